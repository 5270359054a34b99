"""Stacks: how a user's words become a controller, its parameters, and what bad input says."""

import json
import sys
from typing import NamedTuple

import numpy as np
import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control.stack import Stack, as_stack, asked, get, names, resolve, team
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import filters, heads, supervisor
from kerfgym.envs.plant.controller import SLOTS
from kerfgym.envs.plant.fleet import Fleet

SHIPPED = ["idle", "observer", "pid", "preview-5ms", "xi2023-improved", "xi2023-ma", "xi2023-tuned"]

PYTHON = '''
class Steady:
    """Sinks slowly.

    And a second paragraph.
    """

    def reset(self):
        self.past = 0

    def control(self, signals):
        self.past += 1
        return -1.0


class Deaf:
    def reset(self):
        pass


TEXT = "not a controller"
'''

LAW = '''
"""A law in a file of its own."""

from typing import Annotated, NamedTuple

from kerfgym.envs.engine.quantity import Quantity

class Gain(NamedTuple):
    gain: Annotated[float, Quantity("1/s", 1.0, 100.0, "gain")] = 20.0


class Memory(NamedTuple):
    nothing: float = 0.0


class Mine:
    """Proportional.

    More words.
    """

    Params, State = Gain, Memory

    def init(params):
        return Memory(0.0)

    def control(params, state, signals, tables):
        return state, -params.gain * (signals.height - signals.set_height)


class Fast(Mine):
    DEFAULTS = {"law.gain": 60.0, "filter.kind": "median", "filter.window": 7}


class Sideways(Mine):
    SLOT = "xy"


class Seer(Mine):
    INFORMATION = "clairvoyant"


class Endless(Mine):
    class Params(NamedTuple):
        a: tuple = ()


class Stateless:
    class Params(NamedTuple):
        gain: float = 1.0

    def control(params, state, signals, tables):
        return state, 0.0
'''


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A folder of the user's with two modules."""
    (tmp_path / "mycontrol.py").write_text(PYTHON, encoding="utf-8")
    (tmp_path / "mylaw.py").write_text(LAW, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for name in ("mycontrol", "mylaw"):
        sys.modules.pop(name, None)


# ------------------------------------------------------------------------------------------------------ names and words


def test_the_registry_knows_every_shipped_controller():
    assert set(SHIPPED) <= set(names())
    for name in SHIPPED:
        assert get(name).name == name
        assert get(name).slot == "z"
        assert get(name).summary
    assert {get(n).information for n in SHIPPED if n != "preview-5ms"} == {"sensor"}
    assert get("preview-5ms").information == "preview"


def test_overrides_change_what_they_name_and_nothing_else():
    plain, changed = get("pid").parameters(), resolve("pid:law.kp=80,filter.window=9,filter.kind=median").parameters()
    assert changed["law.kp"].value == 80.0
    assert changed["filter.window"].value == 9.0
    assert filters.KINDS[int(changed["filter.kind"].value)] == "median"
    others = set(plain) - {"law.kp", "filter.window", "filter.kind"}
    assert {k: plain[k].value for k in others} == {k: changed[k].value for k in others}
    assert resolve("pid:law.kp=80").name == "pid:law.kp=80"
    assert get("pid").parameters() == plain


def test_a_slot_may_be_named_and_a_stack_passes_through():
    assert resolve("z=pid") is get("pid")
    assert resolve("z=pid:law.kp=80").parameters()["law.kp"].value == 80.0
    assert resolve(get("pid")) is get("pid")


def test_a_follower_is_a_team_without_axes_and_process():
    alone = asked("pid:law.kp=30")
    assert (alone.name, alone.slots, alone.z) == ("pid:law.kp=30", "z", resolve("pid:law.kp=30"))
    assert alone.parameters() == alone.z.parameters()
    assert alone.varied({"law.kp": 40.0}).z == alone.z.varied({"law.kp": 40.0})
    assert (alone.provenance, alone.information) == (alone.z.provenance, alone.z.information)
    with pytest.raises(InvalidInput, match=r"controller 'pid:law.kp=30' drives slot 'z', not 'xy'"):
        _ = alone.xy


def test_what_the_words_leave_open_is_filled_for_jobs_alone():
    two = asked("z=pid,xy=wu")
    assert (two.slots, two.full.slots) == ("z and xy", "z, xy and process")
    assert two.full == team("z=pid,xy=wu")
    assert [s.name for s in two.full.stacks] == ["pid", "wu", "recipe"]
    assert two.having(get("observer")).z is get("observer")
    varied = two.varied({"xy.law.kp": 2.0})
    assert varied.z == two.z
    assert varied.parameters()["xy.law.kp"].value == varied.xy.part("law").kp == 2.0


def test_every_group_of_a_stack_is_declared():
    parameters = get("observer").parameters()
    assert {name.split(".")[0] for name in parameters} == {"gate", "filter", "table", "guard", "law"}
    for name, parameter in parameters.items():
        assert parameter.name == name
        assert parameter.quantity.low <= parameter.value <= parameter.quantity.high


def test_installing_a_stack_writes_its_numbers_into_its_machines_only():
    fleet = Fleet(3, get("pid").law, heads.POOL)
    before = fleet.get("guard", 0), fleet.get("filter", 0), fleet.get("gate", 0)
    resolve("pid:law.kp=33,filter.kind=mean,filter.window=11,gate.length=0.5,gate.mean=mean,guard.rise=0.4").install(
        fleet, [1]
    )
    assert fleet.get("filter", 1)[:2] == (filters.MEAN, 11.0)
    assert fleet.get("gate", 1) == (0.5, 1.0)
    assert fleet.get("guard", 1) == supervisor.Params(rise=0.4)
    assert (fleet.get("guard", 0), fleet.get("filter", 0), fleet.get("gate", 0)) == before


# -------------------------------------------------------------------------------------------- controllers of one's own


@pytest.mark.parametrize("spec", ["mycontrol:Steady", "mycontrol.py:Steady"])
def test_a_plain_python_class_is_a_controller(own, spec):
    steady = resolve(spec)
    assert steady.name == "mycontrol:Steady"
    assert steady.summary == "Sinks slowly."
    assert steady.information == "sensor"
    one, other = steady.python(), steady.python()
    assert one is not other
    assert resolve(f"{spec}:filter.window=9").parameters()["filter.window"].value == 9.0


@pytest.mark.parametrize("spec", ["mylaw:Mine", "mylaw.py:Mine"])
def test_a_law_in_a_file_of_its_own_is_a_controller(own, spec):
    mine = resolve(spec)
    assert mine.python is None
    assert mine.law.summary == "Proportional."
    assert mine.parameters()["law.gain"].value == 20.0
    assert resolve(f"{spec}:law.gain=30").parameters()["law.gain"].value == 30.0
    Fleet(1, mine.law, heads.POOL).advance(3)
    fast = resolve(spec.replace("Mine", "Fast")).parameters()
    assert fast["law.gain"].value == 60.0
    assert fast["filter.window"].value == 7.0


def test_an_instance_gives_every_machine_a_mind_of_its_own(own):
    steady = resolve("mycontrol.py:Steady").python()
    minds = [as_stack(steady, "steady").python() for _ in range(2)]
    for mind in minds:
        mind.reset()
    minds[0].control(None)
    assert [mind.past for mind in minds] == [1, 0]


def test_a_users_file_does_not_take_the_place_of_a_module_of_that_name(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "json", json)
    (tmp_path / "json.py").write_text(PYTHON, encoding="utf-8")
    resolve(f"{tmp_path / 'json.py'}:Steady")
    assert sys.modules["json"] is json


# ---------------------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("pidd", r"unknown controller 'pidd'; did you mean 'pid'\? \(known: .*observer.*\), or module:attr of"),
        ("xi2023_improved", r"unknown controller 'xi2023_improved'; did you mean 'xi2023-improved'\?"),
        ("pid:law.kpp=80", r"controller 'pid': unknown parameter 'law\.kpp'; did you mean 'law\.kp'\?"),
        ("pid:fliter.window=5", r"unknown parameter 'fliter\.window'; did you mean 'filter\.window'\?"),
        ("pid:law.kp=1e9", r"law\.kp = 1000000000\.0 is out of range; allowed: 1 to 400 1/s"),
        ("pid:law.kp=nan", r"law\.kp = nan is out of range; allowed: 1 to 400 1/s"),
        ("pid:law.kp=fast", r"law\.kp = 'fast' is not a number; allowed: 1 to 400 1/s"),
        ("pid:filter.window=65", r"filter\.window = 65\.0 is out of range; allowed: 1 to 64 samples \(whole\)"),
        ("pid:filter.window=4.5", r"filter\.window = 4\.5 is out of range; allowed: 1 to 64 samples \(whole\)"),
        ("pid:filter.kind=medain", r"filter\.kind = 'medain' is not known; did you mean 'median'\?"),
        ("pid:guard.timeout=0", r"guard\.timeout = 0\.0 is out of range; allowed: 1 to 5000 ms"),
        ("pid:gate.length=2", r"gate\.length = 2\.0 is out of range; allowed: 0\.05 to 1 ms"),
        ("pid:law.kp", r"cannot import 'pid'|'law\.kp' is not of the form parameter=value"),
        ("pid:law.kp=80,law.ki", r"'law\.ki' is not of the form parameter=value"),
        ("pid:law.kp=80:law.ki=5", r"'pid:law\.kp=80:law\.ki=5'"),
        (
            "xi2023-improved:filter.window=5,filter.trim=3",
            r"filter\.trim = 3 eats the whole window of 5 samples; allowed: 0 to 2 at this window",
        ),
        ("xy=pid", "'xy=pid': controller 'pid' drives slot 'z', not 'xy'"),
        ("yx=pid", "'yx=pid': no slot 'yx' in this machine; did you mean 'xy'"),
        ("q=pid", r"'q=pid': no slot 'q' in this machine; .*known: z"),
        ("nowhere.at.all:Mine", r"cannot import 'nowhere\.at\.all': No module named 'nowhere'"),
        ("nowhere.py:Mine", r"no file 'nowhere\.py'"),
        ("mycontrol.py:Stedy", r"module 'mycontrol\.py' has no 'Stedy'; did you mean 'Steady'\?"),
        ("mylaw:Mien", r"module 'mylaw' has no 'Mien'; did you mean 'Mine'\?"),
        ("mycontrol.py:Deaf", r"'mycontrol:Deaf' is not a controller: it needs reset\(\) and control\(signals\)"),
        ("mycontrol.py:TEXT", r"'mycontrol:TEXT' is not a controller"),
        ("mylaw.py:Stateless", r"'mylaw:Stateless' has no State, init; a law needs Params, State, init, control"),
        ("z=mylaw.py:Sideways", r"controller 'mylaw:Sideways' drives slot 'xy', not 'z'"),
        ("mylaw.py:Seer", r"unknown information class 'clairvoyant'; .*known: sensor, preview, privileged"),
        ("mylaw.py:Mine:law.gian=3", r"unknown parameter 'law\.gian'; did you mean 'law\.gain'\?"),
        ("mylaw.py:Mine:law.gain=300", r"law\.gain = 300\.0 is out of range; allowed: 1 to 100 1/s"),
    ],
)
def test_a_mistake_in_a_controllers_words_is_named(own, spec, message):
    with pytest.raises(InvalidInput, match=message):
        resolve(spec)


