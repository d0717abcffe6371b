"""The journal of a link: every body that came, in the order in which it came, appended to one file.

    header     one line of JSON: format, the link as it was declared, the time of the start
    entry      length (4 bytes), CRC-32 (4 bytes), arrival [ns] (8 bytes), source (2 bytes), body

All numbers are little-endian; the CRC is over what follows it. An entry of source 0xFFFF is a mark of the link itself:
`end` closes the journal.

Each entry is given to the operating system as it comes, so that a link that is killed loses none. It is forced to the
disk every `fsync_s` seconds by a thread of its own, so that a machine that loses power loses at most that much. Where
the disk is full, entries wait in memory and are written in order when there is room again. A journal that was cut off
ends in a part of an entry: `read_journal` stops before it, and the next link cuts it away and goes on behind it.
"""

from __future__ import annotations

import json
import os
import threading
import time
import zlib
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from struct import Struct
from typing import Any

from filelock import FileLock, Timeout

from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path
from sim_heating.base.files.paths import make_durable, os_error_reason

FORMAT = "live-journal/1"
NAME = "journal.bin"
"""Name of the file in the directory of a link."""
HEAD = Struct("<II")
BODY = Struct("<qH")
MARK = 0xFFFF
END = b"end"
LONGEST_BODY = 1 << 24
"""Bytes of a body; a longer one is not an entry but damage."""
KEPT = 1 << 28
"""Bytes that wait in memory while the disk is full; beyond, the oldest that wait are dropped, and counted."""
RETRY_S = 1.0
"""Time between attempts to write on a full disk [s]."""


@dataclass(frozen=True, slots=True)
class Entry:
    """A body as it came: arrival on the clock of that machine [ns], number of its source, bytes."""

    arrived_ns: int
    source: int
    body: bytes


@dataclass(frozen=True)
class JournalHead:
    """What a journal begins with, and whether it was closed.

    link    : contents of the link file, as plain data
    path    : file that names in it are relative to
    started : date and time of the start, ISO 8601
    size    : bytes up to the end of the last whole entry
    entries : number of whole entries, marks excluded
    is_closed : whether the link ended by itself
    """

    link: Mapping[str, Any]
    path: Path
    started: str
    size: int
    entries: int
    is_closed: bool


def _encoded(entry: Entry) -> bytes:
    content = BODY.pack(entry.arrived_ns, entry.source) + entry.body
    return HEAD.pack(len(content), zlib.crc32(content)) + content


def _header(path: Path, stream: Any) -> Mapping[str, Any]:
    line = stream.readline(1 << 24)
    try:
        found = json.loads(line)
    except ValueError:
        found = None
    if not line.endswith(b"\n") or not isinstance(found, dict) or found.get("format") != FORMAT:
        raise InputError(f"{display_path(path)}: is not a journal of a link ({FORMAT})")
    return found


def _entries(stream: Any) -> Iterator[tuple[Entry, int]]:
    """Whole entries and the place behind each, up to the first that is cut off or damaged."""
    while True:
        head = stream.read(HEAD.size)
        if len(head) < HEAD.size:
            return
        length, crc = HEAD.unpack(head)
        if not BODY.size <= length <= LONGEST_BODY:
            return
        content = stream.read(length)
        if len(content) < length or zlib.crc32(content) != crc:
            return
        arrived, source = BODY.unpack_from(content)
        yield Entry(arrived, source, content[BODY.size :]), stream.tell()


def read_journal(path: str | os.PathLike[str]) -> Iterator[Entry]:
    """The bodies of a journal in the order in which they came, up to where it was cut off.

    path   : of the file, or of the directory that holds it
    raises : InputError where it cannot be read or is no journal
    """
    place = journal_file(path)
    with _opened(place) as stream:
        _header(place, stream)
        for entry, _ in _entries(stream):
            if entry.source != MARK:
                yield entry


def read_head(path: str | os.PathLike[str]) -> JournalHead:
    """The header of a journal, and how far it reaches; InputError where it is no journal."""
    place = journal_file(path)
    with _opened(place) as stream:
        found = _header(place, stream)
        size, entries, is_closed = stream.tell(), 0, False
        for entry, end in _entries(stream):
            size = end
            is_closed = entry.source == MARK and entry.body == END
            entries += entry.source != MARK
    return JournalHead(found["link"], Path(found["path"]), found["started"], size, entries, is_closed)


def journal_file(path: str | os.PathLike[str]) -> Path:
    """The file of a journal by its path, or by that of the directory that holds it."""
    place = Path(path)
    return place / NAME if place.is_dir() else place


def _opened(path: Path) -> Any:
    try:
        return open(path, "rb")
    except OSError as error:
        raise InputError(f"{display_path(path)}: {os_error_reason(error)}; name the journal of a link") from None


def remove_ended(path: Path) -> None:
    """Remove a journal whose link has ended; for a flight that can be sent again. One that was cut off stays."""
    if path.is_file() and read_head(path).is_closed:
        path.unlink()


