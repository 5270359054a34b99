"""Who is to blame for what a fault did.

A run that is lost (the nozzle touched the sheet, or the state is no number) is compared with its repetitions:

=======================  ==========================================================================================
cause                    what it means
=======================  ==========================================================================================
no fault                 the run is lost without any fault
supervisor               it is not lost when every command passes
filter                   it is not lost when the newest count counts
supervisor and filter    either of them could be taken out and it would not be lost, or both must be
law's memory             with both out, it is not lost if the law begins anew when the fault is over, and is told the
                         last sound command instead of the spoilt one
fault itself             it is lost in each of these ways
=======================  ==========================================================================================

A run that is not lost has an *excess* if the fault moves the true gap further than :data:`FLOOR` away from the
faultless run, and further than :data:`EXCESS` times what it does without the supervisor (or filter). Where the
supervisor has stopped the machine with an alarm, the head is away from the sheet on purpose: that is *stopped*.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from ....envs.control.stack import Stack
from ....envs.plant import supervisor
from ....envs.scenarios import Scenario
from .drawn import Drawn, words
from .trials import ALWAYS, FAULTLESS, REPEATS, Repeat, repeats

EXCESS, FLOOR = 3.0, 0.1
"""Times, and mm."""

CAUSES = ("no fault", "supervisor", "filter", "supervisor and filter", "law's memory", "fault itself")

MENDABLE = CAUSES[1:4]
"""Causes that no law can answer for."""

EXCESSES = ("stopped", "supervisor", "filter")


def judged(scenario: Scenario, stack: Stack, given: Sequence[Drawn], threads: int = 1) -> pd.DataFrame:
    """One row a fault: what it was, what came of it in each repetition, and the cause.

    Raises:
        InvalidInput: faults cannot be put into the stack's command.
    """
    found = repeats(scenario, stack, given, ALWAYS, threads)
    shipped, bare = found["shipped"], found["no supervisor"]
    badly = np.flatnonzero(shipped.lost | (shipped.apart > FLOOR))
    rest = [name for name in REPEATS if name not in ALWAYS]
    more = repeats(scenario, stack, [given[int(i)] for i in badly], rest, threads) if len(badly) else {}
    given_of: dict[str, Any] = {key: [getattr(d, key) for d in given] for key in ("scenario", "number", "seed")}
    given_of |= {"fault": [d.name for d in given], "words": [words(d.fault) for d in given]}
    ran: dict[str, Any] = {"lost": shipped.lost, "broken": shipped.broken}
    ran |= {"lowest_mm": shipped.lowest, "apart_mm": shipped.apart}
    ran |= {"alarm": [supervisor.ALARMS[int(a)] for a in shipped.alarm], "lost_faultless": found[FAULTLESS].lost}
    ran |= {"lost_no_supervisor": bare.lost, "apart_no_supervisor_mm": bare.apart}
    frame = pd.DataFrame({"controller": stack.name, **given_of, **ran})
    for name in rest:
        column = name.replace(" ", "_")
        frame[f"lost_{column}"] = pd.array(_spread(more, name, "lost", badly, len(frame)), "boolean")
        frame[f"apart_{column}_mm"] = _spread(more, name, "apart", badly, len(frame))
    frame["cause"] = [cause(row) if row["lost"] else "" for _, row in frame.iterrows()]
    frame["excess"] = ["" if row["lost"] else excess(row) for _, row in frame.iterrows()]
    return frame


def _spread(more: dict[str, Repeat], name: str, field: str, where: np.ndarray, size: int) -> np.ndarray:
    """Values of a repetition that only some faults have; NaN for the others."""
    out = np.full(size, np.nan)
    if len(where):
        out[where] = getattr(more[name], field)
    return out


def cause(row: pd.Series) -> str:
    """One of :data:`CAUSES` for a row of a lost run."""
    if row["lost_faultless"]:
        return "no fault"
    supervisor_did, filter_did = not row["lost_no_supervisor"], not row["lost_no_filter"]
    if supervisor_did and not filter_did:
        return "supervisor"
    if filter_did and not supervisor_did:
        return "filter"
    if supervisor_did or not row["lost_neither"]:
        return "supervisor and filter"
    return "fault itself" if row["lost_forgetful"] else "law's memory"


def excess(row: pd.Series) -> str:
    """One of :data:`EXCESSES` for a row of a run that is not lost, or nothing."""
    if not row["apart_mm"] > FLOOR:
        return ""
    if row["alarm"] != "none":
        return "stopped"
    if row["apart_mm"] > EXCESS * max(row["apart_no_supervisor_mm"], FLOOR / EXCESS):
        return "supervisor"
    return "filter" if row["apart_mm"] > EXCESS * max(row["apart_no_filter_mm"], FLOOR / EXCESS) else ""
