"""Models of the files of a vehicle directory: vehicle.toml, derived materials, control points.

The format is described in docs/reference/vehicle_format.md; `vehicle.load_vehicle` reads and joins the files. Positions
are in m from the nose: x aft, y to starboard, z up.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from sim_heating.base.files import Declared, LocatedError, Location, path_below, raise_located
from sim_heating.base.files.roots import portable_name
from sim_heating.heating.reference.recovery import RecoveryName
from sim_heating.heating.surface_pressure import PressureModel
from sim_heating.inputs.declared_effects import Catalysis, InterfaceDeclaration, Transition
from sim_heating.inputs.pressure_transducer import PressureTransducer, transducer_problems
from sim_heating.inputs.record import STAGNATION, ConstantHeat, LocalAngle, edge_problems, sweep_problems
from sim_heating.thermal.stack import Material, Sensor, Stack, Table, sensor_problems, sensor_remarks

NAME = r"[A-Za-z_][A-Za-z0-9_]*"
"""Pattern of control point names: they become names of properties, parameters and folders."""


class ReferenceHeating(Declared):
    """Reference heating of a ratio: a model, its nose radius, and the enthalpy of air at the wall.

    reference : model of the reference film coefficient
    """

    reference: Literal[
        "sutton-graves", "detra-kemp-riddell", "fay-riddell", "eckert-laminar", "eckert-turbulent", "swept-cylinder"
    ]
    nose_radius_m: float | None = Field(
        default=None, gt=0.0, description="radius of the reference sphere or cylinder in m"
    )
    sweep_deg: float | None = Field(default=None, ge=0.0, lt=90.0, description="sweep of the reference cylinder")
    wall_enthalpy: Annotated[
        Annotated[Literal["equilibrium-air"], Tag("text")] | Annotated[ConstantHeat, Tag("table")],
        Discriminator(lambda value: "text" if isinstance(value, str) else "table"),
    ] = Field(description='"equilibrium-air" or { cp_J_kgK }')

    @model_validator(mode="after")
    def _check(self) -> ReferenceHeating:
        if self.nose_radius_m is None and self.reference in STAGNATION:
            raise LocatedError((("reference",), f'"{self.reference}" needs `nose_radius_m`; add it'))
        raise_located(sweep_problems(self.reference, self.sweep_deg))
        return self


class FlightLimits(Declared):
    """Limits of a flight beside those of temperature; one that is absent is not limited."""

    dynamic_pressure_Pa: float | None = Field(default=None, gt=0.0, description="highest dynamic pressure in Pa")
    normal_load_g: float | None = Field(default=None, gt=0.0, description="highest aerodynamic load along body z, in g")
    alpha_rate_deg_s: float | None = Field(default=None, gt=0.0, description="fastest change of alpha, deg/s")
    bank_rate_deg_s: float | None = Field(default=None, gt=0.0, description="fastest change of bank, deg/s")


class DeclaredFlightLimits(FlightLimits):
    """Limits of a vehicle's flight, with their source."""

    source: str
    confidence: str


class VehicleFile(Declared):
    """Contents of vehicle.toml.

    name : name of the directory
    revision : revision of the vehicle
    """

    format: Literal["vehicle/1"]
    name: str = Field(min_length=1)
    title: str
    revision: str
    reference_length_m: float = Field(gt=0.0, description="length of the Reynolds number in m")
    reference_area_m2: float = Field(gt=0.0, description="reference area in m2")
    heating: ReferenceHeating
    surroundings: Literal["by stack", "by altitude"] = Field(
        default="by stack", description="`surroundings_K` of the stacks, or sky, ground and air"
    )
    transition: Transition | None = None
    catalysis: dict[str, Catalysis] = Field(default={}, description="by material of an outermost layer")
    flight_limits: DeclaredFlightLimits | None = None
    source: str
    confidence: str
    note: str = ""


