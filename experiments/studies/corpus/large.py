"""What large drawings cost to read and to plan: ``python -m kerfgym.experiments.studies.corpus.large``."""

import multiprocessing
import resource
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from ...report.terminal import TextTable
from ...store import runs, script
from .. import pages

MODULE = "kerfgym.experiments.studies.corpus.large"

WIDE, HIGH = 4000.0, 2000.0
"""mm, of the sheet."""


def _parts_with_holes(space: Any, _: np.random.Generator) -> None:
    """100 parts with 120 holes each: circles, slots with round ends, squares of four lines."""
    for x, y in ((400 * i + 10, 200 * j + 10) for i in range(10) for j in range(10)):
        space.add_lwpolyline([(x, y), (x + 380, y), (x + 380, y + 180), (x, y + 180)], close=True)
        for k in range(120):
            a, b = x + 14 + 25 * (k % 15), y + 12 + 22 * (k // 15)
            if k % 3 == 0:
                space.add_circle((a, b), 5.2)
            elif k % 3 == 1:
                slot = [(a - 8, b - 4, 0), (a + 4, b - 4, 1), (a + 4, b + 4, 0), (a - 8, b + 4, 1)]
                space.add_lwpolyline(slot, format="xyb", close=True)
            else:
                corners = [(a - 5, b - 5), (a + 5, b - 5), (a + 5, b + 5), (a - 5, b + 5)]
                for here, there in zip(corners, corners[1:] + corners[:1], strict=True):
                    space.add_line(here, there)


def _open_lines(space: Any, rng: np.random.Generator) -> None:
    places, angles, lengths = rng.uniform(0, [WIDE, HIGH], (60_000, 2)), rng.uniform(0, 7, 60_000), rng.uniform(2, 15)
    ends = places + lengths * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    for here, there in zip(places.tolist(), ends.tolist(), strict=True):
        space.add_line(here, there)


def _a_chain(space: Any, rng: np.random.Generator) -> None:
    points = np.cumsum(rng.normal(0, 5, (60_001, 2)), axis=0).tolist()
    for here, there in zip(points[:-1], points[1:], strict=True):
        space.add_line(here, there)


def _huge_circles(space: Any, rng: np.random.Generator) -> None:
    for x, y, radius in rng.uniform(0.0, [WIDE, HIGH, 750.0], (3000, 3)).tolist():
        space.add_circle((x, y), 100.0 + radius)


def _rings(space: Any, _: np.random.Generator) -> None:
    for k in range(3000):
        space.add_circle((WIDE / 2, HIGH / 2), 5 + 0.3 * k)


DRAWINGS: dict[str, Callable[[Any, np.random.Generator], None]] = {
    "sheet with 12 000 holes": _parts_with_holes,
    "60 000 open lines": _open_lines,
    "60 000 lines in a row": _a_chain,
    "3000 huge circles on each other": _huge_circles,
    "3000 rings within each other": _rings,
}


def main(name: str = "large", docs: bool = False) -> None:
    """Read and plan large drawings, each in a process of its own, and tell time and memory.

    Args:
        name: of the folder in runs/.
        docs: write the table into docs/corpus.md, too.
    """
    campaign = pages.Campaign(MODULE, [], runs.open_folder(runs.named(name), overwrite=True))
    rows = []
    fresh = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), max_tasks_per_child=1)
    with tempfile.TemporaryDirectory() as folder, fresh as pool:
        for title, draw in DRAWINGS.items():
            file = Path(folder) / "large.dxf"
            _drawn(draw, file)
            rows.append([title, *pool.submit(_work, file).result()])
    sheet = TextTable(
        "Large drawings", ["drawing", "contours", "m", "read, s", "planned, s", "of a processor, s", "MB"]
    )
    sheet.sections.append(rows)
    sheet.notes = ["one process each, without the import of libraries; of a processor: both together."]
    campaign.publish([sheet], {"rows": rows}, "corpus.md", "large" if docs else None)


def _drawn(draw: Callable[[Any, np.random.Generator], None], file: Path) -> None:
    import ezdxf

    document = ezdxf.new("R2010")
    document.header["$INSUNITS"] = 4
    draw(document.modelspace(), np.random.default_rng(0))
    document.saveas(file)


def _work(file: Path) -> list[str]:
    import ezdxf.recover  # noqa: F401
    import shapely  # type: ignore[import-untyped]  # noqa: F401
    from scipy import interpolate, sparse, spatial  # noqa: F401

    from ....envs.paths.read import read
    from ....envs.paths.route import Cutting, routed

    begun, cpu = time.perf_counter(), time.process_time()
    drawing = read(file)
    seen = time.perf_counter()
    routed(drawing, Cutting(2.0))
    done, cpu = time.perf_counter(), time.process_time() - cpu
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    figures = [f"{drawing.cut_length / 1000:.0f}", *(f"{s:.1f}" for s in (seen - begun, done - seen, cpu))]
    return [str(len(drawing.pieces)), *figures, f"{memory:.0f}"]


if __name__ == "__main__":
    script.run(main, MODULE)
