"""Close the loop on one record: search for the missing effect, refit with it, and collect the results for a report."""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError, RunError, or_left_out
from sim_heating.base.files import files_written, output_directory
from sim_heating.base.parallel.processes import in_processes
from sim_heating.base.parallel.threads import one_thread
from sim_heating.base.parameters import CLOCK_SKEW, EFFECT_PREFIX, MODEL, SENSOR_PREFIX, Parameter
from sim_heating.base.progress import Progress, no_progress
from sim_heating.closure.clues.correlation import ratio_at, residual_evidence
from sim_heating.closure.clues.record_checks import (
    TRAJECTORY,
    DataFault,
    clock_fault,
    magnitude_fault,
    start_fault,
    with_noise,
)
from sim_heating.closure.clues.residual_heating import ResidualHeating, residual_heating
from sim_heating.closure.curves import curve_of
from sim_heating.closure.plain_marches import plain_marches
from sim_heating.closure.prior.findings import table_error, table_findings
from sim_heating.closure.prior.model_error import SmoothFlightError
from sim_heating.closure.prior.table import table_prior
from sim_heating.closure.result import FILES as REPORT_FILES
from sim_heating.closure.result import (
    NONE,
    PARTLY,
    UNKNOWN,
    Barred,
    CandidateScore,
    Closure,
    Finding,
    NotEffect,
    ParameterEstimate,
    Statement,
)
from sim_heating.closure.search.changes.record_change import ENDS_MOVED
from sim_heating.closure.search.hypothesis import Conclusion, Hypothesis
from sim_heating.closure.search.ranking import posteriors
from sim_heating.closure.search.search import SearchResult, search_effects
from sim_heating.closure.search.table_candidates import TABLE
from sim_heating.closure.search.tell_apart import tell_apart
from sim_heating.closure.search.trials.told_error import told_error
from sim_heating.closure.search.trials.trial_fit import (
    QUICK,
    WIDENED,
    TrialFit,
    declared_fit,
    fitted_effects,
    fitted_values,
    sample_count,
)
from sim_heating.closure.verdict.calibration import false_alarm_statement, features, probability
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.fit import FitResult, estimate, fit_problem
from sim_heating.estimation.inference.newton import Fit, NewtonSettings
from sim_heating.estimation.inference.outliers import outlier_lines, without_outliers
from sim_heating.estimation.problem import FitOptions, FitProblem
from sim_heating.estimation.record_fit import LAG_NAME
from sim_heating.estimation.report.estimate_file import NAME, Estimate
from sim_heating.estimation.report.remarks import remarks, samples_in_words
from sim_heating.estimation.report.report import FIT_FILES, estimate_contents, noise_floor_K, write_fit_data
from sim_heating.heating.effects import effects
from sim_heating.heating.effects.added_curve import ADDED_CURVE
from sim_heating.heating.effects.curve import FIRST, LABELS, UNITS, VALUES, CurveBand
from sim_heating.inputs.averaged_record import averaged_record
from sim_heating.inputs.record import Record, load_record
from sim_heating.simulation.predict import Prediction

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

LOG = logging.getLogger(__name__)
COMMAND = "close-loop"
"""Name under which its results are listed."""
FILES = (*REPORT_FILES, NAME, *FIT_FILES)
"""Names of all files that a closed loop may write."""
REFIT = NewtonSettings(min_improvement=1e-3, min_step=0.02, iterations=10, trust_radius=QUICK.trust_radius)
"""Convergence of the last fit: far within its bounds; no step is longer than those of the search."""
SENSOR_PARAMETERS = {"bias": "bias_K", "gain": "gain", "tau_s": "tau_s", "drift": "drift_K_s"}
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


