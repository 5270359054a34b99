"""What ``kerfgym machine`` does: list, new, draw, show, check."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from ...agents.settings import parsed
from ...envs.engine.quantity import InvalidInput, did_you_mean
from ...envs.safety import names
from ...envs.scenarios import machine_text, machines
from ...envs.scenarios.machines import STANDARD, Machine
from ..store.runs import write_text
from .fixed import fixed

Words = tuple[str, ...]


def new(what: Words, like: str, assignments: list[str], overwrite: bool, seed: int) -> None:
    """Writes a machine's file."""
    file, begin = _target(what, "new", overwrite), machines.load(like)
    tables = {**begin.tables, "name": names.of_file(file.stem)}
    tables["summary"] = f"begun as {begin.name}" + ("" if not assignments else ", but for what is listed below")
    for key, value in parsed(assignments, "axis.bandwidth=25").items():
        table, dot, name = key.partition(".")
        if not dot:
            tables[key] = value
        elif table in machines.TABLES:
            tables[table][name] = value
        else:
            raise InvalidInput(f"--set {key}: unknown table '{table}'; {did_you_mean(table, machines.TABLES)}")
    made = machines.of_tables(tables, "--set" if assignments else like)
    if assignments and made.summary.endswith("listed below"):
        told = [f"{key} {machine_text.written(v)}" for key, v in machines.differences(made, begin).items()]
        made = machines.of_tables({**tables, "summary": f"begun as {begin.name}, with {', '.join(told)}"}, str(file))
    write_text(file, machine_text.text_of(made))
    print(file)


def draw(what: Words, like: str, assignments: list[str], overwrite: bool, seed: int) -> None:
    """Writes the file of one machine that another with distributions draws."""
    if assignments:
        raise InvalidInput(f"draw takes no --set {assignments[0]}; new does")
    file = _target(what, "draw", overwrite)
    made = replace(fixed(machines.load(like), seed), name=names.of_file(file.stem))
    write_text(file, machine_text.text_of(made))
    print(file)


def list_(what: Words, like: str, assignments: list[str], overwrite: bool, seed: int) -> None:
    """Prints the presets, a line each."""
    for name in machines.presets():
        print(f"  {name:16s} {machines.load(name).summary}")


def show(what: Words, like: str, assignments: list[str], overwrite: bool, seed: int) -> None:
    """Prints machines: what differs from the standard one, and what is hardly meant."""
    for machine in map(machines.load, _some(what, "show")):
        _show(machine)


def check(what: Words, like: str, assignments: list[str], overwrite: bool, seed: int) -> None:
    """Prints what is wrong in machines' files, or else what is hardly meant."""
    for one in _some(what, "check"):
        machine = machines.load(one)
        doubts = list(machines.doubts(machine))
        print(f"{one}: machine '{machine.name}' ({machine.digest}) is good; {_said(machine)}")
        for doubt in doubts:
            print(f"  but {doubt}")


def _target(what: Words, action: str, overwrite: bool) -> Path:
    """The one file to write."""
    if len(what) != 1 or not what[0].endswith(".toml"):
        raise InvalidInput(f"{action} takes one file to write, such as mine.toml, not {' '.join(what) or 'nothing'}")
    file = Path(what[0])
    if file.exists() and not overwrite:
        raise InvalidInput(f"'{file}' exists; --overwrite replaces it")
    return file


def _some(what: Words, action: str) -> Words:
    if not what:
        raise InvalidInput(f"{action} takes machines: {', '.join(machines.presets())}, or files")
    return what


def _said(machine: Machine) -> str:
    """How much of it is its own."""
    count = len(machines.differences(machine, STANDARD))
    if count == 0:
        return "all numbers are the standard machine's"
    return f"{count} number{' is' if count == 1 else 's are'} not the standard machine's"


def _show(machine: Machine) -> None:
    if not machines.differences(machine, STANDARD):
        print(f"{machine.name} ({machine.digest}): {_said(machine)}")
    table = Table(title=f"{machine.name} ({machine.digest})", caption=machine.summary or None)
    for column in ("", machine.name, "standard", "unit, meaning, range"):
        table.add_column(column)
    for key, value in machines.differences(machine, STANDARD).items():
        section, _, name = key.partition(".")
        usual = getattr(getattr(STANDARD, section), name)
        shown = [machine_text.written(v) if v is not None else "–" for v in (value, usual)]
        table.add_row(key, *shown, machine_text.explained(type(getattr(machine, section)), name))
    if table.row_count:
        Console(width=max(Console().width, 120)).print(table)
    for doubt in machines.doubts(machine):
        print(f"but {doubt}")


Action = Callable[[Words, str, list[str], bool, int], None]

ACTIONS: dict[str, Action] = {"list": list_, "new": new, "draw": draw, "show": show, "check": check}
"""What the command can do."""


def unknown(action: str) -> Action:
    """What refuses an action that there is none of."""

    def refuse(*_: Any) -> None:
        raise InvalidInput(f"unknown action '{action}'; {did_you_mean(action, ACTIONS)}")

    return refuse
