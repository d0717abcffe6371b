"""Output files of a fit: estimate.json, temperatures and pictures; trend.csv of short segments."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.files import finite_or_none, output_directory, write_csv
from sim_heating.base.files.package import package_version
from sim_heating.base.report.table import Column, Table
from sim_heating.estimation.design.information import sensitivity_to_effort
from sim_heating.estimation.fit import FitResult, rms_normalised_residual
from sim_heating.estimation.inference import residual_tests
from sim_heating.estimation.inference.observability import fitted_rows
from sim_heating.estimation.report.estimate_file import (
    NAME,
    Estimate,
    FitErrors,
    ReferenceCondition,
    correlations,
    excursions,
    write_estimate,
)
from sim_heating.estimation.report.remarks import remarks, short_remarks
from sim_heating.estimation.trend import Trend
from sim_heating.inputs.record import Record, pooled_rmse_K, record_digest
from sim_heating.march.ensemble import condition_history
from sim_heating.simulation.predict import Prediction
from sim_heating.simulation.results import write_temperatures_csv


def _parameters(fitted: FitResult) -> dict[str, dict[str, Any]]:
    """Estimates with their standard deviations and priors, and the bounds that were stated, by label."""
    problem = fitted.problem
    stated = set(problem.owners.labels(problem.options.bounds or {}))
    white = np.sqrt(np.diag(fitted.bounds.white))
    entries = {}
    for u, value, sigma, w in zip(problem.unknowns, fitted.fit.values, fitted.bounds.sigma, white, strict=True):
        p = u.parameter
        entries[u.label] = {
            "value": float(value),
            "sigma": float(sigma),
            "unit": p.unit,
            "white_sigma": float(w),
            "prior_mean": float(p.value) if np.isfinite(p.sigma) else None,
            "prior_sigma": finite_or_none(p.sigma),
            **({"lower": p.lower, "upper": p.upper} if stated & {u.label, *u.tied} else {}),
        }
    return entries


def _predicted(fitted: FitResult) -> dict[str, Any] | None:
    """Errors before the fit; None where a record lacks a heating ratio."""
    if any(record_fit.record.lacks_ratio for record_fit in fitted.problem.record_fits):
        return None
    return {segments: _errors(fitted.before, segments) for segments in ("fit", "holdout")}


def _control_point(records: Sequence[Record]) -> str | None:
    """The control point of all records; None where they are of several."""
    points = {r.declared.control_point for r in records}
    return points.pop() if len(points) == 1 else None


def _digests(records: Sequence[Record]) -> dict[str, str]:
    return {str(r.directory): record_digest(r) for r in records if r.directory.is_dir()}


def _names_of_labelled(records: Sequence[Record]) -> list[str] | None:
    """Names of records of which one has a label, which its directory does not say; else None."""
    return [r.name for r in records] if any(r.label for r in records) else None


def estimate_contents(fitted: FitResult) -> Estimate:
    """The contents of estimate.json."""
    problem = fitted.problem
    records = [record_fit.record for record_fit in problem.record_fits]
    return Estimate.model_validate(
        {
            "format": "estimate/1",
            "records": [str(r.directory) for r in records],
            "converged": fitted.fit.converged,
            "iterations": fitted.fit.iterations,
            "reference_condition": ReferenceCondition(**dict(zip(RATIO_VARIABLES, problem.reference, strict=True))),
            "parameters": _parameters(fitted),
            "fixed": {n: {"value": v, "unit": unit} for n, (v, unit) in problem.fixed.items()},
            "ties": {label: u.label for u in problem.unknowns for label in u.tied},
            "not_estimated": fitted.not_estimated,
            "correlation": correlations(fitted.labels, fitted.bounds.covariance),
            "noise_floor_K": noise_floor_K(fitted),
            "fit": _errors(fitted.after, "fit"),
            "holdout": _errors(fitted.after, "holdout"),
            "predicted": _predicted(fitted),
            "samples": sample_counts(fitted),
            "profiles": {name: profile.as_json() for name, profile in fitted.profiles.items()},
            "outliers": [outlier.as_json() for outlier in fitted.outliers],
            "innovations": _innovations(fitted),
            "degrees_of_freedom": fitted.bounds.dof,
            "log_likelihood": fitted.fit.log_likelihood,
            "process_noise": _process_noise(fitted),
            "statistics": residual_statistics(fitted),
            "sensitivity_to_effort": _sensitivity_to_effort(fitted),
            "warnings": list(fitted.warnings),
            "control_point": _control_point(records),
            "vehicle": records[0].declared.vehicle,
            "segments": [_segments(r) for r in records],
            "starts": _starts(fitted),
            "excursions": excursions([condition_history(r.conditions)[fitted_rows(r), :5] for r in records]),
            "inputs": _digests(records),
            "effects": _effects(fitted),
            "program": f"sim-heating {package_version()}",
            "credibility": fitted.credibility.as_json(),
            "record_names": _names_of_labelled(records),
            "remarks": remarks(fitted),
            "model_error": _model_error(fitted),
        }
    )


def estimate_table(title: str, estimate: Estimate) -> Table:
    """Estimated parameters with their standard deviations, and priors and bounds where some have them, a row each."""
    columns = [
        Column("parameter"),
        Column("value", format=".5g"),
        Column("sigma", format=".2g"),
        Column("unit", is_text=True),
    ]
    rows: list[list[Any]] = [[name, p.value, p.sigma, p.unit] for name, p in estimate.parameters.items()]
    before = [p.known_before for p in estimate.parameters.values()]
    if any(before):
        columns.append(Column("prior, bounds", is_text=True))
        rows = [[*row, text] for row, text in zip(rows, before, strict=True)]
    remarked = [short_remarks(estimate.remarks, name) for name in estimate.parameters]
    if any(remarked):
        columns.append(Column("remark", is_text=True))
        rows = [[*row, text] for row, text in zip(rows, remarked, strict=True)]
    return Table(title, columns, rows)


def _effects(fitted: FitResult) -> list[dict[str, Any]]:
    """The effects of each control point's model at the values found."""
    models = {p.record.declared.control_point: p.model_at(fitted.fit.values) for p in fitted.problem.record_fits}
    return [
        {
            "name": used.effect.name,
            "parameters": {n: float(v) for n, v in used.by_name.items()},
            **({"control_point": point} if len(models) > 1 else {}),
        }
        for point, model in models.items()
        for used in model.effects
    ]


