"""The tables of a vehicle revised by the fits of a campaign, and what they predict before and after."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files import output_directory
from sim_heating.base.files.transaction import LOCK, STAGING
from sim_heating.base.progress import Progress
from sim_heating.campaign.manoeuvre_fits import usable
from sim_heating.campaign.result import CampaignResult
from sim_heating.closure.revise.errors import rmse_with_tables_K
from sim_heating.closure.revise.report import UpdatedTables, update_tables
from sim_heating.closure.revise.revisions import revert
from sim_heating.estimation.report.estimate_file import FittedStart, read_estimate
from sim_heating.inputs.record import Record
from sim_heating.inputs.vehicle import Vehicle, load_vehicle

COMMAND = "campaign-tables"
WORSE, NOTICED = 1.05, 2.0
"""A revision contradicts another flight where that is predicted by more than WORSE times the error before, and by more
than NOTICED noise floors."""


def revise_tables(result: CampaignResult, doubts: Mapping[tuple[str, str], str], out: Path, progress: Progress) -> None:
    """Revise a copy of the vehicle in `out` by every fit that may, and predict every manoeuvre before and after.

    doubts : (flight, control point) -> why its fits should revise no table

    Where a fit of several flights is good it is taken in place of theirs. A revision that contradicts another flight is
    undone. Rows of the revisions, of the fits that were refused and of the errors are added to the result.
    """
    vehicle = result.campaign.vehicle
    chosen = _chosen(result, doubts)
    with output_directory(out, COMMAND, inputs=result.campaign.files) as folder:
        directory = folder / vehicle.directory.resolve().name
        shutil.copytree(vehicle.directory, directory, ignore=shutil.ignore_patterns(LOCK, STAGING))
        for k, row in enumerate(chosen):
            title, others = _title(row), _other_flights(result, row)
            progress(0.7 * k / len(chosen), title)
            try:
                updated = update_tables(result.out / row["folder"], directory, checks=others, root=result.campaign.root)
            except (InputError, RunError) as error:
                result.refused.append(f"{title}: {error}")
                continue
            against = _contradicted(updated, others)
            if against:
                revert(directory, row["control_point"])
                result.refused.append(f"{title}: {against}")
            else:
                result.updates.append(_update_row(row, updated))
        progress(0.7, "predicting")
        _predict_all(result, load_vehicle(directory), lambda done, text: progress(0.7 + 0.3 * done, text))


def _title(row: Mapping[str, Any]) -> str:
    return f"{row['control_point']}, {row['group']}, {', '.join(row['flights'])}"


def _update_row(row: Mapping[str, Any], updated: UpdatedTables) -> dict[str, Any]:
    """A revision as a row of the campaign."""
    revision, update = updated.revision, updated.update
    assert revision is not None
    return {
        "control_point": row["control_point"],
        "manoeuvre": row["group"],
        "flights": row["flights"],
        "revision": revision.revision,
        "parameters": {n: p.model_dump() for n, p in update.parameters.items()},
        "not_written": update.not_written,
        "held": {name: withheld.model_dump() for name, withheld in updated.held.items()},
        "chi_square": revision.chi_square,
        "degrees_of_freedom": revision.degrees_of_freedom,
    }


def _other_flights(result: CampaignResult, row: Mapping[str, Any]) -> list[Record]:
    """Records of the flights that a fit does not have, at its control point, each manoeuvre by itself."""
    point = row["control_point"]
    records = []
    for fit in result.fits:
        flight = fit["flights"][0]
        if fit["control_point"] == point and flight not in row["flights"] and not usable(fit):
            record = next(f for f in result.flights if f.name == flight).records[point].with_fit(fit["segments"])
            records.append(replace(record, label=_label(fit)))
    return records


def _label(fit: Mapping[str, Any]) -> str:
    return f"{fit['flights'][0]}/{fit['manoeuvre']}"


def _contradicted(updated: UpdatedTables, others: Sequence[Record]) -> str:
    """Which manoeuvre of another flight a revision predicts worse than the tables before, in words; empty for none."""
    worst, reason = 1.0, ""
    for record in others:
        errors = updated.errors_K[record.name]["fit"]
        if errors["before"] is None or errors["after"] is None:
            continue
        before, after = errors["before"]["rmse_K"], errors["after"]["rmse_K"]
        if after > max(WORSE * before, NOTICED * record.noise_floor_K()) and after / before > worst:
            worst = after / before
            reason = (
                f"not written, as {record.name} would be predicted to {after:.1f} K in place of {before:.1f} K: the "
                "flights contradict each other"
            )
    return reason


def _chosen(result: CampaignResult, doubts: Mapping[tuple[str, str], str]) -> list[dict[str, Any]]:
    """Rows of the fits that revise the tables: joint ones, and those of flights that are in none."""
    chosen, covered = [], set()
    for row in result.joint:
        why = usable(row)
        if why:
            result.refused.append(f"{_title(row)}: {why}")
            continue
        chosen.append(row)
        covered |= {(row["control_point"], row["group"], flight) for flight in row["flights"]}
    for row in result.fits:
        flight = row["flights"][0]
        if (row["control_point"], row["group"], flight) in covered:
            continue
        why = usable(row) or doubts.get((flight, row["control_point"]), "")
        if why:
            result.refused.append(f"{row['control_point']}, {row['manoeuvre']}, {flight}: {why}")
        else:
            chosen.append(row)
    order = {name: i for i, name in enumerate(result.points)}
    return sorted(chosen, key=lambda row: order[row["control_point"]])


def _predict_all(result: CampaignResult, revised: Vehicle, progress: Progress) -> None:
    """RMSE of each manoeuvre by the vehicle's tables before and after.

    Of plain marches from entry interface, and for fitted ones from the temperatures at the start of the fit.
    """
    points = {u["control_point"] for u in result.updates}
    marched = [(f, p, r, m) for f in result.flights for p, r in f.records.items() if p in points for m in f.manoeuvres]
    for k, (flight, point, record, manoeuvre) in enumerate(marched):
        progress(k / len(marched), f"{flight.name}, {point}")
        row = _row_of(result, flight.name, point, manoeuvre.name)
        segment = [manoeuvre.start_s, manoeuvre.end_s] if row is None else row["segments"][0]
        if record.read_mask[(record.time_s >= segment[0]) & (record.time_s <= segment[1])].any():
            result.errors.append(
                {
                    "flight": flight.name,
                    "control_point": point,
                    "manoeuvre": manoeuvre.name,
                    "check": flight.name in result.checks,
                    **_errors_of(record.with_fit([segment]), row, result, revised),
                }
            )


def _errors_of(
    chosen: Record, row: Mapping[str, Any] | None, result: CampaignResult, revised: Vehicle
) -> dict[str, float | None]:
    """RMSE [K] of the readings of a manoeuvre before, after and by its fit, and the floor of their noise.

    row : of the fit; None for a manoeuvre without one
    """
    tables = {"before": result.campaign.vehicle, "after": revised}
    errors: dict[str, float | None] = {f"{when}_K": rmse_with_tables_K(chosen, v) for when, v in tables.items()}
    fitted = None if row is None or "failed" in row else row
    start = None if fitted is None else _start(result, fitted)
    for when, vehicle in tables.items():
        errors[f"{when}_from_start_K"] = None if start is None else rmse_with_tables_K(chosen, vehicle, start)
    return errors | {"fit_K": None if fitted is None else fitted["rmse_K"], "noise_floor_K": chosen.noise_floor_K()}


def _start(result: CampaignResult, row: Mapping[str, Any]) -> FittedStart | None:
    """Where the march of a fit began; None at the first conditions."""
    starts = read_estimate(result.out / row["folder"]).starts
    return None if not starts else starts[0]


def _row_of(result: CampaignResult, flight: str, point: str, manoeuvre: str) -> dict[str, Any] | None:
    """The fit of one manoeuvre of one flight."""
    return next(
        (r for r in result.fits if (r["flights"][0], r["control_point"], r["manoeuvre"]) == (flight, point, manoeuvre)),
        None,
    )
