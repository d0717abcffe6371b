"""Flight conditions: one named array per column, in SI units with angles in degrees, linear in time between samples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError

RATIO_VARIABLES = ("alpha_deg", "beta_deg", "log10_re", "elevon_deg", "bodyflap_deg")
"""The variables of a heating-ratio table, in the order of its axes."""

STATE = ("time_s", "altitude_m", "velocity_m_s", "mach", *RATIO_VARIABLES, "rho_kg_m3", "T_inf_K", "p_inf_Pa")
"""Columns that every flight has."""

HEATING = ("p_surface_Pa", "h_ref_kg_m2_s", "H_r_J_kg")
"""Columns that the heating of one control point needs in addition to STATE."""

DESCRIPTIONS = {
    "time_s": "time in s",
    "altitude_m": "altitude in m",
    "velocity_m_s": "speed relative to the air in m/s",
    "mach": "speed over the local speed of sound",
    "alpha_deg": "angle of attack in degrees",
    "beta_deg": "sideslip in degrees",
    "log10_re": "base-10 logarithm of the Reynolds number of the reference length",
    "elevon_deg": "elevon deflection in degrees, positive trailing edge down",
    "bodyflap_deg": "body-flap deflection in degrees, positive trailing edge down",
    "rho_kg_m3": "density of the air in kg/m3",
    "T_inf_K": "temperature of the air in K",
    "p_inf_Pa": "pressure of the air in Pa",
    "p_surface_Pa": "pressure at the surface of the control point in Pa; the conductivity of insulation depends on it",
    "h_ref_kg_m2_s": "reference film coefficient, enthalpy based, in kg/(m2 s)",
    "H_r_J_kg": "recovery enthalpy in J/kg, zero at 0 K",
    "q_add_W_m2": "added absorbed heat flux, as of a lamp, in W/m2",
    "jets": "reaction jets that fire, 0 to 1",
    "T_surroundings_K": "temperature that the surface radiates to in K",
    "T_back_K": "temperature behind the wall in K",
    "T_upstream_K": "temperature of the wall upstream of an interface in K",
    "q_Pa": "dynamic pressure in Pa, in place of `rho_kg_m3`",
    "qbar_Pa": "dynamic pressure in Pa",
    "bank_deg": "bank angle of the velocity relative to the air in degrees",
    "gamma_deg": "path angle of the velocity relative to the air in degrees",
    "heading_deg": "heading of the velocity relative to the air in degrees",
    "latitude_deg": "latitude in degrees",
    "longitude_deg": "longitude in degrees",
    "axial_accel_g": "sensed acceleration along the body axis in g, positive aft",
}
"""What each column of a file of conditions holds, for pages and schemas."""

DERIVED = (
    "H_r_rise_J_kg",
    "turbulent_ratio",
    "log10_re_theta_m",
    "dissociation_J_kg",
    "still_air_W_m2K43",
    "H_upstream_J_kg",
)
"""Columns of one control point that follow from the others and from its declaration; no file holds them."""

SURFACES = RATIO_VARIABLES[3:]
"""Deflections of control surfaces, which a file of a vehicle without them leaves out; they are then 0."""

SHUTTLE_MACH_M_S = 304.8
"""1000 ft/s [m/s], the unit of 'Mach' in the Shuttle literature."""

FRAME = (
    "time_s",
    "altitude_m",
    "velocity_m_s",
    "alpha_deg",
    "beta_deg",
    "elevon_deg",
    "bodyflap_deg",
    "rho_kg_m3",
    "jets",
)
"""Inputs that a host gives at each frame; temperature, Mach and Reynolds number are derived from them."""

EXTRAS = ("bank_deg", "gamma_deg", "heading_deg", "latitude_deg", "longitude_deg", "axial_accel_g")
"""Columns that a source adds to FRAME in each row. `axial_accel_g`: sensed acceleration along the body axis, positive
aft, CA qbar S / (m g0). Bank, path angle and heading are those of the velocity relative to the air."""

ACCOMPANYING = (*EXTRAS, "qbar_Pa")
"""Columns of a record that nothing of its heating follows from; a link on it takes them where they are sent."""

LINE_TOLERANCE = {
    "velocity_m_s": 0.0,
    "alpha_deg": 0.02,
    "beta_deg": 0.02,
    "elevon_deg": 0.05,
    "bodyflap_deg": 0.05,
    "rho_kg_m3": 0.0,
    "jets": 0.02,
}
LINE_TOLERANCE_SHARE = {"velocity_m_s": 0.002, "rho_kg_m3": 0.002}
"""Distance from a straight line in time that heating does not notice, in the unit of the variable, plus a share of its
value: what samples of a flight, linear between them, may leave out; a host may bend by a part of it within a thermal
step. With them plug-in and march stay within 0.1 K of each other over an entry. Altitude acts through density."""


@dataclass(frozen=True)
class Conditions:
    """Time histories of a flight, one array per named column; the unit of a column is the end of its name.

    columns : name -> (time,) float64; `time_s` [s] strictly increasing; every value finite
    raises  : InputError naming column and row where a column violates this

    `conditions[name]` is a column, `name in conditions` tests for it, `len(conditions)` is the number of samples.
    """

    columns: Mapping[str, FloatArray]

    def __post_init__(self) -> None:
        time = self.columns.get("time_s")
        if time is None or len(time) == 0:
            raise InputError("conditions: time_s is missing or empty; give at least one sample")
        for name, values in self.columns.items():
            # Lengths before values: the row number of a bad value means nothing in a column of another length.
            if len(values) != len(time):
                raise InputError(f"conditions, column {name}: {len(values)} values for {len(time)} times")
            if not np.all(np.isfinite(values)):
                row = int(np.flatnonzero(~np.isfinite(values))[0])
                raise InputError(f"conditions, row {row + 1}, column {name}: {values[row]} is not a finite number")
        if np.any(np.diff(time) <= 0.0):
            row = int(np.flatnonzero(np.diff(time) <= 0.0)[0]) + 1
            raise InputError(
                f"conditions, row {row + 1}, column time_s: {time[row]} does not come after {time[row - 1]}"
            )

    def __getitem__(self, name: str) -> FloatArray:
        return self.columns[name]

    def __contains__(self, name: object) -> bool:
        return name in self.columns

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def time_s(self) -> FloatArray:
        """(time,) sample times [s], strictly increasing."""
        return self.columns["time_s"]

    @property
    def duration_s(self) -> FloatArray:
        """(time,) time that each sample stands for [s], half of the interval to either side; a single one has 1 s."""
        return np.gradient(self.time_s) if len(self) > 1 else np.ones(1)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all columns in order."""
        return tuple(self.columns)

    def with_columns(self, **arrays: ArrayLike) -> Conditions:
        """Copy of these conditions with columns added or replaced.

        arrays  : name -> (time,) values in the unit that the name ends in, or a scalar for all samples
        raises  : InputError where a value is not finite; ValueError where a length does not fit
        """
        new = {name: np.broadcast_to(np.asarray(a, dtype=float), self.time_s.shape) for name, a in arrays.items()}
        return Conditions({**self.columns, **new})

    def at(self, time_s: ArrayLike) -> Conditions:
        """Conditions at other times, linear between samples.

        time_s  : (n,) times [s], strictly increasing, within the samples
        returns : conditions with the same columns at these times
        raises  : InputError where a time lies outside the samples (no extrapolation), or the times do not increase
        """
        t = np.atleast_1d(np.asarray(time_s, dtype=float))
        first, last = self.time_s[0], self.time_s[-1]
        if np.any(t < first) or np.any(t > last):
            raise InputError(f"conditions: {t.min()} to {t.max()} s requested, sampled from {first} to {last} s only")
        return Conditions(
            {"time_s": t} | {n: np.interp(t, self.time_s, v) for n, v in self.columns.items() if n != "time_s"}
        )
