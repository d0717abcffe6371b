"""Several files of a directory replaced together, by one process at a time, also where a process is killed.

New files are written below `.sim_heating.partial/new`. A journal beside them, written whole, is the moment of decision:
a replacement without a journal never happened, and one with a journal is finished by whoever comes next. Files that are
replaced move to `.sim_heating.partial/old` and are removed last. `settle` finishes, undoes or clears what a killed
process left; everything that reads a file calls it first (`text.read_text`).

A lock file, `.sim_heating.lock`, admits one writer at a time. The system frees it when its owner dies.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from sim_heating.base.errors import InputError
from sim_heating.base.files.paths import display_path, file_digest, has_digest, make_durable, os_error_reason, real_path

if TYPE_CHECKING:
    from filelock import BaseFileLock

LOCK, STAGING = ".sim_heating.lock", ".sim_heating.partial"
NEW, OLD, JOURNAL = "new", "old", "journal.json"
FORMAT = "sim_heating-journal/1"
FINISH, UNDO = "finish", "undo"
WRITER_WAIT_S, READER_WAIT_S = 2.0, 10.0
"""Longest wait of a writer for another one, and of a reader for a replacement in progress [s]."""
DEPTH = 3
"""Directories above a file that may hold the journal of its replacement: results and vehicles are no deeper."""

_thread = threading.local()


def _held() -> set[Path]:
    """Directories that this thread has locked."""
    if not hasattr(_thread, "held"):
        _thread.held = set()
    locked: set[Path] = _thread.held
    return locked


@contextmanager
def exclusive(
    directory: str | os.PathLike[str], *, wait_s: float = WRITER_WAIT_S, waiting: Callable[[], None] | None = None
) -> Iterator[Path]:
    """Keep other processes of this program from writing to a directory; what a killed one left is settled first.

    A missing directory is created, and removed again where nothing was written into it. The lock may be taken again by
    the thread that holds it.

    wait_s  : longest wait for another process [s]
    waiting : called where another process has to be waited for
    returns : the directory, symbolic links resolved
    raises  : InputError where another process keeps the lock, or the directory cannot be created or written
    """
    target = real_path(directory)
    if target in _held():
        yield target
        return
    lock, created = _acquire(target, display_path(directory), wait_s, waiting)
    _held().add(target)
    try:
        _settle_locked(target)
        yield target
    finally:
        _held().discard(target)
        # Removed while it is locked: whoever waits for the removed file sees that it has no name any more and retries.
        with suppress(OSError):
            (target / LOCK).unlink()
        lock.release()
        _remove_empty(created)


def require_exclusive(directory: str | os.PathLike[str]) -> None:
    """Check before any work that a directory can be written and that nobody else does; raises as `exclusive`."""
    with exclusive(directory):
        pass


def _take(lock: BaseFileLock, wait_s: float, waiting: Callable[[], None] | None) -> None:
    """Acquire a lock within a time [s]; where it is not free at once, tell so first."""
    from filelock import Timeout

    if waiting is not None:
        try:
            lock.acquire(timeout=0)
            return
        except Timeout:
            waiting()
    lock.acquire(timeout=wait_s)


def _acquire(
    target: Path, name: str, wait_s: float, waiting: Callable[[], None] | None
) -> tuple[BaseFileLock, list[Path]]:
    """The lock of a directory, and the directories created for it, innermost first."""
    from filelock import FileLock, Timeout

    created: list[Path] = []
    done = False
    try:
        while True:
            created += [p for p in (target, *target.parents) if not p.exists()]
            target.mkdir(parents=True, exist_ok=True)
            lock = FileLock(target / LOCK)
            try:
                os.close(os.open(target / LOCK, os.O_RDWR | os.O_CREAT, 0o666))
            except FileNotFoundError:  # its owner removed the directory, as nothing was written into it
                if target.exists():
                    raise
                continue
            with contextlib.suppress(FileNotFoundError):
                _take(lock, wait_s, waiting)
                done = True
                return lock, created
    except Timeout:
        raise InputError(
            f"{name}: another sim-heating process is writing there; wait until it ends, or choose another directory"
        ) from None
    except FileExistsError:
        raise InputError(f"{name}: is a file; name a directory for the results") from None
    except OSError as error:
        raise InputError(
            f"{name}: results cannot be written ({os_error_reason(error)}); choose another place"
        ) from None
    finally:
        if not done:
            _remove_empty(created)


def _remove_empty(directories: Iterable[Path]) -> None:
    """Remove directories, innermost first, as far as they are empty."""
    with suppress(OSError):
        for directory in directories:
            directory.rmdir()


@contextmanager
def staged(target: Path) -> Iterator[Path]:
    """An empty directory for new files of a locked directory, removed at the end of the block.

    target : as `exclusive` returns it
    """
    staging = target / STAGING
    try:
        (staging / NEW).mkdir(parents=True)
        yield staging / NEW
    finally:
        if not (staging / JOURNAL).exists():
            shutil.rmtree(staging, ignore_errors=True)


def commit(target: Path, old: Mapping[str, str]) -> None:
    """Move the staged files into place, and files that they replace or that are to go out of it; all or none.

    old    : name within the directory -> digest of each file to be replaced or removed
    raises : InputError, nothing changed, where a file is in the way that is not among these, or has another digest
    """
    new = {name: file_digest(target / STAGING / NEW / name) for name in files_below(target / STAGING / NEW)}
    for name in {*new, *old}:
        require_plain(target, name)
        expected = old.get(name)
        if os.path.lexists(target / name) and (expected is None or not has_digest(target / name, expected)):
            raise _in_the_way(target, name)
    for path in sorted((target / STAGING / NEW).rglob("*"), reverse=True):
        make_durable(path)
    make_durable(target / STAGING / NEW)
    _write_journal(target, FINISH, new, old)
    try:
        _finish(target, new, old)
    except BaseException:
        _write_journal(target, UNDO, new, old)
        _undo(target, new)
        raise


def replace_files(
    directory: str | os.PathLike[str], new: Mapping[str, str | bytes], removed: Iterable[str] = ()
) -> None:
    """Write, replace and remove files of a directory together: all or none, also where the program is killed.

    new     : name within the directory, with `/` -> contents; text is written as UTF-8
    removed : names of files to remove; those missing are passed over
    raises  : InputError where another process writes there, a name leaves the directory, or leads through a symbolic
              link
    """
    with exclusive(directory) as target:
        for name in (*new, *removed):
            require_plain(target, name)
        with staged(target) as staging:
            for name, contents in new.items():
                (staging / name).parent.mkdir(parents=True, exist_ok=True)
                (staging / name).write_bytes(contents.encode("utf-8") if isinstance(contents, str) else contents)
            replaced = [name for name in {*new, *removed} if (target / name).is_file()]
            commit(target, {name: file_digest(target / name) for name in replaced})


def files_below(directory: Path) -> list[str]:
    """Names of all files below a directory, relative to it, with `/`."""
    return sorted(p.relative_to(directory).as_posix() for p in directory.rglob("*") if not p.is_dir() or p.is_symlink())


def require_plain(target: Path, name: str) -> None:
    """Check that a file of this name can be written.

    raises : InputError where the name leaves the directory, a symbolic link stands on the way to the file, or a file
             stands where a folder is needed
    """
    parts = PurePosixPath(name).parts
    if not parts or ".." in parts or PurePosixPath(name).is_absolute() or set("\\\0") & set(name):
        raise InputError(f"{display_path(target)}: `{name}` is not the name of a file in it; nothing was changed")
    path = target
    for number, segment in enumerate(parts, start=1):
        where = Path(display_path(path)) / segment  # of a link itself, not of what it leads to
        path /= segment
        if path.is_symlink():
            raise InputError(
                f"{where}: is a symbolic link, which is not followed to replace a file; remove it or "
                "choose another directory"
            )
        if number < len(parts) and os.path.lexists(path) and not path.is_dir():
            raise InputError(f"{where}: is a file in the place of a folder; move it away or choose another directory")


# After a kill -------------------------------------------------------------------------------------------------------


def settle_above(path: str | os.PathLike[str]) -> None:
    """Settle the directories that a file is in, before it is read.

    raises : InputError where a replacement in progress does not end, or an interrupted one cannot be finished
    """
    parents = Path(path).absolute().parents
    for directory in parents[:DEPTH]:
        if directory.name == STAGING or STAGING in directory.parts:
            return
        if os.path.lexists(directory / STAGING):
            settle(directory)


def settle(directory: str | os.PathLike[str]) -> None:
    """Finish or undo the replacement of files that a killed process began in a directory, and clear what it left.

    raises : InputError where a replacement in progress does not end, or an interrupted one cannot be finished
    """
    target = real_path(directory)
    if target in _held() or not os.path.lexists(target / STAGING):
        return
    in_progress = (target / STAGING / JOURNAL).exists()
    try:
        with exclusive(target, wait_s=READER_WAIT_S if in_progress else 0.0):
            pass
    except InputError:
        # Without a journal its files are whole: those of the results before, while others are being made.
        if (target / STAGING / JOURNAL).exists():
            raise


def settle_below(directory: str | os.PathLike[str]) -> None:
    """Settle all directories below one, where processes that wrote into them have been ended."""
    unsettled = {path.parent for name in (LOCK, STAGING) for path in Path(directory).rglob(name)}
    for folder in sorted(unsettled):
        with suppress(InputError), exclusive(folder, wait_s=0.0):  # refused where another process is at work
            pass


def _settle_locked(target: Path) -> None:
    staging = target / STAGING
    if not os.path.lexists(staging):
        return
    if not (staging / JOURNAL).exists():
        shutil.rmtree(staging, ignore_errors=True)
        return
    state, new, old = _read_journal(target)
    for name in {*new, *old}:
        require_plain(target, name)
    if state == FINISH:
        _finish(target, new, old)
    else:
        _undo(target, new)


def _write_journal(target: Path, state: str, new: Mapping[str, str], old: Mapping[str, str]) -> None:
    staging = target / STAGING
    partial = staging / f"{JOURNAL}.partial"
    data = {"format": FORMAT, "state": state, "new": dict(new), "old": dict(old)}
    partial.write_text(json.dumps(data), encoding="utf-8")
    make_durable(partial)
    os.replace(partial, staging / JOURNAL)
    make_durable(staging)
    make_durable(target)


def _read_journal(target: Path) -> tuple[str, dict[str, str], dict[str, str]]:
    path = target / STAGING / JOURNAL
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        state, new, old = data["state"], data["new"], data["old"]
        for files in (new, old):
            if not all(isinstance(text, str) for item in files.items() for text in item):
                raise TypeError
        if state not in (FINISH, UNDO) or data["format"] != FORMAT:
            raise ValueError
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise InputError(
            f"{display_path(path)}: is damaged, so that an interrupted replacement of files cannot be finished; move "
            f"the files in {display_path(path.parent)} to where they belong and remove it"
        ) from None
    return state, new, old


def _finish(target: Path, new: dict[str, str], old: Mapping[str, str]) -> None:
    """Carry out what the journal says; steps that were done before are passed over."""
    staging = target / STAGING
    for name, digest in old.items():
        has_come = name in new and not (staging / NEW / name).exists()
        if not (has_come or (staging / OLD / name).exists()):
            _move_out(target, name, digest)
    for name in reversed(new):  # the list of results, whose name begins with a dot, comes last
        if (staging / NEW / name).exists():
            if os.path.lexists(target / name):
                raise _in_the_way(target, name)
            _move(staging / NEW / name, target / name)
    folders = {(target / name).parent for name in new} | {target}
    for folder in folders:
        make_durable(folder)
    _discard(target, old)


def _move_out(target: Path, name: str, digest: str) -> None:
    """Move a file that is replaced to the old ones, where it is there; it has to have its digest."""
    if os.path.lexists(target / name):
        if not has_digest(target / name, digest):
            raise _in_the_way(target, name)
        _move(target / name, target / STAGING / OLD / name)


def _undo(target: Path, new: Mapping[str, str]) -> None:
    """Put everything back to where it was before `_finish`."""
    staging = target / STAGING
    for name, digest in new.items():
        arrived = not (staging / NEW / name).exists()
        if arrived and has_digest(target / name, digest):
            _move(target / name, staging / NEW / name)
    for name in files_below(staging / OLD):
        if os.path.lexists(target / name):
            raise _in_the_way(target, name)
        _move(staging / OLD / name, target / name)
    _discard(target, new)


def _in_the_way(target: Path, name: str) -> InputError:
    return InputError(
        f"{display_path(target / name)}: already exists and was not written by sim-heating, or was changed since; move "
        "it away or choose another directory"
    )


def _discard(target: Path, names: Iterable[str]) -> None:
    """Remove the journal, then the staging directory, and directories of files that are gone, where empty."""
    (target / STAGING / JOURNAL).unlink()
    shutil.rmtree(target / STAGING)
    folders = {folder for name in names for folder in (target / name).parents if target in folder.parents}
    for folder in sorted(folders, key=lambda p: len(p.parts), reverse=True):
        with suppress(OSError):
            folder.rmdir()


def _move(old: Path, new: Path) -> None:
    new.parent.mkdir(parents=True, exist_ok=True)
    os.replace(old, new)
