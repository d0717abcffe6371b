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
    topics = set(MARCH)
    if any(layer.contact_m2K_W > 0.0 for layer in stack.layer):
        topics.add("contact resistance")
    if any(isinstance(m.conductivity_W_mK, PressureTable) for m in model.construction.layer_materials()):
        topics.add("conductivity at pressures")
    if stack.venting_tau_s > 0.0:
        topics.add("venting")
    if isinstance(stack.back, BackFace):
        topics.add("back face")
    if model.wall_enthalpy == "equilibrium-air":
        topics.add("equilibrium air")
    if model.ratio is not None:
        topics.add("ratio table")
    return topics | {f"effect {used.effect.name}" for used in model.effects}


def _topics_of_heating(reference: str, recovery: Recovery) -> set[str]:
    topics = set() if reference in ("columns", "none") else {f"reference {reference}", "equilibrium air"}
    return topics if reference == "none" or recovery.kind == "total" else {*topics, f"recovery {recovery.kind}"}


def _topics_of_sensors(sensors: Iterable[Sensor]) -> set[str]:
    topics = set()
    for sensor in sensors:
        topics |= {"thermocouple lag"} if sensor.tau_s > 0.0 else set()
        topics |= {"recorder words"} if sensor.bits is not None else set()
    return topics


def topics_of_record(record: Record, model: PointModel) -> set[str]:
    """Topics of a prediction along a record."""
    heating = record.declared.heating
    topics = topics_of_model(model) | _topics_of_heating(heating.reference, heating.recovery_of_point)
    return topics | _topics_of_sensors(record.used_sensors)


def topics_of_points(vehicle: Vehicle, points: Sequence[ControlPoint], models: Sequence[PointModel]) -> set[str]:
    """Topics of the control points of a vehicle along a flight."""
    topics = {"atmosphere", "surface pressure"}
    for point, model in zip(points, models, strict=True):
        topics |= topics_of_model(model) | _topics_of_heating(vehicle.heating.reference, point.recovery)
    return topics


def topics_of_trajectory(scenario: Scenario) -> set[str]:
    """Topics of what flies a scenario; a recording has none."""
    source = scenario.declared.trajectory.source
    return set() if source == "recorded" else {f"trajectory {source}"}
