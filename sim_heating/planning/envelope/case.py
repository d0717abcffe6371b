"""One case of an envelope study: the base entry with some of its variables changed, flown as a 3-DOF entry.

The axes along which an entry may be changed are the numeric fields of `Case`. Angle of attack is changed as a whole
(offset, and a stretch of the schedule's axis) and about one station of the schedule; cross-range through the velocity
of a single bank reversal, range through the level of the reference drag; trim follows from centre
of gravity, body flap and the flight-found pitching moment. A lateral centre of gravity is balanced at each instant
after the flight, with

    roll  Cl_beta beta + Cl_a a + CN y / b = 0,   Cl_a = (dCN/d_elevon) y_e / b
    yaw   Cn_beta beta - CA y / b = 0

y the offset to starboard, a half the difference of the elevons, y_e their distance from the plane of symmetry. The
yawing moment of the elevons and the change of the path are neglected.
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
from sim_heating.base.limits import LIMITS, QUANTITIES
from sim_heating.inputs.vehicle import Vehicle
from sim_heating.trajectory import entry3dof
from sim_heating.trajectory import point_mass as pm
from sim_heating.trajectory.aero import Aero, flown_aero
from sim_heating.trajectory.guidance import resolve_guidance
from sim_heating.trajectory.spec import Guidance, TrajectorySpec

TRAJECTORY = {"source": "entry-3dof", "rate_hz": 4.0}
"""Source of every case, and its steps a second."""
CROSS_RANGE_WITHIN_KM = 2.0
"""Largest error of a required cross-range [km] at the end of what can be reached."""
BASE_ENTRY = "base entry"
"""Name of the entry that a study changes, wherever a figure of it stands beside those of others."""
STATION_RAMP = 0.25
"""Part of a station's half-width over which its offset comes and goes."""


