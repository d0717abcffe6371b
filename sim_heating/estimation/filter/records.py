"""Flight records as input of a Kalman filter, and a start for a fit from the data before it; docs/theory/filter.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.parameters import CLOCK_SKEW, COMMON_LAG
from sim_heating.estimation.filter.heating_input import most_likely_disturbance
from sim_heating.estimation.filter.kernel import CONSTANT, PER_RATE, PER_TEMPERATURE
from sim_heating.estimation.filter.march import FilterMarch, FilterTrack, Samples
from sim_heating.estimation.inference.likelihood import middle_K
from sim_heating.estimation.record_fit import (
    FittedChannel,
    RecordFit,
    Sensed,
    Start,
    fitted_channels,
    least_sigma_K,
    march_times,
    sensor_errors,
    sensor_parameter,
    set_parameters,
)
from sim_heating.inputs.points import conditions_of_record, flow_of_record
from sim_heating.inputs.record import Record
from sim_heating.march.ensemble import condition_history
from sim_heating.march.linearised import LinearMarch
from sim_heating.march.point import PointModel
from sim_heating.thermal.mesh import Mesh
from sim_heating.thermal.stack import Sensor

START_SIGMA_K = 5.0
"""Standard deviation [K] of the declared temperatures at the first row of the conditions, all nodes alike."""
UNDECLARED_SIGMA_K = 1.0
"""Noise [K] of a sensor that declares none."""
NEWTON_STEPS = 8
"""Newton steps that invert a calibration curve."""


def calibration_line(sensor: Sensor, read_K: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tangent of a sensor's calibration at the temperatures at which it shows given readings.

        indicated = slope T + constant   about the T with curve(T) = read

    sensor  : its calibration c0 + c1 T + c2 T^2 + ...; the identity where it declares none
    read_K  : (sample,) readings [K]
    returns : (sample,) slope [-] and constant [K]

    Eight Newton steps from T = read; not checked for convergence, as a calibration is close to the identity.
    Calibration: docs/theory/estimation_statistics.md, equation 1.
    """
    curve = np.polynomial.Polynomial(sensor.calibration or [0.0, 1.0])
    slope, T = curve.deriv(), np.array(read_K, dtype=float)
    for _ in range(NEWTON_STEPS):
        T = T - (curve(T) - read_K) / slope(T)
    return slope(T), curve(T) - slope(T) * T


def filter_samples(
    channels: Sequence[FittedChannel],
    time_s: FloatArray,
    mesh: Mesh,
    sigma_K: Mapping[int, float],
    values: Mapping[str, float] | None = None,
    added_K: FloatArray | float = 0.0,
    names: Sequence[str] = (),
    lag: Sensed | None = None,
) -> tuple[Samples, NDArray[np.int64]]:
    """Channels as the filter reads them: linear readings of a node, in the order of time.

    A calibration is its tangent at each reading, so that reading = gain * T_node + constant.

    channels : of a record
    time_s   : (sample,) times that the channels' places refer to [s]
    mesh     : whose sensors are nodes
    sigma_K  : noise [K] by the number of the sensor
    values   : parameters of clock and sensors (bias, gain, drift)
    added_K  : (sensor, sample) correction on top of the march [K], 0 by default
    names    : parameters of the filter, of which clock and sensors act on the readings themselves
    lag      : what the lags of the thermocouples add to the march (`lag_offset`), or None
    returns  : readings of all channels, and the place of each among those of the channels one after the other

    Source: docs/theory/estimation_statistics.md, equations 1, 2 and 4.
    """
    rows, added = [], np.zeros((len(mesh.sensors), len(time_s))) + added_K
    if lag is not None:
        added = added + lag.temperature_K
    direct = []
    for channel in channels:
        low, high = channel.intervals.lower_K, channel.intervals.upper_K
        # the tangent is taken at the middle of a word, at the finite end of an open one
        middle = middle_K(low, high)
        slope, constant = calibration_line(channel.sensor, middle)
        wrong, added_here_K = sensor_errors(channel.sensor, values or {}), added[channel.number, channel.samples]
        constant = constant + slope * (wrong.gain * added_here_K + wrong.bias_K + wrong.drift_K_s * channel.since_s)
        direct.append(direct_terms(channel.sensor, names, slope, wrong.gain, added_here_K, channel.since_s))
        if lag is not None:
            direct[-1][..., CONSTANT] += (slope * wrong.gain)[:, np.newaxis] * _through_lag(channel, names, lag)
        variance = np.zeros(len(low)) + channel.noise_K(sigma_K[channel.number]) ** 2
        node = np.full(len(low), mesh.sensors[channel.number])
        rows.append(np.array([time_s[channel.samples], node, low, high, variance, slope * wrong.gain, constant]))
    t, node, low, high, variance, gain, constant = np.concatenate(rows, axis=1)
    # stable: readings of one time stay in the order of the channels, and results are reproducible
    order = np.argsort(t, kind="stable")
    samples = Samples(
        t[order],
        node[order].astype(np.int64),
        low[order],
        high[order],
        variance[order],
        gain[order],
        constant[order],
        np.concatenate(direct)[order] if names else None,
    )
    return samples, order


