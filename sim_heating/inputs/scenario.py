"""A scenario: vehicle, trajectory, control points, simulated measurements, and differences between truth and tables.

format = "scenario/1"
title = "..."
flight = "STS-2"                    # name of the flight in the records of `synthesize`; the file's name where absent
vehicle = "orbiter"                 # a vehicle's name, or its directory relative to the scenario
control_points = ["V09T9527"]       # all where absent
[trajectory]                        # trajectory/spec.py, with [[trajectory.manoeuvre]]
[heating]                           # longest_step_s, alongside; transition, catalysis: whether those declared act
[[effect]]                          # declared in addition to the vehicle's: name, control_points, parameters, window
[measurements]                      # seed, clock_skew_s, lost samples, gaps, errors of sensors
[truth]                             # altered by `synthesize`, not declared: parameters, [[truth.effect]]
[[compare]]                         # measured histories to compare the prediction with
[design]                            # parameters that the manoeuvres are to determine, and how they may be changed
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from sim_heating.base import files
from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError, error_context
from sim_heating.base.files import CsvTable, Declared, LocatedError, Location, display_path
from sim_heating.base.files.units import converted, name_and_unit
from sim_heating.base.limits import HOTTEST_K, QUANTITIES
from sim_heating.base.parameters import MODEL, PRESSURE_FACTOR, layer_parameter
from sim_heating.heating.edge_flow import EdgeFlow
from sim_heating.heating.effects import EffectUse, Window, use
from sim_heating.heating.effects.recombination import RECOMBINATION
from sim_heating.heating.effects.transition import TRANSITION
from sim_heating.heating.recorded.layout import read_fields, states_columns
from sim_heating.inputs.declared_effects import KEYS
from sim_heating.inputs.pressure_transducer import PressureTransducer
from sim_heating.inputs.record import Segments
from sim_heating.inputs.vehicle import Vehicle, load_vehicle, vehicle_place
from sim_heating.thermal.sampling import RATE_TEXT, SampleRate
from sim_heating.thermal.stack import Sensor
from sim_heating.trajectory.spec import TrajectorySpec


class HeatingOptions(Declared):
    """Options of the heating computed along the flight."""

    quantities: ClassVar = {"T_surroundings_K": ("time_s", "T_surroundings_K"), "T_back_K": ("time_s", "T_back_K")}

    longest_step_s: float = Field(default=1.0, gt=0.0, le=60.0, description="longest thermal step in s")
    alongside: bool = Field(default=False, description="step the plug-in alongside the host and compare")
    T_surroundings_K: list[list[float]] | None = Field(default=None, min_length=1, description="[[time_s, K], ...]")
    T_back_K: list[list[float]] | None = Field(default=None, min_length=1, description="[[time_s, K], ...]")
    transition: bool = Field(default=True, description="false: without the transition that the vehicle declares")
    catalysis: bool = Field(default=True, description="false: fully catalytic walls, without declared recombination")

    @field_validator("T_surroundings_K", "T_back_K")
    @classmethod
    def _check_schedule(cls, schedule: list[list[float]] | None) -> list[list[float]] | None:
        problems: list[tuple[Location, str]] = []
        for i, row in enumerate(schedule or []):
            if len(row) != 2:
                problems.append(((i,), f"{row} is not a pair [time_s, K]"))
            elif not 1.0 <= row[1] <= HOTTEST_K:
                problems.append(((i, 1), f"{row[1]:g} is not a temperature in K (1 to {HOTTEST_K:g})"))
            elif i > 0 and len(schedule[i - 1]) == 2 and row[0] <= schedule[i - 1][0]:  # type: ignore[index]
                problems.append(((i, 0), f"{row[0]:g} does not come after {schedule[i - 1][0]:g}"))  # type: ignore[index]
        files.raise_located(problems)
        return schedule

    @model_validator(mode="after")
    def _check_alongside(self) -> HeatingOptions:
        if self.alongside and self.schedules:
            names = " and ".join(f"`{name}`" for name in self.schedules)
            raise LocatedError((("alongside",), f"a host gives no {names}; remove them, or set alongside = false"))
        return self

    @property
    def schedules(self) -> dict[str, FloatArray]:
        """Columns of flight conditions that are declared: name -> (row, 2) time [s] and value."""
        declared = {name: getattr(self, name) for name in ("T_surroundings_K", "T_back_K")}
        return {name: np.array(rows, dtype=float) for name, rows in declared.items() if rows is not None}

    @property
    def left_out(self) -> dict[str, str]:
        """Effects of the vehicle that the scenario leaves out, each with the key that says so."""
        return {effect: key for key, effect in KEYS.items() if not getattr(self, key)}


class EffectWindow(Declared):
    """Range of a flight condition within which an effect acts: NAME-WINDOW is then the name of the effect.

    low, high : ends of the range, in the unit of the column
    """

    quantities: ClassVar = {"low": "variable", "high": "variable", "ramp": None}

    name: str = Field(pattern="^[a-z0-9-]+$", description="name of the window, of small letters, digits and hyphens")
    variable: str = Field(description="flight condition by the name of its column, such as mach")
    low: float
    high: float
    ramp: float = Field(default=0.0, description="width of the rise to all of the effect at either end; 0 for a jump")

    @property
    def window(self) -> Window:
        """The window that it declares."""
        return Window(self.name, self.variable, self.low, self.high, self.ramp)


class ScenarioEffect(Declared):
    """An effect at the named control points, at all where none is named.

    name : name of an effect
    parameters : values by name; absent ones are nominal
    window : range of a flight condition within which it acts; always where absent
    """

    quantities: ClassVar = {"parameters": None}

    name: str
    control_points: list[str] | None = None
    parameters: dict[str, float] = Field(default={})
    window: EffectWindow | None = None

    def use(self) -> EffectUse:
        """The effect with its parameters, within its window."""
        return use(self.name, self.parameters, None if self.window is None else self.window.window)


class SensorFault(Declared):
    """A sensor's offset, gain error, drift, and a lag that is not the declared one.

    sensor : name of the sensor
    """

    sensor: str
    bias_K: float = 0.0
    gain: float = Field(default=1.0, gt=0.0, description="gain, above 0")
    drift_K_s: float = Field(default=0.0, description="rate of a bias that begins with the first sample in K/s")
    tau_s: float | None = Field(default=None, ge=0.0, description="true time constant in s, in place of the declared")


class Measurements(Declared):
    """Sampling, clock and faults of the measurements that `synthesize` makes."""

    quantities: ClassVar = {"rate_hz": ("time_s", "rate_hz")}

    seed: int = Field(default=1, ge=0, description="a whole number, 0 or above")
    rate_hz: SampleRate | None = Field(default=None, description=f"{RATE_TEXT}; the sensors' own where absent")
    sample_offset_s: float = Field(default=0.0, description="time of the first sample after the start in s")
    clock_skew_s: float = Field(default=0.0, description="recorded T(t) = true T(t - skew) in s")
    jet_q_fraction: float = Field(
        default=0.0, gt=-1.0, le=10.0, description="relative error of the dynamic pressure while jets fire"
    )
    lost_fraction: float = Field(default=0.0, ge=0.0, lt=1.0, description="fraction of samples lost at random")
    gaps_s: list[list[float]] = Field(default=[], description="[[start_s, end_s], ...] without telemetry")
    fault: list[SensorFault] = Field(default=[])

    @field_validator("gaps_s")
    @classmethod
    def _check_gaps(cls, gaps: list[list[float]]) -> list[list[float]]:
        for gap in gaps:
            if len(gap) != 2 or gap[0] > gap[1]:
                raise ValueError(f"{gap} is not a gap; give [start_s, end_s] with start before end")
        return gaps


class Truth(Declared):
    """Differences of the truth from the declared tables, written to truth.toml and not into the record."""

    quantities: ClassVar = {"parameters": None}

    parameters: dict[str, float] = Field(default={}, description="dotted model parameters by name")
    effect: list[ScenarioEffect] = Field(default=[])
    p_surface_factor: float = Field(
        default=PRESSURE_FACTOR.value, ge=PRESSURE_FACTOR.lower, le=PRESSURE_FACTOR.upper,
        description=PRESSURE_FACTOR.text,
    )  # fmt: skip

    @field_validator("parameters")
    @classmethod
    def _check_parameters(cls, parameters: dict[str, float]) -> dict[str, float]:
        for name in parameters:
            of_layer = layer_parameter(name)
            if name not in MODEL and of_layer is None:
                raise ValueError(f"unknown parameter `{name}`{files.suggestion(name, MODEL, otherwise='')}")
            p = MODEL[name] if of_layer is None or name in MODEL else of_layer[1]
            low, high = p.lower, p.upper
            if not low <= parameters[name] <= high:
                raise ValueError(f"{name}: {parameters[name]:g} is outside its bounds {low:g} to {high:g}")
        return parameters


class Compare(Declared):
    """A measured surface-temperature history of a control point: CSV with time_s, temperature_K and sigma_K.

    label : name of the history in pictures and tables
    """

    control_point: str
    file: str = Field(description="CSV relative to the vehicle's directory, or to the scenario")
    label: str
    until_s: float | None = Field(default=None, description="end of the comparison in s, all where absent")
    fit_s: list[list[float]] | None = Field(default=None, description="fit segments of a record made of it, in s")
    holdout_s: list[list[float]] = Field(default=[], description="segments that are held out there, in s")
    noise_correlation_s: float | None = Field(
        default=None,
        gt=0.0,
        description="time over which the errors of its rows change, for that record; white without",
    )
    source: str = Field(default="", description="where the history comes from, for the record made of it")
    confidence: str = Field(default="", description="A read in a data set, B known from the literature, C judged")


class DesignVariable(Declared):
    """A number of a manoeuvre that a design may change, between `low` and `high`.

    low, high : least and greatest value, in the unit of the key
    """

    quantities: ClassVar = {"low": "key", "high": "key"}

    manoeuvre: int = Field(default=1, ge=1, description="number of the manoeuvre in the scenario, from 1")
    key: str = Field(description="key of the manoeuvre")
    low: float
    high: float


class DesignLimits(Declared):
    """Limits of a designed flight; temperature limits are those of the scenario's control points.

    surface_margin_K, bondline_margin_K : least distance of the peaks of the whole flight from the limits
    alpha_deg, elevon_deg, qbar_Pa      : [low, high] during the manoeuvres and `after_s` after them
    altitude_change_m                   : from the flight without manoeuvres, over the same time
    duration_s                          : of one manoeuvre
    """

    surface_margin_K: float = 0.0
    bondline_margin_K: float = 0.0
    alpha_deg: list[float] = Field(default=[30.0, 48.0], description="[low, high] in deg")
    elevon_deg: list[float] = Field(default=[-20.0, 15.0], description="[low, high] in deg")
    qbar_Pa: list[float] = Field(default=[0.0, 16000.0], description="[low, high] in Pa")
    altitude_change_m: float = Field(default=3000.0, gt=0.0, description="in m, above 0")
    duration_s: float = Field(default=60.0, gt=0.0, description="in s, above 0")

    @field_validator("alpha_deg", "elevon_deg", "qbar_Pa")
    @classmethod
    def _check_range(cls, pair: list[float]) -> list[float]:
        if len(pair) != 2 or not pair[0] < pair[1]:
            raise ValueError(f"{pair} is not a range; give [low, high]")
        return pair


class InstrumentSet(Declared):
    """Instruments that a design compares with the declared ones.

    sensor, transducer : in place of the control point's
    bits, range_K, rate_hz : of all thermocouples, scaled alike, in place of their own
    prior  : standard deviation of parameters before the flight, by dotted name, in place of the design's
    """

    quantities: ClassVar = {"prior": None, "rate_hz": ("time_s", "rate_hz")}

    name: str = Field(min_length=1, description="name of the set")
    sensor: list[Sensor] | None = Field(
        default=None, min_length=1, description="[[design.instruments.sensor]], in place of the control point's"
    )
    transducer: list[PressureTransducer] | None = Field(
        default=None, description="[[design.instruments.transducer]], in place of the control point's"
    )
    bits: int | None = Field(default=None, ge=1, le=32, description="bits of the recorder word of all")
    range_K: list[float] | None = Field(default=None, description="[lowest, highest] of all in K")
    rate_hz: SampleRate | None = Field(default=None, description=f"of all: {RATE_TEXT}")
    prior: dict[str, Annotated[float, Field(gt=0.0)]] = Field(
        default={}, description="standard deviations above 0, by dotted name"
    )

    def sensors(self, declared: Sequence[Sensor]) -> tuple[Sensor, ...]:
        """The thermocouples of the set, of which `declared` are those of the control point.

        raises : InputError, one line a problem, where a sensor does not go with the words of the set
        """
        words = {k: v for k, v in (("bits", self.bits), ("range_K", self.range_K)) if v is not None}
        of_set = self.sensor if self.sensor is not None else declared
        where = f"[[design.instruments]] {self.name}"
        return tuple(files.check(s.model_dump(exclude_none=True) | words, Sensor, where) for s in of_set)


class Design(Declared):
    """Aim of the design of a scenario's manoeuvres.

    control_point  : the one whose thermocouples are read; by default the scenario's first with thermocouples
    parameters     : parameters whose bounds are minimised; by default those of the kind of manoeuvre
    nuisance       : further unknown parameters; by default magnitude, derivatives, coating, conductivity, skew,
    pressure
    prior          : standard deviation of parameters before the flight, by dotted name
    criterion      : "D": volume of the bounds' ellipsoid; "A": mean square of the bounds over the planned ones
    start          : "profile": temperatures before the manoeuvre are unknown; "declared": known from entry interface on
    before_s, after_s : time of the samples that are used before and after a manoeuvre
    evaluations    : number of designs that the search evaluates
    flights        : numbers of equal flights for which bounds are reported
    instruments    : that are compared with the declared ones; by default words, rates, clocks and places
    """

    quantities: ClassVar = {"prior": None}

    control_point: str | None = None
    parameters: list[str] | None = Field(default=None, min_length=1)
    nuisance: list[str] | None = None
    prior: dict[str, float] = Field(default={}, description="standard deviations above 0, by dotted name")
    criterion: Literal["D", "A"] = "D"
    start: Literal["profile", "declared"] = "profile"
    before_s: float = Field(default=20.0, ge=0.0, le=1000.0)
    after_s: float = Field(default=40.0, ge=0.0, le=1000.0)
    evaluations: int = Field(default=64, ge=1, le=100_000)
    flights: list[int] = Field(default=[1, 2, 4], min_length=1)
    vary: list[DesignVariable] = Field(default=[])
    limits: DesignLimits = DesignLimits()
    instruments: list[InstrumentSet] = Field(default=[], description="[[design.instruments]], sets to compare")

    @field_validator("prior")
    @classmethod
    def _check_prior(cls, prior: dict[str, float]) -> dict[str, float]:
        for name, sigma in prior.items():
            if not sigma > 0.0:
                raise ValueError(f"{name}: {sigma:g} is not a standard deviation; give one above 0")
        return prior

    @field_validator("flights")
    @classmethod
    def _check_flights(cls, flights: list[int]) -> list[int]:
        if min(flights) < 1:
            raise ValueError(f"{min(flights)} is not a number of flights; give 1 or more")
        if (number := files.repeated_name([str(n) for n in flights])) is not None:
            raise ValueError(f"{number} is repeated; list each number of flights once")
        return flights


class ScenarioFile(Declared):
    """Contents of a scenario file."""

    format: str = Field(pattern="^scenario/1$", description='"scenario/1"')
    title: str
    flight: str = Field(default="", description="name of the flight in records; the file's name where absent")
    vehicle: str
    note: str = ""
    control_points: list[str] | None = None
    trajectory: TrajectorySpec
    heating: HeatingOptions = HeatingOptions()
    effect: list[ScenarioEffect] = Field(default=[])
    measurements: Measurements = Measurements()
    truth: Truth = Truth()
    compare: list[Compare] = Field(default=[])
    design: Design | None = None


@dataclass(frozen=True)
class MeasuredHistory:
    """A measured history to compare with: (sample,) times [s] and temperatures [K] with their sigma [K].

    segments : fit and holdout segments of the record made from it
    noise_correlation_s : time over which the errors of its rows change [s]; None where these are independent
    source, confidence : of the history, as stated; empty where they are not
    """

    control_point: str
    label: str
    time_s: np.ndarray
    temperature_K: np.ndarray
    sigma_K: np.ndarray
    segments: Segments = field(default_factory=Segments)
    noise_correlation_s: float | None = None
    source: str = ""
    confidence: str = ""


@dataclass(frozen=True)
class Scenario:
    """A checked scenario with its vehicle, which is without the effects that the scenario leaves out.

    names    : selected control points, in order
    compare  : measured histories
    """

    path: Path
    declared: ScenarioFile
    vehicle: Vehicle
    names: tuple[str, ...]
    compare: tuple[MeasuredHistory, ...]

    def __repr__(self) -> str:
        return f"<Scenario {(self.title or self.path.stem)!r}: {self.vehicle.name}, {len(self.names)} control points>"

    @property
    def title(self) -> str:
        """Title of the scenario."""
        return self.declared.title

    @property
    def flight(self) -> str:
        """Name of the flight in records: the declared one, else the name of the scenario's file."""
        return self.declared.flight or self.path.stem

    @property
    def files(self) -> tuple[Path, ...]:
        """Files and directories that it is made from; no results may replace them."""
        flown = self.declared.trajectory.file
        compared = (_history_folder(self.path, self.vehicle, c.file) / c.file for c in self.declared.compare)
        return (self.path, self.vehicle.directory, *compared, *([] if flown is None else [Path(flown)]))

    def effects(self, point: str, *, truth: bool = False) -> tuple[EffectUse, ...]:
        """Effects that the scenario adds to a control point of its vehicle, with `truth` the undeclared ones too."""
        chosen = [*self.declared.effect, *(self.declared.truth.effect if truth else [])]
        return tuple(e.use() for e in chosen if e.control_points is None or point in e.control_points)