def close_loop(
    record: Record | str | os.PathLike[str],
    parameters: Sequence[str] | None = None,
    *,
    progress: Progress = no_progress,
) -> ClosedLoop:
    """Identify the effect that the declared model of a record lacks, add it, refit.

    record     : a flight record, or its directory
    parameters : dotted names of the declared model's parameters that are fitted before anything is searched for; by
                 default magnitude and derivatives, and none where the record has no reference heating
    progress   : called with the fraction done, from 0 to 1, and a line of text
    returns    : the effects found, the last fit with its bounds, errors before and after
    raises     : InputError where its clocks are in two units or readings are too few, or for a name that the model
                 does not have; InputError or RunError where not even the declared model can be fitted

    Of a record with very many readings neighbours are averaged, as `estimate` does, and a warning says so.

    >>> import sim_heating as sh
    >>> sh.close_loop("scenarios/records/practice/p08")
    <ClosedLoop of p08: found: impingement-onset, RMSE 1.67 K before, 1.29 K after>
    """
    record = load_record(record)
    times = int(np.count_nonzero(record.read_mask))
    if times < POLICY.min_reading_times:
        needed = f"close-loop needs {POLICY.min_reading_times} at least"
        raise InputError(f"{record.name}: readings at {times} time(s); {needed}")
    # On a clock in another unit every candidate would be fitted to the wrong flight.
    of_clock = clock_fault(record)
    if of_clock is not None:
        raise InputError(of_clock.message)
    record, outliers = without_outliers(record)
    record, averaged = averaged_record(record)
    for line in averaged:
        progress(0.0, line)
    record, of_noise = with_noise(record)
    notes = [*averaged, *outlier_lines(outliers, {record.name: record}), *of_noise]
    result = _stated(search_effects(record, parameters, progress=lambda f, text: progress(0.8 * f, text)))
    progress(0.8, "refitting with the effects found; residual as heating")
    tasks: list[Callable[[], Any]] = [
        partial(_refitted, result), partial(_residual_after, result.before), partial(_before, result),
    ]  # fmt: skip
    (fitted, after, residual_after), residual, before = in_processes(tasks)
    compared = before, before if result.compared is result.none else after
    report = _closure(result, fitted, compared, (residual, residual_after), notes)
    LOG.info("%r", report)
    samples = _samples(result, len(outliers))
    report = replace(report, samples=samples, warnings=[*_few_samples(samples), *report.warnings])
    return ClosedLoop(result, fitted, report)


def _samples(result: SearchResult, outliers: int) -> dict[str, Any]:
    """Numbers of readings that the finding rests on, that were held out, and that were left out with the reason."""
    none = result.none.last
    left_out = dict(none.problem.record_fits[0].left_out)
    if outliers:
        left_out["outliers"] = outliers
    held_out = 0 if none.held_out is None else sample_count(none.held_out)
    return {"fit": sample_count(none.problem), "holdout": held_out, "left_out": left_out}


def _few_samples(samples: Mapping[str, Any]) -> list[str]:
    """Lines on readings that are left out, and on too few of them."""
    words, count = samples_in_words(samples), samples["fit"]
    few = f"{count} readings are fitted, and below {POLICY.min_samples_for_probability} no probability is given"
    return [line for line in (words, few if count < POLICY.min_samples_for_probability else "") if line]


def _stated(result: SearchResult) -> SearchResult:
    """The result of a search, whose finding is stated where it is rather right than wrong."""
    found = probability_of(result)
    if not result.explained or found is None or found >= POLICY.min_probability:
        return result
    return replace(result, conclusion=replace(result.conclusion, finding=PARTLY, improbable=found))


def _refitted(result: SearchResult) -> tuple[FitResult, Prediction, ResidualHeating | None]:
    """The last fit, its plain prediction, and where a cause was found what is missing after it."""
    fitted = refit(result)
    return fitted, plain_marches(fitted)[0], _residual_after(fitted) if result.explained else None


def _before(result: SearchResult) -> Prediction:
    """The plain prediction of the declared model, as that of the last fit is made."""
    return plain_marches(_declared(result))[0]


def _declared(result: SearchResult) -> FitResult:
    """The declared model as the last fit is compared with it: of a model with an error, with the same error free."""
    none = result.none.last
    return result.before if _is_exact(none) else _with_error(result.record, none)


def _is_exact(trial: TrialFit) -> bool:
    return trial.problem.record_fits[0].model_error is None


def _with_error(record: Record, trial: TrialFit) -> FitResult:
    """The whole record fitted with the model of a trial, and with the error that this has."""
    return fit_problem(error_problem(record, trial), trial.fit.values, settings=REFIT)


def error_problem(record: Record, trial: TrialFit) -> FitProblem:
    """The problem of a whole record with the model of a trial and the error that this has."""
    part, options = trial.problem.record_fits[0], trial.problem.options
    options = FitOptions(fitted_effects(trial), priors=trial.problem.priors, prior_scale=options.prior_scale)
    error = part.model_error
    assert error is not None  # the caller's trials have one
    names = [n for n in part.names if n not in part.flight_names]
    problem = FitProblem([record], names, trial.problem.reference, options)
    problem.record_fits[0].sigma_K.update(part.sigma_K)
    if isinstance(error.flight, SmoothFlightError):
        error = replace(error, flight=replace(error.flight, flown=record))
    problem = problem.with_model_error(error)
    return problem.with_flight_unknowns() if part.flight_names else problem


