"""What a reader may ask of any figure: what a legend names can be seen, and what leaves the axes is marked."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D


def named_lines(figure: Figure) -> list[tuple[Axes, Line2D]]:
    """Lines that a legend of the figure names, in the coordinates of their axes' data."""
    legends = [legend for legend in figure.findobj(Legend) if isinstance(legend, Legend)]
    named = {text.get_text() for legend in legends for text in legend.get_texts()}
    lines = [(a, line) for a in figure.axes for line in a.get_lines() if line.get_label() in named]
    return [(a, line) for a, line in lines if line.get_transform() == a.transData]


def named_lines_out_of_sight(figure: Figure) -> list[str]:
    """Labels of lines that a legend names, and that leave their axes upwards or downwards, or are not in them at all.

    A line may go on beyond the left and the right.
    """
    found = []
    for a, line in named_lines(figure):
        x, y = (np.asarray(values, dtype=float) for values in line.get_data())
        (left, right), (low, high) = sorted(a.get_xlim()), sorted(a.get_ylim())
        shown = np.isfinite(x) & np.isfinite(y) & (x >= left) & (x <= right)
        slack = 1e-6 * (high - low)
        if not np.any(shown) or np.any((y[shown] < low - slack) | (y[shown] > high + slack)):
            found.append(str(line.get_label()))
    return found


def unmarked_points(figure: Figure) -> list[str]:
    """Points of any line above or below its axes that no triangle at the edge marks."""
    found = []
    for a in figure.axes:
        low, high = sorted(a.get_ylim())
        marked = {
            (line.get_marker(), float(x))
            for line in a.get_lines()
            if line.get_marker() in "^v"
            for x in line.get_xdata()
        }
        for line in a.get_lines():
            if line.get_marker() in ("None", "", "^", "v") or line.get_transform() != a.transData:
                continue
            for x, y in zip(*line.get_data(), strict=True):
                edge = "^" if y > high else "v" if y < low else ""
                if edge and (edge, float(x)) not in marked:
                    found.append(f"{x:g}, {y:g} of {line.get_label()}")
    return found
