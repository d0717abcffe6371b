"""Trajectory shared by the studies of the tests: an entry of the Orbiter in three degrees of freedom."""

from __future__ import annotations


def entry_3dof(stop: str, sample_s: float = 1.0, altitude_m: float = 121920.0, velocity_m_s: float = 7450.0) -> str:
    """[trajectory] of a study: from entry interface, or another altitude [m] and speed [m/s], to a `stop` such as `mach
    = 2.5`."""
    return f"""[trajectory]
source = "entry-3dof"
sample_s = {sample_s}
[trajectory.initial]
altitude_m = {altitude_m}
velocity_m_s = {velocity_m_s}
gamma_deg = -1.2
heading_deg = 60.0
latitude_deg = -10.0
longitude_deg = 170.0
[trajectory.stop]
{stop}
"""
