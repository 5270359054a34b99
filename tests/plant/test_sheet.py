"""Sheet: footprints against numerical integration, continuous spectra and bands against Welch's estimate, and the
surface under a travelling machine."""

import numpy as np
import pytest
from scipy import integrate, linalg, signal

from kerfgym.envs.plant import filters, heads, idle, machine, path, sensor, sheet
from kerfgym.envs.plant.controller import make_law
from kerfgym.envs.plant.fleet import Fleet
from kerfgym.envs.plant.sheet import FAR, FOOTPRINT, PLATE, Feature, Params, Random, State, Turns

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


@pytest.mark.parametrize("radius", [FOOTPRINT, PLATE, 12.0])
@pytest.mark.parametrize("wavelength", [2.0, 3.0, 5.0, 10.0, 50.0, 300.0, 1000.0, 1e6])
def test_the_footprint_weakens_a_wave_as_the_mean_over_its_weight(wavelength, radius):
    k = 2.0 * np.pi / wavelength
    mean, _ = integrate.quad(lambda u: weight(u) * np.cos(k * radius * u), -1.0, 1.0, epsabs=1e-13, limit=200)
    assert sheet.attenuation(k, radius) == pytest.approx(mean, abs=1e-9)
    assert sheet.attenuation(-k, radius) == sheet.attenuation(k, radius)
    assert sheet.attenuation(k) == sheet.attenuation(k, FOOTPRINT)


def test_a_plate_of_5_mm_is_replaced_by_the_hemisphere_of_its_second_moment():
    def moment(weigh):
        whole, second = (integrate.dblquad(lambda r, _, n=n: weigh(r) * r ** (n + 1), 0, 1, 0, 1)[0] for n in (0, 2))
        return second / whole

    disc, hemisphere = moment(lambda _: 1.0), moment(lambda r: np.sqrt(1.0 - r * r))
    assert pytest.approx(5.0 * np.sqrt(disc / hemisphere), abs=0.02) == PLATE


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
    z = np.array([sheet.features(s, float(x), FOOTPRINT) for x in along])
    assert np.all(z[along <= 98.0] == pytest.approx(0.25, abs=1e-12))
    assert np.all(z[along >= 102.0] == pytest.approx(1.05, abs=1e-12))
    assert sheet.features(s, 100.0, FOOTPRINT) == pytest.approx(0.65)
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


@pytest.mark.parametrize("length", [700.0, 1000.0, 3000.0])
def test_a_slope_turns_smoothly_at_the_ends_of_the_sheet(length):
    p, x = Params(length=length), np.linspace(-50.0, 6.5 * length, 40_001)
    # Up and down by turns; around each turn the slope changes linearly over 600 mm.
    slope = np.ones(x.shape)
    for turn in range(1, 9):
        u = np.clip((x - turn * length) / 300.0, -1.0, 1.0)
        slope = np.where(np.abs(x - turn * length) < 300.0, (-1.0) ** turn * u, slope)
        slope = np.where(x >= turn * length + 300.0, (-1.0) ** turn, slope)
    exact = x[0] + integrate.cumulative_simpson(slope, x=x, initial=0.0)
    assert [sheet.sloped(p, float(each)) for each in x] == pytest.approx(exact, abs=0.02)
    assert exact.max() < length


def test_a_sloping_sheet_stays_within_the_heads_travel_for_minutes():
    fleet = fleet_over(feed=1000.0, gap=40.0)
    fleet.set("sheet.tilt_x", 0, 0.01)
    z, x = surface(fleet, 9000), positions(1000.0, 9000)
    assert z == pytest.approx([0.01 * sheet.sloped(Params(), float(each)) for each in x], abs=1e-9)
    assert z.max() == pytest.approx(0.01 * (3000.0 - 150.0), abs=1e-3)
    assert np.abs(np.diff(z, 2)).max() <= 1.05 * 0.01 / 300.0


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


# ----------------------------------------------------------------------------------------------------------- the plate


NODES, WEIGHTS = np.polynomial.legendre.leggauss(400)
WEIGHTS = WEIGHTS * weight(NODES)  # of a footprint's mean: exact for waves, to 1e-4 for edges


def felt_at(height, x, radius):
    """Mean of ``height`` (a function of the place, mm) over a footprint around each ``x``, by quadrature."""
    x = np.asarray(x)
    return (height(x[..., None] + radius * NODES) * WEIGHTS).sum(axis=-1)


