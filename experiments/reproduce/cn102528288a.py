"""CN102528288A: the digital height controller's measurement, commands, follow flow and advanced processes."""

import functools
import importlib
import math
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from ...baselines import cn102528288a as law
from ...baselines import sequences
from ...envs import scenarios
from ...envs.control import stack
from ...envs.control.panel import LEVEL, Panel
from ...envs.figures import metrics
from ...envs.plant import sensor, supervisor, z_axis
from ..measure import rollout
from ..plots.palette import COLOURS, GRID, QUIET
from . import fixed_gains
from .claims import Estimate, Rows, Trial, estimate, study
from .pictures import Drawing, illustrated
from .verdicts import FAILS, TREND

CONTROLLER = "cn102528288a"
SPEED = 200.0
"""mm/s, printed."""

STATIC, DYNAMIC = 3.0, 20.0
"""µm, printed: ±0.003 mm and ±0.02 mm."""

pictured = functools.partial(illustrated, grid={"color": GRID})


# ------------------------------------------------------------------------------------------------------- measurement


@study(CONTROLLER, "Counting the oscillator")
def counting(trial: Trial, rows: Rows) -> list[Drawing]:
    """What a 300 MHz clock resolves, one total count against a mean of per-period frequencies."""
    p, rng = sensor.EQ3, np.random.default_rng(0)
    heights = (0.1, 0.5, 1.0, 2.0, 5.0, 10.0)
    ends = [float(sensor.oscillator(p, c, 0.0)) * 1e-6 for c in (20.0, 5.0)]
    gate = sensor.Gate(length=0.25)
    scatter: dict[str, list[float]] = {"total": [], "mean": []}
    for h in heights:
        f = float(sensor.oscillator(p, sensor.capacitance(p, h, 1.0), 0.0))
        steep = _slope(p, h)
        # The law of one count depends on the fractional part of its ticks: a test averages over a band of frequencies.
        band = f * (1.0 + rng.uniform(0.0, 1e-3, 4000))
        phases = rng.uniform(0.0, 1.0, band.size)
        for kind, mean in (("total", 0.0), ("mean", 1.0)):
            own, pairs = gate._replace(mean=mean), zip(band, phases, strict=True)
            counted = np.array([sensor.counted(own, float(x), float(u)) for x, u in pairs])
            error = counted - band
            scatter[kind].append(1e3 * float(np.std(error)) / steep)
    f1 = float(sensor.oscillator(p, sensor.capacitance(p, 1.0, 1.0), 0.0))
    values = gate.length * 1e-3 * f1
    law_ = 1e3 * f1 / (math.sqrt(6.0) * sensor.CLOCK * gate.length * 1e-3) / _slope(p, 1.0)
    x, u = f1 * (1.0 + rng.uniform(0.0, 1e-3, 4000)), rng.uniform(0.0, 1.0, 4000)
    ideal = gate._replace(mean=1.0)
    bias = float(np.mean([sensor.counted(ideal, float(f), float(v)) / f - 1.0 for f, v in zip(x, u, strict=True)]))

    @pictured("CN102528288A, measurement")
    def counting(axes: Axes) -> None:
        """Scatter of one reading that comes from counting alone, in µm of height, over the height in mm. It grows with
        the square of the height; below 2 mm it is far under the printed static accuracy."""
        for kind, colour in zip(scatter, COLOURS, strict=False):
            axes.loglog(heights, scatter[kind], color=colour, marker="o", markersize=4, label=f"{kind} over 0.25 ms")
        axes.axhline(STATIC, color=QUIET, linestyle="--", linewidth=0.8)
        axes.text(heights[0], 1.1 * STATIC, "printed static accuracy, ±3 µm", color=QUIET, fontsize=9)
        axes.set(xlabel="height (mm)", ylabel="σ of one reading (µm)")
        axes.legend(frameon=False)

    rows("band", ends, holds=1.0 <= ends[0] <= ends[1] <= 10.0)
    rows("adjacent-edges", values, holds=values > 100.0)
    rows("counting-noise", (scatter["total"][2], law_), holds=abs(scatter["total"][2] / law_ - 1.0) < 0.1)
    holds = scatter["mean"][2] / scatter["total"][2] < 1.5
    rows("mean-of-periods", (scatter["mean"][2] / scatter["total"][2], bias * 1e6), holds)
    return [counting()]


