"""Logs of a machine: one row a sample, a CSV or Parquet table with units, read with all that can be wrong named.

Columns are ``time``, ``encoder``, ``command``, ``frequency``, ``height``, ``set_height``, ``x``, ``y``, ``x_command``
and ``y_command``. Their unit stands behind them in the header, ``encoder [µm]``, or in a TOML file of the same name
beside the log::

    protocol = "motion"
    [units]
    encoder = "µm"

In memory everything is in s, mm, mm/s and Hz. A height or frequency that was not valid is 0.
"""

import csv
import io
import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...envs.engine.quantity import InvalidInput, did_you_mean
from ...envs.safety import files
from . import plausible

PROTOCOLS = ("rest", "sweep", "motion", "follow", "square")
"""What a machine does while it is recorded (docs/identification.md)."""

UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "µs": 1e-6},
    "speed": {"mm/s": 1.0, "m/s": 1e3, "m/min": 1e3 / 60, "mm/min": 1 / 60},
    "length": {"mm": 1.0, "µm": 1e-3, "m": 1e3},
    "frequency": {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6},
}
"""Units that may be given, and what one of them is in those of :class:`Log`."""

COLUMNS = {
    "time": "time",
    "encoder": "length",
    "command": "speed",
    "frequency": "frequency",
    "height": "length",
    "set_height": "length",
    "x": "length",
    "y": "length",
    "x_command": "speed",
    "y_command": "speed",
}
"""What a log can have, and what kind of number it is."""

ALLOWED = {
    "encoder": (-1e3, 1e3),
    "command": (-5e3, 5e3),
    "frequency": (1e4, 1e8),
    "height": (0.0, 100.0),
    "set_height": (0.0, 100.0),
    "x": (-1e5, 1e5),
    "y": (-1e5, 1e5),
    "x_command": (-1e4, 1e4),
    "y_command": (-1e4, 1e4),
}
"""What a number can be, in the units of :class:`Log`; a frequency or height of 0 was not valid [A]."""

LONGEST_GAP, MOST_GAPS = 0.05, 0.01
"""s without a sample, and share of the samples that may be missing [A]."""

FASTEST = 3000.0
"""mm/s; no Z axis is as fast [A]."""

COUNT = 1e-3
"""mm of an encoder's count, by which a jump is known as an overflow [A]."""

PERIOD = 1e-3
"""s, of the machine's control; logs of another rate are refused, since the model has that period."""

FEWEST = 500
"""Samples of a log."""


@dataclass(frozen=True)
class Log:
    """A log: its columns in s, mm, mm/s and Hz, each of shape (samples,), where it comes from, what is doubtful."""

    name: str
    protocol: str
    columns: dict[str, np.ndarray]
    warnings: tuple[str, ...] = ()

    def __getitem__(self, column: str) -> np.ndarray:
        return self.columns[column]

    def __contains__(self, column: str) -> bool:
        return column in self.columns

    @property
    def duration(self) -> float:
        """s from the first to the last sample."""
        return float(self["time"][-1] - self["time"][0])


def write(log: Log, path: str | Path) -> None:
    """Writes a log with units in its header, and its protocol beside it: CSV, or Parquet by the file's ending."""
    path = Path(path)
    names = [name for name in COLUMNS if name in log]
    heading = [f"{name} [{next(iter(UNITS[COLUMNS[name]]))}]" for name in names]
    if path.suffix == ".parquet":
        import pandas as pd

        pd.DataFrame({head: log[name] for head, name in zip(heading, names, strict=True)}).to_parquet(path)
    else:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(heading)
        digits = {"time": 6, "frequency": 3}
        shown = [[f"{v:.{digits.get(name, 5)}f}" for v in log[name]] for name in names]
        writer.writerows(zip(*shown, strict=True))
        path.write_text(text.getvalue(), encoding="utf-8")
    path.with_suffix(".toml").write_text(f"protocol = {json.dumps(log.protocol)}\n", encoding="utf-8")


