"""What happens to the sensor, from a rest log: impulses and drift.

A head that stands still measures one height, so whatever jumps off it for some samples is an impulse. Samples count
that are over six times the noise off the median around them, at those heights where the noise is small enough. Then

- how often: impulses among the samples at which one could begin are a binomial number, whose posterior is a beta
  distribution, exactly, with the prior of Jeffreys 1946;
- how long: lengths are uniform up to the longest, so the posterior over whole numbers is a product. Two impulses in a
  row that look alike are taken for one, and both know how likely that is;
- how high: heights are uniform about A(h) = height/(1 + h/falloff), with noise. Height, falloff and spread are drawn by
  an affine-invariant sampler (Goodman and Weare 2010). The falloff needs impulses at two heights.

Drift changes L·C by drift·(1 − exp(−t/warming)), t since the log began with a cold head. Given the warming it is nearly
linear in the logarithm of the frequency, with a level of its own at each height; the warming is on a grid. A log of a
minute tells drift over warming, and both only when a good part of the warming lies within it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage, special, stats

from .head import Swept, frequency_at, rests, scatter
from .log import PERIOD, Log

PRIOR = {
    "impulses": (0.0, 500.0),
    "impulse_samples": (1.0, 50.0),
    "impulse_height": (0.01, 1.0),
    "impulse_falloff": (0.1, 10.0),
    "impulse_spread": (0.0, 1.0),
    "drift": (-0.01, 0.01),
    "warming": (30.0, 3000.0),
}
"""Ranges in the units of a machine's file [A]; uniform, or in the logarithm."""

LOGARITHMIC = ("impulse_samples", "impulse_height", "impulse_falloff", "warming")
"""Those whose prior is uniform in the logarithm."""

OFF, STAYS, CLEAR, QUIET = 6.0, 4.0, 10.0, 0.02
"""Times the noise that an impulse is off, and in each of its samples; times that all are where more than the lowest
height is of use; mm that the first may be."""

AROUND = 301
"""Samples of the median that impulses are off; the longest have 50."""

BUSY, MOST = 0.3, 600
"""Share of the samples beyond which single impulses are not told apart; impulses whose heights are looked at."""

SCALE, ODD = 0.005, 1e-3
"""Relative error of differences of height by the sweep's head, and share of impulses that are something else [A]."""

WALKERS, STEPS = 64, 900
"""Of the sampler of heights."""

TOLD = 0.4
"""Share of the prior's range that the interval of the warming may have; a wider one goes with too many drifts."""

BLOCK, SETTLED = 250, 2000
"""Samples over which a frequency is averaged for drift, and after which the last fraction of a count has been moved."""


@dataclass(frozen=True)
class Happened:
    """Draws by key of a machine's ``[head]``, of shape (draws,), and words about them."""

    draws: dict[str, np.ndarray]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Impulses:
    """Impulses at rest: of each its mean height off the sheet's, signed, mm; its samples; its error, mm; its gap, mm;
    whether its whole length was seen. Samples at which one could have begun, and height from which on one is seen, mm,
    by gap. How likely two in a row look like one."""

    off: np.ndarray
    length: np.ndarray
    error: np.ndarray
    gap: np.ndarray
    whole: np.ndarray
    exposed: dict[float, int]
    seen: dict[float, float]
    alike: float


