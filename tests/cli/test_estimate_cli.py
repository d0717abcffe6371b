"""`estimate` as a user has it: from a flight's records to values with bounds, and on into the tables, by commands."""

from __future__ import annotations

import math
import shutil
from contextlib import chdir
from pathlib import Path
from typing import Any

import matplotlib.image as mpl_image
import numpy as np
import pytest

import sim_heating as sh
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.files import read_json
from sim_heating.cli import main
from sim_heating.estimation.report.estimate_file import read_estimate
from sim_heating.estimation.report.report import estimate_contents
from tests.support.browser import assert_fits, needs_browser
from tests.support.gliding import gliding
from tests.support.json_output import run_json
from tests.support.paths import ROOT

PRACTICE = ROOT / "scenarios" / "records" / "practice" / "p06"
PLUG, POD = "V09T9527", "V07T9975"
TRUTH = {"ratio.scale": 0.15, "ratio.d_alpha": 0.0006}
SKEW_S = 0.6
CONTRACT = {
    "format", "records", "converged", "iterations", "reference_condition", "parameters", "not_estimated",
    "correlation", "noise_floor_K", "fit", "holdout",
}  # fmt: skip

POPU = """
[[trajectory.manoeuvre]]
kind = "popu"
at_time_s = 90.0
[measurements]
seed = {seed}
clock_skew_s = {skew_s}
[truth]
parameters = {{ "ratio.scale" = 0.15, "ratio.d_alpha" = 0.0006 }}
"""
FIRST = gliding(160.0, PLUG, altitude_m=74000.0, vehicle="orbiter") + POPU.format(seed=1, skew_s=0.0)
OTHERS = {
    "second": gliding(160.0, PLUG, altitude_m=70000.0, velocity_m_s=6000.0, vehicle="orbiter")
    + POPU.format(seed=2, skew_s=SKEW_S),
    "both": gliding(160.0, PLUG, POD, altitude_m=74000.0, vehicle="orbiter") + POPU.format(seed=3, skew_s=0.0),
}


def synthesize(home: Path, name: str, text: str) -> None:
    (home / f"{name}.toml").write_text(text)
    assert main(["synthesize", str(home / f"{name}.toml"), "--out", str(home / name)]) == 0


