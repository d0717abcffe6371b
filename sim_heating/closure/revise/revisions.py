"""Revisions of a control point's ratio table and effects as files of the vehicle: written, read back, reverted.

    ratio_tables/P.csv                     the table in force; its header states `revision` and `parent_revision`
    ratio_revisions/P/revision_1.csv       an earlier one, byte for byte
    ratio_revisions/P/revision_2.json      how revision 2 was made from revision 1: provenance, evidence, changed nodes
    ratio_revisions/P/revision_2.png       and its picture, where nodes changed
    ratio_revisions/P/revision_1.toml      control_points/P.toml before revision 2, where that wrote effects

All files of a revision appear together, or go together when it is reverted, also where the program is killed; one
process at a time revises a vehicle. Evidence is kept as a whole: a later update starts from the table before the first
one and takes all of it together. A revision's file carries a digest of its content.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.base.files import (
    DIGEST,
    Declared,
    LocatedError,
    Location,
    check,
    digest_matches,
    display_path,
    exclusive,
    json_text,
    raw_text,
    read_json,
    repeated_name,
    replace_files,
    suggestion,
    text_digest,
    with_digest,
)
from sim_heating.base.files.text import abbreviated
from sim_heating.base.parameters import RATIO
from sim_heating.base.progress import Progress, no_progress
from sim_heating.closure.revise.checks import MIN_SIGMA
from sim_heating.estimation.report.estimate_file import EstimatedParameter, is_correlation
from sim_heating.heating.ratio.table import RatioTable, ratio_table_text, read_ratio_table
from sim_heating.heating.ratio.uncertainty import Evidence, Posterior, posterior
from sim_heating.inputs.vehicle import Vehicle

FOLDER = "ratio_revisions"
WAIT_S = 3600.0
"""Longest wait for another process that revises the same vehicle [s]; its predictions may take minutes."""
RATIO_TOLERANCE, SIGMA_TOLERANCE = 1e-5, 2e-3
"""Relative differences of ratio and sigma by which a table may be away from what its evidence makes it: it is rounded
to 6 and 4 digits."""
LARGEST = 1e9
"""Largest weight, value or covariance that evidence is taken to have."""
ROUNDING = 1e-6
"""Difference that counts as rounding, relative to the largest value of a table."""


class UsedRecord(Declared):
    """A record behind a revision: hash of its files, and the times that were used."""

    record: str
    inputs: str
    segments: list[list[float]]

    @model_validator(mode="after")
    def _check(self) -> UsedRecord:
        wrong = [i for i, s in enumerate(self.segments) if len(s) != 2 or s[0] > s[1]]
        if wrong:
            raise LocatedError(*((("segments", i), f"{self.segments[i]} is not [start_s, end_s]") for i in wrong))
        return self


class StoredEvidence(Declared):
    """`heating.ratio.uncertainty.Evidence` as a file contains it."""

    names: list[str]
    nodes: list[int]
    H: list[list[float]]
    value: list[float]
    covariance: list[list[float]]

    @model_validator(mode="after")
    def _check(self) -> StoredEvidence:
        known, k, m = [p.name for p in RATIO], len(self.names), len(self.nodes)
        problems: list[tuple[Location, str]] = [
            (("names", i), f"`{n}` is not a parameter of the ratio{suggestion(n, known)}")
            for i, n in enumerate(self.names)
            if n not in known
        ]
        if repeated_name(self.names) is not None:
            problems.append((("names",), f"`{repeated_name(self.names)}` occurs twice"))
        if any(a >= b for a, b in pairwise([-1, *self.nodes])):
            problems.append((("nodes",), "must be the numbers of nodes, 0 or above, each larger than the one before"))
        problems += _shape_problems("H", self.H, k, m) + _shape_problems("covariance", self.covariance, k, k)
        if len(self.value) != k:
            problems.append((("value",), f"has {len(self.value)} values for {k} names"))
        numbers = {"H": chain(*self.H), "value": self.value, "covariance": chain(*self.covariance)}
        for key, largest in ((key, max(map(abs, values), default=0.0)) for key, values in numbers.items()):
            if largest > LARGEST:
                problems.append(((key,), f"contains {largest:g}, beyond {LARGEST:g}, which no flight gives"))
        if not problems and (rule := _covariance_rule(np.array(self.covariance).reshape(k, k))):
            problems.append((("covariance",), rule))
        if problems:
            raise LocatedError(*problems)
        return self

    def arrays(self) -> Evidence:
        """The evidence as arrays, for the update."""
        nodes = np.array(self.nodes, dtype=np.int64)
        return Evidence(tuple(self.names), nodes, np.array(self.H), np.array(self.value), np.array(self.covariance))


def _shape_problems(key: str, rows: list[list[float]], height: int, width: int) -> list[tuple[Location, str]]:
    """Why a list of rows is not a matrix of this shape."""
    if len(rows) != height:
        return [((key,), f"has {len(rows)} rows for {height} names")]
    ragged = [(i, row) for i, row in enumerate(rows) if len(row) != width]
    return [((key, i), f"has {len(row)} values where there must be {width}") for i, row in ragged]


def _covariance_rule(covariance: FloatArray) -> str | None:
    """Why a square matrix is not a covariance; None where it is one."""
    if not np.allclose(covariance, covariance.T, rtol=1e-9, atol=0.0):
        return "is not symmetric"
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if np.any(sigma < MIN_SIGMA) or not is_correlation(covariance / np.outer(sigma, sigma)):
        return "is not positive definite"
    return None


class WrittenEffect(Declared):
    """A written effect: its values, and those declared before, None where it was not declared."""

    name: str
    parameters: dict[str, float]
    before: dict[str, float] | None


class RevisionFile(Declared):
    """Contents of ratio_revisions/P/revision_N.json.

    table        : path of the table below the vehicle
    parent       : number of the revision that it was made from
    parent_hash, table_hash : of the two files' bytes
    estimate     : hash of the estimate's file
    parameters   : estimates of the ratio and of written effects
    effects      : those written into the control point's file
    point_parent_hash, point_hash : of that file's bytes before and after; None where no effect was written
    not_written  : estimated parameters that are not in the vehicle, with the reason
    reach        : distances from which on the errors of two nodes are taken to be independent
    chi_square   : of all evidence against the table before any of it
    changed      : nodes with another value: the five variables, ratio and sigma before and after
    """

    format: Literal["ratio-revision/1"] = "ratio-revision/1"
    control_point: str
    table: str
    revision: int
    parent: int
    parent_hash: str
    table_hash: str
    program: str
    estimate: str
    records: list[UsedRecord]
    reference_condition: dict[str, float]
    parameters: dict[str, EstimatedParameter]
    effects: list[WrittenEffect] = Field(default=[])
    point_parent_hash: str | None = None
    point_hash: str | None = None
    not_written: dict[str, str]
    reach: dict[str, float]
    chi_square: float
    degrees_of_freedom: int
    evidence: StoredEvidence
    errors_K: dict[str, dict[str, Any]] = Field(description="record -> fit, holdout -> before, after")
    changed: dict[str, list[float]]

    @model_validator(mode="after")
    def _check(self) -> RevisionFile:
        if self.parent != self.revision - 1:
            rule = f"{self.parent} is not the revision before {self.revision}, which is {self.revision - 1}"
            raise LocatedError((("parent",), rule))
        return self


@dataclass(frozen=True)
class TableHistory:
    """A table with the revisions behind it.

    path      : the table in force
    raw       : its text
    table     : its contents
    revision  : its number
    base      : the table before the first update; the one in force where there was none
    revisions : those added to `base` since, the oldest first
    """

    path: Path
    raw: str
    table: RatioTable
    revision: int
    base: RatioTable
    revisions: tuple[RevisionFile, ...]


def table_path(vehicle: Vehicle, point: str) -> Path:
    """The file of a control point's table.

    raises : InputError where it is an earlier revision, or shared with other points
    """
    name = vehicle.control_point(point).declared.ratio_table
    if Path(name).parts[0] == FOLDER:
        raise InputError(f"{point}: its `ratio_table` is {name}, an earlier revision; name the one in force first")
    sharing = [p.name for p in vehicle.control_points.values() if p.declared.ratio_table == name and p.name != point]
    if sharing:
        raise InputError(f"{name}: is the table of {', '.join(sharing)} too; give {point} its own copy first")
    return vehicle.directory / name


def read_history(vehicle: Vehicle, point: str) -> TableHistory:
    """The table of a control point and the revisions behind it.

    raises : InputError where its number is not a whole one, a revision was changed after it was written, or the table
             is not the one that its revisions make
    """
    path = table_path(vehicle, point)
    raw = raw_text(path)
    table = read_ratio_table(path)
    number = table.header.get("revision", "")
    if re.fullmatch("[0-9]{1,9}", number) is None:
        raise InputError(
            f"{display_path(path)}, header `revision`: {abbreviated(number)} is not a whole number; number the table"
        )
    revisions: list[RevisionFile] = []
    tables = [path]
    text, at = raw, int(number)
    while (made := revision_path(vehicle.directory, point, at, "json")).is_file():
        revision = _read_revision(made, point, at)
        # A table that was edited no longer is what its evidence made it, and further updates would build on both.
        if revision.table_hash != text_digest(text):
            raise InputError(
                f"{display_path(tables[0])}: was changed after {display_path(made)} was written; revert the change, or "
                "give the table a new `revision`"
            )
        tables.insert(0, revision_path(vehicle.directory, point, revision.parent, "csv"))
        text, at = raw_text(tables[0]), revision.parent
        if revision.parent_hash != text_digest(text):
            raise InputError(
                f"{display_path(tables[0])}: is not the table that {display_path(made)} was made from; restore it"
            )
        revisions.insert(0, revision)
    _refuse_half_written(vehicle.directory, point, int(number))
    history = TableHistory(path, raw, table, int(number), read_ratio_table(tables[0]), tuple(revisions))
    _check_evidence(vehicle.directory, history, tables[1:])
    return history


def _read_revision(file: Path, point: str, number: int) -> RevisionFile:
    """A revision's file, unchanged since it was written.

    raises : InputError where it was changed, or is that of another point or revision
    """
    data, name = read_json(file), display_path(file)
    revision = check({k: v for k, v in data.items() if k != DIGEST}, RevisionFile, name)
    if (revision.control_point, revision.revision) != (point, number):
        raise InputError(
            f"{name}: is revision {revision.revision} of {abbreviated(revision.control_point)}; this must be revision "
            f"{number} of {point}; restore the file"
        )
    # Files of earlier versions have none; their evidence is compared with their table instead.
    if DIGEST in data and not digest_matches(data):
        raise InputError(
            f"{name}: was changed after it was written (its content is not that of its `{DIGEST}`); restore it"
        )
    return revision


def _check_evidence(directory: Path, history: TableHistory, tables: Sequence[Path]) -> None:
    """Check that the evidence of the revisions is on nodes of the table, and makes the tables that are there.

    tables : of the revisions, in their order
    raises : InputError naming the revision
    """
    base = history.base
    for k, (revision, path) in enumerate(zip(history.revisions, tables, strict=True)):
        name = display_path(revision_path(directory, revision.control_point, revision.revision, "json"))
        if max(revision.evidence.nodes, default=-1) >= base.ratio.size:
            raise InputError(
                f"{name}, [evidence]: `nodes`: {max(revision.evidence.nodes)} is not a node of the table, which has "
                f"{base.ratio.size}; restore the file"
            )
        made = posterior(base, [r.evidence.arrays() for r in history.revisions[: k + 1]])
        table = read_ratio_table(path)
        agrees = (
            table.sigma is not None
            and table.ratio.shape == made.ratio.shape
            and (
                np.allclose(table.ratio, made.ratio, rtol=RATIO_TOLERANCE, atol=ROUNDING * np.abs(made.ratio).max())
                and np.allclose(table.sigma, made.sigma, rtol=SIGMA_TOLERANCE, atol=ROUNDING * made.sigma.max())
            )
        )
        if not agrees:
            raise InputError(
                f"{name}: its evidence does not make the table {display_path(path)}; restore both files, or give the "
                "table a new `revision`"
            )


def table_posterior(vehicle: Vehicle, point: str) -> Posterior | None:
    """A control point's table by its sigma column and the evidence of its revisions; None without a sigma column.

    raises : InputError where the table was changed after its revision was written
    """
    base, evidence = vehicle.control_point(point).ratio, list[Evidence]()
    if (vehicle.directory / FOLDER / point).is_dir():
        history = read_history(vehicle, point)
        base, evidence = history.base, [r.evidence.arrays() for r in history.revisions]
    return None if base.sigma is None else posterior(base, evidence)


def _refuse_half_written(directory: Path, point: str, number: int) -> None:
    """Refuse a vehicle with the effects of the next revision and the table of this one.

    An update of an earlier version, which replaced one file after the other, left that when it was killed.
    """
    made, file = revision_path(directory, point, number + 1, "json"), point_path(directory, point)
    if not made.is_file():
        return
    revision = _read_revision(made, point, number + 1)
    if revision.point_hash is not None and revision.point_hash == text_digest(raw_text(file)):
        kept = revision_path(directory, point, number, "toml")
        raise InputError(
            f"{display_path(file)}: an update ended before its table was written; copy {display_path(kept)} over it"
        )


@contextmanager
def revising(directory: str | os.PathLike[str], progress: Progress = no_progress) -> Iterator[None]:
    """Keep other processes from revising a vehicle, from the reading of its tables to the writing of the next ones.

    progress : called where another process has to be waited for
    raises   : InputError where that does not end, or the vehicle cannot be written
    """
    text = f"waiting for another process that revises {display_path(directory)}"
    with exclusive(directory, wait_s=WAIT_S, waiting=lambda: progress(0.0, text)):
        yield


def write_revision(
    vehicle: Vehicle,
    history: TableHistory,
    table: RatioTable,
    made: Mapping[str, Any],
    point_texts: tuple[str, str],
    picture: bytes | None = None,
) -> RevisionFile:
    """Write the next revision, all files of it together: the old ones kept, its origin, the effects, and the table.

    history     : as the table is now
    made        : the fields of a RevisionFile that do not follow from the files
    point_texts : the control point's file as it is now and as it is to be
    picture     : of the update; None where there is none
    raises      : InputError where table or control point are no longer the given ones; nothing is written then
    """
    point, number = str(made["control_point"]), history.revision + 1
    before, after = point_texts
    with revising(vehicle.directory):
        _check_unchanged(vehicle, history, point, before)
        text, effects = ratio_table_text(table, _short_axes(table)), after != before
        data = {
            **made,
            "table": history.path.relative_to(vehicle.directory).as_posix(),
            "revision": number,
            "parent": history.revision,
            "parent_hash": text_digest(history.raw),
            "table_hash": text_digest(text),
            "point_parent_hash": text_digest(before) if effects else None,
            "point_hash": text_digest(after) if effects else None,
        }
        revision = check(data, RevisionFile, f"revision {number}")
        new: dict[Path, str | bytes] = {
            revision_path(Path(), point, history.revision, "csv"): history.raw,
            revision_path(Path(), point, number, "json"): json_text(with_digest(revision.model_dump())),
            Path(revision.table): text,
        }
        if picture is not None:
            new[revision_path(Path(), point, number, "png")] = picture
        if effects:
            new[revision_path(Path(), point, history.revision, "toml")] = before
            new[point_path(Path(), point)] = after
        # What an update of an earlier version left when it was interrupted is not part of this revision.
        stale = {revision_path(Path(), point, number, "png"), revision_path(Path(), point, history.revision, "toml")}
        replace_files(
            vehicle.directory, {p.as_posix(): c for p, c in new.items()}, [p.as_posix() for p in stale - new.keys()]
        )
    return revision


def _check_unchanged(vehicle: Vehicle, history: TableHistory, point: str, point_text: str) -> None:
    """Check that table, revisions and control point are still those that an update was worked out from."""
    now = read_history(vehicle, point)
    file = point_path(vehicle.directory, point)
    same = (now.raw, now.revisions, raw_text(file)) == (history.raw, history.revisions, point_text)
    if not same:
        changed = history.path if now.raw != history.raw else file
        raise InputError(
            f"{display_path(changed)}: was changed while the update was worked out from revision {history.revision}; "
            "nothing was written, update again"
        )


def _short_axes(table: RatioTable) -> dict[str, str]:
    """Formats of the axes that read back equal without trailing zeros, so that unchanged rows keep their text."""
    axes = zip(RATIO_VARIABLES, table.axes, strict=True)
    return {name: "g" for name, axis in axes if all(float(f"{v:g}") == v for v in axis)}


def revert(vehicle: Vehicle, point: str) -> tuple[int, int]:
    """Restore the parent of the newest revision, byte for byte, and remove the revision's files.

    returns : numbers of the revision undone and of the one in force
    raises  : InputError where there is no revision from flight data, or the control point's file was changed since
    """
    with revising(vehicle.directory):
        history = read_history(vehicle, point)
        if not history.revisions:
            raise InputError(
                f"{display_path(history.path)}: revision {history.revision} was not made from flight data; kept"
            )
        undone = history.revisions[-1]
        kept, point_kept = (revision_path(Path(), point, undone.parent, kind) for kind in ("csv", "toml"))
        made = (revision_path(Path(), point, undone.revision, kind) for kind in ("json", "png"))
        restored = {history.path.relative_to(vehicle.directory).as_posix(): raw_text(vehicle.directory / kept)}
        if undone.point_hash is not None:
            file = point_path(vehicle.directory, point)
            restored[point_path(Path(), point).as_posix()] = _point_before(file, vehicle.directory / point_kept, undone)
        replace_files(vehicle.directory, restored, [p.as_posix() for p in (kept, point_kept, *made)])
    return undone.revision, undone.parent


def _point_before(file: Path, kept: Path, undone: RevisionFile) -> str:
    """The control point's file before a revision.

    raises : InputError where a person has changed it since
    """
    text = raw_text(kept)
    if text_digest(text) != undone.point_parent_hash:
        raise InputError(
            f"{display_path(kept)}: is not the file that revision {undone.revision} was made from; restore it"
        )
    # A change made by hand since then would be lost.
    if text_digest(raw_text(file)) not in (undone.point_hash, undone.point_parent_hash):
        raise InputError(
            f"{display_path(file)}: was changed after revision {undone.revision}, which wrote effects into it; "
            "undo the change first, or it would be lost"
        )
    return text


def point_path(directory: Path, point: str) -> Path:
    """The file of a control point in a vehicle."""
    return directory / "control_points" / f"{point}.toml"


def revision_path(directory: Path, point: str, revision: int, kind: str) -> Path:
    """Path of a revision's table (csv), control point (toml), evidence (json) or picture (png) in a vehicle."""
    return directory / FOLDER / point / f"revision_{revision}.{kind}"
