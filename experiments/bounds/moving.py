"""Journeys on which the feed changes for corners, or the sheet in turns.

Only what is random for good is counted: the sheet of continuous spectrum, and bands of vibration. Slopes, waves and
steps are given away, and so is what is on when. Of a sheet and bands at once the larger error counts, since whoever is
told one of them is left with the other's.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...envs.plant import path, sheet
from ...envs.plant.controller import PERIOD
from ...envs.scenarios import Scenario
from . import changing, prediction
from .lowering import Sight
from .spectrum import Surface

EVERY = 50
"""Control periods between the moments at which an error is predicted; a corner takes about eighty, corners come at any
phase, and there are many."""

STRETCH, FREE = 5000, 1000
"""Control periods of each turn that are looked at, and how many of them come first and do not count, since the sheet
before the stretch is given away."""


def places(journey: path.Params, begin: float, periods: int) -> np.ndarray:
    """mm along the path at the end of each control period of a journey from ``begin`` on, shape (periods,)."""
    out = np.empty(periods)
    for n in range(periods):
        begin += path.feed_at(journey, begin) * PERIOD
        out[n] = begin
    return out


@dataclass(frozen=True)
class Along:
    """One machine on its way.

    Attributes:
        journey: with its corners.
        surface: of its sheet; None: smooth.
        size: µm, RMS of the sheet.
        sight: what its readings are worth.
        horizons: control periods, rising.
        reach: µm by which 1, 2, … commands move the head.
    """

    journey: path.Params
    surface: Surface | None
    size: float
    sight: Sight
    horizons: Sequence[int] | np.ndarray
    reach: np.ndarray

    def errors(self, begin: float, periods: int, skipped: int, scored: int) -> np.ndarray:
        """Error variances of a stretch of ``periods`` that begins at ``begin`` mm, µm², some moments after ``skipped``.

        All of the sheet before it is given away, and readings before the period ``scored`` are of the least noise.
        """
        at = np.arange(skipped, periods, EVERY)
        if self.surface is None:
            return np.zeros(len(at))
        where = places(self.journey, begin, periods)
        found, gain = changing.errors(self.surface, self.size, self.sight, where, list(self.horizons), at, scored)
        return np.asarray(np.maximum(prediction.held_back(found, self.reach) - gain, 0.0))


def over_turns(scenario: Scenario, along: Along, trembling: float) -> float:
    """Mean square over all turns, µm²; nothing is counted while one turn fades into the next, nor of a last part.

    Each turn's sheet is looked at for a stretch that begins where a journey without corners would begin the turn.

    Args:
        scenario: with turns.
        along: the machine.
        trembling: error variance of its bands of vibration, µm².
    """
    turns = scenario.turns
    assert turns
    total = 0.0
    for turn in range(int(scenario.duration / turns.length + 1e-9)):
        number = turn % turns.count
        found = np.array([trembling if number in turns.vibrations else 0.0])
        if number in turns.random:
            periods = min(STRETCH, round((turns.length - sheet.FADE) / PERIOD))
            begin = along.journey.feed * turn * turns.length
            found = np.maximum(found, along.errors(begin, periods, min(FREE, periods // 2), 0))
        total += float(found.mean()) * (turns.length - sheet.FADE)
    return total / (scenario.duration - scenario.settle)
