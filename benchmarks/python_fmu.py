"""A frame of the exported FMU against one of the same plug-in through PythonFMU, each in a plain C host and in FMPy.

Both FMUs take the same inputs, step as often and give out the same temperatures, which must agree to the last bit:
their kernel is one. The comparison concerns the layers between a host and the kernel, which show in a host that costs
nothing itself: the bound is on the C host. FMPy's own calls are most of a frame there.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import time
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from fmpy.model_description import ModelDescription
from numpy.typing import NDArray

from benchmarks.measure import Figure
from sim_heating.base.conditions import FRAME
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.simulation.fmu_export.export import write_fmu
from sim_heating.simulation.fmu_export.heating import heating_image, heating_units, quoted
from sim_heating.simulation.fmu_export.parts.library import wrapper_folder
from sim_heating.simulation.plugin import HeatingPlugin

FloatArray = NDArray[np.float64]
HOST = Path(__file__).parent / "c_peer" / "fmi2_host.c"
REACHED = 2

SLAVE = """
import numpy as np
from pythonfmu import Fmi2Causality, Fmi2Slave, Real
from sim_heating import HeatingPlugin, load_vehicle
from sim_heating.base.conditions import FRAME

class Heating(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        vehicle = load_vehicle("{vehicle}")
        self.plugin = HeatingPlugin(vehicle, {points}, nodes={nodes}, longest_wait_s=0.0)
        self.temperatures = self.plugin.temperatures().tolist()
        for name in FRAME[1:]:
            setattr(self, name, 0.0)
            self.register_variable(Real(name, causality=Fmi2Causality.input))
        for k, (point, what) in enumerate(self.plugin.outputs):
            get = lambda k=k: self.temperatures[k]
            self.register_variable(Real(f"{{point}}.{{what}}", causality=Fmi2Causality.output, getter=get))

    def frame(self, time_s):
        return np.array([time_s, *(getattr(self, name) for name in FRAME[1:])])

    def setup_experiment(self, start_time, *more):
        self.start_time = start_time

    def exit_initialization_mode(self):
        self.plugin.reset(self.frame(self.start_time))

    def do_step(self, current_time, step_size):
        self.plugin.step(self.frame(current_time + step_size))
        self.temperatures = self.plugin.temperatures().tolist()
        return True
"""
"""The plug-in as a user of PythonFMU writes it: inputs are attributes, a step's temperatures a list."""


@dataclass(frozen=True)
class Timed:
    """An FMI 2 FMU, unpacked, and the outputs to read.

    outputs : names of its variables
    reached : inputs are those at the end of a step, which this package's FMU has to be given
    """

    folder: Path
    outputs: Sequence[str]
    reached: bool

    @property
    def described(self) -> ModelDescription:
        """The description of its variables."""
        return fmpy.read_model_description(self.folder, validate=False)

    def references(self) -> tuple[list[int], list[int], int | None]:
        """Value references of inputs and outputs, and of the variable that states when inputs apply."""
        refs = {v.name: v.valueReference for v in self.described.modelVariables}
        timing = refs["input_timing"] if self.reached else None
        return [refs[name] for name in FRAME[1:]], [refs[name] for name in self.outputs], timing


@dataclass(frozen=True)
class Frame:
    """Microseconds of a frame in the C host, and all that was read (frame, output) [K]."""

    set_us: float
    step_us: float
    get_us: float
    read: FloatArray

    @property
    def whole_us(self) -> float:
        """Set, step and get."""
        return self.set_us + self.step_us + self.get_us


def _unpacked(path: Path) -> Path:
    """The folder of an FMU's contents, next to it."""
    folder = path.with_suffix("")
    zipfile.ZipFile(path).extractall(folder)
    return folder


def _theirs(plugin: HeatingPlugin, vehicle: str, nodes: int, work: Path) -> Timed:
    """The plug-in exported by PythonFMU."""
    script = work / "heating.py"
    script.write_text(SLAVE.format(vehicle=vehicle, points=list(plugin.names), nodes=nodes))
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", str(script), "-d", str(work)]
    subprocess.run(command, check=True, capture_output=True)
    names = [f"{point}.{what}" for point, what in plugin.outputs]
    return Timed(_unpacked(next(work.glob("Heating*.fmu"))), names, False)


def _ours(plugin: HeatingPlugin, vehicle: str, nodes: int, work: Path) -> Timed:
    """The plug-in exported by this package, with the same outputs."""
    model = heating_image(load_vehicle(vehicle), plugin.names, nodes=nodes)
    write_fmu(work / "ours.fmu", model.image, heating_units(model.effects), 2, ["linux"])
    own = {"surface": "surface_K", "bondline": "bondline_K"}
    names = [f"{quoted(point)}.{own.get(what, f'sensor.{quoted(what)}.indicated_K')}" for point, what in plugin.outputs]
    return Timed(_unpacked(work / "ours.fmu"), names, True)


def _host(work: Path) -> Path:
    """The C host of FMI 2."""
    host = work / "fmi2_host"
    subprocess.run(["gcc", "-std=c11", "-O2", f"-I{wrapper_folder()}", "-o", host, HOST, "-ldl"], check=True)
    return host


def _python_library() -> Path | None:
    """The shared library of this Python, which a PythonFMU needs from a host that is not Python itself."""
    folder, name = sysconfig.get_config_var("LIBDIR"), sysconfig.get_config_var("LDLIBRARY")
    found = Path(folder) / name
    return found if found.suffix == ".so" and found.is_file() else None


def _in_c(host: Path, fmu: Timed, table: Path) -> Frame:
    """A frame in the C host, Python within reach of those that need it.

    table : CSV of frames (conditions.FRAME)
    """
    described = fmu.described
    library = fmu.folder / "binaries" / "linux64" / f"{described.coSimulation.modelIdentifier}.so"
    inputs, outputs, timing = fmu.references()
    listed = [",".join(map(str, refs)) for refs in (inputs, outputs)]
    more = [] if timing is None else [f"{timing}={REACHED}"]
    resources = (fmu.folder / "resources").as_uri()
    env = dict(os.environ)
    if not fmu.reached:
        env |= {"LD_PRELOAD": str(_python_library()), "PYTHONHOME": sys.base_prefix}
        env["PYTHONPATH"] = os.pathsep.join([str(Path.cwd()), *sys.path])
    command = [host, library, described.guid, resources, table, *listed, *more]
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=env)
    times = {k: float(v) for k, v in (line.split() for line in done.stderr.splitlines()[-3:])}
    read = np.array([[float(x) for x in line.split(",")[1:]] for line in done.stdout.splitlines()])
    return Frame(times["set_us"], times["step_us"], times["get_us"], read)


