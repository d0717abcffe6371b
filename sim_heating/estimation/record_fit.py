"""One record in a fit: start of its march, the samples that are read, and grouping of records marched side by side.

Indications of the sensors of a record for given temperatures, and their sensitivity to every parameter.

    indicated = c0 + c1 T' + c2 T'^2 + ...,    T' = gain T(t - skew) + bias        (inputs/sensor_model.py)

so that d indicated = (c1 + 2 c2 T' + ...) (gain dT + T dgain + dbias - gain dT/dt dskew);
docs/estimation_statistics.md, equations 1 and 2.

The discretisation error of a mesh at the sensors, and its removal from the predictions of a fit.

Meshes are of second order: with T_k the temperatures on the mesh whose elements are halved k times,

    T_k + (T_k - T_(k-1)) / 3

is closer to the limit of fine meshes than T_k (Richardson's extrapolation; docs/estimation_statistics.md, equation 31).
A correction T - T_0 that is small is made with k = 1; a larger one is not in the asymptotic range yet, and elements are
halved until the next halving leaves it unchanged. Temperatures at the start that the stack declares are evaluated again
on every mesh: what a coarse one cannot resolve of a profile is part of its error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files import suggestion
from sim_heating.base.kernels.block import LANES
from sim_heating.base.parameters import CLOCK_SKEW, SENSOR, SENSOR_PREFIX, Parameter
from sim_heating.estimation.inference.likelihood import ReadingIntervals, reading_intervals
from sim_heating.inputs.record import Record
from sim_heating.inputs.sensor_model import SensorErrors, calibrated
from sim_heating.march.ensemble import condition_history
from sim_heating.march.linearised import Linearised, LinearMarch, Track
from sim_heating.march.point import PointModel, initial_temperatures
from sim_heating.thermal.mesh import Mesh, on_mesh, refined
from sim_heating.thermal.stack import Sensor

LONGEST_STEP_S = 1.0
"""Default limit on the steps of a fit's march [s]."""


@dataclass(frozen=True, eq=False)
class Start:
    """Start of a march that does not begin at the first row of the conditions with the declared temperatures.

    time_s   : time [s]
    profile  : (node,) temperatures [K]
    columns  : (node, k) their sensitivities [K] to k unknowns of the start, which `unknowns` defines
    refined  : temperatures [K] on the mesh of twice as many elements, for Problem.correct_meshes; by default those of
               the profile between its nodes
    covariance_K2 : (node, node) of the profile [K2], for a fit with noise of the process; exactly known where None

    Kinds of start: docs/clocks_and_starts.md, equations 2 to 5.
    """

    time_s: float
    profile: FloatArray
    columns: FloatArray
    unknowns: tuple[Parameter, ...] = ()
    refined: FloatArray | None = None
    covariance_K2: FloatArray | None = None


StartMaker = Callable[[Record, PointModel, Mesh], Start]
"""Makes a start for a record, its model and its mesh."""


@dataclass(frozen=True, eq=False)
class PredictedSamples:
    """One channel at one parameter vector, for statistics and pictures.

    part, channel : to which it belongs
    time_s        : (sample,) recorded times [s]
    mean_K        : (sample,) predicted indication [K]
    own           : (sample, unknown of the part) its sensitivities [K] per unit of each unknown
    unknowns      : number of all unknowns
    sigma_K       : noise of the sensor [K]
    predicted_sigma_K : standard deviation [K] of mean_K itself, (sample,) where a filter predicts
    """

    part: RecordFit
    channel: FittedChannel
    time_s: FloatArray
    mean_K: FloatArray
    own: FloatArray
    unknowns: int
    sigma_K: float
    predicted_sigma_K: FloatArray | float = 0.0

    @property
    def spread_K(self) -> FloatArray:
        """() or (sample,) standard deviation [K] of a sample about mean_K: sensor and prediction together.

        Square root of S_i of docs/estimation_statistics.md, equation 32.
        """
        return np.asarray(np.hypot(self.sigma_K, self.predicted_sigma_K))

    @property
    def jacobian(self) -> FloatArray:
        """(sample, unknown) sensitivities [K] to all unknowns of the fit, 0 to those of other parts.

        S_i of docs/estimation_statistics.md, equation 14.
        """
        whole = np.zeros((len(self.mean_K), self.unknowns))
        whole[:, self.part.index] = self.own
        return whole


