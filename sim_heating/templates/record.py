"""A flight record from a CSV file of temperatures: the stack from the material library, the lamp as a known flux.

The record is checked as a whole before it is written, so that it validates and goes through `predict`, `estimate` and
`close-loop` as it is.
"""

from __future__ import annotations

import math
import os
import re
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base import files
from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import STATE
from sim_heating.base.errors import InputError, reworded
from sim_heating.base.files.text import and_more_rows
from sim_heating.heating.atmosphere import R_AIR, us76
from sim_heating.heating.ratio.table import read_ratio_table, write_ratio_table
from sim_heating.heating.recorded.reading import OPTION, lowered_confidence, read_flight
from sim_heating.heating.recorded.sounding import read_sounding
from sim_heating.inputs.record import (
    BY_CONFIDENCE,
    DECLARATION,
    REFERENCE_COLUMNS,
    FlightUncertainty,
    Record,
    load_record,
    make_record,
    pressure_of_reference,
    write_record,
)
from sim_heating.templates.materials import LayerInput, describe_source
from sim_heating.templates.measured_csv import FLUX, TEMPERATURE, TIME, CsvColumn, MeasuredCsv, read_measured_csv
from sim_heating.templates.quantities import NUMBER, quantity, require_known, stated_fields
from sim_heating.templates.render import render_toml
from sim_heating.thermal.stack import PressureTable, Sensor

RISE_S = 0.1
"""Time in which a lamp that is switched on or off changes its flux [s]."""
UNEVEN_K = 2.0
"""Difference between the first readings of sensors from which the start is not at one temperature [K]."""
FIRST_READINGS, LEAST_READINGS = 5, 3
MOVES_SIGMA, MOVES_K = 3.0, 0.5
"""Change of the first readings, in standard deviations about a line and in K, from which the wall is heated already."""
SURFACE, BACK = "surface", "back"
"""Depths by name: the outer surface, and the inner face of the last layer."""
COMMAND, RATIO_FILE = "new record", "ratio_table.csv"
UNKNOWN = "unknown"
"""Word for a lamp whose flux is to be estimated."""
UNIT_FLUX_W_M2, LAMP_ENTHALPY_J_KG = 1e4, 1e10
"""Flux at a heating ratio of 1, and the recovery enthalpy by which a lamp is stated as heating: so high that the wall's
own enthalpy, below 2e6 J/kg, changes the flux by less than 2e-4."""
FLUX_EXAMPLE = "20kW/m2"


@dataclass(frozen=True)
class Source:
    """The file of a person that a table of a record is made from, for messages.

    path  : of the file
    rows  : (row,) line of each row in it
    names : column of the table -> its name in the file; another one is of this name
    options : column of the table -> the option that states it, where it is not of the file
    """

    path: Path
    rows: Sequence[int]
    names: Mapping[str, str]
    options: Mapping[str, str] = field(default_factory=dict)

    def shown(self, line: str, table: str) -> str:
        """A line about the table that is made, with the file, the row and the column that the person has."""
        match = re.fullmatch(r"(?:, row (\d+))?, column (\S+?): (.*)", line.removeprefix(table), re.DOTALL)
        if not line.startswith(table) or match is None or int(match[1] or 2) - 2 >= len(self.rows):
            return line
        if match[2] in self.options:
            return f"{self.options[match[2]]}: {match[3]}"
        row = "" if match[1] is None else f", row {self.rows[int(match[1]) - 2]}"
        return f"{files.display_path(self.path)}{row}, column {self.names.get(match[2], match[2])}: {match[3]}"


@dataclass(frozen=True)
class Heat:
    """What heats the wall, in columns and constants of the conditions.

    columns   : of conditions.csv, `time_s` among them
    constants : (name, value, meaning) of [conditions]
    reference : heating.reference of the record
    note      : in words
    notes     : what was converted and derived
    uncertainty : of a flight whose density is not of the day; its confidence is then C
    source    : file of a person whose rows those of the columns are
    """

    columns: Mapping[str, FloatArray]
    constants: tuple[tuple[str, float, str], ...]
    reference: str
    note: str
    notes: tuple[str, ...] = ()
    uncertainty: FlightUncertainty | None = None
    source: Source | None = None

    @property
    def is_of_unknown_lamp(self) -> bool:
        """Whether the flux is that of a lamp, to be estimated as a heating ratio."""
        return LAMP_ENTHALPY_J_KG in [value for _, value, _ in self.constants]


