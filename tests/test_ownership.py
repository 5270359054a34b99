"""Whatever is handed out keeps alive what it points to: every kind of function and array, with its owner gone.

Each test makes two of a kind from the same seeds. One lives, of the other only what was handed out is kept; then the
collector runs, and the freed memory is written over. Both must go on alike, bit for bit.
"""

import copy
import gc
import pickle
import re
import weakref
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import kerfgym
from kerfgym.agents import compiled
from kerfgym.agents.vec_env import HeightFollowingVecEnv
from kerfgym.envs import scenarios
from kerfgym.envs.control import panel
from kerfgym.envs.control import stack as stacks
from kerfgym.envs.cutting import CuttingEnv
from kerfgym.envs.engine.deck import Deck, places
from kerfgym.envs.engine.kernels import Kernel
from kerfgym.envs.height_following import HeightFollowingEnv, HeightFollowingVectorEnv
from kerfgym.envs.plant import calibration, heads, machine, path, prompt
from kerfgym.envs.plant.controller import stage_address
from kerfgym.envs.plant.fleet import Fleet
from kerfgym.envs.tasks import workshop
from kerfgym.envs.tasks.batch import Batch
from kerfgym.envs.tasks.interface import TASK
from kerfgym.envs.tasks.job_interface import CONTOUR, CUTTING
from kerfgym.experiments.measure import cost, margins, rollout
from kerfgym.experiments.studies.faults import inject
from kerfgym.experiments.studies.faults.inject import Fault, Faults, Without

SIZE, PERIODS = 5, 40
EVERY = np.arange(SIZE)


def churn():
    """Collects what nobody holds, and writes over the memory that has become free, pieces of every size."""
    gc.collect()
    held = []
    for count in (*range(1, 200), *(int(1.3**i) for i in range(20, 52))):
        held += [np.full(count, 0xFFFFFFFFFFFFFFFF, np.uint64) for _ in range(8 if count < 200 else 2)]
    assert held[-1][-1] == 0xFFFFFFFFFFFFFFFF


# --------------------------------------------------------------------------------------------------------- fleets


def controlled(spec, scenario="wavy", change=None):
    def make(threads=1, size=SIZE):
        return rollout.fleet_for(scenarios.load(scenario), stacks.resolve(spec), np.arange(size), threads, change)

    return make


def begun(prepare, spec="pid"):
    """A fleet that has got something more from arrays of which nobody else knows."""

    def make(threads=1, size=SIZE):
        fleet = controlled(spec)(threads, size)
        prepare(fleet, np.arange(size))
        fleet.begin(np.arange(size), np.arange(size) + 7)
        return fleet

    return make


def travelled(fleet, every):
    for radius in (5.0, 9.0):
        turn = np.linspace(0.0, 6.0, 200)
        pieces = [radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)]
        fleet.put_contours([path.resample(f"arc {radius}", pieces)], np.zeros(len(every), int), every)


def uneven(fleet, every):
    for seed in (1, 2):
        fleet.put_profile(np.random.default_rng(seed).normal(0.0, 0.02, 400), 0.5, every)


def bumpy(fleet, every):
    fleet.put_map(np.random.default_rng(3).normal(0.0, 0.02, (60, 60)), -5.0, -5.0, 1.0, every)


def replayed(fleet, every):
    fleet.replay(np.random.default_rng(4).uniform(2e6, 3e6, 100))


def own_tables(fleet, every):
    pool = calibration.Pool(1)
    pool[0] = heads.table(3)
    fleet.read_from(pool, 0)


def late(fleet, every):
    numbers = np.zeros(1 + (2 + margins.RING) * fleet.blocks * 32)
    numbers[0], numbers[1 : 1 + fleet.blocks * 32] = fleet.blocks * 32, 0.7
    fleet.at_end(stage_address(margins.fault), numbers)


def prompted(fleet, every):
    prompt.install(fleet, every)


def another_law(fleet, every):
    stack = stacks.resolve("lqg")
    fleet.drive_by(stack.law)
    stack.install(fleet, every)


def cutting(spec):
    def make(threads=1, size=SIZE):
        scenario = scenarios.load("cut-square")
        return workshop.fleet_for(scenario, stacks.team(spec), np.arange(size), threads)

    return make