@dataclass(eq=False)
class RecordFit:
    """One record in a fit.

    record     : the flight record
    model      : the point at the values that are not estimated;  mesh : its mesh
    start      : where the march begins; None for the first row of the conditions
    conditions : flight conditions of the record, reference heating included
    marched, other : dotted names of the unknowns of the march, and of clock and sensors
    index      : (unknown of the part,) place of each in the parameter vector: marched, start, other
    time_s     : (step,) times of the march [s];  sample_s : (sample,) times that are read [s]
    channels   : fitted samples by sensor
    sigma_K    : noise [K] by number of the sensor
    correction_K : (sensor, sample) difference [K] of the limit of fine meshes from the march (Problem.correct_meshes)
    mesh_told  : warning about the mesh, or empty
    """

    record: Record
    model: PointModel
    mesh: Mesh
    start: Start | None
    conditions: Conditions
    marched: tuple[str, ...]
    other: tuple[str, ...]
    index: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    time_s: FloatArray = field(default_factory=lambda: np.zeros(0))
    sample_s: FloatArray = field(default_factory=lambda: np.zeros(0))
    channels: list[FittedChannel] = field(default_factory=list)
    sigma_K: dict[int, float] = field(default_factory=dict)
    correction_K: FloatArray | float = 0.0
    mesh_told: str = ""

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all unknowns of the part in the order of `index`: march, start, clock and sensors."""
        return (*self.marched, *(p.name for p in (self.start.unknowns if self.start else ())), *self.other)

    @property
    def read(self) -> int:
        """Number of the unknowns that are columns of the march."""
        return len(self.names) - len(self.other)

    def values(self, vector: FloatArray) -> dict[str, float]:
        """Values of the part's unknowns by their dotted names, each in its unit ([-] for ratios, [s] for the skew)."""
        return dict(zip(self.names, vector[self.index], strict=True))

    def with_parameters(self, vector: FloatArray) -> PointModel:
        """Model of the point with the parameters of heating and stack at a parameter vector (parameter,)."""
        return self.model.with_parameters(dict(zip(self.marched, vector[self.index], strict=False)))

    def shift_s(self, vector: FloatArray) -> float:
        """Time [s] that is added to the recorded times: recorded T(t) = true T(t - skew), so it is minus the skew.

        Source: docs/clocks_and_starts.md, equation 1.
        """
        return -self.values(vector).get(CLOCK_SKEW.name, 0.0)

    def track(self, vector: FloatArray | None = None, *, sensitive: bool = True) -> Track:
        """Input of the linearised march for this part.

        vector    : (parameter,) for the initial temperatures [K] where the start has unknowns
        sensitive : whether sensitivities to the unknowns are marched as well as temperatures
        """
        names = self.marched if sensitive else ()
        if self.start is None:
            return Track(self.model, self.mesh, names, self.sample_s)
        columns = self.start.columns if sensitive else None
        return Track(self.model, self.mesh, names, self.sample_s, None, self.initial_K(vector), columns)

    def initial_K(self, vector: FloatArray | None) -> FloatArray | None:
        """(node,) temperatures [K] at the start, profile + columns @ unknowns; None for those that the stack declares.

        Source: docs/clocks_and_starts.md, equations 4 and 5.
        """
        if self.start is None:
            return None
        if vector is None or not self.start.unknowns:
            return self.start.profile
        at = self.index[len(self.marched) : self.read]
        return self.start.profile + self.start.columns @ vector[at]

    def refined_K(self, vector: FloatArray) -> FloatArray | None:
        """(node,) temperatures [K] at the start on the refined mesh; None for those that the stack declares.

        The unknowns of the start move both meshes alike. Needed for docs/estimation_statistics.md, equation 31.
        """
        initial, fine = self.initial_K(vector), refined(self.mesh)
        if initial is None or self.start is None:
            return None
        if self.start.refined is None:
            return on_mesh(initial, self.mesh, fine)
        # only the change by the unknowns is interpolated; the profile itself is known on the fine mesh
        return self.start.refined + on_mesh(initial - self.start.profile, self.mesh, fine)

    def corrected(self, found: Linearised) -> Linearised:
        """March with the error of its mesh [K] taken out; sensitivities stay those of the mesh.

        Source: docs/estimation_statistics.md, equation 31.
        """
        return replace(found, temperature_K=found.temperature_K + self.correction_K)


