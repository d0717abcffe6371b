"""The fit of heating and thermal parameters to flight records, from the records to values with bounds.

Magnitude and derivatives of the heating ratio, and any other parameters that are named, are those that make the
measured samples most likely (problem.py, inference/newton.py). Parameters that the data cannot identify are omitted,
with the reason; the noise of sensors that declare none is estimated as well; bounds are corrected for coloured
residuals; errors are those of the plain march at the values found. With process noise the innovations of a Kalman
filter take the place of residuals (filter/innovations.py), and the fit without it is where the search begins. Method:
HEATEST, "Trends in Shuttle Entry Heating from the Correlation of Flight Test Maneuvers"; equations in
docs/theory/estimation_statistics.md.
"""

from __future__ import annotations

import html
import logging
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files import suggestion
from sim_heating.base.parallel.threads import one_thread
from sim_heating.base.parameters import AT, CLOCK_SKEW, MODEL, PRESSURE_FACTOR, SHORT_NAMES, Parameter
from sim_heating.base.progress import Progress, no_progress
from sim_heating.base.report.table import Column, Table
from sim_heating.credibility.facts.of_records import MODEL_ERROR_RATIO, held_out, of_several, ratio_uncertainty
from sim_heating.credibility.statement import Answer, Statement, assess
from sim_heating.estimation.errors_in_fit import with_stated_errors
from sim_heating.estimation.filter.innovations import Innovations, fit_innovations
from sim_heating.estimation.filter.process_noise import ProcessNoise
from sim_heating.estimation.inference import observability
from sim_heating.estimation.inference.bounds import ChannelResiduals as Residuals
from sim_heating.estimation.inference.bounds import CramerRaoBounds, cramer_rao_bounds
from sim_heating.estimation.inference.conditions_noise import conditions_noise, heating_noise
from sim_heating.estimation.inference.error_likelihood import noise_error, whitened
from sim_heating.estimation.inference.identifiability import correlation
from sim_heating.estimation.inference.likelihood import likelihood
from sim_heating.estimation.inference.model_error import StatedError
from sim_heating.estimation.inference.newton import Fit, NewtonSettings, Status, check_parameters, maximise
from sim_heating.estimation.inference.outliers import Outlier, outlier_lines, without_outliers
from sim_heating.estimation.inference.profile import Profile, profile
from sim_heating.estimation.problem import FitProblem, joint_reference
from sim_heating.estimation.record_fit import (
    PredictedSamples,
    RecordFit,
    Start,
    StartMaker,
    marched_from,
    sensor_errors,
)
from sim_heating.estimation.report.posterior import Posterior
from sim_heating.estimation.unknowns import FitOptions, require_estimated
from sim_heating.heating.effects import EffectUse
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.inputs.averaged_record import averaged_record
from sim_heating.inputs.first_readings import other_start
from sim_heating.inputs.parameter_owners import Owners
from sim_heating.inputs.points import point_of_record, undeclared_effects
from sim_heating.inputs.record import Record, load_record, load_records
from sim_heating.march.history import table_excursions
from sim_heating.simulation.predict import Prediction
from sim_heating.simulation.predict import predict as predict_record

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

LOG = logging.getLogger(__name__)
DEFAULT = "default"
"""Stands for the default parameters among the names of parameters."""
WITHOUT_NOISE = "profile of `{}`: is of a fit without process noise; leave one of the two out"
FEWEST_SAMPLES = 3
"""Least number of sample times in a fit."""
REPORTED_CORRELATION = 0.5
"""Magnitude of a correlation [-] above which the text of a fit states it."""
ERROR_ROUNDS = 2
"""Fits with the error of the model about the values of the fit before."""
NOISE_ROUNDS = 4
NOISE_CHANGE = 0.01
"""Relative change below which noise has converged."""
NO_ERROR = np.zeros(0)
MAGNITUDES_TRIED = np.geomspace(0.002, 2.0, 8)
"""Ratios tried as the start of a fit that has no table to start from."""


class EstimatedValue(NamedTuple):
    """Value and standard deviation of an estimated parameter, each in its unit."""

    value: float
    sigma: float


