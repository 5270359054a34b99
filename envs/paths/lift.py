"""How the set height moves between contours: within the speed and the acceleration that the head's lifts are given.

A height follower answers a set height that jumps with its full gain, and a drive that meets its limits oscillates: so
lifts are planned, as the other axes' moves are. The profile is the cubic ``u²(3 − 2u)``, whose largest speed is 1.5 d/T
and whose largest acceleration is 6 d/T²; a leap adds ``sin²(πu)``, with π/T and 2π²/T² of its height.
"""

import numpy as np

from .curve import Floats


def duration(distance: float, speed: float, acceleration: float) -> float:
    """s that a lift by ``distance`` (mm, of either sign) takes at least."""
    way = abs(distance)
    return max(1.5 * way / speed, float(np.sqrt(6.0 * way / acceleration)))


def rise(start: float, end: float, count: int) -> Floats:
    """Heights of a lift in ``count`` equal steps, without the first."""
    u = np.arange(1, count + 1) / count
    return start + (end - start) * u * u * (3.0 - 2.0 * u)


def leap(start: float, end: float, clearance: float, seconds: float, count: int, limits: tuple[float, float]) -> Floats:
    """Heights of a frog-leap in ``count`` equal steps, without the first: up towards ``clearance`` and down again, as
    high as speed and acceleration (``limits``) leave room for above the lift itself."""
    if count <= 0:
        return np.zeros(0)
    speed, acceleration = limits
    way, top = abs(end - start), max(start, end)
    fast = (speed - 1.5 * way / seconds) * seconds / np.pi
    steep = (acceleration - 6.0 * way / seconds**2) * seconds**2 / (2.0 * np.pi**2)
    peak = max(min(fast, steep, clearance - top), 0.0)
    u = np.arange(1, count + 1) / count
    return rise(start, end, count) + peak * np.sin(np.pi * u) ** 2
