"""A scenario for tests to modify: a short glide of the Orbiter at 6800 m/s in three degrees of freedom."""

from __future__ import annotations

from pathlib import Path

from tests.support.paths import ORBITER


def gliding(
    seconds: float,
    *control_points: str,
    altitude_m: float = 75000.0,
    velocity_m_s: float = 6800.0,
    vehicle: str | Path = ORBITER,
) -> str:
    """Text of a scenario; more tables may be added to it, manoeuvres first."""
    names = ", ".join(f'"{name}"' for name in control_points)
    return f"""
format = "scenario/1"
title = "A glide"
vehicle = "{vehicle}"
control_points = [{names}]
[trajectory]
source = "entry-3dof"
[trajectory.initial]
altitude_m = {altitude_m}
velocity_m_s = {velocity_m_s}
gamma_deg = -0.1
heading_deg = 60.0
latitude_deg = 10.0
[trajectory.stop]
time_s = {seconds}
"""
