"""An entry with its heating as one SSP file: valid, complete, and the simulator's flight when another host runs it."""

from __future__ import annotations

import csv
import json
import platform
import shutil
import subprocess
import sys
import zipfile
from contextlib import redirect_stdout
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import fmpy
import numpy as np
import pytest
from fmpy.ssp.ssd import read_ssd, validate_tree
from lxml import etree

from sim_heating.base.conditions import FRAME
from sim_heating.cli import main
from sim_heating.inputs.scenario import load_scenario
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.simulation.plugin import HeatingPlugin
from sim_heating.trajectory import entry3dof
from tests.support.paths import ROOT, SCENARIOS

POINTS = ["V09T9527", "NOSECAP"]
SURFACES = [f"heating::{name}.surface_K" for name in POINTS]
pytestmark = pytest.mark.skipif(
    shutil.which("gcc") is None and shutil.which("cc") is None, reason="needs a C compiler to link the FMUs"
)
SCENARIO = SCENARIOS / "entry_3dof.toml"
EXPORT = ["fmu", "export", "orbiter", "--control-points", ",".join(POINTS), "--trajectory", str(SCENARIO)]
UNTIL_S = 500.0
NAMES = {
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    "osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
}


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What the command reports of a system, with inputs that are held over a step, and of an FMU that it writes too."""
    folder, printed = tmp_path_factory.mktemp("ssp"), StringIO()
    with redirect_stdout(printed):
        files = ["--ssp", str(folder / "entry.ssp"), "--out", str(folder / "heating.fmu")]
        assert main([*EXPORT, *files, "--json"]) == 0
    found: dict[str, Any] = json.loads(printed.getvalue())
    return found


@pytest.fixture(scope="module")
def system(exported: dict[str, Any]) -> Path:
    """The system that was written."""
    return next(Path(name) for name in exported["files"] if name.endswith(".ssp"))


def xml(system: Path, name: str) -> ET.Element:
    """Root of a document in the archive."""
    with zipfile.ZipFile(system) as archive:
        return ET.fromstring(archive.read(name))


def described(system: Path, component: str) -> fmpy.model_description.ModelDescription:
    with zipfile.ZipFile(system) as archive:
        return fmpy.read_model_description(BytesIO(archive.read(f"resources/{component}.fmu")))


# The file ------------------------------------------------------------------------------------------------------------


def test_structure_and_parameters_are_valid_by_the_schemas_of_ssp_1_0(system: Path) -> None:
    """FMPy ships the schemas of the standard."""
    assert read_ssd(system, validate=True).version == "1.0"
    with zipfile.ZipFile(system) as archive:
        for component in ("trajectory", "heating"):
            root = etree.fromstring(archive.read(f"resources/{component}.ssv"))
            validate_tree(root, "SystemStructureParameterValues.xsd")


def test_every_input_of_the_frame_is_connected_to_the_output_of_its_name_and_unit(system: Path) -> None:
    root = xml(system, "SystemStructure.ssd")
    ends = [
        tuple(c.get(key) for key in ("startElement", "startConnector", "endElement", "endConnector"))
        for c in root.iter(f"{{{NAMES['ssd']}}}Connection")
    ]
    assert ends == [("trajectory", name, "heating", name) for name in FRAME if name != "time_s"]
    units = {
        (component.get("name"), connector.get("name"), connector.get("kind")): connector[0].get("unit")
        for component in root.iterfind(".//ssd:Component", NAMES)
        for connector in component.iterfind("ssd:Connectors/ssd:Connector", NAMES)
    }
    assert all(units["trajectory", name, "output"] == units["heating", name, "input"] for _, name, _, _ in ends)


def test_connectors_are_the_inputs_and_outputs_of_the_fmus_with_their_units_in_si(system: Path) -> None:
    root = xml(system, "SystemStructure.ssd")
    declared = {u.get("name"): dict(u[0].attrib) for u in root.iterfind("ssd:Units/ssc:Unit", NAMES)}
    for component in root.iterfind(".//ssd:Component", NAMES):
        inside = described(system, str(component.get("name")))
        expected = [(v.name, v.causality, v.unit) for v in inside.modelVariables if v.causality in ("input", "output")]
        connectors = component.iterfind("ssd:Connectors/ssd:Connector", NAMES)
        assert [(c.get("name"), c.get("kind"), c[0].get("unit")) for c in connectors] == expected
        for unit in inside.unitDefinitions:
            if unit.name in declared:
                found = {
                    k: float(declared[unit.name].get(k, k == "factor")) for k in ("kg", "m", "s", "K", "rad", "factor")
                }
                assert found == {k: float(getattr(unit.baseUnit, k)) for k in found}
        assert {unit for _, _, unit in expected if unit} <= declared.keys()


def test_parameter_files_hold_the_start_value_of_every_scalar_parameter_to_the_last_bit(system: Path) -> None:
    for component in ("trajectory", "heating"):
        parameters = xml(system, f"resources/{component}.ssv").iterfind("ssv:Parameters/ssv:Parameter", NAMES)
        found = {
            p.get("name"): (p[0].tag.split("}")[1], float(p[0].get("value", "nan")), p[0].get("unit"))
            for p in parameters
        }
        expected = {
            v.name: (v.type, float(v.start), v.unit)
            for v in described(system, component).modelVariables
            if v.causality == "parameter" and v.type in ("Real", "Integer")
        }
        assert found == expected
    assert found["input_timing_integer"] == ("Integer", 1.0, None)  # held


def test_the_experiment_ends_where_the_scenario_ends(system: Path) -> None:
    experiment = xml(system, "SystemStructure.ssd").find("ssd:DefaultExperiment", NAMES)
    assert experiment is not None
    scenario = load_scenario(SCENARIO)
    flown = entry3dof.fly(scenario.declared.trajectory, scenario.vehicle)
    assert float(experiment.get("stopTime", "nan")) == flown.conditions.time_s[-1]
    step = experiment.find(".//osp:FixedStepAlgorithm", NAMES)
    assert step is not None
    assert float(step.get("baseStepSize", "nan")) == 1.0 / scenario.declared.trajectory.rate_hz


# In another host -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def frames() -> np.ndarray:
    """(time, FRAME) of the built-in flight."""
    scenario, rows = load_scenario(SCENARIO), []
    spec = scenario.declared.trajectory
    spec = type(spec).model_validate(spec.model_dump() | {"stop": {"time_s": UNTIL_S}})
    entry3dof.fly(spec, scenario.vehicle, on_frame=lambda row: rows.append(np.array(row)))
    return np.array(rows)


def heated(frames: np.ndarray) -> np.ndarray:
    """(time, point) surface temperatures of the simulator's own plug-in, one thermal step a frame."""
    plugin = HeatingPlugin(load_vehicle("orbiter"), POINTS, longest_wait_s=0.0)
    plugin.reset(frames[0])
    found = [plugin.surface_temperatures()]
    for frame in frames[1:]:
        plugin.step(frame)
        found.append(plugin.surface_temperatures())
    return np.array(found)


