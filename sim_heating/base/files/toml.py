"""TOML files read into pydantic models, with every problem located by file, table, key and value; and TOML output.

Three bases of models share these messages: `Declared` refuses conversions and unknown keys, `Convertible` allows
conversions without loss, `Extensible` keeps unknown keys.
"""

from __future__ import annotations

import math
import os
import re
import tomllib
import types
import typing
from collections.abc import Callable, Container, Mapping, Sequence
from functools import partial, reduce
from itertools import chain
from typing import Any, ClassVar, Self, TypeVar

import tomlkit
from pydantic import BaseModel, ConfigDict, ValidationError, ValidationInfo, model_validator

from sim_heating.base.errors import InputError, RunError, tell
from sim_heating.base.files.schema import documented
from sim_heating.base.files.text import abbreviated, as_builtin, display_path, read_text, suggestion
from sim_heating.base.limits import Quantity, numbers_in, quantity, usual_remark

Location = tuple[str | int, ...]
_FROM_FILE = object()
"""Context in which a model is made of what a person has typed."""
M = TypeVar("M", bound=BaseModel)


class Declared(BaseModel):
    """Base of everything that is declared in a file.

    Unknown keys, NaN, infinities and conversions are refused; in what is read from a file also numbers outside the
    range of their quantity: that of the field's name (`limits.quantity`), or the one that `quantities` names. A model
    that is made in Python, for a limiting case, has the limits of its fields alone.

    quantities : field -> name of its quantity; a name for each column where the value is a list of rows; None where the
                 range is checked elsewhere. The name of another field with a text stands for that text: in a schedule
                 `alpha_deg` over what `alpha_against` names, ("alpha_against", "alpha_deg").
    """

    # built when first used: a command reads a few of all formats
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False, defer_build=True)

    quantities: ClassVar[Mapping[str, str | tuple[str | None, ...] | None]] = {}

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: Any, handler: Any) -> dict[str, Any]:
        return documented(handler.resolve_ref_schema(handler(core_schema)), cls, cls.quantities)

    @model_validator(mode="after")
    def _check_plausible(self, info: ValidationInfo) -> Self:
        problems = self.implausible() if info.context is _FROM_FILE else []
        raise_located(problems)
        return self

    def implausible(self) -> list[tuple[Location, str]]:
        """Location and text of each number that is beyond its range, or does not fit the others."""
        return [
            ((name, *below), text)
            for name in type(self).model_fields
            for below, text in _quantity_problems(self, name, getattr(self, name))
        ]

    def unusual(self) -> list[tuple[Location, str]]:
        """Location and text of each number of the file that is possible and outside what is usual; one a field."""
        remarks: list[tuple[Location, str]] = []
        for name in (n for n in type(self).model_fields if n in self.model_fields_set):
            judged = _judged_numbers(self, name, getattr(self, name), _unusual_numbers)
            remarks += [((name, *below), text) for below, text in judged[:1]]
        return remarks


class Convertible(Declared):
    """A `Declared` whose values pydantic may convert without loss, such as a list to a tuple; a text is no number."""

    model_config = ConfigDict(strict=False)

    @model_validator(mode="before")
    @classmethod
    def _refuse_other_types(cls, data: Any) -> Any:
        # Pydantic would take "12", "1_2", digits of other scripts, and true for a 1.
        problems: list[tuple[Location, str]] = [
            ((name, *below), f"{abbreviated(wrong)} is not a number; write a number without quotes")
            for name, value in (data.items() if isinstance(data, dict) else ())
            if name in cls.model_fields
            for below, wrong in _not_numbers(value, _leaves(cls.model_fields[name].annotation))
        ]
        raise_located(problems)
        return data


class Extensible(Declared):
    """A `Declared` that accepts and keeps unknown keys, for files that later versions of the program may extend."""

    model_config = ConfigDict(extra="allow")


class LocatedError(ValueError):
    """Raised by a validator of a `Declared` where a problem has a location below the validated value.

    problems : (location, text), the location relative to the validated value, e.g. (("layer", 2, "material"), "...")
    """

    def __init__(self, *problems: tuple[Location, str]) -> None:
        self.problems = problems
        super().__init__("; ".join(text for _, text in problems))


