"""95 % bands: mixtures of members, an estimate in place of priors, readings of a record inside, margins at the band."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtr

from sim_heating import cli
from sim_heating.base.errors import InputError
from sim_heating.base.parameters import MODEL
from sim_heating.closure.prior.model_error import other_flight
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.report.estimate_file import read_estimate, write_estimate
from sim_heating.estimation.report.report import estimate_contents
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import load_record
from sim_heating.inputs.scenario import load_scenario
from sim_heating.march.history import march_points
from sim_heating.planning.bands import (
    Member,
    Spread,
    members_of_point,
    mixture_quantile,
    predict_with_band,
    read_member,
    spreads,
    with_bands,
)
from sim_heating.planning.considered import considered
from sim_heating.simulation.run import run
from tests.support.paths import ROOT, SCENARIOS

P06 = SCENARIOS / "records" / "practice" / "p06"
EMITTANCE = "stack.emissivity_factor"


def of_normal(mean, sigma):
    return Spread(np.array([[mean]]), np.array([[sigma]]), {})


def test_one_member_has_the_quantile_of_its_normal_distribution():
    assert mixture_quantile([of_normal(700.0, 10.0)], [2.0], 0.975)[0, 0] == pytest.approx(719.59964, abs=1e-4)


def test_two_members_share_the_probability_by_their_weights():
    """Far apart, so that 3/4 and 1/4 of the probability lie about each: the 0.95 quantile is the upper one's 0.8."""
    pair = [of_normal(700.0, 1.0), of_normal(900.0, 10.0)]
    assert mixture_quantile(pair, [3.0, 1.0], 0.95)[0, 0] == pytest.approx(900.0 + 0.8416212 * 10.0, abs=1e-3)


def test_sizes_of_a_models_error_widen_a_band_more_than_their_root_mean_square_does():
    """Half of the probability at 5 K and half at 15 K: their tails reach further than one of sqrt(125) K."""
    pair = [of_normal(700.0, 5.0), of_normal(700.0, 15.0)]
    high = mixture_quantile(pair, [1.0, 1.0], 0.975)[0, 0]
    assert 1.0 - 0.5 * (ndtr((high - 700.0) / 5.0) + ndtr((high - 700.0) / 15.0)) == pytest.approx(0.025, abs=1e-9)
    assert high > 700.0 + 1.96 * np.sqrt(125.0)


@pytest.mark.thorough
def test_a_band_holds_the_readings_of_a_record_and_adds_in_squares():
    predicted = predict_with_band(load_record(P06))
    band = predicted.history.band
    assert predicted.within_band > 0.9
    half = 0.5 * (band.high_K - band.low_K)[0]
    hottest = int(np.nanargmax(predicted.history.surface_K))
    assert half[hottest] == pytest.approx(1.959964 * np.sqrt(sum(s**2 for s in band.sources.values())), rel=0.02)
    assert np.all(half >= 0.0)


def test_a_band_about_an_onset_is_no_wider_than_the_rise_there():
    """The declared transition of a measured tile, which may come 0.07 decades earlier or later, and its wall."""
    record = load_record(SCENARIOS / "records" / "sts96_597")
    model, flown = point_of_record(record), conditions_of_record(record)
    k = next(k for k, used in enumerate(model.effects) if used.effect.name == "transition")
    onset = [p.name for p in model.effects[k].effect.parameters].index("log10_re_onset")

    def surface_K(decades: float) -> np.ndarray:
        values = list(model.effects[k].values)
        values[onset] += decades
        effects = (*model.effects[:k], replace(model.effects[k], values=tuple(values)), *model.effects[k + 1 :])
        return march_points([replace(model, effects=effects)], [flown])[0].surface_K

    rise = np.max(surface_K(-0.5) - surface_K(0.5))
    (spread,) = spreads(model, flown, heating=None, with_table=False)
    assert 0.5 * rise < 1.96 * np.max(spread.sigma_K[0]) < 1.1 * rise  # 1.4 of it with changes at one sigma


@pytest.mark.thorough
def test_a_run_states_margins_at_the_band(tmp_path: Path):
    xarray = pytest.importorskip("xarray")
    out = tmp_path / "out"
    scenario = SCENARIOS / "recorded_sts107.toml"
    assert cli.main(["run", str(scenario), "--bands", "--out", str(out)]) == 0
    found = json.loads((out / "summary.json").read_text())["control_points"]
    with xarray.open_dataset(out / "flight.nc") as flown:
        for name, point in found.items():
            high = float(flown["surface_high_K"].sel(control_point=name).max())
            assert point["band"]["peak_surface_high_K"] == pytest.approx(high)
            assert point["band"]["surface_margin_at_band_K"] < point["surface_margin_K"]
            assert point["band"]["sources_K"]["model"] > 0.0


