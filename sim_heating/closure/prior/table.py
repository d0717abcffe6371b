"""What a declared ratio table with a sigma says of magnitude and derivatives along a flown path, before any reading.

With errors e of the table, of covariance K, the projection P of flown_path.py gives theta = P e, so that

    theta ~ N(0, T),   T = P K P'

- A table with a `sigma` column has K of its nodes (heating/ratio/uncertainty.py): sigma_i sigma_j times the correlation
  over the axes with more than one node. Against a variable with one node it declares that the ratio does not depend on
  it, and no reading can change what it has no node for: such a derivative is left out.
- A table without sigma states nothing. It is given DEFAULT_SIGMA of its ratio, correlated over the same lengths in all
  five variables, as a weak prior; no derivative is left out.

Where table and bounds are right, estimates with flat priors are theta_hat ~ N(0, S), S = T + C, with the table's T
and the bounds C of the fit, corrected for colour. theta_hat' S^-1 theta_hat is then chi-square distributed
(docs/theory/equations.md, equation 17). A parameter is named where it is off by more than three of its sigma,
S_kk^(1/2). Where none is and all together are, the combination is named that is: the eigenvector of S, scaled to ones
on its diagonal, that contributes most. Variances of combinations follow from correlations of the table's errors, which
are assumed; so for these a share of every variance counts as independent of the others.

A fit with flat priors has no error of the model in it: it takes that for an error of the table. Where the model has
one, the estimates are those with both, and with priors, which do not know how the errors of a table go together. With
their information D, diagonal, and the covariance C of the fit, the readings leave (C^-1 - D)^-1 by themselves, and

    S = G T G' + G C,   G = 1 - C D

Without priors D = 0 and G = 1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.files.text import listed
from sim_heating.base.parameters import MODEL, Parameter
from sim_heating.closure.prior.flown_path import FlownPath, projection, record_path
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.inference.newton import Fit
from sim_heating.estimation.inference.observability import variables_of
from sim_heating.heating.ratio.table import SMALLEST_SIGMA, RatioTable
from sim_heating.heating.ratio.uncertainty import correlation, node_weights, prior_covariance
from sim_heating.inputs.record import Record

DEFAULT_SIGMA = 0.25
"""Sigma over ratio of a table that states none [-]: about the least of the windward tables of the orbiter, so that a
table of which nothing is known is not trusted more than those of which something is."""


@dataclass(frozen=True, eq=False)
class TablePrior:
    """The normal prior of a table for the parameters of the linear model, mean 0.

    names      : (k,) parameters of the linear model
    covariance : (k, k) T, in the units of the parameters
    stated     : whether the table has a sigma; else T follows from DEFAULT_SIGMA
    """

    names: tuple[str, ...]
    covariance: FloatArray
    stated: bool

    @property
    def sigma(self) -> FloatArray:
        """(k,) standard deviations in the units of the parameters."""
        return np.sqrt(np.diag(self.covariance))

    def parameters(self) -> dict[str, Parameter]:
        """Name -> definition with the standard deviation of the prior; correlations between them are left out."""
        return {n: replace(MODEL[n], sigma=float(s)) for n, s in zip(self.names, self.sigma, strict=True)}


def has_sigma(table: RatioTable) -> bool:
    """Whether a table states the uncertainty of its ratio; a column of zeros states none."""
    return table.sigma is not None and bool(np.any(table.sigma > 0.0))


def undeclared_derivatives(record: Record, names: Sequence[str]) -> dict[str, str]:
    """Derivatives that the declared table has no node for and states no error of, with the reason for leaving them out.

    names   : parameters;  returns : name -> reason, empty for a record without a table or for a table without sigma
    """
    table = record.ratio_table
    if table is None or not has_sigma(table):
        return {}
    nodes = [len(axis) for axis in table.axes]
    return {
        name: f"the declared table has one node in {RATIO_VARIABLES[i]} and declares no dependence on it"
        for name in names
        for i in variables_of(name)
        if nodes[i] == 1
    }


def table_prior(record: Record, names: Sequence[str], reference: Sequence[float]) -> TablePrior | None:
    """The prior of a record's table for parameters of the linear model; None where the record has no table.

    names     : estimated parameters, of which those of the linear model with a table count
    reference : (5,) condition that the derivatives are about: alpha, beta [deg], log10 Re, elevon, body flap [deg]
    raises    : InputError where the fitted samples cannot distinguish the parameters
    """
    # samples of the path that a prior is computed from, evenly chosen; errors of a table are smooth along it
    most_samples = 400
    table = record.ratio_table
    named = tuple(n for n in names if n == "ratio.scale" or variables_of(n))
    if table is None or not named:
        return None
    path = record_path(record)
    chosen = np.zeros(len(path.x), dtype=bool)
    chosen[:: -(-len(path.x) // most_samples)] = True
    path = path.subset(chosen)
    P = projection(named, path, np.asarray(reference, dtype=float))
    covariance = _of_stated_sigma(table, path, P) if has_sigma(table) else _of_default_sigma(path, P)
    return TablePrior(named, covariance, has_sigma(table))


def _of_stated_sigma(table: RatioTable, path: FlownPath, P: FloatArray) -> FloatArray:
    """(k, k) T from the errors of the table's nodes."""
    assert table.sigma is not None  # checked by the caller
    W = node_weights(table.axes, path.x)
    nodes = np.unique(W.indices)
    H = P @ W[:, nodes].toarray()
    # No table is better than what its reader accepts, and a prior needs a width.
    least = replace(table, sigma=np.maximum(table.sigma, SMALLEST_SIGMA * np.abs(table.ratio)))
    T: FloatArray = H @ prior_covariance(least, nodes, nodes) @ H.T
    return T


