"""From logs to a machine's file whose numbers are distributions, and to words about how sure each is."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...envs.engine.quantity import InvalidInput
from ...envs.plant import calibration
from ...envs.safety import names
from ...envs.scenarios import axes_of, machine_text, machines
from ...envs.scenarios.distributions import Joint, middle
from ...envs.scenarios.machines import Machine
from ..store.runs import write_text
from . import belonging, disturbances, drive, followed, head, mounting, posterior, roughness, sheet_files, slides
from .log import Log, read

ROWS = 100
"""Draws that stand for a posterior in the file, equally likely."""

UNEXPLAINED = 3.0
"""µm that a model may leave of slow moves beyond the encoder's rounding [A]. A drive of this model leaves a tenth;
drives of another make, whose following it still tells, 1 µm; those that it can't stand for, from 5 µm on
(tests/oracle/foreign.py)."""

UNEXCITED = 0.7
"""Share of the prior's interval from which on a log has told nothing."""

NEEDS = {
    "sweep": "head.face, head.body, head.inductance",
    "rest": "head.noise",
    "motion": "the Z drive, and its mounting",
    "square": "gains and time constants of the X and Y axes",
}
"""What each protocol finds."""

COMPANIONS = {"sweep": (".table.csv",), "follow": sheet_files.ENDS}
"""Files that a log adds to the machine's."""


@dataclass(frozen=True)
class Number:
    """One number of a machine after its logs: key, draws in the file's unit, the ends of the prior, whether found, and
    the group within which draws belong together."""

    key: str
    draws: np.ndarray
    prior: tuple[float, float]
    found: bool
    group: str

    @property
    def interval(self) -> tuple[float, float, float]:
        """2.5 %, median and 97.5 %."""
        low, middle, high = np.percentile(self.draws, [2.5, 50, 97.5])
        return float(low), float(middle), float(high)


@dataclass(frozen=True)
class Identified:
    """What logs say of a machine, see :func:`identify`."""

    machine: Machine
    numbers: tuple[Number, ...]
    swept: head.Swept | None
    notes: tuple[str, ...]
    explained: bool = True  # whether the model can stand for this drive
    sheet: followed.Followed | None = None
    spectrum: roughness.Spectrum | None = None

    @property
    def table(self) -> calibration.Table | None:
        """The sweep's calibration table."""
        return self.swept.table if self.swept else None


