"""Kernels: the cache and what can befall it, laws of users, and compiled code against the same code in Python."""

import hashlib
import importlib.util
import os
import re
import shutil
import subprocess
import sys
from typing import NamedTuple

import numpy as np
import pytest
from numba.core import errors
from numba.core.runtime import _nrt_python, rtsys

from kerfgym.envs.engine import compiler, kernels
from kerfgym.envs.engine.columns import aligned
from kerfgym.envs.engine.compiler import for_python
from kerfgym.envs.engine.kernels import Kernel
from kerfgym.envs.engine.lanes import (
    UW,
    Layout,
    U,
    W,
    bits,
    doubles,
    flat,
    fma,
    gauss,
    load,
    logarithm,
    rows,
    sine,
    store,
    uniform,
)
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import controller, filters, heads, idle, machine, z_axis
from kerfgym.envs.plant.controller import make_law, stage_of
from kerfgym.envs.plant.fleet import Fleet
from kerfgym.envs.plant.machine import DT, SUBSTEPS

FOUR = U(4)


def _scaled(address):
    x = doubles(address, FOUR)
    for i in range(4):
        x[i] = fma(x[i], 2.0, 1.0)


def _added(address, size):
    x = doubles(address, size)
    for i in range(1, size):
        x[0] += x[i]


SMALL = """
from kerfgym.envs.engine.lanes import U, doubles

FOUR = U(4)

def scaled(address):
    x = doubles(address, FOUR)
    for i in range(4):
        x[i] = 2.0 * x[i] + 1.0
"""


def scaled(kernel: Kernel) -> list[float]:
    x = np.array([1.0, -2.5, 0.0, 1e6])
    kernel(x.ctypes.data)
    return x.tolist()


SCALED = [3.0, -4.0, 1.0, 2e6 + 1.0]


def imported(path):
    """The module in the file ``path``, as it is now."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)
    exec(compile(path.read_text(), path, "exec"), module.__dict__)  # Python's own cache goes by whole seconds
    return module


def run(program: str, folder, **environment: str) -> str:
    """What a program in a process of its own prints; ``folder`` holds modules that it may import."""
    out = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, "PYTHONPATH": str(folder), **environment},
    )
    assert out.returncode == 0, out.stderr
    return out.stdout.strip()


@pytest.fixture(autouse=True)
def forgotten():
    """Modules of one test do not take the place of another's."""
    yield
    for name in ("small", "helper", "laws"):
        sys.modules.pop(name, None)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A cache that holds the machine and nothing else."""
    folder = tmp_path / "cache"
    folder.mkdir()
    together = machine.advance._together
    assert machine.advance.address
    shutil.copy(kernels._file(together), folder)
    monkeypatch.setenv("KERFGYM_CACHE_DIR", str(folder))
    monkeypatch.setattr(controller, "_stages", {})
    kernels.cache_folder.cache_clear()
    yield folder
    kernels.cache_folder.cache_clear()


@pytest.fixture
def compilations(monkeypatch):
    """Names of the functions that the compiler has been asked for."""
    names = []
    plain = compiler.compiled

    def compiled(functions):
        names.append([f.__name__ for f in functions.values()])
        return plain(functions)

    monkeypatch.setattr(compiler, "compiled", compiled)
    return names


def kept(cache, name: str = "*") -> list:
    """Files in the cache beside the machine's."""
    return sorted(f for f in cache.glob(name) if not f.name.startswith("machine."))


# ----------------------------------------------------------------------------------------------------------- the cache


def test_a_warm_process_steps_an_environment_without_the_compiler(tmp_path):
    program = (
        "import sys, gymnasium, kerfgym\n"
        "env = gymnasium.make('kerfgym/HeightFollowing-v0')\n"
        "env.reset(seed=0)\n"
        "print(env.step([0.25])[0].tolist(), 'numba' in sys.modules)\n"
    )
    first = run(program, tmp_path)
    observation, _, numbas = run(program, tmp_path).rpartition(" ")
    assert observation == first.rpartition(" ")[0]
    assert numbas == "False"