def _of_default_sigma(path: FlownPath, P: FloatArray) -> FloatArray:
    """(k, k) T from errors of DEFAULT_SIGMA of the ratio along the path."""
    sigma = DEFAULT_SIGMA * np.abs(path.declared)
    K = np.outer(sigma, sigma)
    for name, x in zip(RATIO_VARIABLES, path.x.T, strict=True):
        K *= correlation(name, x[:, None] - x[None, :])
    T: FloatArray = P @ K @ P.T
    return T


VARIABLE_WORDS = ("alpha", "beta", "Reynolds-number", "elevon", "body-flap")
"""The ratio variables in words."""
UNIT_WORDS = {"1": "", "1/deg": "/deg", "1/deg2": "/deg2"}


@dataclass(frozen=True)
class TableFinding:
    """A parameter of the linear model, or a combination of some, that leaves the prior of the declared table.

    what       : in words, with value and sigmas
    parameters : name -> estimate, sigma of its bound, each in the unit of the parameter
    sigmas     : by which it is off, of table and bounds together
    p_value    : probability of at least this if table and bounds are right
    """

    what: str
    parameters: Mapping[str, tuple[float, float]]
    sigmas: float
    p_value: float


def table_findings(fit: Fit, covariance: FloatArray, prior: TablePrior | None) -> list[TableFinding]:
    """What of a fit leaves the prior of the declared table by more than three sigmas, the farthest first.

    fit        : of one record, with flat priors or with those of the table
    covariance : of all its parameters
    prior      : of its table for parameters of the linear model; None where the record has no table
    """
    least = 1e-3  # part of the prior's variance that S has at least: with less, readings say nothing of a parameter
    names = [n for n in (prior.names if prior else ()) if n in fit.names]
    if prior is None or not names:
        return []
    of_fit, of_prior = [fit.names.index(n) for n in names], [prior.names.index(n) for n in names]
    C, T = covariance[np.ix_(of_fit, of_fit)], prior.covariance[np.ix_(of_prior, of_prior)]
    G = np.eye(len(C)) - C * fit.prior_information[of_fit]
    S = G @ T @ G.T + G @ C
    # a parameter without a bound is not off anything
    is_told = np.isfinite(np.diag(S)) & (np.diag(S) > least * np.diag(T))
    names, chosen = [n for n, k in zip(names, is_told, strict=True) if k], np.ix_(is_told, is_told)
    value, C, S = fit.values[of_fit][is_told], C[chosen], S[chosen]
    estimates = {n: (float(v), float(s)) for n, v, s in zip(names, value, np.sqrt(np.diag(C)), strict=True)}
    z = value / np.sqrt(np.diag(S))
    findings = [
        TableFinding(table_error(n, v[0], abs(float(u))), {n: v}, abs(float(u)), math.erfc(abs(u) / math.sqrt(2.0)))
        for (n, v), u in zip(estimates.items(), z, strict=True)
        if abs(u) > POLICY.min_sigmas
    ]
    return sorted(findings, key=lambda f: -f.sigmas) or _combination(estimates, z, S)


def _combination(estimates: Mapping[str, tuple[float, float]], z: FloatArray, S: FloatArray) -> list[TableFinding]:
    """The combination that is farthest off where no parameter alone is, and all together are; else nothing.

    z : (k,) estimates over their sigmas;  S : (k, k) covariance of table and bounds
    """
    named_component = 0.3  # component of a combination of unit length above which a parameter is named
    # part of the variance of each estimate that is taken as independent of the others [-]. Errors of a table about
    # another reference condition than that of the fit, for one, leave a constant that no parameter takes up
    independent_share = 0.1
    sigma = np.sqrt(np.diag(S))
    eigenvalues, vectors = np.linalg.eigh(S / np.outer(sigma, sigma))
    off = (vectors.T @ z) / np.sqrt(np.maximum(eigenvalues, 0.0) + independent_share)
    p_value = float(chdtrc(len(off), float(off @ off)))
    if p_value > math.erfc(POLICY.min_sigmas / math.sqrt(2.0)):
        return []
    k = int(np.argmax(np.abs(off)))
    order = np.argsort(-np.abs(vectors[:, k]))
    names = list(estimates)
    members = [names[i] for i in order if abs(vectors[i, k]) > named_component]
    text = (
        f"the table's {listed([table_word(n) for n in members])} are off together "
        f"({abs(off[k]):.1f} sigma along their combination, each less by itself)"
    )
    return [TableFinding(text, {n: estimates[n] for n in members}, abs(float(off[k])), p_value)]


def table_error(name: str, value: float, sigmas: float | None = None) -> str:
    """An error of the declared table in words: "the table's alpha derivative is too low by 0.012/deg".

    name   : of a parameter of the linear model;  value : in its unit, what the table lacks
    sigmas : by which it is off, where they are known
    """
    number = f"{abs(value):.2g}"
    size = f"{100.0 * abs(value):.2g} %" if name == "ratio.scale" else number + UNIT_WORDS[MODEL[name].unit]
    off = "" if sigmas is None else f" ({sigmas:.1f} of its sigma)"
    return f"the table's {table_word(name)} is too {'low' if value > 0.0 else 'high'} by {size}{off}"


def table_word(name: str) -> str:
    """A parameter of the linear model in words: `magnitude`, `alpha derivative`, `alpha-elevon derivative`."""
    variables = [VARIABLE_WORDS[i] for i in variables_of(name)]
    if not variables:
        return "magnitude"
    second = "second " if name.endswith("2") else ""
    return f"{second}{'-'.join(variables)} derivative"
