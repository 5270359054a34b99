"""Small policies for ``kerfgym/Cutting-v0`` that stay within the calibrated settings, made of a few numbers.

What can be chosen there is feed and dither. How fast to go in general and how far to swing are two numbers; how much to
slow down, and where, is a network's answer to what comes on the path in the next 200 ms::

    u = b − Σ_k relu(w_k·d − θ_k),   d = 1 − (planned speed now and later, cosines of the turns to come)

``d`` is 0 on a straight at the planned feed. A policy is a folder like every other (:mod:`agents.policy`), so each
command takes it.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from ....agents.compiled import Compiled
from ....agents.network import Layer, Network
from ....agents.policy import FORMAT, Document, Policy, describe, describe_base, shape_of
from ....envs.control import stack as stacks
from ....envs.control.stack import Team
from ....envs.tasks.all_tasks import TASKS

ENVIRONMENT = "kerfgym/Cutting-v0"
BASE = "huang2024-dynamic"
"""Whose loops follow path and sheet; its process settings give way to the policy's."""

SEEN = ("planned", "planned_50", "planned_100", "planned_200", "ahead_50", "ahead_100", "ahead_200")
UNITS = 1
"""Of the hidden layer."""

SIZE = 2 + UNITS * (len(SEEN) + 1)
"""Numbers of a policy: general feed and dither, then weights and threshold of each unit."""

START = np.array([1.0, 1.0, *[0.1] * len(SEEN), 0.0])
"""The numbers with which a search begins: the base's settings, a little slower before corners."""


def network(numbers: np.ndarray) -> Network:
    """The network of a policy's numbers."""
    task = TASKS[ENVIRONMENT]
    names = task.seen("features", None).names
    where = [names.index(name) for name in SEEN]
    feed, dither = float(numbers[0]), float(numbers[1])
    units = np.asarray(numbers[2:], float).reshape(UNITS, len(SEEN) + 1)
    first = np.zeros((UNITS, len(names)), np.float32)
    first[:, where] = -units[:, :-1]
    bias = (units[:, :-1].sum(axis=1) - units[:, -1]).astype(np.float32)
    # Feed, power, frequency, x, y, z, focus, standoff: 2 kHz and the deepest dither of the focus, else the recipe's.
    last = np.zeros((8, UNITS), np.float32)
    last[0] = -1.0
    out = np.array([feed, 1.0, -1.0, dither, dither, 1.0, 0.0, 0.0], np.float32)
    layers = (Layer("linear", first, bias, "relu"), Layer("linear", last, out))
    return Network(len(names), 1, None, layers, "clip")


def policy(numbers: np.ndarray, provenance: dict[str, Any] | None = None) -> Policy:
    """A policy of these numbers."""
    net = network(numbers)
    observation, action = describe(ENVIRONMENT, "direct", "features", None)
    own = stacks.asked(BASE).full
    document = Document(
        format=FORMAT,
        environment=ENVIRONMENT,
        version=0,
        control="direct",
        base={slot: describe_base(getattr(own, slot)) for slot in TASKS[ENVIRONMENT].slots},
        observation=observation,
        action=action,
        network=shape_of(net),
        weights="",
        provenance=provenance or {},
    )
    return Policy(document, net)


def team(found: Policy) -> Team:
    """The policy as a controller, without a folder."""
    own = stacks.asked(BASE).full
    return own.having(replace(own.process, name="policy", summary="policy", pilot=Compiled(found)))
