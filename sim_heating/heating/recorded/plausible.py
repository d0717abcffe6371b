"""Flight conditions by columns: what is impossible, and what is unusual, about each, its neighbours and the others.

`implausible_values` is refused. Its tolerances follow from physics and are wide: a column in another unit, in another's
place, or damaged, never a flight with scatter, in another gas, or with an atmosphere that differs from the standard
one. `unusual_values` is reported, and the columns are used: a relation that is off what flights on Earth have, or a
sample that stands out of those before and after it. Records, trajectories and links are checked alike.

    p = rho R T       R between that of carbon dioxide and of hydrogen; a pressure in hPa, or a temperature in
                      Rankine, lies outside
    M = V / a         a = sqrt(gamma R T), gamma 1.05 to 1.67 and R by p / (rho T); a speed in knots lies outside
    |dh/dt| <= V      a time in minutes or hours lies outside
    mass / (C_D A)    = int rho V^3 / 2 dt / -(change of V^2 / 2 + g h), of gliding flight; a time in ms lies outside
    log10 Re          = log10(rho V L / mu) with one length L; natural logarithms lie outside
    p over h          near that of the US Standard Atmosphere 1976 at 0.3048 h alone: altitudes in ft lie outside
    rho over h        falls by at least e in 100 km, which no planet's atmosphere exceeds
    mass / (C_L S)    = rho V^2 / 2 over z'' + g - V^2 / (R + z), the lift that a path above 55 km needs; a speed in
                      other units is too slow for it, and no lift carries so little
    path in air       a fast flight below 90 km does not go around the Earth twice
    H_r, h_ref        = V^2 / 2 + cp T, and 2 * 1.7415e-4 (rho / R)^0.5 V of a sphere (Sutton and Graves, TR R-376), by
                      which a film coefficient implies a radius R
    qbar, gamma       = rho V^2 / 2, and sin gamma = (dh/dt) / V
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.base.files import CsvTable, display_path, raise_problems
from sim_heating.base.limits import HIGH_SPEED_M_S, LIMITS, LOW_M, LOW_RULE, QUANTITIES, SLOWEST_M_S, USUAL, Quantity
from sim_heating.heating.atmosphere import CP_AIR, EARTH_RADIUS_M, G0_M_S2, GAMMA, HIGHEST_M, LOWEST_M, R_AIR, us76
from sim_heating.heating.atmosphere import sutherland_viscosity as viscosity
from sim_heating.heating.reference.stagnation import SUTTON_GRAVES

FT_S = 304.8
"""1000 ft/s in m/s: the unit of speed that the Shuttle's literature calls Mach."""
GAS_RANGE = (0.6, 20.0)
"""p / (rho T) over that of air: carbon dioxide 0.66, helium 7.2, hydrogen 14.4."""
MACH_RANGE = (0.6, 1.3)
"""M sqrt(R T) / V = 1 / sqrt(gamma), 0.77 to 0.98, with a margin for temperatures and speeds of different sources."""
MACH_RANGE_STANDARD = (0.5, 2.0)
"""The same over that of air at the standard temperature, where a file has no temperature of its own."""
LENGTHS_M = (1e-3, 1e4)
"""Reference lengths [m] that a Reynolds number may imply."""
BALLISTIC_KG_M2 = (0.5, 5e4)
"""Mass over drag area [kg/m2]: a parachute has a few, a slender entry body 15,000."""
LOST_ENERGY = 0.3
"""Part of the energy of the first sample that a gliding flight loses before its drag says something about its time."""
SCALE_HEIGHT_M = 1e5
"""Largest scale height of an atmosphere [m]; that of the Earth is 7 km, that of Titan 40 km."""
PROFILE_M = 20e3
"""Span of altitude [m] over which a density must fall."""
STANDARD_RANGE = (1.0 / 30.0, 30.0)
"""Density over the standard one below 100 km."""
STANDARD_BELOW_M, STANDARD_SPAN_M = 100e3, 5e3
FOOT_M = 0.3048
LEAST_ROWS = 3
FEET_FROM_M = 3e3
"""Altitude [m] from which one in ft is distinguished from one in m by the air."""
NEAR_STANDARD, FAR_FROM_STANDARD = 0.2, 0.3
"""Logarithms of the ratio to the standard atmosphere: of air that is near it, and of air that is not."""
PART_M = 5e3
"""Change of altitude of the parts of a flight over which it is compared with the path [m]."""
RATE_SLACK_M_S = 100.0
"""Added to the speed where the change of altitude is compared with it [m/s]: winds, and rounded times."""
SCATTER = 0.6
"""Logarithm of the ratio by which a relation of one sample may be off beyond its limits: three times 20 %."""
SAME = 2e-3
"""Relative difference of two columns that are the same but for rounding."""
LONGEST_S = 1e6
"""Longest flight in a file, twelve days [s]: a march of seconds through years would not end."""


CARRIED_ABOVE_M = 55e3
"""Altitude [m] above which no balloon floats, so that lift or speed carries what does not fall."""
CARRIED_KG_M2 = 1.0
"""Mass over lifting area [kg/m2] below which nothing flies: sheets of paper have 0.1, inflated decelerators 30."""
LIFT_SLACK_M_S2 = 3.0
"""Vertical acceleration [m/s2] that speeds relative to a turning Earth, and rounded altitudes, leave unexplained."""
WINDOW_S, WINDOW_SAMPLES = 60.0, 5
AROUND_M, AROUND_BELOW_M = 8e7, 90e3
"""Path [m] of twice around the Earth, and altitude [m] below which no fast flight is as long."""
RADII_M = (1e-6, 1e7)
"""Radii [m] of a sphere that a film coefficient may imply."""
ENTHALPIES = (0.4, 20.0)
"""Recovery enthalpy over V^2 / 2 + cp T: edges have 0.84 and more, streams of arc jets a few."""
QBARS = (0.5, 2.0)
"""Dynamic pressure over rho V^2 / 2."""
STILL_M_S, MOST_ENTHALPY_J_KG = 1.0, 5e8
"""Speed below which nothing flows [m/s], and the largest recovery enthalpy of a flow [J/kg]: that at 30 km/s."""
THRUST_M_S2 = 0.5
"""Rise of the speed [m/s2] above which a flight is under thrust, which carries it too."""


