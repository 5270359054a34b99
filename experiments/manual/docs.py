"""README and manual, as far as they are made: ``python -m kerfgym.experiments.manual.docs`` writes what has changed.

The machine's page holds the text at the head of each part and its parameters; the environments' page their docstrings.
Other pages are written by hand; a script fills in their tables, between two marks::

    <!-- made: controllers -->
    …
    <!-- end -->

Tables come from the code or, where a run made the numbers, from stored results (:mod:`studies`); so do single numbers
in a sentence (:mod:`studies.marks`). A test fails when a page is older than what it is made from.
"""

import ast
import importlib
import inspect
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from types import ModuleType
from typing import Any, get_args, get_origin

import gymnasium

from ... import baselines
from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.engine.lanes import is_part
from ...envs.engine.quantity import InvalidInput, Quantity, quantities
from ...envs.figures import evidence, job_metrics, metrics
from ...envs.plant import controller, sensor
from ..bounds import stored
from ..reproduce.verdicts import VERDICTS
from ..results.conclusions import REFERENCE
from ..statistics import budgets
from ..store.markdown import as_code, row, table
from ..store.runs import write_text
from ..store.stamp import ROOT
from ..studies import marks
from ..tune import study_file
from . import assumptions, command_line, python_api, references, tables

FOLDER, README = ROOT / "docs", ROOT / "README.md"

SIGNAL_CHAIN = (
    "path", "sheet", "sensor", "filters", "calibration", "controller", "supervisor", "z_axis", "xy_axes", "planning",
    "gantry", "spot", "cut", "published", "machine",
)  # fmt: skip
"""Parts of the machine, in the order of the signal."""

# ------------------------------------------------------------------------------------------------------ from docstrings


def markdown(text: str) -> str:
    """A docstring's reStructuredText as Markdown: roles and literals, blocks of code, tables of equals signs."""
    out: list[str] = []
    lines = inspect.cleandoc(text).split("\n")
    at = 0
    while at < len(lines):
        line = lines[at]
        if line.rstrip().endswith("::"):
            head = line.rstrip()[:-1] if line.strip() != "::" else ""
            block, at = _indented(lines, at + 1)
            out += [*([_inline(head)] if head else []), "", "```text", *block, "```", ""]
            continue
        if re.fullmatch(r"=+(\s+=+)+\s*", line):
            end = at + 1 + [bool(re.fullmatch(r"=+(\s+=+)+\s*", each)) for each in lines[at + 1 :]].index(True)
            after = [bool(re.fullmatch(r"=+(\s+=+)+\s*", each)) for each in lines[end + 1 :]]
            end = end + 1 + after.index(True) if True in after else end
            out += _table(lines[at : end + 1])
            at = end + 1
            continue
        out.append(_inline(line))
        at += 1
    return re.sub(r"\n{3,}", "\n\n", "\n".join(out)).strip() + "\n"


def _indented(lines: list[str], at: int) -> tuple[list[str], int]:
    """The block that is indented from a line on, without its indentation, and the line behind it.

    It ends where the indentation becomes less than that of its first line: in an item of a list the text goes on there.
    """
    block: list[str] = []
    first = next((line for line in lines[at:] if line.strip()), "")
    margin = max(1, len(first) - len(first.lstrip()))
    while at < len(lines) and (not lines[at].strip() or lines[at].startswith(" " * margin)):
        block.append(lines[at])
        at += 1
    return inspect.cleandoc("\n" + "\n".join(block)).split("\n"), at


def _table(lines: list[str]) -> list[str]:
    starts = [found.start() for found in re.finditer(r"=+", lines[0])]
    spans = list(zip(starts, [*starts[1:], None], strict=True))
    rows = [[_inline(line[a:b].strip()) for a, b in spans] for line in lines if not line.startswith("=")]
    return [row(rows[0]), row(["---"] * len(spans)), *map(row, rows[1:])]


def _inline(line: str) -> str:
    """Roles such as ``:func:`x``` and double backquotes as plain code; pages of the manual as links."""
    line = as_code(line)
    return re.sub(r"(?<![`\w])docs/(\w[\w-]*\.md(?:#[\w-]+)?)", r"[\1](\1)", line)


# ---------------------------------------------------------------------------------------------------------- the machine


