"""The report of a closed loop: closure.json by its format, and a page that a browser shows."""

from __future__ import annotations

import json
import re
import subprocess
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from matplotlib.figure import Figure

from sim_heating.base.errors import LeftOutWarning
from sim_heating.base.files import files_written, output_directory, read_csv_columns
from sim_heating.base.report.page import Page, Picture, Section, page_html
from sim_heating.base.report.table import Table
from sim_heating.closure.batch import summary_row
from sim_heating.closure.clues.correlation import Correlation, residual_evidence
from sim_heating.closure.clues.record_checks import TRAJECTORY, DataFault
from sim_heating.closure.clues.residual_heating import residual_heating
from sim_heating.closure.report.batch import batch_page, residual_history
from sim_heating.closure.report.record import closure_json, closure_page, closures_table, write_closure
from sim_heating.closure.result import CandidateScore, Closure, Finding, NotEffect, ParameterEstimate, Statement
from sim_heating.closure.search.ranking import posteriors
from sim_heating.closure.search.tell_apart import Experiment
from sim_heating.closure.verdict.adequacy import Adequacy
from sim_heating.estimation.fit import estimate
from sim_heating.heating.effects import use
from sim_heating.inputs.record import pooled_rmse_K
from tests.support.browser import CHROMIUM, assert_fits, assert_harmless, hostile, needs_browser
from tests.support.missing import record_with

FOUND_ONSET = Statement(
    "found", [["impingement-onset"]],
    Adequacy(0.4, 1.02, 1.05, 0.03, 0.49, {"surface": 1.01, "bond": 1.03}, {"0 to 100 s": 1.0}, 1.2, True), 0.98, 0.97,
)  # fmt: skip
ONSET = use("impingement-onset", {"alpha_onset_deg": 41.0, "slope": 0.002})


@cache
def closed() -> Closure:
    """A record with an onset that its tables lack, fitted without and with it."""
    record, _ = record_with([ONSET], 5)
    before = estimate([record])
    names = [u.label for u in before.problem.unknowns]
    after = estimate([record], [*names, "effect.impingement-onset.slope"], effects=[ONSET])
    residual = residual_heating(before.problem, before.fit.values)
    residual_after = residual_heating(after.problem, after.fit.values)
    sigma = after.bounds.sigma
    parameters = {
        u.label: ParameterEstimate(float(v), float(s), u.parameter.unit)
        for u, v, s in zip(after.problem.unknowns, after.fit.values, sigma, strict=True)
    }
    bic = -2.0 * (after.fit.log_likelihood - before.fit.log_likelihood) + np.log(2000.0)
    errors = [f.after[0].segment_errors() for f in (before, after)]
    delta_bic = {"none": 0.0, "impingement-onset": float(bic)}
    scores = [
        CandidateScore(name, delta, e["fit"]["rmse_K"], e["holdout"]["rmse_K"], posteriors(delta_bic)[name])
        for (name, delta), e in zip(delta_bic.items(), errors, strict=True)
    ]
    posterior = posteriors(delta_bic)["impingement-onset"]
    named = Finding("impingement-onset", posterior, {"slope": parameters["effect.impingement-onset.slope"]})
    return Closure(
        record, before.before[0], before.after[0], after.after[0], record.noise_floor_K(), before.problem.reference,
        [named], scores, parameters, residual, residual_after, residual_evidence(residual), FOUND_ONSET,
        false_alarm="Calibrated on null records: 2 %.",
    )  # fmt: skip


