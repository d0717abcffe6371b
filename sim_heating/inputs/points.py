"""Point models from a vehicle or a record, and the conditions of a flight at a control point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES, Conditions
from sim_heating.base.errors import InputError
from sim_heating.heating.edge_flow import EdgeFlow, edge_flow, edge_flow_columns
from sim_heating.heating.effects import EffectUse, combined_uses
from sim_heating.heating.effects.transition import HYSTERESIS, TRANSITION, held_past, past_onset_now, turbulent_part
from sim_heating.heating.interface import Interface, upstream_enthalpy
from sim_heating.heating.ratio.lookup import table_ratios_at
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.reference.models import reference_heating
from sim_heating.heating.surroundings import surroundings_columns
from sim_heating.inputs.declared_effects import KEYS
from sim_heating.inputs.record import ConstantHeat, Record
from sim_heating.inputs.vehicle import ControlPoint, Vehicle, known_control_point, upstream_point
from sim_heating.march.ensemble import condition_history
from sim_heating.march.history import march_points
from sim_heating.march.point import PointModel
from sim_heating.thermal.tables import WallEnthalpy

HEATING_TOLERANCE = 0.01
"""Mean relative difference from which two reference heatings count as different."""
HEATED = 0.1
"""Heating of a wall over the largest of the flight from which its relative changes are reported [-]."""
RECORDS_KEPT = 8
"""Records whose declared model and heated conditions are kept: a search makes hundreds of problems over one record."""


def wall_enthalpy_of(declared: ConstantHeat | str) -> WallEnthalpy:
    """A declared wall enthalpy for the property tables: cp [J/(kg K)] or the name of a gas model."""
    return declared if isinstance(declared, str) else declared.cp_J_kgK


def wall_enthalpy_code(declared: WallEnthalpy) -> float:
    """A wall enthalpy as `upstream_enthalpy` takes it: cp [J/(kg K)], 0 for equilibrium air."""
    return 0.0 if isinstance(declared, str) else float(declared)


def mean_condition(conditions: Conditions) -> tuple[float, ...]:
    """Means of the five ratio variables over time."""
    return tuple(float(np.average(conditions[v], weights=conditions.duration_s)) for v in RATIO_VARIABLES)


def point_of_vehicle(
    vehicle: Vehicle,
    point: ControlPoint,
    parameters: Mapping[str, float] | None = None,
    effects: Sequence[EffectUse] = (),
    reference: tuple[float, ...] = (0.0,) * len(RATIO_VARIABLES),
) -> PointModel:
    """The model of a vehicle's control point, with parameters and effects in addition to its own."""
    return PointModel(
        name=point.name,
        construction=point.construction,
        depths_m=tuple(s.depth_m for s in point.sensors),
        lags_s=tuple(s.tau_s for s in point.sensors),
        ratio=point.ratio,
        wall_enthalpy=wall_enthalpy_of(vehicle.heating.wall_enthalpy),
        nodes=point.construction.stack.nodes,
        parameters=dict(parameters or {}),
        reference=reference,
        effects=combined_uses(point.effects, effects),
        interface=None if point.declared.interface is None else point.declared.interface.interface,
    )


def conditions_at_point(vehicle: Vehicle, point: ControlPoint, flown: Conditions) -> Conditions:
    """Conditions of a flight with surface pressure, reference heating and recovery enthalpy of one control point."""
    heating = reference_heating(
        vehicle.heating.reference,
        flown,
        nose_radius_m=vehicle.heating.nose_radius_m or 1.0,
        running_length_m=point.running_length_m,
        recovery=point.recovery,
        sweep_deg=vehicle.heating.sweep_deg or 0.0,
        ratio=_ratio_along(point.ratio, flown),
    )
    of_edge = edge_flow_columns(point.flow, flown)
    around = {}
    if vehicle.declared.surroundings == "by altitude":
        around = surroundings_columns(flown, point.pressure.parameters())
    return flown.with_columns(p_surface_Pa=point.surface_pressure(flown), **heating._asdict(), **of_edge, **around)


def _ratio_along(table: RatioTable | None, flown: Conditions) -> FloatArray | None:
    """(time,) tabulated heating ratio [-] along a flight, None without a table."""
    return None if table is None else table_ratios_at(table, np.column_stack([flown[v] for v in RATIO_VARIABLES]))


