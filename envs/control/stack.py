"""A controller's stack: the whole chain that a user tunes, trains and compares, under one declared parameter tree.

A stack fills a slot of the machine::

    z        gate → filter → look-up → law → supervisor limits      head velocity, 1 kHz
    xy       path planning → law                                    velocities of the axes, servo period
    process  feed of the plan → law                                 feed override, dither, focus, standoff, power, 8 ms

Its parameters are ``law.…`` and, by slot, ``gate.…``, ``filter.…``, ``table.…`` and ``guard.…``, or ``plan.…``, each
with unit, range, default and source (:class:`Quantity`). ``pid:law.kp=80,filter.hold=4`` is the stack ``pid`` with
two of them changed (:func:`resolve`). A :class:`Team` has one stack for each slot: ``z=pid,xy=wu,process=recipe``.
"""

import copy
import importlib
import importlib.util
import inspect
import re
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from typing_extensions import TypedDict  # as pydantic wants it below Python 3.12

from ..engine.quantity import InvalidInput, Quantity, checked, did_you_mean, quantities
from ..plant import calibration, filters, idle, planning, sensor, supervisor
from ..plant.controller import INFORMATION, SLOTS, Law, make_law, source_of
from ..plant.fleet import Fleet
from ..safety import consent, files, secrets
from .sources import FOLDERS, SHELVES, SOURCES

GROUPS: dict[str, dict[str, Any]] = {
    "z": {
        "gate": sensor.Gate,
        "filter": filters.Params,
        "table": calibration.Params,
        "guard": supervisor.Params,
    },
    "xy": {"plan": planning.Axes},
    "process": {"plan": planning.Feed},
}
"""Parameter groups of each slot; ``law`` comes from the stack's law."""

STANDARD = {"z": "observer", "xy": "wu-tuned", "process": "recipe"}
"""What fills the slots of a team that a user leaves open. Not ``pid``: tuned at cutting heights, it oscillates at the
heights of piercing, where its anti-impulse filter takes the sensor's noise for impulses."""


class PythonController(Protocol):
    """A user's controller in plain Python; it runs everywhere a compiled law does, only slower."""

    def reset(self) -> None:
        """Forgets the past episode."""

    def control(self, signals: Any) -> float:
        """Head velocity in mm/s, up positive, for the signals of this period (:class:`Sensed`)."""


class Pilot(Protocol):
    """What moves a hand of the machines besides the stack's law: a policy."""

    @property
    def program(self) -> list[str]:
        """Text that tells it from any other."""

    def install(self, fleet: Fleet) -> None:
        """Puts it into a fleet, for all its machines."""


@dataclass(frozen=True)
class Parameter:
    """One tunable number of a stack."""

    name: str
    value: float
    quantity: Quantity


