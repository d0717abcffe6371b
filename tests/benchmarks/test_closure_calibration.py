"""Probabilities of findings: fitted to rows of known truth, judged on groups that were left out."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.closure_calibration import FEATURES, features, fitted, left_out, probability, splits
from benchmarks.closure_challenge import reliability


def rows(count: int) -> list[dict[str, Any]]:
    """Findings that are right with the odds of their lead over the next hypothesis."""
    rng = np.random.default_rng(5)
    found = []
    for i in range(count):
        rival, name = float(np.expm1(rng.uniform(0.0, 6.0))), ("catalysis", "moisture")[i % 2]
        right = rng.random() < 1.0 / (1.0 + np.exp(2.0 - 1.5 * np.log1p(rival)))
        found.append({"class": "one", "flight": f"flight {i % 5}", "wall": f"wall {i % 3}", "accepted": [[name]],
                      "alternatives": [[name if right else "emissivity"]], "not_effects": [], "finding": "found",
                      "rival": rival, "p_value": 0.5, "explained": 1.0})  # fmt: skip
    return found


def test_the_odds_that_findings_were_made_with_are_found_again():
    made = rows(2000)
    b = dict(zip(FEATURES, fitted(made), strict=True))
    assert abs(b["log(1 + rival)"] - 1.5) < 0.2
    for lead in (0.5, 2.0, 4.0):
        truth = 1.0 / (1.0 + np.exp(2.0 - 1.5 * lead))
        assert abs(probability(fitted(made), made[0] | {"rival": np.expm1(lead)}) - truth) < 0.05


def test_a_group_is_judged_by_what_the_others_gave():
    made = rows(300)
    for others, own in splits(made, "flight"):
        assert len({r["flight"] for r in own}) == 1
        assert own[0]["flight"] not in {r["flight"] for r in others}
    judged = left_out(made, "wall")
    assert len(judged) == len(made)
    for part in reliability(judged):
        low, high = part["limits"]
        assert part["n"] < 20 or low - 0.05 <= part["mean"] <= high + 0.05


def test_one_class_alone_cannot_be_left_out_of_itself():
    assert list(splits(rows(10), "class")) == []


def test_a_p_value_of_zero_and_a_rival_that_is_better_are_finite():
    extreme = rows(1)[0] | {"p_value": 0.0, "rival": -5.0}
    assert np.all(np.isfinite(features(extreme)))
