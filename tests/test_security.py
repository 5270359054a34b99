"""What files can and can't do: a test for every line of docs/security.md."""

import ast
import builtins
import contextlib
import json
import os
import pickle
import re
import shutil
import socket
import subprocess
import sys
import time
import tracemalloc
import zipfile
from pathlib import Path

import ezdxf
import numpy as np
import pandas as pd
import psutil
import pytest
from safetensors.numpy import load as tensors_of
from safetensors.numpy import save

import kerfgym
from kerfgym.agents import checkpoint, settings
from kerfgym.agents.policy import Policy
from kerfgym.envs import scenarios
from kerfgym.envs.control import stack as stacks
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.paths.read import read as read_drawing
from kerfgym.envs.safety import consent, files, names, secrets
from kerfgym.experiments.benchmark.benchmarking import run
from kerfgym.experiments.cli import main
from kerfgym.experiments.report.remake import remake
from kerfgym.experiments.results import archive
from kerfgym.experiments.store import kinds as stored_records
from kerfgym.experiments.store import pool, tabular
from kerfgym.experiments.tune import storage, study_file

ROOT = Path(kerfgym.__file__).parent
PAGE = ROOT / "docs" / "security.md"
TRAP = "import pathlib\npathlib.Path(__file__).with_name('EXECUTED').touch()\nclass Mine:\n    pass\n"
OWN = """
import pathlib
pathlib.Path(__file__).with_name('EXECUTED').touch()
class Mine:
    def reset(self):
        pass

    def control(self, signals):
        return 0.0
"""
PROCESSES = """
import multiprocessing
from kerfgym.experiments import cli
from kerfgym.experiments.store import pool

def begin() -> None:
    "Processes as a benchmark's, and as those of a search with several workers."
    print(sorted(pool.spread(abs, [-1, -2, -3], 2)))
    process = multiprocessing.get_context("spawn").Process(target=print)
    process.start()
    process.join()
    assert process.exitcode == 0

if __name__ == "__main__":
    cli.COMMANDS["list"] = begin
    cli.main()
"""
URL = "postgresql://user:hunter2@127.0.0.1:1/database"

tested = set()


