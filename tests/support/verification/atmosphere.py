"""US Standard Atmosphere 1976 against its printed tables, and the figures derived from it."""

from __future__ import annotations

import math

from sim_heating.heating.atmosphere import free_stream, gravity, standard_speed_of_sound, sutherland_viscosity, us76
from tests.support.verification.published import published_atmosphere
from tests.support.verification.row import Row, within

US76 = "US Standard Atmosphere 1976, NOAA-S/T 76-1562"
SHOWN_KM = (0, 11, 20, 50, 80, 86, 93.5, 99.5, 105, 127, 143)
"""Those above 86 km lie between the nodes of the package's own table, 105 km aside."""
MOLAR_MASS_120_KM = 26.20
"""Mean molar mass at 120 km [kg/kmol], Table I."""


def states() -> list[Row]:
    """Temperature, pressure, density and speed of sound at altitudes of the printed tables."""
    rows = []
    for row in published_atmosphere():
        z = row["altitude_m"]
        if z / 1000.0 not in SHOWN_KM:
            continue
        T, p, rho = (float(v) for v in us76(z))
        at = f"{z / 1000.0:g} km"
        above = z >= 86e3
        if not math.isnan(row["T_K"]):
            digit = 0.01 if above else 0.001
            source = f"{US76}, Table I"
            rows.append(Row(f"temperature at {at}", row["T_K"], T, digit, "K", source, "last digit printed"))
        for name, printed, got, unit in (
            ("pressure", row["p_Pa"], p, "Pa"),
            ("density", row["rho_kg_m3"], rho, "kg/m3"),
        ):
            fifth = last_digit(printed, 5)
            limit, is_ = (
                (3e-4 * printed, "cubic between nodes of four digits") if above else (fifth, "last digit printed")
            )
            rows.append(Row(f"{name} at {at}", printed, got, limit, unit, f"{US76}, Table I", is_))
        if not math.isnan(row["sound_m_s"]):
            a = float(standard_speed_of_sound(z))
            rows.append(
                Row(
                    f"speed of sound at {at}", row["sound_m_s"], a, 0.006, "m/s", f"{US76}, Table III", "digits printed"
                )
            )
    return rows


def last_digit(value: float, digits: int) -> float:
    """One unit of the last of a number of significant digits."""
    return float(10.0 ** (math.floor(math.log10(value)) + 1 - digits))


def transport() -> list[Row]:
    """Viscosity in the atmosphere and gravity."""
    rows = [
        within(
            3e-5,
            f"viscosity at {z / 1000.0:g} km",
            mu,
            float(sutherland_viscosity(us76(z)[0])),
            "Pa s",
            f"{US76}, Table III",
            "five digits printed",
        )
        for z, mu in ((0.0, 1.7894e-5), (50e3, 1.7037e-5))
    ]
    rows.append(Row("gravity at 80 km", 9.5644, gravity(80e3), 5e-5, "m/s2", f"{US76}, Table II", "digits printed"))
    return rows


def flight() -> list[Row]:
    """Mach number and Reynolds number of a Shuttle entry, and Mach number above the standard's speed of sound."""
    state = free_stream(71158.0, 7081.0, 7.038e-5, 32.77)
    T = 270.65 - 2.8e-3 * (6356766.0 * 71158.0 / (6356766.0 + 71158.0) - 51000.0)
    own = 7.038e-5 * 7081.0 * 32.77 * (T + 110.4) / (1.458e-6 * T**1.5)
    rows = [
        Row(
            "log10 Re of STS-107 at 533 s (71.16 km, 7081 m/s)",
            math.log10(own),
            float(state["log10_re"][0]),
            1e-6,
            "-",
            "rho V L / mu, Sutherland's law, US76 layer equation for T",
            "rounding",
        ),
    ]
    a = math.sqrt(1.4 * 8314.32 / MOLAR_MASS_120_KM * 360.0)
    mach = float(free_stream(120e3, 7486.0, 2.222e-8, 32.77)["mach"][0])
    rows.append(
        within(
            5e-4,
            "Mach number of 7486 m/s at 120 km",
            7486.0 / a,
            mach,
            "-",
            f"gamma 1.4, T 360 K and M 26.20 of {US76}, Table I",
            "four digits of M, p and rho",
        )
    )
    return rows


def rows() -> list[Row]:
    """All of this subject."""
    return [*states(), *transport(), *flight()]
