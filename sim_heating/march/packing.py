"""Models of control points written into the lanes of an ensemble: their tables, effects and parameter values.

Source: docs/theory/equations_thermal_step.md, equation 8.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.kernels import block
from sim_heating.base.kernels.block import LANES
from sim_heating.heating.effects import Effect
from sim_heating.heating.effects.compiled import effect_dispatcher
from sim_heating.heating.effects.transition import TRANSITION
from sim_heating.heating.ratio.lookup import pack_table
from sim_heating.march.lanes import LaneMemory
from sim_heating.march.point import PointModel, elements_of, heating_vector, kernel_effects, stack_values
from sim_heating.thermal.elements import Elements, set_lanes, set_point
from sim_heating.thermal.faces import SIGMA
from sim_heating.thermal.mesh import Mesh
from sim_heating.thermal.stack import BackFace, Material
from sim_heating.thermal.tables import TableStore

CONTACT = Material(density_kg_m3=1.0, specific_heat_J_kgK=[[300.0, 1.0]], conductivity_W_mK=[[300.0, 1.0]])
"""Material of a contact resistance: an element without mass, of conductivity 1, whose "length" is the resistance."""


class PointLanes(NamedTuple):
    """Lanes of points of one wall: (point, 5) where the block of its group and the integers of that begin and end, and
    the number of the lane in it; elements of the wall."""

    positions: IntArray
    elements: Elements


class PointWriter:
    """Writes control points into the lanes of an ensemble.

    models, meshes : of the points;  memory : their lanes
    tables         : property and ratio tables, which those of the points are added to
    tolerance_K    : largest error of a time step at any node [K]
    """

    def __init__(
        self,
        models: Sequence[PointModel],
        meshes: Sequence[Mesh],
        memory: LaneMemory,
        tables: TableStore,
        tolerance_K: float,
    ) -> None:
        self.memory, self.tables = memory, tables
        distinct = _distinct_effects(models)
        self.dispatcher = effect_dispatcher(distinct)
        self._codes = dict(zip(distinct, self.dispatcher.codes, strict=True))
        by_wall: dict[tuple[int, int], Elements] = {}
        for m, mesh in zip(models, meshes, strict=True):
            # most lanes of a march with sensitivities are of one wall
            if (id(m.construction), id(mesh)) not in by_wall:
                by_wall[id(m.construction), id(mesh)] = elements_of(m.construction, mesh)
        self._elements = [by_wall[id(m.construction), id(mesh)] for m, mesh in zip(models, meshes, strict=True)]
        for g in range(len(memory.groups)):
            memory.block(g)[block.scalar_row(block.TOLERANCE)] = tolerance_K
            members = list(dict.fromkeys(memory.lanes[g * LANES : (g + 1) * LANES]))
            for i in members:
                self._write_stack(i, models[i], meshes[i])
                self._write_heating(i, models[i])
            nodes = block.node_integers(memory.integers(g))
            materials = nodes[:, block.MATERIAL_TABLE :]
            nodes[1:-1, block.IS_INTERFACE] = np.any(materials[1:-1] != materials[:-2], axis=1)
            # Interfaces are flags of the group, known once all its stacks are written; parameters come after them.
            for i in members:
                self.set_values(i, stack_values(models[i]), heating_vector(models[i]))

    def _write_stack(self, i: int, model: PointModel, mesh: Mesh) -> None:
        """Write the part of a point's stack that does not depend on its parameters."""
        offsets = self.memory.offsets[i]
        B, J, lanes = (
            self.memory.block(offsets.group),
            self.memory.integers(offsets.group),
            slice(offsets.lane, offsets.end),
        )
        tables = self.tables.add_point(model.construction.layer_materials(), CONTACT, model.wall_enthalpy)
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
            (block.BACK_NODE, mesh.nodes - 1),
            (block.N_PRESSURES, tables.columns),
            (block.PRESSURE_TABLE, tables.pressures),
            (block.EMISSIVITY_TABLE, tables.emissivity),
            (block.ENTHALPY_TABLE, tables.enthalpy),
        ):
            J[row + offsets.lane : row + offsets.end] = value

    def _write_heating(self, i: int, model: PointModel) -> None:
        """Write the part of a point's heating that does not depend on its parameters."""
        offsets, uses, ratio = self.memory.offsets[i], kernel_effects(model), model.ratio
        J = self.memory.integers(offsets.group)
        modes = [u.effect.mode for u in uses]
        lagging = _slot(u.effect.lags for u in uses)
        turning = _slot(u.effect.name == TRANSITION for u in uses)
        on_ratio = len(uses) - modes.count("emittance")
        table = block.NO_TABLE if ratio is None else self.tables.place(("ratio", id(ratio)), lambda: pack_table(ratio))
        for row, value in (
            (block.RATIO_TABLE, table),
            (block.N_ADDING, modes.count("add")),
            (block.N_EMITTING, modes.count("emittance")),
            (block.N_EFFECTS, on_ratio),
            (block.FIRST_AT_WALL, _first_at_wall([u.effect for u in uses[:on_ratio]])),
            (block.LAG_SLOT, lagging),
            (block.TRANSITION_SLOT, turning),
        ):
            J[row + offsets.lane : row + offsets.end] = value
        for lane in range(offsets.lane, offsets.end):
            for k, used in enumerate(uses):
                J[block.EFFECT_CODES + lane * block.EFFECT_SLOTS + k] = self._codes[used.effect]

    def set_values(self, model: int, stack: FloatArray, heating: FloatArray) -> None:
        """Set new parameter values of a point as its lane takes them; the models of its ensemble are left as they are.

        model   : index of the point
        stack   : (parameter,) as march.point.stack_values, each in its unit ([-], [J/kg], [K] ...)
        heating : (N_PARAMETERS,) as march.point.heating_vector

        A march then begins with `reset`, `restore` or `set_profile`. Source: docs/theory/equations_thermal_step.md,
        eq. 8.
        """
        offsets, elements = self.memory.offsets[model], self._elements[model]
        B, J = self.memory.block(offsets.group), self.memory.integers(offsets.group)
        set_point(B, J, offsets.lane, offsets.end, elements, stack, heating)

    def lanes_of(self, models: Sequence[int]) -> PointLanes:
        """Lanes of points of one wall, as `write_lanes` takes them."""
        positions = [(*self.memory.groups[self.memory.offsets[i].group], self.memory.offsets[i].lane) for i in models]
        return PointLanes(np.array(positions, dtype=np.int64), self._elements[models[0]])

    def write_lanes(self, state: FloatArray, lanes: PointLanes, stack: FloatArray, heating: FloatArray) -> None:
        """Write parameter values of points of one wall into their own lanes of a state of this ensemble, or of a copy.

        state : (number,) as `state`, changed;  lanes : as of `lanes_of`
        stack, heating : (point, parameter), (point, N_PARAMETERS), each row as for `set_values` ([-], [K] ...)

        Lanes that fill a group keep theirs, so that a march may go on: heat contents of the lanes themselves are to be
        evaluated again before the next step, and nobody would do so for those. Source:
        docs/theory/equations_thermal_step.md, eq. 8.
        """
        set_lanes(state, self.memory.ints, lanes.positions, lanes.elements, stack, heating)


def _first_at_wall(on_ratio: Sequence[Effect]) -> int:
    """First of the effects on a ratio, in their order, that are evaluated again at each wall temperature."""
    # What follows an effect that adds passes through the lag and every factor: all are evaluated again.
    if any(effect.needs_wall and effect.mode == "add" for effect in on_ratio):
        return 0
    return next((k for k, effect in enumerate(on_ratio) if effect.needs_wall), len(on_ratio))


def _distinct_effects(models: Iterable[PointModel]) -> tuple[Effect, ...]:
    return tuple(dict.fromkeys(u.effect for m in models for u in m.effects if u.effect.kernel))


def _slot(flags: Iterable[bool]) -> int:
    """Slot of the first effect of which something holds, NONE without one."""
    return next((k for k, flag in enumerate(flags) if flag), block.NONE)
