"""One control period of the whole machine: the only place where parts meet.

Order of a period, *command → act → sense → control*::

    supervisor(signals, wish) → drive → 20 × [Z axis, gap] → sensor → filter → table → signals → law → wish

A stage is a loop over the lanes of a block; what it does to one lane is a part's function. The law and an environment's
action and observation are stages too, called by address, so this kernel is compiled once for all of them.
"""

from typing import NamedTuple

import numpy as np

from ..engine.deck import places
from ..engine.kernels import Kernel
from ..engine.lanes import (
    GOLD,
    U0,
    U1,
    U2,
    U3,
    U4,
    UW,
    Layout,
    U,
    W,
    bits,
    call,
    doubles,
    fma,
    gauss,
    load,
    part,
    row,
    rows,
    singles,
    stage,
    store,
    take,
    uniform,
    words,
)
from ..engine.quantity import in_order
from . import calibration, filters, path, sensor, sheet, supervisor, z_axis
from .controller import AHEAD, PERIOD, SLOTS, Privileged

SUBSTEPS = 20
_AT_ONCE = 5
DT = PERIOD / SUBSTEPS
"""s, physics substep of 50 µs."""


class Hand(NamedTuple):
    """What an environment's action does to the stack."""

    gain: float = 1.0  # times the law's command
    residual: float = 0.0  # mm/s, added to it


class Start(NamedTuple):
    """Where an episode starts."""

    gap: float = 1.0  # mm above the sheet, at rest
    head: float = 0.0  # index of the calibrated head
    coast: float = 0.0  # encoder offset before homing, mm


class Course(NamedTuple):
    """What is fixed at the start of a control period."""

    surface: float = 0.0  # mm, at the start of the period; its course is quadratic in the share q of the period
    slope: float = 0.0  # mm
    bend: float = 0.0  # mm
    opens: float = 0.75  # share of the period at which the gate opens
    weight: float = 0.2  # of each substep within the gate
    cover: float = 1.0  # share of the sensor's plate over sheet
    felt: float = 0.0  # mm by which the sheet under the plate is higher than under the tip, mean over the gate
    open: bool = False  # nothing but void under the nozzle tip
    scored: bool = True  # beam on and over sheet


class Moment(NamedTuple):
    """What the substeps of a control period add up."""

    gap: float = 0.0  # mm, at the latest substep
    head: float = 0.0  # mm
    gate_gap: float = 0.0  # mm, mean over the gate
    gate_motor: float = 0.0  # mm, mean over the gate
    lowest: float = 0.0  # mm, smallest gap of the period


class On(NamedTuple):
    """How much of what takes turns is on, 0 to 1."""

    waves: float = 1.0
    random: float = 1.0
    vibrations: float = 1.0
    impulses: float = 1.0


class Tally(NamedTuple):
    """What an episode adds up."""

    ticks: float = 0.0  # control periods so far
    collided: bool = False
    lowest: float = 1e9  # mm, smallest gap so far
    encoder: float = 0.0  # mm, at the last period


_layout = Layout()
P_PATH, P_SHEET = _layout.part("path", path.Params), _layout.part("sheet", sheet.Params)
WAVES = _layout.place(sheet.WAVES * rows(sheet.Wave))
VIBRATIONS = _layout.place(sheet.VIBRATIONS * rows(sheet.Vibration))
P_RANDOM, P_TURNS = _layout.part("random", sheet.Random), _layout.part("turns", sheet.Turns)
FEATURES = _layout.place(sheet.FEATURES * rows(sheet.Feature))
P_SENSOR, P_GATE = _layout.part("sensor", sensor.Params), _layout.part("gate", sensor.Gate)
P_FILTER, P_TABLE = _layout.part("filter", filters.Params), _layout.part("table", calibration.Params)
P_Z, P_GUARD = _layout.part("z", z_axis.Params), _layout.part("guard", supervisor.Params)
JOB, START = _layout.part("job", supervisor.Orders), _layout.part("start", Start)
HAND = _layout.part("hand", Hand)
P_LAW, S_LAW = _layout.place(SLOTS["z"].params), _layout.place(SLOTS["z"].state)
S_PATH, S_SHEET = _layout.part("journey", path.State), _layout.place(rows(sheet.State))
ON = _layout.place(rows(On))
SHAKEN = _layout.place(sheet.VIBRATIONS * rows(sheet.Shaken))
S_SENSOR, S_FILTER = _layout.place(rows(sensor.State)), _layout.place(rows(filters.State))
S_Z, DRIVE = _layout.part("motion", z_axis.State), _layout.part("drive", z_axis.Drive)
S_GUARD = _layout.part("supervisor", supervisor.State)
SIGNALS, TALLY = _layout.part("signals", Privileged), _layout.part("tally", Tally)
COURSE, MOMENT = _layout.part("course", Course), _layout.part("moment", Moment)
PACE = _layout.place(max(rows(z_axis.Pace), rows(filters.Fold)))
GAINS = _layout.place(rows(z_axis.Gains))
FOLD, KEPT = PACE, _layout.place(2)  # the pace has been used when the filter folds
WISH, BEAM, SLOPE, CLOCK, ORIGIN = (_layout.place(1) for _ in range(5))
PASSED, REFUGE = KEPT, KEPT + UW  # and these two when it keeps
HINT, RAW_HINT = _layout.place(1), _layout.place(1)  # entries of the table at the last reading, filtered and raw
SURFACES, SURFACES_LAST = _layout.place(16), U(15)  # ring: two points a period, from the past period to the preview
FELT = _layout.place(16)  # the same for what the sheet under the plate is above that under the tip
SAMPLES, SAMPLES_LAST = _layout.place(filters.LONGEST), U(filters.LONGEST - 1)  # ring of frequencies
HISTORY, HISTORY_LAST = 16, U(15)
HEIGHTS, RAW_HEIGHTS, POSITIONS, COMMANDS = (_layout.place(HISTORY) for _ in range(4))  # rings, one entry a period
ROWS = _layout.rows
STRIDE = U(ROWS * W)

