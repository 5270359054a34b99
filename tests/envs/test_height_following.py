"""The Gymnasium environment: checkers, the bits of a roll-out, what it shows, and what bad input says."""

import inspect
import re
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from scipy.signal import lfilter
from stable_baselines3.common.env_checker import check_env as sb3_check_env

import kerfgym  # noqa: F401
from kerfgym.envs.control.stack import get, python_stack
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.height_following import HeightFollowingEnv
from kerfgym.envs.plant import supervisor
from kerfgym.envs.scenarios import SPLITS, load, suite
from kerfgym.envs.tasks import interface
from kerfgym.envs.tasks.interface import FEATURES, INFO, RAW, TASK
from kerfgym.envs.tasks.task import OBSERVATIONS
from kerfgym.experiments.measure.rollout import fleet_for, roll

ID = "kerfgym/HeightFollowing-v0"


def made(**arguments):
    return gym.make(ID, **arguments).unwrapped


def begun(seed, **arguments):
    """An environment at the start of one test episode."""
    env = made(split="test", **arguments)
    _, info = env.reset(options={"scenario_seed": seed})
    return env, info


# ----------------------------------------------------------------------------------------------------- checkers


@pytest.mark.parametrize("control", TASK.actions)
@pytest.mark.parametrize("observation", OBSERVATIONS[:2])  # the third depends on the base, see test_weights
def test_both_checkers_pass_without_a_warning(control, observation):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(made(control=control, observation=observation))
        sb3_check_env(made(control=control, observation=observation))


def test_both_checkers_pass_with_pictures():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(made(render_mode="rgb_array"))
        sb3_check_env(made(render_mode="rgb_array"))


def test_a_picture_shows_the_moment():
    env = made(render_mode="rgb_array")
    env.reset(seed=1)
    first = env.render()
    assert first.dtype == np.uint8
    assert first.ndim == 3
    assert first.shape[2] == 3
    for _ in range(50):
        env.step(env.action_space.sample())
    assert not np.array_equal(first, env.render())


def test_the_short_name_works_for_workers_that_have_not_imported_the_package():
    env = gym.make(f"kerfgym:{ID}")
    env.reset(seed=0)
    assert env.unwrapped.spec.id == ID


# -------------------------------------------------------------------------------------------------- bit identity

SIGNALS = ("true_gap", "measured_height")


@pytest.mark.parametrize(
    ("scenario", "base"),
    [
        *((name, "xi2023-improved") for name in suite("following")),
        ("wavy", "pid"),
        ("holes", "pid"),
        ("impulses", "observer"),
        ("holes", "observer"),
        ("wavy", "preview-5ms"),
        ("descent", "patent2022"),
        ("holes", "cn102528288a-gap"),
        ("holes", "plasma-style"),
        ("wavy", "oracle"),
        ("laps-wavy", "ilc"),
    ],
)
def test_residual_control_with_zero_actions_is_the_base_controllers_roll_out_bit_for_bit(scenario, base):
    env, info = begun(1005, scenario=scenario, base=base, max_steps=400)
    fleet = fleet_for(load(scenario), get(base), [1005])
    zero, over = np.zeros(1, np.float32), False
    while not over:
        signals = fleet.get("signals")
        assert (info["true_gap"], info["measured_height"]) == (signals.gap, signals.height)
        _, _, terminated, truncated, info = env.step(zero)
        over = terminated or truncated
        fleet.advance()
        assert env.batch.fleet.get("signals") == fleet.get("signals")
        assert env.batch.fleet.get("motion") == fleet.get("motion")
        assert env.batch.fleet.get("drive") == fleet.get("drive")
    assert fleet.tick == 400 or terminated


def test_the_recording_of_the_base_controller_shows_the_same_gap_height_and_command():
    env, _ = begun(1010, scenario="wavy")
    record = roll(load("wavy"), get("xi2023-improved"), [1010])
    lived = []
    for _ in range(3000):
        _, _, _, truncated, info = env.step([0.0])
        lived.append((info["true_gap"], info["measured_height"], env.batch.fleet.get("signals").command))
    assert truncated
    for column, channel in enumerate(("gap", "height", "command")):
        assert np.array_equal(np.array(lived, np.float32)[:, column], record[channel][:, 0]), channel


class Direct:
    """The P law of Xi2023 for a head that is commanded in 200 mm/s by single precision."""

    def reset(self):
        pass

    def control(self, signals):
        return 200.0 * float(np.float32(np.clip(-50.0 * (signals.height - signals.set_height) / 200.0, -1, 1)))


