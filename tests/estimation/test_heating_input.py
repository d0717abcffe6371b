"""The heating that the model lacks, from one thermocouple at the inner face of the coating: recovered as well as said.

Truth is marched on a mesh of half the elements' length with steps of a quarter of a second.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binomtest, chi2

from sim_heating.estimation.filter.heating_input import UnknownInput, bandwidth_Hz, unknown_input
from sim_heating.estimation.filter.march import Disturbance, FilterMarch, FilterTrack
from sim_heating.estimation.filter.smoother import smooth
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.point import PointModel
from sim_heating.thermal.mesh import Mesh, build_mesh, halve_elements
from tests.estimation.test_filter import HEATED, START_K, linear_wall, some_covariance, wall_samples
from tests.estimation.test_filter import TIME_S as LINEAR_S
from tests.support.filter_samples import samples_on_grid
from tests.support.walls import flight, practice_model

History = Callable[[np.ndarray], np.ndarray]
TIME_S = np.arange(0.0, 301.0)
JUMP_S = 0.01
FINE_S = np.append(np.add.outer(TIME_S[:-1], [0.0, JUMP_S, 0.25, 0.5, 0.75]).ravel(), TIME_S[-1])
RATIO, SIGMA_K = 0.04, 1.0
WALKED = Disturbance.gauss_markov(0.003, 30.0)


def heated(time_s: np.ndarray, added: np.ndarray) -> np.ndarray:
    """A steady flight; the addition to the ratio is in the column of alpha, per degree."""
    return flight(time_s, h_ref_kg_m2_s=0.1, H_r_J_kg=2e7, p_surface_Pa=500.0, alpha_deg=added)


def tile(added: float = 0.0, deep: bool = False) -> PointModel:
    """Coating and tile of a practice record, a thermocouple below the coating or 5 mm deeper."""
    plug = practice_model("p06")
    depth = plug.depths_m[0] + (0.005 if deep else 0.0)
    return PointModel("tile", plug.construction, (depth,), parameters={"ratio.d0": RATIO, "ratio.d_alpha": added})


def mesh_of(model: PointModel) -> Mesh:
    return build_mesh(model.construction, np.array(model.depths_m), 14, 1.0)


def flown(truth: History, seed: int, deep: bool = False) -> FilterTrack:
    """The tile with noisy readings every second of a flight with something added, after 200 s without."""
    model = tile(1.0, deep)
    mesh = mesh_of(model)
    ensemble = Ensemble([model], [halve_elements(mesh)])
    warm = np.arange(-200.0, 0.5)
    ensemble.march(warm, heated(warm, 0.0 * warm))
    start = ensemble.node_temperatures(0)
    out = ensemble.march(FINE_S, heated(FINE_S, truth(FINE_S)))[::5, 2]
    read = out[1:] + np.random.default_rng(seed).normal(0.0, SIGMA_K, len(TIME_S) - 1)
    samples = samples_on_grid(TIME_S[1:], mesh.sensors, read[np.newaxis], SIGMA_K)
    return FilterTrack(tile(deep=deep), mesh, samples, (), start[::2])


def found(truth: History, seed: int, disturbance: Disturbance | None = None, deep: bool = False) -> UnknownInput:
    return unknown_input(flown(truth, seed, deep), TIME_S, heated(TIME_S, 0.0 * TIME_S), disturbance)


def test_on_a_linear_wall_the_input_is_that_of_the_smoother():
    # two ways to one posterior: Rauch-Tung-Striebel on the filter, and all readings at once
    model, mesh = linear_wall()
    samples = wall_samples(np.append(LINEAR_S[1:], [3.3, 17.9]), mesh)
    order = np.argsort(samples.time_s, kind="stable")
    samples = replace(
        samples, **{f: getattr(samples, f)[order] for f in ("time_s", "node", "lower_K", "upper_K", "variance_K2")}
    )
    taken = Disturbance.gauss_markov(0.01, 15.0)
    track = FilterTrack(model, mesh, samples, (), START_K, covariance_K2=some_covariance(9), disturbance=taken)
    march = FilterMarch([track, replace(track, disturbance=Disturbance())], LINEAR_S, HEATED)
    filtered, without = march.filter(keep=True)
    smoothed = smooth(filtered)
    found = unknown_input(track, LINEAR_S, HEATED, taken)
    np.testing.assert_allclose(found.delta_ratio, smoothed.ratio[:-1], atol=1e-6 * np.max(np.abs(smoothed.ratio)))
    np.testing.assert_allclose(found.sigma, smoothed.ratio_sigma[:-1], rtol=1e-6)
    np.testing.assert_allclose(found.temperature_K, smoothed.temperature_K, atol=1e-4)
    gain = float(np.sum(filtered.log_likelihood) - np.sum(without.log_likelihood))
    assert found.gain_log_likelihood == pytest.approx(gain, rel=1e-6)


def test_a_long_march_has_fewer_knots_and_the_same_result():
    short = found(sinusoid, 6, WALKED)
    track = flown(sinusoid, 6)
    time = np.linspace(0.0, 300.0, 601)
    finer = unknown_input(track, time, heated(time, 0.0 * time), WALKED)
    assert len(finer.time_s) <= 320 < len(time)
    apart = np.interp(short.time_s, finer.time_s, finer.delta_ratio) - short.delta_ratio
    assert np.max(np.abs(apart)) < 0.3 * np.median(short.sigma)


def step(t: np.ndarray) -> np.ndarray:
    return 0.004 * np.clip(t - 150.0, 0.0, 1.0)


def ramp(t: np.ndarray) -> np.ndarray:
    return 0.006 * np.clip((t - 60.0) / 180.0, 0.0, 1.0)


def sinusoid(t: np.ndarray) -> np.ndarray:
    return 0.004 * np.sin(2.0 * np.pi * t / 60.0)


def walk(seed: int) -> History:
    """A draw of the process itself: a value holds for a second, reached in the first hundredth of it."""
    rng, decay = np.random.default_rng(seed), np.exp(-1.0 / WALKED.correlation_s)
    values = [rng.normal(0.0, WALKED.start_sigma)]
    for _ in TIME_S[1:]:
        values.append(decay * values[-1] + rng.normal(0.0, WALKED.start_sigma * np.sqrt(1.0 - decay**2)))
    at = np.add.outer(TIME_S, [JUMP_S, 1.0]).ravel()
    return lambda t: np.interp(t, at, np.repeat(values, 2))


@pytest.mark.parametrize("truth", [step, ramp, sinusoid])
def test_a_tenth_of_the_ratio_is_recovered_within_its_sigma(truth):
    # smoother than the process that is taken for it, so that the error is below its sigma: mean square 0.2 to 0.9
    correction = found(truth, seed=0)
    error = correction.delta_ratio - truth(correction.time_s)
    z = error / correction.sigma
    assert 0.1 < np.mean(z**2) < 1.3
    jump = np.abs(correction.time_s - 150.5) < 0.5 / np.median(correction.bandwidth_Hz)
    assert np.max(np.abs(z[~jump if truth is step else slice(None)])) < 4.0
    assert np.sqrt(np.mean(error**2)) < 0.1 * np.ptp(truth(TIME_S))
    assert correction.gain_log_likelihood > 1000.0


@pytest.mark.thorough
def test_draws_of_the_process_lie_within_their_bounds_as_often_as_stated():
    z = []
    for seed in range(24):
        truth = walk(100 + seed)
        correction = found(truth, seed, WALKED)
        apart = slice(29, 300, 60)  # two correlation times: nearly independent
        z.append((correction.delta_ratio - truth(correction.time_s))[apart] / correction.sigma[apart])
    z = np.array(z)
    assert binomtest(int(np.sum(np.abs(z) < 1.96)), z.size, 0.95).pvalue > 1e-3
    assert 1e-3 < chi2.cdf(np.sum(z**2), z.size) < 1.0 - 1e-3


def test_the_likelihood_finds_the_noise_model_that_made_the_ratio():
    chosen = found(walk(7), seed=7).disturbance
    assert WALKED.density_1_s / 2.5 < chosen.density_1_s < 2.5 * WALKED.density_1_s
    assert WALKED.correlation_s / 5.0 < chosen.correlation_s < 5.0 * WALKED.correlation_s


def test_no_input_is_found_where_no_heating_is_missing():
    correction = found(lambda t: 0.0 * t, seed=3)
    assert correction.gain_log_likelihood < 5.0
    assert np.max(np.abs(correction.delta_ratio)) < 0.01 * RATIO


def test_readings_that_are_all_lost_leave_the_prior():
    track = flown(step, seed=1)
    nothing = np.full(len(track.samples.time_s), np.nan)
    lost = replace(track, samples=replace(track.samples, lower_K=nothing, upper_K=nothing))
    correction = unknown_input(lost, TIME_S, heated(TIME_S, 0.0 * TIME_S), WALKED)
    np.testing.assert_allclose(correction.sigma, WALKED.start_sigma, rtol=1e-12)
    np.testing.assert_array_equal(correction.delta_ratio, 0.0)
    np.testing.assert_allclose(correction.bandwidth_Hz, 0.0, atol=1e-12)


def test_a_sinusoid_below_the_bandwidth_is_seen_and_one_above_it_is_not():
    resolved = float(np.median(found(sinusoid, 2, WALKED).bandwidth_Hz))
    assert seen(resolved / 5.0) == pytest.approx(1.0, abs=0.1)
    assert seen(min(4.0 * resolved, 0.45)) < 0.5


def seen(frequency_Hz: float) -> float:
    """Part of a sinusoid's amplitude that is recovered."""

    def truth(t: np.ndarray) -> np.ndarray:
        return 0.004 * np.sin(2.0 * np.pi * frequency_Hz * t)

    correction = found(truth, 2, WALKED)
    phases = 2.0 * np.pi * frequency_Hz * correction.time_s
    waves = np.column_stack([np.sin(phases), np.cos(phases), np.ones_like(phases)])
    return float(np.linalg.lstsq(waves, correction.delta_ratio, rcond=None)[0][0] / 0.004)


def test_a_deeper_thermocouple_resolves_less():
    shallow, deep = (found(step, 4, WALKED, deep=deep) for deep in (False, True))
    assert np.median(deep.bandwidth_Hz) < 0.3 * np.median(shallow.bandwidth_Hz)
    assert np.median(deep.sigma) > 1.5 * np.median(shallow.sigma)


def test_bandwidth_of_a_random_walk_is_the_limit_of_long_correlation():
    sigma = np.array([1e-4, 3e-4])
    long = Disturbance.gauss_markov(np.sqrt(0.5 * 1e-7 * 1e7), 1e7)
    walked = bandwidth_Hz(Disturbance(1.0, np.inf, 1e-7), sigma)
    np.testing.assert_allclose(bandwidth_Hz(long, sigma), walked, rtol=1e-4)