def load_scenario(path: str | os.PathLike[str] | Scenario, *, root: str | os.PathLike[str] | None = None) -> Scenario:
    """Read and check a scenario with its vehicle and files.

    path    : of the scenario's TOML file; a scenario that has been loaded is returned as it is
    root    : folder that it may name files in, beside its own, its vehicle's and the package's data; by default the
              nearest folder above it that holds `scenarios`, or the working directory
              (docs/reference/scenario_format.md)
    returns : the scenario with its vehicle
    raises  : InputError with one line a problem

    >>> import sim_heating as sh
    >>> sh.load_scenario("scenarios/popu_mach20.toml").vehicle.name
    'orbiter'
    """
    if isinstance(path, Scenario):
        return path
    file = Path(path)
    declared = files.read_toml(file, ScenarioFile)
    vehicle = load_vehicle(vehicle_place(file, declared.vehicle, root=root), root=root)
    return make_scenario(file, declared, vehicle, root=root)


def make_scenario(
    file: Path,
    declared: ScenarioFile,
    vehicle: Vehicle,
    error_file: Path | None = None,
    *,
    root: str | os.PathLike[str] | None = None,
) -> Scenario:
    """A checked scenario from its declaration and a loaded vehicle.

    file       : the scenario's file, which other files are relative to
    error_file : file that messages name, where it is not the scenario's own
    root       : as `load_scenario` takes it
    raises     : InputError as `load_scenario`
    """
    roots = files.roots_of(file, root, vehicle.directory)
    trajectory_file = declared.trajectory.file
    if trajectory_file is not None:
        roots.named(trajectory_file, "[trajectory]: `file`", code=declared.trajectory.source == "fmu")
        if not os.path.isfile(file.parent / trajectory_file):
            raise InputError(
                f"{display_path(file)}, [trajectory]: `file`: there is no {display_path(file.parent / trajectory_file)}"
            )
        declared = declared.model_copy(
            update={"trajectory": declared.trajectory.model_copy(update={"file": str(file.parent / trajectory_file)})}
        )
    files.raise_problems([f"{display_path(error_file or file)}: {line}" for line in _problems(declared, vehicle)])
    names = tuple(declared.control_points or vehicle.control_points)
    compare = []
    for i, c in enumerate(declared.compare, start=1):
        history = roots.named(c.file, f"[compare] {i}: `file`", _history_folder(file, vehicle, c.file))
        compare += [_measured_history(c, history)] if c.control_point in names else []
    return Scenario(file, declared, vehicle.without_effects(declared.heating.left_out), names, tuple(compare))


