"""The X and Y axes from a *square* log: gains of the four directions, time constants, and the limit of acceleration.

Prediction errors of both encoders, by least squares (Gauss and Newton's steps of SciPy's trust region) from several
first guesses. The candidates move as the machine's own axes do, compiled. How sure that is comes from the sandwich of
Huber 1967: the curvature of the sum of squares, and how its gradient scatters from half a second to half a second. That
holds the counts of the encoder, and whatever else they have in common.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize

from ...envs.engine.columns import Columns
from ...envs.engine.deck import Deck, places
from ...envs.engine.kernels import Kernel
from ...envs.engine.lanes import UW, Layout, U, W, doubles, load, stage, store, words
from ...envs.engine.quantity import InvalidInput
from ...envs.plant import xy_axes
from ...envs.plant.controller import PERIOD
from .log import Log

PRIOR = {
    "x_plus": (0.2, 5.0),
    "x_minus": (0.2, 5.0),
    "y_plus": (0.2, 5.0),
    "y_minus": (0.2, 5.0),
    "t1": (1e-4, 0.5),
    "t2": (5e-5, 0.5),
    "acceleration": (100.0, 1e5),
}
"""Ranges of a machine's ``[gantry]``, uniform in the logarithm, in the units of its file [A]."""

SEGMENT, BLOCK = 250, 500
"""Samples whose mean is free, and whose share of the gradient is taken as one."""

LAGS, RATIOS, LIMITS = np.geomspace(1e-3, 0.4, 24), (0.1, 0.35, 0.7), np.geomspace(200.0, 9e4, 10)
"""s of T1 + T2, T2 over T1, and mm/s² of first guesses."""

STARTS, EXPLAINED = 4, 1.0
"""First guesses from which is searched at most, and µm of RMS error from which on no other is [C]."""

PLAIN = 20.0
"""By which the sum of squares, over its mean, must fall for a limit of acceleration to be believed."""

DRAWS = 1000

_LOW = np.log([*(low for low, _ in list(PRIOR.values())[:4]), 1.5e-4, 0.005, 100.0])
_HIGH = np.log([*(high for _, high in list(PRIOR.values())[:4]), 1.0, 0.98, 1e5])
"""The four gains, T1 + T2, T2/T1 and acceleration, as they are searched."""


@dataclass(frozen=True)
class Found:
    """Axes from the posterior.

    Attributes:
        draws: by key of a machine's ``[gantry]``, each of shape (draws,).
        left: µm, RMS of what the best axes leave of the encoders.
        limited: whether the axes were ever at their limit of acceleration.
        explained: whether no more is left than counts of the encoders.
    """

    draws: dict[str, np.ndarray]
    left: float
    limited: bool
    explained: bool


# ------------------------------------------------------------------------------------------- candidates, compiled

_layout = Layout()
P_XY, G_XY = _layout.part("xy", xy_axes.Params), _layout.part("gains", xy_axes.Gains)
AXIS = _layout.part("axis", xy_axes.Axis)
ROWS = _layout.rows
STRIDE = U(ROWS * W)
_ANY = U(2**40)


class Entries(NamedTuple):
    """The kernel's deck; arrays are float64."""

    block: int  # (blocks, ROWS, W)
    blocks: int
    commands: int  # (periods,), mm/s
    periods: int
    made: int  # (blocks, periods, W), mm


D = places(Entries)
_DECK = U(len(Entries._fields))


@stage
def _slide(block, at, command, made, where):
    """One control period of all lanes; x's gains stand for those of the axis."""
    for lane in range(UW):
        a = at + lane
        p, gains = load(xy_axes.Params, block, a + P_XY), load(xy_axes.Gains, block, a + G_XY)
        axis = xy_axes.commanded(p, load(xy_axes.Axis, block, a + AXIS), command, p.x_plus, p.x_minus)
        axis = xy_axes.moved(p, gains, axis, PERIOD)
        store(block, a + AXIS, axis)
        made[where + lane] = axis.position


def _run(address):
    """All periods of all candidates."""
    deck = words(address, _DECK)
    block, commands, made = doubles(deck[D.block], _ANY), doubles(deck[D.commands], _ANY), doubles(deck[D.made], _ANY)
    for b in range(deck[D.blocks]):
        for t in range(deck[D.periods]):
            _slide(block, b * STRIDE, commands[t], made, (b * deck[D.periods] + t) * UW)


run = Kernel(_run, Path(__file__).read_text(encoding="utf-8"))


class _Candidates(Columns):
    """Columns that are filled to the last lane."""

    @property
    def block(self) -> np.ndarray:
        """All numbers."""
        return self._block


