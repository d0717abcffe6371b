"""Hypotheses on a record, or on several, and what the search concludes from them.

A hypothesis is a model of the record that was fitted: the declared one, the declared one with one or more effects, or
the declared one on a record that is changed (record_change.py), since its flight, its wall or a sensor is other than
stated. On several records it is one such model that some of them have in common (joint_model.py).
All are compared by one score, BIC with the segments held out (ranking.py), relative to the declared model; those that
may not be named (admissibility.py) are left out of the comparison. The score of several records is the sum of theirs: a
parameter of one record costs the logarithm of its number of samples, a common one that of all records that have it, so
that one common value is cheaper than two of their own.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sim_heating.base.parameters import CLOCK_SKEW, COMMON_LAG, RECORD_PARAMETERS, layer_parameter
from sim_heating.closure.search.admissibility import OFF, far_from_declared, objections
from sim_heating.closure.search.joint_model import Cause, JointModel
from sim_heating.closure.search.ranking import model_bic, prior_penalty, scatter_price, volume_penalty
from sim_heating.closure.search.simulated_records import with_simulated_p_value
from sim_heating.closure.search.table_candidates import TABLE
from sim_heating.closure.search.trials.candidates import NO_EFFECT, Candidate
from sim_heating.closure.search.trials.change import RecordChange
from sim_heating.closure.search.trials.trial_fit import TrialFit, fitted_values, sample_count, table_log_prior
from sim_heating.closure.verdict.adequacy import Adequacy, assess, pooled
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.inference.newton import Fit

TWINS = frozenset({"thickness_factor", "heat_capacity_factor"}), frozenset({CLOCK_SKEW.name, COMMON_LAG.name})
"""Parameters of one thing that act nearly alike: of a layer below the coating, whose thickness moves no thermocouple by
much; a clock that is late, and thermocouples that lag."""
NOT_PREDICTED = (
    "it predicts the segments held out worse than the declared model",
    "it explains what the fitted segments show, and nothing of those held out",
)
"""What the segments held out say against a hypothesis."""


def adequacy_of(trial: TrialFit, members: int = 1) -> Adequacy:
    """Whether the model of a trial explains the record to its noise; members : records that have it in common."""
    held_out = [] if trial.held_out_chi2 == 0.0 else trial.held_out_samples
    return with_simulated_p_value(trial, assess(trial.fitted_samples, held_out), members)


@dataclass(frozen=True, eq=False, repr=False)
class Hypothesis:
    """A fitted model of a record, or of several.

    trials     : its effects, each fitted on top of those before; the last one holds the values of all. The declared
                 model alone, or on a changed record, is the trial named `none`
    changed    : the fit of a change of the record; None where it is as declared
    objections : why it may not be named, empty where it may
    price      : of the number of forms tried of each of its effects, and of what else speaks against it, in units of
                 BIC
    score      : BIC with held-out segments, relative to the declared model, with the noise scale of the best
    model      : of the records that have its cause, where there are several; None for the declared models
    each       : of several records, the trial of each: of a member with the common values, of another one with what it
                 shows alone
    alone      : score of the explanation that each of several records has by itself, where it is no member; else 0
    shares     : score of each record relative to its declared model; with `common` they add up to the score
    common     : what common parameters, priors and forms add to the score
    """

    trials: tuple[TrialFit, ...]
    changed: TrialFit | None = None
    objections: tuple[str, ...] = ()
    price: float = 0.0
    score: float = 0.0
    model: JointModel | None = None
    each: tuple[TrialFit, ...] = ()
    alone: tuple[float, ...] = ()
    shares: tuple[float, ...] = ()
    common: float = 0.0

    @property
    def by_record(self) -> tuple[TrialFit, ...]:
        """The trial of each record."""
        return self.each or (self.last,)

    @property
    def members(self) -> tuple[int, ...]:
        """Indices of the records that have the cause; all for the declared models."""
        return tuple(range(len(self.by_record))) if self.model is None else self.model.members

    @property
    def change(self) -> RecordChange | None:
        """The change of the record; None where it is as declared."""
        return None if self.changed is None else self.changed.change

    @property
    def last(self) -> TrialFit:
        """The trial with the values of all parameters."""
        return self.trials[-1]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its change, in words where no effect is it, and of its effects; none for the declared model."""
        change = () if self.change is None else (self.change.name,)
        return (*change, *(t.name for t in self.trials if t.name != "none"))

    @property
    def kind(self) -> str:
        """Kind of its first cause: "effect", "flight", "wall", "sensor", "table"; empty for the declared model."""
        if self.change is not None:
            return "effect" if self.change.effect else self.change.kind
        if self.model is not None:
            return self.model.cause.kind
        if not self.names:
            return ""
        return "table" if self.names == (TABLE,) else "effect"

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of its effects, as a closure report has them."""
        change = () if self.change is None or not self.change.effect else (self.change.effect,)
        return (*change, *(t.name for t in self.added))

    @property
    def added(self) -> tuple[TrialFit, ...]:
        """Trials that add an effect, without derivatives of the table."""
        return tuple(t for t in self.trials if t.name not in ("none", TABLE))

    @property
    def admissible(self) -> bool:
        """Whether it may be named."""
        return not self.objections

    @cached_property
    def adequacy_by_record(self) -> tuple[Adequacy, ...]:
        """Whether it explains each record to its noise.

        Of models with an error each p-value is from as many records more as there are members, so that the smallest of
        them can be as small as that of one record.
        """
        return tuple(adequacy_of(trial, len(self.members)) for trial in self.by_record)

    @cached_property
    def adequacy(self) -> Adequacy:
        """Whether it explains the record, or its members, to their noise."""
        if not self.each:
            return self.adequacy_by_record[0]
        problems = [self.each[i].problem for i in self.members]
        names = [p.record_fits[0].record.name for p in problems]
        members = [self.adequacy_by_record[i] for i in self.members]
        return pooled(dict(zip(names, members, strict=True)), [sample_count(p) for p in problems])

    @property
    def adequate(self) -> bool:
        """Whether its p-value is at least `Policy.adequate_p`."""
        return self.adequacy.p_value >= POLICY.adequate_p

    @cached_property
    def excess_chi2(self) -> float:
        """Reduced chi-square of the fitted samples less one, of all records."""
        if not self.each:
            return self.last.excess_chi2
        counts = [sample_count(t.problem) for t in self.each]
        return float(np.average([t.excess_chi2 for t in self.each], weights=counts))

    @property
    def log_likelihood(self) -> float:
        """Log likelihood of the fitted samples, of all records [-]."""
        return sum(t.fit.log_likelihood for t in self.by_record)

    @property
    def penalties(self) -> float:
        """What its values cost by their distances from their priors, and what is common to several records [BIC]."""
        if not self.each:
            named = [t.candidate for t in self.trials if t.name != "none"]
            return sum(prior_penalty(self.last, c) + volume_penalty(self.last, c) for c in named)
        common = 0.0 if self.model is None else self.model.common_cost(self.last.fit.values)
        return common + self._flight_cost

    @property
    def _flight_cost(self) -> float:
        """Cost of the errors of the flights of its members by their priors [BIC], each flight once."""
        flights = {}
        for trial in (self.each[i] for i in self.members):
            fit, values = trial.record_fit, fitted_values(trial)
            flights[fit.record.flight] = [values[n] for n in fit.flight_names]
        return float(sum(np.sum(np.square(f)) for f in flights.values()))

    def delta_bic(self, none: Hypothesis) -> float:
        """BIC minus that of the declared model, residuals taken as noise, without segments held out."""
        if not self.each:
            return self.last.delta_bic if self.changed is None else self.changed.delta_bic
        fits = [(self.each[i].fit, none.each[i].fit) for i in self.members]
        gained = sum(f.log_likelihood + table_log_prior(f) - g.log_likelihood - table_log_prior(g) for f, g in fits)
        others = sum(score for i, score in enumerate(self.alone) if i not in self.members)
        return (0.0 if self.model is None else self.model.parameter_cost) - 2.0 * gained + others

    def __repr__(self) -> str:
        names, why = " + ".join(self.names) or "none", "; ".join(self.objections) or "admissible"
        return f"<Hypothesis {names}: score {self.score:+.1f}, p {self.adequacy.p_value:.3f}, {why}>"


def hypothesis(trials: Sequence[TrialFit], forms: Mapping[str, int]) -> Hypothesis:
    """A hypothesis with the objections to it.

    trials : effects, each on top of those before;  forms : number of forms of each effect that were tried
    """
    price = sum(2.0 * float(np.log(max(forms.get(t.name, 1), 1))) for t in trials if t.name != "none")
    return _with_objections(Hypothesis(tuple(trials), None, (), price))


def fitted_anew(h: Hypothesis, trial: TrialFit) -> Hypothesis:
    """A hypothesis whose parameters are fitted again, with the objections to it as it is then.

    trial : the last one, of this fit

    What a prediction of the segments held out says against it is told by `scored`. Of a changed record the change is as
    it was, with what speaks against it.
    """
    anew = replace(h, trials=(*h.trials[:-1], trial))
    if h.change is None:
        return _with_objections(anew)
    return replace(anew, objections=tuple(line for line in h.objections if line not in NOT_PREDICTED))


def told_by_fewer(h: Hypothesis, others: Sequence[Hypothesis]) -> Hypothesis:
    """A hypothesis of effects without objections to magnitudes that the models without these effects tell from none.

    others : with scores relative to the same model

    Where a magnitude and another parameter change together, as a film and the temperature behind it, the bounds of the
    one say little of how far it is from none. The ratio of likelihoods says it: three standard deviations are nine in
    score. Source: Wilks (1938), Ann. Math. Stat. 9, 60.
    """
    if h.change is not None or len(h.names) < 2 or h.admissible:
        return h

    def score_without(name: str) -> float:
        return min((o.score for o in others if {*o.names} == {*h.names} - {name}), default=-math.inf)

    told = {name for name in h.names if h.score <= score_without(name) - POLICY.min_sigmas**2}
    return _with_objections(h, told) if told else h


def _with_objections(h: Hypothesis, told: Collection[str] = ()) -> Hypothesis:
    """A hypothesis of effects with the objections to their values; told : as `objections` has it."""
    named = [t for t in h.trials if t.name != "none"]
    against = () if h.last.name == "none" else objections(h.last, [t.candidate for t in h.trials], told)
    far = [line for t in named for line in far_from_declared(h.last, t.candidate)]
    return _with_far(replace(h, objections=against), far)


def change_hypothesis(
    trial: TrialFit, tried: int, against_motion: float = 0.0, contradictions: Sequence[str] = ()
) -> Hypothesis:
    """The hypothesis that the record is changed.

    trial          : of the change
    tried          : number of changes of its family that were tried
    against_motion : what the motion of the flight says against the change, in units of BIC
    contradictions : of the change by the motion of the flight, a line each
    """
    change, fit, against = trial.change, trial.whole_fit, list(contradictions)
    assert change is not None
    assert fit is not None
    parameter = change.parameter
    if not fit.converged and not fit.predicted_gain < POLICY.settled_gain:
        against.append("its fit did not converge")
    if parameter is not None and bool(fit.on_bound[-1]):
        against.append(f"{change.what} is on its bound")
    if parameter is not None and abs(trial.value - parameter.value) < POLICY.min_sigmas * trial.sigma:
        against.append(f"{change.what}: less than {POLICY.min_sigmas:g} standard deviations from none")
    counted = len(change.free) + (1 if change.in_model else 0)  # by the trial's own problem
    uncounted = (change.unknowns - counted) * float(np.log(sample_count(trial.problem)))
    scatter = scatter_price(trial.deviation) + sum(map(scatter_price, trial.deviations_of_free))
    price = 2.0 * float(np.log(max(tried, 1))) + uncounted + scatter + against_motion
    far = trial.deviation > POLICY.max_scatter_sigmas
    lines = [f"{change.what} is {trial.deviation:.1f} {OFF} the declared value"] if far else []
    # the last trial of a hypothesis goes to other processes and back, which a change cannot
    return _with_far(Hypothesis((replace(trial, change=None, whole_fit=None),), trial, tuple(against), price), lines)


def joint_hypothesis(
    none: Hypothesis, model: JointModel, fit: Fit, alone: Sequence[tuple[TrialFit, float]] = ()
) -> Hypothesis:
    """The hypothesis that a cause is common to some of several records, with the objections to it.

    none  : the declared models;  fit : of the model
    alone : by record, the trial of its own explanation and the score of that, for records that are no members; by
            default the declared models
    """
    alone, cause, trials = alone or [(base, 0.0) for base in none.each], model.cause, model.split(fit)
    each, scores = [trial for trial, _ in alone], [float(score) for _, score in alone]
    members = list(zip(model.members, trials, strict=True))
    gained = sum(t.fit.log_likelihood - none.each[i].fit.log_likelihood for i, t in members)
    # of several effects together it is not known what the last one gained
    gain = gained if len(cause.names) == 1 else 0.0
    against, judged = list[tuple[str, ...]](), _judged_candidates(cause)
    for i, trial in members:
        delta = len(trial.candidate.names) * float(np.log(sample_count(trial.problem))) - 2.0 * gain
        each[i], scores[i] = replace(trial, name=cause.names[-1], delta_bic=delta), 0.0
        against.append(objections(replace(each[i], candidate=judged[-1]), judged))
    # what may be named in one of the records, with the values common to all, may be named
    fewest = min(against, key=len)
    by_name = {c.name: c for c in cause.candidates}
    joint = tuple(TrialFit(n, by_name.get(n, NO_EFFECT), model.problem, None, fit) for n in cause.names)
    return Hypothesis(joint, None, fewest, cause.price, model=model, each=tuple(each), alone=tuple(scores))


def _judged_candidates(cause: Cause) -> tuple[Candidate, ...]:
    """The candidates of a cause; far from its declared scatter a wall is fined, as in the search of one record."""
    return tuple(replace(c, with_prior=()) for c in cause.candidates) if cause.kind == "wall" else cause.candidates


def with_one_more(simpler: Hypothesis, trial: TrialFit, forms: Mapping[str, int]) -> Hypothesis:
    """A hypothesis with one effect more, or one derivative of the table.

    trial : of it, fitted on top of the last one of the hypothesis;  forms : as in `hypothesis`
    """
    further = hypothesis([trial], forms)
    return replace(
        simpler,
        trials=(*simpler.trials, trial),
        objections=(*simpler.objections, *further.objections),
        price=simpler.price + further.price,
    )


def _with_far(h: Hypothesis, far: Sequence[str]) -> Hypothesis:
    """A hypothesis with the objection that a declared value is further off than it scatters.

    Such a fault of a declaration may have any size, but has to explain the record.
    """
    explains = not far or h.adequate
    return h if explains else replace(h, objections=(*h.objections, *far))


def scored(none: Hypothesis, others: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Hypotheses with their scores relative to the declared model, best first; those that may not be named come last.

    The scale of a record's residuals is that of the best admissible one in it.
    """
    admissible = [h for h in others if h.admissible]
    best = max(admissible, key=lambda h: h.log_likelihood, default=none)
    zero = [model_bic(t, b) for t, b in zip(none.by_record, best.by_record, strict=True)]
    none_cost = none.penalties + none.price

    def rated(h: Hypothesis) -> Hypothesis:
        bic = [
            zero[i] + h.alone[i] if i not in h.members else
            model_bic(t, b, h.model.common_names(t.record_fit.record) if h.model else ())
            for i, (t, b) in enumerate(zip(h.by_record, best.by_record, strict=True))
        ]  # fmt: skip
        shares = [b - z if i in h.members else h.alone[i] for i, (b, z) in enumerate(zip(bic, zero, strict=True))]
        penalties, against = h.penalties, dict.fromkeys((*h.objections, *_not_predicted(none, h, best)))
        return replace(
            h, score=sum(bic) + penalties + h.price - (sum(zero) + none_cost), objections=tuple(against),
            shares=tuple(shares), common=h.price + penalties - none_cost,
        )  # fmt: skip

    return sorted(map(rated, others), key=lambda h: (not h.admissible, h.score))


