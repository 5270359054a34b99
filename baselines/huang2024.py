"""Huang2024: the trajectory-parameter adjusting unit, by rules.

The paper names a unit that gets the spot's actual position and speed and corrects position, trajectory and dither when
they differ from the plan; how, it does not say. These rules are one reading, around the settings of its dynamic method:

* **Feed.** ``override = planned − slow·max(0, |e| − tolerance)/tolerance − corner·(1 − v_ahead/v_plan)``: slower where
  the contour error e exceeds a tolerance, and where the plan brakes within 100 ms for a corner; it falls at once and
  comes back at a limited rate.
* **Power.** Line energy P/(v·2ω0) as planned would be P ∝ v; a part of the power only heats the surroundings and does
  not fall with v, hence ``P ∝ r^match`` with r the actual speed over the nominal feed.
* **Dither.** Overlap of its turns as planned: ``f ∝ r^overlap``; amplitudes ``∝ r^amplitude``.
* **Direction.** Dither along the path makes the cut's front longer and absorb more, dither across it widens what has
  to be melted, but also the way out for gas and melt. The circle may become an ellipse with ``1 − narrow`` of its
  width, and x and y get the extents of the ellipse as it lies along the path. Between two axes they cannot turn it:
  that is a smaller circle, and the feed falls by ``diagonal`` there.
* **Focus and standoff.** The focus moves against the height error h, −refocus·h; the standoff takes back what remains
  of it on average (``restore``, at most ±0.1 mm).

On C45 the machine obeys all this within the settings that were published (:mod:`envs.figures.evidence`), which leaves
feed, frequency and size of a circular dither; ``extrapolate = true`` in a scenario's job lifts that.

Outside the cut the settings are the planned ones. What the unit cannot know, since no sensor tells: gas pressure, the
power that arrives, and the cut itself.
"""

from typing import Annotated, NamedTuple

import numpy as np

from kerfgym.envs.engine.lanes import clip, part, power
from kerfgym.envs.engine.quantity import Quantity
from kerfgym.envs.plant.controller import Process

SLOT = "process"

LARGEST_TRIM = 0.1
"""mm, of the standoff."""

_PERIOD = 8e-3
_LEAD_IN, _CUT = 3.0, 4.0


class Params(NamedTuple):
    """The planned settings, and how they are adjusted."""

    override: Annotated[float, Quantity("1", 0.05, 2.0, "planned, of the planned feed")] = 1.0
    power: Annotated[float, Quantity("1", 0.05, 1.2, "planned, of the nominal power")] = 1.0
    frequency: Annotated[float, Quantity("Hz", 0.0, 4000.0, "of the dither, planned", "Huang2024")] = 2000.0
    x: Annotated[float, Quantity("mm", 0.0, 0.3, "amplitude of the dither, planned", "Huang2024")] = 0.3
    y: Annotated[float, Quantity("mm", 0.0, 0.3, "amplitude of the dither, planned", "Huang2024")] = 0.3
    z: Annotated[float, Quantity("mm", 0.0, 5.0, "amplitude of the focus' dither, planned", "Huang2024")] = 1.0
    focus: Annotated[float, Quantity("mm", -5.0, 5.0, "offset of the focus, planned, up positive")] = 0.0
    standoff: Annotated[float, Quantity("mm", -0.9, 0.9, "added to the nominal standoff, planned")] = 0.0
    tolerance: Annotated[float, Quantity("mm", 0.002, 0.5, "contour error that is let be", log=True)] = 0.02
    slow: Annotated[float, Quantity("1", 0.0, 1.0, "override given up per tolerance beyond it")] = 0.2
    corner: Annotated[float, Quantity("1", 0.0, 1.0, "share of the plan's braking that the override adds")] = 0.3
    least: Annotated[float, Quantity("1", 0.05, 1.0, "smallest override")] = 0.3
    recover: Annotated[float, Quantity("1/s", 0.1, 50.0, "rate at which the override comes back", log=True)] = 5.0
    match: Annotated[float, Quantity("1", 0.0, 1.0, "exponent of the power with the speed")] = 0.5
    least_power: Annotated[float, Quantity("1", 0.05, 1.0, "smallest power, of the planned one")] = 0.4
    overlap: Annotated[float, Quantity("1", 0.0, 1.0, "exponent of the dither's frequency with the speed")] = 0.5
    least_frequency: Annotated[float, Quantity("1", 0.1, 1.0, "smallest frequency, of the planned one")] = 0.5
    amplitude: Annotated[float, Quantity("1", 0.0, 1.0, "exponent of the dither's amplitudes with the speed")] = 0.0
    narrow: Annotated[float, Quantity("1", 0.0, 1.0, "share of the dither across the path that is given up")] = 0.0
    diagonal: Annotated[float, Quantity("1", 0.0, 0.8, "share of the override given up between two axes")] = 0.0
    refocus: Annotated[float, Quantity("1", 0.0, 1.5, "share of the height error that the focus takes")] = 1.0
    restore: Annotated[float, Quantity("1/s", 0.0, 5.0, "rate at which the standoff takes back a lasting error")] = 0.0
    smooth: Annotated[float, Quantity("ms", 8.0, 1000.0, "time constant of speed and height error", log=True)] = 16.0


class State(NamedTuple):
    """What has been seen."""

    override: float = 1.0
    speed: float = 1.0  # over the nominal feed, smoothed
    height: float = 0.0  # mm, height error, smoothed
    trim: float = 0.0  # mm, of the standoff


@part
def init(params):
    """The initial state."""
    return State(params.override, 1.0, 0.0, 0.0)


@part
def control(params, state, signals, tables):
    """The process' command."""
    p = params
    if signals.phase != _LEAD_IN and signals.phase != _CUT:
        return State(p.override, 1.0, 0.0, state.trim), Process(
            p.override, p.power, p.frequency, p.x, p.y, p.z, p.focus, p.standoff + state.trim
        )
    share = _PERIOD / (_PERIOD + 1e-3 * p.smooth)
    speed = state.speed + share * (signals.speed / max(signals.feed, 1e-6) - state.speed)
    height = state.height + share * (signals.height - signals.set_height - state.height)
    trim = clip(state.trim - p.restore * _PERIOD * height, -LARGEST_TRIM, LARGEST_TRIM)

    tx2, ty2 = signals.tangent_x * signals.tangent_x, signals.tangent_y * signals.tangent_y
    most = p.override * (1.0 - p.diagonal * 4.0 * tx2 * ty2)
    beyond = max(0.0, abs(signals.contour_error) - p.tolerance) / p.tolerance
    ahead = min(signals.planned_50, signals.planned_100)
    braking = clip(1.0 - ahead / max(signals.planned, 1e-6), 0.0, 1.0)
    wanted = clip(most - p.slow * beyond - p.corner * braking, min(p.least, most), most)
    override = min(wanted, state.override + p.recover * _PERIOD)

    r = clip(speed, 1e-3, 1.0)
    watts = p.power * max(power(r, p.match), p.least_power)
    hertz = p.frequency * max(power(r, p.overlap), p.least_frequency)
    size, kept = power(r, p.amplitude), 1.0 - p.narrow
    x, y = size * p.x * np.sqrt(tx2 + kept * kept * ty2), size * p.y * np.sqrt(ty2 + kept * kept * tx2)
    return State(override, speed, height, trim), Process(
        override, watts, hertz, x, y, size * p.z, p.focus - p.refocus * height, p.standoff + trim
    )
