"""Mesh and steps as the program chooses them, samples of 1 s, jumps of heating, low emittance: exact solutions.

The largest error of the surface over all samples from 1 s on is compared with the tolerance that the choice states.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq

from sim_heating.march.mesh_choice import TOLERANCE_K
from sim_heating.thermal.stack import Construction
from tests.support.verification import exact
from tests.support.verification.conduction import CARSLAW, START_K, film
from tests.support.verification.row import Row
from tests.support.walls import FloatArray, as_run, material, wall

T_GAS_K = 1300.0


def film_on_slab(h: float, k: float, a: float, length: float, t: FloatArray, terms: int = 60) -> FloatArray:
    """(T - T_0) / (T_g - T_0) at the heated face of a slab with insulated back under a film.

    1 - sum 4 sin z / (2 z + sin 2 z) cos z exp(-z^2 Fo), z tan z = h L / k. Carslaw & Jaeger (1959), 3.11.
    """
    bi = h * length / k
    z = np.array(
        [
            brentq(lambda z: z * math.sin(z) - bi * math.cos(z), (n + 1e-9) * math.pi, (n + 0.5) * math.pi)
            for n in range(terms)
        ]
    )[:, np.newaxis]
    weight = 4.0 * np.sin(z) / (2.0 * z + np.sin(2.0 * z)) * np.cos(z)
    return 1.0 - np.sum(weight * np.exp(-(z**2) * a * t / length**2), axis=0)


def largest(
    construction: Construction, t: FloatArray, rise: Callable[[FloatArray], FloatArray], **heating: float
) -> float:
    """Largest error of the surface from the second sample on [K]."""
    surface = as_run(construction, t, **heating)
    return float(np.max(np.abs(surface[1:] - START_K - rise(t[1:]))))


def rows() -> list[Row]:
    """All of this subject."""
    t = np.arange(0.0, 201.0)
    alloy, insulator, coat = (
        material(150.0, 960.0, 2770.0),
        material(0.06, 1100.0, 144.0),
        material(1.0, 1100.0, 1666.0),
    )
    steel = material(15.0, 500.0, 8000.0)
    e_coat, e_tile = (math.sqrt(k * rho * 1100.0) for k, rho in ((1.0, 1666.0), (0.06, 144.0)))

    def slab(q: float, k: float, rho_c: float, length: float) -> Callable[[FloatArray], FloatArray]:
        return lambda s: exact.slab_flux(q, k, k / rho_c, length, 0.0, s, 2000)

    def under_film(h: float, k: float, rho_c: float, length: float) -> Callable[[FloatArray], FloatArray]:
        return lambda s: (T_GAS_K - START_K) * film_on_slab(h, k, k / rho_c, length, s)

    def coated(s: FloatArray) -> FloatArray:
        return exact.coated_surface(5e3, e_coat, 1.0 / (1666.0 * 1100.0), e_tile, 0.00038, s)

    def half_space(q: float) -> Callable[[FloatArray], FloatArray]:
        return lambda s: exact.semi_infinite_flux(q, 0.06, 0.06 / (144.0 * 1100.0), 0.0, s)

    cases = (
        (
            "aluminium of 3 mm, lamp of 2e4 W/m2",
            wall((alloy, 0.003)),
            slab(2e4, 150.0, 2770.0 * 960.0, 0.003),
            {"q_add_W_m2": 2e4},
        ),
        ("steel of 20 mm, lamp of 5e4 W/m2", wall((steel, 0.02)), slab(5e4, 15.0, 4e6, 0.02), {"q_add_W_m2": 5e4}),
        (
            "steel of 20 mm, film of 300 W/(m2 K)",
            wall((steel, 0.02)),
            under_film(300.0, 15.0, 4e6, 0.02),
            film(300.0, T_GAS_K),
        ),
        (
            "aluminium of 3 mm, film of 100 W/(m2 K)",
            wall((alloy, 0.003)),
            under_film(100.0, 150.0, 2770.0 * 960.0, 0.003),
            film(100.0, T_GAS_K),
        ),
        ("insulator of 80 mm, lamp of 3e3 W/m2", wall((insulator, 0.08)), half_space(3e3), {"q_add_W_m2": 3e3}),
        ("coated insulator, lamp of 5e3 W/m2", wall((coat, 0.00038), (insulator, 0.08)), coated, {"q_add_W_m2": 5e3}),
    )
    return [
        Row(
            f"{name}, from 0 s on, nothing emitted: largest error in 200 s",
            0.0,
            largest(w, t, rise, **heating),
            TOLERANCE_K,
            "K",
            f"series of {CARSLAW}",
            "tolerance of the choice of mesh",
        )
        for name, w, rise, heating in cases
    ]