def with_design(scenario: Scenario, changes: Mapping[str, Any]) -> Scenario:
    """A scenario with single keys of its [design] replaced.

    raises : InputError as for a scenario with these keys
    """
    old = scenario.declared.design or Design()
    design = files.check({**old.model_dump(), **changes}, Design, f"{display_path(scenario.path)}, [design]")
    return replace(scenario, declared=scenario.declared.model_copy(update={"design": design}))


def _named_points(declared: ScenarioFile) -> list[tuple[str, str]]:
    """(key, name) of the control points that a scenario names, anywhere."""
    points = [("`control_points`", name) for name in declared.control_points or []]
    points += [(f"[compare] {i}: `control_point`", c.control_point) for i, c in enumerate(declared.compare, start=1)]
    if declared.design is not None and declared.design.control_point:
        points.append(("[design]: `control_point`", declared.design.control_point))
    for table, uses in (("effect", declared.effect), ("truth.effect", declared.truth.effect)):
        for i, declared_use in enumerate(uses, start=1):
            points += [(f"[[{table}]] {i}: `control_points`", name) for name in declared_use.control_points or []]
    return points


def _unknown_points(declared: ScenarioFile, vehicle: Vehicle) -> list[str]:
    """Control points that the vehicle does not have, each with its key."""

    def check_point(named: tuple[str, str]) -> None:
        key, name = named
        with error_context(key):
            vehicle.control_point(name)

    return _collect_problems(check_point, _named_points(declared))


