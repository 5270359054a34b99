"""One part as one function of C.

The text is gone through until the kinds of all variables are known, and once more to write it. What is evaluated is
what the kernel evaluates, in the same order, so in ``double`` and without contracted operations it has the same bits.
"""

import ast
import inspect
import io
import re
import textwrap
import tokenize
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

from ..quantity import InvalidInput
from .expressions import Expressions
from .values import INT, NOTHING, REAL, Grid, Kind, Row, Several, Struct, Value, joined
from .words import WIDTH, plain, safe

INDENT = "    "
ROUNDS = 6
"""Times that a text is gone through before the kinds of its variables are given up."""


@dataclass
class Function:
    """A part in C.

    Attributes:
        name: of the function.
        arguments: those that it uses, by the places that they have in the part.
        gives: kind of what it returns.
        word: C type of that.
        members: names of the members of a struct of several.
        text: its definition.
        writes: places of the arguments whose numbers it changes.
        dirty: whether it gives a whole number made of a real one.
    """

    name: str
    arguments: tuple[int, ...] = ()
    gives: Kind = NOTHING
    word: str = "void"
    members: tuple[str, ...] = ()
    text: str = ""
    writes: frozenset[int] = frozenset()
    dirty: bool = False


def translated(
    unit: Any, part: Callable[..., Any], arguments: tuple[Kind, ...], name: str, loose: frozenset[int] = frozenset()
) -> Function:
    """The function of C of a part.

    Args:
        unit: to which it belongs.
        part: a function of Python.
        arguments: kinds of its arguments.
        name: in C.
        loose: arguments that are whole numbers made of real ones, which may be anything.

    Raises:
        InvalidInput: something in it cannot be said in C, with file and line.
    """
    known: dict[str, Kind] = {}
    changed: set[str] = set()
    for _ in range(ROUNDS):
        writer = _Writer(unit, part, arguments, name, dict(known), loose)
        writer.known_changed = changed
        function = writer.written()
        if writer.kinds == known and writer.changed == changed:
            return function
        known, changed = writer.kinds, writer.changed
    raise InvalidInput(f"{writer.where(None)}: the kinds of its variables do not settle")


@dataclass
class _Block:
    """Lines that are being written, and the variables that are declared among them."""

    lines: list[str] = field(default_factory=list)
    declared: set[str] = field(default_factory=set)


