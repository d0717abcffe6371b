"""What the model of a record may be off, as a fit and a prediction have it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from sim_heating.base.arrays import FloatArray
from sim_heating.closure.prior.changed_flight import shift_conditions
from sim_heating.closure.prior.model_error import SmoothFlightError, flight_error, heating_error_prior
from sim_heating.estimation.inference.model_error import StatedError
from sim_heating.inputs.record import Record

ALPHA = "alpha_bias_deg"
SHORTEST_S = 15.0
"""Shortest correlation time of a heating's error in a fit and in a prediction, where none is stated [s].

A search for causes has none below a minute, since a shorter one would buy a jump (docs/theory/model_error.md, section
"Size"). Nothing is told from another here, and an error that changes faster would count as a larger one.
"""


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
        clock = [("time_shift_s", self._shift_s)] if self.error.has_one_clock else []
        return [*self.error.directions, *clock]

    @property
    def _shift_s(self) -> float:
        """One standard deviation of the clock [s]."""
        return self.scale * self.error.uncertainty.time_shift_s

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
        of_flight = f[: len(self.error.directions)]
        other = self.error.record(of_flight)
        if ALPHA in self.error.rows:
            bias_deg = float((self.error.rows[ALPHA][0] @ of_flight)[0])
            turned = other.conditions.with_columns(alpha_deg=other.conditions["alpha_deg"] + bias_deg)
            other = replace(other, conditions=turned)
        if self.error.has_one_clock:
            other = shift_conditions(other, float(f[-1]) * self._shift_s)
        return other


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
    heating = heating_error_prior(record)
    if heating is not None and heating.shortest_s < heating.longest_s:
        heating = replace(heating, shortest_s=SHORTEST_S)
    return StatedError(heating, other_flight(record))
