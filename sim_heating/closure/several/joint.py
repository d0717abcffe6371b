"""Close the loop on several records jointly: each by itself, then one cause in all of them, and the last fit."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sim_heating.base.errors import InputError
from sim_heating.base.files import files_written, output_directory
from sim_heating.base.parameters import AT
from sim_heating.base.progress import Progress, no_progress
from sim_heating.closure.close import (
    COMMAND,
    REFIT,
    ClosedLoop,
    close_loop,
    effect_parameters,
    error_problem,
    estimates_of,
    refit_priors,
    rmse_K,
    valued,
    write_closed_loop,
)
from sim_heating.closure.plain_marches import plain_marches
from sim_heating.closure.prior.model_error import SmoothFlightError
from sim_heating.closure.result import (
    NONE,
    UNKNOWN,
    CandidateScore,
    Finding,
    JointClosure,
    NotEffect,
    ParameterEstimate,
    Statement,
)
from sim_heating.closure.search.ranking import posteriors
from sim_heating.closure.search.tell_apart import Experiment
from sim_heating.closure.search.trials.told_error import told_flight
from sim_heating.closure.search.trials.trial_fit import TrialFit, fitted_effects, sample_count
from sim_heating.closure.several.joint_fit import JointHypothesis, joined
from sim_heating.closure.several.joint_search import JointSearch, search_jointly
from sim_heating.estimation.fit import FitResult, check_joint_records, fit_problem
from sim_heating.estimation.problem import FitOptions, FitProblem
from sim_heating.estimation.report.remarks import further_warnings, remarks
from sim_heating.inputs.record import Record, load_records
from sim_heating.simulation.predict import Prediction

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class JointClosedLoop:
    """Several records with their loops closed jointly.

    loops  : each record's own closed loop
    search : the joint search
    fitted : the last fit of the records with the best cause that may be named, all parameters with bounds; None where
             none is better than the declared models
    report : the contents of closure.json and of the page
    """

    loops: tuple[ClosedLoop, ...]
    search: JointSearch
    fitted: FitResult | None
    report: JointClosure

    def __repr__(self) -> str:
        return repr(self.report)

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the common effects; else `none` or `unknown`."""
        return tuple(effect.name for effect in self.report.effects)

    def plot(self) -> Figure:
        """Residuals of each record before and after."""
        from sim_heating.closure.several.joint_report import residuals_figure  # matplotlib is slow to import

        return residuals_figure(self.report)


def close_loops(
    records: Sequence[Record | str | os.PathLike[str]],
    parameters: Sequence[str] | None = None,
    *,
    progress: Progress = no_progress,
) -> JointClosedLoop:
    """Identify the cause that the declared models of several records lack in common, add it, refit.

    Each record is searched by itself first; the causes that lead in any of them are then fitted to all, with common
    parameters and with the records' own: magnitude and derivatives of the heating ratio, clocks and noise are always
    own. Records may be of one control point, or of neighbouring points of one vehicle: these have only parameters of
    the flow in common (several/joint_fit.py).

    records    : two flight records or more, or their directories
    parameters : dotted names that each declared model is fitted with, as `close_loop` takes them
    progress   : called with the fraction done, from 0 to 1, and a line of text
    returns    : the finding, what each record adds to it, the last fit with its bounds, temperatures [K] before, after
    raises     : InputError for a single record, two of one name, records of different vehicles, or ratios of one point
               over different reference heatings; InputError, RunError where the declared model of one cannot be fitted

    >>> import sim_heating as sh
    >>> flown = sh.synthesize("benchmarks/flights/sts2.toml")
    >>> sh.close_loops([flown["V07T9975"], flown["V07T9976"]])
    <JointClosedLoop of V07T9975, V07T9976: one of: impingement-onset + coating-thickness or heat-capacity, ...>
    """
    loaded = load_records(records)
    if len(loaded) < 2:
        raise InputError(f"close-loop, jointly: {len(loaded)} record; give two or more, or leave out --joint")
    check_joint_records(loaded, "close the loop on")
    vehicles = sorted({r.declared.vehicle for r in loaded})
    if len(vehicles) > 1:
        raise InputError(
            f"records: they are of different vehicles ({', '.join(vehicles)}) and can have no cause in common; close "
            "the loop on each record by itself"
        )
    loops = []
    for k, record in enumerate(loaded):

        def report(fraction: float, text: str, k: int = k, name: str = record.name) -> None:
            progress(0.75 * (k + fraction) / len(loaded), f"{name}: {text}")

        loops.append(close_loop(record, parameters, progress=report))
    return join(loops, progress=lambda f, text: progress(0.75 + 0.25 * f, text))


