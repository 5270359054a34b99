"""Figures as PNG files."""

import io

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image


def png(figure: Figure, few_colours: bool = True) -> bytes:
    """The figure as PNG; with a palette of 256 colours, which lines do with, it is a third as large."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    if few_colours:
        image = image.quantize(256, method=Image.Quantize.FASTOCTREE)
        image.putpalette([255 if value == 254 else value for value in image.getpalette() or []])  # white stays white
    buffer = io.BytesIO()
    image.save(buffer, "PNG", dpi=(figure.dpi, figure.dpi))
    return buffer.getvalue()
