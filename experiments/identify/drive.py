"""The Z drive from a motion log: prediction errors of the encoder, over many candidate axes at once.

1. slow moves alone, with which a log begins and which no limit touches: a grid of axes without dead time, each compared
   at every dead time, which only delays what it does; then least squares for loop, friction and dead time;
2. quicker moves as well: a grid of accelerations and jerks around what is known, least squares for all numbers;
3. the whole log. A drive at its limits is chaotic: where a limit is wrong by a thousandth, a quick move may end
   anywhere. So segments count the less the more of them is left, as outliers do (Holland and Welsch 1977), and come in
   as the axis comes nearer. Where all that ends in a valley beside the right one, CMA-ES over the whole prior;
4. where quick moves leave more than slow ones all the same, each segment's errors have a scale of their own: how a
   drive gets out of its limits is its maker's, and must not spoil what slow moves tell of the loop;
5. how sure that is: draws of the posterior (:mod:`.posterior`). A dead time acts in substeps of 50 µs: within one, all
   are equally likely.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from cmaes import CMA

from ...envs.plant import candidates, z_axis
from ...envs.plant.controller import PERIOD
from ...envs.plant.machine import SUBSTEPS
from . import posterior
from .residuals import count_of

PRIOR = {
    "bandwidth": (15.0, 250.0),
    "zeta": (0.3, 1.6),
    "speed": (100.0, 1500.0),
    "acceleration": (3e3, 4e4),
    "jerk": (2e5, 2e7),
    "friction": (100.0, 3000.0),
    "bristle": (1e-3, 0.03),
    "stiction": (1.0, 2.5),
    "stribeck": (0.5, 20.0),
}
"""Ranges of an axis, uniform in the logarithm, in the units of a machine's file [A]."""

LATEST = 22.0
"""ms of dead time and latency."""

SEGMENT = 250
"""Samples whose mean is free: what a log and a model have drifted apart is not held against the axis."""

SLOW, QUICK, ENOUGH = 55.0, 250.0, 3000
"""mm/s that commands of slow moves do not exceed, and those of quicker ones, which are not at top speed; samples that
such a beginning of a log must have to count as one [A]."""

STARTS = 3
"""Places from which least squares begins."""

QUIETEST = 1e-3
"""µm that slow moves are taken to leave at least: an ideal encoder leaves nothing to compare with."""

GATHERINGS, JUMPS = 6, 60
"""Times that segments which were left out are looked at again; points of each width that are tried in between."""

LOUD, ODD = 2.0, 0.25
"""Times what slow moves leave, from which on a segment is not yet explained; share of them from which on the model is
likely to be another one, and there is no point in going on [A]."""

GRID = {
    "bandwidth": tuple(np.geomspace(18, 220, 9)),
    "zeta": (0.45, 0.7, 1.0),
    "friction": (300.0, 1000.0),
    "jerk": (7e5, 2.5e6, 1e7),
}
"""Where the first look begins."""

LIMITS = {"acceleration": tuple(np.geomspace(3.2e3, 3.8e4, 40)), "jerk": (0.5, 1.0, 2.0)}
"""Where the second begins: mm/s², and shares of the jerk that slow moves seem to have."""

GENERATIONS, EXPLAINED, AT_ONCE = 60, 2.0, 64
"""Generations of a search over the whole prior, and µm of RMS error beyond the encoder's rounding up to which there is
none: a valley beside the right one leaves tens to hundreds of µm; axes in memory at a time."""

APART = 4.0
"""Times what slow moves leave, from which on a segment is said not to be explained."""

NAMES = tuple(PRIOR)
_LOW, _HIGH = np.log(np.array(list(PRIOR.values()))).T


@dataclass(frozen=True)
class Found:
    """Axes from the posterior.

    Attributes:
        draws: by key of a machine's ``[axis]``, each of shape (draws,); ``dead_time`` in s holds the latency.
        best: the most likely axis, without converter and backlash.
        left: µm, RMS of what the best axis leaves of the encoder, where the segments that it explains less count less.
        slow: µm, RMS that it leaves of slow moves beyond the encoder's rounding; each segment counts alike.
        apart: share of the log's segments that leave more than :data:`APART` times what slow moves do.
        beyond: µm, RMS that they leave; 0 if there are none.
        spread: factor by which blocks of what is left widen the draws at most.
        effective: draws that the importance sample is worth.
    """

    draws: dict[str, np.ndarray]
    best: z_axis.Params
    left: float
    spread: float
    effective: float
    slow: float = 0.0
    apart: float = 0.0
    beyond: float = 0.0


