"""Residual heating: exact where conduction has a closed form, and within its sigma on a flight."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sim_heating.base.files import read_csv_columns
from sim_heating.closure.clues.residual_heating import ResidualHeating, residual_heating, write_residual_heating
from sim_heating.estimation.filter.heating_input import UnknownInput, unknown_input
from sim_heating.estimation.filter.march import FilterTrack
from sim_heating.estimation.problem import FitProblem, joint_reference
from sim_heating.heating.effects import use
from sim_heating.inputs.record import Record
from sim_heating.march.mesh_choice import pack
from sim_heating.march.point import PointModel
from tests.support.filter_samples import samples_on_grid
from tests.support.missing import record_with
from tests.support.verification.exact import semi_infinite_flux, semi_infinite_linear_flux
from tests.support.walls import flight, material, wall

K, RHO, C = 0.5, 1000.0, 1000.0
A = K / (RHO * C)
TIME_S = np.arange(0.0, 301.0)
H_REF, H_R, RATIO = 1e-7, 1e11, 1.0
FLUX = H_REF * H_R
"""The enthalpy is so large that the wall's is negligible: the flux is the ratio times this [W/m2]."""
SIGMA_K = 0.5
HALF_SPACE_M = 0.15
"""Deep against sqrt(4 a t), 25 mm."""


def half_space(depth_m: float, rise_K: np.ndarray, seed: int) -> UnknownInput:
    """Residual heating from a thermocouple in a half space whose model has a constant ratio."""
    construction = wall((material(K, C, RHO), HALF_SPACE_M), initial_K=300.0)
    model = PointModel("half space", construction, (depth_m,), nodes=120, parameters={"ratio.d0": RATIO})
    mesh = pack([model]).meshes[0]
    read = 300.0 + rise_K[1:] + np.random.default_rng(seed).normal(0.0, SIGMA_K, len(TIME_S) - 1)
    track = FilterTrack(model, mesh, samples_on_grid(TIME_S[1:], mesh.sensors, read[np.newaxis], SIGMA_K))
    return unknown_input(track, TIME_S, flight(TIME_S, h_ref_kg_m2_s=H_REF, H_r_J_kg=H_R, p_surface_Pa=1e4))


def after(seconds: float) -> np.ndarray:
    """Time since, at least so small that sqrt is defined."""
    return np.maximum(TIME_S - seconds, 1e-12)


@pytest.mark.parametrize("depth_m", [0.0, 0.002])
def test_a_step_in_the_ratio_of_a_half_space_is_recovered(depth_m):
    step = 0.3
    rise = semi_infinite_flux(FLUX, K, A, depth_m, after(0.0)) + semi_infinite_flux(
        step * FLUX, K, A, depth_m, after(150.0)
    )
    found = half_space(depth_m, rise, seed=1)
    truth = np.where(found.time_s > 150.0, step, 0.0)
    away = (np.abs(found.time_s - 150.0) > 1.0 / np.median(found.bandwidth_Hz)) & (found.time_s > 20.0)
    error = (found.delta_ratio - truth)[away]
    assert np.sqrt(np.mean(error**2)) < 0.05 * step
    assert np.mean((error / found.sigma[away]) ** 2) < 1.5


def sine_rise(amplitude: float, frequency_Hz: float) -> np.ndarray:
    """Surface of a half space under FLUX (1 + amplitude sin): the flux in pieces linear in time, each exact."""
    at = np.arange(0.0, TIME_S[-1], 0.1)
    slopes = np.diff(amplitude * FLUX * np.sin(2.0 * math.pi * frequency_Hz * np.append(at, TIME_S[-1]))) / 0.1
    change = np.diff(slopes, prepend=0.0)
    rise = semi_infinite_flux(FLUX, K, A, 0.0, after(0.0))
    for begin, slope in zip(at, change, strict=True):
        rise = rise + semi_infinite_linear_flux(slope, K, A, np.maximum(TIME_S - begin, 0.0))
    return rise


def recovered_amplitude(found: UnknownInput, frequency_Hz: float) -> float:
    phase = 2.0 * math.pi * frequency_Hz * found.time_s
    waves = np.column_stack([np.sin(phase), np.cos(phase), np.ones_like(phase)])
    fit = np.linalg.lstsq(waves, found.delta_ratio, rcond=None)[0]
    return float(np.hypot(fit[0], fit[1]))


