"""A pressure transducer at a control point, and what its readings say of the surface pressure.

The transducer is read with the thermocouples. It indicates, and its recorder stores as a word like theirs,

    p_ind = g f p + b + N(0, sigma),    g ~ N(1, sigma_g),    b ~ N(0, sigma_b),

p the pressure that the record's conditions state, f the factor on it that `conditions.p_surface_factor` is, g and b the
gain and the bias of the transducer. Of the unknowns of a fit f alone is common to its readings and to those of
thermocouples, which depend on the pressure by the conductivity of the insulation. With g and b integrated out, the
likelihood of the transducer is the normal one of f that `pressure_factor` gives.
Source: docs/theory/equations.md, equation 34b.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
from pydantic import Field, field_validator, model_validator

from sim_heating.base.arrays import FloatArray
from sim_heating.base.files import Declared, Location
from sim_heating.base.parameters import PRESSURE_FACTOR
from sim_heating.inputs.sensor_model import word_value
from sim_heating.thermal.sampling import require_span, word_step
from sim_heating.thermal.stack import Sensor

Normal = tuple[float, float]
"""Mean and standard deviation."""


class PressureTransducer(Declared):
    """A pressure transducer at the surface, recorded with the thermocouples.

    name : name of the transducer
    used : false: its readings are not used
    """

    quantities: ClassVar = {"range_Pa": "p_surface_Pa"}

    name: str = Field(min_length=1)
    column: str = Field(min_length=1, description="column of the measurements, ending in _Pa")
    noise_sigma_Pa: float = Field(gt=0.0, description="random part in Pa, above 0")
    bias_sigma_Pa: float = Field(default=0.0, ge=0.0, description="standard deviation of its bias in Pa")
    gain_sigma: float = Field(default=0.0, ge=0.0, le=1.0, description="standard deviation of its gain, relative")
    bits: int | None = Field(default=None, ge=1, le=32, description="bits of the recorder word")
    range_Pa: list[float] | None = Field(default=None, description="[lowest, highest] in Pa")
    used: bool = True

    @field_validator("column")
    @classmethod
    def _check_column(cls, column: str) -> str:
        if not column.endswith("_Pa"):
            raise ValueError(f"`{column}` does not end in _Pa; give pressures in Pa, in a column that says so")
        return column

    @field_validator("range_Pa")
    @classmethod
    def _check_range(cls, range_Pa: list[float] | None) -> list[float] | None:
        if range_Pa is not None and (len(range_Pa) != 2 or not 0.0 <= range_Pa[0] < range_Pa[1]):
            raise ValueError(f"{range_Pa} is not [lowest, highest]; give two increasing pressures in Pa, 0 or above")
        return range_Pa

    @model_validator(mode="after")
    def _check_word(self) -> PressureTransducer:
        require_span(self.bits, self.range_Pa, "range_Pa")
        return self

    @property
    def lsb_Pa(self) -> float:
        """Step of the recorder word [Pa]; 0 where nothing is rounded: docs/theory/equations.md, equation 34."""
        return word_step(self.bits, self.range_Pa)


def measure_pressure(transducer: PressureTransducer, pressure_Pa: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Readings of a transducer [Pa]: gain and bias drawn from what is known of them, noise, recorder word.

    pressure_Pa : (sample,) at the surface, at the sample times [Pa]

    Source: docs/theory/equations.md, equations 34 and 34b.
    """
    gain, bias_Pa = rng.normal(1.0, transducer.gain_sigma), rng.normal(0.0, transducer.bias_sigma_Pa)
    read = gain * pressure_Pa + bias_Pa + rng.normal(0.0, transducer.noise_sigma_Pa, len(pressure_Pa))
    if transducer.bits is None or transducer.range_Pa is None:
        return read
    return word_value(read, transducer.range_Pa[0], transducer.lsb_Pa, transducer.bits)


def pressure_factor(
    transducers: Sequence[PressureTransducer], pressure_Pa: FloatArray, readings: Mapping[str, FloatArray]
) -> Normal:
    """Mean and standard deviation of the factor on the surface pressure [-]: its prior, and what transducers read.

        f = sum_i w_i p_i y_i / I,    I = sum_i w_i p_i^2,    variance 1 / I + sigma_g^2

    of each transducer, with the weights w of s^2 = sigma^2 + LSB^2 / 12 from which the bias is eliminated. The
    estimates of several, and the prior, are averaged by their variances.

    pressure_Pa : (sample,) stated at the times of the readings [Pa], NaN outside the conditions
    readings    : column -> (sample,) [Pa]; NaN is a lost sample, and one at an end of the word's span says too little

    Source: docs/theory/equations.md, equation 34b.
    """
    information, pull = PRESSURE_FACTOR.sigma**-2.0, PRESSURE_FACTOR.value * PRESSURE_FACTOR.sigma**-2.0
    for transducer in (t for t in transducers if t.used):
        read = readings[transducer.column]
        known = np.isfinite(read) & np.isfinite(pressure_Pa)
        if transducer.range_Pa is not None and transducer.bits is not None:
            low, high = transducer.range_Pa
            known &= (read > low + 0.5 * transducer.lsb_Pa) & (read < high - 0.5 * transducer.lsb_Pa)
        p, y = pressure_Pa[known], read[known]
        variance = transducer.noise_sigma_Pa**2 + transducer.lsb_Pa**2 / 12.0
        # what the prior of the bias leaves of the means: all of them where it is known, nothing where it is free
        share = transducer.bias_sigma_Pa**2 / (variance + len(p) * transducer.bias_sigma_Pa**2)
        own = float(p @ p - share * np.sum(p) ** 2) / variance
        if own > 0.0:
            factor = float(p @ y - share * np.sum(p) * np.sum(y)) / variance / own
            weight = 1.0 / (1.0 / own + transducer.gain_sigma**2)
            information, pull = information + weight, pull + weight * factor
    return pull / information, information**-0.5


def transducer_problems(
    transducers: Sequence[PressureTransducer], sensors: Sequence[Sensor]
) -> list[tuple[Location, str]]:
    """Names and columns of transducers that another instrument has.

    sensors : thermocouples of the same file;  returns ((index of the transducer, key), text) of each problem
    """
    problems: list[tuple[Location, str]] = []
    for i, transducer in enumerate(transducers):
        for key in ("name", "column"):
            value, others = getattr(transducer, key), (*sensors, *transducers[:i])
            if value in [getattr(other, key) for other in others]:
                problems.append(((i, key), f"`{value}` is that of another instrument; give each its own"))
    return problems
