"""``kerfgym speed``: everything timed in one process, in interleaved rounds, and compared as ratios.

Times are CPU time, because machines are shared and noisy; what is reported is the median of the rounds and their range.
"""

import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ...envs.scenarios import Machine
from ...envs.tasks.batch import Batch
from ...envs.tasks.interface import TASK
from ..store import runs
from . import kernel_parts, ppo, startup, timed
from .timed import MACHINES, SIZES, Task

LARGEST = SIZES[-1]
POLICIES = 256  # machines of the vector environments that training uses


class Costs:
    """What was measured: ns per step of each round, medians of start-ups in CPU-s, and what was measured apart."""

    def __init__(self, costs: pd.DataFrame, start: dict[str, list[float]], extra: dict[str, float]) -> None:
        self.frame, self.extra = costs, extra
        self.start = {name: startup.median(values) for name, values in start.items()}

    def of(self, name: str, machines: int = 1, threads: int = 1) -> np.ndarray:
        """Of each round; a ratio is the median of the rounds' ratios."""
        c = self.frame
        row = c[(c.name == name) & (c.machines == machines) & (c.threads == threads)]
        return np.array(row.each.iloc[0]) if len(row) else np.array([np.nan])

    def rolled(self, controller: str) -> np.ndarray:
        """Of a roll-out."""
        return self.of(f"roll-out, {controller}", MACHINES)


_PENDULUM, _KERNEL, _VEC = "Pendulum-v1 unwrapped", "kernel, step by step", "stable-baselines3 VecEnv.step"
_APART = None  # found in ``Costs.extra`` by its name

PROMISES: tuple[tuple[str, str, float, Callable[[Costs], Any] | None], ...] = (
    ("env.step × Pendulum-v1 unwrapped", ">=", 4.0, lambda c: c.of(_PENDULUM) / c.of("env.step")),
    ("env.step × HalfCheetah-v5 unwrapped", ">=", 15.0, lambda c: c.of("HalfCheetah-v5 unwrapped") / c.of("env.step")),
    ("roll-out of 1024, one thread × Pendulum-v1", ">=", 90.0, lambda c: c.of(_PENDULUM) / c.rolled("pid")),
    ("kernel of 4096 × plain NumPy model", ">=", 8.0,
     lambda c: c.of("plain NumPy model, batched", LARGEST) / c.of(_KERNEL, LARGEST)),
    ("lanes × the same machine from registers", ">=", 4.0,
     lambda c: c.of("from registers, pid", MACHINES) / c.rolled("pid")),
    ("two threads ÷ one, per CPU-second", ">=", 0.9, lambda c: c.of(_KERNEL, LARGEST) / c.of(_KERNEL, LARGEST, 2)),
    ("two threads ÷ one, per CPU-second, cores loaded", ">=", 0.9, _APART),
    ("slowest law ÷ open loop, roll-out of 1024", ">=", 0.6, lambda c: min(
        (c.rolled("idle") / c.rolled(name) for name in timed.CONTROLLERS if name != "idle"), key=np.median)),
    ("stable-baselines3 VecEnv ÷ kernel, 256, time", "<=", 1.6,
     lambda c: c.of(_VEC, POLICIES) / c.of(_KERNEL, POLICIES)),
    ("stable-baselines3 VecEnv ÷ kernel with action and observation, 256, time", "<=", 1.6,
     lambda c: c.of(_VEC, POLICIES) / c.of("kernel with action and observation", POLICIES)),
    ("environment's share of PPO's time, 256, batches of 512", "<=", 0.05, _APART),
    ("import kerfgym ÷ import gymnasium", "<=", 1.3, lambda c: c.start["import kerfgym"] / c.start["import gymnasium"]),
    ("kerfgym list, CPU-s", "<=", 1.5, lambda c: c.start["kerfgym list"]),
    ("first step warm, CPU-s", "<=", 0.4, lambda c: c.start["first step, warm"]),
    ("machine compiled, CPU-s", "<=", 8.0, lambda c: c.start["machine compiled, empty cache"]),
    ("Cutting-v0 × real time", ">=", 150.0, lambda c: 1e6 / c.of("Cutting-v0 step")),
    ("Cutting-v0 × real time, 256 on one core", ">=", 600.0,
     lambda c: 1e6 / c.of("Cutting-v0 VectorEnv.step", POLICIES)),
    ("KB per machine, block", "<=", 4.5, _APART),
)  # fmt: skip
"""What the project promises of its speed, and how it is found."""


def _all_tasks(machine: Machine | None = None) -> list[Task]:
    """What is compared stands side by side, because a shared machine is slower for seconds at a time."""
    numpy = timed.oracle(LARGEST)
    found = [*timed.references(), timed.single(machine)]
    found += [timed.closed_loop(controller, machine=machine) for controller in timed.CONTROLLERS]
    found += [timed.from_registers(), timed.closed_loop("pid", 1, machine=machine)]
    found += [timed.closed_loop("pid", threads=2, machine=machine)]
    found += [timed.kernel(size, machine=machine) for size in SIZES] + ([numpy] if numpy else [])
    found += [timed.kernel(size, threads=2, machine=machine) for size in (LARGEST, MACHINES)]
    found += [timed.vector(size, machine=machine) for size in (LARGEST, MACHINES, POLICIES)]
    found += [timed.sb3(POLICIES, machine=machine), timed.with_policy(POLICIES)]
    return [*found, timed.job_step(), timed.job_vector(POLICIES)]


