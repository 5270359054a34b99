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

import numpy as np
import pytest

import kerfgym
from kerfgym import baselines
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.figures import job_metrics, metrics
from kerfgym.envs.figures.registered import EVERY
from kerfgym.experiments import cli
from kerfgym.experiments.manual import command_line, python_api, references
from kerfgym.experiments.report import headings, terminal
from kerfgym.experiments.report import summary as summary_page
from kerfgym.experiments.report.page import write_report

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
    told = [command_line.told(about) for _, about in found[1:]]
    assert told == [("what is run, which is long.", "pid"), ("measure it.", "on")]


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
    with pytest.raises(
        InvalidInput, match=r"kerfgym\.envs\.figures\.metrics has no 'evalute'; did you mean 'evaluate'"
    ):
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


def test_every_column_of_the_printed_tables_is_explained(made_up):
    text = page("reading-a-report.md")
    followers, jobs = section(text, "## Columns of followers"), section(text, "## Columns of jobs")
    found = made_up.following()
    for column in headings.of(found):
        assert f"`{column.title}`" in followers or column.title in ("", *found.scored), column.title
    of_jobs = {m.title for m in job_metrics.METRICS.values() if m.shown and m.shown.brief} | {"ISO 9013", "evidence"}
    for title in of_jobs:
        assert f"`{title}`" in jobs, title


def test_every_section_of_the_page_is_explained():
    frame = (ROOT / "experiments" / "report" / "report.html").read_text(encoding="utf-8")
    text = section(page("reading-a-report.md"), "## The page").casefold()
    for heading in re.findall(r"<h2>([^<{]+)</h2>", frame):
        heading = heading.replace("’", "'").replace("How the parts are cut", "Plan").replace(" of the run", "")
        assert heading.casefold() in text, heading


# ------------------------------------------------------------------------------------------------------------- recipes


def registered(name, registry):
    """What the recipe's block with this metric registers, until the test is over."""
    found = re.findall(r"(?ms)^```python\n(.*?)^```", page("add-a-metric.md"))
    (block,) = [b for b in found if f"def {name}(" in b]
    exec(block, {})
    yield registry[name]
    for names in (registry, EVERY):
        names.pop(name)


@pytest.fixture
def within_20um():
    yield from registered("within_20um", metrics.METRICS)


@pytest.fixture
def energy_per_mm():
    yield from registered("energy_per_mm", job_metrics.METRICS)


def test_a_registered_metric_stands_in_every_table_with_unit_direction_and_interval(within_20um, made_up, tmp_path):
    found = made_up.following()
    random = np.random.default_rng(0)
    found.runs["within_20um"] = random.uniform(80.0, 90.0, len(found.runs))
    mean = found.runs[found.runs["scenario"].isin(found.core)].groupby("controller")["within_20um"].mean()
    summary = found.summary()
    for name, value in mean.items():
        low, middle, high = (summary.at[name, f"within_20um{end}"] for end in ("_low", "", "_high"))
        assert middle == pytest.approx(value)
        assert value - 3.0 < low < value < high < value + 3.0
    sheet = terminal.sheets(found)[0]
    at = sheet.titles.index("within_20um, %")
    cells = {row[0]: row[at] for rows in sheet.sections for row in rows}
    low, high = summary.loc["pid", ["within_20um_low", "within_20um_high"]]
    assert cells["pid"] == f"{mean['pid']:.1f} ({low:.1f} … {high:.1f})"
    assert any(note.startswith(f"within_20um, %: {within_20um.summary}; higher is better; ") for note in sheet.notes)
    assert cells["pid"] in summary_page.markdown({"following": found}, made_up.record)
    text = write_report(tmp_path, {"following": found}, made_up.record).read_text(encoding="utf-8")
    (head,) = re.findall(r'<th class="[^"]*"[^>]*data-shows="within_20um">(.*?)</th>', text)
    assert "within_20um" in head
    assert "%, higher is better" in head
    assert f'data-value="{summary.at["pid", "within_20um"]}"' in text
    assert f"{low:.1f}–{high:.1f}" in text
    assert "<option>within_20um, %</option>" in text


