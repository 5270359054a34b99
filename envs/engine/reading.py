"""Parts read from their source as lists of scalar operations, for transformations such as :mod:`adjoint`.

A part is a Python function; the compiler is one reader of it, this is another. Reading is running it on names instead
of numbers: calls of other parts are inlined, loops of fixed counts unrolled, NamedTuples are taken apart into their
numbers. Where a branch depends on a number both sides are read and the results selected. What comes out is a straight
line of operations, each on results of earlier ones.

What is computed in a branch that is not taken may be anything (a division by zero), so operations remember the
condition under which they count: their *guard*.
"""

import ast
import builtins
import functools
import inspect
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

import numpy as np

from . import lanes
from .lanes import is_part, kinds
from .quantity import InvalidInput


class Node:
    """The result of an operation: a number that is known when the code runs."""

    __slots__ = ("args", "guard", "index", "kind", "operation", "text")

    def __init__(self, operation: str, args: tuple[Any, ...], kind: type, guard: Any, index: int, text: str) -> None:
        self.operation, self.args = operation, args  # args: nodes and plain numbers
        self.kind = kind  # float, int or bool
        self.guard = guard  # a node, or None: it always counts
        self.index = index  # place among all operations
        self.text = text  # a leaf's expression, or an array's name


class Record:
    """A NamedTuple of class ``cls``, or with None a plain tuple, of nodes, numbers and records."""

    def __init__(self, cls: Any, values: list[Any]) -> None:
        self.cls, self.values = cls, values

    def get(self, name: str) -> Any:
        """The value of a field."""
        return self.values[self.cls._fields.index(name)]


class Array:
    """An array argument, by its name."""

    def __init__(self, name: str) -> None:
        self.name = name


class _Bound:
    """``record._replace``, before it is called."""

    def __init__(self, record: Record) -> None:
        self.record = record


class _Nothing:
    """No return so far."""


_NOTHING = _Nothing()

_FUNCTIONS: dict[Any, str] = {
    min: "min",
    max: "max",
    abs: "abs",
    lanes.fma: "fma",
    np.sqrt: "sqrt",
    np.floor: "floor",
    np.rint: "rint",
    lanes.logarithm: "logarithm",
    lanes.exponential: "exponential",
    lanes.sine: "sine",
    np.float64: "number",
    float: "number",
    np.int64: "whole",
    int: "whole",
    np.uint64: "index",
    bool: "flag",
}
_KINDS = {"number": float, "sqrt": float, "whole": int, "index": int, "flag": bool, "fma": float}
_BINARY: dict[type, str] = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**", ast.Mod: "%"}
_BINARY |= {ast.FloorDiv: "//", ast.BitAnd: "&", ast.BitOr: "|", ast.LShift: "<<", ast.RShift: ">>"}
_WHOLE = {"%", "//", "&", "|", "<<", ">>"}  # for whole numbers only
_COMPARED: dict[type, str] = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
_PYTHON: dict[str, Callable[..., Any]] = {
    "+": lambda a, b: a + b, "-": lambda a, b: a - b, "*": lambda a, b: a * b, "/": lambda a, b: a / b,
    "**": lambda a, b: a**b, "%": lambda a, b: a % b, "//": lambda a, b: a // b, "&": lambda a, b: a & b,
    "|": lambda a, b: a | b, "<<": lambda a, b: a << b, ">>": lambda a, b: a >> b, "<": lambda a, b: a < b,
    "<=": lambda a, b: a <= b, ">": lambda a, b: a > b, ">=": lambda a, b: a >= b, "==": lambda a, b: a == b,
    "!=": lambda a, b: a != b,
}  # fmt: skip


class _Scope:
    """A function that is being read."""

    def __init__(self, function: Any) -> None:
        self.function = function
        self.tree, self.file, self.first = _tree(function)
        cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
        self.outer = {**vars(builtins), **function.__globals__, **{name: cell.cell_contents for name, cell in cells}}
        self.names: dict[str, Any] = {}

    def refuse(self, node: ast.AST, what: str) -> NoReturn:
        line = self.first + getattr(node, "lineno", 1) - 1
        raise InvalidInput(f"{self.file}, line {line}: {what}, which has no adjoint ('{self.function.__name__}')")


@functools.cache
def _tree(function: Any) -> tuple[ast.FunctionDef, str, int]:
    """Syntax, file and first line of a function."""
    try:
        lines, first = inspect.getsourcelines(function)
    except (OSError, TypeError):
        raise InvalidInput(f"'{function.__name__}' has no source to read, so it has no adjoint") from None
    found = ast.parse(textwrap.dedent("".join(lines))).body[0]
    if not isinstance(found, ast.FunctionDef):
        raise InvalidInput(f"'{function.__name__}' is not a plain function, so it has no adjoint")
    return found, inspect.getsourcefile(function) or "?", first


