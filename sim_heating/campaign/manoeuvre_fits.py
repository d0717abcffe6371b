"""Fits of manoeuvres, each flight by itself and all flights of one manoeuvre together, as jobs that can be resumed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from sim_heating.base.files import results_digest
from sim_heating.base.files.package import package_version
from sim_heating.base.parallel import Job
from sim_heating.campaign.carried import Carried
from sim_heating.campaign.flights import CampaignFlight, Manoeuvre
from sim_heating.campaign.spec import FitSettings
from sim_heating.estimation.fit import FitResult, estimate, rms_normalised_residual
from sim_heating.estimation.inference.newton import NewtonSettings
from sim_heating.estimation.inference.observability import default_names
from sim_heating.estimation.record_fit import StartMaker
from sim_heating.estimation.report.estimate_file import inputs_hash
from sim_heating.estimation.report.report import estimate_contents, write_fit
from sim_heating.estimation.starts import STARTS
from sim_heating.heating.effects import effects, user_effect_files
from sim_heating.inputs.record import Record, load_records

MODEL_ERROR_RATIO = 1.3
"""RMS of the residuals over that of noise [-] above which a fit revises no table: its model is incomplete."""
READINGS_BEFORE = 3
"""Readings of every thermocouple before a start that is made from them."""


@dataclass(frozen=True)
class FitTask:
    """One fit of a manoeuvre; picklable.

    group    : name of the manoeuvres that it is compared with
    records  : directories, one a flight
    segments : fitted [start, end] of each record [s]
    start    : kind of start, `declared` or one of estimation.starts.STARTS
    names    : parameters of the ratio; None for those that the records can tell
    reference: condition that derivatives are about, by variable ([deg], [-]); that of the records where it is empty
    carried  : dotted name -> value of the parameters that closing the loop found
    """

    point: str
    manoeuvre: str
    group: str
    flights: tuple[str, ...]
    records: tuple[str, ...]
    segments: tuple[tuple[float, float], ...]
    out: str
    start: str
    names: tuple[str, ...] | None
    reference: Mapping[str, float] = field(default_factory=dict)
    carried: Mapping[str, float] = field(default_factory=dict)
    root: str | None = None

    @property
    def title(self) -> str:
        """Control point, manoeuvre and flights."""
        return f"{self.point}, {self.manoeuvre}, {', '.join(self.flights)}"


def fit_segment(
    flight: CampaignFlight, record: Record, manoeuvre: Manoeuvre, settings: FitSettings
) -> tuple[float, float] | str:
    """Fitted [start, end] of a manoeuvre [s], half way to its neighbours at most; where that is impossible, why."""
    assert settings.before_s is not None
    assert settings.after_s is not None
    begin, end = manoeuvre.start_s - settings.before_s, manoeuvre.end_s + settings.after_s
    for other in flight.manoeuvres:
        # samples of two fits would count twice in the tables
        if other.end_s <= manoeuvre.start_s:
            begin = max(begin, 0.5 * (other.end_s + manoeuvre.start_s))
        elif other.start_s >= manoeuvre.end_s:
            end = min(end, np.nextafter(0.5 * (manoeuvre.end_s + other.start_s), begin))
    if settings.start != "declared":
        read = np.isfinite(record.temperatures_K(record.used_sensors)) & (record.time_s >= record.conditions.time_s[0])
        if np.any(np.count_nonzero(read, axis=1) <= READINGS_BEFORE):
            return f"a used thermocouple has no more than {READINGS_BEFORE} readings to start from"
        first = max(record.time_s[row][READINGS_BEFORE - 1] for row in read)
        begin = max(begin, float(first))
    if begin >= manoeuvre.end_s:
        return "there are no readings before the end of the manoeuvre"
    return float(begin), float(end)


def fit_job(task: FitTask, records: Sequence[Record]) -> Job:
    """The job of a fit; its name depends on everything that its result depends on."""
    digest = hashlib.sha256("|".join([*map(inputs_hash, records), package_version(), *sorted(effects())]).encode())
    digest.update(json.dumps({k: v for k, v in asdict(task).items() if k not in ("out", "records")}).encode())
    for path in user_effect_files():
        digest.update(path.read_bytes())
    return Job(f"{task.point}-{task.manoeuvre}-{digest.hexdigest()[:16]}.json", task)


def results_are_there(job: Job, finished: bytes) -> bool:
    """Whether the folder of a finished fit still holds what was written into it."""
    try:
        return bool(json.loads(finished)["results"] == results_digest(job.task.out))
    except (ValueError, KeyError, TypeError):
        return False


def run_fit(task: FitTask) -> bytes:
    """Fit one manoeuvre and write its folder; its row of the campaign and the digest of the folder as JSON."""
    loaded = load_records(task.records, root=task.root)
    chosen = [record.with_fit([segment]) for record, segment in zip(loaded, task.segments, strict=True)]
    fitted = fit_manoeuvre(task, chosen)
    write_fit(fitted, task.out)
    return json.dumps({"row": fit_row(task, fitted), "results": results_digest(task.out)}).encode()


def fit_manoeuvre(task: FitTask, records: Sequence[Record]) -> FitResult:
    """The fit of one manoeuvre, with what closing the loop found.

    Parameters found in the whole record that the manoeuvre does not tell have their values from the whole record.
    """
    carried = Carried(task.carried)
    names = list(default_names(records)) if task.names is None else list(task.names)
    starts = [None if task.start == "declared" else _start_at(task.start, segment[0]) for segment in task.segments]
    fixed: dict[str, float] = {}
    settings = NewtonSettings(first_values=dict(task.carried))
    while True:
        free = [name for name in carried.names if name not in fixed]
        more: dict[str, Any] = {"fixed": fixed} if fixed else {}
        fitted = estimate(
            records, [*names, *free] if task.names is not None or free else None, effects=carried.uses(),
            **more, starts=starts, settings=settings, reference=task.reference,
        )  # fmt: skip
        omitted = {label.partition("@")[0] for label in fitted.not_estimated}
        added = {name: task.carried[name] for name in free if name in omitted}
        if not added:
            return fitted
        fixed |= added


def _start_at(kind: str, time_s: float) -> StartMaker:
    return lambda record, model, mesh: STARTS[kind](record, model, mesh, time_s)


def fit_row(task: FitTask, fitted: FitResult) -> dict[str, Any]:
    """A fit as a row of the campaign."""
    contents = estimate_contents(fitted)
    assert contents.fit is not None
    return {
        "control_point": task.point,
        "manoeuvre": task.manoeuvre,
        "flights": list(task.flights),
        "segments": [list(s) for s in task.segments],
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
    """Why a fit revises no table; empty where it may."""
    if "failed" in row:
        return str(row["failed"])
    if not row["converged"]:
        return "the fit did not converge"
    if row["residual_over_noise"] > MODEL_ERROR_RATIO:
        return f"residuals are {row['residual_over_noise']:.1f} times those of noise: its model is incomplete"
    return ""
