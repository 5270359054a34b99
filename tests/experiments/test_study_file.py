"""Study files: what the shipped ones search, that a study goes on where it stood, and what it writes and refuses."""

import json
import math
import tomllib
import types
from dataclasses import replace

import numpy as np
import optuna
import pandas as pd
import pytest
from scipy import optimize

from kerfgym.baselines import PRESETS
from kerfgym.envs.control.stack import get, team
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.experiments.cli import main
from kerfgym.experiments.statistics import budgets
from kerfgym.experiments.store.ledger import Ledger
from kerfgym.experiments.tune import evaluate, goals, searches, staged, storage, study, study_file
from kerfgym.experiments.tune import space as spaces
from kerfgym.experiments.tune.work import done

FOLLOWERS = study_file.read("followers").searches
SUITE = next(iter(FOLLOWERS.values())).suite


@pytest.mark.parametrize("name", FOLLOWERS)
def test_all_of_a_law_is_searched_and_all_that_its_filter_reads(name):
    searched = {axis.name for axis in FOLLOWERS[name].space.axes}
    assert {key for key in get(name).parameters() if key.startswith("law.")} <= searched
    read = {key for key in searched if key.startswith("filter.")}
    assert "filter.kind" not in read
    assert bool(read) == (name != "self-tuning")  # whose law reads the raw height


@pytest.mark.parametrize("name", FOLLOWERS)
def test_the_preset_holds_what_was_searched_and_nothing_else(name):
    preset = tomllib.loads((PRESETS / f"{name}.toml").read_text(encoding="utf-8"))
    assert set(preset["parameters"]) == {axis.name for axis in FOLLOWERS[name].space.axes}


def test_no_winner_of_the_protocol_had_a_larger_budget_than_another():
    records = {name: get(name).provenance for name in FOLLOWERS}
    measure = budgets.measures(records, tuple(FOLLOWERS), "xi2023-tuned")
    assert {name: list(budgets.faults(record, measure)) for name, record in records.items()} == {
        n: [] for n in FOLLOWERS
    }


class Pretended(evaluate.Evaluator):
    """Scores by one gain alone, the larger the better; odd gains collide on more seeds than a trial sees."""

    parts = 1

    def part(self, i, candidate, wanted, by=()):
        self.ledger.add(len(self.seeds), 0.0)
        gain = candidate.parameters()["law.kp"].value
        crash = float(gain % 2.0 >= 1.0 and len(self.seeds) > 16)
        return {s: {"rms_true": np.array([1000.0 / gain]), "collision": np.array([crash])} for s in self.core}

    def peak(self, candidate):
        return candidate.parameters()["law.kp"].value / 60.0

    def exact_peak(self, candidate):
        self.ledger.add(7, 0.0)
        return self.peak(candidate)


@pytest.fixture
def pretended(monkeypatch, here):
    assert get("pid").provenance["trials"] > 0  # read, and kept, before presets lie elsewhere
    monkeypatch.setattr(study, "Evaluator", Pretended)
    monkeypatch.setattr("kerfgym.experiments.tune.outcome.scored", lambda *_: ({"rms_true": 1.0, "collisions": 0}, {}))
    monkeypatch.setattr("kerfgym.experiments.tune.history.write", lambda *_: [])
    unjudged = types.SimpleNamespace(margins=None, ledger=Ledger())
    monkeypatch.setattr("kerfgym.experiments.tune.controllers.assessed", lambda *_: unjudged)
    monkeypatch.setattr("kerfgym.experiments.tune.tuned_page.write", lambda folder, *_: folder / "tuned.html")
    monkeypatch.setattr("kerfgym.experiments.tune.tuned_page.write_nothing", lambda folder, *_: folder / "tuned.html")
    monkeypatch.setattr("kerfgym.experiments.tune.searches.baselines.PRESETS", here / "presets")
    return here


