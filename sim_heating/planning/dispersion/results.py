"""Results of a dispersion: flights in batches, first-order estimate, statistics of the peaks, study.json and notes.

First order means the exact sensitivities along the mean flight, one standard deviation of each input at a time:

    T_peak = T_mean + sum_k s_k z_k,      variance sum_k s_k^2,      quantile T_mean + z_q sqrt(variance)

s_k [K] is the sensitivity of a peak times the standard deviation of input k. For thermal parameters and effects it is
exact (march/linearised.py), at the time of the peak; for inputs that change the flight, and for modes of ratio tables,
it is a central difference of flights DIFFERENCE standard deviations to either side. With members of a set of estimates
T_mean is their mean by weight, their scatter along the planned flight is one of the s_k, and the others are those of
the heaviest member. Slopes by the error of the heating have the variance of all its sizes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtri

from sim_heating.base.arrays import BoolArray, FloatArray, IntArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.kernels.block import LANES, TIME
from sim_heating.base.parallel.batches import Job, run_batches
from sim_heating.base.progress import Progress
from sim_heating.march.linearised import LinearMarch, Track
from sim_heating.planning.dispersion.entry import (
    AXES,
    BATCH,
    DIFFERENCE,
    INDEX,
    RANDOM,
    SOBOL,
    SPOT_CHECK,
    Batch,
    DispersedEntry,
    parquet_bytes,
)
from sim_heating.planning.dispersion.flight import COMPLETED
from sim_heating.planning.dispersion.input_checks import check_inputs
from sim_heating.planning.dispersion.march import QUANTITIES
from sim_heating.planning.dispersion.spot_checks import SpotChecks, fly_with_both_sources, spot_checks
from sim_heating.planning.dispersion.statistics import (
    Indices,
    Probability,
    Quantile,
    additive_model,
    axis_rows,
    deviations,
    indices,
    probability,
    quantiles,
)
from sim_heating.planning.members import member_data
from sim_heating.planning.study import Study

Columns = dict[str, FloatArray]
"""Results of flights by column, as DispersedEntry.fly gives them."""

FLIGHTS_FILE = "dispersion_flights.parquet"
ROW_GROUP = 64
"""Batches of a row group of the merged file."""

# Flights in batches --------------------------------------------------------------------------------------------------


def disperse(
    study: Study, ledger: Path, *, scheduler: str | None = None, workers: int | None = None, progress: Progress
) -> tuple[DispersionResult, dict[str, list[Path]]]:
    """Fly all flights of a study's dispersion and evaluate them.

    ledger  : folder for finished batches, used by this study alone
    returns : the result, and the files of the batches by their purpose (`batches_of`)
    raises  : InputError for inputs that cannot be dispersed; RunError where batches failed
    """
    entry = DispersedEntry(study)
    check_inputs(entry)
    batches = batches_of(entry)
    jobs = [Job(batch.id, batch) for some in batches.values() for batch in some]
    outcome = run_batches(
        jobs, partial(batch_results, entry), ledger, scheduler=scheduler, workers=workers, progress=progress
    )
    if outcome.failed:
        name, why = next(iter(outcome.failed.items()))
        raise RunError(
            f"{len(outcome.failed)} of {len(jobs)} batches failed, {name} first: {why}; run again to repeat them"
        )
    files = {purpose: [ledger / batch.id for batch in some] for purpose, some in batches.items()}
    return evaluate(entry, {purpose: read_columns(some) for purpose, some in files.items()}), files


def batches_of(entry: DispersedEntry) -> dict[str, list[Batch]]:
    """All batches of a dispersion by purpose: main (the statistics), axes (first order), index, spot checks."""
    spec = entry.spec
    # Several scrambles, because bounds from order statistics are exact for independent flights alone: the scatter
    # between scrambles is reported in addition.
    each = spec.flights // spec.scrambles
    main = [
        Batch(spec.sampling, first, min(first + BATCH, each), scramble)
        for scramble in range(spec.scrambles)
        for first in range(0, each, BATCH)
    ]
    index_count, axis_count = spec.index_flights * (len(entry.groups) + 2), 2 * entry.dimensions + 1
    axes, index = (
        [Batch(design, first, min(first + BATCH, count)) for first in range(0, count, BATCH)]
        for design, count in ((AXES, axis_count), (INDEX, index_count))
    )
    checks = [Batch(SPOT_CHECK, k, k + 1) for k in range(min(spec.spot_checks, each))]
    return {"main": main, "axes": axes, "index": index, "spot checks": checks}


def batch_results(entry: DispersedEntry, batch: Batch) -> bytes:
    """The results of a batch as a Parquet file: spot checks are flown with both sources, other designs as a point mass.

    A function of this module, because another process that takes part has to import it by name.
    """
    if batch.design == SPOT_CHECK:
        return parquet_bytes(fly_with_both_sources(entry, entry.rows(batch)))
    return entry(batch)


def read_columns(files: Sequence[Path]) -> Columns:
    """All columns of Parquet files, one file after the other.

    raises : InputError where a file is damaged
    """
    import pyarrow.parquet as pq

    if not files:
        return {}
    parts = []
    for path in files:
        try:
            parts.append(pq.read_table(path))
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: is damaged ({' '.join(str(error).split())}); remove it and run again") from None
    return {name: np.concatenate([p.column(name).to_numpy() for p in parts]) for name in parts[0].column_names}


def merge(files: Sequence[Path], path: Path) -> None:
    """Write the batches as one Parquet file, with a few of them in memory at a time."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    first = pq.read_table(files[0])
    with pq.ParquetWriter(path, first.schema, compression="zstd") as writer:
        for k in range(0, len(files), ROW_GROUP):
            writer.write_table(pa.concat_tables([pq.read_table(f) for f in files[k : k + ROW_GROUP]]).combine_chunks())


