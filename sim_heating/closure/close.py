"""Close the loop on one record: search, refit with what was found, and everything that a report tells of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files import files_written, output_directory
from sim_heating.base.parameters import CLOCK_SKEW, EFFECT_PREFIX, SENSOR_PREFIX
from sim_heating.base.progress import Progress, quiet
from sim_heating.closure.clues.correlation import ratio_at, residual_evidence
from sim_heating.closure.clues.residual_heating import ResidualHeating, residual_heating
from sim_heating.closure.fit_checks import check_fit
from sim_heating.closure.record_checks import CLOCK, DataFault, check_record, unresolved
from sim_heating.closure.report import FILES as REPORT_FILES
from sim_heating.closure.report import (
    CandidateScore,
    Closure,
    Finding,
    ParameterEstimate,
    false_alarm_statement,
    write_closure,
)
from sim_heating.closure.search.search import SearchResult, search_effects
from sim_heating.closure.search.trial_fit import QUICK, WIDENED, TrialFit, fitted_effects, fitted_values
from sim_heating.estimation.fit import FitResult, estimate
from sim_heating.estimation.inference.newton import NewtonSettings
from sim_heating.estimation.report.estimate_file import NAME
from sim_heating.estimation.report.report import FIT_FILES, noise_floor_K, write_fit
from sim_heating.heating.effects import effects
from sim_heating.inputs.record import Record

FILES = (*REPORT_FILES, NAME, *FIT_FILES)
"""Names of all files that a closed loop may write."""
FEWEST_SAMPLES = 10
"""Times of readings below which anything goes with what is left."""
SEARCH_PART = 0.8
"""Part of the time that the search takes."""
LEFT = 0.2
"""Mean square of the normalised residuals, beyond that of noise, from which on what is left is told."""
REFIT = NewtonSettings(min_improvement=1e-3, min_step=0.02, iterations=10, trust_radius=QUICK.trust_radius)
"""When the last fit stops: far within its bounds, and no step is longer than those of the search."""
SENSOR_PARAMETERS = {"bias": "bias_K", "gain": "gain"}


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """A record with its loop closed.

    found : the search;  fitted : the last fit, all of its parameters with bounds;  report : what is told of it
    """

    found: SearchResult
    fitted: FitResult
    report: Closure


def close_loop(record: Record, *, progress: Progress = quiet) -> ClosedLoop:
    """Find what a record's declared model lacks, add it, refit.

    raises : InputError where its clocks are in two units, InputError, RunError where not even the declared model can
             be fitted
    """
    times = int(np.count_nonzero(record.read_mask))
    if times < FEWEST_SAMPLES:
        raise InputError(f"{record.name}: readings at {times} time(s); a loop is closed on {FEWEST_SAMPLES} at least")
    doubts = check_record(record)
    on_clock = [v.words for v in doubts if v.kind == CLOCK]
    if on_clock:
        raise InputError(*on_clock)
    found = search_effects(record, progress=lambda f, text: progress(SEARCH_PART * f, text))
    progress(SEARCH_PART, "refitting with what was found")
    fitted = refit(found) if found.added else found.before
    progress(0.9, "residual as heating")
    return ClosedLoop(found, fitted, _report(found, fitted, doubts))


def refit(found: SearchResult) -> FitResult:
    """The record fitted with the declared model's parameters and all that was added, to the end and with bounds.

    Effects' priors are as wide as in the search.
    """
    last = found.added[-1]
    part = last.problem.record_fits[0]
    priors = {p.name: p for p in last.problem.parameters if p.name == CLOCK_SKEW.name}
    for name in part.march_names:
        if name.startswith(EFFECT_PREFIX):
            own = part.model.definition(name)
            priors[name] = replace(own, sigma=WIDENED * own.sigma)
    return estimate(
        [found.record],
        part.names,
        reference=dict(zip(RATIO_VARIABLES, last.problem.reference, strict=True)),
        effects=fitted_effects(last),
        priors=priors,
        settings=replace(REFIT, first_values=fitted_values(last)),
    )


def _report(found: SearchResult, fitted: FitResult, doubts: Sequence[DataFault]) -> Closure:
    before, values = found.before, found.before.fit.values
    residual = residual_heating(before.problem, values)
    after = fitted.after[0] if found.added else before.after[0]
    left = residual_heating(fitted.problem, fitted.fit.values) if found.added else None
    estimated = {
        u.label: ParameterEstimate(float(v), float(s), u.parameter.unit)
        for u, v, s in zip(fitted.problem.unknowns, fitted.fit.values, fitted.bounds.sigma, strict=True)
    }
    return Closure(
        record=found.record,
        predicted=before.before[0],
        before=before.after[0],
        after=after,
        noise_floor_K=noise_floor_K(fitted) or float("nan"),
        reference=before.problem.reference,
        effects=_named(found, estimated),
        candidates=_tried(found),
        parameters=estimated,
        residual=residual,
        residual_after=left,
        evidence=residual_evidence(residual, ratio_at(before.after[0], residual.time_s)),
        verdicts=[*unresolved(doubts, after), *check_fit(fitted.problem, fitted.fit.values, left or residual)],
        false_alarm=false_alarm_statement(),
        warnings=[*fitted.warnings, *_left_over(found, left)],
    )


def _left_over(found: SearchResult, left: ResidualHeating | None) -> list[str]:
    """A line on what is left beside the effects that were added, where that is more than noise."""
    if left is None or found.added[-1].excess < LEFT:
        return []
    size = math.sqrt(1.0 + found.added[-1].excess)
    return [
        f"what is left is {size:.2f} times noise, little beside what was explained: another effect, or a form that is "
        f"not quite that of {' and '.join(found.names)}. {residual_evidence(left).proposal()[0]}"
    ]


def _named(found: SearchResult, estimated: Mapping[str, ParameterEstimate]) -> list[Finding]:
    if not found.added:
        name = found.names[0]
        posterior = found.rounds[0].posterior["none"]
        return [Finding(name, posterior if name == "none" else 1.0 - posterior, {})]
    return [Finding(a.name, a.posterior, effect_parameters(a, estimated), _sensor(a)) for a in found.added]


def effect_parameters(attempt: TrialFit, estimated: Mapping[str, ParameterEstimate]) -> dict[str, ParameterEstimate]:
    """The parameters of an effect by their names within it."""
    effect = effects().get(attempt.name)
    own = {}
    for name in attempt.candidate.names:
        if name.startswith(SENSOR_PREFIX):
            short = SENSOR_PARAMETERS[name.rpartition(".")[2]]
        else:
            short = (effect and effect.own_name(name)) or name.rpartition(".")[2]
        if name in estimated:
            own[short] = estimated[name]
    return own


def _sensor(attempt: TrialFit) -> str | None:
    """The thermocouple that an effect is of; None where it is of no single one."""
    first = attempt.candidate.names[0]
    return first.removeprefix(SENSOR_PREFIX).rpartition(".")[0] if first.startswith(SENSOR_PREFIX) else None


def _tried(found: SearchResult) -> list[CandidateScore]:
    """The candidates of the first pass; those not worth a fit with what was promised of them, and errors as before."""
    first = found.rounds[0]
    before = found.before.after[0].segment_errors()
    rows = [("none", 0.0, before)]
    for a in first.attempts:
        try:
            rows.append((a.name, a.delta_bic, a.prediction.segment_errors()))
        except RunError:  # found in steps that the plain march cannot take
            continue
    rows += [(name, delta, before) for name, delta in first.passed.items()]
    return [
        CandidateScore(
            name, delta, e["fit"]["rmse_K"], e["holdout"]["rmse_K"] if e["holdout"] else None,
            first.posterior.get(name, 0.0),
        )
        for name, delta, e in rows
    ]  # fmt: skip


def write_closed_loop(closed: ClosedLoop, out: Path) -> list[str]:
    """Write closure.json, report.html, residual_heating.csv and the last fit's estimate.json with its files into a
    folder, all or nothing; names of the files."""
    with output_directory(out) as folder:
        write_closure(closed.report, folder)
        write_fit(closed.fitted, folder)
    return sorted(files_written(out))
