"""The sensor from a sweep and a rest log: its oscillator and plate, the calibration table, its noise.

A sweep gives frequency over height. The head's own equations are fitted to it (:mod:`envs.plant.sensor`), for which the
nozzle's size must be known within the range that is searched; its bore and the oscillator's series capacitors are those
of the machine that it is like. At rest, what frequency scatters at several heights
comes from noise of the capacitance, from the oscillator and from counting, and these fall apart because their shares
change with height. Impulses do not count: scatter is that of the middle 90 % of the differences of neighbours.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import optimize

from ...envs.engine.quantity import InvalidInput
from ...envs.plant import calibration, sensor
from ...envs.scenarios import Head
from ...envs.scenarios.distributions import middle
from .log import PERIOD, Log
from .residuals import count_of

RANGES = {"face": (6.0, 16.0), "body": (5.0, 40.0), "inductance": (50.0, 500.0)}
"""mm, pF and µH that are searched [A]."""

ROUNDED, SPOILT = 0.4, 4.0
"""Share of an encoder's count that it leaves open [A]; standard deviations from which on a sample counts less."""

SETTLED = 0.08
"""s of a sweep after which the mounting no longer rings from its start; before, the nozzle's height is not that of the
encoder by some µm, which near the sheet outweighs all noise [C]."""

NOISE, JITTER = (1e-4, 3e-2), (1e-8, 1e-4)
"""pF, and share of the frequency, that are searched [A]."""

STILL = 1.5
"""s that the head must stand for a rest to count."""


@dataclass(frozen=True)
class Swept:
    """What a sweep says: the head's numbers and their covariance, its table, and µm that the fit leaves at 1 mm; and
    what was known of the head before."""

    values: dict[str, float]
    covariance: np.ndarray
    table: calibration.Table
    left: float
    known: sensor.Params

    @property
    def params(self) -> sensor.Params:
        """The head."""
        return params_of(list(self.values.values()), self.known)


def known_of(head: Head) -> sensor.Params:
    """What no sweep tells of a machine's head: its bore, and the series capacitors of its oscillator."""
    preset = sensor.PRESETS[head.oscillator]
    return preset if head.bore is None else preset._replace(bore=0.5 * float(middle(head.bore)))


def params_of(values: list[float], known: sensor.Params) -> sensor.Params:
    """The head of a face, mm, a body, pF, and an inductance, µH; the rest is known."""
    face, body, inductance = map(float, values)
    return known._replace(radius=0.5 * face, body=body, inductance=inductance)


def frequency_at(p: sensor.Params, heights: np.ndarray) -> np.ndarray:
    """Hz at heights in mm."""
    fringe = np.maximum(0.0, np.log(8 * np.pi * p.radius / heights) - 1.0)
    plate = sensor.EPSILON0 * np.pi * (p.radius**2 - p.bore**2) / heights
    c5 = p.body + plate + 2 * sensor.EPSILON0 * p.radius * fringe
    made: np.ndarray = 1e9 / (2 * np.pi * np.sqrt(p.inductance * c5 / (1.0 + c5 * p.series)))
    return made


def scatter_at(p: sensor.Params, frequency: Any, noise: Any, jitter: Any) -> Any:
    """Hz by which samples of a frequency scatter at rest: noise of C5, pF, of the oscillator, relative, and of
    counting, of which neighbours have a difference that is triangular."""
    total = (1e9 / (2 * np.pi * frequency)) ** 2 / p.inductance
    c5 = total / (1.0 - total * p.series)
    counted = frequency / (sensor.CLOCK * np.floor(0.25e-3 * frequency)) / np.sqrt(6)
    return frequency * np.sqrt((0.5 * noise / (c5 * (1.0 + c5 * p.series))) ** 2 + jitter**2 + counted**2)


