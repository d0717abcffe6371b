"""Walls and flights that the thermal tests heat, and those of the practice records."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmarks.verification.walls import BLACK_TO_NOTHING as BLACK_TO_NOTHING
from benchmarks.verification.walls import even_mesh as even_mesh
from benchmarks.verification.walls import flight as flight
from benchmarks.verification.walls import from_the_first_instant as from_the_first_instant
from benchmarks.verification.walls import heat as heat
from benchmarks.verification.walls import material as material
from benchmarks.verification.walls import wall as wall
from sim_heating.inputs.record import Record, load_record
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.point import PointModel
from sim_heating.thermal.stack import Material
from tests.support.paths import PRACTICE

FloatArray = NDArray[np.float64]


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
