"""Colours by one spelling, ``#rrggbb``, whether a file numbers them (DXF), names them or mixes them (SVG)."""

from functools import cache

INDEXED = ("red", "yellow", "green", "cyan", "blue", "magenta", "white")
"""Names that CAD gives to its colours 1 to 7; the last is black on white paper."""

NONE = "none"
"""The colour of what has no stroke."""


@cache
def of_index(index: int) -> str:
    """The colour with an AutoCAD Color Index, 1 to 255."""
    from ezdxf.colors import aci2rgb

    return of_rgb(*aci2rgb(index)) if 1 <= index <= 255 else of_rgb(*aci2rgb(7))


def of_rgb(red: int, green: int, blue: int) -> str:
    """From channels of 0 to 255."""
    return f"#{red:02x}{green:02x}{blue:02x}"


@cache
def of_css(text: str) -> str | None:
    """From CSS: a name, ``#rgb``, ``rgb(…)``; :data:`NONE` for none and transparent, None for anything else."""
    from tinycss2.color3 import parse_color

    if text.strip().lower() in ("", "none", "transparent"):
        return NONE
    found = parse_color(text)
    if found is None or found == "currentColor":
        return None
    return of_rgb(*(round(255 * min(max(c, 0.0), 1.0)) for c in found[:3])) if found.alpha > 0.0 else NONE


def in_dxf(name: str) -> str:
    """A colour that a user names for a DXF: 1 to 255, CAD's name of one of the first seven, or CSS.

    Raises:
        ValueError: none of these.
    """
    if name.isdigit():
        if not 1 <= int(name) <= 255:
            raise ValueError("not a colour; allowed: 1 to 255, a name such as red, or #rrggbb")
        return of_index(int(name))
    if name.lower() in ("black", *INDEXED):
        return of_index(7 if name.lower() == "black" else INDEXED.index(name.lower()) + 1)
    return in_svg(name)


def in_svg(name: str) -> str:
    """A colour that a user names for an SVG: CSS.

    Raises:
        ValueError: no colour of CSS.
    """
    found = of_css(name)
    if found is None:
        raise ValueError("not a colour; allowed: a name such as red, #rrggbb, or none for what has no stroke")
    return found
