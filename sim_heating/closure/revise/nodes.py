"""Nodes that a table needs to take the form of a fit: planes of its grid, put where the fit bends.

The form of a linear model is that of a table with the nodes it has. An onset, a curvature, or a turbulent ratio bends
within its cells. As long as the nodes leave too much of the ratio, one is added where it leaves least: in each flown
variable places are tried over the flown range, and the best is refined. A node by itself changes no ratio and no
sigma (heating/ratio/uncertainty.py, `on_axes`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize_scalar

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.closure.revise.flown_ratio import FlownRatio

LEAST_EXCURSION = {"alpha_deg": 1.0, "beta_deg": 0.5, "log10_re": 0.05, "elevon_deg": 1.0, "bodyflap_deg": 1.0}
"""Excursion [deg], or [-] for log10_re, below which a variable takes no node."""


def axes_for(
    flown: FlownRatio,
    axes: Sequence[FloatArray],
    *,
    max_misfit: float = 4e-3,
    most_added: int = 6,
    least_gain: float = 0.1,
) -> tuple[FloatArray, ...]:
    """The axes with the nodes that the form of a fit needs, [deg] and [-]; unchanged where it needs none.

    max_misfit : part of the ratio that the nodes may leave where they fit worst [-]: a quarter of it in temperature, 1
        K at 1000 K, about the noise of a thermocouple
    most_added : nodes that one revision adds to a table at most
    least_gain : part by which a further node must reduce the misfit
    """
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


def _with_best_node(
    flown: FlownRatio, axes: tuple[FloatArray, ...], *, most_nodes: int = 20000, values_tried: int = 17
) -> tuple[tuple[FloatArray, ...], float] | None:
    """Axes with one more node, the one that leaves the least misfit, and this misfit; None where there is none.

    most_nodes : nodes of a table that is not enlarged
    values_tried : places that are tried in each variable
    """
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
