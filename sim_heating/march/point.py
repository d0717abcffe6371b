"""Model of a control point for the kernels: construction, sensors, ratio table, parameters and effects, and the numbers
that a lane takes from them.
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
from sim_heating.base.parameters import BOUNDARY, EFFECT_PREFIX, MODEL, RATIO, Parameter
from sim_heating.heating.effects import EffectUse, check_count
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.thermal.elements import BOILS, CONDENSES, DEPOSITED, LATENT_HEAT, WIDTH, Elements
from sim_heating.thermal.mesh import Mesh
from sim_heating.thermal.stack import BackFace, Construction
from sim_heating.thermal.tables import WallEnthalpy

MODES = ("add", "multiply", "emittance")
"""Effects with a kernel, in the order in which they act."""
COATING_PREFIX = "stack.coating."
BACK = ("back.h_W_m2K", "back.T_K", "back.emissivity")
MOISTURE = (LATENT_HEAT, BOILS, DEPOSITED, CONDENSES, WIDTH)
MOISTURE_RUNAWAY = "moisture gives off more heat as it condenses than takes to warm what it condenses in"
CONDENSATION_WIDTHS = 8.0
"""Widths about its condensation temperature outside of which moisture condenses to less than 1e-3."""
VALUE_INDEX = {name: k for k, name in enumerate(MODEL)}
"""Index of each parameter in PointModel.values."""


def _unknown(point: str, name: str, known: Iterable[str]) -> str:
    return f"{point}: unknown parameter `{name}`{suggestion(name, known, otherwise='')}"


@dataclass(frozen=True)
class PointModel:
    """One control point: construction, sensors, heating ratio, parameters and effects.

    name          : for messages and columns
    construction  : stack and materials
    depths_m      : depths of the sensors from the outer surface [m]; each gets a node
    ratio         : declared ratio table [-], or None for ratio.d0 alone
    wall_enthalpy : constant cp [J/(kg K)] or the name of a gas model
    nodes         : number of nodes, or None to have it chosen
    parameters    : dotted name -> value, in the unit of the parameter, where not nominal
    reference     : values of the five ratio variables about which derivatives are defined [deg, deg, -, deg, deg]
    effects       : effects with their parameters
    lags_s        : time constants of the sensors' first-order lags [s], in the order of the depths; empty for none
    raises        : InputError for unknown parameters and values out of bounds, sensors outside the stack, cp not above
                    0, two effects with a lag, ratio.d0 with a table, moisture without a unique temperature

    Heating ratio: docs/equations.md, section 2.
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

    @property
    def runs_away(self) -> bool:
        """Whether condensing moisture would release more heat than warms the material that it condenses in.

            c(T) + (L u (1 - u) - D v (1 - v)) / w <= 0,    u, v logistic about the boiling and condensation
            temperatures

        at one of 81 temperatures over T_condense +- 8 w [K]; L, D latent and deposited heat [J/kg], w the width [K], c
        the specific heat of the insulation [J/(kg K)]. The temperature would jump there and a step have no unique
        solution. Derived in docs/equations_march.md, equation 22.
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
        """(parameter,) all parameters of heating ratio and stack, each in its own unit ([-], [1/deg], [K] ...).

        Nominal, then `back.*` as the stack declares, then those that an effect sets, the first such effect prevailing.
        Heating ratio: docs/equations.md, section 2; factors and moisture: docs/equations_march.md, equations 9, 10 and
        22.
        """
        values = np.array([self.parameters.get(name, p.value) for name, p in MODEL.items()], dtype=float)
        for name in BACK:
            if name not in self.parameters:
                values[VALUE_INDEX[name]] = self._declared_back(name)
        # Reversed, so that of two effects which set one parameter the first prevails.
        for used in reversed(self.effects):
            for place, value in zip(used.effect.model_parameters, used.values, strict=False):
                if place in VALUE_INDEX:
                    values[VALUE_INDEX[place]] = value
        return values

    def value(self, name: str) -> float:
        """Value of one parameter in its own unit ([-], [K], [m] ...), nominal where it is not set.

        name   : dotted name, also `effect.NAME.PARAMETER`
        raises : InputError with the nearest name where the model has no such effect parameter

        Ratio parameters: docs/equations.md, section 2.
        """
        if name.startswith(EFFECT_PREFIX):
            use, k = self._effect_parameter(name)
            return float(self.effects[use].values[k])
        return float(self.values[VALUE_INDEX[name]])

    def _declared_back(self, name: str) -> float:
        back = self.construction.stack.back
        declared = getattr(back, name.removeprefix("back.")) if isinstance(back, BackFace) else None
        return float(MODEL[name].value if declared is None else declared)

    def definition(self, name: str) -> Parameter:
        """Definition of a parameter of this model: unit ([-], [K] ...), nominal value, prior, bounds, description.

        The scale of its perturbation is the prior's sigma: docs/equations_march.md, equation 9.

        name   : dotted name, also `effect.NAME.PARAMETER`
        raises : InputError with the nearest name where the model has no such parameter, or for a coating in a wall of
                 one layer
        """
        if name.startswith(EFFECT_PREFIX):
            use, k = self._effect_parameter(name)
            return self.effects[use].definitions[k]
        if name not in MODEL:
            raise InputError(_unknown(self.name, name, MODEL))
        if name.startswith(COATING_PREFIX) and insulation_layer(self.construction) == 0:
            raise InputError(f"{self.name}: `{name}`: a wall of one layer has no coating; its layer is `stack.rsi.*`")
        return MODEL[name]

    def at_faces(self, name: str) -> bool:
        """Whether a parameter changes only the heat that enters at the faces [W/m2], and nothing within the wall.

        name : dotted name, also `effect.NAME.PARAMETER`

        Its sensitivity then needs no rows of the interior: docs/equations_march.md, equation 13.
        """
        if name.startswith(EFFECT_PREFIX):
            use, k = self._effect_parameter(name)
            effect = self.effects[use].effect
            return effect.kernel is not None or effect.model_parameters[k] in BOUNDARY
        return name in BOUNDARY

    def _effect_parameter(self, name: str) -> tuple[int, int]:
        known = {
            f"{EFFECT_PREFIX}{use.effect.name}.{p.name}": (i, k)
            for i, use in enumerate(self.effects)
            for k, p in enumerate(use.effect.parameters)
        }
        if name not in known:
            raise InputError(_unknown(self.name, name, known))
        return known[name]

    def with_parameters(self, values: Mapping[str, float]) -> PointModel:
        """Copy of the point with parameters set by their dotted names.

        values : dotted name -> value, in the unit of the parameter ([-], [K] ...); within its bounds or beyond, as
                 values are not checked
        raises : InputError with the nearest name where the model has no such parameter

        The caller checks bounds, because derivatives perturb parameters that are at a bound
        (docs/equations_march.md, equation 9).
        """
        parameters, effects = dict(self.parameters), [list(use.values) for use in self.effects]
        for name, value in values.items():
            if name.startswith(EFFECT_PREFIX):
                use, k = self._effect_parameter(name)
                effects[use][k] = value
            else:
                self.definition(name)
                parameters[name] = value
        used = tuple(replace(u, values=tuple(v)) for u, v in zip(self.effects, effects, strict=True))
        return self._unchecked(parameters=parameters, effects=used)

    def without_effects(self, names: Collection[str]) -> PointModel:
        """The point without those of its effects that bear one of these names."""
        kept = tuple(used for used in self.effects if used.effect.name not in names)
        return self if len(kept) == len(self.effects) else replace(self, effects=kept)

    def with_lags(self, lags_s: Sequence[float]) -> PointModel:
        """Copy of the point with other time constants of its sensors [s]; parameters beyond their bounds stay so.

        Lag: docs/equations.md, section 5.
        """
        return self._unchecked(lags_s=tuple(lags_s))

    def _unchecked(self, **changes: object) -> PointModel:
        # Not dataclasses.replace: that would check bounds, which a difference may have to exceed.
        other = copy.copy(self)
        other.__dict__.pop("values", None)
        for name, value in changes.items():
            object.__setattr__(other, name, value)
        return other


def elements_of(construction: Construction, mesh: Mesh) -> Elements:
    """Elements of a mesh as the lanes of a point take them, lengths [m] and densities [kg/m3] among them.

    A contact resistance has no mass: its density is 0. Heat capacity of an element: docs/equations.md, section 3.
    """
    densities = np.array([*(m.density_kg_m3 for m in construction.layer_materials()), 0.0])[mesh.layer]
    return Elements(mesh.layer, mesh.length_m, densities, insulation_layer(construction), mesh.bondline)


def kernel_effects(model: PointModel) -> list[EffectUse]:
    """Effects of a point that have a kernel, in the order in which they act.

    First those that add to the ratio [-], then factors on it [-], those that depend on the wall temperature last, then
    factors on the emittance [-].

    Effects without a kernel act through parameters of the model. Order: docs/equations.md, section 2.
    """
    return sorted(
        (u for u in model.effects if u.effect.kernel), key=lambda u: (MODES.index(u.effect.mode), u.effect.needs_wall)
    )


def heating_vector(model: PointModel) -> FloatArray:
    """(N_PARAMETERS,) heating parameters of a point in the layout of its lane.

    model : the point, for its parameters, reference condition and effects

    Linear ratio (scale and d0 [-], derivatives [1/deg] or [-]), reference condition [deg] or [-], then the parameters
    of each effect, in slots of fixed width. Equation of the ratio: docs/equations.md, section 2.
    """
    vector = np.zeros(N_PARAMETERS)
    vector[: len(RATIO)] = model.values[: len(RATIO)]
    vector[REFERENCE : REFERENCE + len(RATIO_VARIABLES)] = model.reference
    for k, used in enumerate(kernel_effects(model)):
        first = EFFECT_PARAMETERS + k * EFFECT_WIDTH
        vector[first : first + len(used.values)] = used.values
    return vector


def stack_values(model: PointModel) -> FloatArray:
    """(parameter,) values of the parameters of the stack, in the order of `parameters.STACK`.

    model : the point; each parameter in its own unit ([-], [J/kg], [K], [m] ...)

    Moisture parameters: docs/equations_march.md, equation 22.
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

    Beyond the ends of a profile its end values are taken. Source: docs/equations_march.md, equation 23.
    """
    stack = construction.stack
    if stack.initial_profile is not None:
        x, temperature = np.array(stack.initial_profile).T
        return np.interp(mesh.depth_m, x, temperature)
    return np.full(mesh.nodes, float(stack.initial_K or 0.0))
