"""Numbers that runs make are written by a script: none stands in README or manual outside the marks.

A number *looks like a result* if it has decimals, a unit of measurement, a percent sign, or a word such as "times" with
it, or if it stands in a table. Those that are constants of the design, of statistics or of an example stand in a list
here, each with its reason. The changelog tells what was true of a version, so it is not asked.
"""

import re

import pytest

from kerfgym.experiments.manual import docs
from kerfgym.experiments.studies import marks

WHOLE = {"machine.md", "environments.md"}
"""Pages that the code makes from docstrings and declared quantities: what stands there is the machine's definition."""

PAGES = {
    page.relative_to(docs.README.parent).as_posix(): page
    for page in (docs.README, *sorted(docs.FOLDER.glob("*.md")))
    if page.name not in WHOLE
}

_NUMBER = r"[-−+±]?\d[\d,]*(?:\.\d+)?"
_UNITS = (
    r"µm²?|nm|mm|cm|m/s|m/min|µs|ms|s|seconds?|minutes?|hours?|CPU-seconds?|CPU-minutes?|Hz|kHz|MHz|pF|µH|W|kW|kB|KB|MB|"
    r"%|per cent|×|times|steps|trials|million|M|seeds|collisions|runs"
)
RESULT = re.compile(
    rf"(?<![\w.\-–]){_NUMBER}[ -]?(?:{_UNITS})(?!\w)"
    r"|(?<![\w.\-–])[-−+±]?\d+\.\d+(?![\w.])|×\s?\d|\d+-fold|[Ff]actor (?:of )?\d"
)
"""What looks like a result in a sentence."""

CELL = re.compile(r"(?<![\w.])\d")
"""What looks like one in a table: any number that is not part of a name."""

