"""Laws: each against a second implementation, in the closed loop and on its own; presets and information classes."""

import itertools
import math
import tomllib
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from numba.core.errors import TypingError
from scipy import signal

from kerfgym import baselines
from kerfgym.baselines import observer, pid, preview
from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.envs.control.stack import get
from kerfgym.envs.plant import heads, machine, supervisor
from kerfgym.envs.plant.controller import PERIOD, Preview, Privileged, Sensed, make_law
from kerfgym.envs.plant.fleet import Fleet
from kerfgym.envs.scenarios import SPLITS, load
from kerfgym.experiments.measure.rollout import fleet_for
from kerfgym.experiments.tune import study_file

NAMES = study_file.read("followers").searches
"""Followers with a preset, each with its search."""

T = PERIOD


def lived(spec, scenario, seed, periods):
    """Signals that the law of a machine saw and what it wished for, period by period, from the first on."""
    chosen = stack.resolve(spec)
    fleet = fleet_for(load(scenario), chosen, [seed])
    wish = fleet.slots(machine.WISH, 1)
    signals, wishes = [fleet.get("signals")], [float(wish[0])]
    for _ in range(periods):
        fleet.advance()
        signals.append(fleet.get("signals"))
        wishes.append(float(wish[0]))
    return chosen.part("law"), signals, np.array(wishes)


# ------------------------------------------------------------------------------------- second implementations


def proportional(p, signals):
    return [-p.kv * (x.height - x.set_height) for x in signals]


def pid_again(p, signals):
    """The law as its docstring states it, with the derivative by scipy's difference equation, between overrides."""
    e = np.array([x.height - x.set_height for x in signals])
    share, slope, first = T / (p.lag * 1e-3 + T), np.zeros(len(e)), 0
    for overridden, stretch in itertools.groupby(x.override for x in signals):
        last = first + len(list(stretch))
        if not overridden:
            start = signal.lfiltic([share / T, -share / T], [1.0, share - 1.0], y=[0.0], x=[e[max(first - 1, 0)]])
            part, _ = signal.lfilter([share / T, -share / T], [1.0, share - 1.0], e[first:last], zi=start)
            slope[first:last] = part
        first = last
    integral, wishes = 0.0, []
    for i, x in enumerate(signals):
        if not x.captured:  # nothing to regulate yet
            integral = 0.0
        elif not x.override:
            integral = float(np.clip(integral + p.ki * T * e[i], -p.limit, p.limit))
        wishes.append(-(p.kp * e[i] + integral + p.kd * slope[i]))
    return wishes


def observer_again(p, signals):
    """A three-state observer in matrices."""
    r = 1.0 / (1.0 + 2 * np.pi * p.bandwidth * T)
    step = np.array([[1.0, T, T * T / 2], [0.0, 1.0, T], [0.0, 0.0, 1.0]])
    gain = np.array([1 - r**3, 1.5 * (1 - r) ** 2 * (1 + r) / T, (1 - r) ** 3 / T**2])
    x, wishes = np.zeros(3), []
    for s in signals:
        measured = s.head_position - s.height
        if not s.captured:
            x = np.array([measured, 0.0, 0.0])
        elif s.mode == supervisor.MODES.index("hold"):
            x = np.array([x[0], 0.0, 0.0])
        else:
            x = step @ x
            x = x + gain * np.clip(measured - x[0], -p.gate, p.gate)
        error = s.head_position - x[0] - s.set_height
        wishes.append(p.feed * (x[1] + p.bend * p.lead * 1e-3 * x[2]) - p.kp * error)
    return wishes