@dataclass(frozen=True)
class RecordInput:
    """What a person states in addition to the CSV file; what is None is guessed, with a note.

    emissivity    : of the outer surface, in place of that of its material [-]
    initial_K, surroundings_K : temperatures of the wall before the heating, and of what the surface radiates to [K]
    back          : cooling of the back face, keys of `back`; None for an adiabatic one
    noise_K       : random error of all sensors [K]
    pressure_Pa   : of the air in the insulation [Pa]
    nose_radius_m, running_length_m, sweep_deg, local_angle_deg, recovery : of the reference heating and of the point,
                    keys of [heating]
    ratio, ratio_table : heating ratio of a flight [-], or the file of its table; neither where it is to be estimated
    """

    layers: Sequence[LayerInput]
    depths_m: Mapping[str, float]
    heat: Heat
    title: str = ""
    point: str = "plate"
    measured: bool = True
    emissivity: float | None = None
    initial_K: float | None = None
    surroundings_K: float | None = None
    back: Mapping[str, float] | None = None
    noise_K: float | None = None
    pressure_Pa: float | None = None
    nose_radius_m: float | None = None
    running_length_m: float | None = None
    sweep_deg: float | None = None
    local_angle_deg: float | None = None
    recovery: str | None = None
    ratio: float | None = None
    ratio_table: Path | None = None
    notes: tuple[str, ...] = field(default=())


# What is asked for ---------------------------------------------------------------------------------------------------


def sensor_columns(measured: MeasuredCsv) -> list[CsvColumn]:
    """The temperatures of a CSV file.

    raises : InputError where there is none
    """
    temperatures = measured.of_kind(TEMPERATURE)
    if not temperatures:
        names = ", ".join(c.name for c in measured.columns if c.kind != TIME)
        raise InputError(
            f"{files.display_path(measured.path)}: no column is a temperature; name one, --temperature COLUMN, of "
            f"{names}"
        )
    return temperatures


def depths_of(measured: MeasuredCsv, stated: Mapping[str, str], layers: Sequence[LayerInput]) -> dict[str, float]:
    """Depths of the sensors of a file that a person stated [m], by column, else those of the recorder's layout.

    stated : column -> depth from the outer surface with a unit, `surface`, or `back`
    raises : InputError, one line, for an unknown column or a depth outside the stack
    """
    sensors = sensor_columns(measured)
    require_known(dict(stated), [s.name for s in sensors], "--depth", measured.path)
    of_layout = {s.name: s.declared for s in sensors if s.name not in stated and s.declared and s.declared.depth}
    depths = {name: depth_m(column.depth or "", layers, column.place("depth")) for name, column in of_layout.items()}
    return depths | {name: depth_m(text, layers, f"--depth {name}={text}") for name, text in stated.items()}


def depth_m(text: str, layers: Sequence[LayerInput], place: str) -> float:
    """The depth [m] of a sensor: a length with a unit, `surface`, or `back`.

    place  : what states it, for messages
    raises : InputError, one line, where it is none, or outside the stack
    """
    thickness = _thickness_m(layers)
    if text.strip().lower() in (SURFACE, BACK):
        return 0.0 if text.strip().lower() == SURFACE else thickness
    if re.fullmatch(r"[\d.,]+", text.strip()) and float(text.replace(",", ".")) != 0.0:
        raise InputError(f"{place}: has no unit; write 0.4mm")
    depth = quantity(text, "m", place, f"0.4mm, {SURFACE} or {BACK}")
    if not 0.0 <= depth <= thickness * (1.0 + 1e-9):
        raise InputError(f"{place}: lies outside the stack, which is {thickness * 1e3:g} mm thick")
    return min(depth, thickness)


def _thickness_m(layers: Sequence[LayerInput]) -> float:
    return float(f"{sum(layer.thickness_m for layer in layers):.12g}")


def lamp_heat(measured: MeasuredCsv, lamp: str, lit_s: tuple[float, float] | None, absorptance: float | None) -> Heat:
    """The flux that the surface absorbs.

    lamp        : a constant flux with a unit, a column of the CSV file, another CSV file with a time and a flux, or
                  `unknown` for one that is to be estimated
    lit_s       : times at which a constant lamp was lit and put out [s]; None for lit throughout
    absorptance : absorbed part of the flux [-]; None where it is the absorbed flux already
    raises      : InputError, one line, where it is none of these
    """
    columns = {c.name: c for c in measured.columns}
    if lamp == UNKNOWN:
        if absorptance is not None:
            raise InputError("--absorptance: is of a known --lamp; of an unknown one the absorbed flux is estimated")
        return _unknown_flux(measured, lit_s)
    if lamp in columns or Path(lamp).is_file():
        if lit_s is not None:
            raise InputError("--lit: is for a constant --lamp; a column or a file states when the lamp was lit")
        return _recorded_flux(measured, lamp, columns.get(lamp), absorptance)
    return _constant_flux(measured, _stated_flux_W_m2(measured, lamp), lit_s, absorptance)


