"""Damaged logs and calibration tables: each kind is refused, or warned of, with line, column and value."""

import functools
import re

import numpy as np
import pytest

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import heads
from kerfgym.envs.scenarios import machines
from kerfgym.experiments.identify import belonging, identifying, log, protocols

HEADER = ["time [s]", "encoder [mm]", "command [mm/s]", "frequency [Hz]"]


def rows(count=1200):
    """A motion log as text: an axis that follows its commands 10 ms later."""
    time = np.arange(count) * 1e-3
    command = 20.0 * np.sin(40.0 * time)
    encoder = 20.0 - 0.5 * np.cos(40.0 * np.maximum(time - 0.01, 0.0))
    frequency = 3.7e6 + 1e3 * np.sin(np.arange(count))
    cells = zip(time, encoder, command, frequency, strict=True)
    return [[f"{t:.4f}", f"{e:.5f}", f"{c:.4f}", f"{f:.1f}"] for t, e, c, f in cells]


def put(folder, header=HEADER, table=None, name="motion.csv", by=","):
    file = folder / name
    file.write_text("\n".join(by.join(row) for row in [header, *(table or rows())]), encoding="utf-8")
    return file


def changed(row, column, value):
    table = rows()
    table[row][column] = value
    return table


def scaled(column, factor):
    return [[*r[:column], f"{float(r[column]) * factor:.7g}", *r[column + 1 :]] for r in rows()]


# ------------------------------------------------------------------------------------------ tables of text

TEXT = {
    "nan": (HEADER, changed(7, 1, "nan"), r"line 9, column encoder.*nan is not a number"),
    "infinite": (HEADER, changed(7, 2, "inf"), r"line 9, column command.*inf is not a number"),
    "text": (HEADER, changed(7, 1, "far"), r"line 9, column encoder.*'far' is not a number"),
    "comma": (HEADER, changed(7, 1, '"20,1"'), r"line 9, column encoder.*'20,1' is not a number; numbers have a point"),
    "commas without quotes": (HEADER, [[c.replace(".", ",") for c in r] for r in rows()],
                              r"line 2, column 5: '\d+' is one cell too many; .* a point, not a comma"),
    "empty": (HEADER, changed(7, 3, ""), r"line 9, column frequency.*there is nothing"),
    "short row": (HEADER, [*rows()[:5], ["0.005", "20"], *rows()[6:]], r"line 7, column command.*there is nothing"),
    "backwards": (HEADER, changed(7, 0, "0.0055"), r"line 9, column time: 0.0055 is earlier"),
    "descending": (HEADER, rows()[::-1], r"line 3, column time: 1.198 is earlier .*; samples must be in order"),
    "twice": (HEADER, changed(7, 0, "0.0060"), r"line 9, column time: 0.006 is there twice"),
    "gap": (HEADER, rows()[:300] + rows()[400:], r"line 302, column time: 0.4 comes 0.101 s after"),
    "many gaps": (HEADER, [r for i, r in enumerate(rows()) if i % 50], r"line \d+, column time: .*gaps"),
    "other rate": (HEADER, scaled(0, 4.0), r"line 3, column time: 0.004 is 0.004 s after.*period is 0.001 s"),
    "ms as s": (HEADER, scaled(0, 1e3), r"line 3, column time: 1 is 1 s after.*is time in ms"),
    "s as ms": (["time [ms]", *HEADER[1:]], rows(), r"line 3, column time: 0.001 is 1e-06 s after.*is time in s"),
    "MHz as Hz": (HEADER, scaled(3, 1e-6), r"line 2, column frequency: 3.7 is out of range.*MHz"),
    "kHz as Hz": (HEADER, scaled(3, 1e-3), r"line 2, column frequency: 3700 is out of range.*kHz"),
    "µm as mm": (HEADER, scaled(1, 1e3), r"line 2, column encoder: 19500 is out of range.*µm"),
    "m as mm": (HEADER, scaled(1, 1e-3), r"column encoder: 0.0205 ends a travel of .*Is it in m\?"),
    "m/s as mm/s": (HEADER, scaled(2, 1e-3),
                    r"column encoder: 20.5 ends a travel of 1 mm where the commands sum up to 0.001"),
    "jump": (HEADER, changed(700, 1, "40.0"),
             r"line 702, column encoder: 40 is .* mm from the sample before it.*3000 mm/s"),
    "overflow": (HEADER, [[r[0], f"{float(r[1]) - 65.536 * (i > 700):.5f}", *r[2:]] for i, r in enumerate(rows())],
                 r"line 703, column encoder: -4.* did the count of 16 bits overflow"),
    "frozen": (HEADER, [[r[0], "20.0", *r[2:]] for r in rows()], r"line 2, column encoder: 20 never changes"),
    "turned": (HEADER, scaled(2, -1.0), r"line 2, column command: .* opposite sign"),
    "no signal": (HEADER, scaled(2, 0.0)[:1] + [[*r[:2], str(i % 7), r[3]] for i, r in enumerate(rows())][1:],
                  r"line 2, column command: .* does not follow"),
    "no motion": (HEADER, scaled(2, 0.0), r"line 2, column command: 0 is the same throughout"),
    "mostly no frequency": (HEADER, [[*r[:3], "0"] if i % 3 else r for i, r in enumerate(rows())],
                            r"line 3, column frequency: 0 is one of more than half that were not valid"),
    "few": (HEADER, rows(100), r"line 101: ends after 100 samples; at least 500"),
    "only a header": (HEADER, [[""]], r"line \d: .*(nothing|0 samples)"),
    "column twice": ([*HEADER[:3], "encoder [mm]"], rows(), r"line 1: column encoder is there twice"),
    "no unit": (["time", *HEADER[1:]], rows(), r"line 1: time has no unit; write time \[s\]"),
    "wrong unit": ([*HEADER[:3], "frequency [mm]"], rows(), r"line 1: unit 'mm' of frequency is not allowed"),
    "unknown unit": (["time [s]", "encoder [inch]", *HEADER[2:]], rows(),
                     r"line 1: unit 'inch' of encoder .*mm, µm, m"),
    "unknown": ([*HEADER[:3], "frequencies [Hz]"], rows(), r"line 1: unknown column 'frequencies'"),
    "no header": (rows()[0], rows(), r"line 1: '0.0000' is a number; the first line names the columns"),
    "missing": (["_time [s]", *HEADER[1:]], rows(), r"line 1: column time is missing"),
}  # fmt: skip