def _residual_after(fitted: FitResult) -> ResidualHeating:
    """What the model of a fit lacks, as heating."""
    with one_thread():
        return residual_heating(fitted.problem, fitted.fit.values)


def refit(result: SearchResult) -> FitResult:
    """The record fitted to convergence with the best model that may be named, whether it is the cause or not, with
    bounds; the declared model's fit where there is none.

    Priors of the effects are as wide as in the search. A cause that is no effect changes the record itself: its flight,
    wall or sensors are then those found.
    """
    best = result.compared
    if best is result.none:
        return _declared(result)
    record, change = result.record, best.change
    if best.changed is not None and change is not None:
        record = change.apply(record, best.changed.value)
    if change is not None and not best.added:
        return declared_fit(record, [*result.before.labels, *change.free] or None)
    last = best.last
    if not _is_exact(last):
        return _with_error(record, last)
    part = last.problem.record_fits[0]
    in_model = best.changed.estimates if best.changed is not None and change is not None and change.in_model else []
    return estimate(
        [record],
        [n for n in part.names if n not in in_model],
        reference=dict(zip(RATIO_VARIABLES, last.problem.reference, strict=True)),
        effects=fitted_effects(last),
        priors=refit_priors(last),
        settings=replace(REFIT, first_values=fitted_values(last)),
    )


def refit_priors(trial: TrialFit) -> dict[str, Parameter]:
    """Priors of the last fit with the effects of a trial, by dotted name: those of the search.

    With the declared ones the last fit could end at other values than those that were ranked: a lag of 30 s is 60
    sigmas from that of a sensor which is attached as declared.
    """
    part = trial.problem.record_fits[0]
    searched = trial.problem.parameters
    priors = {p.name: p for p in searched if p.name == CLOCK_SKEW.name or p.name.endswith(LAG_NAME)}
    for name in part.march_names:
        if name.startswith(EFFECT_PREFIX):
            parameter = part.model.definition(name)
            priors[name] = replace(parameter, sigma=WIDENED * parameter.sigma)
    return priors


def _closure(
    result: SearchResult,
    fitted: FitResult,
    compared: tuple[Prediction, Prediction],
    residuals: tuple[ResidualHeating, ResidualHeating | None],
    notes: Sequence[str] = (),
) -> Closure:
    """The results of a search and its refit, for the report.

    compared  : plain predictions of the declared model and of the best that may be named
    residuals : as heating, of the declared model and, where a cause was found, after the last fit
    notes     : on the record; they come first of its warnings
    """
    before, (residual, residual_after) = result.before, residuals
    estimated = estimates_of(fitted.problem, fitted.fit, fitted.bounds.sigma)
    not_effects = _not_effects(result)
    faults = [fault for fault in [start_fault(result.record)] if fault is not None]
    faults += [DataFault(TRAJECTORY, d.message) for d in result.discrepancies]
    faults += [fault for fault in [magnitude_fault(fitted.problem, fitted.fit.values)] if fault is not None]
    return Closure(
        record=result.record,
        predicted=None if result.record.lacks_ratio else before.before[0],
        before=compared[0],
        after=compared[1],
        noise_floor_K=noise_floor_K(fitted) or float("nan"),
        reference=before.problem.reference,
        effects=_findings(result, estimated),
        candidates=_candidate_scores(result),
        parameters=estimated,
        residual=residual,
        residual_after=residual_after,
        evidence=residual_evidence(residual, ratio_at(before.after[0], residual.time_s)),
        statement=_statement(result, fitted, [*_left_out(result), *not_effects]),
        curve=or_left_out(lambda: _curve(result), None, "curve that the residual follows"),
        faults=[] if not_effects else faults,
        false_alarm=false_alarm_statement() if _is_exact(result.none.last) else "",
        warnings=[
            *notes,
            *(line for line in fitted.warnings if line not in [*notes, *(f.message for f in faults)]),
            *_forms(result),
            *_residual_warning(result, residual_after),
        ],
        remarks=remarks(fitted),
    )


def _curve(result: SearchResult) -> CurveBand | None:
    """The curve that an unexplained residual follows; None where it explains less than half of it."""
    found = result.curve
    if found is None or found.excess_chi2 > POLICY.min_explained * result.none.excess_chi2:
        return None
    return curve_of(found)


