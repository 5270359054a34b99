"""Software in the loop: an exported folder as a controller. Its C decides inside the simulator.

The folder's C is compiled here, with a few lines around it that know where a number lies in a block of machines, and
runs as a stage between supervisor and drive: from the count and the encoder of a period it makes the command that goes
to the drive. What the machine's own supervisor would say gives way to the exported one's, whose state takes its place.
A library that was not built here is never loaded.
"""

import ctypes
import functools
import hashlib
import json
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ..engine.c99.words import safe
from ..engine.deck import Deck
from ..engine.kernels import cache_folder
from ..engine.lanes import W, fields
from ..engine.quantity import InvalidInput
from ..plant import idle, machine, supervisor, z_axis
from ..plant.controller import Privileged, make_law
from ..plant.fleet import Fleet
from ..safety import consent, files
from . import firmware
from .stack import Stack

MANIFEST = consent.EXPORTED
"""What a folder says of itself."""

SOURCES = ("controller.c", "controller.h", "parameters.h")

FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared")
"""As the kernel computes: no contracted operations."""

COMPILERS = ("cc", "gcc", "clang")

_LARGEST = 1 << 22
"""Bytes of a file of C."""


class Io(NamedTuple):
    """What the stage is given."""

    controllers: int  # array of bytes, (machines, size)
    frequencies: int  # arrays of the reals of the C code, of all heads
    heights: int


@dataclass(frozen=True)
class Exported:
    """The pilot of an exported folder.

    Attributes:
        folder: it.
        library: compiled of it.
        text: its C.
        single: whether its reals are ``float``.
    """

    folder: str
    library: str
    text: str
    single: bool
    sealed: ClassVar[bool] = True  # see :attr:`Stack.sealed`

    @property
    def program(self) -> list[str]:
        """Text that tells it from any other."""
        return [self.text]

    def install(self, fleet: Fleet) -> None:
        """Puts it between supervisor and drive of all machines of a fleet."""
        stage, size = _loaded(self.library)
        kind = np.float32 if self.single else np.float64
        tables = {name: fleet.deck.owned(name).astype(kind, copy=False) for name in ("frequencies", "heights")}
        fleet.after_supervisor(stage, Deck(Io, controllers=np.zeros(fleet.blocks * W * size, np.uint8), **tables))


@functools.cache
def _loaded(library: str) -> tuple[int, int]:
    """Address of the stage of a library that was built here, and the bytes of a controller; it stays loaded."""
    code = ctypes.CDLL(library)
    stage = ctypes.cast(code.exported_stage, ctypes.c_void_p).value
    assert stage
    _KEPT.append(code)
    return stage, int(ctypes.c_uint64.in_dll(code, "exported_size").value)


_KEPT: list[ctypes.CDLL] = []
"""Libraries whose code machines may run."""


def stack_of(folder: Path) -> Stack | None:
    """The controller that an exported folder holds; None if it is not one.

    Raises:
        InvalidInput: its manifest cannot be read, something is missing, or its C does not compile.
    """
    path = folder / MANIFEST
    if not files.is_file(path):
        return None
    about = files.json_(path)
    wanted = {"controller", "real", "parameters", "information"}
    if not isinstance(about, dict) or not wanted <= set(about):
        raise InvalidInput(
            f"'{path}' is not the record of an export; it lacks {', '.join(sorted(wanted - set(about)))}"
        )
    if about["real"] not in ("double", "float") or about["information"] not in firmware.INPUTS:
        raise InvalidInput(f"'{path}': real is double or float, information one of {', '.join(firmware.INPUTS)}")
    texts = {name: files.text(folder / name, _LARGEST) for name in SOURCES}
    single = about["real"] == "float"
    shim = _shim(about["information"], single)
    library = _built(folder, {**texts, "exported.c": shim})
    values = {str(name): value for name, value in dict(about["parameters"]).items() if not str(name).startswith("law.")}
    pilot = Exported(str(folder), str(library), "".join(texts.values()), single)
    law = make_law(idle, "idle", about["information"])
    summary = f"{about['controller']} as C, {about['real']}"
    return Stack(str(folder), summary, law, values, provenance=dict(about.get("provenance", {})), pilot=pilot)


def compiler() -> str:
    """A C compiler.

    Raises:
        InvalidInput: there is none.
    """
    found = next((path for name in COMPILERS if (path := shutil.which(name))), None)
    if found is None:
        raise InvalidInput(
            f"an exported folder is compiled before it runs, and there is no C compiler ({', '.join(COMPILERS)})"
        )
    return found


def _built(folder: Path, texts: dict[str, str]) -> Path:
    """The library of these sources, from the cache where it was built before."""
    with_what = compiler()
    key = hashlib.sha256(json.dumps([texts, with_what, FLAGS]).encode()).hexdigest()[:24]
    place = cache_folder(__file__) / f"exported-{key}"
    library = place / "exported.so"
    if not library.is_file():
        place.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=place) as own:  # others may build the same at the same time
            for name, text in texts.items():
                (Path(own) / name).write_text(text, encoding="utf-8")
            command = [with_what, *FLAGS, "exported.c", "controller.c", "-o", library.name, "-lm"]
            done = subprocess.run(command, cwd=own, capture_output=True, text=True)
            if done.returncode:
                first = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr[:300])
                raise InvalidInput(f"'{folder}' does not compile: {first}")
            (Path(own) / library.name).replace(library)
    return library


