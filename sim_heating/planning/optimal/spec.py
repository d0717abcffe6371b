"""A study of an optimal entry as a file: vehicle, initial and final state, and temperature limits.

format = "optimal-entry/1"
title = "..."
vehicle = "orbiter"                 # a vehicle's name, or its directory relative to the study
probability = 0.95                  # of keeping all limits, by the sigma of the tables; default: tables as declared
[initial]                           # as in a scenario's [trajectory.initial]
[end]                               # altitude_m, velocity_m_s, gamma_deg
[state]                             # as in a scenario's [trajectory.vehicle]
[[limit]]                           # control_point; surface_K, bondline_K in place of the vehicle's own
[flight_limits]                     # dynamic_pressure_Pa, normal_load_g, alpha_rate_deg_s, bank_rate_deg_s, likewise
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from pydantic import Field, field_validator

from sim_heating.base.errors import InputError
from sim_heating.base.files import Declared, display_path, raise_problems, read_toml
from sim_heating.inputs.vehicle import ControlPoint, Vehicle, load_vehicle, vehicle_place
from sim_heating.inputs.vehicle_files import FlightLimits
from sim_heating.planning.limited_point import LimitedPoint
from sim_heating.trajectory.aero import load_aero
from sim_heating.trajectory.spec import Initial, VehicleState


class FinalState(Declared):
    """State at the end of the entry."""

    quantities: ClassVar = {"velocity_m_s": "flight_speed_m_s"}

    altitude_m: float = Field(gt=0.0, description="altitude in m")
    velocity_m_s: float = Field(gt=0.0, description="speed in m/s")
    gamma_deg: float = Field(ge=-80.0, le=80.0, description="path angle in deg")


class Limit(Declared):
    """Temperature limits of one control point; a limit that is not given is the vehicle's own."""

    control_point: str
    surface_K: float | None = Field(default=None, gt=0.0, description="highest surface temperature in K")
    bondline_K: float | None = Field(default=None, gt=0.0, description="highest bondline temperature in K")

    def limited(self, point: ControlPoint) -> LimitedPoint:
        """The control point with these limits, and the vehicle's own in place of those that are not given."""
        bondline_K = point.limits.bondline_K if self.bondline_K is None else self.bondline_K
        return LimitedPoint(point, self.surface_K or point.limits.surface_K, bondline_K)


class OptimalStudyFile(Declared):
    """Contents of a study file.

    alpha_limits_deg : lowest and highest angle of attack [deg]
    bank_limits_deg : lowest and highest bank [deg], negative to the left; cross-range is sought on the side with more
    duration_s  : shortest and longest entry [s]
    soak_s      : length of the soak after the end, without heating from outside [s]
    tolerance_K : largest margin at which an active limit is met [K]
    intervals   : number of intervals of the first mesh
    mesh_tolerance : error of an interval over the typical size of a state
    """

    format: str = Field(pattern="^optimal-entry/1$", description='"optimal-entry/1"')
    title: str
    vehicle: str
    note: str = ""
    initial: Initial
    end: FinalState
    state: VehicleState = VehicleState()
    alpha_limits_deg: list[float] = Field(min_length=2, max_length=2, description="[lowest, highest] in deg")
    bank_limits_deg: list[float] = Field(default=[-89.0, 1.0], min_length=2, max_length=2)
    duration_s: list[float] = Field(default=[600.0, 5000.0], min_length=2, max_length=2)
    probability: float | None = Field(default=None, gt=0.5, lt=1.0, description="above 0.5, below 1")
    limit: list[Limit] = Field(default=[])
    flight_limits: FlightLimits = Field(default=FlightLimits(), description="in place of the vehicle's own")
    soak_s: float = Field(default=1800.0, ge=0.0, le=36000.0)
    tolerance_K: float = Field(default=1.0, gt=0.0, le=50.0)
    intervals: int = Field(default=40, ge=5, le=500)
    mesh_tolerance: float = Field(default=1e-5, gt=0.0, lt=0.1)

    @field_validator("alpha_limits_deg", "bank_limits_deg", "duration_s")
    @classmethod
    def _rises(cls, pair: list[float]) -> list[float]:
        if len(pair) == 2 and pair[0] >= pair[1]:
            raise ValueError(f"the lower limit {pair[0]:g} must be below the upper limit {pair[1]:g}")
        return pair


