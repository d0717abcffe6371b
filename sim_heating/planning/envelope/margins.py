"""Margins of one case of an envelope study: its distance from each limit.

    surface, bondline  limit less peak temperature [K], with the sigma due to that of the ratio table, or to all that is
                       uncertain (planning/bands.py); with estimates, of their mean
    elevon             travel less the deflection that trims, to either end [deg]; negative: the flight is not trimmed
    table              distance of the flight from either end of each axis of a point's ratio table, where the point is
                       heated; negative: outside, where the ratio is unknown and nothing counts as allowed

A case that cannot be flown has no margins and states why in one line.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import ndtri

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES, Conditions
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.kernels.block import LANES
from sim_heating.inputs.points import conditions_behind_walls, point_of_vehicle
from sim_heating.inputs.scenario import Scenario
from sim_heating.march.history import BAND_PROBABILITY, table_excursions
from sim_heating.march.mesh_choice import choose_meshes
from sim_heating.march.point import PointModel
from sim_heating.planning.bands import Member, Spread, estimated_names, members_of_point, mixture_quantile, spreads
from sim_heating.planning.envelope.case import BaseEntry, Case, FlownCase
from sim_heating.planning.limited_point import LimitedPoint
from sim_heating.planning.ratio_table_modes import PeakSensitivity, covariance_root, peak_sensitivities
from sim_heating.planning.soak import with_soak

HEATED = 0.1
"""Part of the highest reference heating above which a flight counts as leaving a ratio table. Below it no wall reaches
0.1^(1/4) of its highest temperature, and little heat enters the structure. `EvaluatedCase.outside` covers all of it."""
ROUNDING = -1e-9
"""Least margin that is not a violation: a deflection at the end of its table is inside, but for rounding."""
TABLE_AXES = dict(
    zip(
        RATIO_VARIABLES,
        (
            ("angle of attack", "deg"),
            ("sideslip", "deg"),
            ("log10 Reynolds number", ""),
            ("elevon", "deg"),
            ("body flap", "deg"),
        ),
        strict=True,
    )
)
"""Names and units of the variables of a ratio table."""
SURFACE, BONDLINE, ELEVON, TABLE = "surface", "bondline", "elevon", "table"


@dataclass(frozen=True)
class Margin:
    """Distance from one limit, negative where it is violated.

    kind         : surface, bondline, elevon or table;  point : the control point, empty for the vehicle as a whole
    value        : peak or extreme, in `unit`;  limit, margin, sigma : in the same unit
    sigma_after  : sigma that would remain after each candidate manoeuvre of the next flight
    """

    kind: str
    point: str
    value: float
    limit: float
    margin: float
    unit: str
    sigma: float = 0.0
    sigma_after: Mapping[str, float] = field(default_factory=dict)

    @property
    def at_band(self) -> float:
        """The margin at the upper end of the 95 % band, where sigma is by all that is uncertain."""
        return self.margin - float(ndtri(0.5 + 0.5 * BAND_PROBABILITY)) * self.sigma

    def reduced(self, sigmas: float, manoeuvre: str | None = None) -> float:
        """The margin less a number of sigma, with the sigma after a manoeuvre where one is named."""
        return self.margin - sigmas * (self.sigma if manoeuvre is None else self.sigma_after.get(manoeuvre, self.sigma))


@dataclass(frozen=True)
class EvaluatedCase:
    """A case and its margins, by name.

    station_m_s : velocity at the station of the angle of attack [m/s], where the case changes one
    outside     : where the flight left a ratio table, one line each;  error : why it could not be flown
    """

    case: Case
    margins: Mapping[str, Margin]
    cross_range_km: float = 0.0
    duration_s: float = 0.0
    station_m_s: float | None = None
    outside: tuple[str, ...] = ()
    error: str | None = None

    @property
    def other_violations(self) -> list[tuple[str, Margin]]:
        """Violated limits other than temperatures: no trim, or outside a table."""
        return [(n, m) for n, m in self.margins.items() if m.unit != "K" and m.margin < ROUNDING]

    @property
    def least(self) -> tuple[str, Margin] | None:
        """Name and margin of the limit that matters most: another violation, else the temperature with least margin."""
        hot = sorted(((n, m) for n, m in self.margins.items() if m.unit == "K"), key=lambda nm: nm[1].margin)
        return next(iter([*self.other_violations, *hot]), None)


class MarginEvaluator:
    """Flies cases and computes their margins.

    base     : the entry that cases change
    points   : control points with their limits
    scenario : of the base entry, for its effects
    soak_s   : length of the soak after the flight [s]
    members  : what may be true of the points, where the sigma of a temperature is by all that is uncertain; empty where
               it is by the ratio tables alone
    informed : control point -> manoeuvre -> root of the table's errors after it (ratio_table_modes.informed_root)
    """

    def __init__(
        self,
        base: BaseEntry,
        points: Sequence[LimitedPoint],
        scenario: Scenario,
        soak_s: float,
        informed: Mapping[str, Mapping[str, FloatArray]] | None = None,
        *,
        members: Sequence[Member] = (),
    ) -> None:
        self.base, self.points, self.soak_s, self.members = base, tuple(points), soak_s, members
        self.informed = informed or {}
        vehicle = base.vehicle
        self.models = [point_of_vehicle(vehicle, p.point, effects=scenario.effects(p.point.name)) for p in points]
        self.roots = [covariance_root(vehicle, p.point.name) for p in points]
        self.meshes = [
            mesh for i in range(0, len(points), LANES) for mesh, _ in choose_meshes(self.models[i : i + LANES], 1.0)
        ]

    def evaluate(self, case: Case) -> EvaluatedCase:
        """Fly a case and compute its margins; if it cannot be flown, the result states why."""
        try:
            return self._evaluate_flight(self.base.fly(case))
        except (InputError, RunError) as error:
            return EvaluatedCase(case, {}, error=f"{case.describe()}: {' '.join(str(error).split())}")

    def _evaluate_flight(self, flown: FlownCase) -> EvaluatedCase:
        vehicle, by_name = self.base.vehicle, {m.name: m for m in self.models}
        conditions_of = [
            conditions_behind_walls(vehicle, [p.point], flown.at_side(p.point.position_m[1]), by_name)[0]
            for p in self.points
        ]
        flights = [with_soak(c, self.soak_s) for c in conditions_of]
        margins = self._trim_margins(flown)
        outside: list[str] = []
        marched = peak_sensitivities(self.models, self.meshes, self.roots, flights)
        for limited, model, conditions, peak, soaked in zip(
            self.points, self.models, conditions_of, marched, flights, strict=True
        ):
            name = limited.point.name
            others = _without_table(model, soaked, members_of_point(self.members, name))
            for channel, (kind, found, limit_K) in enumerate(
                ((SURFACE, peak.surface, limited.surface_K), (BONDLINE, peak.bondline, limited.bondline_K))
            ):
                if limit_K is None or not np.isfinite(limit_K):
                    continue
                margin = self._temperature_margin(name, kind, found, limit_K)
                margins[f"{name} {kind}"] = _with_all(margin, others, channel) if others else margin
            margins |= _table_margins(limited, conditions)
            outside += [
                f"{name}: {o.variable} up to {o.farthest:.3g} outside its ratio table, {o.duration_s:.0f} s in all, "
                f"first at {o.first_s:.0f} s"
                for o in table_excursions(model, conditions)
            ]
        t = flown.conditions.time_s
        return EvaluatedCase(
            flown.case, margins, flown.cross_range_km, float(t[-1] - t[0]), self._station_m_s(flown), tuple(outside)
        )

    def _station_m_s(self, flown: FlownCase) -> float | None:
        """Velocity where the station is passed for the last time [m/s]."""
        station, x = flown.case.alpha_station, flown.conditions[self.base.guidance.alpha_against]
        if station is None or not np.any(x >= station):
            return None
        return float(flown.conditions["velocity_m_s"][np.flatnonzero(x >= station)[-1]])

    def _temperature_margin(self, name: str, kind: str, peak: PeakSensitivity, limit_K: float) -> Margin:
        sigma_after = {
            manoeuvre: float(np.linalg.norm(peak.slope @ root)) if len(peak.slope) else 0.0
            for manoeuvre, root in self.informed.get(name, {}).items()
        }
        T = peak.temperature_K
        return Margin(kind, name, T, limit_K, limit_K - T, "K", peak.sigma_K, sigma_after)

    def _trim_margins(self, flown: FlownCase) -> dict[str, Margin]:
        trim, required = flown.trim, flown.trim.required_deg
        if not trim.low_deg < trim.high_deg:
            return {}
        up = np.min(required - np.abs(flown.aileron_deg)), trim.low_deg
        down = np.max(required + np.abs(flown.aileron_deg)), trim.high_deg
        return {
            "elevon travel, up": Margin(ELEVON, "", float(up[0]), up[1], float(up[0] - up[1]), "deg"),
            "elevon travel, down": Margin(ELEVON, "", float(down[0]), down[1], float(down[1] - down[0]), "deg"),
        }


@dataclass(frozen=True)
class _Uncertain:
    """Temperatures that may be true, without the error of the ratio table.

    spread    : with its weight among all
    estimated : whether they are by an estimate;  has_table : whether the error of the table is to be added
    """

    spread: Spread
    estimated: bool
    has_table: bool


def _without_table(model: PointModel, flown: Conditions, members: Sequence[Member]) -> list[_Uncertain]:
    """What may be true of the temperatures of a point, for each member and size of the heating's error."""
    found = []
    for m in members:
        names = () if m.estimate is None else estimated_names(model, m.estimate)
        has_table = not any(n.startswith("ratio.") for n in names)
        of_member = spreads(model, flown, m, with_table=False)
        found += [_Uncertain(replace(s, weight=m.weight * s.weight), bool(names), has_table) for s in of_member]
    return found


