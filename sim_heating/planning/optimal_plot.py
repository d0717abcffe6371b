"""Picture of optimal entries side by side: where they fly, how, and how hot it gets."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sim_heating.planning.optimal import OptimalEntry
from sim_heating.plots import new_figure, save_figure

STYLES = ("-", "--", ":")


def draw_optimal(path: Path, title: str, entries: Mapping[str, OptimalEntry]) -> None:
    """Ground track, altitude, alpha, bank, surface and bondline temperatures against time.

    entries : up to three, by their names in the legend; limits are dotted
    """
    figure, axes = new_figure(11.0, 10.5, 3, 2)
    insulated = {p.point.name for e in entries.values() for p in e.study.points if p.bondline_K is not None}
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
        for i, (history, peak) in enumerate(zip(entry.histories, entry.peaks, strict=True)):
            axes[2, 0].plot(
                history.time_s, history.surface_K, style, color=f"C{i}", label=history.name if style == "-" else None
            )
            if np.isfinite(peak.surface_limit_K):
                axes[2, 0].axhline(peak.surface_limit_K, color=f"C{i}", linewidth=0.8, linestyle=(0, (1, 2)))
            if history.name in insulated:
                axes[2, 1].plot(history.time_s, history.bondline_K, style, color=f"C{i}")
            if peak.bondline_limit_K is not None:
                axes[2, 1].axhline(peak.bondline_limit_K, color=f"C{i}", linewidth=0.8, linestyle=(0, (1, 2)))
    axes[0, 0].legend(fontsize=8)
    axes[2, 0].legend(fontsize=8)
    labels = ("latitude, deg", "altitude, km", "angle of attack, deg", "bank, deg", "surface, K", "bondline, K")
    for place, label in zip(axes.ravel(), labels, strict=True):
        place.set_ylabel(label)
        place.set_xlabel("time, s")
    axes[0, 0].set_xlabel("longitude, deg")
    end = max(float(e.conditions.time_s[-1]) for e in entries.values())
    for place in (axes[0, 1], axes[1, 0], axes[1, 1], axes[2, 0]):
        place.set_xlim(0.0, 1.02 * end)
    axes[2, 0].set_ylim(0.0, 1.1 * max(float(np.max(h.surface_K)) for e in entries.values() for h in e.histories))
    vehicle = next(iter(entries.values())).study.vehicle
    save_figure(figure, path, f"{title}\n{vehicle.name}, revision {vehicle.revision}", axes)
