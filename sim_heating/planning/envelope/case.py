"""One entry of an envelope study: the base entry with some of its variables changed, flown with the 3-DOF entry.

The axes along which an entry may be changed are the numeric fields of `Case`. Angle of attack is changed as a whole
(offset, and a stretch of the schedule's axis) and about one station of the schedule; cross-range through the velocity
at which the bank reverses for the only time, range through the level of the reference drag; trim follows from centre
of gravity, body flap and the flight-found pitching moment. A lateral centre of gravity is balanced at each instant
after the flight, with

    roll  Cl_beta beta + Cl_a a + CN y / b = 0,   Cl_a = (dCN/d_elevon) y_e / b
    yaw   Cn_beta beta - CA y / b = 0

y the offset to starboard, a half the difference of the elevons, y_e their distance from the plane of symmetry; the
yawing moment of the elevons and the bend of the path are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.limits import LIMITS
from sim_heating.inputs.vehicle import Vehicle
from sim_heating.trajectory import entry3dof
from sim_heating.trajectory import point_mass as pm
from sim_heating.trajectory.aero import Aero, flown_aero
from sim_heating.trajectory.guidance import resolve_guidance
from sim_heating.trajectory.spec import Guidance, TrajectorySpec

FLOWN_WITH = {"source": "entry-3dof", "rate_hz": 4.0}
CROSS_RANGE_WITHIN_KM = 2.0
"""How closely a cross-range that is asked for is met."""
STATION_RAMP = 0.25
"""Part of a station's half-width over which its offset comes and goes."""


@dataclass(frozen=True)
class Case:
    """What is changed of the base entry; what is None or neutral is as the base has it.

    alpha_offset_deg : on the whole angle-of-attack schedule
    alpha_stretch    : of the schedule's axis: above 1 the pitch-down comes at a higher Mach number
    station_alpha_deg: angle of attack held about `alpha_station`, a place on the schedule's own axis
    drag_factor      : on the reference drag: below 1 a longer, higher flight
    cross_range_km   : asked for, with one reversal of the bank
    one_sided        : the bank never reverses: as much cross-range as the rest allows
    bodyflap_deg     : held down to the base's `bodyflap_above_mach`, on its schedule below; the elevon trims
    cm_shift         : pitching moment that flights found
    lateral_cg_m     : of the centre of gravity, to starboard
    """

    alpha_offset_deg: float = 0.0
    alpha_stretch: float = 1.0
    alpha_station: float | None = None
    station_alpha_deg: float | None = None
    drag_factor: float = 1.0
    cross_range_km: float | None = None
    one_sided: bool = False
    cg_fraction: float | None = None
    bodyflap_deg: float | None = None
    cm_shift: float | None = None
    mass_kg: float | None = None
    density_factor: float = 1.0
    lateral_cg_m: float = 0.0

    def changed(self) -> dict[str, Any]:
        """What is not as the base has it."""
        return {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) != f.default}

    def told(self) -> str:
        """In words."""
        return ", ".join(f"{k} {v:g}" for k, v in self.changed().items()) or "base entry"


BETWEEN = {
    "alpha_stretch": (0.0, np.inf), "alpha_station": (0.0, np.inf), "drag_factor": (0.0, np.inf),
    "cg_fraction": (0.0, 1.0), "mass_kg": (0.0, np.inf), "density_factor": (0.0, np.inf),
    "alpha_offset_deg": (-90.0, 90.0), "station_alpha_deg": LIMITS["alpha_deg"][:2],
    "bodyflap_deg": LIMITS["bodyflap_deg"][:2],
}  # fmt: skip
"""Ends between which alone a value has a meaning; neither is one of its values."""
AXES = tuple(f.name for f in fields(Case) if f.name != "one_sided")


@dataclass(frozen=True)
class Trim:
    """How the elevon trims a flight: (time,) deflection that the moment asks for [deg], beyond its travel too."""

    wanted_deg: FloatArray
    low_deg: float
    high_deg: float


@dataclass(frozen=True)
class Flown:
    """A flown case.

    conditions     : of the vehicle as a whole
    cross_range_km : at the end, positive to the left of the great circle along which the flight began
    aileron_deg    : (time,) half the difference of left and right elevon; 0 without a lateral centre of gravity
    """

    case: Case
    conditions: Conditions
    cross_range_km: float
    trim: Trim
    aileron_deg: FloatArray

    def at_side(self, y_m: float) -> Conditions:
        """Conditions where a control point at y sees its own elevon."""
        if self.case.lateral_cg_m == 0.0 or y_m == 0.0:
            return self.conditions
        return self.conditions.with_columns(elevon_deg=self.conditions["elevon_deg"] - np.sign(y_m) * self.aileron_deg)