def test_a_kernel_is_compiled_once_and_then_comes_from_its_file(cache, compilations):
    assert scaled(Kernel(_scaled)) == SCALED
    assert scaled(Kernel(_scaled)) == SCALED
    assert compilations == [["_scaled"]]
    assert len(kept(cache)) == 1


def test_kernels_together_share_a_file_and_a_bound_kernel_needs_no_argument(cache, compilations):
    for _ in range(2):
        first = Kernel(_scaled)
        second = Kernel(_added).together_with(first)
        x = np.array([1.0, -2.5, 0.0, 1e6])
        step = first.bound(x)
        step()
        assert x.tolist() == SCALED
        second(x.ctypes.data, 3)
        assert x[0] == 3.0 - 4.0 + 1.0
    assert compilations == [["_scaled", "_added"]]
    assert len(kept(cache)) == 1


@pytest.mark.parametrize(
    ("kernel", "given", "message"),
    [
        (_scaled, 12345, "12345 keeps nothing alive"),
        (_scaled, np.zeros((4, 4))[:, 0], "not C contiguous"),
        (_scaled, np.broadcast_to(0.0, 4), "not writable"),
        (_added, np.zeros(4), "has 2 arguments; only a kernel of one can be bound"),
    ],
)
def test_what_a_kernel_cannot_be_bound_to_is_refused_at_once(cache, kernel, given, message):
    with pytest.raises(TypeError, match=message):
        Kernel(kernel).bound(given)


def _flipped(content: bytes) -> bytes:
    return content[:-100] + bytes([content[-100] ^ 1]) + content[-99:]


DAMAGES = {
    "empty": lambda content: b"",
    "cut in the code": lambda content: content[:-100],
    "cut in the head": lambda content: content[:10],
    "head only": lambda content: content.partition(b"\n")[0] + b"\n",
    "longer": lambda content: content + b"\0",
    "a bit": _flipped,
    "noise": lambda content: np.random.default_rng(0).bytes(len(content)),
    "noise behind the head": lambda content: (
        content.partition(b"\n")[0] + b"\n" + np.random.default_rng(0).bytes(len(content.partition(b"\n")[2]))
    ),
    "no head": lambda content: content.partition(b"\n")[2],
    "another head": lambda content: b"[]\n" + content.partition(b"\n")[2],
    "a head without the sum": lambda content: b'{"runtime": false}\n' + content.partition(b"\n")[2],
    "text": lambda content: b"garbage\n",
}


def test_a_damaged_file_is_compiled_anew(cache, compilations):
    assert scaled(Kernel(_scaled)) == SCALED
    (file,) = kept(cache)
    for name, damaged in DAMAGES.items():
        file.write_bytes(damaged(file.read_bytes()))
        compilations.clear()
        assert scaled(Kernel(_scaled)) == SCALED, name
        assert compilations == [["_scaled"]], name
        assert scaled(Kernel(_scaled)) == SCALED, name
        assert compilations == [["_scaled"]], name  # it is sound again
    assert kept(cache) == [file]


def test_processes_that_compile_the_same_kernel_at_once_all_get_it_and_leave_one_sound_file(
    tmp_path, cache, compilations
):
    (tmp_path / "small.py").write_text(SMALL)
    program = (
        "import sys, numpy, numba, small\n"
        "from kerfgym.envs.engine import compiler, kernels\n"
        "print('ready', flush=True)\n"
        "input()\n"
        "x = numpy.array([1.0, -2.5, 0.0, 1e6])\n"
        "kernels.Kernel(small.scaled)(x.ctypes.data)\n"
        "print(x.tolist())\n"
    )
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", program],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": str(tmp_path)},
        )
        for _ in range(2)
    ]
    assert [process.stdout.readline() for process in processes] == ["ready\n"] * 2
    for process in processes:
        process.stdin.write("\n")
        process.stdin.flush()
    assert [process.communicate(timeout=60)[0] for process in processes] == [f"{SCALED}\n"] * 2
    (file,) = kept(cache)
    assert file.suffix == ".o"
    assert scaled(Kernel(imported(tmp_path / "small.py").scaled)) == SCALED
    assert compilations == []


