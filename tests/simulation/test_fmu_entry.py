"""The 3-DOF entry as an FMU: the built-in flight to the last bit, guided inside or by the host, and heating by it."""

from __future__ import annotations

import importlib.util
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from sim_heating.base.errors import InputError, RunError
from sim_heating.inputs.scenario import load_scenario
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.simulation.fmu_export.entry import CHANNELS, TRIGGERS, export_entry
from sim_heating.simulation.fmu_export.export import export_fmu
from sim_heating.simulation.plugin import HeatingPlugin
from sim_heating.simulation.run import run
from sim_heating.trajectory import entry3dof
from sim_heating.trajectory.flight import Flight
from sim_heating.trajectory.fmu import flight as fmu
from sim_heating.trajectory.spec import TrajectorySpec
from tests.support.fmu_hosts import Host
from tests.support.paths import ORBITER, ROOT

VEHICLE = load_vehicle(ORBITER)
SPEC = load_scenario(ROOT / "scenarios" / "entry_3dof.toml").declared.trajectory
STOP = {"velocity_m_s": 5800.0}
"""Soon after the POPU at 20,000 ft/s."""
needs_compiler = pytest.mark.skipif(
    shutil.which("gcc") is None and shutil.which("cc") is None, reason="needs a C compiler to link the FMU"
)
pytestmark = needs_compiler


@pytest.fixture(scope="module")
def built_in() -> Flight:
    return entry3dof.fly(TrajectorySpec.model_validate(SPEC.model_dump() | {"stop": STOP}), VEHICLE)


