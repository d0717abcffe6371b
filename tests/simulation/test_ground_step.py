"""A lamp's step on an installed thermocouple: stack and clock are estimated from it before a flight."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.cli import main
from sim_heating.estimation.fit import FitResult, estimate
from sim_heating.inputs.record import Record, write_record
from sim_heating.inputs.sensor_model import SensorErrors
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.simulation.ground_step import BEFORE_S, step_record
from sim_heating.simulation.predict import predict

COATING, CONDUCTIVITY, SKEW = "stack.coating.thickness_factor", "stack.rsi.conductivity_factor", "clock.skew"
TRUTH = {COATING: 1.3, CONDUCTIVITY: 0.9}
SKEW_S = 0.4
PLUG = "V09T9527"


@cache
def lit_plug(flux_W_m2: float) -> Record:
    """The plug under a lamp; its coating is thicker and its insulation less conducting than declared."""
    vehicle = load_vehicle("orbiter")
    return step_record(vehicle, vehicle.control_point(PLUG), flux_W_m2, parameters=TRUTH, skew_s=SKEW_S)


@cache
def fitted(flux_W_m2: float) -> FitResult:
    return estimate([lit_plug(flux_W_m2)], [COATING, CONDUCTIVITY, SKEW])


def values(found: FitResult) -> dict[str, tuple[float, float]]:
    """Value and sigma by name."""
    return {n: (v, s) for n, v, s in zip(found.labels, found.fit.values, found.bounds.sigma, strict=True)}


@pytest.mark.sample(1)
@pytest.mark.parametrize("flux_W_m2", [10e3, 50e3, 100e3])
def test_a_step_gives_back_coating_conductivity_and_skew(flux_W_m2: float) -> None:
    found = values(fitted(flux_W_m2))
    for name, true in (*TRUTH.items(), (SKEW, SKEW_S)):
        value, sigma = found[name]
        # in addition to noise, error of steps of 1 s at the flank: 0.02 s of skew and 0.002 of a factor
        assert abs(value - true) < 3.0 * sigma + (0.02 if name == SKEW else 0.002)


@pytest.mark.thorough
def test_a_brighter_lamp_improves_the_clock_more_than_the_coating() -> None:
    sigma = {q: {n: s for n, (_, s) in values(fitted(q)).items()} for q in (10e3, 50e3, 100e3)}
    assert sigma[10e3][SKEW] > 2.0 * sigma[50e3][SKEW] > 2.0 * sigma[100e3][SKEW]
    assert sigma[10e3][SKEW] < 0.1  # s: a tenth of a sample even with the weak lamp
    assert sigma[10e3][COATING] / sigma[100e3][COATING] < sigma[10e3][SKEW] / sigma[100e3][SKEW]


@pytest.mark.thorough
def test_the_fitted_stack_predicts_the_thermocouples_to_their_noise() -> None:
    found = fitted(50e3)
    floor = found.problem.record_fits[0].record.noise_floor_K()
    before, after = (np.sqrt(np.nanmean(p[0].residual_K ** 2)) for p in (found.before, found.after))
    assert before > 5.0 * floor
    assert after == pytest.approx(floor, rel=0.1)


@pytest.mark.thorough
def test_a_gain_error_is_distinguished_from_a_thick_coating() -> None:
    vehicle = load_vehicle("orbiter")
    wrong = {PLUG: SensorErrors(gain=1.02)}
    record = step_record(vehicle, vehicle.control_point(PLUG), 50e3, parameters={COATING: 1.3}, errors=wrong)
    found = values(estimate([record], [COATING, f"sensor.{PLUG}.gain"]))
    for name, true in ((COATING, 1.3), (f"sensor.{PLUG}.gain", 1.02)):
        assert abs(found[name][0] - true) < 3.0 * found[name][1] + 0.002


@pytest.mark.thorough
def test_thickness_and_heat_capacity_of_a_coating_are_not_separable_with_a_lamp() -> None:
    found = estimate([lit_plug(50e3)], [COATING, "stack.coating.heat_capacity_factor"])
    assert found.correlation[0, 1] < -0.9  # a thin coating is heat capacity and hardly a resistance


def test_a_ground_test_has_no_heating_ratio_to_estimate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_record(lit_plug(50e3), tmp_path / "test")
    arguments = ["estimate", str(tmp_path / "test"), "--parameters", "ratio.d0", "--out", str(tmp_path / "out")]
    assert main(arguments) == 2
    errors = capsys.readouterr().err
    assert "h_ref is 0 throughout" in errors
    assert not (tmp_path / "out").exists()


def test_a_named_ratio_is_omitted_and_the_stack_is_estimated(tmp_path: Path) -> None:
    found = estimate([lit_plug(50e3)], ["ratio.d0", COATING])
    assert found.labels == (COATING,)
    assert "nothing depends on a heating ratio" in found.not_estimated["ratio.d0"]


def test_nothing_happens_before_the_lamp_is_on() -> None:
    record = lit_plug(50e3)
    dark = record.time_s < BEFORE_S
    predicted = predict(record).history.sensors_K[:, dark]
    np.testing.assert_allclose(predicted[np.isfinite(predicted)], 288.15, atol=1e-6)


def test_a_point_without_a_sensor_cannot_be_tested() -> None:
    vehicle = load_vehicle("orbiter")
    blind = replace(vehicle.control_point(PLUG), sensors=())
    with pytest.raises(InputError, match="no sensor to test"):
        step_record(vehicle, blind, 50e3)
