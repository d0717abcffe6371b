"""Control points packed for the compiled march: the one model, whether stepped beside a host or marched through a
flight.

A PointModel says what a control point is: construction, sensors, ratio table, parameters, effects. An Ensemble holds
many, of one flight or of many, in groups of LANES, and is all the state there is: a snapshot of it is a copy
of one array.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property
from itertools import groupby

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_heating.conditions import RATIO_VARIABLES, Conditions
from sim_heating.effects import Effect, EffectUse, check_count
from sim_heating.effects.chain import chain_of
from sim_heating.errors import InputError, RunError
from sim_heating.files import nearest
from sim_heating.heating_ratio.kernel import pack_table
from sim_heating.heating_ratio.table import RatioTable
from sim_heating.jit import handle
from sim_heating.layout import (
    BACK_NODE,
    COLUMN,
    CONDITION_COLUMNS,
    EFFECT_CODES,
    EFFECT_PARAMETERS,
    EFFECT_SLOTS,
    EFFECT_WIDTH,
    EMISSIVITY_TABLE,
    ENERGY_IN,
    ENERGY_OUT,
    ENTHALPY_TABLE,
    FAILED,
    HEAD_ROWS,
    IS_FACE,
    IS_INTERFACE,
    ITERATIONS,
    LAG_PAST,
    LAG_SLOT,
    LANES,
    M_RIGHT,
    MATERIAL_TABLE,
    N_ADDING,
    N_CONDITIONS,
    N_EFFECTS,
    N_EMITTING,
    N_NODES,
    N_PARAMETERS,
    N_PRESSURES,
    NEGATIVE,
    NO_TABLE,
    NODE_ROWS,
    NONE,
    OUTSIDE,
    PRESSURE_TABLE,
    RATIO_TABLE,
    REFERENCE,
    SURROUNDINGS4,
    WALL_EFFECTS,
    T,
    block_size,
    integers_size,
    node_integers,
    node_rows,
    scalar_row,
)
from sim_heating.march import BLOCK_END, BLOCK_START, INTS_END, INTS_START, advance_groups, begin_groups, march_group
from sim_heating.packing import set_point, set_temperatures
from sim_heating.parameters import AT_FACES, EFFECT_PREFIX, MODEL, RATIO, Parameter
from sim_heating.thermal.declare import BackFace, Construction, Material
from sim_heating.thermal.elements import BOILS, CONDENSES, DEPOSITED, LATENT_HEAT, WIDTH
from sim_heating.thermal.kernel import compiled
from sim_heating.thermal.mesh import Mesh
from sim_heating.thermal.tables import PointTables, TableStore, WallEnthalpy

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

CONTACT = Material(density_kg_m3=1.0, specific_heat_J_kgK=[[300.0, 1.0]], conductivity_W_mK=[[300.0, 1.0]])
"""What a contact resistance is made of: an element without mass whose "length" is the resistance."""
MODES = ("add", "multiply", "emittance")
"""Effects with a kernel, in the order in which they act."""
COATING_PREFIX = "stack.coating."
BACK = ("back.h_W_m2K", "back.T_K", "back.emissivity")
MOISTURE = (LATENT_HEAT, BOILS, DEPOSITED, CONDENSES, WIDTH)
RUNS_AWAY = "moisture gives off more heat as it condenses than takes to warm what it condenses in"
CONDENSES_WITHIN = 8.0
"""Widths about the temperature at which moisture condenses within which all of it does."""
PLACES = {name: k for k, name in enumerate(MODEL)}
"""Place of each parameter in PointModel.values."""
CACHE_LINE = 64
"""Bytes."""
THREADED_POINT_STEPS = 20_000
"""Below this many point-steps a march is not worth a second thread."""


def _unknown(point: str, name: str, known: Iterable[str]) -> str:
    near = nearest(name, known)
    return f"{point}: there is no parameter `{name}`." + (f" Nearest: `{near}`." if near else "")


@dataclass(frozen=True)
class PointModel:
    """One control point as the kernels take it.

    name          : for messages and columns
    construction  : stack and materials
    depths_m      : depths of the sensors; each gets a node
    ratio         : declared table, or None for ratio.d0 alone
    wall_enthalpy : constant cp [J/(kg K)] or the name of a gas model
    nodes         : number of nodes, or None to have it chosen
    parameters    : dotted name -> value, where not nominal (parameters.MODEL)
    reference     : values of the five ratio variables that derivatives are about
    effects       : effects with their parameters
    """

    name: str
    construction: Construction
    depths_m: tuple[float, ...] = ()
    ratio: RatioTable | None = None
    wall_enthalpy: WallEnthalpy = 1004.5
    nodes: int | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    reference: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    effects: tuple[EffectUse, ...] = ()

    def __post_init__(self) -> None:
        check_count(self.effects, self.name)
        for key, value in self.parameters.items():
            if key not in MODEL:
                raise InputError(_unknown(self.name, key, MODEL))
            if not MODEL[key].lower <= value <= MODEL[key].upper:
                lower, upper = MODEL[key].lower, MODEL[key].upper
                raise InputError(f"{self.name}, {key}: {value:g} is outside its bounds {lower:g} to {upper:g}")
        stack = self.construction.stack
        for depth in self.depths_m:
            if not stack.holds(depth):
                thickness = stack.thickness_m
                raise InputError(f"{self.name}: a sensor at {depth:g} m is outside the stack (0 to {thickness:g} m)")
        if not isinstance(self.wall_enthalpy, str) and not 0.0 < self.wall_enthalpy < np.inf:
            raise InputError(f"{self.name}, wall_enthalpy: cp {self.wall_enthalpy:g} J/(kg K) must be above 0")
        if sum(use.effect.lags for use in self.effects) > 1:
            raise InputError(f"{self.name}: two effects with a lag; one at most at one control point")
        if self.ratio is not None and self.parameters.get("ratio.d0", 0.0) != 0.0:
            raise InputError(f"{self.name}: ratio.d0 is 0 where there is a ratio table; use ratio.scale")
        if self.runs_away:
            raise InputError(f"{self.name}: {RUNS_AWAY}; lower its deposit_J_kg or raise its width_K")

    @property
    def runs_away(self) -> bool:
        """Whether moisture that condenses would give off more heat than takes to warm what it condenses in by as much
        as that makes it warmer: its temperature would jump."""
        stack = self.values[len(RATIO) :]
        latent, boil, deposit, condense, width = (float(stack[k]) for k in MOISTURE)
        if deposit <= 0.0:
            return False
        T = condense + width * np.linspace(-CONDENSES_WITHIN, CONDENSES_WITHIN, 81)
        up, down = (1.0 / (1.0 + np.exp(-np.clip((T - at) / width, -500.0, 500.0))) for at in (boil, condense))
        material = self.construction.layer_materials()[insulation_layer(self.construction)]
        warmed = np.interp(T, *np.array(material.specific_heat_J_kgK, dtype=float).T)
        return bool(np.any(warmed + (latent * up * (1.0 - up) - deposit * down * (1.0 - down)) / width <= 0.0))

    @cached_property
    def values(self) -> FloatArray:
        """Values of the parameters of parameters.MODEL, in their order."""
        values = np.array([self.parameters.get(name, p.value) for name, p in MODEL.items()], dtype=float)
        for name in BACK:
            if name not in self.parameters:
                values[PLACES[name]] = self._declared_back(name)
        for used in reversed(self.effects):
            for place, value in zip(used.effect.places, used.values, strict=False):
                if place in PLACES:
                    values[PLACES[place]] = value
        return values

    def value(self, name: str) -> float:
        """A parameter's value, nominal where it is not set; `effect.NAME.PARAMETER` as well."""
        if name.startswith(EFFECT_PREFIX):
            use, k = self._effect_place(name)
            return float(self.effects[use].values[k])
        return float(self.values[PLACES[name]])

    def _declared_back(self, name: str) -> float:
        back = self.construction.stack.back
        declared = getattr(back, name.removeprefix("back.")) if isinstance(back, BackFace) else None
        return float(MODEL[name].value if declared is None else declared)

    def definition(self, name: str) -> Parameter:
        """What a dotted name stands for in this model.

        raises : InputError with the nearest name where the model has no such parameter
        """
        if name.startswith(EFFECT_PREFIX):
            use, k = self._effect_place(name)
            return self.effects[use].effect.parameters[k]
        if name not in MODEL:
            raise InputError(_unknown(self.name, name, MODEL))
        if name.startswith(COATING_PREFIX) and insulation_layer(self.construction) == 0:
            raise InputError(f"{self.name}: `{name}`: a wall of one layer has no coating; its layer is `stack.rsi.*`")
        return MODEL[name]

    def at_faces(self, name: str) -> bool:
        """Whether a parameter changes what enters the wall from outside and nothing within it."""
        if name.startswith(EFFECT_PREFIX):
            use, k = self._effect_place(name)
            effect = self.effects[use].effect
            return effect.kernel is not None or effect.places[k] in AT_FACES
        return name in AT_FACES

    def _effect_place(self, name: str) -> tuple[int, int]:
        known = {
            f"{EFFECT_PREFIX}{use.effect.name}.{p.name}": (i, k)
            for i, use in enumerate(self.effects)
            for k, p in enumerate(use.effect.parameters)
        }
        if name not in known:
            raise InputError(_unknown(self.name, name, known))
        return known[name]

    def altered(self, values: Mapping[str, float]) -> PointModel:
        """The same point with parameters set by their dotted names, within their bounds or beyond: nothing is checked
        but the names."""
        parameters, effects = dict(self.parameters), [list(use.values) for use in self.effects]
        for name, value in values.items():
            if name.startswith(EFFECT_PREFIX):
                use, k = self._effect_place(name)
                effects[use][k] = value
            else:
                self.definition(name)
                parameters[name] = value
        other = copy.copy(self)
        used = tuple(EffectUse(u.effect, tuple(v)) for u, v in zip(self.effects, effects, strict=True))
        other.__dict__.pop("values", None)
        object.__setattr__(other, "parameters", parameters)
        object.__setattr__(other, "effects", used)
        return other


