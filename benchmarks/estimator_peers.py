"""Peers of the estimator for its timing: filterpy's extended Kalman filter and scipy's least squares on the same fit.

Both get this program's own compiled march of the same 14 nodes, changed in place and not packed again. The filter's
transition is differenced node by node as its equations read, its innovations parameter by parameter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from sim_heating.estimation.record_fit import RecordFit
from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.point import PointModel, initial_temperatures
from sim_heating.thermal.frame import NOT_CONTROLLED_K

try:
    from filterpy.kalman import ExtendedKalmanFilter
except ImportError:
    ExtendedKalmanFilter = None

FloatArray = NDArray[np.float64]

MOVED_K = 0.1
"""Step of a node's temperature for its column of the transition."""
MOVED = 1e-4
"""Step of a parameter for its derivative, as a part of its prior sigma or of 1."""
START_K2, PROCESS_K2_S = 1e-4, 1e-6
"""Variance of the start and of the process: negligible, so that both sides fit the same model."""


@dataclass
class Plain:
    """One point of a fit as others would march it: from its start, one march or one step at a time.

    read_K : (step, sensor) readings at the ends of the steps, those between two steps taken linearly
    """

    part: RecordFit
    names: tuple[str, ...]
    read_K: FloatArray
    sigma_K: FloatArray

    def __post_init__(self) -> None:
        self.time_s = self.part.time_s
        self.history = condition_history(self.part.conditions.at(self.time_s))
        begun = self.part.initial_K(None)
        self.start_K = initial_temperatures(self.part.model.construction, self.part.mesh) if begun is None else begun
        # all sides march in the schedule of the fit
        self.ensemble = Ensemble([self.part.model], [self.part.mesh], tolerance_K=NOT_CONTROLLED_K)
        self.nodes = self.ensemble.node_offsets(0)
        self.sensors = np.array(self.part.mesh.sensors)

    def model(self, values: FloatArray) -> PointModel:
        """The point at parameter values."""
        return self.part.model.with_parameters(dict(zip(self.names, map(float, values), strict=True)))

    def march(self, values: FloatArray) -> FloatArray:
        """(step, sensor) temperatures [K] after each step."""
        self.ensemble.set_model(0, self.model(values))
        self.ensemble.reset()
        self.ensemble.set_profile(0, self.start_K)
        kept = self.nodes[self.sensors]
        return self.ensemble.march(self.time_s, self.history[np.newaxis], keep=kept)[1:]

    def residuals(self, values: FloatArray) -> FloatArray:
        """(step x sensor,) over sigma."""
        return ((self.read_K - self.march(values)) / self.sigma_K).ravel()

    def step(self, k: int, profile_K: FloatArray) -> FloatArray:
        """(node,) temperatures [K] one step after a profile."""
        self.ensemble.set_profile(0, profile_K)
        self.ensemble.march(self.time_s[k : k + 2], self.history[np.newaxis, k : k + 2], keep=self.nodes[:0])
        return self.ensemble.node_temperatures(0)


def plain(part: RecordFit, names: tuple[str, ...]) -> Plain:
    """The readings of a part on the steps of its march."""
    t = part.time_s[1:]
    sensors = [c.sensor for c in part.channels]
    every = [np.interp(t, part.record.time_s, part.record.thermocouples[s.column]) for s in sensors]
    noise = [np.hypot(part.sigma_K[c.number], c.sensor.lsb_K / np.sqrt(12.0)) for c in part.channels]
    return Plain(part, names, np.column_stack(every), np.array(noise))


def by_filterpy(point: Plain, values: FloatArray, iterations: int) -> FloatArray:
    """Gauss-Newton on the innovations of filterpy's extended Kalman filter, all derivatives by differences."""
    at = values.copy()
    moves = np.array([MOVED * _scale(point, n) for n in point.names])
    for _ in range(iterations):
        base, variance = _innovations(point, at)
        columns = [(_innovations(point, at + move)[0] - base) / sum(move) for move in np.diag(moves)]
        J = -np.column_stack([c.ravel() for c in columns])
        weight = 1.0 / variance.ravel()
        at = at + np.linalg.solve((J.T * weight) @ J, J.T @ (weight * base.ravel()))
    return at


def _scale(point: Plain, name: str) -> float:
    sigma = point.part.model.definition(name).sigma
    return sigma if np.isfinite(sigma) else 1.0


def _innovations(point: Plain, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(step, sensor) innovations [K] and their variances."""
    n, sensors = len(point.nodes), point.sensors
    H = np.eye(n)[sensors]
    ekf = ExtendedKalmanFilter(dim_x=n, dim_z=len(sensors))
    ekf.x, ekf.P, ekf.R = point.start_K.copy(), START_K2 * np.eye(n), np.diag(point.sigma_K**2)
    point.ensemble.set_model(0, point.model(values))
    innovations, variances = np.empty_like(point.read_K), np.empty_like(point.read_K)
    for k in range(len(point.time_s) - 1):
        before = ekf.x
        after = point.step(k, before)
        moved = [point.step(k, before + MOVED_K * e) for e in np.eye(n)]
        ekf.F = (np.column_stack(moved) - after[:, np.newaxis]) / MOVED_K
        ekf.Q = PROCESS_K2_S * (point.time_s[k + 1] - point.time_s[k]) * np.eye(n)
        ekf.predict_x = lambda u=0, x=after: setattr(ekf, "x", x)
        ekf.predict()
        ekf.update(point.read_K[k], lambda x: H, lambda x: H @ x)
        innovations[k], variances[k] = ekf.y, np.diag(ekf.S)
    return innovations, variances


def by_scipy(point: Plain, values: FloatArray) -> FloatArray:
    """scipy's least squares with its own finite differences, until its own tolerances are met."""
    scale = np.array([_scale(point, n) for n in point.names])
    found = least_squares(lambda x: point.residuals(x * scale), values / scale)
    return np.asarray(found.x * scale)


def by_side_by_side(point: Plain, values: FloatArray, iterations: int) -> FloatArray:
    """Gauss-Newton with differences marched side by side in the lanes of one group: the march at its very best."""
    scale = np.array([_scale(point, n) for n in point.names])
    m, at = len(values), values.copy()
    group = Ensemble([point.part.model] * (m + 1), [point.part.mesh] * (m + 1), tolerance_K=NOT_CONTROLLED_K)
    kept = np.concatenate([group.node_offsets(i, point.sensors) for i in range(len(group.models))])
    for _ in range(iterations):
        r = _several(point, group, kept, np.vstack([at, at + MOVED * np.diag(scale)]))
        J = ((r[1:] - r[0]) / (MOVED * scale)[:, np.newaxis]).T
        at = at - np.linalg.lstsq(J, r[0])[0]
    return at


def _several(point: Plain, group: Ensemble, kept: NDArray[np.int64], vectors: FloatArray) -> FloatArray:
    """(vector, step x sensor) residuals."""
    for i, v in enumerate(vectors):
        group.set_model(i, point.model(v))
    group.reset()
    for i in range(len(vectors)):
        group.set_profile(i, point.start_K)
    out = group.march(point.time_s, point.history[np.newaxis], keep=kept)[1:]
    each = out.reshape(len(out), len(vectors), -1).transpose(1, 0, 2)
    return ((point.read_K - each) / point.sigma_K).reshape(len(vectors), -1)
