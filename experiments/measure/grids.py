"""Grids: what is run against what. A suite's scenarios × the controllers that can do them × seeds make one table."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...agents.policy import DOCUMENT
from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.engine.quantity import InvalidInput, check_choice
from ...envs.safety import files
from ...envs.scenarios import Machine, Reading, Scenario, machines
from ...envs.tasks import workshop

DEFAULT = ("xi2023-ma", "xi2023-improved", "xi2023-tuned", "pid", "observer", "preview-5ms")
"""Controllers of a suite that names none."""

EVERYBODY = ("ood",)
"""Suites that compare all shipped controllers and policies of their slot unless told otherwise: who was left out there
would seem to hold beyond the distribution as it does within."""

SHOWN = ("following", "contour", "cutting")
"""Suites of the shipped comparison."""


@dataclass(frozen=True)
class Grid:
    """What fills one table of a benchmark: controllers × scenarios × seeds.

    The suite gives its name, the metric of its score and its reference; ``core`` are the scenarios that make the score.
    """

    suite: str
    controllers: tuple[str, ...]
    scenarios: tuple[Scenario, ...]
    seeds: range | tuple[int, ...]
    core: tuple[str, ...] = ()
    home: str = ""  # folder of a user's suite
    machine: Machine | None = None  # that the scenarios were put on
    given_up: tuple[str, ...] = ()  # what they said of another one

    def __post_init__(self) -> None:
        for what, given in (("controller", self.controllers), ("scenario", tuple(s.name for s in self.scenarios))):
            twice = [name for name in given if given.count(name) > 1]
            if twice:
                raise InvalidInput(f"{what} '{twice[0]}' is given twice")
        if not self.with_jobs and any(s.job for s in self.scenarios):
            raise InvalidInput("scenarios with a job and scenarios without one cannot share a table")

    @property
    def rules(self) -> dict[str, Any]:
        """What the suite's file says."""
        return scenarios.rules(self.home or self.suite)

    @property
    def with_jobs(self) -> bool:
        """Whether its scenarios are jobs, which take teams."""
        return all(s.job is not None for s in self.scenarios)

    def known(self) -> dict[str, stacks.Team]:
        """Its controllers by the words that name them.

        Raises:
            InvalidInput: unknown, of another slot, or unable to do one of the jobs.
        """
        found = {name: resolved(name, self.with_jobs) for name in self.controllers}
        for team in found.values():
            for scenario in self.scenarios if self.with_jobs else ():
                workshop.programme(scenario, team)
        return found


# ----------------------------------------------------------------------------------------- from a user's words to grids


def plan(
    suites: Iterable[str] = (),
    controllers: Iterable[str] = (),
    named: Iterable[str | Path | Scenario] = (),
    *,
    path: Path | None = None,
    reading: Reading | None = None,
    seeds: int | None = None,
    split: str = "test",
    everything: bool = False,
    extrapolate: bool = False,
    cut_as: Mapping[str, float] | None = None,
    machine: Machine | None = None,
) -> list[Grid]:
    """The grids that a user's words ask for, one a suite.

    A controller goes into every suite whose scenarios it can do: a follower (slot z) into all, since in jobs it gets a
    team, other stacks and teams into those of jobs.

    Args:
        suites: names, or folders of one's own; without any, those of the named scenarios, or ``following``.
        controllers: without any, the suite's standard ones (:func:`standard`).
        named: scenarios, in place of the whole suite.
        path: drawing that replaces the scenarios' path or part.
        reading: how it is read; without, as the scenarios say.
        seeds: how many of the split; without, what the suite says.
        split: of the seeds.
        everything: all shipped controllers and policies of each suite's slot, besides ``controllers``.
        extrapolate: process settings may leave those that were published.
        cut_as: keys of the jobs that are set otherwise, such as ``{"lead_in": 5.0}``.
        machine: what cuts, in place of what the scenarios say of a machine.

    Raises:
        InvalidInput: unknown names, a controller or scenario that fits no suite, or a suite that nothing fits.
    """
    cases = [scenarios.load(each) for each in named]
    given = list(dict.fromkeys(suites)) or _suites_of(cases) or list(SHOWN if everything and not path else SHOWN[:1])
    for suite in given:
        scenarios.suite(suite)  # an unknown one is an error
    split_seeds(1, split)
    dealt, words = _dealt(cases, given), list(dict.fromkeys(controllers))
    grids = []
    for suite in given:
        if cases and not dealt[suite]:
            raise InvalidInput(
                f"suite '{suite}': none of the scenarios given fits it; leave it out or name one of its own"
            )
        rules, core = scenarios.rules(suite), scenarios.core(suite)
        chosen = dealt[suite] or list(scenarios.suite(suite).values())
        if any(s != scenarios.suite(suite).get(s.name) for s in chosen):
            core = tuple(s.name for s in chosen)  # who names a sheet of his own means all that he names
        if path is not None:
            chosen, rules = (
                along(path, dealt[suite], suite, reading),
                {**rules, "seeds": scenarios.rules("drawing")["seeds"]},
            )
            core = tuple(s.name for s in chosen)
        if extrapolate:
            chosen = [s.varied(job={"extrapolate": True}) if s.job else s for s in chosen]
        with_jobs = all(s.job is not None for s in chosen)
        if cut_as and (with_jobs or len(given) == 1):
            chosen = [cut(s, cut_as) for s in chosen]
        mine = [name for name in words if len(given) == 1 or can_do(name, with_jobs)]
        mine += [name for name in (shipped(suite) if everything else ()) if name not in mine]
        if words and not mine:
            raise InvalidInput(
                f"suite '{suite}': none of the controllers given drives slot 'z', which it needs; name one, such as pid"
            )
        wanted = split_seeds(rules["seeds"] if seeds is None else seeds, split)
        lost = tuple(machines.warnings(chosen, machine)) if machine else ()
        chosen = [machines.put_on(s, machine) for s in chosen] if machine else chosen
        home = suite if scenarios.is_own(suite) else ""
        who = tuple(mine) or standard(suite)
        grids.append(Grid(scenarios.called(suite), who, tuple(chosen), wanted, core, home, machine, lost))
    return grids


