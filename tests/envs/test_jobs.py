"""Jobs: what is planned, what the machines make of it, and the environments around them."""

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from gymnasium.utils.env_checker import check_env
from scipy.spatial import cKDTree
from stable_baselines3.common.env_checker import check_env as check_for_sb3

import kerfgym  # noqa: F401
from kerfgym.agents.vec_env import CuttingVecEnv
from kerfgym.envs import scenarios
from kerfgym.envs.control.stack import python_stack, team
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.figures import job_metrics, quality
from kerfgym.envs.paths import job as jobs
from kerfgym.envs.paths import kerf, parts
from kerfgym.envs.plant import gantry
from kerfgym.envs.tasks import workshop
from kerfgym.experiments.results import jobs as job_runs

CONTOUR, CUTTING = "kerfgym/ContourFollowing-v0", "kerfgym/Cutting-v0"
SMALL = scenarios.Scenario(
    name="small", job=scenarios.Job(part="square", size=8.0, material="mild-steel", thickness=3.0, lead_in=1.0),
    sheet=scenarios.Sheet(waves=(scenarios.Wave(amplitude=0.1, wavelength=60.0),)),
)  # fmt: skip
FAST = scenarios.Scenario(name="fast", job=scenarios.Job(part="circle", size=6.0, lead_in=0.0, pierce=False))


# ------------------------------------------------------------------------------------------------------- the job


@pytest.mark.parametrize("name", parts.PARTS)
def test_a_job_cuts_the_part_and_keeps_its_limits(name):
    drawing = parts.part(name)
    settings = jobs.Settings(feed=50.0, lead_in=0.0)
    job = jobs.plan(drawing, settings)
    points = np.stack([job.x, job.y], axis=1)
    velocity, acceleration = np.diff(points, axis=0) * 1e3, np.diff(points, 2, axis=0) * 1e6
    cutting = job.phase[1:] == jobs.CUT
    assert job.cut_length == pytest.approx(drawing.cut_length, rel=2e-3)
    assert np.hypot(*velocity[cutting].T).max() <= 50.0 * (1 + 2e-5)
    assert np.hypot(*velocity.T).max() <= settings.rapid * (1 + 1e-6)
    assert np.percentile(np.hypot(*acceleration.T), 99.9) <= 1.05 * settings.acceleration
    assert np.allclose(np.hypot(job.tx, job.ty), 1.0, atol=1e-9)
    assert (np.diff(job.s) >= 0).all()
    assert (job.most >= 1.0).all()
    assert job.beam[job.phase == jobs.RAPID].max() == 0.0
    for i, (first, last) in enumerate(job.contours):
        cut = points[first : last + 1]
        piece = drawing.pieces[i]
        way = np.append(0.0, np.cumsum(np.hypot(*np.diff(piece, axis=0).T)))
        fine = np.arange(0.0, way[-1], 0.01)
        tree = cKDTree(np.stack([np.interp(fine, way, piece[:, k]) for k in (0, 1)], axis=1))
        assert tree.query(cut)[0].max() < 0.02


def test_the_phases_of_a_contour_come_in_order_and_pierce_as_the_material_says():
    job = workshop.programme(SMALL, team("wu"))
    changes = np.append(0, np.flatnonzero(np.diff(job.phase)) + 1)
    order = [jobs.PHASES[int(p)] for p in job.phase[changes]]
    assert order == ["rapid", "approach", "pierce", "approach", "pierce", "approach", "lead-in", "cut", "lift", "rapid"]
    steel = workshop.material_of(SMALL)
    pierced = (job.phase == jobs.PIERCE).sum() * 1e-3
    assert pierced == pytest.approx(sum(seconds for _, seconds in steel.pierce), abs=0.005)
    heights = {round(h, 6) for h in (steel.standoff + job.lift[job.phase == jobs.PIERCE]).tolist()}
    assert heights == {height for height, _ in steel.pierce}
    assert job.lift[job.phase == jobs.CUT].max() == 0.0