def raise_located(problems: Sequence[tuple[Location, str]]) -> None:
    """Raise all problems below a validated value at once, if there are any."""
    if problems:
        raise LocatedError(*problems)


def _quantity_problems(model: Declared, name: str, value: Any) -> list[tuple[Location, str]]:
    """Problems of the numbers of one field: the place below the field, and the rule of the quantity."""
    declared = _declared_quantity(model, name, value)
    if declared is None:
        return []
    problems = _judged_numbers(model, name, value, lambda key, v: _range_problems(quantity(key), v))
    if problems or not isinstance(declared, tuple) or not isinstance(value, (list, tuple)) or declared[0] is None:
        return problems
    return _axis_problems(quantity(_meant(model, declared[0])), value)


def _judged_numbers(
    model: Declared, name: str, value: Any, judge: Callable[[str, Any], list[tuple[Location, str]]]
) -> list[tuple[Location, str]]:
    """Lines about the numbers of one field, each with its place below the field.

    judge : lines about numbers of a quantity, by its name
    """
    if value is None or isinstance(value, (str, bool)):
        return []
    declared = _declared_quantity(model, name, value)
    if isinstance(value, Mapping):
        return [((key, *below), text) for key, v in value.items() for below, text in judge(key, v)]
    if declared is None:
        return []
    if isinstance(declared, str):
        return judge(_meant(model, declared), value)
    return _judged_rows(value, [None if c is None else partial(judge, _meant(model, c)) for c in declared])


def _judged_rows(
    rows: Any, judges: Sequence[Callable[[Any], list[tuple[Location, str]]] | None]
) -> list[tuple[Location, str]]:
    """Lines about the numbers of rows, each with its row and column; none of a value that is no list.

    judges : lines about a number of each column; None for one that holds none
    """
    if not isinstance(rows, (list, tuple)):
        return []
    return [
        ((i, j), text)
        for i, row in enumerate(rows)
        for j, (judge, number) in enumerate(zip(judges, row, strict=False))
        if judge is not None
        for _, text in judge(number)
    ]


def _declared_quantity(model: Declared, name: str, value: Any) -> str | tuple[str | None, ...] | None:
    """What `quantities` states of a field: of one number in place of a list of rows, that of their last column."""
    declared = model.quantities.get(name, name)
    return declared[-1] if isinstance(declared, tuple) and isinstance(value, (int, float)) else declared


def _unusual_numbers(name: str, value: Any) -> list[tuple[Location, str]]:
    return [
        (location, text) for location, number in numbers_in(value) if (text := usual_remark(name, number)) is not None
    ]


def remarks_of(
    model: Declared, data: Any, where: str, *, below: bool = True, told: Container[Location] = ()
) -> list[str]:
    """One line for each number of a model, and of the models below it, that is possible and unusual.

    data  : what the model was made of, in which the lines name tables and keys
    where : name of the file
    below : false: of this model alone
    told  : locations of numbers that another file holds, and that have been told of
    """
    first: dict[Location, str] = {}
    for location, text in _unusual_below(model, ()) if below else model.unusual():
        first.setdefault(location, text)
    return [
        _problem_line(_data_location(location, data), data, where, text)
        for location, text in first.items()
        if location not in told
    ]


def _unusual_below(value: Any, location: Location) -> list[tuple[Location, str]]:
    if isinstance(value, BaseModel):
        remarks = [((*location, *loc), text) for loc, text in value.unusual()] if isinstance(value, Declared) else []
        items: Any = [(name, getattr(value, name)) for name in type(value).model_fields]
    elif isinstance(value, Mapping):
        remarks, items = [], value.items()
    elif isinstance(value, (list, tuple)) and value and isinstance(value[0], BaseModel):
        remarks, items = [], enumerate(value)
    else:
        return []
    for key, item in items:
        remarks += _unusual_below(item, (*location, key))
    return remarks


def _meant(model: Declared, name: str) -> str:
    """The name of a quantity, or the text of the field that has this name."""
    text = getattr(model, name, None) if name in type(model).model_fields else None
    return text if isinstance(text, str) else name


