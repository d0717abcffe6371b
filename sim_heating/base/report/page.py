"""A self-contained HTML page of sections with text, tables and figures: one look for all reports.

    write_page(path, lambda: Page("Title", "what it is", [Section("Errors", tables=[Table(...)], figures=[...])]))

The file is complete: style, figures and scripts are embedded, nothing is loaded. A part that cannot be
made is replaced by the reason. Every text is escaped, and the page's
own policy forbids addresses elsewhere and all scripts but ours, by their digests: names in it come from input files,
and other people open it. What a text has between backticks, as messages have names and keys, is set as code. A page has
a script only for its charts (`chart.js` and uPlot) and for its sortable tables (`table.js`); without scripts it shows
pictures and all rows.
"""

from __future__ import annotations

import base64
import hashlib
import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any, ClassVar

import jinja2
import matplotlib as mpl
from markupsafe import Markup, escape
from matplotlib.figure import Figure
from PIL import Image

from sim_heating.base.errors import or_left_out, printable, tell_left_out
from sim_heating.base.files import write_text_atomic
from sim_heating.base.files.package import package_version
from sim_heating.base.report.chart import Chart, chart_data, intervals_of, script_json
from sim_heating.base.report.figure import explanation, picture_file
from sim_heating.base.report.table import Table

TEMPLATE = "page.html.j2"
CHART_SCRIPTS, CHART_STYLE = ("vendor/uPlot.iife.min.js", "chart.js"), "vendor/uPlot.min.css"
TABLE_SCRIPTS = ("table.js",)
SHARED_SCRIPTS = ("element.js",)
"""Scripts that those of charts and of tables need before them."""
LOOK = "look.css"
RASTER = re.compile(rb"data:image/png;base64,([A-Za-z0-9+/=\s]+)")
WHOLE = re.compile(r"((?:\+- )?[-+]?\b\d+(?:\.\d+)?e[-+]\d+\b|\+- [\d.]+)")
"""Numbers in a text that would break at the sign of their exponent, or between `+-` and the number."""
LONG_NAME = re.compile(r"[\w.\-/]{16,}")
"""Names that a table may break where one of its parts ends."""
AFTER_A_PART = re.compile(r"(?<=[._/])(?=\w)")
CODE = re.compile(r"`([^`\n]+)`")
"""Names, keys and commands in a text, which messages mark by backticks."""
PALETTE = 200
"""Colours of a picture of pixels on a page."""
LARGEST_SCALE = 1.2
"""Width of a picture of pixels on a page over its own: larger, its letters are coarse, and larger than those around."""
RASTER_DPI = 80
"""Resolution of the rasterized parts of a figure."""


@dataclass(frozen=True)
class Picture:
    """A figure, or a function that draws it, with its caption, which is also its alternative text.

    A figure that cannot be drawn is replaced by one that says why.
    """

    widest_px: ClassVar[int | None] = None
    """Vector graphics look well at any width."""
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
        """The file as a data URL, with a palette of colours: a quarter of its size."""
        buffer = io.BytesIO()
        with Image.open(self.path) as picture:
            _few_colours(picture.convert("RGB")).save(buffer, "PNG")
        return _data_url("image/png", buffer.getvalue())

    @property
    def widest_px(self) -> int:
        """The width beyond which the picture would look coarse on a page."""
        with Image.open(self.path) as picture:
            return round(LARGEST_SCALE * picture.width)


def _svg(figure: Figure) -> bytes:
    with mpl.rc_context({"svg.hashsalt": TEMPLATE}):  # identifiers in the file are the same in each run
        drawing = picture_file(figure, "svg", dpi=RASTER_DPI, metadata={"Date": None})
    return RASTER.sub(lambda match: _with_palette(base64.b64decode(match[1])), drawing)


def _with_palette(raster: bytes) -> bytes:
    """A rasterized part of a figure as a data URL with a palette of colours and transparencies."""
    buffer = io.BytesIO()
    with Image.open(io.BytesIO(raster)) as picture:
        _few_colours(picture.convert("RGBA")).save(buffer, "PNG")
    return _data_url("image/png", buffer.getvalue()).encode()


def _few_colours(picture: Image.Image) -> Image.Image:
    return picture.quantize(PALETTE, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)


def _data_url(media: str, content: bytes) -> str:
    return f"data:{media};base64,{base64.b64encode(content).decode()}"


