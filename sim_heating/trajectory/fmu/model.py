"""The description of an FMU: interfaces, variables, units and allowed values, read without running any of its code.

A variable takes, by its type, any number, whole numbers within a range, items of an enumeration, or true and false.

Source: Modelica Association (2022), "Functional Mock-up Interface Specification 3.0".
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import fmpy
from fmpy.model_description import BaseUnit, ModelDescription, ModelVariable, ValidationError
from fmpy.simulation import settable_in_initialization_mode, settable_in_instantiated

from sim_heating.base.errors import InputError, error_context
from sim_heating.base.files import display_path, raise_problems, repeated_name, suggestion
from sim_heating.base.files.units import NO_DIMENSION, Conversion, Scale, conversion, known_unit
from sim_heating.trajectory.fmu.archive import DESCRIPTION, read_archive
from sim_heating.trajectory.fmu.units import unit_of_fmu
from sim_heating.trajectory.spec import FmuSource, FmuValue

VERSIONS = ("2.0", "3.")
CO_SIMULATION, MODEL_EXCHANGE = "co-simulation", "model-exchange"
NUMBERS = ("Real", "Float", "Integer", "Int", "UInt", "Boolean", "Enumeration")
IDENTIFIER = re.compile("[A-Za-z0-9_]+", re.ASCII)
"""A modelIdentifier: it is the name of the library's file and the beginning of the names of its functions."""
REFERENCES = 2**32
"""A value reference is an unsigned number of 32 bits."""
SCHEMA_PROBLEMS = 3
"""Most problems of an invalid description that an error lists."""


