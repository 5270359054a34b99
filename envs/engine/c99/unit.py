"""A unit of C: functions, structs, constants and tables that some parts need, in the order in which C wants them."""

import inspect
import re
import textwrap
from collections.abc import Callable
from typing import Any

import numpy as np

from ..quantity import InvalidInput, quantities
from .functions import Function, translated
from .values import BITS, BOOL, INT, REAL, Grid, Kind, Row, Struct, Value, fields_of, literal
from .words import HELPERS, KEYWORDS, WIDTH, plain, safe


class Unit:
    """What some parts are in C.

    Args:
        single: whether reals are ``float``; else ``double``.
    """

    def __init__(self, single: bool = False) -> None:
        self.single, self.real = single, "float" if single else "double"
        self.functions: dict[Any, Function] = {}
        self.structs: dict[Any, str] = {}
        self.constants: dict[str, tuple[Any, str]] = {}
        self.tables: dict[str, tuple[np.ndarray, str]] = {}
        self.helpers: dict[str, None] = {}
        self.results: dict[str, list[tuple[str, str]]] = {}
        self.fielded: dict[str, Any] = {}
        self._names: dict[str, Any] = {}
        self._running: list[Any] = []
        self.asked: list[str] = []

    # ---------------------------------------------------------------------------------------------- what parts need

    def function(
        self, part: Callable[..., Any], arguments: tuple[Kind, ...], loose: frozenset[int] = frozenset()
    ) -> Function:
        """A part for arguments of these kinds, of which some are whole numbers that may be anything.

        Raises:
            InvalidInput: something in it cannot be said in C, with file and line.
        """
        key = (part, arguments, loose)
        if key not in self.functions:
            if key in self._running:
                raise InvalidInput(f"{_where(part)}: {part.__name__} calls itself; C code here has no recursion")
            self._running.append(key)
            try:
                name = self.named(f"{_module(part)}_{part.__name__.lstrip('_')}", key)
                self.functions[key] = translated(self, part, arguments, name, loose)
            finally:
                self._running.pop()
        if not self._running:
            self.asked.append(self.functions[key].name)
        return self.functions[key]

    def named(self, wanted: str, owner: Any) -> str:
        """A name that nothing else has."""
        words = re.sub(r"_+", "_", re.sub(r"\W", "_", wanted)).strip("_")
        parts = words.split("_")
        half = len(parts) // 2
        if len(parts) > 1 and parts[:half] == parts[half:]:
            words = "_".join(parts[:half])  # a module and its function of one name
        name, count = words, 1
        while (name in self._names and self._names[name] != owner) or name in KEYWORDS:
            count += 1
            longer = (
                f"{owner[1]}_{words}".upper()
                if isinstance(owner, tuple) and owner[0] in ("constant", "table") and count == 2
                else ""
            )
            name = longer or f"{words}_{count}"
        self._names[name] = owner
        return name

    def struct(self, cls: Any) -> str:
        """The type of a NamedTuple."""
        if cls not in self.structs:
            for kind in fields_of(cls).values():
                if isinstance(kind, Struct):
                    self.struct(kind.cls)
            module = cls.__module__.rpartition(".")[2].lstrip("_")
            camel = "".join(word.capitalize() for word in module.split("_")) + cls.__name__.lstrip("_")
            self.structs[cls] = self.named(camel, cls)
        return self.structs[cls]

    def word(self, kind: Kind) -> str:
        """The C type of a kind that is a variable by itself."""
        if isinstance(kind, Struct):
            return self.struct(kind.cls)
        return {REAL: self.real, INT: "int", BOOL: "bool", BITS: "uint64_t"}[kind]

    def helper(self, name: str) -> str:
        """One of :data:`HELPERS`."""
        self.helpers[name] = None
        return name

    def constant(self, name: str, value: Any, module: str, meaning: str = "") -> Value:
        """A number that a module has by a name."""
        word = self.named(name.upper(), ("constant", module, name))
        self.constants[word] = (value, meaning)
        known = literal(value, self.single)
        return Value(known.kind, word, known=known.known)

    def table(self, name: str, value: np.ndarray, module: str, meaning: str = "") -> Value:
        """An array of numbers that a module has by a name."""
        array = np.asarray(value, float)
        word = self.named(name.upper(), ("table", module, name))
        self.tables[word] = (array, meaning)
        if array.ndim == 1:
            return Value(Row("row", len(array), True), word)
        if array.ndim == 2:
            return Value(Grid("grid", *array.shape), word)
        raise InvalidInput(f"{module}.{name}: a table of {array.ndim} dimensions; at most 2")

    def result(self, name: str, members: list[tuple[str, str]]) -> str:
        """The struct in which a function gives several things."""
        word = "".join(part.capitalize() for part in name.split("_")) + "Result"
        self.results[word] = members
        return word

    def field_function(self, cls: Any) -> str:
        """A function that gives a field of a struct of reals by its place."""
        name = self.named(f"{self.struct(cls)}_field", ("field", cls))
        self.fielded[name] = cls
        return name

    # -------------------------------------------------------------------------------------------------------- in C

    def declarations(self) -> str:
        """Structs."""
        return "\n\n".join(self._struct(cls, name) for cls, name in self.structs.items())

    def definitions(self) -> str:
        """Constants, tables, and functions."""
        out = []
        if self.constants:
            lines = []
            for word, (value, meaning) in self.constants.items():
                text = literal(value, self.single).code
                kind = (
                    f"enum {{ {word} = {text} }};" if _is_whole(value) else f"static const {self.real} {word} = {text};"
                )
                kind = f"static const uint64_t {word} = {text};" if text.startswith("UINT64") else kind
                lines += [*_comment(meaning), kind]
            out.append("\n".join(lines))
        out += [self._table(word, array, meaning) for word, (array, meaning) in self.tables.items()]
        if {"bits_of", "number_of"} & set(self.helpers):
            out.append("typedef union {\n    double number;\n    uint64_t bits;\n} pun;")
        for name in self.helpers:
            given, gives, code, meaning = (text.format(real=self.real, f="f" * self.single) for text in HELPERS[name])
            *before, last = code.split("; ")
            body = [f"    {line};" for line in (*before, last if before else f"return {last}")]
            out.append("\n".join([*_comment(meaning), f"static {gives} {name}({given})", "{", *body, "}"]))
        out += [self._field_function(name, cls) for name, cls in self.fielded.items()]
        for word, members in self.results.items():
            inner = "\n".join(f"    {kind} {name};" for kind, name in members)
            out.append(f"typedef struct {{\n{inner}\n}} {word};")
        return "\n\n".join([*out, *self._called()])

    def _called(self) -> list[str]:
        """The text of those functions that are asked for from outside, and of what they call."""
        of = {function.name: function.text for function in self.functions.values()}
        needed, left = set[str](), list(self.asked)
        while left:
            name = left.pop()
            if name in of and name not in needed:
                needed.add(name)
                left += re.findall(r"\w+(?=\()", of[name])
        return [text for name, text in of.items() if name in needed]

    def _struct(self, cls: Any, name: str) -> str:
        about, units = quantities(cls), field_notes(cls)
        lines = [*_comment(_first_line(cls)), "typedef struct {"]
        for field, kind in fields_of(cls).items():
            note = units.get(field, "")
            if field in about:
                q = about[field]
                note = q.doc + (f", {q.unit}" if q.unit not in ("", "1") else "")
            lines.append(f"    {self.word(kind)} {safe(field)};" + (f" /* {note} */" if note else ""))
        if not fields_of(cls):
            lines.append("    char nothing; /* C has no struct without a member */")
        return "\n".join([*lines, f"}} {name};"])

    def _table(self, word: str, array: np.ndarray, meaning: str) -> str:
        def row(values: Any) -> str:
            text = ", ".join(literal(float(v), self.single).code for v in values)
            return "\n".join(textwrap.wrap(text, WIDTH - 8, break_long_words=False, break_on_hyphens=False))

        head = f"static const {self.real} {word}" + "".join(f"[{size}]" for size in array.shape)
        if array.ndim == 1:
            body = textwrap.indent(row(array), "    ")
        else:
            body = ",\n".join("    {" + row(values).replace("\n", "\n     ") + "}" for values in array)
        return "\n".join([*_comment(meaning), f"{head} = {{", body, "};"])

    def _field_function(self, name: str, cls: Any) -> str:
        fields = list(fields_of(cls))
        lines = [f"static {self.real} {name}(const {self.struct(cls)} *it, int place)", "{", "    switch (place) {"]
        lines += [f"    case {i}:\n        return it->{safe(field)};" for i, field in enumerate(fields[:-1])]
        return "\n".join([*lines, f"    default:\n        return it->{safe(fields[-1])};", "    }", "}"])