def measure(todo: list[Task], rounds: int, progress: Callable[[str], None]) -> pd.DataFrame:
    """A row for each task: nanoseconds of CPU time per machine-step, median and range over the rounds.

    Raises:
        NothingDone: a task's machines have not lived through what was timed.
    """
    for task in todo:
        progress(f"warming up: {task.name}")
        task.cost()
    costs: list[list[float]] = [[] for _ in todo]
    for round_ in range(rounds):
        for task, found in zip(todo, costs, strict=True):
            progress(f"round {round_ + 1} of {rounds}: {task.name}, N = {task.machines}")
            found.append(1e9 * task.cost())
    of = {name: [getattr(t, name) for t in todo] for name in ("group", "name", "machines", "threads")}
    of |= {"ns_per_step": [statistics.median(c) for c in costs], "ns_low": [min(c) for c in costs]}
    return pd.DataFrame({**of, "ns_high": [max(c) for c in costs], "rounds": rounds, "each": costs})


def threads_when_loaded(rounds: int, progress: Callable[[str], None]) -> float:
    """Throughput per CPU-second of two threads against one, while other processes load the cores."""
    one, two = timed.closed_loop("pid", LARGEST), timed.closed_loop("pid", LARGEST, 2)
    ratios = []
    with timed.busy(2):
        for round_ in range(rounds):
            progress(f"cores loaded, round {round_ + 1} of {rounds}")
            ratios.append(one.cost() / two.cost())
    return statistics.median(ratios)


def stages(rounds: int, progress: Callable[[str], None]) -> pd.DataFrame:
    """A row for each stage of the period: nanoseconds per machine and period, and what it was compiled to."""
    progress("stages of the kernel")
    costs = [kernel_parts.stage_costs() for _ in range(rounds + 1)][1:]
    median = statistics.median
    frame = pd.DataFrame([{"stage": n, "ns": 1e9 * median(c[n] for c in costs)} for n in kernel_parts.STAGES])
    frame["share"] = frame["ns"] / frame["ns"].sum()
    progress("instructions of the kernel")
    return frame.merge(pd.DataFrame(kernel_parts.table()), on="stage", how="left")


def memory() -> pd.DataFrame:
    """Bytes per machine: in the block that the kernel steps, and in the arrays of a vector environment."""
    batch = Batch(TASK, LARGEST)
    block = (batch.fleet.nbytes) / LARGEST
    arrays = sum(a.nbytes for a in vars(batch).values() if isinstance(a, np.ndarray)) / LARGEST
    return pd.DataFrame({"what": ["machine", "arrays of a batch"], "bytes": [block, arrays]})


def ratios(costs: pd.DataFrame, start: dict[str, list[float]], extra: dict[str, float]) -> pd.DataFrame:
    """:data:`PROMISES` and what was measured; NaN where it could not be."""
    measured, rows = Costs(costs, start, extra), []
    for name, sense, floor, quotient in PROMISES:
        value = extra.get(name, np.nan) if quotient is None else float(np.median(quotient(measured)))
        held = np.nan if np.isnan(value) else float(value >= floor if sense == ">=" else value <= floor)
        rows.append({"ratio": name, "measured": value, "sense": sense, "promised": floor, "held": held})
    return pd.DataFrame(rows)


def speed(
    folder: Path,
    rounds: int,
    train: bool,
    torch_threads: int,
    progress: Callable[[str], None],
    machine: Machine | None = None,
) -> dict[str, Any]:
    """Measures everything and writes the run folder; returns its tables.

    ``machine``: that roll-outs, kernel and environments of height followers simulate; None: the standard one. Jobs, the
    plain model and the machine from registers stay as they are.
    """
    started = time.time()
    costs = measure(_all_tasks(machine), rounds, progress)
    base = float(costs[costs.name == "Pendulum-v1 unwrapped"].ns_per_step.iloc[0])
    costs["times_pendulum"] = base / costs.ns_per_step
    kept = memory()
    extra = {
        "two threads ÷ one, per CPU-second, cores loaded": threads_when_loaded(rounds, progress),
        "KB per machine, block": float(kept.bytes.iloc[0]) / 1024,
    }
    if train:
        progress("training PPO")
        extra["environment's share of PPO's time, 256, batches of 512"], extra["PPO's environment steps per second"] = (
            ppo.share(torch_threads)
        )
    start = startup.measure(rounds, progress)
    start_rows = [
        {"program": name, "cpu_seconds": startup.median(v), "low": min(v), "high": max(v)} for name, v in start.items()
    ]
    tables = {"speed": costs, "stages": stages(rounds, progress), "memory": kept}
    tables |= {"startup": pd.DataFrame(start_rows), "ratios": ratios(costs, start, extra)}
    for name, frame in tables.items():
        runs.write_table(folder, name, frame.drop(columns="each", errors="ignore"))
    each = {f"{r.name}, N = {r.machines}, {r.threads}": r.each for r in costs.itertuples()}
    runs.write_json(folder / "rounds.json", each)
    from .cost_curve import picture

    with runs.atomic(folder / "cost.png") as part:
        picture(costs).savefig(part, format="png", dpi=150)
    meta = runs.record() | {"rounds": rounds, "wall_seconds": round(time.time() - started, 1), "extra": extra}
    meta |= {"cut_by": machine.record} if machine else {}
    runs.write_json(folder / "run.json", meta)
    return tables
