"""Forms of transition in the search: an onset in Re_theta / M_e where the point has an edge, hysteresis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_heating.closure.search.trials.candidates import candidates
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.heating.effects import use
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import Record
from sim_heating.simulation.predict import predict
from tests.support.transition_glide import made

TURBULENT = {"log10_re_onset": 2.45, "factor": 3.0, "width": 0.02, "by_re_theta": 1.0}


@pytest.fixture(scope="module")
def declared(tmp_path_factory: pytest.TempPathFactory) -> Record:
    """A glide whose record declares a transition in Re_theta / M_e."""
    return made(tmp_path_factory.mktemp("glide"))


def undeclared(record: Record) -> Record:
    heating = record.declared.heating.model_copy(update={"transition": None})
    return replace(record, declared=record.declared.model_copy(update={"heating": heating}))


@pytest.mark.thorough
def test_an_undeclared_transition_by_re_theta_over_edge_mach_number_heats_as_a_declared_one(declared: Record) -> None:
    runs = [
        predict(r, point_of_record(r, None, [use("transition", TURBULENT)])) for r in (declared, undeclared(declared))
    ]
    laminar = predict(undeclared(declared))
    assert np.nanmax(np.abs(runs[0].indicated_K - laminar.indicated_K)) > 20.0
    np.testing.assert_array_equal(runs[1].indicated_K, runs[0].indicated_K)


@pytest.mark.thorough
def test_an_onset_in_re_theta_over_edge_mach_number_is_searched_for_where_the_point_has_an_edge(
    declared: Record,
) -> None:
    record = undeclared(declared)
    flown = conditions_of_record(record)
    by_re_theta = [c for c in candidates(record, flown) if ("effect.transition.by_re_theta", 1.0) in c.form.fixed]
    onsets = [c.start["effect.transition.log10_re_onset"] for c in by_re_theta]
    assert len(onsets) == 7
    assert 2.0 < min(onsets) < max(onsets) < 3.5
    # The fit of such a candidate marches it: its predictions depend on the onset.
    middle = by_re_theta[3]
    problem = FitProblem([record], middle.names, joint_reference([record]), FitOptions(effects=middle.uses))
    at = np.array([middle.start[p.name] if not p.name.endswith("factor") else 3.0 for p in problem.parameters])
    assert all(np.any(column != 0.0) for column in problem.samples(at)[0].sensitivity.T)


def test_a_point_without_an_edge_has_no_such_onset(declared: Record) -> None:
    record = undeclared(declared)
    heating = record.declared.heating.model_copy(update={"recovery": None, "local_angle_deg": None})
    total = replace(record, declared=record.declared.model_copy(update={"heating": heating}))
    flown = conditions_of_record(record)
    assert not any(("effect.transition.by_re_theta", 1.0) in c.form.fixed for c in candidates(total, flown))
