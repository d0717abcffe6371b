"""Control points packed for the compiled march: one model, whether stepped by a host or marched through a flight.

An Ensemble holds many points, of one flight or of many, in groups of LANES. It contains the whole state: a snapshot of
it is a copy of one array.

Source: docs/theory/equations_march.md, equations 1 to 3.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.kernels import block
from sim_heating.base.kernels.block import CONDITION_COLUMNS, LANES, N_CONDITIONS
from sim_heating.base.kernels.jit import address_of
from sim_heating.base.parallel.threads import in_threads
from sim_heating.heating.effects.compiled import unusable_value
from sim_heating.march import frames
from sim_heating.march.counters import Counters
from sim_heating.march.lanes import LaneMemory
from sim_heating.march.packing import PointWriter
from sim_heating.march.point import MOISTURE_RUNAWAY, PointModel, heating_vector, initial_temperatures, stack_values
from sim_heating.thermal.frame import STEP_TOLERANCE_K, compiled
from sim_heating.thermal.mesh import Mesh
from sim_heating.thermal.step import LaneGroup
from sim_heating.thermal.tables import TableStore

ABSENT = {"turbulent_ratio": 1.0}
"""Values of columns that a flight may lack, where not 0."""
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

    Attributes: `memory` of the lanes, whose `state` holds everything that changes; `writer` of parameters into them;
    `counters` since the last reset; `table` with all property and ratio tables.
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
        self.models, self.meshes = list(models), tuple(meshes)
        self.step_s, self.tolerance_K = step_s, tolerance_K
        nodes = [mesh.nodes for mesh in self.meshes]
        memory = LaneMemory(nodes, [0] * len(nodes) if kinds is None else kinds, behind or {})
        tables = TableStore() if share_tables_with is None else share_tables_with.writer.tables
        self.memory, self.counters = memory, Counters(memory)
        self.writer: PointWriter = PointWriter(self.models, self.meshes, memory, tables, tolerance_K)
        self.groups, self.lanes, self.lane_offsets = memory.groups, memory.lanes, memory.offsets
        self.state, self.ints, self.table = memory.state, memory.ints, tables.values
        # Addresses and not functions: kernels that call them need no recompiling when effects change.
        self.dispatcher, self.advance_address = self.writer.dispatcher.address, address_of(compiled())
        self.reset()

    def lane_group(self, group: int) -> LaneGroup:
        """A lane group as compiled time loops take it: views of its block and integers, tables and addresses."""
        numbers, integers = self.memory.block(group), self.memory.integers(group)
        return LaneGroup(numbers, integers, self.table, self.dispatcher, self.advance_address)

    @cached_property
    def lane_groups(self) -> frames.LaneGroups:
        """All lane groups as compiled time loops take them."""
        return frames.LaneGroups(self.state, self.ints, self.table, self.dispatcher, self.advance_address, self.groups)

    def set_model(self, model: int, changed: PointModel) -> None:
        """Give a point new parameter values.

        model   : index of the point
        changed : its present model with other values (PointModel.with_parameters); stack, mesh, tables and effects must
                  be the same

        A march then begins with `reset` or `set_profile`: until then heat contents [J/m2] are those of the earlier
        parameters, which the step would take for its start (docs/theory/equations_march.md, equation 6).
        """
        self.models[model] = changed
        self.writer.set_values(model, stack_values(changed), heating_vector(changed))

    def reset(self) -> None:
        """Set every point to the initial temperatures of its stack [K] and clear all counters.

        Source: docs/theory/equations_march.md, equation 23.
        """
        self.counters.clear()
        for i, (model, mesh) in enumerate(zip(self.models, self.meshes, strict=True)):
            self.memory.set_temperatures(i, initial_temperatures(model.construction, mesh))

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
        self.memory.set_temperatures(model, temperature)

    def snapshot(self) -> FloatArray:
        """Copy of everything that changes (temperatures [K], conditions, counters), as one array; `restore` accepts
        it."""
        return self.state.copy()

    def restore(self, snapshot: FloatArray) -> None:
        """Return to the temperatures [K], conditions and counters of a snapshot of this ensemble, bit for bit.

        snapshot : (number,) as `snapshot` gave it
        raises   : InputError where its size is that of another model
        """
        if snapshot.shape != self.state.shape:
            raise InputError(
                f"snapshot: {snapshot.size} numbers, this model has {self.state.size}; it is of another model"
            )
        self.state[:] = snapshot

    def node_temperatures(self, model: int) -> FloatArray:
        """(node,) present temperatures of a point [K], outermost first, without the padding of its group.

        model : number of the point
        """
        offsets = self.lane_offsets[model]
        nodes = block.node_rows(self.memory.block(offsets.group))
        return nodes[: self.meshes[model].nodes, block.T, offsets.lane].copy()

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

    def begin(self, now: FloatArray) -> None:
        """Set the conditions at the present time.

        now : (point, condition) in the units of the condition columns ([deg], [Pa], [J/kg] ...)

        Needed before the first step, and after temperatures or parameters were changed. Source:
        docs/theory/equations_march.md, section 1.
        """
        vectors = now[self.lanes]
        frames.begin_groups(*self.lane_groups, vectors)

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
        vectors = then[self.lanes]
        frames.advance_groups(*self.lane_groups, vectors, dt, 1)

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
            start, end = self.groups[g, frames.BLOCK_START], self.groups[g, frames.BLOCK_END]
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
        self.check_effects(time_s, histories, which)
        self.check()
        return out

    def march_lanes(
        self,
        group: int,
        time_s: FloatArray,
        histories: FloatArray,
        flights: IntArray,
        longest_step_s: float,
        kept: IntArray,
    ) -> FloatArray:
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
        flown = frames.Flights(time_s, histories, flights)
        frames.march_group(
            self.lane_group(group), flown, longest_step_s, kept - self.groups[group, frames.BLOCK_START], out
        )
        return out

    def _check_march(
        self, time_s: FloatArray, histories: FloatArray, which: Sequence[int], longest_step_s: float | None
    ) -> None:
        if not _is_clock(time_s):
            raise InputError("march: time_s must be finite and increase from sample to sample")
        shape = np.shape(histories)
        if len(shape) != 3 or shape[1:] != (len(time_s), N_CONDITIONS):
            expected = f"(flight, {len(time_s)} times, {N_CONDITIONS} conditions)"
            raise InputError(f"march: histories are {shape}; they must be {expected}")
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
        return np.asarray((self.counters.failures > 0.0) | ~np.isfinite(surface) | away)

    def check_effects(self, time_s: FloatArray, histories: FloatArray, which: Sequence[int]) -> None:
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


def _is_clock(time_s: FloatArray) -> bool:
    """Whether times are a row of finite ones that increase, one at least."""
    return (
        np.ndim(time_s) == 1 and len(time_s) > 0 and bool(np.all(np.isfinite(time_s)) and np.all(np.diff(time_s) > 0.0))
    )


def histories(flights: Sequence[Conditions]) -> FloatArray:
    """(flight, time, condition) conditions of several flights, as `Ensemble.march` takes them.

    flights : conditions [deg], [Pa], [J/kg] ..., all at the same times

    Source: docs/theory/equations_march.md, equation 1.
    """
    return np.stack([condition_history(flight) for flight in flights])