def preview_again(p, signals):
    """The law with numpy's interpolation of the sheet ahead."""
    bias, wishes = 0.0, []
    for i, x in enumerate(signals):
        ahead = [x.surface_0, x.surface_1, x.surface_2, x.surface_3, x.surface_4, x.surface_5]

        def at(ms, ahead=ahead):
            return np.interp(ms, range(6), ahead)

        coming = (at(p.lead + 0.5) - at(p.lead - 0.5)) / T
        before = at(p.lead - 0.5) - at(p.lead - 1.5)
        after = at(p.lead + 1.0) - at(p.lead)
        measured = x.head_position - x.height - x.surface_0
        if i:
            bias += p.level * T * np.clip(measured - bias, -0.02, 0.02)
        error = x.head_position - x.surface_0 - x.set_height - bias
        wishes.append(coming + p.sharpen * (after - before) / 1.25 / T - p.kp * error)
    return wishes


def patent_again(p, signals):
    """The three cases as they are printed, with |d| ≤ ε for the hold, and the descent's speed."""
    wishes, last = [], None
    for x in signals:
        d = x.height - x.set_height
        vs, vm = (min(math.sqrt(2 * p.acceleration * s), p.fastest) for s in (abs(d), p.distance))
        if d > p.accuracy and x.height >= p.range:
            wishes.append(-min(vs, max(-x.command, 0.0) + p.acceleration * T))
        else:
            kp = (p.s / 100 if d < -p.accuracy else p.lower if d > p.accuracy else p.hold) * vs / vm
            moved = kp * d + kp / p.r * (d if last is None else last)
            wishes.append(0.0 if abs(d) <= p.accuracy and abs(moved) < p.smallest else -moved / T)
        last = d
    return wishes


def dual_again(p, signals):
    """Both loops over whole columns; the gains by numpy's interpolation and look-up in the text's table."""
    e = np.array([x.height - x.set_height for x in signals])
    gap = np.where([x.override for x in signals], 0.0, np.diff(e, prepend=e[0])) / T
    speed = gap if p.speed else np.array([x.head_velocity for x in signals])
    share = T / (p.lag * 1e-3 + T)
    v = signal.lfilter([share], [1.0, share - 1.0], speed)
    gain = p.gain * np.interp(np.abs(e), [1.0, 3.0], [0.35, 0.75])
    on = np.array([1.0, 0.5, 0.0])[np.digitize(np.abs(e), [0.5, 1.0])]
    first, second, wishes = 0.0, 0.0, []
    for i, x in enumerate(signals):
        if not x.override:
            first = float(np.clip(first - on[i] * p.ki * e[i] * T, -p.limit, p.limit))
        first = first if x.captured else 0.0
        wanted = first - gain[i] * e[i]
        if not x.override:
            second = float(np.clip(second + on[i] * p.kiv * (wanted - v[i]) * T, -p.limit, p.limit))
        second = second if x.captured else 0.0
        wishes.append(p.kpv * (wanted - v[i]) + second)
    return wishes


def plasma_again(p, signals):
    """The PID by its own second implementation between the locks, which are found first."""
    feeds = np.array([x.feed for x in signals])
    assert np.ptp(feeds) == 0.0
    rise = np.diff([x.height - x.set_height for x in signals], prepend=signals[0].height - signals[0].set_height) / T
    fast = (rise > p.slope) & np.array([x.captured for x in signals])
    runs = np.array([fast[max(0, i - int(p.on) + 1) : i + 1].sum() for i in range(len(fast))]) >= p.on
    locked = np.array([runs[max(0, i - int(p.off) + 1) : i + 1].any() for i in range(len(runs))])
    locked &= np.array([x.captured for x in signals])
    integral, slope, wishes = 0.0, 0.0, []
    for i, x in enumerate(signals):
        e = x.height - x.set_height
        slope = 0.0 if x.override else slope + (rise[i] - slope) / (p.lag + 1.0)
        integral = integral if x.override else float(np.clip(integral + p.ki * T * e, -p.limit, p.limit))
        integral = integral if x.captured else 0.0
        wishes.append(0.0 if locked[i] else -(p.kp * e + integral + p.kd * slope))
        integral, slope = (0.0, 0.0) if locked[i] else (integral, slope)
    return wishes


