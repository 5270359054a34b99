"""The modal state of a G-code programme, and what the programme may ask of it."""

import math
from dataclasses import dataclass, field
from typing import Any

from .drawing import UNITS
from .gcode_beam import Switches
from .gcode_frames import Frames
from .gcode_parameters import Key

SET_BY: dict[str, tuple[str, Any]] = {
    **{name: ("plane", name) for name in ("G17", "G18", "G19")},
    **{"G20": ("units", "inches"), "G21": ("units", "mm")},
    **{"G90": ("absolute", True), "G91": ("absolute", False)},
    **{"G90.1": ("absolute_centre", True), "G91.1": ("absolute_centre", False)},
    **{"G98": ("retract_old", True), "G99": ("retract_old", False)},
    **{"G7": ("diameter", True), "G8": ("diameter", False)},
    "G80": ("motion", ""),
}
"""What each word makes of which mode."""


@dataclass
class Modes:
    """What stays until another word changes it; M70 and M72 keep and restore ``motion`` to ``feed_mode``."""

    units: str = "mm"
    motion: str = ""
    plane: str = "G17"
    absolute: bool = True
    absolute_centre: bool = False
    feed: float = math.nan  # as programmed: mm/min, 1/min or mm/rev; nan: open
    feed_mode: str = "G94"
    diameter: bool = False  # X is one (G7)
    retract_old: bool = True  # G98
    old_z: float = 0.0  # before the canned cycles, mm
    cycle: dict[str, float] = field(default_factory=dict)  # sticky R and Z of canned cycles
    tool: float = 0.0
    switches: Switches = field(default_factory=Switches)

    @property
    def size(self) -> float:
        """mm of the unit of length."""
        return UNITS[self.units]

    def told(self, key: Key, frames: Frames) -> float | None:
        """What the interpreter tells of itself; None where it is not asked for that."""
        here = frames.here()
        x, y, z = (each / self.size for each in (here.xy.real, here.xy.imag, here.z))
        if isinstance(key, int):
            return {5400: self.tool, 5420: x, 5421: y, 5422: z}.get(key)
        name = key[1:-1]
        flags = {
            "_imperial": self.units == "inches",
            "_metric": self.units != "inches",
            "_absolute": self.absolute,
            "_incremental": not self.absolute,
            "_inverse_time": self.feed_mode == "G93",
            "_units_per_minute": self.feed_mode == "G94",
            "_units_per_rev": self.feed_mode == "G95",
            "_ijk_absolute_mode": self.absolute_centre,
            "_lathe_diameter_mode": self.diameter,
            "_lathe_radius_mode": not self.diameter,
            "_retract_old_z": self.retract_old,
            "_retract_r_plane": not self.retract_old,
            "_spindle_on": 0 in self.switches.spindles,
            "_spindle_rpm_mode": True,
            **dict.fromkeys(("_ccomp", "_task", "_spindle_css_mode"), False),
        }
        if name in flags:
            return float(flags[name])
        numbers = {
            "_x": x,
            "_y": y,
            "_z": z,
            **dict.fromkeys(("_a", "_b", "_c", "_u", "_v", "_w"), 0.0),
            "_abs_x": frames.at.xy.real / self.size,
            "_abs_y": frames.at.xy.imag / self.size,
            "_abs_z": frames.at.z / self.size,
            "_feed": 0.0 if math.isnan(self.feed) else self.feed / (1.0 if self.feed_mode == "G93" else self.size),
            "_rpm": 0.0 if math.isnan(self.switches.speed) else self.switches.speed,
            "_coord_system": 530.0 + 10.0 * frames.system if frames.system < 7 else 584.0 + frames.system,
            "_plane": 10.0 * float(self.plane[1:]),
            "_motion_mode": 10.0 * float(self.motion[1:] or -0.1),
            "_current_tool": self.tool,
        }
        return numbers.get(name)