FLEETS = {
    "law": controlled("pid"),
    "law with memory": controlled("lqg"),
    "two policies, one after the other": begun(
        lambda fleet, every: stacks.resolve("height-following-ppo").install(fleet, every), "height-following-ppo"
    ),
    "policy": controlled("height-following-ppo"),
    "policy with a schedule": controlled("height-following-schedule-ppo"),
    "contours": begun(travelled),
    "profiles": begun(uneven),
    "map": begun(bumpy),
    "signal": begun(replayed),
    "tables": begun(own_tables),
    "stage at the end": begun(late),
    "stage behind the filter": begun(prompted, "lqg"),
    "another law": begun(another_law),
    "job": cutting("recipe"),
    "job with a policy": cutting("cutting-ppo"),
    "contour with a policy": cutting("contour-following-ppo"),
}


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("kind", FLEETS)
def test_a_stepper_keeps_its_fleet_and_all_that_belongs_to_it(kind, threads):
    size = SIZE if threads == 1 else 40  # two blocks, one for each thread
    whole, gone = FLEETS[kind](threads, size), FLEETS[kind](threads, size)
    expected, found = whole.start_recording(3 * PERIODS), gone.start_recording(3 * PERIODS)
    whole_cut = whole.gantries and whole.gantries.start_recording(3 * PERIODS, whole.tick)
    cut = gone.gantries and gone.gantries.start_recording(3 * PERIODS, gone.tick)
    step = gone.stepper(3)
    del gone
    churn()
    for _ in range(PERIODS):
        step()
    whole.advance(3 * PERIODS)
    assert np.abs(np.diff(found[:, machine.CHANNELS.index("head")], axis=0)).max() > 0.0
    np.testing.assert_array_equal(found, expected)
    if whole.gantries:
        np.testing.assert_array_equal(cut, whole_cut)


def test_a_stepper_keeps_its_fleet_no_longer_than_it_lives_itself():
    fleet = FLEETS["job with a policy"]()
    seen, step = weakref.ref(fleet.deck), fleet.stepper()
    gc.disable()
    try:
        del fleet
        assert seen() is not None
        del step
        assert seen() is None  # no circle, so nobody waits for the collector
    finally:
        gc.enable()


def test_a_stepper_goes_on_with_its_own_steps_when_others_are_handed_out():
    fleet = FLEETS["law"]()
    one, eight = fleet.stepper(), fleet.stepper(8)
    for step, periods in ((one, 1), (eight, 8), (one, 1), (fleet.advance, 1), (eight, 8)):
        before = fleet.tick
        step()
        assert fleet.tick - before == periods


def test_steps_that_break_off_do_not_stay_in_force(monkeypatch):
    fleet = FLEETS["law"](2, 40)

    def interrupted(call):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(kerfgym.envs.engine.workers.Workers, "share", lambda self, call: interrupted(call))
        with pytest.raises(KeyboardInterrupt):
            fleet.advance(500)
    before = fleet.tick
    fleet.advance()
    assert fleet.deck["steps"] == 1
    assert fleet.tick - before == 1


# ----------------------------------------------------------------------------------------- environments and batches


def episode(kind, **arguments):
    batch = Batch(kind, 3, **arguments)
    batch.sequence(np.arange(3), np.arange(3))
    batch.restart(np.arange(3))
    batch.actions[:] = np.linspace(-0.6, 0.9, batch.actions.size).reshape(batch.actions.shape)
    while (batch.rewards == 0.0).any():  # until all cut
        batch.advance()
    return batch


BATCHES = {
    "following": (TASK, {"scenario": "wavy"}),
    "schedule": (TASK, {"scenario": "rough", "control": "schedule"}),
    "raw": (TASK, {"observation": "raw", "control": "direct"}),
    "contour": (CONTOUR, {}),
    "cutting": (CUTTING, {}),
    "several threads": (TASK, {"threads": 2}),
}


@pytest.mark.parametrize("kept", ["observations", "rewards", "returns", "infos", "left"])
@pytest.mark.parametrize("kind", BATCHES)
def test_a_batch_s_step_keeps_every_array_that_the_kernel_reads_and_writes(kind, kept):
    make, arguments = BATCHES[kind]
    whole, gone = episode(make, **arguments), episode(make, **arguments)
    found, advance = getattr(gone, kept), gone.advance
    before = found.copy()
    del gone
    churn()
    for _ in range(PERIODS):
        advance()
        whole.advance()
    assert not np.array_equal(found, before)
    np.testing.assert_array_equal(found, getattr(whole, kept))


