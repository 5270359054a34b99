"""Signals as text for a page: whole multiples of a step, differences, deflated, base64; ``pack.js`` reads them.

A step is the signal's resolution, or a 65 000th of its range where that is more. Neighbouring differences are small, so
that the upper bytes, which stand together, are mostly equal: a signal takes about one byte a sample.
"""

import base64
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

MISSING = -32768
"""Stands for a value that is not finite."""

_MOST = 65000


@dataclass(frozen=True)
class Channel:
    """A signal and the step to which it is kept."""

    values: Floats
    resolution: float


def pack(channels: Sequence[Channel]) -> dict[str, Any]:
    """Signals of equal length, one after the other.

    Returns:
        ``samples``; ``low`` and ``step`` of each channel: value = low + step·(whole + 32767); ``data``, base64.
    """
    lows, steps, whole = [], [], []
    for channel in channels:
        good = np.isfinite(channel.values)
        low = float(channel.values[good].min()) if good.any() else 0.0
        high = float(channel.values[good].max()) if good.any() else 0.0
        step = max(channel.resolution, (high - low) / _MOST)
        scaled = np.where(good, np.rint((np.where(good, channel.values, low) - low) / step) - 32767, MISSING)
        whole.append(np.diff(scaled.astype(np.int64), prepend=0).astype(np.int16))  # wraps, and so does the sum
        lows.append(float(f"{low:.9g}"))
        steps.append(float(f"{step:.9g}"))
    table = np.concatenate(whole) if whole else np.zeros(0, np.int16)
    split = table.astype("<i2").view(np.uint8).reshape(-1, 2).T.tobytes()
    count, data = len(channels[0].values) if channels else 0, base64.b64encode(zlib.compress(split, 7)).decode("ascii")
    return {"samples": count, "low": lows, "step": steps, "data": data}


def thinned(values: Floats, stride: int) -> Floats:
    """The smallest and the largest of every ``2·stride`` samples, in the order in which they came; peaks survive."""
    if stride == 1:
        return values
    count = len(values) // (2 * stride)
    blocks = values[: 2 * stride * count].reshape(count, 2 * stride)
    low, high = np.nanargmin(_known(blocks), axis=1), np.nanargmax(_known(blocks, -np.inf), axis=1)
    first, last = np.minimum(low, high), np.maximum(low, high)
    every = np.arange(count)
    return np.stack([blocks[every, first], blocks[every, last]], axis=1).ravel()


def _known(blocks: Floats, instead: float = np.inf) -> Floats:
    return np.where(np.isfinite(blocks), blocks, instead)
