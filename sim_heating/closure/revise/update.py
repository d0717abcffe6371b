"""The next revision of a control point's ratio tables and effects from an estimate: the changes, and writing them."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.base.files import Roots, display_path, exclusive, read_text, roots_of, text_digest
from sim_heating.base.files.package import data_folders, package_version
from sim_heating.base.files.paths import make_durable, os_error_reason, real_path
from sim_heating.base.files.transaction import LOCK, STAGING, staged
from sim_heating.base.parameters import AT, EFFECT_PREFIX
from sim_heating.closure.result import PARTLY, UNKNOWN
from sim_heating.closure.revise.checks import check_estimate
from sim_heating.closure.revise.effects import FittedEffects, effects_from_fit
from sim_heating.closure.revise.evidence import FlightEvidence, flight_evidence, is_effect
from sim_heating.closure.revise.flown_ratio import FlownRatio, added_nodes, axes_for
from sim_heating.closure.revise.revision_file import RevisionFile, UsedRecord, stored_evidence
from sim_heating.closure.revise.revisions import (
    FOLDER,
    TableHistory,
    point_path,
    read_history,
    read_turbulent_history,
    revision_path,
    write_revision,
)
from sim_heating.estimation.report.estimate_file import (
    Estimate,
    EstimatedParameter,
    correlations,
    estimate_path,
    read_estimate,
)
from sim_heating.heating.edge_flow import Atoms, EdgeFlow, edge_flow
from sim_heating.heating.ratio.table import RatioTable, is_below_zero, node_in_words
from sim_heating.heating.ratio.uncertainty import UPDATE_REACH, Posterior, on_axes, posterior
from sim_heating.inputs.record import Record, load_record, load_records, named_apart, record_digest
from sim_heating.inputs.vehicle import FOLDER as VEHICLES
from sim_heating.inputs.vehicle import ControlPoint, Vehicle, load_vehicle, vehicle_directory


@dataclass(frozen=True, eq=False)
class TableChange:
    """What an update makes of one table.

    history       : the table in force with its revisions
    before, after : posterior of the table without and with the estimate, on the axes of the new revision
    table         : the new revision, rounded
    chi_square    : of all estimates against the table before any of them, by its sigma and CORRELATION_LENGTH [-]
    freedom       : number of combinations of nodes behind it
    """

    history: TableHistory
    before: Posterior
    after: Posterior
    table: RatioTable
    chi_square: float
    freedom: int

    @property
    def old(self) -> RatioTable:
        """The table in force, on the axes of the new revision."""
        return on_axes(self.history.table, self.table.axes)

    @property
    def changed(self) -> NDArray[np.bool_]:
        """Mask of the nodes of the new grid with another ratio or sigma."""
        old = self.old
        assert old.sigma is not None
        assert self.table.sigma is not None
        return (old.ratio != self.table.ratio) | (old.sigma != self.table.sigma)

    @property
    def nodes_added(self) -> dict[str, list[float]]:
        """Variable -> places of the nodes that the table in force has not, [deg] and [-]."""
        return added_nodes(self.history.table.axes, self.table.axes)

    @property
    def is_change(self) -> bool:
        """Whether the new revision differs."""
        return bool(np.any(self.changed)) or bool(self.nodes_added)

    @property
    def p_value(self) -> float:
        """Probability [-] of a larger chi-square if sigma and bounds are right; docs/theory/equations.md, 17."""
        return float(chdtrc(self.freedom, self.chi_square))

    def changed_nodes(self) -> dict[str, list[float]]:
        """The nodes with another ratio or sigma: the five variables, ratio and sigma before and after, one entry a
        node."""
        old, new, which = self.old, self.table, self.changed
        assert old.sigma is not None
        assert new.sigma is not None
        grid = np.meshgrid(*new.axes, indexing="ij")
        columns = dict(zip(RATIO_VARIABLES, grid, strict=True))
        columns |= {"ratio_before": old.ratio, "ratio_after": new.ratio}
        columns |= {"sigma_before": old.sigma, "sigma_after": new.sigma}
        return {name: values[which].tolist() for name, values in columns.items()}


@dataclass(frozen=True, repr=False)
class TableUpdate:
    """An update of the tables and effects of a control point that is not written yet.

    estimate_hash : of the estimate's file
    records, used : the records behind the estimate, with the segments that were fitted; their hashes and times
    flight        : the estimate as evidence
    laminar       : the ratio table;  turbulent : the turbulent one, None where it stays
    effects       : the effects by the estimate
    """

    vehicle: Vehicle
    point: ControlPoint
    estimate: Estimate
    estimate_hash: str
    records: tuple[Record, ...]
    used: tuple[UsedRecord, ...]
    flight: FlightEvidence
    laminar: TableChange
    turbulent: TableChange | None
    effects: FittedEffects

    @property
    def history(self) -> TableHistory:
        """The ratio table in force with its revisions."""
        return self.laminar.history

    @property
    def table(self) -> RatioTable:
        """The new revision of the ratio table."""
        return self.laminar.table

    @property
    def changes(self) -> tuple[TableChange, ...]:
        """Changes of the ratio table, and of the turbulent one where it is revised."""
        return (self.laminar,) if self.turbulent is None else (self.laminar, self.turbulent)

    @property
    def parameters(self) -> dict[str, EstimatedParameter]:
        """Estimates of the ratio and of the effects that are written, into the table or as effects."""
        in_table = (u.effect.name for u in self.flight.in_table)
        written = tuple(f"{EFFECT_PREFIX}{name}." for name in (*self.effects.written, *in_table))
        return {n: p for n, p in self.estimate.parameters.items() if n.startswith(("ratio.", *written))}

    @property
    def flow_after(self) -> EdgeFlow:
        """What the revised effects ask of the flow at the edge of the point, with the revised tables."""
        # Without a declaration of its own an added recombination has the oxygen of the edge, as where a file adds it.
        old = self.point.flow
        atoms: Atoms = "edge-oxygen" if old.atoms == "none" else old.atoms
        tables = (self.table, old.turbulent if self.turbulent is None else self.turbulent.table)
        return edge_flow(self.effects.after, self.point.recovery, self.point.running_length_m, atoms, tables)

    @property
    def not_written(self) -> dict[str, str]:
        """Estimated parameters and effects that are not written, with the reason."""
        return dict(sorted((self.flight.not_written | self.effects.not_written).items()))

    def parameter_comparison(self) -> list[tuple[str, float, float, float, float, float, float]]:
        """Each parameter of the linear model, value and sigma: of the estimate, of the tables before, of them after."""
        evidence = self.flight.evidence
        if not evidence.names:
            return []
        columns = [self.estimate.values(evidence.names), np.sqrt(np.diag(evidence.covariance))]
        turned = self.turbulent
        before = (self.laminar.before, None if turned is None else turned.before)
        after = (self.laminar.after, None if turned is None else turned.after)
        columns += self.flight.parameters_of(*before, with_effects=False)
        columns += self.flight.parameters_of(*after, with_effects=True)
        return [(n, *map(float, c)) for n, *c in zip(evidence.names, *columns, strict=True)]  # type: ignore[misc]

    def __repr__(self) -> str:
        nodes = sum(int(np.count_nonzero(c.changed)) for c in self.changes)
        return f"<TableUpdate of {self.point.name} from revision {self.history.revision}: {nodes} nodes change>"


def prepare_update(
    fit: str | os.PathLike[str],
    vehicle: str | os.PathLike[str],
    records: Sequence[str | os.PathLike[str]] = (),
    point_name: str | None = None,
    root: str | os.PathLike[str] | None = None,
    *,
    accept_partly: bool = False,
) -> TableUpdate:
    """The next revision of a vehicle's table and effects from an estimate.

    fit        : an estimate.json or its directory
    vehicle    : name or directory
    records    : directories of the estimate's records, where they are not where the estimate states
    point_name : the control point, where the estimate is of several
    root       : folder that the estimate may name records in, as `load_scenario` takes it
    accept_partly : take what a closed loop only resembles as if it were its cause
    raises     : InputError where the two do not belong together or the estimate is already in the table
    """
    file = estimate_path(fit)
    complete = read_estimate(file)
    check_estimate(complete, display_path(file))
    if not accept_partly:
        _check_cause(complete, display_path(file))
    loaded_vehicle = load_vehicle(vehicle, root=root)
    roots = roots_of(file, root, loaded_vehicle.directory)
    estimate, loaded = _select_point(complete, _records(complete, roots, records, root), point_name)
    point = loaded_vehicle.control_point(loaded[0].declared.control_point)
    history = read_history(loaded_vehicle, point.name)
    used = tuple(_used_record(estimate, display_path(file), i, record) for i, record in enumerate(loaded))
    loaded = [as_fitted(record, u.segments) for record, u in zip(loaded, used, strict=True)]
    _check_not_repeated(used)
    _check_not_used(history, used)
    turbulent = read_turbulent_history(loaded_vehicle, history, point.name)
    # Of the tables before any revision, so that the evidence of a flight does not depend on other flights.
    revisable = turbulent if isinstance(turbulent, TableHistory) else None
    base = None if revisable is None else revisable.base
    flight = flight_evidence(estimate, loaded, loaded_vehicle, point, history.base, base)
    header = _header(history, estimate, used, point.name)
    laminar, turned = _change(history, flight.laminar, header), None
    if revisable is not None and flight.turbulent is not None:
        turned = _change(revisable, flight.turbulent, header)
    for change in filter(None, (laminar, turned)):
        _check_film_coefficients(change, display_path(file))
    effects = effects_from_fit(
        estimate,
        flight,
        laminar.after,
        None if turned is None else turned.after,
        point_path(loaded_vehicle.directory, point.name),
        point,
        _times(used),
        revision_path(Path(), point.name, history.revision + 1, "json").as_posix(),
    )
    update = TableUpdate(
        loaded_vehicle,
        point,
        estimate,
        text_digest(read_text(file)),
        tuple(loaded),
        used,
        flight,
        laminar,
        turned,
        effects,
    )
    if not any(c.is_change for c in update.changes) and effects.text == effects.raw:
        raise InputError(
            f"{display_path(file)}: changes no node of {point.declared.ratio_table}; its bounds are too wide"
        )
    return update


def _check_cause(estimate: Estimate, name: str) -> None:
    """Check that an estimate's closed loop states its cause; `name` is that of its file."""
    if estimate.finding in (PARTLY, UNKNOWN):
        raise InputError(
            f"{name}: its closed loop ends with `{estimate.finding}`: what its model has is not stated "
            "as the cause of the residual; give --accept-partly to write it nevertheless"
        )


