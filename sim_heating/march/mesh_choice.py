"""Choice of the mesh of a stack: a trial heating pulse marched on a mesh and on its refinement.

The pulse resembles an entry: the surface is driven towards a radiation equilibrium near its highest use temperature
in 300 s, held there with a doublet of 15 % in flux, and left to cool. The change when every element is halved, times
4/3 for a second-order method, estimates the error of the coarser mesh; the coarsest mesh below the tolerance is
taken. Equations: docs/equations_march.md, equations 16 and 17.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.kernels.block import CONDITION_COLUMNS, P_SURFACE, Q_ADD
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.point import PointModel
from sim_heating.thermal.faces import SIGMA
from sim_heating.thermal.frame import STEP_TOLERANCE_K
from sim_heating.thermal.mesh import Mesh, build_mesh, fewest_nodes, halve_elements
from sim_heating.thermal.stack import pairs

TOLERANCE_K = 0.3
"""Error estimate of the automatic mesh at surface, bondline and sensors [K], on a pulse to the highest
temperature of use; a flight that heats less has a smaller error."""
NODE_COUNTS = (14, 16, 20, 24, 28, 32, 40, 48, 64, 80, 100)
"""Node counts tried; few different ones, so that points share lane groups."""
PULSE_TIME_S = np.array([0.0, 300.0, 440.0, 450.0, 460.0, 470.0, 600.0, 900.0, 1200.0])
PULSE_SHAPE = np.array([0.0, 1.0, 1.0, 0.85, 1.15, 1.0, 0.9, 0.1, 0.0])
PULSE_PRESSURE_PA = 1000.0
NOMINAL_SURFACE_K = 1300.0
"""Surface temperature of the pulse where the first layer names no highest temperature of use."""


def pack(models: Sequence[PointModel], step_s: float = 1.0, tolerance_K: float = STEP_TOLERANCE_K) -> Ensemble:
    """Ensemble of control points on meshes chosen for them.

    models : control points;  step_s : longest time step [s] of the marches to come
    tolerance_K : largest error of a time step [K]
    raises : RunError where a trial march on a mesh did not converge

    Error estimates of docs/equations_march.md, equation 16, are below 0.3 K.
    """
    return Ensemble(models, [mesh for mesh, _ in choose_meshes(models, step_s)], step_s, tolerance_K=tolerance_K)


def choose_meshes(models: Sequence[PointModel], step_s: float = 1.0) -> list[tuple[Mesh, float | None]]:
    """Mesh of each control point with its error estimate, eps = 4/3 max |T_h - T_(h/2)| on the trial pulse.

    models  : control points;  step_s : longest time step of the marches to come [s], which also grades the mesh
    returns : (mesh, error [K]) of each point, the first of 14, 16, 20 ... 100 nodes whose estimate is below 0.3 K, else
              the largest; None for the error where the point prescribes its node count

    Surface, bondline and sensors are compared. The estimate is for a pulse to the highest temperature of use: a flight
    that heats more may have a larger error. Results are cached for each stack, sensors, node count and step.
    Derived in docs/equations_march.md, equations 16 and 17.
    """
    new = {key: m for key, m in ((_key(m, step_s), m) for m in models) if key not in _CHOSEN}
    _CHOSEN.update({key: (_prescribed_mesh(m, step_s), None) for key, m in new.items() if m.nodes is not None})
    _CHOSEN.update(_refine_until_accurate({key: m for key, m in new.items() if m.nodes is None}, step_s))
    return [_CHOSEN[_key(m, step_s)] for m in models]


_Key = tuple[str, tuple[float, ...], int | None, float]
_CHOSEN: dict[_Key, tuple[Mesh, float | None]] = {}


def _key(model: PointModel, step_s: float) -> _Key:
    return model.construction.model_dump_json(), model.depths_m, model.nodes, step_s


def _prescribed_mesh(model: PointModel, step_s: float) -> Mesh:
    return mesh_of_nodes(model, model.nodes or 0, step_s)


def mesh_of_nodes(model: PointModel, nodes: int, step_s: float) -> Mesh:
    """Mesh of a control point with a prescribed node count, at least what its interfaces and sensors need.

    model  : the point, its sensor depths in [m];  nodes : prescribed node count
    step_s : longest time step, which sets how fine the mesh is at the surface [s]

    Derived in docs/equations_march.md, section 4.
    """
    depths = np.array(model.depths_m, dtype=float)
    return build_mesh(model.construction, depths, max(nodes, fewest_nodes(model.construction, depths)), step_s)


Key = TypeVar("Key")


def _refine_until_accurate(models: Mapping[Key, PointModel], step_s: float) -> dict[Key, tuple[Mesh, float | None]]:
    """Refine all models together, eight in a lane group, until the error of each is below the tolerance."""
    # Without ratio, parameters and effects: the pulse is a prescribed flux, and the mesh depends on the stack alone.
    bare = {key: PointModel(m.name, m.construction, m.depths_m) for key, m in models.items()}
    fewest = {key: fewest_nodes(m.construction, np.array(m.depths_m)) for key, m in bare.items()}
    done: dict[Key, tuple[Mesh, float | None]] = {}
    for nodes in NODE_COUNTS:
        trying = [key for key in bare if key not in done and (fewest[key] <= nodes or nodes == NODE_COUNTS[-1])]
        if not trying:
            continue
        points = [bare[key] for key in trying]
        meshes = [_prescribed_mesh(replace(point, nodes=nodes), step_s) for point in points]
        errors = _mesh_errors(points, meshes, step_s)
        for key, mesh, error in zip(trying, meshes, errors, strict=True):
            if error < TOLERANCE_K or nodes == NODE_COUNTS[-1]:
                done[key] = (mesh, error)
    return done


def _mesh_errors(points: Sequence[PointModel], meshes: Sequence[Mesh], step_s: float) -> list[float]:
    """Largest change of surface, bondline and sensor temperatures when every element is halved, times 4/3 [K]."""
    coarse = _march_pulse(points, meshes, step_s)
    fine = _march_pulse(points, [halve_elements(mesh) for mesh in meshes], step_s)
    change = np.max(np.abs(coarse - fine), axis=0)
    ends = np.cumsum([2 + len(point.depths_m) for point in points])
    return [float(4.0 / 3.0 * np.max(part)) for part in np.split(change, ends[:-1])]


def _pulse_flux(point: PointModel) -> float:
    """Flux [W/m2] that the surface radiates at its highest temperature of use."""
    outer = point.construction.layer_materials()[0]
    hottest = outer.max_use_K or NOMINAL_SURFACE_K
    return float(np.interp(hottest, *pairs(outer.emissivity or [[hottest, 1.0]])) * SIGMA * hottest**4)


def _march_pulse(points: Sequence[PointModel], meshes: Sequence[Mesh], step_s: float) -> FloatArray:
    # A short step would cost time and change nothing: both meshes are marched in the same steps.
    step = max(step_s, 1.0)
    time = np.linspace(0.0, PULSE_TIME_S[-1], int(np.ceil(PULSE_TIME_S[-1] / step)) + 1)
    history = np.zeros((len(points), len(time), len(CONDITION_COLUMNS)))
    history[:, :, Q_ADD] = np.outer([_pulse_flux(p) for p in points], np.interp(time, PULSE_TIME_S, PULSE_SHAPE))
    history[:, :, P_SURFACE] = PULSE_PRESSURE_PA
    return Ensemble(points, meshes, step).march(time, history, range(len(points)), longest_step_s=step)
