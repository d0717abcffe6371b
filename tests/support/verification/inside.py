"""Behind and within a wall: surroundings and back in time, natural convection, venting of an insulation, air layers."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import fsolve

from sim_heating.base.conditions import RATIO_VARIABLES, Conditions
from sim_heating.march.history import march_points
from sim_heating.march.point import PointModel
from sim_heating.thermal.faces import SIGMA
from sim_heating.thermal.stack import BackFace, Construction, Layer, Material, PressureTable, Stack
from tests.support.verification.row import Row
from tests.support.walls import flight, heat, material, wall

START_K = 300.0


def surroundings() -> list[Row]:
    """A wall that nothing heats takes the temperature of what it radiates to."""
    t = np.linspace(0.0, 4000.0, 401)
    w = wall((material(emissivity=0.85), 0.001))
    _, out = heat(w, flight(t, T_surroundings_K=np.where(t < 100.0, 300.0, 500.0)), nodes=14)
    name, source = "wall in surroundings of 500 K from 100 s on: at 4000 s", "no flux at their temperature"
    return [Row(name, 500.0, out[-1, 0], 1e-3, "K", source, "settled: exp(-13)")]


def back_in_time() -> list[Row]:
    """A plate whose back is in air that warms steadily: it lags as a first-order system."""
    h, rate, t, thickness = 50.0, 0.5, np.linspace(0.0, 100.0, 101), 0.001
    w = wall((material(1e4), thickness), back={"h_W_m2K": h, "T_K": START_K})
    _, out = heat(w, flight(t, T_back_K=START_K + rate * t), nodes=14)
    tau = 1e6 * thickness / h
    source, is_ = "r (t - tau (1 - exp(-t/tau))), tau = rho c d / h", "controlled error of the steps"
    expected = {at: START_K + rate * (at - tau * (1.0 - math.exp(-at / tau))) for at in (20, 100)}
    name = "plate with air behind it that warms by 0.5 K/s"
    return [Row(f"{name}: at {at} s", T, out[at, 0], 0.01, "K", source, is_) for at, T in expected.items()]


def natural_convection() -> list[Row]:
    """Steady flux through a plate into air behind it, at sea level and at a tenth of its pressure."""
    C, q = 1.31, 200.0
    rows = []
    for p, at in ((101325.0, "0.1 MPa"), (10132.5, "10 kPa")):
        w = wall((material(1e4), 0.001), back={"T_K": START_K, "natural_h_W_m2K": C, "natural_exponent": 1.0 / 3.0})
        t = np.linspace(0.0, 1e5, 1001)
        _, out = heat(w, flight(t, q_add_W_m2=q, p_surface_Pa=p), nodes=14)
        rise = (q / (C * (p / 101325.0) ** (2.0 / 3.0))) ** 0.75
        source, is_ = "McAdams, vertical plate: q = 1.31 dT^(4/3), Ra ~ p^2", "emittance of 1e-9"
        name = f"natural convection behind a plate, 200 W/m2, {at}"
        rows.append(Row(name, START_K + rise, out[-1, 0], 1e-3, "K", source, is_))
    return rows


def venting() -> list[Row]:
    """Pressure in an insulation behind that of the surface, seen in its conductivity."""
    tau, q, length, h = 20.0, 1e3, 0.001, 100.0
    k = PressureTable(p_Pa=[100.0, 10000.0], T_K=[300.0, 1300.0], k=[[0.01, 0.03], [0.01, 0.03]])
    light = material(c=100.0, rho=10.0).model_copy(update={"conductivity_W_mK": k})
    t = np.linspace(0.0, 60.0, 601)
    p = np.interp(t, [0.0, 1.0], [100.0, 2000.0])
    w = wall((light, length), back={"h_W_m2K": h, "T_K": START_K}, venting_tau_s=tau)
    _, out = heat(w, flight(t, q_add_W_m2=q, p_surface_Pa=p), nodes=14)
    after_ramp = 100.0 + 1900.0 * (1.0 - tau * (1.0 - math.exp(-1.0 / tau)))
    source, is_ = "p' = (p_surface - p) / tau; k linear in log10 p", "heat in the layer: rho c L dT/dt"
    rows = []
    for at in (20.0, 60.0):
        within = 2000.0 - (2000.0 - after_ramp) * math.exp(-(at - 1.0) / tau)
        conductivity = 0.01 + 0.02 * math.log10(within / 100.0) / 2.0
        expected = START_K + q * (1.0 / h + length / conductivity)
        got = float(np.interp(at, t, out[:, 0]))
        name = f"insulation that vents with tau 20 s: surface at {at:g} s"
        rows.append(Row(name, expected, got, 0.02, "K", source, is_))
    return rows


def gas_layer(emissivity_inner: float = 0.8, conductivity_W_mK: float = 20.0) -> Construction:
    """Two plates of 2 mm, 10 mm of air between them; the back convects and radiates to 300 K.

    emissivity_inner  : of the inner face of the air [-]; the outer one is that of the outer plate, 0.8
    conductivity_W_mK : of the plates
    """
    plate = Material(
        density_kg_m3=8000.0,
        emissivity=[[200.0, 0.8]],
        specific_heat_J_kgK=[[200.0, 500.0]],
        conductivity_W_mK=[[200.0, conductivity_W_mK]],
    )
    air = Material(
        kind="gas",
        density_kg_m3=0.4,
        specific_heat_J_kgK=[[200.0, 1000.0], [2000.0, 1200.0]],
        conductivity_W_mK=[[200.0, 0.018], [2000.0, 0.12]],
    )
    layers = [
        Layer(material="plate", thickness_m=0.002),
        Layer(material="air", thickness_m=0.01, emissivity_inner=emissivity_inner),
        Layer(material="plate", name="back plate", thickness_m=0.002),
    ]
    back = BackFace(h_W_m2K=20.0, T_K=START_K, emissivity=0.9)
    return Construction(stack=Stack(initial_K=START_K, back=back, layer=layers), materials={"plate": plate, "air": air})


def gas_layer_K(flux_W_m2: float, conductivity_W_mK: float) -> tuple[float, float]:
    """Temperatures [K] of the outermost and of the innermost face of `gas_layer` in the steady state.

    flux_W_m2 : absorbed at the outer face;  conductivity_W_mK : of the plates

    Three balances solved by scipy; conduction of the air is the integral of its conductivity.
    """

    def conducted(T: float) -> float:
        return 0.018 * (T - 200.0) + 0.5 * (0.12 - 0.018) / 1800.0 * (T - 200.0) ** 2

    def balance(T: np.ndarray) -> list[float]:
        outer, hot, cold, inner = T
        plates = conductivity_W_mK / 0.002
        across = (conducted(hot) - conducted(cold)) / 0.01 + SIGMA * (hot**4 - cold**4) / (2.0 / 0.8 - 1.0)
        lost = 20.0 * (inner - START_K) + 0.9 * SIGMA * (inner**4 - START_K**4)
        taken = flux_W_m2 - 0.8 * SIGMA * outer**4
        return [taken - plates * (outer - hot), plates * (outer - hot) - across, across - plates * (cold - inner),
                plates * (cold - inner) - lost]  # fmt: skip

    outer, _, _, inner = fsolve(balance, [950.0, 945.0, 735.0, 730.0], xtol=1e-12)
    return float(outer), float(inner)


def gas_layers() -> list[Row]:
    """Plates that radiate at each other across still air, under a lamp until nothing changes."""
    rows = []
    for k, name in ((1800.0, "that conduct well"), (20.0, "of steel")):
        t = np.array([0.0, 4e4])
        w = gas_layer(conductivity_W_mK=k)
        _, out = heat(w, flight(t, q_add_W_m2=6e4), (w.stack.thickness_m,), nodes=14)
        for face, expected, got in zip(("outer", "inner"), gas_layer_K(6e4, k), out[-1, [0, 2]], strict=True):
            text = f"10 mm of air between plates {name}, 60 kW/m2: {face} face"
            source = "balances at four faces, scipy; grey parallel plates, emittances 0.8"
            rows.append(Row(text, expected, float(got), 0.01, "K", source, "steady state: digits of the solution"))
    return rows


def back_losses() -> list[Row]:
    """Heat that leaves a wall with a gas layer at its back, once steady: film and radiation at the inner face."""
    t = np.array([0.0, 4e4])
    still = {name: np.zeros(2) for name in (*RATIO_VARIABLES, "h_ref_kg_m2_s", "H_r_J_kg", "mach")}
    flown = Conditions({"time_s": t, "q_add_W_m2": np.full(2, 6e4), "p_surface_Pa": np.full(2, 101325.0)} | still)
    lost = march_points([PointModel("wall", gas_layer())], [flown])[0].heat.back_W_m2[-1]
    inner = gas_layer_K(6e4, 20.0)[1]
    expected = 20.0 * (inner - START_K) + 0.9 * SIGMA * (inner**4 - START_K**4)
    name, source = "heat that leaves at the back of that wall, back_W_m2", "h (T - T_b) + eps sigma (T^4 - T_b^4)"
    return [Row(name, expected, float(lost), 1.0, "W/m2", source, "0.01 K at the inner face: 1 W/m2")]


def rows() -> list[Row]:
    """All of this subject."""
    return [
        row
        for part in (surroundings, back_in_time, natural_convection, venting, gas_layers, back_losses)
        for row in part()
    ]
