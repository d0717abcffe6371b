"""The heating plug-in as an FMU: a step in a plain C host, against the kernel alone and PythonFMU; export; fuzzing."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from numba import njit

from benchmarks.measure import Figure, save
from sim_heating.conditions import FRAME
from sim_heating.fmu.export import export_heating, write_fmu
from sim_heating.fmu.heating import heating_functions, heating_image
from sim_heating.fmu.library import TARGETS, library, parts, sources
from sim_heating.fmu.native import HELD, INPUTS, INPUTS_NEXT, INPUTS_NOW, N_INPUTS, NEXT, NOW, TIMING
from sim_heating.run import fly_scenario
from sim_heating.scenario import load_scenario
from sim_heating.vehicle import Vehicle, load_vehicle

ROOT = Path(__file__).parents[1]
POINTS, NODES, STEP_S, STEPS, ROUNDS = 16, 24, 0.1, 3000, 5
FUZZED = 20_000
TIMED_S = (0.05, 0.1, 0.25, 0.5, 1.0, 2.0)

PYTHON_FMU = """
import numpy as np
from pythonfmu import Fmi2Causality, Fmi2Slave, Real
from sim_heating.conditions import FRAME
from sim_heating.plugin import HeatingPlugin
from sim_heating.vehicle import load_vehicle

