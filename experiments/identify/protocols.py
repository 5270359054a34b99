"""The protocols on a simulated machine: logs that hold only what a real one could know.

The machine is the kernel's own, its sheet a flat plate. A host moves the head with velocity commands, as a motion
controller would, and sees the encoder alone. Every protocol takes less than two minutes.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from ...envs import scenarios
from ...envs.control.stack import get, resolve
from ...envs.engine.quantity import InvalidInput, check_choice
from ...envs.plant import supervisor
from ...envs.plant.controller import PERIOD
from ...envs.plant.fleet import Fleet
from ...envs.scenarios import Scenario, machines
from ..measure import rollout
from . import square
from .log import PROTOCOLS, Log

HEIGHTS = (0.6, 1.5, 5.0)
"""mm above the plate, of the rest protocol."""

REST, SWEEP, FOLLOW = 12.0, 3.0, 40.0
"""s: at each height, longest of a sweep, of following."""

GAIN = 5.0
"""1/s, with which the host goes to a height; no axis of 20 ms dead time and 25 Hz overshoots with it."""

LOW, HIGH = 15.0, 60.0
"""mm, between which the fast moves of the motion protocol go."""

NEAR, JOLTS, SPEEDS, SLACK = 1.2, 8, (80.0, 120.0, 180.0, 250.0), 4e-3
"""Jolts within the sensor's range: mm of the height from which on, how many at each speed, mm/s, and mm by which they
begin higher for each mm/s, since a drive whose jerk is limited may come back further than it went."""

BEFORE = 300
"""Samples before a touch of the plate that are left out of the log."""

LEAST = 0.6
"""mm below which the host lets the head come at no time."""

DITHER = 0.05
"""mm/s, added to the commands, so that steps of the converter average out."""


def record(machine: Any, protocol: str, seed: int = 0, scenario: Any = None) -> Log:
    """The log of a protocol.

    Args:
        machine: name, file or tables of a machine, see :func:`machines.load`.
        protocol: one of :data:`PROTOCOLS`.
        seed: draws the machine, if it has distributions, and its noise.
        scenario: whose sheet is followed, and how: a name, a file or a scenario. Default: the suite's waves.

    Raises:
        InvalidInput: a scenario for another protocol than *follow*, which alone has a sheet.
    """
    check_choice(protocol, PROTOCOLS, "protocol")
    cuts, rng = machines.load(machine), np.random.default_rng(seed)
    if protocol == "follow":
        return _follow(cuts, seed, scenarios.load("wavy" if scenario is None else scenario))
    if scenario is not None:
        raise InvalidInput(f"the {protocol} protocol has no sheet of a scenario; only follow has")
    if protocol == "square":
        return square.record(cuts, seed)
    flat = Scenario(name=protocol, duration=200.0, settle=0.0, feed=0.0, set_height=1.0)
    rows: list[list[float]] = []
    warned: tuple[str, ...] = ()
    fleet, look, command = _begun(machines.put_on(flat, cuts), seed, 0.2 if protocol == "sweep" else HEIGHTS[0])
    if protocol == "sweep":
        fleet.set("job.request", 0, supervisor.CALIBRATE)
        for _ in range(round(SWEEP / PERIOD)):
            fleet.advance()
            rows.append(look())
            if fleet.column("supervisor.phase")[0] == 2.0:
                break
    else:
        script = {"rest": _rest, "motion": _motion}[protocol](rng)
        asked = next(script)
        while True:
            command[0] = asked
            fleet.advance()
            rows.append(look())
            if rows[-1][2] == 0.0:  # it touched the plate: what comes then is an alarm's
                seconds = len(rows) * PERIOD
                if len(rows) < 2 * BEFORE:
                    raise InvalidInput(
                        f"the {protocol} protocol: after {seconds:.4g} s the head touches the plate already, or its "
                        "sensor tells nothing; nothing can be recorded"
                    )
                warned = (f"{protocol}.csv: the head touched the plate after {seconds:.4g} s; the log ends before",)
                del rows[-BEFORE:]
                break
            try:
                asked = script.send(rows[-1][0])
            except StopIteration:
                break
    encoder, sent, frequency = np.asarray(rows).T
    columns = {"time": np.arange(len(rows)) * PERIOD, "encoder": encoder, "command": sent, "frequency": frequency}
    return Log(f"{protocol}.csv", protocol, columns, warned)


def _begun(scenario: Scenario, seed: int, gap: float) -> tuple[Fleet, Callable[[], list[float]], np.ndarray]:
    """A machine over a plate, what can be seen of it, and where its command is written."""
    fleet = rollout.fleet_for(scenario, get("idle"), [seed], change=lambda f: f.set("start.gap", 0, gap))
    fleet.set("job.set_height", 0, 1e3)  # so that no guard of the supervisor ever acts
    seen = [fleet.row(f"signals.{name}") for name in ("head_position", "command", "frequency")]
    converted = _converted(fleet)

    def look() -> list[float]:
        encoder, command, frequency = (float(each[0]) for each in seen)
        return [encoder, converted(command), frequency]

    return fleet, look, fleet.row("hand.residual")


def _converted(fleet: Fleet) -> Callable[[Any], Any]:
    """What the D/A converter makes of a command: a controller knows the count that it has sent."""
    step = float(fleet.column("z.dac")[0])
    return lambda command: np.rint(command / step) * step if step > 0 else command


def _to(rng: Any, height: float, seconds: float, fastest: float = 50.0) -> Any:
    """Goes to a height and stays."""
    encoder, start = np.nan, True
    for _ in range(round(seconds / PERIOD)):
        asked = 0.0 if start else float(np.clip(GAIN * (height - encoder), -fastest, fastest))
        asked += DITHER * rng.uniform(-1, 1) if abs(asked) > 1.0 else 0.0
        encoder, start = (yield asked), False
    return encoder


def _rest(rng: Any) -> Any:
    for height in HEIGHTS:
        yield from _to(rng, height, 2.0)
        for _ in range(round(REST / PERIOD)):
            yield 0.0


def _motion(rng: Any) -> Any:
    """Random steps of five sizes about a height, reversals, full-speed moves, jolts near the plate.

    Between them the host goes back and waits.
    """
    yield 0.0
    middle = 0.5 * (LOW + HIGH) - 10.0
    for level, hold in ((1.0, 25), (4.0, 15), (15.0, 8), (60.0, 15), (200.0, 20)):
        yield from _to(rng, middle, 1.0)
        yield from _steps(rng, middle, level, hold, 2.0)
    yield from _to(rng, 25.0, 1.0)
    for rate in (5.0, 20.0, 60.0):  # slow reversals, mm/s²
        for k in range(round(1.6 / PERIOD)):
            way = np.mod(k * PERIOD * rate / 6.0, 2.0)
            yield 6.0 * (2.0 * min(way, 2.0 - way) - 1.0) + DITHER * rng.uniform(-1, 1)
    encoder = yield 0.0
    for _ in range(4):  # each from and to another place, since moves that are alike share their roundings
        encoder = yield from _to(rng, LOW + rng.uniform(0, 2), 1.0, 100.0)
        top, low = HIGH - 20.0 - rng.uniform(0, 6), LOW + 20.0 + rng.uniform(0, 4)
        while encoder < top:
            encoder = yield 3000.0
        for _ in range(40):
            yield 0.0
        encoder = yield 0.0
        while encoder > low:
            encoder = yield -3000.0
        for _ in range(120):
            yield 0.0
    for level in SPEEDS:
        near = NEAR + SLACK * level
        yield from _to(rng, near, 2.5 if level == SPEEDS[0] else 1.0, 30.0)
        for _ in range(200):
            yield 0.0
        for _ in range(JOLTS):
            speed, lasts = level * rng.uniform(0.9, 1.1), int(rng.integers(7, 14))
            for command in (speed, -speed):  # up and stop, which opens the free play; down again
                for _ in range(lasts):
                    yield command
                for _ in range(int(rng.integers(60, 120))):
                    yield 0.0
            yield from _to(rng, near, 0.15)


def _steps(rng: Any, about: float, level: float, hold: int, seconds: float, room: float = 8.0) -> Any:
    """Random steps of the command, kept within ``room`` of a height."""
    encoder, left, asked, last = np.nan, 0, 0.0, about
    for _ in range(round(seconds / PERIOD)):
        if left == 0:
            left, away = int(rng.integers(1, 2 * hold)), 0.0 if np.isnan(encoder) else encoder - about
            # A choice of sign that leans back keeps the head near without a loop.
            up = rng.uniform(-1, 1) > 2.0 * away / room
            asked = (1.0 if up else -1.0) * level * rng.uniform(0.3, 1.0)
        left -= 1
        speed = (encoder - last) / PERIOD
        last = encoder if not np.isnan(encoder) else about
        low = not np.isnan(encoder) and encoder + 0.05 * min(speed, 0.0) < LEAST + 0.4
        encoder = yield (abs(level) if low else asked + DITHER * rng.uniform(-1, 1))


def _follow(cuts: machines.Machine, seed: int, scenario: Scenario) -> Log:
    """Closed loop along a real sheet: the shipped reference law over that of a scenario."""
    scenario = scenario.varied(duration=FOLLOW)
    scenario, stack = machines.put_on(scenario, cuts), resolve("xi2023-improved")
    fleet = rollout.fleet_for(scenario, stack, [seed])
    names = ("head_position", "command", "frequency", "height", "set_height")
    seen, x, rows = [fleet.row(f"signals.{name}") for name in names], fleet.row("journey.here"), []
    for _ in range(scenario.steps):
        fleet.advance()
        rows.append([float(each[0]) for each in (*seen, x)])
    encoder, sent, frequency, height, wanted, x_at = np.asarray(rows).T
    height[frequency == 0] = 0.0
    time = np.arange(len(rows)) * PERIOD
    sent = _converted(fleet)(sent)
    columns = {"time": time, "encoder": encoder, "command": sent, "frequency": frequency, "height": height}
    return Log("follow.csv", "follow", {**columns, "set_height": wanted, "x": x_at})