def test_direct_control_by_a_law_is_that_laws_roll_out_bit_for_bit():
    env = made(split="test", scenario="wavy", control="direct", max_steps=500)
    _, info = env.reset(options={"scenario_seed": 1001})
    record = roll(load("wavy").varied(duration=0.5), python_stack(Direct, "direct"), [1001])
    for period in range(500):
        _, _, _, _, info = env.step(np.array([np.clip(-50.0 * info["reported_error"] / 200.0, -1, 1)], np.float32))
        assert np.float32(info["true_gap"]) == record["gap"][period, 0]
        assert np.float32(info["measured_height"]) == record["height"][period, 0]


def test_a_schedule_that_asks_for_the_bases_own_settings_is_the_base_controller():
    env, _ = begun(1002, scenario="impulses", control="schedule", max_steps=500)
    # Window 5 of 1 to 15, trim 1 of 0 to 3, gain 1 of 0.2 to 3.
    action = np.array([(5 - 1) / 7 - 1, 1 / 1.5 - 1, (1 - 0.2) / 1.4 - 1], np.float32)
    record = roll(load("impulses").varied(duration=0.5), get("xi2023-improved"), [1002])
    for period in range(500):
        _, _, _, _, info = env.step(action)
        assert info["true_gap"] == pytest.approx(record["gap"][period, 0], abs=1e-6)
        assert info["measured_height"] == pytest.approx(record["height"][period, 0], abs=1e-6)
    settings = env.batch.fleet.get("filter")
    assert (settings.window, settings.trim) == (5.0, 1.0)


def test_a_schedule_reaches_the_ends_of_its_table():
    env, _ = begun(1002, control="schedule")
    for action, window, trim, gain in (
        ([-1, -1, -1], 1, 0, 0.2),
        ([1, 1, 1], 15, 3, 3.0),
        ([-1, 1, 0], 1, 0, 1.6),
        ([-5 / 7, 1, 0], 3, 1, 1.6),
    ):
        env.step(np.array(action, np.float32))
        settings, hand = env.batch.fleet.get("filter"), env.batch.fleet.get("hand")
        assert (settings.window, settings.trim) == (window, trim)
        assert hand.gain == pytest.approx(gain, rel=1e-6)
        assert hand.residual == 0.0


def test_an_action_of_one_means_what_the_table_says_and_none_means_more():
    for control, speed, gain in (("direct", 200.0, 1.0), ("residual", 50.0, 1.0)):
        env, _ = begun(1000, scenario="flat", control=control)
        for action, share in ((1.0, 1.0), (-0.5, -0.5), (7.0, 1.0), (-3.0, -1.0)):
            env.step(np.array([action], np.float32))
            assert env.batch.fleet.get("hand") == (gain, share * speed)


def test_an_environment_that_has_lived_gives_an_episode_the_bits_of_a_new_one():
    def episode(env):
        first, _ = env.reset(options={"scenario_seed": 1004})
        rng, out = np.random.default_rng(0), [first]
        for _ in range(300):
            out.append(env.step(rng.uniform(-0.2, 0.2, 3).astype(np.float32))[0])
        return np.array(out)

    used = made(scenario="holes", control="schedule", split="test")
    used.reset(seed=5)
    for _ in range(137):
        used.step(used.action_space.sample())
    new = made(scenario="holes", control="schedule", split="test")
    assert np.array_equal(episode(used), episode(new))


# --------------------------------------------------------------------------------------------- what it shows


def symlog(x):
    return np.sign(x) * np.log1p(np.abs(x) / 0.002) / 5


def history(env, rng, steps):
    """Signals and infos of every period from the start on, with the last observation."""
    past = [env.batch.fleet.get("signals")]
    for _ in range(steps):
        observation, reward, _, _, info = env.step(rng.uniform(-0.1, 0.1, env.action_space.shape).astype(np.float32))
        past.append(env.batch.fleet.get("signals"))
    return past, observation, reward, info


