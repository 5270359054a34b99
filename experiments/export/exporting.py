"""``kerfgym export``: writes a controller's folder, and checks one."""

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pandas as pd

from ...envs.control import exported, firmware
from ...envs.control import stack as stacks
from ...envs.control.stack import Stack
from ...envs.engine import lanes
from ...envs.engine.c99.unit import field_notes
from ...envs.engine.c99.values import BOOL, Struct, fields_of
from ...envs.engine.c99.words import safe
from ...envs.engine.quantity import InvalidInput
from ...envs.plant import supervisor
from ..store import runs
from . import c_files, vectors

HERE = Path(__file__).parent

TEMPLATES = ("README.md", "Makefile", "test_vectors.c", "fuzz.c", "processor.c", "processor.ld")

PLACES = jinja2.Environment(
    loader=jinja2.FileSystemLoader(HERE), undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True,
    keep_trailing_newline=True,
)  # fmt: skip
"""Templates of what lies beside the code."""

TOLERANCE = {"double": 1e-9, "float": 0.05}
"""mm/s by which a command may differ from the kernel's: in ``double`` what another mathematical library rounds
differently; in ``float`` three times what the worst of the shipped followers is off by [A]."""

USUAL = {"frequency": (1.1e6, 1e5), "encoder": (0.5, 2.0), "feed": (200.0, 200.0), "request": (3.5, 4.5),
         "set_height": (0.8, 0.5), "low": (-38.0, 1.0), "high": (108.0, 1.0),
         "most_frequency": (1e12, 1.0)}  # fmt: skip
"""Middle and spread of inputs that fuzzing mostly gives."""

STATIC = ("--enable=warning,performance,portability", "--std=c99", "--error-exitcode=1", "--quiet")
"""Checks of cppcheck that the code passes: possible errors, waste, and what compilers differ in. Left out are those of
style, and ``information``, which tells of headers that the analyser has not seen."""

