"""Blocks of machines in one array: the only file that knows where a number lies.

A block holds ``W`` machines ("lanes") as ``ROWS × W`` float64, flat: row ``r`` of lane ``j`` of block ``b`` lies at
``(b·ROWS + r)·W + j``. A machine is a column; a stage of the control period is a loop over the lanes of a block, which
the compiler vectorises. :func:`load` and :func:`store` move a part's NamedTuple between a column and local variables,
so parts are written as scalar functions that know nothing of any of this.

What keeps the lane loops vectorised, all found by measurement: unsigned indices, no gathers and no libm calls in them
(:func:`sine` and :func:`logarithm` are polynomials), integers and flags kept as floats, no fast-math (it would give
the last lanes of a block other bits than the first). ``kerfgym speed`` shows when one of these is lost.

Kernels are cached on disk. Numba looks only at a kernel's own file to decide whether its cache is stale, so
:func:`kernel` stamps each entry with a hash of all sources it can contain.
"""

import hashlib
import pathlib
import types as python_types
from collections.abc import Callable, Iterable
from typing import Any, get_type_hints

import numpy as np
from llvmlite import ir
from numba import carray, njit, types
from numba.core import cgutils
from numba.extending import intrinsic

W = 32
"""Lanes in a block."""

U = np.uint64
UW = U(W)
U0, U1, U2, U3, U4 = U(0), U(1), U(2), U(3), U(4)

part = njit(forceinline=True, error_model="numpy")
"""Decorator of every function of a part: compiled, and inlined into the loop that calls it."""


# ---------------------------------------------------------------------------------------------- parts in a column


def is_part(kind: Any) -> bool:
    """Whether ``kind`` is a NamedTuple class."""
    return isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields")


def rows(cls: Any) -> int:
    """Number of rows that a part's NamedTuple takes."""
    return sum(rows(kind) if is_part(kind) else 1 for kind in get_type_hints(cls).values())


def fields(cls: Any, prefix: str = "") -> list[str]:
    """Dotted names of a part's numbers in row order: ``["window", "trim"]``, ``["sheet.tilt", …]``."""
    names: list[str] = []
    for name, kind in get_type_hints(cls).items():
        names += fields(kind, f"{prefix}{name}.") if is_part(kind) else [prefix + name]
    return names


def flat(value: Any) -> list[float]:
    """A part's numbers in row order."""
    return [x for v in value for x in (flat(v) if isinstance(v, tuple) else [float(v)])]


def unflat(cls: Any, numbers: Iterable[float]) -> Any:
    """The inverse of :func:`flat`."""
    stream = iter(numbers)

    def build(kind: Any) -> Any:
        if is_part(kind):
            return kind(*(build(k) for k in get_type_hints(kind).values()))
        return kind(next(stream))

    return build(cls)


class Layout:
    """Hands out consecutive rows; :attr:`rows` is their number so far."""

    def __init__(self) -> None:
        self.rows = 0

    def place(self, count: int) -> np.uint64:
        """Offset of ``count`` new rows within a block."""
        here, self.rows = self.rows, self.rows + count
        return U(here * W)


# Written as instructions rather than as functions, because Numba would compile a function for every class.


def _numba_type(cls: Any) -> Any:
    kinds = get_type_hints(cls).values()
    inner = [_numba_type(k) if is_part(k) else (types.boolean if k is bool else types.float64) for k in kinds]
    return types.BaseTuple.from_types(inner, cls)


def _cell(builder, data, at, row):
    # The compiler prefers 256-bit vectors where 512-bit ones slow the clock down a little; lane loops gain more.
    set.add(builder.function.attributes, '"prefer-vector-width"="512"')
    return builder.gep(data, [builder.add(at, ir.Constant(ir.IntType(64), row * W))])


