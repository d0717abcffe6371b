"""Time histories that a reader of a page can zoom: curves in panels over one time axis.

    Chart("V09T9527", [Panel("temperature, K", [Curve("measured", time_s, read_K, "0.35", points=True)])])

A page draws them in the browser with uPlot, which it carries within itself (`vendor`); on paper, and where scripts are
off, a picture stands in their place. A curve of many samples is decimated: of equal intervals of time it keeps the
least and the greatest value, so that no extreme is lost, and the page states it.
"""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import printable
from sim_heating.base.report.figure import legend_above, legend_label, mark_beyond, new_figure, save_figure

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#7F7F7F")
"""Colours that people with any colour vision tell apart: Okabe and Ito (2008) without yellow, and a grey."""
DASHES = ((), (7, 4), (2, 3))
"""Dashes that tell curves apart once the colours are used up [pixels]."""
MOST_IN_A_COLUMN = 8
"""Panels of a picture below each other; more stand in two columns, so that they can be read on paper."""
LABEL_WIDTH = 15
"""Characters in a line of the label of a low panel."""
PAGE_SAMPLES = 60_000
"""Samples that the charts of a page hold together: about 0.4 MB."""
MOST_INTERVALS, LEAST_INTERVALS = 700, 100
"""Number of intervals of a decimated curve: a screen is hardly wider than 1400 points."""
RESOLUTION = 20_000
"""Steps that the range of a curve is divided into: finer than a screen shows at a hundredfold zoom."""
LONGEST_TIME_STEP_S, TIMES = 1e-3, 1e6
"""Times are multiples of a millisecond, or of a millionth of a shorter span."""


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve.

    time_s, values : (sample,) each; NaN is a gap
    color          : as matplotlib takes it
    points         : drawn as dots, not as a line;  dash : lengths of its dashes and gaps [pixels]
    sigma          : (sample,) of a band of +-2 sigma about it
    """

    label: str
    time_s: FloatArray
    values: FloatArray
    color: str
    points: bool = False
    dash: Sequence[int] = ()
    sigma: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves over one vertical axis.

    label  : quantity and unit, separated by a comma
    height : over that of a panel of temperatures
    zero   : whether a line marks 0
    limits : of the vertical axis in the first view; samples beyond are marked at its edge. None: of all samples
    """

    label: str
    curves: Sequence[Curve]
    height: float = 1.0
    zero: bool = False
    limits: tuple[float, float] | None = None


@dataclass(frozen=True)
class Span:
    """A shaded span of time [s]: what it is, and its colour."""

    start_s: float
    end_s: float
    label: str
    color: str = "0.85"


@dataclass(frozen=True, eq=False)
class Chart:
    """Panels over one time axis.

    title, caption : for all readers
    view           : first and last time of the first view [s]; by default of all samples
    spans          : shaded
    picture        : in its place on paper and without scripts, with a `data_url`; drawn from the chart where None
    pictured       : whether a picture stands in its place; not where that of another chart shows the same
    time           : quantity and unit of the horizontal axis

    Charts of one page are zoomed together.
    """

    title: str
    panels: Sequence[Panel]
    caption: str = ""
    view: tuple[float, float] | None = None
    spans: Sequence[Span] = field(default=())
    picture: Any = None
    pictured: bool = True
    time: str = "time, s"

    @property
    def curves(self) -> list[Curve]:
        """Curves of all panels."""
        return [c for panel in self.panels for c in panel.curves]

    def figure(self) -> Figure:
        """The chart as a picture."""
        columns = 1 if len(self.panels) <= MOST_IN_A_COLUMN else 2
        by_row = [self.panels[i : i + columns] for i in range(0, len(self.panels), columns)]
        heights = [max(panel.height for panel in row) for row in by_row]
        figure, grid = new_figure(
            9.5, 2.6 * sum(heights) + 1.0, len(heights), columns, sharex=True, height_ratios=heights
        )
        axes = grid.ravel()[: len(self.panels)]
        for left_over in grid.ravel()[len(self.panels) :]:
            left_over.remove()
        for a, panel in zip(axes, self.panels, strict=True):
            _draw_panel(a, panel, self.spans)
        for a in axes[-columns:]:
            a.set_xlabel(self.time)
            a.tick_params(labelbottom=True)
        if self.view is not None:
            axes[-1].set_xlim(*self.view)
        return save_figure(figure, None, self.title, axes)


