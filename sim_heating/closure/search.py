"""From a record that its declared model does not explain to the effect that does.

The declared model's magnitude and derivatives are fitted first. Then every candidate is fitted together with them and
weighed by what its freedom would gain from noise alone,

    BIC = -2 log L / c + k log n,

k parameters estimated from n samples. c is the mean square of the best model's normalised residuals, at least 1: what
even the best model leaves is the scale on which differences count (quasi-likelihood; Burnham & Anderson, Model
Selection and Multimodel Inference, 2nd ed., sec. 2.5). Two for the logarithm of the number of its forms, and the priors
of magnitudes, are added: neither many forms nor a value that nobody would expect come for nothing. The best candidate
is added where its BIC is below that of none by more than GAIN and it explains a good part of what noise does not; that
is repeated until nothing is. Where a further effect was added, each earlier one is weighed anew beside it.

Candidates begin where they have no effect yet. There the gain of a candidate is known from its sensitivities alone;
the best starts of each are then fitted, LANES of them side by side.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_heating.closure.candidates import Candidate, Form, candidates
from sim_heating.closure.thinning import LONGEST_S, thinned
from sim_heating.effects import EffectUse
from sim_heating.errors import RunError
from sim_heating.estimation.estimate import Fitted, estimate, lasting, misfit, predict_at
from sim_heating.estimation.identifiability import covariance
from sim_heating.estimation.likelihood import scores
from sim_heating.estimation.newton import Fit, Settings, Status
from sim_heating.estimation.observation import definition
from sim_heating.estimation.problem import SKEW_SPAN_S, Problem
from sim_heating.estimation.together import Together, maximise_together
from sim_heating.parameters import CLOCK_SKEW, EFFECT_PREFIX, Parameter
from sim_heating.points import conditions_of_record
from sim_heating.predict import Prediction
from sim_heating.record import Record

FloatArray = NDArray[np.float64]
Progress = Callable[[float, str], None]

GAIN = 10.0
"""How much lower the BIC of an effect has to be than that of none."""
SHARE, FIRST_SHARE = 0.5, 0.3
"""Part of what noise does not explain that an effect has to explain; the first of several may leave more to others."""
BESIDE = 0.1
"""What a further effect has to explain, over what the first one did: less is left by a first one whose form differs."""
EXPLAINED = 0.8
"""And what all effects together have to explain to be named at all: a form of our own fits anything a little."""
LASTING = 0.5
"""Mean product of neighbouring normalised residuals from which on something is missing though no candidate touches it;
a recorder's own coloured noise has a fifth of its variance in common between neighbours."""
MOST_EFFECTS = 3
AGREEMENT = 0.25
"""Part of their sample interval to which two recorders' clocks are taken to agree unless shown otherwise."""
WIDENED = 3.0
"""Priors of effects' parameters are this much wider in the search: enough to keep a first step within reason."""
NODES_PART, FEWEST_NODES = 0.5, 14
"""Nodes that a search marches, over those of a fit; and how many it has at least."""
STARTS_FITTED = 2
"""Starts of a set of parameters that are fitted, the most promising ones."""
NEAR = 0.5
"""Part of the best promise from which on several starts of a candidate are fitted."""
BEHIND = 0.1
"""Part of the best promise below which a candidate is not fitted."""
WORTH = 5.0
"""By how much a promised gain in log likelihood may fall short of what its parameters cost."""
QUICK = Settings(gain=0.05, step=0.2, iterations=25, lengths=(0.5, 0.25, 0.1, 0.03, 0.01, 1e-3), reach=0.4)
STAGES = (
    (0.0, replace(QUICK, iterations=4)), (0.3, replace(QUICK, iterations=8)), (0.5, replace(QUICK, iterations=8)),
    (0.8, QUICK),
)  # fmt: skip
"""Part of the best gain that a candidate has to have reached to be fitted further, and how far."""
PATIENCE = 0.8
"""Part of the best gain from which on what a candidate promised keeps it in the second stage."""
CLOSE = 5.0
"""By how much its log likelihood may stay behind the best where it is fitted to the end."""


@dataclass(frozen=True, eq=False)
class Attempt:
    """One candidate fitted on top of a model.

    delta_bic : its BIC minus that of the model without it, residuals taken as noise (c = 1)
    weighed   : the same with c of the best model
    posterior : its probability among all candidates that it was weighed with
    """

    name: str
    candidate: Candidate
    problem: Problem
    fit: Fit
    delta_bic: float
    weighed: float = 0.0
    posterior: float = 0.0

    @property
    def prediction(self) -> Prediction:
        """The record at the values found."""
        return predict_at(self.problem.parts[0], self.fit.values)

    @property
    def excess(self) -> float:
        """Mean square of the normalised residuals, beyond that of noise."""
        return misfit(self.problem.samples(self.fit.values)) ** 2 - 1.0

    @property
    def lasting(self) -> float:
        """What of them lasts from one sample to the next."""
        return lasting(self.problem.samples(self.fit.values))


