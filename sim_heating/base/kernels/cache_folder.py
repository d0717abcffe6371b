"""Folder of the compiled kernels: one for each state of the sources that kernels are made of."""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import numba

PACKAGE = Path(__file__).resolve().parents[2]
KERNEL_FOLDERS = ("base", "heating", "thermal", "trajectory", "march", "inputs", "simulation", "estimation", "planning")
"""Folders of the package with kernels, and with all that these are made of."""
CACHE_AGE_S = 14 * 86400.0
"""Age [s] at which unused caches of other versions of the package are removed."""
KERNELS = "kernels-"
"""Beginning of the name of a folder of kernels."""


def source_digest(package: Path = PACKAGE) -> str:
    """Digest of all sources and data files of the folders with kernels, and of the version of numba.

    package : folder of the package
    returns : 16 hexadecimal digits, of which the name of the cache folder is made

    numba keys its cache by the file of a function alone: a kernel that calls another one, or has a table as a constant,
    would keep its old code after a change in the other file.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    files = (path for folder in KERNEL_FOLDERS for path in (package / folder).rglob("*"))
    for path in sorted(path for path in files if path.suffix in (".py", ".csv") and path.is_file()):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def cache_folder() -> str:
    """A writable folder for the compiled kernels of this version only: in the user's cache, else temporary."""
    for candidate in (_user_cache, _temporary_cache):
        try:
            home = candidate()
            if home is None:
                continue
            home.mkdir(parents=True, exist_ok=True)
            folder = home / f"{KERNELS}{source_digest()}"
            folder.mkdir(exist_ok=True)
            # Writing is tried: permissions alone do not show a full or read-only file system.
            with tempfile.TemporaryFile(dir=folder):
                folder.touch()
            _remove_old(home)
            return str(folder)
        except OSError:
            continue
    return tempfile.mkdtemp(prefix="sim_heating_kernels_")


def _remove_old(home: Path) -> None:
    """Remove what has not been used for long; another process may do so at the same time."""
    for other in home.iterdir():
        with suppress(OSError):
            if other.name.startswith(KERNELS) and time.time() - other.stat().st_mtime > CACHE_AGE_S:
                shutil.rmtree(other, ignore_errors=True)


def _user_cache() -> Path | None:
    """The user's cache; None for a user without a home, as in a container."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "sim_heating"
    except RuntimeError:
        return None


def _temporary_cache() -> Path | None:
    """A temporary folder that later processes of this user find again; None where others could write to it."""
    if not hasattr(os, "getuid"):
        return None
    folder = Path(tempfile.gettempdir()) / f"sim_heating-{os.getuid()}"
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    state = folder.lstat()
    is_private = stat.S_ISDIR(state.st_mode) and state.st_uid == os.getuid() and not state.st_mode & 0o077
    return folder if is_private else None
