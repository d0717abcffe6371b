"""The semi-discrete heat equation of a control point, M(T) dT/dt = F(T, t), as other integrators take it.

It is the system that the march integrates: same mesh, same property tables, same sharing of mass between nodes,
and conditions linear between the samples of the entry. It is written down here a second time, from the equations at the
head of thermal/step.py; so that what the integrators have in common is checked too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

from sim_heating.base.kernels.block import H_REF, P_SURFACE, RECOVERY_ENTHALPY, TIME
from sim_heating.base.kernels.jit import njit
from sim_heating.march.point import PointModel
from sim_heating.thermal.assembly import SHARE
from sim_heating.thermal.faces import SIGMA
from sim_heating.thermal.mesh import Mesh
from sim_heating.thermal.stack import Material, pairs

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Kinked:
    """A property linear between points, constant outside: value at 0 K, kinks (temperature, change of slope)."""

    value: FloatArray
    kink_K: FloatArray
    bend: FloatArray

    @staticmethod
    def of(T_K: FloatArray, rows: FloatArray) -> Kinked:
        """Rows (column, point) of a property at common temperatures."""
        slopes = np.diff(rows, axis=1) / np.diff(T_K)
        bend = np.diff(np.pad(slopes, ((0, 0), (1, 1))), axis=1)
        return Kinked(rows[:, 0], T_K, bend)


@dataclass(frozen=True)
class System:
    """One control point on one mesh, and its entry.

    material  : (element,) which of the materials
    half, g   : (element,) half its mass [kg/m2], reciprocal of its length [1/m]
    heat_capacity, conductivity : of each material; the conductivity a column for each of log10_p
    emissivity : of the surface
    start_K   : (node,)
    time_s, film, recovery, pressure : the entry, (time,)
    """

    material: NDArray[np.int64]
    half: FloatArray
    g: FloatArray
    heat_capacity: list[Kinked]
    conductivity: list[Kinked]
    emissivity: Kinked
    log10_p: FloatArray
    cp_wall: float
    start_K: FloatArray
    time_s: FloatArray
    film: FloatArray
    recovery: FloatArray
    pressure: FloatArray

    @property
    def nodes(self) -> int:
        """Number of unknowns."""
        return len(self.start_K)


def system_of(model: PointModel, mesh: Mesh, history: FloatArray) -> System:
    """The system of a point without contact resistance, its back adiabatic; history as `prescribed` gives it."""
    stack = model.construction.stack
    layers = model.construction.layer_materials()
    distinct = list({id(m): m for m in layers}.values())
    index = {id(m): k for k, m in enumerate(distinct)}
    material = np.array([index[id(layers[layer])] for layer in mesh.layer])
    density = np.array([distinct[m].density_kg_m3 for m in material])
    log10_p = np.unique(np.concatenate([np.log10(m.conductivity_grid()[0]) for m in distinct if _porous(m)]))
    emissivity = layers[0].emissivity or [[300.0, 1.0]]
    return System(
        material=material,
        half=0.5 * density * mesh.length_m,
        g=1.0 / mesh.length_m,
        heat_capacity=[_kinked(*pairs(m.specific_heat_J_kgK)) for m in distinct],
        conductivity=[_conductivity(m, log10_p) for m in distinct],
        emissivity=_kinked(*pairs(emissivity)),
        log10_p=log10_p,
        cp_wall=float(model.wall_enthalpy),
        start_K=np.full(mesh.nodes, float(stack.initial_K or 0.0)),
        time_s=history[0, :, TIME].copy(),
        film=history[0, :, H_REF].copy(),
        recovery=history[0, :, RECOVERY_ENTHALPY].copy(),
        pressure=history[0, :, P_SURFACE].copy(),
    )


def _porous(material: Material) -> bool:
    return len(material.conductivity_grid()[0]) > 1


def _kinked(T_K: FloatArray, values: FloatArray) -> Kinked:
    return Kinked.of(np.array(T_K, dtype=float), np.array([values], dtype=float))


def _conductivity(material: Material, log10_p: FloatArray) -> Kinked:
    p_Pa, T_K, k = material.conductivity_grid()
    columns = [[np.interp(x, np.log10(p_Pa), row) for row in k] for x in log10_p]
    return Kinked.of(np.array(T_K, dtype=float), np.array(columns))


# Compiled, for the solvers of scipy ---------------------------------------------------------------------------------


@njit
def _property(T, value, kinks, bends, count):
    """Property and its integral from 0 K."""
    v, integral = value, value * T
    for j in range(count):
        d = T - kinks[j]
        if d <= 0.0:
            break
        v += bends[j] * d
        integral += 0.5 * bends[j] * d * d
    return v, integral


@njit
def _linear(time_s, values, t):
    k = min(max(int((t - time_s[0]) / (time_s[1] - time_s[0])), 0), len(time_s) - 2)
    f = (t - time_s[k]) / (time_s[k + 1] - time_s[k])
    return values[k] + f * (values[k + 1] - values[k])


@njit
def rate(t, T, given):
    """dT/dt [K/s] of all nodes: fluxes, then the mass matrix by elimination; given is what `arguments` gives."""
    material, half, g, c_value, c_kink, c_bend, k_value, k_kink, k_bend, count, eps, log10_p, cp, mixing, entry = given
    n = len(T)
    out = np.empty(n)
    film, recovery = _linear(entry[0], entry[1], t), _linear(entry[0], entry[2], t)
    x = np.log10(max(_linear(entry[0], entry[3], t), 1e-30))
    last = len(log10_p) - 1
    j, f = 0, 0.0
    if x >= log10_p[last]:
        j, f = last - 1, 1.0
    elif x > log10_p[0]:
        while x >= log10_p[j + 1]:
            j += 1
        f = (x - log10_p[j]) / (log10_p[j + 1] - log10_p[j])
    diagonal, upper, lower = np.zeros(n), np.zeros(n), np.zeros(n)
    out[:] = 0.0
    wall = T[0]
    e = eps[0, 0]
    for m in range(eps.shape[1] - 1):
        e += eps[2, m] * max(0.0, wall - eps[1, m])
    out[0] = film * (recovery - cp * wall) - e * SIGMA * wall**4
    for i in range(n - 1):
        m = material[i]
        c_a, _ = _property(T[i], c_value[m], c_kink[m], c_bend[m], count[m, 0])
        c_b, _ = _property(T[i + 1], c_value[m], c_kink[m], c_bend[m], count[m, 0])
        q = 0.0
        for s in range(2):
            share = f if s == 1 else 1.0 - f
            _, th_a = _property(T[i], k_value[m, j + s], k_kink[m], k_bend[m, j + s], count[m, 1])
            _, th_b = _property(T[i + 1], k_value[m, j + s], k_kink[m], k_bend[m, j + s], count[m, 1])
            q += share * g[i] * (th_a - th_b)
        out[i] -= q
        out[i + 1] += q
        diagonal[i] += (1.0 - mixing) * half[i] * c_a
        diagonal[i + 1] += (1.0 - mixing) * half[i] * c_b
        upper[i] = mixing * half[i] * c_b
        lower[i + 1] = mixing * half[i] * c_a
    for i in range(1, n):
        w = lower[i] / diagonal[i - 1]
        diagonal[i] -= w * upper[i - 1]
        out[i] -= w * out[i - 1]
    out[n - 1] /= diagonal[n - 1]
    for i in range(n - 2, -1, -1):
        out[i] = (out[i] - upper[i] * out[i + 1]) / diagonal[i]
    return out


def arguments(s: System, mixing: float = SHARE) -> tuple[np.ndarray | float, ...]:
    """Arguments of `rate` after t and T; mixing is the part of the mass matrix that is shared, 0 makes it diagonal."""
    c, k = s.heat_capacity, s.conductivity
    most = max(len(p.kink_K) for p in (*c, *k))
    columns = len(s.log10_p)

    def padded(values: FloatArray, fill: float) -> FloatArray:
        return np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, most - values.shape[-1])], constant_values=fill)

    count = np.array([[len(a.kink_K), len(b.kink_K)] for a, b in zip(c, k, strict=True)])
    width = len(s.emissivity.kink_K) + 1
    eps = np.zeros((3, width))
    eps[0, 0] = s.emissivity.value[0]
    eps[1, : width - 1], eps[2, : width - 1] = s.emissivity.kink_K, s.emissivity.bend[0]
    return (
        s.material, s.half, s.g,
        np.array([p.value[0] for p in c]), np.array([padded(p.kink_K, 1e9) for p in c]),
        np.array([padded(p.bend[0], 0.0) for p in c]),
        np.array([np.broadcast_to(p.value, (columns,)) for p in k]), np.array([padded(p.kink_K, 1e9) for p in k]),
        np.array([padded(p.bend, 0.0) for p in k]),
        count, eps, s.log10_p, s.cp_wall, mixing, np.array([s.time_s, s.film, s.recovery, s.pressure]),
    )  # fmt: skip


@njit
def jacobian(t, T, given):
    """(n, n) matrix of `rate`, by differences of 1e-6 T."""
    n = len(T)
    J = np.empty((n, n))
    base = rate(t, T, given)
    moved = T.copy()
    for i in range(n):
        d = 1e-6 * T[i]
        moved[i] = T[i] + d
        J[:, i] = (rate(t, moved, given) - base) / d
        moved[i] = T[i]
    return J


# In numpy, as one writes it without a compiler ----------------------------------------------------------------------


def rate_in_numpy(s: System) -> Callable[[float, FloatArray], FloatArray]:
    """dT/dt as by `rate`, vectorised over the nodes."""
    elements = [np.flatnonzero(s.material == m) for m in range(len(s.heat_capacity))]

    def function(t: float, T: FloatArray) -> FloatArray:
        film, recovery, pressure = (np.interp(t, s.time_s, v) for v in (s.film, s.recovery, s.pressure))
        place = np.interp(np.log10(max(pressure, 1e-30)), s.log10_p, np.arange(len(s.log10_p)))
        net, q, capacity = np.zeros(s.nodes), np.empty(s.nodes - 1), np.empty((2, s.nodes - 1))
        for of_material, c, k in zip(elements, s.heat_capacity, s.conductivity, strict=True):
            ends = T[np.array([of_material, of_material + 1])]
            capacity[:, of_material] = c.value[0] + np.maximum(0.0, ends[..., np.newaxis] - c.kink_K) @ c.bend[0]
            column = min(int(place), len(k.value) - 1)
            f = place - column if column + 1 < len(k.value) else 0.0
            after = min(column + 1, len(k.value) - 1)
            value = k.value[column] + f * (k.value[after] - k.value[column])
            bend = k.bend[column] + f * (k.bend[after] - k.bend[column])
            theta = value * ends + 0.5 * np.maximum(0.0, ends[..., np.newaxis] - k.kink_K) ** 2 @ bend
            q[of_material] = s.g[of_material] * (theta[0] - theta[1])
        emissivity = s.emissivity.value[0] + np.maximum(0.0, T[0] - s.emissivity.kink_K) @ s.emissivity.bend[0]
        net[0] = film * (recovery - s.cp_wall * T[0]) - emissivity * SIGMA * T[0] ** 4
        net[:-1] -= q
        net[1:] += q
        mass = np.zeros((3, s.nodes))
        mass[1, :-1] += (1.0 - SHARE) * s.half * capacity[0]
        mass[1, 1:] += (1.0 - SHARE) * s.half * capacity[1]
        mass[0, 1:], mass[2, :-1] = SHARE * s.half * capacity[1], SHARE * s.half * capacity[0]
        return solve_banded((1, 1), mass, net, check_finite=False)

    return function