def _not_predicted(none: Hypothesis, h: Hypothesis, best: Hypothesis) -> list[str]:
    """Objection to a hypothesis that does not predict the segments held out as what it explains of the others promises.

    best : has the scale of their residuals

    A cause predicts them no worse than the declared model, by one in log density, and better where what it explains of
    the fitted segments promises a gain of three. Models with an error promise nothing, as the error of either takes up
    what they leave, and their densities scatter: the odds have to tell them apart.
    """
    trial, declared = h.last, none.last
    if trial.held_out is None or declared.held_out is None or declared.held_out_chi2 == 0.0:
        return []
    scale = best.last.held_out_scale
    gained = (trial.held_out_log_likelihood - declared.held_out_log_likelihood) / scale
    if trial.has_error:
        return [] if gained >= -math.log(POLICY.odds_apart) else [NOT_PREDICTED[0]]
    if not gained >= -POLICY.held_out_gain:
        return [NOT_PREDICTED[0]]
    excess = 0.5 * sample_count(trial.held_out) * max(declared.held_out_chi2 - 1.0, 0.0) / scale
    if (
        min(max(_explained(none, h, of_nothing=0.0), 0.0), 1.0) * excess >= POLICY.promised_gain
        and gained < POLICY.held_out_gain
    ):
        return [NOT_PREDICTED[1]]
    return []


