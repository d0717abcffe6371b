"""Control points packed for the compiled march: one model, whether stepped by a host or marched through a flight.

An Ensemble holds many points, of one flight or of many, in groups of LANES. It contains the whole state: a snapshot of
it is a copy of one array.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.kernels import block
from sim_heating.base.kernels.block import CONDITION_COLUMNS, LANES, N_CONDITIONS
from sim_heating.base.kernels.jit import address_of
from sim_heating.base.parallel.threads import in_threads
from sim_heating.heating.effects import Effect
from sim_heating.heating.effects.compiled import effect_dispatcher, unusable_value
from sim_heating.heating.effects.transition import TRANSITION
from sim_heating.heating.ratio.lookup import pack_table
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.march.frames import (
    BLOCK_END,
    BLOCK_START,
    INTS_END,
    INTS_START,
    Flights,
    LaneGroups,
    advance_groups,
    begin_groups,
    march_group,
)
from sim_heating.march.point import (
    MOISTURE_RUNAWAY,
    PointModel,
    elements_of,
    heating_vector,
    initial_temperatures,
    kernel_effects,
    stack_values,
)
from sim_heating.thermal.elements import Elements, set_lanes, set_point, set_temperatures
from sim_heating.thermal.faces import SIGMA
from sim_heating.thermal.frame import STEP_TOLERANCE_K, compiled
from sim_heating.thermal.mesh import Mesh
from sim_heating.thermal.stack import BackFace, Material
from sim_heating.thermal.step import LaneGroup
from sim_heating.thermal.tables import PointTables, TableStore

ABSENT = {"turbulent_ratio": 1.0}
"""Values of columns that a flight may lack, where not 0."""
CONTACT = Material(density_kg_m3=1.0, specific_heat_J_kgK=[[300.0, 1.0]], conductivity_W_mK=[[300.0, 1.0]])
"""Material of a contact resistance: an element without mass, of conductivity 1, whose "length" is the resistance."""
CACHE_LINE = 64
"""Length of a line of the processor's cache [bytes]."""
COUNTERS = (
    block.FAILED, block.ITERATIONS, block.STEPS, block.OUTSIDE, block.NEGATIVE, block.ENERGY_IN, block.ENERGY_OUT,
    block.LAG_PAST,
)  # fmt: skip
"""Rows that a march begins with 0."""
THREADED_POINT_STEPS = 20_000
"""Below this number of point-steps a march is faster on one thread."""


def condition_history(conditions: Conditions) -> FloatArray:
    """(time, condition) flight conditions as the kernels take them, in the order of `CONDITION_COLUMNS`.

    conditions : of one flight; each column keeps its unit ([deg], [Pa], [J/kg] ...)

    Columns that a flight may lack (additional flux, jets, rise of the recovery enthalpy ...) are 0, a turbulent over
    laminar ratio is 1. Source: docs/theory/equations_march.md, equation 1.
    """
    n = len(conditions)
    columns = [conditions[c] if c in conditions else np.full(n, ABSENT.get(c, 0.0)) for c in CONDITION_COLUMNS]
    return np.ascontiguousarray(np.column_stack(columns))


@dataclass(frozen=True)
class LaneOffsets:
    """Where the lanes of a point are: its group, lanes from `lane` to before `end`, first number of the group's block.

    Offsets are places in the `state` of its ensemble, those of the point's first lane.
    """

    group: int
    lane: int
    end: int
    start: int

    def temperature(self, node: int) -> int:
        """Offset of a node temperature [K]; node 0 is at the surface."""
        return self.start + (block.HEAD_ROWS + node * block.NODE_ROWS + block.T) * LANES + self.lane

    @property
    def node_0(self) -> int:
        """Offset in `state` of the first number of node 0, the node at the surface."""
        return self.start + block.HEAD_ROWS * LANES + self.lane

    def scalar(self, row: int) -> int:
        """Offset in `state` of one number of the lane.

        row : row of the block ahead of its nodes (base/kernels/block.py)
        """
        return self.start + row * LANES + self.lane