def _change(history: TableHistory, measured: FlownRatio | None, header: dict[str, str]) -> TableChange:
    """The next revision of a table.

    measured : the ratio of the fit; None where the fit says nothing of this table
    header   : provenance of the revision
    """
    axes = history.table.axes if measured is None else axes_for(measured, history.table.axes)
    base, every = on_axes(history.base, axes), [*history.measured, *([] if measured is None else [measured])]
    # From the first table and all evidence, so that the order of updates does not matter: the sigma column alone
    # forgets how the errors of nodes are correlated (decision 0006).
    before = posterior(base, [m.on(axes) for m in history.measured], UPDATE_REACH)
    after = before if measured is None else posterior(base, [m.on(axes) for m in every], UPDATE_REACH)
    # A test of the table, and so with the correlation of its errors rather than with the reach of an update.
    tested = posterior(base, [m.combinations(axes) for m in every])
    table = _round_table(
        on_axes(history.table, axes),
        after,
        {k: v for k, v in history.table.header.items() if k != "made_from"} | header,
    )
    return TableChange(history, before, after, table, tested.chi_square, len(tested.innovation))


def _check_film_coefficients(change: TableChange, fit: str) -> None:
    """Refuse a revision with a ratio that no reader of the table would take.

    raises : InputError with the file of the fit, the table, and the most negative such node
    """
    table = change.table
    assert table.sigma is not None
    below = is_below_zero(table.ratio, table.sigma)
    if not np.any(below):
        return
    node = int(np.argmin(np.where(below, table.ratio, 0.0)))
    count = f", one of {np.count_nonzero(below)} such nodes" if np.count_nonzero(below) > 1 else ""
    raise InputError(
        f"{fit}: makes the ratio {table.ratio.flat[node]:.3g} at {node_in_words(table, node)} of "
        f"{display_path(change.history.path)}{count}, with sigma {table.sigma.flat[node]:.2g}; film coefficients are "
        "not negative. Nothing was written; estimate it again, with a prior or without the derivative that does it"
    )