@pytest.mark.parametrize("steps", [1, 4, 40, 400])
def test_the_features_are_those_of_the_table(steps):
    env, _ = begun(1006, scenario="wavy", observation="features")
    past, observation, _, _ = history(env, np.random.default_rng(1), steps)

    def ago(k):  # before its first period the machine stood still
        return past[max(len(past) - 1 - k, 0)]

    def command(k):
        return ago(k).command if k < steps else 0.0

    x = past[-1]
    expected = [symlog(ago(k).height - x.set_height) for k in (0, 1, 2, 3, 5, 8)]
    lags = (0, 1, 2, 3, 5, 8, 13)
    read = [ago(k).head_position - ago(k).raw_height for k in range(16)]
    half = (0, 1, 1, 2, 2, 2, 2)  # an impulse is left out as soon as there are readings after it
    surface = [np.median(read[k - w : k + w + 1]) for k, w in zip(lags, half, strict=True)]
    expected += [symlog(a - b) for a, b in zip(surface[:-1], surface[1:], strict=True)]
    expected += [(ago(k).head_position - ago(k + 1).head_position) / 1e-3 / 100 for k in (0, 1, 2, 4)]
    expected += [command(k) / 100 for k in range(4)]
    expected += [-50.0 * (x.height - x.set_height) / 100, x.set_height, x.override, x.captured, 0.0]

    def mean(values, periods):  # a first-order lag from zero on
        return lfilter([1 / periods], [1, 1 / periods - 1], values)

    position, error = (
        np.array(v) for v in zip(*((p.head_position, p.height - p.set_height) for p in past), strict=True)
    )
    moved = position - np.concatenate([np.full(8, position[0]), position])[: len(position)]
    restless = np.abs(symlog(moved - mean(moved, 64)))
    expected += [symlog(mean(moved, 64)[-1]), mean(restless, 64)[-1], mean(restless, 256)[-1]]
    expected += [mean(np.abs(symlog(error)), periods)[-1] for periods in (64, 256)]
    expected += [symlog(mean(error, periods)[-1]) for periods in (64, 256)]
    assert observation.shape == (len(FEATURES),) == (len(expected),)
    assert observation == pytest.approx(np.array(expected, float), abs=2e-6)