def test_a_stack_with_a_misspelt_group_is_refused():
    with pytest.raises(InvalidInput, match=r"controller 'x': unknown group 'fliter'; did you mean 'filter'\?"):
        Stack("x", "", get("pid").law, {"fliter.window": 3})


def test_a_law_may_not_have_more_numbers_than_a_machine_has_room_for(own):
    import mylaw

    most = SLOTS["z"].state
    state = NamedTuple("State", [(f"x{i}", float) for i in range(most + 1)])
    many = type("Many", (mylaw.Mine,), {"State": state})
    with pytest.raises(InvalidInput, match=f"controller 'many': State has {most + 1} numbers; at most {most}"):
        as_stack(many, "many")
    few = type("Few", (mylaw.Mine,), {"Params": dict})
    with pytest.raises(InvalidInput, match=r"controller 'few': .*dict.* is not a NamedTuple"):
        as_stack(few, "few")


def test_the_widest_window_works_and_a_wider_one_is_refused():
    with pytest.raises(InvalidInput, match=r"filter\.window = 65"):
        get("xi2023-ma").varied({"filter.window": 65})
    wide = get("xi2023-ma").varied({"filter.window": 64})
    seeds = np.arange(3)
    fleet = Fleet(3, wide.law, heads.POOL)
    scenarios.prepare(fleet, scenarios.load("flat"), seeds, seeds)
    wide.install(fleet, seeds)
    fleet.begin(seeds, scenarios.noise_keys(seeds))
    fleet.advance(200)
    assert np.isfinite(fleet.column("signals.height")).all()
