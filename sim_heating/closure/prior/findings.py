"""Estimates that leave the prior of the declared table, and estimates that a record cannot tell apart, in words.

Where table and bounds are right, estimates with flat priors are theta_hat ~ N(0, S), S = T + C, with the table's T
(prior.py) and the bounds C of the fit, corrected for colour. theta_hat' S^-1 theta_hat is then chi-square distributed
(docs/theory/equations.md, equation 17). A parameter is named where it is off by more than three of its sigma,
S_kk^(1/2). Where none is and all together are, the combination is named that is: the eigenvector of S, scaled to ones
on its diagonal, that contributes most. Variances of combinations follow from correlations of the table's errors, which
are assumed; so for these a share of every variance counts as independent of the others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from sim_heating.base.arrays import FloatArray
from sim_heating.base.parameters import MODEL
from sim_heating.closure.prior.table import TablePrior
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.fit import FitResult
from sim_heating.estimation.inference.observability import variables_of

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


def table_findings(fit: FitResult, prior: TablePrior | None) -> list[TableFinding]:
    """What of a fit leaves the prior of the declared table by more than three sigmas, the farthest first.

    fit   : of one record, with flat priors on the parameters of the linear model
    prior : of its table for these parameters; None where the record has no table
    """
    names = [n for n in (prior.names if prior else ()) if n in fit.labels]
    if prior is None or not names:
        return []
    of_fit, of_prior = [fit.labels.index(n) for n in names], [prior.names.index(n) for n in names]
    value, C = fit.fit.values[of_fit], fit.bounds.covariance[np.ix_(of_fit, of_fit)]
    S = prior.covariance[np.ix_(of_prior, of_prior)] + C
    # a parameter without a bound is not off anything
    bounded = np.isfinite(np.diag(S))
    names = [n for n, k in zip(names, bounded, strict=True) if k]
    value, C, S = value[bounded], C[np.ix_(bounded, bounded)], S[np.ix_(bounded, bounded)]
    estimates = {n: (float(v), float(s)) for n, v, s in zip(names, value, np.sqrt(np.diag(C)), strict=True)}
    z = value / np.sqrt(np.diag(S))
    findings = [
        TableFinding(table_error(n, v[0], abs(float(u))), {n: v}, abs(float(u)), math.erfc(abs(u) / math.sqrt(2.0)))
        for (n, v), u in zip(estimates.items(), z, strict=True)
        if abs(u) > POLICY.min_sigmas
    ]
    return sorted(findings, key=lambda f: -f.sigmas) or _combination(estimates, z, S)


def _combination(
    estimates: Mapping[str, tuple[float, float]],
    z: FloatArray,
    S: FloatArray,
    *,
    named_component: float = 0.3,
    independent_share: float = 0.1,
) -> list[TableFinding]:
    """The combination that is farthest off where no parameter alone is, and all together are; else nothing.

    z : (k,) estimates over their sigmas;  S : (k, k) covariance of table and bounds
    named_component : component of a combination of unit length above which a parameter is named
    independent_share : part of the variance of each estimate that is taken as independent of the others [-]. Errors of
        a table about another reference condition than that of the fit, for one, leave a constant that no parameter
        takes up
    """
    sigma = np.sqrt(np.diag(S))
    eigenvalues, vectors = np.linalg.eigh(S / np.outer(sigma, sigma))
    off = (vectors.T @ z) / np.sqrt(np.maximum(eigenvalues, 0.0) + independent_share)
    p_value = float(chdtrc(len(off), float(off @ off)))
    if p_value > math.erfc(POLICY.min_sigmas / math.sqrt(2.0)):
        return []
    k = int(np.argmax(np.abs(off)))
    order = np.argsort(-np.abs(vectors[:, k]))
    listed = list(estimates)
    members = [listed[i] for i in order if abs(vectors[i, k]) > named_component]
    text = (
        f"the table's {_listed([table_word(n) for n in members])} are off together "
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


def _listed(items: Sequence[str]) -> str:
    return " and ".join((", ".join(items[:-1]), items[-1])) if len(items) > 1 else items[0]
