"""Blocks of machines in one array: the only file that knows where a number lies.

A block holds ``W`` machines ("lanes") as ``ROWS × W`` float64, flat: row ``r`` of lane ``j`` of block ``b`` lies at
``(b·ROWS + r)·W + j``. A machine is a column; a stage of the control period is a loop over the lanes of a block, which
the compiler vectorises. :func:`load` and :func:`store` move a part's NamedTuple between a column and local variables,
so parts are written as scalar functions that know nothing of any of this.

What keeps the lane loops vectorised, all found by measurement: unsigned indices, no gathers and no libm calls in them
(:func:`sine` and :func:`logarithm` are polynomials), integers and flags kept as floats, no fast-math (it would give
the last lanes of a block other bits than the first). ``kerfgym speed`` shows when one of these is lost.
"""

import collections
import ctypes
import functools
from collections.abc import Callable, Iterable
from fractions import Fraction
from typing import Any, TypeVar, get_type_hints

import numpy as np

W = 32
"""Lanes in a block."""

U = np.uint64
UW = U(W)
U0, U1, U2, U3, U4 = U(0), U(1), U(2), U(3), U(4)

PARTS: set[Callable[..., Any]] = set()
"""Functions that compiled code may call."""

_F = TypeVar("_F", bound=Callable[..., Any])


def part(function: _F) -> _F:
    """Decorator of every function of a part: compiled, and inlined into the loop of the kernel that calls it.

    In Python it stays what it is.
    """
    PARTS.add(function)
    return function


STAGES: set[Callable[..., Any]] = set()
"""Parts that are loops over the lanes of a block."""


def stage(function: _F) -> _F:
    """Decorator of a loop over the lanes: compiled by itself, because the vectoriser gives up in larger functions."""
    STAGES.add(function)
    return part(function)


# ---------------------------------------------------------------------------------------------- parts in a column


@functools.cache
def kinds(cls: Any) -> tuple[Any, ...]:
    """Types of a part's fields, in order."""
    given = tuple(cls.__annotations__.values())
    if any(isinstance(kind, str) for kind in given):
        return tuple(get_type_hints(cls).values())
    return tuple(getattr(kind, "__origin__", kind) for kind in given)  # the same, but quicker


def is_part(kind: Any) -> bool:
    """Whether ``kind`` is a NamedTuple class."""
    return isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields")


def rows(cls: Any) -> int:
    """Number of rows that a part's NamedTuple takes."""
    return sum(rows(kind) if is_part(kind) else 1 for kind in kinds(cls))


def fields(cls: Any, prefix: str = "") -> list[str]:
    """Dotted names of a part's numbers in row order: ``["window", "trim"]``, ``["sheet.tilt", …]``."""
    names: list[str] = []
    for name, kind in zip(cls._fields, kinds(cls), strict=True):
        names += fields(kind, f"{prefix}{name}.") if is_part(kind) else [prefix + name]
    return names


def row(cls: Any, field: str) -> np.uint64:
    """Offset of a number from the place of its part, by its dotted name."""
    return U(fields(cls).index(field) * W)


def flat(value: Any) -> list[float]:
    """A part's numbers in row order."""
    return [x for v in value for x in (flat(v) if isinstance(v, tuple) else [float(v)])]


def unflat(cls: Any, numbers: Iterable[float]) -> Any:
    """The inverse of :func:`flat`."""
    stream = iter(numbers)

    def build(kind: Any) -> Any:
        if is_part(kind):
            return kind(*(build(k) for k in kinds(kind)))
        return kind(next(stream))

    return build(cls)


def extended(name: str, first: Any, more: Any, **defaults: Any) -> Any:
    """A NamedTuple class of the fields of ``first``, then those of ``more``; ``defaults`` take the place of theirs."""
    parts = (first, more)
    values = {field: value for part in parts for field, value in part._field_defaults.items()} | defaults
    make: Any = collections.namedtuple  # a checker wants to know the name
    made = make(name, [*first._fields, *more._fields], defaults=[*values.values()])
    made.__annotations__ = {field: kind for part in parts for field, kind in part.__annotations__.items()}
    made.__module__, made.__doc__, made.joined = more.__module__, more.__doc__, parts
    return made


class Layout:
    """Hands out consecutive rows; :attr:`rows` is their number so far, :attr:`parts` what has a name."""

    def __init__(self) -> None:
        self.rows = 0
        self.parts: dict[str, tuple[np.uint64, Any]] = {}

    def part(self, name: str, cls: Any) -> np.uint64:
        """Offset of a part that Python reads or writes by this name."""
        self.parts[name] = self.place(rows(cls)), cls
        return self.parts[name][0]

    def place(self, count: int) -> np.uint64:
        """Offset of ``count`` new rows within a block."""
        here, self.rows = self.rows, self.rows + count
        return U(here * W)


# ------------------------------------------------------------------------------------------------ instructions

