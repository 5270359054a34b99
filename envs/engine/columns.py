"""Columns: the numbers of any number of machines in blocks, as Python reads and writes them."""

import contextlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from .deck import refuse_copy
from .lanes import W, fields, flat, rows, unflat


def aligned(size: int) -> np.ndarray:
    """``size`` zeros from a 64-byte boundary on: a vector must not straddle two cache lines."""
    room = np.zeros(size + 8)
    start = -room.ctypes.data % 64 // 8
    return room[start : start + size]


class Columns:
    """``size`` columns of ``height`` numbers; ``places`` holds offset and class of each part that has a name.

    Every part starts with the defaults of its class.

    Raises:
        TypeError: when they are to be copied or pickled. The copy's kernels would work on the original's memory.
    """

    def __init__(self, size: int, height: int, places: dict[str, tuple[Any, Any]]) -> None:
        self.size, self.blocks, self._places = size, -(-size // W), places
        self._block = aligned(self.blocks * height * W)
        self._view = self._block.reshape(self.blocks, height, W)
        self._written: np.ndarray | None = None  # machines whose rows wait to be written together
        self._waiting: dict[int, Any] = {}
        self._index = {
            f"{name}.{field}": int(place) // W + row
            for name, (place, cls) in places.items()
            for row, field in enumerate(fields(cls))
        }
        for name, (_, cls) in places.items():
            self.put(name, np.arange(size), cls())

    def __reduce__(self) -> Any:
        refuse_copy(self)

    def put(self, name: str, machines: Any, value: tuple) -> None:
        """Writes a part (a name of ``places``) into the columns of ``machines``."""
        self._put_rows(int(self._places[name][0]) // W, machines, flat(value))

    def _put_rows(self, row: int, machines: Any, numbers: list[float]) -> None:
        self._write(machines, {row + i: number for i, number in enumerate(numbers)})

    def _write(self, machines: Any, rows: dict[int, Any]) -> None:
        """Writes values (numbers, or one per machine) into rows of the columns of ``machines``."""
        if machines is self._written:
            self._waiting.update(rows)
            return
        m = np.atleast_1d(machines)
        values = np.empty((len(rows), len(m)))
        for i, value in enumerate(rows.values()):
            values[i] = value
        self._view[m // W, np.fromiter(rows, np.int64, len(rows))[:, None], m % W] = values

    @contextlib.contextmanager
    def writing(self, machines: np.ndarray, again: bool = False) -> Iterator[None]:
        """What is written within into the columns of just these machines, is written all at once in the end.

        ``again`` leaves out numbers that are the same for all, because they have been written before.
        """
        self._written, self._waiting = machines, {}
        try:
            yield
        finally:
            self._written = None
        rows = {r: v for r, v in self._waiting.items() if isinstance(v, np.ndarray)} if again else self._waiting
        if rows:
            self._write(machines, rows)

    def set(self, field: str, machines: Any, values: Any) -> None:
        """Writes one number of a part, such as ``"sheet.tilt_x"``, for ``machines`` (arrays broadcast)."""
        self._write(machines, {self._index[field]: values})

    def set_some(self, name: str, machines: Any, values: dict[str, Any]) -> None:
        """Writes some numbers of a part by their names."""
        self._write(machines, {self._index[f"{name}.{field}"]: value for field, value in values.items()})

    def fields_of(self, name: str) -> tuple[str, ...]:
        """Names of a part's numbers."""
        return self._places[name][1]._fields

    def column(self, field: str) -> np.ndarray:
        """One number of a part for every machine, shape (size,)."""
        return self._view[:, self._index[field]].reshape(-1)[: self.size].copy()

    def get(self, name: str, index: int = 0) -> Any:
        """A part of one machine as its NamedTuple."""
        place, cls = self._places[name]
        row = int(place) // W
        return unflat(cls, self._view[index // W, row : row + rows(cls), index % W].tolist())

    def row(self, field: str, index: int = 0) -> np.ndarray:
        """A view of one number of one machine, shape (): reading and writing it costs next to nothing."""
        return self._view[index // W, self._index[field], index % W : index % W + 1]

    def slots(self, place: Any, count: int, index: int = 0) -> np.ndarray:
        """A view of ``count`` rows of one machine from a place of the layout, shape (count,)."""
        row = int(place) // W
        return self._view[index // W, row : row + count, index % W]
