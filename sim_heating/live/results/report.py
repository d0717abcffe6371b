"""The report of a link that has ended as a page: what came, what was estimated, what was taken out, what is missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import starmap
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.report.chart import COLORS, Chart, Curve, Panel, Span
from sim_heating.base.report.page import Page, Section
from sim_heating.base.report.table import Column, Table
from sim_heating.credibility.section import credibility_section
from sim_heating.live.engine import LinkEngine
from sim_heating.live.state import PointState, State

MEASURED, SURFACE, BONDLINE, ESTIMATED, DECLARED = "0.35", COLORS[1], COLORS[0], COLORS[0], COLORS[7]
MOST_REMARKS = 40
"""Remarks on the page; live.json has all."""
BIN_DEG = 0.1
"""Angles of attack of which the latest estimate of the heating ratio is shown [deg]."""


def live_page(engine: LinkEngine, state: State, credibility: Mapping[str, Any] | None) -> Page:
    """The report of a link.

    engine      : that followed it, with what it kept;  state : the last one
    credibility : what supports the estimates, as live.json has it; None where it could not be stated
    """
    warnings = [removal.text for removal in state.removed]
    remarks = [line for line in engine.remarks.lines() if line not in warnings]
    sections = [_estimates(state)] if state.points else []
    for name, point in state.points.items():
        sections.append(_point(engine, name, point))
    sections.append(_came(engine, state))
    if remarks:
        unlisted = len(remarks) - MOST_REMARKS
        text = [f"{unlisted} more are in live.json."] if unlisted > 0 else []
        sections.append(Section("Remarks", text, points=remarks[:MOST_REMARKS]))
    if credibility is not None:
        sections.append(credibility_section(credibility))
    when = "no estimate" if state.time_s is None else f"up to {state.time_s:.1f} s of flight"
    count = len(engine.link.names)
    subtitle = f"Link, {count} control point{'s' * (count != 1)}, {when}"
    return Page(engine.link.title, subtitle, sections, _outcome(state), warnings)


def _outcome(state: State) -> tuple[str, str]:
    """Whether something is missing."""
    text = state.missing.text
    sentence = f"{text[0].upper()}{text[1:]}."
    if not state.missing.alarm:
        return "No alarm", sentence
    return "Readings and model disagree", sentence


def _estimates(state: State) -> Section:
    bounds = [
        (name, p.surface_K, p.surface_sigma_K, p.bondline_K, p.bondline_sigma_K, p.margin_K)
        for name, p in state.points.items()
    ]
    kelvin = [Column(head, format=".1f", unit="K") for head in ("surface", "sigma", "bondline", "sigma", "margin")]
    fitted = [
        (name, label, parameter.value, parameter.sigma, parameter.unit)
        for name, p in state.points.items()
        for label, parameter in p.parameters.items()
    ]
    columns = [
        Column("control point"),
        Column("parameter", is_text=True),
        Column("estimate", format=".4g"),
        Column("sigma", format=".2g"),
        Column("unit", is_text=True),
    ]
    tables = [
        Table("Temperatures at the end", [Column("control point"), *kelvin], bounds),
        Table("Parameters at the end, with all readings", columns, fitted),
    ]
    return Section("Estimates", tables=tables)


def _failed_spans(engine: LinkEngine, point: str) -> list[Span]:
    """Times in which sensors of a point were wrong."""
    failures = [f for f in engine.checks.failures if f.point == point]
    return [Span(f.wrong_s, engine.estimator.time_s or f.found_s, f"{f.sensor}: {f.why}") for f in failures]


def _point(engine: LinkEngine, name: str, point: PointState) -> Section:
    """Time histories of a control point, and its heating ratio against the angle of attack."""
    readings = {k: _increasing(v) for k, v in engine.followed.readings(name).items()}
    history = _increasing(engine.followed.estimates(name))
    charts = []
    if history or readings:
        spans = _failed_spans(engine, name)
        panels = sum(starmap(_sensor_panels, readings.items()), start=_wall_panels(history))
        caption = (
            f"{name}: estimates as they were during the flight, bands of 2 sigma. Readings, and what was expected "
            "of each before it was taken. Shaded: a sensor that failed."
        )
        charts.append(Chart(f"{name}, histories", panels, caption, spans=spans))
    if history and np.any(np.isfinite(history["ratio"]) & np.isfinite(history["alpha_deg"])):
        charts.append(_ratio_chart(name, history))
    text = [] if charts else ["Nothing was read or estimated here."]
    out = [f"{sensor}: {sensor_state.why}" for sensor, sensor_state in point.sensors.items() if not sensor_state.used]
    return Section(name, [*text, *out], charts=charts)


def _wall_panels(history: Mapping[str, FloatArray]) -> list[Panel]:
    if not history:
        return []
    t = history["time_s"]
    return [
        Panel(
            f"{surface}, K",
            [Curve(surface, t, history[f"{surface}_K"], color, sigma=history[f"{surface}_sigma_K"])],
            height,
        )
        for surface, color, height in (("surface", SURFACE, 1.0), ("bondline", BONDLINE, 0.7))
    ]


def _sensor_panels(name: str, read: Mapping[str, FloatArray]) -> list[Panel]:
    t, residual = read["time_s"], read["read_K"] - read["expected_K"]
    curves = [
        Curve("measured", t, read["read_K"], MEASURED, points=True),
        Curve("expected", t, read["expected_K"], ESTIMATED, sigma=read["sigma_K"]),
    ]
    off = Curve("measured minus expected over sigma", t, residual / read["sigma_K"], ESTIMATED, points=True)
    return [Panel(f"{name}, K", curves), Panel("sigmas", [off], 0.5, zero=True)]


def _ratio_chart(name: str, history: Mapping[str, FloatArray]) -> Chart:
    """The latest estimate at each angle of attack, and the declared ratio as it was flown."""
    is_finite = np.flatnonzero(np.isfinite(history["ratio"]) & np.isfinite(history["alpha_deg"]))
    bins = {round(float(history["alpha_deg"][k]) / BIN_DEG): int(k) for k in is_finite}
    order = np.array(sorted(bins.values(), key=lambda k: float(history["alpha_deg"][k])))
    alpha = history["alpha_deg"][order]
    curves = [
        Curve("declared, as flown", alpha, history["ratio_declared"][order], DECLARED, points=True),
        Curve("estimate", alpha, history["ratio"][order], ESTIMATED, points=True, sigma=history["ratio_sigma"][order]),
    ]
    caption = f"{name}: the latest estimate at each angle of attack with 2 sigma, and the declared ratio."
    return Chart(f"{name}, heating ratio", [Panel("heating ratio", curves)], caption, time="angle of attack, deg")


def _increasing(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Columns whose times increase: of a clock that went back, what it had counted before is dropped."""
    if not columns:
        return {}
    t = columns["time_s"]
    later = np.minimum.accumulate(t[::-1])[::-1]
    kept = np.append(t[:-1] < later[1:], True) if len(t) else np.zeros(0, dtype=bool)
    return {name: values[kept] for name, values in columns.items()}


def _came(engine: LinkEngine, state: State) -> Section:
    counts, health = engine.counts, state.link
    rows: Sequence[tuple[str, int]] = [
        *((name, counts[name]) for name in ("messages", "frames", "readings")),
        ("readings lost", health.lost),
        ("late, put where they belong", health.late),
        ("too late, not used", health.too_late),
        ("doubled", health.doubled),
        ("damaged", health.damaged),
        ("clock jumps", health.jumps),
    ]
    return Section("What came", tables=[Table("", [Column("what"), Column("number", format=".0f")], rows)])
