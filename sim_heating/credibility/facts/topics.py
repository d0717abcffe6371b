"""Equations that a result uses, as topics of verification rows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from sim_heating.heating.reference.recovery import Recovery
from sim_heating.inputs.record import Record
from sim_heating.inputs.scenario import Scenario
from sim_heating.inputs.vehicle import ControlPoint, Vehicle
from sim_heating.march.point import PointModel
from sim_heating.thermal.stack import BackFace, PressureTable, Sensor

CORE = ("conduction", "surface balance")
"""Topics that every result uses, and without which nothing is verified."""
MARCH = (*CORE, "mesh and steps", "whole stack")
"""Topics of every thermal march."""


def topics_of_model(model: PointModel) -> set[str]:
    """Topics of a control point's model: its wall, its ratio, its effects."""
    stack = model.construction.stack
    found = set(MARCH)
    if any(layer.contact_m2K_W > 0.0 for layer in stack.layer):
        found.add("contact resistance")
    if any(isinstance(m.conductivity_W_mK, PressureTable) for m in model.construction.layer_materials()):
        found.add("conductivity at pressures")
    if stack.venting_tau_s > 0.0:
        found.add("venting")
    if isinstance(stack.back, BackFace):
        found.add("back face")
    if model.wall_enthalpy == "equilibrium-air":
        found.add("equilibrium air")
    if model.ratio is not None:
        found.add("ratio table")
    return found | {f"effect {used.effect.name}" for used in model.effects}


def _topics_of_heating(reference: str, recovery: Recovery) -> set[str]:
    found = set() if reference in ("columns", "none") else {f"reference {reference}", "equilibrium air"}
    return found if reference == "none" or recovery.kind == "total" else {*found, f"recovery {recovery.kind}"}


def _topics_of_sensors(sensors: Iterable[Sensor]) -> set[str]:
    found = set()
    for sensor in sensors:
        found |= {"thermocouple lag"} if sensor.tau_s > 0.0 else set()
        found |= {"recorder words"} if sensor.bits is not None else set()
    return found


def topics_of_record(record: Record, model: PointModel) -> set[str]:
    """Topics of a prediction along a record."""
    heating = record.declared.heating
    own = topics_of_model(model) | _topics_of_heating(heating.reference, heating.recovery_of_point)
    return own | _topics_of_sensors(record.used_sensors)


def topics_of_points(vehicle: Vehicle, points: Sequence[ControlPoint], models: Sequence[PointModel]) -> set[str]:
    """Topics of the control points of a vehicle along a flight."""
    found = {"atmosphere", "surface pressure"}
    for point, model in zip(points, models, strict=True):
        found |= topics_of_model(model) | _topics_of_heating(vehicle.heating.reference, point.recovery)
    return found


def topics_of_trajectory(scenario: Scenario) -> set[str]:
    """Topics of what flies a scenario; a recording has none."""
    source = scenario.declared.trajectory.source
    return set() if source == "recorded" else {f"trajectory {source}"}
