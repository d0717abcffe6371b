"""March of a layered wall: control volumes about nodes that lie on every interface and every thermocouple.

    C_i dT_i/dt = sum_j g_ij (T_j - T_i) + s_i,    C_i = sum of rho c(T_i) dx / 2,    g_ij = k((T_i + T_j) / 2, p) / dx
    surface      r h_ref (H_r - H_w(T_0)) + q_add - eps sigma (T_0^4 - T_sur^4) enters the first node
    sideways     s_i loses G_i (T_i - T_i(0)) to a neighbour that stays as it was
    in time      (3 T_n+1 - 4 T_n + T_n-1) / (2 dt), properties at 2 T_n - T_n-1: one elimination and Newton on T_0

A contact resistance is an element without capacity. Differences of the second order in time: Gear (1971).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.challenge.air import WALL_K

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SIGMA = 5.670374419e-8
TABLE_K = np.arange(60.0, 2600.0, 4.0)
"""Nodes that all properties are tabulated on."""


@dataclass(frozen=True)
class Wall:
    """A wall on its mesh.

    dx_m, layer   : (element,) lengths, layers; layer -1 is a contact resistance, `dx_m` then holds it [m2 K/W]
    x_m           : (node,) depths
    capacity      : (layer, temperature) rho c on TABLE_K
    log_p, k      : (layer, pressure), (layer, pressure, temperature) conductivity
    eps           : (temperature,) emissivity
    back          : h [W/(m2 K)], T [K], emissivity, exponent of h in |T - T_back| / 10 K
    """

    dx_m: FloatArray
    layer: IntArray
    x_m: FloatArray
    capacity: FloatArray
    log_p: FloatArray
    k: FloatArray
    eps: FloatArray
    back: FloatArray
    surroundings_K: float

    def node(self, depth_m: float) -> int:
        """Outermost node at a depth."""
        found = int(np.argmin(np.abs(self.x_m - depth_m)))
        assert abs(self.x_m[found] - depth_m) < 1e-9, "a thermocouple sits on a node"
        return found

    def shares(self, weights: Callable[[FloatArray], FloatArray]) -> FloatArray:
        """(node,) integral of a function of depth over the control volumes [m times its unit]."""
        middle = 0.5 * (self.x_m[1:] + self.x_m[:-1])
        part = 0.5 * np.asarray(weights(middle), dtype=float) * np.diff(self.x_m)
        return np.concatenate((part, [0.0])) + np.concatenate(([0.0], part))


@dataclass
class Forcing:
    """What acts on a wall, on the steps of the march.

    film, H_r, log_p, eps_factor : (time,) r h_ref [kg/(m2 s)], recovery enthalpy [J/kg], log10 pressure, on emissivity
    hot, hot_share               : relative rise of the film coefficient on HOT_K, (time,) share of it that acts
    H_w                          : enthalpy of air on WALL_K [J/kg]
    deposit, diverted            : (node,) share of the convective flux that is set free there; share the surface lacks
    water                        : (node,) [kg/m2]
    added                        : (time,) flux into the surface besides convection and radiation [W/m2]
    side                         : (node,) G of what is lost sideways [W/(m2 K)]
    moisture                     : latent heat [J/kg], boiling and width [K], time [s], share that condenses inward
    """

    film: FloatArray
    H_r: FloatArray
    log_p: FloatArray
    eps_factor: FloatArray
    hot: FloatArray
    hot_share: FloatArray
    H_w: FloatArray
    deposit: FloatArray
    diverted: float
    water: FloatArray
    moisture: FloatArray
    added: FloatArray
    side: FloatArray


def build(
    stack: Mapping[str, Any],
    materials: Mapping[str, Any],
    depths_m: Sequence[float],
    back: Sequence[float] | None = None,
    share: float = 1.0,
) -> Wall:
    """The wall of a record's [stack] and [materials] with a node at each depth; `share` of the usual elements."""
    layers = stack["layer"]
    dx, layer, x, outer = [], [], [0.0], 0.0
    for i, entry in enumerate(layers):
        faces = _faces(outer, outer + entry["thickness_m"], depths_m, _elements(i, entry["thickness_m"], share), i == 1)
        dx += np.diff(faces).tolist()
        layer += [i] * (len(faces) - 1)
        x += faces[1:].tolist()
        outer = float(faces[-1])
        contact = entry.get("contact_m2K_W", 0.0)
        if contact > 0.0 and i < len(layers) - 1:
            dx.append(contact)
            layer.append(-1)
            x.append(outer)
    chosen = [materials[entry["material"]] for entry in layers]
    log_p, k = _conductivities([m["conductivity_W_mK"] for m in chosen])
    declared = stack["back"]
    plain = [0.0, 0.0, 0.0, 0.0]
    if declared != "adiabatic":
        plain = [declared["h_W_m2K"], declared["T_K"], declared["emissivity"], 0.0]
    return Wall(
        np.array(dx),
        np.array(layer),
        np.array(x),
        np.array([m["density_kg_m3"] * along(m["specific_heat_J_kgK"], TABLE_K) for m in chosen]),
        log_p,
        k,
        along(chosen[0]["emissivity"], TABLE_K),
        np.array(plain if back is None else back, dtype=float),
        float(stack["surroundings_K"]),
    )


