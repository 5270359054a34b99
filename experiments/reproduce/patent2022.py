"""Patent2022: three-case control and planned descent."""

import functools
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ...baselines import patent2022 as law
from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.figures import metrics
from ...envs.figures.recording import Recording
from ...envs.plant.controller import PERIOD
from ...envs.scenarios import Scenario
from ..measure.rollout import roll
from ..measure.stability import Injection
from ..plots.palette import COLOURS
from .claims import Rows, Trial, study
from .pictures import Drawing, illustrated

OPEN = "guard.capture=2,guard.plan=1,guard.acceleration=50000,guard.fastest=500,guard.delay=0"
"""The supervisor's own approach planner as good as off, so that the law has to stop by itself."""


def _seeds(trial: Trial) -> range:
    return scenarios.SPLITS["test"][: trial.seeds]


def _run(trial: Trial, scenario: Scenario, controller: str) -> Recording:
    return roll(scenario, stacks.resolve(controller), _seeds(trial), trial.threads)


def _flat(**changes: Any) -> Scenario:
    """A level sheet with the suite's noise, long enough to settle on it."""
    return scenarios.load("flat").varied(duration=4.0, settle=2.0, **changes)


IMPULSES = {"impulses": 20, "impulse_samples": 2}


pictured = functools.partial(illustrated, grid={"alpha": 0.3})


def _mean(record: Recording) -> np.ndarray:
    """Mean true error of each run over its scored periods, µm."""
    return 1e3 * np.where(record.scored, record.error, 0.0).sum(axis=0) / record.scored.sum(axis=0)


def _static(d: np.ndarray, **constants: float) -> np.ndarray:
    """L(d) in mm where the difference stays the same, positive downwards."""
    p = law.Params(**constants)
    return np.array([law.displacement(p, float(x), float(x)) for x in d])


# ---------------------------------------------------------------------------------------------------- the three cases


@study("patent2022", "Three cases: lift, hold, lower")
def three_cases(trial: Trial, rows: Rows) -> list[Drawing]:
    """Which case a period is in, what it does, and what s, r, vs and vm do in it."""
    p = law.Params()
    record = _run(trial, scenarios.load("rough"), "patent2022")
    # The wish of a period answers to the height of the same period.
    d = record.reported_error
    free = record["override"] < 0.5
    lift, lower = free & (d < -p.accuracy - 1e-6), free & (d > p.accuracy + 1e-6)
    hold = free & ~lift & ~lower
    wish = record["wish"].astype(float)
    right = ((wish > 0) & lift).sum(axis=0) + ((wish < 0) & lower).sum(axis=0)
    least = [int(case.sum(axis=0).min()) for case in (lift, hold, lower)]
    moved, risen = (lift | lower).sum(axis=0), lift.sum(axis=0)
    wrong = float((100 * (1 - right / moved)).max()) if min(least) > 0 else np.inf
    guess = float((100 * np.minimum(risen, moved - risen) / moved).max())
    rows("cases", (100 * right / moved, least), error=wrong, guess=guess)

    step = scenarios.load("flat").varied(
        duration=1.4, settle=0.1, sheet={"steps": {"count": 1, "height": 0.3, "spacing": 60.0}}
    )
    sizes, times, lows = (1.0, 5.0, 20.0), [], []
    for s in sizes:
        hit = _run(trial, step, f"patent2022:law.s={s:g},law.lower=0.0001,law.hold=0.0001")
        below = hit.error < -0.1
        times.append(below.sum(axis=0) * PERIOD * 1e3)
        lows.append(np.where(below, hit.error, 0.0).min(axis=0))
    gained = times[0] / times[-1]
    holds = np.all(times[0] > times[1]) and np.all(times[1] > times[2])
    rows("sensitivity", (gained, np.median(times[0]), np.median(times[1]), np.median(times[2])), holds)

    noisy = _flat(head=IMPULSES)
    jitters = [metrics.jitter(_run(trial, noisy, f"patent2022:law.r={r:g}")) for r in (1.0, 4.0, 16.0)]
    told = (jitters[0] / jitters[-1], (1 + 1 / 1) / (1 + 1 / 16), np.sqrt(2) / 2, np.sqrt(1 + 1 / 256) / (17 / 16))
    rows(
        "suppression", told, holds=all(np.median(a) > np.median(b) for a, b in zip(jitters, jitters[1:], strict=False))
    )

    small = np.geomspace(0.02, 1.0, 50)
    power = float(np.polyfit(np.log(small), np.log(_static(small)), 1)[0])
    rows("nearer-smaller", power, error=power - 1.5, guess=-0.5)
    return [_characteristic(), _cases(trial)]