def implausible_values(table: CsvTable) -> list[str]:
    """One line for each column of conditions ([m], [m/s], [deg], [kg/m3] ...) with an impossible value, in another unit
    or in another's place.

    table : columns of flight conditions, `time_s`, `altitude_m` and `velocity_m_s` among them; others may be absent
    """
    problems = [p for name in ("T_inf_K", "T_back_K") if name in table.columns for p in table.celsius_problems(name)]
    for name, (lowest, highest, rule) in LIMITS.items():
        if name in table.columns:
            problems += table.problems_where_not(name, (table[name] >= lowest) & (table[name] <= highest), rule)
    problems += _energy_problems(table)
    # A column that is impossible by itself would make every relation with it look wrong.
    return problems or [line for relation in RELATIONS for line in relation(table)] or _duration_problems(table)


def with_density(table: CsvTable) -> CsvTable:
    """Conditions with the density [kg/m3] from dynamic pressure [Pa] and speed [m/s], where a file has `q_Pa` in
    place of `rho_kg_m3`.

        rho = 2 q / V^2

    raises : InputError where neither is there, both are and differ, and for a speed of 0

    As the founding paper reduced its flights. Errors of the dynamic pressure, such as those of firing jets, are then in
    the density, in the reference heating of it, and in what is estimated (docs/reference/effects.md, jet-interaction).
    """
    if "q_Pa" not in table.columns:
        absent = f"{display_path(table.path)}: there is no column `rho_kg_m3` or `q_Pa`; add one"
        raise_problems([] if "rho_kg_m3" in table.columns else [absent])
        return table
    V, q = table["velocity_m_s"], table["q_Pa"]
    if "rho_kg_m3" in table.columns:
        same = np.abs(0.5 * table["rho_kg_m3"] * V**2 - q) <= SAME * q
        raise_problems(table.problems_where_not("q_Pa", same, "is not rho V^2 / 2 of this row; remove one of the two"))
        return table
    raise_problems(table.problems_where_not("velocity_m_s", V > 0.0, "gives no density with q_Pa; give rho_kg_m3"))
    return table.with_columns({"rho_kg_m3": 2.0 * q / V**2})


def _duration_problems(table: CsvTable) -> list[str]:
    """Conditions that last longer than any flight."""
    lasting = table["time_s"] - table["time_s"][0]
    rule = f"is more than {LONGEST_S:g} s after the first row and looks like ms or us; give s"
    return table.problems_where_not("time_s", lasting <= LONGEST_S, rule) or _around_problems(table)


def _energy_problems(table: CsvTable) -> list[str]:
    """Fast flight with little enthalpy (kJ/kg instead of J/kg) or at little height (km instead of m)."""
    speed = table["velocity_m_s"]
    rule = "is below a hundredth of V^2/2 and looks like kJ/kg; give J/kg"
    problems: list[str] = []
    if "H_r_J_kg" in table.columns:
        # without a flow, a lamp is stated by a film and an enthalpy far above the wall's
        possible = (speed < STILL_M_S) | (table["H_r_J_kg"] <= MOST_ENTHALPY_J_KG)
        problems += table.problems_where_not("H_r_J_kg", possible, LIMITS["H_r_J_kg"][2])
        problems += table.problems_where_not(
            "H_r_J_kg", (speed < 1000.0) | (table["H_r_J_kg"] >= 0.005 * speed**2), rule
        )
    high = (speed < HIGH_SPEED_M_S) | (np.abs(table["altitude_m"]) >= LOW_M)
    return problems + table.problems_where_not("altitude_m", high, LOW_RULE)


def _mostly_outside(
    table: CsvTable, column: str, ratio: FloatArray, used: BoolArray, limits: tuple[float, float]
) -> tuple[str, float] | None:
    """Place of the first row outside limits and median ratio of the used rows, where the median is outside; else None.

    The limits of few rows are wider: their median has the scatter of single samples.
    """
    if not np.any(used):
        return None
    margin = np.exp(SCATTER / np.sqrt(np.count_nonzero(used)))
    low, high, median = limits[0] / margin, limits[1] * margin, float(np.median(ratio[used]))
    if low <= median <= high:
        return None
    first = int(np.flatnonzero(used & ~((ratio >= low) & (ratio <= high)))[0])
    return f"{display_path(table.path)}, row {table.lines[first]}, column {column}", median


def _has(table: CsvTable, *names: str) -> bool:
    return all(name in table.columns for name in names)


def gas_problems(table: CsvTable) -> list[str]:
    """Pressure [Pa], density [kg/m3] and temperature [K] that are those of no gas."""
    if not _has(table, "p_inf_Pa", "rho_kg_m3", "T_inf_K"):
        return []
    outside = _mostly_outside(table, "p_inf_Pa", *_gas_ratio(table), GAS_RANGE)
    if outside is None:
        return []
    units = {
        0.01: "hPa",
        1e-3: "kPa",
        1.0 / 47.88: "psf",
        1.0 / 6894.8: "psi",
        1.0 / 133.32: "torr",
        1.0 / 101325.0: "atm",
    }
    close = [unit for size, unit in units.items() if 0.8 < outside[1] / size < 1.25]
    hint = f"; it looks like {close[0]}, give Pa" if close else "; check units and order of p, rho and T"
    return [f"{outside[0]}: p is {outside[1]:.3g} of rho R T of air, as no gas has it{hint}"]


