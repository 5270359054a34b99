"""Small files of every kind, made by our own code; what is changed at random begins with them."""

import json
import shutil
from pathlib import Path
from typing import Any

import ezdxf
import numpy as np
import pandas as pd

from ....envs import scenarios
from ....envs.control.sources import SHELVES
from ....envs.scenarios import material

SVG = """<svg xmlns="http://www.w3.org/2000/svg" width="60mm" height="40mm" viewBox="0 0 60 40">
<defs><g id="a"><rect x="1" y="1" width="8" height="6" rx="1"/></g></defs>
<style>.k {stroke: #f00; fill: none}</style>
<use href="#a" transform="translate(10 5) rotate(30) scale(1.5)"/>
<path class="k" d="M5 5h20v10a5 5 0 0 1 -5 5H5zM10 30c5 -5 10 5 15 0s5 5 9 0q3 -3 6 0t6 0z"/>
<circle cx="45" cy="20" r="6"/><ellipse cx="45" cy="32" rx="5" ry="3"/><line x1="1" y1="38" x2="9" y2="38"/>
<polygon points="30,5 40,5 35,12"/><polyline points="50,5 55,8 52,12"/><text x="2" y="20">7</text>
</svg>
"""

GCODE = (
    "%\n(plate)\nG21 G90 G17 G64 P0.01\nG0 X0 Y0\nM3 S1000\nG1 X30 F1200\nG2 X40 Y10 I0 J10\nG3 X30 Y20 R10 F900\n"
    "G1 X0\nY0\nM5\nG0 X10 Y5\nM3\nG2 X10 Y5 I5 J0\nM5\nM2\n%\n",
    "#1=10\no100 sub\nG1 X#1 F600\no100 endsub\nG20\nG91 G1 X1.5 Y-.25\nM3\no100 call\nN40 G1 X[#1*2+SIN[30]] (move)\n"
    "G92 X0\nG10 L2 P1 X0 Y0\nG54\nG28\nM98 P100\n/ G1 X5\nM30\n",
)

TUNED = """controller = "pid"

[parameters]
"law.kp" = 80.0
"filter.window" = 9

[provenance]
command = "kerfgym tune law -c pid"
trials = 40
simulated_steps = 1000000
cpu_seconds = 12.5
tune_seeds = "0-31"
study = "0123456789abcdef"

[provenance.start]
trials = 3
simulated_steps = 1000
"""


def drawings(folder: Path) -> None:
    """DXF of several versions, SVG, G-code."""
    for version in ("R12", "R2000", "R2018"):
        document = ezdxf.new(version)
        document.header["$INSUNITS"] = 4
        space = document.modelspace()
        block = document.blocks.new("hole")
        block.add_circle((0, 0), 3)
        for at in ((10, 10), (30, 10)):
            space.add_blockref("hole", at, dxfattribs={"rotation": 30, "xscale": 1.5})
        space.add_line((0, 0), (50, 0))
        space.add_arc((50, 10), 10, 270, 90)
        space.add_polyline2d([(0, 30), (20, 30), (20, 40)], close=True)
        if version != "R12":
            space.add_lwpolyline([(0, 0, 0, 0, 0.3), (20, 0), (20, 20), (0, 20)], format="xyseb", close=True)
            space.add_spline([(0, 0), (10, 5), (20, 0), (30, 5)])
            space.add_ellipse((40, 30), (6, 0), 0.5)
            space.add_text("7")
        document.saveas(folder / f"{version.lower()}.dxf")
    (folder / "part.svg").write_text(SVG, encoding="utf-8")
    for number, text in enumerate(GCODE):
        (folder / f"{number}.ngc").write_text(text, encoding="utf-8")


def tables(folder: Path) -> None:
    """CSV: calibration, profile, map, signal."""
    height = np.linspace(0.1, 10.0, 60)
    position = np.arange(0.0, 30.0, 0.5)
    x, y = np.meshgrid(np.arange(0.0, 50.0, 10.0), np.arange(0.0, 40.0, 10.0))
    for name, columns in {
        "calibration": {"frequency_Hz": 1e6 + 1e4 * np.log(height), "height_mm": height},
        "profile": {"position_mm": position, "height_mm": np.sin(position)},
        "map": {"x_mm": x.ravel(), "y_mm": y.ravel(), "height_mm": np.sin(x + y).ravel()},
        "signal": {"frequency_Hz": 1e6 + 100 * np.sin(np.arange(60.0))},
    }.items():
        pd.DataFrame(columns).to_csv(folder / f"{name}.csv", index=False)


