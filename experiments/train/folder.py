"""``kerfgym train``: a run folder around a training, with its record and its policy."""

import contextlib
from pathlib import Path

import tomli_w

from ...agents import settings as presets
from ...agents.settings import Settings
from ...envs.control import stack as stacks
from ...envs.engine.quantity import InvalidInput
from ..measure import grids, stability
from ..store import runs
from ..store.progress import Bars, progress
from . import held_out

SETTINGS, POLICY = "settings.toml", "policy"


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
) -> Path:
    """Trains a policy, or one with each of several seeds, and writes its run folder; see ``cli.train``.

    Raises:
        InvalidInput: see :func:`agents.train.train` and :func:`runs.at_work`.
    """
    from ...agents.train import untrained
    from . import several

    for what, value in (("--seeds", seeds), ("--jobs", jobs)):
        if value < 1:
            raise InvalidInput(f"{what} {value} is out of range; at least 1")
    if test_seeds:
        grids.split_seeds(test_seeds, "test")

    changes = presets.parsed(assignments)
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
            return into(folder, settings, seed, device, threads, ms, test_seeds=test_seeds)
    words = several.command(algorithm, settings.env, steps, preset, assignments, device, threads)
    folder = runs.folder(name or f"{short}-{algorithm}-{seed}-{seed + seeds - 1}")
    with runs.at_work(folder, overwrite, resume):
        tasks = [several.Task(folder, settings, s, device, threads, ms, words) for s in range(seed, seed + seeds)]
        return several.into(folder, tasks, test_seeds, jobs)


def into(
    folder: Path,
    settings: Settings,
    seed: int,
    device: str,
    threads: int,
    ms: bool,
    command: list[str] | None = None,
    test_seeds: int = 0,
    quiet: bool = False,
) -> Path:
    """Trains into a folder that is ours, from its last checkpoint on if there is one; ``run.json`` is written last,
    with ``command`` or the one that was typed.

    Args:
        folder, settings, seed, device, threads: of the training.
        ms: whether a follower's sensitivity is measured.
        command: the words that make it.
        test_seeds: of each scenario, on which the policy is compared with its base; 0: it is not.
        quiet: says nothing, for one of several at a time.
    """
    from ...agents.export import export
    from ...agents.train import train as learn

    if not (folder / SETTINGS).is_file():  # those of an interrupted run stay: it goes on with these or not at all
        runs.write_text(folder / SETTINGS, tomli_w.dumps(settings.plain()))
    with contextlib.nullcontext(None) if quiet else progress(f"{settings.name} on {settings.env}") as told:
        trained = learn(settings, folder, seed, device, threads, True, told)
    last, record = trained.evaluations[-1], runs.record(command)
    short, peaks, beside = presets.TASKS[settings.env].name, {}, None
    with Bars(quiet) as bars:
        with bars.busy("exporting the policy, comparing it with the model"):
            origin = {"command": record["command"], "git": record["git"]}
            origin |= {"score_tune": trained.score, "ledger": trained.ledger}
            exported = export(trained.model, folder / POLICY, origin, known="measured")
        if ms and short == "height-following":
            with bars.busy("Ms of the standard machine's corner plants"):
                stack = stacks.resolve(str(exported.folder))
                measures = {"ms": stability.sensitivity, "ms_noise": stability.broadband}
                peaks = {name: round(measure(stack).peak, 4) for name, measure in measures.items()}
        if test_seeds:
            with bars.busy("policy, base and best classical controller on test seeds"):
                beside = held_out.compared(settings, [str(exported.folder)], test_seeds)
    if peaks and not quiet:
        figures = f"Ms {peaks['ms']:.2f} with sines, {peaks['ms_noise']:.2f} with noise"
        print(f"largest |S| over the standard machine's corner plants: {figures}")
    of_training = {"kind": "train", "env": settings.env, "algorithm": settings.name, "seed": seed}
    best = {"score_tune": trained.score, "steps": trained.best_at}
    of_training |= {"settings": settings.flat(), "ledger": trained.ledger, "best": best, "last": last}
    of_training |= {"ms": peaks.get("ms"), "ms_noise": peaks.get("ms_noise")}
    policy = {"largest_difference": exported.difference, "actions": exported.compared}
    if beside is not None:
        of_training["test"] = held_out.record(beside, [str(exported.folder)], [POLICY])
    runs.write_json(folder / "run.json", {**record, **of_training, "policy": policy})
    if quiet:
        return folder
    print(f"policy: {exported.folder}, at most {exported.difference:.1e} off the model in {exported.compared} actions")
    what = "RMS of the true gap error, µm," if short == "height-following" else "minus the mean return"
    print(f"best {what} on tune seeds {trained.score:.3f}, after {trained.best_at} of {last['steps']} steps")
    if beside is not None:
        print("\n".join(held_out.told(beside, [str(exported.folder)], [POLICY])))
    return folder