def with_upstream_wall(conditions: Conditions, wall_enthalpy: WallEnthalpy) -> Conditions:
    """Conditions with the enthalpy of air at the wall upstream of an interface, from the column `T_upstream_K`.

    returns : the same conditions where they have no such column
    """
    if "T_upstream_K" not in conditions:
        return conditions
    cp = wall_enthalpy_code(wall_enthalpy)
    rows = zip(conditions["T_upstream_K"], conditions["p_surface_Pa"], strict=True)
    return conditions.with_columns(H_upstream_J_kg=[upstream_enthalpy(T, p, cp) for T, p in rows])


def conditions_behind_walls(
    vehicle: Vehicle,
    points: Sequence[ControlPoint],
    flown: Conditions,
    models: Mapping[str, PointModel] | None = None,
    longest_step_s: float = 1.0,
) -> list[Conditions]:
    """Conditions at control points along a flight, those behind an interface with the wall upstream, marched first.

    models : of points by name, in place of the vehicle's declared ones
    """
    return [_behind_wall(vehicle, point, flown, models or {}, longest_step_s) for point in points]


def _behind_wall(
    vehicle: Vehicle, point: ControlPoint, flown: Conditions, models: Mapping[str, PointModel], longest_step_s: float
) -> Conditions:
    conditions, upstream = conditions_at_point(vehicle, point, flown), upstream_point(vehicle, point)
    if upstream is None:
        return conditions
    model = models.get(upstream.name) or point_of_vehicle(vehicle, upstream)
    flown_upstream = _behind_wall(vehicle, upstream, flown, models, longest_step_s)
    (history,) = march_points([model], [flown_upstream], longest_step_s=longest_step_s)
    columns = conditions.with_columns(T_upstream_K=history.surface_K)
    return with_upstream_wall(columns, wall_enthalpy_of(vehicle.heating.wall_enthalpy))


def interface_excess(
    interface: Interface, conditions: Conditions, surface_K: FloatArray, cp: float, turbulent: FloatArray | float = 0.0
) -> FloatArray:
    """(time,) heating behind an interface over that of a wall of one temperature, less 1 [-].

        (F - 1) (H_w1 - H_w2) / (H_r - H_w2)

    conditions : with `H_upstream_J_kg`;  surface_K : (time,) temperature of the wall behind it [K]
    cp         : of air at the wall [J/(kg K)], 0 for equilibrium air;  turbulent : intermittency of the flow [-]
    returns    : 0 where the wall is heated by less than HEATED of the largest: where it is as hot as its flow, a
                 relative change of its heating has no meaning
    Source: docs/theory/interfaces.md, equation 1.
    """
    laminar, full = interface.factors
    at_wall = [upstream_enthalpy(T, p, cp) for T, p in zip(surface_K, conditions["p_surface_Pa"], strict=True)]
    step, driving = conditions["H_upstream_J_kg"] - at_wall, conditions["H_r_J_kg"] - at_wall
    heating, factor = conditions["h_ref_kg_m2_s"] * driving, laminar + turbulent * (full - laminar)
    heated = heating > HEATED * np.max(heating, initial=0.0)
    return np.asarray(np.where(heated, (factor - 1.0) * step / np.where(heated, driving, 1.0), 0.0))


def excess_behind_interface(
    vehicle: Vehicle, point: ControlPoint, conditions: Conditions, surface_K: FloatArray
) -> FloatArray:
    """(time,) `interface_excess` [-] of a control point, 0 without an interface.

    conditions : of `conditions_behind_walls`;  surface_K : (time,) temperature of its wall [K]
    """
    declared = point.declared.interface
    if declared is None:
        return np.zeros(len(conditions))
    turning = [used for used in point.effects if used.effect.name == TRANSITION]
    turbulent_fraction = intermittency_along(turning[0], conditions) if turning else 0.0
    cp = wall_enthalpy_code(wall_enthalpy_of(vehicle.heating.wall_enthalpy))
    return interface_excess(declared.interface, conditions, surface_K, cp, turbulent_fraction)