class _Writer(Expressions):
    """Writes one function."""

    def __init__(
        self,
        unit: Any,
        part: Callable[..., Any],
        arguments: tuple[Kind, ...],
        name: str,
        known: dict[str, Kind],
        loose: frozenset[int],
    ) -> None:
        super().__init__(unit, part)
        source, self.first = inspect.getsourcelines(part)
        text = textwrap.dedent("".join(source))
        tree = ast.parse(text).body[0]
        assert isinstance(tree, ast.FunctionDef)
        self.tree, self.name, self.kinds = tree, name, known
        self.notes, self.own_lines = _comments(text)
        self.noted: set[int] = set()
        names = [each.arg for each in tree.args.args]
        if len(names) != len(arguments) or tree.args.vararg or tree.args.kwonlyargs:
            raise self.refused(tree, f"{len(names)} arguments, of which {len(arguments)} are given")
        self.arguments = dict(zip(names, arguments, strict=True))
        self.gives: Kind | None = None
        self.members: tuple[str, ...] = ()
        self.blocks: list[_Block] = [_Block()]
        self.references = _references(tree)
        self.assigned = _assigned(tree)
        self.counter, self.next_copies, self.dirty = 0, 0, False
        self.known_changed: set[str] = set()
        self.results: dict[str, list[str]] = {}
        self.copies: dict[str, tuple[int, Value, dict[str, Value]]] = {}
        for i, (argument, kind) in enumerate(self.arguments.items()):
            self.variables[argument] = replace(self._argument(argument, kind), dirty=i in loose)

    # ------------------------------------------------------------------------------------------------------ the whole

    def written(self) -> Function:
        """The function; :attr:`kinds` then has what its variables were found to be."""
        body = self.tree.body
        doc = ast.get_docstring(self.tree)
        if doc is not None:
            body = body[1:]
        for name, kind in self.arguments.items():  # what is given another value is a copy
            if name in self.assigned and isinstance(kind, Struct):
                self.line(f"{self.unit.word(kind)} {self.local(name)} = *{self.local(name)}_given;")
                self.used.add(name)
        ends = self.statements(body)
        gives = self.gives or NOTHING
        if gives != NOTHING and not ends:
            raise self.refused(self.tree, "it does not return a value on every way through it")
        order = list(self.arguments)
        used = tuple(i for i, name in enumerate(order) if name in self.used)
        word = self._answer_word(gives)
        given = ", ".join(self._parameter(order[i]) for i in used) or "void"
        head = f"static {word} {self.name}({given})"
        if len(head) > 100:
            head = (
                f"static {word} {self.name}(\n{INDENT}"
                + f",\n{INDENT}".join(self._parameter(order[i]) for i in used)
                + ")"
            )
        text = "\n".join([*self._heading(doc), head, "{", *_broken(self.blocks[0].lines), "}"])
        writes = frozenset(i for i, name in enumerate(order) if name in self.changed)
        return Function(self.name, used, gives, word, self.members, text, writes, self.dirty)

    def _heading(self, doc: str | None) -> list[str]:

        if not doc:
            return []
        lines = []
        for line in plain(doc).split("\n"):
            lines += textwrap.wrap(line, WIDTH - 3, subsequent_indent=" " * (len(line) - len(line.lstrip()))) or [""]
        if len(lines) == 1:
            return [f"/* {lines[0]} */"]
        return [f"/* {lines[0]}", *(f" * {x}".rstrip() for x in lines[1:]), " */"]

    def _answer_word(self, gives: Kind) -> str:
        if gives == NOTHING:
            return "void"
        if not isinstance(gives, Several):
            return self.unit.word(gives)
        words = [(self.unit.word(kind), member) for kind, member in zip(gives.kinds, self.members, strict=True)]
        return self.unit.result(self.name, words)

    def _argument(self, name: str, kind: Kind) -> Value:
        if isinstance(kind, Struct) and name not in self.assigned:
            return Value(kind, f"(*{self.local(name)})")
        return Value(kind, self.local(name))

    def _parameter(self, name: str) -> str:
        kind, word = self.arguments[name], self.local(name)
        if isinstance(kind, Struct):
            return f"const {self.unit.word(kind)} *{word}{'_given' * (name in self.assigned)}"
        if isinstance(kind, Row):
            return f"{'' if name in self.changed else 'const '}{self.unit.real} *{word}"
        return f"{self.unit.word(kind)} {word}"

    def local(self, name: str) -> str:
        """A variable's name in C."""
        return safe(name.lstrip("_") or "unused")

    def line(self, text: str) -> None:
        """Writes a line."""
        self.blocks[-1].lines.append(text)

    def passing(self, kind: Kind, value: Value) -> str:
        """A new variable that holds a value for what follows; its name."""
        self.counter += 1
        name = f"passing_{self.counter}"
        self.line(f"const {self.unit.word(kind)} {name} = {value.code};")
        return name

    def changed_copy(self, whole: Value, changes: dict[str, Value]) -> Value:
        """A copy of a struct with some fields changed."""
        self.next_copies += 1
        name = f"next_{self.next_copies}" if self.next_copies > 1 else "next"
        begin = len(self.blocks[-1].lines)
        code = whole.code[1:-1] if whole.code.startswith("(*") else whole.code
        self.line(f"{self.unit.word(whole.kind)} {name} = {code};")
        made = Value(whole.kind, name)
        for field_name, part in changes.items():
            self.line(f"{self.member(made, field_name).code} = {part.code};")
        self.copies[name] = (begin, whole, changes)
        return made

    def changes_itself(self, own: Value, value: Value) -> bool:
        """Writes the change of some fields of a variable in place, where the copy that was made has no other use."""
        found = self.copies.get(value.code)
        if found is None or found[1].code != own.code or any(own.code in part.code for part in found[2].values()):
            return False
        del self.blocks[-1].lines[found[0] :]
        for name, part in found[2].items():
            self.line(f"{self.member(own, name).code} = {part.code};")
        return True

    def held_result(self, word: str, code: str) -> str:
        """A variable with what a function gives."""
        if self.lazy:
            raise self.refused(None, "a call that gives several things, in a part of a condition")
        self.counter += 1
        name = f"found_{self.counter}" if self.counter > 1 else "found"
        self.line(f"const {word} {name} = {code};")
        self.results[name] = [member for _, member in self.unit.results[word]]
        return name

    # ----------------------------------------------------------------------------------------------------- statements

    def statements(self, body: Iterable[ast.stmt]) -> bool:
        """Writes them; whether the last of them leaves the function on every way."""
        ends = False
        for statement in body:
            self._notes_before(statement)
            ends = self._statement(statement)
            self._note_behind(statement)
        return ends

    def _notes_before(self, statement: ast.stmt) -> None:
        for number in range(max(1, statement.lineno - 12), statement.lineno):
            if (
                number in self.own_lines
                and number not in self.noted
                and all(n in self.own_lines for n in range(number, statement.lineno))
            ):
                self.noted.add(number)
                self.line(f"/* {self.own_lines[number]} */")

    def _note_behind(self, statement: ast.stmt) -> None:
        last = statement.lineno if isinstance(statement, ast.If | ast.For | ast.While) else statement.end_lineno
        note = self.notes.get(last or 0)
        if (
            note
            and last not in self.noted
            and self.blocks[-1].lines
            and not isinstance(statement, ast.If | ast.For | ast.While)
        ):
            self.noted.add(last or 0)
            self.blocks[-1].lines[-1] += f" /* {note} */"

    def _statement(self, s: ast.stmt) -> bool:
        if isinstance(s, ast.Return):
            self._return(s)
            return True
        if isinstance(s, ast.Assign):
            for target in s.targets:
                self._assign(target, self.value(s.value), s)
        elif isinstance(s, ast.AugAssign):
            operation = ast.copy_location(ast.BinOp(_loaded(s.target), s.op, s.value), s)
            self._assign(s.target, self.value(operation), s, (s.op, s.value))
        elif isinstance(s, ast.AnnAssign) and s.value is not None:
            self._assign(s.target, self.value(s.value), s)
        elif isinstance(s, ast.If):
            return self._if(s)
        elif isinstance(s, ast.For):
            self._for(s)
        elif isinstance(s, ast.While):
            test = self.condition(s.test)
            self.line(f"while ({test}) {{{self._beside(s)}")
            self._inner(s.body)
            self.line("}")
        elif isinstance(s, ast.Expr) and isinstance(s.value, ast.Call):
            self.line(f"{self.value(s.value).code};")
        elif isinstance(s, ast.Break | ast.Continue):
            self.line("break;" if isinstance(s, ast.Break) else "continue;")
        elif not isinstance(s, ast.Pass) and not (isinstance(s, ast.Expr) and isinstance(s.value, ast.Constant)):
            raise self.refused(s, f"a statement of the kind {type(s).__name__}")
        return False

    def _beside(self, s: ast.stmt) -> str:
        note = self.notes.get(s.lineno)
        if not note or s.lineno in self.noted:
            return ""
        self.noted.add(s.lineno)
        return f" /* {note} */"

    def _inner(self, body: list[ast.stmt]) -> bool:
        self.blocks.append(_Block())
        ends = self.statements(body)
        inner = self.blocks.pop()
        self.blocks[-1].lines += [INDENT + line if line else "" for line in inner.lines]
        return ends

    def _if(self, s: ast.If) -> bool:
        self._declare_shared([s.body, s.orelse], s)
        self.line(f"if ({self.condition(s.test)}) {{{self._beside(s)}")
        ends = self._inner(s.body)
        orelse = s.orelse
        while len(orelse) == 1 and isinstance(orelse[0], ast.If):
            inner, before = orelse[0], len(self.blocks[-1].lines)
            test = self.condition(inner.test)
            if len(self.blocks[-1].lines) != before:  # it needs a line of its own first
                del self.blocks[-1].lines[before:]
                break
            self._declare_shared([inner.body, inner.orelse], s)
            self.line(f"}} else if ({test}) {{{self._beside(inner)}")
            ends = self._inner(inner.body) and ends
            orelse = inner.orelse
        if orelse:
            self.line("} else {")
            ends = self._inner(orelse) and ends
        else:
            ends = False
        self.line("}")
        return ends

    def _for(self, s: ast.For) -> None:
        call = s.iter
        if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "range") or s.orelse:
            raise self.refused(s, "a loop over something else than range()")
        if not isinstance(s.target, ast.Name):
            raise self.refused(s, "a loop with several variables")
        ends = [self.value(each) for each in call.args]
        if any(end.kind != INT for end in ends):
            raise self.refused(s, "range() of numbers that are not whole")
        start, stop = (ends[0].code, ends[1]) if len(ends) > 1 else ("0", ends[0])
        step = ends[2].known if len(ends) > 2 else 1
        if step not in (1, -1):
            raise self.refused(s, "a loop with another step than 1 or −1")
        name = s.target.id
        self.kinds[name] = INT
        word = self.local(name)
        if name == "_":
            self.counter += 1
            word = f"turn_{self.counter}"
        after = any(n > (s.end_lineno or 0) for n in self.references.get(name, ())) or name in self.blocks[-1].declared
        declared = "" if after else "int "
        if after and not self._is_declared(name):
            self.line(f"int {word} = 0;")
            self.blocks[-1].declared.add(name)
        self.variables[name] = Value(INT, word, dirty=any(end.dirty for end in ends))
        sign, change = ("<", f"{word}++") if step == 1 else (">", f"{word}--")
        self._declare_shared([s.body], s)
        self.line(f"for ({declared}{word} = {start}; {word} {sign} {stop.at(10)}; {change}) {{{self._beside(s)}")
        self.blocks.append(_Block(declared={name}))
        self.statements(s.body)
        inner = self.blocks.pop()
        self.blocks[-1].lines += [INDENT + line if line else "" for line in inner.lines]
        self.line("}")

    def _return(self, s: ast.Return) -> None:
        if s.value is None:
            self.gives = self.gives or NOTHING
            self.line("return;")
            return
        value = self.value(s.value)
        gives = value.kind if self.gives is None else joined(self.gives, value.kind)
        expected = self.kinds.get("return", gives)
        gives = joined(gives, expected) if gives and expected else None
        if gives is None:
            raise self.refused(s, "it returns different kinds of values")
        self.gives = self.kinds["return"] = gives
        value = self.as_kind(value, gives, s)
        self.dirty = self.dirty or value.dirty
        if not isinstance(gives, Several):
            self.line(f"return {value.code};")
            return
        if not self.members:
            given = s.value.elts if isinstance(s.value, ast.Tuple) else []
            names = self.results.get(value.code) or _members(given or [None] * len(gives.kinds), gives.kinds)
            self.members = tuple(n if names.count(n) == 1 else f"{n}_{i}" for i, n in enumerate(names))
        word = self._answer_word(gives)
        parts = ", ".join(f".{name} = {part.code}" for name, part in zip(self.members, value.parts, strict=True))
        self.line(f"return ({word}){{{parts}}};")

    # ---------------------------------------------------------------------------------------------------- assignments

    def _assign(
        self, target: ast.expr, value: Value, s: ast.stmt, grown: tuple[ast.operator, ast.expr] | None = None
    ) -> None:
        if isinstance(target, ast.Tuple):
            self._unpack(target, value, s)
        elif isinstance(target, ast.Name):
            self._to_name(target.id, value, s, grown)
        elif isinstance(target, ast.Subscript):
            place = self.place(target)
            wanted = self.as_kind(value, REAL, s)
            if grown and type(grown[0]) in _GROWS:
                more = self.as_kind(self.value(grown[1]), REAL, s)
                self.line(f"{place.code} {_GROWS[type(grown[0])]} {more.code};")
            else:
                self.line(f"{place.code} = {wanted.code};")
        else:
            raise self.refused(s, "an assignment to an attribute")

    def _unpack(self, target: ast.Tuple, value: Value, s: ast.stmt) -> None:
        parts = value.parts if isinstance(value.kind, Several) else self.members_of(value)
        if parts is None or len(parts) != len(target.elts):
            raise self.refused(s, f"{len(target.elts)} names for something else")
        written = {self.local(n.id) for each in target.elts for n in ast.walk(each) if isinstance(n, ast.Name)}
        read = [set(re.findall(r"(?<![.>\w])\w+", part.code)) & written for part in parts]
        if any(read[1:]):  # all are evaluated before any of them changes
            held = []
            for part in parts:
                plain = part.is_known or isinstance(part.kind, Several | Row)
                held.append(part if plain else Value(part.kind, self.passing(part.kind, part), dirty=part.dirty))
            parts = tuple(held)
        for each, part in zip(target.elts, parts, strict=True):
            if not (isinstance(each, ast.Name) and each.id == "_"):
                self._assign(each, part, s)

    def _to_name(
        self, name: str, value: Value, s: ast.stmt, grown: tuple[ast.operator, ast.expr] | None = None
    ) -> None:
        if isinstance(value.kind, Several):
            kept = []
            for i, part in enumerate(value.parts):
                self._to_name(f"{name}_{i}", part, s)
                kept.append(self.variables[f"{name}_{i}"])
            self.variables[name] = Value(value.kind, "", parts=tuple(kept))
            return
        row = isinstance(value.kind, Row) and self._once(name) and value.code.isidentifier()
        if row or isinstance(value.kind, Grid):
            self.variables[name] = value  # another name for the same numbers
            return
        kind = joined(self.kinds.get(name), value.kind)
        if kind is None:
            raise self.refused(s, f"'{name}' is now one kind of value and now another")
        self.kinds[name] = kind
        if isinstance(kind, Row):
            self._to_row(name, value, kind)
            return
        value = self.as_kind(value, kind, s)
        word = self.local(name)
        own = self.variables.get(name)
        if name in self.arguments or self._is_declared(name):
            if grown and type(grown[0]) in _GROWS and kind == value.kind:
                more = self.as_kind(self.value(grown[1]), kind, s)
                self.line(f"{word} {_GROWS[type(grown[0])]} {more.code};")
            elif own is not None and self.changes_itself(own, value):
                pass
            else:
                self.line(f"{word} = {value.code};")
        else:
            const = "const " if self._once(name) else ""
            self.line(f"{const}{self.unit.word(kind)} {word} = {value.code};")
            self.blocks[-1].declared.add(name)
        self.variables[name] = Value(kind, word, dirty=value.dirty)

    def _to_row(self, name: str, value: Value, kind: Row) -> None:
        word, root = self.local(name), self.roots.get(value.code.split(" ")[0].lstrip("("), "")
        self.roots[word] = root or value.code.split(" ")[0].lstrip("(")
        constant = "" if name in self.known_changed else "const "
        self.line(f"{constant}{self.unit.real} *const {word} = {value.code};")
        self.blocks[-1].declared.add(name)
        self.variables[name] = Value(kind, word)

    def _once(self, name: str) -> bool:
        return self.assigned.get(name, 0) <= 1

    def _is_declared(self, name: str) -> bool:
        return any(name in block.declared for block in self.blocks)

    def _declare_shared(self, bodies: list[list[ast.stmt]], s: ast.stmt) -> None:
        """Declares what is first given a value within, and read or given another one outside of where that is."""
        names: dict[str, list[int]] = {}
        for i, body in enumerate(bodies):
            for name in _assigned_in(body):
                names.setdefault(name, []).append(i)
        loop = isinstance(s, ast.For | ast.While)
        for name, places in names.items():
            if self._is_declared(name) or name in self.arguments:
                continue
            lines = self.references.get(name, ())
            start, end = s.lineno, s.end_lineno or s.lineno
            beyond = any(n > end or n < start for n in lines)
            kind = self.kinds.get(name)
            if (beyond or len(set(places)) > 1 or (loop and self._read_first(name, bodies[0]))) and kind is not None:
                if isinstance(kind, Several | Row | Grid):
                    raise self.refused(s, f"'{name}', which is no single number, is first known in a branch")
                first = (
                    f" = {self.as_kind(Value(INT, '0', known=0), kind, s).code}" if not isinstance(kind, Struct) else ""
                )
                if kind.word == "bool":
                    first = " = false"
                self.line(f"{self.unit.word(kind)} {self.local(name)}{first};")
                self.blocks[-1].declared.add(name)
                self.variables[name] = Value(kind, self.local(name))

    def _read_first(self, name: str, body: list[ast.stmt]) -> bool:
        for statement in body:
            for node in ast.walk(statement):
                if isinstance(node, ast.Name) and node.id == name:
                    return isinstance(node.ctx, ast.Load) or isinstance(statement, ast.AugAssign)
        return False


