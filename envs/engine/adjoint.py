"""Derivatives of parts, made from their own text: reverse and forward mode (Griewank and Walther 2008).

Parts are written once. The compiler reads them as machine code; this module reads the same text as a graph of numbers,
and walks that graph backwards::

    back = adjoint(z_axis.step, p=z_axis.Params, g=z_axis.Gains, r=z_axis.Pace, s=z_axis.State, share=float, dt=float,
                   bristles=False, of=("r", "s"))
    r_, s_ = back(p, g, r, s, share, dt, (s_after_, head_))

``back`` is a part itself. A number's *adjoint*, written with a bar or here with an underscore, is the derivative of
whatever one asks for by that number: ``s_after_`` and ``head_`` are those of the results, ``r_`` and ``s_`` those of
the arguments that ``of`` names. They have the classes of what they belong to.

:func:`tangent` makes the other direction of the same graph: how results change when arguments do. That is the cheaper
one where little is moved and much depends on it, such as a law's few gains.

What can be read: assignments, arithmetic, comparisons, ``a if c else b``, ``if``, ``return``, loops over a ``range``
that is known beforehand, NamedTuples with ``_replace``, calls of other parts, arrays at indices that are known
beforehand, and the functions in :data:`KNOWN`. Both sides of a condition are computed, and the one that does not count
has an adjoint of 0. Anything else is refused with its file and line.

Where a derivative jumps (a limit, a sign, a comparison) it is that of the side on which the numbers are. ``np.floor``
has none. ``np.rint`` passes the adjoint on as if it did not round: that is the mean of a converter's steps, whose own
derivative of 0 would hide all that lies behind it.
"""

import ast
import builtins
import functools
import inspect
import linecache
import math
import textwrap
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from . import lanes
from .quantity import InvalidInput


class Number(int):
    """A number of a graph: the index of the node that computes it."""

    __slots__ = ()


class Struct:
    """A NamedTuple whose fields are numbers of a graph, or constants."""

    def __init__(self, cls: Any, values: Iterable[Any]) -> None:
        self.cls, self.values = cls, tuple(values)

    def field(self, name: str) -> Any:
        """What a field holds."""
        return self.values[self.cls._fields.index(name)]


class Array:
    """An array, or a part of one, of which numbers at known places are read and written."""

    def __init__(self, name: str, start: int = 0) -> None:
        self.name, self.start = name, start


class Graph:
    """What a part computes, each number once: nodes ``(operation, arguments)``, arguments before what they make."""

    def __init__(self) -> None:
        self.nodes: list[tuple[Any, ...]] = []
        self._known: dict[tuple[Any, ...], Number] = {}

    def make(self, operation: str, *arguments: Any) -> Any:
        """The number that an operation makes; a constant where it can be told already."""
        simple = self._simplified(operation, arguments)
        if simple is not None:
            return simple
        key = (operation, *((type(a) is Number, a, isinstance(a, float)) for a in arguments))
        if key not in self._known:
            self._known[key] = Number(len(self.nodes))
            self.nodes.append((operation, *arguments))
        return self._known[key]

    def _simplified(self, operation: str, arguments: tuple[Any, ...]) -> Any:
        if operation in CONSTANT and not any(isinstance(a, Number) for a in arguments):
            return CONSTANT[operation](*arguments)
        x, y = (*arguments, None, None)[:2]
        if operation == "select" and (not isinstance(x, Number) or same(y, arguments[2])):
            return y if isinstance(x, Number) or x else arguments[2]
        if operation in ("and", "or") and not all(isinstance(a, Number) for a in arguments):
            constant, other = (y, x) if isinstance(x, Number) else (x, y)
            return other if bool(constant) == (operation == "and") else operation == "or"
        return None

    # What adds nothing to a derivative is left out; forward, 0·x is what the processor makes of it.

    def plus(self, x: Any, y: Any) -> Any:
        """x + y."""
        if is_zero(x) or is_zero(y):
            return y if is_zero(x) else x
        return self.make("+", x, y)

    def times(self, x: Any, y: Any) -> Any:
        """x·y."""
        if is_zero(x) or is_zero(y):
            return 0.0
        if same(x, 1.0) or same(y, 1.0):
            return y if same(x, 1.0) else x
        if same(x, -1.0) or same(y, -1.0):
            return self.minus(y if same(x, -1.0) else x)
        return self.make("*", x, y)

    def minus(self, x: Any) -> Any:
        """−x."""
        if isinstance(x, Number) and self.nodes[x][0] == "neg":
            return self.nodes[x][1]
        return self.make("neg", x)

    def where(self, condition: Any, x: Any, y: Any) -> Any:
        """x where the condition holds, y elsewhere."""
        return self.make("select", condition, x, y)

    def over(self, x: Any, y: Any) -> Any:
        """x/y, and 0 where x is: a side that does not count may divide by 0."""
        if is_zero(x):
            return 0.0
        if not isinstance(y, Number):
            return self.times(x, 1.0 / y)
        return self.make("over", x, y)

    def share(self, x: Any, y: Any) -> Any:
        """x·y, and 0 where x is: a side that does not count may be infinite."""
        return 0.0 if is_zero(x) else self.make("share", x, y)


