"""All that is known of a search's result when it is over, beside the trials: what it is worth on seeds that the search
did not see, and how its loop stands on machines that the scenarios may draw."""

from dataclasses import dataclass

from ..measure import population
from ..measure.population import Population
from ..store.ledger import Ledger
from .outcome import Found
from .study import RollOuts
from .worth import Ran, Worth, worth


@dataclass(frozen=True)
class Assessed:
    """What is known of a result.

    Attributes:
        worth: on test seeds, before and after.
        margins: Ms and margins before and after; none of a search of jobs.
        ledger: what measuring those took.
    """

    worth: Worth
    margins: tuple[Population, Population] | None
    ledger: Ledger


def assessed(work: RollOuts, found: Found, before: Ran, after: Ran) -> Assessed:
    """Measures what is still missing.

    Args:
        work: of the study.
        found: its result.
        before, after: runs on test seeds of the controller as it stood and of the result.
    """
    evaluator, task = work.evaluator, work.task
    on_tune = [Ran(evaluator.whole(each, task.wanted), evaluator) for each in (work.base, found.controller)]
    told = worth(task, (on_tune[0], before), (on_tune[1], after))
    if task.jobs:
        return Assessed(told, None, Ledger())
    both = [
        population.measured(each.full.z, evaluator.scenarios, evaluator.threads)
        for each in (work.base, found.controller)
    ]
    return Assessed(told, (both[0], both[1]), both[0].ledger + both[1].ledger)
