"""The model that candidates are added to, and one candidate fitted on top of it.

The search marches a thinned record: samples of its conditions are omitted where they are as good as linear, and the
mesh has a third of the nodes. The change that this makes at the declared model is added as a correction. Segments held
out are marched in the same way and never fitted; how well a candidate predicts them is evidence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.parameters import CLOCK_SKEW, EFFECT_PREFIX, RATIO, Parameter
from sim_heating.closure.prior.model_error import clock_prior, flight_error, flight_scales, heating_error_prior
from sim_heating.closure.prior.table import table_prior, undeclared_derivatives
from sim_heating.closure.search.trials.candidates import NO_EFFECT, Candidate
from sim_heating.closure.search.trials.change import RecordChange
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.fit import FitResult, declared_model, estimate, predict_fit, rms_normalised_residual
from sim_heating.estimation.inference.bounds import ChannelResiduals, spectral_density
from sim_heating.estimation.inference.breaks import finer_knots
from sim_heating.estimation.inference.conditions_noise import heating_noise
from sim_heating.estimation.inference.error_likelihood import (
    ErrorState,
    even_knots_s,
    form_root_K,
    innovations,
    model_error,
    noise_error,
    parameter_root_K,
)
from sim_heating.estimation.inference.error_size import error_size
from sim_heating.estimation.inference.likelihood import likelihood, log_likelihood
from sim_heating.estimation.inference.model_error import ErrorSize, HeatingErrorPrior, ModelError
from sim_heating.estimation.inference.newton import Fit, NewtonSettings
from sim_heating.estimation.inference.observability import default_names, parameters_without_heating
from sim_heating.estimation.problem import FitOptions, FitProblem
from sim_heating.estimation.record_fit import (
    SKEW_SPAN_S,
    PredictedSamples,
    RecordFit,
    least_sigma_K,
    parameter_definition,
    take_error,
)
from sim_heating.estimation.side_by_side import maximise_together
from sim_heating.heating.effects import EffectUse, effects
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import Record
from sim_heating.simulation.predict import Prediction
from sim_heating.thermal.frame import NOT_CONTROLLED_K

WIDENED = 3.0
"""Factor on the sigma of effects' priors in the search, which only keep a first step within reason; not on the priors
of the declared table, which are part of the model."""
OF_TABLE = tuple(p.name for p in RATIO)
"""Magnitude and derivatives: parameters that a declared table has a prior for."""
QUICK = NewtonSettings(
    min_improvement=0.05,
    min_step=0.2,
    iterations=25,
    step_fractions=(0.5, 0.25, 0.1, 0.03, 0.01, 1e-3),
    trust_radius=0.4,
    unlimited=OF_TABLE,
)
CONVERGE = replace(QUICK, min_improvement=0.02, min_step=0.1, iterations=60)


@dataclass(frozen=True, eq=False, repr=False)
class TrialFit:
    """One candidate fitted on top of a model.

    name      : of its effect
    problem   : over the fitted samples;  held_out : over those held out, None where there are none
    delta_bic : its BIC minus that of the model without it, residuals taken as noise (c = 1)
    score     : the BIC difference with c of the best model, held-out segments, forms and priors included
    size      : what the readings say of the size of its model's error, responses taken about its own values; None as
                long as the error is that of the base
    exact_forms : the same with exact forms of its causes, where these have an error; None where they are exact
    objections : why it may not be named, empty where it may; known of candidates fitted to convergence
    change    : of the record, where the problem is over a changed one
    value, sigma : of the parameter of the change with its standard deviation, in its unit; 0 where it has none
    whole_fit : of all unknowns, the parameter of the change last
    """

    name: str
    candidate: Candidate
    problem: FitProblem
    held_out: FitProblem | None
    fit: Fit
    delta_bic: float = 0.0
    score: float = 0.0
    size: ErrorSize | None = None
    exact_forms: TrialFit | None = None
    objections: tuple[str, ...] = ()
    change: RecordChange | None = None
    value: float = 0.0
    sigma: float = 0.0
    whole_fit: Fit | None = None

    @property
    def record_fit(self) -> RecordFit:
        """The fitted samples of its record; of several records those of the first."""
        return self.problem.record_fits[0]

    @property
    def admissible(self) -> bool:
        """Whether it may be named."""
        return not self.objections

    @property
    def deviation(self) -> float:
        """Distance of the value of a change from the neutral one over the sigma that is usual [-]; 0 without one."""
        parameter = None if self.change is None else self.change.parameter
        return 0.0 if parameter is None else abs(self.value - parameter.value) / parameter.sigma

    def definitions(self, names: Sequence[str]) -> dict[str, Parameter]:
        """Definitions of parameters by dotted name, with the scatter that is declared or usual."""
        return {n: parameter_definition(self.record_fit.record, self.record_fit.model, n) for n in names}

    def deviations_of(self, names: Sequence[str]) -> list[float]:
        """Distances of estimated parameters from their declared values, in standard deviations [-]."""
        values = fitted_values(self)
        return [abs(values[n] - p.value) / p.sigma for n, p in self.definitions(names).items()]

    @property
    def deviations_of_free(self) -> list[float]:
        """Distance of each model parameter freed with a change from its prior, in standard deviations [-]."""
        return self.deviations_of(self.change.free if self.change else ())

    @property
    def estimates(self) -> dict[str, tuple[Parameter, float, float]]:
        """Parameter of the change, value and standard deviation by its name; none for a change without one."""
        parameter = None if self.change is None else self.change.parameter
        return {} if parameter is None else {parameter.name: (parameter, self.value, self.sigma)}

    @property
    def log_evidence(self) -> float:
        """Log likelihood of the fitted samples, the size of the model's error integrated out where it is known [-]."""
        error = self.problem.record_fits[0].model_error
        if self.size is None or error is None:
            return self.fit.log_likelihood
        return self.fit.log_likelihood + self.size.evidence - self.size.at(error)

    @property
    def prediction(self) -> Prediction:
        """The plain prediction of the record at the estimates."""
        return predict_fit(self.problem.record_fits[0], self.fit.values)

    @cached_property
    def _predicted(self) -> tuple[list[PredictedSamples], ErrorState | None]:
        """The fitted samples, each predicted from those before it, and what is then known of the heating's error."""
        record_fit = self.problem.record_fits[0]
        return innovations(record_fit, self.problem.samples(self.fit.values))

    @property
    def fitted_samples(self) -> list[PredictedSamples]:
        """The fitted samples, each predicted from those before it where the heating has an error."""
        return self._predicted[0]

    @property
    def known_error(self) -> ErrorState | None:
        """What the fitted samples say of the error of the model; None without one."""
        return self._predicted[1]

    @cached_property
    def held_out_samples(self) -> list[PredictedSamples]:
        """The samples held out, predicted from the fitted ones; none where there are none.

        raises : RunError where they cannot be marched
        """
        if self.held_out is None:
            return []
        return innovations(self.held_out.record_fits[0], self._held_out_plain, self.known_error)[0]

    @cached_property
    def _held_out_plain(self) -> list[PredictedSamples]:
        """The samples held out, predicted without an error; none where there are none.

        raises : RunError where they cannot be marched
        """
        return [] if self.held_out is None else self.held_out.samples(self.fit.values)

    @property
    def has_error(self) -> bool:
        """Whether heating or flight of its model have an error, and not only noise."""
        error = self.problem.record_fits[0].model_error
        return error is not None and not error.is_noise_alone

    @property
    def _held_out_integrated(self) -> list[PredictedSamples]:
        """The samples held out, predicted from the fitted ones and as uncertain as the parameters are.

        raises : RunError where they cannot be marched
        """
        assert self.held_out is not None  # asked for where there are any
        others = self._held_out_plain
        known = np.where(np.outer(~self.fit.on_bound, ~self.fit.on_bound), self.fit.covariance, 0.0)
        root_K = parameter_root_K(self.fitted_samples, others, known)
        return innovations(self.held_out.record_fits[0], others, self.known_error, root_K)[0]

    @cached_property
    def excess_chi2(self) -> float:
        """Reduced chi-square of the fitted samples less one, noise alone giving 0."""
        return rms_normalised_residual(self.fitted_samples) ** 2 - 1.0

    @cached_property
    def scale(self) -> float:
        """By how much its residuals are more than noise as declared, 1 at least: a difference in log likelihood counts
        less by this [-].

        Of an exact model the reduced chi-square. The error of a model takes up what is slow, but not the colour of a
        recorder: there the spectral density at frequency 0, the mean of the channels, as slow causes are distinguished
        from that. A sensor that states the correlation of its noise has it in its model, and counts as 1. Source:
        docs/theory/model_error.md, equation 5b.
        """
        error = self.record_fit.model_error
        if error is None:
            return max(1.0, 1.0 + self.excess_chi2)
        densities = [1.0 if s.channel.number in error.noise else _spectral_density(s) for s in self.fitted_samples]
        return max(1.0, float(np.average(densities, weights=[len(s.mean_K) for s in self.fitted_samples])))

    @cached_property
    def held_out_scale(self) -> float:
        """By how much a difference in log likelihood of the samples held out counts less: as of the fitted ones with an
        error of the model, and by their own reduced chi-square where that is more [-]."""
        return max(1.0 if self.record_fit.model_error is None else self.scale, self.held_out_chi2)

    @cached_property
    def held_out_log_likelihood(self) -> float:
        """Log likelihood of the samples held out, at the estimates; minus infinity where they cannot be marched.

        Of a model with an error the parameters are integrated out: what they leave open, the error of a model that has
        fewer of them leaves open as well. Where the size of the heating's error is, too, it is what all samples have
        more evidence than the fitted ones: the error may start anew among those held out.
        """
        if self.held_out is None:
            return 0.0
        prior = heating_error_prior(self.record_fit.record)
        if self.size is not None and prior is not None and prior.relative > 0.0:
            try:
                return _size_of_error(self, prior, may_break=True, with_held_out=True).evidence - self.size.evidence
            except RunError:
                return -np.inf
        if self.held_out.record_fits[0].model_error is None:
            total = self.held_out.evaluate(self.fit.values).log_likelihood
        else:
            try:
                samples = self._held_out_integrated if self.has_error else self.held_out_samples
            except RunError:
                return -np.inf
            stated = self.held_out.record_fits[0].known_log_likelihood
            each = (log_likelihood(s.channel.intervals, s.mean_K, s.spread_K) for s in samples)
            total = stated + sum(float(np.sum(x)) for x in each)
        return total if np.isfinite(total) else -np.inf

    @cached_property
    def held_out_chi2(self) -> float:
        """Reduced chi-square of the samples held out; 0 where there are none, or they cannot be marched."""
        try:
            return rms_normalised_residual(self.held_out_samples) ** 2 if self.held_out is not None else 0.0
        except RunError:
            return 0.0

    def __repr__(self) -> str:
        name = self.name if self.change is None else self.change.describe(self.value)
        return f"<TrialFit of {name}: score {self.score:+.1f}>"


