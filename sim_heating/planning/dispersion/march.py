"""Control points of one vehicle along eight dispersed flights at a time: a lane a flight, a group a control point.

The ensemble is packed once; for each eight flights the numbers that are dispersed are written into its block, its state
is put back, and every group is marched. Only peaks are kept, so that memory does not grow with the flights.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.block import (
    EFFECT_PARAMETERS,
    EFFECT_WIDTH,
    FAILED,
    LANES,
    N_CONDITIONS,
    NEGATIVE,
    RATIO_TABLE,
    parameters_at,
    scalar_row,
)
from sim_heating.base.parameters import EFFECT_PREFIX, RATIO, STACK
from sim_heating.heating.effects import EffectUse
from sim_heating.heating.ratio.lookup import VARIABLES
from sim_heating.heating.reference.models import reference_model
from sim_heating.inputs.points import point_of_vehicle
from sim_heating.inputs.vehicle import Vehicle
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.frames import march_group
from sim_heating.march.point import PointModel, element_densities, insulation_layer, stack_values
from sim_heating.planning.dispersion.flight import POINT_NUMBERS, WHOLE, Flown, condition_kernel, set_lanes
from sim_heating.planning.limited_point import LimitedPoint
from sim_heating.planning.soak import still_air
from sim_heating.simulation.plugin_kernel import CODE, HOST_SIZE, LENGTH, RADIUS
from sim_heating.thermal.mesh import Mesh

QUANTITIES = ("surface_K", "bondline_K")
"""The peaks that are looked at, in their order."""
SOAK_STEP_S = 20.0
"""Step of the soak [s], which begins in steps of the flight."""
SOAK_BEGINS_S = 60.0
_STACK = {p.name: k for k, p in enumerate(STACK)}
_RATIO = {p.name: k for k, p in enumerate(RATIO)}


@dataclass(frozen=True)
class Peaks:
    """What some flights meant for the points: (flight, point) peak temperatures [K], NaN where a flight was not whole;
    whether the ratio was ever negative; (flight, 2, 5) least and largest ratio variables."""

    surface_K: FloatArray
    bondline_K: FloatArray
    negative: NDArray[np.bool_]
    extent: FloatArray


@dataclass(frozen=True)
class _Group:
    """One control point's lanes: its number among the groups and what its elements are made of."""

    number: int
    mesh: Mesh
    density: FloatArray
    insulation: int
    stack: FloatArray
    parameters: FloatArray
    tables: IntArray
    nodes: FloatArray


