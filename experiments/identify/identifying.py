"""From logs to a machine's file whose numbers are distributions, and to words about how sure each is."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...envs.engine.quantity import InvalidInput
from ...envs.plant import calibration
from ...envs.safety import names
from ...envs.scenarios import machine_text, machines
from ...envs.scenarios.distributions import Choice
from ...envs.scenarios.machines import Machine
from ..store.runs import write_text
from . import drive, head
from .log import Log, read

QUANTILES = 41
"""Values that stand for a posterior in the file, equally likely."""

UNEXCITED = 0.7
"""Share of the prior's interval from which on a log has told nothing."""

NEEDS = {"sweep": "head.face, head.body, head.inductance", "rest": "head.noise", "motion": "the Z drive"}
"""What each protocol finds."""

BESIDE = ("backlash", "resonance", "resonance_zeta", "compliance")
"""Numbers of an axis between motor and nozzle, which its encoder does not see."""


@dataclass(frozen=True)
class Number:
    """One number of a machine after its logs: key, draws in the file's unit, the ends of the prior, whether found."""

    key: str
    draws: np.ndarray
    prior: tuple[float, float]
    found: bool

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
    table: calibration.Table | None
    notes: tuple[str, ...]


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
    if not set(by) & set(NEEDS):
        raise InvalidInput(f"nothing to identify from; give logs of {', '.join(NEEDS)}")
    if "rest" in by and "sweep" not in by:
        raise InvalidInput(f"{by['rest'].name}: noise in pF needs the head's sensitivity; give the sweep log, too")
    base, notes, numbers, table = machines.load(like), [w for log in logs for w in log.warnings], [], None
    if "sweep" in by:
        swept = head.swept(by["sweep"])
        table = swept.table
        spread = rng.multivariate_normal(np.log(list(swept.values.values())), swept.covariance, 1000)
        for key, draws in zip(swept.values, np.exp(spread).T, strict=True):
            numbers.append(_number(f"head.{key}", draws, head.RANGES[key]))
        notes.append(f"sweep: table rated {table.rating}, scatter {table.noise:.1f} µm at 1 mm; the nozzle's bore is "
                     "taken as 2 mm")  # fmt: skip
        if "frequency" in by.get("motion", ()) or "frequency" in by.get("rest", ()):
            notes += _belongs(table, [by[p] for p in ("rest", "motion") if p in by])
    if "rest" in by:
        for key, draws in head.noise(by["rest"], swept, rng).items():
            numbers.append(_number(f"head.{key}", draws, {"noise": head.NOISE, "jitter": head.JITTER}[key]))
    if "motion" in by:
        found = drive.identify(by["motion"]["command"], by["motion"]["encoder"], seed)
        for key, draws in found.draws.items():
            ends = drive.PRIOR.get(key, (0.0, drive.LATEST * 1e-3))
            numbers.append(_number(f"axis.{key}", draws, ends, log=key in drive.PRIOR))
        notes.append(f"motion: the model leaves {found.left:.2f} µm of the encoder, correlated over "
                     f"{found.correlated:.0f} samples; the sample is worth {found.effective:.0f} draws")  # fmt: skip
        if found.left > 5.0:
            notes.append("motion: that is far more than counts of an encoder; the model does not explain this drive")
        notes.append("axis.dead_time holds the latency")
        notes.append(f"not found: axis.{', axis.'.join(BESIDE)}; an encoder on the motor does not see them")
    for protocol in NEEDS:
        if protocol not in by:
            notes.append(f"no {protocol} log: {NEEDS[protocol]} as in '{base.name}'")
    return Identified(_machine(base, name, numbers, [log.name for log in logs]), tuple(numbers), table, tuple(notes))


def _number(key: str, draws: np.ndarray, prior: tuple[float, float], log: bool = True) -> Number:
    low, high = np.percentile(draws, [2.5, 97.5])
    scale = np.log if log else np.asarray
    wide = float(np.diff(scale([low, high]))[0]) / (0.95 * float(np.diff(scale(list(prior)))[0]))
    return Number(key, draws, prior, wide < UNEXCITED)


def _belongs(table: calibration.Table, logs: list[Log]) -> list[str]:
    """Warns of a sweep of another head: frequencies near the plate that the table does not have."""
    said: list[str] = []
    top = 1.01 * float(table.frequency[-1])
    for log in logs:
        if "frequency" in log:
            off = np.flatnonzero(log["frequency"] > top)
            if len(off) > 0.01 * len(log["time"]):
                raise InvalidInput(
                    f"{log.name}, line {off[0] + 2}, column frequency: {log['frequency'][off[0]]:.7g} Hz lies over "
                    f"1 % above the sweep's highest, {table.frequency[-1]:.7g} Hz; is the sweep that of another head?"
                )
    return said


def _machine(base: Machine, name: str, numbers: list[Number], logs: list[str]) -> Machine:
    tables: dict[str, dict[str, Any]] = {"head": {}, "axis": {}}
    for number in numbers:
        if not number.found:  # what a log does not tell stays as it was
            continue
        table, key = number.key.split(".")
        values = np.quantile(number.draws, (np.arange(QUANTILES) + 0.5) / QUANTILES)
        if number.key == "axis.dead_time":
            values = np.minimum(values, 0.02)
        tables[table][key] = Choice(choice=tuple(float(f"{v:.7g}") for v in values))
    if "dead_time" in tables["axis"]:
        tables["axis"]["latency"] = 0.0
    return replace(
        base,
        name=name,
        summary=f"identified from {', '.join(logs)}; like {base.name} where they say nothing",
        head=replace(base.head, **tables["head"]),
        axis=replace(base.axis, **tables["axis"]),
    )


def command(files: tuple[str, ...], out: str, like: str, overwrite: bool) -> tuple[Identified, list[Log]]:
    """What ``kerfgym identify`` does but for its page; what was found, and the logs."""
    target = Path(out)
    if target.suffix != ".toml":
        raise InvalidInput(f"-o takes a file such as mine.toml, not {out}")
    if target.exists() and not overwrite:
        raise InvalidInput(f"'{target}' exists; --overwrite replaces it")
    logs = [read(file) for file in files]
    found = identify(logs, names.of_file(target.stem), like)
    write_text(target, machine_text.text_of(found.machine, whole=False))
    if found.table is not None:
        calibration.write_csv(found.table, target.with_suffix(".table.csv"))
    print(f"{'':22s}{'median':>12s}   95 % interval")
    for number in found.numbers:
        low, middle, high = number.interval
        told = f"{low:.5g} to {high:.5g}" if number.found else "not excited: as before the logs"
        print(f"{number.key:22s}{middle:12.5g}   {told}")
    for line in strong(found.numbers):
        print(line)
    for note in found.notes:
        print(note)
    print(target)
    return found, logs


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