def _with_all(margin: Margin, others: Sequence[_Uncertain], channel: int) -> Margin:
    """A margin whose sigma is by the ratio table, with one by all that is uncertain: of its 95 % band, over 1.96.

    others : temperatures without the error of the table;  channel : 0 the surface, 1 the bondline

    With estimates the temperature is the mean of the members.
    """
    peaks = [int(np.argmax(o.spread.mean_K[channel])) for o in others]
    T = np.array([o.spread.mean_K[channel, k] for o, k in zip(others, peaks, strict=True)])
    weights, high = [o.spread.weight for o in others], 0.5 + 0.5 * BAND_PROBABILITY
    value = float(np.average(T, weights=weights))

    def sigma(of_table_K: float) -> float:
        every = [
            replace(
                o.spread,
                mean_K=T[i : i + 1] - value,
                sigma_K=np.hypot(o.spread.sigma_K[channel, k : k + 1], of_table_K if o.has_table else 0.0),
            )
            for i, (o, k) in enumerate(zip(others, peaks, strict=True))
        ]
        return float(mixture_quantile(every, weights, high)[0] / ndtri(high))

    by_all = replace(
        margin, sigma=sigma(margin.sigma), sigma_after={name: sigma(s) for name, s in margin.sigma_after.items()}
    )
    is_estimated = any(o.estimated for o in others)
    return replace(by_all, value=value, margin=margin.limit - value) if is_estimated else by_all


def _table_margins(limited: LimitedPoint, conditions: Conditions) -> dict[str, Margin]:
    """Distances from the ends of the axes of a point's ratio table, where the point is heated."""
    name, margins = limited.point.name, dict[str, Margin]()
    # Before and after the heating a flight leaves every table without consequence for any temperature.
    flux = conditions["h_ref_kg_m2_s"] * conditions["H_r_J_kg"]
    heated = flux > HEATED * np.max(flux)
    for variable, axis in zip(RATIO_VARIABLES, limited.point.ratio.axes, strict=True):
        if len(axis) == 1:
            continue
        x, (quantity, unit) = conditions[variable][heated], TABLE_AXES[variable]
        low, high = float(np.min(x)), float(np.max(x))
        ends = (
            (f"below {axis[0]:g}", Margin(TABLE, name, low, float(axis[0]), low - float(axis[0]), unit)),
            (f"above {axis[-1]:g}", Margin(TABLE, name, high, float(axis[-1]), float(axis[-1]) - high, unit)),
        )
        margins |= {f"{name} ratio table, {quantity} {end} {unit}".rstrip(): margin for end, margin in ends}
    return margins
