"""The frame of every page: one HTML file with its looks and scripts in it, which opens offline."""

from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup
from plotly.offline import get_plotlyjs

HERE = Path(__file__).parent

PAGES = jinja2.Environment(
    loader=jinja2.FileSystemLoader(HERE),
    autoescape=True,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
"""The templates."""


def framed(template: str, scripts: tuple[str, ...] = ("figures.js",), **words: Any) -> str:
    """A page's text.

    Args:
        template: its file; extends ``frame.html``.
        scripts: files of the scripts that draw its figures and sort its tables; without one the page has no library.
        words: of the template.
    """
    return PAGES.get_template(template).render(
        **words,
        css=Markup((HERE / "report.css").read_text(encoding="utf-8")),
        plotly=Markup(_plotly()),
        scripts=Markup("\n".join((HERE / name).read_text(encoding="utf-8") for name in scripts)),
    )


def _plotly() -> str:
    """Plotly's library, once; it may stand between the tags of a script."""
    return get_plotlyjs().replace("</script", "<\\/script")
