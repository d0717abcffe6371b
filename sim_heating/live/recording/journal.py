"""The journal of a link: every body that came, in the order in which it came, appended to one file.

    header     one line of JSON: format, the link as it was declared, what its messages mean, the time of the start
    entry      length (4 bytes), CRC-32 (4 bytes), arrival [ns] (8 bytes), source (2 bytes), body

All numbers are little-endian; the CRC is over what follows it. An entry of source 0xFFFF is a mark of the link itself:
`end` closes the journal, `head` and a line of JSON repeats its header, behind the header, every MiB and at the end.

Each entry is given to the operating system as it comes, so that a link that is killed loses none. It is forced to the
disk every `fsync_s` seconds by a thread of its own, so that a machine that loses power loses at most that much. Where
the disk is full, entries wait in memory and are written in order when there is room again.

Where an entry is damaged or cut off, reading goes on at the next place where length, source and CRC are those of an
entry, and what lies between is reported (`Skipped`). A link that goes on from a damaged journal keeps the damaged file
aside and goes on in one of the sound entries.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import threading
import time
import zlib
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from struct import Struct
from typing import Any, BinaryIO

import numpy as np
from filelock import FileLock, Timeout

from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path
from sim_heating.base.files.paths import make_durable, os_error_reason
from sim_heating.base.files.results import DIGEST, digest_matches, with_digest
from sim_heating.live.recording.same_link import differences
from sim_heating.live.types import too_long

FORMAT = "live-journal/1"
NAME = "journal.bin"
"""Name of the file in the directory of a link."""
HEAD = Struct("<II")
BODY = Struct("<qH")
MARK = 0xFFFF
END, HEADER = b"end", b"head"
HEADER_EVERY = 1 << 20
"""Bytes of entries after which the header is repeated."""
LONGEST_READ = 1 << 29
"""Bytes of an entry in a row of sound ones: earlier versions wrote longer bodies."""
MOST_SOURCES = 256
"""Sources that an entry behind damage may be of."""
WINDOW = 1 << 20
"""Bytes that are searched at a time for the next sound entry."""
MOST_TOLD = 10
"""Damaged stretches that are reported one by one."""
KEPT = 1 << 28
"""Bytes that wait in memory while the disk is full; beyond, the oldest that wait are dropped, and counted."""
RETRY_S = 1.0
"""Time between attempts to write on a full disk [s]."""
SPARE = 24
"""File descriptors that a journal holds for the end of its link: what is written then needs some."""


@dataclass(frozen=True, slots=True)
class Entry:
    """A body as it came: arrival on the clock of that machine [ns], number of its source, bytes."""

    arrived_ns: int
    source: int
    body: bytes


@dataclass(frozen=True, slots=True)
class Skipped:
    """A stretch of a journal that holds no sound entry.

    begin, end : its bytes;  behind : number of messages before it;  messages : in it, None where that cannot be known
    is_last    : whether the file ends with it, as where the last message was cut off
    """

    begin: int
    end: int
    behind: int
    messages: int | None
    is_last: bool

    @property
    def text(self) -> str:
        """What was skipped, and where."""
        count = self.end - self.begin
        many = "" if self.messages is None else f"{self.messages} message{'s' * (self.messages != 1)} of "
        if self.is_last:
            many = many or "a part of a message, "
            return f"ends in {many}{count} bytes, cut off or damaged, behind message {self.behind}"
        if self.behind == 0 and self.begin == 0:
            return f"{count} bytes from its header on are damaged; a copy of the header is used"
        return f"{many}{count} bytes from byte {self.begin} on, behind message {self.behind}, are damaged and skipped"


@dataclass(frozen=True)
class JournalHead:
    """What a journal begins with, and whether it was closed.

    link    : contents of the link file, as plain data
    path    : file that names in it are relative to
    started : date and time of the start, ISO 8601
    means   : what messages of the link mean (`same_link.meaning`); None in a journal of an earlier version
    sent_again : what was sent again, as "record /path"; "" for a flight that cannot be flown again
    size    : bytes up to the end of the last whole entry
    entries : number of whole entries, marks excluded
    skipped : stretches that hold no sound entry
    is_closed : whether the link ended by itself
    """

    link: Mapping[str, Any]
    path: Path
    started: str
    means: Mapping[str, Any] | None
    sent_again: str
    size: int
    entries: int
    skipped: tuple[Skipped, ...]
    is_closed: bool


def _encoded(entry: Entry) -> bytes:
    content = BODY.pack(entry.arrived_ns, entry.source) + entry.body
    return HEAD.pack(len(content), zlib.crc32(content)) + content


# Reading -------------------------------------------------------------------------------------------------------------


def _entry_at(stream: BinaryIO, offset: int, size: int) -> tuple[Entry, int] | None:
    """The sound entry at an offset of a file of a size [bytes], and where it ends; None where there is none."""
    stream.seek(offset)
    head = stream.read(HEAD.size)
    if len(head) < HEAD.size:
        return None
    length, crc = HEAD.unpack(head)
    end = offset + HEAD.size + length
    if not BODY.size <= length <= LONGEST_READ or end > size:
        return None
    content = stream.read(length)
    if len(content) < length or zlib.crc32(content) != crc:
        return None
    arrived, source = BODY.unpack_from(content)
    return Entry(arrived, source, content[BODY.size :]), end


def _next_sound(stream: BinaryIO, begin: int, size: int) -> int:
    """The first place from `begin` on with a sound entry, or else the end of the file."""
    least = HEAD.size + BODY.size
    for start in range(begin, size, WINDOW):
        stream.seek(start)
        data = np.frombuffer(stream.read(WINDOW + least - 1), np.uint8).astype(np.uint32)
        count = len(data) - least + 1
        if count <= 0:
            break
        length = sum(data[k : k + count] << np.uint32(8 * k) for k in range(4))
        source = data[least - 2 : least - 2 + count] | data[least - 1 : least - 1 + count] << np.uint32(8)
        fits = (length >= BODY.size) & (length <= min(LONGEST_READ, size))
        for k in np.flatnonzero(fits & ((source < MOST_SOURCES) | (source == MARK))).tolist():
            if _entry_at(stream, start + k, size) is not None:
                return start + k
    return size


def _messages_between(stream: BinaryIO, begin: int, end: int) -> int | None:
    """Number of entries whose lengths lead from one place to another one; None where they do not."""
    count, offset = 0, begin
    while offset < end:
        stream.seek(offset)
        head = stream.read(HEAD.size)
        if len(head) < HEAD.size or (length := HEAD.unpack(head)[0]) < BODY.size:
            return None
        offset, count = offset + HEAD.size + length, count + 1
    return count if offset == end else None


def _pieces(stream: BinaryIO, offset: int) -> Iterator[Entry | Skipped]:
    """Sound entries, and the stretches between them, from an offset to the end that the file has now."""
    size, messages = os.fstat(stream.fileno()).st_size, 0
    while offset < size:
        sound = _entry_at(stream, offset, size)
        if sound is None:
            end = _next_sound(stream, offset, size)
            yield Skipped(offset, end, messages, _messages_between(stream, offset, end), end == size)
            offset = end
            continue
        entry, offset = sound
        messages += entry.source != MARK
        yield entry


def _header(path: Path, stream: BinaryIO) -> tuple[Mapping[str, Any] | None, int]:
    """The header of a journal, or else the first sound copy, and where the entries begin; None where none is sound.

    raises : InputError where the file is no journal: it holds neither a header nor an entry
    """
    stream.seek(0)
    line = stream.readline(WINDOW)
    header = _checked_header(line)
    if header is not None and line.endswith(b"\n"):
        return header, len(line)
    is_journal = False
    for piece in _pieces(stream, 0):
        if isinstance(piece, Entry):
            is_journal = True
            if piece.source == MARK and (header := _checked_header(piece.body.removeprefix(HEADER))) is not None:
                return header, 0
    if not is_journal:
        raise InputError(f"{display_path(path)}: is not a journal of a link ({FORMAT})")
    return None, 0


def _checked_header(line: bytes) -> Mapping[str, Any] | None:
    """A header as it was written; None where it is none, or was changed since."""
    try:
        header = json.loads(line)
    except ValueError:
        return None
    if not isinstance(header, dict) or header.get("format") != FORMAT or not {"link", "path", "started"} <= set(header):
        return None
    return header if DIGEST not in header or digest_matches(header) else None  # earlier versions wrote none


def read_journal(path: str | os.PathLike[str]) -> Iterator[Entry]:
    """The bodies of a journal in the order in which they came; damaged ones are left out (`read_head` tells them).

    path   : of the file, or of the directory that holds it
    raises : InputError where it cannot be read or is no journal
    """
    file = journal_file(path)
    with _opened(file) as stream:
        for piece in _pieces(stream, _header(file, stream)[1]):
            if isinstance(piece, Entry) and piece.source != MARK:
                yield piece


def read_head(path: str | os.PathLike[str]) -> JournalHead:
    """The header of a journal, and what it holds.

    raises : InputError where it is no journal, or neither its header nor a copy of it can be read
    """
    file = journal_file(path)
    entries, is_closed, skipped = 0, False, list[Skipped]()
    with _opened(file) as stream:
        header, begin = _header(file, stream)
        size = os.fstat(stream.fileno()).st_size
        if header is None:
            raise InputError(
                f"{display_path(file)}: its header is damaged, and no copy of it can be read; its messages can: make "
                "a record of them with --to-record, and name the LINK that wrote it"
            )
        for piece in _pieces(stream, begin):
            if isinstance(piece, Skipped):
                skipped.append(piece)
                size = piece.begin if piece.is_last else size
                continue
            is_closed = piece.source == MARK and piece.body == END
            entries += piece.source != MARK
    means, sent_again = header.get("means"), header.get("sent_again") or _replay_of(header["link"])
    path, started = Path(header["path"]), header["started"]
    return JournalHead(header["link"], path, started, means, sent_again, size, entries, tuple(skipped), is_closed)


def _replay_of(link: Mapping[str, Any]) -> str:
    """What a link of an earlier version sent again; "" where its flight was not sent again."""
    sources = link.get("source") or []
    if len(sources) == 1 and sources[0].get("kind") == "replay" and Path(sources[0].get("record") or "").is_absolute():
        return record_again(sources[0]["record"])
    return ""


def record_again(record: str | os.PathLike[str]) -> str:
    """How a journal names the record that was sent again by --replay."""
    return f"record {Path(record).absolute()}"


def damage_of(path: str | os.PathLike[str]) -> list[str]:
    """Lines on what cannot be read of a journal, its header among that; empty where all can."""
    file = journal_file(path)
    with _opened(file) as stream:
        skipped = [piece for piece in _pieces(stream, _header(file, stream)[1]) if isinstance(piece, Skipped)]
    return damage_lines(file, skipped)


def damage_lines(path: Path, skipped: Sequence[Skipped]) -> list[str]:
    """A line for each stretch that was skipped, and for those beyond the first ones together."""
    name, unlisted = display_path(path), skipped[MOST_TOLD:]
    lines = [f"{name}: {piece.text}" for piece in skipped[:MOST_TOLD]]
    if unlisted:
        lines.append(
            f"{name}: {len(unlisted)} more stretches of {sum(p.end - p.begin for p in unlisted)} bytes are skipped"
        )
    return lines


def journal_file(path: str | os.PathLike[str]) -> Path:
    """The file of a journal by its path, or by that of the directory that holds it."""
    file = Path(path)
    return file / NAME if file.is_dir() else file


def _opened(path: Path) -> BinaryIO:
    try:
        return open(path, "rb")
    except OSError as error:
        raise InputError(f"{display_path(path)}: {os_error_reason(error)}; name the journal of a link") from None


def require_usable(
    path: Path,
    link: Mapping[str, Any],
    means: Mapping[str, Any] | None = None,
    sent_again: str = "",
    has_results: bool = True,
) -> None:
    """Check before any work that a link can write the journal at a path; changes nothing.

    link        : contents of the link file, as plain data;  means : what its messages mean (`same_link.meaning`)
    sent_again  : what the link sends again, as "record /path"; empty for nothing
    has_results : false where the flight that has ended has no results yet
    raises      : InputError where the file holds a flight that has ended, or one of another link
    """
    if not path.is_file() or path.stat().st_size == 0:
        return
    head = read_head(path)
    name, is_own_replay = display_path(path), "" != sent_again == head.sent_again
    if _is_empty(head) or (head.is_closed and is_own_replay):
        return
    if head.is_closed and has_results:
        raise InputError(
            f"{name}: holds a flight that has ended; make a record of it with --to-record, and name another directory "
            "for this one"
        )
    if sent_again != head.sent_again:
        flight = head.sent_again or "a flight"
        raise InputError(
            f"{name}: holds {flight} that was not ended; go on with the command that began it, or name another "
            "directory by --out"
        )
    _require_same_link(name, differences((head.link, head.means), (link, means)))


def _require_same_link(name: str, apart: Sequence[str]) -> None:
    if apart:
        shown = "; ".join(apart if len(apart) <= 4 else [*apart[:4], f"and {len(apart) - 4} more"])
        raise InputError(
            f"{name}: was begun with another link: {shown}. Go on with the link that began it, or name another "
            "directory by --out"
        )


def _is_empty(head: JournalHead) -> bool:
    """Whether nothing came, and nothing ended: such a journal is begun again."""
    return head.entries == 0 and not head.skipped and not head.is_closed


# Writing -------------------------------------------------------------------------------------------------------------


class _Waiting:
    """Encoded entries that wait for the disk.

    dropped : number of those that were given up
    """

    def __init__(self) -> None:
        self._entries: deque[bytes] = deque()
        self._bytes = self.dropped = 0

    @property
    def count(self) -> int:
        return len(self._entries)

    @property
    def first(self) -> bytes:
        return self._entries[0]

    def append(self, data: bytes) -> None:
        self._entries.append(data)
        self._bytes += len(data)

    def pop(self) -> None:
        self._bytes -= len(self._entries.popleft())

    def drop_beyond(self, most_bytes: int) -> None:
        """Give up the oldest entries, until no more bytes wait than that."""
        while self._bytes > most_bytes:
            self.pop()
            self.dropped += 1


class _OpenJournal:
    """The open file of a journal, to which whole entries are appended.

    size : bytes of whole entries
    """

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0))
        self._spare = [os.dup(self._file) for _ in range(SPARE)]
        self.size = self._synced = os.lseek(self._file, 0, os.SEEK_END)

    def append(self, data: bytes) -> None:
        """Write an entry; OSError where the disk does not take all of it."""
        written = os.write(self._file, data)
        if written < len(data):
            written += os.write(self._file, data[written:])
        if written < len(data):
            raise OSError(28, "No space left on device")
        self.size += len(data)

    def take_back(self) -> None:
        """Remove what was written of an entry that the disk did not take."""
        try:
            os.ftruncate(self._file, self.size)
            os.lseek(self._file, self.size, os.SEEK_SET)
        except OSError:  # the next attempt begins at the same place
            return

    def sync(self) -> None:
        """Force what was written to the disk."""
        if self.size > self._synced:
            size = self.size
            os.fsync(self._file)
            self._synced = size

    def close(self) -> None:
        for number in (self._file, *self._spare):
            os.close(number)


class Journal:
    """A journal that is written.

    path    : of the file; it is made where it does not exist, and gone on with where it was cut off
    link    : contents of the link file, as plain data
    link_path : file of the link, which names in it are relative to
    fsync_s : time after which entries are forced to the disk [s]; 0 for each
    means   : what the messages of the link mean (`same_link.meaning`), which a link that goes on has to agree with
    sent_again : what the link sends again, as "record /path"; a journal of the same that has ended is replaced
    has_results : false: the flight that has ended has no results yet, as where its process was killed while it wrote
                  them; its link goes on with it and writes them
    raises  : InputError where the file holds a flight that has ended, or one of another link, or cannot be written

    `is_resumed` is whether it was gone on with, and `notes` the lines on what of it could not be read. `problem` is one
    line while the disk takes nothing, else "". `dropped` counts entries that did not fit in memory meanwhile. `close`
    it in the end.
    """

    def __init__(
        self,
        path: Path,
        link: Mapping[str, Any],
        link_path: Path,
        *,
        fsync_s: float = 1.0,
        means: Mapping[str, Any] | None = None,
        sent_again: str = "",
        has_results: bool = True,
    ) -> None:
        self.path, self.problem = path, ""
        self.notes: list[str] = []
        self._fsync_s = fsync_s
        self._waiting = _Waiting()
        self._retry_at = 0.0
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._created = [p for p in (path.parent, *path.parent.parents) if not p.exists()]
        self._held = FileLock(path.with_suffix(".lock"))
        try:
            self._take_place()
            self._begin(link, link_path, means, sent_again, has_results)
        except KeyboardInterrupt:
            self._ended.set()
            with contextlib.suppress(InputError):
                if self._held.is_locked and _is_empty(read_head(path)):
                    path.unlink()
            self._release()
            raise

    def _take_place(self) -> None:
        """Make the folder, and lock it against other links."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._held.acquire(timeout=0)
        except Timeout:
            rule = "another link writes it; end that one, or name another directory"
            raise InputError(f"{display_path(self.path)}: {rule}") from None
        except OSError as error:
            raise InputError(f"{display_path(self.path)}: {os_error_reason(error)}; name another directory") from None

    def _begin(
        self,
        link: Mapping[str, Any],
        link_path: Path,
        means: Mapping[str, Any] | None,
        sent_again: str,
        has_results: bool,
    ) -> None:
        """Open the file, a new one or one that is gone on with, and keep it synced."""
        path = self.path
        try:
            require_usable(path, link, means, sent_again, has_results)
            if not has_results and path.is_file():
                open_again(path)
            self.is_resumed = self._goes_on(path, means)
            if not self.is_resumed:
                started = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
                head = {
                    "format": FORMAT,
                    "started": started,
                    "path": str(link_path.absolute()),
                    "sent_again": sent_again,
                }
                _write_whole(path, _line(with_digest({**head, "link": link, "means": means})))
            self._disk = _OpenJournal(path)
        except OSError as error:
            self._release()
            raise InputError(f"{display_path(path)}: {os_error_reason(error)}; name another directory") from None
        except InputError:
            self._release()
            raise
        with _opened(path) as stream:
            self._header = stream.readline()
        self._header_due = self._disk.size + HEADER_EVERY if self.is_resumed else 0
        self._thread = threading.Thread(target=self._keep_synced, name="journal", daemon=True)
        if self._fsync_s > 0.0:
            self._thread.start()

    def _goes_on(self, path: Path, means: Mapping[str, Any] | None) -> bool:
        """Whether there is a flight to go on with, whose damage is set aside; an ended one is to be replaced."""
        if not path.is_file() or path.stat().st_size == 0:
            return False
        head = read_head(path)
        if head.is_closed or _is_empty(head):
            return False
        if head.means is None and means is not None:
            self.notes.append(
                f"{display_path(path)}: is of an earlier version, which kept the link file alone; whether its vehicle "
                "or records have changed since is not known"
            )
        if head.skipped:
            aside = _set_aside(path)
            self.notes += [*damage_lines(path, head.skipped), f"the damaged journal is kept as {display_path(aside)}"]
        return True

    def append(self, body: bytes, source: int = 0, arrived_ns: int | None = None) -> None:
        """Append a body; it is with the operating system when this returns, or waits where the disk takes nothing.

        raises : InputError for a body that could not be read back
        """
        if (problem := too_long(body)) is not None:
            raise InputError(problem)
        entry = Entry(time.time_ns() if arrived_ns is None else arrived_ns, source, body)
        if self._disk.size >= self._header_due:
            self._repeat_header()
        with self._lock:
            self._waiting.append(_encoded(entry))
            self._waiting.drop_beyond(KEPT)
        if not self.problem or time.monotonic() >= self._retry_at:
            self._write()

    @property
    def dropped(self) -> int:
        """Number of entries that did not fit in memory while the disk took nothing."""
        return self._waiting.dropped

    def _repeat_header(self) -> None:
        with self._lock:
            self._waiting.append(_encoded(Entry(time.time_ns(), MARK, HEADER + self._header)))
        self._header_due = self._disk.size + HEADER_EVERY

    def _write(self) -> None:
        """Write what waits, entry by entry; on a full disk no part of an entry is left behind."""
        with self._lock:
            while self._waiting.count:
                try:
                    self._disk.append(self._waiting.first)
                except OSError as error:
                    self._refused(error)
                    return
                self._waiting.pop()
            self.problem = ""
        if self._fsync_s == 0.0:
            self._sync()

    def _refused(self, error: OSError) -> None:
        count = f"{self._waiting.count} " if self._waiting.count > 1 else ""
        self.problem = f"journal {display_path(self.path)}: {os_error_reason(error)}; {count}messages wait in memory"
        self._retry_at = time.monotonic() + RETRY_S
        self._disk.take_back()

    def _sync(self) -> None:
        try:
            self._disk.sync()
        except OSError as error:
            self.problem = f"journal {display_path(self.path)}: {os_error_reason(error)}"

    def _keep_synced(self) -> None:
        while not self._ended.wait(self._fsync_s):
            if self.problem and time.monotonic() >= self._retry_at:
                self._write()  # no message may come for long: those that wait are kept once there is room
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
        missing = self._waiting.count
        if is_end:
            self._repeat_header()
            self._waiting.append(_encoded(Entry(time.time_ns(), MARK, END)))
        self._write()
        if self._waiting.count and missing:
            reason, count = self.problem.partition(";")[0], min(missing, self._waiting.count)
            self.problem = f"{reason}; the last {count} messages are not in it"
        self._sync()
        self._disk.close()
        if not self.is_resumed and not is_end and self._disk.size == len(self._header):
            self.path.unlink(missing_ok=True)  # the link was not begun
        self._release()

    def _release(self) -> None:
        """Free the lock, whose file is removed while it is held, as that of a directory is (base.files.transaction).

        Folders that were made for a journal that was not begun are empty, and are removed.
        """
        if self._held.is_locked:
            with contextlib.suppress(OSError):
                self.path.with_suffix(".lock").unlink()
            self._held.release()
        with contextlib.suppress(OSError):
            for folder in self._created:
                folder.rmdir()


