"""Bounds of scenarios: every number is read from machines that were prepared for the scenario, seed by seed.

Three figures for each scenario, all RMS of the true gap error over the benchmark's seeds, µm:

- ``bound``: for any causal controller with only the sensor. All that was drawn once is given away, since it may be
  learned before the score begins: slopes, phases, amplitudes, frequencies. So only what is random for good counts
  (:mod:`lasting`), and steps, of which it must be read off which way they go.
- ``learned``: an estimate of what is left if these have to be learned at the set height (:mod:`estimates`).
- ``linear``: for a fixed linear predictor that is tuned to the scenario's ensemble (:mod:`linear`).

What is added when machines learn to do more: an ingredient of :mod:`spectrum` or :mod:`shapes` in
:func:`ingredients.random_part`, :func:`estimates.drawn_part` and :func:`linear.ensemble`, and its name in :mod:`known`.
Where feed or sheet change meanwhile, :mod:`moving` takes over.
"""

from collections.abc import Sequence

import numpy as np

from ...envs.plant import sheet
from ...envs.plant.fleet import Fleet
from ...envs.scenarios import Scenario
from . import estimates, lasting, linear, moving, noise, prediction
from .ingredients import Lines, of_sizes, of_surface, of_vibrations, prepared, random_part, steps_of
from .known import check
from .lowering import Sight
from .reach import WINDOW, Reach
from .spectrum import Random
from .stored import Bound

EVERY = 100
"""Control periods between the moments at which an error is estimated."""

NEWEST = 6
"""Commands of which is asked how far they can move the head."""

AROUND = 2 * WINDOW
"""Control periods around a step of which only the step is counted."""


def of(scenario: Scenario, seeds: Sequence[int]) -> Bound:
    """The bounds of a scenario over ``seeds``.

    Raises:
        InvalidInput: no bound is known for it.
    """
    check(scenario)
    fleet = prepared(scenario, scenario.some(seeds))
    figures = _moving if scenario.corners or scenario.turns else _straight
    rows = np.array([figures(fleet, scenario, i, sight) for i, sight in enumerate(noise.sights(fleet))])
    bound, learned, fixed, known, steps = np.sqrt(rows.mean(axis=0)).tolist()
    parts = {"prediction": known, "steps": steps, **noise.ingredients(fleet)}
    return Bound(bound, max(learned, bound), None if linear.ensemble(scenario).empty else max(fixed, bound), parts)


def _straight(fleet: Fleet, scenario: Scenario, i: int, sight: Sight) -> tuple[float, ...]:
    """Mean squares of machine ``i``, µm²: bound, learned, linear, and of the bound sheet and steps."""
    axis, random = Reach.of(fleet.get("z", i)), random_part(fleet, scenario, i)
    horizons, reach = axis.horizon + np.arange(NEWEST + 1), axis.within(NEWEST)
    scored = scenario.steps - scenario.settle_steps
    known = lasting.mean_square(random, sight, horizons, reach, scored) if random.xx > 0.0 else 0.0
    steps, calm = _steps(fleet, scenario, i, axis)
    guess = _learned(fleet, scenario, i, random, sight.noise, axis)
    fixed = linear.ensemble(scenario).error(sight.noise, axis.horizon)
    return max(known, calm * known + steps), max(guess, calm * guess + steps), fixed, known, steps


def _learned(fleet: Fleet, scenario: Scenario, i: int, random: Random, sigma: float, axis: Reach) -> float:
    """Mean square that is left to one that learns at the set height, µm²."""
    lines = Lines.of(fleet, scenario)
    # In the middle of each stretch: errors fall and ever more slowly, so their mean is rather under- than overstated.
    at = np.arange(scenario.settle_steps, scenario.steps - EVERY // 2, EVERY) + EVERY // 2
    news = NEWEST if random.xx > 0.0 else 0  # of what was drawn once, the newest readings tell next to nothing
    drawn = estimates.drawn_part(lines, i, fleet, scenario, linear.ensemble(scenario).spread)
    variances = prediction.errors(random, drawn, sigma, axis.horizon + np.arange(news + 1), at)
    return float(prediction.held_back(variances, axis.within(NEWEST)).mean())


def _moving(fleet: Fleet, scenario: Scenario, i: int, sight: Sight) -> tuple[float, ...]:
    """The same where feed or sheet change meanwhile: of continuous spectrum and bands; the rest is given away."""
    axis, journey = Reach.of(fleet.get("z", i)), fleet.get("path", i)
    horizons, reach = axis.horizon + np.arange(NEWEST + 1), axis.within(NEWEST)
    shaken, trembling = of_vibrations(fleet, scenario, i), 0.0
    if shaken.xx > 0.0:
        # A turn is long; what finer readings before it told is forgotten while one turn fades into the next.
        trembling = lasting.mean_square(shaken, sight, horizons, reach, scenario.steps)
    along = moving.Along(journey, of_surface(scenario), float(of_sizes(fleet)[i]), sight, horizons, reach)
    begin = scenario.settle_steps
    if scenario.turns:
        found = moving.over_turns(scenario, along, trembling)
    else:
        found = float(np.mean(np.maximum(along.errors(0.0, scenario.steps, begin, begin), trembling)))
    return found, found, linear.ensemble(scenario).error(sight.noise, axis.horizon), found, 0.0


def _steps(fleet: Fleet, scenario: Scenario, i: int, axis: Reach) -> tuple[float, float]:
    """What the steps of machine ``i`` cost, mean square over the scored periods, µm², and the share of periods that
    are not near any of them."""
    heights, starts = steps_of(fleet, scenario, i)
    if not len(heights):
        return 0.0, 1.0
    scored = range(scenario.settle_steps, scenario.steps)
    feed = float(fleet.column("path.feed")[i])
    costs = axis.cost_of_steps(heights, starts, feed, scenario.head.plate, sheet.FOOTPRINT, scored)
    return float(costs.sum()) / len(scored), max(1.0 - len(heights) * AROUND / len(scored), 0.0)
