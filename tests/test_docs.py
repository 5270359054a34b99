"""The manual: made pages are as old as the code, links lead somewhere, every block of code does what it says."""

import importlib.util
import inspect
import pkgutil
import re
import shlex
import shutil
import tomllib
from functools import wraps
from pathlib import Path

import pytest
import tyro

import kerfgym
from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.figures import job_metrics, metrics, registered
from kerfgym.envs.scenarios import machines
from kerfgym.experiments import cli
from kerfgym.experiments.manual import docs
from kerfgym.experiments.tune import study_file

ROOT = Path(kerfgym.__file__).parent
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(docs.FOLDER.glob("*.md"))]
HEAVY = {
    "first-minutes-learning.md": {
        "num_envs=1024": "num_envs=8",
        "HeightFollowingVecEnv(256,": "HeightFollowingVecEnv(4,",
        "n_steps=64": "n_steps=8",
        "batch_size=512": "batch_size=16",
        "learn(1_000_000)": "learn(64)",
    }
}
"""What is made smaller in blocks that are run, by page; each is there."""

RUN = {
    "benchmark": ["--seeds", "2", "--jobs", "1", "--no-ms", "--no-cost", "--no-blame", "--no-detuned"],
    "render": [],
    "list": [],
}
"""Commands that are run if the files that they name are there, and with what; all others are only read."""

BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def blocks(page, *languages):
    return [text for language, text in BLOCK.findall(page.read_text(encoding="utf-8")) if language in languages]


def commands(page):
    """Lines of shell blocks, as words."""
    for block in blocks(page, "", "bash"):
        for line in block.splitlines():
            yield shlex.split(line, comments=True)


def files(text):
    """``# name`` in the first line of a block: the file that it is."""
    found = re.match(r"# (\w+\.(?:py|toml))\n", text)
    return found[1] if found else None


# ----------------------------------------------------------------------------------------------------------- made pages


def test_made_pages_are_as_old_as_the_code():
    assert not [path.name for path in docs.stale()], "python -m kerfgym.experiments.manual.docs writes them"


def test_an_edit_of_the_code_makes_its_page_stale(monkeypatch):
    page = (docs.FOLDER / "add-a-metric.md").read_text(encoding="utf-8")
    assert docs.filled(page) == page
    found = metrics.METRICS["rms_true"]
    monkeypatch.setitem(metrics.METRICS, "rms_true", registered.Metric("rms_true", "inch", "lower", "", found.function))
    assert docs.filled(page) != page


def test_a_mark_that_nothing_makes_is_an_error():
    with pytest.raises(InvalidInput, match=r"page\.md: nothing makes 'weather'; known: controllers"):
        docs.filled("<!-- made: weather -->\n<!-- end -->", "page.md")


def test_docstrings_become_markdown():
    text = """Two laws.

    As in :func:`~envs.plant.filters.take`, ``y += x``::

        a = b

    =====  ====
    kind   what
    =====  ====
    none   ``x``
    =====  ====
    """
    assert docs.markdown(text) == (
        "Two laws.\n\nAs in `envs.plant.filters.take`, `y += x`:\n\n```text\na = b\n```\n\n"
        "| kind | what |\n| --- | --- |\n| none | `x` |\n"
    )


def test_behind_a_block_of_code_in_an_item_of_a_list_the_item_s_text_goes_on():
    text = """Laws:

    * the first is::

          a = b

      where ``b`` is known.
    * the second
    """
    assert docs.markdown(text) == (
        "Laws:\n\n* the first is:\n\n```text\na = b\n```\n\n  where `b` is known.\n* the second\n"
    )


def test_every_number_of_the_machine_is_in_its_page():
    text = (docs.FOLDER / "machine.md").read_text(encoding="utf-8")
    for part in docs.SIGNAL_CHAIN:
        assert f"`envs/plant/{part}.py`" in text
    for words in ("rad/s, velocity loop, 2π·80 Hz [A] 50–200 Hz", "ms, gate length", "0.05 to 1 ms"):
        assert words in text
    everything = (docs.FOLDER / "environments.md").read_text(encoding="utf-8")
    for heading in ("Action Space", "Observation Space", "Rewards", "Starting State", "Episode End", "Arguments"):
        assert everything.count(f"### {heading}") == 3, heading


# ---------------------------------------------------------------------------------------------------------------- links


def anchor(heading):
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if "://" in target:
            continue
        name, _, place = target.partition("#")
        path = (page.parent / name).resolve() if name else page
        assert path.exists(), target
        if place:
            headings = re.findall(r"(?m)^#+ (.*)$", path.read_text(encoding="utf-8"))
            assert place in map(anchor, headings), target


# ------------------------------------------------------------------------------------------------------------- commands


def read(words, tell):
    """Reads the words of a command as the command itself does, without doing it; tells its arguments."""

    def stub(name, function):
        @wraps(function)
        def told(**given):
            bound = inspect.signature(function).bind(**given)
            bound.apply_defaults()
            tell(name, bound.arguments)

        return told

    stubs = {name: stub(name, function) for name, function in cli.COMMANDS.items()}
    tyro.extras.subcommand_cli_from_dict(stubs, prog="kerfgym", args=words)