def along(table: Any, T_K: FloatArray) -> FloatArray:
    """A property [[T, value], ...] at temperatures."""
    return np.interp(T_K, *np.array(table, dtype=float).T)


def _elements(number: int, thickness_m: float, share: float) -> int:
    usual = 12 if number == 0 else 110 if number == 1 else 10 if thickness_m > 1e-3 else 3
    return max(round(usual * share), 2)


def _faces(start: float, end: float, depths_m: Sequence[float], count: int, graded: bool) -> FloatArray:
    """Nodes of a layer, its ends and the depths within it among them; the elements of a graded one grow inward."""
    stops = [start, *sorted({d for d in depths_m if start + 1e-9 < d < end - 1e-9}), end]

    def stretched(x: Any) -> Any:  # elements are of equal length in this coordinate
        s = (np.asarray(x) - start) / (end - start)
        return np.log1p(7.0 * s) / np.log(8.0) if graded else s

    faces = [start]
    for a, b in pairwise(stops):
        n = max(round(count * float(stretched(b) - stretched(a))), 1)
        u = np.linspace(stretched(a), stretched(b), n + 1)[1:-1]
        s = np.expm1(u * np.log(8.0)) / 7.0 if graded else u
        faces += [*(start + s * (end - start)).tolist(), b]
    return np.array(faces)


def _conductivities(declared: Sequence[Any]) -> tuple[FloatArray, FloatArray]:
    """log10 pressures and conductivities of all layers, padded to one shape with the last column."""
    found = []
    for entry in declared:
        if isinstance(entry, Mapping):
            columns = np.array(entry["k"], dtype=float).T
            rows = np.array([np.interp(TABLE_K, entry["T_K"], column) for column in columns])
            found.append((np.log10(entry["p_Pa"]), rows))
        else:
            found.append((np.array([0.0]), along(entry, TABLE_K)[np.newaxis]))
    most = max(len(p) for p, _ in found)
    log_p = np.array([np.concatenate((p, 50.0 + np.arange(most - len(p)))) for p, _ in found])
    return log_p, np.array([np.pad(k, ((0, most - len(p)), (0, 0)), mode="edge") for p, k in found])


def march(wall: Wall, forcing: Forcing, start_K: float, nodes: Sequence[int], step_s: float) -> FloatArray:
    """(time, surface | nodes) temperatures [K] at the steps of the forcing."""
    kept = np.array([0, *nodes], dtype=np.int64)
    out = np.empty((len(forcing.film), len(kept)))
    _march(
        step_s,
        np.full(len(wall.x_m), float(start_K)),
        wall.dx_m,
        wall.layer,
        wall.capacity,
        wall.log_p,
        wall.k,
        wall.eps,
        wall.back,
        wall.surroundings_K,
        forcing.film,
        forcing.H_r,
        forcing.log_p,
        forcing.eps_factor,
        forcing.hot,
        forcing.hot_share,
        forcing.H_w,
        forcing.deposit,
        forcing.diverted,
        forcing.water.copy(),
        forcing.moisture,
        forcing.added,
        forcing.side,
        WALL_K[1],
        kept,
        out,
    )
    return out


@njit(cache=True, error_model="numpy")
def _place(T, first, step, count):
    """Interval and fraction of a temperature in a uniform table, constant beyond its ends."""
    a = min(max((T - first) / step, 0.0), count - 1.000001)
    i = int(a)
    return i, a - i


@njit(cache=True, error_model="numpy")
def _surface(guess, film, H_r, eps, eps_factor, T_sur, hot, share, H_w, wall_step, constant, slope):
    """T_0 that solves  constant - slope T_0 + film (1 + share hot) (H_r - H_w) - eps sigma (T_0^4 - T_sur^4) = 0."""
    T = guess
    for _ in range(40):
        i, s = _place(T, 0.0, wall_step, len(H_w))
        H, dH = H_w[i] + s * (H_w[i + 1] - H_w[i]), (H_w[i + 1] - H_w[i]) / wall_step
        i, s = _place(T, 60.0, 4.0, len(eps))
        e = eps_factor * (eps[i] + s * (eps[i + 1] - eps[i]))
        i, s = _place(T, 100.0, 5.0, len(hot))
        f = film * (1.0 + share * (hot[i] + s * (hot[i + 1] - hot[i])))
        df = film * share * (hot[i + 1] - hot[i]) / 5.0
        excess = constant - slope * T + f * (H_r - H) - e * SIGMA * (T**4 - T_sur**4)
        change = excess / max(slope + f * dH - df * (H_r - H) + 4.0 * e * SIGMA * T**3, 0.3 * slope)
        T += change
        if abs(change) < 1e-7:
            break
    return T, f * (H_r - H)


