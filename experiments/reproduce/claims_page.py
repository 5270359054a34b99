"""The page of a reproduction: HTML that opens offline, Markdown, and a table in the terminal."""

import base64
from collections import Counter
from pathlib import Path
from typing import Any

import jinja2
from rich.console import Console
from rich.table import Table

from ..store.runs import atomic
from .claims import DOCUMENTS
from .verdicts import CALIBRATED, FAILS, INPUT, NOT, PRESENT, REPRODUCED, TREND, VERDICTS

Part = dict[str, Any]
STYLES = {
    REPRODUCED: "green",
    CALIBRATED: "cyan",
    TREND: "yellow",
    INPUT: "blue",
    PRESENT: "blue",
    FAILS: "red",
    NOT: "magenta",
}
"""Colours in the terminal, by verdict."""


def command(part: Part) -> str:
    """What makes the rows of a study again."""
    return f"kerfgym reproduce {part['study']} --seeds {part['stamp']['seeds']}"


def counts(parts: list[Part]) -> dict[str, int]:
    """Rows by verdict."""
    counted = Counter(row["verdict"] for part in parts for row in part["rows"])
    return {verdict: counted[verdict] for verdict in VERDICTS}


def by_document(parts: list[Part]) -> dict[str, list[Part]]:
    """The studies of each document that was run."""
    return {title: found for name, title in DOCUMENTS.items() if (found := [p for p in parts if p["document"] == name])}


def write(folder: Path, parts: list[Part], record: dict[str, Any], seeds: int) -> None:
    """Writes ``reproduce.html`` and ``reproduce.md`` into the run folder."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([Path(__file__).parent, Path(__file__).parents[1] / "report"]),
        autoescape=jinja2.select_autoescape(["html"]),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["cell"] = lambda text: str(text).replace("|", "\\|").replace("\n", " ")

    def image(drawing: dict[str, Any]) -> str:
        return base64.b64encode((folder / drawing["file"]).read_bytes()).decode("ascii")

    for kind in ("html", "md"):
        told = {"documents": by_document(parts), "counts": counts(parts), "failed": [p for p in parts if p["error"]]}
        of_run = {"record": record, "seeds": seeds, "command": command, "image": image}
        text = environment.get_template(f"reproduce.{kind}").render(**told, **of_run, verdicts=VERDICTS)
        with atomic(folder / f"reproduce.{kind}") as part:
            part.write_text(text, encoding="utf-8")


def show(parts: list[Part]) -> None:
    """Prints a row for every claim, document by document, and how many there are of each verdict."""
    console = Console(width=max(Console().width, 160))
    for title, studies in by_document(parts).items():
        table = Table(title=title, title_justify="left", expand=True)
        widths = {"where": 3, "claim": 9, "paper": 6, "simulation": 6, "true gap": 4, "verdict": 4}
        for name, ratio in widths.items():
            table.add_column(name, ratio=ratio, overflow="fold")
        for part in studies:
            if part["error"]:
                table.add_row(part["study"], part["title"], "", f"failed: {part['error']}", "", "")
            for row in part["rows"]:
                style = STYLES[row["verdict"]]
                instead = f" (with {row['instead']})" if row["instead"] else ""
                cells = [row[key] for key in ("where", "claim", "paper", "simulation", "true")]
                table.add_row(*cells, f"[{style}]{row['verdict']}[/{style}]{instead}")
            table.add_section()
        console.print(table)
    console.print(", ".join(f"{count} {verdict}" for verdict, count in counts(parts).items()))