def _fault_problems(declared: ScenarioFile, vehicle: Vehicle) -> list[str]:
    """Faults of sensors that the vehicle does not have."""
    sensors = {s.name for p in vehicle.control_points.values() for s in p.sensors}
    unknown = [f.sensor for f in declared.measurements.fault if f.sensor not in sensors]
    return [f"[measurements], fault: unknown sensor `{n}`{files.suggestion(n, sensors, cutoff=0.0)}" for n in unknown]


def _problems(declared: ScenarioFile, vehicle: Vehicle) -> list[str]:
    """Unknown control points, effects and sensors, and other contradictions between a scenario and its vehicle."""
    uses = [*declared.effect, *declared.truth.effect]
    return [
        *_unknown_points(declared, vehicle),
        *_collect_problems(_checked_use, uses),
        *_left_out_problems(declared),
        *_inert_problems(declared, vehicle),
        *_idle_back(declared, vehicle),
        *_fault_problems(declared, vehicle),
        *_repeated_labels(declared.compare),
        *(["control_points: the list is empty; omit it for all"] if declared.control_points == [] else []),
        *_selection_problems(declared, vehicle),
        *_fmu_problems(declared.trajectory, vehicle),
        *_design_problems(declared),
    ]


def _checked_use(declared: ScenarioEffect) -> EffectUse:
    """An effect as a scenario uses it; one of the readings has no part in a march, and stands in [measurements]."""
    used = declared.use()
    if used.effect.acts_on_readings:
        raise InputError(
            f"effect `{declared.name}` is one of the readings; give `clock_skew_s` of [measurements], or `tau_s` of "
            "[[measurements.fault]]"
        )
    return used


