"""One reading, or two in a row, far from those of the same sensor before and after, as a disturbed recorder gives.

Readings are suspected where they are away from the one before them by many standard deviations, and the one after them,
where that is there already, comes back. Heating that is steep goes on, and a transition stays: neither comes back with
the next reading but one. Whether a suspected reading is used is for the filter: it is where it agrees with what is
expected.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from sim_heating.base.arrays import BoolArray, FloatArray, IntArray
from sim_heating.estimation.filter.online import Innovations, OnlineFilter, PointReadings
from sim_heating.live.filtering.timeline import Timeline, Word

JUMP_SIGMAS = 8.0
"""Standard deviations of its noise by which a suspected reading is away from the one before it [-]."""
COMES_BACK = 0.5
"""Part of that jump by which the reading after suspected ones is away from them, to the other side, at least [-]."""
NEAR_S = 2.5
"""Time within which a reading is compared with those before and after it [s]; it holds two in a row at 1 Hz."""
AWAY_SIGMAS = 6.0
"""Standard deviations, noise included, by which one that is left out is away from what is expected [-]."""


class SpikeGate:
    """Suspects a reading until the next one of its sensor, and decides by the filter whether it is used.

    sigma_K, lsb_K : (sensor,) standard deviation of the noise and step of the recorder, nan for none [K]
    """

    def __init__(self, sigma_K: FloatArray, lsb_K: FloatArray) -> None:
        lsb_K = np.nan_to_num(lsb_K)
        self.gate_K: list[float] = (JUMP_SIGMAS * sigma_K + lsb_K).tolist()
        self._half_lsb_K = 0.5 * lsb_K
        # times of suspected readings of a sensor whose next ones have not come, by its number
        self._undecided: dict[int, set[float]] = {}

    @property
    def is_waiting(self) -> bool:
        """Whether a suspected reading waits for the next one of its sensor."""
        return bool(self._undecided)

    def readings(self, timeline: Timeline, after_s: float, until_s: float) -> FloatArray:
        """(reading, 4) readings of a step: time [s], number of the sensor, value [K], 1 where it may be a spike.

        after_s, until_s : begin and end of the step [s]
        """
        readings = timeline.readings_between(after_s, until_s)
        rows = np.zeros((len(readings), 4))
        if readings:
            rows[:, :3] = readings
        jumping = {n for t, n in timeline.jumps if after_s - NEAR_S < t <= until_s}
        if jumping:
            near = timeline.readings_between(after_s - NEAR_S, until_s + NEAR_S)
            spikes = suspected([w for w in near if w[1] in jumping], after_s, self.gate_K)
            for k, (t, n, _) in enumerate(readings):
                rows[k, 3] = (t, n) in spikes
                if not spikes.get((t, n), True):
                    self._undecided.setdefault(n, set()).add(t)
        return rows

    def decide(self, number: int, time_s: float, oldest_s: float) -> float:
        """First time [s] from which to filter again, as a reading has come that decides on suspected ones before it.

        number, time_s : of the sensor, and time of the reading [s]
        oldest_s       : time [s] up to which no reading can be decided on any more
        returns        : infinite where nothing was decided
        """
        waiting = self._undecided.get(number)
        if not waiting:
            return math.inf
        decided = {suspected_s for suspected_s in waiting if suspected_s < time_s <= suspected_s + NEAR_S}
        self._undecided[number] = {suspected_s for suspected_s in waiting - decided if suspected_s > oldest_s}
        if not self._undecided[number]:
            del self._undecided[number]
        return min(decided, default=math.inf)

    def filter_without(
        self,
        f: OnlineFilter,
        take_step: Callable[[PointReadings], Innovations],
        readings: PointReadings,
        numbers: IntArray,
        doubtful: BoolArray,
        read_K: FloatArray,
    ) -> tuple[Innovations, BoolArray]:
        """Take a step without the readings that may be spikes, and again with those of them that were expected.

        take_step : takes the step of the filter with some readings
        numbers, doubtful, read_K : (reading,) of the sensor, whether it is suspected, and its temperature [K]
        returns   : innovations, and (reading,) which ones are left out
        """
        before = f.snapshot()
        innovations = take_step(readings._replace(lower_K=np.where(doubtful, np.nan, readings.lower_K)))
        away_K = np.abs(read_K - innovations.predicted_K) - self._half_lsb_K[numbers]
        is_out = doubtful & (away_K > AWAY_SIGMAS * np.sqrt(innovations.variance_K2))
        if np.any(doubtful & ~is_out & np.isfinite(read_K)):
            f.restore(before)
            innovations = take_step(readings._replace(lower_K=np.where(is_out, np.nan, readings.lower_K)))
        f.done_with(before)
        return innovations, is_out


def suspected(readings: Sequence[Word], from_s: float, gate_K: Sequence[float]) -> Mapping[tuple[float, int], bool]:
    """Readings later than a time [s] that look like spikes, alone or two in a row, by time and sensor.

    readings : readings in order of time, from NEAR_S before that time on
    gate_K   : by sensor, how far a reading may be from the one before it [K]
    returns  : whether the reading is there that decides

    >>> suspected([(0.0, 0, 500.0), (1.0, 0, 580.0), (2.0, 0, 501.0), (3.0, 0, 502.0)], 0.0, [10.0])
    {(1.0, 0): True}
    >>> suspected([(0.0, 0, 500.0), (1.0, 0, 580.0), (2.0, 0, 570.0), (3.0, 0, 503.0)], 0.0, [10.0])
    {(1.0, 0): True, (2.0, 0): True}
    >>> suspected([(0.0, 0, 500.0), (1.0, 0, 580.0), (2.0, 0, 640.0), (3.0, 0, 645.0), (4.0, 0, 647.0)], 0.0, [10.0])
    {}
    >>> suspected([(0.0, 0, 500.0), (1.0, 0, 580.0)], 0.0, [10.0])
    {(1.0, 0): False}
    """
    spikes: dict[tuple[float, int], bool] = {}
    by_sensor: dict[int, list[Word]] = {}
    for word in readings:
        by_sensor.setdefault(word[1], []).append(word)
    for n, series in by_sensor.items():
        good, k = 0, 1  # the last reading that is no spike, and the next one
        while k < len(series):
            count, is_decided = _spikes(series[good], series[k : k + 3], gate_K[n])
            for t, _, _ in series[k : k + count]:
                if t > from_s:
                    spikes[t, n] = is_decided
            if not is_decided:
                good, count = k, 1
            k += count
    return spikes


def _spikes(steady: Word, readings: Sequence[Word], gate_K: float) -> tuple[int, bool]:
    """How many of some readings, behind one that is no spike, look like spikes, and whether that is decided."""
    for count in (1, 2):
        is_decided = (
            _come_back(steady, readings[:count], readings[count : count + 1], gate_K)
            if count <= len(readings)
            else None
        )
        if is_decided is not None:
            return count, is_decided
    return 0, False


def _come_back(steady: Word, spikes: Sequence[Word], following: Sequence[Word], gate_K: float) -> bool | None:
    """Whether the reading after some is there and shows them to be spikes; None where they are none."""
    before_s, _, before_K = steady
    away_K = [read_K - before_K for _, _, read_K in spikes]
    if spikes[-1][0] - before_s > NEAR_S or min(map(abs, away_K)) <= gate_K:
        return None
    if not following or following[0][0] - spikes[0][0] > NEAR_S:
        return False
    after_K = following[0][2] - before_K
    return True if all((spike_K - after_K) * spike_K >= COMES_BACK * spike_K**2 for spike_K in away_K) else None
