"""Two fronts on the same *test* seeds: which of all their members nobody betters, and how much each front encloses.

The hypervolume is the share of a box that a front covers. Of each metric the box begins at the least that is possible
(:mod:`bound`; 0 for the contour error) and ends at :data:`WORST` times what ``huang2024-dynamic`` has. Its interval
over seeds comes from jack-knifed seeds: the front's hypervolume without each of them gives that seed's influence, and
:mod:`statistics.bootstrap` makes of those what it makes of every mean.

A run that fails counts: a member with a failed run has no figure, so it encloses nothing. Nor does a member whose
settings left the calibrated ones; it is marked.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ....envs.control import stack as stacks
from ....envs.control.stack import Team
from ...statistics import bootstrap
from ...statistics.intervals import Interval, Sample
from ...statistics.pooling import over_scenarios, over_seeds
from ...tune.evaluate import Evaluator
from .points import METRICS, efficient, hypervolume

WORST = np.array([2.5, 1.001, 1.001, 1.001])
"""Where the box ends, times the figures of :data:`REFERENCE`: in time, dross, Rz and contour error."""

REFERENCE = "huang2024-dynamic"


@dataclass(frozen=True)
class Member:
    """A controller of a front on test seeds: ``values`` (seeds, scenarios, metrics), NaN of a failed run."""

    name: str
    values: np.ndarray
    outside: str

    @property
    def failed(self) -> int:
        """Runs that failed."""
        return int(np.isnan(self.values).any(axis=2).sum())

    def figures(self, kept: Any = slice(None)) -> np.ndarray:
        """Its point, of some seeds; NaN if it failed in any of all its runs or left the calibrated settings."""
        if self.failed or self.outside:
            return np.full(len(METRICS), np.nan)
        values = self.values[kept]
        return np.array(
            [over_scenarios(m, [over_seeds(m, column) for column in values[:, :, i].T]) for i, m in enumerate(METRICS)]
        )


def members(folder: Path) -> dict[str, Team]:
    """The controllers of a front's folder by file: tuned ones (TOML) or policies.

    Raises:
        InvalidInput: it holds something else.
    """
    return {path.stem: stacks.asked(str(path)) for path in sorted(folder.iterdir()) if not path.name.startswith(".")}


def tuned(team: Team) -> list[float]:
    """The figures on *tune* seeds with which a member was found, from its record."""
    origin = team.process.provenance
    figures = origin.get("policy", origin)["tune"]
    return [float(figures[m]) for m in METRICS]


def measured(name: str, team: Team, suite: str, seeds: Any) -> Member:
    """A controller on test seeds."""
    evaluator = Evaluator(team, suite, seeds)
    found = evaluator.whole(team, ("collision", "through", *METRICS))
    columns = []
    for scenario in evaluator.core:
        of = found[scenario]
        bad = (of["collision"] > 0) | (of["through"] < 1.0 - 1e-9)
        columns.append(np.stack([np.where(bad, np.nan, of[m]) for m in METRICS], axis=-1))
    return Member(name, np.stack(columns, axis=1), evaluator.outside)


def chosen(points: np.ndarray, ideal: np.ndarray, worst: np.ndarray, count: int) -> list[int]:
    """At most ``count`` points, one after the other that which adds most hypervolume: how a large front is thinned.

    What a point adds only shrinks as others come (the hypervolume is submodular), so most need not be looked at again.
    """
    found: list[int] = []
    covered, gains = 0.0, [(np.inf, i) for i in range(len(points))]
    while gains and len(found) < count:
        gains.sort(key=lambda each: (-each[0], each[1]))
        best = gains[0][1]
        now = hypervolume(points[[*found, best]], ideal, worst) - covered
        if now <= 0.0:
            gains.pop(0)
        elif len(gains) == 1 or now >= gains[1][0]:
            gains.pop(0)
            found.append(best)
            covered += now
        else:
            gains[0] = (now, best)
    return sorted(found)


def volumes(
    fronts: list[list[Member]], ideal: np.ndarray, worst: np.ndarray, among: tuple[int, ...] = (0, 1, 2, 3)
) -> list[Interval]:
    """Hypervolume of each front with its interval over seeds, and behind them of the last less the first.

    Args:
        fronts: their members.
        ideal, worst: the box.
        among: which of the metrics count.
    """
    which = list(among)

    def volume(front: list[Member], kept: Any = slice(None)) -> float:
        points = np.array([m.figures(kept) for m in front])
        return hypervolume(points[:, which], ideal[which], worst[which])

    samples = []
    for front in fronts:
        n = len(front[0].values)
        without = np.array([volume(front, np.arange(n) != i) for i in range(n)])
        samples.append(Sample.of(volume(front) + (n - 1) * (without.mean() - without)))
    found = bootstrap.replicate(samples, bootstrap.mean)
    each = np.eye(len(fronts))
    return [found.interval(w) for w in (*each, each[-1] - each[0])]


def joint(fronts: dict[str, list[Member]]) -> dict[str, int]:
    """How many of each front's members stand on the front of all together."""
    owners = [name for name, front in fronts.items() for _ in front]
    points = np.array([m.figures() for front in fronts.values() for m in front])
    kept = efficient(points)
    return {name: sum(owners[i] == name for i in kept) for name in fronts}