SANITIZED = ("-g", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all")
"""Beside the flags: what stops at the first thing that C leaves undefined."""


def write(name: str, out: Path, single: bool = False, overwrite: bool = False) -> Path:
    """Writes the folder of a controller; see docs/export.md.

    Args:
        name: as for ``benchmark -c``.
        out: the folder.
        single: ``float`` in place of ``double``.
        overwrite: replace an existing one.

    Raises:
        InvalidInput: no such controller, one that cannot be said in C, or a folder that is there already.
    """
    stack = stacks.resolve(name)
    if out.exists() and not overwrite:
        raise InvalidInput(f"'{out}' exists; --overwrite replaces it")
    if out.exists() and not (out / exported.MANIFEST).is_file():
        raise InvalidInput(f"'{out}' is not the folder of an export, so it is not replaced")
    code = c_files.of(stack, single)
    rows, tables = vectors.of(stack)
    texts = {"controller.c": code.source, "controller.h": code.header, "parameters.h": code.parameters}
    texts["parameters.csv"] = parameters(stack).to_csv(index=False)
    words = _words(stack, code, rows, single)
    texts |= {each: PLACES.get_template(f"{each}.txt").render(words) for each in TEMPLATES}
    texts["vectors.csv"] = _csv(rows)
    texts["tables.csv"] = _csv(
        pd.DataFrame(np.moveaxis(tables, 1, 2).reshape(-1, 2), columns=["frequency_Hz", "height_mm"])
    )
    texts[exported.MANIFEST] = json.dumps(exported.described(stack, single), indent=1, ensure_ascii=False) + "\n"
    for file, text in texts.items():
        runs.write_text(out / file, text)
    return out


def _csv(frame: pd.DataFrame) -> str:
    return (
        "\n".join([",".join(frame.columns), *(",".join(f"{x:.17g}" for x in row) for row in frame.to_numpy())]) + "\n"
    )


def parameters(stack: Stack) -> pd.DataFrame:
    """The parameter sheet: name, value, unit, range, meaning and source of all that can be set."""
    rows = []
    for name, p in stack.parameters().items():
        if name.startswith("gate."):
            continue  # the counter's, not the code's
        q = p.quantity
        value = q.choices[int(p.value)] if q.choices else f"{p.value:.9g}"
        rows.append((name, value, "" if q.unit in ("", "1") else q.unit, q.range, q.doc, q.source))
    return pd.DataFrame(rows, columns=["name", "value", "unit", "range", "meaning", "source"])


def _words(stack: Stack, code: c_files.Code, rows: pd.DataFrame, single: bool) -> dict[str, Any]:
    sheet = parameters(stack)
    inputs = [c for c in rows.columns if c not in ("begins", "table", "command")]
    kinds = _kinds(code.parts.Input)
    within = "" if stack.information == "sensor" else "input."
    places = {c: (c if c.startswith(("ahead.", "truth.")) else within + c) for c in inputs}
    return {
        "name": stack.name,
        "summary": stack.summary,
        "real": "float" if single else "double",
        "single": single,
        "input": code.unit.struct(code.parts.Input),
        "inputs": [
            {
                "column": i + 2,
                "member": ".".join(map(safe, place.split("."))),
                "flag": kinds[place] == BOOL,
                "middle": USUAL.get(place.rpartition(".")[2], (0.0, 10.0))[0],
                "spread": USUAL.get(place.rpartition(".")[2], (0.0, 10.0))[1],
            }
            for i, place in enumerate(places.values())
        ],
        "columns": len(rows.columns),
        "points": firmware.POINTS,
        "gate": stack.part("gate"),
        "about": [(f, note) for f, note in _notes().items()],
        "sheet": sheet.to_dict("records"),
        "tolerance": TOLERANCE["float" if single else "double"],
        "rows": len(rows),
        "flags": " ".join(c_files.FLAGS),
        "sanitized": " ".join(SANITIZED),
        "static": " ".join(STATIC),
        "information": stack.information,
        "prefix": within,
    }


def _kinds(cls: Any, prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, kind in fields_of(cls).items():
        found |= _kinds(kind.cls, f"{prefix}{name}.") if isinstance(kind, Struct) else {prefix + name: kind}
    return found


def _notes() -> dict[str, str]:
    known = field_notes(firmware.Input) | {f"orders.{k}": v for k, v in field_notes(supervisor.Orders).items()}
    known |= {f"orders.{name}": words for name, words in MORE.items()}
    names = [n for n in lanes.fields(firmware.Input) if n in known]
    return {".".join(map(safe, name.split("."))): known[name] for name in names}


MORE = {
    "hole_guard": "the guard against holes and edges acts",
    "rise": "mm above the sheet, how far a calibration goes",
    "rise_speed": "mm/s, how fast it does",
    "request": "see below",
}
"""Of what is said of several orders together."""


def made(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """What ``make`` says in a folder; a ``make`` that runs this one has no part in it."""
    own = {key: value for key, value in os.environ.items() if key not in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")}
    command = ["make", "--silent", "--no-print-directory", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, env=own)


def check(folder: Path) -> list[str]:
    """Compiles an exported folder's own test and runs it; what it says.

    Raises:
        InvalidInput: it is no exported folder, does not compile without a warning, or differs from its vectors.
    """
    if not (folder / exported.MANIFEST).is_file():
        raise InvalidInput(f"'{folder}' is not the folder of an export: it has no {exported.MANIFEST}")
    said = []
    for compiler in ("gcc", "clang"):
        if shutil.which(compiler) is None:
            said.append(f"{compiler}: not installed, not tried")
            continue
        done = made(folder, "-B", f"CC={compiler}", "test")
        last = (done.stdout.strip().splitlines() or [""])[-1]
        if done.returncode:
            first = next((line for line in done.stderr.splitlines() if "error" in line), last)
            raise InvalidInput(f"'{folder}' with {compiler}: {first}")
        said.append(f"{compiler}: {last}")
    if shutil.which("cppcheck") is None:
        return [*said, "cppcheck: not installed, not tried"]
    done = made(folder, "-B", "static")
    if done.returncode:
        raise InvalidInput(f"'{folder}' with cppcheck: {done.stderr.strip().splitlines()[0]}")
    return [*said, "cppcheck: nothing found"]
