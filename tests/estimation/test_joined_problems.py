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


def test_likelihoods_add_up_and_a_common_parameter_has_the_information_of_both() -> None:
    joint = FitProblem.joined(parts(), [{SLOPE: ""}] * 2)
    assert [u.label for u in joint.unknowns] == ["ratio.scale@A", SLOPE, "ratio.scale@B"]
    at = {"ratio.scale@A": 0.01, "ratio.scale@B": -0.02, SLOPE: 0.0015}
    found = joint.evaluate(np.array([at[u.label] for u in joint.unknowns]))
    single = [p.evaluate(np.array([at[f"ratio.scale@{n}"], at[SLOPE]])) for p, n in zip(parts(), "AB", strict=True)]
    assert found.log_likelihood == pytest.approx(sum(s.log_likelihood for s in single), rel=1e-12)
    assert found.gradient[1] == pytest.approx(sum(s.gradient[1] for s in single), rel=1e-9)
    assert found.information[1, 1] == pytest.approx(sum(s.information[1, 1] for s in single), rel=1e-9)
    assert found.information[0, 2] == 0.0


def test_a_common_value_is_the_mean_of_own_ones_by_their_weights_and_is_better_known() -> None:
    common, own = (FitProblem.joined(parts(), [owners] * 2) for owners in ({SLOPE: ""}, {}))
    together, apart = (fit_problem(p, np.zeros(len(p.unknowns))) for p in (common, own))
    value, sigma = together.parameters[SLOPE]
    separate = [apart.parameters[f"{SLOPE}@{name}"] for name in "AB"]
    weights = [s**-2.0 for _, s in separate]
    assert value == pytest.approx(np.average([v for v, _ in separate], weights=weights), abs=0.2 * sigma)
    assert sigma == pytest.approx(sum(weights) ** -0.5, rel=0.1)
    assert value == pytest.approx(0.002, abs=4.0 * sigma)