def line(*texts):
    """The lines of the page that a test is about."""
    tested.update(texts)
    return lambda function: function


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """The user's folder, with a file that must not be run."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(consent.VARIABLE, raising=False)
    (tmp_path / "evil.py").write_text(TRAP, encoding="utf-8")
    yield tmp_path
    assert not (tmp_path / "EXECUTED").exists(), "Python was run that nobody had asked for"


def refused(function, *arguments, within=5.0):
    """The words of the error, which comes at once."""
    start = time.monotonic()
    with pytest.raises(InvalidInput) as error:
        function(*arguments)
    assert time.monotonic() - start < within
    return str(error.value)


def said(capsys, *words):
    """What the command says to bad input."""
    with pytest.raises(SystemExit) as stopped:
        main(list(words))
    told = capsys.readouterr().err
    assert stopped.value.code == 2
    assert "Traceback" not in told
    return told


def test_every_line_of_the_page_has_a_test():
    bullets = re.findall(r"^- (.*?)(?=\n- |\n\n|\Z)", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert len(bullets) > 20
    lines = {" ".join(bullet.split()) for bullet in bullets}
    assert lines - tested == set()
    assert tested - lines == set()


# ------------------------------------------------------------------------------------------------------ what you type


@line("`-c mine.py:Mine` and `-c module:Mine` run that Python, with all that you may do.")
def test_what_is_typed_is_run(here):
    (here / "mine_of_security.py").write_text(OWN, encoding="utf-8")
    for words in ("mine_of_security.py:Mine", "mine_of_security:Mine"):
        assert stacks.resolve(words).python is not None
        (here / "EXECUTED").unlink()


@line(
    "A module is looked for in your folder after all other places, so no file that lies there takes the place of a "
    "library."
)
def test_a_file_in_ones_folder_does_not_take_the_place_of_a_library(here):
    (here / "tomli_w.py").write_text(TRAP, encoding="utf-8")
    (here / "own_module.py").write_text(OWN.replace("EXECUTED", "mine"), encoding="utf-8")
    code = (
        "from kerfgym.envs.control import stack; stack.resolve('own_module:Mine');"
        "import tomli_w; print(tomli_w.__file__)"
    )
    script = here / "elsewhere" / "run.py"  # as an installed command, whose folder is not the user's
    script.parent.mkdir()
    script.write_text(code, encoding="utf-8")
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=100, cwd=here)
    assert done.returncode == 0, done.stderr
    assert str(here) not in done.stdout


@line(
    "Processes that a command starts do not look for modules there at all; but `python -m kerfgym…` begins with your "
    "folder, as Python does: use the command `kerfgym`, or `python -P -m`."
)
def test_no_process_of_a_command_runs_what_lies_in_ones_folder(here):
    for name in ("json", "pickle", "numpy"):  # which a worker imports in its first moment
        (here / f"{name}.py").write_text(TRAP, encoding="utf-8")
    script = here / "elsewhere" / "run.py"  # as an installed command, whose folder is not the user's
    script.parent.mkdir()
    script.write_text(PROCESSES, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(script), "list"], capture_output=True, text=True, timeout=100, cwd=here, check=True
    )
    assert "[1, 2, 3]" in done.stdout
    assert not (here / "EXECUTED").exists()
    subprocess.run([sys.executable, "-m", "json.tool"], capture_output=True, timeout=60, cwd=here)
    assert (here / "EXECUTED").exists()  # so that is what would have happened
    (here / "EXECUTED").unlink()
    subprocess.run(
        [sys.executable, "-P", "-m", "json.tool", "-h"], capture_output=True, timeout=60, cwd=here, check=True
    )


@line(
    "`--allow-code` lets the files of this command name Python, too; so does the environment variable "
    "`KERFGYM_ALLOW_CODE=1`."
)
def test_agreement_is_for_one_command(here, monkeypatch, capsys):
    (here / "mine.py").write_text(OWN, encoding="utf-8")
    (here / "tuned.toml").write_text('controller = "mine.py:Mine"\n[parameters]\n', encoding="utf-8")
    asked = ["render", "x.png", "-c", "tuned.toml", "-s", "flat", "--seconds", "0.01"]
    main([*asked, "--allow-code"])
    (here / "EXECUTED").unlink()
    assert "tuned.toml: controller is 'mine.py:Mine': that is Python code" in said(capsys, *asked)
    monkeypatch.setenv(consent.VARIABLE, "1")
    main(asked)
    (here / "EXECUTED").unlink()


# --------------------------------------------------------------------------------------------------------- every file

READERS = {
    "scenario": lambda path: scenarios.read(path),
    "drawing.dxf": lambda path: read_drawing(path),
    "part.svg": lambda path: read_drawing(path),
    "part.ngc": lambda path: read_drawing(path),
    "profile": lambda path: scenarios.profile(scenarios.Profile(file=str(path))),
    "map": lambda path: scenarios.height_map(scenarios.Map(file=str(path))),
    "signal": lambda path: scenarios.signal(str(path)),
    "head": lambda path: scenarios.measured_head(str(path)),
    "tuned": lambda path: stacks.tuned(str(path)),
    "mine.py": lambda path: stacks.resolve(f"{path}:Mine"),
    "preset": lambda path: settings.from_file(path, "ppo"),
    "checkpoint": lambda path: checkpoint.read(path),
    "parquet": lambda path: tabular.read_parquet(path),
    "csv": lambda path: tabular.read_csv(path),
    "journal": lambda path: storage.repair(path),
}


@line("Only regular files are read; a named pipe, a device, a socket or a folder is an error at once.")
@pytest.mark.parametrize("kind", READERS)
def test_only_regular_files_are_read(here, kind):
    path = here / kind
    with socket.socket(socket.AF_UNIX) as listening:
        for make, word in (
            (lambda: os.mkfifo(path), "a named pipe"),
            (lambda: path.symlink_to("/dev/zero"), "a device"),
            (lambda: path.symlink_to("/proc/self/mem"), "Input/output error"),
            (path.mkdir, "a folder"),
            (lambda: listening.bind(str(path)), "|No such device"),
        ):
            make()
            told = refused(READERS[kind], path)
            assert any(each in told for each in word.split("|")), told
            path.rmdir() if path.is_dir() else path.unlink()


LIMITS = {
    "scenario": files.SETTINGS,
    "profile": files.TABLE,
    "signal": files.TABLE,
    "head": files.TABLE,
    "drawing.dxf": files.DRAWING,
    "part.svg": files.DRAWING,
    "part.ngc": files.DRAWING,
    "tuned": files.SETTINGS,
    "preset": files.SETTINGS,
    "checkpoint": files.NUMBERS,
    "parquet": files.NUMBERS,
    "journal": files.NUMBERS,
}


@line(
    "A file above the limit of its kind is an error before it is read: 1 MB for settings, 32 MB for a CSV table, 64 "
    "MB for a drawing or programme, 64 MB for a run's record, 2 GB for results, weights and journals."
)
@pytest.mark.parametrize("kind", LIMITS)
def test_a_file_that_is_too_large_is_refused_before_it_is_read(here, kind):
    path, most = here / kind, LIMITS[kind]
    path.touch()
    os.truncate(path, most + 1)  # a sparse one, which takes no room
    assert f"larger than {most / 1e6:g} MB" in refused(READERS[kind], path, within=1.0)
    assert (files.SETTINGS, files.TABLE, files.DRAWING, files.RECORD, files.NUMBERS) == (
        1_000_000,
        32_000_000,
        64_000_000,
        64_000_000,
        2_000_000_000,
    )


def test_a_record_that_is_too_large_is_refused(here):
    (here / "run").mkdir()
    (here / "run" / "run.json").touch()
    os.truncate(here / "run" / "run.json", files.RECORD + 1)
    assert "larger than 64 MB" in refused(archive.load, here / "run")


def test_a_file_whose_size_the_system_does_not_tell_is_read_up_to_its_limit():
    assert "larger than 1e-05 MB" in refused(files.data, "/proc/self/status", 10)


@line("Text is UTF-8; another byte is an error with its line.")
def test_text_is_utf_8(here):
    path = here / "x.toml"
    path.write_bytes(b'name = "x"\n# gr\xfcn\n')
    for reader in (scenarios.read, lambda p: stacks.tuned(str(p)), lambda p: settings.from_file(p, "ppo")):
        assert "line 2 is not UTF-8 (byte 0xfc)" in refused(reader, path)


@line("TOML and JSON with more than 32 tables or lists within one another are an error.")
def test_deep_files_are_refused(here):
    assert files.toml_of(f"x = {'[' * 31}{']' * 31}", "x")
    assert "more than 32" in refused(files.toml_of, f"x = {'[' * 32}{']' * 32}", "x")
    for text in (f"x = {'[' * 100_000}", f"x = {'[' * 40}{']' * 40}", f"[{'.'.join('a' * 40)}]\nb = 1"):
        (here / "x.toml").write_text(text, encoding="utf-8")
        assert re.search("32 tables or lists|not valid TOML", refused(scenarios.read, here / "x.toml"))
    (here / "run").mkdir()
    for text in ("[" * 100_000, "[" * 40 + "]" * 40):
        (here / "run" / "run.json").write_text(text, encoding="utf-8")
        assert "more than 32 tables or lists" in refused(archive.load, here / "run")


@pytest.mark.parametrize("value", [2**63, -(2**63) - 1, 10**400])
def test_whole_numbers_have_64_bits(here, value):
    (here / "x.toml").write_text(f"a = [{{b = {value}}}]\n", encoding="utf-8")
    assert f"x.toml: {str(value)[:24]}" in (told := refused(files.toml, here / "x.toml"))
    assert "is no number of 64 bits" in told
    assert len(told) < 200
    assert "is no number of 64 bits" in refused(files.json_of, json.dumps({"a": value}), "x.json")
    assert files.toml_of("a = 9223372036854775807", "x") == {"a": 2**63 - 1}


@line("Names and texts hold no control characters, and what a terminal is shown of a file holds none.")
@pytest.mark.parametrize("text", ["\ud800", "a\0b", "\x1b]52;c;aGk=\a", "\x7f", "\x9b31m"])
def test_control_characters_are_no_text(here, text, capsys, monkeypatch):
    from kerfgym.experiments import cli

    for found in ({"a": [text]}, {text: 1}, text):
        assert "is no text" in refused(files.json_of, json.dumps(found), "x.json")
    assert files.json_of(json.dumps("ü板😀\n\t"), "x.json") == "ü板😀\n\t"
    if "\ud800" <= text <= "\udfff":
        return
    escaped = "".join(f"\\u{ord(c):04x}" for c in text)
    assert "is no text" in refused(files.toml_of, f'a = "{escaped}"', "x.toml")
    pd.DataFrame({"controller": [text], "reason": ["x"]}).to_parquet("x.parquet")
    assert "column controller: holds control characters" in refused(tabular.read_parquet, Path("x.parquet"))

    def fails() -> None:
        raise InvalidInput(f"layer {text} is unknown")

    monkeypatch.setitem(cli.COMMANDS, "list", fails)
    assert all(c.isprintable() or c == "\n" for c in said(capsys, "list"))
    document = ezdxf.new("R2010")
    document.header["$INSUNITS"] = 4
    document.modelspace().add_circle((0, 0), 5, dxfattribs={"layer": "LAYER"})
    document.saveas("x.dxf")
    Path("x.dxf").write_bytes(Path("x.dxf").read_bytes().replace(b"LAYER", text.encode()))
    with contextlib.suppress(SystemExit):
        main(["render", "x.png", "--plan", "x.dxf", "--layers", "ignore=*"])
    told = capsys.readouterr()
    assert all(c.isprintable() or c in "\n\r" for c in told.out + told.err)


LONG = "a" * 5000


@pytest.mark.parametrize("text", [LONG, f"{LONG}.toml", f"{LONG}.dxf", f"{LONG}/b", "a\0b", "a\0b.toml"])
def test_what_no_file_can_be_called_is_not_there(here, text, capsys):
    assert not files.exists(text)
    for reader in (
        scenarios.load,
        stacks.resolve,
        read_drawing,
        archive.load,
        lambda t: stacks.resolve(f"{t}.py:Mine"),
    ):
        refused(reader, text)
    for words in (
        ("report", text),
        ("render", "x.png", "--plan", text),
        ("render", "x.png", "--path", text),
        ("benchmark", "-s", text),
        ("train", "ppo", "--preset", text),
    ):
        told = said(capsys, *words)
        assert len(told) < 2000


def test_an_error_is_no_longer_than_can_be_read(capsys, monkeypatch):
    from kerfgym.experiments import cli
    from kerfgym.experiments.store import typed

    def fails() -> None:
        raise InvalidInput(f"'{'x' * 50_000}' in {URL} is no number; allowed: {'some, ' * 5000}")

    monkeypatch.setitem(cli.COMMANDS, "list", fails)
    told = said(capsys, "list")
    assert len(told) < typed.MOST_TOLD + 100
    assert "xxx…" in told
    assert "is no number; allowed: some" in told
    assert "hunter2" not in told


def dotted(function):
    """``torch.load`` of such a call; empty where that is not so simple."""
    if isinstance(function, ast.Name):
        return function.id
    inner = dotted(function.value) if isinstance(function, ast.Attribute) else ""
    return f"{inner}.{function.attr}" if inner else ""


@line("Nothing is ever unpickled, and no text of a file is evaluated as Python.")
def test_nothing_is_unpickled_or_evaluated():
    for layer in ("envs", "baselines", "agents", "experiments"):
        for file in (ROOT / layer).rglob("*.py"):
            tree = ast.parse(file.read_text(encoding="utf-8"))
            for node in ast.walk(tree):
                if isinstance(node, ast.Import | ast.ImportFrom):
                    modules = [a.name for a in node.names] + [getattr(node, "module", None) or ""]
                    assert not {"pickle", "dill", "marshal", "shelve", "cloudpickle"} & set(modules), file
                if not isinstance(node, ast.Call):
                    continue
                called = dotted(node.func)
                assert called not in ("eval", "joblib.load", "pd.read_pickle"), (file, node.lineno)
                if called == "exec":  # of our own parts' text
                    assert file == ROOT / "envs" / "engine" / "adjoint.py", (file, node.lineno)
                if called == "torch.load":
                    assert any(k.arg == "weights_only" and ast.unparse(k.value) == "True" for k in node.keywords)
                assert all(k.arg != "allow_pickle" for k in node.keywords), (file, node.lineno)


SVG = """<?xml version="1.0"?>
<?xml-stylesheet href="http://127.0.0.1:9/a.css"?>
<!DOCTYPE svg [<!ENTITY secret SYSTEM "file://{secret}">]>
<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" width="9mm" height="9mm">
<image xlink:href="http://127.0.0.1:9/a.png" width="5" height="5"/><use xlink:href="http://127.0.0.1:9/a.svg#b"/>
<rect width="5" height="5"/>{entity}</svg>"""


@pytest.fixture
def watched(monkeypatch):
    """Connections that are tried, and files that are opened."""
    tried, opened = [], []
    monkeypatch.setattr(socket.socket, "connect", lambda self, at: tried.append(at))
    monkeypatch.setattr(socket, "getaddrinfo", lambda *a, **k: tried.append(a) or [])
    known, known_os = builtins.open, os.open
    monkeypatch.setattr(builtins, "open", lambda f, *a, **k: opened.append(str(f)) or known(f, *a, **k))
    monkeypatch.setattr(os, "open", lambda f, *a, **k: opened.append(str(f)) or known_os(f, *a, **k))
    return tried, opened


@line(
    "Reading a file opens no connection.",
    "They give contours; what they name beside them, such as an XREF, a picture, a style sheet or an XML entity, is "
    "not opened.",
)
@pytest.mark.parametrize("kind", ["svg", "entity", "dxf"])
def test_drawings_open_neither_files_nor_connections(here, watched, kind):
    tried, opened = watched
    secret = here / "secret.dxf"
    secret.write_text("a secret", encoding="utf-8")
    file = here / f"part.{'dxf' if kind == 'dxf' else 'svg'}"
    if kind == "dxf":
        document = ezdxf.new("R2010")
        document.header["$INSUNITS"] = 4
        document.add_xref_def(str(secret), "outside")
        document.modelspace().add_blockref("outside", (0, 0))
        document.modelspace().add_image(document.add_image_def(str(secret), (5, 5)), (0, 0), (1, 1))
        document.modelspace().add_circle((0, 0), 5)
        document.saveas(file)
        opened.clear()
    else:
        text = SVG.format(secret=secret, entity="<text>&secret;</text>" if kind == "entity" else "")
        file.write_text(text, encoding="utf-8")
    told = ""
    try:
        assert len(read_drawing(file).pieces) == 1
    except InvalidInput as error:  # what is named outside may be refused, too
        told = str(error)
    assert "a secret" not in told
    assert not tried
    assert str(secret) not in opened
    assert not [name for name in opened if "http" in name]


# ---------------------------------------------------------------------------------------------------------- scenarios


@line("A scenario cannot name a controller or any other code.")
def test_a_scenario_names_no_code(here):
    for text in (
        'controller = "evil.py:Mine"',
        'base = "evil.py:Mine"',
        '[job]\nmaterial = "evil.py:Mine"',
        '[job]\npart = "evil.py"',
        'path = "evil.py"',
    ):
        (here / "x.toml").write_text(f'name = "x"\n{text}\n', encoding="utf-8")
        with pytest.raises(InvalidInput):
            run(["wu"], [scenarios.read(here / "x.toml")], here / "run", range(1000, 1001), suite="contour")
    shutil.rmtree(here / "run", ignore_errors=True)


BAD_NAMES = ("../x", "/tmp/x", "..", ".", "", "a/b", "a\\b", "x\n", ".x", "-x", "x.", " x", "a" * 101, "€" * 90)


@line(
    "The name of a scenario becomes a file's name: 1 to 100 letters, digits, spaces and a few signs, none of which "
    "leads out of the run's folder."
)
@pytest.mark.parametrize("name", BAD_NAMES)
def test_names_are_no_paths(here, name):
    text = f"name = {json.dumps(name)}\nduration = 0.1\nsettle = 0.0\n"
    (here / "x.toml").write_text(text, encoding="utf-8")
    assert "x.toml, line 1: name = " in (told := refused(scenarios.read, here / "x.toml"))
    assert "is no name; allowed: 1 to 100 letters, digits" in told
    assert "is no name" in refused(lambda: scenarios.load("wavy").varied(name=name))


def test_good_names_are_names_and_any_file_gives_one():
    for name in ("wavy", "my sheet 3", "Ø20 (neu), 2. Versuch", "a@b+c", "板"):
        assert names.checked(name, "name") == name
    for stem in ("../x", "a/b|c", "...", "x" * 300, "€" * 300, "Teil <3>"):
        names.checked(names.of_file(stem), "name")


def test_a_hostile_name_leaves_a_foreign_file_as_it_was(here, capsys):
    (here / "pyproject.toml").write_text("precious", encoding="utf-8")
    (here / "x.toml").write_text(f'name = "{here}/pyproject"\nduration = 0.1\n', encoding="utf-8")
    assert "line 1: name = " in said(capsys, "benchmark", "-c", "pid", "-s", "x.toml", "--seeds", "2", "--name", "r")
    assert (here / "pyproject.toml").read_text(encoding="utf-8") == "precious"


@line(
    "A scenario may name tables and drawings anywhere; they are read as such, and the error about a file that is none "
    "shows at most one cell of it."
)
def test_an_error_about_a_foreign_file_shows_next_to_nothing_of_it(here):
    secret = here / "elsewhere" / "passwords"
    secret.parent.mkdir()
    secret.write_text("position_mm,height_mm\nroot,hunter2\nuser,hunter3\n", encoding="utf-8")
    (here / "x.toml").write_text(f'name = "x"\n[sheet.profile]\nfile = "{secret}"\n', encoding="utf-8")
    told = refused(scenarios.read, here / "x.toml")
    assert "row 2, column position_mm: 'root' is not a number" in told
    assert "hunter" not in told


@line("A profile has at most 5 000 000 points, a surface heights of at most ±1000 mm.")
def test_a_profile_to_the_moon_is_an_error(here):
    for rows, message in (
        ("0,0\n1e12,0\n", "points; allowed: 5,000,000"),
        ("0,0\n1e300,0\n", "points; allowed"),
        ("0,0\n1,1e6\n", r"row 3, column height_mm: 1e\+06 mm; allowed: ±1000 mm"),
    ):
        (here / "p.csv").write_text(f"position_mm,height_mm\n{rows}", encoding="utf-8")
        (here / "x.toml").write_text('name = "x"\n[sheet.profile]\nfile = "p.csv"\n', encoding="utf-8")
        assert re.search(message, refused(scenarios.read, here / "x.toml"))


# ---------------------------------------------------------------------------------------- tuned controllers and presets


@line(
    "A `tuned.toml` whose controller is Python is refused, also if it hides in a team or behind another `tuned.toml`."
)
@pytest.mark.parametrize(
    "base", ["evil.py:Mine", "z=evil.py:Mine", "xy=wu,z=evil.py:Mine", "evil:Mine", "evil.py:Mine:a=1"]
)
def test_a_tuned_controller_runs_no_python(here, base, capsys):
    (here / "inner.toml").write_text(f'controller = "{base}"\n[parameters]\n', encoding="utf-8")
    (here / "outer.toml").write_text('controller = "z=inner.toml,xy=wu"\n[parameters]\n', encoding="utf-8")
    for name in ("inner.toml", "outer.toml"):
        told = refused(stacks.team, name)
        assert "that is Python code" in told
        assert "--allow-code" in told
    assert "--allow-code" in said(capsys, "benchmark", "-c", "inner.toml", "-s", "flat", "--seeds", "2")


@pytest.mark.parametrize("value", ["true", "[]", "{a = 1}", "1979-05-27"])
def test_a_tuned_parameter_is_a_number_or_a_word(here, value):
    (here / "t.toml").write_text(f'controller = "pid"\n[parameters]\n"law.kp" = {value}\n', encoding="utf-8")
    assert "t.toml: parameters.law.kp is " in refused(stacks.resolve, "t.toml")


@line("A preset or `settings.toml` whose base controller is Python is refused.")
@pytest.mark.parametrize("table", ["environment", "evaluation"])
def test_a_preset_runs_no_python(here, table, capsys):
    (here / "preset.toml").write_text(f'[{table}]\nbase = "evil.py:Mine"\n', encoding="utf-8")
    told = said(capsys, "train", "ppo", "--preset", "preset.toml", "--name", "x")
    assert f"preset.toml: {table}.base is 'evil.py:Mine': that is Python code" in told
    assert "--allow-code" in told


@line("A `tuned.toml` that names itself is an error.")
def test_a_tuned_controller_that_names_itself_is_an_error(here):
    (here / "a.toml").write_text('controller = "b.toml:law.kp=3"\n[parameters]\n', encoding="utf-8")
    (here / "b.toml").write_text('controller = "a.toml:law.kp=3"\n[parameters]\n', encoding="utf-8")
    assert "names itself" in refused(stacks.resolve, "a.toml")


@line("A provenance of the wrong kind is an error, not a trick on the ranking.")
@pytest.mark.parametrize(
    "text",
    [
        "trials = -1",
        "trials = 2e18",
        'trials = "many"',
        "simulated_steps = nan",
        "cpu_seconds = true",
        "tune_seeds = [1.5]",
        "seeds = 1.5",
        "policy = 3",
        "start = []",
        "[provenance.policy.ledger]\ncpu_seconds = []",
        "[provenance.start]\nsteps = -3",
    ],
)
def test_a_provenance_is_of_the_right_kind(here, text):
    (here / "t.toml").write_text(
        f'controller = "pid"\n[parameters]\n"law.kp" = 50.0\n[provenance]\n{text}\n', encoding="utf-8"
    )
    assert "t.toml: provenance" in refused(stacks.resolve, "t.toml")


@line("A key of a preset of the wrong kind is an error with file and key.")
@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("environment.base = 3", "environment: base is 3"),
        ("environment.scenario = 3", "environment: scenario is 3"),
        ('environment.scenario = [["wavy"]]', "environment: scenario.0 is a list"),
        ("evaluation.scenario = [1]", "evaluation: scenario.0 is 1"),
        ("evaluation.base = []", "base is a list"),
        ('environment.reward = {rate = "x"}', "environment: reward.rate is 'x'"),
        ("environment.reward = {rate = true}", "environment: reward.rate is True"),
        ("environment.machine = 1", "environment: machine is 1"),
        ("environment.max_steps = 1.5", "max_steps is 1.5"),
        ("environment.num_envs = 100001", "environment.num_envs = 100001; a whole number, from 1 to 100,000"),
        ("environment.num_threads = 0", "environment.num_threads = 0"),
        ("steps = true", "steps = True"),
        ("algorithm.gamma = []", "algorithm.gamma = []"),
        ("policy.activation = {}", "policy.activation = {}"),
        ("policy.spread = [0.1, inf]", "policy.spread = [0.1, inf]"),
        ("algorithm = 1", "'algorithm' is a table"),
        (f"environment.scenario = {json.dumps(['wavy'] * 1001)}", "environment.scenario has 1,001 entries"),
    ],
)
def test_a_preset_holds_what_it_should(here, text, key):
    (here / "mine.toml").write_text(text, encoding="utf-8")
    told = refused(settings.from_file, here / "mine.toml", "ppo", within=30.0)
    assert f"{here / 'mine.toml'}: " in told
    assert key in told


def test_the_kinds_of_all_arguments_are_declared():
    declared = set(settings.Arguments.__annotations__)
    for env in settings.TASKS:
        for table in ("environment", "evaluation"):
            assert set(settings.known(settings.Settings("ppo", env), table)) <= declared


# ----------------------------------------------------------------------------------------------------------- policies


@pytest.fixture
def policy(here):
    """A copy of a shipped policy, and a function that writes its document with the right hashes."""
    folder = here / "policy"
    shutil.copytree(ROOT / "agents" / "trained" / "height-following-ppo", folder)

    def write(change):
        document = json.loads((folder / "policy.json").read_text(encoding="utf-8"))
        document.pop("sha256", None)
        change(document)
        (folder / "policy.json").write_text(json.dumps(document), encoding="utf-8")
        return folder

    return write


@line("A policy is JSON and safetensors: numbers for a network of at most 16 layers of 4096, on laws that kerfgym has.")
@pytest.mark.parametrize(
    "change",
    [
        lambda d: d["base"]["z"].update(law="evil.py:Mine"),
        lambda d: d["base"]["z"].update(law="../x"),
        lambda d: d["network"]["layers"][0].update(outputs=5000),
        lambda d: d["network"].update(layers=[]),
        lambda d: d["network"].update(layers=d["network"]["layers"][:1] * 17),
        lambda d: d.update(code="import os"),
        lambda d: d.update(provenance={"trials": "x"}),
    ],
)
def test_a_policy_is_numbers_for_a_small_network(policy, change):
    with pytest.raises(InvalidInput):
        Policy.load(policy(change))


@line(
    "The hashes in a policy show damage; they are no signature, so whoever changes weights can change the hash with "
    "them."
)
def test_hashes_show_damage_and_are_no_signature(policy):
    import hashlib

    folder = policy(lambda document: None)
    before = Policy.load(folder)
    weights = tensors_of((folder / "weights.safetensors").read_bytes())
    changed = save({name: np.ascontiguousarray(0.5 * value) for name, value in weights.items()})
    (folder / "weights.safetensors").write_bytes(changed)
    assert "is damaged, or not this policy's" in refused(Policy.load, folder)
    policy(lambda document: document.update(weights=hashlib.sha256(changed).hexdigest()))
    seen = np.full(before.network.size, 0.3, np.float32)
    assert (Policy.load(folder).act(seen, True) != before.act(seen, True)).any()


@line(
    "`model.zip` beside a policy is for the tools of stable-baselines3 and holds pickles. Nothing here reads it, "
    "whoever wrote it."
)
def test_what_stable_baselines_saved_is_not_read(policy, capsys):
    folder = policy(lambda document: None)
    for place in (folder, folder.parent):
        with zipfile.ZipFile(place / "model.zip", "w") as file:
            file.writestr("data", pickle.dumps(Runs()))
    Policy.load(folder).act(np.zeros(Policy.load(folder).network.size, np.float32), True)
    said(capsys, "benchmark", "-c", str(folder.parent / "model.zip"), "-s", "tilt", "--seeds", "1", "--name", "x")
    main(["benchmark", "-c", str(folder), "-s", "tilt", "--seeds", "1", "--name", "x", "--no-ms"])
    assert not list(folder.parent.rglob("EXECUTED"))


@pytest.mark.parametrize("size", [1e5, 1e20, 3e38])
def test_a_network_whose_numbers_grow_without_end_is_refused(policy, size):
    import hashlib

    folder = policy(lambda document: None)
    weights = tensors_of((folder / "weights.safetensors").read_bytes())
    for name, value in weights.items():
        if name.endswith("weight"):
            weights[name] = np.full_like(value, size)
            weights[name].flat[::2] *= -1
    changed = save(weights)
    (folder / "weights.safetensors").write_bytes(changed)
    policy(lambda document: document.update(weights=hashlib.sha256(changed).hexdigest()))
    if size < 1e10:  # absurd, yet finite
        loaded = Policy.load(folder)
        assert np.isfinite(loaded.act(np.full(loaded.network.size, 10.0, np.float32), True)).all()
    else:
        assert "layers.0 can give" in (told := refused(Policy.load, folder)) or "layers.1 can give" in told


# ---------------------------------------------------------------------------------------------------- runs and reports


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A small run."""
    folder = tmp_path_factory.mktemp("stored") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("kerfgym.experiments.report.page.write_report", lambda *_: None)
        case = scenarios.load("wavy").varied(duration=0.4)
        run(["pid"], [case], folder, range(1000, 1003), with_ms=False, workers=1, quiet=True, core=("wavy",))
    return folder


