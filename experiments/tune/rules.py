"""Parameters of position loops that follow from a rule instead of a search; study files call the rules by their names.

All of them are for the nominal axes, in simulation.
"""

from collections.abc import Callable

import numpy as np

from ...baselines import wu
from ...envs.plant import xy_axes
from ..measure import axes

NOMINAL = xy_axes.Params()


def step_response(kp: float, drive: xy_axes.Params = NOMINAL, step: float = 1.0, periods: int = 1500) -> np.ndarray:
    """Position of one axis, mm, every control period after a step of so many mm."""
    to = np.where(np.arange(periods + 20) < 8, 0.0, step)
    seen = axes.travelled([(axes.journey(to, 0.0 * to), drive, wu.Params(kp=kp))], ["x.position"])
    return seen["x.position"][:, 0]


def step_overshoot(most: float) -> float:
    """Largest Kp whose step of 1 mm overshoots by at most this share."""
    low, high = 0.02, 2.0
    for _ in range(24):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if step_response(middle).max() <= 1.0 + most else (low, middle)
    return _cut(low)


def gain_margin(factor: float) -> float:
    """Kp that may be so many times larger before the loop becomes unstable; linear, for a step of 1 mm, where limits
    act, rings on at a lower gain."""
    return _cut(xy_axes.largest_gain(NOMINAL) / (factor * wu.Params().kn * NOMINAL.gain))


def inverse_gain(share: float) -> float:
    """Feed-forward of the velocity: this share of what makes up for the drive's gain."""
    return share / NOMINAL.gain


def inverse_lag(share: float) -> float:
    """Feed-forward of the acceleration, ms: this share of what makes up for the drive's longer time constant."""
    return 1e3 * share * NOMINAL.t1 / NOMINAL.gain


def _cut(kp: float) -> float:
    return float(np.floor(1e4 * kp) / 1e4)


RULES: dict[str, Callable[[float], float]] = {
    each.__name__: each for each in (step_overshoot, gain_margin, inverse_gain, inverse_lag)
}
"""By name."""
