"""Points marched with an extended Kalman filter on their temperatures: readings in, temperatures with covariance out.

Covariance and sensitivities go through the factorised step of the linearised march, readings may lie anywhere in a
step, and the heating ratio may carry a disturbance. Without process noise and with a known start the filter is the
plain march, and the sensitivities of its innovations are exact (output error); otherwise they leave out how the gain
changes with a parameter. Equations: docs/theory/filter.md, equations 1 to 14.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.kernels.block import D0, LANES, T, node_rows, parameters_at
from sim_heating.estimation.filter import arrays, kernel
from sim_heating.heating.effects.compiled import unusable_value
from sim_heating.march.linearised import LinearMarch, Track, initial_profile
from sim_heating.march.point import PointModel
from sim_heating.thermal.mesh import Mesh
from sim_heating.thermal.step import LaneGroup


@dataclass(frozen=True, eq=False)
class Samples:
    """Readings of one point, in order of time: y = gain * (temperature of a node) + bias + noise.

    time_s, node     : (reading,) time [s] and number of the node
    lower_K, upper_K : (reading,) interval in which the noisy value lay [K], equal where nothing was rounded; NaN where
                       the temperature is predicted only: a lost sample, one held out, a surface
    variance_K2      : (reading,) of the noise [K2]
    gain, bias_K     : (reading,) of the sensor [-], [K]
    direct           : (reading, parameter, 3) terms of a parameter in a reading: a constant [K], times the temperature,
                       times its rate, over the parameter's unit (bias 1, 0, 0; gain 0, 1, 0; skew 0, 0, -gain)
    """

    time_s: FloatArray
    node: IntArray
    lower_K: FloatArray
    upper_K: FloatArray
    variance_K2: FloatArray
    gain: FloatArray
    bias_K: FloatArray
    direct: FloatArray | None = None


@dataclass(frozen=True)
class Disturbance:
    """First-order noise on the heating ratio, additive like ratio.d0, constant over a step.

    start_sigma   : standard deviation at the start [-]
    correlation_s : time in which it decays to 1/e [s]; infinite for a random walk
    density_1_s   : density of the white noise that drives it, the growth of its variance without decay [1/s]
    """

    start_sigma: float = 0.0
    correlation_s: float = math.inf
    density_1_s: float = 0.0

    @staticmethod
    def gauss_markov(sigma: float, correlation_s: float) -> Disturbance:
        """Stationary disturbance of covariance sigma^2 exp(-|t| / tau), driven by noise of density 2 sigma^2 / tau.

        sigma : standard deviation [-];  correlation_s : correlation time tau, above 0 [s]

        Derived in docs/theory/filter.md, equation 3.
        """
        return Disturbance(sigma, correlation_s, 2.0 * sigma**2 / correlation_s)


@dataclass(frozen=True, eq=False)
class FilterTrack:
    """One control point with its readings, start and noise.

    model, mesh, names, initial_K, initial_columns, flight : as of march/linearised.py, Track
    samples       : readings, taken or only predicted
    covariance_K2 : (node, node) of the temperatures at the start [K2]; None for a known start
    noise_K2_s    : white process noise of every node, or (node,) [K2/s]
    disturbance   : of the heating ratio
    freeze_after_s  : time after which gains are frozen [s]: those of one step serve for all that have readings at the
                    same places in it; an approximation, see decision 0014
    """

    model: PointModel
    mesh: Mesh
    samples: Samples
    names: tuple[str, ...] = ()
    initial_K: FloatArray | None = None
    initial_columns: FloatArray | None = None
    covariance_K2: FloatArray | None = None
    noise_K2_s: float | FloatArray = 0.0
    disturbance: Disturbance = field(default_factory=Disturbance)
    flight: int = 0
    freeze_after_s: float = math.inf

    @property
    def parameters(self) -> int:
        """Number of sensitivities: named parameters and columns of the initial temperatures."""
        return len(self.names) + (0 if self.initial_columns is None else self.initial_columns.shape[1])

    def linear(self) -> Track:
        """Track of the point for a linearised march, with ratio.d0 ahead of its parameters.

        The derivative against ratio.d0 [K] is the Gamma of docs/theory/filter.md, equation 1.
        """
        # ratio.d0 first: its column is Gamma, which every other column needs before it.
        return Track(
            self.model,
            self.mesh,
            ("ratio.d0", *self.names),
            self.samples.time_s,
            (),
            self.initial_K,
            self.initial_columns,
            self.flight,
        )


@dataclass(frozen=True, eq=False)
class FilterHistory:
    """History of a filter for the smoother; the state is the node temperatures [K] and the ratio disturbance [-].

    time_s           : (time,) ends of the steps, the start first [s]
    mean, covariance : (time, state), (time, state, state) after all readings up to each time [K], [K2]
    transition       : (step, state, state) derivative of the state after a step and its readings against that before it
    rows             : (reading, state) of a reading's innovation against the state before its step
    step             : (reading,) number of its step
    """

    time_s: FloatArray
    mean: FloatArray
    covariance: FloatArray
    transition: FloatArray
    rows: FloatArray
    step: IntArray


@dataclass(frozen=True, eq=False)
class Filtered:
    """Result of a filter; (reading,) unless stated otherwise, NaN where nothing was read.

    prior_K, posterior_K : temperature before and after all readings of its time [K], with their variances [K2]
    predicted_K, predicted_variance_K2 : expected reading [K] once those before it are taken, with the variance of that
                     and its noise together [K2]
    innovation_K   : reading minus prediction from all readings before it [K]; of an interval, that of the unrounded
                     reading that would move mean and variance as it does
    variance_K2    : its variance [K2]
    log_likelihood : 0 where nothing was read
    sensitivity    : (reading, parameter) of the prediction [K over the parameter's unit]
    temperature_K, ratio, covariance : at the end: (node,) [K], the disturbance [-], (node + 1, node + 1)
    history        : for the smoother, where it was asked for
    """

    prior_K: FloatArray
    prior_variance_K2: FloatArray
    posterior_K: FloatArray
    posterior_variance_K2: FloatArray
    predicted_K: FloatArray
    predicted_variance_K2: FloatArray
    innovation_K: FloatArray
    variance_K2: FloatArray
    log_likelihood: FloatArray
    sensitivity: FloatArray
    temperature_K: FloatArray
    ratio: float
    covariance: FloatArray
    history: FilterHistory | None

    @property
    def read(self) -> NDArray[np.bool_]:
        """(reading,) which readings were taken: those with a finite innovation [K] and variance [K2]."""
        return np.isfinite(self.innovation_K) & np.isfinite(self.variance_K2)

    def score(self) -> FloatArray:
        """(parameter,) gradient of the log likelihood, sum of (nu / S) dm/dp, over the unit of each parameter.

        nu innovation [K], S its variance [K2], m prediction [K]. Exact without process noise and with a known start;
        otherwise the derivative of the gain is missing. Derived in docs/theory/filter.md, equation 13.
        """
        weight = np.where(self.read, self.innovation_K / self.variance_K2, 0.0)
        return weight @ self.sensitivity

    def information(self) -> FloatArray:
        """(parameter, parameter) Gauss-Newton information of the readings, sum of (1 / S) dm/dp dm/dp'.

        S variance of the innovation [K2], m prediction [K]. Derived in docs/theory/filter.md, equation 13.
        """
        weight = np.where(self.read, 1.0 / self.variance_K2, 0.0)
        return (self.sensitivity.T * weight) @ self.sensitivity


class FilterMarch(LinearMarch):
    """Up to LANES points on common times, filtered together; the result of each is independent of the others.

    points    : points with readings; `set_models` changes their parameters
    time_s    : (time,) steps [s];  histories : (flight, time, condition)
    """

    def __init__(self, points: Sequence[FilterTrack], time_s: FloatArray, histories: FloatArray) -> None:
        self.points = tuple(points)
        super().__init__([p.linear() for p in self.points], time_s, histories)

    def _require_finite(self, points: Sequence[FilterTrack], state: arrays.State) -> None:
        """Refuse a filter that diverged, with the effect that is the cause where one is."""
        for i, point in enumerate(points):
            step = state.diverged[self._lane_of[i]]
            for use in point.model.effects if step else ():
                if fault := unusable_value(use, self.time_s, self.histories[point.flight]):
                    raise RunError(f"{point.model.name}: {fault}")
            if step:
                raise RunError(
                    f"{point.model.name}: the filter diverged at {self.time_s[step]:g} s: a temperature fell below "
                    "0 K or is not a number; the noise declared does not fit the readings"
                )

    def filter(self, points: Sequence[FilterTrack] | None = None, *, keep: bool = False) -> list[Filtered]:
        """Filter all points through their flights and readings.

        points  : the same ones with other readings, noise or start; models are those of `set_models`
        keep    : whether to keep the history that a smoother needs: 16 bytes for each step and pair of states
        returns : for each point innovations [K], variances [K2], log likelihood, sensitivities, and the state at the
                  end
        raises  : InputError for readings outside the march, negative noise, or a history with frozen gains; RunError
                  where a filter diverged or a step did not converge

        One linearisation a step, not iterated. Derived in docs/theory/filter.md, equations 1 to 14.
        """
        points = self.points if points is None else tuple(points)
        for point in points:
            _check(point, self.time_s)
        n = int(self._nodes.max())
        m = max(p.parameters for p in points)
        # A reading at the end of a step belongs to it and not to the next, so that it is taken before time goes on.
        steps = [np.searchsorted(self.time_s[1:], p.samples.time_s) for p in points]
        most = max([int(np.max(np.bincount(s), initial=0)) for s in steps])
        state, history = self._state(points, n, m), self._history(points, n, keep)
        readings, after_s = self._readings(points, m), np.zeros(len(points))
        after_s[self._lane_of] = [point.freeze_after_s for point in points]
        # Frozen gains skip F L and F, from which the smoother's transition is read.
        if keep and np.any(np.isfinite(after_s)):
            raise InputError("filter: a smoother needs the covariance of every step; leave freeze_after_s out")
        filter_arrays = arrays.FilterArrays(
            readings,
            state,
            self._noise(points, n),
            arrays.frozen_gains(after_s, most, n + 1),
            history,
            arrays.workspace(n, 1 + m + (1 + keep) * (n + 1)),
            arrays.step_readings(most, n + 1, m),
            np.zeros(n + 1),
            np.zeros((n + 1, n + 1)),
            np.zeros((n + 1, n + 1)),
        )
        out = np.full((len(points), readings.time_s.shape[1], kernel.N_OUT + m), np.nan)
        out[..., kernel.LOG_LIKELIHOOD] = 0.0
        self._begin([point.initial_K for point in points])
        group, X = self._copies()
        kernel.begin_march(group, self._flights)
        kernel.filter_steps(group, X, self._groups, self._offsets(1 + m), self._flights, True, filter_arrays, out)
        self._take_over(group.B)
        self._require_finite(points, state)
        self.nominal.check()
        return [self._filtered(i, points[i], steps[i], out, state, history) for i in range(len(points))]

    def _copies(self) -> tuple[LaneGroup, arrays.Blocks]:
        """The nominal lanes and three copies of the blocks of the perturbed lanes, for start, middle stage and end.

        Copies: the filter disturbs ratios and temperatures, and the points must serve for another march.
        """
        group = self.nominal.lane_group(0)
        return group._replace(B=group.B.copy()), arrays.Blocks(*(self._perturbed_state().copy() for _ in range(3)))

    def _take_over(self, B: FloatArray) -> None:
        """Take over the block of a finished march, its ratios undisturbed again."""
        nominal = self.nominal.memory.block(0)
        d0 = [parameters_at(lane) + D0 for lane in range(LANES)]
        B[d0] = nominal[d0]
        nominal[:] = B

    def _state(self, points: Sequence[FilterTrack], n: int, m: int) -> arrays.State:
        lanes = len(points)
        P, S, d = np.zeros((lanes, n + 1, n + 1)), np.zeros((lanes, n + 1, m)), np.zeros(lanes)
        for i, point in enumerate(points):
            lane, nodes = self._lane_of[i], point.mesh.nodes
            if point.covariance_K2 is not None:
                P[lane, :nodes, :nodes] = point.covariance_K2
            # The disturbance stands behind the point's own nodes, not behind those of the largest point.
            P[lane, nodes, nodes] = point.disturbance.start_sigma**2
            if point.initial_columns is not None:
                S[lane, :nodes, len(point.names) : point.parameters] = point.initial_columns
        return arrays.State(P, S, d, np.zeros(lanes, dtype=np.int64))

    def _noise(self, points: Sequence[FilterTrack], n: int) -> arrays.Noise:
        lanes = len(points)
        nodes, decay, density = np.zeros((lanes, n)), np.zeros(lanes), np.zeros(lanes)
        for i, point in enumerate(points):
            lane = self._lane_of[i]
            nodes[lane, : point.mesh.nodes] = point.noise_K2_s
            decay[lane], density[lane] = 1.0 / point.disturbance.correlation_s, point.disturbance.density_1_s
        return arrays.Noise(nodes, decay, density)

    def _history(self, points: Sequence[FilterTrack], n: int, keep: bool) -> arrays.SmootherHistory:
        lanes, steps = len(points), len(self.time_s) - 1 if keep else -1
        count = max(len(p.samples.time_s) for p in points) if keep else 0
        size = (steps + 1, n + 1, n + 1)
        history = arrays.SmootherHistory(
            np.zeros((lanes, *size[:2])),
            np.zeros((lanes, *size)),
            np.zeros((lanes, max(steps, 0), *size[1:])),
            np.zeros((lanes, count, n + 1)),
        )
        for i, point in enumerate(points if keep else ()):
            lane, nodes = self._lane_of[i], point.mesh.nodes
            history.mean[lane, 0, :nodes] = initial_profile(self.tracks[i])
            history.covariance[lane, 0, :nodes, :nodes] = 0.0 if point.covariance_K2 is None else point.covariance_K2
            history.covariance[lane, 0, nodes, nodes] = point.disturbance.start_sigma**2
        return history

    def _readings(self, points: Sequence[FilterTrack], m: int) -> arrays.Readings:
        lanes, most = len(points), max(1, *(len(p.samples.time_s) for p in points))
        count, node = np.zeros(lanes, dtype=np.int64), np.zeros((lanes, most), dtype=np.int64)
        time_s, gain, bias, variance, lower, upper = np.full((6, lanes, most), np.nan)
        direct = np.zeros((lanes, most, m, 3))
        for i, point in enumerate(points):
            lane, s = self._lane_of[i], point.samples
            columns = slice(len(s.time_s))
            count[lane], time_s[lane, columns], node[lane, columns] = len(s.time_s), s.time_s, s.node
            gain[lane, columns], bias[lane, columns], variance[lane, columns] = s.gain, s.bias_K, s.variance_K2
            lower[lane, columns], upper[lane, columns] = s.lower_K, s.upper_K
            if s.direct is not None:
                direct[lane, columns, : point.parameters] = s.direct
        return arrays.Readings(count, time_s, node, gain, bias, variance, lower, upper, direct)

    def _filtered(
        self,
        i: int,
        point: FilterTrack,
        step: IntArray,
        out: FloatArray,
        state: arrays.State,
        history: arrays.SmootherHistory,
    ) -> Filtered:
        lane, size = self._lane_of[i], point.mesh.nodes + 1
        read = out[lane, : len(point.samples.time_s)]
        kept = None
        if history.mean.shape[1]:
            kept = FilterHistory(
                self.time_s,
                history.mean[lane, :, :size],
                history.covariance[lane, :, :size, :size],
                history.transition[lane, :, :size, :size],
                history.rows[lane, : len(read), :size],
                step,
            )
        return Filtered(
            read[:, kernel.PRIOR],
            read[:, kernel.PRIOR_VARIANCE],
            read[:, kernel.POSTERIOR],
            read[:, kernel.POSTERIOR_VARIANCE],
            read[:, kernel.PREDICTED],
            read[:, kernel.PREDICTED_VARIANCE],
            read[:, kernel.INNOVATION],
            read[:, kernel.VARIANCE],
            read[:, kernel.LOG_LIKELIHOOD],
            read[:, kernel.N_OUT : kernel.N_OUT + point.parameters],
            node_rows(self.nominal.memory.block(0))[: size - 1, T, lane].copy(),
            float(state.d[lane]),
            state.P[lane, :size, :size],
            kept,
        )


def _check(point: FilterTrack, time_s: FloatArray) -> None:
    name, s = point.model.name, point.samples
    if np.any(np.diff(s.time_s) < 0.0):
        raise InputError(f"{name}: readings are not in order of time; sort them")
    # A reading ahead of the first step would be taken in it, at a fraction below 0: an extrapolation.
    outside = np.count_nonzero((s.time_s < time_s[0]) | (s.time_s > time_s[-1]))
    if outside:
        raise InputError(f"{name}: {outside} readings lie outside the march; leave them out")
    if np.any((s.node < 0) | (s.node >= point.mesh.nodes)):
        raise InputError(f"{name}: a reading is of a node that the mesh does not have (0 to {point.mesh.nodes - 1})")
    # Without noise the variance of an innovation is 0 where the state is known, and the update divides by it.
    read = ~np.isnan(s.lower_K)
    if not np.all(s.variance_K2[read] > 0.0):
        raise InputError(f"{name}: the noise variance of a reading is not above 0; declare or estimate noise_sigma_K")
    d = point.disturbance
    if not (np.all(np.asarray(point.noise_K2_s) >= 0.0) and d.density_1_s >= 0.0 and d.correlation_s > 0.0):
        raise InputError(f"{name}: noise of the process must not be negative, and its correlation time above 0 s")
