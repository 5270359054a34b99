"""Figures of jobs: contour, height, quality and time, from what the machines have added up. Lengths of cut weigh."""

from dataclasses import dataclass

import numpy as np

from ..paths.job import PlannedJob
from ..plant.fleet import Fleet
from ..plant.gantry import Sums
from ..plant.published import Excess
from .registered import Called, Registry, Shown

DONE = 0.98
"""Share of a job that must be cut."""


@dataclass(frozen=True)
class Jobs:
    """What machines added up over one job each: arrays of shape (machines,)."""

    sums: dict[str, np.ndarray]
    collided: np.ndarray
    lowest: np.ndarray  # mm, smallest gap
    covered: np.ndarray  # share of the job's cuts that lies behind
    worst: dict[str, np.ndarray]  # largest excess over the published settings while cutting

    @classmethod
    def of(cls, fleet: Fleet, job: PlannedJob) -> "Jobs":
        """What the machines of a fleet have added up, all of them with the same job."""
        assert fleet.gantries
        sums = {name: fleet.gantries.column(f"sums.{name}") for name in Sums._fields}
        near = np.nan_to_num(fleet.gantries.column("progress.near")).astype(int)
        covered = job.cut_s[np.clip(near, 0, len(job.x) - 1)] / job.cut_length
        worst = {name: fleet.gantries.column(f"worst.{name}") for name in Excess._fields}
        return cls(sums, fleet.column("tally.collided") > 0.5, fleet.column("tally.lowest"), covered, worst)

    def mean(self, name: str) -> np.ndarray:
        """Mean over the length that was cut."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return self.sums[name] / self.sums["length"]


METRICS = Registry()
metric = METRICS.metric

CONTOUR, GAP, CUT, TIME = "contour error", "true gap error", "cut", "time"


def evaluate(jobs: Jobs) -> dict[str, np.ndarray]:
    """Every metric by name; a failed run has none but those that are always known."""
    lost = failed(jobs)
    figures = {name: each.function(jobs) for name, each in METRICS.items()}
    return {name: f if METRICS[name].always else np.where(lost, np.nan, f) for name, f in figures.items()}


def evidence(jobs: Jobs) -> dict[str, np.ndarray]:
    """``extrapolated``, the share of the cut that was made with settings outside those that its figures were calibrated
    on, and the largest excess of each setting, ``beyond_…`` (:mod:`evidence`)."""
    return {"extrapolated": jobs.mean("outside"), **{f"beyond_{name}": x for name, x in jobs.worst.items()}}


def broken(jobs: Jobs) -> np.ndarray:
    """Whether a run holds anything that is not finite, cut nothing, or left more than 2 % of the job undone."""
    finite = np.all([np.isfinite(values) for values in jobs.sums.values()], axis=0)
    return ~finite | (jobs.sums["length"] <= 0) | (jobs.covered < DONE)


def failed(jobs: Jobs) -> np.ndarray:
    """Whether a run is broken or the nozzle touched the sheet: after that the head stays up, and nothing is cut."""
    return broken(jobs) | jobs.collided


@metric(
    "µm",
    pooled="rms",
    shown=Shown("contour RMS", "{:.1f}", "", CONTOUR, "RMS", brief=True, manual=True),
    called=Called("contour error", "closer", "contour error, RMS"),
)
def contour_rms(jobs: Jobs) -> np.ndarray:
    """RMS distance of the actual from the commanded path while cutting"""
    return 1e3 * np.sqrt(jobs.mean("contour2"))


@metric(
    "µm",
    pooled="largest",
    shown=Shown("contour max", "{:.0f}", "", CONTOUR, "max", brief=True, manual=True),
    called=Called(exact="contour error, largest"),
)
def contour_max(jobs: Jobs) -> np.ndarray:
    """Largest distance of the actual from the commanded path while cutting"""
    return 1e3 * jobs.sums["contour_worst"]


@metric(
    "µm",
    pooled="rms",
    shown=Shown("gap RMS", "{:.1f}", "", GAP, "RMS", brief=True, manual=True),
    called=Called("standoff error", "closer", "standoff error, RMS", "following error"),
)
def gap_rms(jobs: Jobs) -> np.ndarray:
    """RMS of the true standoff error while cutting"""
    return 1e3 * np.sqrt(jobs.mean("gap2"))


@metric("µm", pooled="largest", shown=Shown("gap max", "{:.0f}", "", GAP, "max", brief=True))
def gap_max(jobs: Jobs) -> np.ndarray:
    """Largest true standoff error while cutting"""
    return 1e3 * jobs.sums["gap_worst"]


@metric("mm", shown=Shown("dross", "{:.3f}", "", CUT, brief=True, manual=True), called=Called("dross", "less"))
def dross(jobs: Jobs) -> np.ndarray:
    """Height of the dross, mean along the cut"""
    return jobs.mean("dross")


@metric("µm", shown=Shown("Rz", "{:.1f}", "", CUT, brief=True, manual=True), called=Called("roughness Rz", "smoother"))
def roughness(jobs: Jobs) -> np.ndarray:
    """Roughness Rz, mean along the cut"""
    return 1e3 * jobs.mean("roughness")


@metric("1", "higher", zero=True, shown=Shown("through", "{:.2f}", "", CUT, brief=True, seldom=True))
def through(jobs: Jobs) -> np.ndarray:
    """Share of the cut that goes through the sheet"""
    return jobs.mean("through")


@metric("mm", shown=Shown("kerf", "{:.3f}", "", CUT, brief=True, seldom=True))
def kerf(jobs: Jobs) -> np.ndarray:
    """Width of the kerf at the top, mean along the cut"""
    return jobs.mean("kerf")


@metric("mm", shown=Shown("u", "{:.3f}", "", CUT, brief=True, compared=True))
def taper(jobs: Jobs) -> np.ndarray:
    """Perpendicularity u, mean along the cut"""
    return jobs.mean("taper")


@metric(
    "s",
    shown=Shown("time", "{:.2f}", "", TIME, "job", brief=True, manual=True),
    called=Called("time of the job", "faster"),
)
def time(jobs: Jobs) -> np.ndarray:
    """Time of the whole job: rapids, piercing, cutting"""
    return jobs.sums["time"]


@metric("s", shown=None)
def cutting_time(jobs: Jobs) -> np.ndarray:
    """Time spent in lead-ins and cuts"""
    return jobs.sums["cutting"]


@metric("mm/s", "higher", shown=Shown("feed", "{:.1f}", "", TIME, brief=True))
def mean_feed(jobs: Jobs) -> np.ndarray:
    """Length cut over the time spent cutting"""
    with np.errstate(invalid="ignore", divide="ignore"):
        return jobs.sums["length"] / jobs.sums["cutting"]


@metric("kJ", shown=Shown("energy", "{:.2f}", "", TIME, brief=True, compared=True))
def energy(jobs: Jobs) -> np.ndarray:
    """Energy of the beam"""
    return 1e-3 * jobs.sums["energy"]


@metric("W", pooled="largest", shown=None)
def power_max(jobs: Jobs) -> np.ndarray:
    """Largest power of the beam while cutting"""
    return jobs.sums["power_most"]


@metric("mm", pooled="largest", shown=None)
def dither_max(jobs: Jobs) -> np.ndarray:
    """Largest amplitude that the galvo realised while cutting"""
    return jobs.sums["dither_most"]


@metric("1", "higher", zero=True, always=True, shown=None)
def covered(jobs: Jobs) -> np.ndarray:
    """Share of the job's cuts that was travelled"""
    return jobs.covered


@metric("1", zero=True, always=True, shown=None)
def collision(jobs: Jobs) -> np.ndarray:
    """1 if the nozzle touched the sheet"""
    return jobs.collided.astype(float)