def _suites_of(cases: list[Scenario]) -> list[str]:
    """The suites that hold scenarios; for one of nobody's the plain suite of its kind."""
    named = {name: suite for suite in reversed(scenarios.suites()) for name in scenarios.rules(suite)["scenarios"]}

    def home(case: Scenario) -> str:
        # Suites of several versions share names; the one that holds this very scenario is meant.
        same = [suite for suite in scenarios.suites() if scenarios.suite(suite).get(case.name) == case]
        return (same or [named.get(case.name, "contour" if case.job else "following")])[0]

    return list(dict.fromkeys(home(s) for s in cases))


def _dealt(cases: list[Scenario], suites: list[str]) -> dict[str, list[Scenario]]:
    """Scenarios by suite: each in the one that holds it, others in the first of their kind.

    Raises:
        InvalidInput: there is none of its kind.
    """
    dealt: dict[str, list[Scenario]] = {suite: [] for suite in suites}
    for case in cases:
        kind = [s for s in suites if len(suites) == 1 or (scenarios.rules(s)["slot"] != "z") == (case.job is not None)]
        home = [s for s in kind if case.name in scenarios.rules(s)["scenarios"]] or kind
        if not home:
            other = "contour" if case.job else "following"
            raise InvalidInput(f"scenario '{case.name}' fits none of these suites ({', '.join(suites)}); add {other}")
        dealt[home[0]].append(case)
    return dealt


def can_do(name: str, with_jobs: bool) -> bool:
    """Whether the controller of a name can do jobs, or else drives the head.

    Raises:
        InvalidInput: unknown, or given wrongly.
    """
    team = stacks.asked(name)  # whatever is wrong with it is an error in every suite
    return with_jobs or team.slots == "z"


def standard(suite: str) -> tuple[str, ...]:
    """Controllers of a suite for which none are named."""
    return tuple(shipped(suite) if suite in EVERYBODY else scenarios.rules(suite).get("controllers", DEFAULT))


def shipped(suite: str) -> list[str]:
    """Every shipped controller of the suite's slot and every shipped policy of its environment, standard ones first."""
    rules = scenarios.rules(suite)
    found = [name for name in stacks.names() if name != "idle" and stacks.get(name).slot == rules["slot"]]
    standard = [name for name in rules.get("controllers", DEFAULT) if name in found]
    policies = [name for name, folder in stacks.shelved().items() if _environment(folder) == rules["environment"]]
    return list(dict.fromkeys([*standard, *found, *policies]))


def _environment(folder: Path) -> str | None:
    """The environment that a policy was made for; None if the folder holds none."""
    document = folder / DOCUMENT
    return files.json_(document).get("environment") if document.is_file() else None


def resolved(name: str, with_jobs: bool) -> stacks.Team:
    """The controller of a name: of all slots for jobs, of the slot ``z`` alone for followers.

    Raises:
        InvalidInput: unknown, or of another slot.
    """
    if with_jobs:
        return stacks.team(name)
    team = stacks.asked(name)
    if team.slots != "z":
        raise InvalidInput(
            f"controller '{name}' drives slot '{team.slots}'; scenarios without a job need one of slot 'z', such as pid"
        )
    return team


def split_seeds(count: int, split: str = "test") -> range:
    """The first ``count`` seeds of a split.

    Raises:
        InvalidInput: unknown split, or more seeds than it has.
    """
    check_choice(split, scenarios.SPLITS, "split")
    seeds = scenarios.SPLITS[split]
    if not 1 <= count <= len(seeds):
        raise InvalidInput(f"--seeds {count} is out of range; split '{split}' has {len(seeds)}")
    return seeds[:count]


def along(path: Path, given: list[Scenario], suite: str, reading: Reading | None = None) -> list[Scenario]:
    """Scenarios along a drawing: the given ones, or the suite's, with the drawing as their part or path.

    Raises:
        InvalidInput: the drawing cannot be read, or lies outside what scenario and machine allow.
    """
    found = given or [scenarios.load(scenarios.rules(suite).get("along", "drawing"))]
    return [s.along(path, reading) for s in found]


def cut(scenario: Scenario, how: Mapping[str, float]) -> Scenario:
    """A scenario with some keys of its job set otherwise.

    Raises:
        InvalidInput: it has no job, or a value is out of range.
    """
    if scenario.job is None:
        options = ", ".join(f"--{key.replace('_', '-')}" for key in how)
        raise InvalidInput(
            f"{options}: scenario '{scenario.name}' cuts nothing; allowed: scenarios with a job, such as those of the "
            "suites contour and cutting"
        )
    return scenario.varied(job=dict(how))


def planning(grids: Sequence[Grid]) -> list[str]:
    """What a user should know: what his machine replaces, and how the parts that he drew are cut."""
    told: dict[str, None] = {note: None for grid in grids for note in grid.given_up}
    for scenario in (s for grid in grids for s in grid.scenarios):
        if scenario.job and Path(scenario.job.part).suffix:
            name = Path(scenario.job.part).name
            told |= {f"{name}: {warning}": None for warning in workshop.route_of(scenario).warnings}
    return list(told)
