"""Charts of flights and flight records, for pages: temperatures, residuals, heat, trajectory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.report.chart import COLORS, Chart, Curve, Panel, Span, distinct_styles
from sim_heating.base.report.figure import ANGLES, MANOEUVRE_NAMES
from sim_heating.base.report.page import Picture, SavedPicture
from sim_heating.inputs.record import Record, pooled_rmse_K
from sim_heating.march.history import PointHistory, is_hot_structure
from sim_heating.simulation.report.plots import LIMITS_SHOWN
from sim_heating.trajectory.flight import Window

MARGIN = 0.2
"""Time shown on either side of the fitted samples, over their time span."""
FITTED, HELD_OUT, MANOEUVRE = "#e6eff8", "0.85", "#fdebd0"
"""Colours of shaded spans."""
MEASURED = "0.35"
LAMP = "q_add_W_m2"
CHANGED_DEG = 0.5
"""Range of an angle above which it is drawn."""
FITTED_SHADE, HELD_OUT_SHADE = "blue fitted", "grey held out"
SHADES = f"Shaded: {FITTED_SHADE}, {HELD_OUT_SHADE}."


@dataclass(frozen=True, eq=False)
class ModelCurve:
    """Temperatures of a record's sensors by one model, whose name is the label.

    indicated_K, residual_K : (sensor, sample) indicated, and measured minus indicated [K]
    """

    label: str
    color: str
    indicated_K: FloatArray
    residual_K: FloatArray


def with_rmse(name: str, residual_K: FloatArray, fitted: NDArray[np.bool_]) -> str:
    """A name and the RMSE [K] of one sensor over the fitted samples, for keys and legends; the name where it has none.

    residual_K : (sample,) measured minus predicted [K];  fitted : (sample,) whether it is fitted
    """
    errors = pooled_rmse_K(residual_K, fitted)
    return name if errors is None else f"{name}, RMSE {errors['rmse_K']:.2f} K"


def shown_span(record: Record) -> tuple[float, float]:
    """First and last time [s] that are shown first: those of the fitted and held-out samples, and a margin."""
    used = record.time_s[record.fit_mask() | record.holdout_mask()]
    margin = MARGIN * float(np.ptp(used)) if len(used) else 0.0
    first, last = (used.min(), used.max()) if len(used) else record.time_s[[0, -1]]
    return max(float(record.time_s[0]), float(first) - margin), min(float(record.time_s[-1]), float(last) + margin)


def residual_limits(residual_K: FloatArray) -> tuple[float, float]:
    """Limits of an axis of residuals [K] by those of the fitted samples: a held-out span that the model misses would
    flatten all others."""
    spread = np.nanpercentile(np.abs(residual_K), 99.0) if np.any(np.isfinite(residual_K)) else 1.0
    return -1.3 * float(spread) - 1.0, 1.3 * float(spread) + 1.0


def record_spans(record: Record) -> list[Span]:
    """Segments that are fitted, where the record declares some, and held out."""
    segments = record.declared.segments
    fitted = [Span(float(a), float(b), "fitted", FITTED) for a, b in segments.fit or []]
    return fitted + [Span(float(a), float(b), "held out", HELD_OUT) for a, b in segments.holdout]


def shades(record: Record) -> str:
    """What the shaded spans of a record mean; empty where none is shaded."""
    segments = record.declared.segments
    shown = [(segments.fit, FITTED_SHADE), (segments.holdout, HELD_OUT_SHADE)]
    named = ", ".join(shade for spans, shade in shown if spans)
    return f"Shaded: {named}." if named else ""


def record_chart(
    record: Record,
    models: Sequence[ModelCurve],
    picture: Picture | SavedPicture | None = None,
    *,
    scale: int = 0,
    temperatures: bool = True,
) -> Chart:
    """Measured and predicted temperatures of each used sensor, the residuals below each, and the flight.

    scale        : number of the model whose residuals set their axes
    picture      : in its place on paper
    temperatures : whether these are drawn, or the residuals alone
    """
    t, used = record.time_s, [i for i, s in enumerate(record.sensors) if s.used]
    read_K, fitted = record.temperatures_K(), record.fit_mask()
    panels = []
    for i in used or range(len(record.sensors)):
        name = record.sensors[i].name
        labelled = [(with_rmse(m.label, m.residual_K[i], fitted), m) for m in models]
        if temperatures:
            curves = [Curve(label, t, m.indicated_K[i], m.color) for label, m in labelled]
            measured = Curve("measured", t, read_K[i], MEASURED, points=True)
            panels.append(Panel(f"{name}, indicated, K", [measured, *curves]))
        residuals = [Curve(label, t, m.residual_K[i], m.color, points=True) for label, m in labelled]
        limits = residual_limits(models[scale].residual_K[i][fitted])
        panels.append(Panel(f"{name}, measured minus predicted, K", residuals, 0.6, zero=True, limits=limits))
    view = shown_span(record)
    panels += flown_panels(record.conditions)
    curves_text = "Measured and predicted, residuals below" if temperatures else "Measured minus predicted"
    caption = f"{record.declared.title or record.declared.control_point}. {curves_text}. {shades(record)}".rstrip()
    return Chart(record.name, panels, caption, view, record_spans(record), picture)


def flown_panels(conditions: Conditions, height: float = 0.5) -> list[Panel]:
    """What was flown: angles that changed, Mach number, Reynolds number, the known flux of a lamp."""
    t = conditions.time_s
    angles = [
        Curve(label, t, conditions[name], color)
        for name, (label, color) in ANGLES.items()
        if name in conditions and np.ptp(conditions[name]) > CHANGED_DEG
    ]
    panels = [Panel("angles, deg", angles, height)] if angles else []
    for name, label, unit in (("mach", "Mach number", 1.0), ("log10_re", "log10 of Reynolds number", 1.0)):
        if name in conditions and np.ptp(conditions[name]) > 0.0:
            panels.append(Panel(label, [Curve(label, t, conditions[name] / unit, COLORS[0])], 0.8 * height))
    if LAMP in conditions and np.ptp(conditions[LAMP]) > 0.0:
        panels.append(Panel("known flux, kW/m2", [Curve("known flux", t, conditions[LAMP] / 1e3, COLORS[1])], height))
    return panels


def window_spans(windows: Sequence[Window]) -> list[Span]:
    """Manoeuvres."""
    return [Span(w.start_s, w.end_s, MANOEUVRE_NAMES.get(w.kind, w.kind), MANOEUVRE) for w in windows]


def _shaded(windows: Sequence[Window]) -> str:
    return " Shaded: manoeuvres." if windows else ""


def temperature_chart(
    points: Sequence[PointHistory],
    windows: Sequence[Window],
    limits: Mapping[str, Mapping[str, float | None]],
    picture: Picture | SavedPicture | None = None,
) -> Chart:
    """Surface and bondline temperatures of control points, hottest first, with the limits of a few."""
    ordered = sorted(points, key=lambda p: -float(np.max(p.surface_K)))
    styles = distinct_styles(len(ordered))
    hot = {p.name for p in ordered if is_hot_structure(np.max(p.surface_K), np.max(p.bondline_K))}
    panels = []
    for key, label in (("surface_K", "surface temperature, K"), ("bondline_K", "bondline temperature, K")):
        styled = zip(ordered, styles, strict=True)
        shown = [(p, s) for p, s in styled if key == "surface_K" or p.name not in hot]
        curves = [Curve(p.name, p.time_s, getattr(p, key), **s) for p, s in shown]
        if len(ordered) <= LIMITS_SHOWN:
            curves += _limit_curves([(p, s["color"], limits.get(p.name, {}).get(key)) for p, s in shown])
        if curves:
            panels.append(Panel(label, curves, 1.3 if key == "surface_K" else 1.0))
    caption = "Surface and bondline temperatures of the control points, hottest first; hot structure has no bondline."
    return Chart("Temperatures", panels, f"{caption}{_shaded(windows)}", spans=window_spans(windows), picture=picture)


def _limit_curves(limits: Sequence[tuple[PointHistory, str, float | None]]) -> list[Curve]:
    """Temperature limits of points [K], dotted in their colours; of a point without one none."""
    return [
        Curve(f"{p.name}, limit", p.time_s[[0, -1]], np.full(2, limit), color, dash=(2, 4))
        for p, color, limit in limits
        if limit is not None and np.isfinite(limit)
    ]


def heat_chart(
    points: Sequence[PointHistory], windows: Sequence[Window], picture: Picture | SavedPicture | None = None
) -> Chart:
    """Heat fluxes at the surface of control points and their heat loads."""
    ordered = sorted(points, key=lambda p: -float(np.nanmax(p.heat.convected_W_m2)))
    styles = distinct_styles(len(ordered))
    panels = [
        Panel(
            label,
            [Curve(p.name, p.time_s, p.heat.columns()[key] / unit, **s) for p, s in zip(ordered, styles, strict=True)],
            0.8,
            zero=key == "conducted_W_m2",
        )
        for key, unit, label in (
            ("convected_W_m2", 1e3, "convected, kW/m2"),
            ("conducted_W_m2", 1e3, "conducted, kW/m2"),
            ("heat_load_J_m2", 1e6, "heat load, MJ/m2"),
        )
    ]
    caption = f"Heat at the surface of the control points.{_shaded(windows)}"
    return Chart("Heat at the surface", panels, caption, spans=window_spans(windows), picture=picture)


def trajectory_chart(
    flown: Conditions, windows: Sequence[Window], picture: Picture | SavedPicture | None = None
) -> Chart:
    """Altitude, velocity, angles, Mach and Reynolds number and dynamic pressure of a flight."""
    t, panels = flown.time_s, []
    for name, unit, label in (
        ("altitude_m", 1e3, "altitude, km"),
        ("velocity_m_s", 1e3, "velocity, km/s"),
        ("bank_deg", 1.0, "bank, deg"),
        ("qbar_Pa", 1e3, "dynamic pressure, kPa"),
    ):
        if name in flown and np.ptp(flown[name]) > 0.0:
            panels.append(Panel(label, [Curve(label.partition(",")[0], t, flown[name] / unit, COLORS[0])], 0.5))
    panels += flown_panels(flown, 0.6)
    caption = f"The flight.{_shaded(windows)}"
    return Chart("Trajectory", panels, caption, spans=window_spans(windows), picture=picture)
