"""Rows of JSON as a block of cells: one object a line, a list of objects, or one object with a list for each column."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path
from sim_heating.heating.recorded.cells.block import Block, of_frame


def is_json(text: str) -> bool:
    """Whether a text begins as an object of JSON does, or as a list of them."""
    return re.match(r"\s*(\{|\[\s*\{)", text) is not None


def json_block(path: Path, text: str) -> Block:
    """The block of objects of JSON, one a row; `lines` numbers those of a list from 1.

    raises : InputError, one line, for a line that is damaged, and for a row that is no object
    """
    if text.lstrip().startswith("["):
        rows = list(enumerate(_value(path, 1, text), 1))
    else:
        rows = [(i, _value(path, i, line)) for i, line in enumerate(text.splitlines(), 1) if line.strip()]
    for i, row in rows:
        if not isinstance(row, dict):
            raise InputError(f"{display_path(path)}, row {i}: no JSON object; write one a row, with the same keys")
    if len(rows) == 1:
        rows = _rows_of_columns(rows[0][1])
    block = of_frame(path, pd.DataFrame([row for _, row in rows], dtype=object), {}, "JSON")
    return replace(block, lines=tuple(i for i, _ in rows))


def _rows_of_columns(columns: dict[str, Any]) -> list[tuple[int, dict[str, Any]]]:
    """Rows of an object with a list for each column; the object itself where its values are no lists of one length."""
    if {isinstance(v, list) for v in columns.values()} != {True} or len({len(v) for v in columns.values()}) > 1:
        return [(1, columns)]
    return [(i, dict(zip(columns, row, strict=True))) for i, row in enumerate(zip(*columns.values(), strict=True), 1)]


def _value(path: Path, first: int, text: str) -> Any:
    """What a text of JSON holds, which begins in a line of the file."""
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        line, problem = first + error.lineno - 1, f"is not JSON ({error.msg})"
    except RecursionError:
        line, problem = first, "objects or lists are nested too deeply"
    raise InputError(f"{display_path(path)}, row {line}: {problem}; write one object a row, with the same keys")
