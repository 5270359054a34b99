"""Where a name of a module comes from, and what is said of it there."""

import ast
import functools
import importlib
import inspect
from types import ModuleType


def origin(module: str, name: str) -> tuple[str, str]:
    """The module in which a name is given its value, and the docstring or comment that stands with it.

    Args:
        module: in which the name is used.
        name: of a constant.
    """
    for _ in range(5):
        said, imported = _names(module)
        if name in said:
            return module, said[name]
        if name not in imported:
            break
        module, name = imported[name]
    return module, ""


@functools.cache
def _names(module: str) -> tuple[dict[str, str], dict[str, tuple[str, str]]]:
    """What stands with each constant of a module, and where imported names come from."""
    try:
        loaded: ModuleType = importlib.import_module(module)
        source = inspect.getsource(loaded)
    except (ImportError, OSError, TypeError):  # a user's file, which is known by itself alone
        return {}, {}
    lines, body = source.split("\n"), ast.parse(source).body
    said: dict[str, str] = {}
    imported: dict[str, tuple[str, str]] = {}
    for statement, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(statement, ast.ImportFrom):
            package = loaded.__name__.rsplit(".", statement.level)[0] if statement.level else ""
            if statement.level and hasattr(loaded, "__path__"):
                package = (
                    loaded.__name__.rsplit(".", statement.level - 1)[0] if statement.level > 1 else loaded.__name__
                )
            home = ".".join(part for part in (package, statement.module or "") if part)
            imported |= {alias.asname or alias.name: (home, alias.name) for alias in statement.names}
        elif isinstance(statement, ast.Assign | ast.AnnAssign):
            targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
            names = [node.id for target in targets for node in ast.walk(target) if isinstance(node, ast.Name)]
            words = ""
            if (
                isinstance(after, ast.Expr)
                and isinstance(after.value, ast.Constant)
                and isinstance(after.value.value, str)
            ):
                words = " ".join(after.value.value.split())
            elif "  # " in (line := lines[(statement.end_lineno or 1) - 1]):
                words = line.split("  # ", 1)[1]
            said |= dict.fromkeys(names, words if "fmt: skip" not in words else "")
    return said, imported
