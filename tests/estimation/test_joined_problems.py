"""Problems of single records joined into one: likelihoods add up, a parameter is common or a record's own."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from sim_heating.estimation.fit import fit_problem
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.heating.effects import use
from tests.support.missing import record_with

ONSET = use("impingement-onset", {"alpha_onset_deg": 41.0, "slope": 0.002})
SLOPE = "effect.impingement-onset.slope"


@cache
def parts() -> tuple[FitProblem, FitProblem]:
    """The same flight with two draws of the noise, the slope of an impingement and a magnitude unknown."""
    records = [replace(record_with([ONSET], seed)[0], directory=Path(name)) for name, seed in (("A", 5), ("B", 6))]
    return tuple(
        FitProblem([r], ("ratio.scale", SLOPE), joint_reference([r]), FitOptions([ONSET], prior_scale=np.inf))
        for r in records
    )


def test_joined_likelihoods_and_information_add_up() -> None:
    joint = FitProblem.joined(parts(), [{SLOPE: ""}] * 2)
    assert [u.label for u in joint.unknowns] == ["ratio.scale@A", SLOPE, "ratio.scale@B"]
    at = {"ratio.scale@A": 0.01, "ratio.scale@B": -0.02, SLOPE: 0.0015}
    found = joint.evaluate(np.array([at[u.label] for u in joint.unknowns]))
    single = [p.evaluate(np.array([at[f"ratio.scale@{n}"], at[SLOPE]])) for p, n in zip(parts(), "AB", strict=True)]
    assert found.log_likelihood == pytest.approx(sum(s.log_likelihood for s in single), rel=1e-12)
    assert found.gradient[1] == pytest.approx(sum(s.gradient[1] for s in single), rel=1e-9)
    assert found.information[1, 1] == pytest.approx(sum(s.information[1, 1] for s in single), rel=1e-9)
    assert found.information[0, 2] == 0.0


@pytest.mark.thorough
def test_common_value_is_the_weighted_mean_of_the_separate_ones() -> None:
    common, own = (FitProblem.joined(parts(), [owners] * 2) for owners in ({SLOPE: ""}, {}))
    together, apart = (fit_problem(p, np.zeros(len(p.unknowns))) for p in (common, own))
    value, sigma = together.parameters[SLOPE]
    separate = [apart.parameters[f"{SLOPE}@{name}"] for name in "AB"]
    weights = [s**-2.0 for _, s in separate]
    assert value == pytest.approx(np.average([v for v, _ in separate], weights=weights), abs=0.2 * sigma)
    assert sigma == pytest.approx(sum(weights) ** -0.5, rel=0.1)
    assert value == pytest.approx(0.002, abs=4.0 * sigma)


def test_tied_parameters_have_the_gradient_and_the_information_of_both() -> None:
    """Two thermocouples with one bias: what the problem of two biases has along the direction (1, 1)."""
    record = parts()[0].record_fits[0].record
    a, b = (f"sensor.{s.name}.bias" for s in record.used_sensors[:2])
    own, tied = (
        FitProblem([record], ("ratio.scale", a, b), joint_reference([record]), FitOptions([ONSET], ties=ties))
        for ties in ((), [(b, a)])
    )
    assert [u.label for u in tied.unknowns] == ["ratio.scale", b]
    assert tied.unknowns[1].tied == (b, a)
    at = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 1.0]])
    separate, common = own.evaluate(at @ [0.01, 2.0]), tied.evaluate(np.array([0.01, 2.0]))
    assert common.log_likelihood == separate.log_likelihood
    np.testing.assert_allclose(common.gradient, at.T @ separate.gradient, rtol=1e-12)
    np.testing.assert_allclose(common.information, at.T @ separate.information @ at, rtol=1e-12)
    jacobians = [
        np.concatenate([s.jacobian for s in p.samples(v)])
        for p, v in ((own, at @ [0.01, 2.0]), (tied, np.array([0.01, 2.0])))
    ]
    np.testing.assert_allclose(jacobians[1], jacobians[0] @ at, rtol=1e-12)