def read(path: str | Path) -> Log:
    """Reads a log and looks at every number of it.

    Raises:
        InvalidInput: file, line, column and value of the first thing that cannot be, and what is allowed.
    """
    path = Path(path)
    beside = path.with_suffix(".toml")
    about = files.toml(beside) if files.is_file(beside) else {}
    known = ("protocol", "units", "about")
    for key in about:
        if key not in known:
            raise InvalidInput(f"{beside}: unknown key '{key}'; {did_you_mean(key, known)}")
    protocol = about.get("protocol") or next((p for p in PROTOCOLS if p in path.stem), "")
    if protocol not in PROTOCOLS:
        raise InvalidInput(
            f'{path}: which protocol is it? Say protocol = "motion" in {beside.name}, or in the file\'s name; allowed: '
            f"{', '.join(PROTOCOLS)}" + (f", not {files.shown(protocol)}" if protocol else "")
        )
    heading, table = _parquet(path) if path.suffix == ".parquet" else _csv(path)
    units = about.get("units", {})
    if not isinstance(units, dict):
        raise InvalidInput(f'{beside}: units is a table of columns, such as units.encoder = "µm"')
    names, scales = _header(path, heading, units)
    columns = {}
    for index, (name, scale) in enumerate(zip(names, scales, strict=True)):
        if name:
            columns[name] = _numbers(path, table, index, heading[index]) * scale
    needed = {"rest": ("time", "encoder"), "sweep": ("time", "encoder", "frequency")}
    needed["square"] = ("time", "x", "y", "x_command", "y_command")
    for name in needed.get(protocol, ("time", "encoder", "command")):
        if name not in columns:
            raise InvalidInput(f"{path}, line 1: column {name} is missing; a {protocol} log needs it")
    if "frequency" not in columns and "height" not in columns and protocol not in ("motion", "square"):
        raise InvalidInput(f"{path}, line 1: neither frequency nor height; a {protocol} log needs one of them")
    log = Log(path.name, protocol, columns)
    return Log(path.name, protocol, columns, tuple(_checked(path, log, heading, dict(zip(names, scales, strict=True)))))


def _csv(path: Path) -> tuple[list[str], list[list[str]]]:
    rows = list(csv.reader(files.text(path, files.TABLE).splitlines()))
    if not rows or not any(cell.strip() for cell in rows[0]):
        raise InvalidInput(f"{path}, line 1: no header; expected such as time [s],encoder [mm],command [mm/s]")
    heading = [cell.strip() for cell in rows[0]]
    for mark, what in ((";", "semicolons"), ("\t", "tabs")):
        if len(heading) == 1 and mark in heading[0]:
            raise InvalidInput(f"{path}, line 1: {files.shown(heading[0])} is separated by {what}; columns are "
                               "separated by commas, and numbers have a point")  # fmt: skip
    for i, row in enumerate(rows[1:]):
        if len(row) > len(heading) and any(cell.strip() for cell in row[len(heading) :]):
            raise InvalidInput(
                f"{path}, line {i + 2}, column {len(heading) + 1}: '{row[len(heading)]}' is one cell too many; the "
                f"header names {len(heading)} columns; numbers have a point, not a comma"
            )
    return heading, rows[1:]


def _parquet(path: Path) -> tuple[list[str], Any]:
    import pandas as pd

    try:
        frame = pd.read_parquet(files.checked(path, files.TABLE))
    except (OSError, ValueError) as error:
        raise InvalidInput(f"cannot read {path}: it is not Parquet ({error})") from None
    return [str(name).strip() for name in frame.columns], frame


def _header(path: Path, heading: list[str], given: dict[str, Any]) -> tuple[list[str], list[float]]:
    """Name of each column, and what its unit is in ours; columns that nobody reads have no name."""
    names, scales = [], []
    for cell in heading:
        found = re.fullmatch(r"(.*?)\s*(?:\[(.*)\])?", cell)
        assert found is not None
        name, unit = found[1], found[2]
        if name not in COLUMNS:
            if unit is not None and not name.startswith("_"):
                raise InvalidInput(
                    f"{path}, line 1: unknown column '{name}'; {did_you_mean(name, COLUMNS)}, or _{name}"
                )
            if any(char.isdigit() for char in name) and re.fullmatch(r"[-+.\deE]+", name):
                raise InvalidInput(f"{path}, line 1: '{name}' is a number; the first line names the columns")
            names.append("")
            scales.append(1.0)
            continue
        if name in names:
            raise InvalidInput(f"{path}, line 1: column {name} is there twice (columns {names.index(name) + 1} and "
                               f"{len(names) + 1})")  # fmt: skip
        beside = given.get(name)
        if unit is not None and beside is not None and unit != beside:
            raise InvalidInput(
                f"{path}, line 1: {name} is in {unit} by its header and in {beside} by the file beside it"
            )
        said, allowed = unit if unit is not None else beside, UNITS[COLUMNS[name]]
        said = "µ" + said[1:] if isinstance(said, str) and said[:1] in ("u", "μ") else said
        if said is None:
            raise InvalidInput(f"{path}, line 1: {name} has no unit; write {name} [{next(iter(allowed))}]; allowed: "
                               f"{', '.join(allowed)}")  # fmt: skip
        if said not in allowed:
            raise InvalidInput(f"{path}, line 1: unit '{said}' of {name} is not allowed; allowed: {', '.join(allowed)}")
        names.append(name)
        scales.append(allowed[said])
    for name in given:
        if name not in COLUMNS:
            raise InvalidInput(f"{path.with_suffix('.toml')}: unknown column '{name}'; {did_you_mean(name, COLUMNS)}")
        if name not in names:
            raise InvalidInput(f"{path.with_suffix('.toml')}: units.{name} is of a column that the log does not have")
    return names, scales


