"""The page of the command line, made from what the commands say of themselves: ``kerfgym COMMAND --help``.

Help is printed so wide that nothing wraps, and read line by line: an option stands two blanks in, what it is stands
behind it or further in. Scripts are the modules that ``python -m`` runs; the first sentence of their text is told.
"""

import ast
import contextlib
import io
import os
import re
from collections.abc import Iterator
from unittest import mock

import tyro

from ..cli import COMMANDS
from ..store.markdown import as_code, table
from ..store.stamp import ROOT

WIDE = "1000"
"""Columns of the terminal for which help is printed."""

_WORD = re.compile(r"^  (?P<words>\S.*?)(?:  +(?P<about>\S.*))?$")
_DEFAULT = re.compile(r" ?\((?:default: (?P<value>.*?)|repeatable|required)\)$")
_SAID = {"None": "", "False": "", "True": "on"}
"""Defaults that are told otherwise; of a switch that is off nothing need be said."""


def help_of(name: str) -> str:
    """What ``kerfgym NAME --help`` prints on a wide terminal."""
    out = io.StringIO()
    wide = mock.patch.dict(os.environ, {"COLUMNS": WIDE})
    with wide, contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
        tyro.cli(COMMANDS[name], prog=f"kerfgym {name}", args=["--help"])
    return out.getvalue()


def commands() -> str:
    """Every command with its options."""
    return "\n".join(map(command, COMMANDS))


def options(text: str) -> Iterator[tuple[str, str]]:
    """Arguments and options of a command's help, each with what it is."""
    words, about = "", ""
    for line in text.split("\n"):
        line = line.rstrip()
        if not line.startswith("  ") or line.strip("- ") == "":
            continue
        found = _WORD.match(line)
        if line.startswith("   ") and words:
            about = f"{about} {line.strip()}".strip()
        elif found and (found["words"].startswith("-") or found["words"].split()[0].strip("[]").isupper()):
            if words:
                yield words, about
            words, about = found["words"], found["about"] or ""
    if words:
        yield words, about


def told(about: str) -> tuple[str, str]:
    """What an option is, and its default where the text does not say it."""
    default = ""
    while found := _DEFAULT.search(about):
        default = found["value"] or default
        about = about[: found.start()]
    return about, "" if "Default:" in about else _SAID.get(default, default)


def command(name: str) -> str:
    """A command: what it does, and a table of its options."""
    text = help_of(name)
    about = text.split("\n\n options")[0].split("\n\n positional arguments")[0].split("\n", 1)[1].strip()
    rows = []
    for words, what in options(text):
        if words.startswith("-h"):
            continue
        what, default = told(_files(what))
        names = words.split(", ")
        if names[-1].startswith("--no-") and default != "on":  # a switch that is off as it is
            del names[-1]
        rows.append((", ".join(f"`{each}`" for each in names), what, default))
    return f"## `kerfgym {name}`\n\n{_files(about)}\n\n" + table(("argument", "what it is", "default"), rows)


def _files(text: str) -> str:
    """``runs/<name>/`` as code: Markdown takes it for a tag."""
    return re.sub(r"(?<!\S)(\S*<\w+>(?:[\w./]*[\w/])?)", r"`\1`", text)


def scripts() -> str:
    """Modules of ``experiments`` that ``python -m`` runs, with the first sentence of their text."""
    rows = []
    for path in sorted((ROOT / "experiments").rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        if '\nif __name__ == "__main__":' not in source or path.name == "cli.py":
            continue
        file = path if path.name != "__main__.py" else path.with_name("__init__.py")
        about = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
        module = ".".join(("kerfgym", *file.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__")
        rows.append((f"`python -m {module}`", _plain(about)))
    return table(("command", "what it does"), rows)


def _plain(text: str) -> str:
    """The first sentence, of a question the answer too; without how the module is run, roles and double backquotes."""
    lines = re.split(r"(?<=\w[.?])\s", re.sub(r"\s+", " ", text.split("\n\n")[0]))
    first = " ".join(lines[: 2 if lines[0].endswith("?") else 1])
    first = re.sub(r"^``python -m [^`]*``: |:? ``python -m [^`]*``.*$", "", first)
    first = as_code(first).rstrip(":.")
    return first[:1].upper() + first[1:]
