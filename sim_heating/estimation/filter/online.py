"""The Kalman filter taken on step by step, with the parameters estimated as the readings come.

The kernel is that of the batch filter (`FilterMarch`), resumed. Its state is known given the parameters; what the
readings say of these is summed as it says it,

    A += m' m'^T / S,    b += m' nu / S,        m' = dm/dp, nu innovation, S its variance,

so that with a prior of mean p_m and information Lambda_0, linearised about p_0,

    p = p_0 + (Lambda_0 + A)^-1 (b - Lambda_0 (p_0 - p_m)),    cov p = (Lambda_0 + A)^-1,
    z = z_0 + s (p - p_0),                                     cov z = P + s cov(p) s^T.

That is the Kalman filter of state and parameters together in the form of Friedland (IEEE Trans. Autom. Control 14
(1969) 359), whose parts stay apart. The point of linearisation follows the estimate (`linearise_again`). Derived in
docs/theory/filter.md, equations 17 to 21.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.block import (
    C_STAGES,
    COLUMN,
    END,
    FILM,
    H_REF,
    HEAD_ROWS,
    HIGH,
    INVALID_HIGH_K,
    LANES,
    N_CONDITIONS,
    NODE_ROWS,
    T,
    conditions_at,
    node_rows,
    scalar_row,
)
from sim_heating.base.kernels.jit import njit
from sim_heating.estimation.filter.arrays import (
    Blocks,
    FilterArrays,
    Readings,
    State,
    frozen_gains,
    step_readings,
    workspace,
)
from sim_heating.estimation.filter.kernel import (
    INNOVATION,
    N_OUT,
    PREDICTED,
    PREDICTED_VARIANCE,
    VARIANCE,
    begin_march,
    filter_steps,
)
from sim_heating.estimation.filter.lane_models import LaneModels
from sim_heating.estimation.filter.lane_parameters import Information, LaneParameters, Prior
from sim_heating.estimation.filter.march import FilterMarch, FilterTrack, Samples
from sim_heating.estimation.filter.mesh_error import MeshError
from sim_heating.march.frames import Flights
from sim_heating.march.point import initial_temperatures
from sim_heating.thermal.sensitivity import (
    ACTS_NOWHERE,
    OWN_PERTURBATION,
    PerturbedGroups,
    PerturbedOffsets,
    against_ratio,
)
from sim_heating.thermal.step import LaneGroup

MOVED = 0.1
"""Part of its standard deviation [-] by which an estimate has to be away from where the filter is linearised, before it
is linearised again."""
LARGEST_SHIFT_K = 50.0
"""Most by which a new linearisation moves a temperature [K]; the rest of the way follows the next time."""


class PointReadings(NamedTuple):
    """Readings of several points in some steps, (reading,) in order of time.

    point       : number of the point;  time_s : [s];  node : that is read
    lower_K, upper_K : interval [K], equal where nothing was rounded, NaN where the reading is predicted only
    variance_K2 : of the noise;  gain, bias_K : of the sensor [-], [K]
    direct      : (reading, parameter, 3) direct terms, as of march.Samples
    """

    point: IntArray
    time_s: FloatArray
    node: IntArray
    lower_K: FloatArray
    upper_K: FloatArray
    variance_K2: FloatArray
    gain: FloatArray
    bias_K: FloatArray
    direct: FloatArray


def readings_of_filter(readings: PointReadings, rows: IntArray, first: int, parameters: int) -> PointReadings:
    """Readings of the points of one filter, by its own numbers of the points.

    readings : of the points of several filters;  rows : of those of this filter
    first    : number of its first point;  parameters : number of parameters of its point that has most of them

    Temperatures [K] and direct terms of docs/theory/filter.md, equation 12, are as they were.
    """
    own = readings._replace(**{name: column[rows] for name, column in readings._asdict().items()})
    return own._replace(point=own.point - first, direct=own.direct[:, :parameters])


class Innovations(NamedTuple):
    """Readings as the filter of state and parameters together expected them, (reading,) as they were given.

    predicted_K, variance_K2 : expected reading and its variance, noise included, from all readings before it
    innovation_K, innovation_variance_K2 : reading less prediction, and the variance that it ought to have; NaN where
        nothing was read. Of a recorder word, those of docs/theory/filter.md, equation 10

    Derived in docs/theory/filter.md, equation 20.
    """

    predicted_K: FloatArray
    variance_K2: FloatArray
    innovation_K: FloatArray
    innovation_variance_K2: FloatArray


class HeatedAt(NamedTuple):
    """Where the heating of the last step was evaluated, which readings and a new linearisation have moved since.

    d : (lane,) ratio disturbance [-];  p : (lane, parameter) parameters, each in its unit
    """

    d: FloatArray
    p: FloatArray


class Outlook(NamedTuple):
    """Estimates of all lanes at a time, parameters and state together (docs/theory/filter.md, equations 18 and 19).

    z, variance    : (lane, node + 1) temperatures [K] and ratio disturbance [-], and their variances
    p, covariance  : (lane, parameter) values, (lane, parameter, parameter), each in its unit
    ratio          : (lane, 3) heating ratio [-], its standard deviation, that of the declared model
    """

    z: FloatArray
    variance: FloatArray
    p: FloatArray
    covariance: FloatArray
    ratio: FloatArray


@dataclass(frozen=True, eq=False)
class PointEstimate:
    """State and parameters of one point given all readings so far.

    time_s        : [s]
    temperature_K, sigma_K : (node,) estimates and their standard deviations [K], outermost node first
    disturbance, disturbance_sigma : of the heating ratio [-]
    ratio, ratio_sigma, ratio_declared : heating ratio of the point with its standard deviation, that of the model as
        it was declared [-]
    names, values, covariance : (parameter,), (parameter,), (parameter, parameter), each in its unit
    state_covariance : (node + 1, node + 1) of temperatures and disturbance given the parameters [K2], [K], [-]
    sensitivity   : (node + 1, parameter) of temperatures and disturbance [K over the unit of each parameter]

    Covariance of the state is state_covariance + sensitivity covariance sensitivity^T: docs/theory/filter.md,
    equation 19.
    """

    time_s: float
    temperature_K: FloatArray
    sigma_K: FloatArray
    disturbance: float
    disturbance_sigma: float
    ratio: float
    ratio_sigma: float
    ratio_declared: float
    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    state_covariance: FloatArray
    sensitivity: FloatArray


@dataclass(frozen=True, eq=False)
class FilterSnapshot:
    """All that changes in an online filter, at a time [s]; `OnlineFilter.restore` goes back to it bit for bit.

    numbers : (number,) those of its arrays, one array after the other
    """

    time_s: float
    stepped: bool
    numbers: FloatArray


class OnlineFilter(FilterMarch):
    """Up to LANES points filtered together, step by step, with their parameters.

    points : as for FilterMarch; their samples are not used, each has its own conditions. Parameters of clock and
             sensors are columns of `initial_columns` that are 0
    priors : of the parameters of each point by name, those of clock and sensors behind the others
    corrects_mesh : whether readings and estimates are those of the limit of fine meshes; its error is found beside the
             filter, at the parameters of the beginning (mesh_error.py)
    raises : InputError for a prior that is missing, or whose sigma is not above 0 and finite

    `begin` first, then `step`; `estimates` at any time. Derived in docs/theory/filter.md, equations 17 to 21.
    """

    def __init__(
        self, points: Sequence[FilterTrack], priors: Sequence[Mapping[str, Prior]], corrects_mesh: bool = False
    ) -> None:
        tracks = [replace(p, samples=_no_samples(), flight=i) for i, p in enumerate(points)]
        super().__init__(tracks, np.zeros(1), np.zeros((len(tracks), 1, N_CONDITIONS)))
        n, m = int(self._nodes.max()), max(p.parameters for p in tracks)
        self._parameters = LaneParameters(tracks, priors, self._lane_of, m)
        self._size = n, m
        self.now_s = math.nan
        self._stepped = False
        self._room: list[FloatArray] = []
        self._group = self.nominal.lane_group(0)
        if self.perturbed is None:
            raise InputError("online filter: nothing to filter")
        self._X = Blocks(self.perturbed.state, self.perturbed.state.copy(), self.perturbed.state.copy())
        self._process = self._noise(tracks, n)
        self._state_now = self._state(tracks, n, m)
        self._heated_at = HeatedAt(np.zeros(len(tracks)), np.zeros((len(tracks), m)))
        self._declared = np.zeros((len(tracks), m))
        for i, point in enumerate(tracks):
            self._declared[self._lane_of[i], : len(point.names)] = [point.model.value(n) for n in point.names]
        self._models = LaneModels(tracks, self.nominal, self.perturbed, self._lanes)
        self._arrays_of: dict[int, FilterArrays] = {}
        self._columns = self._offsets(1 + m)
        self._mesh_error = MeshError([p.model for p in tracks], [p.mesh for p in tracks]) if corrects_mesh else None

    def _started(
        self, initial_K: Sequence[FloatArray | None] | None, covariance_K2: Sequence[FloatArray | None] | None
    ) -> list[FilterTrack]:
        """The points with temperatures [K] at the start and covariances of them [K2] in place of those declared."""
        none = [None] * len(self.points)
        return [
            replace(p, initial_K=p.initial_K if T_0 is None else T_0, covariance_K2=p.covariance_K2 if C is None else C)
            for p, T_0, C in zip(self.points, initial_K or none, covariance_K2 or none, strict=True)
        ]

    def begin(
        self,
        time_s: float,
        conditions: FloatArray,
        initial_K: Sequence[FloatArray | None] | None = None,
        covariance_K2: Sequence[FloatArray | None] | None = None,
        values: Sequence[FloatArray] | None = None,
    ) -> None:
        """Start at a time.

        time_s        : [s];  conditions : (point, condition) there, in the units of the condition columns
        initial_K     : (node,) temperatures of each point [K]; as its track declares where None
        covariance_K2 : (node, node) of them [K2]; as its track declares where None

        values        : (parameter,) of each point, where it is linearised; at the means of its priors where None

        No reading is known. Derived in docs/theory/filter.md, equation 17.
        """
        points = self._started(initial_K, covariance_K2)
        self._state_now = self._state(points, *self._size)
        self._parameters.reset()
        for i in range(len(points)):
            if values is not None:
                self._parameters.linearise_at(i, values[i])
            self._write_model(i)
        self._begin([p.initial_K for p in points])
        for other in self._X[1:]:
            other[:] = self._X.start
        self._stepped, self.now_s = False, float(time_s)
        begin_march(self._group, self._flights_of(np.array([self.now_s]), conditions[:, np.newaxis]))
        if self._mesh_error is not None:
            models = [
                p.model.with_parameters(dict(zip(p.names, self.parameters(i).values(), strict=False)))
                for i, p in enumerate(points)
            ]
            declared = [initial_temperatures(p.model.construction, p.mesh) for p in points]
            profiles = [T if p.initial_K is None else p.initial_K for p, T in zip(points, declared, strict=True)]
            self._mesh_error.begin(models, profiles, conditions)

    def gap(self, time_s: FloatArray, conditions: FloatArray, readings: PointReadings, error: float) -> Innovations:
        """Filter all points through steps whose conditions are not known well: an unknown error of the ratio in them.

        time_s     : (step,) ends of the steps [s];  conditions : (point, step, condition) there
        readings   : in order of time, up to the last of the steps
        error      : standard deviation of the error over the ratio itself [-], one error for the whole gap
        returns    : innovations of the readings [K]

        Points whose ratio wanders have that anyway, and none added. Derived in docs/theory/filter.md, equation 22.
        """
        state, h_ref = self._state_now, self._h_ref()
        added = []
        for i, point in enumerate(self.points):
            lane, n, d = self._lane_of[i], point.mesh.nodes, point.disturbance
            if d.start_sigma == d.density_1_s == 0.0 and h_ref[lane] > 0.0:
                state.P[lane, n, n] = (error * float(self.nominal.film_kg_m2_s[i]) / h_ref[lane]) ** 2
                added.append(i)
        innovations = self.step(time_s, conditions, readings)
        for i in added:
            lane, n = self._lane_of[i], self.points[i].mesh.nodes
            state.P[lane, n, :] = state.P[lane, :, n] = state.S[lane, n] = state.d[lane] = 0.0
            self._write_model(i)
        return innovations

    def _h_ref(self) -> FloatArray:
        """(lane,) reference film coefficient of each lane at the present time [kg/(m2 s)]."""
        return self._group.B[conditions_at(END, 0) + H_REF :][: LANES * N_CONDITIONS : N_CONDITIONS]

    def step(self, time_s: FloatArray, conditions: FloatArray, readings: PointReadings) -> Innovations:
        """Filter all points through one or more steps.

        time_s     : (step,) ends of the steps [s], increasing, later than the present time
        conditions : (point, step, condition) there; linear in between
        readings   : in order of time, after the present time and up to the last of the steps
        returns    : innovations of the readings [K]

        One call with two steps gives the bits of two calls with one. Derived in docs/theory/filter.md, equations 1 to
        12, 17 and 20.
        """
        if len(time_s) > 1:
            before = readings.time_s <= time_s[-2]
            parts = (
                self._run(time_s[:-1], conditions[:, :-1], PointReadings(*(a[before] for a in readings))),
                self.step(time_s[-1:], conditions[:, -1:], PointReadings(*(a[~before] for a in readings))),
            )
            return Innovations(*(np.concatenate(pair) for pair in zip(*parts, strict=True)))
        self._heated_at.d[:], self._heated_at.p[:] = self._state_now.d, self._information.at
        return self._run(time_s, conditions, readings)

    def _run(self, time_s: FloatArray, conditions: FloatArray, readings: PointReadings) -> Innovations:
        readings = self._with_mesh_error(time_s, conditions, readings)
        times = np.append(self.now_s, time_s)
        histories = np.concatenate([conditions[:, :1], conditions], axis=1)
        lane_of = self._lane_of[readings.point]
        lanes = len(self.points)
        count = np.bincount(lane_of, minlength=lanes)
        most, rank = int(np.max(count)), _places(lane_of)
        if len(time_s) > 1:
            steps = np.searchsorted(time_s, readings.time_s)
            most = int(np.max(np.bincount(steps * lanes + lane_of), initial=0))
        arrays = self._arrays(most)._replace(readings=_by_lane(readings, lane_of, rank, count, self._size[1]))
        rows = max(1, int(np.max(count, initial=0)))
        out = np.full((lanes, rows, N_OUT + self._size[1]), np.nan)
        innovations = np.full((lanes, rows, 4), np.nan)
        run_online(
            self._group,
            self._X,
            self._groups,
            self._columns,
            self._flights_of(times, histories),
            not self._stepped,
            arrays,
            out,
            self._information,
            innovations,
        )
        self._stepped, self.now_s = True, float(times[-1])
        return Innovations(*innovations[lane_of, rank].T)

    def _with_mesh_error(self, time_s: FloatArray, conditions: FloatArray, readings: PointReadings) -> PointReadings:
        """Readings of some steps as the mesh of their points shows them: their biases have its error at those times."""
        if self._mesh_error is None:
            return readings
        step, error_K, now_s = np.searchsorted(time_s, readings.time_s), np.zeros(len(readings.node)), self.now_s
        for k, end_s in enumerate(time_s.tolist()):
            self._mesh_error.advance(conditions[:, k], end_s - now_s)
            now_s = end_s
            in_step = step == k
            if np.any(in_step):
                error_K[in_step] = self._mesh_error.of_nodes()[readings.point[in_step], readings.node[in_step]]
        return readings._replace(bias_K=readings.bias_K + readings.gain * error_K)

    def linearise_again(self, i: int, moved: float = MOVED) -> bool:
        """Linearise a point about its present estimate, where that has moved; whether it has.

            p_0 <- p,    z <- z + s dp,    b <- b - A dp

        i     : number of the point
        moved : part of its standard deviation [-] by which a parameter has to have moved

        Temperatures move by 50 K at most, parameters stay within their bounds. Derived in docs/theory/filter.md,
        equation 21.
        """
        lane = int(self._lane_of[i])
        lower, upper = self._parameters.bounds[i]
        if not shift_linearisation(
            self._group.B, self._state_now, self._information, lane, int(self._nodes[lane]), moved, lower, upper
        ):
            return False
        self._write_model(i)
        return True

    def estimates(self) -> list[PointEstimate]:
        """State and parameters of all points now (docs/theory/filter.md, equations 18 and 19)."""
        state, (n, m) = self._state_now, self._size
        lanes = len(self.points)
        outlook = Outlook(
            np.full((lanes, n + 1), np.nan),
            np.full((lanes, n + 1), np.nan),
            np.zeros((lanes, m)),
            np.zeros((lanes, m, m)),
            np.full((lanes, 3), np.nan),
        )
        read_estimates(
            self._group.B,
            self._X.end,
            self._columns,
            state,
            self._information,
            self._heated_at,
            self._declared,
            self._stepped,
            outlook,
        )
        error_K = np.zeros((lanes, n)) if self._mesh_error is None else self._mesh_error.of_nodes()
        return [self._estimate(i, outlook, error_K[i]) for i in range(lanes)]

    def _estimate(self, i: int, outlook: Outlook, error_K: FloatArray) -> PointEstimate:
        lane, n, m = self._lane_of[i], self.points[i].mesh.nodes, self.points[i].parameters
        sigma = np.sqrt(np.maximum(outlook.variance[lane, : n + 1], 0.0))
        ratio, ratio_sigma, ratio_declared = outlook.ratio[lane].tolist()
        z, P, S = outlook.z[lane], self._state_now.P[lane, : n + 1, : n + 1], self._state_now.S[lane, : n + 1, :m]
        wall = (z[:n] + error_K[:n], sigma[:n], float(z[n]), float(sigma[n]), ratio, ratio_sigma, ratio_declared)
        parameters = (self.names[i], outlook.p[lane, :m], outlook.covariance[lane, :m, :m])
        return PointEstimate(self.now_s, *wall, *parameters, P.copy(), S.copy())

    @property
    def names(self) -> list[tuple[str, ...]]:
        """Names of the parameters of each point."""
        return self._parameters.names

    @property
    def _information(self) -> Information:
        return self._parameters.information

    @property
    def most_parameters(self) -> int:
        """Number of parameters of the point that has most of them."""
        return self._size[1]

    @property
    def diverged(self) -> list[int]:
        """Numbers of the points whose filter diverged: a temperature [K] fell below 1 K or is not a number."""
        return [i for i in range(len(self.points)) if self._state_now.diverged[self._lane_of[i]]]

    def parameters(self, i: int) -> dict[str, float]:
        """Values of the parameters of a point where it is linearised, each in its unit ([-] for a ratio)."""
        return self._parameters.values(i)

    # Snapshots -------------------------------------------------------------------------------------------------------

    def snapshot(self) -> FilterSnapshot:
        """All that changes, copied; `restore` goes back to it exactly."""
        arrays = [a.ravel() for a in self._changing()]
        numbers = self._room.pop() if self._room else np.empty(sum(a.size for a in arrays))
        return FilterSnapshot(self.now_s, self._stepped, np.concatenate(arrays, out=numbers))

    def done_with(self, snapshot: FilterSnapshot) -> None:
        """Have a snapshot's room for later ones: fresh memory costs more than the copy. It is not restored again."""
        self._room.append(snapshot.numbers)

    def restore(self, snapshot: FilterSnapshot) -> None:
        """Go back, or forward, to a snapshot of this filter."""
        self.now_s, self._stepped = snapshot.time_s, snapshot.stepped
        where, groups = self._information.at.copy(), self._groups.groups
        gathered = [[head[scalar_row(COLUMN)].copy() for head in _heads(x, groups)] for x in self._X]
        self._copy_back(snapshot.numbers)
        moved = [i for i in range(len(self.points)) if np.any((self._information.at != where)[self._lane_of[i]])]
        if moved:
            # The nodes of the perturbed lanes have the parameters of another linearisation.
            for i in moved:
                self._write_model(i)
            self._copy_back(snapshot.numbers)
        # The next step assembles them again; what stays in them, parameters and the memory of lag, is that of the end.
        for x in self._X[:2]:
            for present, end in zip(_heads(x, groups), _heads(self._X.end, groups), strict=True):
                present[:] = end
        # Polynomials of their nodes that were gathered with other parameters, or in another column of pressures.
        for x, columns in zip(self._X, gathered, strict=True):
            for (first, last, *_), before, head in zip(groups, columns, _heads(x, groups), strict=True):
                if moved or np.any(before != head[scalar_row(COLUMN)]):
                    node_rows(x[first:last])[:, HIGH] = INVALID_HIGH_K

    def _copy_back(self, numbers: FloatArray) -> None:
        at = 0
        for array in self._changing():
            array[...] = numbers[at : at + array.size].reshape(array.shape)
            at += array.size

    def _changing(self) -> tuple[FloatArray | IntArray, ...]:
        """All that changes from step to step and is not found again by the next one: what is in the nodes of the
        perturbed lanes follows from the nominal ones and from the parameters."""
        info, heads = self._information, _heads(self._X.end, self._groups.groups)
        mesh = () if self._mesh_error is None else (self._mesh_error.state,)
        filtered = self._group.B, *heads, *self._state_now, info.A, info.b, info.pull, info.at, *self._heated_at
        return (*filtered, *mesh)

    # Packing ---------------------------------------------------------------------------------------------------------

    def _flights_of(self, time_s: FloatArray, histories: FloatArray) -> Flights:
        return Flights(time_s, np.ascontiguousarray(histories), self._flights.of_lane)

    def _arrays(self, most: int) -> FilterArrays:
        """Arrays of the filter with room for a number of readings in a step; their readings are to be replaced."""
        if most not in self._arrays_of:
            n, m = self._size
            nothing = self._readings([replace(p, samples=_no_samples()) for p in self.points], m)
            self._arrays_of[most] = FilterArrays(
                nothing,
                self._state_now,
                self._process,
                frozen_gains(np.full(len(self.points), np.inf), most, n + 1),
                self._history(self.points, n, False),
                workspace(n, 2 + m + n),
                step_readings(most, n + 1, m),
                np.zeros(n + 1),
                np.zeros((n + 1, n + 1)),
                np.zeros((n + 1, n + 1)),
            )
        return self._arrays_of[most]._replace(state=self._state_now)

    def _write_model(self, i: int) -> None:
        """Give the lanes of a point the parameters that it is linearised at, its ratio disturbance among them."""
        at, d = self._information.at[self._lane_of[i]].tolist(), float(self._state_now.d[self._lane_of[i]])
        self._models.write(i, at, d, self._X)


