"""How good a policy is in the middle of its training: whole episodes of *tune* seeds, without exploration."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .learner import environment
from .settings import Settings

EPISODES = 56
"""Episodes of an evaluation unless the settings say otherwise: some of each scenario of the core."""


@dataclass(frozen=True)
class Evaluation:
    """``score`` is what the best policy is chosen by, the smaller the better.

    For HeightFollowing it is the benchmark's: the geometric mean over the scenarios of the RMS true error, µm, the
    time before a scenario counts left out. For the others it is minus the mean return.
    """

    score: float
    mean_return: float
    collisions: int
    steps: int  # simulated
    scenarios: dict[str, float] = field(default_factory=dict)  # RMS true error, µm


class Evaluator:
    """The environments of an evaluation, built once.

    Args:
        settings: arguments of ``evaluation`` that are the environment's take the place of the training's; episodes are
            whole unless ``evaluation.max_steps`` says otherwise.
    """

    def __init__(self, settings: Settings) -> None:
        changes = {"max_steps": None, **settings.evaluation}
        self.episodes = changes.pop("episodes", EPISODES)
        changes.pop("every", None)
        self.env = environment(settings, num_envs=self.episodes, split="tune", **changes)
        self.height = not self.env.batch.task.with_job

    def __call__(self, model: Any) -> Evaluation:
        """One episode of each of the first tune seeds."""
        env, batch = self.env, self.env.batch
        env.seed(0)
        seen = env.reset()
        alive, returns, collisions = np.ones(self.episodes, bool), np.zeros(self.episodes), 0
        which, settled = batch.scenario_of.copy(), np.array([s.settle_steps for s in batch.scenarios])
        square, count = np.zeros(len(batch.scenarios)), np.zeros(len(batch.scenarios))
        state, began, steps, period = None, np.ones(self.episodes, bool), 0, 0
        while alive.any():
            actions, state = model.predict(seen, state=state, episode_start=began, deterministic=True)
            steps += int(alive.sum())
            seen, _, began, infos = env.step(actions)
            for i in np.flatnonzero(began & alive).tolist():
                returns[i] = infos[i]["episode"]["r"]
                collisions += infos[i]["cost"] > 0.5
            alive &= ~began
            if self.height:
                error, scored = (batch.infos[batch.task.info.index(name)] for name in ("true_error", "scored"))
                counts = alive & (scored > 0.5) & (period >= settled[which])
                np.add.at(square, which[counts], error[counts] ** 2)
                np.add.at(count, which[counts], 1)
            period += 1
        mean = float(returns.mean())
        if not self.height:
            return Evaluation(-mean, mean, collisions, steps)
        found = {s.name: 1e3 * math.sqrt(square[i] / count[i]) for i, s in enumerate(batch.scenarios) if count[i]}
        score = math.exp(np.mean(np.log(list(found.values())))) if found else -mean
        return Evaluation(score, mean, collisions, steps, found)
