"""Two folders of results, file by file, array by array, number by number.

Every file is read as leaves, `key -> numbers or text`: a column of a CSV, a variable of a NetCDF, an array of an npz,
a column of a Parquet, a leaf of a JSON or a TOML, an attribute of an XML, the arrays of an FMU's image. Numbers have to
have the same bits; all NaN are the same. Texts that differ are listed and fail nothing, with a note whether the numbers
in them differ as well.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
import tomllib
import zipfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any, TypeVar
from xml.etree import ElementTree

import netCDF4
import numpy as np
import pandas as pd
from numpy.typing import NDArray

RUN = "run.json"
"""About a run, and about a command of it."""
LAST_BITS = 1e-12
"""Relative differences up to here are listed separately."""
IGNORED = {
    r"wall_s": "wall time",
    r"(.*_)?(hash|digest)|revised_inputs": "digest of files that hold paths or versions; their contents are compared",
    r"program|version|generationTool": "version of the program",
    r"generationDateAndTime": "date",
    r"instantiationToken|guid": "digest that identifies an FMU",
}
"""Keys that are left out, as patterns of the last part of a key, with the reason."""
IGNORED_OF_RUNS = {r"arguments\b.*": "how a command is called; some module commands became commands of sim-heating"}
"""Keys of a command's run.json that are left out, as patterns of the whole key, with the reason."""
IGNORED_FILES = {
    r"run\.json": "about the run: commit, libraries, machine",
    r".*\.fmu!binaries/.*": "compiled code holds names of functions; what it computes is compared by the *_frames",
}
"""Files, or parts of an FMU, that are left out, as patterns of the path, with the reason."""
MASKED = {
    r"\{[0-9a-f]{32}\}|\b(?=\d*[a-f])(?=[a-f]*\d)[0-9a-f]{12,64}\b": "<digest>",
    r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?Z?": "<date>",
    r"sim[-_]heating \d+\.\d+\.\d+\S*": "<version>",
}
"""Parts of texts that change from version to version, and what stands for them."""
DIGEST_OF_PATH = re.compile(r"-[0-9a-f]{12}(?=[-./])")
"""Part of a path that is a digest of study or program."""

Numbers = NDArray[np.float64]
Leaves = dict[str, Numbers | str]
T = TypeVar("T")
TEXTS = (".txt", ".html", ".md", ".xml", ".py", "")
PICTURES = (".png", ".svg", ".pdf")


# Files as leaves ---------------------------------------------------------------------------------------------------