def _no_samples() -> Samples:
    nothing = np.zeros(0)
    return Samples(nothing, np.zeros(0, dtype=np.int64), nothing, nothing, nothing, nothing, nothing)


def no_readings(parameters: int) -> PointReadings:
    """Readings of a step in which nothing was read."""
    nothing, number = np.zeros(0), np.zeros(0, dtype=np.int64)
    return PointReadings(
        number, nothing, number, nothing, nothing, nothing, nothing, nothing, np.zeros((0, parameters, 3))
    )


def _heads(X: FloatArray, groups: IntArray) -> list[FloatArray]:
    """What is ahead of the nodes in the block of each group of lanes: parameters, conditions, heating (views)."""
    return [X[first : first + HEAD_ROWS * LANES] for first in groups[:, 0]]


def _by_lane(readings: PointReadings, lane_of: IntArray, rank: IntArray, count: IntArray, m: int) -> Readings:
    """Readings of several points as rows of their lanes, `count` of each; m : number of columns of direct terms."""
    lanes, rows = len(count), max(1, int(np.max(count, initial=0)))
    numbers, node = np.full((6, lanes * rows), np.nan), np.zeros((lanes, rows), dtype=np.int64)
    direct, at = np.zeros((lanes, rows, m, 3)), lane_of * rows + rank
    numbers[:, at] = (
        readings.time_s,
        readings.gain,
        readings.bias_K,
        readings.variance_K2,
        readings.lower_K,
        readings.upper_K,
    )
    node.ravel()[at] = readings.node
    if np.any(readings.direct):
        direct.reshape(-1, m, 3)[at, : readings.direct.shape[1]] = readings.direct
    time_s, gain, bias, variance, lower, upper = numbers.reshape(6, lanes, rows)
    return Readings(count.astype(np.int64), time_s, node, gain, bias, variance, lower, upper, direct)