@pytest.mark.parametrize("what", TEXT)
def test_a_damaged_table_is_refused_with_line_column_and_value(what, tmp_path):
    header, table, told = TEXT[what]
    with pytest.raises(InvalidInput, match=told):
        log.read(put(tmp_path, header, table))


BYTES = {
    "empty": (b"", r"line 1: no header"),
    "blank": (b"\n\n\n", r"line 1: no header"),
    "UTF-16": ("time [s],encoder [mm]\n0,1\n".encode("utf-16"), r"line 1 is not UTF-8 \(byte 0xff\); save it as UTF-8"),
    "Latin-1": ("time [s],encoder [µm]\n0,1\n".encode("latin-1"), r"line 1 is not UTF-8 \(byte 0xb5\)"),
    "semicolons": (b"time [s];encoder [mm]\n0;1\n", r"line 1: .* is separated by semicolons; columns .* by commas"),
    "tabs": (b"time [s]\tencoder [mm]\n0\t1\n", r"line 1: .* is separated by tabs; columns .* by commas"),
}


@pytest.mark.parametrize("what", BYTES)
def test_a_file_of_another_kind_is_refused_with_its_line(what, tmp_path):
    data, told = BYTES[what]
    (tmp_path / "motion.csv").write_bytes(data)
    with pytest.raises(InvalidInput, match=told):
        log.read(tmp_path / "motion.csv")


def test_a_byte_order_mark_does_no_harm(tmp_path):
    plain, file = log.read(put(tmp_path)), tmp_path / "motion.csv"
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert np.array_equal(log.read(file)["encoder"], plain["encoder"])


