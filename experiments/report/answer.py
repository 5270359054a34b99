"""The answer in words: who is best in following, dross, roughness and time, by how much, and how sure that is."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ..plots.palette import Look
from ..statistics.comparison import figures
from ..statistics.pooling import declared
from .headings import HOW
from .numbers import ends, fixed, known, listed, number, percent, span, times
from .standing import Standing
from .suite import KNOWS, Suite

FIRST = ("following error", "contour error")
"""Columns that stand first in the answer for several suites."""

BARS = 6
"""Controllers in a card's picture, at most."""

_ENDS = ("score_low", "score_high", "score")


def headline(standing: Standing, labels: dict[str, str]) -> str:
    """The main finding of a suite in a sentence."""
    suite, best = standing.suite, standing.best
    if best is None:
        return "No controller that may be ranked has a score, so there is nothing to compare."
    name, score = labels[best], estimate(standing, best)
    does = f"has the smallest {suite.metrics[standing.metric].spoken}" if suite.jobs else "follows"
    if len(standing.ranked) == 1 and suite.reference not in standing.order:
        return f"{name}: {score}." if suite.jobs else f"{name} {does} with an error of {score}."
    if standing.tied:
        both = listed([name, *(labels[n] for n in standing.tied)])
        do = does.replace("follows", "follow closest").replace("has", "have", 1)
        lead = f"{both} {do} and cannot be told apart: {name} has {score}"
    else:
        lead = f"{name} {does}{'' if suite.jobs else ' closest'}: {score}"
    ratio = float(standing.frame.at[best, "ratio"])
    if best == suite.reference or not math.isfinite(ratio):
        return f"{lead}."
    word = standing.less
    if abs(ratio - 1) < 0.005:
        return f"{lead}, as {labels[suite.reference]}."
    if ratio < 1:
        return f"{lead}; {labels[suite.reference]}, which may not be ranked here, is {times(1 / ratio)} times {word}."
    return f"{lead}, {times(ratio)} times {word} than {labels[suite.reference]}."


def estimate(standing: Standing, name: str) -> str:
    """A figure with its unit."""
    low, value, high = ends(standing.frame.loc[name], "score")
    return f"{fixed(value, known(low, high, value))}\u00a0{standing.unit}"


def remarks(suite: Suite, standing: Standing, labels: dict[str, str], limit_ms: float) -> list[str]:
    """Sentences that belong to the headline: what it rests on, what speaks against it, what is missing."""
    out, best, summary = [], standing.best, suite.summary
    what = "the runs" if suite.jobs else "the true gap"
    out.append(
        f"Figures are of {what}, {HOW[declared(standing.metric).pooled]} over {len(suite.seeds)} "
        f"seed{'s' * (len(suite.seeds) != 1)}, {suite.scored_in_words}, without those that failed."
    )
    if best is not None and not suite.jobs:
        row = summary.loc[best]
        if row["runs"] > 0 and not row["collisions"]:
            runs = int(row["runs"])
            out.append(f"{labels[best]} touched the sheet in none of the {runs} runs in which it should not.")
        peaks = peaks_of(row)
        if not peaks:
            out.append("Its sensitivity peak Ms was not measured.")
        elif max(peaks.values()) <= limit_ms:
            out.append(f"Its sensitivity peak Ms is {in_words(peaks)}, within the limit of {limit_ms:g}.")
    if suite.reference not in summary.index:
        out.append(f"The reference {suite.reference} was not run, so there are no ratios.")
    elif not math.isfinite(float(summary.at[suite.reference, "score"])):
        out.append(f"The reference {suite.reference} has no score because runs failed, so there are no ratios.")
    for information, names in suite.classes.items():
        for name in names:
            if information != "sensor" and name in standing.order:
                knows = KNOWS.get(information, "not ranked")
                out.append(f"{labels[name]} ({knows}) reaches {estimate(standing, name)}.")
    missing = [labels[name] for name in suite.ranked if not math.isfinite(float(summary.at[name, "score"]))]
    if missing:
        out.append(f"Without a score, because runs failed: {', '.join(missing)}.")
    notes = {str(note) for note in standing.frame["note"] if note}
    if notes and all(standing.frame["note"]):
        out.append(f"There is {notes.pop() if len(notes) == 1 else 'no interval'}.")
    return out


