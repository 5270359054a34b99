"""Adjoints of parts: each kind of statement against finite differences, and what has none is refused by name."""

from typing import NamedTuple

import numpy as np
import pytest

from kerfgym.baselines import pid, self_tuning
from kerfgym.envs.engine.adjoint import Array, Fixed, adjoint
from kerfgym.envs.engine.compiler import for_python
from kerfgym.envs.engine.lanes import as_bits, clip, exponential, fma, logarithm, power, sine
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import z_axis
from kerfgym.envs.plant.controller import Sensed


class Inner(NamedTuple):
    """A part of a part."""

    a: float = 1.5
    on: bool = True


class Outer(NamedTuple):
    """Numbers and a part between them."""

    x: float = 0.7
    inner: Inner = Inner()
    y: float = 2.25


def _arithmetic(x, y):
    return x * y - x / y + -x + (+y) ** 3 - 2.0 * x


def _functions(x, y):
    z = np.sqrt(x) + logarithm(y) * exponential(-x) + sine(x * y) + power(x, y)
    return fma(x, y, z) + abs(x - y) + abs(y - x) + np.float64(x)


def _limits(x, y):
    return min(x, y) * x + max(x, y, 0.1) * y + clip(3.0 * x, 0.0, 1.0) + clip(x * x, 0.0, 9.0)


def _ternary(x, y):
    far = 1.0 / (x - 0.7) if x != 0.7 else 0.0  # infinite where it does not count
    return (x * x if x < y else y) + (x if x > y or y < 0.0 else 2.0 * x) + far


def _branches(x, y):
    z, w = x, 0.0
    if x < y and not y < 1.0:
        z = x * y
        w = z * z
    elif x > 10.0:
        z = 0.0
    z += w
    z *= 2.0
    return z


def _early(x, y):
    if x > y:
        return x * x
    if y > 2.0:
        z = x * y
        return z * z
    return 3.0 * x


def _loops(x, y):
    total, factor = 0.0, x
    for i in range(4):
        for _j in range(i):
            total += factor * y
        factor *= x
    return total


def _tuples(x, y):
    o = Outer(x, Inner(a=x * y), y)._replace(y=y * y)
    (a, b), c = _pair(o), o.inner
    return a * b * c.a * Outer().y + _pair(o)[0]


def _pair(o):
    return o.x * o.inner.a, o.y if o.inner.on else 0.0


PARTS = (_arithmetic, _functions, _limits, _ternary, _branches, _early, _loops, _tuples)


def slopes(function, *at: float) -> list[float]:
    """Derivatives by central differences, extrapolated."""
    found = []
    for i in range(len(at)):

        def cut(h, i=i):
            x = [[v + s * h * (j == i) for j, v in enumerate(at)] for s in (1, -1)]
            return (function(*x[0]) - function(*x[1])) / (2 * h)

        found.append((4 * cut(5e-5) - cut(1e-4)) / 3)
    return found


@pytest.mark.parametrize("function", PARTS)
@pytest.mark.parametrize("at", [(0.7, 2.25), (1.6, 1.1), (0.4, 1.3)])
def test_the_adjoint_of_a_part_is_its_slope(function, at):
    made = adjoint(function, float, float)
    wanted = slopes(function, *at)
    if function is _ternary and at[0] == 0.7:  # the branch is a point
        wanted = slopes(lambda x, y: (x * x if x < y else y) + 2.0 * x, *at)
    np.testing.assert_allclose(made(*at, 1.0), wanted, rtol=1e-7, atol=1e-8)
    assert made(*at, -2.0) == pytest.approx([-2.0 * x for x in made(*at, 1.0)])


@pytest.mark.parametrize("function", PARTS)
def test_compiled_adjoints_are_those_of_python(function):
    made = adjoint(function, float, float)
    np.testing.assert_allclose(for_python(made)(1.6, 1.1, 1.0), made(1.6, 1.1, 1.0), rtol=1e-13)


def _gathered(m, table, k, x):
    m[k] = x * m[k + 1]
    old = m[k]
    if x > 1.0:
        m[k + 1] += old * old * table[k]
    m[0] = 2.0
    return m[k] * m[k + 1] + m[0] * x


def test_arrays_are_read_written_and_left_as_they_were_found():
    made, k, x = adjoint(_gathered, Array, Array, int, float), 1, 1.3
    m, table, weights = np.array([0.3, 0.5, 0.9]), np.array([1.0, 2.0, 3.0]), np.array([0.2, -0.4, 0.7])

    def whole(numbers):
        n, t = np.array(numbers[:3]), np.array(numbers[3:6])
        return _gathered(n, t, k, numbers[6]) + weights @ n

    bar, table_bar = weights.copy(), np.zeros(3)
    (d_x,) = made(m, table, k, x, 1.0, bar, table_bar)
    wanted = slopes(lambda *numbers: whole(numbers), *m, *table, x)
    np.testing.assert_allclose([*bar, *table_bar, d_x], wanted, rtol=1e-7, atol=1e-9)
    assert m.tolist() == [0.3, 0.5, 0.9]