def _gas_ratio(table: CsvTable) -> tuple[FloatArray, BoolArray]:
    """p / (rho R T) with R of air, and the rows that have it."""
    p, expected = table["p_inf_Pa"], table["rho_kg_m3"] * R_AIR * table["T_inf_K"]
    used = (p > 0.0) & (expected > 0.0)
    return np.divide(p, expected, out=np.ones_like(p), where=used), used


def mach_problems(table: CsvTable) -> list[str]:
    """Mach numbers [-] that are not the speed over the speed of sound: V / 1000 ft/s, or another unit of either."""
    if not _has(table, "mach"):
        return []
    V, mach, rho = table["velocity_m_s"], table["mach"], table["rho_kg_m3"]
    used = (V > 50.0) & (mach > 0.1)
    has_gas = _has(table, "T_inf_K", "p_inf_Pa")
    T = table["T_inf_K"] if _has(table, "T_inf_K") else us76(np.clip(table["altitude_m"], LOWEST_M, HIGHEST_M))[0]
    gas = np.clip(table["p_inf_Pa"] / (rho * T), R_AIR * GAS_RANGE[0], R_AIR * GAS_RANGE[1]) if has_gas else R_AIR
    # A pressure that is rounded to zero high up says nothing about the gas.
    gas = np.where(table["p_inf_Pa"] > 0.0, gas, R_AIR) if has_gas else np.full_like(T, R_AIR)
    if thousands := _thousands_of_feet(table, used & (V > 1000.0), np.sqrt(GAMMA * gas * T)):
        return thousands
    limits = MACH_RANGE if has_gas else MACH_RANGE_STANDARD
    scale = 1.0 if has_gas else np.sqrt(GAMMA)
    ratio = np.divide(mach * np.sqrt(gas * T) * scale, V, out=np.ones_like(V), where=used)
    outside = _mostly_outside(table, "mach", ratio, used, limits)
    if outside is None:
        return []
    expected = f"{outside[1] * np.sqrt(GAMMA) / scale:.3g} of velocity_m_s over the speed of sound"
    return [f"{outside[0]}: is {expected}; check units and order of mach, velocity_m_s and T_inf_K"]


def _thousands_of_feet(table: CsvTable, used: BoolArray, sound_m_s: FloatArray) -> list[str]:
    """Mach numbers that are speeds in 1000 ft/s, at a speed of sound [m/s]."""
    V, mach = table["velocity_m_s"][used], table["mach"][used]
    if len(V) <= 3 or not np.allclose(mach * FT_S / V, 1.0, rtol=SAME):
        return []
    true = V / sound_m_s[used]
    if np.max(np.abs(true / mach - 1.0)) <= 5.0 * SAME:
        return []
    rule = "is V / 1000 ft/s, as the Shuttle's literature has it; Mach here is V over the speed of sound"
    first = int(np.flatnonzero(used)[0])
    return [f"{table.problem(first, 'mach', rule)}, {true[0]:.4g}; correct the column or omit it"]


def reynolds_problems(table: CsvTable) -> list[str]:
    """Reynolds numbers [-] that imply no length: natural logarithms, or another column."""
    if not _has(table, "log10_re", "T_inf_K"):
        return []
    unit, used = _unit_reynolds(table)
    length = np.where(used, 10.0 ** table["log10_re"] / np.where(used, unit, 1.0), 1.0)
    outside = _mostly_outside(table, "log10_re", length, used, LENGTHS_M)
    if outside is None:
        return []
    as_log = np.where(used, np.exp(table["log10_re"]) / np.where(used, unit, 1.0), 1.0)
    natural = _mostly_outside(table, "log10_re", as_log, used, LENGTHS_M) is None
    hint = "it looks like a natural logarithm, give the base-10 one" if natural else "check the columns of rho V L / mu"
    return [f"{outside[0]}: implies a reference length of {outside[1]:.3g} m; {hint}"]


def _unit_reynolds(table: CsvTable | Mapping[str, FloatArray]) -> tuple[FloatArray, BoolArray]:
    """Reynolds number of 1 m, rho V / mu(T) [1/m], and the rows with which a Reynolds number implies a length."""
    unit = table["rho_kg_m3"] * table["velocity_m_s"] / viscosity(np.maximum(table["T_inf_K"], 1.0))
    return unit, (unit > 1e-2) & (table["log10_re"] > -3.0)


def implied_length_m(columns: Mapping[str, FloatArray]) -> float | None:
    """Median reference length L = Re mu(T) / (rho V) that Reynolds numbers imply [m]; None where nothing implies one.

    columns : flight conditions, name -> (row,) in the unit that the name ends in
    Source: docs/theory/equations_reference_heating.md, equation 3.
    """
    if not {"log10_re", "rho_kg_m3", "velocity_m_s", "T_inf_K"} <= set(columns):
        return None
    unit, used = _unit_reynolds(columns)
    return float(np.median(10.0 ** columns["log10_re"][used] / unit[used])) if np.any(used) else None


