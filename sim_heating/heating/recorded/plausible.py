"""Plausibility of recorded flight conditions: each column within its limits, and consistent with the others.

Tolerances follow from physics and are wide: what is refused is a column in another unit, in another's place, or
damaged, never a flight with scatter, in another gas, or with an atmosphere that differs from the standard one.

    p = rho R T       R between that of carbon dioxide and of hydrogen; a pressure in hPa, or a temperature in
                      Rankine, lies outside
    M = V / a         a = sqrt(gamma R T), gamma 1.05 to 1.67 and R by p / (rho T); a speed in knots lies outside
    |dh/dt| <= V      a time in minutes or hours lies outside
    mass / (C_D A)    = int rho V^3 / 2 dt / -(change of V^2 / 2 + g h), of gliding flight; a time in ms lies outside
    log10 Re          = log10(rho V L / mu) with one length L; natural logarithms lie outside
    p over h          near that of the standard atmosphere at 0.3048 h alone: altitudes in ft lie outside
    rho over h        falls by at least e in 100 km, which no planet's atmosphere exceeds
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.base.files import CsvTable, display_path, raise_problems
from sim_heating.base.limits import (
    HIGH_SPEED_M_S,
    LIMITS,
    LOW_M,
    LOW_RULE,
    QUANTITIES,
    SLOWEST_M_S,
)
from sim_heating.heating.atmosphere import G0_M_S2, GAMMA, HIGHEST_M, LOWEST_M, R_AIR, us76
from sim_heating.heating.atmosphere import sutherland_viscosity as viscosity

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
"""Altitude [m] from which one in ft is told from one in m by the air."""
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


def implausible_values(table: CsvTable) -> list[str]:
    """One line for each column of conditions with an impossible value, in another unit or in another's place.

    table : columns of flight conditions, `time_s`, `altitude_m` and `velocity_m_s` among them; others may be absent
    """
    celsius = [table.celsius_problems(name) for name in ("T_inf_K", "T_back_K") if name in table.columns]
    problems = [line for lines in celsius for line in lines]
    for name, (lowest, highest, rule) in LIMITS.items():
        if name in table.columns:
            problems += table.problems_where_not(name, (table[name] >= lowest) & (table[name] <= highest), rule)
    problems += _energy_problems(table)
    # A column that is impossible by itself would make every relation with it look wrong.
    return problems or [line for relation in RELATIONS for line in relation(table)] or _duration_problems(table)


def with_density(table: CsvTable) -> CsvTable:
    """Conditions with the density from dynamic pressure and speed, where a file has `q_Pa` in place of `rho_kg_m3`.

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
    return table.problems_where_not("time_s", lasting <= LONGEST_S, rule)


def _energy_problems(table: CsvTable) -> list[str]:
    """Fast flight with little enthalpy (kJ/kg instead of J/kg) or at little height (km instead of m)."""
    speed = table["velocity_m_s"]
    rule = "is below a hundredth of V^2/2 and looks like kJ/kg; give J/kg"
    problems: list[str] = []
    if "H_r_J_kg" in table.columns:
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
    """Pressure, density and temperature that are those of no gas."""
    if not _has(table, "p_inf_Pa", "rho_kg_m3", "T_inf_K"):
        return []
    p, expected = table["p_inf_Pa"], table["rho_kg_m3"] * R_AIR * table["T_inf_K"]
    used = (p > 0.0) & (expected > 0.0)
    found = _mostly_outside(table, "p_inf_Pa", np.divide(p, expected, out=np.ones_like(p), where=used), used, GAS_RANGE)
    if found is None:
        return []
    units = {0.01: "hPa", 1e-3: "kPa", 1.0 / 47.88: "psf", 1.0 / 6894.8: "psi", 1.0 / 133.32: "torr",
             1.0 / 101325.0: "atm"}  # fmt: skip
    close = [unit for size, unit in units.items() if 0.8 < found[1] / size < 1.25]
    hint = f"; it looks like {close[0]}, give Pa" if close else "; check units and order of p, rho and T"
    return [f"{found[0]}: p is {found[1]:.3g} of rho R T of air, as no gas has it{hint}"]