def oracle_again(p, signals):
    """The preview's feed-forward, and the truth's feedback with numpy's differences."""
    none = SimpleNamespace(kp=0.0, lead=p.lead, sharpen=p.sharpen, level=0.0)
    lead = np.clip(p.lead, 1.5, 4.0)
    wishes, integral = preview_again(none, signals), 0.0
    for i, x in enumerate(signals):
        ahead = [x.surface_0, x.surface_1, x.surface_2, x.surface_3, x.surface_4, x.surface_5]
        assert lead == p.lead  # else both interpolate elsewhere
        past = signals[i - 1].surface_0 if i else x.surface_0
        here = np.array([past, *ahead[:2]])
        true, motor = x.gap - x.set_height, x.head_position - x.surface_0 - x.set_height
        if not x.override:
            integral = float(np.clip(integral + p.ki * T * true, -p.limit, p.limit))
        integral = integral if x.captured else 0.0
        wishes[i] -= p.kp * ((1 - p.nozzle) * motor + p.nozzle * true) + integral
        wishes[i] -= p.damping * (x.velocity - np.gradient(here, T)[1])
        wishes[i] -= p.brake * 1e-3 * (x.acceleration - np.diff(here, 2)[0] / T**2)
    return wishes


AGAIN = {
    "patent2022": patent_again,
    "patent2022:law.s=40,law.r=3,law.hold=0.2,law.lower=0.1,law.accuracy=0.05,law.smallest=1e-4": patent_again,
    "cn102528288a": dual_again,
    "cn102528288a-gap": dual_again,
    "cn102528288a-tuned": dual_again,
    "plasma-style": plasma_again,
    "plasma-style:law.slope=15,law.on=4,law.off=60": plasma_again,
    "oracle:law.lead=3.5": oracle_again,
    "oracle:law.lead=2,law.ki=900,law.damping=0.3,law.brake=0.6,law.nozzle=0.4,law.limit=2": oracle_again,
    "ilc": pid_again,  # there are no laps
    "xi2023-improved": proportional,
    "xi2023-tuned": proportional,
    "pid": pid_again,
    "pid:law.kp=60,law.ki=9000,law.kd=-0.3,law.lag=4,law.limit=20": pid_again,
    "observer": observer_again,
    "observer:law.kp=70,law.bandwidth=40,law.gate=0.02,law.lead=6,law.bend=0.9,law.feed=0.7": observer_again,
    "preview-5ms": preview_again,
    "preview-5ms:law.lead=2.2,law.sharpen=3,law.level=40": preview_again,
}


@pytest.mark.parametrize("scenario", ["wavy", "impulses", "holes", "descent"])
@pytest.mark.parametrize("spec", AGAIN)
def test_the_compiled_law_wishes_what_a_second_implementation_does(spec, scenario):
    p, signals, wishes = lived(spec, scenario, 1003, 900)
    again = np.array(AGAIN[spec](p, signals))
    # Holes are cut out of a level sheet, and the oracle knows that there is nothing to follow.
    assert np.ptp(wishes) > 1e-4 or (spec.startswith("oracle") and scenario == "holes")
    assert wishes == pytest.approx(again, rel=1e-6, abs=1e-6)


def test_those_runs_held_over_holes_and_approached_from_above():
    _, over_holes, _ = lived("pid", "holes", 1003, 900)
    _, from_above, _ = lived("pid", "descent", 1003, 900)
    assert 10 < sum(x.mode == supervisor.HOLD for x in over_holes) < 900
    assert 10 < sum(not x.captured for x in from_above) < 900
    assert any(x.override for x in from_above)


# --------------------------------------------------------------------------------------------------------- PID


def steps(law, params, signals):
    """Wishes of a law written in Python over a list of signals."""
    state, out = law.init(params), []
    for x in signals:
        state, wish = law.control(params, state, x, ())
        out.append(wish)
    return np.array(out)