def test_without_corner_handling_the_feed_is_constant_and_the_job_shorter():
    slow, fast = (workshop.programme(SMALL, team(name)) for name in ("wu", "wu-no-corners"))
    cutting = (fast.phase == jobs.CUT) & (fast.feed > 0.0)  # at its end the programme stands still
    assert np.mean(np.abs(fast.feed[cutting] - fast.cut_feed) < 1e-6) > 0.97  # a chord cuts each corner
    assert fast.duration < slow.duration


def test_kerf_compensation_is_the_offset_that_closed_forms_say():
    from shapely import Polygon

    square, r = parts.part("square", side=20.0), 0.25
    grown = Polygon(kerf.compensated(square, 2 * r).pieces[0])
    assert grown.area == pytest.approx(20.0**2 + 4 * 20.0 * r + np.pi * r * r, rel=1e-5)
    plate = parts.part("slot-plate")
    moved = kerf.compensated(plate, 0.4)
    areas = [Polygon(p).area for p in plate.pieces], [Polygon(p).area for p in moved.pieces]
    holes = [area < max(areas[0]) for area in areas[0]]
    assert all((b < a) == hole for a, b, hole in zip(*areas, holes, strict=True))


# --------------------------------------------------------------------------------------------------- the machines


def test_the_contour_error_is_the_distance_to_the_path():
    scenario = scenarios.load("contour-corners")
    _, job, channels = job_runs.roll(scenario, team("wu"), [1000], record=True)
    index = {name: i for i, name in enumerate(gantry.CHANNELS)}
    x, y, error, phase = (channels[:, index[name], 0].astype(float) for name in ("x", "y", "error", "phase"))
    cutting = (phase == jobs.CUT) | (phase == jobs.LEAD_IN)
    cut = (job.phase == jobs.CUT) | (job.phase == jobs.LEAD_IN)
    fine = np.linspace(0, len(job.x) - 1, 12 * len(job.x))
    path = np.stack([np.interp(fine, np.arange(len(job.x)), v) for v in (job.x, job.y)], axis=1)
    path = path[np.interp(fine, np.arange(len(job.x)), cut.astype(float)) > 0.5]
    nearest = cKDTree(path).query(np.stack([x, y], axis=1)[cutting])[0]
    difference = np.abs(error[cutting]) - nearest
    # The nearest point of all may lie on another leg; the machine's never lies nearer.
    assert difference.min() > -4e-3
    assert np.quantile(np.abs(difference), 0.9) < 3e-3


def test_metrics_are_what_a_recording_says():
    scenario = scenarios.load("contour-circle")
    fleet, job, channels = job_runs.roll(scenario, team("wu"), [1000, 1001], record=True)
    figures = job_metrics.evaluate(job_metrics.Jobs.of(fleet, job))
    index = {name: i for i, name in enumerate(gantry.CHANNELS)}
    for i in range(2):
        c = {name: channels[:, k, i].astype(float) for name, k in index.items()}
        w = c["speed"] * ((c["phase"] == jobs.CUT) | (c["phase"] == jobs.LEAD_IN))
        assert figures["contour_rms"][i] == pytest.approx(
            1e3 * np.sqrt((w * c["error"] ** 2).sum() / w.sum()), rel=1e-5
        )
        assert figures["roughness"][i] == pytest.approx(1e3 * (w * c["roughness"]).sum() / w.sum(), rel=1e-5)
        assert figures["dross"][i] == pytest.approx((w * c["dross"]).sum() / w.sum(), rel=1e-5)
        assert figures["gap_rms"][i] == pytest.approx(
            1e3 * np.sqrt((w * c["gap_error"] ** 2).sum() / w.sum()), rel=1e-4
        )
    assert figures["covered"].tolist() == [1.0, 1.0]


def test_table_2_holds_in_the_machine_too():
    scenario = scenarios.load("cut-square").varied(job={"size": 15.0})
    for method, rough, dross in (
        ("huang2024-static-quality", 50, 1.0),
        ("huang2024-static-fast", 170, 1.0),
        ("huang2024-dynamic", 90, 0.9),
    ):
        fleet, job, _ = job_runs.roll(scenario, team(method), [1000])
        figures = job_metrics.evaluate(job_metrics.Jobs.of(fleet, job))
        assert figures["roughness"][0] == pytest.approx(rough, rel=0.10)
        assert figures["dross"][0] == pytest.approx(dross, rel=0.10)
        assert figures["through"][0] > 0.99


