"""Model of a scenario's [trajectory] table: source, start, stop, vehicle state, guidance, dispersions, manoeuvres.

Every angle is in degrees, every velocity is relative to the air unless stated otherwise, and 'mach' is the
true Mach number, V over the local speed of sound ('Mach 20' of the Shuttle's papers is 20,000 ft/s: use
`at_velocity_m_s = 6096`). A schedule is a list of [x, value] pairs, linear between them and constant outside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic
from pydantic import AfterValidator, BaseModel, Discriminator, Field, Tag, field_validator, model_validator

from sim_heating.base.files import Convertible, Location
from sim_heating.base.limits import QUANTITIES, SLOWEST_M_S, low_and_fast, usual_remark
from sim_heating.heating.atmosphere import G0_M_S2, HIGHEST_M, LOWEST_M, us76
from sim_heating.heating.recorded.fields import ConditionField, check_columns, field_or_table
from sim_heating.heating.recorded.plausible import CARRIED_ABOVE_M, CARRIED_KG_M2

Axis = Literal["mach", "velocity_m_s"]
Positive = Annotated[float, Field(gt=0.0)]


def _sorted_schedule(pairs: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    if not pairs:
        raise ValueError("a schedule needs at least one [x, value] pair")
    x = np.array([p[0] for p in pairs])
    if np.any(np.diff(x) <= 0.0) and np.any(np.diff(x) >= 0.0):
        raise ValueError("a schedule's first numbers must all rise or all fall")
    return tuple(sorted(pairs))


Schedule = Annotated[tuple[tuple[float, float], ...], AfterValidator(_sorted_schedule)]
"""[[x, value], ...] with x rising or falling throughout; stored sorted by rising x."""


def _limits(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] >= pair[1]:
        raise ValueError(f"the lower limit {pair[0]} must be below the upper limit {pair[1]}")
    return pair


Limits = Annotated[tuple[float, float], AfterValidator(_limits)]


SLIP_M_S = 1.0
"""Speed [m/s] below which a state is at rest rather than in km/s."""
HIGH_M, GROUND_M = (20e3, 400.0)
"""Altitude [m] from which a flight below SLOWEST_M_S is one in km/s, and below which one of km in m."""

STRONGEST_WIND_M_S = 500.0
SLOWEST_SOUND_M_S = 220.0
"""Speed of sound of the coldest air that has been met, 120 K at the mesopause [m/s]."""


class Initial(Convertible):
    """State at time 0: position on the WGS84 ellipsoid, velocity relative to the air (wind is added to it)."""

    altitude_m: Positive
    velocity_m_s: Positive
    gamma_deg: float = Field(ge=-90.0, le=90.0)
    heading_deg: float
    latitude_deg: float = Field(ge=-90.0, le=90.0)
    longitude_deg: float = 0.0
    bank_deg: float = Field(default=0.0, ge=-180.0, le=180.0)

    @property
    def highest_speed_m_s(self) -> float:
        """Speed that an unpowered flight from here never exceeds [m/s]: that of a fall without drag, and a wind."""
        return math.sqrt(self.velocity_m_s**2 + 2.0 * G0_M_S2 * self.altitude_m) + STRONGEST_WIND_M_S

    def implausible(self) -> list[tuple[Location, str]]:
        """Problems of the numbers, and of altitude [m] and speed [m/s] together."""
        return [*super().implausible(), *state_problems(self.altitude_m, self.velocity_m_s)]

    def unusual(self) -> list[tuple[Location, str]]:
        """Numbers, and an entry [deg] so steep, so slow or so fast as hardly any begins."""
        return [*super().unusual(), *entry_remarks(self.altitude_m, self.velocity_m_s, self.gamma_deg)]


ENTRY_ABOVE_M, ENTRY_FROM_M_S = 85e3, 3e3
"""Altitude [m] and speed [m/s] above which a flight begins as an entry."""
ENTRY_GAMMA_DEG, ENTRY_SPEEDS_M_S = (-25.0, 8.0), (5e3, 12e3)
"""Path angle [deg] and speed [m/s] of entries: skips to ballistic vehicles, suborbital ones to the Moon's."""


