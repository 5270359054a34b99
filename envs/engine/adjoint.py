"""Gradients of parts: from a part's source the function that carries adjoints from its results back to its arguments.

If a part computes ``y = f(x)`` and some number L follows from y, the *adjoint* of a value is the derivative of L by
it. :func:`adjoint` makes the part that gets x and the adjoint of y, and returns the adjoint of x (reverse mode,
Griewank and Walther 2008). It computes f again, in the same operations, and goes back through them. It is a part like
any other: Python runs it, kernels call it, and lanes vectorise it, because it has no branches.

What passes through what:

- a branch, ``min``, ``max``, ``clip``, ``abs``: the side that is taken;
- ``np.rint``: all, as if nothing were rounded (what is rounded is a resolution, whose steps have no slope anywhere);
- ``np.floor``, comparisons, whole numbers: nothing.
"""

import linecache
import zlib
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from . import lanes
from .lanes import is_part, part
from .quantity import InvalidInput
from .reading import Array, Node, Reader, Record

__all__ = ["Array", "Fixed", "adjoint"]


class Fixed(NamedTuple):
    """The kind of an argument that is the same in all calls, such as a switch; the adjoint does not have it."""

    value: Any


class _Rule(NamedTuple):
    """An operation in the code: {0}, {1}, {2} are its arguments, {z} its result, {d} the result's adjoint."""

    forward: str
    back: tuple[tuple[int, str, str], ...] = ()  # argument, how its adjoint grows, by what
    singular: bool = False  # what goes back may be infinite where the operation does not count


_ADD, _TAKE, _TIMES, _TERM = "add", "take", "times", "term"  # d, −d, d times a factor, an expression

_RULES = {
    "+": _Rule("{0} + {1}", ((0, _ADD, ""), (1, _ADD, ""))),
    "-": _Rule("{0} - {1}", ((0, _ADD, ""), (1, _TAKE, ""))),
    "*": _Rule("{0} * {1}", ((0, _TIMES, "{1}"), (1, _TIMES, "{0}"))),
    "/": _Rule("{0} / {1}", ((0, _TERM, "{d} / {1}"), (1, _TERM, "-({d} / {1}) * {z}")), True),
    "**": _Rule("{0} ** {1}", ((0, _TERM, "{d} * ({1} * {0} ** ({1} - 1))"),), True),
    "neg": _Rule("-{0}", ((0, _TAKE, ""),)),
    "abs": _Rule("abs({0})", ((0, _TERM, "choose({0} >= 0.0, {d}, -{d})"),)),
    "min": _Rule(
        "min({0}, {1})", ((0, _TERM, "choose({1} < {0}, 0.0, {d})"), (1, _TERM, "choose({1} < {0}, {d}, 0.0)"))
    ),
    "max": _Rule(
        "max({0}, {1})", ((0, _TERM, "choose({1} > {0}, 0.0, {d})"), (1, _TERM, "choose({1} > {0}, {d}, 0.0)"))
    ),
    "select": _Rule("{1} if {0} else {2}", ((1, _TERM, "choose({0}, {d}, 0.0)"), (2, _TERM, "choose({0}, 0.0, {d})"))),
    "fma": _Rule("fma({0}, {1}, {2})", ((0, _TIMES, "{1}"), (1, _TIMES, "{0}"), (2, _ADD, ""))),
    "sqrt": _Rule("np.sqrt({0})", ((0, _TERM, "0.5 * {d} / {z}"),), True),
    "floor": _Rule("np.floor({0})"),
    "rint": _Rule("np.rint({0})", ((0, _ADD, ""),)),
    "logarithm": _Rule("logarithm({0})", ((0, _TERM, "{d} / {0}"),), True),
    "exponential": _Rule("exponential({0})", ((0, _TERM, "choose(abs({0}) < 700.0, {d} * {z}, 0.0)"),)),
    "sine": _Rule("sine({0})", ((0, _TIMES, "sine({0} + 1.5707963267948966)"),)),
    "number": _Rule("np.float64({0})", ((0, _ADD, ""),)),
    "whole": _Rule("np.int64({0})"),
    "index": _Rule("np.uint64({0})"),
    "flag": _Rule("bool({0})"),
    "and": _Rule("{0} and {1}"),
    "or": _Rule("{0} or {1}"),
    "not": _Rule("not {0}"),
} | {sign: _Rule(f"{{0}} {sign} {{1}}") for sign in ("<", "<=", ">", ">=", "==", "!=", "%", "//", "&", "|", "<<", ">>")}

