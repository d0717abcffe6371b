"""Envelope and next flight of a study: its [envelope] and [next_flight] tables.

[envelope]
sigmas = 1.0                        # the band about each boundary, in sigma of the temperatures
bands = true                        # sigma by all that is uncertain, in place of the ratio tables alone
before = "orbiter"                  # for comparison, this vehicle too: a name, or a directory relative to the study
[[envelope.member]]                 # estimates in place of what is declared, several where no evidence tells them apart
estimate = "out/sts2/estimate.json"
weight = 0.7
[[envelope.map]]                    # all combinations of values along one axis or two
name = "alpha"
[envelope.map.axes]
alpha_offset_deg = [-8.0, -4.0, 0.0, 4.0]
[[envelope.boundary]]               # the allowed interval of one axis, along another
name = "alpha"
along = "alpha_station"
at = [24.0, 20.0, 16.0]
across = "station_alpha_deg"
values = [28.0, 34.0, 40.0, 46.0]
[next_flight]
[[next_flight.manoeuvre]]           # a candidate: its manoeuvres, and the points whose thermocouples are read
name = "POPU at 20,000 ft/s"
control_points = ["V07T9975"]
[[next_flight.manoeuvre.flown]]     # as a scenario's [[trajectory.manoeuvre]]
kind = "popu"

Axes are the numeric fields of `Case` in planning/envelope/case.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from sim_heating.base.files import Declared, LocatedError, repeated_name, suggestion
from sim_heating.planning.envelope.case import AXES, BASE_ENTRY, OPEN_RANGES, Case
from sim_heating.planning.members import StudyMember
from sim_heating.trajectory.spec import Manoeuvre

Values = list[float]


def _check_axes(stated: Sequence[tuple[str, str, Values]]) -> None:
    """Check (key, axis, values) of a table: each axis exists and is stated once, and its values are in their range."""
    by_axis: dict[str, str] = {}
    for key, name, values in stated:
        if name not in AXES:
            raise ValueError(f"there is no axis `{name}`{suggestion(name, AXES)}")
        if name in by_axis:
            raise ValueError(f"`{name}` is given by `{by_axis[name]}` and by `{key}`; use another axis for one of them")
        by_axis[name] = key
        low, high = OPEN_RANGES.get(name, (-np.inf, np.inf))
        for value in values:
            if not low < value < high:
                rule = f"above {low:g}" if np.isinf(high) else f"between {low:g} and {high:g}"
                raise ValueError(f"`{key}`: {name} {value:g} must be {rule}")
    if ("station_alpha_deg" in by_axis) != ("alpha_station" in by_axis):
        raise ValueError("`station_alpha_deg` is held about `alpha_station`; give both")


def _require_rising(name: str, values: Values, fewest: int) -> None:
    if len(values) < fewest or any(b <= a for a, b in pairwise(values)):
        raise ValueError(f"{name}: {values} must rise from value to value, with {fewest} or more of them")


class _Result(Declared):
    """A map or a boundary with its name."""

    name: str = Field(pattern=r"^[\w-]+$", description="a name of letters, digits, - and _")
    title: str = ""

    @property
    def heading(self) -> str:
        """The title, or the name where there is none."""
        return self.title or self.name


class EnvelopeMap(_Result):
    """Peaks and margins of every control point over one axis or two, with other variables `fixed`.

    axes : one or two axes with their values
    fixed : values of other axes
    one_sided : true: the bank never reverses, for as much cross-range as the rest allows
    """

    quantities: ClassVar = {"axes": None, "fixed": None}

    axes: dict[str, Values] = Field(min_length=1, max_length=2)
    fixed: dict[str, float] = Field(default={})
    one_sided: bool = False

    @model_validator(mode="after")
    def _check_axes(self) -> EnvelopeMap:
        for name, values in self.axes.items():
            _require_rising(name, values, 1)
        _check_axes(
            [*(("axes", n, v) for n, v in self.axes.items()), *(("fixed", n, [v]) for n, v in self.fixed.items())]
        )
        return self

    def case(self, position: dict[str, float]) -> Case:
        """The case at a place, given by the axes' values."""
        return Case(**{**self.fixed, **position}, one_sided=self.one_sided)

    def entry(self, position: dict[str, float]) -> str:
        """Name of the entry at a place: all values of its axes and of `fixed`, and whether it is the base entry."""
        values = ", ".join(f"{k} {v:g}" for k, v in {**position, **self.fixed}.items())
        return values if self.case(position).changes() else f"{BASE_ENTRY} ({values})"


