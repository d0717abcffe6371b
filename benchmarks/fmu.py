"""The heating plug-in as an FMU: a step in a plain C host, against the kernel alone and PythonFMU; export; fuzzing."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from benchmarks import python_fmu
from benchmarks.measure import Figure, save
from sim_heating.base.conditions import FRAME
from sim_heating.inputs.scenario import load_scenario
from sim_heating.inputs.vehicle import Vehicle, load_vehicle
from sim_heating.simulation.fmu_export.export import export_fmu, write_fmu
from sim_heating.simulation.fmu_export.heating import heating_image, heating_units
from sim_heating.simulation.fmu_export.parts.library import (
    HELD,
    INPUTS,
    INPUTS_NEXT,
    INPUTS_NOW,
    MODE,
    N_INPUTS,
    NEXT,
    NOW,
    START,
    STEP,
    TARGETS,
    TIMING,
    link_inputs,
    wrapper_folder,
    wrapper_sources,
)
from sim_heating.simulation.run import fly_scenario

ROOT = Path(__file__).parents[1]
POINTS, NODES, STEP_S, STEPS, ROUNDS = 16, 24, 0.1, 3000, 9
FUZZED = 20_000
EXPORTS = 2
TIMED_S = (0.05, 0.1, 0.25, 0.5, 1.0, 2.0)


def _frames(step_s: float, count: int, start_s: float = 300.0) -> np.ndarray:
    """(frame, len(FRAME)) of an entry with a POPU, from the heating pulse on."""
    flown = fly_scenario(load_scenario(ROOT / "scenarios" / "entry_3dof.toml")).conditions.with_columns(jets=0.0)
    at = flown.at(start_s + step_s * np.arange(count + 1))
    return np.column_stack([at[name] for name in FRAME])


def _host(work: Path) -> Path:
    host = work / "host"
    source = str(wrapper_folder() / "host" / "host.c")
    subprocess.run(["gcc", "-std=c11", "-O2", f"-I{wrapper_folder()}", "-o", str(host), source, "-ldl"], check=True)
    return host


def _in_host(
    host: Path, fmu: Path, table: Path, timing: str, outputs: list[str]
) -> tuple[np.ndarray, dict[str, float]]:
    """Output of the C host, and its times."""
    done = subprocess.run([host, fmu, timing, table, *outputs], check=True, capture_output=True, text=True)
    times = {k: float(v) for k, v in (line.split() for line in done.stderr.splitlines())}
    return np.array([[float(x) for x in line.split(",")[1:]] for line in done.stdout.splitlines()[1:]]), times


def _write(table: Path, frames: np.ndarray) -> Path:
    np.savetxt(table, frames, fmt="%.17g", delimiter=",", header=",".join(FRAME), comments="")
    return table


# A step ------------------------------------------------------------------------------------------------------------


def _direct(model: Any, frames: np.ndarray) -> float:
    """Fastest step [s] of the compiled functions called from a compiled loop, without an FMU."""
    function, *called = [unit.compiled for unit in heating_units(model.effects)]
    move = function.ctypes
    R, N, T = model.image.R.copy(), model.image.N.copy(), model.image.T.copy()
    N[TIMING] = HELD
    A = np.array([f.address for f in called], dtype=np.int64)

    @njit
    def fly(R, N, A, T, frames, take):
        for i in range(take, take + 50):
            for k in range(N[N_INPUTS]):
                value = frames[i, 1 + k] if k < frames.shape[1] - 1 else 0.0
                R[N[INPUTS_NOW] + k] = R[N[INPUTS_NEXT] + k]
                R[N[INPUTS_NEXT] + k] = value
            R[NEXT] = frames[i, 0]
            move(R.ctypes, N.ctypes, A.ctypes, T.ctypes)
            R[NOW] = R[NEXT]

    R[NOW] = frames[0, 0]
    R[N[INPUTS] : N[INPUTS] + len(FRAME) - 1] = frames[0, 1:]
    N[MODE] = START
    move(*(a.ctypes.data_as(t) for a, t in zip((R, N, A, T), move.argtypes, strict=True)))
    N[MODE] = STEP
    best = np.inf
    for take in range(1, len(frames) - 50, 50):
        began = time.perf_counter()
        fly(R, N, A, T, frames, take)
        best = min(best, (time.perf_counter() - began) / 50)
    return best


def _stepping(vehicle: Vehicle, host: Path, work: Path) -> list[Figure]:
    names = list(vehicle.control_points)[:POINTS]
    outputs = [f"{n}.surface_K" for n in names]
    model = heating_image(vehicle, names, nodes=NODES)
    write_fmu(work / "timed.fmu", model.image, heating_units(model.effects), 3, ["linux"])
    zipfile.ZipFile(work / "timed.fmu").extractall(work / "timed")
    frames = _frames(STEP_S, STEPS)
    table = _write(work / "timed.csv", frames)
    times, direct = [], []
    for _ in range(ROUNDS):
        times.append(_in_host(host, work / "timed", table, "reached", outputs)[1])
        direct.append(_direct(model, frames))
    step_us, direct_us = min(t["fastest_step_us"] for t in times), 1e6 * min(direct)
    about = f"{POINTS} points, {NODES} nodes asked for"
    figures = [
        Figure("inputs set and doStep, C host", step_us, "us", 20.0, note=about),
        Figure("the same over the kernel called directly", step_us / direct_us, "x", 1.2, note=f"{direct_us:.1f} us"),
        Figure("instantiate, C host", min(t["instantiate_ms"] for t in times), "ms", 50.0),
    ]
    beside = [
        f for n in (POINTS, 1) for f in python_fmu.beside("orbiter", names[:n], NODES, frames, table, work, ROUNDS)
    ]
    return [*figures, *beside]


# Inputs, export, fuzzing -------------------------------------------------------------------------------------------


def _timing(vehicle: Vehicle, host: Path, work: Path) -> dict[str, dict[str, float]]:
    """Largest error of surface temperatures [K] by the meaning of inputs and the communication step."""
    names = ["NOSECAP", "V09T9527", "V07T9975"]
    export_fmu(vehicle, work / "inputs.fmu", names)
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


def _export(work: Path, cache: Path) -> tuple[float, float]:
    """Time by the clock and of the processors [s] of the command with this cache of kernels."""
    command = [sys.executable, "-m", "sim_heating", "fmu", "export", "orbiter", "--out", str(work / "whole.fmu")]
    before, began = os.times(), time.perf_counter()
    subprocess.run(command, check=True, capture_output=True, env=os.environ | {"NUMBA_CACHE_DIR": str(cache)})
    wall, after = time.perf_counter() - began, os.times()
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    return wall, spent


def _exporting(work: Path) -> list[Figure]:
    """Exports of all points by the command, each the faster of two: first ever, without the library, once more."""
    first, linked, again = [], [], []
    for k in range(EXPORTS):
        cache = work / f"kernels{k}"
        first.append(_export(work, cache))
        shutil.rmtree(cache / "fmu")
        linked.append(_export(work, cache))
        again.append(_export(work, cache))
    rows = (
        ("first export, nothing compiled before", first),
        ("export where kernels are compiled and the library is not", linked),
        ("export where the library is there", again),
    )
    spent = "{:.0f} s of the processors'"
    return [Figure(what, min(found)[0], "s", 20.0, note=spent.format(min(found)[1])) for what, found in rows]


def compile_fuzz(vehicle: Vehicle, work: Path) -> list[str]:
    """Command, less seed and number of calls, of the fuzzer with an FMU of two points in it, sanitized."""
    model = heating_image(vehicle, ["NOSECAP", "V09T9527"])
    (work / "model.bin").write_bytes(model.image.binary("{fuzzed}"))
    made = link_inputs(heating_units(model.effects), TARGETS["linux"], work)
    flags = ["-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=undefined", f"-I{wrapper_folder()}"]
    program = work / "fuzz"
    command = ["gcc", *flags, "-o", program, *made, *wrapper_sources(), wrapper_folder() / "host" / "fuzz.c", "-lm"]
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


def _instances(vehicle: Vehicle, work: Path) -> list[Figure]:
    """Memory of many instances of all points, and what their states cost, in a C host linked with the wrapper."""
    folder = work / "instances"
    folder.mkdir()
    model = heating_image(vehicle)
    (folder / "model.bin").write_bytes(model.image.binary("{counted}"))
    made = [*link_inputs(heating_units(model.effects), TARGETS["linux"], folder), *wrapper_sources()]
    source = Path(__file__).parent / "c_peer" / "instances.c"
    command = ["gcc", "-std=gnu11", "-O2", f"-I{wrapper_folder()}", "-o", folder / "host", *made, source, "-lm"]
    subprocess.run(list(map(str, command)), check=True)
    done = subprocess.run([folder / "host", folder, "{counted}"], check=True, capture_output=True, text=True)
    found = {name: float(value) for name, value in (line.split() for line in done.stdout.splitlines())}
    points, step = f"{len(vehicle.control_points)} points", found["step_us"]
    return [
        Figure("memory of an instance", 1e-3 * found["instance_bytes"], "kB", 64.0, note=points),
        Figure("a serialised state", 1e-3 * found["state_bytes"], "kB", 64.0, note=points),
        Figure("a state taken, over a step", found["get_us"] / step, "x", 1.0, note=f"{found['get_us']:.1f} us"),
        Figure(
            "a state restored, over a step",
            found["set_us"] / step,
            "x",
            1.0,
            note=f"{found['set_us']:.1f} us with what the next step does for it",
        ),
        Figure("a step of two instances in turn", found["two_us"], "us", note=f"{step:.1f} us of one alone"),
        Figure("a step of 40 instances in turn", found["many_us"], "us", note=f"{step:.1f} us of one alone"),
    ]


def run() -> list[Figure]:
    """Measure everything."""
    vehicle = load_vehicle("orbiter")
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        host = _host(work)
        figures = [
            *_stepping(vehicle, host, work),
            *_instances(vehicle, work),
            *_exporting(work),
            _fuzzing(vehicle, work),
        ]
        apart = _timing(vehicle, host, work)
    figures += [Figure(f"held inputs, {s}: error of a surface temperature", e, "K") for s, e in apart["held"].items()]
    figures += [Figure(f"inputs given at both ends, {s}", e, "K") for s, e in apart["updated"].items()]
    save("fmu", figures, {"largest_error_K": apart})
    return figures
