"""JSON Schemas of the declared files: what each key holds, its range and its default, for editors and for the pages.

A schema is made from the model that reads the file. The description of a key is that of the field, else the line of the
model's docstring about it, else what its quantity is (`limits.quantity`). The schemas stand in `sim_heating/schemas`,
where editors find them through the first line of a file, `#:schema PATH` (`schema_line`).
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sim_heating.base.conditions import DESCRIPTIONS
from sim_heating.base.limits import Quantity, quantity

if TYPE_CHECKING:
    from pydantic import BaseModel

SCHEMAS = Path(__file__).resolve().parents[2] / "schemas"
"""Folder of the schemas, package data."""
SUFFIX = ".schema.json"
DIALECT = "https://json-schema.org/draft/2020-12/schema"
COMMON = {
    "format": "name and version of the format",
    "title": "title, free text",
    "note": "free text",
    "source": "where the numbers come from",
    "confidence": "A read in a source, B well known and not read again, C estimated",
    "vehicle": "name of a vehicle, or its directory relative to the file",
    "control_point": "name of a control point of the vehicle",
    "control_points": "names of control points of the vehicle; all where absent",
    "reference_condition": "conditions that derivatives are about",
    "unit": "unit, as `1/deg`",
}
"""Description of keys that mean the same in every format."""
_ENTRY = re.compile(r"^(\w+(?:, \w+)*) *: +(\S.*)$")
_RULE = re.compile(r"^is not (?:an? )?(?P<noun>.*?)(?: \([^()]*\))?(?:;.*)?$")


def schema_path(name: str) -> Path:
    """File of the JSON Schema of a format, by the name of the format, as `record` or `scenario`."""
    return SCHEMAS / f"{name}{SUFFIX}"


def schema_line(name: str, folder: str | os.PathLike[str] | None = None) -> str:
    """First line of a TOML file, by which editors find the schema of its format.

    folder : of a file that is moved together with the schemas, whose path is then relative to it; None for a file of a
             user, which may go to another machine, and names the schema beside it

    `sim-heating formats record --schema > record.schema.json` puts that of a record there.

    >>> schema_line("record")
    '#:schema record.schema.json'
    """
    target = schema_path(name)
    where = target.name if folder is None else Path(os.path.relpath(target, Path(folder).resolve())).as_posix()
    return f"#:schema {where}"


def documented(js: dict[str, Any], model: type[BaseModel], quantities: Mapping[str, Any]) -> dict[str, Any]:
    """The JSON Schema of a model with a description and the range of every key, without pydantic's titles.

    js         : schema of the model, changed in place
    quantities : field -> name of its quantity, as `toml.Declared.quantities`
    """
    js.pop("title", None)
    written = _docstring_entries(model)
    if model.__doc__:
        js["description"] = " ".join(model.__doc__.split("\n\n")[0].split())
    for name, value in js.get("properties", {}).items():
        value.pop("title", None)
        of_name = _quantity_of(name, model, quantities)
        if of_name is not None:
            _set_range(value, of_name)
        stated = model.model_fields[name].description if name in model.model_fields else None
        text = stated or written.get(name) or _usual_text(name, value, of_name)
        if text is not None:
            value["description"] = text
    return js


def _quantity_of(name: str, model: type[BaseModel], quantities: Mapping[str, Any]) -> Quantity | None:
    """The quantity of a field; None where another field states it, or each column has its own."""
    declared = quantities.get(name, name)
    is_name = isinstance(declared, str) and (declared == name or declared not in model.model_fields)
    return quantity(declared) if is_name else None


def _usual_text(name: str, js: Mapping[str, Any], measured: Quantity | None) -> str | None:
    """Description of a key by its name, or by its quantity; a table has its own."""
    if _is_table(js):
        return None
    return DESCRIPTIONS.get(name) or (COMMON.get(name) if measured is None else noun(measured))


def _is_table(js: Mapping[str, Any]) -> bool:
    """Whether a value is a table of a model, or a list of them, which has a description of its own."""
    below = [*js.get("anyOf", []), *js.get("oneOf", []), *([js["items"]] if "items" in js else [])]
    return "$ref" in js or any(map(_is_table, below))


def noun(measured: Quantity) -> str:
    """What a quantity is, from the rule of its messages: `a flight speed in m/s` gives `flight speed in m/s`."""
    match = _RULE.match(measured.rule)
    return match["noun"] if match else measured.rule


def _docstring_entries(model: type[BaseModel]) -> dict[str, str]:
    """Lines `name, name : text` of the docstrings of a model and of its bases, with the lines that go on below them."""
    entries: dict[str, str] = {}
    for owner in reversed(model.__mro__):
        names: list[str] = []
        for line in (owner.__dict__.get("__doc__") or "").splitlines():
            entry = _ENTRY.match(line.strip())
            if entry:
                names = entry[1].split(", ")
                entries |= dict.fromkeys(names, entry[2])
            elif names and line.strip():
                entries |= {name: f"{entries[name]} {line.strip()}" for name in names}
            else:
                names = []
    return entries


def _set_range(js: dict[str, Any], measured: Quantity) -> None:
    """Set the range of a quantity at every number of a schema, where the model sets none."""
    if js.get("type") in ("number", "integer"):
        for key, exclusive, end in (
            ("minimum", "exclusiveMinimum", measured.lowest),
            ("maximum", "exclusiveMaximum", measured.highest),
        ):
            if key not in js and exclusive not in js and abs(end) != float("inf"):
                js[key] = end
    for below in ("items", "additionalProperties"):
        if isinstance(js.get(below), dict):
            _set_range(js[below], measured)
    for branch in (*js.get("anyOf", []), *js.get("oneOf", []), *js.get("prefixItems", [])):
        _set_range(branch, measured)
