"""Start-up in fresh processes: imports, the command, the first step with a warm and with an empty cache."""

import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from .proof import NothingDone

_CPU = "import time; start = time.process_time();"
_END = "print(time.process_time() - start)"
_STEP = (
    "import time, gymnasium, kerfgym; start = time.process_time();"
    "env = gymnasium.make('kerfgym/HeightFollowing-v0'); env.reset(seed=0); env.step(env.action_space.sample());"
)
_STEPPED = "; assert env.unwrapped.batch.fleet.column('tally.ticks')[0] == 1, 'no step was made'"
_COMPILE = "import time; from kerfgym.envs.plant import machine; start = time.process_time();machine.advance.address;"

PROGRAMS = {
    "import gymnasium": f"{_CPU} import gymnasium; {_END}",
    "import kerfgym": f"{_CPU} import kerfgym; {_END}",
    "kerfgym list": f"{_CPU} import contextlib, io; from kerfgym.experiments import cli\n"
    f"with contextlib.redirect_stdout(io.StringIO()) as shown: cli.main(['list'])\n"
    f"{_END}; assert 'xi2023-tuned' in shown.getvalue(), 'nothing was listed'",
    "first step, warm": _STEP + _END + _STEPPED,
}
COLD = {"machine compiled, empty cache": _COMPILE + _END, "first step, empty cache": _STEP + _END + _STEPPED}


def _seconds(program: str, cache: str | None = None, name: str = "a program") -> float:
    environment = {**os.environ, **({"KERFGYM_CACHE_DIR": cache} if cache else {})}
    out = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment)
    if out.returncode:
        last = out.stderr.strip().rpartition("\n")[2]
        raise NothingDone(f"'{name}' is no measurement: it ended with status {out.returncode}: {last}")
    if cache and not any(Path(cache).glob("*.o")):
        raise NothingDone(f"'{name}' is no measurement: nothing was compiled into the empty cache")
    return float(out.stdout)


def measure(rounds: int, progress: Callable[[str], None]) -> dict[str, list[float]]:
    """CPU-seconds of each, interleaved; the compiler once or twice only, it takes long.

    Raises:
        NothingDone: a program failed, or did not fill its empty cache.
    """
    found: dict[str, list[float]] = {name: [] for name in (*PROGRAMS, *COLD)}
    for name, program in PROGRAMS.items():
        _seconds(program, name=name)  # files are in the system's cache, kernels in ours
    for _ in range(rounds):
        for name, program in PROGRAMS.items():
            progress(name)
            found[name].append(_seconds(program, name=name))
    for _ in range(min(rounds, 3)):
        for name, program in COLD.items():
            progress(name)
            with tempfile.TemporaryDirectory() as cache:
                found[name].append(_seconds(program, cache, name))
    return found


def median(values: list[float]) -> float:
    """Median, NaN if there are none."""
    return statistics.median(values) if values else float("nan")
