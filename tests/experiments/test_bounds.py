"""Causal bounds, against closed forms, brute force and the controllers that must not be below them."""

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.linalg import toeplitz
from scipy.optimize import lsq_linear

from kerfgym.envs import metrics, scenarios
from kerfgym.envs import stack as stacks
from kerfgym.envs.plant import machine, sheet, z_axis
from kerfgym.envs.plant.controller import PERIOD
from kerfgym.envs.plant.quantity import InvalidInput
from kerfgym.experiments import bounds, rollout, table
from kerfgym.experiments.bounds import noise, prediction, reach, record, shapes, spectrum, suite

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


def test_the_error_of_the_next_reading_is_kolmogorovs():
    random = spectrum.band(5.0, 40.0, 0.05) + ornstein()
    white = prediction.whitener(random, SIGMA)
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
    random, n = ornstein(0.8, 5.0, 112), 400
    drawn = shapes.sine(2 * np.pi * 9.0 * PERIOD * np.arange(n), 50.0, sensor=0.7) + shapes.ramp(np.arange(n), 0.01)
    at, seen = n - 1, n - horizon
    lags = 25.0 * 0.8 ** np.arange(n)
    prior = np.diag(drawn.variance)
    read = toeplitz(lags)[:seen, :seen] + SIGMA**2 * np.eye(seen) + drawn.sensor[:seen] @ prior @ drawn.sensor[:seen].T
    cross = lags[at - np.arange(seen)] + drawn.score[at] @ prior @ drawn.sensor[:seen].T
    whole = 25.0 + drawn.score[at] @ prior @ drawn.score[at] - cross @ np.linalg.solve(read, cross)
    assert error(random, drawn, SIGMA, horizon, at) == pytest.approx(whole, rel=2e-3)


# -------------------------------------------------------------------------------------------------------------- spectra


def test_a_density_becomes_its_covariance():
    rate = 40.0  # 1/s; r(τ) = s²·exp(−rate·τ) has the one-sided density 4·s²·rate/(rate² + (2πf)²)
    f = spectrum.frequencies()
    found = spectrum.seen(4 * SIZE**2 * rate / (rate**2 + (2 * np.pi * f) ** 2))
    wanted = SIZE**2 * np.exp(-rate * PERIOD * np.arange(200))
    np.testing.assert_allclose(found.yy[:200], wanted, atol=5e-3 * SIZE**2)  # beyond 4 kHz nothing is summed
    assert found.xx == pytest.approx(SIZE**2, rel=5e-3)


def test_a_band_is_noise_behind_a_resonance():
    f0, zeta, f = 55.0, 0.04, spectrum.frequencies()
    shape = 1.0 / ((f0**2 - f**2) ** 2 + (2 * zeta * f0 * f) ** 2)
    density = 4.0 * shape / (np.pi / (4 * zeta * f0**3))
    np.testing.assert_allclose(spectrum.band(2.0, f0, zeta).yy, spectrum.seen(density).yy, atol=2e-4)


@pytest.mark.parametrize("exponent", [2.0, 3.0])
def test_a_power_law_has_its_rms_and_its_slope_and_keeps_the_rms_at_any_feed(exponent):
    def density(k):
        return spectrum.power_law(k, 50.0, exponent, 0.05)

    assert quad(density, 0, np.inf)[0] == pytest.approx(2500.0)
    assert density(80.0) / density(40.0) == pytest.approx(2.0**-exponent, rel=1e-5)
    for feed in (50.0, 200.0):
        assert spectrum.seen(spectrum.along(density, feed)).xx == pytest.approx(2500.0, rel=5e-3)
    slow, quick = (spectrum.seen(spectrum.along(density, feed)).yy for feed in (100.0, 200.0))
    np.testing.assert_allclose(slow[::2][:100], quick[:100], rtol=3e-3)


