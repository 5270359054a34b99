"""The cut's streaming form over recorded runs, compiled: for metrics, calibration and tests."""

from typing import Any

import numpy as np

from . import cut
from .kernels import Kernel
from .lanes import U, W, doubles, flat, load, rows

_P, _B, _S = U(0), U(rows(cut.Params) * W), U((rows(cut.Params) + rows(cut.Beam)) * W)
_SIZE = _S + U(rows(cut.State) * W)
_FIGURES = U(rows(cut.Figures))


def _run(column_address, inputs_address, figures_address, steps, period_in_ns):
    """``steps`` periods of one cut: speed, standoff error and contour error in, figures out."""
    column, inputs = doubles(column_address, _SIZE), doubles(inputs_address, steps * U(3))
    out, dt = doubles(figures_address, steps * _FIGURES), 1e-9 * np.float64(np.int64(period_in_ns))
    p, b, s = load(cut.Params, column, _P), load(cut.Beam, column, _B), load(cut.State, column, _S)
    for i in range(steps):
        s, f = cut.step(p, b, s, inputs[i * U(3)], inputs[i * U(3) + U(1)], inputs[i * U(3) + U(2)], dt)
        o = i * _FIGURES
        out[o] = f.margin
        out[o + U(1)] = f.roughness
        out[o + U(2)] = f.dross
        out[o + U(3)] = f.kerf_top
        out[o + U(4)] = f.kerf_bottom
        out[o + U(5)] = f.taper
        out[o + U(6)] = f.through


_kernel = Kernel(_run)


def figures(p: cut.Params, b: cut.Beam, speed: Any, error: Any, contour: Any = 0.0, dt: float = 1e-3) -> np.ndarray:
    """:class:`cut.Figures` of every period, shape (steps, 7).

    Args:
        p, b: material and beam, the same throughout.
        speed, error, contour: mm/s, mm and mm; arrays of shape (steps,) or numbers.
        dt: s.
    """
    given = np.stack(
        np.broadcast_arrays(*(np.atleast_1d(np.asarray(x, float)) for x in (speed, error, contour))), axis=1
    )
    inputs, out = np.ascontiguousarray(given), np.empty((len(given), int(_FIGURES)))
    column = np.zeros(int(_SIZE))
    numbers = [*flat(p), *flat(b), *flat(cut.fresh())]
    column[: len(numbers) * W : W] = numbers
    _kernel(column.ctypes.data, inputs.ctypes.data, out.ctypes.data, len(given), round(dt * 1e9))
    return out
