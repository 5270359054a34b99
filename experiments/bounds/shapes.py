"""Shapes of unknown size: what was drawn once for an episode and has to be learned while it lasts.

A sine of known frequency is two shapes (cosine and sine), a slope is one. A shape is a column over the control periods
of an episode, as the sensor sees it and as the score does, with the variance of its size before anything was measured.
Sizes are taken as Gaussian and independent, so the error of the best estimate follows from linear regression.
"""

from dataclasses import dataclass
from functools import reduce

import numpy as np


@dataclass(frozen=True)
class Shapes:
    """Columns of unknown size.

    Attributes:
        sensor, score: of each shape at the end of every control period, shape (periods, shapes).
        variance: of their sizes; a shape times its size is in µm.
    """

    sensor: np.ndarray
    score: np.ndarray
    variance: np.ndarray

    def __add__(self, other: "Shapes") -> "Shapes":
        return Shapes(
            np.hstack([self.sensor, other.sensor]),
            np.hstack([self.score, other.score]),
            np.concatenate([self.variance, other.variance]),
        )


def none(periods: int) -> Shapes:
    """No shape."""
    return Shapes(np.zeros((periods, 0)), np.zeros((periods, 0)), np.zeros(0))


def joined(parts: list[Shapes], periods: int) -> Shapes:
    """All of ``parts`` together."""
    return reduce(lambda a, b: a + b, parts, none(periods))


def ramp(course: np.ndarray, variance: float) -> Shapes:
    """A slope whose level at the start is known; ``course``: what it is multiplied by, such as mm along the path."""
    column = np.asarray(course, float)[:, None]
    return Shapes(column, column, np.array([variance]))


def sine(phase: np.ndarray, variance: float, sensor: float = 1.0, score: float = 1.0) -> Shapes:
    """A sine whose ``phase`` (rad) is known but for a constant: cosine and sine, each of ``variance`` µm²."""
    columns = np.stack([np.cos(phase), np.sin(phase)], axis=1)
    return Shapes(sensor * columns, score * columns, np.full(2, variance))


def stretch(
    phase: np.ndarray, course: np.ndarray, amplitude: float, variance: float, sensor: float = 1.0, score: float = 1.0
) -> Shapes:
    """What a small error of a sine's frequency makes of it: ``amplitude·course·cos(phase)``.

    Args:
        phase: rad, of the sine that was drawn.
        course: what its frequency is multiplied by: s, or mm for a wavenumber.
        amplitude: µm.
        variance: of the frequency before anything was measured.
        sensor, score: gains.
    """
    column = (amplitude * np.asarray(course) * np.cos(phase))[:, None]
    return Shapes(sensor * column, score * column, np.array([variance]))
