"""What an estimate leaves open for another flight: errors behind it that its own standard deviations do not have.

A fit with the information W of its readings, sensitivities J and prior information P has M = J' W J + P. Readings that
differ from its model by J_w w + G u move the estimates by

    dp = M^-1 J' W (J_w w + G u)

w  a parameter of the wall that was held at its declared value, w ~ N(0, sigma_w^2). With a wall that is w otherwise
   the parameters are p - M^-1 J' W J_w w, so that most of the error cancels in a prediction.
u  the error of heating and flight of each record (docs/theory/model_error.md, equation 1), u ~ N(0, 1). It adds
   M^-1 J' W G G' W J M^-1 to the covariance. The size of the heating's error is what the readings say (equation 5),
   with the wall free within its priors, so that a wrong wall does not count as one.

A loop that was closed has the error of its model in its fit, and so in the covariance of its estimate.json. Source:
consider covariance analysis, B. D. Tapley, B. E. Schutz and G. H. Born, Statistical Orbit Determination (2004),
chapter 6; docs/theory/model_error.md, equation 12.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path, roots_of
from sim_heating.base.parameters import AT
from sim_heating.closure.prior.changed_flight import shift_conditions
from sim_heating.closure.prior.model_error import SmoothFlightError, flight_error, heating_error_prior
from sim_heating.closure.revise.evidence import OF_START, fitted_use
from sim_heating.closure.revise.update import as_fitted, stated_record
from sim_heating.credibility.facts.contributors import WALL
from sim_heating.estimation.inference.error_likelihood import error_size, model_error
from sim_heating.estimation.inference.identifiability import covariance
from sim_heating.estimation.inference.likelihood import likelihood
from sim_heating.estimation.inference.model_error import ErrorSize, ModelError
from sim_heating.estimation.inference.observability import without_stuck_sensors
from sim_heating.estimation.inference.outliers import without_outliers
from sim_heating.estimation.problem import FitProblem
from sim_heating.estimation.report.estimate_file import NAME, Estimate
from sim_heating.estimation.unknowns import FitOptions
from sim_heating.inputs.averaged_record import averaged_record
from sim_heating.inputs.parameter_owners import Owners
from sim_heating.inputs.points import point_of_record
from sim_heating.inputs.record import Record, named_apart, record_digest

ALPHA = "alpha_bias_deg"


@dataclass(frozen=True, eq=False)
class OtherFlight:
    """Flights that a recorded one may have been, as a prediction has them.

    error : of the recorded flight

    Beside what acts through the heating (`SmoothFlightError`), an angle of attack that is off changes the place in the
    ratio table, and a clock that both are recorded by shifts all conditions.
    """

    error: SmoothFlightError

    @cached_property
    def directions(self) -> list[tuple[str, float]]:
        """(direction,) what differs, and its standard deviation in its unit."""
        clock = [("time_shift_s", self.error.uncertainty.time_shift_s)] if self.error.has_one_clock else []
        return [*self.error.directions, *clock]

    def record(self, f: FloatArray) -> Record:
        """The record along the flight that differs; f : (direction,) by how many standard deviations [-]."""
        of_flight = f[: len(self.error.directions)]
        other = self.error.record(of_flight)
        if ALPHA in self.error.rows:
            bias_deg = float((self.error.rows[ALPHA][0] @ of_flight)[0])
            turned = other.conditions.with_columns(alpha_deg=other.conditions["alpha_deg"] + bias_deg)
            other = replace(other, conditions=turned)
        if self.error.has_one_clock:
            other = shift_conditions(other, float(f[-1]) * self.error.uncertainty.time_shift_s)
        return other


def other_flight(record: Record) -> OtherFlight | None:
    """The flights that a record's may have been; None where its trajectory is exact."""
    error = flight_error(record)
    return None if error is None else OtherFlight(error)


