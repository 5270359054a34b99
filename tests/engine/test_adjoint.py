"""Derivatives of parts: against finite differences, and where nothing can be read, a refusal that says where."""

import math
from typing import NamedTuple

import numpy as np
import pytest

from kerfgym.envs.engine.adjoint import adjoint, tangent
from kerfgym.envs.engine.lanes import clip, exponential, flat, fma, logarithm, part, sine, unflat
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import filters, z_axis


class Pair(NamedTuple):
    x: float = 0.0
    y: float = 0.0


class Nest(NamedTuple):
    inner: Pair = Pair()
    z: float = 0.0


@part
def _inner(a, b):
    return a * b if a > b else a / (b + 3.0)


@part
def everything(p, q, k, on):
    """One of each kind of statement."""
    total = 0.0
    for i in range(3):
        total += p.x * i - q.inner.y
    if p.y > 0.5:
        u, v = np.sqrt(p.y + 1.0), -p.x
    elif p.y > -2.0 and not p.x > 3.0:
        u, v = abs(p.y), p.x**2
    else:
        u, v = 1.0, 2.0
    if on:
        total -= _inner(u, v)
    changed = q._replace(z=min(q.z, u, k) + max(v, 0.1))
    total += logarithm(2.0 + u) + exponential(0.3 * v) * sine(changed.z) + clip(k, -1.0, 1.0)
    return Pair(fma(p.x, k, total), y=changed.inner.x), changed


@part
def early(x, y):
    if x > 1.0:
        return x * y
    if y > 1.0:
        z = y * y
        return z - x
    return x + 3.0 * y


@part
def with_memory(m, x):
    own = m[4:8]
    m[0] = m[1] * x + own[0]
    if x > 0.0:
        m[2] = own[1] * own[1]
    m[1] = m[0] + m[2]
    return m[1] * x


def numbers(value):
    """All numbers of a result in a row."""
    return np.array(flat(value) if isinstance(value, tuple) else [value], float)


def difference(function, x, direction, size=1e-5):
    """Derivative along a direction: central differences, extrapolated once (Richardson)."""
    central = [(function(x + h * direction) - function(x - h * direction)) / (2.0 * h) for h in (size, 0.5 * size)]
    return (4.0 * central[1] - central[0]) / 3.0


@pytest.mark.parametrize("on", [True, False])
def test_every_kind_of_statement_has_the_derivative_that_differences_have(on):
    back = adjoint(everything, of=("p", "q", "k"), p=Pair, q=Nest, k=float, on=on)
    random, met = np.random.default_rng(0), set()
    for _ in range(400):
        x = random.uniform(-4.0, 4.0, 6)
        weights = random.normal(size=5)

        def told(z, weights=weights):
            return weights @ numbers(everything(Pair(*z[:2]), Nest(Pair(*z[2:4]), z[4]), z[5], on))

        p, q = Pair(*x[:2]), Nest(Pair(*x[2:4]), x[4])
        p_, q_, k_ = back(p, q, x[5], Pair(*weights[:2]), unflat(Nest, weights[2:]))
        mine = np.array([*p_, *flat(q_), k_])
        theirs = [difference(told, x, direction) for direction in np.eye(6)]
        assert mine == pytest.approx(np.array(theirs), rel=1e-6, abs=1e-6)
        met.add((p.y > 0.5, p.y > -2.0, p.x > 3.0))
    assert len(met) >= 5  # the conditions went both ways


@pytest.mark.parametrize("on", [True, False])
def test_tangents_are_adjoints_the_other_way(on):
    """w·(J·d) = (Jᵀ·w)·d, for any direction d and weights w."""
    kinds = {"p": Pair, "q": Nest, "k": float, "on": on}
    back, forth = adjoint(everything, of=("p", "q", "k"), **kinds), tangent(everything, of=("p", "q", "k"), **kinds)
    random = np.random.default_rng(1)
    for _ in range(400):
        x, d, w = random.uniform(-4.0, 4.0, 6), random.normal(size=6), random.normal(size=5)
        given = Pair(*x[:2]), unflat(Nest, x[2:5]), x[5]
        bars = back(*given, Pair(*w[:2]), unflat(Nest, w[2:]))
        dots = forth(*given, Pair(*d[:2]), unflat(Nest, d[2:5]), d[5])
        assert w @ numbers(dots) == pytest.approx(d @ numbers(bars), rel=1e-10, abs=1e-10)


def test_a_tangent_of_what_is_true_or_false_is_false():
    class Told(NamedTuple):
        x: float = 0.0
        high: bool = False

    @part
    def told(x):
        return Told(3.0 * x, x > 1.0)

    assert tangent(told, of=("x",), x=float)(2.0, 1.0) == Told(3.0, False)


