"""Error of time integration after a jump of heating onto bare insulation, with steps divided and undivided."""

from __future__ import annotations

import numpy as np

from benchmarks.measure import Figure, one_thread, save
from benchmarks.ode import system_of
from benchmarks.problems import plug
from benchmarks.work_precision import DEFAULT_STEP_S, REFERENCE_TOLERANCE, by_scipy, marched
from sim_heating.base.kernels.block import CONDITION_COLUMNS, H_REF, P_SURFACE, RECOVERY_ENTHALPY, TIME
from sim_heating.march.mesh_choice import choose_meshes
from sim_heating.march.point import PointModel
from sim_heating.thermal.frame import NOT_CONTROLLED_K, STEP_TOLERANCE_K
from sim_heating.thermal.stack import Construction, Layer, Stack

FILM_KG_M2_S, H_R_J_KG, LONG_S = 0.02, 6e6, 60.0
"""A film that stands over bare insulation from the first instant, for a minute."""


def run() -> list[Figure]:
    """Largest errors at any node and second, against LSODA on the same mesh."""
    with one_thread():
        error_K = _largest_errors_K()
    figures = [
        Figure("error of time integration", error_K[STEP_TOLERANCE_K], "K", 0.1),
        Figure("the same with undivided steps", error_K[NOT_CONTROLLED_K], "K"),
    ]
    save("after_a_jump", figures)
    return figures


def _largest_errors_K() -> dict[float, float]:
    """Largest error [K] by the tolerance [K] that steps are divided to."""
    base = plug()
    tile = base.construction.materials["li900"].model_copy(update={"emissivity": [[300.0, 0.85]]})
    stack = Stack(layer=[Layer(material="li900", thickness_m=0.05)], initial_K=300.0, back="adiabatic")
    construction = Construction(stack=stack, materials={"li900": tile})
    model = PointModel("bare", construction, (0.004,), wall_enthalpy=base.wall_enthalpy, parameters={"ratio.d0": 1.0})
    mesh = choose_meshes([model], DEFAULT_STEP_S)[0][0]
    time_s = np.arange(0.0, LONG_S + 0.5 * DEFAULT_STEP_S, DEFAULT_STEP_S)
    history = np.zeros((1, len(time_s), len(CONDITION_COLUMNS)))
    history[0, :, [TIME]] = time_s
    for column, value in ((H_REF, FILM_KG_M2_S), (RECOVERY_ENTHALPY, H_R_J_KG), (P_SURFACE, 1000.0)):
        history[..., column] = value
    reference = by_scipy(system_of(model, mesh, history), "LSODA", REFERENCE_TOLERANCE, time_s[1:])
    found = {}
    for tolerance in (NOT_CONTROLLED_K, STEP_TOLERANCE_K):
        march, _ = marched(model, mesh, history, DEFAULT_STEP_S, tolerance_K=tolerance)
        found[tolerance] = float(np.max(np.abs(march()[1:] - reference)))
    return found
