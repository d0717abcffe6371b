"""A campaign of flights of one control point: flown, fitted alone and jointly, its tables revised, resumed.

The flights are entries in three degrees of freedom that end after their manoeuvre. Their truth has a heating ratio and
a derivative that the tables do not have.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.base.files import read_json
from sim_heating.campaign.carried import Carried, agreed
from sim_heating.campaign.flights import read_flights
from sim_heating.campaign.joint import agreement
from sim_heating.cli import main
from sim_heating.inputs.record import load_record
from tests.support.browser import assert_fits, needs_browser
from tests.support.json_output import run_json
from tests.support.paths import SCENARIOS

TRUTH = {"ratio.scale": 0.15, "ratio.d_alpha": 4e-4}
POINT = "V09T9527"
FITTED = ("doublet-seed11", "doublet-seed12")
CAMPAIGN = """
format = "campaign/1"
title = "Three measurements of one manoeuvre"
vehicle = "orbiter"
close_loop = false

[fit]
parameters = ["ratio.scale", "ratio.d_alpha"]

[[flight]]
scenario = "doublet.toml"
seeds = [11, 12]

[[flight]]
scenario = "doublet.toml"
seeds = [13]
check = true
"""


def write_doublet(path: Path, truth: dict[str, float]) -> None:
    """A scenario that ends after its manoeuvre, with a truth that its tables do not have."""
    text = (SCENARIOS / "entry_3dof.toml").read_text()
    text = text[: text.index("[measurements]")].replace("mach = 2.5", "velocity_m_s = 5950.0")
    lines = [line for line in text.splitlines() if not line.startswith("control_points")]
    parameters = ", ".join(f'"{n}" = {v}' for n, v in truth.items())
    head = "\n".join(lines).replace("[trajectory]\n", f'control_points = ["{POINT}"]\n[trajectory]\n', 1)
    path.write_text(f"{head}\n[truth]\nparameters = {{ {parameters} }}\n")


def finished(folder: Path, campaign: str) -> Path:
    """The folder with a scenario, a campaign of it, and the results of the campaign in `out`."""
    write_doublet(folder / "doublet.toml", TRUTH)
    (folder / "campaign.toml").write_text(campaign)
    assert main(["campaign", str(folder / "campaign.toml"), "--out", str(folder / "out"), "--workers", "1"]) == 0
    return folder


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The campaign of two flights that are fitted and one that checks."""
    return finished(tmp_path_factory.mktemp("campaign"), CAMPAIGN)


