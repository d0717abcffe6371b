"""From an estimate to the next revision of a control point's ratio table and effects: what changes, what that does to
errors, and writing it."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path, read_text, require_writable
from sim_heating.base.files.package import data_folders, package_version
from sim_heating.base.parameters import AT, EFFECT_PREFIX
from sim_heating.closure.revise.effects import FittedEffects, fitted_effects_of
from sim_heating.closure.revise.evidence import FlightEvidence, flight_evidence, is_effect
from sim_heating.closure.revise.revisions import (
    FOLDER,
    RevisionFile,
    TableHistory,
    UsedRecord,
    content_hash,
    point_path,
    read_history,
    revision_path,
    write_revision,
)
from sim_heating.estimation.report.estimate_file import (
    NAME,
    PAIR,
    Estimate,
    EstimatedParameter,
    correlations,
    inputs_hash,
    read_estimate,
)
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.ratio.uncertainty import CORRELATION_LENGTH, Posterior, posterior
from sim_heating.inputs.points import point_with_vehicle_table
from sim_heating.inputs.record import Record, load_record, pooled_rmse_K
from sim_heating.inputs.vehicle import FOLDER as VEHICLES
from sim_heating.inputs.vehicle import ControlPoint, Vehicle, load_vehicle, vehicle_directory
from sim_heating.simulation.predict import predict

RATIO_DIGITS, SIGMA_DIGITS = 6, 4
"""Significant digits of a changed node, far below any sigma."""
LEAST_SIGMA, HIGHEST = 1e-12, 1e3
"""Of an estimated ratio parameter: no flight tells one more closely, and none has such a value."""
SURPRISING = 1e-3
"""Chance of the evidence under the table's own sigma below which a person should look."""


@dataclass(frozen=True)
class TableUpdate:
    """An update that is not written yet.

    history       : the table in force and what made it
    informed      : the estimate as evidence
    before, after : posterior of the table without and with the estimate
    table         : the new revision, rounded
    effects       : what the estimate says of effects
    used          : the records behind the estimate
    """

    vehicle: Vehicle
    point: ControlPoint
    estimate: Estimate
    estimate_hash: str
    records: tuple[Record, ...]
    used: tuple[UsedRecord, ...]
    history: TableHistory
    informed: FlightEvidence
    before: Posterior
    after: Posterior
    table: RatioTable
    effects: FittedEffects

    @property
    def changed(self) -> NDArray[np.bool_]:
        """Which nodes of the grid have another ratio or sigma."""
        old = self.history.table
        assert old.sigma is not None
        assert self.table.sigma is not None
        return (old.ratio != self.table.ratio) | (old.sigma != self.table.sigma)

    @property
    def parameters(self) -> dict[str, EstimatedParameter]:
        """What was estimated of the ratio and of the effects that are written."""
        written = tuple(f"{EFFECT_PREFIX}{name}." for name in self.effects.written)
        return {n: p for n, p in self.estimate.parameters.items() if n.startswith(("ratio.", *written))}

    @property
    def not_written(self) -> dict[str, str]:
        """What was estimated and goes nowhere, with the reason."""
        return dict(sorted((self.informed.not_written | self.effects.not_written).items()))

    def parameter_views(self) -> list[tuple[str, float, float, float, float, float, float]]:
        """Each written parameter, value and sigma: of the estimate, of the table before, of the table after."""
        evidence, rows = self.informed.evidence, self.informed.rows
        if not evidence.names:
            return []
        value = evidence.value - self.informed.at_zero
        columns = [value, np.sqrt(np.diag(evidence.covariance))]
        for p in (self.before, self.after):
            columns += [rows @ p.ratio.ravel() - self.informed.at_zero, p.sigma_along(csr_array(rows))]
        return [(n, *map(float, c)) for n, *c in zip(evidence.names, *columns, strict=True)]  # type: ignore[misc]


