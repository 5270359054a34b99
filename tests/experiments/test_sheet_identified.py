"""The sheet of a follow log: found as it is, in spectrum too, and of use as a scenario."""

import numpy as np
import pytest
from scipy import integrate, signal

from kerfgym.envs import scenarios
from kerfgym.envs.control.stack import resolve
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import calibration, sheet
from kerfgym.envs.scenarios import machines
from kerfgym.experiments import cli
from kerfgym.experiments.identify import followed, head, identifying, protocols, roughness, sheet_files
from kerfgym.experiments.identify.log import Log
from kerfgym.experiments.measure import rollout

PLATE, TIP = 5.6, 2.0
WAVES = ((0.4, 83.0, 0.3), (0.06, 21.0, 1.0), (0.02, 13.0, 2.0))
"""Amplitude, wavelength and phase of the sheet of :func:`closed`, mm."""

TABLE = calibration.Table(
    np.linspace(2e6, 4e6, calibration.POINTS), np.linspace(0.01, 10.0, calibration.POINTS), 1000, 1000, 1.0, "A"
)
"""A head whose height is a straight line over the frequency."""


def seen(wavelength, radius):
    """Share of a wave that a hemisphere's footprint leaves, by quadrature of its projection ¾(1 − u²)."""
    k = 2 * np.pi / wavelength * radius
    return integrate.quad(lambda u: 0.75 * (1 - u * u) * np.cos(k * u), -1, 1)[0]


def wavy(x, radius):
    return sum(a * seen(w, radius) * np.sin(2 * np.pi * x / w + p) for a, w, p in WAVES)


def closed(noise=2e-3, samples=20000, feed=200.0, hits=0, tilt=0.0):
    """A follow log whose surface is known in closed form; the head follows it badly."""
    rng = np.random.default_rng(1)
    x = np.arange(samples) * feed * 1e-3
    surface = wavy(x, PLATE) + tilt * x
    encoder = 5.0 + tilt * x + 0.8 + 0.9 * wavy(x - 2.0, PLATE) + 0.01 * rng.normal(size=samples).cumsum() / 100
    height = encoder - 5.0 - surface + noise * rng.normal(size=samples)
    height[rng.choice(samples, hits, replace=False)] += 0.08
    frequency = np.interp(height, TABLE.height, TABLE.frequency)
    late = np.convolve(frequency, np.ones(5) / 5)[:samples]
    late[:4] = frequency[:4]
    columns = {"time": np.arange(samples) * 1e-3, "encoder": encoder, "x": x, "frequency": frequency}
    columns |= {"height": np.interp(late, TABLE.frequency, TABLE.height), "set_height": np.full(samples, 0.8)}
    return Log("follow.csv", "follow", columns)


def off(found, truth):
    """RMS error of a profile, mm, whatever its level; within a wavelength of its ends a line takes the waves' place."""
    return float(np.std((truth - found)[400:-400]))


@pytest.mark.parametrize("noise", [1e-3, 5e-3, 20e-3])
def test_a_sheet_in_closed_form_is_found_far_below_the_noise_of_a_sample(noise):
    found = followed.followed(closed(noise), TABLE)
    assert found.noise == pytest.approx(1e3 * noise, rel=0.05)
    assert off(found.height, wavy(found.position, PLATE)) < 0.25 * noise
    assert off(found.tip, wavy(found.position, TIP)) < 0.5 * noise
    assert found.feed == pytest.approx(200.0, rel=1e-6)
    assert found.set_height == pytest.approx(0.8)


def test_what_the_plate_weakens_is_given_back_under_the_tip():
    found = followed.followed(closed(1e-3), TABLE)
    weak = off(found.height, wavy(found.position, TIP))
    assert off(found.tip, wavy(found.position, TIP)) < 0.1 * weak