def _stated_flux_W_m2(measured: MeasuredCsv, lamp: str) -> float:
    if re.match(r"[A-Za-z./]", lamp):
        hint = files.suggestion(lamp, [c.name for c in measured.columns], otherwise="") if lamp[0].isalpha() else ""
        listed = ", ".join(c.name for c in measured.columns if c.kind != TIME)
        raise InputError(
            f"--lamp {lamp}: is neither a flux such as {FLUX_EXAMPLE}, nor a column ({listed}), nor a file{hint}"
        )
    if re.fullmatch(rf"\s*{NUMBER}\s*", lamp):
        raise InputError(f"--lamp {lamp}: has no unit; write {FLUX_EXAMPLE}")
    return quantity(lamp, "W/m2", "--lamp", f"--lamp {FLUX_EXAMPLE}")


def _recorded_flux(measured: MeasuredCsv, lamp: str, flux_column: CsvColumn | None, absorptance: float | None) -> Heat:
    """The flux of a column of the readings, or, where that is None, of the file that `lamp` names.

    raises : InputError, one line, where cells hold no number, or the file is not one of a flux at all these times
    """
    file, clock, where = measured, measured.of_kind(TIME)[0].si, f"column {lamp}"
    if flux_column is None:
        where = f"file {lamp}"
        file, clock, flux_column = _flux_file(measured, lamp)
    flux = flux_column.si
    if flux_column.guess:
        warnings.warn(f"--lamp {lamp}, column {flux_column.name}: {flux_column.guess}", stacklevel=3)
    empty = np.flatnonzero(np.isnan(flux))
    if empty.size:
        cell = f"{files.display_path(file.path)}, row {file.rows[empty[0]]}, column {flux_column.name}"
        raise InputError(f"{cell}: holds no number; fill it{and_more_rows(empty.size)}")
    absorbed = "absorbed" if absorptance is None else f"incident, {absorptance:g} of it absorbed"
    note = f"{where}, {flux.min():g} to {flux.max():g} W/m2 {absorbed}"
    source = Source(file.path, file.rows, {"time_s": file.of_kind(TIME)[0].name, "q_add_W_m2": flux_column.name})
    factor = 1.0 if absorptance is None else absorptance
    return Heat({"time_s": clock, "q_add_W_m2": factor * flux}, (), "none", note, source=source)


def _flux_file(measured: MeasuredCsv, lamp: str) -> tuple[MeasuredCsv, FloatArray, CsvColumn]:
    """A file of the flux of a lamp: its content, its times on the clock of the readings [s], and the column.

    raises : InputError, one line, where it has not one flux, or not all times of the readings
    """
    times = measured.of_kind(TIME)[0].si
    file = read_measured_csv(Path(lamp), kinds=(FLUX,))
    fluxes = file.of_kind(FLUX)
    if len(fluxes) != 1:
        names = ", ".join(c.name for c in file.columns)
        raise InputError(f"--lamp {lamp}: has {len(fluxes)} columns of a heat flux (of {names}); it needs one")
    clock = file.of_kind(TIME)[0].si + _later_s(file, measured)
    if clock[0] > times[0] or clock[-1] < times[-1]:
        raise InputError(
            f"--lamp {lamp}: covers {clock[0]:g} to {clock[-1]:g} s, and the readings {times[0]:g} to "
            f"{times[-1]:g} s; give the flux at all of these times, on the same clock"
        )
    return file, clock, fluxes[0]


def _constant_flux(
    measured: MeasuredCsv, lamp_W_m2: float, lit_s: tuple[float, float] | None, absorptance: float | None
) -> Heat:
    """A constant flux while the lamp is lit."""
    times = measured.of_kind(TIME)[0].si
    flux_W_m2 = float(f"{(1.0 if absorptance is None else absorptance) * lamp_W_m2:.12g}")
    absorbed = f"{flux_W_m2:g} W/m2 absorbed{'' if absorptance is None else f', {absorptance:g} of {lamp_W_m2:g} W/m2'}"
    if lit_s is None:
        meaning = "flux that the surface absorbs, from the first row to the last"
        ends, constants = times[[0, -1]], (("q_add_W_m2", flux_W_m2, meaning),)
        source = _source_of_clock(measured, ends)
        return Heat({"time_s": ends}, constants, "none", f"{absorbed}, throughout", source=source)
    clock, lit = _lit(times, lit_s)
    after = "" if lit_s[1] <= times[-1] else f", which is after the last reading, {times[-1]:g} s (--lit)"
    note = f"{absorbed}, from {lit_s[0]:g} to {lit_s[1]:g} s{after}"
    columns = {"time_s": clock, "q_add_W_m2": flux_W_m2 * lit}
    return Heat(columns, (), "none", note, source=_source_of_clock(measured, clock))


