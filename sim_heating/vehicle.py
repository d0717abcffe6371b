"""A vehicle as data: a directory of materials, layer stacks, control points, limits and heating-ratio tables.

    vehicle.toml                 name, reference length and area, the reference heating that all ratios are over
    materials/<NAME>.toml        one material each, whole or `based_on` another one
    control_points/<NAME>.toml   position, stack, sensors, limits, pressure model, ratio table of one point
    ratio_tables/<NAME>.csv      heating ratio in alpha, beta, log10_re, elevon and body flap

The format is told in docs/vehicle_format.md. Loading reads all of it, checks it, and tells all problems at once.
Positions are in m from the nose: x aft, y to starboard, z up.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, ParamSpec, TypeVar

from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from sim_heating.conditions import Conditions, FloatArray
from sim_heating.errors import InputError
from sim_heating.files import (
    Declared,
    LocatedError,
    Location,
    check,
    nearest,
    raise_problems,
    read_toml,
    read_toml_dict,
    shown,
)
from sim_heating.heating_ratio.table import RatioTable, read_ratio_table
from sim_heating.record import STAGNATION, ConstantHeat
from sim_heating.surface_pressure import PressureModel, surface_pressure
from sim_heating.thermal.declare import Construction, Material, Sensor, Stack, Table, construct, sensor_problems

T = TypeVar("T")
P = ParamSpec("P")

FOLDER = "aircraft_data"
ENVIRONMENT = "SIM_HEATING_AIRCRAFT_DATA"
"""Environment variable that names a folder of vehicles."""

NAME = r"[A-Za-z_][A-Za-z0-9_]*"
"""Names of control points: elsewhere they become properties, parameters and folders."""


class ReferenceHeating(Declared):
    """What a heating ratio is over: a model, its nose radius, and the enthalpy of air at the wall."""

    reference: Literal["sutton-graves", "detra-kemp-riddell", "fay-riddell", "eckert-laminar", "eckert-turbulent"]
    nose_radius_m: float | None = Field(default=None, gt=0.0, description="radius of the reference sphere in m")
    wall_enthalpy: Annotated[
        Annotated[Literal["equilibrium-air"], Tag("text")] | Annotated[ConstantHeat, Tag("table")],
        Discriminator(lambda value: "text" if isinstance(value, str) else "table"),
    ] = Field(description='"equilibrium-air" or { cp_J_kgK }')

    @model_validator(mode="after")
    def _check(self) -> ReferenceHeating:
        if self.nose_radius_m is None and self.reference in STAGNATION:
            raise LocatedError((("reference",), f'"{self.reference}" needs `nose_radius_m`; add it'))
        return self


class VehicleFile(Declared):
    """Contents of vehicle.toml."""

    format: Literal["vehicle/1"]
    name: str = Field(min_length=1)
    title: str
    revision: str
    reference_length_m: float = Field(gt=0.0, description="length of the Reynolds number in m")
    reference_area_m2: float = Field(gt=0.0, description="reference area in m2")
    heating: ReferenceHeating
    source: str
    confidence: str
    note: str = ""


class DerivedMaterial(Declared):
    """A material that is another one with some properties replaced or multiplied by a factor."""

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
        """The keys of the derived material; its limit is its own, never inherited."""
        data = base.model_dump()
        data["specific_heat_J_kgK"] = [[T, c * self.specific_heat_factor] for T, c in data["specific_heat_J_kgK"]]
        k = data["conductivity_W_mK"]
        if isinstance(k, dict):
            k["k"] = [[value * self.conductivity_factor for value in row] for row in k["k"]]
        else:
            data["conductivity_W_mK"] = [[T, value * self.conductivity_factor] for T, value in k]
        replaced = {"density_kg_m3": self.density_kg_m3, "emissivity": self.emissivity}
        data.update({key: value for key, value in replaced.items() if value is not None})
        told = {"max_use_K": self.max_use_K, "source": self.source, "confidence": self.confidence, "note": self.note}
        return data | told


class Limits(Declared):
    """Temperatures that a mission may not pass; a point without a bond has no bondline limit."""

    surface_K: float = Field(gt=0.0, description="highest surface temperature in K")
    bondline_K: float | None = Field(default=None, gt=0.0, description="highest bondline temperature in K")
    source: str


class Turbulent(Declared):
    """Turbulent over laminar film coefficient at the point, for effects that switch between them."""

    factor: float = Field(ge=1.0, description="1 or more")
    source: str


class ControlPointFile(Declared):
    """Contents of control_points/<NAME>.toml."""

    name: str = Field(pattern=f"^{NAME}$", description="letters, digits and _, the name of the file")
    title: str
    heat_shield: str = Field(description="kind of heat shield, free text")
    position_m: list[float] = Field(min_length=3, max_length=3, description="[x aft, y starboard, z up] from the nose")
    x_over_L: float = Field(ge=0.0, description="distance from the nose over the reference length")
    running_length_m: float | None = Field(default=None, gt=0.0, description="length of the boundary layer in m")
    ratio_table: str = Field(description="path below the vehicle directory")
    source: str
    confidence: str
    note: str = ""
    stack: Stack
    sensor: list[Sensor] = Field(default=[])
    limits: Limits
    pressure: PressureModel
    turbulent: Turbulent | None = None

    @field_validator("ratio_table")
    @classmethod
    def _check_ratio_table(cls, path: str) -> str:
        if Path(path).is_absolute() or ".." in Path(path).parts:
            raise ValueError(f"`{path}` leads out of the vehicle directory; give a path below it")
        return path

    @model_validator(mode="after")
    def _check(self) -> ControlPointFile:
        problems: list[tuple[Location, str]] = [
            (("sensor", *location), text) for location, text in sensor_problems(self.stack, self.sensor)
        ]
        if self.limits.bondline_K is not None and len(self.stack.layer) == 1:
            problems.append((("limits", "bondline_K"), "a stack of one layer has no bondline; remove it"))
        if problems:
            raise LocatedError(*problems)
        return self


@dataclass(frozen=True)
class ControlPoint:
    """One place of the vehicle's surface, ready to be computed.

    construction     : layer stack with its materials
    sensors          : thermocouples, in the order of the file
    ratio            : heating ratio over the vehicle's reference heating
    running_length_m : length of the boundary layer up to the point [m], None where it has no meaning (leeside)
    turbulent_factor : turbulent over laminar film coefficient [-], None where not declared
    declared         : the file itself, with sources and notes
    """

    name: str
    title: str
    position_m: tuple[float, float, float]
    x_over_L: float
    running_length_m: float | None
    construction: Construction
    sensors: tuple[Sensor, ...]
    limits: Limits
    pressure: PressureModel
    ratio: RatioTable
    turbulent_factor: float | None
    declared: ControlPointFile

    def surface_pressure(self, conditions: Conditions) -> FloatArray:
        """Pressure at the surface of the point along a flight [Pa], one value a sample."""
        return surface_pressure(self.pressure, conditions)


@dataclass(frozen=True)
class Vehicle:
    """A vehicle, read and checked.

    directory          : where it came from
    reference_length_m : length of the Reynolds number [m]
    heating            : what all its ratio tables are over
    control_points     : name -> control point, sorted by name
    materials          : name -> material, all of the vehicle's
    """

    name: str
    title: str
    revision: str
    directory: Path
    reference_length_m: float
    reference_area_m2: float
    heating: ReferenceHeating
    control_points: dict[str, ControlPoint]
    materials: dict[str, Material]
    declared: VehicleFile

    def control_point(self, name: str) -> ControlPoint:
        """The control point of a name.

        raises : InputError that says which name is nearest
        """
        if name not in self.control_points:
            known = nearest(name, self.control_points)
            hint = f"Nearest: `{known}`." if known else f"Known: {', '.join(self.control_points)}."
            raise InputError(f"vehicle {self.name}: there is no control point `{name}`. {hint}")
        return self.control_points[name]


class _Problems:
    """Collects what is wrong in many files, so that all of it can be told at once."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def attempt(self, read: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T | None:
        """The result of a reader, or None where it found problems, which are kept."""
        try:
            return read(*args, **kwargs)
        except InputError as error:
            self.lines += error.problems
            return None

    def add(self, line: str) -> None:
        self.lines.append(line)


