"""The environment's share of training time: PPO of stable-baselines3 on 256 machines."""

import time
from typing import Any

from . import proof

SETTINGS: dict[str, Any] = {"n_steps": 64, "batch_size": 512, "n_epochs": 4}
MACHINES, ITERATIONS = 256, 3


def share(threads: int = 1) -> tuple[float, float]:
    """Trains PPO (two layers of 64) for some iterations.

    Args:
        threads: of torch.

    Returns:
        ``(share, rate)``: the environment's part of the time, and environment steps per second.

    Raises:
        NothingDone: the machines have not lived through these steps.
    """
    import torch
    from stable_baselines3 import PPO

    from ...agents.vec_env import HeightFollowingVecEnv

    class Timed(HeightFollowingVecEnv):
        spent = 0.0

        def step_async(self, actions: Any) -> None:
            start = time.perf_counter()
            super().step_async(actions)
            self.spent += time.perf_counter() - start

        def step_wait(self) -> Any:
            start = time.perf_counter()
            result = super().step_wait()
            self.spent += time.perf_counter() - start
            return result

    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        env = Timed(MACHINES, scenario="wavy")
        model = PPO("MlpPolicy", env, device="cpu", seed=0, **SETTINGS)
        steps = MACHINES * SETTINGS["n_steps"]
        model.learn(steps)  # everything is compiled and warm
        env.spent, begun = 0.0, proof.of_batch(env.batch)
        start = time.perf_counter()
        model.learn(ITERATIONS * steps)
        whole = time.perf_counter() - start
        proof.check("training PPO", begun, proof.of_batch(env.batch), ITERATIONS * SETTINGS["n_steps"])
    finally:
        torch.set_num_threads(before)
    return env.spent / whole, ITERATIONS * steps / whole