def _model_error(fitted: FitResult) -> dict[str, float] | None:
    """Size of the heating's error and its correlation time [s], in a fit with an error of its model."""
    errors = [r.model_error for r in fitted.problem.record_fits]
    first = next((e for e in errors if e is not None and not e.is_noise_alone), None)
    return None if first is None else {"relative": first.sigma, "correlation_s": first.correlation.time_s}


def _process_noise(fitted: FitResult) -> dict[str, Any] | None:
    """Levels of the process noise, and which of them were estimated; None in an output-error fit."""
    return None if fitted.innovations is None else asdict(fitted.innovations.levels.noise)


def _starts(fitted: FitResult) -> list[dict[str, Any] | None] | None:
    """Where the march of each record began, with the temperatures found; None where all began with the record."""
    starts: list[dict[str, Any] | None] = []
    for record_fit in fitted.problem.record_fits:
        initial_K = record_fit.initial_K(fitted.fit.values)
        profile = None if initial_K is None else np.column_stack([record_fit.mesh.depth_m, initial_K]).tolist()
        starts.append(None if profile is None else {"time_s": record_fit.begin_s, "profile": profile})
    return starts if any(starts) else None


def _segments(record: Record) -> list[list[float]]:
    """Fitted [start, end] times [s]."""
    return record.declared.segments.fit or [[float(record.time_s[0]), float(record.time_s[-1])]]


def _errors(predictions: tuple[Prediction, ...], segments: str) -> FitErrors | None:
    """Errors of the used sensors of all records over their fit or holdout segments."""
    residuals = []
    for p in predictions:
        used = [i for i, sensor in enumerate(p.record.sensors) if sensor.used]
        mask = p.record.fit_mask() if segments == "fit" else p.record.holdout_mask()
        residuals.append(p.residual_K[used][:, mask].ravel())
    pooled = pooled_rmse_K(np.concatenate(residuals))
    return None if pooled is None else FitErrors.model_validate(pooled)


def sample_counts(fitted: FitResult) -> dict[str, Any]:
    """Numbers of readings that were fitted, that are held out, and that were left out by the reason."""
    left_out: dict[str, int] = {}
    for record_fit in fitted.problem.record_fits:
        for reason, count in record_fit.left_out.items():
            left_out[reason] = left_out.get(reason, 0) + count
    if fitted.outliers:
        left_out["outliers"] = len(fitted.outliers)
    held_out = _errors(fitted.after, "holdout")
    count = sum(len(c.samples) for record_fit in fitted.problem.record_fits for c in record_fit.channels)
    return {"fit": count, "holdout": 0 if held_out is None else held_out.n, "left_out": left_out}


