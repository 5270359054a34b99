"""One-line mistakes in a source file: where, what stands there, and what is put in its place.

A mutant changes the text between two places of the syntax tree and nothing else, so that its report is the line that a
reader would find in a diff. What is left out:

- numbers in annotations and defaults of NamedTuple classes: ``docs/machine.md`` states them a second time, and a test
  compares the two;
- addresses within ``load`` and ``store``, which say where a number lies and not what it is;
- decorators, docstrings, and what stands in messages.
"""

import ast
import random
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

_SWAPS = {ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*")}
_COMPARISONS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
_OPPOSITE = {"<": ">=", "<=": ">", ">": "<=", ">=": "<", "==": "!=", "!=": "=="}
_BOUNDARY = {"<": "<=", "<=": "<", ">": ">=", ">=": ">"}
_NAMES = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "floor": "ceil", "ceil": "floor"}
_ADDRESSES = ("load", "store")


class Mutant(NamedTuple):
    """A mistake: bytes ``start`` to ``stop`` of ``file`` are replaced."""

    file: str  # from the package's folder on, such as envs/plant/cut.py
    line: int
    kind: str
    start: int
    stop: int
    old: str
    new: str

    @property
    def name(self) -> str:
        """Names it among the mutants of its file."""
        return f"{self.file}:{self.line}:{self.start} {self.kind}: {_short(self.old)} → {_short(self.new)}"

    def applied(self, source: bytes) -> bytes:
        """The file's text with the mistake in it."""
        assert source[self.start : self.stop].decode() == self.old
        return source[: self.start] + self.new.encode() + source[self.stop :]


def _short(text: str) -> str:
    return " ".join(text.split())


def mutants(path: Path, file: str) -> list[Mutant]:
    """All mutants of a source file, in the order of their places; ``file``: how they name it."""
    source = path.read_bytes()
    found = _Finder(source, file).of(ast.parse(source))
    return sorted(set(found), key=lambda m: (m.start, m.stop, m.kind, m.new))


def sample(every: Iterable[Mutant], count: int, seed: int) -> list[Mutant]:
    """``count`` of them (or all, if there are fewer), each as likely as any other, in their old order."""
    known = list(every)
    chosen = random.Random(seed).sample(range(len(known)), min(count, len(known)))
    return [known[i] for i in sorted(chosen)]


