"""Study of Ms and margins at feeds at which policies act.

Tables measure |S| at rest and margins at 500 mm/s (:mod:`measure.stability`, :mod:`measure.margins`). A policy that was
trained on cuts hands over to its base there, so what stands in its row is its base's. Here both are measured at feeds of
its training, on the machine of the suite that it was made for.
"""

from typing import Any

from joblib import Parallel, delayed

from ...envs import scenarios
from ...envs.control import stack as stacks
from ..measure import margins, plants, stability
from ..store.stamp import LAWS, LOADED, trained
from .registry import Trial, study

FEEDS = (100.0, 200.0)
"""mm/s"""

COMPARED = {
    "following": ("forecast", "height-following-gradient"),
    "following-v1": ("forecast", "height-following-v1-gradient"),
}
"""Policies that know their range, behind their base, by the suite whose machine they are measured on."""


def measured(suite: str, name: str, feed: float) -> dict[str, float]:
    """``ms``, ``ms_noise`` with ``…_low`` and ``…_high``, ``gain_margin`` and ``delay_margin`` (ms), worst over the
    corner plants of the suite's first core scenario, at a feed (mm/s)."""
    stack = stacks.resolve(name)
    machine = plants.of(scenarios.load(f"{suite}/{scenarios.core(suite)[0]}"))
    noise, room = stability.broadband(stack, 1, machine, feed), margins.Bench(stack, 1, machine, feed).measure(stack)
    low, high = noise.interval
    found = {"ms": stability.sensitivity(stack, 1, machine, feed).peak, "ms_noise": noise.peak}
    return found | {"ms_noise_low": low, "ms_noise_high": high, "gain_margin": room.gain, "delay_margin": room.delay_ms}


@study(
    "at-work",
    "Ms and margins at feeds at which policies act, beside their base's",
    "python -m kerfgym.experiments.manual at-work",
    3.0,
    (*LOADED, *LAWS, *trained("height-following-")),
)
def at_work(trial: Trial) -> dict[str, Any]:
    """By suite, controller and feed."""
    cases = [(suite, name, feed) for suite, names in COMPARED.items() for name in names for feed in FEEDS]
    found: dict[str, Any] = {}
    each = Parallel(n_jobs=trial.workers, inner_max_num_threads=1)(delayed(measured)(*case) for case in cases)
    for (suite, name, feed), figures in zip(cases, each, strict=True):
        found.setdefault(suite, {}).setdefault(name, {})[f"{feed:g}"] = figures
    return {"numbers": found}
