"""The [optimal] table of a study from the flight of its scenario, so that at least that flight is within its bounds.

Start, end, angles of attack and the vehicle's state are those of the flight. The limits are the vehicle's own where the
flight keeps them, soak included; where it does not, they are what the flight reaches, and a note says so: with limits
that the nominal flight exceeds, most searches find no flight at all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim_heating.base.conditions import Conditions
from sim_heating.base.files import display_path
from sim_heating.inputs.points import conditions_behind_walls, point_of_vehicle
from sim_heating.inputs.scenario import Scenario
from sim_heating.march.history import march_points
from sim_heating.planning.optimal.spec import OptimalStudyFile, tabulated_alpha_deg
from sim_heating.planning.soak import with_soak
from sim_heating.simulation.run import fly_scenario

INITIAL = ("altitude_m", "velocity_m_s", "gamma_deg", "heading_deg", "latitude_deg", "longitude_deg")
EAST_OVER_EQUATOR = {"heading_deg": 90.0, "latitude_deg": 0.0, "longitude_deg": 0.0}
"""Where a recorded trajectory does not have them [deg]."""
LEAST_ALPHA_RANGE_DEG = 10.0
"""Angles of attack that a flight at a constant one is given [deg]."""
SHORTEST, LONGEST = 0.5, 2.5
"""Durations to search among, over that of the flight."""
STEP_K, LEAST_ROOM_K = 10.0, 2.0
"""A limit that the flight exceeds becomes the next multiple of STEP_K that is LEAST_ROOM_K or more above its peak."""


@dataclass(frozen=True)
class StartingTable:
    """Contents of an [optimal] table, and what a reader has to know of it.

    values : keys of the table; `limit` is a list of dicts
    above  : control point -> limit of it (`surface_K`, `bondline_K`) -> why it is above the vehicle's own
    notes  : one line each
    """

    values: Mapping[str, Any]
    above: Mapping[str, Mapping[str, str]]
    notes: tuple[str, ...]


def optimal_table(scenario: Scenario, names: Sequence[str]) -> StartingTable:
    """Fly a scenario, march its points, and make the [optimal] table that its flight is within.

    names  : control points to be limited
    raises : InputError where the vehicle has no aerodynamic tables; RunError where the flight or a thermal step fails
    """
    tabulated = tabulated_alpha_deg(scenario.vehicle)
    flown = fly_scenario(scenario).conditions
    initial, notes = _initial(scenario, flown)
    duration = float(flown.time_s[-1] - flown.time_s[0])
    limits, above = _limits(scenario, flown, names)
    values = {
        "alpha_limits_deg": _alpha_limits(flown, *tabulated),
        "duration_s": [round(SHORTEST * duration), round(LONGEST * duration)],
        "initial": initial,
        "end": {
            "altitude_m": round(float(flown["altitude_m"][-1]), -2),
            "velocity_m_s": round(float(flown["velocity_m_s"][-1])),
            "gamma_deg": round(_path_angle_deg(flown, -1), 1),
        },
        "state": scenario.declared.trajectory.vehicle.model_dump(mode="json", exclude_defaults=True),
        "limit": limits,
    }
    notes += [
        f"{name}, {key} = {limit[key]:.0f}: {why}"
        for limit in limits
        for name in [limit["control_point"]]
        for key, why in above.get(name, {}).items()
    ]
    return StartingTable(values, above, tuple(notes))


def _initial(scenario: Scenario, flown: Conditions) -> tuple[dict[str, float], list[str]]:
    declared = scenario.declared.trajectory.initial
    if declared is not None:
        return {key: float(getattr(declared, key)) for key in INITIAL}, []
    absent = [key for key in EAST_OVER_EQUATOR if key not in flown]
    first = {key: float(flown[key][0]) for key in INITIAL if key in flown} | {k: EAST_OVER_EQUATOR[k] for k in absent}
    first["gamma_deg"] = round(_path_angle_deg(flown, 0), 3)
    where = f"{display_path(scenario.path)}: its trajectory has no "
    notes = [f"{where}{', '.join(absent)}: the entry begins eastward over the equator"] if absent else []
    return {key: first[key] for key in INITIAL}, notes


def _path_angle_deg(flown: Conditions, sample: int) -> float:
    """Path angle at a sample [deg], from the rate of altitude where the trajectory has none."""
    if "gamma_deg" in flown:
        return float(flown["gamma_deg"][sample])
    sine = np.gradient(flown["altitude_m"], flown.time_s)[sample] / flown["velocity_m_s"][sample]
    return math.degrees(math.asin(float(np.clip(sine, -0.98, 0.98))))


def _alpha_limits(flown: Conditions, lowest: float, highest: float) -> list[float]:
    """Angles of attack of a flight, at least LEAST_ALPHA_RANGE_DEG of them, within those of the tables [deg]."""
    low, high = math.floor(float(np.min(flown["alpha_deg"]))), math.ceil(float(np.max(flown["alpha_deg"])))
    margin = max(0.0, 0.5 * (LEAST_ALPHA_RANGE_DEG - (high - low)))
    return [max(low - margin, lowest), min(high + margin, highest)]


def _limits(
    scenario: Scenario, flown: Conditions, names: Sequence[str]
) -> tuple[list[dict[str, Any]], dict[str, dict[str, str]]]:
    """Entries of `limit`, and why some of them are above the vehicle's own limits."""
    vehicle, soak_s = scenario.vehicle, float(OptimalStudyFile.model_fields["soak_s"].default)
    points = [vehicle.control_point(name) for name in names]
    flights = [with_soak(c, soak_s) for c in conditions_behind_walls(vehicle, points, flown)]
    limits, above = list[dict[str, Any]](), dict[str, dict[str, str]]()
    for point, history in zip(
        points, march_points([point_of_vehicle(vehicle, p) for p in points], flights), strict=True
    ):
        limit: dict[str, Any] = {"control_point": point.name}
        declared = {"surface_K": point.limits.surface_K, "bondline_K": point.limits.bondline_K}
        peaks = {"surface_K": float(np.max(history.surface_K)), "bondline_K": float(np.max(history.bondline_K))}
        for key, peak in peaks.items():
            kept = declared[key]
            if kept is not None and peak + LEAST_ROOM_K > kept:
                limit[key] = STEP_K * math.ceil((peak + LEAST_ROOM_K) / STEP_K)
                above.setdefault(point.name, {})[key] = (
                    f"the scenario's flight reaches {peak:.0f} K, the vehicle's own limit is {kept:.0f} K"
                )
        limits.append(limit)
    return limits, above
