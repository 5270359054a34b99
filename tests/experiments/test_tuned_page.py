"""The page of a search: what its first screen says, of results, of warnings, of searches that found nothing."""

import html
import re
import tomllib
from pathlib import Path

import pytest

from kerfgym.experiments.cli import main
from kerfgym.experiments.measure import population

MACHINE = """
summary = "a drive that is known by two numbers together"
[axis]
bandwidth = { choice = [55.0, 60.0, 65.0], joint = "motion" }
dead_time = { choice = [0.0012, 0.0011, 0.001], joint = "motion" }
"""

QUICK = ["--trials", "4", "--seeds", "2", "--threads", "1", "--overwrite"]


def text_of(page):
    """What a reader sees of the first screen, and the whole file."""
    whole = Path(page).read_text(encoding="utf-8")
    first = whole[whole.index("<header") : whole.index("</header>")]
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", " ", first))), whole


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("pages")


@pytest.fixture
def place(folder, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "mine.toml").write_text(MACHINE, encoding="utf-8")
    return folder


def test_the_first_screen_says_machine_sheets_what_to_set_and_what_it_is_worth(place, capsys):
    main(["tune", "law.kp", "filter.jump", "-c", "pid", "--machine", "mine.toml", "-s", "step", *QUICK, "--name", "a"])
    printed = capsys.readouterr().out
    first, whole = text_of("runs/a/tuned.html")
    tuned = tomllib.loads((place / "runs/a/tuned.toml").read_text(encoding="utf-8"))
    assert "mine, a drive that is known by two numbers together" in first
    assert "each seed draws another one that its file allows" in first
    assert "step (twelve steps of 0.1 to 0.4 mm" in first
    assert "least following error with Ms ≤ 2 and no collision" in first
    for name, unit in (("law.kp", "1/s"), ("filter.jump", "mm")):
        assert re.search(rf"{name} \S+ {tuned['parameters'][name]:.5g} {unit} \+?[−\d.]+ %, Ms \d", first), name
    assert re.search(r"following error µm [\d.]+ [\d.]+–[\d.]+ [\d.]+", first)
    assert f"Margins on {population.DRAWN} machines drawn from mine" in first
    assert f"Ms ≤ 2 of {population.DRAWN}" in first
    assert "record a follow log, and compare" in first
    assert "law.limit" in whole  # which was not searched
    assert "<script" not in whole
    assert not re.search(r'(src|href)="(?!#|data:)', whole)
    assert re.search(r"law\.kp +│ 1/s +│", printed)
    assert re.search(r"rms_true, test seeds +│ µm +│ +[\d.]+ \([\d.]+–[\d.]+\)", printed)
    assert f"margins on {population.DRAWN} machines: Ms" in printed
    assert printed.rstrip().endswith(str(Path("runs/a/tuned.html")))
    spent = (place / "runs/a/run.json").read_text(encoding="utf-8")
    assert '"margins"' in spent
    assert (place / "runs/a/margins.csv").read_text(encoding="utf-8").count("\n") == 1 + 2 * population.DRAWN


def test_where_nothing_keeps_the_limits_the_page_says_what_comes_nearest(place, capsys):
    words = ["tune", "law.kp=70..71", "-c", "pid:law.kp=70", "-s", "step", *QUICK, "--ms", "1.1", "--name", "b"]
    with pytest.raises(SystemExit):
        main(words)
    told = capsys.readouterr().err
    assert "no trial keeps all limits" in told
    assert f"{Path('runs/b/tuned.html')} shows the nearest" in told
    first, _ = text_of("runs/b/tuned.html")
    assert "Nothing that was tried keeps all limits, so there is nothing to set." in first
    assert re.search(r"law\.kp 70 7[01]\S* 1/s", first)
    assert re.search(r"Ms ≤ 1.1: [\d.]+ times what is allowed", first)
    assert not (place / "runs/b/tuned.toml").exists()


def test_a_search_of_jobs_has_no_margins_and_says_on_what_its_figures_stand(place):
    main(["tune", "law.kp", "-s", "contour-square", *QUICK, "--name", "c"])
    first, _ = text_of("runs/c/tuned.html")
    assert "contour error" in first
    assert "Margins" not in first
    assert "Figures of the cut: " in first


def test_a_front_shows_its_members_and_says_that_the_middle_is_above(place):
    main(["tune", "law", "-c", "pid", "-s", "step", "-m", "rms_true", "-m", "jitter", *QUICK, "--trials", "12",
          "--name", "d"])  # fmt: skip
    first, whole = text_of("runs/d/tuned.html")
    members = len(list((place / "runs/d/front").glob("*.toml"))) if (place / "runs/d/front").is_dir() else 1
    assert whole.count("front/0") == (members if members > 1 else 0)
    assert "following error" in first
    assert "command jitter" in first
    assert "from the middle of the front" in first


def test_what_a_name_holds_is_shown_and_not_run(place):
    hostile = '<img src=x onerror="alert(1)">'
    (place / "bad.toml").write_text(f"summary = '{hostile}'\n[axis]\nbandwidth = 60.0\n", encoding="utf-8")
    main(["tune", "law.kp", "-c", "pid", "--machine", "bad.toml", "-s", "step", *QUICK, "--trials", "2", "--name", "e"])
    first, whole = text_of("runs/e/tuned.html")
    assert hostile not in whole
    assert hostile in first


def test_a_setting_that_the_filter_does_not_read_is_warned_of(place, capsys):
    main(["tune", "filter.window", "law.kp", "-c", "pid", "-s", "step", *QUICK, "--trials", "2", "--name", "g"])
    told = capsys.readouterr().err
    assert (
        "warning: filter.window changes nothing: a filter of the kind anti-impulse reads filter.jump, filter.hold; "
        "'read' searches what it reads"
    ) in told
    main(["tune", "read", "-c", "pid", "-s", "step", *QUICK, "--trials", "2", "--name", "h"])
    main(["tune", "filter", "-c", "pid", "-s", "step", *QUICK, "--trials", "2", "--name", "i"])
    assert "changes nothing" not in capsys.readouterr().err
