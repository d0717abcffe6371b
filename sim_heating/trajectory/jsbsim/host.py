"""JSBSim as a host: one fresh executive, named properties, the standard atmosphere injected, one frame at a time.

JSBSim's own atmosphere is frozen at 187 K above 86 km and up to a quarter too thin, so density, temperature and
pressure of US76 (times a dispersion) and the wind are written before each frame, for the altitude that the frame leads
to. Values read after a frame belong to that frame.

Source: Berndt (2004), "JSBSim: An Open Source Flight Dynamics Model in C++", AIAA 2004-4923.
"""

from __future__ import annotations

import ctypes
import itertools
import math
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import FRAME
from sim_heating.base.errors import InputError, RunError, error_context
from sim_heating.base.files import display_path, suggestion
from sim_heating.base.files.xml import read_xml
from sim_heating.heating.atmosphere import HIGHEST_M
from sim_heating.trajectory.aero import Aero, load_aero
from sim_heating.trajectory.dispersed_air import air_kernel, dispersion_block
from sim_heating.trajectory.jsbsim.library import jsbsim
from sim_heating.trajectory.jsbsim.model import control_path, write_aircraft
from sim_heating.trajectory.spec import Dispersions

FT_M = 0.3048
PSF_PA = 47.88025898
SLUG_FT3_KG_M3 = 515.3788184
RANKINE_K = 1.0 / 1.8

LOWEST_M = -1000.0
"""Altitude below which a vehicle has hit the ground [m]."""

JSBSIM_ERRORS = (jsbsim.BaseError, RuntimeError, ValueError, IndexError, ArithmeticError, MemoryError)
"""What JSBSim raises: its own errors, and those that its binding makes of exceptions of the C++ library."""


class PropertyRead(NamedTuple):
    """A JSBSim property and its factor to SI units."""

    name: str
    factor: float = 1.0


Read = PropertyRead | float
"""Source of a column: a property, or a constant in the column's unit."""

VEHICLE_READS: Mapping[str, PropertyRead] = MappingProxyType(
    {
        "altitude_m": PropertyRead("position/h-sl-ft", FT_M),
        "velocity_m_s": PropertyRead("velocities/vt-fps", FT_M),
        "alpha_deg": PropertyRead("aero/alpha-deg"),
        "beta_deg": PropertyRead("aero/beta-deg"),
        "elevon_deg": PropertyRead("fcs/elevon-pos-deg"),
        "bodyflap_deg": PropertyRead("fcs/bodyflap-pos-deg"),
        "rho_kg_m3": PropertyRead("atmosphere/rho-slugs_ft3", SLUG_FT3_KG_M3),
        "jets": PropertyRead("control/jet-firing"),
    }
)
"""Properties of the columns of conditions.FRAME in the models of this package."""

OTHER_READS: Mapping[str, Read] = MappingProxyType(
    {
        "elevon_deg": PropertyRead("fcs/elevator-pos-deg"),
        "bodyflap_deg": 0.0,
        "jets": 0.0,
    }
)
"""Controls of an aircraft that lacks the properties above: the elevator, which JSBSim gives every aircraft, is its
elevon; what does not exist does not deflect or fire."""


class InitialState(NamedTuple):
    """State at the start; velocity, path angle and heading are relative to the air."""

    altitude_m: float
    velocity_m_s: float
    gamma_deg: float
    heading_deg: float
    latitude_deg: float
    longitude_deg: float = 0.0
    alpha_deg: float = 0.0
    bank_deg: float = 0.0