def test_so_does_a_metric_of_jobs(energy_per_mm, made_up, tmp_path):
    sums = {"energy": np.array([300.0, 0.0]), "length": np.array([60.0, 0.0])}
    machines = types.SimpleNamespace(sums=sums, mean=lambda name: sums[name][:1] / sums["length"][:1])
    assert energy_per_mm.function(machines) == pytest.approx([5.0])
    found = made_up.cutting()
    found.runs["energy_per_mm"] = np.random.default_rng(0).uniform(4.0, 5.0, len(found.runs))
    mean = found.runs[found.runs["controller"] == "fast"]["energy_per_mm"].mean()
    sheet = terminal.sheets(found)[0]
    cells = {row[0]: row[sheet.titles.index("J/mm")] for rows in sheet.sections for row in rows}
    assert cells["fast"].startswith(f"{mean:.2f} (")
    assert any(note.startswith(f"J/mm: {energy_per_mm.summary}; lower is better; ") for note in sheet.notes)
    assert cells["fast"] in summary_page.markdown({"cutting": found}, made_up.record)
    text = write_report(tmp_path, {"cutting": found}, made_up.record).read_text(encoding="utf-8")
    assert re.search(r'data-shows="energy_per_mm"><button type="button">J/mm<small>J/mm, lower is better</small>', text)
    (heading,) = re.findall(r'<th class="(g\d+) first" colspan="\d+" scope="colgroup">time</th>', text)
    assert re.search(rf'<th class="{heading}"[^>]* data-shows="energy_per_mm"', text)


def test_of_an_earlier_run_a_new_metric_has_no_column(within_20um, made_up):
    sheet = terminal.sheets(made_up.following())[0]
    assert not any("within_20um" in text for text in (*sheet.titles, *sheet.notes))


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

at_60 = "hum = 0.01\\nhum_frequency = 60"
hum, quiet, without = spectrum("hum = 0.01"), spectrum(""), spectrum(at_60, "sensor")
other = spectrum(at_60)
print(int(hum.argmax()), int(other.argmax()), bool(hum[50] > 20 * quiet[50]), bool(without[60] < other[60] / 20))
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

    sensor, head = "envs/plant/sensor.py", "envs/scenarios/hardware.py"
    last = re.search(r"(?m)^    plasma: Annotated.*\n", (copy / sensor).read_text(encoding="utf-8"))[0]
    edit(sensor, last, blocks[0])
    edit(sensor, "part, uniform\n", "part, sine, uniform\n", "instead")
    old = re.search(r"(?m)^    c5 = capacitance\(p, max.*\n", (copy / sensor).read_text(encoding="utf-8"))[0]
    assert blocks[1].split("c5 = ")[1].startswith(old.strip().removeprefix("c5 = "))  # as it is, and a term more
    edit(sensor, old, blocks[1], "instead")
    last = re.search(r"(?m)^    plasma: Annotated.*\n", (copy / head).read_text(encoding="utf-8"))[0]
    edit(head, last, blocks[2])
    edit("envs/plant/ideal.py", '"bursts", "plasma"', ', "hum"')
    settings = os.environ | {"PYTHONPATH": str(tmp_path), "KERFGYM_CACHE_DIR": str(tmp_path / "cache")}
    # Whatever tells Python where the checkout is must not find it before the copy.
    alone = "import sys; sys.meta_path[:] = [f for f in sys.meta_path if f.__module__.startswith('_frozen')]\n"
    done = subprocess.run(
        [sys.executable, "-c", alone + HUM], capture_output=True, text=True, cwd=tmp_path, env=settings, timeout=280
    )
    assert done.stdout.split() == ["50", "60", "True", "True"], done.stderr
