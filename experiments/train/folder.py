"""A run folder around one training, with its record and its policy."""

import contextlib
from pathlib import Path

import tomli_w

from ...agents import settings as presets
from ...agents.settings import Settings
from ...envs.control import stack as stacks
from ...envs.scenarios import Scenario, machines
from ..measure import plants, stability
from ..store import runs
from ..store.progress import Bars, progress
from . import held_out

SETTINGS, POLICY = "settings.toml", "policy"

MODEL = "model.zip"
"""What stable-baselines3 loads, for those who go on with its tools. It holds pickles, so nothing here reads it."""


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
    plants_of = on.name if (on := held_out.cut_by(settings)) else "standard"
    last, record = trained.evaluations[-1], runs.record(command)
    short, peaks, beside = presets.TASKS[settings.env].name, {}, None
    with Bars(quiet) as bars:
        with bars.busy("exporting the policy, comparing it with the model"):
            origin = {"command": record["command"], "git": record["git"]}
            origin |= {"machine": on.record} if on else {}
            origin |= {"score_tune": trained.score, "ledger": trained.ledger}
            exported = export(trained.model, folder / POLICY, origin, known="measured")
            if settings.name != "gradient":
                with runs.atomic(folder / MODEL) as part, part.open("wb") as file:
                    trained.model.save(file)
        if ms and short == "height-following":
            plant = plants.of(machines.put_on(Scenario(name="corner"), on)) if on else plants.STANDARD
            with bars.busy(f"Ms of the {plants_of} machine's corner plants"):
                stack = stacks.resolve(str(exported.folder))
                measures = {"ms": stability.sensitivity, "ms_noise": stability.broadband}
                peaks = {name: round(measure(stack, machine=plant).peak, 4) for name, measure in measures.items()}
        if test_seeds:
            with bars.busy("policy, base and best classical controller on test seeds"):
                beside = held_out.compared(settings, [str(exported.folder)], test_seeds)
    if peaks and not quiet:
        figures = f"Ms {peaks['ms']:.2f} with sines, {peaks['ms_noise']:.2f} with noise"
        print(f"largest |S| over the {plants_of} machine's corner plants: {figures}")
    of_training = {"kind": "train", "env": settings.env, "algorithm": settings.name, "seed": seed}
    best = {"score_tune": trained.score, "steps": trained.best_at}
    of_training |= {"settings": settings.flat(), "ledger": trained.ledger, "best": best, "last": last}
    of_training |= {"cut_by": on.record} if on else {}
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
