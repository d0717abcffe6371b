"""Conditions that measured data sets cover, and by how much a result lies outside of them.

A data set covers the conditions that it was measured at: in each range of Mach numbers the intervals of angle of
attack, log10 of Reynolds number and wall temperature that it went through. A ground test without flow covers an
interval of wall temperatures alone. Wall temperatures of a data set are the readings of its outermost thermocouple, as
far as it reads; those of a result are the surface temperatures of the model.

An interval is stated with DIGITS digits. A result that is outside of it by less than one unit of the last digit of its
larger end is within it: the interval does not resolve that distance.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from sim_heating.base.arrays import BoolArray, FloatArray

MACH_EDGES = (0.0, 2.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0)
"""Mach numbers that divide a flight into ranges."""
VARIABLES = {"mach": 1e-3, "alpha_deg": 10.0, "log10_re": 0.5, "wall_K": 100.0}
"""Variables of the region, each with the distance [-, deg, -, K] that counts as much as those of the others where the
nearest range is chosen: by Mach number first, so that walls are compared at like speeds."""
UNITS = {"mach": "", "alpha_deg": " deg", "log10_re": "", "wall_K": " K"}
DIGITS = 4
"""Digits that the ends of an interval are stated with."""
Distances = dict[tuple[int, float, float], FloatArray]
"""Distance of an array from an interval, by the identity of the array and the ends of the interval."""
FLIGHT, GROUND = "flight", "ground test"
STILL_M_S = 1.0
"""Speed up to which a record is a ground test [m/s]."""


@dataclass(frozen=True)
class Samples:
    """Conditions of one control point along its time.

    kind       : `flight`, or `ground test`, which has a wall temperature alone
    values     : variable -> (time,) values in its unit [-], [deg], [K]
    duration_s : (time,) time that each sample stands for [s]
    """

    kind: str
    values: Mapping[str, FloatArray]
    duration_s: FloatArray


@dataclass(frozen=True)
class Band:
    """Conditions that a data set covers within one range of Mach numbers, with the errors of the prediction there.

    limits : variable -> least and greatest value;  rmse_K : of the declared prediction [K];  n : number of readings
    """

    limits: Mapping[str, tuple[float, float]]
    rmse_K: float
    n: int

    def beyond(self, samples: Samples, computed: Distances) -> dict[str, FloatArray]:
        """(time,) signed distance of each variable from the interval, 0 within or below its resolution, in its unit.

        computed : distances that were computed before; points of one flight share their conditions
        """
        distances = {}
        for name, (low, high) in self.limits.items():
            x = samples.values[name]
            key = (id(x), low, high)
            if key not in computed:
                distance = x - np.clip(x, low, high)
                computed[key] = np.where(np.abs(distance) < _resolution(low, high), 0.0, distance)
            distances[name] = computed[key]
        return distances


def _resolution(low: float, high: float) -> float:
    """One unit of the last digit that the larger end of an interval is stated with, in the unit of the interval."""
    largest = max(abs(low), abs(high))
    return 10.0 ** (math.floor(math.log10(largest)) + 1 - DIGITS) if largest > 0.0 else 0.0


@dataclass(frozen=True)
class ValidationCase:
    """A measured data set that the declared model was compared with, nothing fitted.

    name, title : of the record;  kind : `flight` or `ground test`;  vehicle, control_point : as the record names them
    source      : where the measurements come from, empty where the record does not say
    files       : digest of the record's files
    rmse_K, max_abs_K, n : errors of the prediction over all used readings [K]
    rise_K      : greatest less least reading [K]
    of_user     : whether a user added it
    """

    name: str
    title: str
    kind: str
    vehicle: str
    control_point: str
    source: str
    files: str
    rmse_K: float
    max_abs_K: float
    n: int
    rise_K: float
    bands: tuple[Band, ...]
    of_user: bool = False


@dataclass(frozen=True)
class Extrapolation:
    """Where a result lies against the conditions of measured data sets.

    inside        : part of the time within them [-]
    outside       : variable -> (farthest below, farthest above, part of the time outside), distances in its unit
    share_by_case : data set -> part of the time within it [-], those above 0
    error         : greatest RMSE over rise of the ranges that the result lies in [-]; None where it lies in none
    """

    inside: float
    outside: Mapping[str, tuple[float, float, float]]
    share_by_case: Mapping[str, float]
    error: float | None

    @property
    def short(self) -> str:
        """In a few words, without distances."""
        if self.inside >= 1.0 or not self.outside:
            return self.words
        names = ", ".join(_label(n) for n in self.outside)
        return f"{1.0 - self.inside:.0%} of the time outside the conditions of measured data ({names})"

    @property
    def words(self) -> str:
        """In one sentence."""
        if self.inside >= 1.0:
            return f"at all times within the conditions of measured data ({', '.join(self.share_by_case)})"
        if self.inside <= 0.0 and not self.outside:
            return "not compared with the conditions of measured data sets"
        far = []
        for name, (below, above, _) in self.outside.items():
            label, unit = _label(name), UNITS[name]
            far += [f"{label} {above:.3g}{unit} above"] if above > 0.0 else []
            far += [f"{label} {below:.3g}{unit} below"] if below > 0.0 else []
        return f"{1.0 - self.inside:.0%} of the time outside the conditions of measured data: up to {', '.join(far)}"


def _label(name: str) -> str:
    return {"mach": "Mach", "log10_re": "log10 Re", "wall_K": "wall temperature"}.get(name, name.partition("_")[0])


def bands_of(samples: Samples, residual_K: FloatArray) -> tuple[Band, ...]:
    """Ranges that a data set covers, a range of Mach numbers each.

    residual_K : (sensor, time) measured less predicted [K]
    """
    if samples.kind == GROUND:
        return (_band(samples, residual_K, np.ones(len(samples.duration_s), dtype=bool)),)
    mach = samples.values["mach"]
    ranges = [(mach >= low) & (mach <= high) for low, high in pairwise(MACH_EDGES)]
    return tuple(_band(samples, residual_K, inside) for inside in ranges if np.any(inside))


def _band(samples: Samples, residual_K: FloatArray, inside: BoolArray) -> Band:
    limits = {n: (float(np.min(x[inside])), float(np.max(x[inside]))) for n, x in samples.values.items()}
    residual = residual_K[:, inside]
    residual = residual[np.isfinite(residual)]
    rmse = float(np.sqrt(np.mean(residual**2))) if len(residual) else 0.0
    if "mach" in limits:  # neighbouring ranges meet at their common edge, which a sampled flight steps over
        mach = samples.values["mach"]
        low, high = limits["mach"]
        below = [e for e in MACH_EDGES if mach.min() < e <= low]
        above = [e for e in MACH_EDGES if high <= e < mach.max()]
        limits["mach"] = (max(below, default=low), min(above, default=high))
    return Band(limits, rmse, len(residual))


@dataclass(frozen=True, eq=False)
class _Coverage:
    """The conditions of a control point against data sets.

    bands  : of the data sets of its kind, each with its data set
    beyond : of each band, `Band.beyond`
    """

    samples: Samples
    bands: Sequence[tuple[ValidationCase, Band]]
    beyond: Sequence[Mapping[str, FloatArray]]

    @cached_property
    def cost(self) -> FloatArray:
        """(band, time) distance from each band over the scales of VARIABLES, 0 within [-]."""
        return np.array([sum(np.abs(d) / VARIABLES[n] for n, d in distances.items()) for distances in self.beyond])

    def at_nearest(self, values: FloatArray) -> FloatArray:
        """(time,) of values (band, time), those of the nearest band."""
        return values[np.argmin(self.cost, axis=0), np.arange(values.shape[1])]

    def seconds(self, where: BoolArray) -> float:
        """Time [s] of the samples (time,) that are marked."""
        return float(np.sum(self.samples.duration_s[where]))

    def seconds_by_case(self) -> dict[str, float]:
        """Time [s] within any band of each data set, by its name."""
        covered: dict[str, BoolArray] = {}
        for case, _, where in self.covering:
            covered[case.name] = where | covered.get(case.name, False)
        return {name: self.seconds(where) for name, where in covered.items()}

    @property
    def covering(self) -> list[tuple[ValidationCase, Band, BoolArray]]:
        """Data set, band, and (time,) whether a sample is within it, of each band that some sample is within."""
        inside = self.cost == 0.0
        return [(case, band, where) for (case, band), where in zip(self.bands, inside, strict=True) if np.any(where)]

    @property
    def relative_errors(self) -> list[float]:
        """Error over the rise of the temperature [-] of each band that some sample is within."""
        return [band.rmse_K / case.rise_K if case.rise_K > 0.0 else 1.0 for case, band, _ in self.covering]

    def widen(self, outside: dict[str, list[float]]) -> None:
        """Widen how far each variable lies below and above all data sets, and add the time in which it does [s]."""
        for name in self.samples.values:
            beyond = self.at_nearest(np.array([distances[name] for distances in self.beyond]))
            if np.any(beyond != 0.0):
                far = outside.setdefault(name, [0.0, 0.0, 0.0])
                far[0], far[1] = max(far[0], float(-beyond.min())), max(far[1], float(beyond.max()))
                far[2] += self.seconds(beyond != 0.0)


def _coverages(points: Sequence[Samples], cases: Sequence[ValidationCase]) -> Iterator[_Coverage]:
    """Coverage of each control point with samples by the data sets of its kind, where there are any."""
    computed: Distances = {}
    for samples in points:
        bands = [(case, band) for case in cases if case.kind == samples.kind for band in case.bands]
        if bands and len(samples.duration_s):
            yield _Coverage(samples, bands, [band.beyond(samples, computed) for _, band in bands])


def extrapolation(points: Sequence[Samples], cases: Sequence[ValidationCase]) -> Extrapolation:
    """Where the points of a result lie against the conditions of data sets.

    points : conditions of each control point;  cases : data sets; those of another kind than a point are not compared
    """
    total = sum(float(np.sum(p.duration_s)) for p in points)
    if total <= 0.0:
        return Extrapolation(0.0, {}, {}, None)
    inside, seconds_by_case = 0.0, dict.fromkeys((c.name for c in cases), 0.0)
    outside: dict[str, list[float]] = {}
    errors: list[float] = []
    for coverage in _coverages(points, cases):
        inside += coverage.seconds(coverage.at_nearest(coverage.cost) == 0.0)
        errors += coverage.relative_errors
        for name, seconds in coverage.seconds_by_case().items():
            seconds_by_case[name] += seconds
        coverage.widen(outside)
    return Extrapolation(
        min(inside / total, 1.0) if inside < total * (1.0 - 1e-12) else 1.0,
        {n: (max(low, 0.0), max(high, 0.0), t / total) for n, (low, high, t) in outside.items()},
        {n: t / total for n, t in seconds_by_case.items() if t > 0.0},
        max(errors, default=None),
    )
