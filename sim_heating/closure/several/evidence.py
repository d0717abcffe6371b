"""What each record adds to a joint finding: how far it speaks for the cause, and with which values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from sim_heating.closure.search.search import SearchResult
from sim_heating.closure.search.trials.trial_fit import TrialFit, fitted_values
from sim_heating.closure.several.causes import applies
from sim_heating.closure.several.joint_fit import (
    FEW_STEPS,
    RECORD,
    JointHypothesis,
    JointModel,
    fit_models,
    joint_model,
)
from sim_heating.closure.verdict.policy import POLICY


@dataclass(frozen=True)
class Evidence:
    """What one record adds to a joint finding.

    record     : its name;  point : its control point
    alone      : the finding of its own search;  named : what that named, in words
    member     : whether the record has the cause in the best joint hypothesis
    for_cause  : score of its declared model minus that with the cause [BIC]: above 0 it speaks for the cause; of one
                 that is no member, with the values of the others
    over_rival : score of the best other cause minus that of the cause in this record; None without another one
    own        : values and standard deviations of the cause's parameters that this record alone gives
    agreement  : probability of values as far from the common ones, by chance; None where it has no common parameter
    """

    record: str
    point: str
    alone: str
    named: str
    member: bool
    for_cause: float
    over_rival: float | None
    own: Mapping[str, tuple[float, float]]
    agreement: float | None

    @property
    def verdict(self) -> str:
        """What it says of the cause, in a word or two."""
        if self.for_cause < -POLICY.min_gain:
            return "contradicts it"
        if self.member and self.agreement is not None and self.agreement < POLICY.contradicted_p:
            return "other values"
        return "supports it" if self.member and self.for_cause > POLICY.min_gain else "does not tell"


def evidence_of_records(
    alone: Sequence[SearchResult], none: JointHypothesis, best: JointHypothesis, rival: JointHypothesis | None
) -> list[Evidence]:
    """What each record adds to the best hypothesis."""
    assert best.model is not None
    model, common = best.model, _values(best)
    bases = none.by_record
    able = [i for i in range(len(alone)) if applies(model.cause, bases[i])]
    free = {i: joint_model(model.cause, bases, [i], model.levels) for i in able}
    starts = {i: fitted_values(best.by_record[i]) if i in best.members else common for i in able}
    # of records that are no members: the same model with the members' values
    given = {i: _pinned(joint_model(model.cause, bases, [i], model.levels), common) for i in able
             if i not in best.members}  # fmt: skip
    models = [*free.values(), *given.values()]
    fits = fit_models(models, [m.start({i: starts[i]}) for m in models for i in m.members], iterations=FEW_STEPS)
    fitted = [m.split(f)[0] if np.isfinite(f.log_likelihood) else None for m, f in zip(models, fits, strict=True)]
    own = dict(zip(free, fitted[: len(free)], strict=True))
    at_common = dict(zip(given, fitted[len(free) :], strict=True))
    return [_evidence_of(i, result, none, best, rival, own.get(i), at_common.get(i)) for i, result in enumerate(alone)]


def evidence_without_cause(alone: Sequence[SearchResult]) -> list[Evidence]:
    """Evidence of records to which no cause could be fitted: what each found by itself."""
    return [
        Evidence(
            r.record.name, r.record.declared.control_point, r.conclusion.finding, _named(r), True, 0.0, None, {}, None
        )
        for r in alone
    ]


def _named(result: SearchResult) -> str:
    return " + ".join(" or ".join(names) for names in result.conclusion.alternatives)


def _values(h: JointHypothesis) -> dict[str, float]:
    """Values of the cause's parameters, common ones or those of a member."""
    assert h.model is not None
    pairs = zip(h.model.problem.unknowns, h.last.fit.values, strict=True)
    return {u.parameter.name: float(v) for u, v in pairs if u.parameter.name in h.model.cause.candidate.names}


def _pinned(model: JointModel, values: Mapping[str, float], *, pinned_sigma: float = 1e-6) -> JointModel:
    """The model with those parameters of its cause at given values that records may have in common.

    pinned_sigma : standard deviation of a value that is given, over the value
    """
    pinned = [n for n, level in model.cause.widest.items() if level != RECORD]
    model.problem.unknowns = [
        replace(u, parameter=replace(p, value=values[p.name], sigma=pinned_sigma * (abs(values[p.name]) or 1.0)))
        if (p := u.parameter).name in pinned
        else u
        for u in model.problem.unknowns
    ]
    return model


def _evidence_of(
    i: int,
    result: SearchResult,
    none: JointHypothesis,
    best: JointHypothesis,
    rival: JointHypothesis | None,
    own: TrialFit | None,
    at_common: TrialFit | None,
) -> Evidence:
    """own : the record's own fit of the cause;  at_common : its fit with the others' values, if it is no member"""
    assert best.model is not None
    names, member = best.model.cause.candidate.names, i in best.members
    at_own: dict[str, tuple[float, float]] = {}
    agreement, for_cause = None, -best.shares[i] if member else 0.0
    if own is not None:
        sigma = dict(zip(own.fit.names, own.fit.sigma.tolist(), strict=True))
        at_own = {n: (float(v), sigma[n]) for n, v in fitted_values(own).items() if n in names}
        scale = max(1.0, 1.0 + own.excess_chi2)
        common = [
            u for u in best.model.problem.unknowns
            if u.parameter.name in names and len(u.records) > 1
            and any(best.model.members[k] == i for k in u.records)
        ]  # fmt: skip
        if member and common:
            lost = max(own.fit.log_likelihood - best.by_record[i].fit.log_likelihood, 0.0)
            agreement = float(chdtrc(len(common), 2.0 * lost / scale))
        if at_common is not None:
            for_cause = 2.0 * (at_common.fit.log_likelihood - none.by_record[i].fit.log_likelihood) / scale
    return Evidence(
        record=result.record.name,
        point=result.record.declared.control_point,
        alone=result.conclusion.finding,
        named=_named(result),
        member=member,
        for_cause=float(for_cause),
        over_rival=None if rival is None else float(rival.shares[i] - best.shares[i]),
        own=at_own,
        agreement=agreement,
    )
