"""Reference heating: published constants, limits, recovery enthalpy and the flat plate at low speed."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.verification.conduction import CP_J_KGK, RATIO_ONE
from benchmarks.verification.row import Row, within
from benchmarks.verification.walls import flight, heat, material, wall
from sim_heating.base.conditions import Conditions
from sim_heating.heating.reference import gas
from sim_heating.heating.reference.flat_plate import eckert_film
from sim_heating.heating.reference.models import reference_heating
from sim_heating.heating.reference.stagnation import stagnation_kernel

FOOT_M, BTU_FT2_S_W_M2, SLUG_FT3_KG_M3 = 0.3048, 11356.5, 515.3788
PEAK = {"rho_kg_m3": 7.04e-5, "velocity_m_s": 7081.0, "T_inf_K": 217.2, "alpha_deg": 40.0}
"""STS-107 near its peak heating."""


def conditions(**columns: float) -> Conditions:
    """One state, as a flight of two samples."""
    return Conditions({"time_s": np.arange(2.0)}).with_columns(**columns)


def cold_wall_flux(model: str, **columns: float) -> float:
    """Flux of a reference sphere of one foot at 300 K [W/m2]: film times the enthalpy difference of its definition."""
    h_ref = reference_heating(model, conditions(**columns), nose_radius_m=FOOT_M)[0][0]
    return float(h_ref * (0.5 * columns["velocity_m_s"] ** 2 + 1004.5 * (columns["T_inf_K"] - 300.0)))


def correlations() -> list[Row]:
    """Published constants of the correlations, and their agreement."""
    expected = 17600.0 * BTU_FT2_S_W_M2 / 1e3
    sea_level = {"rho_kg_m3": 1.225, "velocity_m_s": 26000.0 * FOOT_M, "T_inf_K": 300.0}
    got = cold_wall_flux("detra-kemp-riddell", **sea_level) / 1e3
    rows = [
        within(5e-4, "Detra-Kemp-Riddell, 1 ft, 26000 ft/s, sea level", expected, got, "kW/m2",
               "Detra, Kemp & Riddell (1957): 17600 Btu/(ft2 s)", "four digits of 1.1035e8"),
    ]  # fmt: skip
    rho, V, T_inf = PEAK["rho_kg_m3"], PEAK["velocity_m_s"], PEAK["T_inf_K"]
    p_0 = stagnation_kernel(rho, V, T_inf)[0]
    got = cold_wall_flux("sutton-graves", **PEAK) / 1e3
    expected = 0.1113 * math.sqrt(p_0 / 101325.0 / FOOT_M) * (0.5 * V**2 + 1004.5 * (T_inf - 300.0)) / 1e3
    source, is_ = "Sutton & Graves, NASA TR R-376: K 0.1113 kg/(s m^1.5 atm^.5)", "p_0 is 0.97 rho V^2, not 1: 1.5 %"
    rows.append(
        within(0.015, "Sutton-Graves, 1 ft, 7081 m/s: flux by stagnation pressure", expected, got, "kW/m2", source, is_)
    )
    betts = 17700.0 * math.sqrt(rho / SLUG_FT3_KG_M3) * (1e-4 * V / FOOT_M) ** 3.07 * BTU_FT2_S_W_M2 / 1e3
    source, is_ = "Betts (2010), fit of the Shuttle's reference heating", "spread of published correlations: 6 %"
    for model in ("sutton-graves", "fay-riddell", "detra-kemp-riddell"):
        got = cold_wall_flux(model, **PEAK) / 1e3
        if model == "detra-kemp-riddell":
            is_ = "its own spread: 8 %"
        rows.append(
            within(
                0.08 if model[0] == "d" else 0.06, f"{model}, 1 ft, 7081 m/s: flux", betts, got, "kW/m2", source, is_
            )
        )
    return rows


def recovery() -> list[Row]:
    """Recovery enthalpy of a flat surface."""
    rows = []
    T_inf, mach = 222.5, 3.0
    V = mach * math.sqrt(0.4 * CP_J_KGK * T_inf)
    for kind, r in (("laminar", math.sqrt(0.71)), ("turbulent", 0.71 ** (1.0 / 3.0))):
        plate = conditions(rho_kg_m3=0.1, velocity_m_s=V, T_inf_K=T_inf, alpha_deg=0.0)
        h_ref, H_r = reference_heating(f"eckert-{kind}", plate, running_length_m=1.0)
        w, t = wall((material(emissivity=1e-9), 0.001)), np.linspace(0.0, 4000.0, 401)
        _, out = heat(w, flight(t, h_ref_kg_m2_s=h_ref[0], H_r_J_kg=H_r[0]), nodes=14, parameters=RATIO_ONE)
        T_aw = T_inf * (1.0 + r * 0.2 * mach**2)
        source = "T (1 + r (gamma - 1)/2 M^2), r = Pr^(1/2) laminar, Pr^(1/3) turbulent"
        rows.append(
            Row(
                f"adiabatic flat plate at Mach 3, {kind}, total temperature 623 K",
                T_aw,
                out[-1, 0],
                0.05,
                "K",
                source,
                "settled; emittance of 1e-9",
            )
        )
        H_0 = 0.5 * 6300.0**2 + 1004.5 * 217.0
        state = conditions(rho_kg_m3=8e-5, velocity_m_s=6300.0, T_inf_K=217.0, alpha_deg=40.0)
        got = reference_heating(f"eckert-{kind}", state, running_length_m=10.0)[1][0]
        expected = H_0 - (1.0 - r) * 0.5 * (6300.0 * math.cos(math.radians(40.0))) ** 2
        source = "H_0 - (1 - r) u_e^2 / 2, u_e = V cos 40 deg"
        rows.append(
            within(
                1e-9,
                f"recovery enthalpy at 6300 m/s, 40 deg, {kind}",
                expected / 1e6,
                got / 1e6,
                "MJ/kg",
                source,
                "rounding",
            )
        )
    return rows


def slow_plate() -> list[Row]:
    """A slow flat plate as hot as the air: friction through Reynolds' analogy."""
    T, p = 300.0, 1e5
    h, rho, mu = gas.air_kernel(T, p)[0], gas.air_density_kernel(T, p), gas.air_transport_kernel(T, p)[1]
    rows = []
    for name, u, x, turbulent, friction, source in (
        ("laminar", 10.0, 0.5, False, lambda re: 0.332057 / math.sqrt(re), "Blasius: c_f/2 = 0.332057 Re^-1/2"),
        ("turbulent", 40.0, 1.5, True, lambda re: 0.0296 * re**-0.2, "Prandtl: c_f/2 = 0.0296 Re^-1/5"),
        ("turbulent, Re above 2e7", 40.0, 20.0, True, lambda re: 0.185 * math.log10(re) ** -2.584,
         "Schultz-Grunow: c_f/2 = 0.185 (log10 Re)^-2.584"),
    ):  # fmt: skip
        got = eckert_film(p, h, u, x, T, turbulent) / (rho * u) * gas.PRANDTL ** (2.0 / 3.0)
        expected = friction(rho * u * x / mu)
        rows.append(
            within(
                5e-4,
                f"flat plate without dissipation, {name}: C_h Pr^(2/3)",
                expected,
                got,
                "-",
                source,
                "three digits of the constant; 1 K of dissipation",
            )
        )
    return rows


def rows() -> list[Row]:
    """All of this subject."""
    return [*correlations(), *recovery(), *slow_plate()]
