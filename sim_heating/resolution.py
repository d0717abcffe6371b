"""How many nodes a stack needs: the same heating pulse on a mesh and on its refinement.

The pulse is an entry in small: the surface is driven towards a radiation equilibrium near its highest use temperature in
300 s, held there with a doublet of 15 % in flux, and left to cool. What halving every element changes, times 4/3 for a
second-order method, estimates the error of the coarser mesh; the coarsest mesh below the tolerance is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sim_heating.ensemble import Ensemble, PointModel
from sim_heating.layout import CONDITION_COLUMNS, P_SURFACE, Q_ADD
from sim_heating.thermal.declare import Construction, pairs
from sim_heating.thermal.kernel import SIGMA
from sim_heating.thermal.mesh import Mesh, build_mesh, fewest_nodes, refined

FloatArray = NDArray[np.float64]

TOLERANCE_K = 0.15
"""Error estimate that the automatic mesh keeps at surface, bondline and sensors [K]."""
LADDER = (14, 16, 20, 24, 28, 32, 40, 48, 64, 80, 100)
"""Node counts tried; few different ones, so that points share lane groups."""
PULSE_TIME_S = np.array([0.0, 300.0, 440.0, 450.0, 460.0, 470.0, 600.0, 900.0, 1200.0])
PULSE_SHAPE = np.array([0.0, 1.0, 1.0, 0.85, 1.15, 1.0, 0.9, 0.1, 0.0])
PULSE_PRESSURE_PA = 1000.0
NOMINAL_SURFACE_K = 1300.0
"""Surface temperature of the pulse where the first layer names no highest temperature of use."""


def pack(models: Sequence[PointModel], step_s: float = 1.0) -> Ensemble:
    """An ensemble of these points on meshes chosen for them; step_s is the longest time step [s] to come."""
    return Ensemble(models, [choose_mesh(m.construction, m.depths_m, m.nodes, step_s) for m in models], step_s)


def choose_mesh(
    construction: Construction, depths_m: tuple[float, ...], nodes: int | None = None, step_s: float = 1.0
) -> Mesh:
    """The mesh of a stack: of so many nodes where that is said, else the coarsest whose error estimate is small."""
    depths = np.array(depths_m, dtype=float)
    if nodes is not None:
        return build_mesh(construction, depths, max(nodes, fewest_nodes(construction, depths)), step_s)
    return _chosen(construction.model_dump_json(), depths_m, step_s)[0]


def mesh_error_K(construction: Construction, depths_m: tuple[float, ...], step_s: float = 1.0) -> tuple[Mesh, float]:
    """The automatic mesh and its error estimate [K] on the pulse."""
    return _chosen(construction.model_dump_json(), depths_m, step_s)


@lru_cache(maxsize=1024)
def _chosen(construction_json: str, depths_m: tuple[float, ...], step_s: float) -> tuple[Mesh, float]:
    construction = Construction.model_validate_json(construction_json)
    depths = np.array(depths_m, dtype=float)
    model = PointModel("mesh", construction, depths_m)
    fewest = fewest_nodes(construction, depths)
    ladder = [n for n in LADDER if n >= fewest] or [fewest]
    for nodes in ladder:
        mesh = build_mesh(construction, depths, nodes, step_s)
        error = _estimate(model, mesh, step_s)
        if error < TOLERANCE_K:
            break
    return mesh, error


def _estimate(model: PointModel, mesh: Mesh, step_s: float) -> float:
    """Largest change of surface, bondline and sensor temperatures when every element is halved, times 4/3 [K]."""
    coarse, fine = (_pulse(model, m, step_s) for m in (mesh, refined(mesh)))
    return float(4.0 / 3.0 * np.max(np.abs(coarse - fine)))


def _pulse(model: PointModel, mesh: Mesh, step_s: float) -> FloatArray:
    outer = model.construction.layer_materials()[0]
    hottest = outer.max_use_K or NOMINAL_SURFACE_K
    emissivity = np.interp(hottest, *pairs(outer.emissivity or [[hottest, 1.0]]))
    step = max(step_s, 1.0)
    time = np.linspace(0.0, PULSE_TIME_S[-1], int(np.ceil(PULSE_TIME_S[-1] / step)) + 1)
    history = np.zeros((1, len(time), len(CONDITION_COLUMNS)))
    history[0, :, Q_ADD] = emissivity * SIGMA * hottest**4 * np.interp(time, PULSE_TIME_S, PULSE_SHAPE)
    history[0, :, P_SURFACE] = PULSE_PRESSURE_PA
    return Ensemble([model], [mesh], step).march(time, history, longest_step_s=step)