def identify(logs: Iterable[Log], name: str = "mine", like: Any = "standard", seed: int = 0) -> Identified:
    """A machine whose numbers are distributions, from logs of its protocols.

    Args:
        logs: at most one of each protocol that finds something.
        name: of the machine.
        like: what holds where the logs say nothing.
        seed: of the sampling.

    Raises:
        InvalidInput: no log finds anything, two of a protocol, a rest without a sweep, or what a log lacks.
    """
    logs, rng = list(logs), np.random.default_rng(seed)
    by: dict[str, Log] = {}
    for log in logs:
        if log.protocol in by:
            raise InvalidInput(f"{log.name} and {by[log.protocol].name} are both {log.protocol} logs; give one of each")
        by[log.protocol] = log
    if not set(by) & {*NEEDS, "follow"}:
        raise InvalidInput(f"nothing to identify from; give logs of {', '.join(NEEDS)} or follow")
    if "rest" in by and "sweep" not in by:
        raise InvalidInput(f"{by['rest'].name}: noise in pF needs the head's sensitivity; give the sweep log, too")
    base, notes, numbers, swept = machines.load(like), [w for log in logs for w in log.warnings], [], None
    explained, against = True, list[str]()  # what stands in the machine's own summary, wherever that is shown
    if base.head.table:
        given = calibration.read_csv(base.head.table)
        notes += belonging.doubts(
            given, [by[p] for p in ("sweep", "rest", "motion") if p in by], f"{base.head.table}'s"
        )
    if "sweep" in by:
        swept = head.swept(by["sweep"], head.known_of(base.head))
        spread = rng.multivariate_normal(np.log(list(swept.values.values())), swept.covariance, 1000)
        for key, draws in zip(swept.values, np.exp(spread).T, strict=True):
            numbers.append(_number(f"head.{key}", draws, head.RANGES[key], "sweep"))
        notes.append(
            f"sweep: table rated {swept.table.rating}, scatter {swept.table.noise:.1f} µm at 1 mm; a nozzle's bore of "
            f"{2 * swept.known.bore:g} mm and oscillator {base.head.oscillator} are those of '{base.name}'"
        )
        notes += belonging.doubts(swept.table, [by[p] for p in ("rest", "motion") if p in by])
    if "rest" in by and swept:
        for key, draws in head.noise(by["rest"], swept, rng).items():
            numbers.append(_number(f"head.{key}", draws, {"noise": head.NOISE, "jitter": head.JITTER}[key], "rest"))
        happened = disturbances.identify(by["rest"], swept, rng, middle(base.head.warming))
        for key, draws in happened.draws.items():
            numbers.append(_number(f"head.{key}", draws, disturbances.PRIOR[key], key, key in disturbances.LOGARITHMIC))
        notes += happened.notes
    if "motion" in by:
        found = drive.identify(by["motion"]["command"], by["motion"]["encoder"], seed)
        for key, draws in found.draws.items():
            ends = drive.PRIOR.get(key, (0.0, drive.LATEST * 1e-3))
            numbers.append(_number(f"axis.{key}", draws, ends, "motion", key in drive.PRIOR))
        notes.append(f"motion: the model leaves {found.left:.2f} µm of the encoder; the sample is worth "
                     f"{found.effective:.0f} draws")  # fmt: skip
        if found.effective < posterior.FEW * len(drive.NAMES):
            notes.append(
                "motion: too few draws for intervals, which may be too narrow: at its limits the smallest of changes "
                "sends this drive elsewhere"
            )
            against.append("its intervals may be too narrow")
        if found.spread > 2.0:
            notes.append(
                f"motion: what is left is not chance alone; intervals are up to {found.spread:.1f} times as wide"
            )
        if found.slow > UNEXPLAINED:
            notes.append(
                f"motion: {found.slow:.1f} µm of slow moves are left beyond the encoder's rounding; the model does not "
                "explain this drive"
            )
            against.append("the model does not explain its drive")
        elif found.apart > 0.0:
            notes.append(
                f"motion: {found.apart:.0%} of the log, its quickest moves, leave {found.beyond:.0f} µm and count less;"
                " this drive gets out of its limits in another way than the model's"
            )
            against.append("the model does not explain its quickest moves")
        explained = found.slow <= UNEXPLAINED
        notes.append("axis.dead_time holds the latency")
        notes += _mounted(by["motion"], swept, found.best, numbers, seed)
    if "square" in by:
        slid = slides.identify(by["square"], axes_of(base.gantry), seed)
        for key, draws in slid.draws.items():
            numbers.append(_number(f"gantry.{key}", draws, slides.PRIOR[key], "square"))
        notes.append(f"square: the model leaves {slid.left:.2f} µm of the encoders")
        if not slid.explained:
            notes.append("square: that is far more than counts of an encoder; the model does not explain these axes")
            against.append("the model does not explain its X and Y axes")
        if not slid.limited:
            notes.append("square: the axes never came to their limit of acceleration")
    for protocol in NEEDS:
        if protocol not in by:
            notes.append(f"no {protocol} log: {NEEDS[protocol]} as in '{base.name}'")
    machine, sheet, spectrum = _machine(base, name, numbers, [log.name for log in logs], rng, against), None, None
    if "follow" in by:
        sheet = followed.followed(by["follow"], swept.table if swept else None, machine.axis, machine.head.plate)
        spectrum = roughness.spectrum(sheet.position, sheet.felt, sheet.plate, 1e-3 * sheet.noise)
        notes += sheet_files.told(sheet, spectrum)
    return Identified(machine, tuple(numbers), swept, tuple(notes), explained, sheet, spectrum)


def _mounted(log: Log, swept: head.Swept | None, axis: Any, numbers: list[Number], seed: int) -> list[str]:
    """Adds what hangs between motor and nozzle; returns what a user should know."""
    keys = ", ".join(f"axis.{key}" for key in mounting.PRIOR)
    if swept is None or "frequency" not in log:
        return [f"not found: {keys}; an encoder on the motor does not see them, which takes a motion log with "
                "frequency and the sweep"]  # fmt: skip
    found = mounting.identify(log, swept, axis, seed)
    if found is None:
        return [f"not found: {keys}; {log.name} does not end near the plate"]
    for key, draws in found.draws.items():
        numbers.append(_number(f"axis.{key}", draws, mounting.PRIOR[key], "mounting"))
    return [f"motion: near the plate the model leaves {found.left:.1f} µm of the height, as at 1 mm"]