@dataclass(frozen=True, eq=False)
class Round:
    """One pass over all candidates on top of a model.

    base, excess : that model, and its excess
    attempts     : the best attempt of each effect, best first
    posterior    : the probability of each with equal prior ones, `none` included
    passed       : effects not worth a fit, and the delta_bic that their best start promised
    """

    base: Attempt
    excess: float
    attempts: tuple[Attempt, ...]
    posterior: Mapping[str, float]
    passed: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Search:
    """What was found in one record.

    before  : the declared model's fit, its magnitude and derivatives;  rounds : the passes
    added   : the attempts whose effects were added, in order
    unknown : whether something significant is left that no candidate explains
    """

    record: Record
    before: Fitted
    rounds: tuple[Round, ...]
    added: tuple[Attempt, ...]
    unknown: bool

    @property
    def names(self) -> tuple[str, ...]:
        """What is named: the added effects; `unknown`; or `none`."""
        return tuple(a.name for a in self.added) or (("unknown",) if self.unknown else ("none",))


def search(record: Record, *, progress: Progress = lambda fraction, text: None) -> Search:
    """Look for what the declared model of a record lacks.

    raises : InputError, RunError where not even the declared model can be fitted
    """
    progress(0.02, "declared model")
    before = estimate([record])
    base = _base(before)
    rounds: list[Round] = []
    added: list[Attempt] = []
    while len(added) < MOST_EFFECTS:
        begin = 0.1 + 0.9 * len(added) / MOST_EFFECTS

        def tell(fraction: float, text: str, begin: float = begin, number: int = len(added) + 1) -> None:
            progress(begin + 0.9 * fraction / MOST_EFFECTS, f"effect {number}: {text}")

        rounds.append(one_round(added[-1] if added else base, [a.name for a in added], tell))
        best = _worth_adding(rounds, added)
        if best is None:
            break
        added = _reconsidered(base, [*added, best], tell)
        if added[-1].excess < BESIDE * _by_first(rounds, added):
            break  # less is left than a further effect has to explain
    return Search(record, before, tuple(rounds), *_judged(rounds, added))


def _worth_adding(rounds: Sequence[Round], added: Sequence[Attempt]) -> Attempt | None:
    """The best attempt of the last round where it explains enough to be added."""
    found = rounds[-1]
    best = found.attempts[0] if found.attempts else None
    if best is None or best.weighed > -GAIN:
        return None
    least = max(SHARE * found.excess, BESIDE * _by_first(rounds, added)) if added else FIRST_SHARE * found.excess
    return best if found.excess - best.excess >= least else None


def _by_first(rounds: Sequence[Round], added: Sequence[Attempt]) -> float:
    """What the first effect explained of the excess."""
    return rounds[0].excess - added[0].excess


def _reconsidered(base: Attempt, added: list[Attempt], progress: Progress) -> list[Attempt]:
    """The effects with each earlier one weighed anew beside the others: where two act, the first found may be one that
    comes near to both."""
    for earlier in added[:-1]:
        others = [a for a in added if a is not earlier]
        without = _stacked(base, others, values_of(added[-1]))
        found = one_round(without[-1], [a.name for a in others], progress)
        best = next(iter(found.attempts), None)
        if best is not None and best.name != earlier.name and _bic(best, best) < _bic(added[-1], best) - GAIN:
            return [*without, best]
    return added


def _bic(attempt: Attempt, best: Attempt) -> float:
    """BIC of a whole model, its residuals on the scale of those of the best one."""
    c, parameters = max(1.0, 1.0 + best.excess), len(attempt.problem.unknowns)
    return -2.0 * attempt.fit.log_likelihood / c + parameters * float(np.log(samples(attempt.problem)))


def _stacked(base: Attempt, effects: Sequence[Attempt], values: Mapping[str, float]) -> list[Attempt]:
    """Effects one on top of the other on the base, each fitted from the values given."""
    stack = [base]
    for one in effects:
        problem, own = _on_top(stack[-1], one.candidate), {n: values[n] for n in one.candidate.names}
        first = _first(problem, {**values_of(stack[-1]), **own})
        stack.append(replace(one, problem=problem, fit=maximise_together([problem], [first], QUICK)[0]))
    return stack[1:]