BESIDE = {
    "protocol": ('protocol = "movement"', r"mine\.csv: which protocol is it\?.* not 'movement'"),
    "key": ('protcol = "motion"', r"mine\.toml: unknown key 'protcol'; did you mean 'protocol'"),
    "no table": ('protocol = "motion"\nunits = "mm"', r"mine\.toml: units is a table of columns"),
    "column": ('protocol = "motion"\n[units]\nencoders = "mm"', r"mine\.toml: unknown column 'encoders'"),
    "absent": ('protocol = "motion"\n[units]\nheight = "mm"', r"mine\.toml: units.height is of a column that the log"),
    "contradiction": ('protocol = "motion"\n[units]\nencoder = "µm"',
                      r"line 1: encoder is in mm by its header and in µm"),
    "no unit": ('protocol = "motion"\n[units]\nencoder = 3', r"line 1: .*encoder"),
}  # fmt: skip


@pytest.mark.parametrize("what", BESIDE)
def test_a_file_beside_the_log_that_cannot_be_right_is_refused(what, tmp_path):
    text, told = BESIDE[what]
    file = put(tmp_path, name="mine.csv")
    file.with_suffix(".toml").write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput, match=told):
        log.read(file)


# ------------------------------------------------------------------------------------ logs of a machine, spoilt


@functools.cache
def recorded(protocol, machine="standard"):
    return protocols.record(machine, protocol, 1)


def spoilt(protocol, part=slice(None), **columns):
    """A machine's log with columns of another content: ``encoder=lambda log, v: 1e3 * v``."""
    made = recorded(protocol)
    kept = {name: values[part] for name, values in made.columns.items()}
    kept |= {name: np.asarray(change(kept, kept[name].copy())) for name, change in columns.items()}
    return log.Log(made.name, protocol, kept)


def at(values, where, value):
    values[where] = value
    return values


def wave(count, size, period):
    return size * np.sin(2 * np.pi * np.arange(count) / period)


def waiting(values, value):
    """The same log, in which a value holds for 0.88 s near the beginning."""
    return np.concatenate([values[:20], np.full(880, value), values[20:-880]])


def other_encoder(count):
    """An axis that only its own log's commands have moved."""
    return 20.0 + np.cumsum(np.random.default_rng(3).normal(0, 0.02, count))


