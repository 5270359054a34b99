"""The files of C: what a controller is on a machine's own control."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...envs.control import firmware
from ...envs.control.stack import Stack
from ...envs.engine import lanes
from ...envs.engine.c99 import Unit
from ...envs.engine.c99.values import BOOL, Row, Struct, fields_of, literal
from ...envs.engine.c99.words import WIDTH, plain, safe
from ...envs.engine.quantity import InvalidInput, Quantity, quantities
from ...envs.plant import filters

FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror", "-O2", "-ffp-contract=off")
"""With which the code compiles without a warning. Contracted operations would give other bits than the simulator's."""


@dataclass(frozen=True)
class Code:
    """A controller in C.

    Attributes:
        header, source, parameters: text of ``controller.h``, ``controller.c`` and ``parameters.h``.
        unit: what they were made of.
        parts: the follower's parts.
    """

    header: str
    source: str
    parameters: str
    unit: Unit
    parts: firmware.Firmware


def of(stack: Stack, single: bool = False) -> Code:
    """The code of a height follower.

    Args:
        stack: of the slot z, without a policy.
        single: reals are ``float``; else ``double``.

    Raises:
        InvalidInput: a controller in plain Python or with a policy, of another slot, or a law of which something cannot
            be said in C, with file and line.
    """
    if stack.python is not None:
        raise InvalidInput(
            f"'{stack.name}' is plain Python; write it as a law of parts to have it in C (docs/export.md)"
        )
    if stack.pilot is not None:
        raise InvalidInput(f"'{stack.name}' has a policy; policies cannot be exported yet")
    law, unit = stack.law, Unit(single)
    parts = firmware.of(law)

    def struct(cls: Any) -> Struct:
        return Struct("struct", cls)

    rings = [Row("row", size) for size in (firmware.SAMPLES, firmware.HISTORY, firmware.HISTORY)]
    tables = [Row("row", firmware.POINTS, True)] * 2 + [Row("row", len(law.tables), True)]
    kinds = (struct(parts.Settings), struct(firmware.State), struct(law.State), struct(parts.Input), *rings, *tables)
    step = unit.function(parts.step, kinds + ((Row("row", law.memory),) if law.memory else ()))
    if len(law.tables):
        unit.table("LAW_TABLES", law.tables, law.name.rpartition(".")[2], "Tables of the law.")
    settings, state = unit.struct(parts.Settings), unit.struct(firmware.State)
    own, told = unit.struct(law.State), unit.struct(parts.Input)
    given = ["&c->settings", "&c->state", "&c->law", "input", "c->samples", "c->heights", "c->positions"]
    given += ["c->table_frequency", "c->table_height", "LAW_TABLES", "c->memory"]
    call = f"{step.name}(\n        {', '.join(given[i] for i in step.arguments)})".replace(
        ", c->samples", ",\n        c->samples"
    )
    words = {"real": unit.real, "settings": settings, "state": state, "law": own, "input": told, "name": stack.name}
    memory = f"    {unit.real} memory[{law.memory}]; /* of the law */\n" if law.memory else ""
    clears = (
        f"    for (int i = 0; i < {law.memory}; i++) {{\n        c->memory[i] = {literal(0.0, single).code};\n    }}\n"
    )
    sizes = {"samples": firmware.SAMPLES, "history": firmware.HISTORY, "points": firmware.POINTS}
    head = _HEADER.format(
        declarations=unit.declarations(), memory=memory, summary=plain(stack.summary), **sizes, **words
    )
    begun = {
        "begun": _values(unit, firmware.State, firmware.State()),
        "own": _values(unit, law.State, _first(law.State)),
    }
    body = _SOURCE.format(
        definitions=unit.definitions(),
        call=call,
        word=step.word,
        members=step.members,
        clears=clears if memory else "",
        **begun,
        **words,
    )
    return Code(head, body, _parameters(unit, stack, parts), unit, parts)


def _first(cls: Any) -> Any:
    """A part's numbers before anything has happened: those of its fields that say none are 0."""
    return lanes.unflat(cls, np.zeros(lanes.rows(cls)))


