"""Contents of `estimate.json`: values, bounds and correlations, and the inputs they were made from.

The keys are those of the format "estimate/1", and in addition what a later reader needs to use the result: the control
point, the segments that were fitted, the excursions that were flown in them, the program, and a hash of each record's
files. Further keys are kept. The covariance is C_ij = rho_ij sigma_i sigma_j (docs/theory/estimation_statistics.md,
equation 18); a pair that is not listed is uncorrelated.

The `digest` is that of all other keys: an estimate that was changed after it was written is not read, since its numbers
would go into tables as if a flight had given them.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from sim_heating.base import files
from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.base.limits import limit_message, out_of_range
from sim_heating.base.parameters import AT, MODEL

NAME = "estimate.json"
PAIR = "|"
"""Between the two names of a correlation."""
SLACK = 1e-6
"""Negative eigenvalue of a correlation matrix that is accepted as rounding [-]."""
NOT_A_CORRELATION = "is not a correlation matrix (it has a negative eigenvalue)"


class EstimatedParameter(files.Extensible):
    """One parameter.

    value, sigma : estimate and one standard deviation, corrected for coloured residuals, in `unit`
    unit         : contract unit
    white_sigma  : standard deviation before that correction
    prior_mean, prior_sigma : of the prior that was used; None where it was flat
    lower, upper : bounds that were stated for it; None where none were

    Source: docs/theory/estimation_statistics.md, equations 18 (white) and 22 (corrected).
    """

    value: float
    sigma: float = Field(ge=0.0, description="one standard deviation")
    unit: str
    white_sigma: float | None = Field(default=None, ge=0.0)
    prior_mean: float | None = None
    prior_sigma: float | None = Field(default=None, ge=0.0)
    lower: float | None = None
    upper: float | None = None

    @property
    def prior(self) -> tuple[float, float]:
        """Mean and standard deviation of the prior, in `unit`; infinite standard deviation for a flat one."""
        return self.prior_mean or 0.0, math.inf if self.prior_sigma is None else self.prior_sigma

    @property
    def known_before(self) -> str:
        """Prior and bounds in words; empty where the prior was flat and there was no bound."""
        prior = "" if self.prior_sigma is None else f"{self.prior_mean or 0.0:g} +- {self.prior_sigma:g}"
        if self.lower is None or self.upper is None:
            return prior
        bounds = f"{self.lower:g} to {self.upper:g}"
        return f"{prior}, {bounds}" if prior else bounds


class Remark(files.Extensible):
    """Something about an estimate that nature does not have, or that its sigma or its errors do not say.

    kind       : `emittance above 1`, `negative ratio`, `negative conductivity`, `on its bound`, `far from prior`,
                 `correlated`, `misfit as noise` or `end of range`
    parameters : names of the parameters that it is about; empty where it is about readings
    message    : what was found
    meaning    : what it usually means
    """

    kind: str
    parameters: list[str]
    message: str
    meaning: str

    @property
    def in_words(self) -> str:
        """What was found and what it usually means, in a sentence."""
        return f"{self.message}: {self.meaning}"


class FixedParameter(files.Extensible):
    """A parameter that was not estimated, at a value that is not the declared one.

    value : the value, in `unit`
    """

    value: float
    unit: str


class FitErrors(files.Extensible):
    """Pooled residuals [K] of the plain march at the estimated parameters, and their number.

    n : number of readings
    """

    rmse_K: float = Field(ge=0.0)
    max_abs_K: float = Field(ge=0.0)
    n: int = Field(ge=0)


class InnovationErrors(FitErrors):
    """Readings less the filter's predictions from those before them [K]: what a fit with process noise minimises.

    normalised_rms : RMS of the innovations over the standard deviations that the filter states for them [-]

    Source: docs/theory/estimation_statistics.md, equation 32.
    """

    normalised_rms: float = Field(ge=0.0)


class ReferenceCondition(files.Extensible):
    """The condition that the derivatives are about ([deg], log10 Re [-])."""

    alpha_deg: float
    beta_deg: float
    log10_re: float
    elevon_deg: float
    bodyflap_deg: float

    @model_validator(mode="after")
    def _check(self) -> ReferenceCondition:
        values = {name: getattr(self, name) for name in RATIO_VARIABLES}
        problems = [
            ((name,), limit_message(name, value)) for name, value in values.items() if out_of_range(name, value)
        ]
        files.raise_located(problems)
        return self

    def values(self) -> FloatArray:
        """(5,) alpha, beta [deg], log10 Re [-], elevon, bodyflap [deg]: the order of a ratio table.

        The variables of docs/theory/equations.md, section 2.
        """
        return np.array([getattr(self, name) for name in RATIO_VARIABLES])


class Excursion(files.Extensible):
    """Least and greatest value of a variable over the fitted samples ([deg], log10 Re [-]).

    min, max : least and greatest value
    """

    min: float
    max: float


class FittedEffect(files.Extensible):
    """An effect of the fitted model with all its values, estimated or fixed.

    control_point : to which it belongs, in a fit of several
    name : name of the effect
    parameters : value of each of its parameters
    """

    name: str
    parameters: dict[str, float]
    control_point: str | None = None


class FittedStart(files.Extensible):
    """Where the march of a fit began that did not begin with the record.

    time_s  : time [s]
    profile : [depth from the outer surface [m], temperature [K]] there, at the values found
    """

    time_s: float
    profile: list[list[float]] = Field(min_length=2)

    @model_validator(mode="after")
    def _check(self) -> FittedStart:
        wrong = [i for i, row in enumerate(self.profile) if len(row) != 2]
        files.raise_located([(("profile", i), f"{self.profile[i]} is not [depth_m, T_K]") for i in wrong])
        return self


class FittedError(files.Extensible):
    """The error of the model that was integrated out of the likelihood: of the heating, as large as the readings say.

    relative      : standard deviation over the heating
    correlation_s : correlation time

    Source: docs/theory/model_error.md, equation 5.
    """

    relative: float = Field(ge=0.0)
    correlation_s: float = Field(gt=0.0)


class Estimate(files.Extensible):
    """Contents of estimate.json.

    records             : directories of the records, as given to the command
    converged, iterations : how the search ended, and its number of steps
    reference_condition : condition that the derivatives are about
    parameters          : by dotted name
    fixed               : by dotted name, parameters that were fixed
    ties                : name of a parameter -> that of `parameters` which stands for it, where some were tied
    not_estimated       : name -> reason
    correlation         : "a|b" -> correlation of two parameters [-]
    noise_floor_K       : root mean square of noise and rounding over the fitted samples [K]
    fit, holdout        : errors over the segments; None where there is none
    innovations         : errors of the filter's predictions over the fit segments; None without process noise
    control_point       : to which the parameters belong; None in a fit of several points
    vehicle             : as the record names it
    segments            : fitted [start, end] times [s] of each record; None: as the records declare
    starts              : by record, None for one whose march began with it; None: of all
    excursions          : by variable, over the fitted samples
    inputs              : record -> hash of its files, `record_digest`
    effects             : those of the fitted model, in addition to what the records declare
    program             : name and version
    provenance          : command, inputs with their digests, seed, versions, platform
    record_names        : of each record, as in the names of its parameters; None: those of the directories
    remarks             : on estimates that nature does not have, or that mean less than their sigma says
    model_error         : that the fit had; None for one that knows the noise alone
    finding             : of the closed loop whose best model this is the fit of; None for an estimate by itself
    """

    format: Literal["estimate/1"]
    records: list[str] = Field(min_length=1, description="directories of the records")
    converged: bool
    iterations: int = Field(ge=0)
    reference_condition: ReferenceCondition
    parameters: dict[str, EstimatedParameter]
    fixed: dict[str, FixedParameter] = Field(default={})
    ties: dict[str, str] = Field(default={})
    not_estimated: dict[str, str] = Field(default={})
    correlation: dict[str, float] = Field(default={})
    noise_floor_K: float | None = None
    fit: FitErrors | None = None
    holdout: FitErrors | None = None
    innovations: InnovationErrors | None = None
    control_point: str | None = None
    vehicle: str | None = None
    segments: list[list[list[float]]] | None = None
    starts: list[FittedStart | None] | None = None
    excursions: dict[str, Excursion] = Field(default={})
    inputs: dict[str, str] = Field(default={})
    effects: list[FittedEffect] = Field(default=[])
    program: str | None = None
    provenance: dict[str, Any] | None = None
    record_names: list[str] | None = None
    remarks: list[Remark] = Field(default=[])
    model_error: FittedError | None = None
    finding: str | None = None

    def __repr__(self) -> str:
        values = ", ".join(f"{n}={p.value:.5g} +- {p.sigma:.2g} {p.unit}" for n, p in self.parameters.items())
        names = ", ".join(self.record_names or [Path(record).name for record in self.records])
        return f"Estimate({names}: {values}; {'converged' if self.converged else 'not converged'})"

    @model_validator(mode="after")
    def _check(self) -> Estimate:
        files.raise_located([*self._parameter_problems(), *self._correlation_problems(), *self._segment_problems()])
        # a table update weighs the estimate by its covariance, which must not have a negative variance in any direction
        if not is_correlation(self.correlation_matrix(tuple(self.parameters))):
            raise files.LocatedError((("correlation",), NOT_A_CORRELATION))
        return self

    def _parameter_problems(self) -> list[tuple[files.Location, str]]:
        """Ratio parameters that do not exist, or have another unit."""
        ratio_names = [name for name in MODEL if name.startswith("ratio.")]
        problems: list[tuple[files.Location, str]] = []
        for label, p in self.parameters.items():
            name = label.partition(AT)[0]
            if name.startswith("ratio.") and name not in MODEL:
                problems.append((("parameters", name), f"unknown parameter{files.suggestion(name, ratio_names)}"))
            elif name in MODEL and p.unit != MODEL[name].unit:
                rule = f'"{p.unit}" is not the unit of {name}; it is "{MODEL[name].unit}"'
                problems.append((("parameters", name, "unit"), rule))
        return problems

    def _segment_problems(self) -> Iterator[tuple[files.Location, str]]:
        for key, entries in (("segments", self.segments), ("starts", self.starts)):
            if entries is not None and len(entries) != len(self.records):
                yield (key,), f"has {len(entries)} entries for {len(self.records)} records"
        for i, segments in enumerate(self.segments or []):
            for j, s in enumerate(segments):
                if len(s) != 2 or s[0] > s[1]:
                    yield ("segments", i, j), f"{s} is not a segment; give [start_s, end_s] with start before end"

    def _correlation_problems(self) -> list[tuple[files.Location, str]]:
        problems: list[tuple[files.Location, str]] = []
        for pair, rho in self.correlation.items():
            names = pair.split(PAIR)
            unknown = [n for n in names if n not in self.parameters]
            if len(names) != 2 or names[0] == names[1]:
                problems.append((("correlation", pair), 'is not a pair; write "a|b" with two parameters'))
            elif unknown:
                problems.append((("correlation", pair), f"{unknown[0]} is not among the parameters"))
            elif abs(rho) > 1.0:
                problems.append((("correlation", pair), f"{rho:g} must lie within -1 to 1"))
            elif self.correlation.get(PAIR.join(reversed(names)), rho) != rho:
                problems.append((("correlation", pair), "is given in both orders with two values; remove one"))
        return problems

    def correlation_matrix(self, names: Sequence[str]) -> FloatArray:
        """(n, n) correlation [-] of the named parameters; 0 for a pair that is not listed.

        Source: docs/theory/estimation_statistics.md, equation 18.
        """
        return correlation_matrix(self.correlation, names)

    def values(self, names: Sequence[str]) -> FloatArray:
        """(n,) estimated values of the named parameters, each in its contract unit ([-] for a ratio).

        The most probable values, docs/theory/estimation_statistics.md, equation 13.
        """
        return np.array([self.parameters[n].value for n in names])

    def covariance(self, names: Sequence[str]) -> FloatArray:
        """(n, n) covariance of the named parameters, marginal over the others: rho_ij sigma_i sigma_j.

        In products of the contract units ([-] for ratios). Source: docs/theory/estimation_statistics.md, equations 18
        and 22.
        """
        sigma = np.array([self.parameters[n].sigma for n in names])
        return self.correlation_matrix(names) * np.outer(sigma, sigma)


def correlation_matrix(stated: Mapping[str, float], names: Sequence[str]) -> FloatArray:
    """(n, n) correlation [-] of names, of which each pair `a|b` is stated in one order; 0 for a pair that is not.

    Source: docs/theory/estimation_statistics.md, equation 18.
    """
    rho = np.eye(len(names))
    for i, a in enumerate(names):
        for j, b in enumerate(names):
            if i != j:
                rho[i, j] = stated.get(f"{a}{PAIR}{b}", stated.get(f"{b}{PAIR}{a}", 0.0))
    return rho


def is_correlation(rho: FloatArray) -> bool:
    """Whether a symmetric (n, n) matrix with unit diagonal gives no combination a negative variance, to rounding."""
    return bool(np.linalg.eigvalsh(rho).min(initial=1.0) >= -SLACK)


def correlations(names: Sequence[str], covariance: FloatArray) -> dict[str, float]:
    """Entries of `correlation` for a covariance matrix: each pair of names once, in their order.

    covariance : (n, n)
    returns    : "a|b" -> C_ij / (sigma_i sigma_j) [-], clipped to -1 ... 1; 0 where a sigma is 0

    Source: docs/theory/estimation_statistics.md, equation 18.
    """
    sigma = np.sqrt(np.diag(covariance))
    # a parameter on its bound has sigma 0 and no correlation
    scale = np.where(sigma > 0.0, sigma, 1.0)
    return {
        f"{a}{PAIR}{b}": float(np.clip(covariance[i, j] / (scale[i] * scale[j]), -1.0, 1.0))
        for i, a in enumerate(names)
        for j, b in enumerate(names)
        if i < j
    }


def estimate_path(path: str | os.PathLike[str]) -> Path:
    """The file of an estimate: as it is named, or the estimate.json in a directory."""
    return Path(path) / NAME if os.path.isdir(path) else Path(path)


def read_estimate(path: str | os.PathLike[str]) -> Estimate:
    """Read an estimate.json, or the one in a directory.

    raises : InputError with one line for each problem, naming file, key and value; also where the file was changed
             after it was written, or carries no digest by which that could be seen
    """
    file = estimate_path(path)
    data, name = files.read_json(file), files.display_path(file)
    # both are in output directories and are easily confused
    if str(data.get("format")).startswith("closure-report/"):
        raise InputError(f"{name}: is a closure report; give an estimate.json")
    estimate = files.check({k: v for k, v in data.items() if k != files.DIGEST}, Estimate, name)
    if files.DIGEST not in data:
        raise InputError(
            f"{name}: has no `{files.DIGEST}`, by which a change of the file could be seen (an earlier version wrote "
            "none); estimate again"
        )
    if not files.digest_matches(data):
        raise InputError(
            f"{name}: was changed after it was written (its content is not that of its `{files.DIGEST}`); undo the "
            "change, or estimate again"
        )
    return estimate


def write_estimate(path: str | os.PathLike[str], estimate: Estimate) -> None:
    """Write an estimate with its digest, atomically; it reads back equal. Empty optional keys are omitted."""
    data = estimate.model_dump()
    data["parameters"] = {n: {k: v for k, v in p.items() if v is not None} for n, p in data["parameters"].items()}
    of_records = ("control_point", "vehicle", "segments", "excursions", "inputs", "effects", "record_names")
    optional = (*of_records, "program", "provenance", "fixed", "ties", "remarks", "model_error", "finding")
    data["effects"] = [{k: v for k, v in e.items() if v is not None} for e in data["effects"]]
    data = {k: v for k, v in data.items() if k not in optional or v not in (None, {}, [])}
    files.write_json(path, files.with_digest(files.with_provenance(data)))


def excursions(conditions: Sequence[FloatArray]) -> dict[str, Excursion]:
    """Least and greatest values of the ratio variables over fitted samples.

    conditions : by record, (sample, 5) alpha, beta [deg], log10 Re [-], elevon, bodyflap [deg]
    returns    : variable -> its range

    The variables of docs/theory/equations.md, section 2.
    """
    every = np.concatenate(conditions)
    return {
        name: Excursion(min=float(every[:, i].min()), max=float(every[:, i].max()))
        for i, name in enumerate(RATIO_VARIABLES)
    }
