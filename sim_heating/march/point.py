"""Model of a control point for the kernels: construction, sensors, ratio table, parameters and effects, and the numbers
that a lane takes from them.

Source: docs/theory/equations.md, equations 5 and 6.
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.base.files import suggestion
from sim_heating.base.kernels.block import EFFECT_PARAMETERS, EFFECT_WIDTH, N_PARAMETERS, REFERENCE
from sim_heating.base.parameters import (
    BOUNDARY,
    EFFECT_PREFIX,
    LAYER,
    LAYER_SLOTS,
    MODEL,
    NONLINEAR,
    RATIO,
    STACK_PREFIX,
    Parameter,
    layer_parameter,
)
from sim_heating.heating.effects import EffectUse, ModelParameter, check_count
from sim_heating.heating.interface import Interface
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.thermal import elements
from sim_heating.thermal.mesh import Mesh
from sim_heating.thermal.stack import BackFace, Construction
from sim_heating.thermal.tables import WallEnthalpy

MODES = ("add", "multiply", "emittance")
"""Effects with a kernel, in the order in which they act."""
COATING_PREFIX, RSI_PREFIX = "stack.coating.", "stack.rsi."
BACK = ("back.h_W_m2K", "back.T_K", "back.emissivity")
MOISTURE = (elements.LATENT_HEAT, elements.BOILS, elements.DEPOSITED, elements.CONDENSES, elements.WIDTH)
MOISTURE_RUNAWAY = "moisture gives off more heat as it condenses than takes to warm what it condenses in"
CONDENSATION_WIDTHS = 8.0
"""Widths about its condensation temperature outside of which moisture condenses to less than 1e-3."""
VALUE_INDEX = {name: k for k, name in enumerate(MODEL)}
"""Index in PointModel.values of each parameter that every point has."""
_PARAMETERS = tuple(MODEL.values())
_NOMINAL = np.ones(len(RATIO) + elements.STACK_WIDTH)
_NOMINAL[: len(MODEL)] = [p.value for p in _PARAMETERS]
LEAST_BEHIND = 1e-3
"""Least thickness left behind the deepest sensor in a layer, over the declared thickness [-]."""
AMBIGUOUS = -1
"""Place of a name that is the role of one layer, and what the file calls another."""


def _unknown(point: str, name: str, names: Iterable[str]) -> str:
    return f"{point}: unknown parameter `{name}`{suggestion(name, names, otherwise='')}"


@dataclass(frozen=True)
class PointModel:
    """One control point: construction, sensors, heating ratio, parameters and effects.

    name          : for messages and columns
    construction  : stack and materials
    depths_m      : depths of the sensors from the outer surface [m]; each gets a node
    ratio         : declared ratio table [-], or None for ratio.d0 alone
    wall_enthalpy : constant cp [J/(kg K)] or the name of a gas model
    nodes         : number of nodes, or None to have it chosen
    parameters    : dotted name -> value, in the unit of the parameter, where not nominal; a layer by its own name or by
                    its role (`stack.li900.conductivity_factor` is `stack.rsi.conductivity_factor` of a tile)
    reference     : values of the five ratio variables about which derivatives are defined [deg, deg, -, deg, deg]
    effects       : effects with their parameters
    lags_s        : time constants of the sensors' first-order lags [s], in the order of the depths; empty for none
    interface     : step of wall temperature upstream; its wall is the column H_upstream_J_kg of the conditions
    raises        : InputError for unknown parameters and values out of bounds, sensors outside the stack, cp not above
                    0, two effects with a lag, ratio.d0 with a table, moisture without a unique temperature

    Heating ratio: docs/theory/equations.md, section 2.
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
    lags_s: tuple[float, ...] = ()
    interface: Interface | None = None

    def __post_init__(self) -> None:
        check_count(self.effects, self.name)
        stack = self.construction.stack
        self._check_parameters()
        for depth in self.depths_m:
            if not stack.holds(depth):
                thickness = stack.thickness_m
                raise InputError(f"{self.name}: a sensor at {depth:g} m is outside the stack (0 to {thickness:g} m)")
        if not isinstance(self.wall_enthalpy, str) and not 0.0 < self.wall_enthalpy < np.inf:
            raise InputError(f"{self.name}, wall_enthalpy: cp {self.wall_enthalpy:g} J/(kg K) must be above 0")
        if any(self.lags_s) and len(self.lags_s) != len(self.depths_m):
            raise InputError(
                f"{self.name}: {len(self.lags_s)} lags for {len(self.depths_m)} sensors; give one for each"
            )
        # A lane has one memory for a lag.
        if sum(use.effect.lags for use in self.effects) > 1:
            raise InputError(f"{self.name}: two effects with a lag, and one control point takes one; remove the other")
        if self.ratio is not None and self.parameters.get("ratio.d0", 0.0) != 0.0:
            raise InputError(f"{self.name}: ratio.d0 is 0 where there is a ratio table; use ratio.scale")
        # Last: it reads `values`, which are valid only after the checks above.
        if self.runs_away:
            raise InputError(f"{self.name}: {MOISTURE_RUNAWAY}; lower its deposit_J_kg or raise its width_K")

    def _check_parameters(self) -> None:
        for key, value in self.parameters.items():
            if key not in self.places:
                raise InputError(_unknown(self.name, key, self.places))
            # A role that the point lacks, such as the coating of a wall of one layer, has no effect and does no harm.
            p = MODEL[key] if key in MODEL else self.definition(key)
            if not p.lower <= value <= p.upper:
                raise InputError(f"{self.name}, {key}: {value:g} is outside its bounds {p.lower:g} to {p.upper:g}")
        check_one_name(self.name, self.places, self.parameters)

    @cached_property
    def places(self) -> Mapping[str, int]:
        """Index [-] in `values` of every parameter by dotted name, that of a layer by its own name and by its role.

        The first layer and the insulation have roles. Layers of one name have their parameters in common; those of one
        layer that has a role are the role's.
        """
        stack, insulation = self.construction.stack, insulation_layer(self.construction)
        indices = dict(VALUE_INDEX)
        for slot, name in enumerate(_slot_names(self.construction)):
            layers = [i for i, layer_name in enumerate(stack.layer_names) if layer_name == name]
            of_role = _values_of_role(layers, insulation)
            for parameter, index in of_role.items():
                indices.setdefault(f"{STACK_PREFIX}{name}.{parameter}", index)
            for k, p in enumerate(LAYER):
                index = of_role.get(p.name, len(MODEL) + elements.OWN_WIDTH * slot + k)
                if indices.setdefault(f"{STACK_PREFIX}{name}.{p.name}", index) != index:
                    indices[f"{STACK_PREFIX}{name}.{p.name}"] = AMBIGUOUS
        return indices

    @property
    def runs_away(self) -> bool:
        """Whether condensing moisture would release more heat than warms the material that it condenses in.

            c(T) + (L u (1 - u) - D v (1 - v)) / w <= 0,    u, v logistic about the boiling and condensation
            temperatures

        at one of 81 temperatures over T_condense +- 8 w [K]; L, D latent and deposited heat [J/kg], w the width [K], c
        the specific heat of the insulation [J/(kg K)]. The temperature would jump there and a step have no unique
        solution. Derived in docs/theory/equations_march.md, equation 22.
        """
        stack = self.values[len(RATIO) :]
        latent, boil, deposit, condense, width = (float(stack[k]) for k in MOISTURE)
        if deposit <= 0.0:
            return False
        # Only about condensation: elsewhere the deposited heat is negligible and boiling only adds to the heat content.
        T = condense + width * np.linspace(-CONDENSATION_WIDTHS, CONDENSATION_WIDTHS, 81)
        # Clipped where exp would overflow; u (1 - u) is 0 there to rounding.
        up, down = (1.0 / (1.0 + np.exp(-np.clip((T - at) / width, -500.0, 500.0))) for at in (boil, condense))
        material = self.construction.layer_materials()[insulation_layer(self.construction)]
        warmed = np.interp(T, *np.array(material.specific_heat_J_kgK, dtype=float).T)
        return bool(np.any(warmed + (latent * up * (1.0 - up) - deposit * down * (1.0 - down)) / width <= 0.0))

    @cached_property
    def values(self) -> FloatArray:
        """(parameter,) all parameters of heating ratio, stack and layers, each in its own unit ([-], [1/deg], [K] ...).

        Their indices are `places`. Nominal, then `back.*` as the stack declares, then those that an effect sets, the
        first such effect prevailing.
        Heating ratio: docs/theory/equations.md, section 2; factors and moisture: docs/theory/equations_march.md,
        equations 9, 10 and 22.
        """
        values = _NOMINAL.copy()
        for name, value in self.parameters.items():
            values[self.places[name]] = value
        for name in BACK:
            if name not in self.parameters:
                values[VALUE_INDEX[name]] = self._declared_back(name)
        # Reversed, so that of two effects which set one parameter the first prevails.
        for used in reversed(self.effects):
            for parameter, value in zip(used.effect.model_parameters, used.values, strict=False):
                if parameter in VALUE_INDEX:
                    values[VALUE_INDEX[parameter]] = value
        return values

    def value(self, name: str) -> float:
        """Value of one parameter in its own unit ([-], [K], [m] ...), nominal where it is not set.

        name   : dotted name, also `effect.NAME.PARAMETER`
        raises : InputError with the nearest name where the model has no such effect parameter

        Ratio parameters: docs/theory/equations.md, section 2.
        """
        if name.startswith(EFFECT_PREFIX):
            use, k = self._effect_parameter(name)
            return float(self.effects[use].values[k])
        return float(self.values[self._place(name)])

    def _place(self, name: str) -> int:
        """Index of a parameter in `values`.

        raises : InputError where the point has none of this name, or the file calls another layer by that of a role
        """
        if name not in self.places:
            of_layer = layer_parameter(name)
            layer_names = self.construction.stack.layer_names
            if of_layer is not None and of_layer[0] not in layer_names:
                layers = ", ".join(dict.fromkeys(layer_names))
                raise InputError(f"{self.name}: `{name}`: there is no layer `{of_layer[0]}`; its layers are {layers}")
            raise InputError(_unknown(self.name, name, self.places))
        if self.places[name] == AMBIGUOUS:
            raise InputError(
                f"{self.name}: `{name}` is of the layer that the file calls so, and of another one by its role; give "
                "the first another `name` in [[stack.layer]]"
            )
        return self.places[name]

    def _existing_place(self, name: str) -> int:
        """As `_place`; raises InputError for a coating in a wall of one layer as well."""
        index = self._place(name)
        if name in MODEL and name.startswith(COATING_PREFIX) and insulation_layer(self.construction) == 0:
            raise InputError(f"{self.name}: `{name}`: a wall of one layer has no coating; its layer is `stack.rsi.*`")
        return index

    def _declared_back(self, name: str) -> float:
        back = self.construction.stack.back
        declared = getattr(back, name.removeprefix("back.")) if isinstance(back, BackFace) else None
        return float(MODEL[name].value if declared is None else declared)

    def definition(self, name: str) -> Parameter:
        """Definition of a parameter of this model: unit ([-], [K] ...), nominal value, prior, bounds, description.

        The scale of its perturbation is the prior's sigma: docs/theory/equations_march.md, equation 9.

        name   : dotted name, also `effect.NAME.PARAMETER`
        raises : InputError with the nearest name where the model has no such parameter or layer, or for a coating in a
                 wall of one layer
        """
        if name.startswith(EFFECT_PREFIX):
            use, k = self._effect_parameter(name)
            set_here, usual = self.effects[use].definitions[k], self.effects[use].effect.parameters[k]
            stands_for = usual.stands_for if isinstance(usual, ModelParameter) else ""
            scatter = self._declared_scatter(stands_for) if set_here.sigma == usual.sigma else None
            return set_here if scatter is None else replace(set_here, sigma=scatter)
        index = self._existing_place(name)
        p = _PARAMETERS[index] if index < len(MODEL) else LAYER[(index - len(MODEL)) % elements.OWN_WIDTH]
        sigma = self._declared_scatter(name) or p.sigma
        return replace(p, name=name, sigma=sigma, lower=max(p.lower, self._least_thickness(name)))

    @property
    def layer_parameters(self) -> list[tuple[str, Parameter]]:
        """Name of the layer and definition of each parameter that a layer has by its own name alone, not by a role."""
        return [
            (layer, self.definition(name))
            for layer in _slot_names(self.construction)
            for name in (f"{STACK_PREFIX}{layer}.{p.name}" for p in LAYER)
            if self.places[name] >= len(MODEL)
        ]

    def _layers_of(self, name: str) -> list[int]:
        """Indices of the layers that a parameter of parameters.LAYER is of, by their own name or by a role."""
        of_layer = layer_parameter(name)
        layer_name = "" if of_layer is None else of_layer[0]
        role = {"coating": 0, "rsi": insulation_layer(self.construction)}.get(layer_name)
        named = [i for i, layer in enumerate(self.construction.stack.layer_names) if layer == layer_name]
        return [] if of_layer is None else named if role is None else [role]

    def _least_thickness(self, name: str) -> float:
        """Part of the thickness of a layer down to its deepest sensor, which keeps its place [-]; else no limit."""
        stack = self.construction.stack
        if not name.endswith(f".{LAYER[0].name}"):
            return -np.inf  # derivatives of the ratio may be negative
        faces, parts = stack.interfaces_m, [0.0]
        slack = 1e-9 * stack.thickness_m  # a depth in a file is that of a face to rounding
        for i in self._layers_of(name):
            inside = [x - faces[i] for x in self.depths_m if faces[i] < x < faces[i + 1] - slack]
            parts += [LEAST_BEHIND + float(x / (faces[i + 1] - faces[i])) for x in inside]
        return max(parts)

    def _declared_scatter(self, name: str) -> float | None:
        """Relative standard deviation that the layer of a parameter, or its material, declares [-]; else None."""
        suffix, scatters = name.rpartition(".")[2], []
        for i in self._layers_of(name):
            layer, material = self.construction.stack.layer[i], self.construction.layer_materials()[i]
            of_thickness = None if layer.thickness_sigma_m is None else layer.thickness_sigma_m / layer.thickness_m
            scatter = (of_thickness, material.conductivity_sigma, material.heat_capacity_sigma)
            scatters.append(dict(zip((p.name for p in LAYER), scatter, strict=True))[suffix])
        return max((s for s in scatters if s is not None), default=None)

    def is_curved(self, name: str) -> bool:
        """Whether the heat balance [W/m2] at given temperatures is not affine in a parameter of stack or ratio.

        name : dotted name; a layer's by its own name or its role
        """
        index = self.places.get(name, AMBIGUOUS)
        canonical = _PARAMETERS[index].name if 0 <= index < len(MODEL) else name
        return canonical in NONLINEAR or canonical.endswith(f".{LAYER[0].name}")

    def same_parameter(self, name: str, other: str) -> bool:
        """Whether two dotted names are of one parameter, as those of a layer by its own name and by its role."""
        return name == other or (name in self.places and self.places[name] == self.places.get(other))

    def at_faces(self, name: str) -> bool:
        """Whether a parameter changes only the heat that enters at the faces [W/m2], and nothing within the wall.

        name : dotted name, also `effect.NAME.PARAMETER`

        Its sensitivity then needs no rows of the interior: docs/theory/equations_march.md, equation 13.
        """
        if name.startswith(EFFECT_PREFIX):
            use, k = self._effect_parameter(name)
            effect = self.effects[use].effect
            return effect.kernel is not None or effect.model_parameters[k] in BOUNDARY
        return name in BOUNDARY

    def _effect_parameter(self, name: str) -> tuple[int, int]:
        by_name = {
            f"{EFFECT_PREFIX}{use.effect.name}.{p.name}": (i, k)
            for i, use in enumerate(self.effects)
            for k, p in enumerate(use.effect.parameters)
        }
        if name not in by_name:
            raise InputError(_unknown(self.name, name, by_name))
        return by_name[name]

    def with_parameters(self, values: Mapping[str, float]) -> PointModel:
        """Copy of the point with parameters set by their dotted names.

        values : dotted name -> value, in the unit of the parameter ([-], [K] ...); within its bounds or beyond, as
                 values are not checked
        raises : InputError with the nearest name where the model has no such parameter

        The caller checks bounds, because derivatives perturb parameters that are at a bound
        (docs/theory/equations_march.md, equation 9).
        """
        parameters, effects = dict(self.parameters), [list(use.values) for use in self.effects]
        for name, value in values.items():
            if name.startswith(EFFECT_PREFIX):
                use, k = self._effect_parameter(name)
                effects[use][k] = value
            else:
                self._existing_place(name)
                for other in [n for n in parameters if self.same_parameter(name, n)]:
                    del parameters[other]
                parameters[name] = value
        used = tuple(replace(u, values=tuple(v)) for u, v in zip(self.effects, effects, strict=True))
        return self._unchecked(parameters=parameters, effects=used)

    def without_effects(self, names: Collection[str]) -> PointModel:
        """The point without those of its effects that bear one of these names."""
        kept = tuple(used for used in self.effects if used.effect.name not in names)
        return self if len(kept) == len(self.effects) else replace(self, effects=kept)

    def with_lags(self, lags_s: Sequence[float]) -> PointModel:
        """Copy of the point with other time constants of its sensors [s]; parameters beyond their bounds stay so.

        Lag: docs/theory/equations.md, section 5.
        """
        return self._unchecked(lags_s=tuple(lags_s))

    def _unchecked(self, **changes: object) -> PointModel:
        # Not dataclasses.replace: that would check bounds, which a difference may have to exceed.
        other = copy.copy(self)
        other.__dict__.pop("values", None)
        for name, value in changes.items():
            object.__setattr__(other, name, value)
        return other


