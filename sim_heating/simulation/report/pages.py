"""Pages of flights and of predictions along flight records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.report.chart import COLORS, Chart, Curve, Panel, distinct_styles
from sim_heating.base.report.figure import MANOEUVRE_NAMES
from sim_heating.base.report.page import Page, SavedPicture, Section
from sim_heating.base.report.table import SORTABLE, Column, Table
from sim_heating.credibility.section import credibility_section
from sim_heating.inputs.record import Record
from sim_heating.march.history import PointHistory, range_lines, rising_bondlines
from sim_heating.simulation.report import charts
from sim_heating.trajectory.flight import Window

PREDICTED = "tab:blue"
FLUXES = {
    "convected_W_m2": "convected",
    "radiated_W_m2": "radiated",
    "conducted_W_m2": "conducted",
    "added_W_m2": "absorbed from the lamp or the sun",
}
"""Heat fluxes of a wall's surface, and their names."""


@dataclass(frozen=True)
class RunPictures:
    """Pictures of a run that stand in place of its charts, and those of its manoeuvres."""

    trajectory: Path
    temperatures: Path
    heating: Path
    compared: Path
    manoeuvres: Sequence[Path] = ()


@dataclass(frozen=True, eq=False)
class MeasuredCurve:
    """A measured history of a control point, with its residual [K] and its RMSE [K]."""

    label: str
    history: PointHistory
    time_s: FloatArray
    temperature_K: FloatArray
    residual_K: FloatArray
    rmse_K: float


def run_page(
    summary: Mapping[str, Any],
    peaks: Table,
    flown: Conditions,
    points: Sequence[PointHistory],
    windows: Sequence[Window],
    limits: Mapping[str, Mapping[str, float | None]],
    compared: Sequence[MeasuredCurve],
    pictures: RunPictures,
) -> Page:
    """The report of a flown scenario as a page.

    summary : contents of summary.json;  peaks : peak temperatures, a row a control point
    """
    end = summary["end"]
    subtitle = (
        f"{summary['vehicle']}, revision {summary['revision']}; {summary['duration_s']:.0f} s, "
        f"to {end['altitude_m'] / 1e3:.1f} km at Mach {end['mach']:.1f}"
    )
    margins = [k for k, column in enumerate(peaks.layout) if column.head == "margin"]
    beyond = [i for i, row in enumerate(peaks.rows) if any((row[k] or 0.0) < 0.0 for k in margins)]
    captions = ["Bold: a limit is exceeded."] if beyond else []
    if any("band" in point for point in summary["control_points"].values()):
        captions.append("Margin at the band: of the upper end of the 95 % band; below 0 where that exceeds the limit.")
    table = replace(peaks, title=" ".join(captions), strong=beyond, sortable=_long(peaks))
    temperatures = charts.temperature_chart(points, windows, limits, SavedPicture(pictures.temperatures))
    lines = [*range_lines(summary["control_points"]), *rising_bondlines(summary["control_points"])]
    sections = [
        Section("Peak temperatures", points=lines, tables=[table]),
        Section("Temperatures", charts=[temperatures]),
        *_compared_section(compared, pictures.compared),
        Section("Heat at the surface", charts=[charts.heat_chart(points, windows, SavedPicture(pictures.heating))]),
        Section("Trajectory", charts=[charts.trajectory_chart(flown, windows, SavedPicture(pictures.trajectory))]),
        *_manoeuvres_section(windows, pictures.manoeuvres),
        _events_section(summary),
        credibility_section(summary["credibility"]),
    ]
    return Page(summary["scenario"], subtitle, sections, warnings=list(filter(None, [summary["beyond_reference"]])))


def _long(table: Table) -> bool:
    return len(table.rows) > SORTABLE


