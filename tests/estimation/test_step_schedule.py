"""The schedule of steps that a fit keeps: divided where the first march needs it, the same while parameters move."""

from __future__ import annotations

import numpy as np
import pytest

from sim_heating.estimation.problem import FitOptions, FitProblem
from sim_heating.estimation.record_fit import march_times
from sim_heating.march.linearised import LinearMarch, Track
from sim_heating.march.mesh_choice import pack
from sim_heating.march.point import PointModel
from sim_heating.march.schedule import divided_times
from sim_heating.thermal.frame import NOT_CONTROLLED_K
from tests.support.walls import flight, material, practice_record, wall

SECONDS = np.arange(0.0, 41.0)
JUMP = flight(SECONDS, q_add_W_m2=np.where(SECONDS > 4.0, 4e4, 0.0), h_ref_kg_m2_s=0.02, H_r_J_kg=3e6)
NAMES = ("ratio.d0", "stack.rsi.conductivity_factor", "stack.emissivity_factor")


def bare(**parameters: float) -> PointModel:
    construction = wall((material(0.06, 1100.0, 144.0, 0.85), 0.05))
    return PointModel("bare", construction, (0.004,), nodes=32, parameters={"ratio.d0": 0.3} | parameters)


def in_steps(model: PointModel, time_s: np.ndarray, names: tuple[str, ...] = NAMES):
    history = np.stack([np.interp(time_s, SECONDS, column) for column in JUMP[0].T], axis=1)[np.newaxis]
    track = Track(model, pack([model]).meshes[0], names, SECONDS[1:], nodes=(0, *pack([model]).meshes[0].sensors))
    return LinearMarch([track], time_s, history).march()[0]


@pytest.fixture(scope="module")
def schedule() -> np.ndarray:
    model = bare()
    return divided_times(Track(model, pack([model]).meshes[0], (), np.zeros(0)), SECONDS, JUMP)


def test_schedule_holds_all_samples_and_divides_the_seconds_after_a_jump(schedule):
    assert set(SECONDS) < set(schedule)
    finest = [np.min(np.diff(schedule[(schedule >= t) & (schedule <= t + 1.0)])) for t in (4.0, 30.0)]
    assert finest[0] < 0.1
    assert finest[1] == 1.0


def test_scheduled_linearised_march_is_the_march_that_divides_its_steps(schedule):
    ensemble = pack([bare()])
    own = ensemble.march(SECONDS, JUMP)[1:, [0, 2]]
    assert ensemble.counters.steps[0] == len(schedule) - 1
    np.testing.assert_allclose(in_steps(bare(), schedule).temperature_K.T, own, rtol=0.0, atol=1e-6)


def test_sensitivities_in_the_schedule_are_differences_of_marches_in_it(schedule):
    found = in_steps(bare(), schedule)
    for k, name in enumerate(NAMES):
        step = 1e-4
        high, low = (
            in_steps(bare(**{name: bare().value(name) + sign * step}), schedule, ()).temperature_K for sign in (1, -1)
        )
        np.testing.assert_allclose(found.sensitivity[..., k], (high - low) / (2.0 * step), rtol=1e-5, atol=1e-3)


def test_a_fit_keeps_the_schedule_of_its_first_march():
    record, _ = practice_record("p06")
    controlled, plain = (
        FitProblem([record], ["ratio.scale"], (40.0, 0.0, 5.0, 0.0, 0.0), FitOptions(tolerance_K=tolerance))
        for tolerance in (FitOptions().tolerance_K, NOT_CONTROLLED_K)
    )
    fit = controlled.record_fits[0]
    undivided = march_times(fit.conditions, fit.begin_s, float(fit.sample_s[-1]))
    np.testing.assert_array_equal(plain.record_fits[0].time_s, undivided)
    assert len(undivided) < len(fit.time_s) < 1.03 * len(undivided)
    before = fit.time_s.copy()
    controlled.evaluate(np.array([0.2]))
    np.testing.assert_array_equal(fit.time_s, before)


def test_records_on_common_times_share_one_schedule():
    record, _ = practice_record("p06")
    both = FitProblem([record, record], ["ratio.scale"], (40.0, 0.0, 5.0, 0.0, 0.0))
    assert len(both.marches.groups) == 1
