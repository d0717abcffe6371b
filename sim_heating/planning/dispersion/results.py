"""The part [dispersion] of a study: flights in batches, what they tell, and where first order tells the same.

What the exact sensitivities along the mean flight say of the peaks' scatter, to first order.

    T_peak = T_mean + sum_k s_k z_k,      variance sum_k s_k^2,      quantile T_mean + z_q sqrt(variance)

s_k [K] is the sensitivity of a peak times the standard deviation of input k. Of thermal parameters and effects it is
exact (march/linearised.py), at the time of the peak; of what changes the flight, and of the modes of ratio tables, a
central difference of flights DIFFERENCE standard deviations to either side.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.kernels.block import LANES, TIME
from sim_heating.base.parallel import Job, run_batches
from sim_heating.base.progress import Progress
from sim_heating.march.linearised import LinearMarch, Track
from sim_heating.planning.dispersion.entry import (
    AXES,
    BATCH,
    DIFFERENCE,
    INDEX,
    RANDOM,
    TWICE,
    Batch,
    DispersedEntry,
    parquet_bytes,
)
from sim_heating.planning.dispersion.flight import WHOLE, fly_many
from sim_heating.planning.dispersion.march import QUANTITIES
from sim_heating.planning.dispersion.spot_checks import SpotChecks, fly_twice, told_apart
from sim_heating.planning.dispersion.statistics import (
    Indices,
    Probability,
    Quantile,
    axis_rows,
    deviations,
    indices,
    probability,
    quantiles,
)
from sim_heating.planning.study import Study

Columns = dict[str, FloatArray]

FLIGHTS_FILE = "dispersion_flights.parquet"
ROW_GROUP = 64
"""Batches of a row group of the merged file."""


@dataclass(frozen=True)
class Answer:
    """What the flights tell of one peak of one point.

    limit      : [K], None where there is none
    exceeded   : probability that the peak is above it; flights without an end count as above
    first      : what first order says: mean, sigma and quantiles [K], and whether it holds
    indices    : Sobol' indices by group, None where they were not asked for or the peak is constant
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


@dataclass(frozen=True)
class Outside:
    """How often and how far flights left a ratio table."""

    point: str
    variable: str
    flights: int
    farthest: float


@dataclass(frozen=True)
class Dispersed:
    """All that a dispersion found.

    kept  : probability that a flight comes to its end with all peaks below their limits
    safe  : that it does so, never leaves a ratio table and is trimmed all the way
    ended : that it comes to its end
    """

    entry: DispersedEntry
    columns: Columns
    answers: list[Answer]
    outside: list[Outside]
    kept: Probability
    safe: Probability
    ended: Probability
    order: FirstOrder
    checks: SpotChecks | None

    def values(self, answer: Answer) -> FloatArray:
        """(flight,) the peak of an answer [K]."""
        return self.columns[f"{answer.quantity}.{answer.point}"]


def batch_results(entry: DispersedEntry, batch: Batch) -> bytes:
    """The results of a batch as a Parquet file: spot checks are flown with both sources, other designs as a point mass.

    A function of this module, because another process that takes part has to import it by name.
    """
    return parquet_bytes(fly_twice(entry, entry.rows(batch))) if batch.design == TWICE else entry(batch)


def batches_of(entry: DispersedEntry) -> dict[str, list[Batch]]:
    """All batches of a dispersion by what they are for."""
    spec = entry.spec
    each = spec.flights // spec.scrambles
    main = [
        Batch(spec.sampling, first, min(first + BATCH, each), scramble)
        for scramble in range(spec.scrambles)
        for first in range(0, each, BATCH)
    ]
    count = spec.index_flights * (len(entry.groups) + 2)
    index = [Batch(INDEX, first, min(first + BATCH, count)) for first in range(0, count, BATCH)]
    twice = [Batch(TWICE, k, k + 1) for k in range(min(spec.spot_checks, each))]
    return {"main": main, "axes": axis_batches(entry, BATCH), "index": index, "twice": twice}