def gated(height, feed, steps, radius, substeps=5):
    """Mean of that over the gate at the end of each period, taken at the substeps' ends."""
    shares = 1.0 - np.arange(substeps) / 20.0
    return felt_at(height, feed * 1e-3 * (np.arange(steps)[:, None] + shares), radius).mean(axis=1)


@pytest.mark.parametrize("wavelength", [12.0, 20.0, 60.0])
@pytest.mark.parametrize("plate", [FOOTPRINT, PLATE, 9.0])
def test_the_sensor_reports_the_sheet_under_its_plate_while_the_gap_is_under_the_tip(wavelength, plate):
    fleet, k = fleet_over(feed=100.0, gap=1.0), 2 * np.pi / wavelength
    fleet.put_plate(0, plate)
    fleet.put_wave(0, 0, 0.2, k, 0.0, 0.7)
    gap, head, raw = travelled(fleet, 400, "signals.gap", "signals.head", "signals.raw_height")

    def height(x):
        return 0.2 * np.sin(k * x + 0.7)

    assert gap == pytest.approx(head - felt_at(height, positions(100.0, 400), FOOTPRINT), abs=1e-6)
    assert raw == pytest.approx(head - gated(height, 100.0, 400, plate), abs=2e-3)  # the calibration's error
    if plate > FOOTPRINT and wavelength <= 20.0:
        assert np.abs(raw - gap).max() > 0.03


@pytest.mark.parametrize("plate", [FOOTPRINT, PLATE, 12.0])
def test_the_sensor_reports_a_step_as_its_plates_ramp(plate):
    fleet = fleet_over(feed=100.0, gap=0.8)
    fleet.put_plate(0, plate)
    fleet.put_feature(0, 0, 30.0, FAR, -0.3, 0.0)
    fleet.put_feature(0, 1, 80.0, 110.0, 0.2, 0.0)  # a part that stands proud
    head, raw = travelled(fleet, 1500, "signals.head", "signals.raw_height")

    def height(x):
        return np.where(x > 30.0, -0.3, 0.0) + np.where((x > 80.0) & (x < 110.0), 0.2, 0.0)

    assert raw == pytest.approx(head - gated(height, 100.0, 1500, plate), abs=3e-3)
    away = np.abs(positions(100.0, 1500) - 30.0) > plate + 0.1
    assert np.abs(np.diff(raw[:700])[away[1:700]]).max() < 2e-3
    inside = np.flatnonzero((raw[:700] > 0.81) & (raw[:700] < 1.09))
    assert np.ptp(positions(100.0, 1500)[inside]) == pytest.approx(2 * 0.77 * plate, abs=0.3)


@pytest.mark.parametrize("gate", [0.05, 0.25, 0.6, 1.0])
def test_what_the_plate_feels_more_is_averaged_over_the_gate_like_the_gap(gate):
    k, half = 2 * np.pi / 40.0, 0.25  # rad/mm; mm, half a period's way
    fleet = fleet_over(feed=500.0, gap=2.0)
    fleet.put_plate(0, PLATE)
    fleet.put_wave(0, 0, 0.5, k, 0.0, 0.3)
    fleet.put("gate", 0, sensor.Gate(gate, 0.0))
    seen = travelled(fleet, 200, "course.felt")[0]
    more = gated(lambda x: 0.5 * np.sin(k * x + 0.3), 500.0, 200, PLATE, round(gate * 20))
    more -= gated(lambda x: 0.5 * np.sin(k * x + 0.3), 500.0, 200, FOOTPRINT, round(gate * 20))
    remainder = np.abs(more).max() * k**3 * half**3 / (9.0 * np.sqrt(3.0))  # of a parabola through three points
    assert np.abs(seen - more).max() <= remainder + 1e-9
    assert np.abs(more).max() > 1e4 * remainder


def test_the_first_reading_is_that_of_the_plate():
    for plate in (FOOTPRINT, PLATE):
        fleet = fleet_over(feed=0.0, gap=1.0)
        fleet.put_plate(0, plate)
        fleet.put_wave(0, 0, 0.3, 0.4, 0.0, 1.0)
        fleet.begin(0, 1)
        first = fleet.get("signals").raw_height
        fleet.advance()
        assert first == pytest.approx(fleet.get("signals").raw_height, abs=2e-3)
        more = 0.3 * (sheet.attenuation(0.4, plate) - sheet.attenuation(0.4)) * np.sin(1.0)
        assert first == pytest.approx(1.0 - more, abs=2e-3)