@pytest.mark.parametrize("method", ["huang2024-static-fast", "huang2024-dynamic"])
def test_the_full_form_on_the_simulated_trajectory_agrees_with_what_the_machine_adds_up(method):
    scenario = scenarios.load("cut-bulge").varied(job={"size": 10.0, "lead_in": 0.0})
    fleet, job, channels = job_runs.roll(scenario, team(f"xy=wu,process={method}"), [1000], record=True)
    figures = job_metrics.evaluate(job_metrics.Jobs.of(fleet, job))
    steel, optics = workshop.material_of(scenario), fleet.gantries.get("optics")
    found = quality.evaluate(quality.travelled(channels[:, :, 0], optics, steel.power), steel.params)
    inner = slice(60, -60)  # cells of 25 µm; the ends are standstills
    assert 1e3 * found.roughness[inner].mean() == pytest.approx(figures["roughness"][0], rel=0.05)
    assert found.dross[inner].mean() == pytest.approx(figures["dross"][0], rel=0.05)
    assert found.kerf_top[inner].mean() == pytest.approx(figures["kerf"][0], rel=0.06)
    assert found.through[inner].mean() == pytest.approx(figures["through"][0], abs=0.02)


def test_the_sheet_is_read_where_the_axes_are():
    tilted = FAST.varied(sheet={"tilt": 0.05, "tilt_y": -0.02}, head={"noise": 0.0, "impulses": 0.0})
    fleet, _, channels = job_runs.roll(tilted, team("wu-no-corners"), [1000], record=True)
    fleet = workshop.fleet_for(tilted, team("wu-no-corners"), [1000])
    z = fleet.start_recording(2000)
    g = fleet.gantries.start_recording(2000, fleet.tick)
    fleet.advance(2000)
    x, y = (g[:, gantry.CHANNELS.index(name), 0].astype(float) for name in "xy")
    surface = z[:, 3, 0].astype(float)
    assert np.allclose(surface, 0.05 * x - 0.02 * y, atol=2e-5)
    assert np.ptp(surface) > 0.2
    assert channels is not None


def test_a_recording_that_begins_later_holds_what_a_whole_one_holds_from_there_on():
    kept = {}
    for first in (0, 300):
        fleet = workshop.fleet_for(FAST, team("wu-no-corners"), [1000])
        fleet.advance(first)
        cut = fleet.gantries.start_recording(500 - first, fleet.tick)
        head = fleet.start_recording(500 - first)
        fleet.advance(600 - first)  # beyond its end
        kept[first] = cut, head
    for whole, late in zip(kept[0], kept[300], strict=True):
        assert np.ptp(late[:, 0]) > 0
        assert np.array_equal(whole[300:], late)


class Proportional:
    """The law of Xi2023 in plain Python."""

    def reset(self):
        pass

    def control(self, signals):
        return -50.0 * (signals.height - signals.set_height)


def test_a_plain_python_law_does_a_job_with_the_bits_of_the_compiled_one():
    python = team(python_stack(Proportional, "mine"))
    rows = [job_runs.measured(FAST, who, (1000, 1003))[0] for who in (python, team("xi2023-improved:law.kv=50"))]
    pd.testing.assert_frame_equal(*rows)
    assert not rows[0]["failed"].any()


# ------------------------------------------------------------------------------------------------ environments


@pytest.mark.parametrize("id_", [CONTOUR, CUTTING])
@pytest.mark.parametrize("observation", ["features", "raw"])
@pytest.mark.filterwarnings("ignore:.*infinity.*", "ignore:.*Box observation space.*")
def test_the_checkers_have_nothing_to_say(id_, observation):
    env = gym.make(id_, observation=observation, scenario=SMALL, render_mode="rgb_array")
    check_env(env.unwrapped, skip_render_check=True)
    check_for_sb3(env.unwrapped)
    env.reset(seed=0)
    frame = env.render()
    assert frame.dtype == np.uint8
    assert frame.ndim == 3


