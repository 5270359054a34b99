"""Files that others wrote: what may be read of them at all.

Only regular files are read, since a pipe may never end and a device may never stop; only up to a size; text is UTF-8;
TOML and JSON are flat. Everything else is an error that says what is wrong and what is allowed.
"""

import json
import os
import stat
import tomllib
from pathlib import Path
from typing import Any

from .engine.quantity import InvalidInput

MEGABYTE = 1_000_000

SETTINGS = 1 * MEGABYTE
"""Bytes of a scenario, a preset, a tuned controller."""

TABLE = 32 * MEGABYTE
"""Bytes of a CSV: a profile, a map, a calibration table, a signal; 32 MB are half an hour of a signal."""

DRAWING = 64 * MEGABYTE
"""Bytes of a drawing or programme; what ezdxf makes of a file takes twenty times as much memory."""

RECORD = 64 * MEGABYTE
"""Bytes of a run's record, a policy's document, a page that is remade."""

NUMBERS = 2000 * MEGABYTE
"""Bytes of results, weights, journals and checkpoints, which a run of one's own makes."""

DEEPEST = 32
"""Tables within tables; what kerfgym writes has six."""

_KINDS = (
    (stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a named pipe"), (stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)  # fmt: skip


def checked(path: str | Path, most: int) -> Path:
    """The path, if it is that of a regular file of at most so many bytes; for libraries that open it themselves.

    Raises:
        InvalidInput: it is none, too large, or cannot be opened.
    """
    os.close(_opened(path, most))
    return Path(path)


def data(path: str | Path, most: int) -> bytes:
    """The bytes of a regular file.

    Raises:
        InvalidInput: it is none, larger than ``most`` bytes, or cannot be read.
    """
    handle = _opened(path, most)
    try:
        with os.fdopen(handle, "rb") as file:
            pieces, left = [file.read(min(os.fstat(handle).st_size, most) + 1)], most
            while pieces[-1]:  # it grew, or it is one of those whose size the system does not tell
                left -= len(pieces[-1])
                if left < 0:
                    raise _too_large(path, most)
                pieces.append(file.read(MEGABYTE))
    except OSError as error:
        raise InvalidInput(f"cannot read '{path}': {error.strerror}") from None
    except MemoryError:
        raise InvalidInput(f"cannot read '{path}': it does not fit into memory") from None
    return b"".join(pieces)


def text(path: str | Path, most: int) -> str:
    """The text of a regular file in UTF-8, with or without a byte order mark.

    Raises:
        InvalidInput: as :func:`data`, or not UTF-8; with the line.
    """
    found = data(path, most)
    try:
        return found.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = found.count(b"\n", 0, error.start) + 1
        raise InvalidInput(
            f"cannot read '{path}': line {line} is not UTF-8 (byte 0x{found[error.start]:02x}); save it as UTF-8"
        ) from None


def toml(path: str | Path, most: int = SETTINGS) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        InvalidInput: as :func:`text`, or not TOML; with line and column.
    """
    return toml_of(text(path, most), path)


def toml_of(words: str, where: str | Path) -> dict[str, Any]:
    """The tables of TOML text.

    Raises:
        InvalidInput: it is none, or deeper than any of ours.
    """
    try:
        return _flat(tomllib.loads(words), where)
    except RecursionError:
        raise _too_deep(where) from None
    except ValueError as error:  # also an integer of thousands of digits
        raise InvalidInput(f"{where}: not valid TOML: {error}") from None


def json_(path: str | Path, most: int = RECORD) -> Any:
    """What a JSON file holds.

    Raises:
        InvalidInput: as :func:`text`, or not JSON; with line and column.
    """
    return json_of(text(path, most), path)


def json_of(words: str, where: str | Path) -> Any:
    """What JSON text holds.

    Raises:
        InvalidInput: it is none, or deeper than any of ours.
    """
    try:
        return _flat(json.loads(words), where)
    except RecursionError:
        raise _too_deep(where) from None
    except ValueError as error:
        raise InvalidInput(f"cannot read '{where}': not valid JSON: {error}") from None


def within(folder: Path, name: Any, what: str) -> Path:
    """The path of a name that a file gives for something in a folder.

    Raises:
        InvalidInput: it is no text, or leads out of the folder.
    """
    if isinstance(name, str) and "\0" not in name and not Path(name).is_absolute() and ".." not in Path(name).parts:
        found = folder / name
        if found.resolve().is_relative_to(folder.resolve()):
            return found
    raise InvalidInput(f"{what} {name!r} leads out of '{folder}'; allowed: names of what lies in it")


def _opened(path: str | Path, most: int) -> int:
    """A handle of a regular file; opening does not wait for the other end of a pipe."""
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise InvalidInput(f"cannot read '{path}': {error.strerror}") from None
    except ValueError:
        raise InvalidInput(f"cannot read {str(path)!r}: a path holds no zero bytes") from None
    status = os.fstat(handle)
    if stat.S_ISREG(status.st_mode) and status.st_size <= most:
        return handle
    os.close(handle)
    if stat.S_ISREG(status.st_mode):
        raise _too_large(path, most)
    kind = next((words for is_kind, words in _KINDS if is_kind(status.st_mode)), "no ordinary file")
    raise InvalidInput(f"cannot read '{path}': it is {kind}; only regular files are read")


def _too_large(path: str | Path, most: int) -> InvalidInput:
    return InvalidInput(f"cannot read '{path}': it is larger than {most / MEGABYTE:g} MB")


def _too_deep(where: str | Path) -> InvalidInput:
    return InvalidInput(f"{where}: more than {DEEPEST} tables or lists within one another")


def _flat(found: Any, where: str | Path) -> Any:
    """What was parsed, if it is not deep: whatever looks at it may call itself."""
    layer = [found]
    for _ in range(DEEPEST):
        layer = [x for each in layer if isinstance(each, dict | list)
                 for x in (each.values() if isinstance(each, dict) else each)]  # fmt: skip
        if not layer:
            return found
    raise _too_deep(where)