def _left_out_problems(declared: ScenarioFile) -> list[str]:
    """Effects that a scenario both leaves out and declares."""
    return [
        f"[heating]: `{key}` = false leaves out what [[effect]] {i} declares; remove one of the two"
        for i, e in enumerate(declared.effect, start=1)
        for key in [declared.heating.left_out.get(e.name)]
        if key is not None
    ]


def _inert_problems(declared: ScenarioFile, vehicle: Vehicle) -> list[str]:
    """Effects of a scenario that would do nothing at a point, because the point does not declare what they read."""
    return [
        f"effect `{e.name}`: does nothing at {point.name}, which declares no {lacking}; declare it there, or name "
        "other `control_points` of the effect"
        for e in (*declared.effect, *declared.truth.effect)
        for name in e.control_points or declared.control_points or vehicle.control_points
        for point in [vehicle.control_points.get(name)]
        if point is not None
        for lacking in _lacking(e, point.flow)
    ]


def _idle_back(declared: ScenarioFile, vehicle: Vehicle) -> list[str]:
    """A temperature behind walls whose back faces are all adiabatic."""
    names = declared.control_points or vehicle.control_points
    points = [vehicle.control_points[name] for name in names if name in vehicle.control_points]
    if declared.heating.T_back_K is None or any(p.construction.stack.back != "adiabatic" for p in points):
        return []
    rule = "declare `back = { h_W_m2K, T_K, emissivity }` in the [stack] of one of them, or remove it"
    return [f"[heating]: `T_back_K` does nothing behind the adiabatic walls of the control points; {rule}"]