@pytest.fixture
def changed(stored, here):
    """A function: a copy of the run with its record changed."""

    def of(change, name="run"):
        folder = here / "runs" / name
        shutil.copytree(stored, folder)
        record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        change(record)
        (folder / "run.json").write_text(json.dumps(record), encoding="utf-8")
        return folder

    return of


def renamed(record, name):
    record["grids"] = {name: record["grids"]["following"]}


@line(
    "No name in a `run.json` leads out of the run's folder, neither where it is read nor where its report is written."
)
def test_names_in_a_record_stay_in_the_folder(here, changed, capsys, monkeypatch):
    monkeypatch.setattr("kerfgym.experiments.report.page.write_report", lambda *_: None)
    first = changed(lambda r: None, "first")
    for i, folder in enumerate(("../first", str(first), "..", "a/../../first")):
        bad = changed(lambda r, folder=folder: r["grids"]["following"].update(folder=folder), f"bad{i}")
        assert "leads out of" in refused(archive.load, bad)
    (here / "runs" / "link").mkdir()
    shutil.copy(first / "run.json", here / "runs" / "link")
    record = json.loads((first / "run.json").read_text(encoding="utf-8"))
    record["grids"]["following"]["folder"] = "inside"
    (here / "runs" / "link" / "run.json").write_text(json.dumps(record), encoding="utf-8")
    (here / "runs" / "link" / "inside").symlink_to(first)
    assert "leads out of" in refused(archive.load, here / "runs" / "link")
    (here / "ring").symlink_to("ring")
    for name in ("a" * 300, "a/" * 3000, "ring", "\ud800"):  # nothing can be called so, or be there
        assert "can be called so" in refused(files.within, here, name, "folder")
    (here / "secret.toml").write_text('password = "hunter2"', encoding="utf-8")
    for i, make in enumerate(
        (
            lambda place: place.symlink_to(here, target_is_directory=True),
            lambda place: (place.mkdir(), (place / "a.toml").symlink_to(here / "secret.toml")),
        )
    ):
        bad = changed(lambda r: None, f"linked{i}")
        shutil.rmtree(bad / "scenarios")
        make(bad / "scenarios")
        assert "leads out of" in refused(archive.load, bad)
    before = {path for path in here.rglob("*")}
    for i, name in enumerate(("../../../escaped", str(here / "escaped"), "..", "a\0b", "x/../../..")):
        second = changed(lambda r, name=name: renamed(r, name), f"second{i}")
        before |= set(second.rglob("*")) | {second}
        with contextlib.suppress(InvalidInput):  # one that stays within is only written there
            remake(["first", str(second)], here / "runs" / f"joined{i}", quiet=True, command=["x"])
        new = {path for path in here.rglob("*")} - before
        assert all(path.is_relative_to(here / "runs" / f"joined{i}") for path in new)
        before |= new


