"""Revisions of a control point's ratio table and effects as files of the vehicle: written, read back, reverted.

    ratio_tables/P.csv                     the table in force; its header states `revision` and `parent_revision`
    ratio_revisions/P/revision_1.csv       an earlier one, byte for byte
    ratio_revisions/P/revision_2.json      how revision 2 was made from revision 1: provenance, evidence, changed nodes
    ratio_revisions/P/revision_2.png       and its picture, where nodes changed
    ratio_revisions/P/revision_1.toml      control_points/P.toml before revision 2, where that wrote effects
    ratio_revisions/P/revision_1.turbulent.csv    the turbulent table before revision 2, where that revised it

All files of a revision appear together, or go together when it is reverted, also where the program is killed; one
process at a time revises a vehicle. Evidence is kept as a whole: a later update starts from the table before the first
one and takes all of it together. A revision's file carries a digest of its content.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base import files
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError, tell
from sim_heating.base.files import display_path
from sim_heating.base.files.paths import real_path
from sim_heating.base.files.text import abbreviated
from sim_heating.base.progress import Progress, no_progress
from sim_heating.closure.revise.flown_ratio import FlownRatio
from sim_heating.closure.revise.revision_file import RevisedTurbulent, RevisionFile, StoredEvidence
from sim_heating.heating.ratio.table import RatioTable, ratio_table_text, read_ratio_table, table_of_text
from sim_heating.heating.ratio.uncertainty import CORRELATION_LENGTH, Posterior, on_axes, posterior
from sim_heating.inputs.vehicle import Vehicle
from sim_heating.inputs.vehicle_files import ControlPointFile

FOLDER = "ratio_revisions"
TURBULENT = "turbulent.csv"
"""Kind of file of a turbulent table before a revision."""


@dataclass(frozen=True)
class TableHistory:
    """A table with the revisions behind it.

    path      : the table in force
    raw       : its text
    table     : its contents
    revision  : its number
    base      : the table before the first update; the one in force where there was none
    revisions : those added to `base` since, the oldest first
    measured  : what each of them took from a flight
    """

    path: Path
    raw: str
    table: RatioTable
    revision: int
    base: RatioTable
    revisions: tuple[RevisionFile, ...]
    measured: tuple[FlownRatio, ...] = ()

    @property
    def reach(self) -> Mapping[str, float]:
        """Variable -> distance from which on the errors of two nodes are independent, by the newest revision."""
        return self.revisions[-1].reach if self.revisions else CORRELATION_LENGTH

    def posterior(self) -> Posterior:
        """The table in force by its sigma column and the evidence of its revisions."""
        axes = self.table.axes
        return posterior(on_axes(self.base, axes), [m.on(axes) for m in self.measured], self.reach)


def table_path(vehicle: Vehicle, point: str) -> Path:
    """The file of a control point's table.

    raises : InputError where it is an earlier revision, or shared with other points
    """
    vehicle.control_point(point)
    return vehicle.directory / _own_table(_declared(vehicle), point)


def _declared(vehicle: Vehicle) -> dict[str, ControlPointFile]:
    return {name: p.declared for name, p in vehicle.control_points.items()}


def _own_table(declared: Mapping[str, ControlPointFile], point: str) -> str:
    """Name of the table in force of a control point, which no other one has.

    raises : InputError where it is an earlier revision, or shared with other points
    """
    name = declared[point].ratio_table
    if Path(name).parts[0] == FOLDER:
        raise InputError(f"{point}: its `ratio_table` is {name}, an earlier revision; name the one in force first")
    sharing = _sharing(declared, point, name)
    if sharing:
        raise InputError(f"{name}: is the table of {', '.join(sharing)} too; give {point} its own copy first")
    return name


def _sharing(declared: Mapping[str, ControlPointFile], point: str, name: str) -> list[str]:
    """Other points with the same table, laminar or turbulent."""
    return [
        other for other, p in declared.items() if name in (p.ratio_table, p.ratio_table_turbulent) and other != point
    ]


def read_history(vehicle: Vehicle, point: str) -> TableHistory:
    """The table of a control point and the revisions behind it.

    raises : InputError where its number is not a whole one, a revision was changed after it was written, or the table
             is not the one that its revisions make
    """
    path = table_path(vehicle, point)
    raw = files.raw_text(path)
    table = read_ratio_table(path)
    number = _revision_number(path, table.header)
    revisions: list[RevisionFile] = []
    tables = [path]
    text, at = raw, number
    while (file := revision_path(vehicle.directory, point, at, "json")).is_file():
        revision = _read_revision(file, point, at)
        parent = revision_path(vehicle.directory, point, revision.parent, "csv")
        text, at = _parent_text(tables[0], text, parent, file, revision), revision.parent
        tables.insert(0, parent)
        revisions.insert(0, revision)
    _refuse_half_restored(vehicle.directory, point, number)
    history = TableHistory(path, raw, table, number, read_ratio_table(tables[0]), tuple(revisions))
    return _with_measurements(vehicle.directory, history, tables[1:], [r.evidence for r in revisions])


def _revision_number(path: Path, header: Mapping[str, str]) -> int:
    """The revision that the header of a table states.

    raises : InputError where it is no whole number
    """
    number = header.get("revision", "")
    if re.fullmatch("[0-9]{1,9}", number) is None:
        raise InputError(
            f"{display_path(path)}, header `revision`: {abbreviated(number)} is not a whole number; number the table"
        )
    return int(number)


def read_turbulent_history(vehicle: Vehicle, history: TableHistory, point: str) -> TableHistory | str | None:
    """The turbulent table of a control point and the revisions of it.

    history : of the laminar table, whose revisions they are
    returns : None where the point has none; one line where it has one that cannot be revised
    raises  : InputError where it is not the one that its revisions make
    """
    name = vehicle.control_point(point).declared.ratio_table_turbulent
    if name is None:
        return None
    if sharing := _sharing(_declared(vehicle), point, name):
        return f"{name} is the table of {', '.join(sharing)} too; give {point} its own copy"
    path = vehicle.directory / name
    raw, table = files.raw_text(path), read_ratio_table(path)
    if table.sigma is None:
        return f"{name} has no sigma column to weigh the flight against; add one"
    revisions = [r for r in history.revisions if r.turbulent is not None]
    tables, text = [path], raw
    for revision in reversed(revisions):
        file = revision_path(vehicle.directory, point, revision.revision, "json")
        parent = revision_path(vehicle.directory, point, revision.parent, TURBULENT)
        assert revision.turbulent is not None
        text = _parent_text(tables[0], text, parent, file, revision.turbulent)
        tables.insert(0, parent)
    turbulent = TableHistory(path, raw, table, history.revision, read_ratio_table(tables[0]), tuple(revisions))
    stored = [r.turbulent.evidence for r in revisions if r.turbulent is not None]
    return _with_measurements(vehicle.directory, turbulent, tables[1:], stored)


def _parent_text(path: Path, text: str, parent: Path, file: Path, hashes: RevisionFile | RevisedTurbulent) -> str:
    """The text of the table that a revision was made from.

    path, text : the table that it made
    raises     : InputError where one of the two is another one
    """
    # A table that was edited no longer is what its evidence made it, and further updates would build on both.
    if hashes.table_hash != files.text_digest(text):
        raise InputError(
            f"{display_path(path)}: was changed after {display_path(file)} was written; revert the change, or "
            "give the table a new `revision`"
        )
    before = files.raw_text(parent)
    if hashes.parent_hash != files.text_digest(before):
        raise InputError(
            f"{display_path(parent)}: is not the table that {display_path(file)} was made from; restore it"
        )
    return before


def _read_revision(file: Path, point: str, number: int) -> RevisionFile:
    """A revision's file, unchanged since it was written.

    raises : InputError where it was changed, or is that of another point or revision
    """
    data, name = files.read_json(file), display_path(file)
    revision = files.check({k: v for k, v in data.items() if k != files.DIGEST}, RevisionFile, name)
    if (revision.control_point, revision.revision) != (point, number):
        raise InputError(
            f"{name}: is revision {revision.revision} of {abbreviated(revision.control_point)}; this must be revision "
            f"{number} of {point}; restore the file"
        )
    if not files.digest_matches(data):
        raise InputError(
            f"{name}: was changed after it was written (its content is not that of its `{files.DIGEST}`); restore it"
        )
    return revision


def _with_measurements(
    directory: Path, history: TableHistory, tables: Sequence[Path], stored: Sequence[StoredEvidence | None]
) -> TableHistory:
    """A history with what its revisions took from flights, which makes the tables that are there.

    tables, stored : of the revisions, in their order
    raises         : InputError naming the revision
    """
    measured: list[FlownRatio] = []
    before = history.base
    for revision, path, evidence in zip(history.revisions, tables, stored, strict=True):
        name = display_path(revision_path(directory, revision.control_point, revision.revision, "json"))
        if evidence is not None:
            measured.append(evidence.measurement())
        table = read_ratio_table(path)
        if not _makes(history.base, measured, revision.reach, before, table):
            raise InputError(
                f"{name}: its evidence does not make the table {display_path(path)}; restore both files, or give the "
                "table a new `revision`"
            )
        before = table
    return replace(history, measured=tuple(measured))


def _makes(
    base: RatioTable, measured: Sequence[FlownRatio], reach: Mapping[str, float], parent: RatioTable, table: RatioTable
) -> bool:
    """Whether evidence makes a table, to rounding.

    base : the table before any of it;  parent : the table before the last of it
    """
    # relative differences of ratio and sigma by which a table may be away from what its evidence makes it: it is
    # rounded to 6 and 4 digits
    ratio_tolerance, sigma_tolerance = 1e-5, 2e-3
    rounding = 1e-6  # difference that counts as rounding, relative to the largest value of a table
    if any(not np.all(np.isin(a, b)) for a, b in zip(parent.axes, table.axes, strict=True)) or table.sigma is None:
        return False
    remade = posterior(on_axes(base, table.axes), [m.on(table.axes) for m in measured], reach)
    old = on_axes(parent, table.axes)
    assert old.sigma is not None  # of a table that was revised
    sigma = np.minimum(remade.sigma, old.sigma)
    return np.allclose(
        table.ratio, remade.ratio, rtol=ratio_tolerance, atol=rounding * np.abs(remade.ratio).max()
    ) and np.allclose(table.sigma, sigma, rtol=sigma_tolerance, atol=rounding * sigma.max())


def table_posterior(vehicle: Vehicle, point: str) -> Posterior | None:
    """A control point's table by its sigma column and the evidence of its revisions; None without a sigma column.

    raises : InputError where the table was changed after its revision was written
    """
    if (vehicle.directory / FOLDER / point).is_dir():
        history = read_history(vehicle, point)
        return None if history.base.sigma is None else history.posterior()
    table = vehicle.control_point(point).ratio
    return None if table.sigma is None else posterior(table, [])


def _refuse_half_restored(directory: Path, point: str, number: int) -> None:
    """Refuse a vehicle with the effects of the next revision and the table of this one, as where a table was put back
    by hand: the next update would count the effects twice."""
    following, file = revision_path(directory, point, number + 1, "json"), point_path(directory, point)
    if not following.is_file():
        return
    revision = _read_revision(following, point, number + 1)
    if revision.point_hash is not None and revision.point_hash == files.text_digest(files.raw_text(file)):
        kept = revision_path(directory, point, number, "toml")
        raise InputError(
            f"{display_path(file)}: has the effects of revision {number + 1}, and the table is that of revision "
            f"{number}; copy {display_path(kept)} over it"
        )


@contextmanager
def revising(directory: str | os.PathLike[str], progress: Progress = no_progress) -> Iterator[None]:
    """Keep other processes from revising a vehicle, from the reading of its tables to the writing of the next ones.

    progress : called where another process has to be waited for
    raises   : InputError where that does not end, or the vehicle cannot be written
    """
    text = f"waiting for another process that revises {display_path(directory)}"
    # the predictions of the other one may take minutes
    with files.exclusive(directory, wait_s=3600.0, waiting=lambda: progress(0.0, text)):
        yield


def write_revision(
    vehicle: Vehicle,
    history: TableHistory,
    table: RatioTable,
    content: Mapping[str, Any],
    point_texts: tuple[str, str],
    picture: bytes | None = None,
    turbulent: tuple[TableHistory, RatioTable] | None = None,
) -> RevisionFile:
    """Write the next revision, all files of it together: the old ones kept, its origin, the effects, and the tables.

    history     : as the table is now
    content     : the fields of a RevisionFile that do not follow from the files
    point_texts : the control point's file as it is now and as it is to be
    picture     : of the update; None where there is none
    turbulent   : the turbulent table as it is now and as it is to be; None where it stays
    raises      : InputError where tables or control point are no longer the given ones; nothing is written then
    """
    point, number = str(content["control_point"]), history.revision + 1
    before, after = point_texts
    with revising(vehicle.directory):
        _check_unchanged(vehicle, history, point, before, turbulent)
        text, effects = ratio_table_text(table, _short_axes(table)), after != before
        new: dict[Path, str | bytes] = {revision_path(Path(), point, history.revision, "csv"): history.raw}
        data = {**content, **_of_files(vehicle, history, text)}
        new[Path(data["table"])] = text
        data |= {
            "revision": number,
            "parent": history.revision,
            "point_parent_hash": files.text_digest(before) if effects else None,
            "point_hash": files.text_digest(after) if effects else None,
        }
        if turbulent is not None:
            old, revised = turbulent
            turbulent_text = ratio_table_text(revised, _short_axes(revised))
            data["turbulent"] = {**content["turbulent"], **_of_files(vehicle, old, turbulent_text)}
            new[revision_path(Path(), point, history.revision, TURBULENT)] = old.raw
            new[Path(data["turbulent"]["table"])] = turbulent_text
        revision = files.check(data, RevisionFile, f"revision {number}")
        new[revision_path(Path(), point, number, "json")] = files.json_text(files.with_digest(revision.model_dump()))
        if picture is not None:
            new[revision_path(Path(), point, number, "png")] = picture
        if effects:
            new[revision_path(Path(), point, history.revision, "toml")] = before
            new[point_path(Path(), point)] = after
        # what a revision left whose table was put back by hand is not part of this one
        stale = {revision_path(Path(), point, number, "png"), revision_path(Path(), point, history.revision, "toml")}
        files.replace_files(
            vehicle.directory, {p.as_posix(): c for p, c in new.items()}, [p.as_posix() for p in stale - new.keys()]
        )
    return revision


def _of_files(vehicle: Vehicle, history: TableHistory, text: str) -> dict[str, str]:
    """Path and hashes of a table that is replaced by another text."""
    return {
        "table": history.path.relative_to(vehicle.directory).as_posix(),
        "parent_hash": files.text_digest(history.raw),
        "table_hash": files.text_digest(text),
    }


def _check_unchanged(
    vehicle: Vehicle,
    history: TableHistory,
    point: str,
    point_text: str,
    turbulent: tuple[TableHistory, RatioTable] | None,
) -> None:
    """Check that tables, revisions and control point are still those that an update was worked out from."""
    now = read_history(vehicle, point)
    file = point_path(vehicle.directory, point)
    same = (now.raw, now.revisions, files.raw_text(file)) == (history.raw, history.revisions, point_text)
    turned = turbulent is not None and files.raw_text(turbulent[0].path) != turbulent[0].raw
    if not same or turned:
        changed = history.path if now.raw != history.raw else file
        if turbulent is not None and turned:
            changed = turbulent[0].path
        raise InputError(
            f"{display_path(changed)}: was changed while the update was worked out from revision {history.revision}; "
            "nothing was written, update again"
        )


def _short_axes(table: RatioTable) -> dict[str, str]:
    """Formats of the axes that read back equal without trailing zeros, so that unchanged rows keep their text."""
    axes = zip(RATIO_VARIABLES, table.axes, strict=True)
    return {name: "g" for name, axis in axes if all(float(f"{v:g}") == v for v in axis)}


def revert(directory: Path, point: str) -> tuple[int, int]:
    """Restore the parent of the newest revision, byte for byte, and remove the revision's files.

    directory : of the vehicle, whose tables need not be possible: a revision that made one impossible is undone too,
                and it is told what was wrong with it
    returns   : numbers of the revision undone and of the one in force
    raises    : InputError where there is no revision from flight data, or a file of it was changed since
    """
    with revising(directory):
        declared = _declared_points(directory, point)
        path = directory / _own_table(declared, point)
        raw = files.raw_text(path)
        number = _revision_number(path, files.read_csv_columns(path, ("ratio",), content=raw).header)
        file = revision_path(directory, point, number, "json")
        _refuse_half_restored(directory, point, number)
        if not file.is_file():
            raise InputError(f"{display_path(path)}: revision {number} was not made from flight data; kept")
        undone = _read_revision(file, point, number)
        kept, point_kept = (revision_path(Path(), point, undone.parent, kind) for kind in ("csv", "toml"))
        removed = [revision_path(Path(), point, undone.revision, kind) for kind in ("json", "png")]
        restored = {_below(directory, path): _parent_text(path, raw, directory / kept, file, undone)}
        problems = _table_problems(path, raw)
        turbulent = declared[point].ratio_table_turbulent
        if undone.turbulent is not None:
            if turbulent is None:
                raise InputError(
                    f"{display_path(point_path(directory, point))}: has no `ratio_table_turbulent`, which revision "
                    f"{number} revised; name {undone.turbulent.table} again"
                )
            path = directory / turbulent
            raw = files.raw_text(path)
            removed.append(revision_path(Path(), point, undone.parent, TURBULENT))
            restored[turbulent] = _parent_text(path, raw, directory / removed[-1], file, undone.turbulent)
            problems += _table_problems(path, raw)
        if undone.point_hash is not None:
            of_point = point_path(directory, point)
            restored[_below(directory, of_point)] = _point_before(of_point, directory / point_kept, undone)
        files.replace_files(directory, restored, [p.as_posix() for p in (kept, point_kept, *removed)])
    tell(f"{line}; revision {undone.revision}, which is undone, had it" for line in problems)
    return undone.revision, undone.parent


def _below(directory: Path, path: Path) -> str:
    return path.relative_to(directory).as_posix()


def _declared_points(directory: Path, point: str) -> dict[str, ControlPointFile]:
    """The files of all control points of a vehicle by name.

    raises : InputError with the most similar name where there is none of this one
    """
    paths = {p.stem: p for p in sorted(directory.glob("control_points/*.toml"))}
    if point not in paths:
        raise InputError(
            f"vehicle {real_path(directory).name}: there is no control point `{point}`{files.suggestion(point, paths)}"
        )
    return {name: files.read_toml(path, ControlPointFile) for name, path in paths.items()}


def _table_problems(path: Path, text: str) -> list[str]:
    """Why a table that a revision made cannot be; none where it can."""
    try:
        table_of_text(path, text)
    except InputError as error:
        return list(error.problems)
    return []


def _point_before(file: Path, kept: Path, undone: RevisionFile) -> str:
    """The control point's file before a revision.

    raises : InputError where a person has changed it since
    """
    text = files.raw_text(kept)
    if files.text_digest(text) != undone.point_parent_hash:
        raise InputError(
            f"{display_path(kept)}: is not the file that revision {undone.revision} was made from; restore it"
        )
    # A change made by hand since then would be lost.
    if files.text_digest(files.raw_text(file)) not in (undone.point_hash, undone.point_parent_hash):
        raise InputError(
            f"{display_path(file)}: was changed after revision {undone.revision}, which wrote effects into it; "
            "undo the change first, or it would be lost"
        )
    return text


def point_path(directory: Path, point: str) -> Path:
    """The file of a control point in a vehicle."""
    return directory / "control_points" / f"{point}.toml"


def revision_path(directory: Path, point: str, revision: int, kind: str) -> Path:
    """Path of a revision's tables (csv, TURBULENT), control point (toml), evidence (json) or picture (png)."""
    return directory / FOLDER / point / f"revision_{revision}.{kind}"
