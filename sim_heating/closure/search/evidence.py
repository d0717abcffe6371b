"""What each record adds to a joint finding: how far it speaks for the cause, and with which values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from scipy.special import chdtrc

from sim_heating.base.parameters import SENSOR_PREFIX
from sim_heating.closure.search.hypothesis import Hypothesis
from sim_heating.closure.search.joint_model import RECORD, Cause, JointModel, joint_model, refit_models
from sim_heating.closure.search.search import SearchResult
from sim_heating.closure.search.trials.trial_fit import TrialFit, fitted_values
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.heating.effects import effects
from sim_heating.inputs.points import conditions_of_record


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
    member: bool = True
    for_cause: float = 0.0
    over_rival: float | None = None
    own: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    agreement: float | None = None

    @property
    def verdict(self) -> str:
        """What it says of the cause, in a word or two."""
        if self.for_cause < -POLICY.min_gain:
            return "contradicts it"
        if self.member and self.agreement is not None and self.agreement < POLICY.contradicted_p:
            return "other values"
        return "supports it" if self.member and self.for_cause > POLICY.min_gain else "does not tell"


def applies(cause: Cause, base: TrialFit) -> bool:
    """Whether a record can have a cause: its thermocouples, and the columns that its effects read."""
    record = base.record_fit.record
    flown, sensors = conditions_of_record(record), {s.name for s in record.sensors}
    needed = [column for name in cause.names if name in effects() for column in effects()[name].needs]
    named = [n.split(".", 1)[1].rpartition(".")[0] for n in cause.candidate.names if n.startswith(SENSOR_PREFIX)]
    return all(column in flown for column in needed) and sensors.issuperset(named)


def evidence_without_cause(alone: Sequence[SearchResult]) -> list[Evidence]:
    """Evidence of records to which no cause could be fitted: what each found by itself."""
    return [
        Evidence(
            r.record.name, r.record.declared.control_point, r.conclusion.finding,
            " + ".join(" or ".join(names) for names in r.conclusion.alternatives),
        )
        for r in alone
    ]  # fmt: skip


def evidence_of_records(
    alone: Sequence[SearchResult], none: Hypothesis, best: Hypothesis, rival: Hypothesis | None
) -> list[Evidence]:
    """What each record adds to the best hypothesis.

    alone : the search of each record;  none : the declared models;  rival : another cause, None without one
    """
    assert best.model is not None
    model, common = best.model, _values(best)
    able = [i for i in range(len(alone)) if applies(model.cause, none.each[i])]
    # each record by itself; of those that are no members also with the members' values
    free = {i: joint_model(model.cause, none.each, [i], model.levels) for i in able}
    pinned = {
        i: _pinned(joint_model(model.cause, none.each, [i], model.levels), common) for i in able
        if i not in best.members
    }  # fmt: skip
    starts = {i: fitted_values(best.each[i]) if i in best.members else common for i in able}
    models = [*free.values(), *pinned.values()]
    fitted = refit_models(models, [m.start({i: starts[i]}) for m in models for i in m.members])
    trials = {id(m): m.split(f)[0] for m, f in fitted}
    evidence = []
    for i, by_itself in enumerate(evidence_without_cause(alone)):
        fitted_alone, with_members = (trials.get(id(m.get(i))) for m in (free, pinned))
        by_values = _by_values(i, none, best, fitted_alone, with_members)
        over_rival = None if rival is None else float(rival.shares[i] - best.shares[i])
        evidence.append(replace(by_itself, member=i in best.members, over_rival=over_rival, **by_values))
    return evidence


def _by_values(
    i: int, none: Hypothesis, best: Hypothesis, free: TrialFit | None, pinned: TrialFit | None
) -> dict[str, Any]:
    """What record i says of the best hypothesis, and with which values: fields of its evidence.

    free : the cause fitted to this record alone;  pinned : with the others' values, if it is no member; None where
           that cannot be marched
    """
    assert best.model is not None
    names, member = best.model.cause.candidate.names, i in best.members
    fields: dict[str, Any] = {"for_cause": float(-best.shares[i] if member else 0.0)}
    if free is None:
        return fields
    sigma = dict(zip(free.fit.names, free.fit.sigma.tolist(), strict=True))
    fields["own"] = {n: (float(v), sigma[n]) for n, v in fitted_values(free).items() if n in names}
    scale = max(1.0, 1.0 + free.excess_chi2)
    common = [
        u for u in best.model.problem.unknowns
        if u.parameter.name in names and len(u.records) > 1 and any(best.model.members[k] == i for k in u.records)
    ]  # fmt: skip
    if member and common:
        lost = max(free.fit.log_likelihood - best.each[i].fit.log_likelihood, 0.0)
        fields["agreement"] = float(chdtrc(len(common), 2.0 * lost / scale))
    if pinned is not None:
        gained = pinned.fit.log_likelihood - none.each[i].fit.log_likelihood
        fields["for_cause"] = float(2.0 * gained / scale)
    return fields


def _values(h: Hypothesis) -> dict[str, float]:
    """Values of the cause's parameters, common ones or those of a member."""
    assert h.model is not None
    pairs = zip(h.model.problem.unknowns, h.last.fit.values, strict=True)
    return {u.parameter.name: float(v) for u, v in pairs if u.parameter.name in h.model.cause.candidate.names}


def _pinned(model: JointModel, values: Mapping[str, float]) -> JointModel:
    """The model with those parameters of its cause at given values that records may have in common."""
    pinned_sigma = 1e-6  # standard deviation of a value that is given, over the value
    pinned = [n for n, level in model.cause.widest.items() if level != RECORD]
    model.problem.unknowns = [
        replace(u, parameter=replace(p, value=values[p.name], sigma=pinned_sigma * (abs(values[p.name]) or 1.0)))
        if (p := u.parameter).name in pinned
        else u
        for u in model.problem.unknowns
    ]
    return model
