"""A walk over all keys of documents: which model a key is of, another value for it, and whether anything comes of it.

A key is named after the model that declares it, `Stack.initial_K`, wherever in a format the model occurs.
"""

from __future__ import annotations

import copy
import inspect
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
from pydantic import BaseModel

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files import toml_text

Place = tuple[str | int, ...]
Outcome = dict[str, Any]


@dataclass(frozen=True)
class Deed:
    """What a user does with files: writes them, and has something computed from them.

    write   : writes the files into an empty folder
    file    : the file whose keys are walked, below the folder
    model   : the model that reads it
    do      : what comes out of the files in a folder, by name
    """

    name: str
    write: Callable[[Path], None]
    file: str
    model: type[BaseModel]
    do: Callable[[Path], Outcome]

    def document(self, folder: Path) -> dict[str, Any]:
        """The contents of its file, written into a folder."""
        self.write(folder)
        return tomllib.loads((folder / self.file).read_text())


def models_of(kind: Any, known: list[type[BaseModel]] | None = None) -> list[type[BaseModel]]:
    """All models that a type holds, itself first."""
    known = [] if known is None else known
    if isinstance(kind, type) and issubclass(kind, BaseModel) and kind not in known:
        known.append(kind)
        kind.model_rebuild()
        for field in kind.model_fields.values():
            models_of(field.annotation, known)
    for inner in get_args(kind):
        models_of(inner, known)
    return known


def keys_of(model: type[BaseModel]) -> list[str]:
    """All keys of a format, each after its model."""
    return [f"{owner(m, name)}.{name}" for m in models_of(model) for name in m.model_fields]


def owner(model: type[BaseModel], key: str) -> str:
    """Name of the model that declares a key, that of the base where one model extends another."""
    declaring = [m for m in model.__mro__ if key in inspect.get_annotations(m)]
    return declaring[-1].__name__.removeprefix("Optional") if declaring else model.__name__


def present(value: Any, place: Place = ()) -> Iterator[tuple[str, Place]]:
    """(key, place in the document) of all keys that a document states, from its model."""
    if isinstance(value, BaseModel):
        for name in value.model_fields_set:
            yield f"{owner(type(value), name)}.{name}", (*place, name)
            yield from present(getattr(value, name), (*place, name))
    elif isinstance(value, Mapping):
        for name, inner in value.items():
            yield from present(inner, (*place, name))
    elif isinstance(value, (list, tuple)):
        for i, inner in enumerate(value):
            yield from present(inner, (*place, i))


def at(document: Any, place: Place) -> Any:
    """The value at a place."""
    for step in place:
        document = document[step]
    return document


def changed(document: Mapping[str, Any], place: Place, value: Any) -> dict[str, Any]:
    """The document with another value at a place; without the key where that is None."""
    other = copy.deepcopy(dict(document))
    table = at(other, place[:-1])
    if value is None:
        del table[place[-1]]
    else:
        table[place[-1]] = value
    return other


def others(value: Any, choices: Sequence[str] = ()) -> Iterator[Any]:
    """Other values of the same kind: numbers a little above and below, texts among the choices, no value."""
    if isinstance(value, bool):
        yield not value
    elif isinstance(value, int):
        yield from (value + 1, value - 1, 2 * value, value + 4)
    elif isinstance(value, float):
        yield from (1.1 * value, 0.9 * value, value + 0.01, value + 1.0, value - 1.0)
    elif isinstance(value, str):
        yield from (c for c in choices if c != value)
        yield value.replace("_K", "_2_K") if value.endswith("_K") else f"{value}2"
    elif isinstance(value, list) and value and all(isinstance(v, (int, float)) for v in value):
        yield [v + 0.05 * max(abs(v), 0.02) if i else v for i, v in enumerate(value)]
        yield [1.05 * v for v in value]
        yield value[:-1]
    elif isinstance(value, list) and value and all(isinstance(v, list) and not isinstance(v[0], str) for v in value):
        yield [[row[0], *(0.93 * v for v in row[1:])] for row in value]
        yield [[0.97 * v for v in row] for row in value]
    elif isinstance(value, (list, tuple)) and len(value) > 1:
        yield value[:-1]
        yield value[1:]
    elif isinstance(value, dict):
        for name, inner in value.items():
            for other in others(inner):
                yield value | {name: other}
    yield None


def choices_of(model: BaseModel, place: Place) -> Sequence[str]:
    """The texts that a key of a document may have."""
    inner: Any = model
    for step in place[:-1]:
        inner = getattr(inner, str(step)) if isinstance(inner, BaseModel) else inner[step]

    def texts(kind: Any) -> Iterator[str]:
        for part in get_args(kind):
            if isinstance(part, str):
                yield part
            else:
                yield from texts(part)

    return list(texts(type(inner).model_fields[str(place[-1])].annotation)) if isinstance(inner, BaseModel) else []


def same(one: Any, other: Any) -> bool:
    """Whether two outcomes are equal, NaN being equal to itself."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(same(one[k], other[k]) for k in one)
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        kind = np.asarray(one).dtype.kind
        return np.shape(one) == np.shape(other) and bool(np.array_equal(one, other, equal_nan=kind in "fc"))
    if isinstance(one, (list, tuple)) and isinstance(other, (list, tuple)):
        return len(one) == len(other) and all(same(a, b) for a, b in zip(one, other, strict=True))
    return bool(one == other) or (one != one and other != other)


_BEFORE: dict[str, Outcome] = {}
"""What comes out of the files of a deed as they are, by its name."""


def acts(deed: Deed, key: str, values: Sequence[Any], folder: Path, refuses: str = "") -> str:
    """Why nothing comes of a key in a deed; empty where something does, or where every other value is refused by name.

    values : other values of the key to try, before those of `others`
    folder : an empty one;  refuses : another key, whose value this one may refuse
    """
    document = deed.document(folder)
    model = deed.model.model_validate(document)
    places = [place for name, place in present(model) if name == key]
    if not places:
        return "not in the document"
    if deed.name not in _BEFORE:
        _BEFORE[deed.name] = deed.do(folder)
    before, idle = _BEFORE[deed.name], False
    refused: list[str] = []
    for place in places:
        for value in [*values, *others(at(document, place), choices_of(model, place))]:
            (folder / deed.file).write_text(toml_text(changed(document, place, value)))
            try:
                if not same(before, deed.do(folder)):
                    return ""
                idle = True
            except RunError as error:
                if key.partition(".")[2] in str(error):  # what could be done before cannot any more
                    return ""
                refused.append(f"{value!r}: {error}")
            except (InputError, ValueError) as error:
                refused.append(f"{value!r}: {str(error).splitlines()[0][:160]}")
    if refuses and any(refuses in text for text in refused):
        return ""
    name = key.partition(".")[2]
    if not idle and any(named in text for text in refused for named in (f"`{name}`", f"[{name}]")):
        return ""
    return f"nothing comes of it; refused: {refused}"
