"""Causal bounds: what no controller that has only the sensor can go below, scenario by scenario.

The method, its assumptions and the figures are in ``docs/bounds.md``; ``python -m kerfgym.experiments.bounds`` makes
the figures anew. Each ingredient is a part that can be added to others: random sheets and vibrations (:mod:`spectrum`),
shapes of unknown size (:mod:`shapes`), the sensor's noise (:mod:`noise`), what the drive can reach (:mod:`reach`);
:mod:`prediction` makes an error of them, :mod:`scenario` reads them from scenario and machine, and :mod:`known` says
for which scenarios that is possible. Where feed or sheet change meanwhile, :mod:`changing` and :mod:`moving` take over.
"""

from .stored import recorded, stale

__all__ = ["recorded", "stale"]