def seen(heights, **more):
    columns = {"height": heights, "set_height": np.full(len(heights), 0.8), **more}
    rows = zip(*columns.values(), strict=True)
    return [
        Sensed(**dict(zip(columns, row, strict=True)), fresh=i == 0, captured=True, mode=supervisor.FOLLOW)
        for i, row in enumerate(rows)
    ]


RANDOM = 0.8 + np.random.default_rng(5).normal(0, 0.1, 400)


def test_pid_is_its_transfer_function():
    p = pid.Params(kp=70.0, ki=2500.0, kd=0.4, lag=2.0, limit=500.0)
    e = RANDOM - 0.8
    parts = [
        (np.array([p.kp]), np.array([1.0])),
        (np.array([p.ki * T]), np.array([1.0, -1.0])),  # I += ki·T·e
        (p.kd / (2e-3 + T) * np.array([1.0, -1.0]), np.array([1.0, -2e-3 / (2e-3 + T)])),  # backward difference
    ]
    e0 = np.concatenate([np.zeros(1), np.diff(e)]).cumsum()  # the derivative does not kick at the first period
    expected = -sum(signal.lfilter(b, a, e0 if i == 2 else e) for i, (b, a) in enumerate(parts))
    assert steps(pid, p, seen(RANDOM)) == pytest.approx(expected, rel=1e-9)


def test_the_integral_stands_still_while_the_supervisor_overrides_the_law():
    p = pid.Params(kp=70.0, ki=2500.0, kd=0.4, lag=2.0, limit=500.0)
    override = (np.arange(300) >= 50) & (np.arange(300) < 250)
    wishes = steps(pid, p, seen(np.full(300, 1.2), override=override.tolist()))
    grown = p.ki * T * 0.4
    assert wishes[49] == pytest.approx(-70.0 * 0.4 - 50 * grown)
    assert wishes[50:250] == pytest.approx(wishes[49])
    assert wishes[250] == pytest.approx(wishes[49] - grown)


def test_the_integral_is_empty_until_the_approach_is_over():
    p = pid.Params(kp=70.0, ki=2500.0, kd=0.0, lag=2.0, limit=500.0)
    far = [x._replace(captured=False) for x in seen(np.full(200, 5.8))]
    near = [x._replace(fresh=False) for x in seen(np.full(3, 0.9))]
    wishes = steps(pid, p, far + near)
    assert wishes[:200] == pytest.approx(-70.0 * 5.0)
    assert wishes[200:] == pytest.approx(-70.0 * 0.1 - p.ki * T * 0.1 * np.arange(1, 4))


def test_the_integral_stops_at_its_limit_and_leaves_it_at_once():
    p = pid.Params(kp=1.0, ki=2000.0, kd=0.0, lag=0.0, limit=5.0)
    wishes = steps(pid, p, seen(np.concatenate([np.full(200, 0.9), np.full(5, 0.7)])))
    assert wishes[199] == pytest.approx(-0.1 - 5.0)
    assert wishes[200] == pytest.approx(0.1 - 5.0 + 0.2)


# ---------------------------------------------------------------------------------------------------- observer


def states(p, surface, heads_=None):
    """The observer's estimates while the surface passes under a standing head."""
    head = np.zeros(len(surface)) if heads_ is None else heads_
    state, out = observer.init(p), []
    for z, position in zip(surface, head, strict=True):
        x = Sensed(height=position - z, head_position=position, set_height=0.8, captured=True, mode=supervisor.FOLLOW)
        state, _ = observer.control(p, state, x, ())
        out.append(state)
    return np.array(out)


WIDE = observer.Params(bandwidth=25.0, gate=5.0)


