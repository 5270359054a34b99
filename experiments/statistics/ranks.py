"""Fair play: who may be ranked with whom, and what the ranks are.

Ranks are given within an information class only. A controller that was tuned or trained on seeds of the run, whose
budget is not recorded or larger than the others' (:mod:`budgets`), or that was not run in all scenarios, is shown with
its figures but without a rank, and with the reason. So is one whose figures of the cut are *extrapolated*: its settings
left what they were calibrated on, or nothing was calibrated (:mod:`envs.figures.evidence`).

**Rank** is one more than the number of ranked controllers of the class that are better, by the rules of
:func:`comparison.better`; who cannot be told apart shares it. :func:`order` is the order in which all are shown.
"""

import math
import re
from typing import Any

import pandas as pd

from ...envs.figures import evidence
from ...envs.figures.job_metrics import DONE
from ...envs.scenarios import SPLITS
from ..store.ledger import ranges
from . import comparison
from .budgets import faults, measures, slots

_RANGE = re.compile(r"(\d{1,18})(?:-(\d{1,18}))?")
_FROM = re.compile(r"from (\d{1,18})")


def standings(results: Any, why: dict[str, list[str]] | None = None, typical: bool = True) -> pd.DataFrame:
    """Ranks, ties, figures with intervals, and what speaks against ranking; for the page and for the terminal.

    Args:
        results: of a grid, :class:`conclusions.Results`.
        why: what :func:`reasons` says of them, if that is known; it is the same for every metric.
        typical: as for :func:`comparison.figures`.

    Returns:
        One row per controller, in the order in which they were asked for:

        - ``information``: its class;
        - ``rank``: among those of its class that are ranked, 1 is best, ties share it; NaN if it is not ranked;
        - ``tied``: list of names, who of the ranked of its class cannot be told apart from it (without itself);
        - ``reasons``: list of sentences, why it is not ranked; empty if it is;
        - ``note``: why there are no intervals; empty if there are;
        - ``score``, ``ratio``, ``typical``, ``wins``, each with ``…_low`` and ``…_high``, ``lost`` and ``tried``: see
          :func:`comparison.figures`.
    """
    frame = comparison.figures(results, typical)
    classes = results.runs.groupby("controller", sort=False)["information"].first().reindex(frame.index)
    why = reasons(results) if why is None else why
    ranks: dict[str, float] = dict.fromkeys(frame.index, math.nan)
    tied: dict[str, list[str]] = {name: [] for name in frame.index}
    for information in dict.fromkeys(classes):
        ranked = [name for name in frame.index if classes[name] == information and not why[name]]
        above = comparison.better(results, ranked)
        for name in above.index:
            ranks[name] = 1.0 + int(above[name].sum())
            tied[name] = [o for o in above.index if o != name and not (above.at[o, name] or above.at[name, o])]
    head = pd.DataFrame({"information": classes, "rank": pd.Series(ranks), "tied": pd.Series(tied)})
    notes = {name: _note(results, name, frame) for name in frame.index}
    head = head.assign(reasons=pd.Series(why), note=pd.Series(notes))
    return head.join(frame)


def order(frame: pd.DataFrame) -> list[str]:
    """Names of a frame of :func:`standings` as they are shown: by rank and then by score, then who is not ranked.

    Who is not ranked stands among the others by the score, but never above one that is ranked and failed less.
    """
    scores, ranks = frame["score"].astype(float), frame["rank"].astype(float)
    ranked = sorted((n for n in frame.index if not math.isnan(ranks[n])), key=lambda n: (ranks[n], _last(scores[n])))
    for name in sorted((n for n in frame.index if math.isnan(ranks[n])), key=lambda n: _last(scores[n])):
        share = frame.at[name, "lost"] / max(frame.at[name, "tried"], 1)
        above = [
            n
            for n in ranked
            if _last(scores[n]) <= _last(scores[name]) or frame.at[n, "lost"] / max(frame.at[n, "tried"], 1) < share
        ]
        ranked.insert(max((ranked.index(n) + 1 for n in above), default=0), name)
    return ranked


def foremost(frame: pd.DataFrame) -> list[str]:
    """Names of a frame of :func:`standings` that have the sensor only, a score, and no failed run; in their order."""
    mine = frame[(frame["information"] == "sensor") & (frame["lost"] == 0)]
    return [name for name in order(frame) if name in mine.index and math.isfinite(frame.at[name, "score"])]


def _last(score: float) -> float:
    return math.inf if math.isnan(score) else score


def reasons(results: Any) -> dict[str, list[str]]:
    """Why each controller may not be ranked in the results' metric, in sentences; nothing if it may."""
    return {name: [*why, *extrapolated(results, name)] for name, why in in_any_metric(results).items()}