def mach_problems(table: CsvTable) -> list[str]:
    """Mach numbers that are not the speed over the speed of sound: V / 1000 ft/s, or another unit of either."""
    if not _has(table, "mach"):
        return []
    V, mach, rho = table["velocity_m_s"], table["mach"], table["rho_kg_m3"]
    used = (V > 50.0) & (mach > 0.1)
    own = _has(table, "T_inf_K", "p_inf_Pa")
    T = table["T_inf_K"] if _has(table, "T_inf_K") else us76(np.clip(table["altitude_m"], LOWEST_M, HIGHEST_M))[0]
    gas = np.clip(table["p_inf_Pa"] / (rho * T), R_AIR * GAS_RANGE[0], R_AIR * GAS_RANGE[1]) if own else R_AIR
    # A pressure that is rounded to zero high up says nothing about the gas.
    gas = np.where(table["p_inf_Pa"] > 0.0, gas, R_AIR) if own else np.full_like(T, R_AIR)
    thousands = used & (V > 1000.0)
    if np.count_nonzero(thousands) > 3 and np.allclose(mach[thousands] * FT_S / V[thousands], 1.0, rtol=SAME):
        true = V[thousands] / np.sqrt(GAMMA * gas[thousands] * T[thousands])
        if np.max(np.abs(true / mach[thousands] - 1.0)) > 5.0 * SAME:
            first = int(np.flatnonzero(thousands)[0])
            rule = "is V / 1000 ft/s, as the Shuttle's literature has it; Mach here is V over the speed of sound"
            return [f"{table.problem(first, 'mach', rule)}, {true[0]:.4g}; correct the column or omit it"]
    limits = MACH_RANGE if own else MACH_RANGE_STANDARD
    scale = 1.0 if own else np.sqrt(GAMMA)
    ratio = np.divide(mach * np.sqrt(gas * T) * scale, V, out=np.ones_like(V), where=used)
    found = _mostly_outside(table, "mach", ratio, used, limits)
    if found is None:
        return []
    expected = f"{found[1] * np.sqrt(GAMMA) / scale:.3g} of velocity_m_s over the speed of sound"
    return [f"{found[0]}: is {expected}; check units and order of mach, velocity_m_s and T_inf_K"]


def reynolds_problems(table: CsvTable) -> list[str]:
    """Reynolds numbers that imply no length: natural logarithms, or another column."""
    if not _has(table, "log10_re", "T_inf_K"):
        return []
    unit = table["rho_kg_m3"] * table["velocity_m_s"] / viscosity(np.maximum(table["T_inf_K"], 1.0))
    used = (unit > 1e-2) & (table["log10_re"] > -3.0)
    length = np.where(used, 10.0 ** table["log10_re"] / np.where(used, unit, 1.0), 1.0)
    found = _mostly_outside(table, "log10_re", length, used, LENGTHS_M)
    if found is None:
        return []
    as_log = np.where(used, np.exp(table["log10_re"]) / np.where(used, unit, 1.0), 1.0)
    natural = _mostly_outside(table, "log10_re", as_log, used, LENGTHS_M) is None
    hint = "it looks like a natural logarithm, give the base-10 one" if natural else "check the columns of rho V L / mu"
    return [f"{found[0]}: implies a reference length of {found[1]:.3g} m; {hint}"]


def profile_problems(table: CsvTable) -> list[str]:
    """A density that does not fall with altitude, or is far from any standard atmosphere of the Earth."""
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
    found = _mostly_outside(table, "rho_kg_m3", rho / standard, inside, STANDARD_RANGE)
    if found is None:
        return []
    units = {1e-3: "g/cm3", 1.0 / 515.379: "slug/ft3", 1.0 / 16.0185: "lb/ft3"}
    close = min(units, key=lambda size: abs(np.log(found[1] / size)))
    near = 0.4 < found[1] / close < 2.5
    hint = f"it looks like {units[close]}, give kg/m3" if near else "check its unit, or give T_inf_K of that atmosphere"
    return [f"{found[0]}: is {found[1]:.3g} of the standard atmosphere's; {hint}"]