def comments(module: ModuleType) -> dict[str, dict[str, str]]:
    """What stands behind each field of the module's classes: {class: {field: comment}}."""
    source = inspect.getsource(module)
    notes = assumptions.comments(source)
    out: dict[str, dict[str, str]] = {}
    for node in ast.parse(source).body:
        if isinstance(node, ast.ClassDef):
            fields = [each for each in node.body if isinstance(each, ast.AnnAssign)]
            out[node.name] = {
                each.target.id: notes[each.end_lineno or 0]
                for each in fields
                if isinstance(each.target, ast.Name) and each.end_lineno in notes
            }
    return out


def parameters(cls: Any, notes: dict[str, str]) -> str:
    """The fields of a part's class: name, default, what it is."""
    declared = quantities(cls)
    rows = []
    for name in cls._fields:
        default = cls._field_defaults.get(name, "")
        if name in declared:
            q = declared[name]
            default = q.choices[int(default)] if q.choices else f"{default:g}"
            unit = f"{q.unit}, " if q.unit not in ("", "1") else ""
            rows.append((f"`{name}`", default, f"{unit}{_inline(q.doc)} {q.source}", q.range))
        else:
            rows.append((f"`{name}`", f"{default:g}", notes.get(name, ""), ""))
    return table(("parameter", "default", "what it is", "allowed"), rows)


def machine() -> str:
    """The page of the machine."""
    text = [
        "# The machine",
        "Each part is a file of `envs/plant/`. They stand here in the order in which the signal travels, each with the "
        "text at the head of its file and a table of its parameters. Units are mm, s, Hz, pF, µH, W unless another is "
        "named. Sources: a document's name; [P] published elsewhere, [C] computed, [S] from a data sheet, [A] assumed. "
        "A scenario sets most numbers of the machine ([scenarios](add-a-scenario.md)), a controller's stack those of "
        "filter and law ([controllers](controllers.md)). [Physics](physics.md) says why the machine is modelled so.",
    ]
    for name in SIGNAL_CHAIN:
        module = importlib.import_module(f"kerfgym.envs.plant.{name}")
        title, body = _titled(module)
        text += [f"## {title}", f"`envs/plant/{name}.py`", body]
        notes = comments(module)
        for cls in (vars(module)[each] for each in notes if not each.startswith("_")):
            if is_part(cls) and cls.__module__ == module.__name__ and _settable(cls):
                about = _inline((inspect.getdoc(cls) or "").split("\n")[0])
                text += [f"**{cls.__name__}**: {about}", parameters(cls, notes[cls.__name__])]
    return _page(text)


SETTABLE = ("Params", "Gate", "Axes", "Feed", "Hand", "Recipe", "Range", "Beam", "Wave", "Vibration")
"""Classes of parts that hold what is set, not what the machine remembers."""


def _settable(cls: Any) -> bool:
    """Whether a class holds what is set, and has a number for each of it."""
    numbers = all(isinstance(value, int | float) for value in cls._field_defaults.values())
    return cls.__name__ in SETTABLE and numbers


def _titled(module: ModuleType) -> tuple[str, str]:
    """First sentence of a module's text up to its colon as a title, and the text."""
    text = markdown(module.__doc__ or "")
    first = text.split("\n", 1)[0]
    return first.split(":")[0].strip().rstrip("."), text


# ----------------------------------------------------------------------------------------------------- the environments


def environments() -> str:
    """The page of the environments: each class' docstring, which is in Markdown already."""
    text = [
        "# Environments",
        "`import kerfgym` registers the environments. Each section below also holds for the vector environment "
        "(`gymnasium.make_vec`) and for the native `VecEnv` of stable-baselines3 (`kerfgym.agents.vec_env`): one "
        "kernel steps them all, and the same scenario seed gives the same bits in each. [Your first ten "
        "minutes](first-minutes-learning.md) begins more gently, and the [Glossary](glossary.md) explains the terms.",
    ]
    for name, spec in gymnasium.registry.items():
        if name.startswith("kerfgym/"):
            module, cls = str(spec.entry_point).split(":")
            doc = inspect.getdoc(getattr(importlib.import_module(module), cls)) or ""
            file = module.removeprefix("kerfgym.").replace(".", "/")
            text += [f"## `{name}`", f"`{file}.py`", re.sub(r"(?m)^## ", "### ", doc)]
    return _page(text)


