"""Random changes to files: of bytes, of words and numbers, of lines, of JSON's and TOML's values.

A change is a function of the random stream and the bytes; what it gives depends on nothing else, so a case is found
again by its number.
"""

import json
import random
import re
from collections.abc import Callable, Iterator
from typing import Any

import tomli_w

from ....envs.engine.quantity import InvalidInput
from ....envs.safety import files

NUMBERS = (
    *("0", "-1", "1", "-0.0", "1e300", "-1e300", "1e-300", "1e12", "1e999", "nan", "inf", "-inf", "2147483648"),
    *("9223372036854775808", "18446744073709551616", "1e308", "5e-324", "9" * 30, "9" * 400, "9" * 5000),
    *("0x10", "1_0", "1.5.2", "3,5", ""),
)

WORDS = (
    *("null", "true", "[]", "{}", '""', "../../x", "/dev/zero", "/etc/passwd", "pipe", "x.py:Mine", "\\u0000", "ä€𝄞"),
    *("a" * 256, "a" * 5000, "%s%n", "${HOME}", "{{7*7}}", "<script>", "#", ";", "(", "]", "}", "]]>", "&a;"),
    *("\t", "\r", " = "),
)

VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 0.5, 1e300, float("nan"), float("inf"), 2**63 - 1, 2**63, 10**30, 10**400),
    *("", "x", "1", "../../x", "/dev/zero", "/proc/self/mem", "pipe", "evil.py:Mine", "a\0b", "\ud800"),
    *([], {}, [None], [[[]]], {"a": 1}, {"": {}}, ["x", 1], [1.5, "x"], "a" * 256, "a" * 3000, "9" * 5000),
)

KEYS = ("x", "../x", "", "a\0b", "a" * 300, "__proto__", "é")

CODINGS = ("utf-8-sig", "utf-16", "utf-16-le", "utf-32", "latin-1", "cp1252", "shift-jis", "utf-7")

PILES = (b"[", b"(", b"{", b'{"a":', b"<g>", b"a.", b"\n[[a]]", b"-", b"\0")
"""Of which there may be thousands, within one another."""

_NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_KEY = re.compile(rb'"[^"\n]{1,60}"[ \t]*[:=][ \t]*|(?m:^)[\w.]{1,60}[ \t]*=[ \t]*')
_WORD = re.compile(rb"[A-Za-z_][\w.\-]*")

MOST = 4_000_000
"""Bytes of a changed file; what is larger than its limit has tests of its own."""

Change = Callable[[random.Random, bytes], bytes]


def _somewhere(draw: random.Random, data: bytes) -> tuple[int, int]:
    start = draw.randrange(len(data) + 1)
    return start, min(len(data), start + int(2 ** draw.uniform(0, 10)))


def flip(draw: random.Random, data: bytes) -> bytes:
    """Some bytes become others."""
    out = bytearray(data)
    for _ in range(draw.choice((1, 1, 2, 8, 40))):
        if out:
            out[draw.randrange(len(out))] = draw.randrange(256)
    return bytes(out)


def cut(draw: random.Random, data: bytes) -> bytes:
    """A piece is left out."""
    a, b = _somewhere(draw, data)
    return data[:a] + data[b:]


def end(draw: random.Random, data: bytes) -> bytes:
    """The rest is missing."""
    return data[: draw.randrange(len(data) + 1)]


def repeat(draw: random.Random, data: bytes) -> bytes:
    """A piece is there many times."""
    a, b = _somewhere(draw, data)
    return data[:a] + data[a:b] * draw.choice((2, 3, 50, 2000)) + data[b:]


def move(draw: random.Random, data: bytes) -> bytes:
    """A piece is elsewhere."""
    a, b = _somewhere(draw, data)
    rest = data[:a] + data[b:]
    c = draw.randrange(len(rest) + 1)
    return rest[:c] + data[a:b] + rest[c:]


def lines(draw: random.Random, data: bytes) -> bytes:
    """Lines are left out, doubled, swapped or repeated."""
    out = data.split(b"\n")
    for _ in range(draw.choice((1, 2, 5))):
        i, j = draw.randrange(len(out)), draw.randrange(len(out))
        kind = draw.randrange(4)
        if kind == 0 and len(out) > 1:
            del out[i]
        elif kind == 1:
            out.insert(j, out[i])
        elif kind == 2:
            out[i], out[j] = out[j], out[i]
        else:
            out[i:i] = [out[j]] * draw.choice((10, 3000))
    return b"\n".join(out)