@dataclass(frozen=True, eq=False, repr=False)
class FitResult:
    """Result of a fit.

    problem       : records, parameters and samples;  fit : the most probable values
    bounds        : covariance corrected for coloured residuals, and without that correction
    not_estimated : omitted parameters, with the reason
    before, after : each record predicted by the declared model, and at the values found [K]
    warnings      : one line each
    innovations   : of the filter, in a fit with process noise
    outliers      : isolated readings that were left out
    profiles      : of the parameters that one was asked for, by their labels

    Source: docs/theory/estimation_statistics.md, equations 13 to 26.
    """

    problem: FitProblem
    fit: Fit
    bounds: CramerRaoBounds
    not_estimated: dict[str, str]
    before: tuple[Prediction, ...]
    after: tuple[Prediction, ...]
    warnings: tuple[str, ...]
    innovations: Innovations | None = None
    outliers: tuple[Outlier, ...] = ()
    profiles: Mapping[str, Profile] = field(default_factory=dict)

    def __repr__(self) -> str:
        values = zip(self.labels, self.fit.values, self.bounds.sigma, strict=True)
        estimates = ", ".join(f"{label}={value:.5g} +- {sigma:.2g}" for label, value, sigma in values)
        names = ", ".join(record_fit.record.name for record_fit in self.problem.record_fits)
        return f"<FitResult of {names}: {estimates}; {self.fit.status.name.lower()}>"

    @cached_property
    def credibility(self) -> Statement:
        """What supports the estimate, factor by factor."""
        facts = of_several([p.facts("estimate", with_peak=False) for p in self.after])
        excess = rms_normalised_residual(self.samples())
        facts_of_fit = replace(
            facts,
            topics=facts.topics | {"estimates", "sensitivities"},
            sigma=True,
            uncertainty=ratio_uncertainty(
                dict(zip(self.labels, self.bounds.sigma.tolist(), strict=True)),
                [p.record for p in self.after],
                self.problem.reference,
            ),
            consistent=Answer(excess <= MODEL_ERROR_RATIO, f"residuals are {excess:.2f} times those of noise"),
            holds=self._holds(),
            varied=held_out(*self._pooled_rmse_K()),
        )
        return assess(facts_of_fit)

    def _holds(self) -> Answer:
        """Whether the search converged to values within their bounds."""
        converged = self.fit.converged
        fixed = [n for n, s in zip(self.labels, self.bounds.sigma, strict=True) if s <= 0.0]
        on_bound = f"on a bound: {', '.join(fixed)}" if fixed else "no parameter on a bound"
        return Answer(converged and not fixed, f"{'converged' if converged else 'not converged'}, {on_bound}")

    def _pooled_rmse_K(self) -> tuple[float | None, float | None]:
        """RMSE over the fitted data and over those held out [K], root mean square over the records that have both."""
        errors = [p.segment_errors() for p in self.after]
        both = [(e["fit"]["rmse_K"], e["holdout"]["rmse_K"]) for e in errors if e["fit"] and e["holdout"]]
        if not both:
            return None, None
        fitted_K, held_out_K = (float(np.sqrt(np.mean(np.square(x)))) for x in zip(*both, strict=True))
        return fitted_K, held_out_K

    @property
    def parameters(self) -> dict[str, EstimatedValue]:
        """Value and standard deviation of each estimated parameter, in the unit of the parameter."""
        pairs = zip(self.fit.values.tolist(), self.bounds.sigma.tolist(), strict=True)
        return {label: EstimatedValue(*pair) for label, pair in zip(self.labels, pairs, strict=True)}

    @property
    def covariance(self) -> FloatArray:
        """(parameter, parameter) covariance of the estimates, each in its unit, corrected for coloured residuals.

        Source: docs/theory/estimation_statistics.md, equation 22.
        """
        return self.bounds.covariance

    @property
    def success(self) -> bool:
        """Whether the search converged."""
        return self.fit.converged

    @property
    def message(self) -> str:
        """How the search ended."""
        return self.fit.status.value

    @property
    def n(self) -> int:
        """Number of readings that were fitted."""
        errors = [p.segment_errors()["fit"] for p in self.after]
        return sum(int(e["n"]) for e in errors if e)

    @property
    def aic(self) -> float:
        """Akaike's information criterion, 2 k - 2 ln L [-], of k estimated parameters; less is better.

        Source: H. Akaike, IEEE Trans. Automatic Control AC-19 (1974) 716-723.
        """
        return 2.0 * len(self.labels) - 2.0 * self.fit.log_likelihood

    @property
    def bic(self) -> float:
        """Schwarz's information criterion, k ln n - 2 ln L [-], of n fitted readings; less is better.

        Source: G. Schwarz, Annals of Statistics 6 (1978) 461-464.
        """
        return len(self.labels) * float(np.log(self.n)) - 2.0 * self.fit.log_likelihood

    def report(self) -> str:
        """The fit as text: how it ended, values with bounds, correlations, what was not estimated, warnings."""
        columns = [
            Column("parameter"),
            Column("value", format=".5g"),
            Column("sigma", format=".2g"),
            Column("unit", is_text=True),
        ]
        units = [u.parameter.unit for u in self.problem.unknowns]
        rows = [[n, *p, unit] for (n, p), unit in zip(self.parameters.items(), units, strict=True)]
        rho = self.correlation
        lines = [
            repr(self).partition(":")[0].lstrip("<"),
            f"{self.message}; {self.n} readings, log likelihood {self.fit.log_likelihood:.2f}, "
            f"AIC {self.aic:.2f}, BIC {self.bic:.2f}",
            *Table("estimate", columns, rows).lines(),
            *(
                f"correlation of {a} and {b}: {rho[i, j]:+.3f}"
                for (i, a), (j, b) in combinations(enumerate(self.labels), 2)
                if abs(rho[i, j]) > REPORTED_CORRELATION
            ),
            *(f"{name}: not estimated, {why}" for name, why in self.not_estimated.items()),
            *(f"warning: {line}" for line in self.warnings),
        ]
        return "\n".join(lines)

    def to_dataframe(self) -> pd.DataFrame:
        """Value, standard deviation and unit of each parameter, a row each."""
        import pandas as pd  # slow to import

        data = {
            "value": self.fit.values,
            "sigma": self.bounds.sigma,
            "unit": [u.parameter.unit for u in self.problem.unknowns],
        }
        return pd.DataFrame(data, index=pd.Index(self.labels, name="parameter"))

    def _repr_html_(self) -> str:
        """The table of parameters in a notebook, below how the search ended."""
        return f"<p>{html.escape(repr(self).partition(':')[0].lstrip('<'))}: {html.escape(self.message)}</p>" + str(
            self.to_dataframe().to_html()
        )

    def to_xarray(self) -> xr.Dataset:
        """Values, standard deviations and correlations of the parameters, each in its unit."""
        import xarray as xr  # slow to import

        data = {
            "value": ("parameter", self.fit.values),
            "sigma": ("parameter", self.bounds.sigma),
            "correlation": (("parameter", "other_parameter"), self.correlation),
        }
        names = list(self.labels)
        return xr.Dataset(data, {"parameter": names, "other_parameter": names})

    def plot(self, record: int = 0) -> Figure:
        """Measured temperatures of a record, those of the fitted model, and the residual below."""
        return self.after[record].plot()

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the estimated parameters, in the order of the parameter vector."""
        return tuple(u.label for u in self.problem.unknowns)

    @property
    def correlation(self) -> FloatArray:
        """(parameter, parameter) correlation [-] of the estimates, from the covariance corrected for colour.

        Source: docs/theory/estimation_statistics.md, equations 18 and 22.
        """
        return correlation(self.bounds.covariance)

    def profile(self, name: str) -> Profile:
        """95 % interval of an estimated parameter by the profile of the likelihood, in its unit, the others refitted.

        name   : its label
        raises : InputError for a parameter that is not estimated, and for a fit with process noise

        For an onset, a width or a parameter near its bound, whose likelihood is no parabola, this is the interval;
        sigma is not. Source: docs/theory/estimation_statistics.md, equation 26a.
        """
        check_profiles([name], self.labels, self.innovations)
        at = self.labels.index(name)
        corrected, white = self.bounds.covariance[at, at], self.bounds.white[at, at]
        is_bounded = np.isfinite(corrected) and np.isfinite(white) and corrected > 0.0 and white > 0.0
        return profile(self.problem, self.fit, name, float(corrected / white) if is_bounded else 1.0)

    def to_problem(self) -> Posterior:
        """The posterior of the parameters for a sampler, beside `profile`.

        raises : InputError for a fit with process noise, whose likelihood is that of the filter
        """
        if self.innovations is not None:
            raise InputError("to_problem: a fit with process noise has no likelihood for a sampler; fit without")
        return Posterior(self.problem, self.fit.values, self.bounds.covariance)

    def samples(self) -> list[PredictedSamples]:
        """The fitted channels at the values found [K], as the march or the filter predicts them.

        Source: docs/theory/estimation_statistics.md, equation 1, or 32 for a fit with process noise.
        """
        if self.innovations is not None:
            return self.innovations.samples(self.fit.values)
        return self.problem.innovations(self.fit.values)


@one_thread()
def estimate(
    records: Record | str | os.PathLike[str] | Sequence[Record | str | os.PathLike[str]],
    parameters: Sequence[str] | None = None,
    *,
    reference: Mapping[str, float] | None = None,
    effects: Sequence[EffectUse] = (),
    fixed: Mapping[str, float] | None = None,
    priors: Mapping[str, Parameter | tuple[float, float]] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    ties: Sequence[Sequence[str]] = (),
    starts: Sequence[Start | StartMaker | None] | None = None,
    settings: NewtonSettings | None = None,
    process_noise: ProcessNoise | None = None,
    error_of: Callable[[Record], StatedError] | None = None,
    profiles: Sequence[str] = (),
    progress: Progress = no_progress,
) -> FitResult:
    """Fit parameters to records, jointly: maximum a posteriori, by Newton's method.

    records   : flight records or their directories, one or several
    parameters : dotted names; by default magnitude [-] and five derivatives, as far as the records identify them and
                the tables can hold them; under a lamp, without any flow, emittance and the conductivity and heat
                capacity of each layer, as far as the records inform them. `default` among them stands for these
    reference : values of ratio variables that derivatives are about ([deg], [-]), where not the records' own
    effects   : effects in addition to the declared model, their parameters estimated where `parameters` includes them
    fixed     : name -> value of a parameter that is not estimated, in place of the declared one
    priors    : name -> mean and standard deviation of another prior, infinite for a flat one; or a whole Parameter
    bounds    : name -> least and greatest value
    ties      : names that have one value, each a tie; a single name ties all parameters that it covers
    starts    : by record, where its march begins: a record_fit.Start, or what makes one (starts.STARTS)
    settings  : values that the iteration begins with, when it stops, and how far it may step
    process_noise : given or to be estimated; None for an output-error fit
    error_of  : what the model of a record may be off, integrated out of the likelihood, as `stated_error` has it; None
                for fits that know the noise alone
    profiles  : names of estimated parameters whose 95 % interval is sought by the profile (FitResult.profile)
    progress  : called with the fraction done and a line of text
    returns   : values, bounds, predictions [K] before and after, warnings
    raises    : InputError where nothing can be estimated, RunError where the model cannot be marched at the start or at
                the values found

    Of a record with very many readings neighbours are averaged where nothing moves between them, with the noise of the
    mean, and a warning says so (inputs/averaged_record.py).

    A name of all these may have an owner: a control point, `ratio.d_alpha@V09T9527`; for clocks and thermocouples a
    record or a flight, `clock.skew@STS-2`. A fit that does not converge is returned, with its status. Source:
    docs/theory/estimation_statistics.md, equations 13 to 26 and 31; 32 to 35 with process noise.

    >>> import sim_heating as sh
    >>> fit = sh.estimate("scenarios/records/practice/p06", ["ratio.scale", "ratio.d_alpha"])
    >>> fit
    <FitResult of p06: ratio.scale=0.0563... +- 0.003, ratio.d_alpha=9.35...e-05 +- 7e-05; converged>
    >>> fit.parameters["ratio.scale"].sigma < 0.01, fit.success
    (True, True)
    """
    if process_noise is not None:
        _refuse_beside_noise(profiles, error_of)
    listed = [records] if isinstance(records, (Record, str, os.PathLike)) else records
    loaded, outliers, notes = _cleaned(load_records(listed), progress)
    options = FitOptions(effects, fixed=fixed, priors=priors, bounds=bounds, ties=ties, starts=starts)
    first = {} if settings is None else settings.first_values
    problem, omitted = _informed_problem(loaded, parameters, joint_reference(loaded, reference), options, first)
    innovations = None
    if process_noise is not None:
        fit, innovations = _fit_with_noise(problem, process_noise, first, settings, progress)
    else:
        problem, fit = _fit_without_noise(problem, error_of, first, settings, progress)
    wanted_profiles = problem.owners.labels(profiles)
    check_profiles(wanted_profiles, [u.label for u in problem.unknowns], innovations)
    fit_result = replace(_fit_result(problem, fit, omitted, notes, innovations), outliers=tuple(outliers))
    LOG.info("%r in %d iterations", fit_result, fit.iterations)
    if not profiles:
        return fit_result
    return replace(fit_result, profiles={name: fit_result.profile(name) for name in wanted_profiles})


def _refuse_beside_noise(profiles: Sequence[str], error_of: Callable[[Record], StatedError] | None) -> None:
    if profiles:
        raise InputError(WITHOUT_NOISE.format(profiles[0]))
    if error_of is not None:
        raise InputError("the error of the model and process noise: both are of the heating; leave one of the two out")


def _cleaned(records: Sequence[Record], progress: Progress) -> tuple[list[Record], list[Outlier], list[str]]:
    """Records as they are fitted: without stuck sensors and outliers, averaged where they have very many readings.

    returns : the records, their outliers, and lines on what was left out and averaged
    """
    check_joint_records(records)
    stuck: list[str] = []
    outliers: list[Outlier] = []
    averaged: list[str] = []
    cleaned, fewer = [], []
    for record in records:
        used, lines = observability.without_stuck_sensors(record)
        stuck += lines
        used, of_record = without_outliers(used)
        outliers += of_record
        cleaned.append(used)
        used, lines = averaged_record(used)
        averaged += lines
        fewer.append(used)
    for line in averaged:
        progress(0.0, line)
    notes = [*averaged, *stuck, *outlier_lines(outliers, {record.name: record for record in cleaned})]
    return fewer, outliers, notes


def _informed_problem(
    records: Sequence[Record],
    parameters: Sequence[str] | None,
    condition: tuple[float, ...],
    options: FitOptions,
    first: Mapping[str, float],
) -> tuple[FitProblem, dict[str, str]]:
    """The problem of the parameters that the records determine, and why others are not estimated.

    condition : values of ratio variables that derivatives are about ([deg], [-])
    first     : values that the iteration begins with
    """
    names, omitted, optional = _labels_to_estimate(parameters, records, options)
    remaining = _remaining_names(names, omitted, records)
    options = _without(options, set(omitted), Owners(records))
    problem = FitProblem(records, remaining, condition, options)
    _check_samples(problem)
    while worst := _weakest(problem, first_values(problem, first), optional):
        omitted |= worst
        out = {m for u in problem.unknowns if u.label in worst for m in (u.tied or (u.label,))}
        remaining = _remaining_names([n for n in remaining if n not in out], omitted, records)
        options = _without(options, out, problem.owners)
        problem = FitProblem(records, remaining, condition, options)
    return problem, omitted


def _weakest(problem: FitProblem, values: FloatArray, optional: frozenset[str]) -> dict[str, str]:
    """Parameters to leave out next, and why: derivatives one at a time, since each lowers the bounds of the others."""
    return _least_determined(problem, values) or _uninformed(problem, values, optional)


def check_profiles(names: Sequence[str], labels: Sequence[str], innovations: Innovations | None) -> None:
    """Check that profiles are of parameters that are estimated, without process noise.

    names  : of which a profile is asked for;  labels : of the estimated parameters
    raises : InputError naming the first that is not
    """
    if names and innovations is not None:
        raise InputError(WITHOUT_NOISE.format(names[0]))
    for name in names:
        if name not in labels:
            hint = suggestion(name, labels, otherwise=f"; estimated are {', '.join(labels)}")
            raise InputError(f"profile of `{name}`: is not estimated{hint}")


def fit_problem(problem: FitProblem, first: FloatArray, *, settings: NewtonSettings | None = None) -> FitResult:
    """The fit of a problem that is set up, all of its parameters estimated.

    first   : (parameter,) values to start from, each in its unit
    returns : values, bounds, predictions [K] before and after, warnings
    raises  : RunError where the model cannot be marched at the start or at the values found

    Source: docs/theory/estimation_statistics.md, equations 13 to 26 and 31.
    """
    return _fit_result(problem, _fit(problem, first, settings, no_progress), {}, (), None)


def declared_model(record: Record, reasons: Mapping[str, str] | None = None) -> FitResult:
    """The declared model of a record in the form of a fit, with nothing estimated.

    record  : of which stuck sensors are left out
    reasons : parameter -> why it is not estimated
    returns : predictions [K], residuals and noise at the declared values
    raises  : InputError where readings are too few, RunError where the model cannot be marched

    For records from which no magnitude of the heating can be estimated, such as one under a lamp.
    """
    cleaned, outliers, notes = _cleaned([load_record(record)], no_progress)
    problem = FitProblem(cleaned, (), joint_reference(cleaned))
    _check_samples(problem)
    nothing = np.zeros(0)
    if _lacks_noise(problem):
        problem.update_noise(nothing)
    problem.correct_meshes(nothing)
    evaluation = problem.evaluate(nothing)
    if not np.isfinite(evaluation.log_likelihood):
        problem.samples(nothing)  # says what failed
        raise RunError(
            f"{record.name}: the declared model cannot be marched along the record; see `sim-heating predict`"
        )
    empty, log_p, at_bound = np.zeros((0, 0)), evaluation.log_likelihood, np.zeros(0, dtype=bool)
    ended = (Status.CONVERGED, 0, 0.0, np.zeros((1, 0)))
    fit = Fit((), nothing, empty, log_p, log_p, empty, nothing, at_bound, (), *ended)
    return replace(_fit_result(problem, fit, dict(reasons or {}), notes, None), outliers=tuple(outliers))


def _reasons_to_omit(label: str, covered: Sequence[Record], *, is_tied: bool, is_chosen: bool) -> dict[str, str]:
    """Why a parameter is left out before any march, by its label; empty where it is estimated.

    covered : records that it is of
    """
    # of tied ones the value is that of where the variable changes
    reasons = {} if is_tied else observability.constant_variables([label], covered)
    reasons |= observability.parameters_without_heating([label], covered)
    return reasons if is_chosen else observability.unsupported_derivatives([label], covered) | reasons


def _named(names: Sequence[str] | None, fixed: Collection[str]) -> list[str]:
    """Names that are stated, without that of the default; InputError where one of them is fixed."""
    named = [n for n in names or () if n != DEFAULT]
    for name in named:
        if not {name, name.partition(AT)[0]}.isdisjoint(fixed):
            raise InputError(f"{name}: is fixed, and named to be estimated; do one of the two")
    return named


def _labels_to_estimate(
    names: Sequence[str] | None, records: Sequence[Record], options: FitOptions
) -> tuple[list[str], dict[str, str], frozenset[str]]:
    """Labels of the parameters that are to be estimated; of those that are left out before any march, with reasons; and
    of those that are left out where the records do not inform them.

    raises : InputError where one is named and fixed
    """
    owners, fixed = Owners(records), options.fixed or {}
    fixed_labels = owners.labels(fixed)
    named = _named(names, fixed)
    by_default = _default_labels(names, owners)
    labels = [n for n in dict.fromkeys((*by_default, *owners.labels(named))) if n not in fixed_labels]
    require_estimated(options, owners, labels)
    tied = set().union(*map(owners.labels, options.ties))
    chosen = {*owners.labels((*named, *options.normal_priors, *(options.bounds or {}))), *tied}
    omitted = {n: _fixed_at(n, owners, fixed) for n in by_default if n in fixed_labels}
    for label in labels:
        omitted |= _reasons_to_omit(label, owners.covered(label), is_tied=label in tied, is_chosen=label in chosen)
    thermal = frozenset(n for n in by_default if not n.startswith("ratio.")) - chosen
    return labels, omitted, thermal


def _default_labels(names: Sequence[str] | None, owners: Owners) -> list[str]:
    """Labels of the parameters that are estimated by default: of the heating, or of the wall where there is none."""
    if names is not None and DEFAULT not in names:
        return []
    of_heating = observability.default_names(owners.records)
    if not observability.parameters_without_heating(of_heating, owners.records):
        return [
            label
            for label in owners.labels(of_heating)
            if not observability.lacks_surface(label, owners.covered(label))
        ]
    return owners.labels(observability.default_thermal_names(owners.records))


def _without(options: FitOptions, labels: set[str], owners: Owners) -> FitOptions:
    """Options without what they state of some parameters alone, by label; a tie of any of these is void."""

    def remains(name: str) -> bool:
        return not set(owners.labels([name])) <= labels

    return replace(
        options,
        priors={n: p for n, p in (options.priors or {}).items() if isinstance(p, Parameter) or remains(n)},
        bounds={n: v for n, v in (options.bounds or {}).items() if remains(n)},
        ties=[tie for tie in options.ties if not labels & set(owners.labels(tie))],
    )


def _fixed_at(label: str, owners: Owners, fixed: Mapping[str, float]) -> str:
    """Why a parameter that is fixed is not estimated."""
    name = label.partition(AT)[0]
    value = owners.stated(fixed, owners.covered(label)[0])[name]
    unit = MODEL[name].unit
    return f"fixed at {value:g}{'' if unit == '1' else f' {unit}'}"


def _remaining_names(names: Sequence[str], omitted: Mapping[str, str], records: Sequence[Record]) -> list[str]:
    """The names that remain to be estimated.

    raises : InputError with the reasons where none remains
    """
    remaining = [n for n in names if n not in omitted]
    if not remaining:
        raise InputError(f"{records[0].name}: nothing to estimate: {'; '.join(dict.fromkeys(omitted.values()))}")
    return remaining


def _check_samples(problem: FitProblem) -> None:
    times = sum(len(record_fit.sample_s) for record_fit in problem.record_fits)
    if times < FEWEST_SAMPLES:
        names = ", ".join(record_fit.record.name for record_fit in problem.record_fits)
        raise InputError(
            f"{names}: readings at {times} time(s) in the fit segments, too few to estimate from; at least "
            f"{FEWEST_SAMPLES} are needed"
        )


def check_joint_records(records: Sequence[Record], do: str = "estimate") -> None:
    """Check that records may be fitted together.

    do     : what a message advises to do with each record by itself
    raises : InputError where there is none, or ratios of one point are over different references
    """
    if not records:
        raise InputError(f"{do}: no record; give at least one")
    models = {r.declared.heating.reference for r in records}
    if len(models) > 1:
        raise InputError(
            f"records: their ratios are over different reference heatings ({', '.join(sorted(models))}) and have no "
            f"common derivatives; {do} each record by itself"
        )
    # Points may differ: their derivatives do not mix.
    recoveries: dict[str, set[str]] = {}
    for r in records:
        recoveries.setdefault(r.declared.control_point, set()).add(r.declared.heating.recovery_of_point.kind)
    for point, kinds in recoveries.items():
        if len(kinds) > 1:
            raise InputError(
                f"records of {point}: their ratios are reduced with different recovery enthalpies "
                f"({', '.join(sorted(kinds))}) and have no common derivatives; {do} each record by itself"
            )


def first_values(problem: FitProblem, begin: Mapping[str, float]) -> FloatArray:
    """Start of the fit: as given, prior means, and for a ratio without a table the likeliest of some magnitudes."""
    first = np.array([begin.get(p.name, p.value) for p in problem.parameters])
    bare = [k for k, u in enumerate(problem.unknowns) if u.parameter.name == "ratio.d0" and first[k] == 0.0]
    for k in bare:
        tried = np.tile(first, (len(MAGNITUDES_TRIED), 1))
        tried[:, k] = MAGNITUDES_TRIED
        # from a ratio of 0 the wall stays cold and the gradient points nowhere useful: a coarse scan in the log first
        first = tried[int(np.nanargmax(problem.log_likelihoods(tried)))]
    return first


def _information(problem: FitProblem, values: FloatArray) -> FloatArray:
    check_parameters(problem.parameters)
    evaluation = problem.evaluate(values)
    if not np.isfinite(evaluation.log_likelihood):
        problem.samples(values)  # says what failed
        raise RunError("estimate: the declared model cannot be marched along the record; see `sim-heating predict`")
    return evaluation.information + np.diag([p.sigma**-2.0 for p in problem.parameters])


def _typical_ratios(problem: FitProblem, values: FloatArray) -> FloatArray:
    """(record,) heating ratio [-]: that of the reference condition where it is estimated, else the declared mean."""
    ratios = np.array([observability.mean_ratio(record_fit.record) for record_fit in problem.record_fits])
    for u, value in zip(problem.unknowns, values, strict=True):
        if is_d0(u.parameter):
            ratios[list(u.records)] = abs(value)
    return ratios


def _least_determined(problem: FitProblem, values: FloatArray) -> dict[str, str]:
    """The least determined parameter of a problem at a vector, and why it should be omitted; empty for none."""
    labels = [u.label for u in problem.unknowns]
    typical = _typical_ratios(problem, values)
    ratio, excursion = np.full(len(labels), np.nan), np.zeros((len(labels), len(RATIO_VARIABLES)))
    flown: dict[tuple[int, ...], FloatArray] = {}
    for k, u in enumerate(problem.unknowns):
        ratios = typical[list(u.records)]
        if np.any(np.isfinite(ratios)):
            ratio[k] = np.mean(ratios[np.isfinite(ratios)])
        if u.records not in flown:
            flown[u.records] = observability.deviations([problem.record_fits[i].record for i in u.records])
        excursion[k] = flown[u.records]
    return observability.least_determined(labels, _information(problem, values), ratio, excursion)


def _uninformed(problem: FitProblem, values: FloatArray, optional: Collection[str]) -> dict[str, str]:
    """Optional parameters of a problem that the records do not inform, with the reason, at a parameter
    vector."""
    labels = [u.label if u.label in optional else "" for u in problem.unknowns]
    if not any(labels):
        return {}
    sigma = np.array([p.sigma for p in problem.parameters])
    return observability.uninformed(labels, _information(problem, values), sigma)


def is_d0(parameter: Parameter) -> bool:
    """Whether a parameter is the heating ratio itself [-], where there is no table."""
    return parameter.name == observability.MAGNITUDES[1]


def _lacks_noise(problem: FitProblem) -> bool:
    """Whether a fitted sensor declares no noise, which is then estimated."""
    return any(c.sensor.noise_sigma_K is None for r in problem.record_fits for c in r.channels)


def _part_done(steps: int) -> float:
    """Part of a fit that is done after a number of steps, which is usually three to five and not known before."""
    return 0.9 * (1.0 - 0.65**steps)


def _fit(problem: FitProblem, first: FloatArray, settings: NewtonSettings | None, progress: Progress) -> Fit:
    """Newton's iteration, in turn with the noise of the sensors that declare none, and again with meshes corrected."""
    steps = [0]

    def report(vector: FloatArray, log_posterior: float) -> None:
        steps[0] += 1
        LOG.debug("iteration %d: log posterior %.4f at %s", steps[0], log_posterior, vector)
        progress(_part_done(steps[0]), f"iteration {steps[0]}: log posterior {log_posterior:.2f}")

    unknown_noise = _lacks_noise(problem)
    if unknown_noise:
        # residuals at the start include model errors: this noise is too large, and is set again after the fit
        problem.update_noise(first)

    def fit_from(start: FloatArray) -> Fit:
        return maximise(problem.evaluate, problem.parameters, start, problem.log_likelihoods, settings, report)

    fit = fit_from(first)
    for _ in range(NOISE_ROUNDS if unknown_noise else 0):
        if not fit.converged or problem.update_noise(fit.values) < NOISE_CHANGE:
            break
        fit = fit_from(fit.values)
    if fit.converged or fit.status is Status.ITERATIONS:
        # only now: the error of a mesh depends on the parameters, and costs several marches
        problem.correct_meshes(fit.values)
        fit = fit_from(fit.values)
    return replace(fit, iterations=steps[0])


