"""Members of a set of estimates in dispersed flights: which of them a flight has, and what it leaves open.

A flight has one member, drawn by the weights. The parameters of its estimate vary by their covariance, errors that it
leaves open for another flight among them (planning/considered.py): p = p_fit + R z, R R' = cov p, z independent
standard normal numbers. They stand in place of the study's own inputs of the same parameters, and an estimated ratio in
place of the error of the ratio table, as in the bands of a prediction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.march.point import PointModel
from sim_heating.planning import bands
from sim_heating.planning.dispersion.statistics import choices


@dataclass(frozen=True, eq=False)
class DrawnMember:
    """One member at the control points of a study.

    declared : models of the control points as the vehicle declares them
    member   : the estimate; a point that it is not of stays as declared
    """

    declared: Sequence[PointModel]
    member: bands.Member

    @cached_property
    def of_points(self) -> list[bands.Member]:
        """The member at each control point."""
        return [bands.members_of_point([self.member], m.name)[0] for m in self.declared]

    @cached_property
    def models(self) -> list[PointModel]:
        """The control points with the values of the estimate."""
        return [bands.model_of_member(model, m) for model, m in zip(self.declared, self.of_points, strict=True)]

    @cached_property
    def labels(self) -> list[dict[str, str]]:
        """For each control point, name in the model -> label in the estimate of what that leaves open."""
        return [
            {} if m.estimate is None else {n: label for n, (label, _) in bands.open_parameters(model, m).items()}
            for model, m in zip(self.declared, self.of_points, strict=True)
        ]

    @cached_property
    def _rows(self) -> dict[str, FloatArray]:
        """Label -> (axis,) its change for a unit of each independent number; points share the labels of all."""
        labels = list(dict.fromkeys(label for of_point in self.labels for label in of_point.values()))
        if not labels:
            return {}
        steps = bands.principal_steps(bands.open_covariance(self.member, labels))
        return dict(zip(labels, steps[:, np.any(steps != 0.0, axis=0)], strict=True))

    @property
    def axes(self) -> int:
        """Number of independent normal numbers that its estimate takes."""
        return max((len(row) for row in self._rows.values()), default=0)

    def replaces(self, point: int, name: str) -> bool:
        """Whether the estimate stands in place of a study's own input of a parameter at a control point."""
        return any(self.models[point].same_parameter(name, own) for own in self.labels[point])

    def replaces_table(self, point: int) -> bool:
        """Whether the estimate stands in place of the error of a control point's ratio table."""
        return any(own.startswith("ratio.") for own in self.labels[point])

    def deviations(self, point: int, z: FloatArray) -> Mapping[str, FloatArray]:
        """Name in the model -> (flight,) deviation from the estimate within the bounds, each in its unit.

        z : (flight, number) standard normal numbers, `axes` of them or more
        """
        model, drawn = self.models[point], dict[str, FloatArray]()
        for name, label in self.labels[point].items():
            value, definition = model.value(name), model.definition(name)
            changed = np.clip(value + z[:, : self.axes] @ self._rows[label], definition.lower, definition.upper)
            drawn[name] = changed - value
        return drawn


@dataclass(frozen=True, eq=False)
class DrawnMembers:
    """The members of a study, one of which each flight has.

    each : at the control points; of a study that names no estimate a single one, as the vehicle declares them
    """

    each: Sequence[DrawnMember]

    @property
    def is_drawn(self) -> bool:
        """Whether they are estimates, which flights draw."""
        return any(m.member.estimate is not None for m in self.each)

    @cached_property
    def shares(self) -> FloatArray:
        """(member,) weights over their sum [-]."""
        weights = np.array([m.member.weight for m in self.each])
        return np.asarray(weights / np.sum(weights))

    @cached_property
    def heaviest(self) -> int:
        """Number of the member with the greatest weight, by which the flight is planned."""
        return int(np.argmax(self.shares))

    @property
    def columns(self) -> int:
        """Number of normal numbers of a flight: which member it has, and what that leaves open."""
        return 1 + max(m.axes for m in self.each) if self.is_drawn else 0

    def numbers(self, z: FloatArray) -> IntArray:
        """(flight,) number of the member of each flight, by its share; 0 has the heaviest.

        z : (flight, number) standard normal numbers, `columns` of them
        """
        if not self.is_drawn:
            return np.zeros(len(z), dtype=np.int64)
        return choices(self.shares, z[:, 0])
