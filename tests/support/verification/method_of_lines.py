"""An independent solution of a flight record's physics: finite volumes in space, scipy's Radau in time.

It uses none of the package's numerics: its own mesh, its own fluxes (conductivity at the mean temperature of two
neighbours, no Kirchhoff variable), lumped volumes, properties by np.interp from the declared tables.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import RegularGridInterpolator
from scipy.sparse import diags

from sim_heating.base.conditions import RATIO_VARIABLES, Conditions
from sim_heating.march.point import PointModel
from sim_heating.thermal.stack import Material, PressureTable

FloatArray = NDArray[np.float64]
SIGMA = 5.670374419e-8
FORCING_STEP_S = 0.05
"""Step at which the heating ratio is looked up; between, film coefficients are linear."""


@dataclass(frozen=True)
class Grid:
    """Nodes of a wall: depth [m], and for each element its layer and length [m]."""

    depth_m: FloatArray
    layer: NDArray[np.int64]
    length_m: FloatArray

    def node(self, depth_m: float) -> int:
        """The node at a depth."""
        return int(np.argmin(np.abs(self.depth_m - depth_m)))


def grid(model: PointModel, elements: Sequence[int], growth: float = 3.0) -> Grid:
    """A number of elements for each layer, growing inward (3 to 1 from first to last) and ending on every interface."""
    lengths = [
        layer.thickness_m * np.diff(np.expm1(np.log(growth) * np.linspace(0.0, 1.0, n + 1)) / (growth - 1.0))
        for layer, n in zip(model.construction.stack.layer, elements, strict=True)
    ]
    length = np.concatenate(lengths)
    return Grid(np.concatenate(([0.0], np.cumsum(length))), np.repeat(np.arange(len(elements)), elements), length)


def conductivity(m: Material, temperature_K: FloatArray, p_Pa: float) -> FloatArray:
    """k(T, p) [W/(m K)] as declared: linear in T and in log10(p), held beyond the ends."""
    table = m.conductivity_W_mK
    if not isinstance(table, PressureTable):
        return np.interp(temperature_K, *np.array(table).T)
    log_p, k = np.log10(table.p_Pa), np.array(table.k)
    x = float(np.clip(np.log10(p_Pa), log_p[0], log_p[-1]))
    j = min(max(int(np.searchsorted(log_p, x)) - 1, 0), len(log_p) - 2)
    f = (x - log_p[j]) / (log_p[j + 1] - log_p[j])
    low, high = (np.interp(temperature_K, table.T_K, k[:, i]) for i in (j, j + 1))
    return (1.0 - f) * low + f * high


def film(model: PointModel, conditions: Conditions) -> FloatArray:
    """Film coefficient r h_ref [kg/(m2 s)]: the contract's linear model about a table, looked up by scipy."""
    assert model.ratio is not None
    x = np.column_stack([conditions[name] for name in RATIO_VARIABLES])
    axes = [np.asarray(a) if len(a) > 1 else np.array([a[0], a[0] + 1.0]) for a in model.ratio.axes]
    values = model.ratio.ratio
    for i, axis in enumerate(model.ratio.axes):
        values = np.repeat(values, 2, axis=i) if len(axis) == 1 else values
    inside = np.clip(x, [a[0] for a in axes], [a[-1] for a in axes])
    ratio = RegularGridInterpolator(axes, values)(inside) * (1.0 + model.value("ratio.scale"))
    for i, short in enumerate(("alpha", "beta", "logre", "elevon", "bodyflap")):
        ratio += model.value(f"ratio.d_{short}") * (x[:, i] - model.reference[i])
    return ratio * conditions["h_ref_kg_m2_s"]


def specific_heat(m: Material, temperature_K: FloatArray) -> FloatArray:
    """c(T) [J/(kg K)] as declared."""
    return np.interp(temperature_K, *np.array(m.specific_heat_J_kgK).T)


def solve(
    model: PointModel,
    conditions: Conditions,
    on: Grid,
    rtol: float = 1e-6,
) -> FloatArray:
    """(time, node) temperatures [K] at the samples of the conditions; insulated back, wall enthalpy cp T."""
    forcing = _forcing(model, conditions)
    materials = model.construction.layer_materials()
    of = [np.flatnonzero(on.layer == i) for i in range(len(materials))]
    half = 0.5 * on.length_m * np.array([m.density_kg_m3 for m in materials])[on.layer]
    emissivity = np.array(materials[0].emissivity).T
    cp, surroundings4 = float(model.wall_enthalpy), model.construction.stack.surroundings_K**4

    def rate(t: float, T: FloatArray) -> FloatArray:
        h, recovery, q_add, log_p = (np.interp(t, forcing[0], row) for row in forcing[1:])
        flux, capacity = np.zeros(len(T) + 1), np.zeros(len(T))
        radiated = np.interp(T[0], *emissivity) * SIGMA * (T[0] ** 4 - surroundings4)
        flux[0] = h * (recovery - cp * T[0]) + q_add - radiated
        for m, e in zip(materials, of, strict=True):
            hot, cold = T[e], T[e + 1]
            flux[e + 1] = conductivity(m, 0.5 * (hot + cold), 10.0**log_p) * (hot - cold) / on.length_m[e]
            ends = specific_heat(m, T[e[0] : e[-1] + 2])
            capacity[e] += half[e] * ends[:-1]
            capacity[e + 1] += half[e] * ends[1:]
        return -np.diff(flux) / capacity

    n = len(on.depth_m)
    start = np.full(n, model.construction.stack.initial_K)
    time = conditions.time_s
    tridiagonal = diags([1.0, 1.0, 1.0], [-1, 0, 1], (n, n))
    options = {"rtol": rtol, "atol": 1e-4, "max_step": 5.0, "jac_sparsity": tridiagonal}
    solution = solve_ivp(rate, (time[0], time[-1]), start, "Radau", t_eval=time, **options)
    assert solution.success, solution.message
    return solution.y.T


def _forcing(model: PointModel, conditions: Conditions) -> FloatArray:
    """Time, film, recovery enthalpy, added flux and log10 pressure on a fine grid of times."""
    time = np.arange(conditions.time_s[0], conditions.time_s[-1] + FORCING_STEP_S, FORCING_STEP_S)
    fine = conditions.at(np.minimum(time, conditions.time_s[-1]))
    q_add = fine["q_add_W_m2"] if "q_add_W_m2" in fine else np.zeros(len(time))
    return np.array([time, film(model, fine), fine["H_r_J_kg"], q_add, np.log10(fine["p_surface_Pa"])])
