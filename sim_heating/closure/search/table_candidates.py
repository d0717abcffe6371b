"""Candidates that are no effect: one magnitude or derivative of the declared table, freed of what the table says of it.

Such a candidate has one parameter, with a flat prior: a derivative that the declared table excludes, or one of the
base that it has pulled towards its own value. It competes with effects: what a wrong slope of the table explains is
not taken for an effect, and what an effect explains better is not taken for a wrong slope.
"""

from __future__ import annotations

from sim_heating.base.parameters import MODEL
from sim_heating.closure.prior.table import undeclared_derivatives
from sim_heating.closure.search.trials.candidates import Candidate
from sim_heating.closure.search.trials.trial_fit import TrialFit, fitted_values, is_of_table
from sim_heating.estimation.inference.observability import constant_variables, default_names

TABLE = "table"
"""Name of these candidates, which no effect has."""


def table_candidates(base: TrialFit) -> list[Candidate]:
    """The candidates that free one magnitude or derivative each; none where the record has no table.

    Those against a variable that is constant over the fitted samples are left out.
    """
    least_sigma = 1.0  # sigmas of the table by which an estimate has to be off for its prior to matter
    record, values = base.record_fit.record, fitted_values(base)
    fitted = {p.name: p for p in base.problem.parameters}
    excluded = [n for n in undeclared_derivatives(record, default_names([record])) if n not in fitted]
    constant = constant_variables(excluded, [record])
    off = [n for n, p in fitted.items() if is_of_table(p) and abs(values[n]) > least_sigma * p.sigma]
    return [
        Candidate(TABLE, (), (n,), {n: values.get(n, 0.0)}, active=(n,), with_prior=(), priors={n: MODEL[n]})
        for n in (*(n for n in excluded if n not in constant), *off)
    ]
