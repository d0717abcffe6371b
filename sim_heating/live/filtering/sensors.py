"""Sensors of all points of a link: their readings as the filter takes them, and what they ought to show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain
from typing import NamedTuple

import numpy as np

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.base.kernels.block import LANES
from sim_heating.base.parameters import CLOCK_SKEW, SENSOR, SENSOR_PREFIX
from sim_heating.estimation.filter.lagging import Lagging, LaggingFilter
from sim_heating.estimation.filter.online import OnlineFilter, PointEstimate, PointReadings
from sim_heating.estimation.filter.records import UNDECLARED_SIGMA_K, calibration_line, direct_terms
from sim_heating.estimation.inference.likelihood import word_intervals
from sim_heating.estimation.record_fit import least_sigma_K, sensor_errors
from sim_heating.live.filtering.estimates import SensorEstimate
from sim_heating.live.filtering.parameters import is_of_march
from sim_heating.live.filtering.points import LivePoint
from sim_heating.live.filtering.timeline import Word
from sim_heating.thermal.stack import Sensor


@dataclass
class LeftOut:
    """Times [s] from which on, and to which, a sensor is left out."""

    spans: list[tuple[float, float]] = field(default_factory=list)

    def covers(self, time_s: float) -> bool:
        return any(begin <= time_s <= end for begin, end in self.spans)


class Recorders(NamedTuple):
    """(sensor,) foot of the range and step of each recorder [K], and its largest count [-]; nan where there is none."""

    foot_K: FloatArray
    lsb_K: FloatArray
    largest_count: FloatArray


def _noise(sensor: Sensor) -> tuple[float, float]:
    """Standard deviation of the noise of a sensor [K], and its part that grows with the reading [-]."""
    return max(sensor.noise_sigma_K or UNDECLARED_SIGMA_K, least_sigma_K(sensor)), sensor.noise_per_K


def _recorder(sensor: Sensor) -> tuple[float, float, float]:
    """Foot of the range and step of a sensor's recorder [K], and its largest count [-]; nan where it has none."""
    if sensor.bits is None or sensor.range_K is None:
        return np.nan, np.nan, np.nan
    return sensor.range_K[0], sensor.lsb_K, 2.0**sensor.bits - 1.0