def _records(
    estimate: Estimate,
    roots: Roots,
    stated: Sequence[str | os.PathLike[str]],
    root: str | os.PathLike[str] | None,
) -> list[Record]:
    """The estimate's records: as given, else where it states, relative to here or to its own file."""
    if not stated:
        return named_apart([stated_record(estimate, i, roots, root) for i in range(len(estimate.records))])
    if len(stated) != len(estimate.records):
        raise InputError(
            f"--record: {len(stated)} given, the estimate is of {len(estimate.records)}; name each in order"
        )
    for folder in stated:
        if not os.path.isdir(folder):
            raise _no_record(roots.file, os.fspath(folder))
    return load_records(stated, root=root)


def stated_record(estimate: Estimate, i: int, roots: Roots, root: str | os.PathLike[str] | None) -> Record:
    """A record where the estimate states, in a folder that it may name or with the files that were fitted."""
    name = estimate.records[i]
    folder = next((f for f in (Path(), roots.file.parent) if os.path.isdir(f / name)), None)
    if folder is None:
        raise _no_record(roots.file, name)
    try:
        path = roots.named(name, f"`records`, item {i + 1}", folder)
    except InputError as outside:
        # An estimate is often made of records elsewhere. The digest shows that whoever wrote it knew their content;
        # nothing is said about files that do not have it.
        try:
            record = load_record(folder / name)
            if estimate.inputs.get(name) == record_digest(record):
                return record
        except InputError:
            pass
        raise outside from None
    return load_record(path, root=root)