def same(x: Any, y: Any) -> bool:
    """Whether two numbers of a graph, or constants, are one."""
    return isinstance(x, Number) == isinstance(y, Number) and type(x) in (Number, float, int, bool) and x == y


def is_zero(x: Any) -> bool:
    """Whether it is the constant 0."""
    return not isinstance(x, Number) and x == 0.0


SYMBOLS = {
    "+": "{} + {}", "-": "{} - {}", "*": "{} * {}", "/": "{} / {}", "neg": "-{}", "not": "not {}",
    "<": "{} < {}", "<=": "{} <= {}", ">": "{} > {}", ">=": "{} >= {}", "==": "{} == {}", "!=": "{} != {}",
    "and": "{} and {}", "or": "{} or {}", "select": "{1} if {0} else {2}",
    "over": "{0} / {1} if {0} != 0.0 else 0.0", "share": "{0} * {1} if {0} != 0.0 else 0.0",
}  # fmt: skip
"""Operations and how they are written."""

KNOWN: dict[Any, str] = {
    lanes.fma: "fma",
    lanes.sine: "sine",
    lanes.logarithm: "logarithm",
    lanes.exponential: "exponential",
    min: "min",
    max: "max",
    abs: "abs",
    np.abs: "abs",
    np.sqrt: "sqrt",
    math.sqrt: "sqrt",
    np.floor: "floor",
    np.rint: "rint",
}
"""Functions whose derivative is known, by what they are called in a graph."""

CALLS = {name: name for name in ("fma", "sine", "logarithm", "exponential", "min", "max", "abs")}
CALLS |= {"sqrt": "np.sqrt", "floor": "np.floor", "rint": "np.rint"}

CONSTANT: dict[str, Callable[..., Any]] = {
    **{name: function for function, name in KNOWN.items()},
    "sqrt": math.sqrt,
    "select": lambda c, x, y: x if c else y,
    "over": lambda x, y: x / y if x else 0.0,
    "share": lambda x, y: x * y if x else 0.0,
    "neg": lambda x: -x,
    "not": lambda x: not x,
    "and": lambda x, y: x and y,
    "or": lambda x, y: x or y,
    "+": lambda x, y: x + y,
    "-": lambda x, y: x - y,
    "*": lambda x, y: x * y,
    "/": lambda x, y: np.float64(x) / y if y == 0 else x / y,
    "<": lambda x, y: x < y,
    "<=": lambda x, y: x <= y,
    ">": lambda x, y: x > y,
    ">=": lambda x, y: x >= y,
    "==": lambda x, y: x == y,
    "!=": lambda x, y: x != y,
}
"""What operations make of constants."""

_OPERATORS = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=",
    ast.Eq: "==", ast.NotEq: "!=", ast.And: "and", ast.Or: "or",
}  # fmt: skip
_IDENTITIES = (float, np.float64)
_CAST = (int, np.int64, np.uint64, bool)
_MISSING = object()


# ------------------------------------------------------------------------------------------- from text to graph


class Reader:
    """Reads parts into one graph.

    Args:
        graph: what is added to.
        heap: numbers in arrays that have been read or written, by array and place.
    """

    def __init__(self, graph: Graph, heap: dict[tuple[str, int], Any]) -> None:
        self.graph, self.heap = graph, heap

    def call(self, function: Any, arguments: list[Any], named: dict[str, Any]) -> Any:
        """What a part returns."""
        function = getattr(function, "py_func", function)
        tree, file, line = _tree(function)
        bound = inspect.signature(function).bind(*arguments, **named)
        bound.apply_defaults()
        cells = inspect.getclosurevars(function).nonlocals if function.__closure__ else {}
        scope = _Scope(self, dict(bound.arguments), {**function.__globals__, **cells}, file, line)
        returned = scope.run(tree.body)
        return None if returned is _MISSING else returned