def _spectral_density(samples: PredictedSamples) -> float:
    """Spectral density of the innovations of a channel at frequency 0 over that of white noise as declared [-]."""
    scored = likelihood(samples.channel.intervals, samples.mean_K, samples.spread_K)
    no_parameters, name = np.zeros((len(samples.mean_K), 0)), samples.channel.sensor.name
    return spectral_density(
        ChannelResiduals(name, np.asarray(samples.time_s), scored.score, scored.information, no_parameters)
    )


def declared_fit(record: Record, names: Sequence[str] | None = None) -> FitResult:
    """The declared model fitted with flat priors: the baseline that everything else is compared with.

    names  : dotted names of what is fitted; by default magnitude and derivatives, without those that the table
             excludes, and nothing at all where the record has no reference heating
    raises : InputError for a name that the record's model does not have, or where nothing named can be estimated;
             InputError, RunError where not even the declared model can be fitted
    """
    if names is not None:
        return estimate([record], names)
    default = default_names([record])
    without_heating = parameters_without_heating(default, [record])
    if without_heating:
        return declared_model(record, without_heating)
    excluded = undeclared_derivatives(record, default)
    fit = estimate([record], [n for n in default if n not in excluded])
    return replace(fit, not_estimated=fit.not_estimated | excluded)


