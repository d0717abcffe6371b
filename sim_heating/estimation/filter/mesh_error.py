"""Error of the meshes of control points, found while they are marched.

Each point is marched beside the filter on its own mesh and on one with every element halved, at fixed parameters and
with nothing measured. The limit of fine meshes is, for an error of second order,

    T(h -> 0) - T_h = 4/3 (T_(h/2) - T_h)

which is what a fit of the whole record corrects (docs/theory/estimation_statistics.md, equation 31).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.point import PointModel
from sim_heating.thermal.mesh import Mesh, halve_elements, interpolate_profile


class MeshError:
    """Error of each point's mesh at the present time of a march.

    models, meshes : (point,) models, and the mesh on which each is filtered
    """

    def __init__(self, models: Sequence[PointModel], meshes: Sequence[Mesh]) -> None:
        self._meshes, self._fine = tuple(meshes), tuple(halve_elements(mesh) for mesh in meshes)
        self._both = Ensemble([*models, *models], [*self._meshes, *self._fine])
        count = len(self._meshes)
        most, same = max(mesh.nodes for mesh in self._meshes), [_same_nodes(mesh) for mesh in self._meshes]
        coarse = [self._both.node_offsets(i) for i in range(count)]
        fine = [self._both.node_offsets(count + i, nodes) for i, nodes in enumerate(same)]
        # (mesh, point, node); points with fewer nodes repeat their last one
        self._at = np.array(
            [[[*offsets, *[offsets[-1]] * (most - len(offsets))] for offsets in both] for both in (coarse, fine)]
        )

    def begin(self, models: Sequence[PointModel], initial_K: Sequence[FloatArray], conditions: FloatArray) -> None:
        """Start a march.

        models     : (point,) with the parameters at which the error is found
        initial_K  : (node,) temperatures of each point [K];  conditions : (point, condition) at the start

        Source: docs/theory/filter.md, section "Mesh".
        """
        count = len(self._meshes)
        self._both.counters.clear()
        for i, (model, mesh, fine) in enumerate(zip(models, self._meshes, self._fine, strict=True)):
            for k, to_mesh in ((i, mesh), (count + i, fine)):
                self._both.set_model(k, model)
                self._both.set_profile(k, interpolate_profile(initial_K[i], mesh, to_mesh))
        self._both.begin(np.concatenate([conditions, conditions]))

    def advance(self, conditions: FloatArray, dt: float) -> None:
        """March by dt [s] to conditions (point, condition) that are linear in between (docs/theory/filter.md)."""
        self._both.advance(np.concatenate([conditions, conditions]), dt)

    def of_nodes(self) -> FloatArray:
        """(point, node) limit of fine meshes less the temperatures of each point's mesh [K]; 0 where a march failed.

        Points with fewer nodes than the largest one repeat their last one. Source:
        docs/theory/estimation_statistics.md, equation 31.
        """
        coarse, fine = self._both.state[self._at]
        error_K = 4.0 / 3.0 * (fine - coarse)
        error_K[~np.isfinite(error_K).all(axis=1)] = 0.0
        return error_K

    @property
    def state(self) -> FloatArray:
        """(number,) temperatures [K] and all else that changes in equation 31; to be copied and written back."""
        return self._both.state


def _same_nodes(mesh: Mesh) -> list[int]:
    """Node of the halved mesh at each node of a mesh."""
    return [0, *np.cumsum(np.where(mesh.layer < 0, 1, 2)).tolist()]
