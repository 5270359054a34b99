"""The oracle: nothing that knows less does better."""

import numpy as np

from kerfgym.baselines import oracle, preview
from kerfgym.envs.control.stack import get
from kerfgym.envs.figures import metrics
from kerfgym.envs.plant.controller import Preview, Privileged
from kerfgym.envs.scenarios import core, load
from kerfgym.experiments.measure.rollout import roll


def test_without_the_truth_it_is_the_preview():
    rng = np.random.default_rng(3)
    p = oracle.Params(kp=60.0, lead=3.1, sharpen=2.0, ki=0.0, damping=0.0, brake=0.0, nozzle=0.0)
    state = oracle.init(p)
    for _ in range(20):
        known = dict(zip([f"surface_{i}" for i in range(6)], rng.normal(0, 0.01, 6), strict=True))
        known |= {"head_position": 0.8 + rng.normal(0, 0.01), "height": 0.8, "set_height": 0.8}
        state, wish = oracle.control(p, state, Privileged(**known, gap=rng.normal(), velocity=rng.normal()), ())
        other = preview.Params(kp=60.0, lead=3.1, sharpen=2.0, level=0.0)
        assert wish == preview.control(other, preview.init(other), Preview(**known), ())[1]


def test_it_is_privileged_and_at_least_as_good_as_the_preview():
    assert get("oracle").information == "privileged"
    scores = []
    for name in ("oracle", "preview-5ms"):
        errors = [
            np.sqrt(np.mean(metrics.rms_true(roll(load(s), get(name), range(1000, 1010))) ** 2))
            for s in core("following")
        ]
        scores.append(np.exp(np.mean(np.log(errors))))
    assert scores[0] <= scores[1]


def test_its_integral_takes_away_what_is_constant():
    p = oracle.Params(kp=50.0, ki=1000.0, limit=0.02)
    state = oracle.init(p)
    x = Privileged(gap=0.81, set_height=0.8, head_position=0.8, captured=True, fresh=False)
    for period in range(1, 4):
        state, wish = oracle.control(p, state, x, ())
        assert np.isclose(wish, -min(1000.0 * 1e-3 * 0.01 * period, 0.02))
    some, _ = oracle.control(p, oracle.init(p), x, ())
    still, _ = oracle.control(p, some, x._replace(override=True), ())
    assert still.integral == some.integral  # a further period would have doubled it
    assert np.isclose(some.integral, 0.01)
    empty, _ = oracle.control(p, state, x._replace(captured=False), ())
    assert empty.integral == 0.0
