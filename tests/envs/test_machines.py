"""Machines as files: what they hold, what scenarios on them are, and what is refused."""

import warnings
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

import kerfgym  # noqa: F401  (registers the environments)
from kerfgym.agents.vec_env import HeightFollowingVecEnv
from kerfgym.envs import scenarios
from kerfgym.envs.control import stack as stacks
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.height_following import HeightFollowingVectorEnv
from kerfgym.envs.plant import calibration, heads, sensor
from kerfgym.envs.scenarios import Head, Machine, Scenario, machine_text, machines
from kerfgym.envs.tasks import workshop

MINE = """\
name = "mine"
[axis]
bandwidth = 25
dead_time = 0.004
[head]
bore = 1.5
noise = { log_uniform = [2e-3, 1e-2] }
"""

SEEDS = range(1000, 1004)


@pytest.fixture
def mine(tmp_path):
    """A file of the machine with a drive of 25 Hz, 4 ms of dead time, a nozzle of 1.5 mm, and more noise."""
    file = tmp_path / "mine.toml"
    file.write_text(MINE, encoding="utf-8")
    return file


def course(scenario, controller="xi2023-tuned:law.kv=20", periods=300):
    """Positions and counts of some machines, which are the same bits if the machines are."""
    fleet = workshop.fleet_for(scenario, stacks.asked(controller), SEEDS)
    fleet.advance(periods)
    return np.stack([fleet.column(f"motion.{name}") for name in ("position", "velocity")] + [
        fleet.column("signals.frequency"), fleet.column("z.dead_time")
    ])  # fmt: skip


# -------------------------------------------------------------------------------------------------- files