def profile_problems(table: CsvTable) -> list[str]:
    """A density [kg/m3] that does not fall with altitude [m], or is far from any standard atmosphere of the Earth."""
    z, rho = table["altitude_m"], table["rho_kg_m3"]
    lowest, highest = int(np.argmin(z)), int(np.argmax(z))
    span = z[highest] - z[lowest]
    where = f"{display_path(table.path)}, column rho_kg_m3"
    if span >= PROFILE_M and np.log(rho[lowest] / rho[highest]) < span / SCALE_HEIGHT_M:
        values = f"{rho[lowest]:.3g} at {z[lowest]:.0f} m and {rho[highest]:.3g} at {z[highest]:.0f} m"
        return [f"{where}: {values}; the density of an atmosphere falls with altitude, check columns and units"]
    # A file with its own temperature may be of another planet; without one it is computed as a flight on Earth.
    if _has(table, "T_inf_K") or span < STANDARD_SPAN_M:
        return []
    inside = (z >= LOWEST_M) & (z <= STANDARD_BELOW_M)
    if not np.any(inside):
        return []
    standard = us76(np.clip(z, LOWEST_M, HIGHEST_M))[2]
    outside = _mostly_outside(table, "rho_kg_m3", rho / standard, inside, STANDARD_RANGE)
    if outside is None:
        return []
    units = {1e-3: "g/cm3", 1.0 / 515.379: "slug/ft3", 1.0 / 16.0185: "lb/ft3"}
    close = min(units, key=lambda size: abs(np.log(outside[1] / size)))
    near = 0.4 < outside[1] / close < 2.5
    hint = f"it looks like {units[close]}, give kg/m3" if near else "check its unit, or give T_inf_K of that atmosphere"
    return [f"{outside[0]}: is {outside[1]:.3g} of the standard atmosphere's; {hint}"]


def feet_problems(table: CsvTable) -> list[str]:
    """Altitudes in ft: pressure [Pa] and density [kg/m3] are those of the standard atmosphere at 0.3048 of the
    altitude."""
    z, names = table["altitude_m"], [n for n in ("p_inf_Pa", "rho_kg_m3") if n in table.columns]
    used = (z >= FEET_FROM_M) & (z <= HIGHEST_M) & (FOOT_M * z <= STANDARD_BELOW_M)
    used &= np.all([table[n] > 0.0 for n in names], axis=0)
    if not names or np.count_nonzero(used) < LEAST_ROWS:
        return []
    near, far = (_far_from_standard(table, names, used, scale * z[used]) for scale in (FOOT_M, 1.0))
    if max(near) > NEAR_STANDARD or min(far) < FAR_FROM_STANDARD + 3.0 * max(near):
        return []
    first, name = int(np.flatnonzero(used)[0]), names[0]
    rule = f"looks like ft: {name} there is {table[name][first]:.4g}, that of the standard atmosphere at"
    write = f"{FOOT_M * z[first]:.0f} m; give m, or name the column `altitude_ft`"
    return [f"{table.problem(first, 'altitude_m', rule)} {write}"]


def _far_from_standard(table: CsvTable, names: Sequence[str], used: BoolArray, z: FloatArray) -> list[float]:
    """Median distance of columns from the standard atmosphere at altitudes z [m], as the size of a logarithm."""
    air = dict(zip(("T_inf_K", "p_inf_Pa", "rho_kg_m3"), us76(z), strict=True))
    return [float(np.median(np.abs(np.log(table[name][used] / air[name])))) for name in names]


def speed_problems(table: CsvTable) -> list[str]:
    """Speeds in km/s."""
    V, z = table["velocity_m_s"], table["altitude_m"]
    fastest = float(np.max(V))
    if np.ptp(z) < PROFILE_M or not 1.0 <= fastest < SLOWEST_M_S:
        return []
    question = QUANTITIES["velocity_m_s"].suggestion(fastest)
    where = f"{display_path(table.path)}, column velocity_m_s"
    return [f"{where}: nothing crosses {np.ptp(z) / 1e3:.0f} km of altitude at {fastest:g} m/s at most{question}"]


def clock_problems(table: CsvTable) -> list[str]:
    """A time that is not in seconds, by the change of altitude and by the drag that slows a gliding flight."""
    t, z, V = table["time_s"], table["altitude_m"], table["velocity_m_s"]
    if len(t) < 3 or np.any(np.diff(t) <= 0.0):
        return []
    where = f"{display_path(table.path)}, column time_s"
    # Over parts of the flight that are long enough for an altitude that is rounded to 100 m, or scatters.
    path = np.concatenate(([0.0], np.cumsum(0.5 * (V[1:] + V[:-1] + 2.0 * RATE_SLACK_M_S) * np.diff(t))))
    climbed = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(z)))))
    ends = np.searchsorted(climbed, np.arange(0.0, climbed[-1], PART_M))
    steep = np.flatnonzero(np.abs(np.diff(z[ends])) > np.maximum(np.diff(path[ends]), LOW_M))
    if steep.size:
        if alone := _standing_out(table, "altitude_m"):  # a sample, not the clock
            return alone
        a, b = ends[steep[0]], ends[steep[0] + 1]
        change = f"altitude changes by {abs(z[b] - z[a]):.4g} m over a path of {path[b] - path[a]:.4g} m"
        return [f"{where}: from {t[a]:g} to {t[b]:g} {change}; the time is not in s"]
    ballistic = _ballistic_kg_m2(table, LOST_ENERGY)
    if ballistic is None or BALLISTIC_KG_M2[0] <= ballistic <= BALLISTIC_KG_M2[1]:
        return []
    usual = {1e3: "milliseconds", 1e6: "microseconds", 1.0 / 60.0: "minutes", 1.0 / 3600.0: "hours"}
    close = [u for size, u in usual.items() if 50.0 <= ballistic / size <= 5e3]
    hint = f"the clock of the flight conditions is in {close[0]}, give s" if close else "check time, density and speed"
    return [f"{where}: the flight slows as with {ballistic:.3g} kg/m2 of mass over drag area; {hint}"]


