"""Evaluation of candidates in compiled roll-outs, a few scenarios at a time, on fleets that are built once.

Only *tune* seeds, and a suite's core, with those scenarios behind it in which nobody may collide.
"""

import contextlib
import time
from typing import Any

import numpy as np

from ...envs import scenarios
from ...envs.control.stack import Stack, Team
from ...envs.engine.quantity import InvalidInput
from ...envs.figures import evidence, job_metrics, metrics
from ...envs.figures.recording import Recording
from ...envs.plant import heads
from ...envs.plant.fleet import Fleet
from ...envs.scenarios import Machine, Scenario, machines
from ..measure import plants, rollout, stability
from ..results import jobs
from ..statistics.pooling import declared
from ..store.ledger import Ledger
from .goals import DESCENT, Figures

PEAKS = 3
"""Peaks of |S| whose slopes are measured."""

TOGETHER = 2
"""Scenarios that share a fleet: what a candidate is judged by before it goes on. Not the number of cores, since a study
must not depend on the machine."""


def chosen(
    suite: str, named: tuple[str, ...] = (), machine: Machine | None = None
) -> tuple[list[Scenario], tuple[str, ...]]:
    """The scenarios that a candidate goes through, the core first, and the core's names.

    Args:
        suite: name or folder.
        named: scenarios in place of the suite's; all of them are the core.
        machine: on which they are put.
    """
    given = [scenarios.load(each) for each in named]
    cases = {each.name: each for each in given} or scenarios.suite(suite)
    core = tuple(cases) if given else scenarios.core(suite)
    if len(given) > len(cases):
        raise InvalidInput("two scenarios of one name; each needs one of its own")
    if machine:
        cases = {name: machines.put_on(each, machine) for name, each in cases.items()}
    guarded = [n for n, case in cases.items() if case.guard and not case.exempt and n not in core]
    return [cases[name] for name in (*core, *guarded)], core


def with_jobs(suite: str, named: tuple[str, ...] = ()) -> bool:
    """Whether the suite's scenarios, or those that are named in its place, are jobs for teams."""
    return chosen(suite, named)[0][0].job is not None