@pytest.mark.parametrize("name", machines.presets())
def test_a_shipped_machine_is_what_would_be_written_of_it(name):
    machine, file = machines.load(name), machines._FOLDER / f"{name}.toml"
    assert machine.name == name
    told = [line for line in file.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    made = [line for line in machine_text.text_of(machine).splitlines() if not line.startswith("#")]
    assert told == made


def test_the_standard_machine_is_that_of_a_scenario_that_says_nothing():
    plain = Scenario(name="plain")
    assert replace(machines.load("standard"), summary="") == Machine(name="standard")
    assert machines.put_on(plain, machines.load("standard")) == plain
    assert not machines.differences(plain, machines.load("standard"))


@pytest.mark.parametrize("name", [*machines.presets(), "mine"])
@pytest.mark.parametrize("whole", [True, False])
def test_what_is_written_of_a_machine_reads_back_to_an_equal_one(name, whole, mine, tmp_path):
    machine = machines.load(mine if name == "mine" else name)
    again = tmp_path / "again.toml"
    again.write_text(machine_text.text_of(machine, whole), encoding="utf-8")
    assert machines.read(again) == machine
    assert machines.read(again).digest == machine.digest
    assert machines.load(machine.tables) == machine


def test_numbers_known_together_are_written_read_and_drawn_together(tmp_path):
    rows = {"bandwidth": [24.1, 25.3, 26.0], "zeta": [0.81, 0.78, 0.74]}
    machine = machines.of_tables(
        {"name": "mine", "axis": {key: {"choice": v, "joint": "motion"} for key, v in rows.items()}}, "mine"
    )
    file = tmp_path / "mine.toml"
    file.write_text(machine_text.text_of(machine, whole=False), encoding="utf-8")
    assert machines.read(file).digest == machine.digest
    fleet = workshop.fleet_for(machines.put_on(scenarios.load("wavy"), machine), stacks.asked("idle"), range(50))
    bandwidths = np.round(fleet.column("z.omega") / (2 * np.pi), 6)
    assert set(zip(bandwidths, fleet.column("z.zeta"), strict=True)) == set(zip(*rows.values(), strict=True))


def test_every_number_of_a_machine_is_written_with_unit_and_range():
    lines = machine_text.text_of(machines.STANDARD).splitlines()
    assert "bandwidth = { uniform = [50, 120] }           # Hz, velocity loop; 5 to 500 Hz" in lines
    assert "# bore = 2                                    # mm, diameter of the nozzle's bore; 0.2 to 8 mm" in lines
    assert all("  # " in line for line in lines[7:] if "=" in line)


def test_a_file_without_a_name_has_its_own_and_a_digest_is_of_the_numbers(mine, tmp_path):
    other = tmp_path / "other.toml"
    other.write_text(MINE.replace('name = "mine"\n', 'summary = "the same"\n'), encoding="utf-8")
    assert machines.read(other).name == "other"
    assert machines.read(other).digest == machines.read(mine).digest
    other.write_text(MINE.replace("25", "26"), encoding="utf-8")
    assert machines.read(other).digest != machines.read(mine).digest


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[axis]\nbandwith = 3", r"bad\.toml, line 2: unknown key 'axis\.bandwith'; did you mean 'bandwidth'\?"),
        (
            "[axis]\ndead_time = 0.021",
            r"bad\.toml, line 2: axis\.dead_time = 0\.021 is out of range; allowed: 0 to 0\.02 s",
        ),
        ("[axs]\nx = 1", r"bad\.toml, line 1: unknown key 'axs'; did you mean 'axis'\?"),
        ("[axis]\nzeta = 'high'", r"line 2: axis\.zeta: a number or a distribution is needed, not 'high'"),
        ("[axis]\nzeta = {uniform = [1, 0.5]}", r"line 2: axis\.zeta: the range \[1.0, 0.5\] must rise"),
        ("[axis]\nzeta = nan", r"line 2: axis\.zeta = nan"),
        ("[axis]\nzeta = {choice = [1, 'a']}", r"line 2: axis\.zeta: 'a' is not a number"),
        ("bandwidth = 25", r"line 1: unknown key 'bandwidth'; did you mean 'axis\.bandwidth'\?"),
        ("[head]\nspeed = 25", r"line 2: unknown key 'head\.speed'; did you mean 'axis\.speed' or 'gantry\.speed'\?"),
        (
            "feed = 200",
            r"line 1: feed belongs to a scenario, not to a machine; a machine has head, axis, gantry, optics",
        ),
        ("[sheet]\ntilt = 0", r"line 1: sheet belongs to a scenario"),
        ("[head]\nsignal = 'a.csv'", "head.signal is a recording; it belongs to a scenario"),
        ("[head]\nbore = 7\nface = 8", r"head: bore = 7 is out of range; allowed: 0\.8 of the face, 6\.4 mm|bore = 7"),
        ("[head]\ntable = 'none.csv'", r"none\.csv"),
        ("name = '../mine'", r"name = '\.\./mine' is no name"),
        ("axis = 3", r"line 1: axis = 3 is not allowed; allowed: a table \(Axis\)"),
        ("a = " + "[" * 5000, "more than 32 tables or lists within one another"),
        ("[axis]\nbandwidth = 1e999", "out of range"),
        ("not toml", "not valid TOML"),
    ],
)
def test_a_bad_file_is_refused_with_its_line(text, message, tmp_path):
    file = tmp_path / "bad.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput, match=message):
        machines.load(file)


def test_an_unknown_machine_is_an_error_that_offers_the_nearest():
    with pytest.raises(
        InvalidInput, match=r"unknown machine 'moden'; did you mean 'modern'\?.*or a path to a TOML file"
    ):
        machines.load("moden")
    with pytest.raises(InvalidInput, match="machine = 3 is not allowed; allowed: one of heavy-head"):
        machines.load(3)


@pytest.mark.parametrize("given", ["mine", "mine.tml", "mne.toml"])
def test_a_file_that_is_not_there_is_an_error_that_offers_the_nearest(given, mine):
    with pytest.raises(InvalidInput, match=r"no machine '.*'; did you mean the file '.*mine\.toml'\? \(known: heavy"):
        machines.load(mine.parent / given)


def test_a_preset_that_is_nearer_than_a_file_is_offered(tmp_path, monkeypatch):
    (tmp_path / "modest.toml").write_text("", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidInput, match="unknown machine 'modrn'; did you mean 'modern'"):
        machines.load("modrn")
    with pytest.raises(InvalidInput, match=r"cannot read '.*none/mine\.toml'"):
        machines.load(tmp_path / "none" / "mine.toml")


