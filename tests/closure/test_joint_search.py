"""One cause in several records: what they tell together, what each adds, and which of them contradicts."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from click.testing import CliRunner

from sim_heating.base.errors import InputError
from sim_heating.cli import cli
from sim_heating.closure.close import close_loops
from sim_heating.closure.search.evidence import Evidence
from sim_heating.closure.search.joint_model import narrower_levels, widest_level
from sim_heating.closure.search.joint_search import JointSearch, search_jointly
from sim_heating.closure.search.search import SearchResult
from sim_heating.heating.effects import use
from sim_heating.inputs.record import Record, write_record
from tests.support.few_candidates import search_among, searched_among
from tests.support.missing import record_with

ONSET, SLOPE = "effect.impingement-onset.alpha_onset_deg", "effect.impingement-onset.slope"
RIVALS = ("impingement-onset", "alpha-curvature")
AMONG = (*RIVALS, "time-skew", "coating-thickness")


@cache
def flown(name: str, seed: int, onset_deg: float, slope: float, point: str = "LS") -> Record:
    """A practice flight with flow impingement of a slope [1/deg] above an onset."""
    effects = [use("impingement-onset", {"alpha_onset_deg": onset_deg, "slope": slope})] if slope else []
    record, _ = record_with(effects, seed)
    declared = record.declared.model_copy(update={"control_point": point})
    return replace(record, declared=declared, directory=Path(name))


@cache
def searched(record: Record) -> SearchResult:
    """The search of one record among the rivals alone."""
    return searched_among(record, RIVALS)


def joint(*records: Record) -> tuple[JointSearch, dict[str, Evidence]]:
    """The joint search, and what each record adds."""
    found = search_jointly([searched(r) for r in records])
    return found, {e.record: e for e in found.evidence}


def value(found: JointSearch, label: str) -> tuple[float, float]:
    """A parameter of the best joint hypothesis with its standard deviation."""
    fit = found.best.last.fit
    return dict(zip(fit.names, zip(fit.values.tolist(), fit.sigma.tolist(), strict=True), strict=True))[label]


@pytest.mark.thorough
def test_the_scores_of_records_and_what_is_common_add_up_and_one_value_is_cheaper_than_two() -> None:
    found, evidence = joint(flown("A", 5, 41.0, 0.002), flown("B", 6, 41.0, 0.002))
    assert found.conclusion.finding == "found"
    assert found.best.names == ("impingement-onset",)
    assert found.best.score == pytest.approx(-sum(e.for_cause for e in evidence.values()) + found.best.common)
    assert [e.verdict for e in evidence.values()] == ["supports it"] * 2
    assert min(e.agreement for e in evidence.values()) > 1e-3
    onset, sigma = value(found, ONSET)
    assert onset == pytest.approx(41.0, abs=5.0 * sigma)
    alone = sum(searched(r).conclusion.best.score for r in (flown("A", 5, 41.0, 0.002), flown("B", 6, 41.0, 0.002)))
    assert found.best.score < alone - 5.0


@pytest.mark.thorough
def test_a_record_without_the_effect_of_the_other_contradicts_it() -> None:
    found, evidence = joint(flown("A", 5, 41.0, 0.002), flown("C", 6, 41.0, 0.0))
    assert found.best.names == ("impingement-onset",)
    assert evidence["A"].verdict == "supports it"
    assert not evidence["C"].member
    assert evidence["C"].verdict == "contradicts it"
    assert evidence["C"].for_cause < -100.0


@pytest.mark.thorough
def test_nothing_is_found_in_records_that_have_nothing() -> None:
    found, evidence = joint(flown("C", 6, 41.0, 0.0), flown("E", 7, 41.0, 0.0))
    assert found.conclusion.finding == "none"
    assert [e.verdict for e in evidence.values()] == ["does not tell"] * 2


@pytest.mark.thorough
def test_another_onset_at_the_same_point_is_each_records_own_and_the_slope_stays_common() -> None:
    found, evidence = joint(flown("A", 5, 41.0, 0.002), flown("D", 6, 38.0, 0.002))
    assert found.best.model.levels == {ONSET: "record", SLOPE: "point"}
    for name, truth in ((f"{ONSET}@A", 41.0), (f"{ONSET}@D", 38.0), (SLOPE, 0.002)):
        at, sigma = value(found, name)
        assert at == pytest.approx(truth, abs=5.0 * sigma)
    assert all(e.member for e in evidence.values())


@pytest.mark.thorough
def test_neighbouring_points_share_the_onset_of_the_flow_and_not_what_it_does_to_each() -> None:
    found, evidence = joint(flown("A", 5, 41.0, 0.002, "LEFT"), flown("B", 6, 41.0, 0.001, "RIGHT"))
    assert found.best.model.levels == {ONSET: "all", SLOPE: "point"}
    for name, truth in ((ONSET, 41.0), (f"{SLOPE}@LEFT", 0.002), (f"{SLOPE}@RIGHT", 0.001)):
        at, sigma = value(found, name)
        assert at == pytest.approx(truth, abs=5.0 * sigma)
    assert [e.verdict for e in evidence.values()] == ["supports it"] * 2


def test_what_is_of_the_flow_of_a_point_or_of_a_flight() -> None:
    levels = {
        "effect.transition.log10_re_onset": "all", "effect.transition.factor": "point", ONSET: "all", SLOPE: "point",
        "effect.emissivity.change_s": "record", "stack.moisture.latent_J_kg": "record", "clock.skew": "record",
        "stack.rsi.conductivity_factor": "point", "sensor.surface.bias": "record", "ratio.d_alpha2": "point",
    }  # fmt: skip
    assert {name: widest_level(name) for name in levels} == levels
    left, right = flown("A", 5, 41.0, 0.002, "LEFT"), flown("B", 6, 41.0, 0.001, "RIGHT")
    assert narrower_levels("all", [left, right]) == ["point"]
    assert narrower_levels("all", [left, replace(left, directory=Path("other"))]) == ["record"]
    assert narrower_levels("point", [left, right]) == []


@pytest.mark.thorough
def test_two_flights_tell_together_what_neither_tells_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    search_among(monkeypatch, *AMONG)
    for name, seed in (("one", 6), ("two", 7)):
        write_record(flown(name, seed, 40.0, 2.6e-4), tmp_path / name)
    records, out = [str(tmp_path / name) for name in ("one", "two")], tmp_path / "out"
    result = CliRunner().invoke(cli, ["close-loop", *records, "--joint", "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert "What each record adds: impingement-onset" in result.output
    alone = [json.loads((out / name / "closure.json").read_text()) for name in ("one", "two")]
    assert [a["finding"] for a in alone] == ["none", "none"]
    found = json.loads((out / "closure.json").read_text())
    assert found["format"] == "closure-report/2"
    assert found["finding"] == "found"
    assert found["alternatives"] == [["impingement-onset"]]
    assert found["adequacy"]["p_value"] > 0.01
    assert found["common_parameters"] == {ONSET: "all", SLOPE: "point"}
    slope = found["effect"]["parameters"]["slope"]
    assert slope["value"] == pytest.approx(2.6e-4, abs=4.0 * slope["sigma"])
    assert [(r["record"], r["finding"], r["has_cause"]) for r in found["by_record"]] == [
        ("one", "none", True), ("two", "none", True),
    ]  # fmt: skip
    assert found["after"]["fit"]["n"] == sum(a["before"]["fit"]["n"] for a in alone)
    assert found["after"]["fit"]["rmse_K"] < found["before"]["fit"]["rmse_K"]
    assert (out / "records.csv").read_text().splitlines()[0].startswith("record,point,alone,for_cause,over_rival")
    page = (out / "report.html").read_text()
    assert "What each record adds" in page
    assert page.count("data:image/svg") == 1


def test_records_that_can_have_nothing_in_common_are_refused_before_any_search(tmp_path: Path) -> None:
    one, two = flown("A", 5, 41.0, 0.002), flown("B", 6, 41.0, 0.002)
    with pytest.raises(InputError, match="1 record; give two or more"):
        close_loops([one])
    with pytest.raises(InputError, match=r"two records are named .*/A; leave one out"):
        close_loops([one, one])
    other = replace(two, declared=two.declared.model_copy(update={"vehicle": "capsule"}))
    with pytest.raises(InputError, match=r"different vehicles \(capsule, orbiter\)"):
        close_loops([one, other])
    write_record(one, tmp_path / "A")
    result = CliRunner().invoke(
        cli, ["close-loop", str(tmp_path / "A"), "--joint", "--workers", "2", "--out", str(tmp_path / "out")]
    )
    assert isinstance(result.exception, InputError)
    assert "--joint: the records are searched in one process" in str(result.exception)
