"""What a thermocouple and its recorder make of a temperature.

    indicated = c0 + c1 T' + c2 T'^2 + ...,   T' = gain T + bias,   T = temperature at the sensor at t - skew,

then noise, then the recorder word: codes 0 .. 2^bits - 1 over range_K, rounded to the nearest and clipped at the ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.jit import njit
from sim_heating.thermal.stack import Sensor


@dataclass(frozen=True)
class SensorErrors:
    """What is wrong with one sensor beside its noise: T' = gain T + bias."""

    bias_K: float = 0.0
    gain: float = 1.0


def calibrated(sensor: Sensor, temperature_K: FloatArray, errors: SensorErrors | None = None) -> FloatArray:
    """Indicated temperature [K] before noise and quantisation."""
    wrong = errors or SensorErrors()
    return indicated(np.asarray(temperature_K, dtype=float), wrong.gain, wrong.bias_K, calibration(sensor))


def calibration(sensor: Sensor) -> FloatArray:
    """Coefficients c0, c1, ... of a sensor; 0, 1 where it declares none."""
    return np.array(sensor.calibration or [0.0, 1.0])


@njit
def indicated(temperature_K, gain, bias_K, coefficients):  # type: ignore[no-untyped-def]
    """c0 + c1 T' + c2 T'^2 + ..., T' = gain T + bias, of one temperature or an array of them [K]."""
    wrong = gain * temperature_K + bias_K
    value = 0.0 * wrong + coefficients[-1]
    for k in range(len(coefficients) - 2, -1, -1):
        value = coefficients[k] + value * wrong
    return value


def quantised(sensor: Sensor, indicated_K: FloatArray) -> FloatArray:
    """The temperature that the recorder word stands for [K]; unchanged where the sensor declares no word."""
    if sensor.bits is None or sensor.range_K is None:
        return indicated_K
    low, _ = sensor.range_K
    codes = np.clip(np.rint((indicated_K - low) / sensor.lsb_K), 0, 2**sensor.bits - 1)
    return low + codes * sensor.lsb_K


def sample_times(
    sensors: Sequence[Sensor], start_s: float, end_s: float, *, rate_hz: float | None = None, offset_s: float = 0.0
) -> FloatArray:
    """Times at which the recorder samples [s]: at the sensors' common rate, 1 Hz where they name none.

    offset_s : time of the first sample after the start, on top of the sensors' own
    raises   : InputError where sensors of one recorder differ in rate or offset
    """
    rates = {s.rate_hz or 1.0 for s in sensors} if rate_hz is None else {rate_hz}
    offsets = {s.sample_offset_s for s in sensors}
    if len(rates) > 1 or len(offsets) > 1:
        names = ", ".join(s.name for s in sensors)
        raise InputError(f"{names}: sensors of one record need one rate_hz and one sample_offset_s; give them the same")
    rate = rates.pop()
    first = start_s + offsets.pop() + offset_s
    count = int(np.floor((end_s - first) * rate + 1e-9)) + 1
    return first + np.arange(max(count, 0)) / rate


def measured(
    sensor: Sensor,
    temperature_K: FloatArray,
    rng: np.random.Generator,
    errors: SensorErrors | None = None,
    lost: NDArray[np.bool_] | None = None,
) -> FloatArray:
    """(sample,) readings [K] of a sensor whose temperature at the sample times is given; lost samples are NaN."""
    indicated = calibrated(sensor, temperature_K, errors)
    noisy = indicated + rng.normal(0.0, sensor.noise_sigma_K or 0.0, len(indicated))
    read = quantised(sensor, noisy)
    return read if lost is None else np.where(lost, np.nan, read)


def lost_samples(
    time_s: FloatArray, rng: np.random.Generator, fraction: float, gaps_s: Sequence[Sequence[float]]
) -> NDArray[np.bool_]:
    """Which samples are lost: a random fraction, and all within the telemetry gaps [[start, end], ...], ends
    included."""
    lost = rng.random(len(time_s)) < fraction
    for start, end in gaps_s:
        lost |= (time_s >= start) & (time_s <= end)
    return lost
