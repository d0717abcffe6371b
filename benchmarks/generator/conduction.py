"""Temperatures of a layered wall: finite volumes in temperature, second-order backward differences in time.

    rho c dT/dt = d/dx (k(T, p) dT/dx) + s,     separate cells on either side of every interface and sensor
    (3 T_n+1 - 4 T_n + T_n-1) / (2 dt),         properties at 2 T_n - T_n-1, so that a step is one elimination
    r h_ref (H_r - H_w) = eps sigma (T_w^4 - T_sur^4) + 2 k_0 / dx_0 (T_w - T_0),   Newton on T_w alone

Source: section 1 of the record's format for the balance; Gear (1971) for the differences.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from benchmarks.challenge.deviation import HOT_K
from sim_heating.heating.reference.gas import wall_enthalpy_grid

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SIGMA = 5.670374419e-8
STEP_S = 0.1
"""Time step; conditions, samples and clocks are multiples of it."""

FACE_CELLS = 10
"""Cells of the outermost layer."""
BULK_CELLS = 200
"""Cells of the second layer, the smallest on its outer side."""
GRADING = 2.0
"""Natural logarithm of the largest over the smallest cell of the second layer."""
THIN_CELLS = 4
"""Cells of every other layer; ten in one above a millimetre."""

LOG10_P = np.arange(0.0, 6.01, 0.25)
WALL_K = np.arange(0.0, 3001.0, 50.0)
"""Where the enthalpy of air at the wall is tabulated: at the nodes of the table it comes from, which is exact."""


@dataclass(frozen=True)
class Wall:
    """A wall on its mesh, ready to march.

    dx_m, layer  : (cell,)
    contact      : (cell,) resistance at the inner face of a cell [m2 K/W]
    rho          : (layer,) density
    c_T, c       : (layer, node) specific heat, padded with its last value
    k_T, k       : (layer, node) and (layer, pressure, node) conductivity on log10 pressures LOG10_K
    k_log_p      : (layer, pressure)
    eps_T, eps   : emissivity of the outermost layer
    back         : h [W/(m2 K)], T [K], emissivity, exponent of the film coefficient in |T - T_back| / 10 K
    """

    dx_m: FloatArray
    layer: IntArray
    contact: FloatArray
    rho: FloatArray
    c_T: FloatArray
    c: FloatArray
    k_T: FloatArray
    k_log_p: FloatArray
    k: FloatArray
    eps_T: FloatArray
    eps: FloatArray
    back: FloatArray
    surroundings_K: float

    @property
    def faces_m(self) -> FloatArray:
        """(cell + 1,) depths of the faces of the cells."""
        return np.concatenate(([0.0], np.cumsum(self.dx_m)))

    @property
    def centres_m(self) -> FloatArray:
        """(cell,) depths of the middles of the cells."""
        return self.faces_m[:-1] + 0.5 * self.dx_m

    def face(self, depth_m: float) -> int:
        """Number of the face at a depth."""
        faces = self.faces_m
        found = int(np.argmin(np.abs(faces - depth_m)))
        assert abs(faces[found] - depth_m) < 1e-9, "a sensor sits on a face"
        return found


@dataclass
class Forcing:
    """Boundary conditions of a wall, on the steps of the march, and the sources of an effect in depth.

    film, H_r, p            : (time,) r h_ref, recovery enthalpy, surface pressure
    eps_factor              : (time,) on the declared emissivity
    hot                     : the ratio times 1 + hot(T_w), tabulated on HOT_K
    deposit, deposited      : (cell,) share of the deposited flux [1]; share of the convective flux that is deposited
    diverted                : share of the deposit that the surface does not receive
    water, moisture         : (cell,) [kg/m3]; latent heat [J/kg], boiling and width [K], time [s], condensing share
    """

    film: FloatArray
    H_r: FloatArray
    p: FloatArray
    eps_factor: FloatArray
    hot: FloatArray
    deposit: FloatArray
    deposited: float
    diverted: float
    water: FloatArray
    moisture: FloatArray


def build_wall(
    stack: Mapping[str, Any],
    materials: Mapping[str, Mapping[str, Any]],
    depths_m: Sequence[float],
    back: Sequence[float] | None = None,
    refine: float = 1.0,
) -> Wall:
    """The wall of a record's [stack] and [materials], a face at each depth.

    back   : film coefficient, temperature, emissivity and exponent in place of the declared back face
    refine : on the number of cells
    """
    layers = stack["layer"]
    chosen = [materials[entry["material"]] for entry in layers]
    faces = _faces([entry["thickness_m"] for entry in layers], depths_m, refine)
    dx = np.concatenate([np.diff(f) for f in faces])
    layer = np.repeat(np.arange(len(layers)), [len(f) - 1 for f in faces])
    contact = np.zeros(len(dx))
    contact[np.flatnonzero(np.diff(layer))] = [entry.get("contact_m2K_W", 0.0) for entry in layers[:-1]]
    c_T, c = _padded([np.array(m["specific_heat_J_kgK"]) for m in chosen])
    k_T, k_log_p, k = _padded_conductivity([m["conductivity_W_mK"] for m in chosen])
    eps = np.array(chosen[0]["emissivity"])
    return Wall(
        dx_m=dx,
        layer=layer,
        contact=contact,
        rho=np.array([m["density_kg_m3"] for m in chosen]),
        c_T=c_T,
        c=c,
        k_T=k_T,
        k_log_p=k_log_p,
        k=k,
        eps_T=np.ascontiguousarray(eps[:, 0]),
        eps=np.ascontiguousarray(eps[:, 1]),
        back=np.array(_declared_back(stack["back"]) if back is None else back, dtype=float),
        surroundings_K=float(stack["surroundings_K"]),
    )


def _declared_back(back: Any) -> list[float]:
    if back == "adiabatic":
        return [0.0, 0.0, 0.0, 0.0]
    return [back["h_W_m2K"], back["T_K"], back["emissivity"], 0.0]


def _faces(thickness_m: Sequence[float], depths_m: Sequence[float], refine: float) -> list[FloatArray]:
    """Depths of the cell faces, layer by layer; all are shifted smoothly so that one meets each sensor."""
    found, outer = [], 0.0
    for i, thickness in enumerate(thickness_m):
        cells = FACE_CELLS if i == 0 else BULK_CELLS if i == 1 else 10 if thickness > 1e-3 else THIN_CELLS
        cells = max(round(refine * cells), 3)
        s = np.linspace(0.0, 1.0, cells + 1)
        faces = outer + thickness * (np.expm1(GRADING * s) / np.expm1(GRADING) if i == 1 else s)
        inside = sorted(depth for depth in depths_m if faces[0] + 1e-9 < depth < faces[-1] - 1e-9)
        found.append(_warped(faces, inside))
        outer += thickness
    return found


def _warped(faces: FloatArray, depths_m: Sequence[float]) -> FloatArray:
    """Faces shifted smoothly, the two ends kept, so that a separate face lies at each of the increasing depths."""
    last = len(faces) - 1
    numbers = [0]
    for i, depth in enumerate(depths_m):
        nearest = int(np.argmin(np.abs(faces - depth)))
        numbers.append(min(max(nearest, numbers[-1] + 1), last - len(depths_m) + i))
    numbers.append(last)
    targets = np.array([faces[0], *depths_m, faces[-1]])
    warped = np.asarray(PchipInterpolator(faces[numbers], targets)(faces))
    warped[numbers] = targets
    return warped


def _padded(tables: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Tables [[T, value], ...] as two arrays of one length; padding lies beyond every temperature."""
    length = max(len(t) for t in tables) + 1
    T, value = np.empty((len(tables), length)), np.empty((len(tables), length))
    for i, table in enumerate(tables):
        T[i, : len(table)], value[i, : len(table)] = table[:, 0], table[:, 1]
        T[i, len(table) :] = 1e6 + np.arange(length - len(table))
        value[i, len(table) :] = table[-1, 1]
    return T, value


