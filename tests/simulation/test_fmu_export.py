"""The heating plug-in as an FMU: the simulator's numbers to the last bit, on hosts without Python."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
import threading
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from lxml import etree

from sim_heating.base.conditions import FRAME, RATIO_VARIABLES, Conditions
from sim_heating.base.errors import InputError
from sim_heating.cli import main
from sim_heating.heating.ratio.table import read_ratio_table, write_ratio_table
from sim_heating.inputs.points import conditions_at_point
from sim_heating.inputs.scenario import load_scenario
from sim_heating.inputs.vehicle import Vehicle, load_vehicle
from sim_heating.simulation.fmu_export.export import export_fmu
from sim_heating.simulation.fmu_export.heating import MODEL, THERMAL_STEP
from sim_heating.simulation.fmu_export.parts.library import TARGETS, CompilationUnit, compiler_command, object_code
from sim_heating.simulation.plugin import HeatingPlugin
from sim_heating.simulation.run import fly_scenario
from tests.support.fmu_hosts import SOURCES, Host, compile_host, link_model, run_host
from tests.support.json_output import run_json
from tests.support.paths import ROOT, SCENARIOS, TESTS

POINTS = ["V09T9527", "NOSECAP", "BODYFLAP"]
SURFACES = [f"{name}.surface_K" for name in POINTS]
Frame = dict[str, float]


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("orbiter")


@pytest.fixture(scope="module")
def fmus(vehicle, tmp_path_factory) -> dict[int, Path]:
    """The same control points for both versions of the standard."""
    folder = tmp_path_factory.mktemp("fmus")
    for fmi in (2, 3):
        export_fmu(vehicle, folder / f"fmi{fmi}.fmu", POINTS, fmi=fmi)
    return {fmi: folder / f"fmi{fmi}.fmu" for fmi in (2, 3)}


@pytest.fixture(scope="module")
def flown() -> Conditions:
    """A whole entry with a POPU."""
    return fly_scenario(load_scenario(ROOT / "scenarios" / "entry_3dof.toml")).conditions.with_columns(jets=0.0)


def frames(flown: Conditions, step_s: float, end_s: float = np.inf) -> list[Frame]:
    """Frames a communication step apart, at times that add up as a host's do."""
    times = [float(flown.time_s[0])]
    while times[-1] + step_s <= min(float(flown.time_s[-1]), end_s):
        times.append(times[-1] + step_s)
    at = flown.at(times)
    return [{name: float(at[name][i]) for name in FRAME} for i in range(len(times))]


def plugin_temperatures(vehicle: Vehicle, given: list[Frame], **more) -> np.ndarray:
    """(time, point) of the simulator's own plug-in, one thermal step a frame."""
    plugin = HeatingPlugin(vehicle, POINTS, longest_wait_s=0.0, **more)
    plugin.reset(given[0])
    found = [plugin.surface_temperatures()]
    for frame in given[1:]:
        plugin.step(frame)
        found.append(plugin.surface_temperatures())
    return np.array(found)


def fmu_temperatures(host: Host, given: list[Frame], outputs: Sequence[str] = SURFACES) -> np.ndarray:
    host.start(given[0])
    found = [host.get(*outputs)]
    for frame in given[1:]:
        host.step(frame)
        found.append(host.get(*outputs))
    return np.array(found)


# Numbers -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fmi", [pytest.param(2, marks=pytest.mark.thorough), 3])
def test_fmpy_validates_the_fmu_without_a_problem(fmus, fmi):
    assert validate_fmu(fmus[fmi]) == []
    assert all(unit.baseUnit for unit in fmpy.read_model_description(fmus[fmi]).unitDefinitions)


@pytest.mark.sample(1)
@pytest.mark.parametrize(("fmi", "step_s"), [(3, 0.5), (2, 1.0), (3, 0.7), (2, 3.0)])
def test_whole_entry_with_a_popu_has_the_bits_of_the_simulator(fmus, vehicle, flown, fmi, step_s):
    given = frames(flown, step_s)
    with Host(fmus[fmi]) as host:
        np.testing.assert_array_equal(fmu_temperatures(host, given), plugin_temperatures(vehicle, given))


@pytest.mark.sample(1)
@pytest.mark.parametrize("step_s", [1.0, 3.0])
def test_a_point_behind_an_interface_has_the_bits_of_the_simulator(vehicle, flown, tmp_path, step_s):
    given, name = frames(flown, step_s, 500.0), "NOSE_HRSI"
    plugin = HeatingPlugin(vehicle, [name], longest_wait_s=0.0)
    plugin.reset(given[0])
    export_fmu(vehicle, tmp_path / "behind.fmu", [name])
    with Host(tmp_path / "behind.fmu") as host:
        host.start(given[0])
        for frame in given[1:]:
            plugin.step(frame)
            host.step(frame)
            assert host.get(f"{name}.surface_K")[0] == plugin.surface_K[name]


@pytest.mark.parametrize("timing", ["reached", "updated"])
def test_plain_c_host_has_the_same_bits(fmus, vehicle, flown, tmp_path, timing):
    given = frames(flown, 1.0, 500.0)
    out = run_host(compile_host(tmp_path), fmus[3], timing, given, SURFACES)
    np.testing.assert_array_equal(out, plugin_temperatures(vehicle, given))


def test_the_c_host_takes_the_conditions_of_a_run_and_tells_which_columns_it_skips(fmus, flown, tmp_path):
    """A run writes more columns than a heating FMU has inputs: the host refused them."""
    given = frames(flown, 1.0, 20.0)
    more = [{"time_s": f["time_s"], "mach": 20.0, **f, "log10_re": 6.0} for f in given]  # log10_re is an output
    host = compile_host(tmp_path)
    exact = run_host(host, fmus[3], "reached", given, SURFACES)
    np.testing.assert_array_equal(run_host(host, fmus[3], "reached", more, SURFACES), exact)
    table, folder = fmus[3].with_suffix(".csv"), fmus[3].with_suffix("")
    told = subprocess.run([host, folder, "reached", table, SURFACES[0]], capture_output=True, text=True, check=True)
    assert "columns that are no inputs of the FMU, skipped: mach, log10_re\n" in told.stderr


