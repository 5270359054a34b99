"""Xi2023's operator functions: home, centre, calibrate, follow, and the settings that each of them takes."""

import numpy as np
from matplotlib.axes import Axes

from ...envs.control.panel import CENTRE, LEVEL, Panel
from ...envs.plant import supervisor
from ..plots.palette import COLOURS, GRID, QUIET
from .claims import Findings, Row, Trial, estimate, judged, study
from .pictures import drawn
from .verdicts import INPUT, NAMED, PRESENT, SILENT, TREND

CONTROLLER = "xi2023-improved"


@study("xi2023", "Operator functions")
def operator(trial: Trial) -> Findings:
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

    @drawn("Xi2023 §2.1, operator functions", grid={"color": GRID})
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
                axes.text(log["time"][i] + 0.05, 101.0, {"move": "centre"}.get(name, name), rotation=90, va="top",
                          color=QUIET, fontsize=8)  # fmt: skip
        axes.set(xlabel="time (s)", ylabel="head (mm)", ylim=(-3.0, 103.0))

    rows = [
        Row("§2.1", "home: the machine's zero afterwards against the true one, encoder off by ±5 mm before", NAMED,
            estimate(homes, "µm"), judged(np.abs(homes).max() < 2.0, PRESENT)),
        Row("§2.1", f"centre: distance from the rest position of {CENTRE:g} mm", NAMED, estimate(centres, "µm"),
            judged(np.abs(centres).max() < 5.0, PRESENT)),
        Row("§3.2", "calibrate over 10 mm at 10 mm/s: samples used", "1000", estimate(usable, digits=4),
            judged(np.min(usable) >= 950, INPUT), "10 mm over 10 mm/s × 1 ms; what counts as an impulse is left out"),
        Row("§2.1", "settable calibration speed: samples at 40 mm/s", NAMED, estimate(coarse, digits=4),
            judged(np.max(coarse) < np.min(usable), PRESENT)),
        Row("§3.2", "fewer valid points, lower accuracy: error of the table at 1 mm, 250 against 1000 points",
            "“the closer to 1000, the higher the accuracy”",
            f"{np.median(np.abs(rough)):.2f} against {np.median(np.abs(fine)):.2f} µm",
            judged(np.median(np.abs(rough)) > np.median(np.abs(fine)), TREND),
            "medians of the mean of reported − true over 0.3 s; the table's trend is fitted, so that little is lost"),
        Row("§2.1", "follow at a settable height: gap − 1 mm on a level sheet after 0.5 s", NAMED,
            estimate(followed, "µm"), judged(np.abs(followed).max() < 20.0, PRESENT)),
        Row("§2.1", "settable follow speed of 20 mm/s: fastest motion on the way down from 50 mm", NAMED,
            estimate(speeds, "mm/s"), judged(np.max(speeds) < 21.0, PRESENT)),
        Row("§2.1", "contacts that are not part of a calibration", SILENT, f"{contacts}/{trial.seeds}",
            judged(contacts == 0, PRESENT)),
    ]  # fmt: skip
    return Findings(rows, [operator()])


def _bias(p: Panel) -> float:
    """µm, mean of reported − true height over the last 0.3 s."""
    log = p.log()
    return 1e3 * float(np.mean(log["height"][-300:] - log["gap"][-300:]))


def _fastest(p: Panel) -> float:
    """mm/s, fastest motion since following was last asked for, once what went before has died away."""
    log = p.log()
    begun = int(np.flatnonzero(np.diff(log["mode"]))[-1]) + 100
    return float(np.abs(log["velocity"][begun:]).max())
