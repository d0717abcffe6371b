"""Designs of dispersed flights and the statistics of their peaks: which deviations are flown, and what follows of them.

Designs come first: scrambled Sobol' sequences, independent flights, Saltelli's design for sensitivity indices, and
steps along the axes. A row holds standard normal numbers; `deviations` turns them into deviations of the inputs. Every
row is a function of the seed and of the flight's number alone, so that each batch draws its own rows.

Bounds of quantiles are distribution-free, those of probabilities are Clopper's and Pearson's; both hold for independent
flights. The flights of one scramble of a Sobol' sequence are not independent: they fill the space more evenly, so that
estimates scatter less, as a rule, than the bounds state. Scrambles are independent of each other; the scatter of an
estimate between them is reported with its bounds.

Sources: David and Nagaraja, Order Statistics (2003), section 7.1; Clopper and Pearson, Biometrika 26 (1934) 404;
Saltelli et al., Comput. Phys. Commun. 181 (2010) 259.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import ndtr, ndtri
from scipy.stats import binom, binomtest, qmc

from sim_heating.base.arrays import BoolArray, FloatArray, IntArray
from sim_heating.planning.dispersion.spec import LARGEST_SIGMAS, DispersedInput

# Designs -------------------------------------------------------------------------------------------------------------

INDEX_STREAM = 1_000_003
"""Number of the scramble that flights for sensitivity indices are drawn from; no other design uses it."""


@lru_cache(maxsize=4)
def _scrambled(dimensions: int, seed: int, scramble: int) -> qmc.Sobol:
    """A scrambled Sobol' sequence at its beginning; scrambling takes longer than drawing a batch."""
    entropy = np.random.SeedSequence([seed, scramble])
    return qmc.Sobol(dimensions, scramble=True, seed=np.random.default_rng(entropy))


def sobol_rows(dimensions: int, seed: int, scramble: int, start: int, stop: int) -> FloatArray:
    """(stop - start, dimensions) rows of one scramble of the Sobol' sequence, standard normal [-]."""
    # A copy, whose place in the sequence is its own.
    sequence = copy(_scrambled(dimensions, seed, scramble))
    sequence.reset()
    if start > 0:
        sequence.fast_forward(start)
    with warnings.catch_warnings():
        # A batch is a part of a sequence; whether the whole is balanced is for the study to choose.
        warnings.filterwarnings("ignore", message="The balance properties")
        return normal_numbers(sequence.random(stop - start))


def random_rows(dimensions: int, seed: int, scramble: int, start: int, stop: int) -> FloatArray:
    """(stop - start, dimensions) rows of independent flights, standard normal [-].

    The rows depend on where the batch starts, so that two batches never share a stream.
    """
    # Seeded by the place of the batch, so that any process draws the same rows for it.
    rng = np.random.default_rng(np.random.SeedSequence([seed, scramble, start]))
    return normal_numbers(rng.random((stop - start, dimensions)))


