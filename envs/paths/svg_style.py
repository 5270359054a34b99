"""SVG style sheets: what ``style`` elements say about which elements.

Rules are read by tinycss2. Of selectors those of one element are understood: ``*``, a name, ``.class``, ``#id`` and
what they make together, such as ``path.fold``; rules that depend on where an element stands are named and left out.
"""

import re
from collections import defaultdict
from dataclasses import dataclass, replace
from itertools import count

from ..engine.quantity import in_order
from .svg_tree import Node

SELECTOR = re.compile(r"(\*|[a-zA-Z][\w-]*)?((?:[.#][\w-]+)*)")

LONGEST = 500_000
"""Characters of a style sheet; what is longer takes too long to read."""

SHOWN = in_order(
    "display visibility stroke transform clip-path mask stroke-dasharray font-size font-family text-anchor fill"
)
"""Properties that matter here."""


@dataclass(frozen=True)
class Rule:
    """Properties of the elements that a selector fits; of two rules the greater ``weight`` wins, then the later."""

    tag: str
    classes: frozenset[str]
    id: str
    properties: dict[str, str]
    weight: tuple[int, int, int]

    @property
    def key(self) -> str:
        """Something that an element must have for the rule to fit it."""
        return f"#{self.id}" if self.id else f".{min(self.classes)}" if self.classes else self.tag or "*"

    def fits(self, node: Node, classes: set[str]) -> bool:
        """Whether the rule speaks of the element."""
        return (
            self.tag in ("", "*", node.tag)
            and (not self.id or node.attributes.get("id") == self.id)
            and self.classes <= classes
        )


def apply(root: Node) -> list[tuple[Node, str]]:
    """Writes what the style sheets within ``root`` say into the elements; returns selectors not understood."""
    by_key: dict[str, list[tuple[int, Rule]]] = defaultdict(list)
    unknown: list[tuple[Node, str]] = []
    order = count()
    for sheet in root.all():
        if sheet.tag == "style" and len(sheet.text) > LONGEST:
            unknown.append((sheet, f"all of {len(sheet.text)} characters"))
        elif sheet.tag == "style":
            try:
                found, other = _rules(sheet.text)
            except RecursionError:  # brackets within brackets
                found, other = [], [f"all of {len(sheet.text)} characters"]
            unknown += [(sheet, selector) for selector in other]
            for rule in found:
                by_key[rule.key].append((next(order), rule))
    if not by_key:
        return unknown
    for rules in by_key.values():
        _merge(rules)
    for node in root.all():
        classes = set(node.attributes.get("class", "").split())
        keys = (f"#{node.attributes.get('id', '')}", *(f".{name}" for name in classes), node.tag, "*")
        fitting = [(r.weight, n, r) for key in keys for n, r in by_key.get(key, ()) if r.fits(node, classes)]
        for _, _, rule in sorted(fitting, key=lambda each: each[:2]):
            node.css.update(rule.properties)
    return unknown


def _merge(rules: list[tuple[int, Rule]]) -> None:
    """Makes one of rules with the same selector that follow one another: thousands of them cost no more than few."""
    merged: list[tuple[int, Rule]] = []
    for order, rule in rules:
        last = merged[-1][1] if merged else None
        if last and (last.tag, last.classes, last.id) == (rule.tag, rule.classes, rule.id):
            last.properties.update(rule.properties)
        else:
            merged.append((order, replace(rule, properties=dict(rule.properties))))
    rules[:] = merged


def _rules(text: str) -> tuple[list[Rule], list[str]]:
    import tinycss2

    found: list[Rule] = []
    other: list[str] = []
    for rule in tinycss2.parse_stylesheet(text, skip_comments=True, skip_whitespace=True):
        if rule.type == "at-rule":
            other.append(f"@{rule.at_keyword}")
        if rule.type != "qualified-rule":
            continue
        said = tinycss2.parse_blocks_contents(rule.content, skip_comments=True, skip_whitespace=True)
        properties = {
            d.lower_name: tinycss2.serialize(d.value).strip()
            for d in said
            if d.type == "declaration" and d.lower_name in SHOWN
        }
        if not properties:
            continue
        for selector in tinycss2.serialize(rule.prelude).split(","):
            match = SELECTOR.fullmatch(selector.strip())
            if not match or not selector.strip():
                other.append(selector.strip())
                continue
            marks = re.findall(r"[.#][\w-]+", match[2])
            classes = frozenset(m[1:] for m in marks if m[0] == ".")
            ids = [m[1:] for m in marks if m[0] == "#"]
            weight = (len(ids), len(classes), int(match[1] not in (None, "*")))
            found.append(Rule(match[1] or "", classes, ids[0] if ids else "", properties, weight))
    return found, other
