"""TOML read into pydantic models, with every problem told by file, table, key, value and rule; and written back."""

from __future__ import annotations

import json
import math
import os
import re
import tomllib
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files.text import (
    abbreviated,
    as_builtin,
    display_path,
    one_line,
    read_text,
    suggestion,
)

Location = tuple[str | int, ...]
M = TypeVar("M", bound=BaseModel)


class Declared(BaseModel):
    """Base of everything that is declared in a file: unknown keys, NaN, infinities and conversions are refused."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class Convertible(Declared):
    """A `Declared` whose values pydantic may convert without loss: a list to a tuple, a numeric text to a number."""

    model_config = ConfigDict(strict=False)


class Extensible(Declared):
    """A `Declared` that accepts and keeps unknown keys, for files that later versions of the program may extend."""

    model_config = ConfigDict(extra="allow")


class LocatedError(ValueError):
    """What a validator of a `Declared` raises where a problem has a place of its own below the validated value.

    problems : (location, text), the location relative to the validated value, e.g. (("layer", 2, "material"), "...")
    """

    def __init__(self, *problems: tuple[Location, str]) -> None:
        self.problems = problems
        super().__init__("; ".join(text for _, text in problems))


def read_toml(path: str | os.PathLike[str], model: type[M]) -> M:
    """Read a TOML file into a pydantic model.

    raises : InputError with one line a problem: file, table, key, value, rule, nearest known name
    """
    return check(read_toml_dict(path), model, display_path(path))


def read_toml_dict(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a TOML file as plain dictionaries; InputError with the line where it is not TOML."""
    text, name = read_text(path), display_path(path)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(_toml_syntax(name, text, str(error))) from None
    except RecursionError:
        raise InputError(f"{name}: tables or lists are nested too deeply") from None
    except ValueError as error:
        raise InputError(f"{name}: is not TOML ({error})") from None


def _toml_syntax(name: str, text: str, message: str) -> str:
    place = re.search(r"\s*\(at line (\d+), column (\d+)\)$", message)
    if place is None:
        what = message.removesuffix(" (at end of document)")
        return f"{name}, line {len(text.splitlines())}: {what} at the end of the file; it may have been cut off"
    return f"{name}, line {place[1]}: {message[: place.start()]} (column {place[2]}); this is not TOML"


def check(data: Any, model: type[M], where: str) -> M:
    """A pydantic model of plain data, with every problem told as in a file named `where`.

    raises : InputError, all problems at once
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        # An unknown key is often the reason why another is missing, so it is told first. In a file of another format
        # every key is wrong, and that alone is told.
        found = error.errors(include_url=False)
        other_format = [e for e in found if e["loc"] == ("format",) and e["type"] != "missing"]
        errors = other_format or _branches_told_once(sorted(found, key=lambda e: e["type"] != "extra_forbidden"), data)
        problems = [p for e in errors for p in _problems_of(e, data, model, where)]
        raise InputError(*dict.fromkeys(one_line(p) for p in problems)) from None
    except RecursionError:
        raise InputError(f"{where}: tables or lists are nested too deeply") from None


def _branches_told_once(errors: Sequence[Any], data: Any) -> list[Any]:
    """Of a value that is of no branch of a union: what is wrong within the branch that it is meant for, else one error
    that names all the kinds that it may be."""
    places = [_in_data(tuple(e["loc"]), data, keep_last=e["type"] == "missing") for e in errors]
    meant = {place[:k] for place in places for k in range(len(place))}
    meant |= {place for error, place in zip(errors, places, strict=True) if not _of_another_kind(error)}
    kept: list[Any] = []
    kinds: dict[Location, list[str]] = {}
    for error, place in zip(errors, places, strict=True):
        if not _of_another_kind(error):
            kept.append(error)
        elif place not in meant:
            if place not in kinds:
                kept.append(error | {"kinds": kinds.setdefault(place, [])})
            kinds[place].append(_EXPECTED.get(error["type"], "one of its words"))
    return kept


def _of_another_kind(error: Any) -> bool:
    """Whether a value is no text, number, table or whatever else it should be."""
    if error["type"] == "literal_error":
        return isinstance(error["input"], (dict, list))
    return error["type"] in _EXPECTED and error["type"] != "finite_number"


def _problems_of(error: Any, data: Any, model: type[BaseModel], where: str) -> list[str]:
    """The lines for one pydantic error; a LocatedError from a validator may hold several."""
    located = error.get("ctx", {}).get("error")
    if isinstance(located, LocatedError):
        places = [(tuple(error["loc"]) + loc, text) for loc, text in located.problems]
        return [_line(_in_data(loc, data), data, where, text) for loc, text in places]
    loc = _in_data(tuple(error["loc"]), data, keep_last=error["type"] == "missing")
    return [_line(loc, data, where, _rule(error, loc, model), named=error["type"] in ("missing", "extra_forbidden"))]


def _in_data(loc: Location, data: Any, keep_last: bool = False) -> Location:
    """A pydantic location without the tags that it adds for the branches of a union."""
    kept: list[str | int] = []
    for i, part in enumerate(loc):
        is_last = keep_last and i == len(loc) - 1
        if isinstance(data, dict) and (part in data or is_last):
            kept.append(part)
            data = data.get(part)
        elif isinstance(data, (list, tuple)) and isinstance(part, int) and part < len(data):
            kept.append(part)
            data = data[part]
    return tuple(kept)


def _line(loc: Location, data: Any, where: str, rule: str, named: bool = False) -> str:
    """`file, [table] 2, row 3: rule`; `named` where the rule itself names the last key."""
    table, key, rows = _place(loc, data)
    if named:
        return f"{_join(where, table)}: {rule}"
    if key is None:
        return f"{_join(where, table)}{rows}: {rule}"
    return f"{_join(where, table)}: `{key}`{rows}: {rule}"


def _join(where: str, table: str) -> str:
    return f"{where}, {table}" if table else where


def _place(loc: Location, data: Any) -> tuple[str, str | None, str]:
    """Split a location into table `[a.b] 2`, key, and `, row i, item j` inside the key's value."""
    table: list[str] = []
    count, node = "", data
    for i, part in enumerate(loc):
        value = _child(node, part)
        if isinstance(part, int):
            count = f" {part + 1}"
        elif _leads_to_table(value, loc[i + 1 :]):
            table.append(part)
        else:
            return _bracketed(table, count), part, _rows(loc[i + 1 :])
        node = value
    return _bracketed(table, count), None, ""