class DerivedMaterial(Declared):
    """A material derived from another one, with properties replaced or multiplied by a factor."""

    quantities: ClassVar = {"emissivity": ("T_K", "emissivity")}

    based_on: str = Field(description="name of a material that is given whole")
    density_kg_m3: float | None = Field(default=None, gt=0.0, description="density in kg/m3, above 0")
    emissivity: Table | None = Field(default=None, description="[[T_K, value], ...], value above 0, up to 1")
    specific_heat_factor: float = Field(default=1.0, gt=0.0, description="factor, above 0")
    conductivity_factor: float = Field(default=1.0, gt=0.0, description="factor, above 0")
    max_use_K: float | None = Field(default=None, gt=0.0, description="highest temperature of use in K")
    source: str
    confidence: str
    note: str | None = None

    def apply(self, base: Material) -> dict[str, Any]:
        """The keys of the derived material; `max_use_K` is never inherited."""
        data = base.model_dump()
        data["specific_heat_J_kgK"] = [[T, c * self.specific_heat_factor] for T, c in data["specific_heat_J_kgK"]]
        k = data["conductivity_W_mK"]
        if isinstance(k, dict):
            k["k"] = [[value * self.conductivity_factor for value in row] for row in k["k"]]
        else:
            data["conductivity_W_mK"] = [[T, value * self.conductivity_factor] for T, value in k]
        replaced = {"density_kg_m3": self.density_kg_m3, "emissivity": self.emissivity}
        data.update({key: value for key, value in replaced.items() if value is not None})
        replacing = {
            "max_use_K": self.max_use_K,
            "source": self.source,
            "confidence": self.confidence,
            "note": self.note,
        }
        return data | replacing


class Limits(Declared):
    """Temperature limits of a mission; a point without a bond has no bondline limit."""

    surface_K: float = Field(gt=0.0, description="highest surface temperature in K")
    bondline_K: float | None = Field(default=None, gt=0.0, description="highest bondline temperature in K")
    source: str


class Turbulent(Declared):
    """Turbulent over laminar film coefficient at the point, for transition at a point without a turbulent table."""

    factor: float = Field(ge=1.0, description="1 or more")
    source: str


class DeclaredEffect(Declared):
    """An effect of the declared model of a control point, with the parameters that are not nominal."""

    quantities: ClassVar = {"parameters": None}

    name: str = Field(description="name of an effect")
    parameters: dict[str, float] = Field(default={}, description="values by name; absent ones are nominal")
    source: str = Field(description="the evidence for the effect")


class ControlPointFile(Declared):
    """Contents of control_points/<NAME>.toml."""

    name: Annotated[str, portable_name()] = Field(
        pattern=f"^{NAME}$", description="letters, digits and _, the name of the file"
    )
    title: str
    heat_shield: str = Field(description="kind of heat shield, free text")
    position_m: list[float] = Field(min_length=3, max_length=3, description="[x aft, y starboard, z up] from the nose")
    x_over_L: float = Field(ge=0.0, description="distance from the nose over the reference length")
    running_length_m: float | None = Field(default=None, gt=0.0, description="length of the boundary layer in m")
    ratio_table: Annotated[str, path_below("is outside the vehicle directory; give a path below it")] = Field(
        description="path below the vehicle directory"
    )
    ratio_table_turbulent: (
        Annotated[str, path_below("is outside the vehicle directory; give a path below it")] | None
    ) = Field(default=None, description="path below the vehicle directory")
    recovery: RecoveryName | None = Field(default=None, description="enthalpy that the ratio is reduced with")
    local_angle_deg: LocalAngle = None
    source: str
    confidence: str
    note: str = ""
    stack: Stack
    sensor: list[Sensor] = Field(default=[])
    transducer: list[PressureTransducer] = Field(default=[], description="of the pressure at the surface")
    limits: Limits
    pressure: PressureModel
    turbulent: Turbulent | None = None
    transition: Transition | None = None
    catalysis: Catalysis | None = None
    interface: InterfaceDeclaration | None = None
    effect: list[DeclaredEffect] = Field(default=[])

    def unusual(self) -> list[tuple[Location, str]]:
        """As of all declarations, and sensors within layers that are too thin for them."""
        sensors = [(("sensor", *location), text) for location, text in sensor_remarks(self.stack, self.sensor)]
        return [*super().unusual(), *sensors]

    @model_validator(mode="after")
    def _check(self) -> ControlPointFile:
        problems: list[tuple[Location, str]] = [
            (("sensor", *location), text) for location, text in sensor_problems(self.stack, self.sensor, {})
        ]
        problems += [
            (("transducer", *location), text) for location, text in transducer_problems(self.transducer, self.sensor)
        ]
        problems += edge_problems(self.recovery, self.local_angle_deg)
        if self.limits.bondline_K is not None and len(self.stack.layer) == 1:
            problems.append((("limits", "bondline_K"), "a stack of one layer has no bondline; remove it"))
        raise_located(problems)
        return self
