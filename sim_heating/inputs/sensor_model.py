"""Sensor model: from the temperature at a thermocouple to the reading that its recorder stores.

    T_ind = c0 + c1 T' + c2 T'^2 + ...,   T' = gain T_tc + bias + drift t',   dT_tc/dt = (T - T_tc) / tau at t - skew,

T the temperature at the sensor, t' the time since the first sample of the record, then Gaussian noise, then the
recorder word: codes 0 .. 2^bits - 1 over range_K, rounded to the nearest and clipped at the ends. The lag is applied
where temperatures are marched (march/history.py).
Equations: docs/theory/equations.md, section 5.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.jit import for_values, njit
from sim_heating.thermal.sampling import USUAL_HZ, Rate, sample_instants
from sim_heating.thermal.stack import Sensor


@dataclass(frozen=True)
class SensorErrors:
    """Systematic errors of one sensor, in addition to its noise: T' = gain T_tc + bias + drift t', T_tc behind a lag.

    bias_K : added to the temperature, positive where the sensor reads too high [K]
    gain   : indicated over true temperature, 1 without error [-]
    tau_s  : time constant of its first-order lag [s]; None for the declared one
    drift_K_s : rate of a bias that grows from 0 at the first sample of the record [K/s]
    """

    bias_K: float = 0.0
    gain: float = 1.0
    tau_s: float | None = None
    drift_K_s: float = 0.0


def indicated_temperature(
    sensor: Sensor, temperature_K: FloatArray, errors: SensorErrors | None = None, since_s: FloatArray | float = 0.0
) -> FloatArray:
    """Indicated temperature of a sensor before noise and quantisation, T_ind = c0 + c1 T' + c2 T'^2 + ...

    temperature_K : (sample,) temperature of the thermocouple [K], behind its lag, at the sample times less the clock
                    skew
    errors        : gain [-], bias [K] and drift [K/s] in T' = gain T + bias + drift t'; by default those that the
                    sensor states, the bias of its check before the flight
    since_s       : (sample,) time since the first sample of the record [s], where the sensor drifts
    returns       : (sample,) indicated temperature [K]

    Source: docs/theory/equations.md, section 5.
    """
    wrong = errors or SensorErrors(stated_bias_K(sensor))
    # A sum and not the argument of the kernel, which would be compiled for arrays a second time.
    drifted = np.asarray(temperature_K, dtype=float) + wrong.drift_K_s / wrong.gain * since_s
    kernel = for_values(indicated_kernel, drifted.size)
    return kernel(drifted, wrong.gain, wrong.bias_K, calibration_coefficients(sensor))


def stated_bias_K(sensor: Sensor) -> float:
    """What a sensor is known to read too much [K], the mean of its prior; 0 where nothing states it.

    Source: docs/theory/equations.md, section 5.
    """
    prior_K = sensor.bias_prior_K
    return 0.0 if prior_K is None else prior_K[0]


def lags_s(sensors: Sequence[Sensor], errors: Mapping[str, SensorErrors]) -> tuple[float, ...]:
    """Time constants of sensors [s]: as declared, where their errors have no other one.

    errors : by the name of the sensor

    Source: docs/theory/equations.md, section 5.
    """
    wrong = [errors.get(s.name, SensorErrors()).tau_s for s in sensors]
    return tuple(s.tau_s if tau is None else tau for s, tau in zip(sensors, wrong, strict=True))


def calibration_coefficients(sensor: Sensor) -> FloatArray:
    """Calibration coefficients of a sensor: (order + 1,) c0 [K], c1 [-], c2 ...; 0, 1 where it declares none.

    Source: docs/theory/equations.md, section 5.
    """
    return np.array(sensor.calibration or [0.0, 1.0])


@njit
def indicated_kernel(temperature_K, gain, bias_K, coefficients):
    """Calibration polynomial T_ind = c0 + c1 T' + c2 T'^2 + ... of T' = gain T + bias, by Horner's rule.

    temperature_K : true temperature [K], a number or an array;  gain [-], bias_K [K]
    coefficients  : c0 [K], c1 [-], c2 ...
    returns       : indicated temperature [K], in the shape of temperature_K

    Source: docs/theory/equations.md, section 5.
    """
    wrong = gain * temperature_K + bias_K
    # 0 * wrong gives the constant the shape of the argument, in a kernel that serves numbers and arrays alike.
    value = 0.0 * wrong + coefficients[-1]
    for k in range(len(coefficients) - 2, -1, -1):
        value = coefficients[k] + value * wrong
    return value


def quantise(sensor: Sensor, indicated_K: FloatArray) -> FloatArray:
    """Temperature that the recorder word stands for: low + code LSB, code = round((T_ind - low) / LSB).

    indicated_K : (sample,) indicated temperature with its noise [K]
    returns     : (sample,) [K], within range_K; unchanged where the sensor declares no word

    Codes are clipped to 0 .. 2^bits - 1, so that a temperature outside range_K reads as the end of the range. A value
    halfway between two codes goes to the even one. Source: docs/theory/equations.md, section 5.
    """
    if sensor.bits is None or sensor.range_K is None:
        return indicated_K
    return word_value(indicated_K, sensor.range_K[0], sensor.lsb_K, sensor.bits)


def word_value(indicated: FloatArray, lowest: float, lsb: float, bits: int) -> FloatArray:
    """(sample,) what a recorder word stands for: low + code LSB, all in one unit ([K] or [Pa]).

    lowest : of its span;  lsb : its step;  bits : of the word [-]

    Source: docs/theory/equations.md, equation 34.
    """
    codes = np.clip(np.rint((indicated - lowest) / lsb), 0, 2**bits - 1)
    return np.asarray(lowest + codes * lsb)


def sample_times(
    sensors: Sequence[Sensor],
    start_s: float,
    end_s: float,
    *,
    rate_hz: Rate | None = None,
    offset_s: float = 0.0,
    manoeuvres_s: Sequence[tuple[float, float]] = (),
) -> FloatArray:
    """Times at which a recorder samples its sensors, from start and offsets up to and including the end.

    sensors        : sensors of one recorder, with a common rate (1 Hz where they name none) and offset
    start_s, end_s : recorded span [s]
    rate_hz        : sample rate in place of that of the sensors [Hz]
    offset_s       : time of the first sample after the start, added to that of the sensors [s]
    manoeuvres_s   : start and end of the manoeuvres, in which a recorder may be faster [s]
    returns        : (sample,) times [s]; empty where the first sample lies behind the end
    raises         : InputError where sensors of one recorder differ in rate or offset

    Source: docs/theory/equations.md, equation 33a.
    """
    rates = [s.rate_hz or USUAL_HZ for s in sensors] if rate_hz is None else [rate_hz]
    offsets = {s.sample_offset_s for s in sensors}
    if any(rate != rates[0] for rate in rates) or len(offsets) > 1:
        names = ", ".join(s.name for s in sensors)
        raise InputError(f"{names}: sensors of one record need one rate_hz and one sample_offset_s; give them the same")
    return sample_instants(rates[0], start_s + offsets.pop() + offset_s, end_s, manoeuvres_s)


def measure(
    sensor: Sensor,
    temperature_K: FloatArray,
    rng: np.random.Generator,
    errors: SensorErrors | None = None,
    lost: NDArray[np.bool_] | None = None,
    since_s: FloatArray | float = 0.0,
) -> FloatArray:
    """Readings of a thermocouple: calibration with systematic errors, Gaussian noise, recorder word, lost samples.

    temperature_K : (sample,) temperature of the thermocouple, behind its lag, at the sample times [K]
    rng           : generator of the noise, of standard deviation noise_sigma_K [K] (0 where none is declared), and of
                    noise_per_K times the indicated temperature in addition
    errors        : bias, gain and drift of the sensor; none by default
    lost          : (sample,) which samples the telemetry loses
    since_s       : (sample,) time since the first sample of the record [s], where the sensor drifts
    returns       : (sample,) readings [K], NaN where lost

    Source: docs/theory/equations.md, section 5.
    """
    indicated = indicated_temperature(sensor, temperature_K, errors, since_s)
    # Noise is drawn for lost samples as well: losing one leaves the noise of the others unchanged.
    noisy = indicated + rng.normal(0.0, sensor.noise_sigma_K or 0.0, len(indicated))
    if sensor.noise_per_K:
        noisy = noisy + rng.normal(0.0, sensor.growing_noise_K(indicated))
    read = quantise(sensor, noisy)
    return read if lost is None else np.where(lost, np.nan, read)


def lost_samples(
    time_s: FloatArray, rng: np.random.Generator, fraction: float, gaps_s: Sequence[Sequence[float]]
) -> NDArray[np.bool_]:
    """Which samples the telemetry loses: an independent random fraction, and all within gaps.

    time_s   : (sample,) [s]
    fraction : probability that a sample is lost [-]
    gaps_s   : telemetry gaps [[start, end], ...] [s], both ends included
    returns  : (sample,) True where lost

    Readings at these times become NaN. Source: docs/reference/scenario_format.md, `[measurements]`.
    """
    lost = rng.random(len(time_s)) < fraction
    for start, end in gaps_s:
        lost |= (time_s >= start) & (time_s <= end)
    return lost
