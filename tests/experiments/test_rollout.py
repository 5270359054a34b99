"""Roll-outs: the same bits whatever the company, limits kept under any command, and controllers in plain Python."""

import numpy as np
import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control.stack import get, python_stack, resolve
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.figures import metrics
from kerfgym.envs.plant import heads, machine, supervisor
from kerfgym.envs.plant.controller import PERIOD
from kerfgym.envs.plant.fleet import Fleet
from kerfgym.envs.scenarios import load, suite
from kerfgym.experiments.measure.rollout import chunks, command_of, roll

ALL = load("wavy").varied(
    name="all at once",
    guard=True,
    start_above=0.5,
    head={"impulses": 20, "impulse_samples": 2, "bursts": 5, "drift": 0.001, "warming": 1.0},
    sheet={
        "tilt": {"uniform": [-0.01, 0.01]},
        "vibrations": [{"frequency": {"uniform": [12, 30]}, "amplitude": 0.02}] * 3,
        "holes": {"pitch": 60, "length": {"uniform": [2, 15]}, "round": True},
        "bulge": {"height": 0.5, "width": 40, "growth": 1, "x": 40},
    },
)
"""Everything a sheet and a sensor can do, in one machine."""

MIX = [*(load(n) for n in ("wavy", "rough", "step", "holes", "impulses", "flutter", "bulge", "descent", "tip-up")), ALL]
"""Machine i of a mixture travels MIX[i mod 10], with seed 1000 + i."""

COLUMNS = (
    "signals.gap",
    "signals.height",
    "signals.raw_height",
    "signals.frequency",
    "signals.surface_0",
    "signals.surface_5",
    "signals.head_position",
    "signals.command",
    "signals.mode",
    "motion.position",
    "motion.velocity",
    "motion.acceleration",
    "supervisor.anchor",
    "tally.lowest",
    "journey.distance",
)
PERIODS = 400


def mixture(order, law="pid", threads=1, begun=True):
    """A fleet in which place j holds machine ``order[j]`` of the mixture."""
    order = np.asarray(order)
    chosen = get(law)
    fleet = Fleet(len(order), chosen.law, heads.POOL, threads)
    for which, scenario in enumerate(MIX):
        places = np.flatnonzero(order % len(MIX) == which)
        if len(places):
            scenarios.prepare(fleet, scenario, places, 1000 + order[places])
    chosen.install(fleet, np.arange(len(order)))
    if begun:
        begin(fleet, np.arange(len(order)), order)
    return fleet


def begin(fleet, places, order):
    fleet.begin(places, scenarios.noise_keys(1000 + np.asarray(order)))


def state(fleet, places=slice(None)):
    """What a fleet knows of the machines at some places, as bits, shape (columns, machines)."""
    return np.array([fleet.column(c)[places] for c in COLUMNS]).view(np.uint64)


@pytest.fixture(scope="module")
def whole():
    """Machines 0 to 256 of the mixture after 400 periods."""
    fleet = mixture(np.arange(257))
    fleet.advance(PERIODS)
    return state(fleet)


# ------------------------------------------------------------------------------------------------------- bit identity


def test_the_mixture_holds_what_it_should(whole):
    values = whole.view(np.float64)
    assert np.isfinite(values).all()
    for column in ("signals.gap", "signals.height", "motion.position", "signals.frequency"):
        assert len(np.unique(values[COLUMNS.index(column)])) > 200, column
    modes = values[COLUMNS.index("signals.mode")]
    assert {supervisor.FOLLOW, supervisor.HOLD} <= set(modes)


@pytest.mark.parametrize("machine_", [0, 1, 3, 6, 9, 31, 32, 63, 64, 249, 255, 256])
def test_a_machine_alone_has_the_bits_it_has_among_257(whole, machine_):
    fleet = mixture([machine_])
    fleet.advance(PERIODS)
    assert np.array_equal(state(fleet)[:, 0], whole[:, machine_])


@pytest.mark.parametrize("size", [7, 64])
@pytest.mark.parametrize("threads", [1, 2])
def test_fleets_of_any_size_and_order_give_a_seed_the_same_bits(whole, size, threads):
    order = np.random.default_rng(size).permutation(257)[:size]
    fleet = mixture(order, threads=threads)
    fleet.advance(PERIODS)
    assert np.array_equal(state(fleet), whole[:, order])


def test_two_threads_give_the_bits_of_one(whole):
    order = np.arange(257)[::-1]
    fleet = mixture(order, threads=2)
    fleet.advance(PERIODS)
    assert np.array_equal(state(fleet), whole[:, order])


