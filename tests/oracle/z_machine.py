"""The height-following machine in plain NumPy, one array element per machine: an oracle for the compiled kernel.

It is written from the equations, which each method states or cites, and shares no function with the kernel: its own
random words, library sines and logarithms, ``np.interp`` for the table, sums over all features of a sheet, closed forms
where the kernel keeps a state. What it must share, because it is part of the contract, is the numerical scheme:

- a control period of 1 ms is 20 substeps; the surface runs through its heights at the start, the middle and the end of
  the period on a parabola;
- the drive's loop goes from substep to substep by its exact solution under a held command, and the structural mode has
  the exact poles, both to second order in (natural frequency × substep); velocity and position are trapezoidal sums;
- friction's bristles are implicit in their own deflection, with the motor's speed in the middle of the substep;
- the feed is constant within a period; bands of vibration go on by half periods, speed first;
- the words of the random streams (:func:`word`) and what each of them is for (:meth:`ZMachine._count`,
  :meth:`ZMachine._shake`), and the samples of the random sheets' tables.

It follows, approaches and holds over holes. Contact, the limits of the travel and other alarms end what it knows; such
machines are marked in ``lost``.
"""

from collections import deque
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy import linalg

from kerfgym.envs.engine.lanes import fields
from kerfgym.envs.plant import machine, sheet, supervisor
from kerfgym.envs.plant.calibration import Pool
from kerfgym.envs.plant.filters import IMPROVED, KINDS, MEAN, NONE
from kerfgym.envs.plant.fleet import Fleet

Array = np.ndarray

PERIOD = 1e-3  # s (Xi2023)
SUBSTEPS = 20
DT = PERIOD / SUBSTEPS
GRAVITY = 9810.0  # mm/s²
EPSILON0 = 8.8541878128e-3  # pF/mm
CLOCK = 300e6  # Hz (CN102528288A)
LEAST_GAP = 0.005  # mm, least apparent gap under an impulse
FOOTPRINT = 2.0  # mm, radius of the nozzle's footprint (docs/physics.md#footprints)
AHEAD = 5  # ms by which the sheet is known ahead: the period T draws from the words of the period T − 5
BAND = 0x5EED5EED5EED5EED  # vibration i has the stream key + (i + 1)·BAND
FADE = 1.0  # s, end of a turn in which the next one fades in
BEND = 300.0  # mm before and after a turn of the slope in which it turns
TABLE_SPACING = 0.25  # mm between the samples of the random sheets' tables
WIDEST = 12.0  # mm, widest disc on which an edge is felt
LEAST_OVER_VOID = 0.1  # mm; with nothing under the nozzle no gap is smaller, nor is there contact
SUDDEN = 20.0  # times the rise that trips the guard: what no sheet does
WINDOW, MEMORY = 5, 15  # ms: the hole guard compares with the sheet then, a hold goes back to the head's place then
BRAKING, MARGIN, TOP = 0.8, 3.0, 0.9  # of the barriers before the ends of the travel and before the top speed

CHANNELS = (
    "gap", "height", "raw_height", "frequency", "surface", "head", "position", "velocity", "acceleration", "play",
    "encoder", "encoder_velocity", "command", "holding", "override", "captured", "scored", "lowest",
)  # fmt: skip
"""What :meth:`ZMachine.run` keeps of each period: true gap, reported height, raw height, mm; newest count, Hz; surface,
head, motor, mm; motor's velocity and acceleration, mm/s, mm/s²; head above its lower flank, mm; encoder, mm, mm/s;
command, mm/s; the supervisor's flags; whether the period counts as cutting; smallest gap so far, mm."""

GROUPS = ("path", "sheet", "random", "turns", "sensor", "gate", "filter", "table", "z", "guard", "job", "start")


# ----------------------------------------------------------------------------------------------- random numbers


def word(keys: Array, n: int) -> Array:
    """Output ``n`` of splitmix64 (Steele et al. 2014) for each of ``keys``, 64 bits; output 0 is the mixed key."""
    z = keys + np.uint64(n * 0x9E3779B97F4A7C15 % 2**64)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def uniform(bits: Array) -> Array:
    """The upper 53 bits as a number in [0, 1)."""
    return (bits >> np.uint64(11)).astype(float) / 2.0**53


def normal(bits: Array, fill: Array) -> Array:
    """The ones among 64 bits (mean 32, variance 16), spread over ±½ by a uniform ``fill``, at variance 1."""
    return (np.bitwise_count(bits).astype(float) - 32.0 + (fill - 0.5)) / np.sqrt(16.0 + 1.0 / 12.0)


