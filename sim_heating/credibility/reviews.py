"""Signed reviews of people: `credibility.toml` next to a vehicle or a record.

    format = "credibility/1"
    [[review]]
    factor = "history"
    level = 2
    person = "A. Engineer, heat shield group"
    date = "2026-11-20"
    statement = "Flown on two vehicles before; report HS-12."
    reviewed = "sha256:..."

`reviewed` is the digest of what was reviewed, the vehicle's or the record's files as they were then. Where it is not
that of the files as they are now, the review does not count, and the statement says so. A name in a file is no
cryptographic signature: who may write the file may write the name.
"""

from __future__ import annotations

import datetime
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tomlkit
from pydantic import Field, field_validator

from sim_heating.base.errors import InputError
from sim_heating.base.files import Declared, display_path, read_toml, suggestion, write_text_atomic
from sim_heating.credibility.rules import HIGHEST, REVIEW, rules
from sim_heating.inputs.record import Record, record_digest
from sim_heating.inputs.vehicle import REVIEWS, Vehicle, add_vehicle_files

FILE = REVIEWS


class Review(Declared):
    """One review of one factor by one person."""

    factor: str = Field(description="name of a factor")
    level: int = Field(ge=0, le=HIGHEST, description="0 to 4, by the rules of `sim-heating credibility rules`")
    person: str = Field(min_length=1, description="name, and on whose behalf")
    date: datetime.date = Field(description='of the review, as "2026-11-20"')
    statement: str = Field(min_length=1, description="what was found")
    reviewed: str = Field(pattern="^sha256:[0-9a-f]{64}$", description="digest of what was reviewed")

    @field_validator("date", mode="before")
    @classmethod
    def _read_date(cls, value: object) -> object:
        if not isinstance(value, str):
            return value
        try:
            return datetime.date.fromisoformat(value)
        except ValueError:
            raise ValueError(f'"{value}" is no date; write it as "2026-11-20"') from None

    @field_validator("factor")
    @classmethod
    def _check(cls, name: str) -> str:
        factors = [f.name for f in rules().factors]
        if name not in factors:
            raise ValueError(f"`{name}` is no factor{suggestion(name, factors)}")
        return name


class ReviewFile(Declared):
    """Contents of credibility.toml."""

    format: Literal["credibility/1"]
    review: list[Review] = Field(default=[])


@dataclass(frozen=True)
class Reviewed:
    """A review and whether it counts: only where its digest is that of the files as they are now."""

    review: Review
    counts: bool

    @property
    def words(self) -> str:
        """Who reviewed what, in one line."""
        r = self.review
        void = "" if self.counts else "; does not count: what was reviewed has changed since"
        return f"{r.factor} {r.level}: {r.person}, {r.date.isoformat()}: {r.statement}{void}"


def reviews_in(folder: Path | None, digest: str) -> tuple[Reviewed, ...]:
    """Reviews in the credibility.toml of a folder; none where there is no such file.

    digest : of what the folder holds now;  raises : InputError where the file is damaged
    """
    if folder is None or not (folder / FILE).is_file():
        return ()
    return reviews_of_file(folder / FILE, digest)


def reviews_of_file(path: Path, digest: str) -> tuple[Reviewed, ...]:
    """Reviews of a file, each with whether it is of a digest; raises InputError where the file is damaged."""
    return tuple(Reviewed(r, r.reviewed == digest) for r in read_toml(path, ReviewFile).review)


def evidence_of(reviews: Sequence[Reviewed]) -> frozenset[str]:
    """Names of the evidence of reviews that count: `review.FACTOR.N` up to the level that each states."""
    counting = [r.review for r in reviews if r.counts]
    return frozenset(f"{REVIEW}{r.factor}.{n}" for r in counting for n in range(1, r.level + 1))


def digest_of(reviewed: Vehicle | Record) -> str:
    """Digest of the files of a vehicle or a record, reviews aside."""
    if isinstance(reviewed, Record):
        return record_digest(reviewed)
    digest = hashlib.sha256()
    add_vehicle_files(digest, reviewed.directory)
    return f"sha256:{digest.hexdigest()}"


def add_review(folder: Path, review: Review) -> Path:
    """Append a review to the credibility.toml of a folder, which is created where there is none; returns its path.

    raises : InputError where the file is damaged
    """
    path = folder / FILE
    if path.is_file():
        read_toml(path, ReviewFile)
        document = tomlkit.parse(path.read_text(encoding="utf-8"))
    else:
        document = tomlkit.document()
        document["format"] = "credibility/1"
    entries = document.setdefault("review", tomlkit.aot())
    if not isinstance(entries, tomlkit.items.AoT):
        raise InputError(f"{display_path(path)}: `review` is written inline; write [[review]] tables")
    entry = tomlkit.table()
    for key, value in review.model_dump(mode="json").items():
        entry[key] = value
    entries.append(entry)
    write_text_atomic(path, tomlkit.dumps(document))
    return path
