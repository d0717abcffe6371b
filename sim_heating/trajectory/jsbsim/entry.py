"""Entry in JSBSim with six degrees of freedom: guidance and manoeuvres command, JSBSim flies, samples are stored.

Each frame is one JSBSim frame. Commands are renewed COMMAND_HZ times a second: guidance, the same as the 3-DOF
entry's, gives angle of attack and bank, the manoeuvres add their offsets, and the vehicle's attitude control follows
them.

Source: Berndt (2004), "JSBSim: An Open Source Flight Dynamics Model in C++", AIAA 2004-4923.
"""

from __future__ import annotations

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import FRAME
from sim_heating.base.errors import InputError, RunError, error_context
from sim_heating.base.files import display_path
from sim_heating.base.progress import Progress
from sim_heating.heating.atmosphere import standard_sound_kernel
from sim_heating.trajectory import flight
from sim_heating.trajectory.aero import Aero, flown_aero
from sim_heating.trajectory.flight import Flight, OnFrame, VehicleData
from sim_heating.trajectory.guidance import ALPHA_COMMAND, EntryGuidance, Observation, first_memory, resolve_guidance
from sim_heating.trajectory.jsbsim.host import InitialState, open_vehicle
from sim_heating.trajectory.jsbsim.model import control_path
from sim_heating.trajectory.jsbsim.pilot import Commands, Observer
from sim_heating.trajectory.manoeuvres import ManoeuvreScript
from sim_heating.trajectory.spec import TrajectorySpec

COMMAND_HZ = 10.0
"""Greatest rate of commands [1/s]; lags of 0.3 s and more in the attitude control smooth their steps."""

LOST_DEG = 20.0
"""Sideslip, or error of the angle of attack, from which the vehicle is out of control [deg]."""

ENTRY_INTERFACE_M = 122.0e3
SKIP_OUT_M = 5.0e3
"""Climb above the entry interface, and above the start, that counts as skipping out [m]."""


def fly(
    spec: TrajectorySpec, vehicle: VehicleData, *, on_frame: OnFrame | None = None, progress: Progress | None = None
) -> Flight:
    """Fly a scenario's trajectory in JSBSim.

    on_frame : called at the start and after each frame with the values of conditions.FRAME; the array is reused
    progress : called every 20 s of flight with the fraction of the flight done and a line of text
    raises   : InputError for a scenario or vehicle that cannot be flown; RunError with time and state where the
               vehicle goes out of control, skips out, hits the ground, or its state is not finite
    """
    entry = JSBSimEntry(spec, vehicle)
    if on_frame is not None:
        on_frame(entry.host.read_frame())
    next_report_s = flight.REPORT_S
    while not entry.ended():
        entry.command()
        for _ in range(entry.frames_a_command):
            entry.step(on_frame)
        if progress is not None and entry.host.time_s >= next_report_s:
            progress(entry.done(), f"{entry.observed.altitude_m / 1e3:.1f} km, {entry.observed.velocity_m_s:.0f} m/s")
            next_report_s += flight.REPORT_S
    return entry.flight()