@dataclass(frozen=True, eq=False)
class Considered:
    """What an estimate leaves open for another flight.

    covariance : (parameter, parameter) of the estimates in their order, each in its unit, errors of the model included
    moves      : parameter of the wall that was held, with its owner where several points were fitted -> (parameter,)
                 by how much the estimates are otherwise where it is larger by 1
    size       : what the readings say of the size of the heating's error; None where the model of no record has one
    """

    covariance: FloatArray
    moves: Mapping[str, FloatArray] = field(default_factory=dict)
    size: ErrorSize | None = None


def fitted_records(estimate: Estimate, path: str | os.PathLike[str], root: str | os.PathLike[str] | None = None) -> list[Record]:
    """The records behind an estimate, as they were fitted.

    path   : of the estimate's file, beside which they may lie
    raises : InputError where one does not exist, or was changed since
    """
    file = Path(path)
    file = file / NAME if file.is_dir() else file
    for name in estimate.records:
        if not any((folder / name).is_dir() for folder in (Path(), file.parent)):
            raise InputError(
                f"{display_path(file)}: its record `{name}` does not exist, and a band needs it; run the command from "
                "the folder that the estimate was made in"
            )
    roots = roots_of(file, root)
    records = named_apart([stated_record(estimate, i, roots, root) for i in range(len(estimate.records))])
    for name, record in zip(estimate.records, records, strict=True):
        if estimate.inputs.get(name, record_digest(record)) != record_digest(record):
            raise InputError(f"{name}: was changed since the estimate; estimate it again")
    if estimate.segments is not None:
        records = [as_fitted(r, s) for r, s in zip(records, estimate.segments, strict=True)]
    return records


def considered(estimate: Estimate, records: Sequence[Record]) -> Considered:
    """What an estimate leaves open for another flight; its own covariance alone where its march began in mid-flight or
    had process noise.

    records : that were fitted, in the order of the estimate
    raises  : InputError, RunError where the model of the estimate cannot be marched along them
    """
    labels = list(estimate.parameters)
    own = estimate.covariance(labels)
    if estimate.innovations is not None or estimate.starts is not None or any(n.startswith(OF_START) for n in labels):
        return Considered(own)
    problem = _problem(estimate, [averaged_record(without_outliers(without_stuck_sensors(r)[0])[0])[0] for r in records])
    every = [u.label for u in problem.unknowns]
    values = np.array([estimate.parameters[n].value if n in labels else u.parameter.value for n, u in zip(every, problem.unknowns, strict=True)])
    if any(c.sensor.noise_sigma_K is None for r in problem.record_fits for c in r.channels):
        problem.update_noise(values)
    problem.correct_meshes(values)
    at = np.array([every.index(n) for n in labels])
    # one on its bound does not move
    free = at[np.diag(own) > 0.0]
    held = [k for k, n in enumerate(every) if n not in labels]
    prior = np.array([p.sigma**-2.0 for p in problem.parameters])
    errors, size = _errors(problem, values, prior)
    inside = problem.with_model_errors(errors) if estimate.finding is not None else problem
    information = inside.evaluate(values).information + np.diag(prior)
    inverse = covariance(information[np.ix_(free, free)])
    inverse = np.where(np.isfinite(inverse), inverse, 0.0)
    moves = dict[str, FloatArray]()
    for k in held:
        moved = np.zeros(len(labels))
        moved[np.isin(at, free)] = -inverse @ information[free, k]
        moves[every[k]] = moved
    if estimate.finding is not None or all(e is None for e in errors):
        return Considered(own, moves, size)
    noisy = problem.with_model_errors(errors)
    moved = inverse @ _by_errors(noisy, values, free, size)
    spread = inverse + moved @ moved.T
    whole = np.zeros_like(own)
    whole[np.ix_(np.isin(at, free), np.isin(at, free))] = spread
    return Considered(whole, moves, size)