def feet_problems(table: CsvTable) -> list[str]:
    """Altitudes in ft: pressure and density are those of the standard atmosphere at 0.3048 of the altitude."""
    z, names = table["altitude_m"], [n for n in ("p_inf_Pa", "rho_kg_m3") if n in table.columns]
    used = (z >= FEET_FROM_M) & (z <= HIGHEST_M) & (FOOT_M * z <= STANDARD_BELOW_M)
    used &= np.all([table[n] > 0.0 for n in names], axis=0)
    if not names or np.count_nonzero(used) < LEAST_ROWS:
        return []
    as_metres, as_feet = (
        dict(zip(("T_inf_K", "p_inf_Pa", "rho_kg_m3"), us76(scale * z[used]), strict=True)) for scale in (1.0, FOOT_M)
    )
    near, far = (
        [float(np.median(np.abs(np.log(table[n][used] / air[n])))) for n in names] for air in (as_feet, as_metres)
    )
    if max(near) > NEAR_STANDARD or min(far) < FAR_FROM_STANDARD + 3.0 * max(near):
        return []
    first, name = int(np.flatnonzero(used)[0]), names[0]
    rule = f"looks like ft: {name} there is {table[name][first]:.4g}, that of the standard atmosphere at"
    write = f"{FOOT_M * z[first]:.0f} m; give m, or name the column `altitude_ft`"
    return [f"{table.problem(first, 'altitude_m', rule)} {write}"]


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
        a, b = ends[steep[0]], ends[steep[0] + 1]
        found = f"altitude changes by {abs(z[b] - z[a]):.4g} m over a path of {path[b] - path[a]:.4g} m"
        return [f"{where}: from {t[a]:g} to {t[b]:g} {found}; the time is not in s"]
    inside = z <= STANDARD_BELOW_M
    if np.count_nonzero(inside) < 3:
        return []
    t, V, rho, z = t[inside], V[inside], table["rho_kg_m3"][inside], z[inside]
    energy = 0.5 * V**2 + G0_M_S2 * z
    lost = energy[0] - energy[-1]
    if lost < LOST_ENERGY * energy[0] or energy[0] < 0.5 * HIGH_SPEED_M_S**2:
        return []
    work = float(np.trapezoid(0.5 * rho * V**3, t))
    ballistic = work / lost
    if BALLISTIC_KG_M2[0] <= ballistic <= BALLISTIC_KG_M2[1]:
        return []
    usual = {1e3: "milliseconds", 1e6: "microseconds", 1.0 / 60.0: "minutes", 1.0 / 3600.0: "hours"}
    close = [u for size, u in usual.items() if 50.0 <= ballistic / size <= 5e3]
    hint = f"the clock of the flight conditions is in {close[0]}, give s" if close else "check time, density and speed"
    return [f"{where}: the flight slows as with {ballistic:.3g} kg/m2 of mass over drag area; {hint}"]


def swapped_problems(table: CsvTable) -> list[str]:
    """Angles of attack and of sideslip in each other's place."""
    if not _has(table, "alpha_deg", "beta_deg"):
        return []
    alpha, beta = np.median(np.abs(table["alpha_deg"])), np.median(np.abs(table["beta_deg"]))
    if beta < 20.0 or alpha > 0.5 * beta:
        return []
    where = f"{display_path(table.path)}, columns alpha_deg and beta_deg"
    return [f"{where}: {beta:g} deg of sideslip at {alpha:g} deg of attack look swapped"]


RELATIONS: tuple[Callable[[CsvTable], list[str]], ...] = (
    feet_problems, speed_problems, gas_problems, mach_problems, reynolds_problems, profile_problems, clock_problems,
    swapped_problems,
)  # fmt: skip
"""Relations between columns, each with the problems of a table whose columns are possible by themselves."""