def disperse(
    study: Study, ledger: Path, *, scheduler: str | None = None, workers: int | None = None, progress: Progress
) -> tuple[Dispersed, dict[str, list[Path]]]:
    """Fly all flights of a study's dispersion and say what they tell; gives the batches' files as well.

    ledger : folder that is this study's alone
    raises : InputError for inputs that cannot be; RunError where batches failed
    """
    entry = DispersedEntry(study)
    entry.check()
    batches = batches_of(entry)
    jobs = [Job(batch.id, batch) for some in batches.values() for batch in some]
    outcome = run_batches(
        jobs, partial(batch_results, entry), ledger, scheduler=scheduler, workers=workers, progress=progress
    )
    if outcome.failed:
        name, why = next(iter(outcome.failed.items()))
        raise RunError(
            f"{len(outcome.failed)} of {len(jobs)} batches failed, {name} first: {why}; run again to try them"
        )
    files = {what: [ledger / batch.id for batch in some] for what, some in batches.items()}
    return told(entry, {what: read_columns(some) for what, some in files.items()}), files


def read_columns(files: Sequence[Path]) -> Columns:
    """All columns of Parquet files, one after the other."""
    import pyarrow.parquet as pq

    if not files:
        return {}
    parts = []
    for path in files:
        try:
            parts.append(pq.read_table(path))
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: is damaged ({' '.join(str(error).split())}); remove it and run again") from None
    return {
        name: np.concatenate([p.column(name).to_numpy() for p in parts]) for name in parts[0].column_names
    }  # fmt: skip


def merge(files: Sequence[Path], path: Path) -> None:
    """The batches as one Parquet file, a few at a time in memory."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    first = pq.read_table(files[0])
    with pq.ParquetWriter(path, first.schema, compression="zstd") as writer:
        for k in range(0, len(files), ROW_GROUP):
            writer.write_table(pa.concat_tables([pq.read_table(f) for f in files[k : k + ROW_GROUP]]).combine_chunks())


def told(entry: DispersedEntry, flown: Mapping[str, Columns]) -> Dispersed:
    """What the flights tell, by what they were for (`batches_of`)."""
    columns, index = flown["main"], flown["index"]
    order = first_order(entry, flown["axes"])
    checks = told_apart(entry, flown["twice"]) if flown["twice"] else None
    whole = columns["outcome"] == WHOLE
    above = ~whole
    answers = []
    for p, limited in enumerate(entry.points):
        for k, (quantity, limit) in enumerate(zip(QUANTITIES, (limited.surface_K, limited.bondline_K), strict=True)):
            if quantity == QUANTITIES[1] and entry.meshes[p].bondline == 0:
                continue  # a wall of one layer has no other bondline than its surface
            answer = _answer(entry, columns, index, order, k, p, limit)
            answers.append(answer)
            if limit is not None and np.isfinite(limit):
                above |= ~(columns[f"{quantity}.{limited.point.name}"] <= limit)
    confidence = entry.spec.confidence
    outside, left = _outside(entry, columns)
    unsafe = above | left | (columns["untrimmed_s"] > 0.0)
    return Dispersed(
        entry, columns, answers, outside, probability(~above, confidence), probability(~unsafe, confidence),
        probability(whole, confidence), order, checks,
    )  # fmt: skip


def _answer(
    entry: DispersedEntry, columns: Columns, index: Columns, order: FirstOrder, k: int, p: int, limit: float | None
) -> Answer:
    spec, point, quantity = entry.spec, entry.points[p].point.name, QUANTITIES[k]
    x = columns[f"{quantity}.{point}"]
    known = x[np.isfinite(x)]
    if len(known) < 2:
        raise RunError(f"of {len(x)} flights {len(known)} come to their end; look at the entry and what disperses it")
    found = quantiles(x, columns["scramble"].astype(np.int64), spec.quantiles, spec.confidence)
    sigma = float(np.std(known, ddof=1))
    limit = limit if limit is not None and np.isfinite(limit) else None
    driven = None
    if index:
        driven = indices(index[f"{quantity}.{point}"], len(entry.groups), spec.confidence, spec.seed)
    return Answer(
        point, quantity, float(np.mean(known)), sigma, found, limit, float(np.min(known)),
        None if limit is None else probability(~(x <= limit), spec.confidence),
        _first(entry, order, k, p, found, sigma), driven,
    )  # fmt: skip


def _first(
    entry: DispersedEntry, order: FirstOrder, k: int, p: int, found: Sequence[Quantile], sigma: float
) -> dict[str, Any]:
    """First order beside the counted quantiles; it holds where each is within the counted one's bounds or near it."""
    lines = []
    for quantile in found:
        value = float(order.quantile(quantile.q)[k, p])
        apart = None if quantile.value is None else value - quantile.value
        within = quantile.low is not None and quantile.high is not None and quantile.low <= value <= quantile.high
        holds = apart is not None and (within or abs(apart) <= NEAR * sigma)
        lines.append({"q": quantile.q, "value_K": value, "apart_K": apart, "holds": holds})
    shares = {name: float(order.share(columns)[k, p]) for name, columns in entry.groups}
    return {
        "mean_K": float(order.mean[k, p]), "sigma_K": float(order.sigma[k, p]), "quantiles": lines,
        "holds": all(line["holds"] for line in lines), "variance_share": shares,
    }  # fmt: skip


