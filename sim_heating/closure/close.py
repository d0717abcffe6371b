"""Close the loop on one record: search for the missing effect, refit with it, and collect the results for a report."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files import files_written, output_directory
from sim_heating.base.parameters import CLOCK_SKEW, EFFECT_PREFIX, SENSOR_PREFIX
from sim_heating.base.progress import Progress, no_progress
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
from sim_heating.inputs.record import Record, load_record

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

COMMAND = "close-loop"
"""Name under which its results are listed."""
FILES = (*REPORT_FILES, NAME, *FIT_FILES)
"""Names of all files that a closed loop may write."""
MIN_SAMPLES = 10
"""Times of readings below which any effect would explain the residual."""
SEARCH_FRACTION = 0.8
"""Fraction of the time that the search takes."""
REPORTED_EXCESS = 0.2
"""Excess chi-square from which on the residual of the added effects is reported."""
REFIT = NewtonSettings(min_improvement=1e-3, min_step=0.02, iterations=10, trust_radius=QUICK.trust_radius)
"""Convergence of the last fit: far within its bounds; no step is longer than those of the search."""
SENSOR_PARAMETERS = {"bias": "bias_K", "gain": "gain", "tau_s": "tau_s"}
"""Parameters of a sensor by their names in closure.json."""


@dataclass(frozen=True, eq=False, repr=False)
class ClosedLoop:
    """A record with its loop closed.

    search : the rounds of the search and the effects that were added
    fitted : the last fit, all parameters with bounds
    report : the contents of closure.json and of the page
    """

    search: SearchResult
    fitted: FitResult
    report: Closure

    def __repr__(self) -> str:
        return repr(self.report).replace("Closure", "ClosedLoop", 1)

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects found, in the order in which they were added; else `none` or `unknown`."""
        return tuple(effect.name for effect in self.report.effects)

    def to_xarray(self) -> xr.Dataset:
        """Parameters of the last fit: values, standard deviations, correlations."""
        return self.fitted.to_xarray()

    def plot(self) -> Figure:
        """Measured temperatures, those of the model with the effects found, and the residual below."""
        return self.fitted.plot()


def close_loop(record: Record | str | os.PathLike[str], *, progress: Progress = no_progress) -> ClosedLoop:
    """Identify the effect that the declared model of a record lacks, add it, refit.

    record   : a flight record, or its directory
    progress : called with the fraction done, from 0 to 1, and a line of text
    returns  : the effects found, the last fit with its bounds, errors before and after
    raises   : InputError where its clocks are in two units or readings are too few; InputError or RunError where not
               even the declared model can be fitted

    >>> import sim_heating as sh
    >>> sh.close_loop("scenarios/records/practice/p08")
    <ClosedLoop of p08: impingement-onset, RMSE 1.67 K before, 1.29 K after>
    """
    record = load_record(record)
    times = int(np.count_nonzero(record.read_mask))
    if times < MIN_SAMPLES:
        raise InputError(f"{record.name}: readings at {times} time(s); close-loop needs {MIN_SAMPLES} at least")
    faults = check_record(record)
    # On a clock in another unit every candidate would be fitted to the wrong flight; other faults may still be
    # explained by the closed loop and are judged after it.
    of_clock = [f.message for f in faults if f.kind == CLOCK]
    if of_clock:
        raise InputError(*of_clock)
    result = search_effects(record, progress=lambda f, text: progress(SEARCH_FRACTION * f, text))
    progress(SEARCH_FRACTION, "refitting with the effects found")
    fitted = refit(result) if result.added else result.before
    progress(0.9, "residual as heating")
    return ClosedLoop(result, fitted, _closure(result, fitted, faults))


def refit(result: SearchResult) -> FitResult:
    """The record fitted to convergence with the declared model's parameters and all added effects, with bounds.

    Priors of the effects are as wide as in the search.
    """
    last = result.added[-1]
    part = last.problem.record_fits[0]
    # The priors of the search: with the declared ones the last fit could end at other values than those that were
    # ranked.
    priors = {p.name: p for p in last.problem.parameters if p.name == CLOCK_SKEW.name}
    for name in part.march_names:
        if name.startswith(EFFECT_PREFIX):
            parameter = part.model.definition(name)
            priors[name] = replace(parameter, sigma=WIDENED * parameter.sigma)
    return estimate(
        [result.record],
        part.names,
        reference=dict(zip(RATIO_VARIABLES, last.problem.reference, strict=True)),
        effects=fitted_effects(last),
        priors=priors,
        settings=replace(REFIT, first_values=fitted_values(last)),
    )


