"""A vehicle as data: a directory of materials, layer stacks, control points, limits and heating-ratio tables.

    vehicle.toml                 name, reference length and area, the reference heating that all ratios are over
    materials/<NAME>.toml        one material each, whole or `based_on` another one
    control_points/<NAME>.toml   position, stack, sensors, limits, pressure model, ratio table of one point
    ratio_tables/<NAME>.csv      heating ratio in alpha, beta, log10_re, elevon and body flap

The format is described in docs/reference/vehicle_format.md. Loading reads and checks all of it and reports all problems
at once. Positions are in m from the nose: x aft, y to starboard, z up.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ParamSpec, TypeVar

from sim_heating.base import files
from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import SURFACES, Conditions
from sim_heating.base.errors import InputError, error_context, tell
from sim_heating.base.files import display_path, suggestion
from sim_heating.base.files.package import data_folders
from sim_heating.base.files.paths import real_path
from sim_heating.base.files.toml import remarks_of
from sim_heating.heating.edge_flow import EdgeFlow, edge_flow
from sim_heating.heating.effects import EffectUse, check_count, combined_uses, use
from sim_heating.heating.ratio.table import RatioTable, depends_on, read_ratio_table
from sim_heating.heating.reference.recovery import Recovery
from sim_heating.heating.surface_pressure import ModifiedNewtonian, PressureModel, surface_pressure
from sim_heating.inputs.declared_effects import Catalysis, Transition, turbulent_recovery
from sim_heating.inputs.record import LINE, SWEPT, declared_recovery
from sim_heating.inputs.vehicle_files import ControlPointFile, DerivedMaterial, Limits, ReferenceHeating, VehicleFile
from sim_heating.thermal.stack import Construction, Material, Sensor, construct, sensor_problems

T = TypeVar("T")
P = ParamSpec("P")

SUFFIXES = (".toml", ".csv", ".json", ".xml")
"""Kinds of files of a vehicle that a computation may read."""
REVIEWS = "credibility.toml"
"""File of signed reviews, which names the digest of the other files."""
FOLDER = "aircraft_data"
ENVIRONMENT = "SIM_HEATING_AIRCRAFT_DATA"
"""Environment variable that names a folder of vehicles."""
FAR, NEAR_NOSE = 100.0, 0.02
"""Factor between distances from the nose that is no rounding of a place, and x_over_L below which they say nothing."""
READINGS = 20
"""How often a vehicle is read that other processes change during the reading."""


@dataclass(frozen=True)
class ControlPoint:
    """One place of the vehicle's surface, ready for computation.

    construction     : layer stack with its materials
    sensors          : thermocouples, in the order of the file
    ratio            : heating ratio over the vehicle's reference heating
    recovery         : enthalpy that the ratio is reduced with, and the surface that its edge follows from
    running_length_m : length of the boundary layer up to the point [m], None where it has no meaning (leeside)
    turbulent_factor : turbulent over laminar film coefficient [-], None where not declared
    effects          : effects of the declared model: transition, recombination, and those of its file
    flow             : what these effects ask of the flow at its edge, with its laminar and turbulent tables
    transition       : declaration of its transition, of its own file or of the vehicle's; None without
    catalysis        : declaration of its recombination, likewise
    declared         : contents of the file, with sources and notes
    upstream         : layers of the wall upstream that its interface declares; None where that is a control point
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
    recovery: Recovery
    turbulent_factor: float | None
    effects: tuple[EffectUse, ...]
    flow: EdgeFlow
    transition: Transition | None
    catalysis: Catalysis | None
    declared: ControlPointFile
    upstream: Construction | None = None

    @property
    def wall_upstream(self) -> ControlPoint | None:
        """The wall of the stack that its interface declares upstream, heated as the point is; None without one."""
        if self.upstream is None or self.declared.interface is None:
            return None
        declared = self.declared.model_copy(update={"interface": None})
        name = self.declared.interface.upstream
        return replace(self, name=name, construction=self.upstream, sensors=(), declared=declared, upstream=None)

    def surface_pressure(self, conditions: Conditions) -> FloatArray:
        """Pressure at the surface of the point along a flight [Pa], one value a sample."""
        return surface_pressure(self.pressure, conditions)

    @property
    def surfaces(self) -> tuple[str, ...]:
        """Columns of the control surfaces on which the heating or the pressure of the point depends."""
        turns = (self.recovery.elevon_factor, self.recovery.bodyflap_factor)
        if isinstance(self.pressure, ModifiedNewtonian):
            turns = (self.pressure.elevon_factor, self.pressure.bodyflap_factor)
        tables = (self.ratio, self.flow.laminar, self.flow.turbulent)
        needed = {name for used in self.effects for name in used.effect.needs}
        turned = (n for n, k in zip(SURFACES, turns, strict=True) if k != 0.0 or n in needed or depends_on(n, *tables))
        return tuple(turned)

    def without_effects(self, names: Collection[str]) -> ControlPoint:
        """The point without those of its declared effects that bear one of these names; what the flow at its edge is
        asked for remains, so that another effect may read it."""
        return replace(self, effects=tuple(used for used in self.effects if used.effect.name not in names))


