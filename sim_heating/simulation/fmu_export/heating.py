"""A vehicle's control points as the image of an FMU: what the heating plug-in packs, with a name for each number."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from sim_heating.base.conditions import FRAME, RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.block import (
    EFFECT_CODES,
    EFFECT_PARAMETERS,
    EFFECT_SLOTS,
    EFFECT_WIDTH,
    LANES,
    N_PARAMETERS,
    RATIO_TABLE,
    REFERENCE,
    parameters_at,
)
from sim_heating.base.kernels.jit import STEP_SIGNATURE, c_function
from sim_heating.base.limits import LIMITS
from sim_heating.base.parameters import RATIO, SENSOR, STACK, UNITS, Parameter
from sim_heating.heating.atmosphere import us76
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
from sim_heating.heating.reference.models import COLUMNS
from sim_heating.inputs.sensor_model import calibration_coefficients
from sim_heating.inputs.vehicle import ControlPoint, Vehicle
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.point import PointModel, element_densities, insulation_layer, kernel_effects, stack_values
from sim_heating.simulation.fmu_export import heating_kernel as k
from sim_heating.simulation.fmu_export.image import TEXT_BYTES, Image, Kind, Problem, Role, Variable, identifier
from sim_heating.simulation.fmu_export.library import (
    FUNCTION,
    HELD,
    INPUT_SLOPES,
    INPUTS,
    INPUTS_NEXT,
    INPUTS_NOW,
    N_INPUTS,
    R_HEAD,
    TARGETS,
    TIMING,
    Target,
    Unit,
    compiler,
    needs,
    objects,
    wrapper,
)
from sim_heating.simulation.plugin import HeatingPlugin
from sim_heating.thermal.mesh import Mesh
from sim_heating.thermal.step import compiled

START_ALTITUDE_M = 122e3
INPUT_STARTS = {"altitude_m": START_ALTITUDE_M, "velocity_m_s": 7600.0, "alpha_deg": 40.0}
"""Entry interface: what inputs are before a host sets them; the density is that of the standard atmosphere."""
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
    "h_ref_kg_m2_s": ("kg/(m2 s)", 0.05, "reference film coefficient"),
    "H_r_J_kg": ("J/kg", 2e7, "recovery enthalpy"),
}
"""Unit, nominal value and meaning of each input."""
TIMINGS = (
    ("held", "inputs are values at the start of a step, held over it unless the host gives more"),
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
        "flux that the flow brings to the surface, at the wall's temperature",
    ),
    ("heating.radiated_W_m2", "W/m2", -np.inf, 1e5, "net flux that the surface radiates"),
    ("heating.absorbed_W_m2", "W/m2", -np.inf, 1e4, "flux that goes into the wall"),
    ("limit.surface_margin_K", "K", -np.inf, 100.0, "limit of the surface less its temperature"),
    ("limit.bondline_margin_K", "K", -np.inf, 100.0, "limit of the bondline less its temperature"),
)
"""What each control point gives out, in the order of the kernel: name, unit, least and nominal value, meaning."""
HOTTEST_LIMIT_K = 1e5


@dataclass(frozen=True)
class HeatingModel:
    """The image of a vehicle's heating and the effects that its library must hold."""

    image: Image
    effects: tuple[Effect, ...]


def heating_image(vehicle: Vehicle, control_points: Sequence[str] | None = None, *, columns: bool = False,
                  nodes: int | None = None) -> HeatingModel:  # fmt: skip
    """The heating plug-in of a vehicle as an image.

    control_points : names; all by default
    columns        : h_ref and H_r are inputs, instead of the vehicle's reference heating
    nodes          : as in HeatingPlugin
    raises         : InputError for a name that there is not
    """
    plugin = HeatingPlugin(vehicle, control_points, nodes=nodes)
    known = _library_effects(plugin.ensemble.models)
    image = Image(f"{identifier(vehicle.name)}_heating", f"Heating of {vehicle.title}", 1.0)
    _Packer(image, vehicle, plugin, known, columns).pack()
    return HeatingModel(image, known)