@dataclass(frozen=True)
class Stack:
    """A controller, complete with filter and limits.

    ``values`` holds what differs from the parts' defaults, by dotted name; ``python`` makes a fresh plain-Python
    controller if the law is one.
    """

    name: str
    summary: str
    law: Law
    values: dict[str, Any] = field(default_factory=dict)
    python: Callable[[], PythonController] | None = None
    provenance: dict[str, Any] = field(default_factory=dict)
    source: str = ""  # text of a plain-Python controller's file
    pilot: Pilot | None = None
    companions: "dict[str, Stack]" = field(default_factory=dict)  # what it is used with in the other slots, by slot

    def __post_init__(self) -> None:
        for group in {name.split(".")[0] for name in self.values}:
            if group not in self._groups:
                raise InvalidInput(
                    f"controller '{self.name}': unknown group '{group}'; {did_you_mean(group, self._groups)}"
                )
        for group in self._groups:
            self.part(group)
        if self.slot == "z":
            filters.validated(self.part("filter"))

    @property
    def slot(self) -> str:
        """What the stack drives."""
        return self.law.slot

    @property
    def information(self) -> str:
        """Information class of its law: sensor, preview or privileged."""
        return self.law.information

    @property
    def _groups(self) -> dict[str, Any]:
        return {**GROUPS[self.slot], "law": self.law.Params}

    def part(self, group: str) -> Any:
        """Parameters of one group as its NamedTuple, checked."""
        mine = {n.split(".", 1)[1]: v for n, v in self.values.items() if n.split(".")[0] == group and "." in n}
        return checked(self._groups[group], mine, f"{group}.")

    def parameters(self) -> dict[str, Parameter]:
        """Every declared parameter by dotted name."""
        found = {}
        for group, cls in self._groups.items():
            values = self.part(group)
            for name, quantity in quantities(cls).items():
                found[f"{group}.{name}"] = Parameter(f"{group}.{name}", getattr(values, name), quantity)
        return found

    def varied(self, changes: dict[str, Any], name: str | None = None) -> "Stack":
        """The stack with some parameters changed.

        Raises:
            InvalidInput: unknown parameter (the nearest is offered), or value out of range.
        """
        if changes and self.sealed:
            raise InvalidInput(
                f"controller '{self.name}' is C; its settings are in its parameters.h, so {', '.join(changes)} cannot "
                "be changed here. Change what it was exported from"
            )
        known = self.parameters()
        for key in changes:
            if key not in known:
                raise InvalidInput(f"controller '{self.name}': unknown parameter '{key}'; {did_you_mean(key, known)}")
        return replace(self, values={**self.values, **changes}, name=name or self.name)

    @property
    def sealed(self) -> bool:
        """Whether filter, law and supervisor are code of their own (:mod:`exported`): nothing here changes them, times
        them or sees into them."""
        return bool(getattr(self.pilot, "sealed", False))

    @property
    def program(self) -> list[str]:
        """Text of the files that hold its law."""
        return [self.law.source, self.source, *(self.pilot.program if self.pilot else [])]

    def install(self, fleet: Fleet, machines: Any) -> None:
        """Writes the stack's parameters into the columns of ``machines``; the fleet must run the stack's law."""
        if self.slot != "z":
            assert fleet.gantries
            fleet.gantries.put_law(self.slot, machines, self.part("law"))
        else:
            fleet.put("gate", machines, self.part("gate"))
            fleet.put("table", machines, self.part("table"))
            fleet.put("guard", machines, self.part("guard"))
            fleet.put_filter(machines, self.part("filter"))
            fleet.put_law(machines, self.part("law"))
        if self.pilot:
            self.pilot.install(fleet)


def python_stack(make: Callable[[], PythonController], name: str, summary: str = "") -> Stack:
    """A stack whose law is a plain-Python controller; its filter is the default one."""
    return Stack(name, summary, make_law(idle, "idle"), python=make)


# ------------------------------------------------------------------------------------------------------ registry

_stacks: dict[str, Stack | Callable[[], Stack]] = {}


def register(name: str, stack: Stack | Callable[[], Stack]) -> None:
    """Makes a stack known by name; a function is called when it is first asked for."""
    _stacks[name] = stack


register("idle", lambda: Stack("idle", "no law: the head stands still unless a hand moves it", make_law(idle, "idle")))


def _load_sources() -> None:
    for module in SOURCES:
        importlib.import_module(module)


def names() -> list[str]:
    """Names of all registered stacks."""
    _load_sources()
    return sorted(_stacks)


def get(name: str) -> Stack:
    """A registered stack.

    Raises:
        InvalidInput: unknown name; the nearest is offered.
    """
    _load_sources()
    if name not in _stacks:
        raise InvalidInput(
            f"unknown controller '{name}'; {did_you_mean(name, [*sorted(_stacks), *shelved()])}, "
            "or module:attr of your own"
        )
    entry = _stacks[name]
    if not isinstance(entry, Stack):
        entry = _stacks[name] = entry()
    return entry


def shelved() -> dict[str, Path]:
    """Folders of the shipped policies by name."""
    return {p.name: p for shelf in SHELVES if shelf.is_dir() for p in sorted(shelf.iterdir()) if p.is_dir()}


