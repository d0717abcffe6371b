"""Closing the loop on flights whose record declares the transition of its boundary layer, and what goes to the
vehicle."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from sim_heating.cli import main
from sim_heating.closure.close import close_loop
from sim_heating.closure.revise.errors import held_fits
from sim_heating.closure.revise.update import prepare_update
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.report.estimate_file import write_estimate
from sim_heating.estimation.report.report import estimate_contents
from sim_heating.inputs.points import point_with_vehicle_table
from sim_heating.inputs.record import Record, load_record
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.simulation.predict import predict
from tests.support.few_candidates import search_among
from tests.support.transition_glide import EARLY, POINT, made

SCALE = 0.08
HOTTER = f'[truth.parameters]\n"ratio.scale" = {SCALE}\n'
ONSET = "effect.transition.log10_re_onset"
RIVALS = (
    "transition",
    "catalysis",
    "nonisothermal-wall",
    "emissivity",
    "impingement-onset",
    "conductivity",
    "time-skew",
)
"""Those of all effects that come closest to the transition, and two of another kind."""


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Records of a glide: `right`, as declared; `early`, whose layer turns earlier than declared; `hot`, with 8 % more
    heating, laminar and turbulent, in addition."""
    home = tmp_path_factory.mktemp("flights")
    for name, truth in (("right", ""), ("early", EARLY), ("hot", HOTTER + EARLY)):
        (home / name).mkdir()
        made(home / name, truth)
    return home


def flown(flights: Path, name: str) -> Record:
    return load_record(flights / name / "record")


@pytest.mark.thorough
def test_a_transition_that_is_as_declared_is_no_finding(flights: Path) -> None:
    assert close_loop(flown(flights, "right")).effects == ("none",)


@pytest.mark.thorough
def test_a_transition_earlier_than_declared_is_found_by_freeing_the_declared_one(
    flights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    search_among(monkeypatch, *RIVALS)
    record = flown(flights, "early")
    closed = close_loop(record)
    assert closed.effects == ("transition",)
    found = closed.report.effects[0].parameters["log10_re_onset"]
    assert abs(found.value - 2.42) < 3.0 * found.sigma
    assert closed.fitted.after[0].segment_errors()["fit"]["rmse_K"] < 1.1 * record.noise_floor_K()


@pytest.mark.thorough
def test_a_vehicle_takes_the_fitted_transition_at_this_point_and_keeps_its_own_elsewhere(
    flights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(flights)
    record = load_record("hot/record")
    write_estimate("fit.json", estimate_contents(estimate(record, ["ratio.scale", ONSET])))
    assert main(["update-tables", "fit.json", "--vehicle", "orbiter", "--out", "revised"]) == 0
    old, new = load_vehicle("orbiter"), load_vehicle("./revised/orbiter")
    values = {
        u.effect.name: dict(zip((p.name for p in u.definitions), u.values, strict=True))
        for u in new.control_point(POINT).effects
    }
    assert values["transition"]["log10_re_onset"] == pytest.approx(2.42, abs=2e-3)
    # Laminar and turbulent table both take the 8 %, so that the factor between the two stays.
    assert values["transition"]["factor"] == 1.0
    before, after = (v.control_point(POINT).flow.turbulent for v in (old, new))
    assert before is not None
    assert after is not None
    assert np.max(after.ratio / before.ratio) == pytest.approx(1.0 + SCALE, abs=0.01)
    assert (new.directory / "vehicle.toml").read_bytes() == (old.directory / "vehicle.toml").read_bytes()
    assert new.control_point("STS96_597").effects == old.control_point("STS96_597").effects
    model, flow = point_with_vehicle_table(record, new)
    assert predict(record, model, flow=flow).segment_errors()["fit"]["rmse_K"] < 1.1 * record.noise_floor_K()

    assert main(["update-tables", "--vehicle", "./revised/orbiter", "--revert", POINT]) == 0
    for folder in ("ratio_tables", "control_points"):
        for file in sorted((old.directory / folder).iterdir()):
            assert (new.directory / folder / file.name).read_bytes() == file.read_bytes()


@pytest.mark.thorough
def test_a_turbulent_table_that_points_share_stays_and_the_factor_takes_its_change(
    flights: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(flights)
    shutil.copytree(load_vehicle("orbiter").directory, tmp_path / "orbiter")
    other = tmp_path / "orbiter" / "control_points" / "STS96_597.toml"
    other.write_text(other.read_text().replace("STS96_597_turbulent.csv", f"{POINT}_turbulent.csv"))
    record = load_record("hot/record")
    write_estimate("shared.json", estimate_contents(estimate(record, ["ratio.scale", ONSET])))
    update = prepare_update("shared.json", tmp_path / "orbiter")
    assert update.turbulent is None
    (transition,) = (u for u in update.effects.after if u.effect.name == "transition")
    assert transition.by_name["factor"] == pytest.approx(1.0 + SCALE, abs=0.01)
    assert held_fits(update)["record"].is_held

    write_estimate("shared.json", estimate_contents(estimate(record, ["ratio.scale"])))
    update = prepare_update("shared.json", tmp_path / "orbiter")
    assert "turbulent heating is" in update.not_written["effect.transition"]
