"""The forecast law and what it is made of: against numpy's least squares, scipy's drives, closed forms."""

import gymnasium as gym
import numpy as np
import pytest
from scipy import signal

from kerfgym.baselines import drive_bank, ramps, slots, trends
from kerfgym.baselines import forecast as law
from kerfgym.envs.control import stack
from kerfgym.envs.plant import sensor, sheet, supervisor
from kerfgym.envs.plant.controller import PERIOD, Sensed
from kerfgym.envs.scenarios import load
from kerfgym.experiments.measure import rollout

P = law.Params()


def followed(readings, feed=200.0, test=4.5):
    """Memory of the trends after the readings, one a period."""
    m = np.zeros(trends.MEMORY)
    for k, z in enumerate(readings):
        trends.update(m, k == 0, k < 2, z, z, feed, test)
    return m


# ------------------------------------------------------------------------------------------------------- trends


@pytest.mark.parametrize("feed", [100.0, 200.0, 400.0])
def test_the_trends_of_a_parabola_are_the_parabola(feed):
    x = np.arange(0.0, 300.0, feed * PERIOD)
    z = 0.3 + 0.01 * x - 2e-5 * x * x
    m = followed(z, feed)
    assert m[trends.LEVEL :][: trends.TRENDS] == pytest.approx(z[-1], abs=1e-6)
    assert m[trends.SLOPE :][: trends.TRENDS] == pytest.approx(0.01 - 4e-5 * x[-1], abs=1e-6)
    assert m[trends.BEND :][: trends.TRENDS] == pytest.approx(-4e-5, rel=1e-3)


@pytest.mark.parametrize("count", [3, 10, 300])
def test_the_line_is_that_of_least_squares(count):
    rng = np.random.default_rng(3)
    x = np.arange(count) * 0.2
    z = 1.0 - 0.008 * x + 1e-3 * rng.normal(size=count)
    m = followed(np.concatenate([z[:1], z]), test=100.0)  # the first but begins
    slope, level = np.polyfit(x, z, 1)
    assert m[trends.COUNT] == count
    assert m[trends.LINE] == pytest.approx(level + slope * x[-1], abs=2e-7 if count > 3 else 1e-12)
    assert m[trends.TILT] == pytest.approx(slope, abs=1e-7 if count > 3 else 1e-12)


def test_a_straight_sheet_counts_as_one_until_it_bends():
    rng = np.random.default_rng(7)
    x = np.arange(800) * 0.2
    z = 0.005 * x + 2e-3 * rng.normal(size=800)
    assert trends.straight(followed(z[:90]), 100.0) == 0.0
    assert trends.straight(followed(z), 100.0) == 1.0
    bent = z + np.where(x > 140.0, 4e-4 * (x - 140.0) ** 2, 0.0)
    assert trends.straight(followed(bent), 100.0) == 0.0


def test_noise_is_estimated_whatever_the_sheet():
    rng = np.random.default_rng(11)
    x = np.arange(3000) * 0.2
    z = 0.4 * np.sin(2 * np.pi * x / 60.0) + 0.003 * rng.normal(size=3000)
    found = [followed(z[: 500 + 100 * k])[trends.NOISE] for k in range(25)]
    assert np.mean(found) == pytest.approx(0.003, rel=0.05)


@pytest.mark.parametrize(
    ("wave", "hertz", "noise", "low", "high"),
    [(60.0, 0.0, 1e-6, 0.1, 0.2), (25.0, 0.0, 1e-6, 0.1, 0.4), (0.0, 60.0, 1e-5, 1.0, 4.0), (0.0, 0.0, 3e-3, 1.0, 4.0)],
)
def test_a_bent_sheet_differs_in_long_trends_and_a_shaken_one_in_short_ones(wave, hertz, noise, low, high):
    rng, t = np.random.default_rng(2), np.arange(1500) * PERIOD
    z = noise * rng.normal(size=1500)
    z += 0.1 * np.sin(2 * np.pi * 200.0 * t / wave) if wave else 0.0
    z += 0.01 * np.sin(2 * np.pi * hertz * t) if hertz else 0.0
    assert low < trends.shaken(followed(z)) < high


