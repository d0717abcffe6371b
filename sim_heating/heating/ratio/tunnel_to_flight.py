"""Heating ratios from the wind tunnel to flight: laminar, turbulent and transitional flow.

A ratio is measured at one flow state on a model, h / h_ref on the model's own reference sphere. In flight it is

    r_flight = r_tunnel * theory(flight) / theory(tunnel)

with theory the film coefficient of Eckert's flat plate, at the local pressure and edge speed of a windward surface,
over that of Fay and Riddell's sphere:

    theory_laminar   ~ Re_L^0     both go with Re^-1/2: real-gas and edge properties remain
    theory_turbulent ~ Re_L^0.3   Re^-1/5 over the laminar Re^-1/2 of the sphere

Transitional flow is a blend by intermittency,

    r = r_laminar (1 + gamma (f - 1)),   gamma = 1 / (1 + exp(-(log10_re - onset) / width)),

with f turbulent over laminar theory; it is divided out in the tunnel and put back in flight with an onset of its own.
A node of the flight table at log10_re takes the tunnel's ratio at the same Reynolds number, or at the nearest one that
the tunnel reached.

Assumptions: model and vehicle are similar and the reference sphere is scaled with them; modified Newtonian pressure and
edge speed V cos(angle) in both; equilibrium air and a fully catalytic wall in flight; one wall temperature each.
Sigma, as a fraction of the ratio, grows in quadrature by `method_sigma` (the method as such), by `correction_sigma`
times the logarithm of the correction, and for transitional flow by what `onset_sigma` decades of both onsets are worth.

Holds for attached windward flow. Leeside and impingement regions have no better theory; let their method_sigma say so.
Sources: Eckert, Trans. ASME 78 (1956) 1273; Fay & Riddell, J. Aero. Sci. 25 (1958) 73; that wind-tunnel data must be
scaled, transitional flow above all: Hodge, Phillips & Audley, NASA CP-2283 (1983). The method is engineering practice.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.files import Declared, LocatedError
from sim_heating.heating.atmosphere import sutherland_kernel
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.reference.flat_plate import eckert_kernel
from sim_heating.heating.reference.stagnation import COLD_WALL_K, NO_LEWIS, fay_riddell_kernel

ALPHA, LOG10_RE = 0, 2
"""Axes of a ratio table."""

SHALLOWEST_DEG = 3.0
"""Newtonian pressure vanishes at grazing incidence and the real one does not: smaller angles count as this one."""

REFERENCE = "fay-riddell"


class FlowState(Declared):
    """A free stream and the body in it; its density follows from the Reynolds number on `length_m`."""

    velocity_m_s: float = Field(gt=0.0, description="free-stream speed in m/s")
    T_inf_K: float = Field(gt=0.0, description="free-stream temperature in K")
    wall_K: float = Field(gt=0.0, description="wall temperature in K")
    length_m: float = Field(gt=0.0, description="reference length of model or vehicle in m")
    nose_radius_m: float = Field(gt=0.0, description="radius of the reference sphere, scaled with the model, in m")

    def density(self, log10_re: float) -> float:
        """Free-stream density [kg/m3] at a Reynolds number."""
        return 10.0**log10_re * sutherland_kernel(self.T_inf_K) / (self.velocity_m_s * self.length_m)


class Transition(Declared):
    """Onset of transition at the place in question, as log10 of the free-stream Reynolds number on the body."""

    onset_log10_re: float
    width: float = Field(gt=0.0, description="decades, above 0")

    def intermittency(self, log10_re: float) -> float:
        """Turbulent fraction, 0.5 at the onset."""
        return 1.0 / (1.0 + math.exp(-(log10_re - self.onset_log10_re) / self.width))


class Scaling(Declared):
    """How a table goes from the wind tunnel to flight, and what that is worth.

    x_over_L         : running length over reference length
    inclination_deg  : added to alpha for the angle of the local surface
    fixed_angle_deg  : angle of the local surface where it does not follow alpha (impingement, leeside)
    """

    regime: Literal["laminar", "turbulent", "transitional"]
    x_over_L: float = Field(gt=0.0, description="running length over reference length, above 0")
    inclination_deg: float = 0.0
    fixed_angle_deg: float | None = Field(default=None, gt=0.0, lt=90.0)
    tunnel: FlowState
    flight: FlowState
    tunnel_transition: Transition | None = None
    flight_transition: Transition | None = None
    method_sigma: float = Field(ge=0.0, description="fraction of the ratio: 0.05 laminar, 0.1 turbulent")
    correction_sigma: float = Field(default=0.3, ge=0.0, description="fraction of the logarithm of the correction")
    onset_sigma: float = Field(default=0.15, ge=0.0, description="decades of Reynolds number")

    @model_validator(mode="after")
    def _check(self) -> Scaling:
        for key in ("tunnel_transition", "flight_transition"):
            if (getattr(self, key) is None) == (self.regime == "transitional"):
                rule = "needs" if self.regime == "transitional" else "has no"
                raise LocatedError((("regime",), f'"{self.regime}" {rule} `{key}`'))
        return self

    def angle_deg(self, alpha_deg: float) -> float:
        """Angle of the local surface against the flow."""
        angle = alpha_deg + self.inclination_deg if self.fixed_angle_deg is None else self.fixed_angle_deg
        return min(max(angle, SHALLOWEST_DEG), 89.0)


def theory(state: FlowState, log10_re: float, angle_deg: float, x_over_L: float, turbulent: bool) -> float:
    """Flat-plate film coefficient on a windward surface over that of the reference sphere [-].

    log10_re : of the free stream on `state.length_m`;  angle_deg : local surface against the flow, 0 to 90
    Diverging-flow factors are in; the sphere has the cold wall that defines the reference heating.
    """
    rho, V, T = state.density(log10_re), state.velocity_m_s, state.T_inf_K
    plate = eckert_kernel(rho, V, T, angle_deg, x_over_L * state.length_m, state.wall_K, turbulent, True)
    return plate / fay_riddell_kernel(rho, V, T, state.nose_radius_m, COLD_WALL_K, NO_LEWIS)


def scale_table(table: RatioTable, scaling: Scaling, log10_re: FloatArray | None = None) -> RatioTable:
    """A ratio table measured in a wind tunnel as one for flight.

    table    : over Fay and Riddell's sphere, log10_re on the model's length
    log10_re : nodes of the flight table, increasing; those of the tunnel where absent
    returns  : ratio and sigma at the same alpha, beta and deflections; its header tells what was assumed
    raises   : InputError where the table is over another reference or states no sigma
    """
    if table.sigma is None:
        raise InputError("ratio table: there is no sigma to add to; give the column `sigma`")
    if table.reference not in (None, REFERENCE):
        raise InputError(f"ratio table: is over `{table.reference}`; scaling takes ratios over `{REFERENCE}`")
    nodes = table.axes[LOG10_RE] if log10_re is None else np.asarray(log10_re, dtype=float)
    at_tunnel = np.clip(nodes, table.axes[LOG10_RE][0], table.axes[LOG10_RE][-1])
    factor, added = _corrections(scaling, table.axes[ALPHA], at_tunnel, nodes)
    shape = (factor.shape[0], 1, factor.shape[1], 1, 1)
    ratio = _at_nodes(table.ratio, table.axes[LOG10_RE], at_tunnel)
    ratio = ratio * factor.reshape(shape)
    measured = _at_nodes(table.sigma, table.axes[LOG10_RE], at_tunnel) * factor.reshape(shape)
    sigma = np.hypot(measured, added.reshape(shape) * ratio)
    axes = (*table.axes[:LOG10_RE], nodes, *table.axes[LOG10_RE + 1 :])
    return replace(table, axes=axes, ratio=ratio, sigma=sigma, header=_header(table, scaling, added))


def _corrections(
    scaling: Scaling, alpha_deg: FloatArray, at_tunnel: FloatArray, nodes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(alpha, log10_re) factor on the ratio, and sigma added as a fraction of it."""
    factor, added = np.empty((len(alpha_deg), len(nodes))), np.empty((len(alpha_deg), len(nodes)))
    for i, j in product(range(len(alpha_deg)), range(len(nodes))):
        factor[i, j], added[i, j] = correction(scaling, float(alpha_deg[i]), float(at_tunnel[j]), float(nodes[j]))
    return factor, added