# --------------------------------------------------------------------------------------------------------------- tables


def controllers() -> str:
    """Every registered controller."""
    rows = []
    for slot in ("z", "xy", "process"):
        for name in stacks.names():
            stack = stacks.get(name)
            if stack.slot == slot:
                rows.append((f"`{name}`", slot, stack.information, stack.summary, _tuned(stack.provenance)))
    return table(("controller", "slot", "information", "what it is", "tuned with"), rows)


def _tuned(record: dict[str, Any]) -> str:
    if not record.get("trials"):
        return "–"
    steps = record.get("simulated_steps")
    return f"{record['trials']} trials" + (f", {1e-6 * steps:.0f} M steps" if steps else "")


def _rounds(record: dict[str, Any], key: str) -> list[Any]:
    """A number of a search's record and of those that it went on from, the last first."""
    return [record[key]] + (_rounds(record["start"], key) if "start" in record else [])


def presets() -> str:
    """What the search of each shipped follower came to and cost, from the records in the presets."""
    rows: list[tuple[str, ...]] = []
    steps, seconds = 0.0, 0.0
    for name in study_file.read("followers").searches:
        found = baselines.preset(name)["provenance"]
        spent, for_ms = budgets.spent(found), _rounds(found, "ms_steps")
        steps, seconds = steps + spent.steps, seconds + spent.cpu_seconds
        trials = " + ".join(str(each) for each in reversed(_rounds(found, "trials")))
        score, ms = f"{found['score_checked_um']:.2f}", f"{found['ms']:.2f}"
        cost = (f"{1e-6 * spent.steps:.0f} M", f"{1e-6 * sum(for_ms):.0f} M", f"{spent.cpu_seconds:.0f}")
        searched = (str(found["searched"]), trials, found["tune_seeds"])
        rows.append((f"`{name}`", found["suite"], *searched, score, ms, *cost))
    rows.append(("all", *[""] * 6, f"{1e-6 * steps:.0f} M", "", f"{seconds:.0f}"))
    cost = ("simulated steps", "steps for Ms", "CPU-seconds")
    searched = ("numbers searched", "trials", "tune seeds")
    titles = ("preset", "suite", *searched, "score on tune seeds, µm", "Ms", *cost)
    return table(titles, rows)


_TRADED = {"cutting_time": "cutting time", "dross": "dross", "roughness": "Rz", "contour_rms": "contour RMS"}


def other_presets() -> str:
    """The same of the axes and of the process, whose searches have aims of their own."""
    rows, followers = [], study_file.read("followers").searches
    for path in sorted(baselines.PRESETS.glob("*.toml")):
        if path.stem in followers:
            continue
        found = baselines.preset(path.stem)["provenance"]
        over = found.get("relative", {})
        came_to = ", ".join(f"{words} {over[key]:.3f}" for key, words in _TRADED.items() if key in over)
        if "score_tune_um" in found:
            came_to = f"contour RMS {found['score_tune_um']:.1f} µm"
        criterion = found.get("criterion", "least contour RMS")
        seconds = f"{found['cpu_seconds']:.0f}" if "cpu_seconds" in found else "–"
        rows.append((f"`{path.stem}`", found.get("suite", "–"), criterion, found["trials"], came_to or "–", seconds))
    titles = ("preset", "suite", "what is sought", "trials", "came to, on tune seeds", "CPU-seconds")
    return table(titles, rows)


def evidence_ranges() -> str:
    """Calibrated and published settings of C45."""
    rows = (
        (name, words, source, *((printed, where) if printed != words else ("the same", "")))
        for name, words, source, printed, where in evidence.table("c45-10")
    )
    return table(("setting", "calibrated", "source", "published", "source"), rows)


def signals() -> str:
    """What the laws of each slot are handed, by information class, and what they command."""
    notes, text = comments(controller), []
    for name, slot in controller.SLOTS.items():
        rows: list[tuple[str, str, str]] = []
        for information, cls in slot.information.items():
            known = {row[0] for row in rows}
            mine = _noted(notes, cls)
            rows += [(f"`{f}`", information, mine.get(f, "")) for f in cls._fields if f"`{f}`" not in known]
        text += [f"**Slot `{name}`**\n", table(("signal", "from class", "what it is"), rows)]
        if slot.command is not float:
            mine = notes[slot.command.__name__]
            fields = ((f"`{f}`", mine.get(f, "")) for f in slot.command._fields)
            text += [f"Its command, `{slot.command.__name__}`:\n", table(("field", "what it is"), fields)]
    return "\n".join(text)


