"""Closing the loop on a flight of which one thermocouple, badly attached, follows its place late."""

from __future__ import annotations

from pathlib import Path

import pytest

from sim_heating.closure.close import close_loop
from sim_heating.inputs.scenario import load_scenario
from sim_heating.simulation.synthesize import synthesize
from tests.support.few_candidates import search_among
from tests.support.gliding import gliding

pytestmark = pytest.mark.thorough

POINT = "V09T9527"
AMONG = ("sensor-lag", "time-skew", "alpha-curvature", "coating-thickness", "conductivity")
ENTRY = """
[[trajectory.manoeuvre]]
kind = "popu"
at_time_s = 200.0
[[measurements.fault]]
sensor = "{sensor}"
tau_s = {tau_s}
"""


@pytest.mark.parametrize(
    ("sensor", "tau_s"),
    [
        pytest.param("V09T9527", 8.0, id="at the surface"),
        pytest.param("V07T9528", 30.0, id="long, 4 mm deep"),
    ],
)
def test_the_lag_of_one_thermocouple_is_found_and_is_no_skew_of_the_clock(
    tmp_path: Path, sensor: str, tau_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    search_among(monkeypatch, *AMONG)
    falling = gliding(280.0, POINT, altitude_m=100e3, velocity_m_s=7500.0).replace("gamma_deg = -0.1", "gamma_deg = -1")
    (tmp_path / "entry.toml").write_text(falling + ENTRY.format(sensor=sensor, tau_s=tau_s))
    record = synthesize(load_scenario(tmp_path / "entry.toml"))[POINT]
    closed = close_loop(record)
    (found,) = closed.report.effects
    assert (found.name, found.sensor) == ("sensor-lag", sensor)
    tau, skew = found.parameters["tau_s"], closed.report.parameters["clock.skew"]
    assert abs(tau.value - tau_s) < 4.0 * tau.sigma < 0.5
    assert abs(skew.value) < 4.0 * skew.sigma < 0.5
    assert closed.fitted.after[0].segment_errors()["fit"]["rmse_K"] < 1.1 * record.noise_floor_K()