def _broken(lines: list[str]) -> list[str]:
    """Lines of a function's body, indented, none too long where C leaves a place to break it."""

    out = []
    for line in lines:
        text = INDENT + line if line else ""
        code, note, words = text.partition(" /* ")
        indent = " " * (len(text) - len(text.lstrip()))
        if note and code.strip() and len(text) > WIDTH:
            out += [f"{indent}/* {words}"]
            text = code
        while len(text) > WIDTH and not text.lstrip().startswith("/*") and (at := _break_of(text, WIDTH)):
            out.append(text[:at].rstrip())
            text = indent + INDENT * 2 + text[at:].lstrip()
        out.append(text)
    return out


def _break_of(text: str, width: int) -> int:
    """Where a line is broken: as far outside of brackets as can be, and there as late; 0 if nowhere."""
    least, depth, best = len(text) - len(text.lstrip()) + 12, 0, (99, 0)
    for i, sign in enumerate(text[:width]):
        depth += (sign in "([{") - (sign in ")]}")
        for words, before in _BREAKS:
            if i + before > least and text.startswith(words, i) and depth <= best[0]:
                best = (depth, i + before)
    return best[1]


_BREAKS = ((", ", 2), (" && ", 1), (" || ", 1), (" ? ", 1), (" : ", 1), (" + ", 1), (" - ", 1))
"""Where a line may be broken, and how far behind the beginning of that."""

