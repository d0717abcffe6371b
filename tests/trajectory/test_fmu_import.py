"""A flight from an FMU: versions and interfaces, units, derived columns, inputs, ends; an FMU of another tool."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_heating.base.errors import InputError
from sim_heating.base.files.units import conversion, known_unit
from sim_heating.heating.atmosphere import us76
from sim_heating.inputs.scenario import load_scenario
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.simulation.run import run
from sim_heating.trajectory.flight import Flight
from sim_heating.trajectory.fmu import flight as fmu
from sim_heating.trajectory.fmu.columns import ColumnsOfFmu, aerodynamic_angles
from sim_heating.trajectory.fmu.model import read_fmu
from sim_heating.trajectory.fmu.units import BaseUnit, unit_of_fmu
from sim_heating.trajectory.jsbsim.host import euler_angles
from sim_heating.trajectory.spec import TrajectorySpec
from tests.support.fmus import needs_compiler
from tests.support.paths import ORBITER
from tests.support.small_fmus import (
    closed_form,
    description,
    feedthrough_fmu,
    glide_fmu,
    library,
    pack,
    platform_folder,
)

VEHICLE = load_vehicle(ORBITER)

approx = pytest.approx
COLUMNS = {
    "altitude_m": "h", "velocity_m_s": "speed", "alpha_deg": "alpha", "beta_deg": 0.0, "elevon_deg": 1.0,
    "bodyflap_deg": 10.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def binary(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return library(tmp_path_factory.mktemp("glide"))


@pytest.fixture(scope="module")
def glide(binary: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The glide as an FMI 2 co-simulation FMU."""
    return glide_fmu(tmp_path_factory.mktemp("fmu") / "glide.fmu", binary)


def spec(path: Path, columns: dict[str, Any] = COLUMNS, stop: dict[str, float] | None = None, **more: Any):
    """A [trajectory] table that flies an FMU for 20 s."""
    own = {k: more.pop(k) for k in ("start", "inputs", "interface", "tolerance", "timeout_s") if k in more}
    table = {"source": "fmu", "file": str(path), "rate_hz": 4.0, "stop": stop or {"time_s": 20.0}, "fmu": own} | more
    table["fmu"] = {"columns": columns} | own
    return TrajectorySpec.model_validate(table)


def fly(path: Path, *args: Any, **kwargs: Any) -> Flight:
    return fmu.fly(spec(path, *args, **kwargs), VEHICLE)


# ---- versions and interfaces --------------------------------------------------------------------------------------


@needs_compiler
@pytest.mark.parametrize("fmi", ["2", "3"])
def test_a_co_simulation_fmu_flies_its_closed_form(fmi: str, binary: Path, tmp_path: Path) -> None:
    c = fly(glide_fmu(tmp_path / "glide.fmu", binary, fmi)).conditions
    altitude, speed = np.array([closed_form(t) for t in c.time_s]).T
    assert c.time_s == approx(np.arange(21.0))
    assert c["altitude_m"] == approx(altitude, rel=1e-14)
    assert c["velocity_m_s"] == approx(speed, rel=1e-13)


@pytest.mark.sample(1)
@needs_compiler
@pytest.mark.parametrize("fmi", ["2", "3"])
def test_a_model_exchange_fmu_is_integrated_to_its_tolerance_through_a_time_event(
    fmi: str, binary: Path, tmp_path: Path
) -> None:
    path = glide_fmu(tmp_path / "glide.fmu", binary, fmi, "ModelExchange")
    _, speed = closed_form(20.0)
    errors = []
    for tolerance in (1e-4, 1e-9):
        c = fly(path, tolerance=tolerance).conditions
        assert c["altitude_m"] == approx([closed_form(t)[0] for t in c.time_s], rel=1e-9)
        errors.append(abs(c["velocity_m_s"][-1] - speed) / speed)
    assert errors[0] < 1e-4
    assert errors[1] < 1e-7


@needs_compiler
def test_start_values_reach_the_fmu_in_its_own_units(glide: Path) -> None:
    c = fly(glide, start={"sink": {"value": 360.0, "unit": "km/h"}, "drag": 0.0}).conditions
    assert c["altitude_m"][10] == approx(70e3 - 1000.0)
    assert np.ptp(c["velocity_m_s"]) == approx(0.0, abs=1e-9)