@line("A key of the wrong kind in a `run.json` is an error with its place.")
@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("tables", None),
        ("tables", []),
        ("summaries", {"a": 1}),
        ("core", "wavy"),
        ("scenarios", [1]),
        ("ledger", []),
        ("tuning", {"pid": 3}),
        ("tuning", {"pid": {"trials": "x"}}),
        ("parameters", {"pid": 1}),
        ("kind", "other"),
        ("folder", 3),
        ("decisions", {"pid": []}),
        ("bounds", {"wavy": "x"}),
        ("exempt", 1),
    ],
)
def test_a_record_of_the_wrong_kind_is_an_error(changed, key, value):
    told = refused(archive.load, changed(lambda r: r["grids"]["following"].update({key: value})))
    assert "grids.following" in told
    assert key in told


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("machine", {"processor": []}),
        ("machine", {"cores": "2"}),
        ("git", {"commit": [1]}),
        ("packages", {"numpy": 1}),
        ("wall_seconds", "1"),
        ("notes", "x"),
        ("tuning", {"pid": {"trials": "x"}}),
        ("plates", [[]]),
        ("corners", 1),
        ("linear", {"wavy": []}),
        ("ledger", {"pid": {"cpu_seconds": "1"}}),
        ("kernel", 1),
    ],
)
def test_what_holds_for_the_whole_run_is_of_the_right_kind_too(changed, key, value):
    assert f"run.json': {key}" in refused(archive.load, changed(lambda r: r.update({key: value})))


