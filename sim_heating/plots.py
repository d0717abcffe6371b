"""Pictures of a flight and its temperatures; each function draws one file and shows nothing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from sim_heating.conditions import Conditions, FloatArray
from sim_heating.temperatures import PointHistory
from sim_heating.trajectory.flight import Window

DPI = 110
BEFORE_S, AFTER_S = 15.0, 25.0
"""How much of the flight around a manoeuvre is drawn."""
MEASURED = {"color": "0.35", "marker": "o", "markersize": 2.2, "linestyle": "none"}


def _figure(width: float, height: float, rows: int, columns: int = 1, **keys: object) -> tuple[Figure, np.ndarray]:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, np.atleast_1d(figure.subplots(rows, columns, **keys))


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=DPI)


def _shade(axes: Axes, windows: Sequence[Window]) -> None:
    for window in windows:
        axes.axvspan(window.start_s, window.end_s, color="tab:orange", alpha=0.18, linewidth=0)


def draw_trajectory(path: Path, title: str, flown: Conditions, windows: Sequence[Window]) -> None:
    """Altitude, velocity, angles and dynamic pressure against time, manoeuvres shaded."""
    figure, axes = _figure(9.0, 9.0, 4, sharex=True)
    t = flown.time_s
    axes[0].plot(t, flown["altitude_m"] / 1e3, color="tab:blue")
    axes[0].set_ylabel("altitude, km")
    twin = axes[0].twinx()
    twin.plot(t, flown["velocity_m_s"] / 1e3, color="tab:red")
    twin.set_ylabel("velocity, km/s", color="tab:red")
    for name, label in (("alpha_deg", "angle of attack"), ("beta_deg", "sideslip"), ("bank_deg", "bank")):
        if name in flown:
            target = axes[1] if name != "bank_deg" else axes[2]
            target.plot(t, flown[name], label=label)
    for name, label in (("elevon_deg", "elevon"), ("bodyflap_deg", "body flap")):
        axes[3].plot(t, flown[name], label=label)
    axes[1].set_ylabel("deg")
    axes[2].set_ylabel("deg")
    axes[3].set_ylabel("deg, trailing edge down +")
    for a in axes:
        _shade(a, windows)
        a.grid(alpha=0.3)
    for a in axes[1:]:
        if a.get_legend_handles_labels()[0]:
            a.legend(loc="best", fontsize=8)
    axes[-1].set_xlabel("time, s")
    figure.suptitle(f"{title}: trajectory" + (" (manoeuvres shaded)" if windows else ""))
    _save(figure, path)


def draw_temperatures(path: Path, title: str, points: Sequence[PointHistory], windows: Sequence[Window]) -> None:
    """Surface and bondline temperatures of all control points against time."""
    figure, axes = _figure(9.0, 8.0, 2, sharex=True)
    ordered = sorted(points, key=lambda p: -float(np.max(p.surface_K)))
    for i, point in enumerate(ordered):
        style = {"color": f"C{i % 10}", "linestyle": ("-", "--", ":")[i // 10 % 3], "linewidth": 1.3}
        axes[0].plot(point.time_s, point.surface_K, label=point.name, **style)
        axes[1].plot(point.time_s, point.bondline_K, **style)
    axes[0].set_ylabel("surface temperature, K")
    axes[1].set_ylabel("bondline temperature, K")
    axes[1].set_xlabel("time, s")
    for a in axes:
        _shade(a, windows)
        a.grid(alpha=0.3)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center", fontsize=8)
    figure.suptitle(title + (" (manoeuvres shaded)" if windows else ""))
    _save(figure, path)


def draw_manoeuvre(
    path: Path, title: str, flown: Conditions, points: Sequence[PointHistory], window: Window, variable: str
) -> None:
    """Surface and thermocouple temperatures above, the manoeuvred variable below, about one manoeuvre."""
    figure, axes = _figure(8.0, 2.2 * len(points) + 2.2, len(points) + 1, sharex=True)
    shown = (flown.time_s >= window.start_s - BEFORE_S) & (flown.time_s <= window.end_s + AFTER_S)
    t = flown.time_s[shown]
    for a, point in zip(axes[:-1], points, strict=True):
        a.plot(t, point.surface_K[shown], color="tab:red", label="surface")
        if len(point.sensors_K):
            a.plot(t, point.sensors_K[0][shown], color="0.2", marker=".", markersize=4, label="surface thermocouple")
        a.set_ylabel(f"{point.name}\ntemperature, K")
        a.legend(loc="best", fontsize=8)
    for name, label in ((variable, variable.replace("_deg", "")), ("alpha_deg", "alpha")):
        if name == variable or variable != "alpha_deg":
            axes[-1].plot(t, flown[name][shown], label=label)
    axes[-1].set_ylabel("deg")
    axes[-1].legend(loc="best", fontsize=8)
    axes[-1].set_xlabel("time, s")
    for a in axes:
        _shade(a, [window])
        a.grid(alpha=0.3)
    figure.suptitle(f"{title}: {window.kind}")
    _save(figure, path)


def draw_comparison(
    path: Path,
    title: str,
    panels: Sequence[tuple[str, PointHistory, FloatArray, FloatArray, FloatArray, float]],
) -> None:
    """Predicted surface temperature against a measured history, one panel each.

    panels : (label, prediction, time_s, temperature_K, sigma_K, rmse_K)
    """
    columns = 2 if len(panels) > 1 else 1
    rows = -(-len(panels) // columns)
    figure, axes = _figure(5.2 * columns, 3.6 * rows, rows, columns, sharex=True, sharey=True, squeeze=False)
    for a, (label, point, time_s, temperature_K, sigma_K, rmse_K) in zip(axes.ravel(), panels, strict=False):
        a.fill_between(time_s, temperature_K - 2 * sigma_K, temperature_K + 2 * sigma_K, color="0.85", linewidth=0)
        a.plot(time_s, temperature_K, label="measured (band: 2 sigma)", **MEASURED)
        a.plot(point.time_s, point.surface_K, color="tab:red", label="predicted, laminar tables")
        a.set_title(f"{label}: RMSE {rmse_K:.0f} K", fontsize=10)
        a.grid(alpha=0.3)
        a.legend(fontsize=8, loc="lower center")
    for a in axes.ravel()[len(panels) :]:
        a.set_visible(False)
    for a in axes[-1]:
        a.set_xlabel("time from entry interface, s")
    for a in axes[:, 0]:
        a.set_ylabel("surface temperature, K")
    figure.suptitle(title)
    _save(figure, path)


def draw_prediction(
    path: Path, title: str, time_s: FloatArray, names: Sequence[str], measured_K: FloatArray, predicted_K: FloatArray
) -> None:
    """Each sensor of a record, measured and predicted, with the residual below."""
    figure, axes = _figure(9.0, 7.0, 2, sharex=True, height_ratios=[2, 1])
    for i, name in enumerate(names):
        axes[0].plot(time_s, measured_K[i], ".", color=f"C{i}", markersize=2, alpha=0.6)
        axes[0].plot(time_s, predicted_K[i], color=f"C{i}", linewidth=1.2, label=name)
        axes[1].plot(time_s, measured_K[i] - predicted_K[i], color=f"C{i}", linewidth=0.8)
    axes[0].set_ylabel("temperature, K")
    axes[0].legend(title="line: predicted, dots: measured", fontsize=8, title_fontsize=8)
    axes[1].set_ylabel("measured - predicted, K")
    axes[1].set_xlabel("time, s")
    for a in axes:
        a.grid(alpha=0.3)
    figure.suptitle(title)
    _save(figure, path)