def _slope(p: sensor.Params, h: float) -> float:
    """Hz/mm at the height ``h``."""

    def f(x: float) -> float:
        return float(sensor.oscillator(p, sensor.capacitance(p, x, 1.0), 0.0))

    return (f(h * 1.001) - f(h * 0.999)) / (0.002 * h)


# --------------------------------------------------------------------------------------------------------- commands


def _panel(seed: int, **start: float) -> Panel:
    return Panel(CONTROLLER, LEVEL, seed, **start)


@study(CONTROLLER, "Six commands and error handling")
def commands(trial: Trial, rows: Rows) -> None:
    """Each command's end state, from a motion, over seeds of the machine; what is asked wrongly; what breaks."""
    ends: dict[str, list[float]] = {"stop": [], "follow": [], "single-side protection": [], "idle positioning": []}
    homes, jumps, contacts = [], [], 0
    alarms: dict[str, list[bool]] = {"unknown command": [], "sensor lost": [], "index pulse missing": [], "limit": []}
    for seed in range(trial.seeds):
        p = _panel(seed, gap=15.0, coast=float(np.random.default_rng(seed).uniform(-5.0, 5.0)))
        p.home()
        homes.append(1e3 * (p["head"] - 10.0 * round(p["head"] / 10.0)))
        p.move(20.0)
        ends["idle positioning"].append(1e3 * (p["head"] - 20.0))
        p.follow(1.0)
        p.wait(0.5)
        ends["follow"].append(1e3 * (p["gap"] - 1.0))
        p.protect(2.0)
        p.wait(1.0)
        ends["single-side protection"].append(p["gap"])
        p.request("move", target=40.0)
        p.wait(0.15)
        ends["stop"].append(1e3 * p.stop().seconds)
        jumps.append(_jump(p))
        contacts += p.collided
        for name, fault in (("unknown command", None), ("sensor lost", "cable")):
            p = _panel(seed, gap=2.0)
            p.follow(1.0)
            if fault:
                p.break_(fault)
            else:
                p.send(99.0)
            alarms[name].append(p.until(lambda: False, 0.3).alarm == name and not p.collided)
        for name, fault in (("index pulse missing", "index"), ("limit", "switch")):
            p = _panel(seed, gap=60.0)
            p.break_(fault)
            alarms[name].append(p.home().alarm == name)
    rows("stop", ends["stop"], holds=np.max(ends["stop"]) < 100.0)
    rows("follow", ends["follow"], holds=np.abs(ends["follow"]).max() < 20.0)
    rows("protect", ends["single-side protection"], holds=np.min(ends["single-side protection"]) >= 1.99)
    rows("idle-positioning", ends["idle positioning"], holds=np.abs(ends["idle positioning"]).max() < 5.0)
    rows("home", homes, holds=np.abs(homes).max() < 20.0)
    rows("stops-first", jumps, holds=np.max(jumps) <= 10.0 + 1e-9)
    for name, seen in alarms.items():
        rows("error-handling", (sum(seen), len(seen), name), holds=all(seen), case=name)
    rows("contacts", (contacts, trial.seeds), holds=contacts == 0)


def _jump(p: Panel) -> float:
    """Largest change of the command in a control period while the supervisor gives it, mm/s."""
    log = p.log()
    own = log["mode"] != supervisor.FOLLOW
    return float(np.abs(np.diff(log["command"]))[own[1:] & own[:-1]].max())