def _with_noisy_conditions(problem: FitProblem, fit: Fit, settings: NewtonSettings | None) -> tuple[FitProblem, Fit]:
    """The problem with the noise of its records' conditions, and its fit from that without; as they are without any.

    Source: docs/theory/model_error.md, equations 9 and 10.
    """
    if fit.status is Status.NO_START or all(conditions_noise(r.record) is None for r in problem.record_fits):
        return problem, fit
    noises = [heating_noise(record_fit, fit.values) for record_fit in problem.record_fits]
    pairs = list(zip(problem.record_fits, noises, strict=True))
    noisy = problem.with_model_errors([None if n is None else noise_error(r, fit.values, n) for r, n in pairs])
    refined = maximise(noisy.evaluate, noisy.parameters, fit.values, noisy.log_likelihoods, settings)
    return noisy, replace(refined, iterations=fit.iterations + refined.iterations)


def _fit_with_errors(
    problem: FitProblem, first: FloatArray, stated: Sequence[StatedError], settings: NewtonSettings | None
) -> tuple[FitProblem, Fit]:
    """The problem with the errors of its models, as large as the readings say, and its fit."""
    if _lacks_noise(problem):
        problem.update_noise(first)
    problem.correct_meshes(first)
    noisy, _ = with_stated_errors(problem, first, stated, sized=False)
    fit = maximise(noisy.evaluate, noisy.parameters, first, noisy.log_likelihoods, settings)
    for _ in range(ERROR_ROUNDS):
        if fit.status is Status.NO_START:
            break
        noisy, _ = with_stated_errors(problem, fit.values, stated)
        steps = fit.iterations
        fit = maximise(noisy.evaluate, noisy.parameters, fit.values, noisy.log_likelihoods, settings)
        fit = replace(fit, iterations=steps + fit.iterations)
    return noisy, fit


