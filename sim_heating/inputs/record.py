"""A flight record: vehicle, flight conditions and measurements in one directory, format flight-record/1.

    record.toml         the declaration
    conditions.csv      flight conditions, one row a sample
    thermocouples.csv   measurements, one column a sensor; an empty cell is a lost sample
    ratio_table.csv     optional: the declared heating-ratio table, and a turbulent one for declared transition

The whole record is checked before anything is returned.
"""

from __future__ import annotations

import hashlib
import math
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, Discriminator, Field, Tag, field_validator, model_validator

from sim_heating.base import files
from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.base.conditions import DERIVED, HEATING, RATIO_VARIABLES, STATE, SURFACES, Conditions
from sim_heating.base.errors import InputError, tell
from sim_heating.base.files import CsvTable, Declared, LocatedError, Location, display_path
from sim_heating.base.files.roots import portable_name
from sim_heating.base.kernels.jit import interpreted
from sim_heating.base.limits import HOTTEST_K, USUAL
from sim_heating.base.parameters import PRESSURE_FACTOR
from sim_heating.heating.atmosphere import R_AIR, us76
from sim_heating.heating.effects import EffectUse
from sim_heating.heating.ratio.table import (
    LEAST_RATIO,
    MOST_RATIO,
    RatioTable,
    depends_on,
    ratio_table_text,
    read_ratio_table,
)
from sim_heating.heating.recorded import plausible
from sim_heating.heating.recorded.fields import ConditionField
from sim_heating.heating.recorded.layout import lacks_only_derived, states_columns
from sim_heating.heating.recorded.reading import local_pressure, lowered_confidence, read_flight
from sim_heating.heating.reference.models import reference_model, total_enthalpy_kernel
from sim_heating.heating.reference.recovery import Recovery, RecoveryName, point_recovery
from sim_heating.heating.surface_pressure import PressureModel
from sim_heating.inputs.declared_effects import Catalysis, InterfaceDeclaration, Transition, turbulent_problems
from sim_heating.inputs.pressure_transducer import Normal, PressureTransducer, pressure_factor, transducer_problems
from sim_heating.thermal.stack import Construction, PressureTable, Sensor, construct, sensor_problems, sensor_remarks

REFERENCE_COLUMNS = ("h_ref_kg_m2_s", "H_r_J_kg")
LEAST_DEFECT = 0.3
"""Part of the difference of total and recovery enthalpy that a column of the latter shows at least."""
OPTIONAL_COLUMNS = ("q_add_W_m2", "jets", "T_surroundings_K", "T_back_K", "T_upstream_K", "q_Pa")
DECLARATION = "record.toml"


# The declaration -----------------------------------------------------------------------------------------------------


NO_FILE = "is not a file of this record; name one inside its directory"


def _not_the_declaration(file: str) -> str:
    if PurePosixPath(file).name == DECLARATION:
        raise ValueError(f"`{file}` {NO_FILE}")
    return file


FileOfRecord = Annotated[str, files.path_below(NO_FILE), AfterValidator(_not_the_declaration)]
"""Type of a key that names a file of the record."""


class FileReference(Declared):
    """A file of the record by its name."""

    file: FileOfRecord = Field(min_length=1, description="a file name in the record's directory")


class AmbientCheck(Declared):
    """A reading before the flight, where the whole wall has a known temperature."""

    reading_K: float = Field(gt=0.0, description="what the thermocouple read in K")
    T_K: float = Field(gt=0.0, description="temperature of the wall by another thermometer in K")
    sigma_K: float = Field(default=0.0, ge=0.0, le=50.0, description="standard deviation of that temperature in K")


class RecordedSensor(Sensor):
    """A thermocouple of a record: it may have been checked before the flight."""

    ambient_check: AmbientCheck | None = Field(default=None, description="reading of a wall at a known temperature")

    @property
    def bias_prior_K(self) -> tuple[float, float] | None:
        """Mean and standard deviation of what the thermocouple reads too much [K]; None where nothing states them.

        mean = (reading - c(T)) / c'(T),   sigma^2 = sigma_T^2 + noise^2 + LSB^2 / 12 + calibration_sigma^2

        c the calibration curve. The last term is there because a curve that holds at ambient may be off where it is
        hot.
        Source: docs/theory/equations.md, section 5.
        """
        check = self.ambient_check
        if check is None:
            return super().bias_prior_K
        reading_K = self.noise_floor_K(self.noise_sigma_K or 0.0)
        curve = np.polynomial.Polynomial(self.calibration or [0.0, 1.0])
        mean_K = float((check.reading_K - curve(check.T_K)) / curve.deriv()(check.T_K))
        return mean_K, math.hypot(check.sigma_K, reading_K, self.calibration_sigma_K or 0.0)

    @model_validator(mode="after")
    def _check_ambient(self) -> RecordedSensor:
        prior = self.bias_prior_K
        if self.ambient_check is not None and prior is not None and prior[1] == 0.0:
            rule = (
                "states no error, and would fix the bias exactly; add `sigma_K` of the wall's temperature to it, or "
                "`noise_sigma_K` or `bits` to the sensor"
            )
            raise LocatedError((("ambient_check",), rule))
        return self


