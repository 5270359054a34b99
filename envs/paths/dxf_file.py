"""DXF files: read as they should be, or repaired as far as they can be."""

import io
import logging
import re
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

from ..engine.quantity import InvalidInput, in_order
from .collected import MOST_ENTITIES, some

SUBCLASS = {
    "LWPOLYLINE": "AcDbPolyline",
    "SPLINE": "AcDbSpline",
    "MTEXT": "AcDbMText",
    "MESH": "AcDbSubMesh",
    "MLINE": "AcDbMLine",
    "LEADER": "AcDbLeader",
    "MULTILEADER": "AcDbMLeader",
}
"""The marker without which ezdxf does not read an entity; some programs leave it out."""

COMMON = {"5", "330", "102", "100", "8", "6", "48", "60", "62", "67", "370", "420", "430", "440", "410", "1001"}
"""Group codes that stand before that marker, for they belong to every entity."""

Tag = tuple[str, str]
"""Group code and value, as they stand in the file."""

BINARY = b"AutoCAD Binary DXF"

DRAWN = re.compile(
    rb"(?m)^ *0\r?\n *(?:LINE|ARC|CIRCLE|ELLIPSE|LWPOLYLINE|POLYLINE|SPLINE|POINT|INSERT|TEXT|MTEXT|HATCH|SOLID|TRACE"
    rb"|3DFACE)\r?$"
)
"""Where an entity begins that is drawn, in a text file."""

CODE = re.compile(r"-?\d{1,4}")

COMMA = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d+)?")
"""A number as some languages write it."""

STRUCTURE = in_order(
    "SECTION ENDSEC EOF TABLE ENDTAB BLOCK ENDBLK BLOCK_RECORD LAYER LTYPE STYLE VPORT VIEW UCS APPID DIMSTYLE CLASS"
)
"""What begins with code 0 and is no entity; a number that is none is 0 there."""

WHOLE = ((60, 79), (90, 99), (160, 179), (270, 289), (370, 389), (400, 409), (420, 429), (440, 459), (1060, 1071))
"""Ranges of group codes whose values are whole numbers. [P] DXF reference"""

REAL = ((10, 59), (110, 149), (210, 239), (460, 469), (1010, 1059))
"""Those whose values are numbers."""


def document_of(file: Path) -> tuple[Any, list[str]]:
    """The file as ezdxf's document, and what had to be repaired.

    Raises:
        InvalidInput: not a DXF file, or one that cannot be repaired.
    """
    import ezdxf  # slow
    from ezdxf import recover

    data = file.read_bytes()
    if sum(1 for _ in DRAWN.finditer(data)) > MOST_ENTITIES:  # before ezdxf takes seconds for them
        raise InvalidInput(f"{file}: more than {MOST_ENTITIES} entities; allowed: no more")
    logging.getLogger("ezdxf").setLevel(logging.CRITICAL)  # what it says there is said here
    try:
        document = ezdxf.readfile(file)
        document.modelspace()  # a damaged file may have none
        return document, []
    except Exception as error:  # damaged files raise whatever the damage leads to
        first = _plain(error)
    repairs = [("", data)]
    unread: list[str] = []
    if not data.startswith(BINARY):
        tags, unread, commas = _tags(data)
        if unread or commas:
            repairs.clear()  # ezdxf would take what is no number as 0
        if commas:
            unread.insert(0, f"numbers with a comma in place of a point are read as meant ({commas})")
        repairs.append(("", _written(tags)))
        repairs.append((", without its tables, so that layers and line types are unknown", _written(_bare(tags))))
    for loss, text in repairs:
        try:
            document, auditor = recover.read(io.BytesIO(text))
            drawn = len(document.modelspace())
        except Exception:
            continue
        if drawn:
            lost = f", {len(auditor.errors)} of its mistakes remain" if auditor.errors else ""
            return document, [f"the file is damaged and was repaired{loss}{lost}: {first}", *unread]
    raise InvalidInput(f"{file}: cannot be read as DXF: {first}")