def _summed(m, count, x):
    total = 0.0
    for i in range(np.int64(count)):
        total += m[i] * x
    return total


def test_a_loop_of_unknown_count_is_read_up_to_its_longest():
    m, bar = np.array([1.0, 2.0, 4.0]), np.zeros(3)
    made = adjoint(_summed, Array, float, float, wrt=("x",), longest=3)
    assert made(m, 2.0, 5.0, 1.0, bar) == (3.0,)
    assert bar.tolist() == [5.0, 5.0, 0.0]
    with pytest.raises(InvalidInput, match="a loop whose count is not known beforehand"):
        adjoint(_summed, Array, float, float)


def _rounded(x):
    return np.rint(x * 3.0) / 3.0 + np.floor(x) * x


def test_rounding_passes_the_adjoint_on_and_floor_passes_none():
    assert adjoint(_rounded, float)(2.3, 1.0) == (pytest.approx(1.0 + 2.0),)


def test_fixed_arguments_are_not_asked_for():
    made = adjoint(z_axis.step, z_axis.Params, z_axis.Gains, z_axis.Pace, z_axis.State, float, float, Fixed(False),
                   wrt=("s",))  # fmt: skip
    assert made.__code__.co_varnames[: made.__code__.co_argcount] == ("p", "g", "r", "s", "share", "dt", "result_0",
                                                                      "result_1")  # fmt: skip


def _while(x):
    while x > 1.0:
        x = x * 0.5
    return x


def _bits(x):
    return as_bits(x)


def _lists(x):
    return [x][0]


def _string(x):
    return x + "a"


def _halfway(x):
    if x > 0.0:
        return x
    x = 2.0


@pytest.mark.parametrize(
    ("function", "what"),
    [(_while, "'while'"), (_bits, "'as_bits'"), (_lists, r"\[x\]"), (_string, "x \\+ 'a'"),
     (_halfway, "returns only sometimes")],
)  # fmt: skip
def test_what_has_no_adjoint_is_refused_with_its_place(function, what):
    with pytest.raises(InvalidInput, match=rf"test_adjoint\.py, line \d+: .*{what}") as refused:
        adjoint(function, float)
    line = int(str(refused.value).split("line ")[1].split(":")[0])
    assert 0 <= line - function.__code__.co_firstlineno <= 3


def test_only_numbers_have_adjoints():
    with pytest.raises(InvalidInput, match="'y' is no NamedTuple and no float"):
        adjoint(_arithmetic, float, bool, wrt=("y",))


def _pid(params, state, height):
    signals = Sensed(height=height, set_height=1.0, captured=True, fresh=False)
    return pid.control(params, state, signals, 0)


def test_a_whole_classical_law_has_its_adjoint():
    params, state = pid.Params(lag=2.0), pid.State(3.0, 0.1, 5.0)
    ((*by_params,), _, by_height) = adjoint(_pid, pid.Params, pid.State, float)(
        params, state, 1.3, pid.State(0.0, 0.0, 0.0), 1.0
    )
    wanted = slopes(lambda *x: _pid(pid.Params(*x[:5]), state, x[5])[1], *params, 1.3)
    np.testing.assert_allclose([*by_params, by_height], wanted, rtol=1e-6, atol=1e-8)


def _tuned(params, state, height, position, memory):
    signals = Sensed(height=height, raw_height=height, set_height=1.0, head_position=position, captured=True,
                     frequency=1e6, valid=True, fresh=False)  # fmt: skip
    return self_tuning.control(params, state, signals, 0, memory)


def test_a_law_that_learns_has_its_adjoint():
    """Recursive least squares, rings and all."""
    rng = np.random.default_rng(0)
    params, memory = self_tuning.Params(), np.zeros(self_tuning.MEMORY)
    state = self_tuning.init(params)
    signals = Sensed(height=1.0, raw_height=1.0, set_height=1.0, captured=True, frequency=1e6, valid=True)
    for i in range(60):
        x, noise = 0.1 * np.sin(0.05 * i), 1e-3 * rng.normal()
        now = signals._replace(head_position=x, raw_height=1.0 + noise, height=1.0 + noise, fresh=i == 0)
        state, _ = self_tuning.control(params, state, now, np.zeros(0), memory)
    made = adjoint(_tuned, self_tuning.Params, self_tuning.State, float, float, Array, wrt=("params", "position"),
                   longest=4)  # fmt: skip
    bar = np.zeros(len(memory))
    none = self_tuning.State(*(0.0,) * 15, False)
    by_params, by_position = made(params, state, 1.002, 0.02, memory, none, 1.0, bar)
    names = ("kp", "feed", "lead", "sharpen", "smith", "lag")

    def command(*numbers):
        changed = params._replace(**dict(zip(names, numbers[:-1], strict=True)))
        return _tuned(changed, state, 1.002, numbers[-1], memory.copy())[1]

    wanted = slopes(command, *(getattr(params, name) for name in names), 0.02)
    np.testing.assert_allclose(
        [*(getattr(by_params, name) for name in names), by_position], wanted, rtol=1e-5, atol=1e-7
    )
