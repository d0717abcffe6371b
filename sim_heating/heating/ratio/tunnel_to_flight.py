"""Heating ratios from the wind tunnel to flight: laminar, turbulent and transitional flow.

A ratio is measured at one flow state on a model, h / h_ref on the model's own reference sphere. In flight it is

    r_flight = r_tunnel * Theta(flight) / Theta(tunnel)

with the theoretical ratio Theta the film coefficient of Eckert's flat plate, at the local pressure and edge speed of a
windward surface, over that of Fay and Riddell's sphere:

    Theta_laminar   ~ Re_L^0     both are proportional to Re^-1/2: real-gas and edge properties remain
    Theta_turbulent ~ Re_L^0.3   Re^-1/5 over the laminar Re^-1/2 of the sphere

Transitional flow is a blend by intermittency,

    r = r_laminar (1 + gamma (f - 1)),   gamma = 1 / (1 + exp(-(log10_re - onset) / width)),

with f turbulent over laminar theory. The blend is divided out of the tunnel's ratio and applied in flight with the
flight's onset.
A film coefficient goes with the enthalpy that its flux was divided by. Where the flight table is to be reduced with the
enthalpy of an edge, H_r (heating/reference/recovery.py), a ratio that the tunnel reduced with H is multiplied there by

    (H - H_w) / (H_aw - H_w),    H_aw = H_0 - (1 - r) u_e^2/2,  r by intermittency from Pr^1/2 to Pr^1/3

before it is scaled, and by (H_aw - H_w) / (H_r - H_w) of the flight state after it; the latter is 1 where H_r is that
of the regime.
A node of the flight table at log10_re takes the tunnel's ratio at the same Reynolds number, or at the nearest one that
the tunnel reached.

Assumptions: model and vehicle are similar and the reference sphere is scaled with them; modified Newtonian pressure and
edge speed V cos(angle) in both; equilibrium air and a fully catalytic wall in flight; one wall temperature each; where
a ratio stays reduced with the total enthalpy, the change of H_0 - H_w over H_aw - H_w (7 to 10 %) is neglected.
Sigma, as a fraction of the ratio, grows in quadrature by `method_sigma` (the method as such), by `correction_sigma`
times the logarithm of the correction, and for transitional flow by the effect of `onset_sigma` decades of both onsets.

Valid for attached windward flow. Leeside and impingement regions have no better theory; choose their method_sigma
accordingly. Equations: docs/theory/equations.md, equations 10 to 14;
docs/theory/equations_reference_heating.md, equations 19 and 20.
Sources: Eckert, Trans. ASME 78 (1956) 1273; Fay & Riddell, J. Aero. Sci. 25 (1958) 73; that wind-tunnel data must be
scaled, transitional flow above all: Hodge, Phillips & Audley, NASA CP-2283 (1983). The method is engineering practice.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.files import Declared, LocatedError
from sim_heating.base.kernels.axis import cells_of
from sim_heating.heating.atmosphere import sutherland_kernel
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.reference.flat_plate import eckert_kernel, windward_edge_kernel
from sim_heating.heating.reference.gas import air_kernel
from sim_heating.heating.reference.models import total_enthalpy_kernel
from sim_heating.heating.reference.recovery import NO_INCIDENCE, Recovery, SurfaceRecovery, point_recovery_kernel
from sim_heating.heating.reference.stagnation import COLD_WALL_K, NO_LEWIS, fay_riddell_kernel

ALPHA, LOG10_RE = 0, 2
"""Axes of a ratio table."""

SHALLOWEST_DEG = 3.0
"""Smallest surface angle [deg]: at grazing incidence Newtonian pressure vanishes and the real one does not."""

REFERENCE = "fay-riddell"


def surface_angle_deg(angle_deg: float) -> float:
    """Angle of a surface against the flow [deg] within the limits of the theory, 3 to 89.

    angle_deg : angle of the surface [deg]
    Source: docs/theory/equations.md, equation 10; below 3 deg Newtonian pressure vanishes, at 90 deg the edge speed.
    """
    return min(max(angle_deg, SHALLOWEST_DEG), 89.0)


class FlowState(Declared):
    """A free stream and the body in it; its density follows from the Reynolds number on `length_m`.

    velocity_m_s, T_inf_K   : free-stream speed [m/s] and temperature [K]
    wall_K                  : wall temperature [K]
    length_m, nose_radius_m : reference length of model or vehicle, radius of the reference sphere [m]
    recovery                : enthalpy that the ratio is reduced with in this state; the total one where absent
    """

    quantities: ClassVar = {"velocity_m_s": "flight_speed_m_s", "T_inf_K": "stream_K"}

    velocity_m_s: float = Field(gt=0.0, description="free-stream speed in m/s")
    T_inf_K: float = Field(gt=0.0, description="free-stream temperature in K")
    wall_K: float = Field(gt=0.0, description="wall temperature in K")
    length_m: float = Field(gt=0.0, description="reference length of model or vehicle in m")
    nose_radius_m: float = Field(gt=0.0, description="radius of the reference sphere, scaled with the model, in m")
    recovery: SurfaceRecovery | None = Field(default=None, description="enthalpy that the ratio is reduced with")

    def density(self, log10_re: float) -> float:
        """Free-stream density rho = Re mu(T_inf) / (V L) [kg/m3] at a Reynolds number.

        log10_re : log10 of the Reynolds number on `length_m` [-];  mu is Sutherland's law
        Source: docs/theory/equations_reference_heating.md, equations 2 and 3.
        """
        return 10.0**log10_re * sutherland_kernel(self.T_inf_K) / (self.velocity_m_s * self.length_m)

    def log10_re(self, rho_kg_m3: float) -> float:
        """log10 of the Reynolds number on `length_m` [-], the inverse of `density`.

        rho_kg_m3 : free-stream density [kg/m3]
        Source: docs/theory/equations_reference_heating.md, equations 2 and 3.
        """
        return math.log10(rho_kg_m3 / self.density(0.0))


class Transition(Declared):
    """Transition at one place on the body: onset and width in log10 of the free-stream Reynolds number.

    onset_log10_re : where the intermittency is 0.5 [-], Reynolds number on the body length
    width          : scale of the logistic rise [-], decades
    """

    onset_log10_re: float
    width: float = Field(gt=0.0, description="decades, above 0")

    def intermittency(self, log10_re: float) -> float:
        """Turbulent fraction gamma = 1 / (1 + exp(-(log10_re - onset) / width)) [-], 0.5 at the onset.

        log10_re : log10 of the free-stream Reynolds number on the body [-]
        Source: docs/theory/equations.md, equation 11; the logistic form is a choice.
        """
        return 1.0 / (1.0 + math.exp(-(log10_re - self.onset_log10_re) / self.width))


class Scaling(Declared):
    """How a ratio table is scaled from the wind tunnel to flight, and the uncertainty of the scaling.

    regime            : laminar, turbulent or transitional; the last needs both transitions
    x_over_L          : running length over reference length [-]
    inclination_deg   : added to alpha for the angle of the local surface [deg]
    fixed_angle_deg   : angle of the local surface where it does not follow alpha (impingement, leeside) [deg]
    tunnel, flight    : the two flow states
    method_sigma      : relative sigma of the method as such [-]
    correction_sigma  : relative sigma per unit of the logarithm of the correction [-]
    onset_sigma       : sigma of both onsets of transition, decades of Reynolds number [-]
    raises            : LocatedError where a transition is missing, or given in another regime
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
        """Angle of the local surface against the flow [deg], limited to 3 to 89.

        alpha_deg : angle of attack [deg]; without effect where `fixed_angle_deg` is given
        """
        fixed = self.fixed_angle_deg
        return surface_angle_deg(alpha_deg + self.inclination_deg if fixed is None else fixed)

    def intermittencies(self, tunnel_log10_re: float, flight_log10_re: float) -> tuple[float, float]:
        """Turbulent fraction [-] of the boundary layer in the tunnel and in flight; 0 or 1 in one regime.

        tunnel_log10_re, flight_log10_re : log10 of the free-stream Reynolds numbers [-]
        Source: docs/theory/equations.md, equation 11.
        """
        if self.tunnel_transition is None or self.flight_transition is None:
            return (1.0, 1.0) if self.regime == "turbulent" else (0.0, 0.0)
        tunnel, flight = self.tunnel_transition, self.flight_transition
        return tunnel.intermittency(tunnel_log10_re), flight.intermittency(flight_log10_re)


