"""The plug-in alongside a host: frames agree with the march; pauses, snapshots and errors of hosts."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_heating.base.conditions import FRAME, Conditions
from sim_heating.base.errors import InputError
from sim_heating.inputs.points import conditions_at_point, conditions_behind_walls, point_of_vehicle
from sim_heating.inputs.scenario import load_scenario
from sim_heating.inputs.vehicle import Vehicle, load_vehicle
from sim_heating.march.history import march_points
from sim_heating.simulation.plugin import HeatingPlugin
from sim_heating.simulation.plugin_jsbsim import JSBSimHeating
from sim_heating.simulation.run import fly_scenario
from sim_heating.simulation.run import run as run_scenario
from sim_heating.trajectory import entry3dof
from sim_heating.trajectory.jsbsim.host import InitialState, JSBSimHost, open_vehicle
from sim_heating.trajectory.spec import TrajectorySpec
from tests.support.paths import AIRCRAFT, ROOT

approx = pytest.approx
POINTS = ("V09T9527", "V07T9730", "V07T9975")
FRAME_0 = {
    "time_s": 0.0, "altitude_m": 74000.0, "velocity_m_s": 6800.0, "alpha_deg": 40.0, "beta_deg": 0.0,
    "elevon_deg": 1.0, "bodyflap_deg": 15.0, "rho_kg_m3": 4.6e-5, "jets": 0.0,
}  # fmt: skip
GLIDE = {
    "source": "entry-3dof",
    "initial": {
        "altitude_m": 74000.0, "velocity_m_s": 6800.0, "gamma_deg": -0.1, "heading_deg": 60.0, "latitude_deg": 10.0,
    },
    "stop": {"time_s": 120.0},
    "manoeuvre": [{"kind": "popu", "at_time_s": 60.0}],
}  # fmt: skip


def frame(at_s: float, **changes: float) -> np.ndarray:
    """A frame of a steady glide at a time."""
    return np.array([{**FRAME_0, "time_s": at_s, **changes}[name] for name in FRAME])


def glide(rate_hz: float) -> tuple[Conditions, list[np.ndarray]]:
    """Two minutes through a POPU: the samples of a flight and all its frames."""
    frames: list[np.ndarray] = []
    spec = TrajectorySpec.model_validate(GLIDE | {"rate_hz": rate_hz, "sample_s": 1.0 / rate_hz})
    flight = entry3dof.fly(spec, load_vehicle(AIRCRAFT / "orbiter"), on_frame=lambda row: frames.append(row.copy()))
    return flight.conditions, frames


@pytest.fixture(scope="module")
def orbiter() -> Vehicle:
    return load_vehicle(AIRCRAFT / "orbiter")


@pytest.fixture(scope="module")
def shared(orbiter: Vehicle) -> HeatingPlugin:
    return HeatingPlugin(orbiter, POINTS)


@pytest.fixture(scope="module")
def every_frame(orbiter: Vehicle) -> HeatingPlugin:
    """A plug-in that takes a thermal step with every frame."""
    return HeatingPlugin(orbiter, POINTS, longest_wait_s=0.0)


@pytest.fixture
def plugin(shared: HeatingPlugin) -> HeatingPlugin:
    """A plug-in at the start of a steady glide."""
    shared.reset(frame(0.0))
    return shared


@pytest.fixture(scope="module")
def twenty_hertz() -> tuple[Conditions, list[np.ndarray]]:
    return glide(20.0)


def run(plugin: HeatingPlugin, frames: Iterable[np.ndarray]) -> np.ndarray:
    """Surface and bondline temperatures after all frames."""
    for i, values in enumerate(frames):
        if i == 0:
            plugin.reset(values)
        else:
            plugin.step(values)
    return np.concatenate([plugin.surface_temperatures(), plugin.bondline_temperatures()])


# Agreement with the march ---------------------------------------------------------------------------------------------


def test_frame_by_frame_is_the_march_over_the_same_conditions(
    orbiter: Vehicle, every_frame: HeatingPlugin, twenty_hertz: tuple[Conditions, list[np.ndarray]]
) -> None:
    flown, frames = twenty_hertz
    stepped = run(every_frame, frames)
    points = [orbiter.control_point(n) for n in POINTS]
    # on the plug-in's meshes: a march may refine them for its flight, which begins at once with full heating
    packed = zip(every_frame.ensemble.models, every_frame.ensemble.meshes, strict=True)
    models = {m.name: replace(m, nodes=mesh.nodes) for m, mesh in packed}
    flights = conditions_behind_walls(orbiter, points, flown, models)
    histories = march_points([models[n] for n in POINTS], flights)
    marched = [*(h.surface_K[-1] for h in histories), *(h.bondline_K[-1] for h in histories)]
    behind = np.array([p.declared.interface is not None for p in points] * 2)
    np.testing.assert_allclose(stepped[~behind], np.array(marched)[~behind], rtol=0.0, atol=1e-6)
    # the wall upstream of an interface is extrapolated over a frame
    np.testing.assert_allclose(stepped[behind], np.array(marched)[behind], rtol=0.0, atol=0.01)


@pytest.mark.parametrize(("wait_s", "tolerance_K"), [(0.0, 1e-6), (0.25, 0.05)])
def test_a_thermocouple_that_lags_reads_as_in_a_march(
    orbiter: Vehicle, twenty_hertz: tuple[Conditions, list[np.ndarray]], wait_s: float, tolerance_K: float
) -> None:
    flown, frames = twenty_hertz
    point = orbiter.control_point("V09T9527")
    late = replace(point, sensors=tuple(s.model_copy(update={"tau_s": 8.0}) for s in point.sensors))
    vehicle = replace(orbiter, control_points={late.name: late})
    plugin = HeatingPlugin(vehicle, [late.name], longest_wait_s=wait_s)
    plugin.reset(frames[0])
    read = [list(plugin.sensors_K.values())]
    for values in frames[1:]:
        plugin.step(values)
        read.append(list(plugin.sensors_K.values()))
    nodes = plugin.ensemble.meshes[0].nodes
    models = [replace(point_of_vehicle(orbiter, p), nodes=nodes) for p in (late, point)]
    behind, without = (
        march_points([model], [conditions_at_point(orbiter, point, flown)])[0].sensors_K for model in models
    )
    assert np.max(np.abs(behind - without)) > 20.0
    np.testing.assert_allclose(np.transpose(read), behind, rtol=0.0, atol=tolerance_K)


@pytest.mark.parametrize("every", [1, 2, 4, 10])
def test_hosts_of_other_frame_rates_agree(
    every: int, plugin: HeatingPlugin, twenty_hertz: tuple[Conditions, list[np.ndarray]]
) -> None:
    # 20, 10, 5 and 2 Hz over one flight: what differs is the chord of the conditions and the thermal step
    _, frames = twenty_hertz
    fast = run(plugin, frames)
    assert len(frames[::every]) * every >= len(frames)
    np.testing.assert_allclose(run(plugin, frames[::every]), fast, rtol=0.0, atol=0.02)


@pytest.mark.sample(1)
@pytest.mark.parametrize("rate_hz", [60.0, 120.0])
def test_hosts_at_60_and_120_hertz_agree_with_one_at_20(
    rate_hz: float, plugin: HeatingPlugin, twenty_hertz: tuple[Conditions, list[np.ndarray]]
) -> None:
    slow = run(plugin, twenty_hertz[1])
    np.testing.assert_allclose(run(plugin, glide(rate_hz)[1]), slow, rtol=0.0, atol=0.05)  # K


def test_the_step_may_change_from_frame_to_frame(plugin: HeatingPlugin) -> None:
    times = np.cumsum([0.0, *([1 / 60] * 60), *([1 / 20] * 20), *([1 / 120] * 120), 1.0, 0.5, 0.5])
    uneven = run(plugin, [frame(t) for t in times])
    even = run(plugin, [frame(t) for t in np.linspace(0.0, times[-1], 301)])
    np.testing.assert_allclose(uneven, even, rtol=0.0, atol=0.02)


def test_a_long_frame_is_divided_into_thermal_steps(plugin: HeatingPlugin) -> None:
    at_once = run(plugin, [frame(0.0), frame(30.0, alpha_deg=44.0)])
    frames = [frame(t, alpha_deg=40.0 + 4.0 * t / 30.0) for t in np.linspace(0.0, 30.0, 31)]
    # what is linear between frames is what was derived at them: surface pressure, 0.0002 K here, the recovery enthalpy,
    # which goes with the square of the cosine of the angle, 0.002 K, and the heat of dissociation, 0.09 K
    np.testing.assert_allclose(at_once, run(plugin, frames), rtol=0.0, atol=0.12)


def test_values_of_a_frame_are_reached_linearly_at_its_end(plugin: HeatingPlugin) -> None:
    early = run(plugin, [frame(0.0), frame(1e-6, alpha_deg=45.0), frame(10.0, alpha_deg=45.0)])
    ramped = run(plugin, [frame(0.0), frame(10.0, alpha_deg=45.0)])
    assert early[0] > ramped[0] + 1.0


def test_steady_flight_takes_one_newton_iteration_a_stage(
    every_frame: HeatingPlugin, twenty_hertz: tuple[Conditions, list[np.ndarray]]
) -> None:
    """A step has two stages, and begins along the parabola of the one before."""
    _, frames = twenty_hertz
    run(every_frame, frames)
    a_step = every_frame.ensemble.counters.iterations / (len(frames) - 1)
    assert np.all(a_step >= 2.0)
    assert np.all(a_step < 2.2), a_step


def test_a_second_vehicle_flies_with_the_same_plug_in() -> None:
    capsule = HeatingPlugin(load_vehicle(AIRCRAFT / "capsule"))
    capsule.reset(frame(0.0, alpha_deg=20.0))
    for t in range(1, 61):
        capsule.step(frame(float(t), alpha_deg=20.0))
    hottest = max(capsule.surface_K, key=lambda name: capsule.surface_K[name])
    assert hottest in ("FACE", "SHOULDER")
    assert all(290.0 < T < 2500.0 for T in capsule.surface_K.values())


# Between thermal steps -----------------------------------------------------------------------------------------------

STEADY: dict[str, float] = {}
BURST = {"jets": 1.0, "alpha_deg": 42.0, "rho_kg_m3": 6e-5}
"""Values of a frame while jets fire for 50 ms in a gust."""


def steady_60_hertz(
    seconds: float, changes: Mapping[str, float], changed_from: int = 600, changed_to: int = 603
) -> list[np.ndarray]:
    """Frames of a glide at 60 Hz, some of them with other values."""
    return [frame(i / 60.0, **(changes if changed_from <= i < changed_to else {})) for i in range(int(60 * seconds))]


def largest_difference_K(one: HeatingPlugin, other: HeatingPlugin, frames: list[np.ndarray]) -> float:
    """Largest difference of any temperature after any frame."""
    one.reset(frames[0])
    other.reset(frames[0])
    largest = 0.0
    for values in frames[1:]:
        one.step(values)
        other.step(values)
        largest = max(largest, float(np.max(np.abs(one.temperatures() - other.temperatures()))))
    return largest


@pytest.mark.parametrize("changes", [STEADY, BURST], ids=["cold wall in full heating", "burst of three frames"])
def test_temperatures_between_thermal_steps_are_those_of_a_step_with_every_frame(
    changes: dict[str, float], plugin: HeatingPlugin, every_frame: HeatingPlugin
) -> None:
    assert largest_difference_K(plugin, every_frame, steady_60_hertz(20.0, changes)) < 0.02


def test_temperatures_between_thermal_steps_follow_a_popu(plugin: HeatingPlugin, every_frame: HeatingPlugin) -> None:
    # 0.023 K where the atoms of the flow, linear between thermal steps, pass a corner of the gas table
    assert largest_difference_K(plugin, every_frame, glide(60.0)[1]) < 0.03


def test_a_commanded_staircase_acts_with_its_mean(orbiter: Vehicle) -> None:
    """A body flap that retracts by 0.02 deg ten times a second, met at the same place of every second stair."""
    plugins = [HeatingPlugin(orbiter, ["BODYFLAP"], longest_wait_s=wait_s) for wait_s in (0.2, 0.0)]
    late = {"altitude_m": 33e3, "velocity_m_s": 1440.0, "alpha_deg": 21.8, "rho_kg_m3": 8.9e-3}
    stairs = (np.arange(3600) + 5) // 6
    apart = []
    for i, stair in enumerate(stairs):
        values = frame(i / 60.0, **late, bodyflap_deg=14.0 - 0.02 * stair)
        for plugin in plugins:
            plugin.reset(values) if i == 0 else plugin.step(values)
        apart.append(plugins[0].surface_K["BODYFLAP"] - plugins[1].surface_K["BODYFLAP"])
    assert abs(np.mean(apart[-1200:])) < 0.004


@pytest.mark.thorough
def test_over_an_entry_at_60_hertz_every_point_keeps_the_promise() -> None:
    """All points of the nominal entry: within 0.02 K of a step with every frame, 0.1 K of `run`."""
    scenario = load_scenario(ROOT / "scenarios" / "nominal.toml")
    frames: list[np.ndarray] = []
    flight = fly_scenario(scenario, on_frame=lambda row: frames.append(row.copy()))
    waiting, every = (HeatingPlugin(scenario.vehicle, scenario.names, longest_wait_s=wait_s) for wait_s in (0.25, 0.0))
    surface, apart = [], 0.0
    for i, values in enumerate(frames):
        for plugin in (waiting, every):
            plugin.reset(values) if i == 0 else plugin.step(values)
        apart = max(apart, float(np.max(np.abs(waiting.temperatures() - every.temperatures()))))
        surface.append(waiting.surface_temperatures())
    assert apart < 0.02
    result = run_scenario(scenario, flight=flight)
    clock = np.array([values[0] for values in frames])
    for k, name in enumerate(scenario.names):
        history = result.points[name].history
        known = history.time_s <= clock[-1] + 1e-6
        at = np.searchsorted(clock, history.time_s[known] - 1e-6)
        assert np.max(np.abs(np.array(surface)[at, k] - history.surface_K[known])) < 0.1


def test_a_quiet_flight_takes_a_thermal_step_every_quarter_of_a_second(plugin: HeatingPlugin) -> None:
    heated = []
    for values in steady_60_hertz(60.0, STEADY)[1:]:
        plugin.step(values)
        assert plugin.time_s == values[0]
        heated.append(round(60.0 * plugin.heated_s))
    assert heated[0] == 1  # without a step to extrapolate from, every frame is one
    assert heated[-1] - heated[-16] == 15
    assert len(set(heated)) < len(heated) / 12


def test_a_frame_off_the_line_is_stepped_to_at_once(plugin: HeatingPlugin) -> None:
    frames = steady_60_hertz(11.0, STEADY)
    run(plugin, frames[:600])
    n = 600
    while plugin.heated_s == plugin.time_s:
        plugin.step(frames[n])
        n += 1
    plugin.step(frame(n / 60.0, **BURST))
    assert plugin.heated_s == plugin.time_s


def test_frames_of_a_second_heat_a_cold_wall_as_short_frames_do(every_frame: HeatingPlugin) -> None:
    coarse, fine = (run(every_frame, [frame(i / n, rho_kg_m3=4e-4) for i in range(5 * n + 1)]) for n in (1, 64))
    np.testing.assert_allclose(coarse, fine, rtol=0.0, atol=0.05)  # undivided frames are 0.18 K off


def test_the_wait_does_not_change_a_flight_with_long_frames(plugin: HeatingPlugin, every_frame: HeatingPlugin) -> None:
    frames = [frame(float(t), alpha_deg=40.0 + 0.1 * t) for t in range(30)]
    np.testing.assert_array_equal(run(plugin, frames), run(every_frame, frames))


def test_a_flight_rewound_into_a_wait_repeats_itself_to_the_bit(plugin: HeatingPlugin) -> None:
    frames = steady_60_hertz(12.0, BURST)
    run(plugin, frames[:598])
    saved, heated_s = plugin.snapshot(), plugin.heated_s
    assert heated_s < plugin.time_s

    def onwards() -> np.ndarray:
        return np.array([(plugin.step(values), plugin.temperatures().copy())[1] for values in frames[598:]])

    first = onwards()
    plugin.restore(saved)
    assert plugin.heated_s == heated_s
    np.testing.assert_array_equal(onwards(), first)


# Pauses, snapshots and resets ----------------------------------------------------------------------------------------


def test_a_paused_host_changes_nothing(plugin: HeatingPlugin) -> None:
    plugin.step(frame(1.0))
    plugin.step(frame(1.0 + 1 / 60))
    before, published = plugin.ensemble.state.copy(), plugin.temperatures().copy()
    for _ in range(100):
        plugin.step(frame(1.0 + 1 / 60))
    np.testing.assert_array_equal(plugin.ensemble.state, before)
    np.testing.assert_array_equal(plugin.temperatures(), published)


def test_a_rewound_flight_repeats_itself_to_the_bit(plugin: HeatingPlugin) -> None:
    for t in range(1, 20):
        plugin.step(frame(float(t)))
    saved = plugin.snapshot()
    later = [frame(float(t), alpha_deg=42.0, rho_kg_m3=5e-5) for t in range(20, 40)]
    for values in later:
        plugin.step(values)
    first = plugin.ensemble.state.copy()
    plugin.restore(saved)
    assert plugin.time_s == 19.0
    for values in later:
        plugin.step(values)
    np.testing.assert_array_equal(plugin.ensemble.state, first)


def test_a_snapshot_does_not_change_while_the_flight_goes_on(plugin: HeatingPlugin) -> None:
    saved = plugin.snapshot()
    kept = saved.state.copy()
    plugin.step(frame(10.0))
    np.testing.assert_array_equal(saved.state, kept)


def test_a_flight_after_a_reset_repeats_the_first_to_the_bit(plugin: HeatingPlugin) -> None:
    frames = [frame(float(t), alpha_deg=40.0 + 0.1 * t) for t in range(30)]
    first = run(plugin, frames)
    plugin.reset(frame(0.0))
    assert plugin.surface_K["V09T9527"] == 290.0
    np.testing.assert_array_equal(run(plugin, frames), first)


# Errors of hosts ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FRAME)
def test_a_nan_is_refused_and_changes_nothing(name: str, plugin: HeatingPlugin) -> None:
    plugin.step(frame(1.0))
    before = plugin.ensemble.state.copy()
    with pytest.raises(InputError, match=name):
        plugin.step(frame(2.0, **{name: np.nan}))
    np.testing.assert_array_equal(plugin.ensemble.state, before)
    plugin.step(frame(2.0))


@pytest.mark.parametrize(
    "wrong",
    [
        {"altitude_m": 1e7}, {"velocity_m_s": -1.0}, {"velocity_m_s": 24000.0}, {"alpha_deg": 400.0},
        {"beta_deg": 120.0}, {"rho_kg_m3": 0.0}, {"rho_kg_m3": -1e-5}, {"jets": 2.0}, {"elevon_deg": np.inf},
    ],
    ids=lambda w: "-".join(w),
)  # fmt: skip
def test_an_implausible_value_is_refused_with_its_name(wrong: dict[str, float], plugin: HeatingPlugin) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        plugin.step(frame(1.0, **wrong))
    with pytest.raises(InputError, match=next(iter(wrong))):
        plugin.reset(frame(0.0, **wrong))


def test_a_clock_that_goes_back_or_jumps_is_refused(plugin: HeatingPlugin) -> None:
    plugin.step(frame(10.0))
    with pytest.raises(InputError, match="went back from 10 to 9"):
        plugin.step(frame(9.0))
    with pytest.raises(InputError, match="jumped from 10 to 1010"):
        plugin.step(frame(1010.0))
    plugin.step(frame(10.5))
    assert plugin.time_s == 10.5


def test_a_sudden_density_spike_is_flagged_with_its_time(plugin: HeatingPlugin) -> None:
    for t in range(1, 6):
        plugin.step(frame(float(t)))
    assert plugin.flags.density_spikes == 0
    plugin.step(frame(6.0, rho_kg_m3=1e-4))
    assert plugin.flags.density_spikes == 1
    assert plugin.flags.last_spike_s == 6.0


def test_a_density_change_that_altitude_explains_is_not_a_spike(
    plugin: HeatingPlugin, twenty_hertz: tuple[Conditions, list[np.ndarray]]
) -> None:
    run(plugin, twenty_hertz[1][::20])
    assert plugin.flags.density_spikes == 0


def test_thermal_steps_outside_a_ratio_table_are_counted(plugin: HeatingPlugin) -> None:
    plugin.step(frame(1.0, alpha_deg=70.0))
    assert plugin.steps_outside["V09T9527"] >= 1


def test_frames_faster_and_higher_than_the_model_holds_are_counted_and_told(plugin: HeatingPlugin) -> None:
    plugin.step(frame(1.0))
    assert plugin.flags.too_fast == plugin.flags.too_high == 0
    plugin.step(frame(2.0, velocity_m_s=12e3))
    plugin.step(frame(3.0, altitude_m=400e3, rho_kg_m3=3e-12))
    assert (plugin.flags.too_fast, plugin.flags.too_high) == (1, 1)
    told = plugin.remarks()
    assert "1 frames above 8 km/s, to which the reference heating holds" in told
    assert "1 frames above 200 km, where the atmosphere ends" in told


def test_deflection_off_a_table_of_one_deflection_is_outside(plugin: HeatingPlugin) -> None:
    # the table of V09T9527 is for elevon and body flap at 0 alone
    plugin.reset(frame(0.0, elevon_deg=0.0, bodyflap_deg=0.0))
    plugin.step(frame(1.0, elevon_deg=0.0, bodyflap_deg=0.0))
    assert "V09T9527" not in plugin.steps_outside
    plugin.step(frame(2.0, elevon_deg=5.0, bodyflap_deg=0.0))
    assert plugin.steps_outside["V09T9527"] >= 1


def test_long_frame_is_heated_in_parts_and_told(plugin: HeatingPlugin) -> None:
    # 10 s of a steep descent in one frame, and as frames of a quarter second on the same line
    first, last = frame(0.0), frame(10.0, altitude_m=68e3, velocity_m_s=6300.0, rho_kg_m3=3e-4)
    plugin.reset(first)
    plugin.step(last)
    at_once = plugin.temperatures().copy()
    assert any("the longest frame has 10 s" in line for line in plugin.remarks())
    plugin.reset(first)
    rho = list(FRAME).index("rho_kg_m3")
    for share in np.arange(1, 41) / 40.0:
        between = first + share * (last - first)
        between[rho] = first[rho] * (last[rho] / first[rho]) ** share
        plugin.step(between)
    assert np.max(np.abs(plugin.temperatures() - at_once)) < 0.2


def test_a_frame_by_name_must_have_every_column_and_no_other(plugin: HeatingPlugin) -> None:
    plugin.step({**FRAME_0, "time_s": 1.0})
    with pytest.raises(InputError, match="unknown `aplha_deg`"):
        plugin.step({**FRAME_0, "aplha_deg": 40.0, "time_s": 2.0})
    with pytest.raises(InputError, match="`rho_kg_m3` is missing"):
        plugin.step({k: v for k, v in FRAME_0.items() if k != "rho_kg_m3"})
    with pytest.raises(InputError, match="float64"):
        plugin.step(np.zeros(3))


def test_a_step_before_the_first_frame_is_refused(orbiter: Vehicle) -> None:
    with pytest.raises(InputError, match="reset"):
        HeatingPlugin(orbiter, POINTS[:1]).step(frame(1.0))


def test_an_unknown_control_point_is_refused_with_the_nearest(orbiter: Vehicle) -> None:
    with pytest.raises(InputError, match="V09T9527"):
        HeatingPlugin(orbiter, ["V09T9572"])


@given(
    altitude_m=st.floats(0.0, 150e3),
    velocity_m_s=st.floats(0.0, 12e3),
    alpha_deg=st.floats(-90.0, 90.0),
    log_rho=st.floats(-10.0, 0.3),
    dt=st.floats(1e-3, 60.0),
)
def test_every_plausible_frame_gives_finite_positive_temperatures(
    shared: HeatingPlugin, altitude_m: float, velocity_m_s: float, alpha_deg: float, log_rho: float, dt: float
) -> None:
    shared.reset(frame(0.0))
    values = {"altitude_m": altitude_m, "velocity_m_s": velocity_m_s, "alpha_deg": alpha_deg}
    shared.step(frame(dt, rho_kg_m3=10.0**log_rho, **values))
    assert np.all(np.isfinite(shared.surface_temperatures()))
    assert np.all(shared.surface_temperatures() > 0.0)


# In JSBSim -----------------------------------------------------------------------------------------------------------

START = InitialState(74000.0, 6800.0, -0.1, 60.0, 10.0, alpha_deg=40.0)


@pytest.fixture
def host() -> JSBSimHost:
    made = open_vehicle(AIRCRAFT / "orbiter")
    made.start(START)
    return made


def test_jsbsim_publishes_the_plug_in_s_temperatures_as_properties(host: JSBSimHost, plugin: HeatingPlugin) -> None:
    heating = JSBSimHeating(host, plugin, sensors=True)
    for _ in range(60):
        host.step()
        heating.frame()
    for name in POINTS:
        assert host.getter(f"heating/{name}/surface-K")() == plugin.surface_K[name]
        assert host.getter(f"heating/{name}/bondline-K")() == plugin.bondline_K[name]
    assert host.getter("heating/V09T9527/V07T9528-K")() == plugin.sensors_K["V07T9528"]
    assert plugin.surface_K["V09T9527"] > 290.5


def test_a_jsbsim_script_reads_the_temperature_of_the_last_frame(
    host: JSBSimHost, plugin: HeatingPlugin, tmp_path: Path
) -> None:
    # an <output> of the host's own: its CSV row of frame n holds what the plug-in wrote after frame n - 1
    heating = JSBSimHeating(host, plugin)
    directive = tmp_path / "output.xml"
    directive.write_text(
        f'<?xml version="1.0"?><output name="{tmp_path}/heating.csv" type="CSV" rate="60">'
        "<property>heating/V09T9527/surface-K</property></output>"
    )
    assert host.fdm.set_output_directive(str(directive))
    host.fdm.run_ic()
    written = [host.getter("heating/V09T9527/surface-K")()]
    for _ in range(30):
        host.step()
        heating.frame()
        written.append(plugin.surface_K["V09T9527"])
    host.fdm.disable_output()
    rows = [float(line.split(",")[1]) for line in (tmp_path / "heating.csv").read_text().splitlines()[1:]]
    assert len(set(rows)) > 20
    np.testing.assert_allclose(rows[-5:], written[len(rows) - 6 : len(rows) - 1], rtol=1e-5)


def test_a_misspelt_property_is_refused_and_not_read_as_zero(host: JSBSimHost, plugin: HeatingPlugin) -> None:
    JSBSimHeating(host, plugin)
    with pytest.raises(InputError, match=r"no such JSBSim property; did you mean `heating/V09T9527/surface-K`"):
        host.getter("heating/V09T9527/surfce-K")


def test_a_host_that_lacks_a_reading_is_refused_when_it_is_opened(tmp_path: Path) -> None:
    from sim_heating.trajectory.aero import load_aero
    from sim_heating.trajectory.jsbsim.host import VEHICLE_READS, PropertyRead
    from sim_heating.trajectory.jsbsim.model import write_aircraft

    model = write_aircraft(load_aero(AIRCRAFT / "orbiter"), AIRCRAFT / "orbiter", tmp_path)
    with pytest.raises(InputError, match="fcs/elevon-pos-deg"):
        JSBSimHost(tmp_path, model, reads=dict(VEHICLE_READS) | {"elevon_deg": PropertyRead("fcs/elevn-pos-deg")})


def test_an_effect_of_the_truth_heats_the_plug_in_s_point(orbiter: Vehicle, plugin: HeatingPlugin) -> None:
    from sim_heating.heating.effects import use

    effects = {"V09T9527": (use("transition", {"log10_re_onset": 5.0, "factor": 3.0}),)}
    turbulent = HeatingPlugin(orbiter, POINTS, effects=effects)
    frames = [frame(float(t)) for t in range(120)]
    laminar = run(plugin, frames)
    heated = run(turbulent, frames)
    assert heated[0] / laminar[0] == approx(3.0**0.25, abs=0.03)  # radiation equilibrium
    assert heated[1] == laminar[1]


def test_a_vehicle_is_not_touched_by_its_plug_in(orbiter: Vehicle, plugin: HeatingPlugin) -> None:
    before = replace(orbiter)
    plugin.step(frame(5.0))
    assert orbiter == before


# Compilation --------------------------------------------------------------------------------------------------------


FIRST_STEPS = """
import sim_heating as sh
from numba.core import event
plugin = sh.HeatingPlugin(sh.load_vehicle("orbiter"), ["V09T9527"])
frame = {frame!r}
plugin.reset(frame)
with event.install_recorder("numba:compile") as compiled:
    plugin.warm_up()
    for i in range(1, 40):
        plugin.step(frame | {{"time_s": i / 60.0, "alpha_deg": 40.0 + (i > 20)}})
print(len(compiled.buffer))
"""


@pytest.mark.thorough
def test_nothing_is_compiled_after_the_reset() -> None:
    """A host in real time waits before its flight, not in its first frames.

    In a process of its own, as kernels stay compiled within one.
    """
    code = FIRST_STEPS.format(frame=FRAME_0)
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert int(result.stdout) == 0


def test_a_warm_up_leaves_the_flight_as_it_is(plugin: HeatingPlugin) -> None:
    plugin.step(frame(1.0))
    before = plugin.snapshot()
    plugin.warm_up()
    after = plugin.snapshot()
    for name in ("host", "published", "state"):
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name))
