"""close-loop as a user runs it, on records with an undeclared effect and without one."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from sim_heating.base.errors import InputError
from sim_heating.base.files import files_written
from sim_heating.cli import cli, main
from sim_heating.closure.close import FILES, close_loop
from sim_heating.closure.search.ranking import count_forms
from sim_heating.closure.search.search import search_effects, search_round
from sim_heating.closure.search.trials.candidates import LAG_EFFECT, SENSOR_EFFECT, candidates
from sim_heating.closure.search.trials.trial_fit import MAX_STEP_S, base_trial, fitted_values, thinned_indices
from sim_heating.estimation.fit import estimate
from sim_heating.formats.catalogue import format_named
from sim_heating.heating.effects import EffectUse, effects, use
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import Record, Segments, load_record, write_record
from sim_heating.inputs.sensor_model import quantise
from sim_heating.simulation.predict import predict
from tests.support.few_candidates import search_among
from tests.support.paths import BOARD, PRACTICE, ROOT
from tests.support.systems import posix

PAIRED = (
    "conductivity", "alpha-curvature", "radiative-conduction", "gap-flow", "heat-capacity", "coating-thickness",
)  # fmt: skip


NAMED = ("impingement-onset", "time-skew", "conductivity", "alpha-curvature", "coating-thickness")
"""Candidates of the test of all files."""


def simulated_record(
    record: Record,
    uses: Sequence[EffectUse] = (),
    noise: float = 1.0,
    seed: int = 8,
) -> Record:
    """The record with readings simulated by its declared model, with effects or with other noise.

    noise : factor on the declared sigma, 1 K where none is declared
    """
    predicted, rng = predict(record, point_of_record(record, None, uses)), np.random.default_rng(seed)
    columns = dict(record.thermocouples)
    for sensor, indicated in zip(record.sensors, predicted.indicated_K, strict=True):
        noisy = indicated + rng.normal(0.0, noise * (sensor.noise_sigma_K or 1.0), len(indicated))
        columns[sensor.column] = quantise(sensor, noisy)
    return replace(record, thermocouples=columns)


def every_eighth(record: Record) -> Record:
    """The record with an eighth of its conditions and readings, 8 s apart."""
    columns = {name: column[::8] for name, column in record.thermocouples.items()}
    conditions = conditions_of_record(record)
    return replace(record, conditions=conditions.at(conditions.time_s[::8]), thermocouples=columns)


@pytest.mark.thorough
def test_noise_above_the_declared_one_is_no_cause() -> None:
    noisy = search_effects(simulated_record(every_eighth(load_record(PRACTICE / "p06")), noise=2.0))
    assert noisy.names == ("none",)
    assert noisy.none.excess_chi2 > 1.0
    assert noisy.none.adequacy.noise_scale == pytest.approx(2.0, rel=0.1)


@pytest.mark.thorough
def test_two_effects_are_both_named_with_their_sizes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another effect resembles both together and is the best single one; the pair explains the record to its noise."""
    search_among(monkeypatch, *PAIRED)
    put_in = [use("conductivity", {"conductivity_factor": 1.12}), use("alpha-curvature", {"d_alpha2": 1.5e-4})]
    found = search_effects(simulated_record(load_record(PRACTICE / "p06"), put_in))
    assert found.conclusion.best.adequate
    assert set(found.names) == {"conductivity", "alpha-curvature"}
    last = found.added[-1]
    values, sigma = fitted_values(last), dict(zip(last.fit.names, last.fit.sigma, strict=True))
    for name, truth in (
        ("effect.conductivity.conductivity_factor", 1.12),
        ("effect.alpha-curvature.d_alpha2", 1.5e-4),
    ):
        assert values[name] == pytest.approx(truth, abs=5.0 * sigma[name])


def test_magnitudes_have_priors_and_onsets_with_several_starts_have_none() -> None:
    record = load_record(PRACTICE / "p06")
    tried = candidates(record, conditions_of_record(record))
    known = {c.name: {n.rpartition(".")[2] for n in c.with_prior} for c in tried if len(c.names) > 1}
    assert known["transition"] == {"factor", "alpha_sens", "hysteresis"}
    assert known["catalysis"] == {"flow_step"}  # of the last of its forms
    assert known["sensor-bias"] == {"bias", "gain"}


def test_a_special_case_of_another_form_is_not_counted() -> None:
    """Transition without sensitivity to angle of attack is a special case; a logistic rise is not one of spots."""
    record = load_record(PRACTICE / "p06")
    forms = count_forms(candidates(record, conditions_of_record(record)))
    assert forms["transition"] == 2
    assert forms["radiative-conduction"] == 1
    assert forms["sensor-bias"] == len(record.used_sensors)