def _library_effects(models: Sequence[PointModel]) -> tuple[Effect, ...]:
    """Effects of the library: all that the package has, so that one library serves all vehicles, and the user's own."""
    own = dict.fromkeys(u.effect for m in models for u in kernel_effects(m))
    return tuple(dict.fromkeys([*(e for e in effects().values() if e.kernel and e.built_in), *own]))


MODEL = Unit("heating_move", FUNCTION, lambda: c_function(FUNCTION, k.advance))
THERMAL_STEP = Unit("heating_thermal_step", STEP_SIGNATURE, compiled)


def heating_units(model_effects: tuple[Effect, ...]) -> tuple[Unit, ...]:
    """Functions of the library: the model's; in the order of `A`, the effects, the thermal step."""

    def dispatcher() -> Any:
        for own in model_effects:
            if not own.built_in:
                _refuse_unportable(own)
        return indexed_dispatcher(model_effects).function

    return MODEL, Unit("heating_effects", SIGNATURE, dispatcher, _sources_of(model_effects)), THERMAL_STEP


def _refuse_unportable(effect: Effect) -> None:
    """raises : InputError naming an effect of the user's own that needs what a host without Python does not have"""
    missing = needs(Unit("effect", KERNEL, lambda: compiled_kernel(effect)))
    if missing:
        hint = "a kernel takes and gives numbers, and may call the mathematical functions of C"
        raise InputError(
            f"{effect_context(effect)}: needs {', '.join(missing)}, which a host without Python lacks; {hint}"
        )


def _sources_of(used: Sequence[Effect]) -> str:
    """Contents of the files that the user's own effects come from."""
    return "".join(kernel_file(e).read_text() for e in used if not e.built_in)


def _made_beside() -> tuple[Unit, ...]:
    """Units that a second process makes while the first one makes that of the thermal step."""
    return heating_units(_library_effects(()))[:2]


