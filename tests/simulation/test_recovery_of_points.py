"""A vehicle whose tables are reduced with the enthalpy of an edge: every way to fly it heats with the same one."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException

from sim_heating.base.conditions import FRAME, Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.block import N_CONDITIONS, RECOVERY_ENTHALPY, RECOVERY_RISE
from sim_heating.cli import main
from sim_heating.heating.reference.recovery import Recovery
from sim_heating.inputs.points import check_reference, conditions_at_point, conditions_of_record
from sim_heating.inputs.ratio_sources import write_tables
from sim_heating.inputs.record import load_record, make_record
from sim_heating.inputs.scenario import load_scenario
from sim_heating.inputs.vehicle import Vehicle, load_vehicle
from sim_heating.march.history import march_points
from sim_heating.march.mesh_choice import choose_meshes
from sim_heating.simulation.fmu_export.export import export_fmu
from sim_heating.simulation.plugin import HeatingPlugin, host_array, point_constants
from sim_heating.simulation.plugin_kernel import derive_conditions
from sim_heating.simulation.predict import predict
from sim_heating.simulation.run import RunResult, run, with_reference_heating
from sim_heating.simulation.synthesize import synthesize, write_records
from tests.support.fmu_hosts import Host
from tests.support.gliding import gliding
from tests.support.paths import ORBITER

EDGES = {"V09T9527": ("edge-laminar", 1.5), "BODYFLAP": ("edge-turbulent", -2.0)}
POINTS = [*EDGES, "NOSECAP"]


def without_recovery(text: str) -> str:
    return re.sub(r"^(# )?(recovery|local_angle_deg)\b.*\n", "", text, flags=re.M)


def with_edges(folder: Path, **changed: str) -> Path:
    """The Orbiter whose EDGES have one; `changed` are other names of a point's recovery in its table."""
    shutil.copytree(ORBITER, folder)
    for name in POINTS:
        kind, angle = EDGES.get(name, ("total", None))
        point, table = folder / f"control_points/{name}.toml", folder / f"ratio_tables/{name}.csv"
        keys = "" if angle is None else f'recovery = "{kind}"\nlocal_angle_deg = {angle}\n'
        point.write_text(without_recovery(point.read_text()).replace("\nsource =", f"\n{keys}source =", 1))
        table.write_text(f"# recovery: {changed.get(name, kind)}\n{without_recovery(table.read_text())}")
    return folder


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory) -> Vehicle:
    return load_vehicle(with_edges(tmp_path_factory.mktemp("vehicles") / "orbiter"))


@pytest.fixture(scope="module")
def scenario(vehicle, tmp_path_factory):
    file = tmp_path_factory.mktemp("scenario") / "glide.toml"
    file.write_text(gliding(30.0, *POINTS, vehicle=vehicle.directory))
    return load_scenario(file, root=vehicle.directory.parent.parent)


@pytest.fixture(scope="module")
def result(scenario) -> RunResult:
    return run(scenario)


@pytest.fixture(scope="module")
def marched(result) -> np.ndarray:
    """(time, point) surface temperatures [K] on the meshes of a host, which knows no flight to refine them for."""
    models, flights = zip(*((result.points[n].model, result.points[n].conditions) for n in POINTS), strict=True)
    chosen = [replace(m, nodes=mesh.nodes) for m, (mesh, _) in zip(models, choose_meshes(models), strict=True)]
    return np.transpose([history.surface_K for history in march_points(chosen, flights)])


@pytest.fixture(scope="module")
def flown(result) -> Conditions:
    return result.flight.conditions


def frames(flown: Conditions) -> list[np.ndarray]:
    return [np.array([flown[name][i] for name in FRAME]) for i in range(len(flown))]


def edge_enthalpy(flown: Conditions, name: str) -> np.ndarray:
    """The recovery enthalpy of a point of EDGES, in own words."""
    V, angle = flown["velocity_m_s"], flown["alpha_deg"] + EDGES[name][1]
    if name == "BODYFLAP":
        angle = angle + flown["bodyflap_deg"]
    r = 0.71**0.5 if EDGES[name][0] == "edge-laminar" else 0.71 ** (1 / 3)
    return V**2 / 2 * (1 - (1 - r) * np.cos(np.radians(angle)) ** 2) + 1004.5 * flown["T_inf_K"]


def last_temperatures(host: Host, given: list[dict[str, float]]) -> np.ndarray:
    host.start(given[0])
    for frame in given[1:]:
        host.step(frame)
    return np.array(host.get(*(f"{p}.surface_K" for p in POINTS)))


