"""Plain marches of a fit whose model has an error: no smooth error of the heating, along the flight that is found.

Without an error of the heating the flight takes up what it can: it is free within three standard deviations of each of
its errors, which is as far as anyone would believe. The response to them is a difference of marches about the stated
flight, and is another one there. So it is taken again about the flight found, as long as the march itself gains by
that: Gauss and Newton's iteration over flight and parameters. Source: docs/theory/model_error.md, equation 7.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import RunError
from sim_heating.closure.search.trials.trial_fit import CONVERGE
from sim_heating.estimation.fit import FitResult, predict_fit
from sim_heating.estimation.inference.error_likelihood import flight_response
from sim_heating.estimation.inference.newton import Priors
from sim_heating.estimation.problem import FitProblem
from sim_heating.estimation.side_by_side import maximise_together
from sim_heating.simulation.predict import Prediction


def plain_marches(fitted: FitResult) -> list[Prediction]:
    """The plain march of each record of a fit, whose parameters and flights are fitted once more without an error of
    the heating; as they are where the model has none.
    """
    limit = 3.0  # standard deviations by which each error of a flight may be off [-]
    rounds = 8  # responses that are taken at most
    steps = (1.0, 0.5, 0.25, 0.1, 0.03)  # parts of a step that are tried, the largest first
    settled = 0.5  # gain in log posterior [-] that ends it
    exact = fitted.problem.without_heating_error()
    if exact is fitted.problem:
        return list(fitted.after)
    integrated = fitted.problem.errors(fitted.fit.values)
    parts = zip(exact.record_fits, integrated, strict=True)
    flights = [p.model_error.along_flight(u) for p, u in parts if p.model_error is not None and not p.flight_names]
    exact = exact.with_flight_unknowns(limit)
    limits = np.array([(u.parameter.lower, u.parameter.upper) for u in exact.unknowns]).T
    values = np.clip(np.concatenate([fitted.fit.values, *flights]), *limits)
    reached, problem = _log_posterior(exact, values), exact
    for _ in range(rounds):
        fit = maximise_together([problem], [values], CONVERGE)[0]
        if not np.isfinite(fit.log_likelihood):
            break
        tried = [values + step * (fit.values - values) for step in steps]
        better = next(((v, p) for v in tried if (p := _log_posterior(exact, v)) > reached), None)
        if better is None:
            break
        gained, (values, reached) = better[1] - reached, better
        if gained < settled:
            break
        problem = _about(exact, values)
    return [predict_fit(fit_of_record, values) for fit_of_record in exact.record_fits]


def _about(exact: FitProblem, values: FloatArray, *, alone: bool = False) -> FitProblem:
    """The problem along the flights at a parameter vector, with the responses about them; `alone`, without any."""
    parts = []
    for fit_of_record in exact.record_fits:
        error = fit_of_record.model_error
        if error is None or error.flight is None:
            parts.append(fit_of_record)
            continue
        by_name = fit_of_record.values(values)
        f = np.array([by_name[n] for n in fit_of_record.flight_names])
        moved, F = fit_of_record.along(error.flight.record(f)), np.zeros_like(error.flight_K)
        if not alone:
            response = flight_response(moved, values, error.flight, f)
            F[:, np.searchsorted(error.sample_s, fit_of_record.sample_s)] = response
            moved = replace(moved, correction_K=fit_of_record.correction_K - response @ f)
        parts.append(replace(moved, model_error=replace(error, flight_K=F)))
    return exact.with_record_fits(parts)


def _log_posterior(exact: FitProblem, values: FloatArray) -> float:
    """Log posterior of parameters and flights by the marches along these, but for a constant [-]."""
    try:
        log_likelihood = _about(exact, values, alone=True).evaluate(values).log_likelihood
    except RunError:
        return -np.inf
    return (
        log_likelihood + float(Priors.of(exact.parameters).log_prior(values))
        if np.isfinite(log_likelihood)
        else -np.inf
    )