def _places(lane_of: IntArray) -> IntArray:
    """(reading,) how many readings of its own lane come before each."""
    order = np.argsort(lane_of, kind="stable")
    ordered = lane_of[order]
    first = np.searchsorted(ordered, ordered)
    ranks = np.empty(len(lane_of), dtype=np.int64)
    ranks[order] = np.arange(len(lane_of)) - first
    return ranks


# Compiled ------------------------------------------------------------------------------------------------------------


@njit
def factorise(information: Information, lane: int, scale: FloatArray, L: FloatArray, pulled: FloatArray) -> None:
    """Factorise what is known of the parameters of a lane, Lambda_0 + A = D^-1 L L^T D^-1.

    scale  : (m,) receives the diagonal of D, in the units of the parameters;  L : (m, m) receives the lower triangle
    pulled : (m,) receives L^-1 D (b - Lambda_0 (p_0 - p_m)) [-]

    Scaled to a diagonal of 1, since the units of parameters differ by orders of magnitude. Derived in
    docs/theory/filter.md, equation 18.
    """
    A, prior, m = information.A[lane], information.prior[lane], len(scale)
    for k in range(m):
        scale[k] = 1.0 / math.sqrt(A[k, k] + prior[k, k])
    for k in range(m):
        for j in range(k + 1):
            total = (A[k, j] + prior[k, j]) * scale[k] * scale[j]
            for i in range(j):
                total -= L[k, i] * L[j, i]
            if j < k:
                L[k, j] = total / L[j, j]
            else:
                L[k, k] = math.sqrt(total)
    for k in range(m):
        pulled[k] = information.b[lane, k] - information.pull[lane, k]
    whiten(L, scale, pulled)