def direct_terms(
    sensor: Sensor, names: Sequence[str], slope: FloatArray, gain: float, added_K: FloatArray, since_s: FloatArray
) -> FloatArray:
    """(reading, parameter, 3) derivatives of readings to parameters of clock and sensor.

    sensor  : whose readings they are;  names : of all parameters
    slope   : (reading,) of its calibration [-];  gain : of the sensor [-]
    added_K : (reading,) correction on top of the march [K];  since_s : (reading,) time since the first reading [s]

    Split into parts that are constant, per temperature and per rate. Source: docs/theory/estimation_statistics.md,
    equation 2.
    """
    derivatives = np.zeros((len(slope), len(names), 3))
    for k, name in enumerate(names):
        if name == CLOCK_SKEW.name:
            derivatives[:, k, PER_RATE] = -slope * gain
        elif name == sensor_parameter(sensor, "bias"):
            derivatives[:, k, CONSTANT] = slope
        elif name == sensor_parameter(sensor, "drift"):
            derivatives[:, k, CONSTANT] = slope * since_s
        elif name == sensor_parameter(sensor, "gain"):
            derivatives[:, k, CONSTANT], derivatives[:, k, PER_TEMPERATURE] = slope * added_K, slope
    return derivatives


def _through_lag(channel: FittedChannel, names: Sequence[str], lag: Sensed) -> FloatArray:
    """(reading, parameter) derivatives of what the lag of a channel adds to the temperature of its place [K]."""
    i, at = channel.number, channel.samples
    derivatives = np.zeros((len(at), len(names)))
    # the unknowns of march and start come first
    columns = min(lag.sensitivity.shape[2], len(names))
    derivatives[:, :columns] = lag.sensitivity[i, at, :columns]
    for k, name in enumerate(names):
        if name == CLOCK_SKEW.name:
            derivatives[:, k] = -lag.rate_K_s[i, at]
        elif name in (COMMON_LAG.name, sensor_parameter(channel.sensor, "tau_s")):
            derivatives[:, k] = lag.per_lag_K_s[i, at]
    return derivatives


def track_of_record(
    record: Record, model: PointModel, mesh: Mesh, end_s: float | None = None
) -> tuple[FilterTrack, FloatArray, FloatArray]:
    """A record up to a time as input of the filter: all readings but those held out.

    record, model, mesh : point and its mesh
    end_s   : last time [s]; by default the end of the conditions
    returns : the track, (step,) times [s] and the (1, step, ...) history of conditions along them
    raises  : InputError where no used sensor is read by then

    Temperatures at the first row are uncertain by 5 [K], all nodes alike. The filter: docs/theory/filter.md, after
    Kalman 1960.
    """
    conditions, t = conditions_of_record(record, flow_of_record(record, model.effects)), record.time_s
    begin, end = conditions.time_s[0], min(conditions.time_s[-1], np.inf if end_s is None else end_s)
    chosen = (t >= begin) & (t <= end) & ~record.holdout_mask()
    channels = fitted_channels(record, t[chosen], chosen)
    if not channels:
        raise InputError(f"{record.name}: no used sensor is read between {begin:g} and {end:g} s; nothing to filter")
    sigma = {c.number: max(c.sensor.noise_sigma_K or UNDECLARED_SIGMA_K, least_sigma_K(c.sensor)) for c in channels}
    # fully correlated: a wall that has soaked is off as a whole, not node by node
    covariance = np.full((mesh.nodes, mesh.nodes), START_SIGMA_K**2)
    steps = march_times(conditions, begin, end)
    steps = np.append(steps[steps < end], end)
    record_fit = RecordFit(record, model, mesh, None, conditions, (), (), time_s=steps, sample_s=t[chosen])
    steps = record_fit.time_s = record_fit.divided_times()
    samples, _ = filter_samples(channels, t[chosen], mesh, sigma, lag=lag_offset(record_fit, np.zeros(0)))
    history = condition_history(conditions.at(steps))[np.newaxis]
    return FilterTrack(model, mesh, samples, covariance_K2=covariance), steps, history


def lag_offset(record_fit: RecordFit, vector: FloatArray, *, sensitive: bool = True) -> Sensed | None:
    """What the lags of a record's thermocouples add to the plain march, and its derivatives; None where none lags.

    vector    : (parameter,)
    sensitive : whether with sensitivities to the unknowns of march and start
    raises    : RunError where the march failed

    Used where a filter predicts the temperature of the place: docs/theory/filter.md, equation 7a.
    """
    if not record_fit.lags:
        return None
    track, history = record_fit.track(vector, sensitive=sensitive), record_fit.history(record_fit.time_s)
    march = LinearMarch([track], record_fit.time_s, history)
    plain = march.march(*set_parameters(march, [record_fit], [vector]))[0]
    lagged, at = record_fit.sensed(plain, vector), np.searchsorted(record_fit.read_s, record_fit.sample_s)
    return Sensed(
        lagged.temperature_K - plain.temperature_K[:, at],
        lagged.rate_K_s - plain.rate_K_s[:, at],
        lagged.sensitivity - plain.sensitivity[:, at],
        lagged.per_lag_K_s,
    )


def filtered_start(record: Record, model: PointModel, mesh: Mesh, time_s: float) -> Start:
    """A start of a fit: temperatures and covariance of the filter given all readings before a time.

    time_s  : time of the start [s]
    returns : temperatures [K] and their covariance [K2]; no unknowns
    raises  : InputError where nothing is read before that time

    The heating ratio may wander as a stationary disturbance of the largest likelihood, so that an error of the ratio
    before the start does not bias the temperatures. Source: disturbance, docs/theory/estimation_statistics.md,
    equation 34.
    """
    track, steps, history = track_of_record(record, model, mesh, time_s)
    point = replace(track, disturbance=most_likely_disturbance(track, steps, history))
    filtered = FilterMarch([point], steps, history).filter()[0]
    nothing, covariance = np.zeros((mesh.nodes, 0)), filtered.covariance[:-1, :-1]
    return Start(time_s, filtered.temperature_K, nothing, covariance_K2=covariance)
