"""Parts in C99: what is computed is what Python computes, bit by bit; what cannot be said is refused with its line."""

import ctypes
import math
import shutil
import subprocess
from typing import NamedTuple

import numpy as np
import pytest

from kerfgym.envs.engine.c99 import Unit
from kerfgym.envs.engine.c99.values import REAL, Row, Struct
from kerfgym.envs.engine.lanes import clip, exponential, logarithm, part
from kerfgym.envs.engine.quantity import InvalidInput

COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror", "-Wno-unused-function", "-O2",
         "-ffp-contract=off", "-fPIC", "-shared"]  # fmt: skip

pytestmark = pytest.mark.skipif(not COMPILERS, reason="no C compiler")

GAINS = np.array([0.5, 1.5, -2.0, 4.0])
"""Of each turn."""

CROSSED = np.array([[1.0, 2.0], [3.0, 4.0]])

MOST, TINY = 7, 1e-300


class Pair(NamedTuple):
    """Two numbers and a flag."""

    a: float  # mm
    b: float = 2.0  # mm/s
    up: bool = False


@part
def halves(x):
    """A number in two."""
    return x - 0.5, 0.5


@part
def scalar(x, y):
    """Operators, comparisons, choices, in the order of Python."""
    a, b = y, x
    a, b = b + a, a - b * x  # both from what they were
    c = (a - (b - x)) - -y / (x if abs(x) > 1e-3 else 1.0)
    d = min(max(c, -3.0, y), b, 8.0)
    e = c**2 - abs(d) ** 0.5 + (y * y + 0.25) ** (1.0 / 3.0)
    f = 1.0 if x < y <= d or not (x > 0.0 and y != d) else -1.0
    g = np.floor(e) + np.rint(0.3 * e) + np.sqrt(abs(c)) + 1 / 3
    h, rest = halves(g)
    return clip(f * h + rest, -1e6, 1e6) + TINY


