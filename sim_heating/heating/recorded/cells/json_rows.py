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
    # objects within a row are columns of their own, `tc.TC1`
    block = of_frame(path, pd.json_normalize(_with_named_items([row for _, row in rows])).astype(object), {}, "JSON")
    return replace(block, lines=tuple(i for i, _ in rows))


def _with_named_items(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows whose lists, as long as in the first row each, are objects of their numbers from 1 on: `tc.1`, `tc.2`."""
    listed = {key for key, value in rows[0].items() if isinstance(value, list)}
    even = {key for key in listed if {_length(row.get(key)) for row in rows} == {len(rows[0][key])}}
    return [{k: dict(enumerate(v, 1)) if k in even else v for k, v in row.items()} for row in rows] if even else rows


def _length(value: Any) -> int:
    return len(value) if isinstance(value, list) else -1


def _rows_of_columns(columns: dict[str, Any]) -> list[tuple[int, dict[str, Any]]]:
    """Rows of an object with a list for each column, or with one list of objects; else the object itself."""
    listed = [v for v in columns.values() if isinstance(v, list) and {*map(type, v)} == {dict}]
    if len(listed) == 1:
        return list(enumerate(listed[0], 1))
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