@functools.cache
def _tree(function: Any) -> tuple[ast.FunctionDef, str, int]:
    """A function's text, its file, and the line before its first."""
    lines, first = inspect.getsourcelines(function)
    tree = ast.parse(textwrap.dedent("".join(lines))).body[0]
    assert isinstance(tree, ast.FunctionDef)
    return tree, inspect.getsourcefile(function) or "?", first - 1


class _Scope:
    """A function that is being read: its names."""

    def __init__(self, reader: Reader, names: dict[str, Any], space: dict[str, Any], file: str, line: int) -> None:
        self.reader, self.names, self.space, self.file, self.line = reader, names, space, file, line

    @property
    def graph(self) -> Graph:
        return self.reader.graph

    def refused(self, node: ast.AST, why: str) -> InvalidInput:
        line = self.line + getattr(node, "lineno", 0)
        return InvalidInput(f"no derivative of {ast.unparse(node)[:60]!r} ({self.file}, line {line}): {why}")

    # --------------------------------------------------------------------------------------------- statements

    def run(self, statements: list[ast.stmt]) -> Any:
        """What is returned; ``_MISSING`` if the end is reached."""
        for i, statement in enumerate(statements):
            if isinstance(statement, ast.Return):
                return None if statement.value is None else self.value(statement.value)
            if isinstance(statement, ast.If):
                returned = self.condition(statement, statements[i + 1 :])
                if returned is not _CONTINUE:
                    return returned
            else:
                returned = self.simple(statement)
                if returned is not _MISSING:
                    return returned
        return _MISSING

    def simple(self, statement: ast.stmt) -> Any:
        """An assignment, a loop or a call; what is returned from within it, if something is."""
        if isinstance(statement, ast.Assign):
            value = self.value(statement.value)
            for target in statement.targets:
                self.assign(target, value)
        elif isinstance(statement, ast.AnnAssign) and statement.value:
            self.assign(statement.target, self.value(statement.value))
        elif isinstance(statement, ast.AugAssign):
            old = self.value(_as_read(statement.target))
            self.assign(statement.target, self.binary(statement, statement.op, old, self.value(statement.value)))
        elif isinstance(statement, ast.For):
            return self.loop(statement)
        elif isinstance(statement, ast.Expr):
            if not isinstance(statement.value, ast.Constant):
                self.value(statement.value)
        elif not isinstance(statement, ast.Pass | ast.Assert):
            raise self.refused(statement, "statements of this kind are not read")
        return _MISSING

    def condition(self, statement: ast.If, rest: list[ast.stmt]) -> Any:
        """An ``if`` and, where one of its sides returns, all that follows; ``_CONTINUE`` if none does."""
        test = self.value(statement.test)
        if not isinstance(test, Number):
            returned = self.run(statement.body if test else statement.orelse)
            return _CONTINUE if returned is _MISSING else returned
        before, heap = dict(self.names), dict(self.reader.heap)
        one = self.run(statement.body)
        then_names, then_heap = self.names, self.reader.heap
        self.names, self.reader.heap = before, heap
        other = self.run(statement.orelse)
        if one is _MISSING and other is _MISSING:
            self.join(test, then_names, then_heap)
            return _CONTINUE
        if other is _MISSING:
            other = self.run(rest)
            self.join(test, {}, then_heap)
        elif one is _MISSING:
            names, heap = self.names, self.reader.heap
            self.names, self.reader.heap = then_names, then_heap
            one = self.run(rest)
            then_heap, self.names, self.reader.heap = self.reader.heap, names, heap
            self.join(test, {}, then_heap)
        else:
            self.join(test, {}, then_heap)
        one, other = (None if each is _MISSING else each for each in (one, other))
        return self.either(statement, test, one, other)

    def join(self, test: Any, names: dict[str, Any], heap: dict[tuple[str, int], Any]) -> None:
        """After both sides of a condition: what has another value in one is that side's."""
        for name in [*self.names]:
            if name in names:
                self.names[name] = self.either(ast.Name(name), test, names[name], self.names[name])
        for place in {**heap, **self.reader.heap}:
            mine = self.reader.heap[place] if place in self.reader.heap else self.read(*place)
            theirs = heap[place] if place in heap else self.read(*place)
            self.reader.heap[place] = self.graph.where(test, theirs, mine)

    def either(self, node: ast.AST, test: Any, one: Any, other: Any) -> Any:
        """``one if test else other``, number by number."""
        if one is other:
            return one
        if isinstance(one, Struct) and isinstance(other, Struct) and one.cls is other.cls:
            pairs = zip(one.values, other.values, strict=True)
            return Struct(one.cls, [self.either(node, test, x, y) for x, y in pairs])
        if isinstance(one, tuple) and isinstance(other, tuple) and len(one) == len(other):
            return tuple(self.either(node, test, x, y) for x, y in zip(one, other, strict=True))
        if not (_is_number(one) and _is_number(other)):
            raise self.refused(node, "its sides are of different kinds")
        return self.graph.where(test, one, other)

    def loop(self, statement: ast.For) -> Any:
        values = self.value(statement.iter)
        if not isinstance(values, range | tuple | list):
            raise self.refused(statement.iter, "loops are over ranges that are known beforehand")
        for value in values:
            self.assign(statement.target, value)
            returned = self.run(statement.body)
            if returned is not _MISSING:
                return returned
        return _MISSING

    def assign(self, target: ast.expr, value: Any) -> None:
        if isinstance(target, ast.Name):
            self.names[target.id] = value
        elif isinstance(target, ast.Tuple):
            values = value.values if isinstance(value, Struct) else value
            for each, part in zip(target.elts, values, strict=True):
                self.assign(each, part)
        elif isinstance(target, ast.Subscript):
            self.reader.heap[self.place(target)] = value
        else:
            raise self.refused(target, "nothing can be assigned to it")

    # -------------------------------------------------------------------------------------------- expressions

    def value(self, node: ast.expr) -> Any:
        """What an expression stands for."""
        if isinstance(node, ast.Constant):
            return node.value
        if isinstance(node, ast.Name):
            return self.named(node)
        if isinstance(node, ast.Tuple | ast.List):
            return tuple(self.value(each) for each in node.elts)
        if isinstance(node, ast.Attribute):
            return self.attribute(node)
        if isinstance(node, ast.BinOp):
            return self.binary(node, node.op, self.value(node.left), self.value(node.right))
        if isinstance(node, ast.UnaryOp):
            operation = {ast.USub: "neg", ast.Not: "not"}.get(type(node.op))
            value = self.value(node.operand)
            return self.graph.make(operation, value) if operation else value
        if isinstance(node, ast.BoolOp):
            return functools.reduce(
                functools.partial(self.graph.make, _OPERATORS[type(node.op)]), map(self.value, node.values)
            )
        if isinstance(node, ast.Compare):
            return self.compared(node)
        if isinstance(node, ast.IfExp):
            return self.chosen(node)
        if isinstance(node, ast.Subscript):
            return self.subscript(node)
        if isinstance(node, ast.Call):
            return self.called(node)
        raise self.refused(node, "expressions of this kind are not read")

    def named(self, node: ast.Name) -> Any:
        for space in (self.names, self.space, vars(builtins)):
            if node.id in space:
                return space[node.id]
        raise self.refused(node, "not known here, or only on one side of a condition")

    def attribute(self, node: ast.Attribute) -> Any:
        whole = self.value(node.value)
        if isinstance(whole, Struct):
            if node.attr == "_replace":
                return functools.partial(_replaced, whole)
            return whole.field(node.attr)
        return getattr(whole, node.attr)

    def binary(self, node: ast.AST, operator: ast.operator, x: Any, y: Any) -> Any:
        if not (isinstance(x, Number) or isinstance(y, Number)):
            return _BINARY[type(operator)](x, y)
        if isinstance(operator, ast.Pow) and y == 2:
            return self.graph.make("*", x, x)
        if type(operator) not in _OPERATORS:
            raise self.refused(node, "this operator has no derivative here")
        return self.graph.make(_OPERATORS[type(operator)], x, y)

    def compared(self, node: ast.Compare) -> Any:
        values, found = [self.value(each) for each in (node.left, *node.comparators)], True
        for operator, x, y in zip(node.ops, values[:-1], values[1:], strict=True):
            if type(operator) not in _OPERATORS:
                raise self.refused(node, "comparisons of this kind are not read")
            found = self.graph.make("and", found, self.graph.make(_OPERATORS[type(operator)], x, y))
        return found

    def chosen(self, node: ast.IfExp) -> Any:
        test = self.value(node.test)
        if not isinstance(test, Number):
            return self.value(node.body if test else node.orelse)
        return self.either(node, test, self.value(node.body), self.value(node.orelse))

    def subscript(self, node: ast.Subscript) -> Any:
        whole = self.value(node.value)
        if not isinstance(whole, Array):
            index = self.value(node.slice)
            return (whole.values if isinstance(whole, Struct) else whole)[index]
        if isinstance(node.slice, ast.Slice):
            start = self.index(node, node.slice.lower) if node.slice.lower else 0
            return Array(whole.name, whole.start + start)
        return self.read(*self.place(node))

    def place(self, node: ast.Subscript) -> tuple[str, int]:
        whole = self.value(node.value)
        if not isinstance(whole, Array):
            raise self.refused(node, "not an array")
        return whole.name, whole.start + self.index(node, node.slice)

    def index(self, node: ast.AST, given: ast.expr) -> int:
        index = self.value(given)
        if isinstance(index, Number) or not hasattr(index, "__index__"):
            raise self.refused(node, "places in arrays must be known beforehand")
        return int(index)

    def read(self, array: str, place: int) -> Any:
        """A number of an array: what was written last, or what it held before."""
        if (array, place) not in self.reader.heap:
            return self.graph.make("given", f"{array}[{place}]")
        return self.reader.heap[array, place]

    def called(self, node: ast.Call) -> Any:
        function = self.value(node.func)
        arguments = [self.value(each) for each in node.args]
        named = {each.arg: self.value(each.value) for each in node.keywords if each.arg}
        if isinstance(function, functools.partial):
            return function(**named)
        if _is_known(function) and not named:
            return self.operation(KNOWN[function], arguments)
        if lanes.is_part(function):
            defaults = function._field_defaults
            given = dict(zip(function._fields, arguments, strict=False)) | named
            return Struct(function, [given[f] if f in given else defaults[f] for f in function._fields])
        if any(function is each for each in _IDENTITIES) and len(arguments) == 1:
            return arguments[0] if isinstance(arguments[0], Number) else float(arguments[0])
        if _is_part(function):
            return self.reader.call(function, arguments, named)
        if not any(_holds_numbers(each) for each in (*arguments, *named.values())):
            return function(*arguments, **named)
        raise self.refused(node, "neither a part nor a function whose derivative is known")

    def operation(self, name: str, arguments: list[Any]) -> Any:
        if name in ("min", "max"):
            return functools.reduce(functools.partial(self.graph.make, name), arguments)
        return self.graph.make(name, *arguments)


