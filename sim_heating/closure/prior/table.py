"""What a declared ratio table with a sigma says of magnitude and derivatives along a flown path, before any reading.

With errors e of the table, of covariance K, the projection P of flown_path.py gives theta = P e, so that

    theta ~ N(0, T),   T = P K P'

- A table with a `sigma` column has K of its nodes (heating/ratio/uncertainty.py): sigma_i sigma_j times the correlation
  over the axes with more than one node. Against a variable with one node it declares that the ratio does not depend on
  it, and no reading can change what it has no node for: such a derivative is left out.
- A table without sigma states nothing. It is given DEFAULT_SIGMA of its ratio, correlated over the same lengths in all
  five variables, as a weak prior; no derivative is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.parameters import MODEL, Parameter
from sim_heating.closure.prior.flown_path import FlownPath, projection, record_path
from sim_heating.estimation.inference.observability import variables_of
from sim_heating.heating.ratio.table import SMALLEST_SIGMA, RatioTable
from sim_heating.heating.ratio.uncertainty import correlation, node_weights, prior_covariance
from sim_heating.inputs.record import Record

DEFAULT_SIGMA = 0.25
"""Sigma over ratio of a table that states none [-]: about the least of the windward tables of the orbiter, so that a
table of which nothing is known is not trusted more than those of which something is."""


@dataclass(frozen=True, eq=False)
class TablePrior:
    """The normal prior of a table for the parameters of the linear model, mean 0.

    names      : (k,) parameters of the linear model
    covariance : (k, k) T, in the units of the parameters
    stated     : whether the table has a sigma; else T follows from DEFAULT_SIGMA
    """

    names: tuple[str, ...]
    covariance: FloatArray
    stated: bool

    @property
    def sigma(self) -> FloatArray:
        """(k,) standard deviations in the units of the parameters."""
        return np.sqrt(np.diag(self.covariance))

    def parameters(self) -> dict[str, Parameter]:
        """Name -> definition with the standard deviation of the prior; correlations between them are left out."""
        return {n: replace(MODEL[n], sigma=float(s)) for n, s in zip(self.names, self.sigma, strict=True)}


def has_sigma(table: RatioTable) -> bool:
    """Whether a table states the uncertainty of its ratio; a column of zeros states none."""
    return table.sigma is not None and bool(np.any(table.sigma > 0.0))


def undeclared_derivatives(record: Record, names: Sequence[str]) -> dict[str, str]:
    """Derivatives that the declared table has no node for and states no error of, with the reason for leaving them out.

    names   : parameters;  returns : name -> reason, empty for a record without a table or for a table without sigma
    """
    table = record.ratio_table
    if table is None or not has_sigma(table):
        return {}
    nodes = [len(axis) for axis in table.axes]
    return {
        name: f"the declared table has one node in {RATIO_VARIABLES[i]} and declares no dependence on it"
        for name in names
        for i in variables_of(name)
        if nodes[i] == 1
    }


def table_prior(
    record: Record, names: Sequence[str], reference: Sequence[float], *, most_samples: int = 400
) -> TablePrior | None:
    """The prior of a record's table for parameters of the linear model; None where the record has no table.

    names     : estimated parameters, of which those of the linear model with a table count
    reference : (5,) condition that the derivatives are about: alpha, beta [deg], log10 Re, elevon, body flap [deg]
    raises    : InputError where the fitted samples cannot distinguish the parameters
    most_samples : samples of the path that a prior is computed from, evenly chosen; errors of a table are smooth along
        it
    """
    table = record.ratio_table
    named = tuple(n for n in names if n == "ratio.scale" or variables_of(n))
    if table is None or not named:
        return None
    path = record_path(record)
    chosen = np.zeros(len(path.x), dtype=bool)
    chosen[:: -(-len(path.x) // most_samples)] = True
    path = path.subset(chosen)
    P = projection(named, path, np.asarray(reference, dtype=float))
    covariance = _of_stated_sigma(table, path, P) if has_sigma(table) else _of_default_sigma(path, P)
    return TablePrior(named, covariance, has_sigma(table))


def _of_stated_sigma(table: RatioTable, path: FlownPath, P: FloatArray) -> FloatArray:
    """(k, k) T from the errors of the table's nodes."""
    assert table.sigma is not None  # checked by the caller
    W = node_weights(table.axes, path.x)
    nodes = np.unique(W.indices)
    H = P @ W[:, nodes].toarray()
    # No table is better than what its reader accepts, and a prior needs a width.
    least = replace(table, sigma=np.maximum(table.sigma, SMALLEST_SIGMA * np.abs(table.ratio)))
    T: FloatArray = H @ prior_covariance(least, nodes, nodes) @ H.T
    return T


def _of_default_sigma(path: FlownPath, P: FloatArray) -> FloatArray:
    """(k, k) T from errors of DEFAULT_SIGMA of the ratio along the path."""
    sigma = DEFAULT_SIGMA * np.abs(path.declared)
    K = np.outer(sigma, sigma)
    for name, x in zip(RATIO_VARIABLES, path.x.T, strict=True):
        K *= correlation(name, x[:, None] - x[None, :])
    T: FloatArray = P @ K @ P.T
    return T