LEVEL = "the level of all intervals, a constant of intervals.LEVEL"
ALLOWED: dict[str, dict[str, str]] = {
    "README.md": {
        "Python 3.11 or newer": "of pyproject.toml",
        "up to 5 mm/s on top": "a tenth of the action's range, in the example",
        "95 % intervals over seeds": LEVEL,
    },
    "docs/bounds.md": {
        "They know the sheet 5 ms ahead": "the preview's definition, controller.AHEAD",
        "An impulse of 70 µm": "an impulse at the set height, from the constants of the sensor's model",
        "the sensor resolves, 5 µm": "a constant, sensor.LEAST_GAP",
        "Over 200 seeds the RMS": "the test seeds, a constant of the suites",
    },
    "docs/your-machine.md": {
        "if a parameter is 20 % off": "a constant, outcome.OFF",
    },
    "docs/glossary.md": {
        "| 8 ms: how often the programme": "the interpolation period, a constant of the machine",
        "in 95 % of repetitions": LEVEL,
    },
    "docs/machines.md": {
        "from command to drive, up to 20 ms": "the range of axis.dead_time",
        "mm, diameter of the nozzle": "a machine, in the example",
        "reach over a drawing of up to 4 × 2 m": "a constant, schema.SHEET",
        "may come to 22 ms. Commands older than 6 ms": "ranges of dead time and latency, and z_axis.QUEUE",
        "Gradients keep 6 ms and refuse more": "z_axis.QUEUE",
    },
    "docs/reading-a-report.md": {"is a 95 % interval over seeds": LEVEL},
    "docs/add-a-metric.md": {
        "it may be 0 or infinite in a good run": "what zero means",
        "Intervals are of 95 % over seeds": LEVEL,
    },
    "docs/tuning.md": {
        "by more than 5 %": "a constant, worth.FLATTERED",
        "if it is 20 % off;": "a constant, outcome.OFF",
        "after with 95 % intervals": LEVEL,
        "numbers; 0: as the sampler gives them, neither rounded nor mended | 5": "what digits means, and its default",
        "or several: [2.0, 3.3, inf] searches": "caps, in the example",
    },
    "docs/identification.md": {
        "An interval of 95 % should hold": LEVEL,
        "at most 55 mm/s": "drive.SLOW",
        "up to 250 mm/s": "drive.QUICK",
    },
    "docs/physics.md": {'"500 mm/s" of Xi2023 and "200 mm/s" of CN102528288A': "printed by the documents"},
    "docs/add-a-scenario.md": {
        "viscous below 1 mm/s": "the default of z_axis.Params.creep",
        "under the tip (2 mm)": "sheet.FOOTPRINT",
    },
    "docs/drawings.md": {
        "of a DXF 1 to 255": "AutoCAD's colour index",
        "without it 0.05": "the default of Reading.join",
        "HATCH, SOLID, TRACE, 3DFACE": "names of DXF entities",
        "leave their chords by 2 µm": "a constant of the reader",
        "to 0.03 % of their radius": "what a cubic is off a quarter circle, a known constant",
        "Ends within 1 nm": "a constant of joining",
        "wider than 5 µm is listed": "a constant of joining",
        "gap up to 20 times the tolerance": "a constant of joining",
        "another one within 5 µm goes": "overlaps.NEAR",
        "within 10 µm of each other": "a constant of cleaning",
        "less than 5 µm beyond": "overlaps.NEAR",
        "Curves shorter than 0.05 mm": "the default of Reading.join",
        "4 million points, 10 km of path": "limits of the reader",
        "coordinates up to 1000 km; a file 64 MB": "limits of the reader",
        "a grid of 32 767 × 32 767": "the largest that DXF allows",
        "may be 1 km long": "a limit of journeys",
        "4 × 2 m for drawings": "the largest usual sheet",
        "agree to 0.5 %": "what is asked, a limit of the corpus",
    },
    "docs/jobs.md": {
        "stands still for 20 ms": "job.HALT",
        "within 0.01 mm": "gantry.IN_POSITION",
        "After 500 ms it goes on": "the default of gantry.Journey.patience",
        "falls with 3000 mm/s²": "the default of job.Settings.lift_acceleration",
        "smoothly, within 8 ms": "gantry._SMOOTHING",
    },
    "docs/gcode.md": {"may run lines again 200 000 times": "gcode_flow.MOST_LINES"},
    "docs/blame.md": {"95 % intervals over seeds": LEVEL},
    "docs/results-following.md": {
        "95 % intervals over seeds": LEVEL,
        "no more than a factor of 1.5": "what is asked, agreement.FACTOR",
    },
    "docs/controllers.md": {
        "head velocity | 1 ms |": "the control period, a constant of the machine",
        "servo period, 4 ms in Wu": "Wu's",
        "standoff | 8 ms |": "the interpolation period, a constant of the machine",
        "1.1 times the simulated steps": "a rule of the ranking, budgets.SLACK",
    },
    "docs/reproduction.md": {"encoder is 3.2 mm off until it is homed": "an argument of the example"},
    "docs/statistics.md": {
        "above 1 it is closer": "follows from the definition",
        "mean of the worst 5 % of the runs": "the definition of the figure",
        "They hold 95 %": LEVEL,
        "contain the truth in 95 % of the repeats": LEVEL,
        "is near 95 %": LEVEL,
        "which should be 5 %": LEVEL,
        "hold together with 95 %": LEVEL,
        "because it may be 0 or infinite": "why it is pooled so",
        "scale | 0 is the reference, 1 is": "the definition of the scale",
        "one collision in 200 runs decides": "an example",
        "sine of the sheet (20 µm, 1 to 200 Hz)": "constants of stability",
        "random-phase multisine, 20 µm RMS": "a constant of stability",
        "with its 95 % interval over 16": LEVEL,
        "its lines are 1 Hz apart": "a constant of stability",
        "a step of 0.1 mm still settles": "a constant of margins",
    },
    "docs/endurance.md": {
        "of the suites last 3 s": "of the scenarios' files",
        "is run for 300 s over": "the script's default",
        "kept in windows of 10 s": "a constant of endurance",
        "last third of the time over 30 s": "a constant of endurance",
        "table hold together with 95 %": LEVEL,
        "lies above 1.05 (RMS) or 1.10 (largest": "the criterion's margins, constants of endurance.verdict",
        "after the first 10 s over": "a constant of endurance",
        "must keep it at 1.5 or less": "what is asked of it",
        "a window above 50 µm": "the definition of a burst",
        "60 m up 3 mm/m": "an arithmetic example of the sheet's slope",
    },
    "docs/faults.md": {
        "NaN passes as 0 mm/s [A]": "a definition of the campaign",
        "1 to 20 ms of frozen": "a definition of the campaign",
        "1 to 20 ms of dropouts": "a definition of the campaign",
        "impulses of 1 to 5 ms, ten times as many": "a definition of the campaign",
        "count that says 10 mm need not": "an example from the definitions",
        "fall by 1 mm and more in 5 ms": "supervisor.SUDDEN times the default of Params.rise",
    },
    "docs/security.md": {
        "1 MB for settings, 32 MB for a CSV table, 64 MB for a drawing": "limits, constants of envs.safety.files",
        "64 MB for a run's record": "a limit, a constant of envs.safety.files",
        "heights of at most ±1000 mm": "a limit, scenarios.MOST_HEIGHT",
        "more than 300 million cells": "a limit, tabular.CELLS",
    },
}
"""Words around numbers that no run makes, by page, and why they may stand there."""


