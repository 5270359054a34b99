"""Wu: the sampled position loops' rates, stability, lag, distortion and accuracy."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from scipy import signal

from ...baselines import wu
from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.engine.quantity import InvalidInput
from ...envs.figures import job_metrics
from ...envs.plant import xy_axes
from ...envs.scenarios import Scenario
from ...envs.tasks.workshop import drawing_of
from ..measure import axes
from ..measure.axes import IDEAL
from ..plots.palette import COLOURS, QUIET
from ..results import jobs
from .claims import Rows, Trial, estimate, study
from .pictures import Drawing, illustrated

PRESETS = {"a": xy_axes.Params(), "b": xy_axes.Params(t1=0.012, t2=0.006626, tau=0.0, gain=1.04167)}
"""Drive constants that agree with the printed limit (docs/physics.md#the-x-and-y-axes); Wu gives none."""

KN = 0.2
KP = 0.54
"""Gain of the stack ``wu``: Kv 30 1/s with the constants (a)."""

CUTTING, RAPID = 8e3 / 60, 1e4 / 60
"""mm/s: 8 and 10 m/min."""

MISMATCH = 1.05


def _apart(distance: float) -> str:
    """A distance in mm that is nothing but rounding, or in nm."""
    return "less than 1 pm" if distance < 1e-9 else f"{1e6 * distance:.2g} nm"


def _kv(kp: float, p: xy_axes.Params) -> float:
    """Velocity gain, 1/s."""
    return kp * KN * p.gain / (p.servo * 1e-3)


# ------------------------------------------------------------------------------------------------- loop and rates


@study("wu", "Two rates and the incremental position error")
def rates(trial: Trial, rows: Rows) -> None:
    """What the machine's servo issues and sees on a circle whose speed changes all the time."""
    way = axes.circle(40.0, axes.from_rest(60.0, 2000, 2400))
    fields = ("x.issued", "x.step", "axes_signals.error_x", "axes_signals.position_x", "axes_signals.velocity_x")
    seen = axes.travelled([(way, PRESETS["a"], wu.Params(kp=KP))], fields)
    issued, step, error, position, velocity = (seen[name][:, 0] for name in fields)
    servo, interpolation = (float(np.median(np.diff(np.flatnonzero(np.diff(a))))) for a in (issued, step))
    increments = np.diff(issued[3::4])
    pairs = [increments[first : first + 2 * ((len(increments) - first) // 2)].reshape(-1, 2) for first in (0, 1)]
    unequal, count = min((float(np.abs(np.diff(halves, axis=1)).max()), len(halves)) for halves in pairs)
    # E_i = E_{i−1} − ΔA_i + ΔO_{i−1}, from the encoder's readings and the issued increments alone.
    instants = slice(3, None, 4)
    e, a, o = error[instants], position[instants], velocity[instants] * 4e-3
    replayed = e[0] + np.cumsum(-np.diff(a) + o[:-1])
    apart = float(np.abs(replayed - e[1:]).max())
    prompt = e[0] + np.cumsum(-np.diff(a) + o[1:])  # the increment of the same instant instead
    whole = float(np.abs(increments).max()) * 2  # all of an interpolated increment in the first of its two interrupts
    rows("servo", servo, holds=servo == 4.0)
    rows("interpolation", interpolation, holds=interpolation == 8.0)
    rows("equal-halves", (count, _apart(unequal)), error=unequal, guess=whole)
    rows("position-error", (len(replayed), _apart(apart)), error=apart, guess=float(np.abs(prompt - e[1:]).max()))


@study("wu", "Lag of a ramp")
def lag(trial: Trial, rows: Rows) -> None:
    """The steady position error at constant speed."""
    speeds = (CUTTING / 4, CUTTING)
    ideal = [p._replace(**IDEAL) for p in PRESETS.values()]
    runs = [(v, p, kp) for v in speeds for p in ideal for kp in (0.2, KP)]
    ways = ((axes.line(axes.from_rest(v, 500, 3000)), p, wu.Params(kp=kp)) for v, p, kp in runs)
    found = axes.travelled(ways, ["axes_signals.error_x"], every=4)["axes_signals.error_x"][-1]
    expected = np.array([v / _kv(kp, p) for v, p, kp in runs])
    off = float(np.abs(found / expected - 1).max())
    at = runs.index((CUTTING, ideal[0], KP))
    kv = _kv(KP, ideal[0])
    rows("lag-as-printed-first", (float(found[at]), kv, CUTTING * kv), holds=abs(found[at] / (CUTTING * kv) - 1) < 0.01)
    error = 100 * (float(found[at]) / (CUTTING / kv) - 1)
    rows("lag-as-printed-next", (float(found[at]), CUTTING / kv), error=error, guess=-100.0)
    guess = 100 * float(np.abs(expected.mean() / expected - 1).max())
    rows("lag-of-type-1", (1e2 * max(off, 1e-6), len(runs)), error=100 * off, guess=guess)
    _moves_and_stops(rows)


def _moves_and_stops(rows: Rows) -> None:
    """What the actual position does while the commanded one moves evenly, and after it has stopped."""
    p = PRESETS["a"]
    speeds = np.concatenate([axes.from_rest(CUTTING, 300, 1500), np.zeros(1500)])
    seen = axes.travelled([(axes.line(speeds), p, wu.Params(kp=KP))], ["x.position", "axes_signals.error_x"])
    x, error = seen["x.position"][:, 0], seen["axes_signals.error_x"][:, 0]
    pace = float((x[1400] - x[1000]) / 0.4)
    rest = 1e3 * float(np.abs(x[-1] - speeds.sum() * 1e-3))
    lag = 1e3 * float(error[1400])
    rows("same-speed", (pace, CUTTING), error=100 * (pace / CUTTING - 1), guess=100 * (RAPID / CUTTING - 1))
    rows("comes-to-rest", rest, error=rest, guess=lag, tolerance=1e3 * p.encoder)


@study("wu", "The loop in the z domain")
def z_domain(trial: Trial, rows: Rows) -> None:
    """A, B, C, D against scipy's zero-order hold, and the difference equation against the machine."""
    t, off = 4e-3, {"first": 0.0, "sum": 0.0, "product": 0.0, "poles": 0.0}
    single, open_loop = np.inf, np.inf  # A of a drive with T1 alone; the cubic of the open loop
    for p in (*PRESETS.values(), xy_axes.Params(tau=0.003)):
        drive = (np.trim_zeros([p.tau, 1.0], "f"), [p.t1 * p.t2, p.t1 + p.t2, 1.0])
        number, under, _ = signal.cont2discrete(drive, t, method="zoh")
        number = number.ravel()
        c, d = np.exp(-t / p.t1), np.exp(-t / p.t2)
        c1, c2 = (p.t1 - p.tau) / (p.t1 - p.t2), (p.tau - p.t2) / (p.t1 - p.t2)
        off["first"] = max(off["first"], abs(number[1] - (1 - c1 * c - c2 * d)))
        off["sum"] = max(off["sum"], abs(-number[2] - (c1 * d + c2 * c - c - d)))
        off["product"] = max(off["product"], abs(-number[2] - (c1 * d + c2 * c - c * d)))
        k = 0.7
        closed = np.polyadd(np.polymul(under, [1, -1]), k * np.append(number[1:], 0.0))
        off["poles"] = max(off["poles"], float(np.abs(closed - xy_axes.characteristic(p, k)).max()))
        single = min(single, abs(number[1] - (1 - c)))
        open_loop = min(open_loop, float(np.abs(closed - xy_axes.characteristic(p, 0.0)).max()))
    # The literal machine's samples in the difference equation of the closed loop.
    p, kp, step = PRESETS["a"]._replace(literal=True, **IDEAL), 1.5, np.ones(700)
    step[:8] = 0.0
    fields = ("axes_signals.error_x", "axes_signals.position_x")
    seen = axes.travelled([(axes.journey(step, 0 * step), p, wu.Params(kp=kp))], fields)
    error, ours = (seen[name][3::4, 0] for name in fields)
    a, b, *_ = xy_axes.z_domain(p)
    k = kp * KN * p.gain
    left = np.convolve(ours, xy_axes.characteristic(p, k))[3 : len(ours)]
    right = np.convolve(error + ours, [0.0, k * a, -k * b, 0.0])[3 : len(ours)]
    apart = float(np.abs(left - right).max())
    rows("z-domain-a", off, error=off["first"], guess=single)
    rows("z-domain-b", off, holds=off["sum"] < 1e-12)
    rows("z-domain-b-corrected", off, holds=off["product"] < 1e-12)
    rows("characteristic-equation", off, error=off["poles"], guess=open_loop)
    rows("sampled-axis", (_apart(apart), len(left)), error=apart, guess=float(np.abs(1.0 - ours[3:]).max()))


def limit_in_time(p: xy_axes.Params, kn: float = KN) -> float:
    """The Kp at which the ringing after a step neither grows nor decays in the simulation, interpolated."""
    around = xy_axes.largest_gain(p) / (kn * p.gain) * np.linspace(0.9, 1.1, 9)
    step = np.ones(2600)
    step[:8] = 0.0
    p = p._replace(**IDEAL)
    way, field = axes.journey(step, 0 * step), "x.summed" if p.literal else "x.position"
    seen = axes.travelled([(way, p, wu.Params(kp=float(kp), kn=kn)) for kp in around], [field])[field] - 1.0
    early, late = (np.abs(seen[k : k + 600]).max(axis=0) for k in (800, 1800))
    return float(np.interp(0.0, np.log(late / early), around))


@study("wu", "Stability of the position loop")
def stability(trial: Trial, rows: Rows) -> None:
    """The largest gain Kp of the literal and of the physical loop, from their poles and from simulated steps."""
    for name, p in PRESETS.items():
        for literal in (True, False):
            q = p._replace(literal=literal)
            limit = xy_axes.largest_gain(q) / (KN * p.gain)
            holds = literal and abs(limit - 4.5) < 0.01
            rows("limit-of-poles", (limit, name), holds, case="literal" if literal else "physical")
            seen = limit_in_time(q)
            holds = literal and abs(seen - 4.5) < 0.05
            rows("limit-in-time", (seen, name, "literal" if literal else "physical"), holds)


def frequency_response(p: xy_axes.Params, kp: float, hertz: np.ndarray) -> np.ndarray:
    """Position over issued reference of the physical loop at its servo instants."""
    z = np.exp(2j * np.pi * hertz * p.servo * 1e-3)
    m, one = xy_axes.physical_loop(p, kp * KN * p.gain), np.array([0.0, 0.0, 1.0])
    return np.array([1.0 - (s - 1.0) * np.linalg.solve(s * np.eye(3) - m, one)[2] for s in z])


def bandwidth(p: xy_axes.Params, kp: float) -> float:
    """Hz at which that response falls 3 dB below 1."""
    hertz = np.linspace(0.05, 60.0, 4000)
    return float(hertz[np.argmax(np.abs(frequency_response(p, kp, hertz)) < np.sqrt(0.5))])


@study("wu", "Overshoot and sampling rate")
def response(trial: Trial, rows: Rows) -> list[Drawing]:
    """Steps of many gains, and the bandwidth that goes with them."""
    kps = np.round(np.arange(0.10, 1.5001, 0.02), 2)
    step = np.ones(1500)
    step[:8] = 0.0
    shown: dict[float, np.ndarray] = {}
    for name, p in PRESETS.items():
        q = p._replace(**IDEAL)
        there = axes.journey(step, step)
        seen = axes.travelled([(there, q, wu.Params(kp=float(kp))) for kp in kps], ["x.position", "y.position"])
        x, y = seen["x.position"], seen["y.position"]
        over = x.max(axis=0) - 1.0
        largest = float(kps[over <= 1e-3].max())
        at = int(np.argmin(np.abs(kps - KP)))
        if name == "a":
            shown = {kp: x[:, int(np.argmin(np.abs(kps - kp)))] for kp in (0.2, KP, 1.0)}
            apart = float(np.abs(x - y).max())
            rows("matched-axes", (_apart(apart), len(kps)), holds=apart < 1e-9)
        rows("no-overshoot", (largest, name, largest / 4.5, _kv(KP, p), KP, over[at]), holds=largest < 4.5)
        ratio, fast = 250.0 / bandwidth(p, KP), 250.0 / bandwidth(p, largest)
        holds = ratio >= 7.0 and fast >= 7.0
        rows("sampling-rate", (ratio, fast, KP, largest, name, 250 / ratio, 250 / fast), holds)
    return [_steps(shown)]


@illustrated("Wu §4, §6.1", words={"KP": KP})
def _steps(ax: Axes, shown: dict[float, np.ndarray]) -> None:
    """Step of 1 mm, constants (a), slide that integrates its velocity. Kp 0.2 does not overshoot; the stack wu's {KP}
    does, and all are far below the printed limit of 4.5."""
    ax.axhline(1.0, color=QUIET, lw=0.8)
    for (kp, x), colour in zip(shown.items(), COLOURS, strict=False):
        ax.plot(np.arange(len(x[:500])), x[:500], color=colour, label=f"Kp {kp:g} (Kv {_kv(kp, PRESETS['a']):.0f} 1/s)")
    ax.set(xlabel="time, ms", ylabel="position, mm", xlim=(0, 500))
    ax.legend(frameon=False)


# ---------------------------------------------------------------------------------------- simulation findings (§5)


def settled(turns: float, radius: float, speed: float) -> int:
    """Periods of so many turns."""
    return int(turns * 2e3 * np.pi * radius / speed)


def distorted(
    radius: float, speed: float, runs: list[tuple[float, dict[str, Any], dict[str, Any]]], kv: float = 30.0
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Angle (rad) and radial error (mm) of the last turn of circles on ideal axes.

    Args:
        radius: mm.
        speed: mm/s.
        runs: sense (1: counter-clockwise), relative gains of the drives, relative gains of the law.
        kv: velocity gain, 1/s.
    """
    turn, p = settled(1.0, radius, speed), PRESETS["a"]._replace(**IDEAL)
    speeds = axes.from_rest(speed, turn // 2, int(2.6 * turn))
    kp = axes.gain(kv, p)
    ways = ((axes.circle(radius, speeds, s), p._replace(**own), wu.Params(kp=kp, **law)) for s, own, law in runs)
    seen = axes.travelled(ways, ["x.position", "y.position"])
    x, y = seen["x.position"][-turn:], seen["y.position"][-turn:]
    return [(np.arctan2(y[:, i], x[:, i]), np.hypot(x[:, i], y[:, i]) - radius) for i in range(len(runs))]


def harmonics(angle: np.ndarray, error: np.ndarray, most: int = 4) -> np.ndarray:
    """Amplitudes of the radial error's mean and harmonics 1 … ``most`` over the angle, mm."""
    columns = [np.ones_like(angle)]
    for k in range(1, most + 1):
        columns += [np.cos(k * angle), np.sin(k * angle)]
    found, *_ = np.linalg.lstsq(np.stack(columns, axis=1), error, rcond=None)
    return np.append(abs(found[0]), np.hypot(found[1::2], found[2::2]))


@study("wu", "Finding 1: equal gains")
def equal_gains(trial: Trial, rows: Rows) -> None:
    """Lines and arcs at constant and varying feed when all four directions have the same gain."""
    p = PRESETS["a"]
    law, angle = wu.Params(kp=KP), np.pi / 6
    steady = axes.from_rest(CUTTING, 300, 2500)
    varying = steady * (0.75 + 0.25 * np.cos(2 * np.pi * np.arange(len(steady)) / 400))
    weaker: dict[str, Any] = {"x_plus": MISMATCH, "x_minus": MISMATCH}
    ways = [(axes.line(way, angle), q, law) for q in (p, p._replace(**weaker)) for way in (steady, varying)]
    seen = axes.travelled(ways, ["x.position", "y.position"])
    beside = 1e3 * np.abs(seen["y.position"] * np.cos(angle) - seen["x.position"] * np.sin(angle)).max(axis=0)
    for i, text in enumerate(("constant speed", "speed varying between 4 and 8 m/min")):
        rows("line-offset", (float(beside[i]), text), error=float(beside[i]), guess=float(beside[i + 2]), case=text)
    te = p.t1 + p.t2 - p.tau + 2e-3  # a held servo period adds half of itself where the velocity is integrated
    kv = _kv(KP, p)
    for radius, speed in ((60.0, 30.0), (50.0, CUTTING), (10.0, CUTTING)):
        (_, error), (_, uneven) = distorted(radius, speed, [(1.0, {}, {}), (1.0, weaker, {})])
        shift, ripple = 1e3 * float(error.mean()), 1e3 * float(np.ptp(error))
        formula = -1e3 * speed**2 / radius * (1 / (2 * kv**2) - te / kv)
        rows(
            "arc-radius",
            (shift, ripple, radius, speed * 0.06, formula, speed / radius / kv),
            error=1e3 * float(np.abs(error).max()),
            guess=1e3 * float(np.abs(uneven).max()),
            case="grows" if abs(shift) >= 50.0 else "within",
        )


CASES: dict[str, tuple[float, dict[str, Any], str]] = {
    "a": (1.0, {"x_minus": 1 / MISMATCH}, "ccw, Ky± = Kx+ > Kx−"),
    "b": (-1.0, {"x_plus": 1 / MISMATCH, "x_minus": 1 / MISMATCH}, "cw, Ky± > Kx±"),
    "c": (-1.0, {"x_minus": 1 / MISMATCH}, "cw, Ky± = Kx+ > Kx−"),
    "d": (1.0, {"y_plus": 1 / MISMATCH, "y_minus": 1 / MISMATCH}, "ccw, Kx± > Ky±"),
}
"""Wu Fig. 5, its four inscriptions in order: sense, drive gains, text."""


@study("wu", "Finding 2: unequal gains")
def unequal_gains(trial: Trial, rows: Rows) -> list[Drawing]:
    """Offset of lines, distortion of circles, Fig. 5, and what correcting the gains in the law does."""
    radius, speed, kv = 60.0, 30.0, 30.0
    p = PRESETS["a"]._replace(**IDEAL)
    stronger: dict[str, Any] = {"x_plus": MISMATCH, "x_minus": MISMATCH}
    expected = speed / 2 * abs(1 / (kv * MISMATCH) - 1 / kv)
    way = axes.line(axes.from_rest(speed, 300, 2500), np.pi / 4)
    run = (way, p._replace(**stronger), wu.Params(kp=axes.gain(kv, p)))
    seen = axes.travelled([run], ["x.position", "y.position"], every=50)
    offset = float(abs(seen["y.position"][-1, 0] - seen["x.position"][-1, 0]) / np.sqrt(2))
    back = {"x_plus": 1 / MISMATCH, "x_minus": 1 / MISMATCH}
    cases = [(1.0, {}, {}), (1.0, stronger, {}), (1.0, stronger, back)]
    cases += [(sense, drive, {}) for sense, drive, _ in CASES.values()]
    matched, uneven, mended, *four = distorted(radius, speed, cases, kv)
    waves = 1e3 * harmonics(*uneven)
    rest = 1e3 * harmonics(*mended)[2]
    rows("unequal-line", (1e3 * offset, 1e3 * expected), holds=abs(offset / expected - 1) < 0.03)
    others, guess = (float(1 - waves[k] ** 2 / (waves[1:] ** 2).sum()) for k in (2, 1))
    figures = waves, max(waves[1], waves[3], waves[4]), radius, 1e3 * expected
    rows("twice-the-frequency", figures, error=others, guess=guess)
    rows("software-correction", (waves, max(rest, 1e-3)), holds=rest < 0.01 * waves[2])
    level = matched[1].mean()
    shapes = {}
    for (key, (sense, drive, text)), (angle, error) in zip(CASES.items(), four, strict=True):
        shapes[key] = (angle, error - level)
        basis = np.stack([np.cos(2 * angle), np.sin(2 * angle), np.ones_like(angle)], axis=1)
        (even, odd, _), *_ = np.linalg.lstsq(basis, error, rcond=None)
        axis = float(np.rad2deg(0.5 * np.arctan2(odd, even)) % 180)
        change = np.abs(error - level)
        upper = np.sin(angle) > 0
        # The half travelled towards −x: above counter-clockwise, below clockwise; away from where x turns.
        minus = (upper if sense > 0 else ~upper) & (np.abs(np.sin(angle)) > 0.3)
        plus = (~upper if sense > 0 else upper) & (np.abs(np.sin(angle)) > 0.3)
        both = "x_plus" in drive or "y_plus" in drive
        if both:
            fine = abs((axis - (135.0 if (key in "bd") else 45.0) + 90) % 180 - 90) < 3
            result, case = f"ellipse, long axis at {axis:.0f}°", "both"
        else:
            fine = change[minus].max() > 20 * change[plus].max()
            result = f"travelled to −x {1e3 * change[minus].max():.2g} µm, to +x {1e3 * change[plus].max():.1g} µm"
            case = "upper" if sense > 0 else "lower"
        rows("fig-5", (result, key, text), holds=fine, case=case)
    _matched_stack(trial, rows)
    return [_circles(shapes=shapes, radius=radius)]


def _matched_stack(trial: Trial, rows: Rows) -> None:
    """``wu`` and ``wu-matched`` on the scenario with unequal axes, and ``wu`` with equal ones."""
    scenario = scenarios.load("contour-mismatch")
    equal = scenario.varied(gantry=dict.fromkeys(("x_plus", "x_minus", "y_plus", "y_minus"), 1.0))
    plain, matched = (_contour(name, scenario, trial)["contour_rms"] for name in ("wu", "wu-matched"))
    ideal = _contour("wu", equal, trial)["contour_rms"]
    share = 1.0 - (ideal / plain) ** 2
    rows("matched-stack", (estimate(plain, "µm"), estimate(matched, "µm")), holds=np.median(matched - plain) < 0)
    case = "open" if estimate(100 * share).low < 50 else "settled"
    figures = 100 * share, estimate(plain, "µm"), estimate(ideal, "µm")
    rows("share-of-gains", figures, holds=np.median(share) > 0.5, case=case)


def _contour(name: str, scenario: Scenario, trial: Trial) -> dict[str, np.ndarray]:
    """Metrics of the jobs of a scenario under a stack of the slot ``xy``."""
    seeds = list(scenarios.SPLITS["test"])[: trial.seeds]
    fleet, job, _ = jobs.roll(scenario, stacks.team(stacks.get(name)), seeds)
    return job_metrics.evaluate(job_metrics.Jobs.of(fleet, job))


TIMES = 300.0
"""By which Fig. 5 exaggerates radial errors."""


@illustrated(
    "Wu Fig. 5 (its four inscriptions; the drawings themselves are not available)",
    4,
    height=2.75,
    sharey=True,
    words={"TIMES": f"{TIMES:g}"},
)
def _circles(*panels: Axes, shapes: dict[str, tuple[np.ndarray, np.ndarray]], radius: float) -> None:
    """Circles of R 60 mm at 1.8 m/min, Kv 30 1/s, with gains that differ by 5 %; radial errors × {TIMES}, dashed: equal
    gains; arrows: sense of travel. A gain that is weaker in one direction bulges or flattens only the half travelled
    that way; a weaker axis makes an ellipse along a diagonal."""
    circle = np.linspace(0, 2 * np.pi, 400)
    for ax, (key, (angle, error)) in zip(panels, shapes.items(), strict=True):
        sense, _, text = CASES[key]
        ax.plot(radius * np.cos(circle), radius * np.sin(circle), color=QUIET, lw=0.8, ls="--")
        order = np.argsort(angle)
        theta, r = angle[order], radius + TIMES * error[order]
        ax.plot(r * np.cos(theta), r * np.sin(theta), color=COLOURS[0 if sense > 0 else 1])
        left, right = (-sense * 9, 0.55 * radius), (sense * 9, 0.55 * radius)
        ax.annotate("", xy=left, xytext=right, arrowprops={"arrowstyle": "->", "color": QUIET})
        ax.set_title(f"({key}) {text}", fontsize=8)
        ax.set(aspect="equal", xlabel="x, mm", xlim=(-80, 80), ylim=(-80, 80))
        ax.set_xticks([-60, 0, 60])
        if key == "a":
            ax.set(ylabel="y, mm")


@study("wu", "Finding 3: sudden changes of the input")
def sudden_changes(trial: Trial, rows: Rows) -> list[Drawing]:
    """The stack ``wu`` with and without acceleration, deceleration and corner handling."""
    for scenario in ("contour-square", "contour-corners", "contour-gear"):
        results = {name: _contour(name, scenarios.load(scenario), trial) for name in ("wu-no-corners", "wu")}
        for metric, text in (("contour_max", "largest"), ("contour_rms", "RMS")):
            without, with_ = (results[name][metric] for name in ("wu-no-corners", "wu"))
            times = estimate(without / with_, digits=2)
            took = (np.median(results[name]["time"]) for name in ("wu-no-corners", "wu"))
            figures = estimate(without, "µm"), estimate(with_, "µm"), scenario, text, times
            rows("corner-handling", (*figures, *took), holds=np.median(without - with_) > 0)
    return [_corner()]


@illustrated("Wu §5.3", 2)
def _corner(path: Axes, detail: Axes) -> None:
    """Left: a corner of contour-square (seed 1000). Right: contour error along the whole cut, left of the path
    positive. At constant feed the corner is cut short and the axes swing afterwards; slowed down, they overrun it less
    and settle sooner."""
    scenario = scenarios.load("contour-square")
    for name, colour in (("wu-no-corners", COLOURS[1]), ("wu", COLOURS[0])):
        frame = jobs.traced(scenario, stacks.team(stacks.get(name)), 1000)
        cut = frame[frame["phase"] == 4]
        x, y = cut["x"].to_numpy(), cut["y"].to_numpy()
        path.plot(x, y, color=colour, lw=1.0, label=name)
        along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
        detail.plot(along, 1e3 * cut["error"], color=colour, lw=1.0, label=name)
    top, right = float(y.max()), float(x.max())
    path.set(xlabel="x, mm", ylabel="y, mm", xlim=(right - 4, right + 0.8), ylim=(top - 4, top + 0.8), aspect="equal")
    detail.set(xlabel="way along the cut, mm", ylabel="contour error, µm")
    path.legend(frameon=False, loc="lower left")


# ------------------------------------------------------------------------------------------- the drive at low speed


SPEEDS = (0.1, 0.2, 0.5, 1.0, 2.0, 4.0, 8.0)
"""m/min, feeds of circles."""

CONVERTERS = (8, 12, 16)
"""Bits of the converter that tells the drive its speed; its step is the slowest motion that the drive is told."""

SMALL = 10.0
"""mm, radius of those circles."""


def out_of_round(speed: float, bits: Sequence[int]) -> np.ndarray:
    """Peak to valley of the radius over a circle's last turn, µm, for drives whose speed command has so many bits.

    Constants (b), encoder of 1 µm, Kv 30 1/s. 0 bits: a converter without steps.

    Args:
        speed: feed, m/min.
        bits: of each drive.
    """
    p = PRESETS["b"]._replace(encoder=1e-3)
    drives = [p._replace(dac=RAPID / 2 ** (n - 1) if n else 0.0) for n in bits]
    turn = settled(1.0, SMALL, speed / 0.06)
    speeds = axes.from_rest(speed / 0.06, min(turn, 500), max(1500, turn // 4) + turn)
    way, law = axes.circle(SMALL, speeds), wu.Params(kp=axes.gain(30.0, p))
    seen = axes.travelled([(way, drive, law) for drive in drives], ["x.position", "y.position"])
    return 1e3 * np.ptp(np.hypot(seen["x.position"][-turn:], seen["y.position"][-turn:]), axis=0)


@study("wu", "The drive at low speed")
def low_speed(trial: Trial, rows: Rows) -> list[Drawing]:
    """What the coarseness of the speed that a drive is told does to a circle, from crawling to the largest feed."""
    found = np.array([out_of_round(v, (*CONVERTERS, 0)) for v in SPEEDS])
    smooth = found[:, -1:]
    drive = np.sqrt(np.maximum(found[:, :-1] ** 2 - smooth**2, 0.0))  # what the converter adds
    slow, fast = SPEEDS.index(0.2), SPEEDS.index(8.0)
    steps = [RAPID / 2 ** (n - 1) * 0.06 for n in CONVERTERS]  # m/min
    told = (", ".join(f"{x:.2g}" for x in found[slow, :-1]), ", ".join(f"{n} bits" for n in CONVERTERS))
    rows("low-speed", told, holds=found[slow, 0] > 2 * found[slow, -2])
    holds = drive[slow, 0] > 1.5 * drive[fast, 0]
    rows("low-speed-share", (drive[slow, 0], drive[fast, 0], CONVERTERS, steps, smooth[fast, 0]), holds)
    figures = ", ".join(f"{n} bits {x / 20.0:.2g}" for n, x in zip(CONVERTERS, found[slow], strict=False))
    rows("low-speed-repeatability", figures, holds=found[slow, 0] > 20.0)
    holds = (np.diff(found[slow, : len(CONVERTERS)]) < 0).all()
    rows("better-drive", " → ".join(f"{x:.2g}" for x in found[slow]), holds)
    return [_low_speed(found, steps)]


@illustrated("Wu §6.2")
def _low_speed(ax: Axes, found: np.ndarray, steps: list[float]) -> None:
    """Circles of R 10 mm, encoder of 1 µm. A drive whose speed comes in steps of 1.3 mm/s cannot crawl: below 1 m/min
    it is told to stand still and to go by turns, and the circle suffers most."""
    for i, (bits, colour) in enumerate(zip(CONVERTERS, COLOURS, strict=False)):
        ax.loglog(SPEEDS, found[:, i], "o-", ms=4, color=colour, label=f"{bits} bits, steps of {steps[i]:.2g} m/min")
    ax.loglog(SPEEDS, np.maximum(found[:, -1], 1e-2), ":", color=QUIET, label="no steps")
    ax.axhline(20.0, color=QUIET, ls="--", lw=0.8)
    ax.text(SPEEDS[1], 22.0, "±0.01 mm", color=QUIET, fontsize=9)
    ax.set(xlabel="feed, m/min", ylabel="out of round, peak to valley, µm", ylim=(1e-1, None))
    ax.legend(frameon=False, fontsize=8)


# -------------------------------------------------------------------------------------------------- figures of §1


TARGETS = np.array([0.0, 74.9873, 150.0231, 224.9617, 299.9711])
"""mm, places over 300 mm that are no multiples of a count."""

APPROACHES = (1000, 1300, 1700, 2200, 2800)
"""ms that an approach takes, from either side: from brisk to slow."""

_LEG = 3600  # ms from target to target


def approached(resolution: list[tuple[xy_axes.Params, float]]) -> np.ndarray:
    """Where the slide stands after each approach, mm less the target: (axes, side, approach, target).

    Args:
        resolution: axes with the Kp that gives Kv 30 1/s.
    """
    out, legs = -5.0, []
    stops = [*TARGETS, TARGETS[-1] + 5.0, *TARGETS[::-1], out]
    for move in APPROACHES:
        ease = np.append(0.5 - 0.5 * np.cos(np.pi * (np.arange(move) + 1) / move), np.ones(_LEG - move))
        legs += [a + (b - a) * ease for a, b in zip([out, *stops], stops, strict=False)]
    x = np.concatenate([*legs, np.full(_LEG, out)])  # waits: the last 20 ms are not travelled
    ways = ((axes.journey(x, 0 * x), p, wu.Params(kp=kp)) for p, kp in resolution)
    seen = axes.travelled(ways, ["x.position"], every=_LEG)["x.position"]
    errors = (seen - np.tile(stops, len(APPROACHES))[:, None]).T
    errors = errors.reshape(len(resolution), len(APPROACHES), 2, len(TARGETS) + 1)[..., :-1]
    errors[:, :, 1] = errors[:, :, 1, ::-1].copy()
    return np.swapaxes(errors, 1, 2)


@study("wu", "Accuracy, repeatability and speeds")
def accuracy(trial: Trial, rows: Rows) -> list[Drawing]:
    """What the control's share of the machine's accuracy is: encoder, D/A converter, loop."""
    b = PRESETS["b"]._replace(encoder=0.005)
    choices = {
        "(b): 8-bit D/A, encoder 5 µm": b._replace(dac=RAPID / 2**7),
        "(b): 12-bit D/A, encoder 1 µm": b._replace(dac=RAPID / 2**11, encoder=1e-3),
        "(a): 16-bit D/A, encoder 1 µm": PRESETS["a"],
    }
    errors = approached([(p, axes.gain(30.0, p)) for p in choices.values()])
    _travel(rows)
    for (text, p), e in zip(choices.items(), errors, strict=True):
        worst = float(np.abs(e).max())
        spread = float(np.ptp(e, axis=(0, 1)).max() / 2)
        step = p.dac / 30.0
        rows("position-accuracy", (1e3 * worst, text), holds=worst <= 0.05)
        told = (1e3 * spread, text, 1e3 * step, "; 8 bits cannot hold ±0.01 mm" if spread > 0.01 else "")
        rows("repeatability", told, holds=spread <= 0.01)
    p = PRESETS["a"]
    speeds = (CUTTING, RAPID)
    ways = ((axes.line(axes.from_rest(v, 500, 2500)), p, wu.Params(kp=KP)) for v in speeds)
    seen = axes.travelled(ways, ["x.position", "axes_signals.error_x"])
    for i, (v, text) in enumerate(zip(speeds, ("largest cutting speed", "rapid return"), strict=True)):
        reached = 0.06 * float((seen["x.position"][-1, i] - seen["x.position"][-501, i]) / 0.5)
        holds = abs(reached / (0.06 * v) - 1) < 2e-3
        rows("speeds", (reached, 0.06 * v, seen["axes_signals.error_x"][-1, i], _kv(KP, p)), holds, claim=text)
    return [_approaches(errors=errors, names=list(choices))]


def _travel(rows: Rows) -> None:
    """The machine's travel, and whether it refuses what is larger."""
    g = scenarios.Gantry()
    try:
        drawing_of(scenarios.Job(part="square", size=1200.0), (g.travel_x, g.travel_y))
        refused = False
    except InvalidInput:
        refused = True
    fits = (g.travel_x, g.travel_y) == (1500.0, 1000.0)
    rows("travel", g, holds=fits and refused, case="refused" if refused else "not refused")


@illustrated("Wu §1", 3, sharey=True)
def _approaches(*panels: Axes, errors: np.ndarray, names: list[str]) -> None:
    """Standstill error at five places over 300 mm, five approaches from each side, from brisk to slow; shaded: ±0.01
    mm. With 8 bits the velocity command vanishes within half a D/A step, 22 µm of error, and the slide rests anywhere
    in there."""
    for ax, e, name in zip(panels, errors, names, strict=True):
        ax.axhspan(-10, 10, color="#eceef0", lw=0)
        for side, (marker, text) in enumerate(((">", "towards +x"), ("<", "towards −x"))):
            for k in range(len(APPROACHES)):
                label = text if k == 0 else None
                ax.plot(TARGETS, 1e3 * e[side, k], marker, color=COLOURS[side], ms=5, mfc="none", label=label)
        ax.set_title(name, fontsize=9)
        ax.set(xlabel="target, mm")
    panels[0].set(ylabel="position at rest − target, µm")
    panels[-1].legend(frameon=False)