def _is_whole(value: Any) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool | np.bool_)


def _module(part: Any) -> str:
    return str(part.__module__).rpartition(".")[2].lstrip("_")


def _where(part: Any) -> str:
    return f"{inspect.getsourcefile(part)}, line {part.__code__.co_firstlineno}"


def _first_line(thing: Any) -> str:
    text = (thing.__doc__ or "").strip().split("\n")[0]
    return "" if text.startswith(f"{thing.__name__}(") else plain(text)


def _comment(text: str) -> list[str]:
    if not text:
        return []
    lines = textwrap.wrap(plain(text), WIDTH - 3)
    if len(lines) == 1:
        return [f"/* {lines[0]} */"]
    return [f"/* {lines[0]}", *(f" * {line}" for line in lines[1:-1]), f" * {lines[-1]} */"]


def field_notes(cls: Any) -> dict[str, str]:
    """The comments behind the fields of a NamedTuple, which say units."""
    try:
        source = inspect.getsource(cls)
    except (OSError, TypeError):  # joined of two
        notes: dict[str, str] = {}
        for part in getattr(cls, "joined", ()):
            notes |= field_notes(part)
        return notes
    found = re.findall(r"^    (\w+): .*?  # (.*)$", source, re.MULTILINE)
    return {name: plain(note) for name, note in found}
