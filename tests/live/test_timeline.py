"""Samples of a link in order of flight time, whatever the order in which they came."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim_heating.live.filtering.timeline import Placed, Timeline
from sim_heating.live.types import Frame, Reading

SENSORS = {("P", "a"): 0, ("P", "b"): 1}


def frame(t: float) -> Frame:
    return Frame(t, {"alpha_deg": 40.0 + t})


def reading(t: float, sensor: str = "a", value_K: float = 500.0) -> Reading:
    return Reading(t, "P", sensor, value_K)


def flown(until_s: float = 10.0) -> Timeline:
    line = Timeline(SENSORS)
    for t in np.arange(0.0, until_s + 0.05, 0.1):
        line.put(frame(float(t)))
    return line


def test_what_comes_in_any_order_lies_in_order_of_time():
    rng = np.random.default_rng(1)
    samples = [frame(0.1 * k) for k in range(20)] + [reading(0.05 + 0.1 * k, s) for k in range(19) for s in "ab"]
    orders = []
    for _ in range(5):
        line = Timeline(SENSORS)
        for k in rng.permutation(len(samples)):
            line.put(samples[k])
        orders.append((line.frames_s, line.readings))
    assert all(order == orders[0] for order in orders)
    assert orders[0][0] == sorted(orders[0][0])
    assert orders[0][1] == sorted(orders[0][1])


def test_a_sample_within_the_window_is_late_and_one_behind_it_too_late():
    line = flown()
    assert line.put(frame(9.55)) is Placed.LATE
    assert line.put(reading(8.5)) is Placed.TAKEN
    assert line.put(reading(8.2)) is Placed.LATE
    assert line.put(reading(7.9)) is Placed.TOO_LATE
    assert (line.counts.late, line.counts.too_late) == (2, 1)
    assert line.counts.lateness_s == pytest.approx(1.8)


def test_the_same_reading_or_frame_twice_counts_once():
    line = flown()
    assert line.put(frame(line.frames_s[-3])) is Placed.DOUBLED
    assert line.put(reading(9.7)) is Placed.TAKEN
    assert line.put(reading(9.7)) is Placed.DOUBLED
    assert line.put(reading(9.7, "b")) is Placed.TAKEN
    assert len(line.readings) == 2
    assert line.counts.doubled == 2


@pytest.mark.parametrize("sample", [reading(9.9, value_K=math.nan), reading(math.inf), frame(math.nan)])
def test_what_is_no_number_is_lost(sample):
    line = flown()
    assert line.put(sample) is Placed.LOST
    assert line.counts.lost == 1


@pytest.mark.parametrize("wild_s", [1e9, -1e9, 500.0])
def test_one_damaged_time_does_not_move_the_clock(wild_s):
    line = flown()
    line.put(frame(wild_s))
    assert line.put(frame(10.1)) is Placed.TAKEN
    assert line.newest_s == 10.1
    assert line.counts.jumps == 0


@pytest.mark.parametrize("to_s", [2.0, 13.5, 4000.0])
def test_three_frames_in_a_row_on_another_clock_are_a_jump(to_s):
    line = flown()
    placed = [line.put(frame(to_s + 0.1 * k)) for k in range(3)]
    assert placed[-1] is Placed.JUMPED
    assert Placed.JUMPED not in placed[:2]
    assert line.jump is not None
    assert line.jump.by_s == pytest.approx(to_s - 10.0)
    line.follow(bridged=False)
    assert line.frames_s == pytest.approx([to_s, to_s + 0.1, to_s + 0.2])
    assert line.put(frame(to_s + 0.3)) is Placed.TAKEN


@pytest.mark.parametrize(("lost", "is_taken"), [(3, True), (4, True), (9, False)])
def test_a_few_frames_lost_at_a_low_rate_are_no_new_clock(lost, is_taken):
    line = Timeline(SENSORS)
    for t in range(11):
        line.put(frame(float(t)))
    line.put(reading(10.5 + lost))
    placed = line.put(frame(11.0 + lost))
    assert (placed is Placed.TAKEN) == is_taken
    assert line.readings == ([(10.5 + lost, 0, 500.0)] if is_taken else [])
    assert line.counts.jumps == line.counts.off_clock == 0


@pytest.mark.parametrize(("passed_s", "is_gap"), [(20.0, True), (0.1, False)])
def test_the_conditions_tell_a_gap_from_a_clock_that_jumped_ahead(passed_s, is_gap):
    line = flown()
    for k in range(3):
        line.put(Frame(30.0 + 0.1 * k, frame(10.0 + passed_s + 0.1 * k).values))
    assert line.jump is not None
    assert line.jump.is_gap is is_gap
    assert line.counts.jumps == (not is_gap)


def test_conditions_that_stay_do_not_tell_a_gap_from_a_jump():
    line = Timeline(SENSORS)
    for t in (*np.arange(0.0, 10.05, 0.1), 30.0, 30.1, 30.2):
        line.put(Frame(float(t), {"alpha_deg": 40.0}))
    assert line.jump is not None
    assert line.jump.is_gap is None
    assert line.counts.jumps == 1


def test_conditions_tell_a_short_jump_ahead_of_a_slow_link():
    line = Timeline(SENSORS)
    for t in range(11):
        line.put(frame(float(t)))
    placed = [line.put(Frame(14.0 + k, frame(11.0 + k).values)) for k in range(3)]
    assert placed[-1] is Placed.JUMPED
    assert line.jump is not None
    assert line.jump.is_gap is False


def test_after_a_jump_back_readings_on_the_old_clock_are_kept_out():
    line = flown()
    for k in range(3):
        line.put(frame(2.0 + 0.1 * k))
    line.follow(bridged=False)
    assert line.put(reading(10.0)) is Placed.WAITING
    assert line.put(reading(2.2)) is Placed.TAKEN
    assert [w[0] for w in line.readings] == [2.2]


def test_readings_with_the_first_frames_behind_a_gap_are_kept():
    line = flown()
    for k in range(3):
        line.put(reading(20.0 + 0.1 * k))
        line.put(frame(20.0 + 0.1 * k))
    line.follow(bridged=True)
    assert [w[0] for w in line.readings] == pytest.approx([20.0, 20.1, 20.2])
    assert line.frames_s[0] == 0.0
    assert line.newest_s == pytest.approx(20.2)


def test_what_no_sample_to_come_can_reach_is_forgotten():
    line = flown()
    line.put(reading(9.0))
    line.put(reading(9.8))
    line.forget(9.5)
    assert line.frames_s[0] >= 9.5
    assert [w[0] for w in line.readings] == [9.8]


def test_a_jump_is_noted_whichever_of_its_readings_comes_last():
    given = [reading(0.1 * k, s, 560.0 if (k, s) == (6, "a") else 500.0) for k in range(12) for s in "ab"]
    rng = np.random.default_rng(2)
    for order in [np.arange(len(given)), *(rng.permutation(len(given)) for _ in range(5))]:
        line = Timeline(SENSORS, gate_K=[20.0, 20.0])
        for k in order:
            line.put(given[k])
        assert {(0.1 * 6, 0), (0.1 * 7, 0)} <= set(line.jumps)
        assert {n for _, n in line.jumps} == {0}