INTERFACE_M, INTERFACE_GAMMA_DEG = 110e3, -0.4
"""Altitude [m] from which an entry begins, and the shallowest path angle [deg] there that is no orbit."""


def entry_remarks(altitude_m: float, velocity_m_s: float, gamma_deg: float) -> list[tuple[Location, str]]:
    """(key, text) of what is unusual about the state that an entry begins in; [] for other flights.

    altitude_m, velocity_m_s, gamma_deg : altitude [m], speed [m/s] and path angle [deg]
    """
    q_Pa = 0.5 * us76(min(max(altitude_m, LOWEST_M), HIGHEST_M))[2] * velocity_m_s**2
    if (text := usual_remark("q_Pa", float(q_Pa))) is not None:
        return [(("altitude_m",), f"{altitude_m:g} m at {velocity_m_s:g} m/s: dynamic pressure [Pa] of {text}")]
    if velocity_m_s < SLOWEST_M_S:
        return []
    if CARRIED_ABOVE_M <= altitude_m < ENTRY_ABOVE_M and q_Pa < CARRIED_KG_M2 * G0_M_S2:
        text = f"{velocity_m_s:g} m/s at {altitude_m:g} m is unusual: lift carries {q_Pa / G0_M_S2:.2g} kg/m2 there"
        return [(("velocity_m_s",), f"{text}; check its unit")]
    if altitude_m < ENTRY_ABOVE_M:
        return []
    remarks: list[tuple[Location, str]] = []
    low, high = ENTRY_GAMMA_DEG if altitude_m < INTERFACE_M else (ENTRY_GAMMA_DEG[0], INTERFACE_GAMMA_DEG)
    if velocity_m_s >= ENTRY_FROM_M_S and not low <= gamma_deg <= high:
        text = f"{gamma_deg:g} deg at {altitude_m:g} m is unusual (entries: {low:g} to {high:g}); check it"
        remarks.append((("gamma_deg",), text))
    low, high = ENTRY_SPEEDS_M_S
    if not low <= velocity_m_s <= high:
        text = f"{velocity_m_s:g} m/s at {altitude_m:g} m is unusual (entries: {low:g} to {high:g}); check its unit"
        remarks.append((("velocity_m_s",), text))
    return remarks


def state_problems(altitude_m: float, velocity_m_s: float) -> list[tuple[Location, str]]:
    """Problems of a state in free flight: a speed in km/s or an altitude in km, by what the other one is.

    altitude_m, velocity_m_s : altitude [m] and speed [m/s]
    returns                  : (key, text) of each problem

    A body at rest at 20 km falls at 20 m/s after 2 s, so that a state between rest and this speed is not worth a flight
    from there; within 400 m of the ground a flight at such a speed is over after seconds.
    """
    slow = SLIP_M_S <= velocity_m_s < SLOWEST_M_S
    high, low = altitude_m >= HIGH_M, 10.0 <= altitude_m < GROUND_M
    problems: list[tuple[Location, str]] = []
    if low_and_fast(altitude_m, velocity_m_s) or (slow and low):
        question = QUANTITIES["altitude_m"].suggestion(altitude_m)
        problems.append((("altitude_m",), f"{altitude_m:g} m at {velocity_m_s:g} m/s is no entry{question}"))
    if slow and (high or low):
        question = QUANTITIES["velocity_m_s"].suggestion(velocity_m_s)
        problems.append((("velocity_m_s",), f"{velocity_m_s:g} m/s at {altitude_m:g} m is no entry{question}"))
    return problems


MACH_COUNTS_BELOW_M = 90.0e3
"""Mach ends a flight below this altitude only: in the hot air above it is low."""


