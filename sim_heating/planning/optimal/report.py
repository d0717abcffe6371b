"""An optimal entry as a part of a study.

Picture of optimal entries side by side: where they fly, how, and how hot it gets.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np

from sim_heating.base.errors import InputError
from sim_heating.base.files import write_csv
from sim_heating.base.progress import Progress
from sim_heating.base.report.figure import new_figure, save_figure
from sim_heating.base.report.table import Table
from sim_heating.planning.optimal.search import ROUNDS, OptimalEntry, fly_optimal
from sim_heating.planning.part import Engine, Found, Part, Picture
from sim_heating.planning.study import Study

PICTURE, CONDITIONS = "optimal_entry.png", "optimal_conditions.csv"


def optimal_part(study: Study, folder: Path, _engine: Engine, progress: Progress) -> Found:
    """Find the entry of largest cross-range that a study's [optimal] asks for.

    raises : RunError where no flight is found that keeps the limits
    """
    asked = study.optimal()
    if asked is None:
        raise InputError(f"{study.path}: has no [optimal]")
    done = [0]

    def told(line: str) -> None:
        done[0] += 1
        progress(done[0] / ROUNDS, f"round {done[0]}: {line}")

    entry = fly_optimal(asked, progress=told)
    draw_optimal(folder / PICTURE, f"{study.title}\n{study.stamp}", {"optimal": entry})
    write_csv(
        folder / CONDITIONS, entry.conditions.columns, ".10g", {"study": study.hash, "vehicle": study.vehicle.name}
    )
    tables = (Table("Peak temperatures along the optimal entry [K]", HEADS, _rows(entry)),) if entry.peaks else ()
    head = f"cross-range {entry.cross_range_deg:.3f} deg, {entry.cross_range_km:.0f} km; {entry.status}"
    picture = Picture(PICTURE, "The optimal entry: ground track, altitude, angles, temperatures; limits dotted.")
    return Found(_data(entry), tables, (picture,), (head, *entry.notes))


OPTIMAL = Part(optimal_part, lambda _: (PICTURE, CONDITIONS))
HEADS = ("control point", "surface", "limit", "bondline", "limit")


def _rows(entry: OptimalEntry) -> list[tuple[str, ...]]:
    return [
        (
            p.point, f"{p.surface_K:.0f}", f"{p.surface_limit_K:.0f}" if np.isfinite(p.surface_limit_K) else "-",
            f"{p.bondline_K:.0f}", "-" if p.bondline_limit_K is None else f"{p.bondline_limit_K:.0f}",
        )
        for p in entry.peaks
    ]  # fmt: skip


def _data(entry: OptimalEntry) -> dict[str, object]:
    finite = {"surface_limit_K"}
    return {
        "cross_range_deg": entry.cross_range_deg,
        "cross_range_km": entry.cross_range_km,
        "duration_s": float(entry.motion.duration_s),
        "status": entry.status,
        "held_back_by": entry.binding,
        "peaks": [
            {k: None if k in finite and not np.isfinite(v) else v for k, v in asdict(p).items()} for p in entry.peaks
        ],
        "notes": list(entry.notes),
    }


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