def declared_values(problem: FitProblem) -> FloatArray:
    """(parameter,) values of the parameters of a problem as they are declared, the means of their priors."""
    return np.array([p.value for p in problem.parameters])


def base_trial(baseline: FitResult) -> TrialFit:
    """The declared model with its magnitude and derivatives, a clock that may be slightly off, and its own error.

    Magnitude and derivatives have the prior of the declared table, as wide as it is. The base has the largest

        log L / c + log p

    with c its own reduced chi-square, at least 1: where something is missing, every reading counts as less than it
    would with noise alone, and the table keeps its say. With c = 1, a missing transition turns the magnitude and
    derivatives of a table into ones that no table has, from where no candidate finds its way.

    A clock that is not known is started where it is declared and one standard deviation to either side: by a manoeuvre
    whose answer the error of the heating takes up for a part, it has several likely values.
    """
    base = _base_trial(baseline, 0.0)
    clock = next((p for p in base.problem.parameters if p.name == CLOCK_SKEW.name), None)
    shifts = list[float]()
    if clock is not None and CLOCK_SKEW.sigma < clock.sigma < math.inf:
        shifts = [float(np.clip(shift, clock.lower, clock.upper)) for shift in (-clock.sigma, clock.sigma)]
    starts = _distinct_clocks([base, *(_base_trial(baseline, shift) for shift in shifts)])
    return _with_error_no_larger(max(map(with_own_error, starts), key=_log_posterior))


def _distinct_clocks(bases: Sequence[TrialFit]) -> list[TrialFit]:
    """Declared models without those whose clock ended where that of one before did."""
    apart = 0.5  # standard deviations of the clock given the readings
    kept = list(bases[:1])
    for base in bases[1:]:
        k = base.fit.names.index(CLOCK_SKEW.name)
        sigma_s = math.sqrt(base.fit.covariance[k, k])
        if all(not abs(base.fit.values[k] - other.fit.values[k]) < apart * sigma_s for other in kept):
            kept.append(base)
    return kept


def _log_posterior(base: TrialFit) -> float:
    """Log evidence of a declared model, with its priors [-]."""
    return base.log_evidence + base.fit.log_posterior - base.fit.log_likelihood


