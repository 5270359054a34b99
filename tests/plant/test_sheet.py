"""Sheet: the footprint's mean against numerical integration, and the surface under a travelling machine."""

import numpy as np
import pytest
from scipy import integrate

from kerfgym.envs.plant import filters, heads, idle, machine, path, sensor, sheet
from kerfgym.envs.plant.controller import make_law
from kerfgym.envs.plant.fleet import Fleet
from kerfgym.envs.plant.sheet import FAR, FOOTPRINT, Feature, Params, State

IDLE = make_law(idle, "idle")


def fleet_over(feed: float = 200.0, machines: int = 1, gap: float = 1.0) -> Fleet:
    """Machines with their heads at rest, ``gap`` over the first point of the sheet."""
    fleet = Fleet(machines, IDLE, heads.ensure([0]))
    every = np.arange(machines)
    fleet.put_filter(every, filters.Params(kind=filters.NONE))
    fleet.put("sensor", every, sensor.EQ3._replace(noise=0.0, jitter=0.0))
    fleet.set("path.feed", every, feed)
    fleet.set("start.gap", every, gap)
    return fleet


def travelled(fleet: Fleet, steps: int, *fields: str) -> np.ndarray:
    """Signals of the first machine after each of ``steps`` periods, shape (fields, steps)."""
    fleet.begin(np.arange(fleet.size), np.arange(1, fleet.size + 1))
    views = [fleet.row(field) for field in fields]
    out = np.empty((len(fields), steps))
    for step in range(steps):
        fleet.advance()
        for i, view in enumerate(views):
            out[i, step] = view[0]
    return out


def surface(fleet: Fleet, steps: int) -> np.ndarray:
    """Surface under the first machine at the end of each period, mm."""
    return travelled(fleet, steps, "signals.surface_0")[0]


def positions(feed: float, steps: int) -> np.ndarray:
    """Distance at the end of each period, mm."""
    return feed * 1e-3 * np.arange(1, steps + 1)


# ------------------------------------------------------------------------------------------------------- footprint


def weight(u):
    """Projection of a hemisphere's weight on a direction."""
    return 0.75 * (1.0 - u * u)


@pytest.mark.parametrize("wavelength", [2.0, 3.0, 5.0, 10.0, 50.0, 300.0, 1000.0, 1e6])
def test_the_footprint_weakens_a_wave_as_the_mean_over_its_weight(wavelength):
    k = 2.0 * np.pi / wavelength
    mean, _ = integrate.quad(lambda u: weight(u) * np.cos(k * FOOTPRINT * u), -1.0, 1.0, epsabs=1e-13, limit=200)
    assert sheet.attenuation(k) == pytest.approx(mean, abs=1e-9)
    assert sheet.attenuation(-k) == sheet.attenuation(k)


def test_a_level_sheet_is_not_weakened():
    assert sheet.attenuation(0.0) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("u", [-5.0, -1.0, -0.7, -0.2, 0.0, 0.3, 0.99, 1.0, 4.0])
def test_the_share_behind_a_line_is_the_integral_of_the_weight(u):
    behind, _ = integrate.quad(weight, -1.0, max(-1.0, min(1.0, u)))
    assert sheet.share(u) == pytest.approx(behind, abs=1e-12)


def test_the_weight_is_the_projection_of_a_hemisphere():
    for u in (0.0, 0.5, 0.9):
        chord = np.sqrt(1.0 - u * u)
        across, _ = integrate.quad(lambda v, u=u: np.sqrt(max(0.0, 1.0 - u * u - v * v)), -chord, chord)
        assert weight(u) == pytest.approx(across / (2.0 * np.pi / 3.0), rel=1e-6)


# -------------------------------------------------------------------------------------------------- steps and voids


def test_a_step_is_a_ramp_of_two_millimetres_on_either_side():
    s = State(level=0.25, current=Feature(100.0, FAR, 0.8, 0.0))
    along = np.linspace(95.0, 105.0, 201)
    z = np.array([sheet.features(s, float(x)) for x in along])
    assert np.all(z[along <= 98.0] == pytest.approx(0.25, abs=1e-12))
    assert np.all(z[along >= 102.0] == pytest.approx(1.05, abs=1e-12))
    assert sheet.features(s, 100.0) == pytest.approx(0.65)
    exact = [0.25 + 0.8 * integrate.quad(weight, -1.0, np.clip((x - 100.0) / 2.0, -1.0, 1.0))[0] for x in along]
    assert z == pytest.approx(exact, abs=1e-12)


