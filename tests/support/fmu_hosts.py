"""Hosts of an FMU for the tests: FMPy step by step, for both versions of the standard, and the C host that ships."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

from sim_heating.inputs.vehicle import Vehicle
from sim_heating.simulation.fmu_export.heating import heating_image, heating_units
from sim_heating.simulation.fmu_export.parts.library import TARGETS, link_inputs, wrapper_sources
from tests.support.paths import ROOT

SOURCES = ROOT / "fmu"
TIMING = {"held": 1, "reached": 2}


class Host:
    """An instance in FMPy; variables by their names, what the FMU logged in `messages`.

    timing : of the inputs; None leaves it as exported
    like   : a host of the same FMU, whose loaded library this one shares
    """

    def __init__(
        self,
        path: Path,
        parameters: Mapping[str, float] | None = None,
        timing: str | None = "reached",
        like: Host | None = None,
    ) -> None:
        described = fmpy.read_model_description(path, validate=False)
        self.three = described.fmiVersion.startswith("3")
        self.refs = {v.name: v.valueReference for v in described.modelVariables}
        self.folder = fmpy.extract(path) if like is None else like.folder
        self.owns = like is None
        self.messages: list[str] = []
        token = described.instantiationToken if self.three else described.guid
        slave = FMU3Slave if self.three else FMU2Slave
        self.fmu: Any = slave(guid=token, unzipDirectory=self.folder, instanceName="test",
                              modelIdentifier=described.coSimulation.modelIdentifier)  # fmt: skip
        self.fmu.instantiate(**({"logMessage": self._log3} if self.three else {"callbacks": self._callbacks()}))
        self.set({**(parameters or {})})
        if timing is not None:
            (self.fmu.setInt64 if self.three else self.fmu.setInteger)([self.refs["input_timing"]], [TIMING[timing]])

    def _log3(self, environment: object, status: int, category: bytes, message: bytes) -> None:
        self.messages.append(message.decode())

    def _callbacks(self) -> Any:
        from fmpy import fmi2

        def log(environment: object, name: bytes, status: int, category: bytes, message: bytes) -> None:
            self.messages.append(message.decode())

        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(log)
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmi2.calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmi2.free)
        return callbacks

    def set(self, values: Mapping[str, float]) -> None:
        setter = self.fmu.setFloat64 if self.three else self.fmu.setReal
        if values:
            setter([self.refs[n] for n in values], [float(v) for v in values.values()])

    def get(self, *names: str) -> np.ndarray:
        getter = self.fmu.getFloat64 if self.three else self.fmu.getReal
        return np.array(getter([self.refs[n] for n in names]))

    def start(self, frame: Mapping[str, float]) -> None:
        """Initialise at the time and conditions of a frame."""
        time = frame["time_s"]
        if self.three:
            self.fmu.enterInitializationMode(startTime=time)
        else:
            self.fmu.setupExperiment(startTime=time)
            self.fmu.enterInitializationMode()
        self.set({n: v for n, v in frame.items() if n != "time_s"})
        self.fmu.exitInitializationMode()
        self.time = time

    def step(self, frame: Mapping[str, float]) -> None:
        """A step to the time of a frame, whose values are set before."""
        self.set({n: v for n, v in frame.items() if n != "time_s"})
        length = frame["time_s"] - self.time
        self.fmu.doStep(currentCommunicationPoint=self.time, communicationStepSize=length)
        self.time += length

    def save(self) -> Any:
        """The state of the instance."""
        return self.fmu.getFMUState() if self.three else self.fmu.getFMUstate()

    def restore(self, state: Any, time: float) -> None:
        """Go back to a state, which was taken at a time."""
        (self.fmu.setFMUState if self.three else self.fmu.setFMUstate)(state)
        self.time = time

    def drop(self, state: Any) -> None:
        (self.fmu.freeFMUState if self.three else self.fmu.freeFMUstate)(state)

    def to_bytes(self, state: Any) -> bytes:
        return (self.fmu.serializeFMUState if self.three else self.fmu.serializeFMUstate)(state)

    def from_bytes(self, data: bytes) -> Any:
        return (self.fmu.deserializeFMUState if self.three else self.fmu.deSerializeFMUstate)(data)

    def close(self) -> None:
        self.fmu.freeInstance()
        if self.owns:
            shutil.rmtree(self.folder)

    def __enter__(self) -> Host:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def link_model(vehicle: Vehicle, folder: Path, points: Sequence[str] | None = None) -> tuple[Path, list[Path], int]:
    """A folder with the image of a vehicle for the token "{token}", what its library is linked from, and the number of
    its variables.
    """
    model = heating_image(vehicle, points)
    (folder / "model.bin").write_bytes(model.image.binary("{token}"))
    made = [*link_inputs(heating_units(model.effects), TARGETS["linux"], folder), *wrapper_sources()]
    return folder, made, len(model.image.variables)


def compile_host(folder: Path) -> Path:
    """The C host of the repository."""
    host = folder / "host"
    command = ["gcc", "-std=c11", "-O2", "-Wall", "-Werror", f"-I{SOURCES}", "-o", host, SOURCES / "host" / "host.c"]
    subprocess.run([*command, "-ldl"], check=True)
    return host


def run_host(host: Path, fmu: Path, timing: str, frames: Sequence[Mapping[str, float]], outputs: Sequence[str]) -> Any:
    """(time, output) as the C host wrote it."""
    folder = fmu.with_suffix("")
    if not folder.exists():
        zipfile.ZipFile(fmu).extractall(folder)
    table = folder.with_suffix(".csv")
    lines = [",".join(frames[0]), *(",".join(repr(float(x)) for x in f.values()) for f in frames)]
    table.write_text("\n".join(lines) + "\n")
    done = subprocess.run([host, folder, timing, table, *outputs], check=True, capture_output=True, text=True)
    return np.array([[float(x) for x in line.split(",")[1:]] for line in done.stdout.splitlines()[1:]])
