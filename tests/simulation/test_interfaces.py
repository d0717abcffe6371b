"""Heating behind an interface: run, plug-in, record and estimate with the wall upstream."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_heating.base.conditions import FRAME, Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.block import N_CONDITIONS, UPSTREAM
from sim_heating.heating.atmosphere import free_stream, us76
from sim_heating.heating.interface import film_factor
from sim_heating.heating.reference.gas import wall_enthalpy_grid
from sim_heating.inputs.declared_effects import InterfaceDeclaration
from sim_heating.inputs.points import (
    conditions_at_point,
    conditions_behind_walls,
    conditions_of_record,
    excess_behind_interface,
    point_of_vehicle,
)
from sim_heating.inputs.record import Record, make_record
from sim_heating.inputs.vehicle import ControlPoint, Vehicle, load_vehicle
from sim_heating.march.history import PointHistory, march_points
from sim_heating.simulation.plugin import HeatingPlugin, host_array, point_constants
from sim_heating.simulation.plugin_kernel import derive_history
from sim_heating.simulation.predict import predict
from sim_heating.simulation.synthesize import flown_columns, ratio_table_of, record_declaration, turbulent_table_of

FELT, TILE = "V07T9975", "POD_LRSI"


@pytest.fixture(scope="module")
def orbiter() -> Vehicle:
    return load_vehicle("orbiter")


@pytest.fixture(scope="module")
def flown(orbiter: Vehicle) -> Conditions:
    """Two minutes at full heating of the pod, alpha swinging by 4 deg."""
    t = np.arange(0.0, 121.0, 0.5)
    z = 70e3 - 20.0 * t
    rho = np.array([us76(height)[2] for height in z])
    V = 6400.0 - 3.0 * t
    columns = free_stream(z, V, rho, orbiter.reference_length_m)
    alpha = 40.0 + 4.0 * np.sin(t / 8.0)
    zero = np.zeros_like(t)
    given = {"time_s": t, "altitude_m": z, "velocity_m_s": V, "rho_kg_m3": rho, "alpha_deg": alpha, "beta_deg": zero,
             "elevon_deg": zero, "bodyflap_deg": zero, "jets": zero}  # fmt: skip
    return Conditions(columns | given)


def march(vehicle: Vehicle, points: list[ControlPoint], flown: Conditions) -> list[PointHistory]:
    models = [point_of_vehicle(vehicle, p) for p in points]
    return march_points(models, conditions_behind_walls(vehicle, points, flown))


def with_interface(point: ControlPoint, **keys: object) -> ControlPoint:
    assert point.declared.interface is not None
    changed = InterfaceDeclaration(**{**point.declared.interface.model_dump(exclude_unset=True), **keys})  # type: ignore[arg-type]
    return replace(point, declared=point.declared.model_copy(update={"interface": changed}))


def test_the_film_of_an_unheated_starting_length_has_its_limits():
    assert film_factor("laminar", 0.0, 1.0) == 1.0
    assert film_factor("turbulent", 1.0, 1e9) == pytest.approx(1.0, abs=1e-6)
    assert film_factor("laminar", 1.0, 2.0, 1e-4) == pytest.approx(film_factor("laminar", 1.0, 2.0), rel=1e-6)
    # half a footprint over the step: its singularity is integrable, F ~ (3/4 xi)^(-1/3), mean 3/2 of that at the end
    assert film_factor("laminar", 1.0, 1.0 + 1e-9, 2e-5) == pytest.approx(
        1.5 * film_factor("laminar", 1.0, 1.00001), rel=1e-3
    )
    with pytest.raises(InputError, match="lies behind the step"):
        film_factor("laminar", 1.0, 1.0)


def test_excess_is_told_where_there_is_heating_alone(orbiter: Vehicle, flown: Conditions) -> None:
    """A relative change of a heating near zero has no meaning; elsewhere it is that of equation 1."""
    felt = orbiter.control_point(FELT)
    (along,) = conditions_behind_walls(orbiter, [felt], flown)
    (history,) = march_points([point_of_vehicle(orbiter, felt)], [along])
    wall = np.interp(flown.time_s, history.time_s, history.surface_K)
    excess = excess_behind_interface(orbiter, felt, along, wall)
    assert np.all(excess[10:] != 0.0)
    fading = along.with_columns(h_ref_kg_m2_s=along["h_ref_kg_m2_s"] * np.linspace(1.0, 0.0, len(flown)) ** 4)
    faded = excess_behind_interface(orbiter, felt, fading, wall)
    assert np.all(faded[-20:] == 0.0)
    np.testing.assert_allclose(faded[10:40], excess[10:40])


def test_a_wall_upstream_of_the_same_temperature_changes_nothing(orbiter: Vehicle, flown: Conditions) -> None:
    felt = orbiter.control_point(FELT)
    same = replace(with_interface(felt, upstream="felt ahead"), upstream=felt.construction)
    alike = march(orbiter, [same], flown)[0].surface_K
    plain = march_points([point_of_vehicle(orbiter, felt)], [conditions_at_point(orbiter, felt, flown)])[0].surface_K
    np.testing.assert_allclose(alike, plain, rtol=0.0, atol=0.02)


def test_a_hotter_wall_upstream_heats_the_wall_behind_it_more(orbiter: Vehicle, flown: Conditions) -> None:
    felt = orbiter.control_point(FELT)
    (at_felt,) = conditions_behind_walls(orbiter, [felt], flown)
    model = point_of_vehicle(orbiter, felt)
    cp_J_kg = 1004.5 * 200.0
    hot, as_is, cold = (
        march_points([model], [at_felt.with_columns(H_upstream_J_kg=at_felt["H_upstream_J_kg"] + d)])[0].surface_K[-1]
        for d in (cp_J_kg, 0.0, -cp_J_kg)
    )
    assert cold < as_is < hot


def test_the_flux_is_that_of_the_superposed_starting_length(orbiter: Vehicle, flown: Conditions) -> None:
    felt = orbiter.control_point(FELT)
    (at_felt,) = conditions_behind_walls(orbiter, [felt], flown)
    model = point_of_vehicle(orbiter, felt)
    (history,) = march_points([model], [at_felt])
    plain = march_points([replace(model, interface=None)], [at_felt.with_columns(H_upstream_J_kg=0.0)])[0]
    assert felt.declared.interface is not None
    F = felt.declared.interface.interface.factors[0]
    h_0, H_1, H_r = plain.ratio * at_felt["h_ref_kg_m2_s"], at_felt["H_upstream_J_kg"], at_felt["H_r_J_kg"]
    H_2 = np.array([wall_enthalpy_grid("equilibrium-air", [T], [p])[0, 0]
                    for T, p in zip(history.surface_K, at_felt["p_surface_Pa"], strict=True)])  # fmt: skip
    expected = h_0 * ((H_r - H_1) + F * (H_1 - H_2))
    np.testing.assert_allclose(history.heat.convected_W_m2, expected, rtol=1e-4)


def test_the_plugin_follows_the_wall_upstream_as_the_march_does(orbiter: Vehicle, flown: Conditions) -> None:
    names = [FELT, "NOSE_HRSI"]
    points = [orbiter.control_point(name) for name in names]
    plugin = HeatingPlugin(orbiter, names, longest_wait_s=0.0)
    assert plugin.names == tuple(names)
    rows = np.column_stack([flown[name] for name in FRAME])
    plugin.reset(rows[0])
    read = [plugin.surface_temperatures()]
    for row in rows[1:]:
        plugin.step(row)
        read.append(plugin.surface_temperatures())
    # on the plug-in's meshes: a march may refine them for this flight, which begins at once with full heating
    nodes = {m.name: mesh.nodes for m, mesh in zip(plugin.ensemble.models, plugin.ensemble.meshes, strict=True)}
    models = {n: replace(point_of_vehicle(orbiter, orbiter.control_point(n)), nodes=nodes[n]) for n in nodes}
    flights = conditions_behind_walls(orbiter, points, flown, models)
    marched = [h.surface_K for h in march_points([models[name] for name in names], flights)]
    # The wall upstream is stepped first, in plug-in and march: the cap warms by 70 K in the first step of 0.5 s.
    np.testing.assert_array_equal(np.transpose(read), np.array(marched))


def record_of(vehicle: Vehicle, point: ControlPoint, flown: Conditions) -> Record:
    (conditions,) = conditions_behind_walls(vehicle, [point], flown)
    history = march(vehicle, [point], flown)[0]
    declared = record_declaration(vehicle, point, point.sensors, "pod", "two minutes")
    columns = {"time_s": history.time_s} | {s.column: T for s, T in zip(point.sensors, history.sensors_K, strict=True)}
    return make_record(
        declared, flown_columns(conditions), columns, ratio_table_of(point), point.name, turbulent_table_of(point)
    )


def test_a_record_holds_the_wall_upstream_and_is_predicted_alike(orbiter: Vehicle, flown: Conditions) -> None:
    point = orbiter.control_point(FELT)
    record = record_of(orbiter, point, flown)
    assert record.declared.heating.interface is not None
    assert "T_upstream_K" in record.conditions
    assert "H_upstream_J_kg" not in record.conditions
    np.testing.assert_allclose(
        predict(record).history.surface_K, march(orbiter, [point], flown)[0].surface_K, rtol=0.0, atol=1e-6
    )


def test_a_record_may_give_the_layers_of_the_wall_upstream(orbiter: Vehicle, flown: Conditions) -> None:
    record = record_of(orbiter, orbiter.control_point(FELT), flown)
    interface = record.declared.heating.interface
    assert interface is not None
    interface = interface.model_copy(update={"stack": record.declared.stack})
    heating = record.declared.heating.model_copy(update={"interface": interface})
    columns = {k: v for k, v in record.conditions.columns.items() if k != "T_upstream_K"}
    alike = replace(
        record, declared=record.declared.model_copy(update={"heating": heating}), conditions=Conditions(columns)
    )
    along = conditions_of_record(alike)
    np.testing.assert_allclose(along["T_upstream_K"], predict(alike).history.surface_K, rtol=0.0, atol=0.05)


def test_an_interface_without_its_wall_gets_one_line(orbiter: Vehicle, flown: Conditions) -> None:
    record = record_of(orbiter, orbiter.control_point(FELT), flown)
    columns = {k: v for k, v in record.conditions.columns.items() if k != "T_upstream_K"}
    with pytest.raises(InputError, match="there is no column `T_upstream_K`"):
        make_record(record.declared, Conditions(columns), record.thermocouples, record.ratio_table, FELT)
    heating = record.declared.heating.model_copy(update={"interface": None})
    declared = record.declared.model_copy(update={"heating": heating})
    with pytest.raises(InputError, match=r"has no effect without \[heating.interface\]"):
        make_record(declared, record.conditions, record.thermocouples, record.ratio_table, FELT)


def test_a_live_link_derives_conditions_without_the_wall_upstream(orbiter: Vehicle, flown: Conditions) -> None:
    points = [orbiter.control_point(FELT)]
    rows = np.column_stack([flown[name] for name in FRAME])
    histories = np.zeros((1, len(rows), N_CONDITIONS))
    derive_history(rows, host_array(orbiter), point_constants(orbiter, points), np.array([0]), histories)
    assert np.all(histories[..., UPSTREAM] == 0.0)
