"""The discretisation error of a mesh at the sensors, and its removal from the predictions of a fit.

Meshes are of second order: with T_k the temperatures on the mesh whose elements are halved k times,

    T_k + (T_k - T_(k-1)) / 3

is closer to the limit of fine meshes than T_k (Richardson's extrapolation; docs/estimation_statistics.md, equation 31).
A correction T - T_0 that is small is made with k = 1; a larger one is not in the asymptotic range yet, and elements are
halved until the next halving leaves it unchanged. Temperatures at the start that the stack declares are evaluated again
on every mesh: what a coarse one cannot resolve of a profile is part of its error.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import RunError
from sim_heating.march.ensemble import condition_history
from sim_heating.march.linearised import LinearMarch, Track
from sim_heating.thermal.mesh import Mesh, on_mesh, refined

if TYPE_CHECKING:
    from sim_heating.estimation.record_fit import Part

SURE_K = 1.0
"""Size of a correction [K] below which the first one is accurate to some hundredths of a kelvin."""
SETTLED_K = 0.1
"""Change of a correction [K] from one mesh to the next at which it is accepted."""
MOST_HALVINGS = 6


def correct_mesh(part: Part, vector: FloatArray) -> None:
    """Set the correction and the warning of a part, at a parameter vector.

    part   : its correction_K becomes (sensor, sample) [K], 0 where none can be found
    vector : (parameter,) values at which the error is evaluated; its change with the parameters is neglected

    A correction of 1 [K] or more, or one that could not be found, leaves a warning in mesh_told.
    Source: docs/estimation_statistics.md, equation 31.
    """
    mesh = f"{part.record.name}: the mesh of {part.mesh.nodes} nodes"
    finer = "leave `nodes` out of [stack], or ask for more"
    part.correction_K, part.mesh_told = 0.0, ""
    try:
        part.correction_K = mesh_error_K(part, vector)
    except RunError as error:
        part.mesh_told = f"{mesh} could not be corrected, and predictions keep its error ({error}); {finer}"
        return
    worst = float(np.max(np.abs(part.correction_K)))
    if worst >= SURE_K:
        part.mesh_told = (
            f"{mesh} is up to {worst:.1f} K off; predictions are corrected, their sensitivities to the parameters are "
            f"not; {finer}"
        )


def mesh_error_K(part: Part, vector: FloatArray) -> FloatArray:
    """Correction that the limit of fine meshes adds to the march of a part, by Richardson's extrapolation.

        T_k - T_0 + (T_k - T_(k-1)) / 3,   k = 1 where that is below 1 K

    vector  : (parameter,) values
    returns : (sensor, sample) [K]
    raises  : RunError where a refined mesh cannot be marched, or the correction still changes by 0.1 [K] after six
              halvings

    Second order holds for smooth solutions. Source: docs/estimation_statistics.md, equation 31.
    """
    fine, initial = refined(part.mesh), part.refined_K(vector)
    coarse, found = _temperatures_K(part, vector, [(part.mesh, part.initial_K(vector)), (fine, initial)])
    # T_1 - T_0 + (T_1 - T_0) / 3
    error = 4.0 / 3.0 * (found - coarse)
    for _ in range(1, MOST_HALVINGS):
        if np.max(np.abs(error)) < SURE_K:
            return error
        finer = refined(fine)
        initial, fine, last = None if initial is None else on_mesh(initial, fine, finer), finer, found
        (found,) = _temperatures_K(part, vector, [(fine, initial)])
        before, error = error, found - coarse + (found - last) / 3.0
        if np.max(np.abs(error - before)) < SETTLED_K:
            return error
    raise RunError(f"elements halved {MOST_HALVINGS} times still change it by more than {SETTLED_K:g} K")


def _temperatures_K(
    part: Part, vector: FloatArray, meshes: Sequence[tuple[Mesh, FloatArray | None]]
) -> list[FloatArray]:
    """(sensor, sample) temperatures [K] of the march on each mesh, from the initial temperatures [K] paired with it."""
    tracks = [Track(part.altered(vector), mesh, (), part.sample_s, initial_K=initial) for mesh, initial in meshes]
    history = condition_history(part.conditions.at(part.time_s))[np.newaxis]
    found = LinearMarch(tracks, part.time_s, history).march([part.shift_s(vector)] * len(tracks))
    return [f.temperature_K for f in found]
