"""A hierarchical bootstrap: samples (runs, seeds, scenarios) drawn anew axis by axis, figures studentised.

Each axis that is drawn at random gets weights, how often each of its members was drawn; axes cross, so a member's
weight is the product (the pigeonhole bootstrap, Owen 2007). Seeds are drawn once for all samples, which keeps pairs
together; seeds that only some samples have are drawn among themselves. A statistic gives, with each value, the
*influence* of every member on it; their mean squares are its variance, and that of a difference follows from the pairs'
products.

The generator's seed is fixed: the same samples give the same intervals to the last digit.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse, stats

from .intervals import LEVEL, TRIMMED, Interval, Sample

COUNT = 1000
FEWEST = 5
"""Members of an axis below which Student's t is used: a bootstrap of so few repeats itself."""

EXACT = 1e-10
"""Share of the values below which a difference is rounding: the time of a job may be the same on every seed."""

LEAST = 0.01
"""Share of the standard error that a bootstrap sample's counts for at least. Where one seed in twenty differs, every
third bootstrap sample is without it and would estimate no error at all."""

_CHUNK = 1_000_000
_SEED = 7

Weights = tuple[np.ndarray | None, ...]
"""Of runs (B, R) and seeds (B, S); None for an axis that is not drawn. Scenarios stay as they are."""

Statistic = Callable[[np.ndarray, Weights], tuple[np.ndarray, Weights]]
"""From values (R, S, C) and weights, which add up to the number of members, to the statistic (B,) and its influences,
shaped as the weights."""


def pooled(power: float, log: bool = True) -> Statistic:
    """Logarithm of a suite's figure: geometric mean over runs and scenarios of the power mean over those seeds in which
    the run did not fail (is finite). Of each run and scenario there must be one.

    Args:
        power: of the mean over the seeds, 2 for the root mean square.
        log: False for the figure itself, with the plain mean over runs and scenarios; ``power`` is 1 then.
    """

    def statistic(values: np.ndarray, weights: Weights) -> tuple[np.ndarray, Weights]:
        sound = np.isfinite(values)
        powers, one = np.where(sound, values, 0.0) ** power, sound.astype(float)
        total, count = _over_seeds(powers, weights[1]), _over_seeds(one, weights[1])
        with np.errstate(divide="ignore", invalid="ignore"):
            whole = powers.sum(axis=1) / one.sum(axis=1)
            mean = np.where(count > 0, total / count, whole)  # of a sample that holds failed runs only, nothing new
            level, slope = (np.log(mean) / power, mean) if log else (mean, np.ones_like(mean))
            shares = np.where((slope > 0) & (count > 0), 1.0 / (slope * count), 0.0)
            others = np.where(count > 0, (1.0 if log else mean) / count, 0.0)
        by_level, ones = (x.transpose(0, 2, 1).reshape(-1, values.shape[1]) for x in (powers, one))

        def of_seeds(kept: np.ndarray) -> np.ndarray:
            """How much each seed moves the value, but for what all have in common."""
            moved = (kept * shares).reshape(len(mean), -1) @ by_level
            return (moved if sound.all() else moved - (kept * others).reshape(len(mean), -1) @ ones) / power

        return _of_levels(level, weights, of_seeds)

    return statistic


pooled_mean = pooled(1.0, log=False)
"""Mean over runs and scenarios of the mean over the seeds, of figures that may be zero."""

log_score = pooled(2.0)
"""Logarithm of the followers' score: geometric mean over runs and scenarios of the root mean square over seeds."""


def _over_seeds(values: np.ndarray, weights: np.ndarray | None) -> np.ndarray:
    """Means over the seeds, (B, R, C)."""
    if weights is None:
        return values.mean(axis=1)[None]
    r, s, c = values.shape
    return (weights @ values.transpose(1, 0, 2).reshape(s, r * c)).reshape(-1, r, c) / s


def _of_levels(level: np.ndarray, weights: Weights, of_seeds: Callable) -> tuple[np.ndarray, Weights]:
    """The mean of ``level`` (B, R, C) over runs and scenarios; ``of_seeds`` gives the seeds' influences of (B, R, C)
    times it."""
    kept = _times(np.ones((1, *level.shape[1:])), (weights[0], None), "brc") / level[0].size
    value = (kept * level).sum(axis=(1, 2))
    by_run = None if weights[0] is None else level.mean(axis=2)
    return value, (by_run, None if weights[1] is None else of_seeds(kept))


def mean(values: np.ndarray, weights: Weights) -> tuple[np.ndarray, Weights]:
    """Mean of all values."""
    total = _times(values[None], weights, "brsc").sum(axis=(1, 2, 3)) / values.size
    return total, _sums(values.reshape(1, -1), weights, list(np.indices(values.shape).reshape(3, -1)[:2]), values.size)


