"""Jerk-limited changes of speed: the S-curve, without acceleration at both ends (Biagiotti and Melchiorri 2008).

From v0 to v1 = v0 ± dv the acceleration rises with the jerk J, stays at a where dv ≥ a²/J, and falls again. That takes
T = dv/a + a/J, or 2·sqrt(dv/J) where a is not reached, and leads (v0 + v1)/2·T far.
"""

from dataclasses import dataclass
from math import asinh, cbrt, sinh, sqrt

import numpy as np

from .curve import Floats


def ramp_time(change: Floats, acceleration: Floats, jerk: Floats) -> Floats:
    """s, to change the speed by ``change`` mm/s of either sign."""
    dv = np.abs(change)
    return np.where(dv >= acceleration**2 / jerk, dv / acceleration + acceleration / jerk, 2.0 * np.sqrt(dv / jerk))


def ramp_way(v0: Floats, v1: Floats, acceleration: Floats, jerk: Floats) -> Floats:
    """mm, to get from ``v0`` to ``v1``."""
    return 0.5 * (v0 + v1) * ramp_time(v1 - v0, acceleration, jerk)


def reachable(v0: float, way: float, acceleration: float, jerk: float) -> float:
    """mm/s, the speed that can be reached from ``v0`` within ``way`` mm; the inverse of :func:`ramp_way`."""
    knee = acceleration * acceleration / jerk
    if way <= (v0 + 0.5 * knee) * 2.0 * acceleration / jerk:
        # x³ + 2·v0·x = way·sqrt(J) with x = sqrt(dv): one real root.
        q = way * sqrt(jerk)
        if v0 < 1e-9:
            return v0 + cbrt(q) ** 2
        r = sqrt(2.0 * v0 / 3.0)
        return v0 + (2.0 * r * sinh(asinh(0.5 * q / r**3) / 3.0)) ** 2
    # v1² + knee·v1 + knee·v0 − v0² = 2·a·way
    return 0.5 * (sqrt(knee * knee - 4.0 * (knee * v0 - v0 * v0 - 2.0 * acceleration * way)) - knee)


def peak(v0: Floats, v1: Floats, most: Floats, way: Floats, acceleration: Floats, jerk: Floats) -> Floats:
    """The largest speed up to ``most`` from which ``v1`` is still reached, on a way from v0 to v1. By bisection."""
    low, high = np.maximum(v0, v1), np.maximum(most, np.maximum(v0, v1))
    fits = ramp_way(v0, high, acceleration, jerk) + ramp_way(high, v1, acceleration, jerk) <= way
    low = np.where(fits, high, low)
    for _ in range(0 if fits.all() else 50):
        middle = 0.5 * (low + high)
        fits = ramp_way(v0, middle, acceleration, jerk) + ramp_way(middle, v1, acceleration, jerk) <= way
        low, high = np.where(fits, middle, low), np.where(fits, high, middle)
    return low


@dataclass(frozen=True)
class Motion:
    """Distance against time as cubics: piece i begins at ``t[i]`` with distance ``s``, speed ``v``, acceleration ``a``
    and has the jerk ``j``; one more entry in ``t`` ends it, ``way`` is the distance travelled."""

    t: Floats
    s: Floats
    v: Floats
    a: Floats
    j: Floats
    way: float

    @property
    def duration(self) -> float:
        """s."""
        return float(self.t[-1])

    def at(self, t: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Distance mm, speed mm/s, acceleration mm/s² and jerk mm/s³ at ``t`` s; at rest before and after."""
        i = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.j) - 1)
        over = (t < self.t[0]) | (t >= self.t[-1])
        d = np.clip(t, 0.0, self.t[-1]) - self.t[i]
        a0, j = self.a[i], self.j[i]
        s = self.s[i] + d * (self.v[i] + d * (a0 / 2.0 + d * j / 6.0))
        v = np.where(over, 0.0, self.v[i] + d * (a0 + d * j / 2.0))
        s = np.where(t >= self.t[-1], self.way, np.clip(s, 0.0, self.way))
        return s, np.maximum(v, 0.0), np.where(over, 0.0, a0 + d * j), np.where(over, 0.0, j)


def blocks(v0: Floats, v1: Floats, top: Floats, ways: Floats, acceleration: Floats, jerk: Floats) -> Motion:
    """One block after the other: each begins with ``v0``, goes up to ``top``, ends with ``v1``, and is ``ways`` long,
    which must suffice for that (see :func:`peak`)."""
    up, up_way = _ramp(top - v0, acceleration, jerk), ramp_way(v0, top, acceleration, jerk)
    down, down_way = _ramp(top - v1, acceleration, jerk), ramp_way(top, v1, acceleration, jerk)
    cruise = np.maximum(ways - up_way - down_way, 0.0) / np.where(top > 0.0, top, 1.0)
    times = np.stack([*up, cruise, *down], axis=1)
    jerks = np.outer(jerk, [1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0])
    a, v = np.zeros_like(times), np.zeros_like(times)
    s = np.zeros_like(times)
    at_a, at_v, at_s = 0.0 * v0, v0.copy(), np.insert(np.cumsum(ways), 0, 0.0)[:-1]
    for k in range(7):
        d, j = times[:, k], jerks[:, k]
        if k == 3:
            at_a, at_v = 0.0 * at_a, top
        a[:, k], v[:, k], s[:, k] = at_a, at_v, at_s
        at_s = at_s + d * (at_v + d * (at_a / 2.0 + d * j / 6.0))
        at_v, at_a = at_v + d * (at_a + d * j / 2.0), at_a + d * j
    on = times.ravel() > 0.0
    t = np.insert(np.cumsum(times.ravel()[on]), 0, 0.0)
    s, v, a, jerks = (q.ravel()[on] for q in (s, v, a, jerks))
    return Motion(t, s, v, a, jerks, float(ways.sum()))


def steps(ways: Floats, speeds: Floats) -> Motion:
    """One constant speed after the other, each for its way, there at once and gone at once."""
    s, zero = np.insert(np.cumsum(ways), 0, 0.0), np.zeros(len(ways))
    t = np.insert(np.cumsum(ways / speeds), 0, 0.0)
    return Motion(t, s[:-1], np.asarray(speeds, float), zero, zero, float(s[-1]))


def _ramp(change: Floats, acceleration: Floats, jerk: Floats) -> tuple[Floats, Floats, Floats]:
    """s, with rising, steady and falling acceleration."""
    dv = np.abs(change)
    full = dv >= acceleration**2 / jerk
    rise = np.where(full, acceleration / jerk, np.sqrt(dv / jerk))
    return rise, np.where(full, dv / acceleration - acceleration / jerk, 0.0), rise