_CONTINUE = object()
_BINARY: dict[Any, Callable[[Any, Any], Any]] = {
    ast.Add: lambda x, y: x + y,
    ast.Sub: lambda x, y: x - y,
    ast.Mult: lambda x, y: x * y,
    ast.Div: lambda x, y: x / y,
    ast.FloorDiv: lambda x, y: x // y,
    ast.Mod: lambda x, y: x % y,
    ast.Pow: lambda x, y: x**y,
}


def _is_known(function: Any) -> bool:
    try:
        return function in KNOWN
    except TypeError:  # not hashable
        return False


def _is_part(function: Any) -> bool:
    return getattr(function, "py_func", function) in lanes.COMPILED if callable(function) else False


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | bool | np.generic)


def _holds_numbers(value: Any) -> bool:
    if isinstance(value, Struct | tuple):
        return any(_holds_numbers(each) for each in (value.values if isinstance(value, Struct) else value))
    return isinstance(value, Number | Array)


def _replaced(whole: Struct, **values: Any) -> Struct:
    return Struct(whole.cls, [values.get(name, old) for name, old in zip(whole.cls._fields, whole.values, strict=True)])


def _as_read(target: ast.expr) -> ast.expr:
    read = ast.parse(ast.unparse(target), mode="eval").body
    return ast.copy_location(read, target)