def _base_trial(baseline: FitResult, clock_s: float, *, is_clock_free: bool = False) -> TrialFit:
    """The declared model with a clock that starts at a skew [s].

    is_clock_free : whether the clock of a flight whose time is not known to SKEW_SPAN_S may be off by as much. It is
        where it would otherwise be on its bound
    """
    # most fits of the base with the reduced chi-square of the one before, and the factor by which it has to grow for
    # another
    chi2_rounds, chi2_change = 3, 1.2
    node_fraction = 1.0 / 3.0  # nodes of the search over those of a fit
    min_nodes = 14  # least number of nodes of the search
    stated = baseline.problem.record_fits[0]
    prior = table_prior(stated.record, stated.names, baseline.problem.reference)
    priors = {} if prior is None else prior.parameters()
    declared = {**{n: p.value for n, p in priors.items()}, CLOCK_SKEW.name: clock_s}
    # Far from the truth a fit with flat priors may end anywhere, and what it ends at is no place to start from.
    start = (dict(zip(stated.names, baseline.fit.values, strict=True)) if baseline.fit.converged else {}) | {
        CLOCK_SKEW.name: clock_s
    }
    fitted, held_out = stated.record.fit_mask(), stated.record.holdout_mask()
    # A third of the nodes, and as few conditions as are linear to tolerance: only the last fit is on the whole record.
    thin = thin_record(stated.record, max(int(node_fraction * stated.mesh.nodes), min_nodes))
    full = _declared_problem(baseline, stated.record, priors, fitted | held_out, is_clock_free)
    thinned = _declared_problem(baseline, thin, priors, fitted | held_out, is_clock_free, **THINNED_STEPS)
    error_K, at_s = thinning_error(full, thinned, start)

    def problem_over(chosen: NDArray[np.bool_], c: float = 1.0) -> FitProblem:
        weighed = {n: replace(p, sigma=p.sigma / math.sqrt(c)) for n, p in priors.items()}
        problem = _declared_problem(baseline, thin, weighed, chosen, is_clock_free, **THINNED_STEPS)
        record_fit = problem.record_fits[0]
        record_fit.correction_K = error_K[:, np.isin(at_s, record_fit.sample_s)]
        if error is not None:
            record_fit.model_error = error
            record_fit.sigma_K.update({i: max(n.white_K, least_sigma_K(sensors[i])) for i, n in error.noise.items()})
        return problem

    error, sensors = _model_error(full, thinned, start), thin.sensors
    problem = problem_over(fitted)
    try:
        held_out_problem = problem_over(held_out) if np.any(held_out) else None
    except InputError:  # nothing was measured there
        held_out_problem = None
    fit, c = maximise_together([problem], [start_values(problem, start)], QUICK)[0], 1.0
    for _ in range(chi2_rounds if priors else 0):
        before_c, c = c, max(1.0, rms_normalised_residual(problem.innovations(fit.values)) ** 2)
        if c < chi2_change * before_c:
            break
        weighed = problem_over(fitted, c)
        at = declared if before_c == 1.0 else dict(zip(fit.names, fit.values, strict=True))
        fit = maximise_together([weighed], [start_values(weighed, at)], QUICK)[0]
    flight, is_clock = flight_error(stated.record), np.array(fit.names) == CLOCK_SKEW.name
    is_unknown = flight is not None and flight.has_clock and not flight.has_one_clock
    if is_unknown and not is_clock_free and np.any(fit.on_bound & is_clock):
        return _base_trial(baseline, clock_s, is_clock_free=True)
    information = np.array([p.sigma**-2.0 for p in problem.parameters])
    fit = replace(fit, prior_information=information, log_posterior=fit.log_likelihood)
    fit = replace(fit, log_posterior=fit.log_likelihood + table_log_prior(fit))
    return TrialFit("none", NO_EFFECT, problem, held_out_problem, fit)


def _with_error_no_larger(own: TrialFit) -> TrialFit:
    """The declared model with the error that the readings say it has, no larger than the prior's scale.

    With a cause the error is no larger than without one. One that follows what is missing would hide that.
    """
    error, prior = own.record_fit.model_error, heating_error_prior(own.record_fit.record)
    if error is None or prior is None or error.sigma <= prior.relative:
        return own
    smaller = fitted_on(with_error(own, error.of_size(prior.relative, error.correlation, error.flight_scale)), QUICK)
    return replace(smaller, size=None) if np.isfinite(smaller.fit.log_likelihood) else own


def _model_error(full: FitProblem, thinned: FitProblem, start: Mapping[str, float]) -> ModelError | None:
    """The error of the model of a record that states one or was measured; None for any other.

    full, thinned : the declared model over all samples, of the whole record, which has the noise of its conditions, and
                    of the thinned one
    start         : its values by dotted name
    """
    record_fit = thinned.record_fits[0]
    prior = heating_error_prior(record_fit.record)
    try:
        values = start_values(thinned, start)
        noise = heating_noise(full.record_fits[0], start_values(full, start)) if record_fit.record.has_flow else None
        if prior is not None:
            return model_error(record_fit, values, prior.relative, prior.middle, flight_error(record_fit.record), noise)
        return None if noise is None else noise_error(record_fit, values, noise)
    except RunError:  # a model so wrong that it cannot be marched everywhere
        return None