def resolve(spec: "str | Stack") -> Stack:
    """A stack from what a user writes.

    ``pid`` · ``pid:law.kp=80,filter.hold=4`` · ``z=pid`` · ``runs/x/tuned.toml`` · ``runs/ppo/policy``, a policy's
    folder · ``height-following-ppo``, a shipped policy · ``package.module:attr`` · ``file.py:attr``, the last two also
    with overrides behind a second colon.

    Raises:
        InvalidInput: unknown name, slot, module, attribute, parameter, or value out of range.
    """
    if isinstance(spec, Stack):
        return spec
    prefixed = re.match(r"([A-Za-z_]\w*)=(.*)", spec)
    slot, rest = prefixed.groups() if prefixed else (None, spec)
    if slot is not None and slot not in SLOTS:
        raise InvalidInput(f"'{spec}': no slot '{slot}' in this machine; {did_you_mean(slot, SLOTS)}")
    pieces = rest.split(":")
    if len(pieces) > 1 and "=" not in pieces[1]:
        stack, overrides = _import(pieces[0], pieces[1]), pieces[2:]
    elif pieces[0].endswith(".toml"):
        stack, overrides = _tuned_stack(pieces[0]), pieces[1:]
    else:
        stack, overrides = _of_folder(pieces[0]) or get(pieces[0]), pieces[1:]
    if len(overrides) > 1:
        raise InvalidInput(f"'{spec}': overrides are separated by commas, as in pid:law.kp=80,filter.hold=4")
    if slot is not None and stack.slot != slot:
        raise InvalidInput(f"'{spec}': controller '{stack.name}' drives slot '{stack.slot}', not '{slot}'")
    if not overrides:
        return stack
    varied = stack.varied(_overrides(overrides[0], spec), name=f"{stack.name}:{overrides[0]}")
    return replace(varied, provenance={**stack.provenance, "edited": overrides[0]})


@dataclass(frozen=True)
class Team:
    """What controls a machine: ``stacks``, one for each slot, in the order of the slots.

    A machine that does jobs has all slots, one that follows the sheet has ``z`` alone.
    """

    name: str
    stacks: tuple[Stack, ...]

    def __getitem__(self, slot: str) -> Stack:
        """The stack in a slot.

        Raises:
            InvalidInput: there is none.
        """
        for stack in self.stacks:
            if stack.slot == slot:
                return stack
        raise InvalidInput(f"controller '{self.name}' drives slot '{self.slots}', not '{slot}'")

    @property
    def z(self) -> Stack:
        """The stack that follows the height."""
        return self["z"]

    @property
    def xy(self) -> Stack:
        """The stack that moves the axes."""
        return self["xy"]

    @property
    def process(self) -> Stack:
        """The stack that sets the process."""
        return self["process"]

    @property
    def slots(self) -> str:
        """Its slots in words: ``z, xy and process``."""
        return " and ".join(", ".join(s.slot for s in self.stacks).rsplit(", ", 1))

    def having(self, *stacks: Stack) -> "Team":
        """The team with these stacks in their slots."""
        found = {stack.slot: stack for stack in (*self.stacks, *stacks)}
        return replace(self, stacks=tuple(found[slot] for slot in SLOTS if slot in found))

    @property
    def full(self) -> "Team":
        """The team with all slots: open ones are filled by companions of its stacks, or :data:`STANDARD`."""
        mates = {slot: mate for stack in self.stacks for slot, mate in stack.companions.items()}
        usual = (mates.get(slot) or get(name) for slot, name in STANDARD.items())
        return replace(self, stacks=()).having(*usual, *self.stacks)

    @property
    def information(self) -> str:
        """The most that one of its laws knows."""
        return max((s.information for s in self.stacks), key=list(INFORMATION).index)

    @property
    def summary(self) -> str:
        """What is in it."""
        return ", ".join(f"{s.slot}={s.name}" for s in self.stacks)

    def _prefix(self, stack: Stack) -> str:
        return f"{stack.slot}." if len(self.stacks) > 1 else ""

    def parameters(self) -> dict[str, Parameter]:
        """Every declared parameter; in a team of several stacks the slot precedes its name: ``z.law.kp``."""
        return {self._prefix(s) + name: p for s in self.stacks for name, p in s.parameters().items()}

    def varied(self, changes: dict[str, Any], name: str | None = None) -> "Team":
        """The team with some parameters changed, named as :meth:`parameters` names them.

        Raises:
            InvalidInput: unknown parameter (the nearest is offered), or value out of range.
        """
        known = self.parameters()
        for key in changes:
            if key not in known:
                raise InvalidInput(f"controller '{self.name}': unknown parameter '{key}'; {did_you_mean(key, known)}")
        stacks = []
        for stack in self.stacks:
            own = self._prefix(stack)
            stacks.append(stack.varied({k.removeprefix(own): v for k, v in changes.items() if k.startswith(own)}))
        return replace(self, name=name or self.name, stacks=tuple(stacks))

    @property
    def program(self) -> list[str]:
        """Text of the files that hold its laws."""
        return [text for stack in self.stacks for text in stack.program]

    @property
    def provenance(self) -> dict[str, Any]:
        """How its stacks were tuned, by slot if there are several."""
        if len(self.stacks) == 1:
            return self.stacks[0].provenance
        return {stack.slot: stack.provenance for stack in self.stacks if stack.provenance}

    def install(self, fleet: Fleet, machines: Any) -> None:
        """Writes the parameters of all stacks into the columns of ``machines``."""
        for stack in self.stacks:
            stack.install(fleet, machines)


