"""Options of a running estimate, and what it gives: estimates, innovations and notices."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.estimation.filter.online import PointEstimate


@dataclass(frozen=True)
class LiveOptions:
    """How the estimator works.

    lateness_s     : how late a sample may come and still be used [s]
    jump_s         : a frame further ahead is a jump of the clock, or a gap [s]
    longest_step_s : longest step of the filter [s]
    wait_s         : longest time over which frames on a straight line are passed over [s]; 0 makes a step of each
    linearise_s    : time after which a point is linearised about its estimate again, where that has moved [s]; infinite
                     for never
    snapshot_s     : time between snapshots [s]
    start          : temperatures at the first frame: as the stack declares (`declared`), by conduction from the first
                     readings (`readings`), or the latter where these contradict the former (`auto`)
    again_s        : time since the start [s] at which the flight so far is filtered again about its estimate, and again
                     whenever that time has doubled; infinite for never
    start_s        : time of the first readings that a start is made from [s]
    node_noise_K_sqrt_s : white noise of every node [K s^-1/2]
    ratio_noise    : standard deviation [-] and correlation time [s] of a ratio that wanders; None for none
    corrects_mesh  : whether the error of the meshes is found beside the filter and corrected
    """

    lateness_s: float = 2.0
    jump_s: float = 2.5
    longest_step_s: float = 1.0
    wait_s: float = 0.4
    linearise_s: float = 1.0
    again_s: float = 60.0
    snapshot_s: float = 0.5
    start: Literal["auto", "declared", "readings"] = "auto"
    start_s: float = 2.0
    node_noise_K_sqrt_s: float = 0.0
    ratio_noise: tuple[float, float] | None = None
    corrects_mesh: bool = True


@dataclass(frozen=True)
class SensorEstimate:
    """What a sensor ought to show now: prediction and its standard deviation, noise of the sensor included [K]."""

    predicted_K: float
    sigma_K: float


@dataclass(frozen=True, eq=False)
class LiveEstimate:
    """Estimate of a control point at the time of the newest frame.

    surface_K, bondline_K and their _sigma_K : estimates and standard deviations [K]
    sensors : what each sensor ought to show, by name
    state   : node temperatures, ratio and parameters with covariances
    """

    surface_K: float
    surface_sigma_K: float
    bondline_K: float
    bondline_sigma_K: float
    sensors: Mapping[str, SensorEstimate]
    state: PointEstimate

    @property
    def parameters(self) -> dict[str, tuple[float, float]]:
        """Estimate and standard deviation of each parameter by name, in its unit."""
        sigma = np.sqrt(np.diag(self.state.covariance)).tolist()
        return dict(zip(self.state.names, zip(self.state.values.tolist(), sigma, strict=True), strict=True))


class Innovation(NamedTuple):
    """A reading as it was expected.

    innovation_K, variance_K2 : reading less prediction [K], and the variance that it ought to have [K2]; of a recorder
                                word those of docs/theory/filter.md, equation 10
    predicted_K, predicted_variance_K2 : the expected reading [K] and its variance with its noise [K2]
    read_K : the reading itself [K], the middle of the interval of a word
    is_left_out : whether it is a single spike, which the filter did not use
    """

    time_s: float
    point: str
    sensor: str
    innovation_K: float
    variance_K2: float
    predicted_K: float
    predicted_variance_K2: float
    read_K: float
    is_left_out: bool = False


LOG_COLUMNS = 8
"""Columns of what is logged of a reading: time [s], number of its sensor, then as Innovation from innovation_K on."""


class InnovationLog:
    """What was expected of the readings of each step, until no late sample can change it any more.

    sensor_names : point and name of each sensor, by its number
    """

    def __init__(self, sensor_names: Sequence[tuple[str, str]]) -> None:
        self._sensor_names = sensor_names
        self.clear()

    def clear(self) -> None:
        """Forget all steps and what was handed out."""
        # (reading, LOG_COLUMNS) of each step, in order of time and sensor, from step number `_first` on
        self._steps: list[FloatArray] = []
        self._first = 0
        self._handed_out_s = -math.inf

    @property
    def count(self) -> int:
        """Number of steps whose innovations are, or were, logged."""
        return self._first + len(self._steps)

    def append(self, step: FloatArray) -> None:
        """Log the (reading, LOG_COLUMNS) innovations of the next step."""
        self._steps.append(step)

    def cut(self, count: int) -> None:
        """Forget all steps but the first ones, so many as `count` was at an earlier time."""
        del self._steps[count - self._first :]

    def hand_out(self, until_s: float, now_s: float, first_kept: int) -> list[Innovation]:
        """Innovations since the last call up to a time, in order of time and sensor.

        until_s    : time up to which no late sample can change them [s];  now_s : end of the last step [s]
        first_kept : number of steps up to the oldest snapshot; those before it may be forgotten
        """
        if until_s <= self._handed_out_s:
            return []
        final = self._between(self._handed_out_s, min(until_s, now_s))
        self._handed_out_s = min(until_s, now_s)
        stale = first_kept - self._first
        if all(step[-1, 0] <= self._handed_out_s for step in self._steps[:stale] if len(step)):
            del self._steps[:stale]
            self._first += stale
        numbers, names = final[:, 1].astype(int).tolist(), self._sensor_names
        columns = [final[:, k].tolist() for k in range(2, LOG_COLUMNS - 1)]
        points, sensors = [names[n][0] for n in numbers], [names[n][1] for n in numbers]
        return list(map(Innovation, final[:, 0].tolist(), points, sensors, *columns, (final[:, -1] > 0.0).tolist()))

    def _between(self, after_s: float, until_s: float) -> FloatArray:
        """(reading, LOG_COLUMNS) innovations later than one time and up to another [s], in order of time and sensor."""
        chosen: list[FloatArray] = []
        for step in reversed(self._steps):
            if len(step) and step[-1, 0] <= after_s:
                break
            chosen.append(step[(step[:, 0] > after_s) & (step[:, 0] <= until_s)])
        return np.concatenate([np.zeros((0, LOG_COLUMNS)), *reversed(chosen)])


@dataclass
class Notices:
    """Messages of a running estimate to its user.

    messages : the last 100 lines
    refused  : number of frames that were not used as they came
    """

    messages: list[str] = field(default_factory=list)
    refused: int = 0

    def tell(self, message: str) -> None:
        """Add a line."""
        self.messages.append(message)
        del self.messages[:-100]

    def refuse(self, message: str) -> None:
        """Count a frame that is not used as it came, and tell why."""
        self.refused += 1
        self.tell(message)