needs_ecos = pytest.mark.skipif(
    (sys.platform, platform.machine()) != ("linux", "x86_64"), reason="ecospy has no library for this platform"
)


def in_ecos(system: Path, step_s: float, folder: Path) -> dict[str, np.ndarray]:
    """Columns of the example that runs a system in ecos, in a process of its own."""
    out = folder / f"ecos_{step_s}.csv"
    example = [sys.executable, ROOT / "examples" / "ssp_in_ecos.py", system]
    command = [*example, "--step", str(step_s), "--until", str(UNTIL_S), "--out", out]
    subprocess.run(list(map(str, command)), check=True, capture_output=True, timeout=120)
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def surfaces(found: dict[str, np.ndarray]) -> np.ndarray:
    return np.stack([found[name] for name in SURFACES], axis=1)


@pytest.mark.thorough
@needs_ecos
def test_ecos_flies_the_built_in_entry_and_its_temperatures_converge_to_the_plug_ins_with_the_step(
    system: Path, frames: np.ndarray, tmp_path: Path
) -> None:
    """Inputs held over a step: an error of first order, within 1.2 K at 0.25 s for the hotter of the two points."""
    exact, worst = heated(frames), {}
    for every, step_s in ((1, 0.25), (2, 0.5), (4, 1.0)):
        found = in_ecos(system, step_s, tmp_path)
        for k, name in enumerate(FRAME[1:], start=1):
            np.testing.assert_array_equal(found[f"trajectory::{name}"], frames[::every, k], err_msg=name)
        worst[step_s] = np.max(np.abs(surfaces(found) - exact[::every]), axis=0)
    assert np.max(exact) > 1100.0
    assert np.all(worst[0.25] < [0.6, 1.2])
    order = np.log2(worst[1.0] / worst[0.25]) / 2.0
    assert np.all(np.abs(order - 1.0) < 0.1)


