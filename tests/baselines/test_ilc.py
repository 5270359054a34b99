"""Iterative learning: what falls from lap to lap, what bounds it, and whose memory it is."""

import gymnasium as gym
import numpy as np
import pytest

from kerfgym.baselines import ilc
from kerfgym.envs import scenarios
from kerfgym.envs.control.stack import get, resolve
from kerfgym.envs.plant import heads
from kerfgym.envs.plant.controller import PERIOD, Sensed
from kerfgym.envs.plant.fleet import Fleet
from kerfgym.envs.scenarios import load
from kerfgym.experiments.measure.rollout import fleet_for, roll

LAP = 2 * np.pi * 30.0
SEEDS = range(1000, 1010)


def by_lap(record, laps):
    """RMS true error of each lap, µm, shape (laps, machines); the first without its first 0.3 s."""
    turn = LAP / 200.0 / PERIOD
    ends = np.round(turn * np.arange(laps + 1)).astype(int)
    return 1e3 * np.array(
        [np.sqrt(np.mean(record.error[max(a, 300) : b] ** 2, axis=0)) for a, b in zip(ends, ends[1:], strict=False)]
    )


@pytest.mark.parametrize("name", scenarios.suite("repeated"))
def test_the_error_falls_from_lap_to_lap_to_a_small_share_of_the_first(name):
    case = load(name).varied(head={"plate": 2.0})  # a wider plate sees another sheet, and nobody learns what it hides
    error = np.sqrt(np.mean(by_lap(roll(case, get("ilc"), SEEDS), 8) ** 2, axis=1))
    plain = np.sqrt(np.mean(by_lap(roll(case, get("pid"), SEEDS), 8) ** 2, axis=1))
    assert error[0] == pytest.approx(plain[0], rel=0.02)  # in its first lap it is its PID
    assert np.all(error[1:4] < 0.7 * error[:3])
    assert error[-1] < 0.2 * error[0]
    assert plain[-1] > 0.9 * plain[0]  # without learning it stays


def test_the_error_does_not_grow_over_many_laps():
    case = load("laps-wavy").varied(circle={"laps": 40}, duration=37.6, head={"plate": 2.0})
    error = by_lap(roll(case, get("ilc"), range(1000, 1006)), 39)
    assert np.sqrt(np.mean(error[-10:] ** 2)) < 1.5 * np.sqrt(np.mean(error[6:16] ** 2))
    assert error[5:].max() < 0.6 * error[0].min()


def test_without_laps_it_is_its_inner_pid():
    for scenario in ("wavy", "holes", "descent"):
        own, inner = (roll(load(scenario), get(name), range(1000, 1004)) for name in ("ilc", "pid"))
        assert np.array_equal(own.data, inner.data)


def test_its_inner_pid_is_the_tuned_one():
    own, inner = get("ilc").parameters(), get("pid").parameters()
    shared = [name for name in inner if name in own]
    assert len(shared) == len(inner)
    assert {name: own[name].value for name in shared} == {name: inner[name].value for name in shared}


def test_machines_of_a_fleet_learn_alone():
    case, law = load("laps-rough").varied(duration=2.5), get("ilc")
    together, alone = roll(case, law, [1000, 1001, 1002]), roll(case, law, [1001])
    assert np.array_equal(together.data[:, :, 1], alone.data[:, :, 0])


def test_a_new_episode_starts_with_nothing_learnt():
    case = load("laps-wavy").varied(duration=2.5)
    fleet = fleet_for(case, get("ilc"), [1003])
    gaps = []
    for _ in range(2):
        record = fleet.start_recording(case.steps)
        fleet.advance(case.steps)
        fleet.stop_recording()
        gaps.append(record[:, 0, 0].copy())
        fleet.begin([0], scenarios.noise_keys([1003]))
    assert np.array_equal(*gaps)


def test_in_the_environment_it_learns_what_it_learns_in_a_roll_out():
    case = load("laps-wavy")
    env = gym.make("kerfgym/HeightFollowing-v0", scenario=case, split="test", base="ilc", max_steps=2000).unwrapped
    record = roll(case.varied(duration=2.0), get("ilc"), [1004])
    for _ in range(2):  # the second episode, too
        env.reset(options={"scenario_seed": 1004})
        gaps = [env.step(np.zeros(1, np.float32))[4]["true_gap"] for _ in range(2000)]
        assert np.array_equal(np.array(gaps, np.float32), record["gap"][:, 0])
    error = np.square(record.error[:, 0])
    assert error[300:942].mean() > 2.0 * error[1242:1884].mean()  # the same places, a lap later