class Thermocouples(FileReference):
    """The measurements and their sensors."""

    file: FileOfRecord = Field(
        default="thermocouples.csv", min_length=1, description="a file name in the record's directory"
    )
    sensor: list[RecordedSensor] = Field(min_length=1, description="[[thermocouples.sensor]], at least one")
    transducer: list[PressureTransducer] = Field(
        default=[], description="[[thermocouples.transducer]], of the pressure at the surface, in the same file"
    )

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the file that are read, in addition to `time_s`."""
        return (*(s.column for s in self.sensor), *(t.column for t in self.transducer))


class FlightUncertainty(Declared):
    """How far the flight may be from its conditions: one standard deviation of each error, 0 where it is not stated."""

    quantities: ClassVar = {"density_scale_m": "scale_height_m"}

    time_shift_s: float = Field(default=0.0, ge=0.0, description="of the clock of the conditions")
    time_stretch: float = Field(default=0.0, ge=0.0, lt=1.0, description="of the duration of the flight, relative")
    density_relative: float = Field(default=0.0, ge=0.0, le=1.0, description="of the density, smooth in altitude")
    density_scale_m: float = Field(default=8000.0, gt=0.0, description="distance over which that error changes")
    velocity_relative: float = Field(default=0.0, ge=0.0, le=0.5, description="of the velocity")
    alpha_deg: float = Field(default=0.0, ge=0.0, le=20.0, description="of the angle of attack")


BY_CONFIDENCE = {
    "A": FlightUncertainty(
        time_shift_s=0.5, time_stretch=5e-4, density_relative=0.05, velocity_relative=0.002, alpha_deg=0.25
    ),
    "B": FlightUncertainty(
        time_shift_s=3.0, time_stretch=3e-3, density_relative=0.1, velocity_relative=0.005, alpha_deg=0.5
    ),
    "C": FlightUncertainty(
        time_shift_s=20.0, time_stretch=0.02, density_relative=0.15, velocity_relative=0.01, alpha_deg=2.0
    ),
}
"""Of a measured flight that states none, by the confidence of its conditions: A recorded on the flight (clocks set by
hand, density by a sounding of the day), B reconstructed from the literature, and where none is stated; C a
representative flight in place of the one flown, whose phases begin some tens of seconds earlier or later. Judged."""


class FlightNoise(Declared):
    """White noise of the conditions, one standard deviation at each row: what a filter of the trajectory has left."""

    alpha_deg: float = Field(default=0.0, ge=0.0, le=20.0, description="of the angle of attack")
    density_relative: float = Field(default=0.0, ge=0.0, le=1.0, description="of the density, relative")
    velocity_relative: float = Field(default=0.0, ge=0.0, le=0.5, description="of the velocity, relative")


class HeatingUncertainty(Declared):
    """A smooth relative error of the heating, which no model is without: its size and how long it lasts."""

    relative: float = Field(ge=0.0, le=1.0, description="scale of its standard deviation over the heating; 0 for none")
    correlation_s: float | None = Field(default=None, gt=0.0, description="its correlation time; 15 to 600 s without")


class ConditionsFile(FileReference):
    """The flight conditions: a file of columns, and constants in place of columns, by their names."""

    file: FileOfRecord = Field(
        default="conditions.csv", min_length=1, description="a file name in the record's directory"
    )
    source: str = Field(default="", description="where the flight conditions come from")
    confidence: str = Field(default="", description="A read in a data set, B known from the literature, C judged")
    uncertainty: FlightUncertainty | None = Field(
        default=None, description="[conditions.uncertainty]; by `confidence` for a measured record that has none"
    )
    noise: FlightNoise | None = Field(
        default=None, description="[conditions.noise]; from the roughness of the columns for a measured record without"
    )
    altitude_m: float | None = None
    velocity_m_s: float | None = None
    mach: float | None = None
    alpha_deg: float | None = None
    beta_deg: float | None = None
    log10_re: float | None = None
    elevon_deg: float | None = None
    bodyflap_deg: float | None = None
    rho_kg_m3: float | None = None
    T_inf_K: float | None = None
    p_inf_Pa: float | None = None
    p_surface_Pa: float | None = None
    h_ref_kg_m2_s: float | None = None
    H_r_J_kg: float | None = None
    q_add_W_m2: float | None = None
    jets: float | None = None
    T_surroundings_K: float | None = None
    T_back_K: float | None = None
    T_upstream_K: float | None = None

    @property
    def constants(self) -> dict[str, float]:
        """Values that hold at all times, by column, each in the unit that its name ends in."""
        named = self.model_dump(exclude={"file", "source", "confidence", "uncertainty", "noise"}, exclude_none=True)
        return {name: float(value) for name, value in named.items()}

    def unusual(self) -> list[tuple[Location, str]]:
        """As of all declarations; an enthalpy without a flow states a lamp, and is looked at with the other columns."""
        flows = self.velocity_m_s is not None and self.velocity_m_s >= plausible.STILL_M_S
        return [remark for remark in super().unusual() if flows or remark[0] != ("H_r_J_kg",)]


class ConstantHeat(Declared):
    """Enthalpy of air at the wall as cp T."""

    cp_J_kgK: float = Field(gt=0.0, description="specific heat of air in J/(kg K), above 0")


def _enthalpy_tag(value: Any) -> str:
    return "constant" if isinstance(value, (dict, ConstantHeat)) else "named"


LocalAngle = Annotated[
    float | None, Field(ge=-90.0, le=90.0, description="angle of the surface against the x axis in degrees")
]
"""Type of the key for the angle of a local surface with a known edge."""


def edge_problems(recovery: RecoveryName | None, local_angle_deg: float | None) -> list[tuple[Location, str]]:
    """Problems of a declared recovery enthalpy: an edge without an angle, or an angle without a recovery enthalpy."""
    if recovery in (None, "total", "attachment-line") or local_angle_deg is not None:
        unused = recovery in (None, "attachment-line") and local_angle_deg is not None
        rule = 'is that of an edge; give `recovery` = "edge-laminar" or "edge-turbulent"'
        return [(("local_angle_deg",), rule)] if unused else []
    return [(("recovery",), f'"{recovery}" needs `local_angle_deg`, the angle that is added to alpha; add it')]


def declared_recovery(
    recovery: RecoveryName | None,
    local_angle_deg: float | None,
    reference: str,
    elevon_factor: float = 0.0,
    bodyflap_factor: float = 0.0,
    sweep_deg: float | None = None,
) -> Recovery:
    """Recovery enthalpy of a control point: as declared, else that of the reference heating.

    recovery, local_angle_deg      : as declared, angle [deg]; None where not
    reference                      : name of the reference heating
    elevon_factor, bodyflap_factor : part of a deflection that turns the surface [-]
    sweep_deg                      : of an attachment line [deg]
    """
    if recovery is None:
        return replace(reference_model(reference).recovery, sweep_deg=sweep_deg or 0.0)
    if recovery == "total":
        return Recovery()
    if recovery == LINE:
        return Recovery(recovery, sweep_deg=sweep_deg or 0.0)
    return Recovery(recovery, local_angle_deg or 0.0, elevon_factor, bodyflap_factor)


STAGNATION = ("sutton-graves", "detra-kemp-riddell", "fay-riddell", "swept-cylinder")
FLAT_PLATE = ("eckert-laminar", "eckert-turbulent")
SWEPT, LINE = "swept-cylinder", "attachment-line"


def sweep_problems(
    reference: str, sweep_deg: float | None, recovery: RecoveryName | None = None
) -> list[tuple[Location, str]]:
    """Problems of a sweep [deg]: a cylinder and an attachment line need one, and nothing else has one.

    reference, recovery : names of the reference heating and of the recovery enthalpy, None where not stated
    """
    key, name = ("recovery", LINE) if recovery == LINE and reference != SWEPT else ("reference", SWEPT)
    if (sweep_deg is None) != (reference == SWEPT or recovery == LINE):
        return []
    if sweep_deg is None:
        return [((key,), f'"{name}" needs `sweep_deg`; add it (0 for a cylinder across the flow)')]
    return [(("sweep_deg",), f'is of "{SWEPT}" only; remove it, or change `reference`')]


class Heating(Declared):
    """The reference heating that ratios are over, the wall enthalpy, and the declared ratio."""

    reference: Literal[
        "columns",
        "sutton-graves",
        "detra-kemp-riddell",
        "fay-riddell",
        "eckert-laminar",
        "eckert-turbulent",
        "swept-cylinder",
        "none",
    ] = Field(description='"columns", a model of reference heating, or "none"')
    nose_radius_m: float | None = Field(
        default=None, gt=0.0, description="radius of the reference sphere or cylinder in m"
    )
    sweep_deg: float | None = Field(default=None, ge=0.0, lt=90.0, description="sweep of the reference cylinder")
    running_length_m: float | None = Field(default=None, gt=0.0, description="length from the leading edge in m")
    wall_enthalpy: Annotated[
        Annotated[Literal["equilibrium-air"], Tag("named")] | Annotated[ConstantHeat, Tag("constant")],
        Discriminator(_enthalpy_tag),
    ] = Field(description='{ cp_J_kgK = ... } or "equilibrium-air"')
    ratio_table: FileOfRecord | None = Field(default=None, description="file of the declared heating ratio")
    ratio: float | None = Field(
        default=None, ge=0.0, le=MOST_RATIO, description="constant heating ratio, in place of a table; 0: no heating"
    )
    recovery: RecoveryName | None = Field(default=None, description="enthalpy that the ratio is reduced with")
    local_angle_deg: LocalAngle = None
    transition: RecordTransition | None = None
    catalysis: Catalysis | None = None
    interface: InterfaceDeclaration | None = None
    uncertainty: HeatingUncertainty | None = Field(
        default=None, description="[heating.uncertainty]; 0.05 for a measured record that has none"
    )
    elevon_factor: float = Field(default=0.0, ge=-1.0, le=1.0, description="part of the elevon that turns the surface")
    bodyflap_factor: float = Field(default=0.0, ge=-1.0, le=1.0, description="part of the flap that turns the surface")

    @property
    def recovery_of_point(self) -> Recovery:
        """Recovery enthalpy of the control point: as declared, else that of the reference heating."""
        return declared_recovery(
            self.recovery,
            self.local_angle_deg,
            self.reference,
            self.elevon_factor,
            self.bodyflap_factor,
            self.sweep_deg,
        )

    @property
    def effects(self) -> tuple[EffectUse, ...]:
        """Effects of the declared model: transition and recombination, as far as declared."""
        turning = () if self.transition is None else (self.transition.effect,)
        return (*turning, *(() if self.catalysis is None else self.catalysis.effects))

    @property
    def turbulent_file(self) -> str | None:
        """File of the turbulent heating ratio, None without one."""
        return None if self.transition is None else self.transition.ratio_table_turbulent

    @model_validator(mode="after")
    def _check_transition(self) -> Heating:
        if self.transition is None:
            return self
        if self.transition.ratio_table_turbulent is not None and self.ratio_table is None:
            rule = "needs the laminar `ratio_table` as well; name it, or give `factor` in place of the turbulent table"
            raise LocatedError((("transition", "ratio_table_turbulent"), rule))
        needs_edge = self.transition.by_re_theta
        if needs_edge and (not self.recovery_of_point.of_surface or self.running_length_m is None):
            rule = "needs the edge of the point: `recovery`, `local_angle_deg` and `running_length_m` in [heating]"
            raise LocatedError((("transition", "re_theta_over_m_e"), rule))
        return self

    @model_validator(mode="after")
    def _check_ratio(self) -> Heating:
        if self.ratio is not None and self.ratio_table is not None:
            raise LocatedError((("ratio",), "is a constant in place of `ratio_table`; remove one of the two"))
        if self.ratio is not None and 0.0 < self.ratio < LEAST_RATIO:
            rule = f"{self.ratio:g} is above 0 and below {LEAST_RATIO:g}; give 0 for no heating"
            raise LocatedError((("ratio",), rule))
        if self.ratio is not None and self.reference == "none":
            raise LocatedError((("ratio",), 'is over a reference heating, and `reference` is "none"; remove it'))
        return self

    def constant_ratio(self) -> RatioTable | None:
        """The declared constant ratio as a table of one node; None where none is declared, or no heating is."""
        if not self.ratio:
            return None
        node = np.zeros(1)
        ratio = np.full((1,) * len(RATIO_VARIABLES), self.ratio)
        return RatioTable((node,) * len(RATIO_VARIABLES), ratio, header={"source": "constant of the record"})

    @model_validator(mode="after")
    def _check_edge(self) -> Heating:
        files.raise_located(edge_problems(self.recovery, self.local_angle_deg))
        if self.local_angle_deg is None and (self.elevon_factor or self.bodyflap_factor):
            key = "elevon_factor" if self.elevon_factor else "bodyflap_factor"
            raise LocatedError(((key,), "turns the surface of an edge; give `recovery` and `local_angle_deg` as well"))
        return self

    @model_validator(mode="after")
    def _check_lengths(self) -> Heating:
        for names, key in ((STAGNATION, "nose_radius_m"), (FLAT_PLATE, "running_length_m")):
            if self.reference in names and getattr(self, key) is None:
                raise LocatedError((("reference",), f'"{self.reference}" needs `{key}`; add it'))
        files.raise_located(sweep_problems(self.reference, self.sweep_deg, self.recovery))
        return self


class RecordTransition(Transition):
    """[heating.transition] of a record: the criterion, and the turbulent heating."""

    quantities: ClassVar = {"width": "transition_width", "factor": "transition_factor"}

    ratio_table_turbulent: FileOfRecord | None = Field(default=None, description="file of the turbulent heating ratio")
    factor: float | None = Field(default=None, gt=0.0, description="turbulent over laminar, or on that of the tables")
    factor_sigma: float | None = Field(default=None, ge=0.0, description="its standard deviation")

    @model_validator(mode="after")
    def _check_turbulent(self) -> RecordTransition:
        if self.ratio_table_turbulent is None and self.factor is None:
            raise LocatedError((("ratio_table_turbulent",), "is missing; name the turbulent table, or give `factor`"))
        return self

    @property
    def effect(self) -> EffectUse:
        """The effect that it declares."""
        by_table = self.ratio_table_turbulent is not None
        return self.use(1.0 if self.factor is None else self.factor, by_table, self.factor_sigma)


class ReferenceCondition(Declared):
    """The condition that derivatives refer to; absent values are means over the fit segments."""

    alpha_deg: float | None = None
    beta_deg: float | None = None
    log10_re: float | None = None
    elevon_deg: float | None = None
    bodyflap_deg: float | None = None


class Segments(Declared):
    """Times to fit and times to hold out, [[start, end], ...] in s, both ends included."""

    quantities: ClassVar = {"fit": "time_s", "holdout": "time_s"}

    fit: list[list[float]] | None = Field(default=None, description="[[start_s, end_s], ...]")
    holdout: list[list[float]] = Field(default_factory=list, description="[[start_s, end_s], ...]")

    @field_validator("fit", "holdout")
    @classmethod
    def _check(cls, segments: list[list[float]] | None) -> list[list[float]] | None:
        problems: list[tuple[Location, str]] = [
            ((i,), f"{s} is not a segment; give [start_s, end_s] with start before end")
            for i, s in enumerate(segments or [])
            if len(s) != 2 or s[0] > s[1]
        ]
        files.raise_located(problems)
        return segments


class FlownManoeuvre(Declared):
    """A manoeuvre of the flight: its kind, and when it was flown."""

    quantities: ClassVar = {"start_s": "time_s", "end_s": "time_s"}

    kind: str = Field(min_length=1, description='what was flown, as "popu" or "bodyflap-sweep"')
    start_s: float = Field(description="start in s, on the clock of the conditions")
    end_s: float = Field(description="end in s")

    @model_validator(mode="after")
    def _check_times(self) -> FlownManoeuvre:
        if not self.start_s < self.end_s:
            raise LocatedError((("end_s",), f"{self.end_s:g} is not after start_s, {self.start_s:g}"))
        return self


class RecordFile(Construction):
    """record.toml. The stack and the materials are those of a Construction."""

    format: Literal["flight-record/1"] = Field(description='"flight-record/1"')
    title: str = ""
    flight: str = Field(
        default="",
        pattern=r"^([^./\\|@][^/\\|@]*)?$",
        description="name of the flight, without / \\ | @; that of the directory above where absent",
    )
    vehicle: str = ""
    control_point: Annotated[str, portable_name()] = Field(min_length=1, description="name of the control point")
    measured: bool = Field(description="true for a measurement, false for synthetic data")
    source: str = Field(default="", description="where measurements and construction come from")
    confidence: str = Field(default="", description="A read in a data set, B known from the literature, C judged")
    conditions: ConditionsFile = Field(default_factory=lambda: ConditionsFile(file="conditions.csv"))
    thermocouples: Thermocouples = Field(description="[[thermocouples.sensor]] and the file of samples")
    heating: Heating
    reference_condition: ReferenceCondition | None = None
    segments: Segments = Field(default_factory=Segments)
    manoeuvre: list[FlownManoeuvre] = Field(default=[], description="[[manoeuvre]], those that were flown")

    def unusual(self) -> list[tuple[Location, str]]:
        """As of all declarations, and sensors within layers that are too thin for them."""
        sensors = sensor_remarks(self.stack, self.thermocouples.sensor)
        return [*super().unusual(), *((("thermocouples", "sensor", *location), text) for location, text in sensors)]

    @model_validator(mode="after")
    def _check_record(self) -> RecordFile:
        problems: list[tuple[Location, str]] = [
            (("thermocouples", "sensor", *location), text)
            for location, text in sensor_problems(self.stack, self.thermocouples.sensor, self.materials)
        ]
        problems += [
            (("thermocouples", "transducer", *location), text)
            for location, text in transducer_problems(self.thermocouples.transducer, self.thermocouples.sensor)
        ]
        heating = self.heating
        named = (self.conditions.file, self.thermocouples.file, heating.ratio_table, heating.turbulent_file)
        if len({f for f in named if f}) < sum(f is not None for f in named):
            problems.append((("conditions", "file"), "two parts of the record name the same file; give each its own"))
        files.raise_located(problems)
        return self


# The record ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Record:
    """A checked flight record.

    declared      : record.toml
    conditions    : flight conditions on their own times
    thermocouples : column -> (sample,) of the measurement file; `time_s`, a column a sensor [K], NaN a lost sample
    ratio_table   : the declared heating ratio, or None
    directory     : folder that it was read from, for messages and names of results
    turbulent     : the declared turbulent heating ratio, or None
    label         : its name among the records of a command, where that of the directory is not unique there
    rows          : (sample,) rows of the measurement file, its names on the first
    pressure_factor : mean and standard deviation of the surface pressure over that of the conditions [-], by its prior
                    and by what its transducers read
    """

    declared: RecordFile
    conditions: Conditions
    thermocouples: Mapping[str, FloatArray]
    ratio_table: RatioTable | None = None
    directory: Path = field(default=Path("record"))
    turbulent: RatioTable | None = None
    label: str = ""
    rows: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    pressure_factor: Normal = (PRESSURE_FACTOR.value, PRESSURE_FACTOR.sigma)

    def __repr__(self) -> str:
        sensors, t = len(self.sensors), self.conditions.time_s
        point = self.declared.control_point
        return f"<Record {self.name!r} of {point}: {sensors} sensors, {t[0]:g} to {t[-1]:g} s>"

    @property
    def name(self) -> str:
        """Name of the record's directory; FLIGHT/NAME where another record of the command has that name too."""
        return self.label or self.folder_name

    @property
    def folder_name(self) -> str:
        """Name of the record's directory."""
        return Path(os.path.abspath(self.directory)).name

    @property
    def flight(self) -> str:
        """Name of the flight: the declared one, else that of the directory which the record's own is in."""
        return self.declared.flight or Path(os.path.abspath(self.directory)).parent.name

    @property
    def time_s(self) -> FloatArray:
        """(sample,) times of the measurements [s]."""
        return self.thermocouples["time_s"]

    @property
    def sensors(self) -> list[Sensor]:
        """All sensors in the order of the declaration."""
        return [*self.declared.thermocouples.sensor]

    @property
    def used_sensors(self) -> list[Sensor]:
        """The sensors that may be fitted."""
        return [s for s in self.sensors if s.used]

    @property
    def construction(self) -> Construction:
        """Stack and materials, as the thermal model takes them."""
        return Construction(stack=self.declared.stack, materials=self.declared.materials)

    @property
    def upstream(self) -> Construction | None:
        """Layers of the wall upstream of its interface; None without one, or where its temperature is a column."""
        interface = self.declared.heating.interface
        if interface is None or interface.stack is None:
            return None
        return construct(interface.stack, self.declared.materials, f"{self.name}, [heating.interface]")

    def temperatures_K(self, sensors: Sequence[Sensor] | None = None) -> FloatArray:
        """(sensor, sample) measurements of the given sensors, all by default; NaN is a lost sample."""
        return np.array([self.thermocouples[s.column] for s in (self.sensors if sensors is None else sensors)])

    @property
    def read_mask(self) -> BoolArray:
        """(sample,) True where any used sensor has a reading."""
        return np.any(np.isfinite(self.temperatures_K(self.used_sensors)), axis=0)

    def fit_mask(self, time_s: ArrayLike | None = None) -> BoolArray:
        """(n,) True for times [s] in a fit segment and in no holdout segment; by default those of the samples."""
        t = self.time_s if time_s is None else np.asarray(time_s, dtype=float)
        fit = self.declared.segments.fit
        return (np.ones(t.shape, dtype=bool) if fit is None else in_segments(t, fit)) & ~self.holdout_mask(t)

    def holdout_mask(self, time_s: ArrayLike | None = None) -> BoolArray:
        """(n,) True for times [s] in a holdout segment; by default those of the samples."""
        t = self.time_s if time_s is None else np.asarray(time_s, dtype=float)
        return in_segments(t, self.declared.segments.holdout)

    def with_fit(self, segments: Sequence[Sequence[float]]) -> Record:
        """The record with other fit segments [[start_s, end_s], ...]."""
        other = Segments(fit=[list(s) for s in segments], holdout=self.declared.segments.holdout)
        return replace(self, declared=self.declared.model_copy(update={"segments": other}))

    @property
    def lacks_ratio(self) -> bool:
        """Whether a reference heats the wall, and neither a table nor a constant states the ratio to it."""
        heating = self.declared.heating
        heats = heating.reference not in ("columns", "none") or (
            heating.reference == "columns" and bool(np.any(self.conditions["h_ref_kg_m2_s"]))
        )
        return heats and self.ratio_table is None and heating.ratio is None

    def require_ratio(self) -> None:
        """Refuse a record without a heating ratio where its declared model is to be marched.

        raises : InputError, one line, with the options of `new record` that state one
        """
        if self.lacks_ratio:
            raise InputError(
                f"{display_path(self.directory / DECLARATION)}, [heating]: `ratio` is missing, and a reference "
                "without a ratio heats nothing; give `ratio = 1.0` or a `ratio_table` (`new record` has --ratio, "
                "--ratio-table and --like), or `estimate` ratio.d0"
            )

    @property
    def has_flow(self) -> bool:
        """Whether air flows past the wall at some time; under a lamp in a room it does not."""
        return "velocity_m_s" in self.conditions and bool(np.any(self.conditions["velocity_m_s"] > 0.0))

    @property
    def surfaces(self) -> tuple[str, ...]:
        """Columns of the control surfaces that move, or that the heating depends on; none of a vehicle without any."""
        heating, tables = self.declared.heating, (self.ratio_table, self.turbulent)
        needed = {name for used in heating.effects for name in used.effect.needs}
        return tuple(
            name
            for name in SURFACES
            if name in needed
            or _depends_on_surface(name, heating, tables)
            or (name in self.conditions and bool(np.any(self.conditions[name])))
        )

    def with_sensors(self, sensors: Sequence[Sensor]) -> Record:
        """The record with other declarations of its thermocouples, of which it has the columns."""
        thermocouples = self.declared.thermocouples.model_copy(update={"sensor": list(sensors)})
        return replace(self, declared=self.declared.model_copy(update={"thermocouples": thermocouples}))

    def noise_floor_K(
        self, mask: ArrayLike | None = None, estimated_sigma_K: Mapping[str, float] | None = None
    ) -> float:
        """Root mean square of the noise floor over the used sensors' samples [K]; NaN where there are none.

        mask              : (sample,) which samples; by default those of the fit segments
        estimated_sigma_K : by sensor name, for the sensors that declare no noise
        raises            : InputError where a sensor has neither
        """
        chosen = self.fit_mask() if mask is None else np.asarray(mask, dtype=bool)
        variance_K2: list[float] = []
        for sensor, T in zip(self.used_sensors, self.temperatures_K(self.used_sensors), strict=True):
            floor_K = sensor.noise_floor_K(self._sigma_K(sensor, estimated_sigma_K or {}))
            read = T[chosen & np.isfinite(T)]
            variance_K2 += (floor_K**2 + sensor.growing_noise_K(read) ** 2).tolist()
        return math.sqrt(float(np.mean(variance_K2))) if variance_K2 else math.nan

    def _sigma_K(self, sensor: Sensor, estimated: Mapping[str, float]) -> float:
        sigma = sensor.noise_sigma_K if sensor.noise_sigma_K is not None else estimated.get(sensor.name)
        if sigma is None:
            raise InputError(
                f"{self.name}, sensor {sensor.name}: noise_sigma_K is neither declared nor estimated; give it"
            )
        return sigma


