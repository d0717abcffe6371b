"""How well records are predicted with the tables before and after an update, by the fit itself, and what of the fit the
tables do not hold.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.parameters import AT, CLOCK_SKEW, EFFECT_PREFIX, RECORD_PARAMETERS, SENSOR_PREFIX
from sim_heating.closure.revise.evidence import OF_START, fitted_use, is_effect
from sim_heating.closure.revise.revision_file import HeldFit, holds
from sim_heating.closure.revise.update import TableUpdate
from sim_heating.estimation.record_fit import marched_from, sensor_errors
from sim_heating.estimation.report.estimate_file import FittedStart
from sim_heating.heating.edge_flow import EdgeFlow
from sim_heating.heating.effects import EffectUse, combined_uses
from sim_heating.inputs.points import flow_of_record, point_of_record, point_with_vehicle_table
from sim_heating.inputs.record import Record, pooled_rmse_K
from sim_heating.inputs.vehicle import Vehicle
from sim_heating.march.point import PointModel
from sim_heating.simulation.predict import predict

REST = "the form of its ratio between nodes, and heating of which nothing was read"
"""What is left where all else is added."""
NOT_MARCHED = (EFFECT_PREFIX, SENSOR_PREFIX, OF_START, *RECORD_PARAMETERS)
"""Begin of the names of what a fit has in addition to heating and stack; effects are passed as such."""


def errors_before_and_after(update: TableUpdate, records: Sequence[Record]) -> dict[str, dict[str, Any]]:
    """RMSE of plain predictions with tables and effects in force and with the new ones, over fit and holdout segments.

    Everything else, notably the stack, is as the record declares.
    returns : record -> segments -> before, after; None for segments that do not exist
    raises  : InputError where a record is of another control point, or over another reference heating
    """
    errors: dict[str, dict[str, Any]] = {}
    for record in records:
        if record.declared.control_point != update.point.name:
            point = record.declared.control_point
            raise InputError(f"{record.name}: is of {point}, the table is that of {update.point.name}")
        residuals = {when: _residual_K(record, *model) for when, model in _models(update, record).items()}
        masks = {"fit": record.fit_mask(), "holdout": record.holdout_mask()}
        errors[record.name] = {
            segment: {when: pooled_rmse_K(r, mask) for when, r in residuals.items()} for segment, mask in masks.items()
        }
    return errors


def _models(update: TableUpdate, record: Record) -> dict[str, tuple[PointModel, EdgeFlow]]:
    """The model of a record with the vehicle before and after, with what its effects ask of the flow at the edge."""
    model, flow = point_with_vehicle_table(record, update.vehicle)
    revised = replace(model, ratio=update.table, effects=update.effects.after)
    return {"before": (model, flow), "after": (revised, update.flow_after)}


def rmse_with_tables_K(record: Record, vehicle: Vehicle, start: FittedStart | None = None) -> float:
    """RMSE over the fit segments of a record [K], predicted with the tables and effects of a vehicle.

    start  : where the march begins, as the fit of the record states it; by default at the first conditions
    raises : InputError where the vehicle has no such control point, or its table is over another reference heating
    """
    errors = pooled_rmse_K(_residual_K(record, *point_with_vehicle_table(record, vehicle), start), record.fit_mask())
    return math.nan if errors is None else float(errors["rmse_K"])


# What the tables hold of the fit --------------------------------------------------------------------------------------


def held_fits(update: TableUpdate) -> dict[str, HeldFit]:
    """Record of the estimate -> how well the new tables hold the fit of it."""
    starts = update.estimate.starts or [None] * len(update.records)
    return {record.name: _held_fit(update, record, start) for record, start in zip(update.records, starts, strict=True)}


def _held_fit(update: TableUpdate, record: Record, start: FittedStart | None) -> HeldFit:
    """The fit of a record with a new table held."""
    least_loss = 0.2  # part of the error with the new table [-] from which on a cause of it is named
    mask, values = record.fit_mask(), _values(update, record)
    parameters = {n: v for n, v in values.items() if not n.startswith(NOT_MARCHED)}
    effects = [u for e in update.estimate.effects if (u := fitted_use(update.estimate, e.name)) is not None]
    fit = point_of_record(record, parameters, effects)
    fit = replace(fit, reference=tuple(update.estimate.reference_condition.values().tolist()))
    models = _models(update, record)

    def rmse_K(model: PointModel, flow: EdgeFlow, begin: FittedStart | None = start, **of_readings: Any) -> float:
        residual = _residual_K(record, model, flow, begin, **of_readings)
        errors = pooled_rmse_K(residual, mask)
        return math.nan if errors is None else float(errors["rmse_K"])

    readings: dict[str, Any] = {
        "skew_s": values.get(CLOCK_SKEW.name, 0.0),
        "errors": {s.name: sensor_errors(s, values) for s in record.sensors},
    }
    fit_K = rmse_K(fit, flow_of_record(record, effects), **readings)
    after_K = rmse_K(*models["after"])
    from_entry_K = after_K if start is None else rmse_K(*models["after"], begin=None)
    causes: dict[str, float] = {}
    if not holds(after_K, fit_K):
        missing = list(_missing(update, parameters, readings))
        for m in missing:
            causes[m.what] = _reduction(after_K, rmse_K(*_with(models["after"], fit, [m]), **m.of_readings))
        every = {key: value for m in missing for key, value in m.of_readings.items()}
        causes[REST] = _reduction(rmse_K(*_with(models["after"], fit, missing), **every), fit_K)
    named = {cause: loss for cause, loss in causes.items() if loss > least_loss * after_K}
    if start is not None and (loss := _reduction(from_entry_K, after_K)) > least_loss * from_entry_K:
        named[f"heating before {start.time_s:g} s, where the fit begins"] = loss
    before_K = rmse_K(*models["before"])
    return HeldFit(
        noise_floor_K=record.noise_floor_K(),
        fit_K=fit_K,
        before_K=before_K,
        after_K=after_K,
        from_entry_K=from_entry_K,
        not_held=named,
    )


class _Missing(NamedTuple):
    """What the fit has and the new vehicle has not: parameters, effects, and arguments of `predict`."""

    what: str
    parameters: dict[str, float]
    effects: list[EffectUse]
    of_readings: dict[str, Any]


def _with(
    revised: tuple[PointModel, EdgeFlow], fit: PointModel, missing: Sequence[_Missing]
) -> tuple[PointModel, EdgeFlow]:
    """The model with the tables after, and what they have not of the fit."""
    model, flow = revised
    parameters, effects = dict(model.parameters), model.effects
    for m in missing:
        parameters |= m.parameters
        effects = combined_uses(effects, m.effects)
    return replace(model, parameters=parameters, effects=effects, reference=fit.reference), flow


def _reduction(total: float, remaining: float) -> float:
    """sqrt(whole^2 - without^2), 0 where that is negative."""
    return math.sqrt(max(total**2 - remaining**2, 0.0))


def _values(update: TableUpdate, record: Record) -> dict[str, float]:
    """Values of the fit by name, those of another record of a joint fit left out."""
    split = ((*n.partition(AT)[::2], p.value) for n, p in update.estimate.parameters.items())
    return {name: value for name, owner, value in split if owner in ("", record.name, update.point.name)}


def _missing(update: TableUpdate, parameters: Mapping[str, float], readings: Mapping[str, Any]) -> Iterator[_Missing]:
    """What the fit has and the new vehicle has not, one by one; errors of sensors together."""
    for label in update.not_written:
        name = label.partition(AT)[0]
        if name in parameters:
            yield _Missing(label, {name: parameters[name]}, [], {})
        elif name == CLOCK_SKEW.name:
            yield _Missing(label, {}, [], {"skew_s": readings["skew_s"]})
        elif is_effect(name):
            used = fitted_use(update.estimate, name.removeprefix(EFFECT_PREFIX))
            if used is not None:
                yield _Missing(label, {}, [used], {})
    if any(n.startswith(SENSOR_PREFIX) for n in update.not_written):
        yield _Missing("errors of the sensors", {}, [], {"errors": readings["errors"]})


def _residual_K(
    record: Record,
    model: PointModel,
    flow: EdgeFlow,
    start: FittedStart | None = None,
    **of_readings: Any,
) -> FloatArray:
    """(sensor, sample) measured less predicted [K] at the used sensors, from a start or from the first conditions."""
    used = [i for i, s in enumerate(record.sensors) if s.used]
    if start is not None:
        end = float(record.time_s[record.fit_mask()].max()) + abs(of_readings.get("skew_s", 0.0))
        end = min(end, float(record.conditions.time_s[-1]))
        record, model = marched_from(record, model, start.time_s, end, np.array(start.profile))
    return predict(record, model, flow=flow, **of_readings).residual_K[used]
