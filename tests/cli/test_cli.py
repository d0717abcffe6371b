"""The command as a user has it: files that it writes, its exit status, and one line for an error."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from sim_heating.base.files import MARKER, files_written
from sim_heating.cli import main
from tests.support.browser import assert_fits, needs_browser
from tests.support.gliding import gliding
from tests.support.paths import ROOT, TILE
from tests.support.systems import posix

SHORT = gliding(60.0, "V09T9527", vehicle="orbiter")
POPU = '[[trajectory.manoeuvre]]\nkind = "popu"\n'


@pytest.fixture
def workdir(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory with one good scenario in it, the vehicles found by name."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SIM_HEATING_AIRCRAFT_DATA", str(ROOT / "aircraft_data"))
    (tmp_path / "short.toml").write_text(SHORT)
    return tmp_path


def written_by(command: str, out: Path) -> Path:
    """Results of a command on the short flight."""
    scenario = out.parent / "short.toml"
    scenario.write_text(SHORT)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SIM_HEATING_AIRCRAFT_DATA", str(ROOT / "aircraft_data"))
        assert main([command, str(scenario), "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def synthesized(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The record of the short flight, as `synthesize` writes it."""
    return written_by("synthesize", tmp_path_factory.mktemp("synthesized") / "record")


@pytest.fixture
def record(workdir: Path, synthesized: Path) -> Path:
    """That record in the working directory."""
    return shutil.copytree(synthesized, workdir / "record")


