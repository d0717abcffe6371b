"""Options of a running estimate, and what it gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

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