def _closure(result: SearchResult, fitted: FitResult, faults: Sequence[DataFault]) -> Closure:
    """The results of a search and its refit, for the report; `faults` are those found before any fit."""
    before, values = result.before, result.before.fit.values
    residual = residual_heating(before.problem, values)
    after = fitted.after[0] if result.added else before.after[0]
    residual_after = residual_heating(fitted.problem, fitted.fit.values) if result.added else None
    estimated = {
        u.label: ParameterEstimate(float(v), float(s), u.parameter.unit)
        for u, v, s in zip(fitted.problem.unknowns, fitted.fit.values, fitted.bounds.sigma, strict=True)
    }
    return Closure(
        record=result.record,
        predicted=before.before[0],
        before=before.after[0],
        after=after,
        noise_floor_K=noise_floor_K(fitted) or float("nan"),
        reference=before.problem.reference,
        effects=_findings(result, estimated),
        candidates=_candidate_scores(result),
        parameters=estimated,
        residual=residual,
        residual_after=residual_after,
        evidence=residual_evidence(residual, ratio_at(before.after[0], residual.time_s)),
        faults=[
            *unresolved(faults, after),
            *check_fit(fitted.problem, fitted.fit.values, residual_after or residual),
        ],
        false_alarm=false_alarm_statement(),
        warnings=[*fitted.warnings, *_residual_warning(result, residual_after)],
    )


def _residual_warning(result: SearchResult, residual: ResidualHeating | None) -> list[str]:
    """A line on the residual of the added effects, where it is more than noise."""
    if residual is None or result.added[-1].excess_chi2 < REPORTED_EXCESS:
        return []
    size = math.sqrt(1.0 + result.added[-1].excess_chi2)
    return [
        f"the residual is {size:.2f} times noise, small compared with what the effects explain: another effect, or a "
        f"form that differs from that of {' and '.join(result.names)}. {residual_evidence(residual).proposal()[0]}"
    ]


def _findings(result: SearchResult, estimated: Mapping[str, ParameterEstimate]) -> list[Finding]:
    """The added effects; "none" or "unknown" where there are none."""
    if not result.added:
        name = result.names[0]
        posterior = result.rounds[0].posterior["none"]
        return [Finding(name, posterior if name == "none" else 1.0 - posterior, {})]
    return [Finding(t.name, t.posterior, effect_parameters(t, estimated), _sensor_of(t)) for t in result.added]


def effect_parameters(trial: TrialFit, estimated: Mapping[str, ParameterEstimate]) -> dict[str, ParameterEstimate]:
    """The estimates of an effect by their names within it."""
    effect = effects().get(trial.name)
    named = {}
    for name in trial.candidate.names:
        if name.startswith(SENSOR_PREFIX):
            short = SENSOR_PARAMETERS[name.rpartition(".")[2]]
        else:
            short = (effect and effect.own_name(name)) or name.rpartition(".")[2]
        if name in estimated:
            named[short] = estimated[name]
    return named


def _sensor_of(trial: TrialFit) -> str | None:
    """The thermocouple that an effect is of; None where it is of no single one."""
    first = trial.candidate.names[0]
    return first.removeprefix(SENSOR_PREFIX).rpartition(".")[0] if first.startswith(SENSOR_PREFIX) else None


def _candidate_scores(result: SearchResult) -> list[CandidateScore]:
    """The candidates of the first round; those that were not fitted have their predicted BIC, and errors as before."""
    first = result.rounds[0]
    before = result.before.after[0].segment_errors()
    rows = [("none", 0.0, before)]
    for trial in first.trials:
        try:
            rows.append((trial.name, trial.delta_bic, trial.prediction.segment_errors()))
        except RunError:  # fitted in steps that the plain march cannot take
            continue
    rows += [(name, delta_bic, before) for name, delta_bic in first.screened_out.items()]
    return [
        CandidateScore(
            name=name,
            delta_bic=delta_bic,
            fit_rmse_K=errors["fit"]["rmse_K"],
            holdout_rmse_K=errors["holdout"]["rmse_K"] if errors["holdout"] else None,
            posterior=first.posterior.get(name, 0.0),
        )
        for name, delta_bic, errors in rows
    ]


def write_closed_loop(closed: ClosedLoop, out: str | os.PathLike[str]) -> list[str]:
    """Write all files of a closed loop into a folder, or none.

    returns : names of closure.json, report.html, residual_heating.csv, and the last fit's estimate.json with its files
    """
    with output_directory(out, COMMAND, inputs=[closed.report.record.directory]) as folder:
        write_closure(closed.report, folder)
        write_fit(closed.fitted, folder)
    return sorted(files_written(out))
