"""Margins by simulation against python-control's of the linear loop, and what they say of loops that are not linear."""

import math

import control
import numpy as np
import pytest
from scipy.linalg import expm

from kerfgym.envs.plant.controller import PERIOD
from kerfgym.envs.stack import get, resolve
from kerfgym.experiments import margins as measured
from kerfgym.experiments.margins import CANDIDATES, DELAYS, GAINS, Bench, Margins, margins
from kerfgym.experiments.stability import CORNERS

T = PERIOD
CENTRE = 0.125e-3
"""s from the centre of a gate of 0.25 ms to the end of its period."""

NO_FILTER = "xi2023-improved:filter.kind=none"


def axis(bandwidth, zeta, resonance):
    """Head over velocity command without dead time, continuous: drive of second order, integrator, mode (PHYSICS §2)."""
    w, wr = 2 * np.pi * bandwidth, 2 * np.pi * resonance
    drive = control.tf([w**2], [1, 2 * zeta * w, w**2])
    mode = control.tf([wr**2], [1, 2 * 0.05 * wr, wr**2])
    return control.ss(drive * control.tf([1], [1, 0]) * (0.9 + 0.1 * mode))


def loop(kv, corner, window=1):
    """Open loop of a P law on a mean of ``window`` samples: held command, dead time, reading at the gate's centre."""
    bandwidth, zeta, dead_time, resonance = corner
    plant = axis(bandwidth, zeta, resonance)
    size = plant.nstates
    both = np.zeros((size + 1, size + 1))
    both[:size, :size], both[:size, size:] = plant.A, plant.B
    whole, to_gate = expm(both * T), expm(both * (T - CENTRE))
    reading = plant.C @ to_gate[:size]
    held = control.ss(whole[:size, :size], whole[:size, size:], reading[:, :size], reading[:, size:], T)
    periods = round(dead_time / T) + 1  # and the one after which the reading is there
    mean = control.tf(np.ones(window) / window, [1] + [0] * (window - 1), T)
    return kv * control.ss(mean) * control.ss(control.tf([1], [1] + [0] * periods, T)) * held


def linear(kv, window=1):
    """Gain margin and dead-time margin (ms), worst over the corner plants."""
    gains, delays = [], []
    for corner in CORNERS:
        gm, pm, _, _, wg, _ = control.stability_margins(loop(kv, corner, window), returnall=True)
        gains.append(min(g for g in gm if g > 1))
        delays.append(min(np.deg2rad(pm) / wg))
    return min(gains), 1e3 * min(delays)


def ideal(bench):
    """Takes friction, backlash, quantisation and limits out of a bench's machines."""
    every = np.arange(bench.fleet.size)
    for name in ("friction", "backlash", "dac", "encoder"):
        bench.fleet.set(f"z.{name}", every, 0.0)
    for name in ("speed", "acceleration", "jerk"):
        bench.fleet.set(f"z.{name}", every, 1e12)
    return bench


@pytest.mark.parametrize(("spec", "kv", "window"), [
    (f"{NO_FILTER},law.kv=50", 50.0, 1), (f"{NO_FILTER},law.kv=90", 90.0, 1),
    ("xi2023-ma:filter.window=5,law.kv=50", 50.0, 5),
])  # fmt: skip
def test_the_margins_of_a_p_law_are_those_of_the_linear_loop(spec, kv, window):
    stack = resolve(spec)
    found = ideal(Bench(stack)).measure(stack)
    gain, delay = linear(kv, window)
    assert found.gain == pytest.approx(gain, rel=0.03)
    assert found.delay_ms == pytest.approx(delay, rel=0.05)