@dataclass(frozen=True)
class Vehicle:
    """A vehicle, read and checked.

    directory          : folder that it was read from
    reference_length_m : length of the Reynolds number [m]
    heating            : reference heating of all its ratio tables
    control_points     : name -> control point, sorted by name
    materials          : name -> material
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

    def __repr__(self) -> str:
        return f"<Vehicle {self.name!r}, revision {self.revision}: {len(self.control_points)} control points>"

    @property
    def surfaces(self) -> tuple[str, ...]:
        """Columns of the control surfaces on which the heating of any of its points depends: by its ratio tables, or as
        it turns the surface."""
        needed = {name for point in self.control_points.values() for name in point.surfaces}
        return tuple(name for name in SURFACES if name in needed)

    def without_effects(self, names: Collection[str]) -> Vehicle:
        """The vehicle without those of its declared effects that bear one of these names."""
        if not names:
            return self
        points = {name: point.without_effects(names) for name, point in self.control_points.items()}
        return replace(self, control_points=points)

    def control_point(self, name: str) -> ControlPoint:
        """The control point of a name.

        raises : InputError with the most similar name
        """
        if name not in self.control_points:
            hint = suggestion(name, self.control_points)
            raise InputError(f"vehicle {self.name}: there is no control point `{name}`{hint}")
        return self.control_points[name]


class _Problems:
    """Collects the problems of many files, so that they can be reported at once."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def attempt(self, read: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T | None:
        """The result of a reader, or None where it found problems, which are collected."""
        try:
            return read(*args, **kwargs)
        except InputError as error:
            self.lines += error.problems
            return None

    def add(self, line: str) -> None:
        self.lines.append(line)

    def add_all(self, lines: Iterable[str]) -> None:
        self.lines.extend(lines)


def load_vehicle(vehicle: str | os.PathLike[str] | Vehicle, *, root: str | os.PathLike[str] | None = None) -> Vehicle:
    """Read a vehicle by name or by path and check all of it.

    vehicle : a directory with a vehicle.toml, or a name that `vehicle_directory` looks up; a vehicle that has been
              loaded is returned as it is
    root    : folder that symbolic links in it may lead to; by default as docs/reference/scenario_format.md states
    raises  : InputError with the problems of all files, one line each

    Files that another process replaces in the meantime, as `update-tables` does, are read again.

    >>> import sim_heating as sh
    >>> len(sh.load_vehicle("orbiter").control_points)
    20
    """
    if isinstance(vehicle, Vehicle):
        return vehicle
    directory = checked_directory(vehicle, root)
    for _ in range(READINGS):
        files.settle(directory)
        before = _change_times(directory)
        try:
            loaded = _load(directory)
        except InputError:
            if _change_times(directory) == before:
                raise
        else:
            if _change_times(directory) == before:
                return loaded
    raise InputError(f"{display_path(directory)}: other processes keep changing it; wait until they end")