def condition_history(conditions: Conditions) -> FloatArray:
    """(time, condition) what the kernels read of a flight; columns that a flight may lack are 0."""
    columns = [conditions[c] if c in conditions else np.zeros(len(conditions)) for c in CONDITION_COLUMNS]
    return np.ascontiguousarray(np.column_stack(columns))


@dataclass(frozen=True)
class _Place:
    """Where a model stands: group, its lanes from `lane` to before `end`, and the first number of the group's block."""

    group: int
    lane: int
    end: int
    start: int

    def temperature(self, node: int) -> int:
        return self.start + (HEAD_ROWS + node * NODE_ROWS + T) * LANES + self.lane

    @property
    def node_0(self) -> int:
        """The first number of node 0."""
        return self.start + HEAD_ROWS * LANES + self.lane

    def scalar(self, row: int) -> int:
        return self.start + row * LANES + self.lane


class Ensemble:
    """Control points in lanes, with their temperatures.

    models : the control points; results keep their order
    meshes : the mesh of each (resolution.pack chooses them)
    step_s : the longest time step [s] that a march takes
    beside : an ensemble of points with the same tables and effects, whose tables this one shares
    kinds   : (point,) numbers; points of different ones share no group, those of the lowest come first

    Attributes: `meshes`, `table` with all property and ratio tables, and `state`, which holds everything that changes.
    """

    def __init__(
        self,
        models: Sequence[PointModel],
        meshes: Sequence[Mesh],
        step_s: float = 1.0,
        beside: Ensemble | None = None,
        kinds: Sequence[int] | None = None,
    ) -> None:
        if not models:
            raise InputError("there is no control point; give at least one")
        self.models = list(models)
        self.step_s = step_s
        self.meshes = tuple(meshes)
        self._effects = _distinct_effects(self.models)
        self._chain = chain_of(self._effects)
        self.chain = self._chain.handle
        self._codes = dict(zip(self._effects, self._chain.codes, strict=True))
        self.begin_handle, self.advance_handle = (handle(f) for f in compiled())
        self._tables: TableStore = TableStore() if beside is None else beside._tables
        self._arrange([0] * len(self.models) if kinds is None else kinds)
        self.table = self._tables.values
        self.reset()

    # Packing ---------------------------------------------------------------------------------------------------------

    def point_tables(self, model: PointModel) -> PointTables:
        """Where the property tables of a point stand in `table`."""
        return self._tables.add_point(model.construction.layer_materials(), CONTACT, model.wall_enthalpy)

    def _add_ratio_table(self, table: RatioTable | None) -> int:
        return NO_TABLE if table is None else self._tables.place(("ratio", id(table)), lambda: pack_table(table))

    def _arrange(self, kinds: Sequence[int]) -> None:
        """Put models of one kind and like node counts into groups of LANES; the last one of a group fills it up."""
        order = sorted(range(len(self.models)), key=lambda i: (kinds[i], -self.meshes[i].nodes, i))
        alike = [list(group) for _, group in groupby(order, key=lambda i: kinds[i])]
        members = [group[k : k + LANES] for group in alike for k in range(0, len(group), LANES)]
        nodes = [self.meshes[group[0]].nodes for group in members]
        blocks = np.concatenate(([0], np.cumsum([block_size(n) for n in nodes])))
        integers = np.concatenate(([0], np.cumsum([integers_size(n) for n in nodes])))
        self.groups = np.column_stack([blocks[:-1], blocks[1:], integers[:-1], integers[1:]]).astype(np.int64)
        self.state = aligned_zeros(int(blocks[-1]))
        self.ints = np.zeros(integers[-1], dtype=np.int64)
        self.lanes = np.array([group + [group[-1]] * (LANES - len(group)) for group in members]).ravel()
        self.places = [_Place(0, 0, 0, 0)] * len(self.models)
        self._densities = [
            element_densities(m.construction, mesh) for m, mesh in zip(self.models, self.meshes, strict=True)
        ]
        for g, group in enumerate(members):
            for lane, i in enumerate(group):
                end = LANES if i == group[-1] else lane + 1
                self.places[i] = _Place(g, lane, end, int(blocks[g]))
            self._pack_group(g)

    def block(self, group: int) -> FloatArray:
        """The numbers of a group (a view)."""
        return self.state[self.groups[group, BLOCK_START] : self.groups[group, BLOCK_END]]

    def integers(self, group: int) -> IntArray:
        """The integers of a group (a view)."""
        return self.ints[self.groups[group, INTS_START] : self.groups[group, INTS_END]]

    def _pack_group(self, g: int) -> None:
        J = self.integers(g)
        members = list(dict.fromkeys(self.lanes[g * LANES : (g + 1) * LANES]))
        J[N_NODES] = self.meshes[members[0]].nodes
        for i in members:
            self._pack_stack(i)
            self._pack_heating(i)
        nodes = node_integers(J)
        materials = nodes[:, MATERIAL_TABLE:]
        nodes[1:-1, IS_INTERFACE] = np.any(materials[1:-1] != materials[:-2], axis=1)
        for i in members:
            self.set_model(i, self.models[i])

    def _pack_stack(self, i: int) -> None:
        """What of the stack of a point does not change with its parameters."""
        model, mesh, place = self.models[i], self.meshes[i], self.places[i]
        B, J, lanes = self.block(place.group), self.integers(place.group), slice(place.lane, place.end)
        tables = self.point_tables(model)
        nodes = node_integers(J)
        materials = np.array(tables.materials)[mesh.layer]
        nodes[:, MATERIAL_TABLE:][: len(materials), lanes] = materials[:, np.newaxis]
        nodes[:, MATERIAL_TABLE:][len(materials) :, lanes] = materials[-1]
        nodes[[0, mesh.nodes - 1], IS_FACE] = 1
        node_rows(B)[mesh.nodes :, M_RIGHT, lanes] = 1.0
        B[scalar_row(SURROUNDINGS4)][lanes] = model.construction.stack.surroundings_K**4
        for row, value in (
            (BACK_NODE, mesh.nodes - 1), (N_PRESSURES, tables.columns), (PRESSURE_TABLE, tables.pressures),
            (EMISSIVITY_TABLE, tables.emissivity), (ENTHALPY_TABLE, tables.enthalpy),
        ):  # fmt: skip
            J[row + place.lane : row + place.end] = value

    def _pack_heating(self, i: int) -> None:
        """What of the heating of a point does not change with its parameters."""
        place, uses = self.places[i], acting(self.models[i])
        J = self.integers(place.group)
        modes = [u.effect.mode for u in uses]
        lagging = [k for k, u in enumerate(uses) if u.effect.lags]
        for row, value in (
            (RATIO_TABLE, self._add_ratio_table(self.models[i].ratio)), (N_ADDING, modes.count("add")),
            (N_EMITTING, modes.count("emittance")), (N_EFFECTS, len(uses) - modes.count("emittance")),
            (WALL_EFFECTS, any(u.effect.needs_wall and u.effect.mode != "emittance" for u in uses)),
            (LAG_SLOT, lagging[0] if lagging else NONE),
        ):  # fmt: skip
            J[row + place.lane : row + place.end] = value
        for lane in range(place.lane, place.end):
            for k, used in enumerate(uses):
                J[EFFECT_CODES + lane * EFFECT_SLOTS + k] = self._codes[used.effect]

    def set_model(self, model: int, altered: PointModel) -> None:
        """Give a point other parameters: `altered` is its present model but for their values (PointModel.altered).

        A march then begins with `reset` or `set_profile`.
        """
        place, mesh = self.places[model], self.meshes[model]
        self.models[model] = altered
        set_point(
            self.block(place.group), self.integers(place.group), place.lane, place.end, mesh.layer, mesh.length_m,
            self._densities[model], insulation_layer(altered.construction), mesh.bondline,
            stack_values(altered), heating_vector(altered),
        )  # fmt: skip

    # State -----------------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Put every point back to the initial temperatures of its stack."""
        self.clear()
        for i, (model, mesh) in enumerate(zip(self.models, self.meshes, strict=True)):
            self._set_profile(i, initial_temperatures(model.construction, mesh))

    def clear(self) -> None:
        """Set to zero what is counted over a march."""
        for g in range(len(self.groups)):
            B = self.block(g)
            for row in (FAILED, ITERATIONS, OUTSIDE, NEGATIVE, ENERGY_IN, ENERGY_OUT, LAG_PAST):
                B[scalar_row(row)] = 0.0
            B[scalar_row(COLUMN)] = -1.0

    def _set_profile(self, i: int, temperature_K: FloatArray) -> None:
        place = self.places[i]
        B, J = self.block(place.group), self.integers(place.group)
        set_temperatures(B, place.lane, place.end, J[N_NODES], temperature_K)

    def set_profile(self, model: int, temperature_K: ArrayLike) -> None:
        """Set all node temperatures [K] of one point; the next march begins with them, a step needs `begin` first."""
        temperature = np.ascontiguousarray(temperature_K, dtype=float)
        if temperature.shape != (self.meshes[model].nodes,) or not np.all((temperature > 0.0) & (temperature < np.inf)):
            raise InputError(f"{self.models[model].name}: give {self.meshes[model].nodes} temperatures above 0 K")
        self._set_profile(model, temperature)

    def snapshot(self) -> FloatArray:
        """Everything that changes, as one array; `restore` takes it back."""
        return self.state.copy()

    def restore(self, snapshot: FloatArray) -> None:
        """Go back to a snapshot of this ensemble."""
        if snapshot.shape != self.state.shape:
            raise InputError(
                f"snapshot: {snapshot.size} numbers, this model has {self.state.size}; it is of another model"
            )
        self.state[:] = snapshot

    # Reading ---------------------------------------------------------------------------------------------------------

    def node_temperatures(self, model: int) -> FloatArray:
        """(node,) temperatures of a point [K], outermost first."""
        place = self.places[model]
        nodes = node_rows(self.block(place.group))
        return nodes[: self.meshes[model].nodes, T, place.lane].copy()

    def outputs(self) -> IntArray:
        """Places in `state` of surface, bondline and each sensor of each point, in this order."""
        at = []
        for mesh, place in zip(self.meshes, self.places, strict=True):
            at += [place.temperature(node) for node in (0, mesh.bondline, *mesh.sensors)]
        return np.array(at, dtype=np.int64)

    def scalars(self, row: int) -> FloatArray:
        """(point,) one scalar row of the block, such as layout.ENERGY_IN."""
        return np.array([self.state[place.scalar(row)] for place in self.places])

    # Moving ----------------------------------------------------------------------------------------------------------

    def spread(self, vectors: FloatArray) -> FloatArray:
        """(group * LANES, condition) from one condition vector a point."""
        return vectors[self.lanes]

    def begin(self, now: FloatArray) -> None:
        """Set the conditions that hold now, one vector (layout.CONDITION_COLUMNS) a point."""
        vectors = self.spread(now)
        begin_groups(self.state, self.ints, self.table, self.chain, self.begin_handle, self.groups, vectors)

    def advance(self, then: FloatArray, dt: float) -> None:
        """One frame of dt [s] to new conditions, linear between, in one step.

        raises : InputError where dt is not above 0; `check` says whether the step converged
        """
        if not 0.0 < dt < np.inf:
            raise InputError(f"advance: dt is {dt:g} s; it must be above 0")
        vectors = self.spread(then)
        advance_groups(self.state, self.ints, self.table, self.chain, self.advance_handle, self.groups, vectors, dt, 1)

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

        time_s    : (time,) samples [s], common to all flights
        histories : (flight, time, condition) as condition_history gives them
        which     : flight of each point; by default the flights are one for each point, or one for all
        keep      : places in `state` to keep at each sample, `outputs()` by default; an empty array keeps nothing
        returns   : (time, kept)
        raises    : InputError for times or histories that are not of this form or hold values that are no numbers;
                    RunError where the step of a point did not converge
        """
        if which is None:
            which = [0] * len(self.models) if len(histories) == 1 else list(range(len(self.models)))
        self._check_march(time_s, histories, which, longest_step_s)
        kept = self.outputs() if keep is None else keep
        out = np.empty((len(time_s), len(kept)) if len(kept) else (0, 0))
        flights = np.asarray(which, dtype=np.int64)[self.lanes].reshape(-1, LANES)
        step = self.step_s if longest_step_s is None else longest_step_s
        time_s, histories = np.ascontiguousarray(time_s, dtype=float), np.ascontiguousarray(histories, dtype=float)

        def one(g: int) -> None:
            start, end = self.groups[g, BLOCK_START], self.groups[g, BLOCK_END]
            mine = np.flatnonzero((kept >= start) & (kept < end))
            part = np.empty((len(out), len(mine)))
            march_group(
                self.block(g), self.integers(g), self.table, self.chain, self.begin_handle, self.advance_handle,
                time_s, histories, flights[g], step, kept[mine] - start, part,
            )  # fmt: skip
            if len(out):
                out[:, mine] = part

        groups = range(len(self.groups))
        if len(groups) > 1 and len(time_s) * len(self.models) > THREADED_POINT_STEPS:
            with ThreadPoolExecutor(min(len(groups), os.cpu_count() or 1)) as pool:
                list(pool.map(one, groups))
        else:
            for g in groups:
                one(g)
        self.check()
        return out

    def _check_march(
        self, time_s: FloatArray, histories: FloatArray, which: Sequence[int], longest_step_s: float | None
    ) -> None:
        shape = np.shape(histories)
        if np.ndim(time_s) != 1 or len(shape) != 3 or shape[1:] != (len(time_s), N_CONDITIONS):
            wanted = f"(flight, {len(time_s)} times, {N_CONDITIONS} conditions)"
            raise InputError(f"march: histories are {shape}; they must be {wanted}")
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
        """(point,) whose step did not converge, whose temperature is not a number, or whose moisture runs away."""
        surface = np.array([self.state[place.temperature(0)] for place in self.places])
        away = np.array([model.runs_away for model in self.models])
        return np.asarray((self.scalars(FAILED) > 0.0) | ~np.isfinite(surface) | away)

    def check(self) -> None:
        """raises : RunError naming the points that failed."""
        away = [model.name for model in self.models if model.runs_away]
        if away:
            raise RunError(f"{', '.join(away)}: {RUNS_AWAY}")
        bad = [model.name for model, failed in zip(self.models, self.failed(), strict=True) if failed]
        if bad:
            raise RunError(f"{', '.join(bad)}: the thermal step did not converge; try a smaller longest_step_s")


def aligned_zeros(count: int) -> FloatArray:
    """Zeros that begin on a cache line: where every second vector load splits a line, a step takes a fifth longer."""
    memory = np.zeros(count + CACHE_LINE // 8)
    first = (-memory.ctypes.data % CACHE_LINE) // 8
    return memory[first : first + count]


def _distinct_effects(models: Iterable[PointModel]) -> tuple[Effect, ...]:
    return tuple(dict.fromkeys(u.effect for m in models for u in m.effects if u.effect.kernel))


def element_densities(construction: Construction, mesh: Mesh) -> FloatArray:
    """(element,) density [kg/m3]; a contact has none."""
    return np.array([*(m.density_kg_m3 for m in construction.layer_materials()), 0.0])[mesh.layer]


def acting(model: PointModel) -> list[EffectUse]:
    """The effects of a point that have a kernel, in the order of their slots; the others stand for parameters."""
    return sorted((u for u in model.effects if u.effect.kernel), key=lambda u: MODES.index(u.effect.mode))


def heating_vector(model: PointModel) -> FloatArray:
    """(N_PARAMETERS,) the heating parameters of a point as its lane has them (layout.py)."""
    vector = np.zeros(N_PARAMETERS)
    vector[: len(RATIO)] = model.values[: len(RATIO)]
    vector[REFERENCE : REFERENCE + len(RATIO_VARIABLES)] = model.reference
    for k, used in enumerate(acting(model)):
        first = EFFECT_PARAMETERS + k * EFFECT_WIDTH
        vector[first : first + len(used.values)] = used.values
    return vector


def stack_values(model: PointModel) -> FloatArray:
    """Values of parameters.STACK."""
    return model.values[len(RATIO) :]


def insulation_layer(construction: Construction) -> int:
    """Number of the layer that `stack.rsi.*` is about: the second, behind a coating; of one layer, that one."""
    return min(1, len(construction.stack.layer) - 1)


def initial_temperatures(construction: Construction, mesh: Mesh) -> FloatArray:
    """(node,) initial temperatures [K] as the stack declares them, a profile linear between its points."""
    stack = construction.stack
    if stack.initial_profile is not None:
        x, temperature = np.array(stack.initial_profile).T
        return np.interp(mesh.depth_m, x, temperature)
    return np.full(mesh.nodes, float(stack.initial_K or 0.0))
