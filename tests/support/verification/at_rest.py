"""A vehicle at rest on the runway: sky, ground and air as surroundings."""

from __future__ import annotations

from scipy.optimize import brentq

from sim_heating.heating.atmosphere import SEA_LEVEL_K
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.simulation.plugin import HeatingPlugin
from sim_heating.thermal.faces import SIGMA
from tests.support.verification.row import Row

POINTS = ("LOWER_MID", "LEE_UPPER", "V07T9975")
RUNWAY = {
    "altitude_m": 0.0, "velocity_m_s": 0.0, "alpha_deg": 0.0, "beta_deg": 0.0, "elevon_deg": 0.0, "bodyflap_deg": 0.0,
    "rho_kg_m3": 1.225,
}  # fmt: skip


def soaked_K(hours: float, sky_K: float | None = None) -> dict[str, float]:
    """Surface temperatures [K] of the Orbiter after some hours at rest, from 290 K; sky_K: in place of a clear sky."""
    frame = RUNWAY | ({} if sky_K is None else {"T_surroundings_K": sky_K})
    plugin = HeatingPlugin(load_vehicle("orbiter"), POINTS)
    plugin.reset(frame | {"time_s": 0.0})
    for i in range(1, round(360 * hours) + 1):
        plugin.step(frame | {"time_s": 10.0 * i})
    return plugin.surface_K


def clear_sky_balance_K(emittance: float) -> float:
    """Temperature [K] of an adiabatic surface that faces a clear sky in still air of 288.15 K."""
    T = SEA_LEVEL_K

    def gained(wall: float) -> float:
        return 1.31 * (T - wall) ** (4.0 / 3.0) - emittance * (SIGMA * wall**4 - 5.31e-13 * T**6)

    return float(brentq(gained, 200.0, T - 1e-9))


def rows() -> list[Row]:
    """All of this subject."""
    coating = load_vehicle("orbiter").control_points["LEE_UPPER"].construction.layer_materials()[0]
    assert coating.emissivity is not None  # the outermost layer states one
    emittance = float(coating.emissivity[0][1])
    clear, overcast = soaked_K(1.0), soaked_K(1.0, SEA_LEVEL_K)
    settled = soaked_K(8.0)["LEE_UPPER"]
    lower, source = "at rest on the runway for 1 h", "air of the standard atmosphere at sea level"
    is_ = "5 K: what a wall of this capacity keeps of its start at 290 K"
    return [
        Row(f"LOWER_MID {lower}, clear sky", SEA_LEVEL_K, clear["LOWER_MID"], 5.0, "K", source, is_),
        *(Row(f"{n} {lower}, overcast sky", SEA_LEVEL_K, overcast[n], 5.0, "K", source, is_) for n in POINTS),
        Row("LEE_UPPER at rest for 8 h, clear sky", clear_sky_balance_K(emittance), settled, 0.5, "K",
            "balance: Swinbank's sky, McAdams's plate", "heat that the structure still gives off"),
    ]  # fmt: skip
