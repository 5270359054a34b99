"""Expressions of a part in C."""

import ast
import builtins
import inspect
import types
from collections.abc import Callable
from typing import Any

import numpy as np

from .. import lanes
from ..quantity import InvalidInput
from .origins import origin
from .values import (
    AND,
    BIT_AND,
    BIT_OR,
    BIT_XOR,
    BITS,
    BOOL,
    EQUAL,
    INT,
    LESS,
    NOTHING,
    OR,
    PLUS,
    PRIMARY,
    REAL,
    SHIFT,
    TERNARY,
    TIMES,
    UNARY,
    Grid,
    Kind,
    Row,
    Several,
    Struct,
    Value,
    as_kind,
    fields_of,
    joined,
    literal,
)
from .words import safe

_OPERATORS = {ast.Add: ("+", PLUS), ast.Sub: ("-", PLUS), ast.Mult: ("*", TIMES), ast.Div: ("/", TIMES)}
_BITWISE = {
    ast.LShift: ("<<", SHIFT), ast.RShift: (">>", SHIFT), ast.BitAnd: ("&", BIT_AND), ast.BitOr: ("|", BIT_OR),
    ast.BitXor: ("^", BIT_XOR),
}  # fmt: skip
_COMPARES = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}

_MATH = {
    "sqrt": "sqrt", "floor": "floor", "ceil": "ceil", "exp": "exp", "log": "log", "rint": "rint", "sin": "sin",
    "cos": "cos", "tan": "tan", "hypot": "hypot", "arctan2": "atan2", "atan2": "atan2", "abs": "fabs", "fabs": "fabs",
    "tanh": "tanh", "log1p": "log1p", "expm1": "expm1",
}  # fmt: skip
"""Functions of NumPy and ``math`` that C has."""

_PLAIN = {lanes.logarithm: "log", lanes.exponential: "exp", lanes.sine: "sin", lanes.power: "pow"}
"""Parts that stand for functions of C where their bits do not matter: in ``float``."""