def identify(
    log: Log, head: Swept, rng: np.random.Generator, usual: float | None = None, draws: int = 1000
) -> Happened:
    """What a rest log tells of impulses and drift.

    Args:
        log: of the protocol *rest*, with ``frequency``.
        head: of the sweep, which makes heights of frequencies.
        rng: draws.
        usual: s of warming that holds if the log does not tell it; then drift is drawn with it, and warming is not.
            Without, both are drawn together.
        draws: of each number.
    """
    stood = [(where, log["frequency"][where]) for where, _ in rests(log)]
    stood.sort(key=lambda each: float(np.median(each[1])))  # the lowest height first
    marks, _ = _impulses(stood, head)
    marks = marks or [f <= 0 for _, f in stood]
    warmed, told = _drift([(where, f, mark) for (where, f), mark in zip(stood, marks, strict=True)], rng, usual, draws)
    # A warm head takes heights for others, and so their differences: it is cooled before they are looked at.
    cold = [(where, f * np.sqrt(1 + _warm(warmed, _time(where)))) for where, f in stood]
    _, found = _impulses(cold, head)
    out: dict[str, np.ndarray] = {}
    if found is None:
        notes = ["rest: impulses are so many that single ones cannot be told apart, or too small to be seen; not found"]
    else:
        sizes = _sizes(found, rng, draws)
        out = _counted(found, sizes, rng, draws)
        if len(found.off):
            out |= sizes
        else:
            del out["impulse_samples"]
        seconds = PERIOD * sum(found.exposed.values())
        notes = [f"rest: {len(found.off)} impulses in {seconds:.3g} s at the heights that are quiet enough"]
    del warmed["held"]
    return Happened({**out, **warmed}, (*notes, *told))


def _warm(warmed: dict[str, np.ndarray], time: np.ndarray) -> np.ndarray:
    """Relative change of L·C, the mean of some draws; where the draws are of a usual warming, theirs alone counts."""
    some = slice(0, 100)
    drift, warming = warmed["drift"][some, None], warmed["held"][some, None]
    made: np.ndarray = np.mean(drift * (1 - np.exp(-time[::50] / warming)), axis=0)
    return np.interp(time, time[::50], made)


def _time(where: slice) -> np.ndarray:
    """s since the log began, of a rest's samples."""
    return np.arange(where.start, where.stop) * PERIOD


# ------------------------------------------------------------------------------------------------------- impulses


def _impulses(stood: list[tuple[slice, np.ndarray]], head: Swept) -> tuple[list[np.ndarray], Impulses | None]:
    """Which samples of each rest are impulses, and these; none if they cannot be told apart."""
    grid = np.geomspace(2e-3, 30.0, 6000)
    made = frequency_at(head.params, grid)
    marks, rows = [], []
    exposed: dict[float, int] = {}
    seen: dict[float, float] = {}
    for _, f in stood:
        valid = f > 0
        h = np.interp(np.interp(np.arange(len(f)), np.flatnonzero(valid), f[valid]), made, grid)
        off = h - ndimage.median_filter(h, AROUND, mode="nearest")
        gap, noise, jumps = float(np.median(h)), scatter(h), np.zeros(len(h), bool)
        for _ in range(4):  # what scatters between impulses alone
            jumps = _marked(off, noise)
            calm = ~(jumps[1:] | jumps[:-1])
            if calm.mean() < 1 - 2 * BUSY:
                return [], None
            noise = float(np.std(np.diff(off)[calm]) / np.sqrt(2))
        marks.append(ndimage.binary_dilation(jumps) | ~valid)
        found = [(first, last, float(off[first:last].mean())) for first, last in _runs(off, jumps, noise, gap)]
        unclear = any(abs(mean) < CLEAR * noise for _, _, mean in found)
        if OFF * noise > QUIET or (unclear and seen):
            continue
        seen[gap], exposed[gap] = OFF * noise, len(h)
        for first, last, mean in found:
            many = last - first
            exposed[gap] -= many - 1
            inside = first > 0 and last < len(h)
            rows.append((mean, many, noise * (1 + mean / gap) ** 2 / np.sqrt(many), gap, inside))
    if not seen:
        return marks, None
    off, length, error, at, whole = np.asarray(rows, float).reshape(-1, 5).T
    near = np.abs(off[:, None] - off) < OFF * np.hypot(error * np.sqrt(length), (error * np.sqrt(length))[:, None])
    pairs = (near & (at[:, None] == at))[~np.eye(len(off), dtype=bool)]
    alike = float(pairs.sum() / max((at[:, None] == at).sum() - len(at), 1))
    return marks, Impulses(off, length, error, at, whole > 0, exposed, seen, alike)