BLOCK = slice(20000, 20400)
SPOILT = {
    "sweep from above": ("sweep", lambda: spoilt("sweep", slice(None, None, -1), time=lambda c, v: v[::-1]),
                         r"line \d+, column encoder: \S+ is the lowest.*rises by 0.\d+ mm.*touches the sheet first"),
    "sweep without a touch": ("sweep", lambda: spoilt("sweep", slice(500, None)),
                              r"line 2, column encoder: \S+ is the lowest.*did the nozzle touch"),
    "sweep of two touches": ("sweep", lambda: spoilt("sweep", np.concatenate([np.arange(1200), np.arange(1200)[::-1],
                                                                              np.arange(1200)]),
                                                     time=lambda c, v: 1e-3 * np.arange(len(v))),
                             r"line \d+, column frequency: 0 is a second touch; the first is in line \d+"),
    "sweep with a dropout": ("sweep", lambda: spoilt("sweep", frequency=lambda c, v: at(v, 1000, 0.0)),
                             r"line 1002, column frequency: 0 is not valid 5.* mm above the lowest place"),
    "sweep in m": ("sweep", lambda: spoilt("sweep", encoder=lambda c, v: 1e-3 * v), r"column encoder: .*is it in m\?"),
    "sweep in µm": ("sweep", lambda: spoilt("sweep", encoder=lambda c, v: 1e3 * v), r"column encoder: .*is it in µm\?"),
    "sweep upside down": ("sweep", lambda: spoilt("sweep", encoder=lambda c, v: 20 - v),
                          r"column frequency: .*frequency must rise with height"),
    "clipped frequency": ("sweep", lambda: spoilt("sweep", frequency=lambda c, v: np.minimum(v, 3.5e6)),
                          r"line \d+, column frequency: 3.5e\+06 is the same in \d+ samples on end; .*clipped"),
    "rest that moves": ("rest", lambda: spoilt("rest", encoder=lambda c, v: 5 + wave(len(v), 3.0, 4000)),
                        r"line \d+, column encoder: \S+ moves, as do .*% of the samples"),
    "rest in m": ("rest", lambda: spoilt("rest", encoder=lambda c, v: 1e-3 * v),
                  r"line \d+, column encoder: \S+ is the highest, 4.4 µm above the lowest; .*is it in m\?"),
    "rest with a frozen counter": ("rest", lambda: spoilt("rest", frequency=lambda c, v: at(v, BLOCK, v[20000])),
                                   r"line \d+, column frequency: \S+ is the same in 40\d samples on end"),
    "rest with its frequency turned": ("rest", lambda: spoilt("rest", frequency=lambda c, v: 7.4e6 - v),
                                       r"line \d+, column frequency: .* frequency rises with height"),
    "motion that has begun": ("motion", lambda: spoilt("motion", slice(40, None)),
                              r"line 4, column encoder: \S+ is .* the axis moves already"),
    "hardly any motion": ("motion", lambda: spoilt("motion", slice(0, 20000), command=lambda c, v: 1e-3 * v),
                          r"column (encoder|command): .*(units|1 mm/s)"),
    "encoder frozen for a while": ("motion", lambda: spoilt("motion", encoder=lambda c, v: waiting(v, v[20]),
                                                            command=lambda c, v: waiting(v, 10.0)),
                                   r"line 22, column encoder: \S+ stays for 88\d samples while the command is 10 mm/s"),
    "clipped command": ("motion", lambda: spoilt("motion", command=lambda c, v: np.clip(v, -0.5, 0.5) * 4),
                        r"line \d+, column command: \S+ is the largest, as are .*% of the samples"),
    "every sample twice": ("motion", lambda: spoilt("motion", encoder=lambda c, v: np.repeat(v[::2], 2)[: len(v)]),
                           r"line \d+, column encoder: \S+ repeats the sample before it, as 50%"),
    "command of another log": ("motion", lambda: spoilt("motion", encoder=lambda c, v: other_encoder(len(v))),
                               r"line 2, column command: .*does not follow"),
    "600 s": ("motion", lambda: spoilt("motion", np.resize(np.arange(39000), 600000),
                                       time=lambda c, v: 1e-3 * np.arange(len(v)),
                                       encoder=lambda c, v: 20 + wave(len(v), 5, 1000),
                                       command=lambda c, v: 31.4 * np.cos(2 * np.pi * np.arange(len(v)) / 1000)),
              r"line 300003, column time: 300.001 is over 300 s"),
    "travel of no Z axis": ("motion", lambda: spoilt("motion", encoder=lambda c, v: v + np.linspace(0, 600, len(v))),
                            r"line \d+, column encoder: \S+ ends a travel of .* mm; a Z axis may have 500 mm"),
    "negative set height": ("follow", lambda: spoilt("follow", set_height=lambda c, v: -v),
                            r"line 2, column set_height: -0.8 is out of range; allowed: 0 to 100 mm"),
    "height in µm": ("follow", lambda: spoilt("follow", height=lambda c, v: 1e3 * v),
                     r"line 2, column height: .* out of range; allowed: 0 to 100 mm; is it in µm"),
    "height in m": ("follow", lambda: spoilt("follow", height=lambda c, v: 1e-3 * v),
                    r"line \d+, column height: .*was the loop closed, and are the units right"),
    "open loop": ("follow", lambda: spoilt("follow", height=lambda c, v: v + 3.0),
                  r"line \d+, column height: .* mm from the set height.*was the loop closed"),
    "a loop that does not answer": ("follow", lambda: spoilt("follow", height=lambda c, v: np.roll(v, 4321),
                                                             frequency=lambda c, v: np.roll(v, 4321)),
                                    r"line \d+, column height: .* off, and the command does not answer: .* −0.3"),
    "height of another frequency": ("follow", lambda: spoilt("follow", height=lambda c, v: 2.0 - v),
                                    r"line \d+, column height: .* is the largest, and the frequency is not"),
    "a perfect loop": ("follow", lambda: spoilt("follow", height=lambda c, v: c["set_height"]),
                       r"line 2, column height: 0.8 is the set height to the last digit"),
    "frozen height": ("follow", lambda: spoilt("follow", height=lambda c, v: at(v, BLOCK, v[20000])),
                      r"line 20002, column height: \S+ is the same in 400 samples on end; allowed: 200"),
    "impossible gap": ("follow", lambda: spoilt("follow", height=lambda c, v: v + 0.3 * (-1.0) ** np.arange(len(v)),
                                                frequency=lambda c, v: v * (1 + 0.05 * (-1.0) ** np.arange(len(v)))),
                       r"line \d+, column height: .* puts the sheet .* no such gap can be"),
}  # fmt: skip