def _flat(value: Any, key: str, leaves: Leaves) -> Leaves:
    """Leaves of nested dictionaries and lists; a list of numbers is one array, none is NaN, true is 1."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            _flat(inner, f"{key}.{name}" if key else str(name), leaves)
    elif isinstance(value, list) and (array := _array(value)) is not None:
        leaves[key] = array
    elif isinstance(value, list):
        leaves[f"{key}.length"] = np.array([float(len(value))])
        for i, inner in enumerate(value):
            _flat(inner, f"{key}.{i}", leaves)
    elif (array := _array([value])) is not None:
        leaves[key] = array
    else:
        leaves[key] = str(value)
    return leaves


def _array(values: list[Any]) -> Numbers | None:
    """A list of numbers, however deep, as an array; None where something else is in it, or its shape is ragged."""
    try:
        array = np.array(values)
        if array.dtype.kind == "O":
            array = np.array([np.nan if v is None else v for v in values], dtype=float)
    except (ValueError, TypeError):
        return None
    return array.astype(np.float64) if array.dtype.kind in "fiub" else None


def _csv(data: bytes) -> Leaves:
    """Columns of numbers, cells that are no numbers as text; comments `# key: value` before the heads."""
    lines = data.decode().splitlines()
    comments = [line for line in lines if line.startswith("#")]
    leaves: Leaves = {}
    for i, line in enumerate(comments):
        name, colon, value = line.lstrip("# ").partition(": ")
        number = _number(value)
        leaves[f"#{name}" if colon else f"#{i}"] = np.array([number]) if colon and number is not None else line
    rows = list(csv.reader(line for line in lines if not line.startswith("#")))
    if not rows:
        return leaves
    leaves["rows"] = np.array([float(len(rows) - 1)])
    for name, cells in zip(rows[0], zip_longest(*rows[1:], fillvalue=""), strict=False):
        numbers = [_number(cell) for cell in cells]
        leaves[name] = np.array([np.nan if n is None else n for n in numbers], dtype=np.float64)
        words = [cell for cell, n in zip(cells, numbers, strict=True) if n is None and cell]
        if words:
            leaves[f"{name} (text)"] = "|".join(words)
    return leaves


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


def _netcdf(data: bytes) -> Leaves:
    leaves: Leaves = {}
    with netCDF4.Dataset("in memory", memory=data) as file:
        file.set_auto_maskandscale(False)
        _netcdf_group(file, "", leaves)
    return leaves


def _netcdf_group(group: Any, prefix: str, leaves: Leaves) -> None:
    for name, dimension in group.dimensions.items():
        leaves[f"{prefix}{name}.size"] = np.array([float(len(dimension))])
    for name, variable in group.variables.items():
        values = np.asarray(variable[...])
        leaves[f"{prefix}{name}"] = (
            values.astype(np.float64) if values.dtype.kind in "fiub" else "|".join(map(str, values.ravel()))
        )
        _flat({f"{prefix}{name}@{a}": _plain(variable.getncattr(a)) for a in variable.ncattrs()}, "", leaves)
    _flat({f"{prefix}@{a}": _plain(group.getncattr(a)) for a in group.ncattrs()}, "", leaves)
    for name, inner in group.groups.items():
        _netcdf_group(inner, f"{prefix}{name}/", leaves)


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value


def _npz(data: bytes) -> Leaves:
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        return {name: arrays[name].astype(np.float64) for name in arrays.files}


def _parquet(data: bytes) -> Leaves:
    table = pd.read_parquet(io.BytesIO(data))
    leaves: Leaves = {"rows": np.array([float(len(table))])}
    for name in table.columns:
        array = _array(table[name].tolist())
        leaves[str(name)] = "|".join(map(str, table[name])) if array is None else array
    return leaves


def _xml(data: bytes) -> Leaves:
    """Attributes of every element; elements are known by their names, else by their places among those of their tag."""
    leaves: Leaves = {}

    def walk(element: ElementTree.Element, key: str) -> None:
        for name, value in element.attrib.items():
            numbers = [_number(part) for part in value.split()]
            leaves[f"{key}.{name}"] = np.array(numbers) if numbers and None not in numbers else value
        counts: Counter[str] = Counter()
        for inner in element:
            walk(inner, f"{key}.{inner.tag}:{inner.get('name', counts[inner.tag])}")
            counts[inner.tag] += 1

    walk(ElementTree.fromstring(data), "")
    return leaves


IMAGE = b"sim-heating-fmu3"
"""Beginning of the image of an FMU."""


def _model_bin(data: bytes) -> Leaves:
    """Numbers R, N and T of an FMU's image, with bounds of variables: simulation/fmu_export/parts/image.py."""
    if data[: len(IMAGE)] != IMAGE:
        raise ValueError("model.bin: of another format than this comparison reads")
    header = np.frombuffer(data, np.int64, 10, len(IMAGE))
    n_real, n_whole, n_table, n_variables, n_problems, *n_kept = (int(n) for n in header[:7])
    at = len(IMAGE) + 8 * len(header)
    variables = np.frombuffer(data, np.int64, 7 * n_variables, at).reshape(-1, 7)
    at += 8 * (7 * n_variables + 3 * n_problems + 2 * sum(n_kept))
    return {
        "counts": header[:7].astype(np.float64),
        "lower, upper": variables[:, 5:7].copy().view(np.float64),
        "R": np.frombuffer(data, np.float64, n_real, at).copy(),
        "N": np.frombuffer(data, np.int64, n_whole, at + 8 * n_real).astype(np.float64),
        "T": np.frombuffer(data, np.float64, n_table, at + 8 * (n_real + n_whole)).copy(),
    }