def theoretical_ratio(state: FlowState, log10_re: float, angle_deg: float, x_over_L: float, turbulent: bool) -> float:
    """Flat-plate film coefficient on a windward surface over that of the reference sphere [-].

    state     : flow state of tunnel or flight
    log10_re  : log10 of the free-stream Reynolds number on `state.length_m` [-]
    angle_deg : angle of the local surface against the flow [deg], 0 to 90
    x_over_L  : running length over reference length [-];  turbulent : turbulent plate, else laminar
    Diverging-flow factors are included; the sphere has the cold wall (300 K) that defines the reference heating.
    Source: docs/theory/equations.md, equation 10 (Eckert 1956; Fay and Riddell 1958).
    """
    rho, V, T = state.density(log10_re), state.velocity_m_s, state.T_inf_K
    plate = eckert_kernel(rho, V, T, angle_deg, x_over_L * state.length_m, state.wall_K, turbulent, True)
    return plate / fay_riddell_kernel(rho, V, T, state.nose_radius_m, COLD_WALL_K, NO_LEWIS)


def driving_enthalpy(
    state: FlowState, log10_re: float, angle_deg: float, recovery: SurfaceRecovery | None, intermittency: float = 0.0
) -> float:
    """Recovery less wall enthalpy, H - H_w [J/kg], that a flux in a flow state is divided by for a film coefficient.

    state         : flow state of tunnel or flight
    log10_re      : log10 of the free-stream Reynolds number on `state.length_m` [-]
    angle_deg     : angle of the local surface against the flow [deg], 0 to 90
    recovery      : a key of RECOVERIES; None for the adiabatic wall of the boundary layer as it is
    intermittency : turbulent fraction of that boundary layer [-]
    raises        : InputError where the wall is hotter than the adiabatic wall
    Source: docs/theory/equations_reference_heating.md, equations 19 and 20.
    """
    rho, V, T = state.density(log10_re), state.velocity_m_s, state.T_inf_K
    p_e, _, _ = windward_edge_kernel(rho, V, T, angle_deg)
    H_w, H_0 = air_kernel(state.wall_K, p_e)[0], total_enthalpy_kernel(V, T)
    kind: SurfaceRecovery = "edge-laminar" if recovery is None else recovery
    H, rise, _ = point_recovery_kernel(H_0, V, angle_deg, 0.0, 0.0, Recovery(kind).parameters(), 0, NO_INCIDENCE)
    driving = H - H_w if recovery is not None else H + intermittency * rise - H_w
    if driving <= 0.0:
        raise InputError(
            f"[scaling]: a wall of {state.wall_K:g} K is hotter than the adiabatic wall at {V:g} m/s and {T:g} K, and "
            "a film coefficient has no meaning; correct wall_K or velocity_m_s"
        )
    return float(driving)


