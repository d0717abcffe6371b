"""What an FMU says of itself: its interfaces, its variables and their units, read without running any of its code."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fmpy
from fmpy.model_description import ModelDescription, ModelVariable

from sim_heating.errors import InputError
from sim_heating.files import shown, suggestion
from sim_heating.trajectory.fmu_units import NO_DIMENSION, Conversion, Scale, conversion, known_unit, unit_of_fmu
from sim_heating.trajectory.spec import FmuSource, FmuValue

VERSIONS = ("2.0", "3.")
NUMBERS = ("Real", "Float", "Integer", "Int", "UInt", "Boolean", "Enumeration")
NEAREST_OF = 12
"""Variables that an error lists where no name is near."""


@dataclass(frozen=True)
class FmuModel:
    """A readable FMU for this platform, and the interface to use."""

    path: Path
    description: ModelDescription
    interface: str

    @property
    def variables(self) -> dict[str, ModelVariable]:
        """Variables by name, those that share another's value by their own names too."""
        found = {v.name: v for v in self.description.modelVariables}
        aliases = {a.name: v for v in self.description.modelVariables for a in v.aliases}
        return aliases | found

    def number(self, name: str, where: str) -> ModelVariable:
        """A scalar variable that is a number.

        raises : InputError naming the nearest one
        """
        variable = self.variables.get(name)
        if variable is None:
            known = [v for v, held in self.variables.items() if held.causality in ("output", "input", "parameter")]
            raise InputError(f"{where}: {self} has no variable `{name}`. {suggestion(name, known[:NEAREST_OF] or '-')}")
        if not str(variable.type).startswith(NUMBERS) or variable.shape:
            kind = "an array" if variable.shape else f"a {variable.type}"
            raise InputError(f"{where}: `{name}` of {self} is {kind}; name a variable that is one number")
        return variable

    def scale(self, variable: ModelVariable, unit: str | None, where: str) -> Scale:
        """The unit of a variable: as the scenario says, which must not be another than the FMU's, or the FMU's own.

        raises : InputError where it is unknown, told by nobody, or told in two ways
        """
        name = self.unit_name(variable)
        given = None if unit is None else known_unit(unit)
        if unit is not None and given is None:
            raise InputError(f"{where}: `{unit}` is not a unit; write it like m, ft/s, kg/m3, deg")
        if name is None:
            if given is None:
                raise InputError(f"{where}: `{variable.name}` of {self} has no unit; give `unit`")
            return given
        definitions = {u.name: u.baseUnit for u in self.description.unitDefinitions}
        try:
            own = unit_of_fmu(name, definitions.get(name))
        except InputError as error:
            if given is None:
                raise InputError(f"{where}: `{variable.name}` of {self}: {error}") from None
            return given
        if given is not None and conversion(given, own) != Conversion(1.0, 0.0):
            raise InputError(f"{where}: `{variable.name}` is in `{name}` in {self}, not in `{unit}`; remove `unit`")
        return own

    @staticmethod
    def unit_name(variable: ModelVariable) -> str | None:
        """The unit that the FMU names for a variable or its type."""
        return variable.unit or (variable.declaredType.unit if variable.declaredType is not None else None)

    def conversion(self, variable: ModelVariable, unit: str | None, wanted: str, where: str) -> Conversion:
        """From a variable's unit to a wanted one; what is to be a plain number needs none.

        raises : InputError where they do not measure the same
        """
        if unit is None and wanted in NO_DIMENSION and self.unit_name(variable) is None:
            return Conversion(1.0, 0.0)
        scale, target = self.scale(variable, unit, where), known_unit(wanted)
        assert target is not None
        found = conversion(scale, target)
        if found is None:
            name = unit or self.unit_name(variable)
            raise InputError(f"{where}: `{variable.name}` of {self} is in `{name}`, which is no `{wanted}`")
        return found

    def start_values(self, source: FmuSource) -> dict[str, Any]:
        """The scenario's start values in the FMU's units."""
        found: dict[str, Any] = {}
        for name, value in source.start.items():
            where = f"[trajectory.fmu.start], `{name}`"
            text = self.variables.get(name)
            if isinstance(value, str) and text is not None and text.type == "String":
                found[text.name] = value
                continue
            variable = self.number(name, where)
            if isinstance(value, str):
                raise InputError(f"{where}: `{value}` is not a number, and `{name}` of {self} is a {variable.type}")
            if isinstance(value, FmuValue):
                if self.unit_name(variable) is None:
                    raise InputError(f"{where}: `{name}` of {self} has no unit; give a plain number")
                scale = self.scale(variable, None, where)
                way = None if (given := known_unit(value.unit)) is None else conversion(given, scale)
                if way is None:
                    raise InputError(f"{where}: `{value.unit}` is no unit of it; it is in `{variable.unit}`")
                value = way(value.value)
            found[variable.name] = value
        return found

    def __str__(self) -> str:
        return shown(self.path)


def read_fmu(path: Path, interface: str | None = None) -> FmuModel:
    """Read an FMU's description and choose the interface.

    raises : InputError where the file is no FMU of a known version, lacks the interface, or has nothing for this
             platform
    """
    name = shown(path)
    try:
        description = fmpy.read_model_description(path, validate=False)
        platforms = fmpy.supported_platforms(path)
    except (OSError, zipfile.BadZipFile) as error:
        raise InputError(f"{name}: is not an FMU ({error})") from None
    except Exception as error:  # FMPy raises plain Exceptions, lxml its own
        raise InputError(f"{name}: modelDescription.xml cannot be read ({' '.join(str(error).split())})") from None
    if not str(description.fmiVersion).startswith(VERSIONS):
        raise InputError(f"{name}: is of FMI {description.fmiVersion}; FMI 2.0 and 3.0 can be flown")
    has = {
        "co-simulation": description.coSimulation is not None,
        "model-exchange": description.modelExchange is not None,
    }
    chosen = interface or next((k for k, there in has.items() if there), "co-simulation")
    if not has[chosen]:
        others = [k for k, there in has.items() if there]
        raise InputError(f"{name}: has no {chosen} interface" + (f"; it has {', '.join(others)}" if others else ""))
    if fmpy.platform not in platforms:
        found = ", ".join(p for p in platforms if p != "c-code") or "none"
        raise InputError(f"{name}: has no library for this platform ({fmpy.platform}); platforms in it: {found}")
    return FmuModel(path, description, chosen)