def load_vehicle(vehicle: str | os.PathLike[str]) -> Vehicle:
    """Read a vehicle by name or by path and check all of it.

    vehicle : a directory with a vehicle.toml, or a name, looked for as `vehicle_directory` says
    raises  : InputError with one line a problem, those of all files together
    """
    directory = vehicle_directory(vehicle)
    problems = _Problems()
    file = problems.attempt(read_toml, directory / "vehicle.toml", VehicleFile)
    if file is not None and file.name != directory.resolve().name:
        problems.add(f"{shown(directory / 'vehicle.toml')}: `name`: \"{file.name}\" is not the name of its directory")
    materials = _read_materials(directory, problems)
    points = _read_control_points(directory, materials, file, problems)
    raise_problems(problems.lines)
    assert file is not None  # else there was a problem
    return Vehicle(
        name=file.name,
        title=file.title,
        revision=file.revision,
        directory=directory,
        reference_length_m=file.reference_length_m,
        reference_area_m2=file.reference_area_m2,
        heating=file.heating,
        control_points=points,
        materials=materials,
        declared=file,
    )


def vehicle_directory(vehicle: str | os.PathLike[str]) -> Path:
    """The directory of a vehicle.

    A path to a directory with a vehicle.toml (or to that file) is taken as it is. A name is looked for in
    ./aircraft_data, in the folder that SIM_HEATING_AIRCRAFT_DATA names, and in the data that came with the package.
    raises : InputError that names the nearest vehicle
    """
    path = Path(vehicle)
    if path.name == "vehicle.toml" and path.is_file():
        return path.parent
    if (path / "vehicle.toml").is_file():
        return path
    text = os.fspath(vehicle)
    if os.sep in text or "/" in text:
        raise InputError(f"{text}: there is no vehicle here; a vehicle is a directory with a vehicle.toml")
    for folder in vehicle_folders():
        if text and (folder / text / "vehicle.toml").is_file():
            return folder / text
    known = vehicle_names()
    near = nearest(text, known)
    hint = f"Nearest: `{near}`." if near else f"Known: {', '.join(known) or 'none'}; or give a directory."
    raise InputError(f"vehicle `{text}`: there is no vehicle of this name. {hint}")


