"""``python -m kerfgym.experiments.studies.fronts``: the learned front of a cut, beside the rules' and the bound."""

import base64
import html
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ....envs import scenarios
from ....envs.control import stack as stacks
from ....envs.engine.quantity import InvalidInput
from ....envs.safety import files
from ...plots.png import png
from ...report.terminal import TextTable
from ...statistics.intervals import Interval
from ...store import runs, script
from .. import pages
from . import bound, comparing, learn
from .picture import TITLES, picture
from .points import METRICS, hypervolume

MODULE = "kerfgym.experiments.studies.fronts"


def main(rules: Path, name: str = "cutting-fronts", seeds: int = 20, members: int = 80, docs: bool = False) -> None:
    """Learn a front of cutting policies with as many simulated steps as a search of rules took, and compare the two.

    Args:
        rules: run folder of the search, such as runs/NAME/rules of kerfgym tune --study cutting-front --name NAME.
        name: of the run folder; a learned front that it holds is not learned again.
        seeds: test seeds of each scenario.
        members: of each front that are compared, those that enclose most on tune seeds.
        docs: write the table into docs/tuning.md, too.
    """
    spent = _spent(rules)
    if not 5 <= seeds <= len(scenarios.SPLITS["test"]):
        raise InvalidInput(f"--seeds {seeds} is out of range; 5 to {len(scenarios.SPLITS['test'])}")
    folder = runs.named(name)
    if not (folder / learn.RECORD).is_file():
        learn.learn(folder, spent["simulated_steps"])
    words = ["--rules", rules, "--seeds", seeds, "--members", members]
    campaign = pages.Campaign(MODULE, words, folder)
    some = scenarios.SPLITS["test"][:seeds]
    plain = comparing.measured(comparing.REFERENCE, stacks.asked(comparing.REFERENCE), learn.SUITE, some)
    reference, free = plain.figures(), bound.bound(learn.SUITE, some[0])
    ideal, worst = np.append(free[:, :3].min(axis=0), 0.0), reference * comparing.WORST
    folders = {"tuned rules": rules / "front", "learned": folder / "front"}
    counts, fronts = {}, {}
    for title, place in folders.items():
        teams = comparing.members(place)
        points = np.array([comparing.tuned(team) for team in teams.values()])
        kept = [list(teams)[i] for i in comparing.chosen(points, ideal, worst, members)]
        counts[title] = len(teams)
        fronts[title] = [comparing.measured(each, teams[each], learn.SUITE, some) for each in kept]
    both = list(fronts.values())
    *found, gain = comparing.volumes(both, ideal, worst)
    *three, gain_three = comparing.volumes(both, ideal, worst, PLAIN)
    shared = comparing.joint(fronts)
    limit = hypervolume(free, ideal, worst)
    cost = {"tuned rules": spent, "learned": files.json_(folder / learn.RECORD)}
    rows = []
    for (title, front), volume, other in zip(fronts.items(), found, three, strict=True):
        row = {"front": title, "members": counts[title], "compared": len(front)}
        row |= {"failed": sum(m.failed > 0 for m in front), "extrapolated": sum(bool(m.outside) for m in front)}
        row |= {"joint": shared[title], "steps": cost[title]["simulated_steps"]}
        row |= dict(zip(("hypervolume", "low", "high"), volume, strict=True)) | {"share": volume.value / limit}
        row |= dict(zip(("without_dross", "without_dross_low", "without_dross_high"), other, strict=True))
        rows.append(row)
    plane = hypervolume(free[:, list(PLAIN)], ideal[list(PLAIN)], worst[list(PLAIN)])
    rows.append({"front": "bound", "without_dross": plane, "compared": len(free), "hypervolume": limit, "share": 1.0})
    runs.write_table(folder, "fronts", pd.DataFrame(rows))
    runs.write_table(folder, "members", _table(fronts))
    with runs.atomic(folder / "fronts.png") as part:
        part.write_bytes(png(picture(fronts, reference, free)))
    box = ", ".join(f"{TITLES[m]} {low:.4g} to {high:.4g}" for m, low, high in zip(METRICS, ideal, worst, strict=True))
    notes = [
        f"box of the hypervolume: {box}; it ends at {' × '.join(f'{w:g}' for w in comparing.WORST)} times "
        f"{comparing.REFERENCE}'s, on {seeds} test seeds. (… …): 95 % intervals over seeds.",
        f"learned less tuned rules, paired: {_told(gain)}; without dross {_told(gain_three)}.",
        "bound: best calibrated settings for each mm, no following error, contour error 0; no policy reaches it.",
    ]
    sheet = TextTable("Fronts of a cut", list(HEAD), [[_cells(row) for row in rows]], notes)
    page(folder / "report.html", sheet, folder / "fronts.png")
    facts = {
        "fronts": rows,
        "gain": list(gain),
        "gain_without_dross": list(gain_three),
        "ideal": ideal.tolist(),
        "worst": worst.tolist(),
    }
    campaign.publish([sheet], facts, "tuning.md", "cutting-fronts" if docs else None)