def in_any_metric(results: Any) -> dict[str, list[str]]:
    """Why each controller may not be ranked, whatever the metric."""
    tuning = results.meta.get("tuning") or {}
    of_slots = measures(tuning, results.controllers, results.reference)
    out = {}
    for name, runs in results.runs.groupby("controller", sort=False):
        record = tuning.get(name) or {}
        out[str(name)] = [
            *overlaps(record, {int(seed) for seed in runs["seed"]}),
            *(words for _, words in faults(record, of_slots)),
            *_not_run(results, runs),
            *_all_failed(results, runs),
        ]
    return out


def extrapolated(results: Any, name: str) -> list[str]:
    """Whether the metric is a figure of the cut's model and a controller's runs lie outside of what it stands on."""
    if results.metric not in evidence.QUALITY:
        return []
    runs = results.runs[(results.runs["controller"] == name) & results.runs["scenario"].isin(results.scored)]
    outside = evidence.ASSUMED if evidence.follows(runs) else evidence.pooled(runs)
    return [evidence.said(outside)] if outside else []


def overlaps(record: dict[str, Any], seeds: set[int]) -> list[str]:
    """Whether a provenance holds seeds of the run, or hides which it was tuned on; in sentences."""
    out = []
    for slot, body in slots(record).items():
        where = f"{slot}: " if slot else ""
        used = seeds_of(body)
        seen = sorted(seed for seed in seeds if any(seed in span for span in used))
        if seen:
            out.append(f"{where}tuned on seeds of this run: {ranges(seen)}")
        if not used and (body.get("trials") or "policy" in body):
            out.append(f"{where}its record does not say on which seeds it was tuned")
    return out


def seeds_of(record: Any) -> list[range]:
    """Every scenario seed that a provenance names: ``tune_seeds``, ``checked_on``, ``seeds``, a policy's ledger's,
    those of what it started from."""
    if not isinstance(record, dict):
        return []
    out: list[range] = []
    for key, value in record.items():
        if key in ("seeds", "tune_seeds", "checked_on"):
            for text in value.values() if isinstance(value, dict) else [value]:
                out += _spans(text)
        elif key in ("policy", "ledger", "start", "z", "xy", "process"):
            out += seeds_of(value)
    return out


def _spans(text: Any) -> list[range]:
    """``"0-31,40"``, ``"from 10000"`` or a list of numbers, as ranges."""
    if isinstance(text, list | tuple):
        return [range(int(seed), int(seed) + 1) for seed in text]
    if found := _FROM.fullmatch(str(text).strip()):
        return [range(int(found[1]), SPLITS["train"].stop)]
    pieces = [_RANGE.fullmatch(piece.strip()) for piece in str(text).split(",")]
    return [range(int(p[1]), int(p[2] or p[1]) + 1) for p in pieces if p]


def _not_run(results: Any, runs: pd.DataFrame) -> list[str]:
    ran = set(runs["scenario"].unique())
    missing = [scenario for scenario in results.scored if scenario not in ran]
    return [f"not run in {', '.join(missing)}"] if missing else []


def _all_failed(results: Any, runs: pd.DataFrame) -> list[str]:
    """Whether nothing is left to compare, and why."""
    lost = comparison.failures(results).reindex(runs.index) & runs["scenario"].isin(results.scored)
    here = runs[runs["scenario"].isin(results.scored)]
    if not len(here) or int(lost.sum()) < len(here):
        return []
    return [f"all of its {len(here)} runs failed: {why_failed(here)}"]


def why_failed(runs: pd.DataFrame) -> str:
    """What went wrong in failed runs, in words, the most frequent first."""
    touched = runs["collision"] > 0 if "collision" in runs else pd.Series(False, index=runs.index)
    undone = runs["covered"] < DONE if "covered" in runs else pd.Series(False, index=runs.index)
    counts = {
        "the nozzle touched the sheet": int(touched.sum()),
        "the job was not finished": int((undone & ~touched).sum()),
        "nothing was scored, or a number was not finite": int((~touched & ~undone).sum()),
    }
    said = sorted((words for words, n in counts.items() if n), key=lambda words: -counts[words])
    return "; ".join(f"{words} ({counts[words]})" if len(said) > 1 else words for words in said)


def _note(results: Any, name: str, frame: pd.DataFrame) -> str:
    """Why a controller's figures have no intervals."""
    mine = results.runs[results.runs["controller"] == name]
    lost, tried = int(frame.at[name, "lost"]), int(frame.at[name, "tried"])
    if lost and not math.isfinite(frame.at[name, "score"]):
        return f"no score: {lost} of {tried} runs failed, and of a scenario all"
    if mine["seed"].nunique() < 2:
        return "no interval: there is only one seed"
    return ""
