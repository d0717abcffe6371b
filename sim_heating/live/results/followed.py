"""What a link followed, for its report: readings with what was expected of them, estimates along the flight."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from sim_heating.base.arrays import FloatArray
from sim_heating.live.filtering.estimates import Innovation, LiveEstimate
from sim_heating.live.outputs.history import Thinned

EVERY_S = 2.0
"""Flight time between two estimates that are kept [s]."""
READING = ("time_s", "read_K", "expected_K", "sigma_K")
ESTIMATE = (
    "time_s",
    "alpha_deg",
    "surface_K",
    "surface_sigma_K",
    "bondline_K",
    "bondline_sigma_K",
    "ratio",
    "ratio_sigma",
    "ratio_declared",
)


class Followed:
    """Readings and estimates of a link, bounded however long it lasts: what is long past is thinned."""

    def __init__(self) -> None:
        self._readings: dict[tuple[str, str], Thinned] = {}
        self._estimates: dict[str, Thinned] = {}
        self._last_s = -math.inf

    def add_readings(self, innovations: Iterable[Innovation]) -> None:
        """Add readings, each as it was expected before it was taken."""
        for read in innovations:
            rows = self._readings.setdefault((read.point, read.sensor), Thinned(len(READING)))
            rows.add([read.time_s, read.read_K, read.predicted_K, math.sqrt(read.predicted_variance_K2)])

    def is_due(self, time_s: float | None) -> bool:
        """Whether an estimate of a flight time [s] is to be kept; also after a clock that went back."""
        return time_s is not None and not self._last_s <= time_s < self._last_s + EVERY_S

    def add_estimates(self, time_s: float, alpha_deg: float, estimates: Mapping[str, LiveEstimate]) -> None:
        """Add the estimates of all control points at a flight time [s] and angle of attack [deg], NaN for none."""
        self._last_s = time_s
        for name, estimate in estimates.items():
            rows = self._estimates.setdefault(name, Thinned(len(ESTIMATE)))
            rows.add(
                [
                    time_s,
                    alpha_deg,
                    estimate.surface_K,
                    estimate.surface_sigma_K,
                    estimate.bondline_K,
                    estimate.bondline_sigma_K,
                    estimate.state.ratio,
                    estimate.state.ratio_sigma,
                    estimate.state.ratio_declared,
                ]
            )

    def readings(self, point: str) -> dict[str, dict[str, FloatArray]]:
        """(reading,) columns READING of each sensor of a control point that was read, by its name."""
        return {
            sensor: dict(zip(READING, rows.all().T, strict=True))
            for (name, sensor), rows in self._readings.items()
            if name == point
        }

    def estimates(self, point: str) -> dict[str, FloatArray]:
        """(time,) columns ESTIMATE of a control point; empty where it has none."""
        rows = self._estimates.get(point)
        return {} if rows is None else dict(zip(ESTIMATE, rows.all().T, strict=True))