def _shim(information: str, single: bool) -> str:
    """C around the controller: from a block of machines to its input, and back."""
    real = "float" if single else "double"
    at = {f"signals.{name}": int(machine.SIGNALS) // W + i for i, name in enumerate(fields(Privileged))}
    at |= {f"job.{name}": int(machine.JOB) // W + i for i, name in enumerate(fields(supervisor.Orders))}
    at |= {f"guard.{name}": int(machine.S_GUARD) // W + i for i, name in enumerate(fields(supervisor.State))}
    encoder = int(machine.TALLY) // W + fields(machine.Tally).index("encoder")
    head = int(machine.START) // W + fields(machine.Start).index("head")
    axis = {name: int(machine.P_Z) // W + fields(z_axis.Params).index(name) for name in ("speed", "dac")}
    inner = "in" if information == "sensor" else "in.input"
    flags = {name for name, kind in supervisor.Orders.__annotations__.items() if kind is bool}
    lines = [f"{inner}.{name} = ({real})B({at[f'signals.{name}']});" for name in ("frequency", "feed", "place", "lap")]
    lines += [f"{inner}.encoder = ({real})B({encoder});"]
    for name in fields(supervisor.Orders):
        cell = f"B({at[f'job.{name}']})"
        lines.append(f"{inner}.orders.{safe(name)} = {f'{cell} != 0.0' if name in flags else f'({real}){cell}'};")
    if information != "sensor":
        lines += [f"in.ahead.{n} = ({real})B({at[f'signals.{n}']});" for n in firmware.SheetAhead._fields]
    if information == "privileged":
        lines += [f"in.truth.{n} = ({real})B({at[f'signals.{n}']});" for n in firmware.Truth._fields]
    kinds = supervisor.State.__annotations__
    back = [
        f"B({at[f'guard.{n}']}) = {f'c->state.guard.{n} ? 1.0 : 0.0' if kinds[n] is bool else f'c->state.guard.{n}'};"
        for n in fields(supervisor.State)
    ]
    join = "\n        ".join
    told = {"sensor": "FirmwareInput", "preview": "FirmwareAhead", "privileged": "FirmwareKnown"}[information]
    return f"""\
#include <math.h>
#include <stdint.h>
#include "controller.h"

#define B(row) block[at + (uint64_t)(row) * {W} + lane]

const uint64_t exported_size = sizeof(Controller);

void exported_stage(uint64_t address, uint64_t at, uint64_t n, uint64_t io, uint64_t tick)
{{
    double *block = (double *)(uintptr_t)address;
    const uint64_t *words = (const uint64_t *)(uintptr_t)io;
    Controller *controllers = (Controller *)(uintptr_t)words[0];
    const {real} *frequencies = (const {real} *)(uintptr_t)words[1];
    const {real} *heights = (const {real} *)(uintptr_t)words[2];
    (void)tick;
    for (uint64_t lane = 0; lane < n; lane++) {{
        Controller *c = &controllers[at / {int(machine.STRIDE)} * {W} + at % {int(machine.STRIDE)} + lane];
        {told} in;
        if (B({at["signals.fresh"]}) != 0.0) {{
            const uint64_t first = (uint64_t)B({head}) * {firmware.POINTS};
            controller_start(c, frequencies + first, heights + first);
            c->state.guard.offset = ({real})B({at["guard.offset"]});
        }}
        {join(lines)}
        /* What the law was told to hold when the count was taken; a job may have changed it since. */
        if (c->state.guard.mode == {supervisor.PROTECT}) {{
            c->state.last.orders.protect = ({real})B({at["signals.set_height"]});
        }} else {{
            c->state.last.orders.set_height = ({real})B({at["signals.set_height"]});
        }}
        const double command = controller_step(c, &in);
        {join(back)}
        const double speed = B({axis["speed"]}), dac = B({axis["dac"]});
        const double u = command < -speed ? -speed : (command > speed ? speed : command);
        B({int(machine.DRIVE) // W}) = dac > 0.0 ? rint(u / dac) * dac : u;
    }}
}}
"""


def described(stack: Stack, single: bool) -> dict[str, Any]:
    """What a folder says of itself: the record of an export.

    Args:
        stack: that was exported.
        single: whether reals are ``float``.
    """
    groups = ("gate", "filter", "table", "guard", "law")
    numbers = {f"{group}.{name}": float(v) for group in groups for name, v in stack.part(group)._asdict().items()}
    about = {"controller": stack.name, "real": "float" if single else "double", "information": stack.information}
    return {**about, "slot": stack.slot, "parameters": numbers, "provenance": stack.provenance}