def _statement(result: SearchResult, fitted: FitResult, not_effects: Sequence[NotEffect]) -> Statement:
    """The finding with its alternatives and its adequacy."""
    conclusion = result.conclusion
    best = conclusion.best if conclusion.finding != UNKNOWN else result.none
    return Statement(
        finding=conclusion.finding,
        alternatives=[[_in_words(result, name) for name in names] for names in conclusion.alternatives],
        adequacy=best.adequacy,
        explained=conclusion.explained,
        probability=probability_of(result),
        improbable=conclusion.improbable,
        not_effects=not_effects,
        converged=fitted.fit.converged,
        would_tell_apart=or_left_out(
            lambda: tell_apart(result.none, conclusion.best, _rivals(result)), [], "what would tell causes apart"
        ),
        alternative_values=_alternative_values(result),
        experiment="flight" if result.record.has_flow else "test",
        resembles=_resembles(result),
        model_error=told_error(result.compared.last),
        barred=_barred(result),
    )


def _resembles(result: SearchResult) -> list[str]:
    """Names of the best model that may be named, where what it is of is not stated as the cause."""
    if result.conclusion.finding not in (PARTLY, UNKNOWN):
        return []
    return [_in_words(result, name) for name in result.compared.names]


def _barred(result: SearchResult, *, most_barred: int = 5) -> list[Barred]:
    """Models that fit better than the best that may be named, with the reason for which they may not be.

    most_barred : models that may not be named, which are listed at most
    """
    best, seen = result.compared, dict[tuple[str, ...], Barred]()
    for h in sorted(result.hypotheses, key=lambda h: h.score):
        gain = 0.5 * (best.score - h.score)
        if not h.admissible and np.isfinite(h.score) and gain > 0.0:
            seen.setdefault(h.names, Barred(h.names, "; ".join(h.objections), gain))
    return list(seen.values())[:most_barred]


def probability_of(result: SearchResult) -> float | None:
    """Calibrated probability that the finding of a search is right; None where it states nothing.

    Nor is there one for a record whose model has an error, no findings on such records having been counted yet, or for
    one with fewer than `Policy.min_samples_for_probability` readings.
    """
    few = sample_count(result.none.last.problem) < POLICY.min_samples_for_probability
    conclusion = result.conclusion
    return probability(conclusion.finding, features_of(conclusion)) if _is_exact(result.none.last) and not few else None


def features_of(found: Conclusion) -> FloatArray:
    """(feature,) what the probability of a conclusion follows from [-]."""
    return features(
        found.finding,
        found.rival,
        found.best.adequacy.p_value,
        found.explained,
        len(found.alternatives),
        found.disqualified,
        found.best.kind not in ("", "effect"),
    )


def _rivals(result: SearchResult) -> list[Hypothesis]:
    """The best hypothesis with each name that the record cannot tell from the one named first."""
    best = result.conclusion.best
    others = [name for names in result.conclusion.alternatives for name in names if name not in best.names]
    rivals: dict[Hypothesis, None] = {}
    for name in others:
        found = next((h for h in result.hypotheses if h.admissible and name in h.names), None)
        if found is not None:
            rivals.setdefault(found)
    return list(rivals)


def valued(found: Conclusion) -> list[str]:
    """Names of a conclusion whose values no last fit has: all of a set, and what a record resembles."""
    sets = [names for names in found.alternatives if len(names) > 1 or found.finding == PARTLY]
    return [name for names in sets for name in names]


def _alternative_values(result: SearchResult) -> dict[str, dict[str, ParameterEstimate]]:
    """Estimates of each of these by its name in the report: of the best hypothesis with it, as the search fitted it."""
    named = [result.conclusion.best, *(h for h in result.hypotheses if h.admissible)]
    values = {}
    for name in valued(result.conclusion):
        found = next((h for h in named if name in h.names or name in h.effects), None)
        if found is not None and (own := _values_of(found, name)):
            values[_in_words(result, name)] = own
    return values


def _values_of(found: Hypothesis, name: str) -> dict[str, ParameterEstimate]:
    """Estimates of a cause of a hypothesis by their names within it."""
    estimated = estimates_of(found.last.problem, found.last.fit)
    if found.changed is not None and found.change is not None and found.change.name == name:
        return change_parameters(found.changed, estimated)
    return effect_parameters(next(t for t in found.trials if t.name == name), estimated)


