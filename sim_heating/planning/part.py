"""Part of a study: its arguments, its result, and the digest that its finished batches depend on."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from sim_heating.base.files.package import PACKAGE
from sim_heating.base.progress import Progress
from sim_heating.base.report.chart import Chart
from sim_heating.base.report.table import Table
from sim_heating.credibility.validation.region import Samples
from sim_heating.planning.study import HASH_LENGTH, Study


@dataclass(frozen=True)
class Engine:
    """Place of computation: the ledger of finished batches and the processes.

    ledger             : folder for finished batches, with a folder below it for each kind
    scheduler, workers : as base/parallel/batches.py, `run_batches`, takes them
    """

    ledger: Path
    scheduler: str | None = None
    workers: int | None = None


@cache
def program_digest() -> str:
    """Digest of the program's own files, so that batches of another version are not mistaken for those of this one."""
    digest = hashlib.sha256()
    for path in sorted([*PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.csv")]):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:HASH_LENGTH]


@dataclass(frozen=True)
class PartPicture:
    """A picture of a part: its file, relative to the output, and its caption."""

    file: str
    caption: str


@dataclass(frozen=True)
class PartResult:
    """The result of a part.

    data                    : plain values, for study.json
    tables, pictures, notes : for the page; a note is one line
    samples                 : conditions of its nominal flight, for the credibility of the study
    charts                  : for the page; the pictures show the same on paper
    topics                  : of the equations that it uses besides those of the base entry
    """

    data: Mapping[str, Any]
    tables: tuple[Table, ...] = ()
    pictures: tuple[PartPicture, ...] = ()
    notes: tuple[str, ...] = ()
    samples: tuple[Samples, ...] = ()
    topics: tuple[str, ...] = ()
    charts: tuple[Chart, ...] = ()

    def __repr__(self) -> str:
        return (
            f"<PartResult: {len(self.tables)} tables, {len(self.pictures)} pictures, {len(self.notes)} notes; data "
            f"{', '.join(self.data)}>"
        )


@dataclass(frozen=True)
class StudyPart:
    """Computation that a table of a study asks for.

    run   : (study, folder for its files, engine, progress) -> result; its files are written below the folder
    files : study -> names of the files that it may write, relative to the folder
    """

    run: Callable[[Study, Path, Engine, Progress], PartResult]
    files: Callable[[Study], Sequence[str]]
