"""What the model of a record may be off before any reading: the priors of its heating's error and of its flight's.

A record states both ([heating.uncertainty], [conditions.uncertainty]). A measured record that does not has defaults;
the model of a record that was generated and states none is exact.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import chdtrc

from sim_heating.base.arrays import FloatArray
from sim_heating.base.parameters import CLOCK_SKEW, Parameter
from sim_heating.closure.prior.changed_flight import ANGLES, shift_conditions, with_alpha, with_density, with_velocity
from sim_heating.estimation.inference.model_error import AS_STATED, HeatingErrorPrior, StatedError
from sim_heating.estimation.record_fit import SKEW_SPAN_S
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import BY_CONFIDENCE, FlightUncertainty, Record

DENSITY, START = "density_relative", "start_s"
FROM_FLIGHT = ("h_ref_kg_m2_s", "H_r_J_kg", "p_surface_Pa")
"""Columns that the error of a flight acts through; one of its duration through the angles as well, where the flight has
one clock.

Reynolds and Mach number stay as stated: when an onset is reached is what its own parameter says, and a derivative along
the flight's error could not say it.
"""


MEASURED_FLIGHT = HeatingErrorPrior()
"""Error of the heating of a measured flight that states none."""
SCALES = (1.0, 2.0, 4.0)
"""Factors by which standard deviations that a record states may be too small."""
JUDGED_SCALES = dict.fromkeys((0.25, 0.5, 1.0), 1.0 / 3.0)
"""Factors by which standard deviations that follow from a confidence may be too large, with their probabilities."""
KNOTS_A_SCALE, MOST_KNOTS = 3.0, 100
"""Knots of the density's error in each length that it is correlated over, and their intervals at most.

The line between knots a distance h apart leaves out tanh(h / 2) of its variance at the middle, h over that length.
"""
STATED_DOF = 3.0
"""Degrees of freedom of a standard deviation that a record states: it is itself known to 40 % (JCGM 100:2008, G.4.2).

Differences between measurements of one quantity, over their stated uncertainties, have Student's t distribution with
few of them, often near one (D. C. Bailey, "Not Normal: the uncertainties of scientific measurements", R. Soc. Open Sci.
4 (2017) 160600).
"""


def heating_error_prior(record: Record) -> HeatingErrorPrior | None:
    """The prior of the error of a record's heating, of size 0 where only its flight or a sensor has one; None where its
    model is exact. The flux of a lamp is what its record states."""
    stated = record.declared.heating.uncertainty
    slow = any(s.noise_sigma_K and s.noise_correlation_s for s in record.used_sensors)
    if stated is None and record.declared.measured and record.has_flow:
        return MEASURED_FLIGHT
    if stated is None or stated.relative == 0.0:
        is_needed = slow or flight_error(record) is not None
        return replace(MEASURED_FLIGHT, relative=0.0) if is_needed else None
    prior = replace(MEASURED_FLIGHT, relative=stated.relative, scales=stated_scales())
    tau_s = stated.correlation_s
    return prior if tau_s is None else replace(prior, shortest_s=tau_s, longest_s=tau_s)


def stated_scales() -> Mapping[float, float]:
    """Factor on standard deviations that a record states -> its prior probability [-].

    Source: docs/theory/model_error.md, equation 5a.
    """
    c = np.array(SCALES)
    smaller = chdtrc(STATED_DOF, STATED_DOF / (c[1:] * c[:-1]))
    return dict(zip(SCALES, np.diff(smaller, prepend=0.0, append=1.0).tolist(), strict=True))


def flight_scales(record: Record) -> Mapping[float, float]:
    """Factor on the standard deviations of a record's flight -> its prior probability [-].

    Those that a record states may be too small; those that follow from a confidence are wide enough, and may be too
    large. Source: docs/theory/model_error.md, equation 5a.
    """
    if flight_error(record) is None:
        return AS_STATED
    return JUDGED_SCALES if record.declared.conditions.uncertainty is None else stated_scales()


def flight_error(record: Record) -> SmoothFlightError | None:
    """The error of a record's flight; None for a test without flow, and where the flight is exact."""
    stated = record.declared.conditions.uncertainty
    if stated is None and record.declared.measured:
        stated = BY_CONFIDENCE.get(record.declared.conditions.confidence[:1], BY_CONFIDENCE["B"])
    if stated is None or not record.has_flow:
        return None
    z = record.conditions["altitude_m"]
    count = min(math.ceil(KNOTS_A_SCALE * (z.max() - z.min()) / stated.density_scale_m), MOST_KNOTS)
    error = SmoothFlightError(record, stated, np.linspace(z.min(), z.max(), max(count, 1) + 1))
    return error if error.directions else None