def caveats(suite: Suite, standing: Standing, labels: dict[str, str], limit_ms: float) -> list[str]:
    """What speaks against the one in front."""
    best, out = standing.best, []
    if best is None:
        return []
    row, several = suite.summary.loc[best], len(suite.results.scenarios) > len(suite.scored)
    touched = int(row["collisions"])
    if touched:
        many = int(row["runs"])
        out.append(f"it touched the sheet in {touched} of {many} runs{' of all scenarios' if several else ''}")
    if not suite.jobs:
        over = {signal: peak for signal, peak in peaks_of(row).items() if peak > limit_ms}
        if over:
            out.append(f"its sensitivity peak Ms is {in_words(over)}, over the limit of {limit_ms:g}")
        if float(row["gain_margin"]) == 0:
            out.append("its loop does not settle after a step on every corner plant")
    broken = int(row["failed"]) - touched
    if broken > 0:
        out.append(f"{broken} of its {int(row['runs'])} runs hold no figure or were not finished")
    word = standing.less
    informed = suite.summary.at[best, "information"]
    reasons: dict[str, list[str]] = {}
    for name in standing.order[: standing.order.index(best)]:
        if suite.summary.at[name, "information"] == informed:
            reasons.setdefault("; ".join(standing.frame.at[name, "reasons"]), []).append(name)
    for name in reasons.pop("", ()):
        if not standing.frame.at[name, "lost"]:
            continue  # smaller, but not surely so: it is tied or loses run by run
        lost, tried = (int(standing.frame.at[name, column]) for column in ("lost", "tried"))
        out.append(
            f"{labels[name]} ({estimate(standing, name)}) is {word} where it does not fail, but {lost} of its "
            f"{tried} runs failed"
        )
    for why, names in reasons.items():
        are = "is" if len(names) == 1 else "are"
        said = listed(f"{labels[n]} ({estimate(standing, n)})" for n in names)
        out.append(f"{said} {are} {word} but not ranked ({why})")
    return out


def peaks_of(row: Any) -> dict[str, float]:
    """Ms by the signal with which it was measured."""
    found = {"with a sine": float(row["ms"]), "with noise": float(row["ms_noise"])}
    return {signal: peak for signal, peak in found.items() if not math.isnan(peak)}


def in_words(peaks: dict[str, float]) -> str:
    """``1.20 with a sine and 1.71 with noise``."""
    return listed(f"{number(peak)} {signal}" for signal, peak in peaks.items())


def cards(
    suite: Suite, standings: dict[str, Standing], look: dict[str, Look], labels: dict[str, str]
) -> list[dict[str, Any]]:
    """One for each metric that the page answers for and in which the controllers differ; the suite's own first."""
    first = [suite.metric, *(name for name in suite.metrics if name != suite.metric)]
    wanted = [standings[m] for m in first if m in standings and suite.metrics[m].called.less]
    return [_card(s, look, labels) for s in wanted[:5] if s.varies or s.metric == suite.metric]


def matrix(cards_by_suite: dict[str, list[dict[str, Any]]]) -> tuple[list[str], dict[str, list[dict[str, Any] | None]]]:
    """Cards of several suites in rows: the columns that any of them has, and each suite's card in every column."""
    found = {suite: {c["question"]: c for c in reversed(of_suite)} for suite, of_suite in cards_by_suite.items()}
    asked = dict.fromkeys(c["question"] for of_suite in cards_by_suite.values() for c in of_suite)
    columns = sorted(asked, key=lambda name: FIRST.index(name) if name in FIRST else len(FIRST))
    return columns, {suite: [of_suite.get(name) for name in columns] for suite, of_suite in found.items()}