def test_a_wave_is_made_for_the_plate_that_its_machine_has():
    fleet = fleet_over(machines=3)
    for i, plate in enumerate((FOOTPRINT, PLATE, 10.0)):
        fleet.put_plate(i, plate)
    fleet.put_wave(np.arange(3), 0, 0.4, 0.3, 0.0, 0.0)
    tip = fleet.listed(sheet.Wave, 0).amplitude
    assert tip == pytest.approx(0.4 * sheet.attenuation(0.3))
    expected = [0.4 * sheet.attenuation(0.3, plate) for plate in (FOOTPRINT, PLATE, 10.0)]
    assert tip + fleet.listed(sheet.Wave, 0).felt == pytest.approx(expected)


# ------------------------------------------------------------------------------------------------------ random sheets


def over_random(source=(2.0, 300.0, PLATE), machines=1, feed=200.0, rms=1.0, seed=5):
    """Machines that stand high over random sheets, each begun elsewhere."""
    fleet, rng, every = fleet_over(feed, machines, gap=9.0), np.random.default_rng(seed), np.arange(machines)
    fleet.put_plate(every, source[2])
    angle, begin = rng.uniform(0, 2 * np.pi, machines), rng.uniform(0, 1, (2, machines))
    lengths = np.array([[sheet.RANDOM_ONE], [sheet.RANDOM_TWO]]) * sheet.RANDOM_SPACING
    fleet.put_random(every, source, 0, (rms * np.cos(angle), rms * np.sin(angle), *(begin * lengths)))
    return fleet


def surfaces(fleet: Fleet, steps: int) -> np.ndarray:
    """Surface under every machine at the end of each period, mm, shape (steps, machines)."""
    fleet.begin(np.arange(fleet.size), np.arange(1, fleet.size + 1))
    out = np.empty((steps, fleet.size))
    for i in range(steps):
        fleet.advance()
        out[i] = fleet.column("signals.surface_0")
    return out


@pytest.mark.parametrize(("exponent", "rolloff"), [(2.0, 300.0), (3.0, 400.0), (2.5, 800.0)])
def test_a_random_sheets_power_falls_over_the_wavenumber_as_it_should(exponent, rolloff):
    z = surfaces(over_random((exponent, rolloff, PLATE), machines=96, feed=500.0), 16_384)
    per_mm, density = signal.welch(z, fs=2.0, nperseg=8192, axis=0)
    k, seen = 2 * np.pi * per_mm, density.mean(axis=1) / (2 * np.pi)  # over rad/mm

    def shape(x):
        return (x * x + (2 * np.pi / rolloff) ** 2) ** (-exponent / 2) * float(sheet.attenuation(x)) ** 2

    whole, _ = integrate.quad(shape, 0.0, 6.0, limit=500, epsabs=1e-3)
    edges = np.geomspace(0.01, 1.5, 13)
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        inside = (k > low) & (k <= high)
        expected = np.mean([shape(x) for x in k[inside]]) / whole
        lines = (high - low) / (
            2 * np.pi / (sheet.RANDOM_ONE * sheet.RANDOM_SPACING)
        )  # of a table, each of random power
        assert seen[inside].mean() == pytest.approx(expected, rel=0.03 + 4.0 / np.sqrt(2 * lines)), (low, high)


def test_a_random_sheet_has_the_rms_that_is_asked_for_under_the_tip():
    ends = np.cumsum([sheet.RANDOM_ONE + 1, sheet.RANDOM_ONE + 1, sheet.RANDOM_TWO + 1])
    for source in ((2.0, 300.0, PLATE), (3.0, 400.0, 12.0)):
        tables = np.split(sheet.random_tables(*source), ends)
        for tip, felt in (tables[:2], tables[2:]):
            assert np.sqrt(np.mean(tip[:-1] ** 2)) == pytest.approx(1.0, abs=1e-12)
            assert abs(np.mean(tip[:-1])) < 1e-12
            assert 0.9 < np.sqrt(np.mean(felt[:-1] ** 2)) < 1.0
    z = surfaces(over_random(machines=256, feed=2000.0, rms=0.3), 4000)
    assert np.sqrt(np.mean(z**2)) == pytest.approx(0.3, rel=0.03)


