"""What the action of an environment with a job does to path and process, and what it is charged for."""

import gymnasium as gym
import numpy as np
import pytest

import kerfgym  # noqa: F401
from kerfgym.envs import scenarios
from kerfgym.envs.control.stack import team
from kerfgym.envs.plant import gantry, spot, xy_axes
from kerfgym.envs.plant.controller import Process
from kerfgym.envs.tasks import job_interface, workshop
from kerfgym.envs.tasks.job_interface import FEATURES

CONTOUR, CUTTING = "kerfgym/ContourFollowing-v0", "kerfgym/Cutting-v0"
FLAT = {"noise": 0.0, "impulses": 0.0}


def scene(part, size, **job):
    return scenarios.Scenario(
        name=part, job=scenarios.Job(part=part, size=size, material="mild-steel", thickness=3.0, **job)
    ).varied(head=FLAT)


def lived(id_, action, steps=2000, **arguments):
    """Every ``info`` of an episode with one action throughout, and the environment."""
    env = gym.make(id_, **arguments).unwrapped
    env.reset(seed=0)
    seen, over = [], False
    while not over and len(seen) < steps:
        *_, over, late, info = env.step(np.array(action, np.float32))
        seen.append(info)
        over |= late
    return seen, env


@pytest.mark.parametrize("base", ["recipe", "huang2024-dynamic"])
def test_direct_control_is_the_command_whatever_the_base_does(base):
    action = [-0.5, 0.5, 0.25, -0.5, 0.0, -0.6, 0.2, -0.3]
    _, env = lived(CUTTING, action, steps=3, scenario=scene("square", 8.0), control="direct", base=base)
    optics = spot.Params()
    assert env.batch.fleet.gantries.get("applied") == pytest.approx(
        Process(
            override=0.25 * 2.0,
            power=0.75 * 1.2,
            frequency=0.625 * optics.highest,
            x=0.25 * optics.galvo_range,
            y=0.5 * optics.galvo_range,
            z=0.2 * optics.piezo_range,
            focus=0.2 * optics.piezo_range,
            standoff=-0.3,
        ),
        rel=1e-6,
    )


def test_residual_control_adds_to_the_command_of_the_base_within_its_limits():
    _, env = lived(CUTTING, [0.5] * 8, steps=3, scenario=scene("square", 8.0), base="huang2024-dynamic")
    assert env.batch.fleet.gantries.get("applied") == pytest.approx(
        Process(override=1.25, power=1.1, frequency=3000.0, x=0.3, y=0.3, z=1.5, focus=0.5, standoff=0.15), rel=1e-6
    )


def test_the_override_is_about_cuts_and_leaves_piercing_and_rapids_alone():
    def times(override):
        seen, _ = lived(CUTTING, [override] + [0.0] * 7, scenario=scene("square", 20.0))
        phase = np.array([info["phase"] for info in seen])
        return {p: int((phase == p).sum()) for p in range(6)}

    plain, faster = times(0.0), times(1.0)
    for p in (gantry.RAPID, gantry.APPROACH, gantry.PIERCE, gantry.LIFT):
        assert faster[p] == pytest.approx(plain[p], abs=1)
    assert faster[gantry.CUT] < 0.75 * plain[gantry.CUT]


def test_a_correction_to_the_left_moves_a_straight_to_the_left_by_as_much():
    seen, _ = lived(CONTOUR, [0.0, 0.4, 0.0], scenario=scene("square", 60.0), base="wu-tuned")
    cut = np.array([info["contour_error"] for info in seen if info["phase"] == gantry.CUT])
    assert np.median(cut) == pytest.approx(0.4 * job_interface.CORRECTION, abs=2e-3)


def test_corrections_fade_once_the_cut_is_over_so_that_the_job_ends():
    seen, env = lived(CONTOUR, [0.0, 1.0, -1.0], scenario=scene("square", 20.0))
    assert seen[-1]["done"] == 1.0
    progress = env.batch.fleet.gantries.get("progress")
    assert abs(progress.dx) + abs(progress.dy) < 1e-3


