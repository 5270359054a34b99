"""Single numbers in a sentence, between marks that a reader of the page does not see::

    It scores <!-- n: following.self-tuning.score .2f -->3.51<!-- /n --> µm.

Behind the path of the number (:func:`store.number`) may stand how it is written, in Python's words; without, three
significant digits.
"""

import math
import re
from typing import Any

from ...envs.plant.quantity import InvalidInput
from . import store

MARKED = re.compile(r"(<!-- n: (?P<path>[\w-]+\.[^\s…]+)(?: (?P<form>\S+))? -->)(?P<shown>.*?)(<!-- /n -->)", re.DOTALL)
NOT_YET = "(not measured yet)"


def filled(text: str, where: str = "") -> str:
    """A page with every marked number made anew.

    Raises:
        InvalidInput: a number that no study has, or a form that fits no number.
    """

    def made(found: re.Match[str]) -> str:
        try:
            shown = NOT_YET
            if store.read(found["path"].partition(".")[0]) is not None:
                shown = written(store.number(found["path"]), found["form"] or ".3g")
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
