"""What readers are promised of README and manual: short, complete, and recipes that work when they are followed."""

import ast
import os
import re
import shutil
import subprocess
import sys
import textwrap
import types
from pathlib import Path

import pytest

import kerfgym
from kerfgym import baselines
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.figures import job_metrics
from kerfgym.experiments import cli
from kerfgym.experiments.manual import command_line, python_api, references
from kerfgym.experiments.report import terminal
from kerfgym.experiments.results import followers as results

ROOT = Path(kerfgym.__file__).parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def page(name):
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


def section(text, heading):
    """What stands below a heading, up to the next one of its level."""
    level = heading.split(" ")[0]
    found = re.search(rf"(?ms)^{re.escape(heading)}\n(.*?)(?=^{level} |\Z)", text)
    assert found, heading
    return found[1]


# --------------------------------------------------------------------------------------------------------------- readme


def test_the_readme_is_short_and_its_first_screen_says_that_nothing_is_validated():
    lines = README.split("\n")
    assert len(lines) <= 200
    assert "Nothing here has been validated on a machine" in "\n".join(lines[:12])


def test_the_readme_cites_the_five_documents_in_full():
    for entry in references.entries():
        if entry.fields["topic"] == references.DOCUMENTS:
            assert f"**{entry.cited}**: {references.citation(entry)}" in README


def test_every_page_is_reached_from_the_manual_s_index():
    index = page("README.md")
    pages = {path.name for path in (ROOT / "docs").glob("*.md")} - {"README.md"}
    assert not {name for name in pages if f"({name}" not in index}


# --------------------------------------------------------------------------------------------------------- command line


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_the_page_has_just_the_options_that_the_command_prints(name, capsys):
    with pytest.raises(SystemExit):
        cli.main([name, "--help"])
    plain = re.compile(r"--(?:no-)?([a-z][a-z-]*)")
    heads = [line for line in capsys.readouterr().out.split("\n") if re.match(r"\W{1,3}-", line)]
    printed = {found for line in heads for found in plain.findall(line)} - {"help"}
    rows = re.findall(r"(?m)^\| (`.*?) \|", section(page("command-line.md"), f"## `kerfgym {name}`"))
    assert {found for row in rows for found in plain.findall(row)} == printed


def test_help_is_read_with_its_defaults():
    text = """usage: x

Does it.

 options
 -----
  -h, --help       show this
  -c NAME, --controller NAME
                   what is run, which
                   is long. (default: pid)
  --ms, --no-ms    measure it. (default: True)
"""
    found = list(command_line.options(text))
    assert found[1] == ("-c NAME, --controller NAME", "what is run, which is long. (default: pid)")
    assert [command_line.told(about) for _, about in found[1:]] == [
        ("what is run, which is long.", "pid"), ("measure it.", "on"),
    ]  # fmt: skip


def test_every_script_that_the_page_names_is_one():
    names = re.findall(r"(?m)^\| `python -m ([\w.]+)`", section(page("command-line.md"), "## Scripts"))
    assert len(names) > 15
    for name in names:
        path = ROOT.joinpath(*name.split(".")[1:])
        assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), name


# --------------------------------------------------------------------------------------------------------------- python


def public():
    return {
        (f"kerfgym.{m}", n.split(".")[0]) for _, ms in python_api.PUBLIC.values() for m, ns in ms.items() for n in ns
    }


def test_all_that_the_manual_s_examples_import_is_public():
    modules = {module for module, _ in public()}
    used = 0
    for path in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")):
        for block in re.findall(r"(?ms)^```python\n(.*?)^```", path.read_text(encoding="utf-8")):
            for node in ast.walk(ast.parse(block)):
                if isinstance(node, ast.ImportFrom) and str(node.module).startswith("kerfgym"):
                    used += 1
                    for alias in node.names:
                        whole = f"{node.module}.{alias.name}"
                        assert (node.module, alias.name) in public() or whole in modules, f"{path.name}: {whole}"
    assert used > 10


def test_a_name_that_is_gone_is_an_error():
    with pytest.raises(InvalidInput, match=r"kerfgym\.envs\.metrics has no 'evalute'; did you mean 'evaluate'"):
        python_api.entry("kerfgym.envs.figures.metrics", "evalute", str)


def test_a_function_is_told_as_it_is_called():
    text = python_api.entry("kerfgym.experiments.measure.rollout", "roll", str)
    assert text.startswith(
        "**`roll(scenario, stack, seeds, threads=1, change=None)`** in `kerfgym.experiments.measure.rollout`"
    )
    text = python_api.entry("kerfgym.envs.paths.read", "read", str)
    assert "`read(path, *, layers=None" in text
    assert "\n- `path`: the file; its suffix tells the format." in text


# ------------------------------------------------------------------------------------------------------------- reports


def test_every_column_of_the_printed_tables_is_explained():
    text = page("reading-a-report.md")
    followers, jobs = section(text, "## Columns of followers"), section(text, "## Columns of jobs")
    for title in (*terminal.FOLLOWING, "decision, µs", "its P99, µs", "budget", "class"):
        assert f"`{title}`" in followers, title
    for name in terminal.FORMS:
        title = f"{terminal.TITLES.get(name, name)}, {job_metrics.METRICS[name].unit}".removesuffix(", 1")
        assert f"`{title}`" in jobs, title


