"""Every threshold that decides what a closed loop states, in one value.

A field of `Policy` has its unit, a sentence that says what it decides, and where its number comes from (`rule`).
Numbers that only say how long a search goes on are those of `Effort`: they cost time, and with too small ones a cause
may be missed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

CHOSEN = "a choice: no source is recorded"


def rule(value: float, unit: str, sentence: str, source: str = CHOSEN) -> Any:
    """A field of `Policy` with its unit, what it decides, and where its number comes from."""
    return field(default=value, metadata={"unit": unit, "sentence": sentence, "source": source})


@dataclass(frozen=True)
class Policy:
    """The thresholds of a verdict."""

    # what a record has to have
    min_reading_times: int = rule(10, "1", "With readings at fewer times any cause would explain the residual.")
    min_samples_for_probability: int = rule(
        30, "1", "Of fewer fitted readings no probability is given.", "no record of the calibration has fewer"
    )

    # whether a model explains a record
    adequate_p: float = rule(
        0.01, "1", "A model with a p-value of at least this explains the record to its noise.", "the usual level of 1 %"
    )
    contradicted_p: float = rule(
        0.001,
        "1",
        "Below this values contradict each other: those of several records, or a flight and its table.",
        "a tenth of adequate_p: one record in a thousand by chance",
    )
    model_error_chi2: float = rule(
        0.03, "1", "Excess chi-square that meshes and steps may leave.", "a choice for the meshes of the search"
    )
    uneven_chi2: float = rule(
        0.15, "1", "Excess of a part's chi-square, over that of the record, that noise of one size has."
    )
    max_lag1: float = rule(0.4, "1", "Largest lag-1 autocorrelation that counts as the colour of noise.")
    noise_colour: float = rule(0.1, "1", "Autocorrelation by which the colours of recorders differ.")
    max_heating_error: float = rule(
        0.15,
        "1",
        "With a larger relative error of its heating a model is no explanation.",
        "three times the error that a measured flight is expected to have",
    )

    # whether a cause may be named
    min_sigmas: float = rule(
        3.0, "sigma", "A magnitude nearer to none at all is not told from none.", "the usual three standard deviations"
    )
    max_scatter_sigmas: float = rule(
        4.0,
        "sigma",
        "A declared value scatters up to this distance; what is further off is wrong for a reason.",
        "one normal value in 16,000 is beyond",
    )
    near_bound_sigmas: float = rule(
        2.0, "sigma", "A bound this near to the nominal value is a value as good as any other, as of a sharp onset."
    )
    settled_gain: float = rule(
        0.5,
        "log likelihood",
        "A fit, or an error of a model, that a further step would not improve by more has converged.",
        "half a unit is one standard deviation of one parameter",
    )
    held_out_gain: float = rule(
        1.0, "log density", "A cause predicts the samples held out no worse than by this, and better where it promises."
    )
    promised_gain: float = rule(
        3.0, "log density", "Promise, by what is explained of the fitted samples, that those held out have to keep."
    )

    # which cause is named
    min_gain: float = rule(
        10.0,
        "BIC",
        "A cause, or one more, has to be better than none by this.",
        "called very strong evidence by Kass & Raftery (1995), J. Am. Stat. Assoc. 90, 773",
    )
    min_gain_over_adequate: float = rule(
        30.0,
        "BIC",
        "A cause gains this over an exact model that explains the record, further ones over the simplest that does: "
        "errors of form give some gain.",
    )
    min_gain_of_further: float = rule(6.0, "BIC", "One cause more gains this over every model with fewer.")
    max_causes: int = rule(3, "1", "Causes of a model at most.")
    min_explained: float = rule(
        0.5, "1", "Part of the remaining excess chi-square that a cause, or one more, or a curve, has to explain."
    )
    min_explained_over_first: float = rule(
        0.1, "1", "Chi-square that a further cause explains over that of the first: another form of it leaves less."
    )
    min_explained_by_library: float = rule(
        0.9, "1", "Part of the excess that a library's form explains before a free one is tried, which follows all."
    )
    odds_apart: float = rule(
        20.0,
        "1",
        "Hypotheses with smaller odds between them cannot be told apart, nor does an experiment do so.",
        "the usual level of 5 %",
    )
    twin_margin: float = rule(
        40.0, "BIC", "Twins with scores this near are told apart by an error of the model's form, not by the record."
    )
    reported_excess: float = rule(0.2, "1", "Excess chi-square from which on the residual of a finding is reported.")

    # how sure it is
    min_probability: float = rule(
        0.5, "1", "A finding with a smaller probability is not stated.", "rather right than wrong"
    )
    max_probability: float = rule(
        0.99, "1", "Largest probability that is stated.", "some hundred records of known truth support no more"
    )
    min_p_value: float = rule(1e-6, "1", "Below this the size of a p-value says no more.")
    confidence: float = rule(0.95, "1", "Confidence of a limit: of false alarms, of sizes.", "the usual level of 5 %")
    told_apart: float = rule(
        0.5, "1", "An error of the flight is told by itself where its sigma is below this part of its prior's."
    )
    significance: float = rule(0.01, "1", "Level of the tests for clues in a residual.", "the usual level of 1 %")

    # what is fitted on
    min_promised: float = rule(
        0.25, "1", "Part of the best predicted gain below which a candidate is not fitted.", "predictions are linear"
    )
    gain_margin: float = rule(
        5.0, "log likelihood", "What a prediction may be wrong by, and a candidate that is fitted on behind the best."
    )
    min_of_best: float = rule(
        0.5, "1", "Part of the best gain with which one that may be one of two causes, or a rival, is fitted on."
    )
    min_of_adequate: float = rule(
        0.85, "1", "Part of the best gain with which a rival of a model that explains the record is fitted on."
    )
    rival_margin: float = rule(
        30.0, "log likelihood", "Distance from the best gain within which a candidate is a rival in any case."
    )

    @property
    def set_margin(self) -> float:
        """Difference of scores within which hypotheses cannot be distinguished [BIC]."""
        return 2.0 * math.log(self.odds_apart)


@dataclass(frozen=True)
class Effort:
    """How long a search goes on.

    compared : leading hypotheses that are judged with an error of their own, changes and common causes that are fitted
    causes   : leading causes of a round that are fitted to convergence, or that a further one is sought on top of
    rivals   : times that members of a model are exchanged, models with a further cause that are judged each time,
               richer forms of a cause, starts of a common one
    starts   : starts of one form, and second causes that are kept on top of each first one
    """

    compared: int = 8
    causes: int = 6
    rivals: int = 3
    starts: int = 2


POLICY = Policy()
EFFORT = Effort()