@dataclass(frozen=True)
class Case:
    """Changes to the base entry; a variable that is None or neutral stays as in the base.

    alpha_offset_deg : on the whole angle-of-attack schedule
    alpha_stretch    : of the schedule's axis; above 1 the pitch-down comes at a higher Mach number
    station_alpha_deg: angle of attack held about `alpha_station`, a place on the schedule's own axis
    drag_factor      : on the reference drag; below 1 the flight is longer and higher
    cross_range_km   : required, with one reversal of the bank
    one_sided        : the bank never reverses, for as much cross-range as the rest allows
    bodyflap_deg     : held down to the base's `bodyflap_above_mach`, on its schedule below; the elevon trims
    cm_shift         : shift of the pitching moment, as flights have shown one
    lateral_cg_m     : offset of the centre of gravity to starboard
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

    def changes(self) -> dict[str, Any]:
        """The variables that differ from the base entry."""
        return {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) != f.default}

    def describe(self) -> str:
        """The changes in one line, as `alpha_offset_deg -4, mass_kg 84000`."""
        return ", ".join(f"{k} {v:g}" for k, v in self.changes().items()) or BASE_ENTRY


OPEN_RANGES = {
    "alpha_stretch": (0.0, np.inf),
    "alpha_station": (0.0, np.inf),
    "drag_factor": (0.0, np.inf),
    "cg_fraction": (0.0, 1.0),
    "mass_kg": (0.0, QUANTITIES["mass_kg"].highest),
    "density_factor": (0.0, QUANTITIES["density_factor"].highest),
    "alpha_offset_deg": (-90.0, 90.0),
    "station_alpha_deg": LIMITS["alpha_deg"][:2],
    "bodyflap_deg": LIMITS["bodyflap_deg"][:2],
}
"""Range of each variable; its ends are not part of it."""
AXES = tuple(f.name for f in fields(Case) if f.name != "one_sided")
"""Variables that an axis of a map or boundary may have."""


@dataclass(frozen=True)
class Trim:
    """Elevon deflection that trims a flight, and the travel of the elevon.

    required_deg       : (time,) deflection without a pitching moment [deg]; it may lie beyond the travel
    low_deg, high_deg  : ends of the travel [deg]
    """

    required_deg: FloatArray
    low_deg: float
    high_deg: float


@dataclass(frozen=True)
class FlownCase:
    """A flown case.

    conditions     : of the vehicle as a whole
    cross_range_km : at the end, positive to the left of the initial great circle [km]
    aileron_deg    : (time,) half the difference of left and right elevon [deg]; 0 without a lateral centre of gravity
    """

    case: Case
    conditions: Conditions
    cross_range_km: float
    trim: Trim
    aileron_deg: FloatArray

    def at_side(self, y_m: float) -> Conditions:
        """Conditions of a control point at y_m, with the deflection of the elevon on its side."""
        if self.case.lateral_cg_m == 0.0 or y_m == 0.0:
            return self.conditions
        return self.conditions.with_columns(elevon_deg=self.conditions["elevon_deg"] - np.sign(y_m) * self.aileron_deg)


class BaseEntry:
    """A vehicle and the entry that cases change.

    station_width       : half the width of a station, on the axis of the angle-of-attack schedule
    elevon_arm_m        : distance of the elevons from the plane of symmetry [m]
    bodyflap_above_mach : Mach number down to which a changed body flap is held
    raises              : InputError where no guidance flies the entry
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
            raise InputError(
                f'envelope: a trajectory with source = "{spec.source}" has no guidance to change; give "entry-3dof"'
            )
        self.spec = spec.model_copy(update=TRAJECTORY)
        self.vehicle = vehicle
        self.guidance = resolve_guidance(spec.guidance, vehicle.directory)
        self.station_width = station_width
        self.elevon_arm_m = elevon_arm_m
        self.bodyflap_above_mach = bodyflap_above_mach

    def value_on(self, axis: str, case: Case) -> float | None:
        """Value of the base entry on an axis, or None; for `station_alpha_deg` its angle of attack at the station."""
        if axis == "station_alpha_deg" and case.alpha_station is not None:
            schedule = alpha_schedule(replace(case, station_alpha_deg=None), self.guidance, self.station_width)
            return float(np.interp(case.alpha_station, *np.array(schedule).T))
        value = getattr(Case(), axis)
        return None if value is None else float(value)

    def fly(self, case: Case) -> FlownCase:
        """Fly a case.

        raises : InputError where the vehicle has no data for it; RunError where the flight leaves the atmosphere or
                 the required cross-range is out of reach
        """
        if case.cross_range_km is None:
            return self._fly_spec(case, self._spec(case, () if case.one_sided else None))
        return self._fly_spec(case, self._spec(case, (self._reversal_m_s(case, case.cross_range_km),)))

    def _reversal_m_s(self, case: Case, required_km: float) -> float:
        """Velocity [m/s] of the single reversal that leads to a cross-range on the side of the first bank."""
        flown = entry3dof.fly(self._spec(case, ()), self.vehicle).conditions
        side = float(np.sign(self._cross_range_km(flown)))
        most, slowest = abs(self._cross_range_km(flown)), float(flown["velocity_m_s"][-1])

        def excess_km(velocity_m_s: float) -> float:
            flight = entry3dof.fly(self._spec(case, (velocity_m_s,)), self.vehicle)
            return side * self._cross_range_km(flight.conditions) - required_km

        fastest = 0.95 * float(np.max(flown["velocity_m_s"]))
        if required_km > most:
            raise RunError(
                f"a cross-range of {required_km:g} km is out of reach, {most:.0f} km is the most that is flown; "
                "ask for less"
            )
        # At the end of the reach a reversal so late changes nothing, and the root would not be bracketed.
        if abs(required_km - most) < CROSS_RANGE_WITHIN_KM:
            return slowest
        low, high = _bracket_reversal(excess_km, slowest, fastest)
        return float(brentq(excess_km, low, high, xtol=1.0))

    def _spec(self, case: Case, reversals: Sequence[float] | None) -> TrajectorySpec:
        g = self.guidance
        guidance: dict[str, Any] = {
            "alpha_deg": alpha_schedule(case, g, self.station_width),
            "drag_m_s2": tuple((v, case.drag_factor * d) for v, d in g.drag_m_s2),
        }
        if reversals is not None:
            # A target would reverse the bank by itself.
            guidance |= {"reversals_m_s": tuple(reversals), "target": None}
        state = {k: v for k in ("cg_fraction", "cm_shift", "mass_kg") if (v := getattr(case, k)) is not None}
        factors = self.spec.dispersions.density_factor or ((0.0, 1.0),)
        density = tuple((h, case.density_factor * f) for h, f in factors)
        spec = self.spec.model_copy(
            update={
                "guidance": self.spec.guidance.model_copy(update=guidance),
                "vehicle": self.spec.vehicle.model_copy(update=state),
                "dispersions": self.spec.dispersions.model_copy(update={"density_factor": density}),
            }
        )
        return spec if case.bodyflap_deg is None else self._with_bodyflap(spec, case.bodyflap_deg)

    def _with_bodyflap(self, spec: TrajectorySpec, bodyflap_deg: float) -> TrajectorySpec:
        """An entry with the body flap held at high Mach numbers; below, on the schedule that trims."""
        assert spec.guidance.alpha_deg is not None  # given with every case
        aero, low = flown_aero(spec, self.vehicle.directory), self.bodyflap_above_mach - 1.0
        trimming = aero.bodyflap_schedule(spec.guidance.alpha_deg, self.guidance.alpha_against)
        schedule = (*((m, flap) for m, flap in trimming if m < low), (self.bodyflap_above_mach, bodyflap_deg))
        state = spec.vehicle.model_copy(update={"bodyflap_deg": schedule, "bodyflap_against": "mach"})
        return spec.model_copy(update={"vehicle": state})

    def _fly_spec(self, case: Case, spec: TrajectorySpec) -> FlownCase:
        flown = entry3dof.fly(spec, self.vehicle).conditions
        aero = flown_aero(spec, self.vehicle.directory)
        low, high = aero.file.elevon.range_deg
        beta, aileron = lateral_trim(aero, flown, case.lateral_cg_m, self.elevon_arm_m)
        if case.lateral_cg_m != 0.0:
            flown = flown.with_columns(beta_deg=flown["beta_deg"] + beta)
        trim = Trim(required_elevon(aero, flown), low, high)
        return FlownCase(case, flown, self._cross_range_km(flown), trim, aileron)

    def _cross_range_km(self, flown: Conditions) -> float:
        assert self.spec.initial is not None  # every trajectory with guidance has one
        first = self.spec.initial
        end = (float(flown["latitude_deg"][-1]), float(flown["longitude_deg"][-1]))
        return cross_range_km((first.latitude_deg, first.longitude_deg), first.heading_deg, end)