def axis(x: np.ndarray, late: float) -> z_axis.Params:
    """The axis of logarithms ``x``, in the order of :data:`NAMES`, and a delay in substeps; its converter is ideal."""
    v = dict(zip(NAMES, np.exp(x).tolist(), strict=True))
    omega = 2 * np.pi * v.pop("bandwidth")
    return z_axis.Params()._replace(omega=omega, dead_time=(late + 0.5) / SUBSTEPS, dac=0.0, backlash=0.0, **v)


def beginnings(command: np.ndarray) -> tuple[int, int]:
    """Samples of a log up to which its commands, mm/s, are those of slow moves, and of quicker ones; what has less than
    :data:`ENOUGH` of the one begins with the other, and the whole log is the beginning of one that has neither."""
    found = []
    for most in (SLOW, QUICK):
        beyond = np.flatnonzero(np.abs(command) > most)
        found.append(int(beyond[0]) if len(beyond) else len(command))
    slow, quick = (samples if samples >= ENOUGH else None for samples in found)
    return slow or quick or len(command), quick or len(command)


class Errors:
    """What axes leave of a log's encoder, µm, segment by segment.

    Samples that read the same count one after the other have one rounding between them, so they weigh as one.
    """

    def __init__(self, command: np.ndarray, encoder: np.ndarray) -> None:
        self.command, self.encoder = command, encoder
        edges = np.flatnonzero(np.diff(encoder, prepend=np.nan, append=np.nan) != 0)
        runs = np.repeat(np.diff(edges), np.diff(edges))
        whole = len(encoder) // SEGMENT * SEGMENT
        self._weight = 1.0 / np.sqrt(runs[:whole].reshape(-1, SEGMENT))
        self._weight[0, :60] = 0.0
        moving = np.abs(encoder[20:] - encoder[:-20]) > 0
        self.moving = np.concatenate([np.zeros(20, bool), moving])[:whole] & (np.arange(whole) >= 60)
        """Whether the head moved within the last 20 ms, shape (samples of whole segments,)."""
        self.worth = float(np.sum(self._weight**2)) - len(self._weight)
        """Independent errors that a log is worth."""
        self.fastest = float(np.abs(encoder[20:] - encoder[:-20]).max()) / (20 * PERIOD)
        """mm/s of the log."""
        self.slow, self.quick = beginnings(command)
        """Samples of slow moves, and of quicker ones."""
        self.rounding = count_of(encoder) / np.sqrt(12)
        """µm of RMS error that the encoder's counts alone leave."""

    def __call__(self, axes: list[z_axis.Params]) -> np.ndarray:
        """Shape (axes, samples)."""
        return np.concatenate([self.centred(1e3 * (made - self.encoder)) for made in self.courses(axes)])

    def courses(self, axes: list[z_axis.Params]) -> Iterator[np.ndarray]:
        """Where the motors are, mm, shape (some of the axes, samples)."""
        for i in range(0, len(axes), AT_ONCE):
            yield candidates.courses(axes[i : i + AT_ONCE], self.command, float(self.encoder[0]))[:, :, 0]

    def centred(self, off: np.ndarray) -> np.ndarray:
        """Errors of shape (axes, samples) without the mean of each segment, weighed."""
        cut = off[:, : self._weight.size].reshape(len(off), *self._weight.shape)
        square = self._weight**2
        mean = (cut * square).sum(axis=2) / np.maximum(square.sum(axis=1), 1e-9)
        centred: np.ndarray = (self._weight * (cut - mean[:, :, None])).reshape(len(off), -1)
        return centred

    def plain(self, axis: z_axis.Params) -> np.ndarray:
        """Errors of an axis without the mean of each segment, all alike, shape (samples of whole segments,)."""
        weight = np.where(self._weight > 0, self._weight, 1.0)
        left: np.ndarray = (self([axis]).reshape(weight.shape) / weight).ravel()
        return left

    def rms(self, axes: list[z_axis.Params]) -> np.ndarray:
        """µm, shape (axes,)."""
        left: np.ndarray = np.sqrt(np.sum(self(axes) ** 2, axis=1) / self.worth)
        return left

    def rms_of(self, x: np.ndarray, late: float) -> float:
        """The same of one point, µm."""
        return float(self.rms([axis(x, np.rint(late))])[0])

    def beyond_rounding(self, x: np.ndarray, late: float) -> float:
        """What is left without what the encoder's rounding accounts for, µm."""
        return float(np.sqrt(max(self.rms_of(x, late) ** 2 - self.rounding**2, 0.0)))

    def each(self, axes: list[z_axis.Params]) -> np.ndarray:
        """µm, RMS of each segment, shape (axes, segments)."""
        square = self(axes).reshape(len(axes), *self._weight.shape) ** 2
        rms: np.ndarray = np.sqrt(square.sum(axis=2) / np.maximum(np.sum(self._weight**2, axis=1), 1e-9))
        return rms

    def by_segment(self, x: np.ndarray, late: float) -> np.ndarray:
        """The same of one point, shape (segments,)."""
        segments: np.ndarray = self.each([axis(x, np.rint(late))])[0]
        return segments

    def quiet(self, x: np.ndarray, late: float) -> float:
        """µm that slow moves leave, the median of their segments."""
        return max(float(np.median(self.by_segment(x, late)[: self.slow // SEGMENT])), QUIETEST)

    def scaled(self, scales: np.ndarray) -> "Errors":
        """Those whose segments count by a scale of their own, shape (segments,)."""
        made = Errors(self.command, self.encoder)
        made._weight = self._weight / scales[:, None]
        return made

    def first(self, samples: int) -> "Errors":
        """Those of the beginning of the log."""
        part = Errors(self.command[:samples], self.encoder[:samples])
        part.fastest, part.rounding = self.fastest, self.rounding
        return part

    def of(self, points: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """The same of logarithms and delays in substeps, as a :class:`posterior.Problem` asks."""
        return self([axis(x, cell) for x, cell in zip(points, cells, strict=True)])


def identify(command: np.ndarray, encoder: np.ndarray, seed: int = 0) -> Found:
    """Axes that may have made a log, from its commands, mm/s, and its encoder, mm."""
    errors = Errors(command, encoder)
    begun = _begun(errors)
    x, late = _gathered(errors, *begun, seed)
    x, late = _nearest(errors, x, late)
    left = errors.beyond_rounding(x, late)
    if left > EXPLAINED:
        searched = _nearest(errors, *_searched(errors.first(errors.quick), seed))
        (x, late), left = min(((x, late), left), (searched, errors.beyond_rounding(*searched)), key=lambda e: e[1])
    counted, quiet = errors, 0.0
    if left > EXPLAINED:
        counted, x, late, quiet = _set_apart(errors, *begun)
    cells = np.unique(np.clip(np.rint(late) + np.arange(-1, 2), 0, LATEST * SUBSTEPS - 1))
    rng = np.random.default_rng(seed)
    found = posterior.sampled(posterior.Problem(counted.of, _LOW, _HIGH, errors.worth), x, cells, rng)
    draws = dict(zip(NAMES, np.exp(found.draws).T, strict=True))
    draws["dead_time"] = (found.cells + rng.uniform(0, 1, len(found.cells))) / SUBSTEPS * PERIOD
    middle, cell = np.median(found.draws, axis=0), float(np.median(found.cells))
    best = axis(middle, cell)
    leaves, slow = errors.by_segment(middle, cell), errors.first(errors.slow).beyond_rounding(middle, cell)
    apart = leaves > APART * quiet if quiet > 0.0 else np.zeros(len(leaves), bool)
    beyond = float(np.sqrt(np.mean(leaves[apart] ** 2))) if apart.any() else 0.0
    return Found(draws, best, found.left, found.spread, found.effective, slow, float(apart.mean()), beyond)


def _set_apart(errors: Errors, x: np.ndarray, late: float) -> tuple[Errors, np.ndarray, float, float]:
    """Errors in which segments that leave more than slow moves count less, the axis nearest by them, its delay, and µm
    that slow moves leave."""
    counted, quiet = errors, 0.0
    for rounds in (4, 8):  # scales are soon what they are
        leaves = errors.by_segment(x, late)
        quiet = errors.quiet(x, late)
        counted = errors.scaled(np.maximum(leaves / quiet, 1.0))
        x, late = _nearest(counted, x, late, rounds=rounds)
    return counted, x, late, quiet


def _begun(errors: Errors) -> tuple[np.ndarray, float]:
    """An axis by slow moves, but for its limits, which are by quick ones, and its delay in substeps."""
    quick = errors.first(errors.quick)
    x, late = _slow(errors.first(errors.slow))
    return _nearest(quick, _limited(quick, x, late), late, _FREE)


def _gathered(errors: Errors, x: np.ndarray, late: float, seed: int) -> tuple[np.ndarray, float]:
    """From there on an axis of which the fewest segments leave more than slow moves do, and its delay in substeps."""
    rng = np.random.default_rng(seed)
    for rounds in range(GATHERINGS):
        for _ in range(3):
            leaves, quiet = errors.by_segment(x, late), errors.quiet(x, late)
            counted = errors.scaled(np.maximum(leaves / quiet, 1.0) ** 2)
            x, late = _nearest(counted, x, late, rounds=4)
        loud = float(np.mean(errors.by_segment(x, late) > LOUD * quiet))
        if loud == 0.0 or (rounds > 0 and loud > ODD):
            break
        x = _jumped(errors, counted, x, late, quiet, rng)
    return x, late


def _jumped(
    errors: Errors, counted: Errors, x: np.ndarray, late: float, quiet: float, rng: np.random.Generator
) -> np.ndarray:
    """The best of points around, as far as the segments that count allow: that which least squares cannot step to."""
    _, slopes = posterior.Problem(counted.of, _LOW, _HIGH, errors.worth).slopes(x, np.rint(late))
    known = slopes @ slopes.T / quiet**2 + np.diag(12 / (_HIGH - _LOW) ** 2)
    spread = np.linalg.inv(known)
    away = [width * rng.multivariate_normal(np.zeros(len(x)), spread, JUMPS) for width in (0.5, 1.0, 2.0, 4.0)]
    points = np.clip(x + np.concatenate([np.zeros((1, len(x))), *away]), _LOW, _HIGH)
    costs = np.log1p((errors.each([axis(point, np.rint(late)) for point in points]) / quiet) ** 2).sum(axis=1)
    best: np.ndarray = points[int(np.argmin(costs))]
    return best


_FREE = [NAMES.index(name) for name in ("speed", *LIMITS)]


def _slow(slow: Errors) -> tuple[np.ndarray, float]:
    """The axis nearest by slow moves, and its delay."""
    begun = [_nearest(slow, *start) for start in _looked(slow)]
    return min(begun, key=lambda each: slow.rms_of(*each))


def _limited(quick: Errors, x: np.ndarray, late: float) -> np.ndarray:
    """The same with the best of a grid of limits."""
    points = np.array([x] * (len(LIMITS["acceleration"]) * len(LIMITS["jerk"])))
    pulls, jolts = np.log(list(itertools.product(*LIMITS.values()))).T
    points[:, _FREE[1]], points[:, _FREE[2]] = (
        pulls,
        np.clip(points[:, _FREE[2]] + jolts, _LOW[_FREE[2]], _HIGH[_FREE[2]]),
    )
    costs = quick.rms([axis(point, np.rint(late)) for point in points])
    best: np.ndarray = points[int(np.argmin(costs))]
    return best


def _looked(errors: Errors) -> list[tuple[np.ndarray, float]]:
    """The best few of a grid of axes and delays, no two of them with the same bandwidth and damping."""
    encoder = errors.encoder
    fixed = {"speed": errors.fastest, "acceleration": 3e4, "bristle": 5e-3, "stiction": 1.3,
             "stribeck": 3.0}  # fmt: skip
    points = [fixed | dict(zip(GRID, values, strict=True)) for values in itertools.product(*GRID.values())]
    xs = np.clip(np.log([[point[name] for name in NAMES] for point in points]), _LOW + 0.01, _HIGH - 0.01)
    costs = np.empty((len(xs), round(LATEST)))
    made = np.concatenate(list(errors.courses([axis(x, 0.0) for x in xs])))
    for late in range(round(LATEST)):
        begun = np.full((len(made), late), encoder[0])
        delayed = np.concatenate([begun, made[:, : made.shape[1] - late]], axis=1)
        costs[:, late] = np.mean(errors.centred(1e3 * (delayed - encoder)) ** 2, axis=1)
    kept: dict[tuple[float, float], tuple[np.ndarray, float]] = {}
    for at in np.argsort(costs, axis=None):
        i, late = divmod(int(at), costs.shape[1])
        kept.setdefault((points[i]["bandwidth"], points[i]["zeta"]), (xs[i], late * SUBSTEPS + 0.5 * SUBSTEPS))
        if len(kept) == STARTS:
            break
    return list(kept.values())


def _searched(errors: Errors, seed: int) -> tuple[np.ndarray, float]:
    """An axis near the best, by CMA-ES over all numbers at once."""
    low, high = np.append(_LOW, 0.0), np.append(_HIGH, LATEST * SUBSTEPS)
    search = CMA(mean=np.full(len(low), 0.5), sigma=0.25, bounds=np.tile([0.0, 1.0], (len(low), 1)), seed=seed,
                 population_size=64)  # fmt: skip
    best, least = search.mean, np.inf
    for _ in range(GENERATIONS):
        asked = [search.ask() for _ in range(search.population_size)]
        at = low + (high - low) * np.array(asked)
        cost = errors.rms([axis(p[:-1], np.floor(p[-1])) for p in at])
        search.tell([(a, float(c)) for a, c in zip(asked, cost, strict=True)])
        if cost.min() < least:
            best, least = asked[int(np.argmin(cost))], float(cost.min())
    at = low + (high - low) * best
    return at[:-1], float(at[-1])


def _nearest(
    errors: Errors, x: np.ndarray, late: float, free: Sequence[int] = (), rounds: int = 25
) -> tuple[np.ndarray, float]:
    """Least squares from an axis and a delay on, which is taken between two whole substeps; of the numbers ``free``
    alone, if some are given."""
    low, high = np.append(_LOW, 0.0), np.append(_HIGH, LATEST * SUBSTEPS)
    at, width = np.append(x, late), np.append(_HIGH - _LOW, 40.0)
    chosen, damping = list(free or range(len(at))), 1e-2
    for _ in range(rounds):
        here, slopes = _slopes(errors, at, chosen, high)
        cost = float(here @ here)
        weak = cost / errors.worth / width[chosen] ** 2  # what the prior weighs, where the log does not tell
        normal, push = slopes @ slopes.T, slopes @ here
        better = False
        while not better and damping < 1e8:
            factors = damping * 10.0 ** np.arange(-2.0, 5.0, 2.0)
            tries = np.array([at] * len(factors))
            for one, f in zip(tries, factors, strict=True):
                one[chosen] -= np.linalg.solve(normal + np.diag(f * np.diag(normal) + weak), push)
            tries = np.clip(tries, low, high)
            costs = np.sum(_between(errors, tries) ** 2, axis=1)
            best = int(np.argmin(costs))
            better = bool(costs[best] < cost)
            damping = max(1e-9, float(factors[best])) if better else 1e6 * damping
        if not better:
            break
        at = tries[best]
        if costs[best] > cost * (1 - 1e-5):
            break
    return at[:-1], float(at[-1])


def _slopes(errors: Errors, at: np.ndarray, chosen: list[int], high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Errors at a point whose last number is a delay in substeps, and their derivatives by the chosen numbers, of which
    the delay is the last: by wide steps, and by finer ones where those are many deviations wide."""
    smooth = [i for i in chosen if i < len(NAMES)]
    here, slopes = posterior.slopes(lambda points: _between(errors, points), at, high, errors.worth, smooth)
    if len(NAMES) in chosen:
        k = np.floor(at[-1])
        two = errors([axis(at[:-1], k), axis(at[:-1], k + 1.0)])
        slopes = np.concatenate([slopes, two[1:] - two[:1]])
    return here, slopes


def _between(errors: Errors, points: np.ndarray) -> np.ndarray:
    """Errors at points whose last number is a delay in substeps, taken between the two whole ones."""
    whole = np.floor(points[:, -1])
    axes = [axis(p[:-1], k + more) for p, k in zip(points, whole, strict=True) for more in (0.0, 1.0)]
    both = errors(axes).reshape(len(points), 2, -1)
    share = (points[:, -1] - whole)[:, None]
    mixed: np.ndarray = (1 - share) * both[:, 0] + share * both[:, 1]
    return mixed
