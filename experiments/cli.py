"""The ``kerfgym`` command."""

import atexit
import contextlib
import errno
import os
import re
import select
import sys
from pathlib import Path
from typing import Annotated, Any, NoReturn

import tyro
from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from .. import __version__
from ..envs.engine.quantity import InvalidInput, check_choice
from ..envs.safety import consent
from .render.choices import Options, tell
from .store import typed

DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES)
"""What a disk says when it is full or closed."""

PIPE_CLOSED = 128 + 13
"""What a shell says of a program that wrote into a pipe without a reader."""

TRAINING = ("torch", "stable_baselines3", "sb3_contrib", "tensorboard")
"""Packages that only trainings need; policies run without."""

SAFE_PATH = "PYTHONSAFEPATH"
"""Tells Python not to look for modules in the folder in which it is started. Worker processes would, and run a json.py
that lies there."""

KINDS = {
    "environments": "",
    "scenarios": " [suite, its version; core: they make the suite's score]",
    "controllers": " [drives: z the head, xy the axes, process the cut; knows: sensor, preview or privileged]",
    "metrics": " [unit, 1: none; jobs: of parts that the whole machine cuts]",
}
"""What can be listed, and what stands in brackets behind each."""


def unset(metavar: str, *aliases: str) -> Any:
    """How an option without a value of its own is told: its text says what holds then."""
    return arg(metavar=metavar, aliases=aliases or None, help_behavior_hint="")


Whole = Annotated[int | None, unset("INT")]
Real = Annotated[float | None, unset("FLOAT")]
Text = Annotated[str | None, unset("STR")]
Millimetres = Annotated[float | None, unset("MM")]
On = Annotated[str | None, unset("NAME|FILE")]


def _agree(allowed: bool) -> None:
    """Lets files name Python code, here and in the processes that this one starts, until the command is over."""
    if allowed and not consent.given():
        os.environ[consent.VARIABLE] = "1"
        later = typed.AFTERWARDS.get()
        if later is not None:
            later.callback(os.environ.pop, consent.VARIABLE, None)


def list_(kind: Annotated[Positional[str], arg(metavar="KIND")] = "all") -> None:
    """Show environments, scenarios, controllers and metrics, a line each.

    Args:
        kind: one of environments, scenarios, controllers, metrics, or all.
    """
    check_choice(kind, (*KINDS, "all"), "kind")
    for each in KINDS if kind == "all" else (kind,):
        print(f"{each}:{KINDS[each]}")
        for name, line in _entries(each):
            print(f"  {name:28s} {line}")


def _entries(kind: str) -> list[tuple[str, str]]:
    if kind == "environments":
        return [
            ("kerfgym/HeightFollowing-v0", "move the head so that the nozzle keeps its height over the sheet, 1 kHz"),
            ("kerfgym/ContourFollowing-v0", "correct feed and axes along a contour, every 8 ms"),
            ("kerfgym/Cutting-v0", "set feed, power, dither, focus and standoff of a cut, every 8 ms"),
        ]
    if kind == "scenarios":
        from ..envs import scenarios

        lines: dict[str, str] = {}
        for group in scenarios.suites():
            rules = scenarios.rules(group)
            for name, s in scenarios.suite(group).items():
                core = ", core" if name in rules["core"] else ""
                whole = f"{group}/{name}" if name in lines else name  # as -s takes it
                lines[whole] = f"{s.summary} [{group} {rules['version']}{core}]"
        return list(lines.items())
    if kind == "controllers":
        from ..envs.control import stack

        found = [*map(stack.get, stack.names()), *map(stack.resolve, stack.shelved())]
        return [(s.name, f"{s.summary} [{s.slot}, {s.information}]") for s in found]
    from ..envs.figures import job_metrics, metrics

    return [(m.name, f"{m.summary} [{m.unit}, {m.better} is better]") for m in metrics.METRICS.values()] + [
        (m.name, f"{m.summary} [{m.unit}, {m.better} is better; jobs]") for m in job_metrics.METRICS.values()
    ]