def scale_table(table: RatioTable, scaling: Scaling, log10_re: FloatArray | None = None) -> RatioTable:
    """Scale a heating-ratio table measured in a wind tunnel to flight.

    table    : ratio [-] over Fay and Riddell's sphere, log10_re on the model's length
    scaling  : flow states, place, regime and uncertainties
    log10_re : nodes of the flight table [-], increasing; those of the tunnel where absent
    returns  : table of ratio and sigma [-] at the same alpha, beta and deflections; its header states the assumptions
    raises   : InputError where the table is over another reference, reduced with another recovery enthalpy than the
               tunnel state names, or states no sigma
    Reynolds numbers beyond the tunnel's take its nearest ratio, scaled from there.
    Source: docs/theory/equations.md, equations 10 to 12.
    """
    if table.sigma is None:
        raise InputError("ratio table: has no column `sigma`, to which scaling adds; give one")
    if table.reference not in (None, REFERENCE):
        raise InputError(f"ratio table: is over `{table.reference}`; scaling takes ratios over `{REFERENCE}`")
    reduced = scaling.tunnel.recovery or "total"
    if (differs := table.recovery_problem(reduced, REFERENCE)) is not None:
        raise InputError(f"ratio table: {differs} of [scaling.tunnel]")
    nodes = table.axes[LOG10_RE] if log10_re is None else np.asarray(log10_re, dtype=float)
    # No extrapolation of the measured trend: beyond the tunnel's Reynolds numbers theory alone carries it.
    at_tunnel = np.clip(nodes, table.axes[LOG10_RE][0], table.axes[LOG10_RE][-1])
    factor, added = _corrections(scaling, table.axes[ALPHA], at_tunnel, nodes)
    shape = (factor.shape[0], 1, factor.shape[1], 1, 1)
    ratio = _at_log10_re(table.ratio, table.axes[LOG10_RE], at_tunnel)
    ratio = ratio * factor.reshape(shape)
    # A common factor: the tunnel's relative sigma is carried over unchanged.
    measured = _at_log10_re(table.sigma, table.axes[LOG10_RE], at_tunnel) * factor.reshape(shape)
    sigma = np.hypot(measured, added.reshape(shape) * ratio)
    axes = (*table.axes[:LOG10_RE], nodes, *table.axes[LOG10_RE + 1 :])
    return replace(table, axes=axes, ratio=ratio, sigma=sigma, header=_header(table, scaling, added))


