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
from collections.abc import Sequence
from pathlib import Path

from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path
from sim_heating.heating.recorded.cells.block import Block
from sim_heating.heating.recorded.cells.numbers import shown_cell

PROBE = re.compile(r"#\s*Probe\s+(\d+)\s+(\([^)]*\))(.*)")
"""Number and place of a probe, and what is remarked of it, as `# Not Found`."""
TIME = re.compile(r"#\s*Time\b.*")
FIELD = "T"
"""Name of the file of a temperature."""


def is_foam(text: str) -> bool:
    """Whether a text begins as the probes of OpenFOAM do."""
    return PROBE.match(text.lstrip()) is not None


def foam_block(path: Path, text: str) -> Block:
    """The block of the probes of a scalar field, a column a probe, with their places in words.

    raises : InputError, one line, for a row without a number for each probe, such as of a vector
    """
    lines = [(i, line.strip()) for i, line in enumerate(text.splitlines(), 1) if line.strip()]
    rows = [(i, line) for i, line in lines if line[0] != "#"]
    if not rows:
        raise InputError(
            f"{display_path(path)}: no rows of numbers were found; give a file with times and temperatures"
        )
    names, places = _probes([line for _, line in lines])
    _require_scalars(path, rows, len(names))
    numbers, texts = zip(*rows, strict=True)
    units = ("s", *["K"] * (len(names) - 1)) if path.stem == FIELD else ("",) * len(names)
    names_line = next((i for i, line in lines if TIME.fullmatch(line)), 1)
    columns = tuple(map(list, zip(*map(str.split, texts), strict=True)))
    about = f"OpenFOAM probes, {places}"
    return Block(path, names, units, columns, numbers, decimal=".", names_line=names_line, about=about)


def _probes(lines: Sequence[str]) -> tuple[tuple[str, ...], str]:
    """Names of the time and the probes, and the places of the probes in words."""
    probes = list(filter(None, map(PROBE.fullmatch, lines)))
    places = "; ".join(f"{p[1]} at {p[2]} m{p[3].replace('#', ',').rstrip()}" for p in probes)
    return ("Time", *(f"Probe {p[1]}" for p in probes)), places


def _require_scalars(path: Path, rows: Sequence[tuple[int, str]], width: int) -> None:
    """Refuse the first row that is not a time and one number for each probe.

    raises : InputError, one line
    """
    for i, line in rows:
        if len(line.split()) != width or "(" in line:
            rule = f"is not a time and one number for each of {width - 1} probes; give the file of a scalar, as T"
            raise InputError(f"{display_path(path)}, row {i}: `{shown_cell(line)}` {rule}")
