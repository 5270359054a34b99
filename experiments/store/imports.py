"""What a module imports, directly or not, as files of the package: read from the sources, nothing is run.

Imports within functions count. A name that is loaded by its words (presets, policies, suites) is not seen here; those
files are named by patterns, see :mod:`stamp`.
"""

import ast
import functools
from collections.abc import Iterable
from pathlib import Path

ASIDE = (
    "__init__.py",  # the version, which is stored beside the numbers
    *(f"experiments/{room}" for room in ("cli.py", "manual/", "plots/", "render/", "report/")),
    *(f"experiments/results/{name}.py" for name in ("archive", "merge")),
    *(f"experiments/store/{name}.py" for name in ("markdown", "progress", "runs", "typed")),
    *(f"experiments/studies/{name}.py" for name in ("marks", "pages", "recorded", "registry")),
    "envs/paths/",  # what cuts jobs names it, see :data:`stamp.PLANNED`
    *("envs/pictures/", "envs/control/panel.py"),
    "envs/safety/",  # it refuses, or does not
)
"""Files and folders that show or store numbers and make none. Whatever is not named here counts; they count too where
a study names them."""


def sources(root: Path, entries: Iterable[Path]) -> list[Path]:
    """Some modules and all that they import of the package, in order; nothing beyond what stands aside.

    Args:
        root: of the package.
        entries: files that count in any case.
    """
    found: set[Path] = set()
    left = list(entries)
    while left:
        path = left.pop()
        if path not in found:
            found.add(path)
            left += [each for each in imported(root, path, path.stat().st_mtime_ns) if not _aside(root, each)]
    return sorted(found)


def _aside(root: Path, path: Path) -> bool:
    name = path.relative_to(root).as_posix()
    return any(name.startswith(each) if each.endswith("/") else name == each for each in ASIDE)


@functools.cache
def imported(root: Path, path: Path, _: int) -> tuple[Path, ...]:
    """Files of the package that one imports, as it stood when it was written last: modules, and the ``__init__`` of
    each folder on the way."""
    out: dict[Path, None] = {}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                first, *rest = alias.name.split(".")
                if first == root.name or first == "kerfgym":
                    out |= dict.fromkeys(_files(root, tuple(rest)))
        elif isinstance(node, ast.ImportFrom):
            words = tuple(node.module.split(".")) if node.module else ()
            if node.level:
                folder = path.parent.relative_to(root).parts
                words = folder[: len(folder) - node.level + 1] + words
            elif words[:1] == ("kerfgym",):
                words = words[1:]
            else:
                continue
            for alias in node.names:
                out |= dict.fromkeys(_files(root, (*words, alias.name)) or _files(root, words))
    return tuple(out)


def _files(root: Path, words: tuple[str, ...]) -> list[Path]:
    """The file of a module and of the packages around it; nothing if there is no such module."""
    place = root.joinpath(*words)
    module = place.with_suffix(".py") if words else root / "__init__.py"
    if not module.is_file():
        module = place / "__init__.py"
    if not module.is_file():
        return []
    around = [root.joinpath(*words[:i], "__init__.py") for i in range(1, len(words))]
    return [*(each for each in around if each.is_file()), module]
