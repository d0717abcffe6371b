"""Balance at the surface: radiation, films, coated and radiating solids, and jumps of heating as they are run."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from sim_heating.base.conditions import STATE, Conditions
from sim_heating.base.files import check
from sim_heating.inputs.record import Record, RecordFile, make_record
from sim_heating.march.mesh_choice import TOLERANCE_K
from sim_heating.simulation.predict import predict
from sim_heating.thermal.stack import Construction
from tests.support.verification import exact
from tests.support.verification.conduction import CP_J_KGK, RATIO_ONE
from tests.support.verification.gas import CANTERA, cantera_air
from tests.support.verification.gas import equilibrium as gas_equilibrium
from tests.support.verification.row import Row
from tests.support.verification.volterra import surface_temperature
from tests.support.walls import FloatArray, as_run, flight, from_the_first_instant, heat, material, wall

EPS, START_K, THIN_M = 0.85, 300.0, 0.001
LONG_S = np.linspace(0.0, 4000.0, 401)
RCG, TILE = material(1.0, 1100.0, 1666.0, EPS), material(0.06, 1100.0, 144.0, EPS)
RCG_M, TILE_M = 0.00038, 0.08


def equilibrium() -> list[Row]:
    """Temperatures at which a wall emits what it absorbs."""
    w, settled = wall((material(emissivity=EPS), THIN_M)), "settled after 4000 s: rounding"
    rows = []
    for q in (1e4, 1e6):
        _, out = heat(w, flight(LONG_S, q_add_W_m2=q), nodes=14)
        T = exact.radiation_equilibrium(q, EPS)
        rows.append(
            Row(f"radiation equilibrium at {q:g} W/m2", T, out[-1, 0], 1e-6, "K", "(q / eps sigma)^(1/4)", settled)
        )
    w = wall((material(emissivity=EPS), THIN_M), surroundings_K=500.0)
    _, out = heat(w, flight(LONG_S, q_add_W_m2=1e4), nodes=14)
    T, source = exact.radiation_equilibrium(1e4, EPS, 500.0), "eps sigma (T^4 - 500^4) = q"
    rows.append(Row("the same in surroundings of 500 K, 1e4 W/m2", T, out[-1, 0], 1e-6, "K", source, settled))
    film, H_r = 0.01, 1.5e7
    w = wall((material(emissivity=EPS), THIN_M))
    _, out = heat(w, flight(LONG_S, h_ref_kg_m2_s=film, H_r_J_kg=H_r), nodes=14, parameters=RATIO_ONE)
    T = float(brentq(lambda T: film * (H_r - CP_J_KGK * T) - EPS * exact.SIGMA * T**4, 300.0, 3000.0, xtol=1e-10))
    rows.append(
        Row("film and radiation in balance", T, out[-1, 0], 1e-6, "K", "h (H_r - cp T) = eps sigma T^4", settled)
    )
    w = wall((material(emissivity=1e-9), THIN_M))
    _, out = heat(w, flight(LONG_S, h_ref_kg_m2_s=0.1, H_r_J_kg=CP_J_KGK * 1500.0), nodes=14, parameters=RATIO_ONE)
    rows.append(Row("film alone: recovery temperature", 1500.0, out[-1, 0], 1e-5, "K", "H_r / cp", "emittance of 1e-9"))
    return rows


def constant_ratio(ratio: float | None) -> Record:
    """A thin plate in a film, as a flight record: `[heating] ratio`, or none of it. Recovery temperature 600 K."""
    plate = material(emissivity=EPS).model_dump(exclude_none=True)
    declared = {
        "control_point": "plate", "measured": False, "conditions": {"file": "conditions.csv"},
        "thermocouples": {"file": "thermocouples.csv", "sensor": [
            {"name": "T", "column": "T_K", "depth_m": 0.0, "noise_sigma_K": 1.0}]},
        "stack": {"initial_K": START_K, "back": "adiabatic", "layer": [{"material": "plate", "thickness_m": THIN_M}]},
        "materials": {"plate": plate},
        "heating": {"reference": "columns", "wall_enthalpy": {"cp_J_kgK": CP_J_KGK}}
        | ({} if ratio is None else {"ratio": ratio}),
    }  # fmt: skip
    t = np.linspace(0.0, 200.0, 201)
    still = dict.fromkeys((*STATE, "p_surface_Pa"), 0.0) | {
        "altitude_m": 3e4, "velocity_m_s": 1000.0, "mach": 3.31, "log10_re": 6.0, "rho_kg_m3": 0.0184, "T_inf_K": 226.5,
        "p_inf_Pa": 1197.0, "p_surface_Pa": 1197.0, "h_ref_kg_m2_s": 0.02, "H_r_J_kg": CP_J_KGK * 600.0,
    }  # fmt: skip
    flown = Conditions({n: np.full(len(t), v) for n, v in still.items()} | {"time_s": t})
    made = check({"format": "flight-record/1", **declared}, RecordFile, "plate")
    return make_record(made, flown, {"time_s": t, "T_K": np.full(len(t), START_K)})


def declared_ratios() -> list[Row]:
    """A constant heating ratio of a record: rho c L dT/dt = r h_ref cp (T_r - T) - eps sigma T^4 of a thin plate."""
    rows = []
    for ratio in (1.0, 0.5):
        film = ratio * 0.02 * CP_J_KGK

        def rate(_: float, T: FloatArray, film: float = film) -> FloatArray:
            return (film * (600.0 - T) - EPS * exact.SIGMA * T**4) / (1e6 * THIN_M)

        expected = float(solve_ivp(rate, (0.0, 100.0), [START_K], rtol=1e-10, atol=1e-8).y[0, -1])
        got = float(predict(constant_ratio(ratio)).indicated_K[0, 100])
        name, source = (
            f"record with [heating] ratio = {ratio:g}: thin plate after 100 s",
            "heat balance of a thin plate, scipy",
        )
        rows.append(Row(name, expected, got, TOLERANCE_K, "K", source, "tolerance of mesh and steps"))
    return rows


def real_gas() -> list[Row]:
    """Film and radiation in balance where the enthalpy of air at the wall depends on pressure; needs Cantera."""
    if cantera_air() is None:
        return []
    film, T, p = 0.1, 2090.0, 3.0
    H_r = gas_equilibrium(T, p)[0] + EPS * exact.SIGMA * T**4 / film
    w = wall((material(emissivity=EPS), THIN_M))
    held = flight(LONG_S, h_ref_kg_m2_s=film, H_r_J_kg=H_r, p_surface_Pa=p)
    _, out = heat(w, held, nodes=14, parameters=RATIO_ONE, wall_enthalpy="equilibrium-air")
    is_ = "0.05 % of the enthalpy at the wall"
    limit = film * 5e-4 * gas_equilibrium(T, p)[0] / (4.0 * EPS * exact.SIGMA * T**3)
    name = "film and radiation in balance, equilibrium air at the wall, 3 Pa"
    return [Row(name, T, out[-1, 0], limit, "K", CANTERA, is_)]


def lumped() -> list[Row]:
    """Thin plates that radiate: heating by a constant flux, and cooling."""
    rho, c, delta, q = 1666.0, 1200.0, 0.00038, 2e5
    T_r = exact.radiation_equilibrium(q, EPS)
    w = wall((material(1e4, c, rho, EPS), delta), (material(1e-6, 1.0, 1.0), 0.01))
    rows = []
    for share in (0.6, 0.95):
        start = np.array([START_K / T_r])
        at = float(exact.radiating_mass_time(np.array([share]), start[0], rho * c * delta, EPS, T_r)[0])
        _, out = heat(w, flight(from_the_first_instant(at, 800), q_add_W_m2=q), nodes=14)
        source = "rho c d dT/dt = q - eps sigma T^4: atanh and atan"
        is_ = "steps of 1.5 % of the time elapsed; thin layer behind"
        name = f"radiating coating, 2e5 W/m2: after {at:.2f} s"
        rows.append(Row(name, share * T_r, out[-1, 0], 0.02, "K", source, is_))
    delta, t = 0.0005, np.linspace(0.0, 60.0, 1201)
    w = wall((material(1e4, emissivity=EPS), delta), initial_K=1500.0)
    _, out = heat(w, flight(t), nodes=14)
    T = (1500.0**-3 + 3.0 * EPS * exact.SIGMA * 60.0 / (1e6 * delta)) ** (-1.0 / 3.0)
    source, is_ = "1/T^3 = 1/T_0^3 + 3 eps sigma t / (rho c d)", "second order at steps of 0.05 s"
    rows.append(Row("plate cooling from 1500 K by radiation: at 60 s", T, out[-1, 0], 0.05, "K", source, is_))
    return rows


def half_spaces() -> list[Row]:
    """Radiating half spaces, coated and bare, after a jump of flux: resolved, and as the program runs them."""
    e_coat, e_tile = (math.sqrt(k * rho * 1100.0) for k, rho in ((1.0, 1666.0), (0.06, 144.0)))
    a_coat = 1.0 / (1666.0 * 1100.0)

    def coated(t: FloatArray) -> FloatArray:
        # One time after another: the number of terms that matter grows with time.
        return np.concatenate(
            [exact.coated_surface(1.0, e_coat, a_coat, e_tile, RCG_M, at) for at in np.split(t, len(t))]
        )

    def bare(t: FloatArray) -> FloatArray:
        return 2.0 * np.sqrt(t / math.pi) / e_tile

    tile = (TILE, TILE_M)
    return [
        *_after_a_jump("RCG on an insulator", coated, wall((RCG, RCG_M), tile), 1.0e5),
        *_after_a_jump("bare insulator", bare, wall(tile), 5.0e4),
    ]


def _after_a_jump(
    name: str, response: Callable[[FloatArray], FloatArray], construction: Construction, q: float
) -> list[Row]:
    def net(T: float, _: float) -> float:
        return q - EPS * exact.SIGMA * T**4

    rows = []
    source = "integral equation of the half space, own solution"
    for end in (2.0, 20.0, 100.0):
        T = surface_temperature(response, net, START_K, end, 400)
        at = f"{name}, {q:g} W/m2 from 0 s on, radiating: {end:g} s"
        _, out = heat(construction, flight(from_the_first_instant(end), q_add_W_m2=q), nodes=200)
        limit = 2e-4 * (T - START_K)
        rows.append(Row(at, T, out[-1, 0], limit, "K", source, "second-order error of 200 nodes, 2e-4 of the rise"))
        surface = as_run(construction, np.arange(0.0, end + 1.0), q_add_W_m2=q)
        is_ = "tolerance of the choice of the mesh"
        rows.append(Row(f"{at}, mesh and steps as chosen", T, surface[-1], TOLERANCE_K, "K", source, is_))
    return rows


def rows() -> list[Row]:
    """All of this subject."""
    return [row for part in (equilibrium, declared_ratios, real_gas, lumped, half_spaces) for row in part()]