def _innovations(fitted: FitResult) -> dict[str, float] | None:
    """Errors of the filter's predictions [K], pooled over the fitted samples; None in an output-error fit."""
    if fitted.innovations is None:
        return None
    samples, residuals = fitted.samples(), []
    for s in samples:
        record = s.record_fit.record
        read_K = record.thermocouples[s.channel.sensor.column][np.searchsorted(record.time_s, s.time_s)]
        residuals.append(read_K - s.mean_K)
    pooled = pooled_rmse_K(np.concatenate(residuals))
    return None if pooled is None else {**pooled, "normalised_rms": rms_normalised_residual(samples)}


def _sensitivity_to_effort(fitted: FitResult) -> dict[str, dict[str, float]]:
    """Standard deviations of the derivatives with twice the excursions, and with twice as many samples."""
    factors = sensitivity_to_effort(fitted.labels, fitted.fit.information, fitted.fit.prior_information)
    now = dict(zip(fitted.labels, fitted.bounds.sigma, strict=True))
    return {n: {f"{k}_sigma": f * float(now[n]) for k, f in by_change.items()} for n, by_change in factors.items()}


def noise_floor_K(fitted: FitResult) -> float | None:
    """Noise floor of all fit segments [K], with the estimated noise of sensors that declare none."""
    total, count = 0.0, 0
    for record_fit in fitted.problem.record_fits:
        sigma = {c.sensor.name: record_fit.sigma_K[c.number] for c in record_fit.channels}
        n = sum(len(c.samples) for c in record_fit.channels)
        floor = record_fit.record.noise_floor_K(estimated_sigma_K=sigma)
        total, count = total + n * floor**2, count + n
    return float(np.sqrt(total / count)) if count and np.isfinite(total) else None


def sensor_residual_tests(fitted: FitResult) -> list[residual_tests.SensorResiduals]:
    """Normalised residuals of every fitted sensor, and their tests; the random draws are the same every time."""
    rng = np.random.default_rng(0)
    is_joint = len(fitted.problem.record_fits) > 1
    return [
        residual_tests.sensor_residuals(
            f"{s.record_fit.record.name}/{s.channel.sensor.name}" if is_joint else s.channel.sensor.name,
            s.time_s,
            s.channel.intervals,
            s.mean_K,
            s.spread_K,
            rng,
        )
        for s in fitted.samples()
    ]


def residual_statistics(fitted: FitResult) -> dict[str, Any]:
    """Chi-square of the fit, and by sensor: samples, assumed noise, normalised mean and RMS, whiteness, normality."""
    residuals = sensor_residual_tests(fitted)
    noise = [s.sigma_K for s in fitted.samples()]
    every = np.concatenate([r.residual for r in residuals])
    return {
        "chi_square": _test(residual_tests.chi_square(every, float(len(fitted.labels)))),
        "sensors": {
            r.name: {
                "n": r.n,
                "noise_sigma_K": sigma,
                "normalised_mean": r.mean,
                "normalised_rms": r.rms,
                "whiteness": _test(r.whiteness),
                "normality": _test(r.normality),
            }
            for r, sigma in zip(residuals, noise, strict=True)
        },
    }


def _test(test: residual_tests.HypothesisTest | None) -> dict[str, float] | None:
    return None if test is None else {"statistic": test.statistic, "dof": test.dof, "p_value": test.p_value}


TREND = TREND_CSV, TREND_PICTURE, TREND_PAGE = "trend.csv", "trend.png", "report.html"
FIT_FILES = TEMPERATURES, FIT_PICTURE, RATIO_PICTURE = "temperatures.csv", "fit.png", "ratio.png"
PROFILE_PICTURE = "profiles.png"
PAGE = "report.html"


def output_files(records: Sequence[Record], *, filtered: bool = False, profiles: bool = False) -> list[str]:
    """Names of all files that a fit of some records may write; `filtered` with process noise, `profiles` with these."""
    from sim_heating.estimation.report import filtered as filter_report

    folders = [""] if len(records) == 1 else [f"{record.name}/" for record in records]
    names = [*FIT_FILES, *(filter_report.FILES if filtered else ())]
    of_fit = [NAME, PAGE, *([PROFILE_PICTURE] if profiles else [])]
    return [*of_fit, *(f"{folder}{name}" for folder in folders for name in names)]


