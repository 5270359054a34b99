"""The cut's streaming form over recorded runs, compiled: for metrics, calibration and tests.

Runs lie side by side, a lane each, as machines do in a block.
"""

from typing import Any

import numpy as np

from ..engine.kernels import Kernel
from ..engine.lanes import UW, U, W, doubles, flat, load, rows, stage, store
from . import cut

_P, _B, _S = U(0), U(rows(cut.Params) * W), U((rows(cut.Params) + rows(cut.Beam)) * W)
_SIZE = _S + U(rows(cut.State) * W)
_GIVEN, _FIGURES = U(3), U(rows(cut.Figures))
_WHOLE = U(2**40)


@stage
def _period(column, given, out, g, o, dt):
    """One period of every lane: speed, standoff error and contour error in, figures out."""
    p, b = load(cut.Params, column, _P), load(cut.Beam, column, _B)
    for lane in range(UW):
        before, i = load(cut.State, column, _S + lane), g + lane
        s, f = cut.step(p, b, before, given[i], given[i + UW], given[i + UW * U(2)], dt)
        store(column, _S + lane, s)
        store(out, o + lane, f)


def _run(column_address, given_address, figures_address, steps, period_in_ns):
    column, given = doubles(column_address, _SIZE), doubles(given_address, _WHOLE)
    out, dt = doubles(figures_address, _WHOLE), 1e-9 * np.float64(np.int64(period_in_ns))
    for i in range(steps):
        _period(column, given, out, i * _GIVEN * UW, i * _FIGURES * UW, dt)


_kernel = Kernel(_run)


def figures(p: cut.Params, b: cut.Beam, speed: Any, error: Any, contour: Any = 0.0, dt: float = 1e-3) -> np.ndarray:
    """:class:`cut.Figures` of every period, shape (steps, 7), or of several runs (steps, 7, runs).

    Args:
        p, b: material and beam, the same throughout.
        speed, error, contour: mm/s, mm and mm; numbers, or arrays of shape (steps,) or (steps, runs).
        dt: s.
    """
    given = [np.atleast_1d(np.asarray(x, float)) for x in (speed, error, contour)]
    shape = np.broadcast_shapes(*(x.shape for x in given))
    runs = [x if x.ndim == 2 else x[:, None] for x in given]
    steps, count = np.broadcast_shapes(*(x.shape for x in runs))
    numbers = np.repeat([*flat(p), *flat(b), *flat(cut.fresh())], W)
    out = np.empty((steps, int(_FIGURES), count))
    for first in range(0, count, W):
        some = slice(first, min(first + W, count))
        block, found = np.zeros((steps, int(_GIVEN), W)), np.empty((steps, int(_FIGURES), W))
        for k, x in enumerate(runs):
            block[:, k, : some.stop - first] = x if x.shape[1] == 1 else x[:, some]
        column = numbers.copy()
        _kernel(column, block, found, steps, round(dt * 1e9))
        out[:, :, some] = found[:, :, : some.stop - first]
    return out if len(shape) == 2 else out[:, :, 0]
