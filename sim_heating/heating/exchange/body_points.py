"""Heating ratios of control points from a CSV file of body points, as flow solvers write one.

    x_m,y_m,z_m,alpha_deg,log10_re,film_kg_m2_s,h_ref_kg_m2_s
    1.20,0.00,-0.30,40,5.5,0.0121,0.0404

One row is a body point of one flow case. Columns: the position x_m, y_m, z_m; alpha_deg, optionally beta_deg; one of
log10_re, re, and mach with altitude_m; and one of

    film_kg_m2_s with h_ref_kg_m2_s     film coefficient of the point, and of the reference sphere in that case
    q_W_m2 with q_ref_W_m2              flux at the point and at the reference sphere, of walls of one temperature

of which the ratio is the heating ratio: q = h (H_r - H_w), with the same H_r - H_w at both. Every control point takes
the nearest body point of each case. The cases have to make a full grid of angle of attack, sideslip and log10 Re.

Source: docs/theory/equations.md, equation 1.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.files import CsvTable, csv_text, display_path, read_csv_columns
from sim_heating.heating.atmosphere import free_stream, standard_speed_of_sound, us76
from sim_heating.heating.ratio.table import RatioTable, table_of_text

POSITION = ("x_m", "y_m", "z_m")
REYNOLDS = (("log10_re",), ("re",), ("mach", "altitude_m"))
HEATING = (("film_kg_m2_s", "h_ref_kg_m2_s"), ("q_W_m2", "q_ref_W_m2"))
"""Columns of which one group has to be there: the Reynolds number, and the heating over that of the reference."""
CASE_DIGITS = 6
"""Decimals to which the Reynolds numbers of rows of one case agree."""


def tables_of_body_points(
    path: str | os.PathLike[str],
    positions: Mapping[str, tuple[float, float, float]],
    reference_length_m: float,
    *,
    farthest_m: float = 0.5,
    reference: str | None = None,
) -> dict[str, RatioTable]:
    """Ratio tables of control points.

    path               : CSV file as above
    positions          : name -> position of a control point [m], in the axes of the file
    reference_length_m : of the Reynolds number [m]; read with the column mach alone
    farthest_m         : most distance of a body point that stands for a control point [m]
    reference          : reference heating that the file's is, for the header of the tables
    returns            : name -> table, of the points that have a body point within that distance
    raises             : InputError with file, row and column; none of the points is near a body point
    """
    file = read_csv_columns(
        path, (*POSITION, "alpha_deg"), ("beta_deg", *(n for g in (*REYNOLDS, *HEATING) for n in g))
    )
    where = display_path(path)
    ratio = _ratio(file, where)
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
        if all(n in file.columns for n in names):
            return names
    choices = ", or ".join(" with ".join(f"`{n}`" for n in names) for names in groups)
    raise InputError(f"{where}: lacks columns; give {choices}")


def _ratio(file: CsvTable, where: str) -> FloatArray:
    above, below = _group(file, HEATING, where)
    bad = np.flatnonzero(~(file[below] > 0.0))
    if bad.size:
        raise InputError(file.problem(int(bad[0]), below, "is not above 0; the reference is heated in every case"))
    return file[above] / file[below]


def _log10_re(file: CsvTable, where: str, reference_length_m: float) -> FloatArray:
    names = _group(file, REYNOLDS, where)
    if names == ("log10_re",):
        return file["log10_re"]
    bad = np.flatnonzero(~(file[names[0]] > 0.0))
    if bad.size:
        raise InputError(file.problem(int(bad[0]), names[0], "is not above 0"))
    if names == ("re",):
        return np.log10(file["re"])
    z = file["altitude_m"]
    speed = file["mach"] * standard_speed_of_sound(z)
    return free_stream(z, speed, us76(z)[2], reference_length_m)["log10_re"]