def lane_groups(parts: Iterable[RecordFit]) -> list[list[RecordFit]]:
    """Groups of parts on common times and with meshes of one size, LANES parts at most in a group."""
    alike: dict[tuple[bytes, int], list[RecordFit]] = {}
    for part in parts:
        # lanes of a kernel share steps and array sizes
        alike.setdefault((part.time_s.tobytes(), part.mesh.nodes), []).append(part)
    return [group[k : k + LANES] for group in alike.values() for k in range(0, len(group), LANES)]


def group_march(group: Sequence[RecordFit]) -> LinearMarch:
    """Linearised march of a group of parts on common times, one lane each."""
    tracks = [replace(part.track(), flight=i) for i, part in enumerate(group)]
    time = group[0].time_s
    histories = np.stack([condition_history(part.conditions.at(time)) for part in group])
    return LinearMarch(tracks, time, histories)


def set_parameters(
    march: LinearMarch, group: Sequence[RecordFit], vectors: Sequence[FloatArray]
) -> tuple[list[float], list[FloatArray | None]]:
    """Set the models of a march to parameter vectors, one for each of its parts.

    vectors : by part, (parameter,)
    returns : time shifts [s] and initial temperatures [K] (None: as declared), as the march takes them

    Time shift: docs/clocks_and_starts.md, equation 1.
    """
    of_parts = list(zip(group, vectors, strict=True))
    march.set_models([part.with_parameters(v) for part, v in of_parts])
    return [part.shift_s(v) for part, v in of_parts], [part.initial_K(v) for part, v in of_parts]


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
    within = (np.arange(pieces.sum()) - first) * np.repeat(span / pieces, pieces)
    return np.append(np.repeat(knots[:-1], pieces) + within, knots[-1])


def declared_profile(part: RecordFit) -> FloatArray:
    """(node,) temperatures [K] that the stack of a part declares."""
    return initial_temperatures(part.model.construction, part.mesh)


LEAST_SIGMA_K = 0.02
"""Least noise [K] of a sensor: no thermocouple is better, and a likelihood needs some."""
LEAST_OF_LSB = 0.05
"""Least noise of a sensor over its recorder's step [-]."""


@dataclass(frozen=True, eq=False)
class FittedChannel:
    """The samples of one sensor that are fitted.

    sensor   : its declaration;  number : its place in the record
    samples  : (sample,) places in the times that the march reads
    observed : intervals [K] in which its indications lay
    """

    sensor: Sensor
    number: int
    samples: IntArray
    observed: ReadingIntervals


def fitted_channels(record: Record, time_s: FloatArray, chosen: NDArray[np.bool_]) -> list[FittedChannel]:
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
            found.append(FittedChannel(sensor, number, places, reading_intervals(sensor, read[mine])))
    return found


def least_sigma_K(sensor: Sensor) -> float:
    """The least noise [K] that is assumed for a sensor: 0.02 K, or 0.05 of its recorder's step.

    A modelling choice of this program: below it the likelihood of docs/estimation_statistics.md, equation 5, becomes
    that of an interval without noise, whose score is not smooth.
    """
    return max(LEAST_SIGMA_K, LEAST_OF_LSB * sensor.lsb_K)


def sensor_errors(sensor: Sensor, values: Mapping[str, float]) -> SensorErrors:
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


