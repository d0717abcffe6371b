"""Files installed with the package: data folders, numeric tables, the version."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sim_heating.base.arrays import FloatArray

PACKAGE = Path(__file__).resolve().parents[2]
"""Folder of the package `sim_heating`."""


def package_version() -> str:
    """Version of the installed package, or `not installed`."""
    try:
        return version("sim-heating")
    except PackageNotFoundError:
        return "not installed"


def data_folders(name: str) -> tuple[Path, Path]:
    """Possible places of a data folder: within an installed package, or next to the package in a checkout."""
    return PACKAGE / name, PACKAGE.parent / name


def read_package_table(name: str) -> dict[str, FloatArray]:
    """Columns of a numeric CSV file of the package: `#` lines of provenance, one line of names, rows of numbers.

    name : path within the package, such as `heating/data/us76_layers.csv`
    """
    import numpy as np

    lines = [line for line in (PACKAGE / name).read_text(encoding="utf-8").splitlines() if line[:1] not in ("", "#")]
    numbers = np.loadtxt(lines[1:], delimiter=",", ndmin=2)
    return {column: np.ascontiguousarray(numbers[:, i]) for i, column in enumerate(lines[0].split(","))}
