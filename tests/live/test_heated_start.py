"""A start from one reading of each thermocouple: temperatures of walls that were really heated, within their bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_heating.estimation.fit import estimate
from sim_heating.inputs.first_readings import other_start
from sim_heating.inputs.points import conditions_of_record
from sim_heating.inputs.record import Record, load_record, write_record
from sim_heating.live.filtering.heated_start import start_of_heated
from sim_heating.live.recording.to_record import with_heated_start
from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.mesh_choice import mesh_of_nodes
from sim_heating.march.point import initial_temperatures
from tests.support.paths import PRACTICE
from tests.support.walls import practice_model, practice_record

NODES = 40


def flown(name: str, until_s: float):
    """Model, mesh, temperatures of all nodes and conditions after part of a practice flight."""
    record, model = practice_record(name)[0], practice_model(name)
    time_s = np.arange(record.conditions.time_s[0], until_s + 0.5, 1.0)
    history = condition_history(conditions_of_record(record).at(time_s))
    mesh = mesh_of_nodes(model, NODES, 1.0)
    ensemble = Ensemble([model], [mesh])
    ensemble.march(time_s, history[np.newaxis])
    return model, mesh, ensemble.node_temperatures(0), history[-1]


@pytest.mark.parametrize("until_s", [300.0, 650.0, 1000.0])
@pytest.mark.parametrize("name", ["p06", "p07"])
def test_the_true_profile_lies_within_the_bounds(name, until_s):
    model, mesh, true, conditions = flown(name, until_s)
    read = {n: float(true[n]) for n in mesh.sensors}
    profile, covariance = start_of_heated(model, mesh, read, conditions)
    sigma = np.sqrt(np.diag(covariance))
    assert np.all(np.abs(profile - true) < 2.5 * sigma)


def test_thermocouples_in_depth_tell_the_profile_between_them():
    model, mesh, true, conditions = flown("p06", 650.0)
    depths = np.array([0, *(int(np.argmin(np.abs(mesh.depth_m - d))) for d in (0.004, 0.012, 0.025)), *mesh.sensors])
    profile, covariance = start_of_heated(model, mesh, {int(n): float(true[n]) for n in depths}, conditions)
    assert np.max(np.abs(profile - true)) < 40.0
    assert np.max(np.sqrt(np.diag(covariance))) < 60.0


def test_a_cold_wall_starts_cold():
    model, mesh, _, conditions = flown("p06", 5.0)
    declared = initial_temperatures(model.construction, mesh)
    read = {n: float(declared[n]) for n in mesh.sensors}
    profile, _ = start_of_heated(model, mesh, read, conditions)
    np.testing.assert_allclose(profile, declared, atol=1.0)


def test_the_profile_does_not_depend_on_the_mesh():
    model, mesh, true, conditions = flown("p06", 650.0)
    fine = mesh_of_nodes(model, 96, 1.0)
    read = {n: float(true[m]) for n, m in zip(fine.sensors, mesh.sensors, strict=True)}
    found, _ = start_of_heated(model, fine, read, conditions)
    same, _ = start_of_heated(model, mesh, {n: float(true[n]) for n in mesh.sensors}, conditions)
    np.testing.assert_allclose(np.interp(mesh.depth_m, fine.depth_m, found), same, atol=3.0)


def begun_at(record: Record, time_s: float) -> Record:
    """The record of a link that came up in flight."""
    later, flown = record.time_s >= time_s, record.conditions
    conditions = flown.at(flown.time_s[flown.time_s >= time_s])
    return replace(record, conditions=conditions, thermocouples={n: v[later] for n, v in record.thermocouples.items()})


@pytest.mark.thorough
def test_a_record_that_begins_in_flight_carries_the_profile_at_its_start(tmp_path):
    hot = begun_at(load_record(PRACTICE / "p06"), 650.0)
    write_record(with_heated_start(hot), tmp_path / "hot")
    carried = load_record(tmp_path / "hot")
    assert other_start(hot) is not None
    assert other_start(carried) is None
    first, last = carried.declared.stack.initial_profile[0], carried.declared.stack.initial_profile[-1]
    assert first[1] > 1000.0 > 400.0 > last[1]
    errors = [estimate(r, ["ratio.scale"]).after[0].segment_errors()["fit"]["rmse_K"] for r in (hot, carried)]
    assert errors[1] < 0.3 * errors[0]


def test_a_record_from_entry_interface_on_is_as_declared():
    record = load_record(PRACTICE / "p06")
    assert with_heated_start(record) is record