def sensor_definition(record: Record, name: str) -> Parameter | None:
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
        raise InputError(f"{record.name}: `{name}` names no sensor that is used{suggestion(sensor, known)}")
    if what not in SENSOR:
        raise InputError(f"{record.name}: `{name}`: a sensor has no `{what}`{suggestion(what, SENSOR)}")
    return SENSOR[what]


def indications(
    channel: FittedChannel, marched: Linearised, names: Sequence[str], values: Mapping[str, float], named: int
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
    sensor, wrong = channel.sensor, sensor_errors(channel.sensor, values)
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


SMALL_CORRECTION_K = 1.0
"""Size of a correction [K] below which the first one is accurate to some hundredths of a kelvin."""
SETTLED_K = 0.1
"""Change of a correction [K] from one mesh to the next at which it is accepted."""
MOST_HALVINGS = 6


def correct_mesh(part: RecordFit, vector: FloatArray) -> None:
    """Set the correction and the warning of a part, at a parameter vector.

    part   : its correction_K becomes (sensor, sample) [K], 0 where none can be found
    vector : (parameter,) values at which the error is evaluated; its change with the parameters is neglected

    A correction of 1 [K] or more, or one that could not be found, leaves a warning in mesh_told.
    Source: docs/estimation_statistics.md, equation 31.
    """
    mesh = f"{part.record.name}: the mesh of {part.mesh.nodes} nodes"
    finer = "leave `nodes` out of [stack], or ask for more"
    part.correction_K, part.mesh_told = 0.0, ""
    try:
        part.correction_K = mesh_error_K(part, vector)
    except RunError as error:
        part.mesh_told = f"{mesh} could not be corrected, and predictions keep its error ({error}); {finer}"
        return
    worst = float(np.max(np.abs(part.correction_K)))
    if worst >= SMALL_CORRECTION_K:
        part.mesh_told = (
            f"{mesh} is up to {worst:.1f} K off; predictions are corrected, their sensitivities to the parameters are "
            f"not; {finer}"
        )


def mesh_error_K(part: RecordFit, vector: FloatArray) -> FloatArray:
    """Correction that the limit of fine meshes adds to the march of a part, by Richardson's extrapolation.

        T_k - T_0 + (T_k - T_(k-1)) / 3,   k = 1 where that is below 1 K

    vector  : (parameter,) values
    returns : (sensor, sample) [K]
    raises  : RunError where a refined mesh cannot be marched, or the correction still changes by 0.1 [K] after six
              halvings

    Second order holds for smooth solutions. Source: docs/estimation_statistics.md, equation 31.
    """
    fine, initial = refined(part.mesh), part.refined_K(vector)
    coarse, found = _temperatures_K(part, vector, [(part.mesh, part.initial_K(vector)), (fine, initial)])
    # T_1 - T_0 + (T_1 - T_0) / 3
    error = 4.0 / 3.0 * (found - coarse)
    for _ in range(1, MOST_HALVINGS):
        if np.max(np.abs(error)) < SMALL_CORRECTION_K:
            return error
        finer = refined(fine)
        initial, fine, last = None if initial is None else on_mesh(initial, fine, finer), finer, found
        (found,) = _temperatures_K(part, vector, [(fine, initial)])
        before, error = error, found - coarse + (found - last) / 3.0
        if np.max(np.abs(error - before)) < SETTLED_K:
            return error
    raise RunError(f"elements halved {MOST_HALVINGS} times still change it by more than {SETTLED_K:g} K")


def _temperatures_K(
    part: RecordFit, vector: FloatArray, meshes: Sequence[tuple[Mesh, FloatArray | None]]
) -> list[FloatArray]:
    """(sensor, sample) temperatures [K] of the march on each mesh, from the initial temperatures [K] paired with it."""
    tracks = [
        Track(part.with_parameters(vector), mesh, (), part.sample_s, initial_K=initial) for mesh, initial in meshes
    ]
    history = condition_history(part.conditions.at(part.time_s))[np.newaxis]
    found = LinearMarch(tracks, part.time_s, history).march([part.shift_s(vector)] * len(tracks))
    return [f.temperature_K for f in found]