def _later_s(file: MeasuredCsv, measured: MeasuredCsv) -> float:
    """By how much the zero of the times of a lamp's file is later than that of the readings [s].

    raises : InputError where the two are of different clocks
    """
    if file.zero != measured.zero or (file.zero and (file.zero_s is None or measured.zero_s is None)):
        raise InputError(
            f"--lamp {files.display_path(file.path)}: its times and those of {files.display_path(measured.path)} are "
            "of different clocks; write both as dates with times, or both in seconds of one clock"
        )
    return 0.0 if file.zero_s is None or measured.zero_s is None else file.zero_s - measured.zero_s


def _lit(times: FloatArray, lit_s: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Times of the conditions [s], and the part of its flux that a lamp gives then [-]: 0 or 1, with short rises.

    raises : InputError where the times are no interval of the readings
    """
    on, off = lit_s
    if not times[0] <= on < off:
        raise InputError(f"--lit {on:g},{off:g}: give two times in s, from {times[0]:g} s on, the first one earlier")
    if on >= times[-1]:
        raise InputError(
            f"--lit {on:g},{off:g}: the readings end at {times[-1]:g} s; give the times in s on their clock"
        )
    edges = np.round([on, on + RISE_S, off, off + RISE_S], 6)
    clock = np.unique(np.concatenate((times[[0]], edges, np.maximum(times[[-1]], edges[-1]))))
    lit = np.interp(clock, edges, [0.0, 1.0, 1.0, 0.0])
    if on == times[0]:
        lit[0] = 1.0  # lit from the first sample on
    return clock, lit


def _source_of_clock(measured: MeasuredCsv, clock: FloatArray) -> Source:
    """The readings as the file of conditions at some of their times [s], each with the row of the last reading then."""
    (column,) = measured.of_kind(TIME)[:1]
    last = np.searchsorted(column.si, clock, side="right") - 1
    return Source(measured.path, [measured.rows[i] for i in last], {"time_s": column.name}, {"q_add_W_m2": "--lamp"})


def _unknown_flux(measured: MeasuredCsv, lit_s: tuple[float, float] | None) -> Heat:
    """A lamp of unknown flux as a heating whose ratio is to be estimated: q = ratio.d0 * 10 kW/m2 while it is lit."""
    times = measured.of_kind(TIME)[0].si
    clock, lit = (times[[0, -1]], np.ones(2)) if lit_s is None else _lit(times, lit_s)
    T_0, p_0, _ = (float(x) for x in us76(0.0))
    still = {name: 0.0 for name in STATE if name != "time_s"}
    still |= {"rho_kg_m3": float(f"{p_0 / (R_AIR * T_0):.4g}"), "T_inf_K": T_0, "p_inf_Pa": p_0, "p_surface_Pa": p_0}
    constants = tuple((name, value, "of air at rest, at sea level") for name, value in still.items())
    constants += (
        ("H_r_J_kg", LAMP_ENTHALPY_J_KG, "far above the wall's, so that the flux does not depend on the wall"),
    )
    flux = {"time_s": clock, "h_ref_kg_m2_s": UNIT_FLUX_W_M2 / LAMP_ENTHALPY_J_KG * lit}
    when = "throughout" if lit_s is None else f"from {lit_s[0]:g} to {lit_s[1]:g} s"
    note = (
        f"an unknown flux {when}: `estimate` finds ratio.d0, the absorbed flux in units of {UNIT_FLUX_W_M2 / 1e3:g} "
        "kW/m2; heat capacity and emittance are then taken as declared; `predict` needs it"
    )
    return Heat(flux, constants, "columns", note, source=_source_of_clock(measured, clock))


def flown_heat(
    path: Path,
    reference: str | None,
    *,
    fields: Mapping[str, str] | None = None,
    atmosphere: Path | None = None,
    reference_length_m: float | None = None,
    local_angle_deg: float | None = None,
    has_pressure: bool = False,
) -> Heat:
    """The conditions of a flight, by the names and units of a file, with what follows from them.

    reference          : model of reference heating; None for the columns h_ref_kg_m2_s and H_r_J_kg of the file
    fields             : column -> what the option --field states of it
    atmosphere         : file of a sounding, the air of the day
    reference_length_m : of a derived Reynolds number [m]; None for that of a metre
    local_angle_deg    : of the surface against the x axis, for its pressure [deg]
    has_pressure       : whether the pressure in the insulation is stated, and is not one of the flight
    raises             : InputError, one line, with everything that is not there and does not follow from what is
    """
    required = ["time_s", "altitude_m", "velocity_m_s", "alpha_deg", "mach", "log10_re", "rho_kg_m3", "T_inf_K"]
    required.append("p_inf_Pa")
    if not has_pressure:
        required.append("p_surface_Pa")
    if reference is None:
        required += REFERENCE_COLUMNS
    flown = read_flight(
        path,
        required,
        statement=OPTION,
        fields=stated_fields(fields or {}),
        length_m=reference_length_m,
        sounding=None if atmosphere is None else read_sounding(atmosphere),
        pressure=pressure_of_reference(reference, local_angle_deg),
    )
    for line in flown.assumed:
        warnings.warn(f"{files.display_path(path)}: {line}", stacklevel=2)
    columns = {name: values for name, values in flown.table.columns.items() if name != "q_Pa"}
    constants, of_constants = _angles_of_zero(columns)
    uncertainty, of_density = _of_model_density() if flown.has_model_density else (None, [])
    note = f"flight of {files.display_path(path)}"
    source = Source(path, list(map(int, flown.table.lines)), flown.fields)
    notes = (*flown.notes, *of_constants, *of_density)
    return Heat(columns, constants, reference or "columns", note, notes, uncertainty, source)


def _angles_of_zero(columns: Collection[str]) -> tuple[tuple[tuple[str, float, str], ...], list[str]]:
    """Angles that a flight does not record, as constants, and a note of them."""
    absent = [n for n in ("beta_deg", "elevon_deg", "bodyflap_deg") if n not in columns]
    note = [f"{', '.join(absent)} 0, as the file has none (--field {absent[0]}=2deg)"] if absent else []
    return tuple((n, 0.0, "not in the file of the flight") for n in absent), note


def _of_model_density() -> tuple[FlightUncertainty, list[str]]:
    """Uncertainty of conditions whose density is of the standard atmosphere, and a note."""
    confidence = lowered_confidence("B")
    density_sigma = BY_CONFIDENCE[confidence].density_relative
    note = (
        f"confidence of the conditions {confidence}: the density is of the standard atmosphere, "
        f"+-{density_sigma:.0%} (--atmosphere FILE for a sounding of the day)"
    )
    return BY_CONFIDENCE["B"].model_copy(update={"density_relative": density_sigma}), [note]


# The record ----------------------------------------------------------------------------------------------------------


def _surroundings(article: RecordInput, initial_K: float) -> tuple[float, str]:
    """Temperature of what a wall radiates to [K], and the note on it: as stated, the sky, or the wall at the start."""
    if article.surroundings_K is not None:
        return article.surroundings_K, f"surroundings at {article.surroundings_K:g} K (--surroundings)"
    if article.heat.reference != "none" and not article.heat.is_of_unknown_lamp:
        return 0.0, "surroundings at 0 K, the sky of a flight (--surroundings)"
    return initial_K, f"surroundings at {initial_K:g} K, as the wall at the start (--surroundings)"


def _constants(article: RecordInput) -> tuple[list[tuple[str, float, str]], list[str]]:
    """Constant conditions with the air pressure that porous insulation needs, and a note where it is assumed."""
    constants = list(article.heat.constants)
    meaning = "air pressure in the room, on which porous insulation depends"
    if article.pressure_Pa is not None:
        stated = [c for c in constants if c[0] != "p_surface_Pa"]
        return [*stated, ("p_surface_Pa", article.pressure_Pa, meaning)], []
    porous = any(isinstance(layer.material.conductivity_W_mK, PressureTable) for layer in article.layers)
    if not porous or "p_surface_Pa" in {*article.heat.columns, *(name for name, _, _ in constants)}:
        return constants, []
    pressure = float(us76(0.0)[1])
    return [*constants, ("p_surface_Pa", pressure, meaning)], [f"air pressure {pressure:g} Pa, sea level (--pressure)"]


def write_new_record(
    out: str | os.PathLike[str], measured: MeasuredCsv, article: RecordInput
) -> tuple[Record, list[str]]:
    """Write a record of a test article, checked as a whole.

    returns : the record, and one line for each thing that was assumed
    raises  : InputError where something does not fit, or the directory holds files of others
    """
    sensors = sensor_columns(measured)
    times = measured.of_kind(TIME)[0].si
    initial_K, notes = _initial(article, times, sensors)
    notes += _ratio_notes(article)
    surroundings_K, of_surroundings = _surroundings(article, initial_K)
    notes.append(of_surroundings)
    if article.back is None:
        notes.append("back face adiabatic (--back-film, --back-emissivity)")
    materials, of_materials = _materials(article)
    constants, of_pressure = _constants(article)
    notes += [*of_materials, *of_pressure]
    hold = times[0] + np.array([0.6, 0.7]) * (times[-1] - times[0])
    text = render_toml(
        "record.toml.j2",
        "record",
        title=article.title or f"{article.point}: {measured.path.name}",
        source=measured.path.name,
        point=article.point,
        measured=article.measured,
        constants=constants,
        sensors=[_sensor(s, article) for s in sensors],
        initial_K=initial_K,
        surroundings_K=surroundings_K,
        back=None if article.back is None else dict(article.back),
        layers=article.layers,
        materials=materials,
        reference=article.heat.reference,
        lamp=article.heat.is_of_unknown_lamp,
        unit_flux=f"{UNIT_FLUX_W_M2 / 1e3:g}",
        lengths=_of_reference(article),
        uncertainty=None
        if article.heat.uncertainty is None
        else article.heat.uncertainty.model_dump(exclude_unset=True),
        ratio=article.ratio,
        ratio_table=None if article.ratio_table is None else RATIO_FILE,
        first_s=float(times[0]),
        last_s=float(times[-1]),
        hold_s=[float(f"{x:.4g}") for x in hold],
    )
    readings = {"time_s": times} | {_sensor(s, article).column: s.si for s in sensors}
    inputs = list(filter(None, (measured.path, article.ratio_table)))
    sources = {"thermocouples.csv": source_of_readings(measured), "conditions.csv": article.heat.source}
    with (
        files.output_directory(out, COMMAND, expected=(DECLARATION,), inputs=inputs) as folder,
        said_of_options(out),
        said_of_sources(sources, out),
        shown_at(folder, out),
    ):
        files.write_text_atomic(folder / DECLARATION, text)
        files.write_csv(folder / "conditions.csv", article.heat.columns)
        files.write_csv(folder / "thermocouples.csv", readings)
        if article.ratio_table is not None:
            write_ratio_table(folder / RATIO_FILE, read_ratio_table(article.ratio_table))
        record = load_record(folder)
    return record, [*measured.notes, f"heated by {article.heat.note}", *article.heat.notes, *notes, *article.notes]


def _ratio_notes(article: RecordInput) -> list[str]:
    """What is said of the heating ratio of a flight.

    raises : InputError where there are two ratios, or one without a flight
    """
    stated = {"--ratio": article.ratio, "--ratio-table": article.ratio_table}
    options = [option for option, value in stated.items() if value is not None]
    if len(options) == 2:
        raise InputError("--ratio: is a constant in place of --ratio-table; give one of the two")
    is_flight = not (article.heat.reference == "none" or article.heat.is_of_unknown_lamp)
    if options and not is_flight:
        raise InputError(f"{options[0]}: is over the reference heating of a flight; give --conditions, or leave it out")
    if options or not is_flight:
        return []
    return ["no heating ratio: `estimate` finds ratio.d0, `predict` needs one (--ratio, --ratio-table, --like)"]


OPTIONS = {
    ": `control_point`:": "--point:",
    ", [conditions]: `q_add_W_m2`:": "--lamp:",
    ", [conditions]: `p_surface_Pa`:": "--pressure:",
    ", [heating]: `reference`:": "--reference:",
    ", [heating]: `nose_radius_m`:": "--nose-radius:",
    ", [heating]: `running_length_m`:": "--running-length:",
    ", [heating]: `sweep_deg`:": "--sweep:",
    ", [heating]: `recovery`:": "--recovery:",
    ", [heating]: `local_angle_deg`:": "--local-angle:",
    ", [heating]: `ratio`:": "--ratio:",
}
"""Place in record.toml -> the option that states what is there."""
KEYS = {
    "nose_radius_m": "--nose-radius",
    "running_length_m": "--running-length",
    "sweep_deg": "--sweep",
    "local_angle_deg": "--local-angle",
    "recovery": "--recovery",
    "reference": "--reference",
}
"""Key of [heating] -> the option that states it."""


def said_of_options(out: str | os.PathLike[str]) -> AbstractContextManager[None]:
    """Errors about a declaration that was made from options, which is not there afterwards, with their names."""
    return reworded(partial(_of_option, declaration=files.display_path(Path(out) / DECLARATION)))


def _of_option(line: str, declaration: str) -> str:
    for table, option in OPTIONS.items():
        if line.startswith(f"{declaration}{table}"):
            rule = line.removeprefix(f"{declaration}{table}")
            for key, named in KEYS.items():
                rule = rule.replace(f"`{key}`; add it", f"{named}; give it").replace(f"`{key}`", named)
            return f"{option}{rule}"
    return line


def source_of_readings(measured: MeasuredCsv) -> Source:
    """The file of the readings, by the columns of the record that is made from it."""
    return Source(measured.path, measured.rows, {_column_name(c.name): c.name for c in measured.columns})


@contextmanager
def said_of_sources(sources: Mapping[str, Source | None], out: str | os.PathLike[str]) -> Iterator[None]:
    """Errors and warnings about tables that are made from files, with the file, row and column that the person has.

    sources : name of a table in the record -> the file that it is made from
    """

    def shown(line: str) -> str:
        for name, source in sources.items():
            if source is not None:
                line = source.shown(line, files.display_path(Path(out) / name))
        return line

    with _told_as(shown):
        yield


@contextmanager
def _told_as(shown: Callable[[str], str]) -> Iterator[None]:
    """Errors and warnings in other words."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            yield
        except InputError as error:
            raise InputError(*map(shown, error.problems)) from None
    for warning in caught:
        warnings.warn(shown(str(warning.message)), warning.category, stacklevel=4)


def _column_name(name: str) -> str:
    """Name of a column of a record: that of the file without blanks, and with its unit."""
    plain = re.sub(r"[\s,]+", "_", name.strip())
    return plain if plain.endswith("_K") else f"{plain}_K"


@contextmanager
def shown_at(folder: Path, out: str | os.PathLike[str]) -> Iterator[None]:
    """Errors and warnings about files of a directory in the making, with the paths that they will have."""
    temporary, shown = files.display_path(folder), files.display_path(Path(out))
    with _told_as(lambda line: line.replace(temporary, shown)):
        yield


def _of_reference(article: RecordInput) -> dict[str, Any]:
    """Keys of [heating] of a flight's reference heating, as far as stated; an angle without an edge is of the pressure
    alone."""
    edge = article.recovery in ("edge-laminar", "edge-turbulent")
    keys = {
        "nose_radius_m": article.nose_radius_m,
        "running_length_m": article.running_length_m,
        "sweep_deg": article.sweep_deg,
        "recovery": article.recovery,
        "local_angle_deg": article.local_angle_deg if edge else None,
    }
    return {key: value for key, value in keys.items() if value is not None}


def _sensor(column: CsvColumn, article: RecordInput) -> Sensor:
    return Sensor(
        name=column.name,
        column=_column_name(column.name),
        depth_m=article.depths_m[column.name],
        noise_sigma_K=article.noise_K,
    )


def _initial(article: RecordInput, times: FloatArray, sensors: Sequence[CsvColumn]) -> tuple[float, list[str]]:
    """Initial temperature [K], and notes: given, or the mean of the readings before the heating, or of the first.

    times : (reading,) [s]
    """
    if article.initial_K is not None:
        if article.initial_K < files.COLDEST_K:
            raise InputError(f"--initial {article.initial_K:g}K: {files.celsius_rule()}, such as --initial 21degC")
        return article.initial_K, [f"wall at {article.initial_K:g} K at the start (--initial)"]
    cold = times <= _heated_from_s(article.heat)
    first, risen = [], []
    for s in sensors:
        read = np.isfinite(s.si)
        before, start = s.si[cold & read], s.si[read][:FIRST_READINGS]
        risen.append(not len(before) and _moves(times[read][:FIRST_READINGS], start))
        # median: without a known start of the heating the last of them may be heated
        first.append(float(np.mean(before) if len(before) else start[0] if risen[-1] else np.median(start)))
    mean = float(f"{np.mean(first):.5g}")
    which = "the mean of the readings before the heating" if cold.any() else "the mean of the first readings"
    if any(risen):
        which = "the first reading, since it changes from there on"
    notes = [f"wall at {mean:g} K at the start, {which} (--initial)"]
    if max(first) - min(first) > UNEVEN_K:
        apart = max(first) - min(first)
        notes.append(f"the first readings differ by {apart:.1f} K: state initial_profile in [stack] where that is real")
    return mean, notes


def _moves(times: FloatArray, T: FloatArray) -> bool:
    """Whether the first readings [K] at times [s] change by more than they scatter about a straight line."""
    if len(T) < LEAST_READINGS:
        return False
    line = np.polyval(np.polyfit(times - times[0], T, 1), times - times[0])
    return bool(abs(line[-1] - line[0]) > MOVES_SIGMA * np.std(T - line) + MOVES_K)


def _heated_from_s(heat: Heat) -> float:
    """Time [s] until which a stated flux or film is 0; minus infinity where it is not from the start on."""
    history = next((heat.columns[n] for n in ("q_add_W_m2", "h_ref_kg_m2_s") if n in heat.columns), None)
    if history is None or history[0] != 0.0 or not np.any(history):
        return -math.inf
    return float(heat.columns["time_s"][np.argmax(history != 0.0) - 1])


def _materials(article: RecordInput) -> tuple[dict[str, Any], list[str]]:
    """Tables of the materials, the outermost with its emittance, and notes on sources."""
    outer = article.layers[0]
    tables: dict[str, Any] = {}
    notes = []
    for layer in article.layers:
        if layer.name not in tables:
            tables[layer.name] = layer.material.model_dump(exclude_unset=True, exclude_none=True)
            notes.append(describe_source(layer.name, layer.material))
    if article.emissivity is not None:
        tables[outer.name]["emissivity"] = [[300.0, article.emissivity]]
    elif outer.material.emissivity is None:
        raise InputError(
            f"--layer {outer.name}: the outermost layer needs an emittance, and the library has none for this "
            "material; give --emissivity, such as 0.9 for black paint"
        )
    else:
        low, high = (f([e for _, e in outer.material.emissivity]) for f in (min, max))
        span = f"{low:g}" if low == high else f"{low:g} to {high:g}"
        doubt = ", an estimate" if "Emittance C" in (outer.material.note or "") else ""
        notes.append(f"emittance {span}: that of {outer.name} in the library{doubt} (--emissivity)")
    return tables, notes


def like_record(
    out: str | os.PathLike[str],
    like: str | os.PathLike[str],
    measured: MeasuredCsv,
    depths: Mapping[str, str],
    title: str = "",
    noise_K: float | None = None,
    *,
    is_measured: bool = True,
) -> tuple[Record, list[str]]:
    """Write a record with the stack, flight and heating of another one, and the temperatures of a CSV file.

    depths      : column -> depth as a person types it; a column of the other record's sensor has that of the sensor,
                  and so has a single column where that record has a single sensor
    is_measured : whether the temperatures are measured, and not computed
    raises      : InputError where a depth is missing, or the result is no record
    """
    model = load_record(like)
    declared, columns = model.declared, sensor_columns(measured)
    sensors, notes = _sensors_like(model, measured, [c.name for c in columns], depths, noise_K)
    thermocouples = declared.thermocouples.model_copy(update={"sensor": sensors})
    update = {
        "thermocouples": thermocouples,
        "title": title or f"{measured.path.name} on {declared.title}",
        "measured": is_measured,
        "source": f"temperatures: {measured.path.name}; stack, flight and heating: those of {model.name}",
        "confidence": "",
    }
    if declared.confidence:
        notes.append(f"confidence not stated (`confidence`): that of {model.name} is of its readings too")
    times = measured.of_kind(TIME)[0].si
    readings = {"time_s": times} | {s.column: c.si for s, c in zip(sensors, columns, strict=True)}
    with said_of_sources({"thermocouples.csv": source_of_readings(measured)}, out):
        record = make_record(
            declared.model_copy(update=update), model.conditions, readings, model.ratio_table, out, model.turbulent
        )
    comment = f"Temperatures of {measured.path.name}, stack and flight of {model.name}; made by sim-heating new record."
    write_record(record, out, comment=comment)
    return record, [*measured.notes, *notes, f"stack, flight and heating of {files.display_path(Path(like))}"]


def _sensors_like(
    model: Record, measured: MeasuredCsv, names: Sequence[str], depths: Mapping[str, str], noise_K: float | None
) -> tuple[list[Sensor], list[str]]:
    """Sensors at the depths that are stated, else at those of another record's sensors, and notes of them.

    raises : InputError where a depth is missing
    """
    declared = model.declared
    others = _sensors_by_column(model, names)
    layers = [
        LayerInput(layer.material, declared.materials[layer.material], layer.thickness_m)
        for layer in declared.stack.layer
    ]
    stated = depths_of(measured, depths, layers)
    if absent := [name for name in names if name not in {*stated, *others}]:
        raise InputError(
            f"--depth: is missing for {', '.join(absent)}; {model.name} has sensors "
            f"{', '.join(s.column for s in model.sensors)}; write --depth {absent[0]}=0.4mm"
        )
    sensors, notes = [], []
    for name in names:
        depth = stated[name] if name in stated else others[name].depth_m
        sensors.append(Sensor(name=name, column=_column_name(name), depth_m=depth, noise_sigma_K=noise_K))
        notes.append(f"{name} at {depth * 1e3:g} mm" + ("" if name in stated else f", as in {model.name}"))
        if noise_K is None:
            notes.append(_noise_note(name, others.get(name), model))
    return sensors, notes


def _noise_note(name: str, other: Sensor | None, model: Record) -> str:
    noise = None if other is None else other.noise_sigma_K
    of_other = "" if noise is None else f"; the {noise:g} K of {model.name} are of its recorder"
    return f"noise of {name} estimated (--noise 0.5K states it){of_other}"


def _sensors_by_column(model: Record, names: Sequence[str]) -> dict[str, Sensor]:
    """Sensors of a record by their names and columns, and a single one by the name of a single column as well."""
    sensors = {key: s for s in model.sensors for key in (s.column, s.name, s.column.removesuffix("_K"))}
    if len(names) == len(model.sensors) == 1:
        sensors.setdefault(names[0], model.sensors[0])
    return sensors