def _fit_without_noise(
    problem: FitProblem,
    error_of: Callable[[Record], StatedError] | None,
    first: Mapping[str, float],
    settings: NewtonSettings | None,
    progress: Progress,
) -> tuple[FitProblem, Fit]:
    """The fit with the errors of the models where these are stated, else with the noise of the conditions alone."""
    stated = [] if error_of is None else [error_of(r.record) for r in problem.record_fits]
    start = first_values(problem, first)
    if any(s.heating is not None for s in stated):
        return _fit_with_errors(problem, start, stated, settings)
    return _with_noisy_conditions(problem, _fit(problem, start, settings, progress), settings)


def _fit_with_noise(
    problem: FitProblem,
    noise: ProcessNoise,
    first: Mapping[str, float],
    settings: NewtonSettings | None,
    progress: Progress,
) -> tuple[Fit, Innovations | None]:
    """The fit without process noise, and from its values that with it; the first alone where it has no start."""
    if any(not isinstance(r.by_pressure_K, float) for r in problem.record_fits):
        raise InputError(f"`{PRESSURE_FACTOR.name}`: no filter with process noise changes it; leave one of the two out")
    fit = _fit(problem, first_values(problem, first), settings, progress)
    return (fit, None) if fit.status is Status.NO_START else _fit_filtered(problem, noise, fit, progress)


