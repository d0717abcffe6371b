"""What a running estimate has to reach, a seeded sample of each: `python -m benchmarks live` has the whole.

Times are not tested here; the streams are those of the benchmark, smaller.
"""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.live_alarms import watch
from benchmarks.live_bad import TWO_SIDED_95, damaged_packets, over
from benchmarks.live_exact import against_estimate, apart_from_batch, bits_apart
from benchmarks.live_speed import BEGIN_S, FRAMES_HZ, latencies, stream, waiting_too
from sim_heating.live.types import Frame
from tests.support.live_streams import BadLink, Flight, known_flight, practice, samples_of_record

pytestmark = pytest.mark.thorough

SHORT_S = 160.0


@pytest.fixture(scope="module")
def flight() -> Flight:
    """Eight walls of known heating on the first part of an entry."""
    return known_flight("p07", 8, SHORT_S, 1.0, np.random.default_rng(1))


@pytest.fixture(scope="module")
def two() -> Flight:
    return known_flight("p06", 2, 120.0, 1.0, np.random.default_rng(2))


def test_a_flight_in_order_is_estimated_as_by_the_batch_filter(two):
    assert apart_from_batch(two) < 1e-9


def test_samples_in_another_order_give_the_same_bits(two):
    differ, late = bits_apart(two, 1)
    assert late > 50
    assert differ == 0


@pytest.mark.parametrize("jump_s", [0.0, 3.0])
def test_over_a_bad_link_the_truth_stays_within_the_bounds(flight, jump_s):
    link = BadLink(jump_s=jump_s, jump_at_s=100.0)
    found = over(link, flight, np.random.default_rng(3))
    assert found.is_finite
    assert found.lost > 0.02 * len(flight.samples)
    assert found.counts.late > 100
    assert found.counts.doubled > 50
    # 48 values with 95 % bounds: 8 outside is the upper limit of 99 %
    outside = np.sum(np.abs(found.error) > TWO_SIDED_95 * found.sigma)
    assert outside <= 8
    assert 0.5 < np.sqrt(np.mean((found.error / found.sigma) ** 2)) < 1.5


def test_a_clock_that_jumps_ahead_is_told(flight):
    jumped = over(BadLink(jump_s=3.0, jump_at_s=100.0), flight, np.random.default_rng(4))
    assert any("clock jumped ahead" in line or "jump of the clock" in line for line in jumped.messages)
    never = over(BadLink(), flight, np.random.default_rng(4))
    assert not any("jump" in line for line in never.messages)


def test_no_damaged_packet_is_taken_for_a_value_or_ends_the_link():
    found = damaged_packets(300, (0.0, 60.0))
    assert found == {"packets": 300, "silent": 0, "crashes": 0, "differ": 0}


def test_at_the_end_of_a_manoeuvre_the_bounds_are_those_of_an_estimate():
    rows = against_estimate("p06", 400.0, ("ratio.scale", "ratio.d_logre"))
    assert [row.parameter for row in rows] == ["ratio.scale", "ratio.d_logre"]
    assert all(abs(row.sigma_ratio - 1.0) < 0.15 for row in rows)
    assert all(abs(row.apart) < 0.3 for row in rows)


def test_transition_raises_an_alarm_and_a_null_flight_raises_none():
    assert watch(practice("p06")).alarm is None
    alarm = watch(practice("p04")).alarm
    assert alarm is not None
    assert 1000.0 < alarm.time_s < 1100.0  # it sets in at 1044 s


def test_a_stream_has_a_frame_in_each_batch_and_its_calls_are_timed():
    given = stream(1.0, points=2)
    assert [f.time_s for f in given.frames] == pytest.approx(BEGIN_S + np.arange(FRAMES_HZ + 1) / FRAMES_HZ)
    wall, busy = latencies(given)
    assert len(wall) == len(busy) == FRAMES_HZ + 1
    # one that takes two frames' time holds up the next
    assert waiting_too(np.array([2.0, 0.5, 0.0]) / FRAMES_HZ) * FRAMES_HZ == pytest.approx([2.0, 1.5, 0.5])


def test_a_record_becomes_frames_and_readings_in_order():
    samples = samples_of_record(practice("p06"), 10.0)
    times = [s.time_s for s in samples]
    assert times == sorted(times)
    assert sum(isinstance(s, Frame) for s in samples) == 11