# ---- units --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("unit", "wanted", "factor"),
    [
        ("ft", "m", 0.3048), ("ft/s", "m/s", 0.3048), ("km/h", "m/s", 1.0 / 3.6), ("slug/ft3", "kg/m3", 515.3788184),
        ("rad", "deg", 180.0 / math.pi), ("kg.m-3", "kg/m3", 1.0), ("knot", "m/s", 1852.0 / 3600.0),
        ("m·s⁻¹", "m/s", 1.0), ("m s^(-1)", "m/s", 1.0), ("W/(m2.K)", "W.m**-2.K^-1", 1.0), ("m / s2", "m/s/s", 1.0),
    ],
)  # fmt: skip
def test_units_as_fmus_write_them(unit: str, wanted: str, factor: float) -> None:
    given, target = known_unit(unit), known_unit(wanted)
    assert given is not None
    assert target is not None
    found = conversion(given, target)
    assert found is not None
    assert found(1.0) == approx(factor, rel=1e-9)
    assert found.inverse(found(3.7)) == approx(3.7)


@pytest.mark.parametrize(
    "unit",
    [
        "m.", "m*", "m-", "m/", "1/", "'m'", "(", "m)", "g0", "m,s", "1/s.m", "9**9**9", "m^9^9^9",
        "10^3 m", "m^1000", "lambda()", "a" * 60 + "#", "a" * 100_000,
        "(" * 3000 + "m" + ")" * 3000,
    ],
)  # fmt: skip
def test_a_text_that_is_not_a_unit_is_unknown(unit: str) -> None:
    assert known_unit(unit) is None


def test_celsius_has_an_offset_and_an_angle_is_not_a_plain_number() -> None:
    celsius, kelvin, rad, one = (known_unit(u) for u in ("degC", "K", "rad", "1"))
    assert celsius is not None
    assert kelvin is not None
    assert conversion(celsius, kelvin)(20.0) == approx(293.15)  # type: ignore[misc]
    assert rad is not None
    assert one is not None
    assert conversion(rad, one) is None


def test_an_fmus_own_degrees_with_fifteen_digits_leave_every_bit() -> None:
    own, deg = unit_of_fmu("deg", BaseUnit(rad=1, factor=0.0174532925199433)), known_unit("deg")
    assert deg is not None
    assert conversion(own, deg) == (1.0, 0.0)


def test_a_letter_that_an_fmu_defines_is_what_it_defines() -> None:
    charge = unit_of_fmu("C", BaseUnit(s=1, A=1))
    assert charge == known_unit("coulomb")


def test_a_definition_that_contradicts_its_name_is_refused() -> None:
    with pytest.raises(InputError, match=r"defines `ft` as 1 m, but the name means 0\.3048 m; give `unit`"):
        unit_of_fmu("ft", BaseUnit(m=1))


@pytest.mark.parametrize("factor", [0.0, math.nan, math.inf])
def test_a_definition_that_is_not_a_unit_is_refused(factor: float) -> None:
    with pytest.raises(InputError, match=rf"defines `blah` by factor {factor:g} and offset 0, which is not a unit"):
        unit_of_fmu("blah", BaseUnit(m=1, factor=factor))


@needs_compiler
def test_a_unit_unknown_to_pint_is_taken_from_the_definition_of_the_fmu(binary: Path, tmp_path: Path) -> None:
    text = description("2").replace('unit="km"', 'unit="Fl"').replace('<Unit name="km">', '<Unit name="Fl">')
    path = pack(tmp_path / "glide.fmu", text, binary, platform_folder("2"))
    assert fly(path).conditions["altitude_m"][0] == approx(70e3)


# ---- derived columns ----------------------------------------------------------------------------------------------

angle = st.floats(-80.0, 80.0)


@given(st.floats(-20.0, 60.0), angle, angle, st.floats(-179.0, 179.0))
def test_attitude_and_path_give_back_angle_of_attack_and_bank(
    alpha: float, bank: float, gamma: float, heading: float
) -> None:
    roll, pitch, yaw = (math.degrees(a) for a in euler_angles(alpha, bank, gamma, heading))
    assert aerodynamic_angles(roll, pitch, yaw, gamma, heading) == approx((alpha, 0.0, bank), abs=1e-6)


def test_level_wings_yawed_off_the_path_are_sideslip() -> None:
    assert aerodynamic_angles(0.0, 0.0, 10.0, 0.0, 15.0) == approx((0.0, 5.0, 0.0), abs=1e-9)
    assert aerodynamic_angles(0.0, 30.0, 0.0, -10.0, 0.0) == approx((40.0, 0.0, 0.0), abs=1e-9)


