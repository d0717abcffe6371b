"""A record that begins hot and declares a cold wall is told, by the reading and its time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_heating.inputs.first_readings import declared_reading_K, other_start
from sim_heating.inputs.record import Record, load_record
from tests.support.paths import PRACTICE


def begun_at(record: Record, time_s: float) -> Record:
    """The record from a time of the flight on, as it is written by a link that came up then."""
    later = record.time_s >= time_s
    flown = record.conditions.at(record.conditions.time_s[record.conditions.time_s >= time_s])
    return replace(record, conditions=flown, thermocouples={n: v[later] for n, v in record.thermocouples.items()})


@pytest.mark.parametrize("name", [f"p{k:02d}" for k in range(1, 11)])
def test_a_flight_from_entry_interface_on_begins_as_declared(name: str) -> None:
    assert other_start(load_record(PRACTICE / name)) is None


def test_a_record_of_the_later_flight_begins_hot() -> None:
    record = begun_at(load_record(PRACTICE / "p06"), 650.0)
    found = other_start(record)
    assert found is not None
    assert found.is_hot
    assert found.time_s == pytest.approx(650.0, abs=1.0)
    assert found.reading_K > 800.0
    assert found.declared_K == pytest.approx(record.declared.stack.initial_K)
    assert "--start lost:700" in found.in_words


def test_a_declared_profile_is_compared_where_the_sensor_is() -> None:
    record = begun_at(load_record(PRACTICE / "p06"), 650.0)
    read = {s.depth_m: record.thermocouples[s.column] for s in record.used_sensors}
    rows = sorted([x, float(T[np.isfinite(T)][0])] for x, T in read.items())
    stack = record.declared.stack.model_copy(update={"initial": "profile", "initial_profile": rows})
    declared = replace(record, declared=record.declared.model_copy(update={"stack": stack}))
    assert other_start(declared) is None
    assert declared_reading_K(declared, record.used_sensors[0]) == pytest.approx(rows[0][1])
