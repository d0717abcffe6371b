"""Contents of ratio_revisions/P/revision_N.json: how a revision was made, with the evidence behind it."""

from __future__ import annotations

from itertools import chain
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.files import Declared, LocatedError, Location, raise_located, repeated_name, suggestion
from sim_heating.base.parameters import EFFECT_PREFIX, RATIO
from sim_heating.closure.revise.checks import MIN_SIGMA
from sim_heating.closure.revise.flown_ratio import FlownRatio
from sim_heating.estimation.report.estimate_file import EstimatedParameter, is_correlation

LEAST_REACH = 1e-9
"""Least distance of independent errors in a revision, in the unit of its variable: any two nodes are further apart."""
LARGEST = 1e9
"""Largest weight, value or covariance that evidence is taken to have."""


class UsedRecord(Declared):
    """A record behind a revision: hash of its files, and the times that were used."""

    record: str
    inputs: str
    segments: list[list[float]]

    @model_validator(mode="after")
    def _check(self) -> UsedRecord:
        wrong = [i for i, s in enumerate(self.segments) if len(s) != 2 or s[0] > s[1]]
        raise_located([(("segments", i), f"{self.segments[i]} is not [start_s, end_s]") for i in wrong])
        return self


class StoredEvidence(Declared):
    """What a revision took from a flight: the ratio of the fit along the flown path, as `FlownRatio` has it."""

    names: list[str]
    covariance: list[list[float]]
    x: list[list[float]]
    weight: list[float]
    ratio: list[float]
    basis: list[list[float]]
    shape_sigma: float = Field(gt=0.0)

    @model_validator(mode="after")
    def _check(self) -> StoredEvidence:
        ratio_names, k = [p.name for p in RATIO], len(self.names)
        problems: list[tuple[Location, str]] = [
            (("names", i), f"`{n}` is not a parameter of the ratio{suggestion(n, ratio_names)}")
            for i, n in enumerate(self.names)
            if n not in ratio_names and not n.startswith(EFFECT_PREFIX)
        ]
        if repeated_name(self.names) is not None:
            problems.append((("names",), f"`{repeated_name(self.names)}` occurs twice"))
        problems += _shape_problems("covariance", self.covariance, k, k)
        problems += self._path_problems()
        numbers = {
            "covariance": chain(*self.covariance),
            "x": chain(*self.x),
            "weight": self.weight,
            "ratio": self.ratio,
            "basis": chain(*self.basis),
        }
        for key, values in numbers.items():
            if (largest := max(map(abs, values), default=0.0)) > LARGEST:
                problems.append(((key,), f"contains {largest:g}, beyond {LARGEST:g}, which no flight gives"))
        if not problems and (rule := _covariance_rule(np.array(self.covariance).reshape(k, k))):
            problems.append((("covariance",), rule))
        raise_located(problems)
        return self

    def _path_problems(self) -> list[tuple[Location, str]]:
        if not self.x:
            return [(("x",), "holds no sample")]
        count = len(self.x)
        problems = _shape_problems("x", self.x, count, len(RATIO_VARIABLES), "samples")
        problems += _shape_problems("basis", self.basis, count, len(self.names), "samples")
        problems += [
            ((key,), f"has {len(values)} values for {count} samples")
            for key, values in (("weight", self.weight), ("ratio", self.ratio))
            if len(values) != count
        ]
        if any(w <= 0.0 for w in self.weight):
            problems.append((("weight",), "must be above 0"))
        return problems

    def measurement(self) -> FlownRatio:
        """As arrays, for an update of the table before any revision."""
        k = len(self.names)
        x, weight, ratio = (np.array(v, dtype=float) for v in (self.x, self.weight, self.ratio))
        basis, covariance = np.array(self.basis, dtype=float).reshape(len(x), k), np.array(self.covariance)
        return FlownRatio(tuple(self.names), x, weight, ratio, basis, covariance.reshape(k, k), self.shape_sigma)


def stored_evidence(measured: FlownRatio | None) -> dict[str, Any] | None:
    """The content of a StoredEvidence; None for a flight that says nothing of the table."""
    if measured is None:
        return None
    arrays = {key: getattr(measured, key).tolist() for key in ("x", "weight", "ratio", "basis", "covariance")}
    return {"names": list(measured.names), **arrays, "shape_sigma": measured.shape_sigma}


def _shape_problems(
    key: str, rows: list[list[float]], height: int, width: int, rows_of: str = "names"
) -> list[tuple[Location, str]]:
    """Why a list of rows is not a matrix of this shape."""
    if len(rows) != height:
        return [((key,), f"has {len(rows)} rows for {height} {rows_of}")]
    ragged = [(i, row) for i, row in enumerate(rows) if len(row) != width]
    return [((key, i), f"has {len(row)} values where there must be {width}") for i, row in ragged]


