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
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError, RunError, failure_context
from sim_heating.base.files import display_path
from sim_heating.base.kernels.block import LANES
from sim_heating.base.parallel.threads import in_threads
from sim_heating.base.parameters import AT, Parameter
from sim_heating.estimation.fit_marches import FitMarches
from sim_heating.estimation.inference.error_likelihood import innovations, scored_readings
from sim_heating.estimation.inference.model_error import FLIGHT_PREFIX, ModelError
from sim_heating.estimation.inference.newton import Evaluation
from sim_heating.estimation.inference.noise import estimate_noise
from sim_heating.estimation.record_fit import (
    PredictedSamples,
    RecordFit,
    Sensed,
    Start,
    correct_mesh,
    fitted_channels,
    indications,
    lane_groups,
    least_sigma_K,
    march_times,
    parameter_definition,
    sensor_definition,
    set_parameters,
    set_pressure_response,
)
from sim_heating.estimation.unknowns import DEFAULT_OPTIONS, FitOptions, FitParameter, StatedParameters
from sim_heating.inputs.parameter_owners import Owners, is_of_record
from sim_heating.inputs.points import conditions_of_record, flow_of_record, point_of_record
from sim_heating.inputs.record import Record
from sim_heating.march.linearised import Linearised
from sim_heating.march.mesh_choice import choose_meshes, meshes_on_flights
from sim_heating.march.point import PointModel
from sim_heating.thermal.mesh import Mesh


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
        self.stated = StatedParameters(Owners(records), options)
        fixed = list(map(self.stated.fixed, records))
        names_of = [self.owners.of_record(names, r) for r in records]
        models = [self.stated.model(r, n, reference) for r, n in zip(records, names_of, strict=True)]
        # the mesh is chosen once, for the declared model: a likelihood with another mesh at each step would not be
        # smooth, and those of two models could not be compared
        meshes = [_mesh(point_of_record(r), r, options.longest_step_s) for r in records]
        begin = list(options.starts) if options.starts is not None else [None] * len(records)
        self.record_fits = [
            _record_fit(record, model, mesh, start(record, model, mesh) if callable(start) else start, n, f)
            for record, model, mesh, start, n, f in zip(records, models, meshes, begin, names_of, fixed, strict=True)
        ]
        self.unknowns = self.stated.index(self.record_fits)
        for i, record_fit in enumerate(self.record_fits):
            mask = None if options.sample_masks is None else options.sample_masks[i]
            _choose_samples(record_fit, mask, options.longest_step_s)
        _divide_steps(self.record_fits, options.tolerance_K)
        self.marches = FitMarches(self.record_fits)
        start = np.array([p.value for p in self.parameters])
        for record_fit in self.record_fits:
            set_pressure_response(record_fit, start)

    @classmethod
    def joined(cls, parts: Sequence[FitProblem], owners: Sequence[Mapping[str, str]]) -> FitProblem:
        """One problem of several, whose likelihoods add up: some parameters are common to records, the others own.

        parts   : problems of one record each, with the samples, noise, meshes and priors that they have
        owners  : by part, dotted name -> the owner of the parameter, such as a control point; parameters of one name
                  and owner are one, with the prior of the first part that has it. An empty owner is all records; a
                  parameter that is not listed is the record's own
        returns : the problem; labels are `name`, or `name@owner`. Its `reference` is that of the first part alone
        """
        shared: dict[tuple[str, str], tuple[Parameter, list[int]]] = {}
        keys_of = []
        for i, (problem, owner_of) in enumerate(zip(parts, owners, strict=True)):
            record_fit = problem.record_fits[0]
            keys = [
                (u.parameter.name, owner_of.get(u.parameter.name, record_fit.record.name)) for u in problem.unknowns
            ]
            for key, unknown in zip(keys, problem.unknowns, strict=True):
                shared.setdefault(key, (unknown.parameter, []))[1].append(i)
            keys_of.append([keys[k] for k in record_fit.index])
        order = list(shared)
        record_fits = [
            replace(problem.record_fits[0], index=np.array([order.index(key) for key in keys], dtype=np.int64))
            for problem, keys in zip(parts, keys_of, strict=True)
        ]
        unknowns = [
            FitParameter(f"{name}{AT}{owner}" if owner else name, parameter, tuple(numbers))
            for (name, owner), (parameter, numbers) in shared.items()
        ]
        return parts[0].with_record_fits(record_fits, unknowns)

    def with_record_fits(
        self, record_fits: Sequence[RecordFit], unknowns: Sequence[FitParameter] | None = None
    ) -> FitProblem:
        """The problem with other conditions, corrections, errors or unknowns of its records.

        record_fits : of the same samples, corrections and responses in [K];  unknowns : as before where None

        Likelihood: docs/theory/estimation_statistics.md, equations 3 to 14.
        """
        other = copy(self)
        other.record_fits = list(record_fits)
        other.unknowns = self.unknowns if unknowns is None else list(unknowns)
        other.marches = FitMarches(other.record_fits)
        return other

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

    def without_heating_error(self) -> FitProblem:
        """The problem without the smooth errors of the heating; itself where no record has one.

        Errors of flights, and slow noise of sensors, stay: s = 0 in docs/theory/model_error.md, equation 1.
        """
        if all(record_fit.model_error is None for record_fit in self.record_fits):
            return self
        errors = [part.model_error for part in self.record_fits]
        return self.with_model_errors([None if e is None else e.without_heating() for e in errors])

    def with_flight_unknowns(self, limit: float = math.inf) -> FitProblem:
        """The problem with the errors of its flights as unknowns, which several records of one flight may share.

        limit : bound on each of them, those that are unknowns already as well, in standard deviations [-]

        The problem as it is where no flight has any. Each is in standard deviations of its prior [-]: f of
        docs/theory/model_error.md, equation 1.
        """
        of_flight = Parameter("", "1", 0.0, 1.0, -limit, limit, text="error of the flight")
        unknowns = [
            replace(u, parameter=replace(of_flight, name=u.parameter.name))
            if u.parameter.name.startswith(FLIGHT_PREFIX)
            else u
            for u in self.unknowns
        ]
        parts = []
        for i, part in enumerate(self.record_fits):
            names = () if part.model_error is None or part.flight_names else part.model_error.flight_names
            own = f"{AT}{part.record.name}" if len(self.record_fits) > 1 else ""
            index = np.append(part.index, len(unknowns) + np.arange(len(names)))
            unknowns += [FitParameter(f"{n}{own}", replace(of_flight, name=n), (i,)) for n in names]
            parts.append(replace(part, flight_names=names, index=index) if names else part)
        if len(unknowns) == len(self.unknowns) and limit == math.inf:
            return self
        return self.with_record_fits(parts, unknowns)

    # Parameters ------------------------------------------------------------------------------------------------------

    @property
    def owners(self) -> Owners:
        """The owners of the names, with all records of the fit."""
        return self.stated.owners

    @property
    def priors(self) -> dict[str, Parameter]:
        """Priors that were stated as parameters, by name, each in its unit."""
        return self.stated.priors

    @property
    def fixed(self) -> dict[str, tuple[float, str]]:
        """Values and units of the parameters that are fixed, by the names that they were stated by."""
        units = {}
        for name in self.options.fixed or {}:
            stem, record = name.partition(AT)[0], self.owners.covered(name)[0]
            model = next(p.model for p in self.record_fits if p.record is record)
            units[name] = parameter_definition(record, model, stem).unit
        return {name: (float(value), units[name]) for name, value in (self.options.fixed or {}).items()}

    @property
    def parameters(self) -> list[Parameter]:
        """The unknowns as newton.maximise takes them, by their labels, each in its unit ([-] for a ratio).

        Priors P and means of docs/theory/estimation_statistics.md, equation 13.
        """
        return [replace(u.parameter, name=u.label) for u in self.unknowns]

    # Samples ---------------------------------------------------------------------------------------------------------

    # Likelihood ------------------------------------------------------------------------------------------------------

    def evaluate(self, vector: FloatArray) -> Evaluation:
        """Log likelihood of all samples, its gradient, and Gauss-Newton's information.

            g = sum_i S_i u_i,   M = sum_i S_i I_i S_i'

        vector  : (parameter,) values, each in its unit
        returns : log likelihood [-], (parameter,) g, (parameter, parameter) M; NaN log likelihood where a march failed

        Source: docs/theory/estimation_statistics.md, equation 14.
        """
        m = len(self.unknowns)

        def of_group(k: int) -> Evaluation:
            total = sum(record_fit.known_log_likelihood for record_fit in self.marches.groups[k])
            gradient, information = np.zeros(m), np.zeros((m, m))
            for record_fit, samples in self._samples_of_group(k, vector):
                scored = scored_readings(record_fit, [s.mean_K for s in samples])
                sensitivity = np.concatenate([s.sensitivity for s in samples])
                total += scored.log_likelihood
                record_fit.add(gradient, scored.score @ sensitivity)
                record_fit.add(information, scored.information(sensitivity))
            return Evaluation(total, gradient, information)

        try:
            evaluations = in_threads(of_group, len(self.marches.groups))
        # a search goes on from a vector that cannot be marched: it takes a shorter step
        except RunError:
            return self.failed_evaluation()
        return Evaluation(
            sum(f.log_likelihood for f in evaluations),
            np.sum([f.gradient for f in evaluations], axis=0),
            np.sum([f.information for f in evaluations], axis=0),
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

        by_group = in_threads(lambda k: self._samples_of_group(k, vector), len(self.marches.groups))
        return [s for group in by_group for _, samples in group for s in samples]

    def innovations(self, vector: FloatArray) -> list[PredictedSamples]:
        """All channels at a parameter vector, each reading predicted from those before it where the model has an error.

        vector : (parameter,);  returns predicted indications [K] with their standard deviation; without an error of
                 the model those of `samples`
        raises : RunError where a march failed

        Source: docs/theory/model_error.md, equation 6.
        """
        by_group = in_threads(lambda k: self._samples_of_group(k, vector), len(self.marches.groups))
        return [s for group in by_group for record_fit, samples in group for s in innovations(record_fit, samples)[0]]

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
        group = self.marches.groups[k]
        with failure_context(", ".join(display_path(fit.record.directory) for fit in group)):
            marches = self.marches.of_group(k, vector)
        return [
            (record_fit, self._samples_of_record(record_fit, record_fit.corrected(marched, vector), vector))
            for record_fit, marched in zip(group, marches, strict=True)
        ]

    def marched(self, vector: FloatArray) -> list[Linearised]:
        """Linearised march of each record at a parameter vector, without the correction for its mesh.

        vector  : (parameter,)
        returns : by record, temperatures [K] at its sensors, rates [K/s] and sensitivities
        raises  : RunError where a march failed
        """
        return self.marches.of_records(vector)

    def _samples_of_record(self, record_fit: RecordFit, sensed: Sensed, vector: FloatArray) -> list[PredictedSamples]:
        """The channels of a record at a parameter vector."""
        values, samples = record_fit.values(vector), []
        for c in record_fit.channels:
            mean, sensitivity = indications(c, sensed, record_fit.names, values, record_fit.march_columns)
            by_flight, to_flight = record_fit.by_flight(c, values)
            mean += by_flight
            sensitivity[:, len(record_fit.names) - len(record_fit.flight_names) :] = to_flight
            time = record_fit.sample_s[c.samples]
            samples.append(
                PredictedSamples(
                    record_fit, c, time, mean, sensitivity, len(self.unknowns), record_fit.sigma_K[c.number]
                )
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
        def of_record(k: int) -> FloatArray:
            record_fit, march = self.record_fits[k], self.marches.plain(k)
            # a group of lanes is always full: the last candidate fills it up
            padded = [*vectors, *[vectors[-1]] * (LANES - len(vectors))]
            marched = march.attempt(*set_parameters(march, [record_fit] * LANES, padded))
            return np.array([_log_likelihood(record_fit, v, m) for v, m in zip(vectors, marched, strict=False)])

        return np.asarray(np.sum(in_threads(of_record, len(self.record_fits)), axis=0))

    # Mesh ------------------------------------------------------------------------------------------------------------

    def correct_meshes(self, vector: FloatArray) -> None:
        """Take the discretisation error of the meshes [K] out of all predictions from now on, and renew the responses
        to the surface pressure.

        vector : (parameter,) values at which the error is computed; make it near the values found, as its change with
                 the parameters is neglected

        Many samples determine a parameter better than a mesh that is accurate to a fraction of one sample's noise.
        Source: docs/theory/estimation_statistics.md, equation 31.
        """
        in_threads(lambda k: correct_mesh(self.record_fits[k], vector), len(self.record_fits))
        for record_fit in self.record_fits:
            set_pressure_response(record_fit, vector)

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
    fixed_in_record = {n: v for n, v in fixed.items() if is_of_record(n)}
    return RecordFit(record, model, mesh, start, conditions, march_names, sensor_names, fixed=fixed_in_record)


def _choose_samples(record_fit: RecordFit, sample_mask: NDArray[np.bool_] | None, longest_step_s: float) -> None:
    """Give a record its samples, channels, first noise [K] and steps of its march [s].

    raises : InputError where no sample is fitted
    """
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
        record_fit.conditions, begin, float(record_fit.sample_s[-1]) + slack, longest_step_s
    )


def _divide_steps(record_fits: Sequence[RecordFit], tolerance_K: float) -> None:
    """Divide the steps of each record where their error asks for it; the division holds while parameters change.

    Records on common times are marched side by side: they keep common times, with the steps that any of them needs.
    """
    for group in lane_groups(record_fits):
        divided = [record_fit.divided_times(tolerance_K) for record_fit in group]
        time_s = np.unique(np.concatenate(divided))
        for record_fit in group:
            record_fit.time_s = time_s


def _log_likelihood(record_fit: RecordFit, vector: FloatArray, marched: Linearised | None) -> float:
    """Log likelihood of the samples of a record; NaN where its march failed."""
    if marched is None:
        return np.nan
    sensed, values = record_fit.corrected(marched, vector), record_fit.values(vector)
    means_K = [
        indications(c, sensed, (), values, 0)[0] + record_fit.by_flight(c, values)[0] for c in record_fit.channels
    ]
    return record_fit.known_log_likelihood + scored_readings(record_fit, means_K).log_likelihood


def _mesh(point: PointModel, record: Record, step_s: float) -> Mesh:
    """Mesh of a record's point, chosen on its flight where the stack prescribes no number of nodes."""
    if point.nodes is not None:
        # its error on the flight, which takes two marches, would change nothing
        return choose_meshes([point], step_s)[0][0]
    return meshes_on_flights([point], [conditions_of_record(record)], step_s)[0][0]


def joint_reference(records: Sequence[Record], condition: Mapping[str, float] | None = None) -> tuple[float, ...]:
    """The reference condition of a fit: as given, else as the first record declares it, else means over fit segments.

    records   : all of the fit
    condition : variable -> value, for some of the variables
    returns   : alpha, beta [deg], log10 Re [-], elevon, bodyflap [deg]

    Subscript 0 of the founding paper's linear model, docs/theory/equations.md, section 2.
    """
    declared = records[0].declared.reference_condition
    fitted = [(r, r.fit_mask(r.conditions.time_s)) for r in records]
    values = []
    for variable in RATIO_VARIABLES:
        stated = None if declared is None else getattr(declared, variable)
        rows = np.concatenate([r.conditions[variable][mask] for r, mask in fitted])
        times = np.concatenate([r.conditions.duration_s[mask] for r, mask in fitted])
        first = records[0].conditions
        mean = np.average(rows, weights=times) if len(rows) else np.average(first[variable], weights=first.duration_s)
        values.append(float((condition or {}).get(variable, mean if stated is None else stated)))
    return tuple(values)
