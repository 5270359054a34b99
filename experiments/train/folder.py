"""``kerfgym train``: a run folder around a training, with its record and its policy."""

from pathlib import Path
from typing import Any

import tomli_w

from ...agents import settings as presets
from ...agents.settings import Settings
from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.scenarios import Machine, Scenario, machines
from ..measure import plants, stability
from ..store import runs
from ..store.progress import Bars, progress

SETTINGS = "settings.toml"


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
    more: dict[str, Any] | None = None,
) -> Path:
    """Trains a policy and writes its run folder; see ``cli.train``; ``more``: settings, as ``trained_in`` gives them.

    Raises:
        InvalidInput: see :func:`agents.train.train` and :func:`runs.at_work`.
    """
    from ...agents.train import untrained

    changes = presets.parsed(assignments) | (more or {})
    if steps is not None:
        changes["steps"] = steps
    if preset is not None:
        settings = presets.from_file(preset, algorithm, env, changes)
    else:
        settings = presets.preset(algorithm, env or next(iter(presets.TASKS)), changes)
    untrained(settings, seed, device, threads)  # errors before anything is written
    short = presets.TASKS[settings.env].name
    folder = runs.folder(name or f"{short}-{algorithm}-{seed}")
    with runs.at_work(folder, overwrite, resume):
        return into(folder, settings, seed, device, threads, ms)


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


def cut_by(settings: Settings) -> Machine | None:
    """The machine that a training was told to be on; None: as the scenarios say, with or without changes."""
    given = settings.environment.get("machine")
    return machines.load(given) if given and not (isinstance(given, dict) and "name" not in given) else None


def into(
    folder: Path,
    settings: Settings,
    seed: int,
    device: str,
    threads: int,
    ms: bool,
    command: list[str] | None = None,
) -> Path:
    """Trains into a folder that is ours, from its last checkpoint on if there is one; ``run.json`` is written last,
    with ``command`` or the one that was typed."""
    from ...agents.export import export
    from ...agents.train import train as learn

    if not (folder / SETTINGS).is_file():  # those of an interrupted run stay: it goes on with these or not at all
        runs.write_text(folder / SETTINGS, tomli_w.dumps(settings.plain()))
    with progress(f"{settings.name} on {settings.env}") as told:
        trained = learn(settings, folder, seed, device, threads, True, told)
    plants_of = on.name if (on := cut_by(settings)) else "standard"
    last, record = trained.evaluations[-1], runs.record(command)
    short, peaks = presets.TASKS[settings.env].name, {}
    with Bars() as bars:
        with bars.busy("exporting the policy, comparing it with the model"):
            origin = {"command": record["command"], "git": record["git"]}
            origin |= {"machine": on.record} if on else {}
            origin |= {"score_tune": trained.score, "ledger": trained.ledger}
            exported = export(trained.model, folder / "policy", origin, known="measured")
        if ms and short == "height-following":
            plant = plants.of(machines.put_on(Scenario(name="corner"), on)) if on else plants.STANDARD
            with bars.busy(f"Ms of the {plants_of} machine's corner plants"):
                stack = stacks.resolve(str(exported.folder))
                measures = {"ms": stability.sensitivity, "ms_noise": stability.broadband}
                peaks = {name: round(measure(stack, machine=plant).peak, 4) for name, measure in measures.items()}
    if peaks:
        figures = f"Ms {peaks['ms']:.2f} with sines, {peaks['ms_noise']:.2f} with noise"
        print(f"largest |S| over the {plants_of} machine's corner plants: {figures}")
    of_training = {"kind": "train", "env": settings.env, "algorithm": settings.name, "seed": seed}
    best = {"score_tune": trained.score, "steps": trained.best_at}
    of_training |= {"settings": settings.flat(), "ledger": trained.ledger, "best": best, "last": last}
    of_training |= {"cut_by": on.record} if on else {}
    of_training |= {"ms": peaks.get("ms"), "ms_noise": peaks.get("ms_noise")}
    policy = {"largest_difference": exported.difference, "actions": exported.compared}
    runs.write_json(folder / "run.json", {**record, **of_training, "policy": policy})
    print(f"policy: {exported.folder}, at most {exported.difference:.1e} off the model in {exported.compared} actions")
    what = "RMS of the true gap error, µm," if short == "height-following" else "minus the mean return"
    print(f"best {what} on tune seeds {trained.score:.3f}, after {trained.best_at} of {last['steps']} steps")
    return folder
