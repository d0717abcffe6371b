"""Thermocouples and recorders, and what an estimate makes of them."""

from __future__ import annotations

import math

import numpy as np

from sim_heating.base.conditions import Conditions
from sim_heating.estimation.inference.outliers import isolated
from sim_heating.inputs.sensor_model import indicated_temperature, measure, quantise
from sim_heating.march.history import march_points
from sim_heating.march.point import PointModel
from sim_heating.thermal.stack import Sensor
from tests.support.verification.row import Row, within
from tests.support.walls import material, wall

SPAN_K = [255.0, 1644.0]


def sensor(**declared: object) -> Sensor:
    """A thermocouple at the surface."""
    return Sensor.model_validate({"name": "V09T9527", "column": "V09T9527_K", "depth_m": 0.0} | declared)


def recorder() -> list[Row]:
    """Recorder words, calibration and noise."""
    word = sensor(bits=8, range_K=SPAN_K)
    lsb = (SPAN_K[1] - SPAN_K[0]) / 255.0
    T = np.linspace(SPAN_K[0], SPAN_K[1], 2_000_001)
    error = quantise(word, T) - T
    rms = float(np.sqrt(np.mean(error**2)))
    word_of, tried = "8 bits over 255 to 1644 K", "2e6 temperatures"
    rows = [
        Row(f"{word_of}: least step", lsb, word.lsb_K, 1e-12, "K", "span / (2^8 - 1)", "rounding"),
        within(1e-5, f"{word_of}: rms error", lsb / math.sqrt(12.0), rms, "K", "LSB / sqrt(12)", tried),
        Row(f"{word_of}: largest error", 0.5 * lsb, float(np.max(np.abs(error))), 1e-3, "K", "LSB / 2", tried),
    ]
    curved = sensor(calibration=[2.0, 0.99, 1e-5])
    got = float(indicated_temperature(curved, np.array([1000.0]))[0])
    rows.append(
        Row("calibration 2 + 0.99 T + 1e-5 T^2 at 1000 K", 1002.0, got, 1e-9, "K", "the polynomial", "rounding")
    )
    noisy = sensor(noise_sigma_K=1.5, bits=8, range_K=SPAN_K)
    n = 200_000
    steady = np.linspace(900.0, 1000.0, n)
    got = float(np.std(measure(noisy, steady, np.random.default_rng(1)) - steady))
    expected = math.hypot(1.5, lsb / math.sqrt(12.0))
    source, is_ = "sqrt(sigma^2 + LSB^2 / 12)", f"3 sigma of {n} readings: 3 / sqrt(2 n)"
    rows.append(
        within(
            3.0 / math.sqrt(2.0 * n), "noise of 1.5 K and 8 bits: scatter of readings", expected, got, "K", source, is_
        )
    )
    growing = sensor(noise_sigma_K=1.0, noise_per_K=0.003)
    got = float(np.std(measure(growing, steady, np.random.default_rng(2)) - steady))
    expected = math.sqrt(1.0 + float(np.mean((0.003 * steady) ** 2)))
    name = "noise of 1 K and 0.003 of the temperature, 900 to 1000 K: scatter of readings"
    rows.append(within(3.0 / math.sqrt(2.0 * n), name, expected, got, "K", "sqrt(sigma^2 + (kappa T)^2)", is_))
    return rows


def outliers() -> list[Row]:
    """Spikes among the readings of a wall that warms and cools, with noise of 1 K."""
    t = np.arange(0.0, 1000.0)
    read = 300.0 + 900.0 * np.sin(np.pi * t / 1000.0) + np.random.default_rng(4).normal(0.0, 1.0, len(t))
    spikes, pair = np.arange(50, 950, 45), np.array([200, 201])
    read[spikes] += 30.0 * np.where(np.arange(len(spikes)) % 2 == 0, 1.0, -1.0)
    read[pair] += 30.0
    away, _ = isolated(t, read, sensor(noise_sigma_K=1.0))
    name, is_ = "1000 readings, noise 1 K, 20 spikes of 30 K and 2 in a row", "a count"
    found, others = (float(np.count_nonzero(away[k])) for k in (spikes, ~np.isin(t, t[spikes])))
    return [
        Row(f"{name}: spikes that are left out", len(spikes), found, 0.0, "-", "as put in", is_),
        Row(f"{name}: others that are left out", 0.0, others, 0.0, "-", "none", is_),
    ]


def lag() -> list[Row]:
    """A thermocouple behind a first-order lag, on a plate that warms steadily."""
    tau, t = 4.0, np.arange(0.0, 41.0)
    plate = PointModel("plate", wall((material(1e4), 0.001)), (0.001,), nodes=14, lags_s=(tau,))
    lamp = Conditions({"time_s": t}).with_columns(q_add_W_m2=5e3, h_ref_kg_m2_s=0.0, H_r_J_kg=0.0)
    sensed = march_points([plate], [lamp])[0].sensors_K[0]
    rate = 5e3 / (1e6 * 0.001)
    source, is_ = "behind a ramp: r (t - tau (1 - exp(-t/tau)))", "the plate's own profile: q d / 3k"
    name = "thermocouple of tau 4 s on a plate that warms by 5 K/s"
    expected = {at: 300.0 + rate * (at - tau * (1.0 - math.exp(-at / tau))) for at in (2, 40)}
    return [Row(f"{name}: at {at} s", T, float(sensed[at]), 1e-3, "K", source, is_) for at, T in expected.items()]


def rows() -> list[Row]:
    """All of this subject."""
    return [*recorder(), *outliers(), *lag()]
