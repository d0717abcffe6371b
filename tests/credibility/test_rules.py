"""Levels of factors: a rule counts only above rules that are met, and evidence that is taken away raises no level."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_heating.credibility.rules import HIGHEST, REVIEW, rules

EVERY = frozenset(n for f in rules().factors for level in f.levels for n in level.needs)
COMPUTED = sorted(n for n in EVERY if not n.startswith(REVIEW))


def levels(evidence) -> dict[str, int]:
    return {f.name: f.level(evidence) for f in rules().factors}


def test_the_factors_are_the_eight_of_the_standard():
    assert [f.name for f in rules().factors] == [
        "data_pedigree", "verification", "validation", "input_pedigree", "uncertainty_characterization",
        "results_robustness", "history", "process_management",
    ]  # fmt: skip
    assert "no statement of compliance" in rules().basis


def test_all_evidence_gives_the_highest_level_and_none_gives_level_0():
    assert set(levels(EVERY).values()) == {HIGHEST}
    assert set(levels(frozenset()).values()) == {0}


def test_without_a_signed_review_no_factor_reaches_the_highest_level():
    assert all(level < HIGHEST for level in levels(COMPUTED).values())


@pytest.mark.parametrize("name", sorted(EVERY))
def test_without_one_piece_of_evidence_one_factor_falls(name: str):
    without = levels(EVERY - {name})
    assert [f for f, level in without.items() if level < HIGHEST] == [
        f.name for f in rules().factors for level in f.levels if name in level.needs
    ]


@given(st.sets(st.sampled_from(sorted(EVERY))), st.sets(st.sampled_from(sorted(EVERY))))
def test_fewer_pieces_of_evidence_never_raise_a_level(some: set[str], taken: set[str]):
    before, after = levels(some), levels(some - taken)
    assert all(after[name] <= before[name] for name in before)


def test_a_high_rule_does_not_make_up_for_a_low_one():
    verification = next(f for f in rules().factors if f.name == "verification")
    assert verification.level({"verification.used", "verification.error"}) == 0
    assert verification.missing({"verification.core", "verification.error"}) == ("verification.used",)
