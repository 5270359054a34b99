"""What to set, on a report's first screen: of presets, of what was tuned, of policies."""

import re

import pytest

from kerfgym.envs.control import stack as stacks
from kerfgym.experiments.benchmark.in_units import settings
from kerfgym.experiments.report import page
from kerfgym.experiments.report.standing import all_of
from kerfgym.experiments.report.suite import Suite
from kerfgym.experiments.report.to_set import to_set


def asked(spec):
    found = settings(spec, stacks.asked(spec))
    return found, {name: (value, unit, was) for name, value, unit, was in found["rows"]}


def test_of_a_preset_it_is_the_law_and_what_its_filter_reads():
    found, rows = asked("pid")
    known = stacks.asked("pid").parameters()
    assert (found["of"], found["policy"]) == ("", False)
    assert {name for name in known if name.startswith("law.")} <= set(rows)
    assert rows["law.kp"] == (f"{known['law.kp'].value:.5g}", "1/s", "")
    assert rows["filter.kind"] == ("anti-impulse", "", "")
    assert {"filter.jump", "filter.hold"} <= set(rows)
    assert "filter.window" not in rows  # which this kind does not read


def test_of_what_was_changed_or_tuned_it_is_what_differs(tmp_path):
    found, rows = asked("pid:law.kp=40,filter.kind=mean")
    assert found["of"] == "pid"
    was = f"{stacks.asked('pid').parameters()['law.kp'].value:.5g}"
    assert rows == {"law.kp": ("40", "1/s", was), "filter.kind": ("mean", "", "anti-impulse")}
    file = tmp_path / "tuned.toml"
    file.write_text('controller = "pid"\n[parameters]\n"law.kp" = 41.0\n', encoding="utf-8")
    assert asked(str(file)) == (
        {"of": "pid", "policy": False, "rows": [["law.kp", "41", "1/s", was]]},
        asked(str(file))[1],
    )


@pytest.mark.parametrize("spec", ["wu-tuned", "huang2024-adjusting", "lqg", "mpc"])
def test_every_kind_of_controller_has_some(spec):
    _, rows = asked(spec)
    assert rows
    assert all(value for value, *_ in rows.values())


def test_of_a_policy_nothing_is_set_by_hand_and_the_best_that_is_stands_beside_it(made_up):
    results = made_up.following()
    results.meta["settings"] = {
        "xi2023-tuned": {"of": "", "policy": False, "rows": [("law.kv", "90", "1/s", "")]},
        "pid": {"of": "", "policy": True, "rows": []},
    }
    suite = Suite("following", results)
    labels = {name: name for name in results.controllers}
    standing = all_of(suite)[suite.metric]
    assert standing.best == "pid"
    first, second = to_set(suite, standing, labels)
    assert first["lead"] == "is taken as it is, -c pid: it is not set by hand"
    assert (second["label"], second["rows"]) == ("xi2023-tuned", [("law.kv", "90", "1/s", "")])
    results.meta["settings"]["pid"] = {"of": "pid", "policy": False, "rows": [("law.kp", "40", "1/s", "60")]}
    (only,) = to_set(suite, standing, labels)
    assert (only["lead"], only["rows"]) == ("differs from pid in", [("law.kp", "40", "1/s", "60")])


def test_who_is_closer_and_had_more_trials_stands_first(made_up):
    """Whoever tunes on a machine of his own wants those numbers, although the ranking leaves them out as unfair."""
    results = made_up.following()
    results.meta["settings"] = {
        name: {"of": "", "policy": False, "rows": [["law.kp", "1", "", ""]]} for name in results.controllers
    }
    results.meta["tuning"]["pid"] = results.meta["tuning"]["pid"] | {"simulated_steps": 10**12}
    suite = Suite("following", results)
    standing = all_of(suite)[suite.metric]
    assert standing.best == "xi2023-tuned"
    first, second = to_set(suite, standing, {name: name for name in results.controllers})
    assert (first["label"], second["label"]) == ("pid", "xi2023-tuned")
    assert first["lead"] == "is closer, though not ranked, and has"


def test_the_first_screen_has_it_with_units_and_a_run_without_a_record_has_none(made_up, tmp_path):
    results = made_up.following()
    results.meta["settings"] = {"pid": {"of": "pid", "policy": False, "rows": [("law.kp", "40", "1/s", "<b>")]}}
    text = page.page(tmp_path, {"following": results}, {})
    header = text[text.index('<header id="answer">') : text.index("</header>")]
    assert re.search(r"<code>law\.kp</code> <b>40</b> 1/s <small>\(was &lt;b&gt;\)</small>", header)
    assert "Machine: as the scenarios say." in header
    assert "Height following: wavy, rough, holes; 2 of them count" in header
    del results.meta["settings"]
    assert "law.kp</code>" not in page.page(tmp_path, {"following": results}, {})
