"""Causal bounds, against closed forms, brute force and the controllers that must not be below them."""

import dataclasses
import inspect

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.linalg import toeplitz
from scipy.optimize import lsq_linear

from kerfgym.envs import scenarios
from kerfgym.envs.control import stack as stacks
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.figures import metrics
from kerfgym.envs.plant import machine, path, sensor, sheet, z_axis
from kerfgym.envs.plant.controller import PERIOD
from kerfgym.experiments import bounds
from kerfgym.experiments.bounds import (
    changing,
    estimates,
    known,
    lasting,
    linear,
    lowering,
    moving,
    noise,
    prediction,
    reach,
    shapes,
    spectrum,
    stored,
)
from kerfgym.experiments.bounds import ingredients as read
from kerfgym.experiments.bounds import scenario as suite
from kerfgym.experiments.measure import rollout
from kerfgym.experiments.report import terminal
from kerfgym.experiments.store import stamp

SIGMA, RHO, SIZE = 2.0, 0.97, 30.0
CORE = scenarios.core("following")


def ornstein(rho=RHO, size=SIZE, lags=spectrum.MEMORY):
    r = size**2 * rho ** np.arange(lags)
    return spectrum.Random(r, r, size**2)


def error(random, drawn, sigma, horizon, at):
    return prediction.errors(random, drawn, sigma, np.array([horizon]), np.array([at]))[0, 0]


# ----------------------------------------------------------------------------------------------------------- prediction


@pytest.mark.parametrize("horizon", [1, 2, 5])
def test_an_ornstein_uhlenbeck_sheet_without_noise_costs_what_it_forgets(horizon):
    found, weights = prediction.wiener(ornstein(), 1e-4, horizon)
    assert found == pytest.approx(SIZE**2 * (1 - RHO ** (2 * horizon)), rel=1e-6)
    assert weights[0] == pytest.approx(RHO**horizon, rel=1e-6)


@pytest.mark.parametrize("horizon", [0, 2, 3])
def test_in_noise_it_costs_what_the_scalar_riccati_equation_says(horizon):
    q, p = SIZE**2 * (1 - RHO**2), SIZE**2
    for _ in range(2000):
        p = RHO**2 * (p - p**2 / (p + SIGMA**2)) + q
    filtered = p - p**2 / (p + SIGMA**2)
    wanted = RHO ** (2 * horizon) * filtered + SIZE**2 * (1 - RHO ** (2 * horizon))
    assert prediction.wiener(ornstein(), SIGMA, horizon)[0] == pytest.approx(wanted, rel=1e-9)
    assert prediction.Endless(ornstein(lags=2049), SIGMA).variance(horizon) == pytest.approx(wanted, rel=1e-9)


def band(frequency=40.0, zeta=0.05, lags=spectrum.MEMORY):
    return spectrum.bands(np.array([25.0]), np.array([2 * np.pi * frequency]), np.array([zeta]), lags)


@pytest.mark.parametrize("horizon", [0, 2, 4])
def test_a_memory_that_is_long_enough_is_endless(horizon):
    few, many = band(), band(lags=4097)
    endless = prediction.Endless(many + ornstein(lags=4097), SIGMA)
    variance, weights = prediction.wiener(few + ornstein(), SIGMA, horizon)
    assert endless.variance(horizon) == pytest.approx(variance, rel=1e-6)
    np.testing.assert_allclose(endless.weights(horizon)[:50], weights[:50], atol=1e-6)


def test_the_error_of_the_next_reading_is_kolmogorovs():
    random = band(lags=2049) + ornstein(lags=2049)
    white = prediction.Endless(random, SIGMA).whitener
    lags = np.concatenate([random.yy, random.yy[:0:-1]])
    lags[0] += SIGMA**2
    density = np.maximum(np.fft.rfft(lags).real, 1e-12)
    two_sided = np.concatenate([density, density[-1:0:-1]])
    assert white[0] ** -2 == pytest.approx(np.exp(np.log(two_sided).mean()), rel=1e-3)


def test_of_a_sine_of_known_frequency_two_numbers_remain_to_be_learned():
    phase = 2 * np.pi * 17.0 * PERIOD * np.arange(3000)
    drawn = shapes.sine(phase, 1e9)
    assert error(spectrum.NOTHING, drawn, SIGMA, 2, 2999) == pytest.approx(2 * SIGMA**2 / 2998, rel=1e-2)
    unknown = drawn + shapes.stretch(phase, np.arange(3000) * PERIOD, 500.0, 1e9)
    # Over a cycle the mean of 2σ²/n, in phase, and of 8σ²/n, in quadrature: what a line's end is known to, twice.
    cycle = prediction.errors(spectrum.NOTHING, unknown, SIGMA, np.array([0]), np.arange(2941, 3000))
    assert cycle.mean() == pytest.approx(5 * SIGMA**2 / 2970, rel=1e-2)


def test_of_a_slope_through_a_known_point_one_number_remains():
    n = 1500
    drawn = shapes.ramp(np.arange(1, n + 1), 1e9)
    assert error(spectrum.NOTHING, drawn, SIGMA, 0, n - 1) == pytest.approx(3 * SIGMA**2 / n, rel=2e-3)