def _corrections(
    scaling: Scaling, alpha_deg: FloatArray, at_tunnel: FloatArray, nodes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(alpha, log10_re) factor on the ratio [-], and sigma added as a fraction of it [-]."""
    factor, added = np.empty((len(alpha_deg), len(nodes))), np.empty((len(alpha_deg), len(nodes)))
    for i, j in product(range(len(alpha_deg)), range(len(nodes))):
        factor[i, j], added[i, j] = correction(scaling, float(alpha_deg[i]), float(at_tunnel[j]), float(nodes[j]))
    return factor, added


def correction(
    scaling: Scaling, alpha_deg: float, tunnel_log10_re: float, flight_log10_re: float
) -> tuple[float, float]:
    """Factor [-] on a ratio from one tunnel state to one flight state, and the relative sigma [-] that it adds.

    alpha_deg        : angle of attack [deg], the same in both
    tunnel_log10_re, flight_log10_re : log10 of the free-stream Reynolds numbers [-]
    returns          : Theta(flight) / Theta(tunnel), with the transitional blend where both onsets are given, and with
                       the recovery enthalpies of both states where that of flight is an edge's; sigma
    Source: docs/theory/equations.md, equations 10 to 12; docs/theory/equations_reference_heating.md, equation 20.
    """
    angle = scaling.angle_deg(alpha_deg)
    ends = ((scaling.tunnel, tunnel_log10_re), (scaling.flight, flight_log10_re))
    laminar = [theoretical_ratio(s, re, angle, scaling.x_over_L, False) for s, re in ends]
    turbulent = [theoretical_ratio(s, re, angle, scaling.x_over_L, True) for s, re in ends]
    # Independent errors of the method, of both onsets and of the size of the correction, added in quadrature below.
    steps = [scaling.method_sigma]
    if scaling.tunnel_transition is None or scaling.flight_transition is None:
        low, high = turbulent if scaling.regime == "turbulent" else laminar
        factor = high / low
    else:
        ends_of_transition = (scaling.tunnel_transition, scaling.flight_transition)
        blends = [
            _blend(t, re, f / lam, scaling.onset_sigma)
            for t, (_, re), f, lam in zip(ends_of_transition, ends, turbulent, laminar, strict=True)
        ]
        factor = laminar[1] / laminar[0] * blends[1][0] / blends[0][0]
        steps += [blend[1] for blend in blends]
    steps.append(scaling.correction_sigma * math.log(factor))
    # Exact where the edge is; its uncertainty is that of the method.
    return factor * _enthalpy_factor(scaling, angle, tunnel_log10_re, flight_log10_re), math.hypot(*steps)


def _enthalpy_factor(scaling: Scaling, angle_deg: float, tunnel_log10_re: float, flight_log10_re: float) -> float:
    """Factor [-] on a ratio for the enthalpies that it is reduced with in tunnel and flight (equation 20)."""
    if {scaling.tunnel.recovery or "total", scaling.flight.recovery or "total"} == {"total"}:
        return 1.0
    ends = ((scaling.tunnel, tunnel_log10_re), (scaling.flight, flight_log10_re))
    gammas = scaling.intermittencies(tunnel_log10_re, flight_log10_re)
    tunnel, flight = (
        driving_enthalpy(state, re, angle_deg, state.recovery or "total")
        / driving_enthalpy(state, re, angle_deg, None, gamma)
        for (state, re), gamma in zip(ends, gammas, strict=True)
    )
    return tunnel / flight


def _blend(transition: Transition, log10_re: float, f: float, onset_sigma: float) -> tuple[float, float]:
    """Transitional over laminar ratio, 1 + gamma (f - 1) [-], and its relative sigma for an uncertain onset.

    The change of gamma over +-onset_sigma is halved rather than differentiated: a narrow transition is nearly a step.
    """
    blend = 1.0 + transition.intermittency(log10_re) * (f - 1.0)
    spread = transition.intermittency(log10_re + onset_sigma) - transition.intermittency(log10_re - onset_sigma)
    return blend, 0.5 * spread * abs(f - 1.0) / blend


def _at_log10_re(values: FloatArray, axis: FloatArray, nodes: FloatArray) -> FloatArray:
    """Values of a ratio-table array linear in log10_re, at nodes inside the axis."""
    if len(axis) == 1:
        return np.repeat(values, len(nodes), axis=LOG10_RE)
    i = cells_of(axis, nodes)
    w = ((nodes - axis[i]) / (axis[i + 1] - axis[i])).reshape(1, 1, -1, 1, 1)
    return np.take(values, i, LOG10_RE) * (1.0 - w) + np.take(values, i + 1, LOG10_RE) * w


def _header(table: RatioTable, scaling: Scaling, added: FloatArray) -> dict[str, str]:
    """Header of the table with the assumptions of the scaling added."""
    angle = "alpha" if scaling.fixed_angle_deg is None else f"{scaling.fixed_angle_deg:g} deg"
    assumptions = (
        f"{scaling.regime}, tunnel {_state_text(scaling.tunnel)} to flight {_state_text(scaling.flight)}, "
        f"at x/L {scaling.x_over_L:g}, surface at {angle}"
    )
    ends = (("tunnel", scaling.tunnel_transition), ("flight", scaling.flight_transition))
    onsets = [f"{name} {t.onset_log10_re:g} (width {t.width:g})" for name, t in ends if t is not None]
    header = {**table.header, "reference": REFERENCE, "scaled": assumptions}
    if scaling.flight.recovery is not None or table.recovery is not None:
        header["recovery"] = scaling.flight.recovery or "total"
    if onsets:
        header["scaled_onset_log10_re"] = ", ".join(onsets) + f", each +-{scaling.onset_sigma:g}"
    return header | {"scaled_sigma_added": f"{added.min():.3f} to {added.max():.3f} of the ratio, in quadrature"}


def _state_text(state: FlowState) -> str:
    return f"{state.velocity_m_s:g} m/s {state.T_inf_K:g} K wall {state.wall_K:g} K length {state.length_m:g} m"


def windward_trend(alpha_deg: FloatArray) -> FloatArray:
    """Laminar windward film coefficient against alpha, up to a constant: sin(alpha) sqrt(cos(alpha)) [-].

    alpha_deg : angle of attack [deg], any shape; angles below 3 deg count as 3
    returns   : trend [-], in that shape

    From h ~ sqrt(p_e u_e) with Newtonian p_e ~ sin^2 and u_e ~ cos. Within 5 % of the flat plate with real gas between
    25 and 40 deg; for continuing a table downward, not for making one. Derived in docs/theory/equations.md,
    equation 13.
    """
    angle = np.radians(np.maximum(np.asarray(alpha_deg, dtype=float), SHALLOWEST_DEG))
    return np.sin(angle) * np.sqrt(np.cos(angle))


def deflection_factor(alpha_deg: FloatArray, deflection_deg: FloatArray, pressure_exponent: float) -> FloatArray:
    """Film coefficient of a deflected windward surface over that of the undeflected one [-].

        (sin^2(alpha + deflection) / sin^2(alpha))^n,  n = 0.5 laminar, 0.8 turbulent

    alpha_deg, deflection_deg : angle of attack and deflection [deg], shapes that broadcast
    pressure_exponent         : n [-]
    Attached flow, no separation ahead of the hinge; angles below 3 deg count as 3. h ~ p^n is the flat plate at given
    edge speed. Derived in docs/theory/equations.md, equation 14.
    """
    flat = np.radians(np.maximum(np.asarray(alpha_deg, dtype=float), SHALLOWEST_DEG))
    turned = np.radians(np.maximum(np.asarray(alpha_deg, dtype=float) + deflection_deg, SHALLOWEST_DEG))
    return (np.sin(turned) / np.sin(flat)) ** (2.0 * pressure_exponent)
