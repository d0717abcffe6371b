"""Faults of a record that no hypothesis of the search is, described in words."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sim_heating.closure.clues.record_checks import clock_fault, magnitude_fault
from sim_heating.closure.clues.residual_heating import residual_heating
from sim_heating.estimation.fit import estimate
from sim_heating.inputs.record import Record
from tests.support.walls import practice_record

SOUND = "p07"


def sound_record() -> Record:
    return practice_record(SOUND)[0]


def with_readings(**columns: Any) -> Record:
    """The sound record with other readings."""
    record = sound_record()
    return replace(record, thermocouples={**record.thermocouples, **columns})


def with_conditions(**columns: Any) -> Record:
    """The sound record with other conditions."""
    record = sound_record()
    return replace(record, conditions=record.conditions.with_columns(**columns))


def fault_of_magnitude(record: Record) -> str:
    fitted = estimate([record])
    found = magnitude_fault(fitted.problem, fitted.fit.values)
    return "" if found is None else found.message


def test_a_sound_record_has_no_fault():
    assert clock_fault(sound_record()) is None
    assert fault_of_magnitude(sound_record()) == ""


@pytest.mark.thorough
def test_residual_heating_without_one_thermocouple_is_finite_where_the_mesh_was_corrected():
    fitted = estimate([sound_record()])
    for sensor in sound_record().used_sensors:
        residual = residual_heating(fitted.problem, fitted.fit.values, omitted=[sensor.name])
        assert np.all(np.isfinite(residual.delta_ratio))


@pytest.mark.sample(1)
@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milliseconds"), (1.0 / 60.0, "minutes")])
def test_a_clock_in_another_unit_is_reported_whichever_file_has_it(factor, unit):
    record = sound_record()
    for wrong, whose in (
        (with_readings(time_s=record.time_s * factor), "thermocouples"),
        (with_conditions(time_s=record.conditions.time_s * factor), "flight conditions"),
    ):
        found = clock_fault(wrong)
        assert found is not None
        assert whose in found.message
        assert unit in found.message


@pytest.mark.sample(1)
@pytest.mark.parametrize("factor", [0.4, 2.0])
def test_a_reference_heating_wrong_by_a_factor_is_reported(factor):
    message = fault_of_magnitude(with_conditions(h_ref_kg_m2_s=sound_record().conditions["h_ref_kg_m2_s"] * factor))
    assert f"{1.0 / factor:.1f}"[:2] in message
    assert "reference heating" in message
