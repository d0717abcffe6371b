"""What many dispersed flights tell: quantiles and probabilities with their own confidence, and what drives them.

Bounds of quantiles are distribution-free, those of probabilities are Clopper's and Pearson's; both hold for independent
flights. The flights of one scramble of a Sobol' sequence are not independent: they fill the space more evenly, so that
estimates scatter less, as a rule, than the bounds say. Scrambles are independent of each other; what the estimates
scatter between them is told beside the bounds.

Sources: David and Nagaraja, Order Statistics (2003), section 7.1; Clopper and Pearson, Biometrika 26 (1934) 404.

Which deviations are flown: scrambled Sobol' sequences, independent flights, designs for sensitivity indices.

Everything is a function of the seed and of the flight's number, whoever computes it: a batch draws its own rows. A row
holds standard normal numbers; `deviations` makes them those of the inputs.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri
from scipy.stats import binom, binomtest, qmc

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.planning.dispersion.flight import LARGEST
from sim_heating.planning.dispersion.spec import Input

RESAMPLES = 100
"""Of the bootstrap that gives the bounds of indices."""


@dataclass(frozen=True)
class Quantile:
    """A quantile of a peak temperature.

    value      : [K]; None where flights that came to no end reach that far up
    low, high  : bounds; None where there are too few flights for them
    scatter    : standard error by the scatter between scrambles
    """

    q: float
    value: float | None
    low: float | None
    high: float | None
    scatter: float | None


@dataclass(frozen=True)
class Probability:
    """A probability with its bounds, and how many flights it is from."""

    value: float
    low: float
    high: float
    count: int
    flights: int


def quantile(x: FloatArray, q: float, confidence: float) -> tuple[float | None, float | None, float | None]:
    """A quantile and its bounds from order statistics: x_(ceil(n q)), x_(l), x_(u); x may hold NaN, the highest of all.

    P(x_(l) <= quantile <= x_(u)) >= confidence for any distribution, with l, u from Bin(n, q).
    """
    ordered = np.sort(np.where(np.isnan(x), np.inf, x))
    n, tail = len(ordered), 0.5 * (1.0 - confidence)
    lower, upper = int(binom.ppf(tail, n, q)), int(binom.ppf(1.0 - tail, n, q)) + 1
    places = (int(np.ceil(n * q - 1e-9)), lower, upper)
    value, low, high = (float(ordered[k - 1]) if 1 <= k <= n else None for k in places)
    return _finite(value), _finite(low), _finite(high)


def _finite(value: float | None) -> float | None:
    return value if value is not None and np.isfinite(value) else None


def quantiles(x: FloatArray, scramble: NDArray[np.int64], qs: Sequence[float], confidence: float) -> list[Quantile]:
    """Quantiles of (flight,) values, with the scatter between scrambles."""
    found = []
    for q in qs:
        value, low, high = quantile(x, q, confidence)
        each = [quantile(x[scramble == r], q, confidence)[0] for r in np.unique(scramble)]
        whole = [v for v in each if v is not None]
        scatter = float(np.std(whole, ddof=1) / np.sqrt(len(whole))) if len(whole) == len(each) > 1 else None
        found.append(Quantile(q, value, low, high, scatter))
    return found


def probability(happened: BoolArray, confidence: float) -> Probability:
    """Probability of what happened in some of the flights, Clopper-Pearson bounds."""
    count, flights = int(np.count_nonzero(happened)), len(happened)
    bounds = binomtest(count, flights).proportion_ci(confidence, method="exact")
    return Probability(count / flights, float(bounds.low), float(bounds.high), count, flights)


@dataclass(frozen=True)
class Indices:
    """Sobol' indices of one quantity: (group,) first order and total, with bounds (group, 2); None where it is constant
    or too few flights came to an end."""

    first: FloatArray
    total: FloatArray
    first_bounds: FloatArray
    total_bounds: FloatArray


def indices(values: FloatArray, groups: int, confidence: float, seed: int) -> Indices | None:
    """Sobol' indices from the flights of `sampling.saltelli_rows`, (groups + 2) blocks one after the other.

    Rows of which any flight came to no end are left out as a whole. Bounds are bootstrap percentiles.
    """
    blocks = values.reshape(groups + 2, -1)
    blocks = blocks[:, np.all(np.isfinite(blocks), axis=0)]
    if blocks.shape[1] < 8 or np.ptp(blocks[:2]) < 1e-9:
        return None
    first, total = _estimated(blocks)
    rng, resampled = np.random.default_rng(seed), []
    for _ in range(RESAMPLES):
        resampled.append(_estimated(blocks[:, rng.integers(0, blocks.shape[1], blocks.shape[1])]))
    tail = 0.5 * (1.0 - confidence)
    spread = np.quantile(np.array(resampled), [tail, 1.0 - tail], axis=0)
    return Indices(first, total, spread[:, 0].T, spread[:, 1].T)


def _estimated(blocks: FloatArray) -> tuple[FloatArray, FloatArray]:
    """First-order and total indices of blocks (groups + 2, base): Saltelli et al., Comput. Phys. Commun. 181 (2010)
    259, table 2, (b) and (f); scipy.stats.sobol_indices takes the same, and powers of two alone."""
    A, B, AB = blocks[0] - np.mean(blocks), blocks[1] - np.mean(blocks), blocks[2:] - np.mean(blocks)
    variance = np.var(np.concatenate((A, B)))
    return np.mean(B * (AB - A), axis=1) / variance, 0.5 * np.mean((A - AB) ** 2, axis=1) / variance


INDEX_STREAM = 1_000_003
"""Number of the scramble that the indices' flights are drawn from, apart from all others."""


