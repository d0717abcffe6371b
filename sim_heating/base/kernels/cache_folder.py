"""Folder of the compiled kernels: one for each state of the sources that kernels are made of."""

from __future__ import annotations

import ast
import hashlib
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import numba

PACKAGE = Path(__file__).resolve().parents[2]
CACHE_AGE_S = 14 * 86400.0
"""Age [s] at which unused caches of other versions of the package are removed."""
SETTLED_S = 2.0
"""Age [s] of the last change of a file from which on a further one has another time, whatever the file system."""
KERNELS, KNOWN = "kernels-", "sources-"
"""Beginnings of the names of a folder of kernels, and of a file with a digest of sources."""
DECORATORS = "base.kernels.jit"
"""Module that each module with a kernel imports."""

_DIGEST = re.compile("[0-9a-f]{16}")


def _modules(package: Path) -> dict[str, Path]:
    """File of each module and folder of a package, by its dotted name within it."""
    files = {path.relative_to(package).with_suffix("").parts: path for path in package.rglob("*.py") if path.is_file()}
    return {".".join(parts[:-1] if parts[-1] == "__init__" else parts): path for parts, path in files.items()}


def _imported(path: Path, modules: Mapping[str, Path]) -> set[Path]:
    """Modules of the package that a module imports, within functions too, by their absolute names."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.ImportFrom):
            names |= {f"{node.module}", *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    below = (name.removeprefix(f"{PACKAGE.name}.") for name in names if name.startswith(f"{PACKAGE.name}."))
    return {modules[name] for name in below if name in modules}


def kernel_sources(package: Path = PACKAGE) -> list[Path]:
    """All sources of the compiled kernels: modules that import the decorators, what those import, and data files.

    package : folder of the package
    returns : paths in their order

    A relative import would not be found. The public face of the package names everything, the compiler included, and
    defines no kernel: it is none of them.
    """
    modules = _modules(package)
    public, decorators = modules[""], DECORATORS.rpartition(".")[2].encode()
    # most modules do not name the module of the decorators, and parsing all takes two seconds
    named = [path for path in modules.values() if path != public and decorators in path.read_bytes()]
    waiting = [path for path in named if modules[DECORATORS] in _imported(path, modules)]
    sources: set[Path] = set()
    while waiting:
        path = waiting.pop()
        if path not in sources:
            sources.add(path)
            waiting += _imported(path, modules) - {public}
    return sorted([*sources, *(path for path in package.rglob("*.csv") if path.is_file())])


def source_digest(package: Path = PACKAGE) -> str:
    """Digest of all sources of the compiled kernels and of the version of numba.

    package : folder of the package
    returns : 16 hexadecimal digits, of which the name of the cache folder is made

    numba keys its cache by the file of a function alone: a kernel that calls another one, or has a table as a constant,
    would keep its old code after a change in the other file.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    for path in kernel_sources(package):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def file_states(package: Path = PACKAGE) -> str | None:
    """Digest of the states of all files that may be sources: names, sizes, times and numbers, without their content.

    package : folder of the package
    returns : 16 hexadecimal digits, others after any change of a file; None where a change could be missed: where a
              file was changed a moment ago, so that a second change could have the same time. On Windows, which tells
              no time of change, one in place that keeps the size and sets the time of writing back is missed
    """
    states, folders, newest_s = [numba.__version__.encode()], [os.fspath(package)], 0.0
    while folders:
        with os.scandir(folders.pop()) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    folders.append(entry.path)
                elif entry.name.endswith((".py", ".csv")):
                    with suppress(FileNotFoundError):  # a link to nothing, as editors leave
                        s = entry.stat()
                        state = f" {s.st_size} {s.st_mtime_ns} {s.st_ctime_ns} {s.st_ino} {s.st_dev}"
                        states.append(os.fsencode(entry.path) + state.encode())
                        newest_s = max(newest_s, s.st_ctime, s.st_mtime)
    return None if time.time() - newest_s < SETTLED_S else hashlib.sha256(b"\n".join(sorted(states))).hexdigest()[:16]


def known_digest(home: Path, package: Path = PACKAGE) -> str:
    """`source_digest` of a package, as it was found before for the same states of its files: all are read only once.

    home : folder where it is kept, in a file named after these states
    """
    states = file_states(package)
    if states is None:
        return source_digest(package)
    record = home / f"{KNOWN}{states}"
    with suppress(OSError, ValueError):
        kept = record.read_text(encoding="ascii")
        if _DIGEST.fullmatch(kept):
            return kept
    digest = source_digest(package)
    with suppress(OSError):
        record.write_text(digest, encoding="ascii")
    return digest


def cache_folder() -> str:
    """A writable folder for the compiled kernels of this version only: in the user's cache, else temporary."""
    for candidate in (_user_cache, _temporary_cache):
        try:
            home = candidate()
            if home is None:
                continue
            home.mkdir(parents=True, exist_ok=True)
            folder = home / f"{KERNELS}{known_digest(home)}"
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
            if other.name.startswith((KERNELS, KNOWN)) and time.time() - other.stat().st_mtime > CACHE_AGE_S:
                shutil.rmtree(other, ignore_errors=True) if other.is_dir() else other.unlink()


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