def _judged(rounds: Sequence[Round], added: Sequence[Attempt]) -> tuple[tuple[Attempt, ...], bool]:
    """What of the attempts stands, and whether what is left is unknown: they explain the residual, or nothing does."""
    first = rounds[0]
    touched = bool(first.attempts) and first.attempts[0].weighed <= -GAIN
    significant = touched or first.base.lasting > LASTING
    left = added[-1].excess if added else first.excess
    if added and first.excess - left >= EXPLAINED * first.excess:
        return tuple(added), False
    return (), significant


# The model that candidates are added to ------------------------------------------------------------------------------


def _base(before: Fitted) -> Attempt:
    """The declared model with its magnitude and derivatives, and a clock that may be a little off.

    It is marched along no more of the conditions than needed; what that and the mesh change is taken out.
    """
    whole = before.problem.parts[0]
    start = {**dict(zip(whole.names, before.fit.values, strict=True)), CLOCK_SKEW.name: 0.0}
    interval = float(np.median(np.diff(whole.record.time_s)))
    off = min(AGREEMENT * interval, SKEW_SPAN_S)
    clock = {CLOCK_SKEW.name: replace(CLOCK_SKEW, lower=-off, upper=off)}
    names, reference = (*whole.names, CLOCK_SKEW.name), before.problem.reference
    full = Problem([whole.record], names, reference, priors=clock, widened=WIDENED)
    quick = thinned(whole.record, max(int(NODES_PART * whole.mesh.nodes), FEWEST_NODES))
    problem = Problem([quick], names, reference, priors=clock, widened=WIDENED, longest_step_s=LONGEST_S)
    for one in (full, problem):
        one.parts[0].sigma_K.update(whole.sigma_K)
    at = _first(full, start)
    full.correct_meshes(at)
    try:
        exact, coarse = (p.parts[0].corrected(p.marched(at)[0]).temperature_K for p in (full, problem))
    except RunError:  # a model so wrong that it cannot be marched everywhere: the quick march stands as it is
        exact = coarse = np.zeros(1)
    problem.parts[0].correction_K = exact - coarse
    return Attempt(
        "none", Candidate("none", (), (), {}, ()), problem, maximise_together([problem], [at], QUICK)[0], 0.0
    )


def _on_top(base: Attempt, candidate: Candidate) -> Problem:
    """The base's problem with a candidate's unknowns."""
    part = base.problem.parts[0]
    names = tuple(dict.fromkeys((*part.names, *candidate.names)))
    return _carrying(base, candidate, names, widened=WIDENED)


def _carrying(base: Attempt, candidate: Candidate, names: Sequence[str], **more: Any) -> Problem:
    """The base's record with a candidate's effects beside those found, its noise, what is known of its mesh, and a
    clock that goes no further than in the base unless that is what the candidate moves."""
    part, uses = base.problem.parts[0], (*fitted_uses(base), *candidate.uses)
    priors: dict[str, Parameter] = dict(base.problem.priors)
    if CLOCK_SKEW.name in candidate.names:
        priors[CLOCK_SKEW.name] = replace(CLOCK_SKEW, lower=-SKEW_SPAN_S, upper=SKEW_SPAN_S)
    more |= {"effects": uses, "priors": priors, "longest_step_s": LONGEST_S}
    problem = Problem([part.record], names, base.problem.reference, **more)
    problem.parts[0].sigma_K.update(part.sigma_K)
    problem.parts[0].correction_K = part.correction_K
    return problem


def _first(problem: Problem, start: Mapping[str, float]) -> FloatArray:
    return np.array([start.get(p.name, p.value) for p in problem.parameters])


def values_of(attempt: Attempt) -> dict[str, float]:
    """Values found, by dotted name."""
    return dict(zip((u.parameter.name for u in attempt.problem.unknowns), attempt.fit.values, strict=True))


def fitted_uses(attempt: Attempt) -> tuple[EffectUse, ...]:
    """The effects of an attempt's model at the values found."""
    return attempt.problem.parts[0].altered(attempt.fit.values).effects


# One pass over the candidates ----------------------------------------------------------------------------------------


