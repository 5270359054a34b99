"""What each stage of the machine costs a controller: a game whose players are idealised stages.

For every subset of stages the same episodes (same seeds, same random numbers) are rolled out with just these idealised
(:mod:`kerfgym.envs.plant.ideal`). A stage's share of the mean-square true error is its Shapley value: what idealising
it gains, averaged over all orders in which the stages could be idealised. Shares add up to the real error less that of
the fully idealised machine, which is what law, supervisor and sampling leave. Of a job there are two errors, and two
games: of the gap and of the contour.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...envs.control import stack as stacks
from ...envs.control.stack import Team
from ...envs.engine.quantity import InvalidInput, did_you_mean
from ...envs.figures import job_metrics, metrics
from ...envs.plant import filters, ideal
from ...envs.plant.fleet import Fleet
from ...envs.scenarios import Scenario
from ..measure import rollout
from ..results import jobs
from ..store.ledger import Ledger

REFERENCES = ("preview-5ms", "oracle")
"""Controllers with other information, shown beside; neither is a bound (:mod:`kerfgym.experiments.bounds`)."""


def shapley(worth: np.ndarray) -> np.ndarray:
    """Shapley value of each player (Shapley 1953).

    Args:
        worth: of every coalition, shape (2ⁿ, …); player ``i`` is in coalition ``c`` if bit ``i`` of ``c`` is set.

    Returns:
        Values of shape (n, …); they add up to ``worth[-1] − worth[0]``.

    Raises:
        InvalidInput: the first axis is not a power of two, at least 2.
    """
    worth = np.asarray(worth, float)
    count = len(worth).bit_length() - 1
    if count < 1 or len(worth) != 1 << count:
        raise InvalidInput(f"{len(worth)} coalitions; a game of n players has 2ⁿ, at least 2")
    coalitions = np.arange(1 << count)
    size = np.array([c.bit_count() for c in coalitions.tolist()])
    weight = np.array([1.0 / (count * math.comb(count - 1, k)) for k in range(count)])
    values = []
    for player in range(count):
        without = coalitions[coalitions >> player & 1 == 0]
        gain = worth[without | 1 << player] - worth[without]
        values.append(np.tensordot(weight[size[without]], gain, axes=1))
    return np.array(values)


@dataclass(frozen=True)
class Blame:
    """What a controller's error is made of in a scenario.

    Attributes:
        scenario, controller: names.
        error: of which it is, ``gap`` or ``contour``.
        seeds: of the episodes.
        stages: that were idealised.
        errors: mean-square true error (µm²) of every coalition of idealised stages, shape (2ⁿ, seeds); stage ``i`` is
            idealised in coalition ``c`` if bit ``i`` of ``c`` is set. NaN where a run failed.
        references: the same of the controllers with other information, on the real machine, shape (seeds,).
    """

    scenario: str
    controller: str
    error: str
    seeds: tuple[int, ...]
    stages: tuple[str, ...]
    errors: np.ndarray
    references: dict[str, np.ndarray]

    @property
    def shares(self) -> np.ndarray:
        """Share of each stage in every seed's error, µm², shape (stages, seeds)."""
        return shapley(-self.errors)

    @property
    def alone(self) -> np.ndarray:
        """What idealising a stage gains when all others stay as they are, µm², shape (stages, seeds)."""
        gained: np.ndarray = self.errors[0] - self.errors[1 << np.arange(len(self.stages))]
        return gained

    @property
    def failed(self) -> int:
        """Runs that failed; with one, there are no shares."""
        return int(sum(np.isnan(e).sum() for e in (self.errors, *self.references.values())))