def test_a_member_without_bands_is_refused_in_one_line(tmp_path: Path, capsys):
    assert cli.main(["predict", str(P06), "--member", "estimate.json", "1", "--out", str(tmp_path / "out")]) == 2
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error:")]
    assert errors == ["error: --member: is for --bands; add that option"]


@cache
def fitted():
    """The estimate of p06 with emittance as declared, its records, and the fit that knows a wall of 3 % more."""
    names, record = ["ratio.scale", "ratio.d_alpha"], load_record(P06)
    return (
        estimate_contents(estimate(record, names)),
        estimate(record, names, fixed={EMITTANCE: 1.03}),
    )


@pytest.mark.thorough
def test_a_wall_that_was_held_moves_estimates_as_a_fit_with_that_wall_has_them():
    held, other = fitted()
    found = considered(held, [load_record(P06)])
    assert found.names[:2] == tuple(held.parameters)
    slopes = np.linalg.solve(found.covariance[2:, 2:], found.covariance[2:, :2]).T  # the other walls as they are
    moved = held.values(found.names[:2]) + 0.03 * slopes[:, found.names[2:].index(EMITTANCE)]
    assert np.all(np.abs(moved - other.fit.values) < 0.1 * other.bounds.sigma)


@pytest.mark.thorough
def test_most_of_the_error_of_a_wall_cancels_where_the_fitted_point_flies_again():
    held, _ = fitted()
    record = load_record(P06)
    alone, joint = (
        sum(s**2 for s in predict_with_band(record, [Member(held, considered=known)]).history.band.sources.values())
        for known in (None, considered(held, [record]))
    )
    assert joint < 0.3 * alone


@pytest.mark.thorough
def test_an_estimate_with_the_error_of_its_model_predicts_with_a_band(tmp_path: Path):
    """A lasting error of the heating is one of the magnitude, known no better than to the size of that error."""
    copy = shutil.copytree(P06, tmp_path / "p06")
    stated = (copy / "record.toml").read_text()
    (copy / "record.toml").write_text(stated + "\n[heating.uncertainty]\nrelative = 0.05\ncorrelation_s = 1e5\n")
    fit, out, names = tmp_path / "fit", tmp_path / "out", "ratio.scale,ratio.d_alpha"
    assert cli.main(["estimate", str(copy), "--model-error", "--parameters", names, "--out", str(fit)]) == 0
    found = read_estimate(fit)
    assert found.model_error is not None
    scale = found.parameters["ratio.scale"]
    assert 0.5 < scale.sigma / (found.model_error.relative * (1.0 + scale.value)) < 1.1
    assert found.parameters["ratio.d_alpha"].sigma < 1e-3  # the manoeuvre tells it within seconds
    assert cli.main(["predict", str(copy), "--bands", "--member", str(fit), "1", "--out", str(out)]) == 0
    band = json.loads((out / "summary.json").read_text())["band"]
    assert {"estimate", "model"} <= set(band["sources_K"])
    assert band["within"] > 0.9


@pytest.mark.thorough
def test_a_prediction_with_a_member_states_the_estimate_as_input_and_its_band_as_uncertainty(tmp_path: Path):
    held, _ = fitted()
    write_estimate(tmp_path / "estimate.json", held)
    command = ["predict", str(P06), "--bands", "--member", str(tmp_path / "estimate.json"), "1"]
    assert cli.main([*command, "--out", str(tmp_path / "out")]) == 0
    told = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert set(told["provenance"]["inputs"]) == {"scenarios/records/practice/p06", str(tmp_path / "estimate.json")}
    assert told["credibility"]["factors"]["uncertainty_characterization"]["level"] >= 2
    stated = told["credibility"]["uncertainty"]
    sources_K = {name: part["sigma"] for name, part in stated["contributions"].items()}
    assert sources_K == pytest.approx(told["band"]["sources_K"])


@pytest.mark.thorough
def test_the_next_flight_is_predicted_with_what_a_campaign_knows_of_its_wall(tmp_path: Path):
    """An emittance of 0.9 +- 0.01 of what is declared: hotter by nearly 0.9**-0.25 in radiative equilibrium."""
    (tmp_path / "next_flight.toml").write_text(f'[prior]\n"{EMITTANCE}@LS" = [0.9, 0.01]\n')
    aged = read_member(tmp_path / "next_flight.toml")
    record = load_record(P06)
    declared, known = predict_with_band(record), predict_with_band(record, [aged])
    hottest = int(np.nanargmax(declared.history.surface_K))
    rise_K = (known.history.surface_K - declared.history.surface_K)[hottest]
    assert rise_K / declared.history.surface_K[hottest] == pytest.approx(0.9**-0.25 - 1.0, rel=0.05)
    narrower, wider = (p.history.band.sources for p in (known, declared))
    slope = 0.9**-1.25  # of the temperature over the emittance, over that at 1
    assert narrower["estimate"] == pytest.approx(wider[EMITTANCE] * slope * 0.01 / MODEL[EMITTANCE].sigma, rel=0.05)
    assert members_of_point([aged], "V09T9527") == [Member(None)]


