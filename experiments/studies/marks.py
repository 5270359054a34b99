"""Single numbers in a sentence, and what a sentence claims of them, in marks that a reader of the page does not see::

    It scores <!-- n: following.self-tuning.score .2f -->3.51<!-- /n --> µm.
    It is closer than every fixed law. <!-- holds: following.self-tuning.score < following.pid.score -->

Behind the path of a number (:func:`recorded.number`) may stand how it is written, in Python's words; without, three
significant digits. A claim compares a number by ``<``, ``>`` or ``=`` with another, with a constant or with a word. It
guards a sentence without numbers: a test fails when it is no longer so.
"""

import math
import re
from typing import Any

from ...envs.engine.quantity import InvalidInput
from . import recorded

MARKED = re.compile(r"(<!-- n: (?P<path>[\w-]+\.[^\s…]+)(?: (?P<form>\S+))? -->)(?P<shown>.*?)(<!-- /n -->)", re.DOTALL)
CLAIM = re.compile(r"<!-- holds: (?P<left>[\w-]+\.[^\s…]+) (?P<sign>[<>=]) (?P<right>[^\s…]+) -->")
NOT_YET = "(not measured yet)"


def filled(text: str, where: str = "") -> str:
    """A page with every marked number made anew.

    Raises:
        InvalidInput: a number that no study has, or a form that fits no number.
    """

    def made(found: re.Match[str]) -> str:
        try:
            shown = NOT_YET
            if recorded.read(found["path"].partition(".")[0]) is not None:
                shown = written(recorded.number(found["path"]), found["form"] or ".3g")
        except InvalidInput as error:
            raise InvalidInput(f"{where}: {error}") from None
        return f"{found[1]}{shown}{found[5]}"

    return MARKED.sub(made, text)


def written(value: Any, form: str = ".3g") -> str:
    """A number in words; a dash for none.

    Raises:
        InvalidInput: the form fits no number.
    """
    if value is None:
        return "–"
    if value in ("inf", "-inf"):
        value = math.inf if value == "inf" else -math.inf
    if isinstance(value, str):
        return value
    if not math.isfinite(value):
        return "∞" if value > 0 else "−∞"
    try:
        text = format(value, form)
    except ValueError:
        raise InvalidInput(f"'{form}' is no form of a number; such as .2f, .3g, .0%") from None
    if "e" in text and abs(value) >= 1:
        text = f"{float(text):.0f}"
    return text.replace("-", "−").replace("%", " %")


def broken(text: str) -> list[str]:
    """The claims of a page that stored results do not bear out, each with what they say."""
    out = []
    for found in CLAIM.finditer(text):
        claim = f"{found['left']} {found['sign']} {found['right']}"
        try:
            left, right = recorded.number(found["left"]), _value(found["right"])
        except InvalidInput as error:
            out.append(f"{claim}: {error}")
            continue
        if not _holds(left, found["sign"], right):
            out.append(f"{claim}: it is {left} and {right}")
    return out


def _value(word: str) -> Any:
    """A constant, a recorded number, or the word itself."""
    try:
        return float(word)
    except ValueError:
        return recorded.number(word) if "." in word else word


def _holds(left: Any, sign: str, right: Any) -> bool:
    if sign == "=":
        return left is not None and left == right
    known = [float(each) for each in (left, right) if isinstance(each, int | float) or each in ("inf", "-inf")]
    return len(known) == 2 and (known[0] < known[1] if sign == "<" else known[0] > known[1])