@njit
def whiten(L: FloatArray, scale: FloatArray, x: FloatArray) -> None:
    """x <- L^-1 D x in place: the product of two such vectors is one with the covariance of the parameters between.

    x : (m,) derivative of a quantity against the parameters, in its unit ([K] for a temperature) over theirs

    Derived in docs/theory/filter.md, equation 18.
    """
    for k in range(len(x)):
        total = x[k] * scale[k]
        for j in range(k):
            total -= L[k, j] * x[j]
        x[k] = total / L[k, k]


@njit
def unwhiten(L: FloatArray, scale: FloatArray, x: FloatArray) -> None:
    """x <- D L^-T x in place: from L^-1 D g [-] to the change (Lambda_0 + A)^-1 g of the parameters, each in its unit.

    Derived in docs/theory/filter.md, equation 18.
    """
    for k in range(len(x) - 1, -1, -1):
        total = x[k]
        for j in range(k + 1, len(x)):
            total -= L[j, k] * x[j]
        x[k] = total / L[k, k]
    for k in range(len(x)):
        x[k] *= scale[k]


@njit
def _sum_information(information: Information, lane: int, count: int, out: FloatArray, innovations: FloatArray) -> None:
    """Add what the readings of a lane say of its parameters, one after the other; fills `innovations` (equation 20)."""
    m = information.b.shape[1]
    scale, pulled, x, L = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros((m, m))
    for q in range(count):
        factorise(information, lane, scale, L, pulled)
        for k in range(m):
            x[k] = out[q, N_OUT + k]
        whiten(L, scale, x)
        shift, added = 0.0, 0.0
        for k in range(m):
            shift += x[k] * pulled[k]
            added += x[k] * x[k]
        innovations[q, 0], innovations[q, 1] = out[q, PREDICTED] + shift, out[q, PREDICTED_VARIANCE] + added
        nu, variance = out[q, INNOVATION], out[q, VARIANCE]
        if not (math.isfinite(nu) and math.isfinite(variance)):
            continue
        innovations[q, 2], innovations[q, 3] = nu - shift, variance + added
        for k in range(m):
            weight = out[q, N_OUT + k] / variance
            information.b[lane, k] += weight * nu
            for j in range(m):
                information.A[lane, k, j] += weight * out[q, N_OUT + j]


