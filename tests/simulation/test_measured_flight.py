"""What is measured of a flight and of a ground test: axial force of a transition, disturbed air data, constants."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.closure.clues.axial_force import axial_steps
from sim_heating.estimation.fit import estimate
from sim_heating.inputs.record import Record, load_record, write_record
from sim_heating.inputs.scenario import load_scenario
from sim_heating.simulation.synthesize import synthesize
from sim_heating.trajectory.recorded import read_conditions
from tests.support.gliding import gliding

POINT = "V09T9527"
GLIDE = gliding(180.0, POINT, altitude_m=74000.0)
ONSET = 6.0
TRANSITION = f"""
[[truth.effect]]
name = "transition"
parameters = {{ log10_re_onset = {ONSET}, width = 0.004, factor = 3.0 }}
"""
POPU_WITH_JETS = """
[[trajectory.manoeuvre]]
kind = "popu"
at_time_s = 90.0
[[trajectory.manoeuvre]]
kind = "jet-firing"
at_time_s = 89.0
on_s = 4.0
off_s = 6.0
count = 2
[measurements]
jet_q_fraction = 0.3
"""
"""Pitch jets that fire as the vehicle pitches down and up, and disturb the dynamic pressure."""


def record_of(folder: Path, more: str) -> Record:
    """Record of the glide with more tables; its sensors have noise of 0.5 K and no word."""
    file = folder / "glide.toml"
    file.write_text(GLIDE + more)
    loaded = load_scenario(file)
    point = loaded.vehicle.control_point(POINT)
    plain = {"bits": None, "range_K": None, "noise_sigma_K": 0.5}
    point = replace(point, sensors=tuple(s.model_copy(update=plain) for s in point.sensors))
    vehicle = replace(loaded.vehicle, control_points={**loaded.vehicle.control_points, POINT: point})
    return synthesize(replace(loaded, vehicle=vehicle))[POINT]


@pytest.fixture(scope="module")
def disturbed(tmp_path_factory: pytest.TempPathFactory) -> Record:
    return record_of(tmp_path_factory.mktemp("jets"), POPU_WITH_JETS)


# Axial force ----------------------------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_a_transition_in_the_truth_raises_the_axial_acceleration_in_a_step(tmp_path: Path) -> None:
    laminar = record_of(tmp_path, "")
    log10_re = laminar.conditions["log10_re"]
    onset = float(np.quantile(log10_re, 0.5))
    turbulent = record_of(tmp_path, TRANSITION.replace(str(ONSET), f"{onset:.4f}"))
    a, b = (r.conditions["axial_accel_g"] for r in (laminar, turbulent))
    before, after = log10_re < onset - 0.03, log10_re > onset + 0.03
    np.testing.assert_allclose(b[before], a[before], rtol=1e-3)
    # friction is a part of the axial force at 40 deg, and turbulent friction some times laminar
    assert 0.05 < np.median(b[after] / a[after] - 1.0) < 0.5
    crossed = laminar.conditions.time_s[np.argmin(np.abs(log10_re - onset))]
    step = axial_steps(turbulent)[0]
    assert step.relative > 0.0
    assert step.p_value < 1e-3
    assert abs(step.time_s - crossed) < 5.0


def test_a_transition_on_the_elevon_leaves_the_axial_force_as_it_is(tmp_path: Path) -> None:
    """Its flow turns by the deflection, and its area is small."""
    file, axial = tmp_path / "glide.toml", []
    for more in ("", TRANSITION):
        file.write_text(gliding(30.0, "V07T9730", altitude_m=74000.0) + more)
        axial.append(synthesize(file)["V07T9730"].conditions["axial_accel_g"])
    np.testing.assert_array_equal(*axial)


# Dynamic pressure -----------------------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_firing_jets_falsify_the_alpha_derivative_and_their_effect_restores_it(disturbed: Record) -> None:
    """The founding paper's density came from dynamic pressure, with a spike at each firing of the pitch jets."""
    names = ["ratio.scale", "ratio.d_alpha"]
    false, stated = estimate(disturbed, names).parameters["ratio.d_alpha"]
    found = estimate(disturbed, [*names, "effect.jet-interaction.jet_gain"])
    restored, sigma = found.parameters["ratio.d_alpha"]
    assert abs(restored) < 4.0 * sigma
    # false by far more than the data would allow; its own bound is wider, as its residual is coloured
    assert abs(false) > max(20.0 * sigma, 2.0 * stated)
    # film of Fay and Riddell ~ rho^1/2: the factor on the ratio that undoes the spike
    assert found.parameters["effect.jet-interaction.jet_gain"][0] == pytest.approx(1.3**-0.5 - 1.0, abs=0.03)


def test_a_record_with_dynamic_pressure_has_the_density_of_it(disturbed: Record, tmp_path: Path) -> None:
    write_record(disturbed, tmp_path / "r")
    table = (tmp_path / "r" / "conditions.csv").read_text().splitlines()
    names = table[0].split(",")
    kept = [i for i, name in enumerate(names) if name != "rho_kg_m3"]
    assert "q_Pa" in names
    lines = [",".join(line.split(",")[i] for i in kept) for line in table]
    (tmp_path / "r" / "conditions.csv").write_text("\n".join(lines) + "\n")
    read = load_record(tmp_path / "r").conditions
    np.testing.assert_allclose(read["rho_kg_m3"], disturbed.conditions["rho_kg_m3"], rtol=1e-6)


