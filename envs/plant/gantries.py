"""Gantries: the X/Y halves of a fleet's machines, as Python sees them."""

from typing import Any

import numpy as np

from . import gantry, xy_axes
from .columns import Columns
from .controller import Law, stage_of
from .lanes import W, fields, flat


class Gantries(Columns):
    """One gantry for each of ``size`` machines; they share a law, every other parameter may differ.

    Args:
        size: number of machines.
        law: position loop, a law of the slot ``xy``.
    """

    def __init__(self, size: int, law: Law) -> None:
        super().__init__(size, gantry.ROWS, gantry.PLACES)
        self._owned: dict[int, np.ndarray] = {}
        self._jobs: dict[int, tuple[Any, int]] = {}  # with the index of their first sample
        self._deck = np.zeros(gantry.DECK, np.uint64)
        self.address = self._deck.ctypes.data
        self._deck[gantry.D_MACHINES] = size
        self._point(gantry.D_BLOCK, self._block)
        self.record: np.ndarray | None = None
        self.drive_by(law)
        self.put_law(np.arange(size), law.Params())

    def _point(self, slot: int, array: np.ndarray) -> None:
        self._owned[slot] = array  # keeps it alive
        self._deck[slot] = array.ctypes.data

    @property
    def nbytes(self) -> int:
        """Bytes that the gantries take, without the jobs that they share."""
        return self._block.nbytes

    def drive_by(self, law: Law) -> None:
        """Gives the axes another law (its parameters are written with :meth:`put_law`)."""
        self.law = law
        self._deck[gantry.D_LAW] = stage_of(law, gantry.LAW_PLACES)
        self._point(gantry.D_LAW_TABLES, law.tables if law.tables.size else np.zeros(1))
        self._deck[gantry.D_LAW_SIZE] = law.tables.size

    def put_law(self, machines: Any, params: tuple) -> None:
        """Writes the law's ``Params``."""
        self._put_rows(int(gantry.P_LAW) // W, machines, flat(params))

    def set_law(self, field: str, machines: Any, values: Any) -> None:
        """Writes one number of the law's ``Params``."""
        self._write(machines, {int(gantry.P_LAW) // W + fields(self.law.Params).index(field): values})

    def put_axes(self, machines: Any, params: xy_axes.Params) -> None:
        """Writes the axes' parameters."""
        self.put("xy", machines, params)

    def put_job(self, job: Any, machines: Any) -> None:
        """``machines`` do ``job``: arrays of equal length named as :data:`gantry.JOB`, and ``cut_feed`` in mm/s."""
        if id(job) not in self._jobs:
            self._jobs[id(job)] = (job, sum(len(other.x) for other, _ in self._jobs.values()))
            known = [other for other, _ in self._jobs.values()]
            table = [np.stack([getattr(k, name) for name in gantry.JOB], axis=1) for k in known]
            self._point(gantry.D_JOBS, np.concatenate(table, dtype=np.float64).ravel())
        self.set("journey.first", machines, float(self._jobs[id(job)][1]))
        self.set("journey.samples", machines, float(len(job.x)))
        self.set("journey.feed", machines, float(job.cut_feed))