def correction(
    scaling: Scaling, alpha_deg: float, tunnel_log10_re: float, flight_log10_re: float
) -> tuple[float, float]:
    """Factor on a ratio from one tunnel state to one flight state, and the sigma it adds as a fraction of the ratio."""
    angle = scaling.angle_deg(alpha_deg)
    ends = ((scaling.tunnel, tunnel_log10_re), (scaling.flight, flight_log10_re))
    laminar = [theory(s, re, angle, scaling.x_over_L, False) for s, re in ends]
    turbulent = [theory(s, re, angle, scaling.x_over_L, True) for s, re in ends]
    steps = [scaling.method_sigma]
    if scaling.tunnel_transition is None or scaling.flight_transition is None:
        low, high = turbulent if scaling.regime == "turbulent" else laminar
        factor = high / low
    else:
        ends_of_transition = (scaling.tunnel_transition, scaling.flight_transition)
        parts = [
            _blend(t, re, f / lam, scaling.onset_sigma)
            for t, (_, re), f, lam in zip(ends_of_transition, ends, turbulent, laminar, strict=True)
        ]
        factor = laminar[1] / laminar[0] * parts[1][0] / parts[0][0]
        steps += [part[1] for part in parts]
    steps.append(scaling.correction_sigma * math.log(factor))
    return factor, math.hypot(*steps)