def test_a_constant_level_is_known_to_the_noise_over_the_root_of_the_readings():
    drawn = shapes.ramp(np.ones(400), 1e9)
    assert error(spectrum.NOTHING, drawn, SIGMA, 3, 399) == pytest.approx(SIGMA**2 / 397)


def test_a_shape_whose_size_is_known_beforehand_costs_its_variance_until_it_is_read():
    drawn = shapes.ramp((np.arange(50) >= 40).astype(float), 9.0)
    found = prediction.errors(spectrum.NOTHING, drawn, SIGMA, np.array([2]), np.array([30, 40, 41, 42]))[0]
    np.testing.assert_allclose(found, [0.0, 9.0, 9.0, 1 / (1 / 9 + 1 / SIGMA**2)])


@pytest.mark.parametrize("horizon", [1, 3])
def test_shapes_on_a_random_sheet_agree_with_the_whole_covariance_matrix(horizon):
    random, n = ornstein(0.8, 5.0, 129), 400
    drawn = shapes.sine(2 * np.pi * 9.0 * PERIOD * np.arange(n), 50.0, sensor=0.7) + shapes.ramp(np.arange(n), 0.01)
    at, seen = n - 1, n - horizon
    lags = 25.0 * 0.8 ** np.arange(n)
    prior = np.diag(drawn.variance)
    read = toeplitz(lags)[:seen, :seen] + SIGMA**2 * np.eye(seen) + drawn.sensor[:seen] @ prior @ drawn.sensor[:seen].T
    cross = lags[at - np.arange(seen)] + drawn.score[at] @ prior @ drawn.sensor[:seen].T
    whole = 25.0 + drawn.score[at] @ prior @ drawn.score[at] - cross @ np.linalg.solve(read, cross)
    assert error(random, drawn, SIGMA, horizon, at) == pytest.approx(whole, rel=2e-3)


@pytest.mark.parametrize(("horizon", "since"), [(1, 0), (1, 3), (2, 12), (4, 30)])
def test_finer_readings_until_a_moment_agree_with_the_whole_covariance_matrix(horizon, since):
    random, n, before = ornstein(0.9, 5.0, 1025) + band(lags=1025), 400, 0.3
    both = 25.0 * 0.9 ** np.arange(n + horizon) + band(lags=n + horizon).yy
    sigma = np.where(np.arange(n) < n - since, before, SIGMA)
    read = toeplitz(both[:n]) + np.diag(sigma**2)
    cross = both[horizon : horizon + n][::-1]
    wanted = both[0] - cross @ np.linalg.solve(read, cross)
    told = prediction.Told(random, SIGMA, before, 40)
    assert told.variance(horizon, since) == pytest.approx(wanted, rel=1e-6)


def test_what_finer_readings_told_is_forgotten_until_nothing_is_left_of_it():
    random = ornstein(0.9, 5.0, 1025)
    told = prediction.Told(random, SIGMA, 0.01, 200)
    course = [told.variance(2, since) for since in range(200)]
    assert (np.diff(course) >= -1e-9).all()
    assert course[0] == pytest.approx(prediction.Endless(random, 0.01).variance(2))
    assert course[0] < 0.9 * course[-1]
    assert course[-1] == pytest.approx(prediction.Endless(random, SIGMA).variance(2), rel=1e-6)


def test_a_fixed_prediction_of_slopes_is_the_best_for_their_second_moments():
    horizon, memory = 2, spectrum.MEMORY - prediction.FARTHEST
    random = ornstein(0.9, 5.0)
    slope = np.array([[4000.0, 30.0], [30.0, 0.3]])
    found = linear.Ensemble(random, slope, np.zeros(0)).error(SIGMA, horizon)
    since = horizon + np.arange(memory)
    rows = np.stack([np.ones(memory), -since.astype(float)], axis=1)
    lags = 25.0 * 0.9 ** np.arange(memory)
    read = toeplitz(lags) + SIGMA**2 * np.eye(memory) + rows @ slope @ rows.T
    cross = 25.0 * 0.9**since + rows @ slope[0]
    wanted = 25.0 + slope[0, 0] - cross @ np.linalg.solve(read, cross)
    assert found == pytest.approx(wanted, rel=1e-6)
    _, weights = prediction.wiener(
        random, SIGMA, horizon, shapes.ramp(np.ones(512), 1.0) + shapes.ramp(-np.arange(512.0), 1.0), slope
    )
    np.testing.assert_allclose(weights, np.linalg.solve(read, cross), atol=1e-8)


# ------------------------------------------------------------------------------------------------------------- lowering


def eye(sigma=2.0, height=500.0, depths=400):
    """Noise as it grows with the square of the gap."""
    depth = lowering.DEEP * height * np.linspace(0.0, 1.0, depths) ** 2
    return lowering.Sight(sigma, 1e-3, depth, (1.0 - depth / height) ** -4 - 1.0)


