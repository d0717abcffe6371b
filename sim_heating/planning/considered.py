"""What an estimate leaves open for another flight: errors behind it that its own standard deviations do not have.

wall     Parameters w that the fit held at their declared values. With the information W of the readings, sensitivities
         J and J_w, and M = J' W J + P with the information P of priors, the estimates with another wall are

             p(w) = p - A w,   A = M^-1 J' W J_w,   cov w = (P_w + J_w' W (J_w - J A))^-1

         so that most of the error of a wall cancels in a prediction.
heating  The size of the heating's error, as the readings say with the wall free within its priors: a wrong wall does
         not count as one.

The values stay those of the estimate. Source: docs/theory/model_error.md, equations 5 and 12.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path, roots_of
from sim_heating.base.parameters import AT
from sim_heating.closure.prior.model_error import stated_error
from sim_heating.closure.revise.evidence import OF_START, fitted_use
from sim_heating.closure.revise.update import as_fitted, stated_record
from sim_heating.credibility.facts.contributors import WALL
from sim_heating.estimation.errors_in_fit import with_stated_errors
from sim_heating.estimation.inference.identifiability import covariance
from sim_heating.estimation.inference.model_error import ErrorSize
from sim_heating.estimation.inference.observability import without_stuck_sensors
from sim_heating.estimation.inference.outliers import without_outliers
from sim_heating.estimation.problem import FitProblem
from sim_heating.estimation.report.estimate_file import Estimate, estimate_path
from sim_heating.estimation.unknowns import FitOptions
from sim_heating.inputs.averaged_record import averaged_record
from sim_heating.inputs.parameter_owners import Owners
from sim_heating.inputs.points import point_of_record
from sim_heating.inputs.record import Record, named_apart, record_digest


@dataclass(frozen=True, eq=False)
class Considered:
    """What an estimate leaves open for another flight.

    names      : labels of the estimated parameters and of those of the wall that were held
    covariance : (name, name) of them, each in its unit
    size       : what the readings say of the size of the heating's error; None where the model of no record has one
    """

    names: tuple[str, ...]
    covariance: FloatArray
    size: ErrorSize | None = None


def fitted_records(
    estimate: Estimate, path: str | os.PathLike[str], root: str | os.PathLike[str] | None = None
) -> list[Record]:
    """The records behind an estimate, as they were fitted.

    path   : of the estimate's file, beside which they may lie
    raises : InputError where one does not exist, or was changed since
    """
    file = estimate_path(path)
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


def _begins_in_flight(estimate: Estimate) -> bool:
    """Whether the march of an estimate began in mid-flight."""
    return estimate.starts is not None or any(n.startswith(OF_START) for n in estimate.parameters)


def _fitted_problem(estimate: Estimate, records: Sequence[Record]) -> tuple[FitProblem, FloatArray]:
    """The problem whose solution an estimate is, and its (parameter,) values, others at those declared."""
    cleaned = [averaged_record(without_outliers(without_stuck_sensors(r)[0])[0])[0] for r in records]
    problem = _problem(estimate, cleaned)
    fitted = {n: p.value for n, p in estimate.parameters.items()}
    values = np.array([fitted.get(u.label, u.parameter.value) for u in problem.unknowns])
    if any(c.sensor.noise_sigma_K is None for r in problem.record_fits for c in r.channels):
        problem.update_noise(values)
    problem.correct_meshes(values)
    return problem, values


def considered(estimate: Estimate, records: Sequence[Record]) -> Considered:
    """What an estimate leaves open for another flight; its own covariance alone where its march began in mid-flight, or
    had process noise.

    records : that were fitted, in the order of the estimate
    raises  : InputError, RunError where the model of the estimate cannot be marched along them
    """
    labels = list(estimate.parameters)
    own = estimate.covariance(labels)
    if _begins_in_flight(estimate) or estimate.innovations is not None:
        return Considered(tuple(labels), own)
    problem, values = _fitted_problem(estimate, records)
    noisy, size = with_stated_errors(problem, values, [stated_error(r.record) for r in problem.record_fits])
    inside = problem if estimate.model_error is None else noisy
    order = [u.label for u in problem.unknowns]
    held = np.flatnonzero([label not in labels for label in order])
    if len(held) == 0:
        return Considered(tuple(labels), own, size)
    at = np.array(list(map(order.index, labels)))
    moved = np.diag(own) > 0.0  # one on its bound does not move
    information = inside.evaluate(values).information + np.diag([p.sigma**-2.0 for p in problem.parameters])
    free = at[moved]
    A = np.zeros((len(labels), len(held)))
    A[moved] = _known(information[np.ix_(free, free)]) @ information[np.ix_(free, held)]
    of_wall = _known(information[np.ix_(held, held)] - information[np.ix_(held, at)] @ A)
    joint = np.block([[own + A @ of_wall @ A.T, -A @ of_wall], [-of_wall @ A.T, of_wall]])
    return Considered((*labels, *(order[k] for k in held)), joint, size)


def _known(information: FloatArray) -> FloatArray:
    """Covariance of parameters; 0 of those that nothing informs."""
    found = covariance(information)
    return np.where(np.isfinite(found), found, 0.0)


def _problem(estimate: Estimate, records: Sequence[Record]) -> FitProblem:
    """The fit of an estimate, with the parameters of the wall that it held as further unknowns."""
    ties: dict[str, list[str]] = {}
    for label, stands in estimate.ties.items():
        ties.setdefault(stands, [stands]).append(label)
    declared = {u.effect.name for r in records for u in r.declared.heating.effects}
    uses = [fitted_use(estimate, n) for n in dict.fromkeys(e.name for e in estimate.effects) if n not in declared]
    options = FitOptions(
        effects=list(filter(None, uses)),
        fixed={n: f.value for n, f in estimate.fixed.items()},
        priors={n: p.prior for n, p in estimate.parameters.items()},
        ties=list(ties.values()),
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