class JSBSimHost:
    """One aircraft in one fresh JSBSim executive.

    aircraft_path : folder that holds <model>/<model>.xml
    rate_hz       : frames a second
    reads         : column of conditions.FRAME -> property or constant, where it is not that of VEHICLE_READS; a control
                    that the aircraft does not have is that of OTHER_READS
    dispersions   : of the injected US76 atmosphere; None leaves JSBSim its own atmosphere and wind
    notes         : a line for each control that is that of OTHER_READS
    raises        : InputError where the aircraft does not load or lacks a property of `reads`

    Use: `start(state)`, then `step()` and `read_frame(buffer)` in turn. Hosts in one process do not disturb each other.

    >>> from pathlib import Path
    >>> import jsbsim
    >>> from sim_heating.trajectory.jsbsim.host import JSBSimHost, PropertyRead
    >>> aircraft = Path(jsbsim.get_default_root_dir()) / "aircraft"
    >>> x15 = JSBSimHost(aircraft, "X15", reads={"bodyflap_deg": PropertyRead("fcs/speedbrake-pos-deg")})
    >>> print(*x15.notes, sep="\\n")
    elevon_deg is read from fcs/elevator-pos-deg: this aircraft has no fcs/elevon-pos-deg
    jets is 0: this aircraft has no control/jet-firing
    """

    def __init__(
        self,
        aircraft_path: Path,
        model: str,
        *,
        rate_hz: float = 60.0,
        reads: Mapping[str, Read] = MappingProxyType({}),
        dispersions: Dispersions | None = None,
    ) -> None:
        self.rate_hz = rate_hz
        self.frames = 0
        self.notes: list[str] = []
        self._published: list[str] = []
        self._has_run = False
        self.fdm = _load(Path(aircraft_path), model, rate_hz)
        self.frame_values = np.zeros(len(FRAME))
        self._frame_view = self.frame_values.data.cast("B").cast("d")  # an array takes twice as long for a number
        self._reads = [(i, *self._source(FRAME[i], reads)) for i in range(1, len(FRAME))]
        if unknown := [name for name in reads if name not in FRAME[1:]]:
            raise InputError(f"reads: unknown column `{unknown[0]}`{suggestion(unknown[0], FRAME[1:])}")
        self._altitude_ft = self.getter("position/h-sl-ft")
        self._climb_fps = self.getter("velocities/h-dot-fps")
        self._run = self.fdm.run
        self._air = None if dispersions is None else _AirInjection(self, dispersions)

    def __del__(self) -> None:
        # JSBSim's destructors evaluate its functions once more; one whose property does not exist ends the program
        # (terminate). The first run finds such properties: before it an executive must not be destroyed.
        if not getattr(self, "_has_run", True) and hasattr(self, "fdm"):
            _keep(self.fdm)

    def _source(self, column: str, reads: Mapping[str, Read]) -> tuple[Callable[[], float], float]:
        """The reading function of a column, and its factor to SI units."""
        source = reads.get(column)
        if source is None:
            source = VEHICLE_READS[column]
            if column in OTHER_READS and self.fdm.get_property_manager().get_node(source.name) is None:
                absent, source = source.name, OTHER_READS[column]
                origin = f"read from {source.name}" if isinstance(source, PropertyRead) else f"{source:g}"
                self.notes.append(f"{column} is {origin}: this aircraft has no {absent}")
        if isinstance(source, PropertyRead):
            with error_context(f"reads, `{column}`"):
                return self.getter(source.name), source.factor
        value = float(source)
        if not math.isfinite(value):
            raise InputError(f"reads, `{column}`: {value} is not a finite number")
        return lambda: value, 1.0

    @property
    def time_s(self) -> float:
        """Time since the start [s]; counted in frames, so that it does not drift as JSBSim's sum does."""
        return self.frames / self.rate_hz

    def node(self, name: str) -> jsbsim.FGPropertyNode:
        """A property that exists, as a node: `get_double_value()` and `set_double_value(x)` cost 0.02 us.

        raises : InputError with the nearest name where there is no such property

        Source: Berndt (2004), as at the head.
        """
        node = self.fdm.get_property_manager().get_node(name)
        if node is None:
            names = [*_properties(self.fdm), *self._published]
            raise InputError(f"{name}: this aircraft has no such JSBSim property{suggestion(name, names, cutoff=0.0)}")
        return node

    def getter(self, name: str) -> Callable[[], float]:
        """The reading function of a property; see `node`."""
        return self.node(name).get_double_value

    def publish(self, name: str) -> jsbsim.FGPropertyNode:
        """A property made where it is missing, to be written each frame in its unit, such as [K]:
        `heating/nose/surface-K`.

        raises : InputError where JSBSim cannot have a property of that name
        """
        created = self.fdm.get_property_manager().get_node(name, True) if _is_name(name) else None
        self._published.append(name)
        if created is None:
            raise InputError(f"{name}: not a JSBSim property name (letters, digits, . _ -; parts begin with a letter)")
        return created

    def start(self, state: InitialState) -> None:
        """Put the vehicle at a state ([m], [m/s], [deg]) at 0 s, without rotation; commands must have been written
        before.

        Source: Berndt (2004), as at the head.
        """
        air = None if self._air is None else self._air.write(state.altitude_m)
        for name, value in _initial_conditions(state, (0.0, 0.0) if air is None else air).items():
            self.node(f"ic/{name}").set_double_value(value)
        with _logging_to(_Log()):
            self._call_jsbsim(self.fdm.run_ic)
        self._has_run = True
        self.frames = 0

    def step(self) -> None:
        """One frame, of dt_s [s].

        raises : RunError with time and state where the vehicle left the atmosphere, hit the ground or its state is not
        finite

        Source: Berndt (2004), as at the head.
        """
        # The air of the frame to come: at its end the vehicle is at this altitude, not at the last one.
        altitude_m = (self._altitude_ft() + self._climb_fps() / self.rate_hz) * FT_M
        if not LOWEST_M < altitude_m < HIGHEST_M:
            raise RunError(f"JSBSim: the state {_altitude_fault(altitude_m)} {self.describe()}")
        if self._air is not None:
            self._air.write(altitude_m)
        if not self._call_jsbsim(self._run):
            raise RunError(f"JSBSim ended the run by itself; {self.describe()}")
        self.frames += 1

    def read_frame(self, buffer: FloatArray | None = None) -> FloatArray:
        """The columns of conditions.FRAME ([s], [m], [m/s], [deg], [kg/m3]) after the last frame, into buffer or into
        `frame_values`.

        Source: Berndt (2004), as at the head.
        """
        out: FloatArray | memoryview[float] = self._frame_view if buffer is None else buffer
        out[0] = self.frames / self.rate_hz
        for i, get, factor in self._reads:
            out[i] = get() * factor
        return self.frame_values if buffer is None else buffer

    def describe(self) -> str:
        """Time [s] and state ([m], [m/s], [deg]) as text, for messages."""
        f = dict(zip(FRAME, self.read_frame(np.zeros(len(FRAME))).tolist(), strict=True))
        return (
            f"at {f['time_s']:.2f} s: altitude {f['altitude_m'] / 1e3:.2f} km, velocity {f['velocity_m_s']:.0f} m/s, "
            f"alpha {f['alpha_deg']:.1f} deg, beta {f['beta_deg']:.1f} deg"
        )

    def _call_jsbsim(self, call: Callable[[], bool]) -> bool:
        try:
            return call()
        except JSBSIM_ERRORS as error:
            raise RunError(f"JSBSim stopped ({' '.join(str(error).split())}); {self.describe()}") from error