def test_impulses_leave_no_trace():
    found = followed.followed(closed(hits=400), TABLE)
    assert found.left_out == pytest.approx(400 / 20000, rel=0.1)
    assert off(found.height, wavy(found.position, PLATE)) < 0.6e-3


def test_a_slope_is_part_of_the_sheet():
    found = followed.followed(closed(tilt=0.004), TABLE)
    assert off(found.height, wavy(found.position, PLATE) + 0.004 * found.position) < 0.6e-3
    made = roughness.spectrum(found.position, found.felt, PLATE, 1e-3 * found.noise)
    assert made.tilt == pytest.approx(0.004, rel=1e-3)


def test_without_a_sweep_the_log_makes_its_own_table_and_finds_the_filters_delay():
    log = closed(2e-3)
    found = followed.followed(log)
    assert any("late by 2 ms" in note for note in found.notes)
    assert off(found.height, wavy(found.position, PLATE)) < 0.5e-3
    # The reported height as if it were not late: what the head has moved meanwhile would be taken for sheet.
    late = followed.nozzle(log["encoder"], None) - log["height"]
    assert np.std((late - wavy(log["x"], PLATE))[100:-100]) > 5 * off(found.height, wavy(found.position, PLATE))


def test_a_log_with_nothing_but_a_late_height_says_what_it_takes_for_granted():
    log = closed(2e-3)
    found = followed.followed(Log(log.name, log.protocol, {k: v for k, v in log.columns.items() if k != "frequency"}))
    assert any("taken to be 2 ms late" in note for note in found.notes)


def test_the_mounting_moves_the_nozzle_as_its_transfer_function_says():
    axis = machines.load({"name": "m", "axis": {"resonance": 60.0, "compliance": 0.3, "resonance_zeta": 0.1}}).axis
    t, w, r = np.arange(4000) * 1e-3, 2 * np.pi * 25.0, 2 * np.pi * 60.0
    moved = followed.nozzle(10.0 + np.sin(w * t), axis) - 10.0
    gain = 0.7 + 0.3 * r**2 / (r**2 - w**2 + 2j * 0.1 * r * w)
    np.testing.assert_allclose(moved[2000:], np.imag(gain * np.exp(1j * w * t))[2000:], atol=4e-3)


def test_lines_have_their_amplitude_before_any_footprint_and_their_wavelength():
    found = followed.followed(closed(3e-3), TABLE)
    made = roughness.spectrum(found.position, found.felt, PLATE, 1e-3 * found.noise)
    assert made.continuous is None
    assert len(made.lines) == len(WAVES)
    for line, (amplitude, wavelength, _) in zip(made.lines, WAVES, strict=True):
        assert line.amplitude == pytest.approx(amplitude, rel=0.02)
        assert line.wavelength == pytest.approx(wavelength, rel=2e-3)


@pytest.mark.parametrize(("exponent", "rolloff", "rms"), [(2.0, 300.0, 0.08), (3.0, 400.0, 0.25), (4.0, 150.0, 0.05)])
def test_a_continuous_sheet_has_its_spectrum_and_no_lines(exponent, rolloff, rms):
    felt = rms * sheet.random_tables(exponent, rolloff, PLATE)[sheet.RANDOM_ONE + 1 :][:32000]
    position, rng = np.arange(len(felt)) * sheet.RANDOM_SPACING, np.random.default_rng(0)
    felt = felt + 1e-3 * rng.normal(size=len(felt))
    made = roughness.spectrum(position, felt, PLATE, 1e-3)
    assert not made.lines
    assert made.continuous.rms == pytest.approx(rms, rel=0.25)
    assert made.continuous.exponent == pytest.approx(exponent, rel=0.1)
    k, density = signal.welch(felt, 2 * np.pi / sheet.RANDOM_SPACING, nperseg=8000, detrend="linear")
    band = (k > 2 * np.pi / 200) & (k < 2 * np.pi / 30)
    c = made.continuous
    ratio = density[band] / roughness.expected(k[band], c.rms, c.exponent, c.rolloff, PLATE)
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.12)


