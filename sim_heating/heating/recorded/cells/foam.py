"""Probes of OpenFOAM as a block of cells: postProcessing/NAME/0/T.

    # Probe 0 (0 0 0.001)
    # Probe 1 (0 0 0.004)
    #       Probe             0             1
    #        Time
                0        293.15        293.15

The file has the name of its field; a field T is a temperature in K. Source: OpenFOAM user guide, function object
`probes`, and units of fields.
"""

from __future__ import annotations

import re
from pathlib import Path

from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path
from sim_heating.heating.recorded.cells.block import Block
from sim_heating.heating.recorded.cells.numbers import shown_cell

PROBE = re.compile(r"#\s*Probe\s+(\d+)\s+(\([^)]*\))(.*)")
"""Number and place of a probe, and what is remarked of it, as `# Not Found`."""
TIME = re.compile(r"#\s*Time\b.*")
FIELD, UNITS = "T", ("s", "K")
"""Name of the file of a temperature, and the units of its time and its readings."""


def is_foam(text: str) -> bool:
    """Whether a text begins as the probes of OpenFOAM do."""
    return PROBE.match(text.lstrip()) is not None


def foam_block(path: Path, text: str) -> Block:
    """The block of the probes of a scalar field, a column a probe, with their places in words.

    raises : InputError, one line, for a row without a number for each probe, such as of a vector
    """
    lines = [(i, line.strip()) for i, line in enumerate(text.splitlines(), 1) if line.strip()]
    probes = [match for _, line in lines if (match := PROBE.fullmatch(line))]
    rows = [(i, line) for i, line in lines if line[0] != "#"]
    names = ("Time", *(f"Probe {p[1]}" for p in probes))
    cells = [line.split() for _, line in rows]
    for (i, line), row in zip(rows, cells, strict=True):
        if len(row) != len(names) or "(" in line:
            rule = f"is not a time and one number for each of {len(probes)} probes; give the file of a scalar, as T"
            raise InputError(f"{display_path(path)}, row {i}: `{shown_cell(line)}` {rule}")
    if not rows:
        raise InputError(
            f"{display_path(path)}: no rows of numbers were found; give a file with times and temperatures"
        )
    is_temperature = path.stem == FIELD
    units = (UNITS[0] if is_temperature else "", *[UNITS[1] if is_temperature else ""] * len(probes))
    names_line = next((i for i, line in lines if TIME.fullmatch(line)), 1)
    columns = tuple(map(list, zip(*cells, strict=True)))
    places = "; ".join(f"{p[1]} at {p[2]} m{p[3].replace('#', ',').rstrip()}" for p in probes)
    return Block(
        path, names, units, columns, tuple(i for i, _ in rows), decimal=".", names_line=names_line,
        about=f"OpenFOAM probes, {places}",
    )  # fmt: skip