class _AirInjection:
    """Writes US76 with its dispersions into JSBSim's override properties."""

    def __init__(self, host: JSBSimHost, dispersions: Dispersions) -> None:
        # JSBSim's own temperature is stuck at 187 K above 86 km; the air is that of the 3-DOF entry, dispersions
        # included.
        self._block = dispersion_block(dispersions)
        self._setters = [
            host.publish(f"atmosphere/override/{name}").set_double_value
            for name in ("temperature", "pressure", "density")
        ]
        self._has_wind = bool(dispersions.wind_north_m_s or dispersions.wind_east_m_s)
        self._winds = [host.node(f"atmosphere/wind-{d}-fps").set_double_value for d in ("north", "east")]

    def write(self, altitude_m: float) -> tuple[float, float]:
        """Air at an altitude for the next frame; returns the wind to north and east [m/s]."""
        T, p, rho, north, east = air_kernel(altitude_m, self._block)
        temperature, pressure, density = self._setters
        temperature(T / RANKINE_K)
        pressure(p / PSF_PA)
        density(rho / SLUG_FT3_KG_M3)
        if self._has_wind:
            self._winds[0](north / FT_M)
            self._winds[1](east / FT_M)
        return north, east


def open_vehicle(
    vehicle_dir: Path, aero: Aero | None = None, *, rate_hz: float = 60.0, dispersions: Dispersions | None = None
) -> JSBSimHost:
    """A host with a vehicle of this package in it.

    aero   : aerodynamics with mass, centre of gravity and moment shift as flown; None for the vehicle's own
    raises : InputError where the vehicle lacks data that JSBSim needs
    """
    # JSBSim reads its files when it loads the model: they may be removed afterwards.
    with tempfile.TemporaryDirectory(prefix="sim_heating_jsbsim_") as folder:
        model = write_aircraft(aero or load_aero(vehicle_dir), vehicle_dir, Path(folder))
        try:
            # All properties by name: a control that the vehicle's system does not move is a fault of the vehicle.
            return JSBSimHost(
                Path(folder), model, rate_hz=rate_hz, reads=VEHICLE_READS, dispersions=dispersions or Dispersions()
            )
        except InputError as error:  # the vehicle's own file in place of the folder that is about to vanish
            written, control = display_path(Path(folder) / model), display_path(control_path(vehicle_dir))
            raise InputError(*(p.replace(written, control) for p in error.problems)) from error


