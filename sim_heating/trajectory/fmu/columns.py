"""From an FMU's variables to the columns of a flight: mapping, units, usual names and derived columns.

Columns that an FMU does not provide are derived where physics allows it, in this order:

    wind           u = v_NED - wind(altitude)                      [trajectory.dispersions]
    speed          V = |u|, or Mach times the speed of sound of US76
    path, heading  sin(gamma) = -u_D / V or altitude rate / V,  heading = atan2(u_E, u_N)
    attitude       body axes from roll, pitch, yaw (z, y, x), u in them:  alpha = atan2(w, u),  beta = asin(v / V),
                   bank about the velocity from the body's y and z axes
    density        US Standard Atmosphere 1976 times [trajectory.dispersions].density_factor
    body flap      the schedule of the 3-DOF entry;  elevon: in trim, by the vehicle's tables
    jets           0
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sim_heating.base.conditions import EXTRAS, FRAME
from sim_heating.base.errors import InputError
from sim_heating.base.files import raise_problems, suggestion
from sim_heating.base.files.units import Conversion
from sim_heating.heating.atmosphere import standard_sound_kernel
from sim_heating.trajectory import point_mass as pm
from sim_heating.trajectory.aero import flown_aero
from sim_heating.trajectory.dispersed_air import air_kernel, dispersion_block
from sim_heating.trajectory.entry3dof import flight_block
from sim_heating.trajectory.guidance import clip, resolve_guidance
from sim_heating.trajectory.spec import FmuVariable, TrajectorySpec
from sim_heating.trajectory.trimmed_aero import aero_block, lift_drag_kernel, low_speed_rows

if TYPE_CHECKING:
    from sim_heating.trajectory.fmu.model import FmuModel  # it needs FMPy, and an export has the names of columns alone

Frame = dict[str, float]
Step = Callable[[Frame], None]

MOTION = ("velocity_north_m_s", "velocity_east_m_s", "velocity_down_m_s", "altitude_rate_m_s", "mach")
ATTITUDE = ("roll_deg", "pitch_deg", "yaw_deg")
FORCES = ("drag_m_s2", "lift_m_s2", "net_gravity_m_s2")
"""Columns that guidance needs in addition to the frame."""
COLUMNS = (*FRAME[1:], *EXTRAS, *MOTION, *ATTITUDE, *FORCES)
"""Columns that a mapping may name; speed, path angle and heading are relative to the air, MOTION to the Earth."""

FIRST_CAUSES = ("altitude_m", "velocity_m_s", "alpha_deg", "beta_deg")
"""Columns of the frame from which an FMU that has none of the others can be flown."""

AIR_PATH = ("velocity_m_s", "gamma_deg", "heading_deg")
ANGLES = ("alpha_deg", "beta_deg", "bank_deg")
DERIVED_FROM = ((set(MOTION[:3]), AIR_PATH), ({"mach"}, AIR_PATH[:1]), (set(ATTITUDE), ANGLES))
"""Columns that are required, and those derived from them."""
SPEEDS = (set(AIR_PATH[:1]), set(MOTION[:3]))
"""Columns that determine the speed and therefore exclude Mach."""

UNITS = (
    ("_kg_m3", "kg/m3"),
    ("_m_s2", "m/s2"),
    ("_m_s", "m/s"),
    ("_deg", "deg"),
    ("_m", "m"),
    ("_g", "standard_gravity"),
)
"""Ending of a column -> its unit; a plain number where none fits."""
UNIT_AT_END = re.compile("(_(kg|m|m2|m3|s|s2|deg|rad|K|g))+$")
"""The unit at the end of any name."""

USUAL_NAMES = {
    "altitude_m": ("altitude", "alt", "height", "h"),
    "velocity_m_s": ("airspeed", "trueairspeed", "tas", "velocity"),
    "alpha_deg": ("alpha", "angleofattack", "aoa"),
    "beta_deg": ("beta", "sideslip", "angleofsideslip"),
    "elevon_deg": ("elevon",),
    "bodyflap_deg": ("bodyflap",),
    "rho_kg_m3": ("rho", "density", "airdensity"),
    "bank_deg": ("bank", "bankangle"),
    "gamma_deg": ("gamma", "flightpathangle", "fpa"),
    "heading_deg": ("heading",),
    "latitude_deg": ("latitude", "lat"),
    "longitude_deg": ("longitude", "lon"),
    "roll_deg": ("roll", "phi"),
    "pitch_deg": ("pitch", "theta"),
    "yaw_deg": ("yaw", "psi"),
    "mach": ("mach", "machnumber"),
}
"""Names under which a variable is found that the scenario does not map; lower case, letters only."""
NOT_A_LETTER = re.compile("[^a-z]")


def unit_of(column: str) -> str:
    """The unit of a column, such as [m/s]."""
    return next((unit for ending, unit in UNITS if column.endswith(ending)), "1")


def words_of(column: str) -> str:
    """The words of a column's name, without its unit: `altitude` of an altitude_m [m]."""
    return UNIT_AT_END.sub("", column).replace("_", " ")