class JSBSimEntry:
    """One flight: host, guidance, manoeuvres and samples; `fly` calls `ended`, `command` and `step` in turn.

    host     : the JSBSimHost, for properties to read or publish
    observed : latest observation of guidance
    """

    def __init__(self, spec: TrajectorySpec, vehicle: VehicleData) -> None:
        if spec.initial is None:
            raise InputError("trajectory: a JSBSim entry needs [trajectory.initial]")
        guidance = resolve_guidance(spec.guidance, vehicle.directory)
        aero = flown_aero(spec, vehicle.directory)
        self.spec = spec
        self.host = open_vehicle(vehicle.directory, aero, rate_hz=spec.rate_hz, dispersions=spec.dispersions)
        self.frames_a_command = max(round(spec.rate_hz / COMMAND_HZ), 1)
        self._initial = spec.initial
        self._guidance = EntryGuidance(guidance, spec.initial.bank_deg)
        self._script = ManoeuvreScript(spec.manoeuvre)
        with error_context(display_path(control_path(vehicle.directory))):  # whose properties these two need
            self._commands = Commands(self.host, aero, guidance, spec.vehicle)
            self._observer = Observer(self.host)
        self._sampler = flight.Sampler(spec.sample_s, vehicle.reference_length_m)
        self._frames: list[FloatArray] = []
        self._in_manoeuvre = False
        self._frames_a_sample = whole_frames(spec.sample_s * spec.rate_hz)
        self._start(aero)

    def _start(self, aero: Aero) -> None:
        initial = self._initial
        V = initial.velocity_m_s
        mach = V / standard_sound_kernel(initial.altitude_m)
        alpha = float(first_memory(self._guidance.block, mach, V)[ALPHA_COMMAND])
        elevon = aero.trim_elevon_deg(mach, alpha, self._commands.bodyflap_deg(mach, V))
        # Commands before the start: JSBSim evaluates the attitude control, lags included, when it initialises the
        # state.
        self._commands.initialise(alpha, initial.bank_deg, elevon, mach, V)
        self.host.start(InitialState(**initial.model_dump(), alpha_deg=alpha))
        self._sampler.add(self._observer.row())
        self.observed: Observation = self._observer.observe()

    def ended(self) -> bool:
        """Whether the flight has ended.

        raises : RunError where the vehicle is lost
        """
        self.observed = observed = self._observer.observe()
        # The stop is judged first: what a vehicle does beyond it is not a failure of the flight.
        if self.spec.stop.passed(observed.time_s, observed.altitude_m, observed.velocity_m_s, observed.mach):
            return True
        self._check_under_control()
        return False

    def _check_under_control(self) -> None:
        highest = max(self._initial.altitude_m, ENTRY_INTERFACE_M) + SKIP_OUT_M
        # `not <` and not `>=`: an attitude that is NaN counts as lost.
        if not self._observer.attitude_error_deg() < LOST_DEG:
            raise RunError(f"JSBSim: the vehicle went out of control {self.host.describe()}")
        if self.observed.altitude_m > highest:
            raise RunError(f"JSBSim: the vehicle skipped out {self.host.describe()}; start slower or steeper")
        if self.observed.altitude_m < 0.0:
            raise RunError(f"JSBSim: the vehicle hit the ground {self.host.describe()}; give a stop before that")

    def command(self) -> None:
        """Renew the commands [deg] from the latest observation."""
        observed = self.observed
        alpha_deg, bank_deg = self._guidance.command(observed)
        offsets = self._script.offsets(observed.time_s, observed.velocity_m_s, observed.mach)
        self._commands.write(alpha_deg, bank_deg, offsets, observed.mach, observed.velocity_m_s)
        self._in_manoeuvre = self._script.active(observed.time_s, flight.AFTER_MANOEUVRE_S)

    def step(self, on_frame: OnFrame | None = None) -> None:
        """Advance one frame [s] and store a sample when it is due."""
        host = self.host
        host.step()
        if on_frame is not None:
            on_frame(host.read_frame())
        if self._in_manoeuvre:
            self._frames.append(host.read_frame(np.empty(len(FRAME))))
        # Commands change the flight at their own rate, and the sampler sees what they do between samples.
        if host.frames % self._frames_a_sample == 0 or host.frames % self.frames_a_command == 0:
            self._sampler.add(self._observer.row())

    def done(self) -> float:
        """Fraction of the flight done [-], 0 to 1."""
        first, now = self._initial.velocity_m_s, self.observed
        return self.spec.stop.fraction_done(first, now.velocity_m_s, now.time_s)

    def flight(self) -> Flight:
        """Samples ([s], [m], [m/s], [deg] ...), events and manoeuvres so far."""
        end_s = self.host.time_s
        events = [*self._guidance.events, *self._script.events(end_s)]
        windows = self._script.windows(end_s)
        frames = flight.frames_within(self._frames, windows)
        return Flight(self._sampler.conditions(), sorted(events, key=lambda e: e[0]), windows, frames)


def whole_frames(frames: float) -> int:
    """Frames between samples where that is a whole number, else 1: the sampler interpolates between frames."""
    nearest = round(frames)
    return nearest if abs(frames - nearest) < 1e-6 else 1