def test_parameters_do_what_they_do_in_the_simulator(fmus, vehicle, flown):
    changed = {
        "ratio.scale": 0.1, "ratio.d_alpha2": 1e-4, "stack.coating.thickness_factor": 1.2,
        "stack.rsi.conductivity_factor": 0.8, "stack.emissivity_factor": 0.9, "stack.gap.fraction": 0.1,
    }  # fmt: skip
    given = frames(flown, 1.0, 400.0)
    with Host(fmus[3], {f"{p}.{name}": value for p in POINTS for name, value in changed.items()}) as host:
        found = fmu_temperatures(host, given)
    np.testing.assert_array_equal(found, plugin_temperatures(vehicle, given, parameters=changed))


def test_a_deeper_layer_has_the_parameters_of_its_name(fmus, flown):
    given, name = frames(flown, 1.0, 400.0), "V09T9527.stack.'nomex-sip'.heat_capacity_factor"
    with Host(fmus[3]) as plain, Host(fmus[3], {name: 3.0}) as changed:
        difference = fmu_temperatures(changed, given)[:, 0] - fmu_temperatures(plain, given)[:, 0]
    assert 0.0 < np.max(np.abs(difference)) < 1.0  # far below the surface


@pytest.mark.parametrize("step_s", [1.0, 3.0])
def test_a_thermocouple_lags_as_in_the_simulator(fmus, vehicle, flown, step_s):
    given, point = frames(flown, step_s, 300.0), vehicle.control_point(POINTS[0])
    sensor = f"{POINTS[0]}.sensor.{point.sensors[0].name}"
    late = replace(point, sensors=tuple(s.model_copy(update={"tau_s": 6.0}) for s in point.sensors))
    plugin = HeatingPlugin(replace(vehicle, control_points={late.name: late}), [late.name], longest_wait_s=0.0)
    plugin.reset(given[0])
    with Host(fmus[3], {f"{sensor}.tau_s": 6.0}) as host:
        host.start(given[0])
        for frame in given[1:]:
            plugin.step(frame)
            host.step(frame)
            (read,) = host.get(f"{sensor}.indicated_K")
            assert read == plugin.sensors_K[point.sensors[0].name]
        assert abs(read - plugin.surface_K[late.name]) > 1.0


def test_flux_into_the_wall_is_what_the_flow_brings_less_what_is_radiated(fmus, flown):
    given = frames(flown, 1.0, 400.0)
    with Host(fmus[3]) as host:
        fmu_temperatures(host, given)
        brought, radiated, absorbed, margin, surface = host.get(
            *(f"NOSECAP.{n}" for n in ("heating.convected_W_m2", "heating.radiated_W_m2", "heating.absorbed_W_m2",
                                       "limit.surface_margin_K", "surface_K"))
        )  # fmt: skip
    assert brought > absorbed > 0.0
    emissivity = load_vehicle("orbiter").materials["rcc"].emissivity
    blackbody = 5.670374419e-8 * surface**4
    assert radiated == pytest.approx(np.interp(surface, *np.transpose(emissivity)) * blackbody, rel=1e-3)
    assert brought == pytest.approx(radiated + absorbed, rel=1e-12)
    assert margin == pytest.approx(load_vehicle("orbiter").control_point("NOSECAP").limits.surface_K - surface)


def test_host_may_bring_its_own_reference_heating(vehicle, flown, tmp_path):
    """h_ref and H_r are those of a point: its ratio and the angle of its surface act in thin air."""
    export_fmu(vehicle, tmp_path / "columns.fmu", ["NOSECAP"], columns=True)
    given = frames(flown, 1.0, 300.0)
    columns = {name: np.array([f[name] for f in given]) for name in FRAME}
    own = flown.at(columns["time_s"])
    point = conditions_at_point(vehicle, vehicle.control_point("NOSECAP"), own)
    more = [
        {**f, "h_ref_kg_m2_s": float(point["h_ref_kg_m2_s"][i]), "H_r_J_kg": float(point["H_r_J_kg"][i])}
        for i, f in enumerate(given)
    ]
    expected = plugin_temperatures(vehicle, given)[:, POINTS.index("NOSECAP")]
    with Host(tmp_path / "columns.fmu") as host:
        found = fmu_temperatures(host, more, ["NOSECAP.surface_K"])[:, 0]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


# Timing of inputs ---------------------------------------------------------------------------------------------------


def test_held_input_is_late_by_half_a_step_and_an_interpolated_one_is_not(fmus, flown, tmp_path):
    host, end = compile_host(tmp_path), float(flown.time_s[0]) + 400.0
    fine = run_host(host, fmus[3], "reached", frames(flown, 0.25, end), SURFACES)
    rate = np.gradient(fine, 0.25, axis=0)

    def delay_s(timing: str, step_s: float) -> float:
        """The delay that explains the difference best."""
        found = run_host(host, fmus[3], timing, frames(flown, step_s, end), SURFACES)
        every = slice(None, None, round(step_s / 0.25))
        exact, slope = fine[every][: len(found)], rate[every][: len(found)]
        return float(np.sum((exact - found) * slope) / np.sum(slope**2))

    for step_s in (1.0, 2.0):
        assert 0.4 < delay_s("held", step_s) / step_s < 0.6
        assert abs(delay_s("updated", step_s)) < 0.02 * step_s


def without_enumerations(path: Path, value: int, given: list[Frame]) -> np.ndarray:
    """Temperatures in a host that drops enumerations and sets the integer in place of `input_timing`."""
    with Host(path, timing=None) as host:
        setter = host.fmu.setInt32 if host.three else host.fmu.setInteger
        setter([host.refs["input_timing_integer"]], [value])
        return fmu_temperatures(host, given)


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_host_without_enumerations_sets_the_timing_by_an_integer(fmus, flown, fmi):
    given, found = frames(flown, 1.0, 200.0), {}
    for name in ("held", "reached"):
        with Host(fmus[fmi], timing=name) as host:
            found[name] = fmu_temperatures(host, given)
    assert np.max(np.abs(found["held"] - found["reached"])) > 0.1  # K
    for value, name in ((0, "held"), (1, "held"), (2, "reached")):
        np.testing.assert_array_equal(without_enumerations(fmus[fmi], value, given), found[name])
    described = fmpy.read_model_description(fmus[fmi]).modelVariables
    assert next(v for v in described if v.name == "input_timing_integer").type == ("Integer" if fmi == 2 else "Int32")
    with Host(fmus[fmi], timing="reached") as host:  # a host that sets every start value, in whichever order
        (host.fmu.setInt32 if host.three else host.fmu.setInteger)([host.refs["input_timing_integer"]], [0])
        np.testing.assert_array_equal(fmu_temperatures(host, given), found["reached"])


