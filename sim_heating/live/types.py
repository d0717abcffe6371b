"""What flows through a live link: messages as a source sends them, frames of flight conditions, readings of sensors.

A source yields messages. The mapping of the link turns each into frames and readings, which the estimator takes. From
there on times are flight times [s] and values are in SI units.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

TIME = "time_s"
"""Field of a message that holds its flight time [s], unless the link file names another."""

LONGEST_BODY = (1 << 24) - 16
"""Bytes of a message: with what an entry of the journal adds, 16 MiB. A longer one is refused when it comes."""


def too_long(body: bytes) -> str | None:
    """Why a body is refused when it comes; None where it is kept."""
    if len(body) <= LONGEST_BODY:
        return None
    return f"a message of {len(body) / 2**20:.1f} MiB; one of more than {LONGEST_BODY / 2**20:.0f} MiB is refused"


@dataclass(frozen=True, slots=True)
class Message:
    """A message as it came from a source.

    arrived_s : when it arrived, on the monotonic clock of this machine [s]
    body      : the bytes that came, which the journal keeps
    values    : field -> value as sent, a number or a text; nothing is converted yet. A list of numbers is spread over
                `NAME[0]`, `NAME[1]` and so on, an object within an object over `NAME.KEY`
    damaged   : why the bytes could not be read; "" where they could
    """

    arrived_s: float
    body: bytes
    values: Mapping[str, float | str]
    damaged: str = ""


@dataclass(frozen=True, slots=True)
class Frame:
    """Conditions of the flight at one time, linear in time between frames.

    time_s : flight time [s]
    values : column of flight conditions -> value in the unit that its name ends in, finite; those of
             `base.conditions.FRAME` for a vehicle in flight, those of the record's conditions for a test on the ground
    has_model_density : whether the density is of the standard atmosphere, and not of the day
    """

    time_s: float
    values: Mapping[str, float]
    has_model_density: bool = False


@dataclass(frozen=True, slots=True)
class Reading:
    """A thermocouple word.

    time_s  : flight time [s]
    point   : name of the control point
    sensor  : name of the sensor there
    value_K : indicated temperature [K]; NaN where the sample is lost
    """

    time_s: float
    point: str
    sensor: str
    value_K: float


Sample = Frame | Reading
"""What the estimator takes."""