def checked_directory(vehicle: str | os.PathLike[str], root: str | os.PathLike[str] | None = None) -> Path:
    """The folder of a vehicle by name or by path, none of whose symbolic links leads out of `root`.

    raises : InputError where there is no such vehicle, or a link leads elsewhere
    """
    directory = vehicle_directory(vehicle)
    # Once for all of its files: those of aerodynamics, guidance and attitude control are read when it flies.
    files.roots_of(directory / "vehicle.toml", root).check_links(directory)
    return directory


def _change_times(directory: Path) -> list[int]:
    """When files came into or went out of the folders of a vehicle, as they do where a revision is written [ns]."""
    with suppress(OSError):
        folders = [p for p in sorted(directory.iterdir()) if p.is_dir() and not p.name.startswith(".")]
        return [p.stat().st_mtime_ns for p in folders]
    return []


def _load(directory: Path) -> Vehicle:
    """A vehicle from its files, all of it checked."""
    problems = _Problems()
    file = problems.attempt(files.read_toml, directory / "vehicle.toml", VehicleFile)
    if file is not None and file.name != (folder_name := real_path(directory).name):
        problems.add(
            f'{display_path(directory / "vehicle.toml")}: `name`: "{file.name}" is not the name of its directory; '
            f'write "{folder_name}", or rename the directory'
        )
    materials, invalid = _read_materials(directory, problems)
    points = _read_control_points(directory, materials, invalid, file, problems)
    files.raise_problems(problems.lines)
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


def upstream_point(vehicle: Vehicle, point: ControlPoint) -> ControlPoint | None:
    """The wall upstream of the interface of a control point, as a control point; None without an interface."""
    interface = point.declared.interface
    if interface is None:
        return None
    return point.wall_upstream or vehicle.control_point(interface.upstream)


def walls_upstream(vehicle: Vehicle, points: Sequence[ControlPoint]) -> list[ControlPoint]:
    """Control points upstream of the interfaces of others, which are not among these, nearest first."""
    marched: set[str] = {p.name for p in points}
    added: list[ControlPoint] = []
    waiting = list(points)
    while waiting:
        upstream = upstream_point(vehicle, waiting.pop(0))
        if upstream is not None and upstream.name not in marched:
            marched.add(upstream.name)
            added.append(upstream)
            waiting.append(upstream)
    return added


def numbers_upstream(vehicle: Vehicle, points: Sequence[ControlPoint]) -> dict[int, int]:
    """Number of each control point behind an interface -> that of the wall upstream of it, one of the points too."""
    number = {point.name: i for i, point in enumerate(points)}
    upstream = [upstream_point(vehicle, point) for point in points]
    return {i: number[wall.name] for i, wall in enumerate(upstream) if wall is not None}


def vehicle_directory(vehicle: str | os.PathLike[str]) -> Path:
    """The directory of a vehicle.

    A path to a directory with a vehicle.toml (or to that file) is used directly. A name is searched for in
    ./aircraft_data, in the folder that SIM_HEATING_AIRCRAFT_DATA names, and in the data installed with the package.

    raises : InputError with the most similar vehicle
    """
    path = Path(vehicle)
    if path.name == "vehicle.toml" and os.path.isfile(path):
        return path.parent
    if os.path.isfile(path / "vehicle.toml"):  # Path.is_file raises where a name is too long for the system
        return path
    text = os.fspath(vehicle)
    if os.sep in text or "/" in text:
        reason = "the directory has no vehicle.toml" if os.path.isdir(path) else "there is no such directory"
        raise InputError(f"{text}: not a vehicle; {reason}")
    for folder in vehicle_folders():
        if text and os.path.isfile(folder / text / "vehicle.toml"):
            return folder / text
    names = vehicle_names()
    directory = f"; known: {', '.join(names) or 'none'}; or give a directory"
    raise InputError(f"vehicle `{text}`: unknown vehicle{suggestion(text, names, otherwise=directory)}")


