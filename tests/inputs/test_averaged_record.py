"""Very many readings are averaged where nothing moves between neighbours, with the noise of the mean."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_heating.base.conditions import Conditions
from sim_heating.inputs.averaged_record import LARGE, averaged_record
from sim_heating.inputs.record import Record, Segments, load_record
from tests.support.paths import RECORDS

ROWS = 100_000
TILE = load_record(RECORDS / "sts96_480")
TIMES = np.linspace(TILE.conditions.time_s[0], TILE.conditions.time_s[-1], ROWS)
COLUMN = TILE.sensors[0].column


def dense(T, sigma: float | None = 2.0, segments: Segments | None = None) -> Record:
    """The tile's record with other readings [K] at many times."""
    white = {"noise_sigma_K": sigma, "noise_correlation_s": None}
    sensor = TILE.sensors[0].model_copy(update=white)
    declared = TILE.declared.model_copy(update={"segments": segments or Segments()})
    record = replace(TILE, declared=declared, thermocouples={"time_s": TIMES, COLUMN: T})
    return record.with_sensors([sensor])


def smooth(noise_K: float = 2.0):
    """A slow wave [K] with white noise."""
    noise = noise_K * np.random.default_rng(3).standard_normal(ROWS)
    return 600.0 + 200.0 * np.sin(TIMES / 200.0) + noise


def test_few_readings_stay_as_they_are():
    assert averaged_record(TILE) == (TILE, [])


def test_means_have_the_noise_of_the_mean():
    found, (line,) = averaged_record(dense(smooth()))
    n = 5
    assert line == f"sts96_480: 100000 readings averaged by {n} neighbours to 20000, with the noise of the mean"
    assert found.sensors[0].noise_sigma_K == pytest.approx(2.0 / np.sqrt(n))
    residual = found.thermocouples[COLUMN] - (600.0 + 200.0 * np.sin(found.time_s / 200.0))
    assert np.std(residual) == pytest.approx(2.0 / np.sqrt(n), rel=0.03)
    assert abs(np.mean(residual)) < 4.0 * 2.0 / np.sqrt(ROWS)


def test_noise_that_is_not_declared_is_still_to_be_estimated():
    assert averaged_record(dense(smooth(), None))[0].sensors[0].noise_sigma_K is None


def test_where_readings_move_between_neighbours_none_is_averaged():
    T = 600.0 + 100.0 * np.sin(np.arange(ROWS))
    found, (line,) = averaged_record(dense(T))
    assert len(found.time_s) == ROWS
    assert (
        line == "sts96_480: 100000 readings, none averaged: the temperature moves between neighbours; this takes long"
    )


def test_a_few_bends_are_left_out_and_told():
    T = smooth(0.05)
    T[ROWS // 2 + 3 :] += 40.0
    found, (line,) = averaged_record(dense(T, 0.05))
    assert "means over a bend left out" in line
    assert 0 < np.count_nonzero(np.isnan(found.thermocouples[COLUMN])) <= 4


def test_no_mean_is_over_the_edge_of_a_segment():
    """What is held out stays out of the fit."""
    begin, end = float(TIMES[12_345]), float(TIMES[23_457])
    T = np.where((begin <= TIMES) & (end >= TIMES), 900.0, 500.0) + 0.0 * TIMES
    found, _ = averaged_record(dense(T + smooth() - 600.0, segments=Segments(holdout=[[begin, end]])))
    held = found.holdout_mask()
    assert np.nanmin(found.thermocouples[COLUMN][held]) > 680.0
    assert np.nanmax(found.thermocouples[COLUMN][~held]) < 720.0


@pytest.mark.thorough
def test_conditions_keep_their_jumps():
    switched = np.where(TIMES[40_321] < TIMES, 1.0, 0.0)
    columns = {n: np.interp(TIMES, TILE.conditions.time_s, v) for n, v in TILE.conditions.columns.items()}
    record = replace(TILE, conditions=Conditions({**columns, "time_s": TIMES, "jets": switched}))
    found, (line,) = averaged_record(record)
    flown = found.conditions
    assert len(flown) < LARGE
    assert "rows of conditions averaged to" in line
    at = int(np.flatnonzero(flown["jets"] > 0.5)[0])
    assert flown.time_s[at] == TIMES[40_322]
    assert flown.time_s[[0, -1]] == pytest.approx(TIMES[[0, -1]])
    back = np.interp(TIMES, flown.time_s, flown["velocity_m_s"])
    assert back == pytest.approx(columns["velocity_m_s"], abs=2e-3 * np.ptp(columns["velocity_m_s"]))
