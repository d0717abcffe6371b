"""Tecplot's text files of one zone of points as a block of cells."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path
from sim_heating.heating.recorded.cells.block import Block

BEGIN = re.compile(r"(?im)\A(?:\s+|#.*$|title\s*=.*$)*variables\s*=")
NUMBERS = re.compile(r"[\s,\d.eEdD+-]*\d[\s,\d.eEdD+-]*")
"""A line of numbers alone."""


def is_tecplot(text: str) -> bool:
    """Whether a text begins as a file of Tecplot does: `VARIABLES = "Time (s)", "Altitude (ft)"`."""
    return BEGIN.match(text) is not None


def tecplot_block(path: Path, text: str) -> Block:
    """The block of a Tecplot file of one zone, a line a point.

    raises : InputError, one line, for a second zone, and for a line without a number for each variable
    """
    lines = [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip()[:1] not in ("", "#")]
    first = next((k for k, (_, line) in enumerate(lines) if NUMBERS.fullmatch(line)), len(lines))
    names = _variables(lines[:first])
    rows = [(i, tuple(re.split(r"[\s,]+", line.strip(", \t")))) for i, line in lines[first:]]
    if not rows:
        raise InputError(f"{display_path(path)}: no rows of numbers were found; give a file with a zone of points")
    for i, cells in rows:
        if len(cells) != len(names) or not NUMBERS.fullmatch(" ".join(cells)):
            shown = " ".join(cells)[:40]
            rule = f"is not one number for each of {len(names)} variables; export one zone with DATAPACKING=POINT"
            raise InputError(f"{display_path(path)}, row {i}: `{shown}` {rule}")
    numbers, points = zip(*rows, strict=True)
    columns = tuple(map(list, zip(*points, strict=True)))
    return Block(path, names, ("",) * len(names), columns, numbers, decimal=".", about="Tecplot")


def _variables(lines: Sequence[tuple[int, str]]) -> tuple[str, ...]:
    """Names of the variables in the lines above the points."""
    head = "\n".join(line for _, line in lines)
    listed = re.split(r"(?im)^\s*zone\b", re.split(r"(?i)variables\s*=", head, maxsplit=1)[1], maxsplit=1)[0]
    return tuple(quoted or bare for quoted, bare in re.findall(r'"([^"]*)"|([^\s,"]+)', listed))