class Expressions:
    """What an expression of a part is in C; the statements are the other half (:mod:`functions`)."""

    def __init__(self, unit: Any, part: Callable[..., Any]) -> None:
        self.unit, self.part = unit, part
        self.variables: dict[str, Value] = {}
        self.used: set[str] = set()
        self.changed: set[str] = set()
        self.roots: dict[str, str] = {}
        self.above_zero: set[str] = set()
        self.lazy = 0
        self.first = 1

    def passing(self, kind: Kind, value: Value) -> str:
        """A new variable that holds a value; its name."""
        raise NotImplementedError

    def local(self, name: str) -> str:
        """A variable's name in C."""
        raise NotImplementedError

    def where(self, node: Any) -> str:
        """File and line."""
        line = self.first + (getattr(node, "lineno", 1) - 1 if node is not None else 0)
        return f"{inspect.getsourcefile(self.part)}, line {line}"

    def refused(self, node: Any, why: str) -> InvalidInput:
        """The error of something that has no form in C."""
        return InvalidInput(f"{self.where(node)}: {self.part.__name__} cannot be said in C: {why}")

    def as_kind(self, value: Value, kind: Kind, node: Any) -> Value:
        """The value as one of another kind."""
        found = as_kind(value, kind, self.unit.real)
        if found is None:
            raise self.refused(node, f"{value.kind.word} where {kind.word} is needed")
        return found

    def condition(self, node: ast.expr) -> str:
        """A condition's code."""
        value = self.value(node)
        if value.kind == REAL:
            return f"{value.at(EQUAL)} != {literal(0.0, self.unit.single).code}"
        return value.code

    # ---------------------------------------------------------------------------------------------------- expressions

    def value(self, node: ast.expr) -> Value:
        """Any expression."""
        method = getattr(self, f"_{type(node).__name__.lower()}", None)
        if method is None:
            raise self.refused(node, f"an expression of the kind {type(node).__name__}")
        found: Value = method(node)
        return found

    def _constant(self, node: ast.Constant) -> Value:
        if not isinstance(node.value, bool | int | float):
            raise self.refused(node, f"the constant {node.value!r}")
        return literal(node.value, self.unit.single)

    def _name(self, node: ast.Name) -> Value:
        if node.id in self.variables:
            self.used.add(node.id)
            return self.variables[node.id]
        thing, module = self.meant(node)
        return self.constant(node, node.id, thing, module)

    def _attribute(self, node: ast.Attribute) -> Value:
        thing, module = self.meant(node)
        if thing is not _UNMEANT:
            return self.constant(node, node.attr, thing, module)
        whole = self.value(node.value)
        if not isinstance(whole.kind, Struct):
            raise self.refused(node, f"an attribute of something that is no part: .{node.attr}")
        return self.member(whole, node.attr, node)

    def member(self, whole: Value, name: str, node: Any = None) -> Value:
        """A field of a struct."""
        assert isinstance(whole.kind, Struct)
        kinds = fields_of(whole.kind.cls)
        if name not in kinds:
            raise self.refused(node, f"{whole.kind.cls.__name__} has no field {name}")
        code = whole.at(PRIMARY)
        pointed = code.startswith("(*") and code.endswith(")") and code[2:-1].isidentifier()
        return Value(kinds[name], f"{code[2:-1]}->{safe(name)}" if pointed else f"{code}.{safe(name)}")

    def members_of(self, whole: Value) -> tuple[Value, ...] | None:
        """All fields of a struct, as several values; None of something else."""
        if isinstance(whole.kind, Several):
            return whole.parts
        if not isinstance(whole.kind, Struct):
            return None
        if not whole.code.replace("->", "").replace(".", "").strip("(*)").isidentifier():
            whole = Value(whole.kind, self.held(whole.kind, whole))
        cls: Any = getattr(whole.kind, "cls")  # noqa: B009
        return tuple(self.member(whole, name) for name in cls._fields)

    def held(self, kind: Kind, value: Value) -> str:
        """A variable for a value that is needed more than once, or at an address."""
        if self.lazy:
            raise self.refused(None, "a value of several numbers in a part of a condition")
        return self.passing(kind, value)

    def meant(self, node: ast.expr) -> tuple[Any, str]:
        """What a name outside of the function stands for, and the module that has it."""
        if isinstance(node, ast.Name):
            if node.id in self.variables:
                return _UNMEANT, ""
            space = {**vars(builtins), **inspect.getclosurevars(self.part).nonlocals, **self.part.__globals__}
            if node.id not in space:
                raise self.refused(node, f"'{node.id}' is not known")
            return space[node.id], self.part.__module__
        if isinstance(node, ast.Attribute):
            whole, _ = self.meant(node.value) if isinstance(node.value, ast.Name | ast.Attribute) else (_UNMEANT, "")
            if isinstance(whole, types.ModuleType):
                return getattr(whole, node.attr), whole.__name__
        return _UNMEANT, ""

    def constant(self, node: ast.expr, name: str, thing: Any, module: str) -> Value:
        """What a module has by a name."""
        if module in ("numpy", "math"):
            return literal(thing, self.unit.single)
        home, meaning = origin(module, name)
        short = home.rpartition(".")[2].lstrip("_")
        if isinstance(thing, bool | int | float | np.integer | np.floating | np.bool_):
            return self.unit.constant(name.lstrip("_"), thing, short, meaning)
        if isinstance(thing, np.ndarray):
            return self.unit.table(name.lstrip("_"), thing, short, meaning)
        if isinstance(thing, tuple) and hasattr(thing, "_fields"):
            return self._whole(type(thing), thing, node)
        if isinstance(thing, tuple):
            numbers = all(isinstance(x, int | float) and not isinstance(x, bool) for x in thing)
            parts = tuple(literal(x, self.unit.single) if numbers else Value(NOTHING) for x in thing)
            return Value(Several("several", tuple(p.kind for p in parts)), f"{short}.{name}", parts=parts, known=thing)
        raise self.refused(node, f"'{name}' is {type(thing).__name__}")

    def _whole(self, cls: Any, thing: Any, node: ast.expr) -> Value:
        parts = []
        for kind, each in zip(fields_of(cls).values(), thing, strict=True):
            if isinstance(kind, Struct):
                parts.append(self._whole(kind.cls, each, node))
            else:
                parts.append(
                    self.as_kind(literal(bool(each) if kind == BOOL else float(each), self.unit.single), kind, node)
                )
        return self.made(cls, parts)

    def made(self, cls: Any, parts: list[Value]) -> Value:
        """A struct of these values."""
        word = self.unit.struct(cls)
        inner = ", ".join(f".{safe(name)} = {part.code}" for name, part in zip(cls._fields, parts, strict=True))
        found = Value(Struct("struct", cls), f"({word}){{{inner or '0'}}}")
        self.made_of[found.code] = dict(zip(cls._fields, parts, strict=True))
        return found

    @property
    def made_of(self) -> dict[str, dict[str, Value]]:
        """The fields of structs that were made here, by their code."""
        return self.__dict__.setdefault("_made_of", {})

    # ----------------------------------------------------------------------------------------------------- operations

    def _binop(self, node: ast.BinOp) -> Value:
        one, two = self.value(node.left), self.value(node.right)
        if isinstance(node.op, ast.Pow):
            return self._power(node, one, two)
        if (
            isinstance(node.op, ast.FloorDiv | ast.Mod)
            and one.is_known
            and two.is_known
            and one.kind == two.kind == INT
        ):
            known = one.known // two.known if isinstance(node.op, ast.FloorDiv) else one.known % two.known
            return literal(known, self.unit.single)
        if isinstance(node.op, ast.FloorDiv | ast.Mod) and one.kind == two.kind == INT:
            helper = self.unit.helper("floored" if isinstance(node.op, ast.FloorDiv) else "modulo")
            return Value(INT, f"{helper}({one.code}, {two.code})", dirty=one.dirty or two.dirty)
        if type(node.op) in _BITWISE or BITS in (one.kind, two.kind):
            return self._bitwise(node, one, two)
        if type(node.op) not in _OPERATORS:
            raise self.refused(node, f"the operator {type(node.op).__name__}")
        sign, level = _OPERATORS[type(node.op)]
        divides = isinstance(node.op, ast.Div)
        if BOOL in (one.kind, two.kind):
            raise self.refused(node, "arithmetic with truth values")
        kind = REAL if divides or REAL in (one.kind, two.kind) else INT
        known = _folded(sign, one, two)
        one, two = self.as_kind(one, kind, node), self.as_kind(two, kind, node)
        dirty = one.dirty or two.dirty
        right = level + 1 if sign in "-/" or kind == REAL else level
        return Value(kind, f"{one.at(level)} {sign} {two.at(right)}", level, known, dirty=dirty and kind == INT)

    def _bitwise(self, node: ast.BinOp, one: Value, two: Value) -> Value:
        sign, level = {**_OPERATORS, **_BITWISE}.get(type(node.op), ("", 0))
        if not sign or not {one.kind, two.kind} <= {BITS, INT}:
            raise self.refused(node, f"the operator {type(node.op).__name__} on {one.kind.word} and {two.kind.word}")
        one = self.as_kind(one, BITS, node)
        two = two if sign in ("<<", ">>") else self.as_kind(two, BITS, node)
        return Value(BITS, f"{one.at(UNARY)} {sign} {two.at(UNARY)}", level)

    def _power(self, node: ast.BinOp, base: Value, exponent: Value) -> Value:
        if exponent.is_known and exponent.kind == INT and exponent.known == 2:
            base = self.as_kind(base, REAL, node) if base.kind != INT else base
            if not base.code.replace("->", "").replace(".", "").isidentifier():
                base = Value(base.kind, self.held(base.kind, base), known=base.known)
            return Value(base.kind, f"{base.code} * {base.code}", TIMES)
        base, exponent = self.as_kind(base, REAL, node), self.as_kind(exponent, REAL, node)
        if exponent.is_known and exponent.known == 0.5:  # as the kernel's compiler takes it
            return self._math("sqrt", base)
        return self._math("pow", base, exponent)

    def _math(self, name: str, *values: Value) -> Value:
        suffix = "f" if self.unit.single else ""
        return Value(REAL, f"{name}{suffix}({', '.join(value.code for value in values)})")

    def _unaryop(self, node: ast.UnaryOp) -> Value:
        value = self.value(node.operand)
        if isinstance(node.op, ast.Not):
            return Value(BOOL, f"!{value.at(UNARY)}", UNARY)
        if isinstance(node.op, ast.UAdd):
            return value
        if not isinstance(node.op, ast.USub) or value.kind not in (REAL, INT):
            raise self.refused(node, f"the operator {type(node.op).__name__}")
        code = f"-{value.at(UNARY)}" if not value.code.startswith("-") else f"-({value.code})"
        known = -value.known if value.is_known else value.known
        return Value(value.kind, code, UNARY, known, dirty=value.dirty)

    def _compare(self, node: ast.Compare) -> Value:
        values = [self.value(each) for each in (node.left, *node.comparators)]
        tests = []
        for one, two, op in zip(values, values[1:], node.ops, strict=False):
            if type(op) not in _COMPARES:
                raise self.refused(node, f"the comparison {type(op).__name__}")
            kind = joined(one.kind, two.kind)
            if kind not in (REAL, INT, BOOL):
                raise self.refused(node, f"a comparison of {one.kind.word} and {two.kind.word}")
            one, two = self.as_kind(one, kind, node), self.as_kind(two, kind, node)
            level = EQUAL if isinstance(op, ast.Eq | ast.NotEq) else LESS
            tests.append(Value(BOOL, f"{one.at(level + 1)} {_COMPARES[type(op)]} {two.at(level + 1)}", level))
        if len(tests) == 1:
            return tests[0]
        return Value(BOOL, " && ".join(test.at(AND + 1) for test in tests), AND)

    def _boolop(self, node: ast.BoolOp) -> Value:
        values = [self.value(node.values[0])]
        self.lazy += 1
        values += [self.value(each) for each in node.values[1:]]
        self.lazy -= 1
        if any(value.kind != BOOL for value in values):
            raise self.refused(node, "'and' or 'or' of something else than truth values")
        sign, level = ("&&", AND) if isinstance(node.op, ast.And) else ("||", OR)
        return Value(BOOL, f" {sign} ".join(value.at(EQUAL - 1) for value in values), level)

    def _ifexp(self, node: ast.IfExp) -> Value:
        test = self.value(node.test)
        self.lazy += 1
        one, two = self.value(node.body), self.value(node.orelse)
        self.lazy -= 1
        if test.kind != BOOL:
            raise self.refused(node, "a condition that is no truth value")
        return self.chosen(node, test, one, two)

    def chosen(self, node: Any, test: Value, one: Value, two: Value) -> Value:
        """One of two values."""
        kind = joined(one.kind, two.kind)
        if kind is None:
            raise self.refused(node, f"now {one.kind.word} and now {two.kind.word}")
        if isinstance(kind, Several):
            if not test.code.isidentifier():
                test = Value(BOOL, self.held(BOOL, test))
            one, two = self.as_kind(one, kind, node), self.as_kind(two, kind, node)
            parts = tuple(self.chosen(node, test, a, b) for a, b in zip(one.parts, two.parts, strict=True))
            return Value(kind, "", parts=parts)
        one, two = self.as_kind(one, kind, node), self.as_kind(two, kind, node)
        code = f"{test.at(OR + 1)} ? {one.at(TERNARY + 1)} : {two.at(TERNARY + 1)}"
        return Value(kind, code, TERNARY, dirty=one.dirty or two.dirty)

    def _tuple(self, node: ast.Tuple) -> Value:
        parts: list[Value] = []
        for each in node.elts:
            if isinstance(each, ast.Starred):
                parts += self._spread(each)
            else:
                parts.append(self.value(each))
        return Value(Several("several", tuple(part.kind for part in parts)), "", parts=tuple(parts))

    def _spread(self, node: ast.Starred) -> tuple[Value, ...]:
        parts = self.members_of(self.value(node.value))
        if parts is None:
            raise self.refused(node, "* of something that is not several values")
        return parts

    # ------------------------------------------------------------------------------------------------ places in arrays

    def _subscript(self, node: ast.Subscript) -> Value:
        whole = self.value(node.value)
        if isinstance(whole.kind, Row) and isinstance(node.slice, ast.Slice):
            return self._slice(node, whole)
        if isinstance(whole.kind, Row | Grid):
            return self.place(node, writes=False)
        index = self.value(node.slice)
        parts = None if isinstance(whole.kind, Struct) else self.members_of(whole)
        if index.is_known:
            if isinstance(whole.kind, Struct):
                return self.member(whole, whole.kind.cls._fields[index.known], node)
            if parts is not None:
                return parts[index.known]
        if isinstance(whole.kind, Struct) and set(fields_of(whole.kind.cls).values()) == {REAL}:
            index = self._safe_index(index, len(whole.kind.cls._fields), node)
            return Value(REAL, f"{self.unit.field_function(whole.kind.cls)}({self.address(whole)}, {index.code})")
        if isinstance(whole.kind, Several) and whole.is_known:
            module, _, name = whole.code.partition(".")
            table = self.unit.table(name.lstrip("_"), np.array(whole.known, float), module)
            index = self._safe_index(index, len(whole.known), node)
            return Value(REAL, f"{table.code}[{index.code}]")
        raise self.refused(node, "a place in something that is no array")

    def _slice(self, node: ast.Subscript, whole: Value) -> Value:
        part = node.slice
        assert isinstance(part, ast.Slice)
        assert isinstance(whole.kind, Row)
        low = self.value(part.lower) if part.lower else literal(0, self.unit.single)
        high = self.value(part.upper) if part.upper else None
        length = high.known - low.known if high is not None and high.is_known and low.is_known else None
        if part.step is not None or low.kind != INT:
            raise self.refused(node, "a slice with a step, or from no whole number on")
        code = whole.code if low.is_known and low.known == 0 else f"{whole.code} + {low.at(PLUS + 1)}"
        return Value(Row("row", length, whole.kind.constant), code, PLUS)

    def place(self, node: ast.Subscript, writes: bool = True) -> Value:
        """A number in an array."""
        whole = self.value(node.value)
        if writes and isinstance(whole.kind, Row):
            self.writes(whole.code)
        if isinstance(whole.kind, Grid):
            if not isinstance(node.slice, ast.Tuple) or len(node.slice.elts) != 2:
                raise self.refused(node, "a table's place without row and column")
            row, column = (self.value(each) for each in node.slice.elts)
            row = self._safe_index(row, whole.kind.rows, node)
            column = self._safe_index(column, whole.kind.columns, node)
            return Value(REAL, f"{whole.code}[{row.code}][{column.code}]")
        assert isinstance(whole.kind, Row)
        index = self._safe_index(self.value(node.slice), whole.kind.length, node)
        return Value(REAL, f"{whole.at(PRIMARY)}[{index.code}]")

    def _safe_index(self, index: Value, length: int | None, node: Any) -> Value:
        if index.kind != INT:
            raise self.refused(node, "a place that is no whole number")
        if not index.dirty:
            return index
        if length is None:
            raise self.refused(node, "a place made of a real number, in an array whose length is not known")
        return Value(INT, f"{self.unit.helper('place_in')}({index.code}, {length})")

    def writes(self, code: str) -> None:
        """Notes that numbers of an array are changed."""
        word = code.split(" ")[0].lstrip("(")
        for name, value in self.variables.items():
            if value.code in (word, self.roots.get(word)):
                self.changed.add(name)
                self.used.add(name)

    # ---------------------------------------------------------------------------------------------------------- calls

    def _call(self, node: ast.Call) -> Value:
        if isinstance(node.func, ast.Attribute) and node.func.attr == "_replace":
            return self._replaced(node)
        thing, _ = self.meant(node.func)
        if lanes.is_part(thing):
            return self._construct(node, thing)
        if thing in (min, max):
            return self._extreme(node, "smaller" if thing is min else "larger")
        arguments: list[Value] = []
        reads: list[set[str]] = []
        for each in node.args:
            before = set(self.used)
            more = self._spread(each) if isinstance(each, ast.Starred) else (self.value(each),)
            arguments += more
            reads += [self.used - before] * len(more)
        if thing is lanes.fma:
            return self._math("fma", *(self.as_kind(each, REAL, node) for each in arguments))
        if thing in (float, np.float64):
            return self.as_kind(arguments[0], REAL, node)
        if thing in (int, np.int64, np.uint64, lanes.U, np.int32):
            return self._whole_part(node, arguments[0])
        if thing is bool:
            return arguments[0]
        if thing is lanes.as_bits:
            return Value(BITS, f"{self.unit.helper('bits_of')}({self.as_kind(arguments[0], REAL, node).code})")
        if thing is lanes.as_number:
            return Value(REAL, f"{self.unit.helper('number_of')}({self.as_kind(arguments[0], BITS, node).code})")
        if self.unit.single and thing in _PLAIN:
            return self._math(_PLAIN[thing], *(self.as_kind(each, REAL, node) for each in arguments))
        if thing is abs:
            return self._absolute(arguments[0])
        if thing is len:
            return self._length(node, arguments[0])
        name = getattr(thing, "__name__", "")
        if name in _MATH and getattr(thing, "__module__", None) in (None, "math", "numpy"):
            return self._math(_MATH[name], *(self.as_kind(each, REAL, node) for each in arguments))
        if isinstance(thing, types.FunctionType) and thing in lanes.COMPILED:
            return self._called(node, thing, arguments, reads)
        raise self.refused(node, f"a call of {ast.unparse(node.func)}")

    def _whole_part(self, node: ast.Call, value: Value) -> Value:
        if value.kind == INT:
            return value
        if value.kind == BITS:
            return Value(INT, f"(int)({value.code})", UNARY)
        if value.kind == BOOL:
            return Value(INT, f"{value.at(OR)} ? 1 : 0", TERNARY)
        if value.is_known:
            return literal(int(value.known), self.unit.single)
        return Value(INT, f"{self.unit.helper('whole_part')}({self.as_kind(value, REAL, node).code})", dirty=True)

    def _absolute(self, value: Value) -> Value:
        if value.kind == INT:
            return Value(INT, f"abs({value.code})", dirty=value.dirty)
        return self._math("fabs", value)

    def _length(self, node: ast.Call, value: Value) -> Value:
        if isinstance(value.kind, Row) and value.kind.length is not None:
            return literal(value.kind.length, self.unit.single)
        if isinstance(value.kind, Several):
            return literal(len(value.parts), self.unit.single)
        raise self.refused(node, "len() of something whose length is not known")

    def _extreme(self, node: ast.Call, helper: str) -> Value:
        values = [self.value(each) for each in node.args]
        kind = values[0].kind
        for value in values[1:]:
            found = joined(kind, value.kind)
            if found not in (REAL, INT):
                raise self.refused(node, f"the {helper} of {kind.word} and {value.kind.word}")
            kind = found
        values = [self.as_kind(value, kind, node) for value in values]
        name = self.unit.helper(helper if kind == REAL else f"{helper}_int")
        out = values[0]
        for value in values[1:]:
            code, dirty = f"{name}({out.code}, {value.code})", out.dirty or value.dirty
            ends = [each for each in (out, value) if each.is_known and each.known >= 0]
            if kind == INT and ends and helper == "larger":
                self.above_zero.add(code)
            elif kind == INT and ends and (out.code in self.above_zero or value.code in self.above_zero):
                dirty = False  # it lies between two known ends
            out = Value(kind, code, dirty=dirty)
        return out

    def _construct(self, node: ast.Call, cls: Any) -> Value:
        given: dict[str, Value] = {}
        position: list[Value] = []
        for each in node.args:
            position += self._spread(each) if isinstance(each, ast.Starred) else (self.value(each),)
        given.update(zip(cls._fields, position, strict=False))
        given |= {str(word.arg): self.value(word.value) for word in node.keywords}
        parts = []
        for name, kind in fields_of(cls).items():
            if name not in given:
                if name not in cls._field_defaults:
                    raise self.refused(node, f"{cls.__name__} without {name}")
                default = cls._field_defaults[name]
                given[name] = literal(bool(default) if kind == BOOL else float(default), self.unit.single)
            parts.append(self.as_kind(given[name], kind, node))
        return self.made(cls, parts)

    def _replaced(self, node: ast.Call) -> Value:
        assert isinstance(node.func, ast.Attribute)
        whole = self.value(node.func.value)
        if not isinstance(whole.kind, Struct) or node.args:
            raise self.refused(node, "_replace of something that is no part")
        kinds = fields_of(whole.kind.cls)
        changes = {str(w.arg): self.as_kind(self.value(w.value), kinds[str(w.arg)], node) for w in node.keywords}
        if whole.code in self.made_of:
            return self.made(whole.kind.cls, [changes.get(n, self.made_of[whole.code][n]) for n in kinds])
        if not self.lazy:
            return self.changed_copy(whole, changes)
        parts = [changes.get(name, self.member(whole, name, node)) for name in kinds]
        return self.made(whole.kind.cls, parts)

    def changed_copy(self, whole: Value, changes: dict[str, Value]) -> Value:
        """A copy of a struct with some fields changed."""
        raise NotImplementedError

    def _called(self, node: ast.Call, part: Callable[..., Any], given: list[Value], reads: list[set[str]]) -> Value:
        names = list(inspect.signature(part).parameters)
        for named in node.keywords:
            given.append(self.value(named.value))
            names.remove(str(named.arg))
            names.insert(len(given) - 1, str(named.arg))
        kinds = tuple(value.kind for value in given)
        loose = frozenset(i for i, value in enumerate(given) if value.dirty and value.kind == INT)
        function = self.unit.function(part, kinds, loose)
        for i, names_read in enumerate(reads):  # what is handed on and not used there is not used here
            if i not in function.arguments:
                self.used -= names_read
        for i in function.writes:
            self.writes(given[i].code)
        code = f"{function.name}({', '.join(self.handed(given[i]) for i in function.arguments)})"
        if isinstance(function.gives, Several):
            word = self.held_result(function.word, code)
            parts = tuple(
                Value(kind, f"{word}.{member}")
                for kind, member in zip(function.gives.kinds, function.members, strict=True)
            )
            return Value(function.gives, word, parts=parts)
        return Value(function.gives, code, dirty=function.dirty and function.gives == INT)

    def held_result(self, word: str, code: str) -> str:
        """A variable with what a function gives."""
        raise NotImplementedError

    def handed(self, value: Value) -> str:
        """How a value is handed to a function: structs by their address."""
        return self.address(value) if isinstance(value.kind, Struct) else value.code

    def address(self, value: Value) -> str:
        """Of a struct."""
        code = value.code
        if code.startswith("(*") and code.endswith(")") and code[2:-1].isidentifier():
            return code[2:-1]
        if code.startswith("(") or code.replace("->", "").replace(".", "").isidentifier():
            return f"&{code}"
        return f"&{self.held(value.kind, value)}"


_UNMEANT = object()


def _folded(sign: str, one: Value, two: Value) -> Any:
    """The value of an operation of known ones."""
    from .values import UNKNOWN

    if not (one.is_known and two.is_known) or (sign == "/" and not two.known):
        return UNKNOWN
    return {
        "+": lambda a, b: a + b, "-": lambda a, b: a - b, "*": lambda a, b: a * b, "/": lambda a, b: a / b,
    }[sign](one.known, two.known)  # fmt: skip
