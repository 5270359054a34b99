"""Calibration: the run on the machine, the table, the look-up, the CSV file (Xi2023 Fig. 7)."""

from pathlib import Path

import numpy as np
import pytest
from scipy import optimize

from kerfgym.envs.engine.compiler import for_python
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import calibration, filters, heads, idle, sensor
from kerfgym.envs.plant.calibration import POINTS, CalibrationRefused
from kerfgym.envs.plant.controller import make_law
from kerfgym.envs.plant.fleet import Fleet
from kerfgym.envs.plant.sensor import EQ3, Gate

IDLE = make_law(idle, "idle")
QUIET = EQ3._replace(noise=0.0, jitter=0.0)
ALL_HEADS = heads.HEADS * len(heads.OSCILLATORS)


def _heights(p, frequencies, heights, first, wanted, out, slopes):
    for i in range(wanted.size):
        out[i], slopes[i] = calibration.height(p, frequencies, heights, first, wanted[i])


def _brackets(table, first, wanted, out):
    for i in range(wanted.size):
        out[i] = calibration.bracket(table, first, wanted[i])


heights_of, brackets = for_python(_heights), for_python(_brackets)


def look_up(kind: str, frequencies, heights, first: int, wanted) -> tuple[np.ndarray, np.ndarray]:
    """Heights, mm, and slopes of the table, Hz/mm, for the frequencies ``wanted``."""
    p = calibration.Params(float(("interpolate", "nearest").index(kind)))
    out, slopes = np.empty(wanted.size), np.empty(wanted.size)
    heights_of(p, frequencies, heights, np.uint64(first), wanted, out, slopes)
    return out, slopes


def truth(p: sensor.Params, h: np.ndarray) -> np.ndarray:
    """Frequency at the height ``h``, Hz."""
    return np.array([sensor.oscillator(p, sensor.capacitance(p, float(x), 1.0), 0.0) for x in h])


