"""What hangs between motor and nozzle, from a motion log near the plate: backlash, and the mounting's resonance.

The motor's encoder does not see them. The sensor does: of each candidate the axis of :mod:`.drive` makes the nozzle's
path, the head of the sweep its frequency, and the measured one is compared with it. Free play opens only where the
motor falls faster than the head, so a drive that never does so tells nothing of it, and the posterior stays as wide as
the prior.

The nozzle is where the encoder says, and where the candidate is from its motor. So what the model of the drive leaves
is not held against the mounting. Errors are relative to the frequency, where noise of the capacitance is about the same
at every height. What a smooth function of the encoder's reading explains, such as a wrong zero or table, or what is in
proportion to its speed, is not held against a candidate. Samples that an impulse spoilt do not count.
"""

import itertools
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ...envs.plant import candidates, z_axis
from . import posterior
from .head import Swept, frequency_at, params_of
from .log import PERIOD, Log

PRIOR = {
    "backlash": (5e-4, 0.06),
    "resonance": (30.0, 400.0),
    "resonance_zeta": (0.01, 0.3),
    "compliance": (0.01, 1.0),
}
"""Ranges, uniform in the logarithm, in the units of a machine's file [A]."""

HIGHEST, LEAST, STILL = 8.0, 3.0, 0.1
"""mm above the plate up to which the sensor tells anything; s of it that are needed, and of rest before."""

SMOOTH = 6
"""Order of the polynomial of the encoder's reading that is free."""

TYPICAL = 1.5
"""mm above the plate, of the jolts."""

STARTS = 8
"""Resonances from which least squares begins, each of which may end in a valley of its own."""

SETTLED = 400
"""Samples after the first motion that do not count: in which state friction held the axis before is not known."""

MOVING = 1.0
"""mm/s of the command from which on the head is said to move."""

OUTLYING = 6.0
"""Scales of the errors from which on a sample is taken for spoilt."""

_LOW, _HIGH = np.log(np.array(list(PRIOR.values()))).T


@dataclass(frozen=True)
class Found:
    """Draws by key of a machine's ``[axis]``, each of shape (draws,), µm that is left of the height at 1 mm, and how
    many draws the importance sample is worth."""

    draws: dict[str, np.ndarray]
    left: float
    effective: float


def part(log: Log, swept: Swept) -> slice | None:
    """Where a log is near the plate up to its end, from a rest on; None if it is not for long enough."""
    f = log["frequency"]
    far = np.flatnonzero((f <= 0) | (f > frequency_at(swept.params, np.array([HIGHEST]))[0]))
    first = int(far[-1]) + 1 if len(far) else 0
    still, enough = np.abs(log["command"]) < 1e-9, round(STILL / PERIOD)
    if len(f) - first < enough:
        return None
    rests = np.flatnonzero(np.convolve(still[first:], np.ones(enough), "valid") > enough - 0.5)
    begin = first + int(rests[0]) + enough - 1 if len(rests) else len(f)
    moving = np.flatnonzero(np.abs(log["command"][begin:]) > MOVING)
    enough_moves = len(moving) > 0 and (len(f) - begin - moving[0] - SETTLED) * PERIOD >= LEAST
    return slice(begin, len(f)) if enough_moves else None


def mounted(axis: z_axis.Params, x: np.ndarray) -> z_axis.Params:
    """The axis with what the logarithms ``x`` say, in the order of :data:`PRIOR`."""
    backlash, resonance, zeta, compliance = np.exp(x).tolist()
    return axis._replace(backlash=backlash, omega_r=2 * np.pi * resonance, zeta_r=zeta, compliance=min(compliance, 1.0))


