"""What counts as right in the benchmark of the closed loop, and which records a share of it has."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from benchmarks.challenge.record import CLASSES, EFFECTS, FAULTS, IMPERFECT
from benchmarks.closure_challenge import (
    LIBRARY,
    contradictions,
    explains,
    figures_of,
    jobs,
    make_and_close,
    reliability,
    stated,
    verdict,
)
from benchmarks.closure_study import ranks, reliability_by_class, statements, study_figures, study_text


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
        (row("error", []), "right"),
        (row("error", [], "found", alternatives=[["catalysis"]]), "wrong"),
        (row("lacking", [["sensor-bias"]], "partly"), "right"),
        (row("lacking", [["sensor-bias"]], "found", alternatives=[["sensor-bias"]]), "right"),
        (row("lacking", [["sensor-bias"]], "found", alternatives=[["transition"]]), "wrong"),
        (row("lacking", [[]], not_effects=kinds("sensor"), kind="sensor"), "right"),
        (row("recorder", [["none"]], kind="sensor"), "right"),
        (row("recorder", [["time-skew"]], "found", alternatives=[["time-skew"]], kind="flight"), "right"),
        (row("flown", [["emissivity"]], "one of", alternatives=[["catalysis", "emissivity"]]), "right"),
    ],
)  # fmt: skip
def test_verdict(stated_row, expected):
    assert verdict(stated_row) == expected


def test_the_pod_counts_where_all_its_causes_are_in_short_lists():
    truth, lag = [["coating-thickness"], ["impingement-onset"], ["nonisothermal-wall"]], "nonisothermal-wall"
    whole = [["coating-thickness", "heat-capacity"], ["impingement-onset"], [lag]]
    rows = [
        row("paper", truth, "one of", alternatives=whole),
        row("paper", truth, "found", alternatives=whole[1:]),
        row("paper", truth, "one of", alternatives=[[*"abc", "coating-thickness"], *whole[1:]]),
        row("paper", truth, "partly", alternatives=whole),
    ]
    shares = {f.what: f.value for f in figures_of(rows) if f.what.startswith("paper's pod")}
    assert list(shares.values()) == [0.25, 0.25]


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
    assert set(FAULTS) < {*CLASSES, *IMPERFECT}


# Statements, reliability, ranks --------------------------------------------------------------------------------------


def right_transition(onset: float, **more: Any) -> dict[str, Any]:
    """A transition that is found, its true onset at 6.8 +- 0.02."""
    parameters = {"log10_re_onset": {"value": onset, "sigma": 0.02, "unit": "1"}}
    plain = {"form": ["transition/logistic"], "effects": ["transition"], "parameters": [{"log10_re_onset": 6.8}]}
    plain |= {"alternatives": [["transition"]], "effects_stated": [{"name": "transition", "parameters": parameters}]}
    plain |= {"record": "one-000", "log_evidence": [12.0], "calibrated": True, "probability": 0.95}
    return row("one", [["transition"]], "found", **plain) | more


def test_statements_are_counted_by_world_and_class():
    false = row("error", [], "found", alternatives=[["moisture"]], world="imperfect")
    counted = statements([right_transition(6.8), row("error", [], world="imperfect"), false])
    assert counted["exact one"] == {"records": 1, "right": 1, "undecided": 0, "missed": 0, "wrong": 0,
                                    "wrong and found": 0, "refused": 0}  # fmt: skip
    assert (counted["imperfect error"]["right"], counted["imperfect error"]["wrong and found"]) == (1, 1)


def test_intervals_hold_the_truth_as_often_as_they_say():
    onsets = 6.8 + 0.02 * np.random.default_rng(3).normal(size=400)
    (onset,) = ranks([right_transition(float(x)) for x in onsets])
    assert onset["parameter"] == "transition.log10_re_onset"
    assert onset["within"] == pytest.approx(0.95, abs=0.04)
    assert onset["uniform"] > 0.01
    (narrow,) = ranks([right_transition(6.8 + 3.0 * float(x - 6.8)) for x in onsets])
    assert narrow["uniform"] < 1e-6
    assert narrow["within"] < 0.6


def test_a_parameter_of_a_wrong_cause_has_no_rank():
    assert ranks([right_transition(6.8, accepted=[["catalysis"]], effects=["catalysis"])]) == []


def test_a_class_is_judged_by_the_findings_of_the_others():
    rival = {"rival": 20.0, "explained": 1.0, "p_value": 0.5, "disqualified": 0.0}
    right = [right_transition(6.8, **rival) for _ in range(12)]
    wrong = [row("null", [], "found", alternatives=[["moisture"]], **rival) for _ in range(6)]
    by = {part["class"]: part for part in reliability_by_class([*right, *wrong, *[row("null", [], **rival)] * 6])}
    assert by["exact one"]["right"] == 1.0
    assert by["exact null"]["right"] == 0.5
    assert by["exact null"]["by the others"] > by["exact one"]["by the others"]


def test_figures_of_the_study_are_of_causes_that_the_noise_leaves_visible():
    hidden = right_transition(6.8, finding="unknown", alternatives=[], log_evidence=[1.0])
    figures = {f.what: f for f in study_figures([right_transition(6.8), hidden])}
    assert figures["one cause worth 5 or more, exact: stated"].note.startswith("1 of 1")
    assert "statements" in study_text([right_transition(6.8), hidden])
    partly = {f.what: f for f in study_figures([right_transition(6.8), right_transition(6.8, finding="partly")])}
    assert partly["one cause worth 5 or more, exact: stated"].note.startswith("1 of 2")
    assert partly["the same, exact: stated or resembled"].note.startswith("2 of 2")


def test_a_report_that_names_a_cause_and_does_not_explain_it_contradicts_itself():
    errors = {"fit": {"rmse_K": 2.0}, "holdout": None}
    report = {"finding": "found", "effects": [{"name": "catalysis"}], "not_effects": [], "resembles": [],
              "adequacy": {"p_value": 0.4}, "converged": True, "probability": 0.9, "barred": [],
              "before": {"fit": {"rmse_K": 4.0}, "holdout": None}, "after": errors}  # fmt: skip
    assert contradictions(report) == []
    assert contradictions(report | {"adequacy": {"p_value": 1e-4}}) == ["`found` with p = 0.0001"]
    assert contradictions(report | {"finding": "none"}) == ["`none` with effects", "`none` with other errors after"]


@pytest.mark.thorough
@pytest.mark.parametrize(("of_class", "number"), [("error", 0), ("lacking", 2)])
def test_nothing_is_named_where_the_model_is_imperfect_and_no_cause_is_in_it(of_class, number):
    """Records with a large error of the heating: a spline alone, and one beside a cause that the library lacks."""
    judged = json.loads(make_and_close((of_class, number, True, 97)))
    assert judged["record"] == f"imperfect-{of_class}-{number:03d}"
    assert judged["finding"] in ("none", "unknown")
    assert judged["contradictions"] == []
    assert judged["stated_error"]["relative_heating"]["limit_95"] > 0.5 * judged["model_error"]["rms_while_hot"]