@dataclass(frozen=True)
class FmuModel:
    """A readable FMU for this platform, with the interface to use."""

    path: Path
    description: ModelDescription
    interface: str

    @cached_property
    def variables(self) -> dict[str, ModelVariable]:
        """Variables by name in the order of the description, including aliases. Source: FMI 2.0.4, section 2.2.7."""
        # FMPy lists an alias of FMI 3 as a variable of its own, FMI 2 has none.
        return {v.name: v for v in self.description.modelVariables}

    @cached_property
    def units(self) -> dict[str, BaseUnit | None]:
        """Units that the FMU defines, such as [m/s]. Source: FMI 2.0.4, section 2.2.2."""
        return {u.name: u.baseUnit for u in self.description.unitDefinitions}

    @property
    def process_description(self) -> dict[str, Any]:
        """What the process of the FMU (process.py) needs of the description besides variables."""
        d = self.description
        interface = d.coSimulation if self.interface == CO_SIMULATION else d.modelExchange
        assert interface is not None
        return {
            "interface": self.interface,
            "version": d.fmiVersion,
            "token": d.guid,
            "identifier": interface.modelIdentifier,
            "states": d.numberOfContinuousStates,
            "indicators": d.numberOfEventIndicators,
            "step_events": bool(getattr(interface, "needsCompletedIntegratorStep", False)),
        }

    def access(self, variable: ModelVariable) -> tuple[str, int]:
        """The type under which FMPy gets and sets a variable, and its value reference."""
        enumeration = "Integer" if self.description.fmiVersion == "2.0" else "Int64"
        return enumeration if variable.type == "Enumeration" else str(variable.type), variable.valueReference

    def number(self, name: str, where: str) -> ModelVariable:
        """A scalar variable that is a number.

        raises : InputError with the most similar name
        """
        variable = self.variables.get(name)
        if variable is None:
            names = [n for n, v in self.variables.items() if v.causality in ("output", "input", "parameter")]
            raise InputError(f"{where}: {self} has no variable `{name}`{suggestion(name, names)}")
        if not str(variable.type).startswith(NUMBERS) or variable.shape:
            kind = "an array" if variable.shape else f"a {variable.type}"
            raise InputError(f"{where}: `{name}` of {self} is {kind}; name a variable that is one number")
        if not 0 <= variable.valueReference < REFERENCES:
            # The library would receive its last 32 bits: another variable.
            raise InputError(f"{where}: `{name}` of {self} has the impossible valueReference {variable.valueReference}")
        return variable

    def scale(self, variable: ModelVariable, unit: str | None, where: str) -> Scale:
        """The unit of a variable, such as [m/s]: that of the scenario, which must agree with the FMU's, or else the
        FMU's own.

        raises : InputError where the unit is unknown, declared nowhere, or declared differently

        Source: FMI 2.0.4, section 2.2.2.
        """
        name = self.unit_name(variable)
        stated = None if unit is None else known_unit(unit)
        if unit is not None and stated is None:
            raise InputError(f"{where}: `{unit}` is not a unit; write it like m, ft/s, kg/m3, deg")
        if name is None:
            if stated is None:
                raise InputError(f"{where}: `{variable.name}` of {self} has no unit; give `unit`")
            return stated
        try:
            declared = unit_of_fmu(name, self.units.get(name))
        except InputError as error:
            if stated is None:
                raise InputError(f"{where}: `{variable.name}` of {self}: {error}") from None
            return stated
        if stated is not None and conversion(stated, declared) != Conversion(1.0, 0.0):
            raise InputError(f"{where}: `{variable.name}` is in `{name}` in {self}, not in `{unit}`; remove `unit`")
        return declared

    @staticmethod
    def unit_name(variable: ModelVariable) -> str | None:
        """The unit, such as [m/s], that the FMU declares for a variable or its type.

        Source: FMI 2.0.4, section 2.2.2.
        """
        return variable.unit or (variable.declaredType.unit if variable.declaredType is not None else None)

    def conversion(self, variable: ModelVariable, unit: str | None, required: str, where: str) -> Conversion:
        """Conversion from a variable's unit to a required one, such as [ft] to [m]; none is needed for a plain number.

        raises : InputError where their dimensions differ

        Source: FMI 2.0.4, section 2.2.2.
        """
        # A number without unit, such as the jets, is taken as it is; any quantity with a dimension needs a known unit.
        if unit is None and required in NO_DIMENSION and self.unit_name(variable) is None:
            return Conversion(1.0, 0.0)
        scale, target = self.scale(variable, unit, where), known_unit(required)
        assert target is not None
        result = conversion(scale, target)
        if result is None:
            name = self.unit_name(variable) if unit is None else unit or "1"
            raise InputError(
                f"{where}: `{variable.name}` of {self} is in `{name}`, which does not convert to `{required}`"
            )
        return result

    def start_values(self, source: FmuSource) -> dict[str, Value]:
        """The scenario's start values in the FMU's units ([m], [rad] ...), in the order of the FMU's variables.

        raises : InputError, all problems at once

        Source: FMI 2.0.4, section 2.2.7.
        """
        values: dict[str, Value] = {}
        problems: list[str] = []
        for name, value in source.start.items():
            try:
                variable, start = self._start_value(name, value, f"[trajectory.fmu.start], `{name}`")
                values[variable.name] = start
            except InputError as error:
                problems += error.problems
        raise_problems(problems)
        return {name: values[name] for name in self.variables if name in values}

    def _start_value(self, name: str, value: Value | FmuValue, where: str) -> tuple[ModelVariable, Value]:
        variable = self.variables.get(name)
        if variable is None or variable.type != "String" or not isinstance(value, str):
            variable = self.number(name, where)
        if not (settable_in_instantiated(variable) or settable_in_initialization_mode(variable)):
            raise InputError(
                f"{where}: {self} takes no start value for this {variable.causality}; give start values of "
                f"parameters and inputs only"
            )
        if isinstance(value, FmuValue):
            value = self._converted(variable, value, where)
        if variable.type == "String":
            return variable, value
        with error_context(where):
            return variable, accepted_value(variable, value)

    def _converted(self, variable: ModelVariable, stated: FmuValue, where: str) -> float:
        """A start value with a unit, converted to the FMU's unit."""
        unit = self.unit_name(variable)
        if unit is None:
            raise InputError(f"{where}: `{variable.name}` of {self} has no unit; give a plain number")
        scale, source = self.scale(variable, None, where), known_unit(stated.unit)
        convert = None if source is None else conversion(source, scale)
        if convert is None:
            raise InputError(f"{where}: `{stated.unit}` does not convert to its unit `{unit}`")
        return convert(stated.value)

    def __str__(self) -> str:
        return display_path(self.path)


def read_fmu(path: Path, interface: str | None = None) -> FmuModel:
    """Read an FMU's description and choose the interface.

    raises : InputError where the file is not an FMU of a supported version, must not be unpacked, lacks the interface,
             or has no library for this platform

    Source: FMI 2.0.4, section 2.2.
    """
    name = display_path(path)
    archive = read_archive(path)
    status = path.stat()
    description = _description(path, (status.st_ino, status.st_size, status.st_mtime_ns))
    if not str(description.fmiVersion).startswith(VERSIONS):
        raise InputError(f"{name}: uses FMI {description.fmiVersion}; FMI 2.0 and 3.0 are supported")
    interfaces = {CO_SIMULATION: description.coSimulation, MODEL_EXCHANGE: description.modelExchange}
    for declared in interfaces.values():
        _check_identifier(name, declared)
    has = [kind for kind, declared in interfaces.items() if declared is not None]
    chosen = interface or next(iter(has), CO_SIMULATION)
    if chosen not in has:
        raise InputError(f"{name}: has no {chosen} interface" + f"; it has {', '.join(has)}" * bool(has))
    if twice := repeated_name([v.name for v in description.modelVariables]):
        raise InputError(f"{name}: {DESCRIPTION} is not valid: two variables are named `{twice}`")
    _check_library(name, archive.libraries(), interfaces[chosen].modelIdentifier, str(description.fmiVersion))
    return FmuModel(path, description, chosen)


