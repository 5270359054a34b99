"""Xi2023 §3.3: the moving average and its improved form, as the machine runs them, against plain Python."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from scipy.signal import lfilter

from ...envs.plant import filters, heads, idle, machine
from ...envs.plant.controller import make_law
from ...envs.plant.fleet import Fleet
from ..plots.palette import COLOURS, QUIET
from .claims import Rows, Trial, study
from .pictures import Drawing
from .xi2023_sensor import pictured

REST = 3.6e6
"""Hz, frequency before a response."""

HALVES = (1, 2, 4, 8)
"""k of windows N = 2k + 1."""

ROUNDING = 1e-5
"""Hz, of sums over frequencies of 4 MHz."""


def kind(name: str, **settings: float) -> filters.Params:
    """Settings of one of the machine's filters."""
    return filters.Params(kind=float(filters.KINDS.index(name)))._replace(**settings)


def machine_filters(params: Sequence[filters.Params], samples: np.ndarray) -> np.ndarray:
    """What the machine's filters make of a recorded signal, Hz, shape (samples, filters)."""
    fleet = Fleet(len(params), make_law(idle, "idle"), heads.ensure([0]))
    for i, p in enumerate(params):
        fleet.put_filter(i, p)
    fleet.set("path.feed", np.arange(len(params)), 0.0)
    fleet.replay(np.concatenate([samples[:1], samples]))  # the first fills the ring
    fleet.begin(np.arange(len(params)), np.arange(len(params)))
    out = np.empty((len(samples), len(params)))
    for n in range(len(samples)):
        fleet.advance()
        out[n] = [fleet.slots(machine.FOLD, 1, i)[0] for i in range(len(params))]
    return out


def centred(x: np.ndarray, k: int) -> np.ndarray:
    """Eq. 6 as printed: y(n) = Σ x(n+i)/(2k+1), i = −k … k; without the k samples at either end."""
    return np.array([sum(x[n + i] for i in range(-k, k + 1)) / (2 * k + 1) for n in range(k, len(x) - k)])


def six_steps(x: np.ndarray, length: int) -> np.ndarray:
    """Fig. 9 read step by step; NaN until the queue is full."""
    out, queue = np.full(len(x), np.nan), []  # 1: a queue of length N
    for n, sample in enumerate(x.tolist()):
        queue.append(sample)  # 2: write the samples into it one by one
        if len(queue) > length:
            queue.pop(0)
        if len(queue) == length:
            total = sum(queue)  # 3: when it is full, sum them
            extremes = max(queue) + min(queue)  # 4: find largest and smallest, sum these
            rest = total - extremes  # 5: subtract
            out[n] = rest / (length - 2)  # 6: divide by N − 2
    return out


def noisy(seed: int, n: int = 2000) -> np.ndarray:
    """A signal with noise of 2 kHz and an impulse in every tenth sample, Hz."""
    rng = np.random.default_rng(seed)
    hits = rng.choice([-6e4, 0.0, 6e4], n, p=[0.05, 0.9, 0.05])
    return REST + np.cumsum(rng.normal(0, 300, n)) + rng.normal(0, 2000, n) + hits


def _response(shape: np.ndarray) -> np.ndarray:
    """A signal that starts at rest and rises by 1 kHz times ``shape``."""
    return REST + 1e3 * np.concatenate([np.zeros(20), shape])


STEP, IMPULSE = np.ones(40), np.eye(1, 40)[0]


@study("xi2023", "Moving average, eq. 6")
def moving_average(trial: Trial, rows: Rows) -> list[Drawing]:
    """Eq. 6 as printed (centred) and as a buffer can run it (causal)."""
    x, params = noisy(0), [kind("mean", window=2 * k + 1) for k in HALVES]
    y = machine_filters(params, x)
    off = max(float(np.abs(y[2 * k :, i] - centred(x, k)).max()) for i, k in enumerate(HALVES))
    pulse = (machine_filters(params, _response(IMPULSE)) - REST) / 1e3
    time = np.arange(len(pulse)) - 20
    delays = [float((time * pulse[:, i]).sum() / pulse[:, i].sum()) for i in range(len(HALVES))]
    ratio, tau = 0.8, 2.0
    others = machine_filters([kind("weighted", window=5, ratio=ratio), kind("lag", tau=tau)], x)
    weights = ratio ** np.arange(5) / (ratio ** np.arange(5)).sum()
    share = 1 / (tau + 1)
    lagged = lfilter([share], [1, share - 1], x, zi=[(1 - share) * x[0]])[0]
    filtered = np.abs(others[4:, 0] - lfilter(weights, 1, x)[4:])
    apart = max(float(filtered.max()), float(np.abs(others[:, 1] - lagged).max()))
    sample = max(float(np.abs(x[k:-k] - centred(x, k)).max()) for k in HALVES)
    late, settled = _against_lag(5)
    rows("moving-average", off, error=off, guess=sample, tolerance=ROUNDING)
    holds = np.allclose(delays, HALVES, atol=1e-6)
    rows("buffer-delay", (", ".join(f"{d:.3g}" for d in delays), ", ".join(map(str, HALVES))), holds)
    rows("named-filters", apart, holds=apart < ROUNDING)
    rows("measures-fast", (settled, late), holds=settled[0] < settled[1])
    return [_responses()]