def test_a_circle_is_seen_as_its_centripetal_acceleration():
    radius, feed = 20.0, 50.0
    env = gym.make(
        CONTOUR, scenario=scene("circle", 2 * radius, feed=feed), observation="raw", base="wu-tuned"
    ).unwrapped
    seen, _ = env.reset(seed=0)
    names, rows, over = FEATURES["contour"], [], False
    while not over:
        seen, _, over, late, _ = env.step(np.zeros(3, np.float32))
        rows.append(seen)
        assert not late
    rows = np.array(rows)
    middle = rows[(rows[:, names.index("progress")] > 0.5) & (rows[:, names.index("progress")] < 0.8)]
    turns = middle[:, [names.index(f"turn_{k:+d}") for k in job_interface.TURNS]]
    pushes = middle[:, [names.index(f"push_{k:+d}") for k in job_interface.TURNS]]
    # In the frame at the reference the acceleration of another moment points elsewhere: by the angle between.
    angle = feed / radius * 1e-3 * np.array(job_interface.TURNS)
    sense = np.sign(turns.mean())
    assert np.allclose(turns, sense * feed**2 / radius * np.cos(angle), rtol=0.02)
    assert np.allclose(pushes, -(feed**2) / radius * np.sin(angle), atol=0.02 * feed**2 / radius)
    lag = feed * xy_axes.Params().servo * 1e-3 / (0.2595 * 0.2 * xy_axes.Params().gain)  # v·T/K
    there = np.arcsin(np.abs(middle[:, names.index("bend_reference")])) * radius
    # Ahead of the nozzle by the lag, the interpolator's 5 ms, and the 3 ms to the coming interpolation and its 8 ms.
    assert np.allclose(there, lag + feed * 0.016, rtol=0.05)


def test_a_process_sees_the_paths_angle_to_the_axes_whichever_way_it_goes():
    env = gym.make(CUTTING, scenario=scene("circle", 20.0), observation="raw").unwrapped
    names, rows, over = FEATURES["cutting"], [env.reset(seed=0)[0]], False
    while not over:
        seen, _, over, _, _ = env.step(np.zeros(8, np.float32))
        rows.append(seen)
    rows = np.array(rows)
    at = {name: rows[:, names.index(name)] for name in ("tangent_x", "tangent_y", "axial", "diagonal")}
    angle = np.arctan2(at["tangent_y"], at["tangent_x"])
    assert np.ptp(angle) > np.pi
    assert at["axial"] == pytest.approx(np.cos(2 * angle), abs=1e-5)
    assert at["diagonal"] == pytest.approx(np.cos(4 * angle), abs=1e-5)


@pytest.mark.parametrize("id_", [CONTOUR, CUTTING])
def test_the_time_lost_is_what_the_job_takes_longer_than_planned(id_):
    width = 3 if id_ == CONTOUR else 8
    seen, env = lived(id_, [-0.6] + [0.0] * (width - 1), scenario=scene("square", 10.0))
    planned = (len(env.batch.jobs[0].x) - 1) / 8
    lost = sum(info["reward_time"] for info in seen)
    assert len(seen) > 1.1 * planned
    assert lost == pytest.approx(len(seen) - planned, abs=1.5)


def test_a_standoff_that_is_set_wrong_is_cut_with_and_missed():
    seeds = [1000, 1001, 1002]
    fleet = workshop.fleet_for(scenarios.load("cut-standoff"), team("huang2024-dynamic"), seeds)
    fleet.advance(4000)
    g = fleet.gantries
    offset = g.column("recipe.offset")
    assert np.ptp(offset) > 0.01
    assert np.abs(offset).max() <= 0.2
    assert fleet.column("job.set_height") == pytest.approx(1.0 + offset)
    sums = {name: g.column(f"sums.{name}") for name in ("gap2", "length", "power_most", "dither_most")}
    assert np.sqrt(sums["gap2"] / sums["length"]) == pytest.approx(np.abs(offset), abs=0.01)
    assert sums["power_most"] == pytest.approx(workshop.material_of(scenarios.load("cut-standoff")).power)
    optics = spot.Params()
    assert sums["dither_most"] == pytest.approx(0.3 * spot.response(2000.0, optics.galvo, optics.galvo_zeta))


def test_nobody_gets_more_than_the_nominal_power_in_the_cutting_suite():
    for name in scenarios.suite("cutting"):
        _, env = lived(CUTTING, [0.0, 1.0] + [0.0] * 6, steps=2, scenario=name, base="huang2024-dynamic")
        assert env.batch.fleet.gantries.get("applied").power == 1.0
