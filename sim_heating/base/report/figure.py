"""Common style of all figures: size, resolution, grid, legends, colours of frequent curves."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

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
    "color": "0.15", "marker": "o", "markersize": 3.0, "linewidth": 0.8, "label": "outermost thermocouple, predicted",
}  # fmt: skip
TITLE_LINES = 4


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
        figure.savefig(path, dpi=DPI)
    return figure


def lay_out(figure: Figure) -> None:
    """Run the layout engine once and remove it: saving would run it twice, the first time in a trial drawing."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine(None)


def add_grid_and_title(figure: Figure, title: str, axes: np.ndarray) -> None:
    """Grid of all axes, and the title wrapped to the width of the figure, as far as it leaves room for the axes."""
    for a in axes.ravel():
        a.grid(alpha=0.3)
        a.set_axisbelow(True)
    width = int(figure.get_figwidth() * 9.0)
    if title:
        lines = [short for line in title.splitlines() for short in textwrap.wrap(line, width)]
        more = ["..."] if len(lines) > TITLE_LINES else []
        figure.suptitle("\n".join(lines[:TITLE_LINES] + more), fontsize=12)


def legend_above(axes: Axes) -> None:
    """A legend in rows above the axes, where it covers no curve."""
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, fontsize=8, frameon=False, borderaxespad=0.1)
