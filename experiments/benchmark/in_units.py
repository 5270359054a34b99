"""What a user would set on a machine to have a controller: parameters with units, for a report's first screen.

Of a preset these are its law's, and the kind of its filter with all that this kind reads. Of a ``tuned.toml``, and
where parameters are given behind a name, they are those that differ from the controller that it was before.
"""

from typing import Any

from ...envs.control import stack as stacks
from ...envs.control.stack import Team
from ..tune.space import read
from ..tune.verdict import setting, unit


def settings(spec: str, team: Team) -> dict[str, Any]:
    """As a run's record holds it: ``of``, the controller that it was before, empty of a preset; ``policy``, whether a
    learned policy acts in it, which no list of parameters holds; ``rows``: name, value, unit, and value before.

    Args:
        spec: the controller as it was asked for.
        team: what that is.
    """
    known, of = team.parameters(), _before(spec)
    base = stacks.asked(of).parameters() if of else {}
    if set(base) == set(known):
        names = [name for name in known if known[name].value != base[name].value]
    else:
        of, base = "", {}
        kinds = {name for name in known if name.endswith("filter.kind")}
        reads = {*read(known), *kinds}
        names = [name for name in known if name in reads or name.split(".")[-2] in ("law", "plan")]
    rows = []
    for name in names:
        now, was = (setting(at[name].value, at[name].quantity) if at else "" for at in (known, base))
        rows.append([name, now, unit(known[name].quantity), was])
    return {"of": of, "policy": any(stack.pilot is not None for stack in team.stacks), "rows": rows}


def _before(spec: str) -> str:
    """The controller from which what was asked for differs by parameters alone; empty if it is one by itself."""
    if spec.endswith(".toml"):
        return stacks.tuned(spec)[0]
    before, colon, changes = spec.rpartition(":")
    return before if colon and "=" in changes and "=" not in before else ""
