"""Heating-ratio tables in files of other programs: one table of formats, each with a reader and a writer.

    table = read_table("pod.dml")
    write_table("pod.nc", table)

| suffix | format | read | written |
|---|---|---|---|
| .csv | this program's | yes | yes |
| .dml | DAVE-ML, ANSI/AIAA S-119 | yes | yes, with check data |
| .nc | netCDF | yes | yes |

The system for JSBSim (`jsbsim_system`) needs the wall of a point besides its table; body points of a flow solver
(`body_points`) become the tables of several points.

Source: Jackson and Hildreth (2002), "Flight Dynamic Model Exchange Using XML", AIAA 2002-4482.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base.conditions import DESCRIPTIONS, RATIO_VARIABLES, SURFACES
from sim_heating.base.errors import InputError
from sim_heating.base.files import csv_text, display_path, raise_problems, write_text_atomic
from sim_heating.base.files.text import write_bytes_atomic
from sim_heating.heating.exchange import dave_ml
from sim_heating.heating.ratio.table import RatioTable, read_ratio_table, table_of_text, write_ratio_table

RATIO, SIGMA = "ratio", "sigma"
STANDARD_NAMES = {
    "alpha_deg": "angleOfAttack",
    "beta_deg": "angleOfSideslip",
    "log10_re": "log10ReynoldsNumber",
    "elevon_deg": "elevonDeflection",
    "bodyflap_deg": "bodyFlapDeflection",
    RATIO: "heatingRatio",
    SIGMA: "heatingRatioSigma",
}
"""Column -> name of the variable in DAVE-ML: that of S-119 where the standard has one."""
TOLERANCE = 1e-9
"""Of the check values that are written."""
MOST_NODES = 1_000_000
"""Nodes of a table that a model may be sampled at."""


@dataclass(frozen=True)
class TableFormat:
    """A format of ratio tables: its reader and its writer."""

    title: str
    read: Callable[[Path], RatioTable]
    write: Callable[[Path, RatioTable], None]


def _units(name: str) -> str:
    return "deg" if name.endswith("_deg") else "nd"


def dave_ml_of(table: RatioTable) -> dave_ml.DaveModel:
    """A ratio table as a model: five inputs ([deg], [-]), the ratio and its sigma [-]; check data at nodes and
    between them.

    Header entries of the table become lines `key: value` of the description.
    """
    names = (*RATIO_VARIABLES, RATIO, *(() if table.sigma is None else (SIGMA,)))
    variables = {
        n: dave_ml.Variable(
            n,
            {"name": STANDARD_NAMES[n], "units": _units(n)},
            ("isInput",) if n in RATIO_VARIABLES else ("isOutput",),
            DESCRIPTIONS.get(n, "film coefficient over the reference film coefficient, " + n),
        )
        for n in names
    }
    ends = tuple((float(a[0]), float(a[-1])) for a in table.axes)
    extrapolation = ("neither",) * len(RATIO_VARIABLES)
    functions = tuple(
        dave_ml.Function(
            STANDARD_NAMES[n],
            RATIO_VARIABLES,
            n,
            dave_ml.GriddedTable(f"{n}_table", (), table.axes, values),
            ends,
            extrapolation,
        )
        for n, values in ((RATIO, table.ratio), (SIGMA, table.sigma))
        if values is not None
    )
    about = "\n".join(f"{key}: {value}" for key, value in table.header.items())
    title = f"Heating ratio {table.header.get('control_point', '')}".strip()
    author = {"name": table.header.get("source", "unknown"), "org": "unknown"}
    model = dave_ml.DaveModel(title, variables, functions, (), about, author)
    cases = tuple(_case(model, k, x) for k, x in enumerate(_check_points(table)))
    return dave_ml.DaveModel(title, variables, functions, cases, about, author)


def _check_points(table: RatioTable) -> list[dict[str, float]]:
    """The first and the last node, the middle of the first cell, and a point beyond the last node."""
    first = [float(a[0]) for a in table.axes]
    last = [float(a[-1]) for a in table.axes]
    middle = [float(0.5 * (a[0] + a[min(1, len(a) - 1)])) for a in table.axes]
    beyond = [x + 1.0 for x in last]
    return [dict(zip(RATIO_VARIABLES, x, strict=True)) for x in (first, middle, last, beyond)]


def _case(model: dave_ml.DaveModel, number: int, x: Mapping[str, float]) -> dave_ml.CheckCase:
    outputs = model.evaluate(x)
    results = tuple(dave_ml.Signal(n, float(outputs[n]), TOLERANCE) for n in model.outputs)
    return dave_ml.CheckCase(f"case {number + 1}", tuple(dave_ml.Signal(n, value) for n, value in x.items()), results)


def _inputs_of_ratio(model: dave_ml.DaveModel, where: str) -> dict[str, str | None]:
    """Variable of a heating ratio -> the input of a model that is it; None where the model has none.

    raises : InputError where an input is no such variable, or in another unit
    """
    inputs = {name: _variable_named(model, name, model.inputs) for name in RATIO_VARIABLES}
    unknown = [i for i in model.inputs if i not in inputs.values()]
    if unknown:
        names = ", ".join(STANDARD_NAMES[n] for n in RATIO_VARIABLES)
        raise InputError(f"{where}: input `{unknown[0]}` is no variable of a heating ratio ({names})")
    for name, i in inputs.items():
        units = "" if i is None else model.variables[i].attributes.get("units", "")
        if i is not None and units != _units(name):
            raise InputError(f"{where}: variableDef `{i}` is in `{units}`; `{_units(name)}` is read")
    return inputs


def _read_dave_ml(path: Path) -> RatioTable:
    """A ratio table from a model of which an output is the ratio, sampled at the nodes of its tables."""
    model, where = dave_ml.read_dave_ml(path), display_path(path)
    raise_problems([f"{where}: {p}" for p in model.check_problems()])
    result = _ratio_of(model, where)
    inputs = _inputs_of_ratio(model, where)
    axes = {name: model.nodes_of(i) for name, i in inputs.items()}
    if (count := int(np.prod(list(map(len, axes.values()))))) > MOST_NODES:
        raise InputError(f"{where}: its tables have {count} nodes together; {MOST_NODES} are read")
    grid = dict(zip(RATIO_VARIABLES, np.meshgrid(*axes.values(), indexing="ij"), strict=True))
    outputs = model.evaluate({i: grid[name] for name, i in inputs.items() if i is not None})
    columns = {name: g.ravel() for name, g in grid.items()}
    shape = grid["alpha_deg"].shape
    columns[RATIO] = np.broadcast_to(outputs[result], shape).ravel()
    sigma = _variable_named(model, SIGMA, model.outputs)
    if sigma is not None:
        columns[SIGMA] = np.broadcast_to(outputs[sigma], shape).ravel()
    header = dict(line.split(": ", 1) for line in model.about.splitlines() if ": " in line)
    header.setdefault("source", model.title)
    return table_of_text(path, csv_text(columns, None, header))


def _ratio_of(model: dave_ml.DaveModel, where: str) -> str:
    """Identifier of the output that is the ratio.

    raises : InputError where there is none
    """
    result = _variable_named(model, RATIO, model.outputs)
    if result is None:
        names = ", ".join(model.outputs) or "none"
        raise InputError(f"{where}: no output named `{STANDARD_NAMES[RATIO]}` or `{RATIO}` (outputs: {names})")
    return result


def _variable_named(model: dave_ml.DaveModel, name: str, among: tuple[str, ...]) -> str | None:
    """Identifier of the variable with the name in the standard, or the identifier, of a column."""
    accepted = (STANDARD_NAMES[name], name)
    return next((i for i in among if i in accepted or model.variables[i].name in accepted), None)


def _write_dave_ml(path: Path, table: RatioTable) -> None:
    write_text_atomic(path, dave_ml.dave_ml_text(dave_ml_of(table)))


def _absent_surfaces(data: Any, where: str) -> list[str]:
    """Deflections of surfaces [deg] that a data set has no dimension of, and that are 0.

    raises : InputError where another variable of a ratio is no dimension, another dimension is there, or one has no
             nodes
    """
    dimensions = list(map(str, data[RATIO].dims))
    lacking = [n for n in RATIO_VARIABLES if n not in dimensions]
    for name in lacking:
        if name not in SURFACES:
            raise InputError(
                f"{where}, variable {RATIO}: lacks the dimension `{name}`; give one node where it is constant"
            )
    for name in dimensions:
        if name not in RATIO_VARIABLES:
            raise InputError(f"{where}, variable {RATIO}: dimension `{name}` is none of {', '.join(RATIO_VARIABLES)}")
    for name in RATIO_VARIABLES:
        if name in dimensions and name not in data.coords:
            raise InputError(f"{where}: dimension `{name}` has no coordinate; give its nodes")
    return lacking


def _data_set(path: Path, where: str) -> Any:
    """A data set with a variable `ratio`.

    raises : InputError for another file
    """
    import xarray as xr

    try:
        with xr.open_dataset(path, decode_times=False) as opened:
            data = opened.load()
    except (OSError, ValueError) as error:
        raise InputError(f"{where}: is no netCDF file that can be read ({' '.join(str(error).split())[:80]})") from None
    if RATIO not in data:
        raise InputError(f"{where}: no variable `{RATIO}` (it has: {', '.join(map(str, data.data_vars)) or 'none'})")
    return data


def _read_netcdf(path: Path) -> RatioTable:
    """A ratio table from a variable `ratio` over coordinates named as the columns; `sigma` where it is there."""
    where = display_path(path)
    data = _data_set(path, where)
    data = data.expand_dims({n: [0.0] for n in _absent_surfaces(data, where)})
    grid = np.meshgrid(*(np.asarray(data[n], dtype=float) for n in RATIO_VARIABLES), indexing="ij")
    columns = {n: g.ravel() for n, g in zip(RATIO_VARIABLES, grid, strict=True)}
    for n in (RATIO, SIGMA):
        if n in data:
            columns[n] = np.asarray(data[n].transpose(*RATIO_VARIABLES), dtype=float).ravel()
    header = {str(k): " ".join(str(v).split()) for k, v in data.attrs.items() if k != "Conventions"}
    return table_of_text(path, csv_text(columns, None, header))


def _write_netcdf(path: Path, table: RatioTable) -> None:
    import xarray as xr

    values = {RATIO: table.ratio} | ({} if table.sigma is None else {SIGMA: table.sigma})
    texts = {
        RATIO: "film coefficient over the reference film coefficient",
        SIGMA: "one standard deviation of the ratio",
    }
    about = {
        n: {"units": "degree" if n.endswith("_deg") else "1", "long_name": DESCRIPTIONS[n]} for n in RATIO_VARIABLES
    }
    data = xr.Dataset(
        {n: (RATIO_VARIABLES, v, {"units": "1", "long_name": texts[n]}) for n, v in values.items()},
        {n: (n, axis, about[n]) for n, axis in zip(RATIO_VARIABLES, table.axes, strict=True)},
        {"Conventions": "CF-1.10", **table.header},
    )
    write_bytes_atomic(path, bytes(data.to_netcdf(engine="scipy")))


FORMATS: Mapping[str, TableFormat] = {
    ".csv": TableFormat("CSV of this program", read_ratio_table, write_ratio_table),
    ".dml": TableFormat("DAVE-ML (ANSI/AIAA S-119), with check data", _read_dave_ml, _write_dave_ml),
    ".nc": TableFormat("netCDF 3", _read_netcdf, _write_netcdf),
}
"""Suffix of a file -> its format."""


def table_format(path: str | os.PathLike[str]) -> TableFormat:
    """The format of a file by its suffix.

    raises : InputError that names the suffixes there are
    """
    suffix = Path(path).suffix.lower()
    if suffix not in FORMATS:
        suffixes = ", ".join(f"{s} ({f.title})" for s, f in FORMATS.items())
        raise InputError(f"{display_path(path)}: `{suffix}` is no format of ratio tables; there are {suffixes}")
    return FORMATS[suffix]


def read_table(path: str | os.PathLike[str]) -> RatioTable:
    """A ratio table [-] over angles [deg] and log10 Re [-] from a file of any format.

    raises : InputError with file and place
    """
    return table_format(path).read(Path(path))


def write_table(path: str | os.PathLike[str], table: RatioTable) -> None:
    """Write a ratio table [-] over angles [deg] and log10 Re [-] in the format of the suffix, atomically."""
    table_format(path).write(Path(path), table)
