"""What the exact sensitivities along the mean flight say of the peaks' scatter, to first order.

    T_peak = T_mean + sum_k s_k z_k,      variance sum_k s_k^2,      quantile T_mean + z_q sqrt(variance)

s_k [K] is the sensitivity of a peak times the standard deviation of input k. Of thermal parameters and effects it is
exact (linear_march.py), at the time of the peak; of what changes the flight, and of the modes of ratio tables, a
central difference of flights DIFFERENCE standard deviations to either side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from sim_heating.conditions import FloatArray
from sim_heating.layout import LANES, TIME
from sim_heating.linear_march import LinearMarch, Track
from sim_heating.planning.dispersed_entry import AXES, DIFFERENCE, Batch, DispersedEntry
from sim_heating.planning.dispersed_flight import fly_many
from sim_heating.planning.dispersed_march import QUANTITIES
from sim_heating.planning.sampling import axis_rows, deviations

NEAR = 0.1
"""Part of the scatter that a first-order quantile may lie beside the counted one, where it is outside its bounds."""


@dataclass(frozen=True)
class FirstOrder:
    """Peaks of the mean flight and their sensitivities.

    mean  : (quantity, point) [K]
    slope : (quantity, point, dimension) K per standard deviation
    """

    mean: FloatArray
    slope: FloatArray

    @property
    def sigma(self) -> FloatArray:
        """(quantity, point) [K]."""
        return np.asarray(np.sqrt(np.sum(self.slope**2, axis=-1)))

    def quantile(self, q: float) -> FloatArray:
        """(quantity, point) [K]."""
        return np.asarray(self.mean + norm.ppf(q) * self.sigma)

    def share(self, columns: list[int]) -> FloatArray:
        """(quantity, point) share of the variance that some dimensions bring."""
        whole = np.maximum(np.sum(self.slope**2, axis=-1), 1e-30)
        return np.asarray(np.sum(self.slope[..., columns] ** 2, axis=-1) / whole)


def axis_batches(entry: DispersedEntry, size: int) -> list[Batch]:
    """The flights that differences are taken of."""
    count = 2 * entry.dimensions + 1
    return [Batch(AXES, first, min(first + size, count)) for first in range(0, count, size)]


def first_order(entry: DispersedEntry, columns: dict[str, FloatArray]) -> FirstOrder:
    """From the results of `axis_batches`, put together by column."""
    names = [p.point.name for p in entry.points]
    T = np.array([[columns[f"{quantity}.{n}"] for n in names] for quantity in QUANTITIES])
    d = entry.dimensions
    z = axis_rows(d, DIFFERENCE, 0, 2 * d + 1)
    moved = np.column_stack([deviations(entry.inputs, z[:, : len(entry.inputs)]), z[:, len(entry.inputs) :]])
    k = np.arange(d)
    apart = moved[2 * k + 1, k] - moved[2 * k + 2, k]
    scale = np.array([*(i.standard_deviation for i in entry.inputs), *np.ones(d - len(entry.inputs))])
    slope = (T[..., 1::2] - T[..., 2::2]) / apart * scale
    for quantity, point, column, exact in exact_slopes(entry):
        slope[quantity, point, column] = exact * scale[column]
    return FirstOrder(T[..., 0], slope)


def exact_slopes(entry: DispersedEntry) -> list[tuple[int, int, int, float]]:
    """(quantity, point, input, dT_peak / d input) of every thermal parameter and effect, along the mean flight."""
    mean = deviations(entry.inputs, np.zeros((1, entry.dimensions)))
    flown = fly_many(entry.fleet, entry.inputs, [entry.of_flight(mean[0])] * LANES)
    kept: list[tuple[FloatArray, FloatArray]] = []
    entry.march(flown, np.repeat(mean, LANES, axis=0), np.zeros((LANES, entry.dimensions)), kept)
    own = [[(k, i.name) for k, i in enumerate(entry.inputs) if _acts(entry, k, p)] for p in range(len(entry.points))]
    named = [p for p, names in enumerate(own) if names]
    found = []
    for first in range(0, len(named), LANES):
        chosen = named[first : first + LANES]
        tracks = [_track(entry, p, own[p], mean[0], *kept[p], flight) for flight, p in enumerate(chosen)]
        time_s = kept[chosen[0]][1][0, :, TIME]
        marched = LinearMarch(tracks, time_s, np.array([kept[p][1][0] for p in chosen])).march()
        for p, track, result in zip(chosen, tracks, marched, strict=True):
            at = np.searchsorted(track.sample_s, _peak_times(*kept[p]))
            for quantity, sample in enumerate(at):
                slopes = result.sensitivity[quantity, sample]
                found += [(quantity, p, k, float(s)) for (k, _), s in zip(own[p], slopes, strict=True)]
    return found


def _track(
    entry: DispersedEntry, p: int, own: list[tuple[int, str]], mean: FloatArray, marched: FloatArray,
    conditions: FloatArray, flight: int,
) -> Track:  # fmt: skip
    """A point along the mean flight, read at its surface and bondline when they are hottest."""
    model, mesh = entry.lanes.models[p], entry.meshes[p]
    moved = model.altered({name: model.value(name) + mean[k] for k, name in own})
    times = np.unique(_peak_times(marched, conditions))
    return Track(moved, mesh, tuple(name for _, name in own), times, (0, mesh.bondline), flight=flight)


def _peak_times(marched: FloatArray, conditions: FloatArray) -> FloatArray:
    """When surface and bondline of the first lane are hottest [s]."""
    return conditions[0, np.argmax(marched[:, : len(QUANTITIES)], axis=0), TIME]


def _acts(entry: DispersedEntry, k: int, point: int) -> bool:
    return any(p == point for p, _, _ in entry.places[k])