def benchmark(
    controller: Annotated[UseAppendAction[list[str]], arg(aliases=["-c"], metavar="NAME")] = [],  # noqa: B006
    scenario: Annotated[UseAppendAction[list[str]], arg(aliases=["-s"], metavar="NAME|FILE")] = [],  # noqa: B006
    suite: Annotated[UseAppendAction[list[str]], arg(metavar="NAME|FOLDER")] = [],  # noqa: B006
    machine: On = None,
    shipped: bool = False,
    path: Annotated[Path | None, unset("FILE")] = None,
    drawing: OmitArgPrefixes[Options] = Options(),  # noqa: B008
    lead_in: Millimetres = None,
    kerf: Millimetres = None,
    joints: Whole = None,
    joint_spacing: Millimetres = None,
    joint_width: Millimetres = None,
    extrapolate: bool = False,
    seeds: Whole = None,
    split: str = "test",
    name: Text = None,
    jobs: int = 2,
    backend: str = "loky",
    scheduler: Annotated[str | None, unset("ADDRESS")] = None,
    ms: bool = True,
    cost: bool = True,
    blame: bool = True,
    detuned: bool = True,
    markdown: bool = False,
    allow_code: bool = False,
    overwrite: bool = False,
    resume: bool = False,
) -> None:
    """Compare controllers on scenarios; writes runs/<name>/ and prints the table.

    Args:
        controller: built-in name with overrides (pid:law.kp=80,filter.hold=4), or module:attr or file.py:attr of your
            own, or a team for jobs (z=pid,xy=wu,process=huang2024-dynamic); may be given several times. Of several
            suites it runs in those in which it has something to drive. Default: the suite's standard ones.
        scenario: name or TOML file; may be given several times. Default: the whole suite.
        suite: whose scenarios are run; may be given several times (following, contour, cutting, ood, repeated, or a
            folder of one's own), each is a table of its own. Default: that of the scenarios given, or following.
        machine: what cuts, in place of what the scenarios say of a machine: a preset (kerfgym machine list) or a file.
        shipped: compare all shipped controllers and policies of each suite's slot, besides those given; without
            --suite on following, contour and cutting.
        path: drawing or programme (DXF, SVG, G-code). In the suites contour and cutting it is the part that is cut; in
            following the nozzle travels its contours, on a wavy, tilted sheet unless --scenario says otherwise.
        drawing: how the drawing is read.
        lead_in: of jobs, longest way from the scrap into a contour; 0: pierced on the contour. Default: the scenario's.
        kerf: of jobs, the width of the cut: the path lies half of it beside the drawing, in the scrap.
        joints: of jobs, micro-joints that hold each part.
        joint_spacing: of jobs, mm from joint to joint.
        joint_width: of jobs, mm of sheet that a joint leaves. Default: 0.5.
        extrapolate: process settings may lie outside those that were published; such figures are marked and not ranked.
        seeds: how many seeds; each draws machine, sheet and noise. Default: what each suite says, 200 for followers, 20
            for jobs and drawings.
        split: which seeds: test, tune, or reserve, which nothing else uses.
        name: of the run folder. Default: date and time.
        jobs: worker processes.
        backend: loky (processes of this machine) or dask (a cluster of as many processes, or that of --scheduler); the
            figures are the same.
        scheduler: of a dask cluster, such as tcp://10.0.0.1:8786, whose workers have this kerfgym and these files.
        ms: measure the sensitivity peak Ms by injection, and the margins of gain and dead time.
        cost: time the controllers' decisions.
        blame: ask what each stage of the machine costs the reference and the best controller.
        detuned: ask how much worse the best shipped presets get when one of their parameters is 20 % off.
        markdown: print the summary as Markdown, for an issue, instead of the tables; it is also in summary.md.
        allow_code: run Python code that a file names, such as the controller of a tuned.toml; --controller itself may
            name any.
        overwrite: replace an existing run folder.
        resume: go on with a run that another command began. The same command goes on without this option.
    """
    _agree(allow_code)
    from .store import pool

    pool.check(backend, jobs, scheduler)  # before anything that takes time
    from .benchmark import benchmarking as bench
    from .measure import grids
    from .results import archive
    from .store import runs

    reading = drawing.reading()
    how = cut_as(lead_in, kerf, joints, joint_spacing, joint_width)
    planned = grids.plan(
        suite,
        controller,
        scenario,
        path=path,
        reading=reading,
        seeds=seeds,
        split=split,
        everything=shipped,
        extrapolate=extrapolate,
        cut_as=how,
        machine=loaded(machine),
    )
    if path is not None:
        tell(path, reading)
    for note in grids.planning(planned):
        typed.say(note)
    folder = runs.named(name, resume=resume)
    try:
        results = bench.run_grids(
            planned,
            folder,
            with_ms=ms,
            with_cost=cost,
            with_blame=blame,
            with_detuned=detuned,
            workers=jobs,
            backend=backend,
            scheduler=scheduler,
            overwrite=overwrite,
            resume=resume,
        )
    except KeyboardInterrupt:
        print(f"\nkerfgym: interrupted; {archive.resumption(folder)} goes on", file=sys.stderr)
        raise SystemExit(130) from None
    _show(folder, results, markdown)


def loaded(machine: str | None) -> Any:
    """The machine of a name or file; None if none was given."""
    if machine is None:
        return None
    from ..envs.scenarios import machines

    return machines.load(machine)


def cut_as(
    lead_in: float | None, kerf: float | None, joints: int | None, spacing: float | None, width: float | None
) -> dict[str, float]:
    """What was asked for, by the keys of a scenario's job."""
    keys = ("lead_in", "kerf", "joints", "joint_spacing", "joint_width")
    return {k: v for k, v in zip(keys, (lead_in, kerf, joints, spacing, width), strict=True) if v is not None}