@study(CONTROLLER, "Positioning along an S-curve")
def positioning(trial: Trial, rows: Rows) -> list[Drawing]:
    """The displacement–time plan and what the axis makes of it; homing's repeatability."""
    p, distance = supervisor.Params(), 50.0
    duration = float(supervisor.course(p, distance, 0.0)[1])
    time = np.arange(0.0, duration, 1e-4)
    plan = np.array([supervisor.course(p, distance, t)[0] for t in time])
    speed = np.gradient(plan, time)
    acceleration = np.gradient(speed, time)
    jerk = np.gradient(acceleration, time)[5:-5]
    over, ends, seconds, homes, downs = [], [], [], [], []
    for seed in range(trial.seeds):
        m = _panel(seed, gap=10.0, coast=float(np.random.default_rng(seed).uniform(-5.0, 5.0)))
        m.home()
        m.move(20.0)
        outcome = m.move(20.0 + distance)
        m.wait(0.2)
        log = m.log()
        way = log["head"][-round((outcome.seconds + 0.2) * 1e3) :]
        over.append(1e3 * max(0.0, float(way.max()) - 20.0 - distance))
        ends.append(1e3 * (m["head"] - 20.0 - distance))
        seconds.append(outcome.seconds)
        m.home()
        homes.append(m["head"])
        downs.append(_down(m))
        if seed == 0:
            shown_time, shown_way, shown_speed = 1e-3 * np.arange(len(way)), way - 20.0, log["velocity"][-len(way) :]
    homes_ = np.asarray(homes)

    @pictured("CN102528288A claim 4", 1, 2, height=4.6, sharex=True)
    def s_curve(top: Axes, bottom: Axes) -> None:
        """A move by 50 mm: planned displacement (mm) and speed (mm/s) over time (s), and what the head does (dashed).
        The head lags by speed over gain and arrives without overshoot."""
        top.plot(time, plan, color=COLOURS[0], label="planned")
        top.plot(shown_time, shown_way, color=COLOURS[1], linestyle="--", label="head")
        top.set(ylabel="way (mm)", xlim=(0.0, 1.0))
        top.legend(frameon=False)
        bottom.plot(time, speed, color=COLOURS[0])
        bottom.plot(shown_time, shown_speed, color=COLOURS[1], linestyle="--")
        bottom.set(xlabel="time (s)", ylabel="speed (mm/s)")

    a = p.plan * p.acceleration
    holds = speed.max() < 1.001 * p.fastest and acceleration.max() < 1.001 * a and np.abs(jerk).max() < 1.01 * p.jerk
    rows("s-curve", (speed.max(), acceleration.max(), np.abs(jerk).max(), p, a), holds)
    rows("overshoot-of-a-move", over, holds=np.max(over) < 5.0)
    rows("end-of-a-move", ends, holds=np.abs(ends).max() <= STATIC)
    rows("time-of-a-move", (seconds, duration), holds=np.min(seconds) >= duration)
    rows("homing-speed", downs, holds=np.abs(np.asarray(downs) - 2.0).max() < 0.1)
    rows("homing-scatter", 1e3 * float(np.ptp(homes_)), holds=np.ptp(homes_) < 0.02)
    return [s_curve()]


def _down(p: Panel) -> float:
    """mm/s, median speed of homing's way down."""
    log = p.log()
    late = log["velocity"][-2000:]
    return float(-np.median(late[late < -0.5]))


SLOPE = 0.006
"""mm per mm of the sheet under protection: within the traverse it would come to 0.8 mm of a head that stands still."""


@study(CONTROLLER, "Single-side protection")
def protection(trial: Trial, rows: Rows) -> list[Drawing]:
    """A traverse over a sheet with holes: under protection the head neither dives nor lifts, following it would."""
    holes = scenarios.load("holes").varied(sheet={"tilt": SLOPE}, duration=1.0)
    lifts, lows, dives, stills, falls = [], [], [], [], []
    shown: dict[str, dict[str, np.ndarray]] = {}
    for seed in range(trial.seeds):
        for command in ("protect", "follow"):
            p = Panel(CONTROLLER, holes.varied(guard=False), seed, gap=2.0)
            p.follow(2.0)
            if command == "protect":
                p.protect(1.2)
            p.wait(0.1)
            first = p["head"]
            p.feed = SPEED
            p.wait(1.0)
            log = p.log()
            moved = log["head"][-1000:] - first
            if command == "protect":
                lows.append(float(log["gap"][-1000:].min()))
                lifts.append(float(moved.min()))
                stills.append(float((log["gap"][-1000:] - moved).min()))  # of a head that had stood still
            else:
                falls.append(float(moved.min()))
                dives.append(float(np.min(log["gap"][-1000:])))
            if seed == 0:
                shown[command] = {k: v[-1000:] for k, v in log.items()}

    @pictured("CN102528288A claim 3")
    def protection(axes: Axes) -> None:
        """Gap (mm) along a sheet with holes that rises by 6 mm/m, at 200 mm/s: single-side protection and following
        without a hole guard. Protection lifts the head where the sheet comes nearer than 1.2 mm; it never lowers it."""
        for (name, log), colour in zip(shown.items(), COLOURS, strict=False):
            label = {"protect": "protection, 1.2 mm"}.get(name, name)
            axes.plot(log["distance"], log["gap"], color=colour, label=label)
        axes.axhline(1.2, color=QUIET, linewidth=0.8, linestyle="--")
        axes.set(xlabel="way along x (mm)", ylabel="gap to the sheet's plane (mm)")
        axes.legend(frameon=False)

    guess = 1e3 * float(np.abs(np.median(falls)))
    rows("closes-following", np.abs(lifts) * 1e3, error=1e3 * float(np.abs(lifts).max()), guess=guess)
    rows("protection-height", lows, error=1.2 - float(np.min(lows)), guess=1.2 - float(np.median(stills)))
    rows("dive", dives, holds=np.median(dives) < np.median(lows))
    return [protection()]