@pytest.mark.parametrize("steps", [1, 4, 40])
def test_the_raw_signals_are_those_of_the_table(steps):
    env, _ = begun(1006, scenario="wavy", observation="raw")
    past, observation, _, _ = history(env, np.random.default_rng(1), steps)
    recent = [past[max(len(past) - 1 - k, 0)] for k in range(8)]
    x = past[-1]
    expected = [r.height for r in recent] + [r.raw_height for r in recent]
    expected += [r.head_position - past[0].head_position for r in recent]
    expected += [r.command if k < steps else 0.0 for k, r in enumerate(recent)]
    expected += [-50.0 * (x.height - x.set_height), x.set_height, x.feed, x.override, x.captured, x.mode]
    assert observation.shape == (len(RAW),) == (len(expected),)
    assert observation == pytest.approx(np.array(expected, float), rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("control", TASK.actions)
@pytest.mark.parametrize("observation", OBSERVATIONS[:2])  # the third depends on the base, see test_weights
def test_random_actions_keep_every_observation_within_its_space(control, observation):
    env = made(scenario="following", control=control, observation=observation)
    env.action_space.seed(3)
    visited = set()
    for episode in range(25):
        seen, _ = env.reset(seed=episode)
        visited.add(env.scenario.name)
        assert env.observation_space.contains(seen)
        for _ in range(80):
            seen, reward, terminated, truncated, info = env.step(env.action_space.sample())
            assert env.observation_space.contains(seen), (seen, env.observation_space)
            assert np.isfinite(reward)
            assert np.isfinite(list(info.values())).all()
            if terminated or truncated:
                break
    assert len(visited) >= 9


def test_the_reward_is_that_of_the_docstring():
    weights = {"error": 0.7, "rate": 0.2, "collision": 40.0}
    env, _ = begun(1006, scenario="wavy", reward=weights)
    rng = np.random.default_rng(2)
    before = env.batch.fleet.get("signals").command
    for _ in range(200):
        _, reward, terminated, _, info = env.step(rng.uniform(-0.3, 0.3, 1).astype(np.float32))
        x = env.batch.fleet.get("signals")
        error = np.log1p(abs(x.gap - x.set_height) / 0.002)
        rate = ((x.command - before) / 10.0) ** 2
        before = x.command
        assert info["reward_error"] == pytest.approx(error, rel=1e-8)
        assert info["reward_rate"] == pytest.approx(rate, rel=1e-8, abs=1e-12)
        assert info["weighted_error"] == pytest.approx(-0.7 * error, rel=1e-8)
        assert info["weighted_rate"] == pytest.approx(-0.2 * rate, rel=1e-8, abs=1e-12)
        assert reward == pytest.approx(-0.7 * error - 0.2 * rate, rel=1e-8)
        assert info["true_error"] == x.gap - x.set_height
        assert info["reported_error"] == x.height - x.set_height
        assert not terminated
    assert tuple(info) == INFO


def test_a_collision_ends_the_episode_and_costs_what_it_is_said_to():
    env, _ = begun(1000, scenario="flat", control="direct", reward={"collision": 33.0})
    for step in range(500):  # noqa: B007
        _, reward, terminated, truncated, info = env.step([-1.0])
        if terminated:
            break
        assert info["cost"] == 0.0
    assert 3 < step < 100
    assert not truncated
    assert (info["cost"], info["weighted_collision"]) == (1.0, -33.0)
    assert reward < -33.0
    with pytest.raises(InvalidInput, match=r"the episode is over; call reset\(\) before step\(\)"):
        env.step([0.0])


def test_periods_over_a_void_are_not_felt():
    env, _ = begun(1003, scenario="edge")
    inside = 0
    for _ in range(3000):
        _, _, terminated, truncated, info = env.step([0.0])
        if not info["scored"]:
            inside += 1
            assert info["reward_error"] == 0.0
        if terminated or truncated:
            break
    assert inside > 50


def test_an_episode_is_truncated_after_the_scenarios_duration():
    env, _ = begun(1000, scenario=load("flat").varied(duration=0.25))
    ends = [env.step([0.0])[2:4] for _ in range(250)]
    assert ends[:-1] == [(False, False)] * 249
    assert ends[-1] == (False, True)
    with pytest.raises(InvalidInput, match="the episode is over"):
        env.step([0.0])


def test_the_supervisor_holds_over_a_hole_and_says_so():
    env, _ = begun(1003, scenario="edge", observation="features")
    holding = []
    for _ in range(3000):
        seen, _, terminated, truncated, info = env.step([0.0])
        holding.append(seen[FEATURES.index("holding")] == 1.0)
        assert holding[-1] == (info["mode"] == supervisor.HOLD)
        if terminated or truncated:
            break
    assert any(holding)


# ------------------------------------------------------------------------------------------------------ seeds


def test_a_test_split_is_gone_through_in_order():
    env = made(split="test")
    env.reset(seed=197)
    seeds = [env.scenario_seed]
    for _ in range(4):
        env.reset()
        seeds.append(env.scenario_seed)
    assert seeds == [1197, 1198, 1199, 1000, 1001]


def test_training_draws_from_its_own_split_and_repeats_with_the_seed():
    def drawn(env, seed):
        env.reset(seed=seed)
        seeds = [env.scenario_seed]
        for _ in range(20):
            env.reset()
            seeds.append(env.scenario_seed)
        return seeds

    env = made()
    first, second = drawn(env, 3), drawn(env, 4)
    assert first == drawn(made(), 3)
    assert len(set(first + second)) == 42
    assert all(seed in SPLITS["train"] for seed in first + second)


def test_a_suite_or_a_list_of_scenarios_is_drawn_from_evenly():
    env = made(scenario=["flat", load("wavy"), "step"])
    names = []
    for seed in range(150):
        env.reset(seed=seed)
        names.append(env.scenario.name)
    assert {name: names.count(name) for name in set(names)}.keys() == {"flat", "wavy", "step"}
    assert min(names.count(name) for name in set(names)) > 30
    assert len(made(scenario="following").batch.scenarios) == len(suite("following"))


def test_the_machine_may_be_changed_from_outside():
    env = made(
        machine={"axis": {"dead_time": 0.003, "latency": 0.0}, "head": {"noise": 0.0}}, scenario=["flat", "wavy"]
    )
    env.reset(seed=0)
    assert env.batch.fleet.get("z").dead_time == pytest.approx(3.0)
    assert env.batch.fleet.get("sensor").noise == 0.0


# ---------------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scenario": "wavvy"}, r"unknown scenario 'wavvy'; did you mean 'wavy'\?"),
        ({"scenario": []}, "scenario is an empty list; at least one is needed"),
        ({"scenario": ["wavy", "cut-square"]}, r"scenario 'cut-square' is a job; .*Cutting-v0 do jobs"),
        ({"control": "residul"}, r"unknown control 'residul'; did you mean 'residual'\? \(known: direct, "),
        ({"observation": "feature"}, r"unknown observation 'feature'; did you mean 'features'\?"),
        ({"split": "trian"}, r"unknown split 'trian'; did you mean 'train'\?"),
        ({"render_mode": "rgb"}, r"unknown render_mode 'rgb'; did you mean 'rgb_array'\?"),
        ({"base": "pidd"}, r"unknown controller 'pidd'; did you mean 'pid'\?"),
        ({"base": "pid:law.kp=1e9"}, r"law\.kp = 1000000000\.0 is out of range; allowed: 1 to 400 1/s"),
        ({"base": python_stack(Direct, "mine")}, "'mine' is plain Python; a base must be a compiled law"),
        ({"reward": {"eror": 1.0}}, r"unknown reward term 'eror'; did you mean 'error'\?"),
        ({"reward": {"error": -1.0}}, r"reward\.error = -1\.0 is out of range; allowed: 0 and up"),
        ({"reward": {"rate": np.nan}}, r"reward\.rate = nan is out of range; allowed: 0 and up"),
        ({"machine": {"axis": {"dead_tme": 0.001}}}, r"unknown key 'axis\.dead_tme'; did you mean 'dead_time'\?"),
        ({"machine": {"axis": {"dead_time": 1.0}}}, r"dead_time = 1\.0 is out of range; allowed: 0 to 0\.02 s"),
        ({"max_steps": 0}, r"max_steps = 0 is out of range; at least 1"),
        ({"max_steps": -5}, r"max_steps = -5 is out of range; at least 1"),
    ],
)
def test_a_bad_argument_is_named(arguments, message):
    with pytest.raises(InvalidInput, match=message):
        HeightFollowingEnv(**arguments)