@pytest.mark.parametrize("make", [HeightFollowingEnv, lambda: HeightFollowingEnv(control="schedule"), CuttingEnv])
def test_an_environment_s_step_outlives_the_environment(make):
    whole, gone = make(), make()
    whole.reset(seed=5), gone.reset(seed=5)
    step, action = gone.step, 0.5 * np.ones(gone.action_space.shape, np.float32)
    del gone
    churn()
    for _ in range(PERIODS):
        found, expected = step(action), whole.step(action)
        np.testing.assert_array_equal(found[0], expected[0])
        assert found[1:4] == expected[1:4]


@pytest.mark.parametrize("make", [HeightFollowingVectorEnv, HeightFollowingVecEnv])
def test_what_a_step_returned_is_the_user_s(make):
    env = make(4, scenario="wavy")
    env.reset()
    actions = np.full((4, 1), 0.3, np.float32)
    returned = env.step(actions)
    before = copy.deepcopy(returned)
    for _ in range(PERIODS):
        env.step(-actions)
    del env
    churn()
    for now, then in zip(returned, before, strict=True):
        if isinstance(now, np.ndarray):
            np.testing.assert_array_equal(now, then)


def test_a_panel_s_views_read_the_machine_that_it_had():
    whole, gone = panel.Panel(), panel.Panel()
    tick, views = gone.tick, dict(gone._views)
    del gone
    churn()
    for _ in range(PERIODS):
        tick(), whole.tick()
    for name, view in views.items():
        assert view[0] == whole[name]


# ---------------------------------------------------------------------------------------------------------- arrays


def test_views_of_a_column_outlive_the_fleet():
    fleet = FLEETS["job"]()
    fleet.advance(PERIODS)
    views = [
        fleet.row("motion.position", 2),
        fleet.slots(machine.SIGNALS, 6, 3),
        fleet.gantries.row("progress.near", 1),
    ]
    before = [view.copy() for view in views]
    del fleet
    churn()
    for view, then in zip(views, before, strict=True):
        np.testing.assert_array_equal(view, then)


def test_a_recording_is_the_caller_s_when_the_next_one_begins():
    fleet, whole = FLEETS["job"](), FLEETS["job"]()
    expected = whole.start_recording(2 * PERIODS), whole.gantries.start_recording(2 * PERIODS, 0)
    whole.advance(2 * PERIODS)
    parts = []
    for _ in range(2):
        parts.append((fleet.start_recording(PERIODS), fleet.gantries.start_recording(PERIODS, fleet.tick)))
        churn()
        fleet.advance(PERIODS)
    for now, then in zip(zip(*parts, strict=True), expected, strict=True):
        np.testing.assert_array_equal(np.concatenate(now), then)


@pytest.mark.parametrize("kind", ["law", "job"])
def test_a_recording_that_is_full_is_not_written_beyond_its_end(kind):
    fleet = FLEETS[kind]()
    for owner, start in (
        (fleet, lambda: fleet.start_recording(4)),
        (fleet.gantries, lambda: fleet.gantries.start_recording(4, fleet.tick)),
    ):
        if owner is None:
            continue
        shape = start().shape
        room = np.full((20, *shape[1:]), np.nan, np.float32)
        owner.deck["record"] = room  # the recording is the beginning of a larger array
        fleet.advance(3)
        fleet.advance(12)
        assert np.isfinite(room[:4]).all()
        assert np.isnan(room[4:]).all()
        owner.stop_recording()


def test_a_recording_that_was_stopped_belongs_to_the_caller_alone():
    fleet = FLEETS["job"]()
    records = [fleet.start_recording(4), fleet.gantries.start_recording(4, fleet.tick)]
    seen = [weakref.ref(record) for record in records]
    fleet.stop_recording(), fleet.gantries.stop_recording()
    del records
    assert [one() for one in seen] == [None, None]
    fleet.advance(PERIODS)


def test_gantries_that_have_no_job_yet_rest():
    team = stacks.team("recipe")
    fleet = Fleet(SIZE, team.z.law, heads.POOL)
    gantries = fleet.use_gantries(team.xy.law, team.process.law)
    fleet.begin(EVERY, EVERY)
    fleet.advance(PERIODS)
    assert [gantries.trail(fleet.tick - 1, i)[:2] for i in EVERY] == [(0.0, 0.0)] * SIZE


