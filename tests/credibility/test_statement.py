"""The statement of real predictions: what its evidence says, and that taking evidence away lowers its levels."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_heating.credibility.evidence import shipped_evidence
from sim_heating.credibility.facts.contributors import peak_uncertainty
from sim_heating.credibility.facts.sources import (
    DeclaredInput,
    conditions_of_record,
    conditions_of_scenario,
    inputs_of_record,
)
from sim_heating.credibility.reviews import Review, Reviewed, add_review, digest_of, reviews_in
from sim_heating.credibility.statement import Answer, Facts, Statement, assess
from sim_heating.inputs.points import point_of_record
from sim_heating.inputs.record import ConditionsFile, load_record
from sim_heating.inputs.scenario import load_scenario
from sim_heating.march.history import march_points
from sim_heating.simulation.predict import Prediction
from tests.support.paths import ROOT

RECORDS = ROOT / "scenarios" / "records"
YES = Answer(True, "")
GOOD = DeclaredInput("model", "a primary source", "A", measured=True)


def levels(statement: Statement) -> dict[str, int | None]:
    return {a.factor.name: a.level for a in statement.assessments}


@pytest.fixture(scope="module")
def facts(tile: Prediction) -> Facts:
    """The tile's prediction on the plateau, as it would be with sourced inputs and residuals as small as noise."""
    found = tile.facts("estimate")
    flown = found.samples[0]
    plateau = replace(
        flown, values={k: v[150:200] for k, v in flown.values.items()}, duration_s=flown.duration_s[150:200]
    )
    return replace(
        found, model=(GOOD,), conditions=(GOOD,), samples=(plateau,), consistent=YES, holds=YES, varied=YES,
        own_share=YES, own_noise=YES, folder=None,
    )  # fmt: skip


def reviews(*factors: str) -> list[Reviewed]:
    import datetime

    day = datetime.date(2026, 1, 2)
    return [
        Reviewed(Review(factor=f, level=4, person="P", date=day, statement="s", reviewed="sha256:" + 64 * "0"), True)
        for f in factors
    ]


def test_a_measured_tile_is_verified_inside_its_region_and_some_of_its_inputs_are_judged(tile: Prediction):
    found = tile.credibility.as_json()
    assert found["factors"]["verification"]["level"] == 3
    assert found["region"]["inside"] > 0.9
    assert found["factors"]["data_pedigree"]["level"] == 2
    assert found["factors"]["history"]["level"] is None
    assert found["factors"]["process_management"]["level"] is None
    assert found["verification"]["uncovered"] == []
    assert "material rcg" in [i["input"] for i in found["confidence_C"]]


def test_the_ratio_dominates_what_is_uncertain_about_a_flown_tile(tile: Prediction):
    """Laminar or turbulent: the peak of this tile is that of its transition."""
    u = tile.credibility.facts.uncertainty
    assert u is not None
    ratios = ("ratio.scale", "effect.transition.factor")
    assert u.dominant in ratios
    assert sum(u.share(name) for name in ratios) > 0.9
    assert sum(u.share(n) for n in u.contributions) == pytest.approx(1.0)


def test_a_contribution_is_the_change_of_the_peak_at_one_standard_deviation(board: Prediction):
    u = peak_uncertainty(board.model, board.conditions, board.record.time_s[-1])
    warmer = replace(board.model, parameters={"stack.emissivity_factor": 1.035})
    peaks = [float(h.surface_K.max()) for h in march_points([board.model, warmer], [board.conditions] * 2)]
    assert u is not None
    assert u.contributions["stack.emissivity_factor"] == pytest.approx(abs(peaks[1] - peaks[0]), abs=0.05)


def test_a_board_under_a_lamp_has_no_mach_number_and_is_compared_with_ground_tests_alone(board: Prediction):
    statement = board.credibility
    assert statement.region.share_by_case.keys() == {"kaowool_board"}
    assert set(statement.region.outside) <= {"wall_K"}
    assert levels(statement)["input_pedigree"] == 3  # its record states the source of its flux, confidence A