def with_own_error(trial: TrialFit, start: ErrorSize | None = None) -> TrialFit:
    """A trial with the error of its model as large as the readings say, the forms of its causes exact or not.

    trial : with exact forms
    start : what the readings say of the error of another model, as `_with_own_error` has it

    Either is as probable before, and the one with more evidence is taken. Source: docs/theory/model_error.md, equation
    1b.
    """
    own, prior = _with_own_error(trial, start), heating_error_prior(trial.record_fit.record)
    error = own.record_fit.model_error
    if own is trial or own.size is None or error is None or prior is None:
        return own
    try:
        form_K = _form_K(own)
        if form_K is None:
            return own
        formed = with_error(own, replace(error, form_K=form_K))
        size = _size_of_error(formed, prior, may_break=True)
    except RunError:
        return own
    if size.evidence < own.size.evidence + POLICY.settled_gain:
        return own
    formed = _with_own_error(replace(formed, size=None), size)
    is_better = formed.size is not None and formed.log_evidence > own.log_evidence + POLICY.settled_gain
    return replace(formed, exact_forms=own) if is_better else own


def _with_own_error(trial: TrialFit, start: ErrorSize | None = None) -> TrialFit:
    """A trial with the error of its model as large as the readings say, and with the response about its own values.

    start : what they say of the error of another model, whose most probable one is tried first; without it that of the
            trial itself

    The trial as it is where its model has no error, or cannot be marched there, where it has its own already and no
    start is given, or where its log evidence gains less than one half from that. It is fitted on from its values with
    the most probable size, correlation and breaks of the error, and once more as long as others are more probable then
    and its log evidence gains one half.
    """
    most_fits = 4
    prior = heating_error_prior(trial.record_fit.record)
    if trial.record_fit.model_error is None or prior is None or (trial.size is not None and start is None):
        return trial
    try:
        about = _with_response(trial, start.likeliest[1].breaks_s if start else ())
        likeliest = (start or _size_of_error(about, prior, may_break=True)).likeliest
        for k in range(most_fits):
            breaks_s = likeliest[1].breaks_s
            if k > 0 or (breaks_s and start is None):
                about = _with_response(trial, breaks_s)
            error = about.record_fit.model_error
            assert error is not None  # it was given one
            error = error.of_size(*likeliest)
            sized = fitted_on(with_error(about, error), replace(CONVERGE, iterations=40))
            if not np.isfinite(sized.fit.log_likelihood):
                break
            size = _size_of_error(sized, prior, may_break=True)
            sized = replace(sized, size=size)
            if trial.size is not None and sized.log_evidence < trial.log_evidence + POLICY.settled_gain:
                break
            trial, likeliest = sized, size.likeliest
            if size.log_odds_of_likeliest(error) < POLICY.settled_gain:
                break
    except RunError:
        pass
    return trial


def _with_response(trial: TrialFit, breaks_s: Sequence[float]) -> TrialFit:
    """A trial whose error has the response of the readings about its values, with finer knots about breaks.

    breaks_s : beside those of its error [s]
    raises : RunError where it cannot be marched
    """
    now = trial.record_fit.model_error
    assert now is not None  # the caller's trial has one
    all_samples = _over_all_samples(trial).record_fits[0]
    now_s = now.correlation.breaks_s
    knots_s = finer_knots(even_knots_s(all_samples), sorted({*now_s, *breaks_s}))
    alike = replace(now.correlation, breaks_s=tuple(np.intersect1d(now_s, knots_s).tolist()))
    error = model_error(all_samples, trial.fit.values, now.sigma, alike, now.flight, now.heating_noise, knots_s)
    return with_error(trial, error if now.form_K is None else replace(error, form_K=_form_K(trial)))


def _over_all_samples(trial: TrialFit) -> FitProblem:
    """The problem of a trial over the samples that are fitted and those that are held out."""
    record = trial.record_fit.record
    either = [record.fit_mask() | record.holdout_mask()]
    return candidate_problem(trial, trial.record_fit, NO_EFFECT, sample_masks=either)


def _form_K(trial: TrialFit) -> FloatArray | None:
    """(sensor, sample, value) response of the readings to the errors of the forms of a trial's causes [K]; None without
    any.

    raises : RunError where it cannot be marched without one of them
    """
    problem, by_name = _over_all_samples(trial), fitted_values(trial)
    all_samples = problem.record_fits[0]
    all_samples.correction_K = 0.0  # it cancels
    channels, sensors = all_samples.channels, len(all_samples.record.sensors)
    ends = np.cumsum([len(c.samples) for c in channels])[:-1]
    noise_K = np.ones(sensors)
    for channel, of_readings_K in zip(channels, np.split(all_samples.reading_noise_K, ends), strict=True):
        noise_K[channel.number] = np.max(of_readings_K)

    def read_K(values: Mapping[str, float]) -> FloatArray:
        indicated = np.zeros((sensors, len(all_samples.sample_s)))
        for s in problem.samples(start_values(problem, values)):
            indicated[s.channel.number, s.channel.samples] = s.mean_K
        return indicated

    with_all = read_K(by_name)
    causes: dict[str, list[str]] = {}
    for name in (*all_samples.march_names, *all_samples.sensor_names):
        if name not in OF_TABLE and name != CLOCK_SKEW.name:
            causes.setdefault(name.split(".")[1] if name.startswith(EFFECT_PREFIX) else name, []).append(name)
    changes_K = [with_all - read_K(by_name | values_without(trial, *cause)) for cause in causes.items()]
    return form_root_K(changes_K, all_samples.sample_s, noise_K)


