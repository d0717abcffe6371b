"""Check of a scenario beyond its own file: the effects compile, the files that it names are read, triggers are met.

A scenario of JSBSim is flown with the built-in 3-DOF entry, which follows the same guidance within 100 m of altitude
and takes a fraction of a second. An FMU is opened and not flown: it is a program of its own.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sim_heating.base.errors import InputError, RunError, error_context
from sim_heating.base.files import display_path, raise_problems
from sim_heating.heating.effects import Effect
from sim_heating.heating.effects.compiled import compiled_kernel
from sim_heating.inputs.scenario import Scenario
from sim_heating.inputs.vehicle import Vehicle
from sim_heating.trajectory import entry3dof, recorded
from sim_heating.trajectory.aero import check_alpha_schedule, load_aero
from sim_heating.trajectory.flight import Flight, VehicleData, check_samples
from sim_heating.trajectory.guidance import load_guidance
from sim_heating.trajectory.manoeuvres import NOT_FLOWN, trigger_text
from sim_heating.trajectory.spec import TrajectorySpec

FRAME_RATE_HZ = 4.0
"""Frames a second of the flight that checks triggers."""
FLOWN = ("jsbsim", "entry-3dof")
"""Sources that the built-in entry can fly."""


def check_scenario(scenario: Scenario) -> None:
    """Check what a scenario needs when it is run, without running it.

    raises : InputError where a user-defined effect cannot be compiled, a recorded trajectory cannot be used, the flight
             leaves the atmosphere, or a manoeuvre's trigger is never met
    """
    points = [scenario.vehicle.control_point(name) for name in scenario.names]
    check_effects([use.effect for p in points for use in (*p.effects, *scenario.effects(p.name, truth=True))])
    spec, where = scenario.declared.trajectory, f"{display_path(scenario.path)}, [trajectory]"
    if spec.source == "recorded":
        vehicle = scenario.vehicle
        recorded.read_conditions(Path(str(spec.file)), vehicle.reference_length_m, vehicle.surfaces, spec.fields)
    elif spec.source in FLOWN:
        check_triggers(spec, scenario.vehicle, where)


def check_effects(effects: list[Effect]) -> None:
    """Compile the user-defined ones of some effects; the package's own are known to compile.

    raises : InputError with file and line where one cannot be compiled
    """
    problems: list[str] = []
    for effect in dict.fromkeys(e for e in effects if e.kernel is not None and not e.built_in):
        try:
            compiled_kernel(effect)
        except InputError as error:
            problems += error.problems
    raise_problems(problems)


def check_vehicle(vehicle: Vehicle) -> None:
    """Check what a vehicle needs when it flies, as far as it has it: aerodynamics, guidance, effects.

    raises : InputError where a table or a key of them is wrong, or a user-defined effect cannot be compiled
    """
    problems: list[str] = []
    loaded: dict[str, Any] = {}
    for file, read in (("aero/aero.toml", load_aero), ("guidance.toml", load_guidance)):
        try:
            if (vehicle.directory / file).is_file():
                loaded[file] = read(vehicle.directory)
        except InputError as error:
            problems += error.problems
    raise_problems(problems)
    if len(loaded) == 2:
        check_alpha_schedule(loaded["aero/aero.toml"], loaded["guidance.toml"], display_path(vehicle.directory))
    check_effects([use.effect for point in vehicle.control_points.values() for use in point.effects])


def check_triggers(spec: TrajectorySpec, vehicle: VehicleData, where: str) -> None:
    """Fly a trajectory in three degrees of freedom and check that each of its manoeuvres begins.

    where  : file and table, for messages
    raises : InputError where the flight fails, or with one line for each trigger that is never met
    """
    light = spec.model_copy(
        update={
            "source": "entry-3dof",
            "rate_hz": FRAME_RATE_HZ,
            "sample_s": max(spec.sample_s, 1.0 / FRAME_RATE_HZ),
        }
    )
    try:
        with error_context(where):
            flight = entry3dof.fly(light, vehicle)
            check_samples(flight, spec.sample_s)
    except RunError as error:
        raise InputError(f"{where}: {error}") from None
    events = {text for _, text in flight.events}
    started = [(i, f"{m.kind} at {trigger_text(m)}: {NOT_FLOWN}") for i, m in enumerate(spec.manoeuvre, start=1)]
    flown = f"the flight goes {_range_flown(flight)}"
    raise_problems([f"{where}, manoeuvre {i}: {text}; {flown}" for i, text in started if text in events])


def _range_flown(flight: Flight) -> str:
    """Speed, Mach number and time over which a flight goes, in words."""
    c = flight.conditions
    V, mach = c["velocity_m_s"], c["mach"]
    return (
        f"from {V.max():.0f} to {V.min():.0f} m/s, Mach {mach.max():.3g} to {mach.min():.3g}, "
        f"{c.time_s[0]:g} to {c.time_s[-1]:g} s"
    )
