"""JSON files, and output directories that hold either all files of a run or none of them.

A JSON file may carry the digest of its own content, so that a reader notices any later change. The digest depends on
the content alone: not on the order of keys, on blanks and line ends, nor on whether a whole number has a decimal point.
It is a guard against accidents and edits by hand, not a signature.
"""

from __future__ import annotations

import json
import logging
import math
import os
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base.errors import InputError, LeftOutWarning, RunError
from sim_heating.base.files import transaction
from sim_heating.base.files.paths import display_path, file_digest, has_digest, real_path, text_digest
from sim_heating.base.files.provenance import results_from, with_provenance
from sim_heating.base.files.text import abbreviated, as_builtin, first_of, read_text, write_text_atomic

LOG = logging.getLogger(__name__)
MARKER = ".sim_heating.json"
"""File of an output directory that lists the files this program wrote there, with their digests."""
MARKER_FORMAT = "sim_heating-output/2"
MOST_NAMED = 6
"""Names of files that a message has at most."""
OR_FORCE = ", or replace what is there with --force"
"""End of a message about files that others wrote, which every command that writes has the option for."""
REPLACE_OTHERS = "SIM_HEATING_REPLACE_OTHERS"
"""Environment variable that is set within `replacing_others`: processes that a command starts inherit it."""


@contextmanager
def replacing_others() -> Iterator[None]:
    """Within the block, results replace files of the same names, whoever wrote or changed them.

    Results of another command that are unchanged are removed, as those of the same command are. All other files stay.
    A warning names what was replaced.
    """
    before = os.environ.get(REPLACE_OTHERS)
    os.environ[REPLACE_OTHERS] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[REPLACE_OTHERS]
        else:
            os.environ[REPLACE_OTHERS] = before


def replaces_others() -> bool:
    """Whether results may replace files that others wrote or changed."""
    return bool(os.environ.get(REPLACE_OTHERS))


DIGEST = "digest"
"""Key of the digest in a file."""
LEFT_OUT = "left_out"
"""Key of a JSON object that lists its numbers that are not finite, which stand as null in it."""


def json_text(data: Any) -> str:
    """Plain data, numpy numbers and arrays as JSON.

    raises : RunError naming the entry where a number is not finite
    """
    entry = next(_not_finite(data, ""), None)
    if entry:
        raise RunError(f"{entry}, which JSON cannot represent; nothing was written")
    return json.dumps(data, indent=2, default=_to_builtin, allow_nan=False, ensure_ascii=False) + "\n"