@pytest.mark.thorough
def test_segments_held_out_distinguish_conduction_from_radiation_in_depth_better() -> None:
    """In the mean over draws of the noise, which move the odds of one record by a factor of a hundred either way."""
    log_odds, both = [], {"conductivity", "radiative-conduction"}
    others = sorted({*effects(), SENSOR_EFFECT, LAG_EFFECT} - both)
    for seed in (8, 9, 10):
        uses = [use("conductivity", {"conductivity_factor": 1.05})]
        record = simulated_record(load_record(PRACTICE / "p06"), uses, seed=seed)
        fitted_alone = Segments(fit=record.declared.segments.fit)
        without = replace(record, declared=record.declared.model_copy(update={"segments": fitted_alone}))
        with_both, alone = (
            search_round(base_trial(estimate([r])), others, lambda fraction, text: None) for r in (record, without)
        )
        rounds = (alone, with_both)
        scores = [{t.name: t.score for t in r.trials} for r in rounds]
        log_odds.append([0.5 * (s["radiative-conduction"] - s["conductivity"]) for s in scores])
        gained = {a.name: a.delta_bic for a in alone.trials}
        assert all(a.delta_bic == pytest.approx(gained[a.name], abs=0.1) for a in with_both.trials[:2])
    mean = np.mean(log_odds, axis=0)
    assert 0.0 < mean[0] < mean[1] - np.log(3.0)


def test_samples_are_omitted_only_where_conditions_are_as_good_as_linear() -> None:
    flown = conditions_of_record(load_record(PRACTICE / "p08"))
    kept = thinned_indices(flown)
    t = flown.time_s
    assert kept[0] == 0
    assert kept[-1] == len(t) - 1
    assert len(kept) < 0.8 * len(t)
    assert np.max(np.diff(t[kept])) <= MAX_STEP_S * (1.0 + 1e-9)
    alpha = flown["alpha_deg"]
    assert np.max(np.abs(np.interp(t, t[kept], alpha[kept]) - alpha)) <= 0.1