def _explained(none: Hypothesis, h: Hypothesis, *, of_nothing: float) -> float:
    """Part of the declared model's excess chi-square that a hypothesis explains [-]; of_nothing: where it has none."""
    excess = none.excess_chi2
    return (excess - h.excess_chi2) / excess if excess > 0.0 else of_nothing


@dataclass(frozen=True, eq=False, repr=False)
class Conclusion:
    """What the search concludes.

    finding      : "found", "one of", "partly", "unknown" or "none"
    best         : the hypothesis that is named first; the declared model for "none" and where nothing resembles it
    alternatives : for each thing found, the names that the record cannot tell apart, the likeliest first
    rival        : score of the best hypothesis outside the set, relative to the best
    explained    : part of the excess chi-square that it explains [-]
    disqualified : by how much the score of the best hypothesis that may not be named is below that of the best
    improbable   : probability of the finding, where it is too small to be stated and the record only resembles it
    """

    finding: str
    best: Hypothesis
    alternatives: tuple[tuple[str, ...], ...]
    rival: float
    explained: float = 0.0
    disqualified: float = 0.0
    improbable: float | None = None

    @property
    def effect_name(self) -> str:
        """Name in a closure report where no effect is added: "none" where nothing is, or no effect is the cause."""
        explained = self.finding in ("found", "one of") and not self.best.effects
        return "none" if self.finding == "none" or explained else "unknown"

    def __repr__(self) -> str:
        named = " + ".join(" or ".join(slot) for slot in self.alternatives)
        return f"<Conclusion: {self.finding} {named}, rival {self.rival:+.1f}>"


