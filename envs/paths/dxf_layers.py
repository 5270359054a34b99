"""DXF: what layers and line types say about an entity: whether it is shown, whether it is plotted, its colour.

An entity may take its colour and line type from its layer, and in a block from the place where the block stands; what
lies on layer 0 of a block lies on the layer of that place.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any

from . import colours

BYBLOCK, BYLAYER, WHITE = 0, 256, 7

BROKEN = ("CENTER", "DASH", "HIDDEN", "PHANTOM", "DOT", "DIVIDE", "BORDER", "ACAD_ISO", "JIS_")
"""How the names of line types begin that are not drawn through, for files whose table does not define them."""

UNPLOTTED = "defpoints"
"""The layer that CAD keeps for the definition points of dimensions; it is never plotted."""


@dataclass(frozen=True)
class Look:
    """How something is drawn: its layer, its colour (``#rrggbb``), the name of its line type in capitals."""

    layer: str = "0"
    colour: str = "#ffffff"
    linetype: str = "CONTINUOUS"


def attribute(entity: Any, name: str, default: Any) -> Any:
    """An attribute of any entity, also of those that the DXF reader keeps without taking them apart."""
    try:
        if untaken(entity):
            return entity.graphic_properties().get(name, default)
        return entity.dxf.get(name, default)
    except Exception:  # an attribute that this kind of entity cannot have, or a damaged one
        return default


def untaken(entity: Any) -> bool:
    """Whether the DXF reader keeps an entity without taking it apart, as it does with kinds that it does not know."""
    return hasattr(entity, "xtags")


class Layers:
    """The layers and line types of a document."""

    def __init__(self, document: Any) -> None:
        self.document = document
        self.table: dict[str, Any] = {layer.dxf.name.casefold(): layer for layer in document.layers}
        self._frozen = {name for name, layer in self.table.items() if layer.is_frozen()}
        self._hidden = self._frozen | {name for name, layer in self.table.items() if layer.is_off()}
        self._unplotted = {name for name, layer in self.table.items() if not attribute(layer, "plot", 1)} | {UNPLOTTED}
        self._of = cache(self._of_table)  # thousands of entities ask for few layers
        self.broken = {ltype.dxf.name.upper(): _is_broken(ltype) for ltype in document.linetypes}

    def names(self, entities: Iterable[Any]) -> list[str]:
        """Names of the layers that are declared, and those that ``entities`` use."""
        used = (str(attribute(entity, "layer", "0")) for entity in entities)
        return list({n.casefold(): n for n in (*used, *(each.dxf.name for each in self.table.values()))}.values())

    def look(self, entity: Any, around: Look) -> Look:
        """How an entity is drawn within a block that stands somewhere looking like ``around``."""
        layer = str(attribute(entity, "layer", "0"))
        if layer == "0":
            layer = around.layer
        own = self._of(layer)
        linetype = str(attribute(entity, "linetype", "BYLAYER")).upper()
        if linetype == "BYBLOCK":
            linetype = around.linetype
        elif linetype == "BYLAYER":
            linetype = own[0]
        return Look(layer, self._colour(entity, own, around), linetype)

    def _of_table(self, layer: str) -> tuple[str, int, int | None]:
        """Line type, colour's index and exact colour of a layer."""
        own = self.table.get(layer.casefold())
        if own is None:
            return "CONTINUOUS", WHITE, None
        linetype = str(attribute(own, "linetype", "CONTINUOUS")).upper()
        return linetype, abs(own.dxf.color), attribute(own, "true_color", None)

    def _colour(self, entity: Any, layer: tuple[str, int, int | None], around: Look) -> str:
        index, exact = attribute(entity, "color", BYLAYER), attribute(entity, "true_color", None)
        if exact is None and index == BYLAYER:
            _, index, exact = layer
        if exact is not None:
            return colours.of_rgb(*exact.to_bytes(4, "big")[1:])
        return around.colour if index == BYBLOCK else colours.of_index(abs(index))

    def hidden(self, layer: str) -> bool:
        """Whether the layer is off or frozen."""
        return layer.casefold() in self._hidden

    def frozen(self, layer: str) -> bool:
        """Whether the layer is frozen: a block that stands on it is hidden with all that it has on other layers."""
        return layer.casefold() in self._frozen

    def unplotted(self, layer: str) -> bool:
        """Whether the layer is never plotted."""
        return layer.casefold() in self._unplotted

    def dashed(self, linetype: str) -> bool:
        """Whether a line type has gaps."""
        return self.broken.get(linetype, linetype.startswith(BROKEN))


def _is_broken(ltype: Any) -> bool:
    """Whether a line type of the table has gaps (negative lengths) or dots (lengths of 0)."""
    try:
        return any(tag.code == 49 and tag.value <= 0.0 for tag in ltype.pattern_tags.tags)
    except Exception:  # a damaged table entry
        return str(ltype.dxf.name).upper().startswith(BROKEN)