def _lacking(effect: ScenarioEffect, flow: EdgeFlow) -> Iterator[str]:
    """Declarations that an effect reads the flow at a point by, and that the point does not have."""
    requested = {name for name, value in effect.parameters.items() if value > 0.0}
    if effect.name == TRANSITION:
        if "by_table" in requested and flow.turbulent is None:
            yield "[transition] with `ratio_table_turbulent` (by_table = 1)"
        if "by_re_theta" in requested and not flow.re_theta:
            yield "[transition] with `re_theta_over_m_e` (by_re_theta = 1)"
    if effect.name == RECOMBINATION and flow.atoms == "none":
        yield "[catalysis]"


def _repeated_labels(compare: Sequence[Compare]) -> list[str]:
    """Results of a comparison are listed under its label."""
    label = files.repeated_name([c.label for c in compare])
    return [] if label is None else [f"[[compare]]: the label `{label}` is repeated; give each history its own"]


def _fmu_problems(spec: TrajectorySpec, vehicle: Vehicle) -> Sequence[str]:
    """Contradictions between the scenario and its FMU, where it flies one."""
    if spec.source != "fmu":
        return ()
    from sim_heating.trajectory.fmu import require_fmpy

    require_fmpy()
    from sim_heating.trajectory.fmu.flight import fmu_problems  # FMPy and pint are slow to import

    return fmu_problems(spec, vehicle)