class Compared:
    """Hypotheses that are compared, and what follows from them.

    none       : the declared model, or the declared models of all records
    hypotheses : those that were fitted, best first; those that may not be named come last
    conclusion : what follows from them
    """

    none: Hypothesis
    hypotheses: tuple[Hypothesis, ...]
    conclusion: Conclusion

    @property
    def explained(self) -> bool:
        """Whether a cause was found, an effect or another."""
        return self.conclusion.finding in ("found", "one of")

    @property
    def compared(self) -> Hypothesis:
        """The best that may be named and is better than the declared model, which is that where there is none.

        Errors after are of it, whether it is named as the cause or not.
        """
        if self.explained or self.conclusion.finding == "none":
            return self.conclusion.best
        return next((h for h in self.hypotheses if h.admissible and h.score < 0.0), self.none)


def conclude(none: Hypothesis, rated: Sequence[Hypothesis]) -> Conclusion:
    """The conclusion from all hypotheses.

    rated : by `scored`, best first
    """
    admissible = [h for h in rated if h.admissible]
    if not admissible or admissible[0].score > -least_gain(none):
        margin = min((h.score for h in admissible), default=np.inf)
        return Conclusion("none" if _explains(none) else "unknown", none, (), float(margin))
    best = admissible[0]
    inside = _not_told_apart(best, admissible)
    alternatives, fraction = _alternatives(best, inside), _explained(none, best, of_nothing=1.0)
    rival = float(min([h.score for h in admissible if h not in inside] + [0.0]) - best.score)
    finding = _finding(best, alternatives, fraction)
    named = () if finding == "unknown" else alternatives
    return Conclusion(finding, best, named, rival, fraction, _disqualified(best, rated))