def _around_problems(table: CsvTable) -> list[str]:
    """A fast flight in the air that is longer than twice around the Earth."""
    t, z, V = table["time_s"], table["altitude_m"], table["velocity_m_s"]
    fast = (z <= AROUND_BELOW_M) & (V >= HIGH_SPEED_M_S)
    around = float(np.sum((0.5 * (V[1:] + V[:-1]) * np.diff(t))[fast[1:] & fast[:-1]]))
    if around <= AROUND_M:
        return []
    length = f"the path faster than {HIGH_SPEED_M_S:g} m/s and below {AROUND_BELOW_M:g} m is {around:.3g} m long"
    where = f"{display_path(table.path)}, column time_s"
    return [f"{where}: {length}, {around / 4e7:.3g} times around the Earth; the time is not in s"]


def _ballistic_kg_m2(table: CsvTable, least_lost: float) -> float | None:
    """Mass over drag area [kg/m2] with which a fast flight slows below 100 km; None where it hardly does.

    least_lost : part of the first sample's energy that it loses at least
    """
    inside = table["altitude_m"] <= STANDARD_BELOW_M
    if np.count_nonzero(inside) < 3:
        return None
    t, V, rho, z = (table[n][inside] for n in ("time_s", "velocity_m_s", "rho_kg_m3", "altitude_m"))
    energy = 0.5 * V**2 + G0_M_S2 * z
    lost = float(energy[0] - energy[-1])
    if lost < least_lost * energy[0] or energy[0] < 0.5 * HIGH_SPEED_M_S**2:
        return None
    return float(np.trapezoid(0.5 * rho * V**3, t)) / lost


def lift_problems(table: CsvTable) -> list[str]:
    """A path high up that falls less than its speed and the thin air around it let it: the speed [m/s] is too low.

    As of a speed that was multiplied by pi/180: 130 m/s at 80 km, where the air carries 0.02 m/s2.
    """
    least = _least_carried(table)
    if least is None or least[1] >= CARRIED_KG_M2:
        return []
    k, _, needed = least
    where = f"{display_path(table.path)}, row {table.lines[k]}, column velocity_m_s"
    at = f"{table['velocity_m_s'][k]:.4g} m/s at {table['altitude_m'][k]:.4g} m"
    return [f"{where}: {at} need {needed:.3g} m/s2 of lift, which no wing has there; check speed, altitude and time"]


def _least_carried(table: CsvTable) -> tuple[int, float, float] | None:
    """Row, mass over lifting area [kg/m2], and lift needed [m/s2] of the window in which that area is largest.

    Windows of 60 s or 5 samples, above 55 km, in which the speed does not rise as under thrust.
    """
    t, z, V, rho = (table[n] for n in ("time_s", "altitude_m", "velocity_m_s", "rho_kg_m3"))
    if len(t) < WINDOW_SAMPLES or np.any(np.diff(t) <= 0.0):
        return None
    weight = G0_M_S2 * (EARTH_RADIUS_M / (EARTH_RADIUS_M + z)) ** 2 - V**2 / (EARTH_RADIUS_M + z)
    q = 0.5 * rho * V**2
    windows: list[tuple[int, float, float]] = []
    begin = 0
    while begin + WINDOW_SAMPLES <= len(t):
        end = max(begin + WINDOW_SAMPLES, int(np.searchsorted(t, t[begin] + WINDOW_S)))
        end = min(end, len(t))
        window = slice(begin, end)
        begin = end
        if np.min(z[window]) < CARRIED_ABOVE_M or t[end - 1] - t[window.start] <= 1.0:
            continue
        x = t[window] - t[window.start]
        bend, rise = 2.0 * np.polyfit(x, z[window], 2)[0], np.polyfit(x, V[window], 1)[0]
        needed = float(np.mean(weight[window]) + bend) - LIFT_SLACK_M_S2
        if needed <= 0.0 or rise > THRUST_M_S2:
            continue
        windows.append((window.start, float(np.max(q[window])) / needed, needed))
    return min(windows, key=lambda window: window[1], default=None)


def enthalpy_problems(table: CsvTable) -> list[str]:
    """A recovery enthalpy [J/kg], a film coefficient [kg/(m2 s)] or a dynamic pressure [Pa] that the flight cannot
    have."""
    problems: list[str] = []
    for column, _, ratio, used, limits, text in _flight_ratios(table):
        outside = None if limits is None else _mostly_outside(table, column, ratio, used, limits)
        problems += (
            [] if outside is None else [f"{outside[0]}: {text.format(outside[1])}; check its unit and its place"]
        )
    return problems


Ratio = tuple[str, tuple[float, float], FloatArray, BoolArray, tuple[float, float] | None, str]
"""Column, usual range of a ratio, the ratio in each row, rows that have it, possible range or None, words for it."""


def _flight_ratios(table: CsvTable) -> Iterator[Ratio]:
    """Ratios of columns to what the others imply."""
    V, rho = table["velocity_m_s"], table["rho_kg_m3"]
    if _has(table, "H_r_J_kg"):
        T = table["T_inf_K"] if _has(table, "T_inf_K") else np.full_like(V, 250.0)
        total = 0.5 * V**2 + CP_AIR * T
        # without a flow, a lamp is stated by an enthalpy that no flow has
        at_rest = (V <= SLOWEST_M_S) & (table["H_r_J_kg"] <= MOST_ENTHALPY_J_KG)
        for used, possible in ((V > 1000.0, ENTHALPIES), (at_rest, None)):
            yield "H_r_J_kg", (0.78, 1.25), table["H_r_J_kg"] / total, used, possible, "is {:.3g} of V^2 / 2 + cp T"
    if _has(table, "h_ref_kg_m2_s"):
        h = table["h_ref_kg_m2_s"]
        used = (V > 1000.0) & (h > 0.0) & (rho > 0.0)
        radius = np.where(used, rho * (2.0 * SUTTON_GRAVES * V / np.where(used, h, 1.0)) ** 2, 1.0)
        yield "h_ref_kg_m2_s", (4e-3, 300.0), radius, used, RADII_M, "is that of a sphere of {:.3g} m radius"
    if _has(table, "qbar_Pa"):
        q = 0.5 * rho * V**2
        used = q > 0.0
        ratio = np.divide(table["qbar_Pa"], q, out=np.ones_like(q), where=used)
        yield "qbar_Pa", (0.9, 1.1), ratio, used, QBARS, "is {:.3g} of rho V^2 / 2"
    if _has(table, "p_surface_Pa", "p_inf_Pa"):
        highest = table["p_inf_Pa"] + rho * V**2
        used = (V > 300.0) & (table["p_surface_Pa"] > 0.0)
        ratio = np.divide(table["p_surface_Pa"], highest, out=np.ones_like(V), where=used & (highest > 0.0))
        yield "p_surface_Pa", (8e-4, 1.1), ratio, used, None, "is {:.3g} of p + rho V^2, that of a stagnation point"
    if _has(table, "axial_accel_g"):
        drag = np.abs(table["axial_accel_g"]) * G0_M_S2
        q = 0.5 * rho * V**2
        used = (q > 10.0) & (drag > 0.01)
        ratio = np.divide(q, drag, out=np.ones_like(q), where=used)
        yield "axial_accel_g", (20.0, 2e4), ratio, used, None, "implies {:.3g} kg/m2 of mass over axial drag area"


