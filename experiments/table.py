"""The benchmark's table in the terminal."""

import math
from typing import Any

from rich.console import Console
from rich.table import Table

from .results import REFERENCE, Results


def _number(value: float, form: str = "{:.2f}") -> str:
    return "–" if value is None or math.isnan(value) else form.format(value)


def _cell(table: Any, row: Any, column: str) -> float:
    return float(table.at[row, column])


def print_summary(results: Results) -> None:
    """Prints one row per controller, best score first, information classes apart."""
    summary, pooled = results.summary(), results.pooled()
    core = [s for s in results.core if s in pooled.columns] or list(pooled.columns)
    table = Table(title=f"RMS of the true gap error, µm · {results.meta['seed_count']} seeds per scenario")
    table.add_column("controller", no_wrap=True)
    for title in ("score", f"× {REFERENCE}", "reported", "Ms", *core, "jitter", "collisions", "failed", "class"):
        table.add_column(title, justify="right", no_wrap=True)
    order = {"sensor": 0, "preview": 1, "privileged": 2}
    rows = sorted(summary.iterrows(), key=lambda r: (order[r[1]["information"]], r[1]["score"]))
    last = None
    for name, row in rows:
        if last not in (None, row["information"]):
            table.add_section()
        last = row["information"]
        table.add_row(
            str(name), _number(row["score"]), _number(row["ratio"]), _number(row["reported"]), _number(row["ms"]),
            *(_number(_cell(pooled, name, s), "{:.1f}") for s in core), _number(row["jitter"]),
            f"{row['collisions']}/{row['collision_runs']}", str(row["failed"]), str(row["information"]),
        )  # fmt: skip
    console = Console(width=max(Console().width, 170))
    console.print(table)
    exempt = f" ({', '.join(results.exempt)} left out)" if results.exempt else ""
    console.print(
        f"score: geometric mean over {', '.join(core)}; reported: the same of what the machine itself measures;\n"
        f"jitter: RMS change of the command, mm/s per ms; collisions of all scenarios{exempt}."
    )