def vehicle_folders() -> list[Path]:
    """Folders in which vehicles are looked for by name, in that order; those that exist."""
    package = Path(__file__).resolve().parent
    told = os.environ.get(ENVIRONMENT)
    places = [Path(FOLDER), *([Path(told)] if told else []), package / FOLDER, package.parent / FOLDER]
    return [place for place in places if place.is_dir()]


def vehicle_names() -> list[str]:
    """Names of all vehicles that can be loaded by name, sorted."""
    return sorted({p.parent.name for folder in vehicle_folders() for p in folder.glob("*/vehicle.toml")})


def _files(directory: Path, pattern: str, problems: _Problems) -> Iterator[Path]:
    found = sorted(directory.glob(pattern))
    if not found:
        problems.add(f"{shown(directory)}: there is no {pattern}; a vehicle has at least one")
    yield from found


def _read_materials(directory: Path, problems: _Problems) -> dict[str, Material]:
    """All materials of a vehicle, derived ones worked out; faulty ones are told and left out."""
    whole: dict[str, Material] = {}
    derived: dict[str, tuple[Path, DerivedMaterial]] = {}
    for path in _files(directory, "materials/*.toml", problems):
        read = problems.attempt(_read_material, path)
        if isinstance(read, Material):
            whole[path.stem] = read
        elif read is not None:
            derived[path.stem] = (path, read)
    worked_out = {}
    for name, (path, material) in derived.items():
        made = problems.attempt(_derive, path, material, whole)
        if made is not None:
            worked_out[name] = made
    return dict(sorted((whole | worked_out).items()))