def implied_radius_m(table: CsvTable) -> float | None:
    """Median radius [m] of the sphere that the film coefficients are those of; None where nothing flies fast.

    R = rho (2 * 1.7415e-4 V / h_ref)^2, from q = 1.7415e-4 (rho / R)^0.5 V^3 and H_r = V^2 / 2.

    Source: Sutton and Graves (1971), NASA TR R-376.
    """
    for column, _, radius, used, _, _ in _flight_ratios(table):
        if column == "h_ref_kg_m2_s" and np.any(used):
            return float(np.median(radius[used]))
    return None


def swapped_problems(table: CsvTable) -> list[str]:
    """Angles of attack and of sideslip [deg] in each other's place."""
    if not _has(table, "alpha_deg", "beta_deg"):
        return []
    alpha, beta = np.median(np.abs(table["alpha_deg"])), np.median(np.abs(table["beta_deg"]))
    if beta < 20.0 or alpha > 0.5 * beta:
        return []
    where = f"{display_path(table.path)}, columns alpha_deg and beta_deg"
    return [f"{where}: {beta:g} deg of sideslip at {alpha:g} deg of attack look swapped"]


RELATIONS: tuple[Callable[[CsvTable], list[str]], ...] = (
    feet_problems,
    speed_problems,
    gas_problems,
    mach_problems,
    reynolds_problems,
    profile_problems,
    clock_problems,
    swapped_problems,
    lift_problems,
    enthalpy_problems,
)
"""Relations between columns, each with the problems of a table whose columns are possible by themselves."""


# What is unusual ------------------------------------------------------------------------------------------------------

FACTORS: dict[str, float] = {
    "velocity_m_s": 1.15, "mach": 1.2, "T_inf_K": 1.3, "H_r_J_kg": 1.3, "h_ref_kg_m2_s": 2.5, "rho_kg_m3": 2.5,
    "p_inf_Pa": 2.5, "p_surface_Pa": 3.0, "q_Pa": 2.5, "qbar_Pa": 2.5, "T_surroundings_K": 1.5, "T_back_K": 1.3,
    "T_upstream_K": 1.5,
}  # fmt: skip
"""Column -> factor by which a sample that stands out is off the samples before and after it, beyond their own change.

Twice that of scatter, winds, rounding and firing jets, which disturb the density that is derived from acceleration."""
STEPS: dict[str, float] = {
    "altitude_m": 1500.0,
    "alpha_deg": 15.0,
    "beta_deg": 12.0,
    "elevon_deg": 20.0,
    "bodyflap_deg": 20.0,
    "gamma_deg": 15.0,
    "log10_re": 0.4,
    "q_add_W_m2": 3e4,
}
"""Column -> difference, in its unit, by which a sample that stands out is off those before and after it."""
CHANGE = 2.0
"""How many times the change from the sample before to that after, or the scatter of the column, is no standing out."""
MACHS, MACHS_STANDARD = (0.9, 1.1), (0.7, 1.4)
"""Mach number over V / sqrt(gamma R T): with the temperature of the file, and with that of the standard atmosphere."""
GASES, DENSITIES, TEMPERATURES = (0.8, 1.25), (0.3, 3.0), (0.75, 1.35)
"""p / (rho R T) of air, density and temperature over those of the standard atmosphere."""
TEMPERATURES_BELOW_M = 85e3
LENGTHS_OF_VEHICLES_M, LENGTH_SCATTER = (0.05, 150.0), 3.0
"""Reference lengths [m] of vehicles, and the factor by which that of one flight may seem to change."""
BALLISTIC_USUAL_KG_M2 = (60.0, 1300.0)
"""Mass over drag area [kg/m2] of light capsules to heavy winged vehicles; inflated decelerators are below."""
LOST_A_LITTLE = 0.1
CARRIED_USUAL_KG_M2 = 15.0
"""Mass over lifting area [kg/m2] of the lightest hypersonic vehicles."""
GAINED = 0.05
"""Part of the energy that a flight does not gain without thrust; winds and gusts give a few thousandths."""
RADIANS = {"alpha_deg": 1.2, "elevon_deg": 0.35, "bodyflap_deg": 0.45}
"""Column -> largest value [deg] of a fast flight below which it looks like radians: 20 deg are 0.35."""
TRACK = (0.8, 1.25)
"""Distance over ground between positions over that which the speed covers; winds and the turn of the Earth add 7 %."""
HEADING_DEG = 15.0
"""Median difference [deg] of a column of headings and of the path over ground."""
GAMMA_DEG = 2.0
"""Median difference [deg] of a column of path angles and of the path."""
STEEP_DEG, GAMMA_SLOPES = 0.3, (0.6, 1.6)
"""Path [deg] from which a column of path angles is compared as a factor, and that factor; winds give a few percent."""


