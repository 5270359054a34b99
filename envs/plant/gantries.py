"""Gantries: the X/Y halves of a fleet's machines, as Python sees them."""

from typing import Any

import numpy as np

from ..engine.columns import Columns
from ..engine.deck import Deck
from ..engine.lanes import W, fields, flat, rows, unflat
from . import gantry, xy_axes
from .controller import Law, stage_of


class Gantries(Columns):
    """One gantry for each of ``size`` machines; they share their laws, every other parameter may differ.

    Args:
        size: number of machines.
        axes: position loop, a law of the slot ``xy``.
        process: a law of the slot ``process``.
    """

    def __init__(self, size: int, axes: Law, process: Law) -> None:
        super().__init__(size, gantry.ROWS, gantry.PLACES)
        self._jobs: dict[int, tuple[Any, int]] = {}  # with the index of their first sample
        self.deck = Deck(gantry.Entries, machines=size, block=self._block)
        self.deck["jobs"] = np.zeros(2 * len(gantry.JOB))  # until there is a job, they rest
        self.record: np.ndarray | None = None
        self.laws: dict[str, Law] = {}
        for law in (axes, process):
            self.drive_by(law)
            self.put_law(law.slot, np.arange(size), law.Params())

    @property
    def nbytes(self) -> int:
        """Bytes that the gantries take, without the jobs that they share."""
        return self._block.nbytes

    def drive_by(self, law: Law) -> None:
        """Puts a law into its slot (its parameters are written with :meth:`put_law`)."""
        self.laws[law.slot] = law
        name = "law" if law.slot == "xy" else law.slot
        self.deck[name] = stage_of(law, gantry.LAW_PLACES[law.slot])
        self.deck[f"{name}_tables"] = law.tables if law.tables.size else np.zeros(1)
        self.deck[f"{name}_size"] = law.tables.size

    def put_law(self, slot: str, machines: Any, params: tuple) -> None:
        """Writes the ``Params`` of the law in a slot."""
        self._put_rows(int(gantry.LAW_PLACES[slot]["params"]) // W, machines, flat(params))

    def set_law(self, slot: str, field: str, machines: Any, values: Any) -> None:
        """Writes one number of these ``Params``."""
        row = int(gantry.LAW_PLACES[slot]["params"]) // W + fields(self.laws[slot].Params).index(field)
        self._write(machines, {row: values})

    def put_axes(self, machines: Any, params: xy_axes.Params) -> None:
        """Writes the axes' parameters."""
        self.put("xy", machines, params)

    def put_job(self, job: Any, machines: Any) -> None:
        """``machines`` do ``job``: arrays of equal length named as :data:`gantry.JOB`, and ``cut_feed`` in mm/s."""
        if id(job) not in self._jobs:
            self._jobs[id(job)] = (job, sum(len(other.x) for other, _ in self._jobs.values()))
            known = [other for other, _ in self._jobs.values()]
            table = [np.stack([getattr(k, name) for name in gantry.JOB], axis=1) for k in known]
            self.deck["jobs"] = np.concatenate(table, dtype=np.float64).ravel()
        self.set("journey.first", machines, float(self._jobs[id(job)][1]))
        self.set("journey.samples", machines, float(len(job.x)))
        self.set("journey.feed", machines, float(job.cut_feed))
        self.set("journey.patience", machines, float(job.patience))

    def start_recording(self, steps: int, tick: int) -> np.ndarray:
        """Keeps the next ``steps`` periods from ``tick`` on: float32 (steps, channels, size), ``gantry.CHANNELS``."""
        self.record = np.zeros((steps, len(gantry.CHANNELS), self.size), np.float32)
        self.deck["record"] = self.record
        self.deck["record_tick"], self.deck["record_steps"] = tick, steps
        return self.record

    def stop_recording(self) -> None:
        """Ends :meth:`start_recording`; further periods are not kept."""
        self.deck["record"] = None
        self.record = None

    def trail(self, tick: int, index: int = 0) -> gantry.Trail:
        """What happened to one gantry in the control period ``tick``, one of the last ones."""
        place = int(gantry.TRAIL) // W + (tick & int(gantry.TRAIL_LAST)) * rows(gantry.Trail)
        numbers = self._view[index // W, place : place + rows(gantry.Trail), index % W].tolist()
        return unflat(gantry.Trail, numbers)
