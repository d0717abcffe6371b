"""A thermocouple that lags: its temperature, its derivatives, its time constant from a record, and its signature."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from sim_heating.base.kernels.lag import lag_columns, lag_per_constant
from sim_heating.closure.search.trials.candidates import candidates
from sim_heating.estimation.filter.innovations import Innovations
from sim_heating.estimation.filter.process_noise import ProcessNoise
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.estimation.starts import profile_start
from sim_heating.inputs.record import Record, in_segments, load_record
from sim_heating.inputs.scenario import load_scenario
from sim_heating.inputs.sensor_model import SensorErrors
from sim_heating.simulation.predict import predict
from sim_heating.simulation.synthesize import synthesize
from tests.support.gliding import gliding
from tests.support.paths import PRACTICE

POPU_S = (300.0, 420.0)
TAU_S = 2.0


def lagging(x, t, tau_s, at_rest=True):
    """One history behind a lag."""
    return lag_columns(np.asarray(t, dtype=float), np.asarray(x, dtype=float)[:, np.newaxis], tau_s, at_rest)[:, 0]


@cache
def surface_record() -> Record:
    """A practice record with temperatures of its declared model, whose thermocouples all lag by TAU_S, and noise."""
    record = load_record(PRACTICE / "p06")
    late = predict(record, errors={s.name: SensorErrors(tau_s=TAU_S) for s in record.sensors})
    rng = np.random.default_rng(16)
    columns = {
        s.column: T + rng.normal(0.0, 0.5, len(T)) for s, T in zip(record.sensors, late.indicated_K, strict=True)
    }
    sensors = [s.model_copy(update={"bits": None, "noise_sigma_K": 0.5}) for s in record.sensors]
    thermocouples = record.declared.thermocouples.model_copy(update={"sensor": sensors})
    declared = record.declared.model_copy(update={"thermocouples": thermocouples})
    return replace(record, declared=declared, thermocouples={"time_s": record.time_s, **columns})


def with_lags(record: Record, tau_s: float) -> Record:
    """The record with the lag declared for all of its sensors."""
    sensors = [s.model_copy(update={"tau_s": tau_s}) for s in record.sensors]
    thermocouples = record.declared.thermocouples.model_copy(update={"sensor": sensors})
    return replace(record, declared=record.declared.model_copy(update={"thermocouples": thermocouples}))


# The lag itself -------------------------------------------------------------------------------------------------------


def test_behind_a_ramp_a_thermocouple_is_late_by_its_time_constant():
    t = np.array([0.0, 0.3, 1.0, 4.0, 20.0])
    np.testing.assert_allclose(lagging(5.0 * t, t, 2.0), 5.0 * (t - 2.0 * (1.0 - np.exp(-t / 2.0))), atol=1e-12)
    np.testing.assert_allclose(lagging(5.0 * t, t, 2.0, at_rest=False), 5.0 * (t - 2.0), atol=1e-12)


def test_sine_passes_a_lag_as_its_transfer_function_states():
    t, w, tau = np.arange(0.0, 200.0, 0.05), 0.4, 3.0
    expected = np.sin(w * t - np.arctan(w * tau)) / np.hypot(1.0, w * tau)
    late = t > 100.0
    np.testing.assert_allclose(lagging(np.sin(w * t), t, tau)[late], expected[late], atol=1e-4)


def test_derivative_to_the_time_constant_is_that_of_the_difference():
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.uniform(0.1, 2.0, 80))
    x = np.cumsum(rng.normal(size=80))
    for at_rest in (True, False):
        difference = (lagging(x, t, 1.5 + 1e-5, at_rest) - lagging(x, t, 1.5 - 1e-5, at_rest)) / 2e-5
        found = lag_per_constant(t, x, lagging(x, t, 1.5, at_rest), 1.5, at_rest)
        np.testing.assert_allclose(found, difference, atol=1e-8)


def test_a_lag_of_zero_is_none_and_its_derivative_that_of_a_skew():
    t, x = np.array([0.0, 1.0, 3.0]), np.array([300.0, 310.0, 350.0])
    np.testing.assert_array_equal(lagging(x, t, 0.0), x)
    np.testing.assert_allclose(lag_per_constant(t, x, x, 0.0, True), [0.0, -10.0, -20.0])


# Records --------------------------------------------------------------------------------------------------------------


def test_predicted_thermocouple_follows_the_equation_of_its_lag():
    """Against LSODA on a spline through the prediction without lag."""
    record = load_record(PRACTICE / "p06")
    plain = predict(record).history
    behind = predict(with_lags(record, TAU_S)).history.sensors_K[0]
    first = plain.time_s < 400.0
    T, t, behind = plain.sensors_K[0][first], plain.time_s[first], behind[first]
    spline = CubicSpline(t, T)
    solved = solve_ivp(
        lambda s, y: (spline(s) - y) / TAU_S, t[[0, -1]], T[:1], "LSODA", t_eval=t, rtol=1e-8, atol=1e-6, max_step=1.0
    )
    assert np.max(np.abs(T - behind)) > 5.0
    assert np.max(np.abs(solved.y[0] - behind)[5:]) < 0.05 * np.max(np.abs(T - behind))


def test_sensitivities_behind_a_lag_are_those_of_differences():
    record = with_lags(surface_record(), TAU_S)
    names = [
        "ratio.scale", "ratio.d_alpha", "stack.coating.thickness_factor", "clock.skew", "sensors.tau_s",
        f"sensor.{record.sensors[0].name}.tau_s", f"sensor.{record.sensors[0].name}.gain",
    ]  # fmt: skip
    chosen = in_segments(record.time_s, [POPU_S])
    start = partial(profile_start, time_s=POPU_S[0] - 20.0)
    for starts in ([start], None):
        fit = FitProblem([record], names, joint_reference([record]), FitOptions(starts=starts, sample_masks=[chosen]))
        at = np.array([p.value for p in fit.parameters])
        at[[u.label == "clock.skew" for u in fit.unknowns]] = 0.17
        exact = fit.samples(at)
        for k, unknown in enumerate(fit.unknowns):
            step = 1e-3 * np.eye(len(at))[k]
            above, below = fit.samples(at + step), fit.samples(at - step)
            size = max(np.max(np.abs(s.jacobian[:, k])) for s in exact)
            for s, a, b in zip(exact, above, below, strict=True):
                difference = (a.mean_K - b.mean_K) / 2e-3
                assert np.max(np.abs(s.jacobian[:, k] - difference)) < 1e-3 * max(size, 1e-9), unknown.label


@pytest.mark.thorough
def test_time_constant_and_skew_are_found_together_from_a_manoeuvre():
    found = estimate(surface_record(), ["ratio.scale", "clock.skew", "sensors.tau_s"])
    for name, true in (("sensors.tau_s", TAU_S), ("clock.skew", 0.0), ("ratio.scale", 0.0)):
        value, sigma = found.parameters[name]
        assert abs(value - true) < 4.0 * sigma, (name, value, sigma)
    assert found.parameters["sensors.tau_s"][1] < 0.3


@pytest.mark.thorough
@pytest.mark.parametrize("skew_s", [0.0, 1.2, -1.2])
def test_lag_and_skew_are_estimated_at_a_step_of_heating(tmp_path, skew_s):
    """The thermocouple rests until the flight begins, whatever the skew: not behind a ramp of its first seconds."""
    faults = f'[measurements]\nclock_skew_s = {skew_s}\n[[measurements.fault]]\nsensor = "V09T9527"\ntau_s = 8.0\n'
    (tmp_path / "glide.toml").write_text(gliding(120.0, "V09T9527") + faults)
    record = synthesize(load_scenario(tmp_path / "glide.toml"))["V09T9527"]
    found = estimate(record, ["ratio.scale", "clock.skew", "sensor.V09T9527.tau_s"])
    for name, true in (("ratio.scale", 0.0), ("clock.skew", skew_s), ("sensor.V09T9527.tau_s", 8.0)):
        value, sigma = found.parameters[name]
        assert abs(value - true) < 4.0 * sigma < 0.2, (name, value, sigma)
    assert found.after[0].segment_errors()["fit"]["rmse_K"] < 1.1 * record.noise_floor_K()


@pytest.mark.thorough
def test_a_skew_does_not_explain_a_lag_in_a_manoeuvre():
    record = surface_record()
    clock, lag = (["ratio.scale", "ratio.d_alpha", name] for name in ("clock.skew", "sensors.tau_s"))
    skewed, lagged = (estimate(record, names).after[0].segment_errors()["fit"] for names in (clock, lag))
    # chi-square of the residual of 0.5 K noise: 25 would be five sigma
    assert lagged["n"] * (skewed["rmse_K"] ** 2 - lagged["rmse_K"] ** 2) / 0.5**2 > 50.0


def test_close_loop_looks_for_a_lag_of_one_and_of_all_thermocouples():
    record = surface_record()
    found = {c.names for c in candidates(record, record.conditions) if c.name == "sensor-lag"}
    assert found == {("sensors.tau_s",), *((f"sensor.{s.name}.tau_s",) for s in record.used_sensors)}


def test_a_declared_lag_is_in_the_fit_and_in_the_prediction_after_it():
    found = estimate(with_lags(surface_record(), TAU_S), ["ratio.scale"])
    assert found.after[0].segment_errors()["fit"]["rmse_K"] == pytest.approx(0.5, rel=0.1)
    without = estimate(surface_record(), ["ratio.scale"])
    assert without.after[0].segment_errors()["fit"]["rmse_K"] > 1.0


def test_filter_without_process_noise_predicts_the_lagging_march():
    record = with_lags(surface_record(), TAU_S)
    names = ["ratio.scale", "sensors.tau_s", "clock.skew"]
    chosen = in_segments(record.time_s, [POPU_S])
    problem = FitProblem([record], names, joint_reference([record]), FitOptions(sample_masks=[chosen]))
    at = np.array([0.02, 0.3, 0.1])
    filtered, marched = Innovations(problem, ProcessNoise()).samples(at), problem.samples(at)
    for f, m in zip(filtered, marched, strict=True):
        np.testing.assert_allclose(f.mean_K, m.mean_K, atol=1e-6)
        np.testing.assert_allclose(f.jacobian, m.jacobian, atol=1e-4 * np.max(np.abs(m.jacobian)))
