"""Uncertain inputs of an entry and their distributions: the [dispersion] table of a study.

[dispersion]
flights = 8192                      # in all, over `scrambles` independent scrambles of a Sobol' sequence
[[dispersion.input]]
name = "entry.gamma_deg"            # one of FLIGHT_INPUTS, or a dotted parameter of the control points or their effects
sigma = 0.03                        # normal about the declared value; or low and high: uniform deviation from it
over = [[0.0, 0.2], [80e3, 1.0]]    # for `air.*`: factor on the deviation over altitude [m]
title = "the whole column"          # distinguishes it from others of its name, in tables and pictures
control_points = ["NOSECAP"]        # for a parameter of points: only these; one deviation for all of them
model_error = true                  # the smooth error of the heating, as the band of a run has it
[[dispersion.member]]               # an estimate of flights, with a weight; a flight has one, drawn by the weights
estimate = "../out/fit"             # planning/members.py
weight = 3.0

Every input is a deviation from the base entry, independent of the others. A ratio table that has a sigma is uncertain
by itself, with correlated nodes (planning/ratio_table_modes.py).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar, Literal

from pydantic import Field, SerializerFunctionWrapHandler, field_validator, model_serializer, model_validator

from sim_heating.base.files import Declared, suggestion
from sim_heating.base.parameters import EFFECT_PREFIX, MODEL, layer_parameter
from sim_heating.planning.members import StudyMember

FLIGHT_INPUTS = {
    "entry.altitude_m": ("altitude at entry", "m"),
    "entry.velocity_m_s": ("velocity at entry", "m/s"),
    "entry.gamma_deg": ("path angle at entry", "deg"),
    "entry.heading_deg": ("heading at entry", "deg"),
    "entry.latitude_deg": ("latitude at entry", "deg"),
    "entry.longitude_deg": ("longitude at entry", "deg"),
    "air.density": ("density, relative", "1"),
    "air.wind_north_m_s": ("wind to the north", "m/s"),
    "air.wind_east_m_s": ("wind to the east", "m/s"),
    "aero.CN": ("normal force CN, relative", "1"),
    "aero.CA": ("axial force CA, relative", "1"),
    "aero.Cm": ("pitching moment Cm", "1"),
    "vehicle.mass_kg": ("mass", "kg"),
    "vehicle.cg_fraction": ("centre of gravity over length", "1"),
    "guidance.alpha_deg": ("angle of attack held", "deg"),
}
"""Inputs that change the flight: description and unit. `air.density`, `aero.CN` and `aero.CA` are relative
deviations; `aero.Cm` adds to the pitching moment at all Mach numbers; `guidance.alpha_deg` to the schedule of angle of
attack."""
PROFILED = ("air.density", "air.wind_north_m_s", "air.wind_east_m_s")
"""Inputs that are profiles over altitude."""
LARGEST_SIGMAS = 5.0
"""Standard deviations that a normal deviation stays within: one in two million lies beyond."""


class DispersedInput(Declared):
    """One uncertain input: normal with `sigma`, or uniform from `low` to `high`; both as deviations.

    name : an input of a flight, as `mass` or `air.density`, or a dotted parameter of a control point
    low, high : ends of a uniform deviation, in the unit of the input
    over : profile of the deviation, [[altitude_m, factor], ...]
    """

    quantities: ClassVar = {"over": ("altitude_m", None)}

    name: str
    sigma: float | None = Field(default=None, gt=0.0, description="standard deviation, above 0")
    low: float | None = None
    high: float | None = None
    over: list[list[float]] | None = Field(default=None, min_length=1)
    control_points: list[str] | None = Field(default=None, min_length=1)
    title: str = ""

    @field_validator("name")
    @classmethod
    def _is_an_input(cls, name: str) -> str:
        names = [*FLIGHT_INPUTS, *MODEL]
        if name not in names and not name.startswith(EFFECT_PREFIX) and layer_parameter(name) is None:
            raise ValueError(f"there is no input `{name}`{suggestion(name, names)}")
        return name

    @field_validator("over")
    @classmethod
    def _is_a_profile(cls, profile: list[list[float]] | None) -> list[list[float]] | None:
        if profile is not None and (any(len(pair) != 2 for pair in profile) or sorted(profile) != profile):
            raise ValueError("a profile is [[altitude_m, factor], ...] with rising altitudes")
        return profile

    @model_validator(mode="after")
    def _has_one_distribution(self) -> DispersedInput:
        uniform = self.low is not None and self.high is not None and self.low < self.high
        if (self.sigma is None) != uniform or (self.sigma is not None and (self.low, self.high) != (None, None)):
            raise ValueError(f"`{self.name}`: give sigma, or low and high with low below high")
        if (self.over is not None) != (self.name in PROFILED):
            raise ValueError(
                f"`{self.name}`: give `over`, [[altitude_m, factor], ...]"
                if self.over is None
                else f"`{self.name}`: `over` is only for {', '.join(PROFILED)}"
            )
        if self.control_points is not None and self.name in FLIGHT_INPUTS:
            raise ValueError(f"`{self.name}` changes the flight, not a control point; remove `control_points`")
        return self

    @property
    def standard_deviation(self) -> float:
        """Standard deviation of the deviation, in the unit of the input."""
        if self.low is None or self.high is None:
            return float(self.sigma or 0.0)
        return (self.high - self.low) / math.sqrt(12.0)

    def points_of(self, names: Sequence[str]) -> list[int]:
        """Numbers of the control points that it is of; names : of all points of the study."""
        return [p for p, name in enumerate(names) if self.control_points is None or name in self.control_points]

    def describe(self, unit: str) -> tuple[str, str]:
        """Name and size of the input for tables and pictures, as ("mass", "sigma 400 kg").

        unit : of a parameter of control points, which is described by its own name; FLIGHT_INPUTS have their own unit
        """
        quantity, unit = FLIGHT_INPUTS.get(self.name, (self.name, unit))
        name = f"{quantity} ({self.title})" if self.title else quantity
        most = max((abs(factor) for _, factor in self.over or []), default=1.0)
        low, high = (0.0 if end is None else end * most for end in (self.low, self.high))
        size = f"{low:.3g} to {high:.3g}" if self.sigma is None else f"sigma {self.sigma * most:.3g}"
        return name, f"{size}{'' if unit == '1' else f' {unit}'}{'' if self.over is None else ' at most'}"


class Dispersion(Declared):
    """The [dispersion] table: number of flights, design, inputs, and statistics asked for.

    sampling      : "sobol": scrambled Sobol' sequences; "random": independent flights
    scrambles     : independent scrambles, each with the same number of flights
    index_flights : N of the sensitivity indices, which cost N (inputs + 2) flights; 0 omits them
    quantiles     : quantiles of peak temperatures that are reported
    confidence    : of the bounds of quantiles and probabilities
    tables        : factor on the sigma of the ratio tables; 0 disperses none
    model_error   : whether the heating of each flight has the smooth error that `run --bands` has
    step_s        : step of the flight [s]
    thermal_step_s : step of the thermal march [s], a multiple of step_s
    spot_checks   : flights that are also flown in six degrees of freedom (JSBSim)
    member        : estimates from flights, one of which each flight has by the weights, in place of what the vehicle
                    declares of their control points
    flights : number of dispersed flights
    seed : of the random numbers
    """

    flights: int = Field(default=1024, ge=8, le=10_000_000)
    sampling: Literal["sobol", "random"] = "sobol"
    scrambles: int = Field(default=8, ge=2, le=1024)
    seed: int = Field(default=1, ge=0)
    index_flights: int = Field(default=0, ge=0, le=1_000_000)
    quantiles: list[float] = Field(default=[0.5, 0.95, 0.99], min_length=1)
    confidence: float = Field(default=0.95, gt=0.5, lt=1.0)
    tables: float = Field(default=1.0, ge=0.0, le=10.0)
    model_error: bool = False
    step_s: float = Field(default=0.5, gt=0.0, le=5.0)
    thermal_step_s: float = Field(default=4.0, gt=0.0, le=60.0)
    spot_checks: int = Field(default=0, ge=0, le=100)
    input: list[DispersedInput] = Field(default=[], max_length=256)
    member: list[StudyMember] = Field(default=[], max_length=64)

    @model_serializer(mode="wrap")
    def _without_what_is_not_asked_for(self, contents: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """The hash of a study that does not ask for the model's error is as before that could be asked for."""
        data: dict[str, Any] = contents(self)
        return {key: value for key, value in data.items() if key != "model_error" or value}

    @field_validator("quantiles")
    @classmethod
    def _are_quantiles(cls, quantiles: list[float]) -> list[float]:
        if not all(0.0 < q < 1.0 for q in quantiles):
            raise ValueError(f"{quantiles}: each must lie between 0 and 1")
        return sorted(quantiles)

    @model_validator(mode="after")
    def _divides(self) -> Dispersion:
        if self.flights % self.scrambles:
            raise ValueError(f"flights: {self.flights} must be a multiple of scrambles, {self.scrambles}")
        ratio = self.thermal_step_s / self.step_s
        if abs(ratio - round(ratio)) > 1e-9 or round(ratio) < 1:
            raise ValueError(f"thermal_step_s: {self.thermal_step_s:g} must be a multiple of step_s, {self.step_s:g}")
        return self
