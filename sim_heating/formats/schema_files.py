"""JSON Schemas of the formats, from the models that read the files; kept in `sim_heating/schemas`.

Python -m tools.format_pages writes them and the pages of the formats again.
"""

from __future__ import annotations

from typing import Any

from sim_heating.base.files import json_text
from sim_heating.base.files.schema import DIALECT, schema_path
from sim_heating.formats.catalogue import ModelFormat


def schema(declared: ModelFormat) -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a format."""
    js: dict[str, Any] = declared.load().model_json_schema()
    if declared.language == "toml":
        js = _without_null(js)
    top = {"$schema": DIALECT, "$id": schema_path(declared.name).name, "title": f"{declared.file}: {declared.title}"}
    return top | js


def schema_text(declared: ModelFormat) -> str:
    """Contents of the file of a schema."""
    return json_text(schema(declared))


def _without_null(js: Any) -> Any:
    """A schema without null, which TOML does not have: a key that may be null in Python may be absent."""
    if isinstance(js, list):
        return [_without_null(entry) for entry in js]
    if not isinstance(js, dict):
        return js
    kept = {k: _without_null(v) for k, v in js.items() if (k, v) != ("default", None)}
    if "anyOf" in kept:
        branches = [b for b in kept.pop("anyOf") if b != {"type": "null"}]
        kept = {"anyOf": branches, **kept} if len(branches) != 1 else {**branches[0], **kept}
    return kept