def with_parameter(system: Path, name: str, value: str, folder: Path) -> Path:
    """A copy of a system in which a user has edited one start value of the heating."""
    edited = folder / "edited.ssp"
    for prefix, namespace in NAMES.items():
        ET.register_namespace(prefix, namespace)
    with zipfile.ZipFile(system) as archive, zipfile.ZipFile(edited, "w") as copy:
        for entry in archive.namelist():
            data = archive.read(entry)
            if entry == "resources/heating.ssv":
                values = ET.fromstring(data)
                (parameter,) = (p for p in values.iterfind(".//ssv:Parameter", NAMES) if p.get("name") == name)
                parameter[0].set("value", value)
                data = ET.tostring(values, encoding="UTF-8", xml_declaration=True)
            copy.writestr(entry, data)
    return edited


@pytest.mark.thorough
@needs_ecos
def test_inputs_that_a_user_sets_to_reached_have_the_bits_of_the_plug_in_one_step_late(
    system: Path, frames: np.ndarray, tmp_path: Path
) -> None:
    """ecos passes outputs on after a step: those of its start are reached at its end."""
    late = np.concatenate((frames[:1], frames[:-1]))
    late[:, 0] = frames[:, 0]
    reached = with_parameter(system, "input_timing_integer", "2", tmp_path)
    np.testing.assert_array_equal(surfaces(in_ecos(reached, 0.25, tmp_path)), heated(late))


def test_libcosim_gives_the_bits_of_ecos(system: Path, tmp_path: Path) -> None:
    """The master of the Open Simulation Platform, with the FMI Library below."""
    pytest.importorskip("libcosimpy")
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver

    folder, steps = tmp_path / "system", 400
    with zipfile.ZipFile(system) as archive:
        archive.extractall(folder)
    execution = CosimExecution.from_ssp_file(str(folder))  # at the step that the system recommends
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    for _ in range(steps):
        execution.step()
    refs = {v.name: v.valueReference for v in described(system, "heating").modelVariables}
    slave = execution.slave_index_from_instance_name("heating")
    found = observer.last_real_values(slave, [refs[f"{point}.surface_K"] for point in POINTS])
    assert list(found) == [in_ecos(system, 0.25, tmp_path)[name][steps] for name in SURFACES]