LAW_PLACES = {"params": P_LAW, "state": S_LAW, "signals": SIGNALS, "wish": WISH, "stride": STRIDE}


def signal(name: str) -> np.uint64:
    """Offset of a signal of the Z axis's law in a block, by its name in :class:`Privileged`."""
    return SIGNALS + row(Privileged, name)


PLACES = _layout.parts
"""Offset and class of each part that Python reads or writes."""

CHANNELS = in_order(
    "gap height raw_height surface head velocity acceleration command wish mode scored distance override"
)
"""What a recorder keeps of each control period, float32: true gap, mm; reported and raw height, mm; surface and head,
mm; motor velocity, mm/s; motor acceleration, mm/s²; command after and before the supervisor, mm/s; its mode; whether
the period counts as cutting; distance along the path, mm; whether the supervisor overrode the law."""

_TO_GAP, _TO_HEIGHT, _TO_RAW, _TO_SURFACE, _TO_HEAD, _TO_VELOCITY, _TO_ACCELERATION = map(U, range(7))
_TO_COMMAND, _TO_WISH, _TO_MODE, _TO_SCORED, _TO_DISTANCE, _TO_OVERRIDE = map(U, range(7, len(CHANNELS)))


class Entries(NamedTuple):
    """The deck of the machine's kernels. Arrays are float64 unless another type is named; stages are addresses of
    compiled code, 0: none."""

    block: int  # array of all columns
    keys: int  # uint64 array (machines,), random streams
    machines: int
    tick: int  # control periods so far
    steps: int  # control periods of a call
    next: int  # block that the next free thread takes
    flags: int  # F_…
    window: int  # samples of the longest filter
    waves: int  # that are added up
    vibrations: int
    frequencies: int  # arrays (tables,), Hz and mm: calibration tables one behind the other
    heights: int
    tables: int
    contour_x: int  # arrays (contours,), mm, mm and flags: samples of all contours
    contour_y: int
    contour_on: int
    contours: int
    profile: int  # array (profiles,), mm: samples of measured profiles and maps
    profiles: int
    random: int  # array (randoms,): tables of sheets of continuous spectrum
    randoms: int
    signal: int  # array (signals,), Hz, in place of the sensors'
    signals: int
    late: int  # array (blocks, rows of z_axis.Late, lanes), mm/s; only where there are long dead times
    law: int  # stage
    law_tables: int  # array (law_size,), and behind it the machines' memories
    law_size: int
    act: int  # an environment's stages, and its deck
    observe: int
    io: int
    sensed: int  # stage after the sensor, and its deck
    sensed_io: int
    filtered: int  # stage after the filter, and its deck
    filtered_io: int
    sent: int  # stage after the supervisor, and its deck
    sent_io: int
    pilot: int  # first of the stages that move a hand, and its deck
    pilot_io: int
    start: int  # stages of axes that follow a job
    ready: int
    travel: int
    finish: int  # stage at the end of a period
    gantry: int  # what these four are given: the gantries' deck, or an array
    record: int  # float32 array (record_steps, channels, machines)
    record_tick: int  # its first tick
    record_steps: int


D = places(Entries)
DECK = U(len(D))

F_CONTOURS, F_FEATURES, F_PROFILES, F_BULGES, F_RANKS, F_PLATES, F_RANDOM, F_BANDS, F_TURNS, F_BRISTLES, F_LATE = (
    U(2**i) for i in range(11)
)
"""Flags: what at least one of the machines uses; the rest is skipped, which changes no bit of the others."""

_WAVE, _VIBRATION, _FEATURE = (U(rows(c) * W) for c in (sheet.Wave, sheet.Vibration, sheet.Feature))
_SHAKEN = U(rows(sheet.Shaken) * W)
_SALT = U(0x5EED5EED5EED5EED)  # sets a vibration's random numbers apart from the sensor's
_AHEAD2 = U(2 * AHEAD)
AHEAD_S = AHEAD * PERIOD
"""s by which the path runs ahead of the machine."""
_CHANNELS = U(len(CHANNELS))
_PREFILL = AHEAD + 1
_RISE, _MEMORY = U(supervisor.RISE_WINDOW), U(supervisor.MEMORY)
_WORDS = U(6)  # random words that a sample takes
_POINTS = float(calibration.POINTS)
_HEIGHT, _RAW_HEIGHT, _FREQUENCY, _FRESH, _HEAD_POSITION = (
    SIGNALS + row(Privileged, name) for name in ("height", "raw_height", "frequency", "fresh", "head_position")
)
_ON_WAVES, _ON_RANDOM, _ON_VIBRATIONS, _ON_IMPULSES = (ON + row(On, name) for name in On._fields)
_PLATE, _TABLE, _WINDOW = (
    P_SHEET + row(sheet.Params, "plate"),
    START + row(Start, "head"),
    P_FILTER + row(filters.Params, "window"),
)
_SURFACE, _BEND_1, _BEND_2 = (COURSE + row(Course, name) for name in ("surface", "slope", "bend"))
_UNDER = FELT - SURFACES  # from a point of the tip's surface to the plate's
_STILL, _ALL_ON, _UNSENSED, _UNGUARDED = z_axis.Drive(), On(), sensor.State(), supervisor.State()
_NOTHING_LATE, _OLDEST = z_axis.Late(), DRIVE + row(z_axis.Drive, z_axis.Drive._fields[-1])
_LATE = U(rows(z_axis.Late) * W)


# ---------------------------------------------------------------------------------- stages, in the order of a period


@part
def _view(block, a, surface, refuge):
    """What the supervisor of the machine at ``a`` reads; ``surface``: encoder − height RISE_WINDOW ms ago, mm."""
    x, hand = load(Privileged, block, a + SIGNALS), load(Hand, block, a + HAND)
    encoder = x.head_position - load(supervisor.State, block, a + S_GUARD).offset
    return supervisor.View(
        height=x.height,
        fall=surface - (x.head_position - x.height),
        refuge=refuge,
        valid=x.valid,
        head_position=x.head_position,
        encoder=encoder,
        last_encoder=encoder - x.head_velocity * PERIOD,
        wish=hand.gain * block[a + WISH] + hand.residual,
        frequency=x.frequency,
    )


