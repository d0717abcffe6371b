"""The 3-DOF entry of a scenario as the image of an FMU: its blocks, with a variable for each number that may be set."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from sim_heating.base.conditions import FRAME
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.jit import c_function
from sim_heating.base.limits import LIMITS
from sim_heating.base.progress import Progress, no_progress
from sim_heating.simulation.fmu_export import entry_kernel as k
from sim_heating.simulation.fmu_export.export import write_fmu
from sim_heating.simulation.fmu_export.parts.image import Image, Problem, Role, identifier
from sim_heating.simulation.fmu_export.parts.library import MODEL_SIGNATURE, REACHED, TIMING, CompilationUnit
from sim_heating.simulation.fmu_export.parts.packer import ImagePacker, Input
from sim_heating.trajectory import guidance as gd
from sim_heating.trajectory import manoeuvres as mv
from sim_heating.trajectory import point_mass as pm
from sim_heating.trajectory.entry3dof import Entry, initial_numbers
from sim_heating.trajectory.flight import ROW
from sim_heating.trajectory.fmu.columns import unit_of, words_of
from sim_heating.trajectory.spec import TrajectorySpec

MANOEUVRES, POINTS = 4, 12
"""Least number of manoeuvres of an FMU, and of points of a manoeuvre; those that a scenario does not use do nothing."""
NEVER_S = 1e9

INPUTS = tuple(
    Input(*about, -180.0, 180.0)
    for about in (
        ("command.alpha_deg", "deg", 40.0, "angle of attack to be reached at the end of a step"),
        ("command.bank_deg", "deg", 60.0, "bank about the velocity to be reached at the end of a step, right positive"),
        ("command.beta_deg", "deg", 1.0, "sideslip to be reached at the end of a step"),
        ("command.elevon_deg", "deg", 1.0, "elevon about its trim, to be reached at the end of a step"),
        ("command.bodyflap_deg", "deg", 1.0, "body flap about its schedule, to be reached at the end of a step"),
        ("command.jets", "1", 1.0, "share of the reaction jets that fire over a step"),
    )
)
PILOTS = (
    ("inside", "guidance and manoeuvres of this FMU command; inputs are ignored"),
    ("host", "the inputs command; guidance and manoeuvres of this FMU do nothing"),
)
TRIGGERS = (
    ("time", "begins at a time [s]"),
    ("velocity", "begins where speed falls through a value [m/s]"),
    ("mach", "begins where the Mach number falls through a value"),
)
CHANNELS = (
    ("alpha", "angle of attack [deg]"),
    ("beta", "sideslip [deg]"),
    ("elevon", "elevon about its trim [deg]"),
    ("bodyflap", "body flap about its schedule [deg]"),
    ("jets", "reaction jets, 0 to 1"),
)
PITCHES = (
    ("closed", "the elevon trims as usual"),
    ("jets_hold", "jets hold the angle of attack"),
    ("open", "nothing holds the angle of attack"),
)
INITIAL = (
    ("altitude_m", 0.0, 200e3),
    ("velocity_m_s", 1.0, 20e3),
    ("gamma_deg", -90.0, 90.0),
    ("heading_deg", -360.0, 360.0),
    ("latitude_deg", -90.0, 90.0),
    ("longitude_deg", -360.0, 360.0),
)
"""Initial state, relative to the air, in the order of the kernel, with its limits."""
VEHICLE = (("vehicle.mass_kg", pm.MASS, 1.0, 1e7, "kg"), ("vehicle.area_m2", pm.AREA, 1e-3, 1e5, "m2"))
GUIDANCE = (
    ("initial.bank_deg", gd.FIRST_BANK, -180.0, 180.0, "deg"),
    ("guidance.start_drag_m_s2", gd.START_DRAG, 1e-6, 100.0, "m/s2"),
    ("guidance.alpha_lowest_deg", gd.ALPHA_LOW, -90.0, 90.0, "deg"),
    ("guidance.alpha_highest_deg", gd.ALPHA_HIGH, -90.0, 90.0, "deg"),
    ("guidance.alpha_rate_deg_s", gd.ALPHA_RATE, 1e-3, 90.0, "deg/s"),
    ("guidance.bank_lowest_deg", gd.BANK_LOW, 0.0, 180.0, "deg"),
    ("guidance.bank_highest_deg", gd.BANK_HIGH, 0.0, 180.0, "deg"),
    ("guidance.bank_rate_deg_s", gd.BANK_RATE, 1e-3, 90.0, "deg/s"),
    ("guidance.frequency_rad_s", gd.FREQUENCY, 1e-4, 10.0, "1/s"),
    ("guidance.damping", gd.DAMPING, 0.2, 10.0, "1"),
    ("guidance.scale_height_m", gd.SCALE_HEIGHT, 1e3, 1e5, "m"),
)
"""Scalars of the blocks that may be set: name, place, limits, unit; schedules stay as exported."""
GUIDANCE_OUTPUTS = (
    ("mach", gd.MACH, "1"),
    ("altitude_rate_m_s", gd.CLIMB, "m/s"),
    ("drag_m_s2", gd.DRAG, "m/s2"),
    ("lift_m_s2", gd.LIFT, "m/s2"),
    ("net_gravity_m_s2", gd.NET_GRAVITY, "m/s2"),
)
"""Outputs in addition to the frame, for the guidance of a host: name, place, unit."""
NOMINAL = {"altitude_m": 1e5, "velocity_m_s": 7e3, "rho_kg_m3": 1e-4}


def export_entry(
    spec: TrajectorySpec,
    vehicle_dir: Path,
    out: Path,
    *,
    title: str = "",
    fmi: int = 3,
    platforms: tuple[str, ...] = ("linux",),
    progress: Progress = no_progress,
) -> Image:
    """Write the 3-DOF entry of a scenario as a co-simulation FMU.

    spec   : [trajectory] of a scenario with source "entry-3dof"; the host ends the flight
    fmi, platforms, progress : as in `write_fmu`
    returns : the image of the FMU
    raises  : InputError for another source, a platform without a compiler, a place that cannot be written
    """
    image = entry_image(spec, vehicle_dir, title)
    write_fmu(out, image, ENTRY_UNITS, fmi, platforms, progress)
    return image


ENTRY_UNITS = (CompilationUnit("entry_advance", MODEL_SIGNATURE, lambda: c_function(MODEL_SIGNATURE, k.advance)),)
"""The compiled function of the library."""


def require_entry_source(spec: TrajectorySpec) -> None:
    """raises : InputError where a trajectory is not of the 3-DOF entry"""
    if spec.source != "entry-3dof" or spec.initial is None:
        raise InputError(f'source = "{spec.source}" cannot be exported as an FMU; give a scenario with "entry-3dof"')


def entry_image(spec: TrajectorySpec, vehicle_dir: Path, title: str = "") -> Image:
    """The 3-DOF entry of a scenario as an image.

    raises : InputError where the scenario is flown by another source
    """
    require_entry_source(spec)
    name = identifier(Path(vehicle_dir).name)
    image = Image(f"{name}_entry", title or f"3-DOF entry of {name}", 1.0 / spec.rate_hz)
    _EntryPacker(image, spec, Entry(spec, vehicle_dir)).pack()
    return image


class _EntryPacker(ImagePacker):
    """Packs the blocks of an entry into an image."""

    def __init__(self, image: Image, spec: TrajectorySpec, entry: Entry) -> None:
        super().__init__(image, k.N_MODEL)
        self.spec, self.entry = spec, entry

    def pack(self) -> None:
        image = self.image
        self._pack_inputs()
        self._pack_initial()
        self._pack_blocks()
        self._pack_manoeuvres()
        self._pack_outputs()
        # No input acts before the next step; the initial values are those of all parameters.
        parameters = tuple(v.name for v in image.variables if v.role is Role.FIXED)
        image.variables = [replace(v, parameters=parameters) if v.role is Role.OUTPUT else v for v in image.variables]
        image.set_integers([*self.head.items(), (TIMING, REACHED), (k.PILOT, k.INSIDE)])
        image.kept_numbers = [(0, image.n_R)]
        image.kept_integers += [(k.PILOT, 1), (self.head[k.CHOICES], k.CHOICES_EACH * self.head[k.MANOEUVRES])]
        row = self.head[k.ROW]
        outside = "is above the atmosphere's table (200 km); start slower or steeper"
        image.problems += [
            Problem("altitude_m", outside, row + k.ALTITUDE_IN_ROW),
            Problem("altitude_m", "is below the ground; end the flight before", row + k.ALTITUDE_IN_ROW),
            Problem("the state", "is not a number; check start values and inputs"),
        ]

    def _pack_inputs(self) -> None:
        starts = np.zeros(len(INPUTS))
        starts[:2] = self.entry.state[[pm.ALPHA, pm.BANK]]
        self.add_inputs(INPUTS, starts)
        self.add_choice("pilot", Role.FIXED, k.PILOT, "who commands", PILOTS)

    def _pack_initial(self) -> None:
        assert self.spec.initial is not None
        offset = self.image.add_numbers(initial_numbers(self.spec.initial))
        for i, (name, lower, upper) in enumerate(INITIAL):
            text = f"{words_of(name)} at the start, relative to the air"
            self.add_number(f"initial.{name}", Role.FIXED, offset + i, text, unit_of(name), lower, upper)
        options = self.image.add_numbers([self.entry.dt_s])
        text = "longest frame; a longer communication step is divided"
        self.add_number("frame_s", Role.FIXED, options, text, "s", 1e-3, 10.0)
        self.head |= {k.INITIAL: offset, k.OPTIONS: options}

    def _pack_blocks(self) -> None:
        image, entry = self.image, self.entry
        flight = image.add_numbers(self._without_stop(entry.flight), aligned=True)
        block = image.add_numbers(entry.block, aligned=True)
        for first, named in ((flight, VEHICLE), (block, GUIDANCE)):
            for name, offset, lower, upper, unit in named:
                text = words_of(name.split(".")[1]) + ", see docs/theory/equations.md"
                self.add_number(name, Role.FIXED, first + offset, text, unit, lower, upper)
        self.head |= {k.FLIGHT: flight, k.GUIDANCE: block, k.AERO: image.add_tables(entry.tables)}

    @staticmethod
    def _without_stop(flight: np.ndarray) -> np.ndarray:
        """The block of a flight without a stop condition."""
        copy = flight.copy()
        # The host decides when the flight ends.
        copy[[pm.STOP_TIME, pm.STOP_MACH, pm.STOP_SPEED, pm.STOP_ALTITUDE]] = np.inf, 0.0, 0.0, -np.inf
        return copy

    def _pack_manoeuvres(self) -> None:
        """Pack the script: MANOEUVRES or more polygons of POINTS or more points; the last point is repeated."""
        script = self.entry.script
        flown = int(script[mv.COUNT])
        # Unused manoeuvres are exported as well, so that a host can plan others without a new export.
        n = max(flown, MANOEUVRES)
        shapes = [mv.polygon(m) for m in self.spec.manoeuvre]
        points = max([POINTS, *(len(s) for s in shapes)])
        plan, choices, numbers = [float(n)], [], []
        for m in range(n):
            entry = script[mv.PLAN + mv.ENTRY * m :][: mv.ENTRY] if m < flown else np.array([0.0, NEVER_S, 0, 0, 0, 0])
            # Repeating the last point leaves the polygon as it is and gives every manoeuvre the same number of
            # parameters.
            shape = [*shapes[m], *[shapes[m][-1]] * (points - len(shapes[m]))] if m < flown else [(0.0, 0.0)] * points
            first = mv.PLAN + mv.ENTRY * n + 2 * points * m
            plan += [*entry[: mv.PITCH_MODE + 1], first, first + 2 * (points - 1)]
            choices += [entry[mv.TRIGGER] + 1, entry[mv.CHANNEL] + 1, entry[mv.PITCH_MODE] + 1]
            numbers += [x for point in shape for x in point]
        offset, chosen = self.image.add_numbers([*plan, *numbers]), self.image.add_integers(choices)
        self.head |= {k.SCRIPT: offset, k.CHOICES: chosen, k.MANOEUVRES: n}
        for m in range(n):
            self._name_manoeuvre(
                m, offset, chosen + k.CHOICES_EACH * m, mv.PLAN + mv.ENTRY * n + 2 * points * m, points
            )

    def _name_manoeuvre(self, m: int, script: int, chosen: int, first: int, points: int) -> None:
        manoeuvre = f"manoeuvre[{m + 1}]"
        kinds = (
            ("trigger", TRIGGERS, "what triggers it"),
            ("moves", CHANNELS, "what it varies"),
            ("pitch", PITCHES, "pitch axis meanwhile"),
        )
        for i, (name, choices, text) in enumerate(kinds):
            self.add_choice(f"{manoeuvre}.{name}", Role.FIXED, chosen + i, text, choices)
        text = "time [s], speed [m/s] or Mach number at which it begins"
        self.add_number(f"{manoeuvre}.at", Role.FIXED, script + mv.PLAN + mv.ENTRY * m + mv.VALUE, text, lower=0.0)
        for i in range(points):
            offset, at = script + first + 2 * i, f"{manoeuvre}.point[{i + 1}]"
            self.add_number(f"{at}.after_s", Role.FIXED, offset, "time since its beginning", "s", lower=0.0)
            self.add_number(f"{at}.offset", Role.FIXED, offset + 1, "offset then, in the unit of what it varies")

    def _pack_outputs(self) -> None:
        image, n = self.image, self.head[k.MANOEUVRES]
        state = image.add_numbers(np.zeros(pm.STARTED + n), aligned=True)
        work, row = image.add_numbers(np.zeros(pm.WORK), aligned=True), image.add_numbers(np.zeros(len(ROW)))
        self.head |= {k.STATE: state, k.WORK: work, k.ROW: row}
        for i, name in enumerate(ROW[1:], start=1):
            text = f"{words_of(name)}, as in a frame" if i < len(FRAME) else "of the flight"
            lower, upper, _ = LIMITS.get(name, (-np.inf, np.inf, ""))
            self.add_number(name, Role.OUTPUT, row + i, text, unit_of(name), lower, upper, NOMINAL.get(name))
        for name, offset, unit in GUIDANCE_OUTPUTS:
            self.add_number(name, Role.OUTPUT, work + offset, "as guidance uses it", unit)
        for m in range(n):
            text = "when it began; -1 before"
            self.add_number(f"manoeuvre[{m + 1}].began_s", Role.OUTPUT, state + pm.STARTED + m, text, "s")
