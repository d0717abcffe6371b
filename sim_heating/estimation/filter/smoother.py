"""Fixed-interval smoothing of a filtered history: temperatures and heating-ratio disturbance given all readings.

The Rauch-Tung-Striebel smoother in the form of Bryson and Frazier as modified by Bierman (Int. J. Control 18 (1973)
65), which inverts no covariance: heat conduction leaves it nearly singular. Backward from zeros, with A the
transition of a step (its readings taken), h the row of a reading, nu and S its innovation and variance,

    lambda_k = A' lambda_(k+1) + sum h' nu / S,    Lambda_k = A' Lambda_(k+1) A + sum h' h / S,
    z^s_k = z_k + P_k lambda_k,                    P^s_k = P_k - P_k Lambda_k P_k,

z and P filtered at the start of the step; linearised where the filter was. Derived in docs/theory/filter.md,
equations 14 to 16.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.estimation.filter.march import Filtered


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Means and covariances given all readings; the state is the node temperatures and the disturbance of the ratio.

    time_s        : (time,) ends of the steps, the start of the march first [s]
    temperature_K : (time, node) smoothed node temperatures [K]
    ratio         : (time,) disturbance of the heating ratio that acts from each time to the next [-]
    covariance    : (time, node + 1, node + 1) of temperatures [K2] and disturbance [-], the disturbance last
    """

    time_s: FloatArray
    temperature_K: FloatArray
    ratio: FloatArray
    covariance: FloatArray

    @property
    def sigma_K(self) -> FloatArray:
        """(time, node) standard deviation of the smoothed temperatures [K]; docs/theory/filter.md, equation 16.

        A variance that rounding has made negative counts as 0.
        """
        return np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=1, axis2=2)[:, :-1], 0.0))

    @property
    def ratio_sigma(self) -> FloatArray:
        """(time,) standard deviation of the smoothed heating-ratio disturbance [-]; docs/theory/filter.md, equation 16.

        A variance that rounding has made negative counts as 0.
        """
        return np.sqrt(np.maximum(self.covariance[:, -1, -1], 0.0))


def smooth(filtered: Filtered) -> Smoothed:
    """Smooth a filtered history over the whole interval of its readings.

        z^s_k = z_k + P_k lambda_k,    P^s_k = P_k - P_k Lambda_k P_k

    filtered : result of a filter that kept its history
    returns  : temperatures [K], ratio disturbance [-] and their covariance at the ends of all steps
    raises   : InputError where the filter kept no history

    Readings that were not taken (lost, held out) contribute nothing. Needs as much memory again as the filtered
    means and covariances. Source: Bierman 1973, Int. J. Control 18, 65; derived in docs/theory/filter.md, equations 14
    to 16.
    """
    history = filtered.history
    if history is None:
        raise InputError("smoothing: the filter kept no history; filter with keep=True")
    steps, size = history.transition.shape[:2]
    mean, covariance = np.empty((steps + 1, size)), np.empty((steps + 1, size, size))
    adjoint, information = np.zeros(size), np.zeros((size, size))
    mean[-1], covariance[-1] = history.mean[-1], history.covariance[-1]
    read = filtered.read
    first = np.searchsorted(history.step, np.arange(steps + 1))
    for k in range(steps - 1, -1, -1):
        in_step = np.arange(first[k], first[k + 1])
        in_step = in_step[read[in_step]]
        # A has the readings of its step taken already: rows and transition refer to the state at its start.
        A, H, weight = history.transition[k], history.rows[in_step], 1.0 / filtered.variance_K2[in_step]
        adjoint = A.T @ adjoint + H.T @ (weight * filtered.innovation_K[in_step])
        information = A.T @ information @ A + (H.T * weight) @ H
        P = history.covariance[k]
        mean[k] = history.mean[k] + P @ adjoint
        covariance[k] = P - P @ information @ P
        # P Lambda P is symmetric only to rounding, and the square roots of variances read the diagonal alone.
        covariance[k] = 0.5 * (covariance[k] + covariance[k].T)
    return Smoothed(history.time_s, mean[:, :-1], mean[:, -1], covariance)
