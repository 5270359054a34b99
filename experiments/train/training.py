"""``kerfgym train``: one training, or several of one method, in a run folder."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...agents import settings as presets
from ...envs import scenarios
from ...envs.engine.quantity import InvalidInput
from ...envs.scenarios import Machine
from ..measure import grids
from ..store import runs
from . import folder as single
from . import held_out, several


def train(
    algorithm: str,
    env: str | None,
    steps: int | None,
    seed: int,
    assignments: list[str],
    name: str | None,
    device: str,
    threads: int,
    ms: bool,
    overwrite: bool,
    resume: bool,
    preset: Path | None = None,
    seeds: int = 1,
    test_seeds: int = held_out.SEEDS,
    jobs: int = 2,
    more: dict[str, Any] | None = None,
    where: Sequence[str] = (),
) -> Path:
    """Trains a policy, or one with each of several seeds, and writes its run folder; see ``cli.train``. ``more`` are
    settings, as :func:`trained_in` gives them, and ``where`` the words of the command that asked for them.

    Raises:
        InvalidInput: see :func:`agents.train.train` and :func:`runs.at_work`.
    """
    from ...agents.train import untrained

    for what, value in (("--seeds", seeds), ("--jobs", jobs)):
        if value < 1:
            raise InvalidInput(f"{what} {value} is out of range; at least 1")
    if test_seeds:
        grids.split_seeds(test_seeds, "test")

    changes = presets.parsed(assignments) | (more or {})
    if steps is not None:
        changes["steps"] = steps
    if preset is not None:
        settings = presets.from_file(preset, algorithm, env, changes)
    else:
        settings = presets.preset(algorithm, env or next(iter(presets.TASKS)), changes)
    untrained(settings, seed, device, threads)  # errors before anything is written
    short = presets.TASKS[settings.env].name
    if seeds == 1:
        folder = runs.folder(name or f"{short}-{algorithm}-{seed}")
        with runs.at_work(folder, overwrite, resume):
            return single.into(folder, settings, seed, device, threads, ms, test_seeds=test_seeds)
    words = several.command(algorithm, settings.env, steps, preset, assignments, device, threads, where)
    folder = runs.folder(name or f"{short}-{algorithm}-{seed}-{seed + seeds - 1}")
    with runs.at_work(folder, overwrite, resume):
        tasks = [several.Task(folder, settings, s, device, threads, ms, words) for s in range(seed, seed + seeds)]
        return several.into(folder, tasks, test_seeds, jobs)


def trained_in(suites: list[str], named: list[str], machine: Machine | None) -> dict[str, Any]:
    """What suites, scenarios and a machine are in the settings of a training; empty if none was given.

    Files are told with their whole path, for the training to go on from anywhere; a machine with all its numbers, for
    the policy to say what it was made on.

    Raises:
        InvalidInput: unknown, or wrong.
    """
    changes: dict[str, Any] = {}
    for suite in suites:
        scenarios.suite(suite)
    for one in named:
        scenarios.load(one)
    if given := [str(Path(each).resolve()) if Path(each).exists() else each for each in (*suites, *named)]:
        changes |= {"environment.scenario": given, "evaluation.scenario": given}
    if machine:
        changes["environment.machine"] = machine.tables
    return changes