def _finding(best: Hypothesis, alternatives: Sequence[Sequence[str]], fraction: float) -> str:
    """What the best hypothesis is: "found", "one of", "partly" or "unknown"; arguments as in `Conclusion`."""
    if _explains(best):
        return "one of" if any(len(slot) > 1 for slot in alternatives) else "found"
    # the error of either model takes up the rest: what a cause explains is told by its evidence over the declared model
    return "partly" if fraction >= POLICY.min_explained or best.last.size is not None else "unknown"


def _disqualified(best: Hypothesis, rated: Sequence[Hypothesis]) -> float:
    """By how much the score of the best hypothesis that may not be named is below that of the best."""
    barred = (h.score for h in rated if not h.admissible and np.isfinite(h.score))
    return max(float(best.score - min(barred, default=best.score)), 0.0)


def _not_told_apart(best: Hypothesis, admissible: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Hypotheses that are no rivals of the best: as near as the record can tell, twins, and other forms of itself."""
    near = [h for h in admissible if h.score <= best.score + POLICY.set_margin and len(h.names) == len(best.names)]
    twin_score = best.score + POLICY.twin_margin
    twins = [h for h in admissible if h not in near and h.score <= twin_score and _is_twin(h, best)]
    forms = [h for h in admissible if set(h.names) == set(best.names)]
    return [*near, *twins, *forms]


def least_gain(none: Hypothesis) -> float:
    """By how much a cause has to be better than the declared model to be named [BIC].

    Errors of form give some gain over a model with exact heating that explains the record. An error of the heating
    takes them up.
    """
    size = none.last.size
    is_exact = size is None or size.mean == 0.0
    return POLICY.min_gain_over_adequate if none.adequate and is_exact else POLICY.min_gain


def _is_twin(h: Hypothesis, best: Hypothesis) -> bool:
    """Whether an adequate hypothesis differs from the best in one cause, which is a physical twin of the other's."""
    if len(h.names) != len(best.names) or len(set(h.names) - set(best.names)) != 1 or not h.adequate:
        return False
    things, others = _things(h) - _things(best), _things(best) - _things(h)
    return any(a[0] == b[0] and {a[1], b[1]} in TWINS for a in things for b in others)


def _things(h: Hypothesis) -> set[tuple[str, str]]:
    """What the parameters of a hypothesis are of, and which: of layers by their names, and of the record."""
    change = [] if h.change is None or h.change.parameter is None else [h.change.parameter.name]
    names = {*change, *(n for t in h.trials for n in t.candidate.model_names)}
    parameters = {(p[0], p[1].name) for n in names if (p := layer_parameter(n)) is not None and p[0] != "coating"}
    return parameters | {("record", n) for n in names if n in RECORD_PARAMETERS}


def _explains(h: Hypothesis) -> bool:
    """Whether a hypothesis explains the record to its noise, by a model with an error small enough to be named."""
    return h.adequate and (h.last.size is None or h.last.size.mean <= POLICY.max_heating_error)


def _alternatives(best: Hypothesis, inside: Sequence[Hypothesis]) -> tuple[tuple[str, ...], ...]:
    """Names for each effect of the best hypothesis: of those with as many that differ from it in that one alone."""
    slots = [{name: None} for name in best.names]
    for h in inside:
        new = dict.fromkeys(n for n in h.names if n not in best.names)
        for name, slot in zip(best.names, slots, strict=True):
            if {*best.names} - {name} <= {*h.names}:
                slot.update(new)
    return tuple(tuple(slot) for slot in slots)
