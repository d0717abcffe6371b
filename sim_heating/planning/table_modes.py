"""The error of a ratio table as a few independent numbers: what its sigma and correlation mean along a flown path.

A ratio is above 0, and a table's sigma may be most of it: nodes are taken as lognormal, with the ratio as their mean
and the covariance K of table_update/posterior.py, that of the evidence included where the table is a revision:

    n_i = r_i exp(g_i - G_ii / 2),      Cov(g_i, g_j) = G_ij = ln(1 + K_ij / (r_i r_j))

Along a path with weights W the logarithm's error has C = W G W' = V L V'. The modes

    B = G W' V L^(-1/2),        g = B z,  z independent standard normal,

give C along the path exactly, for as many modes as there are; those with the least variance, LOST of the sum in all,
are left out. Off the path the error is its expectation given the error on it: the path has to be a typical one.
"""

from __future__ import annotations

import numpy as np

from sim_heating.conditions import FloatArray
from sim_heating.errors import InputError
from sim_heating.table_update.posterior import node_weights
from sim_heating.table_update.revisions import posterior_of
from sim_heating.vehicle import Vehicle

LOST = 1e-3
"""Share of the variance along the path that may be left out."""
LEAST = -0.9
"""Least relative covariance of two nodes, whose logarithm is taken of 1 more; evidence may make it negative."""


def table_modes(vehicle: Vehicle, point: str, path: FloatArray, factor: float = 1.0) -> FloatArray:
    """(node, mode) errors of the logarithm of a point's table by a unit of each mode; none where it has no sigma.

    path   : (sample, 5) ratio variables of a typical flight
    factor : on the sigma that the table states
    raises : InputError where a ratio is not above 0
    """
    known = posterior_of(vehicle, point)
    mean = vehicle.control_point(point).ratio.ratio.ravel()
    if known is None:
        return np.zeros((mean.size, 0))
    if not np.min(mean) > 0.0:
        raise InputError(
            f"{point}: its ratio table holds {np.min(mean):g}; only ratios above 0 are dispersed, take `tables = 0`"
        )
    W = node_weights(known.prior.axes, path)
    nodes = np.unique(W.indices)
    own = W[:, nodes].toarray()
    K = known.covariance(np.arange(mean.size), nodes)
    G = np.log1p(np.maximum(factor**2 * K / np.outer(mean, mean[nodes]), LEAST))
    along = own @ G[nodes] @ own.T
    variance, vectors = np.linalg.eigh(0.5 * (along + along.T))
    order = np.argsort(variance)[::-1]
    variance, vectors = np.maximum(variance[order], 0.0), vectors[:, order]
    total = float(np.sum(variance))
    if total == 0.0:
        return np.zeros((mean.size, 0))
    count = int(np.searchsorted(np.cumsum(variance), (1.0 - LOST) * total)) + 1
    modes = G @ own.T @ (vectors[:, :count] / np.sqrt(variance[:count]))
    signs = np.where(np.sum(modes, axis=0) < 0.0, -1.0, 1.0)
    return np.asarray(modes * signs)


def table_factors(modes: FloatArray, z: FloatArray) -> FloatArray:
    """(node, flight) factors on a table's ratios for (flight, mode) standard normal numbers; their mean is 1."""
    return np.asarray(np.exp(modes @ z.T - 0.5 * np.sum(modes**2, axis=1)[:, np.newaxis]))