def estimates_of(problem: FitProblem, fit: Fit, sigma: FloatArray | None = None) -> dict[str, ParameterEstimate]:
    """The estimates of a fit by label, by default with the bounds of its information."""
    pairs = zip(problem.unknowns, fit.values, fit.sigma if sigma is None else sigma, strict=True)
    return {u.label: ParameterEstimate(float(v), float(s), u.parameter.unit) for u, v, s in pairs}


def _in_words(result: SearchResult, name: str) -> str:
    """An alternative as the report has it: the name of an effect, another cause with its value."""
    several = [result.conclusion.best, *(h for h in result.hypotheses if h.names == (name,))]
    causes = [cause for h in several if name in h.names and name not in h.effects for cause in _causes(h)]
    return next((c.what for c in causes if (c.kind == "table") == (name == TABLE)), name)


def _not_effects(result: SearchResult) -> list[NotEffect]:
    """The cause that was found, where it is no effect; else errors of the table that the declared model's fit shows."""
    best = result.conclusion.best
    if result.explained:
        return [replace(cause, probability=probability_of(result)) for cause in _causes(best)]
    if result.conclusion.finding != NONE:
        return []
    labels = result.before.labels
    prior = table_prior(result.record, labels, result.before.problem.reference)
    return [
        NotEffect("table", f.what, {n: ParameterEstimate(v, s, MODEL[n].unit) for n, (v, s) in f.parameters.items()})
        for f in table_findings(result.before, prior)
    ]


def _left_out(result: SearchResult) -> list[NotEffect]:
    """Thermocouples that are stuck in all their readings: every fit leaves them out."""
    fitted = {s.name for s in result.before.problem.record_fits[0].record.used_sensors}
    stuck = [s for s in result.record.used_sensors if s.name not in fitted]
    return [
        NotEffect("sensor", f"{s.name} stuck at {np.nanmax(result.record.thermocouples[s.column]):.1f} K throughout")
        for s in stuck
    ]


def _causes(found: Hypothesis) -> list[NotEffect]:
    """Causes of a hypothesis that are no effect, with their estimates."""
    causes, change, changed = [], found.change, found.changed
    if change is not None and changed is not None and not change.effect:
        own = {name: ParameterEstimate(value, sigma, p.unit) for name, (p, value, sigma) in changed.estimates.items()}
        causes.append(NotEffect(found.kind, change.describe(changed.value), own))
    last = found.last
    for trial in found.trials:
        if trial.name == TABLE:
            name, fit = trial.candidate.names[0], last.fit
            at = [u.parameter.name for u in last.problem.unknowns].index(name)
            value, sigma = float(fit.values[at]), float(fit.sigma[at])
            estimate_of_name = {name: ParameterEstimate(value, sigma, MODEL[name].unit)}
            causes.append(NotEffect("table", table_error(name, value), estimate_of_name))
    return causes


def _forms(result: SearchResult) -> list[str]:
    """A line for each effect that is found in a free form."""
    lines = []
    for trial in result.added:
        for used in trial.candidate.uses:
            if used.effect.name == ADDED_CURVE:
                number, low, high = used.values[:FIRST]
                unit, label = UNITS[int(number)], LABELS[int(number)]
                lines.append(
                    f"{trial.name} has another form than the library's: a curve in the {label} is added to the ratio, "
                    f"{VALUES[0]} to {VALUES[-1]} at even steps from {low:.4g} to {high:.4g} {unit}"
                )
    return lines


def _residual_warning(result: SearchResult, residual: ResidualHeating | None) -> list[str]:
    """A line on the residual of what was found, where it is more than noise."""
    best = result.conclusion.best
    if residual is None or best.excess_chi2 < POLICY.reported_excess:
        return []
    size = math.sqrt(1.0 + best.excess_chi2)
    return [
        f"the residual is {size:.2f} times noise, small compared with what the effects explain: another effect, or a "
        f"form that differs from that of {' and '.join(best.names)}. {residual_evidence(residual).proposal()[0]}"
    ]