def test_the_final_check_refuses_what_touches_the_sheet_on_a_hundred_seeds(pretended, capsys):
    main(["tune", "pid", "--study", "followers", "--trials", "60", "--name", "a"])
    assert "1 of" not in capsys.readouterr().err
    preset = tomllib.loads((pretended / "presets" / "pid.toml").read_text(encoding="utf-8"))
    gain, record = preset["parameters"]["law.kp"], preset["provenance"]
    assert 90.0 < gain <= 120.0  # beyond that Ms is above 2
    assert gain % 2.0 < 1.0
    assert record["score_checked_um"] == pytest.approx(1000.0 / gain, rel=1e-3)
    assert record["ms"] <= record["cap"]
    assert record["ms_steps"] > 0
    assert record["simulated_steps"] <= 60 * 16 + 10 * 200
    assert record["start"]["trials"] == get("pid").provenance["trials"]  # it went on from a preset of this suite


def test_a_search_without_anything_that_keeps_the_limits_leaves_the_preset_alone(pretended, monkeypatch, capsys):
    monkeypatch.setattr(Pretended, "peak", lambda self, candidate: math.inf)
    with pytest.raises(SystemExit) as ended:
        main(["tune", "pid", "--study", "followers", "--trials", "12", "--name", "a"])
    assert ended.value.code == 1
    assert "its preset stays as it is" in capsys.readouterr().err
    assert not (pretended / "presets").exists()


def test_a_study_that_was_interrupted_ends_trial_by_trial_as_if_it_had_not_been(pretended, monkeypatch):
    asked = study_file.read("followers", ("pid",), 48)

    def trials(folder):
        task = replace(asked.searches["pid"], url=str(pretended / folder / "pid" / storage.JOURNAL), name="pid")
        return [(t.params, t.values, t.user_attrs.get("ms")) for t in done(task.open())]

    searches.carry_out(asked, pretended / "whole", threads=1)
    calls, one = [], study.RollOuts.one

    def killed(self, trial):
        calls.append(trial.number)
        if len(calls) == 37:  # amid the last stage
            raise KeyboardInterrupt
        one(self, trial)

    monkeypatch.setattr(study.RollOuts, "one", killed)
    with pytest.raises(KeyboardInterrupt):
        searches.carry_out(asked, pretended / "halves", threads=1)
    assert len(trials("halves")) == 36
    searches.carry_out(asked, pretended / "halves", threads=1, resume=True)
    assert len(trials("whole")) == 48
    assert trials("halves") == trials("whole")


def test_stages_are_optunas_samplers_one_after_the_other():
    """The same search, written out with the library alone."""
    task = replace(FOLLOWERS["pid"], trials=36)
    space, cap = task.space, task.limits.ms

    def cost(params, weight):
        away = sum((axis.encode(params[axis.name]) - 0.4) ** 2 for axis in space.axes)
        return math.log(1.0 + away) + weight * max(0.0, math.log(params["law.kp"] / 60.0 / (0.98 * cap)))

    expected = []
    for i, weight in enumerate((2.0, 12.0, 12.0)):
        if i:
            best = min(expected, key=lambda p: (p[1], p[2]))[0]
            sampler = optuna.samplers.CmaEsSampler(x0=best, sigma0=(0.1, 0.25)[i - 1], seed=i - 1)
        else:
            sampler = optuna.samplers.TPESampler(seed=0, multivariate=True, n_startup_trials=30)
        plain = optuna.create_study(sampler=sampler)
        if not i:
            plain.enqueue_trial({axis.name: space.start[axis.name] for axis in space.axes})
        plain.optimize(lambda trial, weight=weight: cost(space.suggest(trial), weight), n_trials=12)
        for t in plain.trials:
            value = math.exp(cost(t.params, 0.0))
            expected.append((t.params, value if t.params["law.kp"] / 60.0 <= 1.005 * cap else math.inf, t.value))
    found = optuna.create_study(sampler=staged.Staged(task.stages, space, 0, 36, cap))
    for _ in range(36):
        trial = found.ask()
        params = space.suggest(trial)
        trial.set_user_attr("ms", params["law.kp"] / 60.0)
        found.tell(trial, math.exp(cost(params, 0.0)))
    assert [t.params for t in found.trials] == [params for params, _, _ in expected]


