"""Sensor: capacitance, oscillator, counter and disturbances, against closed forms and docs/physics.md#the-sensor."""

import numpy as np
import pytest
from scipy import stats

from kerfgym.envs.engine.compiler import for_python
from kerfgym.envs.engine.lanes import mix
from kerfgym.envs.plant import sensor
from kerfgym.envs.plant.sensor import CLOCK, EQ1, EQ3, Gate, Params, State

QUIET = EQ3._replace(noise=0.0, jitter=0.0)
TOTAL_1MS = Gate(1.0, 0.0)


def _frequencies(p, gaps, cover, detuning, out):
    for i in range(gaps.size):
        out[i] = sensor.oscillator(p, sensor.capacitance(p, gaps[i], cover), detuning)


def _counts(gate, frequencies, phases, out):
    for i in range(frequencies.size):
        out[i] = sensor.counted(gate, frequencies[i], phases[i])


def _samples(p, gate, gap, cover, key, out):
    s = State(0.0, 0.0, 0.0, 0.0)
    for i in range(out.size):
        s, out[i] = sensor.step(p, s, gate, gap, cover, 1.0, key, np.uint64(i))


frequencies, counts, samples = (for_python(f) for f in (_frequencies, _counts, _samples))


def c5(h, p: Params = EQ3):
    """Disc over plane with fringe, pF."""
    e0 = 8.8541878128e-3
    plate = e0 * np.pi * (p.radius**2 - p.bore**2) / h
    return p.body + plate + 2.0 * e0 * p.radius * np.maximum(np.log(8.0 * np.pi * p.radius / h) - 1.0, 0.0)


def lc(c, inductance: float = 168.0):
    """Xi2023 eq. 3, Hz."""
    return 1.0 / (2.0 * np.pi * np.sqrt(inductance * 1e-6 * c * 1e-12))


def slope(h: float) -> float:
    """Hz per µm."""
    return (lc(c5(h * (1 + 1e-5))) - lc(c5(h * (1 - 1e-5)))) / (2e-5 * h) * 1e-3


def height_of(f: np.ndarray) -> np.ndarray:
    """Apparent height of the default head, mm."""
    grid = np.geomspace(1e-3, 20.0, 400_001)
    return np.interp(f, lc(c5(grid)), grid)


def offset_of(f: np.ndarray, gap: float) -> np.ndarray:
    """Capacitance beyond that of the default head at ``gap``, pF."""
    return 1e12 / ((2.0 * np.pi * f) ** 2 * 168e-6) - c5(gap)


def counted(gate: Gate, f, phase) -> np.ndarray:
    f, phase = np.broadcast_arrays(np.asarray(f, float), np.asarray(phase, float))
    out = np.empty(f.size)
    counts(gate, f.ravel().copy(), phase.ravel().copy(), out)
    return out.reshape(f.shape)


def sampled(p: Params, gap: float, n: int, gate: Gate = TOTAL_1MS, cover: float = 1.0, seed: int = 1) -> np.ndarray:
    out = np.empty(n)
    samples(p, gate, gap, cover, np.uint64(mix(seed)), out)
    return out


def printed(value: float, digits: str, rel: float):
    """``value`` agrees with the printed ``digits`` to half a unit of the last one, or to ``rel``."""
    number = float(digits)
    places = len(digits.split(".")[1]) if "." in digits else len(digits.rstrip("0")) - len(digits)
    unit = 10.0**-places
    return abs(value - number) <= max(0.5 * unit, rel * abs(number)) + 1e-12


# ------------------------------------------------------------------------------------- capacitance and oscillator


@pytest.mark.parametrize(
    ("preset", "farads", "hertz"),
    [(EQ1, 74.7, 1.665e6), (EQ1, 10.6, 4.053e6), (EQ3, 10.0, 3.88e6), (EQ3, 50.0, 1.74e6)],
)
def test_fed_with_c5_each_preset_gives_its_band(preset, farads, hertz):
    assert sensor.oscillator(preset, farads, 0.0) == pytest.approx(hertz, rel=0.01)


def test_the_oscillator_is_eq_1_with_its_series_capacitors_and_eq_3_without():
    c = np.geomspace(5.0, 100.0, 30)
    for x in c:
        assert sensor.oscillator(EQ3, x, 0.0) == pytest.approx(lc(x), rel=1e-12)
        series = 1.0 / (1.0 / 1000.0 + 1.0 / 1000.0 + 1.0 / 1000.0 + 1.0 / x)
        assert sensor.oscillator(EQ1, x, 0.0) == pytest.approx(lc(series, 150.0), rel=1e-12)