# First order ---------------------------------------------------------------------------------------------------------

NEAR = 0.1
"""Distance from the counted quantile, over the scatter, at which a first-order one outside its bounds still agrees."""


@dataclass(frozen=True)
class FirstOrder:
    """Peaks of the mean flight and their sensitivities.

    mean  : (quantity, point) [K]
    slope : (quantity, point, dimension) [K] per standard deviation
    """

    mean: FloatArray
    slope: FloatArray

    @property
    def sigma(self) -> FloatArray:
        """(quantity, point) standard deviation [K]."""
        return np.asarray(np.sqrt(np.sum(self.slope**2, axis=-1)))

    def quantile(self, q: float) -> FloatArray:
        """(quantity, point) quantile of a normal distribution [K]."""
        return np.asarray(self.mean + ndtri(q) * self.sigma)

    def share(self, columns: list[int]) -> FloatArray:
        """(quantity, point) share of the variance due to some dimensions [-]."""
        variance = np.maximum(np.sum(self.slope**2, axis=-1), 1e-30)
        return np.asarray(np.sum(self.slope[..., columns] ** 2, axis=-1) / variance)


def first_order(entry: DispersedEntry, columns: Columns) -> FirstOrder:
    """First-order estimate from the results of the batches of the design AXES."""
    names = [p.point.name for p in entry.points]
    T = np.array([[columns[f"{quantity}.{n}"] for n in names] for quantity in QUANTITIES])
    d, inputs = entry.dimensions, len(entry.inputs)
    z = axis_rows(d, DIFFERENCE, 0, 2 * d + 1)
    steps = np.column_stack([deviations(entry.inputs, z[:, :inputs]), z[:, inputs:]])
    k = np.arange(d)
    # The distance actually taken: a uniform input is not linear in its normal number.
    width = steps[2 * k + 1, k] - steps[2 * k + 2, k]
    scale = np.array([*(i.standard_deviation for i in entry.inputs), *np.ones(d - inputs)])
    slope = (T[..., 1::2] - T[..., 2::2]) / width * scale
    # Sensitivities of the march replace the differences wherever an input changes parameters of a point alone.
    for quantity, point, column, exact in exact_slopes(entry):
        slope[quantity, point, column] = exact * scale[column]
    for p, (error, number) in enumerate(zip(entry.errors[entry.members.heaviest], entry.columns.errors, strict=True)):
        knots = slice(number.start + 1, number.start + error.columns)
        slope[:, p, knots] = error.of_all_sizes(slope[:, p, knots])
    if not entry.members.is_drawn:
        return FirstOrder(T[..., 0], slope)
    # Which member is true does not change by steps: it counts by the scatter of the planned flight between them.
    share, planned = entry.members.shares, entry.planned_peaks
    mean = np.tensordot(share, planned, 1)
    slope[..., entry.columns.members.start] = np.sqrt(np.tensordot(share, (planned - mean) ** 2, 1))
    return FirstOrder(T[..., 0] + mean - planned[entry.members.heaviest], slope)