def test_verification_rows_that_are_gone_lower_verification(facts: Facts):
    evidence = shipped_evidence()
    assert levels(assess(facts, evidence=evidence))["verification"] == 3
    without = {n: t for n, t in evidence.topics.items() if n != "effect transition"}
    assert levels(assess(facts, evidence=replace(evidence, topics=without)))["verification"] == 1
    failed = {**evidence.topics, "conduction": replace(evidence.topics["conduction"], within=28)}
    assert levels(assess(facts, evidence=replace(evidence, topics=failed)))["verification"] == 0
    assert levels(assess(replace(facts, mesh_error_K=None), evidence=evidence))["verification"] == 2


def test_data_sets_that_are_gone_lower_validation(facts: Facts):
    cases = shipped_evidence().cases
    assert levels(assess(facts, cases=cases))["validation"] == 2
    ground = [c for c in cases if c.kind == "ground test"]
    assert levels(assess(facts, cases=ground))["validation"] == 0


def test_a_data_set_that_was_predicted_badly_is_evidence_against(facts: Facts):
    """Tile 480 is far hotter than predicted; with tile 597 alone the plateau would count as predicted within 10 %."""
    cases = {c.name: c for c in shipped_evidence().cases}
    assert levels(assess(facts, cases=[cases["sts96_597"]]))["validation"] == 3
    assert levels(assess(facts, cases=[cases["sts96_597"], cases["sts96_480"]]))["validation"] == 2


def test_a_record_that_is_itself_missed_is_not_validated_by_others(facts: Facts, tile: Prediction):
    near = [c for c in shipped_evidence().cases if c.name == "sts96_597"]
    no = Answer(False, "missed")
    assert levels(assess(facts, cases=near))["validation"] == 3
    assert levels(assess(replace(facts, own_noise=no), cases=near))["validation"] == 2
    assert levels(assess(replace(facts, own_share=no), cases=near))["validation"] == 1
    found = tile.credibility
    assert re.match(
        r"its own readings are missed by [\d.]+ K of a rise of \d+ K", found.findings["validation.own_share"].text
    )
    assert not found.findings["validation.own_noise"].holds
    assert levels(found)["validation"] in (1, 2)


def test_an_input_without_a_source_is_named_with_the_place_where_to_state_it(board: Prediction):
    declared = board.record.declared.model_copy(
        update={"source": "", "conditions": ConditionsFile(file="conditions.csv")}
    )
    silent = replace(board, record=replace(board.record, declared=declared))
    found = silent.credibility.findings
    assert "construction of the wall (`source` in record.toml, at the top)" in found["data.sources"].text
    assert "conditions (`source` in record.toml, [conditions])" in found["inputs.sources"].text


@pytest.mark.parametrize("path", sorted(RECORDS.rglob("record.toml")), ids=lambda path: path.parent.name)
def test_every_shipped_record_states_the_sources_of_all_it_was_made_from(path: Path):
    record = load_record(path.parent)
    stated = [*inputs_of_record(record, point_of_record(record).effects), *conditions_of_record(record)]
    assert not [f"{i.name}: {i.location}" for i in stated if not i.source]


def test_a_transition_without_a_source_is_named_with_its_table_of_the_record(tile: Prediction):
    declared = tile.record.declared
    transition = declared.heating.transition.model_copy(update={"source": ""})
    heating = declared.heating.model_copy(update={"transition": transition})
    silent = replace(tile.record, declared=declared.model_copy(update={"heating": heating}))
    found = replace(tile, record=silent).credibility.findings["data.sources"]
    assert "transition (`source` in record.toml, [heating.transition])" in found.text


def test_sources_that_are_gone_lower_the_pedigrees(facts: Facts):
    silent, unrated, judged = replace(GOOD, source=""), replace(GOOD, confidence=""), replace(GOOD, confidence="A to C")
    pedigrees = [levels(assess(replace(facts, model=(i,), conditions=(i,)))) for i in (GOOD, judged, unrated, silent)]
    assert [p["data_pedigree"] for p in pedigrees] == [3, 2, 1, 0]
    assert [p["input_pedigree"] for p in pedigrees] == [3, 2, 2, 1]
    assert levels(assess(replace(facts, files={})))["input_pedigree"] == 0


