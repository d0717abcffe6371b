"""Paths in messages, reasons of failed file operations, and digests of files."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path


def display_path(path: str | os.PathLike[str]) -> str:
    """A path for a message: relative where it lies below the working directory, else as given."""
    try:
        return str(real_path(path).relative_to(Path.cwd()))
    except (ValueError, OSError):
        return str(path)


def real_path(path: str | os.PathLike[str]) -> Path:
    """The absolute path with symbolic links followed, as far as they lead; `Path.resolve` fails on a loop of them."""
    return Path(os.path.realpath(path))


def os_error_reason(error: Exception) -> str:
    """Reason of a failed file operation, as the operating system words it."""
    return getattr(error, "strerror", None) or str(error)


DEVICES = frozenset(
    ("con", "prn", "aux", "nul", "conin$", "conout$", *(f"{port}{k}" for port in ("com", "lpt") for k in range(10)))
)
"""Names of devices, which no file of Windows can have, with any extension and in any case (Microsoft, Naming Files)."""
LONGEST_NAME = 200
"""Most bytes of a name; systems hold 255, of which names of partial files and extensions take some."""


def portable_problem(name: str) -> str | None:
    """Why a file or folder of this name cannot be on every system, in the words of a message; None where it can.

    name : without folders
    """
    if name.partition(".")[0].rstrip(" ").lower() in DEVICES:
        return "is the name of a device on Windows, where no file can have it; choose another name"
    if name.endswith((" ", ".")) and name not in (".", ".."):
        return "ends in a blank or a dot, which Windows drops; choose another name"
    if (size := len(os.fsencode(name))) > LONGEST_NAME:
        return f"has {size} bytes; give a name of at most {LONGEST_NAME}"
    return None


def umask() -> int:
    """File mode mask of the process, which can only be read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def file_digest(path: str | os.PathLike[str]) -> str:
    """`sha256:...` of a file's bytes."""
    with open(path, "rb") as stream:
        return f"sha256:{hashlib.file_digest(stream, 'sha256').hexdigest()}"


def has_digest(path: str | os.PathLike[str], digest: str) -> bool:
    """Whether a path is a file of this digest."""
    return os.path.isfile(path) and file_digest(path) == digest


def bytes_digest(data: bytes) -> str:
    """`sha256:...` of bytes."""
    return f"sha256:{hashlib.sha256(data).hexdigest()}"


def text_digest(text: str) -> str:
    """`sha256:...` of a text as UTF-8."""
    return bytes_digest(text.encode())


def make_durable(path: str | os.PathLike[str]) -> None:
    """Have the system write a file, or the names in a directory, to its storage before this returns.

    raises : OSError that names the file, where the storage is full or fails
    """
    try:
        handle = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)  # Windows flushes what it may write
    except PermissionError:
        if os.path.isdir(path):  # Windows opens no directories
            return
        raise
    try:
        os.fsync(handle)
    except OSError as error:
        raise OSError(error.errno, error.strerror, os.fspath(path)) from None
    finally:
        os.close(handle)