def reference_of_record(record: Record) -> tuple[float, ...]:
    """Reference condition of a record's derivatives: as declared, else means over the time of the fit segments."""
    fitted = record.fit_mask(record.conditions.time_s)
    declared = record.declared.reference_condition
    chosen = fitted if np.any(fitted) else np.ones(len(record.conditions), dtype=bool)
    durations_s = record.conditions.duration_s[chosen]
    return tuple(
        float(np.average(record.conditions[v][chosen], weights=durations_s))
        if declared is None or getattr(declared, v) is None
        else float(getattr(declared, v))
        for v in RATIO_VARIABLES
    )


def point_of_record(
    record: Record, parameters: Mapping[str, float] | None = None, effects: Sequence[EffectUse] = ()
) -> PointModel:
    """The declared model of a record."""
    declared = _declared_point(record)
    if not parameters and not effects:
        return declared
    used = combined_uses(record.declared.heating.effects, effects)
    return replace(declared, parameters=dict(parameters or {}), effects=used)


@lru_cache(RECORDS_KEPT)
def _declared_point(record: Record) -> PointModel:
    return PointModel(
        name=record.declared.control_point,
        construction=record.construction,
        depths_m=tuple(s.depth_m for s in record.sensors),
        lags_s=tuple(s.tau_s for s in record.sensors),
        ratio=record.ratio_table,
        wall_enthalpy=wall_enthalpy_of(record.declared.heating.wall_enthalpy),
        nodes=record.declared.stack.nodes,
        reference=reference_of_record(record),
        effects=combined_uses(record.declared.heating.effects, ()),
        interface=None if record.declared.heating.interface is None else record.declared.heating.interface.interface,
    )


def conditions_of_record(record: Record, flow: EdgeFlow | None = None) -> Conditions:
    """Conditions of a record with reference heating and recovery enthalpy of its control point as columns.

    flow : what effects ask of the flow at the point's edge; by default those that the record declares
    """
    of_point = flow or flow_of_record(record)
    table = of_point.laminar
    heated = _heated_conditions(record) if table is record.ratio_table else _heated_with(record, table)
    of_edge = edge_flow_columns(of_point, record.conditions)
    return heated.with_columns(**of_edge) if of_edge else heated


@lru_cache(RECORDS_KEPT)
def _heated_conditions(record: Record) -> Conditions:
    return _heated_with(record, record.ratio_table)


def _heated_with(record: Record, table: RatioTable | None) -> Conditions:
    heating = record.declared.heating
    columns = reference_heating(
        heating.reference,
        record.conditions,
        nose_radius_m=heating.nose_radius_m or 1.0,
        running_length_m=heating.running_length_m,
        recovery=heating.recovery_of_point,
        sweep_deg=heating.sweep_deg or 0.0,
        ratio=_ratio_along(table, record.conditions),
    )
    factor = record.pressure_factor[0]
    measured = {} if factor == 1.0 else {"p_surface_Pa": factor * record.conditions["p_surface_Pa"]}
    heated = record.conditions.with_columns(**columns._asdict(), **measured)
    if record.upstream is not None:
        flown_upstream = heated.with_columns(**edge_flow_columns(flow_of_record(record), record.conditions))
        wall = replace(_declared_point(record), construction=record.upstream, depths_m=(), lags_s=(), interface=None)
        (history,) = march_points([wall], [flown_upstream])
        heated = heated.with_columns(T_upstream_K=history.surface_K)
    return with_upstream_wall(heated, wall_enthalpy_of(heating.wall_enthalpy))


def flow_of_record(record: Record, effects: Sequence[EffectUse] = ()) -> EdgeFlow:
    """What the effects of a record ask of the flow at the edge of its point, those that it declares and others.

    effects : others, each in place of a declared one of its name
    """
    heating = record.declared.heating
    return edge_flow(
        combined_uses(heating.effects, effects),
        heating.recovery_of_point,
        heating.running_length_m,
        "none" if heating.catalysis is None else heating.catalysis.atoms_of,
        (record.ratio_table, record.turbulent),
    )