def test_every_section_of_the_page_is_explained():
    frame = (ROOT / "experiments" / "report" / "report.html").read_text(encoding="utf-8")
    text = section(page("reading-a-report.md"), "## The page").casefold()
    for heading in re.findall(r"<h2>([^<{]+)</h2>", frame):
        heading = heading.replace("’", "'").replace("How the parts are cut", "Plan").replace(" of the run", "")
        assert heading.casefold() in text, heading


# ------------------------------------------------------------------------------------------------------------- recipes


def test_the_recipe_for_a_metric_puts_it_into_summary_and_table(monkeypatch, made_up):
    text = page("add-a-metric.md")
    (shown,) = re.findall(r"`SHOWN` of `experiments/results/followers.py`: `(.*?)`", text)
    (line,) = re.findall(r'(?m)^    ("within, %".*),$', text)
    found = made_up.following()
    found.runs["within_20um"] = 93.21
    assert "within, %" not in terminal.sheets(found)[0].titles
    monkeypatch.setattr(results, "SHOWN", results.SHOWN | eval(f"{{{shown}}}"))
    monkeypatch.setattr(terminal, "FOLLOWING", terminal.FOLLOWING | eval(f"{{{line}}}", vars(terminal)))
    assert found.summary()["within"].round(2).tolist() == [93.21] * 3
    sheet = terminal.sheets(found)[0]
    at = sheet.titles.index("within, %")
    assert [row[at] for rows in sheet.sections for row in rows] == ["93.2"] * 3


def test_the_recipe_for_a_shipped_controller_makes_a_stack_of_it(monkeypatch):
    text = page("add-a-controller.md")
    (law,) = re.findall(r"(?ms)^```python\n# mine_law\.py\n(.*?)^```", text)
    head, _, functions = law.partition("class Law:")
    module = types.ModuleType("kerfgym.baselines.mine")
    exec(head + textwrap.dedent(functions[functions.index("    def init") :]), vars(module))
    monkeypatch.setitem(sys.modules, "kerfgym.baselines.mine", module)
    (entry,) = re.findall(r'(?m)^    ("mine": .*),$', section(text, "## Ship it"))
    monkeypatch.setattr(baselines, "_CATALOGUE", baselines._CATALOGUE | eval(f"{{{entry}}}"))
    stack = baselines._make("mine")
    values = {name: parameter.value for name, parameter in stack.parameters().items()}
    assert (stack.slot, values["law.gain"], values["filter.window"]) == ("z", 60.0, 5.0)
    assert stack.provenance["trials"] == 0


HUM = """
import numpy as np
from kerfgym.envs.plant import ideal
from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.experiments.measure import rollout

def spectrum(text, *stages):
    change = lambda fleet: [ideal.idealise(fleet, stage, [0]) for stage in stages]
    scenario = scenarios.parse('name = "x"\\nduration = 1.3\\n[head]\\nnoise = 0\\nimpulses = 0\\n' + text)
    run = rollout.roll(scenario, stack.resolve("xi2023-ma"), [0], 1, change)
    error = run["raw_height"][300:, 0]
    return 2 * abs(np.fft.rfft(error - error.mean())) / len(error)

hum, quiet, without = spectrum("hum = 0.01"), spectrum(""), spectrum("hum = 0.01", "sensor")
print(int(hum.argmax()), bool(hum[50] > 20 * quiet[50]), bool(without[50] < hum[50] / 20))
"""


def test_the_recipe_for_a_disturbance_works_word_by_word(tmp_path):
    text = page("add-a-disturbance.md")
    blocks = re.findall(r"(?ms)^```text\n(.*?)^```", text)
    copy = tmp_path / "kerfgym"
    shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".*", "docs", "tests", "build", "runs", "__pycache__"))

    def edit(file, after, new, instead=""):
        path = copy / file
        source = path.read_text(encoding="utf-8")
        assert source.count(after) == 1, after
        path.write_text(source.replace(after, new if instead else after + new), encoding="utf-8")

    sensor, head, preparing = (
        f"envs/{each}.py" for each in ("plant/sensor", "scenarios/hardware", "scenarios/preparing")
    )
    last = re.search(r"(?m)^    plasma: Annotated.*\n", (copy / sensor).read_text(encoding="utf-8"))[0]
    edit(sensor, last, blocks[0])
    edit(sensor, "part, uniform\n", "part, sine, uniform\n", "instead")
    old = re.search(r"(?m)^    c5 = capacitance\(p, max.*\n", (copy / sensor).read_text(encoding="utf-8"))[0]
    assert blocks[1].split("c5 = ")[1].startswith(old.strip().removeprefix("c5 = "))  # as it is, and a term more
    edit(sensor, old, blocks[1], "instead")
    last = re.search(r"(?m)^    plasma: Annotated.*\n", (copy / head).read_text(encoding="utf-8"))[0]
    edit(head, last, blocks[2])
    edit(preparing, "        burst_end=1 - np.exp(-PERIOD / own.burst_length),\n", blocks[3])
    edit("envs/plant/ideal.py", '"bursts", "plasma"', ', "hum"')
    settings = os.environ | {"PYTHONPATH": str(tmp_path), "KERFGYM_CACHE_DIR": str(tmp_path / "cache")}
    # Whatever tells Python where the checkout is must not find it before the copy.
    alone = "import sys; sys.meta_path[:] = [f for f in sys.meta_path if f.__module__.startswith('_frozen')]\n"
    done = subprocess.run(
        [sys.executable, "-c", alone + HUM], capture_output=True, text=True, cwd=tmp_path, env=settings, timeout=280
    )
    assert done.stdout.split() == ["50", "True", "True"], done.stderr