@pytest.mark.parametrize("id_", [CONTOUR, CUTTING])
@pytest.mark.parametrize("control", ["residual", "direct"])
def test_whatever_the_policy_does_nothing_is_nan_and_limits_hold(id_, control):
    if id_ == CONTOUR and control == "direct":
        pytest.skip("ContourFollowing has residual control only")
    env = gym.make(id_, scenario=SMALL, control=control).unwrapped
    env.reset(seed=3)
    random = np.random.default_rng(0)
    for _ in range(400):
        action = random.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        observation, reward, over, late, info = env.step(action)
        assert env.observation_space.contains(observation)
        assert np.isfinite([reward, *[v for v in info.values() if not isinstance(v, np.ndarray)]]).all()
        g = env.batch.fleet.gantries
        for axis in "xy":
            a = g.get(axis)
            assert abs(a.part_1 + a.part_2) <= 166.67
        if over or late:
            break


@pytest.mark.parametrize("id_", [CONTOUR, CUTTING])
def test_a_job_ends_when_it_is_done_and_objectives_are_told(id_):
    env = gym.make(id_, scenario=SMALL).unwrapped
    env.reset(seed=1)
    total, steps, over = 0.0, 0, False
    while not over:
        *_, reward, over, late, info = env.step(np.zeros(env.action_space.shape, np.float32))
        total, steps = total + reward, steps + 1
        assert not late
        weighted = [v for k, v in info.items() if k.startswith("weighted_")]
        assert reward == pytest.approx(sum(weighted))
    assert info["done"] == 1.0
    assert info["cost"] == 0.0
    # At the end of the rapid and of the cut the programme waits for the axes.
    assert -40 <= steps * 8 - len(env.batch.jobs[0].x) <= 260
    assert info["objectives"].tolist() == [info[name] for name in env.batch.task.objectives]
    with pytest.raises(InvalidInput, match=r"the episode is over; call reset\(\)"):
        env.step(np.zeros(env.action_space.shape, np.float32))


@pytest.mark.parametrize("name", ["contour-corners", "contour-gear"])
@pytest.mark.parametrize("changes", [{"preset": "modern"}, {"slower": 0.7}], ids=str)
def test_axes_that_come_to_rest_within_a_micrometre_of_the_end_switch_the_beam_off(name, changes):
    """Encoder and D/A converter let them stop short of it, nearer to another sample of the way there."""
    scenario = scenarios.load(name).varied(gantry=changes)
    fleet = workshop.fleet_for(scenario, team("xy=wu-tuned"), [0, 1])
    job = workshop.programme(scenario, team("xy=wu-tuned"))
    fleet.advance(len(job.x) + 800)
    x, y, time = (fleet.gantries.column(name) for name in ("x.position", "y.position", "sums.time"))
    short = np.hypot(x - job.x[-1], y - job.y[-1])
    assert np.all((short > 1e-4) & (short < 1e-3))
    assert np.all(time < job.duration + 0.7)  # what it waits for axes, at six standstills
    assert np.all(fleet.gantries.column("progress.near") == len(job.x) - 1)


@pytest.mark.parametrize("xy", ["wu", "wu-tuned", "wu-stiff"])
def test_every_cut_is_cut_to_its_end_and_the_set_height_never_jumps(xy):
    """However far the axes lag, and whatever corner there is between the end of a cut and the rapid after it."""
    scenario = scenarios.load("contour-slots")
    control = team(f"xy={xy}")
    fleet, job = workshop.fleet_for(scenario, control, [0, 1, 2]), workshop.programme(scenario, control)
    ends, settings = [last for _, last in job.contours], job.settings
    nearest, heights = np.full((len(ends), fleet.size), np.inf), []
    while (fleet.gantries.column("progress.near") < len(job.x) - 1.5).any():
        fleet.advance(1)
        x, y, near = (fleet.gantries.column(name) for name in ("x.position", "y.position", "progress.near"))
        beam = job.beam[near.astype(int)]
        for i, end in enumerate(ends):
            off = np.where(beam > 0.5, np.hypot(x - job.x[end], y - job.y[end]), np.inf)
            nearest[i] = np.minimum(nearest[i], off)
        heights.append(fleet.column("job.set_height"))
    assert nearest.max() <= 0.01
    steps = np.abs(np.diff(heights, axis=0)) * 1e3
    # The nearest point hurries on where axes round a corner or come to rest; a millimetre at once would be 1000 mm/s.
    assert steps.max() <= 2.0 * settings.lift_speed


