"""A record that is damaged is told from one that lacks an effect, in words."""

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


def sound() -> Record:
    return practice_record(SOUND)[0]


def reading(**columns: Any) -> Record:
    """The sound record with other readings."""
    record = sound()
    return replace(record, thermocouples={**record.thermocouples, **columns})


def flying(**columns: Any) -> Record:
    """The sound record with other conditions."""
    record = sound()
    return replace(record, conditions=record.conditions.with_columns(**columns))


def told(record: Record) -> list[DataFault]:
    """All verdicts on a record: before a fit, and after one where it comes to that."""
    found = check_record(record)
    if found:
        return found
    fitted = estimate([record])
    residual = residual_heating(fitted.problem, fitted.fit.values)
    return check_fit(fitted.problem, fitted.fit.values, residual)


def only(record: Record, kind: str) -> str:
    found = told(record)
    assert [v.kind for v in found] == [kind]
    return found[0].words


def test_a_sound_record_has_no_verdict():
    assert told(sound()) == []


def test_a_board_under_a_lamp_is_no_flight_at_another_time():
    assert check_record(load_record(RECORDS / "kaowool_board")) == []


def test_the_heating_without_any_one_thermocouple_is_told_where_the_mesh_was_corrected():
    fitted = estimate([sound()])
    for sensor in sound().used_sensors:
        left = residual_heating(fitted.problem, fitted.fit.values, without=sensor.name)
        assert np.all(np.isfinite(left.delta_ratio))


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
def test_an_effect_is_no_damage(made: Callable[[], tuple[Record, Any]]):
    record, _ = made()
    assert check_record(record) == []


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milliseconds"), (1.0 / 60.0, "minutes")])
def test_a_clock_in_another_unit_is_told_whichever_file_has_it(factor, unit):
    record = sound()
    words = only(reading(time_s=record.time_s * factor), CLOCK)
    assert "thermocouples" in words
    assert unit in words
    words = only(flying(time_s=record.conditions.time_s * factor), CLOCK)
    assert "flight conditions" in words
    assert unit in words


def test_temperatures_of_a_flight_minutes_later_are_told():
    words = only(reading(time_s=sound().time_s + 150.0), TRAJECTORY)
    assert "150 s later" in words


@pytest.mark.parametrize("factor", [0.4, 2.0])
def test_a_reference_heating_off_by_a_factor_is_told(factor):
    words = only(flying(h_ref_kg_m2_s=sound().conditions["h_ref_kg_m2_s"] * factor), TRAJECTORY)
    assert f"{1.0 / factor:.1f}"[:2] in words
    assert "reference heating" in words


def test_a_sensor_that_sticks_half_way_is_told():
    record = sound()
    t, column = record.time_s, record.sensors[0].column
    read = record.thermocouples[column]
    words = only(reading(**{column: np.where(t > 700.0, read[t > 700.0][0], read)}), SENSOR)
    assert f"{record.sensors[0].name}: stands still" in words
    assert "from 700" in words


def test_a_bondline_that_jumps_faster_than_heat_diffuses_is_told():
    record = sound()
    column = record.sensors[-1].column
    words = only(reading(**{column: record.thermocouples[column] + 40.0 * (record.time_s > 800.0)}), SENSOR)
    assert f"{record.sensors[-1].name}: jumps by +4" in words


def test_a_sensor_that_drifts_is_told_from_the_others():
    record = sound()
    column = record.sensors[-1].column
    words = only(
        reading(**{column: record.thermocouples[column] + 0.1 * np.maximum(record.time_s - 500.0, 0.0)}), SENSOR
    )
    assert f"{record.sensors[-1].name}: contradicts" in words
    assert "drifts by +9" in words or "drifts by +10" in words


@pytest.mark.parametrize("factor", [4.0, 1.0 / 3.0])
def test_another_material_is_told(factor):
    record = sound()
    name = record.declared.stack.layer[1].material
    material = record.declared.materials[name].model_dump(exclude_unset=True)
    table = material["conductivity_W_mK"]
    table["k"] = (factor * np.array(table["k"])).tolist()
    other = type(record.declared.materials[name]).model_validate(material)
    materials = {**record.declared.materials, name: other}
    words = only(replace(record, declared=record.declared.model_copy(update={"materials": materials})), MATERIAL)
    assert f"`{name}`" in words
    assert f"conductivity {1.0 / factor:.2g}" in words


def test_a_steep_steady_rise_is_no_jump() -> None:
    assert jumping_sensors(load_record(RECORDS / "practice" / "p04")) == []


def test_telemetry_that_is_lost_for_a_while_is_no_jump() -> None:
    record = sound()
    bondline = record.sensors[-1].column
    lost = (record.time_s > 700.0) & (record.time_s < 850.0)
    read = record.thermocouples[bondline]
    assert np.nanmax(read[lost]) - np.nanmin(read[lost]) > 20.0
    assert jumping_sensors(reading(**{bondline: np.where(lost, np.nan, read)})) == []


def test_a_word_that_flickers_is_no_jump() -> None:
    """A bondline that stays where it is, its noise about a step of its recorder."""
    record = sound()
    bondline, noise = record.sensors[-1], np.random.default_rng(5)
    for _ in range(300):
        T = 270.0 + 0.55 * bondline.lsb_K * noise.standard_normal(len(record.time_s))
        codes = np.rint((T - 255.0) / bondline.lsb_K)
        assert jumping_sensors(reading(**{bondline.column: 255.0 + codes * bondline.lsb_K})) == []


def test_a_recorder_at_the_end_of_its_range_is_no_broken_sensor() -> None:
    record = sound()
    surface = record.sensors[0]
    own = surface.model_copy(update={"range_K": [255.0, 900.0]})
    assert own.range_K is not None
    thermocouples = record.declared.thermocouples.model_copy(update={"sensor": [own, *record.sensors[1:]]})
    declared = record.declared.model_copy(update={"thermocouples": thermocouples})
    read = np.minimum(record.thermocouples[surface.column], 900.0)
    clipped = replace(reading(**{surface.column: read}), declared=declared)
    assert np.count_nonzero(read == 900.0) > 100
    assert check_record(clipped) == []


def test_what_a_fit_explains_was_no_damage_and_what_it_does_not_was() -> None:
    bondline = sound().sensors[-1]
    doubts = [DataFault(SENSOR, "jumps", bondline.name), DataFault(TRAJECTORY, "20 s later")]
    assert unresolved(doubts, estimate([sound()]).after[0]) == []
    jumping = reading(**{bondline.column: sound().thermocouples[bondline.column] + 40.0 * (sound().time_s > 800.0)})
    assert unresolved(doubts, estimate([jumping]).after[0]) == doubts
