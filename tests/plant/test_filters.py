"""Filters: every kind, as it runs in the machine, against numpy and scipy on the same samples."""

import numpy as np
import pytest
from scipy import signal

from kerfgym.envs.engine.compiler import for_python
from kerfgym.envs.engine.quantity import InvalidInput, checked
from kerfgym.envs.plant import filters, heads, idle, machine, sensor
from kerfgym.envs.plant.controller import make_law
from kerfgym.envs.plant.filters import Params
from kerfgym.envs.plant.fleet import Fleet

IDLE = make_law(idle, "idle")
STEPS = 300
ROUNDING = 1e-5
"""Hz, of sums over 64 frequencies of 4 MHz."""

# Capacitance noise of 14 µm and impulses in every fourth sample.
WILD = sensor.EQ3._replace(noise=0.01, impulses=0.15, longest=3.0, impulse=0.2)


def _filtered(p, x, start, slope, out):
    s = filters.State(start, 1e6, 0.0, 0.0)
    for n in range(x.size):
        fold = filters.begin()
        for age in range(p.window):
            fold = filters.take(p, fold, x[n - age] if n >= age else start, float(age))
        s, out[n] = filters.finish(p, s, filters.mean(p, fold), x[n], slope)


filtered = for_python(_filtered)

SLOPE = 127e3
"""Hz/mm, of the table at 1 mm (docs/physics.md#the-sensor)."""


def passed(p: Params, x: np.ndarray, start: float) -> np.ndarray:
    """Output of a filter without ranks for the samples ``x`` after a long rest at ``start``."""
    out = np.empty(len(x))
    filtered(filters.validated(p), np.asarray(x, float), float(start), SLOPE, out)
    return out


def kind(name: str, **settings: float) -> Params:
    return Params(kind=float(filters.KINDS.index(name)))._replace(**{k: float(v) for k, v in settings.items()})


def run(params: list[Params], steps: int = STEPS) -> tuple[np.ndarray, np.ndarray]:
    """Samples, led by the 64 with which the ring is filled, and filtered frequencies of machines with these filters.

    All machines have the same head and random stream, so their samples are the same.
    """
    every = np.arange(len(params))
    fleet = Fleet(len(params), IDLE, heads.ensure([0]))
    for i, p in enumerate(params):
        fleet.put_filter(i, p)
    fleet.put("sensor", every, WILD)
    fleet.set("path.feed", every, 0.0)
    fleet.begin(every, np.full(len(params), 2024))
    rings = [fleet.slots(machine.SAMPLES, filters.LONGEST, i) for i in every]
    outputs = [fleet.slots(machine.FOLD, 1, i) for i in every]
    x, y = [rings[0].copy()], []
    for _ in range(steps):
        fleet.advance()
        newest = np.array([ring[(fleet.tick - 1) % filters.LONGEST] for ring in rings])
        assert np.all(newest == newest[0])
        x.append(newest[:1])
        y.append([output[0] for output in outputs])
    return np.concatenate(x), np.asarray(y)


def windows(x: np.ndarray, n: int) -> np.ndarray:
    """The last ``n`` samples at every step, shape (steps, n), oldest first."""
    return np.lib.stride_tricks.sliding_window_view(x, n)[-STEPS:]


WINDOWED = {
    **{f"mean {n}": kind("mean", window=n) for n in (1, 2, 5, 64)},
    "mean 9 with the trim of another kind": kind("mean", window=9, trim=3),
    **{
        f"improved {n} trim {t}": kind("improved", window=n, trim=t)
        for n, t in ((1, 0), (2, 0), (3, 1), (5, 0), (5, 1), (5, 2), (9, 3), (64, 1), (64, 31))
    },
    **{f"median {n}": kind("median", window=n) for n in (1, 2, 3, 4, 5, 6, 63, 64)},
    **{
        f"weighted {n} by {r}": kind("weighted", window=n, ratio=r)
        for n, r in ((1, 0.8), (2, 0.1), (5, 0.8), (64, 1.0))
    },
    "none": kind("none"),
}
RECURSIVE = {
    **{f"lag {tau}": kind("lag", tau=tau) for tau in (0.0, 2.0, 50.0)},
    **{f"kalman {trust}": kind("kalman", trust=trust) for trust in (1e-3, 0.3, 100.0)},
}
ALL = {**WINDOWED, **RECURSIVE}