@needs_compiler
def test_altitude_velocity_and_attitude_are_enough(glide: Path) -> None:
    columns = {
        "altitude_m": "h", "velocity_north_m_s": "speed", "velocity_east_m_s": 0.0, "velocity_down_m_s": 50.0,
        "roll_deg": 0.0, "pitch_deg": "alpha", "yaw_deg": 0.0,
    }  # fmt: skip
    flight = fly(glide, columns)
    c = flight.conditions
    path = np.degrees(np.arctan2(50.0, [closed_form(t)[1] for t in c.time_s]))
    assert c["gamma_deg"] == approx(-path)
    assert c["alpha_deg"] == approx(math.degrees(0.7) + path)
    assert c["rho_kg_m3"] == approx(us76(c["altitude_m"])[2])
    assert c["bodyflap_deg"][0] != 0.0  # on its schedule, the elevon in trim
    assert "latitude_deg" not in c
    assert "density is that of US76" in [text for _, text in flight.events]


@needs_compiler
def test_wind_and_density_of_the_scenario_are_the_air_that_the_fmu_flies_in(glide: Path) -> None:
    columns = {
        "altitude_m": "h", "velocity_north_m_s": "speed", "velocity_east_m_s": 0.0, "velocity_down_m_s": 0.0,
        "alpha_deg": 40.0, "beta_deg": 0.0,
    }  # fmt: skip
    air = {"density_factor": [[0.0, 1.25]], "wind_north_m_s": [[0.0, 100.0]]}
    c = fly(glide, columns, dispersions=air).conditions
    assert c["velocity_m_s"] == approx([closed_form(t)[1] - 100.0 for t in c.time_s])
    assert c["rho_kg_m3"] == approx(1.25 * us76(c["altitude_m"])[2])


@needs_compiler
def test_a_column_is_found_by_its_usual_name_and_reported(glide: Path) -> None:
    flight = fly(glide, {k: v for k, v in COLUMNS.items() if k not in ("altitude_m", "alpha_deg")})
    assert flight.conditions["altitude_m"][0] == approx(70e3)
    assert "altitude_m is read from `h`, a usual name" in [text for _, text in flight.events]


@needs_compiler
def test_an_output_of_a_usual_name_without_a_unit_is_not_used_and_reported(binary: Path, tmp_path: Path) -> None:
    density = (
        '<ScalarVariable name="rho" valueReference="2" causality="output"><Real/></ScalarVariable></ModelVariables>'
    )
    text = description("2").replace("</ModelVariables>", density)
    flight = fly(pack(tmp_path / "glide.fmu", text, binary, platform_folder("2")))
    written = 'rho_kg_m3 = { variable = "rho", unit = "kg/m3" }'
    expected = f"`rho` is not used because its unit is unknown; if it is rho_kg_m3, write {written}"
    assert expected in [text for _, text in flight.events]


@needs_compiler
def test_a_mapped_mach_determines_the_speed_although_an_output_has_that_name(binary: Path, tmp_path: Path) -> None:
    text = description("2").replace('name="speed"', 'name="velocity"')
    path = pack(tmp_path / "glide.fmu", text, binary, platform_folder("2"))
    c = fly(path, {k: v for k, v in COLUMNS.items() if k != "velocity_m_s"} | {"mach": 20.0}).conditions
    assert c["mach"] == approx(np.full(21, 20.0))


# ---- inputs and ends ----------------------------------------------------------------------------------------------


@needs_compiler
@pytest.mark.parametrize("fmi", ["2", "3"])
def test_an_input_follows_its_schedule_held_over_each_step(fmi: str, binary: Path, tmp_path: Path) -> None:
    path = glide_fmu(tmp_path / "glide.fmu", binary, fmi)
    schedule = {"schedule": [[0.0, 0.5], [10.0, 0.7]], "unit": "rad"}
    c = fly(path, inputs={"command": schedule}).conditions
    at_beginning = np.interp(c.time_s[1:] - 0.25, [0.0, 10.0], [0.5, 0.7])
    assert np.radians(c["alpha_deg"][1:]) == approx(at_beginning, rel=1e-12)