@dataclass(frozen=True)
class Reading:
    """One column from one variable."""

    column: str
    variable: str
    convert: Conversion


def _outputs_by_letters(outputs: Iterable[str]) -> dict[str, list[str]]:
    """Outputs by their name in lower case, letters only, as USUAL_NAMES has it."""
    by_letters: dict[str, list[str]] = {}
    for name in outputs:
        by_letters.setdefault(NOT_A_LETTER.sub("", name.lower()), []).append(name)
    return by_letters


def _only_output(column: str, outputs: Set[str], by_letters: Mapping[str, Sequence[str]]) -> str | None:
    """The output with the name of a column, or the only one with a usual name of it; else None."""
    if column in outputs:
        return column
    names = [name for usual in USUAL_NAMES.get(column, ()) for name in by_letters.get(usual, ())]
    return names[0] if len(names) == 1 else None


class ColumnsOfFmu:
    """Converts the outputs of an FMU to the frames of a flight.

    outputs   : names of the variables to read
    available : columns of every frame
    missing   : columns of EXTRAS that cannot be determined
    notes     : columns found by usual names or derived, for the events of the flight
    raises    : InputError, all problems at once
    """

    def __init__(self, model: FmuModel, spec: TrajectorySpec, vehicle_dir: Path) -> None:
        self.notes: list[str] = []
        self._constants: Frame = {}
        self._readings = self._map_columns(model, spec)
        self.outputs = [r.variable for r in self._readings]
        self._derive = Derivation({*self._constants, *(r.column for r in self._readings)}, spec, vehicle_dir)
        self.notes += self._derive.notes
        self.missing = [name for name in EXTRAS if name not in self._derive.available]
        self.available = self._derive.available

    def _map_columns(self, model: FmuModel, spec: TrajectorySpec) -> list[Reading]:
        readings: list[Reading] = []
        problems: list[str] = []
        for column, declared in spec.fmu.columns.items():
            where = f"[trajectory.fmu.columns], `{column}`"
            if column not in COLUMNS:
                problems.append(f"{where}: unknown column{suggestion(column, COLUMNS)}")
            elif isinstance(declared, float):
                self._constants[column] = declared
            else:
                named = declared if isinstance(declared, FmuVariable) else FmuVariable(variable=declared)
                try:
                    variable = model.number(named.variable, where)
                    convert = model.conversion(variable, named.unit, unit_of(column), where)
                    readings.append(Reading(column, variable.name, convert))
                except InputError as error:
                    problems += error.problems
        for names in SPEEDS:
            if {"mach", *names} <= set(spec.fmu.columns):
                other = ", ".join(sorted(names))
                problems.append(f"[trajectory.fmu.columns]: `mach` and {other} both determine the speed; remove one")
        raise_problems(problems)
        mapped = {r.column for r in readings} | set(self._constants)
        return readings + self._by_usual_name(model, mapped, {r.variable for r in readings})

    def _by_usual_name(self, model: FmuModel, mapped: set[str], read: set[str]) -> list[Reading]:
        """Outputs with unambiguous names: that of the column, or a usual one that only one output has.

        Columns that the mapping contains, or that follow from it, are not searched for.
        """
        # A column that follows from mapped ones is not looked for by name: two sources of one quantity may disagree.
        mapped = mapped.union(*(derived for needed, derived in DERIVED_FROM if needed <= mapped))
        outputs = {v.name for v in model.description.modelVariables if v.causality == "output"} - read
        by_letters = _outputs_by_letters(outputs)
        readings = []
        for column in COLUMNS:
            # A name that fits several outputs is left alone; a wrong guess would fly without a message.
            if column in mapped or (name := _only_output(column, outputs, by_letters)) is None:
                continue
            try:
                convert = model.conversion(model.number(name, column), None, unit_of(column), column)
            except InputError:
                self._note_unused(model, name, column)
                continue
            readings.append(Reading(column, name, convert))
            if name != column:
                self.notes.append(f"{column} is read from `{name}`, a usual name")
        return readings

    def _note_unused(self, model: FmuModel, name: str, column: str) -> None:
        """Note that an output with a usual name is not used because its unit is unknown."""
        unit = unit_of(column)
        with suppress(InputError):  # an output of another dimension is not this column
            model.conversion(model.number(name, column), unit, unit, column)
            written = f'{column} = {{ variable = "{name}", unit = "{unit}" }}'
            self.notes.append(f"`{name}` is not used because its unit is unknown; if it is {column}, write {written}")

    def frame(self, time_s: float, values: list[float]) -> Frame:
        """All columns at a time [s] from the FMU's outputs, in the units of the contract ([m], [m/s], [deg] ...)."""
        frame: Frame = {"time_s": time_s, **self._constants}
        for reading, value in zip(self._readings, values, strict=True):
            frame[reading.column] = reading.convert(value)
        self._derive(frame)
        return frame

    def source_text(self, column: str) -> str:
        """The source of a column, for an error message."""
        return next((f"`{r.variable}` gives {column}" for r in self._readings if r.column == column), column)