@pytest.mark.parametrize("key", ["metric", "reference"])
def test_jobs_without_a_metric_or_reference_are_an_error(key):
    record = {"kind": "jobs", "metric": "time", "reference": "wu", "core": []}
    stored_records.grid(record, "contour", "x")
    for change in ({key: None}, {key: 1}):
        assert key in refused(stored_records.grid, record | change, "contour", "x")


@pytest.mark.parametrize("value", [None, 3, [], {"following": None}, {"following": 3}, {"following": {}}, {}])
def test_grids_of_the_wrong_kind_are_an_error(changed, value):
    refused(archive.load, changed(lambda r: r.update(grids=value)))


@line("The tables of a run hold numbers and names; a table of more than 300 million cells is not unpacked.")
def test_tables_hold_numbers_and_names(changed, here, monkeypatch):
    folder = changed(lambda r: None)
    frame = pd.read_parquet(folder / "runs.parquet")
    (folder / "runs.csv").unlink()
    for column, value in (("rms_true", "x"), ("seed", 1.5), ("controller", 3), ("scenario", None), ("rms_true", [[1]])):
        frame.assign(**{column: [value] * len(frame)}).to_parquet(folder / "runs.parquet")
        assert f"column {column}" in refused(archive.load, folder)
    large = pd.DataFrame({"x": np.zeros(2_000_000, np.int8)})
    large.to_parquet(here / "large.parquet")
    assert (here / "large.parquet").stat().st_size < 100_000
    monkeypatch.setattr(tabular, "CELLS", 1_000_000)
    assert "2,000,000 rows; more than can be read" in refused(tabular.read_parquet, here / "large.parquet")