# The command ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (["orbiter"], "give --out FILE.fmu, --ssp FILE.ssp, or both"),
        (["orbiter", "--ssp", "x.ssp"], "also give --trajectory SCENARIO.toml"),
        (["orbiter", "--ssp", "x.zip", "--trajectory", str(SCENARIO)], "name a file that ends in .ssp"),
        (["orbiter", "--out", "x.fmu", "--trajectory", str(SCENARIO)], "--trajectory: goes with --ssp FILE.ssp"),
        (["capsule", "--ssp", "x.ssp", "--trajectory", str(SCENARIO)], "flies `orbiter`, not `capsule`"),
        (["orbiter", "--ssp", "x.ssp", "--trajectory", str(SCENARIOS / "nominal.toml")], 'source = "jsbsim" cannot be'),
        (["orbiter", "--ssp", "x.ssp", "--trajectory", str(SCENARIO), "--reference", "columns"], "--reference columns"),
        (["orbiter", "--ssp", "x.ssp", "--trajectory", str(SCENARIO), "--fmi", "3"], "of a system are FMI 2.0"),
        (
            ["orbiter", "--ssp", "x.ssp", "--trajectory", str(SCENARIO), "--platforms", "linux-arm64"],
            "export for FMI 3",
        ),
    ],
)
def test_command_refuses_in_one_line(
    arguments: list[str], hint: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["fmu", "export", *arguments]) == 2
    (error,) = capsys.readouterr().err.splitlines()
    assert hint in error
    assert not list(tmp_path.iterdir())


def test_a_vehicle_of_ones_own_is_exported_with_its_flight_from_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The scenario names its vehicle beside its own folder, as `new scenario` writes it; the command names it too."""
    own, elsewhere = tmp_path / "own" / "capsule", tmp_path / "elsewhere"
    shutil.copytree(load_vehicle("capsule").directory, own)
    (tmp_path / "own" / "flight").mkdir()
    elsewhere.mkdir()
    text = (SCENARIOS / "capsule.toml").read_text().replace('vehicle = "capsule"', 'vehicle = "../capsule"')
    (tmp_path / "own" / "flight" / "scenario.toml").write_text(text)
    monkeypatch.chdir(elsewhere)
    flight = ["--trajectory", "../own/flight/scenario.toml"]
    assert main(["fmu", "export", "../own/capsule", "--ssp", "capsule.ssp", *flight]) == 0, capsys.readouterr().err
    assert {c.name for c in described(elsewhere / "capsule.ssp", "trajectory").modelVariables} >= {"altitude_m"}
    # any other vehicle that the scenario leads to stays out of reach
    assert main(["fmu", "export", "capsule", "--ssp", "other.ssp", *flight]) == 2
    assert "outside the folders that may be read from here" in capsys.readouterr().err


def test_command_leaves_a_file_that_it_did_not_write(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = tmp_path / "other.ssp"
    other.write_bytes(b"a user's notes")
    assert main([*EXPORT, "--ssp", str(other)]) == 2
    assert "exists and is not an unmodified export of sim-heating" in capsys.readouterr().err
    assert other.read_bytes() == b"a user's notes"


def test_json_names_both_files_and_what_is_in_them(exported: dict[str, Any]) -> None:
    assert [Path(name).name for name in exported["files"]] == ["entry.ssp", "heating.fmu"]
    assert all(Path(name).is_file() for name in exported["files"])
    assert exported["results"]["fmi"] == "3.0"
    inside = exported["results"]["system"]
    assert (inside["ssp"], inside["fmi"], inside["control_points"]) == ("1.0", "2.0", POINTS)
    assert inside["connections"] == [name for name in FRAME if name != "time_s"]


def test_the_example_compares_a_host_with_a_run_at_the_times_of_both(tmp_path: Path) -> None:
    """A host 2 K too hot at one point; the other point it does not have."""
    for point in ("NOSECAP", "V09T9527"):
        (tmp_path / "run" / point).mkdir(parents=True)
        (tmp_path / "run" / point / "temperatures.csv").write_text("time_s,surface_K\n0,300\n1,400\n2,500\n9,900\n")
    (tmp_path / "host.csv").write_text("time,heating::V09T9527.surface_K\n0,302\n2,502\n")
    example = [sys.executable, str(ROOT / "examples" / "compare_with_run.py"), str(tmp_path / "host.csv")]
    said = subprocess.run([*example, str(tmp_path / "run")], check=True, capture_output=True, text=True).stdout
    assert said.startswith("V09T9527: within 2.00 K over 2 s")
    assert "NOSECAP" not in said
    other = subprocess.run([*example, str(tmp_path)], capture_output=True, text=True)
    assert other.returncode == 1
    assert "has none of the points V09T9527" in other.stderr