class EnvelopeBoundary(_Result):
    """The allowed interval of the axis `across` at each value `at` of the axis `along`, for each value `of` a `family`.

    inside   : place on `across` about which the interval is sought; by default the value of the base entry
    greatest : "cross_range_km": the greatest cross-range within the interval, in place of the interval itself
    along, at : an axis, and its values
    across, values : the axis on which the interval is sought, and values that are flown on it
    family, of : a third axis, and its values; a boundary for each
    fixed : values of other axes
    one_sided : true: the bank never reverses, for as much cross-range as the rest allows
    """

    quantities: ClassVar = {"fixed": None}

    along: str
    at: Values = Field(min_length=1)
    across: str
    values: Values
    inside: float | None = None
    family: str | None = None
    of: Values = Field(default=[])
    greatest: Literal["cross_range_km"] | None = None
    one_sided: bool = False
    fixed: dict[str, float] = Field(default={})

    @model_validator(mode="after")
    def _check_axes(self) -> EnvelopeBoundary:
        stated = [("along", self.along, self.at), ("across", self.across, self.values)]
        stated += [] if self.family is None else [("family", self.family, self.of)]
        _check_axes([*stated, *(("fixed", n, [v]) for n, v in self.fixed.items())])
        if (self.family is None) != (not self.of):
            raise ValueError("`family` names an axis and `of` its values: give both or neither")
        _require_rising("values", self.values, 2)
        _require_rising("at", sorted(self.at), 1)
        return self

    @property
    def sought(self) -> str:
        """Name of the quantity whose ends the boundary has: `greatest`, or the axis `across`."""
        return self.greatest or self.across

    def members(self) -> list[float | None]:
        """Values of the family; [None] without one."""
        return list(self.of) or [None]

    def case(self, member: float | None, position: float, value: float) -> Case:
        """The case of one member at a place on both axes."""
        of_family = {} if self.family is None or member is None else {self.family: member}
        return Case(**{**self.fixed, **of_family, self.along: position, self.across: value}, one_sided=self.one_sided)


class Envelope(Declared):
    """The [envelope] table.

    sigmas              : half the width of the band about a boundary, in sigma of the temperatures
    bands               : whether that sigma is by all that is uncertain, as `run --bands` has it; else by the ratio
                          tables alone
    member              : estimates from flights, in place of what the vehicle declares of their control points
    station_width       : half the width of a station of the angle-of-attack schedule, on its own axis
    bodyflap_above_mach : Mach number down to which a changed body flap is held
    elevon_arm_m        : distance of the elevons from the plane of symmetry [m]
    refinements         : rounds in which flights are added at the edges that were found
    before : an earlier revision of the tables to compare with
    """

    sigmas: float = Field(default=1.0, gt=0.0, le=5.0)
    bands: bool = False
    before: str | None = None
    station_width: float = Field(default=1.0, gt=0.0)
    bodyflap_above_mach: float = Field(default=8.0, gt=0.0)
    elevon_arm_m: float = Field(default=6.0, gt=0.0)
    refinements: int = Field(default=1, ge=0, le=5)
    member: list[StudyMember] = Field(default=[])
    map: list[EnvelopeMap] = Field(default=[])
    boundary: list[EnvelopeBoundary] = Field(default=[])

    @model_validator(mode="after")
    def _asks_for_something(self) -> Envelope:
        if self.member and not self.bands:
            raise ValueError("[[envelope.member]] is for bands; add `bands = true`")
        if not self.map and not self.boundary:
            raise ValueError("has neither map nor boundary; add an [[envelope.map]] or an [[envelope.boundary]]")
        for kind, names in (("maps", [m.name for m in self.map]), ("boundaries", [b.name for b in self.boundary])):
            if (name := repeated_name(names)) is not None:
                raise ValueError(f"two {kind} are named `{name}`; rename one")
        return self


class ManoeuvreCandidate(Declared):
    """Manoeuvres that may be flown together on the next flight, and the control points whose thermocouples are read.

    name : name of the candidate
    """

    name: str
    control_points: list[str] = Field(min_length=1)
    flown: list[Manoeuvre] = Field(min_length=1)

    @field_validator("control_points")
    @classmethod
    def _names_each_once(cls, names: list[str]) -> list[str]:
        if (name := repeated_name(names)) is not None:
            raise ValueError(f"`{name}` is repeated; name each control point once")
        return names

    @field_validator("flown")
    @classmethod
    def _flies_each_once(cls, flown: list[Manoeuvre]) -> list[Manoeuvre]:
        for i, manoeuvre in enumerate(flown):
            if manoeuvre in flown[:i]:
                rule = f"is that of number {flown.index(manoeuvre) + 1}; list each manoeuvre once"
                raise LocatedError(((i,), rule))
        return flown


class NextFlight(Declared):
    """The [next_flight] table."""

    manoeuvre: list[ManoeuvreCandidate] = Field(min_length=1)

    @field_validator("manoeuvre")
    @classmethod
    def _names_differ(cls, candidates: list[ManoeuvreCandidate]) -> list[ManoeuvreCandidate]:
        if (name := repeated_name([c.name for c in candidates])) is not None:
            raise ValueError(f"two candidates are named `{name}`; rename one")
        return candidates
