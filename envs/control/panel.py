"""The operator's panel of one machine: gives commands, waits until they are carried out, and keeps a log.

The commands are those of the supervisor (CN102528288A), with the operator functions of Xi2023: home, centre, calibrate,
follow. One period of the panel is one control period of the machine; between two of them X may be told another feed,
so that sequences such as a frog-leap can be written down step by step (``baselines/sequences.py``).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import scenarios
from ..engine.deck import refuse_copy
from ..engine.quantity import InvalidInput, check_choice, did_you_mean
from ..plant import calibration, heads, supervisor
from ..plant.controller import PERIOD
from ..plant.fleet import Fleet
from ..scenarios import Scenario
from .stack import Stack, resolve

LEVEL = Scenario(name="level sheet", feed=0.0, set_height=1.0, head=scenarios.Head(impulses=0.0))
"""A level sheet under a machine with the randomised axis and head of the seed; nothing moves."""

CENTRE = 50.0
"""mm, where centring brings the head [A]."""

IN_POSITION, FOR = 0.1, 0.05
"""mm and s: the height must be that near the set height for that long (usual for height controllers, [P]); above 1 mm,
where the sensor's noise grows with the square of the height, a tenth of the set height [A]."""

PATIENCE = 30.0
"""s after which a command that is not carried out is given up."""

_FAR = 2.0
"""mm, height from which on a calibration begins with an approach."""

COMMANDS = ("stop", "home", "centre", "move", "calibrate", "follow", "hold", "protect")

CHANNELS = {
    "gap": "signals.gap",
    "height": "signals.height",
    "set_height": "signals.set_height",
    "head": "signals.head",
    "command": "supervisor.command",
    "velocity": "signals.velocity",
    "mode": "supervisor.mode",
    "alarm": "supervisor.alarm",
    "distance": "journey.here",
    "frequency": "signals.frequency",
}
"""What the log keeps of each period: mm, mm/s, Hz, indices into ``supervisor.MODES`` and ``supervisor.ALARMS``."""


@dataclass(frozen=True)
class Outcome:
    """How a command ended: carried out or not, after how many seconds, and with which alarm ("none")."""

    done: bool
    seconds: float
    alarm: str = "none"