def _bracketed(table: list[str], count: str) -> str:
    return f"[{'.'.join(table)}]{count}" if table else ""


def _leads_to_table(value: Any, rest: Location) -> bool:
    """Whether a value is a table, or a list whose item named next is one."""
    if isinstance(value, list) and rest:
        value = _child(value, rest[0])
    return isinstance(value, dict)


def _child(node: Any, part: str | int) -> Any:
    if isinstance(node, dict):
        return node.get(part)
    return node[part] if isinstance(node, (list, tuple)) and isinstance(part, int) and part < len(node) else None


def _rows(parts: Sequence[str | int]) -> str:
    words = ("row", "item", "part")
    return "".join(f", {word} {int(p) + 1}" for word, p in zip(words, parts, strict=False) if isinstance(p, int))


_EXPECTED = {
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "a text in quotes",
    "bool_type": "true or false",
    "list_type": "a list [...]",
    "tuple_type": "a list [...]",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
}

_COMPARED = {
    "greater_than": ("gt", "must be above"),
    "greater_than_equal": ("ge", "must not be below"),
    "less_than": ("lt", "must be below"),
    "less_than_equal": ("le", "must not be above"),
}


def _rule(error: Any, loc: Location, model: type[BaseModel]) -> str:
    """What is wrong with a value and what to do, from pydantic's error type."""
    kind, value, ctx = error["type"], error["input"], error.get("ctx", {})
    key = str(loc[-1]) if loc else ""
    if kind == "extra_forbidden":
        return f"unknown key `{key}`{suggestion(key, known_keys(model, loc[:-1]))}"
    told = _description(model, loc)
    if kind == "missing":
        return f"key `{key}` is missing{_told(told)}"
    if "kinds" in error or kind in _EXPECTED:
        *others, last = dict.fromkeys(error.get("kinds") or [_EXPECTED[kind]])
        return f"{abbreviated(value)} is not {', '.join(others) + ' or ' if others else ''}{last}{_told(told)}"
    if kind in _COMPARED:
        name, words = _COMPARED[kind]
        return f"{abbreviated(value)} {words} {ctx[name]:g}{_told(told)}"
    if kind in ("union_tag_invalid", "union_tag_not_found") and "discriminator" in ctx:
        return _tag_rule(ctx, value)
    if kind == "string_pattern_mismatch":
        return f"{abbreviated(value)} is not {told or ctx['pattern']}"
    if kind == "literal_error":
        return _choice_rule(value, re.findall(r"'([^']*)'", ctx["expected"]))
    if kind in ("too_short", "too_long"):
        limit = ctx.get("min_length", ctx.get("max_length"))
        words = "at least" if kind == "too_short" else "at most"
        return f"has {ctx['actual_length']} values, takes {words} {limit}{_told(told)}"
    text = str(ctx["error"]) if "error" in ctx else error["msg"]
    return f"{text}{_told(told)}" if kind != "value_error" else text


