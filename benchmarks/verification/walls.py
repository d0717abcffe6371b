"""Walls and their heating: the shortest way from numbers to temperatures of the march."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_heating.base.conditions import Conditions
from sim_heating.heating import flight_variables
from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.history import march_points
from sim_heating.march.mesh_choice import pack
from sim_heating.march.point import PointModel
from sim_heating.thermal.frame import STEP_TOLERANCE_K
from sim_heating.thermal.mesh import Mesh
from sim_heating.thermal.stack import Construction, Layer, Material, Stack

FloatArray = NDArray[np.float64]
BLACK_TO_NOTHING = 1e-9
"""The least emissivity that a material may declare."""


def material(k: Any = 1.0, c: Any = 1000.0, rho: float = 1000.0, emissivity: float = BLACK_TO_NOTHING) -> Material:
    """A material; k and c are numbers or tables."""
    return Material(
        density_kg_m3=rho,
        emissivity=[[300.0, emissivity]],
        specific_heat_J_kgK=[[300.0, c]] if isinstance(c, float) else c,
        conductivity_W_mK=[[300.0, k]] if isinstance(k, float) else k,
    )


def wall(*layers: tuple[Material, float], contact: float = 0.0, **stack: Any) -> Construction:
    """Layers (material, thickness [m]) from outside inward, a contact resistance below the first one."""
    declared = [
        Layer(material=f"m{i}", thickness_m=thickness, contact_m2K_W=contact if i == 0 else 0.0)
        for i, (_, thickness) in enumerate(layers)
    ]
    whole: dict[str, Any] = {"initial_K": 300.0, "back": "adiabatic"} | stack
    return Construction(stack=Stack(layer=declared, **whole), materials={f"m{i}": m for i, (m, _) in enumerate(layers)})


def flight(time_s: ArrayLike, **columns: ArrayLike) -> FloatArray:
    """(1, time, condition) of contract columns; scalars hold throughout."""
    time = np.asarray(time_s, dtype=float)
    full = {name: np.broadcast_to(np.asarray(v, dtype=float), time.shape) for name, v in columns.items()}
    return condition_history(Conditions({"time_s": time} | full))[np.newaxis]


def heat(
    construction: Construction,
    history: FloatArray,
    depths_m: tuple[float, ...] = (),
    nodes: int | None = 100,
    step_s: float = 1.0,
    tolerance_K: float = STEP_TOLERANCE_K,
    **model: Any,
) -> tuple[Ensemble, FloatArray]:
    """A single wall marched through a flight: the ensemble, and (time, surface | bondline | sensors) [K]."""
    ensemble = pack([PointModel("wall", construction, depths_m, nodes=nodes, **model)], step_s, tolerance_K)
    return ensemble, ensemble.march(history[0, :, flight_variables.time_s], history)


def as_run(construction: Construction, time_s: ArrayLike, **columns: ArrayLike) -> FloatArray:
    """Surface temperature [K] of a wall of ratio 1, with the mesh and the steps that a flight is run with."""
    time = np.asarray(time_s, dtype=float)
    full = {"h_ref_kg_m2_s": 0.0, "H_r_J_kg": 0.0} | columns
    flown = Conditions(
        {"time_s": time} | {n: np.broadcast_to(np.asarray(v, float), time.shape) for n, v in full.items()}
    )
    return march_points([PointModel("wall", construction, parameters={"ratio.d0": 1.0})], [flown])[0].surface_K


def even_mesh(length_m: float, elements: int) -> Mesh:
    """Equal elements of one layer."""
    depth = np.linspace(0.0, length_m, elements + 1)
    return Mesh(np.full(elements, length_m / elements), np.zeros(elements, dtype=np.int64), depth, (), 0)


def from_the_first_instant(end_s: float, steps: int = 400) -> FloatArray:
    """0 and times that grow by a constant factor to the end: a jump in heating is resolved from its start."""
    return np.concatenate(([0.0], np.geomspace(1e-5 * end_s, end_s, steps)))