def test_one_period_at_a_time_gives_the_bits_of_all_at_once(whole):
    order = np.arange(40)
    fleet = mixture(order, threads=2)
    for _ in range(PERIODS // 2):
        fleet.advance()
    for _ in range(PERIODS // 2):
        fleet.stepper()()
    assert np.array_equal(state(fleet), whole[:, order])


@pytest.mark.parametrize("tick", [1, 137])
def test_an_episode_that_begins_later_has_the_same_bits(whole, tick):
    order = np.arange(50)
    fleet = mixture(order)
    fleet.advance(tick)
    late = np.arange(3, 50, 7)
    begin(fleet, late, late)
    fleet.advance(PERIODS)
    assert np.array_equal(state(fleet, late), whole[:, late])


def test_machines_that_are_not_reset_notice_nothing(whole):
    order = np.arange(50)
    fleet = mixture(order)
    fleet.advance(150)
    again, others = np.array([0, 9, 31, 32]), np.setdiff1d(order, [0, 9, 31, 32])
    before = state(fleet, others)
    scenarios.prepare(fleet, ALL, again, 5000 + again)
    get("pid").install(fleet, again)
    begin(fleet, again, again)
    assert np.array_equal(state(fleet, others), before)
    fleet.advance(PERIODS - 150)
    assert np.array_equal(state(fleet, others), whole[:, others])


def test_a_neighbours_wider_filter_changes_no_bit_of_the_others():
    alone = mixture(np.arange(40), "xi2023-improved")
    mixed = mixture(np.arange(40), "xi2023-improved", begun=False)
    wide = np.arange(0, 40, 3)
    resolve("xi2023-improved:filter.window=31,filter.trim=3").install(mixed, wide)
    begin(mixed, np.arange(40), np.arange(40))
    alone.advance(PERIODS)
    mixed.advance(PERIODS)
    others = np.setdiff1d(np.arange(40), wide)
    assert np.array_equal(state(alone, others), state(mixed, others))
    assert not np.array_equal(state(alone, wide), state(mixed, wide))


def test_a_recording_is_what_the_columns_hold():
    record = roll(load("wavy").varied(duration=0.4), get("pid"), np.arange(1000, 1040), threads=2)
    fleet = Fleet(40, get("pid").law, heads.POOL)
    seeds = np.arange(1000, 1040)
    scenarios.prepare(fleet, load("wavy"), np.arange(40), seeds)
    get("pid").install(fleet, np.arange(40))
    fleet.begin(np.arange(40), scenarios.noise_keys(seeds))
    for period in range(400):
        fleet.advance()
        if period % 50 == 49:
            for channel, column in (
                ("gap", "signals.gap"),
                ("height", "signals.height"),
                ("raw_height", "signals.raw_height"),
                ("surface", "signals.surface_0"),
                ("head", "signals.head"),
                ("velocity", "motion.velocity"),
                ("acceleration", "motion.acceleration"),
                ("command", "signals.command"),
                ("mode", "signals.mode"),
            ):
                assert np.array_equal(record[channel][period], fleet.column(column).astype(np.float32)), channel
    assert np.array_equal(record.set_height, fleet.column("job.set_height"))
    assert np.array_equal(record.lowest, fleet.column("tally.lowest"))
    along = fleet.column("path.feed")[0] * PERIOD * np.arange(1, 401)
    assert record["distance"][:, 0] == pytest.approx(along, abs=1e-4)


def test_other_seeds_give_other_runs():
    record = roll(load("flat").varied(duration=0.1), get("pid"), np.arange(1000, 1050))
    assert np.unique(record["height"], axis=1).shape[1] == 50


# ---------------------------------------------------------------------------------------------------- limits


@pytest.mark.parametrize("name", [*suite("following"), *(f"following-v1/{name}" for name in suite("following-v1"))])
def test_any_command_leaves_every_number_finite_and_the_axis_within_its_limits(name):
    size, periods, rng = 100, 1000, np.random.default_rng(9)
    seeds = np.arange(1000, 1000 + size)
    fleet = Fleet(size, get("idle").law, heads.POOL)
    every = np.arange(size)
    scenarios.prepare(fleet, load(name), every, seeds)
    fleet.set("start.gap", every[::4], 30.0)  # these are not stopped by a collision soon
    get("idle").install(fleet, every)
    fleet.begin(every, scenarios.noise_keys(seeds))
    record = fleet.start_recording(periods)
    # Commands up to twice the axis's top speed, held for 1 ms on some machines and for up to 60 ms on others.
    held, command = np.zeros(size, int), np.zeros(size)
    longest = np.where(every % 2, 1, 60)
    for _ in range(periods):
        new = held <= 0
        command = np.where(new, rng.uniform(-1000, 1000, size), command)
        held = np.where(new, rng.integers(1, longest + 1), held) - 1
        fleet.set("hand.residual", every, command)
        fleet.advance()
    fleet.stop_recording()
    assert np.isfinite(record).all()

    def channel(which):
        return record[:, machine.CHANNELS.index(which)].astype(float)

    round_off = 1 + 1e-5
    assert np.all(np.abs(channel("velocity")) <= fleet.column("z.speed") * round_off)
    # Bristles that let go add what they held, past the drive's own limits.
    held = np.where(fleet.column("z.bristle") > 0.0, fleet.column("z.stiction") * fleet.column("z.friction"), 0.0)
    assert np.all(np.abs(channel("acceleration")) <= (fleet.column("z.acceleration") + held) * round_off)
    jerk = (
        np.abs(np.diff(channel("acceleration"), axis=0)) / PERIOD
    )  # its mean over a period, so no more than the limit
    assert np.all(jerk <= (fleet.column("z.jerk") + 2.0 * held / PERIOD) * round_off)
    assert np.abs(channel("command")).max() <= 1000
    assert np.all(channel("height") >= 0)
    assert np.all(channel("height") <= 10.1)
    position = fleet.column("motion.position")
    assert np.all((position >= fleet.column("z.low")) & (position <= fleet.column("z.high")))
    assert np.abs(channel("acceleration")).max() > 0.99 * fleet.column("z.acceleration").min()


# --------------------------------------------------------------------------------------- controllers in plain Python


class Proportional:
    """The law of Xi2023 in plain Python."""

    def reset(self):
        self.periods = 0

    def control(self, signals):
        self.periods += 1
        return -50.0 * (signals.height - signals.set_height)


@pytest.mark.parametrize("name", ["wavy", "holes", "descent"])
def test_a_plain_python_law_gives_the_bits_of_the_compiled_one(name):
    scenario, seeds = load(name).varied(duration=0.6), [1000, 1003, 1007]
    python = roll(scenario, python_stack(Proportional, "mine"), seeds)
    compiled = roll(scenario, resolve("xi2023-improved:law.kv=50"), seeds)
    for channel in machine.CHANNELS:
        if channel != "wish":  # the hand moves the machine, not its law
            assert np.array_equal(python[channel], compiled[channel]), channel
    assert np.array_equal(python.lowest, compiled.lowest)
    assert np.ptp(python["head"]) > 0.05


class Counting:
    """Every machine has a mind of its own, which is reset once and sees only what the machine measures."""

    minds = []

    def __init__(self):
        self.seen, self.resets = [], 0
        Counting.minds.append(self)

    def reset(self):
        self.resets += 1

    def control(self, signals):
        self.seen.append(signals)
        return 0.0


def test_every_machine_has_a_mind_of_its_own_that_sees_what_the_machine_measures():
    Counting.minds.clear()
    record = roll(load("wavy").varied(duration=0.05), python_stack(Counting, "count"), [1000, 1001])
    assert len(Counting.minds) == 2
    for index, mind in enumerate(Counting.minds):
        assert mind.resets == 1
        assert len(mind.seen) == 50
        assert [x.fresh for x in mind.seen] == [True] + [False] * 49
        heights = np.array([x.height for x in mind.seen[1:]], np.float32)
        assert np.array_equal(heights, record["height"][:-1, index])
        assert not hasattr(mind.seen[0], "gap")
        assert not hasattr(mind.seen[0], "surface_0")


def answering(answer):
    """A class of controllers that always give this answer."""
    return type("Mine", (), {"reset": lambda self: None, "control": lambda self, signals: answer})


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (np.zeros(2), r"controller 'mine' returned an array of shape \(2,\); control\(\) must return one number, mm/s"),
        ([], r"controller 'mine' returned an array of shape \(0,\); control\(\) must return one number"),
        ("fast", r"controller 'mine' returned 'fast'; control\(\) must return one number, mm/s"),
        ({"u": 1}, r"controller 'mine' returned \{'u': 1\}; control\(\) must return one number"),
        (None, r"controller 'mine' returned None; control\(\) must return one number"),
    ],
)
def test_an_answer_that_is_not_one_number_is_refused(answer, message):
    with pytest.raises(InvalidInput, match=message):
        roll(load("flat").varied(duration=0.05, settle=0.0), python_stack(answering(answer), "mine"), [0])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_run_in_which_the_answer_is_not_finite_has_failed_and_the_others_have_not(bad):
    class Mine:
        made = 0

        def __init__(self):
            self.number, Mine.made = Mine.made, Mine.made + 1

        def reset(self):
            self.period = 0

        def control(self, signals):
            self.period += 1
            return bad if self.number == 1 and self.period == 30 else 0.0

    recording = roll(load("flat").varied(duration=0.05, settle=0.0), python_stack(Mine, "mine"), [0, 1, 2])
    assert metrics.failed(recording).tolist() == [False, True, False]
    assert np.isnan(metrics.evaluate(recording)["rms_true"]).tolist() == [False, True, False]


@pytest.mark.parametrize("answer", [3, 3.0, np.float32(3), np.array(3.0), np.array([3.0]), [3.0]])
def test_one_number_may_come_in_any_wrapping(answer):
    assert command_of(answer, "mine") == 3.0


# ---------------------------------------------------------------------------------------------------- odds and ends


def test_seeds_are_dealt_in_groups_in_their_order():
    dealt = list(chunks(range(1000, 1600)))
    assert [len(part) for part in dealt] == [256, 256, 88]
    assert np.concatenate(dealt).tolist() == list(range(1000, 1600))


def test_a_fleet_needs_a_machine_and_a_thread():
    with pytest.raises(InvalidInput, match="at least 1 machine, not 0"):
        Fleet(0, get("idle").law, heads.POOL)
    with pytest.raises(InvalidInput, match="num_threads = 0; at least 1"):
        Fleet(1, get("idle").law, heads.POOL, 0)