def test_the_export_chooses_the_timing_of_hosts_that_set_none(vehicle, flown, tmp_path):
    out, given = tmp_path / "reached.fmu", frames(flown, 1.0, 200.0)
    command = ["fmu", "export", "orbiter", "--control-points", ",".join(POINTS), "--input-timing", "reached"]
    assert main([*command, "--out", str(out)]) == 0
    with Host(out, timing=None) as host:
        np.testing.assert_array_equal(fmu_temperatures(host, given), plugin_temperatures(vehicle, given))
    with pytest.raises(InputError, match="input_timing = `reachd`; did you mean `reached`"):
        export_fmu(vehicle, tmp_path / "x.fmu", POINTS, input_timing="reachd")


def test_input_derivatives_of_fmi_2_interpolate(fmus, vehicle, flown):
    given = frames(flown, 1.0, 300.0)
    inputs = [n for n in FRAME if n != "time_s"]
    with Host(fmus[2], timing="held") as host:
        host.start(given[0])
        for now, then in pairwise(given):
            host.set({n: now[n] for n in inputs})
            refs = [host.refs[n] for n in inputs]
            host.fmu.setRealInputDerivatives(refs, [1] * len(refs), [then[n] - now[n] for n in inputs])
            host.fmu.doStep(now["time_s"], 1.0)
        np.testing.assert_allclose(host.get(*SURFACES), plugin_temperatures(vehicle, given)[-1], atol=1e-6)


# States, instances, errors -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fmi", [2, 3])
def test_state_goes_back_and_through_bytes_to_another_instance(fmus, flown, fmi):
    given = frames(flown, 1.0, 320.0)
    first, rest, then = given[:250], given[250:], given[249]["time_s"]

    def go_on(host: Host) -> np.ndarray:
        for frame in rest:
            host.step(frame)
        return host.get(*SURFACES)

    with Host(fmus[fmi]) as host, Host(fmus[fmi]) as other:
        fmu_temperatures(host, first)
        state = host.save()
        once = go_on(host)
        host.restore(state, then)
        np.testing.assert_array_equal(go_on(host), once)
        copy = other.from_bytes(host.to_bytes(state))
        other.restore(copy, then)
        np.testing.assert_array_equal(go_on(other), once)
        other.drop(copy)
        host.drop(state)


@pytest.mark.parametrize("words", [(1000,), (1000, 1500), (20, 21, 1600)])
def test_damaged_state_is_refused_with_a_message(fmus, flown, words):
    """Highest bits too: a sum that is linear in the words loses two of them in each other."""
    with Host(fmus[3]) as host:
        host.start(frames(flown, 1.0, 1.0)[0])
        state = host.save()
        data = np.frombuffer(host.to_bytes(state), dtype=np.uint64).copy()
        data[list(words)] ^= np.uint64(1 << 63)
        with pytest.raises(FMICallException):
            host.from_bytes(data.tobytes())
        host.drop(state)
        assert "is damaged, or of another model" in host.messages[-1]


def test_instances_in_threads_do_not_disturb_each_other(fmus, flown):
    given = frames(flown, 1.0, 400.0)
    scales = [0.0, 0.1, -0.1, 0.2]
    hosts = [Host(fmus[3], {"NOSECAP.ratio.scale": scale}) for scale in scales]
    found: dict[int, np.ndarray] = {}

    def fly(i: int) -> None:
        found[i] = fmu_temperatures(hosts[i], given)

    threads = [threading.Thread(target=fly, args=(i,)) for i in range(len(hosts))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for i, scale in enumerate(scales):
        hosts[i].close()
        with Host(fmus[3], {"NOSECAP.ratio.scale": scale}) as alone:
            np.testing.assert_array_equal(found[i], fmu_temperatures(alone, given))


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    ("given", "hint"),
    [
        ({"rho_kg_m3": np.nan}, "rho_kg_m3 cannot be nan"),
        ({"velocity_m_s": 24_000.0}, "velocity_m_s is 24000; is not a speed in m/s"),
        ({"NOSECAP.stack.rsi.conductivity_factor": -1.0}, "cannot be -1; it must be from 0.001 to 10"),
    ],
)
def test_invalid_value_is_rejected_with_a_message_and_reset_recovers(fmus, flown, fmi, given, hint):
    first, then = frames(flown, 1.0, 1.5)[:2]
    with Host(fmus[fmi]) as host:
        host.start(first)
        with pytest.raises(FMICallException):
            host.step(then | given)
        assert hint in host.messages[-1]
        with pytest.raises(FMICallException):
            host.step(then)
        assert "not after an error" in host.messages[-1]
        host.fmu.reset()
        host.start(first)
        host.step(then)


@pytest.mark.parametrize(
    ("starts", "time", "length", "hint"),
    [
        (0.0, 5.0, 1.0, "the step begins at"),
        (0.0, 0.0, 0.0, "must be above 0"),
        (0.0, 0.0, 601.0, "the step from 0 s to 601 s is longer than 600 s, the longest that this FMU takes"),
        (50.0, 50.0, 700.0, "the step from 50 s to 750 s is longer than 600 s"),
        (1e9, 1e9, 1e-8, "lost in rounding"),
    ],
)
def test_invalid_step_is_refused(fmus, flown, starts, time, length, hint):
    with Host(fmus[3]) as host:
        host.start(frames(flown, 1.0, 1.5)[0] | {"time_s": starts})
        with pytest.raises(FMICallException):
            host.fmu.doStep(currentCommunicationPoint=time, communicationStepSize=length)
        assert hint in host.messages[-1]


def test_event_mode_is_declined_when_the_instance_is_asked_for(fmus):
    with Host(fmus[3]) as host:
        first = host.fmu.component
        with pytest.raises(Exception, match="Failed to instantiate"):
            host.fmu.instantiate(eventModeUsed=True, logMessage=host._log3)
        host.fmu.component = first
        assert host.messages == ["this FMU has no event mode; instantiate it with eventModeUsed = false"]