def test_closure_json_has_every_field_of_its_format():
    data = json.loads(json.dumps(closure_json(closed())))
    record = closed().record
    assert data["format"] == "closure-report/2"
    assert data["records"] == [str(record.directory)]
    assert data["sensors"] == [s.name for s in record.used_sensors]
    for stage in ("predicted", "before", "after"):
        assert set(data[stage]) == {"fit", "holdout"}
        for errors in data[stage].values():
            assert set(errors) == {"rmse_K", "max_abs_K", "n"}
    used = [i for i, s in enumerate(record.sensors) if s.used]
    mask = record.holdout_mask()
    assert data["after"]["holdout"] == pooled_rmse_K(closed().after.residual_K[used], mask)
    assert data["noise_floor_K"] == pytest.approx(record.noise_floor_K())
    assert list(data["reference_condition"]) == ["alpha_deg", "beta_deg", "log10_re", "elevon_deg", "bodyflap_deg"]
    effect = data["effect"]
    assert effect["name"] == "impingement-onset"
    assert 0.99 < effect["posterior"] <= 1.0
    assert set(effect["parameters"]["slope"]) == {"value", "sigma", "unit"}
    assert effect["parameters"]["slope"]["unit"] == "1/deg"
    assert effect["parameters"]["slope"]["value"] == pytest.approx(0.002, rel=0.2)
    assert [set(c) for c in data["candidates"]] == [{"name", "delta_bic", "fit_rmse_K", "holdout_rmse_K"}] * 2
    assert data["candidates"][0]["delta_bic"] < data["candidates"][1]["delta_bic"] == 0.0
    assert data["residual_heating"] == "residual_heating.csv"
    assert [e["name"] for e in data["effects"]] == [data["effect"]["name"]]


