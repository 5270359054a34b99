"""The Z drive from a motion log: prediction errors of the encoder, over many candidate axes at once.

1. CMA-ES over the whole prior, then Gauss and Newton's steps from its best, whose derivatives and
   damping factors are candidates of the same call;
2. how sure that is: importance sampling around the optimum with a proposal that adapts to what it has found (Cappé et
   al. 2004). It needs no bell-shaped posterior, only one that the heavy-tailed proposal covers.

The scale of the likelihood is that of what the best axis leaves, and its correlation time divides the samples. A dead
time acts in substeps of 50 µs: within one, all are equally likely, and the posterior says so.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from cmaes import CMA
from scipy import special, stats

from ...envs.plant import candidates, z_axis
from ...envs.plant.controller import PERIOD
from ...envs.plant.machine import SUBSTEPS

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

FIRST, GENERATIONS, DRAWS, ROUNDS, AT_ONCE = 18000, 60, 256, 5, 64
"""Samples and generations of the first look; axes of each round of sampling, and rounds; in memory at a time."""

STARTS, EXPLAINED = 4, 2.0
"""Searches over the whole prior at most, and µm of RMS error from which on there is no other: a search may end in a
valley beside the right one, which leaves hundreds of µm."""

NAMES = tuple(PRIOR)
_LOW, _HIGH = np.log(np.array(list(PRIOR.values()))).T


@dataclass(frozen=True)
class Found:
    """Axes from the posterior.

    Attributes:
        draws: by key of a machine's ``[axis]``, each of shape (draws,); ``dead_time`` in s holds the latency.
        left: µm, RMS of what the best axis leaves of the encoder.
        correlated: samples over which that is correlated.
        effective: draws that the importance sample is worth.
    """

    draws: dict[str, np.ndarray]
    left: float
    correlated: float
    effective: float


def axis(x: np.ndarray, late: float) -> z_axis.Params:
    """The axis of logarithms ``x``, in the order of :data:`NAMES`, and a delay in substeps; its converter is ideal."""
    v = dict(zip(NAMES, np.exp(x).tolist(), strict=True))
    omega = 2 * np.pi * v.pop("bandwidth")
    return z_axis.Params()._replace(omega=omega, dead_time=(late + 0.5) / SUBSTEPS, dac=0.0, backlash=0.0, **v)


class Errors:
    """What axes leave of a log's encoder, µm, segment by segment."""

    def __init__(self, command: np.ndarray, encoder: np.ndarray) -> None:
        self.command, self.encoder = command, encoder
        moving = np.abs(encoder[20:] - encoder[:-20]) > 0
        some = np.concatenate([np.zeros(20, bool), moving])
        self.used = some & (np.arange(len(encoder)) < len(encoder) // SEGMENT * SEGMENT)
        self.used[:60] = False

    def __call__(self, axes: list[z_axis.Params]) -> np.ndarray:
        """Shape (axes, samples that are used)."""
        out = []
        for i in range(0, len(axes), AT_ONCE):
            made = candidates.courses(axes[i : i + AT_ONCE], self.command, float(self.encoder[0]))[:, :, 0]
            out.append(self._centred(1e3 * (made - self.encoder)))
        return np.concatenate(out)

    def _centred(self, off: np.ndarray) -> np.ndarray:
        whole = off.shape[1] // SEGMENT * SEGMENT
        cut = off[:, :whole].reshape(len(off), -1, SEGMENT)
        used = self.used[:whole].reshape(-1, SEGMENT)
        mean = (cut * used).sum(axis=2) / np.maximum(used.sum(axis=1), 1)
        centred: np.ndarray = (cut - mean[:, :, None]).reshape(len(off), whole)[:, self.used[:whole]]
        return centred


def correlation_time(residual: np.ndarray) -> float:
    """Samples over which a residual is correlated: the sum of its autocorrelation up to its first zero."""
    r = residual - residual.mean()
    spectrum = np.abs(np.fft.rfft(r, 2 * len(r))) ** 2
    rho = np.fft.irfft(spectrum)[:500]
    rho = rho / max(rho[0], 1e-300)
    ends = np.flatnonzero(rho <= 0.02)
    return float(max(1.0, 1.0 + 2.0 * rho[1 : ends[0] if len(ends) else 500].sum()))


def identify(command: np.ndarray, encoder: np.ndarray, seed: int = 0) -> Found:
    """Axes that may have made a log, from its commands, mm/s, and its encoder, mm."""
    rng = np.random.default_rng(seed)
    errors = Errors(command, encoder)
    x, late, least = np.zeros(0), 0.0, np.inf
    for start in range(STARTS):
        near = _nearest(errors, *_first(command, encoder, seed + 1000 * start))
        left = float(np.sqrt(np.mean(errors([axis(near[0], np.floor(near[1]))]) ** 2)))
        if left < least:
            (x, late), least = near, left
        if least < EXPLAINED:
            break
    return _sampled(errors, x, late, rng)


def _first(command: np.ndarray, encoder: np.ndarray, seed: int) -> tuple[np.ndarray, float]:
    """An axis near the best over the first part of the log, by CMA-ES over all numbers at once."""
    part = slice(0, min(len(command), FIRST))
    errors = Errors(command[part], encoder[part])
    low, high = np.append(_LOW, 0.0), np.append(_HIGH, LATEST * SUBSTEPS)
    width = high - low
    search = CMA(
        mean=np.full(len(low), 0.5),
        sigma=0.25,
        bounds=np.tile([0.0, 1.0], (len(low), 1)),
        seed=seed,
        population_size=64,
    )
    best, least = search.mean, np.inf
    for _ in range(GENERATIONS):
        asked = [search.ask() for _ in range(search.population_size)]
        at = low + width * np.array(asked)
        cost = np.sqrt(np.mean(errors([axis(p[:-1], np.floor(p[-1])) for p in at]) ** 2, axis=1))
        search.tell([(a, float(c)) for a, c in zip(asked, cost, strict=True)])
        if cost.min() < least:
            best, least = asked[int(np.argmin(cost))], float(cost.min())
    at = low + width * best
    return at[:-1], float(at[-1])


_STEP = 1e-4


def _between(errors: Errors, points: np.ndarray) -> np.ndarray:
    """Errors at points whose last number is a delay in substeps, taken between the two whole ones."""
    whole = np.floor(points[:, -1])
    axes = [axis(p[:-1], k + more) for p, k in zip(points, whole, strict=True) for more in (0.0, 1.0)]
    both = errors(axes).reshape(len(points), 2, -1)
    share = (points[:, -1] - whole)[:, None]
    mixed: np.ndarray = (1 - share) * both[:, 0] + share * both[:, 1]
    return mixed


def _nearest(errors: Errors, x: np.ndarray, late: float, rounds: int = 25) -> tuple[np.ndarray, float]:
    """Least squares from a point on, by Levenberg and Marquardt with several damping factors at once."""
    low, high = np.append(_LOW, 0.0), np.append(_HIGH, LATEST * SUBSTEPS)
    at, width = np.append(x, late), np.append(_HIGH - _LOW, 40.0)
    step, damping = np.append(np.full(len(NAMES), _STEP), 0.0), 1e-2
    cost = np.inf
    for _ in range(rounds):
        signs = np.where(at + step > high, -1.0, 1.0)
        points = np.concatenate([at[None], at + np.diag(step * signs)[:-1]])
        made = _between(errors, points)
        here, k = made[0], np.floor(at[-1])
        two = errors([axis(at[:-1], k), axis(at[:-1], k + 1.0)])
        slopes = np.stack([*((made[1:] - here) / (step * signs)[:-1, None]), two[1] - two[0]])
        cost = float(here @ here)
        weak = cost / len(here) / width**2  # what the prior weighs, for directions that the log does not tell
        normal, push = slopes @ slopes.T, slopes @ here
        tries = []
        for factor in damping * 10.0 ** np.arange(-3.0, 5.0):
            matrix = normal + np.diag(factor * np.diag(normal) + weak)
            tries.append(np.clip(at - np.linalg.solve(matrix, push), low, high))
        costs = np.sum(_between(errors, np.array(tries)) ** 2, axis=1)
        best = int(np.argmin(costs))
        if costs[best] >= cost * (1 - 1e-5):
            break
        at, damping = tries[best], max(1e-9, damping * 10.0 ** (best - 3.0))
    return at[:-1], float(at[-1])


def _sampled(errors: Errors, x: np.ndarray, late: float, rng: np.random.Generator) -> Found:
    """The posterior around an optimum."""
    cells = np.unique(np.clip(np.floor(late) + np.arange(-1, 3), 0, LATEST * SUBSTEPS - 1))
    refined = [_in_cell(errors, x, cell) for cell in cells]
    best = int(np.argmin([cost for _, cost, _ in refined]))
    x, cost, slopes = refined[best]
    left = errors([axis(x, cells[best])])[0]
    scale = float(np.sqrt(np.mean(left**2)))
    tau = max(correlation_time(left), _overdispersion(slopes, left))
    unit = scale**2 * tau
    prior = (_HIGH - _LOW) ** 2 / 12
    spread = np.linalg.inv(slopes @ slopes.T / unit + np.diag(1 / prior)) * 1.3
    middle, size = x, len(x)
    odds = np.array([-(c - cost) / (2 * unit) for _, c, _ in refined])
    odds = 0.9 * special.softmax(odds) + 0.1 / len(cells)
    xs: list[np.ndarray] = []
    ks: list[np.ndarray] = []
    likely: list[np.ndarray] = []
    proposed: list[tuple[Any, np.ndarray]] = []
    for _ in range(ROUNDS):
        proposal = stats.multivariate_t(middle, spread, df=5, allow_singular=True, seed=rng)
        x_new = np.atleast_2d(proposal.rvs(DRAWS))
        k_new = rng.choice(len(cells), DRAWS, p=odds)
        inside = np.all((x_new > _LOW) & (x_new < _HIGH), axis=1)
        fine = np.full(DRAWS, -np.inf)
        if inside.any():
            off = errors([axis(v, cells[k]) for v, k in zip(x_new[inside], k_new[inside], strict=True)])
            fine[inside] = -np.sum(off**2, axis=1) / (2 * unit)
        xs, ks, likely = [*xs, x_new], [*ks, k_new], [*likely, fine]
        proposed.append((proposal, odds))
        every, chosen, target = np.concatenate(xs), np.concatenate(ks), np.concatenate(likely)
        density = [p.logpdf(every) + np.log(o[chosen]) for p, o in proposed]
        weight = special.softmax(target - special.logsumexp(density, axis=0))
        worth = 1 / np.sum(weight**2)
        # Too few draws with weight cannot tell a shape: weights are flattened until there are enough.
        flat, power = weight, 1.0
        while 1 / np.sum(flat**2) < 4 * size and power > 1e-4:
            power *= 0.8
            flat = special.softmax(power * (target - special.logsumexp(density, axis=0)))
        middle, spread = flat @ every, 1.2 * np.cov(every.T, aweights=flat)
        odds = np.array([weight[chosen == i].sum() for i in range(len(cells))])
        odds = 0.9 * odds / odds.sum() + 0.1 / len(cells)
    kept = rng.choice(len(every), 1000, p=weight)
    draws = dict(zip(NAMES, np.exp(every[kept]).T, strict=True))
    draws["dead_time"] = (cells[chosen[kept]] + rng.uniform(0, 1, len(kept))) / SUBSTEPS * PERIOD
    return Found(draws, scale, tau, float(worth))


def _overdispersion(slopes: np.ndarray, left: np.ndarray) -> float:
    """How much more the score scatters from second to second than independent errors would let it (the sandwich of
    Huber 1967, as one factor): it holds what counts and the converter's steps leave in one direction for a while."""
    blocks = left.size // (4 * SEGMENT)
    cut = blocks * 4 * SEGMENT
    whitened = np.linalg.solve(np.linalg.cholesky(slopes @ slopes.T + 1e-9 * np.eye(len(slopes))), slopes)
    scores = (whitened[:, :cut] * left[:cut]).reshape(len(slopes), blocks, -1).sum(axis=2)
    return float(np.max(np.sum(scores**2, axis=1)) / np.mean(left**2))


def _in_cell(errors: Errors, x: np.ndarray, cell: float) -> tuple[np.ndarray, float, np.ndarray]:
    """Two more steps with the delay held; the point, its cost and its derivatives, of shape (numbers, samples)."""
    for last in (False, False, True):
        signs = np.where(x + _STEP > _HIGH, -1.0, 1.0)
        made = errors([axis(p, cell) for p in (x, *(x + np.diag(_STEP * signs)))])
        slopes, here = (made[1:] - made[0]) / (_STEP * signs)[:, None], made[0]
        if last:
            break
        weak = np.mean(here**2) / (_HIGH - _LOW) ** 2
        move = np.linalg.solve(slopes @ slopes.T + np.diag(weak), slopes @ here)
        tries = [np.clip(x - share * move, _LOW, _HIGH) for share in (0.0, 0.1, 0.3, 0.6, 1.0)]
        x = tries[int(np.argmin(np.sum(errors([axis(p, cell) for p in tries]) ** 2, axis=1)))]
    return x, float(here @ here), slopes