def _fit_filtered(problem: FitProblem, noise: ProcessNoise, first: Fit, progress: Progress) -> tuple[Fit, Innovations]:
    """The fit on the innovations of the filter, starting from one without process noise."""
    steps = [first.iterations]

    def report(vector: FloatArray, log_posterior: float) -> None:
        steps[0] += 1
        progress(_part_done(steps[0]), f"iteration {steps[0]}: log posterior {log_posterior:.2f}, filtered")

    fit, innovations = fit_innovations(problem, noise, first.values, report)
    return replace(fit, iterations=steps[0]), innovations


def _fit_result(
    problem: FitProblem, fit: Fit, omitted: dict[str, str], notes: Sequence[str], innovations: Innovations | None
) -> FitResult:
    if fit.status is Status.NO_START:
        raise RunError(f"estimate: {fit.describe()[0]}")
    samples = problem.innovations(fit.values) if innovations is None else innovations.samples(fit.values)
    # errors before and after are those of the plain march, also with process noise: a filter follows the readings it is
    # compared with
    flown = zip(problem.record_fits, problem.errors(fit.values), strict=True)
    after = tuple(predict_fit(record_fit, fit.values, u) for record_fit, u in flown)
    before = tuple(predict_record(r.record, point_of_record(r.record)) for r in problem.record_fits)
    undeclared = (undeclared_effects(r.record) for r in problem.record_fits)
    notes = (
        *notes,
        *filter(None, undeclared),
        *start_warnings(problem.record_fits),
        *table_warnings(problem.record_fits),
        *fit_warnings(problem, fit, samples),
    )
    return FitResult(problem, fit, _bounds(problem, fit, samples), omitted, before, after, notes, innovations)