def mean_of_middle(values: np.ndarray, weights: Weights) -> tuple[np.ndarray, Weights]:
    """Interquartile mean of all values; its influences are those of a trimmed mean, the rest drawn in to its ends."""
    total = values.size
    cut = int(TRIMMED * total)
    count = total - 2 * cut
    order = np.argsort(values, axis=None, kind="stable")
    ranked, members = values.ravel()[order], np.unravel_index(order, values.shape)[:2]
    drawn = np.ones((1, total))
    for own, index in zip(weights, members, strict=True):
        if own is not None:
            drawn = drawn * own[:, index]
    up_to = np.cumsum(drawn, axis=1)
    kept = np.diff(np.clip(up_to, cut, total - cut), axis=1, prepend=float(cut))
    finite = np.isfinite(ranked)
    value = kept @ np.where(finite, ranked, 0.0) / count
    lost = kept @ np.where(finite, 0.0, np.sign(ranked))
    ends = [ranked[np.argmax(up_to > edge, axis=1)][:, None] for edge in (cut, total - cut - 0.5)]
    within = np.clip(ranked, *ends)
    within = np.where(np.isfinite(within), within, 0.0)  # where the middle itself is without end, its value says so
    with np.errstate(invalid="ignore"):
        return np.where(lost == 0, value, np.sign(lost) * np.inf), _sums(within, weights, members, count)


def _sums(values: np.ndarray, weights: Weights, members: Sequence[np.ndarray], count: int) -> Weights:
    """Influences on a mean of ``count`` of the values (B, n), whose places on the axes that may be drawn are
    ``members``: of each axis' members the sum over the others."""
    out: list[np.ndarray | None] = []
    for axis, own in enumerate(weights):
        if own is None:
            out.append(None)
            continue
        others = values
        for other, index in zip(weights, members, strict=True):
            if other is not None and other is not own:
                others = others * other[:, index]
        places = (members[axis], np.arange(values.shape[1]))
        one = sparse.csr_array((np.ones(values.shape[1]), places), shape=(own.shape[1], values.shape[1]))
        out.append((one @ others.T).T * (own.shape[1] / count))
    return tuple(out)


def _times(array: np.ndarray, weights: Weights, axes: str) -> np.ndarray:
    """An array whose axes are ``brsc`` or ``brc``, times the weights that there are."""
    for own, axis in zip(weights, "rs", strict=True):
        if own is not None:
            array = array * own.reshape(*(own.shape[0] if a == "b" else own.shape[1] if a == axis else 1 for a in axes))
    return array


# ------------------------------------------------------------------------------------------------------- resampling


