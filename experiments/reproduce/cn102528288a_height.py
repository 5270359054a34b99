"""CN102528288A, background: where the focus belongs, and what a cutting height that is not held does to the cut."""

import numpy as np
from matplotlib.axes import Axes

from ...envs.scenarios import material as materials
from ..plots.palette import COLOURS, QUIET
from .claims import Rows, Trial, estimate, study
from .huang2024 import jobs_of
from .pictures import Drawing, illustrated

STACK = "huang2024-static-fast"
"""A cut without dither in C45 of 10 mm, Huang2024's fastest."""

OFFSETS = np.arange(-3.0, 3.01, 0.5)
"""mm, of the focus from its nominal depth, up positive."""

ERRORS = (-0.9, -0.5, -0.2, 0.0, 0.2, 0.5, 0.9)
"""mm, of the standoff."""

FIGURES = (("roughness", "roughness Rz", "µm"), ("dross", "dross", "mm"))


@study("cn102528288a", "Focus and cutting height")
def focus_and_height(trial: Trial, rows: Rows) -> list[Drawing]:
    """Whole jobs over the depth of the focus and over the error of the standoff."""
    steel = materials.material("c45-10")
    third = steel.params.thickness / 3.0
    focus = [jobs_of(f"{STACK}:law.focus={f:g}", "cut-square", trial.seeds) for f in OFFSETS]
    height = [jobs_of(f"{STACK}:law.standoff={e:g}", "cut-square", trial.seeds) for e in ERRORS]
    depths = steel.params.focus - OFFSETS
    for name, text, _ in FIGURES:
        cut = np.array([np.median(m["through"]) > 0.98 for m in focus])
        values = np.where(cut, [np.median(m[name]) for m in focus], np.inf)
        best = float(depths[np.argmin(values)])
        edge = " or more" if np.argmin(values) in (0, len(depths) - 1) else ""
        rows("focus-depth", (best, edge, text, steel, third), holds=abs(best - third) <= 0.1 * steel.params.thickness)
    level = height[ERRORS.index(0.0)]
    for error in (-0.5, 0.5):
        now = height[ERRORS.index(error)]
        for name, text, unit in FIGURES:
            ratio = now[name] / level[name]
            told = (estimate(now[name], unit), estimate(level[name], unit), text, abs(error))
            rows("standoff", told, holds=np.median(ratio) > 1.02, case="low" if error < 0 else "high")
    through = np.array([np.median(m["through"]) for m in height])
    lost = [f"{e:+g} mm".replace("-", "−") for e, t in zip(ERRORS, through, strict=True) if t < 0.98]
    rows("fails-to-cut", (", ".join(lost) or "none", max(ERRORS)), holds=bool(lost))

    @illustrated("CN102528288A, background", 2)
    def focus_and_height(left: Axes, right: Axes) -> None:
        """Roughness and dross of whole jobs relative to the nominal setting: left over the depth of the focus (dashed:
        a third of the thickness), right over the error of the standoff."""
        for ax, x, runs, label in (
            (left, depths, focus, "depth of the focus, mm"),
            (right, ERRORS, height, "error of the standoff, mm"),
        ):
            for (name, text, unit), colour in zip(FIGURES, COLOURS, strict=False):
                values = np.array([np.median(m[name]) for m in runs])
                here = np.median(level[name])
                ax.plot(x, values / here, "o-", ms=4, color=colour, label=f"{text}, of {here:.3g} {unit}")
            ax.set(xlabel=label, ylabel="relative to the nominal setting, 1")
        right.set_xticks([-0.9, -0.5, 0.0, 0.5, 0.9])
        left.axvline(third, color=QUIET, ls="--", lw=0.8)
        left.legend(frameon=False, fontsize=8)

    return [focus_and_height()]
