"""Starts at a later time: how far each way's temperatures are off, and estimates from them within their bounds."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.problem import FitProblem, joint_reference
from sim_heating.estimation.starts import circuit_profile, conducted_profile, profile_start, smooth_directions
from sim_heating.estimation.trend import state_at
from sim_heating.thermal.mesh import diffusion_depths
from tests.support.walls import practice_model, practice_record

DEGREES = 4.5
"""Bound on every error over its sigma: with twelve errors, exceeded once in ten thousand times."""


def true_profile(name: str, time_s: float) -> tuple:
    """Part of a fit, and its temperatures [K] at a time with the true parameters."""
    record, model = practice_record(name)[0], practice_model(name)
    problem = FitProblem([record], list(model.parameters), model.reference)
    return problem.record_fits[0], state_at(problem.record_fits[0], np.array(list(model.parameters.values())), time_s)[
        0
    ]


@pytest.mark.parametrize("name", ["p06", "p07"])
def test_conducting_wall_has_a_tenth_of_the_error_of_the_circuit(name):
    part, true = true_profile(name, 640.0)
    given = part.record, part.model, part.mesh, 640.0
    conducted = np.sqrt(np.mean((conducted_profile(*given) - true) ** 2))
    circuit = np.sqrt(np.mean((circuit_profile(*given) - true) ** 2))
    assert conducted < 0.1 * circuit
    assert np.max(np.abs(conducted_profile(*given) - true)) < 5.0  # a step of the recorder's word is 4.4 K


def test_directions_are_those_of_a_process_of_unit_variance():
    part, _ = true_profile("p06", 100.0)
    directions = smooth_directions(diffusion_depths(part.model.construction, part.mesh))
    variance = np.sum(directions**2, axis=1)
    assert np.all(variance < 1.0 + 1e-9)
    assert np.all(variance > 0.98)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["p06", "p07"])
@pytest.mark.parametrize("time_s", [300.0, 550.0])
def test_estimates_from_an_estimated_profile_are_within_their_bounds(name, time_s):
    record, truth = practice_record(name)
    start = partial(profile_start, time_s=time_s)
    fit = estimate([record], reference=truth["reference_condition"], starts=[start])
    named = [k for k, label in enumerate(fit.labels) if label.startswith("ratio.")]
    true = np.array([truth["parameters"].get(fit.labels[k], 0.0) for k in named])
    off = (fit.fit.values[named] - true) / fit.bounds.sigma[named]
    assert np.sum(off**2) < 22.5  # chi-square of six: exceeded once in a thousand times
    assert fit.fit.values[0] == pytest.approx(truth["parameters"]["ratio.scale"], abs=2e-3)


def test_start_before_readings_or_outside_conditions_is_refused():
    record = practice_record("p06")[0]
    with pytest.raises(InputError, match="fewer than two readings before -5 s to start from"):
        estimate([record], ["ratio.scale"], starts=[partial(profile_start, time_s=-5.0)])
    with pytest.raises(InputError, match="a start at 2000 s lies outside the conditions"):
        estimate([record], ["ratio.scale"], starts=[partial(profile_start, time_s=2000.0)])


@pytest.mark.thorough
def test_gap_before_the_start_is_bridged():
    record, truth = practice_record("p06")
    lost = (record.time_s > 400.0) & (record.time_s < 520.0)
    columns = {k: np.where(lost & (k != "time_s"), np.nan, v) for k, v in record.thermocouples.items()}
    start = partial(profile_start, time_s=600.0)
    fit = estimate(
        [replace(record, thermocouples=columns)],
        ["ratio.scale", "ratio.d_alpha"],
        reference=dict(zip(truth["reference_condition"], joint_reference([record]), strict=True)),
        starts=[start],
    )
    assert fit.fit.converged
