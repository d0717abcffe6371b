"""What is declared is judged by how far it is from its scatter, by one rule for effects and for changes of a record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_heating.base.parameters import CLOCK_SKEW
from sim_heating.closure.prior.changed_flight import shift_conditions
from sim_heating.closure.search.admissibility import far_from_declared, objections
from sim_heating.closure.search.changes.flight_changes import time_shift
from sim_heating.closure.search.changes.record_change import fit_changes
from sim_heating.closure.search.hypothesis import change_hypothesis, conclude, hypothesis, scored
from sim_heating.closure.search.ranking import scatter_price
from sim_heating.closure.search.trials.candidates import Candidate
from sim_heating.closure.search.trials.trial_fit import QUICK, TrialFit, base_trial, problem_with, start_values
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.side_by_side import maximise_together
from sim_heating.heating.effects import use
from sim_heating.inputs.points import point_of_record
from sim_heating.inputs.record import Record
from tests.support.missing import record_with
from tests.support.walls import practice_record

FACTOR = "effect.conductivity.conductivity_factor"


def conductivity_fitted(record: Record) -> TrialFit:
    base = base_trial(estimate([record]))
    candidate = Candidate(
        "conductivity", (use("conductivity", {"conductivity_factor": 1.0}),), (FACTOR,), {FACTOR: 1.0}, (FACTOR,),
        (FACTOR,),
    )  # fmt: skip
    problem = problem_with(base, candidate)
    fit = maximise_together([problem], [start_values(problem, {FACTOR: 1.0})], QUICK)[0]
    return TrialFit("conductivity", candidate, problem, None, fit, -1e4)


def with_scatter(record: Record, sigma: float) -> Record:
    """The record whose insulation declares the scatter of its conductivity."""
    name = record.declared.stack.layer[1].material
    material = record.declared.materials[name].model_copy(update={"conductivity_sigma": sigma})
    materials = {**record.declared.materials, name: material}
    return replace(record, declared=record.declared.model_copy(update={"materials": materials}))


def test_a_price_grows_as_a_square_and_beyond_the_scatter_as_a_logarithm():
    assert scatter_price(3.0) == 9.0
    furthest = POLICY.max_scatter_sigmas
    assert scatter_price(furthest + 1e-9) == pytest.approx(furthest**2)
    assert scatter_price(100.0 * furthest) - scatter_price(10.0 * furthest) == pytest.approx(2.0 * np.log(10.0))


def test_an_effect_on_a_layer_has_the_scatter_that_its_material_declares():
    record = with_scatter(practice_record("p06")[0], 0.03)
    uses = [use("conductivity", {"conductivity_factor": 1.0})]
    assert point_of_record(record, None, uses).definition(FACTOR).sigma == 0.03
    declared = replace(uses[0], declared=(replace(uses[0].definitions[0], sigma=0.4), *uses[0].definitions[1:]))
    assert point_of_record(record, None, [declared]).definition(FACTOR).sigma == 0.4


@pytest.mark.thorough
def test_a_layer_far_from_its_scatter_is_named_only_where_it_explains_the_record():
    record, _ = record_with([], 1, stack__rsi__conductivity_factor=1.4)
    explains = conductivity_fitted(with_scatter(record, 0.05))
    assert far_from_declared(explains, explains.candidate)
    assert objections(explains) == ()
    assert hypothesis([explains], {}).admissible
    rippled = {
        s.column: record.thermocouples[s.column] + 30.0 * np.sin(record.time_s / 7.0) for s in record.used_sensors
    }
    resembles = replace(record, thermocouples={**record.thermocouples, **rippled})
    trial = conductivity_fitted(with_scatter(resembles, 0.05))
    assert any("standard deviations off" in line for line in hypothesis([trial], {}).objections)


@pytest.mark.thorough
def test_conditions_that_are_all_late_or_early_are_a_skew_of_the_clock():
    """More than a thermocouple clock may be off in a fit: the conditions are moved instead."""
    record, _ = record_with([], 1)
    moved = shift_conditions(record, -12.0)
    base = base_trial(estimate([moved]))
    fit = fit_changes(base, [time_shift()])[0]
    found = change_hypothesis(fit, 1)
    assert found.kind == "effect"
    assert found.names == found.effects == ("time-skew",)
    parameter, skew_s, sigma_s = fit.estimates["skew_s"]
    assert parameter.unit == CLOCK_SKEW.unit
    assert skew_s == pytest.approx(12.0, abs=max(4.0 * sigma_s, 0.2))
    none = hypothesis([base], {})
    conclusion = conclude(none, scored(none, [found]))
    assert conclusion.finding == "found"
    assert conclusion.alternatives == (("time-skew",),)
