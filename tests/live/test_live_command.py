"""The command `sim-heating live`: a link from the command line to its results, and what it refuses in one line."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import sys
from dataclasses import replace
from pathlib import Path
from types import FrameType

import numpy as np
import pytest

import sim_heating as sh
from sim_heating.base.files import read_json
from sim_heating.cli import main
from sim_heating.inputs.record import load_record, write_record
from sim_heating.live.engine import LinkEngine
from sim_heating.live.recording.journal import open_again
from sim_heating.live.recording.to_record import with_heated_start
from tests.live.links import FRAME, free_port, json_lines, part_of_record
from tests.support.json_output import run_json
from tests.support.paths import PRACTICE

LINK = """format = "link/1"
vehicle = "orbiter"
control_points = ["V09T9527"]

[[source]]
kind = "json-lines"
transport = "file"
file = "flight.jsonl"
"""
"""A link that reads the lines of a file."""
POINT = "V09T9527"
SCALE = 0.1
"""What the heating ratio is truly above its table [-]."""


@pytest.fixture(scope="module")
def cut(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A minute of a practice record."""
    return part_of_record(PRACTICE / "p06", 600.0, 660.0, tmp_path_factory.mktemp("records") / "cut")


@pytest.fixture(scope="module")
def replayed(cut: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of its replay."""
    out = tmp_path_factory.mktemp("live") / "out"
    assert main(["live", "--replay", str(cut), "--speed", "0", "--headless", "--out", str(out), "--quiet"]) == 0
    return out


def of_vehicle(folder: Path, link: str = LINK, frames: int = 30) -> Path:
    """A link of a vehicle in a folder, and the file of its lines: constant conditions from a cold start."""
    (folder / "link.toml").write_text(link)
    truth = sh.HeatingPlugin(sh.load_vehicle("orbiter"), [POINT], parameters={"ratio.scale": SCALE})
    columns = {sensor: f"{sensor}_K" for sensor in truth.sensors_K}
    rows: list[dict[str, float]] = []
    for k in range(frames):
        frame = FRAME | {"time_s": float(k)}
        truth.step(frame) if k else truth.reset(frame)
        rows.append(frame | {columns[name]: value for name, value in truth.sensors_K.items()})
    (folder / "flight.jsonl").write_bytes(json_lines(rows))
    return folder / "link.toml"


def the_error(capsys: pytest.CaptureFixture[str], *arguments: str, status: int = 2) -> str:
    """The one line by which a command fails."""
    capsys.readouterr()
    assert main(list(arguments)) == status
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith("error: ")
    return lines[0]


def interrupted_before_it_follows(*arguments: str) -> int:
    """Exit status of a link that Ctrl-C reaches once it has its journal, before anything is compiled."""

    def interrupt(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code is LinkEngine.__init__.__code__:
            raise KeyboardInterrupt

    before = sys.gettrace()
    sys.settrace(interrupt)
    try:
        return main(["live", *arguments])
    finally:
        sys.settrace(before)


def test_a_link_that_is_interrupted_before_anything_came_tells_so(tmp_path, capsys):
    (tmp_path / "link.toml").write_text(LINK)
    (tmp_path / "flight.jsonl").touch()
    link, out = tmp_path / "link.toml", tmp_path / "out"
    assert interrupted_before_it_follows(str(link), "--headless", "--out", str(out)) == 130
    told = capsys.readouterr()
    assert "nothing had come: no journal is kept" in told.out
    assert "interrupted: nothing was left half-written" in told.err
    assert not out.exists()


@pytest.mark.thorough
def test_a_link_that_is_interrupted_again_tells_what_its_journal_keeps(tmp_path, capsys):
    given = (str(of_vehicle(tmp_path, frames=2)), "--headless", "--out", str(out := tmp_path / "out"))
    assert main(["live", *given, "--quiet"]) == 0
    open_again(out / "journal.bin")  # as where the process was killed
    (out / "live.json").unlink()
    assert interrupted_before_it_follows(*given) == 130
    told = " ".join(capsys.readouterr().out.split())
    assert "journal.bin keeps what came: the same command goes on from it" in told


@pytest.mark.thorough
def test_the_end_of_a_link_tells_its_estimates_counts_and_records(cut: Path, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["live", "--replay", str(cut), "--speed", "0", "--headless", "--out", str(out)]) == 0
    told, found = " ".join(capsys.readouterr().out.split()), read_json(out / "live.json")
    record, (point,) = load_record(cut), found["state"]["points"].values()
    fitted = point["parameters"]["ratio.scale"]
    assert f"{fitted['value']:.4g} +- {fitted['sigma']:.2g}" in told
    assert f"{point['surface_K']:.1f} +- {point['surface_sigma_K']:.1f}" in told
    assert f"{found['counts']['frames']} frames and {found['counts']['readings']} readings" in told
    assert found["counts"]["readings"] == len(record.sensors) * len(record.time_s)
    assert f"Missing effect: {found['state']['missing']['text']}" in told
    assert f"{out / 'records'}, one of each control point" in told


@pytest.mark.thorough
def test_the_report_of_a_link_holds_each_point_s_histories_and_ratio(replayed: Path):
    found, page = read_json(replayed / "live.json"), (replayed / "report.html").read_text()
    (point,) = found["control_points"]
    charts = [json.loads(data) for data in re.findall(r'<script type="application/json">(.*?)</script>', page, re.S)]
    assert [chart["title"] for chart in charts] == [f"{point}, histories", f"{point}, heating ratio"]
    labels = [panel["label"] for panel in charts[0]["panels"]]
    assert labels[:2] == ["surface, K", "bondline, K"]
    for sensor in found["state"]["points"][point]["sensors"]:
        assert f"{sensor}, K" in labels
    surface = charts[0]["panels"][0]["curves"][0]
    assert sum(surface["y"]) * surface["step"] == pytest.approx(found["state"]["points"][point]["surface_K"], abs=5.0)
    assert "What came" in page


@pytest.mark.thorough
def test_the_end_of_a_link_states_what_supports_its_estimates(replayed: Path, capsys):
    """A replayed record: its flight and its model are those of the record, and its readings are met as noise allows."""
    block = read_json(replayed / "live.json")["credibility"]
    assert {"record cut", "journal.bin"} <= set(block["files"])
    assert block["region"]["inside"] < 1.0  # p06 is no measured flight
    assert block["region"]["outside"]
    assert "running filter" in block["verification"]["uncovered"]
    assert block["evidence"]["uncertainty.consistent"]["met"]
    assert "no control point has a temperature limit" in block["evidence"]["robustness.holds"]["finding"]
    assert ">Credibility</h2>" in (replayed / "report.html").read_text()
    assert main(["credibility", str(replayed)]) == 0
    assert "live.json" in capsys.readouterr().out


@pytest.mark.thorough
def test_telemetry_states_no_source_and_a_surface_near_its_limit_is_told(tmp_path):
    """What flies beyond a socket is not known to the link; the vehicle and its limits are."""
    link = of_vehicle(tmp_path)
    assert main(["live", str(link), "--headless", "--out", str(tmp_path / "out"), "--quiet"]) == 0
    block = read_json(tmp_path / "out" / "live.json")["credibility"]
    assert block["factors"]["input_pedigree"]["level"] == 1
    assert "telemetry of source json-lines" in block["evidence"]["inputs.sources"]["finding"]
    assert block["evidence"]["robustness.holds"]["met"]
    assert "vehicle orbiter" in block["files"]


@pytest.mark.thorough
def test_json_is_one_object_with_the_last_state(cut: Path, tmp_path, capsys):
    found = run_json(capsys, "live", "--replay", str(cut), "--speed", "0", "--headless", "--out", str(tmp_path / "o"))
    assert found["results"] == read_json(tmp_path / "o" / "live.json")
    assert found["results"]["state"]["link"]["state"] == "ended"


@pytest.mark.thorough
def test_the_record_of_a_replayed_record_is_estimated(replayed: Path, cut: Path, tmp_path, capsys):
    (point,) = read_json(replayed / "live.json")["control_points"]
    record = replayed / "records" / point
    main(["live", "--to-record", str(replayed), "--out", str(tmp_path / "again"), "--quiet"])
    assert (tmp_path / "again" / "thermocouples.csv").read_bytes() == (record / "thermocouples.csv").read_bytes()
    fit = ["estimate", "--parameters", "ratio.scale", "--start", "circuit:620"]
    of_link = run_json(capsys, *fit, str(tmp_path / "again"), "--out", str(tmp_path / "a"))["results"]
    # the link came up in flight: its record carries the temperatures in depth that conduct to the first readings
    write_record(with_heated_start(load_record(cut)), tmp_path / "sent")
    of_sent = run_json(capsys, *fit, str(tmp_path / "sent"), "--out", str(tmp_path / "b"))["results"]
    assert of_link["parameters"] == of_sent["parameters"]


@pytest.mark.thorough
def test_the_record_of_a_vehicle_s_link_is_estimated(tmp_path, capsys):
    link = of_vehicle(tmp_path)
    run_json(capsys, "live", str(link), "--headless", "--out", str(tmp_path / "o"))
    fit = ["estimate", str(tmp_path / "o" / "records" / POINT), "--parameters", "ratio.scale"]
    found = run_json(capsys, *fit, "--out", str(tmp_path / "f"))["results"]["parameters"]["ratio.scale"]
    assert found["value"] == pytest.approx(SCALE, abs=3.0 * found["sigma"])


def test_a_port_in_use_is_one_line(tmp_path, capsys):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = str(other.getsockname()[1])
        told = the_error(capsys, "live", str(of_vehicle(tmp_path)), "--port", port, "--out", str(tmp_path / "o"))
    assert f"page: port {port} of 127.0.0.1 is in use" in told


@pytest.mark.thorough
def test_a_headless_link_serves_its_metrics_where_that_is_asked_for(tmp_path, capsys):
    port = str(free_port(socket.SOCK_STREAM))
    for name, options, text in (("a", ["--metrics"], LINK), ("b", [], LINK + "\n[output]\nmetrics = true\n")):
        (tmp_path / name).mkdir()
        link = of_vehicle(tmp_path / name, text, frames=3)
        out = str(tmp_path / name / "o")
        assert main(["live", str(link), "--headless", "--port", port, "--out", out, *options]) == 0
        assert f"metrics: http://127.0.0.1:{port}/metrics" in " ".join(capsys.readouterr().err.split())


def test_page_options_without_a_page_and_a_short_token_are_one_line(tmp_path, capsys):
    link, out = str(of_vehicle(tmp_path, frames=1)), ["--out", str(tmp_path / "o")]
    told = the_error(capsys, "live", link, "--headless", "--token", "x" * 16, *out)
    assert "--token: this link has no page; serve its metrics alone by --metrics" in told
    told = the_error(capsys, "live", link, "--host", "0.0.0.0", "--token", "guess", *out)
    assert "a token has at least 16" in told
    assert not (tmp_path / "o").exists()


def test_a_mapping_of_an_unknown_condition_is_one_line(tmp_path, capsys):
    link = of_vehicle(tmp_path, LINK + '\n[conditions]\nalpa_deg = { field = "a" }\n')
    told = the_error(capsys, "live", str(link), "--headless", "--out", str(tmp_path / "o"))
    assert "did you mean `alpha_deg`" in told


def test_impossible_running_estimate_is_refused_before_the_start(cut: Path, tmp_path, capsys):
    head = f'format = "link/1"\nrecords = ["{cut}"]\n[[source]]\nkind = "replay"\nspeed = 0.0\n[estimate]\n'
    first, clock = load_record(cut).used_sensors[0].name, 'parameters = ["ratio.scale", "clock.skew"]\n'
    cases = {
        f'parameters = ["sensor.{first}.tau_s"]': f"`sensor.{first}.tau_s`: a running estimate cannot have it",
        'parameters = ["ratio.scale", "sensors.tau_s"]': "`sensors.tau_s`: a running estimate cannot have it",
        clock + 'fix = { "clock.skew" = 0.5 }': "`clock.skew` is in `fix` and in `parameters`",
        clock + 'prior = { "clock.skew" = [4.0, 0.5] }': "`clock.skew` = 4 s: readings would belong outside the window",
        'fix = { "clock.skew" = -3.0 }': "raise `lateness_s` or `jump_s`",
    }
    for k, (keys, problem) in enumerate(cases.items()):
        path, root = tmp_path / f"{k}.toml", ["--root", "/"]
        path.write_text(head + keys)
        told = the_error(capsys, "validate", str(path), *root)
        assert problem in told
        assert the_error(capsys, "live", str(path), "--headless", "--out", str(tmp_path / str(k)), *root) == told
    path.write_text(f"{path.read_text()}\njump_s = 3.5")  # as the last of them proposes
    assert main(["validate", str(path), *root]) == 0


@pytest.mark.thorough
def test_known_recorder_skew_is_removed_from_estimate_and_record(cut: Path, tmp_path, capsys):
    sent = load_record(cut)
    late = replace(sent, thermocouples={**sent.thermocouples, "time_s": sent.time_s + 1.0})
    write_record(late, tmp_path / "late")
    head = 'format = "link/1"\nrecords = ["{}"]\n[[source]]\nkind = "replay"\nspeed = 0.0\n[estimate]\nparameters = '
    (tmp_path / "a.toml").write_text(head.format(cut) + '["ratio.scale"]')
    (tmp_path / "b.toml").write_text(head.format("late") + '["ratio.scale"]\nfix = { "clock.skew" = 1.0 }')
    found = [
        run_json(capsys, "live", str(tmp_path / f"{k}.toml"), "--headless", "--root", "/", "--out", str(tmp_path / k))
        for k in "ab"
    ]
    (of_sent, of_late) = (next(iter(f["results"]["state"]["points"].values())) for f in found)
    assert of_late["parameters"]["ratio.scale"]["value"] == pytest.approx(
        of_sent["parameters"]["ratio.scale"]["value"], abs=0.1 * of_sent["parameters"]["ratio.scale"]["sigma"]
    )
    records = [next((tmp_path / k / "records").rglob("record.toml")).parent for k in "ab"]
    np.testing.assert_allclose(load_record(records[1]).time_s, load_record(records[0]).time_s)


def test_a_field_that_is_never_sent_is_named(tmp_path, capsys):
    link = of_vehicle(tmp_path, LINK + '\n[conditions]\nalpha_deg = { field = "alpha_dg" }\n', frames=60)
    assert main(["live", str(link), "--headless", "--out", str(tmp_path / "o")]) == 0
    assert (
        "field `alpha_dg` (alpha_deg) is not sent; did you mean `alpha_deg`?"
        in read_json(tmp_path / "o" / "live.json")["remarks"]
    )


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="for the administrator no folder is read-only")
def test_a_read_only_place_is_one_line(tmp_path, capsys):
    place = tmp_path / "locked"
    place.mkdir(mode=0o500)
    assert str(place) in the_error(capsys, "live", str(of_vehicle(tmp_path)), "--headless", "--out", str(place / "o"))


def test_a_file_in_the_place_of_results_is_one_line(tmp_path, capsys):
    (tmp_path / "o").write_text("mine")
    told = the_error(capsys, "live", str(of_vehicle(tmp_path)), "--headless", "--out", str(tmp_path / "o"))
    assert "is a file; name a directory for the results" in told


@pytest.mark.thorough
@pytest.mark.skipif(os.name != "posix", reason="a limit on the size of files")
def test_full_disk_prints_estimates_and_fails_in_one_line(tmp_path, capsys):
    import resource

    link = of_vehicle(tmp_path)
    # kernels are compiled: their files are larger
    assert main(["live", str(link), "--headless", "--out", str(tmp_path / "first")]) == 0
    capsys.readouterr()
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1500, hard))
    try:
        status = main(["live", str(link), "--headless", "--out", str(tmp_path / "o")])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    told = capsys.readouterr()
    assert status == 1
    assert len(told.err.strip().splitlines()) == 1
    assert "File too large; the last" in (said := " ".join(told.out.split()))
    assert "messages are not in it" in said
    assert "Came: 30 messages, 30 frames" in told.out


def recorded(folder: Path) -> Path:
    """The directory of a flight that came once and has ended."""
    link, out = of_vehicle(folder), folder / "flight"
    assert main(["live", str(link), "--headless", "--out", str(out), "--quiet"]) == 0
    return out


@pytest.mark.thorough
def test_a_replay_leaves_the_journal_of_a_flight_alone(cut: Path, tmp_path, capsys):
    flight = recorded(tmp_path)
    before = {p.name: p.read_bytes() for p in flight.iterdir() if p.is_file()}
    told = the_error(capsys, "live", "--replay", str(cut), "--speed", "0", "--headless", "--out", str(flight))
    assert "journal.bin: holds a flight that has ended" in told
    assert "name another directory" in told
    told = the_error(capsys, "live", "--replay", str(cut), "--headless", "--out", str(flight), "--force")
    assert "journal.bin: holds a flight that has ended" in told
    assert {p.name: p.read_bytes() for p in flight.iterdir() if p.is_file()} == before


@pytest.mark.thorough
def test_a_replay_goes_by_default_into_a_folder_that_is_not_the_flight_s(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["live", str(of_vehicle(tmp_path)), "--headless", "--quiet"]) == 0
    before = (Path("out") / "link" / "journal.bin").read_bytes()
    record = Path("out") / "link" / "records" / POINT
    assert main(["live", "link.toml", "--replay", str(record), "--speed", "0", "--headless", "--quiet"]) == 0
    assert (Path("out") / "link-replay" / "live.json").is_file()
    assert main(["live", "--replay", str(record), "--speed", "0", "--headless", "--quiet"]) == 0
    assert (Path("out") / f"{POINT}-replay" / "live.json").is_file()
    assert (Path("out") / "link" / "journal.bin").read_bytes() == before


@pytest.mark.thorough
def test_replay_is_repeated_in_its_folder_and_no_other_record(replayed: Path, cut: Path, capsys):
    before = (replayed / "journal.bin").read_bytes()
    other = part_of_record(PRACTICE / "p06", 600.0, 620.0, cut.parent / "other")
    out = ["--speed", "0", "--headless", "--out", str(replayed)]
    assert "holds a flight that has ended" in the_error(capsys, "live", "--replay", str(other), *out)
    assert (replayed / "journal.bin").read_bytes() == before
    assert main(["live", "--replay", str(cut), *out, "--quiet"]) == 0
    assert (replayed / "journal.bin").read_bytes() != before


def test_a_record_is_never_among_the_results_of_its_replay(cut: Path, tmp_path, capsys):
    record = part_of_record(cut, 600.0, 620.0, tmp_path / "d" / "record")
    before = sorted(p.name for p in record.rglob("*"))
    for out, relation in ((record, "is the input"), (record.parent, "contains the input"), (record / "o", "lies in")):
        told = the_error(capsys, "live", "--replay", str(record), "--headless", "--out", str(out), "--force")
        assert relation in told
    assert sorted(p.name for p in record.rglob("*")) == before
    assert sorted(p.name for p in record.parent.iterdir()) == ["record"]


@pytest.mark.parametrize("name", ["live.json", "report.html", f"records/{POINT}/record.toml"])
def test_foreign_result_is_refused_before_any_message_is_taken(tmp_path, capsys, name):
    link, out = of_vehicle(tmp_path), tmp_path / "o"
    (out / name).parent.mkdir(parents=True)
    (out / name).write_text("mine")
    told = the_error(capsys, "live", str(link), "--headless", "--out", str(out))
    assert f"{name} already exists and was not written by sim-heating" in told
    assert not (out / "journal.bin").exists()
    assert (out / name).read_text() == "mine"


def test_a_file_in_the_place_of_the_records_is_refused_before_any_message_is_taken(tmp_path, capsys):
    link, out = of_vehicle(tmp_path), tmp_path / "o"
    out.mkdir()
    (out / "records").write_text("mine")
    for options in ([], ["--force"]):
        told = the_error(capsys, "live", str(link), "--headless", "--out", str(out), *options)
        assert "records: is a file in the place of a folder; move it away or choose another directory" in told
    assert [p.name for p in out.iterdir()] == ["records"]
    assert (out / "records").read_text() == "mine"


@pytest.mark.thorough
@pytest.mark.filterwarnings("default:.*replaced live.json")
def test_unwritable_results_leave_a_flight_that_can_go_on(tmp_path, capsys, monkeypatch):
    """Someone writes a file of a result's name while the flight is flown."""
    import sim_heating.live.run as live_run

    link, out, run = of_vehicle(tmp_path), tmp_path / "o", live_run.run

    def disturbed(*args, **options):
        state = run(*args, **options)
        (out / "live.json").write_text("mine")
        return state

    with monkeypatch.context() as within:
        within.setattr(live_run, "run", disturbed)
        assert main(["live", str(link), "--headless", "--out", str(out)]) == 2
    told = capsys.readouterr()
    assert "holds the flight and is not closed" in " ".join((told.out + told.err).split())
    assert main(["live", str(link), "--headless", "--out", str(out), "--force", "--quiet"]) == 0
    assert read_json(out / "live.json")["counts"]["frames"] == 30


@pytest.mark.thorough
def test_another_link_file_does_not_go_on_with_a_flight(tmp_path, capsys):
    """Degrees Fahrenheit would be read as kelvins."""
    sensor = f'\n[[sensor]]\nsensor = "{POINT}"\nfield = "{POINT}_K"\nunit = "{{}}"\n'
    (tmp_path / "a").mkdir()
    link, out = of_vehicle(tmp_path / "a", LINK + sensor.format("degF")), tmp_path / "o"
    assert main(["live", str(link), "--headless", "--out", str(out), "--quiet"]) == 0
    open_again(out / "journal.bin")
    before = (out / "journal.bin").read_bytes()
    link.write_text(LINK + sensor.format("K"))
    told = the_error(capsys, "live", str(link), "--headless", "--out", str(out))
    assert 'was begun with another link: `sensor 1.unit` was "degF", now "K"' in told
    assert main(["live", str(link), "--to-record", str(out), "--out", str(tmp_path / "k")]) == 0  # as it was asked for
    told = " ".join(capsys.readouterr().out.split())
    assert 'in another way than the link that wrote it: `sensor 1.unit` was "degF", now "K"' in told
    link.write_text(LINK.replace("[[source]]", '[[source]]\nkind = "jsbsim"\nport = 5501\n[[source]]'))
    told = the_error(capsys, "live", str(link), "--headless", "--out", str(out))
    assert "[[source]]: there were 1, now 2" in told
    told = the_error(capsys, "live", str(link), "--to-record", str(out), "--out", str(tmp_path / "r"))
    assert "its sources (jsbsim, json-lines) are not those of" in told
    assert (out / "journal.bin").read_bytes() == before


@pytest.mark.thorough
def test_damage_of_a_journal_is_told_with_the_record_that_is_made_of_it(tmp_path, capsys):
    flight = recorded(tmp_path)
    data = bytearray((flight / "journal.bin").read_bytes())
    data[data.index(b'"time_s": 7.0')] ^= 1
    (flight / "journal.bin").write_bytes(data)
    assert main(["live", "--to-record", str(flight), "--out", str(tmp_path / "r")]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "1 message of" in told
    assert "behind message 7, are damaged and skipped" in told
    assert len(load_record(tmp_path / "r").time_s) == 29


@pytest.mark.thorough
def test_a_file_that_is_followed_again_brings_back_what_was_damaged(tmp_path):
    """The file has the message still that the journal has lost; it comes behind the others, and is in the record."""
    link, out = of_vehicle(tmp_path), tmp_path / "o"
    assert main(["live", str(link), "--headless", "--out", str(out), "--quiet"]) == 0
    open_again(out / "journal.bin")
    data = bytearray((out / "journal.bin").read_bytes())
    data[data.index(b'"time_s": 7.0')] ^= 1
    (out / "journal.bin").write_bytes(data)
    assert main(["live", str(link), "--headless", "--out", str(out), "--quiet"]) == 0
    assert (out / "journal.damaged-1.bin").read_bytes() == bytes(data)
    remarks = read_json(out / "live.json")["remarks"]
    assert any("behind message 7, are damaged and skipped" in line for line in remarks)
    assert any("the damaged journal is kept as" in line for line in remarks)
    assert len(load_record(out / "records" / POINT).time_s) == 30


def test_options_that_contradict_are_usage_errors(tmp_path, capsys):
    assert "--speed is that of --replay or --demo" in the_error(capsys, "live", "link.toml", "--speed", "2")
    assert "--demo flies by itself" in the_error(capsys, "live", "--demo", "--replay", "record")
    assert "Missing argument 'LINK'" in the_error(capsys, "live")
    assert "--to-record needs --out" in the_error(capsys, "live", "--to-record", str(tmp_path))
