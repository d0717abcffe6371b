"""Reference heating: published constants, limits, recovery enthalpy and the flat plate at low speed."""

from __future__ import annotations

import math

import numpy as np

from sim_heating.base.conditions import Conditions
from sim_heating.heating.atmosphere import R_AIR, us76_kernel
from sim_heating.heating.reference import gas
from sim_heating.heating.reference.flat_plate import eckert_film, windward_edge_kernel
from sim_heating.heating.reference.models import reference_heating
from sim_heating.heating.reference.rarefied import free_molecular_film
from sim_heating.heating.reference.recovery import Recovery, recovery_factor
from sim_heating.heating.reference.stagnation import fay_riddell_kernel, stagnation_kernel
from sim_heating.heating.surface_pressure import ModifiedNewtonian, surface_pressure
from tests.support.verification.boundary_layer import plate, stagnation_film, swept_line, van_driest_friction
from tests.support.verification.conduction import CP_J_KGK, RATIO_ONE
from tests.support.verification.gas import cantera_air, shock_by_cantera
from tests.support.verification.row import Row, within
from tests.support.walls import flight, heat, material, wall

FOOT_M, BTU_FT2_S_W_M2 = 0.3048, 11356.5
SIMILARITY = "own similarity solution, Cantera and published transport data"
SPREAD = "spread of published correlations of a cold sphere: 6 %"
FITTED = "stated accuracy of the film coefficient: 1.5 %"
CORRELATED = "stated accuracy of the correlation: 3 %"
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
    return rows


def recovery() -> list[Row]:
    """Recovery enthalpy of a flat surface."""
    rows = []
    T_inf, mach = 222.5, 3.0
    V = mach * math.sqrt(0.4 * CP_J_KGK * T_inf)
    for kind, r in (("laminar", math.sqrt(0.71)), ("turbulent", 0.71 ** (1.0 / 3.0))):
        plate = conditions(rho_kg_m3=0.1, velocity_m_s=V, T_inf_K=T_inf, alpha_deg=0.0)
        h_ref, H_r, _ = reference_heating(f"eckert-{kind}", plate, running_length_m=1.0)
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


def stagnation_layers() -> list[Row]:
    """Fay and Riddell's formula against similarity solutions whose properties vary through the layer."""
    rows = []
    for V, rho, T_inf in ((7081.0, 7.04e-5, 217.0), (4500.0, 3.1e-4, 247.0), (2500.0, 1e-3, 270.0)):
        p_0, h_0, rho_0, p = stagnation_kernel(rho, V, T_inf)
        gradient = math.sqrt(2.0 * (p_0 - p) / rho_0) / FOOT_M
        for T_w, share, is_ in ((300.0, 0.06, SPREAD), (1200.0, 0.03, CORRELATED)):
            expected = stagnation_film(p_0, gas.air_temperature_kernel(h_0, p_0), T_w, gradient, gas.PRANDTL)
            got = fay_riddell_kernel(rho, V, T_inf, FOOT_M, T_w, 1.0)
            name = f"Fay-Riddell, {V:g} m/s, wall {T_w:g} K: film coefficient"
            rows.append(within(share, name, expected, got, "kg/(m2 s)", SIMILARITY, is_))
    return rows


def cylinder() -> list[Row]:
    """Stagnation line of a cylinder across the flow: plane similarity solution, and the ratio of the two constants."""
    state = conditions(rho_kg_m3=1e-3, velocity_m_s=2500.0, T_inf_K=270.0, alpha_deg=0.0)

    def film(model: str, T_w: float) -> float:
        return float(reference_heating(model, state, nose_radius_m=FOOT_M, wall_temperature_K=T_w)[0][0])

    p_0, h_0, rho_0, p = stagnation_kernel(1e-3, 2500.0, 270.0)
    gradient = math.sqrt(2.0 * (p_0 - p) / rho_0) / FOOT_M
    T_0 = gas.air_temperature_kernel(h_0, p_0)
    expected, got = (
        stagnation_film(p_0, T_0, 1200.0, gradient, gas.PRANDTL, plane=True),
        film("swept-cylinder", 1200.0),
    )
    name = "swept-cylinder, 2500 m/s, no sweep, wall 1200 K: film coefficient"
    return [within(0.015, name, expected, got, "kg/(m2 s)", SIMILARITY, FITTED), *insulated_edge()]