def unusual_values(table: CsvTable) -> list[str]:
    """One line for each column ([m], [m/s], [deg], [kg/m3] ...) that is possible and unlike that of flights: its
    values, neighbours, and other columns.

    table : columns that `implausible_values` finds no problem in
    """
    remarks: list[str] = []
    for name in table.columns:
        remarks += _beyond_usual(table, name) or _radians(table, name) or _standing_out(table, name)
    for column, usual, ratio, used, text in _usual_ratios(table):
        outside = _mostly_outside(table, column, ratio, used, usual)
        if outside is not None:
            ratio_text = text.format(outside[1])
            remarks.append(f"{outside[0]}: {ratio_text} ({usual[0]:g} to {usual[1]:g} is usual); check its unit")
    return remarks + _path_remarks(table)


def _beyond_usual(table: CsvTable, name: str) -> list[str]:
    """The first value of a column beyond its usual range."""
    usual = USUAL.get(name) or (None if name in LIMITS else QUANTITIES.get(name))
    if usual is None or (name == "H_r_J_kg" and np.max(table["velocity_m_s"]) < STILL_M_S):
        return []
    if isinstance(usual, Quantity):
        return table.problems_where_not(
            name, (table[name] >= usual.lowest) & (table[name] <= usual.highest), usual.rule
        )
    rule = f"is unusual ({usual.lowest:g} to {usual.highest:g}: {usual.source}); check its unit"
    values = table[name]
    # NaN is a lost sample; a column of zeros says nothing.
    return table.problems_where_not(name, ~(values < usual.lowest) & ~(values > usual.highest) | (values == 0.0), rule)


def _radians(table: CsvTable, name: str) -> list[str]:
    """Angles of attack or of control surfaces that are as small throughout a fast flight as in radians."""
    largest = RADIANS.get(name)
    if largest is None or np.max(table["velocity_m_s"]) < 1000.0 or not 0.0 < np.max(np.abs(table[name])) < largest:
        return []
    remark = f"is {np.max(np.abs(table[name])):.3g} deg at most; is it in radians?"
    return [f"{display_path(table.path)}, column {name}: {remark}"]


def standing_out(time_s: FloatArray, values: FloatArray, step: float, is_factor: bool = False) -> BoolArray:
    """Samples that are off the line through those before and after them, beyond what the column changes and scatters.

    time_s, values : (sample,) [s], and any unit
    step           : least difference that stands out, or factor
    is_factor      : the values are positive, and differ by factors

    At the ends the two nearest samples are continued, or the nearest one holds. Scatter is the median deviation from
    those lines.
    """
    bad = np.zeros(len(values), dtype=bool)
    if len(values) < 5:
        return bad
    x = np.log(values) if is_factor else values
    before, after = np.arange(len(x)) - 1, np.arange(len(x)) + 1
    before[0], after[0], before[-1], after[-1] = 1, 2, len(x) - 3, len(x) - 2
    span = time_s[after] - time_s[before]
    off = np.abs(x - x[before] - (x[after] - x[before]) * (time_s - time_s[before]) / span)
    for end, inner in ((0, 1), (-1, -2)):  # a lamp that is yet to be switched on holds its value
        off[end] = min(off[end], abs(x[end] - x[inner]))
    allowed = np.log(step) if is_factor else step
    change = np.abs(x[after] - x[before])
    return off > allowed + CHANGE * (change + 4.0 * float(np.median(off)))


def _standing_out(table: CsvTable, name: str) -> list[str]:
    """The first sample of a column that stands out of the samples before and after it."""
    if name not in FACTORS and name not in STEPS:
        return []
    values, is_factor = table[name], name in FACTORS
    rows = np.flatnonzero(values > 0.0) if is_factor else np.arange(len(values))
    bad = np.zeros(len(values), dtype=bool)
    step = FACTORS[name] if is_factor else STEPS[name]
    bad[rows] = standing_out(table["time_s"][rows], values[rows], step, is_factor)
    return table.problems_where_not(name, ~bad, "stands out of the rows before and after it; check it")


def _usual_ratios(table: CsvTable) -> Iterator[tuple[str, tuple[float, float], FloatArray, BoolArray, str]]:
    """Column, usual range, ratio to what the others imply, rows that have it, and words for it."""
    V, z, rho = table["velocity_m_s"], table["altitude_m"], table["rho_kg_m3"]
    # the stream of a tunnel has no altitude, which is stated as constant
    flying = (V > 50.0) & (z >= LOWEST_M) & (z <= STANDARD_BELOW_M) & (np.ptp(z) > 0.0)
    T_0, _, rho_0 = us76(np.clip(z, LOWEST_M, HIGHEST_M))
    if not _has(table, "q_Pa"):
        yield "rho_kg_m3", DENSITIES, rho / rho_0, flying, "is {:.3g} of the standard atmosphere's"
    if _has(table, "T_inf_K"):
        low = flying & (z <= TEMPERATURES_BELOW_M)
        yield "T_inf_K", TEMPERATURES, table["T_inf_K"] / T_0, low, "is {:.3g} of the standard atmosphere's"
    if _has(table, "p_inf_Pa", "T_inf_K"):
        yield "p_inf_Pa", GASES, *_gas_ratio(table), "is {:.3g} of rho R T of air"
    if _has(table, "mach"):
        has_temperature = _has(table, "T_inf_K")
        sound = np.sqrt(GAMMA * R_AIR * np.maximum(table["T_inf_K"] if has_temperature else T_0, 1.0))
        used = (V > 50.0) & (table["mach"] > 0.0)
        ratio = np.where(used, table["mach"] * sound / np.where(used, V, 1.0), 1.0)
        yield (
            "mach",
            MACHS if has_temperature else MACHS_STANDARD,
            ratio,
            used,
            "is {:.3g} of velocity_m_s over the speed of sound",
        )
    if _has(table, "log10_re", "T_inf_K"):
        unit, used = _unit_reynolds(table)
        length = np.where(used, 10.0 ** table["log10_re"] / np.where(used, unit, 1.0), 1.0)
        yield "log10_re", LENGTHS_OF_VEHICLES_M, length, used, "implies a reference length of {:.3g} m"
        if np.any(used):
            low, high = np.percentile(length[used], [10.0, 90.0])
            change = np.full_like(length, high / low)
            yield "log10_re", (1.0, LENGTH_SCATTER), change, used, "implies lengths that differ by a factor {:.3g}"
    for column, usual, ratio, used, _, text in _flight_ratios(table):
        yield column, usual, ratio, used, text


