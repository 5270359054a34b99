"""What derivatives through drive and loop cost, as a ratio within one run::

    python -m kerfgym.experiments.studies.gradient_cost [--machines 128] [--rounds 15]

Forward is the roll-out of drive and loop of ``forecast``; with backward, the adjoints of all its weights come behind.
Each round times both, one after the other; medians are over the rounds.
"""

import time
from typing import Annotated

import numpy as np
import tyro

from ...envs.control import stack
from ...envs.engine.kernels import Kernel
from ...envs.plant import z_axis
from ...envs.plant.derivatives import Felt, Period, Rollout
from ...envs.plant.derivatives import backward as backwards
from ...envs.plant.derivatives import forward as forwards

PERIODS = 200
ASKED = 4.0
"""Times forward, that forward and backward may cost."""


def ready(machines: int, bristle: float) -> Rollout:
    """Drives of the standard machine, with a friction whose bristles bend by ``bristle`` mm, that follow a moving
    sheet."""
    law = stack.get("forecast").law
    assert law.weighing
    assert law.weighing.loop
    actions = range(law.weighing.action, law.weighing.action + len(law.weighing.weights))
    roll = Rollout(machines, law.weighing.loop, law.Params, law.weighing.Loop, law.weighing.reads, actions)
    random, every = np.random.default_rng(0), np.arange(machines)
    roll.put_drive(every, z_axis.Params(bristle=bristle))
    roll.put_law(every, law.Params(), law.weighing.Loop())
    roll.put_head(every, 1.0, Felt(1.0, 0.0, 1.0, 0.0))
    course = np.zeros((machines, PERIODS, len(Period._fields)))
    course[:, :, 0] = random.normal(0.0, 0.02, (machines, PERIODS))
    course[:, :, 3:] = 0.75, 0.2, np.nan
    roll.put_recorded(course, random.normal(0.0, 0.1, (machines, PERIODS, law.weighing.reads)))
    roll.forward()
    roll.backward(np.ones((machines, PERIODS, 3)))
    return roll


def seconds(kernel: Kernel, roll: Rollout) -> float:
    """CPU time of a kernel."""
    began = time.thread_time()
    kernel(roll.deck)
    return time.thread_time() - began


def main(
    machines: Annotated[int, tyro.conf.arg(help="in the batch.")] = 128,
    rounds: Annotated[int, tyro.conf.arg(help="that are timed.")] = 15,
) -> None:
    """Times forward, and forward with backward."""
    for friction, bristle in (("viscous", 0.0), ("bristles", 0.01)):
        roll, found = ready(machines, bristle), []
        for _ in range(rounds):
            forward = seconds(forwards, roll)
            found.append((forward, forward + seconds(backwards, roll)))
        forward, both = (1e9 / (machines * PERIODS) * np.median(found, axis=0)).tolist()
        ratios = np.array([b / f for f, b in found])
        print(f"{friction}: forward {forward:.0f} ns a machine and period, with backward {both:.0f} ns")
        print(f"  ratio {np.median(ratios):.2f} ({ratios.min():.2f} to {ratios.max():.2f}); asked: at most {ASKED:g}")


if __name__ == "__main__":
    tyro.cli(main)