def _values(unit: Unit, cls: Any, value: Any) -> str:
    """A part's numbers as C writes them between braces."""
    inner = []
    for (name, kind), each in zip(fields_of(cls).items(), value, strict=True):
        if isinstance(kind, Struct):
            inner.append(f".{safe(name)} = {{{_values(unit, kind.cls, each)}}}")
        else:
            inner.append(f".{safe(name)} = {literal(bool(each) if kind == BOOL else float(each), unit.single).code}")
    text, lines = "", []
    for each in inner:
        if text and len(text) + len(each) > WIDTH - 12:
            lines.append(text)
            text = ""
        text += f"{', ' if text else ''}{each}"
    return ",\n        ".join([*lines, text])


def settings_of(stack: Stack, parts: firmware.Firmware) -> Any:
    """The stack's numbers as the follower's settings."""
    checked = filters.validated(stack.part("filter"))
    return parts.Settings(checked, *(stack.part(group) for group in ("table", "guard", "law")))


def _parameters(unit: Unit, stack: Stack, parts: firmware.Firmware) -> str:
    lines = [
        "/* What can be set. Ranges are those of the simulator. */",
        "#ifndef PARAMETERS_H",
        "#define PARAMETERS_H",
        "",
    ]
    lines += ['#include "controller.h"', "", f"static const {unit.struct(parts.Settings)} CONTROLLER_SETTINGS = {{"]
    for group, values in zip(parts.Settings._fields, settings_of(stack, parts), strict=True):
        about: dict[str, Quantity] = quantities(type(values))
        lines.append(f"    .{safe(group)} = {{")
        for name, value in zip(values._fields, values, strict=True):
            number = literal(float(value), unit.single).code
            q = about.get(name)
            note = ""
            if q:
                chosen = f"{q.choices[int(value)]}; " if q.choices else ""
                kinds = ", ".join(f"{i} {word}" for i, word in enumerate(q.choices))
                note = f" /* {plain(q.doc)}: {chosen}{kinds if kinds else q.range} */"
            lines.append(f"        .{safe(name)} = {number},{note}")
        if not values._fields:
            lines.append("        0,")
        lines.append("    },")
    return "\n".join([*lines, "};", "", "#endif", ""])


_HEADER = """\
/* {name}: {summary}.
 *
 * A capacitive height follower, called once a millisecond: from the newest count and the encoder to the
 * command of the Z drive. How it is called stands in README.md.
 */
#ifndef CONTROLLER_H
#define CONTROLLER_H

#include <stdbool.h>

{declarations}

/* A follower with all that it remembers. It needs no other memory. */
typedef struct {{
    {settings} settings; /* may be changed from call to call */
    {state} state;
    {law} law;
    {real} samples[{samples}]; /* Hz, counts, a ring */
    {real} heights[{history}]; /* mm, a ring */
    {real} positions[{history}]; /* mm, a ring */
{memory}    const {real} *table_frequency; /* Hz, ascending, {points} entries */
    const {real} *table_height; /* mm, {points} entries */
}} Controller;

/* Before the first call, and whenever following begins anew: settings as in parameters.h, nothing remembered.
 *
 * table_frequency, table_height: the head's calibration, {points} entries each, frequencies (Hz) ascending;
 * they are read, not copied.
 */
void controller_start(Controller *c, const {real} *table_frequency, const {real} *table_height);

/* Once a millisecond: the command that goes to the drive, mm/s, up positive. Defined for every input. */
{real} controller_step(Controller *c, const {input} *input);

#endif
"""

_SOURCE = """\
/* {name}, see controller.h. */
#include "controller.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "parameters.h"

{definitions}

void controller_start(Controller *c, const {real} *table_frequency, const {real} *table_height)
{{
    c->settings = CONTROLLER_SETTINGS;
    c->state = ({state}){{
        {begun}}};
    c->law = ({law}){{
        {own}}};
    c->table_frequency = table_frequency;
    c->table_height = table_height;
{clears}}}

{real} controller_step(Controller *c, const {input} *input)
{{
    const {word} now = {call};
    c->state = now.{members[0]};
    c->law = now.{members[1]};
    return now.{members[2]};
}}
"""
