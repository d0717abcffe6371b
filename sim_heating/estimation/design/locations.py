"""Locations of a thermocouple: bounds on the wanted parameters of each control point, the most informative first.

The same manoeuvre is read at each control point of a scenario by one thermocouple: its outermost, or, where a point has
none, one below its coating that is recorded as the outermost of the design's point, over a range up to the limit of the
surface. The parameters are those of the heating ratio r at that point, so that bounds are compared over the ratio:

    value = [mean_k (sigma_k / r)^2 / (sigma_k0 / r_0)^2]^(1/2),    subscript 0: at the design's point.

Source: docs/how_to/manoeuvre_design.md, equation 5a; the founding paper asks for thermocouples "at critical locations,
which may not be identified until after a first flight".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.files import finite_or_none
from sim_heating.estimation.design.planned_flight import PlannedFlight, Planner
from sim_heating.inputs.vehicle import ControlPoint
from sim_heating.thermal.stack import Sensor


@dataclass(frozen=True, eq=False)
class Location:
    """A control point with one thermocouple.

    sensor        : the thermocouple;  is_installed : whether the vehicle has it
    ratio         : mean heating ratio over the times that are read [-]
    sigma         : (wanted,) bounds there, one standard deviation, each in the unit of its parameter
    over_declared : root mean square of the bounds over the ratio, over those at the design's point [-]; infinite where
                    one is not identified
    surface_margin_K : from the highest temperature of its surface to the limit [K]
    """

    control_point: str
    sensor: Sensor
    is_installed: bool
    ratio: float
    sigma: FloatArray
    over_declared: float
    surface_margin_K: float


def locations(planner: Planner, flown: PlannedFlight) -> list[Location]:
    """The control points of the scenario by the information of one thermocouple on a flight, the best first.

    flown   : a flight that keeps its limits
    returns : one for each control point; none where the scenario has one alone
    raises  : RunError where a march failed

    Source: docs/how_to/manoeuvre_design.md, equations 1 and 5a.
    """
    if len(planner.scenario.names) < 2:
        return []
    points = [planner.scenario.vehicle.control_point(name) for name in planner.scenario.names]
    every = {p.name: _bounds_at(planner, flown, p) for p in (*points, planner.point)}
    ratio_0, sigma_0 = every[planner.point.name]
    found = []
    for point in points:
        ratio, sigma = every[point.name]
        over = np.sqrt(np.mean(((sigma / ratio) / (sigma_0 / ratio_0)) ** 2)) if np.all(np.isfinite(sigma)) else np.inf
        sensor, is_installed = _thermocouple(planner, point)
        margin = float(point.limits.surface_K) - _peak_K(planner, flown, point.name)
        found.append(Location(point.name, sensor, is_installed, ratio, sigma, float(over), margin))
    return sorted(found, key=lambda at: at.over_declared)


def _thermocouple(planner: Planner, point: ControlPoint) -> tuple[Sensor, bool]:
    """The outermost thermocouple of a point, and whether the vehicle has it."""
    if point.sensors:
        return min(point.sensors, key=lambda s: s.depth_m), True
    like, stack = min(planner.point.sensors, key=lambda s: s.depth_m), point.construction.stack
    span = None if like.range_K is None else [like.range_K[0], float(point.limits.surface_K)]
    depth_m = stack.layer[0].thickness_m if len(stack.layer) > 1 else 0.0
    update = {"name": point.name, "column": f"{point.name}_K", "depth_m": depth_m, "range_K": span}
    return like.model_copy(update=update), False


def _bounds_at(planner: Planner, flown: PlannedFlight, point: ControlPoint) -> tuple[float, FloatArray]:
    """Mean ratio [-] and (wanted,) bounds at a control point by one thermocouple."""
    there = planner.at(replace(point, sensors=(_thermocouple(planner, point)[0],)))
    seen = replace(flown, conditions=there.conditions_of(flown.flight))
    names = there.names(seen)
    bounds = there.experiment(seen, names, there.priors(names, seen)).sigma(planner.targets)
    return there.mean_ratio(seen), bounds


def _peak_K(planner: Planner, flown: PlannedFlight, name: str) -> float:
    """Highest temperature of the surface of a point on a flight [K], from its distance to the limit."""
    return planner.limit(f"{name} surface_K") - flown.margins[f"{name} surface_K"]


def as_json(at: Location, names: tuple[str, ...]) -> Mapping[str, object]:
    """A location as design.json states it; null where a parameter is not identified.

    names : (wanted,) dotted names
    """
    return {
        "control_point": at.control_point,
        "sensor": at.sensor.name,
        "depth_m": at.sensor.depth_m,
        "is_installed": at.is_installed,
        "ratio": at.ratio,
        "sigma": {n: finite_or_none(s) for n, s in zip(names, at.sigma, strict=True)},
        "over_declared": finite_or_none(at.over_declared),
        "surface_margin_K": at.surface_margin_K,
    }