READERS: dict[str, Callable[[bytes], Leaves]] = {
    ".csv": _csv,
    ".json": lambda data: _flat(json.loads(data), "", {}),
    ".toml": lambda data: _flat(tomllib.loads(data.decode()), "", {}),
    ".nc": _netcdf,
    ".npz": _npz,
    ".parquet": _parquet,
    "modelDescription.xml": _xml,
    "model.bin": _model_bin,
}


@dataclass(frozen=True)
class Results:
    """A folder that `same_results run` wrote."""

    folder: Path

    def files(self) -> dict[str, Callable[[], bytes]]:
        """How to read each file, by its path; digests in paths left out, files then alike numbered by contents."""
        found: dict[str, list[Callable[[], bytes]]] = {}
        for name, read in self._parts():
            found.setdefault(DIGEST_OF_PATH.sub("", name), []).append(read)
        files = {}
        for name, reads in found.items():
            for i, read in enumerate(sorted(reads, key=lambda r: r()) if len(reads) > 1 else reads):
                files[f"{name}#{i + 1}" if i else name] = read
        return files

    def _parts(self) -> Iterator[tuple[str, Callable[[], bytes]]]:
        """Paths below the folder and how to read each; the parts of an FMU stand for it."""
        for path in sorted(p for p in self.folder.rglob("*") if p.is_file()):
            name = path.relative_to(self.folder).as_posix()
            if path.suffix == ".fmu":
                with zipfile.ZipFile(path) as parts:
                    yield from ((f"{name}!{part}", partial(_part, path, part)) for part in parts.namelist())
            else:
                yield name, path.read_bytes

    def masks(self) -> dict[str, str]:
        """What stands for parts of texts that belong to this run: paths, absolute and from the checkout, and MASKED."""
        about = json.loads((self.folder / RUN).read_text())
        root, repository = about["root"], about["repository"]
        paths = {re.escape(root): "<root>", re.escape(os.path.relpath(root, repository)) + r"(?=/)": "<root>"}
        return {**paths, re.escape(repository): "<repository>", **MASKED}


def _part(fmu: Path, name: str) -> bytes:
    with zipfile.ZipFile(fmu) as parts:
        return parts.read(name)


def _masked(text: str, masks: Mapping[str, str]) -> str:
    for pattern, instead in masks.items():
        text = re.sub(pattern, instead, text)
    return text


def _kind(name: str) -> str:
    """What a file is read as: the end of its name, or all of it for parts of an FMU."""
    last = re.split("[/!]", name.partition("#")[0])[-1]
    return last if last in READERS else Path(last).suffix


def read_leaves(name: str, data: bytes, masks: Mapping[str, str]) -> Leaves | None:
    """Leaves of a file, texts and keys masked; of a text the whole; None of a file that is neither."""
    kind = _kind(name)
    if kind in READERS:
        leaves = READERS[kind](data)
    elif kind in TEXTS:
        leaves = {"": data.decode(errors="replace")}
    else:
        return None
    return {_masked(k, masks): _masked(leaf, masks) if isinstance(leaf, str) else leaf for k, leaf in leaves.items()}


# What was renamed --------------------------------------------------------------------------------------------------


NewNames = Mapping[str, str | list[str]]


@dataclass(frozen=True)
class Renames:
    """Names before -> names after, in a TOML file of these three tables.

    files   : path from OUT, a folder of it, or a file's name alone
    columns : of a CSV, NetCDF, npz or Parquet
    keys    : of a JSON or TOML: one key, or several with dots between

    A name is replaced where it is missing after and its new name is there; several new names are tried in turn.
    """

    files: NewNames = field(default_factory=dict)
    columns: NewNames = field(default_factory=dict)
    keys: NewNames = field(default_factory=dict)

    def of_files(self, before: Mapping[str, T], after: Iterable[str]) -> dict[str, T]:
        """Files before by their paths after."""
        return _renamed(before, set(after), self.files, "/!")

    def of_leaves(self, file: str, before: Mapping[str, T], after: Iterable[str]) -> dict[str, T]:
        """Leaves of a file before by their keys after."""
        if _kind(file) in (".json", ".toml"):
            return _renamed(before, set(after), self.keys, ".")
        return _renamed(before, set(after), self.columns, "/@")