def record_digest(record: Record) -> str:
    """Hash `sha256:...` over the names and bytes of a record's files, those that its declaration names.

    raises : InputError where one cannot be read
    """
    declared, heating = record.declared, record.declared.heating
    tables = (heating.ratio_table, heating.turbulent_file)
    names = (DECLARATION, declared.conditions.file, declared.thermocouples.file, *tables)
    digest = hashlib.sha256()
    for name in (n for n in names if n is not None):
        try:
            content = (record.directory / name).read_bytes()
        except OSError:
            raise InputError(
                f"{display_path(record.directory / name)}: cannot be read; write the record first"
            ) from None
        digest.update(f"{name}\0{len(content)}\0".encode())
        digest.update(content)
    return f"sha256:{digest.hexdigest()}"


def in_segments(time_s: ArrayLike, segments: Sequence[Sequence[float]]) -> BoolArray:
    """True for times [s] in any of the segments [start, end], both ends included."""
    t = np.asarray(time_s, dtype=float)
    inside = np.zeros(t.shape, dtype=bool)
    for start, end in segments:
        inside |= (t >= start) & (t <= end)
    return inside


def pooled_rmse_K(residual_K: ArrayLike, mask: ArrayLike | None = None) -> dict[str, float | int] | None:
    """RMSE, largest magnitude and count of the residuals of all sensors together; lost samples (NaN) are ignored.

    residual_K : (sensor, sample) measured minus predicted [K]
    mask       : (sample,) which samples
    returns    : rmse_K, max_abs_K, n, as in result files; None without samples
    """
    residual = np.atleast_2d(np.asarray(residual_K, dtype=float))
    if mask is not None:
        residual = residual[:, np.asarray(mask, dtype=bool)]
    finite = residual[np.isfinite(residual)]
    if finite.size == 0:
        return None
    largest = float(np.max(np.abs(finite)))
    return {"rmse_K": float(np.sqrt(np.mean(finite**2))), "max_abs_K": largest, "n": int(finite.size)}