def _show(folder: Path, grids: dict[str, Any], markdown: bool) -> None:
    """Prints the tables of a run, or its summary, and where the report is."""
    from .report import summary
    from .report.page import cut_by
    from .report.terminal import sheets

    if markdown:
        print((folder / summary.NAME).read_text(encoding="utf-8"))
        return
    for line in dict.fromkeys(cut_by(results) for results in grids.values() if results.meta.get("cut_by")):
        print(line)
    for suite, results in grids.items():
        for sheet in sheets(results):
            sheet.title = f"{suite} · {sheet.title}" if len(grids) > 1 else sheet.title
            sheet.show()
    print(f"\n{folder / 'report.html'}")


def report(
    run: Annotated[Positional[tuple[str, ...]], arg(metavar="RUN ...")] = (),
    name: Text = None,
    markdown: bool = False,
    overwrite: bool = False,
) -> None:
    """Make a stored run's report again, or one report of several runs.

    Of several runs it compares the scenarios and seeds that all of them have. A controller that is not the same in two
    of them, such as two versions of yours, is there twice, as name@run.

    Args:
        run: folders of benchmarks, or their names in runs/.
        name: of the folder for the report with all tables. Default: of one run its own, of several report- and date and
            time.
        markdown: print the summary as Markdown, for an issue, instead of the tables; it is also in summary.md.
        overwrite: replace an existing run folder.
    """
    from .report.remake import remake, tell
    from .store import runs

    folder, found = remake(run, runs.named(name, "report-") if name or len(run) > 1 else None, overwrite)
    tell(found)
    _show(folder, found.grids, markdown)


def blame(
    controller: Annotated[UseAppendAction[list[str]], arg(aliases=["-c"], metavar="NAME")] = [],  # noqa: B006
    scenario: Annotated[UseAppendAction[list[str]], arg(aliases=["-s"], metavar="NAME|FILE")] = [],  # noqa: B006
    machine: On = None,
    stage: Annotated[UseAppendAction[list[str]], arg(metavar="STAGE")] = [],  # noqa: B006
    seeds: Whole = None,
    split: str = "test",
    name: Text = None,
    threads: int = 2,
    allow_code: bool = False,
    overwrite: bool = False,
    resume: bool = False,
) -> None:
    """What each stage of the machine costs a controller, and what a better controller could gain; writes runs/<name>/.

    Args:
        controller: as for benchmark; may be given several times. Default: xi2023-tuned and observer, for jobs wu-tuned.
        scenario: name or TOML file; may be given several times. Default: the core of the suite following.
        machine: what cuts, in place of what the scenarios say of a machine: a preset (kerfgym machine list) or a file.
        stage: sensor, table, filter, servo, "dead time"; in jobs also matching, axes; several times. Default: all.
        seeds: how many seeds; each draws machine, sheet and noise. Default: 24, for jobs 8.
        split: which seeds: test, tune, or reserve, which nothing else uses.
        name: of the run folder. Default: blame- and date and time.
        threads: worker threads.
        allow_code: run Python code that a file names, such as the controller of a tuned.toml; --controller itself may
            name any.
        overwrite: replace an existing run folder.
        resume: go on with a run that another command began. The same command goes on without this option.
    """
    _agree(allow_code)
    from ..envs import scenarios
    from ..envs.scenarios import machines
    from .blame import blame as run
    from .measure.grids import Grid, split_seeds
    from .report.terminal import print_blame
    from .store import runs
    from .store.progress import progress

    chosen = tuple(scenarios.load(s) for s in scenario or scenarios.core("following"))
    cuts: Any = loaded(machine)
    lost: tuple[str, ...] = ()
    if cuts:
        lost = tuple(machines.warnings(chosen, cuts))
        chosen = tuple(machines.put_on(s, cuts) for s in chosen)
        for note in lost:
            typed.say(note)
    jobs = any(s.job for s in chosen)
    wanted = split_seeds(seeds if seeds is not None else (8 if jobs else 24), split)
    who = tuple(controller or (["wu-tuned"] if jobs else ["xi2023-tuned", "observer"]))
    grid = Grid("blame", who, chosen, wanted, machine=cuts, given_up=lost)
    folder = runs.named(name, "blame-", resume)
    with progress("episodes") as told:
        tables = run(grid, folder, stage, threads, overwrite, resume, told)
    print_blame(*tables)
    print(f"\n{folder / 'blame.png'}")


