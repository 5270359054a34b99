"""Modules that register controllers by name; imported when a name is first looked up.

The package's root fills this list, by string: environments take their base controllers by name and never import them.
"""

from pathlib import Path

SOURCES: list[str] = []

FOLDERS: list[str] = []
"""What makes a stack of a folder, ``"module:function"``: of a policy's, say. None if it is not a folder of its kind."""

SHELVES: list[Path] = []
"""Folders that hold such folders, which are then known by their names: the shipped policies."""