class Stop(Convertible):
    """The flight ends at the first of these, each passed from above (time from below); Mach counts below 90 km."""

    quantities: ClassVar = {"velocity_m_s": "flight_speed_m_s", "mach": "at_mach"}

    mach: Positive | None = None
    velocity_m_s: Positive | None = None
    altitude_m: float | None = None
    time_s: Positive = 3000.0

    def passed(self, time_s: float, altitude_m: float, velocity_m_s: float, mach: float) -> bool:
        """Whether a flight in this state ([s], [m], [m/s], Mach [-]) has ended."""
        return (
            time_s >= self.time_s - 1e-9
            or (self.altitude_m is not None and altitude_m <= self.altitude_m)
            or (self.velocity_m_s is not None and velocity_m_s <= self.velocity_m_s)
            or (self.mach is not None and mach <= self.mach and altitude_m < MACH_COUNTS_BELOW_M)
        )

    def fraction_done(self, first_velocity_m_s: float, velocity_m_s: float, time_s: float) -> float:
        """Fraction [-] of a flight that is done, by velocity lost or by time, 0 to 1."""
        # For the display of progress alone: some 300 m/s for Mach 1.
        last = self.velocity_m_s or 300.0 * (self.mach or 0.0)
        by_speed = (first_velocity_m_s - velocity_m_s) / max(first_velocity_m_s - last, 1.0)
        return float(min(max(by_speed, time_s / self.time_s, 0.0), 1.0))


class VehicleState(Convertible):
    """The vehicle as flown; absent keys are the vehicle's own values.

    cg_fraction : centre of gravity from the nose over the reference length
    bodyflap_deg: body flap [[mach or velocity_m_s, deg]]; by default the one that trims the vehicle along the
                  angle-of-attack schedule with the elevon at its own scheduled deflection
    cm_shift    : flight-derived hypersonic pitching-moment shift: true for the vehicle's own value, or a number
    bodyflap_against : what the body-flap schedule is over
    """

    quantities: ClassVar = {"bodyflap_deg": ("bodyflap_against", "bodyflap_deg")}

    mass_kg: Positive | None = None
    cg_fraction: float | None = Field(default=None, gt=0.0, lt=1.0)
    bodyflap_deg: Schedule | None = None
    bodyflap_against: Axis = "mach"
    cm_shift: bool | float = True


class Approach(Convertible):
    """Below `below_mach`: angle of attack flies a reference dynamic pressure, bank is small, then a flare.

    qbar_Pa : reference dynamic pressure [[mach, Pa]]
    bank_deg: bank magnitude (a turn that ends where the heading error is zero, or steady without a target)
    damping : damping ratio of the law of dynamic pressure [-]
    """

    quantities: ClassVar = {"qbar_Pa": ("at_mach", "qbar_Pa")}

    below_mach: Positive = 2.5
    qbar_Pa: Schedule
    alpha_limits_deg: Limits = (0.0, 20.0)
    bank_deg: float = Field(default=0.0, ge=0.0, le=60.0)
    frequency_rad_s: Positive = 0.08
    damping: Positive = 0.8
    flare_altitude_m: float = Field(default=700.0, ge=0.0)
    flare_time_s: Positive = 10.0


class Target(Convertible):
    """Target of the heading error; bank reverses when the error leaves the deadband."""

    latitude_deg: float = Field(ge=-90.0, le=90.0)
    longitude_deg: float
    deadband_deg: Positive = 12.0


