"""Spot checks of a dispersion: some flights repeated in six degrees of freedom, to show what the point mass omits [K].

JSBSim flies the same entry, deviations and guidance, and the flight is marched as `run` marches it. Factors on CN and
CA cannot be given to JSBSim, so these flights have none, with either source; points and tables have nominal parameters,
and the heating has no error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import RunError
from sim_heating.base.kernels.block import LANES
from sim_heating.inputs.points import conditions_behind_walls
from sim_heating.march.history import march_points
from sim_heating.planning.dispersion.entry import DispersedEntry
from sim_heating.planning.dispersion.flight import AERO_FACTORS, entry_with_deviations
from sim_heating.planning.dispersion.march import QUANTITIES
from sim_heating.planning.dispersion.statistics import deviations
from sim_heating.planning.soak import with_soak

RATE_HZ, SAMPLE_S = 60.0, 1.0
"""Frames of JSBSim a second, and interval of the conditions that are kept [s]."""
SIX_DOF, POINT_MASS = "six_dof", "point_mass"


@dataclass(frozen=True)
class SpotChecks:
    """Peaks in six degrees of freedom less those of the point mass.

    difference_K : (flight, quantity, point) [K]; NaN where either flight was not completed
    """

    difference_K: FloatArray

    @property
    def largest_K(self) -> FloatArray:
        """(quantity, point) largest magnitude over the flights that were completed [K]."""
        completed_K = self.difference_K[~np.any(np.isnan(self.difference_K), axis=(1, 2))]
        return (
            np.asarray(np.max(np.abs(completed_K), axis=0))
            if len(completed_K)
            else np.full(self.difference_K.shape[1:], np.nan)
        )


def fly_with_both_sources(entry: DispersedEntry, rows: FloatArray) -> dict[str, FloatArray]:
    """Peaks [K] of the flights of standard normal rows, by column: `six_dof.surface_K.POINT` and the like."""
    names = [p.point.name for p in entry.points]
    columns: dict[str, list[float]] = {}
    for row in deviations(entry.inputs, rows):
        # JSBSim flies the aerodynamics as they are: deviations of CN and CA are left out of both flights that are
        # compared.
        changes = {name: value for name, value in entry.flight_deviations(row).items() if name not in AERO_FACTORS}
        for source, peaks in ((SIX_DOF, _six_dof(entry, changes)), (POINT_MASS, _point_mass(entry, changes))):
            for quantity, values in zip(QUANTITIES, peaks, strict=True):
                for name, value in zip(names, values, strict=True):
                    columns.setdefault(f"{source}.{quantity}.{name}", []).append(float(value))
    return {name: np.array(values) for name, values in columns.items()}


def spot_checks(entry: DispersedEntry, columns: dict[str, FloatArray]) -> SpotChecks:
    """Compare both sources, from the columns of `fly_with_both_sources`."""
    six_dof, point_mass = (
        np.array([[columns[f"{source}.{q}.{p.point.name}"] for p in entry.points] for q in QUANTITIES])
        for source in (SIX_DOF, POINT_MASS)
    )
    return SpotChecks(np.moveaxis(six_dof - point_mass, 2, 0))


def _point_mass(entry: DispersedEntry, changes: dict[str, float]) -> FloatArray:
    """(quantity, point) peaks [K]."""
    flown = entry.sampler.fly(entry.inputs, [changes] * LANES)
    peaks = entry.lanes.march(flown, 0, [], [None] * len(entry.points))
    return np.array([peaks.surface_K[0], peaks.bondline_K[0]])


def _six_dof(entry: DispersedEntry, changes: dict[str, float]) -> FloatArray:
    """(quantity, point) peaks [K], NaN where JSBSim does not complete the flight."""
    from sim_heating.trajectory.jsbsim import entry as jsbsim  # not every platform has it

    vehicle, soak_s = entry.study.vehicle, entry.study.declared.soak_s
    spec = entry_with_deviations(entry.sampler.base, entry.inputs, changes)
    spec = spec.model_copy(update={"source": "jsbsim", "rate_hz": RATE_HZ, "sample_s": SAMPLE_S})
    try:
        flown = jsbsim.fly(spec, vehicle).conditions
    except RunError:
        return np.full((len(QUANTITIES), len(entry.points)), np.nan)
    models, points = entry.lanes.models, [p.point for p in entry.points]
    at_points = conditions_behind_walls(vehicle, points, flown, {m.name: m for m in models})
    marched = march_points(models, [with_soak(c, soak_s) for c in at_points])
    return np.array([[np.max(h.surface_K) for h in marched], [np.max(h.bondline_K) for h in marched]])
