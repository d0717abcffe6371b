"""Vehicle and limited control points of a study, as studies and optimal entries use them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

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


def vehicle_place(study: Path, vehicle: str) -> str | Path:
    """Directory of a vehicle relative to a study's file where it exists, else the vehicle's name."""
    directory = study.parent / vehicle
    return directory if (directory / "vehicle.toml").is_file() else vehicle
