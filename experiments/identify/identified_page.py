"""The page of an identification: one file that says whether the model explains the logs, and shows why."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go

from ...envs.plant import candidates
from ...envs.plant.machine import SUBSTEPS
from ...envs.scenarios import machines
from ..plots.palette import COLOURS, GRID
from ..report.figure import Figure, logarithmic
from ..report.frame import framed
from ..report.numbers import number
from . import check_log, drive, head, next_protocol, residuals
from .identifying import Identified, shown, strong
from .log import PERIOD, Log
from .residuals import Judged, Verdict

UNITS = {
    "face": "mm", "body": "pF", "inductance": "µH", "noise": "pF", "jitter": "1", "bandwidth": "Hz", "zeta": "1",
    "speed": "mm/s", "acceleration": "mm/s²", "jerk": "mm/s³", "friction": "mm/s²", "bristle": "mm", "stiction": "1",
    "stribeck": "mm/s", "dead_time": "s", "backlash": "mm", "resonance": "Hz", "resonance_zeta": "1", "compliance": "1",
    "impulses": "1/s", "impulse_samples": "samples", "impulse_height": "mm", "impulse_falloff": "mm",
    "impulse_spread": "1", "drift": "1", "warming": "s", "x_plus": "1", "x_minus": "1", "y_plus": "1", "y_minus": "1",
    "t1": "s", "t2": "s",
}  # fmt: skip
"""Of a machine's file."""

TRIED = 64
"""Draws of the axis among which that which leaves least is shown."""

DRAWN = 3000
"""Points of a line over a whole log: each the lowest or the highest of its stretch."""

SWEPT = 10.0
"""µm RMS that the head's equations may leave of a sweep at 1 mm: some times its noise there [A]."""

NOISY = (0.15, 0.5)
"""Relative differences of scatter at rest, measured against model, up to which the model explains it, and
beyond which it does not [A]; the scatter itself is known to some per cent."""

NEAR = 0.1
"""Relative error of a predicted following error up to which it counts as predicted."""


class Told(NamedTuple):
    """A log, and whether the model explains it."""

    name: str
    protocol: str
    verdict: Verdict


class Drive(NamedTuple):
    """A motion log with the axis that explains it best: time, s, encoder and model, mm, residual, µm, and where it
    counts; what is judged."""

    time: np.ndarray
    encoder: np.ndarray
    model: np.ndarray
    residual: np.ndarray
    used: np.ndarray
    judged: Judged
    verdict: Verdict


def _verdict(whole: Judged, slow: Judged) -> Verdict:
    """Of a motion log: slow moves tell whether the model stands for the drive. How a drive gets out of its limits is
    its maker's, so what only quick moves leave does not say no."""
    if slow.verdict.explains != "yes" or whole.verdict.explains == "yes":
        return slow.verdict
    return Verdict("partly", f"slow moves are explained; with the quick ones {whole.verdict.why}")


def driven(found: Identified, log: Log) -> Drive:
    """The motion log against the draw that leaves least of it."""
    draws = {n.key.removeprefix("axis."): n.draws for n in found.numbers if n.key.startswith("axis.")}
    size = len(draws["bandwidth"])
    at = np.linspace(0, size - 1, min(TRIED, size)).astype(int)
    errors = drive.Errors(log["command"], log["encoder"])
    axes = [
        drive.axis(
            np.log([float(draws[key][i]) for key in drive.NAMES]),
            float(np.floor(draws["dead_time"][i] / PERIOD * SUBSTEPS + 1e-9)),
        )
        for i in at
    ]
    left = errors(axes)
    best = int(np.argmin(np.mean(left**2, axis=1)))
    model = candidates.courses([axes[best]], log["command"], float(log["encoder"][0]))[0, :, 0]
    encoder = log["encoder"]
    used, residual = np.zeros(len(encoder), bool), np.full(len(encoder), np.nan)
    used[: len(errors.moving)] = errors.moving
    residual[used] = -errors.plain(axes[best])[errors.moving]
    count = residuals.count_of(encoder)
    slow = used & (np.arange(len(used)) < errors.slow)
    judged, calm = (residuals.judged(residual[u], log["command"][u], encoder[u], count) for u in (used, slow))
    return Drive(log["time"], encoder, model, residual, used, judged, _verdict(judged, calm))


