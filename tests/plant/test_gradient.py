"""The roll-out of drive and loop: its bits against the machine's, its gradients against finite differences and a closed
form."""

import functools
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy import signal

import kerfgym
from kerfgym.baselines import pid
from kerfgym.envs.control.stack import resolve
from kerfgym.envs.engine.lanes import fields
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import weighed, z_axis
from kerfgym.envs.plant.controller import Sensed
from kerfgym.envs.plant.rollout import Loop, Motion, Run, Seen, Sent, Start, Surface, at_rest
from kerfgym.envs.plant.z_axis import Params
from kerfgym.envs.scenarios import load
from kerfgym.experiments.measure.rollout import fleet_for

PERIODS, MACHINES = 40, 1024
STEPS = (1e-3, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6)


class Replay:
    """The law that repeats recorded commands."""

    class Params(NamedTuple):
        unused: float = 0.0

    class State(NamedTuple):
        unused: float = 0.0

    class Recorded(NamedTuple):
        command: float = 0.0

    @staticmethod
    def weigh(params, state, seen, recorded):
        return state, recorded.command


class OnSheet:
    """A classical law on a sheet that does not depend on it."""

    Params, State = pid.Params, pid.State

    class Recorded(NamedTuple):
        sheet: float = 0.0

    @staticmethod
    def weigh(params, state, seen, recorded):
        x = _SENSED._replace(height=seen.head_position - recorded.sheet)
        return pid.control(params, state, x, 0)


_SENSED = Sensed(set_height=1.0, captured=True, fresh=False)

# ------------------------------------------------------------------------------------------- the way there


@functools.cache
def lived() -> tuple[Run, dict[str, np.ndarray]]:
    """A fleet whose axes meet everything, and the roll-out under its commands; channels (periods, machines)."""
    rng, size, periods = np.random.default_rng(3), 70, 400
    stack = resolve("pid:law.kp=250,law.kd=0.8")

    def change(fleet):
        every = np.arange(size)
        draws = {
            "dead_time": rng.uniform(0, 5.9, size), "omega": rng.uniform(300, 900, size),
            "friction": rng.uniform(0, 1500, size), "stiction": rng.uniform(1, 1.6, size),
            "bristle": np.where(every % 2, rng.uniform(1e-3, 1e-2, size), 0.0),
            "backlash": rng.uniform(0, 0.02, size), "compliance": rng.uniform(0, 0.4, size),
            "speed": rng.choice([12.0, 500.0], size), "acceleration": rng.choice([900.0, 1e5], size),
            "jerk": rng.choice([1e5, 1e8], size), "low": np.where(every % 7, -40.0, 0.75),
        }  # fmt: skip
        for name, values in draws.items():
            fleet.set(f"z.{name}", every, values)
        fleet.set("gate.length", every, rng.choice([0.25, 0.5, 1.0], size))

    fleet = fleet_for(load("step").varied(duration=periods * 1e-3), stack, np.arange(1000, 1000 + size), 1, change)
    column = {name: [] for name in ("course.surface", "course.slope", "course.bend", "signals.command", "moment.gap",
                                    "signals.head_position", "motion.position", "motion.velocity", "motion.play",
                                    "motion.acceleration")}  # fmt: skip
    axis = Params(*(fleet.column(f"z.{name}") for name in Params._fields))
    z = z_axis.State(*(fleet.column(f"motion.{name}") for name in z_axis.State._fields))
    drive = z_axis.Drive(*(fleet.column(f"drive.{name}") for name in z_axis.Drive._fields))
    start = Start(Motion(z, drive, Seen(fleet.column("signals.head_position"))), Replay.State())
    for _ in range(periods):
        fleet.advance()
        for name, values in column.items():
            values.append(fleet.column(name))
    kept = {name: np.array(values) for name, values in column.items()}
    course = Surface(kept["course.surface"], kept["course.slope"], kept["course.bend"])
    recorded = Replay.Recorded(kept["signals.command"])
    run = Loop(Replay, threads=2).forward(axis, Replay.Params(), recorded, course, start, fleet.column("gate.length"))
    kept["after"] = np.array([fleet.column(f"motion.{name}") for name in z_axis.State._fields])
    kept["speed"], kept["acceleration"], kept["low"] = axis.speed, axis.acceleration, axis.low
    return run, kept


def test_the_way_there_has_the_machines_bits():
    run, kept = lived()
    np.testing.assert_array_equal(run.gap, kept["moment.gap"])
    np.testing.assert_array_equal(run.position, kept["signals.head_position"])
    np.testing.assert_array_equal(np.array(run.after.motion.axis), kept["after"])


