"""Every parameter that is listed changes what is computed; others are refused with the right name."""

from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.heating.effects import effects, use
from sim_heating.heating.effects.curve import VALUES
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import load_record
from sim_heating.march.history import march_points

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
    options = FitOptions(fixed={"effect.time-skew.skew_s": 0.3})
    with pytest.raises(InputError, match=r"`clock\.skew`"):
        FitProblem([record], ["ratio.scale"], joint_reference([record], None), options)


# --- All names of a model --------------------------------------------------------------------------------------------

ACTIVE = {
    "stack.moisture.latent_J_kg": 1e5, "stack.moisture.deposit_J_kg": 2e4, "stack.moisture.vapour_W_m": 5.0,
    "stack.gap.fraction": 0.2, "stack.rsi.radiative_conductivity": 0.03, "stack.rsi.radiation_from_K": 400.0,
}  # fmt: skip
"""Sizes of what has none as declared: without it its temperature, its depth or its width means nothing."""
ON = {
    "effect.added-curve.variable": 0.0, "effect.added-curve.low": 37.0, "effect.added-curve.high": 43.0,
    "effect.curve.variable": 0.0, "effect.curve.low": 37.0, "effect.curve.high": 43.0,
    "effect.catalysis.fall_K": 900.0, "effect.catalysis.catalysis_K": 800.0,
    "effect.transition.log10_re_onset": 5.9, "effect.transition.by_re_theta": 0.0,
    "effect.nonisothermal-wall.decay_begin_s": 50.0, "effect.emissivity.change_s": 100.0,
    "effect.recombination.highest_K": 400.0,
    **{f"effect.{curve}.{value}": 0.03 * k for curve in ("curve", "added-curve") for k, value in enumerate(VALUES)},
}  # fmt: skip
"""Values at which a parameter acts in this flight, where those of its definition lie outside of it."""


def varied_flight():
    """The tile's entry with every condition that heating reads moving."""
    flown = conditions_of_record(load_record(TILE))
    wave = np.sin(flown.time_s / 20.0)
    return flown.with_columns(
        beta_deg=2.0 * wave + 0.5, elevon_deg=4.0 * wave, bodyflap_deg=8.0 * np.cos(flown.time_s / 30.0),
        log10_re=flown["log10_re"] + 0.1 * wave, jets=0.5 + 0.5 * wave, turbulent_ratio=2.5 + 0.2 * wave,
        log10_re_theta_m=2.5 + 0.1 * wave, dissociation_J_kg=1e7 + 1e6 * wave, p_surface_Pa=1000.0 + 500.0 * wave,
    )  # fmt: skip


def moved(definition, value: float) -> float:
    """Another value of a parameter, a part of its sigma away and within its bounds."""
    sigma = definition.sigma
    step = 0.2 * sigma if 0.0 < sigma < np.inf else 0.05 * max(abs(value), 0.1)
    return value + step if value + step <= definition.upper else value - step


def temperatures(models):
    return [
        np.concatenate([h.surface_K, h.bondline_K, h.sensors_K.ravel()])
        for h in march_points(models, [varied_flight()] * len(models))
    ]


def without_action_on(model, names, base) -> list[str]:
    """Those of the names whose change leaves every temperature of a point as it is."""
    changes = [{n: moved(model.definition(n), base.get(n, model.value(n)))} for n in names]
    before, *after = temperatures([model.with_parameters(base | change) for change in ({}, *changes)])
    return [name for name, T in zip(names, after, strict=True) if np.max(np.abs(T - before)) < 1e-9]


@pytest.mark.thorough
def test_every_parameter_of_the_wall_and_the_ratio_acts():
    model = point_of_record(load_record(TILE))
    names = [n for n in model.places if not n.startswith("effect.")]
    assert without_action_on(model, names, ACTIVE) == []


@pytest.mark.thorough
@pytest.mark.parametrize("name", sorted(n for n, e in effects().items() if not e.acts_on_readings))
def test_every_parameter_of_an_effect_acts(name):
    model = point_of_record(load_record(TILE), effects=[use(name)])
    names = [f"effect.{name}.{p.name}" for p in effects()[name].parameters]
    base = {n: ON.get(n, moved(model.definition(n), model.value(n))) for n in names}
    assert without_action_on(model, names, base) == []
