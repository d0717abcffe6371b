"""Uncertainty of a wall's temperatures after a time in which nothing was measured.

The heating ratio is unknown over such a time. It is taken to differ from the model's by independent factors over
intervals that double in length from the end backwards, because the wall forgets earlier heating more; each factor has a
standard deviation of RATIO_SIGMA of the ratio. What the wall keeps of them is the covariance of its temperatures
(docs/theory/clocks_and_starts.md, equation 6).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels.block import LANES
from sim_heating.march.ensemble import condition_history
from sim_heating.march.linearised import LinearMarch, Track
from sim_heating.march.point import PointModel
from sim_heating.thermal.mesh import Mesh

RATIO_SIGMA = 1.0
"""Standard deviation of an unmeasured heating ratio over that of the model [-]: a turbulent boundary layer heats two to
four times as much as a laminar one."""
SHORTEST_S = 1.0
"""Length of the last interval [s]; each one before it is twice as long."""
TRIED = 0.5
"""Change of the ratio over an interval [-], to either side, for the derivative of the temperatures."""


def after_unknown_heating(
    model: PointModel,
    mesh: Mesh,
    conditions: Conditions,
    time_s: FloatArray,
    initial_K: FloatArray | None,
    end_s: float,
) -> tuple[FloatArray, FloatArray]:
    """Temperatures of a wall after a time of unknown heating, and the directions of their uncertainty.

        T(end) = T + sum_i W_i w_i,   W_i = sigma (T(f_i = 1.5) - T(f_i = 0.5)),   r = f_i r_model over interval i

    conditions : flight conditions;  time_s : (step,) times of the march [s], from the beginning of the unknown heating
    initial_K  : (node,) temperatures then [K]; those that the stack declares where None
    end_s      : time at which measurements begin again [s], not after the last step
    returns    : (node,) temperatures of the model [K]; (node, interval) W [K] for w_i of mean 0 and sigma 1 [-]
    raises     : RunError where the march failed

    Intervals are 1, 2, 4, ... s long from the end backwards. Source: docs/theory/clocks_and_starts.md, equation 6.
    """
    flown = conditions.at(time_s)
    histories = [condition_history(flown)]
    for begin, end in _intervals(float(time_s[0]), end_s):
        inside = (time_s > begin) & (time_s <= end)
        for change in (TRIED, -TRIED):
            film = flown["h_ref_kg_m2_s"] * (1.0 + change * inside)
            histories.append(condition_history(flown.with_columns(h_ref_kg_m2_s=film)))
    T = temperatures_at(model, mesh, histories, time_s, initial_K, end_s)
    return T[0], RATIO_SIGMA / (2.0 * TRIED) * (T[1::2] - T[2::2]).T


def temperatures_at(
    model: PointModel,
    mesh: Mesh,
    histories: Sequence[FloatArray],
    time_s: FloatArray,
    initial_K: FloatArray | None,
    end_s: float,
) -> FloatArray:
    """Temperatures of a wall at the end of several flights.

    histories : of each flight, (time, condition) as condition_history gives them, at the steps time_s [s]
    initial_K : (node,) temperatures at the first step [K]; those that the stack declares where None
    end_s     : time of the temperatures [s], not after the last step
    returns   : (flight, node) [K]
    raises    : RunError where a march failed

    Derived in docs/theory/equations_march.md, equations 4 to 8.
    """
    nodes, temperatures_K = tuple(range(mesh.nodes)), []
    for first in range(0, len(histories), LANES):
        lanes = histories[first : first + LANES]
        tracks = [
            Track(model, mesh, (), np.array([end_s]), nodes, initial_K, flight=flight) for flight in range(len(lanes))
        ]
        temperatures_K += [f.temperature_K[:, 0] for f in LinearMarch(tracks, time_s, np.stack(lanes)).march()]
    return np.array(temperatures_K)


def _intervals(begin_s: float, end_s: float) -> list[tuple[float, float]]:
    """Intervals (begin, end] [s] that double in length from the end backwards; the last reaches beyond the end."""
    edges, length = [np.inf, end_s - SHORTEST_S], SHORTEST_S
    while edges[-1] > begin_s:
        length *= 2.0
        edges.append(edges[-1] - length)
    return list(zip(edges[1:], edges[:-1], strict=True))


def largest_directions(spread_K: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Largest directions of a covariance F F', and what they are of the unknowns of F.

    spread_K : (node, unknown) F [K], unknowns of mean 0 and sigma 1
    count    : how many directions at most
    returns  : (node, direction) singular vectors times singular values [K]; (direction, unknown) rows of V' [-]

    The singular values of F keep small directions that an eigendecomposition of F F' would lose to rounding.
    Source: docs/theory/clocks_and_starts.md, equation 5.
    """
    U, s, V = np.linalg.svd(spread_K, full_matrices=False)
    n = min(count, len(s))
    return U[:, :n] * s[:n], V[:n]