class Reader:
    """Reads functions; :attr:`nodes` are the operations in their order.

    Args:
        longest: loops whose count is not known before they run are read as at most so many turns; 0: they are refused.
    """

    def __init__(self, longest: int = 0) -> None:
        self.nodes: list[Node] = []
        self.longest = longest
        self._guard: Node | None = None

    # ------------------------------------------------------------------------------------------------- operations

    def leaf(self, text: str, kind: type) -> Node:
        """A number that is given, by the expression that says where."""
        return self._node("leaf", (), kind, text)

    def argument(self, name: str, kind: Any) -> Any:
        """An argument of a kind: a NamedTuple class, float, int, bool or :class:`Array`."""
        if kind is Array:
            return Array(name)
        if is_part(kind):
            inner = zip(kind._fields, kinds(kind), strict=True)
            return Record(kind, [self.argument(f"{name}.{field}", k if is_part(k) else _own(k)) for field, k in inner])
        if kind not in (float, int, bool):
            raise InvalidInput(f"'{name}' is of {kind!r}; a NamedTuple, float, int, bool or Array")
        return self.leaf(name, kind)

    def _node(self, operation: str, args: tuple[Any, ...], kind: type, text: str = "") -> Node:
        node = Node(operation, args, kind, self._guard, len(self.nodes), text)
        self.nodes.append(node)
        return node

    def _operation(self, operation: str, *args: Any) -> Any:
        if not any(isinstance(x, Node) for x in args) and operation in _PYTHON:
            return _PYTHON[operation](*args)
        if operation in _COMPARED.values():
            return self._node(operation, args, bool)
        whole = operation != "/" and all(_kind(x) is not float for x in args)
        return self._node(operation, args, _KINDS.get(operation, int if whole else float))

    def _both(self, a: Any, b: Any) -> Any:
        """a and b, of conditions."""
        if not isinstance(a, Node):
            return b if a else False
        if not isinstance(b, Node):
            return a if b else False
        return self._node("and", (a, b), bool)

    def _not(self, a: Any) -> Any:
        return self._node("not", (a,), bool) if isinstance(a, Node) else not a

    def select(self, test: Node, a: Any, b: Any, fail: Callable[[str], NoReturn]) -> Any:
        """``a`` where the test holds, else ``b``."""
        if a is b or (not isinstance(a, Node | Record) and _same(a, b)):
            return a
        a, b = _opened(a), _opened(b)
        if isinstance(a, Record) and isinstance(b, Record) and a.cls is b.cls and len(a.values) == len(b.values):
            return Record(a.cls, [self.select(test, x, y, fail) for x, y in zip(a.values, b.values, strict=True)])
        if not all(isinstance(x, Node) or _is_number(x) for x in (a, b)):
            fail("two sides of a branch of different kinds")
        if isinstance(b, bool) and _kind(a) is bool:
            return self._node("or", (self._not(test), a), bool) if b else self._both(test, a)
        found = {_kind(a), _kind(b)}
        return self._node("select", (test, a, b), float if float in found else (bool if found == {bool} else int))

    @contextmanager
    def _under(self, test: Node) -> Iterator[None]:
        """What is read within counts only where the test holds, too."""
        before = self._guard
        self._guard = test if before is None else self._both(before, test)
        try:
            yield
        finally:
            self._guard = before

    # -------------------------------------------------------------------------------------------------- functions

    def call(self, function: Any, args: list[Any], named: dict[str, Any]) -> Any:
        """What a Python function returns for these values."""
        scope = _Scope(function)
        spec = scope.tree.args
        if spec.vararg or spec.kwarg:
            scope.refuse(scope.tree, "a function of any number of arguments")
        parameters = inspect.signature(function).parameters
        free = iter(args)
        for name, parameter in parameters.items():
            if parameter.kind is not parameter.KEYWORD_ONLY and (value := next(free, _NOTHING)) is not _NOTHING:
                scope.names[name] = value
            elif name in named:
                scope.names[name] = named[name]
            elif parameter.default is not parameter.empty:
                scope.names[name] = parameter.default
            else:
                scope.refuse(scope.tree, f"a call without '{name}'")
        if next(free, _NOTHING) is not _NOTHING or not named.keys() <= parameters.keys():
            scope.refuse(scope.tree, "a call with arguments that it does not have")
        result = self._block(scope.tree.body, scope)
        return None if result is _NOTHING else result

    # ------------------------------------------------------------------------------------------------- statements

    def _block(self, statements: list[ast.stmt], scope: _Scope) -> Any:
        """Reads statements; what they return, or nothing so far."""
        for i, statement in enumerate(statements):
            match statement:
                case ast.Return(value=value):
                    return None if value is None else self._value(value, scope)
                case ast.If():
                    return self._branch(statement, statements[i + 1 :], scope)
                case ast.For():
                    if (result := self._loop(statement, scope)) is not _NOTHING:
                        return result
                case ast.Assign(targets=targets, value=value):
                    found = self._value(value, scope)
                    for target in targets:
                        self._assign(target, found, scope)
                case ast.AnnAssign(target=target, value=value) if value is not None:
                    self._assign(target, self._value(value, scope), scope)
                case ast.AugAssign(target=target, op=op, value=value):
                    old = self._value(target, scope)
                    self._assign(target, self._binary(statement, op, old, self._value(value, scope), scope), scope)
                case ast.Expr(value=ast.Constant()) | ast.Pass():
                    pass
                case ast.Expr(value=value):
                    self._value(value, scope)
                case _:
                    scope.refuse(statement, f"a statement '{type(statement).__name__.lower()}'")
        return _NOTHING

    def _branch(self, statement: ast.If, rest: list[ast.stmt], scope: _Scope) -> Any:
        """An ``if`` and what follows it."""
        test = self._condition(statement.test, scope)
        if not isinstance(test, Node):
            return self._block((statement.body if test else statement.orelse) + rest, scope)
        ends = any(isinstance(inner, ast.Return) for inner in ast.walk(statement))
        after = rest if ends else []  # where a side returns, the rest belongs to the sides
        before = scope.names
        sides = []
        for condition, side in ((test, statement.body), (self._not(test), statement.orelse)):
            scope.names = dict(before)
            with self._under(condition):
                sides.append((self._block(side + after, scope), scope.names))
        (a, first), (b, second) = sides
        if ends:
            if (a is _NOTHING) != (b is _NOTHING):
                scope.refuse(statement, "a function that returns only sometimes")
            return a if a is _NOTHING else self.select(test, a, b, functools.partial(scope.refuse, statement))
        self._join(test, first, second, statement, scope)
        return self._block(rest, scope)

    def _join(self, test: Node, a: dict[str, Any], b: dict[str, Any], where: ast.AST, scope: _Scope) -> None:
        """The names after a branch."""
        fail = functools.partial(scope.refuse, where)
        scope.names = {**a, **b} | {name: self.select(test, a[name], b[name], fail) for name in a.keys() & b.keys()}

    def _loop(self, statement: ast.For, scope: _Scope) -> Any:
        match statement:
            case ast.For(target=ast.Name(id=name), iter=ast.Call(func=ast.Name(id="range"), args=given), orelse=[]):
                counts = [self._value(x, scope) for x in given]
            case _:
                scope.refuse(statement, "a loop that is not 'for … in range(…)'")
        if not any(isinstance(count, Node) for count in counts):
            for value in range(*map(int, counts)):
                scope.names[name] = value
                if (result := self._block(statement.body, scope)) is not _NOTHING:
                    return result
            return _NOTHING
        if not self.longest or len(counts) > 1:
            scope.refuse(statement, "a loop whose count is not known beforehand")
        for value in range(self.longest):
            before, test = scope.names, self._operation("<", value, counts[0])
            scope.names = {**before, name: value}
            with self._under(test):
                if self._block(statement.body, scope) is not _NOTHING:
                    scope.refuse(statement, "a return out of such a loop")
            self._join(test, scope.names, before, statement, scope)
        return _NOTHING

    def _assign(self, target: ast.expr, value: Any, scope: _Scope) -> None:
        match target:
            case ast.Name(id=name):
                scope.names[name] = value
            case ast.Tuple(elts=targets):
                values = _opened(value)
                if not isinstance(values, Record) or len(values.values) != len(targets):
                    scope.refuse(target, "an assignment of another number of values")
                for inner, each in zip(targets, values.values, strict=True):
                    self._assign(inner, each, scope)
            case ast.Subscript(value=array, slice=index):
                whole = self._value(array, scope)
                if not isinstance(whole, Array):
                    scope.refuse(target, "writing into what is not an array argument")
                self._node("store", (self._value(index, scope), value), float, whole.name)
            case _:
                scope.refuse(target, f"an assignment to '{ast.unparse(target)}'")

    # ------------------------------------------------------------------------------------------------ expressions

    def _value(self, node: ast.expr, scope: _Scope) -> Any:
        match node:
            case ast.Constant(value=value):
                return value
            case ast.Name(id=name):
                if name in scope.names:
                    return scope.names[name]
                if name in scope.outer:
                    return scope.outer[name]
                scope.refuse(node, f"the unknown name '{name}'")
            case ast.Attribute(value=inner, attr=attr):
                return self._attribute(node, self._value(inner, scope), attr, scope)
            case ast.Tuple(elts=elements):
                return Record(None, [self._value(x, scope) for x in elements])
            case ast.BinOp(left=left, op=op, right=right):
                return self._binary(node, op, self._value(left, scope), self._value(right, scope), scope)
            case ast.UnaryOp(op=ast.Not(), operand=inner):
                return self._not(self._condition(inner, scope))
            case ast.UnaryOp(op=ast.USub(), operand=inner):
                value = self._number(inner, scope)
                return self._node("neg", (value,), value.kind) if isinstance(value, Node) else -value
            case ast.UnaryOp(op=ast.UAdd(), operand=inner):
                return self._number(inner, scope)
            case ast.Compare() | ast.BoolOp():
                return self._condition(node, scope)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                return self._ternary(node, self._condition(test, scope), body, orelse, scope)
            case ast.Subscript(value=inner, slice=index):
                return self._element(node, self._value(inner, scope), self._value(index, scope), scope)
            case ast.Call():
                return self._called(node, scope)
        scope.refuse(node, f"the expression '{ast.unparse(node)}'")

    def _number(self, node: ast.expr, scope: _Scope) -> Any:
        value = self._value(node, scope)
        if not isinstance(value, Node) and not _is_number(value):
            scope.refuse(node, f"'{ast.unparse(node)}' as a number")
        return value

    def _attribute(self, node: ast.expr, whole: Any, attr: str, scope: _Scope) -> Any:
        if attr == "_replace" and isinstance(_opened(whole), Record):
            return _Bound(_opened(whole))
        if isinstance(whole, Record):
            if whole.cls is None or attr not in whole.cls._fields:
                scope.refuse(node, f"'{ast.unparse(node)}'")
            return whole.get(attr)
        if isinstance(whole, Node | Array) or not hasattr(whole, attr):
            scope.refuse(node, f"'{ast.unparse(node)}'")
        return getattr(whole, attr)

    def _binary(self, node: ast.AST, op: ast.operator, a: Any, b: Any, scope: _Scope) -> Any:
        name = _BINARY.get(type(op))
        if name is None or not all(isinstance(x, Node) or _is_number(x) for x in (a, b)):
            scope.refuse(node, f"'{ast.unparse(node)}'")
        known = not isinstance(a, Node) and not isinstance(b, Node)
        if name in _WHOLE and not known and float in (_kind(a), _kind(b)):
            scope.refuse(node, f"'{name}' of numbers that are not whole")
        if name == "**" and isinstance(b, Node):
            scope.refuse(node, "a power whose exponent is not known beforehand")
        return self._operation(name, a, b)

    def _condition(self, node: ast.expr, scope: _Scope) -> Any:
        """Whether an expression is true: a node, or True or False."""
        match node:
            case ast.Compare(left=left, ops=ops, comparators=more):
                whole: Any = True
                a = self._value(left, scope)
                for op, right in zip(ops, more, strict=True):
                    b = self._value(right, scope)
                    if type(op) not in _COMPARED:
                        scope.refuse(node, f"'{ast.unparse(node)}'")
                    whole, a = self._both(whole, self._operation(_COMPARED[type(op)], a, b)), b
                return whole
            case ast.BoolOp(op=op, values=[first, *others]):
                whole = self._condition(first, scope)
                for other in others:
                    negated = isinstance(op, ast.Or)
                    goes_on = self._not(whole) if negated else whole  # the next is looked at only then
                    if not isinstance(goes_on, Node):
                        whole = self._condition(other, scope) if goes_on else negated
                        continue
                    with self._under(goes_on):
                        then = self._condition(other, scope)
                    if not negated:
                        whole = self._both(whole, then)
                    elif isinstance(then, Node):
                        whole = self._node("or", (whole, then), bool)
                    else:
                        whole = True if then else whole
                return whole
        value = self._value(node, scope)
        if isinstance(value, Node) and value.kind is not bool:
            return self._operation("!=", value, 0)
        return value if isinstance(value, Node) else bool(value)

    def _ternary(self, node: ast.expr, test: Any, body: ast.expr, orelse: ast.expr, scope: _Scope) -> Any:
        if not isinstance(test, Node):
            return self._value(body if test else orelse, scope)
        with self._under(test):
            a = self._value(body, scope)
        with self._under(self._not(test)):
            b = self._value(orelse, scope)
        return self.select(test, a, b, functools.partial(scope.refuse, node))

    def _element(self, node: ast.expr, whole: Any, index: Any, scope: _Scope) -> Any:
        if isinstance(whole, Array):
            if _kind(index) is not int:
                scope.refuse(node, f"the index '{ast.unparse(node)}'")
            return self._node("load", (index,), float, whole.name)
        if isinstance(index, Node):
            scope.refuse(node, f"'{ast.unparse(node)}'")
        return whole.values[index] if isinstance(whole, Record) else whole[index]

    def _called(self, node: ast.Call, scope: _Scope) -> Any:
        function = self._value(node.func, scope)
        if any(isinstance(x, ast.Starred) for x in node.args) or any(k.arg is None for k in node.keywords):
            scope.refuse(node, "a call with a star")
        args = [self._value(x, scope) for x in node.args]
        named = {k.arg: self._value(k.value, scope) for k in node.keywords if k.arg}
        if isinstance(function, _Bound):
            old = function.record
            if args or not named.keys() <= set(old.cls._fields):
                scope.refuse(node, f"'{ast.unparse(node)}'")
            return Record(old.cls, [named.get(f, x) for f, x in zip(old.cls._fields, old.values, strict=True)])
        if is_part(function):
            return self._made(node, function, args, named, scope)
        function = getattr(function, "py_func", function)
        if _hashable(function) and function in _FUNCTIONS and not named:
            return self._primitive(node, _FUNCTIONS[function], function, args, scope)
        if inspect.isfunction(function) and function not in _INSTRUCTIONS and not _foreign(function):
            return self.call(function, args, named)
        if not any(isinstance(x, Node | Record | Array) for x in (*args, *named.values())) and callable(function):
            return function(*args, **named)
        scope.refuse(node, f"a call of '{ast.unparse(node.func)}'")

    def _made(self, node: ast.AST, cls: Any, args: list[Any], named: dict[str, Any], scope: _Scope) -> Record:
        given = {**cls._field_defaults, **dict(zip(cls._fields, args, strict=False)), **named}
        if len(args) > len(cls._fields) or given.keys() != set(cls._fields):
            scope.refuse(node, f"a {cls.__name__} of other fields than {', '.join(cls._fields)}")
        return Record(cls, [given[field] for field in cls._fields])

    def _primitive(self, node: ast.AST, name: str, function: Any, args: list[Any], scope: _Scope) -> Any:
        if not all(isinstance(x, Node) or _is_number(x) for x in args):
            scope.refuse(node, f"'{ast.unparse(node)}'")
        if not any(isinstance(x, Node) for x in args):
            return function(*args)
        if name == "number" and args[0].kind is float:
            return args[0]
        if name not in ("min", "max"):
            return self._operation(name, *args)
        return functools.reduce(lambda a, b: self._operation(name, a, b), args)