def intermittency_along(transition: EffectUse, conditions: Conditions) -> FloatArray:
    """(time,) intermittency [-] of a transition along a flight, 0 laminar, 1 turbulent (docs/reference/effects.md,
    equation 24).

    conditions : of the whole flight, since a flow that has turned turbulent may stay so, with the columns that its
                 criterion reads, log10_re or log10_re_theta_m
    """
    history = condition_history(conditions)
    block = np.column_stack([history, np.tile(transition.values, (len(history), 1))])
    turbulent, highest_past, at = np.empty(len(block)), -np.inf, history.shape[1]
    for i, row in enumerate(block):
        highest_past = held_past(highest_past, past_onset_now(row, 0, at), row[at + HYSTERESIS])
        turbulent[i] = turbulent_part(row, at, highest_past)
    return turbulent


def check_reference(record: Record, vehicle: Vehicle, point: ControlPoint) -> None:
    """Refuse a record whose ratio is over another reference heating, or reduced with another recovery enthalpy, than
    the vehicle's table of the control point.

    raises : InputError with both, by name where the record names a model, else by value
    """
    heating, required = record.declared.heating, vehicle.heating
    named: str = heating.reference
    if named == "columns":
        named = (record.ratio_table.reference if record.ratio_table is not None else None) or required.reference
    if named != required.reference:
        raise InputError(
            f"{record.name}: its ratio is over `{named}`, the tables of {vehicle.name} over `{required.reference}`; "
            "fit the record over the vehicle's reference heating"
        )
    recovery = heating.recovery_of_point.kind
    if recovery != point.recovery.kind:
        raise InputError(
            f"{record.name}: its ratio is reduced with recovery `{recovery}`, the table of {point.name} with "
            f"`{point.recovery.kind}`; fit the record with the recovery enthalpy of the control point"
        )
    if wall_enthalpy_of(heating.wall_enthalpy) != wall_enthalpy_of(required.wall_enthalpy):
        raise InputError(
            f"{record.name}: its wall enthalpy is {_enthalpy(heating.wall_enthalpy)}, that of {vehicle.name} "
            f"{_enthalpy(required.wall_enthalpy)}, so the ratios differ in meaning; give the record the vehicle's"
        )
    flown, ours = conditions_of_record(record), conditions_at_point(vehicle, point, record.conditions)
    weight = flown["h_ref_kg_m2_s"] * flown["H_r_J_kg"]
    for column in ("h_ref_kg_m2_s", "H_r_J_kg"):
        apart = float(np.sum(weight * np.abs(flown[column] / ours[column] - 1.0)) / np.sum(weight))
        if not apart < HEATING_TOLERANCE:
            raise InputError(
                f"{record.name}: its {column} is {apart:.1%} from that of `{required.reference}` on {vehicle.name}; "
                "reduce the record with the vehicle's reference heating, or correct its conditions"
            )


def _enthalpy(declared: ConstantHeat | str) -> str:
    value = wall_enthalpy_of(declared)
    return value if isinstance(value, str) else f"cp = {value:g} J/(kg K)"


def point_with_vehicle_table(record: Record, vehicle: Vehicle) -> tuple[PointModel, EdgeFlow]:
    """The declared model of a record with the ratio table and effects of the vehicle's control point, and what these
    ask of the flow at its edge.

    raises : InputError where the vehicle has no such point or its table is over another reference heating
    """
    point = vehicle.control_point(record.declared.control_point)
    check_reference(record, vehicle, point)
    return replace(point_of_record(record, effects=point.effects), ratio=point.ratio), point.flow


def undeclared_effects(record: Record) -> str | None:
    """One line where a record declares no transition or no recombination although its vehicle does at its point.

    returns : None where it declares all of them, or its vehicle or control point is not one that `load_vehicle` finds
              by name: a record is complete without its vehicle
    """
    declared, heating = record.declared, record.declared.heating
    absent = {effect: key for key, effect in KEYS.items() if getattr(heating, key) is None}
    if not absent or heating.reference == "none":
        return None
    point = known_control_point(declared.vehicle, declared.control_point)
    tables = [f"[heating.{absent[u.effect.name]}]" for u in (point.effects if point else ()) if u.effect.name in absent]
    if not tables:
        return None
    return (
        f"{record.name}: declares no {' and no '.join(tables)}, which {declared.vehicle} has at "
        f"{declared.control_point}; its model is without, unless its record.toml declares them or `predict` is given "
        f"--vehicle {declared.vehicle}"
    )
