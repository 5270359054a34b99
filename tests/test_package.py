"""The package as a whole: what importing costs, who imports whom, what is documented, caches that know their age."""

import ast
import importlib
import inspect
import json
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import kerfgym
from kerfgym.envs.engine.lanes import is_part
from kerfgym.envs.engine.quantity import quantities

ROOT = Path(kerfgym.__file__).parent
LAYERS = ("envs", "baselines", "agents", "experiments")
"""Each may import itself and those before it."""

OLD = ("envs.plant.lanes", "envs.plant.quantity")
"""Old names of modules, which warn whoever imports them."""

ROOMS = (
    "envs.engine",
    "envs.plant",
    "envs.safety",
    "envs.paths",
    "envs.scenarios",
    "envs.control",
    "envs.figures",
    "envs.pictures",
    "envs.tasks",
    "envs",
    "baselines",
    "agents",
    "experiments.store",
    "experiments.statistics",
    "experiments.measure",
    "experiments.results",
    "experiments.plots",
    "experiments.bounds",
    "experiments.blame",
    "experiments.report",
    "experiments.render",
    "experiments.tune",
    "experiments.benchmark",
    "experiments.train",
    "experiments.speed",
    "experiments.identify",
    "experiments.reproduce",
    "experiments",
    "experiments.studies",
    "experiments.manual",
)
"""Folders; the modules of each may import those of its own and of the ones before it."""

AT_HOME = ("experiments.studies", "experiments.manual")
"""Folders of a checkout that are not installed: what measures for the manual's pages, and writes them."""

FILES = sorted(path for layer in LAYERS for path in (ROOT / layer).rglob("*.py"))
SOURCES = {".".join(p.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): p for p in FILES}
"""Modules by name, without the package's own."""


def python(code, *words, cwd=None, path=None):
    """What a fresh process prints, from JSON."""
    settings = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    if path:
        settings["PYTHONPATH"] = str(path)
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, words)],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=settings,
        timeout=280,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


# --------------------------------------------------------------------------------------------------------- imports

LOADED = "import sys, json; print(json.dumps(sorted({name.split('.')[0] for name in sys.modules})))"


def test_importing_the_package_is_cheap_and_registers_its_environments():
    loaded = python("import kerfgym;" + LOADED)
    assert not {"numba", "torch", "optuna", "pandas", "scipy", "stable_baselines3", "matplotlib", "pydantic"} & set(
        loaded
    )
    code = "import kerfgym, gymnasium, json; print(json.dumps([i for i in gymnasium.registry if 'kerfgym' in i]))"
    assert python(code) == [f"kerfgym/{name}-v0" for name in ("HeightFollowing", "ContourFollowing", "Cutting")]


def test_environments_and_baselines_need_no_library_for_learning_or_tables():
    code = (
        "import gymnasium, kerfgym; env = gymnasium.make('kerfgym/HeightFollowing-v0', scenario='flat');"
        "env.reset(seed=0); env.step(env.action_space.sample());"
    )
    loaded = python(code + LOADED)
    assert "llvmlite" in loaded
    assert not {"torch", "optuna", "pandas", "stable_baselines3", "matplotlib", "joblib", "pydantic"} & set(loaded)
    assert "numba" not in python(code + LOADED)  # what is compiled needs no compiler any more


def imported(module, path):
    """Modules of this package that a file imports anywhere in it, by their names within the package."""
    package = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = ["kerfgym", *package][: len(package) + 2 - node.level] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            found |= {f"{base}.{alias.name}" for alias in node.names}
    return {name.removeprefix("kerfgym.") for name in found if name.split(".")[0] == "kerfgym"}


@pytest.mark.parametrize("module", SOURCES)
def test_imports_point_one_way(module):
    own = ROOMS.index(room(module))
    later = {name for name in imported(module, SOURCES[module]) if ROOMS.index(room(name)) > own}
    assert not later, f"{module} imports {later}"


def test_no_two_rooms_share_a_name():
    # A controller and the study that holds it against its document are both called after that document.
    names = [name.rpartition(".")[2] for name, path in SOURCES.items() if path.name != "__init__.py"]
    documents = {name.rpartition(".")[2] for name in SOURCES if name.startswith("baselines.")}
    twice = {name for name in names if names.count(name) > 1} - {"__main__", *documents}
    assert twice == {name.rpartition(".")[2] for name in OLD}