@part
def looped(m, x):
    """Loops, places, early ends."""
    total, count = 0.0, 0
    for i in range(MOST):
        if i == 5:
            break
        if i == 1:
            continue
        for j in range(i, -1, -1):
            total += GAINS[j % 1 + (i // 2)] * m[i] if j < 2 else CROSSED[i // 3, 1] * x
        count += 1
        m[i] = total - m[MOST - i]
    while count < 9:
        count += 2
        m[count] -= x
    best = 0
    for i in range(4):
        if m[i] > m[best]:
            best = i
    if best > 2:
        return m[best] + count
    tail = m[3:MOST]
    tail[0], tail[1] = tail[1], tail[0]
    return tail[best] * count + len(GAINS) + m[np.int64(x)]


@part
def moved(p, x):
    """Structs, their copies, and flags."""
    q = p._replace(a=p.b + x, up=x > 1.0)
    if q.up and not p.up:
        q = q._replace(b=q.a * 2.0)
    r = Pair(q.b) if x < 0.0 else q
    return r._replace(b=r[0] - r.b)


@part
def pair_out(a, b, x):
    """A number of a pair that went through :func:`moved`."""
    got = moved(Pair(a, b, x > 2.0), x)
    return got.a + 10.0 * got.b + (100.0 if got.up else 0.0)


@part
def transcendental(x):
    """What works on bits."""
    return logarithm(abs(x) + 1e-3) + exponential(clip(x, -5.0, 5.0))


def built(tmp_path, compiler, unit, name, kinds):
    """The function of C of a part, callable."""
    given = [f"{'double *' if isinstance(k, Row) else 'double '}x{i}" for i, k in enumerate(kinds)]
    function = next(f for f in unit.functions.values() if f.name == name)
    call = ", ".join(f"x{i}" for i in function.arguments)
    idle = "".join(f"    (void)x{i};\n" for i in range(len(kinds)))
    text = "#include <math.h>\n#include <stdbool.h>\n#include <stdint.h>\n#include <stdlib.h>\n"
    text += f"{unit.declarations()}\n{unit.definitions()}\ndouble run({', '.join(given)});\n"
    text += f"double run({', '.join(given)})\n{{\n{idle}    return {name}({call});\n}}\n"
    (tmp_path / "part.c").write_text(text, encoding="utf-8")
    library = tmp_path / f"part-{compiler}.so"
    done = subprocess.run(
        [compiler, *FLAGS, "part.c", "-o", library.name, "-lm"], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    run = ctypes.CDLL(str(library)).run
    run.restype = ctypes.c_double
    run.argtypes = [ctypes.c_void_p if isinstance(k, Row) else ctypes.c_double for k in kinds]
    return run


def numbers(count, seed=0):
    """Usual ones, and those with which comparisons and limits go wrong."""
    rng = np.random.default_rng(seed)
    strange = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 1e-310, 1e300, -1.0, 1.0])
    return np.where(rng.random(count) < 0.2, rng.choice(strange, count), rng.normal(0, 3, count))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize(("function", "count"), [(scalar, 2), (pair_out, 3), (transcendental, 1)])
def test_what_c_computes_is_what_python_does_to_the_bit(tmp_path, compiler, function, count):
    unit = Unit()
    name = unit.function(function, (REAL,) * count).name
    run = built(tmp_path, compiler, unit, name, (REAL,) * count)
    for row in numbers(2000 * count).reshape(-1, count):
        if function is transcendental and not np.isfinite(row).all():
            continue
        expected, found = float(function(*row)), run(*row)
        assert found == expected or (math.isnan(found) and math.isnan(expected)), row


@pytest.mark.parametrize("compiler", COMPILERS)
def test_loops_and_places_are_those_of_python(tmp_path, compiler):
    unit = Unit()
    kinds = (Row("row", 12), REAL)
    run = built(tmp_path, compiler, unit, unit.function(looped, kinds).name, kinds)
    rng = np.random.default_rng(1)
    for _ in range(300):
        memory, x = rng.normal(size=12), float(rng.uniform(0, 11))
        mine = memory.copy()
        expected = looped(memory, x)
        assert run(mine.ctypes.data, x) == expected
        assert np.array_equal(mine, memory)


def test_a_place_made_of_a_real_number_never_lies_outside(tmp_path):
    unit = Unit()
    kinds = (Row("row", 12), REAL)
    run = built(tmp_path, COMPILERS[0], unit, unit.function(looped, kinds).name, kinds)
    assert "place_in(" in unit.definitions()
    for x in (1e18, -1e18, math.nan, math.inf, -5.0, 12.0):
        assert isinstance(run(np.zeros(12).ctypes.data, x), float)


def test_float_has_no_double_in_it():
    unit = Unit(single=True)
    unit.function(scalar, (REAL, REAL))
    unit.function(transcendental, (REAL,))
    unit.function(moved, (Struct("struct", Pair), REAL))
    text = unit.declarations() + unit.definitions()
    assert "double" not in text
    assert "logf(" in text
    assert "2.0f" in text


def test_names_units_and_comments_are_those_of_the_part():
    unit = Unit()
    unit.function(moved, (Struct("struct", Pair), REAL))
    unit.function(looped, (Row("row", 12), REAL))
    text = unit.declarations() + unit.definitions()
    assert "/* Two numbers and a flag. */" in text
    assert "double a; /* mm */" in text
    assert "bool up;" in text
    assert "/* Loops, places, early ends. */" in text
    assert "/* Of each turn. */\nstatic const double GAINS[4]" in text
    assert "static double test_c99_looped(double *m, double x)" in text


@part
def calls_itself(x):
    return calls_itself(x) if x > 0.0 else 0.0


@part
def formats(x):
    return len(f"{x}")


@part
def over_a_list(x):
    total = 0.0
    for each in (x, 2.0):
        total += each
    return total


@part
def not_a_part(x):
    return math.gamma(x)


@part
def sometimes(x):
    if x > 0.0:
        return x
    elif x < -1.0:
        return -x


@part
def mixed(x):
    y = 1.0
    y = Pair(x)
    return y.a


@part
def powered(x):
    return x % 3.0


@pytest.mark.parametrize(
    ("function", "why"),
    [
        (calls_itself, "calls itself"),
        (formats, "an expression of the kind JoinedStr"),
        (over_a_list, "a loop over something else than range()"),
        (not_a_part, "a call of math.gamma"),
        (sometimes, "does not return a value on every way"),
        (mixed, "'y' is now one kind of value and now another"),
        (powered, "the operator Mod"),
    ],
)
def test_what_cannot_be_said_is_refused_with_file_and_line(function, why):
    with pytest.raises(InvalidInput) as error:
        Unit().function(function, (REAL,))
    told = str(error.value)
    first = function.__code__.co_firstlineno
    lines = range(first, first + 8)
    assert why in told
    assert any(f"test_c99.py, line {line}" in told for line in lines), told
