"""An installation without FMPy, as the default one: flights of an imported FMU say what to install, exports work."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from sim_heating.base.errors import InputError
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.simulation.run import fly_fmu
from sim_heating.trajectory.spec import TrajectorySpec
from tests.support.paths import ORBITER, ROOT

WITHOUT = """
import sys

sys.modules["fmpy"] = None  # its import fails, as where it is not installed
import sim_heating.simulation.fmu_export.entry
import sim_heating.simulation.fmu_export.heating
import sim_heating.simulation.fmu_export.ssp
"""


def test_a_flight_of_an_fmu_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fmpy", None)
    spec = TrajectorySpec.model_validate({"source": "fmu", "file": "lander.fmu", "stop": {"time_s": 10.0}})
    with pytest.raises(InputError, match=r"is not installed: pip install 'sim-heating\[fmu-import\]'; or fly with"):
        fly_fmu(spec, load_vehicle(ORBITER))


def test_an_export_needs_no_fmpy() -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", WITHOUT], env=environment, check=True, timeout=120)