@pictured("Patent2022 ¶ 53–69", 2)
def _characteristic(wide: Axes, near: Axes) -> None:
    """Displacement of a period over a constant height difference (down positive), and the same near the target;
    grey: the hold's band. To the left of it s multiplies the lift; within it and to the right the factor is 0.01"""
    for axes, reach in ((wide, 0.5), (near, 0.03)):
        d = np.linspace(-reach, reach, 2001)
        cases = {
            "s = 1, r = 1": {"s": 1.0},
            "s = 5, r = 1": {},
            "s = 20, r = 1": {"s": 20.0},
            "s = 5, r = 4": {"r": 4.0},
        }
        for i, (label, constants) in enumerate(cases.items()):
            axes.plot(d, 1e3 * _static(d, **constants), color=COLOURS[i], label=label, ls="--" if "4" in label else "-")
        axes.axvspan(-0.01, 0.01, color="0.9", zorder=0)
        axes.set_xlabel("height difference d, mm")
    near.set_ylim(-0.3, 0.1)
    wide.set_ylim(-60, 10)
    wide.set_ylabel("displacement L, µm a period")
    wide.legend()


@pictured("Patent2022 Fig. 1")
def _cases(axes: Axes, trial: Trial) -> None:
    """The three cases on a rough sheet at 200 mm/s, one run: lifts are short, the way down is slow"""
    record = roll(scenarios.load("rough").varied(duration=1.5), stacks.resolve("patent2022"), _seeds(trial)[:1])
    t, d = (np.arange(len(record.data)) + 1) * PERIOD, record.reported_error[:, 0]
    accuracy = law.Params().accuracy
    axes.plot(t, d, color="0.6", lw=1)
    for i, (label, mask) in enumerate(
        {"lift": d < -accuracy, "hold": np.abs(d) <= accuracy, "lower": d > accuracy}.items()
    ):
        axes.plot(t[mask], d[mask], ".", ms=3, color=COLOURS[i], label=label)
    axes.set(xlabel="time, s", ylabel="height difference d, mm")
    axes.legend()


# ---------------------------------------------------------------------------------------------------------- descent


@study("patent2022", "Planned descent and overshoot")
def descent(trial: Trial, rows: Rows) -> list[Drawing]:
    """Down onto the sheet from 4 to 15 mm above the set height, the supervisor's own planner off."""
    case, p = scenarios.load("descent"), law.Params()
    planned = _run(trial, case, f"patent2022:{OPEN}")
    plain = _run(trial, case, f"pid:{OPEN}")
    supervised = _run(trial, case, "pid")
    speed = -planned["command"].astype(float)
    d = planned.reported_error
    far = planned["height"] >= p.range
    bound = np.minimum(np.sqrt(2 * p.acceleration * np.maximum(d, 1e-9)), p.fastest)
    beyond = planned["gap"][0] > p.range + p.fastest**2 / (2 * p.acceleration) + 0.5  # room to come up to speed
    most = np.where(far, speed / bound, 0.0).max(axis=0)[beyond]
    rise = np.diff(speed, axis=0, prepend=0.0)
    steepest = np.where(far, rise, 0.0).max(axis=0)[beyond] / PERIOD
    paced = np.all(steepest < 1.001 * p.acceleration) and np.all(most <= 1.0 + 1e-3)
    off_pace = float(100 * np.abs(most - 1.0).max()) if paced else np.inf
    high = plain["height"] >= p.range
    allowed = np.minimum(np.sqrt(2 * p.acceleration * np.maximum(plain.reported_error, 1e-9)), p.fastest)
    share = np.where(high, -plain["command"].astype(float) / allowed, 0.0).max(axis=0)[beyond]
    off_plain = float(100 * np.abs(share - 1.0).max())
    over, over_plain = 1e3 * metrics.overshoot(planned), 1e3 * metrics.overshoot(plain)
    over_supervised = 1e3 * metrics.overshoot(supervised)
    arrival = np.argmax(np.abs(planned.error) < 0.1, axis=0) * PERIOD
    reaches = (np.abs(planned.error[-1]) < 0.02).all()
    rows("approach", (100 * most, p, beyond.sum(), len(beyond), steepest.max()), error=off_pace, guess=off_plain)
    error = float(over.max()) if reaches and not planned.collided.any() else np.inf
    guess = float(np.median(over_plain))
    rows("no-overshoot", (over, over.max(), planned.collided.sum(), np.median(arrival)), error=error, guess=guess)
    told = (over_plain, plain.collided.sum(), plain, np.median(over_supervised), supervised.collided.sum())
    rows("pid-overshoots", told, holds=np.median(over_plain) > 10 * max(1.0, np.median(over)))

    @pictured("Patent2022 ¶ 63–69", 2)
    def descent(gap: Axes, pace: Axes) -> None:
        """A descent from the highest start: gap and velocity; dotted: range h_max, dashed: set height. The plain PID
        hits the sheet and the supervisor retracts it"""
        which = int(np.argmax(planned["gap"][0]))
        t = (np.arange(len(planned.data)) + 1) * PERIOD
        shown = {"patent2022": planned, "pid, no planner": plain, "pid, supervisor's planner": supervised}
        for i, (label, record) in enumerate(shown.items()):
            gap.plot(t, record["gap"][:, which], color=COLOURS[i], label=label)
            pace.plot(t, record["velocity"][:, which], color=COLOURS[i])
        gap.axhline(p.range, color="0.6", ls=":", lw=1)
        gap.axhline(planned.set_height[which], color="0.6", ls="--", lw=1)
        gap.set(xlabel="time, s", ylabel="true gap, mm", xlim=(0, 1.2), ylim=(-1, 17))
        pace.set(xlabel="time, s", ylabel="velocity of the head, mm/s", xlim=(0, 1.2))
        gap.legend()

    return [descent()]