def open_again(path: Path) -> None:
    """Take back the end of a journal, so that its link can be gone on with."""
    end = len(_encoded(Entry(0, MARK, END)))
    with _opened(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        last = _entry_at(stream, max(size - end, 0), size)
    if last is not None and (last[0].source, last[0].body) == (MARK, END):
        os.truncate(path, size - end)


def _line(header: Mapping[str, Any]) -> bytes:
    return json.dumps(header).encode() + b"\n"


def _write_whole(path: Path, header: bytes, entries: Iterable[bytes] = ()) -> None:
    """A journal in the place of the one that is there, whole or not at all."""
    temporary = path.with_name(f".{path.name}.new")
    try:
        with open(temporary, "wb") as stream:
            stream.write(header)
            stream.writelines(entries)
        make_durable(temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    make_durable(path.parent)


def _set_aside(path: Path) -> Path:
    """Keep a damaged journal under another name, and put its header and sound entries in its place; the other name."""
    numbers = (k for k in range(1, 10_000) if not os.path.lexists(_aside(path, k)))
    aside = _aside(path, next(numbers))
    try:
        os.link(path, aside)
    except OSError:  # a file system without links
        shutil.copyfile(path, aside)
    try:
        with _opened(path) as stream:
            header, begin = _header(path, stream)
            assert header is not None  # `read_head` has read it
            sound = (_encoded(piece) for piece in _pieces(stream, begin) if isinstance(piece, Entry))
            _write_whole(path, _line(header), sound)
    except OSError:  # what is there stays as it is
        with contextlib.suppress(OSError):
            aside.unlink()
        raise
    return aside


def _aside(path: Path, number: int) -> Path:
    return path.with_name(f"{path.stem}.damaged-{number}{path.suffix}")
