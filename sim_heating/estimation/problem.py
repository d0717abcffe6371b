"""The likelihood of all samples of some records as a function of their unknown parameters.

Every record is marched with its sensitivities (march/linearised.py), its samples are compared with the predicted
indications of its sensors (record_fit.py), and log likelihood, gradient and information add up over the records
(docs/theory/estimation_statistics.md, equations 13 and 14). Parameters of heating and stack are those of a control
point, shared by all its records; those of clocks, sensors and initial profiles belong to one record. Records on common
times are marched side by side, others in threads.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files import suggestion
from sim_heating.base.kernels.block import LANES
from sim_heating.base.parallel.threads import in_threads
from sim_heating.base.parameters import AT, CLOCK_SKEW, EFFECT_PREFIX, Parameter
from sim_heating.estimation.inference.error_likelihood import innovations, scored_readings
from sim_heating.estimation.inference.model_error import FLIGHT_PREFIX, ModelError
from sim_heating.estimation.inference.newton import Evaluation
from sim_heating.estimation.inference.noise import estimate_noise
from sim_heating.estimation.record_fit import (
    LONGEST_STEP_S,
    PredictedSamples,
    RecordFit,
    Sensed,
    Start,
    StartMaker,
    correct_mesh,
    fitted_channels,
    group_march,
    indications,
    lane_groups,
    least_sigma_K,
    march_times,
    sensor_definition,
    set_parameters,
)
from sim_heating.heating.effects import EffectUse, use
from sim_heating.heating.effects.definition import ModelParameter
from sim_heating.heating.effects.recombination import RECOMBINATION
from sim_heating.inputs.parameter_owners import Owners, is_of_record
from sim_heating.inputs.points import conditions_of_record, flow_of_record, point_of_record
from sim_heating.inputs.record import Record
from sim_heating.march.linearised import Linearised, LinearMarch
from sim_heating.march.mesh_choice import choose_meshes, meshes_on_flights
from sim_heating.march.point import PointModel, check_one_name
from sim_heating.thermal.frame import STEP_TOLERANCE_K
from sim_heating.thermal.mesh import Mesh


@dataclass(frozen=True)
class FitParameter:
    """One estimated parameter.

    label     : its name in results, with its record or control point where there are several
    parameter : definition, prior and bounds
    records   : indices of the records that have it
    tied      : labels of the parameters that it stands for, where these are tied
    """

    label: str
    parameter: Parameter
    records: tuple[int, ...]
    tied: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class FitOptions:
    """Options of a fit, all with defaults.

    Names are as in inputs/parameter_owners.py: plain, or with an owner behind @.

    effects        : in addition to the declared model, and to those that the names of parameters imply
    fixed          : name -> value of a parameter in place of the declared one, where it is not estimated
    priors         : name -> mean and standard deviation of another prior, infinite for a flat one; or a Parameter with
                     another prior or other bounds
    bounds         : name -> least and greatest value
    ties           : names of parameters that have one value, each a tie; a single name ties all that it covers
    prior_scale    : factor on the sigma of all other priors [-]; infinite for flat ones
    starts         : by record, start of its march, how that is made, or None for the declared one
    sample_masks   : (sample,) of each record, which of its samples are fitted; by default those of the fit segments
    longest_step_s : limit on the steps of the march [s]
    tolerance_K    : largest error of a step [K]; steps are divided for it once, at the values that the fit starts from
    """

    effects: Sequence[EffectUse] = ()
    fixed: Mapping[str, float] | None = None
    priors: Mapping[str, Parameter | tuple[float, float]] | None = None
    bounds: Mapping[str, tuple[float, float]] | None = None
    ties: Sequence[Sequence[str]] = ()
    prior_scale: float = 1.0
    starts: Sequence[Start | StartMaker | None] | None = None
    sample_masks: Sequence[NDArray[np.bool_]] | None = None
    longest_step_s: float = LONGEST_STEP_S
    tolerance_K: float = STEP_TOLERANCE_K

    @property
    def normal_priors(self) -> dict[str, tuple[float, float]]:
        """Means and standard deviations by name, each in the unit of the parameter ([-] for a ratio)."""
        return {n: p for n, p in (self.priors or {}).items() if not isinstance(p, Parameter)}


DEFAULT_OPTIONS = FitOptions()
LastMarches = list[tuple[bytes | None, Sequence[Linearised]]]
"""By group of records, the last parameter vector, as bytes, and its marches [K]; a copy of a problem goes on there."""


class FitProblem:
    """The fit of some parameters to some records.

    records   : flight records
    names     : dotted names of the parameters
    reference : the condition that derivatives are about: alpha, beta [deg], log10 Re [-], elevon, bodyflap [deg]
    options   : effects, priors, starts and samples, where not the declared ones
    raises    : InputError where no sample is fitted, or a parameter does not exist in the model

    Likelihood: docs/theory/estimation_statistics.md, equations 3 to 14.
    """

    def __init__(
        self,
        records: Sequence[Record],
        names: Sequence[str],
        reference: tuple[float, ...],
        options: FitOptions = DEFAULT_OPTIONS,
    ) -> None:
        self.reference, self.options = reference, options
        self.priors = {n: p for n, p in (options.priors or {}).items() if isinstance(p, Parameter)}
        self.owners = Owners(records)
        fixed = [self.owners.stated(options.fixed or {}, r) for r in records]
        own = [self.owners.of_record(names, r) for r in records]
        models = [self._model(r, n, f) for r, n, f in zip(records, own, fixed, strict=True)]
        # the mesh is chosen once, for the declared model: a likelihood with another mesh at each step would not be
        # smooth, and those of two models could not be compared
        meshes = [_mesh(point_of_record(r), r, options.longest_step_s) for r in records]
        begin = list(options.starts) if options.starts is not None else [None] * len(records)
        self.record_fits = [
            self._record_fit(record, model, mesh, start(record, model, mesh) if callable(start) else start, n, f)
            for record, model, mesh, start, n, f in zip(records, models, meshes, begin, own, fixed, strict=True)
        ]
        self.unknowns = self._index_parameters()
        for i, record_fit in enumerate(self.record_fits):
            self._choose_samples(record_fit, None if options.sample_masks is None else options.sample_masks[i])
        self._divide_steps()
        self._group()

    @classmethod
    def joined(cls, parts: Sequence[FitProblem], owners: Sequence[Mapping[str, str]]) -> FitProblem:
        """One problem of several, whose likelihoods add up: some parameters are common to records, the others own.

        parts   : problems of one record each, with the samples, noise, meshes and priors that they have
        owners  : by part, dotted name -> the owner of the parameter, such as a control point; parameters of one name
                  and owner are one, with the prior of the first part that has it. An empty owner is all records; a
                  parameter that is not listed is the record's own
        returns : the problem; labels are `name`, or `name@owner`. Its `reference` is that of the first part alone
        """
        joint = copy(parts[0])
        found: dict[tuple[str, str], tuple[Parameter, list[int]]] = {}
        places = []
        for i, (part, own) in enumerate(zip(parts, owners, strict=True)):
            record_fit = part.record_fits[0]
            keys = [(u.parameter.name, own.get(u.parameter.name, record_fit.record.name)) for u in part.unknowns]
            for key, unknown in zip(keys, part.unknowns, strict=True):
                found.setdefault(key, (unknown.parameter, []))[1].append(i)
            places.append([keys[k] for k in record_fit.index])
        order = list(found)
        joint.record_fits = [
            replace(part.record_fits[0], index=np.array([order.index(key) for key in keys], dtype=np.int64))
            for part, keys in zip(parts, places, strict=True)
        ]
        joint.unknowns = [
            FitParameter(f"{name}{AT}{owner}" if owner else name, parameter, tuple(numbers))
            for (name, owner), (parameter, numbers) in found.items()
        ]
        joint._group()
        return joint

    def __getstate__(self) -> dict[str, Any]:
        """All but the marches, which hold addresses of compiled code and are made when they are asked for."""
        groups, records = len(self.groups), len(self.record_fits)
        return {
            **self.__dict__,
            "_marches": [None] * groups,
            "_plain_marches": [None] * records,
            "last_marches": [(None, [])] * groups,
        }

    def with_correction(self, correction_K: FloatArray) -> FitProblem:
        """The problem of one record with another mesh correction.

        correction_K : (sensor, sample) [K]
        """
        return self.with_record_fits([replace(self.record_fits[0], correction_K=correction_K)])

    def with_model_error(self, error: ModelError) -> FitProblem:
        """The problem of one record with another error of its model.

        error : with responses [K] at the samples of this problem, and maybe at others

        Source: docs/theory/model_error.md, equation 1.
        """
        return self.with_model_errors([error])

    def with_model_errors(self, errors: Sequence[ModelError | None]) -> FitProblem:
        """The problem with other errors of its models, by record.

        errors : each with responses [K] at the samples of its record, and maybe at others; None for an exact model

        Source: docs/theory/model_error.md, equation 1.
        """
        return self.with_record_fits([replace(r, model_error=e) for r, e in zip(self.record_fits, errors, strict=True)])

    def with_record_fits(self, record_fits: Sequence[RecordFit]) -> FitProblem:
        """The problem with other conditions, corrections or errors of its records.

        record_fits : of the same unknowns and samples, corrections and responses in [K]

        Likelihood: docs/theory/estimation_statistics.md, equations 3 to 14.
        """
        other = copy(self)
        other.record_fits = list(record_fits)
        other._group()
        return other

    def without_heating_error(self) -> FitProblem:
        """The problem without the smooth errors of the heating; itself where no record has one.

        Errors of flights, and slow noise of sensors, stay: s = 0 in docs/theory/model_error.md, equation 1.
        """
        if all(part.model_error is None for part in self.record_fits):
            return self
        errors = [part.model_error for part in self.record_fits]
        return self.with_model_errors([None if e is None else e.of_size(0.0, e.correlation_s) for e in errors])

    def with_flight_unknowns(self, limit: float = math.inf) -> FitProblem:
        """The problem with the errors of its flights as unknowns, which several records of one flight may share.

        limit : bound on each of them, those that are unknowns already as well, in standard deviations [-]

        The problem as it is where no flight has any. Each is in standard deviations of its prior [-]: f of
        docs/theory/model_error.md, equation 1.
        """
        of_flight = Parameter("", "1", 0.0, 1.0, -limit, limit, text="error of the flight")
        unknowns = [
            replace(u, parameter=replace(of_flight, name=u.parameter.name))
            if u.parameter.name.startswith(FLIGHT_PREFIX) else u
            for u in self.unknowns
        ]  # fmt: skip
        parts = []
        for i, part in enumerate(self.record_fits):
            names = () if part.model_error is None or part.flight_names else part.model_error.flight_names
            own = f"{AT}{part.record.name}" if len(self.record_fits) > 1 else ""
            index = np.append(part.index, len(unknowns) + np.arange(len(names)))
            unknowns += [FitParameter(f"{n}{own}", replace(of_flight, name=n), (i,)) for n in names]
            parts.append(replace(part, flight_names=names, index=index) if names else part)
        if len(unknowns) == len(self.unknowns) and limit == math.inf:
            return self
        other = self.with_record_fits(parts)
        other.unknowns = unknowns
        return other

    # Parameters ------------------------------------------------------------------------------------------------------

    def _model(self, record: Record, names: Sequence[str], fixed: Mapping[str, float]) -> PointModel:
        """The model of a record's point with its effects and with what is fixed in it.

        raises : InputError for a fixed value beyond the limits of its parameter
        """
        given = (*self.options.effects, *record.declared.heating.effects)
        implied = implied_effects((*names, *fixed), given)
        model = point_of_record(record, effects=(*self.options.effects, *implied))
        for problem in without_action((*names, *fixed), record, model).values():
            raise InputError(problem)
        for name, value in fixed.items():
            p = sensor_definition(record, name) or model.definition(name)
            if not p.lower <= value <= p.upper:
                raise InputError(f"{name}: fixed at {value:g}, outside its limits {p.lower:g} to {p.upper:g}")
        of_point = {n: v for n, v in fixed.items() if not is_of_record(n)}
        check_one_name(model.name, model.places, [*of_point, *(n for n in names if not is_of_record(n))])
        return replace(model.with_parameters(of_point), reference=self.reference)

    @staticmethod
    def _record_fit(
        record: Record,
        model: PointModel,
        mesh: Mesh,
        start: Start | None,
        names: Sequence[str],
        fixed: Mapping[str, float],
    ) -> RecordFit:
        sensor_names = tuple(n for n in names if sensor_definition(record, n) is not None)
        march_names = tuple(n for n in names if n not in sensor_names)
        for name in march_names:
            model.definition(name)
        conditions = conditions_of_record(record, flow_of_record(record, model.effects))
        known = {n: v for n, v in fixed.items() if is_of_record(n)}
        return RecordFit(record, model, mesh, start, conditions, march_names, sensor_names, fixed=known)

    def _index_parameters(self) -> list[FitParameter]:
        """Index the unknowns of every record in the parameter vector, shared where they are of one point, or tied."""
        found: dict[str, FitParameter] = {}
        labels = []
        for i, record_fit in enumerate(self.record_fits):
            of_start = [p.name for p in record_fit.start.unknowns] if record_fit.start else []
            labels.append([self._label(name, record_fit.record, name in of_start) for name in record_fit.names])
            for name, label in zip(record_fit.names, labels[-1], strict=True):
                known = found.get(label) or FitParameter(label, self._parameter(record_fit, name), ())
                found[label] = replace(known, records=(*known.records, i))
        require_estimated(self.options, self.owners, list(found))
        unknowns, stands_for = self._tied(found)
        places = [u.label for u in unknowns]
        for record_fit, own in zip(self.record_fits, labels, strict=True):
            index = [places.index(stands_for.get(label, label)) for label in own]
            record_fit.index = np.array(index, dtype=np.int64)
        return unknowns

    def _label(self, name: str, record: Record, of_start: bool) -> str:
        if of_start:  # temperatures at a start are of a record, as its clock is
            return f"{name}{AT}{record.name}" if len(self.owners.records) > 1 else name
        return self.owners.label(name, record)

    def _tied(self, found: Mapping[str, FitParameter]) -> tuple[list[FitParameter], dict[str, str]]:
        """The unknowns with those that are tied made one, and the label of that one for each of them.

        The one has the definition and the prior of the first, and the narrowest of their bounds.
        raises : InputError where a tie has one parameter only, or parameters of two units
        """
        stands_for: dict[str, str] = {}
        groups: dict[str, list[str]] = {label: [label] for label in found}
        for names in self.options.ties:
            own = [label for label in self.owners.labels(names) if label in found]
            if len(own) < 2:
                raise InputError(f"{'='.join(names)}: ties one parameter only; name another one to be equal to it")
            joined = list(dict.fromkeys(m for label in own for m in groups[stands_for.get(label, label)]))
            units = {found[m].parameter.unit for m in joined}
            if len(units) > 1:
                stated = ", ".join(f"{m} [{found[m].parameter.unit}]" for m in joined)
                raise InputError(f"{'='.join(names)}: their units differ: {stated}; only like parameters may be tied")
            for m in joined:
                groups.pop(stands_for.get(m, m), None)
            called = names[0] if len(names) == 1 else joined[0]
            groups[called] = joined
            stands_for |= dict.fromkeys(joined, called)
        unknowns = []
        for label, members in groups.items():
            if label not in stands_for.values():
                unknowns.append(found[label])
                continue
            every = [found[m] for m in members]
            first, records = every[0].parameter, sorted({i for u in every for i in u.records})
            lower, upper = max(u.parameter.lower for u in every), min(u.parameter.upper for u in every)
            limited = replace(first, lower=lower, upper=upper)
            unknowns.append(FitParameter(label, limited, tuple(records), tuple(members)))
        order = {label: i for i, label in enumerate(found)}
        return sorted(unknowns, key=lambda u: order[u.tied[0] if u.tied else u.label]), stands_for

    def _parameter(self, record_fit: RecordFit, name: str) -> Parameter:
        """Definition of an unknown of a record; its value is where the fit starts, and the mean of its prior."""
        for own in record_fit.start.unknowns if record_fit.start else ():
            if own.name == name:
                return own
        parameter = sensor_definition(record_fit.record, name)
        if parameter is None:
            # the fit starts at what the record declares, which is also the mean of the prior
            parameter = replace(record_fit.model.definition(name), value=record_fit.model.value(name))
        if self.options.prior_scale != 1.0:
            parameter = replace(parameter, sigma=self.options.prior_scale * parameter.sigma)
        parameter = self.owners.stated(self.priors, record_fit.record).get(name, parameter)
        if name == CLOCK_SKEW.name:
            span_s = record_fit.skew_span_s
            lower, upper = max(parameter.lower, -span_s), min(parameter.upper, span_s)
            parameter = replace(parameter, lower=lower, upper=upper)
        return replace(self._as_stated(name, parameter, record_fit.record), name=name)

    def _as_stated(self, name: str, parameter: Parameter, record: Record) -> Parameter:
        """A parameter with the normal prior and the bounds that are stated for it.

        raises : InputError where either is beyond the limits of the parameter, or they exclude each other
        """
        label = self.owners.label(name, record)
        prior = self.owners.stated(self.options.normal_priors, record).get(name)
        bounds = self.owners.stated(self.options.bounds or {}, record).get(name)
        limits = f"its limits {parameter.lower:g} to {parameter.upper:g}"
        if prior is not None:
            mean, sigma = prior
            if not sigma > 0.0:
                raise InputError(f"{label}: prior {mean:g} +- {sigma:g}; give a sigma above 0")
            mean = parameter.value if np.isinf(sigma) else mean  # a flat prior has none: the search begins as declared
            if not parameter.lower <= mean <= parameter.upper:
                raise InputError(f"{label}: the mean of its prior, {mean:g}, is outside {limits}")
            parameter = replace(parameter, value=mean, sigma=sigma)
        if bounds is None:
            return parameter
        lower, upper = bounds
        if not lower < upper:
            raise InputError(f"{label}: bounds {lower:g} to {upper:g}; give the lower one first")
        if not parameter.lower <= lower < upper <= parameter.upper:
            raise InputError(f"{label}: bounds {lower:g} to {upper:g} are beyond {limits}")
        if lower <= parameter.value <= upper or np.isinf(parameter.sigma):
            # the value of a flat prior is only where the search begins
            return replace(parameter, value=min(max(parameter.value, lower), upper), lower=lower, upper=upper)
        mean, sigma = parameter.value, parameter.sigma
        raise InputError(
            f"{label}: bounds {lower:g} to {upper:g} exclude the mean of its prior, {mean:g} +- {sigma:g}; give "
            "another prior as well"
        )

    @property
    def fixed(self) -> dict[str, tuple[float, str]]:
        """Values and units of the parameters that are fixed, by the names that they were stated by."""
        units = {}
        for name in self.options.fixed or {}:
            stem, record = name.partition(AT)[0], self.owners.covered(name)[0]
            model = next(p.model for p in self.record_fits if p.record is record)
            units[name] = (sensor_definition(record, stem) or model.definition(stem)).unit
        return {name: (float(value), units[name]) for name, value in (self.options.fixed or {}).items()}

    @property
    def parameters(self) -> list[Parameter]:
        """The unknowns as newton.maximise takes them, by their labels, each in its unit ([-] for a ratio).

        Priors P and means of docs/theory/estimation_statistics.md, equation 13.
        """
        return [replace(u.parameter, name=u.label) for u in self.unknowns]

    # Samples ---------------------------------------------------------------------------------------------------------

    def _choose_samples(self, record_fit: RecordFit, sample_mask: NDArray[np.bool_] | None) -> None:
        record, flown = record_fit.record, record_fit.conditions.time_s
        begin = record_fit.begin_s
        # the set of samples must not change with the skew, or likelihoods could not be compared
        slack = record_fit.skew_span_s
        t = record.time_s
        mask = record.fit_mask() if sample_mask is None else sample_mask
        mask = mask & ((t >= begin + slack) & (t <= flown[-1] - slack) if slack else (t >= begin) & (t <= flown[-1]))
        fitted = record.read_mask & mask
        if not np.any(fitted):
            raise InputError(
                f"{record.name}: no sample of a used sensor lies in the fit segments and within the conditions "
                f"({begin:g} to {flown[-1]:g} s); nothing can be estimated"
            )
        record_fit.sample_s = t[fitted]
        record_fit.channels = fitted_channels(record, record_fit.sample_s, fitted)
        record_fit.sigma_K = {
            c.number: max(c.sensor.noise_sigma_K or 1.0, least_sigma_K(c.sensor)) for c in record_fit.channels
        }
        record_fit.time_s = march_times(
            record_fit.conditions, begin, float(record_fit.sample_s[-1]) + slack, self.options.longest_step_s
        )

    def _divide_steps(self) -> None:
        """Divide the steps of each record where their error asks for it; the division holds while parameters change.

        Records on common times are marched side by side: they keep common times, with the steps that any of them needs.
        """
        for group in lane_groups(self.record_fits):
            found = [record_fit.divided_times(self.options.tolerance_K) for record_fit in group]
            time_s = np.unique(np.concatenate(found))
            for record_fit in group:
                record_fit.time_s = time_s

    def _group(self) -> None:
        self.groups = lane_groups(self.record_fits)
        self._marches: list[LinearMarch | None] = [None] * len(self.groups)
        # a march packs its arrays when it is made: it is stored and set to other parameters
        self._plain_marches: list[LinearMarch | None] = [None] * len(self.record_fits)
        self.last_marches: LastMarches = [(None, [])] * len(self.groups)

    # Likelihood ------------------------------------------------------------------------------------------------------

    def evaluate(self, vector: FloatArray) -> Evaluation:
        """Log likelihood of all samples, its gradient, and Gauss-Newton's information.

            g = sum_i S_i u_i,   M = sum_i S_i I_i S_i'

        vector  : (parameter,) values, each in its unit
        returns : log likelihood [-], (parameter,) g, (parameter, parameter) M; NaN log likelihood where a march failed

        Source: docs/theory/estimation_statistics.md, equation 14.
        """
        m = len(self.unknowns)

        def one(k: int) -> Evaluation:
            total = sum(record_fit.known_log_likelihood for record_fit in self.groups[k])
            gradient, information = np.zeros(m), np.zeros((m, m))
            for record_fit, samples in self._samples_of_group(k, vector):
                scored = scored_readings(record_fit, [s.mean_K for s in samples])
                sensitivity = np.concatenate([s.sensitivity for s in samples])
                total += scored.log_likelihood
                record_fit.add(gradient, scored.score @ sensitivity)
                record_fit.add(information, scored.information(sensitivity))
            return Evaluation(total, gradient, information)

        try:
            found = in_threads(one, len(self.groups))
        # a search goes on from a vector that cannot be marched: it takes a shorter step
        except RunError:
            return self.failed_evaluation()
        return Evaluation(
            sum(f.log_likelihood for f in found),
            np.sum([f.gradient for f in found], axis=0),
            np.sum([f.information for f in found], axis=0),
        )

    def failed_evaluation(self) -> Evaluation:
        """Evaluation where a march failed: log likelihood NaN [-], gradient and information 0.

        A search treats it as a point outside the domain (newton.maximise; docs/theory/estimation_statistics.md, section
        "The most probable parameters").
        """
        m = len(self.unknowns)
        return Evaluation(np.nan, np.zeros(m), np.zeros((m, m)))

    def samples(self, vector: FloatArray) -> list[PredictedSamples]:
        """All channels at a parameter vector: predicted indications [K] and their sensitivities.

        vector : (parameter,)
        raises : RunError where a march failed

        Source: docs/theory/estimation_statistics.md, equations 1 and 2.
        """

        found = in_threads(lambda k: self._samples_of_group(k, vector), len(self.groups))
        return [s for group in found for _, samples in group for s in samples]

    def innovations(self, vector: FloatArray) -> list[PredictedSamples]:
        """All channels at a parameter vector, each reading predicted from those before it where the model has an error.

        vector : (parameter,);  returns predicted indications [K] with their standard deviation; without an error of
                 the model those of `samples`
        raises : RunError where a march failed

        Source: docs/theory/model_error.md, equation 6.
        """
        found = in_threads(lambda k: self._samples_of_group(k, vector), len(self.groups))
        return [s for group in found for record_fit, samples in group for s in innovations(record_fit, samples)[0]]

    def errors(self, vector: FloatArray) -> list[FloatArray]:
        """The most probable error of each record's model at a parameter vector, in standard deviations [-].

        vector  : (parameter,);  returns by record, (unknown,) u, empty without an error
        raises  : RunError where a march failed

        Source: docs/theory/model_error.md, equation 3.
        """
        if all(record_fit.model_error is None for record_fit in self.record_fits):
            return [np.zeros(0)] * len(self.record_fits)
        by_record: dict[int, list[PredictedSamples]] = {}
        for s in self.samples(vector):
            by_record.setdefault(id(s.record_fit), []).append(s)
        return [scored_readings(r, [s.mean_K for s in by_record[id(r)]]).error for r in self.record_fits]

    def _samples_of_group(self, k: int, vector: FloatArray) -> list[tuple[RecordFit, list[PredictedSamples]]]:
        """All channels of each record of a group."""
        return [
            (record_fit, self._samples_of_record(record_fit, record_fit.corrected(found, vector), vector))
            for record_fit, found in zip(self.groups[k], self._march_group(k, vector), strict=True)
        ]

    def _march_group(self, k: int, vector: FloatArray) -> Sequence[Linearised]:
        """A group marched at a parameter vector; the latest result of each group is cached."""
        # likelihood, bounds, pictures and residual tests ask for the same vector in turn
        cached, found = self.last_marches[k]
        if cached != vector.tobytes():
            group, march = self.groups[k], self._marches[k]
            march = self._marches[k] = group_march(group) if march is None else march
            found = march.march(*set_parameters(march, group, [vector] * len(group)))
            self.last_marches[k] = (vector.tobytes(), found)
        return found

    def marched(self, vector: FloatArray) -> list[Linearised]:
        """Linearised march of each record at a parameter vector, without the correction for its mesh.

        vector  : (parameter,)
        returns : by record, temperatures [K] at its sensors, rates [K/s] and sensitivities
        raises  : RunError where a march failed
        """
        found = {
            id(p): f
            for k, group in enumerate(self.groups)
            for p, f in zip(group, self._march_group(k, vector), strict=True)
        }
        return [found[id(record_fit)] for record_fit in self.record_fits]

    def cache_march(self, vector: FloatArray, marched: Mapping[int, Linearised]) -> None:
        """Store results of marches made elsewhere, so that the next evaluation at that vector marches nothing.

        vector  : (parameter,) at which they were made
        marched : index of the record -> its march [K]
        """
        for k, group in enumerate(self.groups):
            self.last_marches[k] = (
                vector.tobytes(),
                [marched[self.record_fits.index(record_fit)] for record_fit in group],
            )

    def has_cached(self, vector: FloatArray) -> bool:
        """Whether an evaluation at a parameter vector (parameter,) needs no march."""
        return all(cached == vector.tobytes() for cached, _ in self.last_marches)

    def _samples_of_record(self, record_fit: RecordFit, found: Sensed, vector: FloatArray) -> list[PredictedSamples]:
        """The channels of a record at a parameter vector."""
        values, samples = record_fit.values(vector), []
        for c in record_fit.channels:
            mean, own = indications(c, found, record_fit.names, values, record_fit.march_columns)
            by_flight, sensitivity = record_fit.by_flight(c, values)
            mean += by_flight
            own[:, len(record_fit.names) - len(record_fit.flight_names) :] = sensitivity
            time = record_fit.sample_s[c.samples]
            samples.append(
                PredictedSamples(record_fit, c, time, mean, own, len(self.unknowns), record_fit.sigma_K[c.number])
            )
        return samples

    def log_likelihoods(self, vectors: FloatArray) -> FloatArray:
        """(candidate,) log likelihoods [-] of several parameter vectors, marched side by side without sensitivities.

        vectors : (candidate, parameter);  returns NaN for a candidate whose march failed

        Source: docs/theory/estimation_statistics.md, equations 3 and 5.
        """
        return np.concatenate(
            [self._lane_log_likelihoods(vectors[k : k + LANES]) for k in range(0, len(vectors), LANES)]
        )

    def _lane_log_likelihoods(self, vectors: FloatArray) -> FloatArray:
        def one(k: int) -> FloatArray:
            record_fit, march = self.record_fits[k], self._plain_march(k)
            # a group of lanes is always full: the last candidate fills it up
            padded = [*vectors, *[vectors[-1]] * (LANES - len(vectors))]
            marched = march.attempt(*set_parameters(march, [record_fit] * LANES, padded))
            return np.array([self._log_likelihood(record_fit, v, m) for v, m in zip(vectors, marched, strict=False)])

        return np.asarray(np.sum(in_threads(one, len(self.record_fits)), axis=0))

    def _plain_march(self, k: int) -> LinearMarch:
        """A march of a record LANES times, without sensitivities."""
        march = self._plain_marches[k]
        if march is None:
            record_fit = self.record_fits[k]
            history = record_fit.history(record_fit.time_s)
            march = self._plain_marches[k] = LinearMarch(
                [record_fit.track(sensitive=False)] * LANES, record_fit.time_s, history
            )
        return march

    @staticmethod
    def _log_likelihood(record_fit: RecordFit, vector: FloatArray, marched: Linearised | None) -> float:
        """Log likelihood of the samples of a record; NaN where its march failed."""
        if marched is None:
            return np.nan
        found, values = record_fit.corrected(marched, vector), record_fit.values(vector)
        means_K = [
            indications(c, found, (), values, 0)[0] + record_fit.by_flight(c, values)[0] for c in record_fit.channels
        ]
        return record_fit.known_log_likelihood + scored_readings(record_fit, means_K).log_likelihood

    # Mesh ------------------------------------------------------------------------------------------------------------

    def correct_meshes(self, vector: FloatArray) -> None:
        """Take the discretisation error of the meshes [K] out of all predictions from now on.

        vector : (parameter,) values at which the error is computed; make it near the values found, as its change with
                 the parameters is neglected

        Many samples determine a parameter better than a mesh that is accurate to a fraction of one sample's noise.
        Source: docs/theory/estimation_statistics.md, equation 31.
        """
        in_threads(lambda k: correct_mesh(self.record_fits[k], vector), len(self.record_fits))

    @property
    def mesh_warnings(self) -> list[str]:
        """Warnings about corrections of a mesh that are large [K] or could not be made."""
        return [record_fit.mesh_warning for record_fit in self.record_fits if record_fit.mesh_warning]

    # Noise -----------------------------------------------------------------------------------------------------------

    def update_noise(self, vector: FloatArray) -> float:
        """Set the noise of sensors that declare none to its most likely value at given parameters.

        vector  : (parameter,)
        returns : largest relative change of a noise [-]; 0 where all sensors declare theirs
        raises  : InputError where the samples of such a sensor do not determine a noise, RunError where a march failed

        The noise [K] is at least record_fit.least_sigma_K; parameters are shared among sensors by their numbers of
        samples.
        Source: docs/theory/estimation_statistics.md, equation 21.
        """
        change, everything = 0.0, self.samples(vector)
        count = sum(len(s.mean_K) for s in everything)
        for s in everything:
            if s.channel.sensor.noise_sigma_K is None:
                least = least_sigma_K(s.channel.sensor)
                # parameters are shared among sensors by their numbers of samples
                fitted = len(self.unknowns) * len(s.mean_K) / count
                sigma = max(estimate_noise(s.channel.intervals, s.mean_K, fitted).sigma_K, least)
                change = max(change, abs(sigma / s.sigma_K - 1.0))
                s.record_fit.sigma_K[s.channel.number] = sigma
        return change


def _mesh(point: PointModel, record: Record, step_s: float) -> Mesh:
    """Mesh of a record's point, chosen on its flight where the stack prescribes no number of nodes."""
    if point.nodes is not None:
        # its error on the flight, which takes two marches, would change nothing
        return choose_meshes([point], step_s)[0][0]
    return meshes_on_flights([point], [conditions_of_record(record)], step_s)[0][0]