def test_laps_too_long_for_the_memory_are_travelled_by_the_pid():
    case = load("laps-wavy").varied(circle={"radius": 80.0, "laps": 3}, feed=400.0, duration=2.6)
    assert 2 * np.pi * 80.0 / 0.1 > ilc.CELLS > 2 * np.pi * 80.0 / 0.2
    long, short, plain = (roll(case, resolve(name), [1000]) for name in ("ilc:law.cell=0.1", "ilc:law.cell=0.2", "pid"))
    assert np.array_equal(long.data, plain.data)
    assert not np.array_equal(short.data, plain.data)


# ----------------------------------------------------------------------------------------------- on a plant by hand


class Plant:
    """A head that moves as commanded ``delay`` periods ago, over a sine of the lap; the law in Python."""

    def __init__(self, params, delay, wavelength, noise=0.0, cells=100):
        self.p, self.delay, self.k = params, delay, 2 * np.pi / wavelength
        self.memory, self.state = np.zeros(ilc.MEMORY), ilc.init(params)
        self.lap, self.feed = cells * params.cell, 200.0
        self.queue, self.head, self.tick = [0.0] * delay, 0.8, 0
        self.errors = []

    def run(self, laps):
        for _ in range(round(laps * self.lap / self.feed / PERIOD)):
            here = self.tick * PERIOD * self.feed
            lap = int(here / self.lap + 1e-9)
            height = self.head - 0.2 * np.sin(self.k * here)
            x = Sensed(
                height=height,
                set_height=0.8,
                head_position=self.head,
                captured=True,
                fresh=self.tick == 0,
                feed=self.feed,
                place=max(here - lap * self.lap, 0.0),
                lap=float(lap),
            )
            self.state, wish = ilc.control(self.p, self.state, x, (), self.memory)
            self.queue.append(wish)
            self.head += self.queue.pop(0) * PERIOD
            self.errors.append(height - 0.8)
            self.tick += 1
        per = round(self.lap / self.feed / PERIOD)
        return np.sqrt(np.mean(np.reshape(self.errors, (-1, per)) ** 2, axis=1))


SLOW = ilc.Params(kp=30.0, ki=0.0, kd=0.0, lag=0.0, learn=0.5, lead=5.0, smooth=0.0, gate=1.0, cell=0.4)


@pytest.mark.parametrize("kp", [5.0, 30.0])
@pytest.mark.parametrize("wavelength", [20.0, 10.0])
@pytest.mark.parametrize("learn", [0.2, 0.4])
def test_a_frequency_shrinks_as_the_loops_transfer_functions_say(kp, wavelength, learn):
    lead = 6.0
    plant = Plant(SLOW._replace(learn=learn, kp=kp, lead=lead, cell=0.2), 5, wavelength, cells=400)
    error = plant.run(5)
    iw, delay = 2j * np.pi * 200.0 / wavelength, 5.5e-3  # the queue's, and half a period of the hold's
    # F reaches e through exp(−iωτ)/(iω + kp·exp(−iωτ)) and is learnt from −(iω + kp)·e, `lead` later.
    factor = 1 - learn * np.exp(iw * (lead * 1e-3 - delay)) * (iw + kp) / (iw + kp * np.exp(-iw * delay))
    assert error[2:] / error[1:-1] == pytest.approx(abs(factor), abs=0.03)


def test_a_lead_that_is_wrong_by_more_than_a_quarter_of_the_period_makes_it_grow_and_q_stops_that():
    wrong = SLOW._replace(lead=17.0)  # at 10 Hz of the sheet, 12 ms are 43°; at 40 Hz more than half a period
    assert Plant(wrong, 5, wavelength=20.0).run(6)[-1] < 0.5 * Plant(wrong, 5, wavelength=20.0).run(1)[0]
    grows = Plant(wrong, 5, wavelength=5.0).run(6)
    assert grows[-1] > 1.5 * grows[0]
    stopped = Plant(wrong._replace(smooth=30.0), 5, wavelength=5.0).run(6)
    assert stopped[-1] < 1.1 * stopped[0]