def measure(
    scenario: Scenario,
    team: Team,
    seeds: Sequence[int],
    stages: Sequence[str] = (),
    references: Sequence[str] = REFERENCES,
    threads: int = 1,
    told: Callable[[int], None] = lambda episodes: None,
    ledger: Ledger | None = None,
) -> list[Blame]:
    """Rolls out every coalition of idealised stages.

    Args:
        scenario: of height following, or with a job.
        team: of the slot ``z`` alone, or for a job of all slots.
        seeds: of the scenario, at least 1.
        stages: some of :func:`stages_of`; without any, all of them.
        references: names of controllers of the slot ``z`` that the gap is compared with.
        threads: worker threads; they change no figure.
        told: is told how many more episodes have been simulated.
        ledger: to which the cost is added.

    Returns:
        One for each error: the gap's, and of a job the contour's.

    Raises:
        InvalidInput: an unknown stage, or a scenario of which the question makes no sense.
    """
    stages = check(scenario, stages)
    if team.z.sealed:
        raise InvalidInput(f"'{team.name}' is C with a filter of its own; blame what it was exported from")
    everyone, idle = np.arange(1 << len(stages)), _idle(scenario, team, stages)
    played = everyone[everyone & idle == 0]
    pairs = np.stack([np.repeat(played, len(seeds)), np.tile(np.arange(len(seeds)), len(played))])
    found: dict[str, np.ndarray] = {}
    cost = ledger or Ledger()
    with cost.timed():
        for first in range(0, pairs.shape[1], rollout.CHUNK):
            coalition, seed = pairs[:, first : first + rollout.CHUNK]
            change = _idealising(stages, coalition)
            for error, squares in _squares(scenario, team, np.asarray(seeds)[seed], threads, cost, change).items():
                found.setdefault(error, np.empty((len(everyone), len(seeds))))[coalition, seed] = squares
            told(len(seed))
        others = {name: team.having(stacks.get(name)) for name in references}
        known = {name: _squares(scenario, other, seeds, threads, cost)["gap"] for name, other in others.items()}
    names = scenario.name, team.name
    whose = tuple(int(s) for s in seeds)
    return [  # one who adds nothing to any coalition need not play
        Blame(*names, error, whose, stages, errors[everyone & ~idle], known if error == "gap" else {})
        for error, errors in found.items()
    ]


def episodes(scenario: Scenario, team: Team, seeds: int, stages: Sequence[str] = ()) -> int:
    """Episodes under ``team`` that :func:`measure` simulates."""
    stages = check(scenario, stages)
    return seeds << len(stages) - _idle(scenario, team, stages).bit_count()


def stages_of(scenario: Scenario) -> tuple[str, ...]:
    """What can be idealised in a scenario."""
    return ideal.JOBS if scenario.job else ideal.FOLLOWING


def check(scenario: Scenario, stages: Sequence[str] = ()) -> tuple[str, ...]:
    """The stages that are idealised.

    Raises:
        InvalidInput: there is nothing to idealise, or nothing to blame.
    """
    known = stages_of(scenario)
    for stage in stages:
        if stage not in ideal.STAGES:
            raise InvalidInput(f"unknown stage '{stage}'; {did_you_mean(stage, known)}")
        if stage not in known:
            raise InvalidInput(f"stage '{stage}' is of jobs; in scenario '{scenario.name}' it is ideal already")
    twice = [stage for stage in stages if stages.count(stage) > 1]
    if twice:
        raise InvalidInput(f"stage '{twice[0]}' is given twice")
    if scenario.head.signal:
        raise InvalidInput(f"scenario '{scenario.name}' replays a recorded signal, on which no stage has an effect")
    return tuple(stages) or known


def _idle(scenario: Scenario, team: Team, stages: Sequence[str]) -> int:
    """Stages that make no difference, as bits: a filter that takes the newest sample alone has no delay, and axes whose
    directions are alike are matched."""
    p = filters.validated(team.z.part("filter"))
    delays = team.z.pilot is not None or p.kind >= filters.LAG or p.window > 1
    matched = all(getattr(scenario.gantry, name) == gain for name, gain in ideal.MATCHING.items())
    idle = {"filter": not delays, "matching": matched}
    return sum(1 << i for i, stage in enumerate(stages) if idle.get(stage))


def _idealising(stages: Sequence[str], coalition: np.ndarray) -> Callable[[Fleet], None]:
    def change(fleet: Fleet) -> None:
        for i, stage in enumerate(stages):
            ideal.idealise(fleet, stage, np.flatnonzero(coalition >> i & 1))

    return change


def _squares(
    scenario: Scenario,
    team: Team,
    seeds: Sequence[int] | np.ndarray,
    threads: int,
    ledger: Ledger,
    change: Callable[[Fleet], None] | None = None,
) -> dict[str, np.ndarray]:
    """Mean-square true errors of each run, µm²; NaN of one that failed."""
    if scenario.job:
        fleet, job, _ = jobs.roll(scenario, team, seeds, threads=threads, change=change)
        ledger.steps += fleet.tick * len(seeds)
        figures = job_metrics.evaluate(job_metrics.Jobs.of(fleet, job))
        return {error: figures[f"{error}_rms"] ** 2 for error in ("gap", "contour")}
    record = rollout.roll(scenario, team.z, seeds, threads, change)
    ledger.steps += scenario.steps * len(seeds)
    rms = metrics.METRICS["rms_true"].function(record)
    return {"gap": np.where(metrics.broken(record), np.nan, rms**2)}
