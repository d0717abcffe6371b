"""Revisions of a control point's ratio table and effects as files of the vehicle: written, read back, reverted.

    ratio_tables/P.csv                     the table in force; its header states `revision` and `parent_revision`
    ratio_revisions/P/revision_1.csv       an earlier one, byte for byte
    ratio_revisions/P/revision_2.json      how revision 2 was made from revision 1: provenance, evidence, changed nodes
    ratio_revisions/P/revision_2.png       and its picture, where nodes changed
    ratio_revisions/P/revision_1.toml      control_points/P.toml before revision 2, where that wrote effects

The table is replaced last and in one step; a failure before leaves the vehicle as it was. A program killed between the
two files is detected by `read_history`. Evidence is kept as a whole: a later update starts from the table before the
first one and takes all of it together.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.base.files import Declared, check, display_path, json_text, raw_text, read_json, write_text_atomic
from sim_heating.estimation.report.estimate_file import EstimatedParameter
from sim_heating.heating.ratio.table import RatioTable, ratio_table_text, read_ratio_table
from sim_heating.heating.ratio.uncertainty import Evidence, Posterior, posterior
from sim_heating.inputs.vehicle import Vehicle

FOLDER = "ratio_revisions"


class UsedRecord(Declared):
    """A record behind a revision: hash of its files, and the times that were used."""

    record: str
    inputs: str
    segments: list[list[float]]


class StoredEvidence(Declared):
    """`heating.ratio.uncertainty.Evidence` as a file contains it."""

    names: list[str]
    nodes: list[int]
    H: list[list[float]]
    value: list[float]
    covariance: list[list[float]]

    def arrays(self) -> Evidence:
        """The evidence as arrays, for the update."""
        nodes = np.array(self.nodes, dtype=np.int64)
        return Evidence(tuple(self.names), nodes, np.array(self.H), np.array(self.value), np.array(self.covariance))


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

    raises : InputError where its number is not a whole one, or the table was changed after its revision was written
    """
    path = table_path(vehicle, point)
    raw = raw_text(path)
    table = read_ratio_table(path)
    number = table.header.get("revision", "")
    if not number.isdecimal():
        raise InputError(f"{display_path(path)}, header `revision`: {number!r} is not a whole number; number the table")
    revisions: list[RevisionFile] = []
    base, text, at = path, raw, int(number)
    while (made := revision_path(vehicle.directory, point, at, "json")).is_file():
        revision = check(read_json(made), RevisionFile, display_path(made))
        # A table that was edited no longer is what its evidence made it, and further updates would build on both.
        if revision.table_hash != content_hash(text):
            raise InputError(
                f"{display_path(base)}: was changed after {display_path(made)} was written; revert the change, or "
                f"give the table a "
                "new `revision`"
            )
        base = revision_path(vehicle.directory, point, revision.parent, "csv")
        text, at = raw_text(base), revision.parent
        if revision.parent_hash != content_hash(text):
            raise InputError(
                f"{display_path(base)}: is not the table that {display_path(made)} was made from; restore it"
            )
        revisions.insert(0, revision)
    _refuse_half_written(vehicle.directory, point, int(number))
    return TableHistory(path, raw, table, int(number), read_ratio_table(base), tuple(revisions))


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
    """Refuse a vehicle with the effects of the next revision and the table of this one."""
    made, file = revision_path(directory, point, number + 1, "json"), point_path(directory, point)
    if not made.is_file():
        return
    revision = check(read_json(made), RevisionFile, display_path(made))
    if revision.point_hash is not None and revision.point_hash == content_hash(raw_text(file)):
        kept = revision_path(directory, point, number, "toml")
        raise InputError(
            f"{display_path(file)}: an update ended before its table was written; copy {display_path(kept)} over it"
        )


def content_hash(text: str) -> str:
    """`sha256:...` of a text as UTF-8."""
    return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"