@pytest.fixture(scope="module")
def report(home: Path) -> dict[str, Any]:
    return read_json(home / "out" / "campaign.json")


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The campaign of one flight that is fitted and one that checks."""
    return finished(tmp_path_factory.mktemp("small"), CAMPAIGN.replace("seeds = [11, 12]", "seeds = [11]"))


@pytest.mark.thorough
def test_joint_flights_find_the_truth_with_smaller_bounds(report: dict[str, Any]) -> None:
    (joint,) = report["joint"]
    assert joint["flights"] == list(FITTED)
    assert [u["flights"] for u in report["updates"]] == [list(FITTED)]
    for name, truth in TRUTH.items():
        together = joint["parameters"][name]
        alone = [r["parameters"][name]["sigma"] for r in report["fits"]]
        assert together["sigma"] == pytest.approx(1.0 / np.sqrt(sum(s**-2 for s in alone)), rel=0.2)
        if name == "ratio.d_alpha":  # the magnitude is about another condition than that of the truth
            assert abs(together["value"] - truth) < 3.5 * together["sigma"]
    assert joint["agreement"]["p_value"] > 1e-3


def test_the_revised_tables_predict_a_flight_that_was_not_fitted(small: Path) -> None:
    report = read_json(small / "out" / "campaign.json")
    assert [u["flights"] for u in report["updates"]] == [[FITTED[0]]]
    (checked,) = [e for e in report["errors"] if e["check"]]
    assert checked["flight"] == "doublet-seed13"
    assert checked["after_K"] < 0.3 * checked["before_K"]


@pytest.mark.thorough
def test_campaign_repeats_only_a_fit_that_was_lost(
    home: Path, report: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    out = home / "out"
    fits = {p: p.stat().st_mtime_ns for p in out.glob("fits/*/*/*/estimate.json")}
    flown = {p: p.stat().st_mtime_ns for p in out.glob("records/*/conditions.csv")}
    assert len(fits) == 2
    assert len(flown) == 3
    lost = min(fits)
    shutil.rmtree(lost.parent)
    printed = run_json(capsys, "campaign", str(home / "campaign.toml"), "--out", str(out), "--workers", "1")
    assert printed["results"] == report
    assert {Path(name) for name in printed["files"]} >= {*fits, *flown, out / "report.html"}
    assert {p for p, t in fits.items() if p.stat().st_mtime_ns != t} == {lost}
    assert {p: p.stat().st_mtime_ns for p in flown} == flown
    assert read_json(out / "campaign.json") == report


def test_records_know_their_flight_and_its_manoeuvre(small: Path) -> None:
    flights = read_flights([small / "out" / "records"])
    assert [f.name for f in flights] == [FITTED[0], "doublet-seed13"]
    for flight in flights:
        (manoeuvre,) = flight.manoeuvres
        assert manoeuvre.name == "popu-mach20"
        record = flight.records[POINT]
        alpha = record.conditions.at([manoeuvre.start_s - 5.0, manoeuvre.start_s + 6.0])["alpha_deg"]
        assert alpha[1] < alpha[0] - 3.0


def test_flights_that_differ_by_more_than_their_bounds_disagree() -> None:
    def row(value: float) -> dict[str, Any]:
        parameters = {"ratio.scale": {"value": value, "sigma": 0.01}, "ratio.d_alpha": {"value": 1e-4, "sigma": 1e-5}}
        return {"parameters": parameters, "correlation": {"ratio.scale|ratio.d_alpha": 0.5}}

    near = agreement([row(0.10), row(0.11)], row(0.105))
    far = agreement([row(0.10), row(0.20)], row(0.15))
    assert near is not None
    assert far is not None
    assert near.degrees == far.degrees == 2
    # d^T C^-1 d of one parameter alone, correlated by 0.5 with one that agrees: (d / sigma)^2 / (1 - 0.25), twice
    assert near.chi_square == pytest.approx(2 * 0.5**2 / 0.75)
    assert near.p_value > 0.5
    assert far.p_value < 1e-6


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ('scenario = "doublet.toml"\nseeds = [13]', 'scenario = "absent.toml"', "there is no"),
        ("seeds = [11, 12]", "seeds = [11, 11]", "must be different whole numbers"),
        ("check = true", 'records = "out/records"', "give either `scenario` or `records`"),
        ("seeds = [13]\ncheck = true", "seeds = [12]", "doublet.toml with seed 12 is that of [[flight]] 1"),
        ("close_loop = false", "close_lop = false", "close_loop"),
        ('vehicle = "orbiter"', 'vehicle = "orbiter"\ncontrol_points = ["V09T9999"]', "V09T9999"),
    ],
)
def test_one_line_states_what_is_wrong_with_a_campaign(
    small: Path, old: str, new: str, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = small / "wrong.toml"
    assert old in CAMPAIGN
    wrong.write_text(CAMPAIGN.replace(old, new))
    assert main(["campaign", str(wrong), "--out", str(small / "wrong")]) == 2
    (said,) = capsys.readouterr().err.strip().splitlines()
    assert line in said
    assert not (small / "wrong").exists()


@pytest.mark.thorough
def test_a_campaign_without_a_manoeuvre_says_that_it_fits_nothing(
    home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It ended well, with a table of zeros."""
    flight = (home / "doublet.toml").read_text()
    head, _, tail = flight.partition("[[trajectory.manoeuvre]]")
    quiet = head + tail[tail.index("\n[") :] if "\n[" in tail else head
    assert "manoeuvre" not in quiet
    (tmp_path / "doublet.toml").write_text(quiet)
    (tmp_path / "campaign.toml").write_text(CAMPAIGN.replace("seeds = [11, 12]", "seeds = [11]"))
    arguments = ["campaign", str(tmp_path / "campaign.toml"), "--out", str(tmp_path / "out"), "--workers", "1"]
    assert main(arguments) == 0
    assert "no flight has a manoeuvre: nothing is fitted" in " ".join(capsys.readouterr().out.split())
    assert "no flight has a manoeuvre" in (tmp_path / "out" / "report.html").read_text()


