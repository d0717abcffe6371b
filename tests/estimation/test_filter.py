"""What the Kalman filter must be: the textbook's on a linear wall, honest on a nonlinear one, the plain march without
noise."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest, chi2, kstest

from sim_heating.base.errors import InputError, RunError
from sim_heating.estimation.filter.march import Disturbance, FilterMarch, FilterTrack, Samples
from sim_heating.estimation.filter.smoother import smooth
from sim_heating.estimation.inference.likelihood import reading_intervals
from sim_heating.heating.effects import use
from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.linearised import LinearMarch, Track
from sim_heating.march.mesh_choice import pack
from sim_heating.march.point import PointModel
from sim_heating.thermal.mesh import Mesh, build_mesh
from sim_heating.thermal.stack import Sensor
from tests.march.test_kernel_interpreted import run_interpreted
from tests.support.dense_filter import LinearStep, dense_filter, dense_smoother, linear_step
from tests.support.filter_samples import samples_on_grid
from tests.support.walls import flight, material, practice_model, practice_record, wall

DT, STEPS = 2.0, 24
SENSORS = (0.002, 0.006)
WALKED = Disturbance(start_sigma=0.01, correlation_s=15.0, density_1_s=1e-5)


def linear_wall() -> tuple[PointModel, Mesh]:
    """Constant properties, no radiation and no wall enthalpy to speak of: a step linear in temperatures and ratio."""
    stack = wall((material(k=0.5), 0.01), back={"h_W_m2K": 100.0, "T_K": 300.0})
    model = PointModel("wall", stack, SENSORS, wall_enthalpy=1e-9, parameters={"ratio.d0": 0.02})
    return model, build_mesh(model.construction, np.array(SENSORS), 9)


TIME_S = DT * np.arange(STEPS + 1.0)
HEATED = flight(TIME_S, h_ref_kg_m2_s=1.0 + 0.5 * np.sin(0.2 * TIME_S), H_r_J_kg=1.5e6, q_add_W_m2=1e3 * TIME_S)
NOISE_K2_S = 0.02 * np.arange(1.0, 10.0)
START_K = np.linspace(500.0, 420.0, 9)


def some_covariance(n: int, sigma_K: float = 5.0) -> np.ndarray:
    """Neighbours of a profile that is not known err together."""
    apart = np.subtract.outer(np.arange(n), np.arange(n))
    return sigma_K**2 * np.exp(-np.abs(apart) / 3.0)


def wall_samples(times: np.ndarray, mesh: Mesh, seed: int = 1) -> Samples:
    """Readings that have little to do with the wall: equations hold for any."""
    rng = np.random.default_rng(seed)
    read = 500.0 + 5.0 * times + rng.normal(0.0, 5.0, (2, len(times)))
    return samples_on_grid(times, mesh.sensors, read, (0.5, 2.0))


def filter_wall(samples: Samples, **track):
    model, mesh = linear_wall()
    whole = {"initial_K": START_K, "covariance_K2": some_covariance(9), "noise_K2_s": NOISE_K2_S,
             "disturbance": WALKED} | track  # fmt: skip
    return FilterMarch([FilterTrack(model, mesh, samples, **whole)], TIME_S, HEATED).filter(keep=True)[0]


def test_a_point_filtered_twice_gives_the_same_result():
    model, mesh = linear_wall()
    track = FilterTrack(model, mesh, wall_samples(TIME_S[1:], mesh), (), START_K, disturbance=WALKED)
    march = FilterMarch([track], TIME_S, HEATED)
    first, again = march.filter()[0], march.filter()[0]
    assert first.ratio != 0.0
    np.testing.assert_array_equal(again.innovation_K, first.innovation_K)


@pytest.fixture(scope="module")
def steps() -> list[LinearStep]:
    model, mesh = linear_wall()
    decay = np.exp(-DT / WALKED.correlation_s)
    return [linear_step(model, mesh, HEATED[0, k : k + 2], DT, decay) for k in range(STEPS)]


def in_steps(samples: Samples) -> list[list[tuple[int, float, float, float]]]:
    """Readings of each step: node, fraction of the step, value, variance."""
    own = np.maximum(np.ceil(samples.time_s / DT - 1e-12).astype(int) - 1, 0)
    return [
        [
            (samples.node[i], samples.time_s[i] / DT - k, samples.lower_K[i], samples.variance_K2[i])
            for i in np.flatnonzero((own == k) & ~np.isnan(samples.lower_K))
        ]
        for k in range(STEPS)
    ]


def by_textbook(steps: list[LinearStep], samples: Samples):
    start = np.zeros((10, 10))
    start[:9, :9], start[9, 9] = some_covariance(9), WALKED.start_sigma**2
    gained = WALKED.density_1_s * 0.5 * WALKED.correlation_s * (1.0 - np.exp(-2.0 * DT / WALKED.correlation_s))
    return dense_filter(steps, DT, np.append(START_K, 0.0), start, NOISE_K2_S, gained, in_steps(samples))


def lost(samples: Samples, fraction: float) -> Samples:
    gone = np.random.default_rng(5).random(len(samples.time_s)) < fraction
    return replace(
        samples, lower_K=np.where(gone, np.nan, samples.lower_K), upper_K=np.where(gone, np.nan, samples.upper_K)
    )


WHEN = {
    "at the end of each step": TIME_S[1:],
    "at the start too": TIME_S,
    "every third step": TIME_S[3::3],
    "between steps": TIME_S[:-1] + 0.31 * DT,
    "several in a step": np.arange(0.3, TIME_S[-1], 0.7),
}


@pytest.mark.parametrize("when", WHEN)
@pytest.mark.parametrize("fraction_lost", [0.0, 0.4])
def test_linear_wall_is_filtered_as_by_the_textbook(steps, when, fraction_lost):
    _, mesh = linear_wall()
    samples = lost(wall_samples(WHEN[when], mesh), fraction_lost)
    filtered, dense = filter_wall(samples), by_textbook(steps, samples)
    history = filtered.history
    np.testing.assert_allclose(history.mean[:, :9], np.array(dense.mean)[:, :9], rtol=1e-8)
    np.testing.assert_allclose(history.mean[:, 9], np.array(dense.mean)[:, 9], rtol=1e-8, atol=1e-10)
    scale = np.sqrt(np.diagonal(np.array(dense.covariance), axis1=1, axis2=2))
    difference = (history.covariance - dense.covariance) / (scale[:, :, None] * scale[:, None, :])
    assert np.max(np.abs(difference)) < 1e-8
    assert np.sum(filtered.log_likelihood) == pytest.approx(dense.log_likelihood, rel=1e-9)


def test_start_uncertain_along_two_profiles_is_filtered_as_in_the_textbook(steps):
    model, mesh = linear_wall()
    samples = wall_samples(WHEN["several in a step"], mesh)
    profiles = np.array([5.0 * np.ones(9), np.linspace(8.0, -3.0, 9)]).T
    track = FilterTrack(model, mesh, samples, initial_K=START_K, covariance_K2=profiles @ profiles.T)
    filtered = FilterMarch([track], TIME_S, HEATED).filter(keep=True)[0]
    start = np.zeros((10, 10))
    start[:9, :9] = profiles @ profiles.T
    dense = dense_filter(steps, DT, np.append(START_K, 0.0), start, np.zeros(9), 0.0, in_steps(samples))
    np.testing.assert_allclose(filtered.history.mean[:, :9], np.array(dense.mean)[:, :9], rtol=1e-9)
    np.testing.assert_allclose(filtered.history.covariance, dense.covariance, atol=1e-9)
    assert np.linalg.matrix_rank(filtered.covariance, tol=1e-9) == 2
    assert np.sum(filtered.log_likelihood) == pytest.approx(dense.log_likelihood, rel=1e-9)


def test_smoothing_is_that_of_rauch_tung_and_striebel(steps):
    _, mesh = linear_wall()
    samples = wall_samples(TIME_S[2::2], mesh)
    smoothed, (mean, covariance) = smooth(filter_wall(samples)), dense_smoother(steps, by_textbook(steps, samples))
    np.testing.assert_allclose(smoothed.temperature_K, np.array(mean)[:, :9], rtol=1e-8)
    np.testing.assert_allclose(smoothed.ratio, np.array(mean)[:, 9], rtol=1e-7, atol=1e-9)
    variance = np.diagonal(np.array(covariance), axis1=1, axis2=2)
    np.testing.assert_allclose(smoothed.sigma_K**2, variance[:, :9], rtol=1e-7)
    np.testing.assert_allclose(smoothed.ratio_sigma**2, variance[:, 9], rtol=1e-7)


def test_smoothing_readings_between_steps_is_conditioning_on_all_at_once(steps):
    # by the filter itself: the mean at the start moves with a reading by covariance over variance
    _, mesh = linear_wall()
    samples = wall_samples(np.array([0.6, 5.3, 5.9, 17.1]), mesh)
    start = np.zeros((10, 10))
    start[:9, :9], start[9, 9] = some_covariance(9), WALKED.start_sigma**2
    rows, constants, F, u = [], [], np.eye(10), np.zeros(10)
    ends = {0: (F, u)}
    for k, step in enumerate(steps):
        F, u = step.F @ F, step.F @ u + step.u
        ends[k + 1] = F, u
    for t, node in zip(samples.time_s, samples.node, strict=True):
        k = int(t // DT)
        row, constant = steps[k].row(node, t / DT - k)
        rows.append(row @ ends[k][0])
        constants.append(row @ ends[k][1] + constant)
    R = np.array(rows)
    quiet = {"noise_K2_s": 0.0, "disturbance": replace(WALKED, density_1_s=0.0)}
    smoothed = smooth(filter_wall(samples, **quiet))
    S = R @ start @ R.T + np.diag(samples.variance_K2)
    K = np.linalg.solve(S, R @ start).T
    exact = np.append(START_K, 0.0) + K @ (samples.lower_K - R @ np.append(START_K, 0.0) - constants)
    np.testing.assert_allclose(smoothed.temperature_K[0], exact[:9], rtol=1e-8)
    np.testing.assert_allclose(smoothed.covariance[0], start - K @ S @ K.T, atol=1e-8 * 25.0)


def test_a_gain_and_a_bias_of_a_sensor_are_a_change_of_scale():
    _, mesh = linear_wall()
    plain = wall_samples(TIME_S[1:], mesh)
    seen = replace(
        plain, gain=plain.gain * 1.1, bias_K=plain.bias_K + 7.0, lower_K=1.1 * plain.lower_K + 7.0,
        upper_K=1.1 * plain.upper_K + 7.0, variance_K2=1.21 * plain.variance_K2,
    )  # fmt: skip
    a, b = filter_wall(plain), filter_wall(seen)
    np.testing.assert_allclose(b.temperature_K, a.temperature_K, rtol=1e-12)
    np.testing.assert_allclose(b.innovation_K, 1.1 * a.innovation_K, rtol=1e-8, atol=1e-8)


def test_a_reading_that_is_only_predicted_changes_nothing():
    _, mesh = linear_wall()
    plain = wall_samples(TIME_S[1:], mesh)
    watched = samples_on_grid(
        TIME_S[1:],
        (*mesh.sensors, 0),
        np.vstack([plain.lower_K.reshape(-1, 2).T, np.full(STEPS, np.nan)]),
        (0.5, 2.0, 1.0),
    )
    a, b = filter_wall(plain), filter_wall(watched)
    np.testing.assert_array_equal(b.temperature_K, a.temperature_K)
    surface = b.posterior_K.reshape(-1, 3)[:, 2]
    np.testing.assert_allclose(surface, b.history.mean[1:, 0], rtol=1e-12)


def test_a_wide_interval_changes_nothing_and_a_narrow_one_is_a_reading():
    _, mesh = linear_wall()
    plain = wall_samples(TIME_S[1:], mesh)
    narrow = replace(plain, lower_K=plain.lower_K - 1e-4, upper_K=plain.upper_K + 1e-4)
    np.testing.assert_allclose(filter_wall(narrow).temperature_K, filter_wall(plain).temperature_K, atol=1e-5)
    everything = np.full(len(plain.time_s), np.inf)
    nothing = filter_wall(replace(plain, lower_K=-everything, upper_K=everything))
    unread = filter_wall(lost(plain, 1.1))
    np.testing.assert_array_equal(nothing.temperature_K, unread.temperature_K)
    np.testing.assert_array_equal(nothing.covariance, unread.covariance)


def test_points_filtered_in_one_march_are_independent():
    model, mesh = linear_wall()
    fine = build_mesh(model.construction, np.array(SENSORS), 14)
    a = FilterTrack(model, mesh, wall_samples(TIME_S[1:], mesh), noise_K2_s=0.5, covariance_K2=np.eye(9))
    b = FilterTrack(
        model,
        fine,
        wall_samples(np.array([0.7, 30.0]), fine),
        ("ratio.d0",),
        disturbance=WALKED,
        covariance_K2=np.eye(14),
    )
    alone = [FilterMarch([p], TIME_S, HEATED).filter()[0] for p in (a, b)]
    together = FilterMarch([a, b], TIME_S, HEATED).filter()
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one.temperature_K, other.temperature_K)
        np.testing.assert_array_equal(one.innovation_K, other.innovation_K)
    np.testing.assert_array_equal(alone[1].sensitivity, together[1].sensitivity)


# A wall with its property tables and radiation -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def plug():
    """The five-layer plug of a practice record in a part of its entry: point, mesh, steps, history."""
    record, _ = practice_record("p06")
    model = practice_model("p06", nodes=14)
    history = condition_history(record.conditions)[np.newaxis, 300:501]
    return model, pack([model]).meshes[0], record.conditions.time_s[300:501], np.ascontiguousarray(history)


def profile_of(plug) -> np.ndarray:
    """Temperatures [K] of the plug at the start of that part, from the start of its entry."""
    model, mesh, _, _ = plug
    record, _ = practice_record("p06")
    t = record.conditions.time_s[:301]
    history = condition_history(record.conditions)[np.newaxis, :301]
    return LinearMarch([whole(model, mesh, t[-1:])], t, history).march()[0].temperature_K[:, 0]


def whole(model: PointModel, mesh: Mesh, times: np.ndarray, initial_K: np.ndarray | None = None) -> Track:
    """All nodes of a point at some times."""
    return Track(model, mesh, (), times, tuple(range(mesh.nodes)), initial_K)


@pytest.fixture(scope="module")
def hot(plug) -> np.ndarray:
    return profile_of(plug)


def test_without_noise_of_the_process_the_filter_is_the_plain_march(plug, hot):
    model, mesh, t, history = plug
    names = ("ratio.scale", "ratio.d_alpha", "stack.coating.thickness_factor", "stack.rsi.conductivity_factor")
    times = t[:-1] + 0.4
    marched = LinearMarch([Track(model, mesh, names, times, initial_K=hot)], t, history).march()[0]
    read = marched.temperature_K + np.random.default_rng(1).normal(0.0, 1.0, marched.temperature_K.shape)
    samples = samples_on_grid(times, mesh.sensors, read, 1.0)
    filtered = FilterMarch([FilterTrack(model, mesh, samples, names, hot)], t, history).filter()[0]
    shape = (len(times), len(mesh.sensors))
    np.testing.assert_allclose(filtered.prior_K.reshape(shape).T, marched.temperature_K, rtol=1e-11)
    np.testing.assert_allclose(filtered.posterior_K, filtered.prior_K, rtol=1e-14)
    found = filtered.sensitivity.reshape(*shape, -1).transpose(1, 0, 2)
    scale = np.max(np.abs(marched.sensitivity), axis=(0, 1))
    np.testing.assert_allclose(found / scale, marched.sensitivity / scale, atol=1e-6)


def test_a_ratio_that_lags_is_filtered_as_in_the_plain_march(plug, hot):
    model, mesh, t, history = plug
    lagging = replace(model, effects=(use("nonisothermal-wall", {"lag_s": 8.0}),))
    names = ("effect.nonisothermal-wall.lag_s", "effect.nonisothermal-wall.lag_fraction", "ratio.scale")
    marched = LinearMarch([Track(lagging, mesh, names, t[1:], initial_K=hot)], t, history).march()[0]
    samples = samples_on_grid(t[1:], mesh.sensors, marched.temperature_K, 1.0)
    filtered = FilterMarch([FilterTrack(lagging, mesh, samples, names, hot)], t, history).filter()[0]
    shape = (len(t) - 1, len(mesh.sensors))
    np.testing.assert_allclose(filtered.prior_K.reshape(shape).T, marched.temperature_K, rtol=1e-11)
    found = filtered.sensitivity.reshape(*shape, -1).transpose(1, 0, 2)
    scale = np.max(np.abs(marched.sensitivity), axis=(0, 1))
    # an effect's parameters are differenced over 2e-6 of their scale, where rounding of heat contents is some 1e-6
    np.testing.assert_allclose(found / scale, marched.sensitivity / scale, atol=1e-5)


def test_gradient_without_process_noise_is_that_of_the_log_likelihood(plug, hot):
    difference, exact, _ = gradients(plug, hot, noise_K2_s=0.0, sigma_K=0.0, away=0.02)
    np.testing.assert_allclose(exact, difference, rtol=1e-5)


def test_gradient_with_process_noise_is_good_to_a_twentieth_of_a_sigma(plug, hot):
    # what is left out is how the gain changes with a parameter: 4 % of the score's sigma for the coating's thickness,
    # below 0.1 % for the others; far off the mark, where the score is 50 sigma, it is 0.2 to 7 sigma
    for noise_K2_s in (0.0, 0.05):
        difference, approximate, sigma = gradients(plug, hot, noise_K2_s, sigma_K=3.0)
        assert np.all(np.abs(approximate - difference) < 0.05 * sigma)
        assert np.any(np.abs(approximate - difference) > 0.01 * sigma)


def gradients(plug, hot, noise_K2_s: float, sigma_K: float, away: float = 0.0):
    """By differences of the log likelihood, by the filter, and the score's standard deviation."""
    model, mesh, t, history = plug
    names, by = ("ratio.scale", "stack.coating.thickness_factor", "stack.rsi.conductivity_factor"), 2e-4
    truth = LinearMarch([Track(model, mesh, (), t[1:], initial_K=hot)], t, history).march()[0].temperature_K
    read = truth + np.random.default_rng(3).normal(0.0, 1.0, truth.shape)
    samples = samples_on_grid(t[1:], mesh.sensors, read, 1.0)
    start = model.with_parameters({"ratio.scale": model.value("ratio.scale") + away})

    def filtered(point: PointModel):
        track = FilterTrack(
            point, mesh, samples, names, hot, None, some_covariance(mesh.nodes, sigma_K), noise_K2_s=noise_K2_s
        )
        return FilterMarch([track], t, history).filter()[0]

    def log_likelihood(name: str, shift: float) -> float:
        return float(np.sum(filtered(start.with_parameters({name: start.value(name) + shift})).log_likelihood))

    difference = np.array([(log_likelihood(n, by) - log_likelihood(n, -by)) / (2.0 * by) for n in names])
    own = filtered(start)
    return difference, own.score(), np.sqrt(np.diag(own.information()))