def _outside(entry: DispersedEntry, columns: Columns) -> tuple[list[Outside], BoolArray]:
    """Flights that left the axes of the points' tables; an axis of one value has no outside."""
    found, left = [], np.zeros(len(columns["outcome"]), dtype=bool)
    for limited in entry.points:
        for variable, axis in zip(RATIO_VARIABLES, limited.point.ratio.axes, strict=True):
            beyond = np.maximum(axis[0] - columns[f"least.{variable}"], columns[f"most.{variable}"] - axis[-1])
            if len(axis) > 1 and np.any(beyond > 0.0):
                count = int(np.count_nonzero(beyond > 0.0))
                found.append(Outside(limited.point.name, variable, count, float(np.max(beyond))))
                left |= beyond > 0.0
    return found, left


def data_of(found: Dispersed) -> dict[str, Any]:
    """A dispersion as study.json holds it."""
    entry, spec = found.entry, found.entry.spec
    names = [name for name, _ in entry.groups]
    untrimmed = found.columns["untrimmed_s"]
    return {
        "flights": spec.flights, "sampling": spec.sampling, "scrambles": spec.scrambles, "seed": spec.seed,
        "confidence": spec.confidence, "dimensions": entry.dimensions,
        "inputs": dict(zip(names, map(", ".join, entry.words), strict=True)),
        "bounds": BOUNDS[spec.sampling],
        "steps": {"flight_s": spec.step_s, "thermal_s": spec.thermal_step_s},
        "nodes": {p.point.name: mesh.nodes for p, mesh in zip(entry.points, entry.meshes, strict=True)},
        "table_modes": {p.point.name: m.shape[1] for p, m in zip(entry.points, entry.modes, strict=True)},
        "came_to_their_end": asdict(found.ended),
        "kept_all_limits": asdict(found.kept),
        "kept_limits_tables_and_trim": asdict(found.safe),
        "elevon_at_its_end": {"flights": int(np.count_nonzero(untrimmed > 0.0)), "longest_s": float(np.max(untrimmed))},
        "outside_tables": [asdict(o) for o in found.outside],
        "negative_ratio_flights": {
            p.point.name: int(np.sum(found.columns[f"negative.{p.point.name}"])) for p in entry.points
        },
        "peaks": [_data(a, names) for a in found.answers],
        "six_degrees_of_freedom": _checks(found),
    }  # fmt: skip


def _checks(found: Dispersed) -> dict[str, Any] | None:
    """Largest differences of peaks in six degrees of freedom from the point mass's; None where none was flown."""
    if found.checks is None:
        return None
    apart, points = found.checks.apart_K, [p.point.name for p in found.entry.points]
    whole = int(np.count_nonzero(~np.any(np.isnan(apart), axis=(1, 2))))
    data: dict[str, Any] = {"flights": len(apart), "came_to_their_end": whole}
    if whole:
        for quantity, largest in zip(QUANTITIES, found.checks.largest_K, strict=True):
            told = {a.point for a in found.answers if a.quantity == quantity}
            data[f"largest_{quantity}"] = {n: float(x) for n, x in zip(points, largest, strict=True) if n in told}
    return data


BOUNDS = {
    "sobol": "order statistics and Clopper-Pearson as for independent flights; those of a Sobol' scramble are more "
    "even, so that the bounds are wide as a rule; `scatter` is the standard error between independent scrambles",
    RANDOM: "order statistics and Clopper-Pearson, exact: the flights are independent",
}
"""What the bounds are, by sampling."""