class Guidance(Convertible):
    """Entry guidance; a vehicle's guidance.toml gives the defaults, a scenario replaces single keys.

    alpha_deg       : angle-of-attack schedule [[x, deg]] with x as in alpha_against
    drag_m_s2       : reference drag acceleration [[velocity_m_s, m/s2]]
    start_drag_m_s2 : bank is `initial.bank_deg` below this drag
    reversals_m_s   : velocities at which bank changes sign (or `target`, on heading error)
    bank_limits_deg : magnitude of bank, smallest and largest
    frequency_rad_s, damping : natural frequency [rad/s] and damping ratio [-] with which drag follows its reference
    scale_height_m : of the density, in the altitude-rate law
    alpha_against : what the schedule of the angle of attack is over
    first_bank : side of the first bank
    """

    quantities: ClassVar = {"alpha_deg": ("alpha_against", "alpha_deg"), "drag_m_s2": ("velocity_m_s", "drag_m_s2")}

    alpha_deg: Schedule
    alpha_against: Axis = "mach"
    alpha_limits_deg: Limits = (0.0, 50.0)
    alpha_rate_deg_s: Positive = 2.0
    drag_m_s2: Schedule
    start_drag_m_s2: Positive = 0.05
    bank_limits_deg: Limits = (0.0, 110.0)
    bank_rate_deg_s: Positive = 5.0
    first_bank: Literal["right", "left"] = "right"
    reversals_m_s: tuple[Positive, ...] = ()
    target: Target | None = None
    frequency_rad_s: Positive = 0.025
    damping: Positive = 0.9
    scale_height_m: Positive = 7000.0
    approach: Approach | None = None

    @model_validator(mode="after")
    def _check_reversals(self) -> Guidance:
        if self.reversals_m_s and self.target is not None:
            raise ValueError("bank reverses at reversals_m_s or towards a target, not both: remove one")
        return self


def _with_optional_fields(model: type[BaseModel]) -> Any:
    """A table with the keys and rules of a model, in which every key may be absent (None)."""
    fields: dict[str, Any] = {}
    for name, field in model.model_fields.items():
        kind: Any = Annotated[(field.annotation, *field.metadata)] if field.metadata else field.annotation
        fields[name] = (kind | None, None)
    return pydantic.create_model(f"Optional{model.__name__}", __base__=Convertible, __doc__=model.__doc__, **fields)


_OptionalGuidance: Any = _with_optional_fields(Guidance)


class GuidanceChanges(_OptionalGuidance):
    """Keys of the vehicle's guidance.toml that a scenario replaces."""

    quantities: ClassVar = Guidance.quantities


class Dispersions(Convertible):
    """Differences of the atmosphere from US76: a density factor and a steady wind, over altitude.

    density_factor : density over that of US76, [[altitude_m, factor], ...]
    wind_north_m_s, wind_east_m_s : wind over altitude, [[altitude_m, m/s], ...]
    """

    quantities: ClassVar = {
        "density_factor": ("altitude_m", "density_factor"),
        "wind_north_m_s": ("altitude_m", "wind_m_s"),
        "wind_east_m_s": ("altitude_m", "wind_m_s"),
    }

    density_factor: tuple[tuple[float, Positive], ...] | None = None
    wind_north_m_s: Schedule | None = None
    wind_east_m_s: Schedule | None = None

    @model_validator(mode="after")
    def _sort_density(self) -> Dispersions:
        if self.density_factor is not None:
            object.__setattr__(self, "density_factor", _sorted_schedule(self.density_factor))
        return self

    @property
    def schedules(self) -> list[Sequence[tuple[float, float]]]:
        """Density factor [-], wind to north and to east [m/s] over altitude [m], as `schedules.pack` takes them."""
        return [self.density_factor or ((0.0, 1.0),), self.wind_north_m_s or (), self.wind_east_m_s or ()]


class _Triggered(Convertible):
    """A manoeuvre starts when speed or Mach falls through a value, or at a time: exactly one of the three."""

    at_velocity_m_s: Positive | None = None
    at_mach: Positive | None = None
    at_time_s: Annotated[float, Field(ge=0.0)] | None = None

    @model_validator(mode="after")
    def _check_trigger(self) -> _Triggered:
        triggers = [k for k in ("at_velocity_m_s", "at_mach", "at_time_s") if getattr(self, k) is not None]
        if len(triggers) != 1:
            raise ValueError(
                "give exactly one of at_velocity_m_s, at_mach, at_time_s, not " + (" and ".join(triggers) or "none")
            )
        return self