class Derivation:
    """The steps that complete a frame, selected once from the columns that an FMU provides.

    available : columns after all steps
    raises    : InputError, one line, naming the columns that remain unknown and from which the others follow
    """

    def __init__(self, columns: set[str], spec: TrajectorySpec, vehicle_dir: Path) -> None:
        self.available = {"time_s", *columns}
        self.notes: list[str] = []
        self._steps: list[Step] = []
        self._air = dispersion_block(spec.dispersions)
        # Motion first: density and trim need the altitude and speed that it may have to derive.
        self._choose_motion()
        self._choose({"altitude_m"}, ("rho_kg_m3",), self._standard_density, "density is that of US76")
        self._choose(set(), ("jets",), _no_jets, "")
        # The other columns of the frame follow from these: to ask for them as well would hide the cause.
        if missing := [column for column in FIRST_CAUSES if column not in self.available]:
            raise InputError(_unknown_columns(missing))
        if not {"elevon_deg", "bodyflap_deg"} <= self.available:
            self._choose_trim(spec, vehicle_dir)

    def __call__(self, frame: Frame) -> None:
        """Complete a frame in place."""
        for step in self._steps:
            step(frame)

    def _choose(self, needed: set[str], outputs: tuple[str, ...], step: Step, note: str) -> None:
        """Add a step if its inputs are available and an output is not; columns that are available stay unchanged."""
        if needed <= self.available and not set(outputs) <= self.available:
            keep = [name for name in outputs if name in self.available]
            self._steps.append(_preserving(step, keep) if keep else step)
            self.available |= set(outputs)
            if note:
                self.notes.append(note)

    def _choose_motion(self) -> None:
        north, east, down, rate, mach = MOTION
        # In order of preference: velocity components, then Mach, which needs a temperature that the FMU may not share.
        self._choose({north, east, down, "altitude_m"}, AIR_PATH, self._from_components, "speed is that of velocity")
        self._choose({mach, "altitude_m"}, ("velocity_m_s",), _from_mach, "speed is Mach times US76's speed of sound")
        self._choose({rate, "velocity_m_s"}, ("gamma_deg",), _from_rate, "")
        note = "alpha, beta, bank are those of attitude and velocity, where not given"
        self._choose({*AIR_PATH[1:], *ATTITUDE}, ANGLES, _from_attitude, note)

    def _choose_trim(self, spec: TrajectorySpec, vehicle_dir: Path) -> None:
        try:
            trim = _Trim(spec, vehicle_dir)
        except InputError as error:
            ways = "map elevon_deg and bodyflap_deg or give numbers"
            raise InputError(f"[trajectory.fmu.columns]: {ways}; trim requires the vehicle's tables: {error}") from None
        note = "elevon and body flap are in trim and on schedule, where not given"
        self._choose({"altitude_m", "velocity_m_s", "alpha_deg"}, ("elevon_deg", "bodyflap_deg"), trim, note)

    def _standard_density(self, f: Frame) -> None:
        f["rho_kg_m3"] = air_kernel(f["altitude_m"], self._air)[2]

    def _from_components(self, f: Frame) -> None:
        _, _, _, wind_north, wind_east = air_kernel(f["altitude_m"], self._air)
        north, east = f["velocity_north_m_s"] - wind_north, f["velocity_east_m_s"] - wind_east
        down = f["velocity_down_m_s"]
        speed = math.sqrt(north * north + east * east + down * down)
        f["velocity_m_s"] = speed
        f["gamma_deg"] = math.degrees(math.asin(clip(-down / max(speed, 1e-9), -1.0, 1.0)))
        f["heading_deg"] = math.degrees(math.atan2(east, north))