def test_a_part_that_writes_into_an_array_has_no_tangent():
    with pytest.raises(InvalidInput, match="writes into an array"):
        tangent(with_memory, of=("x",), m=np.ndarray, x=float)


def test_what_returns_early_has_the_derivative_of_the_way_it_took():
    back = adjoint(early, of=("x", "y"), x=float, y=float)
    assert back(2.0, 5.0, 1.0) == (5.0, 2.0)
    assert back(0.5, 5.0, 1.0) == (-1.0, 10.0)
    assert back(0.5, 0.5, 2.0) == (2.0, 6.0)


@pytest.mark.parametrize("x", [1.7, -0.6])
def test_arrays_are_read_and_written(x):
    back = adjoint(with_memory, of=("m", "x"), m=np.ndarray, x=float)
    random = np.random.default_rng(1)
    before, after_, out_ = random.normal(size=8), random.normal(size=8), random.normal()

    def told(z):
        m = z[:8].copy()
        return out_ * with_memory(m, z[8]) + after_ @ m

    bars = after_.copy()
    x_ = back(before.copy(), x, out_, bars)
    theirs = [difference(told, np.append(before, x), direction) for direction in np.eye(9)]
    assert np.append(bars, x_) == pytest.approx(np.array(theirs), rel=1e-7, abs=1e-8)


def test_rounding_passes_on_what_floor_stops():
    @part
    def rounded(x):
        return np.rint(x / 0.1) * 0.1 + np.floor(x)

    assert adjoint(rounded, of=("x",), x=float)(3.14, 1.0) == pytest.approx(1.0)


def test_a_side_that_does_not_count_may_divide_by_nothing():
    @part
    def safe(x, y):
        return x / y + np.sqrt(y) if y > 0.0 else 2.0 * x

    back = adjoint(safe, of=("x", "y"), x=float, y=float)
    with np.errstate(all="ignore"):  # NumPy's numbers divide by nothing as compiled ones do
        assert back(3.0, np.float64(0.0), 1.0) == (2.0, 0.0)
    assert back(3.0, 4.0, 1.0) == pytest.approx((0.25, -3.0 / 16.0 + 0.25))


def test_an_unfinished_part_of_the_machine_is_refused_with_its_place():
    @part
    def ring(m, tick):
        return m[tick]

    with pytest.raises(InvalidInput, match=r"test_adjoint\.py, line \d+\): places in arrays must be known"):
        adjoint(ring, of=("m",), m=np.ndarray, tick=float)

    @part
    def searches(x):
        while x > 1.0:
            x *= 0.5
        return x

    with pytest.raises(InvalidInput, match=r"no derivative of 'while x > 1\.0.*statements of this kind"):
        adjoint(searches, of=("x",), x=float)

    @part
    def foreign(x):
        return math.gamma(x)

    with pytest.raises(InvalidInput, match=r"math\.gamma.*neither a part nor a function whose derivative is known"):
        adjoint(foreign, of=("x",), x=float)
    with pytest.raises(InvalidInput, match=r"early takes \['x', 'y'\]; kinds are those of \['x'\]"):
        adjoint(early, of=("x",), x=float)


def test_parts_of_the_machine_are_read_as_they_are():
    p, d = z_axis.Params(dac=0.0), z_axis.Drive(1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0)
    entered = adjoint(z_axis.accept, of=("d", "command"), p=z_axis.Params, d=z_axis.Drive, command=float)
    bars = z_axis.Drive(1.0, 10.0, 100.0, 1e3, 1e4, 1e5, 1e6)
    d_, command_ = entered(p, d, 20.0, bars)
    assert d_ == (10.0, 100.0, 1e3, 1e4, 1e5, 1e6, 0.0)  # the oldest leaves the queue
    assert command_ == 1.0
    assert entered(p, d, 600.0, bars)[1] == 0.0  # beyond the drive's speed
    queued = adjoint(z_axis.pace, of=("d",), p=z_axis.Params, d=z_axis.Drive)
    assert queued(p._replace(dead_time=2.4), d, z_axis.Pace(1.0, 10.0, 0.0)) == (0.0, 0.0, 10.0, 1.0, 0.0, 0.0, 0.0)
    noted = adjoint(filters.take, of=("fold", "sample"), p=filters.Params, fold=filters.Fold, sample=float, age=0.0)
    fold_, sample_ = noted(filters.Params(filters.MEAN, 5.0), filters.begin(), 1e6, filters.Fold(1.0))
    assert fold_ == (1.0, 1e6, 0.0, 0.0, 0.0)
    assert sample_ == 1.0