def _findings(result: SearchResult, estimated: Mapping[str, ParameterEstimate]) -> list[Finding]:
    """The effects found; "none" or "unknown" where there are none."""
    best, admissible = result.conclusion.best, [h for h in reversed(result.hypotheses) if h.admissible]
    shares = posteriors({" + ".join(h.names): h.score for h in admissible} | {NONE: 0.0})
    if not result.explained or not best.effects:
        name = result.names[0]
        return [Finding(name, shares[NONE] if name == NONE else 1.0 - shares[NONE], {})]
    share = shares[" + ".join(best.names)]
    of_change = [best.changed] if best.changed is not None and best.change is not None and best.change.effect else []
    return [
        *(Finding(f.change.effect, share, change_parameters(f, estimated)) for f in of_change if f.change),
        *(Finding(t.name, share, effect_parameters(t, estimated), _sensor_of(t)) for t in result.added),
    ]


def change_parameters(fit: TrialFit, estimated: Mapping[str, ParameterEstimate]) -> dict[str, ParameterEstimate]:
    """The estimates of a change that is an effect: its own, those of the model's parameters that are estimated with it,
    and its ends, to the last step of their search."""
    change = fit.change
    assert change is not None
    own = {name: ParameterEstimate(value, sigma, p.unit) for name, (p, value, sigma) in fit.estimates.items()}
    own |= {n.rpartition(".")[2]: estimated[n] for n in change.free if n in estimated}
    values = [value for value, _ in change.ends.values()]
    step = ENDS_MOVED[-1] * (max(values, default=0.0) - min(values, default=0.0))
    return own | {name: ParameterEstimate(value, step, unit) for name, (value, unit) in change.ends.items()}


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
    """All single causes, as they were compared; those that were not fitted have their predicted BIC, and errors as
    before."""
    first = result.rounds[0]
    scored = {h.names[0]: h for h in reversed(result.hypotheses) if len(h.names) == 1}
    shares = posteriors({name: h.score for name, h in scored.items() if h.admissible} | {NONE: 0.0})
    rows = [(NONE, 0.0, result.none.last)]
    rows += [
        (h.names[0], h.last.delta_bic if h.changed is None else h.changed.delta_bic, h.last) for h in scored.values()
    ]
    rows += [(t.name, t.delta_bic, t) for t in first.trials if t.name not in scored]
    rows += [
        (name, delta_bic, result.none.last) for name, delta_bic in first.screened_out.items() if name not in scored
    ]
    return [
        CandidateScore(
            name=name,
            delta_bic=delta_bic,
            fit_rmse_K=rmse_K(trial, trial.problem),
            holdout_rmse_K=None if trial.held_out is None else rmse_K(trial, trial.held_out),
            posterior=shares.get(name, 0.0),
        )
        for name, delta_bic, trial in rows
    ]


def rmse_K(trial: TrialFit, problem: FitProblem) -> float:
    """RMSE of the fitted samples of a trial, or of those held out [K], a recorder's word taken at its middle.

    problem : over these samples;  returns NaN where they cannot be marched, and where the heating has an error: values
              that leave the rest to it are not those of a plain march

    They are predicted by the plain march, along the flight with its most probable error.
    """
    error = problem.record_fits[0].model_error
    if error is not None and error.sigma > 0.0:
        return math.nan
    try:
        samples = problem.samples(trial.fit.values)
        # what the fitted samples say of the flight: those held out inform nothing
        u = trial.problem.errors(trial.fit.values)[0]
    except RunError:
        return math.nan
    residuals = np.concatenate([
        0.5 * (s.channel.intervals.lower_K + s.channel.intervals.upper_K) - s.mean_K for s in samples
    ])  # fmt: skip
    part = problem.record_fits[0]
    if part.model_error is not None and part.error_root_K is not None:
        flight = part.model_error.of_flight
        residuals -= part.error_root_K[:, flight] @ u[flight]
    known = residuals[np.isfinite(residuals)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")


def _contents(closed: ClosedLoop) -> Estimate:
    """The contents of estimate.json: of the last fit, with the finding that its model has."""
    return estimate_contents(closed.fitted).model_copy(update={"finding": closed.report.statement.finding})


def write_closed_loop(closed: ClosedLoop, out: str | os.PathLike[str]) -> list[str]:
    """Write all files of a closed loop into a folder, or none.

    returns : names of closure.json, report.html, residual_heating.csv, and the last fit's estimate.json with its files
    """
    from sim_heating.closure.report import write_closure  # pages are above what is computed

    with output_directory(out, COMMAND, inputs=[closed.report.record.directory]) as folder:
        no_draws: list[Callable[[], object]] = []
        draws = or_left_out(lambda: write_fit_data(closed.fitted, _contents(closed), folder), no_draws, NAME)
        write_closure(closed.report, folder, draws)
    return sorted(files_written(out))