def values_without(trial: TrialFit, cause: str, names: Sequence[str]) -> dict[str, float]:
    """Values of a cause of a trial's model with which it does nothing, by dotted name; a declared one differs from its
    declaration.

    cause : name of an effect, or of what is none;  names : of its estimated parameters
    """
    nominal = {n: p.value for n, p in trial.definitions(names).items()}
    declared = {used.effect.name for used in trial.record_fit.record.declared.heating.effects}
    effect = None if cause in declared else effects().get(cause)
    if effect is None or not effect.neutral:
        return nominal
    neutral = {f"{EFFECT_PREFIX}{cause}.{n}": v for n, v in effect.neutral.items()}
    return {n: neutral[n] for n in nominal if n in neutral}


def fitted_on(trial: TrialFit, settings: NewtonSettings) -> TrialFit:
    """A trial fitted on from its values; its log likelihood is not finite where it cannot be marched."""
    fit = maximise_together([trial.problem], [trial.fit.values], settings)[0]
    gained = fit.log_likelihood - trial.fit.log_likelihood
    return replace(trial, fit=fit, delta_bic=trial.delta_bic - 2.0 * gained)


def with_error(trial: TrialFit, error: ModelError) -> TrialFit:
    """A trial with another error of its model."""
    return over_both(trial, lambda problem: problem.with_model_error(error))


def over_both(trial: TrialFit, changed: Callable[[FitProblem], FitProblem]) -> TrialFit:
    """A trial with its problems changed, over the fitted samples and over those held out; its fit is as before."""
    return replace(trial, problem=changed(trial.problem), held_out=trial.held_out and changed(trial.held_out))


def _size_of_error(
    trial: TrialFit, prior: HeatingErrorPrior, *, may_break: bool = False, with_held_out: bool = False
) -> ErrorSize:
    """What the readings say of the size of the error of a trial's model.

    may_break : whether it may start anew;  with_held_out : whether the samples held out count as well
    raises    : RunError where these cannot be marched
    """
    parameters = trial.problem.parameters
    information = np.array([p.sigma**-2.0 for p in parameters])
    distance = np.array([p.value for p in parameters]) - trial.fit.values
    record_fit, samples = trial.record_fit, trial.problem.samples(trial.fit.values)
    flight = flight_error(record_fit.record)
    has_one_clock = flight is not None and flight.has_one_clock
    is_clock = np.array([has_one_clock and p.name == CLOCK_SKEW.name for p in parameters])
    return error_size(
        record_fit, samples, (information, distance), ~trial.fit.on_bound, prior, flight_scales(record_fit.record),
        is_clock, may_break=may_break, held_out=trial._held_out_plain if with_held_out else (),
    )  # fmt: skip


def _declared_problem(
    baseline: FitResult,
    record: Record,
    priors: Mapping[str, Parameter],
    chosen: NDArray[np.bool_],
    is_clock_free: bool,
    **options_of_march: Any,
) -> FitProblem:
    """The declared model over chosen samples of a record, whole or thinned; priors are those of its table."""
    stated = baseline.problem.record_fits[0]
    interval = float(np.median(np.diff(stated.record.time_s)))
    # Clocks of two recorders never agree exactly, and an unstated skew is estimated as an effect: some room for it
    # belongs to the model without effects.
    agreement_s = min(0.25 * interval, SKEW_SPAN_S)
    name = CLOCK_SKEW.name
    clock = {} if name in stated.names else {name: clock_prior(record, agreement_s, is_free=is_clock_free)}
    options = FitOptions(
        effects=baseline.problem.options.effects,
        priors={**priors, **clock},
        prior_scale=WIDENED,
        sample_masks=[chosen],
        **options_of_march,
    )
    problem = FitProblem([record], (*stated.names, *clock), baseline.problem.reference, options)
    problem.record_fits[0].sigma_K.update(stated.sigma_K)
    return problem


def thinning_error(full: FitProblem, thinned: FitProblem, start: Mapping[str, float]) -> tuple[FloatArray, FloatArray]:
    """Correction of the thinned record: its prediction subtracted from that of the whole one, on a mesh without error.

    start   : values of the declared model by dotted name
    returns : (sensor, sample) [K] and (sample,) times [s]
    """
    at, record_fit = start_values(full, start), full.record_fits[0]
    try:
        full.correct_meshes(at)
        exact, coarse = (p.record_fits[0].corrected(p.marched(at)[0], at).temperature_K for p in (full, thinned))
    except RunError:  # a model so wrong that it cannot be marched everywhere: no correction
        return np.zeros((len(record_fit.mesh.sensors), len(record_fit.sample_s))), record_fit.sample_s
    return exact - coarse, record_fit.sample_s


