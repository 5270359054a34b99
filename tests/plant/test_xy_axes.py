"""Position loops of X and Y against the z domain, closed forms and Wu's findings."""

from types import SimpleNamespace

import numpy as np
import pytest
import sympy
from scipy import signal

from kerfgym.baselines import recipe, wu
from kerfgym.envs import scenarios
from kerfgym.envs.control.stack import get
from kerfgym.envs.plant import heads, xy_axes
from kerfgym.envs.plant.controller import make_law
from kerfgym.envs.plant.fleet import Fleet

IDEAL = {"dac": 0.0, "encoder": 0.0, "acceleration": 1e9, "speed": 1e9}
"""No quantisation, no limits."""

CONSTANTS_B = {"t1": 0.012, "t2": 0.006626, "gain": 1.04167}
LAW, RECIPE = make_law(wu, "wu", slot="xy"), make_law(recipe, "recipe", slot="process")


def job(x, y):
    """A job that passes the points (x, y) (mm) one per millisecond."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    way = np.hypot(np.diff(x), np.diff(y))
    s = np.concatenate([[0.0], np.cumsum(way)])
    tx, ty = np.gradient(x), np.gradient(y)
    length = np.maximum(np.hypot(tx, ty), 1e-12)
    none = np.zeros(len(x))
    return SimpleNamespace(
        x=x,
        y=y,
        s=s,
        feed=np.append(way, way[-1]) * 1e3,
        tx=tx / length,
        ty=ty / length,
        beam=none,
        phase=none,
        lift=none,
        most=none + 2.0,
        cut_s=s,
        cut_feed=float(way.mean() * 1e3),
        patience=0.0,
    )


def ramp(speed, milliseconds, angle=0.0):
    along = speed * 1e-3 * np.arange(milliseconds)
    return job(along * np.cos(angle), along * np.sin(angle))


def circle(radius, speed, turns=6.0, sense=1.0):
    """From rest: the speed rises over the first turn."""
    turn = 2 * np.pi * radius / speed * 1e3
    t = np.arange(int(turn * (turns + 0.5)))
    angle = np.where(t < turn, np.pi * (t / turn) ** 2, np.pi + 2 * np.pi * (t / turn - 1.0)) * sense
    return job(radius * np.cos(angle), radius * np.sin(angle))


def travelled(jobs, axes, kp):
    """Channels of every control period of one gantry per job: a dict of arrays (periods, gantries)."""
    size, every = len(jobs), np.arange(len(jobs))
    fleet = Fleet(size, get("idle").law, heads.POOL)
    g = fleet.use_gantries(LAW, RECIPE)
    scenarios.prepare(fleet, scenarios.load("flat"), every, every)
    for i in range(size):
        g.put_job(jobs[i], [i])
        g.put_axes([i], axes[i])
        g.put_law("xy", [i], wu.Params(kp=kp[i]))
    fleet.begin(every, every)
    names = {
        "x": "x.position",
        "y": "y.position",
        "sum": "x.summed",
        "error": "axes_signals.error_x",
        "tau": "progress.tau",
        "vx": "x.part_1",
        "vx2": "x.part_2",
        "error_y": "axes_signals.error_y",
    }
    seen = {name: [] for name in names}
    for _ in range(len(jobs[0].x) - 20):
        fleet.advance()
        for name, field in names.items():
            seen[name].append(g.column(field))
    return {name: np.array(values) for name, values in seen.items()}


def gain(kv, p):
    """Kp for a velocity gain in 1/s."""
    return kv * p.servo * 1e-3 / (0.2 * p.gain)


def radii(seen, radius, speed):
    """Angle and radial error over the last whole turns, fitted to a circle about the true centre."""
    turn = 2 * np.pi * radius / speed * 1e3
    last = int(3 * turn)
    x, y = seen["x"][-last:, :], seen["y"][-last:, :]
    return np.arctan2(y, x), np.hypot(x, y) - radius


# -------------------------------------------------------------------------------------------------- the z domain


def test_a_and_b_are_those_of_the_drive_held_for_a_servo_period():
    for constants in ({}, CONSTANTS_B, {"tau": 0.003}):
        p = xy_axes.Params(**constants)
        a, b, c, d = xy_axes.z_domain(p)
        number, denominator, _ = signal.cont2discrete(
            ([p.tau, 1.0], [p.t1 * p.t2, p.t1 + p.t2, 1.0]), 1e-3 * p.servo, method="zoh"
        )
        assert np.allclose(number.ravel(), [0.0, a, -b], atol=1e-12)
        assert np.allclose(denominator, [1.0, -c - d, c * d], atol=1e-12)


def test_a_and_b_follow_from_the_laplace_transform_symbolically():
    t1, t2, tau, t, z = sympy.symbols("T1 T2 tau T z", positive=True)
    c, d = sympy.exp(-t / t1), sympy.exp(-t / t2)
    c1, c2 = (t1 - tau) / (t1 - t2), (tau - t2) / (t1 - t2)
    held = c1 * (1 - c) / (z - c) + c2 * (1 - d) / (z - d)  # zero-order hold of the partial fractions
    a, b = 1 - c1 * c - c2 * d, c1 * d + c2 * c - c * d
    assert sympy.simplify(held - (a * z - b) / ((z - c) * (z - d))) == 0
    plain = sympy.apart((1 + tau * z) / ((1 + t1 * z) * (1 + t2 * z)), z)
    assert sympy.simplify(plain - c1 / (1 + t1 * z) - c2 / (1 + t2 * z)) == 0


def test_the_characteristic_equation_is_the_closed_loops():
    p, k = xy_axes.Params(tau=0.002), 0.7
    a, b, c, d = xy_axes.z_domain(p)
    open_denominator = np.polymul(np.polymul([1, -1], [1, -c]), [1, -d])
    assert np.allclose(xy_axes.characteristic(p, k), np.polyadd(open_denominator, k * np.array([a, -b, 0.0])))


@pytest.mark.parametrize(("constants", "physical"), [({}, 3.04), (CONSTANTS_B, 3.12)])
def test_the_literal_loop_is_stable_up_to_kp_4_5_and_the_physical_one_up_to_3(constants, physical):
    p = xy_axes.Params(literal=True, **constants)
    assert xy_axes.largest_gain(p) / (0.2 * p.gain) == pytest.approx(4.5, abs=2e-3)
    q = p._replace(literal=False)
    assert xy_axes.largest_gain(q) / (0.2 * q.gain) == pytest.approx(physical, abs=0.01)


def test_the_simulation_is_stable_and_unstable_where_the_z_domain_says():
    step = np.ones(3000)
    step[:8] = 0.0
    there = job(step, 0 * step)
    literal, physical = xy_axes.Params(literal=True, **IDEAL), xy_axes.Params(**IDEAL)
    seen = travelled([there] * 4, [literal, literal, physical, physical], [4.4, 4.6, 2.95, 3.15])
    early, late = slice(900, 1100), slice(-210, -10)
    swing = [np.abs(seen[k][:, i] - 1.0) for i, k in enumerate(("sum", "sum", "x", "x"))]
    assert swing[0][late].max() < 0.8 * swing[0][early].max()
    assert swing[1][late].max() > 1.5 * swing[1][early].max()
    assert swing[2][late].max() < 0.8 * swing[2][early].max()
    assert swing[3][late].max() > 1.5 * swing[3][early].max()


def test_the_literal_simulation_is_the_difference_equation_sample_by_sample():
    p, kp = xy_axes.Params(literal=True, **IDEAL), 1.5
    step = np.ones(700)
    step[:8] = 0.0
    seen = travelled([job(step, 0 * step)], [p], [kp])
    a, b, *_ = xy_axes.z_domain(p)
    k = kp * 0.2 * p.gain
    # From the issued reference (half at one servo instant, half at the next) to the sum; E holds what came before.
    closed = signal.dlti([k * a, -k * b, 0.0], xy_axes.characteristic(p, k), dt=1.0)
    issued = np.ones(150)
    issued[0] = 0.5
    _, y = signal.dlsim(closed, issued)
    assert np.allclose(seen["sum"][3::4, 0][:140], y[1:141, 0], atol=1e-12)


def test_a_ramp_leaves_the_lag_v_over_kv():
    modes = [xy_axes.Params(literal=flag, **IDEAL) for flag in (True, False)]
    for speed, kp in ((100.0, 0.54), (20.0, 0.2)):
        seen = travelled([ramp(speed, 3000)] * 2, modes, [kp, kp])
        kv = kp * 0.2 * modes[0].gain / 4e-3
        assert seen["error"][-1] == pytest.approx(speed / kv, rel=1e-3)


# ------------------------------------------------------------------------------------------- Wu's error analysis


def test_matched_gains_leave_a_line_straight():
    p = xy_axes.Params(**IDEAL)
    seen = travelled([ramp(50.0, 2500, np.pi / 6)], [p], [gain(30.0, p)])
    beside = seen["y"][:, 0] * np.cos(np.pi / 6) - seen["x"][:, 0] * np.sin(np.pi / 6)
    assert np.abs(beside).max() < 1e-9


def test_matched_gains_change_a_circles_radius_by_the_formula():
    # ΔR = −(v²/R)·(1/(2Kv²) − Te/Kv), Te = T1 + T2 − τ; v/(R·Kv) = 0.04. A servo period that is held adds half of
    # itself to Te where the velocity is integrated; summed speeds take just that away again.
    radius, kv, speed = 25.0, 30.0, 30.0
    literal = xy_axes.Params(literal=True, servo=4.0, interpolation=4.0, **IDEAL)
    physical = literal._replace(literal=False)
    seen = travelled([circle(radius, speed)] * 2, [literal, physical], [gain(kv, literal)] * 2)
    te = literal.t1 + literal.t2
    expected = [-(speed**2 / radius) * (1 / (2 * kv**2) - t / kv) for t in (te, te + 2e-3)]
    _, error = radii(seen, radius, speed)
    assert error[:, 1].mean() == pytest.approx(expected[1], rel=0.05)
    assert error[:, 0].mean() == pytest.approx(expected[0], rel=0.05)
    assert error[:, 1].std() < 0.02 * abs(expected[1])  # the change is uniform


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("stronger", ["x", "y"])
def test_mismatched_gains_make_a_circle_an_ellipse_at_45_or_135_degrees(sense, stronger):
    radius, kv, speed = 60.0, 30.0, 30.0  # v/(R·Kv) = 0.017
    x, y = (1.05, 1.0) if stronger == "x" else (1.0, 1.05)
    p = xy_axes.Params(x_plus=x, x_minus=x, y_plus=y, y_minus=y, **IDEAL)
    seen = travelled([circle(radius, speed, 4.0, sense)], [p], [gain(kv, p)])
    angle, error = radii(seen, radius, speed)
    angle, error = angle[:, 0], error[:, 0]
    basis = np.stack([np.ones_like(angle), np.cos(2 * angle), np.sin(2 * angle)], axis=1)
    (_, even, odd), *_ = np.linalg.lstsq(basis, error, rcond=None)
    assert np.hypot(even, odd) == pytest.approx(speed / 2 * abs(1 / (kv * x) - 1 / (kv * y)), rel=0.02)
    long_axis = np.rad2deg(0.5 * np.arctan2(odd, even)) % 180
    # The weaker axis lags more. Anticlockwise on the first quadrant x falls and y rises: more lag of x lies outside.
    expected = 45.0 if (stronger == "y") == (sense > 0) else 135.0
    assert long_axis == pytest.approx(expected, abs=3.0)


def test_a_line_at_45_degrees_is_offset_by_as_much():
    kv, speed = 30.0, 30.0
    p = xy_axes.Params(x_plus=1.05, x_minus=1.05, **IDEAL)
    seen = travelled([ramp(speed, 2500, np.pi / 4)], [p], [gain(kv, p)])
    beside = (seen["y"][-1, 0] - seen["x"][-1, 0]) / np.sqrt(2)
    assert abs(beside) == pytest.approx(speed / 2 * abs(1 / (kv * 1.05) - 1 / kv), rel=0.02)


def test_a_gain_that_differs_by_direction_distorts_only_the_half_travelled_that_way():
    radius, kv, speed = 60.0, 30.0, 30.0
    matched, uneven = xy_axes.Params(**IDEAL), xy_axes.Params(x_plus=1.1, **IDEAL)
    seen = travelled([circle(radius, speed, 4.0)] * 2, [matched, uneven], [gain(kv, matched)] * 2)
    moved = np.hypot(seen["x"][:, 1] - seen["x"][:, 0], seen["y"][:, 1] - seen["y"][:, 0])
    turn = int(2 * np.pi * radius / speed * 1e3)
    forward = np.gradient(seen["x"][:, 0]) > 0
    settled = np.zeros(len(forward), bool)
    settled[-3 * turn :] = True
    changed = np.diff(forward.astype(int)) != 0
    for at in np.flatnonzero(changed):  # what the axis needs to settle after it has turned
        settled[at : at + 400] = False
    assert moved[settled & ~forward].max() < 0.02 * moved[settled & forward].max()
    assert moved[settled & forward].max() > 0.05


# ------------------------------------------------------------------------------------- limits and quantisation


def test_speed_and_acceleration_stay_within_their_limits_whatever_is_asked():
    step = np.full(1500, 300.0)
    step[:8] = 0.0
    p = xy_axes.Params()
    seen = travelled([job(step, -step)], [p], [gain(30.0, p)])
    velocity = (seen["vx"] + seen["vx2"])[:, 0]
    assert velocity.max() == pytest.approx(p.speed, rel=0.01)
    assert velocity.max() <= p.speed * (1 + 1e-9)
    change = np.abs(np.diff(velocity)) * 1e3
    assert change.max() == pytest.approx(p.acceleration, rel=1e-9)
    moved = np.diff(seen["x"][:, 0]) * 1e3  # mean velocity of each period
    assert np.allclose(moved, 0.5 * (velocity[1:] + velocity[:-1]), atol=0.15)


def test_the_encoder_and_the_d_a_converter_are_felt():
    coarse = xy_axes.Params(dac=1.3, encoder=0.005)
    fine = xy_axes.Params(dac=0.0, encoder=0.0)
    seen = travelled([ramp(33.0, 2500)] * 2, [coarse, fine], [gain(30.0, coarse)] * 2)
    assert np.allclose(np.round(seen["error"][:, 0] / 0.0005) * 0.0005, seen["error"][:, 0], atol=1e-9)
    # One step of the D/A converter is a lag of step/Kv.
    assert 1e-3 < np.ptp(seen["error"][-800:, 0]) <= 2.5 * 1.3 / 30.0
    assert np.ptp(seen["error"][-800:, 1]) < 1e-6


def test_wus_preset_b_with_an_8_bit_converter_lags_43_micrometres_a_step():
    p = xy_axes.Params(dac=1e4 / 60 / 128)
    assert p.dac / 30.0 * 1e3 == pytest.approx(43.4, abs=0.1)


def test_constants_of_the_gains_are_exact():
    p = xy_axes.Params(tau=0.003)
    g = xy_axes.gains(p, 1e-3)
    c1, c2 = (p.t1 - p.tau) / (p.t1 - p.t2), (p.tau - p.t2) / (p.t1 - p.t2)
    drive = np.array([[-1 / p.t1, 0, 0], [0, -1 / p.t2, 0], [1, 1, 0]])  # two parts of the velocity, and the way
    a, b, *_ = signal.cont2discrete(
        (drive, np.array([[c1 / p.t1], [c2 / p.t2], [0]]), np.eye(3), np.zeros((3, 1))), 1e-3, method="zoh"
    )
    assert np.allclose([g.keep_1, g.keep_2, g.way_1, g.way_2], [a[0, 0], a[1, 1], a[2, 0], a[2, 1]], atol=1e-12)
    assert np.allclose([g.feed_1, g.feed_2, g.drag], b.ravel(), atol=1e-12)
