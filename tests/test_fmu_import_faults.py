"""FMUs that misbehave: one clear line each, and nothing left behind - no file, no process."""

from __future__ import annotations

import re
import subprocess
import tempfile
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fmpy
import pytest
from fmus import FAULTS, UNITS, description, glide_fmu, library, needs_compiler, pack, platform_folder

from sim_heating.cli import main
from sim_heating.errors import InputError, RunError
from sim_heating.trajectory import fmu
from sim_heating.trajectory.spec import TrajectorySpec

pytestmark = needs_compiler
VEHICLE = Path(__file__).parents[1] / "aircraft_data" / "orbiter"
COLUMNS = {
    "altitude_m": "h", "velocity_m_s": "speed", "alpha_deg": "alpha", "beta_deg": 0.0, "elevon_deg": 0.0,
    "bodyflap_deg": 0.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def binary(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return library(tmp_path_factory.mktemp("glide"))


def children() -> set[str]:
    """Processes that run an FMU."""
    found = subprocess.run(["pgrep", "-f", "fmu_process.py"], capture_output=True, text=True, check=False)
    return set(found.stdout.split())


@pytest.fixture(autouse=True)
def nothing_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Each test has a temporary folder of its own, which must be empty at its end."""
    own = tmp_path / "temporary"
    own.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(own))
    yield
    assert list(own.iterdir()) == []


def fly(path: Path, columns: dict[str, Any] | None = None, **more: Any) -> None:
    table = {"source": "fmu", "file": str(path), "rate_hz": 4.0, "stop": {"time_s": 10.0}}
    fmu.fly(TrajectorySpec.model_validate(table | {"fmu": {"columns": COLUMNS | (columns or {})} | more}), VEHICLE)


def faulty(path: Path, fault: str, **more: Any) -> None:
    fly(path, start={"fault": FAULTS.index(fault), "fault_time": 5.0}, **more)


# ---- in a step ----------------------------------------------------------------------------------------------------

IN_A_STEP = [
    ("fails", r"failed in its step at 5 s: fmi\dDoStep failed with status 3 \(error\)"),
    ("discards", r"discarded the step of 0\.25 s at 5 s; give shorter steps \(rate_hz\)"),
    ("gives NaN", r"output `speed` is nan at 5\.25 s"),
    ("crashes", r"crashed in its step at 5 s \(SIGSEGV\)"),
    ("hangs", r"hung in its step at 5 s: no answer within 0\.5 s \(timeout_s\); it was stopped"),
    ("exits", r"ended its process in its step at 5 s \(exit status 7\)"),
    ("chatters and fails", r"failed in its step at 5 s: .*; it said: the wing came off"),
]


@pytest.mark.parametrize("fmi", ["2", "3"])
@pytest.mark.parametrize(("fault", "told"), IN_A_STEP)
def test_a_fault_in_a_step_is_told_with_its_time(fault: str, told: str, fmi: str, binary: Path, tmp_path: Path) -> None:
    path = glide_fmu(tmp_path / "glide.fmu", binary, fmi)
    with pytest.raises(RunError, match=told) as found:
        faulty(path, fault, timeout_s=0.5 if fault == "hangs" else 30.0)
    assert str(path) in str(found.value)
    assert "\n" not in str(found.value)


def test_an_early_return_that_nobody_allowed_is_refused(binary: Path, tmp_path: Path) -> None:
    path = glide_fmu(tmp_path / "glide.fmu", binary, "3")
    with pytest.raises(RunError, match=r"returned early, at 5\.125 s, from a step to 5\.25 s"):
        faulty(path, "returns early")


def test_equations_that_cannot_be_evaluated_are_told(binary: Path, tmp_path: Path) -> None:
    path = glide_fmu(tmp_path / "glide.fmu", binary, "2", "ModelExchange")
    with pytest.raises(RunError, match=r"failed in its step at \S+ s: cannot be integrated: At t = .* right-hand side"):
        faulty(path, "fails")


def test_a_process_that_hangs_is_gone_afterwards(binary: Path, tmp_path: Path) -> None:
    before = children()
    with pytest.raises(RunError, match="hung"):
        faulty(glide_fmu(tmp_path / "glide.fmu", binary), "hangs", timeout_s=0.3)
    time.sleep(0.1)
    assert children() <= before


def test_an_interrupted_flight_leaves_nothing(binary: Path, tmp_path: Path) -> None:
    def interrupt(_: object) -> None:
        raise KeyboardInterrupt

    table = {"source": "fmu", "file": str(glide_fmu(tmp_path / "g.fmu", binary)), "fmu": {"columns": COLUMNS}}
    before = children()
    with pytest.raises(KeyboardInterrupt):
        fmu.fly(TrajectorySpec.model_validate(table), VEHICLE, on_frame=interrupt)
    assert children() <= before


# ---- at the start -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fmi", ["2", "3"])
def test_a_crash_at_instantiate_is_told(fmi: str, tmp_path: Path) -> None:
    path = glide_fmu(tmp_path / "glide.fmu", library(tmp_path, "-DCRASH_AT_INSTANTIATE"), fmi)
    with pytest.raises(RunError, match=r"crashed while it was instantiated and initialised \(SIG(SEGV|ILL|TRAP)\)"):
        fly(path)


def test_an_fmu_that_gives_no_instance_is_told(tmp_path: Path) -> None:
    path = glide_fmu(tmp_path / "glide.fmu", library(tmp_path, "-DNO_INSTANCE"))
    with pytest.raises(RunError, match=r"failed while it was instantiated and initialised: .*instantiate"):
        fly(path)


def test_an_fmu_for_another_platform_is_refused_with_those_that_it_has(binary: Path, tmp_path: Path) -> None:
    path = pack(tmp_path / "glide.fmu", description("2"), binary.rename(tmp_path / "glide.dll"), "win64")
    (tmp_path / "glide.dll").rename(binary)
    with pytest.raises(InputError, match=rf"no library for this platform \({fmpy.platform}\); platforms in it: win64"):
        fly(path)


def test_a_library_of_another_machine_is_told(tmp_path: Path) -> None:
    foreign = tmp_path / f"glide{fmpy.sharedLibraryExtension}"
    foreign.write_bytes(b"MZ" + bytes(2000))
    path = pack(tmp_path / "glide.fmu", description("2"), foreign, platform_folder("2"))
    with pytest.raises(RunError, match=r"failed while it was instantiated and initialised: .*Failed to load"):
        fly(path)


def test_a_library_that_lacks_fmi_functions_is_told(tmp_path: Path) -> None:
    (tmp_path / "empty.c").write_text("int nothing;\n")
    binary = tmp_path / "glide.so"
    subprocess.run(["gcc", "-shared", "-fPIC", str(tmp_path / "empty.c"), "-o", str(binary)], check=True)
    with pytest.raises(RunError, match="undefined symbol: fmi2"):
        fly(pack(tmp_path / "glide.fmu", description("2"), binary, platform_folder("2")))


def test_a_start_value_for_an_output_is_refused(binary: Path, tmp_path: Path) -> None:
    with pytest.raises(RunError, match="takes no start value for alpha: give parameters and inputs alone"):
        fly(glide_fmu(tmp_path / "glide.fmu", binary), start={"alpha": 0.5})


# ---- what the file says -------------------------------------------------------------------------------------------

SAYS = [
    ({"altitude_m": "height"}, r"`altitude_m`: .* has no variable `height`. Nearest: `height_0`"),
    ({"altitude_m": "label"}, r"`label` of .* is a String; name a variable that is one number"),
    ({"altitude_m": "speed"}, r"`altitude_m`: `speed` of .* is in `ft/s`, which is no `m`"),
    ({"altitude_m": "h_state"}, r"`h_state` of .* has no unit; give `unit`"),
    ({"altitude_m": {"variable": "h", "unit": "ft"}}, r"`h` is in `km` in .*, not in `ft`; remove `unit`"),
    ({"altitude_m": {"variable": "h", "unit": "feet per"}}, r"`feet per` is not a unit; write it like m, ft/s"),
    ({"altitud_m": "h"}, r"`altitud_m`: there is no such column. Nearest: `altitude_m`"),
    ({"altitude_m": {"variable": "der(h)", "unit": "km"}}, r"gives altitude_m = -50000, which is not an altitude in m"),
    ({"rho_kg_m3": -1.0}, r"rho_kg_m3 = -1, which is not a density of air.*check the mapping and its units"),
    ({"velocity_m_s": {"variable": "v_state", "unit": "km/s"}}, r"a larger one looks like ft/s"),
]  # fmt: skip


@pytest.mark.parametrize(("columns", "told"), SAYS)
def test_a_wrong_mapping_is_told_by_column_variable_and_unit(
    columns: dict[str, Any], told: str, binary: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=told):
        fly(glide_fmu(tmp_path / "glide.fmu", binary), columns)


def test_an_altitude_in_kilometres_that_calls_itself_metres_is_seen_at_once(binary: Path, tmp_path: Path) -> None:
    text = description("2", units=UNITS).replace('<Real unit="km"/>', '<Real unit="m"/>')
    with pytest.raises(InputError, match="altitude_m = 70, which is too low for its speed and looks like km"):
        fly(pack(tmp_path / "glide.fmu", text, binary, platform_folder("2")))


def test_a_column_that_nothing_gives_is_told_with_what_to_do(binary: Path, tmp_path: Path) -> None:
    table = {"source": "fmu", "file": str(glide_fmu(tmp_path / "g.fmu", binary)), "fmu": {"columns": {"alpha_deg": 40}}}
    with pytest.raises(InputError, match=r"`beta_deg` is not known; .* give a number: beta_deg = 0\.0"):
        fmu.fly(TrajectorySpec.model_validate(table), VEHICLE)


@pytest.mark.parametrize(
    ("start", "told"),
    [
        ({"sinc": 1.0}, r"`sinc`: .* has no variable `sinc`. Nearest: `sink`"),
        ({"sink": {"value": 1.0, "unit": "kg"}}, r"`sink`: `kg` is no unit of it; it is in `m/s`"),
        ({"h_state": {"value": 1.0, "unit": "m"}}, r"`h_state` of .* has no unit; give a plain number"),
        ({"sink": "fast"}, r"`fast` is not a number, and `sink` of .* is a Real"),
    ],
)
def test_a_wrong_start_value_is_told(start: dict[str, Any], told: str, binary: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=told):
        fly(glide_fmu(tmp_path / "glide.fmu", binary), start=start)


@pytest.mark.parametrize(
    ("inputs", "told"),
    [
        ({"comand": "alpha_deg"}, r"`comand`: .* Nearest: `command`"),
        ({"sink": {"schedule": [[0, 1]]}}, r"`sink`: it is a parameter of .*, not an input"),
        ({"command": {"schedule": [[0, 1]], "unit": "deg"}}, r"is in `rad` in .*, not in `deg`"),
        ({"command": "alpha_deg"}, r"guidance needs gamma_deg, heading_deg, .*; map them"),
    ],
)
def test_a_wrong_input_is_told(inputs: dict[str, Any], told: str, binary: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=told):
        fly(glide_fmu(tmp_path / "glide.fmu", binary), inputs=inputs)


def test_an_interface_that_an_fmu_lacks_is_told(binary: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has no model-exchange interface; it has co-simulation"):
        fly(glide_fmu(tmp_path / "glide.fmu", binary), interface="model-exchange")


FMI_1 = (
    '<fmiModelDescription fmiVersion="1.0" modelName="x" modelIdentifier="x" guid="x" numberOfContinuousStates="0" '
    'numberOfEventIndicators="0"><ModelVariables/></fmiModelDescription>'
)


def swapped(path: Path, binary: bytes) -> None:
    """An FMU whose library has changed inside the archive."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description("2"))
        archive.writestr(f"binaries/{platform_folder('2')}/glide{fmpy.sharedLibraryExtension}", binary)
    path.write_bytes(path.read_bytes().replace(binary, binary[::-1]))


DAMAGED = [
    (lambda p: p.write_bytes(b"no archive"), "is not an FMU"),
    (lambda p: zipfile.ZipFile(p, "w").close(), "modelDescription.xml cannot be read"),
    (lambda p: pack_text(p, "<fmiModel"), "modelDescription.xml cannot be read"),
    (lambda p: swapped(p, bytes(range(200))), r"cannot be unpacked \(Bad CRC-32"),
    (lambda p: pack_text(p, FMI_1), r"is of FMI 1\.0; FMI 2\.0 and 3\.0 can be flown"),
]


def pack_text(path: Path, text: str) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)


@pytest.mark.parametrize(("damage", "told"), DAMAGED)
def test_a_damaged_fmu_is_refused(damage: Any, told: str, tmp_path: Path) -> None:
    damage(tmp_path / "glide.fmu")
    with pytest.raises(InputError, match=told):
        fly(tmp_path / "glide.fmu")


# ---- at the command -----------------------------------------------------------------------------------------------

SCENARIO = """
format = "scenario/1"
title = "A glide that ends badly"
vehicle = "orbiter"
control_points = ["V09T9527"]
[trajectory]
source = "fmu"
file = "glide.fmu"
rate_hz = 4.0
[trajectory.fmu.columns]
altitude_m = "h"
velocity_m_s = "speed"
alpha_deg = "alpha"
beta_deg = 0.0
[trajectory.fmu.start]
fault = 5
"""


def test_the_command_says_it_in_one_line_and_writes_nothing(
    binary: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    glide_fmu(tmp_path / "glide.fmu", binary)
    (tmp_path / "glide.toml").write_text(SCENARIO)
    assert main(["run", str(tmp_path / "glide.toml"), "--out", str(tmp_path / "out")]) == 1
    (line,) = [x for x in capsys.readouterr().err.splitlines() if x.startswith("failed")]
    assert re.search(r"glide\.fmu: the FMU crashed in its step at 5 s \(SIGSEGV\)", line)
    assert not (tmp_path / "out").exists()


def test_validate_finds_a_wrong_mapping(binary: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    glide_fmu(tmp_path / "glide.fmu", binary)
    (tmp_path / "glide.toml").write_text(SCENARIO.replace('"speed"', '"sped"'))
    assert main(["validate", str(tmp_path / "glide.toml")]) == 2
    assert "[trajectory.fmu.columns], `velocity_m_s`" in capsys.readouterr().err
