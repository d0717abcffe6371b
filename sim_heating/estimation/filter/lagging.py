"""Thermocouples that lag, in a running filter: their readings are those of the place, plus what the lag takes away.

    y = T + o,    tau dy/dt = T - y

The offset o and its derivatives to the parameters go along with the filter as functions of its march alone, as the
batch filter has them (records.filter_samples): a reading corrects the temperature of the place and
the lagging one by as much. docs/theory/filter.md, equation 23.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.kernels.block import HEAD_ROWS, LANES, NODE_ROWS, T
from sim_heating.estimation.filter.kernel import CONSTANT
from sim_heating.estimation.filter.march import FilterTrack
from sim_heating.estimation.filter.online import OnlineFilter, PointReadings, Prior, no_readings


class Lagging(NamedTuple):
    """Thermocouples that lag among the points of one filter.

    number : (lagging,) of each among all sensors of the link, increasing
    point, node : (lagging,) number of its point in the filter, and of the node that it reads
    tau_s  : (lagging,) time constants [s]
    """

    number: IntArray
    point: IntArray
    node: IntArray
    tau_s: FloatArray


class LaggingFilter(OnlineFilter):
    """An online filter of points some of whose thermocouples lag.

    lagging : those;  the others as of OnlineFilter

    `behind_lags` before each `step` or `gap`. Derived in docs/theory/filter.md, equation 23.
    """

    def __init__(
        self,
        points: Sequence[FilterTrack],
        priors: Sequence[Mapping[str, Prior]],
        corrects_mesh: bool,
        lagging: Lagging,
    ) -> None:
        super().__init__(points, priors, corrects_mesh)
        self.lagging = lagging
        count, m = len(lagging.number), self._size[1]
        self._offset_K, self._per = np.zeros(count), np.zeros((count, m))
        # whether the wall was at rest when it began, for which the offset is 0; else found with the first step
        self._is_known = np.zeros(count)

    def begin(
        self,
        time_s: float,
        conditions: FloatArray,
        initial_K: Sequence[FloatArray | None] | None = None,
        covariance_K2: Sequence[FloatArray | None] | None = None,
        values: Sequence[FloatArray] | None = None,
    ) -> None:
        """Start at a time; a wall whose temperatures are known exactly was at rest, so that its sensors have no lag.

        time_s        : [s];  conditions : (point, condition) there
        initial_K     : (node,) temperatures of each point [K];  covariance_K2 : (node, node) of them [K2]
        values        : (parameter,) of each point, where it is linearised; at the means of its priors where None
        """
        super().begin(time_s, conditions, initial_K, covariance_K2, values)
        self._offset_K[:], self._per[:] = 0.0, 0.0
        spread = list(covariance_K2 or [None] * len(self.points))
        rests = np.array([C is None or not np.any(C) for C in spread])
        self._is_known[:] = rests[self.lagging.point]

    def behind_lags(
        self, time_s: FloatArray, conditions: FloatArray, readings: PointReadings, numbers: IntArray
    ) -> PointReadings:
        """Readings of the next steps with what lags take from them in their biases and direct terms.

        time_s     : (step,) ends of the steps [s];  conditions : (point, step, condition) there
        readings   : in order of time, up to the last of the steps;  numbers : (reading,) of their sensors
        returns    : the readings with biases [K] and direct terms of lagging sensors changed
        """
        lags = self.lagging
        slot = np.searchsorted(lags.number, numbers)
        slot[slot == len(lags.number)] = 0
        behind = lags.number[slot] == numbers
        bias, direct = readings.bias_K.copy(), readings.direct.copy()
        (begin_s, T_0, S_0), before = (self.now_s, *self._at_places()), self.snapshot()
        step = np.searchsorted(time_s, readings.time_s)
        offset, per, is_known = self._offset_K.copy(), self._per.copy(), self._is_known > 0.0
        for k, end_s in enumerate(time_s.tolist()):
            self.step(time_s[k : k + 1], conditions[:, k : k + 1], no_readings(self._size[1]))
            T_1, S_1 = self._at_places()
            slope, per_slope = (T_1 - T_0) / (end_s - begin_s), (S_1 - S_0) / (end_s - begin_s)
            if not np.all(is_known):  # as behind the slope of the first step
                offset = np.where(is_known, offset, -lags.tau_s * slope)
                per = np.where(is_known[:, np.newaxis], per, -lags.tau_s[:, np.newaxis] * per_slope)
                is_known[:] = True
            for q in np.flatnonzero(behind & (step == k)):
                j, since_s = slot[q], readings.time_s[q] - begin_s
                bias[q] += readings.gain[q] * _offset(offset[j], slope[j], since_s, lags.tau_s[j])
                direct[q, :, CONSTANT] += readings.gain[q] * _offset(per[j], per_slope[j], since_s, lags.tau_s[j])
            offset = _offset(offset, slope, end_s - begin_s, lags.tau_s)
            per = _offset(per, per_slope, end_s - begin_s, lags.tau_s[:, np.newaxis])
            begin_s, T_0, S_0 = end_s, T_1, S_1
        self.restore(before)
        self.done_with(before)
        self._offset_K[:], self._per[:], self._is_known[:] = offset, per, 1.0
        return readings._replace(bias_K=bias, direct=direct)

    def offset_of(self, number: int, values: FloatArray) -> tuple[float, FloatArray]:
        """What its lag adds to the temperature of a sensor's place now [K], and (parameter,) derivatives.

        number : of the sensor, which lags;  values : (parameter,) estimates, each in its unit

        Derived in docs/theory/filter.md, equation 23.
        """
        j = int(np.searchsorted(self.lagging.number, number))
        per = self._per[j, : len(values)]
        at = self._information.at[self._lane_of[self.lagging.point[j]], : len(values)]
        return float(self._offset_K[j] + per @ (values - at)), per

    def linearise_again(self, i: int, *moved: float) -> bool:
        """Linearise a point about its present estimate, and its lags with it."""
        at = self._information.at[self._lane_of[i]]
        before = at.copy()
        if not super().linearise_again(i, *moved):
            return False
        of_point = self.lagging.point == i
        self._offset_K[of_point] += self._per[of_point] @ (at - before)
        return True

    def _at_places(self) -> tuple[FloatArray, FloatArray]:
        """(lagging,) temperatures of the places now [K], and (lagging, parameter) their sensitivities."""
        lane, node = np.asarray(self._lane_of)[self.lagging.point], self.lagging.node
        rows = (HEAD_ROWS + node * NODE_ROWS + T) * LANES + lane
        return self._group.B[rows], self._state_now.S[lane, node].copy()

    def _changing(self) -> tuple[FloatArray | IntArray, ...]:
        return (*super()._changing(), self._offset_K, self._per, self._is_known)


def online_filter(
    points: Sequence[FilterTrack], priors: Sequence[Mapping[str, Prior]], corrects_mesh: bool, lagging: Lagging
) -> OnlineFilter:
    """A filter of these points; one without thermocouples that lag takes each step once."""
    if len(lagging.number):
        return LaggingFilter(points, priors, corrects_mesh, lagging)
    return OnlineFilter(points, priors, corrects_mesh)


def _offset(offset: FloatArray, slope: FloatArray, since_s: FloatArray | float, tau_s: FloatArray) -> FloatArray:
    """Offset of a lagging value so much later, where what it follows goes on with a constant slope.

        o = -tau slope + (o_0 + tau slope) exp(-t / tau)

    That is `base.kernels.lag.lag_step` less what it follows.
    """
    ramp = -tau_s * slope
    return np.asarray(ramp + (offset - ramp) * np.exp(-since_s / tau_s))