def check_one_name(where: str, indices: Mapping[str, int], names: Iterable[str]) -> None:
    """Refuse two names of one parameter.

    where  : for the message;  places : index of each parameter by name
    raises : InputError naming the two
    """
    seen: dict[int, str] = {}
    for name in names:
        first = seen.setdefault(indices.get(name, AMBIGUOUS), name)
        if name in indices and first != name:
            raise InputError(f"{where}: `{first}` and `{name}` are one parameter of the same layer; name it once")


def _values_of_role(layers: Sequence[int], insulation: int) -> dict[str, int]:
    """Parameter -> index in the values, of the role that layers of one name have; empty where they have none."""
    role = RSI_PREFIX if layers == [insulation] else COATING_PREFIX if layers == [0] else None
    if role is None:
        return {}
    return {name.removeprefix(role): k for name, k in VALUE_INDEX.items() if name.startswith(role)}


def _slot_names(construction: Construction) -> list[str]:
    """Names of the layers that have parameters by them, outermost first, each once."""
    return list(dict.fromkeys(construction.stack.layer_names))[:LAYER_SLOTS]


def _stretch(mesh: Mesh) -> FloatArray:
    """(element,) relative change of the length of each element over that of its layer's thickness [-].

    Sensors at a face of the layer stay there; those within it keep their distance from its outer face, so that only the
    part behind the deepest of them is stretched.
    """
    stretch = np.ones(len(mesh.layer))
    for layer in set(mesh.layer[mesh.layer >= 0]):
        of_layer = np.flatnonzero(mesh.layer == layer)
        behind = of_layer[0] + max(
            (node - of_layer[0] for node in mesh.sensors if of_layer[0] < node <= of_layer[-1]), default=0
        )
        thickness, stretched = np.sum(mesh.length_m[of_layer]), np.sum(mesh.length_m[behind : of_layer[-1] + 1])
        stretch[of_layer] = np.where(of_layer < behind, 0.0, thickness / stretched)
    return stretch