def test_bounds_and_tests_that_are_gone_lower_uncertainty_and_robustness(facts: Facts):
    no = Answer(False, "")
    assert levels(assess(facts))["uncertainty_characterization"] == 3
    assert levels(assess(replace(facts, consistent=no)))["uncertainty_characterization"] == 2
    assert levels(assess(replace(facts, uncertainty=None)))["uncertainty_characterization"] == 1
    assert levels(assess(replace(facts, sigma=False)))["uncertainty_characterization"] == 0
    uncounted = replace(shipped_evidence(), claims=())
    assert levels(assess(facts, evidence=uncounted))["uncertainty_characterization"] == 2
    assert levels(assess(facts))["results_robustness"] == 3
    assert levels(assess(replace(facts, varied=no)))["results_robustness"] == 2
    assert levels(assess(replace(facts, holds=no)))["results_robustness"] == 1
    assert levels(assess(replace(facts, uncertainty=None)))["results_robustness"] == 0


def test_a_signed_review_gives_the_highest_level_only_where_all_rules_below_are_met(facts: Facts):
    with_all = levels(assess(facts, reviews=reviews(*levels(assess(facts)))))
    assert with_all["data_pedigree"] == with_all["verification"] == with_all["history"] == 4
    assert with_all["validation"] == 2  # tile 480 is far hotter than predicted under these conditions


@pytest.mark.thorough
@settings(max_examples=40)
@given(st.data())
def test_fewer_rows_data_sets_claims_and_reviews_never_raise_a_level(facts: Facts, data: st.DataObject):
    """Data sets whose predictions err by more than a tenth are evidence against, and are left out here."""
    every = shipped_evidence()
    good = [replace(c, bands=tuple(replace(b, rmse_K=1.0) for b in c.bands)) for c in every.cases]
    signed = reviews("history", "verification", "validation")

    def some(of):
        return [x for x in of if data.draw(st.booleans())]

    topics = dict(some(every.topics.items()))
    less = replace(every, topics=topics, claims=tuple(some(every.claims)))
    whole = levels(assess(facts, cases=good, evidence=every, reviews=signed))
    part = levels(assess(facts, cases=some(good), evidence=less, reviews=some(signed)))
    # claims that are met support a result together: fewer of them support as much, until there is none
    assert all((part[name] or 0) <= (whole[name] or 0) for name in whole)


def test_a_review_of_files_that_changed_since_does_not_count(tile: Prediction, tmp_path: Path):
    import datetime

    digest = digest_of(tile.record)
    signed = Review(
        factor="history", level=2, person="A. Engineer", date=datetime.date(2026, 11, 20),
        statement="flown on two vehicles", reviewed=digest,
    )  # fmt: skip
    add_review(tmp_path, signed)
    add_review(tmp_path, signed.model_copy(update={"factor": "process_management", "level": 1}))
    assert [r.counts for r in reviews_in(tmp_path, digest)] == [True, True]
    facts = replace(tile.facts(), folder=tmp_path)
    assert levels(assess(facts))["history"] == 2
    changed = assess(replace(facts, reviewed="sha256:" + 64 * "1"))
    assert levels(changed)["history"] is None
    assert [r["counts"] for r in changed.as_json()["reviews"]] == [False, False]


def test_a_damaged_file_of_reviews_is_reported_and_loses_no_result(tile: Prediction, tmp_path: Path):
    (tmp_path / "credibility.toml").write_text('format = "credibility/1"\n[[review]]\nfactor = "histroy"\n')
    found = assess(replace(tile.facts(), folder=tmp_path)).as_json()
    assert "histroy" in " ".join(found["problems"])
    assert found["factors"]["verification"]["level"] == 3


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_the_head_of_a_recording_is_read_in_any_encoding_that_its_columns_are(tmp_path: Path, encoding: str) -> None:
    text = (ROOT / "scenarios" / "data" / "sts107_early_entry.csv").read_text().replace("# title: ", "# title: Höhe, ")
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "sts107_early_entry.csv").write_text(text, encoding=encoding)
    (tmp_path / "recorded.toml").write_text((ROOT / "scenarios" / "recorded_sts107.toml").read_text())
    (recording,) = conditions_of_scenario(load_scenario(tmp_path / "recorded.toml"))
    assert recording.source.startswith("times, altitudes")
    assert "confidence A" in recording.confidence
    assert "Höhe" in recording.confidence