def _renamed(before: Mapping[str, T], after: set[str], renames: NewNames, ends: str) -> dict[str, T]:
    choices = [[new] if isinstance(new, str) else new for new in renames.values()]
    tries = [
        {old: new[min(k, len(new) - 1)] for old, new in zip(renames, choices, strict=True)}
        for k in range(max(map(len, choices), default=0))
    ]

    def name_after(name: str) -> str:
        new = (_replaced(name, t, ends) for t in tries)
        return name if name in after else next((n for n in new if n in after), name)

    return {name_after(name): value for name, value in before.items()}


def _replaced(name: str, renames: Mapping[str, str], ends: str) -> str:
    """Whole parts of a name, between any of `ends`, replaced: longest first, each once."""
    known = "|".join(re.escape(old) for old in sorted(renames, key=len, reverse=True))
    return re.sub(rf"(?:(?<=[{ends}])|^)({known})(?=[{ends}]|$)", lambda found: renames[found[1]], name)


def load_renames(path: Path | None) -> Renames:
    """Renames of a TOML file; none without a file."""
    return Renames() if path is None else Renames(**tomllib.loads(path.read_text()))


# Comparison --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Difference:
    """Numbers of one leaf that differ: the largest relative difference, how many of how many, the worst pair."""

    file: str
    key: str
    relative: float
    count: int
    of: int
    before: float
    after: float

    def line(self) -> str:
        """As a line of the report."""
        worst = f"{self.before!r} -> {self.after!r}"
        return f"  {self.relative:9.3g}  {self.count} of {self.of}  {self.file}: {self.key}  ({worst})"


@dataclass
class Comparison:
    """What was found; `structure` are files, each with what is missing in it or of another shape or kind."""

    files: Counter[str] = field(default_factory=Counter)
    arrays: int = 0
    numbers: int = 0
    differences: list[Difference] = field(default_factory=list)
    structure: list[tuple[str, str]] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    pictures: list[str] = field(default_factory=list)
    ignored: Counter[str] = field(default_factory=Counter)

    def same(self, tolerance: float) -> bool:
        """Whether all numbers are there and none differs by more."""
        return not self.structure and all(d.relative <= tolerance for d in self.differences)

    def _structure(self) -> list[str]:
        """One line for what several files have in common."""
        by_what: dict[str, list[str]] = {}
        for name, what in self.structure:
            by_what.setdefault(what, []).append(name)
        return [
            f"{what}: {names[0]}" + (f" and {len(names) - 1} more" if len(names) > 1 else "")
            for what, names in by_what.items()
        ]

    def report(self, tolerance: float) -> str:
        """Everything that was found, numbers that differ most first."""
        ordered = sorted(self.differences, key=lambda d: -d.relative)
        beyond = [d.line() for d in ordered if d.relative > max(tolerance, LAST_BITS)]
        within = [d.line() for d in ordered if d.relative <= max(tolerance, LAST_BITS)]
        kinds = ", ".join(f"{n} {kind}" for kind, n in sorted(self.files.items()))
        lines = [f"{sum(self.files.values())} files ({kinds}), {self.arrays} arrays, {self.numbers} numbers compared"]
        for title, found in (
            ("missing, or of another shape or kind", self._structure()),
            ("arrays that differ", beyond),
            (f"arrays that differ by at most {max(tolerance, LAST_BITS):g}", within),
            ("texts that differ (no failure)", self.texts),
            ("pictures whose bytes differ (no failure)", self.pictures),
        ):
            lines += [f"{title}: {len(found)}", *(line if line.startswith("  ") else f"  {line}" for line in found)]
        lines += [f"left out: {n} x {why}" for why, n in sorted(self.ignored.items())]
        return "\n".join([*lines, "same numbers" if self.same(tolerance) else "NOT the same numbers"])


