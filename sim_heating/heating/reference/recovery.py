"""Recovery enthalpy of a point of the surface: the enthalpy at which the flow neither heats nor cools it.

    H_r = H_0 - (1 - r) u_e^2 / 2,    u_e = V |cos(angle)|,    r = Pr^1/2 laminar, Pr^1/3 turbulent

Behind a boundary layer it is below the total enthalpy H_0 = V^2/2 + cp T_inf, by 9 % of the total at 40 deg, laminar.
A film coefficient goes with the enthalpy that its flux was divided by, q = h (H_r - H_w). The difference between two
of them depends on the wall temperature and on the speed, so that no heating ratio can stand for it.

On the attachment line of a swept leading edge the flow across the edge comes to rest, and the edge speed is the one
along it, u_e = V sin(sweep) cos(alpha).

A nose, a leeward side or a pod has no known edge: its heating ratio is reduced with the total enthalpy.
Equations: docs/theory/equations_reference_heating.md, equations 15, 18, 19 and 33a.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, NamedTuple, get_args

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels.jit import njit
from sim_heating.heating.reference.gas import PRANDTL
from sim_heating.heating.reference.stagnation import SLOWEST_M_S

SurfaceRecovery = Literal["total", "edge-laminar", "edge-turbulent"]
"""Enthalpy of a ratio that is scaled from a wind tunnel or made by theory."""
RecoveryName = Literal["total", "edge-laminar", "edge-turbulent", "attachment-line"]
"""Enthalpy that a heating ratio is reduced with, by the name that files use."""
TOTAL, EDGE_LAMINAR, EDGE_TURBULENT, ATTACHMENT_LINE = 0.0, 1.0, 2.0, 3.0
RECOVERIES: Mapping[str, float] = MappingProxyType(
    dict(zip(get_args(RecoveryName), (TOTAL, EDGE_LAMINAR, EDGE_TURBULENT, ATTACHMENT_LINE), strict=True))
)
"""Every recovery by name, with its number in the kernel."""
# Constants, for a host asks for them at every frame and point.
_LAMINAR, _TURBULENT = math.sqrt(PRANDTL), PRANDTL ** (1.0 / 3.0)
RECOVERY_WIDTH = 4
"""Length of the parameter block of a recovery: kind, local angle or sweep [deg], elevon and body-flap factor [-]."""


@dataclass(frozen=True)
class Recovery:
    """Enthalpy that the heating ratio of a point is reduced with, and the surface that its edge speed follows from.

    kind            : `total`, `edge-laminar`, `edge-turbulent` or `attachment-line`
    local_angle_deg : angle of the local surface against the vehicle's x axis [deg], added to alpha
    elevon_factor   : part of the elevon deflection that turns the surface [-]
    bodyflap_factor : part of the body-flap deflection that turns the surface [-]
    sweep_deg       : of `attachment-line`, sweep of the leading edge at alpha 0 [deg]
    """

    kind: RecoveryName = "total"
    local_angle_deg: float = 0.0
    elevon_factor: float = 0.0
    bodyflap_factor: float = 0.0
    sweep_deg: float = 0.0

    @property
    def of_surface(self) -> bool:
        """Whether it is that of the boundary layer on a surface, whose edge is known."""
        return self.kind in ("edge-laminar", "edge-turbulent")

    @property
    def needs(self) -> tuple[str, ...]:
        """Columns of the conditions that it reads ([Pa], [J/kg], [deg] ...)."""
        if self.kind == "total":
            return ()
        turned = {"elevon_deg": self.elevon_factor, "bodyflap_deg": self.bodyflap_factor}
        return ("velocity_m_s", "alpha_deg", *(name for name, factor in turned.items() if factor != 0.0))

    def parameters(self) -> FloatArray:
        """(RECOVERY_WIDTH,) block of `point_recovery_kernel`: kind, angle or sweep [deg], elevon, flap factor [-]."""
        angle_deg = self.sweep_deg if self.kind == "attachment-line" else self.local_angle_deg
        return np.array([RECOVERIES[self.kind], angle_deg, self.elevon_factor, self.bodyflap_factor])


class Incidence(NamedTuple):
    """Angle of a surface against the flow [deg], its sine and its cosine [-]."""

    angle_deg: float
    sine: float
    cosine: float


NO_INCIDENCE = Incidence(math.nan, math.nan, math.nan)
"""Before the first point."""


@njit
def incidence_at(angle_deg: float, last: Incidence) -> Incidence:
    """Sine and cosine of an angle [deg]; those of the last one where it is the same.

    Most points of a lower side have one angle, and sines of each would be a twentieth of a frame.
    The angle: docs/theory/equations.md, equation 30; docs/theory/equations_reference_heating.md, equation 19.
    """
    if angle_deg == last.angle_deg:
        return last
    angle = math.radians(angle_deg)
    return Incidence(angle_deg, math.sin(angle), math.cos(angle))


@njit
def recovery_factor(turbulent: bool) -> float:
    """Recovery factor r [-] of a boundary layer: Pr^1/3 where turbulent, Pr^1/2 where laminar; Pr = 0.71.

    Source: Eckert 1956 (Trans. ASME 78, 1273); docs/theory/equations_reference_heating.md, equation 15.
    """
    return _TURBULENT if turbulent else _LAMINAR


@njit
def edge_speed(velocity_m_s: float, angle_deg: float) -> float:
    """Speed u_e = V |cos(angle)| at the edge of the boundary layer on a flat windward surface [m/s], at least 1 m/s.

    velocity_m_s : free-stream speed [m/s];  angle_deg : angle of the surface against the flow [deg]
    Newtonian flow keeps the part of the velocity that is parallel to the surface; sideslip is not considered.
    Source: docs/theory/equations_reference_heating.md, equation 18.
    """
    return _edge_speed(velocity_m_s, math.cos(math.radians(angle_deg)))


@njit
def _edge_speed(velocity_m_s: float, cosine: float) -> float:
    # Not 0, for Re* and with it the laminar law C_h ~ Re*^-1/2 would have no value.
    return max(velocity_m_s * abs(cosine), SLOWEST_M_S)


@njit
def spanwise_speed(velocity_m_s: float, alpha_deg: float, sweep_deg: float) -> float:
    """Speed w = V sin(sweep) cos(alpha) along a leading edge [m/s].

    velocity_m_s : free-stream speed [m/s];  alpha_deg, sweep_deg : angle of attack, sweep of the edge at alpha 0 [deg]
    Source: docs/theory/equations_reference_heating.md, equation 33a.
    """
    return velocity_m_s * math.sin(math.radians(sweep_deg)) * math.cos(math.radians(alpha_deg))


@njit
def point_angle(alpha_deg: float, elevon_deg: float, bodyflap_deg: float, numbers: FloatArray, first: int) -> float:
    """Angle [deg] of the surface of a point with an edge against the flow: alpha, local angle, turned surfaces.

    alpha_deg, elevon_deg, bodyflap_deg : angle of attack and deflections [deg]
    numbers, first                      : array that holds `Recovery.parameters()` from this place on
    Source: docs/theory/equations_reference_heating.md, equation 19.
    """
    return alpha_deg + numbers[first + 1] + numbers[first + 2] * elevon_deg + numbers[first + 3] * bodyflap_deg


@njit
def point_recovery_kernel(
    total_J_kg: float,
    velocity_m_s: float,
    alpha_deg: float,
    elevon_deg: float,
    bodyflap_deg: float,
    numbers: FloatArray,
    first: int,
    incidence: Incidence,
) -> tuple[float, float, Incidence]:
    """Recovery enthalpy H_r of a point and its rise from laminar to fully turbulent flow [J/kg], and its incidence.

        H_r = H_0 - (1 - r) u_e^2/2,    rise = (Pr^1/3 - Pr^1/2) u_e^2/2 for edge-laminar, else 0
        H_r = H_0 - (1 - Pr^1/2) w^2/2 for attachment-line, w the speed along the edge

    total_J_kg                          : total enthalpy H_0 [J/kg]
    velocity_m_s                        : free-stream speed [m/s]
    alpha_deg, elevon_deg, bodyflap_deg : angle of attack and deflections [deg]
    numbers, first                      : array that holds `Recovery.parameters()` from this place on
    incidence                           : of the point before, or NO_INCIDENCE; returned where the point has no edge
    Source: docs/theory/equations_reference_heating.md, equations 15, 18, 19 and 33a.
    """
    kind = numbers[first]
    if kind == TOTAL:
        return total_J_kg, 0.0, incidence
    if kind == ATTACHMENT_LINE:
        w = spanwise_speed(velocity_m_s, alpha_deg, numbers[first + 1])
        return total_J_kg - (1.0 - recovery_factor(False)) * 0.5 * w * w, 0.0, incidence
    incidence = incidence_at(point_angle(alpha_deg, elevon_deg, bodyflap_deg, numbers, first), incidence)
    u_e = _edge_speed(velocity_m_s, incidence.cosine)
    kinetic, turbulent = 0.5 * u_e * u_e, recovery_factor(True)
    if kind == EDGE_TURBULENT:
        return total_J_kg - (1.0 - turbulent) * kinetic, 0.0, incidence
    laminar = recovery_factor(False)
    return total_J_kg - (1.0 - laminar) * kinetic, (turbulent - laminar) * kinetic, incidence


@njit
def _point_recovery_loop(
    total: FloatArray,
    V: FloatArray,
    alpha: FloatArray,
    elevon: FloatArray,
    bodyflap: FloatArray,
    numbers: FloatArray,
    H_r: FloatArray,
    rise: FloatArray,
) -> None:
    for i in range(len(total)):
        H_r[i], rise[i], _ = point_recovery_kernel(
            total[i], V[i], alpha[i], elevon[i], bodyflap[i], numbers, 0, NO_INCIDENCE
        )


def point_recovery(recovery: Recovery, total_J_kg: FloatArray, flown: Conditions) -> tuple[FloatArray, FloatArray]:
    """Recovery enthalpy of a point along a flight, and its rise from laminar to fully turbulent flow.

    recovery   : of the point
    total_J_kg : (time,) total enthalpy [J/kg]
    flown      : conditions with the columns of `recovery.needs`
    returns    : H_r (time,) and rise (time,) [J/kg]
    raises     : KeyError where one of these columns is missing
    Source: docs/theory/equations_reference_heating.md, equation 19.
    """
    H_r, rise = np.array(total_J_kg, dtype=float), np.zeros(len(flown))
    if recovery.kind == "total":
        return H_r, rise
    names = ("velocity_m_s", "alpha_deg", "elevon_deg", "bodyflap_deg")
    # Copies: to numba a read-only column is another type, for which the loop would be compiled a second time.
    columns = [np.array(flown[n], dtype=float) if n in recovery.needs else np.zeros(len(flown)) for n in names]
    V, alpha, elevon, bodyflap = columns
    _point_recovery_loop(H_r.copy(), V, alpha, elevon, bodyflap, recovery.parameters(), H_r, rise)
    return H_r, rise
