"""Tables of stored results in Markdown, each with a line that says which command made it, from what.

Of a benchmark they show columns of the very tables that the command prints (:func:`table.sheets`), so that nothing is
concluded twice; a name in :data:`MADE` stands in a page's mark.
"""

import re
from collections.abc import Callable, Iterable
from typing import Any

from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.engine.quantity import InvalidInput, did_you_mean
from ...envs.figures import job_metrics, metrics
from ...envs.figures.registered import Registry
from ..identify.identified_page import UNITS
from ..measure import margins
from ..store import markdown
from ..studies import recorded
from ..studies.marks import written

MADE: dict[str, Callable[[], str]] = {}
"""Tables by the name that stands in a mark."""


def in_manual(registry: Registry) -> list[str]:
    """Patterns of the titles of the metrics that say that the manual's tables have them."""
    return [re.escape(m.title) for m in registry.values() if m.shown and m.shown.manual]


FOLLOWERS = (
    *("controller", "rank", "failed", "score.*", "× xi2023-tuned", "wins", "Ms.*", "gain", "delay, ms"),
    *(*in_manual(metrics.METRICS), "collisions", "budget"),
)
"""Columns of followers' suites, as patterns of their titles."""

SHORT = ("controller", "score.*", "× xi2023-tuned", "Ms.*", "delay, ms", "failed", "collisions")
"""Of them those of the README."""

MARGINS = ("Ms.*", "gain", "delay, ms")
"""What only the following suite's runs measure."""

JOBS = ("wins", "failed", *in_manual(job_metrics.METRICS), "collisions", "budget", "evidence")
"""Columns of the suites of jobs, behind rank, score and ratio, which are called after metric and reference."""

MAY_LACK = ("failed", "evidence")
"""Columns that not every table has."""


def made(name: str, study: str) -> Callable[[Callable[[dict[str, Any]], str]], Callable[[dict[str, Any]], str]]:
    """Registers what makes a table of a study's results; the line of origin is added."""

    def register(function: Callable[[dict[str, Any]], str]) -> Callable[[dict[str, Any]], str]:
        def whole() -> str:
            found = recorded.read(study)
            if found is None:
                return f"*Not measured yet: `python -m kerfgym.experiments.manual {study}` does it.*\n"
            try:
                return f"{function(found)}\n{origin(found)}\n"
            except (KeyError, TypeError) as error:
                raise InvalidInput(
                    f"results of '{study}' do not have what its table shows ({error}); make them anew: "
                    f"python -m kerfgym.experiments.manual {study}"
                ) from None

        MADE[name] = whole
        return function

    return register


def origin(found: dict[str, Any]) -> str:
    """With which command, version, commit and seeds results were made."""
    facts = [f"`{found['command']}`", f"kerfgym {found['kerfgym']}"]
    if found.get("commit"):
        changed = ", with changes" if found.get("changed") else ""
        facts.append(f"commit {found['commit'][:10]} of {found.get('committed')}{changed}")
    if found.get("seeds"):
        facts.append(f"seeds {found['seeds']}")
    return f"*{'; '.join(facts)}.*"


# ------------------------------------------------------------------------------------------------------------- suites


def columns(found: dict[str, Any], patterns: Iterable[str], title: str = "") -> str:
    """Columns of a table that the command printed: those whose titles fit the patterns, in the patterns' order.

    Args:
        found: results of a benchmark.
        patterns: of titles, each of one column or more.
        title: how the title of the table begins.

    Raises:
        InvalidInput: there is no such table, or it has no such column.
    """
    whole = next((sheet for sheet in found["sheets"] if sheet["title"].startswith(title)), None)
    if whole is None:
        raise InvalidInput(f"results of '{found['study']}' have no table '{title} …'")
    at: list[int] = []
    for pattern in patterns:
        fits = [i for i, each in enumerate(whole["titles"]) if re.fullmatch(pattern, each, re.IGNORECASE)]
        if not fits and pattern not in MAY_LACK:
            hint = did_you_mean(pattern, whole["titles"])
            raise InvalidInput(f"the table of '{found['study']}' has no column '{pattern}'; {hint}")
        at += [i for i in fits if i not in at]
    rows = [[row[i] for i in at] for section in whole["sections"] for row in section]
    titles = [whole["titles"][i] for i in at]
    return markdown.table(titles, ([_named(row[0], found), *row[1:]] for row in rows))


def _named(name: str, found: dict[str, Any]) -> str:
    """A controller's name, and what a reader must know of it."""
    own = found["numbers"].get(name, {})
    words = ["learned"] if name in stacks.shelved() else []
    if own.get("information", "sensor") != "sensor":
        words.append({"preview": "sees the sheet ahead", "privileged": "sees the true gap"}[own["information"]])
    return f"`{name}`" + (f" ({', '.join(words)})" if words else "")