def _compared_section(compared: Sequence[MeasuredCurve], picture: Path) -> list[Section]:
    """Measured histories and the predictions of their points, residuals below."""
    if not compared:
        return []
    panels = []
    for c in compared:
        inside = (c.history.time_s >= c.time_s[0]) & (c.history.time_s <= c.time_s[-1])
        predicted = Curve("predicted", c.history.time_s[inside], c.history.surface_K[inside], COLORS[1])
        measured = Curve("measured", c.time_s, c.temperature_K, charts.MEASURED, points=True)
        panels.append(Panel(f"{c.label}, surface (RMSE {c.rmse_K:.0f} K), K", [measured, predicted]))
        residual = [Curve("measured minus predicted", c.time_s, c.residual_K, charts.MEASURED, points=True)]
        panels.append(Panel("measured minus predicted, K", residual, 0.5, zero=True))
    caption = "Measured histories and the prediction of the declared model at the surface."
    chart = Chart("Measured and predicted", panels, caption, picture=SavedPicture(picture))
    return [Section("Measured against predicted", charts=[chart])]


def _manoeuvres_section(windows: Sequence[Window], pictures: Sequence[Path]) -> list[Section]:
    if not windows:
        return []
    rows = [[MANOEUVRE_NAMES.get(w.kind, w.kind), w.start_s, w.end_s] for w in windows]
    columns = [Column("manoeuvre"), Column("start", format=".1f", unit="s"), Column("end", format=".1f", unit="s")]
    shown = [
        SavedPicture(path, f"{MANOEUVRE_NAMES.get(w.kind, w.kind)} at {w.start_s:.0f} s: the points that respond most.")
        for w, path in zip(windows, pictures, strict=True)
    ]
    return [Section("Manoeuvres", tables=[Table("", columns, rows)], pictures=shown)]


def _events_section(summary: Mapping[str, Any]) -> Section:
    rows = [[e["what"], e["time_s"]] for e in summary["events"]]
    columns = [Column("event"), Column("time", format=".1f", unit="s")]
    return Section("Events", tables=[Table("", columns, rows, sortable=len(rows) > SORTABLE)])


def prediction_page(
    summary: Mapping[str, Any], record: Record, history: PointHistory, predicted: charts.ModelCurve, picture: Path
) -> Page:
    """The report of a prediction along a flight record as a page.

    summary   : contents of summary.json;  history : at the samples of the record
    predicted : indications of the sensors;  picture : of both, in place of the chart
    """
    kind = "measured" if record.declared.measured else "synthetic"
    subtitle = f"Record {record.name}, control point {record.declared.control_point}, {kind} data; nothing fitted"
    warnings = [*range_lines({record.name: summary}), *filter(None, [summary["beyond_reference"]])]
    sections = [
        _prediction_errors(summary),
        Section("Measured against predicted", charts=[charts.record_chart(record, [predicted], SavedPicture(picture))]),
        Section("Wall", charts=[_wall_chart(history, record)]),
        credibility_section(summary["credibility"]),
    ]
    return Page(record.declared.title or record.declared.control_point, subtitle, sections, _outcome(summary), warnings)


def _outcome(summary: Mapping[str, Any]) -> tuple[str, str]:
    """RMSE over the fit segments, and over those held out; with a band the share of readings within it."""
    fit, holdout, floor = summary["fit"], summary["holdout"], summary["noise_floor_K"]
    head = "No sample in the fit segments" if fit is None else f"RMSE {fit['rmse_K']:.2f} K"
    parts = [] if holdout is None else [f"held out {holdout['rmse_K']:.2f} K"]
    parts += [] if floor is None else [f"noise floor {floor:.2f} K"]
    within = summary.get("band", {}).get("within")
    parts += [] if within is None else [f"{within:.0%} of the readings within the 95 % band"]
    line = "; ".join(parts)
    return head, f"{line[0].upper()}{line[1:]}." if line else ""