@pytest.fixture(scope="module")
def entry(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """The entry with its POPU as an FMU of either version."""
    folder = tmp_path_factory.mktemp("entry")
    for fmi in (2, 3):
        export_entry(SPEC, ORBITER, folder / f"{fmi}.fmu", fmi=fmi)
    return {fmi: folder / f"{fmi}.fmu" for fmi in (2, 3)}


def fly(path: Path, stop: dict[str, float] = STOP, **more: Any) -> Flight:
    table = {"source": "fmu", "file": str(path), "rate_hz": SPEC.rate_hz, "stop": stop}
    return fmu.fly(TrajectorySpec.model_validate(table | more), VEHICLE)


def assert_same_bits(flown: Flight, expected: Flight) -> None:
    assert len(flown.conditions) == len(expected.conditions)
    for name in expected.conditions.names:
        assert np.array_equal(flown.conditions[name], expected.conditions[name]), name


@pytest.mark.sample(1)
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_popu_on_the_fmu_is_the_built_in_flight_to_the_last_bit(
    fmi: int, entry: dict[int, Path], built_in: Flight
) -> None:
    assert built_in.windows[0].kind == "popu"
    assert built_in.windows[0].end_s < built_in.conditions.time_s[-1]
    assert_same_bits(fly(entry[fmi]), built_in)


@pytest.mark.thorough
@pytest.mark.parametrize("fmi", [2, 3])
def test_guidance_of_the_host_through_the_inputs_flies_it_to_the_last_bit(
    fmi: int, entry: dict[int, Path], built_in: Flight
) -> None:
    names = ("alpha_deg", "bank_deg", "beta_deg", "elevon_deg", "bodyflap_deg", "jets")
    host = {"inputs": {f"command.{name}": name for name in names}, "start": {"pilot": 2}}
    flown = fly(entry[fmi], fmu=host, manoeuvre=[m.model_dump() for m in SPEC.manoeuvre])
    assert_same_bits(flown, built_in)
    assert flown.windows == built_in.windows


def test_a_manoeuvre_can_be_replaced_through_its_parameters(entry: dict[int, Path]) -> None:
    """A sideslip doublet at 400 s in place of the POPU, in the slot of the second manoeuvre."""
    trigger, channel = [t[0] for t in TRIGGERS].index("time") + 1, [c[0] for c in CHANNELS].index("beta") + 1
    shape = [(0.0, 0.0), (4.0, 2.0), (8.0, 2.0), (16.0, -2.0), (20.0, -2.0), (24.0, 0.0)]
    points = shape + [shape[-1]] * 6
    start: dict[str, Any] = {"manoeuvre[1].at": 1.0, "manoeuvre[2].at": 400.0}
    start |= {"manoeuvre[2].trigger": trigger, "manoeuvre[2].moves": channel}
    for i, (after, offset) in enumerate(points, start=1):
        start |= {f"manoeuvre[2].point[{i}].after_s": after, f"manoeuvre[2].point[{i}].offset": offset}
    own = {"kind": "sideslip-doublet", "at_time_s": 400.0, "amplitude_deg": 2.0, "rate_deg_s": 0.5, "hold_s": 4.0}
    spec = TrajectorySpec.model_validate(SPEC.model_dump() | {"stop": {"time_s": 440.0}, "manoeuvre": [own]})
    expected = entry3dof.fly(spec, VEHICLE)
    assert np.ptp(expected.conditions["beta_deg"]) == pytest.approx(4.0)
    assert_same_bits(fly(entry[3], {"time_s": 440.0}, fmu={"start": start}), expected)


@pytest.mark.thorough
def test_initial_state_and_mass_are_parameters(entry: dict[int, Path]) -> None:
    changed = {"gamma_deg": -1.5, "velocity_m_s": 7300.0, "bank_deg": 20.0}
    table = SPEC.model_dump() | {"stop": {"time_s": 300.0}, "vehicle": {"mass_kg": 90000.0}}
    table["initial"] = table["initial"] | changed
    expected = entry3dof.fly(TrajectorySpec.model_validate(table), VEHICLE)
    start = {f"initial.{name}": value for name, value in changed.items()} | {"vehicle.mass_kg": 90000.0}
    assert_same_bits(fly(entry[3], {"time_s": 300.0}, fmu={"start": start}), expected)


def test_a_longer_communication_step_is_divided_into_frames(entry: dict[int, Path], built_in: Flight) -> None:
    flown = fly(entry[3], {"time_s": 300.0}, rate_hz=1.0).conditions
    assert np.array_equal(flown["altitude_m"], built_in.conditions["altitude_m"][:301])


def test_a_stop_between_two_steps_is_passed_by_the_last_one(entry: dict[int, Path]) -> None:
    frames: list[float] = []
    table = {"source": "fmu", "file": str(entry[3]), "rate_hz": 4.0, "stop": {"time_s": 20.1}}
    fmu.fly(TrajectorySpec.model_validate(table), VEHICLE, on_frame=lambda row: frames.append(float(row[0])))
    assert frames[-1] == 20.25


@pytest.mark.sample(1)
@pytest.mark.parametrize("fmi", [2, 3])
def test_the_description_is_valid(fmi: int, entry: dict[int, Path]) -> None:
    assert validate_fmu(str(entry[fmi])) == []
    outputs = {
        v.name: v.unit for v in fmpy.read_model_description(entry[fmi]).modelVariables if v.causality == "output"
    }
    assert outputs["altitude_m"] == "m"
    assert outputs["rho_kg_m3"] == "kg/m3"


def test_a_vehicle_that_hits_the_ground_is_reported_by_the_fmu(entry: dict[int, Path]) -> None:
    start = {"initial.altitude_m": 100.0, "initial.velocity_m_s": 300.0, "initial.gamma_deg": -60.0}
    with pytest.raises(RunError, match=r"altitude_m is .* below the ground; end the flight before"):
        fly(entry[3], {"time_s": 100.0}, fmu={"start": start})


def test_a_start_value_outside_its_limits_is_refused_by_the_fmu(entry: dict[int, Path]) -> None:
    with pytest.raises(RunError, match=r"vehicle\.mass_kg cannot be -1; it must be from 1 to"):
        fly(entry[3], {"time_s": 100.0}, fmu={"start": {"vehicle.mass_kg": -1.0}})


def test_a_trajectory_of_another_source_is_refused(tmp_path: Path) -> None:
    nominal = load_scenario(ROOT / "scenarios" / "nominal.toml").declared.trajectory
    with pytest.raises(InputError, match=r'source = "jsbsim" cannot be exported as an FMU; give .* "entry-3dof"'):
        export_entry(nominal, ORBITER, tmp_path / "entry.fmu")


@pytest.mark.sample(1)
@pytest.mark.parametrize("fmi", [2, 3])
def test_trajectory_and_heating_fmu_together_give_the_plug_in_alongside_the_entry(
    fmi: int, entry: dict[int, Path], tmp_path: Path
) -> None:
    vehicle, until_s = load_vehicle("orbiter"), 400.0
    export_fmu(vehicle, tmp_path / "heating.fmu", ["V09T9527"], fmi=fmi)
    example = importlib.util.spec_from_file_location("round_trip", ROOT / "examples" / "fmu_round_trip.py")
    assert example is not None
    assert example.loader is not None
    module = importlib.util.module_from_spec(example)
    example.loader.exec_module(module)
    rows = module.co_simulate(entry[fmi], tmp_path / "heating.fmu", until_s, SPEC.rate_hz)

    plugin, surface = HeatingPlugin(vehicle, ["V09T9527"]), []

    def heat(frame: np.ndarray) -> None:
        if surface:
            plugin.step(frame)
        else:
            plugin.reset(frame)
        surface.append(float(plugin.surface_temperatures()[0]))

    spec = TrajectorySpec.model_validate(SPEC.model_dump() | {"stop": {"time_s": until_s}})
    entry3dof.fly(spec, VEHICLE, on_frame=heat)
    assert max(surface) > 800.0
    assert [row["V09T9527.surface_K"] for row in rows] == surface


@pytest.mark.thorough
def test_the_example_heats_a_control_point_as_the_built_in_scenario_does(
    entry: dict[int, Path], tmp_path: Path
) -> None:
    shutil.copy(ROOT / "examples" / "entry_fmu.toml", tmp_path)
    shutil.copy(entry[3], tmp_path / "entry.fmu")
    flown = run(load_scenario(tmp_path / "entry_fmu.toml"))
    own = load_scenario(ROOT / "scenarios" / "entry_3dof.toml")
    expected = run(replace(own, names=("V09T9527",)))
    assert flown.flight.conditions.time_s[-1] > 1500.0
    surfaces = [r.points["V09T9527"].history.surface_K for r in (flown, expected)]
    assert np.array_equal(*surfaces)


@pytest.mark.parametrize("fmi", [2, 3])
def test_outputs_change_with_no_command_before_the_next_step(fmi: int, entry: dict[int, Path]) -> None:
    """Nor do their initial values; each command in turn, with the host as pilot."""
    described = fmpy.read_model_description(entry[fmi])
    assert all(not u.dependencies for u in described.outputs)
    commands = [v.name for v in described.modelVariables if v.causality == "input"]
    assert all(not {v.name for v in u.dependencies} & set(commands) for u in described.initialUnknowns)
    outputs = [u.variable.name for u in described.outputs]
    with Host(entry[fmi], timing=None) as host:
        (host.fmu.setInt64 if host.three else host.fmu.setInteger)([host.refs["pilot"]], [2])
        host.fmu.enterInitializationMode() if host.three else (
            host.fmu.setupExperiment(),
            host.fmu.enterInitializationMode(),
        )
        for moment in ("initialization", "between steps"):
            before = host.get(*outputs)
            for name in commands:
                host.set({name: host.get(name)[0] + 0.1})
                np.testing.assert_array_equal(host.get(*outputs), before, err_msg=f"{name}, {moment}")
            if moment == "initialization":
                host.fmu.exitInitializationMode()
                host.fmu.doStep(currentCommunicationPoint=0.0, communicationStepSize=0.5)
        host.fmu.doStep(currentCommunicationPoint=0.5, communicationStepSize=0.5)
        assert host.get("alpha_deg")[0] != before[outputs.index("alpha_deg")]
