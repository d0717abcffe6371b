"""The tables of a file format: its keys or columns with units, ranges and defaults."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from sim_heating.formats.catalogue import ColumnFormat, FileFormat, KeyFormat, ModelFormat
from sim_heating.formats.schema_files import schema


@dataclass(frozen=True)
class Key:
    """A key of a table: what its value is, its default, and what it means; `required` where there is no default."""

    name: str
    value: str
    default: str
    required: bool
    description: str


@dataclass(frozen=True)
class KeyTable:
    """A table of a file: its heading in the file, what it is, and its keys."""

    heading: str
    about: str
    keys: tuple[Key, ...]


KINDS = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false", "null": "null"}
"""Type of JSON Schema -> what a page calls it."""


def key_tables(declared: FileFormat) -> list[KeyTable]:
    """The tables of a format, or one table with its columns or its keys."""
    if isinstance(declared, ColumnFormat):
        rows = [Key(n, "", "", True, text) for n, text in declared.required.items()]
        rows += [Key(n, "", "", False, text) for n, text in declared.optional.items()]
        return [KeyTable("", "", tuple(rows))]
    if isinstance(declared, KeyFormat):
        return [KeyTable("", "", tuple(Key(n, "", "", True, text) for n, text in declared.keys.items()))]
    assert isinstance(declared, ModelFormat)
    js = schema(declared)
    return list(_Walk(js.get("$defs", {}), declared.language).tables("", js, js))


class _Walk:
    """Tables of a JSON Schema in the order of its keys, each model once."""

    def __init__(self, models: Mapping[str, Any], language: str) -> None:
        self.models, self.language = models, language
        self.seen: set[str] = set()

    def tables(self, heading: str, js: Mapping[str, Any], root: Mapping[str, Any]) -> Iterator[KeyTable]:
        required, below = js.get("required", []), []
        keys = []
        for name, value in js.get("properties", {}).items():
            keys.append(Key(name, self._value(value), _default(value), name in required, self._description(value)))
            below += [(path, model) for path, model in self._below(f"{heading}.{name}".lstrip("."), value)]
        about = "" if js is root else str(js.get("description", ""))
        yield KeyTable(self._heading(heading), about, tuple(keys))
        for path, model in below:
            if model not in self.seen:
                self.seen.add(model)
                yield from self.tables(path, self.models[model], root)

    def _heading(self, path: str) -> str:
        if self.language == "json" or not path:
            return path
        return f"[[{path[:-2]}]]" if path.endswith("[]") else f"[{path}]"

    def _below(self, path: str, js: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
        """Models below a key, each with its place in the file; `place[]` is an entry of a list of tables."""
        if "$ref" in js:
            yield path, _name(js["$ref"])
        if isinstance(js.get("items"), Mapping):
            yield from self._below(f"{path}[]", js["items"])
        if isinstance(js.get("additionalProperties"), Mapping):
            yield from self._below(f"{path}.NAME", js["additionalProperties"])
        for branch in (*js.get("anyOf", []), *js.get("oneOf", [])):
            yield from self._below(path, branch)

    def _description(self, js: Mapping[str, Any]) -> str:
        if "description" in js:
            return str(js["description"])
        models = list(self._below("", js))
        return str(self.models[models[0][1]].get("description", "")) if len(models) == 1 else ""

    def _value(self, js: Mapping[str, Any]) -> str:
        """What a value may be, in words."""
        if "$ref" in js:
            return "table"
        if "const" in js:
            return f"`{json.dumps(js['const'])}`"
        if "enum" in js:
            return ", ".join(f"`{json.dumps(v)}`" for v in js["enum"])
        branches = [*js.get("anyOf", []), *js.get("oneOf", [])]
        if branches:
            return " or ".join(dict.fromkeys(self._value(b) for b in branches))
        kind = js.get("type")
        if kind in ("number", "integer"):
            return KINDS[kind] + _range(js)
        if kind == "array":
            return self._list(js)
        return self._table(js) if kind == "object" else KINDS.get(str(kind), "any")

    def _table(self, js: Mapping[str, Any]) -> str:
        inner = js.get("additionalProperties")
        return "table" if not isinstance(inner, Mapping) or "$ref" in inner else f"table of {self._value(inner)}"

    def _list(self, js: Mapping[str, Any]) -> str:
        if "prefixItems" in js:
            return "[" + ", ".join(self._value(i) for i in js["prefixItems"]) + "]"
        items = js.get("items", {})
        return "list of tables" if "$ref" in items or "oneOf" in items else f"list of {self._value(items)}"


def _name(reference: str) -> str:
    return reference.rpartition("/")[2]


def _range(js: Mapping[str, Any]) -> str:
    """` (0 to 45)` or ` (above 0)`; empty without a limit."""
    start, end = _end(js, "minimum", "exclusiveMinimum", "above"), _end(js, "maximum", "exclusiveMaximum", "below")
    if start and end:
        return f" ({start} to {end})"
    if start:
        return f" ({start} or more)" if "minimum" in js else f" ({start})"
    if end:
        return f" (up to {end})" if "maximum" in js else f" ({end})"
    return ""


def _end(js: Mapping[str, Any], included: str, excluded: str, beyond: str) -> str:
    """`45`, or `above 0` of an end that is excluded; empty without one."""
    if included in js:
        return f"{js[included]:g}"
    return f"{beyond} {js[excluded]:g}" if excluded in js else ""


def _default(js: Mapping[str, Any]) -> str:
    value = js.get("default")
    return "" if value is None or value in ("", [], {}) or isinstance(value, dict) else f"`{json.dumps(value)}`"
