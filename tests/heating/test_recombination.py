"""Finite-rate recombination at the wall: its bounds, a published coefficient, and the diffusion that feeds it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim_heating.heating.effects import EffectUse, use
from sim_heating.heating.effects.recombination import HEAT_OF_OXYGEN
from sim_heating.heating.reference.gas import air_kernel
from sim_heating.march.mesh_choice import pack
from sim_heating.march.point import PointModel
from tests.support.walls import flight, heat, material, wall

H_R, H_REF, PRESSURE = 2.4e7, 0.02, 1500.0
R_U = 8314.462618


def factor(used: EffectUse, wall_K: float, dissociation_J_kg: float, ratio: float = 0.2, H_r: float = H_R) -> float:
    """Factor of an effect on the film of a wall at a temperature [-]."""
    stack = wall((material(), 0.01), initial_K=wall_K)
    conditions = {"h_ref_kg_m2_s": H_REF, "H_r_J_kg": H_r, "p_surface_Pa": PRESSURE}
    ensemble = pack([PointModel("p", stack, nodes=14, parameters={"ratio.d0": ratio}, effects=(used,))])
    ensemble.begin(flight([0.0], dissociation_J_kg=dissociation_J_kg, **conditions)[:, 0])
    return float(ensemble.film_kg_m2_s[0]) / (ratio * H_REF)


@pytest.mark.parametrize("dissociation", [1e6, HEAT_OF_OXYGEN, 1.2e7])
def test_a_wall_without_recombination_loses_the_heat_of_dissociation(dissociation: float) -> None:
    """Frozen boundary layer at a noncatalytic wall, Le = 1: the flux film (H_r - h_w) loses film h_D."""
    h_w = air_kernel(1200.0, 1e5)[0]
    expected = 1.0 - dissociation / (H_R - h_w)
    assert factor(use("recombination", {"efficiency": 0.0}), 1200.0, dissociation) == pytest.approx(expected, rel=2e-4)


def test_a_cold_noncatalytic_wall_has_fay_and_riddells_limit() -> None:
    cold = factor(use("recombination", {"efficiency": 0.0}), 120.0, 8e6)
    assert cold == pytest.approx(1.0 - 8e6 / H_R, rel=4e-3)


def test_a_hot_noncatalytic_stagnation_point_is_heated_a_tenth_less_than_with_the_limit_of_a_cold_wall() -> None:
    h_D, hot = 1.4e7, 2000.0
    limit = 1.0 - h_D / H_R
    assert 0.09 < 1.0 - factor(use("recombination", {"efficiency": 0.0}), hot, h_D) / limit < 0.16


def test_a_wall_as_hot_as_the_flow_does_not_divide_by_its_driving_enthalpy() -> None:
    assert np.isfinite(factor(use("recombination", {"efficiency": 0.0}), 2900.0, 1e6, H_r=3.2e6))


def test_a_wall_at_which_every_atom_recombines_is_all_but_fully_catalytic() -> None:
    every = {"gamma_O_factor": 1e6, "gamma_O_activation_K": 0.0, "gamma_N_factor": 1e6, "gamma_N_activation_K": 0.0}
    found = factor(use("recombination", every), 1200.0, 1.2e7)
    # diffusion through the boundary layer is slower than the kinetic rate, but not infinitely so
    assert 0.99 < found < 1.0


def test_a_flow_without_atoms_heats_any_wall_alike() -> None:
    assert factor(use("recombination", {"efficiency": 0.0}), 1200.0, 0.0) == 1.0


@pytest.mark.parametrize(("wall_K", "gamma"), [(1400.0, 0.0104), (1500.0, 0.0170), (1650.0, 0.0317)])
def test_oxygen_recombines_by_scotts_law_against_its_diffusion(wall_K: float, gamma: float) -> None:
    """gamma_O = 16 exp(-10271 / T) of Scott (1980) in numbers; balance of atoms at the wall in Goulard's form."""
    rho_w = PRESSURE / (1.21 * R_U / 28.85064 * wall_K)
    rate = rho_w * gamma * math.sqrt(R_U * wall_K / (2.0 * math.pi * 15.999))
    diffusion = 1.4 ** (2.0 / 3.0) * 0.2 * H_REF
    # the atoms that arrive by diffusion are those that react: h_m (c_e - c_w) = rho_w k_w c_w
    c_w = np.linalg.solve([[diffusion + rate]], [diffusion])[0]
    recombined = 1.0 - c_w
    expected = 1.0 - (1.0 - recombined) * HEAT_OF_OXYGEN / (H_R - air_kernel(wall_K, 1e5)[0])
    assert factor(use("recombination"), wall_K, HEAT_OF_OXYGEN) == pytest.approx(expected, abs=3e-4)