def test_report_and_files_of_one_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Among few effects; the example of `close_loop` in the package searches the same record among all."""
    search_among(monkeypatch, *NAMED)
    out = tmp_path / "out"
    result = CliRunner().invoke(cli, ["close-loop", str(PRACTICE / "p08"), "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert re.search("│ p08 +│ found:", result.output)
    assert ".sim_heating.json" not in result.output
    assert set(files_written(out)) <= set(FILES)
    found = json.loads((out / "closure.json").read_text())
    assert found["format"] == "closure-report/2"
    assert set(found) == set(format_named("closure").keys), "what docs/reference/formats/closure.md lists"
    assert found["finding"] == "found"
    assert found["alternatives"] == [["impingement-onset"]]
    assert found["adequacy"]["p_value"] > 0.01
    assert found["not_effects"] == []
    assert found["converged"]
    assert found["effect"]["name"] == "impingement-onset"
    assert found["after"]["holdout"]["rmse_K"] < 1.1 * found["noise_floor_K"] < found["before"]["holdout"]["rmse_K"]
    assert {c["name"] for c in found["candidates"]} >= {"none", *NAMED}
    rows = (out / "residual_heating.csv").read_text().splitlines()
    assert rows[0] == "time_s,delta_ratio,sigma"
    assert len(rows) > 100
    assert "impingement-onset" in (out / "report.html").read_text()
    estimated = json.loads((out / "estimate.json").read_text())["parameters"]
    assert estimated["effect.impingement-onset.slope"]["value"] > 0.0


@pytest.mark.thorough
def test_a_stuck_sensor_is_reported_and_no_effect(tmp_path: Path) -> None:
    """The others of the board under its lamp read what its declared model says."""
    board = simulated_record(load_record(BOARD))
    sensor = board.sensors[0]
    stuck = {**board.thermocouples, sensor.column: np.full(len(board.time_s), 300.0)}
    write_record(replace(board, thermocouples=stuck), tmp_path / "stuck")
    result = CliRunner().invoke(cli, ["close-loop", str(tmp_path / "stuck"), "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert f"Not an aerothermal effect (sensor): {sensor.name} stuck at 300.0 K" in result.output
    assert json.loads((tmp_path / "out" / "closure.json").read_text())["effect"]["name"] == "none"


@pytest.mark.parametrize("name", ["closure.json", "fit.png", "p07/report.html", "summary.csv"])
def test_a_foreign_file_in_the_output_folder_is_refused_before_any_search(name: str, tmp_path: Path) -> None:
    alone, mine = name in FILES, tmp_path / "out" / name
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    records = [str(PRACTICE / r) for r in (("p06",) if alone else ("p06", "p07"))]
    result = CliRunner().invoke(cli, ["close-loop", *records, "--out", str(tmp_path / "out")])
    assert isinstance(result.exception, InputError)
    assert f"{mine.name} already exists and was not written by sim-heating" in str(result.exception)
    assert [p for p in (tmp_path / "out").rglob("*") if p.is_file()] == [mine]


@pytest.mark.parametrize(("wrong", "whose"), [("thermocouples", "thermocouples"), ("conditions", "flight conditions")])
def test_a_clock_in_milliseconds_is_refused_before_any_search(wrong: str, whose: str, tmp_path: Path) -> None:
    record = tmp_path / "fast"
    shutil.copytree(PRACTICE / "p06", record)
    header, *rows = (record / f"{wrong}.csv").read_text().splitlines()
    assert header.startswith("time_s,")
    fast = [",".join([repr(1e3 * float(time_s)), *rest]) for time_s, *rest in (row.split(",") for row in rows)]
    (record / f"{wrong}.csv").write_text("\n".join([header, *fast]) + "\n")
    result = CliRunner().invoke(cli, ["close-loop", str(record), "--out", str(tmp_path / "out")])
    assert isinstance(result.exception, InputError)
    assert f"the clock of the {whose} is in milliseconds" in str(result.exception)
    assert not (tmp_path / "out").exists()


RESUMED_AMONG = ("conductivity", "heat-capacity")
CLOSED_AMONG_FEW = f"""
import sys, pytest
from sim_heating.cli import main
from tests.support.few_candidates import search_among
search_among(pytest.MonkeyPatch(), *{RESUMED_AMONG})
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.thorough
@posix
def test_a_killed_run_over_many_records_is_resumed_and_a_damaged_record_stops_no_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    search_among(monkeypatch, *RESUMED_AMONG)
    records, out = tmp_path / "records", tmp_path / "out"
    for name in ("b06", "b07", "b99"):
        write_record(simulated_record(load_record(BOARD)), records / name)
    (records / "b99" / "thermocouples.csv").write_text("time_s,tc_5p72mm_K\n0,hot\n")
    command = ["close-loop", str(records), "--out", str(out), "--workers", "1"]
    killed = subprocess.Popen(
        [sys.executable, "-c", CLOSED_AMONG_FEW, *command],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    finished = out / "finished"
    while killed.poll() is None and not list(finished.glob(".b06-*.sha256")):
        time.sleep(0.05)
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    first = {p.name: p.stat().st_mtime_ns for p in finished.glob("b06-*.json")}
    assert first
    assert main(command) == 1
    error = capsys.readouterr().err
    assert "b99" in error
    assert "Traceback" not in error
    assert {p.name: p.stat().st_mtime_ns for p in finished.glob("b06-*.json")} == first
    rows = {row["record"]: row for row in json.loads((out / "summary.json").read_text())["records"]}
    assert rows["b06"]["effects"] == rows["b07"]["effects"]
    assert "failed" in rows["b99"]
    assert (out / "b07" / "closure.json").is_file()
    assert not (out / "b99").exists()
    # What is in the list of finished records is not believed where the results are gone or the list is damaged.
    closure = (out / "b07" / "closure.json").read_bytes()
    shutil.rmtree(out / "b07")
    next(finished.glob("b06-*.json")).write_bytes(b"\xff\xfe{")
    assert main(command) == 1
    assert "Traceback" not in capsys.readouterr().err
    assert (out / "b07" / "closure.json").read_bytes() == closure
    assert {row["record"]: row for row in json.loads((out / "summary.json").read_text())["records"]} == rows


@pytest.mark.parametrize("what", ["nothing here", "two of a name"])
def test_paths_without_records_and_equal_names_are_refused_in_one_line(what: str, tmp_path: Path) -> None:
    given = [str(tmp_path)] if what == "nothing here" else [str(PRACTICE / "p06"), str(PRACTICE / "p06")]
    result = CliRunner().invoke(cli, ["close-loop", *given, "--out", str(tmp_path / "out")], standalone_mode=False)
    assert isinstance(result.exception, Exception)
    assert "record" in str(result.exception)


def test_a_record_of_a_few_readings_is_refused() -> None:
    record = load_record(PRACTICE / "p06")
    few = {name: column[600:606] for name, column in record.thermocouples.items()}
    with pytest.raises(InputError, match=r"readings at 6 time\(s\); close-loop needs 10 at least"):
        close_loop(replace(record, thermocouples=few))