@njit
def run_online(
    group: LaneGroup,
    X: Blocks,
    perturbed: PerturbedGroups,
    offsets: PerturbedOffsets,
    flights: Flights,
    first: bool,
    f: FilterArrays,
    out: FloatArray,
    information: Information,
    innovations: FloatArray,
) -> None:
    """Filter the lanes of one group through some steps, and sum what their readings say of the parameters.

    group         : the nominal lanes;  X, perturbed, offsets : blocks of the perturbed lanes, their groups, and where
                    those of each nominal lane are
    flights       : ends of the steps and conditions;  first : whether the first of them is that of the march
    f, out        : arrays of the filter, and its results by (lane, reading)
    information   : of all lanes, updated
    innovations   : (lane, reading, 4) receives prediction [K], its variance [K2], innovation [K] and its variance [K2]
                    with the parameters estimated from the readings before

    Derived in docs/theory/filter.md, equations 17 and 20.
    """
    filter_steps(group, X, perturbed, offsets, flights, first, f, out)
    for lane in range(f.state.P.shape[0]):
        _sum_information(information, lane, f.readings.number[lane], out[lane], innovations[lane])


@njit
def _moved_by(state: State, lane: int, i: int, step: FloatArray) -> float:
    """Change of node temperature i of a lane [K], or of its disturbance [-] behind the last node, by a step of the
    parameters."""
    change = 0.0
    for k in range(len(step)):
        change += state.S[lane, i, k] * step[k]
    return change