@pytest.mark.parametrize("plate", [PLATE, 12.0])
def test_plate_and_tip_feel_the_same_random_sheet_each_through_its_footprint(plate):
    tables, s = sheet.random_tables(2.0, 300.0, plate), 0.5 * np.arange(32_768)
    r = Random(0.0, 0.6, 0.8, 1000.0, 20_000.0)
    tip, felt = (np.array([sheet.random_height(tables, r, x, side) for x in s]) for side in (0.0, 1.0))
    per_mm, coherence = signal.coherence(tip, felt, fs=2.0, nperseg=2048)
    k, inside = 2 * np.pi * per_mm, (per_mm > 0.003) & (per_mm < 0.4 / plate)
    assert coherence[inside].min() > 0.999
    power, both = signal.welch(tip, fs=2.0, nperseg=2048)[1], signal.csd(tip, felt, fs=2.0, nperseg=2048)[1]
    ratio = sheet.attenuation(k, plate) / sheet.attenuation(k)
    assert np.abs(both / power - ratio)[inside].max() < 0.01
    # What the plate misses is what its footprint lets through less.
    missed = signal.welch(felt - tip, fs=2.0, nperseg=2048)[1]
    assert missed[inside].sum() == pytest.approx((power * (1.0 - ratio) ** 2)[inside].sum(), rel=0.01)


@pytest.mark.parametrize(
    ("exponent", "pair", "heights", "moment"),
    [
        (2.0, 0, [-2.208480197250, -0.952278974051, 0.442799031032, 0.284401331944, 1.234146567809], -140.620527),
        (3.0, 9, [1.288783731826, 0.397928782999, -0.764153264335, 0.659561885817, -0.939920813853], 1832.095535),
    ],
)
def test_random_sheets_are_those_that_version_2_of_the_suite_was_frozen_with(exponent, pair, heights, moment):
    tables = sheet.random_tables(exponent, 300.0, PLATE, pair)
    assert tables[[0, 40_000, 200_000, 300_000, 450_000]] == pytest.approx(heights, abs=1e-9)
    assert np.dot(tables, np.arange(len(tables))) / len(tables) == pytest.approx(moment, abs=1e-5)


def test_pairs_of_tables_have_nothing_in_common():
    n = sheet.RANDOM_ONE
    first, second = (sheet.random_tables(2.0, 300.0, PLATE, pair)[:n] for pair in (0, 1))
    # Correlation at every shift; by chance it stays within about 5/√(independent lengths of 50 mm).
    together = np.fft.irfft(np.fft.rfft(first) * np.conj(np.fft.rfft(second)), n) / n
    assert np.abs(together).max() < 6.0 / np.sqrt(n * sheet.RANDOM_SPACING / 50.0)


