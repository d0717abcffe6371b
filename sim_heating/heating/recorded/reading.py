"""Flight conditions of a file, whole: read by names and units, what follows from them derived, the rest asked for.

Everything that a file lacks is asked for in one message, with the option or the key that states it. What is derived is
told; the air of the standard atmosphere in place of that of the day lowers the confidence of the conditions.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import SURFACES, Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.files import CsvTable, display_path, raise_problems
from sim_heating.heating.recorded.derive import AIR, derived_conditions
from sim_heating.heating.recorded.fields import ConditionField, FlightField, column_unit
from sim_heating.heating.recorded.layout import FlightFields, read_fields
from sim_heating.heating.recorded.sounding import Sounding
from sim_heating.heating.surface_pressure import (
    FractionOfStagnation,
    ModifiedNewtonian,
    PressureModel,
    surface_pressure,
)

LOWER = {"A": "B", "B": "C", "C": "C"}
"""Confidence of conditions -> that of conditions whose air is of a model, and not of the day."""
SMALL_KM, SMALL_KM_S = 400.0, 20.0
"""Largest altitude and speed that a message proposes km and km/s for."""
Hint = Callable[[str, str | None, str], str]
"""What states a column: called with the column, the field whose unit is not known or None, and a unit that may fit."""


@dataclass(frozen=True)
class FlightTable:
    """Flight conditions of a file with what follows from them.

    table    : columns of conditions, rows of the file
    notes    : one line for each field that was renamed or converted, and for each derivation
    has_model_density : whether the density needs the standard atmosphere, which lowers the confidence of conditions
    """

    table: CsvTable
    notes: tuple[str, ...] = ()
    has_model_density: bool = False


def option_hint(column: str, name: str | None, unit: str) -> str:
    """How `new record` and `new scenario` are told a column: `--field altitude_m=ALT:km`, `--field alpha_deg=0deg`."""
    if name is not None:
        field = f"{column}={name}:{unit}"
        return f'--field "{field}"' if " " in field else f"--field {field}"
    if column == "p_surface_Pa":
        return "--local-angle 5deg for modified Newtonian theory, --pressure, or --field p_surface_Pa=NAME"
    zero = f", or --field {column}=0{column_unit(column)}" if column.endswith("_deg") else ""
    return f"--field {column}=NAME{zero}"


def table_hint(column: str, name: str | None, unit: str) -> str:
    """How a scenario is told a column, in [trajectory.fields]."""
    if name is not None:
        return f'[trajectory.fields] {column} = {{ field = "{name}", unit = "{unit}" }}'
    zero = " or { constant = 0.0 }" if column.endswith("_deg") else ""
    return f'[trajectory.fields] {column} = "NAME"{zero}'


def name_hint(column: str, name: str | None, unit: str) -> str:
    """How a record is told a column: by the name, which states the unit."""
    return f"add `{column}`" if name is None else f"name it `{name} ({unit})`"


def lowered_confidence(stated: str) -> str:
    """The confidence of conditions whose density is of the standard atmosphere; C where no letter begins it.

    >>> lowered_confidence("A"), lowered_confidence("B: from the report"), lowered_confidence("")
    ('B', 'C: from the report', 'C')
    """
    if re.match(r"[ABC]\b", stated):
        return LOWER[stated[0]] + stated[1:]
    return f"C: density of the standard atmosphere; {stated}" if stated else "C"


def read_flight(
    path: Path,
    required: Sequence[str],
    *,
    hint: Hint = name_hint,
    fields: Mapping[str, ConditionField | str] | None = None,
    length_m: float | None = None,
    sounding: Sounding | None = None,
    pressure: PressureModel | None = None,
) -> FlightTable:
    """Flight conditions of a file by the names and units of its fields, with what follows from them.

    required : columns that have to be there, or to follow from what is
    hint     : how a column is stated, for the message
    fields   : column -> field, field with unit, or constant, that prevails over the names
    length_m : reference length of a derived Reynolds number [m]; None for that of a metre
    sounding : air of the day
    pressure : model of the surface pressure where it is required and absent
    raises   : InputError, one line, with everything that the file lacks; or the first cell without a number
    """
    found = read_fields(path, fields)
    found, assumed = _with_time(found)
    derived = derived_conditions(found.columns, length_m=length_m, sounding=sounding, wanted={*required, "rho_kg_m3"})
    columns, of_pressure = _with_pressure(derived.columns, required, pressure)
    problems = _lacking(found, columns, required, hint)
    if problems:
        raise InputError(f"{display_path(path)}: needs {' and '.join(problems)}")
    columns = {name: columns[name] for name in (*required, *(n for n in columns if n not in required))}
    raise_problems(_empty_cells(found, columns))
    notes = [*found.notes, *assumed, *derived.notes, *of_pressure]
    if found.empty:
        notes.append(f"no numbers in {', '.join(f'`{n}`' for n in found.empty)}")
    if found.unused:
        notes.append(f"not used: {', '.join(f'`{n}`' for n in found.unused)}")
    of_model = bool(derived.of_model) and not {"rho_kg_m3", "q_Pa"} & set(found.columns)
    return FlightTable(found.table(columns), tuple(notes), of_model)


def local_pressure(local_angle_deg: float | None) -> PressureModel:
    """Model of the surface pressure: modified Newtonian at an angle against the x axis [deg], else of the stagnation
    point."""
    if local_angle_deg is None:
        return FractionOfStagnation(model="fraction-of-stagnation", fraction=1.0)
    return ModifiedNewtonian(model="modified-newtonian", inclination_deg=local_angle_deg)


def _with_pressure(
    columns: Mapping[str, FloatArray], required: Collection[str], model: PressureModel | None
) -> tuple[dict[str, FloatArray], list[str]]:
    """Conditions with the surface pressure [Pa] of a model, where it is required and absent, and a note of it."""
    absent = "p_surface_Pa" in required and "p_surface_Pa" not in columns
    needed = {"rho_kg_m3", "velocity_m_s", "T_inf_K", "p_inf_Pa", "alpha_deg"} - set(columns)
    if not absent or model is None or (needed and needed != {"alpha_deg"}):
        return dict(columns), []
    if not all(np.all(np.isfinite(columns[n])) for n in columns):
        return {**columns, "p_surface_Pa": np.full(len(columns["rho_kg_m3"]), np.nan)}, []
    rest = np.zeros(len(columns["rho_kg_m3"]))
    angles = dict.fromkeys(("alpha_deg", "beta_deg", *SURFACES), rest)
    # Only the rows count here, not the clock, which is checked where the table is.
    rows = {"time_s": np.arange(len(rest), dtype=float)}
    flown = Conditions({**angles, **columns, **rows})
    if isinstance(model, ModifiedNewtonian):
        note = f"p_surface_Pa by modified Newtonian theory at {model.inclination_deg:g} deg to the x axis"
    else:
        note = "p_surface_Pa of the stagnation point, behind a normal shock"
    return {**columns, "p_surface_Pa": surface_pressure(model, flown)}, [note]


def _with_time(found: FlightFields) -> tuple[FlightFields, list[str]]:
    """The fields with a time that states no unit taken for seconds, and a note of it; its steps are checked later."""
    time = found.asked.get("time_s")
    if time is None or "time_s" in found.columns:
        return found, []
    renamed = FlightField(time.name, "time_s", "", time.convert)
    asked = {c: f for c, f in found.asked.items() if c != "time_s"}
    columns = {"time_s": found.raw_of(time), **found.columns}
    return found.replaced(columns, {"time_s": renamed, **found.fields}, asked), [
        f"`{time.name}` states no unit: s assumed, as its steps and the change of altitude allow"
    ]


def _lacking(
    found: FlightFields, columns: Mapping[str, FloatArray], required: Collection[str], hint: Hint
) -> list[str]:
    """What a file lacks, each with the way to state it."""
    needed = [name for name in required if name not in columns]
    if not needed:
        return []
    units = [
        f"the unit of `{f.name}` ({hint(column, f.name, _example(column, found.raw_of(f)))})"
        for column, f in found.asked.items()
    ]
    # what would follow from a column that is asked for is not asked for itself
    follows = {"mach", "log10_re", *AIR} if any(n in needed or n in found.asked for n in ("altitude_m",)) else set()
    follows |= {"mach", "log10_re"} if "velocity_m_s" in needed else set()
    absent = [
        f"{column} ({hint(column, None, '')})"
        for column in needed
        if column not in found.asked and column not in follows
    ]
    return [*units, *absent]


def _example(column: str, values: FloatArray) -> str:
    """A unit that the values of a column may be in, for a message; nothing is converted by it."""
    largest = float(np.nanmax(np.abs(values)))
    if column == "altitude_m":
        return "km" if largest < SMALL_KM else "m"
    if column == "velocity_m_s":
        return "km/s" if largest < SMALL_KM_S else "m/s"
    return column_unit(column) or "1"


def _empty_cells(found: FlightFields, columns: Mapping[str, FloatArray]) -> list[str]:
    """The first cell of each column that holds no number."""
    problems = []
    for name, values in columns.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size and name in found.fields:
            more = f" (and {bad.size - 1} more rows)" if bad.size > 1 else ""
            place = f"{display_path(found.path)}, row {found.lines[bad[0]]}, column {found.fields[name].name}"
            problems.append(f"{place}: the cell holds no number; give one, or remove the row{more}")
    return problems
