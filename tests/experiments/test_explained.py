"""The picture of a policy: what it draws is what the policy did, moment by moment."""

import gymnasium as gym
import numpy as np
import pytest
from PIL import Image

from kerfgym.agents.policy import Policy, bases
from kerfgym.envs import scenarios
from kerfgym.envs.control import stack as stacks
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.experiments import cli
from kerfgym.experiments.measure import rollout
from kerfgym.experiments.render import explained, explained_picture

SEED = 1000
POLICY = "height-following-gradient"


@pytest.fixture(scope="module")
def stepped():
    """The shipped policy on a step."""
    return explained.explained(explained.policy_of(POLICY), scenarios.load("step"), SEED)


def test_its_actions_are_those_of_the_gymnasium_loop(stepped):
    policy = Policy.load(stacks.shelved()[POLICY])
    settings = {"control": "weights", "observation": "sheet", "base": "forecast", "scenario": "step", "split": "test"}
    env = gym.make("kerfgym/HeightFollowing-v0", **settings).unwrapped
    observation, _ = env.reset(options={"scenario_seed": SEED})
    for period in range(900):
        action = policy.act(observation, start=period == 0)
        assert (action == stepped.actions[period].astype(np.float32)).all()
        observation = env.step(action)[0]


def test_its_errors_are_those_of_recorded_runs(stepped):
    case, stack = scenarios.load("step"), explained.policy_of(POLICY)
    base = bases(stack.pilot.policy.document, "")["z"]
    for which, told in ((stack, stepped.error), (base, stepped.base_error)):
        run = rollout.roll(case, which, [SEED])
        assert told == pytest.approx(1e3 * (run["gap"][:, 0].astype(float) - run.set_height[0]), abs=1e-9)


def test_what_the_law_alone_wished_and_what_the_actions_add_make_the_command(stepped):
    at = stepped.window
    run = rollout.roll(scenarios.load("step"), explained.policy_of(POLICY), [SEED])
    assert run["command"][at, 0] == pytest.approx((stepped.plain + stepped.added)[at], abs=1e-5)
    assert run["wish"][at.start - 1 : at.stop - 1, 0] == pytest.approx(stepped.plain[at], abs=1e-5)
    assert np.abs(stepped.added[at]).max() > 1.0
    gain = [weight.name for weight in stacks.get("forecast").law.weighing.weights].index("gain")
    assert (stepped.effects[at, gain][stepped.actions[at, gain] == 0] == 0).all()


def test_a_window_begins_before_the_step_and_before_the_hole(stepped):
    sheet = stepped.sheet[stepped.window]
    assert np.ptp(sheet[:70]) < 1e-3
    assert np.ptp(sheet) > 0.1
    over = np.ones(3000, bool)
    over[100:120] = over[1500:1520] = False  # the first hole lies in the settling time
    assert explained._window(np.where(over, 0.0, np.nan), over, 300) == slice(1420, 1770)


def test_beyond_its_range_it_is_shown_as_its_base(tmp_path):
    found = explained.explained(explained.policy_of(POLICY), scenarios.load("fast-step"), SEED)
    assert found.alone
    assert not found.actions[found.window].any()
    assert (found.error == found.base_error)[found.window].all()
    names = explained.meanings(explained.policy_of(POLICY))
    figure = explained_picture.draw([found], names, POLICY, "forecast", SEED)
    assert any("hands over to its base" in text.get_text() for axes in figure.axes for text in axes.texts)


def test_six_actions_have_a_colour_and_are_drawn_as_they_were(stepped):
    names = explained.meanings(explained.policy_of(POLICY))
    figure = explained_picture.draw([stepped], names, POLICY, "forecast", SEED)
    coloured = [
        line for line in figure.axes[0].lines if line.get_color() in explained_picture.COLOURS and len(line.get_xdata())
    ]
    assert len(coloured) == explained_picture.SERIES
    for line, action in zip(reversed(coloured), explained.largest([stepped], explained_picture.SERIES), strict=True):
        assert (line.get_ydata() == stepped.actions[stepped.window, action]).all()
    size = np.sqrt(np.mean(stepped.effects[stepped.window] ** 2, axis=0))
    assert explained.largest([stepped], 3) == list(np.argsort(-size)[:3])


@pytest.mark.parametrize(
    ("policy", "meanings"),
    [
        ("height-following-ppo", ["velocity, ±50 mm/s"]),
        ("height-following-schedule-ppo", ["window: 1 to 15 samples", "trim: 0 to 3 samples", "gain: 0.2 to 3"]),
    ],
)
def test_other_controls_show_their_actions(policy, meanings, tmp_path, capsys):
    assert explained.meanings(explained.policy_of(policy)) == meanings
    out = tmp_path / "actions.png"
    cli.main(["render", str(out), "--explain", policy, "-s", "holes"])
    assert Image.open(out).width > 600
    assert capsys.readouterr().out.strip().endswith("actions.png")


def test_what_cannot_be_explained_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match=r"'pid' is no policy that follows the height; shipped are height-following"):
        explained.policy_of("pid")
    with pytest.raises(InvalidInput, match=r"a picture: \.png"):
        explained_picture.paint(tmp_path / "x.mp4", POLICY, (), SEED)
    with pytest.raises(InvalidInput, match="has a job"):
        explained_picture.paint(tmp_path / "x.png", POLICY, ("contour-circle",), SEED)
