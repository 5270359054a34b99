"""Logs in, machines out: what is refused, what is found, and what is said to be unknown."""

import numpy as np
import pytest

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import candidates, sensor, z_axis
from kerfgym.envs.scenarios import machines
from kerfgym.experiments.identify import drive, head, identifying, log, mounting, posterior, protocols, residuals

KNOWN = {
    "name": "known",
    "head": {"noise": 2e-3, "nominal": True},
    "axis": {
        "bandwidth": 60.0, "zeta": 0.7, "dead_time": 0.004, "latency": 0.0003, "acceleration": 12000.0, "speed": 400.0,
        "friction": 800.0, "bristle": 0.005, "stiction": 1.4, "stribeck": 3.0, "jerk": 2e6, "backlash": 0.012,
        "resonance": 90.0, "resonance_zeta": 0.08, "compliance": 0.15,
    },
}  # fmt: skip
"""A machine without distributions."""


def rows(count=1200):
    """A motion log as text: an axis that follows its commands 10 ms later."""
    time = np.arange(count) * 1e-3
    command = 20.0 * np.sin(40.0 * time)
    encoder = 20.0 - 0.5 * np.cos(40.0 * np.maximum(time - 0.01, 0.0))
    frequency = np.full(count, 3.7e6)
    cells = zip(time, encoder, command, frequency, strict=True)
    return [[f"{t:.4f}", f"{e:.5f}", f"{c:.4f}", f"{f:.1f}"] for t, e, c, f in cells]


HEADER = ["time [s]", "encoder [mm]", "command [mm/s]", "frequency [Hz]"]


def put(folder, header=HEADER, table=None, name="motion.csv"):
    file = folder / name
    file.write_text("\n".join(",".join(row) for row in [header, *(table or rows())]), encoding="utf-8")
    return file


def test_bore_and_oscillator_are_those_of_the_machine_that_it_is_like():
    machine = machines.load({**KNOWN, "head": {**KNOWN["head"], "bore": 3.6, "oscillator": "eq1"}})
    known = head.known_of(machine.head)
    assert (known.bore, known.series) == (1.8, 0.003)
    sweep, rest = (protocols.record(machine, protocol, 2) for protocol in ("sweep", "rest"))
    swept = head.swept(sweep, known)
    assert swept.values == pytest.approx({"face": 10.0, "body": 10.0, "inductance": 150.0}, rel=0.03)
    noise = head.noise(rest, swept, np.random.default_rng(0))["noise"]
    assert np.median(noise) == pytest.approx(2e-3, rel=0.1)
    # Taken for the usual one, another head makes the same frequencies, and other noise.
    assert head.swept(sweep).values["body"] != pytest.approx(10.0, rel=0.05)


@pytest.mark.parametrize("oscillator", ["eq3", "eq1"])
def test_scatter_is_that_of_the_sensor_itself(oscillator):
    p = sensor.PRESETS[oscillator]
    c5 = np.array([sensor.capacitance(p, h, 1.0) for h in (0.3, 1.0, 5.0)])
    rate = [sensor.oscillator(p, c, 0.0) for c in c5]
    off = [0.5 * (sensor.oscillator(p, c - 1e-3, 0.0) - sensor.oscillator(p, c + 1e-3, 0.0)) for c in c5]
    counted = head.scatter_at(p, np.array(rate), 0.0, 0.0)
    both = head.scatter_at(p, np.array(rate), 1e-3, 0.0)
    assert np.sqrt(both**2 - counted**2) == pytest.approx(off, rel=1e-3)


@pytest.mark.parametrize("count", [0.005, 0.02])
def test_a_coarse_encoder_widens_the_intervals_of_the_head(count):
    coarse = {**KNOWN, "axis": {**KNOWN["axis"], "encoder": count}}
    swept = head.swept(protocols.record(coarse, "sweep", 1))
    sure = np.sqrt(np.diag(swept.covariance))
    off = np.log(list(swept.values.values())) - np.log([10.0, 10.0, 168.0])
    assert np.all(np.abs(off) < 3 * sure)
    fine = head.swept(protocols.record(KNOWN, "sweep", 1))
    assert np.all(sure > np.sqrt(np.diag(fine.covariance)))


@pytest.mark.parametrize(("count", "speed"), [(1e-3, 10.0), (0.02, 10.0), (0.02, 300.0), (1e-3, 3.0)])
def test_a_count_is_found_whatever_the_speed(count, speed):
    place = speed * 1e-3 * np.arange(3000) + 0.7 * count * np.sin(np.arange(3000))
    assert residuals.count_of(count * np.round(place / count)) == pytest.approx(1e3 * count, rel=1e-6)


