"""A platform without JSBSim, for which there is no wheel of it: all but its flights works, and those say what to do."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from sim_heating.cli.simulate import with_installed_source
from sim_heating.inputs.scenario import load_scenario
from sim_heating.trajectory import entry3dof
from sim_heating.trajectory.manoeuvres import NOT_FLOWN
from tests.support.paths import ROOT, SCENARIOS, TILE

WITHOUT = """
import sys

import pytest
sys.modules["jsbsim"] = None  # its import fails, as where it is not installed
from sim_heating.__main__ import main
for arguments in {commands}:
    sys.argv = ["sim-heating", *arguments]
    print("exit status", main(), flush=True)
"""
DETERMINED = "ratio.scale"


@pytest.mark.thorough
def test_what_does_not_fly_in_jsbsim_works_and_what_does_says_what_to_install(tmp_path):
    commands = [
        ["predict", str(TILE), "--out", "predicted"],
        ["estimate", str(TILE), "--parameters", DETERMINED, "--out", "fit"],
        ["validate", str(SCENARIOS / "popu_mach20.toml")],
        ["run", str(SCENARIOS / "popu_mach20.toml"), "--out", "popu"],
    ]
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT.format(commands=commands)],
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    statuses = [line for line in done.stdout.splitlines() if line.startswith("exit status")]
    assert statuses == ["exit status 0"] * 3 + ["exit status 2"], done.stderr
    (problem,) = [line for line in done.stderr.splitlines() if line.startswith("error:")]
    assert "JSBSim is not installed: pip install 'sim-heating[jsbsim]'" in problem
    assert 'source = "entry-3dof"' in problem
    assert (tmp_path / "fit" / "estimate.json").is_file()
    assert not (tmp_path / "popu").exists()


def test_the_demo_is_flown_in_three_degrees_of_freedom_with_its_manoeuvre(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "jsbsim", None)
    scenario = with_installed_source(load_scenario(SCENARIOS / "popu_mach20.toml"))
    spec = scenario.declared.trajectory
    flight = entry3dof.fly(spec.model_copy(update={"rate_hz": 4.0, "sample_s": 1.0}), scenario.vehicle)
    assert spec.source == "entry-3dof"
    assert "JSBSim is not installed" in capsys.readouterr().out
    assert not any(text.endswith(NOT_FLOWN) for _, text in flight.events)