def _marked(off: np.ndarray, noise: float) -> np.ndarray:
    """Samples of impulses: stretches that are off by more than four times the noise, and six times somewhere."""
    out = np.zeros(len(off), bool)
    for sign in (-1.0, 1.0):
        stretch, many = ndimage.label(sign * off > STAYS * noise)
        high = ndimage.maximum(sign * off, stretch, np.arange(many + 1)) > OFF * noise
        high[0] = False
        out |= high[stretch]
    return out


def _runs(off: np.ndarray, jumps: np.ndarray, noise: float, gap: float) -> list[tuple[int, int]]:
    """Stretches of samples that are one impulse each: together, and of one height."""
    runs: list[tuple[int, int]] = []
    for n in np.flatnonzero(jumps):
        if runs and runs[-1][1] == n:
            first = runs[-1][0]
            mean = float(off[first:n].mean())
            sure = OFF * noise * (1 + max(mean, off[n]) / gap) ** 2 * np.sqrt(1 + 1 / (n - first))
            if abs(off[n] - mean) < sure:
                runs[-1] = (first, int(n) + 1)
                continue
        runs.append((int(n), int(n) + 1))
    return runs


def _counted(
    found: Impulses, sizes: dict[str, np.ndarray], rng: np.random.Generator, draws: int
) -> dict[str, np.ndarray]:
    """Rate and longest length."""
    count, chances = len(found.off), sum(found.exposed.values())
    share = rng.beta(count + 0.5, chances - count + 0.5, draws)
    visible = np.zeros(draws)
    for gap, exposed in found.exposed.items():
        a, spread = sizes["impulse_height"] / (1 + gap / sizes["impulse_falloff"]), sizes["impulse_spread"]
        visible += exposed / chances * (_visible(a, spread, found.seen[gap]) if count else 1.0)
    doubled = count / chances * found.alike
    rate = np.minimum(share * (1 + doubled) / np.maximum(visible, 1e-3) / PERIOD, PRIOR["impulses"][1])
    most = np.arange(1, int(PRIOR["impulse_samples"][1]) + 1)
    length = found.length[found.whole].astype(int)
    fine = -np.log(most)
    for m in most:
        one = np.append(0.0, np.full(m, 1.0 / m))
        chance, row = np.zeros(max(4 * int(m), int(length.max(initial=1))) + 1), np.ones(1)
        for several in range(4):
            row = np.convolve(row, one)
            chance[: len(row)] += (1 - doubled) * doubled**several * row
        with np.errstate(divide="ignore"):
            fine[m - 1] += np.log(chance[length]).sum()
    if not np.isfinite(fine).any():
        return {"impulses": rate}
    return {"impulses": rate, "impulse_samples": rng.choice(most, draws, p=special.softmax(fine)).astype(float)}


def _visible(a: np.ndarray, spread: np.ndarray, least: float) -> np.ndarray:
    """Share of the impulses of heights a·(1 ± spread) that are seen."""
    low, high = a * (1 - spread), a * (1 + spread)
    share: np.ndarray = np.clip((high - np.maximum(low, least)) / np.maximum(high - low, 1e-12), 0.0, 1.0)
    return np.where(high - low < 1e-12, (a > least) * 1.0, share)


