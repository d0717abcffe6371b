"""A manoeuvre that is faster than the samples of its flight: conditions are kept as fine as it asks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.conditions import LINE_TOLERANCE, LINE_TOLERANCE_SHARE, Conditions
from sim_heating.estimation.fit import estimate
from sim_heating.inputs.points import conditions_at_point
from sim_heating.inputs.record import load_record
from sim_heating.inputs.scenario import Scenario, load_scenario
from sim_heating.simulation.run import fly_scenario
from sim_heating.simulation.synthesize import synthesize, write_records
from sim_heating.trajectory.flight import Flight
from tests.support.gliding import gliding

pytestmark = pytest.mark.thorough

PLUG = "V09T9527"
FAST_POPU = """
[[trajectory.manoeuvre]]
kind = "popu"
at_velocity_m_s = 6130.0
rate_deg_s = 4.0
hold_s = 0.4
[measurements]
seed = 3
"""


def fast_popu(folder: Path, sample_s: float) -> tuple[Scenario, Flight]:
    """A pushover-pullup within 6 s, in 20 frames a second."""
    text = gliding(150.0, PLUG, altitude_m=72000.0, velocity_m_s=6200.0) + FAST_POPU
    rates = f'source = "entry-3dof"\nrate_hz = 20.0\nsample_s = {sample_s}'
    file = folder / f"popu_{sample_s}.toml"
    file.write_text(text.replace('source = "entry-3dof"', rates))
    scenario = load_scenario(file)
    return scenario, fly_scenario(scenario)


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scenario, Flight, Flight]:
    """A scenario with every frame of its flight kept, and the same flight with samples every second."""
    folder = tmp_path_factory.mktemp("fast")
    scenario, every_frame = fast_popu(folder, 0.05)
    return scenario, every_frame, fast_popu(folder, 1.0)[1]


def test_lines_between_the_kept_samples_miss_no_frame_of_the_flight(flights: tuple[Scenario, Flight, Flight]) -> None:
    _, every_frame, kept = flights
    frames = every_frame.conditions
    frames = frames.at(frames.time_s[frames.time_s <= kept.conditions.time_s[-1]])
    lines = kept.conditions.at(frames.time_s)
    for name, distance in LINE_TOLERANCE.items():
        allowed = distance + LINE_TOLERANCE_SHARE.get(name, 0.0) * np.abs(frames[name])
        assert np.all(np.abs(lines[name] - frames[name]) <= allowed * (1.0 + 1e-9))
    seconds = frames.at(np.arange(0.0, kept.conditions.time_s[-1] + 0.5)).at(frames.time_s)
    assert np.max(np.abs(seconds["alpha_deg"] - frames["alpha_deg"])) > 20.0 * LINE_TOLERANCE["alpha_deg"]


def test_only_the_manoeuvre_has_more_samples_than_one_a_second(flights: tuple[Scenario, Flight, Flight]) -> None:
    _, _, kept = flights
    time_s, window = kept.conditions.time_s, kept.windows[0]
    assert np.all(np.isin(np.arange(0.0, 150.0), time_s))
    between = time_s[np.mod(time_s, 1.0) > 1e-6]
    assert 4 <= len(between) < 30
    assert window.start_s - 1.0 < between[0]
    assert between[-1] < window.end_s + 5.0  # the elevon trims behind


def test_fast_popu_gives_an_unbiased_alpha_derivative_at_one_hertz(
    flights: tuple[Scenario, Flight, Flight],
) -> None:
    scenario, every_frame, kept = flights
    record = synthesize(scenario, flight=every_frame)[PLUG]
    point = scenario.vehicle.control_point(PLUG)

    def d_alpha(flown: Conditions) -> tuple[float, float]:
        """The derivative and its sigma, found with other conditions for the same temperatures."""
        with_conditions = replace(record, conditions=conditions_at_point(scenario.vehicle, point, flown))
        return estimate(with_conditions, ["ratio.scale", "ratio.d_alpha"]).parameters["ratio.d_alpha"]

    frames = every_frame.conditions
    exact, sigma = d_alpha(frames)
    off = abs(d_alpha(kept.conditions)[0] - exact)
    assert off < 0.05 * sigma
    one_a_second = frames.at(np.arange(0.0, frames.time_s[-1] + 1e-9))
    assert abs(d_alpha(one_a_second)[0] - exact) > 2.0 * off  # what samples of 1 Hz alone would cost


def test_a_synthetic_record_holds_the_samples_of_its_manoeuvre(
    flights: tuple[Scenario, Flight, Flight], tmp_path: Path
) -> None:
    scenario, _, kept = flights
    write_records(scenario, synthesize(scenario, flight=kept), tmp_path / "record")
    written = load_record(tmp_path / "record").conditions
    assert written.time_s == pytest.approx(kept.conditions.time_s, abs=1e-6)
    assert written["alpha_deg"] == pytest.approx(kept.conditions["alpha_deg"], abs=1e-4)