def vehicle_place(file: Path, vehicle: str, key: str = "`vehicle`", root: str | os.PathLike[str] | None = None) -> Path:
    """Directory of a vehicle that a file names: relative to the file or to the working directory, else by its name.

    key    : table and key that name it, for messages
    root   : as `load_vehicle` takes it
    raises : InputError naming file and key where there is no such vehicle, or not in a folder that the file may name
    """
    if os.path.isfile(file.parent / vehicle / "vehicle.toml"):
        return files.roots_of(file, root).named(vehicle, key)
    if os.path.isfile(Path(vehicle) / "vehicle.toml"):
        return files.roots_of(file, root).named(vehicle, key, Path())
    with error_context(f"{display_path(file)}: {key}"):
        return vehicle_directory(vehicle)


def add_vehicle_files(digest: hashlib._Hash, directory: Path) -> None:
    """Add names and contents of all files of a vehicle that a computation may read to a digest."""
    readable = (p for p in directory.rglob("*") if p.suffix in SUFFIXES and p.is_file() and p.name[0] != ".")
    inputs = (p for p in readable if p.name != REVIEWS)
    for path in sorted(inputs):
        digest.update(path.relative_to(directory).as_posix().encode())
        digest.update(path.read_bytes())


def vehicle_folders() -> list[Path]:
    """Existing folders that are searched for vehicles by name, in this order."""
    named = os.environ.get(ENVIRONMENT)
    folders = [Path(FOLDER), *([Path(named)] if named else []), *data_folders(FOLDER)]
    return [folder for folder in folders if folder.is_dir()]


def vehicle_names() -> list[str]:
    """Names of all vehicles that can be loaded by name, sorted."""
    return sorted({p.parent.name for folder in vehicle_folders() for p in folder.glob("*/vehicle.toml")})


def library_materials() -> dict[str, Material]:
    """Materials of all vehicles that can be loaded by name; of two of one name that of the first vehicle by name.

    Files that are damaged are left out: they are errors of the vehicle that needs them.
    """
    by_name: dict[str, Material] = {}
    for name in vehicle_names():
        with suppress(InputError):
            directory = vehicle_directory(name)
            files.roots_of(directory / "vehicle.toml").check_links(directory)
            by_name = {**_read_materials(directory, _Problems())[0], **by_name}
    return by_name


def known_control_point(vehicle: str, point: str) -> ControlPoint | None:
    """A control point of a vehicle that is found by name; None where there is none of these names, or no readable one.

    A name is no path here: that a record names a vehicle opens no file of its author's choice.
    """
    if vehicle not in vehicle_names():
        return None
    # Reading a vehicle takes 0.2 s, which a record of another point need not wait for.
    if f"{point}.toml" not in os.listdir(vehicle_directory(vehicle) / "control_points"):
        return None
    with suppress(InputError):
        return load_vehicle(vehicle).control_points.get(point)
    return None


def _files(directory: Path, pattern: str, problems: _Problems) -> Iterator[Path]:
    matching = sorted(directory.glob(pattern))
    if not matching:
        problems.add(f"{display_path(directory)}: there is no {pattern}; a vehicle has at least one")
    yield from matching