class Panel:
    """One machine with its operator.

    Args:
        stack: controller that follows.
        scenario: sheet, head and axis.
        seed: of the scenario.
        gap: mm between nozzle and sheet at the start; default: that of the scenario.
        coast: mm by which the encoder is off before homing.
    """

    def __init__(
        self,
        stack: str | Stack = "observer",
        scenario: Scenario = LEVEL,
        seed: int = 0,
        gap: float | None = None,
        coast: float = 0.0,
    ) -> None:
        self.stack = resolve(stack)
        if self.stack.slot != "z" or self.stack.python:
            raise InvalidInput(f"a panel needs a compiled controller of the slot z; '{self.stack.name}' is none")
        self._pool = calibration.Pool(1)
        self._fleet = Fleet(1, self.stack.law, heads.POOL)
        scenarios.prepare(self._fleet, scenario, np.array([0]), np.array([seed]))
        self.stack.install(self._fleet, 0)
        self._fleet.set("job.request", 0, supervisor.STOP)
        self._fleet.set("start.coast", 0, coast)
        if gap is not None:
            self._fleet.set("start.gap", 0, gap)
        self._fleet.begin(0, scenarios.noise_keys(np.array([seed])))
        self._advance = self._fleet.stepper()
        self._views = {name: self._fleet.row(field) for name, field in CHANNELS.items()}
        self._phase, self._captured = self._fleet.row("supervisor.phase"), self._fleet.row("supervisor.captured")
        self._speed = self._fleet.row("path.feed")
        self._log: list[tuple[float, ...]] = []
        self.events: list[tuple[float, str]] = []

    def __reduce__(self) -> Any:
        refuse_copy(self)

    # ------------------------------------------------------------------------------------------- what there is to see

    def __getitem__(self, channel: str) -> float:
        """The momentary value of a channel."""
        return float(self._views[channel][0])

    @property
    def time(self) -> float:
        """s since the start."""
        return len(self._log) * PERIOD

    @property
    def position(self) -> float:
        """mm, the head's position as the machine knows it: off by what the encoder coasted until it is homed."""
        return float(self._fleet.column("signals.head_position")[0])

    @property
    def mode(self) -> str:
        """What the supervisor does, one of ``supervisor.MODES``."""
        return supervisor.MODES[int(self["mode"])]

    @property
    def alarm(self) -> str:
        """The latched alarm, one of ``supervisor.ALARMS``."""
        return supervisor.ALARMS[int(self["alarm"])]

    @property
    def collided(self) -> bool:
        """Whether the nozzle has touched the sheet so far."""
        return bool(self._fleet.column("tally.collided")[0])

    @property
    def lowest(self) -> float:
        """mm, the smallest gap so far."""
        return float(self._fleet.column("tally.lowest")[0])

    def log(self) -> dict[str, np.ndarray]:
        """Every channel of every period so far, and ``time`` in s."""
        table = np.asarray(self._log).reshape(-1, len(CHANNELS))
        return {"time": (np.arange(len(table)) + 1) * PERIOD, **dict(zip(CHANNELS, table.T, strict=True))}

    # --------------------------------------------------------------------------------------------------- time passes

    def wait(self, seconds: float) -> None:
        """Lets time pass."""
        for _ in range(round(seconds / PERIOD)):
            self.tick()

    def tick(self) -> None:
        """One control period."""
        self._advance()
        self._log.append(tuple(float(view[0]) for view in self._views.values()))

    def until(self, reached: Callable[[], bool], patience: float = PATIENCE) -> Outcome:
        """Lets time pass until ``reached`` says so, an alarm is raised, or patience ends."""
        start = self.time
        while self.time - start < patience:
            self.tick()
            if self["alarm"] != supervisor.NO_ALARM:
                return Outcome(False, self.time - start, self.alarm)
            if reached():
                return Outcome(True, self.time - start)
        return Outcome(False, self.time - start)

    @property
    def feed(self) -> float:
        """mm/s along x."""
        return float(self._speed[0])

    @feed.setter
    def feed(self, value: float) -> None:
        """Tells X another feed, from the next period on."""
        self._speed[0] = value

    # ------------------------------------------------------------------------------------------------------ commands

    def request(self, command: str, **job: float) -> None:
        """Gives a command without waiting for it.

        Args:
            command: one of :data:`COMMANDS`.
            job: fields of ``supervisor.Orders``.
        """
        check_choice(command, COMMANDS, "command")
        for name, value in job.items():
            self._fleet.set(f"job.{name}", 0, value)
        mode = "move" if command == "centre" else command
        self._fleet.set("job.request", 0, supervisor.MODES.index(mode))
        settings = ", ".join(f"{name} {value:g}" for name, value in job.items())
        self.events.append((self.time, f"{command} {settings}".strip()))

    def send(self, code: float) -> None:
        """Puts a number into the command's register as a bus would, whether or not it is a command."""
        self._fleet.set("job.request", 0, code)
        self.events.append((self.time, f"code {code:g}"))

    def stop(self) -> Outcome:
        """All motion stops; an alarm is acknowledged."""
        self.request("stop")
        start = self.time
        while self.time - start < PATIENCE:
            self.tick()
            if self["mode"] == supervisor.STOP and self["command"] == 0.0 and abs(self["velocity"]) < 0.05:
                return Outcome(True, self.time - start)
        return Outcome(False, self.time - start, self.alarm)

    def home(self) -> Outcome:
        """Up to the switch, down at 2 mm/s to the index pulse, where the encoder gets its zero (CN102528288A)."""
        self.request("home")
        return self.until(lambda: self.mode == "home" and self._phase[0] == 4.0)

    def move(self, target: float) -> Outcome:
        """To a position of the head along an S-curve (*idle positioning*), mm."""
        self._within("target", target, "job.low", "job.high", "mm")
        self.request("move", target=target)
        return self.until(lambda: self.mode == "move" and self._phase[0] == 2.0)

    def centre(self, position: float = CENTRE) -> Outcome:
        """To the rest position, mm (Xi2023)."""
        return self.move(position)

    def follow(self, height: float, speed: float | None = None) -> Outcome:
        """Follows at a set height (mm), no faster than ``speed`` (mm/s); waits until it is in position."""
        _check("height", height, 0.05, 9.0, "mm")
        if speed is not None:
            self._fleet.set("guard.follow_speed", 0, _check("speed", speed, 1.0, 1000.0, "mm/s"))
        self.request("follow", set_height=height)
        return self.until(self._settled(height))

    def _settled(self, height: float) -> Callable[[], bool]:
        near, wanted = 0, round(FOR / PERIOD)

        def reached() -> bool:
            nonlocal near
            near_enough = abs(self["height"] - height) <= max(IN_POSITION, 0.1 * height)
            inside = self.mode == "follow" and bool(self._captured[0]) and near_enough
            near = near + 1 if inside else 0
            return near >= wanted

        return reached

    def protect(self, height: float) -> Outcome:
        """Single-sided protection: the head stands still, and is lifted where the sheet comes nearer (mm)."""
        self.request("protect", protect=_check("height", height, 0.05, 9.0, "mm"))
        return self.until(lambda: self.mode == "protect")

    def calibrate(self, distance: float = calibration.SPAN, speed: float = 10.0) -> Outcome:
        """Touches the sheet, rises by ``distance`` (mm) at ``speed`` (mm/s), and reads heights from the new table.

        The sheet is felt for slowly, so a head that is far from it first comes near on the table that it has.

        Raises:
            CalibrationRefused: the run is not fit to use; the old table stays.
        """
        _check("distance", distance, 1.0, 20.0, "mm")
        _check("speed", speed, 1.0, 50.0, "mm/s")
        if self["height"] > _FAR:
            near = self.follow(1.0)
            if not near.done:
                return near
        self.request("calibrate", rise=distance, rise_speed=speed)
        start, most = self.time, round((distance / speed + PATIENCE) / PERIOD)
        frequency, height = heads.samples_of(self._fleet, self.tick, most)
        if self.mode != "calibrate" or self._phase[0] != 2.0:
            return Outcome(False, self.time - start, self.alarm)
        radius = self._fleet.get("sensor").radius
        self._pool[0] = self.table = calibration.build(frequency, height, radius, distance, speed)
        self._fleet.read_from(self._pool, 0)
        self.events.append((self.time, f"calibrated: {self.table.usable} samples, rating {self.table.rating}"))
        return Outcome(True, self.time - start)

    # --------------------------------------------------------------------------------------------------------- faults

    def break_(self, what: str) -> None:
        """Breaks a part of the machine: ``cable`` (of the sensor, off), ``index`` (pulse never comes), ``switch`` (of
        the home position, never closes)."""
        faults: dict[str, Callable[[], Any]] = {
            "cable": lambda: self._fleet.replay(np.full(2, 2.0 * heads.beyond(np.array([0]))[0])),
            "index": lambda: self._fleet.set("job.indexed", 0, 0.0),
            "switch": lambda: self._fleet.set("job.switch", 0, 1e9),
        }
        if what not in faults:
            raise InvalidInput(f"nothing named '{what}' to break; {did_you_mean(what, tuple(faults))}")
        faults[what]()
        self.events.append((self.time, f"{what} breaks"))

    def _within(self, name: str, value: float, low: str, high: str, unit: str) -> None:
        _check(name, value, float(self._fleet.column(low)[0]), float(self._fleet.column(high)[0]), unit)


def _check(name: str, value: float, low: float, high: float, unit: str) -> float:
    if not low <= value <= high:
        raise InvalidInput(f"{name} = {value:g} {unit} is out of range; allowed: {low:g} to {high:g} {unit}")
    return value