def test_a_measured_table_lies_beside_the_file_that_names_it(tmp_path):
    rows = [f"{f},{h}" for h, f in zip(np.linspace(0.01, 10, 400), np.linspace(1e6, 3e6, 400), strict=True)]
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "mine.csv").write_text("frequency_Hz,height_mm\n" + "\n".join(rows), encoding="utf-8")
    file = tmp_path / "deep" / "mine.toml"
    file.write_text("[head]\ntable = 'mine.csv'\n", encoding="utf-8")
    machine = machines.load(file)
    assert machine.head.table == str(tmp_path / "deep" / "mine.csv")
    before = machine.digest
    (tmp_path / "deep" / "mine.csv").write_text("frequency_Hz,height_mm\n" + "\n".join(rows[1:]), encoding="utf-8")
    assert machine.digest != before


# ---------------------------------------------------------------------------------------- scenarios on a machine


def test_a_scenario_on_a_machine_is_the_scenario_that_says_its_numbers(mine):
    put = machines.put_on(scenarios.load("wavy"), machines.load(mine))
    noise = {"log_uniform": [2e-3, 1e-2]}
    said = scenarios.load("wavy").varied(
        axis={"bandwidth": 25, "dead_time": 0.004}, head={"bore": 1.5, "noise": noise}, cut_by="mine"
    )
    assert put == said
    assert np.array_equal(course(put), course(said))
    assert not np.array_equal(course(put), course(scenarios.load("wavy")))


def test_what_a_scenario_says_of_a_machine_gives_way_and_what_happens_to_the_sensor_stays(mine):
    machine = machines.load(mine)
    late, impulses = scenarios.load("ood/late-rough"), scenarios.load("impulses")
    assert machines.put_on(late, machine).axis == machine.axis
    assert machines.given_up(late, machine) == ["axis.dead_time"]
    assert machines.put_on(impulses, machine).head.impulses == impulses.head.impulses == 20
    assert machines.put_on(impulses, machine).head.noise == machine.head.noise
    assert machines.given_up(impulses, machine) == []
    assert machines.warnings([late, impulses, scenarios.load("ood/late-flutter")], machine) == [
        "machine 'mine' replaces what late-rough, late-flutter say of axis.dead_time"
    ]
    spatters = replace(machine, head=replace(machine.head, impulses=7.0))
    assert machines.put_on(scenarios.load("wavy"), spatters).head.impulses == 7.0
    assert machines.put_on(impulses, spatters).head.impulses == 20


def test_a_follower_has_no_axes_and_a_job_gets_those_of_the_machine():
    modern = machines.load("modern")
    assert machines.put_on(scenarios.load("wavy"), modern).gantry == scenarios.Gantry()
    job = machines.put_on(scenarios.load("contour-mismatch"), modern)
    assert job.gantry == modern.gantry
    assert "gantry.x_plus" in machines.given_up(scenarios.load("contour-mismatch"), modern)
    quick = replace(modern, gantry=replace(modern.gantry, speed=2000.0, t1=0.02))
    assert scenarios.axes_of(quick.gantry).speed == 2000.0
    fleet = workshop.fleet_for(machines.put_on(job, quick), stacks.team("wu"), [1000])
    assert fleet.gantries.column("xy.speed")[0] == 2000.0
    assert fleet.gantries.column("xy.t1")[0] == 0.02
    assert fleet.gantries.column("xy.t2")[0] == scenarios.GANTRIES["modern"].t2


def test_a_scenario_that_a_machine_cannot_cut_is_an_error():
    wide = Machine(name="wide", head={"plate": 12.0})
    close = scenarios.load("step").varied(sheet={"steps": {"spacing": 20.0}})
    with pytest.raises(InvalidInput, match=r"scenario 'step' on machine 'wide': steps lie 20 mm apart"):
        machines.put_on(close, wide)


def test_a_scenario_says_what_it_was_put_on_and_reads_back(mine):
    put = machines.put_on(scenarios.load("wavy"), machines.load(mine))
    assert scenarios.parse(put.to_toml()) == put
    assert "cut_by" not in scenarios.load("wavy").to_toml()


# ------------------------------------------------------------------------------------------------------- nozzles


