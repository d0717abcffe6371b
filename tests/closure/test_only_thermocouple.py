"""A thermocouple that indicates too much, alone on its wall: the course of the heating says so, and nothing beside."""

from __future__ import annotations

from dataclasses import replace

import pytest

from sim_heating.closure.search.search import search_effects
from sim_heating.inputs.record import Record
from tests.support.missing import record_with
from tests.support.walls import practice_record

pytestmark = pytest.mark.thorough


def read_at_the_surface_alone() -> Record:
    """A record of the declared model without the thermocouple at the bond line, its readings not rounded."""
    both = practice_record("p06")[0]
    read = both.declared.thermocouples
    surface = read.sensor[0].model_copy(update={"bits": None, "range_K": None})
    alone = read.model_copy(update={"sensor": [surface]})
    declared = replace(both, declared=both.declared.model_copy(update={"thermocouples": alone}))
    return record_with([], 1, declared=declared)[0]


def test_the_gain_of_the_only_thermocouple_is_found_and_is_no_heat_capacity():
    record = read_at_the_surface_alone()
    (surface,) = record.used_sensors
    gained_K = 1.08 * record.thermocouples[surface.column]
    result = search_effects(replace(record, thermocouples={**record.thermocouples, surface.column: gained_K}))
    assert result.conclusion.finding == "found"
    assert result.conclusion.alternatives == (("sensor-bias",),)
    last = result.hypotheses[0].last
    gain = dict(zip(last.fit.names, last.fit.values, strict=True))[f"sensor.{surface.name}.gain"]
    assert gain == pytest.approx(1.08, abs=0.01)


def test_nothing_is_found_where_the_only_thermocouple_is_sound():
    assert search_effects(read_at_the_surface_alone()).conclusion.finding == "none"