def test_a_misspelt_argument_is_an_error():
    with pytest.raises(TypeError, match="scenaro"):
        gym.make(ID, scenaro="wavy")


@pytest.mark.parametrize(
    ("control", "action", "message"),
    [
        ("residual", [np.nan], r"the action \[nan\] is not finite; allowed: -1 to 1"),
        ("residual", np.array([np.inf], np.float32), r"the action \[inf\] is not finite; allowed: -1 to 1"),
        ("schedule", np.array([0.0, -np.inf, 0.0]), r"is not finite; allowed: -1 to 1"),
        ("residual", [0.0, 0.0], r"the action has shape \(2,\); it must be \(1,\)"),
        ("residual", 0.0, r"the action has shape \(\); it must be \(1,\)"),
        ("residual", np.zeros((1, 1)), r"the action has shape \(1, 1\); it must be \(1,\)"),
        ("schedule", np.zeros(1), r"the action has shape \(1,\); it must be \(3,\)"),
    ],
)
def test_a_bad_action_is_refused_and_moves_nothing(control, action, message):
    env, _ = begun(1000, control=control)
    before = env.batch.fleet.tick
    with pytest.raises(InvalidInput, match=message):
        env.step(action)
    assert env.batch.fleet.tick == before


def test_a_step_needs_a_reset_first():
    with pytest.raises(InvalidInput, match=r"call reset\(\) before step\(\)"):
        HeightFollowingEnv().step([0.0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scenario_sed": 1000}, r"unknown option 'scenario_sed'; did you mean 'scenario_seed'\?"),
        ({"scenario_seed": 1200}, r"scenario_seed = 1200 is not in split 'test': 1000 to 1199"),
        ({"scenario_seed": 3}, r"scenario_seed = 3 is not in split 'test': 1000 to 1199"),
    ],
)
def test_a_bad_option_is_named(options, message):
    with pytest.raises(InvalidInput, match=message):
        made(split="test").reset(options=options)


# -------------------------------------------------------------------------------------------------------- manual


def test_the_docstring_tells_the_numbers_of_the_code():
    text = inspect.getdoc(HeightFollowingEnv)
    sections = re.findall(r"^## (.+)$", text, re.MULTILINE)
    assert sections == [
        "Description",
        "Action Space",
        "Observation Space",
        "Rewards",
        "Starting State",
        "Episode End",
        "Arguments",
        "Vectorised environment",
        "Version History",
    ]
    assert f"Box(-10, 10, ({len(FEATURES)},), float32)" in text
    assert f"Box(low, high, ({len(RAW)},), float32)" in text
    documented = set(re.findall(r"^\| `(\w+)` +\|", text.split("## Arguments")[1], re.MULTILINE))
    assert documented == set(inspect.signature(HeightFollowingEnv.__init__).parameters) - {"self"}
    weights = interface.Reward()
    assert (
        f'reward={{"error": {weights.error:g}, "rate": {weights.rate:g}, "collision": {weights.collision:g}, '
        f'"tolerance": {weights.tolerance:g}}}' in text
    )
