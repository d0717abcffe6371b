"""What a closed loop states: the finding in a word, its alternatives, its adequacy, and how sure it is."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from sim_heating.base.parameters import AT
from sim_heating.closure.search.adequacy import ADEQUATE, Adequacy
from sim_heating.closure.search.tell_apart import Experiment
from sim_heating.closure.search.trials.told_error import ToldError

FOUND, ONE_OF, PARTLY, UNKNOWN, NONE = "found", "one of", "partly", "unknown", "none"
"""The findings of a closure report."""
LEAST_P_VALUE = 1e-6
"""p-value below which its size says no more."""
LEAST_ODDS = 20.0
"""Odds below which an experiment tells nothing apart."""
HARDLY = 1.05
"""Odds below which their size says no more."""
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
        return {"value": float(self.value), "sigma": finite(self.sigma), "unit": self.unit}


def values_in_words(parameters: Mapping[str, ParameterEstimate]) -> str:
    """Estimates in a few words: a factor as a change in per cent, others by their names; no more than three.

    >>> from sim_heating.closure.statement import ParameterEstimate, values_in_words
    >>> values_in_words({"heat_capacity_factor": ParameterEstimate(0.949, 0.002, "1")})
    'heat capacity 5.1 % lower'
    """
    return ", ".join(_value_in_words(n, p) for n, p in list(parameters.items())[:3])


def _value_in_words(name: str, p: ParameterEstimate) -> str:
    own, at, whose = name.partition(AT)
    if own.endswith(FACTOR) and p.unit == "1":
        percent = 100.0 * (p.value - 1.0)
        noun = NOUNS.get(own, own.removesuffix(FACTOR).replace("_", " "))
        where = f" in {whose}" if at else ""
        return f"{noun} {abs(percent):.2g} % {'higher' if percent > 0.0 else 'lower'}{where}"
    return f"{name} {p.value:.3g}{'' if p.unit == '1' else f' {p.unit}'}"


def finite(value: float | None) -> float | None:
    """A number for JSON: None where it is not finite."""
    return float(value) if value is not None and math.isfinite(value) else None


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

    def as_json(self) -> dict[str, Any]:
        """Its entry in closure.json."""
        return {"names": list(self.names), "reason": self.reason, "delta_evidence": self.delta_evidence}


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
            "would_tell_apart": [e.as_json() for e in self.would_tell_apart],
            "resembles": list(self.resembles),
            "model_error": None if self.model_error is None else self.model_error.as_json(),
            "barred": [b.as_json() for b in self.barred],
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

        >>> from sim_heating.closure.statement import Statement
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
        of = self.adequacy
        held_out = of is not None and of.chi2_holdout is not None and of.chi2_holdout >= of.chi2_fit
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
            lines.append(
                f"It explains {100.0 * min(self.explained, 1.0):.0f} % of what the declared model leaves above noise, "
                f"and is not stated as the cause{why}; the errors after are those with it."
            )
        if self.model_error is not None:
            lines.append(self.model_error.in_words())
            if self.finding in (FOUND, ONE_OF, NONE):
                lines.append("No probability is given: findings on models with an error are not calibrated yet.")
        return " ".join(lines)

    def _adequacy_in_words(self, adequacy: Adequacy) -> str:
        """What a model does to the record."""
        p = f"p = {adequacy.p_value:.2g}" if adequacy.p_value >= LEAST_P_VALUE else f"p below {LEAST_P_VALUE:g}"
        if adequacy.p_value >= ADEQUATE:
            error = "" if self.model_error is None else " and the model's own error"
            return f"explains the record to its noise{error} ({p})"
        if adequacy.unstructured:
            times = math.sqrt(adequacy.chi2_fit)
            return f"leaves noise alone, {times:.2f} times as large as declared ({p})"
        parts = {f"at sensor {n}": v for n, v in adequacy.by_sensor.items()}
        parts |= {f"from {n}": v for n, v in adequacy.by_phase.items()}
        worst = max(parts, key=lambda n: parts[n], default="")
        remain = "" if self.finding == PARTLY else f": {self.noise_floors:.1f} noise floors remain {self._where}"
        most = f"; most, {math.sqrt(parts[worst]):.1f} noise floors, {worst}" if worst else ""
        return f"does not explain the record to its noise ({p}){remain}{most}"

    def would_tell(self) -> list[str]:
        """What would tell the alternatives apart, a line each; none where nothing has to be told apart.

        Where the best has odds below LEAST_ODDS, one line that says so.
        """
        if not self.would_tell_apart:
            return []
        best = max(self.would_tell_apart, key=lambda e: e.log_odds)
        if best.log_odds >= math.log(LEAST_ODDS):
            return [e.in_words() for e in self.would_tell_apart]
        found = f"; the best, {best.in_words()}" if best.log_odds > math.log(HARDLY) else ""
        return [f"none of the {self.experiment}s tried tells them apart{found}"]


def _percent(probability: float) -> str:
    """A probability in per cent, never as certain."""
    return "above 99 %" if probability > 0.99 else f"{100.0 * probability:.0f} %"
