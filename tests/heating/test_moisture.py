"""Vapour in depth: its conductivity, its conservation of heat, and where it condenses."""

from __future__ import annotations

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from tests.support.walls import flight, heat, heat_content, material, wall

VAPOUR_W_M, BOIL_K, WIDTH_K = 30.0, 360.0, 15.0
MOIST = {"stack.moisture.vapour_W_m": VAPOUR_W_M, "stack.moisture.boil_K": BOIL_K, "stack.moisture.width_K": WIDTH_K}


def dried(temperature_K: float) -> float:
    """Fraction of the moisture that has dried [-]."""
    return 1.0 / (1.0 + np.exp(-(temperature_K - BOIL_K) / WIDTH_K))


def test_steady_moist_layer_conducts_through_its_solid_and_its_vapour():
    # q L = k (T_s - T_b) + vapour (u(T_s) - u(T_b)), at any number of elements
    length, flux_W_m2 = 0.02, 3e3
    moist = wall((material(), length), back={"h_W_m2K": 1e4, "T_K": 340.0})
    _, out = heat(
        moist, flight(np.linspace(0.0, 1e5, 1001), q_add_W_m2=flux_W_m2), (length,), nodes=14, parameters=MOIST
    )
    surface, back = out[-1, 0], out[-1, 2]
    carried = 1.0 * (surface - back) + VAPOUR_W_M * (dried(surface) - dried(back))
    assert carried == pytest.approx(flux_W_m2 * length, rel=1e-7)


def test_vapour_transports_heat_and_conserves_it():
    profile = [[0.0, 420.0], [0.01, 380.0], [0.02, 300.0]]
    insulated = wall((material(), 0.02), initial="profile", initial_profile=profile, initial_K=None)
    ensemble, _ = heat(insulated, flight(np.arange(0.0, 61.0)), nodes=40, parameters=MOIST)
    before, _ = heat(insulated, flight(np.array([0.0, 1e-9])), nodes=40)
    assert heat_content(ensemble) == pytest.approx(heat_content(before), rel=1e-9)


def test_vapour_condenses_ahead_of_the_conducted_heat():
    insulation = wall((material(0.05, 1000.0, 250.0), 0.03))
    lit = flight(np.arange(0.0, 121.0), q_add_W_m2=5e3)
    (_, dry), (_, moist) = (heat(insulation, lit, (0.01,), parameters=p) for p in ({}, MOIST))
    early = np.arange(20, 60)
    assert np.all(moist[early, 2] > dry[early, 2] + 1.0)
    assert moist[-1, 0] < dry[-1, 0]  # the heat that vapour carries inward is taken from the surface


def test_moisture_without_a_unique_temperature_is_rejected():
    # at 340 K deposit / (4 width) = 1250 J/(kg K) is given off where 1000 J/(kg K) warm it
    wet = {"stack.moisture.condense_K": 340.0, "stack.moisture.width_K": 10.0}
    insulation = wall((material(0.05, 1000.0, 250.0), 0.03))
    heat(insulation, flight(np.arange(3.0)), (0.01,), parameters=wet | {"stack.moisture.deposit_J_kg": 3.9e4})
    with pytest.raises(InputError, match="gives off more heat as it condenses"):
        heat(insulation, flight(np.arange(3.0)), (0.01,), parameters=wet | {"stack.moisture.deposit_J_kg": 5e4})
