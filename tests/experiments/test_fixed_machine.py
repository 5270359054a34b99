"""One machine of many: what a seed draws, as a machine without distributions."""

import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control import stack as stacks
from kerfgym.envs.control.stack import get
from kerfgym.envs.scenarios import Scenario, machines
from kerfgym.envs.tasks import workshop
from kerfgym.experiments import cli
from kerfgym.experiments.machine.fixed import fixed
from kerfgym.experiments.measure import rollout
from kerfgym.experiments.studies.identified import WIDE

FLAT = Scenario(name="flat", duration=1.0, settle=0.0, feed=0.0, set_height=1.0)


def parts(machine, seed):
    fleet = rollout.fleet_for(machines.put_on(FLAT, machine), get("idle"), [seed])
    return {name: fleet.get(name)._asdict() for name in ("z", "sensor")}


@pytest.mark.parametrize("machine", ["standard", "modern", "heavy-head", WIDE])
def test_a_fixed_machine_is_the_one_that_the_seed_draws(machine):
    drawn = machines.load(machine)
    one = fixed(drawn, 7)
    there, here = parts(drawn, 7), parts(one, 7)
    for name, part in there.items():
        assert here[name] == pytest.approx(part, rel=1e-12), name
    assert parts(one, 8) == here  # whatever the seed
    assert parts(drawn, 8) != there


def test_axes_and_optics_of_a_fixed_machine_are_those_that_the_seed_draws():
    drawn = machines.load({**WIDE, "gantry": {"x_plus": {"uniform": [0.7, 1.4]}, "slower": {"log_uniform": [0.3, 3.0]}},
                           "optics": {"galvo": {"uniform": [3e3, 6e3]}}})  # fmt: skip
    job, found = scenarios.load("contour-mismatch"), []
    for machine in (drawn, fixed(drawn, 5)):
        gantries = workshop.fleet_for(machines.put_on(job, machine), stacks.team("wu"), [5]).gantries
        found.append({name: gantries.column(name)[0] for name in ("xy.x_plus", "xy.t1", "optics.galvo")})
    assert found[1] == pytest.approx(found[0], rel=1e-12)
    assert found[0]["xy.x_plus"] != 1.0


def test_the_command_writes_it_and_says_what_is_wrong(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    cli.main(["machine", "draw", "one.toml", "--like", "modern", "--seed", "3"])
    assert parts(machines.load("one.toml"), 0) == parts(fixed(machines.load("modern"), 3), 0)
    for words, why in (
        (["one.toml"], "exists; --overwrite"),
        ([], "draw takes one file to write"),
        (["two.toml", "--set", "axis.zeta=1"], "draw takes no --set axis.zeta=1"),
    ):
        with pytest.raises(SystemExit):
            cli.main(["machine", "draw", *words])
        assert why in capsys.readouterr().err


def test_a_fixed_machine_has_no_distribution_left():
    text = fixed(machines.load(WIDE), 1).tables
    assert not [key for table in ("head", "axis") for key, value in text[table].items() if isinstance(value, dict)]
