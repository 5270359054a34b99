"""What each stage of the machine costs a controller: a game whose players are idealised stages.

For every subset of stages the same episodes (same seeds, same random numbers) are rolled out with just these idealised
(:mod:`kerfgym.envs.ideal`). A stage's share of the mean-square true error is its Shapley value: what idealising it
gains, averaged over all orders in which the stages could be idealised. Shares add up to the real error less that of the
fully idealised machine, which is what law, supervisor and sampling leave.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...envs import ideal, metrics
from ...envs import stack as stacks
from ...envs.plant import filters
from ...envs.plant.fleet import Fleet
from ...envs.plant.quantity import InvalidInput, did_you_mean
from ...envs.recording import Recording
from ...envs.scenarios import Scenario
from ...envs.stack import Stack
from .. import rollout

STAGES = tuple(ideal.STAGES)

BOUNDS = ("preview-5ms", "oracle")
"""Controllers that know more, whose error bounds what can be gained."""


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
        seeds: of the episodes.
        stages: that were idealised.
        errors: mean-square true error (µm²) of every coalition of idealised stages, shape (2ⁿ, seeds); stage ``i`` is
            idealised in coalition ``c`` if bit ``i`` of ``c`` is set. NaN where a run failed.
        bounds: the same of the controllers that know more, on the real machine, shape (seeds,).
    """

    scenario: str
    controller: str
    seeds: tuple[int, ...]
    stages: tuple[str, ...]
    errors: np.ndarray
    bounds: dict[str, np.ndarray]

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
        return int(sum(np.isnan(e).sum() for e in (self.errors, *self.bounds.values())))


def measure(
    scenario: Scenario,
    stack: Stack,
    seeds: Sequence[int],
    stages: Sequence[str] = STAGES,
    bounds: Sequence[str] = BOUNDS,
    threads: int = 1,
    told: Callable[[int], None] = lambda episodes: None,
) -> Blame:
    """Rolls out every coalition of idealised stages.

    Args:
        scenario: without a job.
        stack: of the slot ``z``.
        seeds: of the scenario, at least 1.
        stages: some of :data:`STAGES`.
        bounds: names of controllers that the headroom is measured to.
        threads: worker threads; they change no figure.
        told: is told how many more episodes have been simulated.

    Raises:
        InvalidInput: an unknown stage, or a scenario or controller of which the question makes no sense.
    """
    check(scenario, stack, stages)
    everyone, idle = np.arange(1 << len(stages)), _idle(stack, stages)
    played = everyone[everyone & idle == 0]
    errors = np.empty((len(everyone), len(seeds)))
    pairs = np.stack([np.repeat(played, len(seeds)), np.tile(np.arange(len(seeds)), len(played))])
    for first in range(0, pairs.shape[1], rollout.CHUNK):
        coalition, seed = pairs[:, first : first + rollout.CHUNK]
        record = rollout.roll(scenario, stack, np.asarray(seeds)[seed], threads, _idealising(stages, coalition))
        errors[coalition, seed] = _squares(record)
        told(len(seed))
    errors = errors[everyone & ~idle]  # one who adds nothing to any coalition need not play
    known = {name: _squares(rollout.roll(scenario, stacks.get(name), seeds, threads)) for name in bounds}
    return Blame(scenario.name, stack.name, tuple(int(s) for s in seeds), tuple(stages), errors, known)


def episodes(stack: Stack, seeds: int, stages: Sequence[str] = STAGES) -> int:
    """Episodes under ``stack`` that :func:`measure` simulates."""
    return seeds << len(stages) - _idle(stack, stages).bit_count()


def check(scenario: Scenario, stack: Stack, stages: Sequence[str] = STAGES) -> None:
    """Raises :class:`InvalidInput` where there is nothing to idealise, or nothing to blame."""
    for stage in stages:
        if stage not in STAGES:
            raise InvalidInput(f"unknown stage '{stage}'; {did_you_mean(stage, STAGES)}")
    twice = [stage for stage in stages if stages.count(stage) > 1]
    if twice or not stages:
        raise InvalidInput(f"stage '{twice[0]}' is given twice" if twice else "at least one stage must be idealised")
    if stack.slot != "z":
        raise InvalidInput(f"controller '{stack.name}' drives slot '{stack.slot}'; blame is for height followers")
    if scenario.job:
        raise InvalidInput(f"scenario '{scenario.name}' is a job; blame is for scenarios of height following")
    if scenario.head.signal:
        raise InvalidInput(f"scenario '{scenario.name}' replays a recorded signal, on which no stage has an effect")


def _idle(stack: Stack, stages: Sequence[str]) -> int:
    """Stages that make no difference, as bits: a filter that takes the newest sample alone has no delay."""
    p = filters.validated(stack.part("filter"))
    delays = stack.pilot is not None or p.kind >= filters.LAG or p.window > 1
    return 0 if delays or "filter" not in stages else 1 << list(stages).index("filter")


def _idealising(stages: Sequence[str], coalition: np.ndarray) -> Callable[[Fleet], None]:
    def change(fleet: Fleet) -> None:
        for i, stage in enumerate(stages):
            ideal.idealise(fleet, stage, np.flatnonzero(coalition >> i & 1))

    return change


def _squares(record: Recording) -> np.ndarray:
    """Mean-square true error of each run, µm²; NaN of one that failed."""
    rms = metrics.METRICS["rms_true"].function(record)
    return np.where(metrics.failed(record), np.nan, rms**2)