def thin(x: np.ndarray, y: np.ndarray, most: int = DRAWN) -> tuple[np.ndarray, np.ndarray]:
    """A line with fewer points that keeps every peak."""
    good = np.isfinite(y)
    x, y = x[good], y[good]
    if len(x) <= most:
        return x, y
    size = -(-2 * len(x) // most)
    whole = len(x) // size * size
    cut = y[:whole].reshape(-1, size)
    ends = np.sort(np.stack([cut.argmin(axis=1), cut.argmax(axis=1)], axis=1), axis=1)
    at = (ends + np.arange(len(cut))[:, None] * size).ravel()
    return x[at], y[at]


def parted(x: np.ndarray, y: np.ndarray, most: float = 0.2) -> tuple[np.ndarray, np.ndarray]:
    """The line with a gap wherever ``x`` leaps by more than ``most``."""
    leaps = np.flatnonzero(np.diff(x) > most) + 1
    return np.insert(x, leaps, x[leaps - 1]), np.insert(y, leaps, np.nan)


def _line(x: np.ndarray, y: np.ndarray, name: str, colour: int = 0, **more: Any) -> go.Scatter:
    return go.Scatter(x=np.round(x, 4), y=np.round(y, 5), name=name, mode="lines",
                      line={"color": COLOURS[colour], "width": 1.5, **more})  # fmt: skip


def _axes(x: str, y: str) -> dict[str, Any]:
    return {"xaxis": {"title": {"text": x}}, "yaxis": {"title": {"text": y}}}


def _motion(d: Drive) -> list[Figure]:
    judged, rho = d.judged, d.judged.white.rho
    blocks = len(d.residual) // 1000
    power = np.nan_to_num(d.residual[: 1000 * blocks]).reshape(blocks, 1000)
    worst = int(np.argmax(np.sum(power**2, axis=1))) * 1000
    part = slice(worst, worst + 1000)

    def against(where: slice) -> go.Figure:
        pair = [thin(d.time[where], values[where]) for values in (d.encoder, d.model)]
        lines = [_line(*pair[0], "encoder"), _line(*pair[1], "model", 1, dash="dot")]
        return go.Figure(lines, _axes("time, s", "height, mm"))

    values = d.residual[d.used]
    counts, edges = np.histogram(values, 60)
    bell = len(values) * (edges[1] - edges[0]) / (judged.rms * np.sqrt(2 * np.pi))
    middle = 0.5 * (edges[1:] + edges[:-1])
    spread = go.Figure(
        [go.Bar(x=np.round(middle, 4), y=counts, name="samples", marker={"color": COLOURS[5]}),
         _line(middle, bell * np.exp(-0.5 * (middle / judged.rms) ** 2), "normal of the same RMS", 1)],
        {**_axes("residual, µm", "samples"), "bargap": 0.02},
    )  # fmt: skip

    def bounded(lags: np.ndarray, values: np.ndarray, bound: float, what: str) -> go.Figure:
        plot = go.Figure(go.Bar(x=lags, y=np.round(values, 5), marker={"color": COLOURS[0]}, showlegend=False),
                         _axes("lag, ms", what))  # fmt: skip
        plot.add_hrect(-bound, bound, fillcolor=GRID, opacity=0.8, line_width=0, layer="below")
        return plot

    white, crossing = judged.white, judged.crossing
    p = "below 0.001" if white.p < 1e-3 else f"{white.p:.2g}"
    return [
        Figure("against", "Log against model", "The worst second has the largest residual.",
               {"the worst second": against(part), "all": against(slice(None))}),
        Figure("over-time", f"The model leaves {judged.rms:.2g} µm RMS",
               f"{judged.counts:.2g} counts. Encoder − model, less means of {drive.SEGMENT} ms: no drift is held "
               "against the axis. Samples at which the head stands are left out.",
               {"all": go.Figure(_line(*parted(*thin(d.time, d.residual)), "rest"), _axes("time, s", "residual, µm"))},
               height=320),
        Figure("spread", "Histogram of the residual", "", {"all": spread}, height=320),
        Figure("autocorrelation", "Does the residual follow from its own past?",
               f"Shaded: 95 % bounds of white noise. Ljung–Box p {p}; the past explains {white.effect:.0%} of its "
               "variance, and that is what counts: a long log finds the smallest of patterns.",
               {"all": bounded(np.arange(1, len(rho)), rho[1:], white.bound, "autocorrelation")}, height=320),
        Figure("crossing", "Does the residual go with the command?",
               f"Positive lags: the command came first. Shaded: 95 % bounds; {crossing.outside:.0%} of "
               f"the lags lie outside; the command's past explains {crossing.effect:.0%} of the variance.",
               {"all": bounded(crossing.lags, crossing.rho, crossing.bound, "cross-correlation")}, height=320),
    ]  # fmt: skip


def _swept(swept: head.Swept) -> tuple[Verdict, list[Figure]]:
    table = swept.table
    shown = np.linspace(0, len(table.height) - 1, min(400, len(table.height))).astype(int)
    h, f = np.asarray(table.height)[shown], np.asarray(table.frequency)[shown]
    good = h > 0.05
    h, f = h[good], f[good]
    made = head.frequency_at(swept.params, h)
    off = 1e3 * (f - made) / np.gradient(made, h)
    near = (h > 0.7) & (h < 1.3)
    rms = float(np.sqrt(np.mean(off[near] ** 2))) if near.any() else float("nan")
    word = "yes" if rms <= SWEPT else "partly" if rms <= 3 * SWEPT else "no"
    why = f"the head's equations leave {rms:.2g} µm RMS near 1 mm (allowed: {SWEPT:g})"
    if word != "yes":
        why += "; missing: stray capacitance, a nozzle of another shape, or a series capacitance"
    plots = [
        Figure("swept", "Frequency over height", "",
               {"all": go.Figure([_line(h, 1e-6 * f, "sweep"), _line(h, 1e-6 * made, "model", 1, dash="dot")],
                                 _axes("height, mm", "frequency, MHz"))}),
        Figure("swept-left", "What the head's equations leave of the table",
               "Reported heights come from the table, not from the equations.",
               {"all": go.Figure(_line(h, off, "rest"), _axes("height, mm", "table − model, µm"))}, height=320),
    ]  # fmt: skip
    return Verdict(word, why), plots


def _rested(found: Identified, swept: head.Swept, log: Log) -> tuple[Verdict, list[Figure]]:
    middle = {n.key: n.interval[1] for n in found.numbers}
    real, made, at = [], [], []
    for where, _ in head.rests(log):
        f = log["frequency"][where]
        f = f[f > 0]
        mean = float(np.median(f))
        real.append(head.scatter(f))
        made.append(float(head.scatter_at(swept.params, mean, middle["head.noise"], middle["head.jitter"])))
        at.append(mean)
    heights = np.interp(at, swept.table.frequency, swept.table.height)
    off = float(np.max(np.abs(np.array(made) / np.array(real) - 1)))
    word = "yes" if off <= NOISY[0] else "partly" if off <= NOISY[1] else "no"
    why = f"scatter at {len(at)} heights differs from the model's by {off:.0%} at most"
    if word != "yes":
        why += "; missing: noise that changes with height in another way, such as a disturbance from outside"
    points = [
        go.Scatter(x=np.round(heights, 3), y=values, mode="markers", name=name,
                   marker={"color": COLOURS[i], "symbol": ("circle", "x")[i], "size": 11})
        for i, (name, values) in enumerate((("measured", real), ("model", made)))
    ]  # fmt: skip
    plot = go.Figure(points, _axes("height, mm", "scatter of the frequency, Hz"))
    low, high = min(real + made), max(real + made)
    plot.update_layout(yaxis={"title": {"text": "scatter of the frequency, Hz"}, **logarithmic(0.6 * low, 1.6 * high)})
    return Verdict(word, why), [Figure("rested", "Noise at rest", "Standard deviation of one sample.", {"all": plot})]


def _checked(c: check_log.Checked) -> list[Figure]:
    plot = go.Figure()
    for i, (what, values) in enumerate(c.predicted.items()):
        plot.add_box(x=np.round(values, 3), name=what, marker={"color": COLOURS[0]}, boxpoints="all", showlegend=False)
        plot.add_scatter(x=[c.measured[what]], y=[what], mode="markers", name="measured", showlegend=i == 0,
                         marker={"color": COLOURS[1], "symbol": "x", "size": 12})  # fmt: skip
    plot.update_layout(_axes("|height − set height|, µm", ""))
    return [Figure("checked", "Predicted and measured following error", f"Each point: a machine drawn from what logs "
                   f"say, on the sheet of {c.name}, with noise of its own.", {"all": plot}, height=300)]  # fmt: skip


def _rows(found: Identified) -> Iterable[dict[str, str]]:
    for one in found.numbers:
        low, middle, high = (shown(value, one.interval) for value in one.interval)
        yield {
            "key": one.key,
            "median": middle,
            "interval": f"{low} to {high}",
            "unit": UNITS.get(one.key.split(".")[-1], ""),
            "note": "" if one.found else "not excited: interval as wide as the prior",
        }


def page(
    found: Identified,
    logs: Iterable[Log],
    like: Any = "standard",
    check: Log | None = None,
    controller: str = "xi2023-improved",
    foresee: bool = True,
) -> str:
    """The page's text.

    Args:
        found: what the logs say.
        logs: they.
        like: the machine that holds where they say nothing.
        check: a follow log that was not used.
        controller: under which it was recorded; of the score, too.
        foresee: find which protocol to record next.
    """
    by = {log.protocol: log for log in logs}
    told: list[Told] = []
    chapters: list[tuple[str, list[str], list[Figure]]] = []
    first: list[str] = []
    if "motion" in by:
        moved = driven(found, by["motion"])
        told.append(Told(by["motion"].name, "motion", moved.verdict))
        chapters.append(("Z drive", [], _motion(moved)))
    if found.swept:
        verdict, plots = _swept(found.swept)
        told.append(Told(by["sweep"].name, "sweep", verdict))
        chapters.append(("Sensor", [], plots))
    if "rest" in by and found.swept:
        verdict, plots = _rested(found, found.swept, by["rest"])
        told.append(Told(by["rest"].name, "rest", verdict))
        chapters.append(("Noise", [], plots))
    if "follow" in by:
        told.append(Told(by["follow"].name, "follow", Verdict("not asked", "the sheet is found from it, no number")))
    if check is not None:
        checked = check_log.check(found, check, controller)
        first.append(f"Prediction of a log that was not used: {checked.sentence}")
        off = abs(float(np.median(checked.predicted["RMS"])) / checked.measured["RMS"] - 1)
        why = f"the median of the predicted RMS is {off:.0%} off (allowed: {NEAR:.0%})"
        told.append(Told(check.name, "follow, not used", Verdict("yes" if off <= NEAR else "no", why)))
        chapters.append(("A log that was not used", [checked.sentence], _checked(checked)))
    gains = next_protocol.gains(found, like, controller) if foresee else []
    advice = _advice(gains)
    first += [f"Record next: {advice}"] if gains else []
    return framed(
        "identified.html",
        name=found.machine.name,
        logs=[log.name for log in by.values()],
        like=machines.load(like).name,
        headline=_headline(found.machine.name, told),
        verdicts=told,
        first=first,
        rows=list(_rows(found)),
        notes=[*strong(found.numbers), *found.notes],
        gains=gains,
        advice=advice,
        controller=controller,
        chapters=chapters,
        number=number,
    )


def _headline(name: str, told: list[Told]) -> str:
    against = [t.name for t in told if t.verdict.explains == "no"]
    partly = [t.name for t in told if t.verdict.explains == "partly"]
    if against:
        return f"The model does not explain {name}: {', '.join(against)}."
    if partly:
        return f"The model explains {name} in part; not all of {', '.join(partly)}."
    return f"The model explains what {name} did in its logs."


def _advice(gains: list[next_protocol.Gain]) -> str:
    """What to record next, in words."""
    if not gains:
        return ""
    best = gains[0]
    if best.now < 1.0:
        return (
            f"none. What the logs leave open makes the following error uncertain by {number(best.now)} µm (SD), less "
            "than an encoder's count."
        )
    again = " again, longer" if best.recorded else ""
    return (
        f"{best.protocol}{again}. The following error is uncertain by {number(best.now)} µm (SD) now, and by "
        f"{number(best.after)} µm were its numbers known."
    )