def _numbers(path: Path, table: Any, index: int, head: str) -> np.ndarray:
    if not isinstance(table, list):
        values = table.iloc[:, index]
        try:
            out: np.ndarray = values.to_numpy(float)
        except (TypeError, ValueError):
            raise InvalidInput(f"{path}, column {head}: not numbers") from None
        bad = np.flatnonzero(~np.isfinite(out))
        if len(bad):
            raise InvalidInput(f"{path}, line {bad[0] + 2}, column {head}: {out[bad[0]]} is not a number")
        return out
    out = np.empty(len(table))
    for i, row in enumerate(table):
        cell = row[index].strip() if index < len(row) else ""
        try:
            out[i] = float(cell)
        except ValueError:
            told = f"'{cell}' is not a number" if cell else "there is nothing"
            comma = "; numbers have a point, not a comma" if re.fullmatch(r"-?\d+,\d+", cell) else ""
            raise InvalidInput(f"{path}, line {i + 2}, column {head}: {told}{comma}") from None
        if not math.isfinite(out[i]):
            raise InvalidInput(f"{path}, line {i + 2}, column {head}: {cell} is not a number")
    return out


def _checked(path: Path, log: Log, heading: list[str], scales: dict[str, float]) -> list[str]:
    """Raises what cannot be; returns what is doubtful."""
    time = log["time"]
    if len(time) < FEWEST:
        raise InvalidInput(
            f"{path}, line {len(time) + 1}: ends after {len(time)} samples; at least {FEWEST} are needed"
        )

    def refuse(i: Any, name: str, why: str) -> InvalidInput:
        shown = f"{log[name][i] / scales[name]:.6g}"
        return InvalidInput(f"{path}, line {int(i) + 2}, column {name}: {shown} {why}")

    step = np.diff(time)
    back = np.flatnonzero(step <= 0)
    if len(back):
        what = "is there twice" if step[back[0]] == 0 else "is earlier than the sample before it"
        raise refuse(back[0] + 1, "time", f"{what}; samples must be in order")
    usual = float(np.median(step))
    if not 0.8 * PERIOD < usual < 1.25 * PERIOD:
        hint = "; is time in ms?" if 800 * PERIOD < usual < 1250 * PERIOD else ""
        hint = "; is time in s?" if 0.8e-3 * PERIOD < usual < 1.25e-3 * PERIOD else hint
        raise refuse(
            1, "time", f"is {usual:.6g} s after the sample before it; the model's period is {PERIOD:g} s{hint}"
        )
    long = np.flatnonzero(step > LONGEST_GAP)
    if len(long):
        raise refuse(long[0] + 1, "time", f"comes {step[long[0]]:.4g} s after the sample before it; gaps may last "
                                          f"{LONGEST_GAP:g} s")  # fmt: skip
    missing = round(log.duration / PERIOD) + 1 - len(time)
    if missing > MOST_GAPS * len(time):
        gap = np.flatnonzero(step > 1.5 * usual)[0] + 1
        raise refuse(gap, "time", f"is the first of {missing} gaps; {MOST_GAPS:.0%} of the samples may be missing")
    doubts = []
    if missing > 0:
        gap = int(np.argmax(step > 1.5 * usual)) + 1
        doubts.append(str(refuse(gap, "time", f"is the first of {missing} gaps; up to {MOST_GAPS:.0%} are allowed")))
    for name, (low, high) in ALLOWED.items():
        if name in log:
            values = log[name]
            bad = np.flatnonzero(
                ((values < low) | (values > high)) & ~((values == 0) & (name in ("frequency", "height")))
            )
            if len(bad):
                raise refuse(bad[0], name, _out_of(name, values[bad[0]], low, high))
    for name in ("frequency", "height"):
        if name in log and np.mean(log[name] == 0) > 0.5:
            raise refuse(np.flatnonzero(log[name] == 0)[0], name, "is one of more than half that were not valid")
    for name in ("encoder", *(("x", "y") if log.protocol == "square" else ())):
        if name not in log:
            continue
        most, speed = FASTEST if name == "encoder" else ALLOWED["x_command"][1], np.abs(np.diff(log[name])) / step
        if speed.max() > most:
            i = int(np.argmax(speed > most)) + 1
            jump = speed[i - 1] * step[i - 1]
            turns = [bits for bits in (8, 16, 24, 32) if abs(jump / (COUNT * 2**bits) - 1) < 0.02]
            hint = f"did the count of {turns[0]} bits overflow?" if turns else "is it in µm?"
            raise refuse(i, name, f"is {jump:.4g} mm from the sample before it; allowed: {most:g} mm/s; {hint}")
    _related(log, refuse)
    return doubts + plausible.doubts(log.columns, log.protocol, refuse)


