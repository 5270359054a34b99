"""The machine as a file of its own: what cuts, whatever is cut.

A machine has sensor, Z axis, X and Y axes and optics; each number is a value or a distribution, as in a scenario. Its
file has the tables ``[head]``, ``[axis]``, ``[gantry]`` and ``[optics]``, and what it leaves out is the standard
machine's. :func:`load` reads one, by name or from a file; :func:`put_on` puts a scenario on it.
"""

# ruff: noqa: RUF009  (sections that are defaults are frozen)

import difflib
import hashlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from ..engine.quantity import InvalidInput, did_you_mean
from ..safety import files, names
from .distributions import check_joint, middle
from .hardware import DISTURBANCES, Axis, Gantry, Head, Optics
from .measured import measured_head
from .schema import STANDARD_MACHINE, Scenario
from .section import Section, line_of, of_table
from .writing import without_none

_FOLDER = Path(__file__).parents[1] / "machines"

TABLES = ("head", "axis", "gantry", "optics")
"""Tables of a machine; a scenario has tables of the same names."""


@dataclass(frozen=True, kw_only=True)
class Machine(Section):
    """What cuts."""

    name: str  # in tables and plots
    summary: str = ""  # what it is, in a line
    head: Head = Head()
    axis: Axis = Axis()
    gantry: Gantry = Gantry()
    optics: Optics = Optics()

    def __post_init__(self) -> None:
        super().__post_init__()
        names.checked(self.name, "name")
        check_joint(*(getattr(self, table) for table in TABLES))
        if self.head.signal:
            raise ValueError("head.signal is a recording; it belongs to a scenario, not to a machine")

    @property
    def tables(self) -> dict[str, Any]:
        """Every number that it has, as TOML has it."""
        found: dict[str, Any] = without_none(asdict(self))
        return found

    @property
    def digest(self) -> str:
        """What tells its numbers, and its measured table, from any other's."""
        said = {name: self.tables[name] for name in TABLES}
        if table := self.head.table:
            said["head"] = {**said["head"], "table": hashlib.sha256(files.data(table, files.TABLE)).hexdigest()}
        return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()[:12]

    @property
    def record(self) -> dict[str, str]:
        """What results, presets and policies say of it."""
        return {"name": self.name, "summary": self.summary, "digest": self.digest}


STANDARD = Machine(name=STANDARD_MACHINE)
"""The machine of a scenario that says nothing about it."""


def presets() -> list[str]:
    """Names of the machines that are shipped."""
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def load(given: Any) -> Machine:
    """A machine by name, from a TOML file, from the tables of one, or as it is.

    Raises:
        InvalidInput: neither a known name (the nearest is offered) nor a readable file, or file, line and key of the
            first mistake.
    """
    if isinstance(given, Machine):
        return given
    if isinstance(given, dict):
        return of_tables(given, "machine")
    if not isinstance(given, str | Path):
        allowed = f"one of {', '.join(presets())}, a file, or a machine's tables"
        raise InvalidInput(f"machine = {files.shown(given)} is not allowed; allowed: {allowed}")
    if str(given) in presets():
        return read(_FOLDER / f"{given}.toml")
    meant = "" if files.is_file(given) else _file_meant(given)
    if meant:
        raise InvalidInput(
            f"no machine '{given}'; did you mean the file '{meant}'? (known: {', '.join(presets())}, or a path to a "
            "TOML file)"
        )
    if str(given).endswith(".toml") or files.is_file(given):
        return read(given)
    raise InvalidInput(f"unknown machine '{given}'; {did_you_mean(str(given), presets())}, or a path to a TOML file")


def _file_meant(given: str | Path) -> str:
    """The TOML file that is called nearly so, where one was looked for; empty if none is near, or a preset nearer."""
    place, stem = Path(given).parent, Path(given).stem
    try:
        beside = [found.stem for found in place.glob("*.toml")]
    except (OSError, ValueError):  # no such folder, or no name of one
        return ""
    near = difflib.get_close_matches(stem, [*presets(), *beside], n=1, cutoff=0.7)
    return str(place / f"{near[0]}.toml") if near and near[0] in beside else ""


def read(path: str | Path) -> Machine:
    """A machine from a TOML file; a table that it names is taken relative to it.

    Raises:
        InvalidInput: file, line and key of the first mistake.
    """
    text = files.text(path, files.SETTINGS)
    tables = files.toml_of(text, path)
    head = tables.get("head")
    if isinstance(head, dict) and isinstance(head.get("table"), str):
        head["table"] = str(Path(path).resolve().parent / head["table"])
    return of_tables({"name": names.of_file(Path(path).stem), **tables}, str(path), text)


