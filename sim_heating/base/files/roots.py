"""Folders that a file may name other files in, so that a file from elsewhere does not open what its author chooses.

A file that names others reads from its own folder, the folder of its vehicle, the data of the package, and one root:
the folder that the user names (`--root`), by default the nearest folder above the file that holds `scenarios`, or the
working directory where there is none. Symbolic links are followed before a path is judged. What runs as code (an FMU)
comes from the file's own folder or from a root that the user names. Files of records and vehicles lie below their
directories.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated

from pydantic import AfterValidator

from sim_heating.base.errors import InputError
from sim_heating.base.files.package import data_folders
from sim_heating.base.files.paths import display_path, portable_problem, real_path
from sim_heating.base.files.text import abbreviated, raise_problems

DATA = ("aircraft_data", "scenarios")
"""Data folders of the package and of a checkout."""
MARK = "scenarios"
"""Folder whose parent is the root of the files below it."""
MOST_ENTRIES = 20_000
"""Files and folders below a vehicle's directory that are looked at for links."""


def path_below(rule: str) -> AfterValidator:
    """A validator of keys that name a file below a directory: no absolute path, no `..`, nothing that does not print.

    rule : what the message says of another name, after the name
    """

    def check(name: str) -> str:
        posix, windows = PurePosixPath(name), PureWindowsPath(name)
        absolute = posix.is_absolute() or windows.root or windows.drive
        if absolute or ".." in (*posix.parts, *windows.parts) or posix.name == "" or not name.isprintable():
            raise ValueError(f"`{name}` {rule}")
        for segment in posix.parts:
            if (problem := portable_problem(segment)) is not None:
                raise ValueError(f"{abbreviated(name)} {problem}")
        return name

    return AfterValidator(check)


def portable_name() -> AfterValidator:
    """A validator of names that files are named after: what another system cannot hold is refused."""

    def check(name: str) -> str:
        if (problem := portable_problem(name)) is not None:
            raise ValueError(f"{abbreviated(name)} {problem}")
        return name

    return AfterValidator(check)


FileOfFolder = Annotated[str, path_below("is not a file of this folder; name one in it")]
"""Type of a key that names a file of the folder of its own file."""


@dataclass(frozen=True)
class Roots:
    """Folders that a file may name others in.

    file    : the file that names others
    folders : resolved, without those that lie in another one
    code    : those of them that code may come from
    """

    file: Path
    folders: tuple[Path, ...]
    code: tuple[Path, ...]

    def named(self, name: str, key: str, folder: Path | None = None, *, code: bool = False) -> Path:
        """The path of a file or directory that a key names; whether it exists is not looked at.

        name   : as the key gives it
        key    : table and key, for messages, such as "[trajectory]: `file`"
        folder : that the name is relative to; the folder of `file` where None
        code   : whether it is to be run
        raises : InputError naming file, key and folders where the path leads elsewhere
        """
        path = (self.file.parent if folder is None else folder) / name
        raise_problems([f"{display_path(self.file)}, {key}: {line}" for line in self._problems(path, name, code)])
        return path

    def existing(self, name: str, key: str) -> Path:
        """The path of a file or directory that a key names and that is there.

        name, key : as in `named`
        raises    : InputError naming file and key where the path leads elsewhere, or nothing is there
        """
        path = self.named(name, key)
        if name.strip() in ("", "."):
            raise InputError(f"{display_path(self.file)}, {key}: names nothing; name a file")
        if not path.exists():
            raise InputError(f"{display_path(self.file)}, {key}: there is no {display_path(path)}")
        return path

    def check_link(self, path: Path) -> None:
        """Check that a path, links followed, lies in one of the folders.

        raises : InputError where it does not
        """
        raise_problems(self._link_problems(path))

    def check_links(self, folder: Path) -> None:
        """Check that every symbolic link below a folder leads into one of the folders.

        raises : InputError with one line a link that does not
        """
        lines: list[str] = []
        waiting, entered, count = [folder], set[str](), 0
        while waiting:
            current = waiting.pop()
            real = os.path.realpath(current)
            if real in entered:
                continue
            entered.add(real)
            for entry in _entries(current):
                count += 1
                if count > MOST_ENTRIES:
                    raise InputError(
                        f"{display_path(folder)}: holds more than {MOST_ENTRIES} files and folders, links followed; it "
                        "is to hold the vehicle alone"
                    )
                problems = self._link_problems(Path(entry.path)) if entry.is_symlink() else []
                lines += problems
                if not problems and os.path.isdir(entry.path):
                    waiting.append(Path(entry.path))
        raise_problems(lines)

    def _link_problems(self, path: Path) -> list[str]:
        return [f"{display_path(path)}: the link {line}" for line in self._problems(path, "", False)]

    def _problems(self, path: Path, name: str, code: bool) -> Iterator[str]:
        try:
            real = real_path(path)
        except (OSError, ValueError) as error:
            yield f"{abbreviated(name)} is not a path ({error})"
            return
        shown = f"{abbreviated(name)} " if name else ""
        if not _within(real, self.folders):
            allowed = ", ".join(map(str, self.folders))
            yield (
                f"{shown}leads to {real}, outside the folders that may be read from here ({allowed}); "
                "move it into one of them, or name its folder with --root"
            )
        elif code and not _within(real, self.code):
            yield (
                f"{shown}is code and is run from {', '.join(map(str, self.code))} alone; move it there, or name its "
                "folder with --root"
            )


def roots_of(
    file: str | os.PathLike[str],
    root: str | os.PathLike[str] | None = None,
    vehicle: str | os.PathLike[str] | None = None,
) -> Roots:
    """The folders that a file may name others in.

    root    : folder that the user names; None for the default
    vehicle : folder of the file's vehicle, where it has another one than the file's
    raises  : InputError where `root` is no directory
    """
    parent = real_path(Path(file).parent)
    named = () if root is None else (_given_root(root),)
    roots = (parent, *named) if named else (parent, *_default_root(parent))
    of_vehicle = () if vehicle is None else (real_path(Path(vehicle)),)
    data = (real_path(folder) for name in DATA for folder in data_folders(name) if folder.is_dir())
    return Roots(Path(file), _outermost((*roots, *of_vehicle, *data)), _outermost((parent, *named)))


def _given_root(root: str | os.PathLike[str]) -> Path:
    if not os.fspath(root) or not os.path.isdir(root):
        raise InputError(f"--root {os.fspath(root)}: is not a directory; name the folder that files may be read from")
    return real_path(Path(root))


def _default_root(parent: Path) -> tuple[Path, ...]:
    marked = next((folder for folder in (parent, *parent.parents) if os.path.isdir(folder / MARK)), None)
    if marked is not None:
        return (marked,)
    try:
        return (real_path(Path.cwd()),)
    except OSError:  # the working directory has been removed
        return ()


def _within(path: Path, folders: tuple[Path, ...]) -> bool:
    return any(path.is_relative_to(folder) for folder in folders)


def _outermost(folders: tuple[Path, ...]) -> tuple[Path, ...]:
    distinct = tuple(dict.fromkeys(folders))
    return tuple(f for f in distinct if not _within(f, tuple(other for other in distinct if other != f)))


def _entries(folder: Path) -> Iterator[os.DirEntry[str]]:
    """Entries of a folder in the order of their names; none where it cannot be read, which its reader reports."""
    try:
        with os.scandir(folder) as entries:
            yield from sorted(entries, key=lambda entry: entry.name)
    except OSError:
        return