class _Log(jsbsim.FGLogger):  # type: ignore[misc]  # untyped
    """Keeps the last place in a file that JSBSim complained about, and writes nothing."""

    def __init__(self) -> None:
        self._place: tuple[str, int] | None = None

    def where(self) -> str:
        """`, file.xml, line 36` where a place is known, else nothing."""
        return "" if self._place is None else f", {Path(self._place[0]).name}, line {self._place[1]}"

    def file_location(self, filename: str, line: int) -> None:
        """Note the place."""
        self._place = filename, line

    def set_level(self, level: Any) -> None:
        """Nothing."""

    def message(self, message: str) -> None:
        """Nothing."""

    def format(self, format: Any) -> None:
        """Nothing."""

    def flush(self) -> None:
        """Nothing."""


@contextmanager
def _logging_to(log: _Log) -> Iterator[None]:
    """JSBSim's log of this thread goes there: by default it writes to stdout what it also raises."""
    before = jsbsim.get_logger()
    jsbsim.set_logger(log)
    try:
        yield
    finally:
        jsbsim.set_logger(before)


def _load(aircraft_path: Path, model: str, rate_hz: float) -> jsbsim.FGFDMExec:
    file = aircraft_path / model / f"{model}.xml"
    if not file.is_file():
        there = [p.name for p in aircraft_path.glob("*") if (p / f"{p.name}.xml").is_file()]
        raise InputError(f"{file}: there is no such aircraft, JSBSim cannot load it{suggestion(model, there)}")
    read_xml(file)
    before = os.environ.get("JSBSIM_DEBUG")
    os.environ["JSBSIM_DEBUG"] = "0"  # read when the executive is made: silences its banner
    name = display_path(aircraft_path / model)
    fdm = jsbsim.FGFDMExec(None)
    log = _Log()
    try:
        fdm.set_debug_level(0)
        fdm.set_aircraft_path(str(aircraft_path))
        fdm.set_dt(1.0 / rate_hz)  # before loading: control components keep the step that they were loaded with
        with _logging_to(log):
            loaded = fdm.load_model(model)
    except JSBSIM_ERRORS as error:
        _keep(fdm)
        reason = " ".join(str(error).split())
        raise InputError(f"{name}: JSBSim cannot load it{log.where()}: {reason}") from error
    finally:
        if before is None:
            del os.environ["JSBSIM_DEBUG"]
        else:
            os.environ["JSBSIM_DEBUG"] = before
    if not loaded:
        _keep(fdm)
        raise InputError(f"{name}: JSBSim cannot load it{log.where()}")
    _discard_outputs(fdm)
    return fdm


