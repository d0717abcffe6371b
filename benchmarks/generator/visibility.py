"""The residual of an effect after a refit of scale and slopes, and its resemblance to other effects.

Small errors: readings are taken as linear in the parameters, y = J p, and the remainder of the effect's change of the
readings after least squares is its residual. All is weighted with each sensor's noise floor and marched on SPARSE of
the cells: enough for differences.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.challenge.deviation import Deviation
from benchmarks.challenge.recorder import floor_K, used
from benchmarks.generator.case import Case
from benchmarks.generator.point import SLOPE_ERRORS

FloatArray = NDArray[np.float64]

SPARSE = 0.3
"""Share of the cells."""


@dataclass(frozen=True)
class Seen:
    """Influence of an effect on the fitted samples of the used sensors.

    slopes    : (reading, 6) change with scale and slopes, over the floor
    change    : (reading,) change by the effect, over the floor
    visibility_K, residual_K : RMS change before and after the refit
    residual_over_floor      : RMS of the residual over the floor where it exceeds two floors, 0 below 10 samples
    """

    slopes: FloatArray
    change: FloatArray
    visibility_K: float
    residual_K: float
    residual_over_floor: float


@dataclass(frozen=True)
class Bench:
    """A case at its fitted samples: readings without effect [K] and the slopes of `Seen`."""

    case: Case
    t: FloatArray
    fit: NDArray[np.bool_]
    plain_K: FloatArray
    slopes: FloatArray

    def change(self, deviation: Deviation) -> FloatArray:
        """(reading,) change by an effect, over the floor."""
        return stacked(self.case, self.case.indicated(self.t, deviation, refine=SPARSE) - self.plain_K, self.fit)


def bench(case: Case, t: FloatArray, fit: NDArray[np.bool_]) -> Bench:
    """The case without effect, and its slopes by differences."""
    plain = case.indicated(t, refine=SPARSE)
    return Bench(case, t, fit, plain, _slopes(case, t, fit, plain))


def see(on: Bench, deviation: Deviation) -> Seen:
    """Influence of an effect on a case."""
    case, J, change = on.case, on.slopes, on.change(deviation)
    floors = weights(case)
    left = remainder(J, change)
    acts = np.abs(left) > 2.0
    over = float(np.sqrt(np.mean(left[acts] ** 2))) if np.count_nonzero(acts) >= 10 else 0.0
    scale = np.repeat(floors, np.count_nonzero(on.fit))
    K = [float(np.sqrt(np.mean((v * scale) ** 2))) for v in (change, left)]
    return Seen(J, change, K[0], K[1], over)


def weights(case: Case) -> FloatArray:
    """Noise floor of each used sensor [K]."""
    return np.array([floor_K(case.point.sensors[i]) for i in used(case.point.sensors)])


def stacked(case: Case, readings_K: FloatArray, fit: NDArray[np.bool_]) -> FloatArray:
    """Fitted readings of the used sensors in one row, over their floors."""
    return (readings_K[fit][:, used(case.point.sensors)] / weights(case)).T.ravel()


def remainder(J: FloatArray, change: FloatArray) -> FloatArray:
    """Remainder of a change after least squares."""
    size = np.linalg.norm(J, axis=0)
    moved = J[:, size > 1e-9] / size[size > 1e-9]
    return change - moved @ np.linalg.lstsq(moved, change, rcond=1e-9)[0]


def _slopes(case: Case, t: FloatArray, fit: NDArray[np.bool_], plain_K: FloatArray) -> FloatArray:
    ratio = case.point.ratio
    columns = [(case.indicated(t, scale=ratio.scale + 0.01, refine=SPARSE) - plain_K) / 0.01]
    for i, share in enumerate(SLOPE_ERRORS):
        size = share * case.r_0
        d = ratio.d.copy()
        d[i] += size
        columns.append((case.indicated(t, d=d, refine=SPARSE) - plain_K) / size)
    return np.column_stack([stacked(case, c, fit) for c in columns])