def distinct_names(folders: Sequence[str], flight: Callable[[int], str]) -> list[str]:
    """Names of the records of one command: those of their directories, and FLIGHT/NAME where several have one name.

    folders : names of the records' directories
    flight  : the flight of a record by its index, which is asked for where names clash
    raises  : InputError where two records of one name are of one flight

    >>> distinct_names(["V07T9975", "V09T9527", "V09T9527"], ["STS-2", "STS-2", "STS-4"].__getitem__)
    ['V07T9975', 'STS-2/V09T9527', 'STS-4/V09T9527']
    """
    names = [name if folders.count(name) == 1 else f"{flight(i)}/{name}" for i, name in enumerate(folders)]
    _require_distinct(names)
    return names


def _require_distinct(names: Sequence[str]) -> None:
    if (twice := files.repeated_name(names)) is not None:
        raise InputError(
            f"two records are named {twice}; leave one out, rename one, or give each its `flight` in {DECLARATION}"
        )


def named_apart(records: Sequence[Record]) -> list[Record]:
    """The records of one command under names that no two of them have in common; a label that one has is kept.

    raises : InputError where two records of one name are of one flight
    """
    plain = [r for r in records if not r.label]
    names = iter(distinct_names([r.folder_name for r in plain], lambda i: plain[i].flight))
    named = [r if r.label or (name := next(names)) == r.folder_name else replace(r, label=name) for r in records]
    _require_distinct([r.name for r in named])
    return named