def sobol_rows(dimensions: int, seed: int, scramble: int, start: int, stop: int) -> FloatArray:
    """(stop - start, dimensions) rows of one scramble of the Sobol' sequence, standard normal."""
    entropy = np.random.SeedSequence([seed, scramble])
    sequence = qmc.Sobol(dimensions, scramble=True, seed=np.random.default_rng(entropy))
    if start > 0:
        sequence.fast_forward(start)
    with warnings.catch_warnings():
        # A batch is a part of a sequence; whether the whole is balanced is for the study to choose.
        warnings.filterwarnings("ignore", message="The balance properties")
        return normal(sequence.random(stop - start))


def random_rows(dimensions: int, seed: int, scramble: int, start: int, stop: int) -> FloatArray:
    """The same of independent flights; rows hang on where the batch starts."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, scramble, start]))
    return normal(rng.random((stop - start, dimensions)))


def normal(u: FloatArray) -> FloatArray:
    """Standard normal numbers of uniform ones, within LARGEST standard deviations."""
    return np.clip(ndtri(u), -LARGEST, LARGEST)


def deviations(inputs: Sequence[Input], z: FloatArray) -> FloatArray:
    """(flight, input) deviations of standard normal rows (flight, input)."""
    columns = [i.sigma * z[:, k] if i.sigma is not None else _between(i, ndtr(z[:, k])) for k, i in enumerate(inputs)]
    return np.column_stack(columns) if columns else np.zeros((len(z), 0))


def _between(i: Input, u: FloatArray) -> FloatArray:
    assert i.low is not None  # Input says so: either sigma or both ends
    assert i.high is not None
    return i.low + (i.high - i.low) * u


def saltelli_rows(groups: Sequence[Sequence[int]], seed: int, base: int, start: int, stop: int) -> FloatArray:
    """Rows start to stop of the design A, B, AB_1, AB_2, ..., each of `base` flights, standard normal.

    groups : dimensions that go together; AB_k is A with group k from B
    Source : Saltelli et al., Comput. Phys. Commun. 181 (2010) 259, table 2, as scipy.stats.sobol_indices takes it.
    """
    dimensions = sum(len(g) for g in groups)
    rows = np.empty((stop - start, dimensions))
    for block in range(start // base, (stop - 1) // base + 1):
        first, last = max(start, block * base), min(stop, (block + 1) * base)
        both = sobol_rows(2 * dimensions, seed, INDEX_STREAM, first - block * base, last - block * base)
        chosen = both[:, dimensions:] if block == 1 else both[:, :dimensions].copy()
        if block > 1:
            swapped = list(groups[block - 2])
            chosen[:, swapped] = both[:, [dimensions + j for j in swapped]]
        rows[first - start : last - start] = chosen
    return rows


def axis_rows(dimensions: int, step: float, start: int, stop: int) -> FloatArray:
    """Rows of the design 0, +step e_1, -step e_1, +step e_2, ...: for differences about the planned flight."""
    rows = np.zeros((stop - start, dimensions))
    for k in range(start, stop):
        if k > 0:
            rows[k - start, (k - 1) // 2] = step if k % 2 == 1 else -step
    return rows