def test_gantries_decks_outlive_the_fleet_in_what_knows_their_address():
    fleet = FLEETS["job"]()
    deck, gone = Deck(Pair, first=fleet.gantries.deck), weakref.ref(fleet.gantries.deck)
    del fleet
    churn()
    assert gone() is not None
    assert deck["first"] == gone().words.ctypes.data


# --------------------------------------------------------------------------------------------- kernels and addresses


class Pair(NamedTuple):
    first: int
    second: int


def test_a_bound_kernel_keeps_the_kernel_and_the_deck():
    fleet = FLEETS["law"]()
    record = fleet.start_recording(PERIODS)
    kernel = Kernel(machine.advance.function)
    step, gone = kernel.bound(fleet.deck), weakref.ref(fleet.deck)
    del kernel, fleet
    churn()
    for _ in range(PERIODS):
        step()
    assert gone()["tick"] == PERIODS
    whole = FLEETS["law"]()
    expected = whole.start_recording(PERIODS)
    whole.advance(PERIODS)
    np.testing.assert_array_equal(record, expected)


def test_a_number_that_keeps_nothing_alive_is_no_argument():
    fleet = FLEETS["law"]()
    with pytest.raises(TypeError, match="keeps nothing alive"):
        machine.advance.bound(fleet.deck.words.ctypes.data)
    for give in (
        lambda words: fleet.hook(0, 0, words),
        lambda words: fleet.pilot("height", 0, words),
        lambda words: fleet.after_sensor(0, words),
        lambda words: fleet.after_supervisor(0, words),
        lambda words: fleet.at_end(0, words),
    ):
        with pytest.raises(AssertionError, match=r"keeps? nothing alive"):
            give(np.zeros(20, np.uint64))


def test_a_deck_keeps_what_it_points_to_until_the_entry_changes():
    array = np.arange(3.0)
    inner = Deck(Pair, first=array, second=7)
    outer, gone = Deck(Pair, second=inner), weakref.ref(array)
    assert (inner["first"], inner["second"], outer["first"]) == (array.ctypes.data, 7, 0)
    assert inner.owned("first") is array
    assert inner.owned("second") is None
    del array, inner
    gc.collect()
    assert gone() is not None
    outer["second"] = 0
    assert gone() is None


def test_a_deck_s_words_lie_where_its_places_say():
    deck, at = Deck(Pair, second=9), places(Pair)
    assert deck.words[at.second] == 9
    deck.words[at.first] = 5  # as a kernel does
    assert deck["first"] == 5
    with pytest.raises(KeyError, match="third"):
        deck["third"] = 1
    with pytest.raises(ValueError, match="not contiguous"):
        deck["first"] = np.zeros((4, 4))[:, 0]
    assert deck["first"] == 5


HANDED_OUT = {
    "hook": lambda fleet, io: fleet.hook(0, 0, io),
    "after the sensor": lambda fleet, io: fleet.after_sensor(0, io),
    "after the supervisor": lambda fleet, io: fleet.after_supervisor(0, io),
    "pilot": lambda fleet, io: fleet.pilot("other", 0, io),
}


@pytest.mark.parametrize("way", HANDED_OUT)
def test_a_stage_s_deck_lives_as_long_as_a_step_may_reach_it(way):
    fleet, array = FLEETS["law"](), np.arange(3.0)
    gone = weakref.ref(array)
    HANDED_OUT[way](fleet, Deck(compiled.Io, work=array))
    step = fleet.stepper()
    del fleet, array
    gc.collect()
    assert gone() is not None
    del step
    assert gone() is None  # no circle


@pytest.mark.parametrize("kind", ["stage behind the filter", "policy"])
def test_a_fleet_with_stages_of_others_goes_without_the_collector(kind):
    fleet = FLEETS[kind]()
    gone, seen = weakref.ref(fleet), weakref.ref(fleet.deck)
    gc.disable()
    try:
        del fleet
        assert (gone(), seen()) == (None, None)
    finally:
        gc.enable()