@pytest.fixture(scope="module")
def feedthrough(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return library(tmp_path_factory.mktemp("feedthrough"), model="feedthrough")


@pytest.mark.sample(1)
@needs_compiler
@pytest.mark.parametrize("fmi", ["2", "3"])
def test_a_feedthrough_is_flown_by_schedules_from_its_first_frame_on(
    fmi: str, feedthrough: Path, tmp_path: Path
) -> None:
    # Its outputs are its inputs: with their start values, 0, it would begin on the ground, at rest.
    path = feedthrough_fmu(tmp_path / "feedthrough.fmu", feedthrough, fmi)
    altitude, speed = [[0.0, 70e3], [20.0, 68e3]], [[0.0, 6500.0], [20.0, 6400.0]]
    inputs: dict[str, Any] = {"set_altitude": {"schedule": altitude}, "set_airspeed": {"schedule": speed}}
    inputs |= {"set_alpha": {"schedule": [[0.0, 40.0]]}, "count": {"schedule": [[0.0, 3]]}}
    c = fly(path, {}, inputs=inputs).conditions
    beginning = np.maximum(c.time_s - 0.25, 0.0)  # of the step that leads to a frame
    assert c["altitude_m"] == approx(70e3 - 100.0 * beginning)
    assert c["velocity_m_s"] == approx(6500.0 - 5.0 * beginning)
    assert c["alpha_deg"] == approx(np.full(len(c), 40.0))
    assert c["beta_deg"] == approx(np.zeros(len(c)))


@pytest.mark.sample(1)
@needs_compiler
@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_a_start_value_of_a_scheduled_input_holds_until_the_first_step(kind: str, binary: Path, tmp_path: Path) -> None:
    path = glide_fmu(tmp_path / "glide.fmu", binary, kind=kind)
    schedule = {"command": {"schedule": [[0.0, 0.5]]}}
    assert np.radians(fly(path, inputs=schedule).conditions["alpha_deg"]) == approx(np.full(21, 0.5))
    c = fly(path, inputs=schedule, start={"command": 0.6}).conditions
    assert np.radians(c["alpha_deg"][:2]) == approx([0.6, 0.5])


@needs_compiler
@pytest.mark.parametrize("fmi", ["2", "3"])
@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_a_flight_ends_where_the_fmu_ends_it(fmi: str, kind: str, binary: Path, tmp_path: Path) -> None:
    path = glide_fmu(tmp_path / "glide.fmu", binary, fmi, kind)
    flight = fly(path, start={"fault": 7, "fault_time": 4.9})
    assert flight.conditions.time_s[-1] == approx(5.0)
    assert "the FMU ended the flight" in [text for _, text in flight.events]


@needs_compiler
def test_a_flight_ends_at_the_first_stop(glide: Path) -> None:
    c = fly(glide, stop={"altitude_m": 69.7e3}).conditions
    assert c.time_s[-1] == approx(6.0)
    assert fly(glide, stop={"velocity_m_s": 6850.0}).conditions["velocity_m_s"][-1] == approx(6850.0, abs=50.0)


@needs_compiler
def test_each_step_reaches_the_host_before_the_next_is_taken(glide: Path) -> None:
    frames: list[float] = []
    fmu.fly(spec(glide), VEHICLE, on_frame=lambda row: frames.append(float(row[0])))
    assert frames == approx(np.arange(81) / 4.0)


@pytest.mark.thorough
@needs_compiler
@pytest.mark.parametrize("fmi", ["2", "3"])
def test_an_fmu_of_many_variables_is_read_once_and_flown(
    fmi: str, binary: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[Path] = []
    original = fmpy.read_model_description

    def counted(path: Path, **options: Any) -> Any:
        read.append(path)
        return original(path, **options)

    monkeypatch.setattr(fmpy, "read_model_description", counted)
    one = (
        '<ScalarVariable name="body[{0}].q" valueReference="{1}" causality="output"><Real unit="m"/></ScalarVariable>'
        if fmi == "2"
        else '<Float64 name="body[{0}].q" valueReference="{1}" causality="output" unit="m"/>'
    )
    more = "".join(one.format(i, 100 + i) for i in range(20_000))
    text = description(fmi).replace("</ModelVariables>", more + "</ModelVariables>")
    path = pack(tmp_path / "glide.fmu", text, binary, platform_folder(fmi))
    assert not fmu.fmu_problems(spec(path), VEHICLE)
    assert fly(path, stop={"time_s": 1.0}).conditions["altitude_m"][-1] == approx(closed_form(1.0)[0])
    assert read == [path]
    os.utime(path, ns=(0, 0))
    fly(path, stop={"time_s": 1.0})
    assert read == [path, path]  # it may be another one


@pytest.mark.thorough
@needs_compiler
def test_a_variable_with_many_aliases_is_flown_by_one_of_them(binary: Path, tmp_path: Path) -> None:
    aliases = "".join(f'<Alias name="height[{i}]"/>' for i in range(30_000))
    text = description("3").replace(
        'causality="output" unit="km"/>', f'causality="output" unit="km">{aliases}</Float64>'
    )
    path = pack(tmp_path / "glide.fmu", text, binary, platform_folder("3"))
    c = fly(path, COLUMNS | {"altitude_m": "height[27777]"}, stop={"time_s": 1.0}).conditions
    assert c["altitude_m"][-1] == approx(closed_form(1.0)[0])


# ---- scenarios ----------------------------------------------------------------------------------------------------

SCENARIO = """
format = "scenario/1"
title = "A glide"
vehicle = "orbiter"
control_points = ["V09T9527"]
[heating]
alongside = true
longest_step_s = 0.1
[trajectory]
source = "fmu"
file = "glide.fmu"
rate_hz = 10.0
stop = { time_s = 20.0 }
[trajectory.fmu.columns]
altitude_m = "h"
velocity_m_s = { variable = "speed", unit = "ft/s" }
alpha_deg = "alpha"
beta_deg = 0.0
"""


@pytest.mark.thorough
@needs_compiler
def test_a_scenario_flies_an_fmu_with_the_plug_in_alongside(binary: Path, tmp_path: Path) -> None:
    glide_fmu(tmp_path / "glide.fmu", binary, "3")
    (tmp_path / "glide.toml").write_text(SCENARIO)
    result = run(load_scenario(tmp_path / "glide.toml"))
    assert result.plugin_apart_K is not None
    assert result.plugin_apart_K["V09T9527"] < 0.1
    assert result.points["V09T9527"].history.surface_K[-1] > 400.0


@needs_compiler
def test_contradictions_of_scenario_and_fmu_are_reported_without_flying(binary: Path, tmp_path: Path) -> None:
    glide_fmu(tmp_path / "glide.fmu", binary)
    (tmp_path / "glide.toml").write_text(SCENARIO.replace('"speed", unit = "ft/s"', '"sped"').replace('"h"', '"k"'))
    with pytest.raises(InputError) as found:
        load_scenario(tmp_path / "glide.toml")
    assert len(found.value.problems) == 2
    assert "has no variable `sped`; did you mean `speed`" in found.value.problems[1]


# ---- an FMU of another tool ---------------------------------------------------------------------------------------

ALLEN_EGGERS = '''
import math
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

class Ballistic(Fmi2Slave):
    """Straight ballistic entry through an exponential atmosphere: Allen and Eggers, NACA TN 4047 (1957)."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.h_km, self.airspeed_kt, self.beta_kg_m2, self.path = 100.0, 7000.0 * 3600 / 1852, 500.0, 30.0
        for name in ("h_km", "airspeed_kt"):
            self.register_variable(Real(name, causality=Fmi2Causality.output))
        for name in ("beta_kg_m2", "path"):
            self.register_variable(Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed))
        self.h = 100e3

    def do_step(self, time, step):
        V = self.airspeed_kt * 1852 / 3600
        sine, n = math.sin(math.radians(self.path)), 100
        for _ in range(n):
            self.h -= V * sine * step / n
            rho = 1.225 * math.exp(-self.h / 7200.0)
            V -= rho * V * V / (2.0 * self.beta_kg_m2) * step / n
        self.h_km, self.airspeed_kt = self.h / 1000.0, V * 3600 / 1852
        return True
'''


def test_an_fmu_made_by_pythonfmu_flies_allen_and_eggers_entry(tmp_path: Path) -> None:
    pytest.importorskip("pythonfmu")
    (tmp_path / "ballistic.py").write_text(ALLEN_EGGERS)
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", "ballistic.py", "-d", str(tmp_path)]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    columns = {
        "altitude_m": {"variable": "h_km", "unit": "km"}, "velocity_m_s": {"variable": "airspeed_kt", "unit": "knot"},
        "alpha_deg": 0.0, "beta_deg": 0.0, "elevon_deg": 0.0, "bodyflap_deg": 0.0,
    }  # fmt: skip
    path = tmp_path / "Ballistic.fmu"
    c = fly(path, columns, {"altitude_m": 20e3}, start={"path": 40.0}, rate_hz=10.0).conditions
    rho, sine = 1.225 * np.exp(-c["altitude_m"] / 7200.0), math.sin(math.radians(40.0))
    exact = 7000.0 * np.exp(-(rho - 1.225 * math.exp(-100e3 / 7200.0)) * 7200.0 / (2.0 * 500.0 * sine))
    assert c["velocity_m_s"] == approx(exact, rel=2e-3)
    assert c["velocity_m_s"][-1] < 3500.0
    assert read_fmu(path).description.generationTool.startswith("PythonFMU")
    assert ColumnsOfFmu(read_fmu(path), spec(path, columns), ORBITER).missing
