"""The inverse of Wu's drive: what it asks for, and what it learns."""

import numpy as np
import pytest
from scipy.interpolate import lagrange

from kerfgym.baselines import inverse
from kerfgym.envs import scenarios
from kerfgym.envs.control import stack as stacks
from kerfgym.envs.engine.lanes import W, unflat
from kerfgym.envs.plant import gantry, xy_axes
from kerfgym.envs.plant.fleet import Fleet
from kerfgym.envs.tasks import workshop

PERIOD = 4e-3


def travel(
    scenario: str,
    controller: str,
    drive: dict[str, float],
    seeds: int = 1,
    preset: str = "wu",
    law: dict[str, float] | None = None,
) -> Fleet:
    """Machines that have done a job with drives as given."""
    team, case = stacks.team(f"xy={controller}"), scenarios.load(scenario).varied(gantry={"preset": preset})
    every = np.arange(seeds)

    def change(fleet: Fleet) -> None:
        assert fleet.gantries
        for name, value in drive.items():
            fleet.gantries.set(f"xy.{name}", every, value)
        for name, value in (law or {}).items():
            fleet.gantries.set_law("xy", name, every, value)

    fleet = workshop.fleet_for(case, team, every, change=change)
    fleet.advance(int(1.2 * len(workshop.programme(case, team).x)))
    return fleet


def contour_rms(fleet: Fleet) -> np.ndarray:
    """µm"""
    assert fleet.gantries
    return 1e3 * np.sqrt(fleet.gantries.column("sums.contour2") / fleet.gantries.column("sums.length"))


def believed(fleet: Fleet) -> inverse.State:
    assert fleet.gantries
    numbers = fleet.gantries._view[0, int(gantry.S_LAW) // W :, 0]
    return unflat(inverse.State, numbers[: len(inverse.State._fields)].tolist())


@pytest.mark.parametrize(("phase", "at"), [(0.0, 0.0), (1.0, 0.5)])
def test_the_reference_is_the_quartic_through_five_points_issued_late_enough_to_know_them(phase, at):
    """SciPy's polynomial; places count in interpolations of 8 ms from the third newest point."""
    h, rng = 2 * PERIOD, np.random.default_rng(3)
    speeds = 30.0 + rng.normal(0.0, 3.0, 4)  # the newest first
    points = h * np.concatenate([[0.0], np.cumsum(speeds[::-1])])  # the oldest first
    curve = lagrange(h * np.arange(-2, 3), points)
    w0, w1, w2, w3 = speeds
    r = inverse.reference(w0, w1, w2, w3, phase, 2.0, PERIOD)
    issued = points[3] + at * (points[4] - points[3])
    assert r.behind == pytest.approx(issued - curve(h * (at - 0.25)))
    assert (r.v, r.a, r.j) == pytest.approx(tuple(curve.deriv(n)(h * at) for n in (1, 2, 3)))


def test_the_model_of_a_drive_is_the_drive():
    """Over a servo period, against the machine's own axis."""
    p, law = xy_axes.Params(dac=0.0, encoder=0.0, acceleration=1e9), inverse.Params()
    gains = xy_axes.gains(p, 1e-3)
    axis = xy_axes.at_rest(0.0)._replace(part_1=12.0, part_2=-3.0, command=20.0 * p.gain * 1.03)
    for _ in range(4):
        axis = xy_axes.moved(p, gains, axis, 1e-3)
    model = inverse.driven(law, inverse.Gains(plus=1.03), inverse.Model(12.0, -3.0), 20.0, 0.0, p.t1, p.t2, PERIOD)
    assert model == pytest.approx((axis.part_1, axis.part_2, axis.position), rel=1e-9)


def test_it_learns_the_gains_of_four_directions_and_how_slow_the_drives_are():
    drive = {"x_plus": 1.04, "x_minus": 1.02, "y_plus": 0.97, "y_minus": 0.95, "t1": 0.0214, "t2": 0.00535}
    learnt = believed(travel("contour-rosette", "wu-inverse", drive))
    for name in ("x_plus", "x_minus", "y_plus", "y_minus"):
        assert getattr(learnt, name) == pytest.approx(drive[name], abs=0.003)
    assert learnt.slower == pytest.approx(1.07, abs=0.01)


def test_without_learning_it_leaves_what_unequal_drives_leave():
    drive = {"x_plus": 1.04, "x_minus": 1.04, "y_plus": 0.96, "y_minus": 0.96}
    blind = contour_rms(travel("contour-circle", "wu-inverse", drive, law={"learn": 0.0, "doubt": 1e6}))
    seeing = contour_rms(travel("contour-circle", "wu-inverse", drive))
    assert seeing[0] < 1.2
    assert blind[0] > 15 * seeing[0]


@pytest.mark.parametrize("scenario", ["contour-gear", "contour-mismatch"])
def test_it_is_five_times_as_close_as_the_stiff_loop_on_drives_that_it_does_not_know(scenario):
    stiff, learning = (contour_rms(travel(scenario, name, {}, seeds=4)) for name in ("wu-stiff", "wu-inverse"))
    assert np.sqrt((learning**2).mean()) < 0.2 * np.sqrt((stiff**2).mean())


def test_told_the_constants_of_other_axes_it_is_five_times_as_close_as_the_stiff_loop_on_them():
    modern = {"t1": 3.0, "t2": 1.0, "gain": 1.0, "instants": 1.0}
    stiff = contour_rms(travel("contour-gear", "wu-stiff", {}, preset="modern"))
    assert contour_rms(travel("contour-gear", "wu-inverse", {}, preset="modern", law=modern)) < 0.2 * stiff
    assert contour_rms(travel("contour-gear", "wu-inverse", {}, preset="modern")) > stiff


def test_its_loop_bears_two_and_a_half_times_its_gain():
    drive = xy_axes.Params()
    per_command = drive.servo * 1e-3 * drive.gain
    assert xy_axes.largest_gain(drive) / (stacks.get("wu-inverse").part("law").kv * per_command) > 2.5


def test_a_line_at_constant_speed_is_followed_ten_milliseconds_late():
    """The five points that the quartic needs; the same for both axes, so it is no contour error."""
    for phase in (0.0, 1.0):
        assert inverse.reference(30.0, 30.0, 30.0, 30.0, phase, 2.0, PERIOD).behind == pytest.approx(30.0 * 10e-3)