def render(
    out: Annotated[Positional[Path], arg(metavar="OUT")],
    controller: Annotated[str, arg(aliases=["-c"])] = "pid",
    scenario: Annotated[str | None, unset("NAME|FILE", "-s")] = None,
    machine: On = None,
    seed: int = 1000,
    seconds: Real = None,
    slow: Real = None,
    path: Annotated[Path | None, unset("FILE")] = None,
    drawing: OmitArgPrefixes[Options] = Options(),  # noqa: B008
    colour: str = "standoff",
    allow_code: bool = False,
    plan: Annotated[str | None, unset("FILE|PART")] = None,
    lead_in: Millimetres = None,
    kerf: Millimetres = None,
    joints: Whole = None,
    joint_spacing: Millimetres = None,
    joint_width: Millimetres = None,
    explain: Annotated[str | None, unset("POLICY")] = None,
) -> None:
    """Write one episode as MP4 or GIF, or its last moment as PNG; or a job's plan; or what a policy does differently.

    Args:
        out: file to write; .mp4, .gif or .png.
        controller: as for benchmark.
        scenario: name or TOML file. Default: wavy; with --explain a step, a wave and a hole.
        machine: what cuts, in place of what the scenarios say of a machine: a preset (kerfgym machine list) or a file.
        seed: scenario seed.
        seconds: of the episode to show. Default: all of it.
        slow: how many times slower than real. Default: 10, of jobs 0.2, which is five times faster.
        path: drawing or programme that is cut or travelled instead of the scenario's path.
        drawing: how the drawing is read.
        colour: of a job's kerf: standoff, contour, dross or roughness.
        allow_code: run Python code that a file names, such as the controller of a tuned.toml; --controller itself may
            name any.
        plan: drawing, programme or built-in part whose plan is drawn instead: contours, pierce points, lead-ins, order,
            rapids, joints, warnings; with --scenario as that would cut it.
        lead_in: of jobs, longest way from the scrap into a contour; 0: pierced on the contour. Default: the scenario's.
        kerf: of jobs, the width of the cut: the path lies half of it beside the drawing, in the scrap.
        joints: of jobs, micro-joints that hold each part.
        joint_spacing: of jobs, mm from joint to joint.
        joint_width: of jobs, mm of sheet that a joint leaves. Default: 0.5.
        explain: policy of a height follower whose actions over time are drawn instead, with what they add to the
            command, the sheet, and the error beside that of its base.
    """
    _agree(allow_code)
    if explain is not None:
        from .render.explained_picture import paint as paint_actions

        for note in paint_actions(out, explain, (scenario,) if scenario else (), seed, loaded(machine)):
            typed.say(f"{explain}: {note}")
        print(out)
        return
    scenario = scenario or "wavy"
    how = cut_as(lead_in, kerf, joints, joint_spacing, joint_width)
    if plan is not None:
        from .render.plans import paint

        for note in paint(out, plan, scenario, how, drawing.reading(), loaded(machine)):
            typed.say(f"{plan}: {note}")
        print(out)
        return
    from .render.episode import film

    film(out, controller, scenario, seed, seconds, slow, path, colour, drawing.reading(), how, loaded(machine))
    if path is not None:
        tell(path, drawing.reading())
    print(out)


def reproduce(
    names: Annotated[Positional[tuple[str, ...]], arg(metavar="DOCUMENT[/STUDY]")] = (),
    seeds: int = 24,
    name: Text = None,
    jobs: int = 2,
    overwrite: bool = False,
    resume: bool = False,
) -> None:
    """Every number and claim of the five documents beside the simulation; writes runs/<name>/reproduce.html.

    Args:
        names: documents (xi2023, wu, huang2024, cn102528288a, patent2022) or studies of them (xi2023/table-1).
            Default: all.
        seeds: independent runs of whatever is random.
        name: of the run folder. Default: reproduce- and date and time.
        jobs: worker processes.
        overwrite: replace an existing run folder.
        resume: go on with a run that another command began. The same command goes on without this option.
    """
    from .reproduce import claims_page
    from .reproduce.carry_out import reproduce as run
    from .store import runs
    from .store.progress import progress

    folder = runs.named(name, "reproduce-", resume)
    with progress("studies") as told:
        parts = run(names, folder, seeds, jobs, overwrite, resume, told)
    claims_page.show(parts)
    print(f"\n{folder / 'reproduce.html'}")
    failed = [part["study"] for part in parts if part["error"]]
    if failed:
        _refuse(f"failed: {', '.join(failed)}; see {folder / 'parts'}", 1)


