"""What a search states, with its last fit, as data for the report (result.py): of one record, and of several."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import RunError, or_left_out
from sim_heating.base.parameters import AT, MODEL, SENSOR_PREFIX
from sim_heating.closure.clues.correlation import ratio_at, residual_evidence
from sim_heating.closure.clues.record_checks import TRAJECTORY, DataFault, magnitude_fault, start_fault
from sim_heating.closure.clues.residual_heating import ResidualHeating
from sim_heating.closure.curves import curve_of
from sim_heating.closure.prior.model_error import SmoothFlightError
from sim_heating.closure.prior.table import table_error, table_findings, table_prior
from sim_heating.closure.result import (
    NONE,
    PARTLY,
    UNKNOWN,
    Barred,
    CandidateScore,
    Closure,
    Finding,
    JointClosure,
    NotEffect,
    ParameterEstimate,
    Statement,
)
from sim_heating.closure.search.changes.record_change import ENDS_MOVED
from sim_heating.closure.search.hypothesis import Compared, Conclusion, Hypothesis
from sim_heating.closure.search.joint_search import JointSearch
from sim_heating.closure.search.ranking import posteriors
from sim_heating.closure.search.search import SearchResult
from sim_heating.closure.search.table_candidates import TABLE
from sim_heating.closure.search.tell_apart import Experiment, tell_apart
from sim_heating.closure.search.trials.told_error import told_error, told_flight
from sim_heating.closure.search.trials.trial_fit import TrialFit, sample_count
from sim_heating.closure.verdict.calibration import false_alarm_statement, features, probability
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.fit import FitResult
from sim_heating.estimation.inference.newton import Fit
from sim_heating.estimation.problem import FitProblem
from sim_heating.estimation.report.remarks import further_warnings, remarks
from sim_heating.estimation.report.report import noise_floor_K
from sim_heating.heating.effects import effects
from sim_heating.heating.effects.added_curve import ADDED_CURVE
from sim_heating.heating.effects.curve import FIRST, LABELS, UNITS, VALUES, CurveBand
from sim_heating.simulation.predict import Prediction

SENSOR_PARAMETERS = {"bias": "bias_K", "gain": "gain", "tau_s": "tau_s", "drift": "drift_K_s"}
"""Parameters of a sensor by their names in closure.json."""


# One record -----------------------------------------------------------------------------------------------------------


def closure_of(
    result: SearchResult,
    fitted: FitResult,
    compared: tuple[Prediction, Prediction],
    residuals: tuple[ResidualHeating, ResidualHeating | None],
    notes: Sequence[str] = (),
) -> Closure:
    """The results of a search and its refit, for the report.

    compared  : plain predictions of the declared model and of the best that may be named [K]
    residuals : as heating, of the declared model and, where a cause was found, after the last fit
    notes     : on the record; they come first of its warnings
    """
    before, (residual, residual_after) = result.before, residuals
    estimated = estimates_of(fitted.problem, fitted.fit, fitted.bounds.sigma)
    not_effects = _not_effects(result)
    of_trajectory = [DataFault(TRAJECTORY, d.message) for d in result.discrepancies]
    of_magnitude = magnitude_fault(fitted.problem, fitted.fit.values)
    faults = list(filter(None, (start_fault(result.record), *of_trajectory, of_magnitude)))
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
        statement=_statement(
            result,
            fitted,
            [*_left_out(result), *not_effects],
            or_left_out(
                lambda: tell_apart(result.none, result.conclusion.best, _rivals(result)),
                [],
                "what would tell causes apart",
            ),
            probability=probability_of(result),
            improbable=result.conclusion.improbable,
            experiment="flight" if result.record.has_flow else "test",
            resembles=_resembles(result),
            model_error=told_error(result.compared.last),
            barred=_barred(result),
        ),
        curve=or_left_out(lambda: _curve(result), None, "curve that the residual follows"),
        faults=[] if not_effects else faults,
        false_alarm=false_alarm_statement() if is_exact(result.none.last) else "",
        warnings=[
            *notes,
            *(line for line in fitted.warnings if line not in {*notes, *(f.message for f in faults)}),
            *_forms(result),
            *_residual_warning(result, residual_after),
        ],
        remarks=remarks(fitted),
    )


def is_exact(trial: TrialFit) -> bool:
    """Whether the model of a trial has no error of its own."""
    return trial.record_fit.model_error is None


def _curve(result: SearchResult) -> CurveBand | None:
    """The curve that an unexplained residual follows; None where it explains less than half of it."""
    curve = result.curve
    if curve is None or curve.excess_chi2 > POLICY.min_explained * result.none.excess_chi2:
        return None
    return curve_of(curve)


def _resembles(result: SearchResult) -> list[str]:
    """Names of the best model that may be named, where what it is of is not stated as the cause."""
    if result.conclusion.finding not in (PARTLY, UNKNOWN):
        return []
    return [_in_words(result, name) for name in result.compared.names]


def _barred(result: SearchResult) -> list[Barred]:
    """Models that fit better than the best that may be named, with the reason for which they may not be."""
    most_barred = 5  # models that may not be named, which are listed at most
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
    return probability(conclusion.finding, features_of(conclusion)) if is_exact(result.none.last) and not few else None


def features_of(conclusion: Conclusion) -> FloatArray:
    """(feature,) what the probability of a conclusion follows from [-]."""
    return features(
        conclusion.finding,
        conclusion.rival,
        conclusion.best.adequacy.p_value,
        conclusion.explained,
        len(conclusion.alternatives),
        conclusion.disqualified,
        conclusion.best.kind not in ("", "effect"),
    )


def _rivals(result: SearchResult) -> list[Hypothesis]:
    """The best hypothesis with each name that the record cannot tell from the one named first."""
    best = result.conclusion.best
    others = [name for names in result.conclusion.alternatives for name in names if name not in best.names]
    rivals = [next((h for h in result.hypotheses if h.admissible and name in h.names), None) for name in others]
    return [h for h in dict.fromkeys(rivals) if h is not None]


def _not_effects(result: SearchResult) -> list[NotEffect]:
    """The cause that was found, where it is no effect; else errors of the table that the declared model shows."""
    best = result.conclusion.best
    if result.explained:
        return [replace(cause, probability=probability_of(result)) for cause in _causes(best)]
    if result.conclusion.finding != NONE:
        return []
    labels = result.before.labels
    prior, none = table_prior(result.record, labels, result.before.problem.reference), result.none.last
    # the first fit has flat priors; one with an error of the model has that of the table in it
    of_first = result.before.fit, result.before.bounds.covariance
    findings = table_findings(*(of_first if is_exact(none) else (none.fit, none.fit.covariance)), prior)
    return [
        NotEffect("table", f.what, {n: ParameterEstimate(v, s, MODEL[n].unit) for n, (v, s) in f.parameters.items()})
        for f in findings
    ]


def _left_out(result: SearchResult) -> list[NotEffect]:
    """Thermocouples that are stuck in all their readings: every fit leaves them out."""
    fitted = {s.name for s in result.before.problem.record_fits[0].record.used_sensors}
    stuck = [s for s in result.record.used_sensors if s.name not in fitted]
    return [
        NotEffect("sensor", f"{s.name} stuck at {np.nanmax(result.record.thermocouples[s.column]):.1f} K throughout")
        for s in stuck
    ]


def _causes(h: Hypothesis) -> list[NotEffect]:
    """Causes of a hypothesis that are no effect, with their estimates."""
    causes, change, changed = [], h.change, h.changed
    if change is not None and changed is not None and not change.effect:
        causes.append(NotEffect(h.kind, change.describe(changed.value), _of_change(changed)))
    for trial in h.trials:
        if trial.name == TABLE:
            name = trial.candidate.names[0]
            estimate = estimates_of(h.last.problem, h.last.fit)[name]
            causes.append(NotEffect("table", table_error(name, estimate.value), {name: estimate}))
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


def _candidate_scores(result: SearchResult) -> list[CandidateScore]:
    """All single causes, as they were compared; those that were not fitted have their predicted BIC, and errors as
    before."""
    first = result.first
    scored = {h.names[0]: h for h in reversed(result.hypotheses) if len(h.names) == 1}
    shares = _shares(scored.values())
    rows = [(NONE, 0.0, result.none.last)]
    rows += [(h.names[0], h.delta_bic(result.none), h.last) for h in scored.values()]
    rows += [(t.name, t.delta_bic, t) for t in first.trials if t.name not in scored]
    rows += [(name, delta, result.none.last) for name, delta in first.screened_out.items() if name not in scored]
    return [_candidate_score(name, delta, [trial], shares) for name, delta, trial in rows]


def _shares(hypotheses: Iterable[Hypothesis]) -> dict[str, float]:
    """By names of causes, the probability of each hypothesis that may be named, and of the declared model."""
    return posteriors({" + ".join(h.names): h.score for h in hypotheses if h.admissible} | {NONE: 0.0})


# One record or several ------------------------------------------------------------------------------------------------


def _statement(
    search: Compared,
    fitted: FitResult | None,
    not_effects: Sequence[NotEffect],
    experiments: Sequence[Experiment],
    **of_record: Any,
) -> Statement:
    """The finding with its alternatives and its adequacy.

    fitted      : the last fit, None without one;  experiments : that would tell the alternatives apart
    of_record   : further fields, of the statement on a single record
    """
    conclusion = search.conclusion
    best = conclusion.best if conclusion.finding != UNKNOWN else search.none
    return Statement(
        finding=conclusion.finding,
        alternatives=[[_in_words(search, name) for name in names] for names in conclusion.alternatives],
        adequacy=best.adequacy,
        explained=conclusion.explained,
        not_effects=not_effects,
        converged=fitted is None or fitted.fit.converged,
        would_tell_apart=experiments,
        alternative_values=_alternative_values(search),
        **of_record,
    )


def _in_words(search: Compared, name: str) -> str:
    """An alternative as the report has it: the name of an effect, another cause with its value."""
    hypotheses = [search.conclusion.best, *(h for h in search.hypotheses if h.names == (name,))]
    of_record = [h for h in hypotheses if h.model is None and name in {*h.names} - {*h.effects}]
    causes = [cause for h in of_record for cause in _causes(h)]
    return next((c.what for c in causes if (c.kind == "table") == (name == TABLE)), name)


def _alternative_values(search: Compared) -> dict[str, dict[str, ParameterEstimate]]:
    """Estimates of each cause whose values no last fit has, all of a set and what a record resembles, by its name in
    the report: of the best hypothesis with it, as the search fitted it."""
    conclusion = search.conclusion
    sets = [names for names in conclusion.alternatives if len(names) > 1 or conclusion.finding == PARTLY]
    hypotheses = [conclusion.best, *(h for h in search.hypotheses if h.admissible)]
    values = {}
    for name in chain.from_iterable(sets):
        if estimates := _values_of(hypotheses, name):
            values[_in_words(search, name)] = estimates
    return values


def _values_of(hypotheses: Sequence[Hypothesis], name: str) -> dict[str, ParameterEstimate]:
    """Estimates of a cause by their names within it, of the first hypothesis with it; empty where none has it."""
    h = next((h for h in hypotheses if name in {*h.names, *h.effects}), None)
    if h is None:
        return {}
    estimated = estimates_of(h.last.problem, h.last.fit)
    if h.changed is not None and h.change is not None and h.change.name == name:
        return change_parameters(h.changed, estimated)
    return effect_parameters(next(t for t in h.trials if t.name == name), estimated)


def _findings(search: Compared, estimated: Mapping[str, ParameterEstimate]) -> list[Finding]:
    """The effects found; "none" or "unknown" where there are none."""
    best, shares = search.conclusion.best, _shares(reversed(search.hypotheses))
    if not _names_effects(search):
        name = search.conclusion.effect_name
        return [Finding(name, shares[NONE] if name == NONE else 1.0 - shares[NONE], {})]
    posterior = shares[" + ".join(best.names)]
    of_change = [best.changed] if best.changed is not None and best.change is not None and best.change.effect else []
    return [
        *(Finding(f.change.effect, posterior, change_parameters(f, estimated)) for f in of_change if f.change),
        *(Finding(t.name, posterior, effect_parameters(t, estimated), _sensor_of(t)) for t in best.added),
    ]


def _names_effects(search: Compared) -> bool:
    """Whether effects are the cause; what several records have in common may be another one, as a wrong wall."""
    best = search.conclusion.best
    return search.explained and bool(best.effects) and (best.model is None or best.kind == "effect")


def estimates_of(problem: FitProblem, fit: Fit, sigma: FloatArray | None = None) -> dict[str, ParameterEstimate]:
    """The estimates of a fit by label, by default with the bounds of its information."""
    pairs = zip(problem.unknowns, fit.values, fit.sigma if sigma is None else sigma, strict=True)
    return {u.label: ParameterEstimate(float(v), float(s), u.parameter.unit) for u, v, s in pairs}


def _of_change(changed: TrialFit) -> dict[str, ParameterEstimate]:
    """The estimate of the parameter of a change by its name; none for a change without one."""
    return {name: ParameterEstimate(value, sigma, p.unit) for name, (p, value, sigma) in changed.estimates.items()}


def change_parameters(changed: TrialFit, estimated: Mapping[str, ParameterEstimate]) -> dict[str, ParameterEstimate]:
    """The estimates of a change that is an effect: its own, those of the model's parameters that are estimated with it,
    and its ends, to the last step of their search."""
    change = changed.change
    assert change is not None
    estimates = _of_change(changed) | {n.rpartition(".")[2]: estimated[n] for n in change.free if n in estimated}
    values = [value for value, _ in change.ends.values()]
    step = ENDS_MOVED[-1] * (max(values, default=0.0) - min(values, default=0.0))
    return estimates | {name: ParameterEstimate(value, step, unit) for name, (value, unit) in change.ends.items()}


def effect_parameters(trial: TrialFit, estimated: Mapping[str, ParameterEstimate]) -> dict[str, ParameterEstimate]:
    """The estimates of an effect by their names within it; a point's or a record's own as `name@owner`."""
    effect = effects().get(trial.name)
    estimates: dict[str, ParameterEstimate] = {}
    for name in trial.candidate.names:
        if name.startswith(SENSOR_PREFIX):
            short = SENSOR_PARAMETERS[name.rpartition(".")[2]]
        else:
            short = (effect and effect.own_name(name)) or name.rpartition(".")[2]
        labels = [label for label in estimated if label.partition(AT)[0] == name]
        estimates |= {f"{short}{label.removeprefix(name)}": estimated[label] for label in labels}
    return estimates


def _sensor_of(trial: TrialFit) -> str | None:
    """The thermocouple that an effect is of; None where it is of no single one."""
    first = trial.candidate.names[0]
    return first.removeprefix(SENSOR_PREFIX).rpartition(".")[0] if first.startswith(SENSOR_PREFIX) else None


def _candidate_score(
    name: str, delta_bic: float, trials: Sequence[TrialFit], shares: Mapping[str, float]
) -> CandidateScore:
    """One candidate with its errors over all records; trials : of it, one a record;  shares : probability by name."""
    fitted = [(t, t.problem) for t in trials]
    held_out = [(t, t.held_out) for t in trials if t.held_out is not None]
    rmse = _pooled_rmse_K(held_out) if held_out else None
    return CandidateScore(name, delta_bic, _pooled_rmse_K(fitted), rmse, shares.get(name, 0.0))


def _pooled_rmse_K(trials: Sequence[tuple[TrialFit, FitProblem]]) -> float:
    """RMSE over all samples of trials, each with the problem over its samples [K]."""
    errors = [(rmse_K(t, p), sample_count(p)) for t, p in trials]
    if len(errors) == 1:
        return errors[0][0]
    return float(np.sqrt(sum(n * rmse**2 for rmse, n in errors) / sum(n for _, n in errors)))


def rmse_K(trial: TrialFit, problem: FitProblem) -> float:
    """RMSE of the fitted samples of a trial, or of those held out [K], a recorder's word taken at its middle.

    problem : over these samples;  returns NaN where they cannot be marched, and where the heating has an error: values
              that leave the rest to it are not those of a plain march

    They are predicted by the plain march, along the flight with its most probable error.
    """
    fit = problem.record_fits[0]
    if fit.model_error is not None and fit.model_error.sigma > 0.0:
        return math.nan
    try:
        samples = problem.samples(trial.fit.values)
        # what the fitted samples say of the flight: those held out inform nothing
        u = trial.problem.errors(trial.fit.values)[0]
    except RunError:
        return math.nan
    residuals = np.concatenate([s.channel.intervals.centre_K - s.mean_K for s in samples])
    if fit.model_error is not None and fit.error_root_K is not None:
        flight = fit.model_error.of_flight
        residuals -= fit.error_root_K[:, flight] @ u[flight]
    finite = residuals[np.isfinite(residuals)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else float("nan")


# Several records ------------------------------------------------------------------------------------------------------


def joint_closure_of(
    closures: Sequence[Closure], search: JointSearch, fitted: FitResult | None, plain: Sequence[Prediction]
) -> JointClosure:
    """The results of a joint search and its refit, for the report.

    closures : each record by itself;  fitted : the last fit, None without one
    plain    : predictions of the members of the best hypothesis that may be named, after the last fit [K]
    """
    best, conclusion = search.best, search.conclusion
    after = [closure.before for closure in closures]
    for i, prediction in zip(search.compared.members if plain else (), plain, strict=True):
        after[i] = prediction
    estimated, flights, warnings = dict[str, ParameterEstimate](), dict[str, Any](), list[str]()
    if fitted is not None:
        estimated, flights = estimates_of(fitted.problem, fitted.fit, fitted.bounds.sigma), _flights(fitted)
        noted = remarks(fitted)
        warnings = [*(r.in_words for r in noted), *further_warnings(fitted.warnings, noted)]
    shares, rows = _shares(search.hypotheses), [(NONE, 0.0, search.none)]
    rows += [(" + ".join(h.names), h.delta_bic(search.none), h) for h in search.hypotheses]
    not_effects = _common_not_effects(best, estimated) if search.explained else []
    return JointClosure(
        closures=closures,
        search=search,
        effects=_findings(search, estimated),
        statement=_statement(search, fitted, not_effects, _experiments(closures, conclusion.alternatives)),
        candidates=[_candidate_score(name, delta, h.by_record, shares) for name, delta, h in rows],
        parameters=estimated,
        after=after,
        warnings=warnings,
        flights=flights,
    )


def _flights(fitted: FitResult) -> dict[str, dict[str, tuple[float, float] | None]]:
    """By flight, the error that points of it have in common, by name."""
    flights = {}
    for fit in fitted.problem.record_fits:
        error = fit.model_error
        if error is None or not fit.flight_names or not isinstance(error.flight, SmoothFlightError):
            continue
        at = fit.index[-len(fit.flight_names) :]
        covariance = fitted.fit.covariance[np.ix_(at, at)]
        flights[fit.record.flight] = told_flight(error.flight, fitted.fit.values[at], covariance)
    return flights


def _experiments(closures: Sequence[Closure], alternatives: Sequence[Sequence[str]]) -> list[Experiment]:
    """What is expected to tell a joint set apart, by the records that have the same set by themselves."""
    sets = {frozenset(names) for names in alternatives if len(names) > 1}
    best: dict[str, Experiment] = {}
    for statement in (closure.statement for closure in closures):
        if sets and sets == {frozenset(names) for names in statement.alternatives if len(names) > 1}:
            for e in statement.would_tell_apart:
                best[e.what] = max(best.get(e.what, e), e, key=lambda x: x.log_odds)
    return sorted(best.values(), key=lambda e: -e.log_odds)


def _common_not_effects(best: Hypothesis, estimated: Mapping[str, ParameterEstimate]) -> list[NotEffect]:
    """The common cause, where it is no effect."""
    if best.model is None or best.kind == "effect":
        return []
    names = best.model.cause.candidate.names
    estimates = {label: e for label, e in estimated.items() if label.partition(AT)[0] in names}
    values = ", ".join(f"{e.value:.4g} +- {e.sigma:.2g}" for e in estimates.values())
    cause = " + ".join(best.names)
    return [NotEffect(best.kind, f"{cause}: {values}" if values else cause, estimates)]