def exact_slopes(entry: DispersedEntry) -> list[tuple[int, int, int, float]]:
    """(quantity, point, input, dT_peak / d input) of every thermal parameter and effect, along the mean flight.

    Slopes are in [K] per unit of the input, at the time of the peak.
    """
    mean = deviations(entry.inputs, np.zeros((1, entry.dimensions)))
    flown = entry.sampler.fly(entry.inputs, [entry.flight_deviations(mean[0])] * LANES)
    marched: list[tuple[FloatArray, FloatArray]] = []
    entry.march(flown, np.repeat(mean, LANES, axis=0), np.zeros((LANES, entry.dimensions)), marched)
    changes = [_changing(entry, p) for p in range(len(entry.points))]
    changed = [p for p, names in enumerate(changes) if names]
    slopes = []
    for first in range(0, len(changed), LANES):
        chosen = changed[first : first + LANES]
        tracks = [_track(entry, p, changes[p], mean[0], marched[p], flight) for flight, p in enumerate(chosen)]
        time_s = marched[chosen[0]][1][0, :, TIME]
        results = LinearMarch(tracks, time_s, np.array([marched[p][1][0] for p in chosen])).march()
        for p, track, result in zip(chosen, tracks, results, strict=True):
            at = np.searchsorted(track.sample_s, _peak_times(*marched[p]))
            for quantity, sample in enumerate(at):
                sensitivities = result.sensitivity[quantity, sample]
                slopes += [(quantity, p, k, float(s)) for (k, _), s in zip(changes[p], sensitivities, strict=True)]
    return slopes


def _changing(entry: DispersedEntry, point: int) -> list[tuple[int, str]]:
    """Number and name of each input that changes a parameter of a point."""
    entries = enumerate(entry.marches[entry.members.heaviest].places)
    return [(k, entry.inputs[k].name) for k, some in entries if any(of_input.point == point for of_input in some)]


def _track(
    entry: DispersedEntry,
    p: int,
    changes: list[tuple[int, str]],
    mean: FloatArray,
    marched: tuple[FloatArray, FloatArray],
    flight: int,
) -> Track:
    """A point along the mean flight, read at its surface and bondline when they are hottest."""
    model, mesh = entry.lanes.models[p], entry.meshes[p]
    at_mean = model.with_parameters({name: model.value(name) + mean[k] for k, name in changes})
    times = np.unique(_peak_times(*marched))
    return Track(at_mean, mesh, tuple(name for _, name in changes), times, (0, mesh.bondline), flight=flight)


def _peak_times(temperatures: FloatArray, conditions: FloatArray) -> FloatArray:
    """Times at which surface and bondline of the first lane are hottest [s]."""
    return conditions[0, np.argmax(temperatures[:, : len(QUANTITIES)], axis=0), TIME]


# Statistics ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PeakStatistics:
    """Statistics of one peak temperature of one point.

    limit    : [K]; None where there is none
    least_K  : lowest peak of all flights [K]
    exceeded : probability of a peak above the limit; flights that were not completed count as above it
    first    : first-order mean, sigma and quantiles [K], and whether they agree with those counted
    indices  : Sobol' indices by group; None where they were not asked for or the peak is constant
    """

    point: str
    quantity: str
    mean_K: float
    sigma_K: float
    quantiles: list[Quantile]
    limit: float | None
    least_K: float
    exceeded: Probability | None
    first: dict[str, Any]
    indices: Indices | None

    @property
    def location(self) -> str:
        """Location of the peak: surface or bondline."""
        return self.quantity.removesuffix("_K")


