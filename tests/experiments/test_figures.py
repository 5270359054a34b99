"""Studies behind README and manual: stored with what they depend on, stale when that changes, shown as stored."""

import inspect
import json
import linecache
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.experiments.blame import shares as blame_tables
from kerfgym.experiments.blame.game import Blame
from kerfgym.experiments.manual import __main__ as command
from kerfgym.experiments.manual import docs, tables
from kerfgym.experiments.measure.grids import Grid
from kerfgym.experiments.store import imports, stamp, tabular
from kerfgym.experiments.store.plain import plain
from kerfgym.experiments.studies import agreement, marks, recorded, registry, stages, suites

SOURCE = '''"""Of a module."""

SPEED = 3.0  # mm/s
"""What it is."""


def law(x):
    """Of a function."""
    # why
    return "# no comment", x * SPEED
'''


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A package of two files, and an empty store."""
    (tmp_path / "laws").mkdir()
    (tmp_path / "laws" / "pid.py").write_text(SOURCE, encoding="utf-8")
    (tmp_path / "laws" / "pid.toml").write_text("gain = 3\n", encoding="utf-8")
    monkeypatch.setattr(stamp, "ROOT", tmp_path)
    monkeypatch.setattr(recorded, "FOLDER", tmp_path / "results")
    monkeypatch.setattr(registry.Study, "stamp", lambda self: stamp.stamp(self.depends))
    monkeypatch.setattr(suites, "RUN", ())
    monkeypatch.setattr(docs, "main", lambda: None)
    return tmp_path


def of(name, make, depends=("laws/*.py", "laws/*.toml")):
    return registry.Study(name, "a study", "kerfgym list", 1.0, depends, make)


# ------------------------------------------------------------------------------------- what depends on what


def test_words_about_a_source_change_no_result():
    other = (
        SOURCE.replace("Of a function.", "Of a law,\n    in two lines.")
        .replace("# why", "# because")
        .replace('"""What it is."""\n', "\n\n")
    )
    assert stamp.code(other) == stamp.code(SOURCE)
    assert '"# no comment"' in stamp.code(SOURCE)
    assert "# why" not in stamp.code(SOURCE)
    for before, after in (("3.0", "4.0"), ("x * SPEED", "x + SPEED"), ("# no comment", "# none")):
        assert stamp.code(SOURCE.replace(before, after)) != stamp.code(SOURCE)


def test_a_study_is_stale_when_a_file_that_it_depends_on_changes(place):
    one = of("one", lambda trial: {"numbers": {"a": 1.0}})
    assert one.outdated() == ["never run"]
    registry.run(one, 1)
    assert one.outdated() == []
    (place / "laws" / "pid.toml").write_text("gain = 4\n", encoding="utf-8")
    assert one.outdated() == ["laws/*.toml"]
    registry.run(one, 1)
    (place / "laws" / "lqg.py").write_text("", encoding="utf-8")  # a law more
    assert one.outdated() == ["laws/*.py"]


def test_a_study_that_measures_something_else_is_another():
    def function(number, words):
        exec(compile(source := f"def one(trial):\n    {words}\n    return {number}\n", "<study>", "exec"), space := {})
        linecache.cache["<study>"] = (len(source), None, source.splitlines(keepends=True), "<study>")
        return space["one"]

    first = stamp.said(function(1.0, '"""Of it."""'))
    assert stamp.said(function(1.0, "# in other words")) == first
    assert stamp.said(function(2.0, "# in other words")) != first


def test_a_file_can_be_left_out(place):
    assert stamp.files(("laws/*", "!laws/*.toml")) == {"laws/*": [place / "laws" / "pid.py"]}


def test_a_pattern_that_fits_nothing_is_an_error(place):
    with pytest.raises(InvalidInput, match=r"no file of the package fits 'lawz/\*\.py'"):
        stamp.stamp(("lawz/*.py",))


def test_every_study_depends_on_files_that_there_are():
    for each in registry.studies():
        assert each.stamp(), each.name
    assert {each.name for each in registry.studies()} >= {"following", "ood", "contour", "cutting", "blame", "speed"}


def test_what_a_module_imports_counts_however_it_is_written(tmp_path):
    sources = {
        "lab/__init__.py": "",
        "lab/study.py": "from . import grid\nfrom ..core.plant import step\n",
        "lab/grid.py": "def late():\n    from ..core import noise\n",
        "lab/report/page.py": "import secrets\n",
        "core/__init__.py": "",
        "core/plant.py": "import kerfgym.core.sheet\n",
        "core/noise.py": "import numpy\n",
        "core/sheet.py": "from ..lab.report import page\n",
        "core/unused.py": "",
    }
    for name, text in sources.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    found = imports.sources(tmp_path, [tmp_path / "lab" / "study.py"])
    assert [path.relative_to(tmp_path).as_posix() for path in found] == [
        "core/__init__.py",
        "core/noise.py",
        "core/plant.py",
        "core/sheet.py",
        "lab/__init__.py",
        "lab/grid.py",
        "lab/report/page.py",
        "lab/study.py",
    ]


@pytest.mark.parametrize(
    ("name", "files"),
    [
        (
            "following",
            {
                "measure.plants",
                "measure.margins",
                "measure.stability",
                "benchmark.benchmarking",
                "results.conclusions",
                "statistics.pooling",
                "statistics.comparison",
                "statistics.ranks",
            },
        ),
        ("ood", {"statistics.pooling", "statistics.comparison", "results.tasks", "measure.rollout"}),
        ("coverage", {"statistics.bootstrap", "statistics.intervals"}),
        ("filter-grid", {"studies.filter_grid", "tune.study", "measure.stability"}),
        ("blame", {"blame.game", "blame.shares"}),
        ("reproduction", {"reproduce.xi2023_table", "reproduce.claims", "measure.stability"}),
    ],
)
def test_a_study_depends_on_what_computes_its_figures(name, files):
    (one,) = registry.studies([name])
    named = [p for found in stamp.files(one.depends).values() for p in found if p.suffix == ".py"]
    entry = Path(inspect.getfile(one.make))
    found = imports.sources(stamp.ROOT, [entry, *named])
    assert {stamp.ROOT / "experiments" / f"{each.replace('.', '/')}.py" for each in files} <= set(found)
    assert stamp.ROOT / "experiments" / "report" / "page.py" not in found  # what shows numbers makes none
    simulates = stamp.ROOT / "envs" / "engine" / "lanes.py" in found
    assert simulates or name == "coverage"


def test_runs_are_made_anew_when_corner_plants_or_the_machine_change():
    found = imports.sources(stamp.ROOT, [stamp.ROOT / each for each in suites.RUN])
    names = {path.relative_to(stamp.ROOT).as_posix() for path in found}
    assert names >= {
        "experiments/measure/plants.py",
        "envs/engine/lanes.py",
        "envs/plant/machine.py",
        "envs/scenarios/preparing.py",
    }
    assert "experiments/report/terminal.py" not in names


@pytest.mark.parametrize(
    ("name", "cuts"),
    [("following", False), ("ood", False), ("faults", False), ("contour", True), ("cutting-parts", True)],
)
def test_readers_of_drawings_count_where_jobs_are_cut_and_nowhere_else(name, cuts):
    (one,) = registry.studies([name])
    named = {path.relative_to(stamp.ROOT).as_posix() for found in stamp.files(one.depends).values() for path in found}
    imported = imports.sources(stamp.ROOT, [stamp.ROOT / "envs" / "tasks" / "workshop.py"])
    assert not any("paths" in path.parts for path in imported)
    assert ("envs/paths/job.py" in named) == cuts


def test_an_unknown_study_is_an_error():
    with pytest.raises(InvalidInput, match="no study 'folowing'; did you mean 'following'"):
        registry.studies(["folowing"])


def test_every_stored_result_is_of_a_study_and_says_where_it_comes_from():
    known = {each.name for each in registry.studies()}
    for path in recorded.FOLDER.glob("*.json"):
        found = recorded.read(path.stem)
        assert path.stem in known
        assert found["study"] == path.stem
        assert {"command", "kerfgym", "commit", "committed", "depends", "numbers", "seeds"} <= set(found)


# ------------------------------------------------------------------------------------- what is stored, shown


def test_a_number_is_shown_as_it_is_stored(place):
    registry.run(
        of("one", lambda trial: {"numbers": {"pid": {"score": 9.7654321, "failed": None, "room": float("inf")}}}), 1
    )
    text = "<!-- n: one.pid.score -->?<!-- /n --> µm, <!-- n: one.pid.score .1f --><!-- /n -->"
    shown = marks.filled(text)
    assert shown == "<!-- n: one.pid.score -->9.77<!-- /n --> µm, <!-- n: one.pid.score .1f -->9.8<!-- /n -->"
    assert marks.filled(shown) == shown
    assert marks.filled("<!-- n: one.pid.room --><!-- /n -->").count("∞") == 1
    assert marks.filled("<!-- n: two.pid --><!-- /n -->") == "<!-- n: two.pid -->(not measured yet)<!-- /n -->"
    with pytest.raises(InvalidInput, match=r"README\.md: results of 'one\.pid' have no 'scor'; did you mean 'score'"):
        marks.filled("<!-- n: one.pid.scor --><!-- /n -->", "README.md")
    with pytest.raises(InvalidInput, match="is a table, not a number"):
        marks.filled("<!-- n: one.pid --><!-- /n -->")
    with pytest.raises(InvalidInput, match="'2q' is no form of a number"):
        marks.filled("<!-- n: one.pid.score 2q --><!-- /n -->")


@pytest.mark.parametrize(
    ("claim", "why"),
    [
        ("one.pid.score < one.lqg.score", ""),
        ("one.lqg.score > 9", ""),
        ("one.pid.budget = larger", ""),
        ("one.pid.room > one.pid.score", ""),
        ("one.pid.score > one.lqg.score", "it is 8 and 9.5"),
        ("one.pid.score > 8", "it is 8 and 8.0"),
        ("one.pid.budget = none", "it is larger and none"),
        ("one.pid.failed > 0", "it is None and 0.0"),
        ("one.pdi.score < 9", "did you mean 'pid'"),
        ("two.pid.score < 9", "it is None and 9.0"),
    ],
)
def test_a_claim_that_is_no_longer_so_is_found(place, claim, why):
    pid = {"score": 8.0, "budget": "larger", "failed": None, "room": float("inf")}
    registry.run(of("one", lambda trial: {"numbers": {"pid": pid, "lqg": {"score": 9.5}}}), 1)
    found = marks.broken(f"It is so. <!-- holds: {claim} -->\n")
    assert found == [] if not why else why in found[0]


@pytest.mark.parametrize(
    ("value", "form", "text"),
    [
        (-0.5, ".2f", "−0.50"),
        (0.237, ".0%", "24 %"),
        (1234567.0, ".3g", "1230000"),
        (None, ".3g", "–"),
        (3, ".3g", "3"),
    ],
)
def test_numbers_are_written_for_readers(value, form, text):
    assert marks.written(value, form) == text


def test_a_page_is_stale_when_stored_results_are_not_what_it_shows(monkeypatch):
    page = docs.README.read_text(encoding="utf-8")
    assert docs.filled(page, "README.md") == page
    found = recorded.read("following")
    found["sheets"][0]["sections"][0][0][2] = "0.01"  # the first score
    monkeypatch.setattr(recorded, "read", lambda name: found)
    assert "| 0.01 |" in docs.filled(page, "README.md")


def test_a_column_that_a_table_has_no_more_is_an_error():
    with pytest.raises(InvalidInput, match="the table of 'following' has no column 'scor'; did you mean 'score"):
        tables.columns(recorded.read("following"), ("controller", "scor"))


def test_results_of_another_form_ask_to_be_made_anew(monkeypatch):
    monkeypatch.setattr(recorded, "read", lambda name: {"study": name, "numbers": {}, "sheets": []})
    with pytest.raises(InvalidInput, match=r"make them anew: python -m kerfgym\.experiments\.manual calibration"):
        tables.MADE["calibration"]()


def test_a_table_that_nobody_has_measured_says_how(monkeypatch):
    monkeypatch.setattr(recorded, "read", lambda name: None)
    assert tables.MADE["speed"]() == "*Not measured yet: `python -m kerfgym.experiments.manual speed` does it.*\n"


def test_new_results_are_compared_with_those_before():
    before, after = ({"numbers": {"a": x, "b": {"c": [1.0, 2.0]}, "d": "x"}} for x in (1.0, 1.1))
    assert recorded.differences(before, after) == (4, 1)
    assert recorded.differences(before, before) == (4, 0)
    assert recorded.differences(None, after) == (4, 4)


def controllers(ratios, information="sensor"):
    return {
        name: {"information": information, "rank": rank, "score": 20.0 / ratio, "ratio": ratio}
        for name, ratio in ratios.items()
        for rank in (1 + sum(other > ratio for other in ratios.values()),)
    }


def test_suites_agree_if_order_and_ratios_of_the_first_five_do():
    ratios = {"a": 6.0, "b": 5.0, "c": 4.0, "d": 3.0, "e": 2.0, "f": 1.0}
    seer = controllers({"seer": 30.0}, "preview")
    same = agreement.compared(controllers(ratios) | seer, controllers({n: r / 1.4 for n, r in ratios.items()}))
    assert (same["order"], same["ratios"], list(same["rows"])) == ("yes", "yes", ["a", "b", "c", "d", "e"])
    assert same["farthest"] == pytest.approx(1.4)
    far = agreement.compared(controllers(ratios), controllers({**ratios, "e": 1.2}))
    assert (far["order"], far["ratios"], far["rows"]["e"]["quotient"]) == ("yes", "no", pytest.approx(2.0 / 1.2))
    turned = agreement.compared(controllers(ratios), controllers({**ratios, "a": 4.9}))
    assert (turned["order"], turned["ratios"]) == ("no", "yes")
    assert (turned["rows"]["a"]["there"], turned["rows"]["b"]["there"]) == (2, 1)
    tied = controllers({**ratios, "a": 4.9})
    tied["a"]["rank"] = 1
    assert agreement.compared(controllers(ratios), tied)["order"] == "yes"
    without = agreement.compared(controllers(ratios), {n: r for n, r in controllers(ratios).items() if n != "b"})
    assert (without["order"], without["ratios"], without["rows"]["b"]["there"]) == ("no", "no", None)


def test_the_tables_of_blame_are_made_of_what_blame_gives(monkeypatch, tmp_path):
    blamed = Blame(
        "wavy",
        "pid",
        "gap",
        (1, 2, 3),
        ("sensor",),
        np.array([[4.0, 5.0, 6.0], [1.0, 2.0, 1.0]]),
        {"oracle": np.array([1.0, 1.5, 1.2])},
    )
    frames = blame_tables.shares([blamed]), blame_tables.headroom([blamed])
    for i, frame in enumerate(frames):  # a report reads them back, words and all
        frame.to_parquet(tmp_path / f"{i}.parquet")
        assert tabular.read_parquet(tmp_path / f"{i}.parquet").equals(frame)
    numbers = {"shares": stages.nested(frames[0], "stage"), "headroom": stages.nested(frames[1], "informed")}
    body = {"command": "c", "kerfgym": "0", "numbers": plain(numbers)}
    monkeypatch.setattr(recorded, "read", lambda name: body)
    assert "| `pid` | wavy | 2.2 | `oracle` | 1.1 |" in tables.MADE["headroom"]()
    assert "| `pid` | wavy |" in tables.MADE["blame"]()


# ------------------------------------------------------------------------------------- the command


def test_a_study_that_fails_does_not_stop_the_others(place, monkeypatch, capsys):
    def broken(trial):
        raise RuntimeError("the disk is full")

    known = [of("first", broken), of("second", lambda trial: {"numbers": {"a": 2.0}})]
    monkeypatch.setattr(command, "studies", lambda names=(): [s for s in known if not names or s.name in names])
    assert command.main(["--stale"]) == 1
    printed = capsys.readouterr()
    assert "failed: RuntimeError: the disk is full" in printed.out
    assert "failed: first; the same command" in printed.err
    assert recorded.read("first") is None
    assert recorded.number("second.a") == 2
    monkeypatch.setattr(command, "run", lambda each, *_: pytest.fail(f"{each.name} was not stale"))
    assert command.main(["second", "--stale", "--except", "first", "--except", "second"]) == 0
    assert command.main(["--list"]) == 1
    assert "never run" in capsys.readouterr().out
    assert command.main(["--stale", "--except", "first"]) == 0  # the second is as old as the code


def test_a_run_that_was_made_from_the_same_is_read_back(place, monkeypatch):
    monkeypatch.chdir(place)
    monkeypatch.setattr("kerfgym.experiments.report.page.write_report", lambda *_: None)  # has tests of its own
    tiny = scenarios.load("tilt").varied(duration=0.5)
    trial = registry.Trial(of("tiny", None), 1)
    grid = Grid("following", ("xi2023-tuned", "pid"), (tiny,), (1000, 1001), ("tilt",))

    def made(what=grid):
        return suites.benchmarked(trial, what, ["kerfgym", "list"], with_ms=False, quiet=True)

    first = plain(suites.concluded(made()))
    runs = trial.folder / "runs.parquet"
    age = runs.stat().st_mtime_ns
    assert plain(suites.concluded(made())) == first
    assert runs.stat().st_mtime_ns == age
    pid = first["numbers"]["pid"]
    assert pid["ratio"] == pytest.approx(first["numbers"]["xi2023-tuned"]["score"] / pid["score"], 1e-5)
    assert pid["rms"]["tilt"] == pid["score"]
    assert [row[0] for row in first["sheets"][0]["sections"][0]] == ["pid", "xi2023-tuned"]
    (place / "laws" / "pid.toml").write_text("gain = 4\n", encoding="utf-8")
    made()
    assert runs.stat().st_mtime_ns > age
    assert made(replace(grid, seeds=(1000, 1002))).meta["seeds"] == "1000-1002"
    assert made(replace(grid, scenarios=(tiny.varied(name="other"),))).scenarios == ["other"]


def test_what_is_stored_is_json(place):
    body = plain({"a": float("nan"), "b": float("-inf"), "c": 1.23456789, "d": (True, SimpleNamespace(x=1))})
    assert json.loads(json.dumps(body)) == body
    assert body == {"a": None, "b": "-inf", "c": 1.23457, "d": [True, "namespace(x=1)"]}