def one_round(base: Attempt, taken: Sequence[str], progress: Progress) -> Round:
    """Weigh every candidate on top of a model, fit the promising ones, keep the best attempt of each effect."""
    progress(0.0, "weighing candidates")
    record = base.problem.parts[0].record
    flown = conditions_of_record(record)
    tried = candidates(record, flown.at(flown.time_s[record.fit_mask(flown.time_s)]), taken)
    gains = promises(base, tried)
    chosen = sorted(_promising(tried, gains, samples(base.problem)))
    problems, start = [_on_top(base, tried[i]) for i in chosen], values_of(base)
    firsts = [_first(p, {**start, **tried[i].start}) for p, i in zip(problems, chosen, strict=True)]
    progress(0.3, f"fitting {len(chosen)} of {len(tried)} candidates")
    fits = in_stages(problems, firsts, base.fit.log_likelihood, [gains[i] for i in chosen])
    best: dict[str, Attempt] = {}
    for i, problem, fit in zip(chosen, problems, fits, strict=True):
        name = tried[i].name
        attempt = Attempt(name, tried[i], problem, fit, delta_bic(base, fit, tried[i], 1.0))
        if np.isfinite(fit.log_likelihood) and (name not in best or attempt.delta_bic < best[name].delta_bic):
            best[name] = attempt
    passed: dict[str, float] = {}
    for one, gain in zip(tried, gains, strict=True):
        if one.name not in best:
            promised = -2.0 * gain + len(one.names) * float(np.log(samples(base.problem)))
            passed[one.name] = min(promised, passed.get(one.name, np.inf))
    return _weighed(base, sorted(best.values(), key=lambda a: a.delta_bic), passed, forms_of(tried))


def _promising(tried: Sequence[Candidate], gains: Sequence[float], n: int) -> list[int]:
    """Which candidates are fitted: the most promising starts of each form, but none that promises much less than the
    best, or too little to be worth its parameters."""
    most = max(gains, default=0.0)
    count: dict[Form, int] = {}
    chosen = []
    for i in sorted(range(len(tried)), key=lambda i: -gains[i]):
        form = tried[i].form
        allowed = STARTS_FITTED if gains[i] > NEAR * most else 1
        worth = gains[i] > max(BEHIND * most, 0.5 * np.log(n) * len(tried[i].names) - WORTH)
        if worth and count.get(form, 0) < allowed:
            count[form] = count.get(form, 0) + 1
            chosen.append(i)
    return chosen


def promises(base: Attempt, tried: Sequence[Candidate]) -> list[float]:
    """Gain in log likelihood that the linearisation of each candidate at its start promises, the base's parameters
    moving with it; minus infinity where the model cannot be marched there.

    The base's own sensitivities hold for all: a candidate begins without any effect, or little.
    """
    part, start = base.problem.parts[0], values_of(base)
    fixed = {n: start[n] for n in part.marched if not n.startswith(EFFECT_PREFIX)}
    problems = [_carrying(base, c, tuple(dict.fromkeys((*part.other, *c.names))), fixed=fixed) for c in tried]
    firsts = [_first(p, {**start, **c.start}) for p, c in zip(problems, tried, strict=True)]
    known = np.concatenate([s.own for s in base.problem.samples(base.fit.values)])
    inner = known[:, [k for k, n in enumerate(part.names) if n not in part.other]]
    scored = cache(lambda number, mean: scores(part.channels[number].observed, np.frombuffer(mean), sigma[number]))
    sigma = [part.sigma_K[c.number] for c in part.channels]
    marched = Together(problems).march(firsts)
    return [
        _promise(problem, first, inner, scored) - base.fit.log_likelihood if done else -np.inf
        for problem, first, done in zip(problems, firsts, marched, strict=True)
    ]


Scored = Callable[[int, bytes], tuple[float, FloatArray, FloatArray]]
"""likelihood.scores of a channel by its number, for predictions as bytes: those of many candidates are the same."""


def _promise(problem: Problem, first: FloatArray, known: FloatArray, scored: Scored) -> float:
    """Log likelihood that a Gauss-Newton step promises; `known` (sample, parameter): the base's sensitivities."""
    everything = problem.samples(first)
    found = [scored(number, s.mean_K.tobytes()) for number, s in enumerate(everything)]
    score, weight = np.concatenate([f[1] for f in found]), np.concatenate([f[2] for f in found])
    own = np.concatenate([s.own for s in everything])
    gradient, information = score @ own, weight @ own**2
    lower = np.array([p.lower for p in problem.parameters])
    upper = np.array([p.upper for p in problem.parameters])
    held = ((first <= lower) & (gradient <= 0.0)) | ((first >= upper) & (gradient >= 0.0))
    J = np.column_stack([known, own[:, ~held & (information > 0.0)]])
    M, g = J.T @ (J * weight[:, np.newaxis]), J.T @ score
    inverse = covariance(M)
    inverse[~np.isfinite(inverse)] = 0.0
    return float(sum(f[0] for f in found) + 0.5 * g @ inverse @ g)


