"""Logs in, machines out: what is refused, what is found, and what is said to be unknown."""

import numpy as np
import pytest

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import candidates, z_axis
from kerfgym.envs.scenarios import machines
from kerfgym.experiments.identify import drive, head, identifying, log, mounting, protocols

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


def changed(row, column, value):
    table = rows()
    table[row][column] = value
    return table


def scaled(column, factor):
    return [[*r[:column], f"{float(r[column]) * factor:.7g}", *r[column + 1 :]] for r in rows()]


def test_a_sound_log_is_read_in_the_units_of_its_header(tmp_path):
    read = log.read(put(tmp_path, ["time [ms]", "encoder [µm]", "command [m/min]", "frequency [MHz]"],
                        [[f"{float(t) * 1e3:.1f}", f"{float(e) * 1e3:.2f}", f"{float(c) * 0.06:.6f}",
                          f"{float(f) * 1e-6:.7f}"] for t, e, c, f in rows()]))  # fmt: skip
    plain = log.read(put(tmp_path))
    for name in ("time", "encoder", "command", "frequency"):
        np.testing.assert_allclose(read[name], plain[name], rtol=1e-6, atol=1e-4)
    assert plain.protocol == "motion"


BAD = {
    "nan": (HEADER, changed(7, 1, "nan"), r"line 9, column encoder.*nan is not a number"),
    "infinite": (HEADER, changed(7, 2, "inf"), r"line 9, column command.*inf is not a number"),
    "text": (HEADER, changed(7, 1, "far"), r"line 9, column encoder.*'far' is not a number"),
    "comma": (HEADER, changed(7, 1, '"20,1"'), r"line 9, column encoder.*'20,1' is not a number; numbers have a point"),
    "empty": (HEADER, changed(7, 3, ""), r"line 9, column frequency.*there is nothing"),
    "short row": (HEADER, [*rows()[:5], ["0.005", "20"], *rows()[6:]], r"line 7, column command.*there is nothing"),
    "backwards": (HEADER, changed(7, 0, "0.0055"), r"line 9, column time: 0.0055 is earlier"),
    "twice": (HEADER, changed(7, 0, "0.0060"), r"line 9, column time: 0.006 is there twice"),
    "gap": (HEADER, rows()[:300] + rows()[400:], r"line 302, column time: 0.4 comes 0.101 s after"),
    "many gaps": (HEADER, [r for i, r in enumerate(rows()) if i % 50], r"line \d+, column time: .*gaps"),
    "other rate": (HEADER, scaled(0, 4.0), r"line 3, column time: 0.004 is 0.004 s after.*period is 0.001 s"),
    "ms as s": (HEADER, scaled(0, 1e3), r"line 3, column time: 1 is 1 s after.*is time in ms"),
    "MHz as Hz": (HEADER, scaled(3, 1e-6), r"line 2, column frequency: 3.7 is out of range.*MHz"),
    "kHz as Hz": (HEADER, scaled(3, 1e-3), r"line 2, column frequency: 3700 is out of range.*kHz"),
    "µm as mm": (HEADER, scaled(1, 1e3), r"line 2, column encoder: 19500 is out of range.*µm"),
    "jump": (HEADER, changed(700, 1, "40.0"), r"line 702, column encoder: 40 is .* mm from the sample before it"),
    "frozen": (HEADER, [[r[0], "20.0", *r[2:]] for r in rows()], r"line 2, column encoder: 20 never changes"),
    "turned": (HEADER, scaled(2, -1.0), r"line 2, column command: .* opposite sign"),
    "no signal": (HEADER, scaled(2, 0.0)[:1] + [[*r[:2], str(i % 7), r[3]] for i, r in enumerate(rows())][1:],
                  r"line 2, column command: .* does not follow"),
    "few": (HEADER, rows(100), r"100 samples; at least 500"),
    "column twice": ([*HEADER[:3], "encoder [mm]"], rows(), r"line 1: column encoder is there twice"),
    "no unit": (["time", *HEADER[1:]], rows(), r"line 1: time has no unit; write time \[s\]"),
    "wrong unit": ([*HEADER[:3], "frequency [mm]"], rows(), r"line 1: unit 'mm' of frequency is not allowed"),
    "unknown": ([*HEADER[:3], "frequencies [Hz]"], rows(), r"line 1: unknown column 'frequencies'"),
    "no header": (rows()[0], rows(), r"line 1: '0.0000' is a number; the first line names the columns"),
    "missing": (["_time [s]", *HEADER[1:]], rows(), r"line 1: column time is missing"),
}  # fmt: skip


@pytest.mark.parametrize("what", BAD)
def test_a_damaged_log_is_refused_with_line_column_and_value(what, tmp_path):
    header, table, told = BAD[what]
    with pytest.raises(InvalidInput, match=told):
        log.read(put(tmp_path, header, table))


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
    with pytest.raises(
        InvalidInput, match=r"rest.csv, line \d+, column frequency: .* is the sweep that of another head"
    ):
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
