"""Picture of optimal entries side by side: where they fly, how, and how hot it gets."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sim_heating.planning.optimal import OptimalEntry
from sim_heating.plots import new_figure, save_figure

STYLES = ("-", "--", ":")


def draw_optimal(path: Path, title: str, entries: Mapping[str, OptimalEntry]) -> None:
    """Ground track, altitude, alpha and bank, and where points are limited their temperatures, against time.

    entries : up to three, by their names in the legend; limits are dotted
    """
    hot = any(e.histories for e in entries.values())
    figure, axes = new_figure(11.0, 10.5 if hot else 7.0, 3 if hot else 2, 2)
    end = max(float(e.conditions.time_s[-1]) for e in entries.values())
    for (name, entry), style in zip(entries.items(), STYLES, strict=False):
        flown, t = entry.conditions, entry.conditions.time_s
        label = f"{name}: {entry.cross_range_deg:.2f} deg"
        axes[0, 0].plot(flown["longitude_deg"], flown["latitude_deg"], style, color="tab:blue", label=label)
        for place, column, scale in (
            (axes[0, 1], "altitude_m", 1e-3),
            (axes[1, 0], "alpha_deg", 1.0),
            (axes[1, 1], "bank_deg", 1.0),
        ):
            place.plot(t, flown[column] * scale, style, color="tab:blue")
    axes[0, 0].legend(fontsize=8)
    if hot:
        _draw_temperatures(axes[2], entries, 1.02 * end)
    labels = ("latitude, deg", "altitude, km", "angle of attack, deg", "bank, deg", "surface, K", "bondline, K")
    for place, label in zip(axes.ravel(), labels, strict=False):
        place.set_ylabel(label)
        place.set_xlabel("time, s")
    axes[0, 0].set_xlabel("longitude, deg")
    for place in (axes[0, 1], axes[1, 0], axes[1, 1]):
        place.set_xlim(0.0, 1.02 * end)
    vehicle = next(iter(entries.values())).study.vehicle
    save_figure(figure, path, f"{title}\n{vehicle.name}, revision {vehicle.revision}", axes)


def _draw_temperatures(axes: np.ndarray, entries: Mapping[str, OptimalEntry], end_s: float) -> None:
    """Surfaces until the end of the flight, bondlines of those that are limited until that of the soak."""
    surface, bondline = axes
    insulated = {p.point.name for e in entries.values() for p in e.study.points if p.bondline_K is not None}
    for entry, style in zip(entries.values(), STYLES, strict=False):
        for i, (history, peak) in enumerate(zip(entry.histories, entry.peaks, strict=True)):
            label = history.name if style == STYLES[0] else None
            surface.plot(history.time_s, history.surface_K, style, color=f"C{i}", label=label)
            if np.isfinite(peak.surface_limit_K):
                surface.axhline(peak.surface_limit_K, color=f"C{i}", linewidth=0.8, linestyle=(0, (1, 2)))
            if history.name in insulated:
                bondline.plot(history.time_s, history.bondline_K, style, color=f"C{i}")
            if peak.bondline_limit_K is not None:
                bondline.axhline(peak.bondline_limit_K, color=f"C{i}", linewidth=0.8, linestyle=(0, (1, 2)))
    surface.legend(fontsize=8)
    surface.set_xlim(0.0, end_s)
    surface.set_ylim(0.0, 1.1 * max(float(np.max(h.surface_K)) for e in entries.values() for h in e.histories))