def test_a_step_in_the_sheet_reaches_the_machine_as_that_ramp():
    fleet = fleet_over(feed=200.0)
    fleet.put_feature(0, 0, 20.0, FAR, 0.3, 0.0)
    fleet.put_feature(0, 1, 60.0, 90.0, -0.2, 0.0)  # a trough
    fleet.put_feature(0, 2, 130.0, FAR, 0.1, 0.0)
    along = positions(200.0, 800)

    def ramp(x):
        v = np.clip(x / FOOTPRINT, -1.0, 1.0)
        return 0.5 + 0.75 * v - 0.25 * v**3

    expected = 0.3 * ramp(along - 20.0) - 0.2 * (ramp(along - 60.0) - ramp(along - 90.0)) + 0.1 * ramp(along - 130.0)
    assert surface(fleet, 800) == pytest.approx(expected, abs=1e-9)


def test_steps_that_lie_behind_add_up_and_other_features_do_not():
    s = State(current=Feature(10.0, FAR, 0.3, 0.0), upcoming=1.0)
    assert not sheet.is_behind(s.current, 10.0 + sheet.LATEST)
    assert sheet.is_behind(s.current, 10.0 + sheet.LATEST + 1e-6)
    hole = Feature(60.0, 70.0, 0.0, 10.0)
    s = sheet.leave(s, hole)
    assert (s.level, s.upcoming, s.current) == (0.3, 2.0, hole)
    assert not sheet.is_behind(hole, 70.0 + sheet.LATEST)
    assert sheet.is_behind(hole, 70.0 + sheet.LATEST + 1e-6)
    bump = Feature(100.0, 120.0, 0.5, 0.0)
    s = sheet.leave(s, bump)
    s = sheet.leave(s, Feature(200.0, FAR, -0.1, 0.0))
    s = sheet.leave(s, Feature())
    assert s.level == pytest.approx(0.2)
    assert s.upcoming == 5.0
    assert not sheet.is_behind(Feature(), 1e6)


def test_without_a_void_the_plate_is_covered_and_over_a_wide_one_it_is_bare():
    for along in (-50.0, 0.0, 50.0):
        assert sheet.coverage(Feature(), along, 6.5) == 1.0
        assert sheet.coverage(Feature(-10.0, 10.0, 0.3, 0.0), along, 6.5) == 1.0  # a bump is no void
    slot = Feature(0.0, 100.0, 0.0, 50.0)
    assert sheet.coverage(slot, 50.0, 6.5) == pytest.approx(0.0, abs=1e-12)
    assert sheet.coverage(slot, 6.5, 6.5) == pytest.approx(0.0, abs=1e-12)
    assert sheet.coverage(slot, -6.5, 6.5) == pytest.approx(1.0)
    assert sheet.coverage(slot, 0.0, 6.5) == pytest.approx(0.5)
    edge = Feature(0.0, FAR, 0.0, 1e3)
    assert sheet.coverage(edge, 2.0, 6.5) == pytest.approx(0.5 - (0.75 * 2 / 6.5 - 0.25 * (2 / 6.5) ** 3))


def test_a_narrow_void_takes_away_in_proportion_to_its_width():
    wide, narrow = Feature(0.0, 8.0, 0.0, 13.0), Feature(0.0, 8.0, 0.0, 3.0)
    for along in (0.0, 4.0, 9.0):
        lost = 1.0 - sheet.coverage(wide, along, 6.5)
        assert lost > 0.0
        assert 1.0 - sheet.coverage(narrow, along, 6.5) == pytest.approx(lost * 3.0 / 13.0)


def test_nothing_but_void_is_under_the_tip_where_it_lies_wholly_inside():
    hole = Feature(10.0, 20.0, 0.0, 10.0)
    assert sheet.over_void(hole, 15.0, 2.0)
    assert not sheet.over_void(hole, 11.9, 2.0)
    assert not sheet.over_void(hole, 18.1, 2.0)
    assert sheet.over_void(hole, 11.9, 0.0)
    assert not sheet.over_void(Feature(10.0, 20.0, 1.0, 0.0), 15.0, 0.0)