def test_filter_from_a_wrong_profile_converges_to_the_truth(plug, hot):
    model, mesh, t, history = plug
    truth = LinearMarch([whole(model, mesh, t[1:], hot)], t, history).march()[0].temperature_K
    read = truth[list(mesh.sensors)] + np.random.default_rng(2).normal(0.0, 0.5, (len(mesh.sensors), len(t) - 1))
    samples = samples_on_grid(t[1:], mesh.sensors, read, 0.5)
    wrong = FilterTrack(model, mesh, samples, (), hot + 60.0, None, some_covariance(mesh.nodes, 60.0))
    filtered = FilterMarch([wrong], t, history).filter(keep=True)[0]
    smoothed = smooth(filtered)
    z = (filtered.temperature_K - truth[:, -1]) / np.sqrt(np.diag(filtered.covariance)[:-1])
    assert np.all(np.abs(z) < 4.0)
    coating = slice(0, mesh.sensors[0] + 1)
    assert np.max(np.abs(filtered.temperature_K - truth[:, -1])[coating]) < 0.3
    start = smoothed.temperature_K[0] - hot
    assert np.all(np.abs(start / smoothed.sigma_K[0]) < 4.0)
    assert np.sqrt(np.mean(start**2)) < 10.0  # from 60 K


def flown(plug, hot, rng: np.random.Generator, noise_K2_s: float, ratio: Disturbance, runs: int):
    """True temperatures (run, node, step) of the plug when its noise is that given to the filter."""
    model, mesh, t, history = plug
    profile = hot + rng.multivariate_normal(np.zeros(mesh.nodes), some_covariance(mesh.nodes), runs)
    d, truth = rng.normal(0.0, ratio.start_sigma, runs), np.empty((runs, mesh.nodes, len(t) - 1))
    for k in range(len(t) - 1):
        points = [model.with_parameters({"ratio.d0": x}) for x in d]
        ensemble = Ensemble(points, [mesh] * runs)
        for i in range(runs):
            ensemble.set_profile(i, profile[i])
        ensemble.march(t[k : k + 2], history[:, k : k + 2])
        profile = np.array([ensemble.node_temperatures(i) for i in range(runs)])
        profile += rng.normal(0.0, np.sqrt(noise_K2_s * (t[k + 1] - t[k])), profile.shape)
        decay = np.exp(-(t[k + 1] - t[k]) / ratio.correlation_s)
        d = decay * d + rng.normal(0.0, ratio.start_sigma * np.sqrt(1.0 - decay**2), runs)
        truth[:, :, k] = profile
    return truth