def test_records_of_one_flight_that_state_other_manoeuvres_are_refused(small: Path, tmp_path: Path) -> None:
    source = small / "out" / "records" / FITTED[0]
    for name in ("a", "b"):
        shutil.copytree(source, tmp_path / name)
    text = (tmp_path / "b" / "record.toml").read_text().replace(f'control_point = "{POINT}"', 'control_point = "OTHER"')
    (tmp_path / "b" / "record.toml").write_text(text.replace('kind = "popu"', 'kind = "elevon-sweep"'))
    assert load_record(tmp_path / "b").declared.manoeuvre[0].kind == "elevon-sweep"
    with pytest.raises(InputError, match="state different"):
        read_flights([tmp_path])


def test_the_page_names_every_flight_and_the_csv_holds_every_estimate(small: Path) -> None:
    report, page = read_json(small / "out" / "campaign.json"), (small / "out" / "report.html").read_text()
    assert all(f["name"] in page for f in report["flights"])
    rows = (small / "out" / "fits.csv").read_text().splitlines()
    shown = [n for r in (*report["fits"], *report["joint"]) for n in r["parameters"] if not n.startswith("initial.")]
    assert len([row for row in rows if not row.startswith("#")]) == 1 + len(shown)


@needs_browser
def test_the_page_fits_a_screen_a_telephone_and_paper(home: Path) -> None:
    assert_fits(home / "out" / "report.html")


def test_fits_of_one_point_take_the_name_that_all_its_records_allow() -> None:
    coating, heat = "coating-thickness", "heat-capacity"
    of_coating = {coating: {"effect.coating-thickness.coating_factor": (1.2, 0.01)}}
    of_heat = {heat: {"effect.heat-capacity.coating_heat_capacity_factor": (1.18, 0.02)}}
    undecided = Carried(((heat, coating),), of_heat, "one of")
    records = [
        undecided,
        Carried(((coating, heat),), of_coating, "one of"),
        Carried(((coating,),), of_coating, "found"),
    ]
    assert [tuple(c.by_effect) for c in agreed(records)] == [(coating,)] * 3
    assert agreed(records)[0].estimates == {"effect.coating-thickness.coating_factor": (1.2, 0.01)}
    # one record for each name: both take the same
    assert len({tuple(c.by_effect) for c in agreed(records[:2])}) == 1
    # without a name in common every record keeps its own
    apart = [Carried(((heat,),), of_heat, "found"), Carried(((coating,),), of_coating, "found")]
    assert [tuple(c.by_effect) for c in agreed(apart)] == [(heat,), (coating,)]


@pytest.mark.thorough
def test_a_coating_that_loses_emittance_is_followed_from_flight_to_flight(tmp_path: Path) -> None:
    emittance = "stack.emissivity_factor"
    truths = {"first": 1.0, "second": 0.9}
    for name, factor in truths.items():
        write_doublet(tmp_path / f"{name}.toml", {emittance: factor})
    flights = "".join(f'[[flight]]\nscenario = "{name}.toml"\nseeds = [21]\n' for name in truths)
    text = CAMPAIGN[: CAMPAIGN.index("[fit]")] + f'[fit]\nparameters = ["{emittance}"]\nstart = "declared"\n{flights}'
    (tmp_path / "campaign.toml").write_text(f'{text}[ageing]\n"{emittance}" = 0.05\n')
    assert main(["campaign", str(tmp_path / "campaign.toml"), "--out", str(tmp_path / "out"), "--workers", "1"]) == 0
    report = read_json(tmp_path / "out" / "campaign.json")
    (walk,) = report["ageing"]
    assert walk["flights"] == ["first-seed21", "second-seed21"]
    for (value, sigma), truth in zip(walk["known"], truths.values(), strict=True):
        assert abs(value - truth) < 3.5 * sigma
    assert walk["next_sigma"] > walk["known"][-1][1]
    assert report["joint"] == []
    assert "Ageing" in (tmp_path / "out" / "report.html").read_text()
    record = tmp_path / "out" / "records" / "second-seed21"
    settings = ["--settings", str(tmp_path / "out" / "next_flight.toml"), "--parameters", emittance]
    assert main(["estimate", str(record), *settings, "--out", str(tmp_path / "fit")]) == 0