@pytest.mark.parametrize("what", SPOILT)
def test_a_log_that_no_machine_makes_is_refused_or_warned_of(what, tmp_path):
    protocol, make, told = SPOILT[what]
    file = tmp_path / f"{protocol}.parquet"
    log.write(make(), file)
    try:
        said = "\n".join(log.read(file).warnings)
    except InvalidInput as error:
        said = str(error)
    assert said.startswith(str(file))
    assert re.search(told, said), said


@pytest.mark.parametrize("machine", machines.presets())
@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_the_logs_of_every_machine_are_read_without_a_word(machine, ending, tmp_path):
    for protocol in log.PROTOCOLS:
        file = tmp_path / f"{protocol}.{ending}"
        log.write(recorded(protocol, machine), file)
        assert log.read(file).warnings == ()


def test_parquet_is_looked_at_as_csv_is(tmp_path):
    import pandas as pd

    good = {head: values for head, values in zip(HEADER, np.array(rows(), float).T, strict=True)}
    file = tmp_path / "motion.parquet"
    for change, told in (
        ({HEADER[1]: at(good[HEADER[1]].copy(), 7, np.nan)}, r"line 9, column encoder \[mm\]: nan is not a number"),
        ({HEADER[2]: ["far"] * 1200}, r"column command \[mm/s\]: not numbers"),
    ):
        pd.DataFrame({**good, **change}).to_parquet(file)
        with pytest.raises(InvalidInput, match=told):
            log.read(file)
    file.write_bytes(b"time [s],encoder [mm]\n")
    with pytest.raises(InvalidInput, match="it is not Parquet"):
        log.read(file)


# -------------------------------------------------------------------------------------------- calibration tables


def calibrated(frequency=1.0, height=1.0, order=1, header="frequency_Hz,height_mm", by=","):
    f, h = heads.table(0).frequency[::50] * frequency, heads.table(0).height[::50] * height
    return [header, *(f"{x!r}{by}{y!r}" for x, y in zip(f[::order].tolist(), h[::order].tolist(), strict=True))]


def with_row(row, text):
    lines = calibrated()
    lines[row - 1] = text
    return lines


