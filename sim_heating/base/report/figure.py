"""Common style of all figures: size, resolution, grid, legends, colours of frequent curves.

A name is text in every figure: `$` and `\\` have no meaning. A figure that cannot be drawn is replaced by one that says
why, and a warning names it; results in numbers are not affected.
"""

from __future__ import annotations

import io
import textwrap
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogFormatter, NullFormatter, ScalarFormatter
from matplotlib.transforms import Bbox, TransformedBbox
from numpy.typing import ArrayLike

from sim_heating.base.errors import InputError, LeftOutWarning, RunError, printable, reason_of
from sim_heating.base.files.paths import display_path
from sim_heating.base.files.text import result_path, write_bytes_atomic

F = TypeVar("F", bound=Callable[..., object])
DPI = 110
ANGLES = {
    "alpha_deg": ("angle of attack", "tab:blue"),
    "elevon_deg": ("elevon", "tab:green"),
    "bodyflap_deg": ("body flap", "tab:purple"),
    "beta_deg": ("sideslip", "tab:orange"),
}
MANOEUVRE_NAMES = {
    "popu": "pushover-pullup",
    "elevon-pulse": "elevon pulses",
    "elevon-sweep": "elevon sweep",
    "bodyflap-pulse": "body-flap pulses",
    "bodyflap-sweep": "flap manoeuvre",
    "sideslip-doublet": "sideslip doublet",
    "jet-firing": "jet firing",
}
MEASURED: dict[str, Any] = {"color": "0.35", "marker": "o", "markersize": 2.2, "linestyle": "none"}
SURFACE: dict[str, Any] = {"color": "tab:red", "label": "surface, predicted"}
THERMOCOUPLE: dict[str, Any] = {
    "color": "0.15",
    "marker": "o",
    "markersize": 3.0,
    "linewidth": 0.8,
    "label": "outermost thermocouple, predicted",
}


def new_figure(width: float, height: float, rows: int, columns: int = 1, **keys: Any) -> tuple[Figure, np.ndarray]:
    """A figure of this size in inches and its axes, at least one."""
    figure = Figure(
        figsize=(width, height), dpi=DPI, layout="constrained"
    )  # the layout measures text at this resolution
    FigureCanvasAgg(figure)
    return figure, np.atleast_1d(figure.subplots(rows, columns, **keys))


def save_figure(figure: Figure, path: Path | None, title: str, axes: np.ndarray) -> Figure:
    """Add grid and title, lay out, and write the file; without a path the figure is only returned."""
    add_grid_and_title(figure, title, axes)
    lay_out(figure)
    if path is not None:
        write_bytes_atomic(path, picture_file(figure, "png", dpi=DPI))
    return figure


def picture_file(figure: Figure, kind: str, **settings: Any) -> bytes:
    """The file of a figure, `png` or `svg`; settings as matplotlib's `savefig` takes them."""
    buffer = io.BytesIO()
    lay_out(figure)
    with _boxes_for_missing_characters():
        figure.savefig(buffer, format=kind, **settings)
    return buffer.getvalue()


def lay_out(figure: Figure) -> None:
    """Run the layout engine once and remove it: saving would run it twice, the first time in a trial drawing."""
    engine = figure.get_layout_engine()
    if engine is not None:
        with _boxes_for_missing_characters():
            engine.execute(figure)
        figure.set_layout_engine(None)