def join(loops: Sequence[ClosedLoop], *, progress: Progress = no_progress) -> JointClosedLoop:
    """The joint search over records whose own loops are closed, with its last fit."""
    search = search_jointly([loop.search for loop in loops], progress=lambda f, text: progress(0.8 * f, text))
    progress(0.8, "refitting with what the records have in common")
    if search.compared.model is None:
        return JointClosedLoop(tuple(loops), search, None, _report(loops, search, None, []))
    fitted = _refit(search)
    return JointClosedLoop(tuple(loops), search, fitted, _report(loops, search, fitted, plain_marches(fitted)))


def write_joint_loop(closed: JointClosedLoop, out: str | os.PathLike[str]) -> list[str]:
    """Write all files of a joint closed loop into a folder, and those of each record's own into one below it.

    returns : names of closure.json, report.html and records.csv
    """
    from sim_heating.closure.several.joint_report import write_joint_closure  # pages are above what is computed

    for loop in closed.loops:
        write_closed_loop(loop, Path(out) / loop.report.record.name)
    inputs = [loop.report.record.directory for loop in closed.loops]
    with output_directory(out, COMMAND, inputs=inputs) as folder:
        write_joint_closure(closed.report, folder)
    return sorted(files_written(out))


def _refit(search: JointSearch) -> FitResult:
    """The members of the best hypothesis that may be named, fitted to convergence on their full meshes and samples."""
    best = search.compared
    model = best.model
    assert model is not None
    trials = [best.by_record[i] for i in model.members]
    records = [search.alone[i].record for i in model.members]
    if model.cause.change is not None:
        records = [model.cause.change.apply(record, 0.0) for record in records]
    problem = joined([_full_problem(t, r) for t, r in zip(trials, records, strict=True)], model.levels)
    values = {u.label: v for u, v in zip(model.problem.unknowns, best.last.fit.values, strict=True)}
    return fit_problem(problem, np.array([values[u.label] for u in problem.unknowns]), settings=REFIT)


def _full_problem(trial: TrialFit, record: Record) -> FitProblem:
    """A trial's model over the whole record."""
    part = trial.problem.record_fits[0]
    if part.model_error is not None:
        return error_problem(record, trial)
    options = FitOptions(fitted_effects(trial), priors=refit_priors(trial))
    return FitProblem([record], part.names, trial.problem.reference, options)


def _report(
    loops: Sequence[ClosedLoop], search: JointSearch, fitted: FitResult | None, plain: Sequence[Prediction]
) -> JointClosure:
    """The results of a joint search and its refit, for the report.

    plain : of the members of the best hypothesis that may be named, after the last fit
    """
    best, conclusion = search.best, search.conclusion
    after = [loop.report.before for loop in loops]
    for i, prediction in zip(search.compared.members if plain else (), plain, strict=True):
        after[i] = prediction
    estimated = {} if fitted is None else estimates_of(fitted.problem, fitted.fit, fitted.bounds.sigma)
    shares = posteriors({" + ".join(h.names): h.score for h in search.hypotheses if h.admissible} | {NONE: 0.0})
    if search.explained and best.kind == "effect":
        share = shares[" + ".join(best.names)]
        effects = (
            [Finding(c.name, share, _parameters(best, c.name, estimated)) for c in best.model.cause.candidates]
            if best.model
            else []
        )
    else:
        name = conclusion.effect_name
        effects = [Finding(name, shares[NONE] if name == NONE else 1.0 - shares[NONE], {})]
    judged = conclusion.best if conclusion.finding != UNKNOWN else search.none
    return JointClosure(
        closures=[loop.report for loop in loops],
        search=search,
        effects=effects,
        statement=Statement(
            finding=conclusion.finding,
            alternatives=[list(names) for names in conclusion.alternatives],
            adequacy=judged.adequacy,
            explained=conclusion.explained,
            not_effects=_not_effects(best, estimated) if search.explained else [],
            converged=fitted is None or fitted.fit.converged,
            would_tell_apart=_would_tell_apart(loops, conclusion.alternatives),
            alternative_values=_alternative_values(search),
        ),
        candidates=_candidates(search, shares),
        parameters=estimated,
        after=after,
        warnings=() if fitted is None else _warnings(fitted),
        flights={} if fitted is None else _flights(fitted),
    )


