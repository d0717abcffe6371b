"""Which deviations are flown: scrambled Sobol' sequences, independent flights, designs for sensitivity indices.

Everything is a function of the seed and of the flight's number, whoever computes it: a batch draws its own rows. A row
holds standard normal numbers; `deviations` makes them those of the inputs.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri
from scipy.stats import qmc

from sim_heating.planning.dispersed_flight import LARGEST
from sim_heating.planning.dispersion_spec import Input

FloatArray = NDArray[np.float64]

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
