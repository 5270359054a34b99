"""Shapely at its first use: it is slow to import, and whoever follows a straight line never needs it."""

import importlib
from typing import Any


def __getattr__(name: str) -> Any:
    globals()[name] = found = getattr(importlib.import_module("shapely"), name)
    return found