def own_thinning_error(
    trial: TrialFit, stated: Record, thin: Record | None = None, names: Sequence[str] | None = None
) -> tuple[FloatArray, FloatArray]:
    """The correction of a trial's predictions at its own values, as `thinning_error`.

    stated  : the record that the trial's is thinned from
    thin, names : the thinned record and the estimated parameters, where these are not the trial's
    raises : InputError, RunError where the whole record cannot be marched with these
    """
    record_fit = trial.record_fit
    names = record_fit.names if names is None else names
    fitted, held_out = stated.fit_mask(), stated.holdout_mask()
    options = FitOptions(
        effects=fitted_effects(trial),
        priors=trial.problem.priors,
        prior_scale=WIDENED,
        sample_masks=[fitted | held_out],
    )
    full = FitProblem([stated], names, trial.problem.reference, options)
    options = replace(options, **THINNED_STEPS)
    thinned = FitProblem([thin or record_fit.record], names, trial.problem.reference, options)
    return thinning_error(full, thinned, fitted_values(trial))


def corrected(trial: TrialFit, correction: tuple[FloatArray, FloatArray]) -> TrialFit:
    """A trial with another mesh correction, as `own_thinning_error` gives it; its fit is as before."""
    error_K, at_s = correction
    return over_both(trial, lambda p: p.with_correction(error_K[:, np.isin(at_s, p.record_fits[0].sample_s)]))


def problem_with(base: TrialFit, candidate: Candidate) -> FitProblem:
    """The base's problem with the parameters of a candidate."""
    return candidate_problem(base, base.record_fit, candidate)


def held_out_problem_with(
    base: TrialFit,
    candidate: Candidate,
    names: Sequence[str] | None = None,
    changed: Callable[[Record], Record] | None = None,
) -> FitProblem | None:
    """The samples held out with the parameters of a candidate; None where there are none.

    names : of all estimated parameters, by default the base's and the candidate's;  changed : makes another record
    """
    if base.held_out is None:
        return None
    record_fit = base.held_out.record_fits[0]
    record = record_fit.record if changed is None else changed(record_fit.record)
    return candidate_problem(base, record_fit, candidate, names, record, sample_masks=[record.holdout_mask()])


def with_held_out(base: TrialFit, trial: TrialFit) -> TrialFit:
    """The trial of a candidate on top of a base, with the samples that are held out."""
    return replace(trial, held_out=held_out_problem_with(base, trial.candidate))


def unfitted(
    base: TrialFit,
    candidate: Candidate = NO_EFFECT,
    names: Sequence[str] | None = None,
    changed: Callable[[Record], Record] | None = None,
) -> TrialFit:
    """A base with a candidate's parameters, or others by name, or over a changed record; its fit is as before."""
    record_fit = base.record_fit
    record = None if changed is None else changed(record_fit.record)
    problem = candidate_problem(base, record_fit, candidate, names, record)
    return replace(base, problem=problem, held_out=held_out_problem_with(base, candidate, names, changed))


def candidate_problem(
    base: TrialFit,
    record_fit: RecordFit,
    candidate: Candidate,
    names: Sequence[str] | None = None,
    record: Record | None = None,
    **options: Any,
) -> FitProblem:
    """A part of the base with the effects found so far and those of a candidate.

    Its noise and mesh correction are the base's, as are the bounds of the clock and the priors of the table, unless the
    candidate has others.
    record_fit : the base's part over the fitted or held-out samples
    names      : of all estimated parameters; by default the part's and the candidate's
    record     : where it is changed; that of the part by default
    """
    record = record or record_fit.record
    uses = (*fitted_effects(base), *candidate.uses)
    priors: dict[str, Parameter] = dict(base.problem.priors)
    if CLOCK_SKEW.name in candidate.names:
        priors[CLOCK_SKEW.name] = replace(CLOCK_SKEW, lower=-SKEW_SPAN_S, upper=SKEW_SPAN_S)
    priors |= candidate.priors
    options |= {"effects": uses, "priors": priors, "prior_scale": WIDENED, **THINNED_STEPS}
    estimated = dict.fromkeys((*record_fit.names, *candidate.names)) if names is None else names
    plain = [n for n in estimated if n not in record_fit.flight_names]
    problem = FitProblem([record], plain, base.problem.reference, FitOptions(**options))
    # The noise of the base: likelihoods of candidates are compared, and noise fitted to each would absorb what one of
    # them explains.
    problem_fit = problem.record_fits[0]
    problem_fit.sigma_K.update(record_fit.sigma_K)
    problem_fit.known_log_likelihood = record_fit.known_log_likelihood
    # a record without the readings of a broken sensor may have fewer times
    correction = np.broadcast_to(record_fit.correction_K, (len(record.sensors), len(record_fit.sample_s)))
    problem_fit.correction_K = correction[:, np.isin(record_fit.sample_s, problem_fit.sample_s)]
    take_error(problem_fit, record_fit)
    return problem.with_flight_unknowns() if record_fit.flight_names else problem


def start_values(problem: FitProblem, start: Mapping[str, float]) -> FloatArray:
    """(parameter,) values to start from, those of the priors where none are given."""
    return np.array([start.get(p.name, p.value) for p in problem.parameters])


def fitted_values(trial: TrialFit) -> dict[str, float]:
    """Estimates by dotted name."""
    return dict(zip((u.parameter.name for u in trial.problem.unknowns), trial.fit.values, strict=True))


