"""A vehicle's control points as the image of an FMU: the arrays of the heating plug-in and their variables."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim_heating.base.conditions import FRAME, RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.base.files.text import suggestion
from sim_heating.base.kernels import block
from sim_heating.base.kernels.block import LANES
from sim_heating.base.kernels.compiler import CACHE
from sim_heating.base.kernels.jit import STEP_SIGNATURE, c_function
from sim_heating.base.limits import LIMITS
from sim_heating.base.parameters import RATIO, SENSOR, STACK, STACK_PREFIX, UNITS, Parameter
from sim_heating.heating.atmosphere import us76
from sim_heating.heating.edge_flow import TURBULENT_AT
from sim_heating.heating.effects import Effect, EffectUse, effects
from sim_heating.heating.effects.compiled import (
    KERNEL,
    SIGNATURE,
    compiled_kernel,
    effect_context,
    indexed_dispatcher,
    kernel_file,
)
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.reference.models import COLUMNS, recovery_name
from sim_heating.inputs.sensor_model import calibration_coefficients
from sim_heating.inputs.vehicle import ControlPoint, Vehicle, walls_upstream
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.point import PointModel, elements_of, kernel_effects, stack_values
from sim_heating.simulation.fmu_export import heating_kernel as k
from sim_heating.simulation.fmu_export.parts import library
from sim_heating.simulation.fmu_export.parts.image import Image, Kind, Problem, Role, SampledMap, Variable, identifier
from sim_heating.simulation.fmu_export.parts.library import MODEL_SIGNATURE, TARGETS, TIMING, CompilationUnit, Target
from sim_heating.simulation.fmu_export.parts.packer import ImagePacker, Input
from sim_heating.simulation.plugin import HeatingPlugin
from sim_heating.simulation.plugin_kernel import BY_ALTITUDE, CODE, FLOW_AT, SWEEP
from sim_heating.thermal.frame import compiled
from sim_heating.thermal.mesh import Mesh

START_ALTITUDE_M = 122e3
INPUT_STARTS = {"altitude_m": START_ALTITUDE_M, "velocity_m_s": 7600.0, "alpha_deg": 40.0}
"""Inputs before a host sets them: the entry interface; the density is that of the standard atmosphere."""
INPUT_TEXTS = {
    "altitude_m": ("m", 1e5, "geometric altitude"),
    "velocity_m_s": ("m/s", 7000.0, "speed relative to the air"),
    "alpha_deg": ("deg", 40.0, "angle of attack"),
    "beta_deg": ("deg", 1.0, "sideslip angle"),
    "elevon_deg": ("deg", 5.0, "elevon deflection, positive down"),
    "bodyflap_deg": ("deg", 10.0, "body-flap deflection, positive down"),
    "rho_kg_m3": ("kg/m3", 1e-4, "density of the air"),
    "jets": ("1", 1.0, "share of the reaction jets that fire"),
    "q_add_W_m2": ("W/m2", 1e4, "known additional flux absorbed by every surface"),
    "T_surroundings_K": ("K", 300.0, "temperature that surfaces radiate to; 0: as the vehicle declares"),
    "h_ref_kg_m2_s": ("kg/(m2 s)", 0.05, "reference film coefficient, taken as given: the host bridges thin air"),
    "H_r_J_kg": ("J/kg", 2e7, "total enthalpy; a point with a declared edge recovers less of it"),
}
"""Unit, nominal value and meaning of each input."""
TIMINGS = (
    (
        "held",
        "inputs are values at the start of a step, held over it unless the host gives derivatives or later values",
    ),
    ("reached", "inputs are values at the end of a step, reached along a straight line from the last ones"),
)
OUTPUTS = (
    ("surface_K", "K", 0.0, 1000.0, "surface temperature"),
    ("bondline_K", "K", 0.0, 400.0, "temperature at the outer face of the last layer"),
    ("heating.ratio", "1", -np.inf, 1.0, "heating ratio with all corrections and effects; 0 where h_ref is 0"),
    (
        "heating.convected_W_m2",
        "W/m2",
        -np.inf,
        1e5,
        "convective flux to the surface at the wall's temperature",
    ),
    ("heating.radiated_W_m2", "W/m2", -np.inf, 1e5, "net flux that the surface radiates"),
    ("heating.absorbed_W_m2", "W/m2", -np.inf, 1e4, "flux absorbed by the wall"),
    ("limit.surface_margin_K", "K", -np.inf, 100.0, "limit of the surface less its temperature"),
    ("limit.bondline_margin_K", "K", -np.inf, 100.0, "limit of the bondline less its temperature"),
)
"""Outputs of each control point, in the order of the kernel: name, unit, least and nominal value, meaning."""
REYNOLDS = RATIO_VARIABLES[2]
"""The variable of a ratio table that no host gives."""
TABLE_TEXT = (
    "heating ratio before corrections and effects: multilinear between the nodes, that of the nearest edge outside them"
)
NO_LIMIT_K = 1e5
"""Stands for a limit that is not declared [K]."""


@dataclass(frozen=True)
class HeatingModel:
    """The image of a vehicle's heating, and the effects compiled into its library."""

    image: Image
    effects: tuple[Effect, ...]