def stripped(text: str) -> str:
    """A page without what a script makes, code, links' targets and marks; comments of code blocks stay."""

    def comments(found: re.Match[str]) -> str:
        return "\n\n".join(re.findall(r"(?m)(?:^| )# (.*)$", found[0]))

    text = re.sub(r"(?ms)^```.*?^```$", comments, text)
    own = r"(?s)<!-- run: .*?<!-- end -->"  # of scripts with records of their own
    for pattern in (docs._MARKED, marks.MARKED, own, r"(?s)<!--.*?-->", r"`[^`\n]*`", r"\]\([^)]*\)"):
        text = re.sub(pattern, " ", text)
    return re.sub(r"[ \t]+", " ", text)


def unmarked(text: str, allowed: dict[str, str]) -> tuple[list[str], set[str]]:
    """Every place that looks like a result and is not allowed, and the allowed words that are not there."""
    lines, unused = stripped(text), set(allowed)
    for words in allowed:
        pattern = r"\s+".join(map(re.escape, words.split()))
        if re.search(pattern, lines):
            unused.discard(words)
        lines = re.sub(pattern, "…", lines)
    cells = [line for line in lines.split("\n") if line.lstrip().startswith("|") and CELL.search(line)]
    flat = re.sub(r"\s+", " ", lines)
    return cells + [flat[max(0, f.start() - 30) : f.end() + 20] for f in RESULT.finditer(flat)], unused


@pytest.mark.parametrize("name", PAGES)
def test_no_result_stands_outside_the_marks(name):
    found, unused = unmarked(PAGES[name].read_text(encoding="utf-8"), ALLOWED.get(name, {}))
    assert not found, (
        "mark it (<!-- n: study.path -->, <!-- made: table -->); a constant goes into ALLOWED, with a reason"
    )
    assert not unused, "ALLOWED names what is no longer there"


@pytest.mark.parametrize("name", PAGES)
def test_no_sentence_goes_on_behind_a_mark_that_begins_a_line(name):
    # Markdown takes such a line as HTML, and shows what follows on it as it stands.
    for line in PAGES[name].read_text(encoding="utf-8").splitlines():
        assert not re.match(r"\s*<!--.*?-->\s*\S", line), line


@pytest.mark.parametrize("name", PAGES)
def test_what_a_page_claims_is_so(name):
    assert marks.broken(PAGES[name].read_text(encoding="utf-8")) == []


def test_every_exception_is_of_a_page():
    assert set(ALLOWED) <= set(PAGES)


@pytest.mark.parametrize(
    "sentence",
    [
        "It reaches 3.42 µm.",
        "It is 7 times closer.",
        "They need 168 CPU-seconds.",
        "dross falls by 3 %",
        "Ms is 1.22",
        "it lies 3 % below the paper's",
        "after 4.8 million steps",
        "between 9 and 14 µm",
        "a ratio of × 2",
        "±0.3 mm",
        "| `pid` | 9 | 0/2400 |",
        "```\nkerfgym tune law   # takes 130 seconds\n```",
    ],
)
def test_what_looks_like_a_result_is_found(sentence):
    assert unmarked(f"A page.\n\n{sentence}\n", {})[0]


@pytest.mark.parametrize(
    "sentence",
    [
        "Huang2024's Table 2 and CN102528288A",
        "slot `z`, `law.kp=3.5`",
        "two of them, in 16 corner plants",
        "[a link](page.md#3.5-mm)",
        "| Huang2024 | `x=3` |",
        "<!-- n: following.pid.score .2f -->9.77<!-- /n --> µm",
        "<!-- made: following -->\n| pid | 9.77 |\n<!-- end -->",
        "```\nkerfgym tune law.kp=20..120 --ms 3.3\n```",
        "kerfgym 0.1.0",
    ],
)
def test_names_code_and_marked_numbers_are_none(sentence):
    assert unmarked(f"A page.\n\n{sentence}\n", {})[0] == []


def test_an_exception_must_be_there():
    assert unmarked("It has 3 mm.", {"It has 3 mm": "as given", "and 4 mm": "gone"}) == ([], {"and 4 mm"})