@pytest.mark.thorough
@pytest.mark.parametrize("bits", [None, 8])
def test_innovations_are_white_with_the_covariance_stated(plug, hot, bits):
    model, mesh, t, history = plug
    few, rng, ratio = slice(0, 61), np.random.default_rng(7), Disturbance.gauss_markov(0.01, 20.0)
    part = (model, mesh, t[few], np.ascontiguousarray(history[:, few]))
    truth = flown(part, hot, rng, 0.02, ratio, 40)
    sensor = Sensor(name="S", column="S_K", depth_m=0.0, bits=bits, range_K=None if bits is None else [255.0, 1644.0])
    lower, upper, tracks = [], [], []
    for run in truth:
        noisy = run[list(mesh.sensors)] + rng.normal(0.0, 1.0, (len(mesh.sensors), len(run[0])))
        seen = reading_intervals(sensor, noisy)
        samples = samples_on_grid(part[2][1:], mesh.sensors, seen.lower_K, 1.0, seen.upper_K)
        tracks.append(
            FilterTrack(
                model, mesh, samples, (), hot, None, some_covariance(mesh.nodes), noise_K2_s=0.02, disturbance=ratio
            )
        )
        lower.append(seen.lower_K)
        upper.append(seen.upper_K)
    found = [f for k in range(0, 40, 8) for f in FilterMarch(tracks[k : k + 8], part[2], part[3]).filter()]
    # every temperature at the end within its bounds, all readings of all runs
    last = np.array([f.temperature_K for f in found]) - truth[:, :, -1]
    z = last / np.array([np.sqrt(np.diag(f.covariance)[:-1]) for f in found])
    inside = int(np.sum(np.abs(z[:, mesh.sensors[0]]) < 1.96))
    assert binomtest(inside, len(z), 0.95).pvalue > 1e-3
    if bits is None:
        e = np.array([f.innovation_K / np.sqrt(f.variance_K2) for f in found])
        assert chi2.sf(np.sum(e**2), e.size) > 1e-3
        assert chi2.cdf(np.sum(e**2), e.size) > 1e-3
        assert kstest(e.ravel(), "norm").pvalue > 1e-3
        sensors = len(mesh.sensors)
        lag = np.sum(e[:, sensors:] * e[:, :-sensors]) / np.sqrt(e[:, sensors:].size)
        assert abs(lag) < 3.3


