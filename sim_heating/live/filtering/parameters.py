"""Parameters of a running estimate: which ones it can have, and the priors of those that none was given for."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from sim_heating.base.errors import InputError
from sim_heating.base.files import suggestion
from sim_heating.base.parameters import CLOCK_SKEW, SENSOR, SENSOR_PREFIX
from sim_heating.estimation.filter.online import Prior
from sim_heating.estimation.record_fit import error_definition
from sim_heating.march.point import PointModel
from sim_heating.thermal.stack import Sensor

WIDE = 0.5
"""Prior standard deviation of `ratio.scale`, and of what a derivative adds to a ratio over a usual range, over the
ratio [-]; where neither the model nor the caller states one."""
USUAL_RANGE = {"alpha": 5.0, "beta": 2.0, "logre": 0.5, "elevon": 5.0, "bodyflap": 5.0}
"""Change of a variable of the ratio over which WIDE holds, in deg or decades."""
LARGEST_RATIO = 1.0
"""Heating ratio of which WIDE is a part where there is no table [-]."""


def check_estimated(sensors: Mapping[str, Sequence[Sensor]], names: Sequence[str]) -> None:
    """Refuse parameters of sensors and clock that a running estimate cannot have.

    sensors : of each control point, by its name;  names : parameters to estimate
    raises  : InputError with one line
    """
    used = {s.name for of_point in sensors.values() for s in of_point if s.used}
    for name in names:
        if not name.startswith((SENSOR_PREFIX, "clock.", "sensors.")) or name == CLOCK_SKEW.name:
            continue
        sensor, _, kind = name.removeprefix(SENSOR_PREFIX).rpartition(".")
        if not name.startswith(SENSOR_PREFIX) or kind not in ("bias", "gain", "drift"):
            raise InputError(
                f"`{name}`: a running estimate cannot have it; of sensors it has bias, gain and drift, and of the "
                f"clock `{CLOCK_SKEW.name}`. Leave it out here and `estimate` the record"
            )
        if sensor not in used:
            raise InputError(f"`{name}`: unknown or unused sensor `{sensor}`{suggestion(sensor, used)}")


def is_of_march(name: str) -> bool:
    """Whether a parameter is one of the march, and not of sensors or clock."""
    return not name.startswith(SENSOR_PREFIX) and name != CLOCK_SKEW.name


def default_prior(model: PointModel, name: str, sensors: Sequence[Sensor] = ()) -> Prior:
    """Prior of a parameter that none was given for: its definition's, and a wide one for the heating ratio.

    model : of the control point;  name : dotted name, or that of a sensor's error;  sensors : of the point

    The derivative of a ratio may change it by half over a usual range of its variable; a scale may be off by half.
    """
    if name.startswith(SENSOR_PREFIX):
        stem, _, kind = name.removeprefix(SENSOR_PREFIX).rpartition(".")
        definition = next((error_definition(s, kind) for s in sensors if s.name == stem), SENSOR[kind])
        return Prior(definition.value, definition.sigma)
    if name == CLOCK_SKEW.name:
        return Prior(CLOCK_SKEW.value, CLOCK_SKEW.sigma)
    definition = model.definition(name)
    mean = model.value(name)
    if math.isfinite(definition.sigma) and definition.sigma > 0.0:
        return Prior(mean, definition.sigma)
    if name == "ratio.scale":
        return Prior(mean, WIDE)
    ratio = LARGEST_RATIO if model.ratio is None else float(np.max(np.abs(model.ratio.ratio)))
    spans = [USUAL_RANGE[v] for v in _variables(name)]
    return Prior(mean, WIDE * ratio / math.prod(spans))


def _variables(name: str) -> list[str]:
    """Variables of a derivative of the heating ratio by its name: `ratio.d_alpha_elevon` has two."""
    variables = name.removeprefix("ratio.d").strip("_0")
    if variables.endswith("2"):
        return [variables[:-1]] * 2
    return [v for v in variables.split("_") if v in USUAL_RANGE]