# ------------------------------------------------------------------------------------------------------ follow flow


@study(CONTROLLER, "Scheduled gains")
def schedules(trial: Trial, rows: Rows) -> list[Drawing]:
    """The position gain and the integral gains over the error, as the law computes them."""
    errors = np.linspace(0.0, 4.0, 401)
    gain = np.array([law.position_gain(e) for e in errors])
    share = np.array([law.integral_share(e) for e in errors])

    @pictured("CN102528288A, follow flow", height=3.2)
    def schedules(axes: Axes) -> None:
        """Share of the largest position gain and of the integral gains (%) over the following error (mm). Integral
        gains scale the increments, so that no step of them moves the command."""
        axes.plot(errors, 100 * gain, color=COLOURS[0], label="position gain, of its maximum")
        axes.plot(errors, 100 * share, color=COLOURS[1], linestyle="--", label="integral gains, of theirs")
        axes.set(xlabel="following error (mm)", ylabel="share (%)")
        axes.legend(frameon=False)

    for where, printed, error, value in (
        ("error > 3 mm", "75 %", 3.5, law.position_gain(3.5)),
        ("error < 1 mm", "35 %", 0.5, law.position_gain(0.5)),
    ):
        rows("position-gain", (100 * value, where, error), holds=f"{100 * value:.0f} %" == printed, paper=printed)
    words = {0.0: "off", 0.5: "half", 1.0: "full"}
    for where, wanted, error in (("error ≥ 1 mm", 0.0, 1.2), ("1–0.5 mm", 0.5, 0.7), ("error < 0.5 mm", 1.0, 0.3)):
        value = float(law.integral_share(error))
        rows("integral-gains", (value, where), holds=value == wanted, paper=words[wanted])
    return [schedules()]


OPEN = {"guard.capture": 2.0, "guard.plan": 1.0, "guard.acceleration": 5e4, "guard.fastest": 500.0, "guard.delay": 0.0}
"""The supervisor's own approach planner as good as off, so that the law's gains decide how the head arrives."""

GAINS = (60.0, 80.0, 100.0, 130.0, 160.0, 200.0, 250.0)
"""1/s, largest position gains that are tried; the document gives none."""

ABOVE = 5.0
"""mm from which the head comes down: beyond the 3 mm where the largest gain holds."""

ARRIVED = 0.1
"""mm from the set height within which it has arrived for good."""


@dataclass(frozen=True)
class Arrival:
    """How the head came down: of each run s until it has arrived for good, mm of overshoot, whether it collided."""

    time: np.ndarray
    over: np.ndarray
    collided: np.ndarray


def arrival(trial: Trial, **gains: float) -> Arrival:
    """A way down by :data:`ABOVE` onto a level sheet with gains of :mod:`fixed_gains`, over the seeds."""
    hung = {"start_above": ABOVE, "set_height": 1.0}
    case = scenarios.load("flat").varied(duration=1.5, settle=0.1, head={"impulses": 0.0}, **hung)
    law_ = stack.as_stack(fixed_gains, "fixed-gains").varied({**OPEN, **{f"law.{k}": v for k, v in gains.items()}})
    record = rollout.roll(case, law_, np.arange(trial.seeds))
    near = np.abs(record.error) < ARRIVED
    last = len(near) - np.argmax(~near[::-1], axis=0)
    return Arrival(1e-3 * last, np.maximum(-record.error.min(axis=0), 0.0), record.collided.astype(bool))