def heating_image(
    vehicle: Vehicle,
    control_points: Sequence[str] | None = None,
    *,
    columns: bool = False,
    nodes: int | None = None,
    input_timing: str = "held",
) -> HeatingModel:
    """The heating plug-in of a vehicle as an image.

    control_points : names; all by default
    columns        : h_ref and H_r are inputs, instead of the vehicle's reference heating
    nodes          : as in HeatingPlugin
    input_timing   : start value of the variable of this name, one of TIMINGS
    raises         : InputError for an unknown name
    """
    known_timings = [name for name, _ in TIMINGS]
    if input_timing not in known_timings:
        raise InputError(f"fmu: input_timing = `{input_timing}`{suggestion(input_timing, known_timings)}")
    # Walls upstream of an interface are points of the FMU as well.
    names = list(vehicle.control_points) if control_points is None else list(control_points)
    upstream = {p.name: p for p in walls_upstream(vehicle, [vehicle.control_point(name) for name in names])}
    vehicle, names = replace(vehicle, control_points=vehicle.control_points | upstream), [*names, *upstream]
    plugin = HeatingPlugin(vehicle, names, nodes=nodes)
    known = _library_effects(plugin.ensemble.models)
    image = Image(f"{identifier(vehicle.name)}_heating", f"Heating of {vehicle.title}", 1.0)
    _HeatingPacker(image, vehicle, plugin, known, columns, known_timings.index(input_timing) + 1).pack()
    return HeatingModel(image, known)


def _library_effects(models: Sequence[PointModel]) -> tuple[Effect, ...]:
    """Effects of the library: all of the package, so that one library serves all vehicles, and user-defined ones."""
    used = dict.fromkeys(u.effect for m in models for u in kernel_effects(m))
    return tuple(dict.fromkeys([*(e for e in effects().values() if e.kernel and e.built_in), *used]))


MODEL = CompilationUnit("heating_advance", MODEL_SIGNATURE, lambda: c_function(MODEL_SIGNATURE, k.advance))
THERMAL_STEP = CompilationUnit("heating_thermal_step", STEP_SIGNATURE, compiled)


def heating_units(model_effects: tuple[Effect, ...]) -> tuple[CompilationUnit, ...]:
    """Functions of the library: the model's, then those in the order of `A`, the effects and the thermal step."""

    def dispatcher() -> Any:
        for effect in model_effects:
            if not effect.built_in:
                _refuse_unportable(effect)
        return indexed_dispatcher(model_effects).function

    return (
        MODEL,
        CompilationUnit("heating_effects", SIGNATURE, dispatcher, _effect_sources(model_effects)),
        THERMAL_STEP,
    )


def _refuse_unportable(effect: Effect) -> None:
    """raises : InputError naming a user-defined effect that needs what a host without Python does not have"""
    missing = library.missing_functions(CompilationUnit("effect", KERNEL, lambda: compiled_kernel(effect)))
    if missing:
        hint = "a kernel takes and gives numbers, and may call the mathematical functions of C"
        raise InputError(
            f"{effect_context(effect)}: needs {', '.join(missing)}, which a host without Python lacks; {hint}"
        )


