"""Time histories about manoeuvres, figures 5, 6, 7, 10, 11 and 13: measured, predicted, fitted; the angles beneath."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.report.figure import ANGLES, MEASURED, legend_above, mark_beyond, new_figure
from sim_heating.campaign.figures.figure_file import PaperFigure, finished
from sim_heating.campaign.figures.flown import FLAP, POPU, FlownData, PointManoeuvre, fit_quality
from sim_heating.estimation.fit import FitResult
from sim_heating.estimation.report.plots import AFTER, BEFORE, DRAWN_ABOVE_DEG
from sim_heating.heating.effects.transition import TRANSITION
from sim_heating.simulation.report.plots import AFTER_S, BEFORE_S

LAMINAR = "0.55"
DIFFERENT_K = 5.0
"""Difference above which the declared model without its transition is drawn as well [K]."""
ALPHA = "alpha_deg"
LEAST_SPAN_K = 4.0
"""Least half height of a panel of residuals [K]."""


@dataclass(frozen=True, eq=False)
class Panel:
    """One manoeuvre of a figure with its fit."""

    flown: PointManoeuvre
    fit: FitResult


def lower_surface(number: int, mach: float) -> Any:
    """Drawing of figure 5, 6 or 7: the lower surface in the POPU of a speed in units of 1000 ft/s."""

    def draw(data: FlownData) -> PaperFigure:
        flown = data.manoeuvre("lower", POPU, mach)
        return _draw(number, "lower surface", data, [Panel(flown, data.linear_fit(flown, "alpha"))])

    return draw


def elevon(number: int, shown: Sequence[tuple[tuple[str, ...], float]]) -> Any:
    """Drawing of figure 10 or 11: the outboard elevon in manoeuvres given by kinds and speed."""

    def draw(data: FlownData) -> PaperFigure:
        panels = []
        for kinds, mach in shown:
            flown = data.manoeuvre("elevon", kinds, mach)
            # a POPU is trimmed with the elevon, which the point is on
            terms = ("elevon", "elevon2") if kinds == FLAP else ("alpha", "elevon")
            panels.append(Panel(flown, data.linear_fit(flown, *terms)))
        return _draw(number, "outboard elevon", data, panels)

    return draw


def pod(data: FlownData) -> PaperFigure:
    """Figure 13: the side of the OMS pod in the Mach 20 POPU."""
    flown = data.manoeuvre("pod", POPU, 20.0)
    fit = data.impingement_fit(flown, "clock.skew")
    return _draw(13, "OMS pod", data, [Panel(flown, fit)])


def _draw(number: int, where: str, data: FlownData, panels: Sequence[Panel]) -> PaperFigure:
    """One column of panels a manoeuvre."""
    title = f"{where} {panels[0].flown.record.declared.control_point}, {' and '.join(p.flown.label for p in panels)}"
    drawn = new_figure(
        8.0 if len(panels) == 1 else 11.5, 7.0, 3, len(panels), squeeze=False, sharex="col", height_ratios=[2.6, 1, 1.4]
    )
    tables: dict[str, dict[str, Any]] = {}
    notes = []
    for column, panel in zip(drawn[1].T, panels, strict=True):
        part = panel.flown.key if len(panels) > 1 else ""
        tables |= _plot_panel(column, data, panel, part)
        notes.append(f"{panel.flown.label}, {panel.flown.record.declared.control_point}: {fit_quality(panel.fit)}")
    return finished(number, title, drawn, tables, tuple(notes))


def _plot_panel(axes: np.ndarray, data: FlownData, panel: Panel, part: str) -> dict[str, dict[str, Any]]:
    """Plot one manoeuvre from top to bottom; the tables of what is drawn."""
    flown, record = panel.flown, panel.flown.record
    i, sensor = flown.outermost
    begin, end = flown.manoeuvre.start_s - BEFORE_S, flown.manoeuvre.end_s + AFTER_S
    shown = (record.time_s >= begin) & (record.time_s <= end)
    t = record.time_s[shown]
    columns = {"time_s": t, "measured_K": record.temperatures_K()[i][shown]}
    columns["declared_K"] = data.declared(record).indicated_K[i][shown]
    if data.turbulent_part(flown) is not None:
        laminar = data.declared(record, [TRANSITION]).indicated_K[i][shown]
        if np.nanmax(np.abs(laminar - columns["declared_K"])) > DIFFERENT_K:
            columns["declared_laminar_K"] = laminar
    columns["fitted_K"] = panel.fit.after[0].indicated_K[i][shown]
    columns["residual_K"] = columns["measured_K"] - columns["fitted_K"]
    top, middle, bottom = axes
    top.plot(t, columns["measured_K"], label=f"measured, {sensor.name}", **MEASURED)
    top.plot(t, columns["declared_K"], color=BEFORE, linewidth=1.3, label="declared tables")
    if "declared_laminar_K" in columns:
        laminar = columns["declared_laminar_K"]
        top.plot(t, laminar, color=LAMINAR, linewidth=1.3, linestyle="--", label="declared, laminar")
    top.plot(t, columns["fitted_K"], color=AFTER, linewidth=1.5, label="fitted")
    top.set_ylabel("thermocouple, K")
    legend_above(top)
    _plot_residual(middle, t, columns["residual_K"])
    angles = _plot_angles(bottom, record.conditions, begin, end)
    for a in axes:
        a.axvspan(flown.manoeuvre.start_s, flown.manoeuvre.end_s, color="tab:orange", alpha=0.14, linewidth=0)
        a.set_xlim(begin, end)
    bottom.set_xlabel("time, s; shaded: manoeuvre")
    return {part: columns, f"{part}_angles".lstrip("_"): angles}


def _plot_residual(a: Axes, t: np.ndarray, residual: np.ndarray) -> None:
    a.plot(t, residual, ".", color=AFTER, markersize=3.5)
    a.axhline(0.0, color="0.3", linewidth=0.8)
    found = np.abs(residual[np.isfinite(residual)])
    span = max(LEAST_SPAN_K, 1.4 * float(np.percentile(found, 97.0))) if len(found) else LEAST_SPAN_K
    a.set_ylim(-span, span)
    mark_beyond(a, t, residual, AFTER)
    a.set_ylabel("measured\n- fitted, K")


def _plot_angles(a: Axes, conditions: Conditions, begin: float, end: float) -> dict[str, FloatArray]:
    """Plot the angles that change, at all times of the conditions, deflections on the right; their table."""
    inside = (conditions.time_s >= begin) & (conditions.time_s <= end)
    columns = {"time_s": conditions.time_s[inside]}
    moving = [name for name in ANGLES if np.ptp(conditions[name][inside]) > DRAWN_ABOVE_DEG]
    deflections = [name for name in moving if name != ALPHA]
    other = a.twinx() if ALPHA in moving and deflections else a
    lines = []
    for name in moving:
        label, color = ANGLES[name]
        columns[name] = conditions[name][inside]
        place, style = (a, "-") if name == ALPHA or other is a else (other, "--")
        lines += place.plot(columns["time_s"], columns[name], style, color=color, linewidth=1.3, label=label)
    a.set_ylabel(f"{ANGLES[ALPHA][0]}, deg" if ALPHA in moving else "deg")
    if other is not a:
        other.set_ylabel("deflections, deg\n(dashed)")
    if lines:
        legend_above(a, handles=lines)
    return columns