# Reading -------------------------------------------------------------------------------------------------------------


def load_records(
    directories: Sequence[str | os.PathLike[str] | Record], *, root: str | os.PathLike[str] | None = None
) -> list[Record]:
    """Read and check the records of one command, under names that no two of them have in common.

    directories, root : as `load_record` takes them
    raises            : InputError as `load_record`, and where two records of one name are of one flight
    """
    return named_apart([load_record(directory, root=root) for directory in directories])


def load_record(directory: str | os.PathLike[str] | Record, *, root: str | os.PathLike[str] | None = None) -> Record:
    """Read and check a flight record.

    directory : of the record; a record that has been loaded is returned as it is
    root      : folder that symbolic links in it may lead to; by default as docs/reference/scenario_format.md states
    returns   : conditions, measurements and the declared model
    raises    : InputError with one line a problem, naming file, row and column or table and key

    >>> import sim_heating as sh
    >>> record = sh.load_record("scenarios/records/practice/p06")
    >>> [sensor.name for sensor in record.sensors]
    ['LS_surface', 'LS_bond']
    """
    if isinstance(directory, Record):
        return directory
    home = Path(directory)
    if not os.path.isdir(home):
        raise InputError(f"{display_path(home)}: is not a directory; a record is a directory with a {DECLARATION}")
    _refuse_folder_of_records(home)
    roots = files.roots_of(home / DECLARATION, root)
    roots.check_link(home / DECLARATION)
    declared = files.read_toml(home / DECLARATION, RecordFile)
    heating = declared.heating
    for name in (declared.conditions.file, declared.thermocouples.file, heating.ratio_table, heating.turbulent_file):
        if name is not None:
            roots.check_link(home / name)
    named = (heating.ratio_table, heating.turbulent_file)
    table, turbulent = (None if file is None else read_ratio_table(home / file) for file in named)
    required, optional = _condition_columns(declared, (table, turbulent))
    conditions, declared = _conditions_of_file(home / declared.conditions.file, required, optional, declared)
    columns = [*declared.thermocouples.columns]
    thermocouples = files.read_csv_columns(
        home / declared.thermocouples.file, ("time_s", *columns), allow_empty=columns, keep_other=False
    )
    return _check_record(declared, conditions, thermocouples, (table, turbulent), home)