@study(CONTROLLER, "Scheduled gains against fixed ones")
def scheduled_against_fixed(trial: Trial, rows: Rows) -> list[Drawing]:
    """Whether gains that follow the error are faster and overshoot less than gains that stay."""
    near, far = law.NEAR, law.FAR
    kinds: dict[str, dict[str, float]] = {
        "scheduled": {},
        f"fixed at {100 * near:.0f} %": {"share": near},
        f"fixed at {100 * far:.0f} %": {"share": far},
        "scheduled, integrals always on": {"gated": 0.0},
    }
    found = {k: [arrival(trial, gain=g, **change) for g in GAINS] for k, change in kinds.items()}
    ours, small, large, wound = found.values()
    sound = [i for i, a in enumerate(ours) if not a.collided.any()]
    at = sound[-1] if sound else 0
    own = stack.resolve(CONTROLLER).part("law").gain
    mine = arrival(trial, gain=own), arrival(trial, gain=own, share=near)
    hits = [a.collided.sum() for a in mine]

    def over(a: Arrival) -> Estimate:
        return estimate(1e3 * a.over, "µm")

    def beside(a: Estimate, b: Estimate) -> str:
        return f"{a} beside {b}"

    quick, slow = (estimate(1e3 * x[at].time, "ms") for x in (ours, small))
    told = (
        beside(quick, slow),
        *(100 * near, ARRIVED, 100 * far, estimate(1e3 * large[at].time, "ms"), ABOVE, GAINS[at], len(GAINS)),
    )
    rows("scheduled-time", told, holds=quick.value < 0.98 * slow.value)
    figures = (beside(over(ours[at]), over(large[at])), 100 * far, 100 * near, over(small[at]))
    rows("scheduled-overshoot", figures, holds=over(ours[at]).value < 0.98 * over(large[at]).value)
    holds = hits[0] <= hits[1]
    rows("scheduled-crash", (hits[0], trial.seeds, hits[1], CONTROLLER, own, 100 * near, *map(over, mine)), holds)
    rows(
        "integrals-step-by-step",
        (beside(over(ours[at]), over(wound[at])), wound[at].collided.sum(), trial.seeds),
        holds=over(ours[at]).value < 0.98 * over(wound[at]).value,
    )
    _integral_and_pid(trial, rows)

    @pictured("CN102528288A, follow flow", 2, sharex=True, words={"ABOVE": f"{ABOVE:g}", "ARRIVED": f"{ARRIVED:g}"})
    def scheduled(left: Axes, right: Axes) -> None:
        """The head comes down by {ABOVE} mm, medians over the seeds: time (ms) until it stays within {ARRIVED} mm, 1500
        if it does not, and overshoot (µm; beyond 1000 it is on the sheet), over the largest position gain (1/s)."""
        for (name, arrivals), colour, line in zip(found.items(), COLOURS, ("-", "--", "-.", ":"), strict=False):
            left.plot(GAINS, [1e3 * np.median(a.time) for a in arrivals], line, color=colour, marker="o", markersize=4)
            over = [max(1e3 * np.median(a.over), 1.0) for a in arrivals]
            right.semilogy(GAINS, over, line, color=colour, marker="o", markersize=4, label=name)
        right.axhline(1e3, color=QUIET, linewidth=0.8, linestyle="--")
        right.text(GAINS[0], 9e2, "the sheet", color=QUIET, fontsize=9, va="top")
        right.set_ylim(top=5e4)
        left.set(xlabel="largest position gain (1/s)", ylabel="time to arrive (ms)")
        right.set(xlabel="largest position gain (1/s)", ylabel="overshoot (µm)")
        right.legend(frameon=False, fontsize=8)

    return [scheduled()]