@pytest.mark.parametrize(
    ("blocked", "used"),
    [
        ([], "cache"),
        (["cache"], "__pycache__"),
        (["cache", "__pycache__"], "user/kerfgym/*"),
        (["cache", "__pycache__", "user"], "temporary/kerfgym-*"),
    ],
)
def test_where_no_folder_can_be_made_the_next_place_is_taken(tmp_path, monkeypatch, blocked, used):
    (tmp_path / "small.py").write_text(SMALL)
    (tmp_path / "temporary").mkdir()
    for name in blocked:
        (tmp_path / name).write_text("a file where a folder should be")
    monkeypatch.setenv("KERFGYM_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    assert scaled(Kernel(imported(tmp_path / "small.py").scaled)) == SCALED
    assert [f.name.partition("-")[0] for f in tmp_path.glob(f"{used}/*.o")] == ["small.scaled"]
    assert len(list(tmp_path.rglob("*.o"))) == 1


@pytest.mark.parametrize("failing", ["tempfile.mkstemp", "os.replace"])
def test_a_kernel_that_cannot_be_written_runs_all_the_same_and_leaves_nothing(cache, monkeypatch, failing):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(failing, full)
    assert scaled(Kernel(_scaled)) == SCALED
    assert kept(cache) == []


def imported_small(cache, factor: float):
    file = cache.parent / "small.py"
    file.write_text(SMALL.replace("2.0 *", f"{factor} *"))
    return imported(file).scaled


def test_another_stamp_takes_another_file_and_removes_the_one_before(cache, compilations, monkeypatch):
    old, new = (imported_small(cache, factor) for factor in (2.0, 3.0))
    tripled = [4.0, -6.5, 1.0, 3e6 + 1.0]
    assert scaled(Kernel(old)) == SCALED
    (before,) = kept(cache)
    assert scaled(Kernel(new)) == SCALED  # the stamp alone tells what is in a file
    monkeypatch.setattr(kernels, "STAMP", "of edited sources")
    assert scaled(Kernel(new)) == tripled
    (after,) = kept(cache)
    assert after != before
    assert scaled(Kernel(old)) == tripled
    assert scaled(Kernel(old, "extra")) == SCALED  # so does the text of what else is in it
    assert len(compilations) == 3


def test_the_stamp_changes_with_every_source_of_engine_and_plant(tmp_path, monkeypatch):
    envs = kernels.pathlib.Path(kernels.__file__).parent.parent
    sources = [source.relative_to(envs) for folder in ("engine", "plant") for source in (envs / folder).glob("*.py")]
    for source in sources:
        (tmp_path / source).parent.mkdir(exist_ok=True)
        shutil.copy(envs / source, tmp_path / source)
    monkeypatch.setattr(kernels, "__file__", str(tmp_path / "engine" / "kernels.py"))
    stamps = {kernels._stamp()}
    assert stamps == {kernels.STAMP}
    for source in sources:
        with (tmp_path / source).open("a") as file:
            file.write("#")
        stamps.add(kernels._stamp())
    (tmp_path / "plant" / "more.py").touch()
    stamps.add(kernels._stamp())
    assert len(stamps) == len(sources) + 2 > 25


# --------------------------------------------------------------------------------------------------- parts changed


class _Inner(NamedTuple):
    a: float = 5.0
    on: bool = False


class _Mixed(NamedTuple):
    x: float = 1.0
    on: bool = True
    inner: _Inner = _Inner()


class _Alike(NamedTuple):
    x: float = 3.0
    y: float = 4.0


def _changed(x, y):
    mixed = _Mixed(x, y > 0.0, _Inner(y, True))
    mixed = mixed._replace(on=x > 5.0, inner=mixed.inner._replace(a=7))
    alike = _Alike(x, y)._replace(y=x)
    return mixed.x, mixed.on, mixed.inner.a, mixed.inner.on, alike.x, alike.y


def test_a_part_with_some_fields_replaced_is_the_same_compiled_as_in_python():
    for x, y in ((6.0, -1.0), (2.0, 3.0)):
        assert for_python(_changed)(x, y) == _changed(x, y) == (x, x > 5.0, 7.0, True, x, x)


def _misspelt(x):
    return _Alike(x, x)._replace(z=x)


def test_only_fields_that_there_are_can_be_replaced():
    with pytest.raises(errors.TypingError, match="_replace takes fields of _Alike by name"):
        for_python(_misspelt)(1.0)


# ---------------------------------------------------------------------------------------------------- laws of users

LAWS = """
import numba
import numpy as np
from typing import NamedTuple

import helper
from kerfgym.envs.engine.lanes import part


class P(NamedTuple):
    gain: float = 20.0


class S(NamedTuple):
    n: float = 0.0


class Law:
    Params, State = P, S

    def init(params):
        return S(0.0)


class Plain(Law):
    def control(params, state, signals, tables):
        return S(state.n + 1.0), -params.gain * state.n


class Compiled(Law):
    @numba.njit
    def control(params, state, signals, tables):
        return S(state.n + 1.0), -params.gain * state.n


class Helped(Law):
    def control(params, state, signals, tables):
        return S(state.n + 1.0), helper.times(state.n) + helper.MORE


class Choosing(Law):
    def control(params, state, signals, tables):
        return state, 1.0 if "a" in {"a", "b", "c", "d", "e"} else 0.0


class Allocating(Law):
    def control(params, state, signals, tables):
        a = np.zeros(4)
        for i in range(4):
            a[i] += state.n * i
        return S(state.n + 1.0), a.sum()


class Raising(Law):
    def control(params, state, signals, tables):
        if state.n > 1000.0:
            raise ValueError("too far")
        return state, 0.0


class LettingRaise(Law):
    def control(params, state, signals, tables):
        return S(state.n + 1.0), helper.limited(state.n)


class Asserting(Law):
    def control(params, state, signals, tables):
        assert state.n < 1000.0
        return state, 0.0


class Opening(Law):
    def control(params, state, signals, tables):
        open("log.txt")
        return state, 0.0


class Printing(Law):
    def control(params, state, signals, tables):
        print("height", signals.height)
        return state, 0.0


class CallingBack(Law):
    def control(params, state, signals, tables):
        with numba.objmode(y="float64"):
            y = 3.0
        return state, y


class Misspelt(Law):
    def control(params, state, signals, tables):
        return state, params.gian


class Peeping(Law):
    def control(params, state, signals, tables):
        return state, signals.gap


class Undefined(Law):
    def control(params, state, signals, tables):
        return state, nowhere


class Untupled(Law):
    def control(params, state, signals, tables):
        return (state.n,), 0.0


class Whole(Law):
    def control(params, state, signals, tables):
        return S(1), 0.0


class Bare(Law):
    def control(params, state, signals, tables):
        return 0.0
"""

HELPER = """
import numba

MORE = 0.0


@numba.njit
def times(x):
    return 2.0 * x


@numba.njit
def limited(x):
    if x > 1.0:
        raise ValueError("too far")
    return x
"""


@pytest.fixture
def own(tmp_path, cache):
    """A file of the user's with laws, and one with a function that they call."""
    (tmp_path / "laws.py").write_text(LAWS)
    return tmp_path


def spaces(own, helper: str = HELPER):
    """The user's module as it is now."""
    (own / "helper.py").write_text(helper)
    imported(own / "helper.py")
    return imported(own / "laws.py")


def law(own, name: str, helper: str = HELPER):
    return make_law(getattr(spaces(own, helper), name), f"laws:{name}")


def commands(a_law, steps: int = 3) -> list[float]:
    """What the law asks of the second of two machines."""
    fleet, found = Fleet(2, a_law, heads.POOL), []
    fleet.begin([0, 1], [0, 1])
    for _ in range(steps):
        fleet.advance()
        found.append(float(fleet.slots(machine.WISH, 1, 1)[0]))
    return found


@pytest.mark.parametrize("name", ["Plain", "Compiled"])
def test_a_law_may_be_compiled_by_the_user_and_stays_callable_from_python(own, name):
    space = spaces(own)
    control = getattr(space, name).control
    before = control(space.P(), space.S(3.0), None, None)
    assert commands(make_law(getattr(space, name), f"laws:{name}")) == [-20.0, -40.0, -60.0]
    assert control(space.P(), space.S(3.0), None, None) == before == (space.S(4.0), -60.0)


REFUSED = {
    "Raising": r"a compiled law runs inside the machine, so it cannot raise \(.*laws\.py, line \d+\)",
    "LettingRaise": r"a compiled law runs inside the machine, so it cannot raise \(.*helper\.py, line \d+\)",
    "Asserting": r"a compiled law runs inside the machine, so it cannot raise \(.*laws\.py, line \d+\)",
    "Opening": r"Untyped global name 'open': .* \(.*laws\.py, line \d+\)",
    "Printing": r"compiled code runs without Python, so it cannot print or call Python back",
    "CallingBack": r"compiled code runs without Python, so it cannot print or call Python back",
    "Misspelt": r"Unknown attribute 'gian' of type P.* \(.*laws\.py, line \d+\)",
    "Peeping": r"Unknown attribute 'gap' of type Sensed.* \(.*laws\.py, line \d+\)",
    "Undefined": r"NameError: name 'nowhere' is not defined",
    "Untupled": r"UniTuple\(float64 x 1\) is not a NamedTuple",
    "Whole": r"S\(int64 x 1\) is not S\(float64 x 1\)",
    "Bare": r"failed to unpack float64",
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_law_that_cannot_be_compiled_is_refused_by_name(own, cache, name):
    a_law = law(own, name)
    for _ in range(2):
        with pytest.raises(InvalidInput) as refused:
            stage_of(a_law, machine.LAW_PLACES)
        assert re.fullmatch(f"controller 'laws:{name}' cannot be compiled: {REFUSED[name]}", str(refused.value))
    assert kept(cache) == []


def test_a_law_may_allocate_and_frees_what_it_takes(own):
    a_law = law(own, "Allocating")
    assert commands(a_law) == [6.0, 12.0, 18.0]
    _nrt_python.memsys_enable_stats()
    try:
        before = rtsys.get_allocation_stats()
        commands(a_law, 50)
        after = rtsys.get_allocation_stats()
    finally:
        _nrt_python.memsys_disable_stats()
    assert after.alloc - before.alloc >= 100
    assert after.alloc - before.alloc == after.free - before.free


def test_a_law_that_allocates_comes_from_the_cache_too(own, cache):
    assert commands(law(own, "Allocating")) == [6.0, 12.0, 18.0]
    program = (
        "import sys, numpy, laws\n"
        "from kerfgym.envs.plant import heads, machine\n"
        "from kerfgym.envs.plant.controller import make_law\n"
        "from kerfgym.envs.plant.fleet import Fleet\n"
        "fleet = Fleet(2, make_law(laws.Allocating, 'laws:Allocating'), heads.POOL)\n"
        "fleet.begin([0, 1], [0, 1])\n"
        "fleet.advance(3)\n"
        "print(fleet.slots(machine.WISH, 1, 1)[0], 'kerfgym.envs.engine.compiler' in sys.modules)\n"
    )
    assert run(program, own) == "18.0 False"


def test_a_law_is_compiled_anew_when_what_it_takes_from_another_file_changes(own, cache, compilations):
    assert commands(law(own, "Helped")) == [2.0, 4.0, 6.0]
    assert commands(law(own, "Helped", HELPER.replace("2.0 * x", "3.0 * x"))) == [3.0, 6.0, 9.0]
    assert commands(law(own, "Helped", HELPER.replace("MORE = 0.0", "MORE = 0.5"))) == [2.5, 4.5, 6.5]
    assert commands(law(own, "Helped", HELPER.replace("x", "other_name") + "\nUNUSED = 1.0\n")) == [2.0, 4.0, 6.0]
    assert compilations == [["_stage"]] * 3
    assert len(kept(cache)) == 3


def test_a_law_is_compiled_anew_when_its_own_file_changes(own, cache):
    assert commands(law(own, "Plain")) == [-20.0, -40.0, -60.0]
    (own / "laws.py").write_text(LAWS.replace("-params.gain * state.n", "params.gain * state.n"))
    assert commands(law(own, "Plain")) == [20.0, 40.0, 60.0]


def made_in_a_loop(gain: float, offset: tuple[float, float], table: np.ndarray):
    """A law without a file of its own, as in a notebook."""

    class Memory(NamedTuple):
        n: float = 0.0

    class Mine:
        Params, State = idle.Params, Memory

        def init(params):
            return Memory(0.0)

        def control(params, state, signals, tables):
            return Memory(state.n + 1.0), gain * state.n + offset[1] + table[1]

    return make_law(Mine, "mine")


def test_laws_of_one_name_and_text_that_hold_other_numbers_do_not_share_code(cache):
    table = np.zeros(2)
    assert commands(made_in_a_loop(1.0, (0.0, 0.0), table)) == [1.0, 2.0, 3.0]
    assert commands(made_in_a_loop(2.0, (0.0, 0.0), table)) == [2.0, 4.0, 6.0]
    assert commands(made_in_a_loop(1.0, (0.0, 0.25), table)) == [1.25, 2.25, 3.25]
    assert commands(made_in_a_loop(1.0, (0.0, 0.0), table + 0.5)) == [1.5, 2.5, 3.5]


def test_a_laws_stamp_is_the_same_in_every_process(own, tmp_path):
    stamps = [hashlib.sha256(law(own, name).source.encode()).hexdigest() for name in ("Helped", "Choosing")]
    program = (
        "import hashlib, laws\n"
        "from kerfgym.envs.plant.controller import make_law\n"
        "for law in (laws.Helped, laws.Choosing):\n"
        "    print(hashlib.sha256(make_law(law, 'laws').source.encode()).hexdigest())\n"
    )
    assert run(program, own, PYTHONHASHSEED="1").split() == stamps


# ------------------------------------------------------------------------------------------- Python and machine code

_layout = Layout()
MOTOR, AXIS, DRIVE, GAINS = (_layout.place(rows(c)) for c in (z_axis.State, z_axis.Params, z_axis.Drive, z_axis.Gains))
COMMAND, HEADS = _layout.place(1), _layout.place(SUBSTEPS)
ALL = U(_layout.rows * W)


def _axes(address, lanes):
    """A control period of Z axes side by side."""
    block = doubles(address, ALL)
    for a in range(lanes):
        p = load(z_axis.Params, block, a + AXIS)
        store(block, a + DRIVE, z_axis.accept(p, load(z_axis.Drive, block, a + DRIVE), block[a + COMMAND]))
        store(block, a + GAINS, z_axis.gains(p, DT))
    for k in range(SUBSTEPS):
        here = HEADS + U(k) * UW
        for a in range(lanes):
            p, g = load(z_axis.Params, block, a + AXIS), load(z_axis.Gains, block, a + GAINS)
            r = z_axis.pace(p, load(z_axis.Drive, block, a + DRIVE))
            s, head = z_axis.step(p, g, r, load(z_axis.State, block, a + MOTOR), (k + 1.0) / SUBSTEPS, DT)
            store(block, a + MOTOR, s)
            block[a + here] = head


def _filtered(p, x, start, slope, out):
    s = filters.State(start, 1e6, 0.0, 0.0)
    for n in range(x.size):
        fold = filters.begin()
        for age in range(int(p.window)):
            fold = filters.take(p, fold, x[n - age] if n >= age else start, float(age))
        s, out[n] = filters.finish(p, s, filters.mean(p, fold), x[n], slope)


FILTERED = for_python(_filtered)


def _numbers(x, out):
    for i in range(x.size):
        out[0, i] = sine(x[i])
        out[1, i] = logarithm(abs(x[i]))
        out[2, i] = gauss(bits(U(i), U(3)), uniform(bits(U(i), U(4))))


def bits_of(x: np.ndarray) -> list[int]:
    return x.ravel().view(np.uint64).tolist()


def test_a_z_axis_in_python_lives_the_same_bits_as_in_a_kernel_and_alone():
    rng = np.random.default_rng(8)
    block = aligned(_layout.rows * W).reshape(-1, W)
    for lane in range(W):
        spread = [x * rng.uniform(0.7, 1.4) for x in flat(z_axis.Params())]
        p = z_axis.Params(*spread)._replace(dead_time=rng.uniform(0.0, 4.0))
        p = p._replace(dac=p.dac * (lane % 3 > 0), backlash=p.backlash * (lane % 5 > 0))
        block[int(AXIS) // W :, lane][: rows(z_axis.Params)] = flat(p)
        block[int(MOTOR) // W :, lane][: rows(z_axis.State)] = flat(z_axis.at_rest(rng.normal()))
    blocks = [aligned(block.size) for _ in range(3)]
    kernel, alone = Kernel(_axes), for_python(_axes)
    for _ in range(6):
        command = rng.uniform(-600.0, 600.0, W)
        for one, step in zip(blocks, (_axes, kernel, alone), strict=True):
            if not one.any():
                one[:] = block.ravel()
            one.reshape(-1, W)[int(COMMAND) // W] = command
            step(one.ctypes.data, W)
    python, compiled, called = map(bits_of, blocks)
    assert python == compiled == called
    assert np.isfinite(blocks[0]).all()
    assert blocks[0].reshape(-1, W)[int(HEADS) // W :].std(axis=0).min() > 1e-5


@pytest.mark.parametrize("kind", filters.KINDS)
def test_a_filter_in_python_gives_the_same_bits_as_compiled(kind):
    rng = np.random.default_rng(9)
    settings = {
        "window": rng.integers(3, 12),
        "trim": kind == "improved",
        "ratio": rng.uniform(0.5, 1.0),
        "tau": rng.uniform(0.5, 5.0),
        "trust": rng.uniform(0.1, 2.0),
    }
    p = filters.Params(kind=float(filters.KINDS.index(kind)))._replace(**{k: float(v) for k, v in settings.items()})
    x = 4e6 + np.cumsum(rng.normal(0.0, 500.0, 300)) + 4e4 * (rng.random(300) < 0.1)
    outs = [np.empty(300) for _ in range(2)]
    for filtered, out in zip((_filtered, FILTERED), outs, strict=True):
        filtered(p, x, 4e6, 127e3, out)
    assert bits_of(outs[0]) == bits_of(outs[1])
    assert outs[0].std() > 0.0


def test_functions_and_random_numbers_in_python_are_the_same_bits_as_compiled():
    x = np.random.default_rng(10).normal(0.0, 10.0, 400)
    outs = [np.empty((3, x.size)) for _ in range(2)]
    with np.errstate(over="ignore"):
        _numbers(x, outs[0])
    for_python(_numbers)(x, outs[1])
    assert bits_of(outs[0]) == bits_of(outs[1])


def test_only_a_written_fma_is_rounded_once():
    def _products(x, out):
        for i in range(x.size - 2):
            out[0, i] = x[i] * x[i + 1] + x[i + 2]
            out[1, i] = fma(x[i], x[i + 1], x[i + 2])

    x = np.random.default_rng(11).normal(size=200)
    outs = [np.zeros((2, 200)) for _ in range(2)]
    _products(x, outs[0])
    for_python(_products)(x, outs[1])
    assert bits_of(outs[0]) == bits_of(outs[1])
    assert 10 < (outs[0][0] != outs[0][1]).sum() < 190