_GROWS = {ast.Add: "+=", ast.Sub: "-=", ast.Mult: "*=", ast.Div: "/="}


def _loaded(target: ast.expr) -> ast.expr:
    loaded = ast.parse(ast.unparse(target), mode="eval").body
    return ast.copy_location(loaded, target)


_ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth")


def _members(nodes: list[Any], kinds: tuple[Kind, ...]) -> list[str]:
    """What the members of several are called: as their variables are, or as what they are made by."""
    names = []
    for i, (node, kind) in enumerate(zip(nodes, kinds, strict=True)):
        if isinstance(node, ast.Name):
            names.append(node.id.lstrip("_"))
        elif isinstance(kind, Struct) and kind.cls.__name__ == "State":
            names.append("state")
        else:
            names.append("command" if i == 1 and names == ["state"] else _ORDINALS[i])
    return names


def _assigned_in(body: list[ast.stmt]) -> dict[str, int]:
    found: dict[str, int] = {}
    for statement in body:
        for node in ast.walk(statement):
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                found[node.id] = found.get(node.id, 0) + 1
    return found


def _assigned(tree: ast.FunctionDef) -> dict[str, int]:
    """How often each name is given a value; what a loop counts among them."""
    return _assigned_in(tree.body)


def _references(tree: ast.FunctionDef) -> dict[str, list[int]]:
    """Lines in which each name stands."""
    found: dict[str, list[int]] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            found.setdefault(node.id, []).append(node.lineno)
    return found


def _comments(text: str) -> tuple[dict[int, str], dict[int, str]]:
    """Comments behind statements, and those on lines of their own, by line."""

    behind: dict[int, str] = {}
    own: dict[int, str] = {}
    lines = text.split("\n")
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT and "fmt:" not in token.string and "noqa" not in token.string:
            alone = not lines[token.start[0] - 1][: token.start[1]].strip()
            (own if alone else behind)[token.start[0]] = plain(token.string.lstrip("# "))
    return behind, own
