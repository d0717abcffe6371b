"""JSON files, and output directories that hold either all files of a run or none of them."""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files.text import (
    abbreviated,
    as_builtin,
    display_path,
    os_error_reason,
    read_text,
    umask,
    write_text_atomic,
)

MARKER = ".sim_heating.json"
"""File of an output directory that lists the files this program wrote there."""
PARTIAL_NAME_LENGTH = 50
"""Characters of a directory's name repeated in its temporary one: a whole long name would exceed the system's limit."""


def json_text(data: Any) -> str:
    """Plain data, numpy numbers and arrays as JSON.

    raises : RunError naming the entry where a number is not finite
    """
    found = _not_finite(data, "")
    if found:
        raise RunError(f"{found}, which JSON cannot represent; nothing was written")
    return json.dumps(data, indent=2, default=_to_builtin, allow_nan=False, ensure_ascii=False) + "\n"


def write_json(path: str | os.PathLike[str], data: Any) -> None:
    """Write data as JSON, whole or not at all; NaN is an error, None becomes null."""
    write_text_atomic(path, json_text(data))


def read_json(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a JSON file that holds an object.

    raises : InputError, one line, where it is not JSON, holds NaN or an infinity, or is not an object
    """
    text, name = read_text(path), display_path(path)
    try:
        data = json.loads(text, parse_constant=_refuse_constant)
    except json.JSONDecodeError as error:
        at_end = error.pos >= len(text.rstrip()) or error.msg.startswith("Unterminated string")
        cut = "; the file may have been cut off" if at_end else ""
        raise InputError(f"{name}, line {error.lineno}: {error.msg} (column {error.colno}); is not JSON{cut}") from None
    except RecursionError:
        raise InputError(f"{name}: objects or lists are nested too deeply") from None
    except ValueError as error:
        raise InputError(f"{name}: {error}") from None
    if not isinstance(data, dict):
        raise InputError(f"{name}: contains {abbreviated(data)}; it must be an object {{...}}")
    return data


def _refuse_constant(name: str) -> float:
    raise ValueError(f"contains {name}, which is not a JSON number")


def _to_builtin(value: Any) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__} cannot be represented in JSON")


def _not_finite(value: Any, place: str) -> str | None:
    """`place is nan` for the first number that is not finite, or None."""
    value = as_builtin(value)
    if isinstance(value, float) and not math.isfinite(value):
        return f"{place.lstrip('.') or 'the value'} is {value}"
    if isinstance(value, Mapping):
        return next((f for k, v in value.items() if (f := _not_finite(v, f"{place}.{k}"))), None)
    if isinstance(value, (list, tuple)):
        return next((f for i, v in enumerate(value) if (f := _not_finite(v, f"{place}[{i}]"))), None)
    return None


@contextmanager
def output_directory(path: str | os.PathLike[str], expected: Sequence[str] = ()) -> Iterator[Path]:
    """A directory for results that appear all together when the block succeeds, and not at all when it fails.

        with output_directory("out") as folder:
            write_csv(folder / "temperatures.csv", ...)

    A new directory is built under a temporary name and renamed. In an existing one, the files of an earlier run of this
    program (listed in its `.sim_heating.json`) are replaced and other files stay untouched; where a result would
    overwrite one of those, nothing is written.

    expected : names of the results; other people's files of these names are reported before the work begins
    raises   : InputError before the work where the place cannot be used, and after it where a result would overwrite a
               file that this program did not write
    """
    target = Path(os.path.abspath(path))
    _refuse_foreign(target, expected)
    partial, new_parents = _make_partial(target, display_path(path))
    try:
        yield partial
        marker = partial / MARKER
        files = [p for p in partial.rglob("*") if not p.is_dir() and p != marker]
        names = sorted(p.relative_to(partial).as_posix() for p in files)
        write_json(marker, {"format": "sim_heating-output/1", "files": names})
        if target.exists():
            _merge(partial, target, names)
        else:
            os.replace(partial, target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        if not target.exists():
            _remove_empty(new_parents)


def require_writable(path: str | os.PathLike[str], expected: Sequence[str] = ()) -> None:
    """Check before any work that `output_directory` could write results of these names; leaves nothing behind.

    raises : InputError as `output_directory` does before the work
    """
    target = Path(os.path.abspath(path))
    _refuse_foreign(target, expected)
    partial, new_parents = _make_partial(target, display_path(path))
    partial.rmdir()
    _remove_empty(new_parents)


def _remove_empty(directories: Sequence[Path]) -> None:
    """Remove directories, innermost first, as far as they are empty."""
    with suppress(OSError):
        for directory in directories:
            directory.rmdir()


def _make_partial(target: Path, name: str) -> tuple[Path, list[Path]]:
    """A temporary directory on the same file system, and the parents of the target that had to be created.

    It is inside the target where that exists, else next to it.
    """
    try:
        new_parents = [p for p in target.parents if not p.exists()]
        inside = target.is_dir()
        if target.exists() and not inside:
            raise InputError(f"{name}: is a file; name a directory for the results")
        if not inside:
            target.parent.mkdir(parents=True, exist_ok=True)
        prefix = f".{target.name[:PARTIAL_NAME_LENGTH]}.partial-"
        partial = Path(tempfile.mkdtemp(prefix=prefix, dir=target if inside else target.parent))
        partial.chmod(0o777 & ~umask())
    except OSError as error:
        raise InputError(
            f"{name}: results cannot be written ({os_error_reason(error)}); choose another place"
        ) from None
    return partial, new_parents


def files_written(directory: str | os.PathLike[str]) -> set[str]:
    """Names of the files that this program wrote to a directory, from its own list; empty without a list."""
    try:
        listed = json.loads((Path(directory) / MARKER).read_text(encoding="utf-8"))["files"]
    except (OSError, ValueError, KeyError, TypeError):
        return set()
    return {str(n) for n in listed if ".." not in Path(str(n)).parts and not Path(str(n)).is_absolute()}


def _refuse_foreign(target: Path, names: Sequence[str]) -> None:
    """raises : InputError where a file of one of these names exists that this program did not write"""
    ours = files_written(target)
    foreign = [n for n in names if n not in ours and os.path.exists(target / n)]
    if foreign:
        raise InputError(
            f"{display_path(target)}: {', '.join(foreign)} already exists and was not written by sim-heating; choose "
            "another directory"
        )


def _merge(partial: Path, target: Path, names: Sequence[str]) -> None:
    """Move finished files into an existing directory in place of an earlier run's; undone if it fails half-way."""
    _refuse_foreign(target, names)
    ours = files_written(target)
    backup = Path(tempfile.mkdtemp(prefix=".replaced-", dir=partial))
    undo: list[tuple[Path, Path]] = []
    try:
        for name in sorted(n for n in {*ours, MARKER} if (target / n).is_file()):
            _move(target / name, backup / name, undo)
        for name in (*names, MARKER):
            _move(partial / name, target / name, undo)
    except BaseException:
        for old, new in reversed(undo):
            os.replace(new, old)
        raise


def _move(old: Path, new: Path, undo: list[tuple[Path, Path]]) -> None:
    new.parent.mkdir(parents=True, exist_ok=True)
    os.replace(old, new)
    undo.append((old, new))
