"""Where an envelope ends: from the margins of a few flights along one axis to its edges, what limits them, and how
surely.

Each margin is interpolated along the axis by a monotone cubic (PCHIP); the envelope is where all of them, less z
sigma of the temperatures they are of, are not negative. Its edges at z and -z are the band about the edge at z = 0:
with each limit by itself, the edge is inside with the probability of z sigma. Next to a flight that could not be
flown nothing is allowed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from sim_heating.base.arrays import FloatArray
from sim_heating.base.kernels.axis import cells_of
from sim_heating.planning.envelope.margins import ROUNDING, Evaluated

FINE = 801
"""Places along an axis at which margins are compared."""
NOT_FLOWN = "no flight"
END_OF_STUDY = "not reached in this study"
AERODYNAMICS = "aerodynamics"


@dataclass(frozen=True)
class Edge:
    """An end of the envelope on an axis: where, and the limit that makes it; END_OF_STUDY where none does."""

    at: float
    limit: str


@dataclass(frozen=True)
class Allowed:
    """What is allowed along an axis at one z; `least_bad` is the limit that keeps all closed, where nothing is."""

    low: Edge | None
    high: Edge | None
    least_bad: Edge | None = None

    @property
    def width(self) -> float:
        """Length of the interval, 0 where nothing is allowed."""
        return 0.0 if self.low is None or self.high is None else self.high.at - self.low.at


@dataclass(frozen=True, eq=False)
class Scan:
    """Flights along one axis, interpolated.

    x       : (fine,) places;  names : of the limits
    margins : (limit, fine) at z, NaN next to a flight that could not be flown
    """

    x: FloatArray
    names: tuple[str, ...]
    margins: FloatArray

    @property
    def worst(self) -> FloatArray:
        """(fine,) the least margin of all, each over the largest of its own size, -inf where nothing was flown."""
        return np.where(np.any(np.isnan(self.margins), axis=0), -np.inf, np.min(self.margins, axis=0, initial=np.inf))

    def limit_at(self, i: int) -> str:
        """The limit with the least margin at a place."""
        column = self.margins[:, i]
        return NOT_FLOWN if np.any(np.isnan(column)) else self.names[int(np.argmin(column))]


def scan(
    places: Sequence[float], flights: Sequence[Evaluated], sigmas: float = 0.0, manoeuvre: str | None = None
) -> Scan:
    """Margins less so many sigma along an axis, each in units of its spread over the flights."""
    order = np.argsort(places)
    x = np.asarray(places, dtype=float)[order]
    ordered = [flights[i] for i in order]
    fine = np.unique(np.concatenate((np.linspace(x[0], x[-1], FINE), x)))
    good = np.array([f.error is None for f in ordered])
    names = tuple(dict.fromkeys(n for f in ordered for n in f.margins))
    margins = np.full((max(len(names), 1), len(fine)), np.nan)
    if np.count_nonzero(good) >= 2:
        known = fine_between(x, good, fine)
        for k, name in enumerate(names):
            y = np.array([f.margins[name].less(sigmas, manoeuvre) for f in ordered if f.error is None])
            scale = _scale(ordered, name)
            margins[k, known] = PchipInterpolator(x[good], y / scale)(fine[known])
    return Scan(fine, names or (NOT_FLOWN,), margins)


def fine_between(x: FloatArray, good: NDArray[np.bool_], fine: FloatArray) -> NDArray[np.bool_]:
    """(fine,) whether a place lies between two neighbouring flights that could both be flown."""
    i = cells_of(x, fine)
    on = np.isin(fine, x[good])
    return np.asarray((good[i] & good[i + 1]) | on)


def _scale(flights: Sequence[Evaluated], name: str) -> float:
    """Size that margins of a limit are compared in: 10 K, or 1 of another unit."""
    first = next(f.margins[name] for f in flights if name in f.margins)
    return 10.0 if first.unit == "K" else 1.0


def allowed(found: Scan, inside: float) -> Allowed:
    """The interval about a place where all limits are kept; where that place is not, the longest one."""
    worst = found.worst
    runs = _runs(worst >= ROUNDING)
    if not runs:
        best = int(np.argmax(worst))
        return Allowed(None, None, Edge(float(found.x[best]), found.limit_at(best)))
    holding = [r for r in runs if found.x[r[0]] <= inside <= found.x[r[1]]]
    first, last = holding[0] if holding else max(runs, key=lambda r: float(found.x[r[1]] - found.x[r[0]]))
    return Allowed(_edge(found, first, first - 1), _edge(found, last, last + 1))


def _runs(kept: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last places of each run of True."""
    ends = np.flatnonzero(np.diff(np.concatenate(([0], kept.astype(int), [0]))))
    return [(int(a), int(b) - 1) for a, b in zip(ends[::2], ends[1::2], strict=True)]


def _edge(found: Scan, last: int, beyond: int) -> Edge:
    """The edge between a place that is allowed and its neighbour that is not, linear between them."""
    if not 0 <= beyond < len(found.x):
        return Edge(float(found.x[last]), END_OF_STUDY)
    if not np.isfinite(found.worst[beyond]):
        return Edge(float(found.x[last]), NOT_FLOWN)
    a, b = found.worst[last], found.worst[beyond]
    share = float(a / (a - b))
    return Edge(float(found.x[last] + share * (found.x[beyond] - found.x[last])), found.limit_at(beyond))


@dataclass(frozen=True)
class Greatest:
    """The greatest value of a quantity where all limits are kept, where on the axis, and what keeps it from more."""

    value: float
    at: float
    limit: str


def greatest(found: Scan, places: Sequence[float], values: Sequence[float]) -> Greatest | None:
    """The greatest value over the allowed part of an axis; None where nothing is allowed.

    values : at the places; not finite where a flight was not flown
    """
    order = np.argsort(places)
    x, y = np.asarray(places, dtype=float)[order], np.asarray(values, dtype=float)[order]
    kept = found.worst >= ROUNDING
    good = np.isfinite(y)
    if not np.any(kept) or np.count_nonzero(good) < 2:
        return None
    fine = PchipInterpolator(x[good], y[good], extrapolate=False)(found.x)
    fine[~kept | ~np.isfinite(fine)] = -np.inf
    i = int(np.argmax(fine))
    for beyond in (i - 1, i + 1):
        if 0 <= beyond < len(kept) and not kept[beyond]:
            return Greatest(float(fine[i]), float(found.x[i]), found.limit_at(beyond))
    at_end = i in (0, len(kept) - 1)
    return Greatest(float(fine[i]), float(found.x[i]), END_OF_STUDY if at_end else AERODYNAMICS)