def _read_material(path: Path) -> Material | DerivedMaterial:
    data = read_toml_dict(path)
    return check(data, DerivedMaterial if "based_on" in data else Material, shown(path))


def _derive(path: Path, material: DerivedMaterial, whole: Mapping[str, Material]) -> Material:
    if material.based_on not in whole:
        near = nearest(material.based_on, whole)
        hint = f" Nearest: `{near}`." if near else ""
        raise InputError(
            f"{shown(path)}: `based_on`: there is no material `{material.based_on}` that is given whole.{hint}"
        )
    return check(material.apply(whole[material.based_on]), Material, shown(path))


def _read_control_points(
    directory: Path, materials: Mapping[str, Material], vehicle: VehicleFile | None, problems: _Problems
) -> dict[str, ControlPoint]:
    points: dict[str, ControlPoint] = {}
    for path in _files(directory, "control_points/*.toml", problems):
        file = problems.attempt(read_toml, path, ControlPointFile)
        if file is None:
            continue
        if file.name != path.stem:
            problems.add(f'{shown(path)}: `name`: "{file.name}" is not the name of the file')
        construction = problems.attempt(construct, file.stack, materials, shown(path))
        ratio = problems.attempt(_read_ratio, path, file.ratio_table, vehicle)
        if construction is not None and ratio is not None:
            points[file.name] = _control_point(file, construction, ratio)
    for line in _repeated_sensors(directory, points):
        problems.add(line)
    return points


def _read_ratio(owner: Path, ratio_table: str, vehicle: VehicleFile | None) -> RatioTable:
    """The ratio table of a control point file, over the vehicle's own reference heating."""
    path = owner.parent.parent / ratio_table
    if not path.is_file():
        near = nearest(path.name, sorted(p.name for p in path.parent.glob("*.csv")))
        hint = f"Nearest: `{near}`." if near else "Write one, or describe it in ratio_sources and build it."
        raise InputError(f"{shown(owner)}: `ratio_table`: there is no file `{ratio_table}`. {hint}")
    table = read_ratio_table(path)
    declared = table.reference
    if vehicle is not None and declared != vehicle.heating.reference:
        told = f"is `{declared}`" if declared else "is not stated"
        raise InputError(
            f"{shown(path)}, header `reference`: {told}; the vehicle's tables are over `{vehicle.heating.reference}`"
        )
    return table


def _control_point(file: ControlPointFile, construction: Construction, ratio: RatioTable) -> ControlPoint:
    x, y, z = file.position_m
    return ControlPoint(
        name=file.name,
        title=file.title,
        position_m=(x, y, z),
        x_over_L=file.x_over_L,
        running_length_m=file.running_length_m,
        construction=construction,
        sensors=tuple(file.sensor),
        limits=file.limits,
        pressure=file.pressure,
        ratio=ratio,
        turbulent_factor=None if file.turbulent is None else file.turbulent.factor,
        declared=file,
    )


def _repeated_sensors(directory: Path, points: Mapping[str, ControlPoint]) -> list[str]:
    """A sensor's name names it on the whole vehicle."""
    owners: dict[str, str] = {}
    lines = []
    for point in points.values():
        where = shown(directory / "control_points" / f"{point.name}.toml")
        for i, sensor in enumerate(point.sensors):
            first = owners.setdefault(sensor.name, point.name)
            if first != point.name:
                lines.append(f"{where}, [sensor] {i + 1}: `name`: `{sensor.name}` is also one of {first}; rename one")
    return lines
