"""Text files read and written whole, and the wording of messages: paths, similar names, values."""

from __future__ import annotations

import difflib
import json
import os
import stat
import tempfile
from collections.abc import Iterable, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files.paths import display_path, make_durable, os_error_reason, umask
from sim_heating.base.files.transaction import STAGING, settle_above

PARTIAL = ".partial-"
"""Part of the name of a file that is being written; eight random characters follow."""
PARTIAL_NAME_LENGTH, RANDOM_LENGTH = 50, 8
"""Characters of a file's name repeated in its temporary one, which would else exceed the system's limit; and those
after it."""
LARGEST_TEXT_BYTES = 1_000_000_000
"""Largest text that is read: a record of 50 columns for an hour at 500 samples a second has about this size."""
_OTHER_KINDS = (
    (stat.S_ISDIR, "a directory"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)
NAMES_LISTED = 24
"""Known names that a message lists."""


MANY_NAMES, OTHER_LENGTH = 5000, 2
"""Of more names, as many are compared that begin alike and differ in length by at most so many letters."""


def nearest_name(name: str, choices: Iterable[str], cutoff: float = 0.6) -> str | None:
    """The known name most similar to a wrong one, ignoring case, or None where none is similar.

    cutoff : least similarity, 0 to 1 (difflib)
    """
    by_lower = {k.lower(): k for k in choices}
    if len(by_lower) > MANY_NAMES:  # each comparison takes microseconds
        alike = (k for k in by_lower if k[:1] == name[:1].lower() and abs(len(k) - len(name)) <= OTHER_LENGTH)
        by_lower = {k: by_lower[k] for k in islice(alike, MANY_NAMES)}
    close = difflib.get_close_matches(name.lower(), by_lower, n=1, cutoff=cutoff)
    return by_lower[close[0]] if close else None


def suggestion(name: str, choices: Iterable[str], otherwise: str | None = None, cutoff: float = 0.6) -> str:
    """End of a message about an unknown name: "; did you mean `x`?", or the known names where none is close.

    otherwise : end of the message where no name is close, in place of the list of known names
    cutoff    : least similarity of a close name, 0 to 1
    """
    names = list(choices)
    near = nearest_name(name, names, cutoff)
    if near:
        return f"; did you mean `{near}`?"
    if otherwise is not None:
        return otherwise
    return f"; known: {first_of([f'`{n}`' for n in names], NAMES_LISTED) or 'none'}"


def first_of(names: Sequence[str], most: int | None) -> str:
    """The first of some names with commas, and how many more there are; all of them where `most` is None."""
    named = names[:most]
    return ", ".join(named) + (f" and {len(names) - len(named)} more" if len(named) < len(names) else "")


def repeated_name(names: Sequence[str]) -> str | None:
    """The first name that a list holds more than once, or None."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            return name
        seen.add(name)
    return None


def raise_problems(problems: Sequence[str]) -> None:
    """Raise all problems of a file at once, if there are any."""
    if problems:
        raise InputError(*problems)


def and_more_rows(count: int) -> str:
    """` (and 3 more rows)` of 4 rows of which a message names the first; empty for a single one."""
    return f" (and {count - 1} more rows)" if count > 1 else ""


def read_text(path: str | os.PathLike[str]) -> str:
    """The text of a file; where a killed process was replacing it, that is finished or undone first.

    raises : InputError, one line, where it is missing, not a regular file, unreadable, empty, binary, not UTF-8, or
             larger than LARGEST_TEXT_BYTES
    """
    settle_above(path)
    name = display_path(path)
    try:
        raw = _regular_file(Path(path), name)
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{name}: there is no such file{_similar_file(Path(path))}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{name}: cannot be read ({os_error_reason(error)}); give a text file") from None
    if not raw.strip():
        raise InputError(f"{name}: the file is empty")
    if b"\0" in raw:
        raise InputError(f"{name}: is a binary file (byte {raw.index(0)} is 0); give a text file")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        bad = f"byte 0x{raw[error.start]:02x}"
        raise InputError(f"{name}, line {line}: {bad} is not UTF-8 text; save the file as UTF-8") from None


def _regular_file(path: Path, name: str) -> bytes:
    """The bytes of a file; a pipe or a device, which may never end, is not opened."""
    kind, size = path.stat().st_mode, path.stat().st_size
    if not stat.S_ISREG(kind):
        kind_text = next((text for test, text in _OTHER_KINDS if test(kind)), "not a regular file")
        raise InputError(f"{name}: is {kind_text}; give a text file")
    if size > LARGEST_TEXT_BYTES:
        raise InputError(
            f"{name}: has {size / 1e6:.0f} MB, above the {LARGEST_TEXT_BYTES / 1e6:.0f} MB that a text may have; "
            "split or thin it"
        )
    return path.read_bytes()


def raw_text(path: str | os.PathLike[str]) -> str:
    """The text of a file with its line ends and byte-order mark unchanged; raises as `read_text`."""
    read_text(path)
    return Path(path).read_bytes().decode("utf-8")


def _similar_file(path: Path) -> str:
    try:
        near = nearest_name(path.name, sorted(p.name for p in path.parent.iterdir()), cutoff=0.7)
    except OSError:
        return ""
    return f"; did you mean `{near}`?" if near else ""


def is_plain(text: str) -> bool:
    """Whether a text has none of what Python reads as a number and other programs do not: `1_000`, other digits."""
    return "_" not in text and text.isascii()


def plain_number(text: str) -> float:
    """The number that a text stands for, in plain digits.

    raises : ValueError where it is not a number, or one with `_` or with digits of another script
    """
    if not is_plain(text):
        raise ValueError(f"{text} is not a number in plain digits")
    return float(text)


def listed(words: Sequence[str]) -> str:
    """Words as a sentence has them: `2`, `2 and 3`, `2, 3 and 5`; at least one."""
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def abbreviated(value: Any) -> str:
    """A value for a message: on one line, cut after 60 characters."""
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= 60 else text[:57] + "..."


def as_builtin(value: Any) -> Any:
    """numpy scalars and arrays as Python numbers and lists; other values unchanged."""
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value


def write_text_atomic(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file in UTF-8 whole or not at all; missing parent directories are created.

    Bytes of a name that is not UTF-8 become escapes.

    raises : InputError where the place cannot be written; RunError where it is full
    """
    write_bytes_atomic(path, text.encode("utf-8", errors="backslashreplace"))


def write_bytes_atomic(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file of bytes whole or not at all, also where the machine stops; raises as `write_text_atomic`."""
    target = Path(path)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, partial = tempfile.mkstemp(prefix=f".{target.name[:PARTIAL_NAME_LENGTH]}{PARTIAL}", dir=target.parent)
    except OSError as error:
        raise InputError(
            f"{display_path(result_path(path))}: cannot be written ({os_error_reason(error)}); choose another place"
        ) from None
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
        os.chmod(partial, 0o666 & ~umask())
        durable = STAGING not in target.parts  # those are made durable together
        if durable:
            make_durable(partial)
        os.replace(partial, target)
        if durable:
            make_durable(target.parent)
    except OSError as error:
        Path(partial).unlink(missing_ok=True)
        problem = f"{display_path(result_path(path))}: cannot be written ({os_error_reason(error)})"
        raise RunError(f"{problem}; nothing is half-written: make room or choose another place") from None
    except BaseException:
        Path(partial).unlink(missing_ok=True)
        raise


def result_path(path: str | os.PathLike[str]) -> Path:
    """The path that a file of a result will have, when the directory that it is written in replaces the earlier one."""
    parts = Path(path).parts
    start = parts.index(STAGING) if STAGING in parts else len(parts)
    return Path(*parts[:start], *parts[start + 2 :])


def clear_partial_files(directory: str | os.PathLike[str], name: str = "") -> None:
    """Remove what killed processes left of files that they were writing; nobody else may be writing there.

    name : of the one file concerned; all files of the directory where empty
    """
    prefix = f".{name[:PARTIAL_NAME_LENGTH]}"
    with suppress(OSError):
        for path in list(Path(directory).iterdir()):
            start, found, end = path.name.rpartition(PARTIAL)
            ours = (
                found
                and len(end.partition(".")[0]) == RANDOM_LENGTH
                and (start == prefix if name else start.startswith("."))
            )
            if ours and path.is_file() and not path.is_symlink():
                path.unlink()
