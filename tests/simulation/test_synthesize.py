"""A flight as a record: it holds what was declared; an altered truth goes to truth.toml."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim_heating.inputs.record import Record, load_record
from sim_heating.inputs.scenario import Scenario, load_scenario
from sim_heating.march.history import PointHistory
from sim_heating.simulation.predict import predict
from sim_heating.simulation.run import run
from sim_heating.simulation.synthesize import synthesize, write_records
from tests.support.gliding import gliding

approx = pytest.approx
GLIDE = (
    gliding(180.0, "V09T9527", "V07T9975", altitude_m=74000.0)
    + """
[[trajectory.manoeuvre]]
kind = "popu"
at_time_s = 90.0
"""
)
PLUG = "V09T9527"
SURFACE = "V09T9527_K"
STEP_ERROR_K = 0.05
"""Error of the steps of a run and of a prediction, to which the finer steps of the record are exact."""


def scenario(tmp_path: Path, more: str = "", **sensor: Any) -> Scenario:
    """The glide with more tables, all its sensors changed by the keywords."""
    file = tmp_path / "glide.toml"
    file.write_text(GLIDE + more)
    loaded = load_scenario(file)
    points = {
        name: replace(p, sensors=tuple(s.model_copy(update=sensor) for s in p.sensors))
        for name, p in loaded.vehicle.control_points.items()
    }
    return replace(loaded, vehicle=replace(loaded.vehicle, control_points=points))


PLAIN = {"bits": None, "range_K": None, "noise_sigma_K": None}
"""A sensor that reads the temperature itself."""


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Record]:
    return synthesize(scenario(tmp_path_factory.mktemp("plain"), **PLAIN))


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> dict[str, PointHistory]:
    result = run(scenario(tmp_path_factory.mktemp("flown")))
    return {name: p.history for name, p in result.points.items()}


def test_a_perfect_recorder_reads_what_a_run_predicts_within_the_error_of_its_steps(
    plain: dict[str, Record], flown: dict[str, PointHistory]
) -> None:
    for name, record in plain.items():
        np.testing.assert_allclose(record.temperatures_K(), flown[name].sensors_K, rtol=0.0, atol=STEP_ERROR_K)


def test_a_written_record_predicts_the_temperatures_that_it_was_made_of(tmp_path: Path) -> None:
    chosen = scenario(tmp_path, **PLAIN)
    made = synthesize(chosen)
    write_records(chosen, made, tmp_path / "records")
    for name in made:
        prediction = predict(load_record(tmp_path / "records" / name))
        assert np.max(np.abs(prediction.residual_K)) < STEP_ERROR_K


@pytest.mark.thorough
def test_an_altered_truth_is_in_the_readings_and_in_truth_toml_but_not_in_the_record(
    tmp_path: Path, plain: dict[str, Record]
) -> None:
    chosen = scenario(tmp_path, '[truth]\nparameters = { "ratio.scale" = 0.2 }\n', **PLAIN)
    made = synthesize(chosen)
    write_records(chosen, made, tmp_path / "records")
    record = load_record(tmp_path / "records" / PLUG)
    hotter = record.temperatures_K()[0, -1] / plain[PLUG].temperatures_K()[0, -1]
    assert hotter == approx(1.2**0.25, abs=0.01)  # radiation equilibrium: T goes with the fourth root of the ratio
    assert record.declared == plain[PLUG].declared
    np.testing.assert_array_equal(record.ratio_table.ratio, plain[PLUG].ratio_table.ratio)  # type: ignore[union-attr]
    truth = tomllib.loads((tmp_path / "records" / "truth.toml").read_text())
    assert truth["parameters"] == {"ratio.scale": 0.2}


@pytest.mark.thorough
def test_an_undeclared_effect_is_in_truth_toml_only(tmp_path: Path, plain: dict[str, Record]) -> None:
    effect = '[[truth.effect]]\nname = "impingement-onset"\ncontrol_points = ["V07T9975"]\n'
    chosen = scenario(tmp_path, effect, **PLAIN)
    made = synthesize(chosen)
    write_records(chosen, made, tmp_path / "records")
    assert "impingement" not in (tmp_path / "records" / "V07T9975" / "record.toml").read_text()
    assert "impingement-onset" in (tmp_path / "records" / "truth.toml").read_text()
    assert made["V07T9975"].temperatures_K()[0, -1] > plain["V07T9975"].temperatures_K()[0, -1] + 5.0
    np.testing.assert_array_equal(made[PLUG].temperatures_K(), plain[PLUG].temperatures_K())


def test_a_positive_skew_records_what_was_true_earlier(tmp_path: Path, plain: dict[str, Record]) -> None:
    late = synthesize(scenario(tmp_path, "[measurements]\nclock_skew_s = 3.0\n", **PLAIN))[PLUG]
    true = plain[PLUG].thermocouples[SURFACE]
    recorded = late.thermocouples[SURFACE]
    np.testing.assert_allclose(recorded[3:], true[:-3], rtol=0.0, atol=1e-9)  # T(t) = true T(t - 3 s)
    assert np.all(np.isnan(recorded[:3]))  # no temperature exists before the flight


def test_a_skew_between_samples_is_stepped_to_and_not_interpolated(tmp_path: Path) -> None:
    early = synthesize(scenario(tmp_path, "[measurements]\nclock_skew_s = -0.4\n", **PLAIN))[PLUG]
    fine = synthesize(scenario(tmp_path, "[measurements]\nsample_offset_s = 0.4\n", **PLAIN))[PLUG]
    np.testing.assert_allclose(
        early.thermocouples[SURFACE][:-1], fine.thermocouples[SURFACE], rtol=0.0, atol=0.02
    )  # K; the steps between differ


@pytest.mark.thorough
def test_the_same_seed_gives_the_same_record_and_another_seed_another(tmp_path: Path) -> None:
    one, again, other = (
        synthesize(scenario(tmp_path, f"[measurements]\nseed = {seed}\n"))[PLUG].temperatures_K() for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, again)
    assert np.any(one != other)


@pytest.mark.thorough
def test_noise_of_one_point_does_not_depend_on_the_others_of_the_scenario(tmp_path: Path) -> None:
    both = synthesize(scenario(tmp_path))[PLUG]
    alone = synthesize(replace(scenario(tmp_path), names=(PLUG,)))[PLUG]
    np.testing.assert_array_equal(both.temperatures_K(), alone.temperatures_K())


def test_readings_are_multiples_of_the_recorder_s_least_significant_bit(tmp_path: Path) -> None:
    record = synthesize(scenario(tmp_path))[PLUG]
    for sensor, readings in zip(record.sensors, record.temperatures_K(), strict=True):
        codes = (readings - sensor.range_K[0]) / sensor.lsb_K  # type: ignore[index]
        np.testing.assert_allclose(codes, np.rint(codes), atol=1e-6)


def test_a_faulty_sensor_reads_gain_times_temperature_plus_bias(tmp_path: Path, plain: dict[str, Record]) -> None:
    fault = '[[measurements.fault]]\nsensor = "V09T9527"\nbias_K = 5.0\ngain = 1.01\n'
    record = synthesize(scenario(tmp_path, fault, **PLAIN))[PLUG]
    np.testing.assert_allclose(record.temperatures_K()[0], 1.01 * plain[PLUG].temperatures_K()[0] + 5.0)
    np.testing.assert_array_equal(record.temperatures_K()[1:], plain[PLUG].temperatures_K()[1:])


def test_a_telemetry_gap_empties_all_sensors_of_a_record(tmp_path: Path) -> None:
    record = synthesize(scenario(tmp_path, "[measurements]\ngaps_s = [[50.0, 60.0]]\n"))[PLUG]
    inside = (record.time_s >= 50.0) & (record.time_s <= 60.0)
    lost = np.isnan(record.temperatures_K())
    assert np.all(lost[:, inside])
    assert not np.any(lost[:, ~inside])