@pytest.fixture(scope="module")
def together() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Samples and the output of every filter, all running side by side in one block."""
    x, y = run(list(ALL.values()))
    return x, dict(zip(ALL, y.T, strict=True))


def test_the_samples_of_this_file_are_wild(together):
    x = together[0]
    assert np.ptp(x[:64]) == 0.0
    assert np.std(x) > 1e-3 * x.mean()


@pytest.mark.parametrize("name", [n for n in ALL if n.startswith("mean")])
def test_the_moving_average_is_the_mean_of_the_last_samples(together, name):
    x, y = together
    n = int(ALL[name].window)
    assert y[name] == pytest.approx(signal.lfilter(np.ones(n) / n, 1.0, x)[-STEPS:], abs=ROUNDING)


@pytest.mark.parametrize("name", [n for n in ALL if n.startswith("improved")])
def test_the_improved_average_leaves_the_extremes_of_the_window_out(together, name):
    x, y = together
    n, trim = int(ALL[name].window), int(ALL[name].trim)
    kept = np.sort(windows(x, n), axis=1)[:, trim : n - trim]
    assert y[name] == pytest.approx(kept.mean(axis=1), abs=ROUNDING)


@pytest.mark.parametrize("name", [n for n in ALL if n.startswith("median")])
def test_the_median_is_the_middle_sample_or_the_mean_of_the_middle_two(together, name):
    x, y = together
    assert y[name] == pytest.approx(np.median(windows(x, int(ALL[name].window)), axis=1), abs=ROUNDING)


@pytest.mark.parametrize("name", [n for n in ALL if n.startswith("weighted")])
def test_the_weighted_average_has_weights_that_fall_with_age(together, name):
    x, y = together
    weights = ALL[name].ratio ** np.arange(ALL[name].window)
    assert y[name] == pytest.approx(signal.lfilter(weights / weights.sum(), 1.0, x)[-STEPS:], abs=ROUNDING)


def test_no_filter_gives_the_newest_sample(together):
    x, y = together
    assert np.array_equal(y["none"], x[-STEPS:])


@pytest.mark.parametrize("name", [n for n in ALL if n.startswith("lag")])
def test_the_lag_is_a_first_order_filter_with_its_time_constant(together, name):
    x, y = together
    share = 1.0 / (ALL[name].tau + 1.0)
    b, a = [share], [1.0, share - 1.0]
    expected, _ = signal.lfilter(b, a, x, zi=signal.lfilter_zi(b, a) * x[0])
    assert y[name] == pytest.approx(expected[-STEPS:], abs=ROUNDING)


@pytest.mark.parametrize("name", [n for n in ALL if n.startswith("kalman")])
def test_the_kalman_filter_is_that_of_a_random_walk(together, name):
    x, y = together
    estimate, variance, expected = x[0], 1e6, []
    for z in x[63:]:  # the last sample of the ring is the reading at rest, its first measurement
        predicted = variance + ALL[name].trust
        gain = predicted / (predicted + 1.0)
        estimate = estimate + gain * (z - estimate)
        variance = (1.0 - gain) * predicted
        expected.append(estimate)
    assert y[name] == pytest.approx(np.array(expected[1:]), abs=ROUNDING)
    # In the long run the gain solves the Riccati equation.
    q = ALL[name].trust
    assert gain == pytest.approx((-q + np.sqrt(q * q + 4.0 * q)) / 2.0, rel=1e-3)
    late = y[name][-1] - y[name][-2]
    assert late == pytest.approx(gain * (x[-1] - y[name][-2]), abs=1e-3 * abs(x[-1] - y[name][-2]) + ROUNDING)


@pytest.mark.parametrize("name", ["mean 5", "improved 5 trim 1", "median 5", "weighted 5 by 0.8", "lag 2.0"])
def test_a_filter_alone_gives_the_same_bits_as_among_others(together, name):
    _, y = run([ALL[name]], 60)
    assert np.array_equal(y[:, 0], together[1][name][:60])


def test_a_fleet_filters_by_default_as_the_default_settings_say():
    every = np.arange(2)
    fleet = Fleet(2, IDLE, heads.ensure([0]))
    fleet.put_filter(1, Params())
    plain = Fleet(2, IDLE, heads.ensure([0]))
    for f in (fleet, plain):
        f.begin(every, [5, 5])
        f.advance(10)
    assert plain.column("signals.height")[0] == fleet.column("signals.height")[1]


# ----------------------------------------------------------------------------------- what the filters are there for


@pytest.mark.parametrize("n", [1, 2, 5, 64])
def test_the_moving_average_lags_a_ramp_by_half_its_window(n):
    ramp = 3.7e6 + 100.0 * np.arange(200.0)
    y = passed(kind("mean", window=n), ramp, 3.7e6)
    assert y[70:] == pytest.approx(ramp[70:] - 100.0 * (n - 1) / 2.0, abs=ROUNDING)


def test_the_lag_settles_exponentially():
    y = passed(kind("lag", tau=9.0), np.full(50, 3.8e6), 3.7e6)
    assert y == pytest.approx(3.8e6 - 1e5 * 0.9 ** np.arange(1, 51), abs=ROUNDING)


def test_trimming_removes_a_single_impulse_but_not_two_in_one_window():
    x = np.full(40, 3.7e6)
    x[10], x[20], x[22] = 3.71e6, 3.71e6, 3.71e6
    y = passed(kind("improved", window=5, trim=1), x, 3.7e6)
    assert y[:22] == pytest.approx(3.7e6, abs=ROUNDING)
    assert y[22:25] == pytest.approx(3.7e6 + 1e4 / 3.0, abs=ROUNDING)  # one of the two is left
    assert y[25:] == pytest.approx(3.7e6, abs=ROUNDING)


BASE = 3.7e6


@pytest.mark.parametrize("hold", [0, 1, 2, 5])
@pytest.mark.parametrize("jump", [0.05, -0.05, 0.3, -0.3])
def test_the_anti_impulse_filter_drops_short_jumps(hold, jump):
    p = kind("anti-impulse", jump=0.04, hold=hold)
    for length in range(1, hold + 1):
        x = np.full(40, BASE)
        x[10 : 10 + length] += jump * SLOPE
        assert np.all(passed(p, x, BASE) == BASE)


@pytest.mark.parametrize("hold", [0, 1, 2, 5])
@pytest.mark.parametrize("jump", [0.05, -0.05, 0.3, -0.3])
def test_the_anti_impulse_filter_delays_a_lasting_jump_and_then_stays_on_it(hold, jump):
    p = kind("anti-impulse", jump=0.04, hold=hold)
    step = np.where(np.arange(40) < 10, BASE, BASE + jump * SLOPE)
    y = passed(p, step, BASE)
    assert np.all(y[: 10 + hold] == BASE)
    assert y[10 + hold :] == pytest.approx(step[10 + hold :], abs=1e-6)


@pytest.mark.parametrize(("jump", "dropped"), [(0.0399, False), (0.0401, True), (-0.0399, False), (-0.0401, True)])
def test_the_anti_impulse_filter_drops_what_is_higher_than_its_jump_in_millimetres(jump, dropped):
    x = np.full(20, BASE)
    x[10] += jump * SLOPE
    y = passed(kind("anti-impulse", jump=0.04, hold=2), x, BASE)
    assert (y[10] == BASE) == dropped


def test_the_anti_impulse_filter_bridges_an_impulse_on_a_ramp_along_the_ramp():
    ramp = BASE + 0.02 * SLOPE * np.arange(120.0)  # 20 µm a sample
    x = ramp.copy()
    x[[100, 101]] += 0.3 * SLOPE
    y = passed(kind("anti-impulse", jump=0.04, hold=2), x, BASE)
    assert y[:100] == pytest.approx(ramp[:100], abs=ROUNDING)
    assert y[100:] == pytest.approx(ramp[100:], abs=1e-3)


@pytest.mark.parametrize("hold", [2, 10, 50])
@pytest.mark.parametrize("slope", [1.0, 0.1, 1e-3])
def test_the_anti_impulse_filter_never_extrapolates_by_more_than_a_jump_or_the_fastest_drive_s_sample(hold, slope):
    """Whatever it has been fed: noise as wide as the whole range of heights, on a table of any steepness."""
    rng, jump = np.random.default_rng(12), 0.1
    x = BASE + SLOPE * rng.uniform(-3.0, 3.0, 4000) * (rng.random(4000) < 0.5)
    x[0] = BASE
    out = np.empty(len(x))
    filtered(filters.validated(kind("anti-impulse", jump=jump, hold=hold)), x, BASE, slope * SLOPE, out)
    believed = out == x
    last = np.maximum.accumulate(np.where(believed, np.arange(len(x)), 0))
    assert np.abs(out - x[last]).max() <= max(jump, filters.FASTEST) * slope * SLOPE * (1 + 1e-9)


def test_the_anti_impulse_filter_passes_anything_that_does_not_jump():
    x = BASE + 0.009 * SLOPE * np.random.default_rng(11).uniform(-1.0, 1.0, 500)
    assert np.array_equal(passed(kind("anti-impulse", jump=0.04, hold=3), x, BASE), x)


@pytest.mark.parametrize("gap", [0.5, 1.0, 2.0])
@pytest.mark.parametrize(("apparent", "dropped"), [(0.1, True), (0.01, False)])
def test_on_the_machine_the_jump_means_the_same_at_any_height(gap, apparent, dropped):
    fleet = Fleet(1, IDLE, heads.ensure([0]))
    fleet.put_filter(0, kind("anti-impulse", jump=0.04, hold=2))
    head = sensor.EQ3._replace(noise=0.0, jitter=0.0, impulses=0.05, spread=0.0)
    fleet.put("sensor", 0, head._replace(impulse=apparent * (1.0 + gap / head.falloff)))
    fleet.set("path.feed", 0, 0.0)
    fleet.set("start.gap", 0, gap)
    fleet.begin(0, 11)
    heights = []
    for _ in range(400):
        fleet.advance()
        heights.append([fleet.column("signals.height")[0], fleet.column("signals.raw_height")[0]])
    filtered_, raw = np.abs(np.array(heights).T - gap).max(axis=1)
    assert raw == pytest.approx(apparent, abs=3e-3)
    assert filtered_ == pytest.approx(0.0 if dropped else raw, abs=3e-3)


def followed(p: Params, x: np.ndarray) -> tuple[list[filters.State], list[float]]:
    """States and outputs of a recursive filter in plain Python, from rest at ``BASE``."""
    p, s, states, out = filters.validated(p), filters.State(BASE, 1e6, 0.0, 0.0), [], []
    for sample in x:
        s, y = filters.finish(p, s, 0.0, sample, SLOPE)
        states.append(s)
        out.append(y)
    return states, out


def test_the_anti_impulse_filter_learns_a_trend_by_a_first_order_lag():
    rate = 0.02 * SLOPE  # half a jump a sample, which is believed from the start
    states, _ = followed(kind("anti-impulse", jump=0.04), BASE + rate * np.arange(1.0, 13.0))
    assert [s.trend for s in states] == pytest.approx(rate * (1.0 - 0.7 ** np.arange(1.0, 13.0)))


@pytest.mark.parametrize("trend", [0.03, -0.03])
@pytest.mark.parametrize(("beyond", "dropped"), [(0.0549, False), (0.0551, True), (-0.0549, False), (-0.0551, True)])
def test_off_the_trend_a_jump_may_be_higher_by_half_of_it(trend, beyond, dropped):
    ramp = BASE + trend * SLOPE * np.arange(1.0, 121.0)
    x = np.append(ramp[:100], ramp[100] + beyond * SLOPE)  # 40 µm, and half of 30 µm
    _, out = followed(kind("anti-impulse", jump=0.04), x)
    assert out[-1] == pytest.approx(ramp[100] if dropped else x[-1])


def test_a_trend_goes_on_only_as_far_as_a_jump():
    # 15 µm a sample: two of them are less than a jump of 40 µm, three are more.
    ramp = BASE + 0.015 * SLOPE * np.arange(1.0, 101.0)
    _, out = followed(kind("anti-impulse", jump=0.04, hold=5), np.append(ramp, [ramp[-1] + 0.5 * SLOPE] * 5))
    assert np.diff(out[99:]) / SLOPE == pytest.approx([0.015, 0.015, 0.0, 0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("late", [1, 2, 5, 19, 20, 21, 30])
def test_after_a_jump_that_outlasted_it_the_anti_impulse_filter_stays_open_for_20_samples(late):
    x = np.full(80, BASE)
    x[10:] += 0.3 * SLOPE  # bridged twice, believed from sample 12 on
    x[12 + late] += 0.3 * SLOPE
    _, out = followed(kind("anti-impulse", jump=0.04, hold=2), x)
    passes = abs(out[12 + late] - x[12 + late]) < 1.0
    assert passes == (late <= 20)


# --------------------------------------------------------------------------------------------------- bad settings


@pytest.mark.parametrize(("window", "trim", "most"), [(5, 3, 2), (2, 1, 0), (1, 1, 0), (64, 32, 31), (6, 3, 2)])
def test_a_trim_that_eats_the_window_is_refused_with_the_largest_allowed(window, trim, most):
    message = f"filter.trim = {trim} eats the whole window of {window} samples; allowed: 0 to {most} at this window"
    p = kind("improved", window=window, trim=trim)
    with pytest.raises(InvalidInput) as refused:
        filters.validated(p)
    assert str(refused.value) == message
    with pytest.raises(InvalidInput):
        Fleet(1, IDLE, heads.ensure([0])).put_filter(0, p)
    filters.validated(p._replace(trim=float(most)))


@pytest.mark.parametrize(
    ("field", "value"), [("window", 65), ("window", 0), ("window", 2.5), ("trim", -1), ("hold", 51), ("tau", -1)]
)
def test_settings_out_of_range_are_refused_with_the_range(field, value):
    with pytest.raises(InvalidInput, match=rf"filter\.{field} = {value} is out of range; allowed: "):
        checked(Params, {field: value}, "filter.")


def test_a_kind_is_chosen_by_name_and_a_misspelt_one_offers_the_nearest():
    assert checked(Params, {"kind": "median"}, "filter.").kind == filters.MEDIAN
    with pytest.raises(InvalidInput, match="did you mean 'median'"):
        checked(Params, {"kind": "meidan"}, "filter.")
