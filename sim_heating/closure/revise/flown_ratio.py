"""The ratio of a fit along the flown path as a measurement of the nodes of a table.

Along the path a fit with a linear model gives the ratio as an exact function of the conditions,

    r(x_t) = r_hat(x_t) + sum_k b_k(x_t) (theta_k - theta_hat_k),    theta ~ N(theta_hat, C)

and the table's own ratio there is W n. The table is to be this function over the flown region, so that

    W n = r_hat + B e + s,    e ~ N(0, C),  s_t ~ N(0, tau^2 / w_t),  sum over w_t = 1

B e is the error of the fit, of as many dimensions as it has parameters. s is by how much the function of the table may
differ from the form of the fit: its weighted mean square is tau^2, whatever the number of samples, so that a longer or
a denser record adds no information. tau is a small part of the table's own sigma, so that the table has the form of the
fit where it flew, and above 0, so that nothing is taken to be known exactly.

w_t is the square of dT/dr of a wall near radiation equilibrium, T ~ q^(1/4), at equal ratio: the square root of the
heat flux. The samples of a turbulent boundary layer inform the turbulent table, those of a laminar one the laminar
table, by the square of the part that each has in the heating.

With Q an orthonormal basis of sqrt(w) W and of sqrt(w) B C^(1/2), the rows Q' sqrt(w) contain all of this, and are no
more than nodes and parameters together. Equations: docs/theory/equations.md, 17a and 17b; the update by them is that of
heating/ratio/uncertainty.py.

Nodes that a table needs to take the form of a fit: planes of its grid, put where the fit bends.

The form of a linear model is that of a table with the nodes it has. An onset, a curvature, or a turbulent ratio bends
within its cells. As long as the nodes leave too much of the ratio, one is added where it leaves least: in each flown
variable places are tried over the flown range, and the best is refined. A node by itself changes no ratio and no
sigma (heating/ratio/uncertainty.py, `on_axes`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.ratio.uncertainty import Evidence, node_weights


def _unknown(x: FloatArray) -> FloatArray:
    raise NotImplementedError("evidence from a file is not a function of the conditions")


@dataclass(frozen=True, eq=False)
class FlownRatio:
    """The ratio of a fit along the flown path.

    names       : (k,) parameters of the fit
    x           : (m, 5) alpha, beta [deg], log10 Re [-], elevon, body flap [deg]
    weight      : (m,) w [-]
    ratio       : (m,) r_hat [-]
    basis       : (m, k) derivative of the ratio with respect to each parameter, B
    covariance  : (k, k) C of the parameters
    shape_sigma : tau [-]
    ratio_at    : (n, 5) conditions -> (n,) ratio of the fit [-]; of evidence that was read from a file it is not known
    """

    names: tuple[str, ...]
    x: FloatArray
    weight: FloatArray
    ratio: FloatArray
    basis: FloatArray
    covariance: FloatArray
    shape_sigma: float
    ratio_at: Callable[[FloatArray], FloatArray] = _unknown

    def on(self, axes: Sequence[FloatArray]) -> Evidence:
        """As evidence on the nodes of a table with these axes, [deg] and [-]."""
        nodes, A, r, E = self._weighted(axes)
        Q, _ = np.linalg.qr(np.concatenate([A, E], axis=1))
        noise = Q.T @ E
        covariance = noise @ noise.T + self.shape_sigma**2 * np.eye(Q.shape[1])
        return Evidence(self.names, nodes, Q.T @ A, Q.T @ r, covariance)

    def combinations(self, axes: Sequence[FloatArray]) -> Evidence:
        """Only the combinations of nodes that the parameters are about, for a test of the fit against a table.

        Their number is that of the parameters that can be distinguished along the path.
        """
        nodes, A, r, E = self._weighted(axes)
        U, s, _ = np.linalg.svd(E, full_matrices=False)
        kept = s > 1e-9 * np.max(s, initial=0.0)  # others change nothing along the path
        U, s = U[:, kept], s[kept]
        return Evidence(self.names, nodes, U.T @ A, U.T @ r, np.diag(s**2))

    def misfit(self, axes: Sequence[FloatArray]) -> float:
        """How far the ratio lies from that between nodes of these axes that have it themselves, over the ratio [-].

        Root mean square of the samples that lie farthest, 2 % of all.
        """
        W = node_weights(axes, self.x)
        nodes = np.unique(W.indices)
        indices = np.unravel_index(nodes, [len(a) for a in axes])
        at_nodes = self.ratio_at(np.stack([a[i] for a, i in zip(axes, indices, strict=True)], axis=1))
        off = self.ratio - W[:, nodes] @ at_nodes
        worst = np.sort(off**2)[-max(int(0.02 * len(off)), 1) :]
        return float(np.sqrt(np.mean(worst) / np.average(self.ratio**2, weights=self.weight)))

    def form_covariance(self, names: Sequence[str]) -> FloatArray:
        """(k, k) covariance of parameters as a table with the form of the fit has them, tau^2 (B' w B)^-1.

        names : some of the own ones
        """
        B = self.basis[:, [self.names.index(n) for n in names]]
        return np.asarray(self.shape_sigma**2 * np.linalg.pinv((B.T * self.weight) @ B, hermitian=True))

    def _weighted(self, axes: Sequence[FloatArray]) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
        """Nodes with a weight, and sqrt(w) times W, r_hat and B C^(1/2)."""
        root = np.sqrt(self.weight)
        W = node_weights(axes, self.x)
        nodes = np.unique(W.indices).astype(np.int64)
        values, vectors = np.linalg.eigh(self.covariance)
        half = vectors * np.sqrt(np.maximum(values, 0.0))
        return nodes, root[:, None] * W[:, nodes].toarray(), root * self.ratio, root[:, None] * (self.basis @ half)


def shape_sigma(table: RatioTable, x: FloatArray, weight: FloatArray) -> float:
    """tau [-] of a table along a path: `shape_error` times the root mean square of its sigma.

    x : (m, 5) conditions, [deg] and [-];  weight : (m,) w [-]
    """
    shape_error = 0.003  # tau over the sigma of the table along the path [-]
    assert table.sigma is not None  # checked by the caller
    sigma = node_weights(table.axes, x) @ table.sigma.ravel()
    return shape_error * float(np.sqrt(np.average(sigma**2, weights=weight)))


LEAST_EXCURSION = {"alpha_deg": 1.0, "beta_deg": 0.5, "log10_re": 0.05, "elevon_deg": 1.0, "bodyflap_deg": 1.0}
"""Excursion [deg], or [-] for log10_re, below which a variable takes no node."""


def axes_for(flown: FlownRatio, axes: Sequence[FloatArray]) -> tuple[FloatArray, ...]:
    """The axes with the nodes that the form of a fit needs, [deg] and [-]; unchanged where it needs none."""
    # part of the ratio that the nodes may leave where they fit worst [-]: a quarter of it in temperature, 1 K at 1000
    # K, about the noise of a thermocouple
    max_misfit = 4e-3
    most_added = 6  # nodes that one revision adds to a table at most
    least_gain = 0.1  # part by which a further node must reduce the misfit
    enlarged = tuple(axes)
    misfit = flown.misfit(enlarged)
    for _ in range(most_added):
        if misfit <= max_misfit:
            break
        better = _with_best_node(flown, enlarged)
        if better is None or better[1] > (1.0 - least_gain) * misfit:
            break
        enlarged, misfit = better
    return enlarged


def _with_best_node(flown: FlownRatio, axes: tuple[FloatArray, ...]) -> tuple[tuple[FloatArray, ...], float] | None:
    """Axes with one more node, the one that leaves the least misfit, and this misfit; None where there is none."""
    most_nodes = 20000  # nodes of a table that is not enlarged
    values_tried = 17  # places that are tried in each variable
    tried = []
    for i, name in enumerate(RATIO_VARIABLES):
        low, high = float(flown.x[:, i].min()), float(flown.x[:, i].max())
        size = int(np.prod([len(a) for a in axes])) // len(axes[i]) * (len(axes[i]) + 1)
        if len(axes[i]) == 1 or high - low < LEAST_EXCURSION[name] or size > most_nodes:
            continue
        decimals = 3 if name == "log10_re" else 2
        positions = np.linspace(low, high, values_tried + 2)[1:-1]
        misfits = [flown.misfit(_with_node(axes, i, p)) for p in positions]
        best = int(np.argmin(misfits))
        step = positions[1] - positions[0]
        refined = minimize_scalar(
            lambda p, i=i: flown.misfit(_with_node(axes, i, p)),
            bounds=(positions[best] - step, positions[best] + step),
            method="bounded",
            options={"xatol": 0.5 * 10.0**-decimals},
        )
        position = float(refined.x if refined.fun < misfits[best] else positions[best])
        new = _with_node(axes, i, round(position, decimals))
        tried.append((new, flown.misfit(new)))
    return min(tried, key=lambda f: f[1], default=None)


def _with_node(axes: tuple[FloatArray, ...], i: int, position: float) -> tuple[FloatArray, ...]:
    """Axes with a node at a place of one variable."""
    return (*axes[:i], np.unique(np.append(axes[i], position)), *axes[i + 1 :])


def added_nodes(old: Sequence[FloatArray], new: Sequence[FloatArray]) -> dict[str, list[float]]:
    """Variable -> places of the nodes that new axes have in addition, [deg] and [-]; variables without any left out."""
    pairs = zip(RATIO_VARIABLES, old, new, strict=True)
    return {name: np.setdiff1d(b, a).tolist() for name, a, b in pairs if len(b) > len(a)}