@contextmanager
def _boxes_for_missing_characters() -> Iterator[None]:
    """No warning about a character that the font lacks: the box in its place says so."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        yield


def add_grid_and_title(figure: Figure, title: str, axes: np.ndarray) -> None:
    """Grid of all axes, the title wrapped to the width of the figure, and all names as they are written."""
    for a in axes.ravel():
        a.grid(alpha=0.3)
        a.set_axisbelow(True)
    width = int(figure.get_figwidth() * 9.0)
    if title:
        figure.suptitle("\n".join(textwrap.fill(line, width) for line in title.splitlines()), fontsize=12)
    _show_names_as_written(figure)


def _show_names_as_written(figure: Figure) -> None:
    """Show texts without mathematics, except those of ticks with numbers, and control characters as escapes."""
    for text in _texts(figure):
        text.set_parse_math(False)
        text.set_usetex(False)
        text.set_text(printable(text.get_text()))


def _texts(artist: Artist) -> Iterator[Text]:
    """All texts of an artist except labels of ticks that are numbers: these would first have to be placed."""
    if isinstance(artist, Text):
        yield artist
    if not isinstance(artist, Axis):
        children = artist.get_children()
    elif _names_its_ticks(artist):
        children = [artist.label, artist.offsetText, *artist.get_ticklabels()]
    else:
        children = [artist.label, artist.offsetText]
    for child in children:
        yield from _texts(child)


def _names_its_ticks(axis: Axis) -> bool:
    """Whether ticks have names of their own; a function that writes them in each drawing is made to escape them."""
    formatter = axis.get_major_formatter()
    if isinstance(formatter, FuncFormatter):
        formatter.func = _printable_label(formatter.func)
    return not isinstance(formatter, (ScalarFormatter, LogFormatter, NullFormatter))


def _printable_label(label: Callable[..., str]) -> Callable[..., str]:
    return lambda *arguments: printable(label(*arguments))


class PictureWarning(LeftOutWarning):
    """A picture that could not be drawn; the results in numbers are complete."""


def replaced_if_undrawable(draw: F) -> F:
    """Decorate a function that draws a file: where it fails, the file says why, and a PictureWarning is given.

    draw : its first argument is the path of the file; where that is None, errors are raised
    """

    @wraps(draw)
    def drawn(path: Path | None, *args: Any, **kwargs: Any) -> Any:
        try:
            return draw(path, *args, **kwargs)
        except (InputError, RunError):  # the file cannot be written
            raise
        except Exception as error:  # whatever a library finds in names or numbers
            if path is None:
                raise
            figure = explanation(display_path(result_path(path)), error)
            write_bytes_atomic(path, picture_file(figure, "png", dpi=DPI))
            return figure

    return cast(F, drawn)


def explanation(name: str, error: Exception) -> Figure:
    """A figure in place of one that could not be drawn, which is named and reported by a PictureWarning."""
    reason = reason_of(error)
    warnings.warn(
        f"{name}: this picture could not be drawn ({reason}); the numbers are complete", PictureWarning, stacklevel=3
    )
    figure, axes = new_figure(9.0, 3.0, 1)
    axes[0].set_axis_off()
    axes[0].text(0.0, 0.5, textwrap.fill(f"This picture could not be drawn: {reason}", 90), va="center")
    add_grid_and_title(figure, "", np.array([]))
    return figure


def mark_beyond(axes: Axes, x: ArrayLike, y: ArrayLike, color: str) -> None:
    """Mark points above and below the axes, whose limits are final, by triangles at the edge."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    low, high = sorted(axes.get_ylim())
    for edge, marker, beyond in ((high, "^", y > high), (low, "v", y < low)):
        if np.any(beyond):
            at = np.full(np.count_nonzero(beyond), edge)
            (marks,) = axes.plot(x[beyond], at, marker, color=color, markersize=5, zorder=5)
            # whole at the upper and lower edge, and none beside the axes where these are narrower than the points
            marks.set_clip_box(TransformedBbox(Bbox([[0.0, -0.1], [1.0, 1.1]]), axes.transAxes))
    axes.set_ylim(low, high)


def legend_label(name: str) -> str:
    """A name as the label of a curve; matplotlib leaves labels that begin with an underscore out of a legend."""
    return f" {name}" if name.startswith("_") else name


def legend_above(axes: Axes, handles: Sequence[Artist] | None = None) -> None:
    """A legend in rows above the axes, where it covers no curve; of the axes' own labels, or of others."""
    shown = {} if handles is None else {"handles": handles}
    axes.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, fontsize=8, frameon=False, borderaxespad=0.1, **shown
    )
