"""What a user may choose about a drawing: above all what becomes of each layer and each colour.

A user writes rules such as ``OUTLINE,HOLES`` (the same as ``cut=OUTLINE,HOLES``), ``engrave=TEXT*`` or ``ignore=DIM*``.
Rules that cut leave everything out that they do not name; rules that engrave or ignore leave all others as they are.
Where rules disagree, ignoring goes before engraving and engraving before cutting.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

from ..plant.quantity import InvalidInput, did_you_mean
from .joining import GAP

ROLES = ("cut", "engrave", "ignore")

SHOWN = 40
"""Names that a message lists."""

Rules = Sequence[str] | str | None
"""As a user gives them: one rule, several, or none."""


@dataclass(frozen=True, kw_only=True)
class Reading:
    """How a file is read.

    ``units``: what its numbers are in, one of :data:`.drawing.UNITS`, instead of what it says or is taken to mean;
    ``layers`` and ``colours``: rules on what becomes of which layer, and of which colour (DXF) or stroke (SVG), None:
    all are cut; ``join``: mm, the largest gap between two ends that are joined; ``text``: letters are cut as outlines;
    ``hatches``: so are the filled areas of a DXF.
    """

    units: str | None = None
    layers: Rules = None
    colours: Rules = None
    join: float = GAP
    text: bool = False
    hatches: bool = False


@dataclass
class Choice:
    """The rules for one kind of name (layers or colours), and which names they were asked about.

    Args:
        what: "layer" or "colour", for messages.
        rules: as the module's text says; names may hold the wildcards ``*`` and ``?``, in any case.
        spelt: how a name is spelt to be compared; raises ValueError for what cannot be one.
    """

    what: str
    rules: Rules
    spelt: Callable[[str], str] = str.casefold
    patterns: dict[str, dict[str, str]] = field(init=False)  # for each role: how a name is compared, how it was given
    seen: dict[str, str] = field(init=False, default_factory=dict)  # names and their roles

    def __post_init__(self) -> None:
        given = [self.rules] if isinstance(self.rules, str) else list(self.rules or [])
        if self.rules is not None and not isinstance(self.rules, str) and not given:
            raise InvalidInput(f"{self.what}s is empty; name at least one, or leave it out")
        self.patterns = {role: {} for role in ROLES}
        for rule in given:
            head, equals, names = rule.partition("=")
            role, names = (head.strip().lower(), names) if equals else ("cut", rule)
            if role not in ROLES:
                raise InvalidInput(f"{self.what}s: '{rule}' begins with no known role; {did_you_mean(role, ROLES)}")
            self.patterns[role] |= self._split(names)

    def _split(self, names: str) -> dict[str, str]:
        """The names of a rule: as they are compared, and as they were given."""
        found = {}
        for name in filter(None, (part.strip() for part in names.split(","))):
            try:
                found[name.casefold() if set(name) & set("*?") else self.spelt(name)] = name
            except ValueError as error:
                raise InvalidInput(f"{self.what}s: '{name}': {error}") from None
        if not found:
            raise InvalidInput(f"{self.what}s: a rule names no {self.what}; name at least one")
        return found

    def role(self, name: str) -> str:
        """One of :data:`ROLES`."""
        if name not in self.seen:
            fitting = (role for role in ("ignore", "engrave", "cut") if self._among(name, self.patterns[role]))
            self.seen[name] = next(fitting, "ignore" if self.patterns["cut"] else "cut")
        return self.seen[name]

    def named(self, name: str) -> bool:
        """Whether the user asked for exactly this name to be cut or engraved, without a wildcard."""
        return name.casefold() in {*self.patterns["cut"], *self.patterns["engrave"]}

    def check(self, where: object, known: Iterable[str]) -> None:
        """Whether every rule speaks of something that is there.

        Args:
            where: the file, for the message.
            known: names that are in it.

        Raises:
            InvalidInput: one does not; the nearest is offered, and what there is.
        """
        there = list(dict.fromkeys(known))
        for patterns in self.patterns.values():
            for pattern, given in patterns.items():
                if not any(self._among(name, [pattern]) for name in there):
                    known_ = did_you_mean(given, there) if len(there) <= SHOWN else _shortened(given, there)
                    raise InvalidInput(f"{where}: no {self.what} '{given}'; {known_ if there else 'it has none'}")

    def _among(self, name: str, patterns: Iterable[str]) -> bool:
        low = name.casefold()
        return any(low == p or fnmatchcase(low, p) for p in patterns)


def _shortened(pattern: str, there: list[str]) -> str:
    hint, _, _ = did_you_mean(pattern, there).partition("(known:")
    return f"{hint}(known: {', '.join(there[:SHOWN])} and {len(there) - SHOWN} more)"


def merged(layer: str, colour: str) -> str:
    """The role of something whose layer has one and whose colour has one."""
    return next(role for role in ("ignore", "engrave", "cut") if role in (layer, colour))