def of_tables(tables: dict[str, Any], where: str, text: str = "") -> Machine:
    """A machine from tables.

    Args:
        tables: as TOML has them.
        where: what they come from, such as a file.
        text: their TOML, so that an error can name its line.

    Raises:
        InvalidInput: where, line and key of the first mistake, and what is allowed.
    """
    try:
        other = [key for key in tables if key in {f.name for f in fields(Scenario)} - {f.name for f in fields(Machine)}]
        if other:
            raise InvalidInput(f"{other[0]} belongs to a scenario, not to a machine; a machine has {', '.join(TABLES)}")
        _misplaced(tables)
        machine = of_table(Machine, tables)
        if machine.head.table:
            measured_head(machine.head.table)  # a bad file is an error now
        return machine
    except InvalidInput as error:
        raise InvalidInput(f"{where}{line_of(text, str(error))}: {error}") from None


def _misplaced(tables: dict[str, Any]) -> None:
    """Refuses a number that stands outside of its table, or in another's, and says where it belongs."""
    names_in = {table: {f.name for f in fields(getattr(STANDARD, table))} for table in TABLES}
    places = {"": (tables, {f.name for f in fields(Machine)})}
    places |= {f"{t}.": (tables[t], names_in[t]) for t in TABLES if isinstance(tables.get(t), dict)}
    for place, (found, own) in places.items():
        for key in found:
            homes = [f"'{table}.{key}'" for table in TABLES if key in names_in[table]]
            if key not in own and homes:
                raise InvalidInput(f"unknown key '{place}{key}'; did you mean {' or '.join(homes)}?")


# ------------------------------------------------------------------------------------------- scenarios on a machine


def differences(of: Any, than: Any) -> dict[str, Any]:
    """What tables of a machine or scenario say otherwise than those of another, by dotted name."""
    return {
        f"{table}.{field.name}": getattr(getattr(of, table), field.name)
        for table in TABLES
        for field in fields(getattr(of, table))
        if getattr(getattr(of, table), field.name) != getattr(getattr(than, table), field.name)
    }


def put_on(scenario: Scenario, machine: Machine) -> Scenario:
    """The scenario, cut by this machine.

    All that the scenario says of a machine gives way, but for :data:`hardware.DISTURBANCES`, which it is about;
    :func:`given_up` tells what that was.

    Raises:
        InvalidInput: it cannot be cut by it, and why.
    """
    used = TABLES if scenario.job else TABLES[:2]
    own = {key.split(".")[1]: value for key, value in differences(scenario, STANDARD).items() if _happens(key)}
    changes = {name: getattr(machine, name) for name in used}
    changes["head"] = Head(**{f.name: getattr(machine.head, f.name) for f in fields(Head)} | own)
    try:
        return _replaced(scenario, {**changes, "cut_by": machine.name})
    except ValueError as error:
        raise InvalidInput(f"scenario '{scenario.name}' on machine '{machine.name}': {error}") from None


def _happens(key: str) -> bool:
    table, _, name = key.partition(".")
    return table == "head" and name in DISTURBANCES


def _replaced(scenario: Scenario, changes: dict[str, Any]) -> Scenario:
    said = {f.name: getattr(scenario, f.name) for f in fields(scenario)}
    return Scenario(**{**said, **changes})


def given_up(scenario: Scenario, machine: Machine) -> list[str]:
    """What the scenario says of a machine and this one has otherwise, by dotted name."""
    own, put = differences(scenario, STANDARD), put_on(scenario, machine)
    used = TABLES if scenario.job else TABLES[:2]
    return [k for k in own if k.split(".")[0] in used and _of(put, k) != own[k] and not _happens(k)]


def _of(where: Any, key: str) -> Any:
    table, name = key.split(".")
    return getattr(getattr(where, table), name)


def warnings(chosen: Iterable[Scenario], machine: Machine) -> list[str]:
    """What a user should know who puts scenarios on a machine: which of them were about another one."""
    by_keys: dict[str, list[str]] = {}
    for scenario in chosen:
        if keys := given_up(scenario, machine):
            by_keys.setdefault(", ".join(keys), []).append(scenario.name)
    return [
        f"machine '{machine.name}' replaces what {', '.join(dict.fromkeys(given))} "
        f"{'says' if len(given) == 1 else 'say'} of {keys}"
        for keys, given in by_keys.items()
    ]


def doubts(machine: Machine) -> Iterator[str]:
    """What of a machine is possible and yet hardly meant, in sentences."""
    axis = machine.axis
    late = 1e3 * (middle(axis.dead_time) + middle(axis.latency))
    period = 1e3 / middle(axis.bandwidth)
    if late > 6.0:
        yield (
            f"dead time and latency are {late:.3g} ms: gradients (train gradient) stop at 6 ms, and margins of the "
            "shipped controllers were not tuned for it"
        )
    if late > period:
        yield f"dead time and latency of {late:.3g} ms are longer than 1/bandwidth of the drive, {period:.3g} ms"
    if middle(axis.resonance) < middle(axis.bandwidth):
        yield "the structural resonance lies below the velocity loop's bandwidth; such a loop could hardly be tuned"
    if machine.head.table and machine.head.geometry:
        yield "head.table replaces the calibration of the nozzle and oscillator that are given beside it"
