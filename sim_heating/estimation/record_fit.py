"""The fit of one flight record: its march, what its sensors show of it, and the correction for its mesh.

`RecordFit` is one record of a fit: the model of its control point, the start of its march, the samples that are
fitted. Records on common times are marched side by side (`lane_groups`).

A sensor indicates

    indicated = c0 + c1 T' + c2 T'^2 + ...,    T' = gain T(t - skew) + bias + drift t'       (inputs/sensor_model.py)

so that d indicated = (c1 + 2 c2 T' + ...) (gain dT + T dgain + dbias + t' ddrift - gain dT/dt dskew);
docs/theory/estimation_statistics.md, equations 1 and 2. Where a thermocouple lags, T is the temperature of the
thermocouple, and the march is read at its steps as well, since a lag remembers what lies between samples
(`RecordFit.sensed`).

Meshes are of second order. With T_k the temperatures on the mesh whose elements are halved k times,

    T_k + (T_k - T_(k-1)) / 3

is closer to the limit of fine meshes than T_k (Richardson's extrapolation; docs/theory/estimation_statistics.md,
equation 31). A correction T - T_0 that is small is made with k = 1. A larger one is not in the asymptotic range yet,
and elements are halved until the next halving leaves it unchanged. Temperatures at the start that the stack declares
are evaluated again on every mesh: what a coarse one cannot resolve of a profile is part of its error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files import suggestion
from sim_heating.base.kernels.block import LANES, P_SURFACE
from sim_heating.base.kernels.lag import lag_columns, lag_per_constant
from sim_heating.base.parameters import (
    CLOCK_SKEW,
    COMMON_LAG,
    PRESSURE_FACTOR,
    RECORD_PARAMETERS,
    SENSOR,
    SENSOR_PREFIX,
    Parameter,
)
from sim_heating.estimation.inference.likelihood import ReadingIntervals, middle_K, reading_intervals
from sim_heating.estimation.inference.model_error import ModelError
from sim_heating.inputs.points import conditions_of_record, flow_of_record
from sim_heating.inputs.record import Record
from sim_heating.inputs.sensor_model import SensorErrors, indicated_temperature, stated_bias_K
from sim_heating.march.ensemble import condition_history
from sim_heating.march.linearised import Linearised, LinearMarch, Track
from sim_heating.march.point import PointModel
from sim_heating.march.schedule import divided_times
from sim_heating.thermal.frame import NOT_CONTROLLED_K, STEP_TOLERANCE_K
from sim_heating.thermal.mesh import Mesh, halve_elements, interpolate_profile
from sim_heating.thermal.stack import Sensor

LONGEST_STEP_S = 1.0
"""Default limit on the steps of a fit's march [s]."""
LEAST_SIGMA_K = 0.02
"""Least noise [K] of a sensor: no thermocouple is better, and a likelihood needs some."""
# below a tenth of a step the likelihood of a word is that of its interval alone (docs/theory/estimation_statistics.md,
# equation 21)
LEAST_OF_LSB = 0.05
"""Least noise of a sensor over its recorder's step [-]."""
SKEW_SPAN_S = 5.0
"""Bounds of an estimated skew [s]; samples this near the ends of the conditions are then omitted."""
SKEW_SHARE = 0.05
"""Part of the conditions' time that these bounds are at most: a short record has no seconds to spare."""
PRESSURE_STEP = 0.05
"""Step in the logarithm of the surface pressure, to either side, at which the response to it is marched [-]."""
LAG_NAME = ".tau_s"
"""End of the names of time constants of thermocouples."""
SMALL_CORRECTION_K = 1.0
"""Size of a correction [K] below which the first one is accurate to some hundredths of a kelvin."""
SETTLED_K = 0.1
"""Change of a correction [K] from one mesh to the next at which it is accepted."""
# practice record p06 on 8 nodes was 10 K off after one halving and is 0.01 K off with the correction iterated
MOST_HALVINGS = 6