def test_a_head_that_is_held_lower_costs_more_than_the_bound_says_whatever_its_depth():
    random, sight = ornstein(0.9, 5.0, 1025), eye(height=60.0)
    free = prediction.Endless(random, sight.noise).variance(2)
    costs = [
        prediction.Endless(random, sight.noise * (1.0 - d / 60.0) ** 2).variance(2) + d * d
        for d in [*np.linspace(0.0, 0.5, 101), *np.linspace(0.5, 20.0, 101)]
    ]
    assert free - sight.gain(np.array(free)) <= min(costs) < free
    assert sight.gain(np.array(free)) < 0.1 * free


def test_a_deep_dip_pays_only_where_what_it_tells_lasts():
    sight = eye(height=500.0)
    assert not sight.pays(384, 25.0)
    assert sight.pays(10_000, 25.0)


def test_the_sensor_resolves_no_gap_better_than_its_least_and_the_worth_of_a_reading_is_its_noise():
    fleet = read.prepared(scenarios.load("flat"), range(3))
    sights, heights = noise.sights(fleet), fleet.column("job.set_height")
    for i, sight in enumerate(sights):
        assert sight.noise == noise.gaussian(fleet)[i]
        assert sight.finest < 1e-3 * sight.noise
        lower = heights - 1e-3 * sight.depth[150]
        assert sight.worth[150] == pytest.approx((sight.noise / noise.at(fleet, lower)[i]) ** 2 - 1.0)
    p = fleet.get("sensor", 0)._replace(noise=0.0, jitter=0.0)
    with np.errstate(over="ignore"):  # random bits
        said = [
            sensor.step(p, sensor.State(), fleet.get("gate", 0), gap, 1.0, 0.0, np.uint64(1), np.uint64(1))[1]
            for gap in (0.2 * sensor.LEAST_GAP, sensor.LEAST_GAP, 2 * sensor.LEAST_GAP)
        ]
    assert said[0] == said[1] != said[2]


def test_stairs_are_below_what_a_controller_with_finer_readings_before_the_score_is_left_with():
    random, sight, periods = ornstein(0.9, 5.0, 4097), eye(), 600
    free = np.full(6, 1e9)
    told = prediction.Told(random, sight.noise, sight.finest, periods)
    exact = np.mean([told.variance(2, max(n - 1, 0)) for n in range(periods)])
    found = lasting.mean_square(random, sight, 2 + np.arange(7), free, periods)
    assert 0.97 * exact < found <= exact


# -------------------------------------------------------------------------------------------------------------- spectra


SHEETS = [(2.0, 300.0), (2.5, 800.0), (3.0, 400.0)]


def test_a_band_has_the_covariances_of_the_motion_that_the_machine_makes():
    v, rng, many = sheet.Vibration(np.sqrt(2.0) * 5.0, 2 * np.pi * 30.0, 0.0, 0.1), np.random.default_rng(1), 2000
    s, seen = sheet.Shaken(np.zeros(many), np.zeros(many)), []
    for n in range(1200):
        s = sheet.shake(v, s, rng.normal(size=many), 0.5 * PERIOD)
        if n >= 1000 and n % 2:  # two steps a period
            seen.append(s.height)
    heights = np.array(seen)
    found = np.array([np.mean(heights[:60] * heights[lag : lag + 60]) for lag in range(40)])
    wanted = band(30.0, 0.1)
    np.testing.assert_allclose(found, wanted.yy[:40], atol=1.5)  # of 25; 2000 courses tell that much
    assert wanted.xx == 25.0


@pytest.mark.parametrize(("exponent", "rolloff"), SHEETS)
def test_a_surface_has_the_covariances_of_the_machines_tables(exponent, rolloff):
    tables, n = sheet.random_tables(exponent, rolloff, sheet.PLATE), sheet.RANDOM_ONE
    tip, felt = tables[:n], tables[n + 1 : 2 * n + 1]
    surface = spectrum.surface(exponent, rolloff, sheet.PLATE)
    for lag in (0, 4, 24, 80):
        d = lag * sheet.RANDOM_SPACING
        # One table of 33 m is one sample of a long wave only dozens of times, so structure functions are compared.
        for one, two, found in ((felt, felt, surface.yy), (tip, felt, surface.xy)):
            rises = np.mean((one - np.roll(two, lag)) ** 2)
            itself = surface.xx if one is tip else float(surface.yy(0.0))
            assert itself + surface.yy(0.0) - 2 * found(d) == pytest.approx(rises, rel=0.15, abs=1e-6)


@pytest.mark.parametrize(("exponent", "rolloff"), SHEETS)
@pytest.mark.parametrize("sigma", [0.4, 2.5])
def test_the_best_filter_makes_the_error_that_is_predicted_on_the_machines_own_sheet(exponent, rolloff, sigma):
    size, horizon, n = 100.0, 3, sheet.RANDOM_ONE
    tables, grid = sheet.random_tables(exponent, rolloff, sheet.PLATE), np.arange(n + 1) * sheet.RANDOM_SPACING
    places = 0.2 * np.arange(150_000)
    tip, felt = (size * np.interp(places, grid, t) for t in (tables[: n + 1], tables[n + 1 : 2 * n + 2]))
    readings = felt + sigma * np.random.default_rng(2).normal(size=len(places))
    random = spectrum.surface(exponent, rolloff, sheet.PLATE).at(200.0, size**2, spectrum.ENDLESS)
    endless = prediction.Endless(random, sigma)
    guess = np.convolve(readings, endless.weights(horizon)[:8000])[: len(places)]
    left = tip[20_000:] - guess[20_000 - horizon : -horizon]
    assert np.sqrt(np.mean(left**2)) == pytest.approx(np.sqrt(endless.variance(horizon)), rel=0.05)


