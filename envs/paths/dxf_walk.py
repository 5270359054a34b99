"""DXF: every entity that the model space shows, also in blocks, as curves on the sheet."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

from ..engine.quantity import InvalidInput
from .choice import Choice, Reading, merged
from .clip import Clip
from .collected import Collected
from .curve import Curve
from .dxf_curves import CUT, Frame, curve_of
from .dxf_fills import FILLS, TEXTS, filled, written
from .dxf_layers import Layers, Look, attribute, untaken

NESTING = 16
"""Blocks within blocks; more means that a block contains itself."""

XREF = 4
"""Flag of a block that stands for another drawing."""


@dataclass(frozen=True)
class Place:
    """Where a block stands: its axes, how what is in it looks, and what it is clipped to."""

    frame: Frame
    look: Look = field(default_factory=Look)
    clips: tuple[Clip, ...] = ()


class Walk:
    """The way through a document; what is found goes into ``found``."""

    def __init__(self, document: Any, found: Collected, layers: Choice, colours: Choice, asked: Reading) -> None:
        self.document, self.found = document, found
        self.layer_choice, self.colour_choice = layers, colours
        self.text, self.hatches = asked.text, asked.hatches
        self.layers = Layers(document)
        self.dashed: list[tuple[Callable[[], None], str]] = []

    def measure(self, entities: Iterable[Any]) -> None:
        """Counts what the blocks among ``entities`` come to without looking at it, so that a bomb costs no time.

        Raises:
            InvalidInput: blocks nested too deep, or more than a drawing may have.
        """
        self.found.room_for(self._count(entities, {}, 0))

    def _count(self, entities: Iterable[Any], known: dict[str, int], depth: int) -> int:
        if depth > NESTING:
            raise InvalidInput(
                f"{self.found.where}: blocks are nested more than {NESTING} deep; does one contain itself?"
            )
        count = 0
        for entity in entities:
            count += 1
            if entity.dxftype() == "INSERT" and (block := _block(entity)) is not None:
                name = str(entity.dxf.name).casefold()
                if name not in known:
                    known[name] = self._count(block, known, depth + 1)
                rows, columns = (max(int(entity.dxf.get(n, 1)), 1) for n in ("row_count", "column_count"))
                count += rows * columns * max(known[name], 1)
        return count

    def space(self, entities: Iterable[Any], place: Place) -> None:
        """Looks at all ``entities`` of a space.

        Raises:
            InvalidInput: more than a drawing may have.
        """
        for entity in entities:
            self.found.entity()
            self._entity(entity, place)

    def finish(self) -> None:
        """Leaves out what is dashed; cuts it where there is nothing else."""
        if self.dashed and not self.found.curves:
            self.found.warn("all lines are dashed, so they are cut; a drawing with solid ones leaves dashed ones out")
            for take, _ in self.dashed:
                take()
            return
        for _, what in self.dashed:
            self.found.skipped[what] += 1

    def _entity(self, entity: Any, place: Place) -> None:
        kind, look = entity.dxftype(), self.layers.look(entity, place.look)
        skipped, named = self.found.skipped, self.layer_choice.named(look.layer)
        hidden = self.layers.frozen if kind == "INSERT" else self.layers.hidden
        if hidden(look.layer) and not named:
            skipped[f"{kind} on hidden layer '{look.layer}'"] += 1
        elif attribute(entity, "invisible", 0):
            skipped[f"invisible {kind}"] += 1
        elif kind == "INSERT":
            self._insert(entity, replace(place, look=look))
        elif self.layers.unplotted(look.layer) and not named:
            skipped[f"{kind} on layer '{look.layer}', which is not plotted"] += 1
        elif (role := merged(self.layer_choice.role(look.layer), self.colour_choice.role(look.colour))) == "ignore":
            skipped[f"{kind} {self._why(look)}"] += 1
        elif kind == "MLINE":
            self._exploded(entity, replace(place, look=look))
        elif kind not in CUT and not (self.text and kind in TEXTS) and not (self.hatches and kind in FILLS):
            skipped[f"{kind} (unknown)" if untaken(entity) else kind] += 1
        elif kind == "POLYLINE" and (entity.is_polygon_mesh or entity.is_poly_face_mesh):
            skipped["POLYLINE (mesh)"] += 1
        elif self.layers.dashed(look.linetype) and kind in CUT and not named:
            what = f"{kind} with line type {look.linetype}"
            self.dashed.append((lambda: self._take(entity, place, look, role), what))
        else:
            self._take(entity, place, look, role)

    def _why(self, look: Look) -> str:
        by_layer = self.layer_choice.role(look.layer) == "ignore"
        return f"on layer '{look.layer}'" if by_layer else f"of colour {look.colour}"

    # What is there

    def _take(self, entity: Any, place: Place, look: Look, role: str) -> None:
        with self._readable(entity):
            for curve in self._curves(entity, entity.dxftype(), place.frame):
                self._clipped(entity, curve, place.clips, look.layer, role)

    def _curves(self, entity: Any, kind: str, frame: Frame) -> list[Curve]:
        if kind in TEXTS:
            return written(entity, self.document, frame, self.found)
        if kind in FILLS:
            return filled(entity, frame)
        return [curve_of(entity, frame)]

    def _clipped(self, entity: Any, curve: Curve, clips: tuple[Clip, ...], layer: str, role: str) -> None:
        kind, handle = entity.dxftype(), entity.dxf.handle
        which, pieces = f"#{handle}" if handle else "", [curve]
        for clip in clips:
            pieces = [part for piece in pieces for part in clip.inside(piece)]
        if not pieces:
            self.found.skipped[f"{kind} outside its block's clipping"] += 1
        for piece in pieces:
            self.found.add(kind, piece, layer, role, which)

    @contextmanager
    def _readable(self, entity: Any) -> Iterator[None]:
        """Leaves an entity out that cannot be read."""
        try:
            yield
        except InvalidInput:
            raise
        except Exception as error:  # a damaged entity raises whatever the damage leads to
            self.found.skipped[f"{entity.dxftype()} that cannot be read"] += 1
            problem = " ".join(str(error).split()) or type(error).__name__
            self.found.warn("entities that cannot be read are left out", f"{entity}: {problem}")

    def _exploded(self, entity: Any, place: Place) -> None:
        """What an entity that CAD draws in lines of its own consists of."""
        parts: list[Any] = []
        with self._readable(entity):
            parts = list(entity.virtual_entities())
        self.space(parts, place)

    # Blocks

    def _insert(self, insert: Any, place: Place) -> None:
        """What an inserted block consists of, in each place of its grid."""
        name, block = insert.dxf.get("name", ""), _block(insert)
        if block is None:
            self.found.skipped["INSERT of a missing block"] += 1
            self.found.warn("blocks that are not in the file are left out", f"'{name}' ({insert})")
            return
        if block.block.dxf.get("flags", 0) & XREF:
            other = block.block.dxf.get("xref_path", "") or name
            self.found.skipped["INSERT of another drawing"] += 1
            self.found.warn("other drawings (XREF) are not read; bind them to cut them", f"'{other}'")
            return
        within: list[tuple[Any, Place]] = []
        with self._readable(insert):
            frames, clips = self._grid(insert, place.frame), self._clips(insert, name, place)
            within += [(block, replace(place, frame=frame, clips=clips)) for frame in frames]
            within.append((insert.attribs, place))
        for entities, where in within:
            self.space(entities, where)

    def _grid(self, insert: Any, frame: Frame) -> list[Frame]:
        """The axes of the block in each of its places; rows and columns lie apart as they are, whatever the scale."""
        from ezdxf.math import Vec3

        dxf = insert.dxf
        rows, columns = (max(int(dxf.get(n, 1)), 1) for n in ("row_count", "column_count"))
        high, wide = dxf.get("row_spacing", 0.0), dxf.get("column_spacing", 0.0)
        rows, columns = rows if high else 1, columns if wide else 1
        first, own = frame.within(insert.matrix44()), frame.of(insert)
        angle = dxf.get("rotation", 0.0)
        steps = (Vec3(c * wide, r * high).rotate_deg(angle) for r in range(rows) for c in range(columns))
        return [first._replace(origin=first.origin + own.along(step)) for step in steps]

    def _clips(self, insert: Any, name: str, place: Place) -> tuple[Clip, ...]:
        from ezdxf.xclip import XClip

        clip = XClip(insert)
        if not (clip.has_clipping_path and clip.is_clipping_enabled):
            return place.clips
        path = clip.get_wcs_clipping_path()
        self.found.warn("of clipped blocks (XCLIP) only what shows is cut", f"'{name}'")
        corners = [place.frame.x * v.x + place.frame.y * v.y + place.frame.origin for v in path.inner_polygon()]
        return (*place.clips, Clip.of(corners, path.is_inverted_clip))


def _block(insert: Any) -> Any:
    """The block that stands there; None if the file has none, or one so damaged that the reader has dropped it."""
    block = insert.block() if isinstance(insert.dxf.get("name"), str) else None
    return block if block is not None and block.block.is_alive else None
