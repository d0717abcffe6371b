"""Built-in 3-DOF entry: a scenario flown with the point mass of `point_mass` and the tables of `trimmed_aero`.

Attitude has no dynamics: angle of attack, bank and sideslip are as commanded, so that a manoeuvre with `alpha = "free"`
is refused. Continuum lift and drag throughout; above 95 km (Knudsen number on
the length above 0.003) drag is low. Against the 6-DOF flight of the same guidance altitude agrees within 100 m.

Source: docs/theory/equations.md, equations 35 and 36.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import FRAME
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files import display_path
from sim_heating.base.progress import Progress
from sim_heating.heating.atmosphere import HIGHEST_M
from sim_heating.trajectory import guidance as gd
from sim_heating.trajectory import manoeuvres as mv
from sim_heating.trajectory import point_mass as pm
from sim_heating.trajectory.aero import Aero, check_alpha_schedule, flown_aero
from sim_heating.trajectory.flight import REPORT_S, ROW, Flight, OnFrame, Sampler, VehicleData, frames_within
from sim_heating.trajectory.schedules import pack
from sim_heating.trajectory.spec import Guidance, Initial, TrajectorySpec
from sim_heating.trajectory.trimmed_aero import aero_block, low_speed_rows

DEEPEST_M = -20.0
"""Altitude below which a vehicle has hit the ground [m]; a stop at 0 m is overshot by less within a frame."""
FRAME_LENGTH = len(FRAME)


def flight_block(spec: TrajectorySpec, aero: Aero, guidance: Guidance) -> FloatArray:
    """Planet, vehicle, stop [s], [m/s], [m] and dispersions of a flight in one block, see `schedules`.

    Source: NIMA TR8350.2, tables 3.1 and 3.3, for the planet.

    Source: docs/theory/equations.md, equations 35 and 36.
    """
    file, stop, state = aero.file, spec.stop, spec.vehicle
    on_speed = state.bodyflap_deg is not None and state.bodyflap_against == "velocity_m_s"
    # A stop condition that is not given takes a value that is never passed: speed and Mach 0, altitude minus infinity.
    trim = [aero.arm, aero.cm_shift, *file.cm_shift.mach, *file.elevon.range_deg]
    planet = [pm.WGS84_MU_M3_S2, pm.WGS84_J2, pm.WGS84_ROTATION_RAD_S, pm.WGS84_RADIUS_M, pm.WGS84_FLATTENING]
    body = [aero.mass_kg, file.reference.area_m2, *file.bodyflap.range_deg, float(on_speed), file.lateral.CY_beta_rad]
    lowest_m = -np.inf if stop.altitude_m is None else stop.altitude_m
    scalars = (*trim, *planet, *body, stop.time_s, stop.mach or 0.0, stop.velocity_m_s or 0.0, lowest_m)
    flap = state.bodyflap_deg or aero.bodyflap_schedule(guidance.alpha_deg, guidance.alpha_against)
    return pack(scalars, [*spec.dispersions.schedules, flap])


def initial_numbers(initial: Initial) -> FloatArray:
    """The initial state [m], [m/s], [deg] in the order of `point_mass.INITIAL`.

    Source: docs/theory/equations.md, equations 35 and 36.
    """
    return np.array(
        [
            initial.altitude_m,
            initial.velocity_m_s,
            initial.gamma_deg,
            initial.heading_deg,
            initial.latitude_deg,
            initial.longitude_deg,
        ]
    )


def first_state(initial: Initial, flight: FloatArray, block: FloatArray, manoeuvres: int) -> FloatArray:
    """State at 0 s [s], [m], [m/s], [deg], of `point_mass.first_state_kernel`.

    Source: docs/theory/equations.md, section 6.
    """
    state = np.empty(pm.STARTED + manoeuvres)
    pm.first_state_kernel(initial_numbers(initial), flight, block, manoeuvres, state)
    return state


class Entry:
    """One 3-DOF flight: its state and blocks, advanced by a number of frames at a time."""

    def __init__(self, spec: TrajectorySpec, vehicle_dir: Path) -> None:
        if spec.initial is None:
            raise InputError("trajectory: the 3-DOF entry needs [trajectory.initial]")
        aero = flown_aero(spec, vehicle_dir)
        self.dt_s = 1.0 / spec.rate_hz
        self.tables = aero_block(aero, low_speed_rows(vehicle_dir, aero.basic.mach[0]))
        guidance = gd.resolve_guidance(spec.guidance, vehicle_dir)
        check_alpha_schedule(aero, guidance, display_path(vehicle_dir))
        self.flight = flight_block(spec, aero, guidance)
        self.block = gd.guidance_block(guidance, spec.initial.bank_deg)
        self.script = mv.compile_script(spec.manoeuvre)
        self.state = first_state(spec.initial, self.flight, self.block, len(spec.manoeuvre))
        self.work = np.zeros(pm.WORK)

    def run(self, frames: int) -> tuple[FloatArray, bool]:
        """The next frames (at most `frames`, len(ROW); [s], [m], [m/s], [deg] ...), and whether the flight ended with
        the last of them.

        Source: docs/theory/equations.md, equations 35 and 36.
        """
        rows = np.empty((frames, len(ROW)))
        filled, ended = pm.run_kernel(
            self.state, self.flight, self.block, self.script, self.tables, self.dt_s, self.work, rows
        )
        return rows[:filled], ended


def fly(
    spec: TrajectorySpec, vehicle: VehicleData, *, on_frame: OnFrame | None = None, progress: Progress | None = None
) -> Flight:
    """Fly a scenario's trajectory with the built-in 3-DOF entry, frames of spec.dt_s [s].

    on_frame : called after each frame with its values in the order of conditions.FRAME; the array is reused
    progress : called every 20 s of flight with the fraction of the flight done and a line of text
    raises   : InputError for a scenario or vehicle that cannot be flown, RunError where the flight leaves the
               atmosphere model or is not finite

    Source: docs/theory/equations.md, equations 35 and 36.
    """
    entry = Entry(spec, vehicle.directory)
    sampler = Sampler(spec.sample_s, vehicle.reference_length_m)
    events: list[tuple[float, str]] = []
    every: list[FloatArray] = []
    # A call of the kernel flies one second, so that events are known to the second without a check at every frame.
    first_speed, frames, ended = float(entry.state[pm.LAST_SPEED]), max(round(spec.rate_hz), 1), False
    while not ended:
        memory = entry.state[pm.MEMORY : pm.STARTED].copy()
        rows, ended = entry.run(frames)
        # Before the rows are sampled: a value that is not finite would spread through the interpolation.
        _check_rows(rows)
        for row in rows:
            sampler.add(row)
            if spec.manoeuvre:
                every.append(row[:FRAME_LENGTH].copy())
            if on_frame is not None:
                on_frame(row[:FRAME_LENGTH])
        now = entry.state[pm.MEMORY : pm.STARTED]
        events += gd.guidance_events(float(rows[-1, 0]), memory[gd.SIGN], memory[gd.PHASE], now)
        if progress is not None and rows[-1, 0] % REPORT_S < 1.0:
            done = spec.stop.fraction_done(first_speed, rows[-1, 2], rows[-1, 0])
            progress(done, f"{rows[-1, 1] / 1e3:.1f} km, {rows[-1, 2]:.0f} m/s")
    end_s = float(rows[-1, 0])
    windows = mv.manoeuvre_windows(spec.manoeuvre, entry.state[pm.STARTED :], end_s)
    events += mv.manoeuvre_events(spec.manoeuvre, entry.state[pm.STARTED :], end_s)
    return Flight(sampler.conditions(), sorted(events, key=lambda e: e[0]), windows, frames_within(every, windows))


def _check_rows(rows: FloatArray) -> None:
    """raises : RunError where a frame is not finite or lies outside the atmosphere model"""
    bad = ~np.all(np.isfinite(rows), axis=1) | (rows[:, 1] > HIGHEST_M) | (rows[:, 1] < DEEPEST_M)
    if np.any(bad):
        row = rows[int(np.flatnonzero(bad)[0])]
        raise RunError(
            f"3-DOF entry: at {row[0]:.1f} s the vehicle is at {row[1]:.0f} m with {row[2]:.0f} m/s, outside the "
            f"atmosphere (0 to {HIGHEST_M:.0f} m); check the initial speed and path angle, or end the flight earlier by"
            " `mach`, `velocity_m_s`, `altitude_m` or `time_s` in [trajectory.stop]"
        )