def _design_problems(declared: ScenarioFile) -> list[str]:
    """Manoeuvres and keys that a design varies and that do not exist, and ranges without the planned value."""
    lines, manoeuvres = [], declared.trajectory.manoeuvre
    for i, vary in enumerate(declared.design.vary if declared.design else []):
        where = f"[design], vary {i + 1}"
        if vary.manoeuvre > len(manoeuvres):
            lines.append(f"{where}: there is no manoeuvre {vary.manoeuvre}; the scenario has {len(manoeuvres)}")
            continue
        value = getattr(manoeuvres[vary.manoeuvre - 1], vary.key, None)
        if not isinstance(value, float):
            keys = [k for k, v in manoeuvres[vary.manoeuvre - 1] if isinstance(v, float)]
            lines.append(
                f"{where}: `{vary.key}` is not a number that this manoeuvre gives{files.suggestion(vary.key, keys)}"
            )
        elif not vary.low <= value <= vary.high or not vary.low < vary.high:
            lines.append(f"{where}: {vary.key} = {value:g} as planned is not within {vary.low:g} to {vary.high:g}")
    return lines


def _selection_problems(declared: ScenarioFile, vehicle: Vehicle) -> list[str]:
    """Repeated control points, and requests for points that are not selected."""
    chosen = declared.control_points
    if not chosen:
        return []
    name = files.repeated_name(chosen)
    repeated = [] if name is None else [f"control_points: `{name}` is repeated; name it once"]
    absent = [p for p in _requested_points(declared, vehicle) if p in vehicle.control_points and p not in chosen]
    return repeated + [f"`{name}` is used but not selected in control_points; add it" for name in absent]