@njit
def shift_linearisation(
    B: FloatArray,
    state: State,
    information: Information,
    lane: int,
    nodes: int,
    moved: float,
    lower: FloatArray,
    upper: FloatArray,
) -> bool:
    """Move the point of linearisation of a lane to its estimate, where that has moved; whether it has.

    B, state, information : block and arrays of all lanes, changed
    nodes        : of the lane;  moved : part of its standard deviation [-] by which a parameter has to have moved
    lower, upper : (m,) bounds of the parameters, each in its unit

    Derived in docs/theory/filter.md, equation 21.
    """
    m = len(lower)
    scale, step, x, L = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros((m, m))
    factorise(information, lane, scale, L, step)
    unwhiten(L, scale, step)
    away = False
    for k in range(m):
        x[:] = 0.0
        x[k] = 1.0
        whiten(L, scale, x)
        variance = 0.0
        for j in range(m):
            variance += x[j] * x[j]
        target = min(max(information.at[lane, k] + step[k], lower[k]), upper[k])
        step[k] = target - information.at[lane, k]
        away = away or abs(step[k]) > moved * math.sqrt(variance)
    if not away:
        return False
    largest = 0.0
    for i in range(nodes):
        largest = max(largest, abs(_moved_by(state, lane, i, step)))
    if not math.isfinite(largest):
        return False
    fraction = min(1.0, LARGEST_SHIFT_K / max(largest, 1e-300))
    for k in range(m):
        step[k] *= fraction
    for i in range(nodes):
        B[(HEAD_ROWS + i * NODE_ROWS + T) * LANES + lane] += _moved_by(state, lane, i, step)
    state.d[lane] += _moved_by(state, lane, nodes, step)
    for k in range(m):
        information.at[lane, k] += step[k]
        for j in range(m):
            information.b[lane, k] -= information.A[lane, k, j] * step[j]
            information.pull[lane, k] += information.prior[lane, k, j] * step[j]
    return True


