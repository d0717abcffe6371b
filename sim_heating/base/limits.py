"""Physical limits of flight conditions, in a file or from a host, with the rule that a message states beyond them.

The limits are wide: they catch values in another unit and damaged samples, not unusual flights.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from sim_heating.base.files import CsvTable

HOTTEST_K = 1e5
"""Upper limit of every temperature [K]."""
FASTEST_M_S = 20_000.0

LIMITS: dict[str, tuple[float, float, str]] = {
    "time_s": (-1e9, 1e9, "is not a time in seconds of a flight"),
    "altitude_m": (-5e3, 2e6, "is not an altitude in m (-5000 to 2e6)"),
    "T_inf_K": (0.0, HOTTEST_K, "is not a temperature of air"),
    "q_add_W_m2": (-1e10, 1e10, "is not a heat flux in W/m2"),
    "velocity_m_s": (0.0, FASTEST_M_S, "is not a speed in m/s (0 to 20000); a larger one looks like ft/s"),
    "mach": (0.0, 1e3, "is not a Mach number (0 to 1000)"),
    "alpha_deg": (-180.0, 180.0, "is not an angle of attack in degrees (-180 to 180)"),
    "beta_deg": (-90.0, 90.0, "is not a sideslip angle in degrees (-90 to 90)"),
    "log10_re": (-10.0, 20.0, "is not the base-10 logarithm of a Reynolds number (-10 to 20)"),
    "elevon_deg": (-90.0, 90.0, "is not a deflection in degrees (-90 to 90)"),
    "bodyflap_deg": (-90.0, 90.0, "is not a deflection in degrees (-90 to 90)"),
    "rho_kg_m3": (1e-300, 100.0, "is not a density of air in kg/m3 (above 0, to 100)"),
    "p_inf_Pa": (0.0, 1e10, "is not a pressure (0 or above)"),
    "p_surface_Pa": (0.0, 1e10, "is not a pressure (0 or above)"),
    "h_ref_kg_m2_s": (0.0, 1e4, "is not a film coefficient (0 or above)"),
    "H_r_J_kg": (0.0, 1e11, "is not a recovery enthalpy (0 or above; enthalpies are zero at 0 K)"),
    "jets": (0.0, 1.0, "is not a share of jets firing (0 to 1)"),
}
"""Column -> lowest value, highest value, and the rule that a message states about a value outside."""

LOW_RULE = "is too low for its speed and looks like km; give m"
HIGH_SPEED_M_S, LOW_M = 3000.0, 1000.0
"""Speed [m/s] above which, and altitude [m] below which, nothing flies at the same time."""


def frame_problem(frame: Mapping[str, float]) -> tuple[str, str] | None:
    """The first column of a frame whose value is impossible, with the rule that it violates, or None."""
    for name, value in frame.items():
        if name in LIMITS and out_of_range(name, value):
            return name, LIMITS[name][2]
    if frame["velocity_m_s"] >= HIGH_SPEED_M_S and abs(frame["altitude_m"]) < LOW_M:
        return "altitude_m", LOW_RULE
    return None


def out_of_range(name: str, value: float) -> bool:
    """Whether a value lies outside the limits of its column."""
    lowest, highest, _ = LIMITS[name]
    return not lowest <= value <= highest


def limit_message(name: str, value: float) -> str:
    """`value rule` for a value outside the limits of its column."""
    return f"{value:g} {LIMITS[name][2] if math.isfinite(value) else 'is not a finite number'}"


def implausible_values(table: CsvTable) -> list[str]:
    """One line for each column of conditions with an impossible value, or in another unit."""
    problems = table.celsius_problems("T_inf_K") if "T_inf_K" in table.columns else []
    for name, (lowest, highest, rule) in LIMITS.items():
        if name in table.columns:
            problems += table.problems_where_not(name, (table[name] >= lowest) & (table[name] <= highest), rule)
    return problems + _energy_problems(table)


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
