"""Walls and flights, from numbers to temperatures of the march, and the walls of the practice records."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_heating.base.conditions import Conditions
from sim_heating.heating import flight_variables
from sim_heating.inputs.record import Record, load_record
from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.history import march_points
from sim_heating.march.mesh_choice import pack
from sim_heating.march.point import PointModel
from sim_heating.thermal.frame import STEP_TOLERANCE_K
from sim_heating.thermal.mesh import Mesh
from sim_heating.thermal.stack import Construction, Layer, Material, Stack
from tests.support.paths import PRACTICE

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


@cache
def practice_record(name: str) -> tuple[Record, dict[str, Any]]:
    """A practice record and what its generator put into it."""
    with open(PRACTICE / name / "truth.toml", "rb") as file:
        return load_record(PRACTICE / name), tomllib.load(file)


def practice_model(name: str, true: bool = True, **changes: Any) -> PointModel:
    """The control point of a practice record, as declared or with the true scale and derivatives."""
    record, truth = practice_record(name)
    enthalpy_of_air = record.declared.heating.wall_enthalpy
    assert not isinstance(enthalpy_of_air, str)
    model = PointModel(
        name,
        record.construction,
        depths_m=tuple(s.depth_m for s in record.sensors),
        ratio=record.ratio_table,
        wall_enthalpy=enthalpy_of_air.cp_J_kgK,
        parameters=truth["parameters"] if true else {},
        reference=tuple(truth["reference_condition"].values()),
    )
    return replace(model, **changes)


def heat_content(ensemble: Ensemble, model: int = 0) -> float:
    """Heat in a wall above 0 K [J/m2], from its declared tables alone: sum of rho dx / 2 int c dT at both ends."""
    mesh, construction = ensemble.meshes[model], ensemble.models[model].construction
    temperature, total = ensemble.node_temperatures(model), 0.0
    for e in np.flatnonzero(mesh.layer >= 0):
        m = construction.layer_materials()[mesh.layer[e]]
        ends = [enthalpy(m, temperature[e + side]) for side in (0, 1)]
        total += 0.5 * m.density_kg_m3 * mesh.length_m[e] * sum(ends)
    return total


def enthalpy(m: Material, temperature_K: float) -> float:
    """int c dT from 0 K [J/kg] of a table that is linear between its points and held beyond them."""
    points = np.array(m.specific_heat_J_kgK)
    T = np.unique(np.concatenate(([0.0, temperature_K], points[points[:, 0] < temperature_K, 0])))
    return float(np.trapezoid(np.interp(T, points[:, 0], points[:, 1]), T))


def orders(errors: ArrayLike) -> FloatArray:
    """Observed orders: log2 of the ratio of successive errors, each of half the step or element before it."""
    e = np.asarray(errors, dtype=float)
    return np.log2(e[:-1] / e[1:])