class Evaluator:
    """Runs candidates that share the laws of ``base``.

    Args:
        base: of the slot z alone, or, for suites of jobs, of any.
        suite: whose core is run.
        seeds: of the split *tune*.
        threads: worker threads.
        extrapolate: process settings may leave what was published.
        relative: controller to whose figures those of candidates are ratios, mean over the seeds to mean; what it takes
            does not count.
        named: scenarios in place of the suite's.
        machine: on which they are put.
    """

    def __init__(
        self,
        base: Team,
        suite: str,
        seeds: Any,
        threads: int = 1,
        extrapolate: bool = False,
        relative: Team | None = None,
        named: tuple[str, ...] = (),
        machine: Machine | None = None,
    ) -> None:
        self.base, self.suite, self.threads = base, suite, threads
        self._plain = (
            Evaluator(relative, suite, seeds, threads, extrapolate, None, named, machine) if relative else None
        )
        self._unit: dict[Any, Figures] = {}
        self.scenarios, self.core = chosen(suite, named, machine)
        if extrapolate:
            self.scenarios = [s.varied(job={"extrapolate": True}) if s.job else s for s in self.scenarios]
        self._excess = dict.fromkeys(evidence.COLUMNS, 0.0)
        self.jobs = self.scenarios[0].job is not None
        if len({s.job is None for s in self.scenarios}) > 1:
            raise InvalidInput("scenarios with a job and scenarios without one cannot be tuned together")
        if not self.jobs and base.slots != "z":
            raise InvalidInput(
                f"controller '{base.name}' drives slot '{base.slots}'; "
                f"suite '{suite}' needs one of slot 'z', such as pid"
            )
        self.seeds = np.asarray(list(seeds), np.uint64)
        self.ledger = Ledger()
        self._groups = _grouped(self.scenarios, 1 if self.jobs else TOGETHER)
        self._rungs: dict[int, _Rung] = {}
        self._machines = list(plants.machines(self.scenarios))
        self._injections: list[stability.Injection] = []
        self.bent: dict[str, np.ndarray] = {}  # slopes of each scenario's mean square, see :meth:`part`

    @property
    def follower(self) -> Stack:
        """The stack of the slot z whose sensitivity is meant."""
        return self.base.full.z

    def peak(self, candidate: Team) -> float:
        """Ms on the suite's machines at fewer frequencies than a benchmark's, quick enough for a search."""
        with self.ledger.timed():
            if not self._injections:
                few = np.geomspace(5.0, 200.0, 20)
                self._injections = [
                    stability.Injection(self.follower, few, settle=0.4, window=0.8, threads=self.threads, machine=each)
                    for each in self._machines
                ]
            found = [injection.measure(candidate.full.z) for injection in self._injections]
        self.ledger.steps += sum(each.steps for each in found)
        return max(each.peak for each in found)

    def bent_peaks(self, candidate: Team, names: tuple[str, ...]) -> tuple[float, np.ndarray, np.ndarray]:
        """Ms as a benchmark measures it; the logarithms of the highest peaks of |S|, (peaks,); and their slopes by
        these parameters, (peaks, parameters), per unit.

        A descent would find the gaps between few frequencies, and what lowers the highest peak raises the next. Only at
        the peaks tangents are needed.

        Raises:
            InvalidInput: there is no slope by one of them.
        """
        stack = candidate.full.z
        with self.ledger.timed():
            found = [stability.sensitivity(stack, self.threads, each) for each in self._machines]
            at = max(range(len(found)), key=lambda i: found[i].peak)
            highest = _peaks(found[at])
            near = stability.Injection(stack, highest, threads=self.threads, machine=self._machines[at])
            bent, slopes = near.measure_with_slopes(stack, names)
        self.ledger.steps += sum(each.steps for each in (*found, bent))
        return found[at].peak, np.log(bent.worst), slopes

    def exact_peak(self, candidate: Team) -> float:
        """Ms of sines on the suite's machines, as a benchmark measures it."""
        with self.ledger.timed():
            found = [stability.sensitivity(candidate.full.z, self.threads, each) for each in self._machines]
        self.ledger.steps += sum(each.steps for each in found)
        return max(each.peak for each in found)

    @property
    def outside(self) -> str:
        """In what, and by how much, settings of jobs so far lay outside of what figures of the cut stand on."""
        return evidence.words(self._excess)

    @property
    def steps(self) -> int:
        """Simulated steps of a candidate that goes through all scenarios, without Ms; a job is as long as the base
        makes it on the first seed."""
        if not self.jobs:
            return sum(len(s.some(self.seeds)) * s.steps for s in self.scenarios)
        return len(self.seeds) * sum(int(jobs.roll(s, self.base.full, self.seeds[:1])[0].tick) for s in self.scenarios)

    @property
    def parts(self) -> int:
        """Parts in which the scenarios are run."""
        return len(self._groups)

    def part(self, i: int, candidate: Team, wanted: tuple[str, ...], by: tuple[str, ...] = ()) -> Figures:
        """The metrics ``wanted`` of the scenarios of part ``i``; failed runs are NaN.

        With ``by``, parameters of the slot z, :attr:`bent` then has the slopes of the mean square of the true gap
        error over all runs, µm² per unit, (parameters,), of these scenarios.
        """
        found = self._part(i, candidate, wanted, by)
        if self._plain is None:
            return found
        if (i, wanted) not in self._unit:
            self._unit[i, wanted] = self._plain.part(i, self._plain.base, wanted)
        unit = self._unit[i, wanted]
        return {
            s: {
                m: v if m == DESCENT or declared(m).always else np.array([v.mean() / unit[s][m].mean()])
                for m, v in of.items()
            }
            for s, of in found.items()
        }

    def _part(self, i: int, candidate: Team, wanted: tuple[str, ...], by: tuple[str, ...]) -> Figures:
        self.ledger.use(int(s) for s in self.seeds)
        if self.jobs:
            return self._part_of_jobs(self._groups[i][0], candidate.full, wanted)
        if i not in self._rungs:
            self._rungs[i] = _Rung(self._groups[i], self.follower, self._groups[i][0].some(self.seeds), self.threads)
        start = time.process_time()
        found = self._rungs[i].run(candidate.z, wanted, by)
        self.bent |= self._rungs[i].bent
        self.ledger.add(self._rungs[i].steps * (1 + len(by)), time.process_time() - start)
        return found

    def whole(self, candidate: Team, wanted: tuple[str, ...]) -> Figures:
        """The same, of all scenarios at once."""
        return {s: figures for i in range(self.parts) for s, figures in self.part(i, candidate, wanted).items()}

    def _part_of_jobs(self, scenario: Scenario, team: Team, wanted: tuple[str, ...]) -> Figures:
        start = time.process_time()
        fleet, job, _ = jobs.roll(scenario, team, self.seeds)
        done = job_metrics.Jobs.of(fleet, job)
        broken = job_metrics.broken(done)
        left = job_metrics.evidence(done)
        self._excess = {name: max(worst, float(left[name].max())) for name, worst in self._excess.items()}
        found = {
            name: figure if name in ("collision", "covered") else np.where(broken, np.nan, figure)
            for name in dict.fromkeys(wanted)
            for figure in (job_metrics.METRICS[name].function(done),)
        }
        self.ledger.add(int(fleet.tick) * len(self.seeds), time.process_time() - start)
        return {scenario.name: found}