_SPACE = {
    "np": np, "fma": lanes.fma, "choose": lanes.choose,
    "logarithm": lanes.logarithm, "exponential": lanes.exponential, "sine": lanes.sine,
    "inf": float("inf"), "nan": float("nan"),
}  # fmt: skip


def adjoint(
    function: Callable[..., Any], *given: Any, wrt: Sequence[str] | None = None, longest: int = 0
) -> Callable[..., Any]:
    """The adjoint of a part.

    Args:
        function: a part, or any function of what parts are made of. What it calls is read, too.
        given: the kind of each argument: a NamedTuple class, ``float``, ``int``, ``bool``, :class:`Array` for a
            float64 array that it reads or writes, or :class:`Fixed`. Arguments behind them have their defaults.
        wrt: names of the arguments whose adjoints are returned; None: of all NamedTuples and floats.
        longest: loops whose count is not known beforehand have at most so many turns; 0: they are refused.

    Returns:
        a part of: the arguments without the fixed ones; then for each value that ``function`` returns its adjoint (a
        NamedTuple of the same class, or a float); then for each array its adjoint, an array of the same shape, which
        on entry holds the adjoint of the array after the call and on return that of the array before it. It returns a
        tuple of the adjoints of ``wrt``. Arrays are left as they were found; flags have the adjoint False.

    Raises:
        InvalidInput: something of the source has no adjoint; the message tells what, in which file and line.
    """
    names = function.__code__.co_varnames[: function.__code__.co_argcount]
    reader = Reader(longest)
    values = [k.value if isinstance(k, Fixed) else reader.argument(n, k) for n, k in zip(names, given, strict=False)]
    by_name = {n: k for n, k in zip(names, given, strict=False) if not isinstance(k, Fixed)}
    if wrt is None:
        wrt = [name for name, kind in by_name.items() if kind is float or is_part(kind)]
    for name in wrt:
        if not (by_name.get(name) is float or is_part(by_name.get(name))):
            raise InvalidInput(f"'{name}' is no NamedTuple and no float of '{function.__name__}', so has no adjoint")
    result = reader.call(function, values, {})
    results = [] if result is None else (_opened(result).values if _is_tuple(result) else [result])
    sources = {name: value for name, value in zip(names, values, strict=False) if name in wrt}
    return _Writer(function, reader.nodes, by_name, sources, results).written()


def _is_tuple(value: Any) -> bool:
    return (isinstance(value, Record) and value.cls is None) or type(value) is tuple


def _opened(value: Any) -> Any:
    return Record(type(value) if is_part(type(value)) else None, list(value)) if isinstance(value, tuple) else value