class Heating(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        vehicle = load_vehicle("orbiter")
        self.plugin = HeatingPlugin(vehicle, list(vehicle.control_points)[:{points}], nodes={nodes}, longest_wait_s=0.0)
        self.frame = np.zeros(len(FRAME))
        for i, name in enumerate(FRAME[1:], start=1):
            get, put = (lambda i=i: self.frame[i]), (lambda v, i=i: self.frame.__setitem__(i, v))
            self.register_variable(Real(name, causality=Fmi2Causality.input, getter=get, setter=put))
        for k, name in enumerate(self.plugin.names):
            get = lambda k=k: float(self.plugin.surface_temperatures()[k])
            self.register_variable(Real(f"{{name}}.surface_K", causality=Fmi2Causality.output, getter=get))

    def setup_experiment(self, start_time, *more):
        self.frame[0] = start_time

    def exit_initialization_mode(self):
        self.plugin.reset(self.frame.copy())

    def do_step(self, current_time, step_size):
        self.frame[0] = current_time + step_size
        self.plugin.step(self.frame)
        return True
"""


def _frames(step_s: float, count: int, start_s: float = 300.0) -> np.ndarray:
    """(frame, len(FRAME)) of an entry with a POPU, from the heating pulse on."""
    flown = fly_scenario(load_scenario(ROOT / "scenarios" / "entry_3dof.toml")).conditions.with_columns(jets=0.0)
    at = flown.at(start_s + step_s * np.arange(count + 1))
    return np.column_stack([at[name] for name in FRAME])


def _host(work: Path) -> Path:
    host = work / "host"
    source = str(sources() / "host" / "host.c")
    subprocess.run(["gcc", "-std=c11", "-O2", f"-I{sources()}", "-o", str(host), source, "-ldl"], check=True)
    return host


def _in_host(
    host: Path, fmu: Path, table: Path, timing: str, outputs: list[str]
) -> tuple[np.ndarray, dict[str, float]]:
    """What the C host wrote, and its times."""
    done = subprocess.run([host, fmu, timing, table, *outputs], check=True, capture_output=True, text=True)
    told = {k: float(v) for k, v in (line.split() for line in done.stderr.splitlines())}
    return np.array([[float(x) for x in line.split(",")[1:]] for line in done.stdout.splitlines()[1:]]), told


def _write(table: Path, frames: np.ndarray) -> Path:
    np.savetxt(table, frames, fmt="%.17g", delimiter=",", header=",".join(FRAME), comments="")
    return table


# A step ------------------------------------------------------------------------------------------------------------


def _direct(model: Any, frames: np.ndarray) -> float:
    """Fastest step [s] of the compiled functions called from a compiled loop, no FMU about them."""
    start, step, *called = [f.compiled for f in heating_functions(model.effects)]
    begin, advance = start.ctypes, step.ctypes
    R, N = model.image.R.copy(), model.image.N.copy()
    N[TIMING] = HELD
    A = np.array([f.address for f in called], dtype=np.int64)

    @njit
    def fly(R, N, A, frames, take):  # type: ignore[no-untyped-def]
        for i in range(take, take + 50):
            for k in range(N[N_INPUTS]):
                value = frames[i, 1 + k] if k < frames.shape[1] - 1 else 0.0
                R[N[INPUTS_NOW] + k] = R[N[INPUTS_NEXT] + k]
                R[N[INPUTS_NEXT] + k] = value
            R[NEXT] = frames[i, 0]
            advance(R.ctypes, N.ctypes, A.ctypes)
            R[NOW] = R[NEXT]

    R[NOW] = frames[0, 0]
    R[N[INPUTS] : N[INPUTS] + len(FRAME) - 1] = frames[0, 1:]
    begin(*(a.ctypes.data_as(t) for a, t in zip((R, N, A), begin.argtypes, strict=True)))
    best = np.inf
    for take in range(1, len(frames) - 50, 50):
        began = time.perf_counter()
        fly(R, N, A, frames, take)
        best = min(best, (time.perf_counter() - began) / 50)
    return best


def _in_fmpy(path: Path, frames: np.ndarray, names: list[str]) -> float:
    """Fastest frame [s] of an FMI 2 FMU in FMPy: set inputs, step, get outputs."""
    described = fmpy.read_model_description(path, validate=False)
    refs = {v.name: v.valueReference for v in described.modelVariables}
    folder = fmpy.extract(path)
    fmu = FMU2Slave(guid=described.guid, unzipDirectory=folder, instanceName="timed",
                    modelIdentifier=described.coSimulation.modelIdentifier)  # fmt: skip
    fmu.instantiate()
    inputs, outputs = [refs[n] for n in FRAME[1:]], [refs[n] for n in names]
    if "input_timing" in refs:
        fmu.setInteger([refs["input_timing"]], [2])
    fmu.setupExperiment(startTime=frames[0, 0])
    fmu.enterInitializationMode()
    fmu.setReal(inputs, frames[0, 1:].tolist())
    fmu.exitInitializationMode()
    best, now = np.inf, float(frames[0, 0])
    for frame in frames[1:]:
        began = time.perf_counter()
        fmu.setReal(inputs, frame[1:].tolist())
        fmu.doStep(now, STEP_S)
        fmu.getReal(outputs)
        best, now = min(best, time.perf_counter() - began), now + STEP_S
    fmu.terminate()
    fmu.freeInstance()
    shutil.rmtree(folder)
    return best


def _python_fmu(work: Path) -> Path:
    script = work / "heating.py"
    script.write_text(PYTHON_FMU.format(points=POINTS, nodes=NODES))
    subprocess.run(
        [sys.executable, "-m", "pythonfmu", "build", "-f", script, "-d", work], check=True, capture_output=True
    )
    return next(work.glob("Heating*.fmu"))


def _stepping(vehicle: Vehicle, host: Path, work: Path) -> list[Figure]:
    names = list(vehicle.control_points)[:POINTS]
    outputs = [f"{n}.surface_K" for n in names]
    model = heating_image(vehicle, names, nodes=NODES)
    functions = heating_functions(model.effects)
    for fmi in (2, 3):
        write_fmu(work / f"timed{fmi}.fmu", model.image, functions, fmi, ["linux"])
    zipfile.ZipFile(work / "timed3.fmu").extractall(work / "timed")
    frames = _frames(STEP_S, STEPS)
    table = _write(work / "timed.csv", frames)
    told, direct = [], []
    for _ in range(ROUNDS):
        told.append(_in_host(host, work / "timed", table, "reached", outputs)[1])
        direct.append(_direct(model, frames))
    step_us, direct_us = min(t["fastest_step_us"] for t in told), 1e6 * min(direct)
    about = f"{POINTS} points, {NODES} nodes asked for"
    figures = [
        Figure("inputs set and doStep, C host", step_us, "us", 20.0, note=about),
        Figure("the same over the kernel called directly", step_us / direct_us, "x", 1.2, note=f"{direct_us:.1f} us"),
        Figure("instantiate, C host", min(t["instantiate_ms"] for t in told), "ms", 50.0),
    ]
    few = frames[:400]
    ours = min(_in_fmpy(work / "timed2.fmu", few, outputs) for _ in range(2))
    theirs = _in_fmpy(_python_fmu(work), few, outputs)
    note = f"{1e6 * theirs:.0f} against {1e6 * ours:.0f} us, set, step and get"
    return [*figures, Figure("PythonFMU over this FMU, both in FMPy", theirs / ours, "x", 10.0, True, note)]


# Inputs, export, fuzzing -------------------------------------------------------------------------------------------


def _timing(vehicle: Vehicle, host: Path, work: Path) -> dict[str, dict[str, float]]:
    """Largest error of surface temperatures [K] by the meaning of inputs and the communication step."""
    names = ["NOSECAP", "V09T9527", "V07T9975"]
    export_heating(vehicle, work / "inputs.fmu", names)
    zipfile.ZipFile(work / "inputs.fmu").extractall(work / "inputs")
    outputs = [f"{n}.surface_K" for n in names]
    finest, span = 0.05, 900.0

    def flown(timing: str, step_s: float) -> np.ndarray:
        frames = _frames(step_s, round(span / step_s), 0.0)
        return _in_host(host, work / "inputs", _write(work / "inputs.csv", frames), timing, outputs)[0]

    exact = flown("reached", finest)
    apart: dict[str, dict[str, float]] = {"held": {}, "updated": {}, "reached": {}}
    for timing, step_s in ((t, s) for t in apart for s in TIMED_S):
        every = round(step_s / finest)
        found = flown(timing, step_s)
        apart[timing][f"{step_s:g} s"] = float(np.max(np.abs(found - exact[::every][: len(found)])))
    return apart


def _exporting(vehicle: Vehicle, work: Path) -> Figure:
    began = time.perf_counter()
    export_heating(vehicle, work / "whole.fmu")
    return Figure("export of all points, library in the cache", time.perf_counter() - began, "s", 20.0)


def _linking(vehicle: Vehicle) -> Figure:
    model = heating_image(vehicle, ["NOSECAP"])
    began = time.perf_counter()
    library(heating_functions(model.effects), TARGETS["linux"], more=str(time.time()))
    return Figure("making the library, once; kernels compiled before", time.perf_counter() - began, "s")


def compile_fuzz(vehicle: Vehicle, work: Path) -> list[str]:
    """Command, less seed and number of calls, of the fuzzer with an FMU of two points in it, sanitized."""
    model = heating_image(vehicle, ["NOSECAP", "V09T9527"])
    (work / "model.bin").write_bytes(model.image.binary("{fuzzed}"))
    made = parts(heating_functions(model.effects), TARGETS["linux"], work)
    flags = ["-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=undefined", f"-I{sources()}"]
    program = work / "fuzz"
    command = ["gcc", *flags, "-o", program, *made, sources() / "host" / "fuzz.c", "-lm"]
    subprocess.run(list(map(str, command)), check=True)
    return [str(program), str(work), "{fuzzed}", str(len(model.image.variables))]


def _fuzzing(vehicle: Vehicle, work: Path) -> Figure:
    folder = work / "fuzz"
    folder.mkdir()
    command = compile_fuzz(vehicle, folder)
    calls, failed, steps = 0, 0, 0
    for seed in range(1, 6):
        done = subprocess.run([*command, str(seed), str(FUZZED)], capture_output=True, text=True, timeout=600)
        failed += done.returncode != 0
        calls += FUZZED
        steps += int(done.stdout.split()[-1]) if done.returncode == 0 else 0
    note = f"{calls} calls of FMI 2 and 3, {steps} of them steps that ended well"
    return Figure("fuzzing with sanitizers: runs that crash, leak or hang", failed, "", 0.0, note=note)


def run() -> list[Figure]:
    """Measure everything."""
    vehicle = load_vehicle("orbiter")
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        host = _host(work)
        figures = [
            *_stepping(vehicle, host, work),
            _exporting(vehicle, work),
            _linking(vehicle),
            _fuzzing(vehicle, work),
        ]
        apart = _timing(vehicle, host, work)
    figures += [Figure(f"held inputs, {s}: error of a surface temperature", e, "K") for s, e in apart["held"].items()]
    figures += [Figure(f"inputs given at both ends, {s}", e, "K") for s, e in apart["updated"].items()]
    save("fmu", figures, {"largest_error_K": apart})
    return figures