@pytest.mark.parametrize("name", ["bounded", "nelder-mead"])
def test_a_stage_asks_for_the_points_that_scipys_minimiser_asks_for(name):
    names = ("law.velocity", "law.acceleration")[-1 if name == "bounded" else 0 :]
    space, asked = spaces.space(get("wu-stiff"), names), []

    def value(x):
        asked.append(np.atleast_1d(x).tolist())
        return 3.0 + sum((axis.encode(each) - 0.3) ** 2 for axis, each in zip(space.axes, asked[-1], strict=True))

    bounds = [(axis.low, axis.high) for axis in space.axes]
    if name == "bounded":
        optimize.minimize_scalar(value, bounds=bounds[0], method="bounded")
    else:
        start = [space.start[each] for each in names]
        optimize.minimize(value, start, method="Nelder-Mead", bounds=bounds, options={"xatol": 1e-4, "fatol": 1e-3})
    expected, many = list(asked), min(len(asked), 12)
    found = optuna.create_study(sampler=staged.Staged((staged.Stage(name),), space, 0, many, math.inf))
    for _ in range(many):
        trial = found.ask()
        found.tell(trial, value(list(space.suggest(trial).values())))
    assert [list(t.params.values()) for t in found.trials] == expected[:many]


def test_joint_metrics_are_the_geometric_mean_of_all_or_the_worst_of_them():
    figures = {
        "a": {"dross": np.array([2.0]), "energy": np.array([1.0])},
        "b": {"dross": np.array([0.5]), "energy": np.array([4.0])},
    }
    logs = np.log([2.0, 0.5, 1.0, 4.0])
    assert goals.score("mean of dross, energy", figures, ("a", "b")) == pytest.approx(math.sqrt(2.0))
    worst = goals.score("worst of dross, energy", figures, ("a", "b"))
    assert worst == pytest.approx(4.0 * math.exp(0.01 * logs.mean()))
    with pytest.raises(InvalidInput, match="of joint metrics less is better, of through more"):
        goals.metric("mean of dross, through", True)


def test_figures_relative_to_a_controller_are_ratios_of_means_and_its_own_are_one():
    plain, other = team("huang2024-dynamic"), team("recipe")
    wanted, seeds = ("dross", "time", "collision"), range(2)
    of_plain, of_other = (evaluate.Evaluator(c, "cutting", seeds).part(0, c, wanted) for c in (plain, other))
    relative = evaluate.Evaluator(other, "cutting", seeds, relative=plain)
    for controller, expected in ((plain, dict.fromkeys(wanted[:2], 1.0)), (other, None)):
        (name, found), *_ = relative.part(0, controller, wanted).items()
        for metric in wanted[:2]:
            ratio = expected or {m: of_other[name][m].mean() / of_plain[name][m].mean() for m in wanted[:2]}
            assert found[metric] == [ratio[metric]]
        assert len(found["collision"]) == 2  # counted, not divided


def test_a_tied_parameter_has_the_value_of_the_other_and_no_axis_of_its_own():
    found = spaces.space(get("huang2024-tuned"), ["law.x=0.1..0.3", "law.y=law.x"])
    assert [axis.name for axis in found.axes] == ["law.x"]
    assert found.values({"law.x": 0.2}) == {"law.x": 0.2, "law.y": 0.2}
    with pytest.raises(InvalidInput, match=r"'law\.y=law\.x': the first is searched, too, or the second is not"):
        spaces.space(get("huang2024-tuned"), ["law.z", "law.y=law.x"])