def asked(spec: "str | Stack | Team") -> Team:
    """The team that a user's words name, no more: ``pid`` has the slot ``z`` alone, ``z=pid,xy=wu`` two.

    Raises:
        InvalidInput: as :func:`resolve`, or a slot is given twice.
    """
    if isinstance(spec, Team):
        return spec
    if isinstance(spec, Stack):
        return Team(spec.name, (spec,))
    if spec.endswith(".toml") and "=" not in spec:
        base, changes, provenance = tuned(spec)
        if is_team(base):
            varied, slots = team(base).varied(changes, name=spec), {key.split(".")[0] for key in changes}
            return varied.having(*(replace(s, provenance=provenance) for s in varied.stacks if s.slot in slots))
    merged: list[str] = []
    for part in spec.split(","):  # overrides of the stack before have commas too: xy=wu:law.kp=1,plan.corners=0
        if merged and part.split("=")[0] not in SLOTS:
            merged[-1] += "," + part
        else:
            merged.append(part)
    stacks = [resolve(part) for part in merged]
    for stack in stacks:
        if [s.slot for s in stacks].count(stack.slot) > 1:
            raise InvalidInput(f"'{spec}': slot '{stack.slot}' is given twice")
    return Team(spec if len(stacks) > 1 else stacks[0].name, ()).having(*stacks)


def team(spec: "str | Stack | Team") -> Team:
    """The team that does jobs, from what a user writes: :func:`asked` with all slots.

    Raises:
        InvalidInput: as :func:`asked`.
    """
    found = asked(spec).full
    return replace(found, name=spec) if isinstance(spec, str) else found


def is_team(spec: str) -> bool:
    """Whether a user's words name several slots: ``z=pid,xy=wu``, or a ``tuned.toml`` of such."""
    if spec.endswith(".toml") and "=" not in spec:
        spec = tuned(spec)[0]
    return len([part for part in spec.split(",") if part.split("=")[0] in SLOTS]) > 1


class _Tuned(TypedDict, total=False):
    controller: str
    parameters: dict[str, float | str]


