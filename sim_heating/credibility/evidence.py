"""Evidence that is shipped with the package: verification rows by topic, counted statistics, measured data sets.

`evidence.json` is made by `python -m tools.credibility` from benchmarks/results and the measured records; a test
compares it with these.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

from sim_heating.base.files import read_json
from sim_heating.credibility.validation.region import DIGITS, Band, ValidationCase

HALF_DIGIT = 0.5 * 10.0 ** (1 - DIGITS)
"""Greatest rounding error of DIGITS digits, as part of the value [-]."""
EVIDENCE = Path(__file__).with_name("evidence.json")


@dataclass(frozen=True)
class Topic:
    """Verification rows of one topic: how many, and how many of them are within their limit."""

    rows: int
    within: int

    @property
    def verified(self) -> bool:
        """Whether there are rows, and all are within their limits."""
        return 0 < self.rows == self.within


@dataclass(frozen=True)
class Claim:
    """A statistical promise, counted on records of known truth.

    of      : `estimate` or `closed loop`, the kind of result that it supports
    claim   : in words;  value : what was counted
    bound   : what it must not fall below (`at_least`) or exceed
    command : that counts it again;  file, key : where benchmarks/results has it
    """

    of: str
    claim: str
    value: float
    bound: float
    at_least: bool
    command: str
    file: str
    key: str

    @property
    def met(self) -> bool:
        """Whether the count supports the claim."""
        return self.value >= self.bound if self.at_least else self.value <= self.bound


@dataclass(frozen=True)
class Evidence:
    """What supports results made with this version.

    digest, date : of the verification rows;  topics : by name;  claims : statistics
    cases        : measured data sets with the errors of the declared predictions
    """

    digest: str
    date: str
    topics: Mapping[str, Topic]
    claims: tuple[Claim, ...]
    cases: tuple[ValidationCase, ...]

    @property
    def verified(self) -> set[str]:
        """Names of the topics that are verified."""
        return {name for name, topic in self.topics.items() if topic.verified}


@cache
def shipped_evidence() -> Evidence:
    """The content of evidence.json."""
    data = read_json(EVIDENCE)
    return Evidence(
        data["verification"]["digest"],
        data["verification"]["date"],
        {name: Topic(**t) for name, t in data["verification"]["topics"].items()},
        tuple(Claim(**c) for c in data["claims"]),
        tuple(case_from_json(c) for c in data["cases"]),
    )


def case_as_json(case: ValidationCase) -> dict[str, Any]:
    """A data set as plain data, numbers to the digits that mean something."""
    data = asdict(case)
    del data["of_user"]
    for name in ("rmse_K", "max_abs_K", "rise_K"):
        data[name] = _rounded(data[name])
    data["bands"] = [
        {
            "limits": {n: _outward(*ends) for n, ends in band.limits.items()},
            "rmse_K": _rounded(band.rmse_K),
            "n": band.n,
        }
        for band in case.bands
    ]
    return data


def case_from_json(data: Mapping[str, Any], *, of_user: bool = False) -> ValidationCase:
    """A data set from plain data."""
    bands = tuple(
        Band({n: (float(ends[0]), float(ends[1])) for n, ends in b["limits"].items()}, b["rmse_K"], b["n"])
        for b in data["bands"]
    )
    return ValidationCase(**{k: v for k, v in data.items() if k != "bands"}, bands=bands, of_user=of_user)


def _outward(low: float, high: float) -> list[float]:
    """An interval with its ends rounded away from it."""
    return [float(f"{low - abs(low) * HALF_DIGIT:.{DIGITS}g}"), float(f"{high + abs(high) * HALF_DIGIT:.{DIGITS}g}")]


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
