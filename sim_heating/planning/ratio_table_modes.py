"""Errors of a ratio table as a few independent numbers, and the sensitivity of peak temperatures to them.

Two descriptions of one error, that of the nodes with the covariance K of heating/ratio/uncertainty.py, less what the
revisions of the table have already determined.

Lognormal modes, for tables drawn at random (dispersion). A ratio is above 0, and its sigma may be most of it, so that
nodes are lognormal with the ratio as their mean:

    n_i = r_i exp(g_i - G_ii / 2),      Cov(g_i, g_j) = G_ij = ln(1 + K_ij / (r_i r_j))

Along a path with weights W the error of the logarithm has C = W G W' = V L V'. The modes

    B = G W' V L^(-1/2),        g = B z,  z independent standard normal,

give C along the path exactly if all are kept; those with the least variance, LOST of the sum in all, are left out. Off
the path the error is its expectation given the error on it, so that the path has to be a typical one.

Linear directions, for exact sensitivities (envelope). Node errors are e = L z with z ~ N(0, I) and L L' = K. Along a
flight they appear as W e. With the heat flux q as weight, q W L = U S V'; the first few right singular vectors V_k hold
nearly all of it. The march is linearised in each direction L V_k (march/linearised.py), and a peak temperature, whose
sensitivity is that at its own time, has

    dT/dz = V_k dT/dc,    sigma_T = |dT/dz|

After further evidence y = H e + noise(C) on the same nodes, z has the covariance M^-1, M = I + (H L)' C^-1 H L, and
sigma_T^2 = dT/dz' M^-1 dT/dz. Tables of different control points are treated one by one: errors that they have in
common are not known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES, Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.block import LANES
from sim_heating.closure.revise.revisions import table_posterior
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.ratio.uncertainty import Evidence, node_weights
from sim_heating.inputs.vehicle import Vehicle
from sim_heating.march.ensemble import histories
from sim_heating.march.linearised import LinearMarch, Track
from sim_heating.march.point import PointModel
from sim_heating.thermal.mesh import Mesh

# Lognormal modes -----------------------------------------------------------------------------------------------------

LOST = 1e-3
"""Share of the variance along the path that may be left out."""
LEAST_COVARIANCE = -0.9
"""Least relative covariance K_ij / (r_i r_j) of two nodes; evidence may make it negative; ln(1 + x) needs x > -1."""


def table_modes(vehicle: Vehicle, point: str, path: FloatArray, factor: float = 1.0) -> FloatArray:
    """(node, mode) error of the logarithm of a point's table for a unit of each mode; no mode where it has no sigma.

    path   : (sample, 5) ratio variables of a typical flight
    factor : on the sigma that the table states
    raises : InputError where a ratio is not above 0
    """
    posterior = table_posterior(vehicle, point)
    mean = vehicle.control_point(point).ratio.ratio.ravel()
    if posterior is None:
        return np.zeros((mean.size, 0))
    if not np.min(mean) > 0.0:
        raise InputError(
            f"{point}: its ratio table holds {np.min(mean):g}; only ratios above 0 can be dispersed; set `tables = 0`"
        )
    W = node_weights(posterior.prior.axes, path)
    nodes = np.unique(W.indices)
    weights = W[:, nodes].toarray()
    K = posterior.covariance(np.arange(mean.size), nodes)
    # Lognormal with the mean and covariance of the table: with a sigma of most of the ratio a normal error would make
    # negative ratios.
    G = np.log1p(np.maximum(factor**2 * K / np.outer(mean, mean[nodes]), LEAST_COVARIANCE))
    covariance = weights @ G[nodes] @ weights.T
    variance, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    order = np.argsort(variance)[::-1]
    variance, vectors = np.maximum(variance[order], 0.0), vectors[:, order]
    total = float(np.sum(variance))
    if total == 0.0:
        return np.zeros((mean.size, 0))
    count = int(np.searchsorted(np.cumsum(variance), (1.0 - LOST) * total)) + 1
    modes = G @ weights.T @ (vectors[:, :count] / np.sqrt(variance[:count]))
    # An eigenvector has either sign; a fixed one makes a positive number mean a hotter table.
    signs = np.where(np.sum(modes, axis=0) < 0.0, -1.0, 1.0)
    return np.asarray(modes * signs)


def table_factors(modes: FloatArray, z: FloatArray) -> FloatArray:
    """(node, flight) factors on a table's ratios for (flight, mode) standard normal numbers; their mean is 1."""
    return np.asarray(np.exp(modes @ z.T - 0.5 * np.sum(modes**2, axis=1)[:, np.newaxis]))


