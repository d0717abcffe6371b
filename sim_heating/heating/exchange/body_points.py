"""Heating ratios of control points from a CSV file of body points, as flow solvers write one.

    x_m,y_m,z_m,alpha_deg,log10_re,film_kg_m2_s,h_ref_kg_m2_s
    1.20,0.00,-0.30,40,5.5,0.0121,0.0404

One row is a body point of one flow case. Columns: the position x_m, y_m, z_m; alpha_deg, optionally beta_deg; one of
log10_re, re, and mach with altitude_m; and one of

    film_kg_m2_s with h_ref_kg_m2_s     film coefficient of the point, and of the reference sphere in that case
    q_W_m2 with q_ref_W_m2              flux at the point and at the reference sphere, of walls of one temperature
    film_kg_m2_s; q_W_m2 with wall_K    with mach and altitude_m: the reference sphere is computed, in the standard
                                        atmosphere, and the enthalpy of the wall from its temperature

of which the ratio is the heating ratio: q = h (H_r - H_w), with the same H_r - H_w at both. Heads may state other
units, as `x [in]`, `alpha (rad)`, `q_btu_ft2_s`. Every control point takes the nearest body point of each case. The
cases have to make a full grid of angle of attack, sideslip and log10 Re.

Source: docs/theory/equations.md, equation 1.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Iterable, Mapping
from itertools import chain
from pathlib import Path

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError, error_context
from sim_heating.base.files import CsvTable, csv_text, display_path, raise_problems
from sim_heating.base.files.csv_table import names_line, read_csv_columns
from sim_heating.base.files.text import read_text
from sim_heating.base.files.units import Conversion, converted, name_and_unit
from sim_heating.heating.atmosphere import free_stream, standard_speed_of_sound, us76
from sim_heating.heating.ratio.table import RatioTable, table_of_text
from sim_heating.heating.reference.gas import wall_enthalpy_grid
from sim_heating.heating.reference.models import reference_heating

POSITION = ("x_m", "y_m", "z_m")
REYNOLDS = (("log10_re",), ("re",), ("mach", "altitude_m"))
HEATING = (("film_kg_m2_s", "h_ref_kg_m2_s"), ("q_W_m2", "q_ref_W_m2"))
"""Columns of which one group has to be there: the Reynolds number, and the heating over that of the reference."""
FLOW = REYNOLDS[2]
COMPUTED = (("film_kg_m2_s", *FLOW), ("q_W_m2", "wall_K", *FLOW))
"""Columns with which the reference is computed, where the file has none."""
UNITS = dict.fromkeys((*POSITION, "altitude_m"), "m") | dict.fromkeys(("alpha_deg", "beta_deg"), "deg")
UNITS |= dict.fromkeys(HEATING[0], "kg/(m2 s)") | dict.fromkeys(HEATING[1], "W/m2") | {"wall_K": "K"}
"""Column -> its unit."""
SHORT = {name.rpartition("_")[0]: name for name in (*POSITION, "alpha_deg", "beta_deg", "altitude_m")}
SHORT |= {"film": HEATING[0][0], "h_ref": HEATING[0][1], "q": HEATING[1][0], "q_ref": HEATING[1][1], "t_wall": "wall_K"}
SHORT |= {name: name for name in ("re", "mach", "log10_re")}
"""Name in the head of a column, in small letters and without its unit, to the column."""
WALL_PRESSURE_PA = 2e3
"""Pressure of the air at the wall; its enthalpy depends on pressure above 2000 K alone."""
CASE_DIGITS = 6
"""Decimals to which the Reynolds numbers of rows of one case agree."""


def tables_of_body_points(
    path: str | os.PathLike[str],
    positions: Mapping[str, tuple[float, float, float]],
    reference_length_m: float,
    *,
    farthest_m: float = 0.5,
    reference: str | None = None,
    nose_radius_m: float | None = None,
) -> dict[str, RatioTable]:
    """Ratio tables of control points.

    path               : CSV file as above
    positions          : name -> position of a control point [m], in the axes of the file
    reference_length_m : of the Reynolds number [m]; read with the column mach alone
    farthest_m         : most distance of a body point that stands for a control point [m]
    reference          : reference heating that the file's is, for the header of the tables
    nose_radius_m      : of the reference sphere [m], where the file has the point's heating alone
    returns            : name -> table, of the points that have a body point within that distance
    raises             : InputError with file, row and column; none of the points is near a body point
    """
    file = _in_columns(Path(path))
    where = display_path(path)
    ratio = _ratio(file, where, reference, nose_radius_m)
    log_re = np.round(_log10_re(file, where, reference_length_m), CASE_DIGITS)
    beta = file["beta_deg"] if "beta_deg" in file.columns else np.zeros(len(file))
    cases, case = np.unique(np.column_stack([file["alpha_deg"], beta, log_re]), axis=0, return_inverse=True)
    case = np.ravel(case)
    body = np.column_stack([file[n] for n in POSITION])
    tables: dict[str, RatioTable] = {}
    nearest_m = np.inf
    for name, position in positions.items():
        away = np.linalg.norm(body - np.asarray(position), axis=1)
        nearest_m = min(nearest_m, float(away.min()))
        rows = np.array([np.flatnonzero(case == k)[np.argmin(away[case == k])] for k in range(len(cases))])
        if away[rows].max() > farthest_m:
            continue
        columns = {"alpha_deg": cases[:, 0], "beta_deg": cases[:, 1], "log10_re": cases[:, 2], "ratio": ratio[rows]}
        header = {
            "control_point": name,
            "source": f"body points of {Path(path).name}",
            "farthest_body_point_m": f"{away[rows].max():.4g}",
        }
        tables[name] = table_of_text(Path(path), csv_text(columns, None, header | _named(reference)))
    if not tables:
        raise InputError(
            f"{where}: no control point has a body point of every case within {farthest_m:g} m (the "
            f"nearest is {nearest_m:.3g} m away); check axes and units, or --farthest"
        )
    return tables


def _named(reference: str | None) -> dict[str, str]:
    return {} if reference is None else {"reference": reference}


def _group(file: CsvTable, groups: tuple[tuple[str, ...], ...], where: str) -> tuple[str, ...]:
    """The first group of columns that the file has.

    raises : InputError that names the groups
    """
    for names in groups:
        if _has(file, names):
            return names
    choices = ", or ".join(" with ".join(f"`{n}`" for n in names) for names in groups)
    raise InputError(f"{where}: lacks columns; give {choices}")


def _has(file: CsvTable, names: Iterable[str]) -> bool:
    return all(n in file.columns for n in names)


def _in_columns(path: Path) -> CsvTable:
    """The columns of a file, under their names here and in their units.

    raises : InputError for a head with a unit of another quantity, or without one
    """
    lines = read_text(path).splitlines()
    at = names_line(lines)
    heads = [] if at is None else next(csv.reader([lines[at]]))
    columns = [_column_and_unit(head, display_path(path)) for head in heads]
    if at is not None:
        lines[at] = ",".join(name for name, _ in columns)
    optional = ("beta_deg", "wall_K", *chain.from_iterable((*REYNOLDS, *HEATING)))
    renamed = {name: head.strip() for head, (name, _) in zip(heads, columns, strict=True) if name != head.strip()}
    file = read_csv_columns(path, (*POSITION, "alpha_deg"), optional, content="\n".join(lines), heads=renamed)
    return file.with_columns(
        {n: u.factor * file[n] + u.offset for n, u in columns if u is not None and n in file.columns}
    )


def _column_and_unit(head: str, where: str) -> tuple[str, Conversion | None]:
    """Column of a head, and the conversion of its unit; the head itself where it is no column of another unit."""
    if head in UNITS:
        return head, None
    name, unit = name_and_unit(head, list(dict.fromkeys(UNITS.values())))
    column = SHORT.get(name.lower())
    if column is None or column not in UNITS:
        return column or head, None
    conversion = converted(unit, UNITS[column]) if unit else None
    if conversion is None:
        problem = f"`{unit}` is no unit of {UNITS[column]}" if unit else "states no unit"
        raise InputError(f"{where}, column `{head}`: {problem}; write `{column}`, or its unit in brackets")
    return column, conversion


def _ratio(file: CsvTable, where: str, reference: str | None, nose_radius_m: float | None) -> FloatArray:
    computed = next((names for names in COMPUTED if _has(file, names)), None)
    has_reference = any(_has(file, names) for names in HEATING)
    if computed is not None and not has_reference and reference is not None and nose_radius_m is not None:
        h_ref, H_r = _reference_of(file, where, reference, nose_radius_m)
        if computed == COMPUTED[0]:
            return file["film_kg_m2_s"] / h_ref
        raise_problems(file.celsius_problems("wall_K"))
        H_w = wall_enthalpy_grid("equilibrium-air", file["wall_K"], [WALL_PRESSURE_PA])[:, 0]
        return file["q_W_m2"] / (h_ref * (H_r - H_w))
    above, below = _group(file, HEATING, where)
    bad = np.flatnonzero(~(file[below] > 0.0))
    if bad.size:
        raise InputError(file.problem(int(bad[0]), below, "is not above 0; the reference is heated in every case"))
    return file[above] / file[below]


def _reference_of(file: CsvTable, where: str, reference: str, nose_radius_m: float) -> tuple[FloatArray, FloatArray]:
    """Film coefficient [kg/(m2 s)] and recovery enthalpy [J/kg] of the reference sphere in each row.

    raises : InputError for a reference that needs more than speed and altitude
    """
    z, speed = _altitude_and_speed(file)
    T_K, _, rho = us76(z)
    flown = {"time_s": np.arange(len(z), dtype=float), "velocity_m_s": speed, "T_inf_K": T_K, "rho_kg_m3": rho}
    with error_context(where):
        h_ref, H_r, _ = reference_heating(reference, Conditions(flown), nose_radius_m=nose_radius_m)
    return h_ref, H_r


def _altitude_and_speed(file: CsvTable) -> tuple[FloatArray, FloatArray]:
    """Altitude [m] and speed [m/s] of each row, in the standard atmosphere."""
    raise_problems(file.problems_where_not("mach", file["mach"] > 0.0, "is not above 0"))
    with error_context(display_path(file.path)):
        return file["altitude_m"], file["mach"] * standard_speed_of_sound(file["altitude_m"])


def _log10_re(file: CsvTable, where: str, reference_length_m: float) -> FloatArray:
    names = _group(file, REYNOLDS, where)
    if names == ("log10_re",):
        return file["log10_re"]
    if names == FLOW:
        z, speed = _altitude_and_speed(file)
        return free_stream(z, speed, us76(z)[2], reference_length_m)["log10_re"]
    raise_problems(file.problems_where_not("re", file["re"] > 0.0, "is not above 0"))
    return np.log10(file["re"])