def write_trend(trend: Trend, out: Path) -> list[str]:
    """Write trend.csv, trend.png and report.html; returns the names of the files."""
    from sim_heating.base.report.page import write_page
    from sim_heating.estimation.report.page import trend_page
    from sim_heating.estimation.report.plots import draw_trend

    segments = trend.segments
    times = np.array([(s.start_s, s.end_s, float(s.samples)) for s in segments]).T
    conditions = np.array([s.condition for s in segments]).T[: len(RATIO_VARIABLES)]
    ratios = np.array([(s.ratio, s.sigma, s.declared, s.misfit) for s in segments]).T
    columns = {
        **dict(zip(("start_s", "end_s", "samples"), times, strict=True)),
        **dict(zip(RATIO_VARIABLES, conditions, strict=True)),
        **dict(zip(("ratio", "sigma", "declared_ratio", "misfit"), ratios, strict=True)),
        "correlation_before": _correlation_before(trend.covariance),
    }
    for k, name in enumerate(trend.names):
        columns[name] = np.array([s.values[k] for s in segments])
        columns[f"{name}.sigma"] = np.array([s.sigmas[k] for s in segments])
    with output_directory(out, "estimate", inputs=[trend.record.directory]) as folder:
        write_csv(folder / TREND_CSV, columns)
        draw_trend(folder / TREND_PICTURE, trend)
        write_page(folder / TREND_PAGE, lambda: trend_page(trend, folder / TREND_PICTURE))
        return sorted(p.name for p in folder.iterdir() if p.is_file())


def _correlation_before(covariance: FloatArray) -> FloatArray:
    """(segment,) correlation of the error of each ratio with that of the segment before it [-]; 0 for the first."""
    scale = np.sqrt(np.diag(covariance))
    before = np.diag(covariance, -1) / np.where(scale[1:] * scale[:-1] > 0.0, scale[1:] * scale[:-1], 1.0)
    return np.append(0.0, before)


def write_fit(fitted: FitResult, out: str | os.PathLike[str], *, page: bool = True) -> list[str]:
    """Write estimate.json, temperatures, pictures and report.html; returns the names of the files.

    page : whether report.html is written; the report of a closed loop shows its last fit
    """
    from sim_heating.base.report.page import write_page  # matplotlib is slow to import
    from sim_heating.estimation.report.filtered import PICTURE
    from sim_heating.estimation.report.page import estimate_page

    with output_directory(out, "estimate", inputs=[p.record.directory for p in fitted.after]) as folder:
        estimate = estimate_contents(fitted)
        write_fit_data(fitted, estimate, folder)
        if page:
            captions = {RATIO_PICTURE: "heating ratio, declared and fitted", PICTURE: "filtered temperatures"}
            folders = _record_folders(fitted, folder)
            pictures = [
                (f / name, f"{p.record.name}: {caption}.")
                for f, p in zip(folders, fitted.after, strict=True)
                for name, caption in captions.items()
            ]
            profiles = folder / PROFILE_PICTURE if fitted.profiles else None
            table, fits = estimate_table("", estimate), [f / FIT_PICTURE for f in folders]
            write_page(folder / PAGE, lambda: estimate_page(fitted, estimate, table, fits, pictures, profiles))
        return sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())


def write_fit_data(
    fitted: FitResult, estimate: Estimate, folder: Path, marches: Sequence[tuple[Prediction, Prediction]] = ()
) -> None:
    """Write the numbers and the pictures of a fit into an existing folder: estimate.json and temperatures.

    estimate : contents of estimate.json
    marches  : of each record, those of the fitted declared model and of the model found, which are shown in place of
               the fit's own
    """
    from sim_heating.estimation.report.filtered import filtered_history, write_filtered
    from sim_heating.estimation.report.plots import DECLARED, FITTED, draw_fit, draw_profiles  # matplotlib is slow
    from sim_heating.estimation.report.ratio_plot import draw_ratio

    write_estimate(folder / NAME, estimate)
    if fitted.profiles:
        sigmas = dict(zip(fitted.labels, fitted.bounds.sigma.tolist(), strict=True))
        draw_profiles(folder / PROFILE_PICTURE, list(fitted.profiles.values()), sigmas)
    shown, label = marches or list(zip(fitted.before, fitted.after, strict=True)), FITTED if marches else DECLARED
    parts = zip(fitted.problem.record_fits, shown, _record_folders(fitted, folder), strict=True)
    for record_fit, (before, march), record_folder in parts:
        record_folder.mkdir(exist_ok=True, parents=True)
        write_temperatures_csv(record_folder / TEMPERATURES, march.history.time_s, march.history, march.record.sensors)
        filtered = fitted.innovations is not None
        draw_fit(record_folder / FIT_PICTURE, before, march, label=label, filtered=filtered)
        draw_ratio(record_folder / RATIO_PICTURE, fitted, record_fit)
        if fitted.innovations is not None:
            write_filtered(record_folder, filtered_history(fitted.innovations, fitted.fit.values, record_fit))


def _record_folders(fitted: FitResult, folder: Path) -> list[Path]:
    """The folder of each record's files: that of the fit, or one below it where there are several."""
    return [folder if len(fitted.after) == 1 else folder / p.record.name for p in fitted.after]