def prepare_update(
    fit: str | os.PathLike[str],
    vehicle: str | os.PathLike[str],
    records: Sequence[str | os.PathLike[str]] = (),
    point_name: str | None = None,
) -> TableUpdate:
    """Work out the next revision of a vehicle's table and effects from an estimate.

    fit        : an estimate.json or its directory
    vehicle    : name or directory
    records    : directories of the estimate's records, where they are not where it says
    point_name : the control point, where the estimate is of several
    raises     : InputError where the two do not belong together or the estimate is in the table already
    """
    file = Path(fit) / NAME if Path(fit).is_dir() else Path(fit)
    whole = read_estimate(file)
    _refuse_unweighable(whole, display_path(file))
    estimate, loaded = _of_point(whole, _records(whole, file, records), point_name)
    ours = load_vehicle(vehicle)
    point = ours.control_point(loaded[0].declared.control_point)
    history = read_history(ours, point.name)
    used = tuple(_used(estimate, i, record) for i, record in enumerate(loaded))
    _refuse_twice(history, used)
    informed = flight_evidence(estimate, loaded, ours, point)
    earlier = [r.evidence.arrays() for r in history.revisions]
    before, after = posterior(history.base, earlier), posterior(history.base, [*earlier, informed.evidence])
    effects = fitted_effects_of(
        estimate, informed, after, point_path(ours.directory, point.name), point,
        _times(used), revision_path(Path(), point.name, history.revision + 1, "json").as_posix(),
    )  # fmt: skip
    table = _rounded(history.table, after, _header(history, estimate, used, point.name))
    update = TableUpdate(
        ours,
        point,
        estimate,
        content_hash(read_text(file)),
        tuple(loaded),
        used,
        history,
        informed,
        before,
        after,
        table,
        effects,
    )
    if not np.any(update.changed) and effects.text == effects.raw:
        raise InputError(
            f"{display_path(file)}: changes no node of {point.declared.ratio_table}; its bounds are too wide"
        )
    return update


def _records(estimate: Estimate, file: Path, given: Sequence[str | os.PathLike[str]]) -> list[Record]:
    """The estimate's records: as given, else where it says, from here or from beside it."""
    if given and len(given) != len(estimate.records):
        raise InputError(
            f"--record: {len(given)} given, the estimate is of {len(estimate.records)}; name each in order"
        )
    found = []
    for i, name in enumerate(estimate.records):
        places = [Path(given[i])] if given else [Path(name), file.parent / name]
        place = next((p for p in places if p.is_dir()), None)
        if place is None:
            raise InputError(
                f"{display_path(file)}: its record `{given[i] if given else name}` is not there; name it: --record"
            )
        found.append(load_record(place))
    return found


def _refuse_unweighable(estimate: Estimate, name: str) -> None:
    """raises : InputError where a ratio parameter has no value or sigma that a flight gives, or not all correlations"""
    labels = [label for label in estimate.parameters if label.startswith("ratio.")]
    for label in labels:
        value, sigma = estimate.parameters[label].value, estimate.parameters[label].sigma
        where = f"{name}, [parameters.{label}]"
        if abs(value) > HIGHEST:
            raise InputError(f"{where}: `value`: {value:g} is beyond {HIGHEST:g}, no heating ratio; estimate it anew")
        if label.partition(AT)[0] == "ratio.scale" and value <= -1.0:
            raise InputError(f"{where}: `value`: {value:g} leaves no heating (-1 is none at all); estimate it anew")
        if not LEAST_SIGMA <= sigma <= HIGHEST:
            span = f"{LEAST_SIGMA:g} to {HIGHEST:g}"
            raise InputError(f"{where}: `sigma`: {sigma:g} is not within {span} and weighs nothing; estimate it anew")
    of_one_point = [(a, b) for a, b in combinations(labels, 2) if a.partition(AT)[2] == b.partition(AT)[2]]
    pairs = [(f"{a}{PAIR}{b}", f"{b}{PAIR}{a}") for a, b in of_one_point]
    missing = [pair for pair, turned in pairs if not {pair, turned} & estimate.correlation.keys()]
    if missing:
        told = f"{len(missing)} of {len(pairs)} pairs are missing, `{missing[0]}` first"
        raise InputError(f"{name}, [correlation]: {told}; estimate it anew, or write 0 for what is uncorrelated")


def _of_point(estimate: Estimate, records: Sequence[Record], name: str | None) -> tuple[Estimate, list[Record]]:
    """An estimate's parameters and records of one control point; a parameter `a@P` of a joint fit is `a` of P.

    raises : InputError where there are several and none is named, or none of that name
    """
    points = list(dict.fromkeys(r.declared.control_point for r in records))
    if name is None and len(points) > 1:
        raise InputError(f"the estimate is of {', '.join(points)}; name one of them with --point")
    name = points[0] if name is None else name
    if name not in points or estimate.control_point not in (None, name):
        told = ", ".join(points if estimate.control_point is None else [estimate.control_point])
        raise InputError(f"the estimate is of {told}, not of {name}")
    mine = [i for i, r in enumerate(records) if r.declared.control_point == name]
    labels = _plain_names(estimate, name, alone=len(points) == 1)
    return estimate.model_copy(
        update={
            "records": [estimate.records[i] for i in mine],
            "segments": None if estimate.segments is None else [estimate.segments[i] for i in mine],
            "parameters": {stem: estimate.parameters[label] for label, stem in labels.items()},
            "effects": [e for e in estimate.effects if e.control_point in (None, name)],
            "correlation": correlations(tuple(labels.values()), estimate.covariance(tuple(labels))),
        }
    ), [records[i] for i in mine]


