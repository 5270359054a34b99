"""What a picture of a job shows: the part, and the kerf so far."""

import numpy as np

from ..paths.job import PlannedJob
from ..plant import gantry
from ..plant.fleet import Fleet
from .kerf_picture import Kerf, picture


class KerfFilm:
    """Keeps what a frame shows: where the spot has been, and what the cut was like there."""

    def __init__(self, job: PlannedJob, title: str, colour: str) -> None:
        self._job, self._title, self._colour = job, title, colour
        self._rows: list[tuple[float, ...]] = []

    def take(self, fleet: Fleet, index: int = 0) -> None:
        """Adds the present moment of a machine."""
        assert fleet.gantries
        trail = fleet.gantries.trail(fleet.tick - 1, index)
        figures, recipe = fleet.gantries.get("figures", index), fleet.gantries.get("recipe", index)
        gap = fleet.get("signals", index).gap - recipe.standoff
        at = trail.x, trail.y, trail.error, trail.phase
        self._rows.append((*at, gap, figures.dross, figures.roughness, figures.margin))

    def frame(self) -> np.ndarray:
        """The picture, uint8 of shape (height, width, 3)."""
        x, y, error, phase, gap, dross, rough, margin = np.array(self._rows).T
        values = {"standoff": gap, "contour": error, "dross": dross, "roughness": rough}
        cutting = (phase == gantry.LEAD_IN) | (phase == gantry.CUT)
        return picture(Kerf(self._job.outlines, x, y, cutting, values, margin >= 1.0, self._title), self._colour)