def test_capacitance_is_that_of_a_disc_over_a_plane_beside_the_body():
    h = np.concatenate([np.geomspace(0.01, 20.0, 200), [60.0]])  # beyond 46 mm there is no fringe left
    out = np.empty_like(h)
    frequencies(EQ3, h, 1.0, 0.0, out)
    assert np.abs(out / lc(c5(h)) - 1.0).max() < 1e-9
    assert sensor.capacitance(EQ3, 1.0, 0.0) == pytest.approx(EQ3.body)
    half = 0.5 * (sensor.capacitance(EQ3, 1.0, 1.0) + EQ3.body)
    assert sensor.capacitance(EQ3, 1.0, 0.5) == pytest.approx(half)


def test_an_edge_is_felt_on_a_disc_that_grows_with_the_gap_up_to_its_limit():
    assert sensor.sensing_radius(EQ3, 0.0) == pytest.approx(5.0)
    assert sensor.sensing_radius(EQ3, 2.0) == pytest.approx(8.0)
    assert sensor.sensing_radius(EQ3, 9.0) == pytest.approx(sensor.WIDEST)


# h mm, C5 pF, f MHz, Hz/µm, σ of 100 periods, σ of a 1 ms gate, 0.16 % of L·C, +0.01 pF, all four in µm
TABLE = [
    ("0.1", "17.22", "2.959", "5812", "0.021", "0.0007", "0.41", "0.15"),
    ("0.5", "11.74", "3.584", "434.8", "0.40", "0.011", "6.6", "3.5"),
    ("1", "11.01", "3.701", "127.1", "1.5", "0.04", "23", "13"),
    ("2", "10.61", "3.769", "37.5", "5.2", "0.14", "80", "47"),
    ("5", "10.33", "3.820", "8.2", "24", "0.63", "370", "230"),
    ("10", "10.20", "3.844", "2.9", "69", "1.8", "1100", "640"),
]


@pytest.mark.parametrize("row", TABLE, ids=[f"{r[0]} mm" for r in TABLE])
def test_the_head_has_the_capacitance_frequency_and_sensitivity_of_the_table(row):
    h = float(row[0])
    gaps = np.array([h * (1 - 1e-5), h, h * (1 + 1e-5)])
    f = np.empty(3)
    frequencies(EQ3, gaps, 1.0, 0.0, f)
    per_um = (f[2] - f[0]) / (gaps[2] - gaps[0]) * 1e-3
    assert printed(sensor.capacitance(EQ3, h, 1.0), row[1], 0.0)
    assert printed(f[1] * 1e-6, row[2], 0.0)
    assert printed(per_um, row[3], 0.01)

    warm, more = np.empty(1), np.empty(1)
    frequencies(EQ3, np.array([h]), 1.0, 0.0016e-3, warm)  # a thousandth, because the table is linear
    frequencies(EQ3._replace(body=EQ3.body + 0.01e-3), np.array([h]), 1.0, 0.0, more)
    assert printed(1e3 * (f[1] - warm[0]) / per_um, row[6], 0.01)
    assert printed(1e3 * (f[1] - more[0]) / per_um, row[7], 0.01)


@pytest.mark.parametrize("row", TABLE, ids=[f"{r[0]} mm" for r in TABLE])
def test_counting_scatters_as_the_table_says_averaged_over_a_band_of_heights(row):
    h = float(row[0])
    rng = np.random.default_rng(5)
    width = 0.02 if h < 0.5 else 0.3
    f = lc(c5(h * (1.0 + rng.uniform(-width, width, 600))))
    phases = rng.random((600, 300))
    for column, gates in ((4, 1e3 * 100.5 / f), (5, np.full(600, 1.0))):
        sigma = [counted(Gate(g, 0.0), x, ph).std() / x for g, x, ph in zip(gates, f, phases, strict=True)]
        sigma = np.sqrt(np.mean(np.square(sigma)))
        periods = 100.0 if column == 4 else 1e-3 * f.mean()
        assert sigma == pytest.approx(f.mean() / (np.sqrt(6.0) * CLOCK * periods), rel=0.03)
        assert printed(sigma * lc(c5(h)) / slope(h), row[column], 0.05)


# -------------------------------------------------------------------------------------------------------- counter


