"""Control points of a link: their models, their sensors, and the flight conditions that a frame gives them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Protocol

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import ACCOMPANYING, FRAME, LINE_TOLERANCE, LINE_TOLERANCE_SHARE, SURFACES, Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.block import N_CONDITIONS
from sim_heating.base.limits import LIMITS, limit_message
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.inputs.points import conditions_of_record, flow_of_record, point_of_record, point_of_vehicle
from sim_heating.inputs.record import Record
from sim_heating.inputs.vehicle import Vehicle
from sim_heating.live.types import Frame
from sim_heating.march.ensemble import condition_history
from sim_heating.march.mesh_choice import choose_meshes
from sim_heating.march.point import PointModel
from sim_heating.simulation.plugin import host_array, point_constants
from sim_heating.simulation.plugin_kernel import derive_conditions, derive_history
from sim_heating.thermal.mesh import Mesh
from sim_heating.thermal.stack import Sensor

OTHER_SHARE = 0.002
"""Part of its value by which a column that LINE_TOLERANCE does not name may leave a straight line in time [-]."""
FOLLOWING = ("altitude_m", "mach", "T_inf_K", "p_inf_Pa")
"""Columns that act through others, so that their own straight lines do not matter."""
ALONG_LINE = {"log10_re": 1e-3}
"""Distance from a straight line in time that heating does not notice, of columns that no host gives."""


@dataclass(frozen=True, eq=False)
class LivePoint:
    """A control point: its model on a mesh, and its sensors in the order of the mesh's."""

    name: str
    model: PointModel
    mesh: Mesh
    sensors: tuple[Sensor, ...]


class ConditionsOfFrame(Protocol):
    """What the control points of a link are, and what a frame is for them."""

    @property
    def points(self) -> tuple[LivePoint, ...]:
        """The control points."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that a frame has to have."""

    def conditions(self, frame: Frame) -> FloatArray:
        """(point, condition) conditions of a frame, in the units of the condition columns."""

    def histories(self, flown: Mapping[str, FloatArray]) -> FloatArray:
        """(point, time, condition) conditions along a flight, given by its columns, `time_s` among them."""


def _middle(table: RatioTable) -> tuple[float, ...]:
    """Middle of each axis of a ratio table [deg], [deg], [-], [deg], [deg]."""
    return tuple(0.5 * float(axis[0] + axis[-1]) for axis in table.axes)


