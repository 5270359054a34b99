"""Parts and stages of the gantry in plain Python: facts of geometry and limits that whole jobs hardly show."""

import numpy as np
import pytest

from kerfgym.envs.engine.lanes import U, W, load, store
from kerfgym.envs.plant import gantry, spot, xy_axes
from kerfgym.envs.plant.controller import Process


def table(x, y, feed=0.0, phase=gantry.CUT, most=3.0):
    """A job's table along the points (x, y), one each millisecond."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    s = np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y))))
    tx, ty = np.gradient(x), np.gradient(y)
    length = np.maximum(np.hypot(tx, ty), 1e-12)
    none = np.zeros(len(x))
    rows = {
        "x": x,
        "y": y,
        "s": s,
        "feed": none + feed,
        "tx": tx / length,
        "ty": ty / length,
        "beam": none,
        "phase": none + phase,
        "lift": none,
        "most": none + most,
        "cut_s": s,
    }
    return np.stack([rows[name] for name in gantry.JOB], axis=1).ravel()


@pytest.mark.parametrize("angle", [32.0, 45.0, 60.0, 90.0])
@pytest.mark.parametrize("off", [0.2, 1.0, 3.0])
def test_around_a_corner_down_to_30_degrees_the_nearest_point_jumps_to_the_other_leg(angle, off):
    # A slide on the bisector is as far from both legs; a little beyond it, the leg behind the corner is nearer. The
    # way from foot to foot is 2/tan(angle/2) times that distance: 7.0 at 32 degrees, 2 at a right angle.
    legs, a = np.arange(0.0, 20.0, 0.01), np.radians(angle)
    back = 20.0 + legs * -np.cos(a), legs * np.sin(a)
    jobs = table(np.append(legs, back[0]), np.append(0.0 * legs, back[1]))
    turn = np.radians(180.0) - a / 2.0 - 0.01 * a
    r = off / np.sin(a / 2.0)
    x, y = 20.0 + r * np.cos(turn), r * np.sin(turn)
    j = gantry.Journey(samples=float(len(jobs) // len(gantry.JOB)))
    foot = np.floor(x / 0.01)
    found = gantry._nearest(jobs, j, foot, j.samples - 1.0, x, y)
    assert found > len(legs)
    # And from there on, the slide stays on the leg that it has reached.
    assert gantry._nearest(jobs, j, found, j.samples - 1.0, x, y) == found


def test_the_nearest_point_is_never_one_that_the_programme_has_not_reached():
    jobs = table(np.arange(0.0, 10.0, 0.1), np.zeros(100))
    j = gantry.Journey(samples=100.0)
    assert gantry._nearest(jobs, j, 10.0, 40.0, 7.0, 0.0) == 40.0


def overrides(wanted, feed, count, p=None, most=3.0):
    """Overrides in force at the servo instants that follow a wish, on a long cut at ``feed`` mm/s."""
    p = p or xy_axes.Params()
    jobs = table(np.arange(4000) * feed * 1e-3, np.zeros(4000), feed, most=most)
    g = np.zeros(gantry.ROWS * W)
    store(g, gantry.P_XY, p)
    store(g, gantry.P_JOURNEY, gantry.Journey(samples=4000.0))
    store(g, gantry.PROGRESS, gantry.Progress())
    store(g, gantry.APPLIED, Process(override=wanted))
    seen = []
    for _ in range(count):
        gantry.head_all(g, U(0), 1, jobs)
        seen.append(load(gantry.Progress, g, gantry.PROGRESS))
    return seen


@pytest.mark.parametrize("feed", [20.0, 100.0])
@pytest.mark.parametrize("wanted", [0.2, 1.8])
def test_a_change_of_the_override_takes_half_the_axes_acceleration(feed, wanted):
    p = xy_axes.Params(servo=1.0, interpolation=1.0, acceleration=2000.0)
    speeds = feed * np.array([1.0, *(s.override for s in overrides(wanted, feed, 200, p))])
    assert np.abs(np.diff(speeds)).max() == pytest.approx(0.5 * 2000.0 * 1e-3)
    assert speeds[-1] == pytest.approx(wanted * feed)
    moving = np.abs(np.diff(speeds)) > 1e-9
    assert moving[: moving.sum()].all()  # it begins at once and does not pause


def test_at_standstill_the_override_slews_as_at_1_mm_per_s():
    assert overrides(0.5, 0.0, 1, xy_axes.Params(acceleration=20.0))[0].override == pytest.approx(1.0 - 0.08)


def test_an_override_never_exceeds_what_the_axes_have_room_for_nor_falls_to_nothing():
    assert overrides(3.0, 50.0, 400, most=1.3)[-1].override == pytest.approx(1.3)
    assert overrides(0.0, 50.0, 400)[-1].override == pytest.approx(0.05)


def test_a_rapid_does_not_obey_the_override():
    jobs = table(np.arange(400) * 0.1, np.zeros(400), 100.0, gantry.RAPID)
    g = np.zeros(gantry.ROWS * W)
    store(g, gantry.P_XY, xy_axes.Params())
    store(g, gantry.P_JOURNEY, gantry.Journey(samples=400.0))
    store(g, gantry.PROGRESS, gantry.Progress())
    store(g, gantry.APPLIED, Process(override=0.3))
    for _ in range(60):
        gantry.head_all(g, U(0), 1, jobs)
    after = load(gantry.Progress, g, gantry.PROGRESS)
    assert after.override == 1.0
    assert after.tau == 64.0  # 15 servo periods of 4 ms, an interpolation of 8 ms at every second, and at the first


def test_the_piezos_focus_runs_round_a_loop_of_2_per_cent_of_its_stroke():
    p, at, way = spot.Params(hysteresis=0.02, piezo_range=5.0), 0.0, []
    up = np.linspace(-4.0, 4.0, 81)
    for wanted in [*up, *up[::-1], *up]:
        at = spot.realised(p, spot.Command(focus=wanted), at).focus
        way.append(at)
    rising, falling = np.array(way[162:]), np.array(way[81:162])[::-1]
    middle = np.abs(up) < 3.7
    assert np.allclose((falling - rising)[middle], 0.2)  # 2 % of a stroke of ±5 mm
    assert np.allclose(rising[middle], up[middle] - 0.1)


def test_without_hysteresis_the_focus_is_what_was_asked_for():
    p = spot.Params(hysteresis=0.0)
    assert [spot.realised(p, spot.Command(focus=w), 0.7).focus for w in (-3.0, 0.0, 9.0)] == [-3.0, 0.0, 5.0]
