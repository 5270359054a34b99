"""The forked process that runs a test file against a mutant."""

import contextlib
import importlib.util
import os
import sys
from pathlib import Path
from typing import NoReturn

# Loaded once, before the fork: what the tests import beside the package.
import numba
import numpy
import pandas
import pytest
import scipy.linalg
import scipy.optimize
import scipy.signal

LOADED = (numba, numpy, pandas, pytest, scipy.linalg, scipy.optimize, scipy.signal)


def become(copy: Path, tests: str) -> NoReturn:
    """Runs ``tests`` of the package's ``copy`` up to the first failure and ends the process with pytest's code."""
    code = 3
    try:
        os.setpgid(0, 0)
        os.chdir(copy)
        os.environ["KERFGYM_CACHE_DIR"] = str(copy.parent / "kernels")
        sys.dont_write_bytecode = True
        with open(os.devnull, "w") as nothing:
            os.dup2(nothing.fileno(), 1)
            os.dup2(nothing.fileno(), 2)
        for name in [name for name in sys.modules if name.partition(".")[0] == "kerfgym"]:
            del sys.modules[name]
        sys.meta_path.insert(0, _Copy(copy))
        with contextlib.suppress(SystemExit):
            code = int(pytest.main(["-x", "-q", "-n", "0", "-p", "no:cacheprovider", "-W", "ignore", tests]))
    finally:
        os._exit(code)


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