@part
def _guard(block, a):
    """Parameters, state and job of the supervisor."""
    p, s = load(supervisor.Params, block, a + P_GUARD), load(supervisor.State, block, a + S_GUARD)
    return p, s, load(supervisor.Orders, block, a + JOB)


@stage
def supervise_all(block, at, n, tick):
    """Supervisor and drive: the law's wish becomes a command that is on its way."""
    past = at + ((tick - U1 - _RISE) & HISTORY_LAST) * UW
    before = at + POSITIONS + ((tick - U1 - _MEMORY) & HISTORY_LAST) * UW
    now = at + COMMANDS + (tick & HISTORY_LAST) * UW
    for lane in range(n):
        block[at + lane + PASSED] = block[past + lane + POSITIONS] - block[past + lane + HEIGHTS]
        block[at + lane + REFUGE] = block[before + lane]
    for lane in range(n):
        a = at + lane
        p, s, job = _guard(block, a)
        s, u = supervisor.follow(p, s, job, _view(block, a, block[a + PASSED], block[a + REFUGE]))
        store(block, a + S_GUARD, s)
        block[a + PASSED] = u
    for lane in range(n):  # rare, so branches are cheaper than computing it for all
        a = at + lane
        p, s, job = _guard(block, a)
        if not supervisor.is_following(s, job):
            s, u = supervisor.errand(p, s, job, _view(block, a, 0.0, 0.0), block[a + PASSED])
            store(block, a + S_GUARD, s)
            block[a + PASSED] = u
    for lane in range(n):
        a = at + lane
        p, s, job = _guard(block, a)
        s, command = supervisor.join(p, s, job, _view(block, a, 0.0, 0.0), block[a + PASSED])
        store(block, a + S_GUARD, s)
        drive = z_axis.accept(load(z_axis.Params, block, a + P_Z), load(z_axis.Drive, block, a + DRIVE), command)
        store(block, a + DRIVE, drive)
        block[a + PASSED] = command
    for lane in range(n):
        block[now + lane] = block[at + lane + PASSED]


@stage
def travel_all(block, at, n, tick, deck):
    """Path and sheet: the surface in the middle and at the end of the period that lies AHEAD ms ahead."""
    flags = deck[D.flags]
    middle = at + SURFACES + ((tick + tick + _AHEAD2) & SURFACES_LAST) * UW
    end = at + SURFACES + ((tick + tick + _AHEAD2 + U1) & SURFACES_LAST) * UW
    if flags & F_TURNS:
        _take_turns(block, at, n)
    if deck[D.travel] > U0:  # axes that follow a job
        call(deck[D.travel], deck[D.block], at, n, deck[D.gantry], tick)
    else:
        for lane in range(n):
            a = at + lane
            p, s = load(path.Params, block, a + P_PATH), load(path.State, block, a + S_PATH)
            store(block, a + S_PATH, path.advance(p, s, PERIOD, AHEAD_S))
    if flags & F_CONTOURS:
        _trace_contours(block, at, n, deck)
    for lane in range(n):
        a = at + lane
        p, where = load(sheet.Params, block, a + P_SHEET), load(path.State, block, a + S_PATH)
        block[middle + lane] = p.tilt_x * sheet.sloped(p, where.middle_x) + p.tilt_y * where.middle_y
        block[end + lane] = p.tilt_x * sheet.sloped(p, where.x) + p.tilt_y * where.y
    if flags & F_BULGES:
        _add_bulges(block, at, n, middle, end)
    if flags & F_PLATES:
        for lane in range(n):
            block[middle + lane + _UNDER], block[end + lane + _UNDER] = 0.0, 0.0
    _add_waves(block, at, n, middle, end, deck[D.waves])
    if flags & F_BANDS:
        shake_all(block, at, n, tick, middle, end, words(deck[D.keys], U(2**40)), deck[D.vibrations])
    else:
        _add_tones(block, at, n, middle, end, deck[D.vibrations])
    if flags & F_RANDOM:
        _add_random(block, at, n, middle, end, doubles(deck[D.random], deck[D.randoms]))
    if flags & F_FEATURES:
        _add_features(block, at, n, middle, end)
    if flags & F_PROFILES:
        _add_profiles(block, at, n, middle, end, doubles(deck[D.profile], deck[D.profiles]))


@part
def _take_turns(block, at, n):
    """Turns of long episodes: what is on."""
    for lane in range(n):
        a = at + lane
        p, t = load(sheet.Turns, block, a + P_TURNS), load(path.State, block, a + S_PATH).time
        waves, random = sheet.turned(p, p.waves, t), sheet.turned(p, p.random, t)
        store(block, a + ON, On(waves, random, sheet.turned(p, p.vibrations, t), sheet.turned(p, p.impulses, t)))


@part
def _trace_contours(block, at, n, deck):
    """Contours: place and beam at the distance that has been travelled."""
    xs, ys = doubles(deck[D.contour_x], deck[D.contours]), doubles(deck[D.contour_y], deck[D.contours])
    on = doubles(deck[D.contour_on], deck[D.contours])
    for lane in range(n):
        a = at + lane
        p, s = load(path.Params, block, a + P_PATH), load(path.State, block, a + S_PATH)
        if p.contour >= 0.0:
            half = s.distance - 0.5 * p.feed * PERIOD
            x = path.sample(xs, p.contour, p.samples, path.SPACING, s.distance)
            y = path.sample(ys, p.contour, p.samples, path.SPACING, s.distance)
            mx = path.sample(xs, p.contour, p.samples, path.SPACING, half)
            my = path.sample(ys, p.contour, p.samples, path.SPACING, half)
            store(block, a + S_PATH, s._replace(x=x, y=y, middle_x=mx, middle_y=my))
            block[a + BEAM] = 1.0 if path.sample(on, p.contour, p.samples, path.SPACING, s.here) > 0.5 else 0.0