def test_corrections_do_not_keep_a_programme_waiting():
    """They move the place that the axes are waited for; at standstills they fade."""
    env = gym.make(CONTOUR, scenario=SMALL).unwrapped
    env.reset(seed=1)
    steps, over = 0, False
    while not over:
        side = 1.0 if steps % 2 else -1.0
        *_, over, _, _ = env.step(np.array([0.0, side, side], np.float32))
        steps += 1
    assert steps * 8 - len(env.batch.jobs[0].x) <= 260


def test_a_programme_does_not_wait_for_axes_that_never_arrive():
    fleet, job = workshop.fleet_for(SMALL, team("wu"), [0]), workshop.programme(SMALL, team("wu"))
    for axis in ("x", "y"):
        fleet.gantries.set(f"xy.{axis}_plus", [0], 1e-9)
        fleet.gantries.set(f"xy.{axis}_minus", [0], 1e-9)
    end = int(job.contours[0][1])
    fleet.advance(end + 100)
    assert end - 20 <= fleet.gantries.column("progress.tau")[0] <= end
    fleet.advance(int(gantry.Journey().patience))
    assert fleet.gantries.column("progress.tau")[0] > end


def test_a_lower_feed_takes_longer_and_a_dither_is_smoother():
    def cut(action):
        env = gym.make(CUTTING, scenario="cut-square", machine={"job": {"size": 10.0}}, max_steps=2000).unwrapped
        env.reset(seed=1, options={"scenario_seed": 10000})
        rough, length, over, late, info = 0.0, 0.0, False, False, {}
        while not (over or late):
            *_, over, late, info = env.step(np.array(action, np.float32))
            rough += (info["length"] - length) * info["step_roughness"]
            length = info["length"]
        return info["time"], rough / length

    nothing, slower = cut([0.0] * 8), cut([-0.8] + [0.0] * 7)
    dithered = cut([0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    assert slower[0] > 1.2 * nothing[0]
    assert slower[1] < nothing[1]
    assert dithered[1] < nothing[1]


def actions(steps, num_envs, width):
    """The first environments get the same actions however many there are."""
    return np.random.default_rng(0).uniform(-1, 1, (64, steps, width)).astype(np.float32)[:num_envs].swapaxes(0, 1)


@pytest.mark.parametrize(("id_", "width"), [(CONTOUR, 3), (CUTTING, 8)])
def test_single_vector_and_threads_live_through_the_same_bits(id_, width):
    def life(num_envs, threads, mode):
        env = gym.make_vec(
            id_, num_envs=num_envs, scenario=SMALL, num_threads=threads, max_steps=30, autoreset_mode=mode
        )
        seen = [env.reset(seed=11)[0]]
        for step, action in enumerate(0.3 * actions(45, num_envs, width)):
            observations, rewards, *_, late, info = env.step(action)
            if mode == "NextStep" and step == 30:
                continue  # only resets
            if mode == "SameStep" and late.all():
                seen += [np.stack(info["final_obs"]), observations]
            else:
                seen.append(observations)
            del rewards
        return np.stack(seen, axis=1)[:, :44]

    whole = life(64, 1, "SameStep")[:, :31]
    for num_envs, threads, mode in ((1, 1, "SameStep"), (2, 2, "NextStep"), (31, 1, "SameStep"), (64, 2, "SameStep")):
        assert np.array_equal(life(num_envs, threads, mode)[:, :31], whole[:num_envs]), (num_envs, threads, mode)
    single = gym.make(id_, scenario=SMALL, max_steps=30)
    seen = [single.reset(seed=11)[0]]
    for action in 0.3 * actions(30, 1, width)[:, 0]:
        seen.append(single.step(action)[0])
    assert np.array_equal(np.array(seen), whole[0])


def test_stable_baselines_sees_the_same():
    env, ours = (
        CuttingVecEnv(3, scenario=SMALL, max_steps=20),
        gym.make_vec(CUTTING, num_envs=3, scenario=SMALL, max_steps=20, autoreset_mode="SameStep"),
    )
    env.seed(5)
    assert np.array_equal(env.reset(), ours.reset(seed=5)[0])
    for action in 0.3 * actions(50, 3, 8):
        a, b = env.step(action), ours.step(action)
        assert np.array_equal(a[0], b[0])
        assert np.array_equal(a[2], b[2] | b[3])


def test_resetting_some_leaves_the_others_as_they_were():
    alone, other = (gym.make_vec(CUTTING, num_envs=40, scenario=SMALL) for _ in range(2))
    alone.reset(seed=5), other.reset(seed=5)
    mask = np.zeros(40, bool)
    mask[[3, 31, 32]] = True
    for step, action in enumerate(0.3 * actions(30, 40, 8)):
        if step == 15:
            other.reset(options={"reset_mask": mask})
        a, b = alone.step(action), other.step(action)
        assert np.array_equal(a[0][~mask], b[0][~mask])


def test_the_roll_out_of_a_team_is_what_the_environment_does_without_an_action():
    env = gym.make(CUTTING, scenario=SMALL, split="test").unwrapped
    env.reset(options={"scenario_seed": 1003})
    fleet = workshop.fleet_for(SMALL, team("recipe"), [1003])
    for _ in range(60):
        *_, info = env.step(np.zeros(8, np.float32))
        fleet.advance(8)
        assert fleet.get("signals").gap == info["true_gap"]
        assert fleet.gantries.get("figures").roughness == info["roughness"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scenario": "wavy"}, r"scenario 'wavy' has no job"),
        ({"control": "schedule"}, r"unknown control 'schedule'"),
        ({"colour": "dros"}, r"unknown colour 'dros'; did you mean 'dross'"),
        ({"reward": {"tiem": 1}}, r"unknown reward term 'tiem'; did you mean 'time'"),
        ({"base": "recipee"}, r"unknown controller 'recipee'; did you mean 'recipe'"),
        ({"base": "xy=pid"}, r"controller 'pid' drives slot 'z', not 'xy'"),
        ({"base": "xy=wu,xy=wu-tuned"}, r"slot 'xy' is given twice"),
        ({"path": "none.dxf"}, r"none\.dxf: no such file"),
        ({"machine": {"job": {"part": "sqare"}}}, r"unknown part 'sqare'; did you mean 'square'"),
        ({"machine": {"job": {"size": 2000.0}}}, r"size"),
        ({"machine": {"job": {"feed": 1999.0}}}, r"feed = 1999 mm/s is out of range; above 0, at most 166\.667 mm/s"),
        ({"machine": {"job": {"material": "steel"}}}, r"unknown material 'steel'"),
        ({"machine": {"gantry": {"preset": "wuu"}}}, r"preset"),
        ({"max_steps": 0}, r"max_steps = 0 is out of range"),
    ],
)
def test_bad_input_is_named(arguments, message):
    with pytest.raises(InvalidInput, match=message):
        gym.make(CUTTING, **arguments)


def test_a_dither_beyond_the_scenarios_optics_is_refused():
    with pytest.raises(InvalidInput, match=r"'huang2024-dynamic': dither\.x = 0\.3 mm is out of the optics' range"):
        gym.make(CUTTING, base="huang2024-dynamic", machine={"optics": {"galvo_range": 0.1}})
    with pytest.raises(InvalidInput, match=r"law\.power = 0\.0 is out of range"):
        gym.make(CUTTING, base="recipe:law.power=0")


def test_a_part_beyond_the_travel_is_refused():
    with pytest.raises(InvalidInput, match=r"1200\.0 × 1200\.0 mm; allowed: the travel of 1500 × 1000 mm"):
        gym.make(CUTTING, machine={"job": {"size": 1200.0}})