def test_the_machines_of_that_comparison_meet_their_limits():
    _, kept = lived()
    assert (np.abs(kept["signals.command"]) > kept["speed"]).any()
    assert (np.abs(kept["motion.acceleration"]) > 0.999 * kept["acceleration"]).any()
    assert (kept["motion.play"] > 0).any()
    assert np.ptp(kept["moment.gap"]) > 0.1


# --------------------------------------------------------------------------------------------- the way back


def drawn(rng: np.random.Generator, size: int) -> Params:
    """Axes with every part of the model, without the resolutions of D/A and encoder."""
    bristle = np.where(rng.random(size) < 0.5, rng.uniform(1e-3, 1e-2, size), 0.0)
    return Params(
        dead_time=rng.uniform(0, 5.9, size), dac=0.0, encoder=0.0, omega=rng.uniform(300, 900, size),
        zeta=rng.uniform(0.5, 1.0, size), friction=rng.uniform(10, 1500, size), bristle=bristle,
        stiction=rng.uniform(1, 1.6, size), compliance=rng.uniform(0, 0.3, size), jerk=rng.uniform(2e5, 4e6, size),
        acceleration=rng.uniform(3000, 2e4, size), speed=rng.uniform(20, 500, size),
        backlash=rng.uniform(0, 0.02, size),        low=np.where(rng.random(size) < 0.8, -40.0, 0.95),
    )  # fmt: skip


def moved(value, direction, h):
    """A NamedTuple of arrays, moved by ``h`` times a direction, where there is one."""
    return value._replace(**{name: getattr(value, name) + h * d for name, d in direction.items()})


def worst(value, gradient, size: int) -> np.ndarray:
    """Least relative difference of ``gradient(0)`` from differences of ``value(h)``, each of shape (machines,), among
    steps within which no branch is taken otherwise: there the gradient goes straight. NaN: there is none.

    A gradient that happens to be a hundredth of the others counts as large as that: differences are not better."""
    wanted, best = gradient(0.0), np.full(size, np.nan)
    scale = np.maximum(np.abs(wanted), 0.01 * np.median(np.abs(wanted)))
    for h in STEPS:

        def cut(h):
            return (value(h) - value(-h)) / (2 * h)

        found = (4 * cut(h / 2) - cut(h)) / 3
        bends = [np.abs(gradient(s) - 2 * gradient(s / 2) + wanted) for s in (h, -h)]
        best = np.where(np.max(bends, axis=0) < 1e-5 * scale, np.fmin(best, np.abs(found - wanted) / scale), best)
    return best


@functools.cache
def scene():
    """1000 random machines, each for 40 periods from a state amid motion."""
    rng = np.random.default_rng(0)
    axis, shape = drawn(rng, MACHINES), (PERIODS, MACHINES)
    recorded = weighed.Recorded(
        fed=30 * rng.normal(size=shape), sheet=0.1 * rng.normal(size=shape), gain=rng.uniform(20, 80, shape),
        share=rng.uniform(0, 1, shape), behind=rng.uniform(0, 7, shape),
    )  # fmt: skip
    surface, loop = Surface(0.0, 0.0, np.zeros(shape)), Loop()
    start = loop.forward(axis, weighed.Params(), recorded, surface).after
    weights = [rng.normal(size=shape), 1e-3 * rng.normal(size=shape), rng.normal(size=shape)]

    def forward(axis=axis, recorded=recorded, start=start, keep=False):
        return loop.forward(axis, weighed.Params(), recorded, surface, start, keep=keep)

    def value(**given):
        run = forward(**given)
        return (weights[0] * run.gap + weights[1] * run.command + weights[2] * run.position).sum(axis=0)

    def backward(by_axis=False, **given):
        return loop.backward(forward(keep=True, **given), *weights, axis=by_axis)

    return rng, axis, recorded, start, value, backward


def enough(found: np.ndarray) -> bool:
    """Nearly all machines have a step without a branch, and all of these agree."""
    return bool(np.mean(np.isfinite(found)) > 0.98 and np.nanmax(found) < 1e-6)


def test_gradients_by_what_the_law_is_given_are_those_of_differences():
    rng, _, recorded, _, value, backward = scene()
    direction = {name: rng.normal(size=(PERIODS, MACHINES)) for name in weighed.Recorded._fields}

    def along(h):
        found = backward(recorded=moved(recorded, direction, h)).recorded
        return sum((getattr(found, name) * d).sum(axis=0) for name, d in direction.items())

    assert enough(worst(lambda h: value(recorded=moved(recorded, direction, h)), along, MACHINES))


