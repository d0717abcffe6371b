"""The archive of an FMU, checked by its table of contents alone before anything is unpacked.

Rejected are entries outside the archive's folder, links and devices, names that do not print, two entries for one file,
encrypted entries, and archives that would fill a disk. Names of all platforms are checked: an archive made elsewhere is
unpacked here.

Source: Modelica Association (2022), "Functional Mock-up Interface Specification 3.0".
"""

from __future__ import annotations

import stat
import zipfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import fmpy

from sim_heating.base.errors import InputError, error_context
from sim_heating.base.files import display_path
from sim_heating.base.files.paths import os_error_reason
from sim_heating.base.files.xml import LARGEST_BYTES, check_xml

DESCRIPTION = "modelDescription.xml"
BUILD_DESCRIPTION = "sources/buildDescription.xml"
MOST_ENTRIES = 50_000
LARGEST_UNPACKED = 4 * 2**30
"""Most bytes of all entries together."""
PACKED_WELL, LARGEST_RATIO = 256 * 2**20, 100
"""From this many unpacked bytes on an archive that is this many times smaller is a trap: tables shrink to a tenth."""
LONGEST_PART = 255
"""Most bytes of one part of a path; no usual file system takes more."""
MIB = 2**20


@dataclass(frozen=True)
class Archive:
    """A checked archive: the names of its files."""

    files: frozenset[str]

    def libraries(self) -> dict[str, list[str]]:
        """Names of the compiled libraries in each folder of `binaries`. Source: FMI 2.0.4, section 2.3."""
        by_platform: dict[str, list[str]] = {}
        for name in sorted(self.files):
            top, *rest = PurePosixPath(name).parts
            if top == "binaries" and len(rest) == 2 and PurePosixPath(name).suffix in (".so", ".dll", ".dylib"):
                by_platform.setdefault(rest[0], []).append(rest[1])
        return by_platform


def read_archive(path: Path) -> Archive:
    """The table of contents of an FMU, and its XML files checked for what would flood their reader.

    raises : InputError, one line, where it is not an FMU or must not be unpacked

    Source: FMI 2.0.4, section 2.3.
    """
    name = display_path(path)
    if path.exists() and not path.is_file():
        raise InputError(f"{name}: is not a file; give an FMU")
    try:
        with zipfile.ZipFile(path) as archive:
            files = _checked_files(archive, path.stat().st_size)
            for entry, root in ((DESCRIPTION, "fmiModelDescription"), (BUILD_DESCRIPTION, "fmiBuildDescription")):
                if entry in files:
                    _check_description(archive, entry, root)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    except OSError as error:
        raise InputError(f"{name}: cannot be read ({os_error_reason(error)}); give an FMU") from None
    except Exception as error:  # zipfile, zlib and struct raise their own for damaged archives
        raise InputError(
            f"{name}: is not an FMU, or is cut off ({str(error) or type(error).__name__}); export or copy it again"
        ) from None
    return Archive(files)


def unpack(path: Path, folder: Path) -> None:
    """Unpack an FMU into a new folder, checked once more: the file may have changed since it was read.

    raises : InputError where it must not be unpacked or is damaged; OSError where there is no room

    Source: FMI 2.0.4, section 2.3.
    """
    read_archive(path)
    try:
        fmpy.extract(path, folder)
    except OSError:
        raise
    except Exception as error:  # FMPy raises plain Exceptions, zipfile and zlib their own
        raise InputError(f"{display_path(path)}: cannot be unpacked ({error}); it is damaged") from None


def _checked_files(archive: zipfile.ZipFile, packed_bytes: int) -> frozenset[str]:
    entries = archive.infolist()
    if len(entries) > MOST_ENTRIES:
        raise InputError(f"contains {len(entries)} files, more than {MOST_ENTRIES}; nothing was unpacked")
    for entry in entries:
        if fault := _entry_fault(entry):
            raise InputError(f"contains `{entry.filename[:80]}`, {fault}; nothing was unpacked")
    files = _files_stated_once(entries)
    unpacked = sum(entry.file_size for entry in entries)
    if unpacked > LARGEST_UNPACKED or (unpacked > PACKED_WELL and unpacked > LARGEST_RATIO * packed_bytes):
        raise InputError(
            f"would unpack from {packed_bytes / MIB:.1f} to {unpacked / MIB:.0f} MiB, which no FMU needs; nothing was "
            "unpacked"
        )
    if DESCRIPTION not in files:
        raise InputError(f"is not an FMU (it contains no {DESCRIPTION})")
    return files


def _files_stated_once(entries: Sequence[zipfile.ZipInfo]) -> frozenset[str]:
    """Names of the files; InputError where two entries have one name, or a file has that of a folder.

    Which of two entries a reader takes is its own affair: the checked description might not be the one that is used.
    """
    files = [str(PurePosixPath(e.filename)) for e in entries if not e.is_dir()]
    # a folder's name ends in `/`: with a letter behind, it is the parent of a file in it
    folders = {str(parent) for e in entries for parent in PurePosixPath(f"{e.filename}x").parents}
    twice = [name for name, times in Counter(files).items() if times > 1 or name in folders]
    if twice:
        raise InputError(f"contains two entries for `{twice[0][:80]}`; nothing was unpacked")
    return frozenset(files)


def _entry_fault(entry: zipfile.ZipInfo) -> str | None:
    """Why an entry must not be unpacked; zipfile cuts a name at a null character, so the original is checked too."""
    names = (entry.filename, entry.orig_filename)
    if any(not n or not n.isprintable() for n in names):
        return "a name with characters that do not print"
    if any(_leads_outside(n) for n in names):
        return "a path outside the archive"
    if any(len(segment.encode()) > LONGEST_PART for segment in PurePosixPath(entry.filename).parts):
        return "a name too long for a file"
    kind = stat.S_IFMT(entry.external_attr >> 16)
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        return "a link or a device"
    if entry.flag_bits & 0x1:
        return "which is encrypted"
    return None


def _leads_outside(name: str) -> bool:
    """Whether a name leads out of its folder, on any platform."""
    return ".." in PurePosixPath(name).parts or name.startswith("/") or "\\" in name or ":" in name


def _check_description(archive: zipfile.ZipFile, entry: str, root: str) -> None:
    if archive.getinfo(entry).file_size > LARGEST_BYTES:
        raise InputError(f"{entry} is larger than {LARGEST_BYTES / MIB:.0f} MiB")
    with error_context(entry):
        check_xml(archive.read(entry), root)
