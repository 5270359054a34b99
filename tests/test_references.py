"""Sources and pages that the code points to are there; what is listed as assumed is all that is marked so."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml

import kerfgym
from kerfgym.envs.engine.quantity import InvalidInput, quantities
from kerfgym.envs.plant import filters, sensor
from kerfgym.experiments.manual import assumptions, references

ROOT = Path(kerfgym.__file__).parent
ENTRIES, SOURCES = references.entries(), references.sources()

POINTER = re.compile(r"docs/([\w-]+\.md)(?:#([\w-]+))?")


def anchors(page):
    headings = re.findall(r"(?m)^#+ (.*)$", page.read_text(encoding="utf-8"))
    return {re.sub(r"[^\w\- ]", "", each.lower()).strip().replace(" ", "-") for each in headings}


# -------------------------------------------------------------------------------------------------------- bibliography


def test_every_source_that_the_code_names_has_an_entry():
    unknown = {name: found for name, text in SOURCES.items() if (found := references.unknown(text, ENTRIES))}
    assert not unknown, "add them to docs/references.bib"


@pytest.mark.parametrize(
    "text",
    [
        '"""As Kalman and Bucy 1961 have it."""',
        "# the law of Harashima (1996)",
        "(Boyd and\n# Barratt 1991)",
        "Åström et al. 1977, p. 3",
        "by van der Schaft 2000.",
    ],
)
def test_a_source_without_an_entry_is_found(text):
    assert references.unknown(references.unwrapped(text), ENTRIES)


@pytest.mark.parametrize(
    "text", ["(Canudas de Wit\n# et al. 1995)", "Huang2024 eq. 2", "Realised(2000.0, 0.3)", "feeds up to 2000 mm/s"]
)
def test_known_sources_and_plain_numbers_are_none(text):
    assert references.unknown(references.unwrapped(text), ENTRIES) == []


def test_every_entry_is_used():
    assert not [key for key, files in references.used(ENTRIES, SOURCES).items() if not files]


def test_an_entry_that_nothing_names_would_be_noticed():
    extra = references.Entry("book", "nobody1900", {"cited": "Nobody" + " 1900"})
    assert references.used([extra], SOURCES) == {"nobody1900": []}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("@book{x,\n  title = {T},\n}\n", "line 3: 'x' lacks cited, topic, use"),
        ("@book{x,\n  title = {T}\n}\n", "line 2: «  title = {T}» is neither"),
        ("@book{x,\n  title = {T},\n  title = {T},\n}\n", "line 3: 'title' stands twice"),
        ("@book{x,\n  title = {{T},\n}\n", "line 2: braces of 'title'"),
        ("@book{x,", "'x' does not end"),
    ],
)
def test_a_bibliography_of_another_form_is_an_error_with_its_line(text, message):
    with pytest.raises(InvalidInput, match=re.escape(message)):
        references.entries(text)


def test_equations_of_the_documents_are_found_where_they_are_computed():
    places = references.places(ENTRIES, SOURCES)
    assert "envs/plant/filters.py" in places["Xi2023", "equation", 6]
    assert {"envs/plant/spot.py", "envs/figures/quality.py"} <= set(places["Huang2024", "equation", 13])
    assert "envs/paths/bspline.py" in places["Huang2024", "equation", 4]  # "eqs. 3–8"


def test_a_source_reads_as_a_line():
    bierman = next(each for each in ENTRIES if each.key == "bierman1977")
    assert references.citation(bierman) == (
        "Gerald J. Bierman. *Factorization Methods for Discrete Sequential Estimation*. Academic Press. 1977."
    )
    box = next(each for each in ENTRIES if each.key == "box1961")
    assert references.citation(box).startswith(
        "G. E. P. Box and J. S. Hunter. *The 2^(k-p) Fractional Factorial Designs, Part I*. Technometrics 3(3): 311–"
    )


# ------------------------------------------------------------------------------------------------------------- pointers


def test_every_pointer_into_the_manual_leads_to_a_section():
    wrong, seen = [], 0
    for name, text in SOURCES.items():
        for page, place in POINTER.findall(text):
            path = ROOT / "docs" / page
            seen += 1
            if not path.is_file() or (place and place not in anchors(path)):
                wrong.append(f"{name}: docs/{page}#{place}")
    assert not wrong
    assert seen > 30


def test_no_pointer_leads_out_of_the_repository():
    old = re.compile(r"\b(?:PHYSICS|DESIGN) §|\bSEEDS\.md|\bNEXT\.md|\bSTYLE\.md")
    assert not [name for name, text in SOURCES.items() if old.search(text)]


# ---------------------------------------------------------------------------------------------------------- assumptions


def test_every_mark_of_an_assumption_is_listed():
    listed = {}
    for each in assumptions.every():
        listed.setdefault(each.file, set()).update(range(each.first, each.last + 1))
    for layer in assumptions.LAYERS:
        for path in (ROOT / layer).rglob("*"):
            name = path.relative_to(ROOT).as_posix()
            if path.suffix in (".py", ".toml") and name not in assumptions.ABOUT:
                for number, line in enumerate(path.read_text(encoding="utf-8").split("\n"), start=1):
                    if assumptions.MARK in line and 'source: str = "[A]"' not in line:
                        assert number in listed.get(name, ()), f"{name}:{number}"


def test_an_assumed_number_has_the_value_that_the_part_has():
    rows = {(each.file, each.name): each for each in assumptions.every()}
    radius = rows["envs/plant/sensor.py", "Params.radius"]
    assert float(radius.value) == sensor.Params().radius
    assert radius.what == "mm, nozzle face R"
    assert rows["envs/plant/sheet.py", "FOOTPRINT"].value == "2.0"
    assert rows["envs/materials/thin-sheet.toml", "cut.zr"].value == "1.0"
    declared = {name for name, q in quantities(filters.Params).items() if assumptions.MARK in q.source}
    assert {f"Params.{name}" for name in declared} == {
        name for file, name in rows if file == "envs/plant/filters.py" and name.startswith("Params.")
    }


def test_a_mark_in_running_text_is_told_as_its_sentence():
    text = '"""Of heads.\n\nA long first sentence that says nothing of the kind' + " and goes on" * 8
    text += '. Their bodies differ by\n5 % [A]. And so on."""\n'
    (found,) = assumptions.in_words("x.py", text, [])
    assert (found.value, found.what) == ("", "Their bodies differ by 5 %")


# ------------------------------------------------------------------------------------------------------------ packaging


def test_the_version_is_the_same_wherever_it_stands():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert project["version"] == kerfgym.__version__ == cited["version"]
    assert cited["license"] == project["license"]


def test_the_citation_file_has_what_its_format_asks_for():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= set(cited)
    assert cited["cff-version"] == "1.2.0"
    assert cited["authors"] == [{"name": "kerfgym contributors"}]


def test_type_checkers_are_told_that_the_package_is_typed():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert (ROOT / "py.typed").is_file()
    assert "py.typed" in settings["tool"]["setuptools"]["package-data"]["kerfgym"]