@settings(max_examples=4)
@given(
    sigma_K=st.floats(0.1, 5.0), noise_K2_s=st.floats(1e-4, 1.0), start_K=st.floats(0.1, 100.0), seed=st.integers(0, 99)
)
def test_covariance_stays_symmetric_and_positive_definite_over_a_flight(sigma_K, noise_K2_s, start_K, seed):
    model, mesh = linear_wall()
    t = np.linspace(0.0, 1500.0, 1501)
    read = np.random.default_rng(seed).normal(310.0, sigma_K, (2, 1500))
    samples = lost(samples_on_grid(t[1:], mesh.sensors, read, sigma_K), 0.3)
    track = FilterTrack(model, mesh, samples, (), None, None, some_covariance(9, start_K), noise_K2_s, WALKED)
    history = FilterMarch([track], t, flight(t, h_ref_kg_m2_s=0.5, H_r_J_kg=1e5)).filter(keep=True)[0].history
    np.testing.assert_array_equal(history.covariance, history.covariance.transpose(0, 2, 1))
    deviations = np.sqrt(np.diagonal(history.covariance, axis1=1, axis2=2))
    correlation = history.covariance / (deviations[:, :, None] * deviations[:, None, :])
    assert np.min(np.linalg.eigvalsh(correlation)) > 0.0


