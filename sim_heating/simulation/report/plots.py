"""Pictures of a flight and its temperatures; a function draws one picture and opens no window."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import SHUTTLE_MACH_M_S, Conditions
from sim_heating.base.report.figure import (
    ANGLES,
    MANOEUVRE_NAMES,
    MEASURED,
    SURFACE,
    THERMOCOUPLE,
    legend_label,
    new_figure,
    replaced_if_undrawable,
    save_figure,
)
from sim_heating.march.history import Band, PointHistory, is_hot_structure
from sim_heating.trajectory.flight import Window

BEFORE_S, AFTER_S = 15.0, 25.0
"""Time before and after a manoeuvre that is drawn [s]."""
LIMITS_SHOWN = 4
"""Number of points in a picture of temperatures up to which their limits are drawn as well."""
LEGEND_TEXT = {"fontsize": 7.5, "title_fontsize": 8}
LEGEND_LINES = 24
"""Number of lines in a column of a legend that is no taller than half a figure."""
DRAWN_CHANGE_DEG = 0.5
"""An angle that changes less during a manoeuvre is not drawn with the one that is flown [deg]."""


def _shade(axes: Axes, windows: Sequence[Window]) -> None:
    for window in windows:
        axes.axvspan(window.start_s, window.end_s, color="tab:orange", alpha=0.18, linewidth=0)


def _name_windows(axes: Axes, windows: Sequence[Window]) -> None:
    """Name the manoeuvre of each shaded span above it."""
    for window in windows:
        position = (0.5 * (window.start_s + window.end_s), 1.02)
        axes.annotate(
            MANOEUVRE_NAMES.get(window.kind, window.kind),
            position,
            xycoords=("data", "axes fraction"),
            rotation=30,
            fontsize=7.5,
        )


def _twin(axes: Axes, x: FloatArray, y: FloatArray, label: str, color: str) -> None:
    """Plot a second quantity on an axis on the right, in the colour of its line."""
    other = axes.twinx()
    other.plot(x, y, color=color)
    other.set_ylabel(label, color=color)
    other.tick_params(axis="y", colors=color)


@replaced_if_undrawable
def draw_trajectory(path: Path | None, title: str, flown: Conditions, windows: Sequence[Window]) -> Figure:
    """Altitude, velocity, angles and dynamic pressure against time, manoeuvres shaded and named."""
    figure, axes = new_figure(9.0, 9.5, 4, sharex=True)
    t = flown.time_s
    axes[0].plot(t, flown["altitude_m"] / 1e3, color="tab:blue")
    axes[0].set_ylabel("altitude, km", color="tab:blue")
    axes[0].tick_params(axis="y", colors="tab:blue")
    _twin(axes[0], t, flown["velocity_m_s"] / 1e3, "velocity, km/s", "tab:red")
    _plot_angles(axes[1], flown, ("alpha_deg", "beta_deg"))
    if "bank_deg" in flown:
        axes[2].plot(t, flown["bank_deg"], color="tab:blue")
        axes[2].set_ylabel("bank, deg", color="tab:blue")
    else:
        axes[2].set_yticks([])
    axes[2].tick_params(axis="y", colors="tab:blue")
    _twin(
        axes[2],
        t,
        flown["qbar_Pa"] / 1e3 if "qbar_Pa" in flown else np.full(len(t), np.nan),
        "dynamic pressure, kPa",
        "tab:red",
    )
    _plot_angles(axes[3], flown, ("elevon_deg", "bodyflap_deg"))
    axes[3].set_ylabel("deg, trailing edge down +")
    for a in axes:
        _shade(a, windows)
    _name_windows(axes[0], windows)
    axes[-1].set_xlabel("time, s")
    return save_figure(figure, path, f"{title}: trajectory", axes)


def _plot_angles(axes: Axes, flown: Conditions, names: Sequence[str]) -> None:
    for name in names:
        label, color = ANGLES[name]
        axes.plot(flown.time_s, flown[name], color=color, label=label)
    axes.set_ylabel("deg")
    axes.legend(loc="best", fontsize=8)


@replaced_if_undrawable
def draw_temperatures(
    path: Path | None,
    title: str,
    points: Sequence[PointHistory],
    windows: Sequence[Window],
    limits: Mapping[str, Mapping[str, float | None]] | None = None,
) -> Figure:
    """Surface and bondline temperatures of control points against time, legends in the order of the peaks.

    limits : `surface_K` and `bondline_K` [K] of each point, drawn dotted where a few points are
    """
    figure, axes = new_figure(10.0, 9.0, 2, sharex=True)
    style = _styles(points, {p.name: p.surface_K for p in points})
    hottest = sorted(points, key=lambda p: [*style].index(p.name))
    insulated = [p for p in hottest if not is_hot_structure(np.max(p.surface_K), np.max(p.bondline_K))]
    _plot_by_peak(axes[0], {p.name: (p.time_s, p.surface_K) for p in hottest}, style, "surface temperature, K")
    _plot_by_peak(axes[1], {p.name: (p.time_s, p.bondline_K) for p in insulated}, style, "bondline temperature, K")
    for k, (a, shown, key) in enumerate(((axes[0], hottest, "surface_K"), (axes[1], insulated, "bondline_K"))):
        _fill_bands(a, shown, k, style)
        if len(points) <= LIMITS_SHOWN:
            _plot_limits(a, {p.name: (limits or {}).get(p.name, {}).get(key) for p in shown}, style)
        _shade(a, windows)
    axes[1].set_xlabel("time, s")
    _name_windows(axes[0], windows)
    left_out = [p.name for p in hottest if p not in insulated]
    if left_out:
        axes[1].set_title(f"hot structure, no bondline: {', '.join(left_out)}", fontsize=8, loc="left")
    return save_figure(figure, path, title, axes)


def _fill_bands(axes: Axes, points: Sequence[PointHistory], channel: int, style: Mapping[str, dict[str, Any]]) -> None:
    """Shade the 95 % bands of a channel of points, of those that have one."""
    for p in points:
        if p.band is not None:
            ends = (p.band.low_K[channel], p.band.high_K[channel])
            axes.fill_between(p.time_s, *ends, color=style[p.name]["color"], alpha=0.18, linewidth=0)


def _styles(points: Sequence[PointHistory], values: Mapping[str, FloatArray]) -> dict[str, dict[str, Any]]:
    """Colour and line of each point by its name, in the order of their peaks."""
    ordered = sorted(points, key=lambda p: -float(np.max(values[p.name])))
    colors = mpl.colormaps["turbo"](np.linspace(0.95, 0.05, len(ordered)))
    return {
        p.name: {"color": colors[i], "linestyle": ("-", "--", "-.")[i % 3], "linewidth": 1.4}
        for i, p in enumerate(ordered)
    }


def _plot_limits(axes: Axes, limits: Mapping[str, float | None], style: Mapping[str, dict[str, Any]]) -> None:
    """Plot the limit of each point dotted, in its colour."""
    for name, limit in limits.items():
        if limit is not None:
            label = legend_label(f"{name}, limit  {limit:.0f} K")
            axes.axhline(limit, color=style[name]["color"], linestyle=":", linewidth=1.2, label=label)
    if any(limit is not None for limit in limits.values()):
        _legend_right(axes)


def _plot_by_peak(
    axes: Axes, lines: Mapping[str, tuple[FloatArray, FloatArray]], style: Mapping[str, dict[str, Any]], label: str
) -> None:
    """Plot a line for each point, with its peak in the legend, in the order of the peaks.

    label : quantity and unit, separated by a comma
    """
    unit = label.rpartition(", ")[2]
    for name in sorted(lines, key=lambda n: -float(np.max(lines[n][1]))):
        t, values = lines[name]
        axes.plot(t, values, label=legend_label(f"{name}  {_peak(values)} {unit}"), **style[name])
    axes.set_ylabel(label)
    if lines:
        _legend_right(axes)


def _peak(values: FloatArray) -> str:
    """Largest value, with a decimal where it is below 100."""
    top = float(np.max(values))
    return f"{top:.{0 if top >= 100.0 else 1}f}"


def _legend_right(axes: Axes) -> None:
    axes.legend(
        loc="center left",
        bbox_to_anchor=(1.01, 0.5),
        ncols=_legend_columns(len(axes.lines)),
        title="peak",
        **LEGEND_TEXT,
    )


def _legend_columns(lines: int) -> int:
    """Number of columns of a legend that is no taller than a panel of half a figure."""
    return -(-lines // LEGEND_LINES)


@replaced_if_undrawable
def draw_heating(path: Path | None, title: str, points: Sequence[PointHistory], windows: Sequence[Window]) -> Figure:
    """Convected, radiated and conducted heat flux and heat load of control points against time."""
    figure, axes = new_figure(10.0, 11.0, 4, sharex=True)
    style = _styles(points, {p.name: p.heat.convected_W_m2 for p in points})
    panels = (
        ("convected_W_m2", 1e3, "convected, kW/m2"),
        ("radiated_W_m2", 1e3, "radiated, kW/m2"),
        ("conducted_W_m2", 1e3, "conducted, kW/m2"),
        ("heat_load_J_m2", 1e6, "heat load, MJ/m2"),
    )
    hottest = {name: next(p for p in points if p.name == name) for name in style}
    for a, (key, unit, label) in zip(axes, panels, strict=True):
        for name, p in hottest.items():
            a.plot(p.time_s, p.heat.columns()[key] / unit, **style[name])
        a.set_ylabel(label)
        _shade(a, windows)
    peaks = [
        f"{name}  {_peak(p.heat.convected_W_m2 / 1e3)} kW/m2, {_peak(p.heat.heat_load_J_m2 / 1e6)} MJ/m2"
        for name, p in hottest.items()
    ]
    figure.legend(
        axes[0].lines[: len(peaks)],
        [legend_label(text) for text in peaks],
        loc="outside right center",
        ncols=_legend_columns(len(peaks)),
        title="peak of convected flux, heat load",
        **LEGEND_TEXT,
    )
    axes[2].axhline(0.0, color="0.3", linewidth=0.8)
    axes[-1].set_xlabel("time, s")
    _name_windows(axes[0], windows)
    figure.align_ylabels(axes)
    return save_figure(figure, path, f"{title}: heat at the surface", axes)


@replaced_if_undrawable
def draw_manoeuvre(
    path: Path | None,
    title: str,
    flown: Conditions,
    points: Sequence[PointHistory],
    window: Window,
    variable: str,
    moved: Conditions | None = None,
) -> Figure:
    """Thermocouple and surface temperatures about one manoeuvre; below, the angles that change.

    moved : angles and jets at the rate of the simulation, where that is finer than the samples

    As figures 5, 10 and 13 of the founding paper.
    """
    figure, axes = new_figure(8.0, 2.1 * len(points) + 3.2, len(points) + 1, sharex=True)
    shown = _about(flown, window)
    t = flown.time_s[shown]
    for a, point in zip(axes[:-1], points, strict=True):
        a.plot(t, point.surface_K[shown], **SURFACE)
        if len(point.sensors_K):
            a.plot(t, point.sensors_K[0][shown], **THERMOCOUPLE)
        a.set_ylabel(f"{point.name}\ntemperature, K")
    axes[0].legend(loc="best", fontsize=8)
    _plot_moving(axes[-1], flown if moved is None else moved, window, variable)
    axes[-1].set_xlabel("time, s")
    for a in axes:
        _shade(a, [window])
    figure.align_ylabels(axes)
    return save_figure(figure, path, f"{_manoeuvre_title(flown, window)}\n{title}", axes)


def _about(flown: Conditions, window: Window) -> np.ndarray:
    """(time,) which of the times are drawn about a manoeuvre."""
    return (flown.time_s >= window.start_s - BEFORE_S) & (flown.time_s <= window.end_s + AFTER_S)


def _plot_moving(axes: Axes, flown: Conditions, window: Window, variable: str) -> None:
    """Plot the manoeuvred variable, and dashed, on the right, the other angles that change."""
    shown = _about(flown, window)
    t = flown.time_s[shown]
    label, color = ANGLES.get(variable, ("reaction jets, 0 to 1", "tab:red"))
    lines = axes.plot(t, flown[variable][shown], color=color, linewidth=2.2, label=label)
    axes.set_ylabel(f"{label}{', deg' if variable in ANGLES else ''}", color=color)
    axes.tick_params(axis="y", colors=color)
    moving = [n for n in ANGLES if n != variable and np.ptp(flown[n][shown]) > DRAWN_CHANGE_DEG]
    if moving:
        other = axes.twinx()
        for name in moving:
            label, color = ANGLES[name]
            lines += other.plot(t, flown[name][shown], color=color, linewidth=1.1, linestyle="--", label=label)
        other.set_ylabel(f"{', '.join(ANGLES[name][0] for name in moving)}, deg (dashed)")
    axes.legend(handles=lines, loc="best", fontsize=8)


def _manoeuvre_title(flown: Conditions, window: Window) -> str:
    """Name and speed of a manoeuvre, with both definitions of Mach number."""
    begin = flown.at([window.start_s])
    V, mach = float(begin["velocity_m_s"][0]), float(begin["mach"][0])
    name = MANOEUVRE_NAMES.get(window.kind, window.kind)
    return f"{name[0].upper()}{name[1:]} at {V:.0f} m/s (Shuttle 'Mach' {V / SHUTTLE_MACH_M_S:.1f}, V/a {mach:.1f})"


@replaced_if_undrawable
def draw_comparison(
    path: Path | None,
    title: str,
    panels: Sequence[tuple[str, PointHistory, FloatArray, FloatArray, FloatArray, float]],
) -> Figure:
    """Predicted surface temperature against a measured history, one panel each.

    panels : (label, prediction, time_s, temperature_K, sigma_K, rmse_K)
    """
    columns = 2 if len(panels) > 1 else 1
    rows = -(-len(panels) // columns)
    figure, axes = new_figure(5.2 * columns, 3.5 * rows + 0.6, rows, columns, sharex=True, sharey=True, squeeze=False)
    for a, (label, point, time_s, temperature_K, sigma_K, rmse_K) in zip(axes.ravel(), panels, strict=False):
        low, high = temperature_K - 2 * sigma_K, temperature_K + 2 * sigma_K
        a.fill_between(time_s, low, high, color="0.82", linewidth=0, label="2 sigma of the digitised figure")
        a.plot(time_s, temperature_K, label="measured in flight", **MEASURED)
        a.plot(point.time_s, point.surface_K, color="tab:red", label="predicted, declared model")
        a.set_title(f"{label}: RMSE {rmse_K:.0f} K", fontsize=10)
    for a in axes.ravel()[len(panels) :]:
        a.set_visible(False)
    for a in axes[-1]:
        a.set_xlabel("time from entry interface, s")
    for a in axes[:, 0]:
        a.set_ylabel("surface temperature, K")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=9)
    return save_figure(figure, path, title, axes)


@replaced_if_undrawable
def draw_prediction(
    path: Path | None,
    title: str,
    time_s: FloatArray,
    names: Sequence[str],
    measured_K: FloatArray,
    predicted_K: FloatArray,
    band: Band | None = None,
) -> Figure:
    """Each sensor of a record, measured and predicted, with the residual below; the 95 % band where there is one."""
    figure, axes = new_figure(9.5, 7.0, 2, sharex=True, height_ratios=[2, 1])
    for i, name in enumerate(names):
        axes[0].plot(time_s, measured_K[i], ".", color=f"C{i}", markersize=2.5, alpha=0.5)
        axes[0].plot(time_s, predicted_K[i], color=f"C{i}", linewidth=1.2, label=legend_label(name))
        axes[1].plot(time_s, measured_K[i] - predicted_K[i], ".", color=f"C{i}", markersize=2.5)
        if band is not None:
            for a, centre in ((axes[0], 0.0), (axes[1], predicted_K[i])):
                ends = (band.low_K[2 + i] - centre, band.high_K[2 + i] - centre)
                a.fill_between(time_s, *ends, color=f"C{i}", alpha=0.18, linewidth=0)
    axes[0].set_ylabel("temperature at the sensor, K")
    shaded = "" if band is None else "\nshaded: 95 % band"
    axes[0].legend(title=f"line: predicted\ndots: measured{shaded}", fontsize=8, title_fontsize=8)
    axes[1].axhline(0.0, color="0.3", linewidth=0.8)
    axes[1].set_ylabel("measured - predicted, K")
    axes[1].set_xlabel("time, s")
    return save_figure(figure, path, title, axes)