def test_a_plate_wider_than_the_tip_knows_less_of_short_waves_but_knows_them_earlier():
    wide, narrow = (spectrum.surface(2.0, 300.0, r).at(200.0, 1e4, spectrum.ENDLESS) for r in (5.6, 2.0))
    wide, narrow = prediction.Endless(wide, 2.0), prediction.Endless(narrow, 2.0)
    assert wide.variance(1) > 2 * narrow.variance(1)
    assert narrow.variance(18) > 1.5 * wide.variance(18)  # 3.6 mm at 200 mm/s


def test_footprints_part_what_sensor_and_score_see():
    k = np.array([2 * np.pi / 30.0, 2 * np.pi / 12.0])
    wide, narrow = sheet.attenuation(k, 5.6), sheet.attenuation(k, 2.0)
    both = spectrum.tones(np.array([4.0, 1.0]), 200.0 * k, wide, narrow)
    assert both.yy[0] == pytest.approx((np.array([4.0, 1.0]) * wide**2).sum())
    assert both.xy[0] == pytest.approx((np.array([4.0, 1.0]) * wide * narrow).sum())
    assert both.xx == pytest.approx((np.array([4.0, 1.0]) * narrow**2).sum())


# ------------------------------------------------------------------------------------------------------- changing feed


def blind(sigma, finest=None):
    """A reading that lowering the head does not better."""
    return lowering.Sight(sigma, finest or sigma, np.array([0.0, 1e6]), np.zeros(2))


@pytest.mark.parametrize(("exponent", "rolloff"), SHEETS)
def test_at_a_constant_feed_cells_know_what_wieners_filter_knows(exponent, rolloff):
    surface = spectrum.surface(exponent, rolloff, sheet.PLATE)
    endless = prediction.Endless(surface.at(200.0, 1e4, spectrum.ENDLESS), 2.0)
    where, at = 0.2 * np.arange(1, 1201), np.array([1199])
    found = changing.errors(surface, 100.0, blind(2.0), where, [2, 9], at)[0][:, 0]
    exact = np.array([endless.variance(h) for h in (2, 9)])
    # Of the sheet more than the span behind all is given away, so the bound is lower, but not by much.
    assert (np.sqrt(found) <= 1.001 * np.sqrt(exact)).all()
    assert (np.sqrt(found) > 0.97 * np.sqrt(exact)).all()


def test_more_of_the_sheet_given_away_only_lowers_the_error(monkeypatch):
    surface, where, found = spectrum.surface(3.0, 400.0, sheet.PLATE), 0.2 * np.arange(1, 1201), []
    for span in (8.0, 16.0, 32.0, 64.0):
        monkeypatch.setattr(changing, "SPAN", span)
        found.append(changing.errors(surface, 100.0, blind(2.0), where, [2], np.array([1199]))[0][0, 0])
    assert (np.diff(found) > 0).all()
    assert found[-1] - found[-2] < 0.2 * (found[1] - found[0])


def test_at_a_feed_that_changes_cells_know_what_the_whole_covariance_matrix_says():
    surface, size, sigma, horizon = spectrum.surface(2.0, 300.0, sheet.PLATE), 80.0, 1.5, 3
    where = np.cumsum(PERIOD * np.concatenate([np.full(200, 200.0), np.linspace(200, 10, 60), np.full(60, 10.0)]))
    for n in (190, 259, 319):
        seen = where[: n - horizon + 1]
        read = size**2 * surface.yy(np.abs(seen[:, None] - seen)) + sigma**2 * np.eye(len(seen))
        cross = size**2 * surface.xy(np.abs(where[n] - seen))
        wanted = size**2 * surface.xx - cross @ np.linalg.solve(read, cross)
        found = changing.errors(surface, size, blind(sigma), where, [horizon], np.array([n]))[0][0, 0]
        assert 0.97 * np.sqrt(wanted) < np.sqrt(found) < 1.001 * np.sqrt(wanted)


def test_ten_times_the_readings_are_worth_a_tenth_of_their_variance_and_finer_ones_more():
    surface = spectrum.surface(3.0, 400.0, sheet.PLATE)

    def left(feed, sigma, horizon):
        where = feed * PERIOD * np.arange(1, 601 * round(200.0 / feed))
        return changing.errors(surface, 100.0, blind(sigma), where, [horizon], np.array([len(where) - 1]))[0][0, 0]

    assert left(20.0, 2.0, 20) == pytest.approx(left(200.0, 2.0 / np.sqrt(10.0), 2), rel=0.03)
    assert left(20.0, 2.0, 2) < 0.7 * left(200.0, 2.0, 2)
    where, at = 0.2 * np.arange(1, 401), np.array([399])
    finer, usual = (changing.errors(surface, 100.0, blind(2.0, 1e-3), where, [2], at, scored)[0] for scored in (390, 0))
    assert finer < 0.5 * usual


