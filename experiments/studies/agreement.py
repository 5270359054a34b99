"""Study of agreement: whether the following suite's ranking holds on sheets elsewhere, from the two suites' results."""

import itertools
from typing import Any

from ...envs.engine.quantity import InvalidInput
from . import recorded
from .registry import Trial, study

HERE, THERE = "following", "elsewhere"

FIRST = 5
"""Controllers of the sensor's class that are compared: the first of :data:`HERE`."""

FACTOR = 1.5
"""How far the ratios to the reference may be apart."""


def compared(here: dict[str, Any], there: dict[str, Any]) -> dict[str, Any]:
    """Of the first ranked controllers: place and ratio to the reference in either suite, and whether they agree.

    The order is the same if no two of them change places; those that a suite's ranking does not tell apart have none.

    Args:
        here, there: ``numbers`` of two suites' studies: by controller ``information``, ``rank``, ``score``, ``ratio``.

    Returns:
        ``rows`` by controller: ``here, there`` (places among these, 1 is first, shared as the ranks are; None without
        a rank), ``ratio_here, ratio_there``,
        ``quotient`` (the larger over the smaller; None without both); ``order`` and ``ratios``, ``yes`` or ``no``;
        ``farthest``, the largest quotient.
    """
    fair = [
        name
        for name, row in here.items()
        if row["information"] == "sensor" and row["rank"] is not None and row["score"] is not None
    ]
    chosen = sorted(fair, key=lambda name: (here[name]["rank"], here[name]["score"]))[:FIRST]
    places_here, places_there = _places(chosen, here), _places(chosen, there)
    rows: dict[str, dict[str, Any]] = {}
    for name in chosen:
        mine, other = here[name]["ratio"], there.get(name, {}).get("ratio")
        quotient = max(mine / other, other / mine) if mine and other else None
        rows[name] = {"here": places_here[name], "there": places_there[name]}
        rows[name] |= {"ratio_here": mine, "ratio_there": other, "quotient": quotient}
    quotients = [row["quotient"] for row in rows.values()]
    whole = bool(rows) and None not in quotients
    return {
        "rows": rows,
        "farthest": max(quotients) if whole else None,
        "order": "yes" if rows and _same_order(places_here, places_there) else "no",
        "ratios": "yes" if whole and max(quotients) <= FACTOR else "no",
    }


def _places(names: list[str], numbers: dict[str, Any]) -> dict[str, int | None]:
    """Place of each among these names by their ranks; None without a rank."""
    ranks = {name: numbers.get(name, {}).get("rank") for name in names}
    known = [rank for rank in ranks.values() if rank is not None]
    return {name: None if rank is None else 1 + sum(other < rank for other in known) for name, rank in ranks.items()}


def _same_order(here: dict[str, int | None], there: dict[str, int | None]) -> bool:
    """Whether all have places in both, and no two are the other way round."""
    if None in (*here.values(), *there.values()):
        return False
    return all((here[a] - here[b]) * (there[a] - there[b]) >= 0 for a, b in itertools.combinations(here, 2))  # type: ignore[operator]


@study(
    "agreement",
    f"whether the first {FIRST} of {HERE} keep order and ratios on sheets {THERE}",
    "python -m kerfgym.experiments.manual following elsewhere agreement",
    0.1,
    ("docs/results/[ef]*w*.json",),  # both in one pattern, because one that was never run is no file yet
)
def agreement(trial: Trial) -> dict[str, Any]:
    """From stored results; nothing is run.

    Raises:
        InvalidInput: one of the two studies was never run.
    """
    here, there = (_stored(name) for name in (HERE, THERE))
    return {"seeds": here["seeds"], "numbers": compared(here["numbers"], there["numbers"])}


def _stored(name: str) -> dict[str, Any]:
    body = recorded.read(name)
    if body is None:
        raise InvalidInput(f"'{name}' was never run; python -m kerfgym.experiments.manual {name}")
    return body