def test_on_a_cubic_the_short_differs_by_an_eighth_of_the_long():
    """A trend of second order lags a cubic by the cube of its length, and each is twice as long as the one before."""
    x = np.arange(0.0, 400.0, 0.02)
    assert trends.shaken(followed(1e-7 * x**3, feed=20.0)) == pytest.approx(1.0 / 8.0, rel=0.02)


# -------------------------------------------------------------------------------------------------------- ramps


def stepped(feed, height=0.25, edge=40.0, tilt=0.002, periods=None):
    """Way of the head, what the plate sees and where the tip's sheet is."""
    s = np.arange(periods or int(60.0 / feed / PERIOD)) * feed * PERIOD
    shares = [np.array([sheet.share((x - edge) / radius) for x in s]) for radius in (sheet.PLATE, sheet.FOOTPRINT)]
    return s, tilt * s + height * shares[0], tilt * s + height * shares[1]


@pytest.mark.parametrize("feed", [100.0, 200.0, 400.0])
@pytest.mark.parametrize("height", [0.25, -0.1])
def test_a_step_is_known_before_the_tip_is_on_it(feed, height):
    s, plate, tip = stepped(feed, height)
    m = np.zeros(ramps.MEMORY)
    for k, z in enumerate(plate):
        ramps.update(m, k < 2, z, feed)
        if 40.0 - sheet.FOOTPRINT - 0.5 < s[k] < 40.0 + 4.0:
            assert ramps.likely(m, feed, 0.2) == 1.0
            assert m[ramps.HEIGHT] == pytest.approx(height, rel=0.05)
            ahead = int(1.0 / feed / PERIOD)
            assert ramps.tip(m, ahead * feed * PERIOD) == pytest.approx(tip[k + ahead], abs=0.03 * abs(height))


def test_a_ramp_of_another_shape_is_no_step():
    """That of a plate as narrow as the tip: taken for a step of the wide one, the head would be sent astray."""
    m = np.zeros(ramps.MEMORY)
    for k, x in enumerate(np.arange(0.0, 60.0, 0.2)):
        ramps.update(m, k < 2, 0.25 * sheet.share((x - 40.0) / sheet.FOOTPRINT), 200.0)
        assert ramps.likely(m, 200.0, 0.2) == 0.0 or abs(ramps.tip(m, 0.0) - m[ramps.LATEST]) < 0.03


def test_a_wave_is_no_step():
    x = np.arange(2000) * 0.2
    m = np.zeros(ramps.MEMORY)
    for k, z in enumerate(0.5 * np.sin(2 * np.pi * x / 60.0)):
        ramps.update(m, k < 2, z, 200.0)
        assert ramps.likely(m, 200.0, 0.2) == 0.0


# --------------------------------------------------------------------------------------------------- drive bank


