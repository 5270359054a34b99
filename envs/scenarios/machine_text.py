"""A machine's file as it is written: every key, its unit and its range beside it."""

import inspect
import json
import re
from dataclasses import fields
from typing import Any, get_args

from ..engine.quantity import Quantity
from .distributions import Choice, Joint, LogUniform, Uniform
from .machines import STANDARD, TABLES, Machine
from .preparing import axes_of, family_member

HEAD = """\
# A machine: what cuts, whatever is cut. Every number may be drawn anew for each seed:
#   {{ uniform = [50, 120] }}, {{ log_uniform = [5e-4, 5e-3] }} or {{ choice = [0.001, 0.002] }}
# What is left out is the standard machine's. Check it: kerfgym machine check FILE. Use it: --machine FILE.
"""

WIDTH = 44
"""Column at which comments begin, where the value leaves room."""


def text_of(machine: Machine, whole: bool = True) -> str:
    """The file of a machine, which reads back to an equal one.

    Args:
        machine: of which it is.
        whole: every key; else those that differ from the standard machine's.
    """
    lines = [HEAD.format(), f"name = {json.dumps(machine.name, ensure_ascii=False)}"]
    lines += [f"summary = {json.dumps(machine.summary, ensure_ascii=False)}"]
    for table in TABLES:
        section, usual = getattr(machine, table), getattr(STANDARD, table)
        keys = [f.name for f in fields(section) if whole or getattr(section, f.name) != getattr(usual, f.name)]
        keys = [key for key in keys if key != "signal"]
        if keys:
            lines += ["", f"[{table}]  # {_about(section)}", *(_line(machine, table, key) for key in keys)]
    return "\n".join(lines) + "\n"


def _about(section: Any) -> str:
    return (
        re.sub(r" \(docs/.*?\)|``|;.*$", "", (type(section).__doc__ or "").split("\n")[0])
        .split(", see ")[0]
        .rstrip(".")
    )


def _line(machine: Machine, table: str, key: str) -> str:
    section = getattr(machine, table)
    value, meaning = getattr(section, key), explained(type(section), key)
    if value is None:
        usual = _usual(machine, table, key)
        return f"# {key} = {usual}".ljust(WIDTH) + f"  # {meaning}"
    return f"{key} = {written(value)}".ljust(WIDTH) + f"  # {meaning}"


def explained(section: type, key: str) -> str:
    """Unit, meaning and range of a key."""
    kind = inspect.get_annotations(section, eval_str=True)[key]
    inner = next((each for each in get_args(kind) if get_args(each) and type(None) in get_args(kind)), kind)
    quantity = next((each for each in get_args(inner) if isinstance(each, Quantity)), None)
    if quantity:
        return f"{quantity.unit}, {quantity.doc or key}; {quantity.range}".replace("1, ", "", quantity.unit == "1")
    note = re.search(rf"^    {key}: .*?  # (.*)$", inspect.getsource(section), re.MULTILINE)
    return note.group(1) if note else ""


def written(value: Any) -> str:
    """A value as TOML has it."""
    if isinstance(value, Choice):
        joint = f", joint = {json.dumps(value.joint)}" if isinstance(value, Joint) else ""
        return f"{{ choice = [{', '.join(map(written, value.choice))}]{joint} }}"
    if isinstance(value, Uniform | LogUniform):
        sign = ', sign = "±"' if value.sign == "±" else ""
        return f"{{ {value.key} = [{', '.join(map(written, value.ends))}]{sign} }}"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, bool):
        return str(value).lower()
    return repr(int(value)) if value == int(value) and abs(value) < 1e9 else repr(float(value))


def _usual(machine: Machine, table: str, key: str) -> str:
    """What holds where a key is left out."""
    if table == "gantry":
        return written(round(getattr(axes_of(machine.gantry), key), 4))
    if key == "table":
        return '"my_calibration.csv"'
    return written(round(family_member(machine.head, key), 4))
