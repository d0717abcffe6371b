"""The optimal entry of a study as files, tables and a picture: ground track, controls, temperatures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from itertools import count
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from sim_heating.base.errors import InputError
from sim_heating.base.files import write_csv
from sim_heating.base.progress import Progress
from sim_heating.base.report.figure import new_figure, replaced_if_undrawable, save_figure
from sim_heating.base.report.table import Column, Table
from sim_heating.credibility.validation.own_cases import samples_of
from sim_heating.planning.optimal.search import ROUNDS, OptimalEntry, fly_optimal
from sim_heating.planning.part import Engine, PartPicture, PartResult, StudyPart
from sim_heating.planning.study import Study
from sim_heating.simulation.report.charts import temperature_chart, trajectory_chart

PICTURE, CONDITIONS = "optimal_entry.png", "optimal_conditions.csv"


def optimal_part(study: Study, folder: Path, _engine: Engine, progress: Progress) -> PartResult:
    """Find the entry of largest cross-range for a study's [optimal].

    raises : RunError where no flight is found that keeps the limits
    """
    optimal = study.optimal()
    if optimal is None:
        raise InputError(f"{study.path}: has no [optimal]")
    rounds = count(1)

    def report(line: str) -> None:
        number = next(rounds)
        progress(number / ROUNDS, f"round {number}: {line}")

    entry = fly_optimal(optimal, progress=report)
    draw_optimal(folder / PICTURE, f"{study.title}\n{study.stamp}", {"optimal": entry})
    write_csv(
        folder / CONDITIONS, entry.conditions.columns, ".10g", {"study": study.hash, "vehicle": study.vehicle.name}
    )
    tables = (_peak_table(entry),) if entry.peaks else ()
    head = f"cross-range {entry.cross_range_deg:.3f} deg, {entry.cross_range_km:.0f} km; {entry.status}"
    picture = PartPicture(PICTURE, "The optimal entry: ground track, altitude, angles, temperatures; limits dotted.")
    times = [h.time_s <= entry.conditions.time_s[-1] for h in entry.histories]
    samples = tuple(
        samples_of(entry.conditions.at(h.time_s[t]), h.surface_K[t])
        for h, t in zip(entry.histories, times, strict=True)
    )
    charts = [trajectory_chart(entry.conditions, [])]
    if entry.histories:
        limits = {p.point: {"surface_K": p.surface_limit_K, "bondline_K": p.bondline_limit_K} for p in entry.peaks}
        charts.insert(0, temperature_chart(entry.histories, [], limits))
    return PartResult(
        _data(entry),
        tables,
        (picture,),
        (head, *entry.notes),
        samples,
        ("optimal entry",),
        tuple(replace(chart, pictured=False) for chart in charts),
    )


OPTIMAL = StudyPart(optimal_part, lambda _: (PICTURE, CONDITIONS))


def _peak_table(entry: OptimalEntry) -> Table:
    heads = ("surface", "limit", "bondline", "limit")
    columns: list[Column | str] = ["control point", *(Column(head, format=".0f") for head in heads)]
    rows = [
        (
            p.point,
            p.surface_K,
            p.surface_limit_K if np.isfinite(p.surface_limit_K) else None,
            p.bondline_K,
            p.bondline_limit_K,
        )
        for p in entry.peaks
    ]
    return Table("Peak temperatures along the optimal entry [K]", columns, rows)


def _data(entry: OptimalEntry) -> dict[str, object]:
    return {
        "cross_range_deg": entry.cross_range_deg,
        "cross_range_km": entry.cross_range_km,
        "duration_s": float(entry.motion.duration_s),
        "status": entry.status,
        "active_limits": entry.active_limits,
        "peaks": [
            asdict(p) | {"surface_limit_K": p.surface_limit_K if np.isfinite(p.surface_limit_K) else None}
            for p in entry.peaks
        ],
        "flight_limits": [asdict(p) for p in entry.flight_peaks],
        "notes": list(entry.notes),
    }


STYLES = ("-", "--", ":")
"""Line styles of the entries in a picture."""


@replaced_if_undrawable
def draw_optimal(path: Path, title: str, entries: Mapping[str, OptimalEntry]) -> None:
    """Draw ground track, altitude, alpha and bank, and the temperatures of limited points, against time.

    entries : up to three, by their names in the legend; limits are dotted
    """
    hot = any(e.histories for e in entries.values())
    figure, axes = new_figure(11.0, 10.5 if hot else 7.0, 3 if hot else 2, 2)
    end = max(float(e.conditions.time_s[-1]) for e in entries.values())
    for (name, entry), style in zip(entries.items(), STYLES, strict=False):
        flown, t = entry.conditions, entry.conditions.time_s
        label = f"{name}: {entry.cross_range_deg:.2f} deg"
        axes[0, 0].plot(flown["longitude_deg"], flown["latitude_deg"], style, color="tab:blue", label=label)
        for panel, column, scale in (
            (axes[0, 1], "altitude_m", 1e-3),
            (axes[1, 0], "alpha_deg", 1.0),
            (axes[1, 1], "bank_deg", 1.0),
        ):
            panel.plot(t, flown[column] * scale, style, color="tab:blue")
    axes[0, 0].legend(fontsize=8)
    if hot:
        _draw_temperatures(axes[2], entries, 1.02 * end)
    labels = ("latitude, deg", "altitude, km", "angle of attack, deg", "bank, deg", "surface, K", "bondline, K")
    for panel, label in zip(axes.ravel(), labels, strict=False):
        panel.set_ylabel(label)
        panel.set_xlabel("time, s")
    axes[0, 0].set_xlabel("longitude, deg")
    for panel in (axes[0, 1], axes[1, 0], axes[1, 1]):
        panel.set_xlim(0.0, 1.02 * end)
    vehicle = next(iter(entries.values())).study.vehicle
    save_figure(figure, path, f"{title}\n{vehicle.name}, revision {vehicle.revision}", axes)


def _draw_limit(a: Axes, limit_K: float | None, color: str) -> None:
    if limit_K is not None and np.isfinite(limit_K):
        a.axhline(limit_K, color=color, linewidth=0.8, linestyle=(0, (1, 2)))


def _draw_temperatures(axes: np.ndarray, entries: Mapping[str, OptimalEntry], end_s: float) -> None:
    """Draw surfaces until the end of the flight, and limited bondlines until that of the soak."""
    surface, bondline = axes
    insulated = {p.point.name for e in entries.values() for p in e.study.points if p.bondline_K is not None}
    for entry, style in zip(entries.values(), STYLES, strict=False):
        for i, (history, peak) in enumerate(zip(entry.histories, entry.peaks, strict=True)):
            label = history.name if style == STYLES[0] else None
            surface.plot(history.time_s, history.surface_K, style, color=f"C{i}", label=label)
            _draw_limit(surface, peak.surface_limit_K, f"C{i}")
            if history.name in insulated:
                bondline.plot(history.time_s, history.bondline_K, style, color=f"C{i}")
            _draw_limit(bondline, peak.bondline_limit_K, f"C{i}")
    surface.legend(fontsize=8)
    surface.set_xlim(0.0, end_s)
    surface.set_ylim(0.0, 1.1 * max(float(np.max(h.surface_K)) for e in entries.values() for h in e.histories))
