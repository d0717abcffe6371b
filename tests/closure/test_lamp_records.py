"""Records without reference heating, as under a lamp, and what the declared model is fitted with."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from sim_heating.base.errors import InputError
from sim_heating.cli import cli
from sim_heating.closure.close import JointClosedLoop, close_loop, close_loops, write_joint_loop
from sim_heating.closure.clues.correlation import residual_evidence
from sim_heating.closure.clues.residual_heating import residual_heating
from sim_heating.closure.search.trials.trial_fit import declared_fit
from sim_heating.estimation.inference.observability import default_names
from sim_heating.inputs.record import Record, load_record, write_record
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.simulation.ground_step import step_record
from tests.support.paths import PRACTICE
from tests.support.plates import FLUX_W_M2 as FLUX_OF_PLATE
from tests.support.plates import PLATE, plate_K, write_logger_file

CONDUCTIVITY = "stack.rsi.conductivity_factor"
FLUX_W_M2 = 50e3


def lit(flux_W_m2: float = FLUX_W_M2, **parameters: float) -> Record:
    """A plug under a lamp, with a truth that differs from its declaration."""
    vehicle = load_vehicle("orbiter")
    return step_record(vehicle, vehicle.control_point("V09T9527"), flux_W_m2, **parameters)


@pytest.mark.thorough
def test_a_wrong_conductivity_is_found_under_a_lamp(tmp_path: Path) -> None:
    write_record(lit(parameters={CONDUCTIVITY: 0.95}), tmp_path / "lit")
    result = CliRunner().invoke(cli, ["close-loop", str(tmp_path / "lit"), "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    found = json.loads((tmp_path / "out" / "closure.json").read_text())
    assert found["finding"] == "found"
    assert found["effect"]["name"] == "conductivity"
    factor = found["effect"]["parameters"]["conductivity_factor"]
    assert factor["value"] == pytest.approx(0.95, abs=4.0 * factor["sigma"])
    assert found["adequacy"]["p_value"] > 0.01
    assert not [name for name in found["estimated"] if name.startswith("ratio.")]
    assert (tmp_path / "out" / "residual_heating.csv").read_text().startswith("time_s,delta_q_W_m2,sigma_W_m2")


def brighter(factor: float) -> Record:
    """Readings under a lamp whose true flux is a factor times that of the conditions."""
    record = lit(factor * FLUX_W_M2)
    stated = record.conditions.with_columns(q_add_W_m2=record.conditions["q_add_W_m2"] / factor)
    return replace(record, conditions=stated)


def plate(folder: Path, end_s: float, noise_K: float, seed: int, **truth: float) -> Path:
    """The record of a heated plate, made from the file of a logger."""
    time_s = np.arange(0.0, end_s + 1.0, 5.0)
    noise = np.random.default_rng(seed).normal(0.0, noise_K, len(time_s))
    write_logger_file(folder / f"{seed}.csv", time_s, plate_K(time_s, **truth) + noise)
    arguments = ["new", "record", "--csv", str(folder / f"{seed}.csv"), *PLATE, "--out", str(folder / f"plate_{seed}")]
    result = CliRunner().invoke(cli, arguments)
    assert result.exit_code == 0, result.exception
    return folder / f"plate_{seed}"


@pytest.mark.thorough
def test_a_lamp_that_is_brighter_than_stated_is_found_as_that() -> None:
    """The commonest fault of such a test is no error of the wall, whose own factors do not explain the readings."""
    stated = close_loop(brighter(1.08)).report.statement
    assert stated.finding == "found"
    (cause,) = stated.not_effects
    assert cause.kind == "flight"
    assert cause.what == "flux of the lamp (or absorptance of the surface) 8 % above the stated one"
    factor = cause.parameters["factor"]
    assert factor.value == pytest.approx(1.08, abs=4.0 * factor.sigma)


@pytest.mark.thorough
def test_under_the_lamp_that_is_stated_nothing_is_found() -> None:
    assert close_loop(brighter(1.0)).effects == ("none",)


@pytest.fixture(scope="module")
def cooled_plates(tmp_path_factory: pytest.TempPathFactory) -> JointClosedLoop:
    """The closed loops of two plates under lamps of 8 % more flux, alone and jointly."""
    folder = tmp_path_factory.mktemp("plates")
    return close_loops([plate(folder, 300.0, 0.3, seed, flux_W_m2=1.08 * FLUX_OF_PLATE) for seed in (3, 4)])


@pytest.mark.thorough
def test_a_plate_that_cools_tells_its_lamp_and_one_that_is_only_heated_has_a_set(
    cooled_plates: JointClosedLoop, tmp_path: Path
) -> None:
    """While it is heated alone, less heat capacity does the same as more flux; each has its value."""
    cooled = cooled_plates.loops[0].report.statement
    assert (cooled.finding, cooled.not_effects[0].kind) == ("found", "flight")
    heated = close_loop(plate(tmp_path, 130.0, 1.0, 4, flux_W_m2=1.08 * FLUX_OF_PLATE)).report.statement
    assert heated.finding == "one of"
    (names,) = heated.alternatives
    assert "heat-capacity" in names
    (flux,) = (name for name in names if name.startswith("flux of the lamp"))
    own = heated.alternative_values[flux]["factor"]
    assert own.value == pytest.approx(1.08, abs=4.0 * own.sigma)
    assert set(heated.alternative_values) == set(names)
    assert flux in heated.in_words()


@pytest.mark.thorough
def test_a_joint_set_has_the_values_of_all_its_members_and_tells_what_was_not_tried_in_common(tmp_path: Path) -> None:
    """Two plates of 8 % more heat capacity that are heated alone: thickness does the same, and so would each lamp."""
    records = [plate(tmp_path, 130.0, 1.0, seed, heat_capacity=1.08) for seed in (3, 4)]
    closed = close_loops(records)
    write_joint_loop(closed, tmp_path / "out")
    found = json.loads((tmp_path / "out" / "closure.json").read_text())
    assert found["finding"] == "one of"
    (names,) = found["alternatives"]
    assert {"thickness of layer copper", "heat-capacity"} == set(names) == set(found["alternative_values"])
    for own in found["alternative_values"].values():
        (value,) = own.values()
        assert value["value"] == pytest.approx(1.08, abs=4.0 * value["sigma"])
    assert "heat-capacity (heat capacity" in closed.report.in_words()
    assert sum("flux of the lamp" in line and "not tried in common" in line for line in found["remarks"]) == 2


@pytest.mark.thorough
def test_what_a_record_partly_resembles_has_its_value_and_is_not_added(cooled_plates: JointClosedLoop) -> None:
    """Two lamps of 8 % more flux are no property of the plate that they have in common."""
    closed = cooled_plates
    stated = closed.report.statement
    assert stated.finding == "partly"
    assert {name for names in stated.alternatives for name in names} == set(stated.alternative_values)
    before, after = (
        closed.report.pooled(found)["fit"]["rmse_K"]
        for found in ([loop.report.before for loop in closed.loops], closed.report.after)
    )
    assert after < before  # told, though not added
    assert closed.report.effects[0].name == "unknown"


def test_the_missing_flux_under_a_lamp_is_that_of_a_brighter_lamp() -> None:
    """Readings of a lamp 3 % brighter than the conditions state, at the times when it is lit."""
    before = declared_fit(brighter(1.03))
    missing = residual_heating(before.problem, before.fit.values)
    assert missing.flux_W_m2 == pytest.approx(FLUX_W_M2)
    on = (missing.time_s > 25.0) & (missing.time_s < 60.0)
    off = missing.time_s > 120.0
    assert np.mean(missing.delta_ratio[on]) == pytest.approx(0.03, abs=0.003)
    assert np.mean(missing.delta_ratio[off]) == pytest.approx(0.0, abs=0.003)
    shapes = residual_evidence(missing, None).shape_fits
    (step,) = (f for f in shapes if f.shape.variable == "time_s")
    assert shapes[0].share > 0.9
    assert step.shape.at == pytest.approx(70.0, abs=12.0)  # where the lamp goes out; the steps tried are 12 s apart


@pytest.mark.thorough
def test_what_the_declared_model_is_fitted_with_is_not_found_as_an_effect() -> None:
    """p09 has another conductivity; fitted with it, the declared model explains the record."""
    record = load_record(PRACTICE / "p09")
    names = [*default_names([record]), CONDUCTIVITY]
    closed = close_loop(record, names)
    assert closed.effects == ("none",)
    assert not [c for c in closed.search.first.tried if CONDUCTIVITY in c.model_names]
    assert closed.report.statement.adequacy is not None
    assert closed.report.statement.adequacy.p_value > 0.01
    assert {"ratio.scale", CONDUCTIVITY} < set(closed.report.parameters) <= set(names)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ("ratio.scale,stack.rsi.conductivty_factor", "did you mean `stack.rsi.conductivity_factor`?"),
        ("sensor.LS_surfac.bias", "unknown or unused sensor `LS_surfac`"),
        (",", "--parameters: holds no name"),
    ],
)
def test_an_unknown_parameter_is_refused_in_one_line(names: str, message: str, tmp_path: Path) -> None:
    arguments = ["close-loop", str(PRACTICE / "p06"), "--parameters", names, "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(cli, arguments)
    assert isinstance(result.exception, InputError)
    assert message in str(result.exception)
    assert "\n" not in str(result.exception)
    assert not (tmp_path / "out").exists()