Hold = Annotated[float, Field(ge=0.0)]
Amplitude = Annotated[float, Field(ge=0.0)]


class Popu(_Triggered):
    """Pushover-pullup: angle of attack down, up and back, relative to the scheduled one.

    first  : "down" (STS-2) or "up" (STS-4: the pull-up first)
    hold_s : time at the pushed-over and at the pulled-up angle; `hold_down_s`, `hold_up_s` replace it for one of them
    kind : "popu"
    """

    kind: Literal["popu"]
    down_deg: Amplitude = 5.0
    up_deg: Amplitude = 5.0
    rate_deg_s: Positive = 1.0
    hold_s: Hold = 2.0
    hold_down_s: Hold | None = None
    hold_up_s: Hold | None = None
    first: Literal["down", "up"] = "down"


class _SurfacePulse(_Triggered):
    """A control surface goes by `amplitude_deg` (sign kept), holds, returns, `count` times with `pause_s` between.

    count : number of pulses
    alternate : true: every second pulse goes the other way
    alpha : "held": the angle of attack is held during the manoeuvre; "free": it follows the surface
    """

    amplitude_deg: float
    rate_deg_s: Positive
    hold_s: Hold = 4.0
    pause_s: Hold = 4.0
    count: int = Field(default=1, ge=1, le=100)
    alternate: bool = False
    alpha: Literal["held", "free"] = "held"


class ElevonPulse(_SurfacePulse):
    """Elevon pulse about the trimmed value; `alpha = "held"`: jets hold the angle, "free": the pitch loop is open.

    kind : "elevon-pulse"
    """

    kind: Literal["elevon-pulse"]
    rate_deg_s: Positive = 10.0


class BodyflapPulse(_SurfacePulse):
    """Body-flap pulse about the scheduled value; with `alpha = "held"` the elevon takes up the moment.

    kind : "bodyflap-pulse"
    """

    kind: Literal["bodyflap-pulse"]
    rate_deg_s: Positive = 1.5


class _SurfaceSweep(_Triggered):
    """A control surface goes to `from_deg`, sweeps to `to_deg` at `rate_deg_s`, holds, and returns; all relative.

    alpha : "held": the angle of attack is held during the manoeuvre; "free": it follows the surface
    """

    from_deg: float = 0.0
    to_deg: float
    rate_deg_s: Positive
    hold_s: Hold = 0.0
    alpha: Literal["held", "free"] = "held"


class ElevonSweep(_SurfaceSweep):
    """Slow elevon sweep about the trimmed value, jets holding the angle of attack.

    kind : "elevon-sweep"
    """

    kind: Literal["elevon-sweep"]
    rate_deg_s: Positive = 1.0


class BodyflapSweep(_SurfaceSweep):
    """Slow body-flap sweep about the scheduled value, the elevon following in trim.

    kind : "bodyflap-sweep"
    """

    kind: Literal["bodyflap-sweep"]
    rate_deg_s: Positive = 1.0


class SideslipDoublet(_Triggered):
    """Sideslip to +amplitude, hold, to -amplitude, hold, and back.

    kind : "sideslip-doublet"
    """

    quantities: ClassVar = {"amplitude_deg": "sideslip_amplitude_deg"}

    kind: Literal["sideslip-doublet"]
    amplitude_deg: float = 2.0
    rate_deg_s: Positive = 0.5
    hold_s: Hold = 4.0


class JetFiring(_Triggered):
    """Reaction jets on at `level` (0 to 1) for `on_s`, `count` times with `off_s` between; `rise_s` to full thrust.

    level : part of the jets that fire [-]
    count : number of firings
    kind : "jet-firing"
    """

    kind: Literal["jet-firing"]
    level: float = Field(default=1.0, gt=0.0, le=1.0)
    on_s: Positive = 2.0
    off_s: Positive = 2.0
    count: int = Field(default=1, ge=1, le=1000)
    rise_s: Positive = 0.1


