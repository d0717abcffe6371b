"""The page of many closed loops: a table of all records that sorts and filters, and residuals side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.report.chart import Chart, Curve, Panel, Span, decimated
from sim_heating.base.report.page import Page, Section, write_page
from sim_heating.closure.report.record import closures_table
from sim_heating.closure.result import PAGE, Closure
from sim_heating.estimation.report.plots import AFTER, BEFORE
from sim_heating.simulation.report.charts import SHADES, record_spans, residual_limits, shown_span


def residual_history(closure: Closure) -> dict[str, Any]:
    """Residuals of a record's used sensors before and after, decimated, as plain values for `batch_page`."""
    intervals = 200  # of time, of each of which the least, the median and the greatest residual are kept
    record = closure.record
    curves = []
    stages = [("before", closure.before, BEFORE)] + ([("after", closure.after, AFTER)] if closure.added else [])
    for i, sensor in enumerate(record.sensors):
        if sensor.used:
            fitted = residual_limits(
                (closure.after if closure.added else closure.before).residual_K[i][record.fit_mask()]
            )
            for label, prediction, color in stages:
                kept = decimated(record.time_s, prediction.residual_K[i], intervals, middle=True)
                kept = kept[np.isfinite(prediction.residual_K[i][kept])]
                curves.append(
                    {
                        "sensor": sensor.name,
                        "label": label,
                        "color": color,
                        "limits": fitted,
                        "time_s": _rounded(record.time_s[kept], 3),
                        "residual_K": _rounded(prediction.residual_K[i][kept], 2),
                    }
                )
    spans = [[s.start_s, s.end_s, s.label, s.color] for s in record_spans(record)]
    return {"curves": curves, "view": shown_span(record), "spans": spans}


def _rounded(values: FloatArray, digits: int) -> list[float]:
    return [round(v, digits) for v in values.tolist()]


def write_batch_page(
    path: Path, rows: Sequence[Mapping[str, Any]], residuals: Sequence[Mapping[str, Any] | None]
) -> None:
    """Write the page of a batch; rows and residuals as its jobs give them, None for a record that failed."""
    write_page(path, lambda: batch_page(rows, residuals))


def batch_page(rows: Sequence[Mapping[str, Any]], residuals: Sequence[Mapping[str, Any] | None]) -> Page:
    """All records in a table, why some failed, and the residuals of those farthest above their noise floor."""
    most_charts = 12  # records whose residuals are drawn: those farthest above their noise floor
    pages = [None if "failed" in row else f"{row['record']}/{PAGE}" for row in rows]
    failed = [f"{row['record']}: {row['failed']}" for row in rows if "failed" in row]
    faults = [line for row in rows for line in row.get("fault_messages", ())]
    text = "The name of a record leads to its own page. Click the head of a column to sort by it."
    sections = [Section("Records", [text], points=faults, tables=[closures_table(rows, pages)])]
    sections += _residuals_side_by_side(rows, residuals, most_charts)
    count = f"{len(rows) - len(failed)} of {len(rows)} records are done." if failed else f"{len(rows)} records."
    return Page("Closed loops", count, sections, warnings=failed)


def _residuals_side_by_side(
    rows: Sequence[Mapping[str, Any]], residuals: Sequence[Mapping[str, Any] | None], most: int
) -> list[Section]:
    """The residuals of the records farthest above their noise; none where no record has curves."""
    curves = {i: kept for i, kept in enumerate(residuals) if kept is not None and kept["curves"]}
    worst = sorted(sorted(curves, key=lambda i: -_above_noise(rows[i]))[:most])
    if not worst:
        return []
    charts = [_chart(str(rows[i]["record"]), rows[i], curves[i]) for i in worst]
    which = f" of the {len(worst)} records of {len(curves)} farthest above their noise"
    text = (
        f"Measured minus predicted{which if len(worst) < len(curves) else ''}, by the least, the median and the "
        f"greatest value in short intervals of time; the page of a record has more. {SHADES}"
    )
    return [Section("Residuals side by side", [text], charts=charts)]


def _above_noise(row: Mapping[str, Any]) -> float:
    """RMSE over the fitted samples after, over the noise floor."""
    rmse, floor = row["after_fit_rmse_K"], row["noise_floor_K"]
    return rmse / floor if rmse and floor else 0.0


def _chart(name: str, row: Mapping[str, Any], kept: Mapping[str, Any]) -> Chart:
    panels: dict[str, list[Curve]] = {}
    limits = {}
    for c in kept["curves"]:
        curve = Curve(c["label"], np.array(c["time_s"]), np.array(c["residual_K"]), c["color"], points=True)
        panels.setdefault(c["sensor"], []).append(curve)
        limits[c["sensor"]] = tuple(c["limits"])
    shown = [Panel(f"{s}, residual, K", curves, 0.6, zero=True, limits=limits[s]) for s, curves in panels.items()]
    caption = f"{row['control_point']}: {row['finding']}{': ' + row['named'] if row['named'] else ''}."
    return Chart(name, shown, caption, tuple(kept["view"]), [Span(*s) for s in kept["spans"]])
