"""A short flight of the Orbiter whose boundary layer turns turbulent, and records of a tile along it."""

from __future__ import annotations

from pathlib import Path

from sim_heating.inputs.record import Record, load_record
from sim_heating.inputs.scenario import load_scenario
from sim_heating.simulation.synthesize import synthesize, write_records

POINT = "STS96_480"
SCENARIO = f"""
format = "scenario/1"
title = "a glide through transition"
vehicle = "orbiter"
control_points = ["{POINT}"]
[trajectory]
source = "entry-3dof"
sample_s = 1.0
[trajectory.initial]
altitude_m = 53000.0
velocity_m_s = 3300.0
gamma_deg = -0.5
heading_deg = 90.0
latitude_deg = 30.0
longitude_deg = -100.0
[trajectory.stop]
altitude_m = 40000.0
velocity_m_s = 2100.0
time_s = 140.0
"""
EARLY = """
[[truth.effect]]
name = "transition"
parameters = { log10_re_onset = 2.42, factor = 1.0, by_table = 1.0, by_re_theta = 1.0 }
"""


def made(folder: Path, truth: str = "") -> Record:
    """A record of the point, written and read back."""
    (folder / "glide.toml").write_text(SCENARIO + truth)
    scenario = load_scenario(folder / "glide.toml")
    write_records(scenario, synthesize(scenario), folder / "record")
    return load_record(folder / "record")
