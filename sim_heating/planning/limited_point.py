"""A control point with its temperature limits, as studies and optimal entries take it."""

from __future__ import annotations

from dataclasses import dataclass

from sim_heating.inputs.vehicle import ControlPoint


@dataclass(frozen=True)
class LimitedPoint:
    """A control point with the temperatures that it may not pass [K]; where there is none, infinite, or None."""

    point: ControlPoint
    surface_K: float
    bondline_K: float | None