def compare_folders(before: Path, after: Path, renames: Renames) -> Comparison:
    """Compare two folders that `same_results run` wrote."""
    found, results = Comparison(), (Results(before), Results(after))
    new = results[1].files()
    old = renames.of_files(results[0].files(), new)
    masks = [r.masks() for r in results]
    for name in sorted(old.keys() | new.keys()):
        if why := _why_ignored(name, IGNORED_FILES):
            found.ignored[why] += 1
            continue
        if name not in new or name not in old:
            found.structure.append((name, f"file only {'before' if name in old else 'after'}"))
            continue
        data = old[name](), new[name]()
        leaves = [read_leaves(name, d, m) for d, m in zip(data, masks, strict=True)]
        found.files[_kind(name).lstrip(".") or "text"] += 1
        if leaves[0] is not None and leaves[1] is not None:
            _compare_leaves(name, renames.of_leaves(name, leaves[0], leaves[1]), leaves[1], found)
        elif data[0] != data[1] and _kind(name) in PICTURES:
            found.pictures.append(name)
        elif data[0] != data[1]:
            found.structure.append((name, "other bytes"))
    return found


def _why_ignored(name: str, ignored: Mapping[str, str]) -> str | None:
    return next((why for pattern, why in ignored.items() if re.fullmatch(pattern, name)), None)


def _compare_leaves(name: str, old: Leaves, new: Leaves, found: Comparison) -> None:
    for key in dict.fromkeys([*old, *new]):
        of_run = _why_ignored(key, IGNORED_OF_RUNS) if name.endswith(RUN) else None
        if why := of_run or _why_ignored(re.split("[.@#]", key)[-1], IGNORED):
            found.ignored[why] += 1
            continue
        a, b = old.get(key), new.get(key)
        if a is None or b is None:
            found.structure.append((name, f"{key}: only {'after' if a is None else 'before'}"))
        elif isinstance(a, str) and isinstance(b, str):
            if a != b:
                found.texts.append(f"{name}: {key + ': ' if key else ''}{_texts(a, b)}")
        elif isinstance(a, str) or isinstance(b, str):
            found.structure.append((name, f"{key}: text and number"))
        elif a.shape != b.shape:
            found.structure.append((name, f"{key}: shape {a.shape} -> {b.shape}"))
        else:
            found.arrays += 1
            found.numbers += a.size
            if (difference := _difference(name, key, a, b)) is not None:
                found.differences.append(difference)


def _difference(name: str, key: str, a: Numbers, b: Numbers) -> Difference | None:
    """Where two arrays of one shape differ in their bits; 0 and -0 do, by nothing; all NaN are the same."""
    a, b = np.ravel(a), np.ravel(b)
    differs = (a.view(np.int64) != b.view(np.int64)) & ~(np.isnan(a) & np.isnan(b))
    if not differs.any():
        return None
    a, b = a[differs], b[differs]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        relative = np.abs(a - b) / np.maximum(np.abs(a), np.abs(b))
    relative[(a == 0.0) & (b == 0.0)] = 0.0
    relative[np.isnan(relative)] = np.inf
    worst = int(np.argmax(relative))
    of = len(differs)
    return Difference(name, key, float(relative[worst]), len(a), of, float(a[worst]), float(b[worst]))


_PRINTED = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])")
SHOWN = 100
"""Longest text that is shown in a report."""


def _texts(before: str, after: str) -> str:
    """Two texts that differ, if they are short, and whether they hold the same numbers in the same order."""
    old, new = (_PRINTED.findall(re.sub(r"base64,[\w+/=]+", "", text)) for text in (before, after))
    gone = sum((Counter(old) - Counter(new)).values())
    numbers = "same numbers" if old == new else f"OTHER NUMBERS, {gone} of {len(old)}"
    return numbers if len(before) + len(after) > 2 * SHOWN else f"{numbers}: {before!r} -> {after!r}"