@njit(cache=True, error_model="numpy")
def _boil(T, step, water, moisture, source):
    """Water leaves above its boiling point; a share of the vapour condenses on the coldest node further in."""
    latent, boil, width, tau, inward = moisture
    for i in range(len(T)):
        if water[i] <= 0.0 or T[i] <= boil:
            continue
        gone = min(water[i], water[i] / tau * min((T[i] - boil) / width, 1.0) * step)
        water[i] -= gone
        source[i] -= latent * gone / step
        if inward > 0.0 and T[-1] < boil - width:
            for j in range(i + 1, len(T)):
                if T[j] < boil - width:
                    water[j] += inward * gone
                    source[j] += inward * latent * gone / step
                    break


@njit(cache=True, error_model="numpy")
def _march(
    dt,
    T,
    dx,
    layer,
    capacity,
    log_ps,
    ks,
    eps,
    back,
    T_sur,
    film,
    H_r,
    log_p,
    eps_factor,
    hot,
    hot_share,
    H_w,
    deposit,
    diverted,
    water,
    moisture,
    added,
    side,
    wall_step,
    kept,
    out,
):
    n, m = len(T), len(dx)
    before, ahead = T.copy(), T.copy()
    C, g, a, b, source = np.empty(n), np.empty(m), np.empty(n), np.empty(n), np.empty(n)
    pressures, rows = np.empty(len(log_ps)), np.empty(len(log_ps), np.int64)
    wet, flux, start = moisture[0] > 0.0 and water.sum() > 0.0, 0.0, T[n - 1]
    for q in range(len(kept)):
        out[0, q] = T[kept[q]]
    for step in range(1, len(film)):
        first = step == 1
        w = (1.0 if first else 1.5) / dt
        for i in range(n):
            ahead[i] = T[i] if first else 2.0 * T[i] - before[i]
            C[i] = 0.0
            source[i] = deposit[i] * flux - side[i] * (ahead[i] - start)
        source[0] += added[step]
        if wet:
            _boil(T, dt, water, moisture, source)
        for q in range(len(log_ps)):
            row = 0
            while row < log_ps.shape[1] - 2 and log_p[step] > log_ps[q, row + 1]:
                row += 1
            rows[q], pressures[q] = row, 0.0
            if log_ps.shape[1] > 1:
                s = (log_p[step] - log_ps[q, row]) / (log_ps[q, row + 1] - log_ps[q, row])
                pressures[q] = min(max(s, 0.0), 1.0)
        for e in range(m):
            q = layer[e]
            if q < 0:
                g[e] = 1.0 / dx[e]
                continue
            i, s = _place(0.5 * (ahead[e] + ahead[e + 1]), 60.0, 4.0, ks.shape[2])
            r, u = rows[q], pressures[q]
            k = ks[q, r, i] + s * (ks[q, r, i + 1] - ks[q, r, i])
            if u > 0.0:
                k += u * (ks[q, r + 1, i] + s * (ks[q, r + 1, i + 1] - ks[q, r + 1, i]) - k)
            g[e] = k / dx[e]
            for j in (e, e + 1):
                i, s = _place(ahead[j], 60.0, 4.0, capacity.shape[1])
                C[j] += 0.5 * dx[e] * (capacity[q, i] + s * (capacity[q, i + 1] - capacity[q, i]))
        T_b = ahead[n - 1]
        lost = back[0]
        if back[3] > 0.0:
            lost *= (max(abs(T_b - back[1]), 1e-6) / 10.0) ** back[3]
        lost += back[2] * SIGMA * (T_b * T_b + back[1] * back[1]) * (T_b + back[1])
        for i in range(n - 1, 0, -1):
            old = T[i] if first else 2.0 * T[i] - 0.5 * before[i]
            diagonal, right = w * C[i] + g[i - 1], C[i] * old / dt + source[i]
            if i == n - 1:
                diagonal += lost
                right += lost * back[1]
            else:
                diagonal += g[i] * (1.0 - b[i + 1])
                right += g[i] * a[i + 1]
            a[i], b[i] = right / diagonal, g[i - 1] / diagonal
        old = T[0] if first else 2.0 * T[0] - 0.5 * before[0]
        constant = C[0] * old / dt + source[0] + g[0] * a[1]
        slope = w * C[0] + g[0] * (1.0 - b[1])
        T_0, flux = _surface(
            max(ahead[0], 80.0),
            film[step] * (1.0 - diverted),
            H_r[step],
            eps,
            eps_factor[step],
            T_sur,
            hot,
            hot_share[step],
            H_w,
            wall_step,
            constant,
            slope,
        )
        outer = T_0
        for i in range(n):
            new = T_0 if i == 0 else a[i] + b[i] * outer
            before[i], T[i] = T[i], new
            outer = new
        for q in range(len(kept)):
            out[step, q] = T[kept[q]]