def _blend(transition: Transition, log10_re: float, f: float, onset_sigma: float) -> tuple[float, float]:
    """Transitional over laminar ratio, 1 + gamma (f - 1), and its relative sigma for an uncertain onset.

    The change of gamma over +-onset_sigma is halved rather than differentiated: a narrow transition is nearly a step.
    """
    blend = 1.0 + transition.intermittency(log10_re) * (f - 1.0)
    spread = transition.intermittency(log10_re + onset_sigma) - transition.intermittency(log10_re - onset_sigma)
    return blend, 0.5 * spread * abs(f - 1.0) / blend


def _at_nodes(values: FloatArray, axis: FloatArray, nodes: FloatArray) -> FloatArray:
    """Values linear in log10_re, at nodes inside the axis."""
    if len(axis) == 1:
        return np.repeat(values, len(nodes), axis=LOG10_RE)
    i = np.clip(np.searchsorted(axis, nodes, side="right") - 1, 0, len(axis) - 2)
    w = ((nodes - axis[i]) / (axis[i + 1] - axis[i])).reshape(1, 1, -1, 1, 1)
    return np.take(values, i, LOG10_RE) * (1.0 - w) + np.take(values, i + 1, LOG10_RE) * w


def _header(table: RatioTable, scaling: Scaling, added: FloatArray) -> dict[str, str]:
    """The table's header with what was assumed."""
    angle = "alpha" if scaling.fixed_angle_deg is None else f"{scaling.fixed_angle_deg:g} deg"
    told = (
        f"{scaling.regime}, tunnel {_told(scaling.tunnel)} to flight {_told(scaling.flight)}, "
        f"at x/L {scaling.x_over_L:g}, surface at {angle}"
    )
    ends = (("tunnel", scaling.tunnel_transition), ("flight", scaling.flight_transition))
    onsets = [f"{name} {t.onset_log10_re:g} (width {t.width:g})" for name, t in ends if t is not None]
    header = {**table.header, "reference": REFERENCE, "scaled": told}
    if onsets:
        header["scaled_onset_log10_re"] = ", ".join(onsets) + f", each +-{scaling.onset_sigma:g}"
    return header | {"scaled_sigma_added": f"{added.min():.3f} to {added.max():.3f} of the ratio, in quadrature"}


def _told(state: FlowState) -> str:
    return f"{state.velocity_m_s:g} m/s {state.T_inf_K:g} K wall {state.wall_K:g} K length {state.length_m:g} m"


def windward_trend(alpha_deg: FloatArray) -> FloatArray:
    """Laminar windward film coefficient against alpha, up to a constant: sin(alpha) sqrt(cos(alpha)).

    From h ~ sqrt(p_e u_e) with Newtonian p_e ~ sin^2 and u_e ~ cos; angles below 3 deg count as 3. Within 5 % of the
    flat plate with real gas between 25 and 40 deg; for continuing a table downward, not for making one.
    """
    angle = np.radians(np.maximum(np.asarray(alpha_deg, dtype=float), SHALLOWEST_DEG))
    return np.sin(angle) * np.sqrt(np.cos(angle))


def deflection_factor(alpha_deg: FloatArray, deflection_deg: FloatArray, pressure_exponent: float) -> FloatArray:
    """Film coefficient of a deflected windward surface over that of the undeflected one.

        (sin^2(alpha + deflection) / sin^2(alpha))^n,  n = 0.5 laminar, 0.8 turbulent

    Attached flow, no separation ahead of the hinge; angles below 3 deg count as 3. h ~ p^n is the flat plate at given
    edge speed.
    """
    flat = np.radians(np.maximum(np.asarray(alpha_deg, dtype=float), SHALLOWEST_DEG))
    turned = np.radians(np.maximum(np.asarray(alpha_deg, dtype=float) + deflection_deg, SHALLOWEST_DEG))
    return (np.sin(turned) / np.sin(flat)) ** (2.0 * pressure_exponent)
