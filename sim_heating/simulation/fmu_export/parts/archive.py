"""The archive of an FMU or of a system of FMUs: one zip, with a record of digests by which an export is recognised."""

from __future__ import annotations

import hashlib
import io
import json
import os
import stat
import zipfile
import zlib
from pathlib import Path

from sim_heating.base.errors import InputError
from sim_heating.base.files import OR_FORCE, replaces_others
from sim_heating.base.files.package import package_version
from sim_heating.base.files.text import display_path

STAMP = (1980, 1, 1, 0, 0, 0)
"""Time of the files in the archive: a model always gives the same bytes, except for the date in its description."""
RECORD = "resources/export.json"
"""Entry with the digest of every other entry."""
GENERATOR = "sim-heating"
LARGEST_BYTES = 1 << 30
"""Size above which a file is not read to the end; an export has some megabytes."""


def archive_bytes(files: dict[str, bytes]) -> bytes:
    """The archive of these files, and of their record; all are readable by everybody, libraries executable.

    files : content by the name of the entry
    """
    digests = {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
    record = {"generator": GENERATOR, "version": package_version(), "sha256": digests}
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in {**files, RECORD: (json.dumps(record, indent=1) + "\n").encode()}.items():
            entry = zipfile.ZipInfo(name, STAMP)
            entry.create_system = 3  # Unix, whose permissions follow
            entry.external_attr = (stat.S_IFREG | (0o755 if name.startswith("binaries/") else 0o644)) << 16
            archive.writestr(entry, data, zipfile.ZIP_DEFLATED)
    return memory.getvalue()


def is_unmodified_export(path: str | os.PathLike[str]) -> bool:
    """Whether a file is an export that this package wrote and nobody has changed since: each entry has its digest.

    path : any path; False for a directory, a symbolic link, a file that is no archive, and where nothing is
    """
    file = Path(path)
    try:
        status = file.lstat()
        # A link names a file that somebody else put there; a pipe or a device would be waited for.
        if not stat.S_ISREG(status.st_mode) or status.st_size > LARGEST_BYTES:
            return False
        with zipfile.ZipFile(file) as archive:
            return _is_unmodified(archive)
    except (OSError, ValueError, KeyError, EOFError, RuntimeError, NotImplementedError, zipfile.BadZipFile, zlib.error):
        return False


def _is_unmodified(archive: zipfile.ZipFile) -> bool:
    names = archive.namelist()
    if sum(entry.file_size for entry in archive.infolist()) > LARGEST_BYTES or RECORD not in names or archive.comment:
        return False
    record = json.loads(archive.read(RECORD))
    digests = record.get("sha256") if isinstance(record, dict) else None
    if not isinstance(digests, dict) or record.get("generator") != GENERATOR:
        return False
    # As a list: an archive may hold a name twice.
    if names != [*digests, RECORD]:
        return False
    return all(hashlib.sha256(archive.read(name)).hexdigest() == digest for name, digest in digests.items())


def require_replaceable(path: str | os.PathLike[str]) -> None:
    """Refuse to write an export in place of a file that is not an unmodified export of this package.

    raises : InputError naming the file
    """
    if os.path.lexists(path) and not replaces_others() and not is_unmodified_export(path):
        raise InputError(
            f"{display_path(path)}: exists and is not an unmodified export of sim-heating; it is not replaced: "
            f"choose another name{OR_FORCE}"
        )