def _bounds(problem: FitProblem, fit: Fit, samples: Sequence[PredictedSamples]) -> CramerRaoBounds:
    errors = [r.model_error for r in problem.record_fits if r.model_error is not None]
    # an error of the model is in the information already, and what it leaves is white; noise of the conditions is not
    # all that a model may lack
    if not all(e.is_noise_alone for e in errors):
        count = sum(len(s.mean_K) for s in samples) - len(fit.values)
        return CramerRaoBounds(fit.covariance, fit.covariance, float(count), {})
    return fit_bounds(problem.samples(fit.values) if errors else samples, fit)


def predict_fit(record_fit: RecordFit, values: FloatArray, error: FloatArray = NO_ERROR) -> Prediction:
    """The plain march of a record at a parameter vector, no measurement assimilated.

    record_fit : record with its start and mesh;  values : (parameter,)
    error      : (unknown,) error of its model: that of the flight is marched, and that of the heating is left out
    returns : predicted indications [K] of all sensors at the record's times; NaN before the start of the fit and after
              the last sample that is fitted or held out

    It ends there because the ratio of a short segment need not be valid far from it.
    Source: docs/theory/estimation_statistics.md, equation 1, without the correction of equation 31.
    """
    of_record, record = record_fit.values(values), record_fit.record
    errors = {s.name: sensor_errors(s, of_record) for s in record.sensors}
    wanted_s = record.time_s[record.fit_mask() | record.holdout_mask()]
    begin = record_fit.begin_s
    # a shifted sample is read later than it was recorded
    end = min(float(wanted_s.max()) + max(record_fit.shift_s(values), 0.0), record_fit.conditions.time_s[-1])
    initial_K, model_error, flown = record_fit.initial_K(values), record_fit.model_error, record
    profile = None if initial_K is None else np.column_stack([record_fit.mesh.depth_m, initial_K])
    if model_error is not None and model_error.flight is not None:
        if record_fit.flight_names:
            flown = model_error.flight.record(np.array([of_record[n] for n in record_fit.flight_names]))
        elif len(error) > 0:
            flown = model_error.flight.record(model_error.along_flight(error))
    flown = replace(flown, pressure_factor=(record_fit.pressure_factor(values), 0.0))
    marched, model = marched_from(flown, record_fit.model_at(values), begin, end, profile)
    prediction = predict_record(marched, model, skew_s=-record_fit.shift_s(values), errors=errors)
    return replace(prediction, record=record)


