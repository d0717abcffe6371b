"""What a closed loop tells of the error of its model, and of the samples that it used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.parameters import CLOCK_SKEW
from sim_heating.closure.prior.model_error import START, SmoothFlightError
from sim_heating.closure.search.trials.trial_fit import TrialFit
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.estimation.inference.error_likelihood import FORM_ERROR
from sim_heating.estimation.inference.model_error import ModelError

TIME_SHIFT = "time_shift_s"
IN_WORDS = {
    TIME_SHIFT: (1.0, "s later"), "time_stretch": (100.0, "% longer"), "velocity_relative": (100.0, "% faster"),
    "alpha_bias_deg": (1.0, "deg higher in angle of attack"), "density_relative": (100.0, "% off in density"),
}  # fmt: skip
"""By error of a flight, the factor to the unit that it is told in, and what a value above 0 means."""


@dataclass(frozen=True)
class ToldError:
    """The error of the model of a record, as the readings show it with one model.

    relative, limit_95 : size of the smooth error of the heating, its mean and the limit that it is below with 95 % [-]
    correlation_s : its likeliest correlation time [s]
    rms_K         : what it does to the fitted readings [K]
    largest_phase : part of the record where it does most
    flight        : by name, value and standard deviation of an error of the flight, in its unit; None where the record
                    does not tell it apart
    flight_scale  : factor on the standard deviations of the flight, stated or by its confidence -> its probability [-];
                    empty where the flight is exact
    form_relative : standard deviation of the errors that the forms of its causes have [-]; 0 where these are exact
    """

    relative: float
    limit_95: float
    correlation_s: float
    rms_K: float
    largest_phase: str
    flight: Mapping[str, tuple[float, float] | None]
    flight_scale: Mapping[float, float] = field(default_factory=dict)
    form_relative: float = 0.0

    def as_json(self) -> dict[str, Any]:
        """Its entry in closure.json."""
        return {
            "relative_heating": {"value": self.relative, "limit_95": self.limit_95},
            "correlation_s": self.correlation_s,
            "rms_K": self.rms_K,
            "largest_phase": self.largest_phase,
            "flight": flight_as_json(self.flight),
            "flight_scale": {f"{scale:g}": p for scale, p in self.flight_scale.items()} or None,
            "form_relative": self.form_relative,
        }

    def in_words(self) -> str:
        """The size of the error, and what is known of the flight's, in a sentence or two."""
        mean, limit = (f"{100.0 * x:.2g} %" for x in (self.relative, self.limit_95))
        text = (
            f"The model's own error is {mean} of the heating (below {limit} with a probability of 95 %) and changes "
            f"within some {self.correlation_s:.0f} s: {self.rms_K:.1f} K of the readings, most from "
            f"{self.largest_phase}."
        )
        if self.form_relative > 0.0:
            text = (
                f"{text} The readings contradict the exact forms of its causes: what these change may be off by "
                f"{100.0 * self.form_relative:.0f} % (one standard deviation, a choice)."
            )
        flight_text = flight_in_words(self.flight)
        if flight_text:
            text = f"{text} Against its conditions the flight was: {flight_text}."
        return f"{text} {scale_in_words(self.flight_scale)}." if self.flight_scale else text


def flight_as_json(flight: Mapping[str, tuple[float, float] | None]) -> dict[str, Any]:
    """Errors of a flight by name, as closure.json has them."""
    return {n: None if p is None else {"value": p[0], "sigma": p[1]} for n, p in flight.items()}


def flight_in_words(flight: Mapping[str, tuple[float, float] | None]) -> str:
    """Errors of a flight that the readings tell apart, in words; empty where there are none."""
    determined = {n: p for n, p in flight.items() if p is not None}
    scaled = [
        (IN_WORDS[n][0] * value, IN_WORDS[n][0] * sigma, IN_WORDS[n][1]) for n, (value, sigma) in determined.items()
    ]
    return ", ".join(f"{value:+.2g} +- {sigma:.1g} {meaning}" for value, sigma, meaning in scaled)


def scale_in_words(flight_scale: Mapping[float, float]) -> str:
    """By how much the errors of a flight are larger than stated, or smaller than its confidence says, in words.

    flight_scale : factor on the standard deviations -> its probability [-]; 1 is among them
    """
    basis = "stated" if max(flight_scale) > 1.0 else "its confidence says"
    others = ", ".join(f"{s:g} times as large with {100.0 * p:.0f} %" for s, p in flight_scale.items() if s != 1.0)
    return f"Its errors are as large as {basis} with a probability of {100.0 * flight_scale[1.0]:.0f} %, {others}"


def told_error(trial: TrialFit) -> ToldError | None:
    """The error of a trial's model; None for a model without one."""
    phase_count = 8  # consecutive parts of a record whose error is compared
    record_fit, size = trial.record_fit, trial.size
    error, G = record_fit.model_error, record_fit.error_root_K
    if error is None or size is None or G is None:
        return None
    u = trial.problem.errors(trial.fit.values)[0]
    moved_K = G[:, : len(error.time_s)] @ u[: len(error.time_s)]
    at_s = np.concatenate([record_fit.sample_s[c.samples] for c in record_fit.channels])
    order = np.argsort(at_s, kind="stable")
    phases = [index for index in np.array_split(order, phase_count) if len(index)]
    largest = max(phases, key=lambda index: float(np.mean(moved_K[index] ** 2)))
    return ToldError(
        size.mean, size.limit(), size.likeliest[1].time_s, float(np.sqrt(np.mean(moved_K**2))),
        f"{at_s[largest[0]]:.0f} to {at_s[largest[-1]]:.0f} s", _flight(trial, error, u),
        size.posterior_of_scale if len(size.scales) > 1 else {}, 0.0 if error.form_K is None else FORM_ERROR,
    )  # fmt: skip


def _flight(trial: TrialFit, error: ModelError, u: FloatArray) -> dict[str, tuple[float, float] | None]:
    """Value and standard deviation of each error of the flight; None where the record does not tell it apart."""
    flight, state = error.flight, trial.known_error
    if not isinstance(flight, SmoothFlightError) or state is None or trial.record_fit.flight_names:
        return {}
    errors = told_flight(flight, error.along_flight(u), state.covariance[error.of_flight, error.of_flight])
    if flight.has_one_clock and CLOCK_SKEW.name in trial.fit.names:
        k = trial.fit.names.index(CLOCK_SKEW.name)
        shift_s, sigma = float(trial.fit.values[k]), float(trial.fit.sigma[k])
        errors[TIME_SHIFT] = (shift_s, sigma) if 0.0 < sigma < POLICY.told_apart * flight.clock_sigma_s else None
    return errors


def told_flight(
    flight: SmoothFlightError, f: FloatArray, covariance: FloatArray
) -> dict[str, tuple[float, float] | None]:
    """Value and standard deviation of each error of a flight in its unit; None where the readings do not tell it apart.

    f : (direction,) in standard deviations [-];  covariance : of it [-]
    """
    errors: dict[str, tuple[float, float] | None] = {}
    for name, (row, prior) in flight.rows.items():
        if name == START:  # what a clock that is off does to the wall before the first reading
            continue
        sigma = float(np.sqrt(np.mean(np.einsum("ij,jk,ik->i", row, covariance, row))))
        value = row @ f
        size = float(value[0]) if len(value) == 1 else float(np.sqrt(np.mean(value**2)))
        errors[name] = (size, sigma) if sigma < POLICY.told_apart * prior else None
    return errors
