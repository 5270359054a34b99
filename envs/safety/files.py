"""Files that others wrote: what may be read of them at all.

Only regular files are read, since a pipe may never end and a device may never stop; only up to a size; text is UTF-8;
TOML and JSON are flat, and their whole numbers have 64 bits. Everything else is an error that says what is wrong and
what is allowed.
"""

import functools
import json
import os
import re
import stat
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..engine.quantity import InvalidInput

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
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


def checked(path: str | Path, most: int) -> Path:
    """The path, if it is that of a regular file of at most so many bytes; for libraries that open it themselves.

    Raises:
        InvalidInput: it is none, too large, or cannot be opened.
    """
    handle = _opened(path, most)
    try:
        os.read(handle, 1)  # some files of the system pass for regular ones until they are read
    except OSError as error:
        raise InvalidInput(f"cannot read '{path}': {error.strerror}") from None
    finally:
        os.close(handle)
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
        found = tomllib.loads(words)
    except RecursionError:
        raise _too_deep(where) from None
    except ValueError as error:  # also an integer of thousands of digits
        raise InvalidInput(f"{where}: not valid TOML: {error}") from None
    _check(found, where)
    return found


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
        found = json.loads(words)
    except RecursionError:
        raise _too_deep(where) from None
    except ValueError as error:
        raise InvalidInput(f"cannot read '{where}': not valid JSON: {error}") from None
    _check(found, where)
    return found


def fitting(kind: Any, found: Any, where: str | Path) -> None:
    """Makes sure that what a file holds is of a declared kind: no text for a number, no number for a text.

    Args:
        kind: a ``TypedDict``; keys that it does not name may hold anything.
        found: what was parsed.
        where: file, and table within.

    Raises:
        InvalidInput: the first key of another kind, with its place.
    """
    from pydantic import ValidationError

    try:
        _validator(kind).validate_python(found)
    except ValidationError as error:
        first = max(error.errors(include_url=False), key=lambda each: len(each["loc"]))  # the kind that nearly fits
        place = ".".join(str(key) for key in first["loc"] if key not in _FORMS)
        value = shown(first["input"]) if isinstance(first["input"], _PLAIN) else f"a {type(first['input']).__name__}"
        at = f"{place} is {value}" if place else f"found {value}"
        raise InvalidInput(f"{where}: {at}; {_lower(first['msg'])}") from None


@functools.cache
def _validator(kind: Any) -> Any:
    from pydantic import TypeAdapter

    kind.__pydantic_config__ = {"extra": "allow", "strict": True, "allow_inf_nan": True}
    return TypeAdapter(kind)


_PLAIN = (str, int, float, bool, type(None))

_FORMS = ("str", "float", "int", "bool", "list[str]", "dict[str,any]", "none")
"""What pydantic adds to a place where several kinds are allowed."""


def _lower(words: str) -> str:
    return words[:1].lower() + words[1:]


def shown(value: Any, most: int = 80) -> str:
    """A value in an error, however long it is."""
    try:
        words = repr(value)
    except ValueError:  # a whole number of thousands of digits
        return "a number without an end"
    return words if len(words) <= most else f"{words[:most]}…"


def exists(path: str | Path, is_kind: Callable[[Path], bool] = Path.exists) -> bool:
    """Whether there is something of this name; there is nothing where none can be called so, as of a longer one.

    Args:
        path: what a file or a user names.
        is_kind: what it has to be, such as ``Path.is_dir``.
    """
    try:
        return is_kind(Path(path))
    except (OSError, ValueError):
        return False


def is_file(path: str | Path) -> bool:
    """The same of a file."""
    return exists(path, Path.is_file)


def is_folder(path: str | Path) -> bool:
    """The same of a folder."""
    return exists(path, Path.is_dir)


def within(folder: Path, name: Any, what: str) -> Path:
    """The path of a name that a file gives for something in a folder.

    Raises:
        InvalidInput: it is no text, leads out of the folder, or is longer than a name can be.
    """
    if isinstance(name, str) and "\0" not in name and not Path(name).is_absolute() and ".." not in Path(name).parts:
        found = folder / name
        try:
            if found.resolve().is_relative_to(folder.resolve()):
                os.lstat(found)
                return found
        except FileNotFoundError:
            return found
        except (OSError, ValueError, RuntimeError) as error:  # too long, no text of this system, links in a ring
            why = getattr(error, "strerror", None) or error
            raise InvalidInput(f"{what} {shown(name)}: nothing in '{folder}' can be called so: {why}") from None
    raise InvalidInput(f"{what} {shown(name)} leads out of '{folder}'; allowed: names of what lies in it")


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


_NO_TEXT = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff]")


def is_text(words: str) -> bool:
    """Whether text holds nothing that steers a terminal, ends a path or cannot be written."""
    return _NO_TEXT.search(words) is None


def _check(found: Any, where: str | Path) -> None:
    """Raises :class:`InvalidInput` unless whatever looks at what was parsed may call itself, show it, write it again:
    it is not deep, its whole numbers have 64 bits, as TOML wants it, and its text is text."""
    layer = [found]
    for _ in range(DEEPEST):
        if not layer:
            return
        keys = [key for each in layer if isinstance(each, dict) for key in each]
        for each in (*keys, *layer):
            if type(each) is int and not -(2**63) <= each < 2**63:
                raise InvalidInput(f"{where}: {shown(each, 24)} is no number of 64 bits")
            if isinstance(each, str) and not is_text(each):
                raise InvalidInput(
                    f"{where}: {ascii(each)[:80]} is no text: it holds a control character, or half of one"
                )
        within = [each.values() if isinstance(each, dict) else each for each in layer if isinstance(each, dict | list)]
        layer = [x for those in within for x in those]
    if layer:
        raise _too_deep(where)
