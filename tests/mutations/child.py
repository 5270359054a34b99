"""The forked process that runs a test file against a mutant."""

import contextlib
import importlib
import importlib.util
import os
import sys
from pathlib import Path
from typing import Any, NoReturn

# Loaded once, before the fork: what the tests import beside the package.
import numba
import numpy
import pandas
import pytest
import scipy.linalg
import scipy.optimize
import scipy.signal

from kerfgym.tests.mutations import tests_of

CACHE = "KERFGYM_CACHE_DIR"
LOADED = (numba, numpy, pandas, pytest, scipy.linalg, scipy.optimize, scipy.signal)


def become(copy: Path, tests: str, mutated: str, stamp: str) -> NoReturn:
    """Runs ``tests`` of the package's ``copy`` up to the first failure and ends the process with pytest's code.

    Args:
        copy: of the package, in a folder of its own.
        tests: a test file, from the package's folder on.
        mutated: the file with the mistake; none if it is empty.
        stamp: of the kernels of the package without a mistake.
    """
    code = 3
    try:
        os.setpgid(0, 0)
        os.chdir(copy)
        os.environ.pop(CACHE, None)
        sys.dont_write_bytecode = True
        with open(copy.parent / "last.txt", "w") as out:
            os.dup2(out.fileno(), 1)
            os.dup2(out.fileno(), 2)
        for name in [name for name in sys.modules if name.partition(".")[0] == "kerfgym"]:
            del sys.modules[name]
        sys.meta_path.insert(0, _Copy(copy))
        _keep_kernels(copy, Path(mutated).stem, stamp)
        with contextlib.suppress(SystemExit):
            code = int(pytest.main(["-x", "-q", "-n", "0", "-p", "no:cacheprovider", "-W", "ignore", tests]))
    finally:
        os._exit(code)


def _keep_kernels(copy: Path, mutated: str, stamp: str) -> None:
    """Kernels that cannot contain the mistake are those of the package without it; the others have a folder for now.

    The package itself compiles every kernel anew when any source of the plant changes, which takes longer than most
    tests.
    """
    kernels = importlib.import_module("kerfgym.envs.engine.kernels")
    plain, own = kernels._file, kernels.STAMP

    def file(together: tuple[Any, ...]) -> Path:
        holder = together[0].function.__module__.rpartition(".")[2]
        free = not mutated or mutated not in tests_of.INSIDE.get(holder, (mutated,))
        if CACHE in os.environ:  # a test of the cache looks into a folder of its own
            return plain(together)
        kernels.STAMP = stamp if free else own
        folder = copy.parent / ("kernels" if free else "mutant")
        folder.mkdir(exist_ok=True)
        return folder / plain(together).name

    kernels._file = file


class _Copy:
    """Finds the package in the copy, whatever is installed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def find_spec(self, name: str, path: object = None, target: object = None) -> object:
        """Python asks this first."""
        if name != "kerfgym":
            return None
        where = [str(self.folder)]
        return importlib.util.spec_from_file_location(
            name, self.folder / "__init__.py", submodule_search_locations=where
        )
