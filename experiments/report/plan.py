"""Plans of the parts that were cut, as they were before the run."""

import base64
from typing import Any

from .numbers import count
from .suite import Suite


def shown(suites: list[Suite]) -> list[dict[str, Any]]:
    """The pictures with what is said beside them, each once."""
    out: dict[bytes, dict[str, Any]] = {}
    for suite in suites:
        for row in suite.results.plans.itertuples():
            new = {"picture": base64.b64encode(row.picture).decode(), "cuts": count(int(row.cuts), "cut")}
            one = out.setdefault(row.picture, {**new, "warnings": row.warnings.splitlines(), "names": []})
            one["names"] += [name for name in row.scenarios.split(", ") if name not in one["names"]]
    return list(out.values())
