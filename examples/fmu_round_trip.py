"""Two FMUs in one co-simulation: a trajectory drives the heating. Uses FMPy only, nothing of sim_heating.

    sim-heating fmu trajectory scenarios/entry_3dof.toml --out entry.fmu
    sim-heating fmu export orbiter --control-points V09T9527 --out heating.fmu
    python examples/fmu_round_trip.py entry.fmu heating.fmu --until 900 --out round_trip.csv

Every input of the heating is connected to the output of the trajectory of the same name. In each step the trajectory
goes first; the heating follows with the conditions at the end of the step, which it reaches along a straight line
(`input_timing` = reached), so that no input is delayed or held constant.
"""

from __future__ import annotations

import argparse
import csv
import shutil
from pathlib import Path

import fmpy
from fmpy.simulation import (
    apply_start_values,
    instantiate_fmu,
    settable_in_initialization_mode,
    settable_in_instantiated,
)

REACHED = 2
"""Value of `input_timing`: inputs are reached at the end of a step, along a straight line."""


class Unit:
    """An instance of an FMU of version 2 or 3: in initialization mode when constructed, ready to step after `begin`."""

    def __init__(self, path: Path, start: dict[str, float], stop_s: float) -> None:
        self.description = fmpy.read_model_description(path)
        self.three = self.description.fmiVersion.startswith("3")
        self.variables = {v.name: v for v in self.description.modelVariables}
        self.folder = fmpy.extract(path)
        self.fmu = instantiate_fmu(self.folder, self.description, "CoSimulation")
        times = {"startTime": 0.0, "stopTime": stop_s}
        if not self.three:
            self.fmu.setupExperiment(**times)
        remaining = apply_start_values(self.fmu, self.description, start, settable_in_instantiated)
        self.fmu.enterInitializationMode(**(times if self.three else {}))
        apply_start_values(self.fmu, self.description, remaining, settable_in_initialization_mode)

    def names(self, causality: str) -> list[str]:
        """Names of the real variables of a causality."""
        kinds = ("Real", "Float64")
        return [n for n, v in self.variables.items() if v.causality == causality and v.type in kinds and not v.shape]

    def get(self, names: list[str]) -> list[float]:
        """Values by name."""
        references = [self.variables[n].valueReference for n in names]
        return list((self.fmu.getFloat64 if self.three else self.fmu.getReal)(references))

    def set(self, names: list[str], values: list[float]) -> None:
        """Set inputs by name."""
        references = [self.variables[n].valueReference for n in names]
        (self.fmu.setFloat64 if self.three else self.fmu.setReal)(references, values)

    def begin(self) -> None:
        """End the initialization."""
        self.fmu.exitInitializationMode()

    def step(self, time_s: float, step_s: float) -> None:
        """One communication step."""
        self.fmu.doStep(currentCommunicationPoint=time_s, communicationStepSize=step_s)

    def close(self) -> None:
        """Free the instance and remove the unpacked files."""
        self.fmu.freeInstance()
        shutil.rmtree(self.folder, ignore_errors=True)


def connections(trajectory: Unit, heating: Unit) -> list[str]:
    """Inputs of the heating that are outputs of the trajectory, in the same unit; the others are printed."""
    outputs = set(trajectory.names("output"))
    shared = [name for name in heating.names("input") if name in outputs]
    for name in shared:
        units = trajectory.variables[name].unit, heating.variables[name].unit
        if units[0] != units[1]:
            raise SystemExit(f"{name}: unit {units[0]} in the trajectory, {units[1]} in the heating; they must agree")
    unconnected = [name for name in heating.names("input") if name not in outputs]
    if unconnected:
        print(f"not connected, since the trajectory has no such output: {', '.join(unconnected)}")
    return shared


def co_simulate(trajectory_fmu: Path, heating_fmu: Path, until_s: float, rate_hz: float) -> list[dict[str, float]]:
    """Rows of time, altitude, speed and the heating's outputs at every step."""
    trajectory = Unit(trajectory_fmu, {}, until_s)
    heating = Unit(heating_fmu, {"input_timing": REACHED}, until_s)
    try:
        connected, results = connections(trajectory, heating), heating.names("output")
        trajectory.begin()
        heating.set(connected, trajectory.get(connected))
        heating.begin()
        rows = []
        for n in range(round(until_s * rate_hz) + 1):
            if n > 0:
                trajectory.step((n - 1) / rate_hz, 1.0 / rate_hz)
                heating.set(connected, trajectory.get(connected))
                heating.step((n - 1) / rate_hz, 1.0 / rate_hz)
            flown = zip(("altitude_m", "velocity_m_s"), trajectory.get(["altitude_m", "velocity_m_s"]), strict=True)
            rows.append({"time_s": n / rate_hz} | dict(flown) | dict(zip(results, heating.get(results), strict=True)))
        return rows
    finally:
        trajectory.close()
        heating.close()


def main() -> None:
    """Read the command line, co-simulate, write a CSV."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("trajectory", type=Path)
    parser.add_argument("heating", type=Path)
    parser.add_argument("--until", type=float, default=900.0, help="end in s")
    parser.add_argument("--rate-hz", type=float, default=4.0, help="communication steps a second")
    parser.add_argument("--out", type=Path, default=Path("round_trip.csv"))
    given = parser.parse_args()
    rows = co_simulate(given.trajectory, given.heating, given.until, given.rate_hz)
    with given.out.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    surface = [name for name in rows[0] if name.endswith("surface_K")]
    for name in surface:
        hottest = max(rows, key=lambda row: row[name])
        print(f"{name}: {hottest[name]:.1f} K at {hottest['time_s']:.1f} s, {hottest['altitude_m'] / 1e3:.1f} km")
    print(f"Wrote {given.out}: {len(rows)} rows")


if __name__ == "__main__":
    main()