def _preserving(step: Step, names: list[str]) -> Step:
    """A step that leaves some columns unchanged."""

    def preserving_step(frame: Frame) -> None:
        before = {name: frame[name] for name in names}
        step(frame)
        frame |= before

    return preserving_step


def _unknown_columns(missing: list[str]) -> str:
    """The message about columns that are neither mapped nor derived."""
    others = {
        "velocity_m_s": "velocity_m_s also follows from mach, or from velocity_north_m_s, _east_m_s, _down_m_s",
        "alpha_deg": "alpha_deg and beta_deg also follow from roll_deg, pitch_deg, yaw_deg and the velocity components",
    }
    names = ", ".join(f"`{column}`" for column in missing)
    ways = [f'write {missing[0]} = "variable", or a number', *(others[c] for c in missing if c in others)]
    verb = "is" if len(missing) == 1 else "are"
    return f"[trajectory.fmu.columns]: {names} {verb} unknown; {'; '.join(ways)}"


def _no_jets(f: Frame) -> None:
    f["jets"] = 0.0


def _from_mach(f: Frame) -> None:
    f["velocity_m_s"] = f["mach"] * standard_sound_kernel(f["altitude_m"])


def _from_rate(f: Frame) -> None:
    sine = f["altitude_rate_m_s"] / max(f["velocity_m_s"], 1e-9)
    f["gamma_deg"] = math.degrees(math.asin(clip(sine, -1.0, 1.0)))


def _from_attitude(f: Frame) -> None:
    f["alpha_deg"], f["beta_deg"], f["bank_deg"] = aerodynamic_angles(
        f["roll_deg"], f["pitch_deg"], f["yaw_deg"], f["gamma_deg"], f["heading_deg"]
    )


def aerodynamic_angles(
    roll_deg: float, pitch_deg: float, yaw_deg: float, gamma_deg: float, heading_deg: float
) -> tuple[float, float, float]:
    """Angle of attack, sideslip and bank about the velocity [deg] of a body that flies along gamma and heading.

    Body axes after yaw, pitch and roll from north, east, down. Bank is the angle from the vertical plane through the
    velocity to the plane of lift, right wing down positive: of the body's z axis across the velocity.
    """
    r, p, y = (math.radians(a) for a in (roll_deg, pitch_deg, yaw_deg))
    g, h = math.radians(gamma_deg), math.radians(heading_deg)
    cr, sr, cp, sp, cy, sy = math.cos(r), math.sin(r), math.cos(p), math.sin(p), math.cos(y), math.sin(y)
    body_x = (cp * cy, cp * sy, -sp)
    body_y = (sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp)
    body_z = (cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp)
    forward = (math.cos(g) * math.cos(h), math.cos(g) * math.sin(h), -math.sin(g))
    level = (-math.sin(h), math.cos(h), 0.0)
    below = (math.sin(g) * math.cos(h), math.sin(g) * math.sin(h), math.cos(g))
    u, v, w = pm.dot(forward, body_x), pm.dot(forward, body_y), pm.dot(forward, body_z)
    alpha, beta = math.atan2(w, u), math.asin(clip(v, -1.0, 1.0))
    # The wind axes' z: body_z turned back by alpha, which lies across the velocity.
    s, c = math.sin(alpha), math.cos(alpha)
    wind_z = (c * body_z[0] - s * body_x[0], c * body_z[1] - s * body_x[1], c * body_z[2] - s * body_x[2])
    bank = math.atan2(-pm.dot(wind_z, level), pm.dot(wind_z, below))
    return math.degrees(alpha), math.degrees(beta), math.degrees(bank)


class _Trim:
    """Body flap on its schedule and the elevon that trims the vehicle, as in the 3-DOF entry."""

    def __init__(self, spec: TrajectorySpec, vehicle_dir: Path) -> None:
        aero = flown_aero(spec, vehicle_dir)
        # The kernels of the 3-DOF entry: an FMU without surfaces has the deflections that the built-in flight would
        # have.
        self._flight = flight_block(spec, aero, resolve_guidance(spec.guidance, vehicle_dir))
        self._tables = aero_block(aero, low_speed_rows(vehicle_dir, aero.basic.mach[0]))

    def __call__(self, f: Frame) -> None:
        speed = f["velocity_m_s"]
        mach = speed / standard_sound_kernel(f["altitude_m"])
        flap = f.get("bodyflap_deg", np.nan)
        if math.isnan(flap):
            flap = pm.flap_kernel(self._flight, mach, speed, 0.0)
        f["bodyflap_deg"] = flap
        f["elevon_deg"] = lift_drag_kernel(mach, f["alpha_deg"], flap, 0.0, self._flight, self._tables)[3]