class _Finder:
    def __init__(self, source: bytes, file: str) -> None:
        self.source, self.file = source, file
        self.lines = [0]
        for line in source.splitlines(keepends=True):
            self.lines.append(self.lines[-1] + len(line))

    def of(self, node: ast.AST) -> Iterator[Mutant]:
        """Mutants of a node and of all below it."""
        yield from self._own(node)
        for child in self._children(node):
            yield from self.of(child)

    def _children(self, node: ast.AST) -> Iterable[ast.AST]:
        if isinstance(node, ast.ClassDef):
            return [each for each in node.body if isinstance(each, ast.FunctionDef)]
        if isinstance(node, ast.FunctionDef):
            return node.body
        if isinstance(node, ast.AnnAssign):
            return [node.value] if node.value else []
        if isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr | ast.Import | ast.ImportFrom):
            return []
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in _ADDRESSES:
            return node.args[3:] if node.func.id == "load" else node.args[2:]
        return ast.iter_child_nodes(node)

    def _own(self, node: ast.AST) -> Iterator[Mutant]:
        kinds: dict[type, Callable[[ast.AST], Iterator[Mutant]]] = {
            ast.BinOp: self._operator,
            ast.Compare: self._comparison,
            ast.BoolOp: self._junction,
            ast.Constant: self._number,
            ast.Call: self._call,
            ast.IfExp: self._choice,
            ast.UnaryOp: self._sign,
        }
        return kinds.get(type(node), lambda _: iter(()))(node)

    # ------------------------------------------------------------------------------------------------ places

    def _at(self, line: int, column: int) -> int:
        return self.lines[line - 1] + column

    def _span(self, node: ast.AST) -> tuple[int, int]:
        return self._at(node.lineno, node.col_offset), self._at(node.end_lineno, node.end_col_offset)  # type: ignore

    def _between(self, left: ast.AST, right: ast.AST, token: str) -> int:
        """Where ``token`` stands between two nodes."""
        low, high = self._span(left)[1], self._span(right)[0]
        return low + self.source[low:high].index(token.encode())

    def _made(self, node: ast.AST, kind: str, start: int, stop: int, new: str) -> Mutant:
        return Mutant(self.file, node.lineno, kind, start, stop, self.source[start:stop].decode(), new)  # type: ignore

    # ----------------------------------------------------------------------------------------------- mistakes

    def _operator(self, node: ast.AST) -> Iterator[Mutant]:
        assert isinstance(node, ast.BinOp)
        if type(node.op) not in _SWAPS:
            return
        old, new = _SWAPS[type(node.op)]
        start, stop = self._span(node)
        at = self._between(node.left, node.right, old)
        text = self.source
        swapped = text[start:at] + new.encode() + text[at + 1 : stop]
        yield self._made(node, "operator", start, stop, f"({swapped.decode()})")
        if isinstance(node.op, ast.Add | ast.Sub):
            yield self._made(node, "term dropped", start, stop, f"({text[start:at].decode().rstrip()})")
        if isinstance(node.op, ast.Add):
            yield self._made(node, "term dropped", start, stop, f"({text[at + 1 : stop].decode().lstrip()})")

    def _comparison(self, node: ast.AST) -> Iterator[Mutant]:
        assert isinstance(node, ast.Compare)
        left = node.left
        for op, right in zip(node.ops, node.comparators, strict=True):
            if type(op) in _COMPARISONS:
                old = _COMPARISONS[type(op)]
                at = self._between(left, right, old)
                for kind, words in (("comparison", _OPPOSITE), ("boundary", _BOUNDARY)):
                    if old in words:
                        yield self._made(node, kind, at, at + len(old), words[old])
            left = right

    def _junction(self, node: ast.AST) -> Iterator[Mutant]:
        assert isinstance(node, ast.BoolOp)
        old, new = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
        start, stop = self._span(node)
        text, cuts = b"", [start]
        for left, right in zip(node.values[:-1], node.values[1:], strict=True):
            at = self._between(left, right, old)
            text += self.source[cuts[-1] : at] + new.encode()
            cuts.append(at + len(old))
        yield self._made(node, "junction", start, stop, f"({(text + self.source[cuts[-1] : stop]).decode()})")

    def _number(self, node: ast.AST) -> Iterator[Mutant]:
        assert isinstance(node, ast.Constant)
        x = node.value
        if type(x) not in (int, float):
            return
        start, stop = self._span(node)
        halves = [x / 2] if isinstance(x, float) else ([x // 2] if x % 2 == 0 else [])
        for new in dict.fromkeys([2 * x, *halves, type(x)(0)] if x else [type(x)(1)]):
            if new != x:
                yield self._made(node, "number", start, stop, repr(new))

    def _call(self, node: ast.AST) -> Iterator[Mutant]:
        assert isinstance(node, ast.Call)
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        stop = self._span(node.func)[1]
        if name in _NAMES and not (name in ("min", "max") and isinstance(node.func, ast.Attribute)):
            yield self._made(node, "function", stop - len(name), stop, _NAMES[name])
        if name in ("clip", "abs") and node.args:
            start, stop = self._span(node.args[0])
            kind = "limit dropped" if name == "clip" else "sign kept"
            yield self._made(node, kind, *self._span(node), f"({self.source[start:stop].decode()})")

    def _choice(self, node: ast.AST) -> Iterator[Mutant]:
        assert isinstance(node, ast.IfExp)
        if not isinstance(node.test, ast.Compare):
            start, stop = self._span(node.test)
            yield self._made(node, "choice", start, stop, f"(not ({self.source[start:stop].decode()}))")

    def _sign(self, node: ast.AST) -> Iterator[Mutant]:
        assert isinstance(node, ast.UnaryOp)
        start, stop = self._span(node)
        inner = self._span(node.operand)[0]
        if isinstance(node.op, ast.USub):
            yield self._made(node, "sign dropped", start, stop, self.source[start + 1 : stop].decode().lstrip())
        elif isinstance(node.op, ast.Not):
            yield self._made(node, "not dropped", start, stop, self.source[start + 3 : stop].decode().lstrip())
        assert inner > start