@line("A report shows names and texts as text: no markup or script in them comes to life.")
def test_a_report_has_no_foreign_markup(changed):
    evil = "</script><script>alert(1)</script><img src=x onerror=alert(1)>"

    def change(record):
        record.update(command=evil, notes=[evil], machine={"processor": evil}, packages={evil: evil})
        grid = record["grids"]["following"]
        grid["summaries"] = {"wavy": evil}
        grid["tuning"] = {"pid": {"trials": 3, "command": evil, "edited": evil}}

    folder = changed(change)
    frame = pd.read_parquet(folder / "runs.parquet")
    for name in ("runs", "traces"):
        frame = pd.read_parquet(folder / f"{name}.parquet")
        frame["controller"] = evil
        frame.to_parquet(folder / f"{name}.parquet")
    remake([str(folder)], quiet=True)
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "alert(1)" in page  # it is there, as text
    assert "<script>alert" not in page
    assert "<img src=x" not in page


@line("Curves of trainings and studies that a run names are read only below the folder in which you work.")
def test_curves_outside_are_not_read(here, tmp_path_factory):
    from kerfgym.experiments.report import curves, tuning

    def fill(place):
        (place / "ppo" / "policy").mkdir(parents=True)
        (place / "ppo" / "policy" / "policy.json").write_text("{}", encoding="utf-8")
        (place / "ppo" / "evaluations.csv").write_text("steps,score\n1,2\n", encoding="utf-8")
        pd.DataFrame({"parameter": ["a"], "value": [1.0], "side": [1], "moved": [1.2], "rms_true": [1.0]}).to_parquet(
            place / "sensitivity.parquet"
        )

    outside = tmp_path_factory.mktemp("outside")
    fill(outside)
    fill(here / "mine")
    away = os.path.relpath(outside, here)
    (here / "link").symlink_to(outside)
    policies = ["mine/ppo/policy", f"{outside}/ppo/policy", f"{away}/ppo/policy", "link/ppo/policy", "a\0b"]
    assert list(curves.curves(policies)) == ["mine/ppo/policy"]
    tunings = ["mine/tuned.toml", f"{outside}/tuned.toml", f"{away}/tuned.toml", "link/tuned.toml"]
    assert list(tuning.studies(tunings)) == ["mine/tuned.toml"]


