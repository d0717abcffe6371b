"""The estimator over repetitions of noise and recorder words: no bias, bounds that cover, residuals that are white.

A small count of what `python -m benchmarks estimator_statistics` does thousands of times; the limits are those of the
count.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from benchmarks.estimator_statistics import Repetitions, repeat
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.estimation.record_fit import LONGEST_STEP_S, march_times
from sim_heating.estimation.trend import state_at
from sim_heating.inputs.record import Record
from sim_heating.thermal.frame import NOT_CONTROLLED_K
from sim_heating.thermal.mesh import halve_elements, interpolate_profile
from tests.support.estimator_cases import CASES, record_of, repeatable
from tests.support.walls import practice_record

pytestmark = pytest.mark.thorough

TRIALS = 100
RARE = 1e-3
"""Probability of a result outside its limits by chance, for one parameter."""


@pytest.fixture(scope="module", params=["popu", "coating", "skew"])
def found(request: pytest.FixtureRequest) -> Repetitions:
    """Repetitions of one case; seeds that the benchmark does not use."""
    return repeat(repeatable(CASES[request.param]), [(1000, k) for k in range(TRIALS)])


def test_estimates_from_8_bit_data_are_unbiased(found: Repetitions) -> None:
    assert np.all(np.abs(found.bias) < 3.3)


def test_95_percent_bounds_cover_the_truth_in_95_percent_of_fits(found: Repetitions) -> None:
    low, high = binom.interval(1.0 - RARE, TRIALS, 0.95)
    hits = found.covered * TRIALS
    assert np.all((hits >= low) & (hits <= high))


def test_stated_sigmas_are_the_scatter_of_the_estimates(found: Repetitions) -> None:
    assert np.all(np.abs(np.log(found.sigma_over_scatter)) < 3.3 / np.sqrt(2.0 * TRIALS))


def test_residual_tests_reject_as_often_as_their_level(found: Repetitions) -> None:
    for p in (found.white, found.normal):
        low, high = binom.interval(1.0 - RARE, p.size, 0.05)
        assert low <= np.count_nonzero(p < 0.05) <= high


def test_a_coarse_mesh_corrected_predicts_like_a_fine_one() -> None:
    """14 nodes err by tenths of a kelvin on a whole entry; a mesh of 100 nodes, halved, is the truth here."""
    record = record_of("flap")
    names = ["ratio.scale"]
    fine = record.declared.model_copy(update={"stack": record.declared.stack.model_copy(update={"nodes": 100})})
    coarse, exact = (FitProblem([r], names, joint_reference([r])) for r in (record, replace(record, declared=fine)))
    at = np.zeros(1)
    exact.correct_meshes(at)

    def errors() -> list[float]:
        pairs = zip(coarse.samples(at), exact.samples(at), strict=True)
        return [float(np.max(np.abs(s.mean_K - e.mean_K))) for s, e in pairs]

    before = max(errors())
    coarse.correct_meshes(at)
    assert before > 0.2
    assert max(errors()) < 0.1 * before


def mid_entry(nodes: int, at_s: float, profile: int) -> FitProblem:
    """A tile from a time within its entry on, declared with a number of nodes and the temperatures there at a number of
    depths."""
    record = practice_record("p06")[0]

    def declared(of: Record, **changes: object) -> Record:
        stack = of.declared.stack.model_copy(update=changes)
        return replace(of, declared=of.declared.model_copy(update={"stack": stack}))

    whole = FitProblem([declared(record, nodes=100)], ["ratio.scale"], joint_reference([record])).record_fits[0]
    depth_m = np.linspace(0.0, whole.mesh.depth_m[-1], profile)
    then_K = np.interp(depth_m, whole.mesh.depth_m, state_at(whole, np.zeros(1), at_s)[0])
    start = np.column_stack([depth_m, then_K]).tolist()
    begun = declared(record, nodes=nodes, initial="profile", initial_profile=start)
    flown = record.conditions.at(np.append(at_s, record.conditions.time_s[record.conditions.time_s > at_s]))
    fitted = replace(begun, conditions=flown).with_fit([[at_s + 1.0, at_s + 250.0]])
    # meshes are compared on the same steps: division would follow the mesh
    options = FitOptions(tolerance_K=NOT_CONTROLLED_K)
    return FitProblem([fitted], ["ratio.scale"], joint_reference([record]), options)


@pytest.mark.parametrize("nodes", [8, 10, 14])
def test_coarse_mesh_from_a_profile_is_corrected_to_the_exact_march(nodes: int) -> None:
    at, problem, exact = np.zeros(1), mid_entry(nodes, 300.0, 400), mid_entry(100, 300.0, 400)
    before = problem.samples(at)
    for p in (problem, exact):
        p.correct_meshes(at)
    pairs = list(zip(before, problem.samples(at), exact.samples(at), strict=True))
    assert max(np.max(np.abs(b.mean_K - e.mean_K)) for b, _, e in pairs) > 0.2
    assert max(np.max(np.abs(s.mean_K - e.mean_K)) for _, s, e in pairs) < 0.05
    assert bool(problem.mesh_warnings) == (nodes < 14)
    assert not exact.mesh_warnings


def test_fit_on_a_mesh_that_cannot_be_corrected_has_a_warning() -> None:
    problem = mid_entry(8, 60.0, 3)  # a fall of hundreds of kelvin that begins at the surface
    problem.correct_meshes(np.zeros(1))
    (warning,) = problem.mesh_warnings
    assert warning.startswith("p06: the mesh of 8 nodes could not be corrected; predictions keep its error")


def test_a_profile_on_halved_elements_is_the_same_between_the_nodes() -> None:
    part = FitProblem([record_of("popu")], ["ratio.scale"], (0.0,) * 5).record_fits[0]
    profile = np.linspace(900.0, 300.0, part.mesh.nodes)
    halved = interpolate_profile(profile, part.mesh, halve_elements(part.mesh))
    np.testing.assert_allclose(halved[::2], profile)
    np.testing.assert_allclose(halved[1::2], 0.5 * (profile[1:] + profile[:-1]))


def test_steps_of_a_march_follow_the_conditions_up_to_the_longest_step() -> None:
    conditions = record_of("popu").conditions
    begin, end = conditions.time_s[3] + 0.25, conditions.time_s[40] - 0.5
    thin = replace(conditions, columns={k: v[::3] for k, v in conditions.columns.items()})
    time = march_times(thin, begin, end)
    assert time[0] == begin
    assert time[-1] >= end
    assert np.all(np.isin(thin.time_s[(thin.time_s > begin) & (thin.time_s < end)], time))
    assert np.all(np.diff(time) > 0.0)
    assert np.max(np.diff(time)) <= LONGEST_STEP_S + 1e-9
