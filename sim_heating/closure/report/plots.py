"""Figures of a closure report: before and after, residual heating against time and variables, candidates, loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.report.chart import Chart, Curve, Panel, Span
from sim_heating.base.report.figure import ANGLES, add_grid_and_title, mark_beyond, new_figure
from sim_heating.base.report.page import Picture
from sim_heating.closure.clues.correlation import ResidualEvidence
from sim_heating.closure.clues.residual_heating import ResidualHeating
from sim_heating.closure.clues.shapes import TIME
from sim_heating.estimation.report.plots import AFTER, BEFORE, FITTED, fit_chart, fit_figure, shade_holdout
from sim_heating.simulation.predict import Prediction
from sim_heating.simulation.report.charts import flown_panels, record_spans, shades

PREDICTED = "0.62"
LABELS = {n: f"{label}, deg" for n, (label, _) in ANGLES.items()} | {
    "log10_re": "log10 of Reynolds number",
    "mach": "Mach number",
    "jets": "jets",
    "wall_K": "wall temperature, K",
    "wall_enthalpy_ratio": "wall over recovery enthalpy",
    "axial_accel_g": "axial acceleration, g",
    TIME: "time, s",
}
COMPARED = "Each used sensor with its residuals below (measured minus predicted); held-out spans shaded."
ACTIVE = "#f9dcdc"
"""Colour of the time in which a residual is active."""
SIGMAS = 2.0


def comparison_figure(predicted: Prediction | None, declared: Prediction, final: Prediction, effect: str) -> Figure:
    """Measured against predicted temperatures of each used sensor: declared model, the same fitted, with effect."""
    figure, axes = fit_figure(final.record, _compared(predicted, declared, final, effect))
    add_grid_and_title(figure, "", axes)
    return figure


def comparison_chart(predicted: Prediction | None, declared: Prediction, final: Prediction, effect: str) -> Chart:
    """The chart of `comparison_figure`, which is the picture in its place."""
    picture = Picture(partial(comparison_figure, predicted, declared, final, effect), COMPARED)
    return fit_chart(final.record, _compared(predicted, declared, final, effect), picture)


def _compared(
    predicted: Prediction | None, declared: Prediction, final: Prediction, effect: str
) -> list[tuple[Prediction, str, str]]:
    curves = [] if predicted is None else [(predicted, PREDICTED, "declared model")]
    curves.append((declared, BEFORE, FITTED))
    if final is not declared:
        curves.append((final, AFTER, f"with {effect}"))
    return curves


def heating_chart(declared: ResidualHeating, final: ResidualHeating | None, evidence: ResidualEvidence) -> Chart:
    """The residual as heating against time with its band, and the flight; `heating_figure` is the picture."""
    shown = [(declared, BEFORE, FITTED)] + ([] if final is None else [(final, AFTER, "with the effect")])
    curves = [Curve(label, r.time_s, r.delta_ratio, color, sigma=r.sigma) for r, color, label in shown]
    limits = np.array([_limits(r) for r, _, _ in shown])
    missing = Panel(
        f"missing {declared.quantity}", curves, zero=True, limits=(float(limits[:, 0].min()), float(limits[:, 1].max()))
    )
    picture = Picture(partial(heating_figure, declared, final, evidence), f"Missing {declared.quantity} against time.")
    spans = [Span(s.start_s, s.end_s, "active", ACTIVE) for s in evidence.active] + record_spans(declared.record)
    shaded = [shades(declared.record), "Red: the residual is active." if evidence.active else ""]
    caption = " ".join([f"Missing {declared.quantity} against time; bands: {SIGMAS:g} sigma.", *filter(None, shaded)])
    panels = [missing, *flown_panels(declared.record.conditions)]
    return Chart("Residual as heating", panels, caption, declared.span_s, spans, picture)


def heating_figure(declared: ResidualHeating, final: ResidualHeating | None, evidence: ResidualEvidence) -> Figure:
    """The residual as a heating ratio against time, with the angles that changed."""
    flown = declared.record.conditions.at(declared.time_s)
    changed = [name for name in ANGLES if np.ptp(flown[name]) > 0.5]
    if changed:
        figure, axes = new_figure(9.5, 6.0, 2, sharex=True, height_ratios=[2.0, 1.0])
    else:
        figure, axes = new_figure(9.5, 4.0, 1)
    limits = np.array([_limits(residual) for residual in filter(None, (declared, final))])
    axes[0].set_ylim(limits[:, 0].min(), limits[:, 1].max())
    _band(axes[0], declared, BEFORE, FITTED)
    if final is not None:
        _band(axes[0], final, AFTER, "with the effect")
    axes[0].axhline(0.0, color="0.3", linewidth=0.8)
    for span in evidence.active:
        axes[0].axvspan(span.start_s, span.end_s, ymax=0.03, color="tab:red", linewidth=0)
    axes[0].set_ylabel(f"missing {declared.quantity}")
    axes[0].legend(fontsize=8, loc="best")
    for name in changed:
        label, color = ANGLES[name]
        axes[1].plot(declared.time_s, flown[name], color=color, label=label, linewidth=1.1)
    if changed:
        axes[1].set_ylabel("deg")
        axes[1].legend(fontsize=8, loc="best", ncols=4)
    for a in axes:
        shade_holdout(a, declared.record)
    axes[-1].set_xlim(*declared.span_s)
    axes[-1].set_xlabel("time, s; band: 2 sigma; red at the foot: active")
    add_grid_and_title(figure, "", axes)
    return figure


def _band(a: Axes, residual: ResidualHeating, color: str, label: str) -> None:
    """A history with its band of SIGMAS; knots beyond the limits of the axes are marked at their edge."""
    t, d, s = residual.time_s, residual.delta_ratio, residual.sigma
    low, high = a.get_ylim()
    a.fill_between(t, d - SIGMAS * s, d + SIGMAS * s, color=color, alpha=0.25, linewidth=0)
    a.plot(t, np.where((d >= low) & (d <= high), d, np.nan), color=color, linewidth=1.2, label=label)
    mark_beyond(a, t, d, color)


def _limits(residual: ResidualHeating) -> tuple[float, float]:
    """Limits of the axis of well-determined points, with a margin."""
    shown = _well_determined(residual)
    d, s = residual.delta_ratio[shown], SIGMAS * residual.sigma[shown]
    low, high = float(np.min(d - s)), float(np.max(d + s))
    return low - 0.08 * (high - low), high + 0.08 * (high - low)


def _well_determined(residual: ResidualHeating) -> NDArray[np.bool_]:
    """(knot,) fitted knots whose sigma is not far above the median."""
    max_sigma_ratio = 4.0  # points of a sigma above this many times the median are not drawn against variables
    fitted = residual.fitted
    return np.asarray(fitted & (residual.sigma <= max_sigma_ratio * np.median(residual.sigma[fitted])))


def variables_figure(residual: ResidualHeating, variables: Mapping[str, FloatArray], order: Sequence[str]) -> Figure:
    """The residual heating against each variable, coloured by time.

    variables : (knot,) by name;  order : names, those that explain most first
    """
    max_panels = 6
    shown = _well_determined(residual)
    names = [n for n in order if n in variables and n != TIME and np.ptp(variables[n][shown]) > 0.0][:max_panels]
    columns = min(max(len(names), 1), 3)
    rows = max(-(-len(names) // columns), 1)
    figure, axes = new_figure(1.4 + 2.7 * columns, 2.7 * rows + 0.4, rows, columns, sharey=True, squeeze=False)
    t, d, s = (x[shown] for x in (residual.time_s, residual.delta_ratio, residual.sigma))
    mappable = None
    for a, name in zip(axes.ravel(), names, strict=False):
        v = variables[name][shown]
        a.errorbar(v, d, s, fmt="none", ecolor="0.8", elinewidth=0.6, zorder=1, rasterized=True)
        mappable = a.scatter(v, d, c=t, s=7, cmap="viridis", zorder=2, rasterized=True)
        a.axhline(0.0, color="0.3", linewidth=0.8)
        a.set_xlabel(LABELS.get(name, name))
        a.set_ylim(*_limits(residual))
    for a in axes.ravel()[len(names) :]:
        a.set_visible(False)
    for a in axes.reshape(rows, columns)[:, 0]:
        a.set_ylabel(f"missing {residual.quantity}")
    if mappable is not None:
        figure.colorbar(mappable, ax=axes, label="time, s", aspect=40)
    add_grid_and_title(figure, "", axes)
    return figure


def hysteresis_figure(
    residual: ResidualHeating, variables: Mapping[str, FloatArray], evidence: ResidualEvidence
) -> Figure | None:
    """The manoeuvres with the widest loops of the residual, at most `max_loops`; None where none is significant."""
    max_loops = 3
    widest = sorted((loop for loop in evidence.loops if loop.significant), key=lambda loop: -abs(loop.filled))[
        :max_loops
    ]
    if not widest:
        return None
    figure, axes = new_figure(9.5, 3.0, 1, max_loops)
    for a in axes[len(widest) :]:
        a.set_visible(False)
    for a, loop in zip(axes, widest, strict=False):
        inside = (residual.time_s >= loop.start_s) & (residual.time_s <= loop.end_s)
        v, d = variables[loop.variable][inside], residual.delta_ratio[inside]
        a.errorbar(v, d, residual.sigma[inside], color=BEFORE, marker="o", markersize=3, linewidth=1.0, ecolor="0.8")
        a.annotate("", (v[1], d[1]), (v[0], d[0]), arrowprops={"arrowstyle": "->", "color": BEFORE})
        a.set_xlabel(LABELS[loop.variable])
        a.set_title(f"{loop.start_s:.0f} to {loop.end_s:.0f} s", fontsize=9)
    axes[0].set_ylabel(f"missing {residual.quantity}")
    add_grid_and_title(figure, "", axes)
    return figure


def ranking_figure(names: Sequence[str], delta_bic: Sequence[float], chosen: Sequence[str]) -> Figure:
    """BIC of each candidate minus that of none, best at the top; axis linear within 10, logarithmic beyond."""
    figure, axes = new_figure(9.5, 0.27 * len(names) + 0.9, 1)
    a = axes[0]
    y = np.arange(len(names))[::-1]
    a.barh(y, delta_bic, color=[AFTER if n in chosen else PREDICTED for n in names], height=0.7)
    a.set_yticks(y, names, fontsize=9)
    a.set_xscale("symlog", linthresh=10.0)
    a.axvline(0.0, color="0.3", linewidth=0.8)
    a.set_xlabel("BIC minus that without an effect (lower is better)")
    add_grid_and_title(figure, "", axes)
    return figure