def write_revision(
    vehicle: Vehicle, history: TableHistory, table: RatioTable, made: Mapping[str, Any], point_text: str | None = None
) -> RevisionFile:
    """Write the next revision: the old files kept, its record of origin, the effects, then the table itself.

    made       : the fields of a RevisionFile that do not follow from the files
    point_text : the new text of the control point's file, None where it stays
    """
    file = point_path(vehicle.directory, made["control_point"])
    old_point = raw_text(file)
    text = ratio_table_text(table, _short_axes(table))
    data = {
        **made,
        "table": history.path.relative_to(vehicle.directory).as_posix(),
        "revision": history.revision + 1,
        "parent": history.revision,
        "parent_hash": content_hash(history.raw),
        "table_hash": content_hash(text),
        "point_parent_hash": None if point_text is None else content_hash(old_point),
        "point_hash": None if point_text is None else content_hash(point_text),
    }
    revision = check(data, RevisionFile, f"revision {history.revision + 1}")
    point = revision.control_point
    # The table in force is replaced last: whatever ends the program before leaves the old revision valid.
    write_text_atomic(revision_path(vehicle.directory, point, history.revision, "csv"), history.raw)
    if point_text is not None:
        write_text_atomic(revision_path(vehicle.directory, point, history.revision, "toml"), old_point)
    write_text_atomic(
        revision_path(vehicle.directory, point, revision.revision, "json"), json_text(revision.model_dump())
    )
    try:
        if point_text is not None:
            write_text_atomic(file, point_text)
        write_text_atomic(history.path, text)
    except BaseException:
        if point_text is not None:
            write_text_atomic(file, old_point)
        raise
    return revision


def _short_axes(table: RatioTable) -> dict[str, str]:
    """Formats of the axes that read back equal without trailing zeros, so that unchanged rows keep their text."""
    axes = zip(RATIO_VARIABLES, table.axes, strict=True)
    return {name: "g" for name, axis in axes if all(float(f"{v:g}") == v for v in axis)}


def revert(vehicle: Vehicle, point: str) -> tuple[int, int]:
    """Restore the parent of the newest revision, byte for byte.

    returns : numbers of the revision undone and of the one in force
    raises  : InputError where there is no revision from flight data, or the control point's file was changed since
    """
    history = read_history(vehicle, point)
    if not history.revisions:
        raise InputError(
            f"{display_path(history.path)}: revision {history.revision} was not made from flight data; kept"
        )
    undone = history.revisions[-1]
    kept = revision_path(vehicle.directory, point, undone.parent, "csv")
    old_point = revision_path(vehicle.directory, point, undone.parent, "toml")
    if undone.point_hash is not None:
        _revert_point(point_path(vehicle.directory, point), old_point, undone)
    write_text_atomic(history.path, raw_text(kept))
    made = (revision_path(vehicle.directory, point, undone.revision, kind) for kind in ("json", "png"))
    for path in (kept, old_point, *made):
        path.unlink(missing_ok=True)
    if not any(kept.parent.iterdir()):
        kept.parent.rmdir()
    return undone.revision, undone.parent


def _revert_point(file: Path, kept: Path, undone: RevisionFile) -> None:
    """Restore a control point's file, unless a person has changed it since."""
    text = raw_text(kept)
    if content_hash(text) != undone.point_parent_hash:
        raise InputError(
            f"{display_path(kept)}: is not the file that revision {undone.revision} was made from; restore it"
        )
    # A change made by hand since then would be lost.
    if content_hash(raw_text(file)) not in (undone.point_hash, undone.point_parent_hash):
        raise InputError(
            f"{display_path(file)}: was changed after revision {undone.revision}, which wrote effects into it; "
            "undo the change first, or it would be lost"
        )
    write_text_atomic(file, text)


def point_path(directory: Path, point: str) -> Path:
    """The file of a control point in a vehicle."""
    return directory / "control_points" / f"{point}.toml"


def revision_path(directory: Path, point: str, revision: int, kind: str) -> Path:
    """Path of a revision's table (csv), control point (toml), evidence (json) or picture (png) in a vehicle."""
    return directory / FOLDER / point / f"revision_{revision}.{kind}"