def test_held_input_out_of_range_is_reported_at_the_start_of_the_step(fmus, flown):
    with Host(fmus[3], timing="held") as host:
        host.start(frames(flown, 1.0, 1.0)[0])
        host.set({"alpha_deg": 181.0})
        with pytest.raises(FMICallException):
            host.fmu.doStep(currentCommunicationPoint=0.0, communicationStepSize=1.0)
        assert host.messages[-1].startswith("time 0 s: alpha_deg is 181; ")


# Tables and effects --------------------------------------------------------------------------------------------------


@pytest.fixture
def revised(tmp_path) -> Path:
    """The vehicle with a hotter nose cap, as a revision of its table."""
    folder = tmp_path / "orbiter"
    shutil.copytree(ROOT / "aircraft_data" / "orbiter", folder)
    path = folder / "ratio_tables" / "NOSECAP.csv"
    table = read_ratio_table(path)
    write_ratio_table(path, type(table)(table.axes, 1.2 * table.ratio, table.sigma, table.header))
    return folder


def test_revised_table_appears_in_a_re_export_by_path_and_as_an_array(fmus, flown, revised, tmp_path):
    given = frames(flown, 1.0, 400.0)
    export_fmu(load_vehicle(revised), tmp_path / "revised.fmu", POINTS)
    with Host(tmp_path / "revised.fmu") as host:
        exported = fmu_temperatures(host, given)
    with Host(fmus[3]) as host:
        host.fmu.setString([host.refs["NOSECAP.ratio_table.file"]], [str(revised / "ratio_tables" / "NOSECAP.csv")])
        by_path = fmu_temperatures(host, given)
    with Host(fmus[3]) as host:
        table = read_ratio_table(revised / "ratio_tables" / "NOSECAP.csv")
        host.fmu.setFloat64([host.refs["NOSECAP.ratio_table.ratio"]], table.ratio.ravel().tolist())
        as_array = fmu_temperatures(host, given)
    with Host(fmus[3]) as host:
        declared = fmu_temperatures(host, given)
    np.testing.assert_array_equal(by_path, exported)
    np.testing.assert_array_equal(as_array, exported)
    with Host(fmus[3]) as host:  # the last setting takes effect
        host.fmu.setString([host.refs["BODYFLAP.ratio_table.file"]], [str(revised / "ratio_tables" / "BODYFLAP.csv")])
        host.fmu.setString([host.refs["NOSECAP.ratio_table.file"]], [str(revised / "ratio_tables" / "LEE_UPPER.csv")])
        host.fmu.setFloat64([host.refs["NOSECAP.ratio_table.ratio"]], table.ratio.ravel().tolist())
        assert host.fmu.getString([host.refs["NOSECAP.ratio_table.file"]]) == [""]
        np.testing.assert_array_equal(fmu_temperatures(host, given), exported)
    with Host(fmus[3]) as host:
        for path in (str(revised / "ratio_tables" / "NOSECAP.csv"), ""):
            host.fmu.setString([host.refs["NOSECAP.ratio_table.file"]], [path])
        np.testing.assert_array_equal(fmu_temperatures(host, given), declared)
    assert np.max(exported[:, 1] - declared[:, 1]) > 10.0  # K


def test_table_set_repeatedly_takes_no_more_memory(fmus, revised):
    """A state holds all that an instance has."""
    sizes = []
    with Host(fmus[3]) as host:
        for k in range(20):
            name = ("NOSECAP", "LEE_UPPER")[k % 2]
            host.fmu.setString([host.refs["NOSECAP.ratio_table.file"]], [str(revised / f"ratio_tables/{name}.csv")])
            if k == 10:
                host.fmu.reset()
            state = host.save()
            sizes.append(len(host.to_bytes(state)))
            host.drop(state)
    assert len(set(sizes[2:10])) <= 2
    assert sizes[-2:] == sizes[:2]


@pytest.mark.parametrize(
    ("change", "hint"),
    [
        (
            lambda t: t.replace("reference: fay-riddell", "reference: sutton-graves"),
            "these ratios|is over sutton-graves",
        ),
        (lambda t: t.replace("ratio", "rato"), "unknown column rato"),
        (lambda t: t.replace("sigma", "ratio"), "two columns ratio"),
        (lambda t: re.sub(r",[^,]*$", ",-1.0", t, count=2, flags=re.M), 'sigma: "-1.0" is not valid|unknown column'),
        (lambda t: t + "# an afterthought\n", "is not valid"),
        (lambda t: "\n".join(t.splitlines()[:-1]), "do not fill the grid"),
        (lambda t: re.sub(r",[^,]*,([^,]*)$", r",nan,\1", t, count=1, flags=re.M), "is not valid|unknown column"),
    ],
)
def test_damaged_table_is_refused_with_its_path(fmus, tmp_path, change, hint):
    path = tmp_path / "table.csv"
    path.write_text(change((ROOT / "aircraft_data/orbiter/ratio_tables/NOSECAP.csv").read_text()))
    with Host(fmus[3]) as host:
        with pytest.raises(FMICallException):
            host.fmu.setString([host.refs["NOSECAP.ratio_table.file"]], [str(path)])
        assert re.search(hint, host.messages[-1])
        assert "table.csv" in host.messages[-1]


OWN_EFFECT = """
import math

from sim_heating import Effect, Parameter, flight, njit

@njit
def growth(B, c, p, wall_K):
    return 1.0 + B[p] * B[c + flight.mach]

EFFECT = Effect("mach-growth", "multiply", (Parameter("slope", "1", 0.01, 0.01, -1.0, 1.0, "a Mach number"),), growth)
"""


def own_effect(name: str, body: str) -> str:
    """The source of an effect with another body."""
    return OWN_EFFECT.replace("return 1.0 + B[p] * B[c + flight.mach]", body).replace("mach-growth", name)


def vehicle_with_effect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, source: str) -> Path:
    """The Orbiter with a user-defined effect at all points."""
    (tmp_path / "effects").mkdir()
    (tmp_path / "effects" / "own.py").write_text(source)
    monkeypatch.setenv("SIM_HEATING_EFFECTS", str(tmp_path / "effects"))
    folder = tmp_path / "orbiter"
    shutil.copytree(ROOT / "aircraft_data" / "orbiter", folder)
    for point in POINTS:
        with (folder / "control_points" / f"{point}.toml").open("a") as file:
            file.write(f'\n[[effect]]\nname = "{name}"\nsource = "test"\n')
    return folder


