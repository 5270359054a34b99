"""Blame: what each stage of the machine costs a controller, and how references with other information do beside it.

A share may be negative. A controller that was tuned around a fault can do worse without it; then the fault is of use to
it, and a controller retuned for the better machine might do without. Likewise what is left to the law is left at its
present gains, which the stages' delays forbid it to raise.
"""

from .blaming import blame, in_report
from .game import Blame, measure, shapley

__all__ = ["Blame", "blame", "in_report", "measure", "shapley"]