def clip(x: Array, low: Any, high: Any) -> Array:
    """``x`` limited to [low, high]; quicker than NumPy's for short arrays."""
    return np.minimum(np.maximum(x, low), high)


def behind(u: Array) -> Array:
    """Share of a hemisphere that lies behind a line ``u`` radii behind its centre: ∫ ¾(1 − u²) du from −1."""
    v = clip(u, -1.0, 1.0)
    return (2.0 + 3.0 * v - v * v * v) / 4.0


class ZMachine:
    """N machines; every number is an array of shape (N,), and :meth:`step` is one control period of all of them.

    Args:
        parts: numbers of each of :data:`GROUPS`, by the names of the kernel's ``Params``.
        waves: amplitude as the tip's footprint feels it, kx, ky, phase, what the plate's footprint feels more than the
            tip's of each; mm, rad/mm, rad; shape (waves, 5, N).
        vibrations: amplitude, ω, phase, damping of each; mm, rad/s, rad; shape (vibrations, 4, N).
        features: start, stop, rise, width of the void of each, mm along the path; shape (features, 4, N).
        law: ``"xi2023"`` or ``"pid"``; ``gains``: its parameters.
        tables: (machines, frequencies, heights) of each calibrated head: indices, Hz, mm.
        keys: random stream of each machine, uint64.
        randoms: (machines, tables) of each random sheet: indices, and heights under tip and plate of its two periodic
            profiles, mm, in the order tip 1, plate 1, tip 2, plate 2.

    Raises:
        NotImplementedError: a filter, law, path or job that this model does not know.
    """

    def __init__(
        self,
        parts: dict[str, Any],
        waves: Array,
        vibrations: Array,
        features: Array,
        law: str,
        gains: Any,
        tables: Sequence[tuple[Array, Array, Array]],
        keys: Array,
        randoms: Sequence[tuple[Array, Sequence[Array]]] = (),
    ) -> None:
        self.path, self.sheet, self.sensor, self.gate = (parts[n] for n in ("path", "sheet", "sensor", "gate"))
        self.filter, self.table, self.z, self.guard = (parts[n] for n in ("filter", "table", "z", "guard"))
        self.job, self.start, self.gains = parts["job"], parts["start"], gains
        self.waves, self.vibrations, self.features = waves, vibrations, features
        self.tables, self.keys, self.randoms = tables, keys, randoms
        self.random, self.turns = parts["random"], parts["turns"]
        laws: dict[str, Callable[[], Array]] = {"xi2023": self._proportional, "pid": self._pid}
        unknown = [KINDS[int(k)] for k in np.unique(self.filter.kind) if k not in (NONE, MEAN, IMPROVED)]
        for missing, what in (
            (law not in laws, f"the law {law}"),
            (bool(unknown), f"the filter {', '.join(unknown)}"),
            (np.any(self.path.contour >= 0) or np.any(self.path.profile >= 0), "a path along contours or profiles"),
            (np.any(self.job.request != supervisor.FOLLOW), "a job other than following"),
            (np.any(self.start.coast != 0), "a machine that is not homed"),
            (np.any(self.guard.alarm_error > 0), "the alarm of a lasting following error"),
        ):
            if missing:
                raise NotImplementedError(f"the oracle does not know {what}")
        self.law = laws[law]

        # Loop and mode over one substep, see `_move`. x: natural frequency × substep.
        x, ζ = self.z.omega * DT, self.z.zeta
        self.pull, self.brake = self.z.omega * x * (1.0 - ζ * x), 2.0 * ζ * x - (2.0 * ζ**2 - 0.5) * x**2
        x, ζ = self.z.omega_r * DT, self.z.zeta_r
        self.spring, self.damper = self.z.omega_r * x * (1.0 - ζ * x), 2.0 * ζ * x * (1.0 - ζ * x)
        lag = 2.0 * self.z.zeta / self.z.omega + self.z.acceleration / self.z.jerk
        self.braking = self.z.speed / (BRAKING * self.z.acceleration) + MARGIN * lag  # s, from top speed
        self.easing = TOP * self.z.jerk / self.z.acceleration  # 1/s, acceleration per speed left to the top
        self.whole = np.floor(self.z.dead_time).astype(int)
        self.counted = np.maximum(1.0, np.rint(self.gate.length * 1e-3 / DT))  # substeps within the gate
        self._begin()

    @classmethod
    def like(cls, fleet: Fleet, keys: Array, tables: Pool) -> "ZMachine":
        """The machines of a prepared fleet before their episode: their numbers, with the streams ``keys``.

        Args:
            keys: uint64, shape (size,), as given to ``Fleet.begin``.
            tables: calibration tables of the fleet's heads.
        """
        parts = {
            name: SimpleNamespace(**{f: fleet.column(f"{name}.{f}") for f in fields(machine.PLACES[name][1])})
            for name in GROUPS
        }

        def listed(place: Any, count: int, width: int) -> Array:
            rows = [fleet.slots(place, count * width, i).reshape(count, width) for i in range(fleet.size)]
            return np.stack(rows, axis=-1).copy()

        waves, vibrations = listed(machine.WAVES, 8, 5), listed(machine.VIBRATIONS, 3, 4)
        features = listed(machine.FEATURES, 16, 4)
        features = features[np.any(features[:, 2:] != 0.0, axis=(1, 2))]  # neither rise nor void: no feature
        names = fleet.law.Params._fields
        gains = SimpleNamespace(**dict(zip(names, listed(machine.P_LAW, len(names), 1)[:, 0], strict=True)))
        heads = parts["start"].head.astype(int)
        of_heads = [(np.flatnonzero(heads == h), tables[h].frequency, tables[h].height) for h in np.unique(heads)]
        law = fleet.law.name.rpartition(".")[2]
        sizes = np.cumsum([sheet.RANDOM_ONE + 1, sheet.RANDOM_ONE + 1, sheet.RANDOM_TWO + 1])
        randoms = [
            (np.flatnonzero(parts["random"].first == first), np.split(table, sizes))
            for table, first in fleet._randoms.values()
        ]
        return cls(parts, waves, vibrations, features, law, gains, of_heads, np.asarray(keys, np.uint64), randoms)

    def _begin(self) -> None:
        """At rest over the sheet; one reading, which fills the filter; the law's first command."""
        zero, no = np.zeros(len(self.keys)), np.zeros(len(self.keys), bool)
        self.tick = -1
        self.lost, self.holding, self.override, self.foreign, self.captured, self.fresh = no, no, no, no, no, ~no
        self.refuge = self.held = self.command = self.apart = zero
        self.commands = deque([zero] * 24, 24)  # newest first
        self.ways = [zero]  # mm along the path at each ms
        amplitude, omega, phase, _ = self.vibrations.swapaxes(0, 1)
        self.shaken = [(amplitude * np.sin(phase), amplitude * omega * np.cos(phase))]  # each half ms from −1 ms on
        self.force = self._force()
        self.surface = self.surface_at(0.0)
        self.gap, self.head = self.start.gap + zero, self.surface + self.start.gap
        self.position = self.mode = self.head
        self.velocity = self.acceleration = self.friction = self.play = self.falling = self.mode_velocity = zero
        self.bent = zero
        self.remaining = self.hit = self.burst = zero
        self.lowest, self.scored = self.gap, ~no
        self._count(np.maximum(self.gap - self.surface_at(0.0, plate=True) + self.surface, 1e-6), np.ones_like(zero))
        self.samples = deque([self.frequency] * int(self.filter.window.max()), int(self.filter.window.max()))
        self._filter()
        self.encoder, self.encoder_velocity = self._encoded(self.position), zero
        self.positions = deque([self.encoder] * (MEMORY + 1), MEMORY + 1)  # oldest first
        self.heights = deque([self.height] * (WINDOW + 1), WINDOW + 1)
        self.integral = self.slope = self.error = zero
        self.wish = self.law()
        self.fresh = no

    # ------------------------------------------------------------------------------------------------- running

    def step(self) -> None:
        """One control period: supervise, move, sense, filter, look up, control."""
        self.tick += 1
        self._supervise()
        self._move()
        self._sense()
        self._filter()
        self.encoder = self._encoded(self.gate_position)
        self.encoder_velocity = (self.encoder - self.positions[-1]) / PERIOD
        self.positions.append(self.encoder)
        self.heights.append(self.height)
        self.wish = self.law()

    def run(self, periods: int) -> dict[str, Array]:
        """:data:`CHANNELS` of the next periods, each of shape (periods, N)."""
        kept: dict[str, list[Array]] = {name: [] for name in CHANNELS}
        for _ in range(periods):
            self.step()
            for name, values in kept.items():
                values.append(getattr(self, name))
        return {name: np.array(values) for name, values in kept.items()}

    # -------------------------------------------------------------------------------------------- path and sheet

    def way(self, periods: float) -> Array:
        """Distance along the path ``periods`` ms after the start, mm; within a period the feed is constant.

        Beside a corner the feed is what the acceleration lets reach or leave it: v² = v_corner² + 2·a·|distance|.
        Corner n lies at (n + 0.2 + 0.6·frac(phase + n·(√5 − 1)/2)) times the pitch.
        """
        p = self.path
        straight = p.corner <= 0.0
        if straight.all():
            return p.feed * (periods * PERIOD)
        while len(self.ways) <= periods + 1:
            s, pitch = self.ways[-1], np.where(straight, 1.0, p.corner)
            n = np.floor(s / pitch) + np.arange(-2, 3)[:, None]
            corners = pitch * (n + 0.2 + 0.6 * np.mod(p.corner_phase + n * (np.sqrt(5.0) - 1.0) / 2.0, 1.0))
            off = np.abs(s - corners).min(axis=0)
            slow = np.minimum(p.feed, np.sqrt(p.corner_feed**2 + 2.0 * p.corner_acceleration * off))
            self.ways.append(s + np.where(straight, p.feed, slow) * PERIOD)
        low = int(np.floor(periods))
        between = self.ways[low] + (periods - low) * (self.ways[low + 1] - self.ways[low])
        return np.where(straight, p.feed * (periods * PERIOD), between)

    def on(self, mask: Array, periods: float) -> Array:
        """How much of what has this ``mask`` is on: bit by bit, a turn each, with a smooth step in the last second."""
        p, t = self.turns, max(periods, 0.0) * PERIOD
        length = np.where(p.length > 0.0, p.length, 1.0)
        turn = np.floor(t / length)
        bits = [mask.astype(np.int64) >> np.mod(turn + i, p.many).astype(np.int64) & 1 for i in (0, 1)]
        u = clip((t - turn * length - (length - FADE)) / FADE, 0.0, 1.0)
        return np.where(p.length > 0.0, bits[0] + (bits[1] - bits[0]) * (3.0 * u**2 - 2.0 * u**3), 1.0)

    def _force(self) -> Array:
        """mm/s by which noise of variance 1 changes a band's speed in half a period, shape (vibrations, N).

        Such that its height has the variance amplitude²/2 in the long run: by the discrete Lyapunov equation.
        """
        amplitude, omega, _, zeta = self.vibrations.swapaxes(0, 1)
        out, dt = np.zeros(amplitude.shape), PERIOD / 2.0
        for i in np.ndindex(out.shape):
            if zeta[i] > 0.0:
                speed = np.array([-(omega[i] ** 2) * dt, 1.0 - 2.0 * zeta[i] * omega[i] * dt])
                along = np.array([1.0, 0.0]) + dt * speed
                unit = np.outer([dt, 1.0], [dt, 1.0])
                variance = linalg.solve_discrete_lyapunov(np.array([along, speed]), unit)[0, 0]
                out[i] = amplitude[i] * np.sqrt(0.5 / variance)
        return out

    def _shake(self, halves: int) -> Array:
        """Heights of the bands ``halves`` half periods after −1 ms, mm: v' = −2ζω·v − ω²·x + noise, then x' = v.

        The period T takes the words 6·(T − 5) to 6·(T − 5) + 3 of the vibration's stream: two for the noise of its
        first half (see :func:`normal`), two for that of its second.
        """
        _, omega, _, zeta = self.vibrations.swapaxes(0, 1)
        dt = PERIOD / 2.0
        while len(self.shaken) <= halves:
            done = len(self.shaken) - 1
            first = 6 * (done // 2 - 1 - AHEAD) + 2 * (done % 2)
            x, v = self.shaken[-1]
            noise = np.zeros(x.shape)
            for i in range(len(noise)):
                keys = self.keys + np.uint64((i + 1) * BAND % 2**64)
                noise[i] = normal(word(keys, first), uniform(word(keys, first + 1)))
            v = v - dt * (2.0 * zeta * omega * v + omega**2 * x) + self.force * noise
            self.shaken.append((x + dt * v, v))
        return self.shaken[halves][0]

    def _random(self, s: Array, plate: bool) -> Array:
        """Height of the random sheets, mm: two periodic tables, linear between their samples, each begun elsewhere."""
        out, p = np.zeros(len(self.keys)), self.random
        for machines, tables in self.randoms:
            for weight, begin, table in (
                (p.one, p.begin_one, tables[int(plate)]),
                (p.two, p.begin_two, tables[2 + int(plate)]),
            ):
                at = np.mod((s[machines] + begin[machines]) / TABLE_SPACING, len(table) - 1)
                i = at.astype(int)
                out[machines] += weight[machines] * (table[i] * (i + 1 - at) + table[i + 1] * (at - i))
        return out

    def surface_at(self, periods: float, plate: bool = False) -> Array:
        """Height of the sheet under the nozzle's tip or under the sensor's plate ``periods`` ms after the start, mm.

        z = tilt·x + Σ A sin(k·x + φ) + Σ A sin(ωt + φ) + bands + random + bulge + Σ rise·(share behind start − share
        behind stop); the nozzle travels along x. Plate and tip have footprints of their own. The bulge is a raised
        cosine, half as high at half its width; it grows exponentially, and linearly within a period. The slope goes to
        and fro over the sheet's length, on parabolas where it turns. What has turns changes at the start of a period.
        """
        p, t, way = self.sheet, periods * PERIOD, self.way(periods)
        amplitude, kx, _, phase, felt = self.waves.swapaxes(0, 1)
        shake, omega, beat, zeta = self.vibrations.swapaxes(0, 1)
        begin, end, rise, _ = self.features.swapaxes(0, 1)
        radius = p.plate if plate else FOOTPRINT
        period = np.ceil(periods) - 1.0
        along = p.length - np.abs(p.length - np.mod(way, 2.0 * p.length))
        late, early = (np.maximum(BEND - off, 0.0) ** 2 / (2.0 * BEND) for off in (p.length - along, along))
        z = p.tilt_x * (along - late + np.where(way > BEND, early, 0.0))
        waves = ((amplitude + felt * plate) * np.sin(kx * way + phase)).sum(axis=0)
        z = z + self.on(self.turns.waves, period) * waves
        tones = np.where(zeta > 0.0, self._shake(round(2 * periods) + 2), shake * np.sin(omega * t + beat)).sum(axis=0)
        z = z + self.on(self.turns.vibrations, period) * tones
        z = z + self.on(self.turns.random, period) * self._random(way, plate)
        z = z + (rise * (behind((way - begin) / radius) - behind((way - end) / radius))).sum(axis=0)
        to_grow = 0.5 * sum((1.0 - p.bulge_growth) ** n for n in (np.floor(periods), np.ceil(periods)))
        u = np.minimum(np.hypot(way - p.bulge_x, p.bulge_y) / p.bulge_width, 1.0)
        return z + p.bulge * (1.0 - to_grow) * 0.5 * (1.0 + np.cos(np.pi * u))

    def coverage(self, x: Array, gap: Array) -> Array:
        """Share of the sensor's plate over sheet: it feels edges on a disc of radius R + 1.5·h; a void
        narrower than the disc takes away in proportion to its width."""
        radius = np.minimum(self.sensor.radius + 1.5 * np.maximum(gap, 0.0), WIDEST)
        begin, end, _, across = self.features.swapaxes(0, 1)
        lost = behind((x - begin) / radius) - behind((x - end) / radius)
        return 1.0 - (lost * np.minimum(1.0, across / (2.0 * radius))).sum(axis=0)

    def over_void(self, x: Array, reach: float) -> Array:
        """Whether everything within ``reach`` (mm) along the path is void."""
        begin, end, _, across = self.features.swapaxes(0, 1)
        return ((across > 0.0) & (x - reach > begin) & (x + reach < end)).any(axis=0)

    # ------------------------------------------------------------------------------------------------- supervisor

    def _planned(self, distance: Array) -> Array:
        """Speed v from which a distance suffices to stop: v²/(2a) + v·delay = |distance|, mm/s."""
        a, delay = self.guard.plan * self.guard.acceleration, self.guard.delay * 1e-3
        v = np.sqrt((a * delay) ** 2 + 2.0 * a * np.abs(distance)) - a * delay
        return np.sign(distance) * np.minimum(v, self.guard.fastest)

    def _supervise(self) -> None:
        """Approach, hole guard, bumpless handover (docs/physics.md#approach-and-holes); then D/A and dead time."""
        g, e = self.guard, self.height - self.job.set_height
        sheet_before = self.positions[-1 - WINDOW] - self.heights[-1 - WINDOW]
        fall = sheet_before - (self.encoder - self.height)
        holding = self.holding
        sudden = np.minimum(fall, e) > SUDDEN * g.rise
        guarded = (self.job.hole_guard > 0.0) & (fall > g.rise) & (e > g.error)
        trips = ~holding & self.captured & (sudden | guarded)
        released = holding & (e < g.release)
        expired = holding & ~released & (self.held >= g.timeout)
        self.refuge = np.where(trips, self.positions[0], self.refuge)
        self.captured = np.where(holding, ~expired, self.captured | (e < g.capture))
        self.holding = trips | (holding & ~released & ~expired)
        self.held = np.where(holding, self.held + 1.0, 0.0)

        back = self._planned(self.refuge - self.encoder)
        slow = np.maximum(self.wish, self._planned(-np.maximum(e, 0.0)))
        u = np.where(self.captured, self.wish, slow)
        u = np.where(self.holding | expired, back, u)

        # What the supervisor commands above the law's wish dies away by the slew when the law takes over; towards the
        # sheet its own command changes by no more than the slew, away from it at once.
        passes = ~self.holding & (u == self.wish)
        differs = np.where(self.foreign, self.command - u, self.apart)
        left = np.where(differs > g.slew, differs - g.slew, 0.0)
        faded = np.where(u + left > np.maximum(u, self.command), np.maximum(u, self.command), u + left)
        self.apart = faded - u
        command = np.where(passes, faded, np.maximum(u, self.command - g.slew))
        self.foreign = ~passes
        self.override = ~passes | (self.apart != 0.0)
        self.command = command
        self.lost = self.lost | ((self.encoder < self.job.low) & (u < 0.0))
        self.lost = self.lost | ((self.encoder > self.job.high) & (u > 0.0))

        sent = clip(command, -self.z.speed, self.z.speed)
        steps = np.where(self.z.dac > 0.0, self.z.dac, 1.0)
        self.commands.appendleft(np.where(self.z.dac > 0.0, np.rint(sent / steps) * steps, sent))

    # ----------------------------------------------------------------------------------------------------- Z axis

    def _move(self) -> None:
        """Twenty substeps of the axis (docs/physics.md#the-z-axis), and what the gate sees of them.

        Loop: a' = j − F' with j = ω²(u − v) − 2ζω·a within the drive's limits. F is LuGre's friction, σ·b with
        b' = v − σ|v|·b/g(v), σ = Coulomb/bristle and g(v) = Coulomb·(1 + (stiction − 1)/(1 + (v/stribeck)²)); without
        bristles it is Coulomb friction, proportional to v within ``creep`` of rest, and inside the limits. Over a
        substep, with x = ω·dt:
        a⁺ = a + ω·x·(1 − ζx)·(u − v) − (2ζx − (2ζ² − ½)x²)·a − ΔF.

        Mode: m'' = ωr²(carried − m) − 2ζr·ωr·m'. Stepping m' first, then m with the new m', has exact poles if their
        product is exp(−2ζx) = 1 − 2ζx(1 − ζx) + … and their sum 2·exp(−ζx)·cos(x·sqrt(1 − ζ²)) = 1 + product −
        x²(1 − ζx) + …

        Backlash: the head may rise off the motor's lower flank; over it, it accelerates by −(a + g).
        """
        z = self.z
        newest_first = np.array(self.commands)
        lane = np.arange(len(self.keys))
        after, before = newest_first[self.whole, lane], newest_first[self.whole + 1, lane]
        late = z.dead_time - self.whole
        begin, middle, end = self.surface, self.surface_at(self.tick + 0.5), self.surface_at(self.tick + 1.0)
        under = [self.surface_at(self.tick + q, plate=True) for q in (0.0, 0.5, 1.0)]  # the plate
        cover = self.coverage(self.way(self.tick + 1.0), self.gap)
        gate_gap = gate_position = np.zeros(lane.shape)
        lowest = np.full(lane.shape, np.inf)
        for k in range(1, SUBSTEPS + 1):
            q = k / SUBSTEPS
            u = np.where(q <= late + 1e-9, before, after)
            u = clip(u, (z.low - self.position) / self.braking, (z.high - self.position) / self.braking)

            friction = clip(self.velocity / z.creep, -1.0, 1.0) * z.friction
            speed = self.velocity + self.acceleration * DT / 2.0
            most = z.friction * (1.0 + (z.stiction - 1.0) / (1.0 + (speed / z.stribeck) ** 2))
            stiffness = z.friction / np.where(z.bristle > 0.0, z.bristle, 1.0)
            sliding = np.abs(speed) * DT * stiffness / np.where(most > 0.0, most, 1.0)
            self.bent = (self.bent + speed * DT) / (1.0 + sliding)
            friction = np.where(z.bristle > 0.0, stiffness * self.bent, friction)
            # Bristles pull past the drive's limits; friction without bristles is inside them.
            released = np.where(z.bristle > 0.0, self.friction - friction, 0.0)
            pushed = self.pull * (u - self.velocity) - self.brake * self.acceleration
            pushed = pushed + (self.friction - friction) - released
            most = np.minimum(z.acceleration, self.easing * (z.speed - self.velocity))
            least = np.maximum(-z.acceleration, -self.easing * (z.speed + self.velocity))
            change = clip(self.acceleration + pushed, least, most) - self.acceleration
            acceleration = self.acceleration + clip(change, -z.jerk * DT, z.jerk * DT) + released
            velocity = self.velocity + (self.acceleration + acceleration) * DT / 2.0
            position = self.position + (self.velocity + velocity) * DT / 2.0

            # The mode is pulled by where the substep began.
            self.mode_velocity = (
                self.mode_velocity
                + self.spring * (self.position + self.play - self.mode)
                - self.damper * self.mode_velocity
            )
            self.mode = self.mode + self.mode_velocity * DT

            falling = self.falling - (acceleration + GRAVITY) * DT
            self.play = clip(self.play + falling * DT, 0.0, z.backlash)
            self.falling = np.where((self.play > 0.0) & (self.play < z.backlash), falling, 0.0)
            self.position, self.velocity, self.acceleration = position, velocity, acceleration
            self.friction = friction
            self.head = (1.0 - z.compliance) * (position + self.play) + z.compliance * self.mode

            self.surface = begin * (1 - q) * (1 - 2 * q) + middle * 4 * q * (1 - q) + end * q * (2 * q - 1)
            self.gap = self.head - self.surface
            lowest = np.minimum(lowest, self.gap)
            inside = k > SUBSTEPS - self.counted  # the gate closes with the period
            felt = under[0] * (1 - q) * (1 - 2 * q) + under[1] * 4 * q * (1 - q) + under[2] * q * (2 * q - 1)
            gate_gap = gate_gap + np.where(inside, self.head - felt, 0.0)
            gate_position = gate_position + np.where(inside, self.position, 0.0)
        self.gate_gap, self.gate_position = gate_gap / self.counted, gate_position / self.counted
        self.cover, self.lowest_now = cover, lowest

    def _encoded(self, position: Array) -> Array:
        """What the encoder counts of a position, mm."""
        counts = np.where(self.z.encoder > 0.0, self.z.encoder, 1.0)
        return np.where(self.z.encoder > 0.0, np.rint(position / counts) * counts, position)

    # ------------------------------------------------------------------------------------------------------ sensor

    def _sense(self) -> None:
        """Contact or a count at the mean gap within the gate, into the queue of samples."""
        x = self.way(self.tick + 1.0)
        void = self.over_void(x, FOOTPRINT)
        self.scored = ~self.over_void(x, 0.0)
        self.lost = self.lost | ((self.lowest_now <= 0.0) & ~void)
        self.lowest = np.where(void, self.lowest, np.minimum(self.lowest, self.lowest_now))
        self._count(np.maximum(self.gate_gap, np.where(void, LEAST_OVER_VOID, 1e-6)), self.cover)
        self.samples.appendleft(self.frequency)

    def _count(self, gap: Array, cover: Array) -> None:
        """One sample: disturbances, capacitance, oscillator, counter (Xi2023 eqs. 1 and 3, CN102528288A).

        C5 = Cp + cover·[ε0·π(R² − rb²)/h + 2ε0·R·max(0, ln(8πR/h) − 1)], 1/Cs = 1/C5 + series,
        f = 1/(2π·sqrt(L·Cs)). The disturbed f is timed over whole oscillator periods with a clock of 300 MHz.

        A sample takes six words of the stream, sample n the words 6n to 6n + 5, and hashes some of them again
        (:func:`word` with the word as its key): 0 capacitance noise (again 1: phase of the clock, which also fills the
        bits of the jitter), 1 jitter (1: fills the bits of the noise), 2 does an impulse start, 3 its height (1: its
        sign), 4 its length, 5 does a burst end (1: height of the next, 2: does it start).
        """
        p = self.sensor
        w = [word(self.keys, 6 * self.tick + i) for i in range(6)]
        phase, fill = uniform(word(w[0], 1)), uniform(word(w[1], 1))

        starts = (uniform(w[2]) < p.impulses * self.on(self.turns.impulses, self.tick + AHEAD)) & (
            self.remaining <= 0.0
        )
        sign = np.where(uniform(word(w[3], 1)) < 0.5, 1.0, -1.0)
        self.hit = np.where(starts, sign * (1.0 - p.spread + 2.0 * p.spread * uniform(w[3])), self.hit)
        self.remaining = np.where(starts, 1.0 + np.floor(p.longest * uniform(w[4])), self.remaining)
        impulse = np.where(self.remaining > 0.0, self.hit * p.impulse / (1.0 + gap / p.falloff), 0.0)
        self.remaining = self.remaining - 1.0

        self.burst = np.where(uniform(w[5]) < p.burst_end, 0.0, self.burst)
        self.burst = np.where(uniform(word(w[5], 2)) < p.bursts, p.burst * uniform(word(w[5], 1)), self.burst)
        warm = 1.0 - (1.0 - p.warming) ** (self.tick + 2)  # samples so far, the one before the first period included

        h = np.maximum(gap + impulse, LEAST_GAP)
        plate = EPSILON0 * np.pi * (p.radius**2 - p.bore**2) / h
        fringe = 2.0 * EPSILON0 * p.radius * np.maximum(0.0, np.log(8.0 * np.pi * p.radius / h) - 1.0)
        c5 = p.body + cover * (plate + fringe) + p.plasma + self.burst + p.noise * normal(w[0], fill)
        cs = 1.0 / (1.0 / c5 + p.series)
        f = 1.0 / (2.0 * np.pi * np.sqrt(p.inductance * 1e-6 * cs * 1e-12 * (1.0 + p.drift * warm)))
        f = f * (1.0 + p.jitter * normal(w[1], phase))

        periods = np.maximum(1.0, np.floor(self.gate.length * 1e-3 * f))
        ticks = np.floor(periods * CLOCK / f + phase)
        # Period by period: each takes the whole number of ticks below or above ticks/periods, so many of them above.
        below = np.floor(ticks / periods)
        above = ticks - periods * below
        mean = (CLOCK / below * (periods - above) + CLOCK / (below + 1.0) * above) / periods
        self.frequency = np.where(self.gate.mean > 0.5, mean, periods * CLOCK / ticks)

    # ------------------------------------------------------------------------------------------- filter and table

    def _filter(self) -> None:
        """Mean of the window without its ``trim`` smallest and largest samples (Xi2023 eq. 6, Fig. 9), and heights."""
        p, x = self.filter, np.array(self.samples)
        rank = np.arange(len(x))[:, None]
        ascending = np.sort(np.where(rank < p.window, x, np.inf), axis=0)
        keep = (rank >= p.trim) & (rank < p.window - p.trim)
        filtered = np.where(keep, ascending, 0.0).sum(axis=0) / keep.sum(axis=0)
        self.height, self.raw_height = self._looked_up(filtered), self._looked_up(x[0])

    def _looked_up(self, frequency: Array) -> Array:
        """Height in mm from the table of each machine's head, interpolated or that of the nearest entry."""
        height = np.empty_like(frequency)
        for machines, frequencies, heights in self.tables:
            f = frequency[machines]
            nearest = heights[np.searchsorted(0.5 * (frequencies[1:] + frequencies[:-1]), f)]
            interpolated = np.interp(f, frequencies, heights)
            height[machines] = np.where(self.table.look_up[machines] > 0.5, nearest, interpolated)
        return height

    # -------------------------------------------------------------------------------------------------------- laws

    def _proportional(self) -> Array:
        """u = −Kv·(height − set height), mm/s (Xi2023)."""
        return -self.gains.kv * (self.height - self.job.set_height)

    def _pid(self) -> Array:
        """u = −(kp·e + I + kd·D), mm/s.

        D is de/dt behind a lag (backward Euler); I = ki·∫e dt. Under the supervisor's commands D is 0 and I stands;
        before the approach is over I is empty.
        """
        g, e = self.gains, self.height - self.job.set_height
        rate = np.where(self.fresh, 0.0, e - self.error) / PERIOD
        self.slope = np.where(self.override, 0.0, (g.lag * self.slope + rate) / (g.lag + 1.0))
        grown = np.where(self.override, self.integral, self.integral + g.ki * PERIOD * e)
        self.integral = np.where(self.captured, clip(grown, -g.limit, g.limit), 0.0)
        self.error = e
        return -(g.kp * e + self.integral + g.kd * self.slope)
