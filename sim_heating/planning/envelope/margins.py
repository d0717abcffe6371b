"""How far one case of an envelope study stays from each of its limits.

    surface, bondline  limit less peak temperature [K], with the sigma that the ratio table puts on it
    elevon             travel less the deflection that trims, to either end [deg]; negative: there is no trim
    table              distance of the flight from either end of each axis of a point's ratio table, where the point is
                       heated; negative: outside, where nothing is known and nothing is called safe

A case that cannot be flown is told in one line and has no margins.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES, Conditions
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.kernels.block import LANES
from sim_heating.inputs.points import conditions_at_point, point_of_vehicle
from sim_heating.inputs.scenario import Scenario
from sim_heating.march.history import outside_table
from sim_heating.march.mesh_choice import choose_meshes
from sim_heating.planning.envelope.case import Base, Case, Flown
from sim_heating.planning.limited_point import LimitedPoint
from sim_heating.planning.ratio_table_modes import Peak, covariance_root, peaks
from sim_heating.planning.soak import soaked

HEATED = 0.1
"""A flight leaves a ratio table where the reference heating is above this part of its highest value: below it no wall
comes to 0.1^(1/4) of its hottest, and little goes into the structure. `Evaluated.outside` tells of the whole flight."""
ROUNDING = -1e-9
"""A margin from here on is kept: a deflection at the end of its table is inside."""
TABLE_AXES = dict(
    zip(
        RATIO_VARIABLES,
        (("angle of attack", "deg"), ("sideslip", "deg"), ("log10 Reynolds number", ""), ("elevon", "deg"),
         ("body flap", "deg")),
        strict=True,
    )
)  # fmt: skip
"""The variables of a ratio table in words, with their units."""
SURFACE, BONDLINE, ELEVON, TABLE = "surface", "bondline", "elevon", "table"


@dataclass(frozen=True)
class Margin:
    """Distance from one limit, negative where it is passed.

    kind  : surface, bondline, elevon or table;  point : the control point, empty for the vehicle as a whole
    value : peak or extreme;  margin, sigma : in the same unit
    after : sigma as it would be after each of the manoeuvres that may be flown next
    at_s, at_m_s : when, and at which velocity
    """

    kind: str
    point: str
    value: float
    limit: float
    margin: float
    unit: str
    sigma: float = 0.0
    after: Mapping[str, float] = field(default_factory=dict)
    at_s: float = 0.0
    at_m_s: float = 0.0

    def less(self, sigmas: float, manoeuvre: str | None = None) -> float:
        """The margin less a number of sigma, those after a manoeuvre where one is named."""
        return self.margin - sigmas * (self.sigma if manoeuvre is None else self.after.get(manoeuvre, self.sigma))


@dataclass(frozen=True)
class Evaluated:
    """A case and its margins, by name.

    station_m_s : velocity at the station of the angle of attack, where one was changed
    outside     : where the flight left a table, a line each;  error : why it could not be flown
    """

    case: Case
    margins: Mapping[str, Margin]
    cross_range_km: float = 0.0
    duration_s: float = 0.0
    station_m_s: float | None = None
    outside: tuple[str, ...] = ()
    error: str | None = None

    @property
    def passed_other(self) -> list[tuple[str, Margin]]:
        """Limits passed that are none of a temperature: no trim, or outside a table."""
        return [(n, m) for n, m in self.margins.items() if m.unit != "K" and m.margin < ROUNDING]

    @property
    def least(self) -> tuple[str, Margin] | None:
        """What else than a temperature is passed, or the temperature limit that is nearest or most passed."""
        hot = sorted(((n, m) for n, m in self.margins.items() if m.unit == "K"), key=lambda nm: nm[1].margin)
        return next(iter([*self.passed_other, *hot]), None)


class Judge:
    """Flies cases and holds them against the limits.

    base      : what cases start from
    points    : control points with their limits
    effects   : of the base entry's scenario
    soak_s    : how long heat goes on inwards after the flight
    informed  : control point -> manoeuvre -> what it leaves of the table's errors, `table_errors.informed_root`
    """

    def __init__(
        self,
        base: Base,
        points: Sequence[LimitedPoint],
        scenario: Scenario,
        soak_s: float,
        informed: Mapping[str, Mapping[str, FloatArray]] | None = None,
    ) -> None:
        self.base, self.points, self.soak_s = base, tuple(points), soak_s
        self.informed = informed or {}
        vehicle = base.vehicle
        self.models = [point_of_vehicle(vehicle, p.point, effects=scenario.effects(p.point.name)) for p in points]
        self.roots = [covariance_root(vehicle, p.point.name) for p in points]
        self.meshes = [
            mesh for i in range(0, len(points), LANES) for mesh, _ in choose_meshes(self.models[i : i + LANES], 1.0)
        ]

    def evaluate(self, case: Case) -> Evaluated:
        """A case with its margins; one that cannot be flown says why."""
        try:
            flown = self.base.fly(case)
            return self._judged(flown)
        except (InputError, RunError) as error:
            return Evaluated(case, {}, error=f"{case.told()}: {' '.join(str(error).split())}")

    def _judged(self, flown: Flown) -> Evaluated:
        vehicle = self.base.vehicle
        own = [conditions_at_point(vehicle, p.point, flown.at_side(p.point.position_m[1])) for p in self.points]
        flights = [soaked(c, p.point, self.soak_s) for c, p in zip(own, self.points, strict=True)]
        found = self._trim(flown)
        outside: list[str] = []
        marched = peaks(self.models, self.meshes, self.roots, flights)
        for limited, model, conditions, peak in zip(self.points, self.models, own, marched, strict=True):
            name = limited.point.name
            if np.isfinite(limited.surface_K):
                found[f"{name} {SURFACE}"] = self._hot(name, SURFACE, peak.surface, limited.surface_K, flown)
            if limited.bondline_K is not None:
                found[f"{name} {BONDLINE}"] = self._hot(name, BONDLINE, peak.bondline, limited.bondline_K, flown)
            found |= _within_table(limited, conditions)
            outside += [
                f"{name}: {o.variable} up to {o.farthest:.3g} outside its ratio table, {o.duration_s:.0f} s in all, "
                f"first at {o.first_s:.0f} s"
                for o in outside_table(model, conditions)
            ]
        t = flown.conditions.time_s
        return Evaluated(
            flown.case, found, flown.cross_range_km, float(t[-1] - t[0]), self._station_m_s(flown), tuple(outside)
        )

    def _station_m_s(self, flown: Flown) -> float | None:
        """Velocity where the station is passed for the last time."""
        station, x = flown.case.alpha_station, flown.conditions[self.base.guidance.alpha_against]
        if station is None or not np.any(x >= station):
            return None
        return float(flown.conditions["velocity_m_s"][np.flatnonzero(x >= station)[-1]])

    def _hot(self, name: str, kind: str, peak: Peak, limit_K: float, flown: Flown) -> Margin:
        after = {
            manoeuvre: float(np.linalg.norm(peak.slope @ left)) if len(peak.slope) else 0.0
            for manoeuvre, left in self.informed.get(name, {}).items()
        }
        speed = np.interp(peak.time_s, flown.conditions.time_s, flown.conditions["velocity_m_s"])
        T = peak.temperature_K
        return Margin(kind, name, T, limit_K, limit_K - T, "K", peak.sigma_K, after, peak.time_s, float(speed))

    def _trim(self, flown: Flown) -> dict[str, Margin]:
        trim, wanted = flown.trim, flown.trim.wanted_deg
        if not trim.low_deg < trim.high_deg:
            return {}
        up = np.min(wanted - np.abs(flown.aileron_deg)), trim.low_deg
        down = np.max(wanted + np.abs(flown.aileron_deg)), trim.high_deg
        return {
            "elevon travel, up": Margin(ELEVON, "", float(up[0]), up[1], float(up[0] - up[1]), "deg"),
            "elevon travel, down": Margin(ELEVON, "", float(down[0]), down[1], float(down[1] - down[0]), "deg"),
        }


def _within_table(limited: LimitedPoint, conditions: Conditions) -> dict[str, Margin]:
    """Distances from the ends of the axes of a point's ratio table, where it is heated."""
    name, found = limited.point.name, dict[str, Margin]()
    flux = conditions["h_ref_kg_m2_s"] * conditions["H_r_J_kg"]
    heated = flux > HEATED * np.max(flux)
    for variable, axis in zip(RATIO_VARIABLES, limited.point.ratio.axes, strict=True):
        if len(axis) == 1:
            continue
        x, (words, unit) = conditions[variable][heated], TABLE_AXES[variable]
        low, high = float(np.min(x)), float(np.max(x))
        ends = (
            (f"below {axis[0]:g}", Margin(TABLE, name, low, float(axis[0]), low - float(axis[0]), unit)),
            (f"above {axis[-1]:g}", Margin(TABLE, name, high, float(axis[-1]), float(axis[-1]) - high, unit)),
        )
        found |= {f"{name} ratio table, {words} {end} {unit}".rstrip(): margin for end, margin in ends}
    return found
