"""Every parameter that is listed for a record changes what is computed from it; others are refused with the right name."""

from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.estimation.inference.observability import constant_variables
from sim_heating.estimation.parameter_list import parameter_list
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.heating.effects import effects, use
from sim_heating.inputs.record import load_record

TILE = Path(__file__).parent.parent / "data" / "records" / "tile"


def problem(*names: str) -> FitProblem:
    record = load_record(TILE)
    return FitProblem([record], list(names), joint_reference([record], None), FitOptions())


@pytest.mark.parametrize(
    ("name", "instead"),
    [
        ("effect.sensor-lag.tau_s", "`sensors.tau_s`"),
        ("effect.time-skew.skew_s", "`clock.skew`"),
        ("effect.recombination.efficiency", r"\[heating.catalysis\]"),
    ],
)
def test_name_that_does_nothing_is_refused_with_the_right_one(name, instead):
    with pytest.raises(InputError, match=instead):
        problem("ratio.scale", name)


def test_name_that_does_nothing_cannot_be_fixed_either():
    record = load_record(TILE)
    with pytest.raises(InputError, match="`clock.skew`"):
        options = FitOptions(fixed={"effect.time-skew.skew_s": 0.3})
        FitProblem([record], ["ratio.scale"], joint_reference([record], None), options)


# --- All names of a model ----------------------------------------------------------------------------------------------

ACTIVE = {
    "stack.moisture.latent_J_kg": 1e5, "stack.moisture.deposit_J_kg": 5e4, "stack.moisture.vapour_W_m": 5.0,
    "stack.gap.fraction": 0.2, "stack.rsi.radiative_conductivity": 0.03, "stack.rsi.radiation_from_K": 400.0,
    "back.h_W_m2K": 5.0, "back.T_K": 280.0,
}  # fmt: skip
"""Sizes of what has none as declared: without it its temperature, its depth or its width means nothing."""
ON = {
    "added-curve": {"variable": 0.0, "low": 30.0, "high": 45.0, "s_0": 0.02, "s_1": 0.01, "s_2": 0.02},
    "catalysis": {"flow_J_kg": 2e7, "fall_K": 1500.0},
}
"""Values at which an effect acts, where it does nothing as it stands in its definition."""


def varied_flight():
    """The tile's entry with every condition that an effect reads moving."""
    flown = conditions_of_record(load_record(TILE)).at(np.linspace(0.0, 1.0, 61) ** 1.0 * 0.0 + np.arange(61.0))
    return flown
