"""The machines of another make do what their equations say."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from kerfgym.tests.oracle.foreign import Foreign, Running

FREE = replace(Foreign(), coulomb=0.0, static=0.0, viscous=0.0, ripple=0.0, smooth=1.0, bits=32.0, count=1e-9,
               delay=0.0, noise=0.0, impulses=0.0)  # fmt: skip


def moved(make, commands, start=20.0):
    runs = Running(make, start)
    return np.array([runs.step(command) for command in commands])


@pytest.mark.parametrize("weight", [0.0, 0.3])
def test_without_friction_and_limits_the_drive_is_its_linear_loop(weight):
    p = replace(FREE, weight=weight)
    omega = 2 * np.pi * p.natural
    # Speed over command: the controller and the current loop's lag in front of the motor, the filter behind it.
    kp, ki, lag, late = 2 * p.damping * omega, omega**2, p.current, p.filtered
    above = np.polymul([weight * kp, ki], [late, 1.0])
    below = np.polyadd(np.polymul(np.polymul([lag, 1.0], [1.0, 0.0, 0.0]), [late, 1.0]), [kp, ki])
    time = np.arange(0.0, 0.2, 1e-5)
    asked = np.where(time < 0.06, 2.0, np.where(time < 0.13, -1.0, 0.5))
    _, speed, _ = signal.lsim((above, below), asked, time)
    way = np.cumsum(speed) * 1e-5
    made = moved(p, asked[::100])[:, 0] - 20.0
    np.testing.assert_allclose(made, way[99::100], atol=2e-4)


def test_what_is_stuck_breaks_loose_when_the_loop_has_wound_up():
    p = replace(FREE, static=950.0, coulomb=700.0, smooth=0.0)
    wound = p.static / ((2 * np.pi * p.natural) ** 2 * 2.0)  # s until the integral of 2 mm/s holds the static force
    made, free = (moved(each, np.full(30, 2.0))[:, 0] - 20.0 for each in (p, replace(p, static=0.0, coulomb=0.0)))
    stuck = int(1e3 * wound)
    assert stuck == 2
    assert np.all(made[:stuck] < 1e-6)
    assert np.all(free[:stuck] > 1e-5)
    assert made[stuck + 4] > 1e-3


def test_a_command_acts_after_the_delay():
    p = replace(FREE, delay=3.4e-3, current=1e-5, filtered=1e-5)
    made = moved(p, np.full(8, 5.0))[:, 0] - 20.0
    assert np.all(np.abs(made[:3]) < 1e-9)
    assert made[3] > 1e-5
    late = moved(replace(p, delay=0.0), np.full(8, 5.0))[:, 0] - 20.0
    assert late[0] > made[3] > 0.0


def test_play_swallows_the_way_back():
    p = replace(FREE, play=0.01, damping=1.5)
    slow = np.concatenate([np.full(300, 2.0), np.zeros(200), np.full(300, -2.0), np.zeros(200)])
    runs = Running(p, 5.0)
    gaps = []
    for command in slow:
        encoder, _ = runs.step(command)
        gaps.append(runs.gap - encoder)
    assert gaps[450] == pytest.approx(-0.005, abs=2e-5)
    assert gaps[-1] == pytest.approx(0.005, abs=2e-5)


def test_the_count_is_of_the_frequency_of_a_thick_disc_over_a_plane():
    p = replace(FREE, edge=1e-6)
    for gap in (0.3, 1.0, 3.0):
        _, f = Running(p, gap).step(0.0)
        c = (1e9 / (2 * np.pi * f)) ** 2 / p.inductance - p.body
        ideal = 8.8541878e-3 * np.pi * (p.face**2 - p.bore**2) / gap
        fringe = 2 * 8.8541878e-3 * p.face * (np.log(8 * np.pi * p.face / gap) - 1.0)  # Kirchhoff, infinitely thin
        assert c == pytest.approx(ideal + fringe, rel=2e-3)


def test_a_nozzle_on_the_sheet_stops_the_oscillator():
    sheet = np.array([0.0, 0.0, 3.0, 3.0])
    runs = Running(FREE, 1.0, sheet, 10.0, 1000.0)
    seen = [runs.step(0.0)[1] > 0 for _ in range(25)]
    assert all(seen[:12])
    assert not any(seen[20:])