# ------------------------------------------------------------------------------------------- the graph, backwards


def backwards(graph: Graph, seeds: dict[int, Any]) -> dict[int, Any]:
    """Adjoints of all nodes, from those of some (reverse mode); a node without any has an adjoint of 0.

    The graph grows by what computes them.
    """
    bars = dict(seeds)

    def add(x: Any, bar: Any) -> None:
        if isinstance(x, Number):
            bars[x] = graph.plus(bars.get(x, 0.0), bar)

    for index in range(len(graph.nodes) - 1, -1, -1):
        bar = bars.get(Number(index), 0.0)
        if not is_zero(bar):
            operation, *arguments = graph.nodes[index]
            _spread(graph, operation, arguments, Number(index), bar, add)
    return bars


def _spread(
    g: Graph, operation: str, arguments: list[Any], made: Number, bar: Any, add: Callable[[Any, Any], None]
) -> None:
    """Hands the adjoint of a number on to those it was made from."""
    x, y = (*arguments, None, None)[:2]
    if operation in ("+", "-"):
        add(x, bar)
        add(y, bar if operation == "+" else g.minus(bar))
    elif operation == "*":
        add(x, g.times(bar, y))
        add(y, g.times(bar, x))
    elif operation == "/":
        share = g.over(bar, y)
        add(x, share)
        add(y, g.minus(g.share(share, made)))
    elif operation == "neg":
        add(x, g.minus(bar))
    elif operation == "fma":
        add(x, g.times(bar, y))
        add(y, g.times(bar, x))
        add(arguments[2], bar)
    elif operation in ("min", "max"):
        first = g.make("<=" if operation == "min" else ">=", x, y)
        add(x, g.where(first, bar, 0.0))
        add(y, g.where(first, 0.0, bar))
    elif operation == "select":
        add(y, g.where(x, bar, 0.0))
        add(arguments[2], g.where(x, 0.0, bar))
    elif operation == "abs":
        add(x, g.where(g.make("<", x, 0.0), g.minus(bar), bar))
    elif operation == "rint":
        add(x, bar)
    elif operation == "sqrt":
        add(x, g.over(g.times(0.5, bar), made))
    elif operation == "logarithm":
        add(x, g.over(bar, x))
    elif operation == "exponential":
        add(x, g.share(bar, made))
    elif operation == "sine":
        add(x, g.times(bar, g.make("sine", g.make("+", x, 0.5 * math.pi))))


