"""The past of a link for a page that is opened late: bounded, however long the link lasts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.live.state import PointState, State

RECENT = 1200
"""Latest samples, kept as they came: two minutes at 10 Hz."""
OLDER = 1200
"""Most samples kept of the time before."""
SCALARS = ("surface_K", "surface_sigma_K", "bondline_K", "bondline_sigma_K", "ratio", "ratio_sigma", "ratio_declared")
SENSOR = ("measured_K", "measured_s", "predicted_K", "sigma_K")
CONDITIONS = ("alpha_deg", "mach")
DECIMALS = 5


class Thinned:
    """Rows of numbers: the latest as they came, those before at equal distances that double as they fill up.

    >>> from sim_heating.live.outputs.history import Thinned
    >>> rows = Thinned(1, recent=4, older=4)
    >>> for k in range(20):
    ...     rows.add([k])
    >>> rows.all()[:, 0].tolist()
    [0.0, 4.0, 8.0, 12.0, 16.0, 17.0, 18.0, 19.0]
    """

    def __init__(self, width: int, recent: int = RECENT, older: int = OLDER) -> None:
        self._recent = np.full((recent, width), np.nan)
        self._older = np.full((older, width), np.nan)
        self._count, self._kept, self._stride = 0, 0, 1

    def add(self, row: Sequence[float]) -> None:
        """Add a row; the oldest of the latest is kept or dropped."""
        slot = self._count % len(self._recent)
        gone = self._count - len(self._recent)
        if gone >= 0 and gone % self._stride == 0:
            if self._kept == len(self._older):  # every second one stays
                half = self._older[::2].copy()
                self._older[: len(half)] = half
                self._kept, self._stride = len(half), 2 * self._stride
            if gone % self._stride == 0:
                self._older[self._kept] = self._recent[slot]
                self._kept += 1
        self._recent[slot] = row
        self._count += 1

    def all(self) -> FloatArray:
        """(row, width) in the order in which they came; a copy."""
        turn = self._count % len(self._recent) if self._count > len(self._recent) else 0
        recent = np.roll(self._recent[: self._count], -turn, axis=0)
        return np.concatenate([self._older[: self._kept], recent])


class History:
    """Past of all control points of a link."""

    def __init__(self) -> None:
        self._columns: dict[str, list[str]] = {}
        self._rows: dict[str, Thinned] = {}

    def add(self, state: State) -> None:
        """Add a state; one without a flight time is none of the past."""
        if state.time_s is None:
            return
        for name, point in state.points.items():
            row = _row(state, point)
            if self._columns.get(name) != list(row):  # the first, or the point has other sensors now
                self._columns[name], self._rows[name] = list(row), Thinned(len(row))
            self._rows[name].add(list(row.values()))

    def columns(self, point: str) -> dict[str, FloatArray]:
        """Columns of a control point, (sample,) each, NaN where not known; empty without any of this name.

        `time_s`, conditions, temperatures and ratio by their names; of a sensor `sensors.NAME.measured_K` and so on
        """
        if point not in self._rows:
            return {}
        return dict(zip(self._columns[point], self._rows[point].all().T, strict=True))


def _row(state: State, point: PointState) -> dict[str, float]:
    values: dict[str, float | None] = {"time_s": state.time_s}
    values |= {name: state.conditions.get(name) for name in CONDITIONS}
    values |= {name: getattr(point, name) for name in SCALARS}
    for sensor, estimate in point.sensors.items():
        values |= {f"sensors.{sensor}.{name}": getattr(estimate, name) for name in SENSOR}
    return {name: np.nan if value is None else float(value) for name, value in values.items()}


def columns_json(columns: Mapping[str, FloatArray]) -> dict[str, Any]:
    """Columns as lists of rounded numbers, null for what is not known."""
    return {
        name: [v if math.isfinite(v) else None for v in np.round(values, DECIMALS).tolist()]
        for name, values in columns.items()
    }
