"""Scenarios: named, seeded distributions over machine, sheet and journey.

A scenario is physics only; what a user tunes belongs to the controller's stack. It is frozen and validated; unknown or
misspelt keys and values out of range are errors that name what is allowed. :func:`load` reads one from TOML,
:meth:`Scenario.to_toml` writes it, :func:`suite` gives the frozen suites.
"""

from .distributions import bounds
from .hardware import Axis, Gantry, Head, Optics
from .machines import Machine
from .measured import MOST_HEIGHT, height_map, measured_head, profile, signal
from .preparing import GANTRIES, axes_of, prepare
from .reading import parse, read
from .schema import Scenario, journey
from .section import Section
from .shipped import called, checked_rules, core, is_own, load, rules, suite, suites
from .splits import PAIRS, SPLITS, noise_keys, pairs_of
from .surface import Bulge, Holes, Map, Profile, Random, Sheet, Steps, Vibration, Wave
from .travel import Circle, Corners, Job, Reading, Turns, contour, read_drawing
from .writing import living

__all__ = [
    "GANTRIES",
    "MOST_HEIGHT",
    "PAIRS",
    "SPLITS",
    "Axis",
    "Bulge",
    "Circle",
    "Corners",
    "Gantry",
    "Head",
    "Holes",
    "Job",
    "Machine",
    "Map",
    "Optics",
    "Profile",
    "Random",
    "Reading",
    "Scenario",
    "Section",
    "Sheet",
    "Steps",
    "Turns",
    "Vibration",
    "Wave",
    "axes_of",
    "bounds",
    "called",
    "checked_rules",
    "contour",
    "core",
    "height_map",
    "is_own",
    "journey",
    "living",
    "load",
    "measured_head",
    "noise_keys",
    "pairs_of",
    "parse",
    "prepare",
    "profile",
    "read",
    "read_drawing",
    "rules",
    "signal",
    "suite",
    "suites",
]
