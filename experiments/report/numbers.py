"""Numbers in words: as many digits as are known, and the unit's sign."""

import math
from collections.abc import Iterable
from typing import Any


def number(value: float | None) -> str:
    """Three significant digits in plain notation; a dash for what is missing."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    return fixed(value, decimals(value))


def decimals(value: float, digits: int = 3) -> int:
    """Decimals that show so many significant digits of a value, at most six."""
    if not math.isfinite(value) or value == 0:
        return digits - 1
    size = math.floor(math.log10(abs(value)))
    if round(abs(value), digits - 1 - size) >= 10.0 ** (size + 1):
        size += 1
    return min(max(digits - 1 - size, 0), 6)


def fixed(value: float, places: int) -> str:
    """So many decimals, with a minus sign and without a negative zero; thin spaces from 10 000 on."""
    if not math.isfinite(value):
        return number(value)
    text = f"{value:,.{places}f}" if abs(value) >= 9999.5 else f"{value:.{places}f}"
    if float(text.replace(",", "")) == 0:
        text = text.lstrip("-")
    return text.replace(",", "\u202f").replace("-", "−")


def known(low: float, high: float, value: float) -> int:
    """Decimals that an interval leaves meaning to: two significant digits of its half width, at least those of three
    significant digits less one."""
    half = 0.5 * (high - low)
    if not math.isfinite(half) or half <= 0:
        return decimals(value)
    return min(max(decimals(half, 2), decimals(value, 2)), decimals(value, 4))


def ends(row: Any, name: str) -> tuple[float, float, float]:
    """The lower end of a figure, itself, and its upper end; NaN where there are none."""
    low, value, high = (float(row.get(f"{name}{end}", math.nan)) for end in ("_low", "", "_high"))
    return low, value, high


def span(low: float, high: float, places: int) -> str:
    """An interval: ``7.6–8.2``; with signs ``−0.4 to 0.3``; a dash if there is none."""
    if math.isnan(low) or math.isnan(high):
        return "–"
    a, b = fixed(low, places), fixed(high, places)
    return f"{a} to {b}" if low < 0 else f"{a}–{b}"


def times(ratio: float) -> str:
    """A ratio for a sentence: one decimal, two if it is near 1."""
    return f"{ratio:.2f}" if ratio < 1.95 else f"{ratio:.1f}" if ratio < 9.95 else f"{ratio:.0f}"


def percent(share: float) -> str:
    """A share in per cent, never rounded to certainty."""
    if not math.isfinite(share):
        return "–"
    value = 100 * share
    if 0 < value < 0.1:
        return "< 0.1 %"
    if 99.9 < value < 100:
        return "> 99.9 %"
    return f"{value:.0f} %" if 1 <= value <= 99 or value in (0, 100) else f"{value:.1f} %"


def share_of_period(ratio: float) -> str:
    """Of the control period, in per cent."""
    return f"{100 * ratio:.2g} %" if math.isfinite(ratio) else "–"


def part(some: Any, whole: Any) -> str:
    """A count of a count, ``3/240``."""
    return "–" if whole is None or not whole or math.isnan(whole) else f"{int(some)}/{int(whole)}"


def count(many: int, word: str) -> str:
    """``1 seed``, ``20 seeds``, ``12 000 runs``."""
    return f"{many:,}".replace(",", "\u202f") + f" {word}{'s' * (many != 1)}"


def listed(names: Iterable[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    words = list(names)
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""


def million(steps: float) -> str:
    """Steps of a budget in millions."""
    value = 1e-6 * steps
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"