def in_stages(
    problems: Sequence[Problem], firsts: Sequence[FloatArray], reached: float, promised: Sequence[float]
) -> list[Fit]:
    """Fit all a little way, those that came near the best gain over `reached` further, or promised as much, and the
    best to the end, but for those that are not going to reach the best."""
    fits = maximise_together(problems, firsts, STAGES[0][1])
    history = [_gains(fits, reached)]
    for stage, (within, settings) in enumerate(STAGES[1:], start=1):
        best = float(np.max(history[-1], initial=0.0))
        near = history[-1] >= within * best
        if stage == 1:
            near |= np.array(promised) >= PATIENCE * best
        elif stage == len(STAGES) - 1:
            near &= _hoped(history) >= best - CLOSE
        again = [k for k in range(len(fits)) if near[k] and fits[k].status is Status.ITERATIONS]
        further = maximise_together([problems[k] for k in again], [fits[k].values for k in again], settings)
        for k, fit in zip(again, further, strict=True):
            fits[k] = fit
        history.append(_gains(fits, reached))
    return fits


def _gains(fits: Sequence[Fit], reached: float) -> FloatArray:
    return np.nan_to_num([f.log_likelihood - reached for f in fits], nan=-np.inf)


def _hoped(history: Sequence[FloatArray]) -> FloatArray:
    """Where gains end if each stage adds the same part of what the one before it did, twice that allowed."""
    with np.errstate(invalid="ignore", divide="ignore"):
        before, last = history[-2] - history[-3], history[-1] - history[-2]
        more = np.where(last < before, last**2 / (before - last), np.where(last > 0.0, np.inf, 0.0))
    return history[-1] + 2.0 * np.nan_to_num(more, nan=np.inf, posinf=np.inf)


# Weighing ------------------------------------------------------------------------------------------------------------


def delta_bic(base: Attempt, fit: Fit, candidate: Candidate, c: float) -> float:
    """BIC of a fit minus that of the model it is on top of."""
    gained = fit.log_likelihood - base.fit.log_likelihood
    return float(-2.0 * gained / c + len(candidate.names) * np.log(samples(base.problem)))


def _weighed(
    base: Attempt, attempts: Sequence[Attempt], passed: Mapping[str, float], forms: Mapping[str, int]
) -> Round:
    """The round; `forms` says how many forms of each effect were tried, which share its prior probability."""
    excess = base.excess
    if not attempts:
        return Round(base, excess, (), {"none": 1.0}, passed)
    c = max(1.0, 1.0 + min(excess, attempts[0].excess))
    weighed = {
        a.name: delta_bic(base, a.fit, a.candidate, c) + 2.0 * float(np.log(forms[a.name])) + unlikely(a)
        for a in attempts
    }
    posterior = posteriors({"none": 0.0, **weighed})
    told = [replace(a, weighed=weighed[a.name], posterior=posterior[a.name]) for a in attempts]
    return Round(base, excess, tuple(sorted(told, key=lambda a: a.weighed)), posterior, passed)


def posteriors(delta_bic: Mapping[str, float]) -> dict[str, float]:
    """Probability of each candidate with equal prior ones, exp(-BIC / 2) over their sum."""
    least = min(delta_bic.values())
    weight = {name: math.exp(-0.5 * (delta - least)) for name, delta in delta_bic.items()}
    total = sum(weight.values())
    return {name: w / total for name, w in weight.items()}


def unlikely(attempt: Attempt) -> float:
    """By how much priors speak against the values found: the sum of squares of sigmas from what is declared."""
    part, found = attempt.problem.parts[0], values_of(attempt)
    known = {n: definition(part.record, n) or part.model.definition(n) for n in attempt.candidate.prior}
    return float(sum(((found[n] - p.value) / p.sigma) ** 2 for n, p in known.items()))


def forms_of(tried: Sequence[Candidate]) -> dict[str, int]:
    """How many forms of each effect there are, without those that are another one at one value of what it estimates."""
    forms: dict[str, set[Form]] = {}
    for c in tried:
        forms.setdefault(c.name, set()).add(c.form)
    return {name: sum(not any(f.within(g) for g in those) for f in those) for name, those in forms.items()}


def samples(problem: Problem) -> int:
    """Number of samples that are fitted."""
    return sum(len(channel.samples) for part in problem.parts for channel in part.channels)