# Compiled code gets instructions of the processor in their place (:mod:`compiler`); in Python they are what they say.


def load(cls: Any, block: Any, at: Any) -> Any:
    """The part ``cls`` from the column at ``at``."""
    return unflat(cls, block[int(at) : int(at) + rows(cls) * W : W].tolist())


def store(block: Any, at: Any, value: Any) -> None:
    """Writes a part into the column at ``at``."""
    numbers = flat(value)
    block[int(at) : int(at) + len(numbers) * W : W] = numbers


# Unboxing an array costs Python 0.2 µs a piece, so a kernel gets addresses and makes its own views.


def doubles(address: Any, size: Any) -> Any:
    """The float64 array of ``size`` numbers at ``address``."""
    return np.ctypeslib.as_array((ctypes.c_double * int(size)).from_address(int(address)))


def singles(address: Any, size: Any) -> Any:
    """The float32 array of ``size`` numbers at ``address``."""
    return np.ctypeslib.as_array((ctypes.c_float * int(size)).from_address(int(address)))


def flags(address: Any, size: Any) -> Any:
    """The uint8 array of ``size`` numbers at ``address``."""
    return np.ctypeslib.as_array((ctypes.c_uint8 * int(size)).from_address(int(address)))


def words(address: Any, size: Any) -> Any:
    """The uint64 array of ``size`` numbers at ``address``."""
    return np.ctypeslib.as_array((ctypes.c_uint64 * int(size)).from_address(int(address)))


def call(function: Any, block: Any, at: Any, n: Any, tables: Any, size: Any) -> None:
    """Calls the compiled stage at address ``function`` with five unsigned integers."""
    ctypes.CFUNCTYPE(None, *[ctypes.c_uint64] * 5)(int(function))(int(block), int(at), int(n), int(tables), int(size))


def scratch(size: Any) -> Any:
    """A float64 array of ``size`` numbers (known when compiling) that lives until the function ends."""
    return np.empty(int(size))


def take(array: Any, i: Any) -> Any:
    """``array[i]``, which one thread at a time counts up by 1."""
    value = array[i]
    array[i] += U1
    return value


def fma(a: Any, b: Any, c: Any) -> Any:
    """a·b + c, rounded once: one instruction instead of two, the same in every lane."""
    return np.float64(Fraction(float(a)) * Fraction(float(b)) + Fraction(float(c)))


def choose(test: Any, a: Any, b: Any) -> Any:
    """``a if test else b`` of numbers that are both known: no branch, so quick to compile where there are hundreds."""
    return a if test else b


def as_bits(x: Any) -> Any:
    """The 64 bits of a number."""
    return np.float64(x).view(np.uint64)


def as_number(z: Any) -> Any:
    """The number with these 64 bits."""
    return np.uint64(z).view(np.float64)


# --------------------------------------------------------------------------------- random numbers, functions

GOLD, _M1, _M2 = U(0x9E3779B97F4A7C15), U(0xBF58476D1CE4E5B9), U(0x94D049BB133111EB)
_S1, _S2, _S4, _S11, _S27, _S30, _S31, _S56 = U(1), U(2), U(4), U(11), U(27), U(30), U(31), U(56)
_A1, _AF, _A3, _A5 = U(0x0101010101010101), U(0x0F0F0F0F0F0F0F0F), U(0x3333333333333333), U(0x5555555555555555)


@part
def bits(key, n):
    """The ``n``-th 64 random bits of stream ``key`` (splitmix64, Steele et al. 2014): no state, any order."""
    z = key + n * GOLD
    z = (z ^ (z >> _S30)) * _M1
    z = (z ^ (z >> _S27)) * _M2
    return z ^ (z >> _S31)


@part
def uniform(z):
    """Random bits to a number in [0, 1)."""
    return np.float64(np.int64(z >> _S11)) * (1.0 / 9007199254740992.0)


@part
def gauss(z, u):
    """Random bits and an independent uniform number to a nearly normal one, mean 0 and variance 1.

    The number of ones in 64 bits is binomial with variance 16; ``u`` fills the gap between two counts (variance 1/12).
    Its tails end at ±8 sigma, its kurtosis is 2.97.
    """
    x = z - ((z >> _S1) & _A5)
    x = (x & _A3) + ((x >> _S2) & _A3)
    x = (x + (x >> _S4)) & _AF
    count = np.float64(np.int64((x * _A1) >> _S56))
    return (count - 32.5 + u) * 0.24935149047701482  # 1/sqrt(16 + 1/12)


@part
def clip(x, low, high):
    """``x`` limited to [low, high]."""
    return max(low, min(high, x))