def test_an_impulse_is_learnt_no_further_than_the_gate():
    for gate, most in ((0.01, 0.5 * 0.011 / PERIOD), (5.0, np.inf)):
        p = SLOW._replace(gate=gate, kp=1.0, cell=0.2)
        memory, state = np.zeros(ilc.MEMORY), ilc.init(p)
        for tick in range(150):
            height = 0.8 + 0.2 * (tick == 60)
            x = Sensed(height=height, set_height=0.8, captured=True, fresh=tick == 0, feed=200.0, place=0.2 * tick)
            state, _ = ilc.control(p, state, x, (), memory)
        learnt = np.abs(memory[: 2 * ilc.CELLS]).max()
        assert 0.0 < learnt < most
        assert gate < 1.0 or learnt > 0.5 * 0.05 / PERIOD


@pytest.mark.parametrize(("feed", "reach"), [(100.0, 40), (200.0, 60)])
def test_q_reaches_as_far_as_its_length_says_and_no_further_than_sixty_cells(feed, reach):
    # 40 ms are 40 cells of 0.1 mm at 100 mm/s, and would be 80 at 200 mm/s.
    p = ilc.Params(kp=0.0, ki=0.0, kd=0.0, learn=1.0, lead=0.0, smooth=40.0, gate=1.0, cell=0.1)
    memory, state = np.zeros(ilc.MEMORY), ilc.init(p)
    for tick in range(165):
        height = 0.8 + 0.01 * (tick >= 75)  # once: what was seen is not 0 in one period's cells
        place = 0.05 + tick * PERIOD * feed
        x = Sensed(height=height, set_height=0.8, captured=True, fresh=tick == 0, feed=feed, place=place)
        state, _ = ilc.control(p, state, x, (), memory)
    assert np.count_nonzero(memory[: 2 * ilc.CELLS]) == 2 * reach + feed * PERIOD / p.cell


def test_nothing_is_learnt_while_the_supervisor_overrides():
    memory, state = np.zeros(ilc.MEMORY), ilc.init(SLOW)
    for tick in range(200):
        x = Sensed(
            height=1.0 + 0.001 * tick,
            set_height=0.8,
            captured=True,
            override=True,
            fresh=tick == 0,
            feed=200.0,
            place=0.2 * tick,
        )
        state, _ = ilc.control(SLOW, state, x, (), memory)
    assert not memory.any()


# --------------------------------------------------------------------------------------------------- the circle


def test_a_circle_is_travelled_lap_after_lap_and_sees_the_same_sheet():
    case = load("laps-wavy").varied(duration=2.0, circle={"radius": 20.0, "laps": 5})
    fleet = Fleet(1, get("idle").law, heads.POOL)
    scenarios.prepare(fleet, case, [0], [1000])
    fleet.begin([0], scenarios.noise_keys([1000]))
    lap = 2 * np.pi * 20.0
    seen = []
    for _ in range(2000):
        fleet.advance()
        x = fleet.get("signals")
        seen.append((x.place, x.lap, x.surface_0))
    places, laps, surfaces = np.array(seen).T
    assert laps[-1] == np.floor(places[-1] / lap + 400.0 / lap) == 3.0
    assert places.max() < lap
    along = laps * lap + places
    assert np.diff(along) == pytest.approx(200.0 * PERIOD)
    again = np.interp(places[laps == 1], places[laps == 0], surfaces[laps == 0])
    assert np.ptp(surfaces) > 0.1
    assert np.abs(again - surfaces[laps == 1])[5:-5].max() < 2e-3


def test_the_noise_is_another_in_each_lap():
    spread = []
    for noise in (0.0, 0.005):
        case = load("laps-wavy").varied(duration=2.0, head={"noise": noise, "impulses": 0.0}, feed=30 * 2 * np.pi)
        raw = roll(case, get("idle"), [1000])["raw_height"][:, 0]  # 1000 periods a lap
        spread.append(np.std(raw[1000:2000] - raw[:1000]))
    assert spread[1] > 10 * spread[0]


def test_a_circle_excludes_a_drawing_and_a_job():
    with pytest.raises(Exception, match="path and circle exclude each other"):
        load("laps-wavy").varied(path="part.dxf")
    with pytest.raises(Exception, match="job and circle exclude each other"):
        load("contour-square").varied(circle={"radius": 20.0})