def test_gradients_by_the_state_at_the_start_are_those_of_differences():
    rng, _, _, start, value, backward = scene()
    scale = {"position": 1e-2, "velocity": 1.0, "acceleration": 100.0, "mode": 1e-2, "mode_velocity": 1.0}
    direction = {name: size * rng.normal(size=MACHINES) for name, size in scale.items()}
    drive = {name: rng.normal(size=MACHINES) for name in z_axis.Drive._fields}
    sent = {name: rng.normal(size=MACHINES) for name in Sent._fields}

    def at(h):
        m = start.motion
        seen = m.seen._replace(head_position=m.seen.head_position + 0.01 * h, sent=moved(m.seen.sent, sent, h))
        return Start(Motion(moved(m.axis, direction, h), moved(m.drive, drive, h), seen), start.law)

    def along(h):
        m = backward(start=at(h)).before.motion
        parts = ((m.axis, direction), (m.drive, drive), (m.seen.sent, sent))
        total = sum(getattr(found, name) * d for found, given in parts for name, d in given.items())
        return total + 0.01 * m.seen.head_position

    assert enough(worst(lambda h: value(start=at(h)), along, MACHINES))


def test_gradients_by_the_axis_are_those_of_differences():
    rng, axis, _, _, value, backward = scene()
    free = [name for name in Params._fields if name not in ("dead_time", "dac", "encoder")]
    direction = {name: np.abs(getattr(axis, name)) * rng.normal(size=MACHINES) for name in free}
    direction["creep"] = rng.normal(size=MACHINES)

    def along(h):
        found = backward(by_axis=True, axis=moved(axis, direction, h)).axis
        return sum(getattr(found, name) * d for name, d in direction.items())

    assert enough(worst(lambda h: value(axis=moved(axis, direction, h)), along, MACHINES))


def test_a_linear_axis_answers_as_its_transfer_function():
    """By a command of ``t`` the gap moves as by a pulse of 1 ms through ω²/(s² + 2ζωs + ω²)/s, dead time behind it."""
    axis = Params(omega=500.0, zeta=0.8, speed=1e9, acceleration=1e12, jerk=1e18, dead_time=2.0, dac=0.0, encoder=0.0,
                  friction=0.0, backlash=0.0, compliance=0.0, low=-1e12, high=1e12)  # fmt: skip
    loop, last = Loop(Replay), np.zeros((PERIODS, 1))
    last[-1] = 1.0
    run = loop.forward(axis, Replay.Params(), Replay.Recorded(np.zeros((PERIODS, 1))), Surface())
    found = loop.backward(run, gap=last).recorded.command[:, 0]
    after = np.arange(PERIODS, -1.0, -1.0) * 1e-3 - 2e-3  # of the ends and starts of the periods, s
    times = np.linspace(0, 0.05, 501)
    _, step = signal.step(([500.0**2], [1, 2 * 0.8 * 500.0, 500.0**2, 0]), T=times)
    answer = np.interp(np.maximum(after, 0.0), times, step)
    np.testing.assert_allclose(found, answer[:-1] - answer[1:], atol=2e-3 * 1e-3)


def test_the_resolutions_of_converter_and_encoder_pass_gradients_straight_through():
    """Gradients with them are near those without, where nothing else branches."""
    given = {"friction": 0.0, "backlash": 0.0, "compliance": 0.0}
    shape, loop = (PERIODS, 1), Loop()
    recorded = weighed.Recorded(fed=np.full(shape, 3.0), sheet=0.2, gain=60.0, share=0.5, behind=4.0)
    found = []
    for axis in (Params(**given), Params(dac=0.0, encoder=0.0, **given)):
        run = loop.forward(axis, weighed.Params(), recorded, Surface())
        found.append(loop.backward(run, gap=1.0).recorded.fed)
    np.testing.assert_allclose(*found, rtol=1e-9)


