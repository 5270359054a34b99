"""Evidence range: the settings that stand behind the figures of a cut, and how far a run lies outside of them.

Two ranges, which are not the same:

* *calibrated*: dross, roughness and whether it cuts through come from a model that was fitted to a few published cuts.
  Within the settings of those cuts a figure is calibrated; outside it is *extrapolated*: shown and marked, but not
  ranked. Of materials whose coefficients are assumed nothing is calibrated.
* *published*: settings that a document prints, with a result or without one. By default a machine obeys process
  commands only within these, so that nothing is optimised outside of them; ``extrapolate = true`` in a scenario's
  ``[job]`` lifts that.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..plant.published import Excess, Range

QUALITY = ("dross", "roughness", "through", "kerf", "taper")
"""Metrics that are figures of the cut's model."""


@dataclass(frozen=True)
class Setting:
    """One setting: fields of :class:`plant.published.Range` with their values, what they mean, where they come from.

    ``values`` are calibrated; ``printed`` holds those that were published further than that, without a result.
    """

    name: str
    values: dict[str, float]
    words: str
    source: str
    printed: dict[str, float] = field(default_factory=dict)
    printed_words: str = ""
    printed_source: str = ""


C45 = (
    Setting("feed", {"feed_low": 200 / 60, "feed_static": 500 / 60, "feed_high": 1000 / 60},
            "3.33 to 8.33 mm/s without dither, up to 16.7 mm/s with ±0.3 mm of it", "Huang2024 Table 2"),
    Setting("power", {"power_low": 1.0, "power_high": 1.0}, "the nominal one",
            "not published; one effective power was fitted to all three cuts"),
    Setting("frequency", {"frequency_low": 2000.0, "frequency_high": 2000.0}, "2 kHz", "Huang2024 Table 2",
            {"frequency_high": 4000.0}, "2 to 4 kHz", "Huang2024 Table 1, no result"),
    Setting("amplitude", {"amplitude": 0.3}, "up to ±0.3 mm, equal in x and y", "Huang2024 Tables 1 and 2; the ellipse "
            "of eq. 12 has no numbers"),
    Setting("depth", {"deep_low": 1.0, "deep_high": 1.0}, "up to ±1 mm", "Huang2024 Table 2",
            {"deep_high": 5.0}, "up to ±1 mm at 2 kHz, ±5 mm at 4 kHz", "Huang2024 Table 1, no result"),
    Setting("focus", {"focus": 0.1}, "the recipe's ±0.1 mm", "a third of the thickness: CN102528288A; tolerance [A]"),
    Setting("standoff", {"standoff": 0.05}, "the recipe's ±0.05 mm", "1 mm: CN102528288A; tolerance [A]"),
    Setting("gas pressure", {"pressure": 0.05}, "the nominal one ±5 %", "not published; tolerance [A]"),
    Setting("shape", {}, "circular", "Huang2024 eq. 12; no result is given for the hat"),
)  # fmt: skip
"""C45, 10 mm: the three cuts of Huang2024's Table 2, and what its Table 1 prints beyond them."""

RANGES = {"c45-10": C45}
"""Settings by material; of all others the coefficients are assumed."""

_WORDS = {
    "feed": ("feed", "{:.3g} mm/s"),
    "power": ("power", "{:.0%}"),
    "frequency": ("dither frequency", "{:.0f} Hz"),
    "amplitude": ("dither amplitude", "{:.3g} mm"),
    "ellipse": ("dither x against y", "{:.3g} mm"),
    "depth": ("focus dither", "{:.3g} mm"),
    "focus": ("focus", "{:.3g} mm"),
    "standoff": ("standoff", "{:.3g} mm"),
    "pressure": ("gas pressure", "{:.0%}"),
}
ASSUMED = "coefficients assumed, nothing calibrated"
_PLAIN = {"material": ASSUMED, "shape": "dither shape"}

assert {*_WORDS, *_PLAIN} == set(Excess._fields)

COLUMNS = tuple(f"beyond_{name}" for name in Excess._fields)
"""Columns of a run's largest excesses, in tables of runs."""


def calibrated(material: str) -> Range:
    """The settings of a material's calibrated cuts; what lies outside is extrapolated."""
    settings = RANGES.get(material)
    if settings is None:
        return Range()
    values: dict[str, Any] = {name: value for setting in settings for name, value in setting.values.items()}
    return Range(known=True, **values)


def published(material: str, extrapolate: bool = False) -> Range:
    """The settings that were published of a material; with ``extrapolate`` commands beyond them are obeyed too."""
    printed: dict[str, Any] = {
        name: value for setting in RANGES.get(material, ()) for name, value in setting.printed.items()
    }
    found = calibrated(material)
    return found._replace(bounded=found.known and not extrapolate, **printed)


def words(excess: Any) -> str:
    """What lies outside and by how much, such as ``feed by 8.33 mm/s, focus by 1 mm``; empty if nothing does.

    Args:
        excess: mapping with the fields of :class:`plant.published.Excess`, with or without ``beyond_`` before them.
    """
    found = {name: float(excess.get(name, excess.get(f"beyond_{name}", 0.0))) for name in Excess._fields}
    parts = [text for name, text in _PLAIN.items() if name == "material" and found[name] > 0]
    parts += [f"{_WORDS[n][0]} by {_WORDS[n][1].format(x)}" for n, x in found.items() if n in _WORDS and x > 0]
    return ", ".join(parts + [text for name, text in _PLAIN.items() if name == "shape" and found[name] > 0])


def pooled(runs: Any) -> str:
    """:func:`words` of the largest excess in a table of runs; empty if all lie inside or nothing is known of it."""
    if "extrapolated" not in runs or not len(runs) or not (runs["extrapolated"].to_numpy(float) > 0).any():
        return ""
    return words({name: float(np.nanmax(runs[name].to_numpy(float))) for name in COLUMNS if name in runs})


def follows(runs: Any) -> bool:
    """Whether a table of runs is of height followers, whose thin sheet has assumed coefficients."""
    return "rms_true" in runs


def said(text: str) -> str:
    """What stands beside a figure: that it is extrapolated and in what, or that it is not."""
    return f"extrapolated: {text}" if text else "within the calibrated settings"


def table(material: str) -> list[tuple[str, str, str, str, str]]:
    """Setting, calibrated range and its source, published range and its source, for people.

    Empty if nothing is calibrated.
    """
    return [
        (s.name, s.words, s.source, s.printed_words or s.words, s.printed_source or s.source)
        for s in RANGES.get(material, ())
    ]