def _read(context, builder, cls, data, at, row):
    """Instructions that read ``cls`` from ``row`` on; returns its value and the next free row."""
    values = []
    for kind in get_type_hints(cls).values():
        if is_part(kind):
            value, row = _read(context, builder, kind, data, at, row)
        else:
            value, row = builder.load(_cell(builder, data, at, row)), row + 1
            if kind is bool:
                value = builder.fcmp_unordered("!=", value, ir.Constant(ir.DoubleType(), 0.0))
        values.append(value)
    return context.make_tuple(builder, _numba_type(cls), values), row


def _write(context, builder, cls, data, at, row, value):
    """Instructions that write ``value`` from ``row`` on; returns the next free row."""
    parts = cgutils.unpack_tuple(builder, value)
    for kind, x in zip(get_type_hints(cls).values(), parts, strict=True):
        if is_part(kind):
            row = _write(context, builder, kind, data, at, row, x)
        else:
            if kind is bool:
                x = builder.uitofp(x, ir.DoubleType())
            builder.store(x, _cell(builder, data, at, row))
            row += 1
    return row


@intrinsic
def load(typingctx, cls, block, at):
    """The part ``cls`` from the column at ``at`` (compiled code only; in Python see ``Fleet.get``)."""
    kind = cls.instance_class

    def codegen(context, builder, signature, args):
        data = context.make_array(block)(context, builder, args[1]).data
        return _read(context, builder, kind, data, args[2], 0)[0]

    return _numba_type(kind)(cls, block, types.uint64), codegen


@intrinsic
def store(typingctx, block, at, value):
    """Writes a part into the column at ``at`` (compiled code only; in Python see ``Fleet.put``)."""
    kind = value.instance_class
    whole = _numba_type(kind)

    def codegen(context, builder, signature, args):
        data = context.make_array(block)(context, builder, args[0]).data
        _write(context, builder, kind, data, args[1], 0, args[2])
        return context.get_dummy_value()

    return types.none(block, types.uint64, whole), codegen


# ------------------------------------------------------------------------------------------------- addresses

# Unboxing an array costs Python 0.2 µs a piece, so a kernel gets one array of addresses and makes its own views.


@intrinsic
def _doubles(typingctx, address):
    def codegen(context, builder, signature, args):
        return builder.inttoptr(args[0], ir.DoubleType().as_pointer())

    return types.CPointer(types.float64)(types.uint64), codegen


@intrinsic
def _singles(typingctx, address):
    def codegen(context, builder, signature, args):
        return builder.inttoptr(args[0], ir.FloatType().as_pointer())

    return types.CPointer(types.float32)(types.uint64), codegen


@intrinsic
def _words(typingctx, address):
    def codegen(context, builder, signature, args):
        return builder.inttoptr(args[0], ir.IntType(64).as_pointer())

    return types.CPointer(types.uint64)(types.uint64), codegen


@part
def doubles(address, size):
    """The float64 array of ``size`` numbers at ``address``."""
    return carray(_doubles(address), (size,))


@part
def singles(address, size):
    """The float32 array of ``size`` numbers at ``address``."""
    return carray(_singles(address), (size,))


@part
def words(address, size):
    """The uint64 array of ``size`` numbers at ``address``."""
    return carray(_words(address), (size,))


@intrinsic
def call(typingctx, function, block, at, n, tables, size):
    """Calls the compiled stage at address ``function`` with five unsigned integers."""
    word = ir.IntType(64)

    def codegen(context, builder, signature, args):
        kind = ir.FunctionType(ir.VoidType(), [word] * 5)
        builder.call(builder.inttoptr(args[0], kind.as_pointer()), args[1:])
        return context.get_dummy_value()

    return types.none(*([types.uint64] * 6)), codegen


# -------------------------------------------------------------------------------------------- kernels and their cache


