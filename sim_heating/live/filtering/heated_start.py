"""Start of a wall that was heated before anybody looked: temperatures from one reading of each thermocouple.

The surface is taken to have gone from its declared temperature to the reading of the outermost thermocouple along one
of several curves and over one of several times. Each of these histories h is conducted into the wall. Those that agree
with the readings y_i of the deeper thermocouples count more:

    w_h ~ exp(-1/2 sum_i (T_h(d_i) - y_i)^2 / sigma_y^2),    sum_h w_h = 1
    T = sum_h w_h T_h,    C = sum_h w_h (T_h - T) (T_h - T)' + sigma^2 K

K is a smooth error of unit variance; sigma its standard deviation, that of T at the thermocouples and START_SIGMA_K at
least. Derived in docs/theory/clocks_and_starts.md, equations 4 and 8.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.kernels.block import H_REF, Q_ADD, RECOVERY_ENTHALPY
from sim_heating.base.parallel.threads import one_thread
from sim_heating.estimation import starts
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.point import PointModel, initial_temperatures
from sim_heating.thermal.mesh import Mesh, diffusion_depths

CURVES = (
    ((0.0, 0.02, 1.0), (0.0, 1.0, 1.0)),
    ((0.0, 1.0), (0.0, 1.0)),
    ((0.0, 0.5, 1.0), (0.0, 0.2, 1.0)),
    ((0.0, 0.2, 1.0), (0.0, 0.8, 1.0)),
    ((0.0, 0.5, 1.0), (0.0, 1.2, 1.0)),
    ((0.0, 0.3, 1.0), (0.0, 1.8, 1.0)),
)
"""Part of the time that has passed and rise of the surface over its present one [-], of each curve: at once, evenly,
late, early, and two that were hotter before."""
DURATIONS_S = tuple(np.geomspace(20.0, 2560.0, 15).tolist())
"""Times that the heating lasted [s]."""
STEPS = 60
"""Steps of each history."""
READING_SHARE = 0.03
"""Part of the rise of the surface by which these histories miss a thermocouple [-]: walls are heated along other curves
too."""


def start_of_heated(
    model: PointModel, mesh: Mesh, read_K: Mapping[int, float], conditions: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Temperatures of a wall and their covariance, from a reading of each thermocouple.

    read_K     : reading at each node that has a thermocouple [K], one at least
    conditions : (condition,) present conditions, whose pressure and surroundings hold for the past as well
    returns    : (node,) temperatures [K] and (node, node) covariance [K2]
    raises     : RunError where no history can be conducted

    Derived in docs/theory/clocks_and_starts.md, equation 8.
    """
    declared = initial_temperatures(model.construction, mesh)
    nodes = sorted(read_K)
    read = np.array([read_K[n] for n in nodes])
    rise = float(read[0] - declared[0])
    T = _conducted(model, mesh, float(declared[0]), rise, conditions)
    sigma = reading_sigma_K(rise)
    chi2 = np.sum(((T[:, nodes] - read) / sigma) ** 2, axis=1)
    weight = np.exp(-0.5 * (chi2 - chi2.min()))
    weight /= np.sum(weight)
    with one_thread():
        mean = weight @ T
        spread = np.sqrt(weight)[:, np.newaxis] * (T - mean)
        error_K = max(starts.START_SIGMA_K, float(np.max(np.abs(mean[nodes] - read))))
        root = error_K * starts.smooth_directions(diffusion_depths(model.construction, mesh))
        return mean, spread.T @ spread + root @ root.T


def reading_sigma_K(rise_K: float) -> float:
    """Standard deviation [K] by which these histories miss a thermocouple, after a rise of the surface [K]:
    docs/theory/clocks_and_starts.md, equation 8."""
    return float(np.hypot(starts.START_SIGMA_K, READING_SHARE * abs(rise_K)))


def _conducted(model: PointModel, mesh: Mesh, declared_K: float, rise_K: float, conditions: FloatArray) -> FloatArray:
    """(history, node) temperatures at the end of all histories [K]."""
    wall, fraction = starts.with_imposed_surface(model), np.linspace(0.0, 1.0, STEPS + 1)
    shapes = np.array([np.interp(fraction, *curve) for curve in CURVES])
    histories = np.tile(conditions, (len(CURVES), len(fraction), 1))
    histories[..., H_REF], histories[..., Q_ADD] = starts.IMPOSING_FILM, 0.0
    histories[..., RECOVERY_ENTHALPY] = starts.IMPOSING_CP * np.maximum(declared_K + rise_K * shapes, 1.0)
    ensemble = Ensemble([wall] * len(CURVES), [mesh] * len(CURVES))
    temperatures_K = []
    for duration_s in DURATIONS_S:
        ensemble.reset()
        ensemble.march(duration_s * fraction, histories, keep=np.zeros(0, dtype=np.int64), longest_step_s=np.inf)
        temperatures_K += [ensemble.node_temperatures(i) for i in range(len(CURVES))]
    return np.array(temperatures_K)