def by_scenario(found: dict[str, Any]) -> str:
    """RMS over seeds, µm, controllers × scored scenarios, in the order of the score; with collided runs in brackets."""
    rows = []
    for name in _order(found):
        own = found["numbers"][name]
        cells = []
        for scenario in found["scored"]:
            hit = own["collided"].get(scenario) or 0
            cells.append(written(own["rms"].get(scenario), ".1f") + (f" ({hit})" if hit else ""))
        rows.append((_named(name, found), *cells))
    return markdown.table(("controller", *found["scored"]), rows)


def _order(found: dict[str, Any]) -> list[str]:
    """Controllers in the order of the table that the command printed; bounds have rows there, too."""
    return [row[0] for section in found["sheets"][0]["sections"] for row in section if row[0] in found["numbers"]]


def _suite(name: str) -> None:
    rules = scenarios.rules(name)

    @made(name, name)
    def main(found: dict[str, Any]) -> str:
        if rules["slot"] == "z":
            return columns(found, (t for t in FOLLOWERS if name.startswith("following") or t not in MARGINS))
        first = map(re.escape, found["sheets"][0]["titles"][:5])
        return columns(found, (*first, *JOBS))

    made(f"{name} by scenario", name)(by_scenario)
    if rules["slot"] == "z":
        made(f"{name} short", name)(lambda found: columns(found, SHORT))
    else:
        made(f"{name} over reference", name)(lambda found: columns(found, ("(?!better|worse).*",), "over "))


for _name in scenarios.suites():
    if _name != "drawing":
        _suite(_name)


def earlier() -> str:
    """The tables of earlier versions of the following suite, each with a heading; nothing if there is none."""
    text = []
    for name in scenarios.suites():
        if re.fullmatch(r"following-v\d+", name):
            text += [f"### `{name}`", MADE[name]().strip(), MADE[f"{name} by scenario"]().strip()]
    return "\n\n".join(text) + "\n" if text else "There is no earlier version yet.\n"


MADE["earlier versions"] = earlier

# --------------------------------------------------------------------------------------------------------------- jobs


@made("contour-beyond", "contour-beyond")
def contour_beyond(found: dict[str, Any]) -> str:
    """Range over the jobs, by condition."""
    from ..studies.other_parts import AXES, CONTOUR, JOBS

    rows = []
    for name, (words, _) in AXES.items():
        cells = []
        for controller in CONTOUR:
            each = [found["numbers"][controller]["rms"][f"{job}-{name}"] for job in JOBS]
            known = [value for value in each if isinstance(value, int | float)]
            cells.append(f"{written(min(known), '.1f')}–{written(max(known), '.1f')}" if known else "failed")
        rows.append((words, *cells))
    return markdown.table(("axes", *(f"`{name}`" for name in CONTOUR)), rows)


@made("cutting-parts", "cutting-parts")
def cutting_parts(found: dict[str, Any]) -> str:
    """Over the reference, part by part."""
    rows = []
    for name in _order(found):
        if name == found["reference"]:
            continue
        for scenario, over in found["numbers"][name]["over"]["in"].items():
            cells = (written(over[m], ".3f") for m in ("cutting_time", "dross", "roughness", "contour_rms"))
            rows.append((_named(name, found), scenario.removeprefix("cut-"), *cells))
    return markdown.table(("process", "part", "cutting time", "dross", "Rz", "contour error"), rows)


@made("calibration", "calibration")
def calibration(found: dict[str, Any]) -> str:
    """Huang2024's Table 2."""
    rows = []
    for name, row in found["numbers"]["rows"].items():
        dross = (written(row[f"dross, {which}"]) for which in ("paper", "full"))
        rough = (written(1000 * row[f"Rz, {which}"], ".0f") for which in ("paper", "full"))
        rows.append((name, written(row["feed, m/min"]), *dross, *rough))
    titles = ("method", "feed, m/min", "dross, mm: paper", "simulated", "Rz, µm: paper", "simulated")
    return markdown.table(titles, rows)


@made("quality", "quality")
def quality(found: dict[str, Any]) -> str:
    """From which following error on the cut shows it."""
    rows = [
        (f"`{name}`", written(row["thickness"]), written(row["threshold"], ".0f"))
        for name, row in found["numbers"].items()
    ]
    return markdown.table(("material", "thickness, mm", "following error that shows by 1 %, µm RMS"), rows)


# ---------------------------------------------------------------------------------------------------------------- rest


