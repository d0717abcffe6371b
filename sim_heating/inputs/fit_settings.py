"""Settings of a fit, as a TOML file or a table of one states them; every key is optional.

parameters = ["default", "clock.skew"]      # names of what is estimated; `default`: magnitude and derivatives
reference = { alpha_deg = 40.0 }            # condition that derivatives are about
start = "circuit:650"                       # where the march begins, as `--start` of `sim-heating estimate`
fit = [[640.0, 760.0]]                      # segments in place of the record's own [s]; start and fit also by flight:
                                            # fit = { "STS-2" = [[640.0, 760.0]], "STS-4" = [[700.0, 820.0]] }
tie = [["stack.coating.thickness_factor"]]  # names of parameters that have one value, each a tie
[fix]
ratio.d_alpha = 0.0013                      # value of a parameter that is not estimated
[prior]
"clock.skew@STS-2" = [0.0, 0.3]             # mean and standard deviation, or "flat"
[bound]
ratio.scale = [-0.5, 0.5]                   # least and greatest value
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, field_validator

from sim_heating.base.files import Declared, Location, raise_located
from sim_heating.inputs.record import ReferenceCondition, Segments

FLAT = "flat"


def _by_dotted_name(tables: Any) -> Any:
    """Nested tables as one with dotted names: TOML reads the key `ratio.d_alpha` as `d_alpha` of a table `ratio`."""
    if not isinstance(tables, Mapping):
        return tables
    dotted: dict[str, Any] = {}
    for key, value in tables.items():
        below = _by_dotted_name(value)
        dotted |= {f"{key}.{k}": v for k, v in below.items()} if isinstance(below, dict) else {key: value}
    return dotted


def dotted(value: Any) -> BeforeValidator:
    """Validator of a table by dotted names, of which TOML makes tables in tables where they have no quotes."""
    return BeforeValidator(_by_dotted_name, json_schema_input_type=dict[str, value | dict[str, Any]])


class ParameterSettings(Declared):
    """What is estimated, and what is known of the parameters before."""

    quantities: ClassVar = {"fix": None, "prior": None, "bound": None}

    parameters: list[str] | None = Field(default=None, min_length=1, description="names of parameters")
    reference: ReferenceCondition | None = None
    fix: Annotated[dict[str, float], dotted(float)] = Field(default_factory=dict, description="name = value")
    prior: Annotated[dict[str, list[float] | Literal["flat"]], dotted(list[float] | Literal["flat"])] = Field(
        default_factory=dict, description='name = [mean, sigma], or "flat"'
    )
    bound: Annotated[dict[str, list[float]], dotted(list[float])] = Field(
        default_factory=dict, description="name = [least, greatest]"
    )
    tie: list[list[str]] = Field(default_factory=list, description='[["name", "name", ...], ...]')

    @field_validator("prior", "bound")
    @classmethod
    def _check_pairs(cls, values: dict[str, Any]) -> dict[str, Any]:
        problems: list[tuple[Location, str]] = [
            ((name,), f"{value} is not a pair; give two numbers")
            for name, value in values.items()
            if value != FLAT and len(value) != 2
        ]
        raise_located(problems)
        return values

    @property
    def reference_condition(self) -> dict[str, float]:
        """Values that derivatives are about, by variable ([deg], log10 Re [-])."""
        return {} if self.reference is None else self.reference.model_dump(exclude_none=True)

    @property
    def priors(self) -> dict[str, tuple[float, float]]:
        """Mean and standard deviation by name, each in the unit of the parameter; a flat one has mean 0."""
        return {n: (0.0, math.inf) if p == FLAT else (float(p[0]), float(p[1])) for n, p in self.prior.items()}

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """Least and greatest value by name, each in the unit of the parameter."""
        return {n: (b[0], b[1]) for n, b in self.bound.items()}


class FitSettings(ParameterSettings):
    """What is estimated, from which readings, and what is known of the parameters before.

    `start` and `fit` hold for all records, or by record, flight or control point; under "" for all others.
    """

    start: str | dict[str, str] | None = Field(default=None, description='as `--start`, for example "circuit:650"')
    fit: list[list[float]] | dict[str, list[list[float]]] | None = Field(
        default=None, min_length=1, description='[[start_s, end_s], ...], or { "FLIGHT" = [[start_s, end_s], ...] }'
    )

    @field_validator("fit")
    @classmethod
    def _check_segments(cls, segments: Any) -> Any:
        for of_record in segments.values() if isinstance(segments, dict) else [segments]:
            Segments(fit=of_record)
        return segments

    @property
    def starts(self) -> dict[str, str]:
        """Where marches begin, by record, flight or control point; under "" for all others."""
        return self.start if isinstance(self.start, dict) else {} if self.start is None else {"": self.start}

    @property
    def segments_s(self) -> dict[str, list[list[float]]]:
        """Segments [[start, end], ...] [s] by record, flight or control point; under "" for all others."""
        return self.fit if isinstance(self.fit, dict) else {} if self.fit is None else {"": self.fit}