@dataclass(eq=False)
class RecordFit:
    """One record in a fit.

    record     : the flight record
    model      : the point at the values that are not estimated;  mesh : its mesh
    start      : where the march begins; None for the first row of the conditions
    conditions : flight conditions of the record, reference heating included
    march_names  : dotted names of the unknowns of the march;  sensor_names : of clock and sensors
    index      : (unknown of the record,) index of each in the parameter vector: march, start, clock and sensors
    time_s     : (step,) times of the march [s];  sample_s : (sample,) times that are fitted [s]
    channels   : fitted samples by sensor
    sigma_K    : noise [K] by number of the sensor
    correction_K : (sensor, sample) difference [K] of the limit of fine meshes from the march at the thermocouples,
                   which FitProblem.correct_meshes sets
    by_pressure_K : (sensor, sample) response of the thermocouples [K] to the logarithm of the factor on the surface
                   pressure, which `set_pressure_response` sets; 0 where that factor is as the record states it
    mesh_warning : warning about the mesh, or empty
    known_log_likelihood : of readings that are explained without the march and are no samples, such as those of a stuck
                   thermocouple; added to that of the samples
    fixed        : values of parameters of clock and sensors that are not estimated, by dotted name
    model_error  : error of the model that is integrated out of the likelihood; None for none
    flight_names : names of the errors of the flight, where these are unknowns and not integrated out
    """

    record: Record
    model: PointModel
    mesh: Mesh
    start: Start | None
    conditions: Conditions
    march_names: tuple[str, ...]
    sensor_names: tuple[str, ...]
    index: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    time_s: FloatArray = field(default_factory=lambda: np.zeros(0))
    sample_s: FloatArray = field(default_factory=lambda: np.zeros(0))
    channels: list[FittedChannel] = field(default_factory=list)
    sigma_K: dict[int, float] = field(default_factory=dict)
    correction_K: FloatArray | float = 0.0
    by_pressure_K: FloatArray | float = 0.0
    mesh_warning: str = ""
    known_log_likelihood: float = 0.0
    fixed: Mapping[str, float] = field(default_factory=dict)
    model_error: ModelError | None = None
    flight_names: tuple[str, ...] = ()

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all unknowns of the record in the order of `index`: march, start, clock and sensors, flight."""
        of_start = (p.name for p in (self.start.unknowns if self.start else ()))
        return (*self.march_names, *of_start, *self.sensor_names, *self.flight_names)

    @property
    def march_columns(self) -> int:
        """Number of the unknowns that are columns of the march."""
        return len(self.names) - len(self.sensor_names) - len(self.flight_names)

    def values(self, vector: FloatArray) -> dict[str, float]:
        """Values of the record's unknowns, and of what is fixed of its clock and sensors, by dotted name.

        vector  : (parameter,)
        returns : each in its unit ([-] for ratios, [s] for the skew)
        """
        return {**self.fixed, **dict(zip(self.names, vector[self.index], strict=True))}

    def add(self, total: FloatArray, contribution: FloatArray) -> None:
        """Add to a (parameter,) vector or a (parameter, parameter) matrix that of the record's unknowns.

        total : changed in place;  contribution : (unknown of the record,) or (unknown, unknown)
        """
        at = self.index if contribution.ndim == 1 else np.ix_(self.index, self.index)
        if len(set(self.index.tolist())) < len(self.index):  # += would add only one of two unknowns that are tied
            np.add.at(total, at, contribution)
        else:
            total[at] += contribution

    @cached_property
    def error_root_K(self) -> FloatArray | None:
        """(reading, unknown) root of the covariance that the error of the model gives the readings of all channels [K].

        G of docs/theory/model_error.md, equation 1; None without an error.
        """
        error = self.model_error
        if error is None:
            return None
        S, F = self.error_responses_K
        return np.column_stack([error.sigma * S @ error.correlation_root, F])

    @property
    def error_responses_K(self) -> tuple[FloatArray, FloatArray]:
        """(reading, knot) response of all channels to the error of the heating, and (reading, unknown) to all else [K].

        S and F of docs/theory/model_error.md, equation 1, without what is an unknown of the fit.
        """
        assert self.model_error is not None  # asked for with an error only
        responses = [self.model_error.at(c.number, self.sample_s[c.samples]) for c in self.channels]
        S, F = (np.concatenate([r[k] for r in responses]) for k in (0, 1))
        return S, F[:, len(self.flight_names) :]

    def by_flight(self, channel: FittedChannel, values: Mapping[str, float]) -> tuple[FloatArray, FloatArray]:
        """(sample,) what the error of the flight adds to a channel [K], and (sample, unknown) its sensitivities [K].

        values : dotted name -> value, in standard deviations; nothing is added where the error is integrated out

        F f of docs/theory/model_error.md, equation 1.
        """
        count = len(self.flight_names)
        if self.model_error is None or not count:
            return np.zeros(len(channel.samples)), np.zeros((len(channel.samples), 0))
        F = self.model_error.at(channel.number, self.sample_s[channel.samples])[1][:, :count]
        return F @ np.array([values[n] for n in self.flight_names]), F

    @cached_property
    def error_modes(self) -> ErrorModes | None:
        """What the readings see of the error of the model; None without an error.

        R is the noise of the readings, whatever the prediction, so that it is the same for all models of a record.
        Source: docs/theory/model_error.md, equation 3.
        """
        if self.error_root_K is None:
            return None
        scaled = self.error_root_K / self.reading_noise_K[:, np.newaxis]
        variance, modes = np.linalg.eigh(scaled.T @ scaled)
        is_seen = variance > LEAST_SEEN**2
        modes = modes[:, is_seen]
        return ErrorModes(modes, self.error_root_K @ modes, np.sqrt(1.0 + variance[is_seen]))

    @cached_property
    def reading_noise_K(self) -> FloatArray:
        """(reading,) standard deviation of the readings of all channels, rounding included [K].

        Square root of R of docs/theory/model_error.md, equation 1.
        """
        return np.concatenate(
            [
                np.hypot(c.noise_K(self.sigma_K[c.number]), c.sensor.lsb_K / math.sqrt(12.0)) + np.zeros(len(c.samples))
                for c in self.channels
            ]
        )

    @property
    def skew_span_s(self) -> float:
        """By how much the clock may be off [s]: samples this near the ends of the conditions are omitted."""
        if CLOCK_SKEW.name not in self.sensor_names:
            return abs(self.fixed.get(CLOCK_SKEW.name, 0.0))
        return min(SKEW_SPAN_S, SKEW_SHARE * float(self.conditions.time_s[-1] - self.begin_s))

    @property
    def left_out(self) -> dict[str, int]:
        """Numbers of readings of used sensors in the fit segments that are not fitted, by the reason."""
        t, begin, end = self.record.time_s, float(self.conditions.time_s[0]), float(self.conditions.time_s[-1])
        read = np.isfinite(self.record.temperatures_K(self.record.used_sensors)) & self.record.fit_mask()
        outside, early = (t < begin) | (t > end), (t >= begin) & (t < self.begin_s)
        slack = ~outside & ~early & ~np.isin(t, self.sample_s)
        reasons = {"outside the conditions": outside, "before the start": early, "slack of the clock": slack}
        counts = {reason: int(np.count_nonzero(read & mask)) for reason, mask in reasons.items()}
        return {reason: count for reason, count in counts.items() if count}

    def model_at(self, vector: FloatArray) -> PointModel:
        """Model of the point with the parameters of heating and stack at a parameter vector (parameter,)."""
        return self.model.with_parameters(dict(zip(self.march_names, vector[self.index], strict=False)))

    @property
    def begin_s(self) -> float:
        """Time at which the march begins [s]."""
        return float(self.conditions.time_s[0]) if self.start is None else self.start.time_s

    def along(self, flown: Record) -> RecordFit:
        """The record's fit along other conditions, with the samples, steps and mesh that it has.

        flown : the record with these conditions, times in [s]

        Source: docs/theory/model_error.md, equation 2.
        """
        return replace(self, conditions=conditions_of_record(flown, flow_of_record(flown, self.model.effects)))

    def history(self, time_s: FloatArray) -> FloatArray:
        """(1, time, condition) flight conditions at the times of a march [s], as a march takes them."""
        return condition_history(self.conditions.at(time_s))[np.newaxis]

    def divided_times(self, tolerance_K: float = STEP_TOLERANCE_K) -> FloatArray:
        """(step,) times of the march [s] with the ends of the steps into which its error divides its intervals.

        tolerance_K : largest error of a step [K], at the values that are not estimated

        Source: docs/theory/equations_thermal_step.md, section 9.
        """
        if tolerance_K >= NOT_CONTROLLED_K:
            return self.time_s
        # not `track`: the times at which it reads may depend on the steps
        track = Track(self.model, self.mesh, (), np.zeros(0), initial_K=self.initial_K(None))
        return divided_times(track, self.time_s, self.history(self.time_s), tolerance_K)

    def shift_s(self, vector: FloatArray) -> float:
        """Time [s] that is added to the recorded times: recorded T(t) = true T(t - skew), so it is minus the skew.

        Source: docs/theory/clocks_and_starts.md, equation 1.
        """
        return -self.values(vector).get(CLOCK_SKEW.name, 0.0)

    def track(self, vector: FloatArray | None = None, *, sensitive: bool = True) -> Track:
        """Input of the linearised march for this record.

        vector    : (parameter,) for the initial temperatures [K] where the start has unknowns
        sensitive : whether sensitivities to the unknowns are marched as well as temperatures
        """
        names = self.march_names if sensitive else ()
        if self.start is None:
            return Track(self.model, self.mesh, names, self.read_s, at_rest=self.lags)
        columns = self.start.columns if sensitive else None
        return Track(self.model, self.mesh, names, self.read_s, None, self.initial_K(vector), columns)

    @cached_property
    def lags(self) -> bool:
        """Whether a thermocouple of the record lags, or its lag is unknown."""
        names = (*self.sensor_names, *self.fixed)
        return any(s.tau_s > 0.0 for s in self.record.sensors) or any(n.endswith(LAG_NAME) for n in names)

    @cached_property
    def read_s(self) -> FloatArray:
        """(read,) times that the march is read at [s]: the samples, and its steps up to the last of them where a
        thermocouple lags.

        With an unknown skew shifted times stay within a march that begins with a profile, for which steps near its
        beginning are left out; of a march that begins as declared, temperatures before it are those of its beginning,
        and as many steps are read before it as a shift may move into it.
        """
        if not self.lags:
            return self.sample_s
        begin, slack = self.time_s[0], self.skew_span_s
        first = begin + slack if self.start is not None else begin
        steps = self.time_s[(self.time_s >= first) & (self.time_s < self.sample_s[-1])]
        before = 2.0 * begin - self.time_s[(self.time_s > begin) & (self.time_s <= begin + slack)]
        return np.union1d(np.append(steps, before if self.start is None else []), self.sample_s)

    def sensed(self, march: Linearised, vector: FloatArray) -> Sensed:
        """Temperatures of the thermocouples at the samples: the march at their places, behind their lags.

        march  : read at `read_s`, [K], [K/s]
        vector : (parameter,)

        A thermocouple is at the temperature of its place at the first row of the conditions, and on a steady ramp where
        the march begins later. Source: docs/theory/estimation_statistics.md, equation 2a.
        """
        if not self.lags:
            return Sensed(march.temperature_K, march.rate_K_s, march.sensitivity, np.zeros((len(march.rate_K_s), 1)))
        at, values = np.searchsorted(self.read_s, self.sample_s), self.values(vector)
        at_rest = self.start is None
        if at_rest:
            moving = self.read_s + self.shift_s(vector) >= self.time_s[0]
            march = replace(march, rate_K_s=march.rate_K_s * moving)
        channels = [
            _behind_lag(self.read_s, march, i, lag_s(s, values), at_rest) for i, s in enumerate(self.record.sensors)
        ]
        return Sensed(*(np.array([c[k][at] for c in channels]) for k in range(4)))

    def initial_K(self, vector: FloatArray | None) -> FloatArray | None:
        """(node,) temperatures [K] at the start, profile + columns @ unknowns; None for those that the stack declares.

        Source: docs/theory/clocks_and_starts.md, equations 4 and 5.
        """
        if self.start is None:
            return None
        if vector is None or not self.start.unknowns:
            return self.start.profile
        at = self.index[len(self.march_names) : self.march_columns]
        return self.start.profile + self.start.columns @ vector[at]

    def refined_K(self, vector: FloatArray) -> FloatArray | None:
        """(node,) temperatures [K] at the start on the refined mesh; None for those that the stack declares.

        The unknowns of the start change both meshes alike. Needed for docs/theory/estimation_statistics.md,
        equation 31.
        """
        initial, fine = self.initial_K(vector), halve_elements(self.mesh)
        if initial is None or self.start is None:
            return None
        if self.start.refined is None:
            return interpolate_profile(initial, self.mesh, fine)
        # only the change by the unknowns is interpolated; the profile itself is known on the fine mesh
        return self.start.refined + interpolate_profile(initial - self.start.profile, self.mesh, fine)

    def corrected(self, march: Linearised, vector: FloatArray) -> Sensed:
        """`sensed` with the correction for the mesh [K] and the response to the surface pressure [K] added to its
        temperatures; sensitivities are those of the mesh.

        Source: docs/theory/estimation_statistics.md, equations 2b and 31.
        """
        sensed = self.sensed(march, vector)
        added, factor = self.correction_K, self.pressure_factor(vector)
        if not isinstance(self.by_pressure_K, float):
            added = added + self.by_pressure_K * math.log(factor / self.record.pressure_factor[0])
        per_factor = self.by_pressure_K / factor
        return replace(sensed, temperature_K=sensed.temperature_K + added, per_pressure_K=per_factor)

    def pressure_factor(self, vector: FloatArray) -> float:
        """Surface pressure over that of the conditions [-] at a parameter vector (parameter,): as the record knows it
        where it is neither estimated nor fixed.

        Source: docs/theory/estimation_statistics.md, equation 2b.
        """
        return self.values(vector).get(PRESSURE_FACTOR.name, self.record.pressure_factor[0])


LEAST_SEEN = 1e-3
"""Least standard deviation that a direction of the error gives the readings, over their noise, to count [-]."""


class ErrorModes(NamedTuple):
    """Orthogonal directions of the error's unknowns u that the readings see, which are N(0, 1) as u is.

    basis  : (unknown, mode) eigenvectors V of G' R^-1 G [-]
    root_K : (reading, mode) G V [K]
    scale  : (mode,) roots of the eigenvalues of 1 + G' R^-1 G [-]

    G and R of docs/theory/model_error.md, equation 3.
    """

    basis: FloatArray
    root_K: FloatArray
    scale: FloatArray

    @property
    def volume(self) -> float:
        """Minus half the logarithm of the determinant of 1 + G' R^-1 G [-]: docs/theory/model_error.md, equation 3."""
        return -float(np.sum(np.log(self.scale)))

    def all_unknowns(self, seen: FloatArray, score: FloatArray) -> FloatArray:
        """(unknown, ...) u from its values along the modes, (mode, ...), and G' times the score of the readings [-].

        Directions that the readings hardly see follow from the score: what these change in it is of second order.
        """
        return np.asarray(score + self.basis @ (seen - self.basis.T @ score))


