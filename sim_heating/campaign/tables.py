"""The tables of a vehicle revised by the fits of a campaign, and what they predict before and after."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files import output_directory
from sim_heating.base.files.transaction import LOCK, STAGING
from sim_heating.base.progress import Progress
from sim_heating.campaign.manoeuvre_fits import usable
from sim_heating.campaign.result import CampaignResult
from sim_heating.closure.revise.report import update_tables
from sim_heating.inputs.points import point_with_vehicle_table
from sim_heating.inputs.record import in_segments, pooled_rmse_K
from sim_heating.inputs.vehicle import Vehicle, load_vehicle
from sim_heating.simulation.predict import predict

COMMAND = "campaign-tables"


def revise_tables(result: CampaignResult, doubts: Mapping[tuple[str, str], str], out: Path, progress: Progress) -> None:
    """Revise a copy of the vehicle in `out` by every fit that may, and predict every manoeuvre before and after.

    doubts : (flight, control point) -> why its fits should revise no table

    Where a fit of several flights is good it is taken in place of theirs. Rows of the revisions, of the fits that were
    refused and of the errors are added to the result.
    """
    vehicle = result.campaign.vehicle
    chosen = _chosen(result, doubts)
    with output_directory(out, COMMAND, inputs=result.campaign.files) as folder:
        place = folder / vehicle.directory.resolve().name
        shutil.copytree(vehicle.directory, place, ignore=shutil.ignore_patterns(LOCK, STAGING))
        for k, row in enumerate(chosen):
            title = f"{row['control_point']}, {row['group']}, {', '.join(row['flights'])}"
            progress(0.7 * k / len(chosen), title)
            try:
                updated = update_tables(result.out / row["folder"], place, root=result.campaign.root)
            except (InputError, RunError) as error:
                result.refused.append(f"{title}: {error}")
                continue
            made, update = updated.revision, updated.update
            assert made is not None
            result.updates.append({
                "control_point": row["control_point"],
                "manoeuvre": row["group"],
                "flights": row["flights"],
                "revision": made.revision,
                "parameters": {n: p.model_dump() for n, p in update.parameters.items()},
                "not_written": update.not_written,
                "chi_square": update.laminar.chi_square,
                "degrees_of_freedom": update.laminar.freedom,
            })  # fmt: skip
        progress(0.7, "predicting")
        _predict_all(result, load_vehicle(place), lambda done, text: progress(0.7 + 0.3 * done, text))


def _chosen(result: CampaignResult, doubts: Mapping[tuple[str, str], str]) -> list[dict[str, Any]]:
    """Rows of the fits that revise the tables: joint ones, and those of flights that are in none."""
    chosen, taken = [], set()
    for row in result.joint:
        why = usable(row)
        if why:
            result.refused.append(f"{row['control_point']}, {row['group']}, {', '.join(row['flights'])}: {why}")
            continue
        chosen.append(row)
        taken |= {(row["control_point"], row["group"], flight) for flight in row["flights"]}
    for row in result.fits:
        flight = row["flights"][0]
        if (row["control_point"], row["group"], flight) in taken:
            continue
        why = usable(row) or doubts.get((flight, row["control_point"]), "")
        if why:
            result.refused.append(f"{row['control_point']}, {row['manoeuvre']}, {flight}: {why}")
        else:
            chosen.append(row)
    order = {name: i for i, name in enumerate(result.points)}
    return sorted(chosen, key=lambda row: order[row["control_point"]])


def _predict_all(result: CampaignResult, revised: Vehicle, progress: Progress) -> None:
    """RMSE of each manoeuvre by the vehicle's tables before and after, of plain marches from entry interface."""
    points = {u["control_point"] for u in result.updates}
    marched = [(f, p, r) for f in result.flights for p, r in f.records.items() if p in points]
    for k, (flight, point, record) in enumerate(marched):
        progress(k / len(marched), f"{flight.name}, {point}")
        used = [i for i, s in enumerate(record.sensors) if s.used]
        residual = {}
        for when, vehicle in (("before", result.campaign.vehicle), ("after", revised)):
            model, flow = point_with_vehicle_table(record, vehicle)
            residual[when] = predict(record, model, flow=flow).residual_K[used]
        for manoeuvre in flight.manoeuvres:
            row = _row_of(result, flight.name, point, manoeuvre.name)
            segment = (manoeuvre.start_s, manoeuvre.end_s) if row is None else tuple(row["segments"][0])
            mask = in_segments(record.time_s, [segment])
            errors = {when: pooled_rmse_K(r, mask) for when, r in residual.items()}
            if errors["before"] is None or errors["after"] is None:
                continue
            result.errors.append({
                "flight": flight.name,
                "control_point": point,
                "manoeuvre": manoeuvre.name,
                "check": flight.name in result.checks,
                "before_K": errors["before"]["rmse_K"],
                "after_K": errors["after"]["rmse_K"],
                "fit_K": None if row is None or "failed" in row else row["rmse_K"],
                "noise_floor_K": record.noise_floor_K(mask),
            })  # fmt: skip


def _row_of(result: CampaignResult, flight: str, point: str, manoeuvre: str) -> dict[str, Any] | None:
    """The fit of one manoeuvre of one flight."""
    return next(
        (r for r in result.fits if (r["flights"][0], r["control_point"], r["manoeuvre"]) == (flight, point, manoeuvre)),
        None,
    )
