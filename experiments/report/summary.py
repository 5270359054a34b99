"""``summary.md``: a run in a page of Markdown, for an issue or a message."""

from pathlib import Path
from typing import Any

from ..results.conclusions import Results
from ..store import runs
from .terminal import sheets

NAME = "summary.md"


def write(folder: Path, grids: dict[str, Results], meta: dict[str, Any]) -> None:
    """Writes it into the run folder."""
    runs.write_text(folder / NAME, markdown(grids, meta))


def markdown(grids: dict[str, Results], meta: dict[str, Any]) -> str:
    """Command, version, what a reader must know, and the table of every grid."""
    git, machine = meta.get("git") or {}, meta.get("machine") or {}
    version = f"kerfgym {meta.get('kerfgym')}" + (f", commit {git['commit'][:12]}" if git.get("commit") else "")
    facts = [
        version + (" with changes" if git.get("changed") else ""),
        machine.get("processor", "processor unknown"),
        *([f"{meta['wall_seconds']:.0f} s"] if "wall_seconds" in meta else []),
    ]
    lines = ["## kerfgym benchmark", "", "```", str(meta.get("command", "")), "```", "", "; ".join(facts), ""]
    lines += [f"- {note}" for note in meta.get("notes", [])] + [""] * bool(meta.get("notes"))
    for name, results in grids.items():
        cuts = f" · machine {results.meta['cut_by']['name']}" if results.meta.get("cut_by") else ""
        lines += [f"**{name}** · seeds {results.meta.get('seeds')}{cuts}", ""]
        lines += [sheet.markdown() for sheet in sheets(results)]
    return "\n".join(lines).rstrip() + "\n"
