"""A self-contained HTML page of sections with text, tables and figures: one look for all reports.

    write_page(path, Page("Title", "what it is", [Section("Errors", tables=[Table(...)], figures=[...])]))

The file is complete: style and figures are embedded, nothing is loaded. Every text is escaped, and the page's own
policy forbids scripts and addresses elsewhere: names in it come from input files, and other people open it.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import jinja2
import matplotlib as mpl
from matplotlib.figure import Figure

from sim_heating.base.errors import printable
from sim_heating.base.files import write_text_atomic
from sim_heating.base.files.package import package_version
from sim_heating.base.report.figure import explanation, picture_file
from sim_heating.base.report.table import Table

TEMPLATE = "page.html.j2"
RASTER_DPI = 130
"""Resolution of the rasterized parts of a figure."""


@dataclass(frozen=True)
class Picture:
    """A figure, or a function that draws it, with its caption, which is also its alternative text.

    A figure that cannot be drawn is replaced by one that says why.
    """

    figure: Figure | Callable[[], Figure]
    caption: str = ""

    @property
    def data_url(self) -> str:
        """The figure as a data URL: vector graphics, except for artists drawn as `rasterized`."""
        try:
            drawing = _svg(self.figure if isinstance(self.figure, Figure) else self.figure())
        except Exception as error:  # whatever a library finds in names or numbers
            drawing = _svg(explanation(f"report, picture `{self.caption}`", error))
        return _data_url("image/svg+xml", drawing)


@dataclass(frozen=True)
class SavedPicture:
    """A PNG file with its caption."""

    path: Path
    caption: str = ""

    @property
    def data_url(self) -> str:
        """The file as a data URL."""
        return _data_url("image/png", self.path.read_bytes())


def _svg(figure: Figure) -> bytes:
    with mpl.rc_context({"svg.hashsalt": TEMPLATE}):  # identifiers in the file are the same in each run
        return picture_file(figure, "svg", dpi=RASTER_DPI, metadata={"Date": None})


def _data_url(media: str, content: bytes) -> str:
    return f"data:{media};base64,{base64.b64encode(content).decode()}"


@dataclass(frozen=True)
class Section:
    """A heading with paragraphs, points, tables and pictures, in this order."""

    title: str
    text: Sequence[str] = ()
    points: Sequence[str] = ()
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture | SavedPicture] = ()


@dataclass(frozen=True)
class Page:
    """A report.

    title, subtitle : its head
    conclusion      : conclusion in a few words, and a line of explanation
    warnings        : lines shown before the first section
    """

    title: str
    subtitle: str
    sections: Sequence[Section]
    conclusion: tuple[str, str] | None = None
    warnings: Sequence[str] = field(default=())


def page_html(page: Page) -> str:
    """The page as text; everything in it is escaped."""
    return _template().render(page=page, program=f"sim-heating {package_version()}")


def write_page(path: Path, page: Page) -> None:
    """Write the page, whole or not at all."""
    write_text_atomic(path, page_html(page))


@cache
def _template() -> jinja2.Template:
    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        finalize=lambda value: printable(value) if isinstance(value, str) else value,
    )  # fmt: skip
    return environment.get_template(TEMPLATE)