def test_a_fresh_search_begins_with_what_the_law_declares_and_the_rest_of_the_controller():
    (base,) = study_file.read("process").searches["huang2024-adjusting"].base.stacks
    assert base.part("law") == type(base.part("law"))()
    assert base.part("plan") == get("huang2024-adjusting").part("plan")
    assert base.part("law") != get("huang2024-adjusting").part("law")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("metrik = 'jitter'\n[search]\npid = {}", "unknown key 'metrik'; did you mean 'metric'?"),
        ("metric = 'jiter'\n[search]\npid = {}", "search.pid: unknown metric 'jiter'; did you mean 'jitter'?"),
        ("[search]\npidd = {}", "search.pidd: unknown controller 'pidd'; did you mean 'pid'?"),
        ("[search]\npid = {wat = ['law']}", "search.pid: unknown key 'wat'; did you mean 'what'?"),
        (
            "[search]\npid = {what = ['law.kpp']}",
            "search.pid: .*nothing called 'law.kpp' to tune; did you mean",
        ),
        ("trials = 'many'\n[search]\npid = {}", "trials is 'many'"),
        ("[ranges]\n'law.kp' = [1]\n[search]\npid = {}", "a range has two ends"),
        ("[[stage]]\nsampler = 'tp'\n[search]\npid = {}", "unknown sampler 'tp' of a stage; did you mean 'tpe'?"),
        ("presets = true\n[search]\npid = {}", "presets: those of the package are made by its own studies"),
        ("like = 'folowers'", "no shipped study 'folowers'; did you mean 'followers'?"),
        ("like = 'followers'\nwithout = ['pidd']", "unknown search 'pidd'; did you mean 'pid'?"),
        ("[search]\npid = {set = {'law.kp' = {gain_margn = 2.0}}}", "no such rule; did you mean 'gain_margin'?"),
        ("[search]\npid = {relative = 'evil.py:Law'}", "search.pid is 'evil.py:Law': that is Python code"),
        ("[search]\npid = {metric = 'mean of jitter, rms_tru'}", "unknown metric 'rms_tru'; did you mean 'rms_true'?"),
        ("[search]\npid = {stage = [{sampler = 'bounded'}]}", "a stage with sampler bounded takes one number"),
        ("[search]\nmine = {controller = 'evil.py:Law'}", "search.mine is 'evil.py:Law': that is Python code"),
        ("trials = 9", "no search; it needs a table such as"),
    ],
)
def test_a_study_file_that_cannot_be_carried_out_says_where_and_what_is_allowed(here, text, says):
    (here / "mine.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput, match=f"mine.*{says}"):
        searches.carry_out(study_file.read("mine.toml"), here / "runs" / "a")
    assert not (here / "runs").exists()


def test_a_study_says_itself_what_an_option_would_say(here, capsys):
    with pytest.raises(SystemExit):
        main(["tune", "--study", "followers", "--ms", "3"])
    assert "--ms is not given beside --study" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["tune", "pidd", "--study", "followers"])
    assert "unknown search 'pidd'; did you mean 'pid'?" in capsys.readouterr().err


def test_several_caps_make_several_searches_side_by_side(pretended):
    asked = study_file.read("caps", ("pid",), 12)
    assert {name: task.limits.ms for name, task in asked.searches.items()} == {
        "pid-ms-2": 2.0,
        "pid-ms-3.3": 3.3,
        "pid-ms-inf": math.inf,
    }
    found = searches.carry_out(asked, pretended / "caps", threads=1).set_index("search")
    gains = [json.loads(words)["law.kp"] for words in found["parameters"]]
    assert gains == sorted(gains)  # a looser cap allows more
    assert (found["ms"] <= found["cap"]).all()


def test_what_the_searches_of_a_study_found_is_a_table_with_units(capsys):
    row = {
        "controller": "pid",
        "rms_true_test": 13.6967,
        "collisions_test": 0,
        "jitter_test": 0.365432,
        "trials": 6,
        "simulated_steps": 5_376_000,
        "cpu_seconds": 1.76,
        "parameters": "{}",
        "sampler": "tpe",
        "tune_seeds": "0-1",
    }
    found = [{**row, "search": "pid-ms-2", "cap": 2.0, "ms": 1.8}, {**row, "search": "pid", "cap": np.inf, "ms": None}]
    searches.show(pd.DataFrame(found))
    told = capsys.readouterr().out
    assert all(title in told for title in ("Ms at most", "rms_true, µm", "CPU-s", "10,752,000 simulated steps"))
    limited, free = (line.split("│")[1:-1] for line in told.splitlines() if line.startswith("│"))
    assert [cell.strip() for cell in limited] == ["pid-ms-2", "2", "13.7", "0.3654", "1.8", "6", "5,376,000", "2"]
    assert [cell.strip() for cell in free] == ["pid", "–", "13.7", "0.3654", "–", "6", "5,376,000", "2"]