def take_error(record_fit: RecordFit, other: RecordFit) -> None:
    """Give a record the error of another fit's model, with its roots where both have the same readings.

    other : over the same or another record; its responses are in [K]

    Roots of docs/theory/model_error.md, equations 1 and 3: they follow from the places and the noise of the readings,
    whatever the model.
    """
    record_fit.model_error = other.model_error
    if other.model_error is None or record_fit.flight_names != other.flight_names:
        return
    places, others = ([(c.number, r.sample_s[c.samples].tolist()) for c in r.channels] for r in (record_fit, other))
    if places == others and np.array_equal(record_fit.reading_noise_K, other.reading_noise_K):
        record_fit.error_root_K, record_fit.error_modes = other.error_root_K, other.error_modes


@dataclass(frozen=True)
class Sensed(Linearised):
    """Temperatures of thermocouples at the samples, behind their lags, and their derivatives.

    per_lag_K_s : (sensor, sample) derivative to the time constant [K/s]; (sensor, 1) zeros where none lags
    per_pressure_K : (sensor, sample) derivative to the factor on the surface pressure [K]; 0 where that is not changed
    """

    per_lag_K_s: FloatArray
    per_pressure_K: FloatArray | float = 0.0


def _behind_lag(
    time_s: FloatArray, march: Linearised, i: int, tau_s: float, at_rest: bool
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(read,) temperature [K], rate [K/s], (read, parameter) sensitivities, and dT/dtau [K/s] of one thermocouple."""
    T, rate = march.temperature_K[i], march.rate_K_s[i]
    # a lag is linear: whatever moves the history of the place goes through it as the history does
    lagging = lag_columns(time_s, np.column_stack([T, rate, march.sensitivity[i]]), tau_s, at_rest)
    per_lag = lag_per_constant(time_s, T, lagging[:, 0], tau_s, at_rest)
    return lagging[:, 0], lagging[:, 1], lagging[:, 2:], per_lag


@dataclass(frozen=True, eq=False)
class Start:
    """Start of a march that does not begin at the first row of the conditions with the declared temperatures.

    time_s   : time [s]
    profile  : (node,) temperatures [K]
    columns  : (node, k) their sensitivities [K] to k unknowns of the start, which `unknowns` defines
    refined  : temperatures [K] on the mesh of twice as many elements, for FitProblem.correct_meshes; by default those
               of the profile between its nodes
    covariance_K2 : (node, node) of the profile [K2], for a fit with process noise; exactly known where None

    Kinds of start: docs/theory/clocks_and_starts.md, equations 2 to 5.
    """

    time_s: float
    profile: FloatArray
    columns: FloatArray
    unknowns: tuple[Parameter, ...] = ()
    refined: FloatArray | None = None
    covariance_K2: FloatArray | None = None


def start_unknowns(count: int) -> tuple[Parameter, ...]:
    """Unknowns `initial.1` ... of a start along as many directions of its temperatures, with mean 0 and sigma 1 [-]."""
    return tuple(
        Parameter(f"initial.{k + 1}", "1", 0.0, 1.0, text="along a direction of the temperatures at the start")
        for k in range(count)
    )


StartMaker = Callable[[Record, PointModel, Mesh], Start]
"""Makes a start for a record, its model and its mesh."""


@dataclass(frozen=True, eq=False)
class FittedChannel:
    """The samples of one sensor that are fitted.

    sensor    : its declaration;  number : its index in the record
    samples   : (sample,) indices in the times that the march reads
    intervals : in which its indications lay [K]
    since_s   : (sample,) time since the first sample of the record [s]
    """

    sensor: Sensor
    number: int
    samples: IntArray
    intervals: ReadingIntervals
    since_s: FloatArray

    @cached_property
    def growing_K(self) -> FloatArray | float:
        """(sample,) random part of the readings that grows with their temperature [K]; 0 where none does.

        Of the reading and not of the prediction: readings then have one noise whatever the model. Source:
        docs/theory/equations.md, section 5.
        """
        if self.sensor.noise_per_K == 0.0:
            return 0.0
        return self.sensor.growing_noise_K(middle_K(self.intervals.lower_K, self.intervals.upper_K))

    def noise_K(self, sigma_K: float) -> FloatArray | float:
        """() or (sample,) standard deviation of the readings [K], with that of the part that does not grow [K].

        Source: docs/theory/equations.md, section 5.
        """
        return sigma_K if self.sensor.noise_per_K == 0.0 else np.hypot(sigma_K, self.growing_K)


@dataclass(frozen=True, eq=False)
class PredictedSamples:
    """Predicted samples of one channel at one parameter vector, for statistics and pictures.

    record_fit, channel : to which they belong
    time_s        : (sample,) recorded times [s]
    mean_K        : (sample,) predicted indication [K]
    sensitivity   : (sample, unknown of the record) of the prediction [K] per unit of each unknown
    unknowns      : number of all unknowns of the fit
    sigma_K       : noise of the sensor that does not grow with temperature [K]
    predicted_sigma_K : standard deviation [K] of mean_K itself, (sample,) where a filter predicts
    """

    record_fit: RecordFit
    channel: FittedChannel
    time_s: FloatArray
    mean_K: FloatArray
    sensitivity: FloatArray
    unknowns: int
    sigma_K: float
    predicted_sigma_K: FloatArray | float = 0.0

    @property
    def spread_K(self) -> FloatArray:
        """() or (sample,) standard deviation [K] of a sample about mean_K: sensor and prediction together.

        Square root of S_i of docs/theory/estimation_statistics.md, equation 32.
        """
        return np.asarray(np.hypot(self.channel.noise_K(self.sigma_K), self.predicted_sigma_K))

    @property
    def jacobian(self) -> FloatArray:
        """(sample, unknown) sensitivities [K] to all unknowns of the fit, 0 to those of other records.

        S_i of docs/theory/estimation_statistics.md, equation 14.
        """
        jacobian = np.zeros((len(self.mean_K), self.unknowns))
        for k, column in enumerate(self.record_fit.index):  # two tied unknowns have one place
            jacobian[:, column] += self.sensitivity[:, k]
        return jacobian


def lane_groups(record_fits: Iterable[RecordFit], shares: int = 1) -> list[list[RecordFit]]:
    """Groups of records on common times and with meshes of one size, LANES records at most in a group.

    shares : groups that each LANES * shares records are dealt out to, so that as many threads are equally busy; most of
             a march with sensitivities is in lanes that each record adds (march/linearised.py)
    """
    groups: dict[tuple[bytes, int], list[RecordFit]] = {}
    for record_fit in record_fits:
        # lanes of a kernel share steps and array sizes
        groups.setdefault((record_fit.time_s.tobytes(), record_fit.mesh.nodes), []).append(record_fit)
    chunks = (g[k : k + LANES * shares] for g in groups.values() for k in range(0, len(g), LANES * shares))
    return [chunk[k::shares] for chunk in chunks for k in range(min(shares, len(chunk)))]


def group_march(group: Sequence[RecordFit]) -> LinearMarch:
    """Linearised march of a group of records on common times, one lane each."""
    # candidates for one record have its conditions in common
    flights = {id(record_fit.conditions): record_fit.conditions for record_fit in group}
    records, time = list(flights), group[0].time_s
    tracks = [replace(record_fit.track(), flight=records.index(id(record_fit.conditions))) for record_fit in group]
    histories = np.stack([condition_history(conditions.at(time)) for conditions in flights.values()])
    return LinearMarch(tracks, time, histories)


def set_parameters(
    march: LinearMarch, group: Sequence[RecordFit], vectors: Sequence[FloatArray]
) -> tuple[list[float], list[FloatArray | None]]:
    """Set the models of a march to parameter vectors, one for each of its records.

    vectors : by record, (parameter,)
    returns : time shifts [s] and initial temperatures [K] (None: as declared), as the march takes them

    Time shift: docs/theory/clocks_and_starts.md, equation 1.
    """
    pairs = list(zip(group, vectors, strict=True))
    march.set_models([record_fit.model_at(v) for record_fit, v in pairs])
    return [record_fit.shift_s(v) for record_fit, v in pairs], [record_fit.initial_K(v) for record_fit, v in pairs]


def marched_from(
    record: Record, model: PointModel, begin_s: float, end_s: float, profile: FloatArray | None
) -> tuple[Record, PointModel]:
    """A record and a model whose march goes from one time to another.

    begin_s, end_s : [s], within the conditions
    profile        : (node, 2) depth [m] and temperature [K] at its beginning; None for what the stack declares
    """
    marched = replace(record, conditions=record.conditions.at(march_times(record.conditions, begin_s, end_s)))
    if profile is not None:
        initial = {"initial": "profile", "initial_profile": profile.tolist()}
        stack = model.construction.stack.model_copy(update=initial)
        model = replace(model, construction=model.construction.model_copy(update={"stack": stack}))
    return marched, model


def march_times(
    conditions: Conditions, begin_s: float, end_s: float, longest_step_s: float = LONGEST_STEP_S
) -> FloatArray:
    """(step,) times [s] of a march, from begin_s to the first sample of the conditions at or after end_s.

    conditions     : all of their samples in between are steps, as conditions are linear only between samples
    longest_step_s : longer intervals are divided evenly into steps no longer than this [s]
    """
    flown = conditions.time_s
    last = min(int(np.searchsorted(flown, end_s)), len(flown) - 1)
    knots = np.union1d(flown[(flown >= begin_s) & (flown <= flown[last])], [begin_s])
    span = np.diff(knots)
    # 1e-9: an interval of the longest step exactly, but for rounding, is one step
    pieces = np.ceil(span / longest_step_s - 1e-9).astype(int)
    first = np.repeat(np.cumsum(pieces) - pieces, pieces)
    into_interval = (np.arange(pieces.sum()) - first) * np.repeat(span / pieces, pieces)
    return np.append(np.repeat(knots[:-1], pieces) + into_interval, knots[-1])


# What the sensors show ------------------------------------------------------------------------------------------------


def fitted_channels(record: Record, time_s: FloatArray, mask: NDArray[np.bool_]) -> list[FittedChannel]:
    """The used sensors of a record with their samples that are fitted.

    time_s  : (read,) times that the march reads [s]
    mask    : (sample,) which of the record's samples are fitted
    returns : one channel for each used sensor with a reading; lost readings are omitted

    Intervals of recorder words: docs/theory/estimation_statistics.md, equation 4.
    """
    channels = []
    for number, sensor in enumerate(record.sensors):
        reading = record.thermocouples[sensor.column]
        fitted = mask & np.isfinite(reading)
        if sensor.used and np.any(fitted):
            indices = np.searchsorted(time_s, record.time_s[fitted])
            read, since_s = reading_intervals(sensor, reading[fitted]), record.time_s[fitted] - record.time_s[0]
            channels.append(FittedChannel(sensor, number, indices, read, since_s))
    return channels


def indications(
    channel: FittedChannel, march: Sensed, names: Sequence[str], values: Mapping[str, float], march_columns: int
) -> tuple[FloatArray, FloatArray]:
    """Indications of a channel and their sensitivities to the parameters.

        indicated = c0 + c1 T' + ...,   T' = gain T(t - skew) + bias + drift t'

    march   : temperatures of the thermocouples [K], sensitivities and rates [K/s]
    names   : (parameter,) of the record: first the columns of the march, then clock and sensors
    values  : dotted name -> value
    march_columns : number of columns of the march that are read
    returns : (sample,) indications [K]; (sample, parameter) sensitivities [K] per unit of each parameter

    The march already reads T at t - skew. Source: docs/theory/estimation_statistics.md, equations 1 and 2.
    """
    sensor, errors = channel.sensor, sensor_errors(channel.sensor, values)
    T = march.temperature_K[channel.number, channel.samples]
    jacobian = np.zeros((len(T), len(names)))
    np.multiply(
        march.sensitivity[channel.number, channel.samples, :march_columns], errors.gain, out=jacobian[:, :march_columns]
    )
    for k, name in enumerate(names[march_columns:], start=march_columns):
        if name == CLOCK_SKEW.name:
            jacobian[:, k] = -errors.gain * march.rate_K_s[channel.number, channel.samples]
        elif name == sensor_parameter(sensor, "bias"):
            jacobian[:, k] = 1.0
        elif name == sensor_parameter(sensor, "gain"):
            jacobian[:, k] = T
        elif name == sensor_parameter(sensor, "drift"):
            jacobian[:, k] = channel.since_s
        elif name in (COMMON_LAG.name, sensor_parameter(sensor, "tau_s")):
            jacobian[:, k] = errors.gain * march.per_lag_K_s[channel.number, channel.samples]
        elif name == PRESSURE_FACTOR.name and not isinstance(march.per_pressure_K, float):
            jacobian[:, k] = errors.gain * march.per_pressure_K[channel.number, channel.samples]
    # most sensors have no curve: this saves a polynomial for every sample of every evaluation
    wrong = errors.gain * T + errors.bias_K + errors.drift_K_s * channel.since_s
    if sensor.calibration is None:
        return wrong, jacobian
    slope = np.polynomial.Polynomial(sensor.calibration).deriv()(wrong)
    return indicated_temperature(sensor, T, errors, channel.since_s), slope[:, np.newaxis] * jacobian


def sensor_errors(sensor: Sensor, values: Mapping[str, float]) -> SensorErrors:
    """Errors of a sensor at parameter values; the declared bias and lag, drift 0, gain 1 where these lack them.

    values : dotted name -> value

    Used in docs/theory/estimation_statistics.md, equation 1.
    """
    gain, drift = (values.get(sensor_parameter(sensor, kind), SENSOR[kind].value) for kind in ("gain", "drift"))
    bias_K = values.get(sensor_parameter(sensor, "bias"), stated_bias_K(sensor))
    return SensorErrors(bias_K, gain, lag_s(sensor, values), drift)


def lag_s(sensor: Sensor, values: Mapping[str, float]) -> float:
    """Time constant of a sensor [s] at parameter values: its own or the declared one, and that of all in common.

    values : dotted name -> value

    Tau of docs/theory/estimation_statistics.md, equation 2a.
    """
    return values.get(sensor_parameter(sensor, "tau_s"), sensor.tau_s) + values.get(COMMON_LAG.name, 0.0)


def sensor_parameter(sensor: Sensor, kind: str) -> str:
    """Dotted name of a parameter of a sensor, as `sensor.NAME.bias` [K]; the others are those of parameters.SENSOR.

    Parameters b, g and tau of docs/theory/estimation_statistics.md, equation 1.
    """
    return f"{SENSOR_PREFIX}{sensor.name}.{kind}"


def parameter_definition(record: Record, model: PointModel, name: str) -> Parameter:
    """Definition of a parameter of a record's clock or sensors, or of the model of its point, by its dotted name.

    returns : prior, bounds and unit
    raises  : InputError for a name that neither of them has
    """
    return sensor_definition(record, name) or model.definition(name)


def sensor_definition(record: Record, name: str) -> Parameter | None:
    """Definition of a parameter of a clock or sensor by its dotted name; None for any other name.

    returns : prior, bounds and unit (skew [s], bias [K], gain [-], lag [s], drift [K/s])
    raises  : InputError where the record has no such sensor, or a sensor no such parameter

    Parameters s, b and g of docs/theory/estimation_statistics.md, equation 1.
    """
    if name == PRESSURE_FACTOR.name:
        mean, sigma = record.pressure_factor
        return replace(PRESSURE_FACTOR, value=mean, sigma=sigma)
    if name in RECORD_PARAMETERS:
        return RECORD_PARAMETERS[name]
    if not name.startswith(SENSOR_PREFIX):
        return None
    sensor, _, kind = name.removeprefix(SENSOR_PREFIX).rpartition(".")
    by_name = {s.name: s for s in record.used_sensors}
    if sensor not in by_name:
        raise InputError(f"{record.name}: `{name}`: unknown or unused sensor `{sensor}`{suggestion(sensor, by_name)}")
    if kind not in SENSOR:
        raise InputError(f"{record.name}: `{name}`: unknown sensor parameter `{kind}`{suggestion(kind, SENSOR)}")
    return error_definition(by_name[sensor], kind)


def error_definition(sensor: Sensor, kind: str) -> Parameter:
    """Definition of an error of a sensor; what the sensor states is its value, and the mean of its prior.

    kind : `bias` [K], `gain` [-], `tau_s` [s] or `drift` [K/s]

    Parameters b, g and tau of docs/theory/estimation_statistics.md, equation 1.
    """
    if kind == "tau_s":
        return replace(SENSOR[kind], value=sensor.tau_s)
    if kind == "bias" and sensor.bias_prior_K is not None:
        mean_K, sigma_K = sensor.bias_prior_K
        return replace(SENSOR[kind], value=mean_K, sigma=sigma_K)
    return SENSOR[kind]


def least_sigma_K(sensor: Sensor) -> float:
    """The least noise [K] that is assumed for a sensor: 0.02 K, or 0.05 of its recorder's step.

    A modelling choice of this program: below it the likelihood of docs/theory/estimation_statistics.md, equation 5,
    becomes that of an interval without noise, whose score is not smooth.
    """
    return max(LEAST_SIGMA_K, LEAST_OF_LSB * sensor.lsb_K)


# Correction for the mesh ----------------------------------------------------------------------------------------------


def correct_mesh(record_fit: RecordFit, vector: FloatArray) -> None:
    """Set the mesh correction of a record and the warning about it, at a parameter vector.

    record_fit : its correction_K becomes (sensor, sample) [K], 0 where none can be found
    vector     : (parameter,) values at which the error is evaluated; its change with the parameters is neglected

    A correction of 1 [K] or more, or one that could not be found, leaves a warning in mesh_warning.
    Source: docs/theory/estimation_statistics.md, equation 31.
    """
    mesh = f"{record_fit.record.name}: the mesh of {record_fit.mesh.nodes} nodes"
    finer = "remove `nodes` from [stack], or increase it"
    record_fit.correction_K, record_fit.mesh_warning = 0.0, ""
    try:
        record_fit.correction_K = mesh_error_K(record_fit, vector)
    except RunError as error:
        record_fit.mesh_warning = f"{mesh} could not be corrected; predictions keep its error ({error}); {finer}"
        return
    worst = float(np.max(np.abs(record_fit.correction_K)))
    if worst >= SMALL_CORRECTION_K:
        record_fit.mesh_warning = (
            f"{mesh} has errors of up to {worst:.1f} K; predictions are corrected, their sensitivities to the "
            f"parameters are not; {finer}"
        )


def mesh_error_K(record_fit: RecordFit, vector: FloatArray) -> FloatArray:
    """Correction that the limit of fine meshes adds to the march of a record, by Richardson's extrapolation.

        T_k - T_0 + (T_k - T_(k-1)) / 3,   k = 1 where that is below 1 K

    vector  : (parameter,) values
    returns : (sensor, sample) [K]
    raises  : RunError where a refined mesh cannot be marched, or the correction still changes by 0.1 [K] after six
              halvings

    Second order holds for smooth solutions. Source: docs/theory/estimation_statistics.md, equation 31.
    """
    fine, initial = halve_elements(record_fit.mesh), record_fit.refined_K(vector)
    coarse, refined = _temperatures_K(
        record_fit, vector, [(record_fit.mesh, record_fit.initial_K(vector)), (fine, initial)]
    )
    # T_1 - T_0 + (T_1 - T_0) / 3
    error = 4.0 / 3.0 * (refined - coarse)
    for _ in range(1, MOST_HALVINGS):
        # a larger correction is outside the range in which the error falls to a quarter with each halving
        if np.max(np.abs(error)) < SMALL_CORRECTION_K:
            return error
        finer = halve_elements(fine)
        initial, fine, last = None if initial is None else interpolate_profile(initial, fine, finer), finer, refined
        (refined,) = _temperatures_K(record_fit, vector, [(fine, initial)])
        before, error = error, refined - coarse + (refined - last) / 3.0
        if np.max(np.abs(error - before)) < SETTLED_K:
            return error
    raise RunError(f"after {MOST_HALVINGS} halvings of the elements it still changes by more than {SETTLED_K:g} K")


def set_pressure_response(record_fit: RecordFit, vector: FloatArray) -> None:
    """Set the response of a record's thermocouples to its surface pressure, where a fit changes that.

        dT / d ln f = [T(e^h p) - T(e^-h p)] / 2h,   h = 0.05

    vector : (parameter,) values at which it is marched; its change with the parameters is neglected
    raises : RunError where a march failed

    Conductivities are linear in the logarithm of the pressure. Source: docs/theory/estimation_statistics.md,
    equation 2b.
    """
    if PRESSURE_FACTOR.name not in (*record_fit.sensor_names, *record_fit.fixed):
        return
    # start and clock are as they are: only the march from there on depends on the pressure
    track, history = record_fit.track(vector, sensitive=False), record_fit.history(record_fit.time_s)[0]
    sides = np.stack([history, history])
    sides[:, :, P_SURFACE] *= np.exp([[PRESSURE_STEP], [-PRESSURE_STEP]])
    march = LinearMarch([replace(track, flight=k) for k in range(2)], record_fit.time_s, sides)
    high, low = (record_fit.sensed(m, vector) for m in march.march([record_fit.shift_s(vector)] * 2))
    record_fit.by_pressure_K = (high.temperature_K - low.temperature_K) / (2.0 * PRESSURE_STEP)


def _temperatures_K(
    record_fit: RecordFit, vector: FloatArray, meshes: Sequence[tuple[Mesh, FloatArray | None]]
) -> list[FloatArray]:
    """(sensor, sample) temperatures [K] of the thermocouples on each mesh, from its paired initial temperatures [K]."""
    at_rest = record_fit.start is None and record_fit.lags
    tracks = [
        Track(record_fit.model_at(vector), mesh, (), record_fit.read_s, initial_K=initial, at_rest=at_rest)
        for mesh, initial in meshes
    ]
    history = record_fit.history(record_fit.time_s)
    marched = LinearMarch(tracks, record_fit.time_s, history).march([record_fit.shift_s(vector)] * len(tracks))
    return [record_fit.sensed(f, vector).temperature_K for f in marched]
