"""Numbers and schedules of one flight in one flat float64 block, for compiled steps and exported models.

A block holds `scalars`, then for each schedule where its points start and how many they are, then the points:

    [ scalars..., (start, points) of each schedule..., x..., value..., x..., value..., ... ]

One block belongs to one flight; ten thousand dispersed flights are ten thousand blocks and one compiled step.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.kernels.jit import njit


def pack(scalars: Sequence[float], schedules: Sequence[Sequence[tuple[float, float]]]) -> FloatArray:
    """Block of scalars and schedules [(x, value), ...] with x rising, [-] or [m/s] or [m]; an empty schedule is 0
    everywhere."""
    tables = [np.array(s, dtype=float).reshape(-1, 2) for s in schedules]
    start = len(scalars) + 2 * len(tables)
    parts: list[float] = list(scalars)
    for table in tables:
        parts += [start, len(table)]
        start += table.size
    return np.concatenate([np.array(parts, dtype=float), *(t.T.ravel() for t in tables)])


def schedule_positions(first: int, schedules: int) -> Sequence[int]:
    """Positions of (start, points) of a block's schedules, the first at `first`.

    They are numpy integers because numba would compile `scheduled` again for each value of a Python integer.
    """
    return list(np.arange(first, first + 2 * schedules, 2))


@njit
def scheduled(block: FloatArray, entry: int, x: float) -> float:
    """Value at x of the schedule whose (start, points) are at `entry`, in its unit ([deg], [m/s2], [Pa] ...);
    constant beyond its ends."""
    start, points = int(block[entry]), int(block[entry + 1])
    if points == 0:
        return 0.0
    if x <= block[start]:
        return block[start + points]
    for i in range(start + 1, start + points):
        if x < block[i]:
            fraction = (x - block[i - 1]) / (block[i] - block[i - 1])
            low = block[i - 1 + points]
            return low + fraction * (block[i + points] - low)
    return block[start + 2 * points - 1]


@njit
def schedule_slope(block: FloatArray, entry: int, x: float) -> float:
    """Derivative at x of a schedule, in its unit over that of x ([deg] per Mach ...), from the right at a point; 0
    beyond its ends."""
    start, points = int(block[entry]), int(block[entry + 1])
    for i in range(start + 1, start + points):
        if block[i - 1] <= x < block[i]:
            return (block[i + points] - block[i - 1 + points]) / (block[i] - block[i - 1])
    return 0.0