@pytest.mark.parametrize("gate", [0.05, 0.25, 1.0])
def test_a_count_is_a_floor_or_a_ceiling_with_variance_p_times_one_minus_p(gate):
    rng = np.random.default_rng(6)
    phases = (np.arange(2000) + 0.5) / 2000.0
    for f in rng.uniform(1.665e6, 4.053e6, 50):
        periods = np.floor(gate * 1e-3 * f)
        exact = periods * CLOCK / f
        ticks = periods * CLOCK / counted(Gate(gate, 0.0), f, phases)
        whole = np.rint(ticks)
        p = exact % 1.0
        assert np.abs(ticks - whole).max() < 1e-6
        assert set(np.unique(whole)) <= {np.floor(exact), np.ceil(exact)}
        assert whole.mean() == pytest.approx(exact, abs=1e-3)
        assert whole.var() == pytest.approx(p * (1.0 - p), abs=1e-3)


def test_a_mean_of_per_period_frequencies_has_the_bias_of_a_mean_of_reciprocals_and_a_total_count_has_none():
    rng = np.random.default_rng(7)
    phases = (np.arange(4000) + 0.5) / 4000.0
    for f in rng.uniform(1.665e6, 4.053e6, 40):
        length = CLOCK / f
        low = np.floor(length)
        p = length - low
        bias = length * ((1.0 - p) / low + p / (low + 1.0)) - 1.0
        mean = counted(Gate(1.0, 1.0), f, phases).mean() / f - 1.0
        total = counted(Gate(1.0, 0.0), f, phases).mean() / f - 1.0
        assert mean == pytest.approx(bias, abs=2e-9)
        assert total == pytest.approx(0.0, abs=2e-9)


@pytest.mark.parametrize(("low", "high", "bias"), [(116.0, 120.0, 1.2e-5), (81.0, 86.0, 2.4e-5)])
def test_over_a_band_the_bias_of_the_mean_is_a_sixth_over_a_squared_count(low, high, bias):
    # docs/physics.md#the-sensor: 1.2e-5 at 2.54 MHz, the middle of the oscillator's band; the head works at 3.6 MHz.
    rng = np.random.default_rng(8)
    length = rng.uniform(low, high, 200_000)  # clock ticks per oscillator period
    f, phases = CLOCK / length, rng.random(length.size)
    mean = (counted(Gate(1.0, 1.0), f, phases) / f - 1.0).mean()
    total = (counted(Gate(1.0, 0.0), f, phases) / f - 1.0).mean()
    assert mean == pytest.approx((1.0 / (6.0 * length**2)).mean(), rel=0.01)
    assert mean == pytest.approx(bias, rel=0.02)
    assert abs(total) < 1.5e-8


# -------------------------------------------------------------------------------------------------------- samples


def test_an_undisturbed_sample_is_the_true_frequency_to_within_one_count():
    for gap in (0.05, 0.5, 1.0, 5.0):
        for length in (0.05, 0.25, 1.0):
            f = sampled(QUIET, gap, 1000, Gate(length, 0.0))
            count = np.floor(length * 1e-3 * lc(c5(gap))) * CLOCK / lc(c5(gap))
            assert np.abs(f / lc(c5(gap)) - 1.0).max() < 1.0 / (count - 1.0)
            assert f.std() > 0.0 or (count % 1.0) < 1e-6


def test_noise_has_its_size_in_picofarads_and_jitter_in_relative_frequency():
    n = 40_000
    counting = 1.0 / (np.sqrt(6.0) * CLOCK * 1e-3)
    noisy = sampled(QUIET._replace(noise=0.005), 1.0, n)
    expected = np.hypot(0.5 * 0.005 / c5(1.0), counting)
    assert noisy.std() / noisy.mean() == pytest.approx(expected, rel=0.02)
    assert noisy.mean() == pytest.approx(lc(c5(1.0)), rel=5.0 * expected / np.sqrt(n) + expected**2)
    jittery = sampled(QUIET._replace(jitter=1e-5), 1.0, n)
    assert jittery.std() / jittery.mean() == pytest.approx(np.hypot(1e-5, counting), rel=0.02)
    assert abs(np.corrcoef(noisy[:-1], noisy[1:])[0, 1]) < 4.5 / np.sqrt(n)


@pytest.mark.parametrize("key", [0, 7])
def test_the_same_stream_gives_the_same_samples_and_another_one_others(key):
    p = EQ3._replace(impulses=0.01, bursts=0.01)
    assert np.array_equal(sampled(p, 1.0, 500, seed=key), sampled(p, 1.0, 500, seed=key))
    assert np.mean(sampled(p, 1.0, 500, seed=key) == sampled(p, 1.0, 500, seed=key + 1)) < 0.1


