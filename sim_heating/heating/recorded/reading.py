"""Flight conditions of a file, whole: read by names and units, what follows from them derived, the rest asked for.

Everything that a file lacks is asked for in one message, with the option or the key that states it. What is derived is
told; the air of the US Standard Atmosphere 1976 in place of that of the day lowers the confidence of the conditions.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import SURFACES, Conditions
from sim_heating.base.errors import InputError, reworded
from sim_heating.base.files import CsvTable, display_path, nearest_name, raise_problems
from sim_heating.base.files.csv_table import RUNS_BACK, runs_back
from sim_heating.base.files.text import and_more_rows
from sim_heating.base.files.units import name_and_unit
from sim_heating.base.limits import LIMITS
from sim_heating.heating.recorded.derive import derived_conditions
from sim_heating.heating.recorded.fields import ConditionField, FlightField, column_unit, field_of_name
from sim_heating.heating.recorded.layout import DERIVABLE, FlightFields, read_fields
from sim_heating.heating.recorded.plausible import feet_problems
from sim_heating.heating.recorded.sounding import Sounding
from sim_heating.heating.surface_pressure import (
    FractionOfStagnation,
    ModifiedNewtonian,
    PressureModel,
    surface_pressure,
)

LOWER = {"A": "B", "B": "C", "C": "C"}
"""Confidence of conditions -> that of conditions whose air is of a model, and not of the day."""
NEARLY = 0.85
"""Similarity of names from which one is the other, misspelt."""
FLYING_M_S = 300.0
"""Speed [m/s] from which surface pressures tell of a place on a body."""
LAST_STAMP_S = 1e12
"""Times of all calendars in use are earlier [s]; those of 1970 in ms are later, taken for s."""
SMALL_KM, SMALL_KM_S = 400.0, 20.0
"""Largest altitude and speed that a message proposes km and km/s for."""


@dataclass(frozen=True)
class FlightTable:
    """Flight conditions of a file with what follows from them.

    table    : columns of conditions, rows of the file
    notes    : one line for each field that was renamed or converted, and for each derivation
    assumed  : those of the notes that are assumptions: a time whose unit is not stated
    has_model_density : whether the density needs the standard atmosphere, which lowers the confidence of conditions
    fields   : column -> name of the field in the file
    """

    table: CsvTable
    notes: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()
    has_model_density: bool = False
    fields: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Statement:
    """How a person states a column that a file lacks, for the message that asks for it.

    lead     : of the message
    field    : of a field whose unit is not known
    column   : of an absent column
    constant : of an absent angle in addition
    joint    : between two of them
    """

    lead: str
    field: str
    column: str
    constant: str
    joint: str

    def of(self, fields_without_unit: Mapping[str, tuple[str, str]], absent: Sequence[str]) -> str:
        """The statements of fields without unit, (name, a unit that may fit, such as [ft]) by column, and of absent
        columns."""
        stated = [
            self.field.format(column=c, name=n, unit=u, quote='"' if " " in n else "")
            for c, (n, u) in fields_without_unit.items()
        ]
        stated += [PRESSURE if c == "p_surface_Pa" and self is OPTION else self.column.format(column=c) for c in absent]
        angle = next((c for c in absent if c.endswith("_deg")), None)
        constant = "" if angle is None else self.constant.format(column=angle)
        return f"{self.lead} {self.joint.join(stated)}{constant}"


OPTION = Statement(
    "give",
    "--field {quote}{column}={name}:{unit}{quote}",
    "--field {column}=NAME",
    " (or a constant, --field {column}=0deg)",
    " ",
)
"""By options of `new record` and `new scenario`."""
TABLE = Statement(
    "give in [trajectory.fields]",
    '{column} = {{ field = "{name}", unit = "{unit}" }}',
    '{column} = "NAME"',
    " (or a constant, {column} = {{ constant = 0.0 }})",
    ", ",
)
"""By a table of a scenario."""
NAMES = Statement("write", "`{name} ({unit})`", "`{column}`", "", ", ")
"""By the names of the file alone."""
PRESSURE = "--local-angle 5deg (modified Newtonian pressure) or --pressure"


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
    statement: Statement = NAMES,
    fields: Mapping[str, ConditionField | str] | None = None,
    length_m: float | None = None,
    sounding: Sounding | None = None,
    pressure: PressureModel | None = None,
) -> FlightTable:
    """Flight conditions of a file by the names and units of its fields, with what follows from them.

    required : columns that have to be there, or to follow from what is
    statement : how a column is stated, for the message
    fields   : column -> field, field with unit, or constant, that prevails over the names
    length_m : reference length of a derived Reynolds number [m]; None for that of a metre
    sounding : air of the day
    pressure : model of the surface pressure where it is required and absent
    raises   : InputError, one line, with everything that the file lacks; or the first cell without a number
    """
    flight = read_fields(path, fields)
    flight, assumed = _with_time(flight)
    raise_problems([*_misspelt(flight, required), *_empty_cells(flight, flight.columns)])
    if "altitude_m" in flight.columns:
        raise_problems(feet_problems(flight.table(flight.columns)))  # before air at that altitude is derived
    needed = {*required, "rho_kg_m3"}
    with reworded(partial(_of_row, flight)):
        derived = derived_conditions(flight.columns, length_m=length_m, sounding=sounding, requested=needed)
    columns, of_pressure = with_pressure(derived.columns, required, pressure)
    _refuse_lacking(flight, columns, required, statement, has_pressure=pressure is not None)
    columns = {name: columns[name] for name in (*required, *(n for n in columns if n not in required))}
    notes = [*flight.notes, *assumed, *derived.notes, *of_pressure]
    for names, text in ((flight.empty, "no numbers in"), (flight.unused, "not used:")):
        if names:
            notes.append(f"{text} {', '.join(f'`{n}`' for n in names)}")
    of_model = bool(derived.of_model) and not {"rho_kg_m3", "q_Pa", "qbar_Pa"} & set(flight.columns)
    fields_of = {column: f.name for column, f in flight.fields.items()}
    return newest_last(FlightTable(flight.table(columns), tuple(notes), tuple(assumed), of_model, fields_of))


def newest_last(flight: FlightTable) -> FlightTable:
    """A flight that begins with its newest row in the order of time, reported; another one as it is."""
    table = flight.table
    if not runs_back(table["time_s"]):
        return flight
    columns = {name: values[::-1] for name, values in table.columns.items()}
    table = replace(table, columns=columns, lines=table.lines[::-1])
    return replace(flight, table=table, notes=(*flight.notes, RUNS_BACK))


def _of_row(flight: FlightFields, line: str) -> str:
    """A line about a sample of a column, with the row and the field of the file."""
    match = re.fullmatch(r"(\w+), sample (\d+): (.*)", line)
    if match is None:
        return f"{display_path(flight.path)}: {line}"
    name = flight.fields[match[1]].name if match[1] in flight.fields else match[1]
    return f"{display_path(flight.path)}, row {flight.lines[int(match[2]) - 1]}, column {name}: {match[3]}"


def local_pressure(local_angle_deg: float | None) -> PressureModel:
    """Model of the surface pressure: modified Newtonian at an angle against the x axis [deg], else of the stagnation
    point.

    Source: docs/theory/equations.md, equation 30.
    """
    if local_angle_deg is None:
        return FractionOfStagnation(model="fraction-of-stagnation", fraction=1.0)
    return ModifiedNewtonian(model="modified-newtonian", inclination_deg=local_angle_deg)


def implied_pressure(flown: Conditions) -> PressureModel | None:
    """Model of the surface pressure that the columns of a flight imply: the median part [-] of the rise at a stagnation
    point; None where there is no such column, or nothing flies. Source: docs/theory/equations.md, equation 31."""
    if not {"p_surface_Pa", "p_inf_Pa", "rho_kg_m3", "velocity_m_s", "T_inf_K"} <= set(flown.names):
        return None
    used = flown["velocity_m_s"] > FLYING_M_S
    if not np.any(used):
        return None
    rise = surface_pressure(local_pressure(None), flown) - flown["p_inf_Pa"]
    fraction = float(np.median(((flown["p_surface_Pa"] - flown["p_inf_Pa"]) / rise)[used]))
    return FractionOfStagnation(model="fraction-of-stagnation", fraction=min(max(fraction, 0.0), 1.0))


def with_pressure(
    columns: Mapping[str, FloatArray], required: Collection[str], model: PressureModel | None
) -> tuple[dict[str, FloatArray], list[str]]:
    """Conditions with the surface pressure of a model, where it is required and absent, and a note of it.

    columns  : name -> (row,) in the unit that the name ends in
    required : columns that have to be there
    model    : of the surface pressure [Pa]; None for none
    returns  : the columns, `p_surface_Pa` among them where it follows, and one line for that
    Source: docs/theory/equations.md, equations 30 and 31.
    """
    absent = "p_surface_Pa" in required and "p_surface_Pa" not in columns
    needed = {"rho_kg_m3", "velocity_m_s", "T_inf_K", "p_inf_Pa", "alpha_deg"} - set(columns)
    if not absent or model is None or (needed and needed != {"alpha_deg"}):
        return dict(columns), []
    rest = np.zeros(len(columns["rho_kg_m3"]))
    angles = dict.fromkeys(("alpha_deg", "beta_deg", *SURFACES), rest)
    # Only the rows count here, not the clock, which is checked where the table is.
    rows = {"time_s": np.arange(len(rest), dtype=float)}
    flown = Conditions({**angles, **columns, **rows})
    if isinstance(model, ModifiedNewtonian):
        note = f"p_surface_Pa by modified Newtonian theory at {model.inclination_deg:g} deg to the x axis"
    elif model.fraction < 1.0:
        note = f"p_surface_Pa by {model.fraction:.3g} of the rise at a stagnation point"
    else:
        note = "p_surface_Pa of the stagnation point, behind a normal shock"
    return {**columns, "p_surface_Pa": surface_pressure(model, flown)}, [note]


def _with_time(flight: FlightFields) -> tuple[FlightFields, list[str]]:
    """The fields with a time that states no unit taken for seconds, or a date counted from the earliest row, and a note
    of it; its steps are checked later."""
    if np.all((s := flight.columns.get("time_s", np.zeros(1))) > LIMITS["time_s"][1]) and np.all(s < LAST_STAMP_S):
        name, counted = flight.fields["time_s"].name, {**flight.columns, "time_s": np.round(s - s.min(), 6)}
        note = f"`{name}` is a date: counted from the earliest row"
        return flight.replaced(counted, flight.fields, flight.fields_without_unit), [note]
    time = flight.fields_without_unit.get("time_s")
    if time is None or "time_s" in flight.columns:
        return flight, []
    renamed = FlightField(time.name, "time_s", "", time.convert)
    fields_without_unit = {c: f for c, f in flight.fields_without_unit.items() if c != "time_s"}
    columns = {"time_s": flight.numbers[time.name], **flight.columns}
    return flight.replaced(columns, {"time_s": renamed, **flight.fields}, fields_without_unit), [
        f"`{time.name}` states no unit: s assumed, as its steps and the change of altitude allow"
    ]


def _units_in_words(fields: Mapping[str, FlightField]) -> str:
    """`the units of `a`, `b``; empty without a field."""
    names = ", ".join(f"`{f.name}`" for f in fields.values())
    return f"the unit{'s' * (len(fields) > 1)} of {names}" if fields else ""


def _columns_in_words(flight: FlightFields, absent: Sequence[str]) -> str:
    """Columns that a file lacks, with the field that is called so and holds no numbers."""
    empty = {f.column: name for name in flight.empty if (f := field_of_name(name)) is not None}
    return ", ".join(f"{c} (`{empty[c]}` holds no numbers)" if c in empty else c for c in absent)


def _refuse_lacking(
    flight: FlightFields,
    columns: Mapping[str, FloatArray],
    required: Collection[str],
    statement: Statement,
    *,
    has_pressure: bool,
) -> None:
    """Ask for all that a file lacks, in one line.

    has_pressure : whether the surface pressure follows from the others
    raises       : InputError where anything is absent
    """
    needed = [name for name in required if name not in columns or name in flight.fields_without_unit]
    if not needed:
        return
    concerned = _units_asked_for(flight, required)
    named_units = {c: (f.name, _example(f, flight.numbers[f.name])) for c, f in concerned.items()}
    # what would follow from a column that is asked for is not asked for itself
    follows = DERIVABLE if has_pressure else DERIVABLE - {"p_surface_Pa"}
    absent = [column for column in needed if column not in {*named_units, *follows}]
    lacking = " and ".join(filter(None, (_units_in_words(concerned), _columns_in_words(flight, absent))))
    raise InputError(
        f"{display_path(flight.path)}: needs {lacking or ', '.join(needed)}; {statement.of(named_units, absent)}"
    )


def _units_asked_for(flight: FlightFields, required: Collection[str]) -> dict[str, FlightField]:
    """Required columns, and the density, whose fields state no unit."""
    return {c: f for c, f in flight.fields_without_unit.items() if c in (*required, "rho_kg_m3")}


def _misspelt(flight: FlightFields, required: Sequence[str]) -> list[str]:
    """Required columns that are absent, and whose name is nearly that of a field which is no condition."""
    absent = [name for name in required if name not in flight.columns and name not in flight.fields_without_unit]
    near = {name: nearest_name(name, flight.unused, cutoff=NEARLY) for name in absent}
    return [
        f"{display_path(flight.path)}: there is no column `{name}`; nearest in the file: `{close}`"
        for name, close in near.items()
        if close
    ]


def _example(f: FlightField, values: FloatArray) -> str:
    """A unit that the values of a field may be in, for a message; nothing is converted by it.

    UNIT where the name states one that is not known.
    """
    column = f.column
    if name_and_unit(f.name, ())[1] or re.search(r"\d$", f.name):
        return "UNIT"
    largest = float(np.nanmax(np.abs(values)))
    if column == "altitude_m":
        return "km" if largest < SMALL_KM else "m"
    if column == "velocity_m_s":
        return "km/s" if largest < SMALL_KM_S else "m/s"
    return column_unit(column) or "1"


def _empty_cells(flight: FlightFields, columns: Mapping[str, FloatArray]) -> list[str]:
    """The first cell of each column that holds no number."""
    problems = []
    for name, values in columns.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size and name in flight.fields:
            cell = f"{display_path(flight.path)}, row {flight.lines[bad[0]]}, column {flight.fields[name].name}"
            problems.append(f"{cell}: the cell holds no number; give one, or remove the row{and_more_rows(bad.size)}")
    return problems
