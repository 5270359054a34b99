"""Every number that the code marks [A], assumed: where it stands, its value, what it is.

The marks are read from the sources, as they stand: behind a field, in the source of a :class:`Quantity`, in the text
below a constant, behind a line of a material. A mark in running text has no value of its own, so its sentence is told.
"""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from typing import NamedTuple

from ..store.markdown import as_code, table
from ..store.stamp import ROOT

LAYERS = ("envs", "baselines", "agents", "experiments")
MARK = "[A]"

ABOUT = {
    "envs/engine/quantity.py": "says what the mark means",
    "experiments/manual/docs.py": "says what the mark means",
    "experiments/manual/assumptions.py": "reads the marks",
    "experiments/report/limits.py": "says what the mark means",
}
"""Files that speak about the mark itself, and what they say."""

DECLARED = ("Quantity",)
"""Calls that declare a number: unit, range, meaning and source. A number without a source is assumed."""

TOML_TEXT = re.compile(r'"{3}.*?"{3}|"(?:[^"\\\n]|\\.)*"', re.DOTALL)
"""A text in a file of numbers, of one line or several."""

SHORT = 130
"""Characters of a text that is told whole."""


class Assumed(NamedTuple):
    """One assumption; ``first`` and ``last`` are its lines in the file, ``value`` is empty in running text."""

    file: str
    name: str
    value: str
    what: str
    first: int
    last: int


def every() -> list[Assumed]:
    """All assumptions of the package, file by file, in the order of their lines."""
    out: list[Assumed] = []
    for layer in LAYERS:
        for path in sorted((ROOT / layer).rglob("*")):
            name = path.relative_to(ROOT).as_posix()
            if path.suffix not in (".py", ".toml") or name in ABOUT:
                continue
            text = path.read_text(encoding="utf-8")
            found = list((of_python if path.suffix == ".py" else of_toml)(name, text))
            out += sorted([*found, *in_words(name, text, found)], key=lambda each: each.first)
    return out


def of_python(file: str, text: str) -> Iterator[Assumed]:
    """Constants and fields of a module."""
    if MARK not in text and "Quantity(" not in text:
        return
    tree, notes = ast.parse(text), comments(text)
    for prefix, body in [("", tree.body), *((f"{c.name}.", c.body) for c in tree.body if isinstance(c, ast.ClassDef))]:
        for node, below in zip(body, [*body[1:], None], strict=True):
            name, value = _assigned(node)
            if not name or value is None:
                continue
            last = node.end_lineno or node.lineno
            note = " ".join(notes[line] for line in range(node.lineno, last + 1) if line in notes)
            note = note.removesuffix("fmt: skip")
            if declared := _declared(node):
                unit, doc, source = declared
                if MARK in source:
                    words = ", ".join(each for each in (unit, doc, _plain(source), note) if each)
                    yield Assumed(file, prefix + name, value, words, node.lineno, last)
            elif MARK in note:
                yield Assumed(file, prefix + name, value, _plain(note), node.lineno, last)
            elif MARK in (said := _text(below)):
                assert below is not None
                yield Assumed(file, prefix + name, value, _plain(said), node.lineno, below.end_lineno or 0)


def of_toml(file: str, text: str) -> Iterator[Assumed]:
    """Lines of a file of numbers."""
    section = ""
    for number, line in enumerate(text.split("\n"), start=1):
        if found := re.match(r"\[+([^\]]+)\]+\s*$", line):
            section = f"{found[1]}."
        elif MARK in line and (found := re.match(r"(\w+)\s*=\s*(.*?)\s*#\s*(.*)$", line)):
            yield Assumed(file, section + found[1], found[2], _plain(found[3]), number, number)


