"""What a picture of the machine shows: the past second, and the sheet ahead, which a scout machine travels first."""

from collections import deque

import numpy as np

from .. import scenarios
from ..control import stack as stacks
from ..plant import heads, machine, supervisor
from ..plant.controller import PERIOD
from ..plant.fleet import Fleet
from ..scenarios import Scenario


class Film:
    """Keeps what a frame shows: the past second, and the sheet ahead, which a scout machine travels first."""

    AHEAD_MS = 75

    def __init__(self, scenario: Scenario, name: str, seed: int) -> None:
        from .rendering import Renderer

        self.title = f"{scenario.name} · {name} · seed {seed}"
        self._renderer = Renderer()
        self._trace: deque = deque(maxlen=1000)
        self._sheet: deque = deque(maxlen=2 * self.AHEAD_MS)
        self._scout = Fleet(1, stacks.get("idle").law, heads.POOL)
        scenarios.prepare(self._scout, scenario, 0, seed)
        stacks.get("idle").install(self._scout, 0)
        self._scout.begin(0, scenarios.noise_keys(seed))
        self._scout.set("job.request", 0, supervisor.STOP)
        self._scout.set("start.gap", 0, 9.0)
        for _ in range(self.AHEAD_MS):
            self._look()

    def _look(self) -> None:
        self._scout.advance()
        x, journey, course = self._scout.get("signals"), self._scout.get("journey"), self._scout.get("course")
        self._sheet.append((journey.distance - x.feed * machine.AHEAD_S, x.surface_0, not course.scored))

    def take(self, fleet: Fleet, index: int = 0) -> None:
        """Adds the present period of a machine."""
        self._look()
        self._now = (fleet.get("signals", index), fleet.get("tally", index), fleet.get("journey", index))
        x, tally, _ = self._now
        self._trace.append((tally.ticks * PERIOD, x.gap - x.set_height, x.height - x.set_height))

    def frame(self) -> np.ndarray:
        """The picture, uint8 of shape (height, width, 3)."""
        from .rendering import Scene

        x, tally, journey = self._now
        sheet = np.array([(d, z) for d, z, _ in self._sheet])
        return self._renderer.frame(Scene(
            time=tally.ticks * PERIOD, distance=journey.distance - x.feed * machine.AHEAD_S, ahead=sheet,
            void=np.array([v for _, _, v in self._sheet]), head=x.head, gap=x.gap, set_height=x.set_height,
            reported=x.height, mode=supervisor.MODES[int(x.mode)], override=x.override, trace=np.array(self._trace),
            title=self.title,
        ))  # fmt: skip
