"""Equations of motion of a point mass over a rotating sphere, symbolic, for the optimiser.

    dh/dt   = V sin g                        dlon/dt = V cos g sin a / (r cos lat)        dlat/dt = V cos g cos a / r
    dV/dt   = -D - mu/r^2 sin g + w^2 r cos lat (sin g cos lat - cos g sin lat cos a)
    V dg/dt = L cos b + (V^2/r - mu/r^2) cos g + 2 w V cos lat sin a
              + w^2 r cos lat (cos g cos lat + sin g sin lat cos a)
    V cos g da/dt = L sin b + V^2/r cos^2 g sin a tan lat - 2 w V (sin g cos lat cos a - cos g sin lat)
                    + w^2 r sin lat cos lat sin a

g path angle, a heading from north over east, b bank (positive to the right), L and D forces over mass.
Source: Vinh, Busemann and Culp, "Hypersonic and Planetary Entry Flight Mechanics", 1980, eqs. 2-31, 2-36 (heading from
north here). With w = 0 they are those of Betts 2010, eqs. 6.1 to 6.6.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.planning.optimal.collocation import ca

ALTITUDE, LONGITUDE, LATITUDE, SPEED, GAMMA, HEADING = range(6)
"""States: m, m/s, rad."""
ALPHA, BANK = range(2)
"""Controls: deg."""
STATES = 6
"""Number of states of the motion; integrals of wall temperatures may follow them."""
SCALE = np.array([20e3, 0.5, 0.5, 3e3, 0.05, 0.5])
CONTROL_SCALE = np.array([10.0, 30.0])
"""Typical sizes of states and controls."""
LOWEST = np.array([0.0, -np.pi, -1.5, 100.0, -1.5, -2.0 * np.pi])
HIGHEST = np.array([150e3, np.pi, 1.5, 12e3, 1.5, 2.0 * np.pi])
"""Bounds of the states; those of longitude and heading count from the start."""


@dataclass(frozen=True)
class Planet:
    """A rotating sphere: radius [m], gravitational parameter [m3/s2], rotation [rad/s]."""

    radius_m: float
    mu_m3_s2: float
    rotation_rad_s: float = 0.0


def motion_rates(x: Any, lift_m_s2: Any, drag_m_s2: Any, bank_deg: Any, planet: Planet) -> list[Any]:
    """dx/dt of the six states under lift and drag over mass [m/s2] and a bank angle [deg]."""
    h, lat, V, g, a = x[ALTITUDE], x[LATITUDE], x[SPEED], x[GAMMA], x[HEADING]
    r, w = planet.radius_m + h, planet.rotation_rad_s
    gravity, b = planet.mu_m3_s2 / r**2, bank_deg * np.pi / 180.0
    sg, cg, sa, c_a, sl, cl = ca.sin(g), ca.cos(g), ca.sin(a), ca.cos(a), ca.sin(lat), ca.cos(lat)
    across = w**2 * r * cl
    lifted = lift_m_s2 * ca.cos(b) + (V**2 / r - gravity) * cg + 2.0 * w * V * cl * sa
    turned = lift_m_s2 * ca.sin(b) + V**2 / r * cg**2 * sa * sl / cl - 2.0 * w * V * (sg * cl * c_a - cg * sl)
    return [
        V * sg,
        V * cg * sa / (r * cl),
        V * cg * c_a / r,
        -drag_m_s2 - gravity * sg + across * (sg * cl - cg * sl * c_a),
        (lifted + across * (cg * cl + sg * sl * c_a)) / V,
        (turned + across * sl * sa) / (V * cg),
    ]


def cross_range_function(start: FloatArray, side: float) -> Any:
    """CasADi function x -> angle [rad] from the initial great circle, to its left (side 1) or right (side -1)."""
    lon, lat, heading = start[LONGITUDE], start[LATITUDE], start[HEADING]
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    normal = np.cross(up, np.cos(heading) * np.cross(up, east) + np.sin(heading) * east)
    x = ca.SX.sym("x", len(start))
    there = [
        ca.cos(x[LATITUDE]) * ca.cos(x[LONGITUDE]),
        ca.cos(x[LATITUDE]) * ca.sin(x[LONGITUDE]),
        ca.sin(x[LATITUDE]),
    ]
    return ca.Function(
        "cross_range", [x], [side * ca.asin(sum(float(c) * t for c, t in zip(normal, there, strict=True)))]
    )
