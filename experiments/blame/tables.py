"""Tables of blame and headroom, with intervals over seeds."""

import math
import warnings
from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy import stats

from .game import Blame

UNIT = "µm²"

REST = "law"
"""What the tables call the error that the fully idealised machine has left: law, supervisor and sampling."""

RESAMPLES = 4999
"""Of the seeds, for an interval."""


def interval(values: np.ndarray, over: np.ndarray | None = None) -> tuple[float, float]:
    """95 % interval over seeds of the mean of ``values`` or, with ``over``, of the root of the ratio of both means.

    Bootstrap, bias-corrected and accelerated; seeds are drawn with all that belongs to them, so it is paired. NaN with
    fewer than two seeds, or where a run failed.
    """
    samples = (values,) if over is None else (values, over)
    if len(values) < 2 or np.isnan(samples).any():
        return math.nan, math.nan

    def statistic(*drawn: np.ndarray, axis: int) -> np.ndarray:
        means = [sample.mean(axis=axis) for sample in drawn]
        return np.sqrt(means[0] / means[1]) if len(means) == 2 else means[0]

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # without scatter there is nothing to correct, which gives NaN
        for method in ("BCa", "percentile"):
            found = stats.bootstrap(samples, statistic, paired=True, n_resamples=RESAMPLES, rng=0, method=method)
            low, high = map(float, found.confidence_interval)
            if not math.isnan(low):
                break
    return low, high


def shares(found: Sequence[Blame]) -> pd.DataFrame:
    """One row per scenario, controller and stage, then :data:`REST`.

    Columns: ``scenario, controller, stage, share, low, high, unit`` with the 95 % interval over seeds, and ``alone,
    alone_low, alone_high``, what idealising this stage alone gains. The rows of a scenario and controller add up to its
    mean-square error. Shares are NaN where a run failed, intervals also with one seed.
    """
    rows = []
    for blame in found:
        none = np.full(len(blame.seeds), math.nan)
        parts = [*zip(blame.stages, blame.shares, blame.alone, strict=True), (REST, blame.errors[-1], none)]
        for stage, share, alone in parts:
            rows.append([blame.scenario, blame.controller, stage, share.mean(), *interval(share), UNIT, alone.mean(),
                         *interval(alone)])  # fmt: skip
    columns = ["scenario", "controller", "stage", "share", "low", "high", "unit", "alone", "alone_low", "alone_high"]
    return pd.DataFrame(rows, columns=columns)


def headroom(found: Sequence[Blame]) -> pd.DataFrame:
    """One row per scenario, controller and bound.

    Columns: ``scenario, controller, bound``; ``rms`` and ``bound_rms`` (µm) over all seeds; ``ratio, low, high``, the
    factor by which the error could fall at most, with its 95 % interval over seeds.
    """
    rows = []
    for blame in found:
        for name, bound in blame.bounds.items():
            real, least = blame.errors[0].mean(), bound.mean()
            rows.append([blame.scenario, blame.controller, name, math.sqrt(real), math.sqrt(least),
                         math.sqrt(real / least), *interval(blame.errors[0], bound)])  # fmt: skip
    return pd.DataFrame(rows, columns=["scenario", "controller", "bound", "rms", "bound_rms", "ratio", "low", "high"])


def coalitions(blame: Blame) -> pd.DataFrame:
    """Everything that was simulated, one row per run: ``scenario, controller, seed, idealised, error`` (µm²).

    ``idealised`` joins the stages' names by ``+``; empty is the real machine. Rows of the controllers that know more
    carry their names.
    """
    count = len(blame.stages)
    names = ["+".join(blame.stages[i] for i in range(count) if c >> i & 1) for c in range(1 << count)]
    runs = [(blame.controller, name, errors) for name, errors in zip(names, blame.errors, strict=True)]
    runs += [(name, "", errors) for name, errors in blame.bounds.items()]
    return pd.concat(
        [pd.DataFrame({"scenario": blame.scenario, "controller": who, "seed": blame.seeds, "idealised": name,
                       "error": errors}) for who, name, errors in runs],
        ignore_index=True,
    )  # fmt: skip


def of_coalitions(frame: pd.DataFrame, controller: str, stages: tuple[str, ...]) -> Blame:
    """The inverse of :func:`coalitions`."""
    seeds = tuple(frame["seed"].drop_duplicates().tolist())
    errors = frame["error"].to_numpy().reshape(-1, len(seeds))
    names = frame["controller"].to_numpy()[:: len(seeds)]
    count = 1 << len(stages)
    bounds = dict(zip(names[count:], errors[count:], strict=True))
    return Blame(str(frame["scenario"].iloc[0]), controller, seeds, stages, errors[:count], bounds)