def settings(folder: Path) -> None:
    """Scenarios, suites, materials, tuned controllers, presets of trainings, studies."""
    from ....agents.settings import PRESETS
    from ...tune import study_file

    places = {name: folder / name for name in ("scenario", "suite", "material", "tuned", "preset", "study")}
    for place in places.values():
        place.mkdir()
    for name in ("wavy", "shift", "step-flutter", "rough", "tip-up", "cut-bulge", "contour-gear", "corners"):
        (places["scenario"] / f"{name}.toml").write_text(scenarios.load(name).to_toml(), encoding="utf-8")
    for suite in scenarios.suites():
        shutil.copy(Path(scenarios.__file__).parents[1] / "suites" / f"{suite}.toml", places["suite"])
    for name in material.names():
        shutil.copy(material.FOLDER / f"{name}.toml", places["material"])
    (places["tuned"] / "one.toml").write_text(TUNED, encoding="utf-8")
    (places["tuned"] / "team.toml").write_text(
        'controller = "z=pid,xy=wu"\n[parameters]\n"xy.law.kp" = 2.0\n[provenance]\ntrials = 1\n', encoding="utf-8"
    )
    for file in sorted(PRESETS.glob("*-ppo.toml")):
        shutil.copy(file, places["preset"])
    for name in study_file.shipped():
        text = (study_file.SHIPPED / f"{name}.toml").read_text(encoding="utf-8")
        # Only the package's own studies write its presets.
        (places["study"] / f"{name}.toml").write_text(text.replace("presets = true", ""), encoding="utf-8")


def policies(folder: Path) -> None:
    """The shipped ones, without what nobody reads."""
    for place in sorted(SHELVES[0].iterdir())[:2]:
        (folder / place.name).mkdir()
        for name in ("policy.json", "weights.safetensors"):
            shutil.copy(place / name, folder / place.name)


def runs(folder: Path) -> None:
    """A benchmark of two suites, and the journal of a search."""
    from ...benchmark.benchmarking import run_grids
    from ...measure import grids
    from ...tune import storage
    from ...tune.study import Task

    short = (scenarios.load("wavy").varied(duration=0.4), scenarios.load("step").varied(duration=0.4))
    circle = (scenarios.load("contour-circle").varied(job={"size": 6.0, "pierce": False}),)
    wanted = [
        grids.Grid("following", ("pid", "xi2023-tuned", "preview-5ms"), short, range(1000, 1003), ("wavy", "step")),
        grids.Grid("contour", ("wu",), circle, range(1000, 1002), ("contour-circle",)),
    ]
    command = ["kerfgym", "benchmark"]
    run_grids(wanted, folder / "run", workers=1, with_blame=True, with_detuned=True, quiet=True, command=command)
    record = json.loads((folder / "run" / "run.json").read_text(encoding="utf-8"))
    for grid in record["grids"].values():
        del grid["tables"]  # hashes, by which a changed table is told without being shown
    (folder / "run" / "run.json").write_text(json.dumps(record), encoding="utf-8")
    Task(**JOURNALED, url=str(folder / storage.JOURNAL)).work(1).run([])
    (folder / "words.json").write_text(json.dumps(Task(**JOURNALED).words), encoding="utf-8")


_SEARCHED = {"controller": "pid", "what": ("law.kp", "law.ki"), "suite": "drawing"}
JOURNALED: dict[str, Any] = {**_SEARCHED, "seeds": 1, "trials": 3, "name": "x", "sampler": "cmaes"}
"""The search whose journal is changed."""


def make(folder: Path) -> None:
    """All of them, in folders by kind; the folder appears when it is whole."""
    half = folder.with_name(f"{folder.name}.part")
    shutil.rmtree(half, ignore_errors=True)
    for function in (drawings, tables, settings, policies, runs):
        name = function.__name__
        (half / name).mkdir(parents=True)
        function(half / name)
    half.rename(folder)