def test_the_way_through_corners_is_the_machines():
    fleet = read.prepared(scenarios.load("corners"), range(3))
    ways = [moving.places(fleet.get("path", i), 0.0, 500) for i in range(3)]
    fleet.begin(np.arange(3), np.arange(3))
    for n in range(500):
        fleet.advance()
        if n % 50 == 49:
            assert fleet.column("journey.here") == pytest.approx([way[n] for way in ways], abs=0.02)
    assert np.diff(ways[0]).min() < 0.06 < 0.19 < np.diff(ways[0]).max()


def test_turns_count_what_is_on_but_not_the_fading():
    shift = scenarios.load("shift")
    smooth = moving.Along(path.Params(), None, 0.0, blind(1.0), [2], np.ones(1))
    assert moving.over_turns(shift, smooth, 5.0) == pytest.approx(5.0 * 4 * 29.0 / 299.7)
    assert moving.over_turns(shift, smooth, 0.0) == 0.0


def test_in_turns_the_whole_sheet_costs_about_its_share_of_what_it_costs_all_the_time():
    shift, surface = scenarios.load("shift"), spectrum.surface(2.0, 300.0, sheet.PLATE)
    straight = moving.Along(path.Params(), surface, 80.0, blind(2.0), [2], np.full(1, 1e9))
    endless = prediction.Endless(surface.at(200.0, 6400.0, spectrum.ENDLESS), 2.0).variance(2)
    assert moving.over_turns(shift, straight, 0.0) == pytest.approx(endless * 4 * 29.0 / 299.7, rel=0.05)


# ---------------------------------------------------------------------------------------------------------------- drive


def test_what_a_limited_correction_leaves():
    sigma, r = 3.0, 2.0

    def left(x):
        return max(abs(x) - r, 0.0) ** 2 * np.exp(-0.5 * (x / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))

    assert prediction.beyond(np.array(sigma), np.array(r)) == pytest.approx(2 * quad(left, r, 40.0)[0])
    variances = np.array([[4.0], [9.0], [25.0]])
    assert prediction.held_back(variances, np.array([1e9, 1e9])) == pytest.approx(4.0)
    assert prediction.held_back(variances, np.array([0.0, 0.0])) == pytest.approx(25.0)


AXIS = reach.Reach(jerk=2e9, omega=2 * np.pi * 100, zeta=0.05, share=0.1, backlash=5.0, dead=1.0)


def test_the_head_answers_a_pulse_of_jerk_as_its_differential_equation_says():
    w, z = AXIS.omega, AXIS.zeta
    t = np.linspace(0.0, 0.03, 7)

    def motion(t, x):
        return [x[1], w * w * (0.5 * t * t - x[0]) - 2 * z * w * x[1]]

    mode = solve_ivp(motion, (0, 0.03), [0.0, 0.0], t_eval=t, rtol=1e-10, atol=1e-16).y[0]
    np.testing.assert_allclose(AXIS.answer(t), 0.9 * 0.5 * t * t + 0.1 * mode, atol=1e-12)


def test_without_a_mode_the_reach_is_a_sixth_of_jerk_times_time_cubed():
    stiff = reach.Reach(2e9, 600.0, 0.05, 0.0, 0.0, 1.0)
    np.testing.assert_allclose(stiff.within(5), 2e9 * (PERIOD * np.arange(1, 6)) ** 3 / 6, rtol=1e-3)
    late = reach.Reach(2e9, 600.0, 0.05, 0.0, 0.0, 1.25)
    assert (stiff.horizon, late.horizon) == (2, 2)
    assert late.within(1)[0] == pytest.approx(2e9 * (0.75 * PERIOD) ** 3 / 6, rel=1e-2)


@pytest.mark.parametrize(("sign", "friction"), [(1.0, 0.0), (-1.0, 0.0), (1.0, 800.0)])
def test_no_command_moves_the_machines_head_further(sign, friction):
    p = z_axis.Params(friction=friction, bristle=0.004, stiction=1.5, backlash=0.0)
    axis, gains, s = reach.Reach.of(p), z_axis.gains(p, machine.DT), z_axis.at_rest(0.0)
    moved = []
    for _ in range(6):
        for k in range(machine.SUBSTEPS):
            pace = z_axis.Pace(sign * 500.0, sign * 500.0, 0.0)
            s, head = z_axis.step(p, gains, pace, s, (k + 1) / machine.SUBSTEPS, machine.DT)
        moved.append(1e3 * sign * head)
    most = axis.within(6)
    assert (np.array(moved) <= most).all()
    assert moved[2] > 0.8 * most[2] or friction  # and the bound is not idle; friction only brakes