def test_published_laws_of_the_coating_agree_within_a_factor_of_1_4() -> None:
    """Scott (1980) and Kolodziej and Stewart (1987), where both were measured."""
    scott, kolodziej = (lambda T: 16.0 * np.exp(-10271.0 / T)), (lambda T: 40.0 * np.exp(-11440.0 / T))
    T = np.linspace(1435.0, 1580.0, 30)
    assert np.all(np.abs(np.log(scott(T) / kolodziej(T))) < math.log(1.4))


def test_coefficients_stay_above_the_highest_temperature_of_their_law() -> None:
    held = use("recombination", {"highest_K": 1300.0})
    law = use("recombination", {"highest_K": 5000.0})
    assert factor(held, 1200.0, 1e6) == factor(law, 1200.0, 1e6)
    assert factor(held, 1600.0, 1e6) < factor(law, 1600.0, 1e6)


def test_more_film_leaves_a_smaller_part_recombined() -> None:
    thin, thick = (factor(use("recombination"), 1400.0, HEAT_OF_OXYGEN, ratio) for ratio in (0.05, 0.5))
    assert thin > thick


def test_turbulent_film_is_the_one_that_atoms_diffuse_through() -> None:
    """With transition before it the effect finds the turbulent film, in whatever order both are declared."""
    turned = use("transition", {"log10_re_onset": 3.0, "factor": 4.0})
    conditions = {
        "h_ref_kg_m2_s": H_REF, "H_r_J_kg": H_R, "p_surface_Pa": PRESSURE, "dissociation_J_kg": HEAT_OF_OXYGEN,
        "log10_re": 9.0, "alpha_deg": 40.0,
    }  # fmt: skip
    for effects in ((turned, use("recombination")), (use("recombination"), turned)):
        stack = wall((material(), 0.01), initial_K=1400.0)
        ensemble = pack([PointModel("p", stack, nodes=14, parameters={"ratio.d0": 0.1}, effects=effects)])
        ensemble.begin(flight([0.0], **conditions)[:, 0])
        expected = 0.4 * H_REF * factor(use("recombination"), 1400.0, HEAT_OF_OXYGEN, 0.4)
        assert ensemble.film_kg_m2_s[0] == pytest.approx(expected, rel=1e-9)


def test_the_step_of_catalysis_is_the_same_equation_about_the_temperature_of_half_recombination() -> None:
    """Width T_c^2 / (T_A - T_c / 2) and step h_D / (H_r - h_w - h_D), docs/reference/effects.md, behind equation 28."""
    finite, none = use("recombination"), use("recombination", {"efficiency": 0.0})
    T = np.linspace(1100.0, 1650.0, 23)
    rise = np.array([factor(finite, t, HEAT_OF_OXYGEN, 0.6) / factor(none, t, HEAT_OF_OXYGEN, 0.6) for t in T]) - 1.0
    step = HEAT_OF_OXYGEN / (H_R - air_kernel(1400.0, 1e5)[0] - HEAT_OF_OXYGEN)
    half = float(np.interp(0.5 * step, rise, T))
    own = use(
        "catalysis",
        {"catalysis_step": step, "catalysis_K": half, "catalysis_width_K": half**2 / (10271.0 - 0.5 * half)},
    )
    near = T[np.abs(T - half) < 150.0]
    assert len(near) > 5
    for t in near:
        assert factor(own, t, HEAT_OF_OXYGEN) - 1.0 == pytest.approx(float(np.interp(t, T, rise)), abs=0.02 * step)


def test_a_hotter_wall_takes_more_heat_and_the_march_converges_on_it() -> None:
    """A wall that heats up through its own recombination ends where the finite-rate flux is radiated."""
    time = np.linspace(0.0, 3000.0, 301)
    conditions = {
        "h_ref_kg_m2_s": 0.03,
        "H_r_J_kg": H_R,
        "p_surface_Pa": PRESSURE,
        "dissociation_J_kg": HEAT_OF_OXYGEN,
    }
    ends = {}
    for name, effects in {
        "none": (use("recombination", {"efficiency": 0.0}),),
        "finite": (use("recombination"),),
        "full": (),
    }.items():
        thin = wall((material(emissivity=0.85), 0.001))
        _, T = heat(
            thin, flight(time, **conditions), nodes=14, step_s=10.0, parameters={"ratio.d0": 0.3}, effects=effects
        )
        ends[name] = T[-1, 0]
    assert ends["none"] < ends["finite"] < ends["full"]
    radiated = 0.85 * 5.670374419e-8 * ends["finite"] ** 4
    share = factor(use("recombination"), ends["finite"], HEAT_OF_OXYGEN, 0.3 * 0.03 / H_REF)
    assert 0.009 * share * (H_R - 1004.5 * ends["finite"]) == pytest.approx(radiated, rel=1e-5)
