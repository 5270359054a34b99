"""Study of agreement: whether the following suite's ranking holds on sheets elsewhere, from the two suites' results."""

from typing import Any

from ...envs.plant.quantity import InvalidInput
from . import store
from .study import Trial, study

HERE, THERE = "following", "elsewhere"

FIRST = 5
"""Controllers of the sensor's class that are compared: the first of :data:`HERE`."""

FACTOR = 1.5
"""How far the ratios to the reference may be apart."""


def compared(here: dict[str, Any], there: dict[str, Any]) -> dict[str, Any]:
    """Of the first ranked controllers: place and ratio to the reference in either suite, and whether they agree.

    Args:
        here, there: ``numbers`` of two suites' studies: by controller ``information``, ``rank``, ``score``, ``ratio``.

    Returns:
        ``rows`` by controller: ``here, there`` (places among these, 1 is closest), ``ratio_here, ratio_there``,
        ``quotient`` (the larger over the smaller; None without both); ``order`` and ``ratios``, ``yes`` or ``no``;
        ``farthest``, the largest quotient.
    """
    fair = [
        name for name, row in here.items()
        if row["information"] == "sensor" and row["rank"] is not None and row["score"] is not None
    ]  # fmt: skip
    chosen = sorted(fair, key=lambda name: (here[name]["rank"], here[name]["score"]))[:FIRST]
    scores = {name: there.get(name, {}).get("score") for name in chosen}
    known = sorted((name for name in chosen if scores[name] is not None), key=lambda name: scores[name])
    rows: dict[str, dict[str, Any]] = {}
    for place, name in enumerate(chosen, start=1):
        mine, other = here[name]["ratio"], there.get(name, {}).get("ratio")
        quotient = max(mine / other, other / mine) if mine and other else None
        rows[name] = {
            "here": place, "there": known.index(name) + 1 if name in known else None, "ratio_here": mine,
            "ratio_there": other, "quotient": quotient,
        }  # fmt: skip
    quotients = [row["quotient"] for row in rows.values()]
    whole = bool(rows) and None not in quotients
    return {
        "rows": rows, "farthest": max(quotients) if whole else None,
        "order": "yes" if rows and all(row["here"] == row["there"] for row in rows.values()) else "no",
        "ratios": "yes" if whole and max(quotients) <= FACTOR else "no",
    }  # fmt: skip


@study(
    "agreement", f"whether the first {FIRST} of {HERE} keep order and ratios on sheets {THERE}",
    "python -m kerfgym.experiments.figures following elsewhere agreement", 0.1,
    ("docs/results/[ef]*w*.json",),  # both in one pattern, because one that was never run is no file yet
)  # fmt: skip
def agreement(trial: Trial) -> dict[str, Any]:
    """From stored results; nothing is run.

    Raises:
        InvalidInput: one of the two studies was never run.
    """
    found: dict[str, dict[str, Any]] = {}
    for name in (HERE, THERE):
        body = store.read(name)
        if body is None:
            raise InvalidInput(f"'{name}' was never run; python -m kerfgym.experiments.figures {name}")
        found[name] = body
    return {"seeds": found[HERE]["seeds"], "numbers": compared(found[HERE]["numbers"], found[THERE]["numbers"])}