def _draw_panel(axes: Axes, panel: Panel, spans: Sequence[Span]) -> None:
    """Draw the curves of a panel, its spans, its line of zero and its limits."""
    for curve in panel.curves:
        _draw_curve(axes, _drawable(curve))
    for span in spans:
        axes.axvspan(span.start_s, span.end_s, color=span.color, linewidth=0)
    if panel.zero:
        axes.axhline(0.0, color="0.3", linewidth=0.8)
    if panel.limits is not None:
        axes.set_ylim(*panel.limits)
        for c in panel.curves:
            mark_beyond(axes, c.time_s, c.values, c.color)
    axes.set_ylabel(_lines(panel.label) if panel.height < 0.8 else panel.label)
    if any(c.label for c in panel.curves):
        legend_above(axes)


def _draw_curve(axes: Axes, c: Curve) -> None:
    """Draw a curve, and its band of two sigma where it has one."""
    style: dict[str, Any] = {"linewidth": 1.2}
    if c.points:
        style = {"marker": ".", "linestyle": "none", "markersize": 2.5}
    if c.dash:
        style["dashes"] = list(c.dash)
    if c.sigma is not None:
        axes.fill_between(c.time_s, c.values - 2 * c.sigma, c.values + 2 * c.sigma, color=c.color, alpha=0.2)
    axes.plot(c.time_s, c.values, color=c.color, label=legend_label(c.label), rasterized=c.points, **style)


def _lines(label: str) -> str:
    """The label of a low panel in lines: the unit by itself, a long name without unit wrapped."""
    return label.replace(", ", ",\n", 1) if ", " in label else textwrap.fill(label, LABEL_WIDTH)


def _drawable(curve: Curve) -> Curve:
    """A curve of no more samples than a picture shows."""
    time_s, values = np.asarray(curve.time_s, dtype=float), np.asarray(curve.values, dtype=float)
    kept = decimated(time_s, values, MOST_INTERVALS, middle=curve.points)
    sigma = None if curve.sigma is None else curve.sigma[kept]
    return replace(curve, time_s=curve.time_s[kept], values=curve.values[kept], sigma=sigma)


