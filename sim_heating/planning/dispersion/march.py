"""Control points of one vehicle along eight dispersed flights at a time: a lane a flight, a lane group a control point.

The ensemble is packed once. For each eight flights the dispersed numbers are written into its lanes, its state is put
back, and every group is marched. Only peaks are kept, so that memory does not grow with the number of flights.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from graphlib import TopologicalSorter

import numpy as np

from sim_heating.base.arrays import BoolArray, FloatArray, IntArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.block import (
    EFFECT_PARAMETERS,
    EFFECT_WIDTH,
    H_REF,
    LANES,
    N_CONDITIONS,
    RATIO_TABLE,
    TIME,
)
from sim_heating.base.parameters import EFFECT_PREFIX, RATIO
from sim_heating.heating.effects import EffectUse
from sim_heating.heating.ratio.lookup import VARIABLES
from sim_heating.inputs.points import point_of_vehicle
from sim_heating.inputs.vehicle import Vehicle, numbers_upstream, walls_upstream
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.mesh_choice import TOLERANCE_K, choose_meshes
from sim_heating.march.point import PointModel, heating_vector, kernel_effects, stack_values
from sim_heating.planning.dispersion import flight
from sim_heating.planning.limited_point import LimitedPoint
from sim_heating.planning.soak import SOAK
from sim_heating.simulation.plugin import host_array, point_constants
from sim_heating.simulation.plugin_kernel import UPSTREAM_CP
from sim_heating.thermal.mesh import Mesh

QUANTITIES = ("surface_K", "bondline_K")
"""The peaks that are recorded, in their order."""
SOAK_STEP_S = 20.0
"""Longest step of the soak [s]; it begins in steps of the flight."""
SOAK_BEGINS_S = 60.0
"""Part of the soak that is marched in steps of the flight [s]."""
STEP_TOLERANCE_K = TOLERANCE_K
"""Largest error of a step [K]: no finer than the meshes, which are the coarsest of the same error."""
_RATIO = {p.name: k for k, p in enumerate(RATIO)}


@dataclass(frozen=True)
class FlightPeaks:
    """Peaks of control points along some flights.

    surface_K, bondline_K : (flight, point) peak temperatures [K]; NaN where a flight was not completed
    negative              : (flight, point) whether the heating ratio was ever negative
    extent                : (flight, 2, 5) least and largest ratio variables
    """

    surface_K: FloatArray
    bondline_K: FloatArray
    negative: BoolArray
    extent: FloatArray


@dataclass(frozen=True)
class ParameterPlace:
    """Location of a dotted parameter: the number of its point, `stack` or `heating` vector, and index in that."""

    point: int
    vector: str
    index: int


@dataclass(frozen=True)
class _RatioNodes:
    """The ratio table of one point: its nodes as declared [-], and the first place of them in each lane's table."""

    declared: FloatArray
    first: IntArray


def _with_own_table(model: PointModel) -> PointModel:
    """A model with a copy of its ratio table."""
    return model if model.ratio is None else replace(model, ratio=replace(model.ratio))


