"""What is ahead of a flight: predictions against the march and sampled parameters, stops against every one tried."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.live.ahead.futures import Course, FlownPath, Futures
from sim_heating.live.ahead.look_ahead import RESOLUTION_S, LookAhead, Predicted, passing_probability
from sim_heating.live.engine import LinkEngine
from sim_heating.live.filtering.estimates import LiveEstimate, LiveOptions
from sim_heating.live.filtering.estimator import LiveEstimator, Prior
from sim_heating.live.filtering.points import VehiclePoints
from sim_heating.live.types import Frame, Message, Reading
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.point import PointModel
from sim_heating.trajectory.flight import Window
from tests.live.links import FRAME, json_lines, link

POINT = "V09T9527"
NAMES = ("ratio.scale", "ratio.d_alpha", "stack.rsi.conductivity_factor")
PRIORS = dict(zip(NAMES, (Prior(0.03, 0.03), Prior(0.001, 0.0002), Prior(1.05, 0.05)), strict=True))
NOW_S, START_S, LENGTH_S = 40.0, 60.0, 24.0
TIMES = np.arange(0.0, 400.5, 0.5)


def path(alpha_deg: Callable[[np.ndarray], np.ndarray]) -> FlownPath:
    """An entry that slows down by 3 m/s2 and descends by 15 m/s, its density growing as in an isothermal atmosphere."""
    z = 72e3 - 15.0 * TIMES
    return FlownPath({
        "time_s": TIMES, "altitude_m": z, "velocity_m_s": 6200.0 - 3.0 * TIMES, "alpha_deg": alpha_deg(TIMES),
        "beta_deg": 0.0 * TIMES, "elevon_deg": 1.0 + 0.0 * TIMES, "bodyflap_deg": 15.0 + 0.0 * TIMES,
        "rho_kg_m3": 6e-5 * np.exp((72e3 - z) / 7000.0), "jets": 0.0 * TIMES,
    })  # fmt: skip


def pull_up(t: np.ndarray) -> np.ndarray:
    """Down 5 deg, up 5 deg above the nominal angle of 40 deg, and back, at 1 deg/s."""
    return 40.0 + np.interp(t - START_S, [0, 5, 7, 17, 19, 24], [0, -5, -5, 5, 5, 0])


@pytest.fixture(scope="module")
def source() -> VehiclePoints:
    return VehiclePoints(load_vehicle("orbiter"), [POINT, "LOWER_MID"])


@pytest.fixture(scope="module")
def futures(source: VehiclePoints) -> Futures:
    nominal = path(lambda t: 40.0 + 0.0 * t)
    window = Window("popu", START_S, START_S + LENGTH_S)
    return Futures(source.columns, nominal, path(pull_up), [window], {"alpha_deg": 1.0})


def frame_of(flown: Mapping[str, np.ndarray], k: int = 0) -> Frame:
    return Frame(float(flown["time_s"][k]), {n: float(v[k]) for n, v in flown.items() if n != "time_s"})


def followed(
    source: VehiclePoints, futures: Futures, until_s: float, priors: Mapping[str, Prior] = PRIORS
) -> LiveEstimator:
    """An estimator that has followed the planned flight without a reading."""
    estimator = LiveEstimator(source, NAMES, priors, LiveOptions(start="declared", linearise_s=np.inf))
    flown = futures.planned.at(np.arange(0.0, until_s + 0.125, 0.25))
    estimator.add(*(frame_of(flown, k) for k in range(len(flown["time_s"]))))
    estimator.advance()
    return estimator


def read_until(source: VehiclePoints, futures: Futures, last_reading_s: float, until_s: float) -> LiveEstimator:
    """An estimator that came up at 20 s, with a start from its readings of a ratio that is 5 % higher."""
    priors = {**PRIORS, "ratio.scale": Prior(0.05, 0.03)}
    estimator, truth = (
        LiveEstimator(source, NAMES, PRIORS, LiveOptions(start="readings")),
        followed(source, futures, 20.0, priors),
    )
    for t in np.arange(20.25, until_s + 0.125, 0.25):
        frame = frame_of(futures.planned.at(np.array([t])))
        for one in (truth, estimator):
            one.add(frame)
            one.advance()
        if t <= last_reading_s:
            estimator.add(Reading(frame.time_s, POINT, POINT, truth.estimates()[POINT].surface_K))
    return estimator


@pytest.fixture(scope="module")
def now(source: VehiclePoints, futures: Futures) -> tuple[dict[str, LiveEstimate], Frame]:
    return followed(source, futures, NOW_S).estimates(), frame_of(futures.planned.at(np.array([NOW_S])))


def march(
    model: PointModel, source: VehiclePoints, start_K: np.ndarray, time_s: np.ndarray, history: np.ndarray
) -> np.ndarray:
    """(2, time) surface and bondline of a point along conditions [K], in short steps."""
    mesh = source.points[0].mesh
    plain = Ensemble([model], [mesh])
    plain.set_profile(0, start_K)
    return plain.march(time_s, history[np.newaxis], keep=plain.node_offsets(0, (0, mesh.bondline))).T


@pytest.mark.thorough
def test_a_prediction_is_what_the_estimator_has_when_the_future_has_come(source, futures, now) -> None:
    estimates, frame = now
    planned = LookAhead(source, {}, futures, 60.0).predict(estimates, frame)[POINT].futures["planned"]
    later = followed(source, futures, NOW_S + 60.0).estimates()[POINT]
    assert planned.time_s[-1] == NOW_S + 60.0
    assert planned.surface_K[-1] == pytest.approx(later.surface_K, abs=0.5)
    assert planned.bondline_K[-1] == pytest.approx(later.bondline_K, abs=0.1)
    assert planned.surface_sigma_K[-1] == pytest.approx(later.surface_sigma_K, rel=0.01)
    assert planned.bondline_sigma_K[-1] == pytest.approx(later.bondline_sigma_K, rel=0.02, abs=1e-4)


@pytest.mark.thorough
def test_knowledge_from_readings_and_an_uncertain_start_are_carried_on(source, futures) -> None:
    before = read_until(source, futures, 30.0, NOW_S)
    frame = frame_of(futures.planned.at(np.array([NOW_S])))
    planned = LookAhead(source, {}, futures, 60.0).predict(before.estimates(), frame)[POINT].futures["planned"]
    later = read_until(source, futures, 30.0, NOW_S + 60.0).estimates()[POINT]
    assert planned.surface_K[-1] == pytest.approx(later.surface_K, abs=0.5)
    assert planned.surface_sigma_K[-1] == pytest.approx(later.surface_sigma_K, rel=0.02)
    assert planned.bondline_sigma_K[-1] == pytest.approx(later.bondline_sigma_K, rel=0.02, abs=1e-4)


@pytest.mark.parametrize("horizon_s", [60.0, 300.0])
def test_the_mean_is_the_plain_march_on_each_future(source, futures, now, horizon_s) -> None:
    estimates, frame = now
    found = LookAhead(source, {}, futures, horizon_s).predict(estimates, frame)[POINT].futures
    state = estimates[POINT].state
    model = source.points[0].model.with_parameters(dict(zip(state.names, state.values.tolist(), strict=True)))
    for name, future in futures.after(frame).items():
        time_s = np.arange(NOW_S, NOW_S + horizon_s + 0.125, 0.25)
        plain = march(model, source, state.temperature_K, time_s, source.histories(future.at(time_s))[0])
        own = found[name]
        assert np.max(np.abs(np.interp(own.time_s, time_s, plain[0]) - own.surface_K)) < 1.0
        assert np.max(np.abs(np.interp(own.time_s, time_s, plain[1]) - own.bondline_K)) < 0.2
        assert own.peak_surface_K == pytest.approx(np.max(plain[0]), abs=0.5)


@pytest.mark.thorough
def test_sigma_is_that_of_sampled_parameters(source, futures, now) -> None:
    estimates, frame = now
    own = LookAhead(source, {}, futures, 300.0).predict(estimates, frame)[POINT].futures["planned"]
    state = estimates[POINT].state
    future = futures.after(frame)["planned"]
    time_s = np.linspace(NOW_S, NOW_S + 300.0, 301)
    history = source.histories(future.at(time_s))[0]
    drawn = np.random.default_rng(3).multivariate_normal(state.values, state.covariance, 300)
    ends = []
    for p in drawn:
        model = source.points[0].model.with_parameters(dict(zip(state.names, p.tolist(), strict=True)))
        start = state.temperature_K + state.sensitivity[:-1] @ (p - state.values)
        ends.append(march(model, source, start, time_s, history)[:, -1])
    # of 300 draws a standard deviation is known to 4 %
    assert np.std(ends, axis=0) == pytest.approx([own.surface_sigma_K[-1], own.bondline_sigma_K[-1]], rel=0.12)


@pytest.mark.thorough
def test_wandering_ratio_is_carried_on_with_its_long_run_uncertainty(source, futures) -> None:
    options = LiveOptions(start="declared", linearise_s=np.inf, ratio_noise=(0.02, 30.0))
    estimator = LiveEstimator(source, NAMES, PRIORS, options)
    flown = futures.nominal.at(np.arange(0.0, NOW_S + 0.125, 0.25))
    estimator.add(*(frame_of(flown, k) for k in range(len(flown["time_s"]))))
    estimator.advance()
    frame = frame_of(flown, -1)
    held = LookAhead(source, {}, None, 60.0, ratio_sigma=0.02).predict(estimator.estimates(), frame)[POINT]
    for k in range(1, 121):
        estimator.add(Frame(NOW_S + 0.5 * k, frame.values))
    estimator.advance()
    later = estimator.estimates()[POINT]
    sigma = held.futures["held"].surface_sigma_K
    assert sigma[0] < sigma[-1]
    # the surface follows the ratio within seconds: a ratio that stays and one that wanders leave it as uncertain
    assert sigma[-1] == pytest.approx(later.surface_sigma_K, rel=0.1)
    assert sigma[-1] >= later.surface_sigma_K


def test_an_error_of_the_ratio_widens_the_bands_by_what_a_higher_ratio_does(source, futures, now) -> None:
    """Against a march whose laminar ratio is 5 % of the whole ratio higher from now on."""
    estimates, frame = now
    state = estimates[POINT].state
    plain = LookAhead(source, {}, None, 60.0).predict(estimates, frame)[POINT].futures["held"]
    wide = LookAhead(source, {}, None, 60.0, heating_error=0.05).predict(estimates, frame)[POINT].futures["held"]
    added = np.sqrt(wide.surface_sigma_K[-1] ** 2 - plain.surface_sigma_K[-1] ** 2)
    time_s = np.arange(NOW_S, NOW_S + 60.125, 0.25)
    history = source.histories({n: np.full(len(time_s), v) for n, v in frame.values.items()} | {"time_s": time_s})[0]
    model, own = source.points[0].model, dict(zip(state.names, state.values.tolist(), strict=True))
    ends = [
        march(model.with_parameters(own | {"ratio.d0": d}), source, state.temperature_K, time_s, history)[0, -1]
        for d in (0.0, 0.05 * state.ratio)
    ]
    assert added == pytest.approx(ends[1] - ends[0], rel=0.05)


def test_exact_estimate_passes_a_limit_certainly_or_not_at_all(source, futures) -> None:
    known = followed(source, futures, NOW_S, {n: Prior(p.mean, 1e-9) for n, p in PRIORS.items()}).estimates()
    frame = frame_of(futures.planned.at(np.array([NOW_S])))
    peak = LookAhead(source, {}, futures, 60.0).predict(known, frame)[POINT].futures["planned"].peak_surface_K
    for above, probability in ((1.0, 0.0), (-1.0, 1.0)):
        limits = {POINT: {"surface_K": peak + above}}
        planned = LookAhead(source, limits, futures, 60.0).predict(known, frame)[POINT].futures["planned"]
        assert max(planned.surface_sigma_K) < 1e-3
        assert (planned.probability, planned.margin_K) == (probability, pytest.approx(above))


def test_a_point_that_never_reaches_its_limit_needs_no_stop(source, futures, now) -> None:
    limits = {POINT: {"surface_K": 2000.0, "bondline_K": 450.0}}
    ahead = LookAhead(source, limits, futures, 120.0).predict(*now)[POINT]
    assert (ahead.knock_off, ahead.knock_off_by_s) == ("never needed", None)
    assert all(f.probability == pytest.approx(0.0, abs=1e-12) and f.margin_K > 100.0 for f in ahead.futures.values())


def test_a_point_without_limits_has_no_margin_and_no_word_on_stopping(source, futures, now) -> None:
    ahead = LookAhead(source, {}, futures, 60.0).predict(*now)["LOWER_MID"]
    assert (ahead.knock_off, ahead.futures["held"].margin_K, ahead.futures["held"].probability) == (
        "unknown",
        None,
        None,
    )


def between(source, futures, now, share: float) -> float:
    """A surface limit between the peaks of the nominal and the planned flight [K]."""
    found = LookAhead(source, {}, futures, 60.0).predict(*now)[POINT].futures
    # at 1.645 sigma above its mean it is passed with a probability of 5 %
    low, high = (
        np.max(np.add(f.surface_K, np.multiply(1.645, f.surface_sigma_K)))
        for f in map(found.get, ("nominal", "planned"))
        if f
    )
    assert high > low + 10.0
    return low + share * (high - low)


@pytest.mark.sample(1)
@pytest.mark.parametrize("share", [0.3, 0.7])
def test_the_latest_stop_is_that_of_trying_every_one(source, futures, now, share) -> None:
    limits = {POINT: {"surface_K": between(source, futures, now, share)}}
    estimates, frame = now
    look = LookAhead(source, limits, futures, 60.0)
    ahead = look.predict(estimates, frame)[POINT]
    assert ahead.knock_off == "by"
    planned = futures.after(frame)["planned"]
    assert isinstance(planned, Course)
    stops = np.arange(NOW_S, START_S + LENGTH_S, 0.25)
    passed = np.concatenate(
        [
            look.stop_probabilities(0, estimates[POINT].state, frame, planned, stops[k : k + 8])
            for k in range(0, len(stops), 8)
        ]
    )
    latest = stops[np.flatnonzero(passed <= 0.05)[-1]]
    assert ahead.knock_off_by_s == pytest.approx(latest, abs=2.0 * RESOLUTION_S)
    assert START_S < latest < START_S + LENGTH_S


def test_a_surer_stop_comes_earlier_and_a_wider_limit_later(source, futures, now) -> None:
    limit = between(source, futures, now, 0.5)
    by = {
        (keep, wider): LookAhead(source, {POINT: {"surface_K": limit + wider}}, futures, 60.0, keep)
        .predict(*now)[POINT]
        .knock_off_by_s
        for keep, wider in ((0.94, 0.0), (0.95, 0.0), (0.95, 2.0))
    }
    assert by[0.95, 0.0] < by[0.94, 0.0]
    assert by[0.95, 0.0] < by[0.95, 2.0]


def test_a_limit_that_stopping_now_does_not_keep_is_told_as_too_late(source, futures, now) -> None:
    surface = now[0][POINT].surface_K
    ahead = LookAhead(source, {POINT: {"surface_K": surface - 10.0}}, futures, 60.0).predict(*now)[POINT]
    assert (ahead.knock_off, ahead.knock_off_by_s) == ("too late", None)
    assert ahead.futures["nominal"].probability > 0.05


def test_held_conditions_are_the_only_future_without_a_scenario(source, now) -> None:
    ahead = LookAhead(source, {POINT: {"surface_K": 2000.0}}, None, 60.0).predict(*now)[POINT]
    assert (list(ahead.futures), ahead.knock_off) == (["held"], "unknown")


# Probability ----------------------------------------------------------------------------------------------------------


def predicted(apart_K: float, loading_K: np.ndarray) -> Predicted:
    time_s = np.arange(float(loading_K.shape[1]))
    return Predicted.of(time_s, np.full(loading_K.shape[:2], 1000.0 - apart_K), loading_K)


def test_instants_that_move_together_pass_a_limit_together() -> None:
    loading = np.zeros((2, 40, 2))
    loading[0, :, 0] = 10.0
    p = passing_probability(predicted(10.0, loading), np.array([1000.0, np.inf]))
    assert p == pytest.approx(0.15866, abs=0.003)  # 1 sigma


def test_independent_limits_are_passed_with_the_probability_of_either() -> None:
    loading = np.zeros((2, 5, 2))
    loading[0, 2, 0], loading[1, 4, 1] = 10.0, 10.0
    p = passing_probability(predicted(10.0, loading), np.array([1000.0, 1000.0]))
    assert p == pytest.approx(1.0 - (1.0 - 0.15866) ** 2, abs=0.005)


# Futures --------------------------------------------------------------------------------------------------------------


def test_a_stop_returns_to_the_nominal_angle_at_the_rate_of_the_manoeuvre(futures) -> None:
    frame = frame_of(futures.planned.at(np.array([NOW_S])))
    planned = futures.after(frame)["planned"]
    assert isinstance(planned, Course)
    stop = START_S + 6.0  # 5 deg below the nominal angle
    alpha = futures.stopped(planned, frame, stop).at(stop + np.array([-1.0, 0.0, 2.0, 5.0, 30.0]))["alpha_deg"]
    assert alpha == pytest.approx([35.0, 35.0, 37.0, 40.0, 40.0])


def test_position_on_the_flight_follows_velocity_and_not_the_clock(futures) -> None:
    there = frame_of(futures.planned.at(np.array([100.0])))
    later = Frame(there.time_s + 5000.0, there.values)
    nominal = futures.after(later)["nominal"].at(np.array([5100.0, 5150.0]))
    assert nominal["velocity_m_s"] == pytest.approx([6200.0 - 300.0, 6200.0 - 450.0])


def test_a_thinner_atmosphere_stays_thinner_and_a_trim_that_differs_stays(futures) -> None:
    there = frame_of(futures.planned.at(np.array([100.0])))
    values = {**there.values, "rho_kg_m3": 0.9 * there.values["rho_kg_m3"], "elevon_deg": 3.0, "alpha_deg": 42.0}
    then = futures.after(Frame(100.0, values))["nominal"].at(np.array([160.0]))
    usual = futures.nominal.at(np.array([160.0]))
    assert then["rho_kg_m3"] == pytest.approx(0.9 * usual["rho_kg_m3"])
    assert then["elevon_deg"] == pytest.approx([3.0])
    assert then["alpha_deg"] == pytest.approx([40.0])


def test_a_flight_without_a_column_of_the_frames_is_refused() -> None:
    flown = path(pull_up)
    with pytest.raises(InputError, match="the flight has no `h_ref_kg_m2_s`"):
        Futures(["velocity_m_s", "h_ref_kg_m2_s"], flown, flown, [])


# A link ---------------------------------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_link_with_a_scenario_publishes_three_futures_every_second() -> None:
    # no reading tells the slopes of the table: with their wide priors no limit would be kept for sure
    one = {"parameters": ["ratio.scale"]}
    made = link(ahead={"scenario": "../popu_mach20.toml", "horizon_s": 60.0}, estimate=one)
    engine = LinkEngine(made)
    assert engine.ahead.problem == ""
    for k in range(40):
        row = {**FRAME, "time_s": 0.25 * k, "velocity_m_s": 6150.0 - 0.75 * k}
        engine.take(Message(0.0, json_lines([row]), row))
        engine.advance()
    engine.end()
    own = engine.state().points[POINT]
    assert set(own.ahead) == {"nominal", "held", "planned"}
    assert own.ahead["held"].time_s[0] == 9.75
    assert own.knock_off == "never needed"
    # at 6096 m/s, in 8 s, the manoeuvre begins: colder than the nominal flight in its pushover, hotter in its pull-up
    planned, nominal = own.ahead["planned"], own.ahead["nominal"]
    hotter = np.array(planned.surface_K) - np.interp(planned.time_s, nominal.time_s, nominal.surface_K)
    assert np.argmin(hotter) < np.argmax(hotter)
    assert np.min(hotter) < -1.0
    assert np.max(hotter) > 1.0


@pytest.mark.parametrize(("every_s", "again"), [(1.0, True), (60.0, False)])
def test_futures_begin_as_often_as_the_link_states(every_s: float, again: bool) -> None:
    engine = LinkEngine(link(ahead={"every_s": every_s}, estimate={"parameters": ["ratio.scale"], "start": "declared"}))
    for k in range(3):
        row = {**FRAME, "time_s": float(k)}
        engine.take(Message(0.0, json_lines([row]), row))
        engine.advance()
    latest = engine.state().points[POINT].ahead["held"].time_s[0]
    engine.ahead._not_before_s = 0.0  # that this machine has time for it is another matter
    assert engine.ahead.due(latest + 30.0) == again


@pytest.mark.parametrize("horizon_s", [20.0, 45.0])
def test_futures_end_at_the_horizon_of_the_link(horizon_s: float) -> None:
    one = {"parameters": ["ratio.scale"], "start": "declared"}
    engine = LinkEngine(link(ahead={"horizon_s": horizon_s}, estimate=one))
    for k in range(3):
        row = {**FRAME, "time_s": float(k)}
        engine.take(Message(0.0, json_lines([row]), row))
        engine.advance()
    time_s = engine.state().points[POINT].ahead["held"].time_s
    assert time_s[-1] - time_s[0] == horizon_s


def test_scenario_that_cannot_be_flown_leaves_held_conditions_and_a_remark() -> None:
    made = link(ahead={"scenario": "../popu_mach20.toml"})
    assert made.scenario is not None
    spec = made.scenario.declared.trajectory
    late = spec.model_copy(update={"stop": spec.stop.model_copy(update={"time_s": 0.01})})
    declared = made.scenario.declared.model_copy(update={"trajectory": late})
    engine = LinkEngine(replace(made, scenario=replace(made.scenario, declared=declared)))
    assert "the look-ahead has the present conditions alone" in engine.ahead.problem
