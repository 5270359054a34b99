"""Start-up in fresh processes: imports, the command, the first step with a warm and with an empty cache."""

import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable

_CPU = "import time; start = time.process_time();"
_END = "print(time.process_time() - start)"
_STEP = (
    "import time, gymnasium, kerfgym; start = time.process_time();"
    "env = gymnasium.make('kerfgym/HeightFollowing-v0'); env.reset(seed=0); env.step(env.action_space.sample());"
)
_COMPILE = (
    "import time; from kerfgym.envs.plant import machine; start = time.process_time();"
    "machine.advance.address;"
)  # fmt: skip

PROGRAMS = {
    "import gymnasium": f"{_CPU} import gymnasium; {_END}",
    "import kerfgym": f"{_CPU} import kerfgym; {_END}",
    "kerfgym list": f"{_CPU} import contextlib, io; from kerfgym.experiments import cli\n"
    f"with contextlib.redirect_stdout(io.StringIO()): cli.main(['list'])\n{_END}",
    "first step, warm": _STEP + _END,
}
COLD = {"machine compiled, empty cache": _COMPILE + _END, "first step, empty cache": _STEP + _END}


def _seconds(program: str, cache: str | None = None) -> float:
    environment = {**os.environ, **({"KERFGYM_CACHE_DIR": cache} if cache else {})}
    out = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, env=environment)
    return float(out.stdout)


def measure(rounds: int, progress: Callable[[str], None]) -> dict[str, list[float]]:
    """CPU-seconds of each, interleaved; the compiler once or twice only, it takes long."""
    found: dict[str, list[float]] = {name: [] for name in (*PROGRAMS, *COLD)}
    for program in PROGRAMS.values():
        _seconds(program)  # files are in the system's cache, kernels in ours
    for _ in range(rounds):
        for name, program in PROGRAMS.items():
            progress(name)
            found[name].append(_seconds(program))
    for _ in range(min(rounds, 3)):
        for name, program in COLD.items():
            progress(name)
            with tempfile.TemporaryDirectory() as cache:
                found[name].append(_seconds(program, cache))
    return found


def median(values: list[float]) -> float:
    """Median, NaN if there are none."""
    return statistics.median(values) if values else float("nan")