@dataclass(frozen=True)
class OptimalStudy:
    """A checked study with its vehicle, limited control points, and limits of the flight."""

    declared: OptimalStudyFile
    vehicle: Vehicle
    points: tuple[LimitedPoint, ...]
    flight_limits: FlightLimits

    @property
    def title(self) -> str:
        """Title of the study."""
        return self.declared.title


def load_optimal_study(path: str | os.PathLike[str], *, root: str | os.PathLike[str] | None = None) -> OptimalStudy:
    """Read and check a study and its vehicle.

    root   : folder that it may name a vehicle in; by default the nearest above it that holds `scenarios`
    raises : InputError with one line a problem
    """
    study_path = Path(path)
    declared = read_toml(study_path, OptimalStudyFile)
    vehicle = load_vehicle(vehicle_place(study_path, declared.vehicle, root=root), root=root)
    return optimal_study(declared, vehicle, display_path(study_path))


def optimal_study(declared: OptimalStudyFile, vehicle: Vehicle, where: str = "study") -> OptimalStudy:
    """Check a study of a vehicle that has been loaded.

    where  : the file and table, for messages
    raises : InputError with one line a problem: an unknown or repeated control point, a table without the sigma
             needed, an end above the start, angles of attack outside the aerodynamic tables or none of these
    """
    points: dict[str, LimitedPoint] = {}
    problems: list[str] = []
    for limit in declared.limit:
        try:
            point = vehicle.control_point(limit.control_point)
        except InputError as error:
            problems += [f"{where}, [limit]: {line}" for line in error.problems]
            continue
        if declared.probability is not None and point.ratio.sigma is None:
            problems.append(f"{where}, probability: the ratio table of {point.name} has no sigma; add that column")
        if point.name in points:
            problems.append(f"{where}, [limit]: `{point.name}` is repeated; name it once")
        points[point.name] = limit.limited(point)
    for key in ("altitude_m", "velocity_m_s"):
        first, last = getattr(declared.initial, key), getattr(declared.end, key)
        if first <= last:
            problems.append(f"{where}, [end]: `{key}`: {last:g} must be below that of [initial], {first:g}")
    problems += _control_problems(declared, vehicle, where)
    raise_problems(problems)
    of_vehicle = vehicle.declared.flight_limits or FlightLimits()
    limits = of_vehicle.model_dump(include={*FlightLimits.model_fields})
    flight_limits = FlightLimits(**(limits | declared.flight_limits.model_dump(exclude_none=True)))
    return OptimalStudy(declared, vehicle, tuple(points.values()), flight_limits)


def tabulated_alpha_deg(vehicle: Vehicle) -> tuple[float, float]:
    """Lowest and highest angle of attack of a vehicle's aerodynamic tables [deg].

    raises : InputError where it has none
    """
    try:
        alpha_deg = load_aero(vehicle.directory).basic.alpha_deg
    except InputError as error:
        raise InputError(
            *(
                f"{line}; an optimal entry needs aerodynamic tables, as `sim-heating new vehicle` writes them"
                for line in error.problems
            )
        ) from None
    return float(alpha_deg[0]), float(alpha_deg[-1])


def _control_problems(declared: OptimalStudyFile, vehicle: Vehicle, where: str) -> list[str]:
    """Problems of the limits of angle of attack, beyond the vehicle's tables, and of bank."""
    problems = []
    try:
        lowest, highest = tabulated_alpha_deg(vehicle)
    except InputError as error:
        return [f"{where}: {line}" for line in error.problems]
    low, high = declared.alpha_limits_deg
    if low < lowest or high > highest:
        problems.append(
            f"{where}: `alpha_limits_deg`: {low:g} to {high:g} goes beyond the aerodynamic tables of {vehicle.name}, "
            f"{lowest:g} to {highest:g} deg"
        )
    low, high = declared.bank_limits_deg
    if low < -180.0 or high > 180.0:
        problems.append(f"{where}: `bank_limits_deg`: {low:g} to {high:g} must lie within -180 to 180 deg")
    if declared.duration_s[0] <= 0.0:
        problems.append(f"{where}: `duration_s`: the shortest, {declared.duration_s[0]:g} s, must be above 0")
    return problems
