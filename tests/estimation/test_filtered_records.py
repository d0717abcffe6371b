"""Records through the filter: readings as recorded, and the temperatures at a later time from all before it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.estimation.filter.march import FilterMarch
from sim_heating.estimation.filter.records import calibration_line, filtered_start, track_of_record
from sim_heating.estimation.starts import circuit_start
from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.mesh_choice import pack
from sim_heating.thermal.stack import Sensor
from tests.support.walls import practice_model, practice_record

BEGIN_S = 500.0


def test_a_calibration_is_its_tangent_at_the_reading():
    sensor = Sensor(name="S", column="S_K", depth_m=0.0, calibration=[3.0, 0.9, 5e-5])
    T = np.array([300.0, 900.0, 1500.0])
    slope, constant = calibration_line(sensor, 3.0 + 0.9 * T + 5e-5 * T**2)
    np.testing.assert_allclose(slope, 0.9 + 1e-4 * T, rtol=1e-12)
    np.testing.assert_allclose(slope * T + constant, 3.0 + 0.9 * T + 5e-5 * T**2, rtol=1e-12)


def test_filtered_temperatures_are_nearer_the_truth_than_the_march():
    record, _ = practice_record("p06")
    declared, true = practice_model("p06", true=False), practice_model("p06")
    mesh, t = pack([declared]).meshes[0], record.conditions.time_s
    history = condition_history(record.conditions)[np.newaxis]
    upto = int(np.searchsorted(t, BEGIN_S)) + 1
    profiles = []
    for model in (true, declared):
        ensemble = Ensemble([model], [mesh])
        ensemble.march(t[:upto], np.ascontiguousarray(history[:, :upto]))
        profiles.append(ensemble.node_temperatures(0))
    assert t[upto - 1] == BEGIN_S

    def error(profile: np.ndarray) -> float:
        return float(np.sqrt(np.mean((profile - profiles[0]) ** 2)))

    filtered = error(filtered_start(record, declared, mesh, BEGIN_S).profile)
    assert filtered < 0.2 * error(profiles[1])
    assert filtered < 0.2 * error(circuit_start(record, declared, mesh, BEGIN_S).profile)


def test_readings_held_out_or_of_unused_sensors_update_nothing():
    record, _ = practice_record("p06")
    mesh = pack([practice_model("p06")]).meshes[0]
    track, steps, history = track_of_record(record, practice_model("p06"), mesh)
    held = record.time_s[record.holdout_mask()]
    assert len(held) > 0
    assert not np.any(np.isin(track.samples.time_s, held))
    used = {mesh.sensors[i] for i, sensor in enumerate(record.sensors) if sensor.used}
    assert set(track.samples.node) <= used
    taken = FilterMarch([track], steps, history).filter()[0]
    assert np.all(taken.read)


def test_a_start_without_readings_before_it_is_refused():
    record, _ = practice_record("p06")
    model = practice_model("p06")
    with pytest.raises(InputError, match="nothing to filter"):
        filtered_start(record, replace(model), pack([model]).meshes[0], float(record.conditions.time_s[0]) - 1.0)
