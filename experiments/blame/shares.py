"""Tables of blame and of references beside it, with intervals over seeds."""

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd

from ..statistics.bootstrap import Statistic, log_score, mean, replicate
from ..statistics.intervals import Interval, Sample
from .game import Blame

UNIT = "µm²"

REST = "law"
"""What the tables call the error that the fully idealised machine has left: law, supervisor and sampling."""


def shares(found: Sequence[Blame]) -> pd.DataFrame:
    """One row per scenario, controller, error and stage, then :data:`REST`.

    Columns: ``scenario, controller, stage, share, low, high, unit`` with the 95 % interval over seeds; ``alone,
    alone_low, alone_high``, what idealising this stage alone gains; ``error``, of which it is, ``gap`` or ``contour``.
    The rows of a scenario, controller and error add up to its mean square. Shares are NaN where a run failed, intervals
    also with one seed.
    """
    rows = []
    for blame in found:
        none = np.full_like(blame.errors[-1], math.nan)
        parts = [[*blame.shares, blame.errors[-1]], [*blame.alone, none]]
        shared, alone = (_intervals(part, mean, np.eye(len(part))) for part in parts)
        for i, stage in enumerate([*blame.stages, REST]):
            rows.append([blame.scenario, blame.controller, stage, *shared[i], UNIT, *alone[i], blame.error])
    ends = ["share", "low", "high", "unit", "alone", "alone_low", "alone_high"]
    columns = ["scenario", "controller", "stage", *ends, "error"]
    return pd.DataFrame(rows, columns=columns)


def headroom(found: Sequence[Blame]) -> pd.DataFrame:
    """One row per scenario, controller and reference with other information.

    Columns: ``scenario, controller, informed``; ``rms`` and ``informed_rms`` (µm) over all seeds; ``ratio, low, high``,
    the factor between them, with its 95 % interval over seeds; below 1 the controller is closer than the reference.
    """
    rows = []
    for blame in found:
        for name, informed in blame.references.items():
            squares = [blame.errors[0], informed]
            ratio = _intervals([np.sqrt(s) for s in squares], log_score, np.array([[1.0, -1.0]]))[0]
            sizes = (math.sqrt(s.mean()) for s in squares)
            rows.append([blame.scenario, blame.controller, name, *sizes, *np.exp(ratio)])
    columns = ["scenario", "controller", "informed", "rms", "informed_rms", "ratio", "low", "high"]
    return pd.DataFrame(rows, columns=columns)


def _intervals(values: list[np.ndarray], statistic: Statistic, combinations: np.ndarray) -> list[Interval]:
    """Combinations of a statistic of several rows of values, one value a seed, drawn together (paired).

    A row with a failed run has no value.
    """
    sound = [i for i, row in enumerate(values) if np.isfinite(row).all()]
    if not sound:
        return [Interval(math.nan)] * len(combinations)
    replicates = replicate([Sample.of(values[i]) for i in sound], statistic)
    broken = [np.delete(weights, sound).any() for weights in combinations]
    return [
        Interval(math.nan) if bad else replicates.interval(weights[sound])
        for weights, bad in zip(combinations, broken, strict=True)
    ]


def coalitions(blame: Blame) -> pd.DataFrame:
    """Everything that was simulated, one row per run: ``scenario, controller, error, seed, idealised``, and its
    mean-square error ``square`` (µm²).

    ``idealised`` joins the stages' names by ``+``; empty is the real machine. Rows of the controllers that know more
    carry their names.
    """
    count = len(blame.stages)
    names = ["+".join(blame.stages[i] for i in range(count) if c >> i & 1) for c in range(1 << count)]
    runs = [(blame.controller, name, errors) for name, errors in zip(names, blame.errors, strict=True)]
    runs += [(name, "", errors) for name, errors in blame.references.items()]
    head = {"scenario": blame.scenario, "error": blame.error, "seed": blame.seeds}
    frames = [pd.DataFrame({**head, "controller": who, "idealised": name, "square": e}) for who, name, e in runs]
    order = ["scenario", "controller", "error", "seed", "idealised", "square"]
    return pd.concat(frames, ignore_index=True)[order]


def of_coalitions(frame: pd.DataFrame, controller: str, stages: tuple[str, ...]) -> list[Blame]:
    """The inverse of :func:`coalitions`, of one controller in one scenario."""
    count, found = 1 << len(stages), []
    for error, part in frame.groupby("error", sort=False):
        seeds = tuple(part["seed"].drop_duplicates().tolist())
        errors, names = part["square"].to_numpy().reshape(-1, len(seeds)), part["controller"].to_numpy()[:: len(seeds)]
        known = dict(zip(names[count:], errors[count:], strict=True))
        found.append(Blame(part["scenario"].iloc[0], controller, str(error), seeds, stages, errors[:count], known))
    return found