class Base:
    """What cases start from: a vehicle and its entry.

    station_width : half the width of a station, on the axis of the angle-of-attack schedule
    elevon_arm_m  : distance of the elevons from the plane of symmetry
    bodyflap_above_mach : down to where a body flap is held
    raises        : InputError where the entry is not one that guidance flies
    """

    def __init__(
        self,
        spec: TrajectorySpec,
        vehicle: Vehicle,
        *,
        station_width: float = 1.0,
        elevon_arm_m: float = 6.0,
        bodyflap_above_mach: float = 8.0,
    ) -> None:
        if spec.source in ("recorded", "fmu"):
            raise InputError(f'envelope: a {spec.source} trajectory has no guidance to change; give "entry-3dof"')
        self.spec = spec.model_copy(update=FLOWN_WITH)
        self.vehicle = vehicle
        self.guidance = resolve_guidance(spec.guidance, vehicle.directory)
        self.station_width = station_width
        self.elevon_arm_m = elevon_arm_m
        self.bodyflap_above_mach = bodyflap_above_mach

    def neutral(self, axis: str, case: Case) -> float | None:
        """What the base entry has on an axis, where it is a number; of the station's angle of attack at its station."""
        if axis == "station_alpha_deg" and case.alpha_station is not None:
            schedule = alpha_schedule(replace(case, station_alpha_deg=None), self.guidance, self.station_width)
            return float(np.interp(case.alpha_station, *np.array(schedule).T))
        value = getattr(Case(), axis)
        return None if value is None else float(value)

    def fly(self, case: Case) -> Flown:
        """Fly a case.

        raises : InputError for a vehicle that cannot be flown so, RunError where the flight leaves the atmosphere or
                 the cross-range that is asked for is out of reach
        """
        if case.cross_range_km is None:
            return self._flown(case, self._spec(case, () if case.one_sided else None))
        return self._flown(case, self._spec(case, (self._reversal(case, case.cross_range_km),)))

    def _reversal(self, case: Case, asked_km: float) -> float:
        """Velocity [m/s] of the one reversal that leads to a cross-range on the side of the first bank."""
        flown = entry3dof.fly(self._spec(case, ()), self.vehicle).conditions
        side = float(np.sign(self._cross_range_km(flown)))
        most, slowest = abs(self._cross_range_km(flown)), float(flown["velocity_m_s"][-1])

        def missed(velocity_m_s: float) -> float:
            flight = entry3dof.fly(self._spec(case, (velocity_m_s,)), self.vehicle)
            return side * self._cross_range_km(flight.conditions) - asked_km

        fastest = 0.95 * float(np.max(flown["velocity_m_s"]))
        if asked_km > most:
            raise RunError(f"{asked_km:g} km of cross-range asked for and {most:.0f} km is the most that is flown")
        if abs(asked_km - most) < CROSS_RANGE_WITHIN_KM:
            return slowest
        low, high = _bracketed(missed, slowest, fastest)
        return float(brentq(missed, low, high, xtol=1.0))

    def _spec(self, case: Case, reversals: Sequence[float] | None) -> TrajectorySpec:
        g = self.guidance
        guidance: dict[str, Any] = {
            "alpha_deg": alpha_schedule(case, g, self.station_width),
            "drag_m_s2": tuple((v, case.drag_factor * d) for v, d in g.drag_m_s2),
        }
        if reversals is not None:
            guidance |= {"reversals_m_s": tuple(reversals), "target": None}
        state = {k: v for k in ("cg_fraction", "cm_shift", "mass_kg") if (v := getattr(case, k)) is not None}
        given = self.spec.dispersions.density_factor or ((0.0, 1.0),)
        density = tuple((h, case.density_factor * f) for h, f in given)
        spec = self.spec.model_copy(update={
            "guidance": self.spec.guidance.model_copy(update=guidance),
            "vehicle": self.spec.vehicle.model_copy(update=state),
            "dispersions": self.spec.dispersions.model_copy(update={"density_factor": density}),
        })  # fmt: skip
        return spec if case.bodyflap_deg is None else self._with_bodyflap(spec, case.bodyflap_deg)

    def _with_bodyflap(self, spec: TrajectorySpec, bodyflap_deg: float) -> TrajectorySpec:
        """The body flap held at high Mach numbers, below on the schedule that trims there."""
        assert spec.guidance.alpha_deg is not None  # given with every case
        aero, low = flown_aero(spec, self.vehicle.directory), self.bodyflap_above_mach - 1.0
        trimming = aero.bodyflap_schedule(spec.guidance.alpha_deg, self.guidance.alpha_against)
        held = (*((m, flap) for m, flap in trimming if m < low), (self.bodyflap_above_mach, bodyflap_deg))
        state = spec.vehicle.model_copy(update={"bodyflap_deg": held, "bodyflap_against": "mach"})
        return spec.model_copy(update={"vehicle": state})

    def _flown(self, case: Case, spec: TrajectorySpec) -> Flown:
        flown = entry3dof.fly(spec, self.vehicle).conditions
        aero = flown_aero(spec, self.vehicle.directory)
        low, high = aero.file.elevon.range_deg
        beta, aileron = lateral_trim(aero, flown, case.lateral_cg_m, self.elevon_arm_m)
        if case.lateral_cg_m != 0.0:
            flown = flown.with_columns(beta_deg=flown["beta_deg"] + beta)
        return Flown(case, flown, self._cross_range_km(flown), Trim(wanted_elevon(aero, flown), low, high), aileron)

    def _cross_range_km(self, flown: Conditions) -> float:
        assert self.spec.initial is not None  # a trajectory that flies by itself has one
        first = self.spec.initial
        end = (float(flown["latitude_deg"][-1]), float(flown["longitude_deg"][-1]))
        return cross_range_km((first.latitude_deg, first.longitude_deg), first.heading_deg, end)


