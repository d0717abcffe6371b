"""Temperatures that a running estimate begins with, from the declaration of the wall or from the first readings."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError, RunError
from sim_heating.estimation.starts import START_SIGMA_K
from sim_heating.live.filtering.estimates import LiveOptions, Notices
from sim_heating.live.filtering.heated_start import reading_sigma_K, start_of_heated
from sim_heating.live.filtering.points import ConditionsOfFrame, LivePoint
from sim_heating.live.filtering.sensors import SensorTable
from sim_heating.live.filtering.timeline import Timeline
from sim_heating.live.types import Frame
from sim_heating.march.point import initial_temperatures

START_AGREES = 4.0
"""Readings within this many standard deviations of the declared start confirm it [-]."""

Profile = tuple[FloatArray, FloatArray]
"""(node,) temperatures [K] and their (node, node) covariance [K2]."""


class Start:
    """Waits until there is enough to begin with, and chooses the temperatures of each point.

    source   : the control points, and what a frame is for them;  sensors : of all points
    notices  : messages to the user
    profiles : of each point, once the start is made
    """

    def __init__(self, source: ConditionsOfFrame, sensors: SensorTable, options: LiveOptions, notices: Notices) -> None:
        self._source, self._sensors, self._options, self._notices = source, sensors, options, notices
        self.profiles: list[Profile] = []

    def make(self, timeline: Timeline) -> tuple[Frame, FloatArray] | None:
        """The first frame and the (point, condition) vectors there, once `profiles` are made; None before."""
        if not timeline.frames:
            return None
        first, start_s = timeline.frames[0], self._options.start_s
        # late samples of the start are in by then
        wait_s = self._options.lateness_s + (0.0 if self._options.start == "declared" else start_s)
        if timeline.newest_s < first.time_s + wait_s:
            return None
        read_K = self._sensors.first_readings(timeline.readings_between(-math.inf, first.time_s + start_s))
        try:
            vectors = self._source.conditions(first)
        except InputError as error:
            self._notices.refuse(f"{error}; the link begins later")
            timeline.forget(math.nextafter(first.time_s, math.inf))
            return None
        self.profiles = [self._profile(i, p, read_K, vectors[i]) for i, p in enumerate(self._source.points)]
        return first, vectors

    def _profile(self, i: int, point: LivePoint, read_K: Mapping[int, float], conditions: FloatArray) -> Profile:
        """Temperatures of a point at the start.

        read_K : first readings [K], by number of the sensor;  conditions : (condition,) of the point
        """
        declared = initial_temperatures(point.model.construction, point.mesh)
        sensors = [(k, n) for k, n in enumerate(self._sensors.of_point[i]) if n in read_K]
        by_node = {point.mesh.sensors[k]: read_K[n] for k, n in sensors}

        def largest_miss_K(profile: FloatArray) -> float:
            return max((abs(T - float(profile[node])) for node, T in by_node.items()), default=0.0)

        apart_K = largest_miss_K(declared)
        sigmas_K = [self._sensors.sigma_K[n] for _, n in sensors]
        exactly = declared, np.zeros((len(declared), len(declared)))
        agrees = apart_K <= START_AGREES * max([*sigmas_K, START_SIGMA_K / START_AGREES])
        if self._options.start == "declared" or (self._options.start == "auto" and agrees):
            return exactly
        if not by_node:
            self._notices.tell(f"{point.name}: no reading to start from; the declared temperatures are taken")
            return exactly
        try:
            profile, covariance = start_of_heated(point.model, point.mesh, by_node, conditions)
        except RunError as error:
            reason = str(error).splitlines()[0]
            self._notices.tell(
                f"{point.name}: no heating conducts to its first readings ({reason}); the declared temperatures are "
                "taken"
            )
            return exactly
        miss_K = largest_miss_K(profile)
        if miss_K > START_AGREES * reading_sigma_K(apart_K):
            self._notices.tell(
                f"{point.name}: no history of heating agrees with its first readings; the start misses them by up to "
                f"{miss_K:.0f} K, and its bounds are as wide"
            )
        return profile, covariance