def test_user_defined_effect_is_compiled_in(fmus, vehicle, flown, tmp_path, monkeypatch):
    own = load_vehicle(vehicle_with_effect(tmp_path, monkeypatch, "mach-growth", OWN_EFFECT))
    shared = [path for unit in (MODEL, THERMAL_STEP) for path in unit.object_paths(TARGETS["linux"])]
    before = [path.stat().st_mtime_ns for path in shared]
    export_fmu(own, tmp_path / "own.fmu", POINTS)
    assert [
        path.stat().st_mtime_ns for path in shared
    ] == before  # object files shared by all vehicles are not compiled again
    given = frames(flown, 1.0, 400.0)
    with Host(tmp_path / "own.fmu") as host:
        np.testing.assert_array_equal(fmu_temperatures(host, given), plugin_temperatures(own, given))
        assert host.get("NOSECAP.effect.'mach-growth'.slope")[0] == 0.01


KERNELS = {
    "raises": (
        "if wall_K > 500.0:\n        raise ValueError(wall_K)\n    return 1.0",
        "raises, prints or allocates memory",
    ),
    "unknown": ("return math.nosuch(wall_K)", "cannot be compiled: module 'math' has no attribute 'nosuch'"),
    "of-numba": ("return math.gamma(wall_K)", "needs numba_gamma, which a host without Python lacks"),
    "prints": ("print(wall_K)\n    return 1.0", "raises, prints or allocates memory"),
}


@pytest.mark.sample(3)
@pytest.mark.parametrize("name", KERNELS)
def test_effect_that_needs_python_is_refused_by_name(name, tmp_path, monkeypatch):
    body, reason = KERNELS[name]
    own = load_vehicle(vehicle_with_effect(tmp_path, monkeypatch, name, own_effect(name, body)))
    with pytest.raises(InputError, match=rf"effect `{name}` \(.*own.py\).*{reason}"):
        export_fmu(own, tmp_path / "own.fmu", POINTS)
    assert not (tmp_path / "own.fmu").exists()


@pytest.mark.thorough
def test_effect_may_call_the_mathematical_functions_of_c(flown, tmp_path, monkeypatch):
    functions = ("erf", "erfc", "sinh", "cosh", "asinh", "expm1", "log1p", "log2", "hypot", "atan2")
    called = [f"math.{f}(u{', 2.0' if f in ('hypot', 'atan2') else ''})" for f in functions]
    body = f"u = 0.1 + B[p] * B[c + flight.mach]\n    return 1.0 + 1e-3 * ({' + '.join(called)} + round(u, 0))"
    own = load_vehicle(vehicle_with_effect(tmp_path, monkeypatch, "of-c", own_effect("of-c", body)))
    export_fmu(own, tmp_path / "own.fmu", POINTS)
    given = frames(flown, 1.0, 60.0)
    with Host(tmp_path / "own.fmu") as host:
        np.testing.assert_array_equal(fmu_temperatures(host, given), plugin_temperatures(own, given))


# Sampled maps --------------------------------------------------------------------------------------------------------

STRUCT = "org.fmi-standard.fmi-ls-struct"
LS_STRUCT = ROOT / "tests" / "data" / "fmi_ls_struct" / "fmi3LayeredStandardStructManifest.xsd"


class FmpySchemas(etree.Resolver):
    """Schemas of FMI 3.0 that another schema names by a network address: those that FMPy ships."""

    folder = Path(fmpy.__file__).parent / "schema" / "fmi3"

    def resolve(self, url: str, public_id: str, context: Any) -> Any:
        return self.resolve_filename(str(self.folder / url.rpartition("/")[2]), context) if "://" in url else None


@pytest.fixture(scope="module")
def maps(fmus) -> list[Any]:
    """The maps of the FMI 3 export as the example reads them, with nothing of sim_heating."""
    example = importlib.util.spec_from_file_location("ratio_maps", ROOT / "examples" / "ratio_maps.py")
    module = importlib.util.module_from_spec(example)
    example.loader.exec_module(module)
    assert module.sampled_maps(fmus[2]) == []
    return module.sampled_maps(fmus[3])


@pytest.fixture(scope="module")
def manifest_schema() -> etree.XMLSchema:
    """The schema that FMI-LS-STRUCT 1.0.0-rc.1 publishes for its manifest."""
    parser = etree.XMLParser()
    parser.resolvers.add(FmpySchemas())
    return etree.XMLSchema(etree.parse(LS_STRUCT, parser))