class LaneMarch:
    """Control points of a vehicle, each in LANES lanes.

    points  : with their limits
    models  : of the points, without sensors
    meshes  : one a point
    step_s  : of the march, and between the kept frames of flights [s]
    soak_s  : after the end of each flight [s]

    Attributes: `models` of the points; `stepped`, these and behind them the walls upstream of interfaces that are no
    points of the study, as the vehicle declares them; `host` and `constants`, by which conditions follow from frames;
    `soak`, (3,) h_ref [kg/(m2 s)], p_surface [Pa] and surroundings [K] after the flight.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        points: Sequence[LimitedPoint],
        models: Sequence[PointModel],
        meshes: Sequence[Mesh],
        step_s: float,
        soak_s: float,
    ) -> None:
        self.points, self.step_s, self.soak_s = tuple(points), step_s, soak_s
        limited = [p.point for p in points]
        walls = walls_upstream(vehicle, limited)
        of_walls = [_without_sensors(point_of_vehicle(vehicle, wall)) for wall in walls]
        self.models, self.stepped = list(models), [*models, *of_walls]
        meshes = [*meshes, *(mesh for mesh, _ in choose_meshes(of_walls, step_s))]
        self._behind = numbers_upstream(vehicle, [*limited, *walls])
        # Each lane has a copy of the ratio table, whose nodes are written before every march.
        lanes = [_with_own_table(m) for m in self.stepped for _ in range(LANES)]
        # Packed once for the whole study; every march restores the initial state and writes what is dispersed.
        self.ensemble = Ensemble(
            lanes,
            [mesh for mesh in meshes for _ in range(LANES)],
            max(step_s, SOAK_STEP_S),
            tolerance_K=STEP_TOLERANCE_K,
        )
        self._initial_state = self.ensemble.snapshot()
        numbers = range(len(self.stepped))
        self._groups = [self.ensemble.lane_offsets[p * LANES].group for p in numbers]
        self._lanes = [self.ensemble.writer.lanes_of(range(p * LANES, (p + 1) * LANES)) for p in numbers]
        self._declared = tuple(
            [np.repeat(values(m)[np.newaxis], LANES, axis=0) for m in self.stepped]
            for values in (stack_values, heating_vector)
        )
        self._tables = [self._ratio_nodes(p) for p in numbers]
        self.host = host_array(vehicle)
        self.constants = point_constants(vehicle, [*limited, *walls])
        self.soak = np.array(list(SOAK.values()))
        self._outputs = self.ensemble.outputs().reshape(len(self.stepped), 2 * LANES)
        self._memory = np.empty(0)

    def _ratio_nodes(self, p: int) -> _RatioNodes:
        ratio, J = self.stepped[p].ratio, self.ensemble.memory.integers(self._groups[p])
        if ratio is None:
            return _RatioNodes(np.zeros(0), J[RATIO_TABLE : RATIO_TABLE + LANES].copy())
        behind_axes = VARIABLES + sum(len(a) for a in ratio.axes)
        return _RatioNodes(ratio.ratio.ravel(), J[RATIO_TABLE : RATIO_TABLE + LANES] + behind_axes)

    def place_of(self, point: int, name: str) -> ParameterPlace:
        """Location of a dotted parameter of a point.

        raises : InputError where the point has no such parameter
        """
        model = self.models[point]
        model.definition(name)
        if model.places.get(name, -1) >= len(RATIO):
            return ParameterPlace(point, "stack", model.places[name] - len(RATIO))
        if name in _RATIO:
            return ParameterPlace(point, "heating", _RATIO[name])
        effect, parameter = name.removeprefix(EFFECT_PREFIX).rsplit(".", 1)
        for k, used in enumerate(kernel_effects(model)):
            if used.effect.name == effect:
                names = [p.name for p in used.effect.parameters]
                return ParameterPlace(point, "heating", EFFECT_PARAMETERS + k * EFFECT_WIDTH + names.index(parameter))
        raise InputError(f"{model.name}: `{name}` sets another parameter of the model; name that one")

    def places_of_estimated(self, point: int, name: str) -> list[ParameterPlace]:
        """Location of a dotted parameter of a point that an estimate has: that of the parameter of the model which its
        effect sets; none for an effect on readings alone."""
        for used in self.models[point].effects:
            head = f"{EFFECT_PREFIX}{used.effect.name}."
            own = [p.name for p in used.effect.parameters]
            if used.effect.model_parameters and name.startswith(head):
                stands_for = used.effect.model_parameters[own.index(name.removeprefix(head))]
                return [] if used.effect.acts_on_readings else [self.place_of(point, stands_for)]
        return [self.place_of(point, name)]

    def march(
        self,
        flown: flight.SampledFlights,
        first: int,
        changes: Sequence[tuple[ParameterPlace, FloatArray]],
        table_factors: Sequence[FloatArray | None],
        errors: Sequence[tuple[FloatArray, FloatArray]] = (),
        keep: list[tuple[FloatArray, FloatArray]] | None = None,
    ) -> FlightPeaks:
        """Peaks along LANES flights, or fewer, from `first` on.

        changes       : places of parameters and their (flight,) deviations, each in the unit of the parameter
        table_factors : for each point (node, flight) factors on its ratio table [-]; None leaves the table as declared
        errors        : for each point (knot,) times [s] and (flight, knot) relative errors of its heating [-], linear
                        between; none where the heating is exact
        keep          : if given, receives for each point surface and bondline (time, 2 LANES) [K] and the conditions
                        (LANES, time, condition)
        """
        last = min(first + LANES, len(flown.frame_counts))
        # Lanes without a flight repeat the last one, so that they never fail by themselves.
        lane = np.minimum(np.arange(first, first + LANES), last - 1)
        frame_counts = flown.frame_counts[lane]
        time_s = self.times(int(frame_counts.max()))
        histories = self._history_memory(len(time_s))
        flight.condition_kernel(flown.rows[lane], frame_counts, self.host, self.constants, self.soak, time_s, histories)
        for history, (knots_s, relative) in zip(histories, errors, strict=False):
            _scale_heating(history, frame_counts, knots_s, relative[lane])
        self.ensemble.restore(self._initial_state)
        self._write_parameters(changes, lane)
        self._write_ratio_tables(table_factors, lane)
        marched = self.march_all(time_s, histories)
        if np.all(np.any(self.ensemble.failed().reshape(-1, LANES), axis=0)):  # one flight may fail where others do not
            lanes = histories.reshape(-1, *histories.shape[2:])  # point by point, as the ensemble has them
            self.ensemble.check_effects(time_s, lanes, range(len(lanes)))
        if keep is not None:
            keep += [(out, h.copy()) for _, out, h in zip(self.points, marched, histories, strict=False)]

        in_use = slice(0, last - first)
        counts = self._sample_counts(time_s, frame_counts)
        # Lanes march as long as the longest flight of the eight: each counts to the end of its own soak.
        hottest = np.empty((len(self.points), last - first, len(QUANTITIES)))
        for out, peaks in zip(marched, hottest, strict=False):
            flight.peak_kernel(out, counts, peaks)
        surface, bondline = (hottest[:, :, k].T.copy() for k in range(len(QUANTITIES)))
        by_point = self.ensemble.counters.failures, self.ensemble.counters.steps_of_negative_ratio
        failed, negative = (steps.reshape(-1, LANES).T[in_use, : len(self.points)] > 0.0 for steps in by_point)
        # A peak of a flight that did not reach its stop would be too low; NaN counts as above every limit.
        unknown = failed | (flown.outcome[lane[in_use]] != flight.COMPLETED)[:, np.newaxis]
        surface[unknown], bondline[unknown] = np.nan, np.nan
        extent = np.empty((last - first, 2, len(RATIO_VARIABLES)))
        flight.extent_kernel(histories[0], frame_counts, extent)
        return FlightPeaks(surface, bondline, negative, extent)

    def march_all(self, time_s: FloatArray, histories: FloatArray) -> list[FloatArray]:
        """March every point from its present state along histories (point, LANES, time, condition).

        A wall upstream of an interface comes first; the conditions of a point behind it receive its enthalpy.

        returns : for each point (time, 2 LANES) temperatures [K]: surface and bondline of the first lane, of the second
        """
        flights, marched = np.arange(LANES), dict[int, FloatArray]()
        before = {p: {self._behind[p]} if p in self._behind else set[int]() for p in range(len(self.stepped))}
        for p in TopologicalSorter(before).static_order():
            for wall in before[p]:
                flight.upstream_wall_kernel(marched[wall], self.constants.numbers[p, UPSTREAM_CP], histories[p])
            group, outputs = self._groups[p], self._outputs[p]
            marched[p] = self.ensemble.march_lanes(group, time_s, histories[p], flights, SOAK_STEP_S, outputs)
        return [marched[p] for p in range(len(self.stepped))]

    def times(self, frames: int) -> FloatArray:
        """(time,) frames of the longest flight, then its soak, at first in steps of the flight [s]."""
        end = self.step_s * (frames - 1)
        close = np.arange(1, int(np.ceil(min(SOAK_BEGINS_S, self.soak_s) / self.step_s)) + 1) * self.step_s
        far = np.arange(1, int(np.ceil(max(self.soak_s - SOAK_BEGINS_S, 0.0) / SOAK_STEP_S)) + 1) * SOAK_STEP_S
        soak = np.concatenate((close, (close[-1] if len(close) else 0.0) + far))
        return np.concatenate((self.step_s * np.arange(frames), end + soak))

    def _sample_counts(self, time_s: FloatArray, frame_counts: IntArray) -> IntArray:
        """(lane,) number of times that belong to each lane: its flight and its own soak."""
        ends = self.step_s * (frame_counts - 1) + self.soak_s
        return np.searchsorted(time_s, ends + 1e-6, side="right")

    def _history_memory(self, samples: int) -> FloatArray:
        """(point, LANES, time, condition) memory for conditions, the same at every call.

        Allocating some MB for every eight flights would cost more than filling them.
        """
        shape = (len(self.stepped), LANES, samples, N_CONDITIONS)
        size = math.prod(shape)
        # Allocated once: returned after each batch, the memory would be cleared by the system again, at a cost in
        # processor time.
        if size > len(self._memory):
            self._memory = np.empty(size)
        return self._memory[:size].reshape(shape)

    def _write_parameters(self, changes: Sequence[tuple[ParameterPlace, FloatArray]], lane: IntArray) -> None:
        stacks, heating = ([declared.copy() for declared in of_all] for of_all in self._declared)
        for entry, deviation in changes:
            vectors = stacks if entry.vector == "stack" else heating
            vectors[entry.point][:, entry.index] += deviation[lane]
        for p, lanes in enumerate(self._lanes):
            self.ensemble.writer.write_lanes(self.ensemble.state, lanes, stacks[p], heating[p])

    def _write_ratio_tables(self, factors: Sequence[FloatArray | None], lane: IntArray) -> None:
        table = self.ensemble.table
        for nodes, factor in zip(self._tables, factors, strict=False):  # tables of walls upstream stay as they are
            for k, first in enumerate(nodes.first.tolist()):
                scaled = nodes.declared * (1.0 if factor is None else factor[:, lane[k]])
                table[first : first + len(scaled)] = scaled


def _scale_heating(history: FloatArray, frame_counts: IntArray, knots_s: FloatArray, relative: FloatArray) -> None:
    """Multiply the heating of (lane, time, condition) flights, without their soak, by 1 + its error; never below 0.

    frame_counts : (lane,) of the flights;  knots_s : (knot,) [s];  relative : (lane, knot) error [-]
    """
    for of_lane, frames, error in zip(history, frame_counts.tolist(), relative, strict=True):
        flown = of_lane[:frames]
        flown[:, H_REF] *= np.maximum(1.0 + np.interp(flown[:, TIME], knots_s, error), 0.0)


def model_without_sensors(vehicle: Vehicle, limited: LimitedPoint, effects: Sequence[EffectUse]) -> PointModel:
    """Model of a control point without its sensors, whose nodes a peak does not need."""
    return _without_sensors(point_of_vehicle(vehicle, limited.point, effects=tuple(effects)))


def _without_sensors(model: PointModel) -> PointModel:
    return replace(model, depths_m=(), lags_s=(), nodes=None)
