"""Oscilloscope: what the machine did, for a scenario and seed of the reader's choice, controllers over each other."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from ...envs.plant import supervisor
from ...envs.plant.controller import PERIOD
from .pack import Channel, pack, thinned
from .spectra import error_of
from .suite import Suite

Floats = npt.NDArray[np.float64]

ROOM = 6_000_000
"""Bytes of the page that signals may take. The first seed of every scenario is always there."""

POINTS = 6000
"""Samples of a signal that are kept, at most; of longer runs the extremes of equal stretches."""

WINDOW = 1.0
"""s shown at first, at most."""

SETTLE = 0.3
"""s at the start among which no window is looked for, if there is more."""

CROSSINGS = 25
"""How often the error may cross its middle in the first window before it is taken shorter."""

BEFORE_ALARM = 0.7
"""Share of the window before the first alarm."""


class Signal(NamedTuple):
    """A panel: title, unit, factor from the trace's unit, resolution, share of the height."""

    title: str
    unit: str
    factor: float
    resolution: float
    weight: float


SIGNALS = {
    "sheet": Signal("sheet", "mm", 1.0, 1e-4, 0.6),
    "true": Signal("true gap − set", "µm", 1e3, 0.05, 1.7),
    "reported": Signal("reported − set", "µm", 1e3, 0.05, 1.3),
    "contour": Signal("contour error", "µm", 1e3, 0.05, 1.5),
    "command": Signal("command", "mm/s", 1.0, 0.01, 1.1),
    "speed": Signal("head speed", "mm/s", 1.0, 0.01, 1.1),
    "feed": Signal("feed", "mm/s", 1.0, 0.01, 1.0),
    "dross": Signal("dross", "mm", 1.0, 1e-4, 1.0),
    "roughness": Signal("roughness Rz", "µm", 1e3, 0.05, 1.0),
}
"""What may be shown, from top to bottom. The sheet is the same for all controllers."""


def widget(suites: list[Suite], labels: dict[str, str]) -> dict[str, Any] | None:
    """What ``scope.js`` shows; None if nothing was traced."""
    groups = groups_of(suites, _run)
    entries = [entry for group in groups for entry in group["scenarios"]]
    spent = sum(_size(entry["seeds"][0]) for entry in entries)
    traced = [(suite, list(suite.traces[scenario].items())[1:]) for suite in suites for scenario in suite.traced]
    waiting = [
        (rank, suite, entry, one)
        for (suite, more), entry in zip(traced, entries, strict=True)
        for rank, one in enumerate(more)
    ]
    for _, suite, entry, one in sorted(waiting, key=lambda w: w[0]):  # second seeds of all before the third of any
        run = _run(suite, *one)
        spent += _size(run)
        if spent > ROOM:
            break
        entry["seeds"].append(run)
    if not groups:
        return None
    signals_of = {k: s._asdict() for k, s in SIGNALS.items()}
    return {"groups": groups, "labels": labels, "signals": signals_of, "first": telling(suites, groups)}


def groups_of(suites: list[Suite], run: Callable[[Suite, int, dict[str, pd.DataFrame]], Any]) -> list[dict[str, Any]]:
    """What was traced, suite by suite: the first seed of each scenario of which ``run`` makes something."""
    groups = []
    for suite in suites:
        entries = [
            {"name": scenario, "summary": suite.results.summaries.get(scenario, ""), "seeds": [made]}
            for scenario in suite.traced
            if (made := run(suite, *next(iter(suite.traces[scenario].items()))))
        ]
        if entries:
            group = {"suite": suite.title, "scenarios": entries}
            groups.append({**group, "chosen": shown_first(suite), "order": suite.ranked})
    return groups


def _size(run: dict[str, Any]) -> int:
    return sum(len(part["data"]) for part in (run["shared"], *run["controllers"].values()) if part)


def shown_first(suite: Suite, most: int = 4) -> list[str]:
    """Whom the reader sees before choosing: the best of the least informed class, the reference, then the others."""
    order = suite.ranked
    first = [*order[:1], *(name for name in order[1:] if name == suite.reference)]
    informed = [name for name in order if name == suite.informed]
    return (first + informed + [name for name in order if name not in (*first, *informed)])[:most]


def telling(suites: list[Suite], groups: list[dict[str, Any]]) -> str:
    """The scenario that is shown before the reader chooses: of the first group that in which those shown differ most.

    Returns:
        ``group:scenario``, counted from 0.
    """
    suite = next(s for s in suites if s.title == groups[0]["suite"])
    names = [scenario["name"] for scenario in groups[0]["scenarios"]]
    known = suite.summary["information"]
    equals = [name for name in groups[0]["chosen"] if known[name] == known[groups[0]["chosen"][0]]]
    errors = suite.pooled(suite.metric).loc[equals, names]
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = np.ptp(np.log(errors.to_numpy(float)), axis=0).round(6)  # the first of equal ones
    spread = np.where(np.isfinite(spread) & np.isin(names, suite.scored), spread, -1.0)
    return f"0:{int(np.argmax(spread))}"