def test_dynamic_pressure_that_contradicts_the_density_is_refused(disturbed: Record, tmp_path: Path) -> None:
    other = replace(disturbed, conditions=disturbed.conditions.with_columns(q_Pa=disturbed.conditions["q_Pa"] * 1.1))
    write_record(other, tmp_path / "r")
    with pytest.raises(InputError, match=r"column q_Pa: .* is not rho V\^2 / 2 of this row; remove one of the two"):
        load_record(tmp_path / "r")


def test_a_recorded_trajectory_takes_dynamic_pressure_for_the_density(tmp_path: Path) -> None:
    rows = "\n".join(f"{t},{70e3 - 50 * t},{6500 - t},40,0,0,0,{1700 + 5 * t}" for t in range(5))
    head = "time_s,altitude_m,velocity_m_s,alpha_deg,beta_deg,elevon_deg,bodyflap_deg,q_Pa\n"
    (tmp_path / "c.csv").write_text(head + rows + "\n")
    found = read_conditions(tmp_path / "c.csv", 32.8)
    np.testing.assert_allclose(found["rho_kg_m3"], 2.0 * found["q_Pa"] / found["velocity_m_s"] ** 2)


# Thermocouples ------------------------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_a_lag_that_is_not_declared_is_in_the_readings_and_not_in_the_record(tmp_path: Path) -> None:
    lag = '[[measurements.fault]]\nsensor = "V09T9527"\ntau_s = 2.0\n'
    prompt, late = (record_of(tmp_path, more) for more in ("", lag))
    column = prompt.sensors[0].column
    difference = prompt.thermocouples[column] - late.thermocouples[column]
    # the same noise in both: what remains is tau dT/dt of a heating wall
    assert np.max(difference) > 5.0
    assert late.sensors[0].tau_s == 0.0
    value, sigma = estimate(late, ["ratio.scale", "sensor.V09T9527.tau_s"]).parameters["sensor.V09T9527.tau_s"]
    assert abs(value - 2.0) < 4.0 * sigma


@pytest.mark.parametrize("effect", ["time-skew", "sensor-lag"])
def test_an_effect_of_the_readings_stands_in_the_measurements_of_a_scenario(effect: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"effect `{effect}` is one of the readings; give `clock_skew_s`"):
        record_of(tmp_path, f'[[truth.effect]]\nname = "{effect}"\n')


# On the ground --------------------------------------------------------------------------------------------------------


GROUND = """format = "flight-record/1"
control_point = "plate"
measured = false
[conditions]
{constants}
[[thermocouples.sensor]]
name = "back"
column = "back_K"
depth_m = 0.001
noise_sigma_K = 1.0
[stack]
back = "adiabatic"
initial_K = 300.0
[[stack.layer]]
material = "steel"
thickness_m = 0.001
[materials.steel]
density_kg_m3 = 7800.0
emissivity = [[300.0, 0.9]]
specific_heat_J_kgK = [[300.0, 500.0]]
conductivity_W_mK = {conductivity}
[heating]
reference = "none"
wall_enthalpy = {{ cp_J_kgK = 1004.5 }}
"""
STEEL, POROUS = "[[300.0, 15.0]]", "{ p_Pa = [1e2, 1e5], T_K = [300.0], k = [[10.0, 15.0]] }"


def ground_record(folder: Path, constants: str = "q_add_W_m2 = 2e4", conductivity: str = STEEL) -> Path:
    """A plate under a lamp, whose conditions are a time and constants."""
    folder.mkdir()
    (folder / "record.toml").write_text(GROUND.format(constants=constants, conductivity=conductivity))
    (folder / "conditions.csv").write_text("time_s\n0\n10\n20\n")
    (folder / "thermocouples.csv").write_text("time_s,back_K\n0,300\n10,340\n20,380\n")
    return folder


def test_a_ground_record_needs_no_aerodynamic_column(tmp_path: Path) -> None:
    record = load_record(ground_record(tmp_path / "r"))
    assert np.all(record.conditions["q_add_W_m2"] == 2e4)
    assert np.all(record.conditions["velocity_m_s"] == 0.0)
    assert record.conditions["p_surface_Pa"] == pytest.approx(101325.0)
    write_record(record, tmp_path / "copy")
    again = load_record(tmp_path / "copy")
    assert {n: v.tolist() for n, v in again.conditions.columns.items()} == {
        n: v.tolist() for n, v in record.conditions.columns.items()
    }


def test_a_pressure_that_a_conductivity_depends_on_must_be_given(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no column `p_surface_Pa`, on which a conductivity depends"):
        load_record(ground_record(tmp_path / "r", conductivity=POROUS))
    chamber = ground_record(tmp_path / "chamber", "q_add_W_m2 = 2e4\np_surface_Pa = 500.0", POROUS)
    assert np.all(load_record(chamber).conditions["p_surface_Pa"] == 500.0)


def test_a_constant_that_is_a_column_too_is_refused(tmp_path: Path) -> None:
    folder = ground_record(tmp_path / "r")
    (folder / "conditions.csv").write_text("time_s,q_add_W_m2\n0,1\n10,1\n20,1\n")
    with pytest.raises(InputError, match=r"`q_add_W_m2` is a column, and a constant of \[conditions\]; remove one"):
        load_record(folder)
