"""The thresholds of a closed loop: each is stated once, with its unit, what it decides, and where it comes from."""

from __future__ import annotations

import ast
import math
from dataclasses import fields

from sim_heating.closure.verdict.policy import EFFORT, POLICY
from tests.support.paths import ROOT

MOST_RULES = 40
"""Thresholds that a reader of a finding can still take in."""
MOST_NUMBERS = 80
"""Names of closure that stand for a number, those of the policy included."""


def test_every_threshold_says_what_it_decides_and_where_it_comes_from():
    every = [f.metadata for f in fields(POLICY)]
    assert len(every) <= MOST_RULES
    assert all(rule["unit"] and rule["sentence"].endswith(".") and rule["source"] for rule in every)
    assert len({rule["sentence"] for rule in every}) == len(every)


def numbers_of(path):
    """Names of a module that are bound to a number, or to a collection that has one."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            values = [c.value for c in ast.walk(node.value) if isinstance(c, ast.Constant)]
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            if any(type(v) in (int, float) for v in values):
                yield from (n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name))


def test_numbers_of_closure_stay_few():
    names = [f"{p.name}: {n}" for p in (ROOT / "sim_heating" / "closure").rglob("*.py") for n in numbers_of(p)]
    count = len(names) + len(fields(POLICY)) + len(vars(EFFORT))
    assert count <= MOST_NUMBERS, f"{count}\n" + "\n".join(names)


def test_two_scores_apart_are_odds_of_twenty_to_one():
    assert POLICY.set_margin == 2.0 * math.log(20.0)