def refusal(host: Host, table: Path) -> str:
    """Why the FMU does not take a ratio table in place of that of V09T9527; nothing where it does."""
    host.fmu.reset()
    try:
        host.fmu.setString([host.refs["V09T9527.ratio_table.file"]], [str(table)])
    except FMICallException:
        return host.messages[-1]
    return ""


@pytest.mark.thorough
def test_the_conditions_of_a_point_have_the_enthalpy_of_its_edge(vehicle, flown):
    for name in EDGES:
        along = conditions_at_point(vehicle, vehicle.control_point(name), flown)
        np.testing.assert_allclose(along["H_r_J_kg"], edge_enthalpy(flown, name), rtol=1e-12)


def test_a_host_s_frame_has_the_enthalpies_of_the_march(vehicle, flown):
    points = [vehicle.control_point(name) for name in POINTS]
    marched = [conditions_at_point(vehicle, p, flown) for p in points]
    vectors = np.zeros((len(points), N_CONDITIONS))
    for i, frame in enumerate(frames(flown)):
        derive_conditions(frame, host_array(vehicle), point_constants(vehicle, points), np.arange(len(points)), vectors)
        np.testing.assert_allclose(vectors[:, RECOVERY_ENTHALPY], [m["H_r_J_kg"][i] for m in marched], rtol=1e-6)
        np.testing.assert_allclose(vectors[:, RECOVERY_RISE], [m["H_r_rise_J_kg"][i] for m in marched], rtol=1e-9)
    assert vectors[0, RECOVERY_RISE] > 0.0
    assert vectors[1:, RECOVERY_RISE].tolist() == [0.0, 0.0]


def test_plug_in_and_fmu_heat_with_it(vehicle, flown, marched, tmp_path):
    plugin = HeatingPlugin(vehicle, POINTS, longest_wait_s=0.0)
    stepped = []
    for i, frame in enumerate(frames(flown)):
        plugin.reset(frame) if i == 0 else plugin.step(frame)
        stepped.append(plugin.surface_temperatures())
    np.testing.assert_allclose(stepped, marched, atol=0.01)
    given = [dict(zip(FRAME, frame.tolist(), strict=True)) for frame in frames(flown)]
    export_fmu(vehicle, tmp_path / "own.fmu", POINTS)
    with Host(tmp_path / "own.fmu") as host:
        np.testing.assert_array_equal(last_temperatures(host, given), stepped[-1])
        table, other = vehicle.directory / "ratio_tables/V09T9527.csv", tmp_path / "other.csv"
        assert refusal(host, table) == ""
        for text, why in (
            (without_recovery(table.read_text()), "states no recovery, which means total"),
            (table.read_text().replace("edge-laminar", "edge-turbulent"), "is reduced with recovery edge-turbulent"),
        ):
            other.write_text(text)
            assert why in refusal(host, other)


def test_a_host_that_brings_its_own_reference_heating_gives_the_enthalpy_of_the_flow(
    vehicle, flown, result, marched, tmp_path
):
    export_fmu(vehicle, tmp_path / "columns.fmu", POINTS, columns=True)
    flow = result.points["NOSECAP"].conditions  # total: it has no edge
    given = [
        {name: float(flown[name][i]) for name in FRAME} | {n: float(flow[n][i]) for n in ("h_ref_kg_m2_s", "H_r_J_kg")}
        for i in range(len(flown))
    ]
    with Host(tmp_path / "columns.fmu") as host:
        found = last_temperatures(host, given)
    np.testing.assert_allclose(found, marched[-1], rtol=0.0, atol=0.01)