@njit
def read_estimates(
    B: FloatArray,
    X: FloatArray,
    offsets: PerturbedOffsets,
    state: State,
    information: Information,
    heated_at: HeatedAt,
    declared: FloatArray,
    stepped: bool,
    outlook: Outlook,
) -> None:
    """State [K] and parameters of all lanes from what the readings say of both; `outlook` is filled.

    B, X    : block of the lanes, and blocks of the perturbed lanes at the end of the last step
    offsets : where the perturbed lanes of each lane are, the column of the ratio disturbance first
    heated_at : where the heating was evaluated;  declared : (lane, parameter) values of the model, each in its unit
    stepped : whether a step was taken; without one there is no heating ratio yet

    Derived in docs/theory/filter.md, equations 18 and 19.
    """
    m = information.b.shape[1]
    scale, pulled, x, L = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros((m, m))
    for lane in range(state.P.shape[0]):
        n = offsets.nodes[lane]
        factorise(information, lane, scale, L, pulled)
        for i in range(n + 1):
            x[:] = state.S[lane, i]
            whiten(L, scale, x)
            mean = state.d[lane] if i == n else B[(HEAD_ROWS + i * NODE_ROWS + T) * LANES + lane]
            variance = state.P[lane, i, i]
            for k in range(m):
                mean += x[k] * pulled[k]
                variance += x[k] * x[k]
            outlook.z[lane, i], outlook.variance[lane, i] = mean, variance
        if stepped:
            _read_ratio(B, X, offsets, state, information, heated_at, declared, lane, x, outlook.ratio)
            whiten(L, scale, x)
            variance = outlook.ratio[lane, 1]
            for k in range(m):
                outlook.ratio[lane, 0] += x[k] * pulled[k]
                variance += x[k] * x[k]
            outlook.ratio[lane, 1] = math.sqrt(max(variance, 0.0))
        for k in range(m):
            x[:] = 0.0
            x[k] = 1.0
            whiten(L, scale, x)
            unwhiten(L, scale, x)
            outlook.covariance[lane, k] = x
        x[:] = pulled
        unwhiten(L, scale, x)
        for k in range(m):
            outlook.p[lane, k] = information.at[lane, k] + x[k]