def _keep(fdm: jsbsim.FGFDMExec) -> None:
    """Keep an executive until the program ends, its destructor not called even then."""
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(fdm))


def _discard_outputs(fdm: jsbsim.FGFDMExec) -> None:
    """Redirect the aircraft's own <output>, which writes files to the working directory even when switched off.

    Outputs that a user of the host adds later are written.
    """
    for number in itertools.count():
        if not fdm.get_output_filename(number):
            return
        fdm.set_output_filename(number, os.devnull)


def _properties(fdm: jsbsim.FGFDMExec) -> list[str]:
    return [line.split(" (")[0] for line in fdm.query_property_catalog("").splitlines() if line]


def _altitude_fault(altitude_m: float) -> str:
    if math.isnan(altitude_m):
        return "is not a number"
    return "is below ground" if altitude_m <= LOWEST_M else "is above the atmosphere's table"


def _is_name(name: str) -> bool:
    parts = name.split("/")
    return all(p and p[0].isalpha() and all(c.isalnum() or c in "._-[]" for c in p) and p.isascii() for p in parts)


def _initial_conditions(state: InitialState, wind: tuple[float, float]) -> dict[str, float]:
    """JSBSim's `ic/` properties, in an order that sets the state exactly."""
    north, east, down = _velocity_over_ground(state, wind)
    phi, theta, psi = euler_angles(state.alpha_deg, state.bank_deg, state.gamma_deg, state.heading_deg)
    return {
        "lat-geod-deg": state.latitude_deg,
        "long-gc-deg": state.longitude_deg,
        "h-sl-ft": state.altitude_m / FT_M,
        "vw-mag-fps": math.hypot(*wind) / FT_M,
        "vw-dir-deg": math.degrees(math.atan2(wind[1], wind[0])),  # direction that the wind blows to
        "vn-fps": north / FT_M,
        "ve-fps": east / FT_M,
        "vd-fps": down / FT_M,
        "phi-rad": phi,
        "theta-rad": theta,
        "psi-true-rad": psi,
    }


def _velocity_over_ground(state: InitialState, wind: tuple[float, float]) -> tuple[float, float, float]:
    gamma, heading = math.radians(state.gamma_deg), math.radians(state.heading_deg)
    level = state.velocity_m_s * math.cos(gamma)
    return (
        level * math.cos(heading) + wind[0],
        level * math.sin(heading) + wind[1],
        -state.velocity_m_s * math.sin(gamma),
    )


def euler_angles(alpha_deg: float, bank_deg: float, gamma_deg: float, heading_deg: float) -> tuple[float, float, float]:
    """Roll, pitch and yaw [rad] of a body without sideslip: R_y(alpha) R_x(bank) R_y(gamma) R_z(heading)."""
    R = _about_y(alpha_deg) @ _about_x(bank_deg) @ _about_y(gamma_deg) @ _about_z(heading_deg)
    return math.atan2(R[1, 2], R[2, 2]), -math.asin(min(max(R[0, 2], -1.0), 1.0)), math.atan2(R[0, 1], R[0, 0])


def _about_x(deg: float) -> FloatArray:
    s, c = math.sin(math.radians(deg)), math.cos(math.radians(deg))
    return np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])


def _about_y(deg: float) -> FloatArray:
    s, c = math.sin(math.radians(deg)), math.cos(math.radians(deg))
    return np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


def _about_z(deg: float) -> FloatArray:
    s, c = math.sin(math.radians(deg)), math.cos(math.radians(deg))
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