@pytest.mark.thorough
def test_a_section_that_cannot_be_made_costs_neither_page_nor_numbers(tmp_path: Path) -> None:
    textual = Correlation("alpha_deg", 0.0, 0.5, 10.0, "lost", 0.5)  # type: ignore[arg-type]
    report = replace(closed(), evidence=replace(closed().evidence, correlations=(textual,)))
    with pytest.warns(LeftOutWarning, match="section `Evidence`: left out"):
        write_closure(report, tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "This section could not be made: " in page
    assert "Residuals that no heating explains" in page
    assert json.loads((tmp_path / "closure.json").read_text())["effect"]["name"] == "impingement-onset"


def test_a_piece_of_evidence_that_cannot_be_made_is_left_out_with_its_reason() -> None:
    residual = closed().residual
    with pytest.warns(LeftOutWarning, match="evidence, negative ratio: left out"):
        evidence = residual_evidence(residual, np.ones(len(residual.time_s) + 1))  # a ratio of other knots
    assert "negative ratio" in evidence.left_out
    assert evidence.negative_s is None
    assert evidence.shape_fits == residual_evidence(residual).shape_fits
    assert evidence.as_json()["left_out"] == dict(evidence.left_out)


def test_errors_fall_towards_the_noise_floor_as_the_model_grows():
    data = closure_json(closed())
    predicted, before, after = (data[stage]["fit"]["rmse_K"] for stage in ("predicted", "before", "after"))
    assert predicted > before > after
    assert after == pytest.approx(data["noise_floor_K"], rel=0.05)


def test_several_effects_are_listed_in_the_order_in_which_they_were_added():
    more = Finding("catalysis", 0.9, {})
    data = closure_json(replace(closed(), effects=[*closed().effects, more]))
    assert [e["name"] for e in data["effects"]] == ["impingement-onset", "catalysis"]
    assert data["effect"] == data["effects"][0]


def test_holdout_errors_of_a_record_without_holdout_are_null():
    record = closed().record
    bare = replace(
        record,
        declared=record.declared.model_copy(
            update={"segments": record.declared.segments.model_copy(update={"holdout": []})}
        ),
    )
    assert replace(closed().after, record=bare).segment_errors()["holdout"] is None


def test_a_set_is_stated_first_with_what_would_tell_it_apart():
    tell = (Experiment("a thermocouple at the bondline", 4.0), Experiment("the same flight again", 0.5))
    names = [["impingement-onset", "alpha-curvature"]]
    stated = replace(FOUND_ONSET, finding="one of", alternatives=names, would_tell_apart=tell)
    found = replace(closed(), statement=stated)
    assert closure_json(found)["would_tell_apart"][0] == {"what": "a thermocouple at the bondline", "log_odds": 4.0}
    page = closure_page(found)
    assert page.conclusion is not None
    assert page.conclusion[0].startswith("One of: impingement-onset or alpha-curvature")
    section = next(s for s in page.sections if s.title == "What would tell them apart")
    assert section.points == [
        "a thermocouple at the bondline: odds of 55 to 1",
        "the same flight again: odds of 1.6 to 1",
    ]


def test_each_member_of_a_set_has_its_value_in_text_and_json():
    names = [["emissivity", "heat-capacity"]]
    values = {
        "emissivity": {"emissivity_factor": ParameterEstimate(1.056, 0.002, "1")},
        "heat-capacity": {"heat_capacity_factor": ParameterEstimate(0.949, 0.001, "1")},
    }
    stated = replace(FOUND_ONSET, finding="one of", alternatives=names, alternative_values=values)
    said = "One of: emissivity (emissivity 5.6 % higher) or heat-capacity (heat capacity 5.1 % lower)"
    assert stated.in_words().startswith(said)
    assert stated.as_json()["alternatives"] == names
    assert stated.as_json()["alternative_values"]["heat-capacity"]["heat_capacity_factor"]["value"] == 0.949


def test_where_nothing_tells_a_set_apart_one_line_says_so_in_the_word_of_the_record():
    tell = (Experiment("the same test again", 0.0),)
    stated = replace(FOUND_ONSET, would_tell_apart=tell, experiment="test")
    assert stated.would_tell() == ["none of the tests tried tells them apart"]
    little = replace(stated, would_tell_apart=(Experiment("a thermocouple at the bondline", np.log(2.5)), *tell))
    best = "the best, a thermocouple at the bondline: odds of 2.5 to 1"
    assert little.would_tell() == [f"none of the tests tried tells them apart; {best}"]


def test_a_probability_says_whether_records_of_its_kind_are_in_its_calibration():
    """All records that the probability is calibrated with are of flights."""
    flight, test = (Statement("none", probability=0.98, experiment=e).certainty() for e in ("flight", "test"))
    assert flight == "Probability that this finding is right: 98 % (calibrated)."
    assert test == "Probability that this finding is right: 98 % (calibrated on flights, not on tests)."


@pytest.mark.parametrize(
    ("p", "text"),
    [
        (2 / 201, "does not explain the record to its noise (p-value 0.00995)"),
        (0.00999999, "does not explain the record to its noise (p-value 0.00999999)"),
        (0.01, "explains the record to its noise (p-value 0.01)"),
        (0.41234, "explains the record to its noise (p-value 0.41)"),
        (1e-9, "does not explain the record to its noise (p-value below 1e-06)"),
    ],
)
def test_a_p_value_is_told_from_the_level_that_judges_it(p: float, text: str):
    adequacy = replace(FOUND_ONSET.adequacy, p_value=p)
    assert text in replace(FOUND_ONSET, adequacy=adequacy).certainty()
    row = summary_row(closed()) | {"p_value": p}
    table = closures_table([row])
    (cell,) = [cells[[c.head for c in table.layout].index("p-value")] for cells in table.texts]
    assert f"(p-value {cell})" in text


def test_errors_after_are_told_of_what_a_record_partly_resembles():
    partly = replace(FOUND_ONSET, finding="partly", explained=0.87, resembles=["impingement-onset"])
    found = replace(closed(), statement=partly, effects=[Finding("unknown", 0.9, {})])
    assert "explains 87 % of what the declared model leaves above noise, and is not stated" in partly.certainty()
    errors = next(s for s in closure_page(found).sections if s.title == "Errors").tables[0]
    assert errors.rows[-1][0] == "With impingement-onset (after)"
    contents = closure_json(found)
    assert contents["effects"] == []
    assert contents["resembles"] == ["impingement-onset"]
    table = closures_table([summary_row(found)])
    row = dict(zip([c.head for c in table.layout], table.rows[0], strict=True))
    assert 0.0 < row["after, fit"] < row["before, fit"]


def test_where_nothing_is_missing_there_is_no_error_after():
    none = replace(closed(), statement=Statement("none"), after=closed().before, effects=[Finding("none", 0.9, {})])
    table = closures_table([summary_row(none)])
    row = dict(zip([c.head for c in table.layout], table.rows[0], strict=True))
    assert row["after, fit"] is None
    assert closure_json(none)["effects"] == []


def test_a_change_of_the_wall_is_among_the_estimates_and_no_table_is_empty():
    wall = {"stack.al2024.heat_capacity_factor": ParameterEstimate(1.06, 0.01, "1")}
    cause = NotEffect("wall", "heat capacity of layer al2024 6 % above the declared one", wall)
    stated = replace(FOUND_ONSET, not_effects=[cause])
    found = replace(closed(), statement=stated, effects=[Finding("none", 0.1, {})], parameters={})
    section = next(s for s in closure_page(found).sections if s.title == "Estimated parameters")
    assert section.tables[0].rows == [["wall: stack.al2024.heat_capacity_factor", 1.06, 0.01, "1"]]
    assert "Derivatives" not in section.tables[0].title
    bare = replace(found, statement=FOUND_ONSET)
    assert "Estimated parameters" not in [s.title for s in closure_page(bare).sections]


@pytest.mark.thorough
def test_no_share_of_a_candidate_is_stated_as_certain():
    html = page_html(closure_page(closed()))
    assert "1.000" not in html
    assert "above 0.99" in html


def test_posteriors_have_equal_priors():
    found = posteriors({"none": 0.0, "a": -2.0 * np.log(3.0), "b": 1e4})
    assert found["a"] == pytest.approx(0.75)
    assert sum(found.values()) == pytest.approx(1.0)


@pytest.mark.thorough
def test_the_folder_contains_json_history_and_page(tmp_path):
    with output_directory(tmp_path / "out", "close-loop") as folder:
        write_closure(closed(), folder)
    assert files_written(tmp_path / "out") == {"closure.json", "report.html", "residual_heating.csv"}
    data = json.loads((tmp_path / "out" / "closure.json").read_text())
    table = read_csv_columns(tmp_path / "out" / data["residual_heating"], ("time_s", "delta_ratio", "sigma"))
    np.testing.assert_array_equal(table["delta_ratio"], closed().residual.delta_ratio)


class Elements(HTMLParser):
    """Addresses and text of a page, and its elements that are not closed."""

    VOID = ("meta", "img", "link", "br", "wbr")

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.text: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        if tag not in self.VOID:
            self.open.append(tag)
        self.addresses += [v for k, v in attrs if k in ("src", "href")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.mark.thorough
def test_the_page_is_self_contained_and_has_every_section():
    html = page_html(closure_page(closed()))
    found = Elements(html)
    assert found.open == []
    assert all(a.startswith(("data:image/svg+xml;base64,", "#")) for a in found.addresses)
    assert "url(" not in html.split("</style>")[0]
    text = " ".join(found.text)
    for wanted in ("Found: impingement-onset", "Noise floor", "RMSE held out", "sigma", "Calibrated on null records"):
        assert wanted in text
    for section in ("Errors", "Measured against predicted", "Candidates", "Residual as heating", "Evidence"):
        assert f">{section}</h2>" in html
    after = closure_json(closed())["after"]["holdout"]["rmse_K"]
    assert f"{after:.2f}" in text


@pytest.mark.thorough
def test_a_fault_of_the_record_comes_before_any_finding():
    page = closure_page(replace(closed(), faults=[DataFault(TRAJECTORY, "TC1 is stuck.")]))
    assert page.conclusion is not None
    assert page.conclusion[0] == "No aerothermal finding: trajectory"
    assert page.conclusion[1].startswith("TC1 is stuck. The search states: found: impingement-onset.")
    assert 'role="alert">TC1 is stuck' in page_html(page)


def test_text_of_a_record_is_escaped_in_the_page():
    page = Page("<script>x</script>", "a & b", [Section("s", ["<b>"], tables=[Table("", ["<i>"], [["<u>"]])])])
    html = page_html(page)
    assert not re.search(r"<(script|b|i|u)>", html)


def test_a_figure_has_the_same_bytes_each_time():
    def picture() -> str:
        figure = Figure()
        figure.subplots().plot([0.0, 1.0])
        return Picture(figure).data_url

    assert picture() == picture()


@needs_browser
def test_a_browser_shows_the_page_with_all_its_pictures(tmp_path: Path):
    write_closure(closed(), tmp_path)
    page = (tmp_path / "report.html").as_uri()
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={tmp_path / 'p'}"]
    shot = tmp_path / "page.png"
    command = [CHROMIUM, *options, "--window-size=1200,6000", f"--screenshot={shot}", page]
    subprocess.run(command, check=True, timeout=120, capture_output=True)
    pixels = matplotlib.image.imread(shot)[..., :3]
    inked = np.mean(np.any(pixels < 0.97, axis=2), axis=1) > 0.3  # rows with much on them: axes of pictures
    assert pixels.shape[:2] == (6000, 1200)
    assert np.count_nonzero(inked) > 300
    coloured = np.ptp(pixels, axis=2) > 0.2
    assert np.mean(coloured) > 0.003


@needs_browser
def test_the_pages_of_a_record_and_of_a_batch_fit_a_screen_a_telephone_and_paper(tmp_path: Path):
    write_closure(closed(), tmp_path)
    row, kept = (json.loads(json.dumps(f(closed()))) for f in (summary_row, residual_history))
    (tmp_path / "batch.html").write_text(page_html(batch_page([row, row], [kept, kept])))
    assert_fits(tmp_path / "report.html", tmp_path / "batch.html")


def test_a_batch_has_a_page_with_all_records_and_the_residuals_of_those_that_are_done():
    row = json.loads(json.dumps(summary_row(closed())))
    kept = json.loads(json.dumps(residual_history(closed())))
    rows = [row, row | {"record": "A/other"}, {"record": "third", "failed": "no such <file>"}]
    page = batch_page(rows, [kept, kept, None])
    html = page_html(page)
    assert html.count("<figure") == 2
    assert 'href="./A/other/report.html"' in html
    assert 'href="./third' not in html  # which has no page
    assert page.warnings == ["third: no such <file>"]
    sensors = [s.name for s in closed().record.used_sensors]
    for chart in page.sections[1].charts:
        assert [panel.label for panel in chart.panels] == [f"{name}, residual, K" for name in sensors]
    largest = np.nanmax(np.abs(closed().before.residual_K), axis=1)  # no extreme is lost
    shown = [np.max(np.abs(panel.curves[0].values)) for panel in page.sections[1].charts[0].panels]
    used = [i for i, s in enumerate(closed().record.sensors) if s.used]
    np.testing.assert_allclose(shown, largest[used], atol=0.0051)


def test_the_charts_of_a_report_have_the_curves_of_its_pictures():
    sections = {s.title: s for s in closure_page(closed()).sections}
    (compared,), (missing,) = (sections[n].charts for n in ("Measured against predicted", "Residual as heating"))
    used = [s.name for s in closed().record.used_sensors]
    assert [p.label.split(",")[0] for p in compared.panels[: 2 * len(used)]] == [n for n in used for _ in "ab"]
    names = [c.label.split(",")[0] for c in compared.panels[0].curves]
    assert names == ["measured", "declared model", "declared model fitted", "with impingement-onset"]
    after = closed().after
    np.testing.assert_array_equal(compared.panels[1].curves[-1].values, after.residual_K[0])
    np.testing.assert_array_equal(missing.panels[0].curves[0].values, closed().residual.delta_ratio)


@needs_browser
@pytest.mark.filterwarnings("ignore:constrained_layout not applied")  # the names are longer than a picture is high
def test_no_name_of_a_record_or_effect_runs_in_the_report(tmp_path: Path):
    """Names of every field of a record's declaration, of its directory, of an effect and its parameters, of faults."""
    found = closed()
    declared = found.record.declared
    sensors = [
        s.model_copy(update={"name": hostile(f"sensor-{i}")}) for i, s in enumerate(declared.thermocouples.sensor)
    ]
    named = declared.model_copy(
        update={
            "title": hostile("title"), "vehicle": hostile("vehicle"), "control_point": hostile("control-point"),
            "thermocouples": declared.thermocouples.model_copy(update={"sensor": sensors}),
        }
    )  # fmt: skip
    record = replace(found.record, declared=named, directory=Path(hostile("directory", without="/")))
    effect = replace(
        found.effects[0],
        name=hostile("effect"),
        parameters={hostile("parameter"): next(iter(found.parameters.values()))},
    )
    report = replace(
        found, record=record, effects=[effect], parameters={hostile(n): p for n, p in found.parameters.items()},
        predicted=replace(found.predicted, record=record), before=replace(found.before, record=record),
        after=replace(found.after, record=record), false_alarm=hostile("false-alarm"),
        candidates=[replace(c, name=hostile(f"candidate-{i}")) for i, c in enumerate(found.candidates)],
    )  # fmt: skip
    html = page_html(closure_page(report))
    for where in ("directory", "control-point", "effect", "parameter", "candidate-0"):
        assert f"{where} &lt;script&gt;" in html  # shown, and as a text
    assert_harmless(html, tmp_path)
    fault = DataFault(hostile("fault"), hostile("message"))
    assert_harmless(page_html(closure_page(replace(report, faults=(fault,)))), tmp_path)