@njit
def _read_ratio(
    B: FloatArray,
    X: FloatArray,
    offsets: PerturbedOffsets,
    state: State,
    information: Information,
    heated_at: HeatedAt,
    declared: FloatArray,
    lane: int,
    x: FloatArray,
    ratio: FloatArray,
) -> None:
    """Heating ratio of a lane at the end of the last step given the parameters, its variance, and the declared ratio.

    x : (m,) receives the derivative of the ratio against the parameters
    """
    n, film = offsets.nodes[lane], (FILM + END - HEAD_ROWS) * LANES
    h_ref = B[C_STAGES * LANES + (END * LANES + lane) * N_CONDITIONS + H_REF]
    per_d = _ratio_slope(X, offsets, lane, 0, film) / h_ref
    heated = X[offsets.at[lane] + film] / h_ref
    ratio[lane, 0] = heated + per_d * (state.d[lane] - heated_at.d[lane])
    ratio[lane, 2] = heated - per_d * heated_at.d[lane]
    for k in range(len(x)):
        slope = _ratio_slope(X, offsets, lane, 1 + k, film) / h_ref
        ratio[lane, 0] += slope * (information.at[lane, k] - heated_at.p[lane, k])
        ratio[lane, 2] += slope * (declared[lane, k] - heated_at.p[lane, k])
        x[k] = slope + per_d * state.S[lane, n, k]
    ratio[lane, 1] = per_d * per_d * state.P[lane, n, n]


@njit
def _ratio_slope(X: FloatArray, offsets: PerturbedOffsets, lane: int, k: int, film: int) -> float:
    """Derivative of the film coefficient of a lane against the parameter of a column [kg/(m2 s)] over its unit."""
    if offsets.reach[lane, k] == ACTS_NOWHERE:
        return 0.0
    slope = (X[offsets.plus[lane, k] + film] - X[offsets.minus[lane, k] + film]) * offsets.inverse[lane, k]
    if offsets.linear[lane, k] != OWN_PERTURBATION:
        slope *= against_ratio(X, offsets.at[lane], offsets.linear[lane, k])
    return slope