def _plain(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


# Repairs beyond those of ezdxf


def _tags(data: bytes) -> tuple[list[Tag], list[str], int]:
    """The group codes and values of a DXF file, without those that are none, with missing markers put in and an end;
    what was left out for it, and how many numbers have a comma."""
    lines = data.decode("utf-8", "surrogateescape").splitlines()
    tags: list[Tag] = []
    places: list[int] = []  # lines of the codes
    broken: set[int] = set()  # tags that ought to be numbers
    commas = i = 0
    while i + 1 < len(lines):
        code = lines[i].strip()
        if not CODE.fullmatch(code):
            i += 1  # out of step: the next line may be a code
            continue
        value = lines[i + 1].strip()
        kind = _kind(int(code))
        if COMMA.fullmatch(value) and not _is_value(kind, value):
            value, commas = value.replace(",", "."), commas + 1
            lines[i + 1] = value
        sound = _is_value(kind, value)
        if not sound and kind is float:  # a flag or a count that is none may be 0, a coordinate may not
            broken.add(len(tags))
        tags.append((code, lines[i + 1] if sound else "0"))
        places.append(i + 1)
        i += 2
    if tags and tags[-1] != ("0", "EOF"):
        tags += [("0", "ENDSEC"), ("0", "EOF")]
    tags, left_out = _sound(tags, places, broken)
    return _marked(_versioned(tags)), left_out, commas


def _sound(tags: list[Tag], places: list[int], broken: set[int]) -> tuple[list[Tag], list[str]]:
    """Without entities that have ``broken`` numbers, and a polyline's with one vertex that has; and which they are."""
    if not broken:
        return tags, []
    group_of = [(begin, end, tags[begin][1].strip()) for begin, end in _groups(tags)]
    out: list[Tag] = tags[: group_of[0][0]] if group_of else []
    left_out: list[str] = []
    k = 0
    while k < len(group_of):
        begin, end, kind = group_of[k]
        k += 1
        if kind == "POLYLINE":
            while k < len(group_of) and group_of[k][2] in ("VERTEX", "SEQEND"):
                end = group_of[k][1]
                k += 1
        if kind in STRUCTURE or broken.isdisjoint(range(begin, end)):
            out += tags[begin:end]
        else:
            left_out.append(f"{kind} in line {places[begin]}")
    return out, [f"what has numbers that cannot be read is left out: {some(left_out)}"] if left_out else []


def _kind(code: int) -> Callable[[str], Any]:
    """What a group code's values are: int, float or str."""
    ranges: tuple[tuple[Callable[[str], Any], Any], ...] = ((int, WHOLE), (float, REAL))
    return next((kind for kind, known in ranges if any(low <= code <= high for low, high in known)), str)


def _is_value(kind: Callable[[str], Any], value: str) -> bool:
    """Whether a value is of the kind that its code asks for."""
    try:
        kind(value)
    except ValueError:
        return False
    return True


def _groups(tags: list[Tag]) -> Iterator[tuple[int, int]]:
    """Where each entity, or whatever else begins with code 0, begins and ends."""
    return pairwise([*(i for i, (code, _) in enumerate(tags) if code == "0"), len(tags)])


def _marked(tags: list[Tag]) -> list[Tag]:
    """With the markers of :data:`SUBCLASS` where they are missing."""
    out: list[Tag] = []
    for begin, end in _groups(tags):
        group = tags[begin:end]
        marker = SUBCLASS.get(group[0][1].strip())
        if marker and not any(code == "100" and value.strip() == marker for code, value in group):
            split = next((i for i, (code, _) in enumerate(group[1:], 1) if code not in COMMON), len(group))
            before = [tag for tag in group[:split] if tag[0] != "100"]
            at = next((i for i, (code, _) in enumerate(before[1:], 1) if code not in ("5", "330")), len(before))
            group = [*before[:at], ("100", "AcDbEntity"), *before[at:], ("100", marker), *group[split:]]
        out += group
    return out


def _bare(tags: list[Tag]) -> list[Tag]:
    """Header, blocks and entities alone."""
    out: list[Tag] = []
    kept = True
    for i, (code, value) in enumerate(tags):
        if code == "0" and value.strip() == "SECTION":
            kept = i + 1 < len(tags) and tags[i + 1][1].strip() in ("HEADER", "BLOCKS", "ENTITIES")
        elif code == "0" and value.strip() == "EOF":
            kept = True
        if kept:
            out.append((code, value))
    return out


def _written(tags: list[Tag]) -> bytes:
    return "".join(f"{code}\n{value}\n" for code, value in tags).encode("utf-8", "surrogateescape")


def _versioned(tags: list[Tag]) -> list[Tag]:
    """With a version that has such markers, in place of the one in the header or of none."""
    old = next((i for i, (_, value) in enumerate(tags[:-1]) if value.strip() == "$ACADVER"), None)
    if old is not None:
        return [*tags[: old + 1], ("1", "AC1015"), *tags[old + 2 :]]
    head = [("0", "SECTION"), ("2", "HEADER"), ("9", "$ACADVER"), ("1", "AC1015")]
    at = next((i for i, (code, value) in enumerate(tags) if code == "2" and value.strip() == "HEADER"), None)
    return [*head, ("0", "ENDSEC"), *tags] if at is None else [*head, *tags[at + 1 :]]