@pytest.fixture(scope="module")
def flown_records(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A synthesized flight, `first`, whose truth differs from the Orbiter's tables."""
    home = tmp_path_factory.mktemp("flown_records")
    synthesize(home, "first", FIRST)
    return home


@pytest.fixture(scope="module")
def others(flown_records: Path) -> None:
    """Two more of them: a second flight, and one with records of two points."""
    for name, text in OTHERS.items():
        synthesize(flown_records, name, text)


@pytest.fixture(scope="module")
def fit_of_first(flown_records: Path) -> Path:
    """The estimate of what was altered in the truth, from the first flight."""
    with chdir(flown_records):
        estimate("first", "--parameters", ",".join(TRUTH), out=Path("fit_of_first"))
    return flown_records / "fit_of_first"


@pytest.fixture
def workdir(flown_records: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(flown_records)
    return flown_records


def estimate(*arguments: str, out: Path) -> dict[str, Any]:
    assert main(["estimate", *arguments, "--out", str(out)]) == 0
    return read_json(out / "estimate.json")


def error_in_sigma(parameter: dict[str, Any], true: float) -> float:
    """Error over sigma."""
    return abs(parameter["value"] - true) / parameter["sigma"]


@pytest.mark.thorough
@pytest.mark.usefixtures("others")
def test_from_a_scenario_to_a_better_prediction_by_commands_alone(
    workdir: Path, fit_of_first: Path, tmp_path: Path
) -> None:
    found = read_json(fit_of_first / "estimate.json")
    assert main(["update-tables", str(fit_of_first), "--vehicle", "orbiter", "--out", str(tmp_path)]) == 0
    errors = {}
    for vehicle in ("orbiter", str(tmp_path / "orbiter")):
        place = tmp_path / "predicted" / Path(vehicle).parent.name
        assert main(["predict", "second", "--vehicle", vehicle, "--out", str(place)]) == 0
        errors[vehicle] = read_json(place / "summary.json")["fit"]["rmse_K"]
    assert found["fit"]["rmse_K"] == pytest.approx(found["noise_floor_K"], rel=0.15)
    before, after = errors.values()
    assert after < 0.35 * before  # of another flight, whose clock lags by 0.6 s and whose alpha mean differs


def test_estimate_json_holds_what_the_contract_names(
    workdir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    printed = run_json(capsys, "estimate", "first", "--reference", "alpha_deg=40", "--out", str(tmp_path / "fit"))
    found = read_json(tmp_path / "fit" / "estimate.json")
    assert printed["results"] == found
    assert set(found) >= CONTRACT
    assert found["format"] == "estimate/1"
    assert found["records"] == ["first"]
    assert found["converged"] is True
    assert found["iterations"] >= 1
    assert set(found["reference_condition"]) == set(RATIO_VARIABLES)
    assert found["reference_condition"]["alpha_deg"] == 40.0
    for name, parameter in found["parameters"].items():
        assert set(parameter) >= {"value", "sigma", "unit"}
        assert parameter["unit"] == ("1" if name in ("ratio.scale", "ratio.d_logre") else "1/deg")
    names = list(found["parameters"])
    pairs = {f"{a}|{b}" for i, a in enumerate(names) for b in names[i + 1 :]}
    assert set(found["correlation"]) == pairs
    assert all(isinstance(why, str) for why in found["not_estimated"].values())
    five = {"ratio.scale", *(f"ratio.d_{s}" for s in ("alpha", "beta", "logre", "elevon", "bodyflap"))}
    assert set(found["parameters"]) | set(found["not_estimated"]) == five
    assert set(found["fit"]) == {"rmse_K", "max_abs_K", "n"}
    assert found["holdout"] is None
    assert (
        read_estimate(tmp_path / "fit").parameters["ratio.scale"].value == found["parameters"]["ratio.scale"]["value"]
    )


@pytest.mark.thorough
def test_progress_is_reported_by_iteration(workdir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = estimate("first", "--parameters", "ratio.scale", out=tmp_path / "fit")
    printed = capsys.readouterr()
    for i in range(1, found["iterations"] + 1):
        assert f"iteration {i} " in printed.err
    assert "Noise floor" in printed.out


@pytest.mark.thorough
@pytest.mark.usefixtures("others")
def test_two_flights_of_one_point_share_its_ratio_and_keep_their_clocks(
    workdir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a, b, pod = (tmp_path / place for place in (f"A/{PLUG}", f"B/{PLUG}", f"A/{POD}"))
    for flown, record in (("first", a), ("second", b), (f"both/{POD}", pod)):
        shutil.copytree(workdir / flown, record)
    names, fit = ",".join([*TRUTH, "clock.skew"]), tmp_path / "fit"
    found = estimate(str(a), str(b), str(pod), "--parameters", names, out=fit)
    clocks = [f"clock.skew@{owner}" for owner in (f"first/{PLUG}", f"second/{PLUG}", POD)]
    assert set(found["parameters"]) == {*(f"{n}@{p}" for n in TRUTH for p in (PLUG, POD)), *clocks}
    for clock, skew_s in zip(clocks, (0.0, SKEW_S, 0.0), strict=True):
        assert error_in_sigma(found["parameters"][clock], skew_s) < 3.0
    for folder in (f"first/{PLUG}", f"second/{PLUG}", POD):
        assert {p.name for p in (fit / folder).iterdir()} == {"temperatures.csv", "fit.png", "ratio.png"}
    assert main(["predict", str(a), str(b), "--out", str(tmp_path / "predicted")]) == 0
    assert read_json(tmp_path / "predicted" / "second" / PLUG / "summary.json")["record"] == f"second/{PLUG}"
    capsys.readouterr()
    arguments = ["--vehicle", "orbiter", "--point", PLUG, "--dry-run", "--check", "second"]
    assert main(["update-tables", str(fit), *arguments]) == 0
    printed = capsys.readouterr().out
    assert all(name in printed for name in (f"first/{PLUG}", f"second/{PLUG}", " second "))


@pytest.mark.thorough
@pytest.mark.usefixtures("others")
def test_two_points_of_one_flight_have_a_ratio_each(workdir: Path) -> None:
    records = [f"both/{PLUG}", f"both/{POD}"]
    found = estimate_contents(sh.estimate(records, list(TRUTH)))
    assert set(found.parameters) == {f"{n}@{p}" for n in TRUTH for p in (PLUG, POD)}
    assert found.records == records
    alone = estimate_contents(sh.estimate(records[1], list(TRUTH)))
    for name in TRUTH:  # joint and own mean condition are of one flight
        joint, single = found.parameters[f"{name}@{POD}"], alone.parameters[name]
        assert joint.value == pytest.approx(single.value, abs=0.05 * single.sigma)


@pytest.mark.thorough
def test_a_segment_can_be_given_without_changing_the_record(workdir: Path, tmp_path: Path) -> None:
    whole = estimate("first", "--parameters", "ratio.scale", out=tmp_path / "whole")
    short = estimate("first", "--parameters", "ratio.scale", "--fit", "80,130", out=tmp_path / "short")
    assert short["segments"] == [[[80.0, 130.0]]]
    assert short["fit"]["n"] == 51 * 5
    assert whole["fit"]["n"] == 161 * 5
    assert short["parameters"]["ratio.scale"]["sigma"] > whole["parameters"]["ratio.scale"]["sigma"]
    twice = estimate("first", "--parameters", "ratio.scale", "--fit", "80,99", "--fit", "111,130", out=tmp_path / "two")
    assert twice["fit"]["n"] == 40 * 5


@pytest.mark.thorough
@pytest.mark.usefixtures("others")
def test_each_flight_has_its_own_segment_and_start(workdir: Path, tmp_path: Path) -> None:
    own = ["--fit", "80,130@first", "--fit", "60,120", "--start", "circuit:70@second"]
    found = estimate("first", "second", "--parameters", "ratio.scale", *own, out=tmp_path / "fit")
    assert found["segments"] == [[[80.0, 130.0]], [[60.0, 120.0]]]
    assert found["fit"]["n"] == (51 + 51) * 5  # of the second flight from 70 s on


@pytest.mark.thorough
def test_a_start_without_a_time_is_that_of_the_fit_segment(workdir: Path, tmp_path: Path) -> None:
    own = ["--parameters", "ratio.scale", "--fit", "80,130"]
    found, at = (
        estimate("first", *own, "--start", start, out=tmp_path / name)
        for start, name in (("filter", "plain"), ("filter:80", "at"))
    )
    assert found["parameters"] == at["parameters"]


@pytest.mark.parametrize(
    ("options", "hint"),
    [
        (["--fit", "130,80"], "the start before the end"),
        (["--fit", "80"], "write --fit 640,760"),
        (["--fit", "500,600"], "no sample of a used sensor lies in the fit segments"),
        (["--parameters", "ratio.sclae"], "ratio.scale"),
        (["--reference", "alpha=40"], "did you mean `alpha_deg`"),
        (["--start", "circut:80"], "did you mean `circuit`"),
        (["--start", "lost"], "lost needs the time in s at which the readings come back; write lost:650"),
        (["--start", "filter:soon"], "`soon` is not a time in s; write filter:650"),
    ],
)
def test_invalid_options_are_refused_in_one_line_and_leave_no_files(
    options: list[str], hint: str, workdir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["estimate", "first", *options, "--out", str(tmp_path / "fit")]) == 2
    errors = capsys.readouterr().err
    assert hint in errors
    assert "Traceback" not in errors
    assert not (tmp_path / "fit").exists()


SETTINGS = """
parameters = ["ratio.scale", "clock.skew"]
fit = [[0.0, 160.0]]
reference = { beta_deg = 0.01 }
[fix]
ratio.d_alpha = 0.0
[prior]
clock.skew = [0.0, 0.5]
[bound]
ratio.scale = [0.0, 1.0]
"""


@pytest.mark.thorough
@pytest.mark.usefixtures("others")
def test_fixed_values_and_priors_come_from_file_and_command_line(
    workdir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "fit.toml").write_text(SETTINGS)
    found = estimate(
        "second", "--settings", str(tmp_path / "fit.toml"), "--fix", "ratio.d_alpha=0.0006", out=tmp_path / "fit"
    )
    assert found["fixed"] == {"ratio.d_alpha": {"value": 0.0006, "unit": "1/deg"}}
    assert found["segments"] == [[[0.0, 160.0]]]
    assert found["reference_condition"]["beta_deg"] == 0.01
    scale, skew = found["parameters"]["ratio.scale"], found["parameters"]["clock.skew"]
    assert (scale["lower"], scale["upper"], skew["prior_mean"], skew["prior_sigma"]) == (0.0, 1.0, 0.0, 0.5)
    assert found["fit"]["rmse_K"] == pytest.approx(found["noise_floor_K"], rel=0.1)
    assert error_in_sigma(skew, SKEW_S) < 3.0
    printed = capsys.readouterr().out
    assert "ratio.d_alpha: fixed at 0.0006 1/deg" in printed
    assert "0 +- 0.5" in printed
    assert main(["update-tables", str(tmp_path / "fit"), "--vehicle", "orbiter", "--out", str(tmp_path)]) == 2
    assert "[fixed]: ratio.d_alpha was fixed at 0.0006" in capsys.readouterr().err


@pytest.mark.thorough
@pytest.mark.usefixtures("others")
def test_a_clock_that_is_known_is_fixed(workdir: Path) -> None:
    found = sh.estimate("second", list(TRUTH), fixed={"clock.skew": SKEW_S})
    assert found.after[0].segment_errors()["fit"]["rmse_K"] == pytest.approx(1.36, rel=0.1)  # the noise floor
    assert all(abs(found.parameters[n][0] - true) < 3.0 * found.parameters[n][1] for n, true in TRUTH.items())


@pytest.mark.thorough
@pytest.mark.usefixtures("others")
def test_one_coating_of_two_points_is_tied(workdir: Path) -> None:
    coating, records = "stack.coating.thickness_factor", [f"both/{PLUG}", f"both/{POD}"]
    names, flat = ["ratio.scale", "ratio.d_alpha", coating], {coating: (1.0, math.inf)}
    tie = (f"{coating}@{PLUG}", f"{coating}@{POD}")
    own = sh.estimate(records, names, priors=flat)
    tied = estimate_contents(sh.estimate(records, names, priors=flat, ties=[tie]))
    assert tied.ties == dict.fromkeys(tie, tie[0])
    assert tie[1] not in tied.parameters
    common = tied.parameters[tie[0]]
    assert common.white_sigma < min(own.fit.sigma[own.labels.index(name)] for name in tie)
    assert abs(common.value - 1.0) < 3.0 * common.sigma


@pytest.mark.thorough
def test_a_record_without_a_vehicle_is_fitted(tmp_path: Path) -> None:
    external = tmp_path / "external"
    shutil.copytree(PRACTICE, external)
    lines = (external / "record.toml").read_text().splitlines()
    without = [line for line in lines if not line.startswith("vehicle")]
    assert len(without) == len(lines) - 1
    (external / "record.toml").write_text("\n".join(without) + "\n")
    found = estimate(str(external), out=tmp_path / "fit")
    assert found["converged"]
    assert found["holdout"]["rmse_K"] < 1.1 * found["noise_floor_K"]
    assert found["parameters"]["ratio.d_alpha"]["sigma"] > 0.0


@pytest.mark.thorough
def test_pictures_are_drawn_with_something_in_them(fit_of_first: Path) -> None:
    for name in ("fit.png", "ratio.png"):
        picture = mpl_image.imread(fit_of_first / name)
        colours = np.unique((picture[..., :3] * 255).astype(int).reshape(-1, 3), axis=0)
        assert len(colours) > 50
        assert math.prod(picture.shape[:2]) > 200_000
    page = (fit_of_first / "report.html").read_text()
    assert page.count("<figure") == 2  # the chart of the record, in which its picture is, and the heating ratio
    assert all(f">{name}<" in page for name in TRUTH)


@needs_browser
def test_the_page_fits_a_screen_a_telephone_and_paper(fit_of_first: Path) -> None:
    assert_fits(fit_of_first / "report.html")


@pytest.mark.thorough
def test_a_fit_of_the_stack_alone_draws_no_ratio(workdir: Path, tmp_path: Path) -> None:
    estimate("first", "--parameters", "stack.coating.thickness_factor", out=tmp_path / "fit")
    assert (tmp_path / "fit" / "fit.png").exists()
    assert not (tmp_path / "fit" / "ratio.png").exists()


def test_a_layer_by_its_own_name_is_estimated_as_by_its_role(
    workdir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own, role = "stack.li900.conductivity_factor", "stack.rsi.conductivity_factor"
    a, b = (sh.estimate("first", ["ratio.scale", n]).parameters for n in (own, role))
    assert (a["ratio.scale"], a[own]) == (b["ratio.scale"], b[role])
    assert main(["estimate", "first", "--parameters", f"{own},{role}", "--out", str(tmp_path / "both")]) == 2
    assert f"`{own}` and `{role}` are one parameter of the same layer; name it once" in capsys.readouterr().err