def test_a_nozzle_that_is_said_is_what_the_sensor_has_and_its_table_is_its_own():
    scenario = scenarios.load("flat").varied(
        head={"bore": 1.5, "face": 8.0, "nominal": True, "noise": 0.0, "jitter": 0.0}
    )
    fleet = workshop.fleet_for(scenario, stacks.asked("idle"), [1000])
    assert fleet.column("sensor.bore")[0] == 0.75
    assert fleet.column("sensor.radius")[0] == 4.0
    index = int(fleet.column("start.head")[0])
    p = heads.head(index)
    for height in (0.3, 1.0, 3.0):
        frequency = sensor.oscillator(p, sensor.capacitance(p, height, 1.0), 0.0)
        read = calibration.height(
            calibration.Params(),
            heads.POOL.frequencies,
            heads.POOL.heights,
            np.uint64(index * calibration.POINTS),
            frequency,
        )[0]
        assert read == pytest.approx(height, abs=0.02)
    usual = heads.table(0)
    assert np.abs(heads.POOL[index].frequency - usual.frequency).max() > 1e4


def test_the_pool_of_a_nozzle_draws_what_is_a_distribution_and_keeps_the_preset_for_the_rest():
    first = scenarios.preparing.family(Head(bore={"uniform": [1.0, 2.0]}, body=12.0))
    made = [heads.head(first + n) for n in range(heads.HEADS)]
    assert [p.inductance for p in made] == [heads.head(n).inductance for n in range(heads.HEADS)]
    assert {p.body for p in made} == {12.0}
    bores = np.array([2 * p.bore for p in made])
    assert bores[0] == 1.5
    assert len(set(bores)) == heads.HEADS
    assert 1.0 <= bores.min() < bores.max() <= 2.0
    assert heads.exact(first + 3) != heads.exact(3)
    carried = np.array([[getattr(made[3], name)] for name in heads.FIELDS])
    assert heads.carried(carried)[0] == first + 3


def test_a_hundred_kinds_of_nozzles_are_told_apart_in_one_process():
    firsts = [scenarios.preparing.family(Head(face=8.0 + 0.01 * i)) for i in range(100)]
    assert len(set(firsts)) == 100
    assert [2 * heads.head(first).radius for first in firsts] == pytest.approx([8.0 + 0.01 * i for i in range(100)])
    carried = heads.fields(np.array(firsts))
    assert heads.carried(carried).tolist() == firsts
    assert heads.POOL.frequencies[firsts[-1] * calibration.POINTS] == 1e6  # a straight line until it is calibrated


def test_no_head_of_the_pool_is_number_zero():
    unknown = heads.fields(np.array([0, 5]))
    unknown[0, 1] += 1.0
    assert heads.carried(unknown).tolist() == [0, 0]


# ------------------------------------------------------------------------------------------------- environments


def plays(env, steps=5):
    """Observations of an environment of its own, or of one of many machines."""
    seen, _ = env.reset(seed=3)
    found = [np.atleast_2d(seen)[0]]
    for _ in range(steps):
        action = np.zeros(env.action_space.shape, np.float32)
        found.append(np.atleast_2d(env.step(action)[0])[0])
    return np.array(found)


def test_every_environment_of_a_follower_takes_a_machine_by_name_file_object_or_tables(mine):
    machine = machines.load(mine)
    make = lambda m: gym.make("kerfgym/HeightFollowing-v0", scenario="wavy", machine=m, disable_env_checker=True)  # noqa: E731
    wanted = plays(make(machine))
    for given in (mine, str(mine), machine.tables):
        assert np.array_equal(plays(make(given)), wanted)
    assert not np.array_equal(plays(make(None)), wanted)
    assert np.array_equal(plays(make("standard")), plays(make(None)))
    vectors = (
        HeightFollowingVectorEnv(2, scenario="wavy", machine=machine),
        gym.make_vec("kerfgym/HeightFollowing-v0", 2, scenario="wavy", machine=str(mine)),
    )
    for vector in vectors:
        assert np.array_equal(plays(vector), wanted)
    sb3 = HeightFollowingVecEnv(2, scenario="wavy", machine=machine.tables)
    sb3.seed(3)
    found = [sb3.reset()[0]] + [sb3.step(np.zeros((2, *sb3.action_space.shape), np.float32))[0][0] for _ in range(5)]
    assert np.array_equal(np.array(found), wanted)