def swept(log: Log, known: sensor.Params = sensor.EQ3) -> Swept:
    """The head of a sweep: a touch of the sheet, then up.

    Args:
        log: of the protocol *sweep*.
        known: bore and series capacitors.

    Raises:
        InvalidInput: the sweep does not reach from the sheet to 2 mm, or is not fit for a table; and why.
    """
    encoder, frequency = log["encoder"], log["frequency"]
    touched = np.flatnonzero(frequency == 0)
    first = int(touched[-1]) + 1 if len(touched) else int(np.argmin(encoder))
    zero = float(encoder[touched].mean() if len(touched) else encoder[first])
    top = first + int(np.argmax(encoder[first:]))
    height, f = encoder[first : top + 1] - zero, frequency[first : top + 1]
    rising = height > np.concatenate([[-np.inf], np.maximum.accumulate(height)[:-1]]) + 1e-6  # not where it waits
    height, f = height[rising], f[rising]
    if not len(height) or height[-1] < 2.0:
        raise InvalidInput(f"{log.name}: the sweep ends {height[-1] if len(height) else 0:.3g} mm above the sheet; it "
                           "must reach 2 mm")  # fmt: skip
    span = min(calibration.SPAN, float(np.floor(10 * height[-1]) / 10))
    speed = float(np.median(np.diff(height)[np.diff(height) > 0])) / PERIOD
    speed = max(speed, span / (len(height) * PERIOD))
    table = calibration.build(f, height, span=span, speed=speed)
    used = (height > SETTLED * speed) & (height <= span)
    h, y = height[used], f[used]
    # What frequency scatters goes with the capacitance's noise, and is much the same share of it at every height; near
    # the plate a rounding of the encoder counts for more.
    steep = np.abs(np.gradient(np.log(frequency_at(known, h)), h))
    scale = np.hypot(scatter(np.log(y[h > 1.0])), 1e-3 * ROUNDED * count_of(encoder) * steep)

    def off(x: np.ndarray) -> np.ndarray:
        made: np.ndarray = np.log(frequency_at(params_of(np.exp(x[:3]).tolist(), known), h + x[3]) / y) / scale
        return made

    low, high = np.log(np.array(list(RANGES.values()))).T
    start = np.append(np.log([10.0, 10.0, 168.0]), 0.0)
    found = optimize.least_squares(
        off,
        start,
        bounds=(np.append(low, -0.02), np.append(high, 0.02)),
        loss="soft_l1",
        f_scale=SPOILT,
        x_scale=[0.1, 0.1, 0.1, 1e-3],
    )
    left = off(found.x)
    covariance = np.linalg.pinv(found.jac.T @ found.jac, hermitian=True) * float(
        np.mean(np.minimum(left**2, SPOILT**2))
    )
    values = dict(zip(RANGES, np.exp(found.x[:3]).tolist(), strict=True))
    near = np.abs(h - 1.0) < 0.3
    at_1 = 1e3 * float(np.std((left * scale / steep)[near])) if near.any() else np.nan
    table = _grounded(table, params_of(list(values.values()), known), float(height[(height > 0) & (f > 0)].min()))
    return Swept(values, covariance[:3, :3], table, at_1, known)


def _grounded(table: calibration.Table, p: sensor.Params, lowest: float) -> calibration.Table:
    """The table, whose entries below the lowest sample, mm, are the head's equations' if what it had continued to there
    is less than half of them: a play that a touch leaves open is no head's, and near the sheet a table is steep."""
    below = table.height < lowest
    made = frequency_at(p, table.height)
    if not below.any() or np.all(table.frequency[below] > 0.5 * made[below]):
        return table
    first = int(np.argmin(below))
    continued = np.where(below, made * (table.frequency[first] / made[first]), table.frequency)
    return table._replace(frequency=continued)


def rests(log: Log) -> list[tuple[slice, float]]:
    """Where a log stands still, and at which encoder reading, mm."""
    still = np.concatenate([[False], np.abs(np.diff(log["encoder"])) < 1.5e-3])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    long = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if (b - a) * PERIOD > STILL]
    return [(slice(a + 300, b), float(np.median(log["encoder"][a:b]))) for a, b in long if b - a > 900]


def scatter(values: np.ndarray) -> float:
    """Standard deviation of a signal's noise, from differences of neighbours, whatever its impulses and drift.

    What an impulse made is left out: more than 4.5 standard deviations, again and again until nothing more is.
    Quantiles would not do, since a counted frequency has few values.
    """
    differences = np.diff(values)
    scale = 1.4826 * float(np.median(np.abs(differences))) + 2 * float(np.mean(np.abs(differences) < 1e-9) > 0.5)
    for _ in range(20):
        kept = differences[np.abs(differences) <= 4.5 * max(scale, 1e-12)]
        before, scale = scale, float(np.std(kept)) if len(kept) else 0.0
        if abs(scale - before) <= 1e-6 * before:
            break
    return scale / np.sqrt(2)


def noise(log: Log, head: Swept, rng: np.random.Generator, draws: int = 1000) -> dict[str, np.ndarray]:
    """Draws of ``noise`` (pF) and ``jitter`` (relative) from a rest log, on a grid of both.

    Raises:
        InvalidInput: the head stands nowhere, or the log has no frequency.
    """
    if "frequency" not in log:
        raise InvalidInput(f"{log.name}: noise is found from the frequency; the log has none")
    stood = rests(log)
    if not stood:
        raise InvalidInput(f"{log.name}: the head stands nowhere for {STILL:g} s; a rest log needs three heights")
    p = head.params
    noises, jitters = np.geomspace(*NOISE, 600)[:, None], np.geomspace(*JITTER, 120)[None]
    fine = np.zeros((600, 120))
    for where, _ in stood:
        f = log["frequency"][where]
        f = f[f > 0]
        n = len(f)
        sigma = scatter_at(p, float(np.median(f)), noises, jitters)
        # Neighbouring differences share a sample: the variance of their variance is 3 instead of 2 σ⁴/n.
        fine += -0.5 * ((np.log(scatter(f)) - np.log(sigma)) / np.sqrt(0.75 / n)) ** 2
    weight = np.exp(fine - fine.max()).ravel()
    at = rng.choice(weight.size, draws, p=weight / weight.sum())
    i, j = np.unravel_index(at, fine.shape)
    # Capacitance goes with 1/L at a frequency, so what is not known of the one is not known of the noise in pF.
    blur = np.exp(-rng.normal(0, np.sqrt(max(head.covariance[2, 2], 0.0)), draws))
    grid = np.exp(rng.uniform(-0.5, 0.5, (2, draws)) * np.log([[NOISE[1] / NOISE[0]], [JITTER[1] / JITTER[0]]])
                  / np.array([[599], [119]]))  # fmt: skip
    return {"noise": noises[i, 0] * grid[0] * blur, "jitter": jitters[0, j] * grid[1]}