def _effect_sources(used: Sequence[Effect]) -> str:
    """Contents of the files of user-defined effects."""
    return "".join(kernel_file(e).read_text(encoding="utf-8") for e in used if not e.built_in)


def _units_of_second_process() -> tuple[CompilationUnit, ...]:
    """Units that a second process compiles while the first one compiles the thermal step."""
    return heating_units(_library_effects(()))[:2]


@contextmanager
def compiling_objects(targets: Sequence[Target]) -> Iterator[None]:
    """Compile the object files that libraries of all vehicles share, unless they are in the cache.

    The thermal step is compiled before the block begins; the others and the C wrapper in a second process, which has
    ended when the block ends.

    raises : InputError where there is no compiler that could link them
    """
    units = (THERMAL_STEP, *_units_of_second_process())
    if all(path.is_file() for unit in units for target in targets for path in unit.object_paths(target)):
        yield
        return
    # A missing compiler is reported before minutes of compilation, not after.
    for target in targets:
        library.compiler_command(target)
    names = [name for name, target in TARGETS.items() if target in targets]
    command = [
        sys.executable,
        "-c",
        f"from {__name__} import compile_in_second_process; compile_in_second_process({names})",
    ]
    # Two processes of about equal duration; NUMBA_CACHE_DIR gives both one cache of kernels.
    process = subprocess.Popen(
        command, env=os.environ | {"NUMBA_CACHE_DIR": str(CACHE)}, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        _compile_objects([THERMAL_STEP], targets)
        yield
        process.wait()
    finally:
        # Also after an error or an interrupt: the second compiler must not be left behind.
        process.kill()
        process.wait()


def compile_in_second_process(platforms: Sequence[str]) -> None:
    """What the second process of `compiling_objects` does."""
    targets = [TARGETS[name] for name in platforms]
    _compile_objects(_units_of_second_process(), targets)
    for target in targets:
        library.wrapper_objects(target)


def _compile_objects(units: Sequence[CompilationUnit], targets: Sequence[Target]) -> None:
    for target in targets:
        for unit in units:
            library.object_files(unit, target)


def quoted(name: str) -> str:
    """A part of a structured name: unchanged where it is an identifier, else in quotes and escaped."""
    plain = re.fullmatch(r"[A-Za-z_]\w*", name, flags=re.ASCII)
    return name if plain else "'" + re.sub(r"(['\\])", r"\\\1", name) + "'"


def _range(name: str) -> tuple[float, float]:
    """Lowest and highest value of an input; surroundings of 0 K stand for what the vehicle and its stacks declare."""
    lowest, highest = LIMITS[name][:2]
    return (0.0 if name == "T_surroundings_K" else lowest), highest


class _HeatingPacker(ImagePacker):
    """Packs the arrays of a plug-in into an image."""

    def __init__(
        self,
        image: Image,
        vehicle: Vehicle,
        plugin: HeatingPlugin,
        known: tuple[Effect, ...],
        columns: bool,
        timing: int,
    ):
        super().__init__(image, k.N_MODEL)
        self.vehicle, self.plugin, self.known, self.columns, self.timing = vehicle, plugin, known, columns, timing
        self.ensemble: Ensemble = plugin.ensemble
        added = ("q_add_W_m2", "T_surroundings_K")
        self.inputs = [*FRAME[1:], *added, *(("h_ref_kg_m2_s", "H_r_J_kg") if columns else ())]

    def pack(self) -> None:
        image, e = self.image, self.ensemble
        self._pack_inputs()
        self._pack_options()
        self.head |= {
            k.N_POINTS: len(e.models),
            k.N_ROWS: len(e.lanes),
            k.N_GROUPS: len(e.groups),
            k.N_STATE: len(e.state),
            k.N_TABLE: len(e.table),
            k.N_INTS: len(e.ints),
            k.GROUPS: image.add_integers(e.groups),
            k.LANE_POINTS: image.add_integers(e.lanes),
            k.INTS: image.add_integers(self._integers()),
            k.STATE: image.add_numbers(e.state, aligned=True),
            k.TABLE: image.add_tables(e.table),
            k.VECTORS: image.add_numbers(np.zeros((len(e.lanes), block.N_CONDITIONS))),
            k.VECTORS_THEN: image.add_numbers(np.zeros((len(e.lanes), block.N_CONDITIONS))),
            k.FRAMES: image.add_numbers(np.zeros(len(FRAME))),
            k.STARTED_FROM: image.add_numbers(np.zeros(len(FRAME))),
            k.BETWEEN: image.add_numbers(np.zeros(1 + len(self.inputs))),
        }
        self._name_reynolds_number()
        self._keep_blocks()
        self._pack_host()
        self._pack_points()
        image.set_integers(list(self.head.items()))
        n = len(self.inputs)
        for first in (self.head[library.INPUTS_NEXT], self.head[library.INPUTS_NOW]):
            image.problems += [Problem(name, LIMITS[name][2], first + i) for i, name in enumerate(self.inputs)]
        image.problems += [Problem(m.name, "its thermal step did not converge; take shorter ones") for m in e.models]
        assert len(image.problems) == 2 * n + len(e.models)

    def _name_reynolds_number(self) -> None:
        """Add the one variable of the ratio tables that is no input; all points have the same one."""
        offset = self.head[k.VECTORS] + block.LOG10_RE
        # Computed in a step, like all vectors, but read between two steps: another instance may have used them then.
        self.image.kept_numbers.append((offset, 1))
        text = "base-10 logarithm of the freestream Reynolds number on the vehicle's length, at the end of a step"
        self.add_number(REYNOLDS, Role.OUTPUT, offset, text, depends=("altitude_m", "velocity_m_s", "rho_kg_m3"))

    def _keep_blocks(self) -> None:
        """Declare the rows of the blocks, and the flags of the groups, that are the state of an instance."""
        image, e = self.image, self.ensemble
        for g, (first, _, ints, _) in enumerate(e.groups):
            state, integers = self.head[k.STATE] + int(first), self.head[k.INTS] + int(ints)
            n = int(e.memory.integers(g)[block.N_NODES])
            points = len(np.unique(e.lanes[g * LANES : (g + 1) * LANES]))
            image.kept_numbers += [(state + row * LANES, points) for row in block.KEPT_ROWS]
            image.kept_numbers.append((state + block.conditions_at(block.END, 0), points * block.N_CONDITIONS))
            image.kept_numbers += [
                (state + block.node_row(i, row).start, points) for i in range(n) for row in k.KEPT_NODE_ROWS
            ]
            image.kept_integers += [(integers + flag, 1) for flag in (block.IN_DEPTH, block.GAPS)]
            image.kept_integers += [
                (integers + block.NODE_INTS + i * block.INTS_PER_NODE + block.IS_FACE, 1) for i in range(n)
            ]

    def _integers(self) -> np.ndarray[Any, Any]:
        """The ensemble's integers with the codes that effects have in the library."""
        ints = self.ensemble.ints.copy()
        for g, row in enumerate(self.ensemble.groups):
            J = ints[row[2] : row[3]]
            for lane in range(LANES):
                model = self.ensemble.models[self.ensemble.lanes[g * LANES + lane]]
                codes = J[block.EFFECT_CODES + lane * block.EFFECT_SLOTS :][: len(kernel_effects(model))]
                # In a process a code is the address of a kernel; a library has its own numbering.
                codes[:] = [self.known.index(used.effect) for used in kernel_effects(model)]
        return ints

    def _pack_inputs(self) -> None:
        # A density of 0, the default of an input, would be out of range at the start of every host.
        density = float(us76(START_ALTITUDE_M)[2])
        starts = [({**INPUT_STARTS, "rho_kg_m3": density}).get(name, 0.0) for name in self.inputs]
        self.add_inputs([Input(name, *INPUT_TEXTS[name], *_range(name)) for name in self.inputs], starts)
        self.head[k.RANGES] = self.image.add_numbers([_range(name) for name in self.inputs])
        self.head[k.INPUTS_AT_STATE] = self.image.keep_numbers(np.zeros(len(self.inputs)))

    def _pack_options(self) -> None:
        options = self.image.keep_numbers([self.plugin.longest_step_s])
        self.add_choice("input_timing", Role.TUNABLE, TIMING, "what the inputs of a step are", TIMINGS)
        text = "in place of input_timing, for hosts without enumerations: 1 held, 2 reached, 0 as input_timing"
        self.add_integer("input_timing_integer", Role.TUNABLE, library.TIMING_INTEGER, text, 0, len(TIMINGS))
        longest = "longest thermal step; a longer one of the host is divided"
        self.add_number("longest_step_s", Role.TUNABLE, options, longest, "s", 0.01, 60.0, 1.0)
        self.head |= {k.OPTIONS: options, TIMING: self.timing}

    def _pack_host(self) -> None:
        host = np.zeros(k.HOST_WIDTH)
        host[: SWEEP + 1] = self.plugin._host[: SWEEP + 1]
        host[BY_ALTITUDE] = self.plugin._host[BY_ALTITUDE]
        if self.columns:
            host[CODE] = COLUMNS
        numbers, tables = self.plugin.constants
        # Tables of a library are one array, as those that a host sets lie outside it; laminar ones are those of the
        # lanes, which the model looks up when it starts.
        numbers, turbulent = numbers.copy(), FLOW_AT + TURBULENT_AT
        first = self.image.add_tables(tables)
        numbers[:, turbulent] += np.where(numbers[:, turbulent] >= 0.0, first, 0.0)
        self.head |= {
            k.HOST: self.image.add_numbers(host),
            k.CONSTANTS: self.image.add_numbers(numbers),
            k.N_TABLES: first + len(tables),
        }

    def _pack_points(self) -> None:
        e, image = self.ensemble, self.image
        numbers = image.add_numbers(np.zeros(k.POINT_WIDTH * len(e.models)))
        written = image.add_numbers(np.zeros(k.PARAMETERS_WIDTH * len(e.models)))
        R, rows, sensors = np.zeros(k.POINT_WIDTH * len(e.models)), [], []
        for i, (point, model, mesh, lane) in enumerate(
            zip(self.plugin.points, e.models, e.meshes, e.lane_offsets, strict=True)
        ):
            row = R[k.POINT_WIDTH * i : k.POINT_WIDTH * (i + 1)]
            p = block.parameters_at(lane.lane)
            row[: block.N_PARAMETERS] = e.memory.block(lane.group)[p : p + block.N_PARAMETERS]
            row[k.P_STACK : k.P_STACK + k.STACK_WIDTH] = stack_values(model)
            limits = point.limits
            row[k.P_SURFACE_LIMIT] = NO_LIMIT_K if limits.surface_K is None else limits.surface_K
            row[k.P_BONDLINE_LIMIT] = NO_LIMIT_K if limits.bondline_K is None else limits.bondline_K
            row[k.P_OUT + k.SURFACE] = e.state[lane.temperature(0)]
            row[k.P_OUT + k.BONDLINE] = e.state[lane.temperature(mesh.bondline)]
            # A point that fills up its group has several lanes; parameters that a host sets go to all of them.
            of_point = e.lanes[lane.group * LANES : (lane.group + 1) * LANES] == i
            elements = elements_of(model.construction, mesh)
            lanes = [int(np.argmax(of_point)), int(np.sum(of_point))]
            layers = [image.add_integers(elements.layer), image.add_numbers(elements.length_m)]
            layers.append(image.add_numbers(elements.density_kg_m3))
            bondline = [lane.temperature(mesh.bondline), elements.insulation, elements.bondline]
            slots = [image.add_integers(elements.slot), image.add_numbers(elements.stretch)]
            rows.append([lane.group, *lanes, len(mesh.layer), *layers, *bondline, *slots])
            named = len(image.variables)
            self._name_point(point, model, numbers + k.POINT_WIDTH * i)
            sensors += self._pack_sensors(point, mesh, lane)
            self._pack_ratio_table(point, lane)
            self._declare_direct_outputs(named, any(u.effect.mode == "emittance" for u in kernel_effects(model)))
        # No host changes a number without a name, such as the parameters of effects that a point does not have.
        image.kept_numbers += [
            (v.offset, v.count)
            for v in image.variables
            if v.kind is Kind.NUMBER and numbers <= v.offset < numbers + len(R)
        ]
        all_numbers = image.R
        all_numbers[numbers : numbers + len(R)] = R
        parameters = R.reshape(-1, k.POINT_WIDTH)[:, : k.PARAMETERS_WIDTH]
        all_numbers[written : written + parameters.size] = parameters.ravel()
        image.set_numbers(all_numbers)
        self.head |= {
            k.POINT_NUMBERS: numbers,
            k.POINT_INTS: image.add_integers(rows),
            k.N_SENSORS: len(sensors),
            k.SENSOR_INTS: image.add_integers(sensors) if sensors else 0,
            k.WRITTEN: written,
        }

    def _name_point(self, point: ControlPoint, model: PointModel, numbers: int) -> None:
        """Add the variables of one point."""
        name = quoted(point.name)
        declared = point.limits
        limits = {"limit.surface_margin_K": declared.surface_K, "limit.bondline_margin_K": declared.bondline_K}
        for i, (output, unit, lower, nominal, text) in enumerate(OUTPUTS):
            if output not in limits or limits[output] is not None:
                compared = (f"{name}.{output.replace('_margin', '')}",) if output in limits else ()
                self.add_number(
                    f"{name}.{output}",
                    Role.OUTPUT,
                    numbers + k.P_OUT + i,
                    text,
                    unit,
                    lower,
                    nominal=nominal,
                    parameters=compared,
                )
        for i, p in enumerate(RATIO):
            self._name_parameter(f"{name}.{p.name}", p, numbers + i)
        for i, p in enumerate(STACK):
            self._name_parameter(f"{name}.{p.name}", p, numbers + k.P_STACK + i)
        # A host sets each number under one name: what a role names has no second one.
        for layer, parameter in model.layer_parameters:
            offset = numbers + k.P_STACK + model.places[parameter.name] - len(RATIO)
            self._name_parameter(
                f"{name}.{STACK_PREFIX}{quoted(layer)}.{parameter.name.rpartition('.')[2]}", parameter, offset
            )
        for i, (variable, unit) in enumerate(zip(RATIO_VARIABLES, UNITS, strict=True)):
            text = "reference condition of the derivatives of the ratio"
            lower, upper, _ = LIMITS[variable]
            self.add_number(
                f"{name}.reference.{variable}", Role.TUNABLE, numbers + block.REFERENCE + i, text, unit, lower, upper
            )
        for output, limit, offset in (
            ("surface", declared.surface_K, k.P_SURFACE_LIMIT),
            ("bondline", declared.bondline_K, k.P_BONDLINE_LIMIT),
        ):
            if limit is not None:
                text = f"highest temperature of the {output}"
                self.add_number(f"{name}.limit.{output}_K", Role.TUNABLE, numbers + offset, text, "K", 0.0, NO_LIMIT_K)
        uses = kernel_effects(model)
        for slot, used in enumerate(uses):
            self._name_effect(name, used, uses[:slot], numbers + block.EFFECT_PARAMETERS + slot * block.EFFECT_WIDTH)

    def _declare_direct_outputs(self, first: int, emitting: bool) -> None:
        """Declare what the heating of a point depends on, whose variables begin at `first`; temperatures are the state.

        emitting : whether it has effects on its emittance
        """
        variables = self.image.variables
        after = {name for v in variables[first:] for name in v.parameters}  # limits and sensors change no heating
        settable = [v.name for v in variables[first:] if v.role in (Role.TUNABLE, Role.FIXED)]
        parameters = tuple(name for name in settable if name not in after)
        for i, v in enumerate(variables[first:], start=first):
            if v.role is Role.OUTPUT and ".heating." in v.name:
                is_of_wall = v.name.endswith(".radiated_W_m2") and not emitting
                depends = self._inputs_of_radiation() if is_of_wall else ("time", *self.inputs)
                variables[i] = replace(v, depends=depends, parameters=parameters)

    def _inputs_of_radiation(self) -> tuple[str, ...]:
        """Inputs that the radiation of a wall depends on beside its temperature."""
        # Surroundings by altitude follow from altitude and density.
        around = ("altitude_m", "rho_kg_m3") if self.plugin._host[BY_ALTITUDE] else ()
        return (*around, "T_surroundings_K")

    def _name_effect(self, name: str, used: EffectUse, before: Sequence[EffectUse], offset: int) -> None:
        earlier = sum(u.effect.name == used.effect.name for u in before)
        which = quoted(used.effect.name) + (f"[{earlier + 1}]" if earlier else "")
        for i, p in enumerate(used.effect.parameters):
            self._name_parameter(f"{name}.effect.{which}.{p.name}", p, offset + i)

    def _name_parameter(self, name: str, p: Parameter, offset: int) -> None:
        self.add_number(name, Role.TUNABLE, offset, p.text, p.unit, p.lower, p.upper)

    def _pack_sensors(self, point: ControlPoint, mesh: Mesh, lane: Any) -> list[list[int]]:
        """Add the variables of a point's thermocouples; their rows of SENSOR_INTS."""
        rows = []
        for sensor, node in zip(point.sensors, mesh.sensors, strict=True):
            name = f"{quoted(point.name)}.sensor.{quoted(sensor.name)}"
            start = self.ensemble.state[lane.temperature(node)]
            coefficients = calibration_coefficients(sensor)
            numbers = self.image.keep_numbers([1.0, 0.0, start, sensor.tau_s, start])
            calibration, before = self.image.add_numbers(coefficients), self.image.add_numbers([start])
            rows.append([lane.temperature(node), numbers, calibration, len(coefficients), before])
            about = f"thermocouple at {1e3 * sensor.depth_m:.4g} mm"
            text = f"{about}, without noise and quantisation"
            self.add_number(
                f"{name}.indicated_K",
                Role.OUTPUT,
                numbers + k.S_INDICATED,
                text,
                "K",
                nominal=1000.0,
                parameters=(f"{name}.gain", f"{name}.bias"),
            )
            self._name_parameter(f"{name}.gain", SENSOR["gain"], numbers + k.S_GAIN)
            self._name_parameter(f"{name}.bias", SENSOR["bias"], numbers + k.S_BIAS)
            lag = replace(SENSOR["tau_s"], upper=max(SENSOR["tau_s"].upper, sensor.tau_s))
            self._name_parameter(f"{name}.tau_s", lag, numbers + k.S_TAU)
        return rows

    def _pack_ratio_table(self, point: ControlPoint, lane: Any) -> None:
        """Add the variables of a point's ratio table, and the integers by which a table from a file replaces it."""
        e, name = self.ensemble, f"{quoted(point.name)}.ratio_table"
        i = self.plugin.points.index(point)
        lanes = np.flatnonzero(e.lanes[lane.group * LANES : (lane.group + 1) * LANES] == i)
        entries = self.head[k.INTS] + e.groups[lane.group, 2] + block.RATIO_TABLE + lanes
        reference = self.vehicle.heating.reference
        basis = [self.image.add_text(t) for t in (reference, point.recovery.kind, recovery_name(None, reference))]
        inside = int(e.memory.integers(lane.group)[block.RATIO_TABLE + lanes[0]])
        about = [*basis, inside, len(entries), *entries]
        first = self.image.add_integers(about)
        text = "path of a ratio table (CSV) in place of the one inside"
        self.image.variables.append(Variable(f"{name}.file", Kind.TABLE, Role.FIXED, first, text, integers=len(about)))
        self._name_table(name, point.ratio, inside)

    def _name_table(self, name: str, table: RatioTable, at: int) -> None:
        shape = tuple(len(axis) for axis in table.axes)
        at += len(shape)
        for variable, axis, unit in zip(RATIO_VARIABLES, table.axes, UNITS, strict=True):
            text = "nodes of the ratio table"
            self.add_array(f"{name}.{variable}", Role.CONSTANT, at, text, unit, (len(axis),))
            at += len(axis)
        text = f"heating ratio at the nodes, {' x '.join(RATIO_VARIABLES)}"
        self.add_array(f"{name}.ratio", Role.FIXED, at, text, "1", shape, -1e3, 1e3)
        self.image.maps.append(
            SampledMap(
                name, TABLE_TEXT, tuple(f"{name}.{v}" for v in RATIO_VARIABLES), RATIO_VARIABLES, f"{name}.ratio"
            )
        )