def _range_problems(measured: Quantity | None, value: Any) -> list[tuple[Location, str]]:
    if measured is None:
        return []
    if type(value) is float:  # most are, and there are thousands
        text = measured.problem(value)
        return [] if text is None else [((), text)]
    return [
        (location, text) for location, number in numbers_in(value) if (text := measured.problem(number)) is not None
    ]


def _axis_problems(measured: Quantity | None, rows: Any) -> list[tuple[Location, str]]:
    """A problem where the x of several rows are so low, or so close together, that they are in another unit."""
    if measured is None or not isinstance(rows, (list, tuple)) or len(rows) < 2:
        return []
    if not all(rows):  # an empty pair, which the model refuses
        return []
    order = sorted(range(len(rows)), key=lambda i: float(rows[i][0]))
    last = order[-1]
    text = measured.axis_problem(rows[order[0]][0], rows[last][0])
    return [] if text is None else [((last, 0), text)]


def _leaves(annotation: Any) -> set[Any]:
    """The types that an annotation consists of: those of a union, of the items of lists, and of literal values."""
    if typing.get_origin(annotation) is typing.Literal:
        return {type(value) for value in typing.get_args(annotation)}
    parts = typing.get_args(annotation)
    return set().union(*(_leaves(argument) for argument in parts)) if parts else {annotation}


def _not_numbers(value: Any, allowed: set[Any]) -> list[tuple[Location, Any]]:
    """Place and value of each number in quotes, and each true or false, in nested lists of numbers alone."""
    if not allowed & {int, float} or str in allowed:
        return []
    if isinstance(value, (list, tuple)):
        return [((i, *below), wrong) for i, item in enumerate(value) for below, wrong in _not_numbers(item, allowed)]
    if isinstance(value, bool):
        return [] if bool in allowed else [((), value)]
    return [((), value)] if isinstance(value, str) and _is_finite_number(value) else []


def _is_finite_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


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
    position = re.search(r"\s*\(at line (\d+), column (\d+)\)$", message)
    if position is None:
        problem = message.removesuffix(" (at end of document)")
        return f"{name}, line {len(text.splitlines())}: {problem} at the end of the file; it may have been cut off"
    return f"{name}, line {position[1]}: {message[: position.start()]} (column {position[2]}); this is not TOML"


def check(data: Any, model: type[M], where: str, *, tells: bool = True) -> M:
    """A pydantic model of plain data, with problems reported as in a file named `where`; what is unusual is reported.

    tells  : false where the data come from files that have been told of already
    raises : InputError, all problems at once
    """
    try:
        checked = model.model_validate(data, context=_FROM_FILE)
    except ValidationError as error:
        problems = [p for e in _errors_to_report(error, data) for p in _error_lines(e, data, model, where)]
        raise InputError(*problems) from None
    except RecursionError:
        raise InputError(f"{where}: tables or lists are nested too deeply") from None
    if tells and isinstance(checked, Declared):
        tell(remarks_of(checked, data, where))
    return checked


def _errors_to_report(error: ValidationError, data: Any) -> Sequence[Any]:
    """Errors of pydantic in the order of a report.

    An unknown key is often the reason why another is missing, so it comes first. In a file of another format every key
    is wrong, so the format alone is reported.
    """
    raised = error.errors(include_url=False)
    other_format = [e for e in raised if e["loc"] == ("format",) and e["type"] != "missing"]
    return other_format or _one_error_per_union(sorted(raised, key=lambda e: e["type"] != "extra_forbidden"), data)


def _one_error_per_union(errors: Sequence[Any], data: Any) -> list[Any]:
    """Errors with those of a union reduced to one value: the errors within the intended branch, else a single error
    that lists all types that the union accepts."""
    locations = [_data_location(tuple(e["loc"]), data, keep_last=e["type"] == "missing") for e in errors]
    intended = {location[:k] for location in locations for k in range(len(location))}
    intended |= {location for error, location in zip(errors, locations, strict=True) if not _is_type_error(error)}
    kept: list[Any] = []
    kinds: dict[Location, list[str]] = {}
    for error, location in zip(errors, locations, strict=True):
        if not _is_type_error(error):
            kept.append(error)
        elif location not in intended:
            if location not in kinds:
                kept.append(error | {"kinds": kinds.setdefault(location, [])})
            kinds[location].append(_TYPE_NAMES.get(error["type"], "one of the allowed texts"))
    return kept


