"""The front of time, dross and Rz that no choice of calibrated settings can beat, with no contour error at all.

All three are sums along the path. So every millimetre may be looked at alone: all feeds up to what the plan allows
there, all dithers and focus offsets of the calibrated cuts are tried (:func:`catalogue`), with a head and axes that
make no error, and for each weighting the best are taken. What a weighting finds minimises its sum over all policies of
a scenario, those that know everything included; between weightings the front is as fine as there are weightings. The
feed that the plan allows is that of a run at the planned feed. A contour error of 0 is not possible either, so the
bound is generous there.
"""

from dataclasses import dataclass

import numpy as np

from ....envs import scenarios
from ....envs.control import stack as stacks
from ....envs.figures import evidence, job_metrics
from ....envs.plant import cut, published
from ....envs.scenarios import Scenario
from ....envs.tasks import workshop
from ...results import jobs
from .points import METRICS, efficient

FEEDS, DITHERS, DEPTHS, FOCI = 100, 25, 3, 3
"""How many of each setting are tried, evenly from the least to the most."""

REALISED = 0.98
"""Share of a commanded dither that the optics make of it at least: what allows a feed is the command."""


@dataclass(frozen=True)
class Catalogue:
    """Settings: feed in mm/s, dross in mm, Rz in µm, each of shape (n,), in order of the feed."""

    feed: np.ndarray
    dross: np.ndarray
    rough: np.ndarray


def catalogue(material: str = "c45-10") -> Catalogue:
    """What every combination of calibrated settings makes of a straight cut without errors, where it cuts through."""
    known, steel = evidence.calibrated(material), workshop.material(material, None)
    hertz, rows = known.frequency_low, []
    for x in np.linspace(0.0, known.amplitude, DITHERS):
        most = float(published.fastest(known, min(x / REALISED, known.amplitude)))
        for feed in np.linspace(known.feed_high / FEEDS, known.feed_high, FEEDS):  # in corners the plan is slow
            if feed > most + 1e-9:
                break
            for z in np.linspace(0.0, known.deep_low, DEPTHS):
                for focus in np.linspace(-known.focus, known.focus, FOCI):
                    beam = cut.beam(steel.params, steel.power, x, x, z, focus, hertz)
                    found = cut.step(steel.params, beam, cut.fresh(), feed, 0.0, 0.0, 1e-3)[1]
                    if found.through:
                        rows.append((feed, found.dross, 1e3 * found.roughness))
    table = np.array(sorted(rows)).T
    return Catalogue(*table)


@dataclass(frozen=True)
class Way:
    """A scenario's path: mm that may be cut at most at each feed (mm/s), and s that all else takes."""

    feeds: np.ndarray
    lengths: np.ndarray
    rest: float


def way(scenario: Scenario, seed: int) -> Way:
    """The path of a scenario at the planned feed."""
    team = stacks.asked("huang2024-dynamic").full
    fleet, job, channels = jobs.roll(scenario, team, [seed], record=True)
    assert channels is not None
    speed = channels[:, jobs.gantry.CHANNELS.index("speed"), 0].astype(float)
    phase = channels[:, jobs.gantry.CHANNELS.index("phase"), 0]
    done = job_metrics.Jobs.of(fleet, job)
    figures = {m: float(job_metrics.METRICS[m].function(done)[0]) for m in ("time", "cutting_time")}
    on = np.isin(phase, (jobs.gantry.LEAD_IN, jobs.gantry.CUT)) & (speed > 0.05)
    length = speed[on] * 1e-3
    edges = np.linspace(0.0, evidence.calibrated("c45-10").feed_high, FEEDS + 1)  # those of the catalogue
    lengths = np.histogram(np.minimum(speed[on], edges[-1]), edges, weights=length)[0]
    return Way(edges[1:], lengths, figures["time"] - figures["cutting_time"])


def best(way: Way, settings: Catalogue, weights: np.ndarray) -> np.ndarray:
    """Time, dross and Rz of the policy that minimises their weighted sum: s, mm and µm, the weights in 1/each."""
    total = way.lengths.sum()
    cost = weights[0] * total / settings.feed + weights[1] * settings.dross + weights[2] * settings.rough
    figures = np.zeros(3)
    for feed, length in zip(way.feeds, way.lengths, strict=True):
        at = int(np.argmin(cost[: max(int(np.searchsorted(settings.feed, feed + 1e-9, side="right")), 1)]))
        share = length / total
        figures += [length / settings.feed[at], share * settings.dross[at], share * settings.rough[at]]
    return figures + np.array([way.rest, 0.0, 0.0])


def bound(suite: str, seed: int, most_time: float = 2.999) -> np.ndarray:
    """Points of the bound, shape (n, 4) as :data:`points.METRICS`, over the suite's core; the contour error is 0.

    Args:
        suite: whose core is pooled: geometric mean over scenarios.
        seed: whose paths are taken; they differ by the drives alone.
        most_time: times the time at the planned feed, beyond which a job has failed.
    """
    settings = catalogue()
    ways = [way(scenarios.suite(suite)[name], seed) for name in scenarios.core(suite)]
    first = [best(w, settings, np.array([1.0, 0.0, 0.0])) for w in ways]
    found = []
    for rough in (0.0, *np.geomspace(0.02, 20.0, 120)):
        for dross in (0.0, *np.geomspace(0.1, 1e4, 15)):
            each = [best(w, settings, np.array([1.0, dross, rough]) / f) for w, f in zip(ways, first, strict=True)]
            if all(e[0] <= most_time * f[0] for e, f in zip(each, first, strict=True)):
                found.append([*np.exp(np.log(each).mean(axis=0)), 0.0])
    points = np.array(found)
    assert points.shape[1] == len(METRICS)
    return points[efficient(points)]
