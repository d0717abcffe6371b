"""Own laminar boundary layers in equilibrium air, solved as ordinary differential equations of similarity.

Properties are those of Cantera and of the published transport data of `tools.gas_table` at each state, not the
package's table; no correlation enters. Lees and Dorodnitsyn's variables, unit Lewis number, so that the flux is that of
the enthalpy with the frozen Prandtl number:

    (C f'')' + f f'' + beta (rho_e/rho - f'^2) = 0
    (C/Pr h')' + f h' + C u_e^2 f''^2 = 0,         C = rho mu / (rho_e mu_e)
    d eta/dy = rho (2 du_e/dx / (rho_e mu_e))^1/2,  beta = 1/2, u_e = 0     at the stagnation point of a sphere
    d eta/dy = rho (du_e/dx / (rho_e mu_e))^1/2,    beta = 1, u_e = 0       on the stagnation line of a cylinder
    d eta/dy = rho (u_e / (2 rho_e mu_e x))^1/2,    beta = 0                on a flat plate

On the stagnation line of a swept cylinder the spanwise speed w_e g joins with (C g')' + f g' = 0, and its friction
C w_e^2 g'^2 heats the layer in place of C u_e^2 f''^2 (Reshotko and Beckwith, NACA TR 1379, 1958).

Turbulent friction is van Driest's, a transformation of the incompressible plate's.
Source: Lees, Jet Propulsion 26 (1956) 259; Anderson, Hypersonic and High-Temperature Gas Dynamics, 6.3 to 6.5.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.integrate import solve_bvp
from scipy.interpolate import PchipInterpolator

from sim_heating.base.arrays import FloatArray
from tests.support.gas.cantera_air import Air

FAR = 8.0
"""Similarity coordinate eta [-] that counts as the edge."""
NODES = 81


@dataclass(frozen=True)
class Isobar:
    """Equilibrium air at one pressure as functions of its enthalpy above 0 K [J/kg].

    density, viscosity, prandtl : rho [kg/m3], mu [Pa s], frozen Pr [-];  enthalpy : of T [K]
    """

    density: Callable[[FloatArray], FloatArray]
    viscosity: Callable[[FloatArray], FloatArray]
    prandtl: Callable[[FloatArray], FloatArray]
    enthalpy: Callable[[float], float]


@cache
def isobar(p_Pa: float, hottest_K: float) -> Isobar:
    """Properties from 150 K to a temperature [K], 40 K apart, monotone cubics between."""
    air = Air()
    T = np.arange(150.0, hottest_K + 200.0, 40.0)
    states = [(*air.thermodynamics(t, p_Pa)[:2], air.transport(t, p_Pa)) for t in map(float, T)]
    h = np.array([state[0] for state in states])
    rho = p_Pa / (np.array([state[1] for state in states]) * 8314.462618 / 28.85064 * T)
    mu = np.array([state[2].viscosity_Pa_s for state in states])
    Pr = np.array([state[2].prandtl for state in states])
    of_T = PchipInterpolator(T, h)
    return Isobar(
        PchipInterpolator(h, rho), PchipInterpolator(h, mu), PchipInterpolator(h, Pr), lambda t: float(of_T(t))
    )


@dataclass(frozen=True)
class Layer:
    """A solved boundary layer: enthalpy at the wall [J/kg] and its flux C/Pr dh/d eta there [J/kg]."""

    h_w: float
    flux: float


def solve(
    air: Isobar, h_e: float, u_e: float, beta: float, *, h_w: float | None, prandtl: float | None = None
) -> Layer:
    """Boundary layer between an edge and a wall.

    air      : properties at the edge's pressure;  h_e, u_e : edge enthalpy [J/kg], speed [m/s] of the dissipation
    beta     : pressure-gradient parameter, 1/2 at a stagnation point, 0 on a plate
    h_w      : enthalpy at the wall [J/kg]; None for an insulated wall
    prandtl  : constant Prandtl number; None for the air's frozen one at each state
    raises   : RuntimeError where the solver does not converge
    """
    rho_e, mu_e = float(air.density(np.array(h_e))), float(air.viscosity(np.array(h_e)))

    def properties(h: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        rho = air.density(h)
        Pr = air.prandtl(h) if prandtl is None else np.full_like(h, prandtl)
        return rho_e / rho, rho * air.viscosity(h) / (rho_e * mu_e), Pr

    def slopes(eta: FloatArray, y: FloatArray) -> FloatArray:
        f, v, shear, theta, flux = y
        swelling, C, Pr = properties(theta * h_e)
        return np.array(
            [
                v,
                shear / C,
                -f * shear / C - beta * (swelling - v * v),
                flux * Pr / C,
                -f * flux * Pr / C - shear * shear / C * u_e * u_e / h_e,
            ]
        )

    def ends(a: FloatArray, b: FloatArray) -> FloatArray:
        wall = a[4] if h_w is None else a[3] - h_w / h_e
        return np.array([a[0], a[1], wall, b[1] - 1.0, b[3] - 1.0])

    eta = FAR * np.linspace(0.0, 1.0, NODES) ** 1.5
    start = h_w / h_e if h_w is not None else 1.0 + 0.42 * u_e * u_e / h_e
    rise = np.tanh(0.6 * eta)
    guess = np.array(
        [eta - rise / 0.6, rise, 0.5 * (1.0 - rise), start + (1.0 - start) * rise, (1.0 - start) * 0.5 * (1.0 - rise)]
    )
    found = solve_bvp(slopes, ends, eta, guess, tol=1e-5, max_nodes=5000)
    if not found.success:
        raise RuntimeError(f"boundary layer at h_e = {h_e:g} J/kg, u_e = {u_e:g} m/s: {found.message}")
    return Layer(float(found.y[3, 0]) * h_e, float(found.y[4, 0]) * h_e)


def stagnation_film(
    p_0: float, T_0: float, T_w_K: float, gradient_1_s: float, prandtl: float | None = None, *, plane: bool = False
) -> float:
    """Film coefficient q/(h_0 - h_w) [kg/(m2 s)] at the stagnation point of a sphere, or on that of a cylinder (plane).

    p_0, T_0 : stagnation pressure [Pa], temperature [K];  T_w_K : wall temperature [K]
    gradient_1_s : velocity gradient du_e/dx [1/s];  prandtl : constant Prandtl number; None for the frozen one of air
    """
    air = isobar(p_0, T_0)
    h_0, h_w = air.enthalpy(T_0), air.enthalpy(T_w_K)
    layer = solve(air, h_0, 0.0, 1.0 if plane else 0.5, h_w=h_w, prandtl=prandtl)
    rho_mu = float(air.density(np.array(h_0)) * air.viscosity(np.array(h_0)))
    return layer.flux * math.sqrt((1.0 if plane else 2.0) * gradient_1_s * rho_mu) / (h_0 - h_w)


@dataclass(frozen=True)
class Plate:
    """Laminar flat plate: film coefficient q/(h_aw - h_w) [kg/(m2 s)], flux q [W/m2], recovery factor [-]."""

    film: float
    flux: float
    recovery: float


def plate(p_e: float, T_e: float, u_e: float, length_m: float, T_w_K: float, prandtl: float | None = None) -> Plate:
    """Laminar boundary layer on a flat plate, parallel flow.

    p_e, T_e, u_e : edge pressure [Pa], temperature [K], speed [m/s];  length_m : from the leading edge [m]
    T_w_K         : wall temperature [K];  prandtl : constant Prandtl number; None for the frozen one of air
    """
    cold = isobar(p_e, T_e)
    kinetic = 0.5 * u_e * u_e
    # The hottest state of the layer is not above the adiabatic wall: its temperature is that of the total enthalpy.
    hottest = T_e + kinetic / 1000.0
    air = isobar(p_e, min(hottest, 11800.0))
    h_e, h_w = cold.enthalpy(T_e), air.enthalpy(T_w_K)
    insulated = solve(air, h_e, u_e, 0.0, h_w=None, prandtl=prandtl)
    layer = solve(air, h_e, u_e, 0.0, h_w=h_w, prandtl=prandtl)
    rho_mu = float(air.density(np.array(h_e)) * air.viscosity(np.array(h_e)))
    q = layer.flux * math.sqrt(rho_mu * u_e / (2.0 * length_m))
    return Plate(q / (insulated.h_w - h_w), q, (insulated.h_w - h_e) / kinetic)


@dataclass(frozen=True)
class SweptLine:
    """Stagnation line of a swept cylinder: enthalpy of the insulated wall [J/kg], flux q [W/m2], h_w [J/kg]."""

    h_aw: float
    flux: float
    h_w: float


def swept_line(
    p_0: float, T_e: float, w_e: float, T_w_K: float, gradient_1_s: float, prandtl: float | None = None
) -> SweptLine:
    """Laminar boundary layer on the stagnation line of an infinite swept cylinder.

    p_0, T_e     : pressure [Pa] and temperature [K] where the normal flow is at rest;  w_e : speed along the line [m/s]
    T_w_K        : wall temperature [K];  gradient_1_s : du_e/dx across the line [1/s]
    prandtl      : constant Prandtl number; None for the frozen one of air
    """
    air, h_e = isobar(p_0, min(T_e + 0.5 * w_e**2 / 1000.0, 11800.0)), isobar(p_0, T_e).enthalpy(T_e)
    rho_mu, h_w = float(air.density(np.array(h_e)) * air.viscosity(np.array(h_e))), air.enthalpy(T_w_K)
    q = _swept_layer(air, h_e, w_e, h_w, prandtl).flux * math.sqrt(rho_mu * gradient_1_s)
    return SweptLine(_swept_layer(air, h_e, w_e, None, prandtl).h_w, q, h_w)


def _swept_layer(air: Isobar, h_e: float, w_e: float, h_w: float | None, prandtl: float | None) -> Layer:
    """Layer as `solve` returns it, with spanwise flow w_e [m/s]; an insulated wall where h_w is None.

    raises : RuntimeError where the solver does not converge
    """
    rho_e, mu_e = float(air.density(np.array(h_e))), float(air.viscosity(np.array(h_e)))

    def slopes(eta: FloatArray, y: FloatArray) -> FloatArray:
        f, v, shear, _, spanwise, theta, flux = y
        rho = air.density(theta * h_e)
        C = rho * air.viscosity(theta * h_e) / (rho_e * mu_e)
        Pr = air.prandtl(theta * h_e) if prandtl is None else prandtl
        return np.array(
            [
                v, shear / C, -f * shear / C - (rho_e / rho - v * v), spanwise / C, -f * spanwise / C, flux * Pr / C,
                -f * flux * Pr / C - spanwise * spanwise / C * w_e * w_e / h_e,
            ]
        )  # fmt: skip

    def ends(a: FloatArray, b: FloatArray) -> FloatArray:
        wall = a[6] if h_w is None else a[5] - h_w / h_e
        return np.array([a[0], a[1], a[3], wall, b[1] - 1.0, b[3] - 1.0, b[5] - 1.0])

    eta = FAR * np.linspace(0.0, 1.0, NODES) ** 1.5
    start = h_w / h_e if h_w is not None else 1.0 + 0.42 * w_e * w_e / h_e
    rise = np.tanh(0.6 * eta)
    slope = 0.5 * (1.0 - rise)
    guess = np.array([eta - rise / 0.6, rise, slope, rise, slope, start + (1.0 - start) * rise, (1.0 - start) * slope])
    found = solve_bvp(slopes, ends, eta, guess, tol=1e-5, max_nodes=20000)
    if not found.success:
        raise RuntimeError(f"swept line at h_e = {h_e:g} J/kg, w_e = {w_e:g} m/s: {found.message}")
    return Layer(float(found.y[5, 0]) * h_e, float(found.y[6, 0]) * h_e)


def van_driest_friction(
    h_e: float, h_w: float, u_e: float, viscosity_ratio: float, re: float, recovery: float
) -> float:
    """Half the turbulent friction coefficient of a flat plate [-] by van Driest's second transformation.

        c_f/2 = 0.0296 (F_x Re)^-1/5 / F_c,   F_x = (mu_e/mu_w) / F_c,   F_c = r m / (asin alpha + asin beta)^2

    with alpha = (2 A^2 - B)/D, beta = B/D, D = (4 A^2 + B^2)^1/2, A^2 = r m/F, B = (1 + r m - F)/F.

    h_e, h_w, u_e   : edge and wall enthalpy [J/kg], edge speed [m/s]; m = u_e^2/(2 h_e) and F = h_w/h_e stand for the
                      perfect gas's 0.2 M^2 and T_w/T_e
    viscosity_ratio : mu_e/mu_w [-];  re : rho_e u_e x/mu_e [-];  recovery : factor r [-]
    Source: van Driest, Aero. Eng. Review 15 (1956) 26; form of Hopkins & Inouye, AIAA J. 9 (1971) 993.
    """
    m, F = 0.5 * recovery * u_e * u_e / h_e, h_w / h_e
    B = (1.0 + m - F) / F
    D = math.sqrt(4.0 * m / F + B * B)
    F_c = m / (math.asin((2.0 * m / F - B) / D) + math.asin(B / D)) ** 2
    return float(0.0296 * (re * viscosity_ratio / F_c) ** -0.2 / F_c)
