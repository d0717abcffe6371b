"""Whether two links read the same messages in the same way: what a journal may be gone on with, or not.

What is estimated, shown and predicted may differ: all of it is made again from the messages. What a field is, and what
is followed, may not.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from sim_heating.base.errors import InputError
from sim_heating.base.files.paths import bytes_digest, file_digest
from sim_heating.base.files.text import abbreviated
from sim_heating.live.spec import Link, LinkFile, Packets, Replay

DECODED = ("source", "time", "conditions", "sensor")
"""Tables of a link file that say what a message means."""
FOLLOWED = ("vehicle", "records", "control_points")
"""Its keys that say what is followed; the names that they lead to are compared besides."""
NOT_OF_MESSAGES = ("host", "port", "user", "speed")
"""Keys of a source that say where its messages come from, and not what they are."""


def meaning(link: Link) -> dict[str, Any]:
    """What the messages of a link mean beyond its file: sensors by control point, columns, digests of what it names."""
    sensors = {
        point.name: {
            s.name: {"column": s.column, "bits": s.bits, "range_K": None if s.range_K is None else list(s.range_K)}
            for s in point.sensors
        }
        for point in link.points
    }
    return {"columns": list(link.columns), "sensors": sensors, "files": dict(_named_files(link))}


def _named_files(link: Link) -> Iterator[tuple[str, str]]:
    """Digest of each file that says what the messages are: an XTCE document, a record that is sent again."""
    for number, source in enumerate(link.declared.source, start=1):
        table = f"[[source]] {number}"
        if isinstance(source, Packets):
            yield f"{table}: `xtce`", file_digest(link.file(source.xtce, f"{table}: `xtce`"))
        if isinstance(source, Replay):
            folders = [r.directory for r in link.records.values()]
            if source.record is not None:
                folders = [link.file(source.record, f"{table}: `record`")]
            yield f"{table}: `record`", bytes_digest(b"".join(_contents(Path(folder)) for folder in folders))


def _contents(folder: Path) -> bytes:
    """Declaration and tables of a record."""
    files = sorted(p for p in folder.glob("*") if p.suffix in (".csv", ".toml"))
    return b"\0".join(f.name.encode() + b"\0" + f.read_bytes() for f in files)


Read = tuple[Mapping[str, Any], Mapping[str, Any] | None]
"""Contents of a link file as plain data, and its `meaning`; None of one that does not state it."""


def differences(earlier: Read, now: Read) -> list[str]:
    """What differs between what two links read, a line each; empty where they read the same."""
    lines = list(_apart(_compared(earlier[0]), _compared(now[0]), ""))
    if earlier[1] is not None and now[1] is not None:
        lines += _apart(earlier[1], now[1], "")
    return lines


def _compared(contents: Mapping[str, Any]) -> dict[str, Any]:
    """What is compared of a link file, with the defaults of what it does not state."""
    try:
        contents = LinkFile.model_validate(contents).model_dump(mode="json")
    except (ValidationError, InputError, ValueError):  # of a version that had other keys: as it is written
        contents = dict(contents)
    compared = {key: contents.get(key) for key in (*DECODED, *FOLLOWED)}
    sources = contents.get("source") or []
    compared["source"] = [{k: v for k, v in source.items() if k not in NOT_OF_MESSAGES} for source in sources]
    compared["conditions"] = {k: _stated_keys(v) for k, v in (compared["conditions"] or {}).items()}
    return compared


def _stated_keys(condition: str | Mapping[str, Any]) -> dict[str, Any]:
    """The keys of a condition that state something; one by the name of its field alone as a table."""
    table = {"field": condition} if isinstance(condition, str) else condition
    return {key: value for key, value in table.items() if value is not None}


def _apart(value: Any, other: Any, key_path: str) -> Iterator[str]:
    """Lines on where two plain values differ, by their keys."""
    if isinstance(value, Mapping) and isinstance(other, Mapping):
        for key in dict.fromkeys([*value, *other]):
            yield from _apart(value.get(key), other.get(key), f"{key_path}.{key}".lstrip("."))
    elif _are_tables(value) and _are_tables(other):
        if len(value) != len(other):
            yield f"[[{key_path}]]: there were {len(value)}, now {len(other)}"
        for k, (a, b) in enumerate(zip(value, other, strict=False), start=1):
            yield from _apart(a, b, f"{key_path} {k}")
    elif value != other:
        file = key_path.removeprefix("files.")
        was = f"`{key_path}` was {_shown(value)}, now {_shown(other)}"
        yield was if file == key_path else f"{file} names a file that was changed"


def _are_tables(values: Any) -> bool:
    is_list = isinstance(values, Sequence) and not isinstance(values, str)
    return is_list and all(isinstance(v, Mapping) for v in values)


def _shown(value: Any) -> str:
    return "absent" if value is None else abbreviated(value)
