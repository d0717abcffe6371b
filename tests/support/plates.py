"""A copper plate under a lamp, computed without this program, as the CSV file of a data logger."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from sim_heating.templates.materials import material_library

SIGMA = 5.670374419e-8
FLUX_W_M2, ON_S, OFF_S, ROOM_K = 18e3, 10.0, 130.0, 293.15
PLATE = (
    "--layer", "copper 3 mm", "--depth", "TC 1=back", "--lamp", "18 kW/m2", "--lit", "10,130", "--emissivity", "0.8",
)  # fmt: skip
"""Options of `new record` that declare it."""


def plate_K(
    time_s: np.ndarray, heat_capacity: float = 1.0, emittance: float = 0.8, flux_W_m2: float = FLUX_W_M2
) -> np.ndarray:
    """(time,) temperature of a copper plate of 3 mm under a lamp: thin, so that it has one temperature [K].

    heat_capacity : over that of the library's copper [-];  emittance : [-];  flux_W_m2 : absorbed [W/m2]

    rho c(T) L dT/dt = q - eps sigma (T^4 - T_room^4), integrated without this program
    """
    copper = material_library()["copper"]
    T_table, c_table = np.array(copper.specific_heat_J_kgK).T

    def rate(t: float, T: np.ndarray) -> np.ndarray:
        q = np.interp(t, [ON_S, ON_S + 0.1, OFF_S, OFF_S + 0.1], [0.0, flux_W_m2, flux_W_m2, 0.0])
        stored = copper.density_kg_m3 * heat_capacity * np.interp(T, T_table, c_table) * 3e-3
        return (q - emittance * SIGMA * (T**4 - ROOM_K**4)) / stored

    found = solve_ivp(rate, (0.0, time_s[-1]), [ROOM_K], t_eval=time_s, max_step=1.0, rtol=1e-8, atol=1e-6)
    return found.y[0]


def write_logger_file(path: Path, time_s: np.ndarray, T_K: np.ndarray) -> None:
    """A spreadsheet of a Windows data logger: a line before the names, semicolons, decimal commas, degC in a line."""
    rows = [f"{t:.1f};{T - 273.15:.2f};OK" for t, T in zip(time_s, T_K, strict=True)]
    text = "\r\n".join(["Test 12, copper plate", "Time;TC 1;Status", "s;°C;", *rows]).replace(".", ",")
    path.write_bytes(text.encode("cp1252"))