def test_manifest_and_terminals_are_valid_and_go_with_fmi_3_alone(fmus, manifest_schema):
    terminals = etree.XMLSchema(etree.parse(FmpySchemas.folder / "fmi3TerminalsAndIcons.xsd"))
    with zipfile.ZipFile(fmus[3]) as archive:
        manifest = etree.fromstring(archive.read(f"extra/{STRUCT}/fmi-ls-manifest.xml"))
        manifest_schema.assertValid(manifest)
        terminals.assertValid(etree.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml")))
    assert manifest.get("{http://fmi-standard.org/fmi-ls-manifest}fmi-ls-version") == "1.0.0-rc.1"
    with zipfile.ZipFile(fmus[2]) as archive:
        assert not [name for name in archive.namelist() if name.startswith(("extra/", "terminalsAndIcons/"))]


@pytest.mark.parametrize("attribute", ["name", "version", "description"])
def test_the_schema_of_the_manifest_refuses_one_without_an_attribute(fmus, manifest_schema, attribute):
    with zipfile.ZipFile(fmus[3]) as archive:
        manifest = etree.fromstring(archive.read(f"extra/{STRUCT}/fmi-ls-manifest.xml"))
    del manifest.attrib[f"{{http://fmi-standard.org/fmi-ls-manifest}}fmi-ls-{attribute}"]
    assert not manifest_schema.validate(manifest)


def test_a_tool_reads_the_ratio_table_of_each_point_as_a_sampled_map(fmus, maps, vehicle):
    variables = {v.name: v for v in fmpy.read_model_description(fmus[3]).modelVariables}
    assert [sampled.name for sampled in maps] == [f"{point}.ratio_table" for point in POINTS]
    with Host(fmus[3]) as host:
        for point, sampled in zip(POINTS, maps, strict=True):
            table = vehicle.control_point(point).ratio
            assert "multilinear" in sampled.text
            assert sampled.operating_point == list(RATIO_VARIABLES)
            assert all(variables[name].variability == "constant" for name in sampled.axes)
            assert variables[sampled.values].causality == "parameter"
            assert [d.start for d in variables[sampled.values].dimensions] == [len(axis) for axis in table.axes]
            for name, own in zip([*sampled.axes, sampled.values], [*table.axes, table.ratio], strict=True):
                found = host.fmu.getFloat64([host.refs[name]], nValues=own.size)
                np.testing.assert_array_equal(np.reshape(found, own.shape), own)


def test_an_operating_point_follows_its_nodes_in_the_terminal(fmus):
    """The order that section 2 of the standard asks for; members are named once."""
    with zipfile.ZipFile(fmus[3]) as archive:
        root = etree.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml"))
    for terminal in root.iter("Terminal"):
        kinds = [m.get("variableKind").removeprefix(f"{STRUCT}.map.") for m in terminal]
        assert kinds == ["domain", "domainInput"] * len(RATIO_VARIABLES) + ["codomain"]
        names = [m.get("memberName") for m in terminal]
        assert len(set(names)) == len(names)


def test_values_set_through_a_sampled_map_act_as_an_updated_table_in_the_plug_in(fmus, maps, revised, flown):
    given, sampled = frames(flown, 1.0, 400.0), maps[POINTS.index("NOSECAP")]
    table = load_vehicle(revised).control_point("NOSECAP").ratio
    with Host(fmus[3]) as host:
        host.fmu.setFloat64([host.refs[sampled.values]], table.ratio.ravel().tolist())
        found = fmu_temperatures(host, given)
        operating_point = host.get(*sampled.operating_point)
    np.testing.assert_array_equal(found, plugin_temperatures(load_vehicle(revised), given))
    at_end = flown.at([given[-1]["time_s"]])
    expected = [float(at_end[name][0]) for name in RATIO_VARIABLES]
    np.testing.assert_allclose(operating_point, expected, rtol=0.0, atol=1e-9)


def test_the_reynolds_number_of_an_instance_is_its_own(fmus, flown):
    """Two instances in turn, at the entry interface and 300 s later; a state brings it back."""
    early, late = frames(flown, 1.0, 300.0)[0], frames(flown, 1.0, 300.0)[-1]
    with Host(fmus[3]) as first, Host(fmus[3], like=first) as second:
        first.start(early)
        second.start(late)
        (thin,), (dense,) = first.get("log10_re"), second.get("log10_re")
        assert dense > thin + 1.0
        state = first.save()
        first.step({**late, "time_s": early["time_s"] + 1.0})
        assert first.get("log10_re")[0] == dense
        first.restore(state, early["time_s"])
        assert first.get("log10_re")[0] == thin
        assert second.get("log10_re")[0] == dense
        first.drop(state)


# The library ---------------------------------------------------------------------------------------------------------


def test_library_needs_libc_and_libm_alone(fmus, tmp_path):
    with Host(fmus[3]) as host:
        binary = next(Path(host.folder).glob("binaries/x86_64-linux/*.so"))
        needed = subprocess.run(["objdump", "-p", binary], capture_output=True, text=True, check=True).stdout
        undefined = subprocess.run(["nm", "-Du", binary], capture_output=True, text=True, check=True).stdout
    assert set(re.findall(r"NEEDED\s+(\S+)", needed)) <= {"libm.so.6", "libc.so.6"}
    names = {re.split(r"@", line.split()[-1])[0] for line in undefined.splitlines()}
    maths = {"cos", "exp", "expm1", "log10", "log", "pow", "sin", "sincos", "ceil", "floor"}
    maths |= {"acos", "erfc"}  # C99: angle of a swept cylinder, molecules that meet a surface in thin air
    memory = {"malloc", "calloc", "realloc", "free", "memcpy", "memmove", "memset", "memcmp", "bsearch", "qsort"}
    text = {"snprintf", "vsnprintf", "strlen", "strcmp", "strncmp", "strncpy", "strchr", "strspn", "strcspn", "strpbrk"}
    text |= {"strtod_l", "newlocale", "freelocale"}
    files = {"fopen", "fclose", "fread", "fseek", "ftell"}
    loader = {"__cxa_finalize", "__gmon_start__", "_ITM_deregisterTMCloneTable", "_ITM_registerTMCloneTable",
              "__stack_chk_fail"}  # fmt: skip
    assert names <= maths | memory | text | files | loader
    versions = {tuple(map(int, v.split("."))) for v in re.findall(r"GLIBC_([\d.]+)", undefined)}
    assert max(versions) <= (2, 29)  # exp and pow


def test_kernel_that_allocates_is_refused():
    import numba

    from sim_heating.base.errors import RunError

    @numba.cfunc(numba.types.float64(numba.types.int64), error_model="numpy")
    def greedy(n):
        return np.zeros(n).sum()

    with pytest.raises(RunError, match="greedy: needs NRT_"):
        object_code(CompilationUnit("greedy", greedy._sig, lambda: greedy), TARGETS["linux"], "x86-64")


def test_vector_intrinsics_are_allowed_and_fused_multiplication_is_not():
    """The vectoriser's intrinsics depend on the machine that it runs on: one with AVX-512 scatters."""
    from llvmlite.binding import parse_assembly

    from sim_heating.simulation.fmu_export.parts.library import forbidden_calls

    declared = """
        declare void @llvm.masked.scatter.v4f64.v4p0(<4 x double>, <4 x ptr>, <4 x i1>)
        declare double @llvm.vector.reduce.fadd.v8f64(double, <8 x double>)
        declare double @llvm.exp.f64(double)
        declare double @exp(double)
        declare double @llvm.fma.f64(double, double, double)
        declare ptr @malloc(i64)
    """
    assert forbidden_calls(parse_assembly(declared)) == ["llvm.fma.f64", "malloc"]


# The command ---------------------------------------------------------------------------------------------------------


def test_command_writes_an_fmu_and_reports_its_content(tmp_path, capsys):
    out = tmp_path / "deep" / "x.fmu"
    arguments = ("fmu", "export", "orbiter", "--out", str(out), "--control-points", "NOSECAP", "--fmi", "2")
    printed = run_json(capsys, *arguments)
    assert printed["files"] == [str(out)]
    assert (printed["results"]["fmi"], printed["results"]["control_points"]) == ("2.0", ["NOSECAP"])
    assert validate_fmu(out) == []


@pytest.mark.sample(1)
@pytest.mark.parametrize("fmi", [2, 3])
def test_odd_titles_and_names_make_a_valid_description(fmi, tmp_path):
    """A folder that begins with a digit, a bell in the title, quotes, backslashes and umlauts in names of sensors."""
    folder = tmp_path / "2stage"
    shutil.copytree(ROOT / "aircraft_data" / "orbiter", folder)
    vehicle, point = folder / "vehicle.toml", folder / "control_points" / "NOSECAP.toml"
    text = vehicle.read_text().replace('"orbiter"', '"2stage"')
    vehicle.write_text(re.sub(r'^title = ".*"$', r'title = "Bell \\u0007"', text, flags=re.M))
    names = ("it's", "it_s", "Schwärze", "a" + 2 * chr(92) + "b")
    sensors = [f'[[sensor]]\nname = "{name}"\ncolumn = "T{k}_K"\ndepth_m = 0.0\n' for k, name in enumerate(names)]
    point.write_text(point.read_text().replace("[limits]", "\n".join([*sensors, "[limits]"])))
    export_fmu(load_vehicle(folder), tmp_path / "odd.fmu", ["NOSECAP"], fmi=fmi)
    assert validate_fmu(tmp_path / "odd.fmu") == []
    described = fmpy.read_model_description(tmp_path / "odd.fmu")
    assert described.coSimulation.modelIdentifier == "_2stage_heating"
    shown = [v.name for v in described.modelVariables if v.name.endswith("indicated_K")]
    assert len(set(shown)) == len(shown) == len(names) + 1


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (["orbitr", "--out", "x.fmu"], "orbiter"),
        (["orbiter", "--out", "x.zip"], "ends in .fmu"),
        (["orbiter", "--out", "x.fmu", "--control-points", "NOSECUP"], "NOSECAP"),
        (["orbiter", "--out", "x.fmu", "--platforms", "amiga"], "unknown platform `amiga`"),
        (["orbiter", "--out", "x.fmu", "--fmi", "2", "--platforms", "linux-arm64"], "export for FMI 3"),
    ],
)
def test_command_refuses_in_one_line(arguments, hint, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["fmu", "export", *arguments]) == 2
    error = [line for line in capsys.readouterr().err.splitlines() if not line.endswith("...")]
    assert len(error) == 1
    assert hint in error[0]
    assert not list(tmp_path.iterdir())