def _out_of(name: str, value: float, low: float, high: float) -> str:
    told = f"is out of range; allowed: {low:g} to {high:g} {next(iter(UNITS[COLUMNS[name]]))}"
    if name == "frequency":
        told += "; is it in MHz?" if 0.01 < value < 100 else ("; is it in kHz?" if 100 <= value < low else "")
    elif COLUMNS[name] == "length" and abs(value) > high:
        told += "; is it in µm?"
    return told


def _driven(at: np.ndarray, command: np.ndarray, name: str, refuse: Any) -> None:
    """Refuses an axis of a *square* log that its command cannot have moved."""
    if not np.ptp(command) > 0:
        raise refuse(0, f"{name}_command", "is the same throughout; a square log needs commands that change")
    if not np.ptp(at) > 0:
        raise refuse(0, name, "never changes; a frozen or unconnected count")
    moves = np.diff(at) / PERIOD
    late = [float(np.corrcoef(moves[600:], command[600 - k : len(moves) - k])[0, 1]) for k in range(0, 600, 4)]
    most = late[int(np.argmax(np.abs(late)))]
    if most < -0.5:
        raise refuse(0, f"{name}_command", f"begins a column of the opposite sign of the speed of {name}")
    if not max(late) >= 0.3:
        raise refuse(0, f"{name}_command", f"begins a column that {name} does not follow (no correlation in 600 ms)")
    ratio = float(np.ptp(at)) / max(float(np.ptp(np.cumsum(command))) * PERIOD, 1e-9)
    if not 0.05 < ratio < 20:
        raise refuse(int(np.argmax(at)), name, f"ends a travel that is {ratio:.3g} times what the commands sum up to; "
                                               "allowed: 0.05 to 20; are the units right?")  # fmt: skip


def _related(log: Log, refuse: Any) -> None:
    """Columns that do not belong to each other."""
    if log.protocol == "square":
        for axis in ("x", "y"):
            _driven(log[axis], log[f"{axis}_command"], axis, refuse)
        return
    encoder = log["encoder"]
    travelled = float(np.ptp(encoder))
    if "command" in log and log.protocol in ("motion", "follow"):
        if not np.ptp(log["command"]) > 0:
            raise refuse(0, "command", f"is the same throughout; a {log.protocol} log needs commands that change")
        asked = np.cumsum(log["command"]) * PERIOD
        if travelled == 0:
            raise refuse(0, "encoder", "never changes; a frozen or unconnected count")
        wanted = float(np.ptp(asked))
        moves = np.diff(encoder) / PERIOD
        late = [float(np.corrcoef(moves[60:], log["command"][60 - k : len(moves) - k])[0, 1]) for k in range(0, 60, 2)]
        most = late[int(np.argmax(np.abs(late)))]
        if most < -0.5:
            raise refuse(0, "command", "begins a column of the opposite sign of the encoder's speed; up is positive")
        if not max(late) >= 0.3:
            raise refuse(0, "command", "begins a column that the encoder does not follow (no correlation in 60 ms)")
        ratio = travelled / max(wanted, 1e-9)
        if (log.protocol == "follow" and not 0.2 < ratio < 5) or ratio > 20 or ratio < 0.02:
            raise refuse(int(np.argmax(encoder)), "encoder",
                         f"ends a travel of {travelled:.4g} mm where the commands sum up to {wanted:.4g} mm; are the "
                         f"units right?{' Is it in m?' if ratio < 0.02 else ''}")  # fmt: skip
    if log.protocol == "sweep":
        top = int(np.argmax(encoder))
        if not 2.0 <= travelled <= 60.0:
            raise refuse(top, "encoder", f"is the top of a sweep of {travelled:.4g} mm; allowed: 2 to 60 mm"
                         + ("; is it in m?" if travelled < 0.06 else ""))  # fmt: skip
        good = log["frequency"] > 0
        if np.corrcoef(np.argsort(np.argsort(encoder[good])), log["frequency"][good])[0, 1] < 0.3:
            raise refuse(top, "frequency", "is not above those near the sheet; frequency must rise with height")
    if log.protocol == "rest" and travelled > 100:
        raise refuse(
            int(np.argmax(encoder)), "encoder", f"is part of {travelled:.4g} mm of travel; a rest log stands still"
        )