def courses(axes: list[xy_axes.Params], commands: np.ndarray, start: float) -> np.ndarray:
    """What axes do from rest at ``start``, mm, under ``commands``, mm/s, in force in each period.

    Args:
        axes: their parameters; the gains of x are meant.
        commands: shape (periods,).
        start: mm.

    Returns:
        mm at the end of each period, shape (axes, periods).
    """
    columns = _Candidates(len(axes), ROWS, _layout.parts)
    for i in range(columns.blocks * W):
        p: Any = axes[min(i, len(axes) - 1)]
        columns.put("xy", i, p)
        columns.put("gains", i, xy_axes.gains(p, PERIOD))
        columns.put("axis", i, xy_axes.at_rest(start))
    given = np.ascontiguousarray(commands, float)
    made = np.empty((columns.blocks, len(given), W))
    run(Deck(Entries, block=columns.block, blocks=columns.blocks, commands=given, periods=len(given), made=made))
    found: np.ndarray = made.transpose(0, 2, 1).reshape(-1, len(given))[: len(axes)]
    return found


# ------------------------------------------------------------------------------------------------ prediction errors


def constants(total: Any, ratio: Any) -> tuple[Any, Any]:
    """T1 and T2 from their sum and T2/T1."""
    return total / (1 + ratio), total * ratio / (1 + ratio)


def _params(base: xy_axes.Params, x: np.ndarray, axis: int) -> xy_axes.Params:
    """One of the two axes of logarithms ``x``."""
    v = np.exp(x)
    t1, t2 = constants(float(v[4]), float(v[5]))
    return base._replace(
        x_plus=float(v[2 * axis]), x_minus=float(v[2 * axis + 1]), t1=t1, t2=t2, acceleration=float(v[6]), literal=False
    )


class Errors:
    """What axes leave of a log's two encoders, µm, segment by segment, where the slides move."""

    def __init__(self, log: Log, base: xy_axes.Params) -> None:
        self.base = base
        self.commands = [log["x_command"], log["y_command"]]
        self.places = [log["x"], log["y"]]
        whole = len(log["x"]) // SEGMENT * SEGMENT
        steps = np.abs(np.diff(np.stack(self.places)))
        self.count = 1e3 * float(steps[steps > 1e-7].min(initial=np.inf))  # µm of an encoder's count
        self.used = []
        for at in self.places:
            moving = np.concatenate([np.zeros(10, bool), np.abs(at[10:] - at[:-10]) > 0])
            self.used.append(moving[:whole].reshape(-1, SEGMENT))

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Shape (points, samples that are used of x and then of y)."""
        out = []
        for axis in (0, 1):
            made = courses([_params(self.base, x, axis) for x in points], self.commands[axis], self.places[axis][0])
            used = self.used[axis]
            off = (1e3 * (made - self.places[axis]))[:, : used.size].reshape(len(points), *used.shape)
            mean = (off * used).sum(axis=2) / np.maximum(used.sum(axis=1), 1)
            out.append((off - mean[:, :, None])[:, used])
        return np.concatenate(out, axis=1)

    @property
    def allowed(self) -> float:
        """µm that may be left."""
        return max(EXPLAINED, self.count)

    @property
    def blocks(self) -> np.ndarray:
        """Which stretch of the log each used sample belongs to; both axes share them."""
        per = BLOCK // SEGMENT
        return np.concatenate([np.repeat(np.arange(len(u)) // per, u.sum(axis=1)) for u in self.used])

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Derivatives of the errors, shape (samples, numbers), by central differences."""
        step = np.array([1e-5] * 4 + [1e-4, 1e-3, 1e-4])
        made = self(np.concatenate([x + np.diag(step), x - np.diag(step)]))
        slopes: np.ndarray = ((made[: len(x)] - made[len(x) :]) / (2 * step)[:, None]).T
        return slopes