def _read_materials(directory: Path, problems: _Problems) -> tuple[dict[str, Material], frozenset[str]]:
    """All materials of a vehicle, derived ones evaluated, and the names of invalid ones, which are reported."""
    complete: dict[str, Material] = {}
    derived: dict[str, tuple[Path, DerivedMaterial]] = {}
    invalid: set[str] = set()
    for path in _files(directory, "materials/*.toml", problems):
        read = problems.attempt(_read_material, path)
        if isinstance(read, Material):
            complete[path.stem] = read
        elif read is not None:
            derived[path.stem] = (path, read)
        else:
            invalid.add(path.stem)
    evaluated = {}
    for name, (path, material) in derived.items():
        evaluated_material = (
            None if material.based_on in invalid else problems.attempt(_derive, path, material, complete)
        )
        if evaluated_material is None:
            invalid.add(name)
        else:
            evaluated[name] = evaluated_material
    return dict(sorted((complete | evaluated).items())), frozenset(invalid)


def _read_material(path: Path) -> Material | DerivedMaterial:
    data = files.read_toml_dict(path)
    if "based_on" in data:
        return files.check(data, DerivedMaterial, display_path(path))
    return files.check(data, Material, display_path(path))


def _derive(path: Path, material: DerivedMaterial, complete: Mapping[str, Material]) -> Material:
    if material.based_on not in complete:
        hint = suggestion(material.based_on, complete, otherwise="")
        raise InputError(
            f"{display_path(path)}: `based_on`: `{material.based_on}` is not a material that is given whole{hint}"
        )
    base = complete[material.based_on]
    data, where = material.apply(base), display_path(path)
    derived = files.check(data, Material, where, tells=False)
    tell(remarks_of(derived, data, where, told={location for location, _ in base.unusual()}))
    return derived


def _read_control_points(
    directory: Path,
    materials: Mapping[str, Material],
    invalid: frozenset[str],
    vehicle: VehicleFile | None,
    problems: _Problems,
) -> dict[str, ControlPoint]:
    """All control points of a vehicle; of one with an invalid material, only the material's problem is reported."""
    points: dict[str, ControlPoint] = {}
    tables: list[tuple[str, str, RatioTable]] = []
    for path in _files(directory, "control_points/*.toml", problems):
        file = problems.attempt(files.read_toml, path, ControlPointFile)
        if file is None:
            continue
        point, of_point = _read_control_point(path, file, materials, invalid, vehicle, problems)
        tables += of_point
        if point is not None:
            points[file.name] = point
    if len(points) == len(list(directory.glob("control_points/*.toml"))):
        problems.add_all(_interface_problems(directory, points))
    problems.add_all((*_repeated_sensors(directory, points), *_tables_of_others(directory, tables)))
    return points


def _read_control_point(
    path: Path,
    file: ControlPointFile,
    materials: Mapping[str, Material],
    invalid: frozenset[str],
    vehicle: VehicleFile | None,
    problems: _Problems,
) -> tuple[ControlPoint | None, list[tuple[str, str, RatioTable]]]:
    """A control point, None where it has problems, and its tables that can be read, by point and file."""
    _check_declaration(path, file, vehicle, problems)
    construction = None
    if invalid.isdisjoint(layer.material for layer in file.stack.layer):
        construction = problems.attempt(_construct_wall, file, materials, display_path(path))
    recovery = recovery_of(file, None if vehicle is None else vehicle.heating)
    ratio = problems.attempt(_read_ratio, path, file.ratio_table, vehicle, recovery)
    turbulent = problems.attempt(_read_turbulent, path, file, vehicle, recovery)
    tables = [] if ratio is None else [(file.name, file.ratio_table, ratio)]
    tables += [(file.name, file.ratio_table_turbulent or "", table) for table in turbulent or ()]
    effects = problems.attempt(_effects, path, file, vehicle)
    if construction is None or ratio is None or turbulent is None or effects is None:
        return None, tables
    flow = problems.attempt(_flow, path, file, vehicle, recovery, effects, (ratio, *turbulent))
    if flow is None:
        return None, tables
    declared = (_transition(file, vehicle), _catalysis(file, vehicle))
    control_point = _control_point(file, construction, ratio, effects, flow, *declared)
    return replace(control_point, upstream=_upstream(path, file, materials, invalid, problems)), tables