def check(name, given):
    """Names of controllers, scenarios, suites and metrics exist, as far as they are the package's own."""
    own = ("mine", "my_", "runs/", "part")
    asked = given.get("controller") or []
    for spec in [asked] if isinstance(asked, str) else asked:
        if not any(word in spec for word in own):
            (stack.team if stack.is_team(spec) else stack.resolve)(spec)
    asked = given.get("scenario") or []
    for spec in [asked] if isinstance(asked, str) else asked:
        if not spec.startswith(own):
            scenarios.load(spec)
    suites = given.get("suite") or []
    for suite in [suites] if isinstance(suites, str) else suites:
        if not suite.startswith(own):
            scenarios.suite(suite)
    machine = given.get("machine")
    if machine and not machine.startswith(own):
        machines.load(machine)
    for metric in given.get("metric") or []:
        assert metric in {**metrics.METRICS, **job_metrics.METRICS}, (name, metric)


def runs(module):
    """Whether ``python -m`` runs it: it is there, and a package has a ``__main__``."""
    found = importlib.util.find_spec(module)
    return bool(found and (not found.submodule_search_locations or importlib.util.find_spec(f"{module}.__main__")))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_file_and_module_that_a_sentence_names_is_there(page):
    made = r"(?ms)^```.*?^```$|^\*`.*?$|^Made by .*?$"  # blocks, and what stored runs say of the version that made them
    spans = re.findall(r"`([^`\n]+)`", re.sub(made, "", page.read_text(encoding="utf-8")))
    for span in spans:
        if re.fullmatch(r"(envs|baselines|agents|experiments|tests|docs)/[\w./-]*", span):
            assert (ROOT / span).exists() or span == "baselines/mine.py", span  # the recipe's own
        elif re.fullmatch(r"kerfgym(\.\w+)+", span):
            assert pkgutil.resolve_name(span), span
        elif script := re.match(r"python -m (kerfgym[\w.]*)(?= |$)", span):
            assert runs(script[1]), span


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_is_one(page, capsys):
    seen = 0
    for words in commands(page):
        if not words:
            continue
        seen += 1
        if words[0] == "kerfgym":
            try:
                read(words[1:], check)
            except SystemExit as error:
                pytest.fail(f"{' '.join(words)}: {error} {capsys.readouterr()}")
        elif words[0] == "make":
            assert re.search(rf"(?m)^{words[1]}:", (ROOT / "Makefile").read_text(encoding="utf-8")), words
        elif words[:2] == ["python", "-m"]:
            assert runs(words[2]), words
        else:
            assert words[0] in ("tensorboard", "git", "cd"), words
    assert seen or page.name not in ("controllers.md", "add-a-controller.md")


def test_a_command_that_is_none_would_be_noticed(capsys):
    with pytest.raises(SystemExit):
        read(["benchmark", "--colour", "red"], check)
    with pytest.raises(InvalidInput, match="did you mean 'pid'"):
        read(["benchmark", "-c", "pidd"], check)
    assert "colour" in capsys.readouterr().err


# ----------------------------------------------------------------------------------------------------------------- code


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder of the user's, in which a policy was trained and a sheet measured."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "agents" / "trained" / "height-following-ppo", tmp_path / "runs" / "ppo" / "policy")
    (tmp_path / "measured.csv").write_text("position_mm,height_mm\n0,0\n100,0.2\n200,0\n", encoding="utf-8")
    monkeypatch.setattr("kerfgym.experiments.report.page.write_report", lambda *_: None)  # has tests of its own
    kept = dict(metrics.METRICS)
    yield tmp_path
    metrics.METRICS.clear()
    metrics.METRICS.update(kept)


def ready(words, folder):
    """Whether a command is run here: it is quick, and the files that it names are there."""
    named = [word.split(":")[0] for word in words if re.search(r"\.(py|toml)\b|^runs/", word)]
    return words[0] == "kerfgym" and words[1] in RUN and named and all((folder / name).exists() for name in named)


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python", "toml")], ids=lambda page: page.name)
def test_every_block_of_code_runs(page, place, capsys):
    space = {"__name__": "__main__"}
    text, smaller = page.read_text(encoding="utf-8"), HEAVY.get(page.name, {})
    assert all(old in text for old in smaller), "HEAVY names what is no longer there"
    for language, block in BLOCK.findall(text):
        name = files(block)
        if name:
            (place / name).write_text(block, encoding="utf-8")
        if language == "toml":
            if "search" in tomllib.loads(block):
                (place / "study.toml").write_text(block, encoding="utf-8")
                study_file.read(str(place / "study.toml"))
            else:
                scenarios.parse(block)
        elif language == "python":
            for old, new in smaller.items():
                block = block.replace(old, new)
            exec(compile(block, f"{page.name}: {block.splitlines()[0]}", "exec"), space)
        elif language in ("", "bash") and page.name != "README.md":
            for words in (shlex.split(line, comments=True) for line in block.splitlines()):
                if words and ready(words, place):
                    cli.main([*words[1:], *(RUN[words[1]])])
    if page.name == "add-a-controller.md":
        printed = capsys.readouterr().out
        assert re.search(r"mine\.py:Mine\W+\d", printed)  # with a rank
        assert "not ranked: mine_law.py:Law:law.gain=90: changed by hand" in printed