def tune(
    what: Annotated[Positional[tuple[str, ...]], unset("WHAT")] = (),
    controller: Annotated[str | None, unset("NAME", "-c")] = None,
    study: Annotated[str | None, unset("NAME|FILE")] = None,
    suite: Annotated[str | None, unset("NAME|FOLDER")] = None,
    scenario: Annotated[UseAppendAction[list[str]], arg(aliases=["-s"], metavar="NAME|FILE")] = [],  # noqa: B006
    machine: On = None,
    trials: Whole = None,
    budget: Annotated[str | None, unset("STEPS|NAME")] = None,
    sampler: Text = None,
    gradient: bool = False,
    metric: Annotated[UseAppendAction[list[str]], arg(aliases=["-m"], metavar="METRIC")] = [],  # noqa: B006
    ms: Real = None,
    jitter: Real = None,
    overshoot: Real = None,
    limit: Annotated[UseAppendAction[list[str]], arg(metavar="METRIC=MOST")] = [],  # noqa: B006
    seed: int = 0,
    seeds: Whole = None,
    workers: int = 1,
    threads: Whole = None,
    env: Text = None,
    steps: Whole = None,
    set_: Annotated[UseAppendAction[list[str]], arg(name="set", metavar="KEY=VALUE")] = [],  # noqa: B006
    storage: Annotated[str | None, unset("URL")] = None,
    extrapolate: bool = False,
    name: Text = None,
    allow_code: bool = False,
    overwrite: bool = False,
    resume: bool = False,
) -> None:
    """Search a controller's parameters on tune seeds; writes runs/<name>/tuned.toml, which every command takes with -c,
    and the page tuned.html: what to set, and what it is worth.

    With the name of an algorithm it searches the settings of a training; writes runs/<name>/<algorithm>.toml, which
    train takes with --preset.

    With --study it makes all the searches that a study file asks for; writes runs/<name>/searches.csv and a folder for
    each, and the presets if the file says where.

    Args:
        what: a group of parameters (gate, filter, table, law, guard; plan; read, those that the kind of the filter
            reads; all), or parameters by name, with a range or without (law.kp filter.window=3..9); several may be
            given. Default: law. Or an algorithm: ppo, sac, td3, tqc, recurrent-ppo, gradient. With --study some of its
            searches.
        controller: as for benchmark. Default: xi2023-improved; for jobs wu-tuned or huang2024-adjusting.
        study: a study file, or the name of a shipped one. It says how to search: of the options only --trials,
            --workers, --threads, --name, --allow-code, --overwrite and --resume go with it.
        suite: the suite, or folder of one's own, whose core scenarios make the score. In its scenarios with a guard no
            candidate may collide. Of an algorithm, what it is trained in. Default: following, of an algorithm the
            preset's.
        scenario: name or TOML file, in place of a whole suite; may be given several times.
        machine: what cuts, in place of what the scenarios say of a machine: a preset (kerfgym machine list) or a file.
        trials: candidates in all. Default: 300, of an algorithm's settings 40.
        budget: simulated steps after which the search ends; or the name of a controller, for as many steps as that was
            tuned and trained with, so that both can be compared. Steps that tuned --controller before count, too.
        sampler: tpe+cmaes (TPE explores, CMA-ES finishes), tpe, cmaes, gp, random or nsga2. Default: tpe+cmaes, for
            several metrics and for an algorithm's settings tpe.
        gradient: TPE explores, and from the best that it finds a minimiser goes down along exact slopes of score and Ms
            through the known machine. For rms_true and followers whose law has a derivative. A trial with slopes counts
            its steps once more for each parameter.
        metric: what is made best; several give a Pareto front. Default: rms_true, for jobs the suite's own.
        ms: largest sensitivity peak Ms that is allowed; inf: any. Default: 2, for jobs any.
        jitter: largest command jitter that is allowed, mm/s per ms. Default: any.
        overshoot: largest overshoot of a descent that is allowed, mm. Default: any.
        limit: largest value of a metric that is allowed (smallest, if higher is better), such as time=12.5.
        seed: of the sampler, and of trainings; the same command gives the same study.
        seeds: tune seeds per scenario. Default: 32, for jobs 8.
        workers: processes that share the search. Several finish in another order each time, so the result may differ.
            With --study: searches at a time; how many changes no figure.
        threads: of each process. Default: each process gets its share of the cores, a training 1.
        env: of trainings, id of the environment. Default: kerfgym/HeightFollowing-v0.
        steps: of each training. Default: a tenth of the preset's, at least an episode of each machine.
        set_: of trainings, a value of the preset, as for train. A setting that is searched begins there, another one
            keeps it. May be given several times.
        storage: database that keeps the study, so that many machines share it; postgresql://user@host/database.
            Default: a journal in the run folder.
        extrapolate: process settings may lie outside those that were published; the result says so.
        name: of the run folder and of the study. Default: tune- and date and time.
        allow_code: run Python code that a file names, such as the controller of a tuned.toml; --controller itself may
            name any.
        overwrite: replace an existing run folder.
        resume: go on with a run that another command began. The same command goes on without this option.
    """
    _agree(allow_code)
    from .store import runs
    from .store.progress import progress
    from .tune import command, controllers
    from .tune.space import unread

    folder = runs.named(name, "tune-", resume)
    for_controllers: dict[str, Any] = {"controller": controller, "suite": suite}
    for_controllers |= {"metric": metric or None, "ms": ms, "jitter": jitter, "overshoot": overshoot}
    for_controllers |= {"limit": limit or None, "seeds": seeds, "budget": budget, "extrapolate": extrapolate or None}
    for_controllers |= {"gradient": gradient or None}
    cuts = loaded(machine)
    if study is not None:
        from .tune import searches, study_file

        others: dict[str, Any] = {"sampler": sampler, "seed": seed or None, "env": env, "steps": steps}
        others |= {"set": set_ or None, "storage": storage, "scenario": scenario or None, "machine": machine}
        if given := [option for option, value in (for_controllers | others).items() if value is not None]:
            raise InvalidInput(f"--{given[0]} is not given beside --study; the study file says it")
        planned = study_file.read(study, what, trials)
        with progress("trials") as told:
            found = searches.carry_out(planned, folder, workers, threads, overwrite, resume, told)
        searches.show(found)
        print(f"\n{folder / 'searches.csv'}")
        if len(found) < len(planned.searches):
            raise SystemExit(1)
        return
    run: Any = controllers.tune
    if command.trains(what, env, steps, set_):
        from .train.training import trained_in
        from .tune import learners

        more = trained_in([suite] if suite else [], scenario, cuts)
        for_controllers["suite"] = None
        run, given = learners.tune, [option for option, value in for_controllers.items() if value is not None]
        task: Any = learners.task(what, env, steps, set_, trials, sampler, seed, storage, name, threads, given, more)
    else:
        task = command.task(what, trials, sampler, seed, storage, name, **for_controllers, named=scenario, machine=cuts)
        for note in unread(task.space, task.base.parameters()):
            typed.say(f"warning: {note}")
        if cuts:
            from ..envs.scenarios import machines
            from .tune.evaluate import chosen

            for note in machines.warnings(chosen(task.suite, task.named)[0], cuts):
                typed.say(note)
    with progress("trials") as told:
        result = run(task, folder, workers, threads, overwrite, resume, told)
    result.show()
    print("", *result.files, sep="\n")