def test_over_a_hole_the_reading_rises_and_the_beam_has_nothing_to_cut():
    fleet = fleet_over(feed=100.0)
    fleet.put_feature(0, 0, 30.0, 60.0, 0.0, 30.0)
    fleet.begin(0, 1)
    record = fleet.start_recording(900)
    fleet.advance(900)
    along, height, scored = (record[:, machine.CHANNELS.index(name), 0] for name in ("distance", "height", "scored"))
    assert along == pytest.approx(positions(100.0, 900), rel=1e-6)
    clear = (np.abs(along - 30.0) > 0.01) & (np.abs(along - 60.0) > 0.01)
    assert np.array_equal(scored[clear] == 1.0, ((along < 30.0) | (along > 60.0))[clear])
    away = (along < 30.0 - 6.6) | (along > 60.0 + 6.6)
    assert height[away] == pytest.approx(1.0, abs=3e-3)
    assert height[(along > 37.0) & (along < 53.0)].min() >= 9.9  # bare plate: the end of the table
    assert np.all(height[~away] >= 1.0 - 3e-3)
    entering = (along > 30.0 - 6.6) & (along < 33.0)
    assert np.all(np.diff(height[entering]) > -3e-3)


# -------------------------------------------------------------------------------------------------- smooth surface


def test_waves_in_the_machine_are_the_sum_of_their_sines():
    feed, steps = 200.0, 2000
    rng = np.random.default_rng(12)
    fleet = fleet_over(feed)
    x, expected = positions(feed, steps), np.zeros(steps)
    for i in range(sheet.WAVES):
        amplitude, phase = rng.uniform(0.01, 0.5), rng.uniform(-np.pi, np.pi)
        k, ky = 2.0 * np.pi / rng.uniform(8.0, 300.0), rng.normal(0.0, 0.3)
        fleet.put_wave(0, i, amplitude, k, ky, phase)
        kappa = FOOTPRINT * np.hypot(k, ky)
        felt, _ = integrate.quad(lambda u, kappa=kappa: weight(u) * np.cos(kappa * u), -1.0, 1.0)
        expected += amplitude * felt * np.sin(k * x + phase)
    fleet.set("sheet.tilt_x", 0, 0.012)
    assert surface(fleet, steps) == pytest.approx(expected + 0.012 * x, abs=1e-6)


def test_vibrations_move_the_sheet_with_time():
    fleet = fleet_over(feed=0.0)
    fleet.put_vibration(0, 0, 0.05, 37.0, 0.4)
    fleet.put_vibration(0, 1, 0.01, 80.0, -1.0)
    t = 1e-3 * np.arange(1, 1501)
    expected = 0.05 * np.sin(2 * np.pi * 37.0 * t + 0.4) + 0.01 * np.sin(2 * np.pi * 80.0 * t - 1.0)
    assert surface(fleet, 1500) == pytest.approx(expected, abs=1e-8)


def test_a_measured_profile_is_interpolated_along_the_path():
    fleet = fleet_over(feed=150.0)
    profile = np.random.default_rng(13).normal(0.0, 0.1, 60)
    fleet.put_profile(profile, 2.5, 0)
    along = positions(150.0, 1200)  # beyond the end of the profile too
    expected = np.interp(along, 2.5 * np.arange(60), profile)
    assert surface(fleet, 1200) == pytest.approx(expected, abs=1e-6)


def test_the_sheet_ahead_is_what_the_machine_meets_later():
    fleet = fleet_over(feed=200.0)
    fleet.put_wave(0, 0, 0.4, 0.2, 0.0, 0.3)
    fleet.put_feature(0, 0, 15.0, FAR, 0.2, 0.0)
    seen = travelled(fleet, 300, *(f"signals.surface_{ahead}" for ahead in range(6)))
    assert np.ptp(seen[0]) > 0.5
    for ahead in range(1, 6):
        assert np.array_equal(seen[ahead, :-ahead], seen[0, ahead:])