@pytest.mark.parametrize(("dead", "latency"), [(0.0, 0.0), (0.001, 0.0), (0.0015, 0.0), (0.001, 0.0009), (0.002, 0.0)])
def test_the_machine_lets_a_command_act_no_sooner_than_the_horizon(dead, latency):
    axis = {"dead_time": dead, "latency": latency, "friction": 0.0, "bristle": 0.0}
    flat = scenarios.load("flat").varied(axis=axis, duration=0.1, settle=0.0)
    gaps = []
    for push in (0.0, 400.0):
        fleet = rollout.fleet_for(flat, stacks.resolve("xi2023-ma"), [3])
        gap, hand = fleet.row("moment.gap"), fleet.row("hand.residual")
        fleet.set("hand.gain", 0, 0.0)
        seen = []
        for period in range(30):
            hand[0] = push if period >= 20 else 0.0  # decided on the reading of period 19
            fleet.advance()
            seen.append(float(gap[0]))
        gaps.append(seen)
    first = int(np.argmax(np.abs(np.subtract(*gaps)) > 0))
    assert first - 19 == reach.Reach.of(fleet.get("z", 0)).horizon


# ---------------------------------------------------------------------------------------------------------------- steps


def cost(axis, height=250.0, score=2.0, starts=(50.05,), scored=range(10_000)):
    found = axis.cost_of_steps(np.full(len(starts), height), np.array(starts), 200.0, score, score, scored)
    return found.mean()


@pytest.mark.parametrize(("dead", "periods"), [(0.0, 1), (1.0, 2), (2.0, 3)])
def test_a_sudden_step_under_a_free_drive_costs_the_dead_time(dead, periods):
    free = reach.Reach(1e16, 600.0, 0.05, 0.0, 0.0, dead)
    assert cost(free, score=1e-3) == pytest.approx(periods * 250.0**2, rel=1e-6)


def test_a_step_costs_more_with_less_jerk_and_more_dead_time_and_nothing_unscored():
    base = cost(AXIS)
    assert cost(reach.Reach(1e9, *list(vars(AXIS).values())[1:6])) > 1.5 * base
    assert cost(reach.Reach(2e9, 628.3, 0.05, 0.1, 5.0, 2.0)) > 1.5 * base
    assert cost(AXIS, scored=range(200)) == 0.0


def test_a_plate_that_reaches_ahead_of_the_score_makes_a_step_foreseen():
    wide = AXIS.cost_of_steps(np.array([250.0]), np.array([50.05]), 200.0, 5.6, 2.0, range(10_000))
    assert wide[0] < 0.01 * cost(AXIS)


def test_the_dual_is_below_the_best_that_a_jerk_constant_in_each_period_can_do_and_near_it():
    ends = np.arange(1, reach.WINDOW + 1)
    course = 300.0 * np.array([sheet.share(min((n + 4.0) / 10.0 - 1.0, 1.0)) for n in ends])
    size = AXIS.jerk * PERIOD**3
    best = lsq_linear(AXIS._pieces, course / size, (-1.0, 1.0), method="bvls")
    primal = 2 * best.cost * size**2
    stiff = reach.Reach(*list(vars(AXIS).values())[:4], 0.0, 1.0)
    dual = stiff.cost(course[:, None], np.ones((reach.WINDOW, 1)))[0]
    assert 0.9 * primal < dual <= primal
    assert AXIS.cost(course[:, None], np.ones((reach.WINDOW, 1)))[0] <= dual  # free play can only help


# ------------------------------------------------------------------------------------------------------------- readings


def test_noise_is_that_of_the_field_numbers():
    flat = scenarios.load("flat").varied(head={"noise": 0.01, "nominal": True, "jitter": 0.0})
    for height, micrometres in ((0.5, 3.5), (1.0, 13.0), (2.0, 47.0)):  # µm for 0.01 pF, docs/physics.md#the-sensor
        fleet = read.prepared(flat.varied(set_height=height), [0])
        assert noise.gaussian(fleet)[0] == pytest.approx(micrometres, rel=0.05)


# ---------------------------------------------------------------------------------------------------------------- suite


def test_sheets_are_read_as_the_machine_has_them():
    chatter = scenarios.load("chatter")
    fleet = read.prepared(chatter, range(40))
    variance, omega, zeta = read.of_bands(fleet, chatter)
    assert variance.shape == (3, 40)
    assert ((omega > 2 * np.pi * 30) & (omega < 2 * np.pi * 100)).all()
    assert ((2 * variance > 4) & (2 * variance < 64)).all()
    assert ((zeta > 0.02) & (zeta < 0.1)).all()
    rough = scenarios.load("rough")
    fleet = read.prepared(rough, range(40))
    k = fleet.listed(sheet.Wave, 3).kx
    wanted = sheet.attenuation(k, sheet.PLATE) / sheet.attenuation(k)
    np.testing.assert_allclose(read.Lines.of(fleet, rough).sensor[3], wanted)
    k3 = scenarios.load("random-k3")
    sizes = read.of_sizes(read.prepared(k3, range(40)))
    assert ((sizes > 100) & (sizes < 400)).all()


def test_a_bulge_grows_as_the_machines():
    bulge = scenarios.load("bulge").varied(sheet={"tilt": 0.0, "bulge": {"height": 0.7}})
    fleet = read.prepared(bulge, range(2))
    wanted = [0.7 * estimates.bulge(fleet, i, np.arange(1, 2001) * PERIOD) for i in range(2)]
    fleet.begin(np.arange(2), np.arange(2))
    highest = 0.0
    for n in range(2000):
        fleet.advance()
        if n % 100 == 99:
            height = fleet.column("signals.surface_0")
            assert height == pytest.approx([way[n] for way in wanted], abs=4e-3)
            highest = max(highest, height.max())
    assert highest > 0.1


