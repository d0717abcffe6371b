"""Entry in JSBSim with six degrees of freedom: guidance and manoeuvres command, JSBSim flies, samples are kept.

Each frame is one JSBSim frame. Commands are renewed COMMAND_HZ times a second: guidance, the same as the 3-DOF
entry's, gives angle of attack and bank, the manoeuvres add their offsets, and the vehicle's attitude control does the
rest.
"""

from __future__ import annotations

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.progress import Progress
from sim_heating.heating.atmosphere import speed_of_sound_kernel, us76_kernel
from sim_heating.trajectory.aero import Aero, flown_aero
from sim_heating.trajectory.flight import Flight, OnFrame, Sampler, VehicleData
from sim_heating.trajectory.guidance import ALPHA_COMMAND, EntryGuidance, Observation, first_memory, resolve_guidance
from sim_heating.trajectory.jsbsim.host import InitialState, open_vehicle
from sim_heating.trajectory.jsbsim.pilot import Commands, Observer
from sim_heating.trajectory.manoeuvres import ManoeuvreScript
from sim_heating.trajectory.spec import TrajectorySpec

COMMAND_HZ = 10.0
"""Commands a second at most; they pass lags of 0.3 s and more in the attitude control, so that steps do not show."""

LOST_DEG = 20.0
"""Sideslip, or error of the angle of attack, at which the vehicle counts as out of control."""

ENTRY_INTERFACE_M = 122.0e3
SKIPPED_M = 5.0e3
"""A vehicle that climbs so far above the entry interface, and above where it began, has skipped out."""

REPORT_S = 20.0


def fly(
    spec: TrajectorySpec, vehicle: VehicleData, *, on_frame: OnFrame | None = None, progress: Progress | None = None
) -> Flight:
    """Fly a scenario's trajectory in JSBSim.

    on_frame : called at the start and after each frame with the values of conditions.FRAME; the array is reused
    progress : called every 20 s of flight with the fraction of the flight done and a line of text
    raises   : InputError for a scenario or vehicle that cannot be flown; RunError with time and state where the
               vehicle goes out of control, skips out, hits the ground, or is no number
    """
    entry = JSBSimEntry(spec, vehicle)
    if on_frame is not None:
        on_frame(entry.host.read_frame())
    next_report_s = REPORT_S
    while not entry.ended():
        entry.command()
        for _ in range(entry.frames_a_command):
            entry.step(on_frame)
        if progress is not None and entry.host.time_s >= next_report_s:
            progress(entry.done(), f"{entry.seen.altitude_m / 1e3:.1f} km, {entry.seen.velocity_m_s:.0f} m/s")
            next_report_s += REPORT_S
    return entry.flight()


class JSBSimEntry:
    """One flight: host, guidance, manoeuvres and samples; `fly` asks it in turn whether it ended, to command, to step.

    host     : the JSBSimHost, for properties to read or publish
    seen     : what guidance saw last
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
        self._commands = Commands(self.host, aero, guidance, spec.vehicle)
        self._observer = Observer(self.host)
        self._sampler = Sampler(spec.sample_s, vehicle.reference_length_m)
        self._frames_a_sample = whole_frames(spec.sample_s * spec.rate_hz)
        self._start(aero)

    def _start(self, aero: Aero) -> None:
        initial = self._initial
        V = initial.velocity_m_s
        mach = V / speed_of_sound_kernel(us76_kernel(initial.altitude_m)[0])
        alpha = float(first_memory(self._guidance.block, mach, V)[ALPHA_COMMAND])
        elevon = aero.trim_elevon_deg(mach, alpha, self._commands.bodyflap_deg(mach, V))
        self._commands.first(alpha, initial.bank_deg, elevon, mach, V)
        self.host.start(InitialState(**initial.model_dump(), alpha_deg=alpha))
        self._sampler.add(self._observer.row())
        self.seen: Observation = self._observer.observe()

    def ended(self) -> bool:
        """Whether the flight is at its end.

        raises : RunError where its state is none to go on from
        """
        self.seen = seen = self._observer.observe()
        if self.spec.stop.passed(seen.time_s, seen.altitude_m, seen.velocity_m_s, seen.mach):
            return True
        self._refuse_lost()
        return False

    def _refuse_lost(self) -> None:
        highest = max(self._initial.altitude_m, ENTRY_INTERFACE_M) + SKIPPED_M
        if not self._observer.attitude_error_deg() < LOST_DEG:
            raise RunError(f"JSBSim: the vehicle went out of control {self.host.describe()}")
        if self.seen.altitude_m > highest:
            raise RunError(f"JSBSim: the vehicle skipped out {self.host.describe()}; start slower or steeper")
        if self.seen.altitude_m < 0.0:
            raise RunError(f"JSBSim: the vehicle hit the ground {self.host.describe()}; give a stop before that")

    def command(self) -> None:
        """Renew the commands from the state last seen."""
        seen = self.seen
        alpha_deg, bank_deg = self._guidance.command(seen)
        offsets = self._script.offsets(seen.time_s, seen.velocity_m_s, seen.mach)
        self._commands.write(alpha_deg, bank_deg, offsets, seen.mach, seen.velocity_m_s)

    def step(self, on_frame: OnFrame | None = None) -> None:
        """One frame; a sample is kept where its time has come."""
        host = self.host
        host.step()
        if on_frame is not None:
            on_frame(host.read_frame())
        if host.frames % self._frames_a_sample == 0:
            self._sampler.add(self._observer.row())

    def done(self) -> float:
        """Fraction of the flight done, by speed lost or by time."""
        stop = self.spec.stop
        last = stop.velocity_m_s or 300.0 * (stop.mach or 0.0)
        by_speed = (self._initial.velocity_m_s - self.seen.velocity_m_s) / max(self._initial.velocity_m_s - last, 1.0)
        return min(max(by_speed, self.seen.time_s / stop.time_s, 0.0), 1.0)

    def flight(self) -> Flight:
        """Samples, events and manoeuvres so far."""
        end_s = self.host.time_s
        events = [*self._guidance.events, *self._script.events(end_s)]
        return Flight(self._sampler.conditions(), sorted(events, key=lambda e: e[0]), self._script.windows(end_s))


def whole_frames(frames: float) -> int:
    """Frames between samples where that is a whole number, else 1: the sampler takes what lies between two frames."""
    nearest = round(frames)
    return nearest if abs(frames - nearest) < 1e-6 else 1