def test_few_files_lie_at_the_top_of_experiments():
    assert len(list((ROOT / "experiments").glob("*.py"))) <= 5


def room(name):
    """The folder of :data:`ROOMS` in which a module lies, or a name in it."""
    return max((each for each in ROOMS if f"{name}.".startswith(f"{each}.")), key=len, default=ROOMS[0])


def of_the_room(name):
    """The modules of its folder that a module imports anywhere in it."""
    own = name.rpartition(".")[0]
    whole = {thing if thing in SOURCES else thing.rpartition(".")[0] for thing in imported(name, SOURCES[name])}
    return {other for other in whole if other in SOURCES and other.startswith(f"{own}.")}


@pytest.mark.parametrize("module", SOURCES)
def test_no_module_imports_itself_by_way_of_others_in_its_folder(module):
    reached, further = set(), {module}
    while further:
        further = set().union(*map(of_the_room, further)) - reached
        reached |= further
    assert module not in reached


@pytest.mark.parametrize("old", OLD)
def test_laws_of_users_find_what_they_need_under_its_old_name_and_are_told_the_new_one(old):
    new, law = old.replace("plant", "engine"), f"from kerfgym.{old} import *\n"
    sys.modules.pop(f"kerfgym.{old}", None)
    space = {"__name__": "mine"}
    with pytest.warns(DeprecationWarning, match=f"kerfgym.{old} has moved to kerfgym.{new}") as told:
        exec(compile(law, "mine.py", "exec"), space)
    assert told[0].filename == "mine.py"
    own = vars(importlib.import_module(f"kerfgym.{new}"))
    names = {name for name, thing in own.items() if getattr(thing, "__module__", "") == f"kerfgym.{new}"}
    assert names >= {"part", "clip", "sine"} or names >= {"Quantity", "InvalidInput"}
    assert all(space[name] is own[name] for name in names if not name.startswith("_"))
    assert not [name for name in SOURCES if old in imported(name, SOURCES[name])]  # nobody in the package needs it


def test_the_walk_over_imports_sees_both_spellings():
    assert "envs.engine.lanes" in {
        name.rpartition(".")[0] for name in imported("envs.plant.sheet", SOURCES["envs.plant.sheet"])
    }
    assert any(name.startswith("envs.control.stack") for name in imported("baselines", SOURCES["baselines"]))
    assert any(
        name.startswith("baselines")
        for name in imported("experiments.tune.searches", SOURCES["experiments.tune.searches"])
    )


def test_every_sub_package_is_installed_with_its_data():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    folders = {"kerfgym", *(f"kerfgym.{name}" for name, path in SOURCES.items() if path.name == "__init__.py")}
    folders -= {f"kerfgym.{name}" for name in SOURCES if name.startswith(AT_HOME)}
    assert set(settings["tool"]["setuptools"]["packages"]) == folders
    assert settings["project"]["version"] == kerfgym.__version__
    shipped = {p for pattern in settings["tool"]["setuptools"]["package-data"]["kerfgym"] for p in ROOT.glob(pattern)}
    data = {p for layer in LAYERS for ending in ("toml", "html", "csv") for p in (ROOT / layer).rglob(f"*.{ending}")}
    assert data <= shipped


# ------------------------------------------------------------------------------------------------------ documentation


def public(node, prefix=""):
    """Public functions and classes of a module and public methods of its public classes."""
    for child in node.body:
        if isinstance(child, ast.FunctionDef | ast.ClassDef) and not child.name.startswith("_"):
            yield prefix + child.name, child
            if isinstance(child, ast.ClassDef):
                yield from public(child, f"{prefix}{child.name}.")


@pytest.mark.parametrize("module", SOURCES)
def test_every_public_name_is_documented(module):
    tree = ast.parse(SOURCES[module].read_text(encoding="utf-8"))
    assert ast.get_docstring(tree) or not tree.body, f"{module} has no docstring"
    bare = [name for name, node in public(tree) if not ast.get_docstring(node)]
    assert not bare, f"{module}: {bare}"


def declared():
    """Every class of the package with declared quantities, by name."""
    found = {}
    for name in SOURCES:
        if name.split(".")[0] in ("envs", "baselines") and name not in OLD:
            for cls in vars(importlib.import_module(f"kerfgym.{name}")).values():
                if is_part(cls) and quantities(cls):
                    found[f"{cls.__module__}.{cls.__qualname__}"] = cls
    return found