def test_faults_that_read_the_machine_s_deck_outlive_fleet_and_faults():
    def faulty():
        fleet, faults = FLEETS["law"](), Faults(SIZE)
        faults.put("fault", EVERY, Fault(inject.SPIKES, 10.0, 5.0, -20.0, 20.0))
        faults.put("without", EVERY, Without(memory=1.0))
        faults.install(fleet)
        return fleet

    whole, gone = faulty(), faulty()
    expected, found = whole.start_recording(PERIODS), gone.start_recording(PERIODS)
    step = gone.stepper()
    del gone
    churn()
    for _ in range(PERIODS):
        step()
    whole.advance(PERIODS)
    assert np.ptp(found[9:16, machine.CHANNELS.index("command")], axis=0).min() > 30.0  # both spikes
    np.testing.assert_array_equal(found, expected)


def test_decisions_are_timed_on_a_machine_that_is_there():
    stack = stacks.resolve("height-following-ppo")
    signals, wishes = cost.lived(stack, "rough", 50), []
    for forget in (False, True):
        fleet = Fleet(1, stack.law, heads.POOL)
        stack.install(fleet, [0])
        given, wish, hand = signals.copy(), fleet.slots(machine.WISH, 1), fleet.row("hand.residual")
        run = cost._decide_kernel.bound(cost.deck_for(fleet, given, len(given)))
        if forget:
            del fleet, given
            churn()
        run()
        wishes.append((wish[0], hand[0]))
    assert wishes[0] == wishes[1]
    assert wishes[0][1] != 0.0


KEPT_BY_KERNELS = {
    "fleet": FLEETS["law"],
    "gantries": lambda: FLEETS["job"]().gantries,
    "deck": lambda: FLEETS["law"]().deck,
    "stepper": lambda: FLEETS["law"]().stepper(),
    "stepper of threads": lambda: FLEETS["law"](2, 40).stepper(),
    "batch": lambda: episode(TASK),
    "following": HeightFollowingEnv,
    "cutting": CuttingEnv,
    "panel": panel.Panel,
    "vector": lambda: HeightFollowingVectorEnv(2),
    "VecEnv": lambda: HeightFollowingVecEnv(2),
}


@pytest.mark.parametrize("kind", KEPT_BY_KERNELS)
@pytest.mark.parametrize("way", [copy.copy, copy.deepcopy, pickle.dumps])
def test_what_kernels_work_on_is_not_copied(kind, way):
    if kind == "stepper of threads" and way is copy.copy:
        return  # Python's own function with an argument: a second name for it
    thing = KEPT_BY_KERNELS[kind]()
    name = "Fleet" if kind == "stepper of threads" else type(thing).__name__
    with pytest.raises(TypeError, match=f"a {name} can't be copied or pickled, because kernels know the addresses"):
        way(thing)


@pytest.mark.parametrize("way", [copy.copy, copy.deepcopy, lambda stack: pickle.loads(pickle.dumps(stack))])
@pytest.mark.parametrize("spec", ["self-tuning", "height-following-ppo", "recipe", "cutting-ppo"])
def test_a_copy_of_a_stack_or_a_team_controls_as_the_original_does(spec, way):
    if stacks.resolve(spec).slot == "z":
        make, scenario, run = stacks.resolve, scenarios.load("wavy"), rollout.fleet_for
    else:
        make, scenario, run = stacks.team, scenarios.load("cut-square"), workshop.fleet_for
    original = run(scenario, make(spec), EVERY)
    copied = run(scenario, way(make(spec)), EVERY)
    churn()
    expected, found = (fleet.start_recording(10 * PERIODS) for fleet in (original, copied))
    original.advance(10 * PERIODS), copied.advance(10 * PERIODS)
    assert np.abs(np.diff(expected[:, machine.CHANNELS.index("command")], axis=0)).max() > 0.0
    np.testing.assert_array_equal(found, expected)


def test_addresses_are_taken_in_one_place():
    root = Path(kerfgym.__file__).parent
    taken = re.compile(
        r"\.ctypes\.data|__array_interface__|addressof\(|c_void_p\.from|\.data_ptr\(|byref\(|from_buffer\("
    )
    found = {
        f"{folder}/{file.relative_to(root / folder)}"
        for folder in ("envs", "baselines", "agents", "experiments")
        for file in (root / folder).rglob("*.py")
        if taken.search(file.read_text(encoding="utf-8"))
    }
    assert found == {"envs/engine/deck.py", "envs/engine/columns.py"}  # the second aligns an array