@dataclass(frozen=True)
class RatioTableExcursion:
    """Flights that left the ratio table of a point in one variable, and the largest distance from it."""

    point: str
    variable: str
    flights: int
    farthest: float


@dataclass(frozen=True)
class DispersionResult:
    """The result of a dispersion.

    columns                : of all flights of the statistics
    peaks                  : statistics of every peak
    excursions             : flights that left a ratio table
    within_limits          : probability that a flight is completed with all peaks below their limits
    within_limits_and_data : that it also never leaves a ratio table and is trimmed all the way
    completed              : that it meets its stop
    order                  : first-order estimate;  checks : None where no flight was checked
    """

    entry: DispersedEntry
    columns: Columns
    peaks: list[PeakStatistics]
    excursions: list[RatioTableExcursion]
    within_limits: Probability
    within_limits_and_data: Probability
    completed: Probability
    order: FirstOrder
    checks: SpotChecks | None

    def __repr__(self) -> str:
        return (
            f"<DispersionResult `{self.entry.study.title}`: {self.completed.flights} flights, {len(self.peaks)} peaks, "
            f"within all limits {self.within_limits.value:.4g}>"
        )

    def values(self, peak: PeakStatistics) -> FloatArray:
        """(flight,) values of a peak [K]."""
        return self.columns[f"{peak.quantity}.{peak.point}"]


def evaluate(entry: DispersedEntry, flown: Mapping[str, Columns]) -> DispersionResult:
    """Evaluate all flights of a dispersion.

    flown  : columns by the purpose of their batches (`batches_of`)
    raises : RunError where fewer than two flights were completed
    """
    columns, index = flown["main"], flown["index"]
    batches = batches_of(entry)
    rows = {u: np.concatenate([entry.rows(b) for b in batches[u]]) for u in ("main", "index") if index}
    order = first_order(entry, flown["axes"])
    checks = spot_checks(entry, flown["spot checks"]) if flown["spot checks"] else None
    completed = columns["outcome"] == COMPLETED
    # A flight that skipped out or did not stop has no peak; it counts as above every limit.
    above = ~completed
    peaks = []
    for p, limited in enumerate(entry.points):
        for k, (quantity, limit) in enumerate(zip(QUANTITIES, (limited.surface_K, limited.bondline_K), strict=True)):
            if quantity == QUANTITIES[1] and entry.meshes[p].bondline == 0:
                continue  # the bondline of a wall of one layer is its surface
            peaks.append(_peak_statistics(entry, columns, index, rows, order, k, p, limit))
            if limit is not None and np.isfinite(limit):
                # `~(<=)`: a peak that is NaN counts as above.
                above |= ~(columns[f"{quantity}.{limited.point.name}"] <= limit)
    confidence = entry.spec.confidence
    excursions, outside = _table_excursions(entry, columns)
    # Outside a table the ratio is not known, and out of trim the angle of attack would not be flown: neither counts as
    # safe.
    unknown = above | outside | (columns["untrimmed_s"] > 0.0)
    return DispersionResult(
        entry,
        columns,
        peaks,
        excursions,
        probability(~above, confidence),
        probability(~unknown, confidence),
        probability(completed, confidence),
        order,
        checks,
    )