def test_an_ideal_encoder_is_no_trouble(monkeypatch):
    """What the right axis leaves is nothing at all, and nothing is divided by it."""
    monkeypatch.setattr(posterior, "ROUNDS", 1)
    command = protocols.record(KNOWN, "motion", 1)["command"][:12000]
    made = drive.axis(np.log([KNOWN["axis"][key] for key in drive.NAMES]), 86)
    encoder = candidates.courses([made], command, 30.0)[0, :, 0]
    found = drive.identify(command, encoder)
    assert found.left < 0.01
    assert np.median(found.draws["bandwidth"]) == pytest.approx(60.0, rel=1e-4)


def test_a_log_begins_with_slow_moves_or_is_taken_whole():
    slow, brisk, top = np.full(5000, 20.0), np.full(4000, -200.0), np.full(2000, 3000.0)
    assert drive.beginnings(np.concatenate([slow, brisk, top])) == (5000, 9000)
    assert drive.beginnings(np.concatenate([slow[:100], brisk, top])) == (4100, 4100)
    assert drive.beginnings(np.concatenate([top, brisk])) == (6000, 6000)
    assert drive.beginnings(slow) == (5000, 5000)


def test_a_log_ends_before_the_head_touches_the_plate_and_says_so(monkeypatch):
    monkeypatch.setattr(protocols, "NEAR", -1.0)
    touches = protocols.record(KNOWN, "motion", 3)
    assert [w for w in touches.warnings if "the head touched the plate after" in w]
    assert np.all(touches["frequency"] > 0)
    assert touches["encoder"][1000:].min() > 0.3


def test_a_head_that_touches_at_once_has_no_log(monkeypatch):
    monkeypatch.setattr(protocols, "HEIGHTS", (-0.1, 1.5, 5.0))
    with pytest.raises(InvalidInput, match=r"rest protocol: after .* s the head touches the plate already"):
        protocols.record(KNOWN, "rest", 3)


def test_a_log_whose_last_stretch_stands_tells_nothing_of_the_mounting():
    sweep, motion = (protocols.record(KNOWN, protocol, 5) for protocol in ("sweep", "motion"))
    swept = head.swept(sweep)
    first = mounting.part(motion, swept).start + 50
    still = {
        key: np.concatenate([values[:first], np.repeat(values[first], 5000)]) for key, values in motion.columns.items()
    }
    still["command"][first:] = 0.0
    stopped = log.Log("motion.csv", "motion", still)
    assert mounting.part(stopped, swept) is None


def test_files_beside_the_machines_are_not_overwritten_unasked(tmp_path):
    for protocol in ("sweep", "motion"):
        log.write(protocols.record(KNOWN, protocol, 1), tmp_path / f"{protocol}.csv")
    mine = tmp_path / "mine.table.csv"
    mine.write_text("of another run", encoding="utf-8")
    files = (str(tmp_path / "sweep.csv"), str(tmp_path / "motion.csv"))
    with pytest.raises(InvalidInput, match=r"mine.table.csv: exists; --overwrite"):
        identifying.command(files, str(tmp_path / "mine.toml"), "standard", False)
    assert mine.read_text(encoding="utf-8") == "of another run"


def test_a_sound_log_is_read_in_the_units_of_its_header(tmp_path):
    read = log.read(put(tmp_path, ["time [ms]", "encoder [µm]", "command [m/min]", "frequency [MHz]"],
                        [[f"{float(t) * 1e3:.1f}", f"{float(e) * 1e3:.2f}", f"{float(c) * 0.06:.6f}",
                          f"{float(f) * 1e-6:.7f}"] for t, e, c, f in rows()]))  # fmt: skip
    plain = log.read(put(tmp_path))
    for name in ("time", "encoder", "command", "frequency"):
        np.testing.assert_allclose(read[name], plain[name], rtol=1e-6, atol=1e-4)
    assert plain.protocol == "motion"


def test_a_file_beside_the_log_gives_units_and_must_not_contradict_it(tmp_path):
    file = put(tmp_path, ["time", "encoder", "command", "frequency"], name="mine.csv")
    with pytest.raises(InvalidInput, match="which protocol"):
        log.read(file)
    beside = 'protocol = "motion"\n[units]\ntime = "s"\nencoder = "mm"\ncommand = "mm/s"\nfrequency = "Hz"\n'
    file.with_suffix(".toml").write_text(beside, encoding="utf-8")
    assert log.read(file).protocol == "motion"
    put(tmp_path, name="mine.csv")
    file.with_suffix(".toml").write_text(beside.replace('"mm"', '"µm"'), encoding="utf-8")
    with pytest.raises(InvalidInput, match="encoder is in mm by its header and in µm"):
        log.read(file)


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_a_recorded_log_reads_back_and_holds_no_truth(ending, tmp_path):
    made = protocols.record(KNOWN, "sweep")
    assert set(made.columns) <= set(log.COLUMNS)
    file = tmp_path / f"a.{ending}"
    log.write(made, file)
    back = log.read(file)
    assert back.protocol == "sweep"
    for name in made.columns:
        np.testing.assert_allclose(back[name], made[name], atol=6e-4 if name == "frequency" else 6e-6)