def insulated_edge() -> list[Row]:
    """Insulated wall of a swept leading edge at 1000 m/s, 220 K."""
    rows = []
    for sweep in (45.0, 60.0):
        state = conditions(rho_kg_m3=0.1, velocity_m_s=1000.0, T_inf_K=220.0, alpha_deg=0.0)
        h_ref, H_r, _ = reference_heating("swept-cylinder", state, nose_radius_m=0.1, sweep_deg=sweep)
        w, t = wall((material(emissivity=1e-9), 0.001)), np.linspace(0.0, 4000.0, 401)
        _, out = heat(w, flight(t, h_ref_kg_m2_s=h_ref[0], H_r_J_kg=H_r[0]), nodes=14, parameters=RATIO_ONE)
        along = math.sin(math.radians(sweep)) ** 2
        expected = 220.0 + 0.5e6 * (1.0 - along + math.sqrt(0.71) * along) / CP_J_KGK
        name, source = f"insulated leading edge, 1000 m/s, sweep {sweep:g} deg", "T + V^2/2 (cos^2 + Pr^(1/2) sin^2)/cp"
        rows.append(within(5e-3, name, expected, float(out[-1, 0]), "K", source, "recovery factor of 0.855: 0.5 %"))
    return rows


def swept_lines() -> list[Row]:
    """Flux to a cold swept leading edge against similarity solutions with spanwise flow."""
    rows = []
    streams = ((1200.0, 0.05, 222.0), (2500.0, 2e-3, 265.0), (5200.0, 1.5e-4, 230.0), (8000.0, 2.5e-5, 200.0))
    for V, rho, T_inf in streams:
        for sweep in (0.0, 30.0, 60.0):
            w_e = V * math.sin(math.radians(sweep))
            p_0, h_e, rho_0, p = stagnation_kernel(rho, V * math.cos(math.radians(sweep)), T_inf)
            gradient = math.sqrt(2.0 * (p_0 - p) / rho_0) / FOOT_M
            own = swept_line(p_0, gas.air_temperature_kernel(h_e, p_0), w_e, 300.0, gradient, gas.PRANDTL)
            state = conditions(rho_kg_m3=rho, velocity_m_s=V, T_inf_K=T_inf, alpha_deg=0.0)
            h_ref, H_r, _ = reference_heating("swept-cylinder", state, nose_radius_m=FOOT_M, sweep_deg=sweep)
            got = float(h_ref[0] * (H_r[0] - own.h_w))
            name = f"swept-cylinder, {V:g} m/s, sweep {sweep:g} deg: flux to a wall at 300 K"
            rows.append(within(0.015, name, own.flux / 1e3, got / 1e3, "kW/m2", SIMILARITY, FITTED))
    return rows


def plate_layers() -> list[Row]:
    """Eckert's reference enthalpy and recovery factor against similarity solutions with varying properties."""
    rows = []
    for V, rho, T_inf, alpha in ((6300.0, 8e-5, 217.0, 40.0), (2650.0, 8e-4, 265.0, 40.0), (900.0, 0.1, 222.5, 0.0)):
        p_e, h_e, u_e = windward_edge_kernel(rho, V, T_inf, alpha)
        T_e, at = gas.air_temperature_kernel(h_e, p_e), f"laminar plate, {V:g} m/s, {alpha:g} deg"
        for T_w in (300.0, 1100.0):
            own = plate(p_e, T_e, u_e, 10.0, T_w, gas.PRANDTL)
            got = eckert_film(p_e, h_e, u_e, 10.0, T_w, False)
            name = f"{at}, wall {T_w:g} K: film coefficient at 10 m"
            rows.append(within(0.03, name, own.film, got, "kg/(m2 s)", SIMILARITY, CORRELATED))
        factor, is_ = recovery_factor(False), "Pr^(1/2) is exact to 1 %"
        rows.append(within(0.01, f"{at}: recovery factor", own.recovery, factor, "-", SIMILARITY, is_))
    return rows


