"""Plain marches along the flight that is found: as near to the readings as the flight itself, and within its limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_heating.closure.plain_marches import plain_marches
from sim_heating.closure.prior.model_error import flight_error
from sim_heating.closure.search.trials.trial_fit import CONVERGE
from sim_heating.estimation.fit import fit_problem, predict_fit
from sim_heating.estimation.inference.error_likelihood import model_error
from sim_heating.estimation.inference.model_error import Correlation
from sim_heating.estimation.problem import FitProblem
from sim_heating.estimation.side_by_side import maximise_together
from sim_heating.inputs.record import FlightUncertainty, load_record
from tests.support.paths import PRACTICE

REFERENCE = (40.0, 0.0, 6.3, 0.0, 0.0)


def stated(along: float):
    """A record without an effect, stated along a flight that is some sigmas longer and in other air than it was."""
    record = load_record(PRACTICE / "p06")
    uncertainty = FlightUncertainty(time_shift_s=10.0, time_stretch=0.01, density_relative=0.1)
    conditions = record.declared.conditions.model_copy(update={"uncertainty": uncertainty})
    record = replace(record, declared=record.declared.model_copy(update={"conditions": conditions}))
    flight = flight_error(record)
    return flight.record(along * np.ones(len(flight.directions)))


def fitted(record):
    plain = FitProblem([record], ["ratio.scale"], REFERENCE)
    error = model_error(plain.record_fits[0], np.zeros(1), 0.05, Correlation(150.0), flight_error(record))
    return fit_problem(plain.with_model_error(error), np.zeros(1))


def rmse_K(prediction) -> float:
    return prediction.segment_errors()["fit"]["rmse_K"]


def test_the_flight_is_found_by_marches_where_its_linear_response_ends():
    fit = fitted(stated(1.0))
    linear = fit.problem.without_heating_error()
    by_response = predict_fit(linear.record_fits[0], fit.fit.values, linear.errors(fit.fit.values)[0])
    noise_K = 1.46  # what this record leaves along its own flight
    assert rmse_K(by_response) > 1.3 * noise_K
    assert rmse_K(plain_marches(fit)[0]) < 1.1 * noise_K


@pytest.mark.thorough
def test_a_flight_is_no_further_off_than_its_limit():
    problem = fitted(stated(6.0)).problem.without_heating_error().with_flight_unknowns(3.0)
    fit = maximise_together([problem], [np.zeros(len(problem.unknowns))], CONVERGE)[0]
    of_flight = np.array([n.startswith("flight.") for n in fit.names])
    assert np.max(np.abs(fit.values[of_flight])) == 3.0
    assert not fit.on_bound[~of_flight].any()