# ---------------------------------------------------------------------------------------------------- noise in the hold


class _Planner:
    """Velocity planning alone (¶ 2): each period the largest speed that the remaining distance allows."""

    def reset(self) -> None:
        pass

    def control(self, signals: Any) -> float:
        d = signals.height - signals.set_height
        return float(-np.sign(d) * law.allowed(law.Params(), d))


@study("patent2022", "Chatter")
def chatter(trial: Trial, rows: Rows) -> list[Drawing]:
    """What the feedback's noise does to the axis on a level sheet, against a plain PID and velocity planning alone."""
    flat, noisy = _flat(), _flat(head=IMPULSES)
    still = _run(trial, flat, "patent2022")
    without = _run(trial, flat, "patent2022:law.smallest=0")
    held = (np.where(r.scored, r["wish"] == 0.0, 0.0).sum(axis=0) / r.scored.sum(axis=0) for r in (still, without))
    none, before = held
    guess = float((100 * (1 - before)).min())
    error = float((100 * (1 - none)).max())
    rows("hold", (100 * none, 1e6 * law.Params().smallest, 100 * np.median(before)), error=error, guess=guess)
    own = _run(trial, noisy, "patent2022")
    pid = _run(trial, noisy, "pid")
    few = _seeds(trial)[: max(6, trial.seeds // 3)]
    planner = roll(noisy, stacks.python_stack(_Planner, "planner"), few, trial.threads)
    jitter = {name: metrics.jitter(r) for name, r in (("own", own), ("pid", pid), ("planner", planner))}
    ratio = jitter["pid"] / jitter["own"]
    rows("less-chatter", ratio, holds=np.all(ratio > 1.0))
    ratio = jitter["planner"] / jitter["own"][: len(jitter["planner"])]
    quiet = _flat(head={"noise": 0.0, "jitter": 0.0, "impulses": 0.0})
    alone = metrics.jitter(roll(quiet, stacks.python_stack(_Planner, "planner"), _seeds(trial)[:6], trial.threads))
    rows("planning-chatters", (ratio, np.median(alone), np.median(jitter["planner"])), holds=np.all(ratio > 1.0))

    # The same quietness from a plain P law that follows as badly, or as well.
    wavy = scenarios.load("wavy").varied(head=IMPULSES)
    target = metrics.rms_true(_run(trial, wavy, "patent2022"))
    gains = np.array([5.0, 7.0, 10.0, 14.0, 20.0, 28.0, 40.0])
    plain = [f"xi2023-improved:law.kv={kv:g}" for kv in gains]
    following = np.array([np.sqrt(np.mean(metrics.rms_true(_run(trial, wavy, c)) ** 2)) for c in plain])
    shakes = np.array([metrics.jitter(_run(trial, noisy, c)) for c in plain])
    kv = float(np.exp(np.interp(-np.log(np.sqrt(np.mean(target**2))), -np.log(following), np.log(gains))))
    same = np.array([np.interp(np.log(kv), np.log(gains), column) for column in shakes.T])
    holds = np.median(same / jitter["own"]) > 1.0
    rows("as-good-a-pid", (same / jitter["own"], np.sqrt(np.mean(target**2)), kv), holds)

    @pictured("Patent2022 ¶ 2", 2)
    def chatter(left: Axes, right: Axes) -> None:
        """Commands on a level sheet with 20 impulses a second, the same run"""
        t = (np.arange(len(own.data)) + 1) * PERIOD
        left.plot(t, planner["command"][:, 0], color=COLOURS[2], lw=0.8, label="velocity planning alone")
        right.plot(t, pid["command"][:, 0], color=COLOURS[1], lw=0.8, label="pid")
        right.plot(t, own["command"][:, 0], color=COLOURS[0], lw=1.2, label="patent2022")
        for axes, end in ((left, 2.3), (right, 3.0)):
            axes.set(xlabel="time, s", ylabel="command, mm/s", xlim=(2.0, end))
            axes.legend(loc="upper right")

    return [chatter()]


# ------------------------------------------------------------------------------------------------- what s and 0.01 cost


@study("patent2022", "Loop gain and rectified noise")
def gain(trial: Trial, rows: Rows) -> list[Drawing]:
    """How much follows from the printed 0.01, and what a sensitivity that acts one way does to the mean."""
    d = np.geomspace(1e-3, 5.0, 200)
    slope = _static(d, accuracy=1e-4, smallest=0.0) / d / PERIOD
    largest = float(slope.max())
    below = d < 1.0
    power = float(np.polyfit(np.log(d[below]), np.log(slope[below]), 1)[0])
    tones = np.array([0.5, 1.0, 2.0, 5.0])
    response = Injection(stacks.resolve("patent2022"), tones, settle=2.0, window=4.0, threads=trial.threads).measure(
        stacks.resolve("patent2022")
    )
    wavy = metrics.rms_true(_run(trial, scenarios.load("wavy"), "patent2022"))
    told = (largest, np.sqrt(np.mean(wavy**2)), ", ".join(f"{x:.2f}" for x in response.worst))
    rows("factor-of-a-hundredth", told, holds=np.sqrt(np.mean(wavy**2)) < 20.0)
    rows("adaptation", power, error=power - 0.5, guess=-0.5)
    sizes = (1.0, 5.0, 20.0, 100.0)
    noisy = _flat(head=IMPULSES)
    means = [_mean(_run(trial, noisy, f"patent2022:law.s={s:g}")) for s in sizes]
    rows(
        "rectified-noise",
        (means[2], ", ".join(f"s = {s:g}: {np.median(m):.1f} µm" for s, m in zip(sizes, means, strict=True))),
        holds=np.median(means[2]) > 2.0
        and all(np.median(b) > np.median(a) for a, b in zip(means, means[1:], strict=False)),
    )

    @pictured("Patent2022 ¶ 53–69", 2, grid={"alpha": 0.3, "which": "both"})
    def gain(left: Axes, right: Axes) -> None:
        """Left: loop gain as printed over the height difference. Right: mean true error on a level sheet under impulses
        over s, median and 10 to 90 % of the runs"""
        left.loglog(d, slope, color=COLOURS[0], label="r = 1")
        left.loglog(d, _static(d, accuracy=1e-4, smallest=0.0, r=10.0) / d / PERIOD, color=COLOURS[1], label="r = 10")
        left.set(xlabel="height difference d > 0, mm", ylabel="loop gain L/(d·T), 1/s")
        left.legend()
        low, high = (np.array([np.quantile(m, q) for m in means]) for q in (0.1, 0.9))
        middle = np.array([np.median(m) for m in means])
        right.errorbar(sizes, middle, [middle - low, high - middle], color=COLOURS[0], marker="o", capsize=3)
        right.set(xlabel="sensitivity s", ylabel="mean true error, µm", xscale="log")

    return [gain()]