def turbulent_plate() -> list[Row]:
    """Turbulent reference enthalpy against van Driest's second transformation, through Reynolds' analogy."""
    rows = []
    source, is_ = "van Driest (1956), form of Hopkins & Inouye (1971)", "spread of methods there: 10 %"
    for V, rho, T_inf in ((6300.0, 8e-5, 217.0), (2650.0, 8e-4, 265.0)):
        p_e, h_e, u_e = windward_edge_kernel(rho, V, T_inf, 40.0)
        rho_e, mu_e = gas.air_state_kernel(h_e, p_e)
        mu_w, h_w, re = gas.air_transport_kernel(1100.0, p_e)[1], gas.air_kernel(1100.0, p_e)[0], 1e6
        expected = van_driest_friction(h_e, h_w, u_e, mu_e / mu_w, re, recovery_factor(True))
        got = eckert_film(p_e, h_e, u_e, re * mu_e / (rho_e * u_e), 1100.0, True) / (rho_e * u_e)
        name = f"turbulent plate, {V:g} m/s, 40 deg, wall 1100 K, Re 1e6: C_h Pr^(2/3)"
        rows.append(within(0.1, name, expected, got * gas.PRANDTL ** (2.0 / 3.0), "-", source, is_))
    return rows


def slow_sphere() -> list[Row]:
    """Spheres below the speeds of the correlations: they hand over to Fay and Riddell, with a subsonic limit."""
    rows = []
    for V, rho, T_inf in ((1000.0, 1e-2, 230.0), (100.0, 1.0, 280.0)):
        p_0, h_0, rho_0, p = stagnation_kernel(rho, V, T_inf)
        if V > 400.0:
            gradient = math.sqrt(2.0 * (p_0 - p) / rho_0) / FOOT_M
        else:
            mach = V / math.sqrt(1.4 * gas.R_TABLE * T_inf)
            gradient = 1.5 * V / FOOT_M * (1.0 - 0.252 * mach**2)
        expected = stagnation_film(p_0, gas.air_temperature_kernel(h_0, p_0), 300.0, gradient, gas.PRANDTL)
        state = conditions(rho_kg_m3=rho, velocity_m_s=V, T_inf_K=T_inf)
        got = float(reference_heating("sutton-graves", state, nose_radius_m=FOOT_M)[0][0])
        source = SIMILARITY if V > 400.0 else f"{SIMILARITY}; gradient of potential flow, White (1991)"
        name = f"sutton-graves at {V:g} m/s, 1 ft: film coefficient"
        rows.append(within(0.03, name, expected, got, "kg/(m2 s)", source, CORRELATED))
    return rows


def rarefied() -> list[Row]:
    """Free-molecular and continuum limits of stagnation heating."""
    V, T_inf = 7500.0, 634.0
    state = conditions(rho_kg_m3=2e-11, velocity_m_s=V, T_inf_K=T_inf)
    rows = []
    for model in ("sutton-graves", "fay-riddell"):
        h_ref, H_r, _ = (float(a[0]) for a in reference_heating(model, state, nose_radius_m=FOOT_M))
        name = f"{model}, 1 ft, 7500 m/s, 2e-11 kg/m3: flux to a cold wall"
        source, is_ = "free-molecular flow, accommodation 1: rho V H_0", "bridging: h_fm / 2 h_c, below 1 %"
        rows.append(within(0.01, name, 2e-11 * V * H_r, h_ref * H_r, "W/m2", source, is_))
    thick = conditions(rho_kg_m3=3e-4, velocity_m_s=6000.0, T_inf_K=247.0)
    got = float(reference_heating("fay-riddell", thick, nose_radius_m=FOOT_M)[0][0])
    continuum = fay_riddell_kernel(3e-4, 6000.0, 247.0, FOOT_M, 300.0, 1.0)
    source, is_ = "Fay-Riddell without bridging", "exp(-h_fm / h_c)"
    rows.append(within(1e-6, "fay-riddell with bridging at 60 km, 6000 m/s", continuum, got, "kg/(m2 s)", source, is_))
    return [*rows, *rarefied_surfaces()]