def saltelli_rows(groups: Sequence[Sequence[int]], seed: int, base: int, start: int, stop: int) -> FloatArray:
    """Rows start to stop of the design A, B, AB_1, AB_2, ..., each of `base` flights, standard normal [-].

    groups : dimensions that belong together; AB_k is A with group k taken from B

    Source: Saltelli et al., Comput. Phys. Commun. 181 (2010) 259, table 2; scipy.stats.sobol_indices uses the same.
    """
    dimensions = sum(len(g) for g in groups)
    rows = np.empty((stop - start, dimensions))
    for block in range(start // base, (stop - 1) // base + 1):
        first, last = max(start, block * base), min(stop, (block + 1) * base)
        # A and B are the halves of one sequence of twice the dimension, which keeps them independent.
        both = sobol_rows(2 * dimensions, seed, INDEX_STREAM, first - block * base, last - block * base)
        chosen = both[:, dimensions:] if block == 1 else both[:, :dimensions].copy()
        if block > 1:
            swapped = list(groups[block - 2])
            chosen[:, swapped] = both[:, [dimensions + j for j in swapped]]
        rows[first - start : last - start] = chosen
    return rows


def axis_rows(dimensions: int, step: float, start: int, stop: int) -> FloatArray:
    """Rows start to stop of the design 0, +step e_1, -step e_1, +step e_2, ...: steps about the planned flight."""
    rows = np.zeros((stop - start, dimensions))
    for k in range(start, stop):
        if k > 0:
            rows[k - start, (k - 1) // 2] = step if k % 2 == 1 else -step
    return rows


def normal_numbers(u: FloatArray) -> FloatArray:
    """Standard normal numbers from uniform ones [-], within LARGEST_SIGMAS of 0."""
    return np.clip(ndtri(u), -LARGEST_SIGMAS, LARGEST_SIGMAS)


def deviations(inputs: Sequence[DispersedInput], z: FloatArray) -> FloatArray:
    """(flight, input) deviations, each in the unit of its input, from standard normal rows (flight, input)."""
    columns = [i.sigma * z[:, k] if i.sigma is not None else _uniform(i, ndtr(z[:, k])) for k, i in enumerate(inputs)]
    return np.column_stack(columns) if columns else np.zeros((len(z), 0))


def choices(shares: FloatArray, z: FloatArray) -> IntArray:
    """(flight,) number of the alternative that each flight has, by (alternative,) shares of 1; 0 has the likeliest.

    z : (flight,) standard normal numbers
    """
    first = int(np.argmax(shares))
    order = np.array([first, *(k for k in range(len(shares)) if k != first)])
    # The likeliest lies about the middle of the distribution, where the planned flight is.
    u = (ndtr(z) - 0.5 + 0.5 * shares[first]) % 1.0
    return np.asarray(order[np.searchsorted(np.cumsum(shares[order])[:-1], u, side="right")])


def _uniform(i: DispersedInput, u: FloatArray) -> FloatArray:
    assert i.low is not None  # DispersedInput has either sigma or both ends
    assert i.high is not None
    return i.low + (i.high - i.low) * u


# Quantiles and probabilities -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Quantile:
    """A quantile of a peak temperature.

    value     : [K]; None where it lies among flights that were not completed
    low, high : its bounds [K]; None where there are too few flights for them
    scatter   : standard error from the scatter between scrambles [K]
    """

    q: float
    value: float | None
    low: float | None
    high: float | None
    scatter: float | None


@dataclass(frozen=True)
class Probability:
    """A probability with its bounds, from `count` of `flights`."""

    value: float
    low: float
    high: float
    count: int
    flights: int


def quantile(x: FloatArray, q: float, confidence: float) -> tuple[float | None, float | None, float | None]:
    """A quantile and its bounds from order statistics: x_(ceil(n q)), x_(l), x_(u).

    P(x_(l) <= quantile <= x_(u)) >= confidence for any distribution, with l, u from Bin(n, q).

    x : (flight,) values; NaN counts as the highest of all
    """
    # An unknown peak sorts above all others: a quantile among them has no value instead of one that is too low.
    ordered = np.sort(np.where(np.isnan(x), np.inf, x))
    n, tail = len(ordered), 0.5 * (1.0 - confidence)
    lower, upper = int(binom.ppf(tail, n, q)), int(binom.ppf(1.0 - tail, n, q)) + 1
    # Without the 1e-9 an n q that is whole but for rounding would take the next value up.
    ranks = (int(np.ceil(n * q - 1e-9)), lower, upper)
    value, low, high = (float(ordered[k - 1]) if 1 <= k <= n else None for k in ranks)
    return _finite(value), _finite(low), _finite(high)


def _finite(value: float | None) -> float | None:
    return value if value is not None and np.isfinite(value) else None


def quantiles(x: FloatArray, scramble: IntArray, qs: Sequence[float], confidence: float) -> list[Quantile]:
    """Quantiles of (flight,) values, with the scatter between scrambles; scramble : (flight,) number of each one's."""
    estimates = []
    for q in qs:
        value, low, high = quantile(x, q, confidence)
        each = [quantile(x[scramble == r], q, confidence)[0] for r in np.unique(scramble)]
        finite = [v for v in each if v is not None]
        scatter = float(np.std(finite, ddof=1) / np.sqrt(len(finite))) if len(finite) == len(each) > 1 else None
        estimates.append(Quantile(q, value, low, high, scatter))
    return estimates


def probability(happened: BoolArray, confidence: float) -> Probability:
    """Probability of an event from (flight,) whether it happened, with Clopper-Pearson bounds."""
    count, flights = int(np.count_nonzero(happened)), len(happened)
    bounds = binomtest(count, flights).proportion_ci(confidence, method="exact")
    return Probability(count / flights, float(bounds.low), float(bounds.high), count, flights)


# Sensitivity indices -------------------------------------------------------------------------------------------------

RESAMPLES = 100
"""Bootstrap samples that give the bounds of indices."""
FEWEST_ROWS, CONSTANT_K = 8, 1e-9
"""Fewer complete rows of the design, or a peak that varies by less [K], give no indices."""


@dataclass(frozen=True)
class Indices:
    """Sobol' indices of one quantity [-]: (group,) first order and total, with bounds (group, 2)."""

    first: FloatArray
    total: FloatArray
    first_bounds: FloatArray
    total_bounds: FloatArray


@dataclass(frozen=True)
class AdditiveModel:
    """A sum of parabolas, one a normal number: what it explains of a quantity is exact, and need not be sampled.

    coefficients : (terms, dimension) of the normalised Hermite polynomials z and (z^2 - 1)/sqrt(2), in that order
    """

    coefficients: FloatArray

    def __call__(self, z: FloatArray) -> FloatArray:
        """(flight,) values about their mean from (flight, dimension) normal numbers."""
        terms = _hermite(z, len(self.coefficients))
        return np.asarray(sum(t @ c for t, c in zip(terms, self.coefficients, strict=True)) + np.zeros(len(z)))

    def variance(self, columns: Sequence[int]) -> float:
        """Exact variance due to some dimensions: that of a sum of independent parabolas."""
        return float(np.sum(self.coefficients[:, list(columns)] ** 2))


def _hermite(z: FloatArray, terms: int) -> list[FloatArray]:
    return [z, (z**2 - 1.0) / np.sqrt(2.0)][:terms]


def additive_model(z: FloatArray, values: FloatArray, slope: FloatArray) -> AdditiveModel:
    """Parabolas by least squares through flights (flight, dimension), (flight,), four or more for each coefficient.

    slope : (dimension,) of the first order, which makes the model where there are fewer

    Flights without a value are left out. The flights must not be those of the indices, which would be biased.
    """
    z, values = z[np.isfinite(values)], values[np.isfinite(values)]
    terms = min(2, max(0, (len(values) // 4 - 1) // z.shape[1]))
    if terms == 0:
        return AdditiveModel(np.where(np.isfinite(slope), slope, 0.0)[np.newaxis])
    basis = np.column_stack([np.ones(len(z)), *_hermite(z, terms)])
    fitted = np.linalg.lstsq(basis, values, rcond=None)[0][1:]
    return AdditiveModel(np.asarray(fitted, dtype=float).reshape(terms, z.shape[1]))


def indices(
    values: FloatArray,
    groups: Sequence[Sequence[int]],
    confidence: float,
    seed: int,
    z: FloatArray,
    model: AdditiveModel,
) -> Indices | None:
    """Sobol' indices from the flights of `saltelli_rows`; None where the values are constant or too few are known.

    values : (groups + 2 blocks of `base` flights,); rows of the design with a NaN in any block are left out as a whole
    groups : dimensions that belong together
    z      : (flight, dimension) rows of the design
    model  : from other flights; only what it leaves unexplained is sampled (a control variate), which changes no
             expectation and makes the bounds narrower the better it is

    Bounds are bootstrap percentiles.
    """
    blocks, modelled = (x.reshape(len(groups) + 2, -1) for x in (values, model(z)))
    complete = np.all(np.isfinite(blocks), axis=0)
    blocks, modelled = blocks[:, complete], modelled[:, complete]
    if blocks.shape[1] < FEWEST_ROWS or np.ptp(blocks[:2]) < CONSTANT_K:
        return None
    exact = np.array([model.variance(columns) for columns in groups])

    def estimate(rows: IntArray | slice) -> tuple[FloatArray, FloatArray]:
        of_values, of_model = _partial_variances(blocks[:, rows]), _partial_variances(modelled[:, rows])
        variance = of_values[0] - of_model[0] + np.sum(exact)
        first, total = (exact + f - m for f, m in zip(of_values[1:], of_model[1:], strict=True))
        return first / variance, total / variance

    first, total = estimate(slice(None))
    rng = np.random.default_rng(seed)
    resampled = [estimate(rng.integers(0, blocks.shape[1], blocks.shape[1])) for _ in range(RESAMPLES)]
    tail = 0.5 * (1.0 - confidence)
    spread = np.quantile(np.array(resampled), [tail, 1.0 - tail], axis=0)
    return Indices(first, total, spread[:, 0].T, spread[:, 1].T)


def _partial_variances(blocks: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Variance, and those of first order and in total by group, of blocks (groups + 2, base).

    Source: Saltelli et al. (2010), table 2, (b) and (f). scipy.stats.sobol_indices uses the same, but accepts only
    powers of two.
    """
    # Centred on the common mean: the product for the first order has less scatter about 0.
    A, B, AB = blocks[0] - np.mean(blocks), blocks[1] - np.mean(blocks), blocks[2:] - np.mean(blocks)
    variance = float(np.var(np.concatenate((A, B))))
    return variance, np.mean(B * (AB - A), axis=1), 0.5 * np.mean((A - AB) ** 2, axis=1)
