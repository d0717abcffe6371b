"""`sim-heating new vehicle`, `scenario`, `study` and `effect`: what they write validates, and works where it is for."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

import sim_heating as sh
from sim_heating.base.errors import InputError
from sim_heating.cli import cli
from sim_heating.inputs.record import write_record
from sim_heating.planning.study import load_study
from tests.support.paths import ROOT

ENTRY, STUDIES = ROOT / "scenarios" / "entry_3dof.toml", ROOT / "scenarios" / "studies"
POD = (
    "--length", "2m", "--mass", "800kg", "--area", "3m2", "--nose-radius", "1.2m",
    "--point", "NOSE=RCG 0.4 mm / LI-900 60 mm / al2024 3 mm", "--point", "SIDE=inconel625 2 mm", "--place", "SIDE=0.5",
)  # fmt: skip
GLIDER = (
    "--length", "12m", "--mass", "8000kg", "--area", "40m2", "--nose-radius", "0.4m", "--alpha", "35", "--surfaces",
    "--lift-to-drag", "1.1", "--drag-coefficient", "0.6", "--point", "BELLY=RCG 0.4 mm / LI-900 50 mm / al2024 3 mm",
)  # fmt: skip


@pytest.fixture(autouse=True)
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [str(a) for a in arguments])


def made(*arguments: object) -> Result:
    result = run("new", *arguments)
    assert result.exit_code == 0, result.exception
    return result


def test_a_new_vehicle_flies_and_names_what_was_estimated() -> None:
    """A capsule without control surfaces: no file of it mentions an elevon."""
    shown = made("vehicle", *POD, "--out", "pod").output
    assert "NOSE: ratio 1, an estimate (--ratio)" in shown
    assert "good. vehicle pod: 2 control points" in run("validate", "pod").output
    texts = [path.read_text() for path in Path("pod").rglob("*.toml")]
    assert not [text for text in texts if "elevon" in text or "bodyflap" in text]
    assert sh.load_vehicle("pod").surfaces == ()

    made("scenario", "--vehicle", "pod", "--until-mach", "22", "--point", "SIDE", "--out", "flight")
    assert "good. scenario Entry of pod" in run("validate", "flight/scenario.toml").output
    listed = run("parameters", "flight/scenario.toml").output
    assert "ratio.d_alpha" in listed
    assert "elevon" not in listed
    assert "bodyflap" not in listed
    flown = sh.run("flight/scenario.toml")
    surface_K = flown.to_xarray()["surface_K"].to_numpy()
    assert 400.0 < np.nanmax(surface_K) < 1500.0


def test_a_glider_with_surfaces_has_them_in_its_tables_and_is_trimmed() -> None:
    made("vehicle", *GLIDER, "--out", "glider")
    vehicle = sh.load_vehicle("glider")
    assert vehicle.surfaces == ("elevon_deg", "bodyflap_deg")
    assert "shipped vehicle `orbiter`" in Path("glider/guidance.toml").read_text()
    made("scenario", "--vehicle", "glider", "--manoeuvre", "--out", "flight")
    assert "gamma_deg = -1.2" in Path("flight/scenario.toml").read_text()


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("aero/longitudinal.csv", ",Cm", ",CM", "longitudinal.csv: there is no column `Cm`"),
        ("aero/longitudinal.csv", "deg,CN", "deg,CL", "longitudinal.csv: there is no column `CN`"),
        ("aero/aero.toml", "mass_kg = 800.0", "mass_kg = 0.8", "`mass_kg`: 0.8 kg is"),
        ("guidance.toml", "drag_m_s2", "drag_ms2", "unknown key `drag_ms2`"),
    ],
)
def test_a_vehicle_is_good_only_where_it_can_be_flown(file: str, old: str, new: str, message: str) -> None:
    """Its aerodynamics and guidance are read with it, and a file of them named alone is checked with its vehicle."""
    made("vehicle", *POD, "--out", "pod")
    text = Path("pod", file).read_text()
    assert old in text
    Path("pod", file).write_text(text.replace(old, new, 1))
    for named in ("pod", f"pod/{file}"):
        assert message in str(run("validate", named).exception)
    Path("pod", file).write_text(text)
    assert "good. vehicle pod" in run("validate", f"pod/{file}").output


@pytest.mark.thorough
def test_an_estimate_of_a_capsule_does_not_speak_of_its_elevon_and_a_margin_that_is_not_final_says_so() -> None:
    """Lines on surfaces that the vehicle lacks, and +160 K for a bondline that the heat has not reached yet."""
    made("vehicle", *POD, "--out", "pod")
    made("scenario", "--vehicle", "pod", "--until-mach", "22", "--point", "NOSE", "--out", "flight")
    flown = " ".join(run("run", "flight/scenario.toml", "--out", "flown").output.split())
    assert "The bondline of NOSE still rises at the end, and its margin is that so far" in flown
    assert "Wrote flown: report.html, " in flown
    assert "still rises at the end" in Path("flown/report.html").read_text()

    run("synthesize", "flight/scenario.toml", "--out", "records")
    fitted = run("estimate", "records" if Path("records/record.toml").exists() else "records/NOSE", "--out", "fit")
    assert "ratio.scale" in fitted.output
    assert "ratio.d_alpha: not estimated" in fitted.output
    done = re.search(r"iteration 1 \((\d+) %", fitted.output)  # 10 % of it meant minutes for a fit of seconds
    assert done is not None
    assert int(done[1]) > 25
    assert "elevon" not in fitted.output
    assert "bodyflap" not in fitted.output


CAPSULE_TABLE = "mach,alpha_deg,CN,CA,Cm\n" + "".join(
    f"{mach},{alpha},{0.005 * alpha},1.4,0\n" for mach in (1.5, 25) for alpha in (-30, 0, 15)
)
"""Heat shield forward: axial force alone but for a little; its lift is up at negative angles of attack."""


def test_an_angle_of_attack_outside_the_tables_is_refused_and_a_lift_that_is_down_is_told() -> None:
    """Both were flown without a word: coefficients held at the end of the table, and a capsule that dives."""
    made("vehicle", *POD, "--alpha", "22", "--out", "pod")
    made("scenario", "--vehicle", "pod", "--until-mach", "22", "--point", "SIDE", "--out", "flight")
    Path("pod/aero/longitudinal.csv").write_text(CAPSULE_TABLE)
    for refused in (run("validate", "pod"), run("run", "flight/scenario.toml", "--out", "flown")):
        assert isinstance(refused.exception, InputError)
        assert "commands 22 deg at Mach 1, and longitudinal.csv of aero ends at -30 and 15" in str(refused.exception)

    guidance = Path("pod/guidance.toml").read_text()
    down = guidance.replace("[1.0, 22.0], [30.0, 22.0]", "[1.0, 15.0], [30.0, 15.0]")
    Path("pod/guidance.toml").write_text(down)
    with pytest.warns(UserWarning, match=r"lift is down at Mach 30 and 15 deg \(CL -0\.\d+.*negative angles of attack"):
        run("validate", "pod")

    up = down.replace("[1.0, 15.0], [30.0, 15.0]", "[1.0, -15.0], [30.0, -15.0]").replace(
        "alpha_limits_deg = [0.0", "alpha_limits_deg = [-30.0"
    )
    Path("pod/guidance.toml").write_text(up)
    assert "good. vehicle pod" in run("validate", "pod").output


def test_a_trajectory_and_a_record_of_a_vehicle_without_surfaces_need_no_deflections() -> None:
    made("vehicle", *POD, "--out", "pod")
    t = np.arange(0.0, 100.0, 10.0)
    rows = [f"{x:g},{70000 - 100 * x:g},{6000 - 10 * x:g},20,0,{8e-5 * np.exp(x / 70.0):.4g}" for x in t]
    head = "time_s,altitude_m,velocity_m_s,alpha_deg,beta_deg,rho_kg_m3"
    Path("track.csv").write_text("\n".join([head, *rows]))
    made("scenario", "--vehicle", "pod", "--trajectory", "track.csv", "--point", "NOSE", "--out", "flight")
    record = sh.synthesize("flight/scenario.toml")["NOSE"]
    assert not record.conditions["elevon_deg"].any()

    write_record(record, "record")
    conditions = np.genfromtxt("record/conditions.csv", delimiter=",", names=True)
    kept = [name for name in conditions.dtype.names if name not in ("elevon_deg", "bodyflap_deg")]
    rows = [",".join(f"{row[name]:.12g}" for name in kept) for row in conditions]
    Path("record/conditions.csv").write_text("\n".join([",".join(kept), *rows]))
    assert not sh.load_record("record").conditions["bodyflap_deg"].any()


def test_frames_of_a_host_without_control_surfaces_need_no_deflections() -> None:
    frame = {"time_s": 0.0, "altitude_m": 74e3, "velocity_m_s": 6800.0, "alpha_deg": 20.0, "beta_deg": 0.0}
    frame["rho_kg_m3"] = 4.6e-5
    plugin = sh.HeatingPlugin(sh.load_vehicle("capsule"), ["FACE"])
    plugin.reset(frame)
    plugin.step(frame | {"time_s": 0.5})
    assert plugin.surface_K["FACE"] > 293.0
    with pytest.raises(InputError, match="`elevon_deg` is missing"):
        sh.HeatingPlugin(sh.load_vehicle("orbiter"), ["V09T9527"]).reset(frame)


def test_a_trajectory_of_a_vehicle_with_surfaces_needs_their_deflections() -> None:
    made("vehicle", *GLIDER, "--out", "glider")
    Path("track.csv").write_text(
        "time_s,altitude_m,velocity_m_s,alpha_deg,beta_deg,rho_kg_m3\n0,70000,6000,35,0,8e-5\n10,69000,5900,35,0,9e-5\n"
    )
    refused = run("new", "scenario", "--vehicle", "glider", "--trajectory", "track.csv", "--out", "flight")
    said = str(refused.exception)
    assert "needs elevon_deg, bodyflap_deg; give --field elevon_deg=NAME --field bodyflap_deg=NAME" in said
    assert not Path("flight").exists()


@pytest.mark.sample(1)
@pytest.mark.parametrize("kind", ["dispersion", "envelope", "optimal"])
def test_a_new_study_of_a_new_scenario_validates(kind: str) -> None:
    made("scenario", "--vehicle", "capsule", "--point", "FACE", "--out", "flight")
    made("study", kind, "--scenario", "flight/scenario.toml", "--out", "study")
    assert "study/study.toml: good" in run("validate", "study/study.toml").output
    asked = load_study("study/study.toml")
    optimal = asked.optimal()
    assert [asked.declared.dispersion, asked.declared.envelope, optimal].count(None) == 2
    if optimal is not None:
        assert [p.point.name for p in optimal.points] == ["FACE"]
    if kind == "dispersion":
        made("study", kind, "--scenario", "flight/scenario.toml", "--flights", "256", "--out", "study")  # its own file
        Path("study/study.toml").write_text("# edited\n")
        edited = run("new", "study", kind, "--scenario", "flight/scenario.toml", "--out", "study")
        assert "was changed since" in str(edited.exception)


def test_a_study_that_does_not_work_is_not_written(tmp_path: Path) -> None:
    flown = ROOT / "scenarios" / "popu_mach20.toml"
    said = str(run("new", "study", "dispersion", "--scenario", str(flown), "--out", str(tmp_path / "study")).exception)
    assert "study.toml, [dispersion], input 1: trajectory: source" in said
    assert not (tmp_path / "study").exists()


@pytest.mark.thorough
def test_the_shipped_entry_makes_a_study_of_an_optimal_entry_that_plan_solves() -> None:
    """One point that its flight does not heat to a limit. All four points of the scenario: `python -m benchmarks
    optimal`."""
    pytest.importorskip("casadi", reason="optimal entries need CasADi: pip install 'sim-heating[plan]'")
    made("study", "optimal", "--scenario", ENTRY, "--point", "V09T9527", "--out", "study")
    optimal, flown = load_study("study/study.toml").optimal(), sh.load_scenario(ENTRY).declared.trajectory
    assert optimal is not None
    assert flown.initial is not None
    assert optimal.declared.initial == flown.initial.model_copy(update={"bank_deg": 0.0})
    planned = run("plan", "study/study.toml", "--out", "results")
    assert planned.exit_code == 0, planned.exception
    found = json.loads(Path("results/study.json").read_text())["optimal"]
    assert found["status"].endswith("; none is active")
    assert "kept: V09T9527 surface" in found["status"]
    assert {p["name"] for p in found["flight_limits"]} == {
        "dynamic pressure",
        "normal load",
        "rate of alpha",
        "rate of bank",
    }
    assert found["cross_range_deg"] > 20.0


@pytest.mark.thorough
def test_a_limit_that_the_scenarios_own_flight_exceeds_is_raised_and_said_so() -> None:
    shown = made("study", "optimal", "--scenario", ENTRY, "--point", "V07T9975", "--out", "study").output
    own = sh.load_vehicle("orbiter").control_point("V07T9975").limits
    optimal = load_study("study/study.toml").optimal()
    assert optimal is not None
    peak = float(sh.run(ENTRY).histories(["V07T9975"])[0].surface_K.max())
    assert own.surface_K < peak < optimal.points[0].surface_K <= peak + 12.0
    assert f"the scenario's flight reaches {peak:.0f} K, the vehicle's own limit is {own.surface_K:.0f} K" in shown
    kept = made("study", "optimal", "--scenario", ENTRY, "--point", "V09T9527", "--out", "other").output
    assert "own limit" not in kept


@pytest.mark.thorough
def test_new_effects_are_found_checked_and_flown() -> None:
    """The checks run in a process of its own, as a person runs them: the folder of effects is read once."""
    for mode, variable in (("multiply", "mach"), ("add", "alpha_deg"), ("emittance", "wall_K")):
        made("effect", f"{mode}-bell", "--mode", mode, "--variable", variable, "--out", "effects")
    program = (
        "import sys, pytest; from sim_heating.cli import main;"
        "status = main(['validate', 'effects/multiply_bell.toml', 'effects/emittance_bell.toml']);"
        "sys.exit(status or pytest.main(['-q', '-p', 'no:cacheprovider', 'effects/checks']))"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT), "SIM_HEATING_EFFECTS": "effects"}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "good. scenario Entry with emittance-bell" in done.stdout
    assert "12 passed" in done.stdout


@pytest.mark.thorough
@pytest.mark.parametrize("variable", ["alpha_deg", "beta_deg", "elevon_deg", "bodyflap_deg"])
def test_the_practice_flight_of_a_new_effect_moves_its_variable(variable: str) -> None:
    """Within half a minute from the effect's centre to where it is hardly there: nothing else is as quick."""
    made("effect", "my-bell", "--variable", variable, "--out", "effects")
    text = Path("effects/my_bell.toml").read_text()
    without, truth = text.split("[[truth.effect]]")  # the folder of effects is read once a process
    bell = tomllib.loads(truth.partition("\n")[2])["parameters"]
    Path("flight.toml").write_text(without)
    flown = sh.synthesize("flight.toml")["WING_LE"].conditions
    from_centre = np.abs(flown[variable] - bell["centre"]) / bell["width"]
    there = flown["time_s"][from_centre < 0.5]
    soon = from_centre[(flown["time_s"] > there[0] - 30.0) & (flown["time_s"] < there[0] + 30.0)]
    assert soon.max() > 1.2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("vehicle", *POD[:8], "--point", "NOSE", "--out", "x"), "--point NOSE: write --point NOSE="),
        (("vehicle", *POD[:-2], "--out", "x"), "--place: is missing for SIDE"),
        (("vehicle", *POD[:8], "--point", "A=al2024 3 mm", "--out", "x"), "has no emittance"),
        (("vehicle", *POD, "--ratio", "NOZE=1", "--out", "x"), "there is no --point NOZE"),
        (("vehicle", *POD[:-2], "--place", "SIDE=2", "--out", "x"), "write a number from 0 to 1"),
        (("scenario", "--vehicle", "capsul", "--out", "x"), "did you mean `capsule`?"),
        (("scenario", "--vehicle", "capsule", "--point", "FAC", "--out", "x"), "did you mean `FACE`?"),
        (("scenario", "--vehicle", "capsule", "--speed", "7 km", "--out", "x"), "`km` is not a unit"),
        (("study", "envelope", "--scenario", "none.toml", "--out", "x"), "there is no such file"),
        (("study", "optimal", "--scenario", STUDIES / "optimal_entry.toml", "--out", "x"), "optimal entry by itself"),
        (("study", "optimal", "--scenario", STUDIES / "small_envelope.toml", "--out", "x"), "for `sim-heating plan`"),
        (("study", "optimal", "--scenario", ENTRY, "--point", "BODYFLAPS", "--out", "x"), "did you mean `BODYFLAP`?"),
        (("study", "dispersion", "--scenario", "none.toml", "--flights", "100", "--out", "x"), "give 64 or 128"),
        (("effect", "Shock", "--out", "x"), "write a name of small letters"),
        (("effect", "transition", "--out", "x"), "there is an effect of this name already"),
        (("effect", "my-shock", "--variable", "macht", "--out", "x"), "did you mean `mach`?"),
        (("effect", "my-flap", "--variable", "bodyflap_deg", "--vehicle", "capsule", "--point", "FACE", "--out", "x"),
         "capsule has no such control surface"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_refused_in_one_line_and_nothing_is_written(arguments: tuple[str, ...], message: str) -> None:
    result = run("new", *arguments)
    assert isinstance(result.exception, InputError), result.output
    assert message in str(result.exception)
    assert "\n" not in str(result.exception)
    assert not Path("x").exists()