def _bracketed(missed: Callable[[float], float], slowest: float, fastest: float) -> tuple[float, float]:
    """Velocities of a late and an earlier reversal between which the cross-range passes what is asked for."""
    late = slowest
    for early in np.linspace(slowest, fastest, 8)[1:]:
        if missed(float(early)) < 0.0:
            return late, float(early)
        late = float(early)
    raise RunError("the cross-range asked for is not met by any one reversal of the bank")


def alpha_schedule(case: Case, guidance: Guidance, station_width: float) -> tuple[tuple[float, float], ...]:
    """The angle-of-attack schedule of a case."""
    low, high = guidance.alpha_limits_deg
    x, alpha = np.array(sorted(guidance.alpha_deg), dtype=float).T
    x, alpha = x * case.alpha_stretch, alpha + case.alpha_offset_deg
    if case.alpha_station is not None and case.station_alpha_deg is not None:
        ramp = STATION_RAMP * station_width
        ends = case.alpha_station + np.array(
            [-station_width - ramp, -station_width, station_width, station_width + ramp]
        )
        nodes = np.unique(np.concatenate((x, ends)))
        share = np.interp(nodes, ends, [0.0, 1.0, 1.0, 0.0])
        x, alpha = nodes, (1.0 - share) * np.interp(nodes, x, alpha) + share * case.station_alpha_deg
    return tuple(zip(x.tolist(), np.clip(alpha, low, high).tolist(), strict=True))


def cross_range_km(start_deg: tuple[float, float], heading_deg: float, end_deg: tuple[float, float]) -> float:
    """Distance of a place from the great circle through another one under a heading, positive to its left [km].

    start_deg, end_deg : latitude and longitude, of the sphere of the equatorial radius
    """
    (lat, lon), (there, east_of) = np.radians(start_deg), np.radians(end_deg)
    psi = np.radians(heading_deg)
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    ahead = np.cos(psi) * np.cross(up, east) + np.sin(psi) * east
    end = np.array([np.cos(there) * np.cos(east_of), np.cos(there) * np.sin(east_of), np.sin(there)])
    return float(np.arcsin(np.clip(np.cross(up, ahead) @ end, -1.0, 1.0)) * pm.WGS84_RADIUS_M / 1e3)


def wanted_elevon(aero: Aero, flown: Conditions) -> FloatArray:
    """(time,) elevon that would leave no moment [deg]; beyond its travel where the travel does not suffice.

    Beyond, the moment that is left is divided by the slope of the last degree of travel.
    """
    low, high = aero.file.elevon.range_deg
    wanted = flown["elevon_deg"].copy()
    for i in np.flatnonzero((wanted <= low + 1e-9) | (wanted >= high - 1e-9)):
        at = [float(flown[name][i]) for name in ("mach", "alpha_deg")]
        flap, end = float(flown["bodyflap_deg"][i]), float(wanted[i])
        inner = end + 1.0 if end <= low + 1e-9 else end - 1.0
        left, before = (aero.coefficients(at[0], at[1], d, flap)[2] for d in (end, inner))
        slope = (left - before) / (end - inner)
        if slope < 0.0:
            wanted[i] = end - left / slope
    return wanted


def lateral_trim(aero: Aero, flown: Conditions, y_m: float, arm_m: float) -> tuple[FloatArray, FloatArray]:
    """(time,) sideslip and aileron [deg] that balance a centre of gravity y to starboard; see the head of the module.

    raises : InputError where the vehicle has no sideslip derivatives or no elevon
    """
    nothing = np.zeros(len(flown))
    if y_m == 0.0:
        return nothing, nothing
    lateral, b = aero.file.lateral, aero.file.reference.span_m
    if lateral.Cn_beta_deg == 0.0 or aero.file.tables.elevon is None:
        raise InputError("lateral_cg_m: the vehicle's aero.toml has no Cn_beta_deg or no elevon to trim with")
    beta, aileron = nothing.copy(), nothing.copy()
    columns = ("mach", "alpha_deg", "elevon_deg", "bodyflap_deg")
    for i, (mach, alpha, elevon, flap) in enumerate(zip(*(flown[c].tolist() for c in columns), strict=True)):
        cn, ca, _ = aero.body_coefficients(mach, alpha, elevon, flap)
        slope = 0.5 * (
            aero.body_coefficients(mach, alpha, elevon + 1.0, flap)[0]
            - aero.body_coefficients(mach, alpha, elevon - 1.0, flap)[0]
        )
        beta[i] = ca * y_m / (b * lateral.Cn_beta_deg)
        aileron[i] = -(lateral.Cl_beta_deg * beta[i] + cn * y_m / b) * b / (slope * arm_m)
    return beta, aileron