def test_footprints_part_what_sensor_and_score_see():
    k = np.array([2 * np.pi / 30.0, 2 * np.pi / 12.0])
    wide, narrow = spectrum.footprint(k, 5.6), spectrum.footprint(k, 2.0)
    kappa = 5.6 * k
    np.testing.assert_allclose(wide, 3 * (np.sin(kappa) - kappa * np.cos(kappa)) / kappa**3)
    both = spectrum.tones(np.array([4.0, 1.0]), 200.0 * k, wide, narrow)
    assert both.yy[0] == pytest.approx((np.array([4.0, 1.0]) * wide**2).sum())
    assert both.xy[0] == pytest.approx((np.array([4.0, 1.0]) * wide * narrow).sum())
    assert both.xx == pytest.approx((np.array([4.0, 1.0]) * narrow**2).sum())


def test_a_wider_plate_and_a_gate_know_less():
    def density(k):
        return spectrum.power_law(k, 50.0, 2.0, 0.02)

    f = spectrum.frequencies()
    k = 2 * np.pi * f / 200.0
    whole = spectrum.along(density, 200.0)
    score = spectrum.footprint(k, 2.0)
    lagging = score * spectrum.gate(f, 0.25e-3, PERIOD / 20)
    same, gated = (prediction.wiener(spectrum.seen(whole, s, score), 1e-2, 2)[0] for s in (score, lagging))
    assert same < gated
    assert spectrum.gate(np.array([0.0]), 0.25e-3, PERIOD / 20) == 1.0
    delay = -np.angle(spectrum.gate(np.array([50.0]), 0.25e-3, PERIOD / 20))[0] / (2 * np.pi * 50.0)
    assert delay == pytest.approx(0.1e-3)  # the mean age of five substeps of 50 µs that end now


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


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_no_command_moves_the_machines_head_further(sign):
    p = z_axis.Params(friction=0.0, backlash=0.0)
    axis, gains, s = reach.Reach.of(p), z_axis.gains(p, machine.DT), z_axis.at_rest(0.0)
    moved = []
    for _ in range(6):
        for k in range(machine.SUBSTEPS):
            pace = z_axis.Pace(sign * 500.0, sign * 500.0, 0.0)
            s, head = z_axis.step(p, gains, pace, s, (k + 1) / machine.SUBSTEPS, machine.DT)
        moved.append(1e3 * sign * head)
    most = axis.within(6)
    assert (np.array(moved) <= most).all()
    assert moved[2] > 0.8 * most[2]  # and the bound is not idle


@pytest.mark.parametrize("dead", [0.0, 0.001, 0.0015, 0.002])
def test_the_machine_lets_a_command_act_no_sooner_than_the_horizon(dead):
    flat = scenarios.load("flat").varied(axis={"dead_time": dead, "friction": 0.0}, duration=0.1, settle=0.0)
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


def cost(axis, height=250.0, sigma=1e-6, score=2.0, starts=(50.05,), scored=range(10_000)):
    found = axis.cost_of_steps(np.full(len(starts), height), np.array(starts), 200.0, sigma, score, score, scored)
    return found.mean()


@pytest.mark.parametrize(("dead", "periods"), [(0.0, 1), (1.0, 2), (2.0, 3)])
def test_a_sudden_step_under_a_free_drive_costs_the_dead_time(dead, periods):
    free = reach.Reach(1e16, 600.0, 0.05, 0.0, 0.0, dead)
    assert cost(free, score=1e-3) == pytest.approx(periods * 250.0**2, rel=1e-6)


def test_a_step_costs_more_with_less_jerk_more_dead_time_and_more_noise_and_nothing_unscored():
    base = cost(AXIS)
    assert cost(reach.Reach(1e9, *list(vars(AXIS).values())[1:6])) > 1.5 * base
    assert cost(reach.Reach(2e9, 628.3, 0.05, 0.1, 5.0, 2.0)) > 1.5 * base
    assert cost(AXIS, sigma=5.0) > 1.2 * base
    assert cost(AXIS, scored=range(200)) == 0.0


