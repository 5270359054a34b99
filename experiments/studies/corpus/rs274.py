"""LinuxCNC's stand-alone interpreter ``rs274`` (Debian: linuxcnc-uspace), where it is installed.

It is run with a tool table that has every tool without length, with no stored offsets, and in the programme's folder,
where it looks for subroutines. Its block-delete switch is off.
"""

import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

TIME_LIMIT = 20.0
"""s for a programme; some never end."""

ENDED = "File ended with no percent sign or program end"
"""What it says of a programme without M2; the path is whole."""

FEED = 100.0
"""In programmes whose F only a machine knows, or that have none."""


class Output(NamedTuple):
    """What ``rs274`` printed; ``refused``: its complaint, empty if it took the programme; ``filled``: F was made up."""

    text: str
    refused: str
    filled: bool = False


def command() -> str | None:
    """Where it is: ``$KERFGYM_RS274`` or on the path; None where it is not."""
    given = os.environ.get("KERFGYM_RS274")
    return given if given and Path(given).is_file() else shutil.which("rs274")


def run(programme: Path) -> Output | None:
    """What it makes of a programme; None where it is not installed or does not end."""
    found = command()
    if found is None:
        return None
    first = _run(found, programme.resolve(), programme.resolve())
    if first is None or not re.search("zero feed rate|_hal|_ini", first.refused):
        return first
    text = programme.read_bytes().decode("latin-1")
    text = re.sub(r"(?i)F\s*#\s*<\s*_(?:hal|ini)[^>]*>", f"F{FEED:g}", text)
    lines = text.split("\n")
    start = 1 if lines[0].strip() == "%" else 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / programme.name
        copy.write_bytes("\n".join([*lines[:start], f"F{FEED:g}", *lines[start:]]).encode("latin-1"))
        second = _run(found, copy, programme.resolve())
    return second._replace(filled=True) if second else None


def _run(found: str, programme: Path, original: Path) -> Output | None:
    tools = {int(n) for n in re.findall(rb"[Tt]\s*(\d{1,5})", original.read_bytes())} | set(range(1, 100))
    with tempfile.TemporaryDirectory() as folder:
        table, stored = Path(folder) / "tools.tbl", Path(folder) / "stored.var"
        table.write_text("".join(f"T{n} P{n} Z0 D0\n" for n in sorted(tools)))
        try:
            done = subprocess.run(
                [found, "-g", "-t", str(table), "-v", str(stored), str(programme)],
                cwd=original.parent,
                capture_output=True,
                stdin=subprocess.DEVNULL,
                timeout=TIME_LIMIT,
            )
        except subprocess.TimeoutExpired:
            return None
    said = [line.strip() for line in done.stderr.decode("latin-1").splitlines()]
    wrong = [line for line in said if line and not line.startswith(("executing", "link (", "Opening", "open ("))]
    whole = not wrong or wrong[0] == ENDED
    return Output(done.stdout.decode("latin-1"), "" if whole else wrong[0])
