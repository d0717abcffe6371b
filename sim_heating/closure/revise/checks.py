"""What an estimate must be for a table to take it: values that are heating ratios, with a covariance that can be
weighed, about a condition that was flown.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.base.parameters import AT, EFFECT_PREFIX, SHORT_NAMES
from sim_heating.estimation.report.estimate_file import PAIR, Estimate

MIN_SIGMA = 1e-12
"""Least sigma and largest value of an estimated ratio parameter that are accepted."""


def check_estimate(estimate: Estimate, name: str) -> None:
    """Check that the ratio parameters of an estimate can be weighed against a table.

    name   : the estimate's file, for messages
    raises : InputError naming the parameter and the limit
    """
    _check_whole(estimate, name)
    labels = [label for label in estimate.parameters if label.startswith("ratio.")]
    for label in labels:
        _check_value(estimate, label, name)
    _check_correlation(estimate, labels, name)
    _check_reference(estimate, labels, name)


def _check_whole(estimate: Estimate, name: str) -> None:
    """No part of the ratio that is fixed, which has no bound, and no part of ratio or effects that is tied."""
    fixed = {n: p.value for n, p in estimate.fixed.items() if n.startswith("ratio.") and p.value != 0.0}
    for label, value in fixed.items():
        raise InputError(
            f"{name}, [fixed]: {label} was fixed at {value:g}, which no flight estimated, and the ratio of the fit has "
            "it; estimate again with it free, or fixed at 0"
        )
    tied = [(n, other) for n, other in estimate.ties.items() if n != other and n.startswith(("ratio.", EFFECT_PREFIX))]
    for label, other in tied:
        raise InputError(
            f"{name}, [ties]: {label} was tied to {other}, so that its value is not that of this control point and "
            "parameter alone; estimate again without the tie"
        )


def _check_value(estimate: Estimate, label: str, name: str) -> None:
    """A plausible value with a plausible sigma."""
    max_value = 1e3
    value, sigma = estimate.parameters[label].value, estimate.parameters[label].sigma
    where = f"{name}, [parameters.{label}]"
    if abs(value) > max_value:
        raise InputError(
            f"{where}: `value`: {value:g} is beyond {max_value:g}, which is no heating ratio; estimate it again"
        )
    if label.partition(AT)[0] == "ratio.scale" and value <= -1.0:
        raise InputError(f"{where}: `value`: {value:g} leaves no heating (-1 removes all of it); estimate it again")
    if not MIN_SIGMA <= sigma <= max_value:
        span = f"{MIN_SIGMA:g} to {max_value:g}"
        raise InputError(f"{where}: `sigma`: {sigma:g} is not within {span}; estimate it again")


def _check_correlation(estimate: Estimate, labels: list[str], name: str) -> None:
    """All correlations within each control point, and a positive definite matrix of them."""
    # least eigenvalue [-] of the correlation of ratio parameters: below it a combination of them is known exactly
    min_eigenvalue = 1e-12
    pairs = [
        (f"{a}{PAIR}{b}", f"{b}{PAIR}{a}")
        for a, b in combinations(labels, 2)
        if a.partition(AT)[2] == b.partition(AT)[2]
    ]
    missing = [pair for pair, turned in pairs if not {pair, turned} & estimate.correlation.keys()]
    if missing:
        lacking = f"{len(missing)} of {len(pairs)} pairs are missing, `{missing[0]}` first"
        raise InputError(f"{name}, [correlation]: {lacking}; estimate it again")
    values, vectors = np.linalg.eigh(estimate.correlation_matrix(tuple(labels)))
    if labels and values[0] < min_eigenvalue:
        alike = " and ".join(label for label, v in zip(labels, vectors[:, 0], strict=True) if abs(v) > 0.3)
        raise InputError(
            f"{name}, [correlation]: is not positive definite (a combination of {alike} would have no error at all); "
            "estimate fewer parameters"
        )


def _check_reference(estimate: Estimate, labels: list[str], name: str) -> None:
    """A reference condition that was flown, in the variables that an estimated derivative multiplies."""
    rounding = 1e-6  # by how much a reference condition may lie outside what was flown [deg, -]: the rounding of a mean
    terms = {term for label in labels for term in label.partition(AT)[0].rstrip("2").split("_")[1:]}
    for short, variable in zip(SHORT_NAMES, RATIO_VARIABLES, strict=True):
        flown, about = estimate.excursions.get(variable), getattr(estimate.reference_condition, variable)
        if short in terms and flown is not None and not flown.min - rounding <= about <= flown.max + rounding:
            raise InputError(
                f"{name}, [reference_condition]: `{variable}`: {about:g} lies outside the {flown.min:g} to "
                f"{flown.max:g} that were flown; estimate again with a --reference within them"
            )
