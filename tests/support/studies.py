"""What tests of studies share: an entry of the Orbiter in three degrees of freedom, and the batches of a run."""

from __future__ import annotations

from pathlib import Path

from sim_heating.base.parallel.batches import digest_path
from sim_heating.planning.plan import LEDGER


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


def pod_dispersion(title: str, flights: int, more: str = "") -> str:
    """A study of dispersed peaks at a pod tile and the wing leading edge, without errors of the ratio tables.

    more : of its [dispersion]
    """
    return f"""format = "study/1"
title = "{title}"
vehicle = "orbiter"
control_points = ["V07T9975", "WING_LE"]
{entry_3dof("velocity_m_s = 5800.0", sample_s=2.0)}[dispersion]
flights = {flights}
{more}scrambles = 2
tables = 0.0
quantiles = [0.5]
"""


def finished_batches(out: Path) -> dict[Path, int]:
    """Results in the ledger of a study that have their digest, with their times of writing.

    A kill may come between the two files: such a result is computed again.
    """
    results = [p for folder in out.glob(f"{LEDGER}/*") for p in folder.glob("*.parquet")]
    return {p: p.stat().st_mtime_ns for p in results if digest_path(p.parent, p.name).exists()}