def _data(answer: Answer, names: Sequence[str]) -> dict[str, Any]:
    data: dict[str, Any] = {
        "control_point": answer.point, "quantity": f"peak {place_of(answer)}",
        "limit_K": answer.limit, "mean_K": answer.mean_K, "sigma_K": answer.sigma_K, "least_K": answer.least_K,
        "quantiles": [asdict(q) for q in answer.quantiles],
        "exceeded": None if answer.exceeded is None else asdict(answer.exceeded),
        "first_order": answer.first,
    }  # fmt: skip
    if answer.indices is not None:
        i = answer.indices
        data["sobol_indices"] = {
            name: {"first": float(i.first[g]), "first_bounds": i.first_bounds[g].tolist(), "total": float(i.total[g]),
                   "total_bounds": i.total_bounds[g].tolist()}
            for g, name in enumerate(names)
        }  # fmt: skip
    return data


def place_of(answer: Answer) -> str:
    """Where an answer's peak is: surface or bondline."""
    return answer.quantity.removesuffix("_K")


def notes_of(found: Dispersed) -> list[str]:
    """What a person has to know, in lines."""
    n = found.entry.spec.flights
    lines = []
    if found.ended.count < n:
        lines.append(
            f"{n - found.ended.count} of {n} flights did not come to their end; they count as above every limit"
        )
    for a in found.answers:
        if a.exceeded is not None and a.exceeded.count == a.exceeded.flights:
            lines.append(
                f"{a.point}: no flight keeps the limit of {a.limit:.0f} K at its {place_of(a)}; the "
                f"coolest comes to {a.least_K:.0f} K"
            )
    by_variable: dict[str, list[Outside]] = {}
    for o in found.outside:
        by_variable.setdefault(o.variable, []).append(o)
    for variable, some in by_variable.items():
        worst = max(some, key=lambda o: o.farthest)
        whose = _which([o.point for o in some], len(found.entry.points), "control points")
        lines.append(
            f"{variable} lies outside the ratio tables of {whose}: {worst.farthest:.3g} "
            f"beyond at most, in {max(o.flights for o in some)} of {n} flights; edge values held there, and these "
            "flights are not called safe"
        )
    untrimmed = found.columns["untrimmed_s"]
    if np.any(untrimmed > 0.0):
        lines.append(
            f"trim: the elevon is at an end of its travel in {np.count_nonzero(untrimmed > 0.0)} of {n} flights, for "
            f"{np.max(untrimmed):.0f} s at most; not trimmed there, and these flights are not called safe"
        )
    checks = _checks(found)
    if checks is not None and checks["came_to_their_end"] == 0:
        lines.append("six degrees of freedom: none of the flights came to its end there; nothing is compared")
    elif checks is not None:
        agree = [(f"{q.removesuffix('_K')}s", checks[f"largest_{q}"].values()) for q in QUANTITIES]
        told = " and ".join(f"{max(apart):.1f} K at the {where}" for where, apart in agree if apart)
        lines.append(f"{checks['flights']} flights again in six degrees of freedom: peaks agree within {told}")
    fails = [f"{a.point} {place_of(a)}" for a in found.answers if not a.first["holds"]]
    if fails:
        lines.append(f"first order does not give the counted quantiles of {_which(fails, len(found.answers), 'peaks')}")
    return lines


def _which(names: Sequence[str], of: int, what: str) -> str:
    """Names, or that it is all of them."""
    return f"all {of} {what}" if len(names) == of > 1 else ", ".join(names)


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
    moved = model.with_parameters({name: model.value(name) + mean[k] for k, name in own})
    times = np.unique(_peak_times(marched, conditions))
    return Track(moved, mesh, tuple(name for _, name in own), times, (0, mesh.bondline), flight=flight)


def _peak_times(marched: FloatArray, conditions: FloatArray) -> FloatArray:
    """When surface and bondline of the first lane are hottest [s]."""
    return conditions[0, np.argmax(marched[:, : len(QUANTITIES)], axis=0), TIME]


def _acts(entry: DispersedEntry, k: int, point: int) -> bool:
    return any(p == point for p, _, _ in entry.places[k])
