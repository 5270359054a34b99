"""Identification of the Z drive: bandwidth, damping and dead time, from commands and encoder alone.

A pseudo-random binary command moves the heads of a fleet; the model of :mod:`baselines.servo` (a velocity loop of
second order behind a dead time) is fitted to the encoder's course by least squares, machine by machine. The dead time
found counts from the middle of the gate, so it holds the 0.1 ms from there to the end of the period, and the latency.

The command has two levels. Both upward (*rolling*), friction is constant and the loop shows itself as it is; about
zero, friction holds the axis at each reversal, which delays and damps::

    python -m kerfgym.experiments.studies.identify
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import optimize, signal

from ...baselines import servo
from ...envs.control.stack import get
from ...envs.plant.controller import PERIOD
from ...envs.plant.fleet import Fleet
from ...envs.scenarios import Axis, Head, Scenario
from ..measure import rollout

PERIODS = 1200
"""Length of an experiment, control periods."""

BREAKAWAY = 60
"""Periods at the beginning that are not fitted."""

LEVELS = {"rolling": (4.0, 7.0), "about rest": (-1.5, 1.5)}
"""mm/s, of the command; 3 mm/s apart, so that the drive's jerk limit is not met."""

NOMINAL = Axis(
    bandwidth=80.0,
    zeta=0.8,
    dead_time=0.001,
    latency=0.0005,
    acceleration=14000.0,
    resonance=100.0,
    friction=800.0,
    bristle=0.005,
    stiction=1.4,
    stribeck=3.0,
)
"""The machine in the middle of the ranges in docs/physics.md#the-z-axis."""


@dataclass(frozen=True)
class Identified:
    """Fits of shape (machines,); ``true_bandwidth``: that the plants were given."""

    bandwidth: np.ndarray  # Hz
    zeta: np.ndarray
    dead_time: np.ndarray  # ms, from the middle of the gate
    rms: np.ndarray  # mm, of what the model leaves of the encoder's course
    true_bandwidth: np.ndarray


def command(levels: tuple[float, float], periods: int = PERIODS) -> np.ndarray:
    """A maximum-length binary sequence, mm/s, each bit 3 periods long."""
    bits, _ = signal.max_len_seq(9, length=-(-periods // 3))
    return np.where(np.repeat(bits, 3)[:periods], levels[1], levels[0])


def experiment(axis: Axis, seeds: Any, commands: np.ndarray) -> tuple[np.ndarray, Fleet]:
    """Encoder's courses, mm, shape (periods + 1, machines), under ``commands``; row 0 is before the first of them.

    The heads hang 12 mm below their set height, so the supervisor lets them go where they are told.
    """
    head, lasts = Head(noise=0.0, jitter=0.0, impulses=0.0, nominal=True), len(commands) * PERIOD
    scenario = Scenario(
        name="identification", duration=lasts, settle=0.0, feed=0.0, set_height=3.0, axis=axis, head=head
    )
    idle = get("idle")
    seeds = np.atleast_1d(np.asarray(seeds, np.uint64))
    fleet = rollout.fleet_for(scenario, idle, seeds)
    every = np.arange(fleet.size)
    fleet.set("job.set_height", every, 15.0)
    course = [fleet.column("signals.head_position")]
    for value in commands:
        fleet.set("hand.residual", every, value)
        fleet.advance()
        course.append(fleet.column("signals.head_position"))
    return np.array(course), fleet


def response(drive: servo.Drive, commands: np.ndarray) -> np.ndarray:
    """The model's course before each command acts, mm from the start, shape (periods,)."""
    unit = np.eye(6)
    step = np.array([servo.period(drive, 0.0, *row) for row in unit]).T
    a = np.array([[1.0, *step[0, :2]], [0.0, *step[1, :2]], [0.0, *step[2, :2]]])
    course = np.zeros(len(commands))
    for late, column in enumerate((5, 2, 3, 4)):  # the command, and those of 1, 2 and 3 periods ago
        sent = np.concatenate([np.zeros(late), commands])[: len(commands)]
        top, bottom = signal.ss2tf(a, step[:, [column]], np.array([[1.0, 0.0, 0.0]]), np.zeros((1, 1)))
        course += signal.lfilter(top[0], bottom, sent)
    return course


def fit(commands: np.ndarray, course: np.ndarray) -> tuple[servo.Drive, float]:
    """The drive whose response is nearest to an encoder's ``course``, mm, and the RMS difference, mm.

    The breakaway from rest costs some way that the model knows nothing of: the first :data:`BREAKAWAY` periods are left
    out, and a constant is free.
    """

    def off(x: np.ndarray) -> np.ndarray:
        left = (response(servo.Drive(*x), commands) - course[:-1])[BREAKAWAY:]
        return left - left.mean()

    start, ends, scale = [80.0, 0.8, 1.5], ([20.0, 0.3, 0.0], [250.0, 3.0, 2.999]), [50.0, 0.5, 0.5]
    found = optimize.least_squares(off, x0=start, bounds=ends, x_scale=scale, diff_step=1e-5)
    return servo.Drive(*found.x), float(np.sqrt(np.mean(found.fun**2)))


def identify(axis: Axis, seeds: Any, levels: tuple[float, float]) -> Identified:
    """Fits for the plants that ``axis`` gives for ``seeds``."""
    commands = command(levels)
    courses, fleet = experiment(axis, seeds, commands)
    fits = [fit(commands, course) for course in courses.T]
    bandwidth, zeta, dead_time = np.array([drive for drive, _ in fits]).T
    errors, omega = np.array([rms for _, rms in fits]), fleet.column("z.omega")
    return Identified(bandwidth, zeta, dead_time, errors, omega / (2 * np.pi))


def main() -> None:
    """Prints what is found on the nominal machine and over the suite's plants: mean, 5th and 95th percentile."""
    heading = ("bandwidth, Hz", "damping ratio", "dead time, ms")
    print(f"{'plants':<12}{'command':<12}" + "".join(f"{h:>22}" for h in heading) + f"{'left, µm':>10}")
    for plants, axis, seeds in (("nominal", NOMINAL, [0]), ("randomised", Axis(), range(100))):
        for name, levels in LEVELS.items():
            found = identify(axis, seeds, levels)
            cells = []
            for column in (found.bandwidth, found.zeta, found.dead_time):
                low, high = np.percentile(column, [5, 95])
                cells.append(f"{column.mean():.2f}" + (f" ({low:.2f}–{high:.2f})" if len(column) > 1 else ""))
            left = 1e3 * np.median(found.rms)
            print(f"{plants:<12}{name:<12}" + "".join(f"{c:>22}" for c in cells) + f"{left:>10.2f}")


if __name__ == "__main__":
    main()