# ------------------------------------------------------------------------------------------------------------ studies


@line("A study file whose controller is Python is refused, also where it is only compared with.")
@pytest.mark.parametrize("words", ['controller = "evil.py:Mine"', 'controller = "pid"\nrelative = "evil.py:Mine"'])
def test_a_study_file_runs_no_python(here, words, capsys):
    (here / "s.toml").write_text(f'suite = "following"\nmetric = "rms_true"\n[search.x]\n{words}\n', encoding="utf-8")
    told = said(capsys, "tune", "--study", "s.toml")
    assert "s.toml: search.x" in told
    assert "--allow-code" in told


@line(
    "The names of its searches become files' names and lead nowhere else; only the package's own studies write presets."
)
@pytest.mark.parametrize(("name", "more"), [("../x", ""), ("/tmp/x", ""), ("pid", "presets = true\n")])
def test_a_study_file_writes_in_its_run_alone(here, name, more):
    text = f'{more}suite = "following"\nmetric = "rms_true"\n[search."{name}"]\ncontroller = "pid"\n'
    (here / "s.toml").write_text(text, encoding="utf-8")
    assert "s.toml: presets" if more else "search" in refused(study_file.read, "s.toml")


@line("A key of a study file that is unknown or of the wrong kind is an error with its place.")
@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("sweet = 1", "'sweet'"),
        ("trials = 'many'", "trials"),
        ("ranges = 3", "ranges"),
        ("[search.pid]\nset = 3", "set"),
        ("[search.pid]\n[[search.pid.stage]]\nsampler = 3", "sampler"),
        ("like = 'folowers'", "followers"),
        ("seeds = 1" + 30 * "0", "64 bits"),
        ("ms = [nan]", "ms = nan"),
        ("limits = { jitter = nan }", "jitter = nan"),
        ("[search.wu]\nsuite = 'contour'\nwhat = ['law.kp']\nset = { 'law.kp' = { gain_margin = 0.0 } }", "of 0 is no"),
        ("[search]\npid = 3", "search.pid"),
        ("stage = 3", "stage"),
        ("[[stage]]\nspread = 'x'", "spread"),
    ],
)
def test_a_changed_study_file_is_an_error(here, text, told):
    rest = "" if "[search" in text else "[search.pid]\n"
    (here / "s.toml").write_text(f"{text}\n{rest}", encoding="utf-8")
    found = refused(study_file.read, "s.toml")
    assert "s.toml" in found
    assert told in found


@pytest.fixture
def journal(here):
    """A small study, as its journal's lines."""
    study = storage.study_of("a.journal", "x", ["minimize"], ["suite x"], {"explore": 1})
    for value in (3.0, 2.0):
        trial = study.ask()
        trial.suggest_float("law.kp", 1.0, 9.0)
        trial.set_user_attr("steps", 10)
        trial.report(1.0, 0)
        study.tell(trial, value)
    return Path("a.journal").read_text(encoding="utf-8").splitlines()


@line("A journal is JSON, line by line; lines that do not fit each other, or values of the wrong kind, are an error.")
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"op_code":6', '"op_code":99'),
        ('"op_code":4', '"op_kode":4'),
        ('"trial_id":0', '"trial_id":"x"'),
        ('"study_id":0', '"study":0'),
        ('"values":[3.0]', '"values":["x"]'),
        ('"explore":1', '"explore":"x"'),
        ('"steps":10', '"steps":[]'),
        ('"space":["suite x"]', '"space":3'),
        ('"study_name":"x"', '"study_name":[]'),
        ('"worker_id"', '"worker"'),
        ('"directions":[1]', '"directions":[7]'),
        ('"intermediate_value":1.0', '"intermediate_value":"x"'),
        ('"steps":10', '"steps":1' + 400 * "0"),
    ],
)
def test_a_changed_journal_is_an_error(here, journal, old, new):
    text = "\n".join(journal) + "\n"
    assert old in text
    Path("b.journal").write_text(text.replace(old, new), encoding="utf-8")
    told = refused(storage.study_of, "b.journal", "x", ["minimize"], ["suite x"], {"explore": 1})
    assert "b.journal" in told


@pytest.mark.parametrize(
    ("start", "told"),
    [
        ({"filter.kind": "none"}, "cmaes.law.kp = 'None'; allowed: a number"),
        ({"law.kp": "x", "filter.kind": "none"}, "cmaes.law.kp = 'x'"),
        ({}, "cmaes.filter.kind"),
        ({"law.kp": 50.0, "law.ki": 1.0, "filter.kind": "evil"}, "cmaes.filter.kind = 'evil'; allowed: none, mean"),
        ({"law.kp": 50.0, "filter.kind": "mean"}, "cmaes.law.ki"),
        ([], "cmaes"),
    ],
)
def test_a_start_of_cma_es_that_does_not_fit_is_an_error(here, start, told):
    from kerfgym.experiments.tune.study import Task

    task = Task("pid", ("law.kp", "law.ki", "filter.kind"), "drawing", sampler="cmaes", name="x", url="c.journal")
    study = task.open()
    first = study.ask()
    task.space.suggest(first)
    study.tell(first, 1.0)
    study.set_user_attr("cmaes", start)
    assert told in refused(lambda: task.space.suggest(task.open().ask()))


def test_a_journal_that_leads_in_circles_is_an_error(here):
    Path("c.journal").symlink_to("c.journal")
    assert "the journal 'c.journal' cannot be used: Too many levels" in refused(storage.opened, "c.journal")


def test_a_journal_that_was_not_changed_is_read(here, journal):
    study = storage.study_of("a.journal", "x", ["minimize"], ["suite x"], {"explore": 1})
    assert [trial.value for trial in study.trials] == [3.0, 2.0]


@line("Of a Redis database the entries are read, never its snapshots, which are pickles.")
def test_snapshots_are_not_unpickled():
    from optuna.storages import JournalStorage

    class Redis:
        """Somebody else can write into this database."""

        def load_snapshot(self):
            raise AssertionError("a snapshot was read")

        def save_snapshot(self, snapshot):
            raise AssertionError("a snapshot was written")

        def __init__(self):
            self.logs = []

        def read_logs(self, first):
            return self.logs[first:]

        def append_logs(self, logs):
            self.logs += logs

    import optuna

    study = optuna.create_study(storage=JournalStorage(storage._WithoutSnapshots(Redis())))
    for _ in range(120):  # one in a hundred trials saves a snapshot
        study.tell(study.ask(), 1.0)
    assert len(study.trials) == 120


