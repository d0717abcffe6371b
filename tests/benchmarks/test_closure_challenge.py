"""What counts as right in the benchmark of the closed loop, and which records a share of it has."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.challenge.faults import FAULTS
from benchmarks.challenge.record import CLASSES, EFFECTS
from benchmarks.closure_challenge import LIBRARY, explains, figures_of, jobs, reliability, stated, verdict


def row(of_class: str, accepted: list[list[str]], finding: str = "none", **more: Any) -> dict[str, Any]:
    """A row of the benchmark with what is true of a record and what is stated."""
    kind = {"kind": of_class} if of_class in ("wall", "flight", "sensor", "table") else {}
    plain = {"alternatives": [], "not_effects": [], "probability": 0.97, "p_value": 0.4, "converged": True}
    plain |= {"cpu_s": 5.0, "form": ["emissivity/constant"], "separable": True, "size": "usual"}
    return {"class": of_class, "accepted": accepted, "finding": finding} | kind | plain | more


def kinds(*names: str) -> list[dict[str, Any]]:
    """Entries of not_effects."""
    return [{"kind": name, "what": "", "probability": 0.9} for name in names]


@pytest.mark.parametrize(
    ("sets", "truth", "right"),
    [
        ([], [], True),
        ([["moisture"]], [], False),
        ([["coating-thickness", "heat-capacity"]], [["heat-capacity"]], True),
        ([["catalysis"]], [["transition"], ["emissivity"]], False),
        ([["transition"]], [["transition"], ["emissivity"]], False),
        ([["emissivity"], ["transition"]], [["transition"], ["emissivity"]], True),
        ([["emissivity", "transition"], ["moisture"]], [["transition"], ["emissivity"]], False),
        ([["transition"]], [["transition"], ["emissivity", "none"]], True),
        ([["transition"], ["catalysis"]], [["transition"]], False),
    ],
)
def test_each_set_holds_a_true_effect_and_each_true_effect_is_in_one(sets, truth, right):
    assert explains(sets, truth) is right


@pytest.mark.parametrize(
    ("stated_row", "expected"),
    [
        (row("null", []), "right"),
        (row("null", [], "found", alternatives=[["moisture"]]), "wrong"),
        (row("null", [], "unknown"), "undecided"),
        (row("null", [], not_effects=kinds("wall")), "wrong"),
        (row("one", [["catalysis"]], "found", alternatives=[["catalysis"]]), "right"),
        (row("one", [["catalysis"]], "found", alternatives=[["catalysis"]], not_effects=kinds("sensor")), "wrong"),
        (row("one", [["catalysis"]], "partly", alternatives=[["catalysis"]]), "undecided"),
        (row("one", [["catalysis"]]), "missed"),
        (row("wall", [[]], not_effects=kinds("wall")), "right"),
        (row("wall", [[]], not_effects=kinds("flight")), "wrong"),
        (row("wall", [[]], "unknown"), "undecided"),
        (row("wall", [[]], "found", alternatives=[["moisture"]]), "wrong"),
        (row("wall", [[]], "found", alternatives=[["moisture"]], not_effects=kinds("wall")), "wrong"),
        (row("wall", [[]], "found", alternatives=[["skin"]], kinds={"skin": "wall"}), "right"),
        (row("wall", [["heat-capacity"]], "found", alternatives=[["heat-capacity"]]), "right"),
        (row("flight", [["none"]]), "right"),
        (row("flight", [["time-skew"]], "found", alternatives=[["time-skew"]]), "right"),
        (row("table", [["none", "emissivity"]]), "missed"),
        (row("table", [["none"]], not_effects=kinds("table")), "right"),
        (row("sensor", [[]], "refused"), "right"),
        (row("one", [["catalysis"]], "refused"), "wrong"),
        (row("unknown", [[]], "partly"), "right"),
        (row("unknown", [[]], "found", alternatives=[["catalysis"]]), "wrong"),
        (row("unknown", [[]]), "missed"),
        (row("flown", [["emissivity"]], "one of", alternatives=[["catalysis", "emissivity"]]), "right"),
    ],
)  # fmt: skip
def test_verdict(stated_row, expected):
    assert verdict(stated_row) == expected


def test_a_report_without_a_calibration_states_its_posterior():
    effect = {"name": "catalysis", "posterior": 0.9}
    report = {"finding": "found", "alternatives": [["catalysis"]], "effect": effect, "adequacy": {"p_value": 0.3},
              "probability": None, "not_effects": [], "converged": True}  # fmt: skip
    assert (stated(report)["probability"], stated(report)["calibrated"]) == (0.9, False)
    assert stated(report | {"probability": 0.7})["probability"] == 0.7


def test_a_set_of_a_cause_and_an_effect_holds_the_truth_where_either_is_true():
    words = "thickness of layer skin"
    both = {"alternatives": [["heat-capacity", words]], "kinds": {words: "wall"}, "not_effects": kinds("wall")}
    assert verdict(row("wall", [[]], "one of", **both)) == "right"
    assert verdict(row("one", [["heat-capacity"]], "one of", **both)) == "right"
    assert verdict(row("sensor", [[]], "one of", **both)) == "wrong"


def test_a_share_of_the_set_has_that_share_of_every_class():
    tenth = [job.task[0] for job in jobs(tuple(CLASSES), 0.1)]
    assert {c: tenth.count(c) for c in CLASSES} == {c: n // 10 for c, n in CLASSES.items()}


def test_figures_are_of_the_rows_and_leave_out_what_has_none():
    rows = [row("one", [["emissivity"]], "found", alternatives=[["emissivity"]])] * 3 + [row("one", [["emissivity"]])]
    figures = {f.what: f for f in figures_of(rows)}
    assert figures["right, one"].value == 0.75
    assert figures["stated with 0.95 or more: right"].note.startswith("3 of 4")
    assert not any("null" in what for what in figures)
    assert [b["n"] for b in reliability(rows)] == [4]


def test_forms_called_those_of_the_library_are_forms_of_the_generator():
    forms = {family.name: set(family.forms) for family in EFFECTS}
    assert LIBRARY.keys() == forms.keys()
    assert all(set(named) <= forms[name] for name, named in LIBRARY.items())
    assert set(FAULTS) < set(CLASSES)