def test_frozen_gains_are_those_of_the_whole_filter_once_it_is_steady():
    model, mesh = linear_wall()
    t = np.arange(0.0, 401.0, DT)
    steady = flight(t, h_ref_kg_m2_s=0.5, H_r_J_kg=1e5)
    read = np.random.default_rng(4).normal(310.0, 1.0, (2, 2 * (len(t) - 1)))
    samples = samples_on_grid(np.arange(0.5, 400.5), mesh.sensors, read, 1.0)  # two of each sensor in a step
    whole = FilterTrack(model, mesh, samples, noise_K2_s=0.1, disturbance=WALKED, covariance_K2=np.eye(9))
    held = replace(whole, freeze_after_s=300.0)
    a, b = FilterMarch([whole, held], t, steady).filter()
    np.testing.assert_allclose(b.temperature_K, a.temperature_K, atol=1e-6)
    np.testing.assert_allclose(b.covariance, a.covariance, atol=1e-6)
    np.testing.assert_array_equal(b.innovation_K[:600], a.innovation_K[:600])
    with pytest.raises(InputError, match="freeze_after_s"):
        FilterMarch([held], t, steady).filter(keep=True)


def filtered_in_hex() -> list[str]:
    """Results of the filter for a few rounded readings, exactly."""
    model, mesh = linear_wall()
    plain = wall_samples(np.array([0.6, 2.0, 3.1, 3.9]), mesh)
    rounded = replace(plain, lower_K=plain.lower_K - 2.0, upper_K=plain.upper_K + 2.0)
    names = ("ratio.d0", "stack.rsi.conductivity_factor")
    track = FilterTrack(model, mesh, rounded, names, START_K, None, some_covariance(9), NOISE_K2_S, WALKED)
    f = FilterMarch([track], TIME_S[:4], np.ascontiguousarray(HEATED[:, :4])).filter(keep=True)[0]
    numbers = (f.temperature_K, f.innovation_K, f.variance_K2, f.sensitivity, f.covariance)
    return [float(x).hex() for array in numbers for x in array.ravel()]