def rarefied_surfaces() -> list[Row]:
    """Thin air at a surface: free-molecular film at any angle, and a film that no reference radius enters."""
    rows = []
    rho, V, T_inf = 2.08e-9, 7500.0, 634.0
    RT = R_AIR * T_inf
    for angle_deg in (-20.0, 0.0, 5.0, 40.0):
        towards, along = V * math.sin(math.radians(angle_deg)), V * math.cos(math.radians(angle_deg))
        reach = 9.0 * math.sqrt(2.0 * RT)
        c = np.linspace(max(0.0, towards - reach), max(towards, 0.0) + reach, 40001)
        maxwellian = np.exp(-((c - towards) ** 2) / (2.0 * RT)) / math.sqrt(2.0 * math.pi * RT)
        carried = 0.5 * (c**2 + along**2 + 2.0 * RT) + RT
        expected = rho * float(np.trapezoid(c * maxwellian * carried, c))
        H_r = 0.5 * V**2 + 1004.5 * T_inf
        got = free_molecular_film(rho, V, T_inf, angle_deg, H_r) * H_r
        name = f"free-molecular flux to a surface at {angle_deg:g} deg, 150 km"
        source = "quadrature over the Maxwellian, rotation R T"
        rows.append(within(2e-4, name, expected, got, "W/m2", source, "quadrature"))
    for altitude_km in (90, 100):
        T_inf, _, rho = us76_kernel(1e3 * altitude_km)
        state = conditions(rho_kg_m3=rho, velocity_m_s=V, T_inf_K=T_inf, alpha_deg=40.0)
        films = [
            r
            * float(
                reference_heating(
                    "fay-riddell", state, nose_radius_m=R, recovery=Recovery("edge-laminar"), ratio=np.full(2, r)
                )[0][0]
            )
            for R, r in ((FOOT_M, 0.1096), (10.0 * FOOT_M, 0.1096 * math.sqrt(10.0)))
        ]
        name = f"film of a tile at 40 deg, {altitude_km} km, ratio over 1 ft for 10 ft"
        rows.append(within(1e-10, name, films[0], films[1], "kg/(m2 s)", "one tile, one heating", "rounding"))
    return rows


def pressure() -> list[Row]:
    """Modified Newtonian surface pressure with the stagnation pressure of an equilibrium shock."""
    rows = []
    for rho, V, T_inf in ((8e-5, 6300.0, 217.0), (8e-4, 2650.0, 265.0)):
        p_inf = rho * gas.R_TABLE * T_inf
        p_0 = shock_by_cantera(rho, V, T_inf)[2]
        expected = p_inf + (p_0 - p_inf) * math.sin(math.radians(40.0)) ** 2
        state = conditions(
            rho_kg_m3=rho, velocity_m_s=V, T_inf_K=T_inf, p_inf_Pa=p_inf, alpha_deg=40.0, beta_deg=0.0,
            elevon_deg=0.0, bodyflap_deg=0.0, mach=20.0, altitude_m=7e4, log10_re=6.0,
        )  # fmt: skip
        got = float(surface_pressure(ModifiedNewtonian(model="modified-newtonian", inclination_deg=0.0), state)[0])
        name = f"surface pressure at {V:g} m/s, 40 deg, modified Newtonian"
        rows.append(within(1e-3, name, expected, got, "Pa", "shock by Cantera, sin^2", "0.1 % of p_0"))
    return rows


def rows() -> list[Row]:
    """All of this subject; without Cantera, what needs no equilibrium of another program."""
    found = [*correlations(), *recovery(), *slow_plate(), *turbulent_plate(), *rarefied()]
    if cantera_air() is not None:
        found += [*stagnation_layers(), *cylinder(), *swept_lines(), *plate_layers(), *slow_sphere(), *pressure()]
    return found