@pytest.mark.parametrize(
    ("key", "message"),
    [
        (
            "stack.emissivity_facto",
            "unknown parameter `stack.emissivity_facto`; did you mean `stack.emissivity_factor`",
        ),
        (f"{EMITTANCE}@BODYFLAP", "the estimate has no parameter of this control point"),
    ],
)
def test_a_parameter_that_the_point_of_a_record_lacks_is_named_with_the_members_file(tmp_path, key, message):
    (tmp_path / "aged.toml").write_text(f'[prior]\n"{key}" = [0.9, 0.01]\n')
    with pytest.raises(InputError, match=rf"aged\.toml: LS: {re.escape(message)}"):
        predict_with_band(load_record(P06), [read_member(tmp_path / "aged.toml")])


@pytest.mark.parametrize("others", ["", f'"{EMITTANCE}@FACE" = [0.9, 0.01]\n'], ids=["alone", "among others"])
def test_a_prior_of_a_misspelt_control_point_is_refused(tmp_path, others):
    """The bands would be those of the declared model."""
    (tmp_path / "aged.toml").write_text(f'[prior]\n"{EMITTANCE}@FACES" = [0.9, 0.01]\n{others}')
    flown = run(load_scenario(SCENARIOS / "capsule.toml"))
    with pytest.raises(
        InputError, match=r"aged\.toml: the vehicle has no control point `FACES`; did you mean `FACE`\?"
    ):
        with_bands(flown, [read_member(tmp_path / "aged.toml")])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('"ratio.d_alpha" = [0.0, 1.0]', "[prior]: `ratio.d_alpha` is of a fit alone; give an estimate.json"),
        (f'"{EMITTANCE}" = "flat"', "[prior]: states no [mean, sigma] of a parameter"),
        (f'"{EMITTANCE}" = [1.0, -1.0]', "`sigma`: -1.0 must not be below 0"),
    ],
)
def test_settings_that_say_nothing_of_another_flight_are_refused(tmp_path: Path, text: str, message: str):
    (tmp_path / "next.toml").write_text(f"[prior]\n{text}\n")
    with pytest.raises(InputError, match=re.escape(message)) as error:
        read_member(tmp_path / "next.toml")
    assert "next.toml" in str(error.value)