@pytest.mark.thorough
@pytest.mark.skipif(os.environ.get("NUMBA_DISABLE_JIT", "0") != "0", reason="compares with the compiled kernel")
def test_interpreted_and_compiled_filters_agree_bit_for_bit():
    interpreted = run_interpreted(
        "import tests.estimation.test_filter as t; print('\\n'.join(t.filtered_in_hex()))"
    ).split()
    assert interpreted == filtered_in_hex()


# What cannot be filtered ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time_s": TIME_S[::-1]}, "in order of time"),
        ({"time_s": TIME_S + 1.0}, "1 .* lie outside the march"),
        ({"node": np.full(STEPS + 1, 9)}, "the mesh does not have"),
        ({"variance_K2": np.zeros(STEPS + 1)}, "noise_sigma_K"),
    ],
)
def test_invalid_readings_are_refused(change, message):
    samples = samples_on_grid(TIME_S, (4,), np.full((1, STEPS + 1), 500.0), 1.0)
    with pytest.raises(InputError, match=message):
        filter_wall(replace(samples, **change))


def test_a_filter_that_diverges_is_reported_with_its_time():
    _, mesh = linear_wall()
    samples = samples_on_grid(TIME_S[1:], mesh.sensors, np.full((2, STEPS), -1e5), 1.0)
    with pytest.raises(RunError, match="diverged at 2 s"):
        filter_wall(samples)


def test_smoothing_without_a_history_is_refused():
    model, mesh = linear_wall()
    track = FilterTrack(model, mesh, wall_samples(TIME_S[1:], mesh))
    with pytest.raises(InputError, match="keep=True"):
        smooth(FilterMarch([track], TIME_S, HEATED).filter()[0])