def finite_json(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Results with null in place of each number that is not finite: one such number does not cost the others.

    The entries are listed under `left_out`, and a LeftOutWarning names them; without such a number, the data as it is.
    """
    entries = list(_not_finite(data, ""))
    if not entries:
        return data
    warnings.warn(f"left out as not finite: {first_of(entries, MOST_NAMED)}", LeftOutWarning, stacklevel=3)
    return {**_with_null(data), LEFT_OUT: entries}


def finite_or_none(value: float | None) -> float | None:
    """A number as JSON has it: None where it is not finite."""
    return float(value) if value is not None and math.isfinite(value) else None


def write_json(path: str | os.PathLike[str], data: Mapping[str, Any]) -> None:
    """Write results as JSON, whole or not at all; None and numbers that are not finite become null (finite_json).

    Results that state their format carry their origin as `provenance`, those with a digest where they have it already.
    """
    write_text_atomic(path, json_text(finite_json(data if DIGEST in data else with_provenance(data))))


def content_digest(data: Mapping[str, Any]) -> str:
    """`sha256:...` of a JSON object, its own digest aside.

    The bytes behind it: JSON with sorted keys, no blanks, every number as a floating-point one, ASCII with escapes.
    """
    content = json.loads(json.dumps({k: v for k, v in data.items() if k != DIGEST}), parse_int=float)
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return text_digest(text)


def with_digest(data: Mapping[str, Any]) -> dict[str, Any]:
    """The data as plain values, with the digest of their content as the last key.

    raises : RunError naming the entry where a number is not finite
    """
    plain = json.loads(json_text(data))
    return {**{k: v for k, v in plain.items() if k != DIGEST}, DIGEST: content_digest(plain)}


def digest_matches(data: Mapping[str, Any]) -> bool:
    """Whether the digest that a JSON object carries is that of its content; False where it carries none."""
    try:
        return data.get(DIGEST) == content_digest(data)
    except RecursionError:  # nested more deeply than anything that is written with a digest
        return False


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


def _not_finite(value: Any, key: str) -> Iterator[str]:
    """`key is nan` for each number that is not finite."""
    value = as_builtin(value)
    if isinstance(value, float) and not math.isfinite(value):
        yield f"{key.lstrip('.') or 'the value'} is {value}"
    if isinstance(value, Mapping):
        for k, v in value.items():
            yield from _not_finite(v, f"{key}.{k}")
    if isinstance(value, (list, tuple)):
        for i, v in enumerate(value):
            yield from _not_finite(v, f"{key}[{i}]")


def _with_null(value: Any) -> Any:
    """Data with None in place of each number that is not finite."""
    value = as_builtin(value)
    if isinstance(value, Mapping):
        return {k: _with_null(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_with_null(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextmanager
def output_directory(
    path: str | os.PathLike[str],
    command: str,
    *,
    expected: Iterable[str] = (),
    inputs: Iterable[str | os.PathLike[str] | None] = (),
    seed: int | None = None,
) -> Iterator[Path]:
    """A directory for results that appear all together when the block succeeds, and not at all when it fails.

        with output_directory("out", "run", inputs=[scenario]) as folder:
            write_csv(folder / "temperatures.csv", ...)

    The block writes into a temporary directory. Its files then replace those that an earlier run of the same command
    wrote (`.sim_heating.json` lists them with their digests); other files stay untouched. A result that was changed
    since it was written is no longer this program's, and is not replaced. Where the process is killed, the next one
    that reads or writes the directory finishes or undoes the replacement.

    Within such a block, directories below `folder` are part of the same results.

    command  : what writes; only its own results are replaced
    expected : names of the results; other people's files of these names are reported before the work begins
    inputs   : files and directories that the results are made from; None, and what does not exist, is passed over
    seed     : of the random numbers that the results hang on
    raises   : InputError before the work where the place cannot be used, holds other results, or is, contains or lies
               in an input; and after it where a result would overwrite a file that this program did not write
    """
    if transaction.STAGING in Path(path).parts:
        with _part_of_results(Path(path), command) as folder:
            yield folder
        return
    inputs = tuple(inputs)
    _refuse_inputs(real_path(path), inputs)
    with transaction.exclusive(path) as target, results_from(target, inputs, seed):
        _results_to_replace(target, command, expected)
        with transaction.staged(target) as folder:
            yield folder
            _write_marker(folder, command)
            old = _results_to_replace(target, command, transaction.files_below(folder))
            foreign = _others(target, command, old)
            count = len(transaction.files_below(folder))
            transaction.commit(target, old)
        LOG.info("%s: wrote %d files into %s", command, count, display_path(target))
        if foreign:
            _warn_of_replaced(target, foreign, command)


def _warn_of_replaced(target: Path, names: list[str], command: str) -> None:
    """Warn of files that were replaced although others had written or changed them."""
    warnings.warn(
        f"{display_path(target)}: replaced {first_of(names, MOST_NAMED)}, which `{command}` had not written, or not so",
        stacklevel=4,
    )


def require_writable(
    path: str | os.PathLike[str],
    command: str,
    *,
    expected: Iterable[str] = (),
    inputs: Iterable[str | os.PathLike[str] | None] = (),
) -> None:
    """Check before any work that `output_directory` could write these results; leaves nothing behind.

    raises : InputError as `output_directory` does before the work
    """
    _refuse_inputs(real_path(path), inputs)
    with transaction.exclusive(path) as target:
        _results_to_replace(target, command, expected)


@contextmanager
def _part_of_results(folder: Path, command: str) -> Iterator[Path]:
    """A directory within one that is being written; it has a list of its own, so that it may be moved elsewhere."""
    folder.mkdir(parents=True, exist_ok=True)
    yield folder
    if (folder.parent.name, folder.name) != (transaction.STAGING, transaction.NEW):
        _write_marker(folder, command)


def _write_marker(folder: Path, command: str) -> None:
    """List the files of a directory with their digests."""
    marker = folder / MARKER
    digests = {name: file_digest(folder / name) for name in transaction.files_below(folder) if name != MARKER}
    write_json(marker, {"format": MARKER_FORMAT, "command": command, "files": digests})


def _read_marker(directory: Path) -> tuple[str, dict[str, str]] | None:
    """Command and digests of the files that this program wrote to a directory; None without a list.

    raises : InputError where the list is damaged, or of a version that kept no digests
    """
    path = directory / MARKER
    if not os.path.lexists(path):
        return None
    rule = f"{display_path(path)}: lists no results of this program that can be verified; choose another directory"
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        command, files = data["command"], dict(data["files"])
        if data["format"] != MARKER_FORMAT or not all(isinstance(t, str) for t in (command, *files, *files.values())):
            raise TypeError
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(rule) from None
    return command, files


def files_written(directory: str | os.PathLike[str]) -> set[str]:
    """Names of the files that this program wrote to a directory, from its own list; empty without a list.

    raises : InputError where the list is damaged
    """
    marker = _read_marker(Path(directory))
    return set() if marker is None else set(marker[1])


def all_files_written(directory: str | os.PathLike[str]) -> list[str]:
    """Names, with `/`, of the files that this program wrote to a directory and to those below it, from their lists."""
    folders = sorted(path.parent.relative_to(directory) for path in Path(directory).rglob(MARKER))
    return sorted({(folder / name).as_posix() for folder in folders for name in files_written(directory / folder)})


def results_digest(directory: str | os.PathLike[str]) -> str | None:
    """Digest of all results in a directory; None where one is missing, was changed, or there are none."""
    try:
        marker = _read_marker(Path(directory))
        is_unchanged = marker is not None and all(has_digest(Path(directory) / n, d) for n, d in marker[1].items())
        return file_digest(Path(directory) / MARKER) if is_unchanged else None
    except (OSError, InputError):
        return None


def write_own_files(directory: str | os.PathLike[str], command: str, texts: Mapping[str, str]) -> None:
    """Write files into a directory that people keep others in, all or none; the list of results names these alone.

    A file that is there already is replaced only if it is one of the list, unchanged, or is what would be written.

    raises : InputError, nothing written, where another file has one of the names
    """
    with transaction.exclusive(directory) as target:
        listing = _read_marker(target)
        listed = {} if listing is None else listing[1]
        new = {name: text for name, text in texts.items() if not has_digest(target / name, text_digest(text))}
        foreign = _changed(target, new, listed)
        if foreign and not _may_replace(target, foreign):
            raise InputError(
                f"{display_path(target)}: {', '.join(foreign)} was not written by `{command}`, or was changed since, "
                f"and is not replaced; move it away{OR_FORCE}"
            )
        digests = listed | {name: text_digest(text) for name, text in texts.items()}
        marker = json_text({"format": MARKER_FORMAT, "command": command, "files": digests})
        if new or listing is None or digests != listed:
            transaction.replace_files(target, {**new, MARKER: marker})
        if foreign:
            _warn_of_replaced(target, foreign, command)


def _changed(target: Path, names: Iterable[str], digests: Mapping[str, str]) -> list[str]:
    """Files of these names that are there, and not as their digests have them, or that have none."""
    return [n for n in names if os.path.lexists(target / n) and not has_digest(target / n, digests.get(n, ""))]


def _may_replace(target: Path, names: Iterable[str]) -> bool:
    """Whether files that others wrote or changed may be replaced: by --force, and none of them is a folder."""
    return replaces_others() and not any((target / name).is_dir() for name in names)


def _results_to_replace(target: Path, command: str, names: Iterable[str]) -> dict[str, str]:
    """Names and digests of the earlier results in a directory.

    names  : files to be written
    raises : InputError where these are another command's, were changed, or where another file has one of the names
    """
    names = set(names)
    listing = _read_marker(target)
    earlier, files = listing if listing is not None else (command, {})
    _require_results_of(command, target, earlier)
    there = [name for name in sorted({*files, *names} - {MARKER}) if os.path.lexists(target / name)]
    for name in {*files, *names}:
        transaction.require_plain(target, name)
    marker = {} if listing is None else {MARKER: file_digest(target / MARKER)}
    if _may_replace(target, there):
        # a listed result that was changed, and is not written again, is a person's file
        kept = {*_changed(target, there, files)} - names
        return marker | {name: file_digest(target / name) for name in there if name not in kept}
    _require_own(target, there, files)
    return marker | {name: files[name] for name in there}


def _require_results_of(command: str, target: Path, earlier: str) -> None:
    """raises : InputError where the results in a directory are another command's, and may not be replaced"""
    if earlier != command and not replaces_others():
        raise InputError(
            f"{display_path(target)}: holds results of `{earlier}`, which `{command}` does not replace; choose another "
            f"directory{OR_FORCE}"
        )


def _require_own(target: Path, there: Sequence[str], files: Mapping[str, str]) -> None:
    """Refuse to replace files that are not earlier results as they were written.

    there  : names of the files in the directory that would go
    files  : names and digests of the earlier results
    raises : InputError with those of others, or those that were changed
    """
    foreign = [name for name in there if name not in files]
    if foreign:
        raise InputError(
            f"{display_path(target)}: {', '.join(foreign)} already exists and was not written by sim-heating; choose "
            f"another directory{OR_FORCE}"
        )
    if changed := _changed(target, there, files):
        raise InputError(
            f"{display_path(target)}: {', '.join(changed)} was changed after sim-heating wrote it and is not replaced; "
            f"move it away or choose another directory{OR_FORCE}"
        )


def _others(target: Path, command: str, replaced: Iterable[str]) -> list[str]:
    """Files that are replaced although another command or a person wrote or changed them."""
    marker = _read_marker(target)
    listed = marker[1] if marker is not None and marker[0] == command else {}
    return _changed(target, sorted(set(replaced) - {MARKER}), listed)


def _refuse_inputs(target: Path, inputs: Iterable[str | os.PathLike[str] | None]) -> None:
    """raises : InputError where a directory for results is, contains or lies in something that they are made from"""
    for source in inputs:
        if source is None or not os.path.exists(source):
            continue
        path = real_path(source)
        relations = {"is": path == target, "contains": target in path.parents, "lies in": path in target.parents}
        if (relation := next((words for words, holds in relations.items() if holds), None)) is not None:
            raise InputError(
                f"{display_path(target)}: {relation} the input {display_path(path)}, which results might replace; "
                "choose another directory for them"
            )