@pytest.mark.parametrize(("name", "cls"), declared().items())
def test_every_tunable_number_has_a_unit_a_meaning_a_source_and_a_default_within_its_range(name, cls):
    assert inspect.getdoc(cls)
    for field, quantity in quantities(cls).items():
        where = f"{name}.{field}"
        default = cls._field_defaults[field]
        assert quantity.doc, where
        assert quantity.source, where
        assert quantity.unit or quantity.choices, where
        assert quantity.low <= default <= quantity.high, where
        assert quantity.check(default, where) == default
        if quantity.log:
            assert quantity.low > 0, where
        if quantity.choices:
            assert (quantity.low, quantity.high) == (0, len(quantity.choices) - 1), where


def test_there_are_numbers_to_tune():
    names = {name.removeprefix("kerfgym.") for name in declared()}
    assert {"envs.plant.filters.Params", "envs.plant.supervisor.Params", "baselines.pid.Params"} <= names


# ------------------------------------------------------------------------------------------------------------- caches

ROLL = """
import hashlib, json, sys, gymnasium, kerfgym
from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.experiments.measure import rollout
scenario = scenarios.load("wavy").varied(duration=0.2, settle=0.0, head={"nominal": True})
record = rollout.roll(scenario, stack.resolve(sys.argv[1]), [1000])
reward = None
if "with the environment" in sys.argv:
    env = gymnasium.make("kerfgym/HeightFollowing-v0", scenario="wavy", machine={"head": {"nominal": True}})
    env.reset(seed=0)
    reward = env.step([0.5])[1]
print(json.dumps([kerfgym.__file__, hashlib.sha256(record["gap"].tobytes()).hexdigest(), reward]))
"""

LAW = """
from typing import NamedTuple


class Memory(NamedTuple):
    nothing: float = 0.0


class Mine:
    Params = State = Memory

    def init(params):
        return Memory(0.0)

    def control(params, state, signals, tables):
        return state, -50.0 * (signals.height - signals.set_height)
"""


def edited(path, old, new):
    text = path.read_text(encoding="utf-8")
    assert text.count(old) == 1
    path.write_text(text.replace(old, new), encoding="utf-8")


def compiled(package):
    """Names and ages of everything in the caches of a copy."""
    return {p.name: p.stat().st_mtime_ns for p in package.rglob("__pycache__/*.o")}


def test_an_edit_anywhere_is_seen_by_the_next_run_and_nothing_else_is_compiled(tmp_path):
    package, law = tmp_path / "kerfgym", tmp_path / "mine.py"
    package.mkdir()
    shutil.copy2(ROOT / "__init__.py", package)
    for layer in LAYERS:
        shutil.copytree(ROOT / layer, package / layer)
    law.write_text(LAW, encoding="utf-8")

    def run(what="with the environment"):
        file, gaps, reward = python(ROLL, f"{law}:Mine", what, cwd=tmp_path, path=tmp_path)
        assert Path(file).parent == package
        return gaps, reward, compiled(package)

    def renewed(before, after):
        return {name for name, age in after.items() if before.get(name) != age}

    gaps, reward, cache = run()
    assert run() == (gaps, reward, cache)  # the same bits, nothing compiled

    edited(law, "-50.0 * (", "-55.0 * (")
    gaps_law, reward_law, cache_law = run()
    assert gaps_law != gaps
    assert reward_law == reward
    assert renewed(cache, cache_law)
    assert all("_stage" in name and "mine" in name for name in renewed(cache, cache_law))  # the law's own loop alone

    edited(package / "envs" / "tasks" / "interface.py", "TOLERANCE = 0.002", "TOLERANCE = 0.004")
    gaps_env, reward_env, cache_env = run()
    assert gaps_env == gaps_law
    assert reward_env != reward
    assert all(name.startswith("interface.") for name in renewed(cache_law, cache_env))

    edited(package / "envs" / "plant" / "z_axis.py", "clip(command, -p.speed", "clip(0.9 * command, -p.speed")
    gaps_part, _, cache_part = run("without")
    assert gaps_part not in (gaps, gaps_law)
    assert any(name.startswith("machine._advance") for name in renewed(cache_env, cache_part))