Manoeuvre = Annotated[
    Popu | ElevonPulse | ElevonSweep | BodyflapPulse | BodyflapSweep | SideslipDoublet | JetFiring,
    Field(discriminator="kind"),
]


class FmuVariable(Convertible):
    """A variable of an FMU and its unit, by default the one that the FMU declares.

    variable : name of the variable in the FMU
    """

    variable: str
    unit: str | None = None


class FmuValue(Convertible):
    """A start value with its unit.

    value : the value, in `unit`
    """

    value: float
    unit: str


Command = Literal["alpha_deg", "bank_deg", "beta_deg", "elevon_deg", "bodyflap_deg", "jets"]


class FmuInput(Convertible):
    """Source of an input of an FMU: a command of guidance and manoeuvres, or a schedule [[time_s, value], ...].

    unit : unit of the schedule, or of the input where the FMU declares none; a command is converted from its own
    command : a command of guidance and manoeuvres
    schedule : values over time, [[time_s, value], ...]
    """

    quantities: ClassVar = {"schedule": None}

    command: Command | None = None
    schedule: Schedule | None = None
    unit: str | None = None

    @model_validator(mode="after")
    def _check_source(self) -> FmuInput:
        if (self.command is None) == (self.schedule is None):
            raise ValueError("give either `command` or `schedule`")
        return self


class FmuSource(Convertible):
    """An FMU as a trajectory: the meaning of its variables.

    interface: interface to use where the FMU has both; co-simulation by default
    columns  : column -> variable, variable with unit, or a constant; columns that are absent are found by usual names
    start    : parameter or input -> start value, in the FMU's unit or with one
    inputs   : input -> its source; an input that is absent keeps its start value
    tolerance: relative tolerance of the solver
    timeout_s: longest time of one call into the FMU [s]
    """

    quantities: ClassVar = {"columns": None, "start": None, "inputs": None}

    interface: Literal["co-simulation", "model-exchange"] | None = None
    columns: dict[str, str | Annotated[float, Field(strict=True)] | FmuVariable] = Field(default={})
    start: dict[str, bool | int | float | str | FmuValue] = Field(default={})
    inputs: dict[str, Command | FmuInput] = Field(default={})
    tolerance: Positive | None = None
    timeout_s: Positive = 30.0

    @field_validator("start", "inputs", mode="before")
    @classmethod
    def _check_dotted_names(cls, tables: Any, info: pydantic.ValidationInfo) -> Any:
        """Rejects a name with dots and without quotes, which TOML reads as a table."""
        keys = (FmuValue if info.field_name == "start" else FmuInput).model_fields
        for name, table in tables.items() if isinstance(tables, dict) else ():
            if isinstance(table, dict) and table and not keys.keys() & table.keys():
                raise ValueError(f'write a name with dots in quotes, "{name}.{next(iter(table))}" = ...')
        return tables

    @property
    def commands(self) -> set[str]:
        """Commands [deg] of guidance and manoeuvres that the FMU takes."""
        sources = {i if isinstance(i, str) else i.command for i in self.inputs.values()}
        return {command for command in sources if command is not None}