def clock_prior(record: Record, agreement_s: float, *, is_free: bool = False) -> Parameter:
    """The clock of the readings against that of the conditions, with its prior in the declared model.

    agreement_s : by how much two recorders differ that agree [s]

    It is as uncertain as the time of the flight, and as recorders that agree at least. A shift moves the answer to a
    manoeuvre by more than a derivative can say, so that it is a parameter of the march, up to SKEW_SPAN_S. A flight
    whose time is less well known may not be the one that was flown: its heating is then earlier or later than its
    angles say.
    is_free      : whether the clock of such a flight may be off besides, by more than those of recorders that agree
    """
    # standard deviations by which the clock of a flight may be off, as far as the record allows; these may be wider
    # than stated
    clock_sigmas = 3.0
    error = flight_error(record)
    if error is None or not (error.has_one_clock or (is_free and error.has_clock)):
        return replace(CLOCK_SKEW, lower=-agreement_s, upper=agreement_s)
    sigma_s = error.clock_sigma_s
    limit_s = min(max(clock_sigmas * max(flight_scales(record)) * sigma_s, agreement_s), SKEW_SPAN_S)
    return replace(CLOCK_SKEW, sigma=max(sigma_s, agreement_s), lower=-limit_s, upper=limit_s)


@dataclass(frozen=True, eq=False)
class SmoothFlightError:
    """Error of a flight in time, velocity, angle of attack, and density along the altitude.

    flown       : the record as stated
    uncertainty : one standard deviation of each; the logarithm of the density is a first-order Gauss-Markov process
                  along the altitude
    altitudes_m : (knot,) that it is linear between [m]
    scale       : factor on the standard deviations as stated [-]
    """

    flown: Record
    uncertainty: FlightUncertainty
    altitudes_m: FloatArray
    scale: float = 1.0

    def of_scale(self, scale: float) -> SmoothFlightError:
        """This error with another factor on the standard deviations as stated [-]."""
        return replace(self, scale=scale)

    @property
    def has_clock(self) -> bool:
        """Whether the clock of the conditions may be off: its shift is a parameter of the model (`clock_prior`)."""
        return self.uncertainty.time_shift_s > 0.0

    @property
    def has_one_clock(self) -> bool:
        """Whether that is all of the error in time, angles and heating being of one clock."""
        return self.has_clock and self.uncertainty.time_shift_s <= SKEW_SPAN_S

    @property
    def clock_sigma_s(self) -> float:
        """One standard deviation of the clock at the first row [s]: a record does not say about which of its times its
        duration is off."""
        u, t = self.uncertainty, self.flown.conditions.time_s
        return math.hypot(u.time_shift_s, 0.5 * u.time_stretch * (t[-1] - t[0]))

    @cached_property
    def directions(self) -> Sequence[tuple[str, float]]:
        """(direction,) what differs, as in a closure report, and its standard deviation in its unit.

        The wall of a flight that is later than its conditions was heated for less time before the first reading:
        `start_s`, beside the shift of its clock, as the wall may have its initial temperatures by either clock.
        """
        u = self.uncertainty
        shift, start = ("time_shift_s", u.time_shift_s), (START, self.clock_sigma_s)
        single = [
            start if self.has_one_clock else shift, ("time_stretch", u.time_stretch),
            ("velocity_relative", u.velocity_relative), ("alpha_bias_deg", u.alpha_deg),
        ]  # fmt: skip
        density = [(DENSITY, u.density_relative)] * len(self.altitudes_m)
        return [(name, self.scale * sigma) for name, sigma in (*single, *density) if sigma > 0.0]

    @cached_property
    def _density_root(self) -> FloatArray:
        """(knot, knot) lower root of the correlation of the density's error [-]."""
        apart = np.abs(self.altitudes_m[:, np.newaxis] - self.altitudes_m)
        return np.asarray(np.linalg.cholesky(np.exp(-apart / self.uncertainty.density_scale_m)))

    @cached_property
    def rows(self) -> dict[str, tuple[FloatArray, float]]:
        """By name, the (value, direction) matrix from standard deviations to values, and the prior's own.

        One value of each but the density, whose relative error has one at each knot.
        """
        names, count = [name for name, _ in self.directions], len(self.directions)
        rows_by_name = {n: (s * np.eye(count)[[i]], s) for i, (n, s) in enumerate(self.directions)}
        of_density = [i for i, n in enumerate(names) if n == DENSITY]
        if of_density:
            rows = np.zeros((len(of_density), count))
            sigma = self.scale * self.uncertainty.density_relative
            rows[:, of_density] = sigma * self._density_root
            rows_by_name[DENSITY] = rows, sigma
        return rows_by_name

    def record(self, f: FloatArray) -> Record:
        """The record with the reference heating and the surface pressure of the flight that differs.

        f : (direction,) by how many standard deviations [-]
        """
        flown, by = self.flown, {n: row @ f for n, (row, _) in self.rows.items()}
        t, z = flown.conditions.time_s, flown.conditions["altitude_m"]
        other = flown
        if DENSITY in by:
            other = with_density(other, np.exp(np.interp(z, self.altitudes_m, by[DENSITY])))
        if "velocity_relative" in by:
            other = with_velocity(other, 1.0 + float(by["velocity_relative"][0]))
        if "alpha_bias_deg" in by:
            other = with_alpha(other, float(by["alpha_bias_deg"][0]))
        stretched_s = float(by["time_stretch"][0]) * (t - t[0]) if "time_stretch" in by else 0.0
        other = shift_conditions(other, stretched_s + (float(by["time_shift_s"][0]) if "time_shift_s" in by else 0.0))
        heated = conditions_of_record(other)
        columns = {n: heated[n] for n in FROM_FLIGHT if n in heated}
        if START in by:
            columns["h_ref_kg_m2_s"] = columns["h_ref_kg_m2_s"] * _longer_at_start(t, float(by[START][0]))
        if self.has_one_clock:  # its shift is no direction; angles stay without their bias
            turned = shift_conditions(flown, stretched_s).conditions
            columns |= {n: turned[n] for n in ANGLES}
        stated = flown.declared.heating
        # the recovery of the point may follow from its reference heating
        recovery = stated.recovery if stated.reference == "columns" else stated.recovery_of_point.kind
        heating = stated.model_copy(update={"reference": "columns", "recovery": recovery})
        declared = flown.declared.model_copy(update={"heating": heating})
        return replace(flown, declared=declared, conditions=flown.conditions.with_columns(**columns))


