"""For which scenarios a bound is known: those of which every part is either an ingredient or given away knowingly.

A part that is not listed here, because it came later, makes a scenario one without a bound; it is not passed over.
"""

from dataclasses import fields
from typing import Any

from ...envs import scenarios
from ...envs.engine.quantity import InvalidInput
from ...envs.scenarios import Axis, Bulge, Corners, Head, Random, Scenario, Sheet, Steps, Turns, Vibration, Wave

KNOWN: dict[type, frozenset[str]] = {
    part: frozenset(names.split())
    for part, names in {
        Scenario: "name summary version duration settle share feed set_height start_above guard exempt corners turns "
        "cut_by axis head sheet gantry optics",
        Axis: "bandwidth zeta dead_time latency acceleration jerk speed resonance resonance_zeta compliance friction "
        "bristle stiction stribeck backlash encoder dac_bits",
        Head: "plate noise jitter drift warming impulses impulse_samples impulse_height impulse_falloff impulse_spread "
        "bursts burst burst_length plasma oscillator nominal table",
        Sheet: "tilt tilt_y length waves vibrations random steps bulge",
        Wave: "amplitude wavelength direction exponent reference",
        Vibration: "frequency amplitude zeta",
        Random: "rms exponent rolloff",
        Steps: "count height spacing",
        Bulge: "height width growth x y",
        Corners: "pitch feed acceleration",
        Turns: "length count waves random vibrations impulses",
    }.items()
}
"""Fields of each part of a scenario that a bound reads, or that cannot make it wrong."""

_PATH = "a path other than a straight line"
_WORDS = {"job": _PATH, "path": _PATH, "circle": _PATH, "signal": "a replayed signal"}


def unknown(scenario: Scenario) -> list[str]:
    """What a scenario has for which there is no ingredient."""
    found = _beyond(scenario)
    if scenarios.bounds(scenario.start_above) != (0.0, 0.0):
        found.append("a descent")
    if scenario.sheet.length != Sheet().length and scenarios.bounds(scenario.sheet.tilt) != (0.0, 0.0):
        found.append("a slope that turns back elsewhere")
    return found


def _beyond(part: Any) -> list[str]:
    found = []
    for field in fields(part):
        value = getattr(part, field.name)
        if field.name not in KNOWN[type(part)]:
            found += [_WORDS.get(field.name, field.name)] * (value != field.default)
            continue
        for each in value if isinstance(value, tuple) else (value,):
            if type(each) in KNOWN:
                found += _beyond(each)
    return found


def check(scenario: Scenario) -> None:
    """Raises :class:`InvalidInput` for a scenario for which there is no bound."""
    if there := unknown(scenario):
        raise InvalidInput(f"no bound is known for scenario '{scenario.name}': it has {', '.join(there)}")
