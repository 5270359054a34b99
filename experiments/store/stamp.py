"""What a result depends on, as hashes: whether sources, presets or suites have changed since a study was run.

Modules count with all that they import (:mod:`imports`), so nothing that computes can be forgotten. A pattern names
files that are loaded by their names instead, such as ``baselines/presets/*.toml``; one that begins with ``!`` takes
files away again. Comments, docstrings and blank lines of Python sources do not count, because they change no result.
"""

import ast
import functools
import hashlib
import inspect
import io
import textwrap
import tokenize
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from ... import __file__ as _root
from ...envs.engine.quantity import InvalidInput
from .imports import sources

ROOT = Path(_root).parent

LOADED = ("envs/materials/*.toml",)
"""What any simulation may load by its name."""

PLANNED = ("envs/paths/*.py",)
"""What makes jobs of drawings: named by what cuts jobs, for followers along given lines never meet it."""

LAWS = ("baselines/*.py", "baselines/presets/*.toml")
POLICIES = ("agents/compiled.py", "agents/network.py", "agents/policy.py")


def suite(name: str) -> tuple[str, ...]:
    """Files of a suite."""
    return f"envs/suites/{name}.toml", f"envs/suites/{name}/*"


def trained(prefix: str = "") -> tuple[str, ...]:
    """Documents and weights of the shipped policies whose name begins so."""
    return f"agents/trained/{prefix}*/policy.json", f"agents/trained/{prefix}*/*.safetensors"


def files(patterns: Iterable[str]) -> dict[str, list[Path]]:
    """The files of each pattern, in order.

    Raises:
        InvalidInput: a pattern that names no file.
    """
    every = list(patterns)
    less = {path for each in every if each.startswith("!") for path in ROOT.glob(each[1:])}
    out: dict[str, list[Path]] = {}
    for pattern in every:
        if not any(ROOT.glob(pattern.removeprefix("!"))):
            raise InvalidInput(f"no file of the package fits '{pattern}'")
        if not pattern.startswith("!"):
            out[pattern] = sorted(p for p in ROOT.glob(pattern) if p.is_file() and p not in less)
    return out


def stamp(patterns: Iterable[str]) -> dict[str, str]:
    """A hash for each pattern: of the names of its files and of what they say."""
    return {pattern: _of(tuple(found)) for pattern, found in files(dict.fromkeys(patterns)).items()}


def with_imports(entries: Iterable[Path], patterns: Iterable[str]) -> dict[str, str]:
    """A hash for each pattern, and one for each folder of what the entries, and modules among the files of the
    patterns, import."""
    named = [path for found in files(dict.fromkeys(patterns)).values() for path in found if path.suffix == ".py"]
    groups: dict[str, list[Path]] = {}
    for path in sources(ROOT, [*entries, *named]):
        groups.setdefault(path.parent.relative_to(ROOT).as_posix(), []).append(path)
    return stamp(patterns) | {f"imports from {folder}": _of(tuple(found)) for folder, found in groups.items()}


def changed(before: dict[str, str], now: dict[str, str]) -> list[str]:
    """The patterns whose files are not what they were."""
    return [each for each in dict.fromkeys([*now, *before]) if before.get(each) != now.get(each)]


def _of(found: tuple[Path, ...]) -> str:
    digest = hashlib.sha256()
    for path in found:
        digest.update(f"{path.relative_to(ROOT).as_posix()}\n".encode() + _said(path, path.stat().st_mtime_ns) + b"\0")
    return digest.hexdigest()[:16]


@functools.cache
def _said(path: Path, _: int) -> bytes:
    """Of a file, as it stood when it was written last."""
    return code(path.read_text(encoding="utf-8")).encode() if path.suffix == ".py" else path.read_bytes()


def said(function: Callable[..., Any]) -> str:
    """A hash of what a function does, without what decorates it."""
    text = textwrap.dedent(inspect.getsource(function))
    first = ast.parse(text).body[0].lineno - 1
    return hashlib.sha256(code("\n".join(text.split("\n")[first:])).encode()).hexdigest()[:16]


def code(text: str) -> str:
    """A Python source without comments, docstrings and blank lines."""
    lines = text.split("\n")
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            row, column = token.start
            lines[row - 1] = lines[row - 1][:column]
    for node in ast.walk(ast.parse(text)):
        # A string that is a statement of its own says something to readers only.
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            lines[node.lineno - 1 : node.end_lineno] = [""] * ((node.end_lineno or node.lineno) - node.lineno + 1)
    return "\n".join(line.rstrip() for line in lines if line.strip())
