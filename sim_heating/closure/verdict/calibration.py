"""How often findings are right: counted on records of known truth, and stated with every new finding.

closure_calibration.json holds what `python -m benchmarks.closure_calibration` has counted: the adequacy of models that
hold the truth, findings in records that lack nothing, and the coefficients of

    P(right) = 1 / (1 + exp(-b . f))

with the features f of a finding (`features`). Source of the form: logistic regression, Cox (1958), J. R. Stat. Soc. B
20, 215.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import betaincinv

from sim_heating.base.arrays import FloatArray
from sim_heating.base.files import read_json
from sim_heating.closure.verdict.policy import POLICY

CALIBRATION = Path(__file__).with_name("closure_calibration.json")
FEATURES = (
    "constant", "log(1 + rival)", "log10 p", "explained", "set", "none", "further effects", "log(1 + disqualified)",
    "no effect",
)  # fmt: skip
STATED = ("found", "one of", "none")
"""Findings that have a probability; the others say that they do not know."""


@cache
def calibration() -> dict[str, Any]:
    """The contents of closure_calibration.json."""
    return dict(read_json(CALIBRATION))


def features(
    finding: str,
    rival: float,
    p_value: float | None,
    explained: float,
    effects: int,
    disqualified: float = 0.0,
    no_effect: bool = False,
) -> FloatArray:
    """(feature,) what the probability of a finding follows from, in the order of FEATURES [-].

    rival        : score of the best other hypothesis above that of the finding
    p_value      : of its adequacy;  explained : part of the excess chi-square that it explains
    effects      : how many causes are named together
    disqualified : by how much the score of the finding is above that of the best hypothesis that may not be named
    no_effect    : whether what is named is a fault of flight, wall, sensor or table
    """
    p = 1.0 if p_value is None else max(float(p_value), POLICY.min_p_value)
    apart, beaten = (min(max(float(x), 0.0), 1e6) for x in (rival, disqualified))  # beyond, a distance says no more
    return np.array([
        1.0, math.log1p(apart), math.log10(p), float(np.clip(explained, 0.0, 1.0)), finding == "one of",
        finding == "none", max(effects - 1, 0), math.log1p(beaten), no_effect,
    ], dtype=float)  # fmt: skip


def probability(finding: str, of_finding: FloatArray) -> float | None:
    """Probability that a finding is right; None for one that states nothing, or where no coefficients are at hand.

    of_finding : (feature,) its features [-]
    """
    coefficients = calibration().get("coefficients")
    if finding not in STATED or coefficients is None:
        return None
    return probability_by(of_finding, np.array(coefficients))


def probability_by(of_finding: FloatArray, coefficients: FloatArray) -> float:
    """Probability by features and their coefficients, at most `Policy.max_probability` [-]."""
    return min(float(logistic(of_finding @ coefficients)), POLICY.max_probability)


def logistic(x: Any) -> Any:
    """1 / (1 + exp(-x)) [-]."""
    return 1.0 / (1.0 + np.exp(-np.clip(x, -40.0, 40.0)))


def true_statistics() -> FloatArray:
    """(record,) statistics of the adequacy of records fitted with the true model, ascending [-]."""
    return np.sort(np.asarray(calibration()["true_statistics"], dtype=float))


def false_alarm_statement() -> str:
    """The chance of a false alarm with its calibration, in one line."""
    named, records = int(calibration()["named"]), int(calibration()["records"])
    limit = float(betaincinv(named + 1, records - named, POLICY.confidence))
    return (
        f"An effect was named in {named} of {records} synthetic records that had none: chance of a false alarm below "
        f"{limit:.1%} with {POLICY.confidence:.0%} confidence on such records"
    )