def _covariance_rule(covariance: FloatArray) -> str | None:
    """Why a square matrix is not a covariance; None where it is one."""
    if not np.allclose(covariance, covariance.T, rtol=1e-9, atol=0.0):
        return "is not symmetric"
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if np.any(sigma < MIN_SIGMA) or not is_correlation(covariance / np.outer(sigma, sigma)):
        return "is not positive definite"
    return None


class WrittenEffect(Declared):
    """A written effect: its values, and those declared before, None where it was not declared."""

    name: str
    parameters: dict[str, float]
    before: dict[str, float] | None


class HeldFit(Declared):
    """How well the new tables hold a fit, on the fitted samples of one of its records.

    noise_floor_K  : of the record [K];  fit_K : RMSE of the fit [K]
    before_K, after_K : with the tables before and after [K], from the start of the fit
    from_entry_K   : with the new tables from the first row of the conditions on [K]
    not_held       : what else the fit has -> by how much it would reduce the error, as a root of squares [K]
    """

    noise_floor_K: float
    fit_K: float
    before_K: float
    after_K: float
    from_entry_K: float
    not_held: dict[str, float]

    @property
    def is_held(self) -> bool:
        """Whether the error with the new tables is that of the fit."""
        return holds(self.after_K, self.fit_K)


def holds(after_K: float, fit_K: float) -> bool:
    """Whether new tables hold a fit, by their errors [K]."""
    return after_K <= 1.15 * fit_K


class RevisedTurbulent(Declared):
    """What a revision made of the turbulent table; keys as in RevisionFile."""

    table: str
    parent_hash: str
    table_hash: str
    nodes_added: dict[str, list[float]] = Field(default={})
    chi_square: float
    degrees_of_freedom: int
    evidence: StoredEvidence | None
    changed: dict[str, list[float]]


class RevisionFile(Declared):
    """Contents of ratio_revisions/P/revision_N.json.

    table        : path of the table below the vehicle
    parent       : number of the revision that it was made from
    parent_hash, table_hash : of the two files' bytes
    estimate     : hash of the estimate's file
    parameters   : estimates of the ratio and of written effects
    effects      : those written into the control point's file
    in_table     : effects that the ratio table now includes, with their values in the fit
    held         : record of the estimate -> RMSE of the fit and with the tables [K], and what they do not hold
    nodes_added  : variable -> places of nodes that the table had not before
    turbulent    : the same of the turbulent table; None where it is as before
    point_parent_hash, point_hash : of that file's bytes before and after; None where no effect was written
    not_written  : estimated parameters that are not in the vehicle, with the reason
    reach        : distances from which on the errors of two nodes are taken to be independent
    chi_square   : of all evidence against the table before any of it
    changed      : nodes with another value: the five variables, ratio and sigma before and after
    """

    format: Literal["ratio-revision/1"] = "ratio-revision/1"
    control_point: str
    table: str
    revision: int
    parent: int
    parent_hash: str
    table_hash: str
    program: str
    estimate: str
    records: list[UsedRecord]
    reference_condition: dict[str, float]
    parameters: dict[str, EstimatedParameter]
    effects: list[WrittenEffect] = Field(default=[])
    in_table: list[WrittenEffect] = Field(default=[])
    held: dict[str, HeldFit] = Field(default={})
    nodes_added: dict[str, list[float]] = Field(default={})
    turbulent: RevisedTurbulent | None = None
    point_parent_hash: str | None = None
    point_hash: str | None = None
    not_written: dict[str, str]
    reach: dict[str, float]
    chi_square: float
    degrees_of_freedom: int
    evidence: StoredEvidence | None
    errors_K: dict[str, dict[str, Any]] = Field(description="record -> fit, holdout -> before, after")
    changed: dict[str, list[float]]

    @model_validator(mode="after")
    def _check(self) -> RevisionFile:
        if self.parent != self.revision - 1:
            rule = f"{self.parent} is not the revision before {self.revision}, which is {self.revision - 1}"
            raise LocatedError((("parent",), rule))
        if set(self.reach) != set(RATIO_VARIABLES) or not all(LEAST_REACH <= r <= LARGEST for r in self.reach.values()):
            raise LocatedError(
                (("reach",), f"must hold a distance from {LEAST_REACH:g} for each of {', '.join(RATIO_VARIABLES)}")
            )
        return self
