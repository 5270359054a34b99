"""What to set: the parameters of who is best, on the first screen."""

from typing import Any

import numpy as np

from ..statistics.rivals import is_learned
from .standing import Standing
from .suite import Suite


def to_set(suite: Suite, standing: Standing, labels: dict[str, str]) -> list[dict[str, Any]]:
    """The best controller with its settings; before it one that is closer and not ranked, for its budget alone; and, if
    the best is a learned policy, the best of those that can be set by hand. Nothing where a run recorded none.

    Each has ``label``, ``lead``, a sentence before its parameters, and ``rows``: name, value, unit, value before.
    """
    known = suite.results.meta.get("settings") or {}
    out = []
    for name in _asked(suite, standing, known):
        own = known[name]
        if own["policy"]:
            lead = f"is taken as it is, -c {name}: it is not set by hand"
            out.append({"label": labels[name], "lead": lead, "rows": []})
        else:
            lead = f"differs from {own['of']} in" if own["of"] else "has"
            lead = f"is closer, though not ranked, and {lead}" if standing.frame.at[name, "reasons"] else lead
            out.append({"label": labels[name], "lead": lead, "rows": own["rows"]})
    return out


def _asked(suite: Suite, standing: Standing, known: dict[str, Any]) -> list[str]:
    best = standing.best
    if best is None or best not in known:
        return []
    reasons = standing.frame["reasons"]
    before = [name for name in standing.order[: standing.order.index(best)] if name in known and reasons[name]]
    closer = [name for name in before if all(why.startswith("tuned with ") for why in reasons[name])][:1]
    if not known[best]["policy"]:
        return [*closer, best]
    scores = standing.frame["score"].astype(float)
    by_hand = [
        name
        for name in standing.order
        if name in known and not known[name]["policy"] and not is_learned(suite.results, name)
        if suite.summary.at[name, "information"] == suite.summary.at[best, "information"] and np.isfinite(scores[name])
    ]
    return [*closer, best, *by_hand[:1]]


def sheets(suite: Suite) -> str:
    """On which sheets it was run, in words."""
    names, scored = suite.results.scenarios, suite.scored
    some = f"{len(names)} scenarios" if len(names) > 6 else ", ".join(names)
    counts = "" if set(scored) == set(names) else f"; {len(scored)} of them count"
    return f"{suite.title}: {some}{counts}"
