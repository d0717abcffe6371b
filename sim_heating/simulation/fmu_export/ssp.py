"""An entry with its heating as one system of two FMUs in a file: System Structure and Parameterization (SSP) 1.0.

    SystemStructure.ssd             two components, their connectors with units, the connections between them
    resources/trajectory.fmu        the 3-DOF entry of a scenario, FMI 2.0
    resources/heating.fmu           the heating of a vehicle, FMI 2.0
    resources/trajectory.ssv        start values of the scalar parameters of each, which a user may edit; enumerations,
    resources/heating.ssv           paths of tables and arrays are left to the FMUs
    resources/heating.srmd          what the heating can be trusted for (SSP Traceability)

Every output of the trajectory goes to the input of the heating of the same name and unit. An input that no output has,
such as a lamp's flux, keeps the start value of the FMU.

Source: System Structure and Parameterization 1.0, Modelica Association Project SSP, 2019.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from sim_heating.base.files.package import package_version
from sim_heating.base.progress import Progress, no_progress
from sim_heating.inputs.vehicle import Vehicle, load_vehicle
from sim_heating.simulation.fmu_export import export
from sim_heating.simulation.fmu_export.entry import ENTRY_UNITS, entry_image
from sim_heating.simulation.fmu_export.heating import heating_units
from sim_heating.simulation.fmu_export.parts import description
from sim_heating.simulation.fmu_export.parts.archive import archive_bytes, require_replaceable
from sim_heating.simulation.fmu_export.parts.image import Image, Kind, Role, Variable
from sim_heating.simulation.fmu_export.parts.library import TIMING, TIMING_INTEGER
from sim_heating.simulation.fmu_export.traceability import Traceability
from sim_heating.trajectory import entry3dof
from sim_heating.trajectory.spec import TrajectorySpec

FMI = 2
"""Version of the FMUs inside; hosts of SSP 1.0 take FMI 2."""
TRAJECTORY, HEATING = "trajectory", "heating"
"""Names of the components."""
PARAMETER_SET = "parameters"
"""Name of the set of start values of either component; some hosts apply a set only when its name is given."""
_NAMESPACES = {
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    "osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
}
for _prefix, _namespace in _NAMESPACES.items():
    ET.register_namespace(_prefix, _namespace)
CONNECTED = {Role.INPUT: "input", Role.OUTPUT: "output"}


class System(NamedTuple):
    """What a system file holds.

    trajectory, heating : images of its FMUs
    connections         : names of the variables that are connected
    stop_s              : time at which the scenario ends [s]
    """

    trajectory: Image
    heating: Image
    connections: tuple[str, ...]
    stop_s: float


def export_ssp(
    vehicle: Vehicle | str | os.PathLike[str],
    spec: TrajectorySpec,
    out: str | os.PathLike[str],
    control_points: Sequence[str] | None = None,
    *,
    title: str = "",
    platforms: Sequence[str] | None = None,
    input_timing: str = "held",
    progress: Progress = no_progress,
) -> System:
    """Write a 3-DOF entry and the heating of its vehicle as one system of FMUs.

    vehicle : that the trajectory flies; its name, its directory
    spec    : [trajectory] of a scenario with source "entry-3dof"
    out     : the system, a file that ends in .ssp
    title   : one line on the flight
    control_points, platforms, input_timing, progress : as in `export_fmu`
    returns : what was written
    raises  : InputError as `export_fmu`, and for another source of the trajectory

    >>> from tempfile import TemporaryDirectory
    >>> import sim_heating as sh
    >>> flight = sh.load_scenario("scenarios/capsule.toml").declared.trajectory
    >>> with TemporaryDirectory() as folder:
    ...     system = sh.export_ssp("capsule", flight, f"{folder}/capsule.ssp", ["FACE"])
    >>> len(system.connections)
    8
    """
    require_replaceable(out)
    platforms = platforms or [export.native_platform()]
    targets = export.targets_of(platforms, FMI)
    vehicle = load_vehicle(vehicle)
    trajectory = entry_image(spec, vehicle.directory, title)
    model = export.heating_model(vehicle, control_points, targets, input_timing=input_timing)
    _state_timing(model.image)
    flown = entry3dof.fly(spec, vehicle)
    system = System(trajectory, model.image, _connections(trajectory, model.image), float(flown.conditions.time_s[-1]))
    files = {"SystemStructure.ssd": _structure(system, title or vehicle.title)}

    @cache
    def about() -> Traceability:
        return Traceability(vehicle, control_points)

    parts = (
        (TRAJECTORY, trajectory, ENTRY_UNITS, None),
        (HEATING, model.image, heating_units(model.effects), lambda: about().files()),
    )
    for name, image, units, extra_files in parts:
        files[f"resources/{name}.fmu"] = export.fmu_bytes(image, units, FMI, platforms, progress, extra_files)
        files[f"resources/{name}.ssv"] = _parameter_values(image)
    heating = files[f"resources/{HEATING}.fmu"]
    files[f"resources/{HEATING}.srmd"] = about().of_file(f"{HEATING}.fmu", heating)
    export.write_archive(Path(out), archive_bytes(files))
    return system


def _state_timing(heating: Image) -> None:
    """Set the integer that selects the timing of inputs: a parameter file that every host can read has no
    enumerations."""
    heating.set_integers([(TIMING_INTEGER, int(heating.N[TIMING]))])


def _connections(trajectory: Image, heating: Image) -> tuple[str, ...]:
    """Names of the inputs of the heating that are outputs of the trajectory in the same unit."""
    outputs = {(v.name, v.unit) for v in trajectory.variables if v.role is Role.OUTPUT}
    return tuple(v.name for v in heating.variables if v.role is Role.INPUT and (v.name, v.unit) in outputs)


def _tag(prefix: str, element: str) -> str:
    return f"{{{_NAMESPACES[prefix]}}}{element}"


def _add(parent: ET.Element, prefix: str, element: str, /, **attributes: str) -> ET.Element:
    return ET.SubElement(parent, _tag(prefix, element), attributes)


def _root(prefix: str, element: str, name: str, text: str) -> ET.Element:
    return ET.Element(
        _tag(prefix, element),
        {
            "version": "1.0",
            "name": name,
            "description": text,
            "generationTool": f"sim-heating {package_version()}",
            "generationDateAndTime": description.generation_time(),
        },
    )


def _structure(system: System, title: str) -> bytes:
    """SystemStructure.ssd."""
    root = _root("ssd", "SystemStructureDescription", f"{system.trajectory.name}_and_heating", title)
    top = _add(root, "ssd", "System", name="system", description=title)
    elements = _add(top, "ssd", "Elements")
    for name, image in ((TRAJECTORY, system.trajectory), (HEATING, system.heating)):
        _component(elements, name, image)
    connections = _add(top, "ssd", "Connections")
    for name in system.connections:
        _add(
            connections,
            "ssd",
            "Connection",
            startElement=TRAJECTORY,
            startConnector=name,
            endElement=HEATING,
            endConnector=name,
        )
    _units(root, "ssd", [*_connectors(system.trajectory), *_connectors(system.heating)])
    experiment = _add(
        root, "ssd", "DefaultExperiment", startTime="0.0", stopTime=description.number_text(system.stop_s)
    )
    _recommend_step(experiment, system.trajectory.step_s)
    return description.xml_bytes(root)


def _recommend_step(experiment: ET.Element, step_s: float) -> None:
    """State a communication step [s] as hosts of the Open Simulation Platform read it; SSP 1.0 has no place for it."""
    annotations = _add(experiment, "ssd", "Annotations")
    algorithm = _add(_add(annotations, "ssc", "Annotation", type="com.opensimulationplatform"), "osp", "Algorithm")
    _add(algorithm, "osp", "FixedStepAlgorithm", baseStepSize=description.number_text(step_s))


def _connectors(image: Image) -> list[Variable]:
    return [v for _, v in description.variables_of(image, FMI) if v.role in CONNECTED]


def _component(parent: ET.Element, name: str, image: Image) -> None:
    component = _add(
        parent,
        "ssd",
        "Component",
        name=name,
        type="application/x-fmu-sharedlibrary",
        source=f"resources/{name}.fmu",
        implementation="CoSimulation",
        description=image.title,
    )
    connectors = _add(component, "ssd", "Connectors")
    for v in _connectors(image):
        connector = _add(connectors, "ssd", "Connector", name=v.name, kind=CONNECTED[v.role], description=v.text)
        _add(connector, "ssc", "Real", **_unit_of(v))
    bindings = _add(component, "ssd", "ParameterBindings")
    _add(bindings, "ssd", "ParameterBinding", source=f"resources/{name}.ssv")


def _unit_of(v: Variable) -> dict[str, str]:
    return {"unit": v.unit} if v.unit in description.BASE_UNITS else {}


def _units(root: ET.Element, prefix: str, variables: Iterable[Variable]) -> None:
    """Declare the units of variables, with their exponents of SI base units."""
    units = _add(root, prefix, "Units")
    # A unit of a user-defined effect may have no known exponents, which SSP requires: it is left out.
    for unit in sorted({v.unit for v in variables} & description.BASE_UNITS.keys()):
        _add(_add(units, "ssc", "Unit", name=unit), "ssc", "BaseUnit", **description.base_unit(unit))


def _parameter_values(image: Image) -> bytes:
    """A .ssv: start values of the scalar parameters of an FMU that are numbers or integers."""
    root = _root("ssv", "ParameterSet", PARAMETER_SET, f"Start values: {image.title}")
    parent = _add(root, "ssv", "Parameters")
    listed = [
        v for _, v in description.variables_of(image, FMI) if v.role in (Role.TUNABLE, Role.FIXED) and _is_scalar(v)
    ]
    for v in listed:
        parameter = _add(parent, "ssv", "Parameter", name=v.name, description=v.text)
        if v.kind is Kind.INTEGER:
            _add(parameter, "ssv", "Integer", value=description.start_text(image, v))
        else:
            _add(parameter, "ssv", "Real", value=description.start_text(image, v), **_unit_of(v))
    _units(root, "ssv", listed)
    return description.xml_bytes(root)


def _is_scalar(v: Variable) -> bool:
    return v.kind is Kind.NUMBER or (v.kind is Kind.INTEGER and not v.choices)
