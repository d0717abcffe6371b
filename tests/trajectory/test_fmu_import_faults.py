"""FMUs that misbehave: one clear line each, and nothing left behind - no file, no process."""

from __future__ import annotations

import errno
import os
import re
import signal
import stat
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import fmpy
import pytest

from sim_heating.base.errors import InputError, RunError
from sim_heating.cli import main
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.trajectory.flight import Flight
from sim_heating.trajectory.fmu import flight as fmu
from sim_heating.trajectory.fmu.session import FmuSession
from sim_heating.trajectory.spec import TrajectorySpec
from tests.support.fmus import needs_compiler
from tests.support.paths import ORBITER
from tests.support.small_fmus import FAULTS, UNITS, description, glide_fmu, library, pack, platform_folder
from tests.support.systems import posix

pytestmark = [needs_compiler, posix]
VEHICLE = load_vehicle(ORBITER)
COLUMNS = {
    "altitude_m": "h", "velocity_m_s": "speed", "alpha_deg": "alpha", "beta_deg": 0.0, "elevon_deg": 0.0,
    "bodyflap_deg": 0.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def binary(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return library(tmp_path_factory.mktemp("glide"))


def running(pattern: str = r"fmu/process\.py|sleep 30\.25") -> set[str]:
    """Processes that run an FMU, and those that an FMU starts here."""
    found = subprocess.run(["pgrep", "-f", pattern], capture_output=True, text=True, check=False)
    return set(found.stdout.split())


def gone(before: set[str], pattern: str = r"fmu/process\.py|sleep 30\.25") -> bool:
    """Whether no more processes run than before, within the time that the system takes to end them."""
    until_s = time.monotonic() + 5.0
    while not running(pattern) <= before:
        if time.monotonic() > until_s:
            return False
        time.sleep(0.05)
    return True


def both_run(pattern: str) -> bool:
    """Whether the process of an FMU and the one that the FMU forks run, within the time that a loaded machine takes."""
    until_s = time.monotonic() + 20.0
    while len(running(pattern)) != 2:
        if time.monotonic() > until_s:
            return False
        time.sleep(0.05)
    return True


@pytest.fixture(autouse=True)
def nothing_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Each test has a temporary folder of its own, which must be empty at its end."""
    own = tmp_path / "temporary"
    own.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(own))
    yield
    assert list(own.iterdir()) == []


def fly(path: Path, columns: dict[str, Any] | None = None, **more: Any) -> Flight:
    table = {"source": "fmu", "file": str(path), "rate_hz": 4.0, "stop": {"time_s": 10.0}}
    spec = TrajectorySpec.model_validate(table | {"fmu": {"columns": COLUMNS | (columns or {})} | more})
    return fmu.fly(spec, VEHICLE)


def faulty(path: Path, fault: str, **more: Any) -> Flight:
    return fly(path, start={"fault": FAULTS.index(fault), "fault_time": 5.0}, **more)


# ---- in a step ----------------------------------------------------------------------------------------------------

IN_A_STEP = [
    ("fails", r"failed in its step at 5 s: fmi\dDoStep failed with status 3 \(error\)"),
    ("discards", r"discarded the step of 0\.25 s at 5 s; give shorter steps \(rate_hz\)"),
    ("gives NaN", r"output `speed` is nan at 5\.25 s"),
    ("crashes", r"crashed in its step at 5 s \(SIGSEGV\)"),
    ("hangs", r"hung in its step at 5 s: no answer within 0\.5 s \(timeout_s\); it was stopped"),
    ("exits", r"ended its process in its step at 5 s \(exit status 7\)"),
    ("chatters and fails", r"failed in its step at 5 s: .*; it printed: the wing came off"),
    ("logs and fails", "failed in its step at 5 s: .*; it printed: \\[ERROR\\] the wing came\ufffd off$"),
    ("forks and crashes", r"crashed in its step at 5 s \(SIGSEGV\)"),
    ("forks and hangs", r"hung in its step at 5 s: no answer within 0\.5 s \(timeout_s\); it was stopped"),
    ("starts a process and fails", r"failed in its step at 5 s: fmi\dDoStep failed with status 3 \(error\)"),
    ("ends far ahead", r"failed in its step at 5 s: reports that it reached 10000000 s, .* not in its step to 5\.25 s"),
    ("ends at no time", r"failed in its step at 5 s: reports that it reached nan s, .* not in its step to 5\.25 s"),
]


@pytest.mark.sample(6)
@pytest.mark.parametrize("fmi", ["2", "3"])
@pytest.mark.parametrize(("fault", "expected"), IN_A_STEP)
def test_a_fault_in_a_step_is_reported_with_its_time(
    fault: str, expected: str, fmi: str, binary: Path, tmp_path: Path
) -> None:
    path = glide_fmu(tmp_path / "glide.fmu", binary, fmi)
    before, begin_s = running(), time.monotonic()
    with pytest.raises(RunError, match=expected) as found:
        faulty(path, fault, timeout_s=0.5 if fault.endswith("hangs") else 30.0)
    assert str(path) in str(found.value)
    assert str(found.value).isprintable()
    assert time.monotonic() - begin_s < 15.0  # what an FMU starts here would go on for 30 s
    assert gone(before)


def test_a_return_at_the_very_end_of_a_step_is_not_an_early_one(binary: Path, tmp_path: Path) -> None:
    flight = faulty(glide_fmu(tmp_path / "glide.fmu", binary, "3"), "returns at the end")
    assert flight.conditions.time_s[-1] == 10.0


def test_an_early_return_that_was_not_allowed_is_refused(binary: Path, tmp_path: Path) -> None:
    path = glide_fmu(tmp_path / "glide.fmu", binary, "3")
    with pytest.raises(RunError, match=r"returned early, at 5\.125 s, from a step to 5\.25 s"):
        faulty(path, "returns early")


def test_equations_that_cannot_be_evaluated_are_reported(binary: Path, tmp_path: Path) -> None:
    path = glide_fmu(tmp_path / "glide.fmu", binary, "2", "ModelExchange")
    with pytest.raises(RunError, match=r"failed in its step at \S+ s: cannot be integrated: At t = .* right-hand side"):
        faulty(path, "fails")


def test_an_interrupted_flight_leaves_nothing(binary: Path, tmp_path: Path) -> None:
    def interrupt(_: object) -> None:
        raise KeyboardInterrupt

    table = {"source": "fmu", "file": str(glide_fmu(tmp_path / "g.fmu", binary)), "fmu": {"columns": COLUMNS}}
    before = running()
    with pytest.raises(KeyboardInterrupt):
        fmu.fly(TrajectorySpec.model_validate(table), VEHICLE, on_frame=interrupt)
    assert gone(before)


HANGING = """
import signal, sys
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.trajectory.fmu import flight
from sim_heating.trajectory.spec import TrajectorySpec

signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell takes away from what it runs in the background
start = {"fault": int(sys.argv[2]), "fault_time": 0.0}
table = {"source": "fmu", "file": sys.argv[1], "fmu": {"columns": %r, "start": start, "timeout_s": 300.0}}
flight.fly(TrajectorySpec.model_validate(table), load_vehicle(%r), on_frame=lambda row: print("flying", flush=True))
"""


@pytest.mark.thorough
@pytest.mark.parametrize(("sent", "temporary"), [("SIGINT", []), ("SIGKILL", ["sim_heating_fmu_"])])
def test_a_hanging_fmu_ends_with_the_process_that_flies_it(
    sent: str, temporary: list[str], binary: Path, tmp_path: Path
) -> None:
    path, own = glide_fmu(tmp_path / "glide.fmu", binary), tmp_path / "killed"
    own.mkdir()
    command = [sys.executable, "-c", HANGING % (COLUMNS, str(ORBITER)), str(path), str(FAULTS.index("forks and hangs"))]
    environment = os.environ | {"TMPDIR": str(own)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment) as flying:
        its_own = rf"fmu/process\.py {flying.pid}$"
        try:
            assert flying.stdout is not None
            assert flying.stdout.readline() == b"flying\n"
            assert both_run(its_own)
            flying.send_signal(getattr(signal, sent))
        except BaseException:
            flying.kill()  # else the block waits for it
            raise
    assert gone(set(), its_own)
    assert [p.name[:16] for p in own.iterdir() if p.name.startswith("sim_heating_fmu_")] == temporary


# ---- at the start -------------------------------------------------------------------------------------------------


@pytest.mark.sample(1)
@pytest.mark.parametrize("fmi", ["2", "3"])
def test_a_crash_at_instantiation_is_reported(fmi: str, tmp_path: Path) -> None:
    path = glide_fmu(tmp_path / "glide.fmu", library(tmp_path, "-DCRASH_AT_INSTANTIATE"), fmi)
    with pytest.raises(RunError, match=r"crashed while it was instantiated and initialised \(SIG(SEGV|ILL|TRAP)\)"):
        fly(path)


def test_an_fmu_without_an_instance_is_reported(tmp_path: Path) -> None:
    path = glide_fmu(tmp_path / "glide.fmu", library(tmp_path, "-DNO_INSTANCE"))
    with pytest.raises(RunError, match=r"failed while it was instantiated and initialised: .*instantiate"):
        fly(path)


def test_an_fmu_for_another_platform_is_refused_with_those_that_it_has(binary: Path, tmp_path: Path) -> None:
    path = pack(tmp_path / "glide.fmu", description("2"), binary.rename(tmp_path / "glide.dll"), "win64")
    (tmp_path / "glide.dll").rename(binary)
    with pytest.raises(InputError, match=rf"no library for this platform \({fmpy.platform}\); platforms in it: win64"):
        fly(path)


def test_a_library_of_another_machine_is_reported(tmp_path: Path) -> None:
    foreign = tmp_path / f"glide{fmpy.sharedLibraryExtension}"
    foreign.write_bytes(b"MZ" + bytes(2000))
    path = pack(tmp_path / "glide.fmu", description("2"), foreign, platform_folder("2"))
    with pytest.raises(RunError, match=r"failed while it was instantiated and initialised: .*Failed to load"):
        fly(path)


def test_a_library_that_lacks_fmi_functions_is_reported(tmp_path: Path) -> None:
    (tmp_path / "empty.c").write_text("int nothing;\n")
    binary = tmp_path / "glide.so"
    subprocess.run(["gcc", "-shared", "-fPIC", str(tmp_path / "empty.c"), "-o", str(binary)], check=True)
    with pytest.raises(RunError, match="undefined symbol: fmi2"):
        fly(pack(tmp_path / "glide.fmu", description("2"), binary, platform_folder("2")))


def test_a_start_value_for_an_output_is_refused(binary: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"takes no start value for this output; give start values of parameters"):
        fly(glide_fmu(tmp_path / "glide.fmu", binary), start={"alpha": 0.5})


# ---- mappings, start values and inputs ------------------------------------------------------------------------------

WRONG_MAPPINGS = [
    ({"altitude_m": "height"}, r"`altitude_m`: .* has no variable `height`; did you mean `height_0`"),
    ({"altitude_m": "label"}, r"`label` of .* is a String; name a variable that is one number"),
    ({"altitude_m": "speed"}, r"`altitude_m`: `speed` of .* is in `ft/s`, which does not convert to `m`"),
    ({"altitude_m": "h_state"}, r"`h_state` of .* has no unit; give `unit`"),
    ({"altitude_m": {"variable": "h", "unit": "ft"}}, r"`h` is in `km` in .*, not in `ft`; remove `unit`"),
    ({"altitude_m": {"variable": "h", "unit": "feet per"}}, r"`feet per` is not a unit; write it like m, ft/s"),
    ({"altitud_m": "h"}, r"`altitud_m`: unknown column; did you mean `altitude_m`"),
    ({"altitude_m": {"variable": "der(h)", "unit": "km"}}, r"gives altitude_m = -50000, which is not an altitude in m"),
    ({"rho_kg_m3": -1.0}, r"rho_kg_m3 = -1, which is not a density of air.*check the mapping and its units"),
    ({"velocity_m_s": {"variable": "v_state", "unit": "km/s"}}, r"a larger one looks like ft/s"),
    ({"mach": 20.0}, r"`mach` and velocity_m_s both determine the speed; remove one"),
    ({"altitude_m": {"variable": "h_state", "unit": ""}}, r"`h_state` of .* is in `1`, which does not convert to `m`"),
    ({"altitude_m": {"variable": "h_state", "unit": "m."}}, r"`m\.` is not a unit; write it like m, ft/s"),
]


@pytest.mark.parametrize(("columns", "expected"), WRONG_MAPPINGS)
def test_a_wrong_mapping_is_reported_by_column_variable_and_unit(
    columns: dict[str, Any], expected: str, binary: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=expected):
        fly(glide_fmu(tmp_path / "glide.fmu", binary), columns)


def test_an_altitude_in_kilometres_declared_in_metres_is_found_at_the_start(binary: Path, tmp_path: Path) -> None:
    text = description("2", units=UNITS).replace('<Real unit="km"/>', '<Real unit="m"/>')
    with pytest.raises(InputError, match="altitude_m = 70, which is too low for its speed and looks like km"):
        fly(pack(tmp_path / "glide.fmu", text, binary, platform_folder("2")))


def test_an_unknown_column_is_reported_with_a_remedy(binary: Path, tmp_path: Path) -> None:
    table = {"source": "fmu", "file": str(glide_fmu(tmp_path / "g.fmu", binary)), "fmu": {"columns": {"alpha_deg": 40}}}
    # Density, jets, elevon and body flap follow from these: they are no causes.
    (problem,) = fmu.fmu_problems(TrajectorySpec.model_validate(table), VEHICLE)
    assert problem.startswith(
        '[trajectory.fmu.columns]: `velocity_m_s`, `beta_deg` are unknown; write velocity_m_s = "variable", '
        "or a number; velocity_m_s also follows from mach"
    )


@pytest.mark.parametrize(
    ("start", "expected"),
    [
        ({"sinc": 1.0}, r"`sinc`: .* has no variable `sinc`; did you mean `sink`"),
        ({"sink": {"value": 1.0, "unit": "kg"}}, r"`sink`: `kg` does not convert to its unit `m/s`"),
        ({"fault": {"value": 1.0, "unit": "m"}}, r"`fault` of .* has no unit; give a plain number"),
        ({"sink": "fast"}, r"`fast` is not a number, and `sink` is a Real"),
    ],
)
def test_a_wrong_start_value_is_reported(start: dict[str, Any], expected: str, binary: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=expected):
        fly(glide_fmu(tmp_path / "glide.fmu", binary), start=start)


TYPES = (
    '<TypeDefinitions><SimpleType name="Length"><Real unit="m"/></SimpleType><SimpleType name="Mode"><Enumeration>'
    '<Item name="inside" value="1"/><Item name="host" value="4"/></Enumeration></SimpleType></TypeDefinitions>'
)
PARAMETER = 'causality="parameter" variability="fixed"'
MORE_2 = "".join(
    f'<ScalarVariable name="{name}" valueReference="9" {role}><{kind} start="1"/></ScalarVariable>'
    for name, role, kind in (
        ("count", PARAMETER, "Integer"), ("steps", 'causality="input"', "Integer"), ("on", PARAMETER, "Boolean"),
        ("lamp", 'causality="input"', "Boolean"), ("pilot", PARAMETER, 'Enumeration declaredType="Mode"'),
        ("length", PARAMETER, 'Real declaredType="Length"'), ("odd", PARAMETER, 'Real unit="blah"'),
    )
)  # fmt: skip
MORE_3 = "".join(f'<{kind} name="{kind}" valueReference="9" {PARAMETER} start="0"/>' for kind in ("Int8", "UInt64"))


def typed_fmu(path: Path, binary: Path, fmi: str = "2") -> Path:
    """A glide with variables of many types in addition to its own."""
    types, more = (TYPES, MORE_2) if fmi == "2" else ("", MORE_3)
    text = description(fmi, units=UNITS | {"blah": 'm="1" factor="0"'})
    text = text.replace("<ModelVariables>", types + "<ModelVariables>")
    return pack(path, text.replace("</ModelVariables>", more + "</ModelVariables>"), binary, platform_folder(fmi))


NO_VALUE = [
    ({"count": 1.5}, r"`count`: `1\.5` is not a whole number from -2147483648 to 2147483647"),
    ({"count": 99999999999}, r"`99999999999` is not a whole number from -2147483648 to 2147483647"),
    ({"count": 1e20}, r"`1e\+20` is not a whole number"),
    ({"count": True}, r"`true` is not a number, and `count` is a Integer"),
    ({"on": 7}, r"`on`: `7` is neither true nor false"),
    ({"pilot": 5}, r"`pilot`: `5` is not one of its items: 1 \(inside\), 4 \(host\)"),
    ({"pilot": 3.9}, r"`pilot`: `3\.9` is not one of its items: 1 \(inside\), 4 \(host\)"),
    ({"pilot": "host"}, r"`pilot`: `host` is not one of its items: 1 \(inside\), 4 \(host\)"),
    ({"length": {"value": 1.0, "unit": "kg"}}, r"`length`: `kg` does not convert to its unit `m`"),
    ({"odd": {"value": 1.0, "unit": "m"}}, r"defines `blah` by factor 0 and offset 0, which is not a unit"),
]


@pytest.mark.parametrize(("start", "expected"), NO_VALUE)
def test_a_start_value_that_its_variable_cannot_take_is_refused(
    start: dict[str, Any], expected: str, binary: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=expected):
        fly(typed_fmu(tmp_path / "glide.fmu", binary), start=start)


@pytest.mark.parametrize(("name", "value"), [("Int8", 128), ("Int8", -129), ("UInt64", -1), ("UInt64", 2.0**64)])
def test_a_start_value_outside_a_type_of_fmi_3_is_refused(
    name: str, value: float, binary: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=rf"`{name}`: `.*` is not a whole number from (-128 to 127|0 to 1844)"):
        fly(typed_fmu(tmp_path / "glide.fmu", binary, "3"), start={name: value})


@pytest.mark.parametrize(
    ("inputs", "expected"),
    [
        ({"steps": {"schedule": [[0, 0], [5, 1e12]]}}, r"`steps`: `1000000000000\.0` is not a whole number"),
        ({"lamp": {"schedule": [[0, 0.4]]}}, r"`lamp`: `0\.4` is neither true nor false"),
        ({"command": {"schedule": [[0, 1]]}}, r"ignores its inputs; set pilot = 4 in \[trajectory\.fmu\.start\]"),
    ],
)
def test_an_input_that_would_be_ignored_is_refused(
    inputs: dict[str, Any], expected: str, binary: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=expected):
        fly(typed_fmu(tmp_path / "glide.fmu", binary), inputs=inputs)


@pytest.mark.parametrize(
    ("manoeuvre", "expected"),
    [
        ({"kind": "popu", "at_time_s": 3.0}, r"manoeuvre 2 \(popu\): no input takes its alpha_deg"),
        ({"kind": "elevon-pulse", "at_time_s": 3.0, "amplitude_deg": 5.0}, r"\(elevon-pulse\): .* its elevon_deg"),
        ({"kind": "jet-firing", "at_time_s": 3.0}, r"\(jet-firing\): .* its jets; .*did you mean `command`"),
    ],
)
def test_a_manoeuvre_that_no_input_takes_is_refused_before_the_flight(
    manoeuvre: dict[str, Any], expected: str, binary: Path, tmp_path: Path
) -> None:
    path = glide_fmu(tmp_path / "glide.fmu", binary)
    doublet = {"kind": "sideslip-doublet", "at_time_s": 2.0}
    own = {"columns": COLUMNS, "inputs": {"command": "beta_deg"}}
    table = {"source": "fmu", "file": str(path), "fmu": own, "manoeuvre": [doublet, manoeuvre]}
    (problem,) = fmu.fmu_problems(TrajectorySpec.model_validate(table), VEHICLE)
    assert re.search(expected, problem)


def test_a_truth_value_is_not_a_column() -> None:
    with pytest.raises(ValueError, match="altitude_m"):
        TrajectorySpec.model_validate({"source": "fmu", "file": "x.fmu", "fmu": {"columns": {"altitude_m": True}}})


@pytest.mark.parametrize(
    ("inputs", "expected"),
    [
        ({"comand": "alpha_deg"}, r"`comand`: .*did you mean `command`"),
        ({"sink": {"schedule": [[0, 1]]}}, r"`sink`: it is a parameter of .*, not an input"),
        ({"command": {"schedule": [[0, 1]], "unit": "deg"}}, r"is in `rad` in .*, not in `deg`"),
        ({"command": "alpha_deg"}, r"guidance needs gamma_deg, heading_deg, .*; map them"),
    ],
)
def test_a_wrong_input_is_reported(inputs: dict[str, Any], expected: str, binary: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=expected):
        fly(glide_fmu(tmp_path / "glide.fmu", binary), inputs=inputs)


def test_a_missing_interface_of_an_fmu_is_reported(binary: Path, tmp_path: Path) -> None:
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
    (lambda p: zipfile.ZipFile(p, "w").close(), r"is not an FMU \(it contains no modelDescription.xml\)"),
    (lambda p: pack_text(p, "<fmiModel"), r"modelDescription.xml: line 1: is not XML \(unclosed token"),
    (lambda p: swapped(p, bytes(range(200))), r"cannot be unpacked \(Bad CRC-32"),
    (lambda p: pack_text(p, FMI_1), r"uses FMI 1\.0; FMI 2\.0 and 3\.0 are supported"),
    (lambda p: pack_text(p, "<foo/>"), "modelDescription.xml: its root is `foo`, not `fmiModelDescription`"),
    (
        lambda p: pack_text(p, description("2").replace('fmiVersion="2.0"', 'fmiVersion="3.0"')),
        "is not valid: ERROR .*guid",
    ),
    (
        lambda p: pack_text(p, description("2").replace('modelIdentifier="glide"', "")),
        "interface has no modelIdentifier",
    ),
    (
        lambda p: pack_text(p, description("2"), "resources/../../../evil"),
        r"contains `resources/\.\./.*`, a path outside the archive",
    ),
]


# ---- archives and descriptions made to do harm ----------------------------------------------------------------------


def problems(path: Path) -> Sequence[str]:
    """What is found without running the FMU."""
    table = {"source": "fmu", "file": str(path), "fmu": {"columns": COLUMNS}}
    return fmu.fmu_problems(TrajectorySpec.model_validate(table), VEHICLE)


def entry(name: str, content: bytes = b"", *, mode: int = 0, deflated: bool = False) -> tuple[zipfile.ZipInfo, bytes]:
    """An entry of an archive with a file mode of Unix."""
    info = zipfile.ZipInfo(name)
    info.external_attr = mode << 16
    info.compress_type = zipfile.ZIP_DEFLATED if deflated else zipfile.ZIP_STORED
    return info, content


HOSTILE_ENTRIES = [
    ([entry("/etc/evil")], r"`/etc/evil`, a path outside the archive"),
    ([entry("resources\\..\\evil")], r"a path outside the archive"),
    ([entry("C:/evil")], r"`C:/evil`, a path outside the archive"),
    ([entry("resources/link", b"/etc/passwd", mode=stat.S_IFLNK | 0o777)], r"`resources/link`, a link or a device"),
    ([entry("resources/pipe", mode=stat.S_IFIFO | 0o666)], "a link or a device"),
    ([entry("resources/a\x1b[31m")], r"a name with characters that do not print"),
    ([entry("resources/\u202efdp.exe")], r"a name with characters that do not print"),
    ([entry("resources/" + 300 * "a")], r"a name too long for a file"),
    ([entry("modelDescription.xml", b"<other/>")], "contains two entries for `modelDescription.xml`"),
    ([entry("./resources/a"), entry("resources//a")], "contains two entries for `resources/a`"),
    ([entry("resources", b"file"), entry("resources/a")], "contains two entries for `resources`"),
    ([entry(f"resources/{i}") for i in range(50_001)], "contains 50003 files, more than 50000"),
    (
        [entry("resources/zeros", bytes(260 * 2**20), deflated=True)],
        r"would unpack from 0\.\d to 260 MiB, which no FMU needs; nothing was unpacked",
    ),
]


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize(("entries", "expected"), HOSTILE_ENTRIES)
def test_an_archive_made_to_do_harm_is_refused_before_anything_is_unpacked(
    entries: list[tuple[zipfile.ZipInfo, bytes]], expected: str, binary: Path, tmp_path: Path
) -> None:
    path = glide_fmu(tmp_path / "glide.fmu", binary)
    with zipfile.ZipFile(path, "a") as archive:
        for info, content in entries:
            archive.writestr(info, content)
    (problem,) = problems(path)
    assert re.search(expected, problem)
    with pytest.raises(InputError, match=expected), FmuSession(path, 30.0):
        pytest.fail("an archive that was exchanged after its check has been unpacked")


@pytest.mark.parametrize("identifier", ["../../../../lib/libc", "/lib/libc", "gli.de", "gli de", "glidé", "gli\\de"])
@pytest.mark.parametrize("fmi", ["2", "3"])
def test_a_model_identifier_that_is_not_one_is_refused(identifier: str, fmi: str, binary: Path, tmp_path: Path) -> None:
    text = description(fmi).replace('modelIdentifier="glide"', f'modelIdentifier="{identifier}"')
    with pytest.raises(InputError, match=r"the modelIdentifier `.*` may consist of letters, digits and _ only"):
        fly(pack(tmp_path / "glide.fmu", text, binary, platform_folder(fmi)))


def test_a_model_identifier_without_a_library_is_refused_before_the_flight(binary: Path, tmp_path: Path) -> None:
    text = description("2").replace('modelIdentifier="glide"', 'modelIdentifier="slide"')
    path = pack(tmp_path / "glide.fmu", text, binary, platform_folder("2"))
    (problem,) = problems(path)
    assert re.search(rf"has no binaries/{platform_folder('2')}/slide\..*, the library of its modelIdentifier", problem)


def entities(text: str) -> str:
    """A description with entities of which each is ten of the one before."""
    lines = [f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 12)]
    head = f'<!DOCTYPE x [<!ENTITY a0 "haha">{"".join(lines)}]>'
    return text.replace("<fmiModelDescription", f"{head}<fmiModelDescription").replace('"glide" ', '"&a11;" ', 1)


HOSTILE_DESCRIPTIONS = [
    (entities, r"a document type \(<!DOCTYPE \.\.\.>\) is not allowed"),
    (
        lambda text: text.replace(
            "<fmiModelDescription", '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]><fmiModelDescription'
        ),
        r"a document type",
    ),
    (
        lambda text: text.replace("</ModelVariables>", "<a>" * 100_000 + "</a>" * 100_000 + "</ModelVariables>"),
        "more than 100 elements within each other",
    ),
    (lambda text: text.replace('name="alpha"', 'name="h"'), "is not valid: two variables are named `h`"),
    (
        lambda text: text.replace('name="h" valueReference="0"', 'name="h" valueReference="4294967297"'),
        "`h` of .* has the impossible valueReference 4294967297",
    ),
]


@pytest.mark.parametrize(("damage", "expected"), HOSTILE_DESCRIPTIONS)
def test_a_description_made_to_do_harm_is_refused(damage: Any, expected: str, binary: Path, tmp_path: Path) -> None:
    text = damage(description("2"))
    with pytest.raises(InputError, match=expected):
        fly(pack(tmp_path / "glide.fmu", text, binary, platform_folder("2")))


def pack_text(path: Path, text: str, *others: str) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name in ("modelDescription.xml", *others):
            archive.writestr(name, text)


@pytest.mark.parametrize(("damage", "expected"), DAMAGED)
def test_a_damaged_fmu_is_refused(damage: Any, expected: str, tmp_path: Path) -> None:
    damage(tmp_path / "glide.fmu")
    with pytest.raises(InputError, match=expected):
        fly(tmp_path / "glide.fmu")


def test_a_full_disk_is_not_reported_as_a_fault_of_the_fmu(
    binary: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(fmpy, "extract", full)
    with pytest.raises(RunError, match=r"cannot be unpacked and started \(No space left on device\); make room"):
        fly(glide_fmu(tmp_path / "glide.fmu", binary))


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


def test_the_command_reports_it_in_one_line_and_writes_nothing(
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
