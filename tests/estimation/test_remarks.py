"""Estimates that nature does not have are remarked, each with what it usually means; the fits are real ones."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from sim_heating.estimation.fit import FitResult, estimate
from sim_heating.estimation.report.ratio_plot import derivatives_about
from sim_heating.estimation.report.remarks import (
    BOUND,
    CORRELATION,
    EMITTANCE,
    MEANINGS,
    NEGATIVE_CONDUCTIVITY,
    NEGATIVE_RATIO,
    NOISE,
    PRIOR,
    RANGE_END,
    remarks,
)
from sim_heating.inputs.record import load_record
from tests.support.json_output import run_json
from tests.support.paths import BOARD, PRACTICE, TILE

EMISSIVITY = "stack.emissivity_factor"
RADIATIVE = "stack.rsi.radiative_conductivity"


@pytest.fixture(scope="module")
def overheated() -> FitResult:
    """A tile whose declared heating is raised by 30 %: only its emittance may take that up."""
    return estimate(TILE, [EMISSIVITY], fixed={"ratio.scale": 0.3})


def test_an_emittance_above_1_is_remarked_first(overheated: FitResult) -> None:
    first = remarks(overheated)[0]
    assert (first.kind, first.parameters) == (EMITTANCE, [EMISSIVITY])
    assert "the heating of the model is too large" in first.meaning


def test_a_bound_that_is_reached_and_a_prior_that_is_left_are_remarked(overheated: FitResult) -> None:
    found = {remark.kind: remark.message for remark in remarks(overheated)}
    assert found[BOUND] == f"{EMISSIVITY} is on its bound, 1.5"
    assert found[PRIOR] == f"{EMISSIVITY} is 14.3 sigmas of its prior from its mean (1 +- 0.035)"


def test_heating_and_emittance_of_one_record_are_correlated() -> None:
    (remark,) = remarks(estimate(PRACTICE / "p06", ["ratio.scale", EMISSIVITY]))
    assert (remark.kind, remark.parameters) == (CORRELATION, ["ratio.scale", EMISSIVITY])


@pytest.mark.thorough
def test_a_conductivity_by_radiation_below_0_is_remarked() -> None:
    fitted = estimate(BOARD, [RADIATIVE], fixed={"stack.rsi.conductivity_factor": 2.0})
    assert [r.kind for r in remarks(fitted)] == [NEGATIVE_CONDUCTIVITY]


def test_a_ratio_below_0_is_remarked_with_its_duration() -> None:
    """A derivative that no flight has, over the angles of a pull-up, takes the ratio below 0 at one end of it."""
    found = {r.kind: r for r in remarks(estimate(PRACTICE / "p06", ["ratio.scale"], fixed={"ratio.d_alpha": 0.005}))}
    remark = found[NEGATIVE_RATIO]
    assert remark.parameters == ["ratio.scale"]
    assert re.fullmatch(r"p06: the heating ratio is negative for [1-9]\d* s", remark.message)


@pytest.mark.thorough
def test_misfit_taken_as_noise_of_a_sensor_is_a_remark() -> None:
    """p04 lacks a transition, which a fit of the magnitude leaves; p06 lacks nothing, and its noise is that found."""
    found = {}
    for name in ("p04", "p06"):
        record = load_record(PRACTICE / name)
        silent = record.with_sensors([s.model_copy(update={"noise_sigma_K": None}) for s in record.sensors])
        found[name] = [r for r in remarks(estimate(silent, ["ratio.scale"])) if r.kind == NOISE]
    assert found["p06"] == []
    assert len(found["p04"]) == 3  # all but the bondline, which no heating has reached
    assert "no noise is declared" in found["p04"][0].message


def test_readings_stuck_at_the_end_of_their_range_are_counted() -> None:
    """A recorder whose span ends 60 K below the peak of p06: its readings there say no more than `at least`."""
    record = load_record(PRACTICE / "p06")
    first = record.used_sensors[0]
    readings_K = record.temperatures_K([first])[0]
    end_K = float(np.nanmax(readings_K)) - 60.0
    short = first.model_copy(update={"bits": 10, "range_K": [first.range_K[0], end_K]})
    others = [short if s.name == first.name else s for s in record.sensors]
    (remark,) = remarks(estimate(record.with_sensors(others), ["ratio.scale"]))
    clipped = int(np.count_nonzero(readings_K > end_K - short.lsb_K / 2.0))
    assert (remark.kind, remark.parameters) == (RANGE_END, [])
    assert f"{clipped} readings" in remark.message
    assert f"upper end of its range, {end_K:.0f} K" in remark.message


def test_a_good_fit_has_none() -> None:
    assert remarks(estimate(PRACTICE / "p06", ["ratio.scale", "ratio.d_alpha"])) == []


@pytest.mark.thorough
def test_the_command_states_them_in_table_file_and_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    arguments = ["--parameters", EMISSIVITY, "--fix", "ratio.scale=0.3", "--out", str(out)]
    printed = run_json(capsys, "estimate", str(TILE), *arguments)
    written = json.loads((out / "estimate.json").read_text())["remarks"]
    assert printed["results"]["remarks"] == written
    assert {r["kind"] for r in written} == {EMITTANCE, BOUND, PRIOR}
    page = (out / "report.html").read_text()
    for remark in written:
        assert remark["meaning"] == MEANINGS[remark["kind"]]
        assert remark["meaning"] in page
        assert any(remark["message"] in line for line in printed["warnings"])


def test_the_sentence_on_estimates_of_the_ratio_says_what_they_change() -> None:
    """A wall's parameters need none, and a ratio without a table has no scale."""
    condition = [40.0, 0.0, 6.0, 1.0, 14.0]
    both = derivatives_about(["ratio.scale@WING_LE", "ratio.d_alpha"], condition)
    assert both.startswith("The ratio is that of the declared table times 1 + ratio.scale, plus the derivatives. ")
    assert "Derivatives are about alpha 40 deg" in both
    assert "declared table" not in derivatives_about(["ratio.d0", "ratio.d_alpha"], condition)
    assert derivatives_about([EMISSIVITY], condition) == ""