def test_the_observers_error_dies_with_three_equal_poles():
    level, _, _ = states(WIDE, np.full(120, 1e-3)).T
    e = level - 1e-3
    r = 1.0 / (1.0 + 2 * np.pi * 25.0 * T)
    left = e[3:] - 3 * r * e[2:-1] + 3 * r**2 * e[1:-2] - r**3 * e[:-3]
    assert np.abs(left).max() < 1e-12
    assert np.abs(e).max() > 1e-4


@pytest.mark.parametrize("order", [1, 2])
def test_the_observer_tracks_a_ramp_and_a_bend_without_a_steady_error(order):
    t = np.arange(1500) * T
    surface = 4.0 * t if order == 1 else 4.0 * t + 0.5 * 3.0 * t**2
    level, speed, bend = states(WIDE, surface)[-1]
    assert level == pytest.approx(surface[-1], abs=1e-9)
    assert speed == pytest.approx(4.0 if order == 1 else 4.0 + 3.0 * t[-1], abs=1e-6)
    assert bend == pytest.approx(0.0 if order == 1 else 3.0, abs=1e-4)


@pytest.mark.parametrize(("feed", "lag"), [(1.0, 0.0), (0.0, 4.0 / 60.0), (0.5, 2.0 / 60.0)])
def test_feeding_the_sheets_speed_forward_takes_the_lag_of_a_ramp_away(feed, lag):
    p = WIDE._replace(kp=60.0, feed=feed, lead=0.0)
    state, head = observer.init(p), 0.8
    for i in range(3000):
        surface = 4.0 * i * T
        x = Sensed(height=head - surface, head_position=head, set_height=0.8, captured=True, mode=supervisor.FOLLOW)
        state, wish = observer.control(p, state, x, ())
        head += wish * T
    error = x.height - x.set_height
    assert -error == pytest.approx(lag, abs=1e-6)  # the head stays below its place on a sheet that rises


def test_an_impulse_beyond_the_gate_moves_the_observer_no_more_than_the_gate_does():
    p = WIDE._replace(gate=0.05)
    r = 1.0 / (1.0 + 2 * np.pi * 25.0 * T)
    calm = np.zeros(400)
    tracks = {}
    for size in (0.05, 0.3, 3.0):
        hit = calm.copy()
        hit[200] = size
        tracks[size] = states(p, hit)
    assert np.array_equal(tracks[0.3], tracks[3.0])
    assert tracks[3.0] == pytest.approx(tracks[0.05], abs=1e-12)
    assert tracks[3.0][200, 0] == pytest.approx((1 - r**3) * 0.05)
    assert np.abs(tracks[3.0][:, 0]).max() < 0.05


def test_the_observer_stands_still_over_a_hole_and_starts_afresh_after_an_approach():
    p = WIDE
    state = observer.State(0.3, 5.0, 100.0)
    x = Sensed(height=2.0, head_position=1.0, set_height=0.8, captured=True, mode=supervisor.HOLD)
    held, _ = observer.control(p, state, x, ())
    assert tuple(held) == (0.3, 0.0, 0.0)
    far, wish = observer.control(p, state, x._replace(mode=supervisor.FOLLOW, captured=False), ())
    assert tuple(far) == (-1.0, 0.0, 0.0)
    assert wish == pytest.approx(-p.kp * (2.0 - 0.8))


# ----------------------------------------------------------------------------------------------------- preview


def test_the_preview_interpolates_between_the_points_it_knows():
    rng = np.random.default_rng(2)
    points = rng.normal(size=6)
    x = Preview(**{f"surface_{i}": z for i, z in enumerate(points)})
    for ms in np.linspace(-1.0, 6.0, 141):
        assert preview._at(x, ms) == pytest.approx(np.interp(ms, range(6), points), abs=1e-5)


