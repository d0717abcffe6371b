"""The running estimate: a function of the samples, not of their order; honest, and reported where not."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.estimation.filter.march import FilterMarch, FilterTrack
from sim_heating.estimation.filter.online import Prior
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.inference.likelihood import reading_intervals
from sim_heating.estimation.record_fit import least_sigma_K
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import Record, load_record
from sim_heating.live.filtering.estimates import Innovation, LiveOptions
from sim_heating.live.filtering.estimator import LiveEstimator
from sim_heating.live.filtering.parameters import default_prior
from sim_heating.live.filtering.points import RecordPoints, VehiclePoints
from sim_heating.live.types import Frame, Reading, Sample
from sim_heating.march.ensemble import condition_history
from sim_heating.march.point import initial_temperatures
from tests.support.filter_samples import samples_on_grid
from tests.support.paths import PRACTICE

NODES = 14
NAMES = ("ratio.scale", "ratio.d_alpha")
BEGIN_S, END_S = 850.0, 900.0


@cache
def record() -> Record:
    """A practice record without an effect."""
    return load_record(PRACTICE / "p07")


@cache
def samples() -> tuple[Sample, ...]:
    """Frames at 4 Hz and readings at 2 Hz, between them, of the declared model with 5 % more heating."""
    r = record()
    t = np.arange(BEGIN_S, END_S + 0.01, 0.25)
    flown = r.conditions.at(t)
    frames = [Frame(float(s), {n: float(flown[n][k]) for n in flown.names if n != "time_s"}) for k, s in enumerate(t)]
    point = RecordPoints([r], NODES).points[0]
    model = point_of_record(r, {"ratio.scale": 0.05})
    read_s = np.arange(BEGIN_S + 0.1, END_S, 0.5)
    nothing = np.full((len(point.mesh.sensors), len(read_s)), np.nan)
    track = FilterTrack(model, point.mesh, samples_on_grid(read_s, point.mesh.sensors, nothing, 1.0), (), start_K())
    history = condition_history(conditions_of_record(r).at(t))[np.newaxis]
    read = FilterMarch([track], t, history).filter()[0].predicted_K.reshape(len(read_s), -1)
    read = read + np.random.default_rng(0).normal(0.0, 1.0, read.shape)
    words = [
        Reading(float(s), point.name, sensor.name, float(read[k, i]))
        for k, s in enumerate(read_s)
        for i, sensor in enumerate(point.sensors)
    ]
    return tuple(sorted((*frames, *words), key=lambda s: (s.time_s, isinstance(s, Frame))))


@cache
def start_K() -> np.ndarray:
    """A hot wall, cooler inward."""
    mesh = RecordPoints([record()], NODES).points[0].mesh
    return 900.0 - 400.0 * mesh.depth_m / mesh.depth_m[-1]


def estimator(**options) -> LiveEstimator:
    return LiveEstimator(RecordPoints([record()], NODES), NAMES, PRIORS, LiveOptions(**options))


PRIORS = {"ratio.scale": Prior(0.0, 0.2), "ratio.d_alpha": Prior(0.0, 0.002)}


def feed(e: LiveEstimator, given, at_once: int = 1) -> LiveEstimator:
    for k in range(0, len(given), at_once):
        e.add(*given[k : k + at_once])
        e.advance()
    return e


def final(e: LiveEstimator) -> tuple[np.ndarray, ...]:
    found = next(iter(e.estimates().values())).state
    return found.temperature_K, found.sigma_K, found.values, found.covariance


def assert_same_bits(a: LiveEstimator, b: LiveEstimator) -> None:
    for x, y in zip(final(a), final(b), strict=True):
        np.testing.assert_array_equal(x, y)


@pytest.fixture(scope="module")
def in_order() -> LiveEstimator:
    return feed(estimator(), samples())


def shuffled(seed: int, by_s: float) -> list[Sample]:
    """Each sample delayed by up to a time, the first ones excepted, which say when the link begins."""
    rng = np.random.default_rng(seed)
    arrive = [s.time_s + (rng.uniform(0.0, by_s) if s.time_s > BEGIN_S else 0.0) for s in samples()]
    return [samples()[k] for k in np.argsort(arrive, kind="stable")]


@pytest.mark.thorough
@pytest.mark.sample(1)
@pytest.mark.parametrize("seed", range(4))
def test_samples_out_of_order_within_the_window_give_the_same_bits(in_order, seed):
    late = feed(estimator(), shuffled(seed, 1.9))
    assert late.counts.late > 50
    assert late.counts.too_late == 0
    assert_same_bits(late, in_order)
    assert in_order.stepper.steps > 100


@pytest.mark.thorough
@pytest.mark.parametrize("at_once", [1, 50, 1000])
def test_flight_filtered_again_has_the_same_bits_in_any_order(at_once):
    straight = feed(estimator(again_s=10.0), samples())
    assert straight.stepper.past.steps[0].frame.time_s < BEGIN_S + 1.0
    assert_same_bits(feed(estimator(again_s=10.0), shuffled(5, 1.9), at_once), straight)
    assert not np.array_equal(final(straight)[2], final(feed(estimator(again_s=math.inf), samples()))[2])


@pytest.mark.thorough
def test_filtered_again_about_its_estimate_the_flight_gives_that_estimate():
    e = feed(estimator(again_s=math.inf), samples())
    e.filter_again()
    once = final(e)
    e.filter_again()
    twice = final(e)
    sigma = np.sqrt(np.diag(once[3]))
    assert np.max(np.abs(twice[2] - once[2]) / sigma) < 0.1


@pytest.mark.thorough
@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["p06", "p07"])
def test_final_estimate_of_a_record_without_an_effect_is_that_of_a_fit(name):
    r = load_record(PRACTICE / name)
    names = ("ratio.scale", "ratio.d_alpha", "ratio.d_beta", "ratio.d_logre", "ratio.d_elevon", "ratio.d_bodyflap")
    fit = estimate([r], list(names)).parameters
    e = LiveEstimator(RecordPoints([r]), names)
    c, fitted = r.conditions, r.fit_mask(r.time_s)
    e.add(*(Frame(float(t), {n: float(c[n][k]) for n in c.names if n != "time_s"}) for k, t in enumerate(c.time_s[:5])))
    for k, t in enumerate(c.time_s[5:], start=5):
        now = fitted & (r.time_s > c.time_s[k - 1]) & (r.time_s <= t)
        for s in r.used_sensors:
            e.add(
                *(
                    Reading(float(read_s), e.names[0], s.name, float(v))
                    for read_s, v in zip(r.time_s[now], r.thermocouples[s.column][now], strict=True)
                )
            )
        e.add(Frame(float(t), {n: float(c[n][k]) for n in c.names if n != "time_s"}))
        e.advance()
    e.filter_again()
    found = e.estimates()[e.names[0]].parameters
    for n in names:
        assert abs(found[n][0] - fit[n][0]) < 0.3 * fit[n][1]
        assert found[n][1] == pytest.approx(fit[n][1], rel=0.15)


@pytest.mark.sample(1)
@pytest.mark.parametrize("at_once", [7, 1000])
def test_samples_that_pile_up_give_the_same_bits(in_order, at_once):
    assert_same_bits(feed(estimator(), samples(), at_once), in_order)


@pytest.mark.thorough
def test_looking_at_the_estimate_does_not_change_it(in_order):
    watched = estimator(wait_s=1.0)
    for sample in shuffled(9, 1.9):
        watched.add(sample)
        watched.advance()
        watched.estimates()
    assert_same_bits(watched, feed(estimator(wait_s=1.0), samples()))


def test_doubled_samples_change_nothing_and_are_counted(in_order):
    doubled = feed(estimator(), [s for sample in samples() for s in (sample, sample)])
    assert doubled.counts.doubled == len(samples())
    assert_same_bits(doubled, in_order)
    assert not doubled.messages


def test_repeated_samples_with_other_values_are_told_then_explained():
    # a clock that went back by 3 s, with a frame a second: too few lie outside the window to make a new clock
    each_second = [s for s in samples() if isinstance(s, Reading) or s.time_s % 1.0 == 0.0]
    e, flown = estimator(), [s for s in each_second if s.time_s < BEGIN_S + 20.0]
    wrong = [replace(s, time_s=s.time_s - 3.0) for s in each_second if BEGIN_S + 20.0 <= s.time_s < BEGIN_S + 25.0]
    feed(e, flown)
    for sample in wrong:
        e.add(sample)
    first, then = [m for m in e.messages if "again with other values" in m]
    assert "a clock that went back, or two sources" in first
    assert "the clock went back by about 3 s, from 870 to 867 s" in then


def test_in_order_the_estimate_is_that_of_the_batch_filter(in_order):
    options = {"linearise_s": math.inf, "again_s": math.inf, "wait_s": 0.0, "start": "readings", "corrects_mesh": False}
    e = feed(estimator(**options), samples())
    point, r = e.points[0], record()
    t = np.array([s.time_s for s in samples() if isinstance(s, Frame)])
    words = [s for s in samples() if isinstance(s, Reading)]
    nodes = dict(zip((s.name for s in point.sensors), point.mesh.sensors, strict=True))
    read_s = sorted({w.time_s for w in words})
    value = {(w.time_s, w.sensor): w.value_K for w in words}
    sensors = [s for s in point.sensors if s.used]
    grid = np.array([[value[s, sensor.name] for s in read_s] for sensor in sensors])
    known = [reading_intervals(sensor, row) for sensor, row in zip(sensors, grid, strict=True)]
    lower, upper = [i.lower_K for i in known], [i.upper_K for i in known]
    sigma = [max(s.noise_sigma_K or 1.0, least_sigma_K(s)) for s in sensors]
    given = samples_on_grid(read_s, [nodes[s.name] for s in sensors], lower, sigma, upper)
    profile, covariance = e.start_of(point.name)
    track = FilterTrack(point.model, point.mesh, given, NAMES, profile, covariance_K2=covariance)
    history = condition_history(conditions_of_record(r).at(t))[np.newaxis]
    batch = FilterMarch([track], t, history).filter()[0]
    prior = np.diag([PRIORS[n].sigma ** -2.0 for n in NAMES])
    expected = np.linalg.inv(prior + batch.information())
    state = e.estimates()[point.name].state
    sigma_p = np.sqrt(np.diag(expected))
    assert np.max(np.abs(state.covariance - expected) / np.outer(sigma_p, sigma_p)) < 1e-9
    assert np.max(np.abs(state.values - expected @ batch.score()) / sigma_p) < 1e-9


def test_the_scale_that_was_flown_is_found_and_the_wall_with_it(in_order):
    found = in_order.estimates()[in_order.names[0]]
    value, sigma = found.parameters["ratio.scale"]
    assert abs(value - 0.05) < 4.0 * sigma < 0.2
    last = [s for s in samples() if isinstance(s, Reading)][-2:]
    for word in last:
        told = found.sensors[word.sensor]
        assert abs(word.value_K - told.predicted_K) < 5.0 * told.sigma_K


@pytest.mark.thorough
def test_innovations_are_given_once_in_order_and_white(in_order):
    e, seen = estimator(), []
    for sample in shuffled(2, 1.9):
        e.add(sample)
        e.advance()
        seen += e.innovations()
    times = [i.time_s for i in seen]
    assert times == sorted(times)
    assert len(set(seen)) == len(seen)
    z = np.array([i.innovation_K / math.sqrt(i.variance_K2) for i in seen[20:]])
    assert len(z) > 100
    assert np.mean(z**2) == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / len(z)))


def test_a_gap_is_bridged_and_the_bounds_grow(in_order):
    gone = [s for s in samples() if not 880.0 < s.time_s < 890.0]
    e = estimator()
    before = None
    for sample in gone:
        e.add(sample)
        e.advance()
        if isinstance(sample, Frame) and sample.time_s == 880.0:
            before = e.estimates()[e.names[0]].surface_sigma_K
        if isinstance(sample, Frame) and sample.time_s == 890.5:
            assert before is not None
            assert e.estimates()[e.names[0]].surface_sigma_K > 1.5 * before
    assert e.messages[-1] == "no frames from 880 to 890 s: a gap; bridged"
    assert e.counts.jumps == 0
    value, sigma = e.estimates()[e.names[0]].parameters["ratio.scale"]
    assert abs(value - 0.05) < 4.0 * sigma


@pytest.mark.parametrize("by_s", [-100.0, 4000.0])
def test_a_jump_of_the_clock_is_told_and_the_estimate_goes_on(in_order, by_s):
    jumped = [
        s
        if s.time_s < 880.0
        else Frame(s.time_s + by_s, s.values)
        if isinstance(s, Frame)
        else Reading(s.time_s + by_s, s.point, s.sensor, s.value_K)
        for s in samples()
    ]
    e = feed(estimator(), jumped)
    assert e.counts.jumps == 1
    assert "jumped" in e.messages[-1]
    assert e.time_s == pytest.approx(END_S + by_s)
    a, b = e.estimates()[e.names[0]], in_order.estimates()[in_order.names[0]]
    assert abs(a.surface_K - b.surface_K) < 4.0 * b.surface_sigma_K + 1.0


def test_conditions_tell_a_small_jump_of_the_clock_from_a_gap():
    e = feed(estimator(), stamped(8.0))
    assert e.messages[-1] == (
        "the clock jumped ahead from 879.75 to 888 s: the conditions did not go on as long; bridged as a gap"
    )
    assert e.counts.jumps == 1
    value, sigma = e.estimates()[e.names[0]].parameters["ratio.scale"]
    assert abs(value - 0.05) < 4.0 * sigma


def test_few_lost_frames_of_a_slow_link_are_no_jump_and_lose_no_reading():
    """A frame a second, three lost; the readings of that time, sent apart from them, are used."""
    slow = [s for s in samples() if isinstance(s, Reading) or s.time_s % 1.0 == 0.0]
    e = feed(estimator(), [s for s in slow if isinstance(s, Reading) or not 870.0 < s.time_s < 874.0])
    assert e.messages == []
    assert e.counts.jumps == e.counts.off_clock == 0
    read = sum(len(step.rows) for step in e.stepper.past.steps)
    assert read == sum(1 for s in slow if isinstance(s, Reading) and s.time_s <= e.stepper.past.steps[-1].frame.time_s)


def stamped(by_s: float, since_s: float = 880.0, sensor: str | None = None) -> list[Sample]:
    """The samples by a clock that jumps, of all or of one sensor."""
    return [
        replace(s, time_s=s.time_s + by_s)
        if s.time_s >= since_s and (sensor is None or (isinstance(s, Reading) and s.sensor == sensor))
        else s
        for s in samples()
    ]


@pytest.mark.sample(1)
@pytest.mark.parametrize(("by_s", "late_s"), [(-1.0, 0.0), (-3.0, 0.0), (-3.0, 1.5), (-2.9, 1.5), (-1.6, 0.0)])
def test_clock_that_goes_back_a_little_is_told_and_repeats_are_unused(by_s, late_s):
    whole, rng = samples(), np.random.default_rng(3)
    delay = [rng.uniform(0.0, late_s) if s.time_s > BEGIN_S else 0.0 for s in whole]
    arriving = np.argsort([s.time_s + d for s, d in zip(whole, delay, strict=True)], kind="stable")
    given = stamped(by_s)
    e = feed(estimator(), [given[k] for k in arriving])
    assert e.counts.jumps == 1
    assert e.timeline.jump is not None
    assert e.timeline.jump.by_s == pytest.approx(by_s, abs=0.6)
    assert sum(("clock" in m and "back by about" in m) or "jumped back" in m for m in e.messages) == 1
    assert e.time_s == pytest.approx(END_S + by_s)
    found = e.estimates()[e.names[0]]
    (value, sigma), (alpha, alpha_sigma) = (found.parameters[n] for n in NAMES)
    assert abs(value - 0.05) < 3.0 * sigma
    assert abs(alpha) < 3.0 * alpha_sigma


def test_clock_that_goes_back_is_told_with_its_third_sample():
    """Also where its frames lie between those of the flight so far, so that none has the time of another."""
    e, told_s = estimator(), {}
    for sample in stamped(-1.6):
        e.add(sample)
        e.advance()
        for message in e.messages:
            told_s.setdefault(message, sample.time_s)
    first, then = told_s
    assert "that have come already: a clock that went back, or two sources" in first
    assert re.match("the clock went back by about 1.[56] s, from ", then)
    assert told_s[first] < 880.0 - 1.6 + 0.8
    assert 880.0 < told_s[then] < 880.0 + 2.5


@pytest.mark.thorough
@pytest.mark.sample(1)
@pytest.mark.parametrize("late_s", [0.0, 1.5])
def test_a_sensor_whose_own_clock_goes_back_is_left_out_from_there(late_s):
    name, rng = record().used_sensors[0].name, np.random.default_rng(4)
    delay = [rng.uniform(0.0, late_s) if s.time_s > BEGIN_S else 0.0 for s in samples()]
    arriving = np.argsort([s.time_s + d for s, d in zip(samples(), delay, strict=True)], kind="stable")
    given = stamped(-1.5, sensor=name)
    e = feed(estimator(), [given[k] for k in arriving])
    ((point, sensor, since_s, why),) = e.failed_clocks
    assert (point, sensor) == (e.names[0], name)
    assert since_s == pytest.approx(878.6, abs=0.6)
    assert "its clock went back" in why
    known = estimator()
    known.leave_out(point, name, since_s)
    feed(known, samples())
    a, b = (x.estimates()[point].parameters["ratio.scale"] for x in (e, known))
    assert a == pytest.approx(b, rel=1e-9)


def test_two_sources_of_one_quantity_are_no_jump():
    twice = [x for s in samples() for x in (s, replace(s, values={**s.values, "alpha_deg": s.values["alpha_deg"] + 0.1})
             if isinstance(s, Frame) else replace(s, value_K=s.value_K + 1.0))]  # fmt: skip
    e = feed(estimator(), twice)
    assert e.counts.jumps == 0
    assert [m.rpartition(": ")[2] for m in e.messages[1:]] == ["two sources of one quantity"]


def test_single_repeated_sample_with_another_value_changes_nothing(in_order):
    given = list(samples())
    at = next(k for k, s in enumerate(given) if isinstance(s, Reading) and s.time_s > 870.0)
    given.insert(at + 8, replace(given[at], value_K=given[at].value_K + 5.0))
    e = feed(estimator(), given)
    assert e.counts.jumps == 0
    assert not e.failed_clocks
    assert_same_bits(e, in_order)


SPIKE_S = 872.1


def spiked(by_K: float = 40.0, until_s: float = SPIKE_S) -> list[Sample]:
    """The samples with one reading that is far off, or all readings of its sensor up to a time."""
    name = record().used_sensors[1].name
    return [
        replace(s, value_K=s.value_K + by_K)
        if isinstance(s, Reading) and s.sensor == name and SPIKE_S - 0.01 < s.time_s < until_s + 0.01
        else s
        for s in samples()
    ]


def left_out(e: LiveEstimator, given) -> list[Innovation]:
    found = []
    for sample in given:
        e.add(sample)
        e.advance()
        found += [read for read in e.innovations() if read.is_left_out]
    return found


@pytest.mark.sample(1)
@pytest.mark.parametrize("by_K", [-40.0, 15.0])
def test_one_reading_far_off_is_left_out_as_if_it_had_been_lost(by_K):
    e, lost = estimator(), estimator()
    (read,) = left_out(e, spiked(by_K))
    assert (read.time_s, read.sensor) == (SPIKE_S, record().used_sensors[1].name)
    assert read.innovation_K == pytest.approx(by_K, abs=6.0)
    feed(lost, [s for s, t in zip(samples(), spiked(by_K), strict=True) if s == t])
    for a, b in zip(final(e), final(lost), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)


@pytest.mark.thorough
@pytest.mark.sample(1)
@pytest.mark.parametrize(("first_K", "second_K"), [(40.0, 40.0), (-40.0, -60.0), (40.0, -40.0)])
def test_two_distant_readings_in_a_row_count_as_lost(first_K, second_K):
    first, both = spiked(first_K), spiked(second_K, SPIKE_S + 0.5)
    given = [a if a != s else b for s, a, b in zip(samples(), first, both, strict=True)]
    e, lost = estimator(), estimator()
    assert [read.time_s for read in left_out(e, given)] == pytest.approx([SPIKE_S, SPIKE_S + 0.5])
    feed(lost, [s for s, t in zip(samples(), given, strict=True) if s == t])
    for a, b in zip(final(e), final(lost), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)


def test_three_readings_in_a_row_that_are_far_off_are_the_record_s():
    assert left_out(estimator(), spiked(40.0, SPIKE_S + 1.0)) == []


@pytest.mark.thorough
@pytest.mark.parametrize("seed", range(3))
def test_two_spikes_in_a_row_leave_the_same_bits_in_any_order(seed):
    rng = np.random.default_rng(seed)
    arrive = [s.time_s + (rng.uniform(0.0, 1.9) if s.time_s > BEGIN_S else 0.0) for s in samples()]
    given = spiked(40.0, SPIKE_S + 0.5)
    late = feed(estimator(), [given[k] for k in np.argsort(arrive, kind="stable")])
    assert_same_bits(late, feed(estimator(), given))


@pytest.mark.thorough
@pytest.mark.sample(1)
@pytest.mark.parametrize("seed", range(3))
def test_with_a_spike_in_it_the_estimate_has_the_same_bits_in_any_order(seed):
    rng = np.random.default_rng(seed)
    arrive = [s.time_s + (rng.uniform(0.0, 1.9) if s.time_s > BEGIN_S else 0.0) for s in samples()]
    given = spiked()
    late = feed(estimator(), [given[k] for k in np.argsort(arrive, kind="stable")])
    assert_same_bits(late, feed(estimator(), given))


def test_readings_that_step_up_and_stay_are_used_unexplained():
    assert left_out(estimator(), spiked(40.0, END_S)) == []


def test_expected_reading_is_used_however_far_from_its_neighbours(in_order):
    # between two readings that are wrong together it is the right one that looks like a spike
    name = record().used_sensors[1].name
    wrong = {round(SPIKE_S - 0.5, 3), round(SPIKE_S + 0.5, 3)}
    given = [
        replace(s, value_K=s.value_K + 40.0)
        if isinstance(s, Reading) and s.sensor == name and round(s.time_s, 3) in wrong
        else s
        for s in samples()
    ]
    assert {round(read.time_s, 3) for read in left_out(estimator(), given)} == wrong


def test_a_sensor_that_is_left_out_is_predicted_and_not_used():
    e, name = estimator(), record().used_sensors[0].name
    wrong = [
        Reading(s.time_s, s.point, s.sensor, s.value_K + 300.0)
        if isinstance(s, Reading) and s.sensor == name and s.time_s > 870.0
        else s
        for s in samples()
    ]
    e.leave_out(e.names[0], name, 870.0)
    feed(e, wrong)
    found = e.estimates()[e.names[0]]
    value, sigma = found.parameters["ratio.scale"]
    assert abs(value - 0.05) < 4.0 * sigma
    assert name in found.sensors


@pytest.mark.thorough
def test_readings_of_a_failed_sensor_are_taken_back_on_refiltering():
    name = record().used_sensors[0].name
    wrong = [
        replace(s, value_K=s.value_K + 10.0) if isinstance(s, Reading) and s.sensor == name and s.time_s > 870.0 else s
        for s in samples()
    ]
    told, known = feed(estimator(), wrong), estimator()
    before = told.estimates()[told.names[0]].parameters["ratio.scale"]
    told.leave_out(told.names[0], name, END_S + 1.0, wrong_s=870.0)
    assert told.filter_again()
    known.leave_out(known.names[0], name, 870.0)
    feed(known, wrong).filter_again()
    after, expected = (e.estimates()[e.names[0]].parameters["ratio.scale"] for e in (told, known))
    assert after[1] == pytest.approx(expected[1], rel=0.01)
    assert abs(after[0] - expected[0]) < 0.3 * expected[1] < abs(before[0] - expected[0])


@pytest.mark.parametrize(
    ("readings_K", "told"),
    [
        ((1e200, 400.0), r"no heating conducts to its first readings \(.*\); the declared temperatures are taken"),
        ((250.0, 3000.0), "no history of heating agrees with its first readings; the start misses them by up to 2"),
    ],
)
def test_readings_that_no_heating_explains_are_told_and_the_link_begins(readings_K, told):
    e = estimator()
    point = e.points[0]
    words = [Reading(BEGIN_S, point.name, s.name, T) for s, T in zip(point.sensors, readings_K, strict=True)]
    feed(e, [*words, *(s for s in samples() if isinstance(s, Frame))])
    (line,) = [m for m in e.messages if m.startswith(point.name)]
    assert re.search(told, line)
    profile, covariance = e.start_of(point.name)
    declared = initial_temperatures(point.model.construction, point.mesh)
    away = np.abs(profile[list(point.mesh.sensors)] - readings_K)
    assert np.array_equal(profile, declared) or np.all(away < 2.0 * np.sqrt(np.diag(covariance))[[*point.mesh.sensors]])
    assert e.time_s == END_S


def test_names_that_the_link_does_not_have_are_told_with_the_nearest():
    e = estimator()
    with pytest.raises(InputError, match="unknown control point"):
        e.add(Reading(850.0, "NOWHERE", "OE_surface", 300.0))
    with pytest.raises(InputError, match=r"no sensor `OE_surfac`.*OE_surface"):
        e.add(Reading(850.0, e.names[0], "OE_surfac", 300.0))
    with pytest.raises(InputError, match="running estimate cannot have it"):
        LiveEstimator(RecordPoints([record()], NODES), ("sensors.tau_s",))


def test_a_frame_that_lacks_a_column_is_told_and_not_used():
    e = estimator()
    e.add(Frame(850.0, {"alpha_deg": 40.0}))
    assert e.notices.refused == 1
    assert "not used" in e.messages[-1]


def test_priors_of_the_ratio_are_wide_and_those_of_the_stack_its_own():
    model = point_of_record(record())
    assert default_prior(model, "ratio.scale").sigma == 0.5
    assert default_prior(model, "stack.emissivity_factor") == Prior(1.0, 0.035)
    assert default_prior(model, "ratio.d_alpha2").sigma < default_prior(model, "ratio.d_alpha").sigma


def test_a_vehicle_in_flight_is_estimated_from_what_a_host_gives():
    import sim_heating as sh

    vehicle = sh.load_vehicle("orbiter")
    source = VehiclePoints(vehicle, ["LEE_UPPER"], nodes=NODES)
    e = LiveEstimator(source, ("ratio.scale",), options=LiveOptions(start="declared"))
    values = {"altitude_m": 74e3, "velocity_m_s": 6800.0, "alpha_deg": 40.0, "beta_deg": 0.0, "elevon_deg": 1.0,
              "bodyflap_deg": 15.0, "rho_kg_m3": 4.6e-5}  # fmt: skip
    plugin = sh.HeatingPlugin(vehicle, ["LEE_UPPER"], nodes=NODES)
    plugin.reset({"time_s": 0.0, **values})
    for k in range(1, 601):
        plugin.step({"time_s": k / 60.0, **values})
    e.add(*(Frame(k / 60.0, values) for k in range(601)))
    e.advance()
    assert e.estimates()["LEE_UPPER"].surface_K == pytest.approx(plugin.surface_K["LEE_UPPER"], abs=0.5)
    assert e.stepper.steps < 60
