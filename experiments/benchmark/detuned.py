"""For the report: how much worse shipped presets get when one of their parameters is 20 % off.

``kerfgym tune`` says the same of what it finds (:func:`tune.outcome.sensitivity`).
"""

import contextlib
import math

import pandas as pd

from ... import baselines
from ...envs.control import stack as stacks
from ...envs.control.stack import Team
from ...envs.engine.quantity import InvalidInput
from ..results.conclusions import REFERENCE, Results
from ..statistics.ranks import foremost
from ..store.progress import Told
from ..tune import goals
from ..tune.evaluate import Evaluator
from ..tune.outcome import moves

METRIC, SUITE = "rms_true", "following"

SEEDS = 8
"""*Tune* seeds per scenario; the same for all values, so that few tell small changes apart."""

SHOWN = 3
"""Controllers beside the reference: the best presets of the class *sensor*."""

COLUMNS = ["controller", "parameter", "value", "side", "moved", METRIC]


def in_report(results: Results, threads: int = 1, told: Told = lambda done, total, last: None) -> pd.DataFrame:
    """One row for each parameter and side: the score over the preset's own, on *tune* seeds; empty without presets."""
    todo = [(name, team, list(moves(team, searched(name)))) for name, team in _chosen(results).items()]
    rows, done, total = [], 0, sum(1 + len(moved) for _, _, moved in todo)
    for name, team, moved in todo:
        work = Evaluator(team, SUITE, range(SEEDS), threads)

        plain = _score(work, team)
        told(done := done + 1, total, name)
        for parameter, side, value in moved:
            with contextlib.suppress(InvalidInput):  # such as a trim that would eat the window
                ratio = _score(work, team.varied({parameter: value})) / plain
                own = float(team.parameters()[parameter].value)
                rows.append((name, parameter, own, side, value, ratio if math.isfinite(ratio) else math.nan))
            told(done := done + 1, total, name)
    return pd.DataFrame(rows, columns=COLUMNS)


def _score(work: Evaluator, team: Team) -> float:
    return goals.score(METRIC, work.whole(team, (METRIC,)), work.core)


def searched(name: str) -> dict[str, float]:
    """What the search of a shipped preset found; what it left at 0 is not moved."""
    return dict.fromkeys(baselines.preset(name).get("parameters", {}), 0.0)


def _chosen(results: Results) -> dict[str, Team]:
    """The reference and the best of those that are shipped with a preset of their own."""
    tuned = [name for name in foremost(results.standings) if name in stacks.names() and baselines.preset(name)]
    names = [*(n for n in tuned if n == REFERENCE), *[n for n in tuned if n != REFERENCE][:SHOWN]]
    return {name: stacks.asked(name) for name in names}