def _noted(notes: dict, cls: Any) -> dict[str, str]:
    """Notes on the fields of a class, or of those that it joins (:func:`lanes.extended`)."""
    inner = {field: note for part in getattr(cls, "joined", ()) for field, note in _noted(notes, part).items()}
    return {**inner, **notes.get(cls.__name__, {})}


def figures(known: Mapping[str, Any]) -> str:
    """Metrics of followers or of jobs."""
    rows = ((f"`{m.name}`", m.unit, m.better, m.summary) for m in known.values())
    return table(("metric", "unit", "better", "what it is"), rows)


def scenario_tables() -> str:
    """Every table of a scenario's file with its keys."""
    text = []
    for name, cls in _sections(scenarios.Scenario, ""):
        notes, rows = comments(sys.modules[cls.__module__])[cls.__name__], []
        for field, kind in inspect.get_annotations(cls, eval_str=True).items():
            inner = next((each for each in get_args(kind) if get_args(each) and type(None) in get_args(kind)), kind)
            q = next((m for m in get_args(inner) if isinstance(m, Quantity)), None)
            if q is None and _section(kind):
                continue
            given = cls.__dataclass_fields__[field].default
            words = (q.unit, q.doc, q.range) if q else ("", notes.get(field, ""), _kinds(kind))
            rows.append((f"`{field}`", _given(given), *words))
        about = _inline((cls.__doc__ or "").strip().split("\n")[0])
        text += [f"**`{name}`** {about}", "", table(("key", "default", "unit", "what it is", "allowed"), rows)]
    return "\n".join(text)


def capacitance() -> str:
    """What the nominal head reads at some heights, from the sensor's own equations."""
    p, step, rows = sensor.Params(), 1e-5, []
    at = lambda h: sensor.oscillator(p, sensor.capacitance(p, h, 1.0), 0.0)  # noqa: E731
    for h in (0.1, 0.5, 1.0, 2.0, 5.0, 10.0):
        farads, slope = sensor.capacitance(p, h, 1.0), (at(h + step) - at(h - step)) / (2 * step)  # Hz/mm
        noise = 1e3 * at(h) * p.noise / (2 * farads) / slope
        drift = 1e3 * at(h) * 0.0008 / slope
        rows.append(
            (f"{h:g}", f"{farads:.2f}", f"{1e-6 * at(h):.3f}", f"{1e-3 * slope:.1f}", f"{noise:.3g}", f"{drift:.3g}")
        )
    titles = ("gap, mm", "C5, pF", "frequency, MHz", "Hz per µm", "1 fF of noise, µm", "0.16 % of L·C, µm")
    return table(titles, rows)


def suites() -> str:
    """Every suite, from its file."""
    rows = []
    for name in scenarios.suites():
        rules, core = scenarios.rules(name), scenarios.core(name)
        judged = (f"`{rules.get('score', 'rms_true')}`", f"`{rules.get('reference', REFERENCE)}`")
        counted = (len(rules["scenarios"]), len(core), rules["seeds"])
        rows.append((f"`{name}`", rules["version"], rules["slot"], *counted, *judged))
    titles = ("suite", "version", "drives", "scenarios", "in the score", "test seeds", "scored by", "reference")
    return table(titles, rows)


def suite(name: str) -> Callable[[], str]:
    """What makes the table of a suite's scenarios."""

    def made() -> str:
        core = scenarios.core(name)
        cases = scenarios.suite(name).items()
        rows = ((f"`{key}`", case.summary, "yes" if key in core else "no") for key, case in cases)
        return table(("scenario", "what happens", "in the score"), rows)

    return made


def _sections(cls: Any, name: str) -> Iterable[tuple[str, Any]]:
    yield name or "(top)", cls
    for field, kind in inspect.get_annotations(cls, eval_str=True).items():
        inner = _section(kind)
        if inner:
            several = get_origin(kind) is tuple
            label = f"{name}.{field}" if name else field
            for found, each in _sections(inner, label):
                yield (f"[[{label}]]" if several else f"[{label}]") if found == label else found, each