def _peak_statistics(
    entry: DispersedEntry,
    columns: Columns,
    index: Columns,
    rows: Mapping[str, FloatArray],
    order: FirstOrder,
    k: int,
    p: int,
    limit: float | None,
) -> PeakStatistics:
    spec, point, quantity = entry.spec, entry.points[p].point.name, QUANTITIES[k]
    x = columns[f"{quantity}.{point}"]
    finite = x[np.isfinite(x)]
    if len(finite) < 2:
        raise RunError(
            f"{len(finite)} of {len(x)} flights were completed and two are needed; check the entry and its dispersed "
            "inputs"
        )
    scrambles: IntArray = columns["scramble"].astype(np.int64)
    counted = quantiles(x, scrambles, spec.quantiles, spec.confidence)
    sigma = float(np.std(finite, ddof=1))
    limit = limit if limit is not None and np.isfinite(limit) else None
    driven = None
    if index:
        groups, z = [columns for _, columns in entry.groups], rows["index"]
        model = additive_model(rows["main"], x, order.slope[k, p])
        driven = indices(index[f"{quantity}.{point}"], groups, spec.confidence, spec.seed, z, model)
    return PeakStatistics(
        point,
        quantity,
        float(np.mean(finite)),
        sigma,
        counted,
        limit,
        float(np.min(finite)),
        None if limit is None else probability(~(x <= limit), spec.confidence),
        _compare_first_order(entry, order, k, p, counted, sigma),
        driven,
    )


def _compare_first_order(
    entry: DispersedEntry, order: FirstOrder, k: int, p: int, counted: Sequence[Quantile], sigma: float
) -> dict[str, Any]:
    """First order against the counted quantiles; it holds where each is within the counted one's bounds or near it."""
    lines = []
    for quantile in counted:
        value = float(order.quantile(quantile.q)[k, p])
        difference = None if quantile.value is None else value - quantile.value
        is_within = quantile.low is not None and quantile.high is not None and quantile.low <= value <= quantile.high
        holds = difference is not None and (is_within or abs(difference) <= NEAR * sigma)
        lines.append({"q": quantile.q, "value_K": value, "difference_K": difference, "holds": holds})
    shares = {name: float(order.share(columns)[k, p]) for name, columns in entry.groups}
    return {
        "mean_K": float(order.mean[k, p]),
        "sigma_K": float(order.sigma[k, p]),
        "quantiles": lines,
        "holds": all(line["holds"] for line in lines),
        "variance_share": shares,
    }


def _table_excursions(entry: DispersedEntry, columns: Columns) -> tuple[list[RatioTableExcursion], BoolArray]:
    """Flights beyond the axes of the ratio tables, and (flight,) whether it is one; an axis of one value has no end."""
    excursions, outside = [], np.zeros(len(columns["outcome"]), dtype=bool)
    for limited in entry.points:
        for variable, axis in zip(RATIO_VARIABLES, limited.point.ratio.axes, strict=True):
            distance = np.maximum(axis[0] - columns[f"least.{variable}"], columns[f"most.{variable}"] - axis[-1])
            if len(axis) > 1 and np.any(distance > 0.0):
                count = int(np.count_nonzero(distance > 0.0))
                excursions.append(RatioTableExcursion(limited.point.name, variable, count, float(np.max(distance))))
                outside |= distance > 0.0
    return excursions, outside


# study.json ----------------------------------------------------------------------------------------------------------

BOUNDS = {
    SOBOL: "order statistics and Clopper-Pearson as for independent flights; those of a Sobol' scramble are more "
    "even, so that the bounds are wide as a rule; `scatter` is the standard error between independent scrambles",
    RANDOM: "order statistics and Clopper-Pearson, exact: the flights are independent",
}
"""Explanation of the bounds, by sampling."""