def _check_declaration(path: Path, file: ControlPointFile, vehicle: VehicleFile | None, problems: _Problems) -> None:
    """Report where the declaration of a control point fits neither its file nor its vehicle."""
    if file.name != path.stem:
        problems.add(f'{display_path(path)}: `name`: "{file.name}" is not the name of the file')
    if vehicle is not None:
        problems.add_all(_vehicle_problems(path, file, vehicle))
        tell(_position_remarks(path, file, vehicle))


def _vehicle_problems(path: Path, file: ControlPointFile, vehicle: VehicleFile) -> Iterator[str]:
    """Where a control point does not fit its vehicle: its position, and the sweep that its recovery needs."""
    yield from _position_problems(path, file, vehicle)
    if file.recovery == LINE and vehicle.heating.sweep_deg is None:
        rule = f'"{LINE}" needs the sweep of "{SWEPT}", which the [heating] of vehicle.toml does not have'
        yield f"{display_path(path)}: `recovery`: {rule}"


def _upstream(
    path: Path, file: ControlPointFile, materials: Mapping[str, Material], invalid: frozenset[str], problems: _Problems
) -> Construction | None:
    """The wall ahead of the interface of a control point; None where it declares none, or an invalid material."""
    stack = None if file.interface is None else file.interface.stack
    if stack is None or not invalid.isdisjoint(layer.material for layer in stack.layer):
        return None
    return problems.attempt(construct, stack, materials, f"{display_path(path)}, [interface]")


def _wall_met_again(points: Mapping[str, ControlPoint], name: str, upstream: str) -> str:
    """The first wall that interfaces from a point upstream lead to twice; empty where they end."""
    passed = [name]
    while upstream in points and upstream not in passed:
        passed.append(upstream)
        above = points[upstream].declared.interface
        upstream = "" if above is None else above.upstream
    return upstream if upstream in passed else ""


def _interface_problems(directory: Path, points: Mapping[str, ControlPoint]) -> list[str]:
    """Interfaces whose wall upstream is no control point, or in the end the point itself; transition that is not
    there."""
    problems = []
    for name, point in points.items():
        if (interface := point.declared.interface) is None or point.upstream is not None:
            continue
        where = f"{display_path(directory / 'control_points' / name)}.toml, [interface]"
        if again := _wall_met_again(points, name, interface.upstream):
            problems.append(f"{where}: `upstream`: `{interface.upstream}` leads back to {again}; name another wall")
        elif interface.upstream not in points:
            hint = suggestion(interface.upstream, points)
            problems.append(f"{where}: `upstream`: there is no control point `{interface.upstream}`{hint}")
        if interface.flow == "declared transition" and point.transition is None:
            problems.append(f"{where}: `flow`: the point declares no transition; give laminar or turbulent")
    return problems


def _tables_of_others(directory: Path, tables: Sequence[tuple[str, str, RatioTable]]) -> list[str]:
    """Tables that state another control point of the vehicle, which has a table of its own.

    tables : control point, file, table; points that share one file may do so
    """
    problems = []
    for name, file, table in tables:
        stated = table.header.get("control_point", name)
        if any(other == stated for other, _, _ in tables) and (stated, file) not in {(o, f) for o, f, _ in tables}:
            problems.append(
                f"{display_path(directory / file)}, header `control_point`: `{stated}`, but it is the table of {name}; "
                f"put back the file of {name}, or correct the header"
            )
    return problems


AWAY = 0.2
"""Difference of x_over_L and the position over the reference length that noses and body flaps do not explain."""


def _position_remarks(path: Path, file: ControlPointFile, vehicle: VehicleFile) -> list[str]:
    """A position that is not where the distance over the reference length says."""
    x, length = file.position_m[0], vehicle.reference_length_m
    if abs(x / length - file.x_over_L) <= AWAY:
        return []
    position = f"position_m has x = {x:g} m, {x / length:.3g} of reference_length_m = {length:g}"
    return [f"{display_path(path)}: x_over_L is {file.x_over_L:g}, and {position}; check them"]