def _section(kind: Any) -> Any:
    kinds = [k for k in (kind, *get_args(kind)) if isinstance(k, type) and issubclass(k, scenarios.Section)]
    return kinds[0] if kinds else None


def _kinds(kind: Any) -> str:
    if kind is bool:
        return "true, false"
    words = [str(value) for value in get_args(kind) if isinstance(value, str)]
    if get_origin(kind) is tuple and int in get_args(kind):
        return "whole numbers"
    return ", ".join(words) or ("whole number" if kind is int else "text")


def _given(value: Any) -> str:
    name = type(value).__name__
    if name == "_MISSING_TYPE":
        return "needed"
    if value is None or value in ((), ""):
        return "–"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return f"{value:g}"
    return f"`{value}`" if isinstance(value, str) else f"`{_distribution(value)}`"


def _distribution(value: Any) -> str:
    """As it would stand in the file."""
    given = {key: content for key, content in asdict(value).items() if (key, content) != ("sign", "+")}
    plain = ((key, list(content) if isinstance(content, tuple) else content) for key, content in given.items())
    body = ", ".join(f"{key} = {content}" for key, content in plain)
    return f"{{ {body} }}"


# ---------------------------------------------------------------------------------------------------------------- pages

WHOLE: dict[str, Callable[[], str]] = {"machine.md": machine, "environments.md": environments}
MADE: dict[str, Callable[[], str]] = {
    "controllers": controllers, "signals": signals, "metrics of followers": lambda: figures(metrics.METRICS),
    "metrics of jobs": lambda: figures(job_metrics.METRICS),
    "scenario": scenario_tables, "bounds": stored.table, "noise of a reading": stored.noise_table,
    "presets": presets, "other presets": other_presets, "evidence": evidence_ranges,
    "bounds and estimates": stored.comparison,
    "suites": suites, **{f"suite {name}": suite(name) for name in scenarios.suites()},
    "sources": references.bibliography, "places": references.equations, "assumptions": assumptions.page,
    "documents": references.documents, "capacitance": capacitance, "commands": command_line.commands,
    "verdicts": lambda: table(("verdict", "meaning"), VERDICTS.items()),
    "scripts": command_line.scripts, "python": lambda: python_api.page(markdown),
    **tables.MADE,
}  # fmt: skip
"""What stands between marks in pages written by hand."""

_MARKED = re.compile(r"(<!-- made: (?P<name>[^>]+?) -->\n).*?(<!-- end -->)", re.DOTALL)


def filled(text: str, where: str = "") -> str:
    """A page with everything between marks made anew.

    Raises:
        InvalidInput: a mark whose content nothing makes.
    """

    def made(found: re.Match[str]) -> str:
        if found["name"] not in MADE:
            raise InvalidInput(f"{where}: nothing makes '{found['name']}'; known: {', '.join(MADE)}")
        try:
            return f"{found[1]}\n{MADE[found['name']]()}\n{found[3]}"
        except InvalidInput as error:
            raise InvalidInput(f"{where}, '{found['name']}': {error}") from None

    return marks.filled(_MARKED.sub(made, text), where)


def pages() -> dict[Path, str]:
    """Every page as it should be, by its path."""
    out = {FOLDER / name: make() for name, make in WHOLE.items()}
    for path in (README, *sorted(FOLDER.glob("*.md"))):
        if path.name not in WHOLE:
            out[path] = filled(path.read_text(encoding="utf-8"), path.name)
    return out


def _page(text: Iterable[str]) -> str:
    made = "<!-- Made by python -m kerfgym.experiments.manual.docs; edits are lost. -->"
    return "\n\n".join([made, *(each.strip() for each in text)]) + "\n"


def stale() -> dict[Path, str]:
    """The pages that are older than the code, as they should be."""
    old = lambda path: path.read_text(encoding="utf-8") if path.is_file() else None  # noqa: E731
    return {path: text for path, text in pages().items() if old(path) != text}


def main() -> None:
    """Writes what has changed."""
    for path, text in stale().items():
        write_text(path, text)
        print(path)


if __name__ == "__main__":
    main()