def _is_type_error(error: Any) -> bool:
    """Whether a value has the wrong type: not a text, number or table where one is required."""
    if error["type"] == "literal_error":
        return isinstance(error["input"], (dict, list))
    return error["type"] in _TYPE_NAMES and error["type"] != "finite_number"


def _error_lines(error: Any, data: Any, model: type[BaseModel], where: str) -> list[str]:
    """The lines for one pydantic error; a LocatedError from a validator may hold several."""
    located = error.get("ctx", {}).get("error")
    if isinstance(located, LocatedError):
        located_texts = [(tuple(error["loc"]) + loc, text) for loc, text in located.problems]
        return [_problem_line(_data_location(loc, data), data, where, text) for loc, text in located_texts]
    loc = _data_location(tuple(error["loc"]), data, keep_last=error["type"] == "missing")
    return [
        _problem_line(
            loc, data, where, _error_rule(error, loc, model), named=error["type"] in ("missing", "extra_forbidden")
        )
    ]


def _data_location(loc: Location, data: Any, keep_last: bool = False) -> Location:
    """A pydantic location without the tags that pydantic adds for the branches of a union."""
    kept: list[str | int] = []
    for i, key in enumerate(loc):
        is_last = keep_last and i == len(loc) - 1
        if _has_child(data, key) or (is_last and isinstance(data, dict)):
            kept.append(key)
            data = _child(data, key)
        elif isinstance(data, dict) and isinstance(key, str) and "." in key:  # TOML makes tables in tables of it
            below = _data_location(tuple(key.split(".")), data)
            kept += below
            data = reduce(_child, below, data)
    return tuple(kept)


def _problem_line(loc: Location, data: Any, where: str, rule: str, named: bool = False) -> str:
    """`file, [table] 2, row 3: rule`; `named` where the rule itself names the last key."""
    table, key, rows = _split_location(loc, data)
    if named:
        return f"{_join_place(where, table)}: {rule}"
    if key is None:
        return f"{_join_place(where, table)}{rows}: {rule}"
    return f"{_join_place(where, table)}: `{key}`{rows}: {rule}"


def _join_place(where: str, table: str) -> str:
    return f"{where}, {table}" if table else where


def _split_location(loc: Location, data: Any) -> tuple[str, str | None, str]:
    """Split a location into table `[a.b] 2`, key, and `, row i, item j` inside the key's value."""
    table: list[str] = []
    count, node = "", data
    for i, key in enumerate(loc):
        value = _child(node, key)
        if isinstance(key, int):
            count = f" {key + 1}"
        elif _leads_to_table(value, loc[i + 1 :]):
            table.append(key)
        else:
            return _table_header(table, count), key, _row_text(loc[i + 1 :])
        node = value
    return _table_header(table, count), None, ""


def _table_header(table: list[str], count: str) -> str:
    return f"[{'.'.join(table)}]{count}" if table else ""


def _leads_to_table(value: Any, rest: Location) -> bool:
    """Whether a value is a table, or a list whose item named next is one."""
    if isinstance(value, list) and rest:
        value = _child(value, rest[0])
    return isinstance(value, dict)


def _child(node: Any, key: str | int) -> Any:
    if isinstance(node, dict):
        return node.get(key)
    return node[key] if _has_child(node, key) else None


def _has_child(node: Any, key: str | int) -> bool:
    """Whether a table has the key, or a list the index."""
    if isinstance(node, dict):
        return key in node
    return isinstance(node, (list, tuple)) and isinstance(key, int) and key < len(node)


def _row_text(parts: Sequence[str | int]) -> str:
    levels = ("row", "item", "part")
    return "".join(f", {word} {int(p) + 1}" for word, p in zip(levels, parts, strict=False) if isinstance(p, int))