RIVALS = ("pid", "xi2023-tuned", "observer")


def rms(errors, run):
    scored = run.scored[300:]
    return float(np.sqrt(np.mean(errors[300:][scored] ** 2)))


@pytest.mark.parametrize(
    ("machine", "sheet_of"),
    [("standard", "random-k3"), ("modern", "wavy"), ("thin-plate", "random-k2"), ("heavy-head", "rough")],
)
def test_controllers_do_on_the_found_sheet_as_on_the_true_one(machine, sheet_of, tmp_path):
    cuts, seed = machines.load(machine), 5
    log, sweep = protocols.record(machine, "follow", seed, sheet_of), protocols.record(machine, "sweep", seed)
    found = followed.followed(log, head.swept(sweep).table, cuts.axis, cuts.head.plate)
    made = roughness.spectrum(found.position, found.felt, found.plate, 1e-3 * found.noise)
    very, drawn = sheet_files.write(found, made, tmp_path / "mine.toml")
    true = scenarios.load(sheet_of).varied(set_height=found.set_height, duration=15.0)
    for rival in RIVALS:
        runs = [
            rollout.roll(machines.put_on(scenario.varied(duration=15.0), cuts), resolve(rival), [seed])
            for scenario in (true, scenarios.read(very), scenarios.read(drawn))
        ]
        assert rms(runs[1].reported_error, runs[1]) == pytest.approx(rms(runs[0].reported_error, runs[0]), rel=0.02)
        assert rms(followed.under_tip(found, runs[1]), runs[1]) == pytest.approx(rms(runs[0].error, runs[0]), rel=0.1)
        assert rms(runs[2].error, runs[2]) == pytest.approx(rms(runs[0].error, runs[0]), rel=0.15)


def test_what_is_too_short_for_the_plate_is_said_to_be_no_shape():
    moving = scenarios.load("flat").varied(
        sheet={"vibrations": [{"frequency": 40.0, "amplitude": 0.01}]}, set_height=0.8
    )
    made = identifying.identify(
        [protocols.record("modern", "sweep", 1), protocols.record("modern", "follow", 1, moving)], like="modern"
    )
    assert any("too short for the plate to be a shape" in note for note in made.notes)


def test_a_log_without_places_or_of_no_journey_is_refused():
    log = closed()
    with pytest.raises(InvalidInput, match="needs a column x"):
        followed.followed(Log("a.csv", "follow", {k: v for k, v in log.columns.items() if k != "x"}), TABLE)
    with pytest.raises(InvalidInput, match=r"a.csv, line 20001, column x: ends a journey of 40 mm"):
        followed.followed(Log("a.csv", "follow", {**log.columns, "x": 0.01 * log["x"]}), TABLE)
    with pytest.raises(InvalidInput, match="is the sweep that of another head"):
        followed.followed(Log("a.csv", "follow", {**log.columns, "frequency": 2 * log["frequency"]}), TABLE)
    with pytest.raises(InvalidInput, match="only follow has"):
        protocols.record("standard", "rest", 0, "rough")


def test_the_commands_write_scenarios_that_the_other_commands_take(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    cli.main(["record", "--protocol", "follow", "-s", "rough", "-o", "follow.csv"])
    cli.main(["record", "--protocol", "sweep", "-o", "sweep.csv"])
    cli.main(["identify", "sweep.csv", "follow.csv", "-o", "mine.toml"])
    said = capsys.readouterr().out
    assert "mine.sheet.toml" in said
    assert "mine.sheets.toml" in said
    very, drawn = scenarios.load("mine.sheet.toml"), scenarios.load("mine.sheets.toml")
    assert very.sheet.profile is not None
    assert len(drawn.sheet.waves) >= 5
    assert very.feed == drawn.feed == pytest.approx(200.0, rel=1e-3)