def _padded_conductivity(declared: Sequence[Any]) -> tuple[FloatArray, FloatArray, FloatArray]:
    by_pressure = [
        (np.array(k["p_Pa"]), np.array(k["T_K"]), np.array(k["k"]).T)
        if isinstance(k, Mapping)
        else (np.array([1.0]), np.array(k)[:, 0], np.array(k)[np.newaxis, :, 1])
        for k in declared
    ]
    pressures = max(len(p) for p, _, _ in by_pressure)
    nodes = max(len(T) for _, T, _ in by_pressure) + 1
    log_p = np.empty((len(declared), pressures))
    T_K, k_W_mK = np.empty((len(declared), nodes)), np.empty((len(declared), pressures, nodes))
    for i, (p, T, k) in enumerate(by_pressure):
        log_p[i] = np.concatenate((np.log10(p), 100.0 + np.arange(pressures - len(p))))
        T_K[i] = np.concatenate((T, 1e6 + np.arange(nodes - len(T))))
        k_W_mK[i] = np.pad(k, ((0, pressures - len(p)), (0, nodes - len(T))), mode="edge")
    return T_K, log_p, k_W_mK


def wall_enthalpy(declared: Mapping[str, float] | str) -> FloatArray:
    """(pressure, temperature) enthalpy of air at the wall on LOG10_P and WALL_K; zero at 0 K."""
    grid = wall_enthalpy_grid(declared, WALL_K[1:], 10.0**LOG10_P).T
    return np.ascontiguousarray(np.pad(grid, ((0, 0), (1, 0))))