def test_the_preview_feeds_a_ramps_speed_forward_whatever_its_lead():
    ramp = {f"surface_{i}": 0.004 * i for i in range(6)}
    for lead in (0.5, 1.2, 2.0, 3.3, 4.5):
        p = preview.Params(lead=lead, sharpen=2.0)
        x = Preview(head_position=0.8, height=0.8, set_height=0.8, fresh=True, **ramp)
        _, wish = preview.control(p, preview.init(p), x, ())
        assert wish == pytest.approx(4.0, rel=1e-3)  # mm/s: 4 µm in 1 ms


# -------------------------------------------------------------------------------------------- information classes


class Memory(NamedTuple):
    """One number."""

    nothing: float = 0.0


def _space(control):
    def init(params):
        return Memory(0.0)

    return SimpleNamespace(Params=Memory, State=Memory, init=init, control=control)


def reads_height(params, state, signals, tables):
    return state, signals.height


def reads_surface(params, state, signals, tables):
    return state, signals.surface_0


def reads_gap(params, state, signals, tables):
    return state, signals.gap


@pytest.mark.parametrize(
    ("control", "least"), [(reads_height, "sensor"), (reads_surface, "preview"), (reads_gap, "privileged")]
)
def test_a_law_reads_what_its_information_class_holds_and_nothing_else(control, least):
    order = ["sensor", "preview", "privileged"]
    for information in order:
        law = make_law(_space(control), f"spy_{control.__name__}_{information}", information)
        if order.index(information) >= order.index(least):
            Fleet(1, law, heads.POOL)
        else:
            with pytest.raises((TypingError, AttributeError, ValueError), match=control.__name__.split("_")[1]):
                Fleet(1, law, heads.POOL)


def test_each_class_begins_with_the_signals_of_the_one_before():
    assert Preview._fields[: len(Sensed._fields)] == Sensed._fields
    assert Privileged._fields[: len(Preview._fields)] == Preview._fields
    assert not {"gap", "head", "surface_0", "velocity"} & set(Sensed._fields)
    assert not {"gap", "head", "velocity"} & set(Preview._fields)


# ----------------------------------------------------------------------------------------------------- presets


@pytest.mark.parametrize("name", NAMES)
def test_a_tuned_preset_holds_what_was_searched_and_tells_where_it_comes_from(name):
    text = (baselines.PRESETS / f"{name}.toml").read_text(encoding="utf-8")
    preset = tomllib.loads(text)
    values = get(name).parameters()
    assert {key: values[key].value for key in preset["parameters"]} == preset["parameters"]
    record = get(name).provenance
    assert record == preset["provenance"]
    if record["suite"] != f"following-{load('wavy').version}":
        pytest.skip(f"searched on {record['suite']}, before the suite and the protocol of today")
    assert set(preset["parameters"]) == {axis.name for axis in NAMES[name].space.axes}
    first, last = (int(seed) for seed in record["tune_seeds"].split("-"))
    assert first in SPLITS["tune"]
    assert last in SPLITS["tune"]
    assert record["cap"] == NAMES[name].limits.ms == 2.0
    assert 1.0 < record["ms"] <= record["cap"]
    assert 0.0 < record["score_tune_um"] < 100.0
    if get(name).information == "sensor" and "guard.rise" in get(name).values:
        assert record["collisions_tune"] == 0
    assert record["simulated_steps"] > 0
    assert {"trials", "sampler", "sampler_seed", "cpu_seconds", "kerfgym", "git", "python"} <= set(record)


def test_every_search_spent_the_same_number_of_trials():
    assert len({get(name).provenance["trials"] for name in NAMES}) == 1


def test_the_papers_laws_are_not_tuned():
    for name, kind in (("xi2023-ma", 1), ("xi2023-improved", 2)):
        values = get(name).parameters()
        assert get(name).provenance["trials"] == 0
        assert values["law.kv"].value == 50.0
        assert values["filter.window"].value == 5.0
        assert values["filter.kind"].value == kind
    assert scenarios.SPLITS["tune"].stop <= scenarios.SPLITS["test"].start
