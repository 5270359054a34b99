"""Arithmetic of RS274/NGC, as LinuxCNC does it: angles in degrees, truth as 1 and 0."""

import math
from collections.abc import Callable

from ..engine.quantity import InvalidInput
from .gcode_parameters import Parameters

Evaluator = Callable[[Parameters], float]

EQUAL = 1e-6
"""Numbers that differ by less are the same for EQ and NE. [P] LinuxCNC, TOLERANCE_EQUAL"""


def _modulo(a: float, b: float) -> float:
    """The rest of a division, never negative."""
    rest = math.fmod(a, b)
    return rest + abs(b) if rest < 0.0 else rest


LEVELS: tuple[dict[str, Callable[[float, float], float]], ...] = (
    {
        "and": lambda a, b: float(a != 0.0 and b != 0.0),
        "or": lambda a, b: float(a != 0.0 or b != 0.0),
        "xor": lambda a, b: float((a != 0.0) != (b != 0.0)),
    },
    {
        "eq": lambda a, b: float(abs(a - b) < EQUAL),
        "ne": lambda a, b: float(abs(a - b) >= EQUAL),
        "gt": lambda a, b: float(a > b),
        "ge": lambda a, b: float(a >= b),
        "lt": lambda a, b: float(a < b),
        "le": lambda a, b: float(a <= b),
    },
    {"+": lambda a, b: a + b, "-": lambda a, b: a - b},
    {"*": lambda a, b: a * b, "/": lambda a, b: a / b, "mod": _modulo},
    {"**": lambda a, b: a**b},
)
"""Operators from the loosest to the tightest; each from left to right."""

FUNCTIONS: dict[str, Callable[[float], float]] = {
    "abs": abs,
    "sqrt": math.sqrt,
    "exp": math.exp,
    "ln": math.log,
    "fix": math.floor,
    "fup": math.ceil,
    "round": lambda a: math.copysign(math.floor(abs(a) + 0.5), a),
    "sin": lambda a: math.sin(math.radians(a)),
    "asin": lambda a: math.degrees(math.asin(a)),
    "cos": lambda a: math.cos(math.radians(a)),
    "acos": lambda a: math.degrees(math.acos(a)),
    "tan": lambda a: math.tan(math.radians(a)),
}


def angle(y: float, x: float) -> float:
    """ATAN[y]/[x], degrees."""
    return math.degrees(math.atan2(y, x))


def computed(name: str, function: Callable[..., float], where: str, *values: Evaluator) -> Evaluator:
    """``function`` of ``values``; nan where one of them is.

    Raises:
        InvalidInput: when it is evaluated: a result that is no finite number.
    """
    return lambda parameters: _result(name, function, where, *(value(parameters) for value in values))


def chained(
    first: Evaluator,
    operators: dict[str, Callable[[float, float], float]],
    rest: list[tuple[str, Evaluator]],
    where: str,
) -> Evaluator:
    """Operators of one level, from left to right; as :func:`computed`."""

    def evaluate(parameters: Parameters) -> float:
        value = first(parameters)
        for word, operand in rest:
            value = _result(word.upper(), operators[word], where, value, operand(parameters))
        return value

    return evaluate


def _result(name: str, function: Callable[..., float], where: str, *numbers: float) -> float:
    if any(number != number for number in numbers):
        return math.nan
    try:
        result = function(*numbers)
        result = math.inf if isinstance(result, complex) else float(result)
    except (ArithmeticError, ValueError):
        result = math.inf
    if not math.isfinite(result):
        raise InvalidInput(f"{where}: '{name}': cannot be computed of {' and '.join(f'{v:g}' for v in numbers)}")
    return result