def _longer_at_start(time_s: FloatArray, longer_s: float) -> FloatArray:
    """(row,) factor on the heating of a flight [-] whose wall was heated for some seconds more before the first row.

    They are added within the first SKEW_SPAN_S, whose readings no fit of a clock has.
    """
    within = np.maximum(1.0 - (time_s - time_s[0]) / SKEW_SPAN_S, 0.0)
    return np.asarray(np.maximum(1.0 + longer_s * within / np.trapezoid(within, time_s), 0.0))


ALPHA = "alpha_bias_deg"


@dataclass(frozen=True, eq=False)
class OtherFlight:
    """Flights that a recorded one may have been, as a prediction has them.

    error : of the recorded flight

    Beside what acts through the heating (`SmoothFlightError`), an angle of attack that is off changes the place in the
    ratio table, and a clock that both are recorded by shifts all conditions.
    """

    error: SmoothFlightError

    @cached_property
    def directions(self) -> list[tuple[str, float]]:
        """(direction,) what differs, and its standard deviation in its unit."""
        return [("time_shift_s", sigma) if name == START else (name, sigma) for name, sigma in self.error.directions]

    @property
    def scale(self) -> float:
        """Factor on the standard deviations as stated [-]: c of docs/theory/model_error.md, equation 5a."""
        return self.error.scale

    def of_scale(self, scale: float) -> OtherFlight:
        """This error with another factor on the standard deviations as stated [-]: docs/theory/model_error.md, equation
        5a."""
        return replace(self, error=self.error.of_scale(scale))

    def record(self, f: FloatArray) -> Record:
        """The record along the flight that differs; f : (direction,) by how many standard deviations [-]."""
        is_clock = np.array([name == START for name, _ in self.error.directions])
        by = {n: float((row @ f)[0]) for n, (row, _) in self.error.rows.items() if n in (ALPHA, START)}
        other = self.error.record(np.where(is_clock, 0.0, f))
        if ALPHA in by:
            turned = other.conditions.with_columns(alpha_deg=other.conditions["alpha_deg"] + by[ALPHA])
            other = replace(other, conditions=turned)
        return shift_conditions(other, by[START]) if START in by else other


def other_flight(record: Record) -> OtherFlight | None:
    """The flights that a record's may have been; None where its trajectory is exact."""
    error = flight_error(record)
    return None if error is None else OtherFlight(error)


def stated_error(record: Record) -> StatedError:
    """What the model of a record may be off: as it states, or the defaults of a measured one.

    Source: docs/theory/model_error.md, equation 1.

        >>> import sim_heating as sh
        >>> error = sh.stated_error(sh.load_record("scenarios/records/sts96_468"))
        >>> error.heating.relative
        0.05
    """
    return StatedError(heating_error_prior(record), other_flight(record))
