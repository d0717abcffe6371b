"""The error of a ratio table as a few independent numbers: what its sigma and correlation mean along a flown path.

Node errors have the covariance K of table_update/posterior.py, that of the evidence included where the table is a
revision. Along a path with weights W the ratio's error has C = W K W' = V L V'. The modes

    B = K W' V L^(-1/2),        node errors = B z,  z independent standard normal,

give C along the path exactly, for as many modes as there are; those with the least variance, LOST of the sum in all,
are left out. Off the path the error is its expectation given the error on it: the path has to be a typical one.
"""

from __future__ import annotations

import numpy as np

from sim_heating.conditions import FloatArray
from sim_heating.heating_ratio.table import RatioTable
from sim_heating.table_update.posterior import node_weights, posterior, prior_covariance
from sim_heating.table_update.revisions import FOLDER, read_history
from sim_heating.vehicle import Vehicle

LOST = 1e-3
"""Share of the variance along the path that may be left out."""


def table_modes(vehicle: Vehicle, point: str, path: FloatArray) -> FloatArray:
    """(node, mode) node errors of a point's table per unit of each mode; no mode where the table has no sigma.

    path : (sample, 5) ratio variables of a typical flight
    """
    table, root = _prior(vehicle, point)
    if table.sigma is None:
        return np.zeros((table.ratio.size, 0))
    W = node_weights(table.axes, path)
    nodes = np.unique(W.indices)
    own = W[:, nodes].toarray()
    K = prior_covariance(table, np.arange(table.ratio.size), nodes) - root @ root[nodes].T
    along = own @ K[nodes] @ own.T
    variance, vectors = np.linalg.eigh(0.5 * (along + along.T))
    order = np.argsort(variance)[::-1]
    variance, vectors = np.maximum(variance[order], 0.0), vectors[:, order]
    total = float(np.sum(variance))
    if total == 0.0:
        return np.zeros((table.ratio.size, 0))
    count = int(np.searchsorted(np.cumsum(variance), (1.0 - LOST) * total)) + 1
    modes = K @ own.T @ (vectors[:, :count] / np.sqrt(variance[:count]))
    signs = np.where(np.sum(modes, axis=0) < 0.0, -1.0, 1.0)
    return np.asarray(modes * signs)


def _prior(vehicle: Vehicle, point: str) -> tuple[RatioTable, FloatArray]:
    """The table whose sigma column counts, and the root of what evidence has taken from its covariance since."""
    table = vehicle.control_point(point).ratio
    if (vehicle.directory / FOLDER / point).is_dir():
        history = read_history(vehicle, point)
        if history.revisions:
            return history.base, posterior(history.base, [r.evidence.arrays() for r in history.revisions]).root
    return table, np.zeros((table.ratio.size, 0))