def test_a_sine_in_the_ratio_of_a_half_space_is_recovered_with_the_stated_amplitude():
    # the noise model is that of the slow sine; under the same model a faster one falls to half at the stated frequency
    slow = half_space(0.0, sine_rise(0.1, 0.02), seed=2)
    assert recovered_amplitude(slow, 0.02) == pytest.approx(0.1, rel=0.1)
    half = slow.half_amplitude_Hz
    assert 0.02 < half < 0.5
    R = slow.covariance @ slow.information
    wave = np.sin(2.0 * math.pi * half * slow.time_s)
    assert float(wave @ (R @ wave)) / float(wave @ wave) == pytest.approx(0.5, abs=0.05)


BEGIN_S, END_S = 500.0, 580.0
RISE = 0.1


@cache
def flown(seed: int, size: float = RISE) -> tuple[Record, ResidualHeating, float]:
    """A record whose ratio rises by a part at 500 s and falls back at 580 s, unknown to its model; and that rise."""

    def jets(t: np.ndarray) -> np.ndarray:
        return np.clip(t - BEGIN_S, 0.0, 1.0) - np.clip(t - END_S, 0.0, 1.0)

    made, history = record_with([use("jet-interaction", {"jet_gain": size})], seed, jets=jets, lost=0.02)
    problem = FitProblem([made], ["ratio.scale"], joint_reference([made]))
    during = (history.time_s > BEGIN_S + 5.0) & (history.time_s < END_S - 5.0)
    rise = float(np.mean(history.ratio[during])) * size / (1.0 + size)
    return made, residual_heating(problem, np.zeros(1)), rise


@pytest.mark.thorough
def test_a_step_in_a_flight_with_recorder_words_and_lost_samples_is_recovered():
    record, found, rise = flown(3)
    t, ends = found.time_s, [BEGIN_S + 0.5, END_S + 0.5]
    assert np.isnan(record.temperatures_K()).any()
    assert found.delta_ratio[(t > BEGIN_S + 15.0) & (t < END_S - 15.0)].mean() == pytest.approx(rise, rel=0.1)
    away = np.min(np.abs(np.subtract.outer(t, ends)), axis=1) > 0.5 / found.input.half_amplitude_Hz
    away &= found.fitted
    z = (found.delta_ratio - rise * ((t > ends[0]) & (t < ends[1])))[away] / found.sigma[away]
    assert np.mean(z**2) < 1.5


def test_a_heating_error_leaves_the_sensors_at_their_noise():
    _, found, _ = flown(3)
    outer = found.sensors[0]
    assert outer.before_rmse_K > 1.3 * outer.floor_K
    for s in found.sensors:
        assert s.after_rmse_K == pytest.approx(s.floor_K, rel=0.12)


def test_an_error_in_depth_is_not_explained_by_heating():
    record, _, _ = flown(3)
    read = {**record.thermocouples}
    deep = record.sensors[-1]
    read[deep.column] = read[deep.column] + 20.0 * np.sin(record.time_s / 20.0)
    other = replace(record, thermocouples=read)
    problem = FitProblem([other], ["ratio.scale"], joint_reference([other]))
    found = residual_heating(problem, np.zeros(1))
    sensor = found.sensors[-1]
    assert found.input.variance_factor > 10.0  # the noise is found larger, and no history follows the sensor
    assert np.max(np.abs(found.delta_ratio)) < 2.0 * flown(3)[2]
    assert sensor.after_rmse_K > 5.0 * sensor.floor_K
    assert "does not explain" in sensor.describe()


def test_no_heating_is_found_where_none_is_missing():
    _, found, _ = flown(4, 0.0)
    assert found.input.gain_log_likelihood < 5.0
    assert np.max(np.abs(found.delta_ratio)) < 0.1 * flown(3)[2]


def test_the_history_is_written_with_the_columns_of_its_format(tmp_path):
    _, found, _ = flown(3)
    write_residual_heating(tmp_path / "residual_heating.csv", found)
    table = read_csv_columns(tmp_path / "residual_heating.csv", ("time_s", "delta_ratio", "sigma"))
    assert list(table.columns) == ["time_s", "delta_ratio", "sigma"]
    np.testing.assert_array_equal(table["delta_ratio"], found.delta_ratio)
    assert np.all(table["sigma"] > 0.0)