@line(
    "The password of a storage's URL is in no file and no message: `…` stands in its place, also in the recorded "
    "command."
)
def test_passwords_are_nowhere(here, capsys, monkeypatch):
    told = said(capsys, "tune", "law.kp", "-c", "pid", "--trials", "2", "--seeds", "1", "--storage", URL, "--name", "x")
    assert "://user:…@127.0.0.1:1/database' cannot be used" in told
    assert "hunter2" not in told
    database = f"sqlite:///{here}/a.db?password=hunter2"  # a database that needs none and does not mind
    monkeypatch.setattr("kerfgym.experiments.tune.history.write", lambda *_: [])
    monkeypatch.setattr("kerfgym.experiments.tune.outcome.TEST_SEEDS", 2)
    opened = storage.opened
    monkeypatch.setattr(storage, "opened", lambda url: opened(url.replace("?password=hunter2", "")))
    words = "tune law.kp -c pid --trials 2 --seeds 1 --suite drawing --ms inf --name y --storage"
    main([*words.split(), database])
    out = capsys.readouterr()
    assert "password=…" in out.out
    assert "hunter2" not in out.out + out.err
    written = [file for file in (here / "runs").rglob("*") if file.is_file()]
    assert {"tuned.toml", "run.json"} <= {file.name for file in written}
    assert not [file for file in written if b"hunter2" in file.read_bytes()]
    assert "password=…" in (here / "runs" / "y" / "run.json").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "url",
    [
        "postgresql://u:hunter2@127.0.0.1:notaport/d",
        "postgresql:///d?host=127.0.0.1&port=1&password=hunter2",
        "postgresql://u:hun/ter2@127.0.0.1:1/d",
        "sqlite:////none/x.db?password=hunter2",
        "redis://:hunter2@127.0.0.1:1",
        "redis://:hunter2@127.0.0.1:notaport",
        "mysql://u:hunter2@127.0.0.1:1/d",
        "foo://u:hunter2@x/y",
        "u:hunter2@host/d",
    ],
)
def test_a_storage_that_cannot_be_used_says_so_at_once_and_without_its_password(here, url):
    told = refused(storage.opened, url)
    assert "unter2" not in told
    assert "ter2" not in told
    assert list(here.iterdir()) == [here / "evil.py"]


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("postgresql://u:p@h/d", "postgresql://u:…@h/d"),
        ("redis://:p@h", "redis://:…@h"),
        ("mysql+x://u:p@ss:w/rd@h:1/d", "mysql+x://u:…@h:1/d"),
        ("x://h/d?a=1&sslpassword=p&b=2", "x://h/d?a=1&sslpassword=…&b=2"),
        ("postgresql://user@host/database", "postgresql://user@host/database"),
        ("tcp://10.0.0.1:8786", "tcp://10.0.0.1:8786"),
    ],
)
def test_passwords_of_urls_are_masked(text, shown):
    assert secrets.masked(text) == secrets.masked_word(text) == shown
    assert (
        secrets.masked(f"kerfgym tune --storage {text} -c z=pid,xy=wu")
        == f"kerfgym tune --storage {shown} -c z=pid,xy=wu"
    )
    assert secrets.everywhere({"a": [text, 1]}) == {"a": [shown, 1]}


def test_a_long_word_is_read_once_and_not_from_each_of_its_characters_anew():
    began = time.process_time()
    assert secrets.masked("x" * 100_000) == secrets.masked_word("x" * 100_000) == "x" * 100_000
    assert time.process_time() - began < 1.0  # 0.01 s, where each beginning was tried 20 s and more


def test_what_a_driver_repeats_of_a_password_is_masked_too():
    url = "postgresql://u:s3cr et@h/d"
    assert secrets.masked_word(url) == "postgresql://u:…@h/d"
    assert secrets.without("bad word 's3cr et' in the URL", url) == "bad word '…' in the URL"


def test_a_record_of_an_earlier_version_is_shown_without_its_password(changed):
    found = archive.load(changed(lambda r: r.update(command=f"kerfgym tune --storage {URL}")))
    assert found.meta["command"] == "kerfgym tune --storage postgresql://user:…@127.0.0.1:1/database"


# --------------------------------------------------------------------------------------------- checkpoints and clusters


class Runs:
    """What a pickle may do."""

    def __reduce__(self):
        return (exec, ("import pathlib; pathlib.Path('EXECUTED').touch()",))


@line("A checkpoint is loaded as tensors and plain values; anything else in it is an error.")
def test_a_checkpoint_runs_nothing(here):
    import torch

    torch.save({"format": checkpoint.FORMAT, "model": Runs()}, here / "checkpoint.pt")
    assert "is not a checkpoint of kerfgym, or is damaged" in refused(
        checkpoint.read, here / "checkpoint.pt", within=30
    )
    torch.save({"format": checkpoint.FORMAT, "rows": []}, here / "checkpoint.pt")
    assert checkpoint.read(here / "checkpoint.pt")["rows"] == []


@line(
    "`--backend dask` listens on this machine only, speaks TLS with certificates that are made for this one run, and "
    "has no page."
)
def test_a_cluster_of_ones_own_is_not_for_others():
    from distributed import Client, default_client

    with pool._cluster(1, None):
        address = default_client().scheduler.address
        me = psutil.Process()
        listening = [
            c.laddr for p in (me, *me.children(recursive=True)) for c in p.net_connections() if c.status == "LISTEN"
        ]
        assert {at.ip for at in listening} == {"127.0.0.1"}
        assert 8787 not in {at.port for at in listening}
        assert address.startswith("tls://127.0.0.1:")
        with pytest.raises((OSError, TimeoutError)):
            Client(address.replace("tls://", "tcp://"), timeout=1)


@line("A `--scheduler` without `tls://` is answered with a warning, since whoever reaches it can run code.")
def test_a_scheduler_without_tls_is_warned_of(capsys):
    refused(lambda: list(pool.spread(abs, [-1], 1, "dask", "tcp://127.0.0.1:1")), within=30)
    assert "warning: 'tcp://127.0.0.1:1' does not ask who talks to it" in capsys.readouterr().err


def test_reading_takes_the_memory_of_the_file_and_not_of_its_limit(tmp_path):
    (tmp_path / "small.json").write_text("[1]", encoding="utf-8")
    tracemalloc.start()
    assert files.data(tmp_path / "small.json", files.NUMBERS) == b"[1]"
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 3 * files.MEGABYTE


def test_a_column_of_words_holds_words(tmp_path):
    file = tmp_path / "runs.parquet"
    pd.DataFrame({"scenario": ["a"], "iso_roughness": [3]}).to_parquet(file)
    with pytest.raises(InvalidInput, match="column iso_roughness: holds int64, not text"):
        tabular.read_parquet(file)
    pd.DataFrame({"scenarios": ["a"], "picture": [b"<svg>"]}).to_parquet(file)
    with pytest.raises(InvalidInput, match="column picture: holds what is no PNG"):
        tabular.read_parquet(file)
