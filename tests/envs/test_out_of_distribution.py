"""The suite ``ood``: the core of the following suite, one condition beyond what it draws from (docs/suites.md#ood)."""

from dataclasses import asdict

import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.scenarios import core, rules, suite
from kerfgym.envs.scenarios.distributions import bounds

SHIFTS = {
    "fast": {"feed": 400.0},
    "noisy": {"head": {"noise": {"log_uniform": [1.5e-3, 1.5e-2]}}},
    "late": {"axis": {"dead_time": 0.003}},
    "soft": {"axis": {"bandwidth": 40.0}},
    "stiff": {"axis": {"bandwidth": 150.0}},
    "low": {"set_height": 0.3},
    "spatter": {"head": {"impulses": 6.0}},
}
"""docs/suites.md#ood: 400 mm/s; noise × 3; dead time 3 ms; 40 Hz and 150 Hz loop; set height 0.3 mm; impulses × 3."""


def parts(name):
    """Shift and base of a scenario."""
    shift, base = name.split("-")
    changes = {"head": {"impulses": 60.0}} if (shift, base) == ("spatter", "impulses") else SHIFTS[shift]
    return changes, scenarios.load(base)


@pytest.mark.parametrize("name", suite("ood"))
def test_a_scenario_is_one_of_the_core_with_one_condition_changed(name):
    changes, base = parts(name)
    assert base.name in core("following")
    differing = {**asdict(suite("ood")[name]), "name": "", "summary": ""}
    assert differing == {**asdict(base.varied(**changes)), "name": "", "summary": ""}
    assert suite("ood")[name].summary.startswith(f"{base.name}, ")


@pytest.mark.parametrize("name", suite("ood"))
def test_what_is_changed_lies_beyond_what_the_base_draws_from(name):
    changes, base = parts(name)
    shifted = suite("ood")[name]
    for key, value in changes.items():
        for field in value if isinstance(value, dict) else [None]:
            was, now = (getattr(s, key) if field is None else getattr(getattr(s, key), field) for s in (base, shifted))
            (low, high), (least, most) = bounds(was), bounds(now)
            assert most > high or least < low
            if field in ("noise", "impulses"):
                assert (least, most) == pytest.approx((3 * low, 3 * high))


def test_every_shift_is_applied_to_rough_and_to_another_of_the_core_and_all_count():
    names = list(suite("ood"))
    assert core("ood") == tuple(names) == tuple(rules("ood")["scenarios"])
    found = {shift: [n.split("-")[1] for n in names if n.startswith(f"{shift}-")] for shift in SHIFTS}
    assert all(len(set(bases)) == 2 and "rough" in bases for bases in found.values())
    assert sum(map(len, found.values())) == len(names) == 14
