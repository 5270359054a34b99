"""Seeds: which serve what, and what belongs to each.

Tune 0–999, train 10 000 and up, test 1000–1199 (report) and 1200–1999 (reserve). They are disjoint, and a seed fixes an
episode completely: machine, sheet, and every random number of its noise.
"""

from typing import Any

import numpy as np

from ..engine.lanes import mix

SPLITS = {
    "tune": range(0, 1000),
    "test": range(1000, 1200),
    "reserve": range(1200, 2000),
    "train": range(10_000, 2**40),
}
"""Seeds of each split."""

PAIRS = 8
"""Pairs of tables of random sheets that the seeds of a split share."""


def pairs_of(seeds: np.ndarray) -> np.ndarray:
    """Which pair of tables of random sheets each seed has: splits share none, a split's seeds take theirs in turn."""
    split = np.full(len(seeds), len(SPLITS) - 1)
    for i, known in enumerate(SPLITS.values()):
        split[(seeds >= known.start) & (seeds < known.stop)] = i
    return PAIRS * split + (seeds % np.uint64(PAIRS)).astype(int)


def noise_keys(seeds: Any) -> np.ndarray:
    """The random stream of each scenario seed."""
    return mix(np.atleast_1d(np.asarray(seeds, np.uint64)), np.uint64(0x6E6F697365))
