"""Uncertainty of heating ratios: of a table updated by flight estimates, and of the ratio that an estimate predicts.

A ratio table is a normal prior for its node values n. Estimates y measure linear combinations of them, and the update
is exact:

    prior       n ~ N(n_0, K),  K_ij = sigma_i sigma_j rho(x_i, x_j)
    evidence    y = H n + e,  e ~ N(0, C)
    posterior   n_0 + K H' S^-1 (y - H n_0),  covariance K - K H' S^-1 H K,  S = H K H' + C

Errors of a table are common to neighbouring nodes (one tunnel, one model, one scaling), so rho is a product over the
axes of Wendland's (1 - d/l)^3 (1 + 3 d/l), which is positive definite, smooth, and exactly 0 from the distance l on:
nodes farther than l in any variable from every node that the data weigh keep their values. Several pieces of evidence
are applied together to the table before all of them: their order does not matter, and no step is approximate.
An update takes lengths that are shorter than those over which a table errs in common (UPDATE_REACH and
CORRELATION_LENGTH): a local finding is to change the table where it was flown, and not elsewhere.

An estimate predicts the ratio at any condition, with its standard deviation, as

    r = r_table + sum_k b_k theta_k,    b = r_table for ratio.scale, 1 for ratio.d0, dx_i, dx_i dx_j for derivatives

Equations: docs/theory/equations.md, 9 (prediction) and 15 to 17 (update).
Sources: Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), eqs. 2.23 and 2.24, with linear
functionals for values; Wendland, Adv. Comput. Math. 4 (1995) 389, function phi_1,1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.axis import cells_of
from sim_heating.base.parameters import RATIO, SECOND_ORDER
from sim_heating.heating.ratio.lookup import table_ratios_at
from sim_heating.heating.ratio.table import RatioTable

if TYPE_CHECKING:
    from scipy.sparse import csr_array

CORRELATION_LENGTH = {"alpha_deg": 30.0, "beta_deg": 20.0, "log10_re": 2.0, "elevon_deg": 30.0, "bodyflap_deg": 30.0}
"""Distance l [deg], or [-] for log10_re, at which errors of two nodes are independent:
docs/theory/table_updates_computed.md."""
UPDATE_REACH = {"alpha_deg": 15.0, "beta_deg": 10.0, "log10_re": 0.4, "elevon_deg": 15.0, "bodyflap_deg": 15.0}
"""Distance [deg], or [-] for log10_re, from which on an update leaves a node as it is:
docs/theory/table_updates_computed.md."""

SINGULAR = 1e-8
"""Diagonal [-] of the Cholesky root below which a correlation matrix counts as singular."""


def correlation(variable: str, distance: FloatArray, reach: Mapping[str, float] = CORRELATION_LENGTH) -> FloatArray:
    """Correlation (1 - d)^3 (1 + 3 d) [-] of the errors of two nodes along one variable, d = distance / l < 1; else 0.

    variable : name of the axis
    distance : difference of the two nodes, any shape, in the unit of the axis: [deg], or [-] for log10_re
    reach    : variable -> l, in the unit of its axis
    Source: Wendland 1995, Adv. Comput. Math. 4, 389, phi_1,1; docs/theory/equations.md, equation 15.
    """
    d = np.abs(distance) / reach[variable]
    return np.where(d < 1.0, (1.0 - np.minimum(d, 1.0)) ** 3 * (1.0 + 3.0 * d), 0.0)


def node_weights(axes: Sequence[FloatArray], x: FloatArray) -> csr_array:
    """Weights of the nodes in the multilinear ratio, ratio(x) = W n; outside the axes the edge value.

    axes    : increasing nodes of the five variables, [deg] and [-]
    x       : (sample, 5) conditions in the same units
    returns : (sample, node) sparse weights [-], rows sum to 1, nodes in the order of a table's ravelled ratio
    Source: docs/theory/equations.md, equation 7.
    """
    from scipy.sparse import csr_array

    nodes = np.zeros((len(x), 1), dtype=np.int64)
    weights = np.ones((len(x), 1))
    # Variable by variable, each doubles the corners: 32 in the end, last variable fastest as in the ravelled ratio.
    for axis, values in zip(axes, x.T, strict=True):
        low = cells_of(axis, values)
        high = np.minimum(low + 1, len(axis) - 1)
        width = np.where(high > low, axis[high] - axis[low], 1.0)
        f = np.clip((values - axis[low]) / width, 0.0, 1.0)
        ends = np.stack([low, high], axis=1)
        fractions = np.stack([1.0 - f, f], axis=1)
        shape = (len(x), 2 * nodes.shape[1])  # given, as -1 has no meaning where there is no sample
        nodes = (nodes[:, :, None] * len(axis) + ends[:, None, :]).reshape(shape)
        weights = (weights[:, :, None] * fractions[:, None, :]).reshape(shape)
    rows = np.repeat(np.arange(len(x)), nodes.shape[1])
    size = (len(x), math.prod(len(a) for a in axes))
    matrix = csr_array((weights.ravel(), (rows, nodes.ravel())), shape=size)
    # On a node or beyond an edge most corners have weight 0; left in, they would count as nodes that the data inform.
    matrix.eliminate_zeros()
    return matrix


@dataclass(frozen=True)
class Evidence:
    """One estimate as a measurement of table nodes, y = H n + e with e ~ N(0, C).

    names      : the parameters behind it; of none where it says nothing
    nodes      : (m,) ravelled indices of the nodes with a weight
    H          : (k, m) weights of these nodes in each parameter
    value      : (k,) y, in the units of the parameters
    covariance : (k, k) C of e
    """

    names: tuple[str, ...]
    nodes: IntArray
    H: FloatArray
    value: FloatArray
    covariance: FloatArray


@dataclass(frozen=True)
class Posterior:
    """A ratio table updated by evidence, with the quantities that its uncertainty is computed from.

    prior        : the table before the update
    ratio, sigma : updated ratio and standard deviation [-], on its grid
    innovation   : (k,) y - H n_0, all evidence concatenated
    chi_square   : innovation' S^-1 innovation [-]; about k where the table's sigma and the estimates' bounds are right
    root         : (node, k) A with K - A A' the posterior covariance
    reach        : variable -> distance from which on the errors of two nodes are independent, in K
    Source: docs/theory/equations.md, equations 16 and 17.
    """

    prior: RatioTable
    ratio: FloatArray
    sigma: FloatArray
    innovation: FloatArray
    chi_square: float
    root: FloatArray
    reach: Mapping[str, float] = field(default_factory=lambda: CORRELATION_LENGTH)

    @property
    def p_value(self) -> float:
        """Probability [-] of a chi-square at least as large as this one, if the table's sigma and the bounds are right.

        Upper tail of the chi-square distribution with k degrees of freedom (docs/theory/equations.md, equation 17).
        """
        from scipy.special import chdtrc  # slow to import, as all of scipy

        if len(self.innovation) == 0:
            return math.nan
        return float(chdtrc(len(self.innovation), self.chi_square))

    def covariance(self, first: IntArray, second: IntArray) -> FloatArray:
        """(first, second) posterior covariance [-] of the ratios at two lists of nodes, K - A A'.

        first, second : ravelled indices of nodes
        Source: docs/theory/equations.md, equation 16.
        """
        return prior_covariance(self.prior, first, second, self.reach) - self.root[first] @ self.root[second].T

    def sigma_along(self, weights: csr_array) -> FloatArray:
        """(row,) posterior standard deviation [-] of linear combinations of the nodes, such as the ratio between nodes.

        weights : (row, node) sparse weights W [-], see `node_weights`
        The variance is diag(W (K - A A') W'), and 0 where rounding makes it negative (docs/theory/equations.md,
        equation 16).
        """
        nodes = np.unique(weights.indices)
        W = weights[:, nodes].toarray()
        prior = np.sum((W @ prior_covariance(self.prior, nodes, nodes, self.reach)) * W, axis=1)
        return np.sqrt(np.maximum(prior - np.sum((W @ self.root[nodes]) ** 2, axis=1), 0.0))


def prior_covariance(
    table: RatioTable, first: IntArray, second: IntArray, reach: Mapping[str, float] = CORRELATION_LENGTH
) -> FloatArray:
    """(first, second) prior covariance [-] of the ratios at two lists of nodes, from the sigma column of the table.

    table         : ratio table with a sigma
    first, second : ravelled indices of nodes
    reach         : variable -> distance from which on the errors of two nodes are independent
    K_ij = sigma_i sigma_j times the product of `correlation` over the axes with more than one node.
    Source: docs/theory/equations.md, equation 15.
    """
    shape = table.ratio.shape
    assert table.sigma is not None  # checked by posterior
    sigma = table.sigma.ravel()
    K = np.outer(sigma[first], sigma[second])
    indices = zip(np.unravel_index(first, shape), np.unravel_index(second, shape), strict=True)
    for name, axis, (i, j) in zip(RATIO_VARIABLES, table.axes, indices, strict=True):
        # An axis of one value has no distances, and its correlation is 1.
        if len(axis) > 1:
            K *= correlation(name, axis[:, None] - axis[None, :], reach)[np.ix_(i, j)]
    return K


def posterior(
    table: RatioTable, evidence: Sequence[Evidence], reach: Mapping[str, float] = CORRELATION_LENGTH
) -> Posterior:
    """Ratio table updated by all evidence together; the table itself where there is no evidence.

        n = n_0 + K H' S^-1 (y - H n_0),   S = H K H' + C

    table    : ratio [-] with its sigma [-]
    evidence : estimates; those without a parameter are left out
    reach    : variable -> distance from which on the errors of two nodes are independent
    returns  : updated ratio and sigma [-]; sigma is nowhere larger than before
    raises   : InputError where the table has no sigma, or evidence without uncertainty repeats other such evidence
    Source: Rasmussen and Williams (2006), eqs. 2.23 and 2.24; docs/theory/equations.md, equations 15 to 17.
    """
    from scipy.linalg import solve_triangular

    if table.sigma is None:
        raise InputError("ratio table: has no sigma column, which the flight's uncertainty is weighed against; add one")
    # An estimate of effects alone has no ratio parameter, and so no rows.
    evidence = [e for e in evidence if e.names]
    if not evidence:
        return Posterior(table, table.ratio, table.sigma, np.zeros(0), 0.0, np.zeros((table.ratio.size, 0)), reach)
    nodes = np.unique(np.concatenate([e.nodes for e in evidence]))
    H = np.vstack([_design_rows(e, nodes) for e in evidence])
    value = np.concatenate([e.value for e in evidence])
    G = prior_covariance(table, np.arange(table.ratio.size), nodes, reach) @ H.T
    S = H @ G[nodes]
    first = 0
    for e in evidence:
        rows = slice(first, first + len(e.value))
        S[rows, rows] += e.covariance
        first += len(e.value)
    innovation = value - H @ table.ratio.ravel()[nodes]
    # Scaled to a correlation matrix: parameters have units from 1 to 1/deg^2, and SINGULAR needs one common measure.
    scale = np.sqrt(np.maximum(np.diag(S), np.finfo(float).tiny))
    L = _cholesky_root(S / np.outer(scale, scale))
    root = solve_triangular(L, (G / scale).T, lower=True).T
    whitened = solve_triangular(L, innovation / scale, lower=True)
    ratio = table.ratio + (root @ whitened).reshape(table.ratio.shape)
    variance = table.sigma**2 - np.sum(root**2, axis=1).reshape(table.ratio.shape)
    # Rounding can leave a variance slightly outside; data never make a node less certain.
    sigma = np.sqrt(np.clip(variance, 0.0, table.sigma**2))
    return Posterior(table, ratio, sigma, innovation, float(whitened @ whitened), root, reach)


def on_axes(table: RatioTable, axes: Sequence[FloatArray]) -> RatioTable:
    """A table on other axes: ratio [-] and sigma [-] interpolated, equal to the table where the axes hold its nodes.

    axes : increasing nodes of the five variables, [deg] and [-]
    Nodes that are added to a table by this change no ratio and no sigma between its nodes (docs/theory/equations.md,
    equation 7).
    """
    if all(np.array_equal(a, b) for a, b in zip(axes, table.axes, strict=True)):
        return table
    shape = tuple(len(a) for a in axes)
    grid = np.stack([g.ravel() for g in np.meshgrid(*axes, indexing="ij")], axis=1)
    W = node_weights(table.axes, grid)
    columns = [None if v is None else (W @ v.ravel()).reshape(shape) for v in (table.ratio, table.sigma)]
    assert columns[0] is not None
    return replace(table, axes=tuple(axes), ratio=columns[0], sigma=columns[1])


def _cholesky_root(S: FloatArray) -> FloatArray:
    from scipy.linalg import cholesky

    try:
        L: FloatArray = cholesky(S, lower=True)
    except np.linalg.LinAlgError:
        L = np.zeros_like(S)
    if np.min(np.diag(L)) < SINGULAR:
        raise InputError("ratio table: estimates without uncertainty repeat one another; state their sigma")
    return L


def _design_rows(evidence: Evidence, nodes: IntArray) -> FloatArray:
    H = np.zeros((len(evidence.value), len(nodes)))
    H[:, np.searchsorted(nodes, evidence.nodes)] = evidence.H
    return H


def basis(names: Sequence[str], x: FloatArray, reference: FloatArray, declared: FloatArray) -> FloatArray:
    """Derivative of the heating ratio with respect to each ratio parameter, along a path.

    names     : (k,) names of ratio parameters, such as `ratio.d_alpha`
    x         : (sample, 5) alpha, beta [deg], log10 Re [-], elevon, body flap [deg]
    reference : (5,) condition that the derivatives are about, in the same units
    declared  : (sample,) ratio of the declared table [-], 0 without one
    returns   : (sample, k) r_table, 1, dx_i or dx_i dx_j; [-], [deg] or their products
    raises    : KeyError for a name that is not a ratio parameter
    Source: docs/theory/equations.md, equation 9.
    """
    dx = x - reference
    second = [dx[:, i] * dx[:, j] for i, j in SECOND_ORDER]
    # RATIO lists scale, d0, first and second derivatives in this order; `strict` fails where the lists differ.
    columns = dict(zip((p.name for p in RATIO), (declared, np.ones(len(x)), *dx.T, *second), strict=True))
    return np.stack([columns[name] for name in names], axis=1)


def declared_ratio(table: RatioTable | None, x: FloatArray) -> FloatArray:
    """Heating ratio of a declared table along a path; 0 without a table.

    x       : (sample, 5) alpha, beta [deg], log10 Re [-], elevon, body flap [deg]
    returns : (sample,) ratio [-] (docs/theory/equations.md, equation 7)
    """
    return np.zeros(len(x)) if table is None else table_ratios_at(table, x)


def declared_sigma(table: RatioTable | None, x: FloatArray) -> FloatArray | None:
    """Standard deviation of a declared table along a path; None where the table states none.

    x       : (sample, 5) alpha, beta [deg], log10 Re [-], elevon, body flap [deg]
    returns : (sample,) sigma [-], interpolated like the ratio (docs/theory/equations.md, equation 7), as for errors
              that are fully correlated within a cell
    """
    if table is None or table.sigma is None:
        return None
    return table_ratios_at(replace(table, ratio=table.sigma), x)


def estimated_ratio(
    names: Sequence[str],
    values: FloatArray,
    covariance: FloatArray,
    reference: FloatArray,
    table: RatioTable | None,
    x: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Heating ratio and its standard deviation at given conditions, from estimated ratio parameters.

        r = r_table + b' theta,   sigma^2 = b' P b

    names, values : (k,) parameters theta in the units of their names
    covariance    : (k, k) P of the estimate
    reference     : (5,) condition that the derivatives are about;  table : the declared table or None
    x             : (sample, 5) alpha, beta [deg], log10 Re [-], elevon, body flap [deg]
    returns       : (sample,) ratio [-] and (sample,) sigma [-]; the table's own sigma is not part of it
    Source: docs/theory/equations.md, equation 9.
    """
    declared = declared_ratio(table, x)
    B = basis(names, x, reference, declared)
    # The diagonal of B P B' only: the whole matrix would be (sample, sample).
    variance = np.sum((B @ covariance) * B, axis=1)
    return declared + B @ values, np.sqrt(np.maximum(variance, 0.0))
