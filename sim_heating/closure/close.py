"""Close the loop on a record, or on several jointly: search for what the model lacks, refit with it, and write the
results.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError, or_left_out
from sim_heating.base.files import files_written, output_directory
from sim_heating.base.parallel.processes import in_processes
from sim_heating.base.parallel.threads import one_thread
from sim_heating.base.parameters import CLOCK_SKEW, EFFECT_PREFIX, Parameter
from sim_heating.base.progress import Progress, no_progress
from sim_heating.closure.clues.record_checks import clock_fault, with_noise
from sim_heating.closure.clues.residual_heating import ResidualHeating, residual_heating
from sim_heating.closure.plain_marches import plain_marches
from sim_heating.closure.prior.model_error import SmoothFlightError
from sim_heating.closure.result import FILES as REPORT_FILES
from sim_heating.closure.result import PARTLY, Closure, JointClosure
from sim_heating.closure.search.joint_model import joined
from sim_heating.closure.search.joint_search import JointSearch, search_jointly
from sim_heating.closure.search.search import SearchResult, search_effects
from sim_heating.closure.search.trials import trial_fit
from sim_heating.closure.statement import closure_of, is_exact, joint_closure_of, probability_of
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.fit import FitResult, check_joint_records, estimate, fit_problem
from sim_heating.estimation.inference.newton import NewtonSettings
from sim_heating.estimation.inference.outliers import outlier_lines, without_outliers
from sim_heating.estimation.problem import FitOptions, FitProblem
from sim_heating.estimation.record_fit import LAG_NAME
from sim_heating.estimation.report.estimate_file import NAME, Estimate
from sim_heating.estimation.report.remarks import samples_in_words
from sim_heating.estimation.report.report import FIT_FILES, estimate_contents, write_fit_data
from sim_heating.inputs.averaged_record import averaged_record
from sim_heating.inputs.record import Record, load_record, load_records
from sim_heating.simulation.predict import Prediction

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

LOG = logging.getLogger(__name__)
COMMAND = "close-loop"
"""Name under which its results are listed."""
FILES = (*REPORT_FILES, NAME, *FIT_FILES)
"""Names of all files that a closed loop may write."""
REFIT = NewtonSettings(min_improvement=1e-3, min_step=0.02, iterations=30, trust_radius=trial_fit.QUICK.trust_radius)
"""Convergence of the last fit: far within its bounds; no step is longer than those of the search."""


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
        return self.report.after.plot()


@one_thread()
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
    wrong_clock = clock_fault(record)
    if wrong_clock is not None:
        raise InputError(wrong_clock.message)
    record, outliers = without_outliers(record)
    record, averaged = averaged_record(record)
    for line in averaged:
        progress(0.0, line)
    record, noise_lines = with_noise(record)
    notes = [*averaged, *outlier_lines(outliers, {record.name: record}), *noise_lines]
    result = _stated(search_effects(record, parameters, progress=lambda f, text: progress(0.8 * f, text)))
    progress(0.8, "refitting with the effects found; residual as heating")
    tasks: list[Callable[[], Any]] = [
        partial(_refitted, result),
        partial(_residual_after, result.before),
        partial(_before, result),
    ]
    (fitted, after, residual_after), residual, before = in_processes(tasks)
    compared = before, before if result.compared is result.none else after
    report = closure_of(result, fitted, compared, (residual, residual_after), notes)
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
    held_out = 0 if none.held_out is None else trial_fit.sample_count(none.held_out)
    return {"fit": trial_fit.sample_count(none.problem), "holdout": held_out, "left_out": left_out}


def _few_samples(samples: Mapping[str, Any]) -> list[str]:
    """Lines on readings that are left out, and on too few of them."""
    count = samples["fit"]
    few = f"{count} readings are fitted, and below {POLICY.min_samples_for_probability} no probability is given"
    lines = (samples_in_words(samples), few if count < POLICY.min_samples_for_probability else "")
    return [line for line in lines if line]


def _stated(result: SearchResult) -> SearchResult:
    """The result of a search, whose finding is stated where it is rather right than wrong."""
    probability = probability_of(result)
    if not result.explained or probability is None or probability >= POLICY.min_probability:
        return result
    return replace(result, conclusion=replace(result.conclusion, finding=PARTLY, improbable=probability))


def _refitted(result: SearchResult) -> tuple[FitResult, Prediction, ResidualHeating | None]:
    """The last fit, its plain prediction, and where a cause was found what is missing after it."""
    fitted = refit(result)
    return fitted, plain_marches(fitted)[0], _residual_after(fitted) if result.explained else None


def _before(result: SearchResult) -> Prediction:
    """The plain prediction of the declared model, as that of the last fit is made."""
    return plain_marches(_declared(result))[0]


def _declared(result: SearchResult) -> FitResult:
    """The declared model as the last fit is compared with it: of a model with an error, with the same error free, and
    as wide."""
    none, compared = result.none.last, result.compared.last.record_fit.model_error
    if is_exact(none):
        return result.before
    error = none.record_fit.model_error
    if compared is not None and error is not None:
        none = trial_fit.with_error(none, error.of_size(error.sigma, error.correlation, compared.flight_scale))
    return _fit_whole(result.record, none)


def _fit_whole(record: Record, trial: trial_fit.TrialFit) -> FitResult:
    """The whole record fitted with the model of a trial, and with the error that this has."""
    return fit_problem(_whole_problem(record, trial), trial.fit.values, settings=REFIT)


def _whole_problem(record: Record, trial: trial_fit.TrialFit) -> FitProblem:
    """The problem of a whole record with the model of a trial, and the error that this has, if any."""
    fit = trial.record_fit
    error, effects = fit.model_error, trial_fit.fitted_effects(trial)
    if error is None:
        options = FitOptions(effects, priors=refit_priors(trial))
        return FitProblem([record], fit.names, trial.problem.reference, options)
    options = FitOptions(effects, priors=trial.problem.priors, prior_scale=trial.problem.options.prior_scale)
    names = [n for n in fit.names if n not in fit.flight_names]
    problem = FitProblem([record], names, trial.problem.reference, options)
    problem.record_fits[0].sigma_K.update(fit.sigma_K)
    if isinstance(error.flight, SmoothFlightError):
        error = replace(error, flight=replace(error.flight, flown=record))
    problem = problem.with_model_error(error)
    return problem.with_flight_unknowns() if fit.flight_names else problem


def _residual_after(fitted: FitResult) -> ResidualHeating:
    """What the model of a fit lacks, as heating."""
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
    record, change, in_model = result.record, best.change, list[str]()
    if change is not None:
        if best.changed is not None:
            record = change.apply(record, best.changed.value)
            in_model = list(best.changed.estimates if change.in_model else [])
        if not best.added:
            return trial_fit.declared_fit(record, [*result.before.labels, *change.free] or None)
    last = best.last
    if not is_exact(last):
        return _fit_whole(record, last)
    return estimate(
        [record],
        [n for n in last.record_fit.names if n not in in_model],
        reference=dict(zip(RATIO_VARIABLES, last.problem.reference, strict=True)),
        effects=trial_fit.fitted_effects(last),
        priors=refit_priors(last),
        settings=replace(REFIT, first_values=trial_fit.fitted_values(last)),
    )


def refit_priors(trial: trial_fit.TrialFit) -> dict[str, Parameter]:
    """Priors of the last fit with the effects of a trial, by dotted name: those of the search.

    With the declared ones the last fit could end at other values than those that were ranked: a lag of 30 s is 60
    sigmas from that of a sensor which is attached as declared.
    """
    fit = trial.record_fit
    searched = trial.problem.parameters
    priors = {p.name: p for p in searched if p.name == CLOCK_SKEW.name or p.name.endswith(LAG_NAME)}
    for name in fit.march_names:
        if name.startswith(EFFECT_PREFIX):
            parameter = fit.model.definition(name)
            priors[name] = replace(parameter, sigma=trial_fit.WIDENED * parameter.sigma)
    return priors


def _contents(closed: ClosedLoop) -> Estimate:
    """The contents of estimate.json: of the last fit, with the finding that its model has."""
    return estimate_contents(closed.fitted).model_copy(update={"finding": closed.report.statement.finding})


def write_closed_loop(closed: ClosedLoop, out: str | os.PathLike[str]) -> list[str]:
    """Write all files of a closed loop into a folder, or none.

    returns : names of closure.json, report.html, residual_heating.csv, and the last fit's estimate.json with its files
    """
    from sim_heating.closure.report.record import write_closure  # pages are above what is computed

    with output_directory(out, COMMAND, inputs=[closed.report.record.directory]) as folder:
        marches = [(closed.report.before, closed.report.after)]
        or_left_out(lambda: write_fit_data(closed.fitted, _contents(closed), folder, marches), None, NAME)
        write_closure(closed.report, folder)
    return sorted(files_written(out))


# Several records ------------------------------------------------------------------------------------------------------


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
        from sim_heating.closure.report.records import residuals_figure  # matplotlib is slow to import

        return residuals_figure(self.report)


@one_thread()
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
    the flow in common (search/joint_model.py).

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
    search = search_jointly([loop.search for loop in loops], progress=lambda f, text: progress(0.75 + 0.2 * f, text))
    progress(0.95, "refitting with what the records have in common")
    fitted = None if search.compared.model is None else _refit_jointly(search)
    plain = [] if fitted is None else plain_marches(fitted)
    closure = joint_closure_of([loop.report for loop in loops], search, fitted, plain)
    return JointClosedLoop(tuple(loops), search, fitted, closure)


def _refit_jointly(search: JointSearch) -> FitResult:
    """The members of the best hypothesis that may be named, fitted to convergence on their full meshes and samples."""
    best = search.compared
    model = best.model
    assert model is not None
    records = [search.alone[i].record for i in model.members]
    if model.cause.change is not None:
        records = [model.cause.change.apply(record, 0.0) for record in records]
    problems = [_whole_problem(r, best.each[i]) for i, r in zip(model.members, records, strict=True)]
    problem = joined(problems, model.levels)
    values = {u.label: v for u, v in zip(model.problem.unknowns, best.last.fit.values, strict=True)}
    return fit_problem(problem, np.array([values[u.label] for u in problem.unknowns]), settings=REFIT)


def write_joint_loop(closed: JointClosedLoop, out: str | os.PathLike[str]) -> list[str]:
    """Write all files of a joint closed loop into a folder, and those of each record's own into one below it.

    returns : names of closure.json, report.html and records.csv
    """
    from sim_heating.closure.report.records import write_joint_closure  # pages are above what is computed

    for loop in closed.loops:
        write_closed_loop(loop, Path(out) / loop.report.record.name)
    inputs = [loop.report.record.directory for loop in closed.loops]
    with output_directory(out, COMMAND, inputs=inputs) as folder:
        write_joint_closure(closed.report, folder)
    return sorted(files_written(out))