def test_a_bulge_is_a_raised_cosine_of_its_width_at_half_height():
    p = Params(bulge=0.6, bulge_x=20.0, bulge_y=-5.0, bulge_width=40.0)
    grown = State(grown=1.0)
    assert sheet.bulge(p, grown, 20.0, -5.0) == pytest.approx(0.6, abs=1e-8)
    assert sheet.bulge(p, grown, 40.0, -5.0) == pytest.approx(0.3, abs=1e-8)
    assert sheet.bulge(p, grown, 20.0, 15.0) == pytest.approx(0.3, abs=1e-8)
    assert sheet.bulge(p, grown, 20.0, 35.0) == pytest.approx(0.0, abs=1e-8)
    assert sheet.bulge(p, grown, 300.0, 0.0) == pytest.approx(0.0, abs=1e-8)
    for r in np.linspace(0.0, 40.0, 21):
        at = sheet.bulge(p, grown, 20.0 + 0.6 * r, -5.0 + 0.8 * r)
        assert at == pytest.approx(0.6 * np.cos(0.5 * np.pi * r / 40.0) ** 2, abs=1e-8)
        assert sheet.bulge(p, State(grown=0.4), 20.0 + 0.6 * r, -5.0 + 0.8 * r) == pytest.approx(0.4 * at, abs=1e-9)


@pytest.mark.parametrize("tau", [1.0, 3.0])
def test_a_bulge_grows_with_its_time_constant(tau):
    fleet = fleet_over(feed=0.0)
    fleet.use(machine.F_BULGES)
    fleet.put("sheet", 0, Params(bulge=0.5, bulge_growth=1.0 - np.exp(-1e-3 / tau)))
    z = surface(fleet, 2000)
    t = 1e-3 * np.arange(1, 2001)
    assert z == pytest.approx(0.5 * (1.0 - np.exp(-t / tau)), abs=1e-6)


def test_nothing_of_the_sheet_changes_what_lies_beside_it():
    one = fleet_over(machines=3)
    one.put_wave(1, 0, 0.3, 0.1, 0.0, 0.0)
    one.put_feature(2, 0, 5.0, FAR, 0.4, 0.0)
    z = surface(one, 100)
    assert np.all(z == 0.0)
    assert one.get("signals", 1).surface_0 == pytest.approx(0.3 * sheet.attenuation(0.1) * np.sin(2.0), abs=1e-6)
    assert one.get("signals", 2).surface_0 == pytest.approx(0.4)


# ------------------------------------------------------------------------------------------------------------- gap


def test_the_gap_is_the_head_over_the_surface():
    fleet = fleet_over(feed=300.0, gap=2.0)
    fleet.put_wave(0, 0, 0.5, 2 * np.pi / 60.0, 0.0, 1.0)
    fleet.put_wave(0, 1, 0.1, 2 * np.pi / 9.0, 0.0, 0.0)
    gap, head, z = travelled(fleet, 400, "signals.gap", "signals.head", "signals.surface_0")
    assert np.ptp(z) > 0.8
    assert gap == pytest.approx(head - z, abs=1e-9)


@pytest.mark.parametrize("gate", [0.05, 0.25, 1.0])
def test_between_the_ends_of_a_period_the_surface_runs_quadratically(gate):
    # With a head at rest the mean gap over the gate tells the surface's course within the period.
    k, half = 2 * np.pi / 40.0, 0.25  # rad/mm; mm, half a period's way
    fleet = fleet_over(feed=500.0, gap=2.0)
    fleet.put_wave(0, 0, 0.5, k, 0.0, 0.3)
    fleet.put("gate", 0, sensor.Gate(gate, 0.0))
    felt = 0.5 * float(sheet.attenuation(k))
    substeps = 1.0 - np.arange(round(gate * 20)) / 20.0
    gap, head = travelled(fleet, 200, "moment.gate_gap", "moment.head")
    z = felt * np.sin(k * 0.5 * (np.arange(200)[:, None] + substeps) + 0.3)
    remainder = felt * k**3 * half**3 / (9.0 * np.sqrt(3.0))  # of a parabola through three points
    assert np.abs(gap - (head - z.mean(axis=1))).max() <= remainder + 1e-9


def test_a_contour_is_travelled_at_the_feed_and_the_sheet_lies_under_it():
    corner = path.resample("corner", [np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 40.0]])])
    assert corner.length == pytest.approx(70.0, abs=2 * path.SPACING)
    fleet = fleet_over(feed=100.0)
    fleet.put_contours([corner], np.array([0]), np.array([0]))
    fleet.set("sheet.tilt_x", 0, 0.01)
    fleet.set("sheet.tilt_y", 0, -0.02)
    s = positions(100.0, 650)
    expected = 0.01 * np.minimum(s, 30.0) - 0.02 * np.maximum(s - 30.0, 0.0)
    assert surface(fleet, 650) == pytest.approx(expected, abs=1e-6)