def require_estimated(options: FitOptions, owners: Owners, labels: Sequence[str]) -> None:
    """Check that priors, bounds and ties are of parameters that are estimated.

    labels : of these;  raises : InputError naming the first that is not
    """
    tied = [name for tie in options.ties for name in tie]
    for name in (*options.normal_priors, *(options.bounds or {}), *tied):
        if not set(owners.labels([name])) & set(labels):
            hint = suggestion(name, labels, otherwise="; name it among the parameters")
            raise InputError(f"`{name}`: is not estimated{hint}")


def without_action(names: Sequence[str], record: Record, model: PointModel) -> dict[str, str]:
    """Parameters of effects that nothing computed for a record depends on, with what to name or declare instead.

    names : dotted names, of which those like `effect.NAME.PARAMETER` count;  model : of the record with these effects

    An effect on readings has no part in the march: its parameters are those of the record, `clock.skew` for instance.
    Recombination acts on the atoms of a flow that the record declares.
    """
    found, recombines = {}, flow_of_record(record, model.effects).atoms != "none"
    for name in names:
        used = next((u for u in model.effects if name.startswith(f"{EFFECT_PREFIX}{u.effect.name}.")), None)
        if used is None:
            continue
        parameter = next((p for p in used.effect.parameters if name.endswith(f".{p.name}")), None)
        if used.effect.acts_on_readings and isinstance(parameter, ModelParameter):
            found[name] = f"`{name}`: acts on the readings of a record, not on its wall; name `{parameter.stands_for}`"
        elif used.effect.name == RECOMBINATION and not recombines:
            found[name] = (
                f"`{name}`: nothing recombines in {record.name}; declare the flow and its wall in [heating.catalysis], "
                "or name the parameters of effect `catalysis`"
            )
    return found