def march(
    wall: Wall, forcing: Forcing, H_w: FloatArray, start_K: float | FloatArray, faces: Sequence[int], dt: float = STEP_S
) -> FloatArray:
    """(time, surface | faces) temperatures [K] at the steps of the forcing, from a temperature or one a cell."""
    T = np.full(len(wall.dx_m), start_K) if np.ndim(start_K) == 0 else np.array(start_K, dtype=float)
    out = np.empty((len(forcing.film), 1 + len(faces)))
    _march(
        dt, T, wall.dx_m, wall.layer, wall.contact, wall.rho, wall.c_T, wall.c, wall.k_T, wall.k_log_p, wall.k,
        wall.eps_T, wall.eps, wall.back, wall.surroundings_K, H_w, forcing.film, forcing.H_r, forcing.p,
        forcing.eps_factor, HOT_K, forcing.hot, forcing.deposit,
        forcing.deposited, forcing.diverted, forcing.water.copy(), forcing.moisture,
        np.array(faces, dtype=np.int64), out,
    )  # fmt: skip
    return out


@njit(cache=True, error_model="numpy")
def _line(x, y, at, hint):
    """Value of a table, constant beyond its ends, and the interval it was found in; the search begins at the hint."""
    last = len(x) - 2
    i = min(hint, last)
    while i < last and at > x[i + 1]:
        i += 1
    while i > 0 and at < x[i]:
        i -= 1
    if last < 0 or at <= x[0]:
        return y[0], 0
    s = min((at - x[i]) / (x[i + 1] - x[i]), 1.0)
    return y[i] + s * (y[i + 1] - y[i]), i


@njit(cache=True, error_model="numpy")
def _enthalpy_at(H_w, log_p, T):
    """Enthalpy of air at the wall and its slope."""
    a = min(max(4.0 * log_p, 0.0), len(H_w) - 1.0)
    i = min(int(a), len(H_w) - 2)
    b = min(max(T / 50.0, 0.0), H_w.shape[1] - 1.0)
    j = min(int(b), H_w.shape[1] - 2)
    low = (1.0 - a + i) * H_w[i, j] + (a - i) * H_w[i + 1, j]
    high = (1.0 - a + i) * H_w[i, j + 1] + (a - i) * H_w[i + 1, j + 1]
    return low + (b - j) * (high - low), (high - low) / 50.0


@njit(cache=True, error_model="numpy")
def _wall_temperature(guess, film, H_r, log_p, H_w, eps_T, eps, eps_factor, T_sur, hot_T, hot, G, T_in):
    """T_w that closes the balance with conduction G (T_w - T_in) inward."""
    T = guess
    for _ in range(30):
        H, dH = _enthalpy_at(H_w, log_p, T)
        e, _i = _line(eps_T, eps, T, 0)
        rise, _i = _line(hot_T, hot, T, 0)
        ahead, _i = _line(hot_T, hot, T + 0.01, 0)
        f = film * (1.0 + rise)
        df = film * (ahead - rise) / 0.01
        e *= eps_factor
        excess = f * (H_r - H) - e * SIGMA * (T**4 - T_sur**4) - G * (T - T_in)
        slope = df * (H_r - H) - f * dH - 4.0 * e * SIGMA * T**3 - G
        change = -excess / min(slope, -0.1 * G)
        T += change
        if abs(change) < 1e-7:
            break
    return T


@njit(cache=True, error_model="numpy")
def _moisture_sources(T, dx, dt, water, moisture, source):
    """Water leaves above its boiling point; a share of the vapour moves inward and condenses where it is cold."""
    latent, boil, width, tau, condensing = moisture
    for i in range(len(T)):
        if water[i] <= 0.0 or T[i] <= boil:
            continue
        rate = water[i] * min((T[i] - boil) / width, 1.0) / tau
        water[i] -= rate * dt
        source[i] -= latent * rate * dx[i]
        for j in range(i + 1, len(T)):
            if T[j] < boil - 5.0:
                water[j] += condensing * rate * dt * dx[i] / dx[j]
                source[j] += latent * condensing * rate * dx[i]
                break