_TYPE_NAMES = {
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

_BOUNDS = {
    "greater_than": ("gt", "must be above"),
    "greater_than_equal": ("ge", "must not be below"),
    "less_than": ("lt", "must be below"),
    "less_than_equal": ("le", "must not be above"),
}


FILES_OF: Mapping[str, str] = {
    "scenario/1": "the file is a scenario, for `sim-heating run`",
    "study/1": "the file is a study, for `sim-heating plan`",
    "optimal-entry/1": "the file is an optimal entry by itself: for `sim-heating plan`, write a study with format = "
    '"study/1", title, vehicle and scenario, and the other keys of this file below [optimal], its tables as '
    "[optimal.initial] (`sim-heating new study optimal` writes one)",
    "campaign/1": "the file is a campaign, for `sim-heating campaign`",
    "link/1": "the file is a link, for `sim-heating live`",
    "vehicle/1": "the file is a vehicle's; name its folder as `vehicle`",
    "flight-record/1": "the file is a record's; `sim-heating estimate` and others take its folder",
}
"""What a file of each format is and where it goes, for one that is given in place of another."""


def _error_rule(error: Any, loc: Location, model: type[BaseModel]) -> str:
    """The rule that a value violates, from pydantic's error type."""
    kind, value, ctx = error["type"], error["input"], error.get("ctx", {})
    key = str(loc[-1]) if loc else ""
    if kind == "extra_forbidden":
        return _unknown_key_rule(key, model, loc[:-1], error["loc"])
    description = _description(model, loc)
    if kind == "missing":
        return f"key `{key}` is missing{_in_parentheses(description)}"
    if kind in ("union_tag_invalid", "union_tag_not_found") and "discriminator" in ctx:
        return _tag_rule(ctx, value)
    if kind == "string_pattern_mismatch":
        return f"{abbreviated(value)} is not {description or ctx['pattern']}{_file_of(key, value)}"
    if kind == "literal_error":
        return _choice_rule(value, re.findall(r"'([^']*)'", ctx["expected"]))
    if kind == "value_error":
        return str(ctx["error"])
    return f"{_value_rule(error)}{_in_parentheses(description)}"


def _file_of(key: str, value: str) -> str:
    """What a file of another format is and where it goes, for the end of a message; empty where that is not known."""
    return f"; {FILES_OF[value]}" if key == "format" and value in FILES_OF else ""


def _value_rule(error: Any) -> str:
    """The rule of a value of another type, beyond a bound, or of another length."""
    kind, value, ctx = error["type"], error["input"], error.get("ctx", {})
    if "kinds" in error or kind in _TYPE_NAMES:
        *others, last = dict.fromkeys(error.get("kinds") or [_TYPE_NAMES[kind]])
        return f"{abbreviated(value)} is not {', '.join(others)}{' or ' if others else ''}{last}"
    if kind in _BOUNDS:
        name, comparison = _BOUNDS[kind]
        return f"{abbreviated(value)} {comparison} {ctx[name]:g}"
    if kind in ("too_short", "too_long"):
        limit = ctx.get("min_length", ctx.get("max_length"))
        return f"has {ctx['actual_length']} values, takes {'at least' if kind == 'too_short' else 'at most'} {limit}"
    return str(ctx.get("error", error["msg"]))


def _unknown_key_rule(key: str, model: type[BaseModel], table: Location, tagged: Location) -> str:
    """The rule for an unknown key; where its table is one of several kinds, for the kind that it states.

    tagged : pydantic's location, which holds the kind before the key
    """
    kinds = {m: kind for m in _models_at(model, table) if (kind := _kind(m)) is not None}
    tag = tagged[-2] if len(tagged) > 1 else None
    stated = next((m for m, (_, names) in kinds.items() if tag in names), None)
    if stated is None:
        return f"unknown key `{key}`{suggestion(key, known_keys(model, table))}"
    field, keys_of_kind = kinds[stated][0], list(stated.model_fields)
    of_key = chain.from_iterable(names for m, (_, names) in kinds.items() if key in m.model_fields)
    owners = ", ".join(map('"{}"'.format, of_key))
    if not owners:
        return f"unknown key `{key}`{suggestion(key, keys_of_kind)}"
    keys_of_kind.remove(field)
    keys = ", ".join(map("`{}`".format, keys_of_kind))
    return f'`{key}` belongs to {field} = {owners}, not to {field} = "{tag}", which takes {keys}'


def _kind(model: type[BaseModel]) -> tuple[str, tuple[Any, ...]] | None:
    """The key that states the kind of a table, and its values, for one of several kinds; else None."""
    for name, info in model.model_fields.items():
        if typing.get_origin(info.annotation) is typing.Literal and info.is_required():
            return name, typing.get_args(info.annotation)
    return None


def _tag_rule(ctx: Any, table: Any) -> str:
    """The rule for the key that selects one of several kinds of table."""
    key = ctx["discriminator"].strip("'")
    if "tag" not in ctx:
        return f"key `{key}` is missing"
    choices = re.findall(r"'([^']*)'", ctx["expected_tags"])
    return f"`{key}`: {_choice_rule(table[key], choices)}"


def _choice_rule(value: Any, choices: Sequence[str]) -> str:
    return f"{abbreviated(value)} is not one of {', '.join(choices)}{suggestion(str(value), choices, otherwise='')}"


def _in_parentheses(description: str) -> str:
    return f" ({description})" if description else ""


def known_keys(model: type[BaseModel], loc: Location) -> list[str]:
    """The keys of the table at a location of a model; none where the location does not exist."""
    models = _models_at(model, loc)
    return list(dict.fromkeys(name for m in models for name in m.model_fields))


def _description(model: type[BaseModel], loc: Location) -> str:
    """The description of the field that a location lies in."""
    keys = [i for i, key in enumerate(loc) if isinstance(key, str)]
    for i in reversed(keys):
        for owner in _models_at(model, loc[:i]):
            info = owner.model_fields.get(str(loc[i]))
            if info is not None:
                return info.description or ""
    return ""


def _models_at(model: type[BaseModel], loc: Location) -> list[type[BaseModel]]:
    """The pydantic models that a location may hold (several for a union)."""
    annotations: list[Any] = [model]
    for key in loc:
        annotations = [new for a in annotations for new in _annotations_below(a, key)]
    return [a for a in annotations if isinstance(a, type) and issubclass(a, BaseModel)]


def _annotations_below(annotation: Any, key: str | int) -> list[Any]:
    """The annotations one key or index below an annotation, unions opened."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        info = annotation.model_fields.get(str(key))
        return _union_branches(info.annotation) if info else []
    origin, args = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in (dict, Mapping) and isinstance(key, str):
        return _union_branches(args[1])
    if origin in (list, tuple, Sequence) and isinstance(key, int):
        return _union_branches(args[0])
    return []


def _union_branches(annotation: Any) -> list[Any]:
    """The branches of a union, Annotated stripped."""
    origin, args = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return _union_branches(args[0])
    if origin in (typing.Union, types.UnionType):
        return [b for a in args for b in _union_branches(a)]
    return [annotation]


def toml_text(data: Mapping[str, Any], comment: str = "") -> str:
    """Plain data as TOML; None is omitted; numbers read back equal.

    comment : lines put before the data, each after `# `
    raises  : RunError where a number is not finite or a value has no TOML form
    """
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    return head + tomlkit.dumps(_toml_data(data, "")).lstrip("\n")


def _toml_data(value: Any, location: str) -> Any:
    """A value as tomlkit writes it: Python numbers, texts, lists and dictionaries without None."""
    value = as_builtin(value)
    if isinstance(value, Mapping):
        return {k: _toml_data(v, f"{location}.{k}".lstrip(".")) for k, v in value.items() if v is not None}
    if isinstance(value, (list, tuple)):
        return [_toml_data(v, location) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        raise RunError(f"`{location}` is {value}, which is not written to TOML files; nothing was written")
    if not isinstance(value, (bool, str, int, float)):
        raise RunError(f"`{location}`: {type(value).__name__} cannot be represented in TOML")
    return value
