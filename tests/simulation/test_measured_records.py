"""Measured histories as flight records: stored ones equal those made again; transition is found in tiles of STS-96."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.cli import main
from sim_heating.estimation.problem import joint_reference
from sim_heating.inputs.record import Record, load_record
from sim_heating.inputs.scenario import Scenario, load_scenario
from sim_heating.simulation.measured_records import compared_records
from tests.support.paths import SCENARIOS
from tests.support.tile_fits import Tile, fitted, laminar, onset_time_s, rise_time_s, starts_at

RECORDS = SCENARIOS / "records"
TILES = ("STS96_468", "STS96_480", "STS96_597", "STS96_730")


@cache
def scenario() -> Scenario:
    return load_scenario(SCENARIOS / "sts96_iss.toml")


@cache
def made() -> dict[str, Record]:
    return compared_records(scenario())


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", TILES)
def test_stored_record_equals_that_made_from_its_scenario(name: str) -> None:
    stored, fresh = load_record(RECORDS / name.lower()), made()[name]
    assert stored.declared == fresh.declared
    for column, values in fresh.conditions.columns.items():
        np.testing.assert_allclose(stored.conditions[column], values, rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(stored.temperatures_K(), fresh.temperatures_K())


def test_clock_of_a_record_is_shifted_and_stretched_against_its_flight() -> None:
    shifted = compared_records(scenario(), shift_s=-7.0, stretch=1.02)["STS96_468"]
    here = made()["STS96_468"]
    np.testing.assert_allclose(shifted.conditions.time_s, -7.0 + 1.02 * here.conditions.time_s)
    np.testing.assert_array_equal(shifted.time_s, here.time_s)
    np.testing.assert_array_equal(shifted.conditions["log10_re"], here.conditions["log10_re"])


@pytest.mark.parametrize("time_s", [None, 40.0])
def test_errors_of_a_record_change_over_the_time_its_history_states(time_s: float | None) -> None:
    history = replace(scenario().compare[0], noise_correlation_s=time_s)
    (record,) = compared_records(replace(scenario(), compare=(history,))).values()
    assert [sensor.noise_correlation_s for sensor in record.used_sensors] == [time_s]


def test_scenario_that_compares_with_nothing_makes_no_record() -> None:
    with pytest.raises(InputError, match="compares with no measured history"):
        compared_records(replace(scenario(), compare=()))


def test_command_without_arguments_names_those_it_needs(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["measured-records"]) == 2
    assert "SCENARIO" in capsys.readouterr().err


# Transition ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "rise_s"), [("STS96_468", 1344.0), ("STS96_480", 1242.0), ("STS96_597", 1340.0)])
def test_rise_is_found_where_the_figure_shows_it(name: str, rise_s: float) -> None:
    assert rise_time_s(made()[name]) == pytest.approx(rise_s, abs=2.75)


def test_time_of_an_onset_is_when_the_flight_passes_its_reynolds_number() -> None:
    flown = made()["STS96_468"].conditions
    at = onset_time_s(flown, 7.0)
    assert np.interp(at, flown.time_s, flown["log10_re"]) == pytest.approx(7.0)


@pytest.mark.thorough
@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["STS96_468", "STS96_480"])
def test_transition_explains_the_rise_of_a_tile(name: str) -> None:
    record = laminar(load_record(RECORDS / name.lower()))
    reference, rise_s = joint_reference([record]), rise_time_s(record)
    after = fitted(record, reference, starts_at(record, rise_s)[:1])
    tile = Tile(record, rise_s, fitted(record, reference), after)
    before, after_K = (tile.errors(m.residual_K[0]) for m in (tile.before, tile.after))
    assert after_K["window"] < 0.4 * before["window"]
    assert after_K["holdout"] < 0.5 * before["holdout"]
    assert abs(tile.onset_s - rise_s) < 10.0
    assert 2.0 < after.values["effect.transition.factor"] < 6.0
