"""What an estimate says of records and requests that it cannot use, and what it still estimates."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files import read_csv_columns, read_json, write_csv
from sim_heating.base.parameters import MODEL, Parameter
from sim_heating.cli import main
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.inference import newton
from sim_heating.simulation.predict import predict
from tests.support.walls import PRACTICE, practice_record

Change = Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]


def damaged(home: Path, file: str, change: Change) -> Path:
    """A copy of a practice record with one of its files changed."""
    shutil.copytree(PRACTICE / "p06", home / "p06")
    path = home / "p06" / file
    names = path.read_text().splitlines()[0].split(",")
    columns = read_csv_columns(path, names, allow_empty=[n for n in names if n.startswith("LS_")])
    write_csv(path, change({name: np.array(columns[name]) for name in names}))
    return home / "p06"


@pytest.mark.parametrize("command", [predict, partial(estimate, parameters=["ratio.scale"])])
def test_a_march_that_fails_is_told_with_its_record(command: Callable[[object], object]) -> None:
    """Of a table that no file may hold: a flow that cools the wall by three times what is to heat it."""
    record, _ = practice_record("p06")
    record = replace(record, ratio_table=replace(record.ratio_table, ratio=-3.0 * record.ratio_table.ratio))
    with pytest.raises(RunError, match=r"records/practice/p06: LS: the thermal step did not converge"):
        command(record if command is predict else [record])


def run_estimate(capsys, *arguments: object) -> tuple[int, str]:
    """Exit status of `estimate` and what it printed, on one line."""
    status = main(["estimate", *map(str, arguments)])
    captured = capsys.readouterr()
    return status, " ".join((captured.out + captured.err).split())


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--parameters", "ratio.scal"], "unknown parameter `ratio.scal`; did you mean `ratio.scale`"),
        (["--parameters", "sensor.LS_surfac.bias"], "unknown or unused sensor `LS_surfac`; did you mean `LS_surface`"),
        (["--parameters", "sensor.LS_surface.bais"], "unknown sensor parameter `bais`; did you mean `bias`"),
        (["--parameters", "effect.transitoin.factor"], "unknown effect `transitoin`; did you mean `transition`"),
        (["--parameters", "ratio.scale,ratio.scale"], "`ratio.scale` is repeated"),
        (["--parameters", ","], "holds no name"),
        (["--reference", "alpha_deg"], "alpha_deg: `` is not a number; write alpha_deg=40"),
        (["--reference", "alpha=40"], "`alpha` is not a ratio variable; did you mean `alpha_deg`"),
        (["--reference", "alpha_deg=nan"], "alpha_deg: nan is not a finite number"),
        (["--reference", "alpha_deg=1e9"], "alpha_deg: 1e+09 is not an angle of attack in degrees (-180 to 180)"),
        (["--start", "profil:600"], "`profil` is not a way to start; did you mean `profile`"),
        (["--start", "profile:soon"], "`soon` is not a time in s"),
        (["--start", "profile:9999"], "a start at 9999 s lies outside the conditions (0 to 1453 s)"),
        (["--start", "filter:-5"], "--start filter:-5: p06: a start at -5 s lies outside the conditions (0 to 1453 s)"),
        (["--start", "circuit:1e9"], "--start circuit:1e9: p06: a start at 1e+09 s lies outside the conditions"),
        (["--reference", "alpha_deg=40,alpha_deg=41"], "alpha_deg is given twice"),
        (["--fit", "600,inf"], "--fit: 600,inf: give two finite times in s"),
        (["--fit", "600,600.5"], "p06: readings at 1 time(s) in the fit segments, too few to estimate from"),
        (["--process-noise", "1e200"], "1e200 is not within 0 to 10000"),
        (["--ratio-noise", "1e200,30"], "1e200 is not within 0 to 10000"),
        (["--segments", "-3"], "segments of -3 s; give a length in s above 0"),
        (["--segments", "0.001"], "segments of 0.001 s are shorter than the 1 s between samples"),
        (["--segments", "5", "--fit", "5000,6000"], "the fit segments contain no recorded time"),
        (
            ["--segments", "5", "--start", "profile:600", "--fit", "700,800"],
            "the first reading after the start at 600 s is at 700 s, more than a segment of 5 s later",
        ),
        (["--fix", "ratio.d_alhpa=0"], "unknown parameter `ratio.d_alhpa`; did you mean `ratio.d_alpha`"),
        (["--fix", "ratio.d_alpha"], "--fix ratio.d_alpha: write --fix NAME=0.0013"),
        (["--fix", "stack.rsi.conductivity_factor=99"], "fixed at 99, outside its limits 0.001 to 10"),
        (
            ["--fix", "ratio.d_beta=0", "--parameters", "ratio.d_beta"],
            "ratio.d_beta: is fixed, and named to be estimat",
        ),
        (["--fix", "ratio.d_beta@p07=0"], "there is no control point `p07`; known: `LS`"),
        (["--prior", "clock.skew=0,1"], "`clock.skew`: is not estimated; name it among the parameters"),
        (["--prior", "ratio.scale=0,0"], "ratio.scale: prior 0 +- 0; give a sigma above 0"),
        (
            ["--prior", "ratio.scale=0.1,0.1", "--bound", "ratio.scale=0.5,1"],
            "exclude the mean of its prior, 0.1 +- 0.1",
        ),
        (["--bound", "ratio.scale=1,-1"], "ratio.scale: bounds 1 to -1; give the lower one first"),
        (["--tie", "ratio.scale"], "ratio.scale: ties one parameter only"),
        (["--tie", "ratio.scale=ratio.d_alpha"], "units differ: ratio.scale [1], ratio.d_alpha [1/deg]"),
        (["--tie", "ratio.scale="], "write --tie NAME=OTHER, two names or more"),
        (["--fit", "600,700@p07"], "`fit@p07`: there is no record, flight or control point `p07`; did you mean `p06`"),
        (["--start", "circuit:600", "--start", "circuit:610"], "--start: is given twice; leave one out"),
        (["--settings", "no.toml"], "no.toml: there is no such file"),
    ],
)
def test_invalid_request_is_answered_in_a_line(capsys, tmp_path, arguments, line):
    status, text = run_estimate(capsys, PRACTICE / "p06", "--out", tmp_path / "out", *arguments)
    assert (status, line in text) == (2, True), text
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("parameter = []", "fit.toml: unknown key `parameter`; did you mean `parameters`"),
        ("[prior]\nratio.scale = [0.0]", "[0.0] is not a pair; give two numbers"),
        ("[fix]\nratio.scale = true", "fit.toml"),
        ('parameters = ["ratio.scale"]\n[fix]\nratio.scale = 0.1', "fit.toml: ratio.scale: is fixed, and named"),
        ('parameters = ["ratio.scal"]', "fit.toml: "),
        ('start = "circus"', "fit.toml: "),
        ("fit = [[1e6, 2e6]]", "fit.toml: "),
    ],
)
def test_invalid_settings_are_answered_in_a_line(capsys, tmp_path, text, line):
    (tmp_path / "fit.toml").write_text(text)
    status, said = run_estimate(
        capsys, PRACTICE / "p06", "--settings", tmp_path / "fit.toml", "--out", tmp_path / "out"
    )
    assert (status, line in said) == (2, True), said


def test_two_records_of_one_flight_and_name_are_refused(capsys, tmp_path):
    status, text = run_estimate(capsys, PRACTICE / "p06", PRACTICE / "p06", "--out", tmp_path / "out")
    assert (status, "two records are named practice/p06; leave one out" in text) == (2, True)


def test_clocks_that_do_not_overlap_are_an_error(capsys, tmp_path):
    record = damaged(tmp_path, "thermocouples.csv", lambda c: c | {"time_s": c["time_s"] + 5000.0})
    status, text = run_estimate(capsys, record, "--out", tmp_path / "out")
    assert (status, "both files must use the same clock" in text) == (2, True)


def test_channel_without_any_reading_is_an_error(capsys, tmp_path):
    record = damaged(tmp_path, "thermocouples.csv", lambda c: c | {"LS_bond_K": np.full(len(c["time_s"]), np.nan)})
    status, text = run_estimate(capsys, record, "--out", tmp_path / "out")
    assert (status, "sensor LS_bond has no sample; set used = false or remove it" in text) == (2, True)


@pytest.mark.thorough
def test_stuck_sensor_is_not_used_and_the_rest_is_estimated(capsys, tmp_path):
    record = damaged(tmp_path, "thermocouples.csv", lambda c: c | {"LS_bond_K": np.full(len(c["time_s"]), 294.0)})
    status, text = run_estimate(capsys, record, "--parameters", "ratio.scale", "--out", tmp_path / "out")
    assert status == 0
    assert "sensor LS_bond: stuck at 294 K in all" in text
    found = json.loads((tmp_path / "out" / "estimate.json").read_text())
    assert any("stuck at" in line for line in found["warnings"])
    assert list(found["statistics"]["sensors"]) == ["LS_surface"]


def test_record_whose_sensors_are_all_stuck_is_refused():
    record = practice_record("p06")[0]
    columns = {k: v if k == "time_s" else np.full(len(v), 300.0) for k, v in record.thermocouples.items()}
    with pytest.raises(InputError, match="no sensor remains to estimate from"):
        estimate([replace(record, thermocouples=columns)], ["ratio.scale"])


@pytest.mark.thorough
def test_constant_alpha_omits_its_derivative_alone(capsys, tmp_path):
    record = damaged(tmp_path, "conditions.csv", lambda c: c | {"alpha_deg": np.full(len(c["time_s"]), 40.9)})
    names = "ratio.scale,ratio.d_alpha,ratio.d_logre"
    status, text = run_estimate(capsys, record, "--parameters", names, "--out", tmp_path / "out")
    assert (status, "ratio.d_alpha: not estimated, alpha_deg is constant" in text) == (0, True)
    found = json.loads((tmp_path / "out" / "estimate.json").read_text())
    assert set(found["parameters"]) == {"ratio.scale", "ratio.d_logre"}


def test_constant_alpha_and_nothing_else_to_estimate_is_an_error(capsys, tmp_path):
    record = damaged(tmp_path, "conditions.csv", lambda c: c | {"alpha_deg": np.full(len(c["time_s"]), 40.9)})
    status, text = run_estimate(capsys, record, "--parameters", "ratio.d_alpha", "--out", tmp_path / "out")
    assert (status, "nothing to estimate: alpha_deg is constant" in text) == (2, True)


def test_few_samples_estimate_what_they_identify_and_no_more():
    record = practice_record("p06")[0]
    present = np.isin(record.time_s, (620.0, 640.0, 705.0))
    columns = {k: v if k == "time_s" else np.where(present, v, np.nan) for k, v in record.thermocouples.items()}
    found = estimate([replace(record, thermocouples=columns)])
    assert found.labels[0] == "ratio.scale"
    assert len(found.labels) < 5
    assert all(reason for reason in found.not_estimated.values())
    assert np.all(np.isfinite(found.bounds.sigma))


@pytest.mark.thorough
def test_manoeuvre_outside_the_table_has_a_warning(capsys, tmp_path):
    shutil.copytree(PRACTICE / "p06", tmp_path / "p06")
    path = tmp_path / "p06" / "ratio_table.csv"
    source, head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([source, head, *(row for row in rows if float(row.split(",")[0]) <= 25.0)]) + "\n")
    status, text = run_estimate(capsys, tmp_path / "p06", "--parameters", "ratio.scale", "--out", tmp_path / "out")
    assert status == 0
    assert "alpha_deg is up to" in text
    assert "outside its ratio table over the fit segments" in text


@pytest.mark.parametrize(
    ("prior", "line"),
    [
        (replace(MODEL["ratio.scale"], sigma=0.0), "prior 0 +- 0; give a finite value and a sigma above 0"),
        (replace(MODEL["ratio.scale"], value=2.0, upper=1.0), "prior value 2 is outside its bounds -inf to 1"),
        (Parameter("ratio.scale", "1", 0.0, 1.0, 1.0, -1.0), "bounds 1 to -1; give the lower one first"),
    ],
)
def test_invalid_prior_is_refused(prior, line):
    with pytest.raises(InputError) as caught:
        estimate([practice_record("p06")[0]], ["ratio.scale"], priors={"ratio.scale": prior})
    assert line in str(caught.value)


def test_damaged_record_is_named_with_its_file(capsys, tmp_path):
    shutil.copytree(PRACTICE / "p06", tmp_path / "p06")
    (tmp_path / "p06" / "conditions.csv").unlink()
    status, text = run_estimate(capsys, tmp_path / "p06", "--out", tmp_path / "out")
    assert (status, "conditions.csv" in text) == (2, True)


@pytest.mark.thorough
def test_a_fit_that_ends_on_a_kink_has_converged_and_says_so(capsys, tmp_path):
    """An onset in angle of attack has a kink at every sample, and the flight holds one angle for long."""
    out = tmp_path / "out"
    onset = "effect.impingement-onset.alpha_onset_deg,effect.impingement-onset.slope,ratio.scale"
    status, text = run_estimate(capsys, PRACTICE.parent / "sts96_480", "--parameters", onset, "--out", out)
    assert status == 0
    assert "converged; the likelihood has a kink here" in " ".join(text.split())
    assert read_json(out / "estimate.json")["converged"] is True


@pytest.mark.thorough
def test_fit_that_does_not_converge_keeps_its_files_and_fails(capsys, tmp_path, monkeypatch):
    """A search that may take one step only."""
    monkeypatch.setattr(newton, "NewtonSettings", partial(newton.NewtonSettings, iterations=1))
    out = tmp_path / "out"
    status, text = run_estimate(capsys, PRACTICE.parent / "sts96_480", "--parameters", "ratio.scale", "--out", out)
    assert status == 1
    assert text.endswith(f"start nearer or allow more; {out} holds the last iteration, which is not an estimate")
    assert read_json(out / "estimate.json")["converged"] is False