def implied_effects(names: Sequence[str], given: Sequence[EffectUse] = ()) -> list[EffectUse]:
    """The effects that dotted parameter names imply and that are not given, at their nominal values.

    names : of which those like `effect.NAME.PARAMETER` count;  given : effects already in the model
    """
    present = {u.effect.name for u in given}
    wanted = dict.fromkeys(n.split(".")[1] for n in names if n.startswith(EFFECT_PREFIX) and n.count(".") >= 2)
    return [use(name) for name in wanted if name not in present]


def joint_reference(records: Sequence[Record], given: Mapping[str, float] | None = None) -> tuple[float, ...]:
    """The reference condition of a fit: as given, else as the first record declares it, else means over fit segments.

    records : all of the fit
    given   : variable -> value, for some of the variables
    returns : alpha, beta [deg], log10 Re [-], elevon, bodyflap [deg]

    Subscript 0 of the founding paper's linear model, docs/theory/equations.md, section 2.
    """
    declared = records[0].declared.reference_condition
    fitted = [(r, r.fit_mask(r.conditions.time_s)) for r in records]
    values = []
    for variable in RATIO_VARIABLES:
        own = None if declared is None else getattr(declared, variable)
        rows = np.concatenate([r.conditions[variable][mask] for r, mask in fitted])
        times = np.concatenate([r.conditions.duration_s[mask] for r, mask in fitted])
        first = records[0].conditions
        mean = np.average(rows, weights=times) if len(rows) else np.average(first[variable], weights=first.duration_s)
        values.append(float((given or {}).get(variable, mean if own is None else own)))
    return tuple(values)