def _peaks(found: stability.Sensitivity) -> np.ndarray:
    """The frequencies of the highest peaks, Hz, the highest first; no two side by side."""
    worst = np.concatenate([[0.0], found.worst, [0.0]])
    tops = np.flatnonzero((found.worst >= worst[:-2]) & (found.worst > worst[2:]))
    tops = tops[np.argsort(-found.worst[tops], kind="stable")]
    if not len(tops):  # it is infinite somewhere
        tops = np.array([int(np.argmax(found.worst))])
    return found.frequencies[tops[:PEAKS]]


def _grouped(cases: list[Scenario], size: int) -> list[list[Scenario]]:
    """The scenarios in groups of equal length, on as many seeds."""
    groups: list[list[Scenario]] = []
    for scenario in cases:
        last = groups[-1][0] if groups else scenario
        alike = (scenario.steps, scenario.share) == (last.steps, last.share)
        if groups and len(groups[-1]) < size and alike:
            groups[-1].append(scenario)
        else:
            groups.append([scenario])
    return groups


class _Rung:
    """A fleet with the machines of a few scenarios of equal length."""

    def __init__(self, group: list[Scenario], stack: Stack, seeds: np.ndarray, threads: int) -> None:
        self.scenarios, self.seeds = group, np.tile(seeds, len(group))
        self.machines = [np.arange(i * len(seeds), (i + 1) * len(seeds)) for i in range(len(group))]
        self.fleet = Fleet(len(self.seeds), stack.law, heads.POOL, threads)
        for scenario, mine in zip(group, self.machines, strict=True):
            scenarios.prepare(self.fleet, scenario, mine, seeds)
        self.steps = self.fleet.size * group[0].steps
        self.bent: dict[str, np.ndarray] = {}
        self._slopes: Any = None

    def run(self, stack: Stack, wanted: tuple[str, ...], by: tuple[str, ...] = ()) -> Figures:
        with self._tangents(stack, by):
            whole = rollout.anew(self.fleet, self.scenarios[0], stack, self.seeds)
        found: Figures = {}
        for scenario, mine in zip(self.scenarios, self.machines, strict=True):
            part = slice(mine[0], mine[-1] + 1)
            ends = (whole.collided[part], whole.lowest[part])
            head = (scenario, whole.seeds[part], whole.set_height[part])
            record = Recording(*head, whole.data[:, :, part], *ends, to_the_end=True)
            broken = metrics.broken(record)
            if by:
                self.bent[scenario.name] = _mean_square_slopes(record, self._slopes.of_gap()[:, :, part])
            found[scenario.name] = {
                name: figure if name == "collision" else np.where(broken, np.nan, figure)
                for name in dict.fromkeys(wanted)
                for figure in (metrics.METRICS[name].function(record),)
            }
            if scenario.start_above != 0:
                found[scenario.name][DESCENT] = np.zeros(0)
        return found

    def _tangents(self, stack: Stack, by: tuple[str, ...]) -> Any:
        """A context in which the machines run with tangents, if there are parameters to have some."""
        if not by:
            return contextlib.nullcontext()
        from ..measure.slopes import Slopes  # makes its tangents when it is loaded

        if self._slopes is None or self._slopes.names != by:
            self._slopes = Slopes(self.fleet, stack, by, self.scenarios[0].steps)
        return self._slopes


def _mean_square_slopes(record: Recording, slopes: np.ndarray) -> np.ndarray:
    """Slopes of what ``rms_true`` is the root of, mean over the runs, µm² per unit, (parameters,).

    ``slopes``: of the true gap, mm per unit, shape (parameters, periods, machines).
    """
    weight = 1e6 * record.scored / np.maximum(record.scored.sum(axis=0), 1) / record.scored.shape[1]
    return 2.0 * np.einsum("tm,ptm->p", weight * record.error, slopes)