class TrajectorySpec(Convertible):
    """How a flight comes about: flown by guidance, read from a file, or by an FMU.

    source  : "jsbsim": six degrees of freedom in JSBSim; "entry-3dof": the built-in entry; "recorded": a CSV; "fmu"
    rate_hz : integration frames a second (communication steps of an FMU); default 60, 4 for the 3-DOF entry
    sample_s: interval of the stored conditions
    file    : recorded CSV or FMU, relative to the scenario
    fields  : column of flight conditions -> field of the recorded file, with its unit, or a constant; by the names and
              units in the file where absent
    manoeuvre : what is flown besides guidance; `kind` names the manoeuvre
    """

    source: Literal["jsbsim", "entry-3dof", "recorded", "fmu"]
    rate_hz: float = Field(default=60.0, gt=0.0, le=2000.0)
    sample_s: Positive = 1.0
    file: str | None = None
    fields: dict[
        str,
        Annotated[
            Annotated[str, Tag("field")] | Annotated[ConditionField, Tag("table")], Discriminator(field_or_table)
        ],
    ] = Field(default={})
    initial: Initial | None = None
    stop: Stop = Stop()
    vehicle: VehicleState = VehicleState()
    guidance: GuidanceChanges = GuidanceChanges()
    dispersions: Dispersions = Dispersions()
    manoeuvre: tuple[Manoeuvre, ...] = ()
    fmu: FmuSource = FmuSource()

    @model_validator(mode="before")
    @classmethod
    def _default_frame_rate(cls, data: object) -> object:
        # A point mass has no attitude motion to resolve: its fourth-order steps of 0.25 s suffice where JSBSim needs 60
        # Hz.
        if isinstance(data, dict) and data.get("source") == "entry-3dof":
            return {"rate_hz": 4.0} | data
        return data

    @field_validator("fields")
    @classmethod
    def _check_fields(cls, fields: dict[str, Any]) -> dict[str, Any]:
        return check_columns(fields)

    def _check_recorded(self) -> None:
        if self.file is None:
            raise ValueError('source = "recorded" needs `file`, a CSV of flight conditions')
        if self.manoeuvre or self.initial is not None:
            raise ValueError("a recorded flight cannot be changed: remove `initial` and the manoeuvres")

    @model_validator(mode="after")
    def _check_source(self) -> TrajectorySpec:
        if self.source == "recorded":
            self._check_recorded()
            return self
        if self.fields:
            raise ValueError('[trajectory.fields] names fields of a file: it goes with source = "recorded"')
        if self.source == "fmu":
            self._check_fmu()
        elif self.initial is None:
            raise ValueError(f'source = "{self.source}" needs [trajectory.initial]')
        elif self.file is not None:
            raise ValueError(f'source = "{self.source}" does not read a file: remove `file`')
        if self.source == "entry-3dof" and any(getattr(m, "alpha", "held") == "free" for m in self.manoeuvre):
            raise ValueError(
                'a manoeuvre with `alpha = "free"` needs attitude, which source = "entry-3dof" has not: fly "jsbsim", '
                'or set alpha = "held"'
            )
        if self.sample_s < 1.0 / self.rate_hz - 1e-9:
            raise ValueError(f"sample_s = {self.sample_s} is shorter than one frame, {1.0 / self.rate_hz:.4g} s")
        return self

    def implausible(self) -> list[tuple[Location, str]]:
        """Triggers of manoeuvres ([s], [m/s] or Mach [-]) that a fall from the initial state never reaches."""
        problems = super().implausible()
        if self.initial is None:
            return problems
        fastest = self.initial.highest_speed_m_s
        start = f"from {self.initial.velocity_m_s:g} m/s at {self.initial.altitude_m:g} m"
        for i, m in enumerate(self.manoeuvre):
            if m.at_velocity_m_s is not None and m.at_velocity_m_s > fastest:
                problems.append((("manoeuvre", i, "at_velocity_m_s"), f"{m.at_velocity_m_s:g} is not reached {start}"))
            if m.at_mach is not None and m.at_mach * SLOWEST_SOUND_M_S > fastest:
                most = fastest / SLOWEST_SOUND_M_S
                rule = f"Mach {m.at_mach:g} is not reached {start}, at most {most:.3g}"
                problems.append((("manoeuvre", i, "at_mach"), rule))
        return problems

    def _check_fmu(self) -> None:
        if self.file is None:
            raise ValueError('source = "fmu" needs `file`, an FMU')
        if self.initial is not None:
            raise ValueError("an FMU starts from its own start values: remove `initial`, give [trajectory.fmu.start]")
