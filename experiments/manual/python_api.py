"""The page of the Python interface: what a user imports, each with its signature and its docstring.

:data:`PUBLIC` names it; everything else may change without a word. A name that is gone is an error, so the page cannot
tell of what there is not.
"""

import functools
import importlib
import inspect
import re
from collections.abc import Callable
from typing import Any

from ...envs.engine.quantity import InvalidInput, did_you_mean

PUBLIC: dict[str, tuple[str, dict[str, tuple[str, ...]]]] = {
    "Scenarios": (
        "Names, files and changes of scenarios. [Add a scenario](add-a-scenario.md) has the files' keys.",
        {
            "envs.scenarios": (
                "load", "read", "parse", "suite", "core", "suites", "Scenario.varied", "Scenario.along",
                "Scenario.to_toml",
            ),
            "envs.scenarios.machines": ("Machine", "load", "presets", "put_on", "given_up"),
        },
    ),
    "Controllers": (
        "A *stack* is a controller with its filter and limits, a *team* one stack for each slot of a machine that does "
        "jobs. [Controllers](controllers.md) explains both.",
        {
            "envs.control.stack": (
                "resolve", "team", "names", "register", "Stack", "Stack.parameters", "Stack.varied", "Team",
                "PythonController",
            ),
            "envs.engine.quantity": ("Quantity", "InvalidInput"),
            "envs.engine.lanes": ("part",),
            "envs.plant.controller": ("Weight",),
        },
    ),
    "Roll-outs and figures": (
        "Simulate without an environment, and measure. [Add a metric](add-a-metric.md) lists the metrics.",
        {
            "experiments.measure.rollout": ("roll",),
            "experiments.measure.slopes": ("Slopes",),
            "envs.figures.recording": ("Recording", "Recording.error", "Recording.reported_error", "Recording.scored"),
            "envs.figures.metrics": ("metric", "evaluate"),
            "envs.figures.job_metrics": ("Jobs", "metric"), "envs.figures.registered": ("Shown", "Called"),
        },
    ),
    "Stored runs": (
        "What a benchmark left behind. [Runs and reports](runs.md) tells the files, [Statistics](statistics.md) the "
        "figures.",
        {
            "experiments.results.archive": ("load", "Archive"),
            "experiments.statistics.intervals": (
                "iqm", "cvar", "wilson", "probability_of_improvement", "performance_profile",
            ),
        },
    ),
    "Learning": (
        "`gymnasium.make` and `gymnasium.make_vec` make environments; [Environments](environments.md) has them. "
        "stable-baselines3 takes these instead, and policies are files. [Training](training.md) explains the rest.",
        {
            "agents.vec_env": (
                "KernelVecEnv", "HeightFollowingVecEnv", "ContourFollowingVecEnv", "CuttingVecEnv",
            ),
            "agents.policy": ("Policy.load", "Policy.act", "Policy.save", "Range"),
            "agents.export": ("export",),
            "envs.engine.adjoint": ("adjoint",),
            "envs.plant.z_axis": ("Params", "Drive", "accept"),
            "envs.plant.derivatives": ("Rollout", "Rollout.put_recorded", "Rollout.forward", "Rollout.backward"),
        },
    ),
    "Your machine": (
        "[Identification](identification.md#a-controller-on-your-machine) shows a controller on a machine that is not "
        "kerfgym's.",
        {"experiments.identify.outside": ("Outside", "Outside.begin", "Outside.step", "Outside.signal")},
    ),
    "Drawings and the operator's panel": (
        "[Drawings](drawings.md) says what is cut of a file, [Reproduction](reproduction.md#the-operators-panel) shows "
        "the panel at work.",
        {
            "envs.paths.read": ("read",),
            "envs.paths.gcode": ("read_gcode",),
            "envs.control.panel": (
                "Panel", "Panel.home", "Panel.calibrate", "Panel.follow", "Panel.move", "Panel.centre", "Panel.protect",
                "Panel.stop", "Panel.break_", "Panel.wait", "Panel.log",
            ),
            "baselines.sequences": ("frog_leap", "lift_travel_land", "staged_pierce", "find_edge"),
        },
    ),
}  # fmt: skip
"""What users may rely on: headings, a word about each, and names by module below ``kerfgym``."""

LONGEST_DEFAULT = 30
"""Characters of a default; a longer one is told as …"""


def page(markdown: Callable[[str], str]) -> str:
    """Sections of the page; ``markdown`` turns a docstring into it."""
    text = []
    for heading, (about, modules) in PUBLIC.items():
        text += [f"## {heading}", about]
        for name, names in modules.items():
            text += [entry(f"kerfgym.{name}", each, markdown) for each in names]
    return "\n\n".join(text)


def entry(module: str, name: str, markdown: Callable[[str], str]) -> str:
    """A function, class or method: where it is, how it is called, what it says of itself.

    Raises:
        InvalidInput: there is no such name; the nearest is offered.
    """
    thing: Any = importlib.import_module(module)
    for part in name.split("."):
        if not hasattr(thing, part):
            raise InvalidInput(f"{module} has no '{name}'; {did_you_mean(part, dir(thing))}")
        thing = inspect.getattr_static(thing, part) if inspect.isclass(thing) else getattr(thing, part)
        thing = thing.__func__ if isinstance(thing, staticmethod | classmethod) else thing
    is_value = isinstance(thing, property | functools.cached_property) or _is_error(thing)
    called = name if is_value else f"{name}({_arguments(thing)})"
    about = inspect.getdoc(thing) or ""
    return f"**`{called}`** in `{module}`\n\n{listed(markdown(about))}"


def _is_error(thing: Any) -> bool:
    return inspect.isclass(thing) and issubclass(thing, BaseException)


def _arguments(thing: Any) -> str:
    """Names of arguments with their defaults, without types; those of a protocol are not told."""
    if getattr(thing, "_is_protocol", False):
        return ""
    out: list[str] = []
    for each in inspect.signature(thing).parameters.values():
        if each.name in ("self", "cls"):
            continue
        star = "*" if each.kind == each.VAR_POSITIONAL else "**" if each.kind == each.VAR_KEYWORD else ""
        if each.kind == each.KEYWORD_ONLY and not any(word.startswith("*") for word in out):
            out.append("*")
        default = "" if each.default is each.empty else repr(each.default)
        default = "…" if len(default) > LONGEST_DEFAULT or default.startswith("<") else default
        out.append(f"{star}{each.name}" + (f"={default}" if default else ""))
    return ", ".join(out)


def listed(text: str) -> str:
    """Sections of a docstring (Args, Returns, Raises …) as lists."""
    out: list[str] = []
    inside = False
    for line in text.split("\n"):
        if found := re.fullmatch(r"(Args|Returns|Raises|Attributes):", line.strip()):
            out += [f"*{found[1]}*", ""]
            inside = True
        elif inside and re.match(r"    \S", line):
            head, colon, rest = line.strip().partition(": ")
            out.append(f"- `{head}`: {rest}" if colon else f"- {line.strip()}")
        elif inside and line.startswith("     "):
            out.append(f"  {line.strip()}")
        else:
            inside = inside and not line.strip()
            out.append(line)
    return "\n".join(out).strip()