def _sizes(found: Impulses, rng: np.random.Generator, draws: int) -> dict[str, np.ndarray]:
    """Height, falloff and spread; the prior's where there are no impulses."""
    names = ("impulse_height", "impulse_falloff", "impulse_spread")
    low, high = np.array([PRIOR[name] for name in names]).T
    low[:2], high[:2] = np.log(low[:2]), np.log(high[:2])
    reference, places = min(found.exposed), np.array(sorted(found.exposed))
    some = rng.permutation(len(found.off))[:MOST]
    off, error, gap = np.abs(found.off)[some], found.error[some], found.gap[some]
    where = 2 * np.searchsorted(places, gap) + (found.off[some] > 0)

    def fine(x: np.ndarray) -> np.ndarray:
        """Of points (height at the reference, falloff, spread, errors of the head's scale at each height, down and
        up): logarithm of the posterior, shape (n,)."""
        falloff, spread, scale = np.exp(x[:, 1, None]), x[:, 2, None], np.exp(SCALE * x[:, 3:])
        zero = x[:, :1] + np.log1p(reference / falloff)
        full = np.concatenate([zero, x[:, 1:3]], axis=1)
        inside = np.all((full > low) & (full < high), axis=1)
        a, spread = np.exp(zero) / (1 + gap / falloff) * scale[:, where], np.clip(spread, 1e-6, 1.0)
        start, end = a * (1 - spread), a * (1 + spread)
        # Φ(b) − Φ(a) by its logarithm, in the tail where it has digits, so that far points know the way.
        one, two = (start - off) / error, (end - off) / error
        one, two = np.where(one > 0, -two, one), np.where(one > 0, -one, two)
        last = special.log_ndtr(two)
        less = np.minimum(special.log_ndtr(one) - last, -1e-12)
        each = last + np.log(-np.expm1(less)) - np.log(end - start)
        total = np.logaddexp(each, np.log(ODD / (3 * a))).sum(axis=1) - 0.5 * np.sum(x[:, 3:] ** 2, axis=1)
        for at, least in found.seen.items():
            share = _visible(np.exp(zero[:, 0]) / (1 + at / falloff[:, 0]), spread[:, 0], least)
            total -= np.sum(gap == at) * np.log(np.maximum(share, 1e-9))
        return np.where(inside, total, -np.inf)

    near = off[gap == reference] if np.any(gap == reference) else np.array([0.03, 0.05])
    middle = float(np.median(near))
    wide = float(np.clip(0.5 * np.ptp(np.percentile(near, [1, 99])) / middle, 0.02, 0.9))
    x = np.column_stack(
        [
            np.log(middle) + rng.normal(0, 0.1 * wide, WALKERS),
            _begin(off, gap, rng, low[1], high[1]),
            wide * np.exp(rng.uniform(0.0, 0.1, WALKERS)),
            rng.normal(0, 1, (WALKERS, 2 * len(places))),
        ]
    )
    chain = stretched(fine, x, rng, STEPS)[STEPS // 3 :].reshape(-1, x.shape[1])
    kept = chain[rng.choice(len(chain), draws)]
    falloff = np.exp(kept[:, 1])
    return dict(zip(names, (np.exp(kept[:, 0]) * (1 + reference / falloff), falloff, kept[:, 2]), strict=True))


def _begin(off: np.ndarray, gap: np.ndarray, rng: np.random.Generator, low: float, high: float) -> np.ndarray:
    """Logarithms of falloffs to begin with: what the middles of two heights give, or anything."""
    places = np.unique(gap)
    if len(places) < 2:
        return rng.uniform(low, high, WALKERS)
    (h1, a1), (h2, a2) = ((h, float(np.median(off[gap == h]))) for h in places[:2])
    ratio = max(a1 / a2, 1.001)
    falloff = max((h2 - ratio * h1) / (ratio - 1), 0.0)
    middle = np.clip(np.log(max(falloff, 1e-9)), low + 0.5, high - 0.5)
    return np.clip(middle + rng.normal(0, 0.3, WALKERS), low, high)


def stretched(fine: Any, x: np.ndarray, rng: np.random.Generator, steps: int) -> np.ndarray:
    """Walkers of an affine-invariant sampler: each moves along the line to one of the other half.

    Args:
        fine: logarithm of a density, of points of shape (n, numbers).
        x: where the walkers begin, shape (walkers, numbers).
        rng: draws.
        steps: of each walker.

    Returns:
        Where they were, shape (steps, walkers, numbers).
    """
    x, half, size = x.copy(), len(x) // 2, x.shape[1]
    good, out = fine(x), np.empty((steps, *x.shape))
    for step in range(steps):
        for mine, others in ((slice(0, half), slice(half, None)), (slice(half, None), slice(0, half))):
            here, there = x[mine], x[others]
            z = (1 + rng.uniform(0, 1, len(here))) ** 2 / 2  # density ~ 1/√z between ½ and 2
            asked = there[rng.integers(0, len(there), len(here))]
            asked = asked + z[:, None] * (here - asked)
            new = fine(asked)
            with np.errstate(invalid="ignore"):
                takes = np.log(rng.uniform(0, 1, len(here))) < (size - 1) * np.log(z) + new - good[mine]
            x[mine] = np.where(takes[:, None], asked, here)
            good[mine] = np.where(takes, new, good[mine])
        out[step] = x
    return out


# ---------------------------------------------------------------------------------------------------------- drift


def _drift(
    stood: list[tuple[slice, np.ndarray, np.ndarray]], rng: np.random.Generator, usual: float | None, draws: int
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Drift and warming, from the mean frequencies of blocks at each height."""
    time, level, weight, group = [], [], [], []
    for i, (where, f, mark) in enumerate(stood):
        y, quiet = np.log(np.where(f > 0, f, 1.0)), ~mark
        quiet[:SETTLED] = False
        blocks = len(f) // BLOCK
        many = quiet[: blocks * BLOCK].reshape(blocks, BLOCK).sum(axis=1)
        sums = np.where(quiet, y, 0.0)[: blocks * BLOCK].reshape(blocks, BLOCK).sum(axis=1)
        some = many > BLOCK // 2
        time.append((where.start + (np.flatnonzero(some) + 0.5) * BLOCK) * PERIOD)
        level.append(sums[some] / many[some])
        weight.append(many[some] / scatter(y[quiet]) ** 2)
        group.append(np.full(some.sum(), i))
    t, y, w, g = (np.concatenate(x) for x in (time, level, weight, group))

    def centred(x: np.ndarray) -> np.ndarray:
        """Less its mean at each height."""
        out: np.ndarray = x - (np.bincount(g, w * x) / np.bincount(g, w))[g]
        return out

    low, high = PRIOR["warming"]
    taus = np.geomspace(low, high, 200)

    def given(tau: float) -> tuple[float, float, float]:
        """Best drift, its variance and what it leaves, for a warming."""
        warm, drift = 1 - np.exp(-t / tau), 0.0
        for _ in range(4):
            off = centred(y + 0.5 * np.log1p(drift * warm))
            slope = centred(-0.5 * warm / (1 + drift * warm))
            drift = float(np.clip(drift + (w * slope) @ off / ((w * slope) @ slope), -0.5, 0.5))
        off = centred(y + 0.5 * np.log1p(drift * warm))
        return drift, 1 / float((w * slope) @ slope), float(w @ off**2)

    best, variance, left = np.array([given(tau) for tau in taus]).T
    # What blocks scatter more than their samples do is noise that the model lacks; it counts as such.
    more = max(1.0, float(left.min()) / max(len(t) - len(stood) - 2, 1))
    sigma = np.sqrt(variance * more)
    ends = PRIOR["drift"]
    inside = special.ndtr((ends[1] - best) / sigma) - special.ndtr((ends[0] - best) / sigma)
    chance = special.softmax(-0.5 * left / more + np.log(sigma) + np.log(np.maximum(inside, 1e-300)))
    at = rng.choice(len(taus), draws, p=chance)
    warming = np.clip(taus[at] * np.exp(rng.uniform(-0.5, 0.5, draws) * np.log(taus[1] / taus[0])), low, high)
    # Within a cell of the grid the drift goes with the warming: what is known is their ratio.
    bend = np.gradient(best, np.log(taus))[at] * np.log(warming / taus[at])
    drift = stats.truncnorm.rvs((ends[0] - best[at]) / sigma[at], (ends[1] - best[at]) / sigma[at], best[at], sigma[at],
                                random_state=rng) + bend  # fmt: skip
    drift = np.clip(drift, *ends)
    if usual is not None and np.ptp(np.percentile(np.log(warming), [2.5, 97.5])) > TOLD * np.log(high / low):
        drift, spread, _ = given(usual)
        told = f"rest: head.warming is not told by {t[-1]:.3g} s; head.drift is that of {usual:g} s"
        drawn = drift + np.sqrt(spread * more) * rng.normal(size=draws)
        return {"drift": drawn, "held": np.full(draws, usual)}, [told]
    return {"drift": drift, "warming": warming, "held": warming}, []