@part
def _add_bulges(block, at, n, middle, end):
    """Thermal bulge: it grows, and half-way it has grown by half as much."""
    for lane in range(n):
        a = at + lane
        p, s = load(sheet.Params, block, a + P_SHEET), load(sheet.State, block, a + S_SHEET)
        where, grown = load(path.State, block, a + S_PATH), sheet.grow(p, s)
        half = s._replace(grown=0.5 * (s.grown + grown.grown))
        block[middle + lane] += sheet.bulge(p, half, where.middle_x, where.middle_y)
        block[end + lane] += sheet.bulge(p, grown, where.x, where.y)
        store(block, a + S_SHEET, grown)


@part
def _add(block, point, on, tip, felt):
    """Adds to the surface under the tip, and to what the plate feels above it."""
    block[point] += on * tip
    block[point + _UNDER] += on * felt


@part
def _add_waves(block, at, n, middle, end, count):
    """Waves, of which the plate feels less."""
    for i in range(count):
        offset = WAVES + i * _WAVE
        for lane in range(n):
            a = at + lane
            w, where = load(sheet.Wave, block, a + offset), load(path.State, block, a + S_PATH)
            on = block[a + _ON_WAVES]
            halfway, whole = on * sheet.wave(w, where.middle_x, where.middle_y), on * sheet.wave(w, where.x, where.y)
            _add(block, middle + lane, halfway, w.amplitude, w.felt)
            _add(block, end + lane, whole, w.amplitude, w.felt)


@part
def _add_tones(block, at, n, middle, end, count):
    """Vibrations that are tones."""
    for i in range(count):
        offset = VIBRATIONS + i * _VIBRATION
        for lane in range(n):
            a = at + lane
            v, where = load(sheet.Vibration, block, a + offset), load(path.State, block, a + S_PATH)
            on = block[a + _ON_VIBRATIONS]
            block[middle + lane] += on * sheet.vibration(v, where.time - 0.5 * PERIOD)
            block[end + lane] += on * sheet.vibration(v, where.time)


@part
def _half_way(where):
    """Distance along the path in the middle of the period, mm."""
    return where.distance - 0.5 * where.feed * PERIOD


@part
def _add_random(block, at, n, middle, end, randoms):
    """Sheets of continuous spectrum."""
    for lane in range(n):
        a = at + lane
        p, where = load(sheet.Random, block, a + P_RANDOM), load(path.State, block, a + S_PATH)
        on, half = block[a + _ON_RANDOM], _half_way(where)
        if p.first >= 0.0:
            halfway = sheet.random_height(randoms, p, half, 0.0)
            whole = sheet.random_height(randoms, p, where.distance, 0.0)
            _add(block, middle + lane, on, halfway, sheet.random_height(randoms, p, half, 1.0) - halfway)
            _add(block, end + lane, on, whole, sheet.random_height(randoms, p, where.distance, 1.0) - whole)


@part
def _add_features(block, at, n, middle, end):
    """Steps, holes and edges: those behind are left, the present one is there."""
    for lane in range(n):
        a = at + lane
        s, along = load(sheet.State, block, a + S_SHEET), load(path.State, block, a + S_PATH).distance
        if sheet.is_behind(s.current, along) and s.upcoming < sheet.FEATURES:
            upcoming = load(sheet.Feature, block, a + FEATURES + U(np.int64(s.upcoming)) * _FEATURE)
            store(block, a + S_SHEET, sheet.leave(s, upcoming))
    for lane in range(n):
        a = at + lane
        s, where = load(sheet.State, block, a + S_SHEET), load(path.State, block, a + S_PATH)
        half, plate = _half_way(where), block[a + _PLATE]
        halfway, whole = sheet.features(s, half, sheet.FOOTPRINT), sheet.features(s, where.distance, sheet.FOOTPRINT)
        _add(block, middle + lane, 1.0, halfway, sheet.features(s, half, plate) - halfway)
        _add(block, end + lane, 1.0, whole, sheet.features(s, where.distance, plate) - whole)


@part
def _add_profiles(block, at, n, middle, end, profile):
    """Measured profiles along the path, and measured maps."""
    for lane in range(n):
        a = at + lane
        p, s = load(path.Params, block, a + P_PATH), load(path.State, block, a + S_PATH)
        if p.profile >= 0.0:
            if p.profile_samples == 0.0:
                block[middle + lane] += path.height_of(profile, p.profile, s.middle_x, s.middle_y)
                block[end + lane] += path.height_of(profile, p.profile, s.x, s.y)
            else:
                size, spacing = p.profile_samples, p.profile_spacing
                block[middle + lane] += path.sample(profile, p.profile, size, spacing, _half_way(s))
                block[end + lane] += path.sample(profile, p.profile, size, spacing, s.distance)