def _plain_names(estimate: Estimate, point: str, alone: bool) -> dict[str, str]:
    """Label -> name of the parameters of one control point; a clock's, a sensor's, and what is averaged over of others
    keep their labels, ratios and effects of others are left out."""
    names = {}
    for label in estimate.parameters:
        stem, _, owner = label.partition(AT)
        if owner == point or (alone and not owner):
            names[label] = stem
        elif not stem.startswith("ratio.") and not is_effect(stem):
            names[label] = label
    return names


def _used(estimate: Estimate, i: int, record: Record) -> UsedRecord:
    """A record by hash and fitted times.

    raises : InputError where its files are not those that were fitted
    """
    found, told = inputs_hash(record), estimate.inputs.get(estimate.records[i])
    if told is not None and told != found:
        raise InputError(f"{display_path(record.directory)}: was changed since the estimate; estimate it anew")
    segments = estimate.segments[i] if estimate.segments is not None else record.declared.segments.fit
    whole = [[float(record.time_s[0]), float(record.time_s[-1])]]
    return UsedRecord(record=record.name, inputs=found, segments=whole if segments is None else segments)


def _refuse_twice(history: TableHistory, used: Sequence[UsedRecord]) -> None:
    """Refuse data that are in the table already: they would count twice."""
    for revision in history.revisions:
        for old in revision.records:
            for new in used:
                shared = [s for s in new.segments for o in old.segments if s[0] <= o[1] and o[0] <= s[1]]
                if new.inputs == old.inputs and shared:
                    times = f"{shared[0][0]:g} to {shared[0][1]:g} s"
                    raise InputError(
                        f"{display_path(history.path)}: {new.record}, {times}, is in revision {revision.revision} "
                        f"already and "
                        "would count twice; revert that first"
                    )


def _rounded(old: RatioTable, after: Posterior, header: dict[str, str]) -> RatioTable:
    """The new table: changed nodes to a few digits, the others as they were, sigma nowhere larger."""
    assert old.sigma is not None
    ratio = _significant(after.ratio, RATIO_DIGITS)
    sigma = np.minimum(_significant(after.sigma, SIGMA_DIGITS), old.sigma)
    same = (ratio == _significant(old.ratio, RATIO_DIGITS)) & (sigma == _significant(old.sigma, SIGMA_DIGITS))
    return RatioTable(old.axes, np.where(same, old.ratio, ratio), np.where(same, old.sigma, sigma), header)


def _significant(values: FloatArray, digits: int) -> FloatArray:
    return np.array([float(f"{v:.{digits}g}") for v in values.ravel()]).reshape(values.shape)


def _times(used: Sequence[UsedRecord]) -> str:
    return "; ".join(f"{u.record} {', '.join(f'{a:g} to {b:g} s' for a, b in u.segments)}" for u in used)


def _header(history: TableHistory, estimate: Estimate, used: Sequence[UsedRecord], point: str) -> dict[str, str]:
    number = history.revision + 1
    values = {n: p for n, p in estimate.parameters.items() if n.startswith("ratio.") or is_effect(n)}
    return {
        **{key: value for key, value in history.table.header.items() if key != "made_from"},
        "revision": str(number),
        "parent_revision": str(history.revision),
        "revised_from": _times(used),
        "revised_parameters": "; ".join(f"{n} {p.value:.4g} +- {p.sigma:.2g}" for n, p in values.items()),
        "revised_inputs": " ".join(u.inputs for u in used),
        "revised_by": f"sim-heating {package_version()}",
        "evidence": f"{FOLDER}/{point}/revision_{number}.json",
    }


def errors_before_and_after(update: TableUpdate, records: Sequence[Record]) -> dict[str, dict[str, Any]]:
    """RMSE of plain predictions with table and effects in force and with the new ones, over fit and holdout.

    Everything else, the stack above all, is as the record declares, whatever else was estimated.
    raises : InputError where a record is of another control point, over another reference heating, or named twice
    """
    found: dict[str, dict[str, Any]] = {}
    for record in records:
        _check_comparable(update, record)
        if record.name in found:
            raise InputError(f"two records are named {record.name}; rename one")
        model, used = (
            point_with_vehicle_table(record, update.vehicle),
            [i for i, s in enumerate(record.sensors) if s.used],
        )
        revised = replace(model, ratio=update.table, effects=update.effects.after)
        residuals = {when: predict(record, m).residual_K[used] for when, m in (("before", model), ("after", revised))}
        masks = {"fit": record.fit_mask(), "holdout": record.holdout_mask()}
        found[record.name] = {
            part: {when: pooled_rmse_K(r, mask) for when, r in residuals.items()} for part, mask in masks.items()
        }
    return found