def _guesses(errors: Errors) -> list[np.ndarray]:
    """The first guess for each limit of acceleration, the best before the others.

    For every lag T the gains follow from x + T·v = g₊·U₊ + g₋·U₋, with the ways U that were commanded.
    """
    points = []
    for lag in LAGS:
        gains = []
        for at, command in zip(errors.places, errors.commands, strict=True):
            v = np.gradient(at, PERIOD)
            ways = np.stack([np.cumsum(np.maximum(command, 0)), np.cumsum(np.minimum(command, 0))]) * PERIOD
            matrix = np.stack([*ways, np.ones_like(at)], axis=1)
            gains += list(np.linalg.lstsq(matrix, at + lag * v, rcond=None)[0][:2] / errors.base.gain)
        gains = np.clip(gains, *np.exp([_LOW[0], _HIGH[0]]) * [1.001, 0.999]).tolist()
        for ratio in RATIOS:
            points += [np.log([*gains, lag, ratio, acceleration]) for acceleration in LIMITS]
    cost = np.concatenate([np.sum(errors(np.array(points[i : i + W])) ** 2, axis=1) for i in range(0, len(points), W)])
    table, count = cost.reshape(-1, len(LIMITS)), len(LIMITS)
    best = np.argmin(table, axis=0)
    # Where a limit is never reached, no step leads to it; so the ones that are come first, then one that is not.
    reached = np.abs(table / table[:, -1:] - 1)[best, np.arange(count)] > 1e-3
    order = sorted(range(count), key=lambda k: (not reached[k], table[best[k], k]))
    first = order[: max(1, int(reached.sum()))]
    free = [k for k in order if not reached[k]][:1]
    return [points[best[k] * count + k] for k in (*first[:1], *free, *first[1:])]


def identify(log: Log, base: xy_axes.Params, seed: int = 0) -> Found:
    """Axes that may have made a *square* log.

    Args:
        log: whose commands are those in force in each period.
        base: what is not searched: nominal gain, limit of speed, converter.
        seed: of the draws.

    Raises:
        InvalidInput: the axes hardly moved.
    """
    errors, rng = Errors(log, base), np.random.default_rng(seed)
    if min(used.sum() for used in errors.used) < 2000:
        raise InvalidInput(f"{log.name}: the axes move for under 2 s; a square log needs more")
    x, least = np.zeros(0), np.inf
    for start in _guesses(errors)[:STARTS]:
        near, cost = _nearest(errors, start)
        if cost < least:
            x, least = near, cost
        if least < errors.allowed**2:
            break
    # A limit that was hardly reached may as well be any higher one: the simpler axes hold unless they explain less.
    near, cost = _nearest(errors, np.append(x[:-1], _HIGH[-1] - 1e-6))
    if cost < least * (1 + PLAIN / len(errors.blocks)):
        x = near
    return _drawn(errors, x, rng)


def _nearest(errors: Errors, start: np.ndarray) -> tuple[np.ndarray, float]:
    """Least squares from a point on; the optimum, and the mean square that it leaves, µm²."""
    found = optimize.least_squares(
        lambda p: errors(p[None])[0], start, errors.slopes, bounds=(_LOW, _HIGH), x_scale="jac", max_nfev=25,
        xtol=1e-10, ftol=1e-10,
    )  # fmt: skip
    return found.x, 2 * float(found.cost) / len(errors.blocks)


def _drawn(errors: Errors, x: np.ndarray, rng: np.random.Generator) -> Found:
    """The posterior around an optimum."""
    slopes, left = errors.slopes(x), errors(x[None])[0]
    scale = float(np.mean(left**2))
    told = np.sum(slopes**2, axis=0) * (_HIGH - _LOW) ** 2 > 100 * scale  # a tenth of the prior's width would be seen
    known = slopes[:, told]
    curvature = np.linalg.pinv(known.T @ known, hermitian=True)
    blocks = errors.blocks
    scores = np.stack([np.bincount(blocks, weights=each * left, minlength=blocks.max() + 1) for each in known.T], 1)
    n, free = int(np.sum(np.any(scores != 0, axis=1))), int(told.sum())
    spread = curvature @ scores.T @ scores @ curvature * n / max(n - free, 1)
    sizes, ways = np.linalg.eigh(0.5 * (spread + spread.T))
    bell = rng.standard_normal((DRAWS, free)) / np.sqrt(rng.chisquare(max(n - free, 3), (DRAWS, 1)) / max(n - free, 3))
    drawn = rng.uniform(_LOW, _HIGH, (DRAWS, len(x)))  # as before the log, where it tells nothing
    drawn[:, told] = np.clip(x[told] + bell * np.sqrt(np.maximum(sizes, 0)) @ ways.T, _LOW[told], _HIGH[told])
    values = np.exp(drawn)
    t1, t2 = constants(values[:, 4], values[:, 5])
    draws = dict(zip(("x_plus", "x_minus", "y_plus", "y_minus"), values[:, :4].T, strict=True))
    left_over = float(np.sqrt(scale))
    draws |= {"t1": t1, "t2": t2, "acceleration": values[:, 6]}
    return Found(draws, left_over, bool(told[6]), left_over < errors.allowed)
