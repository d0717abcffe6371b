"""What a closed loop tells, as data: the finding with its alternatives, how sure it is, errors before and after.

Pages and files are made of it (report/); it imports none of them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.files import finite_or_none
from sim_heating.base.files.text import listed
from sim_heating.base.parameters import AT
from sim_heating.closure.clues.correlation import ResidualEvidence
from sim_heating.closure.clues.record_checks import DataFault
from sim_heating.closure.clues.residual_heating import NAME as HEATING_NAME
from sim_heating.closure.clues.residual_heating import ResidualHeating
from sim_heating.closure.curves import NAME as CURVE_NAME
from sim_heating.closure.search.evidence import Evidence
from sim_heating.closure.search.joint_search import JointSearch
from sim_heating.closure.search.tell_apart import Experiment
from sim_heating.closure.search.trials.told_error import ToldError, flight_in_words
from sim_heating.closure.verdict.adequacy import Adequacy, p_value_text
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.credibility.facts.of_records import held_out, of_several, ratio_uncertainty
from sim_heating.credibility.statement import Answer, assess
from sim_heating.credibility.statement import Statement as Credibility
from sim_heating.estimation.report.estimate_file import Remark
from sim_heating.heating.effects.curve import CurveBand
from sim_heating.inputs.record import Record
from sim_heating.simulation.predict import Prediction

NAME, PAGE, RECORDS = "closure.json", "report.html", "records.csv"
FILES = (NAME, PAGE, HEATING_NAME, CURVE_NAME)
"""Files of a closure."""
JOINT_FILES = (NAME, PAGE, RECORDS)
"""Files of a joint closure, besides a folder for each record."""
FOUND, ONE_OF, PARTLY, UNKNOWN, NONE = "found", "one of", "partly", "unknown", "none"
"""The findings of a closure report."""
FACTOR = "_factor"
NOUNS = {"coating_factor": "coating thickness"}
"""Quantity of a factor whose name does not state it."""


@dataclass(frozen=True)
class ParameterEstimate:
    """An estimated parameter.

    value, sigma : in its unit; sigma is not finite where the record does not determine it
    unit         : as in closure.json, "1" where it has none
    """

    value: float
    sigma: float
    unit: str

    def as_json(self) -> dict[str, Any]:
        """Its entry in closure.json."""
        return {"value": float(self.value), "sigma": finite_or_none(self.sigma), "unit": self.unit}


def values_in_words(parameters: Mapping[str, ParameterEstimate]) -> str:
    """Estimates in a few words: a factor as a change in per cent, others by their names; no more than three.

    >>> from sim_heating.closure.result import ParameterEstimate, values_in_words
    >>> values_in_words({"heat_capacity_factor": ParameterEstimate(0.949, 0.002, "1")})
    'heat capacity 5.1 % lower'
    """
    return ", ".join(_value_in_words(n, p) for n, p in list(parameters.items())[:3])


def _value_in_words(name: str, p: ParameterEstimate) -> str:
    stem, at, whose = name.partition(AT)
    if stem.endswith(FACTOR) and p.unit == "1":
        percent = 100.0 * (p.value - 1.0)
        noun = NOUNS.get(stem, stem.removesuffix(FACTOR).replace("_", " "))
        where = f" in {whose}" if at else ""
        return f"{noun} {abs(percent):.2g} % {'higher' if percent > 0.0 else 'lower'}{where}"
    return f"{name} {p.value:.3g}{'' if p.unit == '1' else f' {p.unit}'}"


@dataclass(frozen=True)
class NotEffect:
    """A cause that is no aerothermal effect.

    kind        : "wall", "flight", "sensor" or "table"
    what        : in words, with its value
    parameters  : estimates by name
    probability : calibrated; None where no calibration is at hand
    """

    kind: str
    what: str
    parameters: Mapping[str, ParameterEstimate] = field(default_factory=dict)
    probability: float | None = None

    def as_json(self) -> dict[str, Any]:
        """Its entry in closure.json."""
        parameters = {n: p.as_json() for n, p in self.parameters.items()}
        return {"kind": self.kind, "what": self.what, "parameters": parameters, "probability": self.probability}


@dataclass(frozen=True)
class Barred:
    """A model that fits better than the one that is named, and may not be named.

    names  : of its causes;  reason : in words
    delta_evidence : log evidence above that of the named one [-]
    """

    names: Sequence[str]
    reason: str
    delta_evidence: float


@dataclass(frozen=True)
class Statement:
    """What a closed loop states.

    finding      : "found", "one of", "partly", "unknown" or "none"
    alternatives : for each thing found, the names that the record cannot tell apart, the likeliest first; for "partly",
                   what the residual resembles
    adequacy     : of the model with what was named, and for "partly" with what the residual resembles
    explained    : part of the excess chi-square that this model explains [-]
    probability  : calibrated, that the finding as stated is right; None where no calibration is at hand
    improbable   : the same of what a record resembles, where it is too small for a finding; else None
    not_effects  : causes that are no aerothermal effect
    converged    : whether the last fit converged
    would_tell_apart : measurements and manoeuvres that are expected to tell the alternatives apart, the best first
    alternative_values : estimates of each member of a set, or of what the residual resembles, each fitted without the
                   others: by its name in `alternatives` and theirs
    experiment   : what may be repeated: "flight", or "test" of a record without flow
    resembles    : for "partly" and "unknown", the names in the best model that may be named: errors after are of it
    model_error  : of the model that errors after are of; None for a record whose model is exact
    barred       : models that fit better and may not be named
    """

    finding: str
    alternatives: Sequence[Sequence[str]] = ()
    adequacy: Adequacy | None = None
    explained: float = 0.0
    probability: float | None = None
    improbable: float | None = None
    not_effects: Sequence[NotEffect] = ()
    converged: bool = True
    would_tell_apart: Sequence[Experiment] = ()
    alternative_values: Mapping[str, Mapping[str, ParameterEstimate]] = field(default_factory=dict)
    experiment: str = "flight"
    resembles: Sequence[str] = ()
    model_error: ToldError | None = None
    barred: Sequence[Barred] = ()

    def as_json(self) -> dict[str, Any]:
        """Its keys in closure.json."""
        return {
            "finding": self.finding,
            "alternatives": [list(names) for names in self.alternatives],
            "alternative_values": {
                name: {n: p.as_json() for n, p in parameters.items()}
                for name, parameters in self.alternative_values.items()
            },
            "adequacy": None if self.adequacy is None else self.adequacy.as_json(),
            "probability": self.probability,
            "not_effects": [n.as_json() for n in self.not_effects],
            "converged": self.converged,
            "would_tell_apart": [asdict(e) for e in self.would_tell_apart],
            "resembles": list(self.resembles),
            "model_error": None if self.model_error is None else self.model_error.as_json(),
            "barred": [asdict(b) for b in self.barred],
        }

    @property
    def noise_floors(self) -> float:
        """RMS residual over noise, of the fitted samples or of those held out, where it is larger [-]."""
        if self.adequacy is None:
            return math.nan
        return math.sqrt(max(self.adequacy.chi2_fit, self.adequacy.chi2_holdout or 0.0, 0.0))

    @property
    def named(self) -> str:
        """What was found or what the residual resembles: things joined by "+", those of a set by "or"."""
        return " + ".join(" or ".join(names) for names in self.alternatives)

    @property
    def _named_with_values(self) -> str:
        """What was found, the effects of a set with their values."""

        def shown(name: str, names: Sequence[str]) -> str:
            # a cause in words has its value there
            is_effect = len(names) > 1 and " " not in name
            values = values_in_words(self.alternative_values.get(name, {})) if is_effect else ""
            return f"{name} ({values})" if values else name

        return " + ".join(" or ".join(shown(name, names) for name in names) for names in self.alternatives)

    def in_short(self) -> str:
        """The finding in a word, and what it names.

        >>> from sim_heating.closure.result import Statement
        >>> Statement("partly", [["transition", "gap-flow"]]).in_short()
        'partly: transition or gap-flow'
        """
        return f"{self.finding}: {self.named}" if self.named else self.finding

    def in_words(self) -> str:
        """The finding in a few words."""
        if self.finding == FOUND:
            causes = {c.what for c in self.not_effects}
            aerothermal = any(name not in causes for names in self.alternatives for name in names)
            return f"Found: {self.named}" if aerothermal else f"Found, and no aerothermal effect: {self.named}"
        if self.finding == ONE_OF:
            return f"One of: {self._named_with_values}, which the record cannot tell apart"
        if self.finding == PARTLY:
            return f"Partly: it resembles {self.named}, which leaves {self.noise_floors:.1f} noise floors {self._where}"
        if self.finding == UNKNOWN:
            return "Unknown: something is missing that no candidate explains"
        return "None: nothing is missing as far as can be seen"

    @property
    def _where(self) -> str:
        """The samples that `noise_floors` is of."""
        a = self.adequacy
        held_out = a is not None and a.chi2_holdout is not None and a.chi2_holdout >= a.chi2_fit
        where = "on the segments held out" if held_out else "in the fitted samples"
        return where if self.model_error is None else f"{where} beyond the model's own error"

    def certainty(self) -> str:
        """How sure the finding is, in a few sentences."""
        lines = []
        if self.probability is not None:
            how = "calibrated" if self.experiment == "flight" else f"calibrated on flights, not on {self.experiment}s"
            lines.append(f"Probability that this finding is right: {_percent(self.probability)} ({how}).")
        if self.adequacy is not None:
            model = {ONE_OF: "The model with the first", UNKNOWN: "The declared model", NONE: "The declared model"}.get(
                self.finding, "The model with it"
            )
            lines.append(f"{model} {self._adequacy_in_words(self.adequacy)}.")
        if self.finding == PARTLY:
            odds = self.improbable
            why = "" if odds is None else f", as it is right with a probability of {_percent(odds)} only"
            part = f"It explains {100.0 * min(self.explained, 1.0):.0f} % of what the declared model leaves above noise"
            if self.model_error is not None:
                part = "The evidence is for it, where each model has an error of its own"
            lines.append(f"{part}, and is not stated as the cause{why}; the errors after are those with it.")
        if self.model_error is not None:
            lines.append(self.model_error.in_words())
            if self.finding in (FOUND, ONE_OF, NONE):
                lines.append("No probability is given: findings on models with an error are not calibrated yet.")
        return " ".join(lines)

    def _adequacy_in_words(self, adequacy: Adequacy) -> str:
        """What a model does to the record."""
        p = f"p-value {p_value_text(adequacy.p_value)}"
        if adequacy.noise_scale > 1.0:
            return f"leaves noise alone, {adequacy.noise_scale:.2f} times as large as declared ({p} with that noise)"
        if adequacy.p_value >= POLICY.adequate_p:
            error = "" if self.model_error is None else " and the model's own error"
            return f"explains the record to its noise{error} ({p})"
        parts = {f"at sensor {n}": v for n, v in adequacy.by_sensor.items()}
        parts |= {f"from {n}": v for n, v in adequacy.by_phase.items()}
        worst = max(parts, key=lambda n: parts[n], default="")
        remain = "" if self.finding == PARTLY else f": {self.noise_floors:.1f} noise floors remain {self._where}"
        most = f"; most, {math.sqrt(parts[worst]):.1f} noise floors, {worst}" if worst else ""
        return f"does not explain the record to its noise ({p}){remain}{most}"

    def would_tell(self) -> list[str]:
        """What would tell the alternatives apart, a line each; none where nothing has to be distinguished.

        Where the best has odds below `Policy.odds_apart`, one line that says so.
        """
        if not self.would_tell_apart:
            return []
        best = max(self.would_tell_apart, key=lambda e: e.log_odds)
        if best.log_odds >= math.log(POLICY.odds_apart):
            return [e.in_words() for e in self.would_tell_apart]
        best_line = f"; the best, {best.in_words()}" if best.log_odds > math.log(1.05) else ""
        return [f"none of the {self.experiment}s tried tells them apart{best_line}"]


def _percent(probability: float) -> str:
    """A probability in per cent, never as certain."""
    return "above 99 %" if probability > 0.99 else f"{100.0 * probability:.0f} %"


@dataclass(frozen=True)
class Finding:
    """A named effect, or "none" or "unknown".

    name       : as in closure.json
    posterior  : its share of the likelihood among the hypotheses, equal prior ones; a comparison, no calibrated
                 probability
    parameters : estimates by their names within the effect
    sensor     : the thermocouple that the effect is of; None where it is of no single one
    """

    name: str
    posterior: float
    parameters: Mapping[str, ParameterEstimate]
    sensor: str | None = None

    @property
    def title(self) -> str:
        """The effect, with its sensor where it has one."""
        return f"{self.name} of {self.sensor}" if self.sensor else self.name

    def as_json(self) -> dict[str, Any]:
        """Its entry in closure.json."""
        sensor = {} if self.sensor is None else {"sensor": {"value": self.sensor, "sigma": None, "unit": ""}}
        parameters = sensor | {n: p.as_json() for n, p in self.parameters.items()}
        return {"name": self.name, "posterior": self.posterior, "parameters": parameters}


@dataclass(frozen=True)
class CandidateScore:
    """One candidate of the first round.

    delta_bic      : its BIC minus that of "none"
    fit_rmse_K     : RMSE of the plain march over the fit segments [K]; NaN where the heating has an error, which the
                     values found leave the rest to
    holdout_rmse_K : over the segments held out [K]; None where there are none
    posterior      : its probability, by its score
    """

    name: str
    delta_bic: float
    fit_rmse_K: float
    holdout_rmse_K: float | None
    posterior: float

    def as_json(self) -> dict[str, Any]:
        """Its entry in closure.json."""
        errors = {"fit_rmse_K": finite_or_none(self.fit_rmse_K), "holdout_rmse_K": finite_or_none(self.holdout_rmse_K)}
        return {"name": self.name, "delta_bic": self.delta_bic, **errors}


@dataclass(frozen=True, eq=False, repr=False)
class Closure:
    """The result of closing the loop on one record.

    predicted, before, after : declared model, None where it lacks a heating ratio; the same fitted; with effects added,
                               `before` where none were
    noise_floor_K : of the used sensors over the fit segments [K]
    reference     : the ratio variables that the derivatives refer to
    effects       : effects in the order in which they were added; a single "none" or "unknown" where there are none
    candidates    : of the first round, "none" included
    parameters    : all estimates of the last fit, by dotted names
    residual, residual_after : residual heating after the derivatives, and after the effects
    evidence      : on the cause of the first residual
    statement     : the finding, its alternatives, its adequacy, and causes that are no effect
    curve         : smooth factor on the heating that the residual follows, where nothing was found and it explains most
    faults        : errors of the record itself
    false_alarm   : chance of naming an effect where there is none, with its calibration
    warnings      : on the fit and its residual
    remarks       : on estimates that nature does not have, or that mean less than their sigma says
    samples       : numbers of readings that the finding rests on, that were held out, and that were left out by reason
    """

    record: Record
    predicted: Prediction | None
    before: Prediction
    after: Prediction
    noise_floor_K: float
    reference: Sequence[float]
    effects: Sequence[Finding]
    candidates: Sequence[CandidateScore]
    parameters: Mapping[str, ParameterEstimate]
    residual: ResidualHeating
    residual_after: ResidualHeating | None
    evidence: ResidualEvidence
    statement: Statement
    curve: CurveBand | None = None
    faults: Sequence[DataFault] = ()
    false_alarm: str = ""
    warnings: Sequence[str] = ()
    remarks: Sequence[Remark] = ()
    samples: Mapping[str, Any] = field(default_factory=dict)

    @property
    def reference_condition(self) -> dict[str, float]:
        """What the derivatives refer to, by ratio variable."""
        return dict(zip(RATIO_VARIABLES, map(float, self.reference), strict=True))

    @property
    def named(self) -> str:
        """What was found, joined: the effects, else causes that are none; "unknown" or "none"."""
        if self.added:
            return self.statement.named
        return self.effects[0].name

    @property
    def fitted_with(self) -> str:
        """What the model after has and the one before has not: of a set, its first alone."""
        named = [names[0] for names in self.statement.alternatives] if self.added else self.statement.resembles
        return " + ".join(named)

    @property
    def added(self) -> bool:
        """Whether a cause was found that the model after has, and the one before has not."""
        return self.statement.finding in (FOUND, ONE_OF)

    @property
    def compared(self) -> bool:
        """Whether errors after are of another model than those before, named as the cause or not."""
        return self.after is not self.before

    @cached_property
    def credibility(self) -> Credibility:
        """What supports the finding, factor by factor."""
        return credibility_of_finding(
            self.statement,
            [self.after],
            self.parameters,
            self.reference,
            self.after.segment_errors(),
            faulty=bool(self.faults),
        )

    def __repr__(self) -> str:
        errors = (p.segment_errors()["fit"]["rmse_K"] for p in (self.before, self.after))
        fault = f", {self.faults[0].kind}" if self.faults else ""
        before, after = (f"{e:.2f} K" for e in errors)
        finding = f"{self.statement.in_short()}{fault}"
        return f"<Closure of {self.record.name}: {finding}, RMSE {before} before, {after} after>"


# Several records ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class JointClosure:
    """The result of closing the loop on several records jointly.

    closures   : each record by itself
    search     : the joint search, with what each record adds
    effects    : common effects; a single "none" or "unknown" where there are none
    statement  : the finding, its alternatives, its adequacy, and causes that are no effect
    candidates : causes that were fitted jointly, "none" included
    parameters : all estimates of the last fit, by label
    after      : each record with what was found [K]; of a record without it, its declared model with derivatives fitted
    warnings   : on the fit
    flights    : by flight, the error that its points have in common: by name, value and standard deviation in its unit;
                 None where the readings do not tell it apart
    """

    closures: Sequence[Closure]
    search: JointSearch
    effects: Sequence[Finding]
    statement: Statement
    candidates: Sequence[CandidateScore]
    parameters: Mapping[str, ParameterEstimate]
    after: Sequence[Prediction]
    warnings: Sequence[str] = ()
    flights: Mapping[str, Mapping[str, tuple[float, float] | None]] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """Names of the records."""
        return [c.record.name for c in self.closures]

    @property
    def named(self) -> str:
        """What was found in common, or what the records resemble; "unknown" or "none"."""
        return self.statement.named or self.effects[0].name

    @cached_property
    def credibility(self) -> Credibility:
        """What supports the joint finding, factor by factor."""
        faulty = any(c.faults for c in self.closures)
        reference = self.closures[0].reference
        return credibility_of_finding(
            self.statement, self.after, self.parameters, reference, self.pooled(self.after), faulty=faulty
        )

    def pooled(self, predictions: Sequence[Prediction]) -> dict[str, Any]:
        """rmse_K, max_abs_K and n over all records' fit and holdout segments; None where none has a sample."""
        errors = [p.segment_errors() for p in predictions]
        return {segment: _pooled([f[segment] for f in errors]) for segment in ("fit", "holdout")}

    def __repr__(self) -> str:
        before, after = (self.pooled(p)["fit"]["rmse_K"] for p in ([c.before for c in self.closures], self.after))
        errors = f"RMSE {before:.2f} K before, {after:.2f} K after"
        return f"<JointClosedLoop of {', '.join(self.names)}: {self.statement.in_short()}, {errors}>"

    def in_words(self) -> str:
        """The finding in a few words, with the records that have it where not all do."""
        finding = _plural(self.statement.in_words())
        without = [e.record for e in self.search.evidence if not e.member]
        if not self.search.explained or not without:
            return finding
        return f"{finding} in {listed([n for n in self.names if n not in without])}, not in {listed(without)}"

    def certainty(self) -> str:
        """How sure the finding is, in one line."""
        return _plural(self.statement.certainty())

    def remarks(self) -> list[str]:
        """What differs between the records, and faults of their data, a line each."""
        best = self.search.best
        lines = [f"{c.record.name}, by itself: {f.message}" for c in self.closures for f in c.faults]
        lines += self._not_tried_in_common()
        for flight, errors in self.flights.items():
            lines.append(f"Error of flight {flight}, of all its points: {flight_in_words(errors) or 'not told apart'}")
        if best.model is None or not self.search.explained:
            return lines
        widest = best.model.cause.widest
        narrower = [name for name, level in best.model.levels.items() if level != widest[name]]
        return [*lines, *self._verdicts(), *filter(None, map(self._values_apart, narrower))]

    def _verdicts(self) -> Iterator[str]:
        for e in self.search.evidence:
            if e.verdict == "contradicts it":
                yield (
                    f"{e.record} contradicts {' + '.join(self.search.best.names)}: with the values of the other "
                    f"records its score is {-e.for_cause:.0f} worse than without it; by itself it concludes: "
                    f"{finding_alone(e)}"
                )
            elif e.verdict == "other values":
                yield f"{e.record} gives other values than those in common (p = {e.agreement:.1g})"

    def _values_apart(self, name: str) -> str:
        """The values of a parameter that several records or points have each for itself; empty for a common one."""
        estimates = {k: p for k, p in self.parameters.items() if k.partition(AT)[0] == name and AT in k}
        values = ", ".join(f"{p.value:.4g} +- {p.sigma:.2g} in {k.partition(AT)[2]}" for k, p in estimates.items())
        return f"{name.rpartition('.')[2]} is not in common: {values}" if len(estimates) > 1 else ""

    def _not_tried_in_common(self) -> list[str]:
        """What explains a record by itself and was not fitted to all, as the flux of a lamp, a line each."""
        tried = {name for h in self.search.hypotheses for name in h.names}
        lines = []
        for closure, alone in zip(self.closures, self.search.alone, strict=True):
            sets = zip(alone.conclusion.alternatives, closure.statement.alternatives, strict=True)
            causes = [w for names, texts in sets for n, w in zip(names, texts, strict=True) if n not in tried]
            if alone.explained and causes:
                lines.append(f"{closure.record.name}, by itself: {listed(causes)}, which was not tried in common")
        return lines