def _no_record(file: Path, name: str) -> InputError:
    return InputError(f"{display_path(file)}: its record `{name}` does not exist; give its directory with --record")


def _select_point(estimate: Estimate, records: Sequence[Record], name: str | None) -> tuple[Estimate, list[Record]]:
    """Parameters and records of one control point; a parameter `a@P` of a joint fit is `a` of P.

    raises : InputError where there are several and none is named, or none of that name
    """
    points = list(dict.fromkeys(r.declared.control_point for r in records))
    if name is None and len(points) > 1:
        raise InputError(f"the estimate is of {', '.join(points)}; name one of them with --point")
    name = points[0] if name is None else name
    if name not in points or estimate.control_point not in (None, name):
        listed = ", ".join(points if estimate.control_point is None else [estimate.control_point])
        raise InputError(f"the estimate is of {listed}, not of {name}")
    indices = [i for i, r in enumerate(records) if r.declared.control_point == name]
    labels = _plain_names(estimate, name, alone=len(points) == 1)

    def chosen(entries: Sequence[Any] | None) -> list[Any] | None:
        return None if entries is None else [entries[i] for i in indices]

    return estimate.model_copy(
        update={
            "records": chosen(estimate.records),
            "segments": chosen(estimate.segments),
            "starts": chosen(estimate.starts),
            "parameters": {stem: estimate.parameters[label] for label, stem in labels.items()},
            "effects": [e for e in estimate.effects if e.control_point in (None, name)],
            "correlation": correlations(tuple(labels.values()), estimate.covariance(tuple(labels))),
        }
    ), [records[i] for i in indices]


def _plain_names(estimate: Estimate, point: str, alone: bool) -> dict[str, str]:
    """Label -> name of the parameters of one control point.

    Parameters of clocks, of sensors and marginalised ones of other points keep their labels; ratios and effects of
    other points are left out.
    """
    names = {}
    for label in estimate.parameters:
        stem, _, owner = label.partition(AT)
        if owner == point or (alone and not owner):
            names[label] = stem
        elif not stem.startswith("ratio.") and not is_effect(stem):
            names[label] = label
    return names


def _used_record(estimate: Estimate, name: str, i: int, record: Record) -> UsedRecord:
    """A record by hash and fitted times; `name` is that of the estimate's file.

    raises : InputError where its files are not those that were fitted, or the estimate does not state which they were
    """
    digest, stated = record_digest(record), estimate.inputs.get(estimate.records[i])
    if stated is None:
        raise InputError(
            f"{name}: `inputs` has no entry for its record {estimate.records[i]}, so that nothing shows whether it is "
            "still the one that was fitted; estimate again"
        )
    if stated != digest:
        raise InputError(f"{display_path(record.directory)}: was changed since the estimate; estimate it again")
    segments = estimate.segments[i] if estimate.segments is not None else record.declared.segments.fit
    record_span = [[float(record.time_s[0]), float(record.time_s[-1])]]
    return UsedRecord(record=record.name, inputs=digest, segments=record_span if segments is None else segments)


def as_fitted(record: Record, segments: list[list[float]]) -> Record:
    """A record whose fit segments are those of the estimate."""
    declared = record.declared.segments.model_copy(update={"fit": segments})
    return replace(record, declared=record.declared.model_copy(update={"segments": declared}))


