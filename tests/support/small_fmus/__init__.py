"""Small FMUs compiled from the files here: a glide with the closed form of its flight, and a feedthrough."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from pathlib import Path

import fmpy

CODE = Path(__file__).parent
SOURCES = {"glide": [CODE / "glide.c"], "feedthrough": sorted((CODE / "feedthrough").glob("*.c"))}
COMPILER = shutil.which("gcc") or shutil.which("cc") or shutil.which("clang")

FAULTS = (
    "none", "fails", "discards", "returns early", "gives NaN", "crashes", "hangs", "ends", "exits",
    "chatters and fails", "forks and crashes", "forks and hangs", "starts a process and fails", "logs and fails",
    "ends far ahead", "ends at no time", "returns at the end",
)  # fmt: skip
UNITS = {
    "km": 'm="1" factor="1000"', "ft/s": 'm="1" s="-1" factor="0.3048"', "rad": 'rad="1"', "m/s": 'm="1" s="-1"',
    "1/m": 'm="-1"', "s": 's="1"', "m": 'm="1"',
}  # fmt: skip
OUTPUTS = (("h", 0, "km"), ("speed", 1, "ft/s"), ("alpha", 2, "rad"))
PARAMETERS = (
    ("sink", 4, "m/s", 50.0),
    ("drag", 5, "1/m", 1e-6),
    ("fault_time", 6, "s", 5.0),
    ("height_0", 7, "m", 70e3),
    ("speed_0", 8, "m/s", 7000.0),
)
DEFAULTS = {name: value for name, _, _, value in PARAMETERS}


def closed_form(t: float, sink: float = 50.0, drag: float = 1e-6) -> tuple[float, float]:
    """Altitude [m] and speed [m/s] of glide.c after t seconds, its sink rate doubled after 10 s."""
    return 70e3 - sink * (t + max(t - 10.0, 0.0)), 7000.0 / (1.0 + drag * 7000.0 * t)


def library(folder: Path, *options: str, model: str = "glide") -> Path:
    """glide.c or feedthrough.c as a shared library."""
    assert COMPILER is not None
    target = folder / f"{model}{fmpy.sharedLibraryExtension}"
    headers = Path(fmpy.__file__).parent / "c-code"
    sources = [str(path) for path in (*SOURCES[model], CODE / "unused.c")]
    command = [COMPILER, "-shared", "-fPIC", "-O1", *options, f"-I{headers}", *sources, "-lm", "-o", str(target)]
    subprocess.run(command, check=True)
    return target


def description(fmi: str, kind: str = "CoSimulation", units: dict[str, str] = UNITS) -> str:
    """modelDescription.xml of the glide."""
    return (_description_2 if fmi == "2" else _description_3)(kind, units)


def _unit_definitions(units: dict[str, str]) -> str:
    return "".join(f'<Unit name="{n}"><BaseUnit {b}/></Unit>' for n, b in units.items())


def _description_2(kind: str, units: dict[str, str]) -> str:
    output = '<ScalarVariable name="{}" valueReference="{}" causality="output"><Real unit="{}"/></ScalarVariable>'
    parameter = (
        '<ScalarVariable name="{}" valueReference="{}" causality="parameter" variability="fixed" initial="exact">'
        '<Real unit="{}" start="{}"/></ScalarVariable>'
    )
    variables = [output.format(*v) for v in OUTPUTS] + [parameter.format(*v) for v in PARAMETERS]
    states = [
        f'<ScalarVariable name="{n}_state" valueReference="{r}"><Real/></ScalarVariable>'
        for n, r in (("h", 0), ("v", 1))
    ]
    first = len(variables) + 4
    ders = [
        f'<ScalarVariable name="der({n})" valueReference="{r}"><Real derivative="{first + i}"/></ScalarVariable>'
        for i, (n, r) in enumerate((("h", 11), ("v", 12)))
    ]
    return (
        '<?xml version="1.0"?><fmiModelDescription fmiVersion="2.0" modelName="glide" guid="{glide}" '
        f'numberOfEventIndicators="0"><{kind} modelIdentifier="glide" canHandleVariableCommunicationStepSize="true"'
        f"/><UnitDefinitions>{_unit_definitions(units)}</UnitDefinitions><ModelVariables>{''.join(variables)}"
        '<ScalarVariable name="command" valueReference="3" causality="input">'
        '<Real unit="rad" start="0.7"/></ScalarVariable>'
        '<ScalarVariable name="fault" valueReference="9" causality="parameter" variability="fixed" initial="exact">'
        '<Integer start="0"/></ScalarVariable>'
        '<ScalarVariable name="label" valueReference="20" causality="output"><String/></ScalarVariable>'
        f"{''.join(states)}{''.join(ders)}</ModelVariables><ModelStructure><Derivatives>"
        f'<Unknown index="{first + 2}"/><Unknown index="{first + 3}"/></Derivatives></ModelStructure>'
        "</fmiModelDescription>"
    )


_ABILITY = {"CoSimulation": "canHandleVariableCommunicationStepSize", "ModelExchange": "needsCompletedIntegratorStep"}


def _description_3(kind: str, units: dict[str, str]) -> str:
    output = '<Float64 name="{}" valueReference="{}" causality="output" unit="{}"/>'
    parameter = (
        '<Float64 name="{}" valueReference="{}" causality="parameter" variability="fixed" unit="{}" start="{}"/>'
    )
    variables = [output.format(*v) for v in OUTPUTS] + [parameter.format(*v) for v in PARAMETERS]
    return (
        '<?xml version="1.0"?><fmiModelDescription fmiVersion="3.0" modelName="glide" instantiationToken="{glide}">'
        f'<{kind} modelIdentifier="glide" {_ABILITY[kind]}="true"/>'
        f"<UnitDefinitions>{_unit_definitions(units)}</UnitDefinitions><ModelVariables>{''.join(variables)}"
        '<Float64 name="command" valueReference="3" causality="input" unit="rad" start="0.7"/>'
        '<Int32 name="fault" valueReference="9" causality="parameter" variability="fixed" start="0"/>'
        '<Float64 name="h_state" valueReference="13"/><Float64 name="v_state" valueReference="14"/>'
        '<Float64 name="der_h" valueReference="11" derivative="13"/>'
        '<Float64 name="der_v" valueReference="12" derivative="14"/></ModelVariables><ModelStructure>'
        '<ContinuousStateDerivative valueReference="11"/><ContinuousStateDerivative valueReference="12"/>'
        "</ModelStructure></fmiModelDescription>"
    )


def platform_folder(fmi: str) -> str:
    """Folder of an FMU of a version with the library for this machine."""
    return fmpy.platform if fmi == "2" else fmpy.platform_tuple


def pack(path: Path, text: str, binary: Path, folder: str) -> Path:
    """An FMU of a description and a library."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.write(binary, f"binaries/{folder}/{binary.name}")
    return path


