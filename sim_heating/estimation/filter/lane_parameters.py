"""What prior and readings say of the parameters of the points of an online filter, and where each is linearised."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.errors import InputError
from sim_heating.base.parameters import CLOCK_SKEW
from sim_heating.estimation.filter.march import FilterTrack


class Information(NamedTuple):
    """What prior and readings say of the parameters of all lanes (docs/theory/filter.md, equation 17).

    A     : (lane, parameter, parameter) sum of m' m'^T / S;  b : (lane, parameter) sum of m' nu / S
    prior : (lane, parameter, parameter) Lambda_0;  pull : (lane, parameter) Lambda_0 (p_0 - p_m)
    at    : (lane, parameter) p_0, where the filter is linearised, each in its unit
    """

    A: FloatArray
    b: FloatArray
    prior: FloatArray
    pull: FloatArray
    at: FloatArray


@dataclass(frozen=True)
class Prior:
    """What is known of a parameter before any reading, in its unit; sigma above 0 and finite."""

    mean: float
    sigma: float


class LaneParameters:
    """Parameters of the points of an online filter, one lane each.

    points  : tracks of the points;  lane_of : lane of each
    priors  : of the parameters of each point by name, those of clock and sensors behind the others
    columns : number of parameters of the point that has most of them
    raises  : InputError for a prior that is missing, or whose sigma is not above 0 and finite

    `information` has the priors alone after `reset`. Derived in docs/theory/filter.md, equation 17.
    """

    def __init__(
        self, points: Sequence[FilterTrack], priors: Sequence[Mapping[str, Prior]], lane_of: IntArray, columns: int
    ) -> None:
        self._points, self._lane_of, self._columns = tuple(points), lane_of, columns
        self.names = [_parameter_names(p, prior) for p, prior in zip(points, priors, strict=True)]
        self._priors = [[prior[name] for name in names] for names, prior in zip(self.names, priors, strict=True)]
        self.reset()

    def reset(self) -> None:
        """No reading is known, and each point is linearised at the means of its priors."""
        lanes, m = len(self._points), self._columns
        information = Information(
            np.zeros((lanes, m, m)),
            np.zeros((lanes, m)),
            np.zeros((lanes, m, m)),
            np.zeros((lanes, m)),
            np.zeros((lanes, m)),
        )
        for i, priors in enumerate(self._priors):
            lane = self._lane_of[i]
            # parameters that another point has more of: known exactly, without effect
            information.prior[lane] = np.diag([*(p.sigma**-2.0 for p in priors), *[1.0] * (m - len(priors))])
            information.at[lane, : len(priors)] = [p.mean for p in priors]
        self.bounds = [self._bounds_of(p) for p in self._points]
        for names, priors, bounds in zip(self.names, self._priors, self.bounds, strict=True):
            for k, name in enumerate(names):
                if name == CLOCK_SKEW.name:  # readings come at the times of its mean: it stays linearised there
                    bounds[0][k] = bounds[1][k] = priors[k].mean
        self.information = information

    def linearise_at(self, i: int, values: FloatArray) -> None:
        """Linearise point number i about given parameters within their bounds, before any reading.

        values : (parameter,), each in its unit
        """
        info, lane = self.information, self._lane_of[i]
        mean = info.at[lane].copy()
        info.at[lane, : len(values)] = np.clip(values, *(b[: len(values)] for b in self.bounds[i]))
        info.pull[lane] = info.prior[lane] @ (info.at[lane] - mean)

    def values(self, i: int) -> dict[str, float]:
        """Values of the parameters of point number i where it is linearised, each in its unit ([-] for a ratio)."""
        return dict(zip(self.names[i], self.information.at[self._lane_of[i]].tolist(), strict=False))

    def _bounds_of(self, point: FilterTrack) -> tuple[FloatArray, FloatArray]:
        bounds = np.tile([[-np.inf], [np.inf]], self._columns)
        for k, name in enumerate(point.names):
            definition = point.model.definition(name)
            bounds[:, k] = definition.lower, definition.upper
        return bounds[0], bounds[1]


def _parameter_names(point: FilterTrack, priors: Mapping[str, Prior]) -> tuple[str, ...]:
    """Names of the parameters of a point: of its march, then those that only its readings depend on."""
    of_march = point.names
    others = tuple(name for name in priors if name not in of_march)
    if not priors.keys() >= {*of_march} or len(of_march) + len(others) != point.parameters:
        raise InputError(
            f"{point.model.name}: priors of {', '.join(priors) or 'nothing'} for {point.parameters} parameters, "
            f"{', '.join(of_march)} among them; give one for each"
        )
    for name, prior in priors.items():
        if not (0.0 < prior.sigma < math.inf and math.isfinite(prior.mean)):
            raise InputError(
                f"{point.model.name}: the prior of `{name}` is {prior.mean:g} +- {prior.sigma:g}; a running estimate "
                "needs a mean, and a sigma above 0 and finite"
            )
    return of_march + others