@pytest.mark.thorough
def test_run_synthesize_and_predict_agree_on_it(vehicle, scenario, result, tmp_path):
    columns = with_reference_heating(result)
    assert "H_r_J_kg" not in columns
    records = synthesize(scenario, flight=result.flight)
    write_records(scenario, records, tmp_path / "records")
    for name in EDGES:
        record = load_record(tmp_path / "records" / name)
        assert record.declared.heating.recovery == EDGES[name][0]
        assert "H_r_rise_J_kg" not in record.conditions
        assert record.ratio_table is not None
        assert record.ratio_table.recovery == EDGES[name][0]
        np.testing.assert_allclose(record.conditions["H_r_J_kg"], edge_enthalpy(record.conditions, name), rtol=1e-9)
        np.testing.assert_allclose(columns[f"{name}_H_r_J_kg"], record.conditions["H_r_J_kg"], rtol=1e-12)
        # the record of a model gives what the column gives, and the same rise to turbulence
        point = vehicle.control_point(name)
        rise = conditions_at_point(vehicle, point, record.conditions)["H_r_rise_J_kg"]
        np.testing.assert_allclose(conditions_of_record(record)["H_r_rise_J_kg"], rise, rtol=1e-12)
        heating = record.declared.heating.model_copy(update={"reference": "fay-riddell"})
        modelled = replace(record, declared=record.declared.model_copy(update={"heating": heating}))
        np.testing.assert_allclose(conditions_of_record(modelled)["H_r_J_kg"], record.conditions["H_r_J_kg"], rtol=1e-9)
        check_reference(record, vehicle, point)
        with pytest.raises(InputError, match=r"reduced with recovery `edge-\w+`, the table of .* with `total`"):
            check_reference(record, vehicle, replace(point, recovery=Recovery("total")))
        marched = result.points[name].history
        np.testing.assert_allclose(
            predict(record).history.surface_K, np.interp(record.time_s, marched.time_s, marched.surface_K), atol=0.05
        )


# What a user gets wrong ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (
            'recovery = "edge-laminar"',
            '"edge-laminar" needs `local_angle_deg`, the angle that is added to alpha; add it',
        ),
        ("local_angle_deg = 2.0", 'is that of an edge; give `recovery` = "edge-laminar" or "edge-turbulent"'),
        ('recovery = "edge"\nlocal_angle_deg = 2.0', "edge-laminar"),
        ('recovery = "edge-laminar"\nlocal_angle_deg = 200.0', "local_angle_deg"),
    ],
)
def test_a_control_point_that_says_half_of_it_is_refused_in_a_line(tmp_path, capsys, keys, message):
    folder = with_edges(tmp_path / "orbiter")
    point = folder / "control_points/V09T9527.toml"
    point.write_text(without_recovery(point.read_text()).replace("\nsource =", f"\n{keys}\nsource =", 1))
    assert main(["validate", str(folder)]) == 2
    text = capsys.readouterr().err
    assert message in text
    assert "V09T9527.toml" in text


def test_a_table_of_another_enthalpy_than_its_control_point_is_refused(tmp_path):
    folder = with_edges(tmp_path / "orbiter", V09T9527="edge-turbulent")
    with pytest.raises(
        InputError,
        match=r"V09T9527\.csv, header `recovery`: is `edge-turbulent`; it must agree with `edge-laminar`",
    ):
        load_vehicle(folder)


def test_a_record_whose_table_is_of_another_enthalpy_is_refused(scenario, result, tmp_path):
    records = synthesize(scenario, flight=result.flight)
    write_records(scenario, records, tmp_path / "records")
    file = tmp_path / "records/V09T9527/ratio_table.csv"
    file.write_text(without_recovery(file.read_text()))
    message = "header `recovery`: is not stated, which means `total`; it must agree with `edge-laminar` of the record"
    with pytest.raises(InputError, match=message):
        load_record(file.parent)


def test_a_record_of_an_edge_with_the_total_enthalpy_in_its_column_is_refused(scenario, result, tmp_path):
    record = synthesize(scenario, flight=result.flight)["V09T9527"]
    flown = record.conditions
    total = flown.with_columns(H_r_J_kg=0.5 * flown["velocity_m_s"] ** 2 + 1004.5 * flown["T_inf_K"])
    message = r'column H_r_J_kg: is the total enthalpy; recovery = "edge-laminar" needs that of the point'
    with pytest.raises(InputError, match=message):
        make_record(record.declared, total, record.thermocouples, record.ratio_table, turbulent=record.turbulent)


def test_ratio_tables_state_the_enthalpy_of_their_source(tmp_path):
    folder = tmp_path / "orbiter"
    shutil.copytree(ORBITER, folder)
    source, point = folder / "ratio_sources/lee_upper.toml", folder / "control_points/LEE_UPPER.toml"
    source.write_text(source.read_text().replace("\nrevision =", '\nrecovery = "edge-laminar"\nrevision =', 1))
    with pytest.raises(InputError, match="it must agree with `total` of the control point; give both the same"):
        write_tables(folder)
    keys = 'recovery = "edge-laminar"\nlocal_angle_deg = -30.0'
    point.write_text(point.read_text().replace("\nsource =", f"\n{keys}\nsource =", 1))
    write_tables(folder)
    assert "# recovery: edge-laminar\n" in (folder / "ratio_tables/LEE_UPPER.csv").read_text()
    assert load_vehicle(folder).control_point("LEE_UPPER").recovery == Recovery("edge-laminar", -30.0)