def _position_problems(path: Path, file: ControlPointFile, vehicle: VehicleFile) -> list[str]:
    """A position far from the distance from the nose that x_over_L states."""
    away, L = math.hypot(*file.position_m), vehicle.reference_length_m
    distance = file.x_over_L * L
    if away <= FAR * max(distance, L) and (file.x_over_L < NEAR_NOSE or distance <= FAR * away):
        return []
    stated = f"{away:g} m from the nose, x_over_L = {file.x_over_L:g} of reference_length_m = {L:g} is {distance:g} m"
    return [f"{display_path(path)}: `position_m`: {stated}; correct one of the three"]


def recovery_of(file: ControlPointFile, heating: ReferenceHeating | None) -> Recovery:
    """Recovery enthalpy of a control point; a control surface turns with the deflection as in its pressure model.

    heating : reference heating of the vehicle, None where unknown
    """
    pressure = file.pressure
    turns = (pressure.elevon_factor, pressure.bodyflap_factor) if isinstance(pressure, ModifiedNewtonian) else ()
    reference, sweep_deg = ("none", None) if heating is None else (heating.reference, heating.sweep_deg)
    elevon, bodyflap = turns or (0.0, 0.0)
    return declared_recovery(file.recovery, file.local_angle_deg, reference, elevon, bodyflap, sweep_deg)


def _construct_wall(file: ControlPointFile, materials: Mapping[str, Material], where: str) -> Construction:
    """The wall of a control point; refuses a sensor within a layer of gas, which the file alone does not show."""
    construction = construct(file.stack, materials, where)
    for (i, key), text in sensor_problems(file.stack, file.sensor, construction.materials):
        raise InputError(f"{where}: `sensor[{i}].{key}`: {text}")
    return construction


def _read_ratio(
    owner: Path, ratio_table: str, vehicle: VehicleFile | None, recovery: Recovery, key: str = "ratio_table"
) -> RatioTable:
    """The ratio table of a control point file, over the vehicle's own reference heating and the point's recovery."""
    path = owner.parent.parent / ratio_table
    if not os.path.isfile(path):
        describe = "; write one, or describe it in ratio_sources and build it"
        hint = suggestion(path.name, sorted(p.name for p in path.parent.glob("*.csv")), otherwise=describe)
        raise InputError(f"{display_path(owner)}: `{key}`: there is no file `{ratio_table}`{hint}")
    table = read_ratio_table(path)
    declared = table.reference
    if vehicle is not None and declared != vehicle.heating.reference:
        stated = f"is `{declared}`" if declared else "is not stated"
        raise InputError(
            f"{display_path(path)}, header `reference`: {stated}; the vehicle's tables are over "
            f"`{vehicle.heating.reference}`"
        )
    if vehicle is not None and (differs := table.recovery_problem(recovery.kind, vehicle.heating.reference)):
        stated = table.header.get("control_point", owner.stem)
        other = f"; the header states that it is the table of {stated}" if stated != owner.stem else ""
        raise InputError(f"{display_path(path)}, {differs} of control point {owner.stem}{other}")
    return table


def _read_turbulent(
    owner: Path, file: ControlPointFile, vehicle: VehicleFile | None, recovery: Recovery
) -> tuple[RatioTable, ...]:
    """The turbulent ratio table of a control point; none where its file names none."""
    if file.ratio_table_turbulent is None:
        return ()
    turbulent = replace(recovery, kind=turbulent_recovery(recovery.kind))
    return (_read_ratio(owner, file.ratio_table_turbulent, vehicle, turbulent, "ratio_table_turbulent"),)


