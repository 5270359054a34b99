"""Contours cut into short runs, of which a tree knows the boxes: a question costs as much on a sheet of thousands of
holes as it does beside a few."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from . import geos as shapely
from .curve import Indices, Points

RUN = 24
"""Segments of a contour in a run."""


def short_runs(pieces: Sequence[Points]) -> tuple[Any, Indices]:
    """The runs of all contours as shapely's lines, and the contour that each is of.

    Args:
        pieces: arrays of shape (n, 2), mm.
    """
    runs: list[Points] = []
    owners: list[int] = []
    for i, piece in enumerate(pieces):
        runs += [piece[at : at + RUN + 1] for at in range(0, len(piece) - 1, RUN)]
        owners += [i] * (len(runs) - len(owners))
    sizes = [len(run) for run in runs]
    lines = shapely.linestrings(np.concatenate(runs), indices=np.repeat(np.arange(len(runs)), sizes))
    return lines, np.array(owners)
