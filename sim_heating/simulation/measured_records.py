"""Measured histories that a scenario compares with, as flight records along the scenario's own flight.

    sim-heating measured-records SCENARIO --out DIRECTORY

writes DIRECTORY/<control point> for every [[compare]]: records for an estimator where temperatures of a flight were
published and its trajectory was not. The clock of the measured history may lag that of the flight and run at another
rate,

    recorded time = shift + stretch (time of the flight).

Noise is the median sigma of the history; the sigma of each sample is kept in a column of its own.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path, output_directory, repeated_name
from sim_heating.inputs.points import conditions_behind_walls
from sim_heating.inputs.record import Record, make_record, write_record
from sim_heating.inputs.scenario import MeasuredHistory, Scenario
from sim_heating.simulation.run import fly_scenario
from sim_heating.simulation.synthesize import declaration, flown_columns, ratio_table_of, turbulent_table_of

NUMBER_FORMAT = ".7g"
"""Format of numbers in a record's files; finer than their accuracy."""


def compared_records(
    scenario: Scenario, *, flown: Conditions | None = None, shift_s: float = 0.0, stretch: float = 1.0
) -> dict[str, Record]:
    """A record of every measured history of a scenario, by control point.

    flown            : the flight, where it has been flown already
    shift_s, stretch : shift [s] and rate of the recorded clock relative to that of the flight
    raises           : InputError where the scenario compares with nothing, or a control point has no sensor
    """
    if not scenario.compare:
        raise InputError(f"{display_path(scenario.path)}: compares with no measured history; add a [[compare]]")
    point = repeated_name([m.control_point for m in scenario.compare])
    if point is not None:
        raise InputError(
            f"{display_path(scenario.path)}, [[compare]]: {point} is compared with several histories, and a record is "
            "named after its control point; leave one of them"
        )
    if flown is None:
        flown = fly_scenario(scenario).conditions
    flown = flown.with_columns(time_s=shift_s + stretch * flown.time_s)
    return {m.control_point: _record(scenario, m, flown) for m in scenario.compare}


def _record(scenario: Scenario, measured: MeasuredHistory, flown: Conditions) -> Record:
    point = scenario.vehicle.control_point(measured.control_point)
    if len(point.sensors) != 1:
        raise InputError(
            f"{display_path(scenario.path)}, [[compare]]: {point.name} has {len(point.sensors)} sensors; a measured "
            "history is that of one"
        )
    # A published curve has no recorder: no words, no rate. Its noise is the error of reading the figure.
    noise = {
        "noise_sigma_K": float(np.median(measured.sigma_K)),
        "noise_correlation_s": measured.noise_correlation_s,
    }
    sensor = point.sensors[0].model_copy(update={"bits": None, "range_K": None, "rate_hz": None, **noise})
    declared = declaration(scenario, point, [sensor])
    title = f"{measured.label}: {scenario.title}"
    stated: dict[str, str] = (
        {"source": f"measurements: {measured.source}; {declared.source}"} if measured.source else {}
    )
    if measured.confidence and declared.confidence:
        stated["confidence"] = f"measurements {measured.confidence}, construction {declared.confidence}"
    declared = declared.model_copy(update={"title": title, "measured": True, "segments": measured.segments, **stated})
    # the flight is one like that of the measurement, and not reconstructed from it
    declared = declared.model_copy(update={"conditions": declared.conditions.model_copy(update={"confidence": "C"})})
    columns = {"time_s": measured.time_s, sensor.column: measured.temperature_K, "sigma_K": measured.sigma_K}
    conditions = conditions_behind_walls(scenario.vehicle, [point], flown)[0]
    table, turbulent = ratio_table_of(point), turbulent_table_of(point)
    return make_record(declared, flown_columns(conditions), columns, table, point.name, turbulent)


def write_compared_records(scenario: Scenario, directory: Path) -> list[Path]:
    """Write the records of a scenario's measured histories.

    returns : the directories, named as the control points in lower case
    raises  : as compared_records and write_record
    """
    note = "\n".join(
        (
            "Temperatures measured in flight, along a simulated flight that is not the one that was flown.",
            f"Made by sim-heating measured-records of scenarios/{scenario.path.name}, which describes how.",
        )
    )
    with output_directory(directory, "measured-records", inputs=scenario.files) as folder:
        records = {name.lower(): record for name, record in compared_records(scenario).items()}
        for name, record in records.items():
            formats = dict.fromkeys((*record.conditions.columns, *record.thermocouples), NUMBER_FORMAT)
            write_record(record, folder / name, formats, note)
    return [directory / name for name in records]
