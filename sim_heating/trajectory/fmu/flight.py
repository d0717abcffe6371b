"""A flight from an FMU, stepped alongside: one communication step a frame, with schedules or guidance for its inputs.

The FMU runs in a separate process (`session`). [trajectory.fmu] defines the meaning of its variables (`columns`);
temperature, pressure, Mach and Reynolds number are derived here as for every source. An input is constant over a step:
a schedule is evaluated at the beginning of the step, a command is the value to be reached at its end. A schedule's
value at 0 s is already set during initialisation, so that outputs that depend on inputs alone are right in the first
frame.

Commands are those of the 3-DOF entry: guidance acts on the frame at the beginning of a step; manoeuvres start where
speed, extrapolated to the end of the step, passes their trigger.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from fmpy.simulation import settable_in_instantiated

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import FRAME, Conditions
from sim_heating.base.errors import InputError, RunError, error_context
from sim_heating.base.files import raise_problems, suggestion
from sim_heating.base.limits import frame_problem
from sim_heating.base.progress import Progress
from sim_heating.heating.atmosphere import HIGHEST_M, LOWEST_M, standard_sound_kernel
from sim_heating.trajectory import guidance as gd
from sim_heating.trajectory.flight import REPORT_S, ROW, Flight, OnFrame, Sampler, VehicleData, Window, frames_within
from sim_heating.trajectory.fmu.columns import ColumnsOfFmu, Frame, unit_of
from sim_heating.trajectory.fmu.model import FmuModel, Value, accepted_value, item_named, read_fmu
from sim_heating.trajectory.fmu.session import Answer, FmuSession
from sim_heating.trajectory.manoeuvres import ManoeuvreScript, commanded_variable
from sim_heating.trajectory.schedules import pack, scheduled
from sim_heating.trajectory.spec import FmuInput, TrajectorySpec


class FmuFlight:
    """A scenario's [trajectory] with its FMU, checked against the FMU's description before any of its code runs.

    raises : InputError, all problems of one kind at once
    """

    def __init__(self, spec: TrajectorySpec, vehicle: VehicleData) -> None:
        if spec.file is None:
            raise InputError('trajectory: source = "fmu" needs `file`, an FMU')
        self.spec = spec
        # All checks against the description come before any code of the FMU runs.
        self.model: FmuModel = read_fmu(Path(spec.file), spec.fmu.interface)
        self.columns = ColumnsOfFmu(self.model, spec, vehicle.directory)
        self.start = self.model.start_values(spec.fmu)
        self.inputs = InputsOfFmu(self.model, spec, vehicle.directory, self.columns.available)
        self.sampler = Sampler(spec.sample_s, vehicle.reference_length_m)
        self.frames: list[FloatArray] = []

    def fly(self, on_frame: OnFrame | None, progress: Progress | None) -> Flight:
        """Step the FMU by its communication step [s] until the flight ends."""
        spec, step_s = self.spec, 1.0 / self.spec.rate_hz
        events = [(0.0, note) for note in self.columns.notes]
        with FmuSession(self.model.path, spec.fmu.timeout_s) as session:
            # The stop time is rounded up to whole steps, since an FMU may refuse a step that crosses it.
            access = [self.model.access(self.model.variables[name]) for name in self.columns.outputs]
            answer = session.start(
                self.model.process_description,
                self._start_by_mode(),
                self.inputs.access,
                access,
                stop_s=math.ceil(spec.stop.time_s * spec.rate_hz - 1e-6) / spec.rate_hz,
                tolerance=spec.fmu.tolerance,
            )
            frame = self._frame(0.0, answer)
            first_speed, frames = frame["velocity_m_s"], 0
            self._store(frame, on_frame)
            while not self._ended(frame):
                # Frames are counted: a sum of steps would drift from the times that the FMU computes itself.
                time_s = frames / spec.rate_hz
                answer = session.step(time_s, step_s, self.inputs.values(frame, step_s))
                frames += 1
                reached_s = answer.time_s if answer.ended else frames / spec.rate_hz
                # An FMU that ends the flight at the beginning of a step has no new frame to give.
                if reached_s > time_s:
                    frame = self._frame(reached_s, answer)
                    self._store(frame, on_frame)
                if answer.ended:
                    events.append((reached_s, "the FMU ended the flight"))
                    break
                if progress is not None and reached_s % REPORT_S < step_s:
                    done = spec.stop.fraction_done(first_speed, frame["velocity_m_s"], frame["time_s"])
                    progress(done, f"{frame['altitude_m'] / 1e3:.1f} km, {frame['velocity_m_s']:.0f} m/s")
        end_s = frame["time_s"]
        events += self.inputs.events(end_s)
        windows = self.inputs.windows(end_s)
        flown = frames_within(self.frames, windows)
        return Flight(self._conditions(), sorted(events, key=lambda e: e[0]), windows, flown)

    def _start_by_mode(self) -> dict[str, list[tuple[str, int, Value]]]:
        """Start values by the mode of the FMU in which they are set, and in the second the scheduled inputs at 0 s."""
        by_mode: dict[str, list[tuple[str, int, Value]]] = {"instantiated": [], "initialization": []}
        for name, value in self.start.items():
            variable = self.model.variables[name]
            # Some variables may be set in one mode only.
            mode = "instantiated" if settable_in_instantiated(variable) else "initialization"
            by_mode[mode].append((*self.model.access(variable), value))
        for name, first in self.inputs.at_start.items():
            # A start value that the scenario gives for an input holds until the first step.
            if name not in self.start:
                kind, reference = self.model.access(self.model.variables[name])
                value = first if kind.startswith(("Real", "Float")) else round(first)
                by_mode["initialization"].append((kind, reference, value))
        return by_mode

    def _frame(self, time_s: float, answer: Answer) -> Frame:
        """The columns of one answer.

        raises : RunError where a value is not finite or impossible; InputError where it is impossible at the start
        """
        # An impossible value at the start is a wrong mapping or unit; a later one is a fault of the flight.
        kind = InputError if time_s == 0.0 else RunError
        for name, value in zip(self.columns.outputs, answer.values, strict=True):
            if not math.isfinite(value):
                raise RunError(f"{self.model}: output `{name}` is {value} at {time_s:.9g} s")
        frame = self.columns.frame(time_s, answer.values)
        problem = frame_problem(frame)
        if problem is not None:
            column, rule = problem
            raise kind(
                f"{self.model}: at {time_s:.9g} s {self.columns.source_text(column)} = {frame[column]:.6g}, "
                f"which {rule}; check the mapping and its units"
            )
        if not LOWEST_M <= frame["altitude_m"] <= HIGHEST_M:
            raise kind(
                f"{self.model}: at {time_s:.9g} s the vehicle is at {frame['altitude_m']:.0f} m, outside the "
                f"atmosphere ({LOWEST_M:.0f} to {HIGHEST_M:.0f} m); give a stop"
            )
        return frame

    def _store(self, frame: Frame, on_frame: OnFrame | None) -> None:
        # The sampler takes whole rows; columns that cannot be determined are removed again in `_conditions`.
        row = np.array([frame.get(name, 0.0) for name in ROW])
        self.sampler.add(row)
        if self.spec.manoeuvre:
            self.frames.append(row)
        if on_frame is not None:
            on_frame(row[: len(FRAME)])

    def _ended(self, f: Frame) -> bool:
        mach = f["velocity_m_s"] / standard_sound_kernel(f["altitude_m"])
        return self.spec.stop.passed(f["time_s"], f["altitude_m"], f["velocity_m_s"], mach)

    def _conditions(self) -> Conditions:
        """The samples without the columns that cannot be determined."""
        sampled = self.sampler.conditions()
        return Conditions({n: v for n, v in sampled.columns.items() if n not in self.columns.missing})


def fly(
    spec: TrajectorySpec, vehicle: VehicleData, *, on_frame: OnFrame | None = None, progress: Progress | None = None
) -> Flight:
    """Fly a scenario's trajectory with the FMU of spec.file, from the time 0 [s] on.

    on_frame : called at the start and after each communication step with the values of conditions.FRAME
    progress : called every 20 s of flight with the fraction of the flight done and a line of text
    raises   : InputError for an FMU or mapping that cannot be flown; RunError where the FMU fails, crashes, hangs, or
               returns impossible values
    """
    return FmuFlight(spec, vehicle).fly(on_frame, progress)


def fmu_problems(spec: TrajectorySpec, vehicle: VehicleData) -> Sequence[str]:
    """Contradictions between a scenario and its FMU, found without running the FMU."""
    try:
        FmuFlight(spec, vehicle)
    except InputError as error:
        return error.problems
    return ()


_FORCES = ("drag_m_s2", "lift_m_s2", "net_gravity_m_s2")
_DIRECTIONS = ("gamma_deg", "heading_deg", "latitude_deg", "longitude_deg", "alpha_deg")
OBSERVED_COLUMNS = ("altitude_m", "velocity_m_s", *_DIRECTIONS, "rho_kg_m3", *_FORCES)
"""Columns that guidance needs; the altitude rate is V sin(gamma) where it is not available."""


class Pilot:
    """Guidance and manoeuvres for an FMU, one call a frame."""

    def __init__(self, spec: TrajectorySpec, vehicle_dir: Path, available: set[str]) -> None:
        missing = [name for name in OBSERVED_COLUMNS if name not in available]
        if missing:
            raise InputError(f"[trajectory.fmu.columns]: guidance needs {', '.join(missing)}; map them")
        self.script = ManoeuvreScript(spec.manoeuvre)
        self.events: list[tuple[float, str]] = []
        self._block = gd.guidance_block(gd.resolve_guidance(spec.guidance, vehicle_dir))
        self._memory: np.ndarray | None = None
        self._before = (0.0, 0.0)

    def commands(self, f: Frame, step_s: float) -> Frame:
        """Commands [deg] to be reached at the end of the step that begins with a frame."""
        speed = f["velocity_m_s"]
        mach = speed / standard_sound_kernel(f["altitude_m"])
        if self._memory is None:
            self._memory = gd.first_memory(self._block, mach, speed)
            self._before = (speed, mach)
        sign, phase = self._memory[gd.SIGN], self._memory[gd.PHASE]
        gd.guidance_step(self._block, self._memory, _observation(f, speed, mach), step_s)
        self.events += gd.guidance_events(f["time_s"], sign, phase, self._memory)
        # Triggers are judged at the end of the step, where the commands take effect. Extrapolated as `point_mass` does,
        # so that an exported entry under this pilot flies the same bits.
        ahead = 2.0 * speed - self._before[0], 2.0 * mach - self._before[1]
        offsets = self.script.offsets(f["time_s"] + step_s, *ahead)
        self._before = (speed, mach)
        alpha = gd.clip(
            self._memory[gd.ALPHA_COMMAND] + offsets.alpha_deg, self._block[gd.ALPHA_LOW], self._block[gd.ALPHA_HIGH]
        )
        return {
            "alpha_deg": alpha,
            "bank_deg": float(self._memory[gd.BANK_COMMAND]),
            "beta_deg": offsets.beta_deg,
            "elevon_deg": offsets.elevon_deg,
            "bodyflap_deg": offsets.bodyflap_deg,
            "jets": gd.clip(offsets.jets, 0.0, 1.0),
        }


def _observation(f: Frame, speed: float, mach: float) -> np.ndarray:
    climb = f.get("altitude_rate_m_s", speed * math.sin(math.radians(f["gamma_deg"])))
    qbar = 0.5 * f["rho_kg_m3"] * speed * speed
    forces = [f["drag_m_s2"], f["lift_m_s2"], f["net_gravity_m_s2"], qbar]
    attitude = [f["alpha_deg"], f["heading_deg"], f["latitude_deg"], f["longitude_deg"]]
    return np.array([f["time_s"], f["altitude_m"], speed, mach, climb, *forces, *attitude])


class InputsOfFmu:
    """The inputs of an FMU, and their values frame by frame.

    access   : (type, value reference) of each input
    at_start : input with a schedule -> its value at 0 s
    raises   : InputError, all problems at once
    """

    def __init__(self, model: FmuModel, spec: TrajectorySpec, vehicle_dir: Path, available: set[str]) -> None:
        self.access: list[tuple[str, int]] = []
        self.at_start: dict[str, float] = {}
        self._values: list[Callable[[Frame, Frame], float]] = []
        problems: list[str] = []
        for name, declared in spec.fmu.inputs.items():
            source = declared if isinstance(declared, FmuInput) else FmuInput(command=declared)
            try:
                self._values.append(_input_value(model, name, source))
                self.access.append(model.access(model.variables[name]))
                if source.command is None:
                    self.at_start[model.variables[name].name] = self._values[-1]({"time_s": 0.0}, {})
            except InputError as error:
                problems += error.problems
        problems += _pilot_problems(model, spec) + _uncommanded_manoeuvres(model, spec)
        raise_problems(problems)
        self.pilot = Pilot(spec, vehicle_dir, available) if spec.fmu.commands else None

    def values(self, frame: Frame, step_s: float) -> list[float]:
        """Values over the step that begins with a frame, each in the unit of its variable ([deg], [m] ...)."""
        commands = {} if self.pilot is None else self.pilot.commands(frame, step_s)
        return [value(frame, commands) for value in self._values]

    def windows(self, end_s: float) -> list[Window]:
        """Windows [s] of the manoeuvres flown."""
        return [] if self.pilot is None else self.pilot.script.windows(end_s)

    def events(self, end_s: float) -> list[tuple[float, str]]:
        """Events of guidance and manoeuvres, with their times [s]."""
        return [] if self.pilot is None else [*self.pilot.events, *self.pilot.script.events(end_s)]


def _pilot_problems(model: FmuModel, spec: TrajectorySpec) -> list[str]:
    """Inputs of an FMU that its own `pilot` overrides, as in the exported 3-DOF entry."""
    # Such inputs are accepted by the FMU and change nothing: the manoeuvres would be reported as flown.
    pilot = model.variables.get("pilot")
    host = None if pilot is None else item_named(pilot, "host")
    if pilot is None or host is None or not spec.fmu.inputs:
        return []
    if float(spec.fmu.start.get("pilot", pilot.start) or 0) == host:
        return []
    return [f"[trajectory.fmu.inputs]: {model} ignores its inputs; set pilot = {host} in [trajectory.fmu.start]"]


def _uncommanded_manoeuvres(model: FmuModel, spec: TrajectorySpec) -> list[str]:
    """Manoeuvres whose command is not an input of the FMU."""
    # Without this check a manoeuvre had its window in the results while the FMU never received its command.
    unused = [
        (number, m.kind, commanded_variable(m))
        for number, m in enumerate(spec.manoeuvre, start=1)
        if commanded_variable(m) not in spec.fmu.commands
    ]
    inputs = [v.name for v in model.description.modelVariables if v.causality == "input"] if unused else []
    return [
        f"manoeuvre {number} ({kind}): no input takes its {variable}; name one in [trajectory.fmu.inputs]"
        + (suggestion(f"command.{variable}", inputs) if inputs else f"; {model} has no inputs")
        for number, kind, variable in unused
    ]


def _input_value(model: FmuModel, name: str, source: FmuInput) -> Callable[[Frame, Frame], float]:
    """A function that gives one input from a frame and the commands, in the FMU's unit."""
    where = f"[trajectory.fmu.inputs], `{name}`"
    variable = model.number(name, where)
    if variable.causality != "input":
        raise InputError(f"{where}: it is a {variable.causality} of {model}, not an input")
    if source.command is None:
        with error_context(where):
            for _, value in source.schedule or ():
                accepted_value(variable, value)
        block = pack((), [source.schedule or ()])
        if source.unit is not None:
            model.scale(variable, source.unit, where)
        return lambda frame, _: scheduled(block, 0, frame["time_s"])
    command = source.command
    to_command = model.conversion(variable, source.unit, unit_of(command), where)
    return lambda _, commands: to_command.inverse(commands[command])