def test_candidates_move_as_the_machine_that_was_recorded():
    made = protocols.record(KNOWN, "motion")
    axis = z_axis.Params()._replace(
        omega=2 * np.pi * 60, zeta=0.7, dead_time=4.3, acceleration=12000.0, speed=400.0, dac=0.0,
        friction=800.0, bristle=0.005, stiction=1.4, stribeck=3.0, jerk=2e6,
    )  # fmt: skip
    course = candidates.courses([axis], made["command"], made["encoder"][0])[0, :, 0]
    assert np.abs(course - made["encoder"]).max() < 0.52e-3  # half a count, and half a count of the start


def test_a_sweep_and_a_rest_find_head_and_noise():
    swept = head.swept(protocols.record(KNOWN, "sweep", 1))
    assert swept.values == pytest.approx({"face": 10.0, "body": 10.0, "inductance": 168.0}, rel=0.03)
    noise = head.noise(protocols.record(KNOWN, "rest", 1), swept, np.random.default_rng(0))["noise"]
    assert np.median(noise) == pytest.approx(2e-3, rel=0.06)
    low, high = np.percentile(noise, [0.5, 99.5])
    assert low < 2e-3 < high


def test_a_log_of_another_head_than_the_sweeps_is_refused():
    sweep, rest = protocols.record(KNOWN, "sweep"), protocols.record(KNOWN, "rest")
    other = log.Log("rest.csv", "rest", {**rest.columns, "frequency": 1.1 * rest["frequency"]})
    with pytest.raises(InvalidInput, match=r"rest.csv, line \d+, column frequency: .* is that of another head"):
        identifying.identify([sweep, other])


def test_the_machines_file_draws_from_what_was_found_and_keeps_what_was_not(tmp_path):
    made = identifying.identify([protocols.record(KNOWN, "sweep"), protocols.record(KNOWN, "rest")])
    found = {number.key: number.found for number in made.numbers}
    assert found["head.noise"]
    assert not found["head.jitter"]
    assert made.machine.head.jitter == machines.STANDARD.head.jitter
    assert len(made.machine.head.noise.choice) == identifying.ROWS
    assert made.machine.axis == machines.STANDARD.axis
    assert any(note.startswith("no motion log") for note in made.notes)
    drawn = {number.key: number.draws for number in made.numbers}
    known = {
        (f"{face:.7g}", f"{coil:.7g}") for face, coil in zip(drawn["head.face"], drawn["head.inductance"], strict=True)
    }
    head = made.machine.head
    rows = zip(head.face.choice, head.inductance.choice, strict=True)
    assert {(f"{face:.7g}", f"{coil:.7g}") for face, coil in rows} <= known


@pytest.fixture(scope="module")
def recorded():
    """Sweep and motion of the known machine."""
    return protocols.record(KNOWN, "sweep", 2), protocols.record(KNOWN, "motion", 2)


@pytest.fixture(scope="module")
def found(recorded):
    return drive.identify(recorded[1]["command"], recorded[1]["encoder"])


def test_a_known_drive_is_recovered(found):
    for key in ("bandwidth", "zeta", "acceleration", "speed", "jerk", "friction"):
        assert np.median(found.draws[key]) == pytest.approx(KNOWN["axis"][key], rel=0.002), key
    assert np.median(found.draws["dead_time"]) == pytest.approx(0.0043, abs=5e-5)
    assert np.median(found.draws["stiction"]) == pytest.approx(1.4, rel=0.01)
    assert found.left == pytest.approx(1 / np.sqrt(12), rel=0.03)  # µm: roundings of counts of 1 µm


def test_a_known_mounting_is_recovered_from_jolts_near_the_plate(recorded, found):
    sweep, motion = recorded
    draws = mounting.identify(motion, head.swept(sweep), found.best).draws
    for key, true in (("backlash", 0.012), ("resonance", 90.0), ("resonance_zeta", 0.08), ("compliance", 0.15)):
        low, high = np.percentile(draws[key], [0.5, 99.5])
        assert low < true < high, key
    assert np.median(draws["backlash"]) == pytest.approx(0.012, abs=3e-3)
    assert np.median(draws["resonance"]) == pytest.approx(90.0, rel=0.05)


def test_a_log_that_stays_away_from_the_plate_tells_nothing_of_the_mounting(recorded, found):
    sweep, motion = recorded
    away = log.Log("motion.csv", "motion", {k: v[:25000] for k, v in motion.columns.items()})
    assert mounting.identify(away, head.swept(sweep), found.best) is None