@pytest.mark.parametrize("weight", ["0", "-1", "nan", "inf", "half"])
def test_a_weight_that_is_no_number_above_0_is_refused(tmp_path: Path, capsys, weight: str):
    command = ["predict", str(P06), "--bands", "--member", str(P06 / "record.toml"), weight]
    assert cli.main([*command, "--out", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: Invalid value for '--member': ")


def test_the_clock_of_a_flight_shifts_all_that_is_predicted(tmp_path: Path):
    copy = shutil.copytree(P06, tmp_path / "p06")
    stated = (copy / "record.toml").read_text()
    (copy / "record.toml").write_text(stated + "\n[conditions.uncertainty]\ntime_shift_s = 3.0\n")
    record = load_record(copy)
    other = other_flight(record)
    assert other is not None
    assert [name for name, _ in other.directions] == ["time_shift_s"]
    late = other.record(np.ones(1)).conditions
    at = record.conditions.time_s[200:210]
    np.testing.assert_allclose(late.at(at)["alpha_deg"], record.conditions.at(at - 3.0)["alpha_deg"], atol=1e-9)


def test_an_estimate_whose_record_is_gone_is_refused_in_one_line(tmp_path: Path, capsys):
    held, _ = fitted()
    write_estimate(tmp_path / "estimate.json", held.model_copy(update={"records": ["gone"]}))
    command = ["predict", str(P06), "--bands", "--member", str(tmp_path / "estimate.json"), "1"]
    assert cli.main([*command, "--out", str(tmp_path / "out")]) == 2
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error:")]
    assert len(errors) == 1
    assert "its record `gone` does not exist" in errors[0]


@pytest.mark.thorough
def test_margins_of_a_study_are_of_its_estimates_by_weight(tmp_path: Path):
    """Between those of either estimate, as their weights say; a point without one stays as declared."""
    held, _ = fitted()
    for name, scale in (("hot", 0.06), ("cold", -0.06)):
        parameters = held.parameters | {
            "ratio.scale": held.parameters["ratio.scale"].model_copy(update={"value": scale})
        }
        changed = {"control_point": "V07T9975", "parameters": parameters, "records": [str(P06)], "inputs": {}}
        write_estimate(tmp_path / f"{name}.json", held.model_copy(update=changed))
    study = (SCENARIOS / "studies" / "small_envelope.toml").read_text().partition("[[envelope.boundary]]")[0]
    study = study.replace("[-12.0, -8.0, -4.0, 0.0]", "[-8.0]").replace("refinements = 1", "bands = true")
    flights = {}
    for weights in ({}, {"hot": 3.0}, {"cold": 1.0}, {"hot": 3.0, "cold": 1.0}):
        members = [f'[[envelope.member]]\nestimate = "{n}.json"\nweight = {w}\n' for n, w in weights.items()]
        path = tmp_path / f"{'_'.join(weights) or 'declared'}.toml"
        path.write_text(study.replace("[[envelope.map]]", "".join(members) + "[[envelope.map]]"))
        assert cli.main(["plan", str(path), "--workers", "1", "--out", str(tmp_path / path.stem)]) == 0
        planned = json.loads((tmp_path / path.stem / "study.json").read_text())
        flights[path.stem] = planned["envelope"]["maps"]["alpha"]["flights"][0]
    margin, at_band = (
        {name: flight[key]["V07T9975 surface"] for name, flight in flights.items()}
        for key in ("margins_K", "margins_at_band_K")
    )
    assert margin["hot"] < margin["cold"]
    assert margin["hot_cold"] == pytest.approx(0.75 * margin["hot"] + 0.25 * margin["cold"])
    assert at_band["hot"] < at_band["hot_cold"] < at_band["cold"]
    others = [flight["margins_at_band_K"]["WING_LE surface"] for flight in flights.values()]
    assert max(others) == pytest.approx(min(others))


@pytest.mark.thorough
def test_page_and_study_json_state_the_estimates_of_margins(tmp_path: Path):
    shipped = read_estimate(ROOT / "docs" / "reference" / "formats" / "examples" / "estimate.json")
    moved = {"control_point": "V07T9975", "records": [str(P06)], "inputs": {}}
    write_estimate(tmp_path / "first.json", shipped.model_copy(update=moved))
    write_estimate(tmp_path / "second.json", shipped.model_copy(update=moved | {"control_point": None}))
    members = "".join(
        f'[[envelope.member]]\nestimate = "{name}.json"\nweight = {weight}\n'
        for name, weight in (("first", 3.0), ("second", 1.0))
    )
    study = (SCENARIOS / "studies" / "small_envelope.toml").read_text().partition("[[envelope.boundary]]")[0]
    study = study.replace("[-12.0, -8.0, -4.0, 0.0]", "[-8.0]").replace('"V07T9975", "WING_LE"', '"V07T9975"')
    (tmp_path / "study.toml").write_text(study.replace("refinements = 1\n", f"bands = true\n{members}"))
    out = tmp_path / "out"
    assert cli.main(["plan", str(tmp_path / "study.toml"), "--workers", "1", "--out", str(out)]) == 0
    assert json.loads((out / "study.json").read_text())["envelope"]["members"] == [
        {"estimate": "first.json", "control_point": "V07T9975", "weight": 3.0, "share": 0.75},
        {"estimate": "second.json", "control_point": None, "weight": 1.0, "share": 0.25},
    ]
    cells = re.findall(r"<td[^>]*>([^<]*)</td>", (out / "report.html").read_text())
    at = cells.index("first.json")
    assert cells[at : at + 8] == ["first.json", "V07T9975", "3", "75 %", "second.json", "several", "1", "25 %"]


@pytest.mark.parametrize(
    ("member", "message"),
    [
        ('estimate = "gone.json"\n', "[[envelope.member]] 1: `estimate`: the file"),
        ('estimate = "gone.json"\nweight = 0.0\n', "weight"),
    ],
)
def test_a_member_of_a_study_that_cannot_be_is_refused_in_one_line(tmp_path: Path, capsys, member, message):
    study = (SCENARIOS / "studies" / "small_envelope.toml").read_text()
    bands = f"bands = true\n[[envelope.member]]\n{member}"
    (tmp_path / "study.toml").write_text(study.replace("refinements = 1", bands))
    assert cli.main(["plan", str(tmp_path / "study.toml"), "--out", str(tmp_path / "out")]) == 2
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error:")]
    assert len(errors) == 1
    assert "study.toml" in errors[0]
    assert message in errors[0]