def _card(standing: Standing, look: dict[str, Look], labels: dict[str, str]) -> dict[str, Any]:
    metric, word, best = standing.suite.metrics[standing.metric], standing.less, standing.best
    card: dict[str, Any] = {"question": metric.called.question or metric.spoken, "title": metric.spoken}
    card |= {"unit": metric.unit, "best": None, "lines": [], "summary": metric.summary, "bars": [], "tied": []}
    if best is None:
        why = {reason for reasons in standing.frame["reasons"] for reason in reasons}
        outside = len(why) == 1 and next(iter(why)).startswith("extrapolated")
        card["lines"].append(f"Not ranked: {why.pop()}." if outside else "Nobody that may be ranked has a figure.")
        return card | {"bars": _bars(standing, look, labels)}
    row = standing.frame.loc[best]
    low, value, high = ends(row, "score")
    places = known(low, high, value)
    card |= {"best": labels[best], "name": best, "colour": look[best].colour, "value": fixed(value, places)}
    card |= {"span": span(low, high, places), "tied": [labels[n] for n in standing.tied]}
    card["bars"] = _bars(standing, look, labels)
    suite = standing.suite
    if best != suite.reference and suite.reference in standing.order:
        card["lines"].append(_against(standing, best, suite.reference, word, labels))
    rivals = [n for n in standing.ranked[1:] if n not in standing.tied and n != suite.reference]
    if standing.tied:
        card["lines"].append(f"Cannot be told apart from {listed(card['tied'])}.")
    elif rivals:
        card["lines"].append(_against(standing, best, rivals[0], word, labels))
    return card


def _against(standing: Standing, best: str, other: str, word: str, labels: dict[str, str]) -> str:
    """How much better the best is than another, on the same seeds, and how often in single runs."""
    r = standing.suite.results
    runs = r.runs[r.runs["controller"].isin([best, other])]
    pair = replace(r, runs=runs, metric=standing.metric, reference=other)
    row = figures(pair, typical=False).loc[best]
    low, ratio, high = ends(row, "ratio")
    if not math.isfinite(ratio):
        return ""
    there = labels[other] + (", the next" if other != standing.suite.reference else "")
    if ratio < 1:
        fair = "" if other in standing.ranked else ", not ranked,"
        return f"{labels[other]}{fair} is {better(1 / ratio, 1 / high, 1 / low, word)}."
    often = f", {word} in {percent(float(row['wins']))} of single runs" if math.isfinite(float(row["wins"])) else ""
    return f"{better(ratio, low, high, word)} than {there}{often}."


def better(ratio: float, low: float, high: float, word: str) -> str:
    """How much, with its interval: ``3.01 times closer (2.23–3.67)``; in per cent where it is little."""
    if ratio < 1.2:
        share, first, last = (100 * (1 - 1 / value) for value in (ratio, low, high))
        places = min(known(first, last, share), 2)
        sure = f" ({span(first, last, places)})" if math.isfinite(first + last) else ""
        return f"{fixed(share, places)}{sure} % {word}"
    places = min(max(known(low, high, ratio), 1 if ratio < 10 else 0), 2)
    sure = f" ({span(low, high, places)})" if math.isfinite(low) else ""
    return f"{fixed(ratio, places)}{sure} times {word}"


def _bars(standing: Standing, look: dict[str, Look], labels: dict[str, str]) -> list[dict[str, Any]]:
    """Places of the first few on a common axis, per cent of its width: the best, the reference, the informed one."""
    suite = standing.suite
    keep = [n for n in (*standing.ranked[: BARS - 2], suite.reference, suite.informed) if n in standing.order]
    keep += [n for n in standing.ranked or standing.order if n not in keep][: max(0, BARS - len(set(keep)))]
    names = [n for n in standing.order if n in set(keep)]
    frame = standing.frame.loc[names, ["score", "score_low", "score_high"]].astype(float)
    frame["score_low"] = frame["score_low"].where(np.isfinite(frame["score_low"]), frame["score"])
    frame["score_high"] = frame["score_high"].where(np.isfinite(frame["score_high"]), frame["score"])
    low, high = float(frame["score_low"].min()), float(frame["score_high"].clip(upper=3 * frame["score"].max()).max())
    if not low > 0:
        return []
    log = high > 3 * low
    put = (lambda v: math.log(v)) if log else (lambda v: v)
    width = put(high) - put(low) or 1.0

    def place(value: float) -> float:
        return round(100 * min(max((put(value) - put(low)) / width, 0.0), 1.0), 2)

    bars = []
    for n, row in frame.iterrows():
        bar = {"label": labels[n], "name": n, "colour": look[n].colour, "ranked": n in standing.ranked}
        bar |= {"at": place(row["score"]), "low": place(row["score_low"]), "high": place(row["score_high"])}
        places = known(*(float(standing.frame.at[n, c]) for c in _ENDS))
        bars.append(bar | {"value": fixed(row["score"], places)})
    return bars