def _problem(estimate: Estimate, records: Sequence[Record]) -> FitProblem:
    """The fit of an estimate, with the parameters of the wall that it held as further unknowns."""
    priors = {
        n: (0.0 if p.prior_mean is None else p.prior_mean, np.inf if p.prior_sigma is None else p.prior_sigma)
        for n, p in estimate.parameters.items()
    }
    ties = [[n, *(label for label, stands in estimate.ties.items() if stands == n)] for n in set(estimate.ties.values())]
    declared = {u.effect.name for r in records for u in r.declared.heating.effects}
    uses = [fitted_use(estimate, n) for n in dict.fromkeys(e.name for e in estimate.effects) if n not in declared]
    options = FitOptions(
        effects=[u for u in uses if u is not None],
        fixed={n: f.value for n, f in estimate.fixed.items()},
        priors=priors,
        ties=ties,
    )
    names, reference = [*estimate.parameters, *estimate.ties], tuple(estimate.reference_condition.values().tolist())
    return FitProblem(records, [*names, *_held(estimate, names, records, options)], reference, options)


def _held(estimate: Estimate, names: Sequence[str], records: Sequence[Record], options: FitOptions) -> list[str]:
    """Labels of the parameters of walls that a fit neither estimated nor fixed."""
    owners, found = Owners(records), dict[str, None]()
    for record in records:
        model, stated = point_of_record(record, effects=options.effects), [*names, *estimate.fixed]
        for name in WALL:
            if not any(model.same_parameter(name, n.partition(AT)[0]) for n in stated):
                stated.append(name)
                found |= dict.fromkeys(n for n in owners.labels([name]) if record in owners.covered(n))
    return list(found)


def _errors(
    problem: FitProblem, values: FloatArray, prior: FloatArray
) -> tuple[list[ModelError | None], ErrorSize | None]:
    """The error of the model of each record, as large as is most likely, and what all of them say of its size.

    values, prior : (parameter,) values and prior information, of the wall as well
    """
    priors = [heating_error_prior(r.record) for r in problem.record_fits]
    errors = [
        None if p is None else model_error(r, values, p.relative, p.middle_s, other_flight(r.record))
        for r, p in zip(problem.record_fits, priors, strict=True)
    ]
    sized = next((p for p in priors if p is not None and p.relative > 0.0), None)
    if sized is None:
        return errors, None
    noisy = problem.with_model_errors(errors)
    samples = noisy.samples(values)
    distance = np.array([p.value for p in noisy.parameters]) - values
    found = [
        error_size(
            r, [s for s in samples if s.record_fit is r], (prior[r.index], distance[r.index]),
            np.ones(len(r.index), dtype=bool), sized,
        )
        for r, p in zip(noisy.record_fits, priors, strict=True)
        if p == sized
    ]  # fmt: skip
    size = replace(found[0], log_likelihood=np.sum([f.log_likelihood for f in found], axis=0))
    return [e and (e.of_size(*size.likeliest) if e.sigma > 0.0 else e) for e in errors], size


def _by_errors(noisy: FitProblem, values: FloatArray, free: IntArray, size: ErrorSize | None) -> FloatArray:
    """(parameter, unknown) J' W G: what one standard deviation of each error of the records adds to the score."""
    samples, scores = noisy.samples(values), []
    for record_fit in noisy.record_fits:
        error = record_fit.model_error
        if error is None:
            continue
        S, F = record_fit.error_responses_K
        own = [s for s in samples if s.record_fit is record_fit]
        J = np.concatenate([s.jacobian[:, free] for s in own])
        W = np.concatenate([likelihood(s.channel.intervals, s.mean_K, s.spread_K).information for s in own])
        heating = S @ np.linalg.cholesky(expected_covariance(error.time_s, size)) if size and error.sigma > 0.0 else S[:, :0]
        scores.append(J.T @ (W[:, np.newaxis] * np.column_stack([heating, F])))
    return np.concatenate(scores, axis=1)


def expected_covariance(time_s: FloatArray, size: ErrorSize) -> FloatArray:
    """(knot, knot) covariance of the heating's error [-] with its size and correlation time integrated out."""
    apart = np.abs(time_s[:, np.newaxis] - time_s)
    squares = size.posterior @ size.sizes**2
    return np.asarray(sum(square * np.exp(-apart / tau) for square, tau in zip(squares, size.times_s, strict=True)))
