"""modelDescription.xml of an image, FMI 2.0 and FMI 3.0."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from datetime import UTC, datetime
from xml.etree import ElementTree as ET

import numpy as np

from sim_heating.base.files.package import package_version
from sim_heating.heating.atmosphere import G0_M_S2
from sim_heating.simulation.fmu_export.parts.image import Image, Kind, Role, Variable

BASE_UNITS: dict[str, dict[str, float]] = {
    "s": {"s": 1}, "m": {"m": 1}, "m/s": {"m": 1, "s": -1}, "K": {"K": 1}, "Pa": {"kg": 1, "m": -1, "s": -2},
    "kg/m3": {"kg": 1, "m": -3}, "kg/(m2 s)": {"kg": 1, "m": -2, "s": -1}, "J/kg": {"m": 2, "s": -2},
    "W/m2": {"kg": 1, "s": -3}, "W/(m2 K)": {"kg": 1, "s": -3, "K": -1}, "W/(m K)": {"kg": 1, "m": 1, "s": -3, "K": -1},
    "1/K": {"K": -1}, "1/s": {"s": -1}, "deg": {"rad": 1}, "1/deg": {"rad": -1}, "1/deg2": {"rad": -2},
    "deg/s": {"rad": 1, "s": -1}, "m/s2": {"m": 1, "s": -2}, "m2": {"m": 2}, "kg": {"kg": 1},
    "N": {"kg": 1, "m": 1, "s": -2}, "W/m": {"kg": 1, "m": 1, "s": -3}, "standard_gravity": {"m": 1, "s": -2},
}  # fmt: skip
"""Exponents of the SI base units."""
FACTORS = {"rad": np.pi / 180.0, "standard_gravity": G0_M_S2}
"""Size of a degree, whose exponent is that of a radian, and of units that are multiples of SI units."""
CAUSALITY = {
    Role.INDEPENDENT: ("independent", "continuous"),
    Role.INPUT: ("input", "continuous"),
    Role.TUNABLE: ("parameter", "tunable"),
    Role.FIXED: ("parameter", "fixed"),
    Role.OUTPUT: ("output", "continuous"),
    Role.CONSTANT: ("local", "constant"),
}
NUMBERS = (Kind.NUMBER, Kind.SHARED)
CATEGORIES = (("logStatusError", "why a call was refused"),)


def description(image: Image, token: str, fmi: int) -> bytes:
    """modelDescription.xml of an image, with the variables that the version of FMI supports."""
    return _fmi3(image, token) if fmi == 3 else _fmi2(image, token)


def variables_of(image: Image, fmi: int) -> Iterator[tuple[int, Variable]]:
    """Value references and variables; FMI 2 has no arrays."""
    return ((i, v) for i, v in enumerate(image.variables) if fmi == 3 or not v.shape)


def number_text(value: float) -> str:
    """A number in XML, from which it is read back to the last bit."""
    return repr(float(value))


def generation_time() -> str:
    """Now, or the second since 1970 of SOURCE_DATE_EPOCH, with which equal models give equal files."""
    stated = os.environ.get("SOURCE_DATE_EPOCH", "")
    time = datetime.fromtimestamp(int(stated), UTC) if stated.isdecimal() else datetime.now(UTC)
    return time.strftime("%Y-%m-%dT%H:%M:%SZ")


def base_unit(unit: str) -> dict[str, str]:
    """Exponents of the SI base units of a unit, and its factor where it is not 1, as attributes in FMI and in SSP."""
    exponents = {name: str(n) for name, n in BASE_UNITS[unit].items()}
    factor = FACTORS["rad"] ** BASE_UNITS[unit].get("rad", 0) * FACTORS.get(unit, 1.0)
    return exponents | ({"factor": number_text(factor)} if factor != 1.0 else {})


def _root(image: Image, token: str, version: str, token_name: str) -> ET.Element:
    return ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": version,
            "modelName": image.name,
            token_name: token,
            "description": image.title,
            "version": package_version(),
            "generationTool": f"sim-heating {package_version()}",
            "generationDateAndTime": generation_time(),
            "variableNamingConvention": "structured" if all(v.name.isascii() for v in image.variables) else "flat",
        },
    )


def _units(root: ET.Element, image: Image, fmi: int) -> None:
    used = sorted({v.unit for _, v in variables_of(image, fmi) if v.kind in NUMBERS and v.unit != "1"})
    parent = ET.SubElement(root, "UnitDefinitions")
    for unit in used:
        element = ET.SubElement(parent, "Unit", name=unit)
        if unit in BASE_UNITS:
            ET.SubElement(element, "BaseUnit", base_unit(unit))


def _limits(v: Variable) -> dict[str, str]:
    """Attributes min, max, nominal and unit, as far as the variable has them."""
    limits = {"min": v.lower, "max": v.upper, "nominal": v.nominal}
    attributes = {name: number_text(x) for name, x in limits.items() if x is not None and np.isfinite(x)}
    return attributes | ({} if v.unit == "1" or v.kind not in NUMBERS else {"unit": v.unit})


def _has_start(v: Variable) -> bool:
    return v.role is not Role.OUTPUT and v.role is not Role.INDEPENDENT


def start_text(image: Image, v: Variable) -> str:
    """Start value of a variable in XML; numbers of an array in their order."""
    value = image.value(v)
    return (
        value if isinstance(value, str) else str(value) if isinstance(value, int) else " ".join(map(number_text, value))
    )


def _integer_limits(v: Variable) -> dict[str, str]:
    return {"min": str(int(v.lower)), "max": str(int(v.upper))}


def _dependencies(v: Variable, references: dict[str, int], initial: bool) -> str:
    """Attribute `dependencies` of an output: references of the inputs, and for its initial value of the parameters.

    references : reference by name; names that the version of FMI does not have are left out
    """
    names = [*v.depends, *(v.parameters if initial else ())]
    return " ".join(str(references[name]) for name in names if name in references)


def _categories_and_experiment(root: ET.Element, image: Image) -> None:
    categories = ET.SubElement(root, "LogCategories")
    for name, text in CATEGORIES:
        ET.SubElement(categories, "Category", name=name, description=text)
    ET.SubElement(root, "DefaultExperiment", startTime="0.0", stopTime="100.0", stepSize=number_text(image.step_s))


def _attributes(i: int, v: Variable) -> dict[str, str]:
    causality, variability = CAUSALITY[v.role]
    return {
        "name": v.name,
        "valueReference": str(i),
        "description": v.text,
        "causality": causality,
        "variability": variability,
    }


NOT_XML = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")
"""Characters that XML cannot hold."""


def xml_bytes(root: ET.Element) -> bytes:
    """A document of XML, indented, in UTF-8; characters that XML cannot hold become blanks."""
    for element in root.iter():
        for name, value in element.items():
            # Titles and names come from files of the user and may hold characters that no XML parser accepts.
            element.set(name, NOT_XML.sub(" ", value))
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


# FMI 3 ---------------------------------------------------------------------------------------------------------------


def _fmi3(image: Image, token: str) -> bytes:
    root = _root(image, token, "3.0", "instantiationToken")
    ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=image.name,
        canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
        providesIntermediateUpdate="true",
    )
    _units(root, image, 3)
    types = ET.SubElement(root, "TypeDefinitions")
    for v in image.variables:
        if v.choices:
            items = ET.SubElement(types, "EnumerationType", name=f"{v.name}_type")
            _items(items, v)
    _categories_and_experiment(root, image)
    parent = ET.SubElement(root, "ModelVariables")
    for i, v in variables_of(image, 3):
        _variable3(parent, image, i, v)
    structure = ET.SubElement(root, "ModelStructure")
    references = {v.name: i for i, v in variables_of(image, 3)}
    for kind in ("Output", "InitialUnknown"):
        for i, v in variables_of(image, 3):
            if v.role is Role.OUTPUT:
                needed = _dependencies(v, references, kind == "InitialUnknown")
                ET.SubElement(structure, kind, valueReference=str(i), dependencies=needed)
    return xml_bytes(root)


def _items(parent: ET.Element, v: Variable) -> None:
    for value, (name, text) in enumerate(v.choices, start=1):
        ET.SubElement(parent, "Item", name=name, value=str(value), description=text)


def _variable3(parent: ET.Element, image: Image, i: int, v: Variable) -> None:
    attributes = _attributes(i, v)
    if v.role is Role.INPUT:
        attributes["intermediateUpdate"] = "true"
    if v.role is Role.OUTPUT:
        attributes["initial"] = "calculated"
    if v.kind is Kind.TABLE:
        ET.SubElement(ET.SubElement(parent, "String", attributes), "Start", value=start_text(image, v))
        return
    if v.kind is Kind.INTEGER and not v.choices:
        # Of the integer types of FMI 3 the one that hosts of FMI 2 know as Integer.
        ET.SubElement(parent, "Int32", attributes | _integer_limits(v), start=start_text(image, v))
        return
    if v.kind is Kind.INTEGER:
        ET.SubElement(parent, "Enumeration", attributes, declaredType=f"{v.name}_type", start=start_text(image, v))
        return
    start = {"start": start_text(image, v)} if _has_start(v) else {}
    element = ET.SubElement(parent, "Float64", attributes | _limits(v) | start)
    for n in v.shape:
        ET.SubElement(element, "Dimension", start=str(n))


# FMI 2 ---------------------------------------------------------------------------------------------------------------


def _fmi2(image: Image, token: str) -> bytes:
    root = _root(image, token, "2.0", "guid")
    ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=image.name,
        canHandleVariableCommunicationStepSize="true",
        canInterpolateInputs="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
        canNotUseMemoryManagementFunctions="true",
    )
    _units(root, image, 2)
    types = ET.SubElement(root, "TypeDefinitions")
    for v in image.variables:
        if v.choices:
            simple = ET.SubElement(types, "SimpleType", name=f"{v.name}_type")
            _items(ET.SubElement(simple, "Enumeration"), v)
    _categories_and_experiment(root, image)
    parent = ET.SubElement(root, "ModelVariables")
    listed = list(variables_of(image, 2))
    for i, v in listed:
        _variable2(parent, image, i, v)
    structure = ET.SubElement(root, "ModelStructure")
    for kind in ("Outputs", "InitialUnknowns"):
        unknowns = ET.SubElement(structure, kind)
        # FMI 2 refers to variables by their position in the list, counted from 1; FMI 3 by value reference.
        references = {v.name: index for index, (_, v) in enumerate(listed, start=1)}
        for index, (_, v) in enumerate(listed, start=1):
            if v.role is Role.OUTPUT:
                needed = _dependencies(v, references, kind == "InitialUnknowns")
                ET.SubElement(unknowns, "Unknown", index=str(index), dependencies=needed)
    return xml_bytes(root)


def _variable2(parent: ET.Element, image: Image, i: int, v: Variable) -> None:
    attributes = _attributes(i, v)
    if v.role is Role.OUTPUT:
        attributes["initial"] = "calculated"
    element = ET.SubElement(parent, "ScalarVariable", attributes)
    start = {"start": start_text(image, v)} if _has_start(v) else {}
    if v.kind is Kind.TABLE:
        ET.SubElement(element, "String", start)
    elif v.kind is Kind.INTEGER and not v.choices:
        ET.SubElement(element, "Integer", _integer_limits(v) | start)
    elif v.kind is Kind.INTEGER:
        ET.SubElement(element, "Enumeration", start, declaredType=f"{v.name}_type")
    else:
        ET.SubElement(element, "Real", _limits(v) | start)
