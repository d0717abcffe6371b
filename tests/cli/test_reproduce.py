"""A result states what made it, and the command that made it gives the same bytes again."""

from __future__ import annotations

import json
import logging
import re
import shutil
from pathlib import Path

import pytest
import xarray as xr

from sim_heating.base.files import read_json
from sim_heating.cli import main
from tests.support.gliding import gliding
from tests.support.json_output import run_json
from tests.support.paths import TILE


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(TILE, tmp_path / "tile")
    return tmp_path


def test_a_prediction_repeated_has_the_same_bytes(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["predict", "tile", "--out", "out", "--quiet"]) == 0
    block = read_json("out/summary.json")["provenance"]
    assert block["command"] == ["predict", "tile"]
    assert set(block["inputs"]) == {"tile"}
    assert {"sim-heating", "python", "numpy"} <= set(block["versions"])
    found = run_json(capsys, "reproduce", "out")
    assert found["results"]["differences"] == []
    assert found["results"]["same"] == found["results"]["files"] >= 5


@pytest.mark.thorough
def test_a_changed_input_and_what_it_changes_are_named(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["predict", "tile", "--out", "out", "--quiet"]) == 0
    record = home / "tile" / "record.toml"
    changed = re.sub(r"(?m)^initial_profile = .*$", "initial_profile = [[0.0, 320.0]]", text := record.read_text())
    assert changed != text
    record.write_text(changed)
    capsys.readouterr()
    assert main(["reproduce", "out/summary.json"]) == 1
    printed = capsys.readouterr().out
    assert "input tile: was changed since" in printed
    assert "summary.json: fit.rmse_K: " in printed


def test_a_result_written_from_python_states_no_command(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import sim_heating as sh

    sh.write_prediction(sh.predict("tile"), "out")
    assert read_json("out/summary.json")["provenance"]["command"] is None
    assert main(["reproduce", "out"]) == 2
    assert "written from Python, and states no command" in capsys.readouterr().err


@pytest.mark.thorough
def test_a_run_repeated_has_the_same_bytes_and_netcdf(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("glide.toml").write_text(gliding(60.0, "V09T9527", "LEE_UPPER"))
    assert main(["run", "glide.toml", "--out", "out", "--quiet"]) == 0
    with xr.open_dataset("out/flight.nc", decode_timedelta=False) as data:
        assert data.attrs["history"].endswith("sim-heating run glide.toml")
        assert json.loads(data.attrs["provenance"]) == read_json("out/summary.json")["provenance"]
        assert data["time"].units == "s"
        assert data["H_r_J_kg"].dims == ("control_point", "time")
        assert all("long_name" in data[name].attrs for name in data.variables)
    capsys.readouterr()
    found = run_json(capsys, "reproduce", "out/flight.nc")["results"]
    assert (found["same"], found["differences"]) == (1, [])
    found = run_json(capsys, "reproduce", "out")["results"]
    assert found["same"] == found["files"]


@pytest.mark.thorough
def test_a_campaign_repeated_names_its_records_in_another_folder_and_is_the_same(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    popu = "[[trajectory.manoeuvre]]\nkind = 'popu'\nat_time_s = 60.0\ndown_deg = 3.0\nup_deg = 3.0\nrate_deg_s = 1.0\n"
    Path("flight.toml").write_text(gliding(150.0, "V09T9527") + popu)
    fit = '[[flight]]\nscenario = "flight.toml"\nseeds = [1]\n[fit]\nparameters = ["ratio.scale"]\n'
    head = 'format = "campaign/1"\ntitle = "One"\nvehicle = "orbiter"\nclose_loop = false\nupdate_tables = false\n'
    Path("one.toml").write_text(head + fit)
    assert main(["campaign", "one.toml", "--workers", "1", "--out", "out", "--quiet"]) == 0
    assert list(Path("out").glob("fits/**/estimate.json"))
    capsys.readouterr()
    found = run_json(capsys, "reproduce", "out")["results"]
    assert (found["same"], found["differences"]) == (found["files"], [])


@pytest.mark.thorough
def test_v_logs_what_is_written_to_standard_error(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["predict", "tile", "--out", "out", "-v"]) == 0
    assert "INFO sim_heating.base.files.results: predict: wrote" in capsys.readouterr().err
    assert not [h for h in logging.getLogger("sim_heating").handlers if not isinstance(h, logging.NullHandler)]
