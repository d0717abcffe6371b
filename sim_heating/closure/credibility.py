"""What supports the finding of a closed loop, on one record or on several, factor by factor."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from sim_heating.closure.result import ParameterEstimate, Statement
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.credibility.facts.of_records import held_out, of_several, ratio_uncertainty
from sim_heating.credibility.statement import Answer, assess
from sim_heating.credibility.statement import Statement as Credibility
from sim_heating.simulation.predict import Prediction


def credibility_of_finding(
    statement: Statement,
    after: Sequence[Prediction],
    parameters: Mapping[str, ParameterEstimate],
    reference: Sequence[float],
    errors: Mapping[str, Any],
    *,
    faulty: bool,
) -> Credibility:
    """The credibility statement of a closed loop.

    statement  : the finding;  after : each record with what was found
    parameters : estimates of the last fit;  reference : condition of its derivatives [deg, deg, -, deg, deg]
    errors     : rmse_K over `fit` and `holdout`, None where there is none
    faulty     : whether the data of a record have faults, so that the finding is none
    """
    facts = of_several([p.facts("closed loop", with_peak=False) for p in after])
    sigma = {n: e.sigma for n, e in parameters.items() if math.isfinite(e.sigma)}
    adequacy, p = statement.adequacy, statement.probability
    found = replace(
        facts,
        topics=facts.topics | {"estimates", "sensitivities"},
        sigma=bool(sigma),
        uncertainty=ratio_uncertainty(sigma, [a.record for a in after], reference),
        consistent=Answer(
            adequacy is not None and adequacy.p_value >= POLICY.adequate_p,
            "no test of adequacy" if adequacy is None else f"p-value of adequacy {adequacy.p_value:.2g}",
        ),
        holds=Answer(
            p is not None and p >= POLICY.confidence and not faulty,
            "no calibrated probability of the finding" if p is None else f"probability of the finding {p:.2f}",
        ),
        varied=held_out(*(None if errors[n] is None else errors[n]["rmse_K"] for n in ("fit", "holdout"))),
    )
    return assess(found)
