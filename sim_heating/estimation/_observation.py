"""Indications of the sensors of a record for given temperatures, and their sensitivity to every parameter.

    indicated = c0 + c1 T' + c2 T'^2 + ...,    T' = gain T(t - skew) + bias        (inputs/sensor_model.py)

so that d indicated = (c1 + 2 c2 T' + ...) (gain dT + T dgain + dbias - gain dT/dt dskew);
docs/estimation_statistics.md, equations 1 and 2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.errors import InputError
from sim_heating.base.files import suggestion
from sim_heating.base.parameters import CLOCK_SKEW, SENSOR, SENSOR_PREFIX, Parameter
from sim_heating.estimation.inference.likelihood import Observed, observed
from sim_heating.inputs.record import Record
from sim_heating.inputs.sensor_model import SensorErrors, calibrated
from sim_heating.march.linearised import Linearised
from sim_heating.thermal.stack import Sensor

LEAST_SIGMA_K = 0.02
"""Least noise [K] of a sensor: no thermocouple is better, and a likelihood needs some."""
LEAST_OF_LSB = 0.05
"""Least noise of a sensor over its recorder's step [-]."""


@dataclass(frozen=True, eq=False)
class Channel:
    """The samples of one sensor that are fitted.

    sensor   : its declaration;  number : its place in the record
    samples  : (sample,) places in the times that the march reads
    observed : intervals [K] in which its indications lay
    """

    sensor: Sensor
    number: int
    samples: IntArray
    observed: Observed


def channels(record: Record, time_s: FloatArray, chosen: NDArray[np.bool_]) -> list[Channel]:
    """The used sensors of a record with their samples at the chosen times.

    time_s  : (read,) times that the march reads [s]
    chosen  : (sample,) boolean mask over the record's samples
    returns : one channel for each used sensor with a reading; lost readings are left out

    Intervals of recorder words: docs/estimation_statistics.md, equation 4.
    """
    found = []
    for number, sensor in enumerate(record.sensors):
        read = record.thermocouples[sensor.column]
        mine = chosen & np.isfinite(read)
        if sensor.used and np.any(mine):
            places = np.searchsorted(time_s, record.time_s[mine])
            found.append(Channel(sensor, number, places, observed(sensor, read[mine])))
    return found


def least_sigma_K(sensor: Sensor) -> float:
    """The least noise [K] that is assumed for a sensor: 0.02 K, or 0.05 of its recorder's step.

    A modelling choice of this program: below it the likelihood of docs/estimation_statistics.md, equation 5, becomes
    that of an interval without noise, whose score is not smooth.
    """
    return max(LEAST_SIGMA_K, LEAST_OF_LSB * sensor.lsb_K)


def errors_of(sensor: Sensor, values: Mapping[str, float]) -> SensorErrors:
    """Bias [K] and gain [-] of a sensor as parameters state them; 0 and 1 where they do not.

    values : dotted name -> value

    Used in docs/estimation_statistics.md, equation 1.
    """
    bias, gain = (values.get(sensor_parameter(sensor, what), SENSOR[what].value) for what in ("bias", "gain"))
    return SensorErrors(bias, gain)


def sensor_parameter(sensor: Sensor, what: str) -> str:
    """Dotted name of a parameter of a sensor: `sensor.NAME.bias` [K] or `sensor.NAME.gain` [-].

    Parameters b and g of docs/estimation_statistics.md, equation 1.
    """
    return f"{SENSOR_PREFIX}{sensor.name}.{what}"


def definition(record: Record, name: str) -> Parameter | None:
    """Definition of a parameter of a clock or sensor by its dotted name; None for any other name.

    returns : prior, bounds and unit (skew [s], bias [K], gain [-])
    raises  : InputError where the record has no such sensor, or a sensor no such parameter

    Parameters s, b and g of docs/estimation_statistics.md, equation 1.
    """
    if name == CLOCK_SKEW.name:
        return CLOCK_SKEW
    if not name.startswith(SENSOR_PREFIX):
        return None
    sensor, _, what = name.removeprefix(SENSOR_PREFIX).rpartition(".")
    known = [s.name for s in record.used_sensors]
    if sensor not in known:
        raise InputError(f"{record.name}: `{name}` names no sensor that is used. {suggestion(sensor, known)}")
    if what not in SENSOR:
        raise InputError(f"{record.name}: `{name}`: a sensor has no `{what}`. {suggestion(what, SENSOR)}")
    return SENSOR[what]


def indicated(
    channel: Channel, marched: Linearised, names: Sequence[str], values: Mapping[str, float], named: int
) -> tuple[FloatArray, FloatArray]:
    """Indications of a channel and their sensitivities to the parameters.

        indicated = c0 + c1 T' + ...,   T' = gain T(t - skew) + bias

    marched : temperatures [K], sensitivities and rates [K/s] of the march
    names   : (parameter,) of the part, the first `named` of them being columns of the march, then clock and sensors
    values  : dotted name -> value
    named   : number of columns of the march that are read
    returns : (sample,) indications [K]; (sample, parameter) sensitivities [K] per unit of each parameter

    The march already reads T at t - skew. Source: docs/estimation_statistics.md, equations 1 and 2.
    """
    sensor, wrong = channel.sensor, errors_of(channel.sensor, values)
    T = marched.temperature_K[channel.number, channel.samples]
    jacobian = np.zeros((len(T), len(names)))
    np.multiply(marched.sensitivity[channel.number, channel.samples, :named], wrong.gain, out=jacobian[:, :named])
    for k, name in enumerate(names[named:], start=named):
        if name == CLOCK_SKEW.name:
            jacobian[:, k] = -wrong.gain * marched.rate_K_s[channel.number, channel.samples]
        elif name == sensor_parameter(sensor, "bias"):
            jacobian[:, k] = 1.0
        elif name == sensor_parameter(sensor, "gain"):
            jacobian[:, k] = T
    # most sensors have no curve: this saves a polynomial for every sample of every evaluation
    if sensor.calibration is None:
        return wrong.gain * T + wrong.bias_K, jacobian
    calibration = np.polynomial.Polynomial(sensor.calibration)
    slope = calibration.deriv()(wrong.gain * T + wrong.bias_K)
    return calibrated(sensor, T, wrong), slope[:, np.newaxis] * jacobian