def _integral_and_pid(trial: Trial, rows: Rows) -> None:
    """What the integral gains do to the error on a slope, and the tuned law beside a tuned PID."""
    seeds = np.arange(trial.seeds)
    tilted = {"head": {"impulses": 0.0}, "sheet": {"tilt": 0.005}}
    slope = scenarios.load("flat").varied(duration=2.0, settle=1.5, feed=SPEED, **tilted)
    means = [
        1e3 * np.abs(np.where(r.scored, r.error, 0.0).sum(axis=0) / r.scored.sum(axis=0))
        for r in (
            rollout.roll(slope, stack.as_stack(fixed_gains, "fixed-gains").varied(change), seeds)
            for change in ({"law.ki": 0.0, "law.kiv": 0.0}, {})
        )
    ]
    wavy = scenarios.load("wavy")
    own, pid = (metrics.rms_true(rollout.roll(wavy, stack.get(name), seeds)) for name in (f"{CONTROLLER}-tuned", "pid"))
    ratio = estimate(own / pid, digits=3)
    holds = np.median(means[1]) < 0.98 * np.median(means[0])
    rows("steady-error", (estimate(means[0], "µm"), estimate(means[1], "µm")), holds)
    rows("beside-pid", ratio, holds=ratio.value < 0.98)


@study(CONTROLLER, "Accuracy, and following at 200 mm/s")
def accuracy(trial: Trial, rows: Rows) -> list[Drawing]:
    """Static and dynamic error of the law, in three readings of the printed speed."""
    seeds = np.arange(trial.seeds)
    names = (CONTROLLER, f"{CONTROLLER}-gap", f"{CONTROLLER}-tuned")
    flat = scenarios.load("flat").varied(head={"impulses": 0.0}, start_above=0.05)
    still = rollout.roll(flat, stack.get("idle"), seeds)
    standing = 1e3 * np.abs(np.where(still.scored, still["height"] - still.set_height, 0.0)).max(axis=0)
    for name in names:
        record = rollout.roll(flat, stack.get(name), seeds)
        reported = 1e3 * np.abs(np.where(record.scored, record["height"] - record.set_height, 0.0)).max(axis=0)
        true = 1e3 * np.abs(np.where(record.scored, record.error, 0.0)).max(axis=0)
        high = estimate(reported).high
        rows(
            "static-accuracy",
            (reported, name, (reported <= STATIC).sum(), len(reported)),
            error=high if np.isfinite(high) else float(np.median(reported)),
            guess=float(np.median(standing)),
            tolerance=STATIC,
            otherwise=TREND if np.median(reported) <= STATIC else FAILS,
            true=estimate(true, "µm"),
        )
    widest: dict[str, tuple[np.ndarray, list[float]]] = {}
    for name in names:
        amplitudes = np.geomspace(0.01, 3.0, 9)
        peaks = []
        for a in amplitudes:
            case = scenarios.load("wavy").varied(
                head={"impulses": 0.0}, sheet={"waves": ({"amplitude": float(a), "wavelength": 300.0},)}
            )
            record = rollout.roll(case, stack.get(name), seeds[:12])
            peaks.append(float(np.median(1e3 * np.abs(np.where(record.scored, record.error, 0.0)).max(axis=0))))
        widest[name] = (amplitudes, peaks)
        allowed = float(np.interp(DYNAMIC, peaks, amplitudes)) if peaks[0] < DYNAMIC else float("nan")
        steepest = 2 * np.pi * allowed / 300.0 * SPEED if np.isfinite(allowed) else 0.0
        told = (
            f"±{allowed:.2f} mm{' or more' * (peaks[-1] < DYNAMIC)}, {steepest:.1f} mm/s of surface speed"
            if np.isfinite(allowed)
            else "none",
            name,
        )
        rows("dynamic-accuracy", told, holds=np.isfinite(allowed))
    fastest = z_axis.Params().speed
    rows("z-speed", fastest, holds=fastest >= SPEED)

    @pictured("CN102528288A, following at 200 mm/s")
    def following(axes: Axes) -> None:
        """Largest true gap error (µm, median over 12 seeds) at 200 mm/s over a sheet with one wave of 300 mm, over the
        wave's amplitude (µm). Feed-forward of the gap's own speed helps as long as its noise does not."""
        for (name, (sheets, errors)), colour in zip(widest.items(), COLOURS, strict=False):
            axes.loglog(1e3 * sheets, errors, color=colour, marker="o", markersize=4, label=name)
        axes.axhline(DYNAMIC, color=QUIET, linestyle="--", linewidth=0.8)
        axes.text(11.0, 1.1 * DYNAMIC, "printed dynamic accuracy, ±20 µm", color=QUIET, fontsize=9)
        axes.set(xlabel="amplitude of the sheet's wave of 300 mm (µm)", ylabel="largest true error (µm)")
        axes.legend(frameon=False)

    return [following()]