class SensorTable:
    """Sensors of all points by number, and what their readings are to the filter."""

    def __init__(self, points: Sequence[LivePoint], names: Sequence[str]) -> None:
        self.point_and_name = [(p.name, s.name) for p in points for s in p.sensors]
        self.numbers = {key: n for n, key in enumerate(self.point_and_name)}
        of_points = [p.sensors for p in points]
        self.sensors = list(chain.from_iterable(of_points))
        self.point = np.repeat(np.arange(len(points)), list(map(len, of_points)))
        self.node = np.array(list(chain.from_iterable(p.mesh.sensors for p in points)), dtype=np.int64)
        self.sigma_K, self.per_K = np.array([_noise(s) for s in self.sensors]).reshape(-1, 2).T.copy()
        recorders = np.array([_recorder(s) for s in self.sensors]).reshape(-1, 3)
        self.recorders = Recorders(*recorders.T.copy())
        self.of_point = [np.flatnonzero(self.point == k).tolist() for k in range(len(points))]
        self.names = [self._names_of(p, names) for p in points]
        self._begun: dict[int, float] = {}

    @cached_property
    def tau_s(self) -> FloatArray:
        """(sensor,) time constants [s]."""
        return np.array([s.tau_s for s in self.sensors])

    @cached_property
    def curved(self) -> list[int]:
        """Numbers of the sensors with a calibration."""
        return [n for n, s in enumerate(self.sensors) if s.calibration is not None]

    @cached_property
    def used(self) -> BoolArray:
        """(sensor,) whether a sensor is used."""
        return np.array([s.used for s in self.sensors])

    @cached_property
    def _terms(self) -> list[FloatArray]:
        """(parameter, 3) direct terms of a reading in each parameter, an array for each sensor (`direct_terms`)."""
        return [
            direct_terms(s, self.names[i], np.ones(1), 1.0, np.zeros(1), np.ones(1))[0]
            for i, s in zip(self.point, self.sensors, strict=True)
        ]

    @cached_property
    def _any_terms(self) -> bool:
        """Whether an error of a sensor of its own is estimated."""
        return any(np.any(t) for t in self._terms)

    @cached_property
    def _are_plain(self) -> bool:
        """Whether each sensor shows the temperature of its node."""
        return not (self._any_terms or self.curved or np.any(self.tau_s))

    @staticmethod
    def _names_of(point: LivePoint, names: Sequence[str]) -> tuple[str, ...]:
        """Parameters of a point: those of its march, then those of its own sensors and of the clock."""
        of_sensors = {f"{SENSOR_PREFIX}{s.name}.{kind}" for s in point.sensors for kind in SENSOR} | {CLOCK_SKEW.name}
        march = tuple(n for n in names if is_of_march(n))
        return march + tuple(n for n in names if n in of_sensors)

    def lagging(self, first: int) -> Lagging:
        """Sensors that lag among the points of one filter, which begins with point number `first`."""
        numbers = np.flatnonzero((self.point >= first) & (self.point < first + LANES) & (self.tau_s > 0.0))
        return Lagging(numbers, self.point[numbers] - first, self.node[numbers], self.tau_s[numbers])

    def readings(self, rows: FloatArray, filters: Sequence[OnlineFilter], out: Sequence[LeftOut]) -> PointReadings:
        """Readings of the points of all filters as these take them, with what is estimated of the sensors' own errors.

        rows    : (reading, 4) time [s], number of the sensor, value [K], 1 where it may be a spike
        filters : of LANES points each;  out : times at which each sensor is left out
        """
        number, t, value = rows[:, 1].astype(np.int64), rows[:, 0], rows[:, 2]
        skipped = ~self.used[number]
        if any(o.spans for o in out):
            skipped |= np.array([out[n].covers(w) for n, w in zip(number, t, strict=True)], dtype=bool)
        lower, upper = word_intervals(value, *(column[number] for column in self.recorders))
        gain, bias = np.ones(len(t)), np.zeros(len(t))
        direct = np.zeros((len(t), max(f.most_parameters for f in filters), 3))
        for n in self.curved:
            at = number == n
            if np.any(at):
                gain[at], bias[at] = calibration_line(self.sensors[n], value[at])
        if self._any_terms:
            for q, n in enumerate(number):
                self._add_terms(q, int(n), t[q], filters, gain, bias, direct)
        lower = np.where(skipped, np.nan, lower)
        point, node = self.point[number], self.node[number]
        variance = self.sigma_K[number] ** 2 + np.nan_to_num(self.per_K[number] * value) ** 2
        return PointReadings(point, t, node, lower, upper, variance, gain, bias, direct)

    def _add_terms(
        self,
        q: int,
        n: int,
        t: float,
        filters: Sequence[OnlineFilter],
        gain: FloatArray,
        bias: FloatArray,
        direct: FloatArray,
    ) -> None:
        """Add the sensor's own errors, where these are estimated, to a reading."""
        slope, since = gain[q], t - self._begun.setdefault(n, t)
        k, point = divmod(int(self.point[n]), LANES)
        wrong = sensor_errors(self.sensors[n], filters[k].parameters(point))
        bias[q] += slope * (wrong.bias_K + wrong.drift_K_s * since)
        gain[q] = slope * wrong.gain
        terms = slope * self._terms[n]
        drifts = np.array([name.endswith(".drift") for name in self.names[self.point[n]]], dtype=bool)
        terms[drifts] *= since
        direct[q, : len(terms)] = terms

    def first_readings(self, readings: Sequence[Word]) -> dict[int, float]:
        """First reading of each used sensor as a temperature [K], by its number. Later ones may be much hotter."""
        first: dict[int, float] = {}
        for _, n, value in readings:
            if self.used[n] and n not in first:
                first[n] = value
        for n, value in first.items():
            if n in self.curved:
                slope, constant = calibration_line(self.sensors[n], np.array([value]))
                first[n] = float((value - constant[0]) / slope[0])
        return first

    def predicted(self, i: int, point: LivePoint, state: PointEstimate, f: OnlineFilter) -> dict[str, SensorEstimate]:
        """What each sensor of a point ought to show, with its standard deviation; f : filter of the point."""
        estimates = {}
        if self._are_plain:
            nodes = list(point.mesh.sensors)
            T_K, of_point = state.temperature_K[nodes], self.of_point[i]
            noise = np.hypot(self.sigma_K[of_point], self.per_K[of_point] * T_K)
            sigma = np.hypot(state.sigma_K[nodes], noise).tolist()
            pairs = zip(point.sensors, T_K.tolist(), sigma, strict=True)
            return {sensor.name: SensorEstimate(T, sigma_K) for sensor, T, sigma_K in pairs}
        values = dict(zip(state.names, state.values.tolist(), strict=True))
        for k, (n, sensor) in enumerate(zip(self.of_point[i], point.sensors, strict=True)):
            node = point.mesh.sensors[k]
            T, wrong = float(state.temperature_K[node]), sensor_errors(sensor, values)
            per_T = state.sensitivity[node]
            if isinstance(f, LaggingFilter) and self.tau_s[n] > 0.0:
                offset_K, per_offset = f.offset_of(n, state.values)
                T, per_T = T + offset_K, per_T + per_offset
            mean, slope = wrong.gain * T + wrong.bias_K, 1.0
            mean += wrong.drift_K_s * (state.time_s - self._begun.get(n, state.time_s))
            if sensor.calibration is not None:
                curve = np.polynomial.Polynomial(sensor.calibration)
                mean, slope = float(curve(mean)), float(curve.deriv()(mean))
            variance = float(state.sigma_K[node]) ** 2
            if self._any_terms or self.tau_s[n] > 0.0:
                terms = self._terms[n]
                row = wrong.gain * per_T + terms[:, 0] + terms[:, 1] * T
                variance = float(row @ state.covariance @ row)
                variance += wrong.gain**2 * float(state.state_covariance[node, node])
            noise_K2 = float(self.sigma_K[n] ** 2 + (self.per_K[n] * mean) ** 2)
            estimates[sensor.name] = SensorEstimate(mean, math.sqrt(slope**2 * variance + noise_K2))
        return estimates
