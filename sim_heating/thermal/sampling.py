"""How a recorder samples: its rate, constant, changing at stated times, or higher in manoeuvres, and its word.

A rate r(t) that changes leaves the count of samples as it is: sample k is at the time t_k at which

    integral from t_0 to t_k of r dt = k,

so that no instant is sampled twice where a rate begins. Source: docs/theory/equations.md, equations 33a and 34.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar

import numpy as np
from pydantic import AfterValidator, Field

from sim_heating.base.arrays import FloatArray
from sim_heating.base.files import Declared, LocatedError, Location, raise_located

FASTEST_HZ = 1000.0
"""Highest sample rate [Hz]."""
USUAL_HZ = 1.0
"""Sample rate of a recorder that states none [Hz]."""
RATE_TEXT = "samples a second; [[time_s, rate], ...], each from its time on; or a table, higher in manoeuvres"


def require_span(bits: int | None, span: Sequence[float] | None, key: str) -> None:
    """Refuse a recorder word without the span that it covers.

    key    : of the span, such as `range_K`
    raises : LocatedError at `bits`
    """
    if bits is not None and span is None:
        raise LocatedError((("bits",), f"{bits} bits need `{key}`, the span that the word covers; add it"))


def word_step(bits: int | None, span: Sequence[float] | None) -> float:
    """Step of a recorder word, span / (2^bits - 1), in its unit, such as [K]; 0 where nothing is rounded.

    Source: docs/theory/equations.md, equation 34.
    """
    return 0.0 if bits is None or span is None else (span[1] - span[0]) / (2**bits - 1)


class RateInManoeuvres(Declared):
    """Sample rates of a recorder that is faster while a manoeuvre is flown."""

    quantities: ClassVar = {"manoeuvres_hz": "rate_hz", "elsewhere_hz": "rate_hz"}

    manoeuvres_hz: float = Field(gt=0.0, le=FASTEST_HZ, description="samples a second from start to end of each")
    elsewhere_hz: float = Field(default=USUAL_HZ, gt=0.0, le=FASTEST_HZ, description="samples a second otherwise")

    def __str__(self) -> str:
        return f"{self.manoeuvres_hz:g} Hz in manoeuvres, {self.elsewhere_hz:g} Hz elsewhere"


Rate = float | list[list[float]] | RateInManoeuvres


def _check_rows(rate: Rate) -> Rate:
    """Check that the rows of a schedule are pairs of increasing times and of rates."""
    rows = rate if isinstance(rate, list) else []
    problems: list[tuple[Location, str]] = []
    for i, row in enumerate(rows):
        if len(row) != 2:
            problems.append(((i,), f"{row} is not a pair [time_s, rate]"))
        elif not 0.0 < row[1] <= FASTEST_HZ:
            problems.append(((i, 1), f"{row[1]:g} is not a sample rate in Hz (above 0, up to {FASTEST_HZ:g})"))
        elif i > 0 and len(rows[i - 1]) == 2 and row[0] <= rows[i - 1][0]:
            problems.append(((i, 0), f"{row[0]:g} does not come after {rows[i - 1][0]:g}; let the times increase"))
    raise_located(problems)
    return rate


SampleRate = Annotated[
    Annotated[float, Field(gt=0.0, le=FASTEST_HZ)]
    | Annotated[list[list[float]], Field(min_length=1)]
    | RateInManoeuvres,
    AfterValidator(_check_rows),
]
"""Type of the key for samples a second."""


def sample_instants(
    rate: Rate, first_s: float, end_s: float, manoeuvres_s: Sequence[tuple[float, float]] = ()
) -> FloatArray:
    """(sample,) times from the first sample to the end, which is included [s]; empty where it comes after the end.

    rate         : samples a second [Hz], in its time [s]; the first row of a schedule holds before it as well
    manoeuvres_s : start and end of the manoeuvres that are flown [s]

    Source: docs/theory/equations.md, equation 33a.
    """
    begins, rates = _steps(rate, first_s, manoeuvres_s)
    counts = np.concatenate([[0.0], np.cumsum(np.diff(begins) * rates[:-1])])
    last = int(np.searchsorted(begins, end_s, side="right")) - 1
    if last < 0:
        return np.zeros(0)
    # The 1e-9 keeps a last sample that falls on the end but for rounding.
    k = np.arange(int(np.floor(counts[last] + (end_s - begins[last]) * rates[last] + 1e-9)) + 1)
    step = np.searchsorted(counts, k, side="right") - 1
    return np.asarray(begins[step] + (k - counts[step]) / rates[step])


def _steps(rate: Rate, first_s: float, manoeuvres_s: Sequence[tuple[float, float]]) -> tuple[FloatArray, FloatArray]:
    """(step,) times from which each rate holds, the first sample's first [s], and the rates [Hz]."""
    if isinstance(rate, RateInManoeuvres):
        edges = np.unique([first_s, *(t for window in manoeuvres_s for t in window if t > first_s)])
        flown = [any(start <= t < end for start, end in manoeuvres_s) for t in edges]
        return edges, np.where(flown, rate.manoeuvres_hz, rate.elsewhere_hz)
    if isinstance(rate, list):
        times, rates = np.array(rate, dtype=float).T
        begins = np.unique([first_s, *times[times > first_s]])
        return begins, rates[np.maximum(np.searchsorted(times, begins, side="right") - 1, 0)]
    return np.array([first_s]), np.array([rate])
