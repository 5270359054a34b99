"""A fleet: any number of machines in blocks, as Python sees them. Owns the memory, knows no physics."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from ..engine.addresses import Address, Words, address
from ..engine.columns import Columns
from ..engine.lanes import W, fields, flat
from ..engine.quantity import InvalidInput
from ..engine.workers import workers
from . import filters, gantry, machine, path, sheet
from .calibration import Pool
from .controller import Law, stage_of
from .gantries import Gantries


class Fleet(Columns):
    """``size`` machines that share a law; every other parameter may differ from machine to machine.

    Args:
        size: number of machines, at least 1.
        law: what moves them, see :class:`controller.Law`.
        tables: calibration tables of the heads they carry.
        threads: worker threads for :meth:`advance`.
    """

    def __init__(self, size: int, law: Law, tables: Pool, threads: int = 1) -> None:
        if size < 1:
            raise InvalidInput(f"a fleet needs at least 1 machine, not {size}")
        if threads < 1:
            raise InvalidInput(f"num_threads = {threads}; at least 1")
        super().__init__(size, machine.ROWS, machine.PLACES)
        self.law, self.threads = law, threads
        self._keys = np.zeros(self.blocks * W, np.uint64)
        self._owned: dict[int, np.ndarray] = {}
        self._contours: dict[int, tuple[path.Contour, int]] = {}  # with the index of their first sample
        self._profiles: dict[int, tuple[np.ndarray, int]] = {}
        self._randoms: dict[tuple[float, float, float, int], tuple[np.ndarray, int]] = {}
        self._maps: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self._deck = np.zeros(machine.DECK, np.uint64)
        self._at = int(address(self._deck))
        self._deck[machine.D_MACHINES] = size
        self._deck[machine.D_STEPS] = self._usual = 1
        self._promised = False  # a stepper has been handed out that does the usual steps
        self._point(machine.D_BLOCK, self._block)
        self._point(machine.D_KEYS, self._keys)
        self._point(machine.D_FREQUENCIES, tables.frequencies)
        self._point(machine.D_HEIGHTS, tables.heights)
        self._deck[machine.D_TABLES] = tables.frequencies.size
        self.drive_by(law)
        self._pilots: dict[str, tuple[int, Words]] = {}
        self.record: np.ndarray | None = None
        self.gantries: Gantries | None = None
        every = np.arange(size)
        self.put_filter(every, filters.Params())
        self.clear_features(every)
        self.put_law(every, law.Params())

    # ------------------------------------------------------------------------------------------ columns

    def _point(self, slot: int, array: np.ndarray) -> None:
        self._owned[slot] = array  # keeps it alive
        self._deck[slot] = address(array)

    def put_law(self, machines: Any, params: tuple) -> None:
        """Writes the law's ``Params``."""
        self._put_rows(int(machine.P_LAW) // W, machines, flat(params))

    def set_law(self, field: str, machines: Any, values: Any) -> None:
        """Writes one number of the law's ``Params``."""
        self._write(machines, {int(machine.P_LAW) // W + fields(self.law.Params).index(field): values})

    # -------------------------------------------------------------------------------- lists beside the sheet

    def put_plate(self, machines: Any, radius: float) -> None:
        """Radius of the footprint of the sensor's plate, mm; before waves and random sheets, which are made for it."""
        self.set("sheet.plate", machines, radius)
        if radius != sheet.FOOTPRINT:
            self.use(machine.F_PLATES)

    def put_wave(
        self, machines: Any, i: int, amplitude: Any, kx: Any, ky: Any, phase: Any, plate: float | None = None
    ) -> None:
        """Wave ``i`` of the sheet: true amplitude (mm), wave vector (rad/mm); the footprints are allowed for here.

        ``plate``: radius of the plate's, mm; None: the machines' own, as it has been written.
        """
        k = np.hypot(kx, ky)
        if plate is None:
            plate = self.column("sheet.plate")[machines]
        tip = np.asarray(amplitude) * sheet.attenuation(k)
        felt = np.asarray(amplitude) * sheet.attenuation(k, plate)
        self._put_list(machine.WAVES, 5, machines, i, (tip, kx, ky, phase, felt - tip))
        self._deck[machine.D_WAVES] = max(int(self._deck[machine.D_WAVES]), i + 1)

    def put_vibration(self, machines: Any, i: int, amplitude: Any, frequency: Any, phase: Any, zeta: Any = 0.0) -> None:
        """Vibration ``i``: amplitude in mm (of a band √2 times its RMS), frequency in Hz, damping ratio (0: a tone)."""
        omega = 2 * np.pi * np.asarray(frequency)
        self._put_list(machine.VIBRATIONS, 4, machines, i, (amplitude, omega, phase, zeta))
        if np.any(np.asarray(zeta) > 0):
            self.use(machine.F_BANDS)
        self._deck[machine.D_VIBRATIONS] = max(int(self._deck[machine.D_VIBRATIONS]), i + 1)

    def put_feature(self, machines: Any, i: int, start: Any, stop: Any, rise: Any, across: Any) -> None:
        """Feature ``i`` along the path, mm, see :class:`sheet.Feature`."""
        self._put_list(machine.FEATURES, 4, machines, i, (start, stop, rise, across))
        if np.any(np.asarray(start) < sheet.FAR):
            self.use(machine.F_FEATURES)

    def _put_list(self, place: Any, width: int, machines: Any, i: int, values: tuple) -> None:
        row = int(place) // W + i * width
        self._write(machines, {row + offset: value for offset, value in enumerate(values)})

    def listed(self, kind: Any, i: int) -> Any:
        """Entry ``i`` of a list beside the sheet as all machines have it: ``kind`` (:class:`sheet.Wave`, ``Vibration``
        or ``Feature``) of arrays, shape (size,)."""
        place = {sheet.Wave: machine.WAVES, sheet.Vibration: machine.VIBRATIONS, sheet.Feature: machine.FEATURES}[kind]
        count = len(kind._fields)
        row = int(place) // W + i * count
        return kind(*self._view[:, row : row + count].transpose(1, 0, 2).reshape(count, -1)[:, : self.size])

    @property
    def nbytes(self) -> int:
        """Bytes that the machines take, without the tables that they share."""
        return self._block.nbytes + self._keys.nbytes

    @property
    def waves(self) -> int:
        """Waves that the kernel adds up."""
        return int(self._deck[machine.D_WAVES])

    @property
    def vibrations(self) -> int:
        """Vibrations that the kernel adds up."""
        return int(self._deck[machine.D_VIBRATIONS])

    def clear_features(self, machines: Any) -> None:
        """Takes all steps, holes and edges away."""
        none = flat(sheet.Feature())
        self._put_rows(int(machine.FEATURES) // W, machines, none * sheet.FEATURES)

    def put_random(
        self, machines: Any, source: tuple[float, float, float] | None, pairs: Any = 0, numbers: Any = ()
    ) -> None:
        """A sheet of continuous spectrum; ``source`` None: none.

        Args:
            machines: indices.
            source: exponent, roll-off and plate, as :func:`sheet.random_tables` takes them.
            pairs: of which tables, one for all machines or one each.
            numbers: of :class:`sheet.Random` after the first.
        """
        if source is None:
            self.set("random.first", machines, -1.0)
            return
        wanted, which = np.unique(np.asarray(pairs, int), return_inverse=True)
        missing = [pair for pair in wanted.tolist() if (*source, pair) not in self._randoms]
        for pair in missing:
            begin = sum(len(tables) for tables, _ in self._randoms.values())
            self._randoms[*source, pair] = (sheet.random_tables(*source, pair), begin)
        if missing:
            known = [tables for tables, _ in self._randoms.values()]
            self._point(machine.D_RANDOM, known[0] if len(known) == 1 else np.concatenate(known))
            self._deck[machine.D_RANDOMS] = sum(len(tables) for tables in known)
        first = np.array([self._randoms[*source, pair][1] for pair in wanted.tolist()], float)[which]
        for name, value in zip(sheet.Random._fields, (first, *numbers), strict=True):
            self.set(f"random.{name}", machines, value)
        self.use(machine.F_RANDOM)

    def use_bulges(self) -> None:
        """Switches the thermal bulge on."""
        self.use(machine.F_BULGES)

    def use_turns(self) -> None:
        """Switches the turns of long episodes on."""
        self.use(machine.F_TURNS)

    def use(self, flag: Any) -> None:
        """Switches on an optional stage, see ``machine.F_…``."""
        self._deck[machine.D_FLAGS] |= flag

    def put_filter(self, machines: Any, params: filters.Params) -> None:
        """Filter settings; raises :class:`InvalidInput` if the trim eats the window."""
        p = filters.validated(params)
        self.put("filter", machines, p)
        self._deck[machine.D_WINDOW] = max(int(self._deck[machine.D_WINDOW]), int(p.window))
        if p.trim > 1:
            self.use(machine.F_RANKS)

    def forget_filters(self) -> None:
        """Before all machines get new filters: the kernel need not allow for the old ones any more."""
        self._deck[machine.D_WINDOW] = 1
        self._deck[machine.D_FLAGS] &= ~machine.F_RANKS

    def widest_window(self, window: int, trim: int) -> None:
        """Allows for filters up to this window and trim, when they change during an episode."""
        self._deck[machine.D_WINDOW] = max(int(self._deck[machine.D_WINDOW]), window)
        if trim > 1:
            self.use(machine.F_RANKS)

    def put_contours(self, contours: list[path.Contour], which: Any, machines: Any) -> None:
        """Machine ``machines[i]`` travels ``contours[which[i]]``."""
        for contour in contours:
            if id(contour) not in self._contours:
                self._contours[id(contour)] = (contour, sum(len(c.x) for c, _ in self._contours.values()))
                known = [c for c, _ in self._contours.values()]
                self._point(machine.D_CONTOUR_X, np.concatenate([c.x for c in known]))
                self._point(machine.D_CONTOUR_Y, np.concatenate([c.y for c in known]))
                self._point(machine.D_CONTOUR_ON, np.concatenate([c.cutting for c in known]))
                self._deck[machine.D_CONTOURS] = sum(len(c.x) for c in known)
        first = np.array([self._contours[id(contour)][1] for contour in contours])
        self.set("path.contour", machines, first[which])
        self.set("path.samples", machines, np.array([len(contour.x) for contour in contours])[which])
        self.use(machine.F_CONTOURS)

    def put_profile(self, heights: np.ndarray, spacing: float, machines: Any) -> None:
        """A measured profile along the path, mm, sampled every ``spacing`` mm, for ``machines``."""
        if id(heights) not in self._profiles:
            self._profiles[id(heights)] = (heights, sum(len(h) for h, _ in self._profiles.values()))
            known = [h for h, _ in self._profiles.values()]
            self._point(machine.D_PROFILE, np.concatenate(known, dtype=np.float64))
            self._deck[machine.D_PROFILES] = sum(len(h) for h in known)
        self.set("path.profile", machines, self._profiles[id(heights)][1])
        self.set("path.profile_samples", machines, len(heights))
        self.set("path.profile_spacing", machines, spacing)
        self.use(machine.F_PROFILES)

    def put_map(self, heights: np.ndarray, x: float, y: float, spacing: float, machines: Any) -> None:
        """A measured height map, mm, shape (along y, along x), from the corner (x, y) on, for ``machines``."""
        if id(heights) not in self._maps:
            head = [heights.shape[1], heights.shape[0], x, y, spacing]
            self._maps[id(heights)] = (heights, np.concatenate([head, heights.ravel()]))
        self.put_profile(self._maps[id(heights)][1], 1.0, machines)
        self.set("path.profile_samples", machines, 0.0)

    def read_from(self, tables: Pool, head: int) -> None:
        """Heights of all machines come from this head's table from now on."""
        self._point(machine.D_FREQUENCIES, tables.frequencies)
        self._point(machine.D_HEIGHTS, tables.heights)
        self._deck[machine.D_TABLES] = tables.frequencies.size
        every = np.arange(self.size)
        self.set("start.head", every, float(head))
        self._put_rows(int(machine.HINTS) // W, every, [0.0, 0.0])

    def replay(self, frequencies: np.ndarray | None) -> None:
        """A recorded signal, Hz, one number for each control period, in place of all sensors'; None: none."""
        self._deck[machine.D_SIGNALS] = 0 if frequencies is None else len(frequencies)
        if frequencies is not None:
            self._point(machine.D_SIGNAL, np.ascontiguousarray(frequencies, np.float64))

    def use_gantries(self, axes: Law, process: Law) -> Gantries:
        """Gives the machines axes that follow jobs, and a cut; see :class:`gantries.Gantries`."""
        self.gantries = Gantries(self.size, axes, process)
        for slot, kernel in (
            (machine.D_START, gantry.start), (machine.D_READY, gantry.ready), (machine.D_TRAVEL, gantry.travel),
            (machine.D_FINISH, gantry.finish),
        ):  # fmt: skip
            self._deck[slot] = kernel.address
        self._deck[machine.D_GANTRY] = self.gantries.address
        return self.gantries

    # ------------------------------------------------------------------------------------------------- running

    def drive_by(self, law: Law) -> None:
        """Gives the machines another law (its parameters are written with :meth:`put_law`)."""
        self.law = law
        self._deck[machine.D_LAW] = stage_of(law, machine.LAW_PLACES)
        memory = np.zeros(max(1, self.blocks * W * law.memory))  # of each machine, behind the tables
        self._point(machine.D_LAW_TABLES, np.concatenate([law.tables, memory]))
        self._deck[machine.D_LAW_SIZE] = law.tables.size

    def hook(self, act: int, observe: int, io: Words) -> None:
        """Stages that an environment runs before and after each period: addresses, and the words they share."""
        assert isinstance(io, Words), "plain words keep nothing alive"
        self._deck[machine.D_ACT], self._deck[machine.D_OBSERVE] = act, observe
        self._point(machine.D_IO, io)

    def at_end(self, stage: int, numbers: np.ndarray) -> None:
        """A stage at the end of each period of machines without axes: its address, and the array that it gets."""
        assert self.gantries is None
        assert numbers.dtype == np.float64, "numbers keep nothing alive; addresses need Words"
        self._deck[machine.D_FINISH] = stage
        self._point(machine.D_GANTRY, numbers)

    def after_filter(self, stage: int, numbers: np.ndarray) -> None:
        """A stage between filter and table: its address, and the array that it gets beside the deck."""
        self._deck[machine.D_FILTERED] = stage
        self._point(machine.D_FILTERED_IO, Words((address(numbers), self._at)))

    def after_sensor(self, stage: int, io: Words) -> None:
        """A stage between sensor and filter, not run while an episode begins: its address, and the words it gets."""
        assert isinstance(io, Words), "plain words keep nothing alive"
        self._deck[machine.D_SENSED] = stage
        self._point(machine.D_SENSED_IO, io)

    def after_supervisor(self, stage: int, io: Words) -> None:
        """A stage between supervisor and drive: its address, and the words it gets."""
        assert isinstance(io, Words), "plain words keep nothing alive"
        self._deck[machine.D_SENT] = stage
        self._point(machine.D_SENT_IO, io)

    def pilot(self, name: str, stage: int, io: Words) -> None:
        """A stage that moves a hand of the machines: it runs when an episode has begun and after each period.

        Args:
            name: a second pilot of this name takes the place of the first; others run one after the other.
            stage: its address; it ends by calling the stage ``io[0]``, unless that is 0, with ``io[1]``.
            io: what it knows.
        """
        assert isinstance(io, Words), "plain words keep nothing alive"
        self._pilots[name] = (stage, io)
        following = (0, 0)
        for runs, words in reversed(self._pilots.values()):
            words[0], words[1] = following
            following = (runs, address(words))
        self._deck[machine.D_PILOT], self._deck[machine.D_PILOT_IO] = following

    def begin(self, machines: Any, keys: Any) -> None:
        """Starts an episode on ``machines`` (whose parameters are written), with one random stream each."""
        for index, key in zip(np.atleast_1d(machines), np.atleast_1d(keys), strict=True):
            machine.begin(self._at, int(index), int(key))

    def advance(self, steps: int = 1) -> None:
        """``steps`` control periods of every machine; the result does not depend on the number of threads."""
        self._deck[machine.D_STEPS] = steps
        try:
            if self.threads == 1 or self.blocks == 1:
                machine.advance(self._at)
            else:
                self._deck[machine.D_NEXT] = 0
                workers(self.threads).share(self._share)
                self._deck[machine.D_TICK] += np.uint64(steps)
        finally:
            self._deck[machine.D_STEPS] = self._usual

    def _share(self) -> None:
        machine.share(self._at)

    def stepper(self, steps: int = 1) -> Callable[[], Any]:
        """A function that advances every machine by ``steps`` control periods, as quickly as can be.

        It keeps the fleet alive. It goes on doing just these steps when others are asked for later: only the steps of
        the first lie in the deck.
        """
        if (self.threads > 1 and self.blocks > 1) or (self._promised and steps != self._usual):
            return functools.partial(self.advance, steps)
        self._promised, self._usual = True, steps
        self._deck[machine.D_STEPS] = steps
        return machine.advance.bound(Address(self._at, self))

    def run_kernel(self, kernel: Any, steps: int) -> None:
        """``steps`` control periods by another kernel with the deck's contract, such as one to compare speed with."""
        self._deck[machine.D_STEPS] = steps
        try:
            kernel(self._at)
        finally:
            self._deck[machine.D_STEPS] = self._usual

    def start_recording(self, steps: int) -> np.ndarray:
        """Keeps the next ``steps`` periods: float32 of shape (steps, channels, size), see ``machine.CHANNELS``."""
        self.record = np.zeros((steps, len(machine.CHANNELS), self.size), np.float32)
        self._point(machine.D_RECORD, self.record)
        self._deck[machine.D_RECORD_TICK], self._deck[machine.D_RECORD_STEPS] = self._deck[machine.D_TICK], steps
        return self.record

    def stop_recording(self) -> None:
        """Ends :meth:`start_recording`; further periods are not kept."""
        self._deck[machine.D_RECORD] = 0
        self._owned.pop(machine.D_RECORD, None)
        self.record = None

    @property
    def tick(self) -> int:
        """Control periods that the fleet has lived through."""
        return int(self._deck[machine.D_TICK])