# ------------------------------------------------------------------------------------------------ advanced processes


@study(CONTROLLER, "Advanced processes")
def processes(trial: Trial, rows: Rows) -> list[Drawing]:
    """Staged piercing, frog-leap, focus compensation and edge finding, as command sequences."""
    pierces: list[float] = []
    leaps: list[float] = []
    ways: list[float] = []
    across: list[float] = []
    edges: list[float] = []
    focus: list[float] = []
    touched = 0
    shown: dict[str, dict[str, np.ndarray]] = {}
    for seed in range(trial.seeds):
        p = _panel(seed, gap=10.0)
        pierces.append(sequences.staged_pierce(p, 1.0).seconds)
        touched += p.collided
        if seed == 0:
            shown["staged pierce"] = p.log()
        for leap, into in ((sequences.frog_leap, leaps), (sequences.lift_travel_land, ways)):
            p = _panel(seed, gap=1.0)
            p.follow(1.0)
            outcome = leap(p, 60.0, 5.0, 1.0)
            into.append(outcome.seconds if outcome.done else float("nan"))
            touched += p.collided
            if seed == 0:
                shown[leap.__name__.replace("_", " ")] = p.log()
        p = _panel(seed, gap=1.0)
        across.append(_protected(p, 60.0, 1.0))
        touched += p.collided
        at = 40.0 + float(np.random.default_rng(seed).uniform(0.0, 30.0))
        sheet = {"holes": {"pitch": 2.0 * (at + 50.0), "length": 100.0, "count": 1}}
        p = Panel(CONTROLLER, LEVEL.varied(sheet=sheet), seed, gap=1.0)
        edges.append(1e3 * (sequences.find_edge(p, 1.0, 50.0, 150.0).place - at))
        touched += p.collided
        p = _panel(seed, gap=1.0)
        sequences.focus_compensation(p, 200.0, 50.0, 1.0, lambda x: 0.002 * x)
        log = p.log()
        way = (log["distance"] > 20.0) & (log["distance"] < 199.0)
        focus.append(1e3 * float(np.abs(log["gap"][way] + 0.002 * log["distance"][way] - 1.0).max()))
        touched += p.collided
    saved = np.asarray(ways) - np.asarray(leaps)
    rows("staged-pierce", pierces, holds=np.isfinite(pierces).all())
    rows("frog-leap", (saved, np.median(leaps), np.median(ways)), holds=np.min(saved) > 0.0)
    holds = np.max(np.asarray(across) - np.asarray(ways)) < 0.0
    rows("protected-way", (np.median(across), np.median(ways)), holds=holds)
    rows("edge-finding", edges, holds=np.abs(edges).max() < 200.0)
    rows("focus-compensation", focus, holds=np.max(focus) < 100.0)
    rows("process-contacts", (touched, 6 * trial.seeds), holds=touched == 0)

    @pictured("CN102528288A, advanced processes", 2, sharey=True)
    def processes(left: Axes, right: Axes) -> None:
        """Gap (mm) over time (s): piercing in stages from 10 mm above, and the way to the next contour with a frog-leap
        and without."""
        left.plot(shown["staged pierce"]["time"], shown["staged pierce"]["gap"], color=COLOURS[0])
        left.set(xlabel="time (s)", ylabel="gap (mm)", title="staged pierce")
        for name, colour in zip(("frog leap", "lift travel land"), COLOURS[1:], strict=False):
            log = shown[name]
            after = log["time"] >= log["time"][np.argmax(log["mode"] == supervisor.MOVE)]
            right.plot(log["time"][after] - log["time"][after][0], log["gap"][after], color=colour, label=name)
        right.set(xlabel="time (s)", title="to the next contour, 60 mm")
        right.legend(frameon=False)

    return [processes()]


def _protected(p: Panel, distance: float, height: float) -> float:
    """s that a way of ``distance`` mm takes under protection at half of the following height (mm), until it follows."""
    p.follow(height)
    start = p.time
    p.protect(0.5 * height)
    step = sequences.rapid(p, distance, 166.0)
    p.until(lambda: not step())
    p.feed = 0.0
    done = p.follow(height).done
    return p.time - start if done else float("nan")


importlib.import_module(f"{__package__}.cn102528288a_height")  # one study more, of the background