HEAD = (
    *("front", "members", "compared", "failed", "extrapolated", "on the joint front", "M steps"),
    *("hypervolume", "of the bound", "without dross"),
)

PLAIN = (0, 2, 3)
"""The metrics without dross, which the calibrated settings hardly change, though in the box it weighs as much."""


def _cells(row: dict[str, Any]) -> list[str]:
    """A row of the table in words."""
    counts = [str(row.get(key, "–")) for key in ("members", "compared", "failed", "extrapolated", "joint")]
    steps = f"{1e-6 * row['steps']:.0f}" if "steps" in row else "–"
    volume = Interval(row["hypervolume"], row.get("low", math.nan), row.get("high", math.nan))
    ends = (row.get(f"without_dross_{end}", math.nan) for end in ("low", "high"))
    three = Interval(row["without_dross"], *ends)
    return [row["front"], *counts, steps, _told(volume), f"{row['share']:.1%}", _told(three)]


def _told(found: Interval) -> str:
    """A hypervolume with its interval, if there is one."""
    ends = f" ({found.low:.4f} … {found.high:.4f})" if math.isfinite(found.low) else ""
    return f"{found.value:.4f}{ends}"


def _table(fronts: dict[str, list[comparing.Member]]) -> pd.DataFrame:
    """Every member that was compared: its figures on test seeds, runs that failed, and what was extrapolated."""
    rows: list[dict[str, Any]] = []
    for title, front in fronts.items():
        for m in front:
            figures = dict(zip(METRICS, m.figures(), strict=True))
            rows.append({"front": title, "member": m.name, **figures, "failed": m.failed, "outside": m.outside})
    return pd.DataFrame(rows)


def page(path: Path, sheet: TextTable, picture: Path) -> None:
    """Table and picture as a page of HTML that needs no other file."""

    def line(cells: Iterable[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    rows = [line(sheet.titles, "th"), *(line(row, "td") for section in sheet.sections for row in section)]
    image = base64.b64encode(picture.read_bytes()).decode()
    style = "body{font:15px sans-serif;margin:2em}td,th{padding:.3em .8em;text-align:right}img{max-width:100%}"
    body = f"<h1>{html.escape(sheet.title)}</h1><table>{''.join(rows)}</table>"
    body += "".join(f"<p>{html.escape(note)}</p>" for note in sheet.notes)
    body += f'<img alt="the two fronts and the bound" src="data:image/png;base64,{image}">'
    title = f"<title>{html.escape(sheet.title)}</title>"
    runs.write_text(path, f"<!doctype html><meta charset=utf-8>{title}<style>{style}</style>{body}\n")


def _spent(rules: Path) -> dict[str, Any]:
    """What a search of rules took.

    Raises:
        InvalidInput: the folder holds no front.
    """
    if not (rules / "front").is_dir():
        raise InvalidInput(
            f"no front in '{rules}'; kerfgym tune --study cutting-front --name NAME makes runs/NAME/rules"
        )
    record: dict[str, Any] = files.json_(rules / "run.json")["tuned"]
    return record


if __name__ == "__main__":
    script.run(main, MODULE)
