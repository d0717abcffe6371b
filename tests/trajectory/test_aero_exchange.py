"""Aerodynamics of a vehicle to DAVE-ML and back."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.cli import main
from sim_heating.heating.exchange.dave_ml import read_dave_ml
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.trajectory.aero import load_aero
from sim_heating.trajectory.aero_exchange import import_aero


@pytest.mark.parametrize("vehicle", ["orbiter", "capsule"])
def test_a_vehicle_flies_the_same_after_dave_ml_and_back(tmp_path, monkeypatch, vehicle):
    monkeypatch.chdir(tmp_path)
    place = load_vehicle(vehicle).directory
    assert main(["table", f"{vehicle}/aero", "--out", "aero.dml"]) == 0
    assert read_dave_ml("aero.dml").check_problems() == []
    shutil.copytree(place, "copy")
    assert main(["table", "aero.dml", "--out", "copy/aero"]) == 2  # tables are there
    before = load_aero(place)
    for name in ("longitudinal", "elevon", "bodyflap"):
        (tmp_path / "copy" / "aero" / f"{name}.csv").unlink(missing_ok=True)
    tables = before.file.tables
    made = {path.stem: path for path in import_aero("aero.dml", "made")}
    for name, file in (("longitudinal", tables.longitudinal), ("elevon", tables.elevon), ("bodyflap", tables.bodyflap)):
        if file is not None:
            shutil.copy(made[name], tmp_path / "copy" / "aero" / str(file))
    after = load_aero(tmp_path / "copy")
    rng = np.random.default_rng(3)
    for mach, alpha, elevon, flap in rng.uniform((1.0, -5.0, -40.0, -15.0), (28.0, 55.0, 20.0, 25.0), (200, 4)):
        x = (float(mach), float(alpha), float(elevon), float(flap))
        assert np.allclose(after.body_coefficients(*x), before.body_coefficients(*x), rtol=0.0, atol=1e-9)


def test_a_model_of_other_coefficients_is_refused(tmp_path):
    assert main(["table", "capsule/FACE", "--out", str(tmp_path / "face.dml")]) == 0
    with pytest.raises(InputError, match=r"face\.dml: no output named `CN`; CN, CA and Cm are read"):
        import_aero(tmp_path / "face.dml", tmp_path / "aero")