def data_of(result: DispersionResult) -> dict[str, Any]:
    """A dispersion as study.json holds it."""
    entry, spec = result.entry, result.entry.spec
    names = [name for name, _ in entry.groups]
    untrimmed = result.columns["untrimmed_s"]
    return {
        "flights": spec.flights,
        "sampling": spec.sampling,
        "scrambles": spec.scrambles,
        "seed": spec.seed,
        "confidence": spec.confidence,
        "dimensions": entry.dimensions,
        "inputs": dict(zip(names, map(", ".join, entry.group_descriptions), strict=True)),
        "members": members_of(result),
        "bounds": BOUNDS[spec.sampling],
        "steps": {"flight_s": spec.step_s, "thermal_s": spec.thermal_step_s},
        "nodes": {p.point.name: mesh.nodes for p, mesh in zip(entry.points, entry.meshes, strict=True)},
        "table_modes": {p.point.name: m.shape[1] for p, m in zip(entry.points, entry.modes, strict=True)},
        "completed": asdict(result.completed),
        "within_limits": asdict(result.within_limits),
        "within_limits_tables_and_trim": asdict(result.within_limits_and_data),
        "elevon_at_limit": {"flights": int(np.count_nonzero(untrimmed > 0.0)), "longest_s": float(np.max(untrimmed))},
        "outside_tables": [asdict(o) for o in result.excursions],
        **({"model_error": error_sizes_of(result)} if spec.model_error else {}),
        "negative_ratio_flights": {
            p.point.name: int(np.sum(result.columns[f"negative.{p.point.name}"])) for p in entry.points
        },
        "peaks": [_peak_data(a, names) for a in result.peaks],
        "six_degrees_of_freedom": _check_data(result),
    }


def members_of(result: DispersionResult) -> list[dict[str, Any]]:
    """Members of the set of estimates, with their weights and the number of flights that drew each; none without."""
    entry = result.entry
    stated = member_data(entry.spec.member, entry.estimates)
    return [m | {"flights": int(np.count_nonzero(result.columns["member"] == k))} for k, m in enumerate(stated)]


def error_sizes_of(result: DispersionResult) -> dict[str, float]:
    """Standard deviation of the heating's error of each control point over all flights [-]; none without one."""
    names = result.entry.point_names if result.entry.spec.model_error else []
    return {n: float(np.sqrt(np.mean(result.columns[f"model_error.{n}"] ** 2))) for n in names}


def _peak_data(peak: PeakStatistics, names: Sequence[str]) -> dict[str, Any]:
    data: dict[str, Any] = {
        "control_point": peak.point,
        "quantity": f"peak {peak.location}",
        "limit_K": peak.limit,
        "mean_K": peak.mean_K,
        "sigma_K": peak.sigma_K,
        "least_K": peak.least_K,
        "quantiles": [asdict(q) for q in peak.quantiles],
        "exceeded": None if peak.exceeded is None else asdict(peak.exceeded),
        "first_order": peak.first,
    }
    if peak.indices is not None:
        i = peak.indices
        data["sobol_indices"] = {
            name: {
                "first": float(i.first[g]),
                "first_bounds": i.first_bounds[g].tolist(),
                "total": float(i.total[g]),
                "total_bounds": i.total_bounds[g].tolist(),
            }
            for g, name in enumerate(names)
        }
    return data


def _check_data(result: DispersionResult) -> dict[str, Any] | None:
    """Largest differences of peaks in six degrees of freedom from the point mass's; None where none was flown."""
    if result.checks is None:
        return None
    difference, points = result.checks.difference_K, [p.point.name for p in result.entry.points]
    completed = int(np.count_nonzero(~np.any(np.isnan(difference), axis=(1, 2))))
    data: dict[str, Any] = {"flights": len(difference), "completed": completed}
    if completed:
        for quantity, largest in zip(QUANTITIES, result.checks.largest_K, strict=True):
            evaluated = {a.point for a in result.peaks if a.quantity == quantity}
            data[f"largest_{quantity}"] = {n: float(x) for n, x in zip(points, largest, strict=True) if n in evaluated}
    return data


# Notes ---------------------------------------------------------------------------------------------------------------


def notes_of(result: DispersionResult) -> list[str]:
    """Notes for a reader, one line each: incomplete flights, limits, tables, trim, spot checks, first order."""
    n = result.entry.spec.flights
    lines = []
    if result.completed.count < n:
        lines.append(f"{n - result.completed.count} of {n} flights were not completed; they count as above every limit")
    for a in result.peaks:
        if a.exceeded is not None and a.exceeded.count == a.exceeded.flights:
            lines.append(
                f"{a.point}: every flight exceeds the limit of {a.limit:.0f} K at its {a.location}; the lowest peak is "
                f"{a.least_K:.0f} K"
            )
    lines += [*_error_notes(result), *_excursion_notes(result), *_trim_notes(result)]
    lines += [*_check_notes(result), *_index_notes(result)]
    fails = [f"{a.point} {a.location}" for a in result.peaks if not a.first["holds"]]
    if fails:
        all_of = _all_or_names(fails, len(result.peaks), "peaks")
        lines.append(f"first order does not reproduce the counted quantiles of {all_of}")
    return lines