def glide_fmu(path: Path, binary: Path, fmi: str = "2", kind: str = "CoSimulation") -> Path:
    """The glide as an FMU of a version and interface."""
    return pack(path, description(fmi, kind), binary, platform_folder(fmi))


FEEDTHROUGH = ("altitude", "airspeed", "alpha", "beta")


def feedthrough_fmu(path: Path, binary: Path, fmi: str = "2") -> Path:
    """Four outputs in SI units and deg that are its inputs `set_<output>`; their start value is 0."""
    inputs, outputs = (
        [(f"set_{n}", i) for i, n in enumerate(FEEDTHROUGH)],
        [(n, i + 4) for i, n in enumerate(FEEDTHROUGH)],
    )
    units = dict(zip(FEEDTHROUGH, ("m", "m/s", "deg", "deg"), strict=True))
    if fmi == "2":
        one = '<ScalarVariable name="{}" valueReference="{}" causality="{}"><Real unit="{}"{}/></ScalarVariable>'
        count = '<ScalarVariable name="count" valueReference="0" causality="input" variability="discrete"><Integer start="0"/></ScalarVariable>'  # noqa: E501
        token = "guid"
    else:
        one = '<Float64 name="{}" valueReference="{}" causality="{}" unit="{}"{}/>'
        count = '<Int32 name="count" valueReference="0" causality="input" start="0"/>'
        token = "instantiationToken"
    variables = [one.format(n, r, "input", units[n[4:]], ' start="0"') for n, r in inputs]
    variables += [one.format(n, r, "output", units[n], "") for n, r in outputs]
    text = (
        f'<?xml version="1.0"?><fmiModelDescription fmiVersion="{fmi}.0" modelName="Feedthrough" {token}="x">'
        f'<CoSimulation modelIdentifier="feedthrough"/><ModelVariables>{"".join(variables)}{count}</ModelVariables>'
        "<ModelStructure/></fmiModelDescription>"
    )
    return pack(path, text, binary, platform_folder(fmi))