def train(
    algorithm: Annotated[Positional[str], arg(metavar="ALGORITHM")],
    env: Text = None,
    steps: Whole = None,
    seed: int = 0,
    seeds: int = 1,
    test_seeds: int = 24,
    jobs: int = 2,
    preset: Annotated[Path | None, unset("FILE")] = None,
    set_: Annotated[UseAppendAction[list[str]], arg(name="set", metavar="KEY=VALUE")] = [],  # noqa: B006
    suite: Annotated[UseAppendAction[list[str]], arg(metavar="NAME|FOLDER")] = [],  # noqa: B006
    scenario: Annotated[UseAppendAction[list[str]], arg(aliases=["-s"], metavar="NAME|FILE")] = [],  # noqa: B006
    machine: On = None,
    name: Text = None,
    device: str = "cpu",
    threads: int = 1,
    ms: bool = True,
    allow_code: bool = False,
    overwrite: bool = False,
    resume: bool = False,
) -> None:
    """Train a policy; writes runs/<name>/ with curves, evaluations, the last checkpoint and the best policy.

    Args:
        algorithm: ppo, sac, td3, tqc, recurrent-ppo or gradient.
        env: id of the environment. Default: the preset's, or kerfgym/HeightFollowing-v0.
        steps: simulated steps of training. Default: the preset's.
        seed: of everything random.
        seeds: trainings, with the seeds from --seed on; runs/<name>/ then holds a folder for each, and a summary.
        test_seeds: of each scenario by which the training is evaluated, on which the policy is compared with its base
            and the best classical controller at the end; 0: it is not.
        jobs: trainings at a time.
        preset: settings to train with, such as tune ppo writes, or the settings.toml of another training. Default: the
            shipped ones of environment and algorithm.
        set_: a value of the preset, by dotted name (algorithm.gamma=0.97, environment.scenario=["wavy","step"],
            environment.reward.rate=0.1); may be given several times.
        suite: a suite, or a folder of one's own, whose scenarios are trained in; may be given several times. Default:
            the preset's scenarios.
        scenario: name or TOML file that is trained in; may be given several times.
        machine: what cuts, in place of what the scenarios say of a machine: a preset (kerfgym machine list) or a file.
        name: of the run folder. Default: environment, algorithm and seed.
        device: of torch: cpu, cuda, cuda:1.
        threads: of torch; more than one seldom helps such small networks.
        ms: measure the height follower's sensitivity peak Ms by injection.
        allow_code: run Python code that the preset names as base controller; --set may name any.
        overwrite: replace an existing run folder.
        resume: go on with a run that another command began. The same command goes on without this option.
    """
    _agree(allow_code)
    from .train.training import train as run
    from .train.training import trained_in

    more = trained_in(suite, scenario, loaded(machine))
    given = [*(("--suite", each) for each in suite), *(("-s", each) for each in scenario)]
    given += [("--machine", machine)] if machine else []
    where = [word for pair in given for word in pair]
    folder = run(
        algorithm, env, steps, seed, set_, name, device, threads, ms, overwrite, resume, preset, seeds, test_seeds,
        jobs, more, where,
    )  # fmt: skip
    print(f"\n{folder}")