def _condition_columns(
    declared: RecordFile, tables: tuple[RatioTable | None, RatioTable | None]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Columns of conditions that a record needs, and those that are read where they are there."""
    heating = declared.heating
    reference = REFERENCE_COLUMNS if heating.reference == "columns" else ()
    needed = ("time_s",) if heating.reference == "none" else (*STATE, "p_surface_Pa", *reference)
    spared = [name for name in SURFACES if not _depends_on_surface(name, heating, tables)]
    # the density may follow from q_Pa: its absence is noticed where it does not
    spared += [*declared.conditions.constants, "rho_kg_m3"]
    required = tuple(c for c in needed if c not in spared)
    return required, (*(c for c in (*STATE, *HEATING) if c not in required), *OPTIONAL_COLUMNS)


def pressure_of_reference(reference: str | None, local_angle_deg: float | None) -> PressureModel | None:
    """Model of the surface pressure of a point with a reference heating; None where its angle [deg] is not stated."""
    has_angle = local_angle_deg is not None or reference in STAGNATION
    return local_pressure(local_angle_deg) if has_angle else None


def _conditions_of_file(
    path: Path, required: Sequence[str], optional: Sequence[str], declared: RecordFile
) -> tuple[CsvTable, RecordFile]:
    """Conditions of a record's file, and its declaration; what follows from other columns is derived, with a warning.

    A density of the standard atmosphere lowers the confidence of the conditions.
    raises : InputError as `read_csv_columns`, or one line with everything that the file lacks
    """
    density, constants = ("rho_kg_m3", "q_Pa"), declared.conditions.constants
    stated = () if required == ("time_s",) or constants.keys() & {*density} else (density,)
    if states_columns(path, required, stated) or not lacks_only_derived(path, required):
        return files.read_csv_columns(path, required, optional), declared
    heating, needed = declared.heating, tuple(dict.fromkeys((*required, *(("rho_kg_m3",) if stated else ()))))
    fields = {name: ConditionField(constant=value) for name, value in constants.items()}
    pressure = pressure_of_reference(heating.reference, heating.local_angle_deg)
    flown = read_flight(path, needed, fields=fields, pressure=pressure)
    warnings.warn(f"{display_path(path)}: {'; '.join(flown.notes)}", stacklevel=4)
    table = replace(flown.table, columns={n: v for n, v in flown.table.columns.items() if n not in constants})
    if not flown.has_model_density:
        return table, declared
    lower = declared.conditions.model_copy(update={"confidence": lowered_confidence(declared.conditions.confidence)})
    return table, declared.model_copy(update={"conditions": lower})


def _depends_on_surface(name: str, heating: Heating, tables: Sequence[RatioTable | None]) -> bool:
    """Whether the heating of a record depends on the deflection of a control surface, by its column."""
    turns = {"elevon_deg": heating.elevon_factor, "bodyflap_deg": heating.bodyflap_factor}
    return turns[name] != 0.0 or depends_on(name, *tables)


def _refuse_folder_of_records(home: Path) -> None:
    """Refuse a directory that contains records and is not one itself, as that of `synthesize` for several points."""
    inside = [] if os.path.lexists(home / DECLARATION) else sorted(p.parent for p in home.glob(f"*/{DECLARATION}"))
    if inside:
        rest = f" and {len(inside) - 2} more" if len(inside) > 2 else ""
        raise InputError(
            f"{display_path(home)}: is a folder of records, not a record; name the records, such as "
            f"{' '.join(map(display_path, inside[:2]))}{rest}"
        )


def make_record(
    declared: RecordFile,
    conditions: Conditions,
    thermocouples: Mapping[str, ArrayLike],
    ratio_table: RatioTable | None = None,
    directory: str | os.PathLike[str] = "record",
    turbulent: RatioTable | None = None,
) -> Record:
    """A record from parts in memory, checked as one that is read from files.

    raises : InputError as for the files that `write_record` would write
    """
    home = Path(directory)
    measured = {name: np.asarray(values, dtype=float) for name, values in thermocouples.items()}
    files.raise_problems(_array_problems(measured, declared, display_path(home / declared.thermocouples.file)))
    heating = declared.heating
    # The constant ratio of a record is a table in memory, and has no file.
    ratio_table = None if heating.ratio is not None else ratio_table
    for key, file, table in (
        ("`ratio_table`", heating.ratio_table, ratio_table),
        ("`ratio_table_turbulent`", heating.turbulent_file, turbulent),
    ):
        if (file is None) != (table is None):
            raise InputError(
                f"{display_path(home / DECLARATION)}, [heating]: {key} and the given table must both be present "
                f"or both absent"
            )
    flown = _as_table(conditions.columns, home / declared.conditions.file)
    readings = _as_table(measured, home / declared.thermocouples.file)
    return _check_record(declared, flown, readings, (ratio_table, turbulent), home)


def _array_problems(measured: Mapping[str, FloatArray], declared: RecordFile, where: str) -> list[str]:
    """Problems of measurements in memory that a file cannot have: absent, of unequal length, not finite."""
    missing = [n for n in ("time_s", *declared.thermocouples.columns) if n not in measured]
    if missing:
        return [f"{where}: there is no column `{name}`; add it" for name in missing]
    time = measured["time_s"]
    is_row = time.ndim == 1 and time.size > 0
    odd = [name for name, values in measured.items() if not is_row or values.shape != time.shape]
    bad = [name for name, values in measured.items() if np.any(np.isinf(values))]
    bad += ["time_s"] * bool(np.any(np.isnan(time)))
    problems = [f"{where}, column {name}: needs one value a sample, and at least one sample" for name in odd]
    return problems + [f"{where}, column {name}: contains a value that is not a finite number" for name in bad]


def _as_table(columns: Mapping[str, FloatArray], path: Path) -> CsvTable:
    """Columns as the CSV file that they would be written to: names on row 1, samples from row 2 on."""
    samples = len(columns["time_s"])
    return CsvTable(dict(columns), {}, path, np.arange(2, samples + 2))


def _check_record(
    declared: RecordFile,
    conditions: CsvTable,
    thermocouples: CsvTable,
    tables: tuple[RatioTable | None, RatioTable | None],
    home: Path,
) -> Record:
    table, turbulent = tables
    available = {*conditions.columns, *declared.conditions.constants}
    spared = [n for n in SURFACES if n not in available and not _depends_on_surface(n, declared.heating, tables)]
    conditions = conditions.with_columns({name: np.zeros(len(conditions)) for name in spared})
    files.raise_problems(_missing_columns(conditions, declared))
    conditions = _whole_conditions(conditions, declared)
    # Constants are columns from here on, and would be given twice where the record is written.
    kept = {"file", "source", "confidence", "uncertainty", "noise"}
    stated = declared.conditions.model_dump(include=kept, exclude_unset=True)
    declared = declared.model_copy(
        update={"conditions": ConditionsFile(**{"file": declared.conditions.file, **stated})}
    )
    files.raise_problems(
        [
            *_condition_problems(conditions, declared),
            *_measurement_problems(thermocouples, declared.thermocouples.sensor),
            *_clock_problems(conditions, thermocouples),
            *_segment_problems(declared, thermocouples, home),
            *_table_problems(declared.heating, table, home),
            *_turbulent_problems(declared.heating, table, turbulent, home),
        ]
    )
    tell(_remarks(conditions, thermocouples, declared, table, home))
    table = declared.heating.constant_ratio() if table is None else table
    flown, lines = Conditions(conditions.columns), thermocouples.lines
    known = _pressure_factor(declared, flown, thermocouples.columns)
    return Record(declared, flown, thermocouples.columns, table, home, turbulent, rows=lines, pressure_factor=known)


def _pressure_factor(declared: RecordFile, flown: Conditions, readings: Mapping[str, FloatArray]) -> Normal:
    """Mean and standard deviation of the surface pressure over that of the conditions [-]."""
    transducers = declared.thermocouples.transducer
    if not transducers:
        return PRESSURE_FACTOR.value, PRESSURE_FACTOR.sigma
    stated = np.interp(readings["time_s"], flown.time_s, flown["p_surface_Pa"], np.nan, np.nan)
    return pressure_factor(transducers, stated, readings)


RADIUS_RATIOS = (0.5, 2.0)
"""Radius that the column of h_ref implies over the declared nose radius: formulas and rarefied air differ by less."""
READING_K, OVERLAP = 60.0, (0.25, 0.5)
"""Least deviation [K] of a reading that stands out; least part of the flight with readings, and of readings in it.

Readings of one phase of an entry, or until a loss of signal, cover a third of it; those of a clock in minutes 1/60, and
a clock of another zero leaves most of them outside."""


def _remarks(
    conditions: CsvTable, thermocouples: CsvTable, declared: RecordFile, table: RatioTable | None, home: Path
) -> list[str]:
    """What is possible and unusual about the samples of a record, and about them and its declaration together."""
    remarks = plausible.unusual_values(conditions)
    declaration = display_path(home / DECLARATION)
    t = thermocouples["time_s"]
    for sensor in declared.thermocouples.sensor:
        T = thermocouples[sensor.column]
        rows = np.flatnonzero(np.isfinite(T))
        if rows.size == 0:
            continue
        usual = USUAL["temperature_K"]
        odd = np.isnan(T) | ((usual.lowest <= T) & (usual.highest >= T))
        rule = f"is unusual ({usual.lowest:g} to {usual.highest:g} K: {usual.source}); check its unit"
        lines = thermocouples.problems_where_not(sensor.column, odd, rule)
        if not lines:
            alone = np.zeros(len(T), dtype=bool)
            alone[rows] = plausible.standing_out(t[rows], T[rows], READING_K)
            rule = "stands out of the readings before and after it; check it, or leave the cell of a lost sample empty"
            lines = thermocouples.problems_where_not(sensor.column, ~alone, rule)
        remarks += lines
    remarks += [*_order_remarks(conditions, thermocouples, declared), *_scatter_remarks(thermocouples, declared)]
    remarks += [] if table is None else _table_remarks(conditions, table)
    remarks += _clock_remarks(conditions, thermocouples)
    radius = declared.heating.nose_radius_m
    if declared.heating.reference == "columns" and radius is not None and "h_ref_kg_m2_s" in conditions.columns:
        ratio = plausible.implied_radius_m(conditions)
        if ratio is not None and not RADIUS_RATIOS[0] <= ratio / radius <= RADIUS_RATIOS[1]:
            text = f"h_ref_kg_m2_s is that of a sphere of {ratio:.3g} m radius, and nose_radius_m = {radius:g}"
            remarks.append(f"{declaration}, [heating]: {display_path(conditions.path)}, column {text}; check both")
    return remarks


def _order_remarks(conditions: CsvTable, thermocouples: CsvTable, declared: RecordFile) -> list[str]:
    """Sensors that read more than any nearer to the surface, and more than at the start.

    By the maximum principle of the heat equation, a temperature within a wall has its maximum at the start or at a
    boundary: that of a shallower sensor, or what is behind the wall.
    """
    if "T_back_K" in (*conditions.columns, *declared.conditions.constants):
        return []
    remarks: list[str] = []
    behind_K = -math.inf if declared.stack.back == "adiabatic" else declared.stack.back.T_K
    hottest, nearest = math.inf, ""
    for sensor in sorted(declared.thermocouples.sensor, key=lambda s: s.depth_m):
        T = thermocouples[sensor.column]
        T = T[np.isfinite(T)]
        if T.size == 0:
            continue
        peak, start = float(np.max(T)), float(T[0])
        if peak > max(hottest, start, behind_K) + READING_K:
            remarks.append(
                f"{display_path(thermocouples.path)}, column {sensor.column}: reads up to {peak:.4g} K, and "
                f"{nearest}, nearer to the heated surface, up to {hottest:.4g} K; check depths, columns and units"
            )
        if peak < hottest:
            hottest, nearest = peak, sensor.column
    return remarks


SCATTER_RATIO, SCATTER_SAMPLES = 3.0, 30
"""Scatter of readings over the declared random error that is reported, and least number of readings for it: the
chi-square of a fit would be nine times what is declared."""


def _scatter_remarks(thermocouples: CsvTable, declared: RecordFile) -> list[str]:
    """Sensors whose readings scatter by far more than the random error that is declared for them.

    The scatter [K] is 1.4826 median |d4| / sqrt(70), with the fourth differences d4 of five readings in a row, in which
    a curve of third order is nothing. A declared error may be larger: it may hold that of a digitised curve.
    """
    remarks: list[str] = []
    for i, sensor in enumerate(declared.thermocouples.sensor, start=1):
        T = thermocouples[sensor.column]
        if sensor.noise_sigma_K is None or len(T) < SCATTER_SAMPLES:
            continue
        fourth = np.convolve(T, [1.0, -4.0, 6.0, -4.0, 1.0], "valid")
        fourth = fourth[np.isfinite(fourth)]
        if fourth.size < SCATTER_SAMPLES:
            continue
        scatter = 1.4826 * float(np.median(np.abs(fourth))) / math.sqrt(70.0)
        grown = float(np.median(sensor.growing_noise_K(T[np.isfinite(T)])))
        stated = sensor.noise_floor_K(math.hypot(sensor.noise_sigma_K, grown))
        if scatter > SCATTER_RATIO * stated:
            remarks.append(
                f"{display_path(thermocouples.path)}, column {sensor.column}: scatters by {scatter:.3g} K, and "
                f"[[thermocouples.sensor]] {i} declares noise_sigma_K = {sensor.noise_sigma_K:g}; check it"
            )
    return remarks


def _table_remarks(conditions: CsvTable, table: RatioTable) -> list[str]:
    """Flights that lie as a whole outside the ratio table in one of its variables."""
    remarks: list[str] = []
    for name, nodes in zip(RATIO_VARIABLES, table.axes, strict=True):
        if len(nodes) < 2 or name not in conditions.columns:
            continue
        low, high = float(np.min(conditions[name])), float(np.max(conditions[name]))
        if low > nodes[-1] or high < nodes[0]:
            remarks.append(
                f"{display_path(conditions.path)}, column {name}: is {low:.4g} to {high:.4g}, and the ratio table has "
                f"{nodes[0]:g} to {nodes[-1]:g}; check its unit"
            )
    return remarks


def _clock_remarks(conditions: CsvTable, thermocouples: CsvTable) -> list[str]:
    """Readings that cover little of the flight, or that lie mostly outside it."""
    t, flown = thermocouples["time_s"], conditions["time_s"]
    inside = np.mean((t >= flown[0]) & (t <= flown[-1]))
    where, least = f"{display_path(thermocouples.path)}, column time_s", OVERLAP
    if inside < least[1]:
        return [f"{where}: {100.0 * inside:.3g} % of the readings lie within the conditions; is it the same clock?"]
    span = (t[-1] - t[0]) / (flown[-1] - flown[0]) if flown[-1] > flown[0] and len(t) > 2 else 1.0
    if span < least[0]:
        return [f"{where}: the readings last {100.0 * span:.3g} % of the conditions' time; is it the same clock?"]
    return []


def _condition_problems(table: CsvTable, declared: RecordFile) -> list[str]:
    """Time that does not increase, impossible values, values in another unit or at odds with what is declared."""
    problems = table.order_problems() + plausible.implausible_values(table)
    return problems or [
        *_recovery_problems(table, declared.heating),
        *_back_problems(table, declared),
        *_interface_problems(table, declared),
    ]


def _recovery_problems(table: CsvTable, heating: Heating) -> list[str]:
    """A column of the total enthalpy where the ratio is reduced with that of an edge."""
    if heating.reference != "columns" or heating.recovery_of_point.kind == "total":
        return []
    flown = Conditions(table.columns)
    total = interpreted(total_enthalpy_kernel)(flown["velocity_m_s"], flown["T_inf_K"])
    defect = total - point_recovery(heating.recovery_of_point, total, flown)[0]
    # A column from another gas or with rounded digits is near the edge's; the total enthalpy lacks all of the defect.
    weight = flown["h_ref_kg_m2_s"] * defect
    if np.sum(weight * (total - flown["H_r_J_kg"])) >= LEAST_DEFECT * np.sum(weight * defect):
        return []
    rule = f'is the total enthalpy; recovery = "{heating.recovery}" needs that of the point, H_0 - (1 - r) u_e^2 / 2'
    hint = 'correct the column, or state recovery = "total" where the ratio is reduced with it'
    return [f"{display_path(table.path)}, column H_r_J_kg: {rule}; {hint}"]


def _whole_conditions(table: CsvTable, declared: RecordFile) -> CsvTable:
    """Conditions with the declared constants as columns, density from dynamic pressure, and rest on the ground.

    raises : InputError where a constant is a column too, or the pressure that a conductivity depends on is not known
    """
    constants, path = declared.conditions.constants, display_path(table.path)
    twice = [name for name in constants if name in table.columns]
    files.raise_problems([f"{path}: `{n}` is a column, and a constant of [conditions]; remove one" for n in twice])
    rows = len(table)
    table = table.with_columns({name: np.full(rows, value) for name, value in constants.items()})
    if declared.heating.reference == "none":
        table = table.with_columns(_at_rest(table, declared))
    return plausible.with_density(table)


def _at_rest(table: CsvTable, declared: RecordFile) -> dict[str, FloatArray]:
    """Conditions that a ground record leaves out: a vehicle at rest in air of the standard atmosphere at sea level."""
    T_0, p_0, _ = us76(0.0)
    air = {"T_inf_K": np.full(len(table), T_0), "p_inf_Pa": np.full(len(table), p_0)}
    air |= {name: table[name] for name in air if name in table.columns}
    depends = any(isinstance(m.conductivity_W_mK, PressureTable) for m in declared.materials.values())
    if depends and not {"p_surface_Pa", "p_inf_Pa"} & set(table.columns):
        raise InputError(
            f"{display_path(table.path)}: there is no column `p_surface_Pa`, on which a conductivity depends; add it, "
            "or give the constant in [conditions]"
        )
    rest = dict.fromkeys(STATE, np.zeros(len(table))) | air | {"rho_kg_m3": air["p_inf_Pa"] / (R_AIR * air["T_inf_K"])}
    rest |= {"p_surface_Pa": air["p_inf_Pa"]}
    absent = {name: value for name, value in rest.items() if name not in table.columns}
    if "q_Pa" in table.columns:
        absent.pop("rho_kg_m3", None)
    return absent


def _back_problems(table: CsvTable, declared: RecordFile) -> list[str]:
    """A temperature behind a wall whose back face exchanges no heat."""
    if "T_back_K" not in table.columns or declared.stack.back != "adiabatic":
        return []
    rule = "has no effect behind an adiabatic wall; declare `back = { h_W_m2K, T_K, emissivity }` in [stack]"
    return [f"{display_path(table.path)}, column T_back_K: {rule}"]


def _interface_problems(table: CsvTable, declared: RecordFile) -> list[str]:
    """A declared interface without the temperature of its wall upstream, or that temperature without an interface; a
    declared transition that is not there."""
    path, interface, column = display_path(table.path), declared.heating.interface, "T_upstream_K" in table.columns
    if interface is None:
        rule = "has no effect without [heating.interface]; declare it, or remove the column"
        return [f"{path}, column T_upstream_K: {rule}"] if column else []
    if column and interface.stack is not None:
        return [f"{path}, column T_upstream_K: [heating.interface] has a `stack` as well; remove one of the two"]
    if not column and interface.stack is None:
        rule = "the wall upstream of [heating.interface]; add it, or the `stack` of that wall"
        return [f"{path}: there is no column `T_upstream_K`, {rule}"]
    if interface.flow == "declared transition" and declared.heating.transition is None:
        return ["[heating.interface]: `flow`: needs [heating.transition]; declare it, or give laminar or turbulent"]
    return []


def _missing_columns(table: CsvTable, declared: RecordFile) -> list[str]:
    """Missing columns of a record in memory; a file without them is rejected on reading."""
    if declared.heating.reference == "none":
        return []
    needed = ["p_surface_Pa", *(REFERENCE_COLUMNS if declared.heating.reference == "columns" else ())]
    available = {*table.columns, *declared.conditions.constants} | {"rho_kg_m3"}
    absent = [name for name in (*STATE, *needed) if name not in available]
    return [f"{display_path(table.path)}: there is no column `{name}`; add it" for name in absent]


def _measurement_problems(table: CsvTable, sensors: Sequence[Sensor]) -> list[str]:
    """Time that does not increase, temperatures in Celsius or outside the recorder's range, used but empty columns."""
    problems = table.order_problems()
    for sensor in sensors:
        T = table[sensor.column]
        if sensor.calibration is None:
            problems += table.celsius_problems(sensor.column)
        problems += table.problems_where_not(sensor.column, ~(np.abs(T) > HOTTEST_K), "is not a temperature of a wall")
        if sensor.bits is not None and sensor.range_K is not None:
            low, high = sensor.range_K
            outside = (low - sensor.lsb_K > T) | (high + sensor.lsb_K < T)
            rule = f"is outside range_K = [{low:g}, {high:g}] of sensor {sensor.name}; correct the sample or the range"
            problems += table.problems_where_not(sensor.column, ~outside | (T < 100.0), rule)
        if sensor.used and np.all(np.isnan(T)):
            rule = f"sensor {sensor.name} has no sample; set used = false or remove it"
            problems.append(f"{display_path(table.path)}, column {sensor.column}: {rule}")
    return problems


def _clock_problems(conditions: CsvTable, thermocouples: CsvTable) -> list[str]:
    """Measurements that lie entirely outside the time of the conditions."""
    first, last = conditions["time_s"][0], conditions["time_s"][-1]
    t = thermocouples["time_s"]
    if np.any((t >= first) & (t <= last)):
        return []
    rule = f"no sample lies in the {first:g} to {last:g} s of the conditions; both files must use the same clock"
    return [f"{display_path(thermocouples.path)}, column time_s: {rule}"]


def _segment_problems(declared: RecordFile, thermocouples: CsvTable, home: Path) -> list[str]:
    """Segments that lie wholly outside the measured time."""
    first, last = thermocouples["time_s"][0], thermocouples["time_s"][-1]
    where = f"{display_path(home / DECLARATION)}, [segments]"
    return [
        f"{where}: `{key}`, row {i + 1}: {segment} lies outside the measured {first:g} to {last:g} s; correct it"
        for key in ("fit", "holdout")
        for i, segment in enumerate(getattr(declared.segments, key) or [])
        if segment[1] < first or segment[0] > last
    ]


def _table_problems(heating: Heating, table: RatioTable | None, home: Path) -> list[str]:
    """A ratio table over another reference heating than the record's, or reduced with another recovery enthalpy."""
    if table is None:
        return []
    file = display_path(home / str(heating.ratio_table))
    differs = table.recovery_problem(heating.recovery_of_point.kind, heating.reference)
    return _reference_problems(heating, table, file) or (
        [] if differs is None else [f"{file}, {differs} of the record"]
    )


def _turbulent_problems(
    heating: Heating, laminar: RatioTable | None, turbulent: RatioTable | None, home: Path
) -> list[str]:
    """A turbulent table that does not go with the laminar one."""
    if turbulent is None or laminar is None:
        return []
    file = display_path(home / str(heating.turbulent_file))
    if laminar.reference is not None and turbulent.reference != laminar.reference:
        stated = f"is `{turbulent.reference}`, that of the laminar table `{laminar.reference}`"
        return [f"{file}, header `reference`: {stated}; they must agree"]
    return [
        f"{file}, {line} of the record"
        for line in turbulent_problems(turbulent, heating.recovery_of_point.kind, heating.reference)
    ]


def _reference_problems(heating: Heating, table: RatioTable, file: str) -> list[str]:
    """A ratio table over an unknown reference heating, or over another one than the record's."""
    if table.reference is None:
        return []
    models = (*STAGNATION, *FLAT_PLATE)
    if table.reference not in models:
        rule = f"unknown reference heating `{table.reference}`{files.suggestion(table.reference, models)}"
        return [f"{file}, header `reference`: {rule}"]
    if heating.reference in ("columns", "none", table.reference):
        return []
    rule = f"is over `{table.reference}`, the record's heating.reference is `{heating.reference}`; they must agree"
    return [f"{file}, header `reference`: {rule}"]


# Writing -------------------------------------------------------------------------------------------------------------


def write_record(
    record: Record,
    directory: str | os.PathLike[str],
    formats: Mapping[str, str] | None = None,
    comment: str = "",
) -> None:
    """Write a record as a directory, whole or not at all; without formats every number reads back equal.

    formats : number format by column of the CSV files, as in {"time_s": ".2f"}
    comment : lines at the head of record.toml
    raises  : InputError where the directory contains files of these names that this program did not write
    """
    with record_directory(directory) as folder:
        for name, text in record_texts(record, formats, comment).items():
            files.write_text_atomic(folder / name, text)


def record_texts(record: Record, formats: Mapping[str, str] | None = None, comment: str = "") -> dict[str, str]:
    """The files of a record's directory by name; arguments as of `write_record`."""
    declared = record.declared
    conditions = {name: values for name, values in record.conditions.columns.items() if name not in DERIVED}
    tables = (
        (declared.heating.ratio_table, record.ratio_table),
        (declared.heating.turbulent_file, record.turbulent),
    )
    return {
        DECLARATION: files.toml_text(declared.model_dump(exclude_unset=True), comment),
        declared.conditions.file: files.csv_text(conditions, formats),
        declared.thermocouples.file: files.csv_text(record.thermocouples, formats),
        **{file: ratio_table_text(table, formats) for file, table in tables if file is not None and table is not None},
    }


def record_directory(directory: str | os.PathLike[str]) -> AbstractContextManager[Path]:
    """Context in which the files of a record are written into a directory, which lists them at the end."""
    return files.output_directory(directory, "write_record")