def test_where_steps_are_counted_the_rest_of_the_sheet_is_not_and_never_both_are_less_than_one():
    step = scenarios.load("following-v1/step")
    rough = {"random": {"rms": 0.3}}
    sheets = (step.varied(sheet={"steps": None, **rough}), step, step.varied(sheet=rough))
    flat, one, both = (suite.of(each, range(1000, 1004)) for each in sheets)
    assert max(flat.bound, one.bound) <= both.bound < np.hypot(flat.bound, one.bound)


BOUNDED = (
    "random-k2",
    "random-k3",
    "flutter",
    "chatter",
    "step-flutter",
    "corners",
    "following-v1/step",
    "ood/fast-step",
    "elsewhere/tabs",
)
"""Scenarios with something that nobody can learn: continuous spectra, bands, steps, corners."""


@pytest.mark.parametrize("name", BOUNDED)
def test_no_follower_is_below_its_bound(name):
    seeds, scenario = range(1000, 1008), scenarios.load(name)
    some = scenario.some(seeds)
    bound = suite.of(scenario, seeds)
    assert 1.0 < bound.bound <= bound.learned
    for controller in ("self-tuning", "lqg", "observer"):
        run = rollout.roll(scenario, stacks.resolve(controller), some)
        squares = metrics.METRICS["rms_true"].function(run)[~metrics.failed(run)] ** 2
        rms = np.sqrt(np.mean(squares))
        assert bound.bound < rms
        # The bound is no triviality: who learns comes near it, except for steps.
        assert controller != "self-tuning" or rms < 5 * bound.bound or scenario.sheet.steps


@pytest.mark.parametrize("name", ["tilt", "wavy", "rough", "impulses", "following-v1/chatter"])
def test_where_all_can_be_learned_the_bound_is_nothing(name):
    found = suite.of(scenarios.load(name), range(1000, 1002))
    assert found.bound == 0.0 < found.learned < found.linear


def test_the_best_estimator_of_lines_is_as_good_as_estimated_and_better_if_it_looks_closely_first():
    rng, periods, at, horizon, runs = np.random.default_rng(5), 600, 599, 2, 2000
    t = np.arange(1, periods + 1) * PERIOD
    drawn = shapes.sine(2 * np.pi * 17.0 * t, 300.0, 0.8) + shapes.ramp(1e3 * t, 0.05)
    sizes = rng.normal(size=(runs, 3)) * np.sqrt(drawn.variance)
    for early, factor in ((SIGMA, 1.0), (SIGMA / 50.0, 0.0)):
        sigma = np.where(np.arange(periods) < 300, early, SIGMA)
        seen = slice(0, at - horizon + 1)
        readings = sizes @ drawn.sensor[seen].T + sigma[seen] * rng.normal(size=(runs, at - horizon + 1))
        scaled = drawn.sensor[seen] / sigma[seen, None]
        knowledge = scaled.T @ scaled + np.diag(1.0 / drawn.variance)
        guess = np.linalg.solve(knowledge, scaled.T @ (readings / sigma[seen]).T).T
        left = np.mean(((sizes - guess) @ drawn.score[at]) ** 2)
        estimated = error(spectrum.NOTHING, drawn, SIGMA, horizon, at)
        if factor:
            assert left == pytest.approx(estimated, rel=0.1)
        else:
            assert left < 0.02 * estimated


def test_the_bound_follows_dead_time_and_noise():
    seeds, rough = range(1000, 1006), scenarios.load("rough")
    before = suite.of(rough, seeds)
    noisy = suite.of(rough.varied(head={"noise": {"log_uniform": [5e-3, 5e-2]}}), seeds)
    assert noisy.learned > 2 * before.learned
    k2 = scenarios.load("random-k2")
    before, noisy = (suite.of(each, seeds) for each in (k2, k2.varied(head={"noise": 0.02})))
    assert noisy.bound > 1.5 * before.bound
    narrow = scenarios.load("following-v1/rough")  # a wide plate sees the sheet before it is met
    before, late = (suite.of(each, seeds) for each in (narrow, narrow.varied(axis={"dead_time": 0.004})))
    assert late.linear > 1.3 * before.linear


def test_what_no_bound_is_known_for_is_refused():
    with pytest.raises(InvalidInput, match="no bound is known for scenario 'holes': it has holes"):
        suite.of(scenarios.load("holes"), range(2))
    with pytest.raises(InvalidInput, match="it has a path other than a straight line"):
        suite.of(scenarios.load("flat").varied(circle={}), range(2))
    with pytest.raises(InvalidInput, match="it has a descent"):
        suite.of(scenarios.load("descent"), range(2))