def in_words(file: str, text: str, found: list[Assumed]) -> Iterator[Assumed]:
    """Marks that belong to none of these numbers: the sentences in which they stand."""
    taken = {line for each in found for line in range(each.first, each.last + 1)}
    for first, last, said in _prose(file, text):
        if MARK in said and said != MARK and not taken & set(range(first, last + 1)):
            said = re.sub(r"\s+", " ", said)
            short = len(said) <= SHORT
            for sentence in [said] if short else re.split(r"(?<=[.;:])\s+(?=[a-zA-Z*`-])", said):
                if MARK in sentence and (told := _plain(sentence)):
                    yield Assumed(file, "", "", told, first, last)


def _prose(file: str, text: str) -> Iterator[tuple[int, int, str]]:
    """Strings and blocks of comments: first and last line, text."""
    if file.endswith(".py"):
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.lineno, node.end_lineno or node.lineno, node.value
        notes = comments(text)
    else:
        notes = {n: line[1:] for n, line in enumerate(text.split("\n"), start=1) if line.startswith("#")}
        for said in TOML_TEXT.finditer(text):
            first, last = (1 + text.count("\n", 0, at) for at in said.span())
            yield first, last, said[0].strip('"').replace("\\\n", "")
    block: list[int] = []
    for line in [*sorted(notes), 0]:
        if block and line != block[-1] + 1:
            yield block[0], block[-1], " ".join(notes[each].strip() for each in block)
            block = []
        block.append(line)


def page() -> str:
    """The list, as tables by folder."""
    rows = every()
    groups: dict[str, list[Assumed]] = {}
    for each in rows:
        groups.setdefault(each.file.rsplit("/", 1)[0], []).append(each)
    text = []
    for folder, some in groups.items():
        cells = (
            (f"`{each.file.rsplit('/', 1)[1]}`", _code(each.name), _code(each.value), each.what.replace("|", "\\|"))
            for each in some
        )
        text.append(f"**`{folder}/`**\n\n" + table(("file", "number", "value", "what it is"), cells))
    return "\n\n".join(text)


def _code(text: str) -> str:
    return f"`{text}`" if text else "–"


def _assigned(node: ast.stmt) -> tuple[str, str | None]:
    """Name and value of an assignment, as they are written."""
    if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.value is not None:
        return node.target.id, _short(node.value)
    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name | ast.Tuple):
        return ast.unparse(node.targets[0]).strip("()"), _short(node.value).strip("()")
    return "", None


def _short(value: ast.expr) -> str:
    text = ast.unparse(value)
    return text if len(text) <= 60 else f"{text[:57]}…"


def _declared(node: ast.stmt) -> tuple[str, str, str] | None:
    """Unit, meaning and source of a field's declared quantity."""
    if not isinstance(node, ast.AnnAssign):
        return None
    for each in ast.walk(node.annotation):
        if isinstance(each, ast.Call) and isinstance(each.func, ast.Name) and each.func.id in DECLARED:
            given = {k.arg: k.value for k in each.keywords} | dict(
                zip(("unit", "low", "high", "doc", "source"), each.args, strict=False)
            )
            if not isinstance(given.get("doc"), ast.Constant):
                return None
            source = ast.literal_eval(given["source"]) if "source" in given else MARK
            unit = ast.literal_eval(given["unit"])
            return ("" if unit in ("", "1") else unit), ast.literal_eval(given["doc"]), source
    return None


def _text(node: ast.stmt | None) -> str:
    """The string that stands as a statement of its own."""
    value = node.value if isinstance(node, ast.Expr) else None
    return value.value if isinstance(value, ast.Constant) and isinstance(value.value, str) else ""


def comments(text: str) -> dict[int, str]:
    """What stands behind the ``#`` of each line of a module that has one."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return {t.start[0]: t.string.removeprefix("#").strip() for t in tokens if t.type == tokenize.COMMENT}


def _plain(text: str) -> str:
    """Without the mark, roles and line breaks."""
    text = as_code(text)
    text = re.sub(rf"(, value)?\s*{re.escape(MARK)}", "", re.sub(r"\s+", " ", text))
    return re.sub(r"^[\s:;,]+|[\s;,.]+$", "", text)