def _prediction_errors(summary: Mapping[str, Any]) -> Section:
    errors = {"fit segments": summary["fit"], "held out": summary["holdout"]}
    errors |= {f"sensor {name}, fit segments": e for name, e in summary["sensors"].items()}
    rows = [[name, e["rmse_K"], e["max_abs_K"], e["n"]] for name, e in errors.items() if e is not None]
    columns = [
        Column(""),
        Column("RMSE", format=".2f", unit="K"),
        Column("largest", format=".1f", unit="K"),
        Column("samples", format=".0f"),
    ]
    caption = "Measured minus predicted; sensors that are not used are in their own rows alone."
    return Section("Errors", tables=[Table(caption, columns, rows, sortable=len(rows) > SORTABLE)])


def _wall_chart(history: PointHistory, record: Record) -> Chart:
    """Temperatures of the wall, heat fluxes at its surface, and the heating ratio."""
    t, surface, bondline = history.time_s, distinct_styles(2)[1], distinct_styles(2)[0]
    temperatures = [Curve("surface", t, history.surface_K, **surface)]
    if record.construction.stack.bondline_m > 0.0:  # a wall of one layer is bonded to nothing
        temperatures.append(Curve("bondline", t, history.bondline_K, **bondline))
    fluxes, styles = history.heat.columns(), dict(zip(FLUXES, distinct_styles(len(FLUXES)), strict=True))
    has_flow = bool(np.any(np.nan_to_num(history.ratio)))
    acting = {"convected_W_m2": has_flow, "added_W_m2": bool(np.any(fluxes["added_W_m2"]))}
    flux = [Curve(label, t, fluxes[key] / 1e3, **styles[key]) for key, label in FLUXES.items() if acting.get(key, True)]
    panels = [
        Panel("temperature, K", temperatures),
        Panel("heat flux, kW/m2", flux, 0.8, zero=True),
    ]
    if has_flow:
        panels.append(Panel("heating ratio", [Curve("heating ratio", t, history.ratio, COLORS[0])], 0.6))
    return Chart("Wall", panels, "Predicted temperatures of the wall and the heat at its surface.")


def predictions_page(table: Table, curves: Sequence[tuple[Record, charts.ModelCurve]]) -> Page:
    """The page of predictions along several records: their errors, and residuals side by side."""
    pages = [f"{record.name}/report.html" for record, _ in curves]
    fleet = replace(table, sortable=True, links=pages)
    shown = [charts.record_chart(record, [curve], temperatures=False) for record, curve in curves]
    text = "The name of a record leads to its own page. Click the head of a column to sort by it."
    sections = [Section("Records", [text], tables=[fleet]), Section("Residuals side by side", charts=shown)]
    return Page("Predictions", f"{len(curves)} records, declared models, nothing fitted", sections)


def records_page(title: str, records: Mapping[str, Record], windows: Sequence[Window]) -> Page:
    """The page of synthetic flight records: readings of all sensors, and the flight."""
    rows = [
        [name, len(r.sensors), int(np.sum(np.isfinite(r.temperatures_K()))), float(np.nanmax(r.temperatures_K()))]
        for name, r in records.items()
    ]
    columns = [
        Column("record"),
        Column("sensors"),
        Column("readings"),
        Column("highest reading", format=".0f", unit="K"),
    ]
    panels = []
    for name, r in records.items():
        styles = distinct_styles(len(r.sensors))
        read = [
            Curve(s.name, r.time_s, values, style["color"], points=True)
            for s, values, style in zip(r.sensors, r.temperatures_K(), styles, strict=True)
        ]
        panels.append(Panel(f"{name}, readings, K", read, 0.7))
    chart = Chart(
        "Readings", panels, "Readings of the thermocouples. Shaded: manoeuvres.", spans=charts.window_spans(windows)
    )
    flown = next(iter(records.values())).conditions
    sections = [
        Section("Records", tables=[Table("", columns, rows, sortable=len(rows) > SORTABLE)]),
        Section("Readings", charts=[chart]),
        Section("Flight", charts=[charts.trajectory_chart(flown, windows)]),
    ]
    return Page(title, f"{len(records)} flight record{'s' if len(records) > 1 else ''}, synthetic", sections)
