"""Fits of manoeuvres, each flight by itself and all flights of one manoeuvre together, as jobs that can be resumed."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base.files import results_digest
from sim_heating.base.parallel.batches import Job
from sim_heating.base.parameters import AT
from sim_heating.campaign.carried import Estimate, effect_uses
from sim_heating.campaign.flights import CampaignFlight, Manoeuvre
from sim_heating.campaign.spec import ManoeuvreSettings
from sim_heating.closure.batch import program_digest
from sim_heating.credibility.facts.of_records import MODEL_ERROR_RATIO
from sim_heating.estimation.fit import DEFAULT, FitResult, estimate, rms_normalised_residual
from sim_heating.estimation.inference.newton import NewtonSettings
from sim_heating.estimation.record_fit import StartMaker
from sim_heating.estimation.report.report import estimate_contents, write_fit
from sim_heating.estimation.starts import start_at
from sim_heating.estimation.trend import LOST_INTERVALS
from sim_heating.inputs.record import Record, load_records, record_digest

READINGS_BEFORE = 3
"""Readings of every thermocouple before a start that is made from them."""
LOST = "lost"
"""Start of a fit before which the readings were lost."""


@dataclass(frozen=True)
class FitTask:
    """One fit of a manoeuvre; picklable.

    group    : name of the manoeuvres that it is compared with
    records  : directories, one a flight
    segments : fitted [start, end] of each record [s]
    starts   : kind of start of each record, `declared` or one of estimation.starts.STARTS
    settings : what is estimated, and what is known before, as data of a ManoeuvreSettings
    reference: condition that derivatives are about, by variable ([deg], [-])
    carried  : dotted name -> value and standard deviation of the parameters that closing the loop found
    """

    point: str
    manoeuvre: str
    group: str
    flights: tuple[str, ...]
    records: tuple[str, ...]
    segments: tuple[tuple[float, float], ...]
    out: str
    starts: tuple[str, ...]
    settings: Mapping[str, Any]
    reference: Mapping[str, float]
    carried: Mapping[str, Estimate] = field(default_factory=dict)
    root: Path | None = None


@dataclass(frozen=True)
class FittedSpan:
    """Fitted times of a manoeuvre [s], and the kind of the start."""

    begin_s: float
    end_s: float
    start: str


def fitted_span(
    flight: CampaignFlight, record: Record, manoeuvre: Manoeuvre, settings: ManoeuvreSettings
) -> FittedSpan | str:
    """What is fitted of a manoeuvre, half way to its neighbours at most; where that is impossible, why.

    Where the readings before the start are lost, the fit starts with the first one after it, temperatures unknown.
    """
    assert settings.before_s is not None
    assert settings.after_s is not None
    begin, end = manoeuvre.start_s - settings.before_s, manoeuvre.end_s + settings.after_s
    for other in flight.manoeuvres:
        # samples of two fits would count twice in the tables
        if other.end_s <= manoeuvre.start_s:
            begin = max(begin, 0.5 * (other.end_s + manoeuvre.start_s))
        elif other.start_s >= manoeuvre.end_s:
            end = min(end, np.nextafter(0.5 * (manoeuvre.end_s + other.start_s), begin))
    start: str = settings.start or "declared"
    read_s = record.time_s[record.read_mask]
    if start != "declared" and not _read_before(record, begin):
        start, begin = LOST, float(read_s[read_s >= begin].min(initial=np.inf))
    if begin >= manoeuvre.end_s:
        return "there are no readings before the end of the manoeuvre"
    return FittedSpan(float(begin), float(end), start)


def _read_before(record: Record, time_s: float) -> bool:
    """Whether every used thermocouple was read shortly before a time, so that a start can be made from its readings."""
    read = np.isfinite(record.temperatures_K(record.used_sensors)) & (record.time_s <= time_s)
    interval_s = float(np.median(np.diff(record.time_s))) if len(record.time_s) > 1 else 0.0
    longest_s = (LOST_INTERVALS + READINGS_BEFORE) * interval_s
    return all(
        np.count_nonzero(row) >= READINGS_BEFORE and time_s - record.time_s[row][-READINGS_BEFORE] <= longest_s
        for row in read
    )


def fit_job(task: FitTask, records: Sequence[Record]) -> Job:
    """The job of a fit; its name depends on everything that its result depends on."""
    settings = json.dumps({k: v for k, v in asdict(task).items() if k not in ("out", "records")}, default=str)
    digest = program_digest([record_digest(record) for record in records], [settings])
    return Job(f"{task.point}-{task.manoeuvre}-{digest[:16]}.json", task)


def run_fit(task: FitTask) -> bytes:
    """Fit one manoeuvre and write its folder; its row of the campaign and the digest of the folder as JSON."""
    loaded = load_records(task.records, root=task.root)
    chosen = [record.with_fit([segment]) for record, segment in zip(loaded, task.segments, strict=True)]
    fitted = fit_manoeuvre(task, chosen)
    write_fit(fitted, task.out, page=False)  # hundreds of fits: the page of the campaign shows them all
    return json.dumps({"row": fit_row(task, fitted), "results": results_digest(task.out)}).encode()


def _starts(task: FitTask) -> list[StartMaker | None]:
    """What gives the temperatures at the start of each record; None for the declared ones."""
    starts = zip(task.starts, task.segments, strict=True)
    return [None if kind == "declared" else start_at(kind, segment[0]) for kind, segment in starts]


def fit_manoeuvre(task: FitTask, records: Sequence[Record]) -> FitResult:
    """The fit of one manoeuvre, with what closing the loop found.

    The estimates of the whole record are priors here. A parameter on its bound there, and one that has no part in this
    manoeuvre, has the value of the whole record.
    """
    values = {name: value for name, (value, _) in task.carried.items()}
    priors = {name: (value, sigma) for name, (value, sigma) in task.carried.items() if sigma > 0.0}
    stated = ManoeuvreSettings(**task.settings)
    starts = _starts(task)
    fixed = {**{name: value for name, value in values.items() if name not in priors}, **stated.fix}
    settings = NewtonSettings(first_values=values)
    while True:
        free = {name: prior for name, prior in priors.items() if name not in fixed}
        fitted = estimate(
            records,
            [*(stated.parameters or [DEFAULT]), *free],
            effects=effect_uses(values),
            fixed=fixed,
            priors={**free, **stated.priors},
            bounds=stated.bounds,
            ties=stated.tie,
            starts=starts,
            settings=settings,
            reference={**task.reference, **stated.reference_condition},
        )
        omitted = {label.partition(AT)[0] for label in fitted.not_estimated}
        added = {name: values[name] for name in free if name in omitted}
        if not added:
            return fitted
        fixed |= added


def fit_row(task: FitTask, fitted: FitResult) -> dict[str, Any]:
    """A fit as a row of the campaign."""
    contents = estimate_contents(fitted)
    assert contents.fit is not None
    return {
        "control_point": task.point,
        "manoeuvre": task.manoeuvre,
        "flights": list(task.flights),
        "segments": [list(s) for s in task.segments],
        "starts": list(task.starts),
        "converged": contents.converged,
        "parameters": {n: {"value": p.value, "sigma": p.sigma, "unit": p.unit} for n, p in contents.parameters.items()},
        "correlation": dict(contents.correlation),
        "reference_condition": contents.reference_condition.model_dump(),
        "not_estimated": dict(contents.not_estimated),
        "rmse_K": contents.fit.rmse_K,
        "noise_floor_K": contents.noise_floor_K,
        "residual_over_noise": rms_normalised_residual(fitted.samples()),
        "warnings": list(fitted.warnings),
    }


def usable(row: Mapping[str, Any]) -> str:
    """Why a fit revises no table; empty where it may: it converged, and its model is complete."""
    if "failed" in row:
        return str(row["failed"])
    if not row["converged"]:
        return "the fit did not converge"
    if row["residual_over_noise"] > MODEL_ERROR_RATIO:
        return f"residuals are {row['residual_over_noise']:.1f} times those of noise: its model is incomplete"
    return ""
