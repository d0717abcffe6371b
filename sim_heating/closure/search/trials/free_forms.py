"""Effects in a free form: their own form, and a smooth curve against the variable that they depend on.

Nature's form of an effect is never exactly that of a library. Where the form of the library explains most of a
residual and not all of it, a spline that adds to the ratio (heating/effects/added_curve.py) is fitted with it. The
name stays: what heats with a deflection, with sideslip or with the angle of attack otherwise than by the declared
table and its slopes has the name of that variable's effect. Beyond what a flight informs, the curve returns to the
library's form.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from sim_heating.closure.search.trials.candidates import Candidate, candidates
from sim_heating.closure.search.trials.trial_fit import TrialFit, fitted_effects
from sim_heating.estimation.inference.observability import mean_ratio
from sim_heating.heating.effects.added_curve import ADDED_CURVE
from sim_heating.heating.effects.curve import ALPHA, BETA, BODYFLAP, ELEVON, SCATTER, VALUES, VARIABLE
from sim_heating.inputs.points import conditions_of_record

FREE_FORMS: Mapping[str, int] = {
    "alpha-curvature": ALPHA,
    "impingement-onset": ALPHA,
    "elevon-curvature": ELEVON,
    "bodyflap-curvature": BODYFLAP,
    "sideslip": BETA,
}
"""Effects that add to the ratio as a function of one variable, with the number of that variable in a curve."""


def has_free_form(trial: TrialFit) -> bool:
    """Whether an effect of a trial's model is in a free form."""
    return any(used.effect.name == ADDED_CURVE for used in fitted_effects(trial))


def free_form(base: TrialFit, trial: TrialFit, values: Mapping[str, float]) -> Candidate | None:
    """The candidate of an effect in a free form, under the name of the effect; None where it has none in a record.

    base : the declared model;  trial : the effect fitted in the form of the library
    values   : values to start from by dotted name

    Values at the knots have a prior of SCATTER times the mean ratio of the declared table.
    """
    library = trial.candidate
    if library.name not in FREE_FORMS or has_free_form(trial):
        return None
    record = base.record_fit.record
    flown = conditions_of_record(record)
    fitted = flown.at(flown.time_s[record.fit_mask(flown.time_s)])
    for curve in candidates(record, fitted, last_resort=True):
        (used,) = curve.uses
        if used.effect.name == ADDED_CURVE and used.values[VARIABLE] == FREE_FORMS[library.name]:
            sigma = SCATTER * mean_ratio(record)
            declared = tuple(replace(p, sigma=sigma) if p.name in VALUES else p for p in used.definitions)
            return replace(
                library,
                uses=(*library.uses, replace(used, declared=declared)),
                names=(*library.names, *curve.names),
                start={**{n: values[n] for n in library.names}, **curve.start},
                active=(*library.names, *curve.names),
                with_prior=(*library.with_prior, *curve.with_prior),
            )
    return None