def test_a_plate_that_reaches_ahead_of_the_score_makes_a_step_foreseen():
    wide = AXIS.cost_of_steps(np.array([250.0]), np.array([50.05]), 200.0, 2.0, 5.6, 2.0, range(10_000))
    assert wide[0] < 0.01 * cost(AXIS, sigma=2.0)


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
    for height, micrometres in ((0.5, 3.5), (1.0, 13.0), (2.0, 47.0)):  # µm for 0.01 pF, PHYSICS §1
        fleet = suite.prepared(flat.varied(set_height=height), [0])
        assert noise.gaussian(fleet)[0] == pytest.approx(micrometres, rel=0.05)


# ---------------------------------------------------------------------------------------------------------------- suite


def test_sheets_are_read_as_the_machine_has_them():
    fleet = suite.prepared(scenarios.load("chatter"), range(40))
    v = fleet.listed(sheet.Vibration, 2)
    assert v.omega.shape == (40,)
    assert ((v.omega > 2 * np.pi * 30) & (v.omega < 2 * np.pi * 100)).all()
    assert ((v.amplitude > 0.002) & (v.amplitude < 0.008)).all()


@pytest.mark.parametrize("name", CORE)
@pytest.mark.parametrize("controller", ["self-tuning", "pid"])
def test_no_follower_is_below_its_bound(name, controller):
    seeds, scenario = range(1000, 1008), scenarios.load(name)
    found = metrics.METRICS["rms_true"].function(rollout.roll(scenario, stacks.resolve(controller), seeds))
    bound = suite.of(scenario, seeds)
    assert bound.bound <= bound.learned < np.sqrt(np.mean(found**2))


def test_the_bound_follows_dead_time_and_noise():
    seeds, rough = range(1000, 1006), scenarios.load("rough")
    before = suite.of(rough, seeds)
    noisy = suite.of(rough.varied(head={"noise": {"log_uniform": [5e-3, 5e-2]}}), seeds)
    late = suite.of(rough.varied(axis={"dead_time": 0.004}), seeds)
    assert noisy.bound > 2 * before.bound
    assert late.linear > 1.3 * before.linear


def test_what_no_bound_is_known_for_is_refused():
    with pytest.raises(InvalidInput, match="no bound is known for scenario 'holes': it has holes"):
        suite.of(scenarios.load("holes"), range(2))


# --------------------------------------------------------------------------------------------------------------- record


def test_the_record_is_as_old_as_what_it_is_made_from():
    assert bounds.stale() == [], "python -m kerfgym.experiments.bounds makes it anew"


def test_every_core_scenario_has_a_bound_and_a_changed_one_has_none():
    assert set(CORE) <= set(record.wanted())
    for name in CORE:
        found = bounds.recorded(scenarios.load(name))
        assert 0 < found.bound <= found.learned
    assert bounds.recorded(scenarios.load("wavy").varied(feed=201.0)) is None


def test_bounds_are_shown_last_in_the_table_and_drawn_in_the_report(made_up):
    from kerfgym.experiments.report import heat, scores
    from kerfgym.experiments.report.palette import looks
    from kerfgym.experiments.report.standing import all_of
    from kerfgym.experiments.report.suite import Suite

    results = made_up.following()
    assert record.LABEL not in table.sheets(results)[0].markdown()
    results.meta["bounds"] = {"wavy": 0.25, "rough": 1.0}
    assert results.bound == pytest.approx(0.5)
    sheet_ = table.sheets(results)[0]
    row = dict(zip(sheet_.titles, sheet_.sections[-1][0], strict=True))
    assert (row["controller"], row["score"], row["wavy"], row["rough"], row["rank"]) == (
        record.LABEL, "0.50", "0.25", "1.00", "–",
    )  # fmt: skip
    seen = Suite("following", results)
    labels, look = {n: n for n in seen.ranked}, looks(seen.ranked)
    plot = scores.figure(all_of(seen)["rms_true"], look, labels).views[""]
    assert any(shape["x0"] == 0.5 for shape in plot.to_dict()["layout"]["shapes"])
    assert any(record.LABEL in note["text"] for note in plot.to_dict()["layout"]["annotations"])
    view = next(iter(heat.figure(seen, labels).views.values())).to_dict()["data"][0]
    assert view["y"][-1] == record.LABEL
    assert view["text"][-1] == ("0.250", "1.00", "") or list(view["text"][-1])[-1] == ""