@pytest.mark.parametrize("part", known.KNOWN)
def test_a_part_that_nobody_has_thought_of_has_no_bound(part, monkeypatch):
    every = {field.name for field in dataclasses.fields(part)}
    assert every >= known.KNOWN[part]
    bulge = {"height": 0.5, "width": 20, "growth": 2}
    shift = scenarios.load("shift").varied(sheet={"bulge": bulge}, axis={"jerk": 1e6})
    assert known.unknown(shift) == []
    monkeypatch.setitem(known.KNOWN, part, frozenset())
    assert known.unknown(shift)


# --------------------------------------------------------------------------------------------------------------- record


def test_the_record_is_as_old_as_what_it_is_made_from():
    assert bounds.stale() == [], "python -m kerfgym.experiments.bounds makes it anew"


def test_every_core_scenario_has_a_bound_and_a_changed_one_has_none():
    wanted = set(stored.wanted())
    for name in ("following", "following-v1", "ood", "elsewhere"):
        assert {f"{name}/{each}" for each in scenarios.core(name)} <= wanted
    assert bounds.recorded(scenarios.load("following-v1/wavy")) != bounds.recorded(scenarios.load("wavy"))
    for name in CORE:
        found = bounds.recorded(scenarios.load(name))
        assert 0 <= found.bound <= found.learned
        assert found.bound <= found.linear
    wavy = scenarios.load("wavy")
    assert bounds.recorded(wavy.varied(feed=201.0)) is None
    assert bounds.recorded(wavy.varied(name="other", summary="said otherwise", version=1)) == bounds.recorded(wavy)


def test_a_comment_in_a_source_makes_no_record_stale_but_another_number_does():
    files = [path for found in stamp.files(stored.SOURCES).values() for path in found]
    names = {path.name for path in files}
    assert {"lanes.py", "controller.py", "calibration.py", "lasting.py", "preparing.py"} <= names
    assert "record.py" not in names
    text = inspect.getsource(lasting)
    assert stamp.code(text) == stamp.code(text.replace("import numpy", "# said\nimport numpy"))
    assert stamp.code(text) != stamp.code(text.replace("384)", "385)"))


def test_steps_of_an_ensemble_rise_over_a_short_way_as_its_spectrum_says():
    step = scenarios.load("following-v1/step")
    jumps = spectrum.surface(2.0, linear.ENDLESS_STEPS, step.head.plate)
    fleet = read.prepared(step, range(400))
    size = linear._size_of_steps(jumps, fleet, step)
    few, squares = 0.5, []
    for i in range(fleet.size):
        heights, starts = read.steps_of(fleet, step, i)
        for place in np.arange(60.0, 400.0, few):
            squares.append(heights[(starts > place) & (starts <= place + few)].sum() ** 2)
    lag = round(few / sheet.RANDOM_SPACING)
    assert 2.0 * size * (jumps.bare[0] - jumps.bare[lag]) == pytest.approx(np.mean(squares), rel=0.05)


def test_bounds_are_shown_last_in_the_table_and_drawn_in_the_report(made_up):
    from kerfgym.experiments.plots.palette import looks
    from kerfgym.experiments.report import heat, scores
    from kerfgym.experiments.report.standing import all_of
    from kerfgym.experiments.report.suite import Suite

    results = made_up.following()
    assert stored.LABEL not in terminal.sheets(results)[0].markdown()
    results.meta["bounds"] = {"wavy": 0.25, "rough": 1.0}
    assert results.bound == pytest.approx(0.5)
    sheet_ = terminal.sheets(results)[0]
    row = dict(zip(sheet_.titles, sheet_.sections[-1][0], strict=True))
    assert len(sheet_.sections[-1]) == 1
    shown = [row[title] for title in ("controller", "score, µm", "wavy", "rough", "rank")]
    assert shown == [stored.LABEL, "0.50", "0.25", "1.00", "–"]
    seen = Suite("following", results)
    labels, look = {n: n for n in seen.ranked}, looks(seen.ranked)
    plot = scores.figure(all_of(seen)["rms_true"], look, labels).views[""]
    assert any(shape["x0"] == 0.5 for shape in plot.to_dict()["layout"]["shapes"])
    assert any(stored.LABEL in note["text"] for note in plot.to_dict()["layout"]["annotations"])
    view = next(iter(heat.figure(seen, labels).views.values())).to_dict()["data"][0]
    assert view["y"][-1] == stored.LABEL
    assert view["text"][-1] == ("0.250", "1.00", "") or list(view["text"][-1])[-1] == ""
    results.meta["linear"] = {"wavy": 1.0, "rough": 4.0}
    row = dict(zip(sheet_.titles, terminal.sheets(results)[0].sections[-1][1], strict=True))
    assert (row["controller"], row["score, µm"], row["rough"]) == (stored.LINEAR, "2.00", "4.00")
    plot = scores.figure(all_of(seen)["rms_true"], look, labels).views[""].to_dict()["layout"]
    assert {0.5, 2.0} <= {shape["x0"] for shape in plot["shapes"]}
    assert any(stored.LINEAR in note["text"] for note in plot["annotations"])
    view = next(iter(heat.figure(seen, labels).views.values())).to_dict()
    assert list(view["data"][0]["y"][-2:]) == [stored.LABEL, stored.LINEAR]
    results.meta["bounds"]["wavy"] = 0.0
    assert np.isnan(results.bound)  # of scenarios of which all can be learned there is no score