@dataclass(frozen=True)
class Section:
    """A heading with paragraphs, points, tables, charts and pictures, in this order; several charts side by side."""

    title: str
    text: Sequence[str] = ()
    points: Sequence[str] = ()
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture | SavedPicture] = ()
    charts: Sequence[Chart] = ()


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


def sections_of(makers: Mapping[str, Callable[[], Section | Sequence[Section]]]) -> list[Section]:
    """The sections that functions make, by their titles; one that fails gives a section with the reason.

    makers : by title, in the order of the page; each returns a section, or several, or none
    """
    sections: list[Section] = []
    for title, make in makers.items():
        try:
            section = make()
        except Exception as error:
            reason = tell_left_out(f"report, section `{title}`", error)
            section = Section(title, [f"This section could not be made: {reason}"])
        sections += [section] if isinstance(section, Section) else section
    return sections


def page_html(page: Page) -> str:
    """The page as text; everything in it is escaped."""
    charts = [c for section in page.sections for c in section.charts]
    scripts = _scripts(page, has_charts=bool(charts))
    return _template().render(
        page=page,
        program=f"sim-heating {package_version()}",
        scripts=scripts,
        policy=" ".join(map(_digest, scripts)),
        look=_asset(LOOK),
        style=_asset(CHART_STYLE) if charts else "",
        has_charts=bool(charts),
        drawn=partial(_drawn, intervals=intervals_of(charts)),
    )


def _scripts(page: Page, has_charts: bool) -> list[Markup]:
    """Scripts that a page needs, those of all parts first."""
    names = [*(CHART_SCRIPTS if has_charts else ()), *(TABLE_SCRIPTS if _sortable(page) else ())]
    return [_asset(name) for name in (*(SHARED_SCRIPTS if names else ()), *names)]


def _sortable(page: Page) -> bool:
    return any(table.sortable for section in page.sections for table in section.tables)


def _drawn(chart: Chart, intervals: int) -> dict[str, str]:
    """A chart as the template shows it: its `data`, a `note` on their decimation, and `picture_url` of the picture in
    its place, empty where there is none."""
    without: tuple[dict[str, Any], str] = ({}, "The data of this chart could not be made.")
    data, note = or_left_out(lambda: chart_data(chart, intervals), without, f"report, chart `{chart.title}`")
    picture = chart.picture or Picture(chart.figure, chart.title)
    url = picture.data_url if chart.pictured else ""
    return {"data": Markup(script_json(data)), "note": note, "picture_url": url}


@cache
def _asset(name: str) -> Markup:
    """A script or a style of our own, as it is."""
    return Markup((Path(__file__).parent / name).read_text(encoding="utf-8"))


def _digest(script: str) -> str:
    """The digest of a script as a Content-Security-Policy names it."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"


def write_page(path: Path, make: Callable[[], Page]) -> None:
    """Write the page that `make` returns, whole or not at all; where it cannot be made, one that gives the reason."""
    try:
        page = make()
    except Exception as error:
        page = Page(path.stem, f"This page could not be made: {tell_left_out(path.name, error)}", [])
    write_text_atomic(path, page_html(page))


@cache
def _template() -> jinja2.Template:
    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    environment = jinja2.Environment(
        loader=loader,
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: printable(value) if isinstance(value, str) and not isinstance(value, Markup) else value,
    )
    environment.filters["prose"] = partial(_with_code, shown=escape)
    environment.filters["breakable"] = partial(_with_code, shown=_breakable)
    return environment.get_template(TEMPLATE)


def _with_code(text: str, shown: Callable[[str], Markup]) -> Markup:
    """A text whose names, keys and commands are set as code; `shown` makes Markup of each part of it."""
    parts = CODE.split(printable(text))
    pieces = [Markup("<code>{}</code>").format(shown(p)) if i % 2 else shown(p) for i, p in enumerate(parts)]
    return Markup("").join(pieces)


def _breakable(cell: str) -> Markup:
    """The text of a cell: a long name may break after a dot or underscore, a number and its exponent stay whole."""
    parts = WHOLE.split(cell)
    parts[1::2] = [Markup('<span class="whole">{}</span>').format(number) for number in parts[1::2]]
    parts[::2] = [LONG_NAME.sub(_with_breaks, str(escape(text))) for text in parts[::2]]
    return Markup("".join(parts))


def _with_breaks(name: re.Match[str]) -> str:
    return AFTER_A_PART.sub("<wbr>", name[0])
