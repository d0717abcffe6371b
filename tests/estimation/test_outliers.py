"""Isolated outliers of a thermocouple: found by their neighbours, listed with their rows, never two in a row."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_heating.estimation.inference.outliers import outlier_lines, without_outliers
from sim_heating.inputs.record import Record, load_record, write_record
from tests.support.paths import PRACTICE

SENSOR = "LS_surface"
SPIKE_K = 60.0


def p06() -> Record:
    return load_record(PRACTICE / "p06")


def spiked(record: Record, at: list[int], by_K: float = SPIKE_K) -> Record:
    column = next(s.column for s in record.sensors if s.name == SENSOR)
    read = record.thermocouples[column].copy()
    read[at] += by_K
    return replace(record, thermocouples={**record.thermocouples, column: read})


@pytest.mark.parametrize("name", [f"p{k:02d}" for k in range(1, 11)])
def test_a_sound_record_has_no_outlier(name: str) -> None:
    record = load_record(PRACTICE / name)
    cleaned, outliers = without_outliers(record)
    assert outliers == []
    assert cleaned is record


@pytest.mark.parametrize("by_K", [SPIKE_K, -SPIKE_K])
def test_single_spikes_are_left_out_and_nothing_else(by_K: float) -> None:
    at = [100, 400, 900, 1200]
    record = spiked(p06(), at, by_K)
    cleaned, outliers = without_outliers(record)
    assert [o.time_s for o in outliers] == record.time_s[at].tolist()
    column = next(s.column for s in record.sensors if s.name == SENSOR)
    lost = np.isnan(cleaned.thermocouples[column]) & np.isfinite(record.thermocouples[column])
    assert np.flatnonzero(lost).tolist() == at
    true = p06().thermocouples[column][at]
    assert np.all(np.abs([o.expected_K for o in outliers] - true) < 15.0)


def test_two_in_a_row_may_be_an_event_and_stay() -> None:
    assert without_outliers(spiked(p06(), [400, 401]))[1] == []


def test_a_step_and_a_corner_of_the_temperature_stay() -> None:
    record = p06()
    column = next(s.column for s in record.sensors if s.name == SENSOR)
    t = record.time_s
    for events in (np.where(t > 600.0, 80.0, 0.0), 8.0 * np.maximum(t - 600.0, 0.0)):
        changed = {**record.thermocouples, column: record.thermocouples[column] + np.minimum(events, 300.0)}
        assert without_outliers(replace(record, thermocouples=changed))[1] == []


def test_the_row_is_that_of_the_users_file(tmp_path) -> None:
    write_record(spiked(p06(), [400]), tmp_path / "own")
    record = load_record(tmp_path / "own")
    (outlier,) = without_outliers(record)[1]
    row = (tmp_path / "own" / "thermocouples.csv").read_text().splitlines()[outlier.row - 1]
    assert float(row.split(",")[0]) == outlier.time_s
    (line,) = outlier_lines([outlier], {record.name: record})
    assert f"row {outlier.row}" in line
    assert "1 isolated reading is an outlier and is left out" in line
