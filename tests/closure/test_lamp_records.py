"""Records without reference heating, as under a lamp, and what the declared model is fitted with."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from sim_heating.base.errors import InputError
from sim_heating.cli import cli
from sim_heating.closure.close import close_loop
from sim_heating.closure.clues.residual_heating import residual_heating
from sim_heating.closure.search.trials.trial_fit import declared_fit
from sim_heating.estimation.inference.observability import default_names
from sim_heating.inputs.record import Record, load_record, write_record
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.simulation.ground_step import step_record
from tests.support.paths import PRACTICE

CONDUCTIVITY = "stack.rsi.conductivity_factor"
FLUX_W_M2 = 50e3


def lit(flux_W_m2: float = FLUX_W_M2, **parameters: float) -> Record:
    """A plug under a lamp, with a truth that differs from its declaration."""
    vehicle = load_vehicle("orbiter")
    return step_record(vehicle, vehicle.control_point("V09T9527"), flux_W_m2, **parameters)


def test_a_wrong_conductivity_is_found_under_a_lamp(tmp_path: Path) -> None:
    write_record(lit(parameters={CONDUCTIVITY: 0.95}), tmp_path / "lit")
    result = CliRunner().invoke(cli, ["close-loop", str(tmp_path / "lit"), "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    found = json.loads((tmp_path / "out" / "closure.json").read_text())
    assert found["finding"] == "found"
    assert found["effect"]["name"] == "conductivity"
    factor = found["effect"]["parameters"]["conductivity_factor"]
    assert factor["value"] == pytest.approx(0.95, abs=4.0 * factor["sigma"])
    assert found["adequacy"]["p_value"] > 0.01
    assert not [name for name in found["estimated"] if name.startswith("ratio.")]
    assert (tmp_path / "out" / "residual_heating.csv").read_text().startswith("time_s,delta_q_W_m2,sigma_W_m2")


def test_the_missing_flux_under_a_lamp_is_that_of_a_brighter_lamp() -> None:
    """Readings of a lamp 3 % brighter than the conditions state, at the times when it is lit."""
    brighter = lit(1.03 * FLUX_W_M2)
    stated = brighter.conditions.with_columns(q_add_W_m2=brighter.conditions["q_add_W_m2"] / 1.03)
    before = declared_fit(Record(**{**vars(brighter), "conditions": stated}))
    missing = residual_heating(before.problem, before.fit.values)
    assert missing.flux_W_m2 == pytest.approx(FLUX_W_M2)
    on = (missing.time_s > 25.0) & (missing.time_s < 60.0)
    off = missing.time_s > 120.0
    assert np.mean(missing.delta_ratio[on]) == pytest.approx(0.03, abs=0.003)
    assert np.mean(missing.delta_ratio[off]) == pytest.approx(0.0, abs=0.003)


def test_what_the_declared_model_is_fitted_with_is_not_found_as_an_effect() -> None:
    """p09 has another conductivity; fitted with it, the declared model explains the record."""
    record = load_record(PRACTICE / "p09")
    names = [*default_names([record]), CONDUCTIVITY]
    closed = close_loop(record, names)
    assert closed.effects == ("none",)
    assert not [c for c in closed.search.rounds[0].tried if CONDUCTIVITY in c.model_names]
    assert closed.report.statement.adequacy is not None
    assert closed.report.statement.adequacy.p_value > 0.01
    assert {"ratio.scale", CONDUCTIVITY} < set(closed.report.parameters) <= set(names)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ("ratio.scale,stack.rsi.conductivty_factor", "did you mean `stack.rsi.conductivity_factor`?"),
        ("sensor.LS_surfac.bias", "unknown or unused sensor `LS_surfac`"),
        (",", "--parameters: holds no name"),
    ],
)
def test_an_unknown_parameter_is_refused_in_one_line(names: str, message: str, tmp_path: Path) -> None:
    arguments = ["close-loop", str(PRACTICE / "p06"), "--parameters", names, "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(cli, arguments)
    assert isinstance(result.exception, InputError)
    assert message in str(result.exception)
    assert "\n" not in str(result.exception)
    assert not (tmp_path / "out").exists()
