"""The command `sim-heating plan`: files of a study, interruption, processes, and one clear line for every failure."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

from tests.support.paths import ROOT

pytest.importorskip("distributed", reason="studies need Dask and pyarrow: pip install 'sim-heating[plan]'")

import pyarrow.parquet as pq
from threadpoolctl import threadpool_limits

import sim_heating as sh
from sim_heating import cli
from sim_heating.base.parallel import batches
from sim_heating.planning.study import load_study
from tests.support.browser import assert_fits, assert_harmless, hostile, needs_browser
from tests.support.json_output import run_json
from tests.support.studies import entry_3dof, finished_batches
from tests.support.systems import posix

STUDY = f"""
format = "study/1"
title = "Entry for a test"
vehicle = "orbiter"
note = "Forty-eight flights."
control_points = ["V09T9527"]
{{more}}
{entry_3dof("mach = 20.0")}[dispersion]
flights = 48
scrambles = 6
index_flights = 8
quantiles = [0.5]
[[dispersion.input]]
name = "entry.gamma_deg"
sigma = 0.02
[[dispersion.input]]
name = "stack.emissivity_factor"
sigma = 0.02
"""

ENVELOPE = """
[envelope]
[[envelope.map]]
name = "alpha"
[envelope.map.axes]
alpha_offset_deg = [-4.0, 0.0]
"""


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(STUDY.format(more=""))
    return path


def results(out):
    """Bytes of all results, without the ledger of finished batches."""
    return {
        p.relative_to(out).as_posix(): p.read_bytes()
        for p in sorted(out.rglob("*"))
        if p.is_file() and "batches" not in p.parts
    }


def start(study, out, workers, **environment):
    arguments = [sys.executable, "-m", "sim_heating", "plan", str(study), "--out", str(out), "--workers", str(workers)]
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    environment |= {"PYTHONPATH": path}
    return subprocess.Popen(arguments, env=os.environ | environment, start_new_session=True, **quiet)


@pytest.fixture(scope="module")
def by_a_fresh_process(tmp_path_factory):
    """The study, which its results name by its path, and the bytes that a process leaves that does nothing else, with
    linear algebra on one thread."""
    home = tmp_path_factory.mktemp("fresh")
    study = home / "study.toml"
    study.write_text(STUDY.format(more=""))
    assert start(study, home / "out", 1, OPENBLAS_NUM_THREADS="1").wait() == 0
    return study, results(home / "out")


@pytest.mark.thorough
@posix
def test_killed_study_continues_to_the_same_bytes_on_any_worker_count(by_a_fresh_process, tmp_path):
    """Two processes are killed, one goes on. Every file operation of one: `python -m benchmarks kills`; twenty kills of
    two: `python -m benchmarks study_kills`."""
    (study, whole), out, moments = by_a_fresh_process, tmp_path / "out", random.Random(7)
    wanted = moments.randint(1, 4)
    run = start(study, out, 2)
    while run.poll() is None and len(finished_batches(out)) < wanted:
        time.sleep(0.005)
    time.sleep(moments.uniform(0.0, 0.3))
    os.killpg(run.pid, signal.SIGKILL)
    run.wait()
    assert not (out / "study.json").exists() or (out / "report.html").exists()
    kept = finished_batches(out)
    assert len(kept) >= wanted
    assert cli.main(["plan", str(study), "--out", str(out), "--workers", "1"]) == 0
    assert {p: t for p, t in finished_batches(out).items() if p in kept} == kept  # none is done again
    assert results(out) == whole


@pytest.mark.thorough
def test_process_with_earlier_work_gives_the_bytes_of_a_fresh_one(by_a_fresh_process, tmp_path):
    """Another study, a cluster, and linear algebra on two threads; the fresh process has one."""
    (study, fresh), other, busy = by_a_fresh_process, tmp_path / "other.toml", tmp_path / "busy"
    other.write_text(study.read_text().replace("flights = 48", "flights = 12").replace("V09T9527", "BODYFLAP"))
    with threadpool_limits(2, "blas"):
        assert cli.main(["plan", str(other), "--out", str(tmp_path / "before"), "--workers", "2"]) == 0
        assert cli.main(["plan", str(study), "--out", str(busy), "--workers", "1"]) == 0
    assert results(busy) == fresh


@pytest.mark.thorough
def test_results_name_vehicle_revision_and_study_and_agree_with_each_other(study, tmp_path, capsys):
    out = tmp_path / "out"
    printed = run_json(capsys, "plan", str(study), "--out", str(out), "--workers", "1")
    summary, loaded = json.loads((out / "study.json").read_text()), load_study(study)
    assert printed["results"] == summary
    assert (summary["vehicle"], summary["revision"], summary["study"]) == ("orbiter", "1", loaded.hash)
    page = (out / "report.html").read_text()
    assert loaded.stamp in page
    assert page.count("data:image/png;base64,") == 3
    assert 'src="http' not in page
    surface = next(p for p in summary["dispersion"]["peaks"] if p["quantity"] == "peak surface")
    flights = pq.read_table(out / "dispersion_flights.parquet")
    peaks = flights.column("surface_K.V09T9527").to_numpy()
    assert len(peaks) == 48
    assert surface["mean_K"] == pytest.approx(np.mean(peaks), abs=1e-9)
    assert surface["quantiles"][0]["value"] == np.sort(peaks)[23]
    assert set(surface["sobol_indices"]) == {"entry.gamma_deg", "stack.emissivity_factor", "ratio tables"}


@needs_browser
def test_the_page_of_a_study_fits_a_screen_a_telephone_and_paper(by_a_fresh_process):
    study, _ = by_a_fresh_process
    assert_fits(study.parent / "out" / "report.html")


def test_the_hash_changes_with_the_study(study, tmp_path):
    before = load_study(study).hash
    assert load_study(study).hash == before
    study.write_text(study.read_text().replace("sigma = 0.02", "sigma = 0.021"))
    assert load_study(study).hash != before


def test_an_absent_scheduler_is_one_clear_line_and_nothing_is_written(study, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(batches, "SCHEDULER_TIMEOUT_S", 1.0)
    out = tmp_path / "out"
    assert cli.main(["plan", str(study), "--out", str(out), "--scheduler", "tcp://127.0.0.1:1"]) == 2
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error:")]
    assert len(errors) == 1
    assert "no Dask scheduler answers there" in errors[0]
    assert not results(out)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ('revision = "7"', '`revision`: the study needs "7" and orbiter is at "1"'),
        ('scenario = "nowhere.toml"', "give either `scenario` or [trajectory]"),
        ('[[limit]]\ncontrol_point = "NOSECAP"', "`NOSECAP` is not among the study's control points"),
        (ENVELOPE.replace("-4.0, 0.0", "-1e9"), "alpha_offset_deg -1e+09 must be between -90 and 90"),
        ("soak = 3.0", "unknown key `soak`; did you mean `soak_s`"),
        (
            '[[limit]]\ncontrol_point = "V09T9527"\nsurfce_K = 9e2',
            "[limit] 1: unknown key `surfce_K`; did you mean `surface_K`",
        ),
    ],
)
def test_an_impossible_study_is_refused_in_a_line(study, tmp_path, capsys, more, message):
    study.write_text(STUDY.format(more=more))
    assert cli.main(["plan", str(study), "--out", str(tmp_path / "out")]) == 2
    assert message in " ".join(capsys.readouterr().err.split())


def test_a_member_of_a_misspelt_control_point_is_refused(study, tmp_path, capsys):
    (study.parent / "aged.toml").write_text('[prior]\n"stack.emissivity_factor@V09T9537" = [0.9, 0.01]\n')
    study.write_text(STUDY.format(more="") + '[[dispersion.member]]\nestimate = "aged.toml"\nweight = 1.0\n')
    assert cli.main(["plan", str(study), "--out", str(tmp_path / "out")]) == 2
    message = (
        "[[dispersion.member]] 1: aged.toml: the vehicle has no control point `V09T9537`; did you mean `V09T9527`?"
    )
    assert message in " ".join(capsys.readouterr().err.split()).replace(f"{study.parent}/", "")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("file", "advice"),
    [
        (
            "studies/optimal_entry.toml",
            "an optimal entry by itself: for `sim-heating plan`, write a study with format =",
        ),
        ("entry_3dof.toml", "the file is a scenario, for `sim-heating run`"),
    ],
)
def test_a_file_of_another_kind_is_named_with_what_to_write(file, advice, tmp_path, capsys):
    assert cli.main(["plan", str(ROOT / "scenarios" / file), "--out", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert advice in line


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no file system in which nothing can be made")
def test_a_folder_that_cannot_hold_finished_batches_is_reported_in_a_line(study, capsys):
    assert cli.main(["plan", str(study), "--out", "/proc/nowhere"]) == 2
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1
    assert "results cannot be written" in errors[0]


def test_unknown_control_point_is_reported_with_the_file_of_the_study(study, tmp_path, capsys):
    text, flown = STUDY.format(more=""), entry_3dof("mach = 20.0")
    base = ROOT / "scenarios" / "entry_3dof.toml"
    study.write_text(text.replace(flown, f'scenario = "{base}"\n').replace('"V09T9527"', '"V09T952"'))
    assert cli.main(["plan", str(study), "--out", str(tmp_path / "out")]) == 2
    errors = capsys.readouterr().err.strip().splitlines()
    text = "`control_points`: vehicle orbiter: there is no control point `V09T952`; did you mean `V09T9527`?"
    assert errors == [f"error: {study}: {text}"]


def test_study_leaves_out_the_transition_that_its_scenario_leaves_out(study, tmp_path):
    declared = [u.effect.name for u in load_study(study).points[0].point.effects]
    head = 'format = "scenario/1"\ntitle = "base"\nvehicle = "orbiter"\n[heating]\ntransition = false\n'
    (tmp_path / "laminar.toml").write_text(head + entry_3dof("mach = 20.0"))
    study.write_text(STUDY.format(more="").replace(entry_3dof("mach = 20.0"), 'scenario = "laminar.toml"\n'))
    left = [u.effect.name for u in load_study(study).points[0].point.effects]
    assert sorted(declared) == sorted([*left, "transition"])


def test_unknown_effect_is_reported_with_the_file_of_the_scenario(study, tmp_path, capsys):
    base = tmp_path / "base.toml"
    head = 'format = "scenario/1"\ntitle = "base"\nvehicle = "orbiter"\n'
    base.write_text(f'{head}[[effect]]\nname = "gapflow"\n{entry_3dof("mach = 20.0")}')
    study.write_text(STUDY.format(more="").replace(entry_3dof("mach = 20.0"), 'scenario = "base.toml"\n'))
    assert cli.main(["plan", str(study), "--out", str(tmp_path / "out")]) == 2
    assert f"error: {base}: " in capsys.readouterr().err


def test_foreign_page_is_reported_before_the_work_and_kept(study, tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    (out / "report.html").write_text("mine")
    assert cli.main(["plan", str(study), "--out", str(out)]) == 2
    assert "report.html already exists and was not written by sim-heating" in capsys.readouterr().err
    assert [p.name for p in out.iterdir()] == ["report.html"]
    assert (out / "report.html").read_text() == "mine"


@pytest.mark.thorough
@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no file system in which nothing can be made")
def test_worker_processes_that_do_not_start_are_reported_in_a_line(study, tmp_path, capsys, monkeypatch):
    """There is no folder to start them in."""
    monkeypatch.setattr(tempfile, "tempdir", "/proc/nowhere")
    assert cli.main(["plan", str(study), "--out", str(tmp_path / "out"), "--workers", "2"]) == 1
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("dispersion:")]
    assert len(errors) == 1
    assert "the worker processes did not start" in errors[0]
    assert "use --workers 1" in errors[0]


def test_a_study_without_a_part_is_refused(study, tmp_path, capsys):
    study.write_text(STUDY.format(more="").split("[dispersion]")[0])
    assert cli.main(["plan", str(study), "--out", str(tmp_path / "out")]) == 2
    assert "has no table that asks for a result" in capsys.readouterr().err


OPTIMAL = """
[optimal]
alpha_limits_deg = [10.0, 45.0]
initial = { altitude_m = 121920.0, velocity_m_s = 7450.0, gamma_deg = -1.2, heading_deg = 90.0, latitude_deg = 0.0 }
end = { altitude_m = 26000.0, velocity_m_s = 900.0, gamma_deg = -5.0 }
limit = [{ control_point = "NOSECAP" }]
"""


def test_the_optimal_entry_of_a_study_is_flown_with_its_vehicle(study):
    study.write_text(STUDY.format(more="") + OPTIMAL)
    optimal = load_study(study).optimal()
    assert optimal is not None
    assert optimal.vehicle.name == "orbiter"
    assert [p.point.name for p in optimal.points] == ["NOSECAP"]


def test_a_misspelt_key_of_an_optimal_entry_is_reported_with_its_table(study, tmp_path, capsys):
    study.write_text(STUDY.format(more="") + OPTIMAL.replace("alpha_limits_deg", "alpha_limit_deg"))
    assert cli.main(["plan", str(study), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert "[optimal]" in error
    assert "`alpha_limits_deg`" in error


def with_optimal(study, **given):
    """The study and an optimal entry without limits on a coarse mesh."""
    keys = {"intervals": 5, "mesh_tolerance": 0.09} | given
    optimal = OPTIMAL.replace(
        'limit = [{ control_point = "NOSECAP" }]', "\n".join(f"{k} = {v}" for k, v in keys.items())
    )
    study.write_text(STUDY.format(more="") + optimal)


@pytest.mark.thorough
def test_an_optimiser_that_fails_is_one_line_and_the_dispersion_is_kept(study, tmp_path, capsys):
    """No entry ends within five minutes. Which of two reasons the optimiser gives depends on the aerodynamic tables."""
    with_optimal(study, duration_s=[200.0, 300.0])
    out = tmp_path / "out"
    assert cli.main(["plan", str(study), "--out", str(out), "--workers", "1"]) == 1
    lines = capsys.readouterr().err.splitlines()
    (line,) = [line for line in lines if line.startswith("optimal:")]
    reasons = (
        "no flight meets all bounds at once; relax a limit or the final state",
        "the optimiser did not converge in 300 iterations; relax a limit",
    )
    before, _, reason = line.partition("no flight was found: ")
    assert before == "optimal: optimal entry `Entry for a test`: "
    assert reason in reasons
    assert lines[-1] == "failed: optimal: no result; dispersion completed, results kept"
    summary = json.loads((out / "study.json").read_text())
    assert list(summary["failed"]) == ["optimal"]
    assert summary["dispersion"]["flights"] == 48
    assert pq.read_table(out / "dispersion_flights.parquet").num_rows == 48
    assert reason in (out / "report.html").read_text()


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nowhere", ""])
def test_an_absent_scheduler_is_reported_once_and_before_any_part(study, tmp_path, capsys, monkeypatch, address):
    monkeypatch.setattr(batches, "SCHEDULER_TIMEOUT_S", 1.0)
    with_optimal(study)
    out = tmp_path / "out"
    assert cli.main(["plan", str(study), "--out", str(out), "--scheduler", address]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 1
    assert "no Dask scheduler answers there" in errors[0]
    assert not out.exists()


def test_an_envelope_without_a_possible_flight_fails_with_the_reason(study, tmp_path, capsys):
    """Straight up, out of the atmosphere."""
    study.write_text(STUDY.format(more="").split("[dispersion]")[0].replace("-1.2", "89.0") + ENVELOPE)
    out = tmp_path / "out"
    assert cli.main(["plan", str(study), "--out", str(out), "--workers", "1"]) == 1
    told = [line for line in capsys.readouterr().err.splitlines() if not line.endswith("...")]
    warned, errors = ([line for line in told if line.startswith("warning: ") == is_one] for is_one in (True, False))
    assert any("`gamma_deg`: 89" in line for line in warned)
    assert len(errors) == 2
    assert errors[0].startswith(f"envelope: {study}: none of 2 flights can be flown; the first: alpha_offset_deg -4: ")
    assert "outside the atmosphere" in errors[0]
    assert errors[1] == "failed: envelope: no result"
    assert list(json.loads((out / "study.json").read_text())["failed"]) == ["envelope"]


def test_the_plan_that_is_returned_states_the_credibility_that_was_written(study, tmp_path):
    """The base entry was flown for the files, and is not flown again for the caller: its scenario may be gone."""
    planned = sh.plan(study, tmp_path / "out", workers=1)
    study.unlink()
    assert planned.credibility.as_json() == json.loads((tmp_path / "out" / "study.json").read_text())["credibility"]
    written = {p.relative_to(tmp_path / "out").as_posix() for p in (tmp_path / "out").rglob("*") if p.is_file()}
    assert set(planned.files) == {name for name in written if not name.startswith(("batches/", "."))}


@needs_browser
@pytest.mark.filterwarnings("ignore:constrained_layout not applied")  # the texts are longer than a picture is high
def test_no_text_of_a_study_runs_in_its_report(tmp_path):
    """Every free text of a study file, also in its warnings and pictures, in the page that the command writes."""
    study, out = tmp_path / "study.toml", tmp_path / "out"
    text = STUDY.format(more="").replace("flights = 48", "flights = 12")
    text = text.replace('"Entry for a test"', json.dumps(hostile("title")))
    text = text.replace('"Forty-eight flights."', json.dumps(hostile("note")))
    text += ENVELOPE.replace('name = "alpha"', f'name = "alpha"\ntitle = {json.dumps(hostile("map"))}')
    study.write_text(text)
    assert cli.main(["plan", str(study), "--out", str(out), "--workers", "1"]) == 0
    html = (out / "report.html").read_text()
    for where in ("title", "note", "map"):
        assert f"{where} &lt;script&gt;" in html
    assert_harmless(html, tmp_path)
