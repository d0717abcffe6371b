"""Dispersed flights that have one member of a set of estimates: its control points marched in lanes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.kernels.block import LANES
from sim_heating.planning.dispersion.drawn_errors import DrawnError
from sim_heating.planning.dispersion.drawn_members import DrawnMember
from sim_heating.planning.dispersion.flight import SampledFlights
from sim_heating.planning.dispersion.march import FlightPeaks, LaneMarch, ParameterPlace
from sim_heating.planning.dispersion.spec import FLIGHT_INPUTS, DispersedInput
from sim_heating.planning.ratio_table_modes import table_factors


@dataclass(frozen=True, eq=False)
class MemberMarch:
    """The control points of a study as one member has them.

    member : at the control points;  lanes : these in lanes;  inputs : of the study
    errors : of the heating of each control point; none where it is exact
    """

    member: DrawnMember
    lanes: LaneMarch
    inputs: Sequence[DispersedInput]
    errors: Sequence[DrawnError] = ()

    @cached_property
    def places(self) -> list[list[ParameterPlace]]:
        """Parameters of the points that each input changes; none for an input that changes the flight, or in place of
        which the estimate stands."""
        names = [model.name for model in self.member.declared]
        return [
            []
            if i.name in FLIGHT_INPUTS
            else [self.lanes.place_of(p, i.name) for p in i.points_of(names) if not self.member.replaces(p, i.name)]
            for i in self.inputs
        ]

    def _estimated_changes(self, z: FloatArray) -> Iterator[tuple[ParameterPlace, FloatArray]]:
        """Deviations of what the estimate leaves open, each with its place."""
        for p in range(len(self.member.declared)):
            for name, change in self.member.deviations(p, z).items():
                yield from ((place, change) for place in self.lanes.places_of_estimated(p, name))

    def march(
        self,
        flown: SampledFlights,
        deviation: FloatArray,
        z: FloatArray,
        modes: Sequence[tuple[FloatArray, FloatArray]],
        of_errors: Sequence[FloatArray],
        keep: list[tuple[FloatArray, FloatArray]] | None = None,
    ) -> FlightPeaks:
        """Peaks along flights, LANES at a time.

        deviation : (flight, input), each in the unit of its input
        z         : (flight, number) normal numbers of what the estimate leaves open
        modes     : of each point's ratio table, (node, mode) errors and the (flight, mode) normal numbers of these
        of_errors : (flight, number) normal numbers of the error of each point's heating
        keep      : receives for each point surface and bondline (time, 2 LANES) [K] and the conditions (LANES, time,
                    condition); None for none
        """
        changes = [(place, deviation[:, k]) for k, places in enumerate(self.places) for place in places]
        changes += self._estimated_changes(z)
        tables = [
            table_factors(errors, numbers) if errors.shape[1] and not self.member.replaces_table(p) else None
            for p, (errors, numbers) in enumerate(modes)
        ]
        errors = [(e.knots_s, e.at_knots(own)) for e, own in zip(self.errors, of_errors, strict=True)]
        # One flight a lane and one point a group: flights of a batch share their times, and tables and stacks differ by
        # lane.
        return joined(
            [self.lanes.march(flown, first, changes, tables, errors, keep) for first in range(0, len(z), LANES)]
        )


def joined(parts: Sequence[FlightPeaks]) -> FlightPeaks:
    """Peaks of flights, those of one part after those of another."""
    return FlightPeaks(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(FlightPeaks)))
