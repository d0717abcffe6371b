"""March of all filters over one step with its readings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.kernels.block import LANES, N_CONDITIONS, P_SURFACE
from sim_heating.estimation.filter import online
from sim_heating.estimation.filter.lagging import LaggingFilter, online_filter
from sim_heating.estimation.filter.march import Disturbance, FilterTrack, Samples
from sim_heating.estimation.inference.likelihood import middle_K
from sim_heating.live.filtering.estimates import LiveOptions
from sim_heating.live.filtering.parameters import default_prior, is_of_march
from sim_heating.live.filtering.points import LivePoint
from sim_heating.live.filtering.sensors import LeftOut, SensorTable
from sim_heating.live.filtering.spikes import SpikeGate
from sim_heating.live.filtering.timeline import Timeline

GAP_ERROR_1_S, LARGEST_GAP_ERROR = 0.01, 0.3
"""Standard deviation of the heating over a gap, for each second of it, and at most, over the heating itself [1/s], [-]:
conditions that go straight from one end of the gap to the other are not those that were flown."""


class StepMarch:
    """Marches filters over a step, with its readings and without single spikes.

    sensors  : of all points;  gate : suspects single readings;  timeline : readings in order
    left_out : times from which on, and to which, each sensor is left out
    """

    def __init__(self, sensors: SensorTable, gate: SpikeGate, timeline: Timeline, options: LiveOptions) -> None:
        self._sensors, self._gate, self._timeline, self._options = sensors, gate, timeline, options
        self.left_out = [LeftOut() for _ in sensors.sensors]

    def readings_between(self, after_s: float, until_s: float) -> FloatArray:
        """(reading, 4) readings between two times [s]: time [s], number of the sensor, value [K], 1 if suspected."""
        return self._gate.readings(self._timeline, after_s, until_s)

    def march(
        self,
        filters: Sequence[online.OnlineFilter],
        begin_s: float,
        first_vectors: FloatArray,
        end_s: float,
        vectors: FloatArray,
        rows: FloatArray,
        linearise: bool = True,
    ) -> FloatArray:
        """March filters from one time to another [s] with readings, in steps of `longest_step_s` at most.

        first_vectors, vectors : (point, condition) at both ends
        rows                   : (reading, 4) time [s], number of the sensor, value [K], 1 where it may be a spike
        linearise              : whether points whose time has come are linearised again
        returns                : (reading, LOG_COLUMNS) what is logged of the readings
        """
        steps = max(1, math.ceil((end_s - begin_s) / self._options.longest_step_s - 1e-9))
        fraction = np.arange(1, steps + 1) / steps
        time_s = begin_s + fraction * (end_s - begin_s)
        time_s[-1] = end_s
        histories = first_vectors[:, np.newaxis] + fraction[:, np.newaxis] * (vectors - first_vectors)[:, np.newaxis]
        histories[:, -1] = vectors
        # conditions are known at the ends of a gap alone
        gap_error = min(GAP_ERROR_1_S * (end_s - begin_s), LARGEST_GAP_ERROR) if steps > 1 else 0.0
        number, doubtful = rows[:, 1].astype(np.int64), rows[:, 3] > 0.0
        readings, is_out = self._sensors.readings(rows, filters, self.left_out), np.zeros(len(rows), dtype=bool)
        read_K = middle_K(readings.lower_K, readings.upper_K)
        columns = np.empty((len(rows), 4))
        for k, f in enumerate(filters):
            first = k * LANES
            history = histories[first : first + LANES]
            of_filter = np.flatnonzero((readings.point >= first) & (readings.point < first + LANES))
            lane_readings = online.readings_of_filter(readings, of_filter, first, f.most_parameters)
            if isinstance(f, LaggingFilter):
                lane_readings = f.behind_lags(time_s, history, lane_readings, number[of_filter])

            def take_step(
                r: online.PointReadings, f: online.OnlineFilter = f, history: FloatArray = history
            ) -> online.Innovations:
                return f.gap(time_s, history, r, gap_error) if gap_error else f.step(time_s, history, r)

            if np.any(doubtful[of_filter]):
                innovations, is_out[of_filter] = self._gate.filter_without(
                    f, take_step, lane_readings, number[of_filter], doubtful[of_filter], read_K[of_filter]
                )
            else:
                innovations = take_step(lane_readings)
            columns[of_filter] = np.column_stack(innovations)
        predicted, variance = columns[:, 0], columns[:, 1]
        innovation = np.where(is_out, read_K - predicted, columns[:, 2])
        of_innovation = np.where(is_out, variance, columns[:, 3])
        judged = (innovation, of_innovation, predicted, variance, read_K, is_out)
        columns = np.column_stack([rows[:, 0], rows[:, 1], *judged])
        if linearise:
            self._linearise(filters, begin_s, end_s)
        return columns[np.isfinite(columns[:, 2])]

    def _linearise(self, filters: Sequence[online.OnlineFilter], begin_s: float, end_s: float) -> None:
        """Linearise again those points whose time has come, one after the other over `linearise_s`."""
        every_s = self._options.linearise_s
        if not math.isfinite(every_s):
            return
        count = len(self._sensors.of_point)
        for i in range(count):
            phase = i / count
            if math.floor(end_s / every_s - phase) > math.floor(begin_s / every_s - phase):
                filters[i // LANES].linearise_again(i % LANES)


def make_filters(
    points: Sequence[LivePoint], sensors: SensorTable, priors: Mapping[str, online.Prior], options: LiveOptions
) -> list[online.OnlineFilter]:
    """Filters of all points, LANES points in each."""
    tracks, of_tracks = zip(*(_track(p, sensors.names[i], priors, options) for i, p in enumerate(points)), strict=True)
    return [
        online_filter(tracks[k : k + LANES], of_tracks[k : k + LANES], options.corrects_mesh, sensors.lagging(k))
        for k in range(0, len(points), LANES)
    ]


def warm_up(filters: Sequence[online.OnlineFilter]) -> None:
    """Compile, or read from the cache, all that a step runs, so that no sample waits for it."""
    for f in filters:
        still = np.zeros((len(f.points), N_CONDITIONS))
        still[:, P_SURFACE] = 1000.0
        f.begin(0.0, still, [np.full(p.mesh.nodes, 300.0) for p in f.points])
        f.step(np.array([1.0]), still[:, np.newaxis], online.no_readings(max(p.parameters for p in f.points)))
        f.linearise_again(0)
        f.estimates()


def _track(
    point: LivePoint, names: tuple[str, ...], priors: Mapping[str, online.Prior], options: LiveOptions
) -> tuple[FilterTrack, dict[str, online.Prior]]:
    """A point as the filter takes it, and the priors of its parameters."""
    march = tuple(n for n in names if is_of_march(n))
    nothing = np.zeros(0)
    empty = Samples(nothing, np.zeros(0, dtype=np.int64), *(nothing,) * 5)
    wanders = Disturbance() if options.ratio_noise is None else Disturbance.gauss_markov(*options.ratio_noise)
    columns = np.zeros((point.mesh.nodes, len(names) - len(march)))
    noise_K2_s, extra = options.node_noise_K_sqrt_s**2, columns if columns.shape[1] else None
    track = FilterTrack(point.model, point.mesh, empty, march, None, extra, noise_K2_s=noise_K2_s, disturbance=wanders)
    return track, {n: priors[n] if n in priors else default_prior(point.model, n, point.sensors) for n in names}