@contextmanager
def making_objects(targets: Sequence[Target]) -> Iterator[None]:
    """Make the object files that libraries of all vehicles share, where they are not in the cache: that of the thermal
    step before the block begins, the others and the C wrapper in a second process meanwhile; all are there when it
    ends.

    raises : InputError where there is no compiler that could link them
    """
    units = (THERMAL_STEP, *_made_beside())
    if all(path.is_file() for unit in units for target in targets for path in unit.objects(target)):
        yield
        return
    for target in targets:
        compiler(target)
    names = [name for name, target in TARGETS.items() if target in targets]
    command = [sys.executable, "-c", f"from {__name__} import make_others; make_others({names})"]
    folder = str(numba.config.CACHE_DIR)  # type: ignore[attr-defined]
    beside = subprocess.Popen(
        command, env=os.environ | {"NUMBA_CACHE_DIR": folder}, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        _make([THERMAL_STEP], targets)
        yield
        beside.wait()
    finally:
        beside.kill()
        beside.wait()


def make_others(platforms: Sequence[str]) -> None:
    """What the second process of `making_objects` does."""
    targets = [TARGETS[name] for name in platforms]
    _make(_made_beside(), targets)
    for target in targets:
        wrapper(target)


def _make(units: Sequence[Unit], targets: Sequence[Target]) -> None:
    for target in targets:
        for unit in units:
            objects(unit, target)


def quoted(part: str) -> str:
    """A part of a structured name: as it is where it is an identifier, else in quotes, with those within it escaped."""
    plain = re.fullmatch(r"[A-Za-z_]\w*", part, flags=re.ASCII)
    return part if plain else "'" + re.sub(r"(['\\])", r"\\\1", part) + "'"


class _Packer:
    """Puts a plug-in into an image, piece by piece."""

    def __init__(self, image: Image, vehicle: Vehicle, plugin: HeatingPlugin, known: tuple[Effect, ...], columns: bool):
        self.image, self.vehicle, self.plugin, self.known, self.columns = image, vehicle, plugin, known, columns
        self.ensemble: Ensemble = plugin.ensemble
        self.inputs = [*FRAME[1:], "q_add_W_m2", *(("h_ref_kg_m2_s", "H_r_J_kg") if columns else ())]

    def pack(self) -> None:
        image, e = self.image, self.ensemble
        image.numbers(np.zeros(R_HEAD))
        image.integers(np.zeros(k.N_MODEL))
        image.variables.append(Variable("time", Kind.NUMBER, Role.INDEPENDENT, 0, "time", "s"))
        head = self._pack_inputs()
        head |= self._pack_options()
        head |= {
            k.N_POINTS: len(e.models), k.N_ROWS: len(e.lanes), k.N_GROUPS: len(e.groups), k.N_STATE: len(e.state),
            k.N_TABLE: len(e.table), k.N_INTS: len(e.ints),
            k.GROUPS: image.integers(e.groups), k.LANE_POINTS: image.integers(e.lanes),
            k.INTS: image.integers(self._integers()),
            k.STATE: image.numbers(e.state, aligned=True), k.TABLE: image.numbers(e.table),
            k.VECTORS: image.numbers(np.zeros((len(e.lanes), k.N_CONDITIONS))),
            k.FRAMES: image.numbers(np.zeros(len(FRAME))),
        }  # fmt: skip
        head |= self._pack_host() | self._pack_points(head)
        image.set_integers(list(head.items()))
        n = len(self.inputs)
        given, before = head[INPUTS_NEXT], head[INPUTS_NOW]
        for first in (given, before):
            image.problems += [Problem(name, LIMITS[name][2], first + i) for i, name in enumerate(self.inputs)]
        image.problems.append(Problem("the communication step", f"is longer than {k.LONGEST_COMMUNICATION_S:g} s"))
        image.problems += [Problem(m.name, "its thermal step did not converge; take shorter ones") for m in e.models]
        assert len(image.problems) == 2 * n + 1 + len(e.models)

    def _integers(self) -> np.ndarray[Any, Any]:
        """The ensemble's integers with the codes that effects have in the library."""
        ints = self.ensemble.ints.copy()
        for g, row in enumerate(self.ensemble.groups):
            J = ints[row[2] : row[3]]
            for lane in range(LANES):
                model = self.ensemble.models[self.ensemble.lanes[g * LANES + lane]]
                codes = J[EFFECT_CODES + lane * EFFECT_SLOTS :][: len(kernel_effects(model))]
                codes[:] = [self.known.index(used.effect) for used in kernel_effects(model)]
        return ints

    def _pack_inputs(self) -> dict[int, int]:
        image, n = self.image, len(self.inputs)
        density = float(us76(START_ALTITUDE_M)[2])
        starts = [({**INPUT_STARTS, "rho_kg_m3": density}).get(name, 0.0) for name in self.inputs]
        place = image.numbers(starts)
        for i, name in enumerate(self.inputs):
            unit, nominal, text = INPUT_TEXTS[name]
            lower, upper, _ = LIMITS[name]
            image.variables.append(
                Variable(name, Kind.NUMBER, Role.INPUT, place + i, text, unit, lower, upper, nominal)
            )
        copies = {at: image.numbers(starts) for at in (INPUTS_NOW, INPUTS_NEXT)}
        ranges = image.numbers([LIMITS[name][:2] for name in self.inputs])
        zeros = {at: image.numbers(np.zeros(n)) for at in (INPUT_SLOPES, k.HEATED)}
        return {INPUTS: place, N_INPUTS: n, k.RANGES: ranges, **copies, **zeros}

    def _pack_options(self) -> dict[int, int]:
        image = self.image
        options = image.numbers([self.plugin.longest_step_s])
        timing, longest = "what the inputs of a step are", "longest thermal step; a longer one of the host is divided"
        image.variables += [
            Variable("input_timing", Kind.INTEGER, Role.TUNABLE, TIMING, timing, lower=1, upper=2, choices=TIMINGS),
            Variable("longest_step_s", Kind.NUMBER, Role.TUNABLE, options, longest, "s", 0.01, 60.0, 1.0),
        ]
        return {k.OPTIONS: options, TIMING: HELD}

    def _pack_host(self) -> dict[int, int]:
        host = np.zeros(k.HOST_WIDTH)
        host[:3] = self.plugin._host[:3]
        if self.columns:
            host[k.CODE] = COLUMNS
        return {k.HOST: self.image.numbers(host), k.PRESSURES: self.image.numbers(self.plugin.pressures)}

    def _pack_points(self, head: Mapping[int, int]) -> dict[int, int]:
        e, image = self.ensemble, self.image
        numbers = image.numbers(np.zeros(k.POINT_WIDTH * len(e.models)))
        R, rows, sensors = np.zeros(k.POINT_WIDTH * len(e.models)), [], []
        for i, (point, model, mesh, place) in enumerate(
            zip(self.plugin.points, e.models, e.meshes, e.lane_offsets, strict=True)
        ):
            own = R[k.POINT_WIDTH * i : k.POINT_WIDTH * (i + 1)]
            block = e.block(place.group)
            p = parameters_at(place.lane)
            own[:N_PARAMETERS] = block[p : p + N_PARAMETERS]
            own[k.P_STACK : k.P_STACK + len(STACK)] = stack_values(model)
            limits = point.limits
            own[k.P_SURFACE_LIMIT] = HOTTEST_LIMIT_K if limits.surface_K is None else limits.surface_K
            own[k.P_BONDLINE_LIMIT] = HOTTEST_LIMIT_K if limits.bondline_K is None else limits.bondline_K
            own[k.P_OUT + k.SURFACE] = e.state[place.temperature(0)]
            own[k.P_OUT + k.BONDLINE] = e.state[place.temperature(mesh.bondline)]
            mine = e.lanes[place.group * LANES : (place.group + 1) * LANES] == i
            densities = element_densities(model.construction, mesh)
            rows.append([
                place.group, int(np.argmax(mine)), int(np.sum(mine)), len(mesh.layer),
                image.integers(mesh.layer), image.numbers(mesh.length_m), image.numbers(densities),
                place.temperature(mesh.bondline), insulation_layer(model.construction), mesh.bondline,
            ])  # fmt: skip
            self._name_point(point, model, numbers + k.POINT_WIDTH * i)
            sensors += self._pack_sensors(point, mesh, place)
            self._pack_ratio_table(point, place, head)
        whole = image.R
        whole[numbers : numbers + len(R)] = R
        image.set_numbers(whole)
        return {
            k.POINT_NUMBERS: numbers, k.POINT_INTS: image.integers(rows), k.N_SENSORS: len(sensors),
            k.SENSOR_INTS: image.integers(sensors) if sensors else 0, k.CALIBRATIONS: 0,
        }  # fmt: skip

    def _name_point(self, point: ControlPoint, model: PointModel, numbers: int) -> None:
        """Names for the numbers of one point."""
        name = quoted(point.name)
        declared = point.limits
        have = {"limit.surface_margin_K": declared.surface_K, "limit.bondline_margin_K": declared.bondline_K}
        for i, (what, unit, lower, nominal, text) in enumerate(OUTPUTS):
            if what not in have or have[what] is not None:
                self._add(f"{name}.{what}", Role.OUTPUT, numbers + k.P_OUT + i, text, unit, lower, nominal=nominal)
        for i, p in enumerate(RATIO):
            self._name_parameter(f"{name}.{p.name}", p, numbers + i)
        for i, p in enumerate(STACK):
            self._name_parameter(f"{name}.{p.name}", p, numbers + k.P_STACK + i)
        for i, (variable, unit) in enumerate(zip(RATIO_VARIABLES, UNITS, strict=True)):
            text = "condition that the derivatives of the ratio are about"
            lower, upper, _ = LIMITS[variable]
            self._add(f"{name}.reference.{variable}", Role.TUNABLE, numbers + REFERENCE + i, text, unit, lower, upper)
        for what, limit, place in (
            ("surface", declared.surface_K, k.P_SURFACE_LIMIT), ("bondline", declared.bondline_K, k.P_BONDLINE_LIMIT)
        ):  # fmt: skip
            if limit is not None:
                text = f"highest temperature of the {what}"
                self._add(f"{name}.limit.{what}_K", Role.TUNABLE, numbers + place, text, "K", 0.0, HOTTEST_LIMIT_K)
        uses = kernel_effects(model)
        for slot, used in enumerate(uses):
            self._name_effect(name, used, uses[:slot], numbers + EFFECT_PARAMETERS + slot * EFFECT_WIDTH)

    def _name_effect(self, name: str, used: EffectUse, before: Sequence[EffectUse], place: int) -> None:
        earlier = sum(u.effect.name == used.effect.name for u in before)
        which = quoted(used.effect.name) + (f"[{earlier + 1}]" if earlier else "")
        for i, p in enumerate(used.effect.parameters):
            self._name_parameter(f"{name}.effect.{which}.{p.name}", p, place + i)

    def _name_parameter(self, name: str, p: Parameter, place: int) -> None:
        self._add(name, Role.TUNABLE, place, p.text, p.unit, p.lower, p.upper)

    def _add(
        self, name: str, role: Role, place: int, text: str, unit: str,
        lower: float = -np.inf, upper: float = np.inf, nominal: float | None = None, shape: tuple[int, ...] = (),
    ) -> None:  # fmt: skip
        self.image.variables.append(Variable(name, Kind.NUMBER, role, place, text, unit, lower, upper, nominal, shape))

    def _pack_sensors(self, point: ControlPoint, mesh: Mesh, place: Any) -> list[list[int]]:
        """Rows of a point's thermocouples, and names for what they show."""
        rows = []
        for sensor, node in zip(point.sensors, mesh.sensors, strict=True):
            name = f"{quoted(point.name)}.sensor.{quoted(sensor.name)}"
            start = self.ensemble.state[place.temperature(node)]
            coefficients = calibration_coefficients(sensor)
            numbers = self.image.numbers([1.0, 0.0, start])
            rows.append([place.temperature(node), numbers, self.image.numbers(coefficients), len(coefficients)])
            about = f"thermocouple at {1e3 * sensor.depth_m:.4g} mm"
            shown = f"{about}, without noise and quantisation"
            self._add(f"{name}.indicated_K", Role.OUTPUT, numbers + k.S_INDICATED, shown, "K", nominal=1000.0)
            self._name_parameter(f"{name}.gain", SENSOR["gain"], numbers + k.S_GAIN)
            self._name_parameter(f"{name}.bias", SENSOR["bias"], numbers + k.S_BIAS)
        return rows

    def _pack_ratio_table(self, point: ControlPoint, place: Any, head: Mapping[int, int]) -> None:
        """Names for a point's ratio table, and the integers by which another one takes its place."""
        e, name = self.ensemble, f"{quoted(point.name)}.ratio_table"
        i = self.plugin.points.index(point)
        lanes = np.flatnonzero(e.lanes[place.group * LANES : (place.group + 1) * LANES] == i)
        places = head[k.INTS] + e.groups[place.group, 2] + RATIO_TABLE + lanes
        reference = self.image.text(self.vehicle.heating.reference)
        inside = int(e.integers(place.group)[RATIO_TABLE + lanes[0]])
        own = [head[k.TABLE], reference, inside, len(places), *places]
        first = self.image.integers([*np.zeros(TEXT_BYTES // 8), *own])
        text = "path of a ratio table (CSV) in place of the one inside"
        self.image.variables.append(Variable(f"{name}.file", Kind.TABLE, Role.FIXED, first, text))
        self._name_table(name, point.ratio, head[k.TABLE] + inside)

    def _name_table(self, name: str, table: RatioTable, at: int) -> None:
        shape = tuple(len(axis) for axis in table.axes)
        at += len(shape)
        for variable, axis, unit in zip(RATIO_VARIABLES, table.axes, UNITS, strict=True):
            text = "nodes of the ratio table"
            self._add(f"{name}.{variable}", Role.CONSTANT, at, text, unit, shape=(len(axis),))
            at += len(axis)
        text = f"heating ratio at the nodes, {' x '.join(RATIO_VARIABLES)}"
        self._add(f"{name}.ratio", Role.FIXED, at, text, "1", -1e3, 1e3, shape=shape)
