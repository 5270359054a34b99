"""G and M words: which exist, which exclude each other in a line, and which letters belong to them.

[P] LinuxCNC 2.9, "G-Codes", "M-Codes", "RS274/NGC Overview" (modal groups, order of execution).
"""

from typing import NamedTuple

AXES = "XYZABCUVW"
STAY = "ABCUVW"
"""Axes that this machine does not have: they may be named, but not moved."""


class Code(NamedTuple):
    """``group``: only one of a group may stand in a line; ``letters`` that may come with it; ``harmless``: what it is,
    if it changes nothing about the path and is only listed; ``refused``: why, if it is an error."""

    group: str
    letters: str = ""
    harmless: str = ""
    refused: str = ""


CYCLES = ("G73", "G81", "G82", "G83", "G84", "G85", "G86", "G87", "G88", "G89", "G74")

_COMPENSATION = "cutter compensation is not computed; let the CAM system offset the path"
_TURNED = "a lathe's cycle or thread is not a path in the plane of the sheet"

CODES: dict[str, Code] = {
    **{name: Code("motion", AXES + "@^") for name in ("G0", "G1")},
    **{name: Code("motion", AXES + "IJKRP@^") for name in ("G2", "G3")},
    "G5": Code("motion", "XYIJPQ"), "G5.1": Code("motion", "XYIJ"), "G5.2": Code("motion", "XYPL"),
    "G5.3": Code("motion"), "G80": Code("cycle end"),
    **{name: Code("motion", AXES + "RLPQIJK@^") for name in CYCLES},
    **{name: Code("motion", refused=_TURNED) for name in (
        "G33", "G33.1", "G70", "G71", "G71.1", "G71.2", "G72", "G72.1", "G72.2", "G76",
    )},
    **{name: Code("motion", refused="a probe's answer is known to the machine only") for name in (
        "G38.2", "G38.3", "G38.4", "G38.5", "G38",
    )},
    **{name: Code("plane") for name in ("G17", "G18", "G19")},
    **{name: Code("plane", refused="this machine has no U, V and W") for name in ("G17.1", "G18.1", "G19.1")},
    "G90": Code("distance"), "G91": Code("distance"), "G90.1": Code("centre"), "G91.1": Code("centre"),
    "G93": Code("feed"), "G94": Code("feed", harmless="feed per minute"), "G95": Code("feed"),
    "G20": Code("units"), "G21": Code("units"),
    "G40": Code("compensation", harmless="no cutter compensation"),
    **{name: Code("compensation", "DL", refused=_COMPENSATION) for name in ("G41", "G42", "G41.1", "G42.1")},
    "G43": Code("tool", "H", "tool length"), "G43.1": Code("tool", AXES), "G43.2": Code("tool", AXES + "H"),
    "G49": Code("tool", harmless="no tool length"),
    "G98": Code("retract", harmless="retract of cycles"), "G99": Code("retract", harmless="retract of cycles"),
    **{name: Code("system") for name in ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")},
    "G61": Code("control", harmless="exact path"), "G61.1": Code("control", harmless="exact stop"),
    "G64": Code("control", "PQ", "path blending"),
    "G96": Code("spindle mode", "SD$", "constant surface speed"),
    "G97": Code("spindle mode", "S$", "constant spindle speed"),
    "G7": Code("lathe"), "G8": Code("lathe"),
    "G15": Code("polar", harmless="no polar coordinates"), "G69": Code("rotation", harmless="no rotation"),
    "G4": Code("not modal", "P", "dwell"), "G10": Code("not modal", AXES + "PRLIJQ"), "G53": Code("not modal"),
    **{name: Code("not modal", AXES) for name in ("G28", "G28.1", "G30", "G30.1", "G52", "G92")},
    **{name: Code("not modal") for name in ("G92.1", "G92.2", "G92.3")},
    "M0": Code("stop", harmless="pause"), "M1": Code("stop", harmless="pause"), "M2": Code("stop"),
    "M30": Code("stop"), "M60": Code("stop", harmless="pause"), "M98": Code("stop", "PL"), "M99": Code("stop"),
    **{name: Code("output", "P") for name in ("M62", "M63", "M64", "M65")},
    "M66": Code("output", "PELQ", "waiting for an input"),
    "M67": Code("output", "EQ"), "M68": Code("output", "EQ"),
    "M6": Code("tool change", harmless="tool change"), "M61": Code("tool change", "Q", "tool number"),
    **{name: Code("spindle", "$") for name in ("M3", "M4", "M5")},
    "M19": Code("spindle", "RQP$", "oriented spindle"),
    **{name: Code("coolant", harmless="coolant or gas") for name in ("M7", "M8", "M9")},
    "M48": Code("override", harmless="overrides"), "M49": Code("override", harmless="overrides"),
    "M50": Code("override", "P", "feed override"), "M51": Code("override", "P$", "spindle override"),
    "M52": Code("override", "P", "adaptive feed"), "M53": Code("override", "P", "feed stop"),
    "M190": Code("material", "P", "QtPlasmaC's choice of material"),
    **{name: Code("state") for name in ("M70", "M71", "M72", "M73")},
}  # fmt: skip
"""By name."""

HARMLESS = {"T": "tool", "S": "spindle speed or power", "Z": "heights: the head follows the sheet"}
"""Letters that are listed."""

READ = "G0 to G5.3, G7, G8, G10, G17 to G21, G28, G30, G40, G43, G49 to G64, G73, G80 to G99, M0 to M9, M30, M48 to M73"
"""Those of use, for messages."""