@stage
def shake_all(block, at, n, tick, middle, end, keys, count):
    """Vibrations of which at least one machine has a band: two steps of its mode a period, with noise of its own."""
    first = (at // STRIDE) * UW + at % STRIDE
    for i in range(count):
        offset, place, salt = VIBRATIONS + i * _VIBRATION, SHAKEN + i * _SHAKEN, _SALT * (i + U1)
        for lane in range(n):
            a = at + lane
            v, where = load(sheet.Vibration, block, a + offset), load(path.State, block, a + S_PATH)
            key, word, on = keys[first + lane] + salt, tick * _WORDS, block[a + _ON_VIBRATIONS]
            one = gauss(bits(key, word), uniform(bits(key, word + U1)))
            two = gauss(bits(key, word + U2), uniform(bits(key, word + U3)))
            s = sheet.shake(v, load(sheet.Shaken, block, a + place), one, 0.5 * PERIOD)
            block[middle + lane] += on * (s.height if v.zeta > 0.0 else sheet.vibration(v, where.time - 0.5 * PERIOD))
            s = sheet.shake(v, s, two, 0.5 * PERIOD)
            block[end + lane] += on * (s.height if v.zeta > 0.0 else sheet.vibration(v, where.time))
            store(block, a + place, s)


@stage
def prepare_all(block, at, n, tick):
    """What the substeps of this period need: the surface's course, the drive's pace, the gate."""
    s0 = at + SURFACES + ((tick + tick - U1) & SURFACES_LAST) * UW
    s1 = at + SURFACES + ((tick + tick) & SURFACES_LAST) * UW
    s2 = at + SURFACES + ((tick + tick + U1) & SURFACES_LAST) * UW
    for lane in range(n):
        a = at + lane
        start, middle, end = block[s0 + lane], block[s1 + lane], block[s2 + lane]
        block[a + _SURFACE] = start
        block[a + _BEND_1] = 4.0 * middle - 3.0 * start - end
        block[a + _BEND_2] = 2.0 * (start - middle) + 2.0 * (end - middle)
    for lane in range(n):
        a = at + lane
        feature, here = load(sheet.State, block, a + S_SHEET).current, load(path.State, block, a + S_PATH).here
        c, m = load(Course, block, a + COURSE), load(Moment, block, a + MOMENT)
        radius = sensor.sensing_radius(load(sensor.Params, block, a + P_SENSOR), max(m.gap, 0.0))
        gate = load(sensor.Gate, block, a + P_GATE)
        counted = max(1.0, np.rint(gate.length * (1e-3 / PERIOD) * SUBSTEPS))  # substeps within the gate
        # Means of q and q² over the gate's substeps, with which the plate's course is averaged as the gap is.
        q = 1.0 - (counted - 1.0) / (2.0 * SUBSTEPS)
        q2 = q * q + (counted * counted - 1.0) / (12.0 * SUBSTEPS * SUBSTEPS)
        start, middle, end = block[s0 + lane + _UNDER], block[s1 + lane + _UNDER], block[s2 + lane + _UNDER]
        course = c._replace(
            opens=1.0 - counted / SUBSTEPS + 1e-9,
            weight=1.0 / counted,
            cover=sheet.coverage(feature, here, radius),
            felt=start + (4.0 * middle - 3.0 * start - end) * q + 2.0 * (start - 2.0 * middle + end) * q2,
            open=sheet.over_void(feature, here, sheet.FOOTPRINT),
            scored=block[a + BEAM] > 0.5 and not sheet.over_void(feature, here, 0.0),
        )
        store(block, a + COURSE, course)
        store(block, a + PACE, z_axis.pace(load(z_axis.Params, block, a + P_Z), load(z_axis.Drive, block, a + DRIVE)))
        store(block, a + MOMENT, m._replace(gate_gap=0.0, gate_motor=0.0, lowest=1e9))


@part
def _late_of(at):
    """Where the late commands of the machine at ``at`` begin."""
    return at // STRIDE * _LATE + at % STRIDE


@stage
def pass_on_all(block, at, n, deck):
    """Long dead times, before the supervisor: the oldest command of the drive's queue goes over to the late ones."""
    late, first = doubles(deck[D.late], U(2**40)), _late_of(at)
    for lane in range(n):
        then = z_axis.passed_on(load(z_axis.Late, late, first + lane), block[at + lane + _OLDEST])
        store(late, first + lane, then)


@stage
def delay_all(block, at, n, deck):
    """Long dead times: the pace of the period under commands of which some are late."""
    late, first = doubles(deck[D.late], U(2**40)), _late_of(at)
    for lane in range(n):
        a = at + lane
        p, drive = load(z_axis.Params, block, a + P_Z), load(z_axis.Drive, block, a + DRIVE)
        store(block, a + PACE, z_axis.late_pace(p, drive, load(z_axis.Late, late, first + lane)))


@part
def substep(p, gains, pace, course, z, m, share, bristles):
    """One substep of one machine: the Z axis moves; gap and gate add up."""
    z, head = z_axis.step(p, gains, pace, z, share, DT, bristles)
    gap = head - fma(share, fma(share, course.bend, course.slope), course.surface)
    weight = course.weight if share > course.opens else 0.0
    gate_gap, gate_motor = fma(weight, gap, m.gate_gap), fma(weight, z.position, m.gate_motor)
    return z, Moment(gap, head, gate_gap, gate_motor, min(m.lowest, gap))


@stage
def move_all(block, at, n, k, bristles):
    """Substeps ``k`` … ``k + 4`` of the period; five at once, so that a state stays in registers for a while.

    ``bristles``: whether the friction of at least one machine has some; the compiler makes a loop without them, too.
    """
    first = np.float64(np.int64(k))
    for lane in range(n):
        a = at + lane
        p, gains = load(z_axis.Params, block, a + P_Z), load(z_axis.Gains, block, a + GAINS)
        pace, course = load(z_axis.Pace, block, a + PACE), load(Course, block, a + COURSE)
        z, m = load(z_axis.State, block, a + S_Z), load(Moment, block, a + MOMENT)
        z, m = substep(p, gains, pace, course, z, m, (first + 1.0) / SUBSTEPS, bristles)
        z, m = substep(p, gains, pace, course, z, m, (first + 2.0) / SUBSTEPS, bristles)
        z, m = substep(p, gains, pace, course, z, m, (first + 3.0) / SUBSTEPS, bristles)
        z, m = substep(p, gains, pace, course, z, m, (first + 4.0) / SUBSTEPS, bristles)
        z, m = substep(p, gains, pace, course, z, m, (first + 5.0) / SUBSTEPS, bristles)
        store(block, a + S_Z, z)
        store(block, a + MOMENT, m)


@part
def has_bristles(deck):
    """Whether the friction of at least one machine has bristles; without, a period takes a seventh less time."""
    return (deck[D.flags] & F_BRISTLES) > U0


@part
def sensed_gap(m, c):
    """Gap that the sensor feels over the gate while nothing touches, mm."""
    return max(m.gate_gap - c.felt, 0.1 if c.open else 1e-6)


@stage
def sense_all(block, at, n, tick, keys, first):
    """Sensor: one count, put into the ring of samples; a count that is not valid leaves the last one there."""
    now = at + SAMPLES + (tick & SAMPLES_LAST) * UW
    last = at + SAMPLES + ((tick - U1) & SAMPLES_LAST) * UW
    for lane in range(n):
        a = at + lane
        m, c = load(Moment, block, a + MOMENT), load(Course, block, a + COURSE)
        touches = m.lowest <= 0.0 and not c.open
        gap = 0.0 if touches else sensed_gap(m, c)
        p, s = load(sensor.Params, block, a + P_SENSOR), load(sensor.State, block, a + S_SENSOR)
        gate, spatter = load(sensor.Gate, block, a + P_GATE), block[a + _ON_IMPULSES]
        s, f = sensor.step(p, s, gate, gap, c.cover, spatter, keys[first + lane], tick)
        store(block, a + S_SENSOR, s)
        t = load(Tally, block, a + TALLY)
        lowest = t.lowest if c.open else min(t.lowest, m.lowest)
        store(block, a + TALLY, t._replace(ticks=t.ticks + 1.0, collided=t.collided or touches, lowest=lowest))
        block[a + _FREQUENCY] = f
    for lane in range(n):
        f = block[at + lane + _FREQUENCY]
        block[now + lane] = f if f > 0.0 else block[last + lane]


@stage
def replay_all(block, at, n, tick, deck):
    """A recorded signal in place of the sensor's: one frequency for each control period, from the episode's start."""
    now, signal = at + SAMPLES + (tick & SAMPLES_LAST) * UW, doubles(deck[D.signal], deck[D.signals])
    last = np.float64(np.int64(deck[D.signals])) - 1.0
    for lane in range(n):
        a = at + lane
        f = signal[U(np.int64(min(max(load(Tally, block, a + TALLY).ticks, 0.0), last)))]
        block[a + _FREQUENCY] = f
        block[now + lane] = f


@stage
def filter_all(block, at, n, tick, window, ranks):
    """Filter over the ring of samples; the result lies in ``FOLD``'s first row."""
    for lane in range(n):
        store(block, at + lane + FOLD, filters.begin())
    for age in range(window):
        then = at + SAMPLES + ((tick - age) & SAMPLES_LAST) * UW
        old = np.float64(np.int64(age))
        for lane in range(n):
            a = at + lane
            p = load(filters.Params, block, a + P_FILTER)
            store(block, a + FOLD, filters.take(p, load(filters.Fold, block, a + FOLD), block[then + lane], old))
    for lane in range(n):
        a = at + lane
        block[a + FOLD] = filters.mean(load(filters.Params, block, a + P_FILTER), load(filters.Fold, block, a + FOLD))
    if ranks:
        rank_all(block, at, n, tick, window)
    now = at + SAMPLES + (tick & SAMPLES_LAST) * UW
    for lane in range(n):
        a = at + lane
        p, s = load(filters.Params, block, a + P_FILTER), load(filters.State, block, a + S_FILTER)
        s, f = filters.finish(p, s, block[a + FOLD], block[now + lane], block[a + SLOPE])
        store(block, a + S_FILTER, s)
        block[a + FOLD] = f


@stage
def rank_all(block, at, n, tick, window):
    """Trims of two and more, and medians: a sample is kept if enough others lie below and above it."""
    total, rank = KEPT, KEPT + UW
    for lane in range(n):
        block[at + lane + total] = 0.0
    for age in range(window):
        this = at + SAMPLES + ((tick - age) & SAMPLES_LAST) * UW
        old = np.float64(np.int64(age))
        for lane in range(n):
            block[at + lane + rank] = 0.0
        for other in range(window):
            that = at + SAMPLES + ((tick - other) & SAMPLES_LAST) * UW
            its_age = np.float64(np.int64(other))
            for lane in range(n):
                a = at + lane
                x, y = block[this + lane], block[that + lane]
                below = y < x or (y == x and its_age < old)
                block[a + rank] += 1.0 if below and its_age < block[a + _WINDOW] else 0.0
        for lane in range(n):
            a = at + lane
            p = load(filters.Params, block, a + P_FILTER)
            block[a + total] += filters.kept(p, block[a + rank], old) * block[this + lane]
    for lane in range(n):
        a = at + lane
        p = load(filters.Params, block, a + P_FILTER)
        many = p.trim > 1.0 and (p.kind == filters.IMPROVED or p.kind == filters.MEDIAN)
        block[a + FOLD] = block[a + total] / (p.window - 2.0 * p.trim) if many else block[a + FOLD]


@stage
def look_up_all(block, at, n, tick, deck):
    """Table: filtered and newest frequency to heights. Gathers, so a stage of its own."""
    frequencies, heights = doubles(deck[D.frequencies], deck[D.tables]), doubles(deck[D.heights], deck[D.tables])
    now = at + SAMPLES + (tick & SAMPLES_LAST) * UW
    for lane in range(n):
        a = at + lane
        first = U(np.int64(block[a + _TABLE] * _POINTS))
        p = load(calibration.Params, block, a + P_TABLE)
        filtered, raw = block[a + FOLD], block[now + lane]
        i = calibration.bracket_near(frequencies, first, filtered, first + U(np.int64(block[a + HINT])))
        j = calibration.bracket_near(frequencies, first, raw, first + U(np.int64(block[a + RAW_HINT])))
        block[a + HINT], block[a + RAW_HINT] = np.float64(np.int64(i - first)), np.float64(np.int64(j - first))
        height, slope = calibration.between(p, frequencies, heights, i, filtered)
        block[a + _HEIGHT], block[a + SLOPE] = height, slope
        block[a + _RAW_HEIGHT] = calibration.between(p, frequencies, heights, j, raw)[0]


@stage
def report_all(block, at, n, tick):
    """Signals of this period for the law, the supervisor, the history and the recorder."""
    for lane in range(n):
        a = at + lane
        m, t, z = load(Moment, block, a + MOMENT), load(Tally, block, a + TALLY), load(z_axis.State, block, a + S_Z)
        x, s = load(Privileged, block, a + SIGNALS), load(supervisor.State, block, a + S_GUARD)
        encoder = z_axis.encoded(load(z_axis.Params, block, a + P_Z), m.gate_motor)
        position = encoder + s.offset
        speed = (encoder - t.encoder) / PERIOD
        job = load(supervisor.Orders, block, a + JOB)
        set_height = job.protect if s.mode == supervisor.PROTECT else job.set_height
        way, way_there = load(path.State, block, a + S_PATH), load(path.Params, block, a + P_PATH)
        lap, feed = way_there.lap, path.feed_at(way_there, way.here) if way_there.corner > 0.0 else way.feed
        turns = np.floor(max(way.here, 0.0) / lap) if lap > 0.0 else 0.0
        store(block, a + TALLY, t._replace(encoder=encoder))
        x = x._replace(valid=x.frequency > 0.0, set_height=set_height, head_position=position, head_velocity=speed)
        x = x._replace(command=s.command, mode=s.mode, override=s.override, captured=s.captured, fresh=False)
        x = x._replace(feed=feed, place=way.here - turns * lap, lap=turns)
        s0, s1 = block[a + _surface(tick, U0)], block[a + _surface(tick, U1)]
        s2, s3 = block[a + _surface(tick, U2)], block[a + _surface(tick, U3)]
        s4, s5 = block[a + _surface(tick, U4)], block[a + _surface(tick, U(5))]
        x = x._replace(surface_0=s0, surface_1=s1, surface_2=s2, surface_3=s3, surface_4=s4, surface_5=s5)
        x = x._replace(gap=m.gap, head=m.head, velocity=z.velocity, acceleration=z.acceleration)
        store(block, a + SIGNALS, x)
        block[a + CLOCK] = np.float64(np.int64(tick & HISTORY_LAST))
        slot = a + (tick & HISTORY_LAST) * UW
        block[slot + HEIGHTS] = x.height
        block[slot + RAW_HEIGHTS] = x.raw_height
        block[slot + POSITIONS] = position


@part
def _surface(tick, ahead):
    """Offset of the surface at the end of the period ``ahead`` ms from now."""
    return SURFACES + ((tick + tick + U1 + ahead + ahead) & SURFACES_LAST) * UW


@stage
def record_all(block, at, n, tick, record, where, machines):
    """The channels of this period into the recorder, lanes side by side."""
    for lane in range(n):
        a = at + lane
        x, s = load(Privileged, block, a + SIGNALS), load(path.State, block, a + S_PATH)
        o = where + lane
        record[o + _TO_GAP * machines] = x.gap
        record[o + _TO_HEIGHT * machines] = x.height
        record[o + _TO_RAW * machines] = x.raw_height
        record[o + _TO_SURFACE * machines] = x.surface_0
        record[o + _TO_HEAD * machines] = x.head
        record[o + _TO_VELOCITY * machines] = x.velocity
        record[o + _TO_ACCELERATION * machines] = x.acceleration
        record[o + _TO_COMMAND * machines] = x.command
        record[o + _TO_WISH * machines] = block[a + WISH]
        record[o + _TO_MODE * machines] = x.mode
        record[o + _TO_SCORED * machines] = 1.0 if load(Course, block, a + COURSE).scored else 0.0
        record[o + _TO_DISTANCE * machines] = s.here
        record[o + _TO_OVERRIDE * machines] = 1.0 if x.override else 0.0


# ------------------------------------------------------------------------------------------------------ kernels


@part
def sense_and_control(block, at, n, tick, keys, first, deck):
    """The second half of a period: sense, filter, look up, report, control."""
    sense_all(block, at, n, tick, keys, first)
    if deck[D.signals] > U0:
        replay_all(block, at, n, tick, deck)
    if deck[D.sensed] > U0:
        call(deck[D.sensed], deck[D.block], at, n, deck[D.sensed_io], tick)
    filter_all(block, at, n, tick, deck[D.window], deck[D.flags] & F_RANKS)
    if deck[D.filtered] > U0:
        call(deck[D.filtered], deck[D.block], at, n, deck[D.filtered_io], tick)
    look_up_all(block, at, n, tick, deck)
    report_all(block, at, n, tick)
    call(deck[D.law], deck[D.block], at, n, deck[D.law_tables], deck[D.law_size])


@stage
def live_all(deck, b):
    """All periods that the deck asks for, of the machines of block ``b``; an environment acts before them all and
    observes after them all."""
    machines = deck[D.machines]
    blocks = (machines + UW - U1) // UW
    block = doubles(deck[D.block], blocks * STRIDE)
    keys = words(deck[D.keys], blocks * UW)
    record = singles(deck[D.record], U(2**40))
    at = b * STRIDE
    n = min(UW, machines - b * UW)
    tick = deck[D.tick]
    steps = deck[D.steps]
    for i in range(steps):
        if deck[D.act] > U0 and i == U0:
            call(deck[D.act], deck[D.block], at, n, deck[D.io], b * UW)
        if deck[D.flags] & F_LATE:
            pass_on_all(block, at, n, deck)
        supervise_all(block, at, n, tick)
        if deck[D.sent] > U0:
            call(deck[D.sent], deck[D.block], at, n, deck[D.sent_io], tick)
        travel_all(block, at, n, tick, deck)
        prepare_all(block, at, n, tick)
        if deck[D.flags] & F_LATE:
            delay_all(block, at, n, deck)
        for k in range(0, SUBSTEPS, _AT_ONCE):
            move_all(block, at, n, k, has_bristles(deck))
        sense_and_control(block, at, n, tick, keys, b * UW, deck)
        if deck[D.record] > U0 and tick - deck[D.record_tick] < deck[D.record_steps]:
            place = (tick - deck[D.record_tick]) * _CHANNELS * machines + b * UW
            record_all(block, at, n, tick, record, place, machines)
        if deck[D.finish] > U0:
            call(deck[D.finish], deck[D.block], at, n, deck[D.gantry], tick)
        if deck[D.pilot] > U0:
            call(deck[D.pilot], deck[D.block], at, n, deck[D.pilot_io], b * UW)
        if deck[D.observe] > U0 and i + U1 == steps:
            call(deck[D.observe], deck[D.block], at, n, deck[D.io], b * UW)
        tick += U1


def _advance(deck_address):
    """Some control periods of all machines, as the deck says; its tick moves on by the periods.

    Args:
        deck_address: of the words of a deck of :class:`Entries`, see :class:`fleet.Fleet`.
    """
    deck = words(deck_address, DECK)
    for b in range((deck[D.machines] + UW - U1) // UW):
        live_all(deck, b)
    deck[D.tick] += deck[D.steps]


def _share(deck_address):
    """The same for several threads at once: each takes the next block until none is left. The tick stays as it is."""
    deck = words(deck_address, DECK)
    blocks = (deck[D.machines] + UW - U1) // UW
    b = take(deck, D.next)
    while b < blocks:
        live_all(deck, b)
        b = take(deck, D.next)


def _begin(deck_address, machine, key):
    """Starts an episode on one machine whose parameters lie in its column; the others are left alone.

    The head stands at the starting gap over the sheet; the sheet ahead is known, the filter is filled with one reading,
    and the law has seen its first signals. ``key`` is the episode's random stream.
    """
    deck = words(deck_address, DECK)
    b, lane = machine // UW, machine % UW
    blocks = (deck[D.machines] + UW - U1) // UW
    block = doubles(deck[D.block], blocks * STRIDE)
    keys = words(deck[D.keys], blocks * UW)
    at = b * STRIDE + lane
    tick = deck[D.tick] - U1  # the period before the first
    # Counting on from the block's tick must give the stream that a machine alone would get from tick 0.
    keys[machine] = key - (tick + U1) * _WORDS * GOLD
    start, feed = load(Start, block, at + START), path.feed_at(load(path.Params, block, at + P_PATH), 0.0)
    if deck[D.start] > U0:
        call(deck[D.start], deck[D.block], at, U1, deck[D.gantry], tick)

    growth = load(sheet.Params, block, at + P_SHEET).bulge_growth  # the prefill's first step grows it to 0 at time 0
    first = load(sheet.Feature, block, at + FEATURES)
    store(block, at + S_SHEET, sheet.State(growth / (growth - 1.0), 0.0, 1.0, first))
    store(block, at + S_SENSOR, _UNSENSED)
    follows = load(supervisor.Orders, block, at + JOB).request == supervisor.FOLLOW
    mode = supervisor.FOLLOW if follows else supervisor.STOP
    store(block, at + S_GUARD, _UNGUARDED._replace(mode=mode, offset=start.coast))
    store(block, at + DRIVE, _STILL)
    if deck[D.flags] & F_LATE:
        store(doubles(deck[D.late], U(2**40)), _late_of(at), _NOTHING_LATE)
    block[at + BEAM] = 1.0
    store(block, at + S_PATH, path.State(-PERIOD, -PERIOD * feed, 0.0, 0.0, 0.0, 0.0, feed, -PERIOD * feed))
    store(block, at + ON, _ALL_ON)
    for i in range(SURFACES_LAST + U1):
        block[at + FELT + i * UW] = 0.0
    for i in range(sheet.VIBRATIONS):
        v = load(sheet.Vibration, block, at + VIBRATIONS + U(i) * _VIBRATION)
        store(block, at + SHAKEN + U(i) * _SHAKEN, sheet.shaken(v))
    for i in range(_PREFILL):
        travel_all(block, at, U1, tick + U1 - U(_PREFILL) + U(i), deck)
    surface = block[at + _surface(tick, U0)]
    head = surface + start.gap
    store(block, at + S_Z, z_axis.at_rest(head))
    gains = z_axis.gains(load(z_axis.Params, block, at + P_Z), DT)
    store(block, at + GAINS, gains)
    if gains.spring > 0.0:
        deck[D.flags] |= F_BRISTLES
    felt = block[at + _UNDER + _surface(tick, U0)]
    store(block, at + COURSE, Course(surface, 0.0, 0.0, 0.75, 0.2, 1.0, felt, False, True))
    store(block, at + MOMENT, Moment(start.gap, head, start.gap, head, start.gap))
    store(block, at + TALLY, Tally(-1.0, False, 1e9, z_axis.encoded(load(z_axis.Params, block, at + P_Z), head)))

    # One reading of the head at rest; the ring and the recursive filters start from it.
    sense_all(block, at, U1, tick, keys, machine)
    if deck[D.signals] > U0:
        replay_all(block, at, U1, tick, deck)
    reading = block[at + SAMPLES + (tick & SAMPLES_LAST) * UW]
    for i in range(SAMPLES_LAST + U1):
        block[at + SAMPLES + i * UW] = reading
    store(block, at + S_FILTER, filters.State(reading, 1e6, 0.0, 0.0))
    block[at + HINT], block[at + RAW_HINT] = 0.0, 0.0
    block[at + SLOPE] = 1e9  # nothing is a jump before the first reading
    filter_all(block, at, U1, tick, deck[D.window], deck[D.flags] & F_RANKS)
    if deck[D.filtered] > U0:
        call(deck[D.filtered], deck[D.block], at, U1, deck[D.filtered_io], tick)
    look_up_all(block, at, U1, tick, deck)
    report_all(block, at, U1, tick)
    block[at + _FRESH] = 1.0
    for i in range(HISTORY_LAST + U1):
        block[at + HEIGHTS + i * UW] = block[at + _HEIGHT]
        block[at + RAW_HEIGHTS + i * UW] = block[at + _RAW_HEIGHT]
        block[at + POSITIONS + i * UW] = block[at + POSITIONS + (tick & HISTORY_LAST) * UW]
        block[at + COMMANDS + i * UW] = 0.0
    block[at + ORIGIN] = block[at + _HEAD_POSITION]
    store(block, at + HAND, Hand(1.0, 0.0))
    call(deck[D.law], deck[D.block], at, U1, deck[D.law_tables], deck[D.law_size])
    if deck[D.ready] > U0:
        call(deck[D.ready], deck[D.block], at, U1, deck[D.gantry], tick)
    if deck[D.pilot] > U0:
        call(deck[D.pilot], deck[D.block], at, U1, deck[D.pilot_io], machine)
    if deck[D.observe] > U0:
        call(deck[D.observe], deck[D.block], at, U1, deck[D.io], machine)


advance = Kernel(_advance)
share = Kernel(_share).together_with(advance)
begin = Kernel(_begin).together_with(advance)