def _groups_in_order(group_of: Mapping[int, int], behind: Mapping[int, int]) -> list[int]:
    """Groups in an order in which walls upstream are before what lies behind them; empty where there is none.

    group_of : point -> its group, those of points that are in none yet are of one point; the order without any wall
    """
    before: dict[int, set[int]] = {group: set() for group in group_of.values()}
    for i, wall in behind.items():
        before[group_of[i]].add(group_of[wall])
    try:
        return list(TopologicalSorter(before).static_order())
    except CycleError:
        return []


class PointLanes(NamedTuple):
    """Lanes of points of one wall: (point, 5) where the block of its group and the integers of that begin and end, and
    the number of the lane in it; elements of the wall."""

    positions: IntArray
    elements: Elements


class Ensemble:
    """Control points in lanes, with their temperatures.

    models : the control points; results keep their order
    meshes : the mesh of each (mesh_choice.pack chooses them)
    step_s : the longest time step that a march takes [s]
    share_tables_with : an ensemble of points with the same tables and effects, whose tables this one shares
    kinds  : (point,) numbers; points of different kinds share no group, those of the lowest come first
    tolerance_K : largest error of a time step at any node [K], for which a point divides its steps; from
             NOT_CONTROLLED_K on no step is divided
    behind : point -> the point of the wall upstream of its interface, by their numbers; that wall is in an earlier
             group, so that its step is taken first
    raises : InputError where there is no point

    Attributes: `meshes`, `table` with all property and ratio tables, and `state`, which holds everything that changes.
    """

    def __init__(
        self,
        models: Sequence[PointModel],
        meshes: Sequence[Mesh],
        step_s: float = 1.0,
        share_tables_with: Ensemble | None = None,
        kinds: Sequence[int] | None = None,
        tolerance_K: float = STEP_TOLERANCE_K,
        behind: Mapping[int, int] | None = None,
    ) -> None:
        if not models:
            raise InputError("no control point was given; give at least one")
        self.models = list(models)
        self.step_s, self.tolerance_K = step_s, tolerance_K
        self.meshes = tuple(meshes)
        self._effects = _distinct_effects(self.models)
        self._dispatcher = effect_dispatcher(self._effects)
        self.dispatcher = self._dispatcher.address
        self._codes = dict(zip(self._effects, self._dispatcher.codes, strict=True))
        # An address and not the function: kernels that call it need no recompiling when effects change.
        self.advance_address = address_of(compiled())
        self._tables: TableStore = TableStore() if share_tables_with is None else share_tables_with._tables
        self._arrange([0] * len(self.models) if kinds is None else kinds, behind or {})
        self.table = self._tables.values
        self.reset()

    # Packing ---------------------------------------------------------------------------------------------------------

    def point_tables(self, model: PointModel) -> PointTables:
        """Offsets in `table` of the property tables of a point; those that are not there yet are added.

        model : the point, for the materials of its layers and the enthalpy of air at its wall
        """
        return self._tables.add_point(model.construction.layer_materials(), CONTACT, model.wall_enthalpy)

    def _add_ratio_table(self, table: RatioTable | None) -> int:
        return block.NO_TABLE if table is None else self._tables.place(("ratio", id(table)), lambda: pack_table(table))

    def _grouped(self, kinds: Sequence[int], behind: Mapping[int, int]) -> list[list[int]]:
        """Numbers of the models of each group, at most LANES of one kind, walls upstream in groups before."""
        group_of = {i: i for i in range(len(self.models))}  # by the first point of the group
        members: dict[int, list[int]] = {}
        with_room: list[int] = []
        # Padding behind the back costs as much as nodes do: neighbours in node count share a group.
        for i in sorted(group_of, key=lambda i: (kinds[i], -self.meshes[i].nodes, i)):
            alike = (first for first in with_room if kinds[first] == kinds[i])
            first = next((f for f in alike if not behind or _groups_in_order(group_of | {i: f}, behind)), i)
            group_of[i] = first
            members.setdefault(first, []).append(i)
            with_room = [f for f in dict.fromkeys([*with_room, first]) if len(members[f]) < LANES]
        first_of = {
            i: first for first, points in members.items() for i in points
        }  # those of the lowest kind come first
        return [members[first] for first in _groups_in_order(first_of, behind)]

    def _arrange(self, kinds: Sequence[int], behind: Mapping[int, int]) -> None:
        """Put models of one kind and like node counts into groups of LANES; the last one of a group fills it up."""
        members = self._grouped(kinds, behind)
        nodes = [max(self.meshes[i].nodes for i in group) for group in members]
        blocks = np.concatenate(([0], np.cumsum([block.block_size(n) for n in nodes])))
        integers = np.concatenate(([0], np.cumsum([block.integers_size(n) for n in nodes])))
        self.groups = np.column_stack([blocks[:-1], blocks[1:], integers[:-1], integers[1:]]).astype(np.int64)
        self.state = aligned_zeros(int(blocks[-1]))
        self.ints = np.zeros(integers[-1], dtype=np.int64)
        # Lanes without a point repeat the last one, so that they never fail by themselves.
        self.lanes = np.array([group + [group[-1]] * (LANES - len(group)) for group in members]).ravel()
        self.lane_offsets = [LaneOffsets(0, 0, 0, 0)] * len(self.models)
        by_wall: dict[tuple[int, int], Elements] = {}
        for m, mesh in zip(self.models, self.meshes, strict=True):
            # most lanes of a march with sensitivities are of one wall
            if (id(m.construction), id(mesh)) not in by_wall:
                by_wall[id(m.construction), id(mesh)] = elements_of(m.construction, mesh)
        self._elements = [
            by_wall[id(m.construction), id(mesh)] for m, mesh in zip(self.models, self.meshes, strict=True)
        ]
        for g, group in enumerate(members):
            for lane, i in enumerate(group):
                end = LANES if i == group[-1] else lane + 1
                self.lane_offsets[i] = LaneOffsets(g, lane, end, int(blocks[g]))
            self._pack_group(g)

    def block(self, group: int) -> FloatArray:
        """(number,) numbers of a lane group: temperatures [K], conditions and all else that changes (a view).

        group : number of the group
        """
        return self.state[self.groups[group, BLOCK_START] : self.groups[group, BLOCK_END]]

    def integers(self, group: int) -> IntArray:
        """(integer,) integers of a lane group: node count, table offsets, effect codes (a view).

        group : number of the group
        """
        return self.ints[self.groups[group, INTS_START] : self.groups[group, INTS_END]]

    def lane_group(self, group: int) -> LaneGroup:
        """A lane group as compiled time loops take it: views of its block and integers, tables and addresses."""
        return LaneGroup(self.block(group), self.integers(group), self.table, self.dispatcher, self.advance_address)

    @cached_property
    def lane_groups(self) -> LaneGroups:
        """All lane groups as compiled time loops take them."""
        return LaneGroups(self.state, self.ints, self.table, self.dispatcher, self.advance_address, self.groups)

    def _pack_group(self, g: int) -> None:
        J = self.integers(g)
        members = list(dict.fromkeys(self.lanes[g * LANES : (g + 1) * LANES]))
        J[block.N_NODES] = max(self.meshes[i].nodes for i in members)
        self.block(g)[block.scalar_row(block.TOLERANCE)] = self.tolerance_K
        for i in members:
            self._pack_stack(i)
            self._pack_heating(i)
        nodes = block.node_integers(J)
        materials = nodes[:, block.MATERIAL_TABLE :]
        nodes[1:-1, block.IS_INTERFACE] = np.any(materials[1:-1] != materials[:-2], axis=1)
        # Interfaces are flags of the group, known once all its stacks are packed; parameters are written after them.
        for i in members:
            self.set_model(i, self.models[i])

    def _pack_stack(self, i: int) -> None:
        """Write the part of a point's stack that does not depend on its parameters."""
        model, mesh, offsets = self.models[i], self.meshes[i], self.lane_offsets[i]
        B, J, lanes = self.block(offsets.group), self.integers(offsets.group), slice(offsets.lane, offsets.end)
        tables = self.point_tables(model)
        nodes = block.node_integers(J)
        materials = np.array(tables.materials)[mesh.layer]
        nodes[:, block.MATERIAL_TABLE :][: len(materials), lanes] = materials[:, np.newaxis]
        nodes[:, block.MATERIAL_TABLE :][len(materials) :, lanes] = materials[-1]
        nodes[[0, mesh.nodes - 1], block.IS_FACE] = 1
        block.node_rows(B)[mesh.nodes :, block.M_RIGHT, lanes] = 1.0
        for gas in model.construction.gas_layers:
            J[block.IN_DEPTH] = 1
            between = SIGMA * model.construction.faces_exchange(gas)
            block.node_rows(B)[np.flatnonzero(mesh.layer == gas), block.BETWEEN_FACES, lanes] = between
        B[block.scalar_row(block.SURROUNDINGS4)][lanes] = model.construction.stack.surroundings_K**4
        factors = (1.0, 1.0) if model.interface is None else model.interface.factors
        for row, factor in zip((block.STEP_LAMINAR, block.STEP_TURBULENT), factors, strict=True):
            B[block.scalar_row(row)][lanes] = factor
        if model.construction.stack.venting_tau_s > 0.0:
            J[block.VENTS] = 1
            B[block.scalar_row(block.VENTING_TAU)][lanes] = model.construction.stack.venting_tau_s
        back = model.construction.stack.back
        if isinstance(back, BackFace) and back.natural_h_W_m2K > 0.0:
            J[block.CONVECTS] = 1
            B[block.scalar_row(block.NATURAL)][lanes] = back.natural_h_W_m2K
            B[block.scalar_row(block.NATURAL_EXPONENT)][lanes] = back.natural_exponent
        for row, value in (
            (block.BACK_NODE, mesh.nodes - 1), (block.N_PRESSURES, tables.columns),
            (block.PRESSURE_TABLE, tables.pressures), (block.EMISSIVITY_TABLE, tables.emissivity),
            (block.ENTHALPY_TABLE, tables.enthalpy),
        ):  # fmt: skip
            J[row + offsets.lane : row + offsets.end] = value

    def _pack_heating(self, i: int) -> None:
        """Write the part of a point's heating that does not depend on its parameters."""
        offsets, uses = self.lane_offsets[i], kernel_effects(self.models[i])
        J = self.integers(offsets.group)
        modes = [u.effect.mode for u in uses]
        lagging = [k for k, u in enumerate(uses) if u.effect.lags]
        turning = [k for k, u in enumerate(uses) if u.effect.name == TRANSITION]
        on_ratio = len(uses) - modes.count("emittance")
        for row, value in (
            (block.RATIO_TABLE, self._add_ratio_table(self.models[i].ratio)), (block.N_ADDING, modes.count("add")),
            (block.N_EMITTING, modes.count("emittance")), (block.N_EFFECTS, on_ratio),
            (block.FIRST_AT_WALL, _first_at_wall([u.effect for u in uses[:on_ratio]])),
            (block.LAG_SLOT, lagging[0] if lagging else block.NONE),
            (block.TRANSITION_SLOT, turning[0] if turning else block.NONE),
        ):  # fmt: skip
            J[row + offsets.lane : row + offsets.end] = value
        for lane in range(offsets.lane, offsets.end):
            for k, used in enumerate(uses):
                J[block.EFFECT_CODES + lane * block.EFFECT_SLOTS + k] = self._codes[used.effect]

    def set_model(self, model: int, changed: PointModel) -> None:
        """Give a point new parameter values.

        model   : index of the point
        changed : its present model with other values (PointModel.with_parameters); stack, mesh, tables and effects must
                  be the same

        A march then begins with `reset` or `set_profile`: until then heat contents [J/m2] are those of the earlier
        parameters, which the step would take for its start (docs/theory/equations_march.md, equation 6).
        """
        self.models[model] = changed
        self.set_values(model, stack_values(changed), heating_vector(changed))

    def set_values(self, model: int, stack: FloatArray, heating: FloatArray) -> None:
        """Set new parameter values of a point as its lane takes them; `models` is left as it is.

        model   : index of the point
        stack   : (parameter,) as march.point.stack_values, each in its unit ([-], [J/kg], [K] ...)
        heating : (N_PARAMETERS,) as march.point.heating_vector

        A march then begins with `reset`, `restore` or `set_profile`. Source: docs/theory/equations_thermal_step.md,
        eq. 8.
        """
        offsets, elements = self.lane_offsets[model], self._elements[model]
        B, J = self.block(offsets.group), self.integers(offsets.group)
        set_point(B, J, offsets.lane, offsets.end, elements, stack, heating)

    def lanes_of(self, models: Sequence[int]) -> PointLanes:
        """The own lanes of points of one wall, as `write_lanes` takes them."""
        positions = [(*self.groups[self.lane_offsets[i].group], self.lane_offsets[i].lane) for i in models]
        return PointLanes(np.array(positions, dtype=np.int64), self._elements[models[0]])

    def write_lanes(self, state: FloatArray, lanes: PointLanes, stack: FloatArray, heating: FloatArray) -> None:
        """Write parameter values of points of one wall into their own lanes of a state of this ensemble, or of a copy.

        state : (number,) as `state`, changed;  lanes : as of `lanes_of`
        stack, heating : (point, parameter), (point, N_PARAMETERS), each row as for `set_values`

        Lanes that fill a group keep theirs, so that a march may go on: heat contents of the lanes themselves are to be
        evaluated again before the next step, and nobody would do so for those. Source:
        docs/theory/equations_thermal_step.md, eq. 8.
        """
        set_lanes(state, self.ints, lanes.positions, lanes.elements, stack, heating)

    # State -----------------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Set every point to the initial temperatures of its stack [K] and clear all counters.

        Source: docs/theory/equations_march.md, equation 23.
        """
        self.clear()
        for i, (model, mesh) in enumerate(zip(self.models, self.meshes, strict=True)):
            self._set_profile(i, initial_temperatures(model.construction, mesh))

    def clear(self) -> None:
        """Set to zero the counters of a march: failures, iterations, samples outside the table or of negative ratio,
        absorbed and emitted energy [J/m2] (docs/theory/equations_march.md, equation 24).
        """
        for g in range(len(self.groups)):
            B = self.block(g)
            for row in COUNTERS:
                B[block.scalar_row(row)] = 0.0
            B[block.scalar_row(block.COLUMN)] = -1.0

    def _set_profile(self, i: int, temperature_K: FloatArray) -> None:
        offsets = self.lane_offsets[i]
        B, J = self.block(offsets.group), self.integers(offsets.group)
        set_temperatures(B, offsets.lane, offsets.end, J[block.N_NODES], temperature_K)

    def set_profile(self, model: int, temperature_K: ArrayLike) -> None:
        """Set all node temperatures of one point; a march begins with them, a single step needs `begin` first.

        The initial condition T(x, 0) of docs/theory/equations_march.md, equation 23, for a profile known from
        elsewhere.

        model         : index of the point
        temperature_K : (node,) outermost first [K]
        raises        : InputError where the number of nodes differs or a temperature is not above 0 K
        """
        temperature = np.ascontiguousarray(temperature_K, dtype=float)
        if temperature.shape != (self.meshes[model].nodes,) or not np.all((temperature > 0.0) & (temperature < np.inf)):
            raise InputError(f"{self.models[model].name}: give {self.meshes[model].nodes} temperatures above 0 K")
        self._set_profile(model, temperature)

    def snapshot(self) -> FloatArray:
        """Copy of everything that changes (temperatures, conditions, counters), as one array; `restore` accepts it."""
        return self.state.copy()

    def restore(self, snapshot: FloatArray) -> None:
        """Return to a snapshot of this ensemble, bit for bit.

        snapshot : (number,) as `snapshot` gave it
        raises   : InputError where its size is that of another model
        """
        if snapshot.shape != self.state.shape:
            raise InputError(
                f"snapshot: {snapshot.size} numbers, this model has {self.state.size}; it is of another model"
            )
        self.state[:] = snapshot

    # Reading ---------------------------------------------------------------------------------------------------------

    def node_temperatures(self, model: int) -> FloatArray:
        """(node,) present temperatures of a point [K], outermost first, without the padding of its group.

        model : number of the point
        """
        offsets = self.lane_offsets[model]
        nodes = block.node_rows(self.block(offsets.group))
        return nodes[: self.meshes[model].nodes, block.T, offsets.lane].copy()

    def stage_temperatures(self, model: int) -> FloatArray:
        """(node,) temperatures of a point [K] at the middle stage of its last step, t_n + gamma dt, outermost first.

        model : number of the point

        With those at both ends of the step they define the parabola of docs/theory/equations_march.md, equation 4.
        """
        offsets = self.lane_offsets[model]
        nodes = block.node_rows(self.block(offsets.group))
        return nodes[: self.meshes[model].nodes, block.T_STAGE, offsets.lane].copy()

    def node_offsets(self, model: int, nodes: Iterable[int] | None = None) -> IntArray:
        """(node,) offsets in `state` of node temperatures [K] of a point.

        model : number of the point
        nodes : nodes wanted, 0 at the surface; by default all of the point
        """
        selected = range(self.meshes[model].nodes) if nodes is None else nodes
        return np.array([self.lane_offsets[model].temperature(node) for node in selected], dtype=np.int64)

    def outputs(self) -> IntArray:
        """Offsets in `state` of the temperatures [K] of surface, bondline and each sensor of each point, in this order.

        The outputs that docs/theory/equations_march.md, equation 16, compares.
        """
        faces = [(0, mesh.bondline, *mesh.sensors) for mesh in self.meshes]
        return np.concatenate([self.node_offsets(i, nodes) for i, nodes in enumerate(faces)])

    def film_offsets(self) -> IntArray:
        """(point,) offsets in `state` of the film coefficient at the end of the last step [kg/(m2 s)].

        Source: docs/theory/equations_march.md, equation 18.
        """
        # FILM has one row a stage; the third is that of the end of a step, where the samples are.
        return np.array([offsets.scalar(block.FILM + 2) for offsets in self.lane_offsets], dtype=np.int64)

    def heat_offsets(self) -> IntArray:
        """(3, point) offsets in `state` of the heat that enters the wall and that leaves at the back [W/m2], and of
        T_sur^4 [K4], at the samples.

        Source: docs/theory/equations_thermal_step.md, equations 14 and 30.
        """
        rows = (block.STAGE_IN, block.STAGE_OUT, block.STAGE_SURROUNDINGS4 + 2)
        return np.array([[offsets.scalar(row) for offsets in self.lane_offsets] for row in rows], dtype=np.int64)

    @property
    def film_kg_m2_s(self) -> FloatArray:
        """(point,) film coefficient r h_ref [kg/(m2 s)] at the end of a step: docs/theory/equations_march.md, eq 18."""
        return self.state[self.film_offsets()]

    @property
    def failures(self) -> FloatArray:
        """(point,) stages not converged since the last reset [-]: docs/theory/equations_thermal_step.md, section 6."""
        return self._scalars(block.FAILED)

    @property
    def iterations(self) -> FloatArray:
        """(point,) Newton iterations since the last reset [-]: docs/theory/equations_thermal_step.md, equation 25."""
        return self._scalars(block.ITERATIONS)

    @property
    def steps(self) -> FloatArray:
        """(point,) time steps taken since the last reset [-]: docs/theory/equations_thermal_step.md, section 9."""
        return self._scalars(block.STEPS)

    @property
    def steps_outside_table(self) -> FloatArray:
        """(point,) number of steps that ended outside the ratio table since the last reset [-].

        For a host, which steps frame by frame; durations of a whole march are docs/theory/equations_march.md,
        equation 19.
        """
        return self._scalars(block.OUTSIDE)

    @property
    def steps_of_negative_ratio(self) -> FloatArray:
        """(point,) number of steps that ended with a negative ratio since the last reset [-].

        The ratio is that of docs/theory/equations_march.md, equation 18; it is not clipped.
        """
        return self._scalars(block.NEGATIVE)

    @property
    def absorbed_J_m2(self) -> FloatArray:
        """(point,) energy that entered at the surface and in gaps since the last reset [J/m2].

        Source: docs/theory/equations_march.md, equation 24.
        """
        return self._scalars(block.ENERGY_IN)

    @property
    def emitted_J_m2(self) -> FloatArray:
        """(point,) energy that left at the back since the last reset [J/m2]; docs/theory/equations_march.md, eq 24."""
        return self._scalars(block.ENERGY_OUT)

    def _scalars(self, row: int) -> FloatArray:
        return np.array([self.state[offsets.scalar(row)] for offsets in self.lane_offsets])

    # Moving ----------------------------------------------------------------------------------------------------------

    def spread(self, vectors: FloatArray) -> FloatArray:
        """(group * LANES, condition) condition vectors of all lanes from those of the points.

        vectors : (point, condition), each column in its unit ([deg], [Pa], [J/kg] ...)

        Lanes that fill a group repeat its last point. Conditions: docs/theory/equations_march.md, equation 1.
        """
        return vectors[self.lanes]

    def begin(self, now: FloatArray) -> None:
        """Set the conditions at the present time.

        now : (point, condition) in the units of the condition columns ([deg], [Pa], [J/kg] ...)

        Needed before the first step, and after temperatures or parameters were changed. Source:
        docs/theory/equations_march.md, section 1.
        """
        vectors = self.spread(now)
        begin_groups(*self.lane_groups, vectors)

    def advance(self, then: FloatArray, dt: float) -> None:
        """Advance all points by one frame, conditions linear in time over it, each in as many steps as its error needs.

        then   : (point, condition) at the end of the frame, in the units of the condition columns
        dt     : length of the frame [s]
        raises : InputError where dt is not above 0

        Whether the step converged is found with `check` or `failed`. Source: docs/theory/equations_march.md,
        equation 3; docs/theory/equations_thermal_step.md, equations 19 and 20, for the step.
        """
        if not 0.0 < dt < np.inf:
            raise InputError(f"advance: dt is {dt:g} s; it must be above 0")
        vectors = self.spread(then)
        advance_groups(*self.lane_groups, vectors, dt, 1)

    def march(
        self,
        time_s: FloatArray,
        histories: FloatArray,
        which: Sequence[int] | None = None,
        *,
        longest_step_s: float | None = None,
        keep: IntArray | None = None,
    ) -> FloatArray:
        """March all points through their flights from the present temperatures.

        time_s         : (time,) samples [s], common to all flights
        histories      : (flight, time, condition) as condition_history gives them
        which          : flight of each point; by default the flights are one for each point, or one for all
        longest_step_s : intervals that are longer are divided into equal steps [s]; by default that of the ensemble
        keep           : offsets in `state` to store at each sample, `outputs()` by default; an empty array stores
                         nothing
        returns        : (time, place) numbers stored, by default temperatures [K]
        raises         : InputError for times or histories of another form or with values that are not finite;
                         RunError where the step of a point did not converge

        Derived in docs/theory/equations_march.md, equations 1 and 2.
        """
        # One flight for all points is the common case of a simulation, one for each that of a study.
        if which is None:
            which = [0] * len(self.models) if len(histories) == 1 else list(range(len(self.models)))
        self._check_march(time_s, histories, which, longest_step_s)
        kept = self.outputs() if keep is None else keep
        out = np.empty((len(time_s), len(kept)) if len(kept) else (0, 0))
        flights = np.asarray(which, dtype=np.int64)[self.lanes].reshape(-1, LANES)
        step = self.step_s if longest_step_s is None else longest_step_s
        time_s, histories = np.ascontiguousarray(time_s, dtype=float), np.ascontiguousarray(histories, dtype=float)

        # Groups share nothing that changes: results do not depend on threads. The kernel releases the interpreter.
        def march_one(g: int) -> None:
            start, end = self.groups[g, BLOCK_START], self.groups[g, BLOCK_END]
            columns = np.flatnonzero((kept >= start) & (kept < end))
            rows = self.march_lanes(g, time_s, histories, flights[g], step, kept[columns])
            if len(rows):
                out[:, columns] = rows

        groups = range(len(self.groups))
        if len(groups) > 1 and len(time_s) * len(self.models) > THREADED_POINT_STEPS:
            in_threads(march_one, len(groups))
        else:
            for g in groups:
                march_one(g)
        self._check_effects(time_s, histories, which)
        self.check()
        return out

    def march_lanes(
        self, group: int, time_s: FloatArray, histories: FloatArray, flights: IntArray, longest_step_s: float,
        kept: IntArray,
    ) -> FloatArray:  # fmt: skip
        """March one lane group through its flights from the present temperatures, without any check.

        time_s         : (time,) samples [s];  histories : (flight, time, condition), in the units of their columns
        flights        : (LANES,) flight of each lane
        longest_step_s : intervals that are longer are divided into equal steps [s]
        kept           : offsets in `state`, all in this group, to store at each sample
        returns        : (time, place) numbers stored; no rows where no place is given

        Whether the steps converged is found with `check` or `failed`. Source: docs/theory/equations_march.md,
        equations 1, 2.
        """
        out = np.empty((len(time_s) if len(kept) else 0, len(kept)))
        flights_of_group = Flights(time_s, histories, flights)
        march_group(
            self.lane_group(group), flights_of_group, longest_step_s, kept - self.groups[group, BLOCK_START], out
        )
        return out

    def _check_march(
        self, time_s: FloatArray, histories: FloatArray, which: Sequence[int], longest_step_s: float | None
    ) -> None:
        shape = np.shape(histories)
        if np.ndim(time_s) != 1 or len(shape) != 3 or shape[1:] != (len(time_s), N_CONDITIONS):
            expected = f"(flight, {len(time_s)} times, {N_CONDITIONS} conditions)"
            raise InputError(f"march: histories are {shape}; they must be {expected}")
        if len(time_s) == 0 or not np.all(np.isfinite(time_s)) or np.any(np.diff(time_s) <= 0.0):
            raise InputError("march: time_s must be finite and increase from sample to sample")
        if len(which) != len(self.models) or not all(0 <= w < shape[0] for w in which):
            raise InputError(f"march: {shape[0]} flights for {len(self.models)} points; name the flight of each point")
        if longest_step_s is not None and not longest_step_s > 0.0:
            raise InputError(f"march: longest_step_s is {longest_step_s:g}; it must be above 0")
        if not np.all(np.isfinite(histories)):
            flight, sample, column = np.argwhere(~np.isfinite(histories))[0]
            name, time = CONDITION_COLUMNS[column], np.asarray(time_s)[sample]
            raise InputError(f"march, flight {flight}, time_s {time:g}: {name} is not a finite number")

    def failed(self) -> NDArray[np.bool_]:
        """(point,) whose step did not converge, whose surface temperature [K] is not a number, or whose moisture has no
        unique temperature (docs/theory/equations_march.md, equation 22).
        """
        surface = np.array([self.state[offsets.temperature(0)] for offsets in self.lane_offsets])
        away = np.array([model.runs_away for model in self.models])
        return np.asarray((self.failures > 0.0) | ~np.isfinite(surface) | away)

    def _check_effects(self, time_s: FloatArray, histories: FloatArray, which: Sequence[int]) -> None:
        """Look for the reason of a failure in the effects that a user defined.

        raises : RunError with effect, file, time and value, where a point failed and an effect of it has a value that
                 no step can use
        """
        for model, failed, flight in zip(self.models, self.failed(), which, strict=True):
            for use in model.effects if failed else ():
                if fault := unusable_value(use, time_s, histories[flight]):
                    raise RunError(f"{model.name}: {fault}")

    def check(self) -> None:
        """Raise an error where a point failed.

        raises : RunError naming the points whose step did not converge, or whose moisture has no unique temperature
                 (docs/theory/equations_march.md, equation 22)
        """
        away = [model.name for model in self.models if model.runs_away]
        if away:
            raise RunError(f"{', '.join(away)}: {MOISTURE_RUNAWAY}")
        bad = [model.name for model, failed in zip(self.models, self.failed(), strict=True) if failed]
        if bad:
            raise RunError(
                f"{', '.join(bad)}: the thermal step did not converge; check the layers' properties and "
                "the heating, or take a smaller longest_step_s from Python"
            )


def aligned_zeros(count: int) -> FloatArray:
    """Array of `count` zeros that begins on a cache line.

    Where every second vector load splits a line, a step takes a fifth longer.
    """
    memory = np.zeros(count + CACHE_LINE // 8)
    first = (-memory.ctypes.data % CACHE_LINE) // 8
    return memory[first : first + count]


def _first_at_wall(on_ratio: Sequence[Effect]) -> int:
    """First of the effects on a ratio, in their order, that are evaluated again at each wall temperature."""
    # What follows an effect that adds passes through the lag and every factor: all are evaluated again.
    if any(effect.needs_wall and effect.mode == "add" for effect in on_ratio):
        return 0
    return next((k for k, effect in enumerate(on_ratio) if effect.needs_wall), len(on_ratio))


def _distinct_effects(models: Iterable[PointModel]) -> tuple[Effect, ...]:
    return tuple(dict.fromkeys(u.effect for m in models for u in m.effects if u.effect.kernel))


def histories(flights: Sequence[Conditions]) -> FloatArray:
    """(flight, time, condition) conditions of several flights, as `Ensemble.march` takes them.

    flights : conditions [deg], [Pa], [J/kg] ..., all at the same times
    """
    return np.stack([condition_history(flight) for flight in flights])