@made("agreement", "agreement")
def agreement(found: dict[str, Any]) -> str:
    """The first of the following suite, there and elsewhere, and the verdict."""
    from ..studies.agreement import FACTOR

    own = found["numbers"]
    forms = {"here": ".3g", "there": ".3g", "ratio_here": ".2f", "ratio_there": ".2f", "quotient": ".2f"}
    rows = [(f"`{name}`", *(written(row[c], form) for c, form in forms.items())) for name, row in own["rows"].items()]
    pairs = ("place in `following`", "in `elsewhere`", "× xi2023-tuned in `following`", "in `elsewhere`")
    titles = ("controller", *pairs, "apart by")
    verdict = f"The same order: {own['order']}. All ratios within a factor of {FACTOR:g}: {own['ratios']}."
    return f"{markdown.table(titles, rows)}\n{verdict}\n"


@made("blame", "blame")
def blame(found: dict[str, Any]) -> str:
    """Shares of the mean square, with intervals."""
    shares = found["numbers"]["shares"]
    stages = list(dict.fromkeys(s for cases in shares.values() for rows in cases.values() for s in rows))
    rows = []
    for scenario, cases in shares.items():
        for name, own in cases.items():
            cells = [_ends(own.get(stage)) for stage in stages]
            whole = sum(row["share"] for row in own.values() if row["share"] is not None)
            rows.append((f"`{name}`", scenario, *cells, written(whole)))
    return markdown.table(("controller", "scenario", *(f"{stage}, µm²" for stage in stages), "all, µm²"), rows)


def _ends(row: Any) -> str:
    if not row or row["share"] is None:
        return "–"
    return f"{_three(row['share'])} ({_three(row['low'])} … {_three(row['high'])})"


def _three(value: Any) -> str:
    """Three digits, of small values one place."""
    return written(value, ".1f" if isinstance(value, int | float) and abs(value) < 10 else ".3g")


@made("headroom", "blame")
def headroom(found: dict[str, Any]) -> str:
    """How far references that know more are away, on the same seeds."""
    rows = []
    for scenario, cases in found["numbers"]["headroom"].items():
        for name, other, row in ((name, *case) for name, own in cases.items() for case in own.items()):
            factor = f"{written(row['ratio'])} ({written(row['low'])} … {written(row['high'])})"
            rows.append((f"`{name}`", scenario, _three(row["rms"]), f"`{other}`", _three(row["informed_rms"]), factor))
    return markdown.table(("controller", "scenario", "RMS, µm", "reference", "its RMS, µm", "factor"), rows)


@made("policies", "policies")
def policies(found: dict[str, Any]) -> str:
    """Costs of the shipped trainings, and what other seeds come to."""
    rows = []
    for name, own in found["numbers"].items():
        seeds = own.get("seeds")
        spread = "one training only"
        if seeds:
            score = seeds["score"]
            ends = f"{written(score['median'])} ({written(score['best'])} … {written(score['worst'])})"
            spread = f"{ends}, {seeds['count']} seeds"
        base = str(own["base"] or "–").split(":")[0]
        layers = "–".join(map(str, own["layers"]))
        acts = f"{own['control'] or 'residual'} on `{base}`"
        cost = (f"{1e-6 * own['steps']:.1f} M", written(own["cpu_seconds"], ".0f"))
        rows.append((f"`{name}`", acts, layers, *cost, own["seed"], spread, _of_base(own, base)))
    scores = ("score of all seeds: median (best … worst)", "median ÷ base's score")
    titles = ("policy", "acts", "layers", "steps of training", "CPU-seconds", "shipped seed", *scores)
    return markdown.table(titles, rows)


def _of_base(own: dict[str, Any], base: str) -> str:
    """The median of the trainings' scores over that of what they stand on, in the suite that they were made for."""
    suite = recorded.read(own["suite"])
    if not own.get("seeds") or suite is None or base not in suite["numbers"]:
        return "–"
    return written(own["seeds"]["score"]["median"] / suite["numbers"][base]["score"], ".2f")


@made("at-work", "at-work")
def at_work(found: dict[str, Any]) -> str:
    """Ms and margins at feeds at which policies act."""
    rows = []
    for suite, controllers in found["numbers"].items():
        for name, feeds in controllers.items():
            for feed, own in feeds.items():
                noise = f"{own['ms_noise']:.2f} ({own['ms_noise_low']:.2f} … {own['ms_noise_high']:.2f})"
                room = (margins.in_words(float(own[key]), most) for key, most in _MOST.items())
                rows.append((f"`{name}`", f"`{suite}`", feed, f"{own['ms']:.2f}", noise, *room))
    titles = ("controller", "machine of", "feed, mm/s", "Ms sine", "Ms noise", "gain", "delay, ms")
    return markdown.table(titles, rows)


