"""A fleet: any number of machines in blocks, as Python sees them. Owns the memory, knows no physics."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..engine.columns import Columns
from ..engine.deck import Deck
from ..engine.lanes import W, fields, flat
from ..engine.quantity import InvalidInput
from ..engine.workers import workers
from . import filters, gantry, machine, path, sheet, z_axis
from .calibration import Pool
from .controller import Law, stage_of
from .gantries import Gantries


class Filtered(NamedTuple):
    """The deck of a stage between filter and table."""

    numbers: int  # array of its own
    machine: int  # the words of the machine's deck


class Fleet(Columns):
    """``size`` machines that share a law; every other parameter may differ from machine to machine.

    Its :attr:`deck` owns what kernels work on; the fleet may go while a stepper, or anything else that was handed out,
    goes on.

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
        self._contours: dict[int, tuple[path.Contour, int]] = {}  # with the index of their first sample
        self._profiles: dict[int, tuple[np.ndarray, int]] = {}
        self._randoms: dict[tuple[float, float, float, int], tuple[np.ndarray, int]] = {}
        self._maps: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self.deck = Deck(machine.Entries, machines=size, block=self._block, keys=self._keys)
        self.deck["steps"] = self._usual = 1
        self._promised = False  # a stepper has been handed out that does the usual steps
        self.deck["frequencies"] = tables.frequencies
        self.deck["heights"] = tables.heights
        self.deck["tables"] = tables.frequencies.size
        self.drive_by(law)
        self._pilots: dict[str, tuple[int, Deck]] = {}
        self.record: np.ndarray | None = None
        self.gantries: Gantries | None = None
        every = np.arange(size)
        self.put_filter(every, filters.Params())
        self.clear_features(every)
        self.put_law(every, law.Params())

    # ------------------------------------------------------------------------------------------ columns

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
        self.deck["waves"] = max(self.deck["waves"], i + 1)

    def put_vibration(self, machines: Any, i: int, amplitude: Any, frequency: Any, phase: Any, zeta: Any = 0.0) -> None:
        """Vibration ``i``: amplitude in mm (of a band √2 times its RMS), frequency in Hz, damping ratio (0: a tone)."""
        omega = 2 * np.pi * np.asarray(frequency)
        self._put_list(machine.VIBRATIONS, 4, machines, i, (amplitude, omega, phase, zeta))
        if np.any(np.asarray(zeta) > 0):
            self.use(machine.F_BANDS)
        self.deck["vibrations"] = max(self.deck["vibrations"], i + 1)

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
        return self.deck["waves"]

    @property
    def vibrations(self) -> int:
        """Vibrations that the kernel adds up."""
        return self.deck["vibrations"]

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
            self.deck["random"] = known[0] if len(known) == 1 else np.concatenate(known)
            self.deck["randoms"] = sum(len(tables) for tables in known)
        first = np.array([self._randoms[*source, pair][1] for pair in wanted.tolist()], float)[which]
        for name, value in zip(sheet.Random._fields, (first, *numbers), strict=True):
            self.set(f"random.{name}", machines, value)
        self.use(machine.F_RANDOM)

    def use_bulges(self) -> None:
        """Switches the thermal bulge on."""
        self.use(machine.F_BULGES)

    def allow_delay(self, periods: Any) -> None:
        """Before machines get these dead times (control periods): makes room for commands that wait so long."""
        if np.any(np.asarray(periods) > z_axis.QUEUE - 1) and not self.deck["flags"] & int(machine.F_LATE):
            self.deck["late"] = np.zeros(self.blocks * len(z_axis.Late._fields) * W)
            self.use(machine.F_LATE)

    def use_turns(self) -> None:
        """Switches the turns of long episodes on."""
        self.use(machine.F_TURNS)

    def use(self, flag: Any) -> None:
        """Switches on an optional stage, see ``machine.F_…``."""
        self.deck["flags"] |= int(flag)

    def put_filter(self, machines: Any, params: filters.Params) -> None:
        """Filter settings; raises :class:`InvalidInput` if the trim eats the window."""
        p = filters.validated(params)
        self.put("filter", machines, p)
        self.deck["window"] = max(self.deck["window"], int(p.window))
        if p.trim > 1:
            self.use(machine.F_RANKS)

    def forget_filters(self) -> None:
        """Before all machines get new filters: the kernel need not allow for the old ones any more."""
        self.deck["window"] = 1
        self.deck["flags"] &= ~int(machine.F_RANKS)

    def widest_window(self, window: int, trim: int) -> None:
        """Allows for filters up to this window and trim, when they change during an episode."""
        self.deck["window"] = max(self.deck["window"], window)
        if trim > 1:
            self.use(machine.F_RANKS)

    def put_contours(self, contours: list[path.Contour], which: Any, machines: Any) -> None:
        """Machine ``machines[i]`` travels ``contours[which[i]]``."""
        for contour in contours:
            if id(contour) not in self._contours:
                self._contours[id(contour)] = (contour, sum(len(c.x) for c, _ in self._contours.values()))
                known = [c for c, _ in self._contours.values()]
                self.deck["contour_x"] = np.concatenate([c.x for c in known])
                self.deck["contour_y"] = np.concatenate([c.y for c in known])
                self.deck["contour_on"] = np.concatenate([c.cutting for c in known])
                self.deck["contours"] = sum(len(c.x) for c in known)
        first = np.array([self._contours[id(contour)][1] for contour in contours])
        self.set("path.contour", machines, first[which])
        self.set("path.samples", machines, np.array([len(contour.x) for contour in contours])[which])
        self.use(machine.F_CONTOURS)

    def put_profile(self, heights: np.ndarray, spacing: float, machines: Any) -> None:
        """A measured profile along the path, mm, sampled every ``spacing`` mm, for ``machines``."""
        if id(heights) not in self._profiles:
            self._profiles[id(heights)] = (heights, sum(len(h) for h, _ in self._profiles.values()))
            known = [h for h, _ in self._profiles.values()]
            self.deck["profile"] = np.concatenate(known, dtype=np.float64)
            self.deck["profiles"] = sum(len(h) for h in known)
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
        self.deck["frequencies"] = tables.frequencies
        self.deck["heights"] = tables.heights
        self.deck["tables"] = tables.frequencies.size
        every = np.arange(self.size)
        self.set("start.head", every, float(head))
        self._put_rows(int(machine.HINT) // W, every, [0.0, 0.0])

    def replay(self, frequencies: np.ndarray | None) -> None:
        """A recorded signal, Hz, one number for each control period, in place of all sensors'; None: none."""
        self.deck["signals"] = 0 if frequencies is None else len(frequencies)
        if frequencies is not None:
            self.deck["signal"] = np.ascontiguousarray(frequencies, np.float64)

    def use_gantries(self, axes: Law, process: Law) -> Gantries:
        """Gives the machines axes that follow jobs, and a cut; see :class:`gantries.Gantries`."""
        self.gantries = Gantries(self.size, axes, process)
        for kernel in (gantry.start, gantry.ready, gantry.travel, gantry.finish):
            self.deck[kernel.function.__name__.lstrip("_")] = kernel.address
        self.deck["gantry"] = self.gantries.deck
        return self.gantries

    # ------------------------------------------------------------------------------------------------- running

    def drive_by(self, law: Law) -> None:
        """Gives the machines another law (its parameters are written with :meth:`put_law`)."""
        self.law = law
        self.deck["law"] = stage_of(law, machine.LAW_PLACES)
        memory = np.zeros(max(1, self.blocks * W * law.memory))  # of each machine, behind the tables
        self.deck["law_tables"] = np.concatenate([law.tables, memory])
        self.deck["law_size"] = law.tables.size

    @property
    def memories(self) -> np.ndarray:
        """What the law keeps of each machine, shape (machines, law.memory); a view of what kernels work on."""
        kept = self.deck.owned("law_tables")[self.law.tables.size :]
        return kept[: self.size * self.law.memory].reshape(self.size, self.law.memory)

    def hook(self, act: int, observe: int, io: Deck) -> None:
        """Stages that an environment runs before and after each period: addresses, and the deck they share."""
        assert isinstance(io, Deck), "plain words keep nothing alive"
        self.deck["act"], self.deck["observe"] = act, observe
        self.deck["io"] = io

    def at_end(self, stage: int, numbers: np.ndarray) -> None:
        """A stage at the end of each period of machines without axes: its address, and the array that it gets."""
        assert self.gantries is None
        assert numbers.dtype == np.float64, "numbers keep nothing alive; addresses need a Deck"
        self.deck["finish"] = stage
        self.deck["gantry"] = numbers

    def after_filter(self, stage: int, numbers: np.ndarray) -> None:
        """A stage between filter and table: its address, and the array that it gets in :class:`Filtered`."""
        self.deck["filtered"] = stage
        self.deck["filtered_io"] = Deck(Filtered, numbers=numbers, machine=self.deck.words)

    def after_sensor(self, stage: int, io: Deck) -> None:
        """A stage between sensor and filter, not run while an episode begins: its address, and the deck it gets."""
        assert isinstance(io, Deck), "plain words keep nothing alive"
        self.deck["sensed"] = stage
        self.deck["sensed_io"] = io

    def after_supervisor(self, stage: int, io: Deck) -> None:
        """A stage between supervisor and drive: its address, and the deck it gets."""
        assert isinstance(io, Deck), "plain words keep nothing alive"
        self.deck["sent"] = stage
        self.deck["sent_io"] = io

    def pilot(self, name: str, stage: int, io: Deck) -> None:
        """A stage that moves a hand of the machines: it runs when an episode has begun and after each period.

        Args:
            name: a second pilot of this name takes the place of the first; others run one after the other.
            stage: its address; it ends by calling the stage ``next``, unless that is 0, with ``next_io``.
            io: what it knows; these two entries are among it.
        """
        assert isinstance(io, Deck), "plain words keep nothing alive"
        self._pilots[name] = (stage, io)
        following: tuple[int, Deck | None] = (0, None)
        for runs, its in reversed(self._pilots.values()):
            its["next"], its["next_io"] = following
            following = (runs, its)
        self.deck["pilot"], self.deck["pilot_io"] = following

    def begin(self, machines: Any, keys: Any) -> None:
        """Starts an episode on ``machines`` (whose parameters are written), with one random stream each."""
        for index, key in zip(np.atleast_1d(machines), np.atleast_1d(keys), strict=True):
            machine.begin(self.deck, int(index), int(key))

    def advance(self, steps: int = 1) -> None:
        """``steps`` control periods of every machine; the result does not depend on the number of threads."""
        other = steps != self._usual
        if other:
            self.deck["steps"] = steps
        try:
            if self.threads == 1 or self.blocks == 1:
                machine.advance(self.deck)
            else:
                self.deck["next"] = 0
                workers(self.threads).share(self._share)
                self.deck["tick"] += steps
        finally:
            if other:
                self.deck["steps"] = self._usual

    def _share(self) -> None:
        machine.share(self.deck)

    def stepper(self, steps: int = 1) -> Callable[[], Any]:
        """A function that advances every machine by ``steps`` control periods, as quickly as can be.

        It keeps alive all that the machines need. It goes on doing just these steps when others are asked for later:
        only the steps of the first lie in the deck.
        """
        if (self.threads > 1 and self.blocks > 1) or (self._promised and steps != self._usual):
            return functools.partial(self.advance, steps)
        self._promised, self._usual = True, steps
        self.deck["steps"] = steps
        return machine.advance.bound(self.deck)

    def run_kernel(self, kernel: Any, steps: int) -> None:
        """``steps`` control periods by another kernel with the deck's contract, such as one to compare speed with."""
        self.deck["steps"] = steps
        try:
            kernel(self.deck)
        finally:
            self.deck["steps"] = self._usual

    def start_recording(self, steps: int) -> np.ndarray:
        """Keeps the next ``steps`` periods: float32 of shape (steps, channels, size), see ``machine.CHANNELS``."""
        self.record = np.zeros((steps, len(machine.CHANNELS), self.size), np.float32)
        self.deck["record"] = self.record
        self.deck["record_tick"], self.deck["record_steps"] = self.deck["tick"], steps
        return self.record

    def stop_recording(self) -> None:
        """Ends :meth:`start_recording`; further periods are not kept."""
        self.deck["record"] = None
        self.record = None

    @property
    def tick(self) -> int:
        """Control periods that the fleet has lived through."""
        return self.deck["tick"]