def _effects(path: Path, file: ControlPointFile, vehicle: VehicleFile | None) -> tuple[EffectUse, ...]:
    """The declared effects of a control point with their parameters: those of its own file take the place of others."""
    with error_context(f"{display_path(path)}, [effect]"):
        of_file = tuple(use(effect.name, effect.parameters) for effect in file.effect)
    uses = combined_uses((*_transition_use(path, file, vehicle), *_recombination(file, vehicle)), of_file)
    check_count(uses, display_path(path))
    return uses


def _transition(file: ControlPointFile, vehicle: VehicleFile | None) -> Transition | None:
    """Declared transition of a control point: of its own file, or the vehicle's at a point with a turbulent table."""
    of_vehicle = None if vehicle is None or file.ratio_table_turbulent is None else vehicle.transition
    return file.transition or of_vehicle


def _transition_use(path: Path, file: ControlPointFile, vehicle: VehicleFile | None) -> tuple[EffectUse, ...]:
    by_table = file.ratio_table_turbulent is not None
    criterion = _transition(file, vehicle)
    if criterion is None:
        return ()
    if not by_table and file.turbulent is None:
        rule = "needs the turbulent heating: `ratio_table_turbulent`, or `factor` in [turbulent]"
        raise InputError(f"{display_path(path)}, [transition]: {rule}")
    factor = 1.0 if by_table or file.turbulent is None else file.turbulent.factor
    with error_context(f"{display_path(path)}, [transition]"):
        return (criterion.use(factor, by_table),)


def _catalysis(file: ControlPointFile, vehicle: VehicleFile | None) -> Catalysis | None:
    """Declared recombination at a control point: of its own file, or of its outermost material."""
    of_material = {} if vehicle is None else vehicle.catalysis
    return file.catalysis or of_material.get(file.stack.layer[0].material)


def _recombination(file: ControlPointFile, vehicle: VehicleFile | None) -> tuple[EffectUse, ...]:
    declared = _catalysis(file, vehicle)
    return () if declared is None else declared.effects


def _flow(
    path: Path,
    file: ControlPointFile,
    vehicle: VehicleFile | None,
    recovery: Recovery,
    effects: tuple[EffectUse, ...],
    tables: tuple[RatioTable, ...],
) -> EdgeFlow:
    """What the effects of a control point ask of the flow at its edge.

    raises : InputError where a criterion in Re_theta / M_e has no edge
    """
    declared = _catalysis(file, vehicle)
    flow = edge_flow(
        effects, recovery, file.running_length_m, "edge-oxygen" if declared is None else declared.atoms_of, tables
    )
    if flow.re_theta and (not recovery.of_surface or file.running_length_m is None):
        rule = "transition by Re_theta / M_e needs the edge: `recovery`, `local_angle_deg` and `running_length_m`"
        raise InputError(f"{display_path(path)}: {rule}")
    return flow


def _control_point(
    file: ControlPointFile,
    construction: Construction,
    ratio: RatioTable,
    effects: tuple[EffectUse, ...],
    flow: EdgeFlow,
    transition: Transition | None,
    catalysis: Catalysis | None,
) -> ControlPoint:
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
        recovery=flow.recovery,
        turbulent_factor=None if file.turbulent is None else file.turbulent.factor,
        effects=effects,
        flow=flow,
        transition=transition,
        catalysis=catalysis,
        declared=file,
    )


def _repeated_sensors(directory: Path, points: Mapping[str, ControlPoint]) -> list[str]:
    """Problems of sensors whose name also belongs to another control point: names are unique on a vehicle."""
    owners: dict[str, str] = {}
    lines = []
    for point in points.values():
        where = display_path(directory / "control_points" / f"{point.name}.toml")
        for i, sensor in enumerate(point.sensors):
            first = owners.setdefault(sensor.name, point.name)
            if first != point.name:
                rule = f"`name`: `{sensor.name}` also belongs to a sensor of {first}; rename one"
                lines.append(f"{where}, [sensor] {i + 1}: {rule}")
    return lines
