"""What an FMU's inputs are given: schedules over time, or the commands of guidance and manoeuvres.

Commands are those of the 3-DOF entry: guidance acts on the frame at the beginning of a step, manoeuvres start where
speed, extrapolated to its end, passes their trigger, and both are to be reached at its end.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from sim_heating.atmosphere import speed_of_sound_kernel, us76_kernel
from sim_heating.errors import InputError, told_of
from sim_heating.files import suggestion
from sim_heating.trajectory import guidance as gd
from sim_heating.trajectory.flight import Window
from sim_heating.trajectory.fmu_columns import Frame, unit_of
from sim_heating.trajectory.fmu_model import FmuModel
from sim_heating.trajectory.fmu_values import fitting, item_named
from sim_heating.trajectory.manoeuvres import ManoeuvreScript, moved
from sim_heating.trajectory.schedules import pack, scheduled
from sim_heating.trajectory.spec import FmuInput, TrajectorySpec

SEEN = (
    "altitude_m", "velocity_m_s", "gamma_deg", "heading_deg", "latitude_deg", "longitude_deg", "alpha_deg",
    "rho_kg_m3", "drag_m_s2", "lift_m_s2", "net_gravity_m_s2",
)  # fmt: skip
"""Columns that guidance needs; the altitude rate is V sin(gamma) where it is not given."""


class Pilot:
    """Guidance and manoeuvres beside an FMU, one call a frame."""

    def __init__(self, spec: TrajectorySpec, vehicle_dir: Path, have: set[str]) -> None:
        missing = [name for name in SEEN if name not in have]
        if missing:
            raise InputError(f"[trajectory.fmu.columns]: guidance needs {', '.join(missing)}; map them")
        self.script = ManoeuvreScript(spec.manoeuvre)
        self.events: list[tuple[float, str]] = []
        self._block = gd.guidance_block(gd.resolve_guidance(spec.guidance, vehicle_dir))
        self._memory: np.ndarray | None = None
        self._before = (0.0, 0.0)

    def commands(self, f: Frame, step_s: float) -> Frame:
        """Commands to be reached at the end of the step that begins with a frame."""
        speed = f["velocity_m_s"]
        mach = speed / speed_of_sound_kernel(us76_kernel(f["altitude_m"])[0])
        if self._memory is None:
            self._memory = gd.first_memory(self._block, mach, speed)
            self._before = (speed, mach)
        sign, phase = self._memory[gd.SIGN], self._memory[gd.PHASE]
        gd.guide(self._block, self._memory, _seen(f, speed, mach), step_s)
        self.events += gd.guidance_events(f["time_s"], sign, phase, self._memory)
        ahead = 2.0 * speed - self._before[0], 2.0 * mach - self._before[1]
        offsets = self.script.offsets(f["time_s"] + step_s, *ahead)
        self._before = (speed, mach)
        alpha = gd.clipped(
            self._memory[gd.ALPHA_COMMAND] + offsets.alpha_deg, self._block[gd.ALPHA_LOW], self._block[gd.ALPHA_HIGH]
        )
        return {
            "alpha_deg": alpha,
            "bank_deg": float(self._memory[gd.BANK_COMMAND]),
            "beta_deg": offsets.beta_deg,
            "elevon_deg": offsets.elevon_deg,
            "bodyflap_deg": offsets.bodyflap_deg,
            "jets": gd.clipped(offsets.jets, 0.0, 1.0),
        }


def _seen(f: Frame, speed: float, mach: float) -> np.ndarray:
    climb = f.get("altitude_rate_m_s", speed * math.sin(math.radians(f["gamma_deg"])))
    qbar = 0.5 * f["rho_kg_m3"] * speed * speed
    return np.array([
        f["time_s"], f["altitude_m"], speed, mach, climb, f["drag_m_s2"], f["lift_m_s2"], f["net_gravity_m_s2"], qbar,
        f["alpha_deg"], f["heading_deg"], f["latitude_deg"], f["longitude_deg"],
    ])  # fmt: skip


class InputsOfFmu:
    """The inputs of a flight's FMU, by name, and their values frame by frame.

    raises : InputError, all problems at once
    """

    def __init__(self, model: FmuModel, spec: TrajectorySpec, vehicle_dir: Path, have: set[str]) -> None:
        self.names: list[str] = []
        self._values: list[Callable[[Frame, Frame], float]] = []
        problems: list[str] = []
        for name, given in spec.fmu.inputs.items():
            whole = given if isinstance(given, FmuInput) else FmuInput(command=given)
            try:
                self._values.append(_value(model, name, whole))
                self.names.append(name)
            except InputError as error:
                problems += error.problems
        problems += _unheard(model, spec) + _unmoved(model, spec)
        if problems:
            raise InputError(*problems)
        self.pilot = Pilot(spec, vehicle_dir, have) if spec.fmu.commands else None

    def values(self, frame: Frame, step_s: float) -> list[float]:
        """Values over the step that begins with a frame."""
        commands = {} if self.pilot is None else self.pilot.commands(frame, step_s)
        return [value(frame, commands) for value in self._values]

    def windows(self, end_s: float) -> list[Window]:
        """Manoeuvres flown."""
        return [] if self.pilot is None else self.pilot.script.windows(end_s)

    def events(self, end_s: float) -> list[tuple[float, str]]:
        """What guidance and manoeuvres did."""
        return [] if self.pilot is None else [*self.pilot.events, *self.pilot.script.events(end_s)]


def _unheard(model: FmuModel, spec: TrajectorySpec) -> list[str]:
    """What is wrong with inputs of an FMU whose own `pilot` commands, as the exported 3-DOF entry has one."""
    pilot = model.variables.get("pilot")
    host = None if pilot is None else item_named(pilot, "host")
    if pilot is None or host is None or not spec.fmu.inputs:
        return []
    if float(spec.fmu.start.get("pilot", pilot.start) or 0) == host:
        return []
    return [f"[trajectory.fmu.inputs]: {model} looks at its inputs only with pilot = {host} in [trajectory.fmu.start]"]


def _unmoved(model: FmuModel, spec: TrajectorySpec) -> list[str]:
    """Manoeuvres that no input of an FMU takes."""
    inputs = [v.name for v in model.description.modelVariables if v.causality == "input"]
    return [
        f"manoeuvre {number} ({m.kind}): no input takes its {moved(m)}; name one in [trajectory.fmu.inputs]. "
        + (suggestion(f"command.{moved(m)}", inputs) if inputs else f"{model} has no inputs")
        for number, m in enumerate(spec.manoeuvre, start=1)
        if moved(m) not in spec.fmu.commands
    ]


def _value(model: FmuModel, name: str, given: FmuInput) -> Callable[[Frame, Frame], float]:
    """How one input is made of a frame and the commands, in the FMU's unit."""
    where = f"[trajectory.fmu.inputs], `{name}`"
    variable = model.number(name, where)
    if variable.causality != "input":
        raise InputError(f"{where}: it is a {variable.causality} of {model}, not an input")
    if given.command is None:
        with told_of(where):
            for _, value in given.schedule or ():
                fitting(variable, value)
        block = pack((), [given.schedule or ()])
        if given.unit is not None:
            model.scale(variable, given.unit, where)
        return lambda frame, _: scheduled(block, 0, frame["time_s"])
    command = given.command
    to_command = model.conversion(variable, given.unit, unit_of(command), where)
    return lambda _, commands: to_command.back(commands[command])
