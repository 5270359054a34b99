"""What ``kerfgym speed`` times: each runs some machine-steps, proves them, and gives CPU-seconds per step."""

import contextlib
import functools
import importlib.util
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.plant import heads
from ...envs.plant.fleet import Fleet
from ...envs.scenarios import Machine, machines
from ..measure import rollout
from . import kernel_parts, proof

SIZES = (1, 2, 8, 32, 64, 128, 256, 512, 1024, 2048, 4096)
"""Machines of the plot of cost against N."""

CONTROLLERS = ("idle", "xi2023-improved", "xi2023-tuned", "pid", "observer", "preview-5ms")
"""Laws that are rolled out; ``idle`` is the open loop."""

MACHINES = 1024
ORACLE = Path(__file__).parents[2] / "tests" / "oracle" / "z_machine.py"
"""The machine in plain NumPy, where the checkout has its tests."""


@dataclass(frozen=True)
class Task:
    """One thing to time."""

    group: str
    name: str
    machines: int
    threads: int
    run: Callable[[], int]  # does its work, and tells how many machine-steps that was
    lived: Callable[[], proof.Life]  # what its machines have lived through
    prepare: Callable[[], Any] = lambda: None  # before each run, not timed

    def cost(self) -> float:
        """CPU-seconds per machine-step, of all threads together.

        Raises:
            NothingDone: the machines have not lived through these steps.
        """
        self.prepare()
        before = self.lived()
        start = time.process_time()
        steps = self.run()
        spent = time.process_time() - start
        proof.check(self.title, before, self.lived(), steps // self.machines)
        return spent / steps

    @property
    def title(self) -> str:
        """Name, machines and threads."""
        return f"{self.name}, N = {self.machines}, threads: {self.threads}"


def _repeated(
    group: str,
    name: str,
    size: int,
    step: Callable[[], Any],
    calls: int,
    lived: Callable[[], proof.Life],
    threads: int = 1,
    periods: int = 1,
    prepare: Callable[[], Any] = lambda: None,
) -> Task:
    """``step`` so many times, each of so many periods of ``size`` machines."""

    def run() -> int:
        for _ in range(calls):
            step()
        return calls * periods * size

    return Task(group, name, size, threads, run, lived, prepare)


def _environment(
    group: str, name: str, id_: str, steps: int, lived: Callable[[Any], proof.Life], periods: int = 1, **arguments: Any
) -> Task:
    """Steps of a Gymnasium environment; its resets are not timed."""
    import gymnasium as gym

    env = gym.make(id_, **arguments).unwrapped
    assert isinstance(env.action_space, gym.spaces.Box)
    step, reset = functools.partial(env.step, np.zeros(env.action_space.shape, np.float32)), lambda: env.reset(seed=0)
    return _repeated(group, name, 1, step, steps, lambda: lived(env), periods=periods, prepare=reset)


def references() -> Iterator[Task]:
    """What the machine is compared with."""
    yield _environment("single", "Pendulum-v1 unwrapped", "Pendulum-v1", 2000, lambda env: proof.of_state(env.state))
    if importlib.util.find_spec("mujoco"):
        yield _environment("single", "HalfCheetah-v5 unwrapped", "HalfCheetah-v5", 300, _cheetah)


def _cheetah(env: Any) -> proof.Life:
    return proof.of_state(env.data.qpos, round(env.data.time / env.dt))


def single(machine: Machine | None = None) -> Task:
    """The environment, one step after the other."""
    what: dict[str, Any] = {"scenario": "wavy", "machine": machine}
    return _environment("single", "env.step", "kerfgym/HeightFollowing-v0", 2500, _batched, **what)


def _batched(env: Any) -> proof.Life:
    return proof.of_batch(env.batch)


def _fleet(size: int, controller: str, threads: int = 1, machine: Machine | None = None) -> Fleet:
    # Without a law the head runs into a wavy sheet, and a crashed machine is no yardstick.
    scenario = scenarios.load("flat" if controller == "idle" else "wavy")
    scenario = machines.put_on(scenario, machine) if machine else scenario
    return rollout.fleet_for(scenario, stacks.resolve(controller), np.arange(size), threads)


def kernel(size: int, threads: int = 1, name: str = "kernel, step by step", machine: Machine | None = None) -> Task:
    """The block kernel in closed loop, one call for each period."""
    fleet, calls = _fleet(size, "xi2023-improved", threads, machine), max(10, min(20_000, 60_000 // size))
    return _repeated("kernel", name, size, fleet.stepper(), calls, lambda: proof.of_fleet(fleet), threads)


def closed_loop(controller: str, size: int = MACHINES, threads: int = 1, machine: Machine | None = None) -> Task:
    """A compiled roll-out: many periods in one call."""
    fleet, periods = _fleet(size, controller, threads, machine), max(20, min(20_000, 60_000 // size))
    name, step = f"roll-out, {controller}", lambda: fleet.advance(periods)
    return _repeated("roll-out", name, size, step, 1, lambda: proof.of_fleet(fleet), threads, periods)


def from_registers(size: int = MACHINES) -> Task:
    """The roll-out of ``pid``, one machine after the other."""
    fleet, periods = _fleet(size, "pid"), 15
    step, lived = lambda: fleet.run_kernel(kernel_parts.registers, periods), lambda: proof.of_fleet(fleet)
    return _repeated("registers", "from registers, pid", size, step, 1, lived, periods=periods)


def vector(size: int, threads: int = 1, machine: Machine | None = None) -> Task:
    """The Gymnasium vector environment."""
    from ...envs.height_following import HeightFollowingVectorEnv

    env = HeightFollowingVectorEnv(size, num_threads=threads, scenario="wavy", machine=machine)
    env.reset(seed=0)
    return _vector("VectorEnv.step", env, np.zeros((size, 1), np.float32), threads)


def _vector(name: str, env: Any, actions: np.ndarray, threads: int = 1) -> Task:
    """60 000 machine-steps of an environment of many machines, or ten calls."""
    size, step = len(actions), functools.partial(env.step, actions)
    return _repeated("vector", name, size, step, max(10, 60_000 // size), lambda: _batched(env), threads)


def with_policy(size: int) -> Task:
    """The kernel with action, observation and reward, but nothing around it: what a vector environment cannot beat."""
    from ...envs.tasks.batch import Batch
    from ...envs.tasks.interface import TASK

    batch, calls = Batch(TASK, size), max(10, 60_000 // size)
    every = np.arange(size)
    batch.sequence(every, every)
    batch.restart(every)
    name = "kernel with action and observation"
    return _repeated("vector", name, size, batch.advance, calls, lambda: proof.of_batch(batch))


def sb3(size: int, threads: int = 1, machine: Machine | None = None) -> Task:
    """The stable-baselines3 VecEnv."""
    from ...agents.vec_env import HeightFollowingVecEnv

    env = HeightFollowingVecEnv(size, num_threads=threads, scenario="wavy", machine=machine)
    env.seed(0)
    env.reset()
    return _vector("stable-baselines3 VecEnv.step", env, np.zeros((size, 1), np.float32), threads)


def job_step() -> Task:
    """Cutting-v0, one step of 8 ms after the other, with the quality of the cut."""
    return _environment("jobs", "Cutting-v0 step", "kerfgym/Cutting-v0", 400, _batched, periods=8)


def job_vector(size: int) -> Task:
    """The vector environment of Cutting-v0."""
    from ...envs.cutting import CuttingVectorEnv

    env = CuttingVectorEnv(size)
    env.reset(seed=0)
    step, calls = functools.partial(env.step, np.zeros((size, 8), np.float32)), max(4, 12_000 // size)
    return _repeated("jobs", "Cutting-v0 VectorEnv.step", size, step, calls, lambda: _batched(env), periods=8)


def oracle(size: int) -> Task | None:
    """The plain NumPy model of the machine, if the checkout has it."""
    if not ORACLE.is_file():
        return None
    spec = importlib.util.spec_from_file_location("kerfgym_oracle", ORACLE)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    seeds = np.arange(size)
    model = module.ZMachine.like(_fleet(size, "xi2023-improved"), scenarios.noise_keys(seeds), heads.POOL)

    def lived() -> proof.Life:
        return proof.of_state(np.stack([model.head, model.gap, model.frequency], axis=1), model.tick)

    return _repeated("NumPy", "plain NumPy model, batched", size, model.step, 3, lived)


@contextlib.contextmanager
def busy(processes: int) -> Iterator[None]:
    """Other processes that load the cores meanwhile."""
    import multiprocessing

    context = multiprocessing.get_context("spawn")
    others = [context.Process(target=_spin, daemon=True) for _ in range(processes)]
    for other in others:
        other.start()
    time.sleep(1.0)
    try:
        yield
    finally:
        for other in others:
            other.terminate()


def _spin() -> None:
    while True:
        sum(range(100_000))