class _Writer:
    """Writes the adjoint of a list of operations."""

    def __init__(
        self,
        function: Callable[..., Any],
        nodes: list[Node],
        arguments: dict[str, Any],
        sources: dict[str, Any],
        results: list[Any],
    ) -> None:
        self.function, self.nodes, self.arguments, self.sources, self.results = (
            function, nodes, arguments, sources, results,
        )  # fmt: skip
        self.space: dict[str, Any] = dict(_SPACE)
        self.arrays = [name for name, kind in arguments.items() if kind is Array]
        self.named: set[Node] = set()  # nodes that the written lines use
        self.grown: set[Node] = set()  # nodes whose adjoint has a first term
        self.back: list[str] = []  # lines of the way back

    def written(self) -> Callable[..., Any]:
        """The function."""
        name = f"{self.function.__name__}_adjoint"
        self.live = self._active() & self._useful()
        bars = [f"result_{i}" for i in range(len(self.results))]
        for bar, value in zip(bars, self.results, strict=True):
            self._enter(bar, value)
        for node in reversed(self.nodes):
            self._reverse(node)
        returned = ", ".join(self._returned(value) for value in self.sources.values())
        parameters = [*self.arguments, *bars, *(f"{array}_bar" for array in self.arrays)]
        lines = [*self._forward(), *self.back, f"return ({returned},)" if returned else "return"]
        text = f"def {name}({', '.join(parameters)}):\n" + "".join(f"    {line}\n" for line in lines)
        file = f"<adjoint of {self.function.__module__}.{self.function.__qualname__}, {zlib.crc32(text.encode()):x}>"
        linecache.cache[file] = (len(text), None, text.splitlines(keepends=True), file)
        exec(compile(text, file, "exec"), self.space)
        made: Any = self.space[name]
        made.__module__ = self.function.__module__
        made.__doc__ = f"Adjoint of :func:`{self.function.__name__}`, see :mod:`kerfgym.envs.engine.adjoint`."
        made.text = text
        return part(made)

    # ---------------------------------------------------------------------------------------- what has an adjoint

    def _active(self) -> set[Node]:
        """Numbers that depend on what adjoints are asked for, or on an array."""
        found = {node for value in self.sources.values() for node in _leaves(value)}
        for node in self.nodes:
            if node.kind is float and node.operation != "leaf":
                rule = _RULES.get(node.operation)
                back = {0} if rule is None else {i for i, _, _ in rule.back}
                if node.operation == "load" or any(node.args[i] in found for i in back if i < len(node.args)):
                    found.add(node)
        return {node for node in found if node.kind is float}

    def _useful(self) -> set[Node]:
        """Numbers on which results depend, or arrays."""
        found = {node for value in self.results for node in _leaves(value)}
        for node in reversed(self.nodes):
            if node.operation == "store" and isinstance(node.args[1], Node):
                found.add(node.args[1])
            elif node in found and node.operation in _RULES:
                found |= {x for i, _, _ in _RULES[node.operation].back if isinstance(x := node.args[i], Node)}
        return found

    # ---------------------------------------------------------------------------------------------- the way back

    def _use(self, value: Any) -> str:
        """A value as the code names it."""
        if isinstance(value, Node):
            self.named.add(value)
            return value.text if value.operation == "leaf" else f"v{value.index}"
        if isinstance(value, bool | np.bool_):
            return str(bool(value))
        if isinstance(value, int):
            return f"({value})" if value < 0 else str(value)
        if isinstance(value, float):
            return f"({float(value)!r})" if value < 0 else repr(float(value))
        name = f"k_{type(value).__name__}_{value}".replace("-", "m")
        self.space[name] = value  # a whole number of NumPy's, whose type counts
        return name

    def _enter(self, bar: str, value: Any) -> None:
        """The adjoint of a result reaches the nodes that it is made of."""
        value = _opened(value)
        if isinstance(value, Record):
            fields = value.cls._fields if value.cls else range(len(value.values))
            for field, inner in zip(fields, value.values, strict=True):
                self._enter(f"{bar}.{field}" if value.cls else f"{bar}[{field}]", inner)
        elif isinstance(value, Node) and value in self.live:
            self._grow(value, _TERM, bar)

    def _grow(self, node: Node, how: str, what: str, d: str = "") -> None:
        """One more term of a node's adjoint."""
        bar, first = f"b{node.index}", node not in self.grown
        self.grown.add(node)
        line = {
            _ADD: d if first else f"{bar} + {d}",
            _TAKE: f"-{d}" if first else f"{bar} - {d}",
            _TIMES: f"{d} * {what}" if first else f"fma({d}, {what}, {bar})",
            _TERM: what if first else f"{bar} + ({what})",
        }[how]
        self.back.append(f"{bar} = {line}")

    def _reverse(self, node: Node) -> None:
        """From the adjoint of a result to those of its arguments."""
        if node.operation == "store":
            self._reverse_store(node)
        if node not in self.grown or node.operation == "leaf":
            return
        if node.operation == "load":
            place = f"{node.text}_bar[{self._use(node.args[0])}]"
            self.back += self._if(node.guard, f"{place} += b{node.index}")
            return
        rule, d = _RULES[node.operation], f"b{node.index}"
        for i, how, what in rule.back:
            if (argument := node.args[i]) in self.live:
                text = what.format(*(self._use(x) if f"{{{j}}}" in what else "" for j, x in enumerate(node.args)),
                                   z=self._use(node) if "{z}" in what else "", d=d)  # fmt: skip
                if rule.singular and node.guard is not None:
                    text = f"({text}) if {self._use(node.guard)} else 0.0"
                self._grow(argument, how, text, d)

    def _reverse_store(self, node: Node) -> None:
        """What was written has the adjoint of its place; what had been there has none. The array is put back."""
        index, value = node.args
        place, kept = self._use(index), f"o{node.index}"
        bar = f"{node.text}_bar[{place}]"
        if isinstance(value, Node) and value in self.live:
            self._grow(value, _TERM, f"{bar} if {self._use(node.guard)} else 0.0" if node.guard is not None else bar)
        self.back += self._if(node.guard, f"{bar} = 0.0")
        self.back += self._if(node.guard, f"{node.text}[{place}] = {kept}")
        self._use(value)

    def _if(self, guard: Node | None, line: str) -> list[str]:
        return [line] if guard is None else [f"if {self._use(guard)}:", f"    {line}"]

    # ------------------------------------------------------------------------------------------------ the way there

    def _forward(self) -> list[str]:
        """The operations that the way back needs, again."""
        lines: list[list[str]] = []
        for node in reversed(self.nodes):
            if node.operation == "store":
                place, value = self._use(node.args[0]), self._use(node.args[1])
                kept = f"{node.text}[{place}]"
                found = [f"o{node.index} = {kept if node.guard is None else self._guarded(kept, node.guard)}"]
                lines.append(found + self._if(node.guard, f"{kept} = {value}"))
            elif node in self.named and node.operation != "leaf":
                if node.operation == "load":
                    text = f"{node.text}[{self._use(node.args[0])}]"
                    text = text if node.guard is None else self._guarded(text, node.guard)
                else:
                    rule = _RULES[node.operation]
                    text = rule.forward.format(*map(self._use, node.args))
                    if node.operation == "select" and node.kind is float:
                        text = "choose({}, {}, {})".format(*map(self._use, node.args))
                    text = self._guarded(text, node.guard) if rule.singular and node.guard is not None else text
                lines.append([f"v{node.index} = {text}"])
        return [line for group in reversed(lines) for line in group]

    def _guarded(self, text: str, guard: Node) -> str:
        """An access to an array, or a division, only where it counts: elsewhere the index may be anything."""
        return f"{text} if {self._use(guard)} else 0.0"

    def _returned(self, value: Any) -> str:
        """The adjoint of an argument, as an expression."""
        if isinstance(value, Record):
            name = next(
                n for i in range(99) if self.space.get(n := f"{value.cls.__name__}_{i}", value.cls) is value.cls
            )
            self.space[name] = value.cls
            return f"{name}({', '.join(map(self._returned, value.values))})"
        if value.kind is not float:
            return "False"
        return f"b{value.index}" if value in self.grown else "0.0"


def _leaves(value: Any) -> list[Node]:
    """The nodes of a value."""
    value = _opened(value)
    if isinstance(value, Record):
        return [node for inner in value.values for node in _leaves(inner)]
    return [value] if isinstance(value, Node) else []
