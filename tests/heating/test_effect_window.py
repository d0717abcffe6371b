"""An effect within a window of a flight condition: all of it inside, none outside, a ramp at the ends."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.heating import flight_variables
from sim_heating.heating.effects import Window, use
from sim_heating.heating.effects.compiled import CONDITIONS, values_along

FAST = Window("fast", "mach", 18.0, 30.0, ramp=0.5)


def at_mach(*mach: float) -> np.ndarray:
    """Conditions at Mach numbers, with jets that fire, elevon at 6 deg."""
    rows = np.zeros((len(mach), CONDITIONS))
    rows[:, flight_variables.mach] = mach
    rows[:, flight_variables.jets] = 1.0
    rows[:, flight_variables.elevon_deg] = 6.0
    return rows


def test_a_factor_acts_within_its_window_alone() -> None:
    used = use("jet-interaction", {"jet_gain": 0.3}, FAST)
    found = values_along(used, at_mach(17.0, 18.0, 18.25, 18.5, 25.0, 29.75, 30.0, 31.0), np.zeros(8))
    assert found == pytest.approx([1.0, 1.0, 1.15, 1.3, 1.3, 1.15, 1.0, 1.0])


def test_what_adds_to_the_ratio_adds_nothing_outside() -> None:
    knots = {f"s_{k + 1}": 6e-4 * x**2 for k, x in enumerate(np.linspace(-7.0, 11.0, 7))}
    used = use("added-curve", {"variable": 2.0, "low": -7.0, "high": 11.0, **knots}, FAST)
    found = values_along(used, at_mach(25.0, 16.0), np.zeros(2))
    assert found == pytest.approx([6e-4 * 6.0**2, 0.0])  # the curve holds a parabola exactly


def test_one_effect_in_two_windows_is_two_effects() -> None:
    slow = Window("slow", "mach", 0.0, 18.0)
    assert use("jet-interaction", {}, FAST).effect.name == "jet-interaction-fast"
    assert use("jet-interaction", {}, FAST).effect != use("jet-interaction", {}, slow).effect


def test_another_process_gets_the_same_window() -> None:
    used = use("jet-interaction", {"jet_gain": 0.3}, FAST)
    assert pickle.loads(pickle.dumps(used)) == used


@pytest.mark.parametrize("name", ["transition", "nonisothermal-wall", "coating-thickness"])
def test_effects_with_a_memory_or_without_a_kernel_take_no_window(name: str) -> None:
    with pytest.raises(InputError, match=f"effect {name}: takes no window"):
        use(name, {}, FAST)


def test_a_window_of_nothing_is_refused() -> None:
    with pytest.raises(InputError, match="low is below high"):
        Window("none", "mach", 5.0, 5.0)
    with pytest.raises(InputError, match="do not read a flight condition `velocity_m_s`"):
        Window("fast", "velocity_m_s", 5000.0, 7000.0)
    with pytest.raises(InputError, match="half the range"):
        Window("fast", "mach", 5.0, 7.0, ramp=1.5)