class Errors:
    """What nozzles leave of a log's frequency, in parts per million of it."""

    def __init__(self, log: Log, where: slice, axis: z_axis.Params, swept: Swept) -> None:
        self.axis, self.head = axis, swept.params
        self.command, encoder, self.frequency = (log[key][where] for key in ("command", "encoder", "frequency"))
        # The height of the first samples, at rest, is what the sensor says; the head moves by the encoder from there.
        rest = np.median(self.frequency[: round(STILL / PERIOD) // 2])
        heights = np.geomspace(0.02, 3 * HIGHEST, 2000)
        self.start = float(np.interp(rest, frequency_at(self.head, heights), heights))
        basis = np.polynomial.chebyshev.chebvander(2 * (encoder - encoder.min()) / np.ptp(encoder) - 1, SMOOTH)
        # Where the motor is has been measured; what a candidate adds is how far the nozzle is from it. Encoder and
        # count need not be of the same instant, so an error in proportion to the speed is free as well.
        self.motor = self.start + encoder - np.median(encoder[: round(STILL / PERIOD) // 2])
        near = np.maximum(self.motor, 0.05)
        steep = frequency_at(self.head, near + 1e-3) / frequency_at(self.head, near) - 1
        basis = np.column_stack([basis, steep * np.gradient(encoder) / np.ptp(np.gradient(encoder))])
        self.good = np.arange(len(encoder)) > np.flatnonzero(np.abs(self.command) > MOVING)[0] + SETTLED
        self._free = np.linalg.qr(basis * self.good[:, None])[0]
        alone = self(self._tried(np.log([[1e-3, 100.0, 0.05, 0.01]])))[0]
        quick = alone - ndimage.median_filter(alone, 9)
        self.good &= np.abs(quick) < OUTLYING * 1.4826 * np.median(np.abs(quick[self.good]))
        self._free = np.linalg.qr(basis * self.good[:, None])[0]
        self.worth = float(self.good.sum() - basis.shape[1])

    def __call__(self, axes: list[z_axis.Params]) -> np.ndarray:
        """Shape (axes, samples)."""
        motor, nozzle = np.moveaxis(candidates.courses(axes, self.command, self.start), 2, 0)
        made = self.motor + nozzle - motor
        off = 1e6 * (frequency_at(self.head, np.maximum(made, 1e-3)) / self.frequency - 1) * self.good
        left: np.ndarray = off - (off @ self._free) @ self._free.T
        return left

    def _tried(self, points: np.ndarray) -> list[z_axis.Params]:
        return [mounted(self.axis, x) for x in points]

    def of(self, points: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """The same of logarithms, as a :class:`posterior.Problem` asks; there is one cell."""
        return np.concatenate([self(self._tried(points[i : i + 64])) for i in range(0, len(points), 64)])


def identify(log: Log, swept: Swept, axis: z_axis.Params, seed: int = 0) -> Found | None:
    """Mountings that may have made a log.

    Args:
        log: a motion log with frequency, whose end is near the plate.
        swept: the head.
        axis: the drive, as it was found from the same log.
        seed: of the sampling.

    Returns:
        None where the log does not come near the plate.
    """
    where = part(log, swept)
    if where is None:
        return None
    errors = Errors(log, where, axis, swept)
    problem = posterior.Problem(errors.of, _LOW, _HIGH, errors.worth)
    grid = np.array(list(itertools.product((2e-3, 8e-3, 0.025), np.geomspace(35, 350, 16), (0.05,), (0.05, 0.2))))
    first = np.log(grid)
    costs = np.sum(errors.of(first, np.zeros(len(first))) ** 2, axis=1)
    # A ringing has a valley of its own: the best of each resonance, the best of these.
    begin = [min(range(len(first)), key=lambda i: costs[i] + 1e99 * (first[i, 1] != f)) for f in np.unique(first[:, 1])]
    begin.sort(key=lambda i: float(costs[i]))
    valleys = [posterior.nearest(problem, first[i], 0.0, 12) for i in begin[:STARTS]]
    found = posterior.sampled_valleys(problem, valleys, np.random.default_rng(seed))
    at_1 = frequency_at(errors.head, np.array([1.0, 1.001]))
    draws = dict(zip(PRIOR, np.exp(found.draws).T, strict=True))
    # What a frequency is in mm is no better known than the head, and both of these are mm.
    unsure = _steepness(swept, len(found.draws), np.random.default_rng(seed + 1))
    draws |= {key: np.clip(draws[key] / unsure, *PRIOR[key]) for key in ("backlash", "compliance")}
    return Found(draws, found.left * 1e-6 * float(at_1[0] / (at_1[1] - at_1[0])), found.effective)


def _steepness(swept: Swept, count: int, rng: np.random.Generator) -> np.ndarray:
    """How steeply frequency rises with height where the jolts are, of heads that the sweep leaves possible, over that
    of the best; shape (count,)."""
    middle, heights = np.log(list(swept.values.values())), np.array([TYPICAL, TYPICAL + 1e-3])
    heads = [middle, *rng.multivariate_normal(middle, swept.covariance, count)]
    rise = [float(np.diff(np.log(frequency_at(params_of(np.exp(x).tolist(), swept.known), heights)))[0]) for x in heads]
    return np.asarray(rise[1:]) / rise[0]
