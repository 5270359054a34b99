"""The modal state of a G-code programme, and what the programme may ask of it."""

import math
from dataclasses import dataclass, field

from .drawing import UNITS
from .gcode_beam import Switches
from .gcode_frames import Frames, numbered_position
from .gcode_parameters import Key


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
        if isinstance(key, int):
            return self.tool if key == 5400 else numbered_position(frames, key, self.size)
        name = key[1:-1]
        here = frames.here()
        flags = {
            "_imperial": self.units == "inches", "_metric": self.units != "inches", "_absolute": self.absolute,
            "_incremental": not self.absolute, "_inverse_time": self.feed_mode == "G93",
            "_units_per_minute": self.feed_mode == "G94", "_units_per_rev": self.feed_mode == "G95",
            "_ijk_absolute_mode": self.absolute_centre, "_lathe_diameter_mode": self.diameter,
            "_lathe_radius_mode": not self.diameter, "_retract_old_z": self.retract_old,
            "_retract_r_plane": not self.retract_old, "_spindle_on": 0 in self.switches.spindles,
            "_ccomp": False, "_task": False, "_spindle_rpm_mode": True, "_spindle_css_mode": False,
        }  # fmt: skip
        if name in flags:
            return float(flags[name])
        numbers = {
            "_x": here.xy.real / self.size, "_y": here.xy.imag / self.size, "_z": here.z / self.size,
            **dict.fromkeys(("_a", "_b", "_c", "_u", "_v", "_w"), 0.0),
            "_abs_x": frames.at.xy.real / self.size, "_abs_y": frames.at.xy.imag / self.size,
            "_abs_z": frames.at.z / self.size,
            "_feed": 0.0 if math.isnan(self.feed) else self.feed / (1.0 if self.feed_mode == "G93" else self.size),
            "_rpm": 0.0 if math.isnan(self.switches.speed) else self.switches.speed,
            "_coord_system": 530.0 + 10.0 * frames.system if frames.system < 7 else 584.0 + frames.system,
            "_plane": 10.0 * float(self.plane[1:]), "_motion_mode": 10.0 * float(self.motion[1:] or -0.1),
            "_current_tool": self.tool,
        }  # fmt: skip
        return numbers.get(name)