@pytest.mark.parametrize("name", ["kerfgym/ContourFollowing-v0", "kerfgym/Cutting-v0"])
def test_every_environment_of_jobs_takes_a_machine(name):
    with pytest.warns(UserWarning, match="machine 'modern' replaces what .* of gantry"):
        env = gym.make(name, machine="modern", disable_env_checker=True)
    assert env.unwrapped.batch.scenarios[0].gantry.preset == "modern"
    assert env.unwrapped.batch.scenarios[0].cut_by == "modern"


def test_tables_without_a_name_still_change_the_scenario_alone():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make("kerfgym/HeightFollowing-v0", scenario="ood/late-rough", machine={"axis": {"zeta": 0.9}})
    scenario = env.unwrapped.batch.scenarios[0]
    assert (scenario.axis.zeta, scenario.axis.dead_time, scenario.cut_by) == (0.9, 0.003, "standard")


# ------------------------------------------------------------------------------------------------- suites in folders


@pytest.fixture
def folder(tmp_path):
    """A suite of one's own: two scenarios, one of which has a profile beside it."""
    own = tmp_path / "my_suite"
    own.mkdir()
    (own / "bend.csv").write_text("position_mm,height_mm\n0,0\n500,0.2\n1000,0\n", encoding="utf-8")
    (own / "one.toml").write_text('name = "bent"\n[sheet.profile]\nfile = "bend.csv"\n', encoding="utf-8")
    (own / "two.toml").write_text('name = "two"\nduration = 1\n', encoding="utf-8")
    return own


def test_a_folder_is_a_suite_whose_files_find_what_lies_beside_them(folder, monkeypatch):
    monkeypatch.chdir(folder.parent)
    for name in (str(folder), "my_suite", "my_suite/"):
        found = scenarios.suite(name)
        assert list(found) == ["bent", "two"] == list(scenarios.core(name))
        assert found["bent"].sheet.profile.file == str(folder / "bend.csv")
        assert scenarios.called(name) == "my_suite"
    assert scenarios.rules("my_suite")["slot"] == "z"
    env = gym.make("kerfgym/HeightFollowing-v0", scenario="my_suite")
    assert [s.name for s in env.unwrapped.batch.scenarios] == ["bent", "two"]


def test_a_suites_file_says_its_core_and_a_change_of_a_file_is_seen(folder):
    (folder / "suite.toml").write_text('core = ["two"]\nseeds = 5\n', encoding="utf-8")
    assert scenarios.core(str(folder)) == ("two",)
    assert scenarios.rules(str(folder))["seeds"] == 5
    (folder / "three.toml").write_text('name = "three"\n', encoding="utf-8")
    assert list(scenarios.suite(str(folder))) == ["bent", "three", "two"]


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("suite.toml", 'core = ["tow"]', r"suite\.toml: core: unknown scenario 'tow'; did you mean 'two'\?"),
        ("suite.toml", "\nsedes = 5", r"suite\.toml, line 2: unknown key 'sedes'; did you mean 'seeds'\?"),
        ("suite.toml", 'scenarios = ["bent"]\ncore = ["two"]', "core: 'two' is none of the suite's scenarios"),
        ("three.toml", 'name = "two"', r"two\.toml': there are two scenarios 'two' in this suite"),
        ("three.toml", 'name = "three"\n[job]', "scenarios with a job and scenarios without one cannot share a suite"),
        ("three.toml", 'name = "three"\nfed = 3', r"three\.toml, line 2: unknown key 'fed'; did you mean 'feed'\?"),
    ],
)
def test_what_is_wrong_in_a_suites_folder_is_an_error(folder, file, text, message):
    (folder / file).write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput, match=message):
        scenarios.suite(str(folder))


def test_a_folder_that_is_no_suite_or_called_as_a_shipped_one_is_an_error(tmp_path):
    with pytest.raises(InvalidInput, match=r"unknown suite '.*nowhere'.*or a folder of scenarios"):
        scenarios.suite(str(tmp_path / "nowhere"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(InvalidInput, match="holds no scenario; it needs a TOML file for each"):
        scenarios.suite(str(tmp_path / "empty"))
    (tmp_path / "ood").mkdir()
    with pytest.raises(InvalidInput, match="suite 'ood' is shipped already; one's own needs another name"):
        scenarios.suite(str(tmp_path / "ood"))