def _error_notes(result: DispersionResult) -> list[str]:
    """The size of the heating's error, where flights have one."""
    sizes = error_sizes_of(result).values()
    if not sizes:
        return []
    low, high = (f"{100.0 * s:.2g} %" for s in (min(sizes), max(sizes)))
    size = low if low == high else f"{low} to {high}"
    return [f"the heating of each flight has the smooth error that bands have, one standard deviation {size}"]


def _excursion_notes(result: DispersionResult) -> list[str]:
    by_variable: dict[str, list[RatioTableExcursion]] = {}
    for o in result.excursions:
        by_variable.setdefault(o.variable, []).append(o)
    lines = []
    for variable, some in by_variable.items():
        worst = max(some, key=lambda o: o.farthest)
        points = _all_or_names([o.point for o in some], len(result.entry.points), "control points")
        lines.append(
            f"{variable} lies outside the ratio tables of {points}: by {worst.farthest:.3g} at most, in "
            f"{max(o.flights for o in some)} of {result.entry.spec.flights} flights; edge values are held there, and "
            "these flights do not count as within the limits, the tables and the trim"
        )
    return lines


UNUSABLE_INDEX = 0.1
"""Half width of the bounds of a total index that no longer tells what drives a peak, and a total this far below the
first order, which no function has."""


def _index_notes(result: DispersionResult) -> list[str]:
    """Peaks whose indices have too wide bounds, or a total below the first order by more than rounding."""
    wide, crossed = [], []
    for a in (a for a in result.peaks if a.indices is not None):
        assert a.indices is not None
        if np.any(np.ptp(a.indices.total_bounds, axis=1) > 2.0 * UNUSABLE_INDEX):
            wide.append(f"{a.point} {a.location}")
        if np.any(a.indices.total < a.indices.first - 0.1 * UNUSABLE_INDEX):
            crossed.append(f"{a.point} {a.location}")
    remedy = f"raise index_flights, {result.entry.spec.index_flights} here"
    count = sum(a.indices is not None for a in result.peaks)
    lines = []
    for names, words in (
        (wide, f"are uncertain by more than {UNUSABLE_INDEX:g}"),
        (crossed, "have a total below the first order, by the scatter of few flights"),
    ):
        if names:
            lines.append(f"Sobol' indices of {_all_or_names(names, count, 'peaks')} {words}; {remedy}")
    return lines


def _trim_notes(result: DispersionResult) -> list[str]:
    untrimmed = result.columns["untrimmed_s"]
    if not np.any(untrimmed > 0.0):
        return []
    return [
        f"trim: the elevon is at an end of its travel in {np.count_nonzero(untrimmed > 0.0)} of "
        f"{result.entry.spec.flights} flights, for {np.max(untrimmed):.0f} s at most; these flights are not trimmed "
        "there and do not count as within the limits, the tables and the trim"
    ]


def _check_notes(result: DispersionResult) -> list[str]:
    checks = _check_data(result)
    if checks is None:
        return []
    if checks["completed"] == 0:
        return ["six degrees of freedom: no flight was completed there; nothing is compared"]
    largest = [(f"{q.removesuffix('_K')}s", checks[f"largest_{q}"].values()) for q in QUANTITIES]
    agreement = " and ".join(f"{max(values):.1f} K at the {where}" for where, values in largest if values)
    return [f"{checks['flights']} flights repeated in six degrees of freedom: peaks agree within {agreement}"]


def _all_or_names(names: Sequence[str], count: int, noun: str) -> str:
    """`all 12 peaks` where every one is named, else the names."""
    return f"all {count} {noun}" if len(names) == count > 1 else ", ".join(names)
