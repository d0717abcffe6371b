"""Vehicle and limited control points of a study, as studies and optimal entries use them."""

from __future__ import annotations

from dataclasses import dataclass

from sim_heating.inputs.vehicle import ControlPoint


@dataclass(frozen=True)
class LimitedPoint:
    """A control point with its temperature limits.

    surface_K  : [K]; infinite where there is no limit
    bondline_K : [K]; None where there is no limit
    """

    point: ControlPoint
    surface_K: float
    bondline_K: float | None