def fitted_effects(trial: TrialFit) -> tuple[EffectUse, ...]:
    """The effects of a trial's model at the estimates."""
    return trial.record_fit.model_at(trial.fit.values).effects


def is_of_table(parameter: Parameter) -> bool:
    """Whether a parameter has the prior of the declared table."""
    return parameter.name in OF_TABLE and math.isfinite(parameter.sigma)


def table_log_prior(fit: Fit) -> float:
    """Log prior density of magnitude and derivatives by the declared table, without its constant [-].

    The means are 0, the table as it is; parameters with a flat prior add nothing.
    """
    of_table = np.array([n in OF_TABLE for n in fit.names])
    return -0.5 * float(np.sum(fit.prior_information[of_table] * fit.values[of_table] ** 2))


def delta_bic(base: TrialFit, fit: Fit, candidate: Candidate, c: float) -> float:
    """BIC of a fit minus that of the model it is on top of; c is the scale of the residuals."""
    gained = (fit.log_likelihood - base.fit.log_likelihood) / c + table_log_prior(fit) - table_log_prior(base.fit)
    return float(-2.0 * gained + _parameter_cost(base, candidate))


def needed_log_likelihood(base: TrialFit, candidate: Candidate, delta: float) -> float:
    """Log likelihood that a fit of a candidate has at least where its `delta_bic` with c = 1 is as low as a given one.

    The prior density of the table is taken at its largest.
    """
    cost = _parameter_cost(base, candidate)
    return float(base.fit.log_likelihood + table_log_prior(base.fit) + 0.5 * (cost - delta))


def _parameter_cost(base: TrialFit, candidate: Candidate) -> float:
    """k log n of a candidate on top of a model."""
    return float(len(candidate.names) * np.log(sample_count(base.problem)))


def is_fitted(base: TrialFit, name: str) -> bool:
    """Whether a parameter is estimated already, under this or another name.

    The clock is not where it may only be off by the agreement of two recorders.
    """
    record_fit = base.record_fit
    if name == CLOCK_SKEW.name and name in base.problem.priors:
        return base.problem.priors[name].sigma > CLOCK_SKEW.sigma
    return any(record_fit.model.same_parameter(name, fitted) for fitted in record_fit.names)


def sample_count(problem: FitProblem) -> int:
    """Number of samples of a problem."""
    return sum(len(channel.samples) for record_fit in problem.record_fits for channel in record_fit.channels)


MAX_STEP_S = 2.0
"""Longest interval between samples that are kept [s]."""
THINNED_STEPS: dict[str, Any] = {"longest_step_s": MAX_STEP_S, "tolerance_K": NOT_CONTROLLED_K}
"""Steps of the marches of thinned records. They are not divided: the difference to the whole record is taken out, and
candidates are compared on the same steps."""
TOLERANCES = {
    "alpha_deg": 0.1, "beta_deg": 0.1, "log10_re": 0.01, "elevon_deg": 0.2, "bodyflap_deg": 0.2, "jets": 0.02,
}  # fmt: skip
"""Largest distance of an omitted sample from the line between its kept neighbours, in its own unit."""


def thin_record(record: Record, nodes: int) -> Record:
    """The record with fewer samples of its conditions, and the given number of nodes.

    nodes : of the mesh, more where the sensors need more
    """
    flown = conditions_of_record(record)
    stack = record.declared.stack.model_copy(update={"nodes": nodes})
    declared = record.declared.model_copy(update={"stack": stack})
    return replace(record, declared=declared, conditions=record.conditions.at(flown.time_s[thinned_indices(flown)]))


def thinned_indices(flown: Conditions) -> NDArray[np.int64]:
    """(kept,) indices of the samples that are kept, first and last included."""
    # the largest distance that an omitted sample's heating of a cold wall has from that line, over the largest heating
    # of the flight
    heating_tolerance = 0.002
    t = flown.time_s
    heating = flown["h_ref_kg_m2_s"] * flown["H_r_J_kg"]
    if "q_add_W_m2" in flown:
        heating = heating + flown["q_add_W_m2"]
    largest = float(np.max(np.abs(heating)))
    columns = [heating / (heating_tolerance * largest)] if largest > 0.0 else []
    columns += [flown[name] / tolerance for name, tolerance in TOLERANCES.items() if name in flown]
    x = np.column_stack(columns)
    kept = [0]
    while kept[-1] < len(t) - 1:
        i = kept[-1]
        j = max(int(np.searchsorted(t, t[i] + MAX_STEP_S * (1.0 + 1e-9), side="right")) - 1, i + 1)
        # The longest interval whose omitted samples are as good as linear; between samples a march is linear anyway.
        while j > i + 1 and not _is_linear(t[i : j + 1], x[i : j + 1]):
            j -= 1
        kept.append(j)
    return np.array(kept, dtype=np.int64)


def _is_linear(t: FloatArray, x: FloatArray) -> bool:
    """Whether all samples lie within 1 of the line from the first to the last."""
    fraction = (t - t[0]) / (t[-1] - t[0])
    return bool(np.all(np.abs(x - x[0] - fraction[:, np.newaxis] * (x[-1] - x[0])) <= 1.0))
