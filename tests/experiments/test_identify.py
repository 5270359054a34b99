"""Identification finds what the plants were given, and the laws' defaults are what it finds."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from kerfgym.baselines import lqg, mpc, servo
from kerfgym.experiments.studies import identify

# Without what the model leaves out.
IDEAL = replace(identify.NOMINAL, latency=0.0, friction=0.0, backlash=0.0, compliance=0.0, encoder=0.0, dac_bits=0.0)
GATE = 0.1
"""ms from the middle of the gate's substeps to the end of the period."""


def test_the_models_response_is_scipys():
    """A velocity loop and an integrator, simulated by scipy in steps of a tenth of a period."""
    drive = servo.Drive(70.0, 0.6, 1.3)
    commands = identify.command((-1.0, 2.0), 200)
    fine = np.concatenate([np.zeros(13), np.repeat(commands, 10)])[: 10 * len(commands)]
    w = 2 * np.pi * drive.bandwidth
    plant = signal.cont2discrete(([w * w], [1.0, 2 * drive.zeta * w, w * w, 0.0]), 1e-4)
    expected = signal.lfilter(np.ravel(plant[0]), plant[1], fine)[::10]
    assert np.ptp(expected) > 0.01
    assert identify.response(drive, commands) == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize(("bandwidth", "zeta", "late"), [(80.0, 0.8, 0.001), (50.0, 1.0, 0.002), (120.0, 0.6, 0.001)])
def test_an_ideal_drive_is_found_as_it_is(bandwidth, zeta, late):
    axis = replace(IDEAL, bandwidth=bandwidth, zeta=zeta, dead_time=late)
    found = identify.identify(axis, [0], identify.LEVELS["rolling"])
    assert found.true_bandwidth == pytest.approx(bandwidth)
    assert found.bandwidth == pytest.approx(bandwidth, rel=0.01)
    assert found.zeta == pytest.approx(zeta, rel=0.02)
    assert found.dead_time == pytest.approx(late * 1e3 + GATE, abs=0.03)
    assert found.rms < 1e-4


def test_friction_damps_about_rest_and_not_when_rolling():
    rolling, resting = (identify.identify(identify.NOMINAL, [0], identify.LEVELS[name]) for name in identify.LEVELS)
    assert rolling.zeta == pytest.approx(0.8, abs=0.05)
    assert resting.zeta > 1.2


def test_the_laws_defaults_are_what_is_identified_over_the_suites_plants():
    found = identify.identify(identify.Axis(), range(100), identify.LEVELS["rolling"])
    for law in (lqg, mpc):
        p = law.Params()
        assert p.bandwidth == pytest.approx(found.bandwidth.mean(), rel=0.02)
        assert p.zeta == pytest.approx(found.zeta.mean(), rel=0.02)
        assert p.dead_time == pytest.approx(found.dead_time.mean(), rel=0.02)