_INSTRUCTIONS = {
    lanes.load, lanes.store, lanes.doubles, lanes.singles, lanes.flags, lanes.words, lanes.call, lanes.scratch,
    lanes.take, lanes.as_bits, lanes.as_number, lanes.as_bits32, lanes.as_number32,
}  # fmt: skip
"""What belongs to stages or to bits, not to numbers."""


def _foreign(function: Any) -> bool:
    """Whether a function is NumPy's or Python's own."""
    return (function.__module__ or "").split(".")[0] in {"numpy", "math", "builtins", "numba"}


def _own(kind: Any) -> type:
    """What compiled code takes a field for."""
    return bool if kind is bool else float


def _opened(value: Any) -> Any:
    """A tuple that is known beforehand, as a record."""
    return Record(type(value) if is_part(type(value)) else None, list(value)) if isinstance(value, tuple) else value


def _is_number(value: Any) -> bool:
    return isinstance(value, bool | int | float | np.integer | np.bool_)


def _kind(value: Any) -> type:
    if isinstance(value, Node):
        return value.kind
    if isinstance(value, bool | np.bool_):
        return bool
    return int if isinstance(value, int | np.integer) else float


def _same(a: Any, b: Any) -> bool:
    """Whether two values that are known beforehand are the same."""
    if isinstance(a, Record | Node | Array) or isinstance(b, Record | Node | Array):
        return False
    if _is_number(a) and _is_number(b):
        return type(a) is type(b) and repr(a) == repr(b)
    return a is b


def _hashable(value: Any) -> bool:
    try:
        hash(value)
    except TypeError:
        return False
    return True
