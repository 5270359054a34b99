"""Xi2023's operator functions: home, centre, calibrate, follow, and the settings that each of them takes."""

import numpy as np
from matplotlib.axes import Axes

from ...envs.control.panel import CENTRE, LEVEL, Panel
from ...envs.plant import supervisor
from ..plots.palette import COLOURS, GRID, QUIET
from .claims import Rows, Trial, study
from .pictures import Drawing, illustrated

CONTROLLER = "xi2023-improved"


@study("xi2023", "Operator functions")
def operator(trial: Trial, rows: Rows) -> list[Drawing]:
    """A shift at the panel, over seeds of the machine: home, centre, calibrate, follow."""
    homes, centres, usable, coarse, followed, speeds, fine, rough = ([] for _ in range(8))
    contacts = 0
    for seed in range(trial.seeds):
        p = Panel(CONTROLLER, LEVEL, seed, gap=15.0, coast=float(np.random.default_rng(seed).uniform(-5.0, 5.0)))
        p.home()
        homes.append(1e3 * (p.position - p["head"]))
        p.centre()
        centres.append(1e3 * (p["head"] - CENTRE))
        p.follow(1.0, speed=20.0)
        speeds.append(_fastest(p))
        p.calibrate()
        usable.append(p.table.usable)
        p.follow(1.0)
        p.wait(0.5)
        followed.append(1e3 * (p["gap"] - 1.0))
        fine.append(_bias(p))
        p.calibrate(10.0, 40.0)
        coarse.append(p.table.usable)
        p.follow(1.0)
        p.wait(0.5)
        rough.append(_bias(p))
        contacts += p["alarm"] == supervisor.COLLISION
        if seed == 0:
            log = p.log()

    @illustrated("Xi2023 §2.1, operator functions", grid={"color": GRID})
    def operator(axes: Axes) -> None:
        """Head position (mm) over time (s) through one shift at the panel: home, centre, follow at 20 mm/s, calibrate,
        follow, calibrate four times as fast, follow."""
        axes.plot(log["time"], log["head"], color=COLOURS[0])
        names = {supervisor.MODES.index(m): m for m in ("home", "move", "follow", "calibrate")}
        changes = np.flatnonzero(np.diff(log["mode"], prepend=-1))
        for i in changes:
            name = names.get(int(log["mode"][i]))
            if name:
                axes.axvline(log["time"][i], color=QUIET, linewidth=0.6, linestyle=":")
                word = {"move": "centre"}.get(name, name)
                axes.text(log["time"][i] + 0.05, 101.0, word, rotation=90, va="top", color=QUIET, fontsize=8)
        axes.set(xlabel="time (s)", ylabel="head (mm)", ylim=(-3.0, 103.0))

    rows("home", homes, holds=np.abs(homes).max() < 2.0)
    rows("centre", (centres, CENTRE), holds=np.abs(centres).max() < 5.0)
    rows("calibrate", usable, holds=np.min(usable) >= 950)
    rows("calibration-speed", coarse, holds=np.max(coarse) < np.min(usable))
    holds = np.median(np.abs(rough)) > np.median(np.abs(fine))
    rows("fewer-points", (np.median(np.abs(rough)), np.median(np.abs(fine))), holds)
    rows("follow", followed, holds=np.abs(followed).max() < 20.0)
    rows("follow-speed", speeds, holds=np.max(speeds) < 21.0)
    rows("contacts", (contacts, trial.seeds), holds=contacts == 0)
    return [operator()]


def _bias(p: Panel) -> float:
    """µm, mean of reported − true height over the last 0.3 s."""
    log = p.log()
    return 1e3 * float(np.mean(log["height"][-300:] - log["gap"][-300:]))


def _fastest(p: Panel) -> float:
    """mm/s, fastest motion since following was last asked for, once what went before has died away."""
    log = p.log()
    begun = int(np.flatnonzero(np.diff(log["mode"]))[-1]) + 100
    return float(np.abs(log["velocity"][begun:]).max())