# ------------------------------------------------------------------------------------------- the graph, forwards


def forwards(graph: Graph, seeds: dict[int, Any]) -> dict[int, Any]:
    """Tangents of all nodes, from those of some (forward mode); a node without any has a tangent of 0.

    The graph grows by what computes them. A node's tangent is what each of its arguments hands on to it, and what it
    hands back to that argument is the same product; so :func:`_spread` knows both.
    """
    dots = dict(seeds)
    for index in range(len(graph.nodes)):
        operation, *arguments = graph.nodes[index]
        for source in dict.fromkeys(each for each in arguments if isinstance(each, Number)):
            dot = dots.get(source, 0.0)

            def add(x: Any, share: Any, source: Number = source, index: int = index) -> None:
                if same(x, source):
                    dots[Number(index)] = graph.plus(dots.get(Number(index), 0.0), share)

            if not is_zero(dot):
                _spread(graph, operation, arguments, Number(index), dot, add)
    return dots


# ------------------------------------------------------------------------------------------- from graph to part


class _Writer:
    """Writes a function whose arguments are the given numbers."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.space: dict[str, Any] = {"np": np, **{name: getattr(lanes, name) for name in _OURS}}

    def text(self, value: Any) -> str:
        """A number, or NamedTuples of them, as an expression."""
        if isinstance(value, Struct):
            name = value.cls.__name__
            while self.space.setdefault(name, value.cls) is not value.cls:  # of another class
                name += "_"
            return f"{name}({', '.join(map(self.text, value.values))})"
        if isinstance(value, tuple):
            return f"({', '.join(map(self.text, value))},)"
        return f"n{int(value)}" if isinstance(value, Number) else repr(_plain(value))

    def lines(self, wanted: list[Any]) -> list[str]:
        """Statements that compute all that ``wanted`` holds."""
        needed, waiting = set(), [n for value in wanted for n in _numbers(value)]
        while waiting:
            index = waiting.pop()
            if index not in needed:
                needed.add(index)
                waiting += [a for a in self.graph.nodes[index][1:] if isinstance(a, Number)]
        return [f"n{i} = {self.expression(*self.graph.nodes[i])}" for i in sorted(needed)]

    def expression(self, operation: str, *arguments: Any) -> str:
        if operation == "given":
            return arguments[0]
        shown = [self.text(a) if not is_negative(a) else f"({self.text(a)})" for a in arguments]
        if operation in SYMBOLS:
            return SYMBOLS[operation].format(*shown)
        return f"{CALLS[operation]}({', '.join(shown)})"


_OURS = ("fma", "sine", "logarithm", "exponential")


def is_negative(value: Any) -> bool:
    """Whether it is a constant with a sign."""
    return not isinstance(value, Number) and not isinstance(value, bool) and value < 0


def _plain(value: Any) -> Any:
    """A constant as the compiler reads it."""
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, float) and not math.isfinite(value):
        raise InvalidInput(f"a part has the constant {value}")
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


def _numbers(value: Any) -> list[int]:
    if isinstance(value, Struct | tuple):
        return [n for each in (value.values if isinstance(value, Struct) else value) for n in _numbers(each)]
    return [int(value)] if isinstance(value, Number) else []


def given(graph: Graph, kind: Any, name: str) -> Any:
    """An argument of this kind as a graph has it: a NamedTuple class, ``float``, ``np.ndarray``, or a constant."""
    if lanes.is_part(kind):
        kinds = zip(kind._fields, lanes.kinds(kind), strict=True)
        return Struct(kind, [given(graph, k if lanes.is_part(k) else float, f"{name}.{field}") for field, k in kinds])
    if kind is np.ndarray:
        return Array(name)
    return graph.make("given", name) if kind is float else kind


def adjoint(
    function: Callable[..., Any], of: Iterable[str], only: range | None = None, **kinds: Any
) -> Callable[..., Any]:
    """The reverse-mode derivative of a part, as a part.

    Args:
        function: the part.
        of: names of the arguments whose adjoints are wanted.
        only: places in arrays whose adjoints are wanted, one behind the other; what the part writes into arrays counts
            then for itself alone. None: all places.
        kinds: of its arguments: a NamedTuple class, ``float``, ``np.ndarray`` for an array, or the value of one that
            is a constant here.

    Returns:
        a part that takes the arguments that are no constants, in order; then the adjoint of each result; then, for each
        array, one of adjoints, shape as the array's. It returns the adjoints of ``of``: one alone or a tuple, in
        order. Adjoints of arrays are not returned but added to theirs, which hold those of what the part writes when
        it is called. Its attribute ``text`` holds all that it computes.

    Raises:
        InvalidInput: the part holds something whose derivative is not known; says where.
    """
    reader, arguments, returned = _opened(function, of, kinds)
    graph, names = reader.graph, [*arguments]
    results = returned if isinstance(returned, tuple) else (() if returned is None else (returned,))
    arrays = [name for name, value in arguments.items() if isinstance(value, Array)]

    seeds: dict[int, Any] = {}
    bars = [
        given(graph, each.cls if isinstance(each, Struct) else float, f"result_{i}") for i, each in enumerate(results)
    ]
    for value, bar in zip(results, bars, strict=True):
        _seed(graph, seeds, value, bar)
    places = sorted({*reader.heap, *_read(graph, arrays)})
    for array, place in places:
        if (array, place) in reader.heap and only is None:
            _seed(graph, seeds, reader.heap[array, place], graph.make("given", f"{array}_bar[{place}]"))
    found = backwards(graph, seeds)

    writer = _Writer(graph)
    wanted = [_bars(graph, arguments[name], found) for name in of if name not in arrays]
    changes = {}
    for array, place in places:
        bar = found.get(graph.make("given", f"{array}[{place}]"), 0.0)
        written = (array, place) in reader.heap and only is None
        if (only is None or place in only) and (written or not is_zero(bar)):
            its = f"{array}_bar[{place - (only.start if only else 0)}]"
            changes[its] = bar if written else graph.plus(graph.make("given", its), bar)
    lines = writer.lines([*wanted, *changes.values()])
    lines += [f"{place} = {writer.text(value)}" for place, value in changes.items()]
    if wanted:
        lines.append(f"return {writer.text(wanted[0] if len(wanted) == 1 else tuple(wanted))}")
    taken = _taken(kinds, names)
    taken += [f"result_{i}" for i in range(len(results))] + [f"{name}_bar" for name in arrays]
    return _made(f"{function.__name__}_adjoint", taken, lines or ["pass"], writer.space)


def tangent(function: Callable[..., Any], of: Iterable[str], **kinds: Any) -> Callable[..., Any]:
    """The forward-mode derivative of a part, as a part.

    Args:
        function: the part; it may read arrays, whose numbers are constants here, but must not write into them.
        of: names of the arguments that have tangents.
        kinds: as for :func:`adjoint`.

    Returns:
        a part that takes the arguments that are no constants, in order, then the tangents of those of ``of``, in their
        order. It returns the tangent of what the part returns. Its attribute ``text`` holds all that it computes.

    Raises:
        InvalidInput: the part holds something whose derivative is not known; says where.
    """
    reader, arguments, returned = _opened(function, of, kinds)
    if reader.heap:
        raise InvalidInput(f"no tangent of {function.__name__}: it writes into an array")
    graph, seeds = reader.graph, dict[int, Any]()
    for name in of:
        _seed(graph, seeds, arguments[name], given(graph, kinds[name], f"{name}_dot"))
    dots = forwards(graph, seeds)
    writer = _Writer(graph)
    several = isinstance(returned, tuple)
    whole = tuple(_dots(each, dots) for each in returned) if several else _dots(returned, dots)
    lines = [*writer.lines([whole]), f"return {writer.text(whole)}"]
    taken = [*_taken(kinds, [*arguments]), *(f"{name}_dot" for name in of)]
    return _made(f"{function.__name__}_tangent", taken, lines, writer.space)


def _opened(
    function: Callable[..., Any], of: Iterable[str], kinds: dict[str, Any]
) -> tuple[Reader, dict[str, Any], Any]:
    """A part as a graph: what has read it, its arguments by name, and what it returns."""
    names = list(inspect.signature(getattr(function, "py_func", function)).parameters)
    unknown = {*kinds, *of} - set(names)
    if unknown or set(names) - set(kinds):
        raise InvalidInput(f"{function.__name__} takes {names}; kinds are those of {sorted(kinds)}, of is {list(of)}")
    reader = Reader(Graph(), {})
    arguments = {name: given(reader.graph, kinds[name], name) for name in names}
    return reader, arguments, reader.call(function, [*arguments.values()], {})


def _taken(kinds: dict[str, Any], names: list[str]) -> list[str]:
    """Arguments that are no constants."""
    return [name for name in names if not isinstance(kinds[name], bool | int | float | np.generic)]


def _seed(graph: Graph, seeds: dict[int, Any], value: Any, bar: Any) -> None:
    if isinstance(value, Struct):
        for each, its in zip(value.values, bar.values, strict=True):
            _seed(graph, seeds, each, its)
    elif isinstance(value, Number):
        seeds[value] = graph.plus(seeds.get(value, 0.0), bar)


def _read(graph: Graph, arrays: list[str]) -> set[tuple[str, int]]:
    """Places in arrays that the part reads."""
    found = set()
    for operation, *arguments in graph.nodes:
        array, _, place = str(arguments[0]).partition("[") if operation == "given" else ("", "", "")
        if array in arrays:
            found.add((array, int(place.rstrip("]"))))
    return found


def _bars(graph: Graph, value: Any, bars: dict[int, Any]) -> Any:
    """Adjoints of an argument, in its class."""
    if isinstance(value, Struct):
        return Struct(value.cls, [_bars(graph, each, bars) for each in value.values])
    return bars.get(value, 0.0) if isinstance(value, Number) else 0.0


def _dots(value: Any, dots: dict[int, Any]) -> Any:
    """Tangents of a result, in its class; those of what is true or false are False."""
    if isinstance(value, Struct):
        pairs = zip(value.values, lanes.kinds(value.cls), strict=True)
        return Struct(value.cls, [False if kind is bool else _dots(each, dots) for each, kind in pairs])
    return dots.get(value, 0.0) if isinstance(value, Number) else 0.0


def _made(name: str, arguments: list[str], lines: list[str], space: dict[str, Any]) -> Callable[..., Any]:
    """A part with this text."""
    text = f"def {name}({', '.join(arguments)}):\n" + "".join(f"    {line}\n" for line in lines)
    file = f"<{name} {len(text)}>"
    linecache.cache[file] = (len(text), None, text.splitlines(keepends=True), file)
    exec(compile(text, file, "exec"), {"__name__": __name__, **space}, space)
    space[name].text = text
    return lanes.part(space[name])
