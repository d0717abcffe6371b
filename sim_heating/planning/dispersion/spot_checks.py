"""Some flights of a dispersion again in six degrees of freedom: what the point mass leaves out, in kelvin.

The same entry, deviations and guidance are flown by JSBSim and marched as `run` marches a flight. Factors on CN and CA
are no numbers of an entry, so that these flights have none, on both sides; parameters of points and tables are nominal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import RunError
from sim_heating.base.kernels.block import LANES
from sim_heating.inputs.points import conditions_at_point
from sim_heating.march.history import march_points
from sim_heating.planning.dispersion.entry import DispersedEntry
from sim_heating.planning.dispersion.flight import dispersed, fly_many
from sim_heating.planning.dispersion.march import QUANTITIES
from sim_heating.planning.dispersion.statistics import deviations
from sim_heating.planning.soak import soaked
from sim_heating.trajectory.jsbsim import entry as jsbsim

RATE_HZ, SAMPLE_S = 60.0, 1.0
FACTORS = ("aero.CN", "aero.CA")


@dataclass(frozen=True)
class SpotChecks:
    """Peaks in six degrees of freedom less those of the point mass, (flight, quantity, point) [K]; NaN where either
    flight did not come to its end."""

    apart_K: FloatArray

    @property
    def largest_K(self) -> FloatArray:
        """(quantity, point) of all flights that came to their end."""
        whole = self.apart_K[~np.any(np.isnan(self.apart_K), axis=(1, 2))]
        return np.asarray(np.max(np.abs(whole), axis=0)) if len(whole) else np.full(self.apart_K.shape[1:], np.nan)


def fly_twice(entry: DispersedEntry, rows: FloatArray) -> dict[str, FloatArray]:
    """Peaks of flights with both sources, by column: `six.` and `three.`."""
    names = [p.point.name for p in entry.points]
    columns: dict[str, list[float]] = {}
    for row in deviations(entry.inputs, rows):
        changes = {name: value for name, value in entry.of_flight(row).items() if name not in FACTORS}
        for source, peaks in (("six", _six_dof(entry, changes)), ("three", _point_mass(entry, changes))):
            for quantity, values in zip(QUANTITIES, peaks, strict=True):
                for name, value in zip(names, values, strict=True):
                    columns.setdefault(f"{source}.{quantity}.{name}", []).append(float(value))
    return {name: np.array(values) for name, values in columns.items()}


def told_apart(entry: DispersedEntry, columns: dict[str, FloatArray]) -> SpotChecks:
    """From the columns of `fly_twice`."""
    six, three = (
        np.array([[columns[f"{source}.{q}.{p.point.name}"] for p in entry.points] for q in QUANTITIES])
        for source in ("six", "three")
    )
    return SpotChecks(np.moveaxis(six - three, 2, 0))


def _point_mass(entry: DispersedEntry, changes: dict[str, float]) -> FloatArray:
    found = entry.lanes.march(fly_many(entry.fleet, entry.inputs, [changes] * LANES), 0, [], [None] * len(entry.points))
    return np.array([found.surface_K[0], found.bondline_K[0]])


def _six_dof(entry: DispersedEntry, changes: dict[str, float]) -> FloatArray:
    vehicle, soak_s = entry.study.vehicle, entry.study.declared.soak_s
    spec = dispersed(entry.fleet.base, entry.inputs, changes)
    spec = spec.model_copy(update={"source": "jsbsim", "rate_hz": RATE_HZ, "sample_s": SAMPLE_S})
    try:
        flown = jsbsim.fly(spec, vehicle).conditions
    except RunError:
        return np.full((len(QUANTITIES), len(entry.points)), np.nan)
    points = [p.point for p in entry.points]
    flights = [soaked(conditions_at_point(vehicle, p, flown), p, soak_s) for p in points]
    marched = march_points(entry.lanes.models, flights)
    return np.array([[np.max(h.surface_K) for h in marched], [np.max(h.bondline_K) for h in marched]])
