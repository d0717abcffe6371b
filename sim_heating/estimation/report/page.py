"""The page of a fit: parameters, errors, measured against predicted, and the tests of the residuals."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import starmap
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base.report.chart import Chart, Curve, Panel
from sim_heating.base.report.page import Page, SavedPicture, Section
from sim_heating.base.report.table import SORTABLE, Column, Table
from sim_heating.credibility.section import credibility_section
from sim_heating.estimation.fit import FitResult
from sim_heating.estimation.report.estimate_file import PAIR, Estimate, FitErrors
from sim_heating.estimation.report.plots import AFTER, BEFORE, fit_chart, ratio_limits
from sim_heating.estimation.report.ratio_plot import derivatives_about
from sim_heating.estimation.report.remarks import floor_in_words, further_warnings, samples_in_words
from sim_heating.estimation.trend import Trend
from sim_heating.simulation.report.charts import flown_panels

NOTABLE = 0.5
"""Magnitude of a correlation from which on it is listed."""


def estimate_page(
    fitted: FitResult,
    estimate: Estimate,
    parameters: Table,
    fit_pictures: Sequence[Path],
    pictures: Sequence[tuple[Path, str]],
    profiles: Path | None = None,
) -> Page:
    """The report of a fit as a page.

    parameters   : the table of the estimated parameters
    fit_pictures : of each record, the picture of its fit
    pictures     : further ones with their captions; files that do not exist are left out
    profiles     : that of the profiles of the likelihood
    """
    records = [p.record for p in fitted.after]
    titles = dict.fromkeys(r.declared.title or r.declared.control_point for r in records)
    subtitle = f"Record{'s' if len(records) > 1 else ''} {', '.join(r.name for r in records)}, {estimate.vehicle or ''}"
    sections = [
        _parameters_section(fitted, estimate, parameters),
        *_profiles_section(profiles),
        _errors_section(estimate),
        _comparison_section(fitted, fit_pictures),
        _residuals_section(estimate),
        *_pictures_section(pictures),
        credibility_section(fitted.credibility.as_json()),
    ]
    return Page(
        "; ".join(titles),
        subtitle.rstrip(", "),
        sections,
        _headline(fitted, estimate),
        further_warnings(fitted.warnings, estimate.remarks),
    )


def _headline(fitted: FitResult, estimate: Estimate) -> tuple[str, str]:
    """Whether the fit converged, and its errors."""
    count = f"{estimate.iterations} iteration{'s' if estimate.iterations != 1 else ''}"
    head = f"Converged after {count}" if estimate.converged else f"Not converged: {fitted.fit.status.value}"
    declared = _declared(estimate, "fit")
    before = "" if declared is None else f"{declared.rmse_K:.2f} K with the declared model, "
    after = "" if estimate.fit is None else f"RMSE over fitted data: {before}{estimate.fit.rmse_K:.2f} K fitted"
    floor = "" if estimate.noise_floor_K is None else f"; noise floor {floor_in_words(estimate)}"
    return head, f"{after}{floor}." if after else ""


def _declared(estimate: Estimate, segments: str) -> FitErrors | None:
    """Errors of the declared model over fit or holdout segments."""
    errors = ((estimate.model_extra or {}).get("predicted") or {}).get(segments)
    return None if errors is None else FitErrors.model_validate(errors, from_attributes=True)


def _parameters_section(fitted: FitResult, estimate: Estimate, parameters: Table) -> Section:
    about = derivatives_about(estimate.parameters, estimate.reference_condition.values())
    text = f"One standard deviation, corrected for coloured residuals. {about}".rstrip()
    points = [
        f"{n}: fixed at {p.value:g} {p.unit}".removesuffix(" 1")
        for n, p in estimate.fixed.items()
        if n not in estimate.not_estimated
    ]
    points += [f"{n}: tied to {other}" for n, other in estimate.ties.items() if n != other]
    points += [p.in_words() for p in fitted.profiles.values()]
    points += starmap("{}: not estimated, {}".format, estimate.not_estimated.items())
    points += [remark.in_words for remark in estimate.remarks]
    strongest = sorted(estimate.correlation.items(), key=lambda item: -abs(item[1]))
    rows = [[*pair.split(PAIR), rho] for pair, rho in strongest if abs(rho) >= NOTABLE]
    columns = [Column("parameter"), Column("and", is_text=True), Column("correlation", format="+.3f")]
    caption = f"Correlations of a magnitude of {NOTABLE:g} and more."
    notable = Table(caption, columns, rows, sortable=len(rows) > SORTABLE)
    return Section("Estimated parameters", [text], points, [parameters, notable] if rows else [parameters])


def _errors_section(estimate: Estimate) -> Section:
    rows: list[list[Any]] = []
    for label, errors in (
        ("declared model, fitted samples", _declared(estimate, "fit")),
        ("fitted model, fitted samples", estimate.fit),
        ("declared model, held out", _declared(estimate, "holdout")),
        ("fitted model, held out", estimate.holdout),
        ("predictions of the filter, which the fit minimised", estimate.innovations),
    ):
        if errors is not None:
            rows.append([label, errors.rmse_K, errors.max_abs_K, errors.n])
    columns = [
        Column(""),
        Column("RMSE", format=".2f", unit="K"),
        Column("largest", format=".1f", unit="K"),
        Column("samples", format=".0f"),
    ]
    caption = "Errors of the plain march, with no measurement assimilated; held-out samples entered no fit."
    samples = samples_in_words((estimate.model_extra or {}).get("samples", {}))
    caption += f" {samples[0].upper()}{samples[1:]}." if samples else ""
    return Section("Errors", tables=[Table(caption, columns, rows)])


def _comparison_section(fitted: FitResult, pictures: Sequence[Path]) -> Section:
    label = "fitted" if fitted.innovations is None else "fitted, plain march"
    charts = [
        fit_chart(after.record, [(before, BEFORE, "declared"), (after, AFTER, label)], SavedPicture(path))
        for before, after, path in zip(fitted.before, fitted.after, pictures, strict=True)
    ]
    return Section("Measured against predicted", charts=charts)


def _residuals_section(estimate: Estimate) -> Section:
    """Tests of the normalised residuals of each sensor."""
    sensors = (estimate.model_extra or {}).get("statistics", {}).get("sensors", {})
    rows = [
        [
            name,
            s["n"],
            s["noise_sigma_K"],
            s["normalised_mean"],
            s["normalised_rms"],
            *(None if s[test] is None else s[test]["p_value"] for test in ("whiteness", "normality")),
        ]
        for name, s in sensors.items()
    ]
    columns = [
        Column("sensor"),
        Column("samples", format=".0f"),
        Column("assumed noise", format=".2f", unit="K"),
        Column("mean", format="+.2f"),
        Column("RMS", format=".2f"),
        Column("whiteness, p", format=".2g"),
        Column("normality, p", format=".2g"),
    ]
    caption = "Residuals over their noise: for the true model the mean is 0, the RMS 1, and p-values are not small."
    return Section("Residuals", tables=[Table(caption, columns, rows, sortable=len(rows) > SORTABLE)])


def _profiles_section(picture: Path | None) -> list[Section]:
    """Profiles of the likelihood, where some were asked for."""
    if picture is None or not picture.is_file():
        return []
    caption = (
        "Twice the fall of the log likelihood along a parameter, the others refitted. Shaded: the 95 % interval; "
        "dashed: the parabola of its sigma."
    )
    return [Section("Profiles of the likelihood", pictures=[SavedPicture(picture, caption)])]


def _pictures_section(pictures: Sequence[tuple[Path, str]]) -> list[Section]:
    shown = [SavedPicture(path, caption) for path, caption in pictures if path.is_file()]
    return [Section("Heating ratio", pictures=shown)] if shown else []


def trend_page(trend: Trend, picture: Path) -> Page:
    """The report of consecutive segments as a page: the heating ratio of each, against time."""
    record, segments = trend.record, trend.segments
    middle = np.array([0.5 * (s.start_s + s.end_s) for s in segments])
    ratio, sigma, declared = np.array([[s.ratio, s.sigma, s.declared] for s in segments]).T.reshape(3, -1)
    curves = [Curve("segments", middle, ratio, AFTER, sigma=sigma)]
    if record.ratio_table is not None:
        curves.append(Curve("declared model, same conditions", middle, declared, BEFORE))
    chart = Chart(
        "Heating ratio",
        [Panel("heating ratio", curves, limits=ratio_limits(trend)), *flown_panels(record.conditions)],
        "The heating ratio of each segment at its middle; band: 2 sigma. The first view shows segments whose ratio is "
        "known to half of itself, triangles those beyond.",
        (float(segments[0].start_s), float(segments[-1].end_s)),
        picture=SavedPicture(picture),
    )
    rows = [[f"{s.start_s:g} to {s.end_s:g} s", s.samples, s.ratio, s.sigma, s.declared, s.misfit] for s in segments]
    columns = [
        Column("segment"),
        Column("samples"),
        Column("ratio", format=".5g"),
        Column("sigma", format=".2g"),
        Column("declared", format=".5g"),
        Column("misfit", format=".2f"),
    ]
    sections = [
        Section("Heating ratio", charts=[chart]),
        Section(
            "Segments",
            points=[f"left out: {line}" for line in trend.left_out],
            tables=[Table("", columns, rows, sortable=len(rows) > SORTABLE)],
        ),
    ]
    subtitle = f"Record {record.name}, control point {record.declared.control_point}: consecutive segments"
    return Page(record.declared.title or record.declared.control_point, subtitle, sections, warnings=trend.warnings)
