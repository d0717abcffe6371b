"""The textbook Kalman filter and smoother on explicit matrices, for walls whose step is linear in their temperatures.

The matrices of a step come from single marches: a wall of constant properties without radiation is moved by each of its
temperatures, and by the heating ratio, in turn. Anderson & Moore, Optimal Filtering (1979), chapters 3 and 7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.kernels import block
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.point import PointModel
from sim_heating.thermal.frame import NOT_CONTROLLED_K
from sim_heating.thermal.mesh import Mesh
from sim_heating.thermal.step import GAMMA

FloatArray = NDArray[np.float64]
MOVED_K = 50.0


@dataclass(frozen=True)
class LinearStep:
    """z' = F z + u and the middle stage F_m z + u_m of z = (temperatures, disturbance of the ratio)."""

    F: FloatArray
    u: FloatArray
    F_m: FloatArray
    u_m: FloatArray

    def row(self, node: int, x: float) -> tuple[FloatArray, float]:
        """T(node) at the fraction x of the step as row z + constant: the parabola through 0, GAMMA and 1."""
        places = np.array([0.0, GAMMA, 1.0])
        weights = [np.prod([(x - b) / (a - b) for b in places if b != a]) for a in places]
        start = np.eye(len(self.F))[node]
        row = weights[0] * start + weights[1] * self.F_m[node] + weights[2] * self.F[node]
        return row, float(weights[1] * self.u_m[node] + weights[2] * self.u[node])


def linear_step(model: PointModel, mesh: Mesh, vectors: FloatArray, dt: float, decay: float) -> LinearStep:
    """Matrices of one step between two condition vectors (2, condition)."""
    n = mesh.nodes

    def stepped(z: FloatArray) -> tuple[FloatArray, FloatArray]:
        moved = model.with_parameters({"ratio.d0": model.value("ratio.d0") + z[n]})
        ensemble = Ensemble([moved], [mesh], tolerance_K=NOT_CONTROLLED_K)
        ensemble.set_profile(0, z[:n])
        ensemble.begin(vectors[:1])
        ensemble.advance(vectors[1:], dt)
        # the middle stage of the step: with its ends it defines the parabola of equations_march.md, equation 4
        end, rows = (
            ensemble.node_temperatures(0),
            block.node_rows(ensemble.memory.block(ensemble.lane_offsets[0].group)),
        )
        middle = rows[:n, block.T_STAGE, ensemble.lane_offsets[0].lane].copy()
        return np.append(end, decay * z[n]), np.append(middle, z[n])

    zero = np.append(np.full(n, 600.0), 0.0)
    steps = np.append(np.full(n, MOVED_K), 1e-2)
    pairs = [
        [np.subtract(*p) / (2 * d) for p in zip(stepped(zero + d * e), stepped(zero - d * e), strict=True)]
        for d, e in zip(steps, np.eye(n + 1), strict=True)
    ]
    F, F_m = (np.column_stack([p[s] for p in pairs]) for s in (0, 1))
    end, middle = stepped(zero)
    return LinearStep(F, end - F @ zero, F_m, middle - F_m @ zero)


@dataclass
class Dense:
    """Means, covariances and log likelihood of the textbook filter, the start first."""

    mean: list[FloatArray]
    covariance: list[FloatArray]
    predicted: list[tuple[FloatArray, FloatArray]]
    log_likelihood: float = 0.0


def dense_filter(
    steps: list[LinearStep], dt: float, z: FloatArray, P: FloatArray, q: FloatArray, q_d: float,
    readings: list[list[tuple[int, float, float, float]]],
) -> Dense:  # fmt: skip
    """Filter; readings of each step are (node, fraction of the step, value, variance), all taken at once.

    q : (node,) white noise [K2/s];  q_d : variance that the disturbance gains in a step
    """
    result = Dense([z], [P], [])
    for step, own in zip(steps, readings, strict=True):
        Q = np.diag(np.append(q * dt, q_d))
        predicted, P_minus = step.F @ z + step.u, step.F @ P @ step.F.T + Q
        z_minus = predicted
        if own:
            rows, constants = zip(*(step.row(node, x) for node, x, _, _ in own), strict=True)
            R, nodes, x = np.array(rows), [o[0] for o in own], np.array([o[1] for o in own])
            shared = np.array([[q[a] * dt * min(x[i], x[j]) if a == b else 0.0 for j, b in enumerate(nodes)]
                               for i, a in enumerate(nodes)])  # fmt: skip
            cross = step.F @ P @ R.T
            cross[nodes, range(len(own))] += q[nodes] * dt * x
            S = R @ P @ R.T + shared + np.diag([o[3] for o in own])
            nu = np.array([o[2] for o in own]) - R @ z - np.array(constants)
            K = np.linalg.solve(S, cross.T).T
            result.log_likelihood -= 0.5 * (nu @ np.linalg.solve(S, nu) + np.linalg.slogdet(2 * np.pi * S)[1])
            z_plus, P_plus = z_minus + K @ nu, P_minus - K @ S @ K.T
        else:
            z_plus, P_plus = z_minus, P_minus
        result.predicted.append((z_minus, P_minus))
        z, P = z_plus, P_plus
        result.mean.append(z)
        result.covariance.append(P)
    return result


def dense_smoother(steps: list[LinearStep], result: Dense) -> tuple[list[FloatArray], list[FloatArray]]:
    """Rauch-Tung-Striebel, for readings at the ends of steps."""
    z, P = result.mean[-1], result.covariance[-1]
    means, covariances = [z], [P]
    for k in range(len(steps) - 1, -1, -1):
        z_minus, P_minus = result.predicted[k]
        J = np.linalg.solve(P_minus, steps[k].F @ result.covariance[k]).T
        z = result.mean[k] + J @ (z - z_minus)
        P = result.covariance[k] + J @ (P - P_minus) @ J.T
        means.insert(0, z)
        covariances.insert(0, P)
    return means, covariances