def _check_comparable(update: TableUpdate, record: Record) -> None:
    point = record.declared.control_point
    if point != update.point.name:
        raise InputError(f"{record.name}: is of {point}, the table is that of {update.point.name}")


Draw = Callable[[Path, TableUpdate], None]
"""Draws an update into a file."""


def check_target(vehicle: str | os.PathLike[str], out: Path | None) -> None:
    """Refuse to write where the revision would change data that came with the package, or an existing copy.

    raises : InputError that says what to do
    """
    directory = vehicle_directory(vehicle)
    if out is not None:
        if (out / directory.resolve().name).exists():
            copy = display_path(out / directory.resolve().name)
            raise InputError(f"--out {display_path(out)}: holds {copy} already; revise that one with --vehicle {copy}")
        return
    (installed, checkout), home = data_folders(VEHICLES), directory.resolve().parent
    by_name = directory.is_absolute() and Path(vehicle).name == os.fspath(vehicle)
    if home == installed or (home == checkout and by_name):
        raise InputError(
            f"vehicle {directory.name}: came with the package; name a folder for a copy of yours with --out"
        )
    require_writable(directory)


def write_update(
    update: TableUpdate, out: Path | None, errors: dict[str, dict[str, Any]], draw: Draw | None = None
) -> tuple[Path, RevisionFile]:
    """Write the revision into the vehicle, or into a copy of it in `out`; the vehicle's directory and what was written.

    draw   : draws the picture of the update into a file; without one there is no picture
    raises : InputError where the place cannot be written; nothing is left half-written
    """
    source = update.vehicle.directory
    try:
        if out is None:
            return source, _write(update, update.vehicle, update.history, errors, draw)
        return _write_copy(update, out / source.resolve().name, errors, draw)
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be written ({error.strerror}); choose another place") from None


def _write_copy(
    update: TableUpdate, target: Path, errors: dict[str, dict[str, Any]], draw: Draw | None
) -> tuple[Path, RevisionFile]:
    """Revise a copy of the vehicle, made aside and put in its place as a whole."""
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = Path(tempfile.mkdtemp(prefix=f".{target.name}.partial-", dir=target.parent))
    try:
        copy = load_vehicle(shutil.copytree(update.vehicle.directory, partial / target.name))
        made = _write(update, copy, read_history(copy, update.point.name), errors, draw)
        os.replace(partial / target.name, target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return target, made


def _write(
    update: TableUpdate, vehicle: Vehicle, history: TableHistory, errors: dict[str, dict[str, Any]], draw: Draw | None
) -> RevisionFile:
    picture = revision_path(vehicle.directory, update.point.name, history.revision + 1, "png")
    picture.parent.mkdir(parents=True, exist_ok=True)
    if draw is not None and np.any(update.changed):
        draw(picture, update)
    effects = update.effects
    point_text = effects.text if effects.text != effects.raw else None
    return write_revision(vehicle, history, update.table, _made(update, errors), point_text)


def _made(update: TableUpdate, errors: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """What a RevisionFile says beside the files themselves."""
    evidence, estimate = update.informed.evidence, update.estimate
    return {
        "control_point": update.point.name,
        "program": f"sim-heating {package_version()}",
        "estimate": update.estimate_hash,
        "records": [u.model_dump() for u in update.used],
        "reference_condition": dict(zip(RATIO_VARIABLES, estimate.reference_condition.values().tolist(), strict=True)),
        "parameters": {n: p.model_dump() for n, p in update.parameters.items()},
        "effects": update.effects.changes(),
        "not_written": update.not_written,
        "reach": CORRELATION_LENGTH,
        "chi_square": update.after.chi_square,
        "degrees_of_freedom": len(update.after.innovation),
        "evidence": {
            "names": list(evidence.names),
            **{key: getattr(evidence, key).tolist() for key in ("nodes", "H", "value", "covariance")},
        },
        "errors_K": errors,
        "changed": changed_nodes(update),
    }


def changed_nodes(update: TableUpdate) -> dict[str, list[float]]:
    """The nodes with another ratio or sigma: the five variables, ratio and sigma before and after, one entry a node."""
    old, new, which = update.history.table, update.table, update.changed
    assert old.sigma is not None
    assert new.sigma is not None
    grid = np.meshgrid(*old.axes, indexing="ij")
    columns = dict(zip(RATIO_VARIABLES, grid, strict=True))
    columns |= {"ratio_before": old.ratio, "ratio_after": new.ratio}
    columns |= {"sigma_before": old.sigma, "sigma_after": new.sigma}
    return {name: values[which].tolist() for name, values in columns.items()}