@njit(cache=True, error_model="numpy")
def _march(
    dt, T, dx, layer, contact, rho, c_T, c_table, k_T, k_log_p, k_table, eps_T, eps, back, T_sur, H_w,
    film, H_r, p, eps_factor, hot_T, hot, deposit, deposited, diverted, water, moisture, faces, out,
):  # fmt: skip
    n, layers = len(T), len(rho)
    before, ahead = T.copy(), T.copy()
    capacity, k, conductance = np.empty(n), np.empty(n), np.empty(n)
    a, b, source = np.empty(n), np.empty(n), np.zeros(n)
    c_hint, k_hint = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    column = np.empty((layers, k_T.shape[1]))
    T_w = T[0]
    T_w_before = T_w
    out[0, :] = T[0]
    for m in range(len(faces)):
        out[0, 1 + m] = 0.5 * (T[max(faces[m] - 1, 0)] + T[min(faces[m], n - 1)])
    for step in range(1, len(film)):
        first = step == 1
        w0 = 1.0 if first else 1.5
        log_p = np.log10(max(p[step], 1e-3))
        for m in range(layers):
            for j in range(k_T.shape[1]):
                column[m, j], _ = _line(k_log_p[m], k_table[m, :, j], log_p, 0)
        for i in range(n):
            m = layer[i]
            ahead[i] = T[i] if first else 2.0 * T[i] - before[i]
            c, c_hint[i] = _line(c_T[m], c_table[m], ahead[i], c_hint[i])
            k[i], k_hint[i] = _line(k_T[m], column[m], ahead[i], k_hint[i])
            capacity[i] = rho[m] * c * dx[i] / dt
            source[i] = 0.0
        for i in range(n - 1):
            conductance[i] = 1.0 / (0.5 * dx[i] / k[i] + contact[i] + 0.5 * dx[i + 1] / k[i + 1])
        guess = T_w if first else 2.0 * T_w - T_w_before
        if deposited != 0.0:
            flux = film[step] * (H_r[step] - _enthalpy_at(H_w, log_p, guess)[0])
            for i in range(n):
                source[i] += deposited * flux * deposit[i]
        if moisture[0] != 0.0:
            _moisture_sources(ahead, dx, dt, water, moisture, source)
        half = 2.0 * k[n - 1] / dx[n - 1]
        difference = ahead[n - 1] - back[1]
        lost = back[0] * (abs(difference) / 10.0) ** back[3] if back[3] != 0.0 else back[0]
        lost += back[2] * SIGMA * (ahead[n - 1] ** 2 + back[1] ** 2) * (ahead[n - 1] + back[1])
        lost = lost * half / (lost + half)
        # T_i = a_i + b_i T_i-1, from the inside out; the outermost cell hangs on the wall temperature.
        for i in range(n - 1, -1, -1):
            known = T[i] if first else 2.0 * T[i] - 0.5 * before[i]
            outward = conductance[i - 1] if i > 0 else 2.0 * k[0] / dx[0]
            diagonal = w0 * capacity[i] + outward
            right = capacity[i] * known + source[i]
            if i == n - 1:
                diagonal += lost
                right += lost * back[1]
            else:
                diagonal += conductance[i] * (1.0 - b[i + 1])
                right += conductance[i] * a[i + 1]
            a[i], b[i] = right / diagonal, outward / diagonal
        G = 2.0 * k[0] / dx[0]
        T_w_before = T_w
        T_w = _wall_temperature(
            guess, film[step] * (1.0 - deposited * diverted), H_r[step], log_p, H_w, eps_T, eps,
            eps_factor[step], T_sur, hot_T, hot, G * (1.0 - b[0]), a[0] / (1.0 - b[0]),
        )  # fmt: skip
        outer = T_w
        for i in range(n):
            before[i] = T[i]
            T[i] = a[i] + b[i] * outer
            outer = T[i]
        out[step, 0] = T_w
        for m in range(len(faces)):
            j = faces[m]
            # Outer side of a contact resistance; without one the two sides are one.
            flux = conductance[j - 1] * (T[j - 1] - T[j])
            out[step, 1 + m] = T[j - 1] - 0.5 * flux * dx[j - 1] / k[j - 1]