def _tag_rule(ctx: Any, table: Any) -> str:
    """What is wrong with the key that says which of several tables one is."""
    key = ctx["discriminator"].strip("'")
    if "tag" not in ctx:
        return f"key `{key}` is missing"
    choices = re.findall(r"'([^']*)'", ctx["expected_tags"])
    return f"`{key}`: {_choice_rule(table[key], choices)}"


def _choice_rule(value: Any, choices: Sequence[str]) -> str:
    return f"{abbreviated(value)} is not one of {', '.join(choices)}{suggestion(str(value), choices, otherwise='')}"


def _told(description: str) -> str:
    return f" ({description})" if description else ""


def known_keys(model: type[BaseModel], loc: Location) -> list[str]:
    """The keys of the table at a location of a model; of the model itself where the location leads nowhere."""
    found = _models_at(model, loc)
    return list(dict.fromkeys(name for m in found for name in m.model_fields))


def _description(model: type[BaseModel], loc: Location) -> str:
    """The description of the field that a location lies in."""
    keys = [i for i, part in enumerate(loc) if isinstance(part, str)]
    for i in reversed(keys):
        for owner in _models_at(model, loc[:i]):
            info = owner.model_fields.get(str(loc[i]))
            if info is not None:
                return info.description or ""
    return ""


def _models_at(model: type[BaseModel], loc: Location) -> list[type[BaseModel]]:
    """The pydantic models that a location may hold (several for a union)."""
    annotations: list[Any] = [model]
    for part in loc:
        annotations = [new for a in annotations for new in _step(a, part)]
    return [a for a in annotations if isinstance(a, type) and issubclass(a, BaseModel)]


def _step(annotation: Any, part: str | int) -> list[Any]:
    """The annotations one key or index below an annotation, unions opened."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        info = annotation.model_fields.get(str(part))
        return _open(info.annotation) if info else []
    origin, args = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in (dict, Mapping) and isinstance(part, str):
        return _open(args[1])
    if origin in (list, tuple, Sequence) and isinstance(part, int):
        return _open(args[0])
    return []


def _open(annotation: Any) -> list[Any]:
    """The branches of a union, Annotated stripped."""
    origin, args = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return _open(args[0])
    if origin in (typing.Union, types.UnionType):
        return [b for a in args for b in _open(a)]
    return [annotation]


def toml_text(data: Mapping[str, Any], comment: str = "") -> str:
    """Plain data as TOML; None is left out; numbers are written so that they read back equal.

    raises : RunError where a number is not finite or a value has no TOML form
    """
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    return head + "".join(_toml_table(data, ())).lstrip("\n")


def _toml_table(data: Mapping[str, Any], path: tuple[str, ...]) -> Iterator[str]:
    """Lines of one table: plain keys first, then sub-tables and arrays of tables."""
    held = {k: v for k, v in data.items() if v is not None}
    for key, value in held.items():
        if not _is_table(value) and not _is_table_list(value):
            yield f"{_toml_key(key)} = {_toml_value(value, (*path, key))}\n"
    for key, value in held.items():
        name = ".".join(_toml_key(p) for p in (*path, key))
        if _is_table(value):
            yield f"\n[{name}]\n"
            yield from _toml_table(value, (*path, key))
        elif _is_table_list(value):
            for item in value:
                yield f"\n[[{name}]]\n"
                yield from _toml_table(item, (*path, key))


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping)


def _is_table_list(value: Any) -> bool:
    return isinstance(value, (list, tuple)) and len(value) > 0 and all(isinstance(v, Mapping) for v in value)


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _toml_string(key)


def _toml_string(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _toml_value(value: Any, path: tuple[str, ...]) -> str:
    value = as_builtin(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _toml_string(value)
    if isinstance(value, float) and not math.isfinite(value):
        raise RunError(f"`{'.'.join(path)}` is {value}, which no file of ours holds; nothing was written")
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_toml_value(v, path) for v in value) + "]"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_toml_key(k)} = {_toml_value(v, path)}" for k, v in value.items()) + " }"
    raise RunError(f"`{'.'.join(path)}`: {type(value).__name__} has no form in TOML")