def elements_of(construction: Construction, mesh: Mesh) -> elements.Elements:
    """Elements of a mesh as the lanes of a point take them, lengths [m] and densities [kg/m3] among them.

    A contact resistance has no mass: its density is 0. Heat capacity of an element: docs/theory/equations.md,
    section 3.
    """
    densities = np.array([*(m.density_kg_m3 for m in construction.layer_materials()), 0.0])[mesh.layer]
    named, names = _slot_names(construction), construction.stack.layer_names
    slots = np.array([*(named.index(n) if n in named else -1 for n in names), -1])[mesh.layer]
    return elements.Elements(
        mesh.layer, mesh.length_m, densities, slots, _stretch(mesh), insulation_layer(construction), mesh.bondline
    )


def kernel_effects(model: PointModel) -> list[EffectUse]:
    """Effects of a point that have a kernel, in the order in which they act.

    First those that add to the ratio [-], then factors on it [-], those that depend on the wall temperature last, then
    factors on the emittance [-].

    Effects without a kernel act through parameters of the model. Order: docs/theory/equations.md, section 2.
    """
    return sorted(
        (u for u in model.effects if u.effect.kernel), key=lambda u: (MODES.index(u.effect.mode), u.effect.needs_wall)
    )


def heating_vector(model: PointModel) -> FloatArray:
    """(N_PARAMETERS,) heating parameters of a point in the layout of its lane.

    model : the point, for its parameters, reference condition and effects

    Linear ratio (scale and d0 [-], derivatives [1/deg] or [-]), reference condition [deg] or [-], then the parameters
    of each effect, in slots of fixed width. Equation of the ratio: docs/theory/equations.md, section 2.
    """
    vector = np.zeros(N_PARAMETERS)
    vector[: len(RATIO)] = model.values[: len(RATIO)]
    vector[REFERENCE : REFERENCE + len(RATIO_VARIABLES)] = model.reference
    for k, used in enumerate(kernel_effects(model)):
        first = EFFECT_PARAMETERS + k * EFFECT_WIDTH
        vector[first : first + len(used.values)] = used.values
    return vector


def stack_values(model: PointModel) -> FloatArray:
    """(STACK_WIDTH,) values of the parameters of the stack as its lane takes them (thermal/elements.py).

    model : the point; each parameter in its own unit ([-], [J/kg], [K], [m] ...)

    Moisture parameters: docs/theory/equations_march.md, equation 22.
    """
    return model.values[len(RATIO) :]


def insulation_layer(construction: Construction) -> int:
    """Index of the layer that the parameters `stack.rsi.*` refer to.

    construction : layers, outermost first
    returns      : 1, the insulation behind a coating; 0 in a wall of one layer
    """
    return min(1, len(construction.stack.layer) - 1)


def initial_temperatures(construction: Construction, mesh: Mesh) -> FloatArray:
    """(node,) initial temperatures [K] as the stack declares them: uniform, or a profile linear between its points.

    construction : stack and materials, with the declared start;  mesh : depths of the nodes [m]

    Beyond the ends of a profile its end values are taken. Source: docs/theory/equations_march.md, equation 23.
    """
    stack = construction.stack
    if stack.initial_profile is not None:
        x, temperature = np.array(stack.initial_profile).T
        return np.interp(mesh.depth_m, x, temperature)
    return np.full(mesh.nodes, float(stack.initial_K or 0.0))
