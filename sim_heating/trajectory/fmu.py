"""A flight from an FMU, stepped alongside: one communication step a frame, commands of guidance where it takes them.

The FMU runs in a process of its own (`fmu_session`). What its variables mean is in [trajectory.fmu] (`fmu_columns`);
temperature, pressure, Mach and Reynolds number are derived here as for every source. An input holds over a step: a
schedule is taken at the step's beginning, a command is the one that is to be reached at its end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sim_heating.atmosphere import HIGHEST_M, LOWEST_M, speed_of_sound_kernel, us76_kernel
from sim_heating.conditions import FRAME, Conditions
from sim_heating.errors import InputError, RunError
from sim_heating.plausible import frame_problem
from sim_heating.progress import Progress
from sim_heating.trajectory.flight import ROW, Flight, OnFrame, Sampler, reference_length_m
from sim_heating.trajectory.fmu_columns import ColumnsOfFmu, Frame
from sim_heating.trajectory.fmu_model import FmuModel, read_fmu
from sim_heating.trajectory.fmu_pilot import InputsOfFmu
from sim_heating.trajectory.fmu_session import Answer, FmuSession
from sim_heating.trajectory.spec import TrajectorySpec

REPORT_S = 20.0


class FmuFlight:
    """What a scenario's [trajectory] makes of an FMU, checked against it before any of its code runs.

    raises : InputError, all problems of one kind at once
    """

    def __init__(self, spec: TrajectorySpec, vehicle_dir: Path) -> None:
        if spec.file is None:
            raise InputError('trajectory: source = "fmu" needs `file`, an FMU')
        self.spec = spec
        self.model: FmuModel = read_fmu(Path(spec.file), spec.fmu.interface)
        self.columns = ColumnsOfFmu(self.model, spec, vehicle_dir)
        self.start = self.model.start_values(spec.fmu)
        self.inputs = InputsOfFmu(self.model, spec, vehicle_dir, self.columns.have)
        self.sampler = Sampler(spec.sample_s, reference_length_m(vehicle_dir))

    def fly(self, on_frame: OnFrame | None, progress: Progress | None) -> Flight:
        """Step the FMU until the flight ends."""
        spec, step_s = self.spec, 1.0 / self.spec.rate_hz
        events = [(0.0, note) for note in self.columns.notes]
        with FmuSession(self.model.path, spec.fmu.timeout_s) as session:
            answer = session.start(
                self.model.interface, self.start, self.inputs.names, self.columns.outputs,
                stop_s=math.ceil(spec.stop.time_s * spec.rate_hz - 1e-6) / spec.rate_hz, tolerance=spec.fmu.tolerance,
            )  # fmt: skip
            frame = self._frame(0.0, answer)
            first_speed, frames = frame["velocity_m_s"], 0
            self._keep(frame, on_frame)
            while not self._ended(frame):
                time_s = frames / spec.rate_hz
                answer = session.step(time_s, step_s, self.inputs.values(frame, step_s))
                frames += 1
                reached_s = answer.time_s if answer.ended else frames / spec.rate_hz
                if reached_s > time_s:
                    frame = self._frame(reached_s, answer)
                    self._keep(frame, on_frame)
                if answer.ended:
                    events.append((reached_s, "the FMU ended the flight"))
                    break
                if progress is not None and reached_s % REPORT_S < step_s:
                    done = _done(frame, first_speed, spec)
                    progress(done, f"{frame['altitude_m'] / 1e3:.1f} km, {frame['velocity_m_s']:.0f} m/s")
        end_s = frame["time_s"]
        events += self.inputs.events(end_s)
        return Flight(self._conditions(), sorted(events, key=lambda e: e[0]), self.inputs.windows(end_s))

    def _frame(self, time_s: float, answer: Answer) -> Frame:
        """The columns of one answer.

        raises : RunError where a value is no number or cannot be; InputError where that is so from the start
        """
        kind = InputError if time_s == 0.0 else RunError
        for name, value in zip(self.columns.outputs, answer.values, strict=True):
            if not math.isfinite(value):
                raise RunError(f"{self.model}: output `{name}` is {value} at {time_s:.9g} s")
        frame = self.columns.frame(time_s, answer.values)
        problem = frame_problem(frame)
        if problem is not None:
            column, rule = problem
            raise kind(
                f"{self.model}: at {time_s:.9g} s {self.columns.told(column)} = {frame[column]:.6g}, which {rule}; "
                "check the mapping and its units"
            )
        if not LOWEST_M <= frame["altitude_m"] <= HIGHEST_M:
            raise kind(
                f"{self.model}: at {time_s:.9g} s the vehicle is at {frame['altitude_m']:.0f} m, outside the "
                f"atmosphere ({LOWEST_M:.0f} to {HIGHEST_M:.0f} m); give a stop"
            )
        return frame

    def _keep(self, frame: Frame, on_frame: OnFrame | None) -> None:
        row = np.array([frame.get(name, 0.0) for name in ROW])
        self.sampler.add(row)
        if on_frame is not None:
            on_frame(row[: len(FRAME)])

    def _ended(self, f: Frame) -> bool:
        mach = f["velocity_m_s"] / speed_of_sound_kernel(us76_kernel(f["altitude_m"])[0])
        return self.spec.stop.passed(f["time_s"], f["altitude_m"], f["velocity_m_s"], mach)

    def _conditions(self) -> Conditions:
        """The samples without the columns that nobody knows."""
        whole = self.sampler.conditions()
        return Conditions({n: v for n, v in whole.columns.items() if n not in self.columns.missing})


def fly(
    spec: TrajectorySpec, vehicle_dir: Path, *, on_frame: OnFrame | None = None, progress: Progress | None = None
) -> Flight:
    """Fly a scenario's trajectory with the FMU of spec.file, from 0 s on.

    on_frame : called at the start and after each communication step with the values of conditions.FRAME
    progress : called every 20 s of flight with the fraction of the flight done and a line of text
    raises   : InputError for an FMU or mapping that cannot be flown; RunError where the FMU fails, crashes, hangs, or
               gives what is no flight
    """
    return FmuFlight(spec, vehicle_dir).fly(on_frame, progress)


def problems_of(spec: TrajectorySpec, vehicle_dir: Path) -> Sequence[str]:
    """What is wrong between a scenario and its FMU, found without running the FMU."""
    try:
        FmuFlight(spec, vehicle_dir)
    except InputError as error:
        return error.problems
    return ()


def _done(frame: Frame, first_speed: float, spec: TrajectorySpec) -> float:
    last = spec.stop.velocity_m_s or 300.0 * (spec.stop.mach or 0.0)
    by_speed = (first_speed - frame["velocity_m_s"]) / max(first_speed - last, 1.0)
    return float(min(max(by_speed, frame["time_s"] / spec.stop.time_s, 0.0), 1.0))
