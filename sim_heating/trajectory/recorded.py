"""A flight as it was recorded: conditions from a file, by the names and units of its columns.

Time, altitude, speed and angles are required. Density is taken as recorded, else from the dynamic pressure `q_Pa`, from
pressure and temperature, or of the US Standard Atmosphere 1976; temperature, pressure, Mach and Reynolds number are
derived where a column is absent. Deflections of control surfaces that the vehicle does not have are 0 where they are
absent. Further columns of numbers are kept where the names are those of the contract.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np

from sim_heating.base.conditions import EXTRAS, FRAME, HEATING, STATE, SURFACES, Conditions
from sim_heating.base.errors import InputError, tell
from sim_heating.base.files import CsvTable, display_path, raise_problems, read_csv_columns
from sim_heating.base.progress import Progress
from sim_heating.heating.atmosphere import HIGHEST_M, LOWEST_M
from sim_heating.heating.recorded.derive import AIR, derived_conditions
from sim_heating.heating.recorded.fields import ConditionField
from sim_heating.heating.recorded.layout import states_columns
from sim_heating.heating.recorded.plausible import implausible_values, unusual_values, with_density
from sim_heating.heating.recorded.reading import TABLE, FlightTable, Statement, newest_last, read_flight
from sim_heating.heating.recorded.sounding import Sounding
from sim_heating.trajectory.flight import Flight, OnFrame, VehicleData
from sim_heating.trajectory.spec import TrajectorySpec

DERIVED = ("T_inf_K", "p_inf_Pa", "mach", "log10_re")
DENSITY = ("rho_kg_m3", "q_Pa")
"""Columns of which one is needed."""
REQUIRED = tuple(name for name in STATE if name not in (*DERIVED, *DENSITY, *SURFACES))
"""Columns that every recording has; a vehicle needs those of its control surfaces as well."""
OPTIONAL = (
    *DENSITY,
    *DERIVED,
    "jets",
    "qbar_Pa",
    "T_surroundings_K",
    "T_back_K",
    "q_add_W_m2",
    *EXTRAS,
    *HEATING,
)


def fly(
    spec: TrajectorySpec, vehicle: VehicleData, *, on_frame: OnFrame | None = None, progress: Progress | None = None
) -> Flight:
    """The recorded flight of spec.file, one frame a row ([s], [m], [m/s], [deg], [kg/m3]); nothing is resampled and
    there are no events.

    spec.file : path, which the reader of a scenario has made relative to the scenario
    on_frame  : called for each row with its values in the order of conditions.FRAME; the array is reused
    raises    : InputError naming file, row and column
    """
    if spec.file is None:
        raise InputError('trajectory: source = "recorded" needs `file`, a CSV of flight conditions')
    conditions = read_conditions(Path(spec.file), vehicle.reference_length_m, vehicle.surfaces, spec.fields)
    if on_frame is not None:
        _send_frames(conditions, on_frame)
    if progress is not None:
        progress(1.0, f"{len(conditions)} recorded samples")
    return Flight(conditions)


def read_conditions(
    path: Path,
    length_m: float,
    surfaces: Collection[str] = SURFACES,
    fields: Mapping[str, ConditionField | str] | None = None,
) -> Conditions:
    """Conditions of a file; length_m [m] is the reference length of a derived Reynolds number.

    surfaces : columns of control surfaces that the file needs; others may be absent, and are 0 [deg]
    fields   : column -> field, field with unit, or constant, that prevails over the names
    raises   : InputError naming file, row and column; one line with everything that is asked for

    A warning states which columns were renamed, converted or taken from the standard atmosphere.
    """
    recording = read_recording(path, length_m, surfaces, fields)
    table = recording.table
    spared = [name for name in SURFACES if name not in surfaces]
    table = table.with_columns({name: np.zeros(len(table)) for name in spared if name not in table.columns})
    raise_problems(_problems(table))
    if recording.notes:
        warnings.warn(f"{display_path(path)}: {'; '.join(recording.notes)}", stacklevel=2)
    tell(unusual_values(table))
    stated = dict(table.columns)
    derived = derived_conditions(stated, length_m=length_m).columns
    # A column of the file takes precedence over the derived one.
    columns = derived | {"qbar_Pa": 0.5 * stated["rho_kg_m3"] * stated["velocity_m_s"] ** 2} | stated
    order = STATE + tuple(name for name in columns if name not in STATE)
    return Conditions({name: columns[name] for name in order})


def read_recording(
    path: Path,
    length_m: float,
    surfaces: Collection[str] = SURFACES,
    fields: Mapping[str, ConditionField | str] | None = None,
    *,
    statement: Statement = TABLE,
    sounding: Sounding | None = None,
) -> FlightTable:
    """Columns of a recorded flight ([s], [m], [m/s], [deg] ...) by the names and units of the file, with what had to be
    converted or derived.

    statement : how a column is stated, for the message
    sounding  : air of the day
    Other arguments and errors as of `read_conditions`; a file with the columns of the contract is taken as it is,
    without a note.
    """
    required = [*REQUIRED, *(name for name in SURFACES if name in surfaces)]
    if not fields and sounding is None and states_columns(path, required, (DENSITY,)):
        spared = [name for name in SURFACES if name not in surfaces]
        return newest_last(FlightTable(with_density(read_csv_columns(path, required, [*OPTIONAL, *spared]))))
    air = ("rho_kg_m3",) if sounding is None else AIR
    return read_flight(
        path, [*required, *air], statement=statement, fields=fields, length_m=length_m, sounding=sounding
    )


def _problems(table: CsvTable) -> list[str]:
    z = table["altitude_m"]
    inside = (z >= LOWEST_M) & (z <= HIGHEST_M)
    outside = table.problems_where_not("altitude_m", inside, "is outside the atmosphere's table")
    return [*table.order_problems(), *outside, *implausible_values(table)]


def _send_frames(conditions: Conditions, on_frame: OnFrame) -> None:
    with_jets = conditions if "jets" in conditions else conditions.with_columns(jets=0.0)
    for row in np.column_stack([with_jets[name] for name in FRAME]):
        on_frame(row)
