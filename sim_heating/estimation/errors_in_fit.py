"""Errors of the models of records as part of a fit: as large as the readings say, integrated out of the likelihood.

docs/theory/model_error.md, equations 1 to 5. Responses are taken about the values that the fit starts from, then about
those that it has found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.estimation.inference.error_likelihood import model_error
from sim_heating.estimation.inference.error_size import error_size
from sim_heating.estimation.inference.model_error import ErrorSize, HeatingErrorPrior, StatedError
from sim_heating.estimation.problem import FitProblem


def with_stated_errors(
    problem: FitProblem, values: FloatArray, stated: Sequence[StatedError], *, sized: bool = True
) -> tuple[FitProblem, ErrorSize | None]:
    """A problem with the errors of its records, and what the readings say of the size of the heating's.

    values : (parameter,) that responses [K] are about, each in its unit
    stated : by record
    sized  : whether the errors have the root mean square of the sizes that the readings allow, and the likeliest
             correlation; else those of the priors
    raises : RunError where the model cannot be marched

    Source: docs/theory/model_error.md, equations 2 and 5.
    """
    errors = [
        None if s.heating is None else model_error(r, values, s.heating.relative, s.heating.middle, s.flight)
        for r, s in zip(problem.record_fits, stated, strict=True)
    ]
    noisy = problem.with_model_errors(errors)
    prior = next((s.heating for s in stated if s.heating is not None and s.heating.relative > 0.0), None)
    if prior is None:
        return noisy, None
    size = _size(noisy, values, stated, prior)
    if sized:
        alike = size.likeliest[1]
        noisy = problem.with_model_errors([e and (e.of_size(size.rms, alike) if e.sigma > 0.0 else e) for e in errors])
    return noisy, size


def _size(noisy: FitProblem, values: FloatArray, stated: Sequence[StatedError], prior: HeatingErrorPrior) -> ErrorSize:
    """What the readings of all records with one prior say of the size of the heating's error."""
    samples = noisy.samples(values)
    information = np.array([p.sigma**-2.0 for p in noisy.parameters])
    distance = np.array([p.value for p in noisy.parameters]) - values
    found = [
        error_size(
            r, [x for x in samples if x.record_fit is r], (information[r.index], distance[r.index]),
            np.ones(len(r.index), dtype=bool), prior,
        )
        for r, s in zip(noisy.record_fits, stated, strict=True)
        if s.heating == prior
    ]  # fmt: skip
    return replace(found[0], log_likelihood=np.sum([f.log_likelihood for f in found], axis=0))
