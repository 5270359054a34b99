"""The X/Y half of the machine and its cut in plain NumPy, one array element per machine: an oracle for the kernel.

It is written from the equations, which each method states, and shares no function with the kernel: matrix exponentials
for the drive, a search over all samples for the place on the path, sums in place of states
where that is possible. The numerical scheme is part of the contract, so it is shared:

- axes and path run ``AHEAD`` = 5 ms ahead of the machine; a trail holds what happened until the machine gets there, and
  six periods have passed before an episode begins;
- a period's order: what was decided about the process, what the axes' law decided, motion, place, servo instant; then,
  in the machine's own time, the cut and the next decision about the process;
- limits of acceleration take the same share of speed and way;
- the dither's flattening of a Gaussian is the rational function of ``cut.flattened`` (which a test of its own compares
  with the hypergeometric function), and an integral over the depth is Boole's rule on five depths.

What the Z half decides is given: the gap, the reported height, whether the period is scored. So is the wish of the law
of the process, because that law has tests of its own; when it is asked, and what it is shown, is not given.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy import linalg

Array = np.ndarray

PERIOD = 1e-3  # s
BEFORE = 6  # periods that the axes have done when an episode begins
RAPID, APPROACH, PIERCE, LEAD_IN, CUT, LIFT = range(6)
LEAST_OVERRIDE, IN_POSITION, STILL = 0.05, 0.01, 1e-3  # 1, mm, mm/s
SLEW, FADE = 0.5, 0.5  # of the acceleration for a change of override; of a correction, at each interpolation
SMOOTHING, HURRY = 8.0, 2.0  # ms, 1: how the set height follows the place
REACH, ROOM = 8.0, 0.05  # the nearest point is looked for as far as eight times the distance, and 0.05 mm
BOOLE = np.array([7.0, 32.0, 12.0, 32.0, 7.0])[:, None] / 90.0
DEPTHS = np.arange(5.0)[:, None] / 4.0
KAPPA = 0.22  # of a swept focus, such that ∫p² comes out
LENGTH, CUTOFF = 0.8, 2.5  # mm, of a peak-to-valley; wavelength above which an error is waviness
FILM, FLOW, WIDTH = 0.033, 0.137, 0.26  # of Huang2024's fastest static cut
LEFT_OPEN = 0.05  # share of the kerf that no film closes
SLOWEST = 0.05  # mm/s, a standstill

SUMS = ("time", "cutting", "length", "contour2", "contour_worst", "gap2", "gap_worst", "dross", "roughness", "through",
        "kerf", "taper", "energy", "power_most", "dither_most")  # fmt: skip


def axis(position: Array) -> SimpleNamespace:
    """An axis at rest."""
    zero = np.zeros_like(position)
    return SimpleNamespace(
        position=position.copy(),
        issued=position.copy(),
        summed=position.copy(),
        pace=zero.copy(),
        parts=np.zeros((2, *position.shape)),
        command=zero.copy(),
        step=zero.copy(),
        velocity=zero.copy(),
    )


class XYMachine:
    """N gantries; every number is an array of shape (N,).

    Args:
        jobs: one :class:`paths.job.PlannedJob` for each.
        parts: numbers of ``xy``, ``recipe``, ``optics``, ``cut``, ``published``, ``journey`` and ``law`` (Wu's), each
            an object with arrays of shape (N,).
    """

    def __init__(self, jobs: Sequence[Any], parts: dict[str, Any]) -> None:
        self.jobs, self.n = jobs, len(jobs)
        self.p, self.recipe, self.optics, self.c, self.range, self.journey, self.law = (
            parts[name] for name in ("xy", "recipe", "optics", "cut", "published", "journey", "law")
        )
        p, zero = self.p, np.zeros(self.n)
        self.last = np.array([len(job.x) - 1.0 for job in jobs])
        longest = int(self.last.max()) + 1
        self.tables = {
            name: np.stack([np.pad(getattr(job, name), (0, longest - len(job.x)), mode="edge") for job in jobs])
            for name in ("x", "y", "s", "feed", "tx", "ty", "beam", "phase", "lift", "most")
        }
        # Two parts of the velocity (T·v' = c·u − v), the way, and the held command: exact over a period.
        self.drive = np.empty((self.n, 4, 4))
        c1 = (p.t1 - p.tau) / (p.t1 - p.t2)
        for i in range(self.n):
            rates = np.zeros((4, 4))
            rates[0, [0, 3]] = [-1.0 / p.t1[i], c1[i] / p.t1[i]]
            rates[1, [1, 3]] = [-1.0 / p.t2[i], (1.0 - c1[i]) / p.t2[i]]
            rates[2, :2] = 1.0
            self.drive[i] = linalg.expm(PERIOD * rates)
        self.x, self.y = (axis(self.at(zero, name)) for name in ("x", "y"))
        self.tau, self.override, self.near, self.aloft = zero.copy(), zero + 1.0, zero.copy(), zero.copy()
        self.servo_in, self.interpolation_in, self.waited = zero.copy(), zero.copy(), zero.copy()
        self.dx, self.dy, self.hand_x, self.hand_y = zero.copy(), zero.copy(), zero.copy(), zero.copy()
        names = ("override", "power", "frequency", "x", "y", "z", "focus", "standoff")
        self.applied = {name: zero + (1.0 if name in ("override", "power") else 0.0) for name in names}
        self.wish: dict[str, Array] | None = None
        self.realised = {name: zero.copy() for name in ("frequency", "x", "y", "z", "lag", "lag_z", "focus")}
        self.due = zero > 1.0
        self.trail: list[dict[str, Array]] = []
        self._locate()
        self.trail.clear()  # what the prefill sees begins with the first period
        self._servo()
        for _ in range(BEFORE):
            self._travel()
        self.tick, self.process_in = -1, zero.copy()
        self.sums = {name: zero.copy() for name in SUMS}
        self.figures = {
            name: zero.copy()
            for name in ("margin", "roughness", "dross", "kerf_top", "kerf_bottom", "taper", "through")
        }
        self.base, self.high, self.low, self.way, self.lengths, self.geometric, self.error2, self.weight = (
            zero.copy() for _ in range(8)
        )
        self.seen: dict[str, Array] = {}

    # ------------------------------------------------------------------------------------------------- running

    def ready(self, wish: dict[str, Array], height: Array, gap: Array, set_height: Array) -> None:
        """The first decision about the process; see :meth:`step`."""
        self._decide(wish, height, gap, set_height)

    def step(self, gap: Array, height: Array, set_height: Array, scored: Array, wish: dict[str, Array]) -> None:
        """One control period; what the Z half made of it, and what the law of the process wishes at its end."""
        self.tick += 1
        self._travel()
        self._cut(gap, scored.astype(bool))
        self._decide(wish, height, gap, set_height)

    @property
    def now(self) -> dict[str, Array]:
        """What the axes did in this period of the machine."""
        return self.trail[self.tick + 1]

    def at(self, tau: Array, name: str) -> Array:
        """A field of the jobs at ``tau`` ms of nominal time, interpolated; beyond the ends the end's."""
        t, rows, v = np.clip(tau, 0.0, self.last), np.arange(self.n), self.tables[name]
        low = t.astype(int)
        after = np.minimum(low + 1, self.last.astype(int))
        share = t - low
        return (1.0 - share) * v[rows, low] + share * v[rows, after]

    # ---------------------------------------------------------------------------------------------------- axes

    def _travel(self) -> None:
        self._apply()
        for a, command, plus, minus in (
            (self.x, self.x.velocity, self.p.x_plus, self.p.x_minus),
            (self.y, self.y.velocity, self.p.y_plus, self.p.y_minus),
        ):
            self._take(a, command, plus, minus)
            self._move(a)
        self.due = np.zeros(self.n, bool)
        self._locate()
        self._servo()

    def _take(self, a: SimpleNamespace, command: Array, plus: Array, minus: Array) -> None:
        """D/A steps, the drive's gain of that direction, its limit of speed; and the next increment is issued."""
        dac = np.where(self.p.dac > 0.0, self.p.dac, 1.0)
        u = np.where(self.p.dac > 0.0, np.rint(command / dac) * dac, command)
        u = u * self.p.gain * np.where(u > 0.0, plus, minus)
        a.command = np.where(self.due, np.clip(u, -self.p.speed, self.p.speed), a.command)
        a.issued = np.where(self.due, a.issued + a.step, a.issued)

    def _move(self, a: SimpleNamespace) -> None:
        state = np.stack([*a.parts, np.zeros(self.n), a.command], axis=1)
        after = np.einsum("nij,nj->ni", self.drive, state)
        before = a.parts.sum(axis=0)
        change = after[:, 0] + after[:, 1] - before
        most = self.p.acceleration * PERIOD
        share = np.minimum(1.0, most / np.maximum(np.abs(change), 1e-300))
        a.parts = a.parts + share * (after[:, :2].T - a.parts)
        way = share * after[:, 2] + (1.0 - share) * before * PERIOD
        a.position = a.position + np.where(self.p.literal > 0.5, a.pace, way)

    def _encoded(self, a: SimpleNamespace) -> Array:
        position = np.where(self.p.literal > 0.5, a.summed, a.position)
        count = np.where(self.p.encoder > 0.0, self.p.encoder, 1.0)
        return np.where(self.p.encoder > 0.0, np.rint(position / count) * count, position)

    def _in_position(self, x: Array, y: Array) -> Array:
        """Within 10 µm of (x, y), or standing still and told to."""
        speed = np.abs(self.x.parts.sum(axis=0)) + np.abs(self.y.parts.sum(axis=0))
        still = (self.x.command == 0.0) & (self.y.command == 0.0) & (speed < STILL)
        return (np.hypot(x - self.x.position, y - self.y.position) <= IN_POSITION) | still

    # ------------------------------------------------------------------------------------------ place on the path

    def _locate(self) -> None:
        """Nearest sample that has been passed already, looked for from the last one on; a standstill's end if there."""
        latest = np.floor(self.tau).astype(int)
        there = self._in_position(
            self.at(np.floor(self.tau), "x") + self.dx, self.at(np.floor(self.tau), "y") + self.dy
        )
        for i, job in enumerate(self.jobs):
            x, y, near = self.x.position[i], self.y.position[i], int(self.near[i])
            limit = job.s[near] + REACH * np.hypot(job.x[near] - x, job.y[near] - y) + ROOM
            most = min(latest[i], int(np.searchsorted(job.s, limit, side="right")) - 1)
            if most > near:
                off = (job.x[near : most + 1] - x) ** 2 + (job.y[near : most + 1] - y) ** 2
                near = near + int(np.flatnonzero(off == off.min())[-1])
            k = latest[i]
            waits = near < k and job.x[k] == job.x[k - 1] and job.y[k] == job.y[k - 1]
            self.near[i] = k if waits and there[i] else near
        self.aloft = self.aloft + np.clip((self.near - self.aloft) / SMOOTHING, 0.0, HURRY)
        x, y, s, feed, tx, ty, beam, phase = (
            self.at(self.near, name) for name in ("x", "y", "s", "feed", "tx", "ty", "beam", "phase")
        )
        dx, dy = self.x.position - x, self.y.position - y
        along, beside = dx * tx + dy * ty, dy * tx - dx * ty
        corner = np.abs(along) > feed * PERIOD + 1e-9  # the nearest point is the corner, not on either leg
        error = np.where(corner, np.where(beside >= 0.0, 1.0, -1.0) * np.hypot(dx, dy), beside)
        seen = {
            "x": self.x.position.copy(),
            "y": self.y.position.copy(),
            "error": error,
            "speed": np.hypot(self.x.parts.sum(axis=0), self.y.parts.sum(axis=0)),
            "lag": (self.x.issued - self.x.position) * tx + (self.y.issued - self.y.position) * ty,
            "s": s + np.where(corner, 0.0, along),
            "feed": feed * self.override,
            "tx": tx,
            "ty": ty,
            "phase": phase,
            "beam": beam,
            "lift": self.at(self.aloft, "lift"),
            "tau": self.near.copy(),
            "override": self.override.copy(),
            "over": (self.near >= self.last).astype(float),
        }
        self.trail.append(seen)

    # ------------------------------------------------------------------------------------------------ servo instant

    def _servo(self) -> None:
        p = self.p
        now = self.servo_in <= 1.0
        self.servo_in = np.where(now, p.servo, self.servo_in - 1.0)
        for a in (self.x, self.y):  # literal: the speeds at the instants are summed
            sampled = a.parts.sum(axis=0) * p.servo * PERIOD
            literal = now & (p.literal > 0.5)
            a.summed = np.where(literal, a.summed + sampled, a.summed)
            a.pace = np.where(literal, sampled / p.servo, a.pace)
        turn = now & (self.interpolation_in <= p.servo)
        self.interpolation_in = np.where(
            turn, p.interpolation, np.where(now, self.interpolation_in - p.servo, self.interpolation_in)
        )
        self._interpolate(turn)
        period = p.servo * PERIOD
        k, law = self.law.kp * self.law.kn / period, self.law
        for a, plus, minus in ((self.x, law.x_plus, law.x_minus), (self.y, law.y_plus, law.y_minus)):
            fed = a.step / period
            change = (fed - getattr(a, "fed", 0.0)) / period
            wish = k * (a.issued - self._encoded(a)) + law.velocity * fed + 1e-3 * law.acceleration * change
            a.velocity = np.where(now, wish * np.where(wish > 0.0, plus, minus), a.velocity)
            a.fed = np.where(now, fed, getattr(a, "fed", 0.0))
        self.due = now

    def _interpolate(self, turn: Array) -> None:
        """Where the path goes next: override, waiting at standstills, corrections, and the way there in increments."""
        p, j = self.p, self.journey
        feed, room = self.at(self.tau, "feed"), self.at(self.tau, "most")
        phase = self.at(np.rint(self.tau), "phase")
        feeds = (phase == LEAD_IN) | (phase == CUT)
        most = SLEW * p.acceleration * p.interpolation * PERIOD / np.maximum(feed, 1.0)
        wanted = np.where(feeds, np.clip(self.applied["override"], LEAST_OVERRIDE, room), 1.0)
        override = self.override + np.clip(wanted - self.override, -most, most)
        there = self._in_position(self.at(self.tau, "x") + self.dx, self.at(self.tau, "y") + self.dy)
        halted = (feed == 0.0) & ~there
        waits = halted & (self.waited < j.patience)
        waited = np.where(waits, self.waited + p.interpolation, np.where(halted, self.waited, 0.0))
        tau = np.where(waits, self.tau, np.minimum(self.tau + override * p.interpolation, self.last))
        corrects = feeds & (feed > 0.0)
        dx = np.where(corrects, np.clip(self.hand_x, -j.corrections, j.corrections), FADE * self.dx)
        dy = np.where(corrects, np.clip(self.hand_y, -j.corrections, j.corrections), FADE * self.dy)
        for a, name, d in ((self.x, "x", dx), (self.y, "y", dy)):
            step = (self.at(tau, name) + d - a.issued) * p.servo / p.interpolation
            a.step = np.where(turn, step, a.step)
        self.override, self.waited = np.where(turn, override, self.override), np.where(turn, waited, self.waited)
        self.tau, self.dx, self.dy = (
            np.where(turn, new, old) for new, old in ((tau, self.tau), (dx, self.dx), (dy, self.dy))
        )

    # ------------------------------------------------------------------------------------------------ process, spot

    def _apply(self) -> None:
        """The wish of the process' law comes into force, within the limits of recipe, optics and publication."""
        if self.wish is None:
            return
        w, r, o = self.wish, self.recipe, self.optics
        c = {
            "override": np.clip(w["override"], LEAST_OVERRIDE, r.most_override),
            "power": np.clip(w["power"], 0.0, r.most_power),
            "frequency": np.clip(w["frequency"], 0.0, o.highest),
            "x": np.clip(w["x"], 0.0, o.galvo_range),
            "y": np.clip(w["y"], 0.0, o.galvo_range),
            "z": np.clip(w["z"], 0.0, o.piezo_range),
            "focus": np.clip(w["focus"], -o.piezo_range, o.piezo_range),
            "standoff": np.clip(w["standoff"], -r.most_standoff, r.most_standoff),
        }
        within = self._published(c)
        c = {name: np.where(self.range.bounded > 0.5, within[name], c[name]) for name in c}
        on = self.due_process & True
        self.applied = {name: np.where(on, c[name], self.applied[name]) for name in c}
        f = c["frequency"]
        galvo, piezo = self._phasor(f, o.galvo, o.galvo_zeta), self._phasor(f, o.piezo, o.piezo_zeta)
        play = 2.0 * o.hysteresis * o.piezo_range  # the loop's width
        made = {
            "frequency": f,
            "x": np.abs(galvo) * c["x"],
            "y": np.abs(galvo) * c["y"],
            "z": np.abs(piezo) * c["z"],
            "lag": -np.angle(galvo) * (f > 0.0),
            "lag_z": (o.hysteresis - np.angle(piezo)) * (f > 0.0),
            # A play: the focus stays where it is until what is wanted is half the loop away.
            "focus": np.where(
                np.abs(self.realised["focus"] - c["focus"]) <= 0.5 * play,
                self.realised["focus"],
                c["focus"] + 0.5 * play * np.sign(self.realised["focus"] - c["focus"]),
            ),
        }
        for name in ("x", "y", "z"):
            made[name] = np.where(f > 0.0, made[name], 0.0)
        self.realised = {name: np.where(on, made[name], self.realised[name]) for name in made}
        self.wish = None

    def _published(self, c: dict[str, Array]) -> dict[str, Array]:
        """Settings within what a document prints: straight lines between its two methods."""
        r, on = self.range, c["frequency"] > 0.0
        a = np.where(on, np.minimum(np.minimum(c["x"], c["y"]), r.amplitude), 0.0)
        f = np.where(on, np.clip(c["frequency"], r.frequency_low, r.frequency_high), 0.0)
        feed = np.maximum(self.journey.feed, 1e-9)
        fastest = r.feed_static + (r.feed_high - r.feed_static) * np.clip(a / np.maximum(r.amplitude, 1e-9), 0, 1)
        share = (f - r.frequency_low) / np.maximum(r.frequency_high - r.frequency_low, 1e-9)
        deepest = r.deep_low + (r.deep_high - r.deep_low) * np.clip(share, 0.0, 1.0)
        return {
            "override": np.minimum(np.maximum(c["override"], r.feed_low / feed), fastest / feed),
            "power": np.clip(c["power"], r.power_low, r.power_high),
            "frequency": f,
            "x": a,
            "y": a,
            "z": np.clip(c["z"], 0.0, deepest),
            "focus": np.clip(c["focus"], -r.focus, r.focus),
            "standoff": np.clip(c["standoff"], -r.standoff, r.standoff),
        }

    @staticmethod
    def _phasor(f: Array, natural: Array, zeta: Array) -> Array:
        """H(jω) = 1/(1 − r² + 2jζr) of a second-order system, r = f/f0."""
        r = f / natural
        return 1.0 / (1.0 - r**2 + 2j * zeta * r)

    def _decide(self, wish: dict[str, Array], height: Array, gap: Array, set_height: Array) -> None:
        """The set height of the coming period, and every ``recipe.period`` ms what the law of the process is shown."""
        r = self.recipe
        after = self.trail[self.tick + 2]["lift"]
        self.set_height = r.standoff + r.offset + self.applied["standoff"] + after
        turn = self.process_in <= 1.0
        self.process_in = np.where(turn, r.period, self.process_in - 1.0)
        self.due_process = turn
        if turn.any():
            t = self.now
            shown = {
                "planned": self.at(t["tau"], "feed"), "planned_50": self.at(t["tau"] + 50.0, "feed"),
                "planned_100": self.at(t["tau"] + 100.0, "feed"), "planned_200": self.at(t["tau"] + 200.0, "feed"),
                "speed": t["speed"], "override": t["override"], "lag": t["lag"], "contour_error": t["error"],
                "height": height, "set_height": set_height, "phase": t["phase"], "beam": t["beam"],
                "progress": t["tau"] / self.last, "thickness": r.thickness, "nominal_power": r.power,
                "standoff": r.standoff, "feed": self.journey.feed, "tangent_x": t["tx"], "tangent_y": t["ty"],
                "gap": gap, "margin": self.figures["margin"], "dross": self.figures["dross"],
                "roughness": self.figures["roughness"],
            }  # fmt: skip
            self.seen = {name: np.where(turn, value, self.seen.get(name, value)) for name, value in shown.items()}
            self.wish = {name: np.asarray(value, float).copy() for name, value in wish.items()}

    # --------------------------------------------------------------------------------------------------- the cut

    def _cut(self, gap: Array, scored: Array) -> None:
        t, r, real = self.now, self.recipe, self.realised
        error, power = gap - r.standoff, self.applied["power"] * r.power
        # Sines along and across the path that spread as much: √2 of the RMS; eq. 12's hat has ⟨(0.2 s + 0.8 g c)²⟩.
        share = np.where(self.optics.shape == 1.0, np.sqrt(2.0 * (0.5 * 0.2**2 + 0.5 * 0.8**2 / 3.0)), 1.0)
        x, y, c, s = share * real["x"], share * real["y"], t["tx"], t["ty"]
        own = self.optics.along > 0.5
        along, across = np.where(own, x, np.hypot(x * c, y * s)), np.where(own, y, np.hypot(x * s, y * c))
        up = real["z"] * np.sqrt(2.0 / 3.0)  # a triangle's mean square is a third
        self.figures = self._quality(power, along, across, up, t["speed"], error, t["error"])
        f, w = self.figures, np.where(scored, t["speed"] * PERIOD, 0.0)
        off, worst = np.abs(t["error"]), self.sums
        added = {
            "time": np.where(t["over"] > 0.5, 0.0, PERIOD),
            "cutting": np.where(scored, PERIOD, 0.0),
            "length": w,
            "contour2": w * off**2,
            "gap2": w * error**2,
            "dross": w * f["dross"],
            "roughness": w * f["roughness"],
            "through": w * f["through"],
            "kerf": w * f["kerf_top"],
            "taper": w * f["taper"],
            "energy": t["beam"] * power * PERIOD,
        }
        largest = {
            "contour_worst": off,
            "gap_worst": np.abs(error),
            "power_most": power,
            "dither_most": np.maximum(real["x"], real["y"]),
        }
        self.sums = {name: worst[name] + more for name, more in added.items()} | {
            name: np.where(scored, np.maximum(worst[name], value), worst[name]) for name, value in largest.items()
        }

    def _remember(self, way: Array, error: Array, contour: Array) -> None:
        """Waviness (first order over the way), five peak-to-valleys, and the mean square of the standoff's error."""
        weight = self.weight + way
        share = np.where(
            way > 0.0, np.maximum(1.0 - np.exp(-way / (5.0 * LENGTH)), way / np.maximum(weight, 1e-9)), 0.0
        )
        passed = 2.0 * np.pi * way / CUTOFF
        self.base = np.where(self.weight > 0.0, self.base + (contour - self.base) * passed / (1.0 + passed), contour)
        rest, began = contour - self.base, self.way <= 0.0
        self.high = np.where(began, rest, np.maximum(self.high, rest))
        self.low = np.where(began, rest, np.minimum(self.low, rest))
        along = self.way + way
        full = along >= LENGTH
        self.lengths = np.where(full, np.minimum(self.lengths + 1.0, 5.0), self.lengths)
        fresh = (self.high - self.low - self.geometric) / np.maximum(self.lengths, 1.0)
        self.geometric = np.where(full, self.geometric + fresh, self.geometric)
        self.way, self.weight = np.where(full, 0.0, along), weight
        self.error2 = self.error2 + share * (error**2 - self.error2)

    def _quality(
        self, power: Array, along: Array, across: Array, up: Array, speed: Array, error: Array, contour: Array
    ) -> dict[str, Array]:
        """Melt margin, kerf, film, roughness and dross: the equations at the head of ``envs/plant/cut.py``."""
        p, v, e = self.c, np.maximum(speed, SLOWEST), np.clip(error, -10.0, 10.0)
        self._remember(np.where(speed > SLOWEST, speed * PERIOD, 0.0), e, contour)
        length = 4.0 * np.sqrt(p.w0**2 / 4.0 + along**2 / 2.0)
        k = 2.0 * np.pi * self.realised["frequency"] / v
        a = across * np.sqrt(1.0 - np.exp(-((k * length) ** 2) / 12.0))  # what the front does not average is there
        z = DEPTHS * p.thickness
        focus = p.focus - e - self.realised["focus"]
        w = p.w0 * np.sqrt(1.0 + ((z - focus) ** 2 + KAPPA * 1.5 * up**2) / p.zr**2)
        density = self._flattened(2.0 * a / w) / (w * np.sqrt(np.pi))
        cosine = length / np.hypot(length, p.thickness)  # Fresnel at a steep front, unpolarised
        reflected = 0.0
        for n in (cosine, 1.0 / cosine):
            reflected = reflected + 0.5 * ((p.refraction - n) ** 2 + p.extinction**2) / (
                (p.refraction + n) ** 2 + p.extinction**2
            )
        width, phi = 1.0 / density, density / (BOOLE * density).sum(axis=0)
        lost = p.conduct * (0.25 * v * width / p.diffusivity) ** 0.36
        margins = ((1.0 - reflected) * power * phi / p.thickness + p.burn * v * width) / (v * width * p.melt + lost)
        margin = (BOOLE * margins).sum(axis=0)
        kerf = self._kerf(margins, w / 2.0, a)
        u = DEPTHS
        cold = (BOOLE * (1.0 + p.carry * (1.0 - 2.0 * u)) / np.maximum(margins, 0.02)).sum(axis=0)
        losses = 1.0 + np.maximum(0.0, kerf[4] / kerf[0] - 1.0) ** 2

        def through(film: Array) -> Array:
            gap = np.maximum(kerf - 2.0 * film * np.sqrt(u), np.where(u > 0.0, LEFT_OPEN * kerf, kerf))
            return 1.0 / (losses + p.slot * p.thickness * (BOOLE / gap).sum(axis=0))

        def film2(flow: Array) -> Array:
            return p.film * v * p.thickness / (np.maximum(1.0 / cold, 0.02) * flow)

        flow = through(np.sqrt(film2(through(np.zeros_like(v)))))
        gas = p.pressure / (1.0 + (e / np.where(e > 0.0, p.gas_above, p.gas_below)) ** 2)
        melted = p.rough * (np.sqrt(film2(flow)) / FILM) ** p.rough_power * gas**-p.rough_gas
        written = self.geometric + 2.0 * across * np.exp(-0.5 * (k * p.w0 / 2.0) ** 2)
        burnt = p.upturn * np.maximum(0.0, margin - p.upturn_from)
        rough = np.sqrt(melted**2 + written**2 + p.follow**2 * self.error2 + burnt**2)
        dross = p.dross * np.cbrt((BOOLE * kerf).sum(axis=0) / WIDTH) / np.sqrt(flow / FLOW * gas)
        return {
            "margin": margin,
            "roughness": np.maximum(rough, p.floor),
            "dross": dross,
            "kerf_top": kerf[0],
            "kerf_bottom": kerf[4],
            "taper": np.abs(kerf[0] - kerf[4]) / 2.0,
            "through": (margin >= 1.0).astype(float),
        }

    @staticmethod
    def _flattened(r: Array) -> Array:
        top, bottom = (0.58093949, 2.18316201, 1.0), (0.26214703, 0.9331167, 2.46994122)
        q = r**2
        return (top[0] * q**2 + top[1] * q + 1.0) / ((bottom[0] * r + bottom[1]) * q**2 + bottom[2] * q + 1.0)

    @staticmethod
    def _kerf(m: Array, sigma: Array, a: Array) -> Array:
        """b = 2·sqrt((4 + 2·ln m)·σ² + a² + c·a·σ), c = 3.16·r²/(r² + 2.4), r = a/σ."""
        r = a / sigma
        c = 3.16 * r**2 / (r**2 + 2.4)
        least = np.maximum(0.01, 4.0 + 2.0 * np.log(np.maximum(m, 1e-6)))
        return 2.0 * np.sqrt(least * sigma**2 + a**2 + c * a * sigma)
