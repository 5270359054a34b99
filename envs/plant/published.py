"""Published settings: how far a process command may go, and how far it leaves what the cut's figures stand on.

A machine has two ranges of settings; ``envs/figures/evidence.py`` says where their numbers come from. The *published*
one is what a document prints: a machine that is ``bounded`` obeys process commands only within it. The *calibrated* one
holds the settings of the cuts that the model was fitted to: of every machine it is noted by how much it leaves them.

Dither counts with its smaller amplitude a: up to a feed of ``feed_static`` without it, up to ``feed_high`` with all of
it, in a straight line between. The focus may be dithered by ``deep_low`` at the lowest and ``deep_high`` at the highest
frequency, again in a straight line between. Of eq. 12's shapes (Huang2024) the ellipse is printed without numbers and
the hat without a result, so the two amplitudes must be equal and the shape a circle.
"""

from typing import NamedTuple

from ..engine.lanes import clip, part
from .controller import Process
from .spot import HAT


class Range(NamedTuple):
    """A range of settings of a material."""

    known: bool = False  # the material's coefficients were calibrated
    bounded: bool = False  # commands beyond are not obeyed
    feed_low: float = 0.0  # mm/s
    feed_static: float = 0.0  # mm/s, largest without dither
    feed_high: float = 0.0  # mm/s, largest with the whole dither
    power_low: float = 1.0  # of the nominal power
    power_high: float = 1.0
    frequency_low: float = 0.0  # Hz, of a dither
    frequency_high: float = 0.0
    amplitude: float = 0.0  # mm, of the dither in x and y
    deep_low: float = 0.0  # mm, of the focus' dither at the lowest frequency
    deep_high: float = 0.0  # mm, at the highest
    focus: float = 0.0  # mm, ±, from the recipe's
    standoff: float = 0.0  # mm, ±, from the recipe's
    pressure: float = 0.0  # ±, of the nominal gas pressure


class Excess(NamedTuple):
    """By how much settings lie outside; 0 inside."""

    material: float = 0.0  # 1: its coefficients are assumed, so there is no inside
    feed: float = 0.0  # mm/s
    power: float = 0.0  # of the nominal power
    frequency: float = 0.0  # Hz
    amplitude: float = 0.0  # mm
    ellipse: float = 0.0  # mm, difference of the amplitudes in x and y
    depth: float = 0.0  # mm, of the focus' dither
    focus: float = 0.0  # mm
    standoff: float = 0.0  # mm
    pressure: float = 0.0  # of the nominal gas pressure
    shape: float = 0.0  # 1: dithered in a shape without a published result


@part
def fastest(r, amplitude):
    """Largest feed, mm/s, with a dither of this amplitude, mm."""
    return r.feed_static + (r.feed_high - r.feed_static) * clip(amplitude / max(r.amplitude, 1e-9), 0.0, 1.0)


@part
def deepest(r, frequency):
    """Largest dither of the focus, mm, at this frequency, Hz."""
    share = (frequency - r.frequency_low) / max(r.frequency_high - r.frequency_low, 1e-9)
    return r.deep_low + (r.deep_high - r.deep_low) * clip(share, 0.0, 1.0)


@part
def bounded(r, feed, c):
    """A process command as far as it lies within the published settings; ``feed`` in mm/s is that of override 1."""
    amplitude = min(c.x, c.y, r.amplitude) if c.frequency > 0.0 else 0.0
    frequency = clip(c.frequency, r.frequency_low, r.frequency_high) if c.frequency > 0.0 else 0.0
    return Process(
        override=clip(c.override, r.feed_low / max(feed, 1e-9), fastest(r, amplitude) / max(feed, 1e-9)),
        power=clip(c.power, r.power_low, r.power_high),
        frequency=frequency,
        x=amplitude,
        y=amplitude,
        z=clip(c.z, 0.0, deepest(r, frequency)),
        focus=clip(c.focus, -r.focus, r.focus),
        standoff=clip(c.standoff, -r.standoff, r.standoff),
    )


@part
def _above(x, limit):
    """By how much ``x`` exceeds a limit; what rounding does is no excess."""
    return x - limit if x > limit + 1e-6 * (1.0 + abs(limit)) else 0.0


@part
def beyond(r, feed, c, shape, offset, pressure):
    """The :class:`Excess` of a process command.

    Args:
        r: the :class:`Range`.
        feed: mm/s of override 1.
        c: the command in force.
        shape: of the dither.
        offset: mm, of the machine's standoff from the recipe's, beside the command's.
        pressure: of the gas, of the nominal one.
    """
    on = r.known and c.frequency > 0.0
    least, most = (min(c.x, c.y), max(c.x, c.y)) if on else (0.0, 0.0)
    depth = c.z if on else 0.0
    dithered = most > 0.0 or depth > 0.0
    set_feed = feed * c.override
    too_fast, too_slow = _above(set_feed, fastest(r, least)), _above(r.feed_low, set_feed)
    return Excess(
        material=0.0 if r.known else 1.0,
        feed=max(too_fast, too_slow) if r.known else 0.0,
        power=max(_above(c.power, r.power_high), _above(r.power_low, c.power)) if r.known else 0.0,
        frequency=(
            max(_above(c.frequency, r.frequency_high), _above(r.frequency_low, c.frequency)) if dithered else 0.0
        ),
        amplitude=_above(most, r.amplitude) if on else 0.0,
        ellipse=_above(most - least, 0.0),
        depth=_above(depth, deepest(r, c.frequency)) if on else 0.0,
        focus=_above(abs(c.focus), r.focus) if r.known else 0.0,
        standoff=_above(abs(c.standoff + offset), r.standoff) if r.known else 0.0,
        pressure=_above(abs(pressure - 1.0), r.pressure) if r.known else 0.0,
        shape=1.0 if dithered and shape == HAT else 0.0,
    )


@part
def outside(x):
    """Whether any setting lies outside."""
    total = x.material + x.feed + x.power + x.frequency + x.amplitude + x.ellipse + x.depth + x.focus + x.standoff
    return total + x.pressure + x.shape > 0.0