def test_a_random_sheet_goes_on_across_the_ends_of_its_tables_and_repeats_them():
    tables = sheet.random_tables(2.0, 300.0, PLATE)
    n1, n2 = sheet.RANDOM_ONE, sheet.RANDOM_TWO
    parts = np.split(tables, np.cumsum([n1 + 1, n1 + 1, n2 + 1]))
    for side in (0, 1):
        for weights, n, table in (((1.0, 0.0), n1, parts[side]), ((0.0, 1.0), n2, parts[2 + side])):
            r, lap = Random(0.0, *weights, 0.0, 0.0), n * sheet.RANDOM_SPACING
            for turn in (-1, 0, 1, 2, 40):
                for sample in (0, 1, n // 3, n - 1):
                    at = turn * lap + sample * sheet.RANDOM_SPACING
                    assert sheet.random_height(tables, r, at, side) == pytest.approx(table[sample], abs=1e-9)
                    between = sheet.random_height(tables, r, at + 0.1, side)
                    assert between == pytest.approx(0.6 * table[sample] + 0.4 * table[sample + 1], abs=1e-9)
                before, after = (sheet.random_height(tables, r, turn * lap + e, side) for e in (-1e-7, 1e-7))
                assert abs(after - before) < 1e-6


# ------------------------------------------------------------------------------------------------- bands of vibration


def shaken_by(frequency, zeta, amplitude=0.02, machines=256, more=()):
    fleet, every = fleet_over(0.0, machines), np.arange(machines)
    phase = np.random.default_rng(9).uniform(0, 2 * np.pi, machines)
    fleet.put_vibration(every, 0, amplitude, frequency, phase, zeta)
    for i, other in enumerate(more, start=1):
        fleet.put_vibration(every, i, *other)
    return fleet


def recursion(frequency, zeta):
    """Poles' matrix of a band's steps of half a period: x″ + 2ζω·x′ + ω²·x = noise, speed first."""
    omega, dt = 2 * np.pi * frequency, 5e-4
    speed = np.array([-(omega**2) * dt, 1.0 - 2 * zeta * omega * dt])
    return np.array([np.array([1.0, 0.0]) + dt * speed, speed]), np.array([dt, 1.0])


@pytest.mark.parametrize(("frequency", "zeta"), [(15.0, 0.03), (30.0, 0.1), (80.0, 0.05), (150.0, 0.3), (200.0, 0.7)])
def test_a_band_has_its_variance_from_the_start_and_the_spectrum_of_its_mode(frequency, zeta):
    z = surfaces(shaken_by(frequency, zeta), 8192)
    assert np.mean(z**2) == pytest.approx(0.02**2 / 2, rel=0.05)
    assert np.mean(z[:50] ** 2) == pytest.approx(0.02**2 / 2, rel=0.25)
    hertz, seen = signal.welch(z, fs=1000.0, nperseg=4096, axis=0)
    seen = seen.mean(axis=1)

    # The steps' own spectrum, of variance amplitude²/2 by scipy's Lyapunov equation; sampled every other step.
    step, push = recursion(frequency, zeta)
    scale = 0.02**2 / 2 / linalg.solve_discrete_lyapunov(step, np.outer(push, push))[0, 0]

    def density(f):
        z = np.exp(2j * np.pi * f * 5e-4)
        return 2 * 5e-4 * scale * np.array([np.abs(np.linalg.solve(np.eye(2) * x - step, push)[0]) ** 2 for x in z])

    exact = density(hertz) + density(1000.0 - hertz)
    near = (hertz > 0.6 * frequency) & (hertz < min(1.5 * frequency, 480.0))
    smooth = np.convolve(exact, [0.25, 0.5, 0.25], "same")  # Welch's window is no wider than this
    assert seen[near].sum() == pytest.approx(exact[near].sum(), rel=0.04)
    if zeta * frequency > 5.0:  # wider than the window
        assert np.abs(seen[near] / smooth[near] - 1.0).max() < 0.2

    # The continuous oscillator's.
    w, w0 = 2 * np.pi * hertz[near], 2 * np.pi * frequency
    continuous = 4 * 0.02**2 / 2 * 2 * zeta * w0**3 / ((w0**2 - w**2) ** 2 + (2 * zeta * w0 * w) ** 2)
    if frequency <= 80.0:
        assert exact[near].sum() == pytest.approx(continuous.sum(), rel=0.05)
        assert hertz[exact.argmax()] == pytest.approx(hertz[near][continuous.argmax()], abs=1.0)


def test_bands_of_a_machine_and_of_its_neighbours_have_nothing_to_do_with_each_other():
    z = surfaces(shaken_by(40.0, 0.2, machines=40), 8192)
    across = np.corrcoef(z.T) - np.eye(40)
    assert np.abs(across).max() < 0.15
    both = surfaces(shaken_by(40.0, 0.2, machines=40, more=[(0.02, 40.0, 0.3, 0.2)]), 8192) - z
    assert np.mean(both**2) == pytest.approx(0.02**2 / 2, rel=0.1)
    own = [np.corrcoef(a, b)[0, 1] for a, b in zip(z.T, both.T, strict=True)]
    assert np.abs(own).max() < 0.15


def test_a_tone_beside_bands_is_the_tone_that_it_is_alone():
    tone, band = (0.03, 37.0, 0.4), (0.02, 50.0, 1.0, 0.1)
    alone, beside = fleet_over(0.0, 2), fleet_over(0.0, 2)
    for fleet in (alone, beside):
        fleet.put_vibration(np.arange(2), 0, *tone)
    beside.put_vibration(1, 1, *band)
    a, b = surfaces(alone, 300), surfaces(beside, 300)
    assert np.array_equal(a[:, 0], b[:, 0])
    assert np.abs(a[:, 1] - b[:, 1]).max() > 1e-3


# --------------------------------------------------------------------------------------------------------------- turns


def test_a_turns_mask_is_read_bit_by_bit_up_to_32():
    rng = np.random.default_rng(4)
    for many in (1, 2, 3, 10, 31, 32):
        for mask in [0, 1, 2**many - 1, *rng.integers(0, 2**many, 20).tolist(), 2 ** (many - 1)]:
            p = Turns(length=5.0, many=float(many))
            on = [sheet.turned(p, float(mask), 5.0 * (turn + 3 * many) + 2.0) for turn in range(many)]
            assert on == [float(mask >> turn & 1) for turn in range(many)]


def test_in_the_last_second_of_a_turn_the_next_one_fades_in():
    p = Turns(length=4.0, many=3.0)
    t = np.linspace(0.0, 24.0, 4801)
    on = np.array([sheet.turned(p, 0b011, x) for x in t])  # on, on, off
    u = np.clip(np.mod(t, 12.0) - 7.0, 0.0, 1.0) - np.clip(np.mod(t, 12.0) - 11.0, 0.0, 1.0)
    expected = 1.0 - np.where(u == 1.0, 1.0, 3 * u**2 - 2 * u**3)
    assert on == pytest.approx(expected, abs=1e-9)
    assert sheet.turned(p, 0b011, -1.0) == 1.0
    assert sheet.turned(Turns(), 0.0, 3.0) == 1.0


def test_what_takes_turns_is_on_in_its_own_and_the_rest_always():
    steps = 6000

    def over(**masks):
        fleet = over_random(feed=100.0, rms=0.1)
        fleet.set("start.gap", 0, 3.0)
        if masks:
            fleet.put("turns", 0, Turns(length=2.0, many=3.0, **{name: float(mask) for name, mask in masks.items()}))
            fleet.use_turns()
        return fleet

    t = 1e-3 * np.arange(steps)  # at the start of each period, which is when turns change

    def shown(turn):
        turns = Turns(length=2.0, many=3.0)
        return np.array([sheet.turned(turns, float(1 << turn), x) for x in t])

    alone = {name: np.zeros(steps) for name in ("waves", "random", "vibrations")}
    for name in alone:
        fleet = over()
        if name != "random":
            fleet.put_random(0, None)
        if name == "waves":
            fleet.put_wave(0, 0, 0.2, 0.1, 0.0, 0.0)
        if name == "vibrations":
            fleet.put_vibration(0, 0, 0.02, 20.0, 0.0)
            fleet.put_vibration(0, 1, 0.02, 30.0, 0.0, 0.1)
        alone[name] = surfaces(fleet, steps)[:, 0]
    fleet = over(waves=0b001, random=0b010, vibrations=0b100)
    fleet.put_wave(0, 0, 0.2, 0.1, 0.0, 0.0)
    fleet.put_vibration(0, 0, 0.02, 20.0, 0.0)
    fleet.put_vibration(0, 1, 0.02, 30.0, 0.0, 0.1)
    fleet.put_feature(0, 0, 50.0, FAR, 0.5, 0.0)
    expected = sum(shown(i) * z for i, z in enumerate(alone.values())) + np.where(
        positions(100.0, steps) > 50.0, 0.5, 0
    )
    away = np.abs(positions(100.0, steps) - 50.0) > 2.0
    assert surfaces(fleet, steps)[away, 0] == pytest.approx(expected[away], abs=1e-9)


def test_impulses_come_in_their_turns_only():
    fleet = fleet_over(0.0, 64)
    every = np.arange(64)
    fleet.put("sensor", every, sensor.EQ3._replace(noise=0.0, jitter=0.0, impulses=0.05))
    fleet.put("turns", every, Turns(length=2.0, many=2.0, impulses=2.0))
    fleet.use_turns()
    fleet.begin(every, np.arange(1, 65))
    hit = np.empty((4000, 64), bool)
    for i in range(4000):
        fleet.advance()
        hit[i] = np.abs(fleet.column("signals.raw_height") - 1.0) > 0.02
    assert not hit[:990].any()
    assert hit[2000:2990].mean() == pytest.approx(0.05, rel=0.1)
    assert hit[1400:1600].mean() == pytest.approx(0.025, rel=0.2)  # in the middle of the fade


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