def _bracket_reversal(excess_km: Callable[[float], float], slowest: float, fastest: float) -> tuple[float, float]:
    """Velocities [m/s] of a late and an earlier reversal between which the required cross-range lies."""
    late = slowest
    for early in np.linspace(slowest, fastest, 8)[1:]:
        if excess_km(float(early)) < 0.0:
            return late, float(early)
        late = float(early)
    raise RunError("no single reversal of the bank leads to the required cross-range")


def held_alpha(case: Case, guidance: Guidance) -> str:
    """Where the limits of guidance hold an offset schedule in whole or in part, what is flown instead; else empty."""
    low, high = guidance.alpha_limits_deg
    if case.alpha_offset_deg == 0.0 or case.alpha_station is not None:
        return ""
    commanded = [alpha + case.alpha_offset_deg for _, alpha in guidance.alpha_deg]
    if all(low <= alpha <= high for alpha in commanded):
        return ""
    return (
        f"alpha_offset_deg {case.alpha_offset_deg:g}: asks for {min(commanded):g} to {max(commanded):g} deg, and is "
        f"flown within {low:g} to {high:g} deg, `alpha_limits_deg` of guidance"
    )


def alpha_schedule(case: Case, guidance: Guidance, station_width: float) -> tuple[tuple[float, float], ...]:
    """The angle-of-attack schedule of a case: (place on its axis, alpha [deg])."""
    low, high = guidance.alpha_limits_deg
    x, alpha = np.array(sorted(guidance.alpha_deg), dtype=float).T
    x, alpha = x * case.alpha_stretch, alpha + case.alpha_offset_deg
    if case.alpha_station is not None and case.station_alpha_deg is not None:
        ramp = STATION_RAMP * station_width
        ends = case.alpha_station + np.array(
            [-station_width - ramp, -station_width, station_width, station_width + ramp]
        )
        nodes = np.unique(np.concatenate((x, ends)))
        weight = np.interp(nodes, ends, [0.0, 1.0, 1.0, 0.0])
        x, alpha = nodes, (1.0 - weight) * np.interp(nodes, x, alpha) + weight * case.station_alpha_deg
    return tuple(zip(x.tolist(), np.clip(alpha, low, high).tolist(), strict=True))


def cross_range_km(start_deg: tuple[float, float], heading_deg: float, end_deg: tuple[float, float]) -> float:
    """Distance of a place from the great circle that leaves the start along a heading, positive to its left [km].

    start_deg, end_deg : latitude and longitude, on the sphere of the equatorial radius
    """
    (lat, lon), (there, east_of) = np.radians(start_deg), np.radians(end_deg)
    psi = np.radians(heading_deg)
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    ahead = np.cos(psi) * np.cross(up, east) + np.sin(psi) * east
    end = np.array([np.cos(there) * np.cos(east_of), np.cos(there) * np.sin(east_of), np.sin(there)])
    return float(np.arcsin(np.clip(np.cross(up, ahead) @ end, -1.0, 1.0)) * pm.WGS84_RADIUS_M / 1e3)


def required_elevon(aero: Aero, flown: Conditions) -> FloatArray:
    """(time,) elevon that leaves no pitching moment [deg], beyond its travel where the travel does not suffice.

    Beyond the travel, the remaining moment is divided by the slope of the last degree of travel.
    """
    low, high = aero.file.elevon.range_deg
    required = flown["elevon_deg"].copy()
    for i in np.flatnonzero((required <= low + 1e-9) | (required >= high - 1e-9)):
        at = [float(flown[name][i]) for name in ("mach", "alpha_deg")]
        flap, end = float(flown["bodyflap_deg"][i]), float(required[i])
        # Extrapolated with the slope inside the travel, so that a margin states by how much the elevon is short.
        inner = end + 1.0 if end <= low + 1e-9 else end - 1.0
        remaining, before = (aero.coefficients(at[0], at[1], d, flap)[2] for d in (end, inner))
        slope = (remaining - before) / (end - inner)
        if slope < 0.0:
            required[i] = end - remaining / slope
    return required


def lateral_trim(aero: Aero, flown: Conditions, y_m: float, arm_m: float) -> tuple[FloatArray, FloatArray]:
    """(time,) sideslip and aileron [deg] that balance a centre of gravity y_m to starboard, by the equations above.

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