class LaneMarch:
    """Control points of a vehicle, each in LANES lanes.

    points  : with their limits;  effects : beside the vehicle's own, by point
    meshes  : one a point
    step_s  : of the march, and between the kept frames of flights
    soak_s  : after the end of each flight
    """

    def __init__(
        self,
        vehicle: Vehicle,
        points: Sequence[LimitedPoint],
        effects: Sequence[Sequence[EffectUse]],
        meshes: Sequence[Mesh],
        step_s: float,
        soak_s: float,
    ) -> None:
        self.points, self.step_s, self.soak_s = tuple(points), step_s, soak_s
        self.models = [bare_model(vehicle, p, e) for p, e in zip(points, effects, strict=True)]
        lanes = [
            m if m.ratio is None else replace(m, ratio=replace(m.ratio)) for m in self.models for _ in range(LANES)
        ]
        self.ensemble = Ensemble(lanes, [mesh for mesh in meshes for _ in range(LANES)], max(step_s, SOAK_STEP_S))
        self._fresh = self.ensemble.snapshot()
        self._groups = [self._group(p, mesh) for p, mesh in enumerate(meshes)]
        self.host = _host(vehicle)
        plate = reference_model(vehicle.heating.reference).on_plate
        lengths = [(p.point.running_length_m or 1.0) if plate else 1.0 for p in points]
        self.numbers = np.array([[*p.point.pressure.parameters(), n] for p, n in zip(points, lengths, strict=True)])
        assert self.numbers.shape[1] == POINT_NUMBERS  # what condition_kernel reads
        self.still = np.array([list(still_air(p.point.construction).values()) for p in points])
        self._columns = self.ensemble.outputs()
        self._room = np.empty(0)

    def _group(self, p: int, mesh: Mesh) -> _Group:
        model, e = self.models[p], self.ensemble
        number = e.lane_offsets[p * LANES].group
        first = parameters_at(0)
        J = e.integers(number)
        length = 0 if model.ratio is None else VARIABLES + sum(len(a) for a in model.ratio.axes)
        return _Group(
            number, mesh, element_densities(model.construction, mesh), insulation_layer(model.construction),
            stack_values(model), e.block(number)[first : parameters_at(1)].copy(),
            J[RATIO_TABLE : RATIO_TABLE + LANES] + length,
            np.zeros(0) if model.ratio is None else model.ratio.ratio.ravel(),
        )  # fmt: skip

    def place_of(self, point: int, name: str) -> tuple[str, int]:
        """Where a dotted parameter of a point stands: ("stack" or "heating", place).

        raises : InputError where the point has no such parameter
        """
        model = self.models[point]
        model.definition(name)
        if name in _STACK:
            return "stack", _STACK[name]
        if name in _RATIO:
            return "heating", _RATIO[name]
        kernels = sorted((u for u in model.effects if u.effect.kernel), key=lambda u: _MODES[u.effect.mode])
        effect, parameter = name.removeprefix(EFFECT_PREFIX).rsplit(".", 1)
        for k, used in enumerate(kernels):
            if used.effect.name == effect:
                names = [p.name for p in used.effect.parameters]
                return "heating", EFFECT_PARAMETERS + k * EFFECT_WIDTH + names.index(parameter)
        raise InputError(f"{model.name}: `{name}` stands for another parameter of the model; name that one")

    def march(
        self,
        flown: Flown,
        first: int,
        changes: Sequence[tuple[int, str, int, FloatArray]],
        tables: Sequence[FloatArray | None],
        keep: list[tuple[FloatArray, FloatArray]] | None = None,
    ) -> Peaks:
        """Peaks along LANES flights, or fewer, from `first` on.

        changes : (point, kind, place, (flight,) deviation) of parameters
        tables  : for each point (node, flight) factors on its ratio table, None where it stands
        keep    : receives, where it is wanted, for each point surface and bondline (time, 2 LANES) and the conditions
                  (LANES, time, condition)
        """
        last = min(first + LANES, len(flown.filled))
        lane = np.minimum(np.arange(first, first + LANES), last - 1)
        filled = flown.filled[lane]
        time_s = self.times(int(filled.max()))
        histories = self._histories(len(time_s))
        condition_kernel(flown.rows[lane], filled, self.host, self.numbers, self.still, time_s, histories)
        self.ensemble.restore(self._fresh)
        self._write(changes, tables, lane)
        counted = self._counted(time_s, filled)
        shape = (last - first, len(self.points))
        surface, bondline, negative = np.empty(shape), np.empty(shape), np.empty(shape, dtype=bool)
        own = np.arange(last - first)
        for p, group in enumerate(self._groups):
            out = self._march_group(p, group, time_s, histories[p])
            if keep is not None:
                keep.append((out, histories[p].copy()))
            B = self.ensemble.block(group.number)
            failed = B[scalar_row(FAILED)][own] > 0.0
            for i in own:
                until = counted[i]
                surface[i, p] = np.nan if failed[i] else np.max(out[:until, 2 * i])
                bondline[i, p] = np.nan if failed[i] else np.max(out[:until, 2 * i + 1])
            negative[:, p] = B[scalar_row(NEGATIVE)][own] > 0.0
        whole = flown.outcome[lane[own]] == WHOLE
        surface[~whole], bondline[~whole] = np.nan, np.nan
        ratio = histories[0, : last - first, :, : len(RATIO_VARIABLES)]
        extent = np.array([[r[:n].min(axis=0), r[:n].max(axis=0)] for r, n in zip(ratio, filled, strict=False)])
        return Peaks(surface, bondline, negative, extent)

    def _histories(self, samples: int) -> FloatArray:
        """Room for (point, LANES, time, condition), the same each time: some MB that were made anew for every few
        flights would cost more than what is written there."""
        shape = (len(self.points), LANES, samples, N_CONDITIONS)
        size = math.prod(shape)
        if size > len(self._room):
            self._room = np.empty(size)
        return self._room[:size].reshape(shape)

    def times(self, frames: int) -> FloatArray:
        """Frames of the longest flight, then the soak: in steps of the flight at first."""
        end = self.step_s * (frames - 1)
        close = np.arange(1, int(np.ceil(min(SOAK_BEGINS_S, self.soak_s) / self.step_s)) + 1) * self.step_s
        far = np.arange(1, int(np.ceil(max(self.soak_s - SOAK_BEGINS_S, 0.0) / SOAK_STEP_S)) + 1) * SOAK_STEP_S
        soak = np.concatenate((close, (close[-1] if len(close) else 0.0) + far))
        return np.concatenate((self.step_s * np.arange(frames), end + soak))

    def _counted(self, time_s: FloatArray, filled: IntArray) -> IntArray:
        """How many of the times count for each lane: its flight and its own soak."""
        ends = self.step_s * (filled - 1) + self.soak_s
        return np.searchsorted(time_s, ends + 1e-6, side="right")

    def _write(
        self, changes: Sequence[tuple[int, str, int, FloatArray]], tables: Sequence[FloatArray | None], lane: IntArray
    ) -> None:
        stacks = [np.repeat(g.stack[np.newaxis], LANES, axis=0) for g in self._groups]
        heating = [np.repeat(g.parameters[np.newaxis], LANES, axis=0) for g in self._groups]
        for p, kind, place, deviation in changes:
            (stacks if kind == "stack" else heating)[p][:, place] += deviation[lane]
        for p, g in enumerate(self._groups):
            B, J = self.ensemble.block(g.number), self.ensemble.integers(g.number)
            set_lanes(
                B, J, g.mesh.layer, g.mesh.length_m, g.density, g.insulation, g.mesh.bondline, stacks[p], heating[p]
            )
            factors = tables[p]
            for k in range(LANES):
                at = int(g.tables[k])
                self.ensemble.table[at : at + len(g.nodes)] = g.nodes * (
                    1.0 if factors is None else factors[:, lane[k]]
                )

    def march_all(self, time_s: FloatArray, histories: FloatArray) -> list[FloatArray]:
        """Every group from where it is along histories (point, LANES, time, condition), (time, 2 LANES) each."""
        return [self._march_group(p, g, time_s, histories[p]) for p, g in enumerate(self._groups)]

    def _march_group(self, p: int, group: _Group, time_s: FloatArray, histories: FloatArray) -> FloatArray:
        e, g = self.ensemble, group.number
        start = e.groups[g, 0]
        kept = self._columns[2 * LANES * p : 2 * LANES * (p + 1)] - start
        out = np.empty((len(time_s), 2 * LANES))
        march_group(
            e.block(g), e.integers(g), e.table, e.dispatcher, e.advance_address, time_s, histories,
            np.arange(LANES), SOAK_STEP_S, kept, out,
        )  # fmt: skip
        return out


_MODES = {"add": 0, "multiply": 1, "emittance": 2}


def bare_model(vehicle: Vehicle, limited: LimitedPoint, effects: Sequence[EffectUse]) -> PointModel:
    """A control point without its sensors, whose nodes a peak does not need."""
    return replace(point_of_vehicle(vehicle, limited.point, effects=tuple(effects)), depths_m=(), nodes=None)


def _host(vehicle: Vehicle) -> FloatArray:
    host = np.zeros(HOST_SIZE)
    host[CODE] = float(reference_model(vehicle.heating.reference).code)
    host[LENGTH], host[RADIUS] = vehicle.reference_length_m, vehicle.heating.nose_radius_m or 1.0
    return host