def _run(suite: Suite, seed: int, parts: dict[str, pd.DataFrame]) -> dict[str, Any]:
    """One scenario and seed: signals of every controller, the window shown at first, where nothing is scored."""
    channels = {name: signals(run) for name, run in parts.items()}
    first = next(iter(parts.values()))
    errors = {name: error_of(run) for name, run in parts.items()}
    alarms = {name: at for name, run in parts.items() if (at := _alarm(run)) is not None}
    longest = max(len(run) for run in parts.values())
    stride = math.ceil(longest / POINTS) if longest > POINTS else 1
    out: dict[str, Any] = {"seed": seed, "start": float(first["time"].iloc[0]), "step": stride * PERIOD}
    out |= {"stride": stride, "shared": None, "controllers": {}}
    for name, found in channels.items():
        kept = {key: values for key, values in found.items() if key != "sheet"}
        alarm = alarms.get(name)
        out["controllers"][name] = {
            "signals": list(kept),
            "alarm": None if alarm is None else (alarm + 1) * PERIOD,
            **pack([Channel(thinned(v, stride), SIGNALS[k].resolution) for k, v in kept.items()]),
        }
    sheet = next((found["sheet"] for found in channels.values() if "sheet" in found), None)
    if sheet is not None:
        out["shared"] = {"signals": ["sheet"], **pack([Channel(thinned(sheet, stride), SIGNALS["sheet"].resolution)])}
    counted = _together([mask for _, mask in errors.values()])
    time = first["time"].to_numpy(float)
    last, idle = len(time) - 1, _stretches(~counted[: len(time)])
    out["idle"] = [[float(time[a]), float(time[min(b, last)])] for a, b in idle][:200]
    chosen = [name for name in shown_first(suite) if name in errors] or list(errors)
    first_alarm = min((alarms[name] for name in chosen if name in alarms), default=None)
    start, stop = interesting([errors[name] for name in chosen], PERIOD, first_alarm)
    out["window"] = [start * PERIOD, stop * PERIOD]
    return out


def _alarm(run: pd.DataFrame) -> int | None:
    """Period of the first alarm, such as a touch."""
    if "mode" not in run:
        return None
    alarm = run["mode"].to_numpy(float) == supervisor.ALARM
    return int(np.argmax(alarm)) if alarm.any() else None


def signals(run: pd.DataFrame) -> dict[str, Floats]:
    """The signals that a trace has, in the page's units."""
    error, counted = error_of(run)
    found: dict[str, Floats] = {"true": np.where(np.isfinite(error), error, np.nan)}
    columns = {"command": "command", "speed": "velocity", "sheet": "surface"}
    if "gap_error" in run:
        columns = {"contour": "error", "command": "command", "speed": "velocity", "feed": "speed"}
        columns |= {"dross": "dross", "roughness": "roughness"}
        found["true"] = np.where(counted, error, np.nan)
        if "reported_error" in run:
            found["reported"] = np.where(counted, 1e3 * run["reported_error"].to_numpy(float), np.nan)
    else:
        found["reported"] = 1e3 * (run["height"] - run["set_height"]).to_numpy(float)
    for key, column in columns.items():
        if column in run:
            values = SIGNALS[key].factor * run[column].to_numpy(float)
            cut = key in ("contour", "dross", "roughness")
            found[key] = np.where(counted, values, np.nan) if cut else values
    return {key: found[key] for key in SIGNALS if key in found}


# ------------------------------------------------------------------------------------------- the window shown at first


def _together(masks: list[npt.NDArray[np.bool_]]) -> npt.NDArray[np.bool_]:
    out = np.zeros(max(len(m) for m in masks), bool)
    for mask in masks:
        out[: len(mask)] |= mask
    return out


def _legible(errors: list[Floats], period: float) -> float:
    """Seconds that can be shown so that fast vibrations are still seen as curves."""
    rates = []
    for error in errors:
        good = error[np.isfinite(error)]
        if len(good) > 1:
            above = good > np.median(good)
            rates.append(np.count_nonzero(above[1:] != above[:-1]) / (len(good) * period))
    return float(np.clip(CROSSINGS / max(np.median(rates), 1e-9), WINDOW / 4, WINDOW)) if rates else WINDOW


def interesting(
    runs: list[tuple[Floats, npt.NDArray[np.bool_]]], period: float, alarm: int | None = None
) -> tuple[int, int]:
    """First and one past the last period of what is shown at first.

    It is the time around the first alarm, or if there is none, that in which the true errors differ most. The
    difference is cut off at its 95th percentile, so that one excursion does not choose the window.

    Args:
        runs: error (µm) and where it counts, of each controller.
        period: s.
        alarm: period of the first alarm.
    """
    shortest = min(len(error) for error, _ in runs)
    if shortest < 3:
        return 0, shortest
    counts = np.stack([counted[:shortest] for _, counted in runs])
    errors = np.where(counts, np.stack([error[:shortest] for error, _ in runs]), np.nan)
    width = min(shortest, max(2, round(_legible(list(errors), period) / period)))
    if alarm is not None and alarm < shortest:
        start = int(np.clip(alarm - round(BEFORE_ALARM * width), 0, shortest - width))
        return start, start + width
    bad = ~np.isfinite(errors)
    top, bottom = np.where(bad, -np.inf, errors).max(axis=0), np.where(bad, np.inf, errors).min(axis=0)
    if len(runs) == 1:
        top, bottom = np.maximum(top, 0.0), np.minimum(bottom, 0.0)
    spread = np.subtract(top, bottom, where=~bad.all(axis=0), out=np.zeros(shortest))
    positive = spread[spread > 0]
    if len(positive):
        spread = np.minimum(spread, np.quantile(positive, 0.95))
    total = np.concatenate([[0.0], np.cumsum(spread)])
    sums = total[width:] - total[:-width]
    first = round(SETTLE / period) if shortest * period >= SETTLE + WINDOW else 0
    first = min(first, len(sums) - 1)
    start = first + int(np.argmax(sums[first:]))
    return start, start + width


def _stretches(mask: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and one past the last index of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