def _flights(fitted: FitResult) -> dict[str, dict[str, tuple[float, float] | None]]:
    """By flight, the error that points of it have in common, by name."""
    found = {}
    for part in fitted.problem.record_fits:
        error = part.model_error
        if error is None or not part.flight_names or not isinstance(error.flight, SmoothFlightError):
            continue
        at = part.index[-len(part.flight_names) :]
        covariance = fitted.fit.covariance[np.ix_(at, at)]
        found[part.record.flight] = told_flight(error.flight, fitted.fit.values[at], covariance)
    return found


def _warnings(fitted: FitResult) -> list[str]:
    """Warnings on a joint fit, and remarks on its estimates."""
    found = remarks(fitted)
    return [*(remark.in_words for remark in found), *further_warnings(fitted.warnings, found)]


def _would_tell_apart(loops: Sequence[ClosedLoop], alternatives: Sequence[Sequence[str]]) -> list[Experiment]:
    """What is expected to tell a joint set apart, by the records that have the same set by themselves."""
    sets = {frozenset(names) for names in alternatives if len(names) > 1}
    best: dict[str, Experiment] = {}
    for statement in (loop.report.statement for loop in loops):
        if sets and sets == {frozenset(names) for names in statement.alternatives if len(names) > 1}:
            for e in statement.would_tell_apart:
                best[e.what] = max(best.get(e.what, e), e, key=lambda x: x.log_odds)
    return sorted(best.values(), key=lambda e: -e.log_odds)


def _alternative_values(search: JointSearch) -> dict[str, dict[str, ParameterEstimate]]:
    """Estimates of each member of a set, or of what the records resemble: of the best joint hypothesis with it."""
    named, values = [h for h in search.hypotheses if h.admissible], {}
    for name in valued(search.conclusion):
        found = next((h for h in named if name in h.names), None)
        if found is None or found.model is None:
            continue
        if own := _parameters(found, name, estimates_of(found.model.problem, found.last.fit)):
            values[name] = own
    return values


def _parameters(
    best: JointHypothesis, cause: str, estimated: Mapping[str, ParameterEstimate]
) -> dict[str, ParameterEstimate]:
    """The estimates of a cause by their names within it; a point's or a record's own as `name@owner`."""
    assert best.model is not None
    candidate = next((c for c in best.model.cause.candidates if c.name == cause), None)
    if candidate is None:  # a change without a parameter, as another material
        return {}
    trial, found = TrialFit(cause, candidate, best.last.problem, None, best.last.fit), {}
    for label, estimate in estimated.items():
        name, at, whose = label.partition(AT)
        found.update({f"{short}{at}{whose}": e for short, e in effect_parameters(trial, {name: estimate}).items()})
    return found


def _not_effects(best: JointHypothesis, estimated: dict[str, ParameterEstimate]) -> list[NotEffect]:
    """The common cause, where it is no effect."""
    if best.model is None or best.kind == "effect":
        return []
    names = best.model.cause.candidate.names
    own = {label: e for label, e in estimated.items() if label.partition(AT)[0] in names}
    values = ", ".join(f"{e.value:.4g} +- {e.sigma:.2g}" for e in own.values())
    what = " + ".join(best.names)
    return [NotEffect(best.kind, f"{what}: {values}" if values else what, own)]


def _candidates(search: JointSearch, shares: dict[str, float]) -> list[CandidateScore]:
    """All causes that were fitted jointly, and none."""

    def score(name: str, h: JointHypothesis, delta_bic: float) -> CandidateScore:
        fitted = [(rmse_K(t, t.problem), sample_count(t.problem)) for t in h.by_record]
        held_out = [(rmse_K(t, t.held_out), sample_count(t.held_out)) for t in h.by_record if t.held_out]
        return CandidateScore(name, delta_bic, _pooled(fitted), _pooled(held_out) if held_out else None,
                              shares.get(name, 0.0))  # fmt: skip

    rows = [score(" + ".join(h.names), h, h.delta_bic(search.none)) for h in search.hypotheses]
    return [score(NONE, search.none, 0.0), *rows]


def _pooled(found: Sequence[tuple[float, int]]) -> float:
    """RMSE [K] over all samples of several (RMSE [K], number of samples)."""
    total = sum(n for _, n in found)
    return float(np.sqrt(sum(n * rmse**2 for rmse, n in found) / total))