def _shared(first: UsedRecord, other: UsedRecord) -> str | None:
    """Times of one record that are also of another, in words; None where they are of other files or times."""
    pairs = ((a, b) for a in first.segments for b in other.segments)
    shared = [a for a, b in pairs if a[0] <= b[1] and b[0] <= a[1]]
    return f"{shared[0][0]:g} to {shared[0][1]:g} s" if shared and first.inputs == other.inputs else None


def _check_not_repeated(used: Sequence[UsedRecord]) -> None:
    """Check that no two records of the estimate are copies: their data would count twice.

    raises : InputError naming both and the times
    """
    for first, other in combinations(used, 2):
        if times := _shared(first, other):
            raise InputError(
                f"records {first.record} and {other.record} of the estimate are copies; {times} would count twice: "
                "estimate again with one of them"
            )


def _check_not_used(history: TableHistory, used: Sequence[UsedRecord]) -> None:
    """Check that data are not in the table already: they would count twice.

    raises : InputError naming record, times and revision
    """
    for revision in history.revisions:
        for old in revision.records:
            for new in used:
                if times := _shared(new, old):
                    raise InputError(
                        f"{display_path(history.path)}: {new.record}, {times}, is in revision {revision.revision} "
                        "already and would count twice; revert that first"
                    )


def _round_table(old: RatioTable, updated: Posterior, header: dict[str, str]) -> RatioTable:
    """The new table: changed nodes to a few digits, the others as they were, sigma nowhere larger."""
    ratio_digits, sigma_digits = 6, 4  # significant digits of a changed node, far below any sigma
    assert old.sigma is not None
    ratio = _significant(updated.ratio, ratio_digits)
    # Data never make a node less certain; rounding up must not either.
    sigma = np.minimum(_significant(updated.sigma, sigma_digits), old.sigma)
    # Compared as rounded: nodes beyond the reach of the correlation keep every digit of their file.
    same = (ratio == _significant(old.ratio, ratio_digits)) & (sigma == _significant(old.sigma, sigma_digits))
    return RatioTable(old.axes, np.where(same, old.ratio, ratio), np.where(same, old.sigma, sigma), header)


def _significant(values: FloatArray, digits: int) -> FloatArray:
    """Values rounded to significant digits."""
    return np.array([float(f"{v:.{digits}g}") for v in values.ravel()]).reshape(values.shape)


def _times(used: Sequence[UsedRecord]) -> str:
    """Records with their fitted times, in words."""
    return "; ".join(f"{u.record} {', '.join(f'{a:g} to {b:g} s' for a, b in u.segments)}" for u in used)


def _header(history: TableHistory, estimate: Estimate, used: Sequence[UsedRecord], point: str) -> dict[str, str]:
    """Provenance of a revision, for the header of a table."""
    number = history.revision + 1
    values = {n: p for n, p in estimate.parameters.items() if n.startswith("ratio.") or is_effect(n)}
    return {
        "revision": str(number),
        "parent_revision": str(history.revision),
        "revised_from": _times(used),
        "revised_parameters": "; ".join(f"{n} {p.value:.4g} +- {p.sigma:.2g}" for n, p in values.items()),
        "revised_inputs": " ".join(u.inputs for u in used),
        "revised_by": f"sim-heating {package_version()}",
        "evidence": f"{FOLDER}/{point}/revision_{number}.json",
    }


Draw = Callable[[Path, TableUpdate], None]
"""Function that draws an update into a file."""


def check_target(vehicle: str | os.PathLike[str], out: Path | None) -> None:
    """Refuse to write where the revision would change data that came with the package, or an existing copy.

    raises : InputError that states what to do
    """
    directory = vehicle_directory(vehicle)
    if out is not None:
        if (out / real_path(directory).name).exists():
            raise _exists(out, real_path(directory).name)
        return
    (installed, checkout), home = data_folders(VEHICLES), real_path(directory).parent
    by_name = directory.is_absolute() and Path(vehicle).name == os.fspath(vehicle)
    if home == installed or (home == checkout and by_name):
        raise InputError(f"vehicle {directory.name}: came with the package; name a folder for your copy with --out")


def _exists(out: Path, name: str) -> InputError:
    copy = display_path(out / name)
    return InputError(f"--out {display_path(out)}: already contains {copy}; revise that one with --vehicle {copy}")


