"""Faults of a record are distinguished from missing effects, and described in words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sim_heating.closure.clues.residual_heating import residual_heating
from sim_heating.closure.fit_checks import check_fit
from sim_heating.closure.record_checks import (
    CLOCK,
    MATERIAL,
    SENSOR,
    TRAJECTORY,
    DataFault,
    check_record,
    jumping_sensors,
    unresolved,
)
from sim_heating.estimation.fit import estimate
from sim_heating.heating.effects import use
from sim_heating.inputs.record import Record, load_record
from tests.support.missing import record_with
from tests.support.paths import RECORDS
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


def faults_of(record: Record) -> list[DataFault]:
    """Faults that the record shows, or else those that its fit shows."""
    found = check_record(record)
    if found:
        return found
    fitted = estimate([record])
    residual = residual_heating(fitted.problem, fitted.fit.values)
    return check_fit(fitted.problem, fitted.fit.values, residual)


def only_fault(record: Record, kind: str) -> str:
    found = faults_of(record)
    assert [v.kind for v in found] == [kind]
    return found[0].message


def test_a_sound_record_has_no_fault():
    assert faults_of(sound_record()) == []


def test_a_board_under_a_lamp_is_not_taken_for_a_flight_at_another_time():
    assert check_record(load_record(RECORDS / "kaowool_board")) == []


def test_residual_heating_without_one_thermocouple_is_finite_where_the_mesh_was_corrected():
    fitted = estimate([sound_record()])
    for sensor in sound_record().used_sensors:
        residual = residual_heating(fitted.problem, fitted.fit.values, without=[sensor.name])
        assert np.all(np.isfinite(residual.delta_ratio))


@pytest.mark.parametrize(
    "made",
    [
        lambda: record_with([use("transition", {"log10_re_onset": 6.6, "factor": 2.0})], 1),
        lambda: record_with([], 1, stack__rsi__conductivity_factor=1.4),
        lambda: record_with([use("gap-flow", {"gap_fraction": 0.15})], 1),
        lambda: record_with([], 1, skew_s=3.0),
    ],
    ids=["transition", "conductivity", "gap flow", "time skew"],
)
def test_a_missing_effect_is_not_taken_for_a_fault(made: Callable[[], tuple[Record, Any]]):
    record, _ = made()
    assert check_record(record) == []


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milliseconds"), (1.0 / 60.0, "minutes")])
def test_a_clock_in_another_unit_is_reported_whichever_file_has_it(factor, unit):
    record = sound_record()
    message = only_fault(with_readings(time_s=record.time_s * factor), CLOCK)
    assert "thermocouples" in message
    assert unit in message
    message = only_fault(with_conditions(time_s=record.conditions.time_s * factor), CLOCK)
    assert "flight conditions" in message
    assert unit in message


def test_temperatures_of_a_flight_minutes_later_are_reported():
    message = only_fault(with_readings(time_s=sound_record().time_s + 150.0), TRAJECTORY)
    assert "150 s later" in message


@pytest.mark.parametrize("factor", [0.4, 2.0])
def test_a_reference_heating_wrong_by_a_factor_is_reported(factor):
    message = only_fault(with_conditions(h_ref_kg_m2_s=sound_record().conditions["h_ref_kg_m2_s"] * factor), TRAJECTORY)
    assert f"{1.0 / factor:.1f}"[:2] in message
    assert "reference heating" in message


def test_a_sensor_that_sticks_half_way_is_reported():
    record = sound_record()
    t, column = record.time_s, record.sensors[0].column
    read = record.thermocouples[column]
    message = only_fault(with_readings(**{column: np.where(t > 700.0, read[t > 700.0][0], read)}), SENSOR)
    assert f"{record.sensors[0].name}: is stuck" in message
    assert "from 700" in message


def test_a_bondline_that_jumps_faster_than_heat_diffuses_is_reported():
    record = sound_record()
    column = record.sensors[-1].column
    message = only_fault(
        with_readings(**{column: record.thermocouples[column] + 40.0 * (record.time_s > 800.0)}), SENSOR
    )
    assert f"{record.sensors[-1].name}: jumps by +4" in message


def test_a_sensor_that_drifts_is_identified_among_the_others():
    record = sound_record()
    column = record.sensors[-1].column
    message = only_fault(
        with_readings(**{column: record.thermocouples[column] + 0.1 * np.maximum(record.time_s - 500.0, 0.0)}), SENSOR
    )
    assert f"{record.sensors[-1].name}: contradicts" in message
    assert "drifts by +9" in message or "drifts by +10" in message


@pytest.mark.parametrize("factor", [4.0, 1.0 / 3.0])
def test_another_material_is_reported(factor):
    record = sound_record()
    name = record.declared.stack.layer[1].material
    material = record.declared.materials[name].model_dump(exclude_unset=True)
    table = material["conductivity_W_mK"]
    table["k"] = (factor * np.array(table["k"])).tolist()
    other = type(record.declared.materials[name]).model_validate(material)
    materials = {**record.declared.materials, name: other}
    message = only_fault(
        replace(record, declared=record.declared.model_copy(update={"materials": materials})), MATERIAL
    )
    assert f"`{name}`" in message
    assert f"conductivity {1.0 / factor:.2g}" in message


def test_a_steep_steady_rise_is_not_a_jump() -> None:
    assert jumping_sensors(load_record(RECORDS / "practice" / "p04")) == []


def test_a_gap_of_the_telemetry_is_not_a_jump() -> None:
    record = sound_record()
    bondline = record.sensors[-1].column
    lost = (record.time_s > 700.0) & (record.time_s < 850.0)
    read = record.thermocouples[bondline]
    assert np.nanmax(read[lost]) - np.nanmin(read[lost]) > 20.0
    assert jumping_sensors(with_readings(**{bondline: np.where(lost, np.nan, read)})) == []


def test_noise_of_one_recorder_step_is_not_a_jump() -> None:
    """The temperature of the bondline is constant, with noise of about one step of the recorder."""
    record = sound_record()
    bondline, noise = record.sensors[-1], np.random.default_rng(5)
    for _ in range(300):
        T = 270.0 + 0.55 * bondline.lsb_K * noise.standard_normal(len(record.time_s))
        codes = np.rint((T - 255.0) / bondline.lsb_K)
        assert jumping_sensors(with_readings(**{bondline.column: 255.0 + codes * bondline.lsb_K})) == []


def test_a_recorder_at_the_end_of_its_range_is_not_a_broken_sensor() -> None:
    record = sound_record()
    surface = record.sensors[0]
    own = surface.model_copy(update={"range_K": [255.0, 900.0]})
    assert own.range_K is not None
    thermocouples = record.declared.thermocouples.model_copy(update={"sensor": [own, *record.sensors[1:]]})
    declared = record.declared.model_copy(update={"thermocouples": thermocouples})
    read = np.minimum(record.thermocouples[surface.column], 900.0)
    clipped = replace(with_readings(**{surface.column: read}), declared=declared)
    assert np.count_nonzero(read == 900.0) > 100
    assert check_record(clipped) == []


def test_faults_that_the_fit_explains_are_dropped_and_the_others_kept() -> None:
    bondline = sound_record().sensors[-1]
    faults = [DataFault(SENSOR, "jumps", bondline.name), DataFault(TRAJECTORY, "20 s later")]
    assert unresolved(faults, estimate([sound_record()]).after[0]) == []
    jumping = with_readings(
        **{bondline.column: sound_record().thermocouples[bondline.column] + 40.0 * (sound_record().time_s > 800.0)}
    )
    assert unresolved(faults, estimate([jumping]).after[0]) == faults