@part
def sine(x):
    """sin(x) to 3e-11 for |x| < 1e5, by a polynomial that vectorises."""
    k = np.floor(fma(x, 0.3183098861837907, 0.5))
    y = fma(-k, 3.178650954705639e-08, fma(-k, 3.1415926218032837, x))
    y2 = y * y
    odd = fma(y2, fma(y2, -2.3846693895829946e-8, 2.752261884662379e-6), -1.9840804039010531e-4)
    s = y * fma(y2, fma(y2, fma(y2, odd, 8.3333304956694724e-3), -1.6666666606466932e-1), 1.0)
    return s * fma(-2.0, fma(-2.0, np.floor(k * 0.5), k), 1.0)


def as_bits32(x: Any) -> Any:
    """The 32 bits of a single-precision number."""
    return np.float32(x).view(np.uint32)


def as_number32(z: Any) -> Any:
    """The single-precision number with these 32 bits."""
    return np.uint32(z).view(np.float32)


_EXPONENT, _MANTISSA, _ONE, _S52 = U(0x7FF), U(0x000FFFFFFFFFFFFF), U(0x3FF0000000000000), U(52)


@part
def logarithm(x):
    """ln(x) to 1e-10 for normal x > 0, by a series that vectorises."""
    z = as_bits(x)
    exponent = np.float64(np.int64((z >> _S52) & _EXPONENT)) - 1023.0
    mantissa = as_number((z & _MANTISSA) | _ONE)
    high = mantissa > 1.4142135623730951
    m = mantissa * 0.5 if high else mantissa
    e = exponent + 1.0 if high else exponent
    s = (m - 1.0) / (m + 1.0)
    q = s * s
    series = fma(q, fma(q, fma(q, fma(q, fma(q, fma(q, 1 / 13, 1 / 11), 1 / 9), 1 / 7), 1 / 5), 1 / 3), 1.0)
    return fma(e, 0.6931471805599453, 2.0 * s * series)


_S1023 = np.int64(1023)


@part
def exponential(x):
    """e^x to 1e-14 for |x| < 700, beyond it as at ±700; a polynomial that vectorises."""
    y = clip(x, -700.0, 700.0)
    k = np.rint(y * 1.4426950408889634)
    r = fma(-k, 1.9082149292705877e-10, fma(-k, 0.693147180369123816490, y))
    p = fma(r, fma(r, fma(r, fma(r, 1 / 39916800, 1 / 3628800), 1 / 362880), 1 / 40320), 1 / 5040)
    p = fma(r, fma(r, fma(r, fma(r, fma(r, fma(r, p, 1 / 720), 1 / 120), 1 / 24), 1 / 6), 0.5), 1.0)
    return fma(r, p, 1.0) * as_number(U(np.int64(k) + _S1023) << _S52)


@part
def power(x, y):
    """x^y for normal x > 0."""
    return exponential(y * logarithm(x))


F32 = np.float32
_LN2, _SQRT2, _HALF = F32(0.6931472), F32(1.4142135), F32(0.5)
_EXPONENT32, _MANTISSA32, _ONE32, _S23 = np.uint32(0xFF), np.uint32(0x007FFFFF), np.uint32(0x3F800000), np.uint32(23)
_C3, _C4, _C5 = F32(3.3333331174e-1), F32(-2.4999993993e-1), F32(2.0000714765e-1)
_C6, _C7, _C8 = F32(-1.6668057665e-1), F32(1.4249322787e-1), F32(-1.2420140846e-1)
_C9, _C10, _C11 = F32(1.1676998740e-1), F32(-1.1514610310e-1), F32(7.0376836292e-2)


@part
def logarithm32(x):
    """ln(x) for normal single-precision x ≥ 1, to single precision (polynomial of Cephes' logf, Moshier 1989)."""
    z = as_bits32(x)
    exponent = np.float32(np.int32((z >> _S23) & _EXPONENT32)) - F32(127.0)
    mantissa = as_number32((z & _MANTISSA32) | _ONE32)
    upper = mantissa > _SQRT2
    m = (mantissa * _HALF if upper else mantissa) - F32(1.0)
    e = exponent + F32(1.0) if upper else exponent
    m2 = m * m
    m4 = m2 * m2  # the polynomial in pairs, which do not wait for one another
    low, high = (_C3 + m * _C4) + m2 * (_C5 + m * _C6), (_C7 + m * _C8) + m2 * (_C9 + m * _C10)
    p = low + m4 * (high + m4 * _C11)
    return m + (m2 * (m * p - _HALF) + e * _LN2)


def mix(*numbers: Any) -> np.ndarray:
    """A 64-bit key from whole numbers (arrays broadcast); each number goes through a full avalanche."""
    with np.errstate(over="ignore"):
        key = np.full(np.broadcast(*numbers).shape, GOLD, np.uint64)
        for number in numbers:
            z = (key ^ np.asarray(number).astype(np.uint64)) + GOLD
            z = (z ^ (z >> _S30)) * _M1
            z = (z ^ (z >> _S27)) * _M2
            key = z ^ (z >> _S31)
    return key