def fit_bounds(samples: Sequence[PredictedSamples], fit: Fit) -> CramerRaoBounds:
    """Bounds of the values found, corrected for coloured residuals; 0 for parameters on a bound.

    samples : predictions [K] and sensitivities at the values found, without an error of the model
    fit     : which parameters are on a bound, and priors
    raises  : InputError where there are no more samples than parameters

    Source: docs/theory/estimation_statistics.md, equations 22 to 25.
    """
    channels: list[Residuals] = []
    noisy = {id(s.record_fit): s.record_fit for s in samples if s.record_fit.model_error is not None}
    for key, record_fit in noisy.items():
        channels += whitened(record_fit, [s for s in samples if id(s.record_fit) == key], ~fit.on_bound)
    for s in samples:
        if id(s.record_fit) in noisy:
            continue
        scored = likelihood(s.channel.intervals, s.mean_K, s.spread_K)
        name = f"{s.record_fit.record.name}/{s.channel.sensor.name}"
        channels.append(Residuals(name, s.time_s, scored.score, scored.information, s.jacobian[:, ~fit.on_bound]))
    # a parameter on its bound does not move with the data; left in, it would widen the bounds of the others
    free = cramer_rao_bounds(channels, fit.prior_information[~fit.on_bound])
    free_block = np.ix_(~fit.on_bound, ~fit.on_bound)
    corrected, white = np.zeros_like(fit.covariance), np.zeros_like(fit.covariance)
    corrected[free_block], white[free_block] = free.covariance, free.white
    return replace(free, covariance=corrected, white=white)


