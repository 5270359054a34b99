"""The letters of pictures: DejaVu Sans, which comes with Matplotlib and, unlike Pillow's own font, has µ, × and −."""

from importlib.util import find_spec
from pathlib import Path
from typing import Any

_NARROWER = 0.92
"""Of the size asked for: its letters are wider than most fonts'."""


def font(size: float) -> Any:
    """The font in a size, px; Pillow is imported here, Matplotlib is not."""
    from PIL import ImageFont

    package = Path(str(find_spec("matplotlib").origin)).parent  # type: ignore[union-attr]
    return ImageFont.truetype(package / "mpl-data" / "fonts" / "ttf" / "DejaVuSans.ttf", _NARROWER * size)
