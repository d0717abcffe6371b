"""A part of a study: what it is given, what it returns, and the digest that its stored batches depend on."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from sim_heating.base.files.package import PACKAGE
from sim_heating.base.progress import Progress
from sim_heating.base.report.table import Table
from sim_heating.planning.study import HASH_LENGTH, Study


@dataclass(frozen=True)
class Engine:
    """Where many flights are computed.

    ledger    : folder for finished batches, one below it for each kind
    scheduler, workers : as `batches.run_batches` takes them
    """

    ledger: Path
    scheduler: str | None = None
    workers: int | None = None


@cache
def program_digest() -> str:
    """Digest of the program's own files: batches of another version are not those of this one."""
    digest = hashlib.sha256()
    for path in sorted([*PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.csv")]):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:HASH_LENGTH]


@dataclass(frozen=True)
class Picture:
    """A picture: its file, relative to the output, and what it shows."""

    file: str
    caption: str


@dataclass(frozen=True)
class Found:
    """What a part found.

    data     : for study.json, plain values
    tables, pictures, notes : for the page; a note is one line
    """

    data: Mapping[str, Any]
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Part:
    """What a table of a study asks for.

    run   : (study, folder for its files, engine, progress) -> found; files go below the folder
    files : study -> names of the files that it may write, from there
    """

    run: Callable[[Study, Path, Engine, Progress], Found]
    files: Callable[[Study], Sequence[str]]