def write_update(
    update: TableUpdate,
    out: Path | None,
    errors: dict[str, dict[str, Any]],
    draw: Draw | None = None,
    held: Mapping[str, dict[str, Any]] | None = None,
) -> tuple[Path, RevisionFile]:
    """Write the revision into the vehicle, or into a copy of it in `out`.

    out     : folder for the copy; None for the vehicle itself
    errors  : as `errors_before_and_after` gives them
    draw    : draws the picture of the update into a file; without one there is no picture
    held    : record of the estimate -> how well the tables hold the fit of it, the fields of `HeldFit`
    returns : the vehicle's directory, and what was written
    raises  : InputError where the place cannot be written, or the vehicle was changed since the update was prepared;
              nothing is written then
    """
    picture, content = _picture(update, draw), _revision_content(update, errors, held or {})
    try:
        if out is None:
            return update.vehicle.directory, _write(update, update.vehicle, content, picture)
        return _write_copy(update, out, content, picture)
    except OSError as error:
        path = display_path(error.filename or out or update.vehicle.directory)
        raise InputError(f"{path}: cannot be written ({os_error_reason(error)}); choose another place") from None


def _picture(update: TableUpdate, draw: Draw | None) -> bytes | None:
    """The picture of an update; None where no node changes."""
    if draw is None or not update.laminar.is_change:
        return None
    with tempfile.TemporaryDirectory() as folder:
        draw(Path(folder) / "picture.png", update)
        return (Path(folder) / "picture.png").read_bytes()


def _write_copy(
    update: TableUpdate, out: Path, content: dict[str, Any], picture: bytes | None
) -> tuple[Path, RevisionFile]:
    """Revise a copy of the vehicle, made in a staging directory and renamed as a whole."""
    source = real_path(update.vehicle.directory)
    with exclusive(out) as folder, staged(folder) as staging:
        copy = staging / source.name
        shutil.copytree(source, copy, ignore=shutil.ignore_patterns(LOCK, STAGING))
        revision = _write(update, load_vehicle(copy), content, picture)
        for path in (*copy.rglob("*"), copy):
            make_durable(path)
        if os.path.lexists(folder / source.name):
            raise _exists(out, source.name)
        os.replace(copy, folder / source.name)
        make_durable(folder)
    return out / source.name, revision


def _write(update: TableUpdate, vehicle: Vehicle, content: dict[str, Any], picture: bytes | None) -> RevisionFile:
    """Write the revision into a vehicle, which may be a copy of the one that the update is of."""
    history = replace(update.history, path=vehicle.directory / update.point.declared.ratio_table)
    texts, turbulent = (update.effects.raw, update.effects.text), None
    if update.turbulent is not None:
        path = vehicle.directory / str(update.point.declared.ratio_table_turbulent)
        turbulent = (replace(update.turbulent.history, path=path), update.turbulent.table)
    return write_revision(vehicle, history, update.table, content, texts, picture, turbulent)


def _revision_content(
    update: TableUpdate, errors: dict[str, dict[str, Any]], held: Mapping[str, dict[str, Any]]
) -> dict[str, Any]:
    """The fields of a RevisionFile that do not follow from the files."""
    estimate, turbulent = update.estimate, update.turbulent
    return {
        "control_point": update.point.name,
        "program": f"sim-heating {package_version()}",
        "estimate": update.estimate_hash,
        "records": [u.model_dump() for u in update.used],
        "reference_condition": dict(zip(RATIO_VARIABLES, estimate.reference_condition.values().tolist(), strict=True)),
        "parameters": {n: p.model_dump() for n, p in update.parameters.items()},
        "effects": update.effects.changes(),
        "in_table": [{"name": u.effect.name, "parameters": u.by_name, "before": None} for u in update.flight.in_table],
        "not_written": update.not_written,
        "reach": UPDATE_REACH,
        "errors_K": errors,
        "held": dict(held),
        **_change_content(update.laminar, update.flight.laminar),
        "turbulent": None if turbulent is None else _change_content(turbulent, update.flight.turbulent),
    }


def _change_content(change: TableChange, measured: FlownRatio | None) -> dict[str, Any]:
    """The fields of one table."""
    return {
        "nodes_added": change.nodes_added,
        "chi_square": change.chi_square,
        "degrees_of_freedom": change.freedom,
        "evidence": stored_evidence(measured),
        "changed": change.changed_nodes(),
    }