def _stamp() -> str:
    digest = hashlib.sha256(str(W).encode())
    for path in sorted(pathlib.Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


STAMP = _stamp()
"""Hash of all sources of the plant, which any kernel may contain."""


def kernel(function: Callable[..., Any], extra: str = "") -> Any:
    """``function`` compiled at its first call, cached on disk, and compiled anew when a source has changed.

    ``extra`` is the text of whatever else the kernel contains: a controller, an environment's observation.
    """
    compiled = njit(error_model="numpy", nogil=True, cache=True)(function)
    compiled._cache._cache_file._source_stamp = STAMP + hashlib.sha256(extra.encode()).hexdigest()
    return compiled


def specialise(template: Callable[..., Any], name: str, extra: str = "", **filled: Any) -> Any:
    """``template`` compiled with other globals, under a name, and so a cache file, of its own.

    A kernel that takes a function as an argument or from a closure is never cached, hence this.
    """
    assert isinstance(template, python_types.FunctionType)
    function = python_types.FunctionType(
        template.__code__, {**template.__globals__, **filled}, template.__name__, template.__defaults__
    )
    function.__module__ = template.__module__
    function.__qualname__ = f"{template.__name__}.{name}"
    return kernel(function, extra)


STAGE = types.void(*([types.uint64] * 5))
"""Signature of a stage that is called by address: block, at, lanes, tables, size of the tables."""


def address_of(stage: Any) -> int:
    """Address of a compiled stage (see :data:`STAGE`) for :func:`call`."""
    stage.compile(STAGE.args)
    overload_ = stage.overloads[STAGE.args]
    return overload_.library.get_pointer_to_function(overload_.fndesc.llvm_cfunc_wrapper_name)


# --------------------------------------------------------------------------------- random numbers, functions

GOLD, _M1, _M2 = U(0x9E3779B97F4A7C15), U(0xBF58476D1CE4E5B9), U(0x94D049BB133111EB)
_S1, _S2, _S4, _S11, _S27, _S30, _S31, _S56 = U(1), U(2), U(4), U(11), U(27), U(30), U(31), U(56)
_A1, _AF, _A3, _A5 = U(0x0101010101010101), U(0x0F0F0F0F0F0F0F0F), U(0x3333333333333333), U(0x5555555555555555)


@part
def bits(key, n):
    """The ``n``-th 64 random bits of stream ``key`` (splitmix64, Steele 2014): no state, any order."""
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
    k = np.floor(x * 0.3183098861837907 + 0.5)
    y = (x - k * 3.1415926218032837) - k * 3.178650954705639e-08
    y2 = y * y
    odd = -1.9840804039010531e-4 + y2 * (2.752261884662379e-6 - y2 * 2.3846693895829946e-8)
    s = y * (1.0 + y2 * (-1.6666666606466932e-1 + y2 * (8.3333304956694724e-3 + y2 * odd)))
    return s * (1.0 - 2.0 * (k - 2.0 * np.floor(k * 0.5)))


@intrinsic
def _as_bits(typingctx, x):
    def codegen(context, builder, signature, args):
        return builder.bitcast(args[0], ir.IntType(64))

    return types.uint64(types.float64), codegen


@intrinsic
def _as_number(typingctx, z):
    def codegen(context, builder, signature, args):
        return builder.bitcast(args[0], ir.DoubleType())

    return types.float64(types.uint64), codegen


_EXPONENT, _MANTISSA, _ONE, _S52 = U(0x7FF), U(0x000FFFFFFFFFFFFF), U(0x3FF0000000000000), U(52)


@part
def logarithm(x):
    """ln(x) to 1e-10 for normal x > 0, by a series that vectorises."""
    z = _as_bits(x)
    exponent = np.float64(np.int64((z >> _S52) & _EXPONENT)) - 1023.0
    mantissa = _as_number((z & _MANTISSA) | _ONE)
    high = mantissa > 1.4142135623730951
    m = mantissa * 0.5 if high else mantissa
    e = exponent + 1.0 if high else exponent
    s = (m - 1.0) / (m + 1.0)
    q = s * s
    series = 1.0 + q * (1 / 3 + q * (1 / 5 + q * (1 / 7 + q * (1 / 9 + q * (1 / 11 + q * (1 / 13))))))
    return 2.0 * s * series + e * 0.6931471805599453


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