def distinct_styles(count: int) -> list[dict[str, Any]]:
    """Colour and dashes of a number of curves, as `Curve` takes them."""
    return [{"color": COLORS[i % len(COLORS)], "dash": DASHES[i // len(COLORS) % len(DASHES)]} for i in range(count)]


def intervals_of(charts: Sequence[Chart]) -> int:
    """Number of intervals of a decimated curve on a page with these charts."""
    curves = sum(3 if c.sigma is not None else 1 for chart in charts for c in chart.curves)
    return int(np.clip(PAGE_SAMPLES // (2 * max(curves, 1)), LEAST_INTERVALS, MOST_INTERVALS))


def decimated(time_s: FloatArray, values: FloatArray, intervals: int, *, middle: bool = False) -> NDArray[np.intp]:
    """Indices of the samples that are drawn: of each interval of time the least and the greatest value.

    time_s    : (sample,) increasing;  values : (sample,) NaN is a gap, of which the first sample stays
    intervals : number of equal intervals of time; with no more than two samples in each, all are drawn
    middle    : whether the median of each interval is drawn, too: dots between the extremes look like the whole then
    returns   : increasing; the first and the last finite sample are among them
    """
    finite = np.flatnonzero(np.isfinite(values) & np.isfinite(time_s))
    gaps = np.flatnonzero(~np.isfinite(values) & np.append(True, np.isfinite(values[:-1])))
    if len(finite) <= 2 * intervals:
        return np.union1d(finite, gaps)
    t, y = time_s[finite], values[finite]
    number = np.minimum(((t - t[0]) / (t[-1] - t[0]) * intervals).astype(int), intervals - 1)
    order = np.lexsort((y, number))
    changes = np.flatnonzero(np.diff(number[order]))
    least, greatest = np.append(0, changes + 1), np.append(changes, len(order) - 1)
    medians = order[(least + greatest) // 2] if middle else order[:0]
    kept = finite[np.unique(np.concatenate([order[least], medians, order[greatest], [0, len(finite) - 1]]))]
    return np.union1d(kept, gaps) if len(gaps) <= intervals else kept


def chart_data(chart: Chart, intervals: int) -> tuple[dict[str, Any], str]:
    """What a browser draws, and a sentence on the decimation, empty where every sample is drawn.

    Times and values are whole multiples of a step, each as the difference from the one before.
    """
    times: list[FloatArray] = []
    most = max((len(c.time_s) for c in chart.curves), default=0)
    reduced = False

    def time_number(time_s: FloatArray) -> int:
        for i, earlier in enumerate(times):
            if np.array_equal(earlier, time_s, equal_nan=True):
                return i
        times.append(time_s)
        return len(times) - 1

    def encoded(time_s: FloatArray, values: FloatArray, points: bool) -> dict[str, Any]:
        nonlocal reduced
        kept = decimated(time_s, values, intervals, middle=points)
        reduced |= bool(np.count_nonzero(np.isfinite(values[kept])) < np.count_nonzero(np.isfinite(values)))
        if points:  # dots have no gaps
            kept = kept[np.isfinite(values[kept])]
        is_complete = len(kept) == len(time_s)
        drawn = values[kept]
        span = float(np.ptp(drawn[np.isfinite(drawn)])) if np.any(np.isfinite(drawn)) else 0.0
        top = float(np.max(np.abs(drawn[np.isfinite(drawn)]), initial=0.0))
        step = 10.0 ** math.floor(math.log10((span or top or 1.0) / RESOLUTION))
        return {
            "t": time_number(time_s),
            **({} if is_complete else {"i": _differences(kept.astype(float))}),
            "step": step,
            "y": _differences(drawn / step),
        }

    def curve(c: Curve) -> dict[str, Any]:
        time_s, values = np.asarray(c.time_s, dtype=float), np.asarray(c.values, dtype=float)
        entry = {"label": printable(c.label), "color": to_hex(c.color), **encoded(time_s, values, c.points)}
        entry |= {"points": True} if c.points else {}
        entry |= {"dash": list(c.dash)} if c.dash else {}
        if c.sigma is not None:
            entry["band"] = [encoded(time_s, values + k * c.sigma, False) for k in (-2.0, 2.0)]
        return entry

    panels = [
        {
            "label": printable(p.label),
            "height": p.height,
            "zero": p.zero,
            "curves": [curve(c) for c in p.curves],
            "limits": _floats(p.limits),
        }
        for p in chart.panels
    ]
    data = {
        "title": printable(chart.title),
        "time": printable(chart.time),
        "panels": panels,
        "view": _floats(chart.view),
        "spans": [[s.start_s, s.end_s, printable(s.label), to_hex(s.color)] for s in chart.spans],
        "times": [_encoded_times(t) for t in times],
    }
    note = (
        f"Curves of more than {2 * intervals} samples (up to {most}) are drawn by the least and the greatest value, "
        f"dots by the median too, in each of {intervals} equal intervals of time; the CSV files have every sample."
    )
    return data, note if reduced else ""


def _floats(ends: tuple[float, float] | None) -> list[float] | None:
    return None if ends is None else [float(end) for end in ends]


def _encoded_times(time_s: FloatArray) -> dict[str, Any]:
    span = float(np.ptp(time_s[np.isfinite(time_s)])) if np.any(np.isfinite(time_s)) else 0.0
    step = min(LONGEST_TIME_STEP_S, 10.0 ** math.floor(math.log10((span or 1.0) / TIMES)))
    return {"step": step, "y": _differences(time_s / step)}


def _differences(values: FloatArray) -> list[int | None]:
    """Rounded values, each less the one before it that is finite; the first as it is. None for what is not finite."""
    steps: list[int | None] = []
    last = 0
    for v in values.tolist():
        if not math.isfinite(v):
            steps.append(None)
        else:
            now = round(v)
            steps.append(now - last)
            last = now
    return steps


def script_json(data: Any) -> str:
    """JSON that may stand in a script element of a page, whatever its texts are: they cannot end the element."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