def number(draw: random.Random, data: bytes) -> bytes:
    """Numbers become extreme."""
    for _ in range(draw.choice((1, 1, 2, 6))):
        found = list(_NUMBER.finditer(data))
        if not found:
            return data
        at = draw.choice(found)
        data = data[: at.start()] + draw.choice(NUMBERS).encode() + data[at.end() :]
    return data


def word(draw: random.Random, data: bytes) -> bytes:
    """A word becomes another one, of the file or a hostile one."""
    found = list(_WORD.finditer(data))
    if not found:
        return data
    at, other = draw.choice(found), draw.choice(found)[0]
    new = other if draw.random() < 0.5 else draw.choice(WORDS).encode()
    return data[: at.start()] + new + data[at.end() :]


def insert(draw: random.Random, data: bytes) -> bytes:
    """Something is there that should not be."""
    at = draw.randrange(len(data) + 1)
    pile = draw.choice(PILES) * draw.choice((20, 40, 3000))
    new = draw.choice((draw.randbytes(8), draw.choice(WORDS).encode(), pile, pile, b"\xff\xfe", b"\0"))
    return data[:at] + new + data[at:]


def recode(draw: random.Random, data: bytes) -> bytes:
    """The text has a letter that is not in ASCII, and another coding, which nothing says."""
    text = data.decode("utf-8", "replace")
    at = draw.randrange(len(text) + 1)
    return f"{text[:at]}ü{text[at:]}".encode(draw.choice(CODINGS), "replace")


def double(draw: random.Random, data: bytes) -> bytes:
    """A key of JSON or TOML is there twice, with different values."""
    found = list(_KEY.finditer(data))
    if not found:
        return data
    at = draw.choice(found)
    text = json.dumps(draw.choice(VALUES)).encode()
    comma = b"," if at[0].rstrip().endswith(b":") else b"\n"
    return data[: at.start()] + at[0] + text + comma + data[at.start() :]


def value(draw: random.Random, data: bytes) -> bytes:
    """A value of JSON or TOML becomes one of another kind, is left out, or gets another key."""
    text = data.decode("utf-8", "replace")
    for parse, write in ((files.json_of, json.dumps), (files.toml_of, tomli_w.dumps)):
        try:
            tree = parse(text, "")
        except InvalidInput:
            continue
        _changed(draw, tree)
        try:
            return write(tree).encode()
        except (TypeError, ValueError):  # TOML has no null
            return data
    return data


def _changed(draw: random.Random, tree: Any) -> None:
    """Changes the tree at some place: any is as likely as another, or, as often, any level."""
    places = list(_places(tree))
    if not places:
        return
    if draw.random() < 0.5:
        level = draw.choice(sorted({depth for depth, _, _ in places}))
        places = [place for place in places if place[0] == level]
    _, tree, key = draw.choice(places)
    kind = draw.randrange(6)
    if kind == 0:
        del tree[key]
    elif kind == 1 and isinstance(tree, dict):
        tree[draw.choice((*KEYS, f"{key}x"))] = tree.pop(key)
    elif kind == 2:
        other = draw.choice(list(tree) if isinstance(tree, dict) else range(len(tree)))
        tree[key], tree[other] = tree[other], tree[key]
    elif kind == 3:
        for _ in range(draw.choice((1, 2, 20, 40))):
            tree[key] = draw.choice(([tree[key]], {"a": tree[key]}))
    else:
        tree[key] = draw.choice(VALUES)


def _places(tree: Any, depth: int = 0) -> Iterator[tuple[int, Any, Any]]:
    """Every table or list of a tree with each of its keys, and how deep it lies."""
    if isinstance(tree, dict | list):
        for key in list(tree) if isinstance(tree, dict) else range(len(tree)):
            yield depth, tree, key
            yield from _places(tree[key], depth + 1)


CHANGES: tuple[Change, ...] = (
    *(flip, cut, end, repeat, move, lines, number, number),
    *(word, word, insert, insert, recode, double, value, value),
)
"""As often as each is here."""


def mutated(draw: random.Random, data: bytes, other: bytes) -> bytes:
    """One to four changes; now and then the head of one file and the tail of another of its kind. Of JSON and TOML half
    have changed values only, since else most would not even be parsed."""
    if draw.random() < 0.5:
        other_values = value(draw, data)
        for _ in range(draw.choice((0, 0, 1, 3))):
            other_values = value(draw, other_values)
        if other_values != data:
            return other_values
    if draw.random() < 0.05:
        data = data[: draw.randrange(len(data) + 1)] + other[draw.randrange(len(other) + 1) :]
    for _ in range(draw.choice((1, 1, 1, 2, 4))):
        data = draw.choice(CHANGES)(draw, data)
    return data[:MOST]
