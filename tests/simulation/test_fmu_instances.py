"""Many instances of one loaded FMU: they share its tables and their working memory, and their states are small."""

from __future__ import annotations

import shutil
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException

from sim_heating.heating.ratio.table import read_ratio_table
from sim_heating.inputs.vehicle import Vehicle, load_vehicle
from sim_heating.simulation.fmu_export.export import export_fmu
from tests.support.fmu_hosts import SOURCES, Host, link_model
from tests.support.paths import ROOT

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
POINTS = ["V09T9527", "NOSECAP", "BODYFLAP"]
SURFACES = [f"{name}.{what}" for name in POINTS for what in ("surface_K", "bondline_K", "heating.ratio")]
FRAMES = [
    {"time_s": 0.5 * i, "altitude_m": 75e3 - 20.0 * i, "velocity_m_s": 6800.0 - i,
     "alpha_deg": 40.0 + 3.0 * np.sin(0.2 * i), "beta_deg": 0.0, "elevon_deg": 2.0, "bodyflap_deg": 10.0,
     "rho_kg_m3": 4e-5 * np.exp(20.0 * i / 7e3), "jets": 0.0}
    for i in range(60)
]  # fmt: skip
"""A POPU on the way down."""
BUDGET_BYTES = 65_536


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("orbiter")


@pytest.fixture(scope="module")
def fmus(vehicle, tmp_path_factory) -> dict[int, Path]:
    folder = tmp_path_factory.mktemp("instances")
    for fmi in (2, 3):
        export_fmu(vehicle, folder / f"{fmi}.fmu", POINTS, fmi=fmi)
    return {fmi: folder / f"{fmi}.fmu" for fmi in (2, 3)}


def hotter(host: Host) -> None:
    """Ratios of the nose cap 1.3 times those of its table, set as an array."""
    table = read_ratio_table(ROOT / "aircraft_data" / "orbiter" / "ratio_tables" / "NOSECAP.csv")
    host.fmu.setFloat64([host.refs["NOSECAP.ratio_table.ratio"]], (1.3 * table.ratio).ravel().tolist())


def from_file(host: Host) -> None:
    """The table of the body flap at the nose cap, by its path."""
    path = ROOT / "aircraft_data" / "orbiter" / "ratio_tables" / "LEE_UPPER.csv"
    host.fmu.setString([host.refs["NOSECAP.ratio_table.file"]], [str(path)])


SETTINGS = {
    "as exported": lambda host: None,
    "scaled": lambda host: host.set({f"{p}.ratio.scale": 0.1 for p in POINTS}),
    "gaps": lambda host: host.set({f"{p}.stack.gap.fraction": 0.2 for p in POINTS}),
    "moist": lambda host: host.set({"V09T9527.stack.moisture.latent_J_kg": 2e5}),
    "hotter": hotter,
    "from file": from_file,
}


def fly(host: Host, frames: list[dict[str, float]]) -> np.ndarray:
    found = []
    for frame in frames:
        host.step(frame)
        found.append(host.get(*SURFACES))
    return np.array(found)


def alone(path: Path, setting: str) -> np.ndarray:
    """Outputs of an instance that shares its library with no other."""
    with Host(path) as host:
        SETTINGS[setting](host)
        host.start(FRAMES[0])
        return fly(host, FRAMES[1:])


@pytest.fixture(scope="module")
def expected(fmus) -> dict[str, np.ndarray]:
    return {name: alone(fmus[3], name) for name in SETTINGS}


def test_the_settings_differ(expected):
    surfaces = [tuple(found[-1]) for found in expected.values()]
    assert len(set(surfaces)) == len(SETTINGS)


def test_instances_that_step_in_turn_have_the_bits_of_each_alone(fmus, expected):
    """More instances than there is working memory for: each step replaces what another one left there."""
    with Host(fmus[3]) as first:
        hosts = {name: first if name == "as exported" else Host(fmus[3], like=first) for name in SETTINGS}
        for name, host in hosts.items():
            SETTINGS[name](host)
            host.start(FRAMES[0])
        for i, frame in enumerate(FRAMES[1:]):
            for name, host in hosts.items():
                host.step(frame)
                np.testing.assert_array_equal(host.get(*SURFACES), expected[name][i], err_msg=name)
        for host in list(hosts.values())[1:]:
            host.close()


def test_a_failed_instance_leaves_nothing_behind_for_the_next_one(fmus, expected):
    """Its parameters drive the thermal step to numbers that are not finite, in memory that the others use after it."""
    wild = {f"{p}.{name}": 1e308 for p in POINTS for name in ("ratio.d_alpha", "ratio.d_alpha2")}
    with Host(fmus[3]) as host, Host(fmus[3], like=host) as second, Host(fmus[3], like=host) as failing:
        for one in (host, second):
            one.start(FRAMES[0])
        failures = 0
        for i, frame in enumerate(FRAMES[1:20]):
            failing.fmu.reset()
            failing.set(wild)
            try:
                failing.start(FRAMES[0])
                failing.step(FRAMES[1] | {"alpha_deg": 45.0})
            except FMICallException:
                failures += "did not converge" in failing.messages[-1]
            for one in (host, second):
                one.step(frame)
                np.testing.assert_array_equal(one.get(*SURFACES), expected["as exported"][i])
        assert failures == 19