def made_up(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Samples of a fine run without a machine: 1000 points with a little noise."""
    h = np.arange(1, POINTS + 1) * 0.01
    c = 10.0 + 0.67 / h + 0.0885 * np.maximum(np.log(40 * np.pi / h) - 1.0, 0.0)
    c = c + np.random.default_rng(seed).normal(0.0, 1e-3, POINTS)
    return 1e9 / (2 * np.pi * np.sqrt(168.0 * c)), h


# -------------------------------------------------------------------------------------------------------- the run


def test_a_calibration_uses_at_least_990_of_its_1000_points():
    table = heads.table(0)
    assert 1000 <= table.raw <= 1050  # contact, 0 to 10 mm at 10 mm/s, a little more
    assert table.usable >= 990
    assert table.rating == "A"
    assert table.frequency.shape == table.height.shape == (POINTS,)
    assert np.allclose(table.height, np.arange(1, POINTS + 1) * 0.01, atol=1e-12)


def test_the_samples_of_a_run_lie_a_hundredth_of_a_millimetre_apart():
    frequency, height = heads.run(QUIET)
    rising = height[(frequency > 0.0) & (height > 0.1)]
    assert np.abs(np.diff(rising) - 0.01).max() <= 1.01e-3  # one count
    assert rising[-1] > 10.0


@pytest.mark.parametrize("index", range(ALL_HEADS))
def test_below_a_millimetre_every_heads_table_is_true_to_a_micrometre(index):
    p, table = heads.head(index), heads.table(index)
    h = np.geomspace(0.05, 1.0, 40)  # further down the head is still gathering speed
    assert np.abs(np.interp(truth(p, h), table.frequency, table.height) - h).max() <= 1e-3
    far = np.linspace(1.0, 9.9, 60)
    error = np.interp(truth(p, far), table.frequency, table.height) - far
    softer = truth(p._replace(body=p.body + p.noise), far)
    one_sample = (truth(p, far) - softer) / np.gradient(truth(p, far), far)
    assert np.sqrt(np.mean((error / one_sample) ** 2)) < 0.5  # averaging beats a sample


@pytest.mark.parametrize("preset", [0, 1])
def test_the_heads_of_a_preset_differ_within_their_tolerances(preset):
    nominal, *others = (heads.head(preset * heads.HEADS + i) for i in range(heads.HEADS))
    assert nominal == sensor.PRESETS[heads.OSCILLATORS[preset]]
    drawn = np.array([[getattr(h, f) for f in ("body", "inductance", "radius")] for h in others])
    drawn /= [nominal.body, nominal.inductance, nominal.radius]
    assert np.all(np.abs(drawn - 1.0) <= [0.05, 0.02, 0.02])
    assert np.all(np.ptp(drawn, axis=0) > [0.05, 0.02, 0.02])
    assert heads.head(3) == heads.head(3)


def test_impulses_during_a_run_are_set_aside():
    p = EQ3._replace(impulses=0.005)
    h = np.geomspace(0.05, 1.0, 40)
    table = heads.calibrate(p, seed=1)
    assert table.usable >= 990
    assert np.abs(np.interp(truth(p, h), table.frequency, table.height) - h).max() <= 1e-3


@pytest.mark.parametrize(("noise", "rating"), [(0.001, "A"), (0.005, "B"), (0.02, "C")])
def test_a_run_is_rated_by_its_noise_in_micrometres_at_a_millimetre(noise, rating):
    table = heads.calibrate(EQ3._replace(noise=noise))
    assert table.rating == rating
    h = np.arange(0.7, 1.3, 0.01)  # 0.01 pF are 13 µm at 1 mm, and the square of the height elsewhere
    expected = 13.2 * noise / 0.01 * np.sqrt(np.mean(h**4))
    assert table.noise == pytest.approx(expected, rel=4.0 / np.sqrt(2.0 * h.size))


def test_even_the_noisiest_usable_run_gives_a_table_that_rises():
    table = heads.calibrate(EQ3._replace(noise=0.02))
    assert np.all(np.diff(table.frequency) > 0.0)
    assert np.all(np.diff(table.height) > 0.0)


@pytest.mark.parametrize("noise", [0.05, 0.1])
def test_a_noisy_run_is_refused_with_its_noise(noise):
    with pytest.raises(CalibrationRefused, match=r"noise of \d+ µm at 1 mm; at most 50 µm is fit to use"):
        heads.calibrate(EQ3._replace(noise=noise))


def test_a_run_whose_frequency_does_not_rise_is_refused():
    f, h = made_up()
    with pytest.raises(CalibrationRefused, match="does not rise with height"):
        calibration.build(f[::-1].copy(), h)
    flat = 3.7e6 + np.random.default_rng(1).normal(0.0, 10.0, POINTS)
    flat[:50], flat[-50:] = 3.7e6 + 1.0, 3.7e6
    with pytest.raises(CalibrationRefused, match="does not rise with height"):
        calibration.build(flat, h)


def test_a_run_with_too_few_samples_is_refused_with_their_number():
    f, h = made_up()
    with pytest.raises(CalibrationRefused, match="only 800 of 1000 samples are valid"):
        calibration.build(f[:800], h[:800])
    f[::5] = 0.0
    with pytest.raises(CalibrationRefused, match="only 800 of 1000 samples are valid"):
        calibration.build(f, h)


def test_a_run_with_samples_off_the_curve_is_refused_with_their_number():
    f, h = made_up()
    f[::8] *= 0.97
    with pytest.raises(CalibrationRefused, match=r"\d+ of 1000 samples lie off the curve; at most 10 % may"):
        calibration.build(f, h)


@pytest.mark.parametrize(("gate", "falls"), [(0.05, (2.0, 5.0)), (0.25, (5.5, 10.0)), (1.0, None)])
def test_averaging_few_periods_leaves_raw_samples_that_fall_but_a_table_that_rises(gate, falls):
    # A gate of 100 periods falls from 2.5 mm up, 1000 periods from 7.2 mm, 2000 never; σ grows with h².
    frequency, height = heads.run(QUIET, gate=Gate(gate, 0.0))
    valid = (frequency > 0.0) & (height > 0.0)
    where = height[valid][1:][np.diff(frequency[valid]) < 0.0]
    if falls is None:
        assert where.size == 0
    else:
        assert falls[0] < where.min() < falls[1]
    table = calibration.build(frequency, height)
    assert np.all(np.diff(table.frequency) > 0.0)
    h = np.geomspace(0.05, 1.0, 40)
    assert np.abs(np.interp(truth(QUIET, h), table.frequency, table.height) - h).max() <= 1e-3


def test_the_literal_table_is_the_first_thousand_raw_samples():
    frequency, height = heads.run(QUIET, gate=Gate(1.0, 0.0))
    table = calibration.literal(frequency, height)
    valid = frequency > 0.0
    assert np.array_equal(table.height, height[valid][:POINTS])
    assert np.abs(table.frequency - frequency[valid][:POINTS]).max() < 2e-3
    with pytest.raises(CalibrationRefused, match="only 500 of 1000 samples are valid"):
        calibration.literal(frequency[valid][:500], height[valid][:500])


def test_the_literal_table_rises_where_samples_fall():
    frequency, height = made_up()
    assert np.diff(frequency).min() < 0.0
    assert np.diff(calibration.literal(frequency, height).frequency).min() > 0.0  # a look-up divides by each step


# ------------------------------------------------------------------------------------------------------- monotone


def test_isotonic_regression_is_that_of_scipy():
    rng = np.random.default_rng(9)
    for n in (1, 2, 3, 10, 300):
        for trend in (-1.0, 0.0, 0.02, 1.0):
            y = trend * np.arange(n) + rng.normal(size=n)
            assert calibration.isotonic(y) == pytest.approx(optimize.isotonic_regression(y).x, abs=1e-9)
    ties = rng.integers(0, 4, 200).astype(float)
    assert calibration.isotonic(ties) == pytest.approx(optimize.isotonic_regression(ties).x, abs=1e-9)


# -------------------------------------------------------------------------------------------------------- look-up


@pytest.fixture(scope="module")
def two_heads() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two tables one behind the other, and frequencies inside, between, at and beyond their entries."""
    rng = np.random.default_rng(10)
    tables = [base + np.cumsum(rng.exponential(100.0, POINTS)) for base in (1e6, 2e6)]
    steps = [np.cumsum(rng.exponential(0.01, POINTS)) for _ in range(2)]
    inside = [rng.uniform(t[0] - 500.0, t[-1] + 500.0, 5000) for t in tables]
    edges = [np.concatenate([t, np.nextafter(t, 0.0), [0.0, 1e9, t[0] - 1e-3, t[-1] + 1e-3]]) for t in tables]
    return np.concatenate(tables), np.concatenate(steps), np.concatenate(inside + edges)


@pytest.mark.parametrize("head", [0, 1])
def test_the_binary_search_finds_what_searchsorted_finds(two_heads, head):
    frequencies, _, wanted = two_heads
    out = np.empty(wanted.size)
    brackets(frequencies, np.uint64(head * POINTS), wanted, out)
    own = frequencies[head * POINTS : (head + 1) * POINTS]
    expected = np.clip(np.searchsorted(own, wanted, side="right") - 1, 0, POINTS - 2) + head * POINTS
    assert np.array_equal(out, expected)


@pytest.mark.parametrize("head", [0, 1])
def test_a_height_is_interpolated_between_entries_and_ends_with_the_table(two_heads, head):
    frequencies, heights, wanted = two_heads
    out, _ = look_up("interpolate", frequencies, heights, head * POINTS, wanted)
    own = slice(head * POINTS, (head + 1) * POINTS)
    assert out == pytest.approx(np.interp(wanted, frequencies[own], heights[own]), abs=1e-9)
    assert out.min() == heights[own][0]
    assert out.max() == heights[own][-1]


@pytest.mark.parametrize("head", [0, 1])
def test_the_nearest_look_up_gives_the_entry_of_the_nearest_frequency(two_heads, head):
    frequencies, heights, wanted = two_heads
    out, _ = look_up("nearest", frequencies, heights, head * POINTS, wanted)
    own = slice(head * POINTS, (head + 1) * POINTS)
    nearest = np.abs(wanted[:, None] - frequencies[own]).argmin(axis=1)
    assert out == pytest.approx(heights[own][nearest], abs=1e-9)


@pytest.mark.parametrize("kind", ["interpolate", "nearest"])
def test_the_slope_is_that_of_the_table_between_the_entries_on_either_side(two_heads, kind):
    frequencies, heights, wanted = two_heads
    own = slice(POINTS, 2 * POINTS)
    _, slopes = look_up(kind, frequencies, heights, POINTS, wanted)
    between = np.clip(np.searchsorted(frequencies[own], wanted, side="right") - 1, 0, POINTS - 2)
    exact = np.diff(frequencies[own]) / np.diff(heights[own])
    assert slopes == pytest.approx(exact[between], rel=1e-9)


def test_the_nearest_entry_costs_half_a_step_of_the_table():
    table = heads.table(0)
    f = truth(QUIET, np.linspace(0.2, 1.0, 2000))
    near, between = (look_up(kind, table.frequency, table.height, 0, f)[0] for kind in ("nearest", "interpolate"))
    assert np.abs(near - between).max() == pytest.approx(5e-3, rel=0.05)


def test_a_machine_reads_the_table_of_its_own_head():
    pool = heads.ensure([0, 5])
    fleet = Fleet(2, IDLE, pool)
    fleet.put_filter(np.arange(2), filters.Params(kind=filters.NONE))
    for machine, head in enumerate((5, 0)):
        fleet.put("sensor", machine, heads.head(head)._replace(noise=0.0, jitter=0.0))
        fleet.set("start.head", machine, head)
    fleet.begin([0, 1], [3, 4])
    fleet.advance()
    assert fleet.column("signals.height") == pytest.approx(fleet.column("signals.gap"), abs=3e-3)


# -------------------------------------------------------------------------------------------------- static accuracy


def static_errors(gap: float, gate: Gate, machines: int = ALL_HEADS) -> np.ndarray:
    """Reported height less true gap of heads at rest over a level sheet without disturbances, mm."""
    fleet = Fleet(machines, IDLE, heads.ensure(range(machines)))
    every = np.arange(machines)
    fleet.put_filter(every, filters.Params())
    for i in every:
        fleet.put("sensor", i, heads.head(i)._replace(noise=0.0, jitter=0.0))
    fleet.set("start.head", every, every)
    fleet.put("gate", every, gate)
    fleet.set("path.feed", every, 0.0)
    fleet.set("start.gap", every, gap)
    fleet.begin(every, np.arange(1, machines + 1))
    errors = []
    for _ in range(50):
        fleet.advance()
        errors.append(fleet.column("signals.height") - fleet.column("signals.gap"))
    assert fleet.column("signals.gap") == pytest.approx(gap, abs=1e-9)
    return np.abs(errors)


@pytest.mark.parametrize(("gap", "most"), [(0.5, 1e-3), (1.0, 3e-3)])
def test_the_static_error_is_a_micrometre_at_half_a_millimetre_and_three_at_one(gap, most):
    assert static_errors(gap, Gate()).max() <= most


@pytest.mark.parametrize("gate", [0.1, 0.33, 0.5, 0.72, 1.0])
def test_the_static_error_does_not_depend_on_the_length_of_the_gate(gate):
    assert static_errors(1.0, Gate(gate, 0.0), machines=2).max() <= 3e-3


# ------------------------------------------------------------------------------------------------------------ CSV


def write(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_a_table_comes_back_from_its_file_bit_for_bit(tmp_path):
    table = heads.table(0)
    calibration.write_csv(table, tmp_path / "head.csv")
    back = calibration.read_csv(tmp_path / "head.csv")
    assert np.array_equal(back.frequency, table.frequency)
    assert np.array_equal(back.height, table.height)


def test_a_shorter_table_is_brought_to_a_thousand_entries_on_the_same_curve(tmp_path):
    h = np.linspace(0.1, 5.0, 40)
    f = truth(EQ3, h)
    rows = [f"note,{y},{x}" for x, y in zip(f.tolist(), h.tolist(), strict=True)]
    table = calibration.read_csv(write(tmp_path / "t.csv", "remark, height_mm ,frequency_Hz", *rows))
    assert table.frequency.shape == (POINTS,)
    step = (5.0 - 0.1) / (POINTS - 1)
    assert np.interp(f, table.frequency, table.height) == pytest.approx(h, abs=0.5 * step)  # corners are cut
    assert table.height[[0, -1]] == pytest.approx([0.1, 5.0])
    assert table.frequency[[0, -1]] == pytest.approx(f[[0, -1]])
    assert table.raw == 40


def test_a_byte_order_mark_does_no_harm(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("frequency_Hz,height_mm\n1e6,0\n2e6,1\n", encoding="utf-8-sig")
    assert calibration.read_csv(path).frequency[[0, -1]] == pytest.approx([1e6, 2e6])


HEADER = "frequency_Hz,height_mm"


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (("frequency_Hz,h", "1e6,0"), "row 1: column height_mm is missing; expected frequency_Hz, height_mm"),
        (("",), "row 1: column frequency_Hz is missing"),
        ((HEADER, "1e6,0", "2e6,high", "3e6,2"), "row 3, column height_mm: 'high' is not a number"),
        ((HEADER, "1e6,0", ",1", "3e6,2"), "row 3, column frequency_Hz: the cell is empty"),
        ((HEADER, "1e6,0", "2e6", "3e6,2"), "row 3, column height_mm: the cell is empty"),
        ((HEADER, "1e6,0", "2e6,1", "nan,2"), "row 4, column frequency_Hz: nan is not a finite number"),
        ((HEADER, "1e6,0", "2e6,inf", "3e6,2"), "row 3, column height_mm: inf is not a finite number"),
        ((HEADER, "1e6,0", "2e6,1", "2e6,2"), "row 4: frequency and height must both rise from row to row"),
        ((HEADER, "1e6,0", "2e6,1", "3e6,0.5"), "row 4: frequency and height must both rise from row to row"),
        ((HEADER, "1e6,0"), "needs at least two rows of numbers"),
        ((HEADER,), "needs at least two rows of numbers"),
    ],
)
def test_a_bad_file_is_refused_with_file_row_and_column(tmp_path, lines, message):
    path = write(tmp_path / "bad.csv", *lines)
    with pytest.raises(InvalidInput) as refused:
        calibration.read_csv(path)
    assert str(path) in str(refused.value)
    assert message in str(refused.value)


def test_a_missing_file_is_refused_by_name(tmp_path):
    with pytest.raises(InvalidInput, match=r"cannot read .*none\.csv: No such file"):
        calibration.read_csv(tmp_path / "none.csv")


def test_a_file_that_is_no_text_is_refused_by_name(tmp_path):
    (tmp_path / "picture.csv").write_bytes(b"\x89PNG\r\n\x1a\n\xff\xfe\x00\x00")
    with pytest.raises(InvalidInput, match=r"picture\.csv"):
        calibration.read_csv(tmp_path / "picture.csv")
