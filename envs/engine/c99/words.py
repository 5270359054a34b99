"""Words: what a name may not be, what C lacks, and a docstring without its markup."""

import re

from ..quantity import in_order

WIDTH = 100
"""Columns of a line, at most, where it can be broken."""

KEYWORDS = frozenset(
    in_order(
        "auto break case char const continue default do double else enum extern float for goto if inline int long "
        "register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while "
        "bool true false abs fabs floor sqrt exp log pow rint fma sin cos tan main y0 y1 yn j0 j1 jn gamma index NULL "
        "EOF INFINITY NAN HUGE_VAL"
    )
)
"""Words that a name of ours must not be."""

HELPERS = {
    "smaller": (
        "{real} a, {real} b",
        "{real}",
        "b < a ? b : a",
        "The smaller; the first, where they cannot be compared.",
    ),
    "larger": (
        "{real} a, {real} b",
        "{real}",
        "b > a ? b : a",
        "The larger; the first, where they cannot be compared.",
    ),
    "smaller_int": ("int a, int b", "int", "b < a ? b : a", "The smaller."),
    "larger_int": ("int a, int b", "int", "b > a ? b : a", "The larger."),
    "whole_part": (
        "{real} x",
        "int",
        "x > -1e9{f} ? (x < 1e9{f} ? (int)x : 1000000000) : (x <= -1e9{f} ? -1000000000 : 0)",
        "The whole part; of what is no number 0, and never beyond a billion.",
    ),
    "modulo": (
        "int a, int b",
        "int",
        "a % b + (a % b != 0 && (a < 0) != (b < 0) ? b : 0)",
        "What a / b, rounded down, leaves.",
    ),
    "floored": ("int a, int b", "int", "a / b - (a % b != 0 && (a < 0) != (b < 0) ? 1 : 0)", "a / b, rounded down."),
    "bits_of": (
        "double x",
        "uint64_t",
        "pun both; both.number = x; return both.bits",
        "The 64 bits of a number.",
    ),
    "number_of": (
        "uint64_t bits",
        "double",
        "pun both; both.bits = bits; return both.number",
        "The number with these 64 bits.",
    ),
    "place_in": ("int i, int n", "int", "i < 0 ? 0 : (i < n ? i : n - 1)", "A place in an array of n numbers."),
}
"""Parameters, answer, expression and meaning of the few functions that C lacks."""


def safe(name: str) -> str:
    """A name that is no word of C's."""
    return f"{name}_" if name in KEYWORDS or name in HELPERS else name


def plain(text: str) -> str:
    """A docstring's words without the marks of its markup, and without what would end a comment."""
    text = re.sub(r":\w+:`~?\.*([^`]*)`", r"\1", text).replace("``", "").replace("|", "|")
    return text.replace("*/", "* /").replace("/*", "/ *")