@dataclass(frozen=True)
class Replicates:
    """A statistic of several samples, as measured and of every bootstrap sample.

    Attributes:
        value: (K,), as measured.
        spread: (K, K), estimated covariance of the values.
        values: (B, K), of the bootstrap samples.
        spreads: (B, K, K), the covariance that each bootstrap sample would estimate.
        freedom: (K,), degrees of freedom where an axis has too few members for a bootstrap; 0 of one, inf of enough.
    """

    value: np.ndarray
    spread: np.ndarray
    values: np.ndarray
    spreads: np.ndarray
    freedom: np.ndarray

    def interval(self, weights: Sequence[float], level: float = LEVEL) -> Interval:
        """A linear combination of the values with its interval: bootstrap-t, equal tails.

        Of one draw there is none; of fewer than :data:`FEWEST` it is Student's.
        """
        w = np.asarray(weights, float)
        used = np.flatnonzero(w)
        value = float(np.sum(w[used] * self.value[used]))
        freedom = self.freedom[used].min(initial=np.inf)
        if not freedom or not np.isfinite(value):
            return Interval(value)
        error, deviations = self._studentised(w[None])
        if error[0] == 0:
            return Interval(value, value, value)
        tails = (0.5 - level / 2, 0.5 + level / 2)
        if np.isfinite(freedom):
            low, high = stats.t.ppf(tails, freedom)
        else:
            finite = deviations[np.isfinite(deviations[:, 0]), 0]
            low, high = np.quantile(finite, tails, method="closest_observation")
        below, above = self._endless(w, tails[0])
        ends = float(value - high * error[0]), float(value - low * error[0])
        return Interval(value, -np.inf if below else ends[0], np.inf if above else ends[1])

    def _endless(self, w: np.ndarray, tail: float) -> tuple[bool, bool]:
        """Whether more than a tail of the bootstrap samples are infinitely low, or high: failures that took over."""
        with np.errstate(invalid="ignore"):
            moved = np.sum(np.where(w == 0, 0.0, self.values * w), axis=1)
        return bool(np.mean(moved == -np.inf) > tail), bool(np.mean(moved == np.inf) > tail)

    def better(self, level: float = LEVEL) -> np.ndarray:
        """(K, K): whether the first has a lower value than the second, all such statements together at ``level``.

        The critical value is the quantile of the largest studentised difference of all pairs in a bootstrap sample.
        """
        k = len(self.value)
        found = np.zeros((k, k), bool)
        first, second = np.triu_indices(k, 1)
        freedom = np.minimum(self.freedom[first], self.freedom[second])
        first, second, freedom = first[freedom > 0], second[freedom > 0], freedom[freedom > 0]
        if not len(first):
            return found
        pairs = np.zeros((len(first), k))
        pairs[np.arange(len(first)), first], pairs[np.arange(len(first)), second] = 1.0, -1.0
        error, deviations = self._studentised(pairs)
        most, enough = stats.t.ppf(0.5 + level / 2, freedom), np.isinf(freedom)
        if enough.any():
            most[enough] = np.quantile(np.abs(deviations[:, enough]).max(axis=1), level, method="higher")
        difference, least = self.value[first] - self.value[second], np.zeros(len(error))
        np.multiply(most, error, out=least, where=error > 0)
        np.maximum(least, self._rounding, out=least)
        found[first, second] = difference < -least
        found[second, first] = difference > least
        return found

    @property
    def _rounding(self) -> float:
        return EXACT * float(np.abs(self.value[np.isfinite(self.value)]).max(initial=0.0))

    def _studentised(self, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Standard errors (n,) of the combinations (n, K), and deviations (B, n) of the bootstrap samples in theirs."""
        error = np.sqrt(np.maximum(np.einsum("nj,jk,nk->n", weights, self.spread, weights), 0.0))
        errors = np.sqrt(np.maximum(np.einsum("nj,bjk,nk->bn", weights, self.spreads, weights), 0.0))
        moved = np.einsum("bk,nk->bn", self.values - self.value, weights)
        rounding = self._rounding
        error = np.where(error <= rounding, 0.0, error)
        with np.errstate(divide="ignore", invalid="ignore"):
            return error, np.where(np.abs(moved) <= rounding, 0.0, moved / np.maximum(errors, LEAST * error))


def replicate(samples: Sequence[Sample], statistic: Statistic, *, count: int = COUNT) -> Replicates:
    """Bootstraps a statistic of several samples of the same scenarios.

    Args:
        samples: paired where they share seeds.
        statistic: such as :func:`log_score`.
        count: bootstrap samples.
    """
    labels = {seed: i for i, seed in enumerate(dict.fromkeys(s for sample in samples for s in sample.seeds))}
    where = [np.array([labels[seed] for seed in sample.seeds]) for sample in samples]
    owners = np.zeros((len(labels), len(samples)), bool)
    for k, index in enumerate(where):
        owners[index, k] = True
    random = np.random.default_rng(_SEED)
    together = np.unique(owners, axis=0, return_inverse=True)[1].ravel()
    seeds = np.ones((count + 1, len(labels)))
    for group in range(together.max() + 1):
        members = np.flatnonzero(together == group)
        seeds[1:, members] = _draw(random, len(members), count)
    runs = [_with_first(_draw(random, n, count)) if n > 1 else None for n in (len(s.values) for s in samples)]

    values = np.empty((count + 1, len(samples)))
    spreads = np.zeros((count + 1, len(samples), len(samples)))
    size = max(1, _CHUNK // max(sample.values.size for sample in samples))
    for at in range(0, count + 1, size):
        part = slice(at, at + size)
        drawn = len(seeds[part])
        of_seeds = np.zeros((drawn, len(labels), len(samples)))
        for k, sample in enumerate(samples):
            weights: Any = tuple(None if w is None else w[part] for w in (runs[k], seeds[:, where[k]]))
            values[part, k], influence = statistic(sample.values, weights)
            scaled = [_scaled(i, w) for i, w in zip(influence, weights, strict=True)]
            of_seeds[:, where[k], k] = scaled[1]
            if runs[k] is not None:
                spreads[part, k, k] += np.sum(weights[0] * scaled[0] ** 2, axis=1)
        spreads[part] += _products(seeds[part], of_seeds)
    freedom = [min(_freedom(len(s.seeds)), _freedom(len(s.values), single=np.inf)) for s in samples]
    return Replicates(values[0], spreads[0], values[1:], spreads[1:], np.array(freedom, float))


def _freedom(members: int, single: float = 0.0) -> float:
    """Degrees of freedom of an axis; a single run is no draw of runs, a single seed is one of seeds."""
    return single if members == 1 else np.inf if members >= FEWEST else members - 1.0


def _draw(random: np.random.Generator, members: int, count: int) -> np.ndarray:
    return random.multinomial(members, np.full(members, 1.0 / members), size=count).astype(float)


def _with_first(weights: np.ndarray) -> np.ndarray:
    """Before the bootstrap samples, the sample as it was measured."""
    return np.concatenate([np.ones((1, weights.shape[1])), weights])


def _scaled(influence: np.ndarray | None, weights: np.ndarray | None) -> Any:
    """Influences with the weighted mean 0, scaled so that their summed squares are the variance of the value."""
    if influence is None or weights is None or weights.shape[1] < 2:
        return 0.0
    members = weights.shape[1]
    centred = influence - np.mean(weights * influence, axis=1, keepdims=True)
    return centred / np.sqrt(members * (members - 1))


def _products(weights: np.ndarray, influence: np.ndarray) -> np.ndarray:
    """Weighted sums of products of influences (B, n, K): (B, K, K)."""
    return np.swapaxes(influence * weights[:, :, None], 1, 2) @ influence