def test_a_scenario_of_another_source_is_refused_with_its_file(capsys, tmp_path):
    out, scenario = tmp_path / "entry.fmu", SCENARIOS / "nominal.toml"
    assert main(["fmu", "trajectory", str(scenario), "--out", str(out)]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 1
    assert 'nominal.toml, [trajectory]: source = "jsbsim" cannot be exported as an FMU' in errors[0]


def test_no_compiler_is_needed_once_the_library_is_cached_and_a_missing_one_is_named_otherwise(
    fmus, vehicle, tmp_path, monkeypatch
):
    monkeypatch.setenv("PATH", "")
    monkeypatch.setitem(sys.modules, "ziglang", None)
    export_fmu(vehicle, tmp_path / "other.fmu", ["V07T9975"])
    with pytest.raises(InputError, match=r"pip install 'sim-heating\[fmu\]'"):
        compiler_command(TARGETS["linux"])


@pytest.fixture(scope="module")
def linked(vehicle, tmp_path_factory) -> tuple[Path, list[Path], int]:
    """A folder with an image of two points, what its library is linked from, and the number of its variables."""
    return link_model(vehicle, tmp_path_factory.mktemp("linked"), ["NOSECAP", "V09T9527"])


@pytest.mark.thorough
def test_random_legal_and_illegal_calls_neither_crash_nor_leak(linked):
    """A short run of the benchmark's fuzzing, with address and undefined-behaviour sanitizers."""
    folder, made, variables = linked
    flags = ["-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=undefined", f"-I{SOURCES}"]
    program = folder / "fuzz"
    subprocess.run(["gcc", *flags, "-o", program, *made, SOURCES / "host" / "fuzz.c", "-lm"], check=True)
    arguments = [folder, "{token}", str(variables), "1", "3000"]
    done = subprocess.run([program, *arguments], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.split()[-1]) > 50  # steps that ended well: the fuzzer gets that far


def test_a_step_allocates_nothing(linked):
    folder, made, _ = linked
    program, source = folder / "allocation", TESTS / "support" / "fmu_allocation.c"
    wrapped = "-Wl,--wrap=malloc,--wrap=calloc,--wrap=realloc"
    subprocess.run(["gcc", "-O1", f"-I{SOURCES}", wrapped, "-o", program, *made, source, "-lm"], check=True)
    done = subprocess.run([program, folder, "{token}"], capture_output=True, text=True, check=True)
    allocations = dict(line.split() for line in done.stdout.splitlines())
    assert int(allocations["before"]) > 0  # the counter counts
    assert int(allocations["during"]) == 0


def wine() -> str | None:
    return shutil.which("wine64") or shutil.which("wine") or shutil.which("/usr/lib/wine/wine64")


@pytest.mark.skipif(wine() is None, reason="needs Wine")
def test_windows_library_agrees_under_wine(vehicle, flown, tmp_path):
    """To 1e-9 K, not to the bit: exp, pow, log10, sin and cos are the host system's."""
    pytest.importorskip("ziglang")
    given = frames(flown, 1.0, 200.0)
    fmu = tmp_path / "windows.fmu"
    export_fmu(vehicle, fmu, POINTS, platforms=["windows"])
    command = [sys.executable, "-m", "ziglang", "cc", "-target", "x86_64-windows-gnu", "-O2", f"-I{SOURCES}"]
    subprocess.run([*command, "-o", tmp_path / "host.exe", SOURCES / "host" / "host.c"], check=True)
    runner = tmp_path / "host"
    runner.write_text(f'#!/bin/sh\nWINEDEBUG=-all WINEPREFIX={tmp_path}/wine exec {wine()} {tmp_path}/host.exe "$@"\n')
    runner.chmod(0o755)
    found = run_host(runner, fmu, "reached", given, SURFACES)
    np.testing.assert_allclose(found, plugin_temperatures(vehicle, given), rtol=0.0, atol=1e-9)


def test_runs_in_libcosim_with_the_same_bits(fmus, vehicle):
    """An independent host: the Open Simulation Platform's, with the FMI Library below."""
    pytest.importorskip("libcosimpy")
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimManipulator import CosimManipulator
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    inputs = {name: 0.0 for name in FRAME if name != "time_s"}
    inputs |= {"altitude_m": 70e3, "velocity_m_s": 6500.0, "alpha_deg": 40.0, "rho_kg_m3": 8e-5}
    with Host(fmus[2]) as named:
        refs = named.refs
    execution = CosimExecution.from_step_size(step_size=0.5e9)  # ns
    slave = execution.add_local_slave(CosimLocalSlave(fmu_path=str(fmus[2]), instance_name="heating"))
    manipulator, observer = CosimManipulator.create_override(), CosimObserver.create_last_value()
    execution.add_manipulator(manipulator)
    execution.add_observer(observer)
    manipulator.slave_real_values(slave, [refs[n] for n in inputs], list(inputs.values()))
    for _ in range(101):
        execution.step()
    found = observer.last_real_values(slave, [refs[n] for n in SURFACES])
    given = [{"time_s": 0.5 * i, **inputs} for i in range(102)]
    np.testing.assert_array_equal(found, plugin_temperatures(vehicle, given)[-1])


# Dependencies --------------------------------------------------------------------------------------------------------

AT_POINT = {"time_s": 0.0, "altitude_m": 70e3, "velocity_m_s": 6500.0, "alpha_deg": 38.7, "beta_deg": 0.3,
            "elevon_deg": 1.7, "bodyflap_deg": 8.3, "rho_kg_m3": 8e-5, "jets": 0.2}  # fmt: skip


def declared(path: Path, initial: bool) -> dict[str, set[str]]:
    """Names of the variables that each output depends on, as the description says."""
    described = fmpy.read_model_description(path)
    unknowns = described.initialUnknowns if initial else described.outputs
    assert all(u.dependencies is not None for u in unknowns)
    return {u.variable.name: {v.name for v in u.dependencies} for u in unknowns}


def shifted(v: fmpy.model_description.ScalarVariable, value: float) -> float:
    """Another value of a variable within its limits."""
    more = value + 1e-2 * max(1.0, abs(value)) if v.unit != "kg/m3" else 1.01 * value
    return more if v.max is None or more <= float(v.max) else value - 1e-2 * max(1e-3, abs(value))


@pytest.mark.parametrize("fmi", [2, 3])
def test_initial_outputs_change_only_with_what_they_are_declared_to_depend_on(fmus, fmi):
    """Each input and each parameter of a point in turn, in initialization mode."""
    depends = declared(fmus[fmi], initial=True)
    outputs, acts = list(depends), set()
    known = [
        v
        for v in fmpy.read_model_description(fmus[fmi]).modelVariables
        if v.causality == "input" or (v.name.startswith("NOSECAP.") and v.causality == "parameter")
    ]
    with Host(fmus[fmi], timing="held") as host:
        host.fmu.enterInitializationMode() if host.three else (
            host.fmu.setupExperiment(),
            host.fmu.enterInitializationMode(),
        )
        host.set({n: v for n, v in AT_POINT.items() if n != "time_s"})
        before = host.get(*outputs)
        for v in known:
            if v.dimensions or v.type == "String":
                continue
            value = host.get(v.name)[0]
            host.set({v.name: shifted(v, value)})
            changed = {name for name, a, b in zip(outputs, host.get(*outputs), before, strict=True) if a != b}
            assert all(v.name in depends[name] for name in changed), (v.name, changed)
            acts |= {(name, v.name) for name in changed}
            host.set({v.name: value})
        np.testing.assert_array_equal(host.get(*outputs), before)
    for name in ("altitude_m", "velocity_m_s", "alpha_deg", "rho_kg_m3"):
        assert ("NOSECAP.heating.convected_W_m2", name) in acts
    assert ("NOSECAP.limit.surface_margin_K", "NOSECAP.limit.surface_K") in acts


@pytest.mark.parametrize("fmi", [2, 3])
def test_state_dependent_outputs_are_declared_to_depend_on_no_input(fmus, fmi):
    depends = declared(fmus[fmi], initial=False)
    direct = {name for name, known in depends.items() if known}
    heating = {f"{p}.heating.{what}" for p in POINTS for what in ("ratio", "convected_W_m2", "absorbed_W_m2")}
    radiated = {f"{p}.heating.radiated_W_m2" for p in POINTS}
    assert direct == heating | radiated | {"log10_re"}
    # A surface radiates to its surroundings, which a host may state; its own temperature is the state.
    # Undeclared, they follow from altitude and pressure.
    assert all(depends[name] == {"T_surroundings_K", "altitude_m", "rho_kg_m3"} for name in radiated)
    assert all({"altitude_m", "rho_kg_m3", "q_add_W_m2"} < depends[name] for name in heating)
    assert depends["log10_re"] == {"altitude_m", "velocity_m_s", "rho_kg_m3"}


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("timing", ["held", "reached"])
def test_no_output_changes_with_an_input_between_two_steps(fmus, fmi, timing):
    """Perturbed at a communication point; the step from there is what they act on."""
    outputs = list(declared(fmus[fmi], initial=False))
    with Host(fmus[fmi], timing=timing) as host:
        host.start(AT_POINT)
        for k in range(1, 20):
            host.step(AT_POINT | {"time_s": 0.5 * k})
        before = host.get(*outputs)
        for name, value in AT_POINT.items():
            if name != "time_s":
                host.set({name: 1.01 * value})
                np.testing.assert_array_equal(host.get(*outputs), before)
        host.fmu.doStep(currentCommunicationPoint=host.time, communicationStepSize=0.5)
        assert np.all(host.get(*SURFACES) != before[[outputs.index(name) for name in SURFACES]])