def _number(key: str, draws: np.ndarray, prior: tuple[float, float], group: str, log: bool = True) -> Number:
    low, high = np.percentile(draws, [2.5, 97.5])
    scale = np.log if log else np.asarray
    wide = float(np.diff(scale([low, high]))[0]) / (0.95 * float(np.diff(scale(list(prior)))[0]))
    return Number(key, draws, prior, wide < UNEXCITED, group)


def _machine(
    base: Machine,
    name: str,
    numbers: list[Number],
    logs: list[str],
    rng: np.random.Generator,
    against: Iterable[str] = (),
) -> Machine:
    """A machine that draws from what was found; numbers that were drawn together stay together. ``against``: what is
    said against it in its summary."""
    tables: dict[str, dict[str, Any]] = {"head": {}, "axis": {}, "gantry": {}}
    for group in dict.fromkeys(number.group for number in numbers):
        of = [number for number in numbers if number.group == group]
        rows = rng.choice(len(of[0].draws), ROWS, replace=False)
        for number in of:
            if not number.found:  # what a log does not tell stays as it was
                continue
            table, key = number.key.split(".")
            values = number.draws[rows]
            if number.key == "gantry.acceleration":  # which is a number in a machine's file
                tables[table][key] = float(f"{np.median(number.draws):.7g}")
                continue
            if number.key == "axis.dead_time":
                values = np.minimum(values, 0.02)
            tables[table][key] = Joint(choice=tuple(float(f"{v:.7g}") for v in values), joint=group)
    if "dead_time" in tables["axis"]:
        tables["axis"]["latency"] = 0.0
    if "t1" in tables["gantry"]:
        tables["gantry"]["slower"] = 1.0
    return replace(
        base,
        name=name,
        summary="; ".join([f"identified from {', '.join(logs)}", f"like {base.name} where they say nothing", *against]),
        head=replace(base.head, **tables["head"]),
        axis=replace(base.axis, **tables["axis"]),
        gantry=replace(base.gantry, **tables["gantry"]),
    )


def command(files: tuple[str, ...], out: str, like: str, overwrite: bool) -> tuple[Identified, list[Log]]:
    """What ``kerfgym identify`` does but for its page; what was found, and the logs."""
    target = Path(out)
    if target.suffix != ".toml":
        raise InvalidInput(f"-o takes a file such as mine.toml, not {out}")
    logs = [read(file) for file in files]
    ends = {".toml", ".html", *(end for log in logs for end in COMPANIONS.get(log.protocol, ()))}
    there = [str(file) for file in map(target.with_suffix, sorted(ends)) if file.exists()]
    if there and not overwrite:
        raise InvalidInput(f"{', '.join(there)}: exists; --overwrite replaces what is there")
    found = identify(logs, names.of_file(target.stem), like)
    write_text(target, machine_text.text_of(found.machine, whole=False))
    if found.table is not None:
        calibration.write_csv(found.table, target.with_suffix(".table.csv"))
    scenarios = sheet_files.write(found.sheet, found.spectrum, target) if found.sheet and found.spectrum else ()
    print(f"{'':22s}{'median':>12s}   95 % interval")
    for number in found.numbers:
        low, middle, high = (shown(value, number.interval) for value in number.interval)
        told = f"{low} to {high}" if number.found else "not excited: as before the logs"
        print(f"{number.key:22s}{middle:>12s}   {told}")
    for line in strong(found.numbers):
        print(line)
    for note in found.notes:
        print(note)
    print(target, *scenarios, sep="\n")
    return found, logs


def shown(value: float, interval: tuple[float, float, float]) -> str:
    """A value with as many digits as its interval needs: two of its width, at least four in all."""
    width = interval[2] - interval[0]
    largest = max(abs(interval[0]), abs(interval[2]), 1e-300)
    digits = 4 if width <= 0 else int(np.clip(np.ceil(np.log10(largest / width)) + 2, 4, 9))
    return f"{value:.{digits}g}"


def strong(numbers: tuple[Number, ...], least: float = 0.8) -> list[str]:
    """Pairs of an axis's numbers that the log knows better together than alone."""
    of = [n for n in numbers if n.key.startswith("axis.") and n.found]
    if len(of) < 2:
        return []
    table = np.corrcoef([n.draws for n in of])
    return [
        f"correlated: {of[i].key} and {of[j].key}, {table[i, j]:+.2f}"
        for i in range(len(of))
        for j in range(i)
        if abs(table[i, j]) > least
    ]