def _against_lag(n: int) -> tuple[list[float], list[int]]:
    """Samples by which a ramp is late, and after which a step has come by 95 %: mean of ``n``, lag of equal noise."""
    pair = [kind("mean", window=n), kind("lag", tau=0.5 * (n - 1))]  # white noise passes by 1/n through either
    ramp = _response(np.arange(1.0, 121.0))
    late = [float((ramp[-1] - value) / 1e3) for value in machine_filters(pair, ramp)[-1]]
    step = (machine_filters(pair, _response(STEP)) - REST) / 1e3
    return late, [int(np.argmax(step[:, i] >= 0.95)) - 19 for i in range(len(pair))]


@pictured("Xi2023 eq. 6 and Fig. 9", 2)
def _responses(*axes: Axes) -> None:
    """Filters of N = 5 (k = 2). The centred form answers before the step comes, so no machine can run it; the
    causal one lags by k = 2 samples. The improved filter jumps in the middle of the step and does not answer to an
    impulse of one sample."""
    for ax, shape, name in zip(axes, (STEP, IMPULSE), ("step", "impulse of one sample"), strict=True):
        x = _response(shape)
        both = (machine_filters([kind("mean", window=5), kind("improved", window=5)], x) - REST) / 1e3
        time = np.arange(len(x)) - 20
        ax.step(time, (x - REST) / 1e3, where="mid", color=QUIET, lw=1, label="samples")
        middle = (centred(x, 2) - REST) / 1e3
        ax.plot(time[2:-2], middle, "D--", ms=3, lw=1, color=COLOURS[2], label="eq. 6 as printed, centred")
        ax.plot(time, both[:, 0], "o-", ms=3, lw=1, color=COLOURS[1], label="eq. 6, causal")
        ax.plot(time, both[:, 1], "s-", ms=3, lw=1, color=COLOURS[0], label="improved, causal")
        ax.set(xlabel="sample (1 ms each)", ylabel=f"response to a {name}", xlim=(-4, 9), ylim=(-0.05, 1.1))
    axes[1].legend(fontsize=8)


@study("xi2023", "Improved filter, Fig. 9")
def improved_filter(trial: Trial, rows: Rows) -> list[Drawing]:
    """The six steps, what they take out, and what not."""
    lengths = (3, 5, 9)
    x = noisy(1)
    y = machine_filters([kind("improved", window=n) for n in lengths], x)
    off = max(float(np.nanmax(np.abs(y[:, i] - six_steps(x, n)))) for i, n in enumerate(lengths))
    plain = machine_filters([kind("mean", window=n) for n in lengths], x)
    untrimmed = max(float(np.nanmax(np.abs(plain[:, i] - six_steps(x, n)))) for i, n in enumerate(lengths))
    pair = [kind("mean", window=5), kind("improved", window=5)]
    hits = {count: np.isin(np.arange(40), range(count)).astype(float) for count in (1, 2)}
    leaks = {n: np.abs(machine_filters(pair, _response(shape)) - REST) for n, shape in hits.items()}
    leak = {n: gone.max(axis=0) / 1e3 for n, gone in leaks.items()}
    ramp = _response(np.arange(1.0, 41.0))
    late = [float((ramp[-1] - value) / 1e3) for value in machine_filters(pair, ramp)[-1]]
    rows("six-steps", off, error=off, guess=untrimmed, tolerance=ROUNDING)
    rows("one-sample", (100 * leak[1][1], 100 * leak[1][0]), holds=leak[1][1] < leak[1][0])
    rows("two-samples", (100 * leak[2][1], 100 * leak[2][0]), holds=leak[2][1] < leak[2][0])
    rows("ramp-delay", late, holds=abs(late[1] - late[0]) < 1e-6)
    return [_improved(pair)]


@pictured("Xi2023 Fig. 9")
def _improved(ax: Axes, pair: list[filters.Params]) -> None:
    """Both filters of N = 5 on the same samples. Single impulses (20, 50) leave the improved filter alone; of two
    within one window (80, 82) it passes a third."""
    n = np.arange(120)
    hits = np.isin(n, (20, 50)) * 1.0 - np.isin(n, (80, 82)) * 1.0
    x = REST + 4e3 * np.sin(n / 12) + np.random.default_rng(2).normal(0, 500, len(n)) + 6e4 * hits
    y = machine_filters(pair, x)
    ax.plot(n, (x - REST) / 1e3, ".", ms=4, color=QUIET, label="samples")
    ax.plot(n, (y[:, 0] - REST) / 1e3, color=COLOURS[1], lw=1.2, label="moving average")
    ax.plot(n, (y[:, 1] - REST) / 1e3, color=COLOURS[0], lw=1.6, label="improved")
    ax.set(xlabel="sample (1 ms each)", ylabel="frequency − 3.6 MHz (kHz)", ylim=(-30, 30))
    ax.annotate("impulses of ±60 kHz,\nbeyond the frame", (52, 20), fontsize=8, color=QUIET)
    ax.legend(fontsize=8, loc="lower left")