TABLES = {
    "µm": (calibrated(height=1e3),
           r"row 3, column height_mm: 510 is out of range; allowed: -1 to 100 mm; is it in µm"),
    "m": (calibrated(height=1e-3),
          r"row 21, column height_mm: 0.009\d+ is the highest; .*0.5 mm or more; is it in m\?"),
    "MHz": (calibrated(frequency=1e-6), r"row 2, column frequency_Hz: 1.\d+ is out of range; .*is it in MHz"),
    "kHz": (calibrated(frequency=1e-3), r"row 2, column frequency_Hz: 1\d+\.\d+ is out of range; .*is it in kHz"),
    "negative": (with_row(5, "3e6,-2"), r"row 5, column height_mm: -2 is out of range"),
    "descending": (calibrated(order=-1), r"row 3, column frequency_Hz: \S+ after \S+; .*must both rise.*other order"),
    "falls once": (with_row(9, "1e6,4.0"), r"row 9, column frequency_Hz: 1000000 after \d+"),
    "repeated row": (with_row(9, calibrated()[7]), r"row 9, column frequency_Hz: (\S+) after \1;"),
    "nan": (with_row(9, "nan,4.0"), r"row 9, column frequency_Hz: nan is not a finite number"),
    "inf": (with_row(9, "3.6e6,inf"), r"row 9, column height_mm: inf is not a finite number"),
    "text": (with_row(9, "3.6e6,high"), r"row 9, column height_mm: 'high' is not a number"),
    "empty cell": (with_row(9, "3.6e6,"), r"row 9, column height_mm: the cell is empty"),
    "commas": (with_row(9, "3,6e6,4,0"), r"row 9, column 3: '4' is one cell too many; .* a point, not a comma"),
    "semicolons": (calibrated(header="frequency_Hz;height_mm", by=";"), r"row 1: .*columns are separated by commas"),
    "tabs": (calibrated(header="frequency_Hz\theight_mm", by="\t"), r"row 1: .*columns are separated by commas"),
    "no header": (calibrated()[1:], r"row 1: column frequency_Hz is missing"),
    "only a header": (calibrated()[:1], r"needs at least two rows"),
    "column twice": (["frequency_Hz,height_mm,height_mm", *(f"{r},1" for r in calibrated()[1:])],
                     r"row 1: column height_mm is there 2 times"),
    "unknown unit": (calibrated(header="frequency_Hz,height_inch"), r"row 1: column height_mm is missing"),
    "empty": ([""], r"row 1: column frequency_Hz is missing"),
}  # fmt: skip


@pytest.mark.parametrize("what", TABLES)
def test_a_damaged_calibration_table_is_refused_with_row_column_and_value(what, tmp_path):
    lines, told = TABLES[what]
    (tmp_path / "head.csv").write_text("\n".join(lines), encoding="utf-8")
    (tmp_path / "mine.toml").write_text('[head]\ntable = "head.csv"\n', encoding="utf-8")
    with pytest.raises(InvalidInput, match=told):
        machines.load(tmp_path / "mine.toml")


def test_a_calibration_table_that_is_none_of_text_is_refused(tmp_path):
    (tmp_path / "head.csv").write_bytes("\n".join(calibrated()).encode("utf-16"))
    (tmp_path / "mine.toml").write_text('[head]\ntable = "head.csv"\n', encoding="utf-8")
    with pytest.raises(InvalidInput, match="line 1 is not UTF-8"):
        machines.load(tmp_path / "mine.toml")


# --------------------------------------------------------------------------------- logs and tables of two heads


def test_a_sweep_of_another_head_than_the_rests_is_told_by_the_heights():
    sweep, rest = recorded("sweep"), recorded("rest")
    assert belonging.doubts(identifying.head.swept(sweep).table, [rest]) == []
    own = log.Log("rest.csv", "rest", {**rest.columns, "frequency": 0.97 * rest["frequency"]})
    (said,) = belonging.doubts(identifying.head.swept(sweep).table, [own])
    assert "rest.csv, line" in said
    assert "column frequency" in said
    assert "mm from the rest before it" in said
    far = log.Log("rest.csv", "rest", {**rest.columns, "frequency": 0.3 * rest["frequency"]})
    (said,) = belonging.doubts(identifying.head.swept(sweep).table, [far])
    assert "lies over 1 % below the sweep's lowest" in said


def test_a_machines_table_that_is_not_of_the_logs_head_is_told(tmp_path):
    (tmp_path / "head.csv").write_text("\n".join(calibrated(frequency=0.95)), encoding="utf-8")
    (tmp_path / "other.toml").write_text('[head]\ntable = "head.csv"\n', encoding="utf-8")
    with pytest.raises(InvalidInput, match=r"sweep.csv, line \d+, column frequency: .* above .*head.csv's highest"):
        identifying.identify([recorded("sweep")], like=tmp_path / "other.toml")


def test_over_forty_kinds_are_known():
    assert len(TEXT) + len(BYTES) + len(BESIDE) + len(SPOILT) + len(TABLES) >= 40