class Journal:
    """A journal that is written.

    path    : of the file; it is made where it does not exist, and gone on with where it was cut off
    link    : contents of the link file, as plain data
    place   : file that names in it are relative to
    fsync_s : time after which entries are forced to the disk [s]; 0 for each
    raises  : InputError where the file holds a flight that has ended, or cannot be written

    `is_resumed` is whether it was gone on with. `problem` is one line while the disk takes nothing, else "". `dropped`
    counts entries that did not fit in memory meanwhile. `close` it in the end.
    """

    def __init__(self, path: Path, link: Mapping[str, Any], place: Path, *, fsync_s: float = 1.0) -> None:
        self.path, self.problem, self.dropped = path, "", 0
        self._fsync_s = fsync_s
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        self._retry_at = 0.0
        self._lock = threading.Lock()
        self._ended = threading.Event()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._held = FileLock(path.with_suffix(".lock"))
            self._held.acquire(timeout=0)
            resumed = path.is_file() and path.stat().st_size > 0
            if resumed:
                self._size = self._whole_size(path)
                self._file = os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0))
                os.ftruncate(self._file, self._size)
            else:
                self._file = self._made(path, link, place)
        except Timeout:
            rule = "another link writes it; end that one, or name another directory"
            raise InputError(f"{display_path(path)}: {rule}") from None
        except OSError as error:
            self._held.release()
            raise InputError(f"{display_path(path)}: {os_error_reason(error)}; name another directory") from None
        except InputError:
            self._held.release()
            raise
        self.is_resumed = resumed
        os.lseek(self._file, 0, os.SEEK_END)
        self._synced = self._size
        self._thread = threading.Thread(target=self._keep_synced, name="journal", daemon=True)
        if fsync_s > 0.0:
            self._thread.start()

    def _whole_size(self, path: Path) -> int:
        head = read_head(path)
        if head.is_closed:
            raise InputError(
                f"{display_path(path)}: holds a flight that has ended; make a record of it with --to-record, and name "
                "another directory for this one"
            )
        return head.size

    def _made(self, path: Path, link: Mapping[str, Any], place: Path) -> int:
        """A new file with its header, whole or not at all."""
        head = {"format": FORMAT, "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())}
        data = json.dumps(head | {"path": str(place.absolute()), "link": link}).encode() + b"\n"
        temporary = path.with_name(f".{path.name}.new")
        temporary.write_bytes(data)
        make_durable(temporary)
        os.replace(temporary, path)
        make_durable(path.parent)
        self._size = len(data)
        return os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0))

    def append(self, body: bytes, source: int = 0, arrived_ns: int | None = None) -> None:
        """Append a body; it is with the operating system when this returns, or waits where the disk takes nothing."""
        entry = Entry(time.time_ns() if arrived_ns is None else arrived_ns, source, body)
        self._waiting.append(data := _encoded(entry))
        self._waiting_bytes += len(data)
        while self._waiting_bytes > KEPT:
            self._waiting_bytes -= len(self._waiting.popleft())
            self.dropped += 1
        if not self.problem or time.monotonic() >= self._retry_at:
            self._write()

    def _write(self) -> None:
        """Write what waits, entry by entry; on a full disk no part of an entry is left behind."""
        with self._lock:
            while self._waiting:
                data = self._waiting[0]
                try:
                    written = os.write(self._file, data)
                    if written < len(data):
                        written += os.write(self._file, data[written:])
                    if written < len(data):
                        raise OSError(28, "No space left on device")
                except OSError as error:
                    self._refused(error)
                    return
                self._size += len(data)
                self._waiting.popleft()
                self._waiting_bytes -= len(data)
            self.problem = ""
        if self._fsync_s == 0.0:
            self._sync()

    def _refused(self, error: OSError) -> None:
        count = f"{len(self._waiting)} " if len(self._waiting) > 1 else ""
        self.problem = f"journal {display_path(self.path)}: {os_error_reason(error)}; {count}messages wait in memory"
        self._retry_at = time.monotonic() + RETRY_S
        try:
            os.ftruncate(self._file, self._size)
            os.lseek(self._file, self._size, os.SEEK_SET)
        except OSError:  # the next attempt begins at the same place
            return

    def _sync(self) -> None:
        try:
            if self._size > self._synced:
                size = self._size
                os.fsync(self._file)
                self._synced = size
        except OSError as error:
            self.problem = f"journal {display_path(self.path)}: {os_error_reason(error)}"

    def _keep_synced(self) -> None:
        while not self._ended.wait(self._fsync_s):
            self._sync()

    def close(self, *, is_end: bool) -> None:
        """Write what waits and close the file.

        is_end : whether the flight has ended; a journal without that mark is gone on with
        """
        if self._ended.is_set():
            return
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()
        if is_end:
            self._waiting.append(_encoded(Entry(time.time_ns(), MARK, END)))
        self._write()
        self._sync()
        os.close(self._file)
        self._held.release()