def test_a_roll_out_in_chunks_is_the_same_roll_out():
    rng, axis, recorded, start, _, _ = scene()
    loop, surface, weight = Loop(), Surface(0.0, 0.0, 0.0), rng.normal(size=(PERIODS, MACHINES))

    def part(rows, begins):
        some = weighed.Recorded(*(x[rows] for x in recorded))
        return loop.forward(axis, weighed.Params(), some, surface, begins)

    first, second = slice(0, 15), slice(15, PERIODS)
    whole = part(slice(None), start)
    one = part(first, start)
    two = part(second, one.after)
    np.testing.assert_array_equal(np.concatenate([one.gap, two.gap]), whole.gap)
    wanted = loop.backward(whole, gap=weight)
    behind = loop.backward(two, gap=weight[second])
    before = loop.backward(one, gap=weight[first], after=behind.before)
    for a, b, c in zip(wanted.recorded, before.recorded, behind.recorded, strict=True):
        np.testing.assert_array_equal(np.concatenate([b, c]), a)
    cut = loop.backward(one, gap=weight[first])
    assert (cut.recorded.fed != before.recorded.fed).any()


def test_threads_and_other_machines_change_no_bit():
    _, axis, recorded, start, _, backward = scene()
    wanted = backward()
    loop = Loop(threads=2)
    some = slice(3, 80)
    few = Loop().forward(
        Params(*(np.broadcast_to(x, MACHINES)[some] for x in axis)), weighed.Params(),
        weighed.Recorded(*(x[:, some] for x in recorded)), Surface(), chosen(start, some),
    )  # fmt: skip
    run = loop.forward(axis, weighed.Params(), recorded, Surface(), start)
    np.testing.assert_array_equal(few.gap, run.gap[:, some])
    again = loop.forward(axis, weighed.Params(), recorded, Surface(), start, into=run)
    assert again.given["kept"] is run.given["kept"]
    one, two = Loop().backward(again, gap=1.0), loop.backward(again, gap=1.0)
    for a, b in zip(one.recorded, two.recorded, strict=True):
        np.testing.assert_array_equal(a, b)
    assert np.isfinite(wanted.recorded.fed).all()


def chosen(start: Start, some: slice) -> Start:
    m = start.motion
    seen = Seen(m.seen.head_position[some], m.seen.head_velocity[some], Sent(*(x[some] for x in m.seen.sent)))
    axis, drive = z_axis.State(*(x[some] for x in m.axis)), z_axis.Drive(*(x[some] for x in m.drive))
    return Start(Motion(axis, drive, seen), weighed.State())


def test_gradients_of_a_classical_laws_parameters_are_those_of_differences():
    rng, size = np.random.default_rng(1), 64
    sheet = 0.1 * np.sin(0.2 * np.arange(60)[:, None] + rng.uniform(0, 6, size))
    loop, axis = Loop(OnSheet), drawn(rng, size)._replace(dac=0.0, encoder=0.0)
    params = pid.Params(*(x * rng.uniform(0.8, 1.2, size) for x in (60.0, 1500.0, 0.2, 2.0, 100.0)))
    recorded, surface = OnSheet.Recorded(sheet), Surface(sheet)

    def run(h, keep=False):
        changed = moved(params, dict.fromkeys(("kp", "ki", "kd", "lag"), h), 1.0)
        return loop.forward(axis, changed, recorded, surface, Start(at_rest(1.1), pid.State(0.0, 0.1, 0.0)), keep=keep)

    def along(h):
        there = run(h, True)
        by = loop.backward(there, gap=2.0 * (there.gap - 1.0)).params
        return by.kp + by.ki + by.kd + by.lag

    assert enough(worst(lambda h: ((run(h).gap - 1.0) ** 2).sum(axis=0), along, size))


def test_what_cannot_be_run_is_refused():
    loop, shape = Loop(), (5, 3)
    with pytest.raises(InvalidInput, match=r"\(periods, machines\)"):
        loop.forward(Params(), weighed.Params(), weighed.Recorded(), Surface())
    with pytest.raises(InvalidInput, match="shapes"):
        loop.forward(Params(), weighed.Params(), weighed.Recorded(fed=np.zeros(shape)), Surface(np.zeros((4, 3))))
    run = loop.forward(Params(), weighed.Params(), weighed.Recorded(fed=np.zeros(shape)), Surface(), keep=False)
    with pytest.raises(InvalidInput, match="keep=True"):
        loop.backward(run)
    assert fields(Seen)[2] == "sent.u1"


def test_the_manuals_example_finds_a_better_gain():
    text = (Path(kerfgym.__file__).parent / "docs/gradients.md").read_text(encoding="utf-8")
    space, code = {}, text.split("```python\n")[1].split("```")[0]
    exec(code, space)
    last = np.sqrt(np.mean(space["error"] ** 2))
    exec(code.replace("range(20)", "range(1)"), space)
    assert last < 0.8 * np.sqrt(np.mean(space["error"] ** 2))
