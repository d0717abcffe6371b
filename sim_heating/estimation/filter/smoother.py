"""Fixed-interval smoothing of a filtered history: temperatures and heating-ratio disturbance given all readings.

The Rauch-Tung-Striebel smoother in the form of Bryson & Frazier as modified by Bierman (IEEE Trans. Autom. Control 18
(1973) 391), which inverts no covariance: heat conduction leaves it nearly singular. Backward from zeros, with A the
transition of a step (its readings taken), h the row of a reading, nu and s its innovation and variance,

    lambda' = A' lambda + sum h nu / s,    Lambda' = A' Lambda A + sum h h' / s,
    mean + P lambda',    P - P Lambda' P,

mean and P filtered at the start of the step; linearised where the filter was.
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

    time_s        : (time,) ends of the steps, the start first
    temperature_K : (time, node)
    ratio         : (time,) disturbance that holds from each time to the next
    covariance    : (time, node + 1, node + 1)
    """

    time_s: FloatArray
    temperature_K: FloatArray
    ratio: FloatArray
    covariance: FloatArray

    @property
    def sigma_K(self) -> FloatArray:
        """(time, node) standard deviation of the temperatures."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=1, axis2=2)[:, :-1], 0.0))

    @property
    def ratio_sigma(self) -> FloatArray:
        """(time,) standard deviation of the disturbance."""
        return np.sqrt(np.maximum(self.covariance[:, -1, -1], 0.0))


def smooth(filtered: Filtered) -> Smoothed:
    """Smooth a filtered history; memory as much again as its means and covariances.

    raises : InputError where the filter kept no history
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
        own = np.arange(first[k], first[k + 1])
        own = own[read[own]]
        A, H, weight = history.transition[k], history.rows[own], 1.0 / filtered.variance_K2[own]
        adjoint = A.T @ adjoint + H.T @ (weight * filtered.innovation_K[own])
        information = A.T @ information @ A + (H.T * weight) @ H
        P = history.covariance[k]
        mean[k] = history.mean[k] + P @ adjoint
        covariance[k] = P - P @ information @ P
        covariance[k] = 0.5 * (covariance[k] + covariance[k].T)
    return Smoothed(history.time_s, mean[:, :-1], mean[:, -1], covariance)