# Linear directions ---------------------------------------------------------------------------------------------------

NEGLECTED = 1e-3
"""Share of the variance along a flight, weighted with the heat flux, that the directions may leave out."""
FLIGHT_SAMPLES = 150
"""Approximate number of samples of a flight from which the directions are computed."""


def covariance_root(vehicle: Vehicle, point: str) -> FloatArray | None:
    """(node, node) root L of the covariance of a control point's table; None where the table states no sigma.

    raises : InputError where the table was changed without a revision
    """
    posterior = table_posterior(vehicle, point)
    if posterior is None:
        return None
    nodes = np.arange(posterior.ratio.size)
    values, vectors = np.linalg.eigh(posterior.covariance(nodes, nodes))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def informed_root(root: FloatArray, evidence: Evidence) -> FloatArray:
    """(z, z) B with B B' = M^-1: dT/dz B is the sensitivity that remains after the evidence."""
    rows = evidence.H @ root[evidence.nodes]
    M = np.eye(root.shape[1]) + rows.T @ np.linalg.solve(evidence.covariance, rows)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(M)).T)


def directions(root: FloatArray, table: RatioTable, flown: Conditions) -> FloatArray:
    """(z, k) orthonormal directions V_k of the node errors that a flight depends on."""
    x = np.stack([flown[v] for v in RATIO_VARIABLES], axis=1)
    flux = flown["h_ref_kg_m2_s"] * flown["H_r_J_kg"]
    heated = np.flatnonzero(flux > 0.0)
    heated = heated[:: max(len(heated) // FLIGHT_SAMPLES, 1)]
    seen = node_weights(table.axes, x[heated])
    _, s, Vt = np.linalg.svd(flux[heated, np.newaxis] * (seen @ root), full_matrices=False)
    left_out = 1.0 - np.cumsum(s**2) / np.sum(s**2)
    return np.asarray(Vt[: int(np.argmax(left_out <= NEGLECTED)) + 1].T)


@dataclass(frozen=True, eq=False)
class PeakSensitivity:
    """A peak temperature [K], its time [s], and its slope dT/dz [K], which is empty where the table has no sigma."""

    temperature_K: float
    time_s: float
    slope: FloatArray

    @property
    def sigma_K(self) -> float:
        """Standard deviation of the peak due to the sigma of the table [K]."""
        return float(np.linalg.norm(self.slope))


@dataclass(frozen=True, eq=False)
class PointPeaks:
    """Peak temperatures of one control point along a flight."""

    surface: PeakSensitivity
    bondline: PeakSensitivity


def peak_sensitivities(
    models: Sequence[PointModel],
    meshes: Sequence[Mesh],
    roots: Sequence[FloatArray | None],
    flights: Sequence[Conditions],
) -> list[PointPeaks]:
    """Peak temperatures of control points with their sensitivities to the errors of their tables.

    roots   : of the covariance of each table (`covariance_root`)
    flights : conditions of each point on common times, at which the march stops
    raises  : RunError where a step did not converge
    """
    peaks: list[PointPeaks] = []
    for first in range(0, len(models), LANES):
        lanes = slice(first, first + LANES)
        peaks += _march_linearised(models[lanes], meshes[lanes], roots[lanes], flights[lanes])
    return peaks


def _march_linearised(
    models: Sequence[PointModel],
    meshes: Sequence[Mesh],
    roots: Sequence[FloatArray | None],
    flights: Sequence[Conditions],
) -> list[PointPeaks]:
    time = flights[0].time_s
    bases, tracks = [], []
    for i, (model, mesh, root, flown) in enumerate(zip(models, meshes, roots, flights, strict=True)):
        V = np.zeros((0, 0))
        errors: tuple[FloatArray, ...] = ()
        if root is not None and model.ratio is not None:
            V = directions(root, model.ratio, flown)
            errors = tuple((root @ v).reshape(model.ratio.ratio.shape) for v in V.T)
        bases.append(V)
        tracks.append(Track(model, mesh, (), time, (0, mesh.bondline), flight=i, table_errors=errors))
    out = LinearMarch(tracks, time, histories(flights)).march()
    return [
        PointPeaks(*(_peak(time, r.temperature_K[node], r.sensitivity[node], V) for node in (0, 1)))
        for r, V in zip(out, bases, strict=True)
    ]


def _peak(time_s: FloatArray, temperature_K: FloatArray, sensitivity: FloatArray, V: FloatArray) -> PeakSensitivity:
    i = int(np.argmax(temperature_K))
    return PeakSensitivity(float(temperature_K[i]), float(time_s[i]), V @ sensitivity[i])