@pytest.fixture(scope="module")
def run_results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `run` writes of the short flight."""
    return written_by("run", tmp_path_factory.mktemp("run") / "out")


@pytest.fixture
def first(workdir: Path, run_results: Path) -> Path:
    """Those results in the working directory."""
    return shutil.copytree(run_results, workdir / "first")


@pytest.fixture(scope="module")
def predicted(synthesized: Path) -> Path:
    """What `predict` writes of it and a copy of it."""
    shutil.copytree(synthesized, synthesized.parent / "copy")
    records = [str(synthesized), str(synthesized.parent / "copy")]
    assert main(["predict", *records, "--out", str(synthesized.parent / "predicted")]) == 0
    return synthesized.parent / "predicted"


def only_line(capsys: pytest.CaptureFixture[str]) -> str:
    """The one line of an error; progress lines end in dots."""
    err = [line for line in capsys.readouterr().err.splitlines() if not line.endswith("...")]
    assert len(err) == 1, err
    assert "Traceback" not in err[0]
    return err[0]


# Outputs of a good run -----------------------------------------------------------------------------------------------


def test_run_writes_tables_pictures_and_a_summary(workdir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "short.toml", "--out", "out"]) == 0
    made = {p.name for p in (workdir / "out").iterdir()}
    assert made >= {"temperatures.csv", "conditions.csv", "flight.nc", "summary.json", "trajectory.png"}
    output = capsys.readouterr().out
    assert "V09T9527" in output
    assert "temperatures.png" in output
    point = json.loads((workdir / "out" / "summary.json").read_text())["control_points"]["V09T9527"]
    assert 900.0 < point["peak_surface_K"] < 1300.0


@pytest.mark.thorough
def test_a_second_run_replaces_the_first_and_keeps_other_files(first: Path) -> None:
    (first / "notes.txt").write_text("mine")
    assert main(["run", "short.toml", "--out", "first"]) == 0
    assert (first / "notes.txt").read_text() == "mine"


def test_a_synthetic_record_is_valid_and_can_be_predicted(
    record: Path, predicted: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main(["validate", "record", "short.toml"]) == 0
    found = json.loads((predicted / "record" / "summary.json").read_text())
    # 305 samples: 3 sigma of an RMSE is 12 %
    assert found["fit"]["rmse_K"] == pytest.approx(found["noise_floor_K"], rel=0.15)
    assert "good" in capsys.readouterr().out


@pytest.mark.thorough
def test_a_name_in_brackets_is_printed_unchanged(workdir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(TILE, workdir / "[red] tile")
    assert main(["predict", "[red] tile", "--out", "[bold] out"]) == 0
    output = capsys.readouterr().out
    assert "[red] tile" in output
    assert "Wrote [bold] out" in output


def test_several_records_are_predicted_each_in_its_own_directory(predicted: Path) -> None:
    assert {p.name for p in predicted.iterdir()} == {"record", "copy", "report.html", MARKER}
    fleet = (predicted / "report.html").read_text()
    assert all(f'href="./{name}/report.html"' in fleet for name in ("record", "copy"))


def test_a_key_in_the_chart_of_a_sensor_gives_the_error_of_this_sensor(predicted: Path) -> None:
    found = json.loads((predicted / "record" / "summary.json").read_text())["sensors"]
    page = (predicted / "record" / "report.html").read_text()
    (chart, *_) = (json.loads(text) for text in re.findall(r'application/json">([^<]*)<', page))
    panels = {panel["label"].removesuffix(", indicated, K"): panel["curves"] for panel in chart["panels"]}
    errors = {name: f"predicted, RMSE {error['rmse_K']:.2f} K" for name, error in found.items()}
    assert len(set(errors.values())) > 1
    assert {name: panels[name][1]["label"] for name in found} == errors


@needs_browser
def test_record_and_prediction_pages_fit_screen_telephone_and_paper(predicted: Path) -> None:
    pages = "record/report.html", "predicted/report.html", "predicted/record/report.html"
    assert_fits(*(predicted.parent / page for page in pages))


def test_validate_recognises_a_vehicle_a_table_and_a_record(workdir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsule = ROOT / "aircraft_data" / "capsule"
    assert main(["validate", str(capsule), str(capsule / "ratio_tables" / "FACE.csv"), str(TILE)]) == 0
    assert capsys.readouterr().out.count("good") == 3


def test_validate_checks_the_paths_after_a_wrong_one(workdir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["validate", "nowhere", "short.toml", "neither"]) == 2
    printed = capsys.readouterr()
    assert "short.toml: good" in printed.out
    assert "nowhere" in printed.err
    assert "neither" in printed.err


# Refused with one line and status 2 ----------------------------------------------------------------------------------

DAMAGED = {
    "unknown key": (SHORT.replace("title =", 'titel = "x"\ntitle ='), "did you mean `title`"),
    "unknown control point": (SHORT.replace("V09T9527", "V09T9257"), "did you mean `V09T9527`"),
    "unknown vehicle": (SHORT.replace('"orbiter"', '"orbitr"'), "did you mean `orbiter`"),
    "no control points": (SHORT.replace('["V09T9527"]', "[]"), "the list is empty"),
    "missing key": (SHORT.replace("altitude_m = 75000.0", ""), "`altitude_m` is missing"),
    "text for a number": (SHORT.replace("75000.0", '"75 km"'), "is not a number"),
    "NaN": (SHORT.replace("75000.0", "nan"), "not a finite number"),
    "NaN between bounds": (SHORT.replace("-0.1", "nan"), "`gamma_deg`: NaN is not a finite number"),
    "no trigger": (SHORT + POPU, "exactly one of"),
    "two triggers": (SHORT + POPU + "at_mach = 20.0\nat_time_s = 3.0\n", "exactly one of"),
    "unknown manoeuvre": (SHORT + '[[trajectory.manoeuvre]]\nkind = "popo"\nat_time_s = 3.0\n', "did you mean `popu`"),
    "manoeuvre of no kind": (SHORT + "[[trajectory.manoeuvre]]\nat_time_s = 3.0\n", "key `kind` is missing"),
    "key of other manoeuvres": (
        SHORT + POPU + "at_time_s = 3.0\namplitude_deg = 2.0\n",
        '"sideslip-doublet", not to kind = "popu", which takes',
    ),
    "misspelt key of a manoeuvre": (SHORT + POPU + "at_time_s = 3.0\nrate_deg = 2.0\n", "did you mean `rate_deg_s`"),
    "manoeuvre backwards": (SHORT + POPU + "at_time_s = 3.0\nrate_deg_s = -1.0\n", "must be above 0"),
    "unknown effect": (SHORT + '[[effect]]\nname = "transitoin"\n', "did you mean `transition`"),
    "effect of nobody": (
        SHORT + '[[effect]]\nname = "swirl"\n',
        "your own are read from packages, and from the folders in SIM_HEATING",
    ),
    "effect out of bounds": (SHORT + '[[effect]]\nname = "transition"\nparameters = { factor = 50.0 }\n', "1 to 20"),
    "unknown truth": (SHORT + '[truth]\nparameters = { "ratio.sclae" = 0.1 }\n', "did you mean `ratio.scale`"),
    "fault of no sensor": (SHORT + '[[measurements.fault]]\nsensor = "V09T9528"\n', "did you mean `V09T9527`"),
    "gap backwards": (SHORT + "[measurements]\ngaps_s = [[20.0, 10.0]]\n", "start before end"),
    "no measured file": (
        SHORT + '[[compare]]\ncontrol_point = "V09T9527"\nfile = "none.csv"\nlabel = "x"\n',
        "no such file",
    ),
    "recorded without a file": (SHORT.replace("entry-3dof", "recorded"), "needs `file`"),
    "empty": ("", "empty"),
    "cut off": (SHORT[: SHORT.index("75000") + 2].replace("altitude_m = 75", "altitude_m = ["), "cut off"),
    "another format": (
        SHORT.replace("scenario/1", "study/1") + "[envelope]\n",
        '`format`: "study/1" is not "scenario/1"',
    ),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_scenario_is_refused_in_one_line(
    name: str, workdir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, hint = DAMAGED[name]
    (workdir / "bad.toml").write_text(text)
    assert main(["run", "bad.toml", "--out", "out/here"]) == 2
    assert hint in only_line(capsys)
    assert not (workdir / "out").exists()


def test_a_binary_scenario_is_refused(workdir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (workdir / "bad.toml").write_bytes(bytes(range(256)))
    assert main(["synthesize", "bad.toml", "--out", "out"]) == 2
    assert "binary" in only_line(capsys)


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (["run", "short.toml"], "--out"),
        (["run", "nothing.toml", "--out", "out"], "no such file"),
        (["rum", "short.toml", "--out", "out"], "run"),
        (["predict", "--out", "out"], "RECORDS"),
        (["predict", ".", "--out", "out"], "record.toml"),
        (["validate", "."], "neither a record"),
        (["validate", "nowhere"], "no such file"),
        (["run", "short.toml", "--out", "short.toml"], "is a file"),
        (["run", "short.toml", "--out", "short.toml/x"], "short.toml is a file"),
        (["run", "short.toml", "--out", "x" * 300], "name another directory"),
        (["run", "short.toml", "--out", f"{'x' * 300}/out"], "name another directory"),
    ],
    ids=lambda v: " ".join(v)[:60] if isinstance(v, list) else None,
)
def test_wrong_usage_is_reported_in_one_line(
    arguments: list[str], hint: str, workdir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert hint in only_line(capsys)
    assert not (workdir / "out").exists()


def test_two_records_of_one_name_are_refused(workdir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["predict", str(TILE), str(TILE), "--out", "out"]) == 2
    assert "rename" in only_line(capsys)


def test_a_damaged_record_leaves_no_directory(record: Path, workdir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    file = record / "thermocouples.csv"
    file.write_text(file.read_text().replace("V09T9527_K", "V09T9527_C"))
    assert main(["predict", "record", "--out", "out"]) == 2
    assert "V09T9527_K" in only_line(capsys)
    assert not (workdir / "out").exists()


def test_a_file_of_other_origin_is_never_overwritten(workdir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (workdir / "out").mkdir()
    (workdir / "out" / "summary.json").write_text("mine")
    assert main(["run", "short.toml", "--out", "out"]) == 2
    assert "summary.json" in only_line(capsys)
    assert [p.name for p in (workdir / "out").iterdir()] == ["summary.json"]


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    "command",
    [
        ["predict", str(TILE)],
        ["run", "popu.toml"],
        ["synthesize", "short.toml"],
        ["estimate", str(TILE)],
        ["estimate", str(TILE), "--process-noise", "0.2", "--ratio-noise", "0.01,30"],
        ["estimate", str(TILE), "--segments", "60"],
    ],
    ids=" ".join,
)
def test_a_file_of_other_origin_is_refused_before_any_work(
    command: list[str], workdir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    both = SHORT.replace('["V09T9527"]', '["V09T9527", "V07T9975"]')
    (workdir / "popu.toml").write_text(both + POPU + "at_time_s = 20.0\n")
    assert main([*command, "--out", "out"]) == 0
    written = files_written("out")
    assert written
    capsys.readouterr()
    for name in written:
        mine = workdir / "occupied" / name
        mine.parent.mkdir(parents=True)
        mine.write_text("mine")
        assert main([*command, "--out", "occupied"]) == 2
        errors = capsys.readouterr().err.splitlines()
        assert errors == [
            f"error: occupied: {name} already exists and was not written by sim-heating; choose another directory, or "
            "replace what is there with --force"
        ]
        assert [p for p in (workdir / "occupied").rglob("*") if p.is_file()] == [mine]
        shutil.rmtree(workdir / "occupied")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a file system without write access")
@pytest.mark.parametrize(
    "command",
    [
        ["run", "short.toml", "--out", "/proc/nowhere"],
        ["estimate", str(TILE), "--out", "/proc/nowhere/fit"],
        ["fmu", "export", "capsule", "--out", "/proc/capsule.fmu"],
        ["fmu", "trajectory", "short.toml", "--out", "/proc/nowhere/entry.fmu"],
        ["update-tables", "estimate.json", "--vehicle", "orbiter", "--out", "/proc/nowhere"],
    ],
    ids=" ".join,
)
def test_a_directory_that_cannot_be_written_is_refused_before_any_work(
    command: list[str], workdir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(command) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 1
    assert "results cannot be written" in errors[0]


# Failures of a run, with status 1 ------------------------------------------------------------------------------------


def test_a_flight_out_of_the_atmosphere_fails_with_status_1(workdir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    up = SHORT.replace("6800.0", "12000.0").replace("-0.1", "20.0").replace("time_s = 60.0", "time_s = 900.0")
    (workdir / "up.toml").write_text(up)
    assert main(["run", "up.toml", "--out", "out"]) == 1
    assert "outside the atmosphere" in only_line(capsys)
    assert not (workdir / "out").exists()


@pytest.mark.thorough
@posix
@pytest.mark.parametrize("number", [signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)])
def test_an_interrupted_run_leaves_nothing_behind(workdir: Path, number: signal.Signals) -> None:
    if signal.getsignal(number) is signal.SIG_IGN:
        pytest.skip("what nohup started goes on through a hangup")
    long = SHORT.replace("entry-3dof", "jsbsim").replace("time_s = 60.0", "time_s = 1000.0")
    (workdir / "long.toml").write_text(long.replace('source = "jsbsim"', 'source = "jsbsim"\nrate_hz = 1000.0'))
    command = [sys.executable, "-m", "sim_heating", "run", "long.toml", "--out", "out"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, cwd=workdir, env=environment, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        while "flying" not in (line := process.stderr.readline()):
            assert line, "it ended before it flew"
            time.sleep(0.01)
        process.send_signal(number)
        errors = process.stderr.read()
        assert process.wait(timeout=60) == 128 + number
    assert "interrupted" in errors
    assert "Traceback" not in errors
    assert sorted(p.name for p in workdir.iterdir()) == ["long.toml", "short.toml"]


INTERRUPTED = """
import sys
class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == "sim_heating.cli":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupt())
from sim_heating.__main__ import main
sys.exit(main())
"""


def test_an_interrupt_while_modules_load_is_reported_in_one_line() -> None:
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "interrupted: nothing was begun\n")


@pytest.mark.thorough
def test_a_cache_that_cannot_be_written_is_reported_in_one_line(workdir: Path) -> None:
    command = [sys.executable, "-m", "sim_heating", "fmu", "export", "orbiter", "--out", "x.fmu"]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": "/proc/nowhere"}
    done = subprocess.run(command, cwd=workdir, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == "failed: /proc/nowhere: No such file or directory"
    assert sorted(p.name for p in workdir.iterdir()) == ["short.toml"]


# Errors that would go unnoticed -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("more", "hint"),
    [
        ("[measurements]\nseed = -1\n", "`seed`: -1"),
        ("[measurements]\nrate_hz = 1e9\n", "`rate_hz`: "),
        (
            "[measurements]\nclock_skew_s = 150.0\n",
            "clock in s (-60 to 60); is this ms? write 0.15",
        ),
        ("[measurements]\nsample_offset_s = 9999.0\n", "[measurements]: skew, offset, gaps and losses leave no sample"),
    ],
)
def test_impossible_measurements_are_refused_in_one_line(
    workdir: Path, capsys: pytest.CaptureFixture[str], more: str, hint: str
) -> None:
    (workdir / "odd.toml").write_text(SHORT + more)
    assert main(["synthesize", "odd.toml", "--out", "out"]) == 2
    assert hint in only_line(capsys)
    assert not (workdir / "out").exists()


def test_a_control_point_named_twice_is_refused(workdir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (workdir / "twice.toml").write_text(SHORT.replace('["V09T9527"]', '["V09T9527", "V09T9527"]'))
    assert main(["validate", "twice.toml"]) == 2
    assert "`V09T9527` is repeated" in only_line(capsys)


@pytest.mark.thorough
def test_a_manoeuvre_whose_trigger_is_never_met_is_reported(workdir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (workdir / "fast.toml").write_text(SHORT + POPU + "at_velocity_m_s = 3000.0\n")
    assert main(["run", "fast.toml", "--out", "out"]) == 0
    assert "trigger never met; manoeuvre not flown" in capsys.readouterr().out


@pytest.mark.thorough
def test_a_flight_is_read_back_from_its_own_conditions(workdir: Path, first: Path) -> None:
    head = SHORT[: SHORT.index("[trajectory]")]
    (workdir / "again.toml").write_text(head + '[trajectory]\nsource = "recorded"\nfile = "first/conditions.csv"\n')
    assert main(["run", "again.toml", "--out", "second"]) == 0
    last = [(workdir / d / "temperatures.csv").read_text().splitlines()[-1] for d in ("first", "second")]
    before, again = (line.split(",") for line in last)
    assert [float(x) for x in again] == pytest.approx([float(x) for x in before], abs=0.001)


@pytest.mark.thorough
@pytest.mark.parametrize(("column", "factor"), [("velocity_m_s", 1.0 / 0.3048), ("altitude_m", 1e-3)])
def test_a_recorded_flight_in_another_unit_is_refused(
    workdir: Path, first: Path, capsys: pytest.CaptureFixture[str], column: str, factor: float
) -> None:
    header, *rows = (first / "conditions.csv").read_text().splitlines()
    place = header.split(",").index(column)
    cells = [row.split(",") for row in rows]
    damaged = [",".join([*c[:place], repr(float(c[place]) * factor), *c[place + 1 :]]) for c in cells]
    (workdir / "odd.csv").write_text("\n".join([header, *damaged]))
    head = SHORT[: SHORT.index("[trajectory]")]
    (workdir / "odd.toml").write_text(head + '[trajectory]\nsource = "recorded"\nfile = "odd.csv"\n')
    capsys.readouterr()
    assert main(["run", "odd.toml", "--out", "out"]) == 2
    assert f"column {column}" in only_line(capsys)


@pytest.mark.thorough
def test_predict_reports_a_negative_heating_ratio(record: Path, workdir: Path) -> None:
    lines = (record / "ratio_table.csv").read_text().splitlines()
    comments = [x for x in lines if x[0] == "#"]
    header, *rows = [x for x in lines if x[0] != "#"]
    assert header.endswith(",ratio,sigma")
    # all but one node: a table that is negative throughout is refused
    negative = [",".join([*row.split(",")[:-2], "-0.0001", "0.0001"]) for row in rows[:-1]]
    (record / "ratio_table.csv").write_text("\n".join([*comments, header, *negative, rows[-1]]))
    assert main(["predict", "record", "--out", "out"]) == 0
    assert json.loads((workdir / "out" / "summary.json").read_text())["negative_ratio_s"] > 50.0


# Wrong names and paths -----------------------------------------------------------------------------------------------


def test_of_a_misspelt_option_only_close_names_are_suggested(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new", "record", "--absorbtance", "0.9"]) == 2
    assert only_line(capsys) == "error: No such option '--absorbtance'. Did you mean '--absorptance'?"


def test_parameters_of_a_file_that_is_no_toml_says_what_it_takes(
    workdir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (workdir / "README.md").write_text("# mine")
    assert main(["parameters", "README.md"]) == 2
    takes = "give a flight record (a directory with record.toml) or a scenario.toml"
    assert only_line(capsys) == f"error: README.md: {takes}"