def speed(
    rounds: int = 5,
    machine: On = None,
    name: Text = None,
    train: bool = True,
    torch_threads: int = 1,
    overwrite: bool = False,
) -> None:
    """Measure the machine's speed as ratios within one process; writes runs/<name>/ and prints the tables.

    Args:
        rounds: interleaved rounds; medians and ranges are over them.
        machine: what the roll-outs and environments of followers simulate: a preset or a file. Default: standard.
        name: of the run folder. Default: speed- and date and time.
        train: also time a short PPO training.
        torch_threads: threads that torch may use in it.
        overwrite: replace an existing run folder.
    """
    from .report.terminal import print_speed
    from .speed.proof import NothingDone
    from .speed.timing import speed as measure
    from .store import runs
    from .store.progress import status

    for what, value in (("--rounds", rounds), ("--torch-threads", torch_threads)):
        if value < 1:
            raise InvalidInput(f"{what} {value} is out of range; at least 1")
    folder = runs.named(name, "speed-")
    runs.open_folder(folder, overwrite)
    try:
        with status() as progress:
            tables = measure(folder, rounds, train, torch_threads, progress, loaded(machine))
    except NothingDone as error:
        raise SystemExit(f"kerfgym: error: {error}") from None
    print_speed(tables)
    print(f"\n{folder}")


def machine(
    action: Annotated[Positional[str], arg(metavar="ACTION")],
    what: Annotated[Positional[tuple[str, ...]], arg(metavar="NAME|FILE ...")] = (),
    like: str = "standard",
    set_: Annotated[UseAppendAction[list[str]], arg(name="set", metavar="KEY=VALUE")] = [],  # noqa: B006
    seed: int = 0,
    overwrite: bool = False,
) -> None:
    """Machines as files: what cuts, for --machine of every command and machine= of every environment.

    list shows the presets. new FILE writes a machine with every number, its unit and its range, to be changed in an
    editor or with --set. draw FILE writes the one machine that --seed draws from one with distributions, every number
    fixed. show NAME|FILE tells what differs from the standard machine. check FILE ... tells what is wrong in files, or
    what is hardly meant.

    Args:
        action: list, new, draw, show or check.
        what: of new and draw the file to write, of show and check machines: names of presets, or files.
        like: of new, the machine to begin with; of draw, the one with distributions.
        set_: of new, a number that differs, such as axis.bandwidth=25 or head.bore=1.5; may be given several times.
        seed: of draw, which machine.
        overwrite: of new and draw, replace an existing file.
    """
    from .machine import machine_files

    machine_files.ACTIONS.get(action, machine_files.unknown(action))(what, like, set_, overwrite, seed)


def record(
    machine: Annotated[str, arg(metavar="NAME|FILE")] = "standard",
    protocol: Annotated[str, arg(metavar="PROTOCOL")] = "motion",
    scenario: Annotated[str | None, unset("NAME|FILE", "-s")] = None,
    out: Annotated[Text, arg(aliases=("-o",))] = None,
    seed: int = 0,
    overwrite: bool = False,
) -> None:
    """A log of a simulated machine, as a real one would record it; for trying kerfgym identify.

    Args:
        machine: what is recorded: a preset (kerfgym machine list) or a file.
        protocol: rest, sweep, motion, follow or square.
        scenario: of follow, whose sheet, feed and set height it has: a name or a TOML file. Default: wavy.
        out: the log, CSV or Parquet by its ending. Default: PROTOCOL.csv.
        seed: draws the machine, where it has distributions, and its noise.
        overwrite: replace an existing file.
    """
    from .identify.log import write
    from .identify.protocols import record as recorded

    target = Path(out or f"{protocol}.csv")
    if target.suffix not in (".csv", ".parquet"):
        raise InvalidInput(f"-o takes a .csv or .parquet file, not {target}")
    if target.exists() and not overwrite:
        raise InvalidInput(f"'{target}' exists; --overwrite replaces it")
    made = recorded(machine, protocol, seed, scenario)
    write(made, target)
    print(*made.warnings, target, sep="\n")