def _in_fmpy(fmu: Timed, frames: FloatArray) -> float:
    """Fastest frame [us] in FMPy: set inputs, step, get outputs."""
    described = fmu.described
    inputs, outputs, timing = fmu.references()
    slave = FMU2Slave(guid=described.guid, unzipDirectory=str(fmu.folder), instanceName="timed",
                      modelIdentifier=described.coSimulation.modelIdentifier)  # fmt: skip
    slave.instantiate()
    if timing is not None:
        slave.setInteger([timing], [REACHED])
    slave.setupExperiment(startTime=frames[0, 0])
    slave.enterInitializationMode()
    slave.setReal(inputs, frames[0, 1:].tolist())
    slave.exitInitializationMode()
    best, now = np.inf, float(frames[0, 0])
    for frame in frames[1:]:
        given, then = frame[1:].tolist(), float(frame[0])
        began = time.perf_counter()
        slave.setReal(inputs, given)
        slave.doStep(now, then - now)
        slave.getReal(outputs)
        best, now = min(best, time.perf_counter() - began), then
    slave.terminate()
    slave.freeInstance()
    return 1e6 * best


def _called(plugin: HeatingPlugin, frames: FloatArray) -> float:
    """Fastest frame [us] of the plug-in called from Python, without an FMU."""
    plugin.reset(frames[0])
    best = np.inf
    for frame in frames[1:]:
        began = time.perf_counter()
        plugin.step(frame)
        plugin.temperatures().tolist()
        best = min(best, time.perf_counter() - began)
    return 1e6 * best


def beside(
    vehicle: str, points: Sequence[str], nodes: int, frames: FloatArray, table: Path, work: Path, rounds: int
) -> list[Figure]:
    """PythonFMU over this package's FMU, in the C host and in FMPy.

    table : the frames as a file
    """
    folder = work / f"beside{len(points)}"
    folder.mkdir()
    plugin = HeatingPlugin(load_vehicle(vehicle), points, nodes=nodes, longest_wait_s=0.0)
    ours, theirs = _ours(plugin, vehicle, nodes, folder), _theirs(plugin, vehicle, nodes, folder)
    about = f"{len(points)} points" if len(points) > 1 else "1 point"
    figures = []
    if _python_library() is not None:
        host = _host(folder)
        pairs = [(_in_c(host, ours, table), _in_c(host, theirs, table)) for _ in range(rounds)]
        for a, b in pairs:
            np.testing.assert_array_equal(a.read, b.read)
        ratio = float(np.median([b.whole_us / a.whole_us for a, b in pairs]))
        best, other = (min(frame, key=lambda f: f.whole_us) for frame in zip(*pairs, strict=True))
        times = [f"{f.set_us:.1f} + {f.step_us:.1f} + {f.get_us:.1f}" for f in (other, best)]
        read = f"set, step and get of {len(ours.outputs)} outputs"
        note = (
            f"{times[0]} against {times[1]} us, {read}; the plug-in called from Python {_called(plugin, frames):.0f} us"
        )
        bound = 10.0 if len(points) > 1 else None
        figures = [Figure(f"PythonFMU over this FMU, {about}, C host", ratio, "x", bound, True, note)]
    few = frames[:400]
    fmpy_us = [(_in_fmpy(ours, few), _in_fmpy(theirs, few)) for _ in range(rounds)]
    best_us, other_us = (min(us) for us in zip(*fmpy_us, strict=True))
    ratio = float(np.median([b / a for a, b in fmpy_us]))
    note = f"{other_us:.0f} against {best_us:.0f} us, set, step and get, most of it FMPy's own calls"
    return [*figures, Figure(f"PythonFMU over this FMU, {about}, FMPy", ratio, "x", note=note)]
