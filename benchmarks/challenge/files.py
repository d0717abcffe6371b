"""Reading of scenarios and vehicles as data, and writing of flight records: TOML and CSV."""

from __future__ import annotations

import csv
import json
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[2]
SCENARIOS = ROOT / "scenarios"
FLIGHTS = ROOT / "benchmarks" / "flights"
"""Flights that only benchmarks fly: their figures stay comparable when the shipped scenario changes."""
AIRCRAFT = ROOT / "aircraft_data"


def scenario_file(name: str) -> Path:
    """File of a scenario: that of the benchmarks where they have a flight of the name, else the shipped one."""
    own = FLIGHTS / f"{name}.toml"
    return own if own.is_file() else SCENARIOS / f"{name}.toml"


@cache
def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file; what is returned is shared and must not be changed."""
    with open(path, "rb") as file:
        return tomllib.load(file)


@cache
def read_csv(path: Path) -> dict[str, FloatArray]:
    """Columns of a CSV file of numbers; lines that start with # are skipped."""
    with open(path, newline="") as file:
        rows = list(csv.reader(line for line in file if not line.startswith("#")))
    return dict(zip(rows[0], np.array(rows[1:], dtype=float).T, strict=True))


def write_csv(path: Path, columns: Mapping[str, FloatArray], formats: Mapping[str, str], head: str = "") -> None:
    """Columns as text; NaN is an empty cell."""
    text = [
        ["" if np.isnan(value) else format(value, formats.get(name, ".10g")) for value in values]
        for name, values in columns.items()
    ]
    lines = (",".join(row) for row in zip(*text, strict=True))
    path.write_text(head + ",".join(columns) + "\n" + "\n".join(lines) + "\n")


def toml_text(content: Mapping[str, Any], name: str = "") -> str:
    """TOML of a mapping: scalars and lists first, then its tables and lists of tables."""
    plain = [f"{_key(k)} = {_value(v)}" for k, v in content.items() if not _is_table(v) and not _is_tables(v)]
    parts = ["\n".join(plain)] if plain else []
    for key, value in content.items():
        path = f"{name}.{_key(key)}" if name else _key(key)
        if _is_tables(value):
            parts += [f"[[{path}]]\n{toml_text(entry, path)}" for entry in value]
        elif _is_table(value):
            parts.append(f"[{path}]\n{toml_text(value, path)}")
    return "\n".join(part.rstrip("\n") + "\n" for part in parts)


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping)


def _is_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(v, Mapping) for v in value)


def _key(key: str) -> str:
    return key if key.replace("_", "").replace("-", "").isalnum() else json.dumps(key)


def _value(value: Any) -> str:
    if isinstance(value, (list, tuple, np.ndarray)):
        return "[" + ", ".join(map(_value, value)) + "]"
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    if isinstance(value, (float, np.floating)):
        return repr(float(value))
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    return json.dumps(str(value))


def nodes_of(
    columns: Mapping[str, FloatArray], names: Sequence[str], values: str
) -> tuple[list[FloatArray], FloatArray]:
    """Axes and grid of a table in long form; a node that is missing takes the value below it on the second axis."""
    axes = [np.unique(columns[name]) for name in names]
    grid = np.full([len(a) for a in axes], np.nan)
    grid[tuple(np.searchsorted(axis, columns[name]) for axis, name in zip(axes, names, strict=True))] = columns[values]
    for i in range(1, grid.shape[1]):
        grid[:, i] = np.where(np.isnan(grid[:, i]), grid[:, i - 1], grid[:, i])
    return axes, grid