def test_instances_in_more_threads_than_idle_workspaces_keep_their_bits(fmus, expected):
    found: dict[str, np.ndarray] = {}
    with Host(fmus[3]) as first:
        hosts = {name: Host(fmus[3], like=first) for name in SETTINGS}

        def run(name: str) -> None:
            SETTINGS[name](hosts[name])
            hosts[name].start(FRAMES[0])
            found[name] = fly(hosts[name], FRAMES[1:])

        threads = [threading.Thread(target=run, args=(name,)) for name in hosts]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for host in hosts.values():
            host.close()
    for name, values in found.items():
        np.testing.assert_array_equal(values, expected[name], err_msg=name)


@pytest.mark.parametrize("setting", SETTINGS)
def test_state_goes_through_bytes_to_another_instance_with_what_was_set(fmus, expected, setting):
    with Host(fmus[3]) as host, Host(fmus[3], like=host) as other:
        SETTINGS[setting](host)
        host.start(FRAMES[0])
        fly(host, FRAMES[1:30])
        state = host.save()
        fly(host, FRAMES[30:40])
        host.restore(state, FRAMES[29]["time_s"])
        np.testing.assert_array_equal(fly(host, FRAMES[30:]), expected[setting][29:])
        hotter(other)  # which the state replaces
        other.start(FRAMES[0])
        copy = other.from_bytes(host.to_bytes(state))
        other.restore(copy, FRAMES[29]["time_s"])
        np.testing.assert_array_equal(fly(other, FRAMES[30:]), expected[setting][29:])
        host.drop(state)
        other.drop(copy)


def test_reading_a_table_gives_what_was_set_in_this_instance_alone(fmus):
    with Host(fmus[3]) as host, Host(fmus[3], like=host) as other:
        ref = [host.refs["NOSECAP.ratio_table.ratio"]]
        table = read_ratio_table(ROOT / "aircraft_data" / "orbiter" / "ratio_tables" / "NOSECAP.csv").ratio.ravel()
        before = host.save()
        hotter(host)
        np.testing.assert_array_equal(host.fmu.getFloat64(ref, nValues=table.size), 1.3 * table)
        np.testing.assert_array_equal(other.fmu.getFloat64(ref, nValues=table.size), table)
        then = host.save()
        host.fmu.setFloat64(ref, (2.0 * table).tolist())
        host.restore(then, 0.0)
        np.testing.assert_array_equal(host.fmu.getFloat64(ref, nValues=table.size), 1.3 * table)
        host.restore(before, 0.0)
        np.testing.assert_array_equal(host.fmu.getFloat64(ref, nValues=table.size), table)
        host.drop(before)
        host.drop(then)


@pytest.mark.thorough
def test_an_instance_and_its_state_of_20_points_take_less_than_64_KiB(vehicle, tmp_path):
    assert len(vehicle.control_points) == 20
    folder, made, _ = link_model(vehicle, tmp_path)
    program, source = tmp_path / "instances", ROOT / "benchmarks" / "c_peer" / "instances.c"
    subprocess.run(["gcc", "-std=gnu11", "-O1", f"-I{SOURCES}", "-o", program, *made, source, "-lm"], check=True)
    done = subprocess.run([program, folder, "{token}"], capture_output=True, text=True, check=True)
    found = {name: float(value) for name, value in (line.split() for line in done.stdout.splitlines())}
    assert found["instance_bytes"] < BUDGET_BYTES
    assert found["state_bytes"] < BUDGET_BYTES


# States that are none ------------------------------------------------------------------------------------------------

PROGRAM = Path(__file__).parents[1] / "support" / "fmu_states.c"


@pytest.fixture(scope="module")
def states(vehicle, tmp_path_factory) -> dict[str, int]:
    """Status of each call of tests/support/fmu_states.c, under an address sanitizer."""
    folder, made, _ = link_model(vehicle, tmp_path_factory.mktemp("states"), ["NOSECAP"])
    flags = ["-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=undefined", f"-I{SOURCES}"]
    subprocess.run(["gcc", *flags, "-o", folder / "states", *made, PROGRAM, "-lm"], check=True)
    done = subprocess.run([folder / "states", folder, "{token}"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return {name: int(status) for name, status in (line.rsplit(" ", 1) for line in done.stdout.splitlines())}


@pytest.mark.thorough
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    "mistake",
    ["freed", "of another instance", "of an instance that is gone", "address of the state", "state as the address",
     "freed state as the address", "number", "null"],
)  # fmt: skip
def test_a_state_that_was_not_handed_out_is_refused_and_nothing_is_touched(states, fmi, mistake):
    calls = {name: status for name, status in states.items() if name.startswith(f"{fmi} {mistake}:")}
    assert calls
    assert set(calls.values()) == {3}, calls


@pytest.mark.thorough
@pytest.mark.parametrize("fmi", [2, 3])
def test_proper_states_are_taken_after_all_these_mistakes(states, fmi):
    proper = {name: status for name, status in states.items() if name.startswith(f"{fmi} proper:")}
    assert len(proper) == 6
    assert set(proper.values()) == {0}, proper