def tuned(path: str) -> tuple[str, dict[str, Any], dict[str, Any]]:
    """What a ``tuned.toml`` holds: the controller it started from, the parameters that differ, how they were found.

    Raises:
        InvalidInput: no such file, not TOML, not what ``kerfgym tune`` writes, or it names Python code and the user
            has not agreed to run it (:mod:`consent`).
    """
    data = files.toml(path)
    base, parameters = data.get("controller"), data.get("parameters")
    if not isinstance(base, str) or not isinstance(parameters, dict) or base.endswith(".toml"):
        raise InvalidInput(f"{path}: not a tuned controller; it needs 'controller', a name, and a table [parameters]")
    files.fitting(_Tuned, data, path)
    consent.required(base, f"{path}: controller")
    return base, parameters, recorded(data.get("provenance", {}), f"{path}: provenance")


MOST_SPENT = 1e18
"""Steps, trials or seconds of a search; what is more was never spent."""


def recorded(record: Any, where: str) -> dict[str, Any]:
    """The record of how a stack was tuned, as a file or a user's class gives it, without passwords; empty if there is
    none.

    Raises:
        InvalidInput: it is no table, its trials, steps or CPU-seconds are no numbers from 0 on, or its seeds no seeds.
    """
    if not isinstance(record, dict):
        raise InvalidInput(f"{where}: {files.shown(record)} is no table such as {{'trials': 40, 'tune_seeds': '0-31'}}")
    for key in ("trials", "simulated_steps", "steps", "training_steps", "cpu_seconds"):
        value = record.get(key, 0)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= MOST_SPENT:
            raise InvalidInput(f"{where}: {key} is {files.shown(value)}; allowed: a number from 0 to {MOST_SPENT:g}")
    for key in ("seeds", "tune_seeds", "checked_on"):
        _check_seeds(record.get(key, ""), f"{where}: {key}")
    for key in ("policy", "ledger", "start", *SLOTS):
        if key in record:
            recorded(record[key], f"{where}.{key}")
    found: dict[str, Any] = secrets.everywhere(record)
    return found


def _check_seeds(seeds: Any, where: str) -> None:
    """Raises :class:`InvalidInput` unless it is text such as ``0-31``, whole numbers, or a table of such."""
    for each in seeds.values() if isinstance(seeds, dict) else [seeds]:
        whole = [each] if isinstance(each, int) else each if isinstance(each, list | tuple) else []
        if not isinstance(each, str | int | list | tuple) or not all(isinstance(n, int) and n >= 0 for n in whole):
            allowed = "text such as '0-31', or whole numbers from 0 on"
            raise InvalidInput(f"{where} is {files.shown(each)}; allowed: {allowed}")


def _tuned_stack(path: str) -> Stack:
    base, parameters, provenance = tuned(path)
    if is_team(base):
        raise InvalidInput(f"'{path}' is a team ({base}); it does jobs, such as those of the suite cutting")
    try:
        with _within(path):
            return replace(resolve(base).varied(parameters, name=path), provenance=provenance)
    except InvalidInput as error:
        raise InvalidInput(f"{path}: {error}") from None


_READING: ContextVar[tuple[str, ...]] = ContextVar("reading", default=())
"""Files that are being resolved, each of which named the next."""


@contextmanager
def _within(path: str) -> Iterator[None]:
    """Guards against a file that names itself, or one that names it."""
    mine = str(Path(path).resolve())
    if mine in _READING.get():
        raise InvalidInput(f"'{path}' names itself as the controller it started from")
    before = _READING.set((*_READING.get(), mine))
    try:
        yield
    finally:
        _READING.reset(before)


def _overrides(text: str, spec: str) -> dict[str, Any]:
    changes: dict[str, Any] = {}
    for item in text.split(","):
        key, equals, value = item.partition("=")
        if not equals:
            raise InvalidInput(f"'{spec}': '{item}' is not of the form parameter=value")
        try:
            changes[key.strip()] = float(value)
        except ValueError:
            changes[key.strip()] = value.strip()
    return changes


def _of_folder(text: str) -> Stack | None:
    """The stack that a folder holds; None if it is a controller's name."""
    folder = shelved().get(text) or Path(text)
    if not text or text in names() or not files.is_folder(folder):
        return None
    for loader in FOLDERS:
        module, function = loader.split(":")
        stack = getattr(importlib.import_module(module), function)(folder)
        if stack is not None:
            return replace(stack, name=text)
    raise InvalidInput(f"folder '{text}' holds no policy: it has no policy.json")