def runs_of(x: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Values and lengths of stretches of ``x`` that stay constant within ``tolerance``."""
    edges = np.concatenate([[0], 1 + np.flatnonzero(np.abs(np.diff(x)) > tolerance), [x.size]])
    return x[edges[:-1]], np.diff(edges)


def test_impulses_come_at_their_rate_and_last_their_lengths_with_either_sign():
    n, start, longest = 400_000, 0.01, 4
    f = sampled(QUIET._replace(impulses=start, longest=float(longest)), 1.0, n)
    values, lengths = runs_of(height_of(f) - 1.0, 1e-3)
    hit = np.abs(values) > 5e-3
    impulses = int(hit.sum())
    free = n - int(lengths[hit].sum()) + impulses  # samples at which one could start
    assert impulses == pytest.approx(start * free, abs=4.0 * np.sqrt(start * free))
    found = np.bincount(lengths[hit], minlength=longest + 1)
    assert found[longest + 1 :].sum() <= 0.002 * impulses  # two in a row of nearly the same height
    assert stats.chisquare(found[1 : longest + 1]).pvalue > 1e-3
    assert (values[hit] > 0).mean() == pytest.approx(0.5, abs=2.0 / np.sqrt(impulses))


@pytest.mark.parametrize("gap", [0.3, 1.0, 2.0])
def test_impulses_have_the_height_a_of_h_with_a_uniform_spread(gap):
    p = QUIET._replace(impulses=0.05, impulse=0.137, falloff=0.894, spread=0.3)
    h = height_of(sampled(p, gap, 100_000)) - gap
    size = np.abs(h[np.abs(h) > 0.01])
    law = 0.137 / (1.0 + gap / 0.894)
    blur = 1.0 / (CLOCK * 1e-3) * lc(c5(gap)) / slope(gap) * 1e-3  # one count, mm
    assert size.min() > 0.7 * law - blur
    assert size.max() < 1.3 * law + blur
    assert stats.kstest(size / law, "uniform", args=(0.7, 0.6)).pvalue > 1e-3


def test_an_impulse_never_looks_like_contact():
    f = sampled(QUIET._replace(impulses=0.2, impulse=0.2, spread=0.0), 0.05, 5000)
    assert f.min() > 0.0
    assert height_of(f).min() == pytest.approx(sensor.LEAST_GAP, rel=1e-3)


def test_bursts_start_and_end_at_their_rates_and_have_uniform_heights():
    n, start, end, most = 400_000, 0.004, 0.05, 0.1
    c = offset_of(sampled(QUIET._replace(bursts=start, burst_end=end, burst=most), 1.0, n), 1.0)
    values, lengths = runs_of(c, 2e-4)
    active = values > 2e-4
    starts = int(active.sum())
    assert starts == pytest.approx(start * n, abs=4.0 * np.sqrt(start * n))
    assert stats.kstest(values[active], "uniform", args=(0.0, most)).pvalue > 1e-3
    # A burst lasts until it ends or another one takes its place.
    stop = 1.0 - (1.0 - start) * (1.0 - end)
    assert lengths[active].mean() == pytest.approx(1.0 / stop, rel=4.0 / np.sqrt(starts))


def test_plasma_adds_its_constant_capacitance():
    c = offset_of(sampled(QUIET._replace(plasma=0.08), 1.0, 2000), 1.0)
    assert c.mean() == pytest.approx(0.08, abs=1e-5)


def test_warming_up_detunes_the_oscillator_exponentially():
    n, drift, warming = 5000, 0.0016, 1e-3
    f = sampled(QUIET._replace(drift=drift, warming=warming), 1.0, n)
    warm = 1.0 - (1.0 - warming) ** np.arange(1, n + 1)
    expected = lc(c5(1.0)) / np.sqrt(1.0 + drift * warm)
    assert np.abs(f / expected - 1.0).max() < 1.01 / (CLOCK * 1e-3 * (1 - 1e-3))
    assert f[-1] < f[0]


@pytest.mark.parametrize("gap", [0.0, -0.2])
def test_contact_stops_the_oscillation(gap):
    disturbed = EQ3._replace(impulses=0.3, bursts=0.3, plasma=0.1)
    assert np.all(sampled(disturbed, gap, 200) == 0.0)
    assert np.all(sampled(disturbed, 1e-6, 200) > 0.0)


def test_less_sheet_under_the_plate_reads_higher():
    f = [sampled(QUIET, 1.0, 10, cover=c)[0] for c in (1.0, 0.7, 0.3, 0.0)]
    assert np.all(np.diff(f) > 0.0)
    assert f[-1] == pytest.approx(lc(EQ3.body), rel=1e-5)