_MOST = {"gain_margin": float(margins.GAINS[-1]), "delay_margin": float(margins.DELAYS[-1])}
"""The largest that is tried."""


@made("learners", "learners")
def learners(found: dict[str, Any]) -> str:
    """Scores over the base's, by what is equal, best first."""
    rows = []
    for equal, each in found["numbers"].items():
        for name, own in sorted(each.items(), key=lambda item: float(item[1]["median"])):
            median, best, worst = (written(float(own[key]), ".3g") for key in ("median", "best", "worst"))
            cost = (f"{1e-6 * own['training_steps']:.2f} M", written(own["cpu_seconds"], ".0f"))
            jitter = written(own["jitter"] / own["base_jitter"], ".2f")
            many = f"{own['trainings']}, {own['diverged']} diverged" if own["diverged"] else own["trainings"]
            rows.append((equal, f"`{name}`", *cost, many, f"{median} ({best} … {worst})", jitter, own["failed"]))
    score = "score ÷ base's: median (best … worst)"
    titles = (
        "equal",
        "learner",
        "steps of training",
        "CPU-seconds",
        "trainings",
        score,
        "jitter ÷ base's",
        "failed runs",
    )
    return markdown.table(titles, rows)


@made("filter-grid", "filter-grid")
def filter_grid(found: dict[str, Any]) -> str:
    """What search and grids found, and how far apart they are on test seeds."""
    own = found["numbers"]
    rows = []
    for name, settings in own["found"].items():
        what = ", ".join(f"{key} {value if key == 'kind' else written(value)}" for key, value in settings.items())
        ratio = own["search_over"].get(name)
        over = "–"
        if ratio:
            over = " … ".join(f"{ratio[end]:+.3f} %".replace("-", "−") for end in ("low", "high"))
        points = own["points"].get(name, own["trials"])
        rows.append((name, points, what, over))
    return markdown.table(("found by", "candidates", "filter", "search against it, RMS on test seeds (95 %)"), rows)


@made("coverage", "coverage")
def coverage(found: dict[str, Any]) -> str:
    """Coverage of each kind of interval."""
    rows, titles = [], []
    for kind, figures in found["numbers"].items():
        for figure, counts in figures.items():
            for count, cells in counts.items():
                titles = list(cells)
                shares = ("–" if value is None else f"{value:.1f} %" for value in cells.values())
                rows.append((kind, figure, count, *shares))
    return markdown.table(("errors", "figure", "runs", *titles), rows)


@made("identified", "identified")
def identified(found: dict[str, Any]) -> str:
    """How often the intervals of identified machines hold the truth, and how near the medians are."""
    rows = []
    for name, row in found["numbers"].items():
        unit = UNITS.get(name, "1")
        about = f" {unit}" if unit != "1" else ""
        median, most = (f"{row[key]:.2g}{about}" for key in ("median_error", "p95_error"))
        told = f"{row['excited']} of {row['machines']}"
        held = f"{100 * row['held']:.1f} % ({100 * row['held_low']:.1f} … {100 * row['held_high']:.1f})"
        relative = f"{100 * row['median_relative']:.2g} %"
        rows.append([f"`{name}`", held, told, median, relative, most])
    head = ["number", "intervals that hold", "told by the logs", "median error", "of the value", "95th percentile"]
    return markdown.table(head, rows)


@made("speed", "speed")
def speed(found: dict[str, Any]) -> str:
    """Promises, and what was measured."""
    signs = {">=": "≥", "<=": "≤"}
    rows = []
    for name, row in found["numbers"]["ratios"].items():
        held = {1: "yes", 0: "**no**"}.get(row["held"], "not measured")
        rows.append((name, written(row["measured"]), f"{signs[row['sense']]} {row['promised']:g}", held))
    return markdown.table(("", "measured", "promised", "held"), rows) + f"\nMeasured on: {found.get('processor')}.\n"


@made("speed by stage", "speed")
def stages(found: dict[str, Any]) -> str:
    """Where the kernel's time goes."""
    rows = (
        (name, written(row["ns"], ".1f"), written(row["share"], ".0%"))
        for name, row in found["numbers"]["stages"].items()
    )
    return markdown.table(("stage", "ns per machine and period", "share"), rows)


@made("reproduction", "reproduction")
def reproduction(found: dict[str, Any]) -> str:
    """Rows by document and verdict."""
    documents = found["numbers"]["documents"]
    verdicts = list(found["numbers"]["all"])
    rows = [(name, *(counts[v] for v in verdicts)) for name, counts in documents.items()]
    rows.append(("all", *(found["numbers"]["all"][v] for v in verdicts)))
    return markdown.table(("document", *verdicts), rows)