class VehiclePoints:
    """Control points of a vehicle in flight; a frame has the columns of `base.conditions.FRAME`.

    names      : of the control points; all of the vehicle's by default
    nodes      : nodes of each mesh; chosen for accuracy where None
    parameters : dotted model parameters, the same for all points
    raises     : InputError for an unknown control point or parameter

    Derivatives refer to the middle of the ratio table, so that an unknown slope is no unknown magnitude.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        names: Sequence[str] | None = None,
        nodes: int | None = None,
        parameters: Mapping[str, float] | None = None,
    ) -> None:
        points = [vehicle.control_point(n) for n in (vehicle.control_points if names is None else names)]
        models = [replace(point_of_vehicle(vehicle, p, parameters), reference=_middle(p.ratio)) for p in points]
        meshed = _meshed(models, nodes)
        self.points = tuple(
            LivePoint(p.name, m, mesh, tuple(p.sensors)) for p, (m, mesh) in zip(points, meshed, strict=True)
        )
        self._spared = {"time_s", "jets", *(s for s in SURFACES if s not in vehicle.surfaces)}
        self.columns = tuple(c for c in FRAME if c not in self._spared)
        self._constants, self._host = point_constants(vehicle, points), host_array(vehicle)
        self._lanes = np.arange(len(points))

    def conditions(self, frame: Frame) -> FloatArray:
        """(point, condition) conditions of a frame, as the plug-in derives them.

        raises : InputError for a column that is missing or a value out of range
        """
        columns = frame.values
        values = np.array([frame.time_s, *(_value(columns, c, self._spared) for c in FRAME[1:])])
        for name, value in zip(FRAME, values.tolist(), strict=True):
            low, high, _ = LIMITS[name]
            if not low <= value <= high:
                raise InputError(f"frame at {frame.time_s:g} s: {name} {limit_message(name, value)}")
        vectors = np.zeros((len(self.points), N_CONDITIONS))
        derive_conditions(values, self._host, self._constants, self._lanes, vectors)
        return vectors

    def histories(self, flown: Mapping[str, FloatArray]) -> FloatArray:
        """(point, time, condition) conditions along a flight, as the plug-in derives them at each frame.

        flown  : (time,) columns of frames, `time_s` among them
        raises : InputError for a column that is missing or a value out of range
        """
        time_s = flown["time_s"]
        frames = np.empty((len(time_s), len(FRAME)))
        for i, name in enumerate(FRAME):
            frames[:, i] = _column(flown, name, self._spared)
            low, high, _ = LIMITS[name]
            if not np.all((frames[:, i] >= low) & (frames[:, i] <= high)):
                k = int(np.flatnonzero(~((frames[:, i] >= low) & (frames[:, i] <= high)))[0])
                raise InputError(f"conditions at {time_s[k]:g} s: {name} {limit_message(name, frames[k, i])}")
        histories = np.zeros((len(self.points), len(time_s), N_CONDITIONS))
        derive_history(frames, self._host, self._constants, self._lanes, histories)
        return histories


class RecordPoints:
    """Control points of flight records, or of walls under lamps; a frame has the columns of their conditions.

    records    : one for each control point, all on one flight
    nodes      : nodes of each mesh; chosen for accuracy where None
    parameters : dotted model parameters, the same for all points
    """

    def __init__(
        self, records: Sequence[Record], nodes: int | None = None, parameters: Mapping[str, float] | None = None
    ) -> None:
        self.records = tuple(records)
        models = [point_of_record(r, parameters) for r in records]
        self._flows = [flow_of_record(r, m.effects) for r, m in zip(records, models, strict=True)]
        self.points = tuple(
            LivePoint(m.name, m, mesh, tuple(r.sensors))
            for r, (m, mesh) in zip(records, _meshed(models, nodes), strict=True)
        )
        spared = ("time_s", *ACCOMPANYING)
        self.columns = tuple(dict.fromkeys(c for r in records for c in r.conditions.names if c not in spared))

    def conditions(self, frame: Frame) -> FloatArray:
        """(point, condition) conditions of a frame, with the reference heating of each record.

        raises : InputError for a column that is missing
        """
        flown = {c: np.array([_value(frame.values, c, ())]) for c in self.columns}
        return self.histories({"time_s": np.array([frame.time_s]), **flown})[:, 0]

    def histories(self, flown: Mapping[str, FloatArray]) -> FloatArray:
        """(point, time, condition) conditions along a flight, with the reference heating of each record.

        flown  : (time,) columns of frames, `time_s` among them
        raises : InputError for a column that is missing
        """
        now = Conditions({"time_s": flown["time_s"], **{c: _column(flown, c, ()) for c in self.columns}})
        return np.array(
            [
                condition_history(conditions_of_record(replace(record, conditions=now), flow))
                for record, flow in zip(self.records, self._flows, strict=True)
            ]
        )


@cache
def line_tolerance(columns: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
    """(column,) distance of each column from a straight line in time that heating does not notice, and share of its
    value that is added to it [-].
    """
    tolerance = {**LINE_TOLERANCE, **ALONG_LINE}
    apart = [np.inf if c in FOLLOWING else tolerance.get(c, 0.0) for c in columns]
    relative = [LINE_TOLERANCE_SHARE.get(c, 0.0 if c in tolerance else OTHER_SHARE) for c in columns]
    return np.array(apart), np.array(relative)


def _value(columns: Mapping[str, float], column: str, spared: set[str] | tuple[str, ...]) -> float:
    if column in columns:
        return columns[column]
    if column in spared:
        return 0.0
    raise InputError(f"frame: no `{column}`; it has {', '.join(columns)}")


def _column(flown: Mapping[str, FloatArray], column: str, spared: set[str] | tuple[str, ...]) -> FloatArray:
    if column in flown:
        return flown[column]
    if column in spared:
        return np.zeros(len(flown["time_s"]))
    raise InputError(f"conditions: no `{column}`; they have {', '.join(flown)}")


def _meshed(models: Sequence[PointModel], nodes: int | None) -> list[tuple[PointModel, Mesh]]:
    refined = [m if nodes is None else replace(m, nodes=nodes) for m in models]
    return [(m, mesh) for m, (mesh, _) in zip(refined, choose_meshes(refined), strict=True)]