def start_warnings(record_fits: Sequence[RecordFit]) -> list[str]:
    """One line for each record whose march begins as declared and whose first reading [K] is not there."""
    others = [other_start(record_fit.record) for record_fit in record_fits if record_fit.start is None]
    return [other.in_words for other in others if other is not None]


def table_warnings(record_fits: Sequence[RecordFit]) -> list[str]:
    """One line for each variable ([deg], [-]) that leaves the ratio table over the fit segments, or has no slope in it,
    and for each control point whose records declare different tables.

    Outside, the table has its edge value, so that the estimate includes the difference (docs/theory/equations.md,
    section 2). A derivative against a variable with one node is estimated, but no revision of this table can hold it.
    """
    lines = _different_tables([record_fit.record for record_fit in record_fits])
    for record_fit in record_fits:
        name, conditions = record_fit.record.name, record_fit.conditions
        fitted = conditions.at(conditions.time_s[record_fit.record.fit_mask(conditions.time_s)])
        lines += [
            f"{name}: {o.variable} is up to {o.farthest:.3g} outside its ratio table over the fit segments, from "
            f"{o.first_s:g} s on; the edge value is used there, and estimates include the difference"
            for o in table_excursions(record_fit.model, fitted)
        ]
        table = record_fit.model.ratio
        lines += [
            f"{name}: its ratio table has one node in {variable}, so that no revision of it can hold ratio.d_{short}; "
            "add nodes to the table before update-tables"
            for variable, short, axis in zip(RATIO_VARIABLES, SHORT_NAMES, table.axes if table else (), strict=False)
            if len(axis) == 1 and f"ratio.d_{short}" in record_fit.march_names
        ]
    return lines


def _different_tables(records: Sequence[Record]) -> list[str]:
    """One line for each control point whose records declare different ratio tables."""
    first: dict[str, Record] = {}
    lines: dict[str, str] = {}
    for record in records:
        earlier = first.setdefault(record.declared.control_point, record)
        a, b = earlier.ratio_table, record.ratio_table
        same = a is b or (a is not None and b is not None and _same_nodes(a, b))
        if not same:
            names = f"{earlier.name} and {record.name}"
            lines.setdefault(
                record.declared.control_point,
                f"{names} declare different ratio tables; a common estimate is relative to each",
            )
    return list(lines.values())


def _same_nodes(a: RatioTable, b: RatioTable) -> bool:
    """Whether two tables have the same ratios at the same nodes."""
    pairs = ((*a.axes, a.ratio), (*b.axes, b.ratio))
    return all(np.array_equal(array, other) for array, other in zip(*pairs, strict=True))


def fit_warnings(problem: FitProblem, fit: Fit, samples: Sequence[PredictedSamples]) -> list[str]:
    """Warnings about a fit: convergence, mesh errors [K], bounds, a likely clock error, unidentified directions.

    samples : fitted channels at the values found

    Thresholds are 1.3 times the expected RMS of residuals [-], and scaled eigenvalues of 1e-6.
    Source: docs/theory/estimation_statistics.md, equations 19 and 29.
    """
    lines = [] if fit.status is Status.CONVERGED else [fit.status.value]
    if fit.status is Status.KINK:
        lines = [f"{lines[0]}, and a sigma is of one side of it; `--profile NAME` gives the interval of a parameter"]
    lines += problem.mesh_warnings
    for u, value, bounded in zip(problem.unknowns, fit.values, fit.on_bound, strict=True):
        if bounded:
            lines.append(f"{u.label} is on its bound, {value:g}")
        # a lead of some seconds removes the whole lag of a coating: docs/theory/clocks_and_starts.md, first table
        model = problem.record_fits[u.records[0]].model
        if bounded and model.same_parameter(u.parameter.name, "stack.coating.thickness_factor") and value < 1.0:
            lines.append(
                "a coating thickness on its lower bound mostly indicates a clock error, thermocouples that lead the "
                f"flight conditions; estimate {CLOCK_SKEW.name} as well"
            )
    excess = rms_normalised_residual(samples)
    if excess > MODEL_ERROR_RATIO:
        lines.append(
            f"residuals are {excess:.1f} times as large as those of noise alone: the model is incomplete, and the "
            "bounds do not include its error"
        )
    return lines + [f"{d.describe()}; their bounds are wide" for d in fit.singular]


def rms_normalised_residual(everything: Sequence[PredictedSamples]) -> float:
    """RMS of the residuals over that which noise and rounding give [-]: 1 for the true model.

        sqrt(sum_i u_i^2 / sum_i I_i)

    everything : all fitted channels, scores u [1/K] and information I [1/K2] of which are those at their predictions
                 [K]

    Source: docs/theory/estimation_statistics.md, equation 29.
    """
    scored = [likelihood(s.channel.intervals, s.mean_K, s.spread_K) for s in everything]
    squares = sum(float(np.sum(f.score**2)) for f in scored)
    return float(np.sqrt(squares / sum(float(np.sum(f.information)) for f in scored)))


def lag1_autocorrelation(everything: Sequence[PredictedSamples]) -> float:
    """Lag-1 autocovariance of the residuals over the variance that noise and rounding give [-].

        sum_i u_i u_(i+1) / sum_i I_i

    0 for white noise of any size; larger where the model errs for longer than a sample. Samples that follow each other
    in a channel count as neighbours, whatever the time [s] between them.

    Source: docs/theory/estimation_statistics.md, equation 30.
    """
    scored = [likelihood(s.channel.intervals, s.mean_K, s.spread_K) for s in everything]
    products = sum(float(np.sum(f.score[1:] * f.score[:-1])) for f in scored)
    return products / sum(float(np.sum(f.information)) for f in scored)