def _requested_points(declared: ScenarioFile, vehicle: Vehicle) -> Iterable[str | None]:
    """Control points that comparisons, a design, effects and faults of sensors name, each once."""
    owner = {s.name: p.name for p in vehicle.control_points.values() for s in p.sensors}
    return dict.fromkeys((
        *(c.control_point for c in declared.compare),
        *([declared.design.control_point] if declared.design else []),
        *(p for e in (*declared.effect, *declared.truth.effect) for p in e.control_points or []),
        *(owner[f.sensor] for f in declared.measurements.fault if f.sensor in owner),
    ))  # fmt: skip


def _collect_problems(call: Callable[[Any], object], items: Iterable[Any]) -> list[str]:
    lines: list[str] = []
    for item in items:
        try:
            call(item)
        except InputError as error:
            lines += error.problems
    return lines


def _history_folder(scenario: Path, vehicle: Vehicle, file: str) -> Path:
    """Folder that a measured history is relative to: the vehicle's, or the scenario's where only that has the file."""
    beside_scenario = os.path.isfile(scenario.parent / file) and not os.path.isfile(vehicle.directory / file)
    return scenario.parent if beside_scenario else vehicle.directory


HISTORY = ("time_s", "temperature_K", "sigma_K")
"""Columns of a measured history."""
SIGMA = re.compile(r"(?i)sigma|std|uncert")


def _history_table(file: Path) -> CsvTable:
    """Time, temperature and its standard deviation of a file, in its columns or by names with units: `Time (min)`,
    `Temperature (degF)`, `sigma (degF)`.

    raises : InputError as `read_csv_columns` where the names state neither
    """
    if states_columns(file, HISTORY):
        return files.read_csv_columns(file, HISTORY)
    fields = read_fields(file)
    sigma = next((n for n in fields.unused if SIGMA.search(n)), "")
    scale = converted(name_and_unit(sigma, ["K"])[1], "K")
    if "time_s" not in fields.columns or "T_inf_K" not in fields.columns or scale is None:
        return files.read_csv_columns(file, HISTORY)
    sigma_K = scale.factor * fields.numbers[sigma]  # a difference of temperatures has no offset
    columns = {"time_s": fields.columns["time_s"], "temperature_K": fields.columns["T_inf_K"], "sigma_K": sigma_K}
    read = np.all([np.isfinite(v) for v in columns.values()], axis=0)  # an empty cell is a lost sample
    return replace(fields.table({n: v[read] for n, v in columns.items()}), lines=fields.lines[read])


def _measured_history(compare: Compare, file: Path) -> MeasuredHistory:
    table = _history_table(file)
    rule = f"K is no temperature of a surface; give K, at most {HOTTEST_K:g}"
    hot = table.problems_where_not("temperature_K", table["temperature_K"] <= HOTTEST_K, rule)
    noise = QUANTITIES["noise_sigma_K"]
    sigma = table["sigma_K"]
    spread = table.problems_where_not("sigma_K", (sigma >= noise.lowest) & (sigma <= noise.highest), noise.rule)
    files.raise_problems([*table.order_problems(), *table.celsius_problems("temperature_K"), *hot, *spread])
    time = table["time_s"]
    until = np.inf if compare.until_s is None else compare.until_s
    inside = time <= until
    columns = {name: table[name][inside] for name in ("time_s", "temperature_K", "sigma_K")}
    segments = files.check(
        {"fit": compare.fit_s, "holdout": compare.holdout_s}, Segments, f"[[compare]] {compare.label}"
    )
    return MeasuredHistory(
        compare.control_point,
        compare.label,
        **columns,
        segments=segments,
        noise_correlation_s=compare.noise_correlation_s,
        source=compare.source,
        confidence=compare.confidence,
    )