@pytest.mark.parametrize(("hertz", "zeta", "dead"), [(60.0, 0.7, 1.2), (90.0, 0.9, 2.4), (110.0, 0.65, 2.8)])
def test_the_drives_dead_time_and_lag_are_found(hertz, zeta, dead):
    """A drive by scipy at a hundredth of a period; the encoder is read an eighth of one back, as on the machine."""
    rng, fine = np.random.default_rng(5), 100
    time = np.arange(1500) * PERIOD
    told = 8 * np.sin(2 * np.pi * 4 * time) + 4 * np.sin(2 * np.pi * 13 * time) + rng.normal(size=1500)
    t = np.arange(1500 * fine) * PERIOD / fine
    late = np.concatenate([np.zeros(int(dead * fine)), np.repeat(told, fine)])[: len(t)]
    w = 2 * np.pi * hertz
    _, at, _ = signal.lsim(([w * w], [1.0, 2 * zeta * w, w * w, 0.0]), late, t)
    m = np.zeros(drive_bank.MEMORY)
    for k in range(1, 1500):
        # The command of a period is sent at its start; the law hears of it at its end.
        drive_bank.update(m, k == 1, at[(k + 1) * fine - fine // 8 - 1], told[k], 0.0)
    assert m[drive_bank.DEAD_TIME] + m[drive_bank.LAG] == pytest.approx(dead + 2e3 * zeta / w, abs=0.35)


# ---------------------------------------------------------------------------------------------------------- law


def signals(plate, head, commands, feed=200.0):
    """What a law sees of a sheet, mm, from a head at ``head`` that was sent ``commands``, one a period."""
    return [
        Sensed(
            height=head[k] - z, raw_height=head[k] - z, frequency=1e6, valid=True, set_height=0.7,
            head_position=head[k], head_velocity=0.0, command=commands[k], mode=supervisor.FOLLOW, override=False,
            captured=True, fresh=k == 0, feed=feed, place=0.0, lap=0.0,
        )
        for k, z in enumerate(plate)
    ]  # fmt: skip


def driven(params, seen):
    """Memory, state and commands of the law over the signals."""
    memory, state, out = np.zeros(law.MEMORY), law.init(params), []
    for x in seen:
        state, command = law.control(params, state, x, np.zeros(0), memory)
        out.append(command)
    return memory, state, np.array(out)


def rough(n=400, seed=4):
    rng, x = np.random.default_rng(seed), np.arange(n) * 0.2
    return 0.2 * np.sin(2 * np.pi * x / 45.0) + 0.02 * np.sin(2 * np.pi * x / 17.0) + 1e-3 * rng.normal(size=n)


def test_no_action_is_the_law_and_an_action_adds_its_span_times_its_signal():
    seen = signals(rough(), 0.7 + rough(), np.zeros(400))
    memory, state, commands = driven(P, seen)
    before = memory.copy()
    assert law.weigh(P, state, seen[-1], memory) == commands[-1]
    assert np.array_equal(memory, before)
    assert not memory[law.ACTION :][: len(law.WEIGHTS)].any()
    gain = memory[law.RULE + len(law.WEIGHTS) - 2]
    for k, (name, span, _) in enumerate(law.WEIGHTS[:-2]):
        memory[law.ACTION + k] = 1e-3
        changed = law.weigh(P, state, seen[-1], memory) - commands[-1]
        unit = gain if name.startswith("place") else 1.0
        assert changed == pytest.approx(1e-3 * span * unit * memory[law.SIGNAL + k], rel=1e-6, abs=1e-12), name
        memory[law.ACTION + k] = 0.0


def test_what_is_seen_of_the_sheet_does_not_depend_on_what_the_head_does():
    z, t = rough(), np.arange(400) * PERIOD
    close = 0.7 + z
    loose = close + 0.02 * np.sin(2 * np.pi * 5 * t)
    still, _, _ = driven(P, signals(z, close, np.gradient(close, PERIOD)))
    moved, _, _ = driven(P._replace(kp=30.0, calm=20.0), signals(z, loose, np.gradient(loose, PERIOD)))
    of_the_drive = {"dead time", "lag", "drive's fit", "rise", "step's way"}
    for k, name in enumerate(law.FEATURES):
        assert name in of_the_drive or moved[k] == pytest.approx(still[k], abs=1e-9), name


def test_features_are_bounded_and_those_of_trends_are_the_same_at_any_feed():
    assert set(law.CONDITIONS) <= set(law.FEATURES)
    described = []
    for feed in (100.0, 200.0, 400.0):
        n = int(90.0 / feed / PERIOD)
        x = np.arange(n) * feed * PERIOD + (90.0 - n * feed * PERIOD)
        z = 0.2 * np.sin(2 * np.pi * x / 50.0)
        memory, _, _ = driven(P, signals(z, 0.7 + z, np.zeros(n), feed))
        described.append(memory[: len(law.FEATURES)])
        assert np.abs(described[-1]).max() <= 10.0
    of_trends = [k for k, name in enumerate(law.FEATURES) if name.endswith(" mm") and not name.startswith("level 1.2")]
    for other in (0, 2):
        assert described[other][of_trends] == pytest.approx(described[1][of_trends], abs=0.12)


def test_on_a_tilted_sheet_the_head_is_sent_along_with_it():
    """0.005 mm/mm at 200 mm/s: a millimetre a second, once the line is known."""
    n = 500
    z = 0.001 * np.arange(n)
    head = z + 0.7
    _, _, commands = driven(P._replace(smith=0.0), signals(z, head, np.ones(n)))
    assert commands[300:] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(("room", "late", "brake"), [(0.4, 6.0, 1e4), (0.05, 4.0, 1.4e4), (2.0, 8.0, 5e3)])
def test_the_shield_lets_the_head_fall_no_faster_than_it_can_stop(room, late, brake):
    """Speed w covers w·T until it brakes and w²/2a after: that is the room, to the micrometre."""
    p, m = P._replace(brake=brake, margin=0.05), np.zeros(law.MEMORY)
    m[law.BEHIND] = late - 1.0
    x = signals([0.0], [room + 0.05], [0.0])[0]
    w = -law.shielded(p, x, m, -1e3)
    assert w * late * 1e-3 + w * w / (2.0 * brake) == pytest.approx(room, abs=1e-9)
    assert law.shielded(p, x, m, -0.5 * w) == -0.5 * w
    assert law.shielded(p, x._replace(head_position=0.05), m, -10.0) == 0.0
    m[law.SINKING] = -3.0
    assert law.shielded(p, x, m, -1e3) == pytest.approx(-w - 3.0)


def test_under_the_shield_a_head_that_is_sent_down_stops_above_the_sheet():
    """A drive that does as told after 4 ms, but for its limit of acceleration."""
    p, m = P._replace(brake=1e4, margin=0.05), np.zeros(law.MEMORY)
    m[law.BEHIND] = 5.0
    at, speed, sent = 5.0, 0.0, [0.0] * 4
    lowest = at
    for _ in range(2000):
        m[law.WAY] = sum(sent) * PERIOD + (speed - sent[0]) * PERIOD
        sent = [*sent[1:], law.shielded(p, signals([0.0], [at], [0.0])[0], m, -400.0)]
        speed += np.clip(sent[0] - speed, -1e4 * PERIOD, 1e4 * PERIOD)
        at += speed * PERIOD
        lowest = min(lowest, at)
    assert 0.05 <= lowest < 0.2


# ------------------------------------------------------------------------------------------------ no sheet below


def slotted(length=200.0, feed=200.0, rise=0.0):
    """A scenario with one slot."""
    change = {"sheet": {"holes": {"length": length, "count": 1, "jitter": 0.0}}, "feed": feed, "duration": 400.0 / feed}
    if rise:
        change["sheet"] = {"holes": None, "steps": {"height": rise, "spacing": 150.0, "count": 1}}
    return load("long-hole").varied(**change)


def over_a_slot(length=200.0, feed=200.0, rise=0.0, seed=201, controller="forecast"):
    """A run over a slot of ``length`` mm; with a ``rise`` below 0 the sheet goes on so much lower instead."""
    return rollout.roll(slotted(length, feed, rise), stack.resolve(controller), seed)


@pytest.mark.parametrize(("length", "feed", "sinks"), [(120.0, 200.0, 0.07), (200.0, 200.0, 0.07), (200.0, 60.0, 0.4)])
def test_over_a_slot_that_outlasts_the_hold_the_head_stays_where_the_hold_put_it(length, feed, sinks):
    """At low feeds the guard takes the edge for one late, and the head has come down with the reading by then."""
    run = over_a_slot(length, feed)
    over = (run["distance"][:, 0] > 150.0 - length / 2.0) & (run["distance"][:, 0] < 150.0 + length / 2.0)
    assert over.sum() > 500.0, "longer than a hold"
    assert not run.collided.any()
    assert np.abs(run["head"][over, 0] - run.set_height[0]).max() < sinks
    assert run["head"][-1, 0] == pytest.approx(run.set_height[0], abs=0.01), "and follows when the sheet is back"


def test_a_follower_that_approaches_what_it_reads_there_dives_through_the_plane_of_the_sheet():
    assert over_a_slot(controller="self-tuning")["head"].min() < 0.0


def test_a_sheet_that_goes_on_deeper_is_approached_once_an_edge_would_be_over():
    """3 mm down: the hold ends after 400 ms; readings within the table for 30 mm, 150 ms, are a sheet's."""
    run = over_a_slot(rise=-3.0)
    below, held = run["head"][:, 0] < run.set_height[0] - 0.5, run["mode"][:, 0] == supervisor.HOLD
    assert held.any()
    assert np.flatnonzero(below)[0] - np.flatnonzero(held)[-1] == pytest.approx(1e3 * slots.LONGER / 200.0, abs=40.0)
    assert run["gap"][-1, 0] == pytest.approx(run.set_height[0], abs=0.02)
    assert not run.collided.any()


def told(**changes):
    """Signals of a head 0.7 mm above a sheet at 0.3 mm."""
    x = signals([0.3], [1.0], [0.0])[0]
    return x._replace(**{"fresh": False, "raw_height": 10.0, **changes})


def test_the_sheet_is_away_after_a_hold_that_the_supervisor_ends_without_it():
    m = np.full(slots.MEMORY, 7.0)
    slots.update(m, told(fresh=True, captured=False))
    assert not slots.is_away(m), "an episode begins with an approach"
    slots.update(m, told(mode=supervisor.HOLD))
    assert not slots.is_away(m)
    slots.update(m, told(captured=False))
    assert slots.is_away(m)
    assert m[slots.PLANE] == pytest.approx(0.3)
    for _ in range(10_000):  # no time is too long
        slots.update(m, told(captured=False))
    assert slots.is_away(m)
    back, stopped = m.copy(), m.copy()
    slots.update(back, told(captured=True, raw_height=0.75))
    slots.update(stopped, told(captured=False, mode=supervisor.STOP))
    assert not slots.is_away(back)
    assert not slots.is_away(stopped)


def test_an_action_has_no_say_where_there_is_no_sheet_and_regains_it_within_a_fifth_of_a_second():
    env = gym.make_vec("kerfgym/HeightFollowing-v0", 1, control="weights", observation="sheet", base="forecast",
                       scenario=slotted(), max_steps=2000)  # fmt: skip
    batch = env.unwrapped.batch
    env.reset(seed=3)
    fleet, generator, said, moved, modes = batch.fleet, np.random.default_rng(0), [], [], []
    for _ in range(1900):
        before = fleet.memories[0].copy()
        env.step(generator.uniform(-0.02, 0.02, (1, len(law.WEIGHTS))).astype(np.float32))
        after = fleet.memories[0]
        said.append(before[law.SAY])
        moved.append(slots.is_away(before[law.GONE :]))
        modes.append(fleet.column("signals.mode")[0])
        if after[law.SAY] > said[-1]:
            assert after[law.SAY] - said[-1] <= law.REGAINED + 1e-12
    said, away, held = np.array(said), np.array(moved), np.array(modes) == supervisor.HOLD
    assert away.sum() > 200
    assert not said[away].any()
    assert not said[1:][held[:-1] & held[1:]].any()
    assert said[~away].max() == 1.0
    x, s, m = signals([0.3], [1.0], [0.0])[0], law.init(P), np.random.default_rng(1).normal(size=law.MEMORY)
    m[law.SAY] = 0.0
    told_nothing = m.copy()
    told_nothing[law.ACTION : law.RULE] = 0.0
    assert law.weigh(P, s, x, m) == law.weigh(P, s, x, told_nothing)


@pytest.mark.parametrize(
    ("changes", "away", "say"),
    [
        ({}, False, 0.505),
        ({"height": 0.7 + 0.34}, False, 0.505),
        ({"height": 0.7 + 0.36}, False, 0.0),
        ({"height": 0.01}, False, 0.0),
        ({"height": 0.01, "set_height": 0.3}, False, 0.0),  # whatever the set height, it is a fault
        ({"height": np.nan}, False, 0.0),
        ({"captured": False}, False, 0.0),
        ({"override": True}, False, 0.0),
        ({}, True, 0.0),
        ({"fresh": True, "captured": False}, False, 1.0),
    ],
)
def test_an_action_has_a_say_while_the_head_follows(changes, away, say):
    x = told(height=0.7, captured=True, override=False)._replace(**changes)
    assert law._say(x, away, 0.5) == pytest.approx(say)
    assert law._say(x, away, 1.0) <= 1.0


@pytest.mark.parametrize("feed", [50.0, 200.0, 400.0])
def test_only_readings_over_more_than_an_edge_are_a_sheet(feed):
    m = np.zeros(slots.MEMORY)
    slots.update(m, told(mode=supervisor.HOLD))
    readings = 0
    slots.update(m, told(captured=False, feed=feed))
    while slots.is_away(m):
        slots.update(m, told(captured=False, feed=feed, raw_height=4.0))
        readings += 1
    assert readings * feed * PERIOD == pytest.approx(2.0 * sensor.WIDEST + 6.0, abs=2.0 * feed * PERIOD)
