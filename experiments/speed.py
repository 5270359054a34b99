"""Speed as ratios within one process: the machine against ``Pendulum-v1``, lanes against a machine from registers.

Everything is measured in CPU time, in interleaved rounds, and reported as the median with its range, because machines
are noisy. ``python -m kerfgym.experiments.speed`` prints the table.
"""

import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..envs import scenarios
from ..envs import stack as stacks
from ..envs.plant import machine
from ..envs.plant.fleet import Fleet
from ..envs.plant.kernels import Kernel
from ..envs.plant.lanes import U0, U1, UW, call, doubles, load, part, store, words
from ..envs.scenarios import Scenario
from . import rollout

ROUNDS = 7
MACHINES = 1024


@part
def _move_one(block, a):
    """All substeps of one machine with its state in local variables."""
    p, pace = load(machine.z_axis.Params, block, a + machine.P_Z), load(machine.z_axis.Pace, block, a + machine.PACE)
    course = load(machine.Course, block, a + machine.COURSE)
    z, m = load(machine.z_axis.State, block, a + machine.S_Z), load(machine.Moment, block, a + machine.MOMENT)
    for k in range(machine.SUBSTEPS):
        z, m = machine.substep(p, pace, course, z, m, (np.float64(k) + 1.0) / machine.SUBSTEPS)
    store(block, a + machine.S_Z, z)
    store(block, a + machine.MOMENT, m)


def _registers(deck_address):
    """The same machine, one after the other, nothing to vectorise: what the lanes are compared with."""
    deck = words(deck_address, machine.U(machine.DECK))
    machines = deck[machine.D_MACHINES]
    blocks = (machines + UW - U1) // UW
    block = doubles(deck[machine.D_BLOCK], blocks * machine.STRIDE)
    keys = words(deck[machine.D_KEYS], blocks * UW)
    for b in range(blocks):
        for lane in range(min(UW, machines - b * UW)):
            a, i = b * machine.STRIDE + lane, b * UW + lane
            tick = deck[machine.D_TICK]
            for _ in range(deck[machine.D_STEPS]):
                machine.supervise_all(block, a, U1, tick)
                machine.travel_all(block, a, U1, tick, deck)
                machine.prepare_all(block, a, U1, tick)
                _move_one(block, a)
                machine.sense_all(block, a, U1, tick, keys, i)
                machine.filter_all(block, a, U1, tick, deck[machine.D_WINDOW], U0)
                machine.look_up_all(block, a, U1, tick, deck)
                machine.report_all(block, a, U1, tick)
                law, tables, size = deck[machine.D_LAW], deck[machine.D_LAW_TABLES], deck[machine.D_LAW_SIZE]
                call(law, deck[machine.D_BLOCK], a, U1, tables, size)
                tick += U1
    deck[machine.D_TICK] += deck[machine.D_STEPS]


_registers_kernel = Kernel(_registers)


@dataclass(frozen=True)
class Rate:
    """Steps per CPU-second: median and range over the rounds."""

    name: str
    median: float
    low: float
    high: float


def _pendulum() -> Callable[[], float]:
    import gymnasium as gym

    env = gym.make("Pendulum-v1").unwrapped
    env.reset(seed=0)
    action = np.zeros(1, np.float32)

    def go() -> float:
        start = time.process_time()
        for _ in range(2000):
            env.step(action)
        return 2000 / (time.process_time() - start)

    return go


def _environment() -> Callable[[], float]:
    import gymnasium as gym

    env = gym.make("kerfgym/HeightFollowing-v0", scenario="wavy").unwrapped
    action = np.zeros(1, np.float32)

    def go() -> float:
        env.reset(seed=0)
        start = time.process_time()
        for _ in range(2900):
            env.step(action)
        return 2900 / (time.process_time() - start)

    return go


def _fleet(size: int, controller: str, scenario: Scenario) -> Fleet:
    return rollout.fleet_for(scenario, stacks.resolve(controller), np.arange(size))


def _closed_loop(size: int, controller: str, scenario: Scenario, steps: int) -> Callable[[], float]:
    fleet = _fleet(size, controller, scenario)

    def go() -> float:
        start = time.process_time()
        fleet.advance(steps)
        return size * steps / (time.process_time() - start)

    return go


def _from_registers(size: int, controller: str, scenario: Scenario, steps: int) -> Callable[[], float]:
    fleet = _fleet(size, controller, scenario)

    def go() -> float:
        start = time.process_time()
        fleet.run_kernel(_registers_kernel, steps)
        return size * steps / (time.process_time() - start)

    return go


def warm_start() -> float:
    """CPU-seconds from making the environment to the end of its first step, in a fresh process with a warm cache."""
    code = (
        "import time, gymnasium, kerfgym; start = time.process_time();"
        "env = gymnasium.make('kerfgym/HeightFollowing-v0'); env.reset(seed=0); env.step(env.action_space.sample());"
        "print(time.process_time() - start)"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return float(out.stdout)


def measure(rounds: int = ROUNDS) -> list[Rate]:
    """Rates of everything, interleaved."""
    wavy = scenarios.load("wavy")
    tasks = {
        "Pendulum-v1 unwrapped": _pendulum(),
        "env.step": _environment(),
        "closed loop, N = 1": _closed_loop(1, "pid", wavy, 20000),
        f"closed loop pid, N = {MACHINES}": _closed_loop(MACHINES, "pid", wavy, 60),
        f"closed loop observer, N = {MACHINES}": _closed_loop(MACHINES, "observer", wavy, 60),
        f"closed loop xi2023-improved, N = {MACHINES}": _closed_loop(MACHINES, "xi2023-improved", wavy, 60),
        f"rough sheet, pid, N = {MACHINES}": _closed_loop(MACHINES, "pid", scenarios.load("rough"), 60),
        f"from registers, pid, N = {MACHINES}": _from_registers(MACHINES, "pid", wavy, 15),
    }
    for go in tasks.values():
        go()  # compiled and warm
    rates: dict[str, list[float]] = {name: [] for name in tasks}
    for _ in range(rounds):
        for name, go in tasks.items():
            rates[name].append(go())
    return [Rate(name, statistics.median(r), min(r), max(r)) for name, r in rates.items()]


def main() -> None:
    """Prints the table."""
    from rich.console import Console
    from rich.table import Table

    rates = measure()
    base = rates[0].median
    table = Table(title=f"control steps of 1 ms per CPU-second, one thread, median of {ROUNDS} interleaved rounds")
    for column in ("", "M/s", "range", "ns/step", "× Pendulum-v1"):
        table.add_column(column, justify="left" if not column else "right")
    for r in rates:
        span = f"{r.low / 1e6:.3f}–{r.high / 1e6:.3f}"
        table.add_row(r.name, f"{r.median / 1e6:.3f}", span, f"{1e9 / r.median:.0f}", f"{r.median / base:.1f}")
    console = Console(width=120)
    console.print(table)
    by_name = {r.name: r.median for r in rates}
    ratio = by_name[f"closed loop pid, N = {MACHINES}"] / by_name[f"from registers, pid, N = {MACHINES}"]
    console.print(f"lanes × registers: {ratio:.1f}")
    starts = sorted(warm_start() for _ in range(5))
    console.print(f"warm start of the first step: {starts[2]:.2f} CPU-s (from gymnasium.make on; median of 5)")


if __name__ == "__main__":
    main()
