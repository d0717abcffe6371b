"""Readings of several sensors at common times, as the filter takes them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from sim_heating.estimation.filter.march import Samples


def samples_on_grid(
    time_s: ArrayLike, nodes: Sequence[int], lower_K: ArrayLike, sigma_K: ArrayLike, upper_K: ArrayLike | None = None
) -> Samples:
    """Samples of several sensors that are read at common times, with gain 1 and bias 0.

    time_s           : (sample,) [s];  nodes : (sensor,) node of each sensor
    lower_K, upper_K : (sensor, sample) interval of each reading [K], NaN where nothing is read; upper_K None where
                       nothing was rounded
    sigma_K          : (sensor,) or one number, standard deviation of the noise [K]
    returns          : readings in order of time, the sensors of one time in their order

    The reading model is docs/theory/filter.md, equation 7.
    """
    t, lower = np.asarray(time_s, dtype=float), np.atleast_2d(np.asarray(lower_K, dtype=float))
    upper = lower if upper_K is None else np.atleast_2d(np.asarray(upper_K, dtype=float))
    count, sensors = len(t), len(nodes)
    sigma = np.broadcast_to(np.asarray(sigma_K, dtype=float), sensors)
    flat = np.zeros(count * sensors)
    return Samples(
        np.repeat(t, sensors),
        np.tile(np.asarray(nodes, dtype=np.int64), count),
        lower.T.ravel(),
        upper.T.ravel(),
        np.tile(sigma**2, count),
        flat + 1.0,
        flat,
    )