def _path_remarks(table: CsvTable) -> list[str]:
    """A path that is unlike that of an entry: drag, lift, energy, path angle."""
    t, z, V = table["time_s"], table["altitude_m"], table["velocity_m_s"]
    where, remarks = display_path(table.path), []
    if len(t) < WINDOW_SAMPLES or np.any(np.diff(t) <= 0.0):
        return []
    ballistic = _ballistic_kg_m2(table, LOST_A_LITTLE)
    low, high = BALLISTIC_USUAL_KG_M2
    if ballistic is not None and not low <= ballistic <= high:
        remark = f"the flight slows as with {ballistic:.3g} kg/m2 of mass over drag area ({low:g} to {high:g} is usual)"
        remarks.append(f"{where}, column time_s: {remark}; check time, density and speed")
    carried = _least_carried(table)
    if carried is not None and carried[1] < CARRIED_USUAL_KG_M2:
        remark = (
            f"{carried[1]:.3g} kg/m2 of mass over lifting area would fly so ({CARRIED_USUAL_KG_M2:g} or more is usual)"
        )
        rows = f"row {table.lines[carried[0]]}, column velocity_m_s"
        remarks.append(f"{where}, {rows}: {remark}; check speed, altitude, time and density")
    energy = 0.5 * V**2 + G0_M_S2 * z
    gained = energy / np.maximum(np.minimum.accumulate(energy), 1.0) - 1.0
    k = int(np.argmax(gained))
    if np.max(energy) >= 0.5 * HIGH_SPEED_M_S**2 and gained[k] > GAINED:
        remark = f"the energy V^2 / 2 + g h has risen by {100.0 * gained[k]:.3g} % here, and drag lets it fall"
        remarks.append(f"{where}, row {table.lines[k]}, column velocity_m_s: {remark}; was there thrust?")
    return [*remarks, *_track_remarks(table), *_path_angle_remarks(table)]


def _path_angle_remarks(table: CsvTable) -> list[str]:
    """A path angle that is not that of the change of altitude, or another unit of it."""
    t, z, V = table["time_s"], table["altitude_m"], table["velocity_m_s"]
    moving = V > 300.0
    if not _has(table, "gamma_deg") or not np.any(moving):
        return []
    path = np.degrees(np.arcsin(np.clip(np.gradient(z, t)[moving] / V[moving], -1.0, 1.0)))
    stated = table["gamma_deg"][moving]
    off = float(np.median(np.abs(path - stated)))
    slope = float(np.sum(path * stated) / max(np.sum(path**2), 1e-9))
    is_scaled = np.sqrt(np.mean(path**2)) > STEEP_DEG and not GAMMA_SLOPES[0] <= slope <= GAMMA_SLOPES[1]
    if off <= GAMMA_DEG and not is_scaled:
        return []
    differs = f"differs by {off:.3g} deg from" if off > GAMMA_DEG else f"is {slope:.3g} of"
    relation = f"{differs} the path that altitude, time and speed describe"
    return [f"{display_path(table.path)}, column gamma_deg: {relation}; check its unit"]


def _track_remarks(table: CsvTable) -> list[str]:
    """Positions over ground that the speed does not lead to, in the time that they take."""
    if not _has(table, "latitude_deg", "longitude_deg"):
        return []
    t, z, V = table["time_s"], table["altitude_m"], table["velocity_m_s"]
    latitude, longitude = np.radians(table["latitude_deg"]), np.radians(table["longitude_deg"])
    north, east = np.diff(latitude), np.cos(0.5 * (latitude[1:] + latitude[:-1])) * np.sin(np.diff(longitude))
    flat = np.sqrt(np.maximum((0.5 * (V[1:] + V[:-1]) * np.diff(t)) ** 2 - np.diff(z) ** 2, 0.0))
    flown = flat * EARTH_RADIUS_M / (EARTH_RADIUS_M + z[1:])
    used = flown > 100.0
    if np.count_nonzero(used) < WINDOW_SAMPLES:
        return []
    if _has(table, "heading_deg"):
        turned = np.degrees(np.arctan2(east, north)) - table["heading_deg"][1:]
        off = float(np.median(np.abs((turned[used] + 180.0) % 360.0 - 180.0)))
        if off > HEADING_DEG:
            remark = f"differs by {off:.3g} deg from the path over ground; check its unit"
            return [f"{display_path(table.path)}, column heading_deg: {remark}"]
    ratio = float(np.median(EARTH_RADIUS_M * np.hypot(north, east)[used] / flown[used]))
    if TRACK[0] <= ratio <= TRACK[1]:
        return []
    remark = (
        f"move over ground by {ratio:.3g} of what speed and time give; check their unit, and that of time and speed"
    )
    return [f"{display_path(table.path)}, columns latitude_deg and longitude_deg: {remark}"]