def _check_identifier(name: str, interface: Any) -> None:
    if interface is None:
        return
    identifier = interface.modelIdentifier
    if not identifier:
        raise InputError(f"{name}: {DESCRIPTION} is not valid: an interface has no modelIdentifier")
    # FMPy joins it to a path and loads what is there: "../../../lib/x" would run code from outside the archive.
    if IDENTIFIER.fullmatch(identifier) is None:
        raise InputError(
            f"{name}: {DESCRIPTION} is not valid: the modelIdentifier `{identifier[:80]}` may consist of letters, "
            "digits and _ only"
        )


def _check_library(name: str, libraries: dict[str, list[str]], identifier: str, version: str) -> None:
    folder = fmpy.platform if version == "2.0" else fmpy.platform_tuple
    library = f"{identifier}{fmpy.sharedLibraryExtension}"
    if folder not in libraries:
        platforms = ", ".join(libraries) or "none"
        raise InputError(f"{name}: has no library for this platform ({folder}); platforms in it: {platforms}")
    if library not in libraries[folder]:
        raise InputError(f"{name}: has no binaries/{folder}/{library}, the library of its modelIdentifier")


@lru_cache(maxsize=1)
def _description(path: Path, _: tuple[int, int, int]) -> ModelDescription:
    """The description of a file of some inode, size and time of change; a large one takes seconds to read."""
    try:
        # Not validated at first, because FMPy rejects some valid descriptions; the schema is asked only why reading
        # failed.
        return fmpy.read_model_description(path, validate=False)
    except Exception as error:  # FMPy raises plain Exceptions, lxml its own, and both Python's
        raise InputError(f"{display_path(path)}: {DESCRIPTION} {_description_fault(path, error)}") from None


def _description_fault(path: Path, error: Exception) -> str:
    """The fault of a description that FMPy cannot read; from the schema where FMPy gives no message."""
    if not isinstance(error, AttributeError | TypeError | ValueError | LookupError):
        return f"cannot be read ({' '.join(str(error).split())})"
    try:
        fmpy.read_model_description(path, validate=True)
    except ValidationError as invalid:
        problems = "; ".join(str(p) for p in invalid.problems[:SCHEMA_PROBLEMS])
        return f"is not valid: {' '.join(problems.split())}"
    except Exception:  # without a version there is no schema, and FMPy fails on some valid descriptions
        pass
    return "is not valid; its root must be an fmiModelDescription with an fmiVersion"


Value = bool | int | float | str


def accepted_value(variable: ModelVariable, value: Value) -> bool | int | float:
    """A scenario's value converted to the type of a variable.

    raises : InputError with the allowed values where the variable does not take it

    Source: FMI 2.0.4, section 2.2.3.
    """
    text = str(value).lower() if isinstance(value, bool) else str(value)
    if variable.type == "Boolean":
        if value in (0, 1):
            return bool(value)
        raise InputError(f"`{text}` is neither true nor false")
    if items := _items(variable):
        # True equals 1 in Python and would select the first item.
        if value in items and not isinstance(value, bool):
            return int(value)
        raise InputError(f"`{text}` is not one of its items: {', '.join(f'{k} ({n})' for k, n in items.items())}")
    if isinstance(value, bool | str):
        raise InputError(f"`{text}` is not a number, and `{variable.name}` is a {variable.type}")
    if str(variable.type).startswith(("Real", "Float")):
        return value
    return _whole_number(variable, value, *_range(str(variable.type)))


def _whole_number(variable: ModelVariable, value: float, lowest: int, highest: int) -> int:
    # 1.5 would become the integer 1 without a message.
    if not lowest <= value <= highest or value != int(value):
        raise InputError(
            f"`{value}` is not a whole number from {lowest} to {highest}, which `{variable.name}` requires"
        )
    return int(value)


def item_named(variable: ModelVariable, name: str) -> int | None:
    """The number of an enumeration's item, None without one of this name. Source: FMI 2.0.4, section 2.2.3."""
    return next((number for number, item in _items(variable).items() if item == name), None)


def _items(variable: ModelVariable) -> dict[int, str]:
    return {} if variable.declaredType is None else {int(i.value): i.name for i in variable.declaredType.items}


def _range(kind: str) -> tuple[int, int]:
    """Least and greatest value of FMI 3's Int8 to UInt64; FMI 2's Integer and an enumeration have 32 bits."""
    unsigned, bits = kind.startswith("U"), int((re.search(r"\d+", kind) or ["32"])[0])
    return (0, 2**bits - 1) if unsigned else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