def _plural(text: str) -> str:
    """A statement on one record as one on several."""
    for singular, plural in (("the record to its", "the records to their"), ("the record shows", "the records show")):
        text = text.replace(singular, plural)
    return re.sub(r"\bthe record\b", "the records", text)


def _pooled(errors: Sequence[Mapping[str, float] | None]) -> dict[str, float] | None:
    stated = [e for e in errors if e is not None and e["n"]]
    count = sum(e["n"] for e in stated)
    if not count:
        return None
    rmse = float(np.sqrt(sum(e["n"] * e["rmse_K"] ** 2 for e in stated) / count))
    return {"rmse_K": rmse, "max_abs_K": max(e["max_abs_K"] for e in stated), "n": int(count)}


def finding_alone(e: Evidence) -> str:
    """The finding of a record by itself."""
    return {"partly": f"resembles {e.named}", "unknown": "unknown", "none": "none"}.get(e.alone, e.named)


# Credibility ----------------------------------------------------------------------------------------------------------


def credibility_of_finding(
    statement: Statement,
    predictions: Sequence[Prediction],
    parameters: Mapping[str, ParameterEstimate],
    reference: Sequence[float],
    errors: Mapping[str, Any],
    *,
    faulty: bool,
) -> Credibility:
    """The credibility statement of a closed loop.

    statement  : the finding;  predictions : each record with what was found
    parameters : estimates of the last fit;  reference : condition of its derivatives [deg, deg, -, deg, deg]
    errors     : rmse_K over `fit` and `holdout`, None where there is none
    faulty     : whether the data of a record have faults, so that the finding is none
    """
    facts = of_several([p.facts("closed loop", with_peak=False) for p in predictions])
    sigma = {n: e.sigma for n, e in parameters.items() if math.isfinite(e.sigma)}
    adequacy, p = statement.adequacy, statement.probability
    of_finding = replace(
        facts,
        topics=facts.topics | {"estimates", "sensitivities"},
        sigma=bool(sigma),
        uncertainty=ratio_uncertainty(sigma, [a.record for a in predictions], reference),
        consistent=Answer(
            adequacy is not None and adequacy.p_value >= POLICY.adequate_p,
            "no test of adequacy" if adequacy is None else f"p-value of adequacy {p_value_text(adequacy.p_value)}",
        ),
        holds=Answer(
            p is not None and p >= POLICY.confidence and not faulty,
            "no calibrated probability of the finding" if p is None else f"probability of the finding {p:.2f}",
        ),
        varied=held_out(*(None if errors[n] is None else errors[n]["rmse_K"] for n in ("fit", "holdout"))),
    )
    return assess(of_finding)
