"""Edges of an envelope along one axis: from the margins of a few flights to its edges and the limits that make them.

Each margin is interpolated along the axis by a monotone cubic (PCHIP). The envelope is where none of them, less z sigma
of its temperature, is negative. Its edges at z and -z are the band about the edge at z = 0: with each limit by itself,
the edge lies inside with the probability of z sigma. Next to a flight that could not be flown nothing is allowed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.base.kernels.axis import cells_of
from sim_heating.planning.envelope.margins import ROUNDING, EvaluatedCase

FINE = 801
"""Places along an axis at which margins are compared."""
NOT_FLOWN = "no flight"
END_OF_STUDY = "not reached in this study"
AERODYNAMICS = "aerodynamics"
"""Names in place of a limit: a flight that failed, the last value of the study, a maximum within the envelope."""


@dataclass(frozen=True, eq=False)
class AxisScan:
    """Margins interpolated along one axis.

    x       : (fine,) places;  names : of the limits
    margins : (limit, fine) at z, each over a typical size of its unit; NaN next to a flight that could not be flown
    """

    x: FloatArray
    names: tuple[str, ...]
    margins: FloatArray

    @property
    def least(self) -> FloatArray:
        """(fine,) the least margin of all limits; -inf next to a flight that could not be flown."""
        return np.where(np.any(np.isnan(self.margins), axis=0), -np.inf, np.min(self.margins, axis=0, initial=np.inf))

    def limit_at(self, i: int) -> str:
        """Name of the limit with the least margin at a place."""
        column = self.margins[:, i]
        return NOT_FLOWN if np.any(np.isnan(column)) else self.names[int(np.argmin(column))]


def scan_axis(
    positions: Sequence[float], flights: Sequence[EvaluatedCase], sigmas: float = 0.0, manoeuvre: str | None = None
) -> AxisScan:
    """Interpolate the margins of flights along an axis.

    positions : of the flights on the axis
    sigmas    : number of sigma subtracted from each margin
    manoeuvre : with the sigma that would remain after this one
    """
    order = np.argsort(positions)
    x = np.asarray(positions, dtype=float)[order]
    ordered = [flights[i] for i in order]
    fine = np.unique(np.concatenate((np.linspace(x[0], x[-1], FINE), x)))
    flown = np.array([f.error is None for f in ordered])
    names = tuple(dict.fromkeys(n for f in ordered for n in f.margins))
    margins = np.full((max(len(names), 1), len(fine)), np.nan)
    if np.count_nonzero(flown) >= 2:
        is_between = _between_flown(x, flown, fine)
        for k, name in enumerate(names):
            y = np.array([f.margins[name].reduced(sigmas, manoeuvre) for f in ordered if f.error is None])
            # PCHIP does not overshoot: a spline would invent a violation between two flights within the limit. Margins
            # are scaled, so that kelvins and degrees can be compared.
            margins[k, is_between] = PchipInterpolator(x[flown], y / _scale(ordered, name))(fine[is_between])
    return AxisScan(fine, names or (NOT_FLOWN,), margins)


def _between_flown(x: FloatArray, flown: BoolArray, fine: FloatArray) -> BoolArray:
    """(fine,) whether a place lies between two neighbouring flights that could both be flown."""
    i = cells_of(x, fine)
    on_flight = np.isin(fine, x[flown])
    return np.asarray((flown[i] & flown[i + 1]) | on_flight)


def _scale(flights: Sequence[EvaluatedCase], name: str) -> float:
    """Typical size of a margin of a limit: 10 K, or 1 of another unit."""
    first = next(f.margins[name] for f in flights if name in f.margins)
    return 10.0 if first.unit == "K" else 1.0


# The allowed interval ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Edge:
    """An end of the envelope on an axis, and the limit that makes it; END_OF_STUDY where no limit does."""

    at: float
    limit: str


@dataclass(frozen=True)
class AllowedInterval:
    """The allowed interval of an axis at one z.

    low, high      : its ends; None where nothing is allowed
    least_violated : where nothing is allowed, the place that comes closest and the limit that is violated there
    """

    low: Edge | None
    high: Edge | None
    least_violated: Edge | None = None

    @property
    def width(self) -> float:
        """Length of the interval, 0 where nothing is allowed."""
        return 0.0 if self.low is None or self.high is None else self.high.at - self.low.at


def allowed_interval(scan: AxisScan, start: float) -> AllowedInterval:
    """The interval about a place in which no limit is violated; where that place is not allowed, the longest one."""
    least = scan.least
    runs = _runs(least >= ROUNDING)
    if not runs:
        best = int(np.argmax(least))
        return AllowedInterval(None, None, Edge(float(scan.x[best]), scan.limit_at(best)))
    # Of several allowed intervals the one around the base entry counts: the others cannot be reached from it without a
    # violation.
    about = [r for r in runs if scan.x[r[0]] <= start <= scan.x[r[1]]]
    first, last = about[0] if about else max(runs, key=lambda r: float(scan.x[r[1]] - scan.x[r[0]]))
    return AllowedInterval(_edge(scan, first, first - 1), _edge(scan, last, last + 1))


def _runs(allowed: BoolArray) -> list[tuple[int, int]]:
    """First and last places of each run of True."""
    ends = np.flatnonzero(np.diff(np.concatenate(([0], allowed.astype(int), [0]))))
    return [(int(a), int(b) - 1) for a, b in zip(ends[::2], ends[1::2], strict=True)]


def _edge(scan: AxisScan, last: int, neighbour: int) -> Edge:
    """The edge between a place that is allowed and its neighbour that is not, linear between them."""
    if not 0 <= neighbour < len(scan.x):
        return Edge(float(scan.x[last]), END_OF_STUDY)
    # Next to a flight that could not be flown nothing is interpolated, and the edge stays at the last one flown.
    if not np.isfinite(scan.least[neighbour]):
        return Edge(float(scan.x[last]), NOT_FLOWN)
    a, b = scan.least[last], scan.least[neighbour]
    fraction = float(a / (a - b))
    return Edge(float(scan.x[last] + fraction * (scan.x[neighbour] - scan.x[last])), scan.limit_at(neighbour))


# The greatest value --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class GreatestValue:
    """The greatest value of a quantity within the envelope, its place on the axis, and the limit that bounds it."""

    value: float
    at: float
    limit: str


def greatest_value(scan: AxisScan, positions: Sequence[float], values: Sequence[float]) -> GreatestValue | None:
    """The greatest value over the allowed part of an axis; None where nothing is allowed.

    values : at the positions; not finite where no flight was possible
    """
    order = np.argsort(positions)
    x, y = np.asarray(positions, dtype=float)[order], np.asarray(values, dtype=float)[order]
    allowed = scan.least >= ROUNDING
    is_finite = np.isfinite(y)
    if not np.any(allowed) or np.count_nonzero(is_finite) < 2:
        return None
    fine = PchipInterpolator(x[is_finite], y[is_finite], extrapolate=False)(scan.x)
    fine[~allowed | ~np.isfinite(fine)] = -np.inf
    i = int(np.argmax(fine))
    for beyond in (i - 1, i + 1):
        if 0 <= beyond < len(allowed) and not allowed[beyond]:
            return GreatestValue(float(fine[i]), float(scan.x[i]), scan.limit_at(beyond))
    at_end = i in (0, len(allowed) - 1)
    return GreatestValue(float(fine[i]), float(scan.x[i]), END_OF_STUDY if at_end else AERODYNAMICS)