def export(
    controller: Annotated[str | None, unset("NAME", "-c")] = None,
    out: Annotated[Text, arg(aliases=("-o",))] = None,
    float_: Annotated[bool, arg(name="float")] = False,
    check: Annotated[str | None, unset("FOLDER")] = None,
    overwrite: bool = False,
) -> None:
    """A height follower as C code: filter, table look-up, law and supervisor, with test vectors and a README.

    The folder is itself a controller: -c FOLDER has its C decide inside the simulator.

    Args:
        controller: as for benchmark, such as pid or runs/x/tuned.toml.
        out: the folder. Default: the controller's name.
        float_: single precision.
        check: in place of exporting, compile an exported folder's own test with gcc and clang, run it, and compare the
            C in the loop with the controller that it was made of: score, Ms and margins. Where gcc-arm-none-eabi and
            QEMU are installed, it runs on an emulated Cortex-M4F and M7, too.
        overwrite: replace an exported folder.
    """
    from .export import exporting, in_loop, processor

    if (check is None) == (controller is None):
        raise InvalidInput("give one of --controller NAME, which is exported, and --check FOLDER")
    if check is not None:
        print(*exporting.check(Path(check)), sep="\n")
        print(*in_loop.told(Path(check)), *processor.told(Path(check)), sep="\n")
        return
    assert controller
    print(exporting.write(controller, Path(out or Path(controller).stem), float_, overwrite))


def identify(
    log: Annotated[Positional[tuple[str, ...]], arg(metavar="LOG ...")],
    out: Annotated[str, arg(aliases=("-o",))] = "mine.toml",
    like: str = "standard",
    check: str | None = None,
    controller: str = "xi2023-improved",
    overwrite: bool = False,
) -> None:
    """A machine's file from its logs; every number that they tell is a distribution, so --machine draws from it.

    Args:
        log: logs of the protocols rest, sweep, motion, square and follow, one of each (docs/identification.md).
        out: the machine's file. Beside it lie the sweep's table, of follow the sheet as .sheet.toml and .sheets.toml,
            and a page that says whether the model explains the logs.
        like: the machine that holds where the logs say nothing.
        check: a follow log that is not used; the page compares its following error with the predicted one.
        controller: what followed there, and in the page's forecasts.
        overwrite: replace an existing file.
    """
    from .identify.with_page import command

    command(log, out, like, overwrite, check, controller)


ABOUT = """Testbed for laser-cutting machine control. Everything is simulated; nothing is validated on a machine.

kerfgym list shows what there is, kerfgym COMMAND --help every option of a command."""

_ALL = (list_, benchmark, report, blame, tune, train, reproduce, render, speed, machine, record, identify, export)
COMMANDS: dict[str, Any] = {command.__name__.removesuffix("_"): command for command in _ALL}
"""Every command by its name."""

for _each in COMMANDS.values():  # the terminal decides where lines of help end, not this file
    _each.__doc__ = re.sub(r"(?<=\S)\n {12}(?=\S)", " ", _each.__doc__ or "")


def main(arguments: list[str] | None = None) -> None:
    """Entry point of the command."""
    words = sys.argv[1:] if arguments is None else arguments
    if words == ["--version"]:
        print(f"kerfgym {__version__}")
        return
    before, closing = typed.TYPED.set(("kerfgym", *words)), contextlib.ExitStack()
    after = typed.AFTERWARDS.set(closing)
    if arguments is None:  # a process of its own: its runs are over when it is, at the very last
        atexit.register(closing.close)
    closing.callback(_alone, os.environ.get(SAFE_PATH))
    os.environ[SAFE_PATH] = "1"
    try:
        tyro.extras.subcommand_cli_from_dict(COMMANDS, prog="kerfgym", description=ABOUT, args=words)
        sys.stdout.flush()
    except InvalidInput as error:
        _refuse(typed.told(error))
    except MemoryError:
        _refuse("not enough memory for this; what is finished is kept")
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in TRAINING:
            raise
        _refuse(f"this needs the package '{error.name}', which is not installed: pip install 'kerfgym[train]'")
    except OSError as error:
        if isinstance(error, BrokenPipeError) and _unread():
            raise SystemExit(PIPE_CLOSED) from None
        if error.errno not in DISK:
            raise
        where = f"'{error.filename}'" if error.filename else "a file of the run"
        said = os.strerror(error.errno)
        _refuse(f"cannot write {where}: {said}; what is finished is kept, and the same command goes on")
    except KeyboardInterrupt:
        print("\nkerfgym: interrupted; the same command goes on", file=sys.stderr)
        raise SystemExit(130) from None
    finally:
        typed.TYPED.reset(before)
        typed.AFTERWARDS.reset(after)
        if arguments is not None:
            closing.close()


def _refuse(why: str, code: int = 2) -> NoReturn:
    """Ends the command with an error."""
    print(f"kerfgym: error: {why}", file=sys.stderr)
    raise SystemExit(code) from None


def _alone(before: str | None) -> None:
    """Lets processes that are started from now on look for modules where they did."""
    if before is None:
        os.environ.pop(SAFE_PATH, None)
    else:
        os.environ[SAFE_PATH] = before


def _unread() -> bool:
    """Whether nobody reads what is printed any more, as behind ``| head -1``; then nothing more is."""
    try:
        ends = select.poll()
        ends.register(sys.stdout.fileno(), 0)
        closed = any(event & select.POLLERR for _, event in ends.poll(0))
    except (OSError, ValueError):  # it is no file
        return False
    if closed:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return closed


if __name__ == "__main__":
    main()
