"""The law of :mod:`rollout` that learners train: recorded signals with weights, fed forward and back.

With ``sheet`` (encoder − reading of that period, mm, which does not depend on the control) the law is::

    u = fed + gain·(sheet + set height − encoder − share·moving)
    moving = Σ over the newest commands that have not acted yet (``behind`` ms), mm

A policy gives ``fed``, ``sheet``, ``gain`` and ``share`` of each period; their adjoints are what it learns from. They
stand beside each other as the columns of :class:`Recorded`.
"""

from typing import NamedTuple

from ..engine.lanes import clip, part
from .controller import PERIOD


class Params(NamedTuple):
    """What is the same in all periods."""

    set_height: float = 1.0  # mm


class State(NamedTuple):
    """The law remembers nothing; NamedTuples of compiled code are not empty."""

    unused: float = 0.0


class Recorded(NamedTuple):
    """What is given for each period."""

    fed: float = 0.0  # mm/s, fed forward
    sheet: float = 0.0  # mm, where the sheet is taken to be
    gain: float = 0.0  # 1/s
    share: float = 0.0  # of the commands on their way that counts as done
    behind: float = 0.0  # ms of commands that are on their way, up to 7


@part
def _counts(behind, age):
    """How much of the command of ``age`` periods ago is on its way, 0 to 1."""
    return clip(behind - age + 0.5, 0.0, 1.0)


@part
def moving(sent, behind):
    """What commands on their way will move the head by, mm."""
    near = _counts(behind, 1.0) * sent.u1 + _counts(behind, 2.0) * sent.u2 + _counts(behind, 3.0) * sent.u3
    far = _counts(behind, 4.0) * sent.u4 + _counts(behind, 5.0) * sent.u5 + _counts(behind, 6.0) * sent.u6
    return PERIOD * (near + far + _counts(behind, 7.0) * sent.u7)


@part
def weigh(params, state, seen, recorded):
    """The state, and the command, mm/s."""
    goes_on = recorded.share * moving(seen.sent, recorded.behind)
    error = recorded.sheet + params.set_height - seen.head_position - goes_on
    return state, recorded.fed + recorded.gain * error