def _import(module: str, attribute: str) -> Stack:
    """A user's controller: a Stack, a law namespace, or a plain-Python class."""
    if not module or not attribute:
        raise InvalidInput(
            f"'{module}:{attribute}': nothing stands {'after' if module else 'before'} the colon; "
            "a controller of your own is file.py:Class or module:Class, changed parameters are pid:law.kp=80"
        )
    file = Path(module) if module.endswith(".py") else None
    if module.startswith("."):
        raise InvalidInput(f"'{module}' is no module's name; a file is named with its suffix: mine.py:Mine")
    try:
        if file is not None:
            space = _import_file(file)
        else:
            if "" not in sys.path:
                # The user's own folder, last: what lies in it must not take the place of a library that is imported
                # later.
                sys.path.append("")
            space = importlib.import_module(module)
    except InvalidInput:
        raise
    except ModuleNotFoundError as error:
        raise InvalidInput(f"cannot import '{module}': {error}") from None
    except Exception as error:  # whatever a user's code raises is the user's to mend, and none of it is ours
        raise InvalidInput(f"cannot import '{module}': {_told(error, file)}") from None
    if not hasattr(space, attribute):
        public = [n for n in vars(space) if not n.startswith("_")]
        raise InvalidInput(f"module '{module}' has no '{attribute}'; {did_you_mean(attribute, public)}")
    return as_stack(getattr(space, attribute), f"{Path(module).stem}:{attribute}")


def _told(error: Exception, file: Path | None) -> str:
    """What a user's code raised, and where in it."""
    if isinstance(error, SyntaxError):
        return f"{error.filename or file}, line {error.lineno}: {error.msg}"
    frames = [f for f in traceback.extract_tb(error.__traceback__) if "importlib" not in f.filename]
    own = [f for f in frames if file is not None and Path(f.filename) == file]
    at = (own or frames)[-1]
    return f"{at.filename}, line {at.lineno}: {type(error).__name__}: {error}"


def _import_file(path: Path) -> Any:
    if not files.exists(path):
        raise InvalidInput(f"no file '{path}'")
    files.checked(path, files.SETTINGS)
    spec = importlib.util.spec_from_file_location(f"kerfgym_user_{path.stem}", path)
    assert spec
    assert spec.loader
    space = importlib.util.module_from_spec(spec)
    # Under a name of its own: a user's json.py must not take the place of the library's.
    sys.modules[spec.name] = space
    try:
        spec.loader.exec_module(space)
    except BaseException:
        del sys.modules[spec.name]
        raise
    return space


def as_stack(thing: Any, name: str) -> Stack:
    """A stack from a user's object: a :class:`Stack`, a compiled law's namespace, or a plain-Python controller class.

    ``TUNING`` of the object is its provenance: ``{"trials": 0}``, or trials, steps and seeds of a search.

    Raises:
        InvalidInput: it is none of these; the message says what is missing.
    """
    if isinstance(thing, Stack):
        return thing
    provenance = recorded(getattr(thing, "TUNING", {}), f"'{name}': TUNING")
    if hasattr(thing, "control") and hasattr(thing, "reset"):
        doc = (inspect.getdoc(thing) or "").split("\n")[0]
        make = thing if isinstance(thing, type) else lambda: copy.deepcopy(thing)
        return replace(
            python_stack(make, name, doc),
            provenance=provenance,
            source=source_of(thing if isinstance(thing, type) else type(thing)),
        )
    if hasattr(thing, "control") or hasattr(thing, "Params"):
        law = make_law(thing, name, getattr(thing, "INFORMATION", "sensor"), getattr(thing, "SLOT", "z"))
        return Stack(name, law.summary, law, dict(getattr(thing, "DEFAULTS", {})), provenance=provenance)
    raise InvalidInput(
        f"'{name}' is not a controller: it needs reset() and control(signals), or Params, State, init and control"
    )
