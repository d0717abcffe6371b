"""The flow at the edge that declared effects read: momentum thickness, sound, atoms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim_heating.base.conditions import Conditions
from sim_heating.heating.edge_flow import EdgeFlow, edge_flow_columns, re_theta_over_mach, surface_edge
from sim_heating.heating.effects.recombination import HEAT_OF_NITROGEN, HEAT_OF_OXYGEN
from sim_heating.heating.reference.flat_plate import DIVERGING_LAMINAR, eckert_film
from sim_heating.heating.reference.gas import PRANDTL, air_density_of_enthalpy_kernel, air_state_kernel
from sim_heating.heating.reference.recovery import Recovery

ct = pytest.importorskip("cantera", reason="no wheel of Cantera for this Python")

EDGE = Recovery("edge-laminar")


def flown(V: float, rho: float, T: float, alpha: float = 40.0) -> Conditions:
    """One flight condition, held for a second."""
    given = {
        "velocity_m_s": V, "rho_kg_m3": rho, "T_inf_K": T, "alpha_deg": alpha, "beta_deg": 0.0, "log10_re": 6.3,
        "elevon_deg": 0.0, "bodyflap_deg": 0.0,
    }  # fmt: skip
    return Conditions({"time_s": np.array([0.0, 1.0])} | {name: np.full(2, value) for name, value in given.items()})


@pytest.mark.parametrize(("p_e", "h_e", "u_e"), [(900.0, 9.0e6, 4500.0), (1500.0, 4.0e6, 2600.0)])
def test_momentum_thickness_is_the_integral_of_the_wall_shear(p_e: float, h_e: float, u_e: float) -> None:
    """theta = int tau / (rho_e u_e^2) dx, the shear by Reynolds' analogy of the film: tau = h u_e Pr^(2/3)."""
    length = 10.0
    x = length * np.linspace(0.0, 1.0, 20001)[1:] ** 4  # dense where the shear is singular
    shear = np.array([eckert_film(p_e, h_e, u_e, at, 1100.0, False) for at in x]) * u_e * PRANDTL ** (2.0 / 3.0)
    rho_e, mu_e = air_density_of_enthalpy_kernel(h_e, p_e), air_state_kernel(h_e, p_e)[1]
    theta = float(np.trapezoid(shear, x) + 2.0 * shear[0] * x[0]) / (rho_e * u_e**2)
    re_theta = rho_e * u_e * theta / mu_e / DIVERGING_LAMINAR
    mach = u_e / equilibrium_sound_speed(h_e, p_e)
    edge = surface_edge(p_e, h_e, u_e, 0.0, True)
    assert re_theta_over_mach(edge, length) == pytest.approx(re_theta / mach, rel=0.01)


def equilibrium_air(h_J_kg: float, p_Pa: float) -> ct.Solution:
    """Equilibrium air of 79/21 N2/O2 at an enthalpy above 0 K, by Cantera."""
    species = [s for s in ct.Species.list_from_file("airNASA9.yaml") if s.name in ("N2", "O2", "N", "O", "NO")]
    gas = ct.Solution(thermo="ideal-gas", species=species)
    gas.TPX = 300.0, p_Pa, "N2:0.79, O2:0.21"
    # 298.15 K is the zero of Cantera's enthalpy; 300.6 kJ/kg is that of this program there
    gas.HP = h_J_kg - 300.6e3, p_Pa
    gas.equilibrate("HP")
    return gas


def equilibrium_sound_speed(h_J_kg: float, p_Pa: float) -> float:
    """Speed of sound of equilibrium air [m/s]: sqrt(dp / drho) along an isentrope, by Cantera."""
    gas = equilibrium_air(h_J_kg, p_Pa)
    s, p, rho = gas.s, gas.P, gas.density
    gas.SP = s, 1.001 * p
    gas.equilibrate("SP")
    return math.sqrt(0.001 * p / (gas.density - rho))


@pytest.mark.parametrize(("V", "rho", "T"), [(7000.0, 4e-5, 210.0), (5000.0, 2e-4, 240.0)])
def test_atoms_at_the_stagnation_point_are_those_of_equilibrium(V: float, rho: float, T: float) -> None:
    column = edge_flow_columns(EdgeFlow(EDGE, atoms="stagnation"), flown(V, rho, T))["dissociation_J_kg"][0]
    gas = equilibrium_air(0.5 * V**2 + 1004.5 * T, 0.95 * rho * V**2)
    formation = {"O": 246.79e6, "N": 470.818e6, "NO": 89.775e6}
    moles = gas.X / gas.mean_molecular_weight
    expected = sum(moles[gas.species_index(n)] * h for n, h in formation.items())
    assert column == pytest.approx(expected, rel=0.02)


def test_oxygen_dissociates_before_nitrogen_so_that_its_heat_can_be_told_from_the_sum() -> None:
    """At the enthalpies of an entry the part of h_D beyond all oxygen is nitrogen's, within 6 % of h_D."""
    for h, p in ((8e6, 500.0), (1.2e7, 1500.0), (2.0e7, 2000.0)):
        gas = equilibrium_air(h, p)
        moles = gas.X / gas.mean_molecular_weight
        o, n, no = (moles[gas.species_index(n)] for n in ("O", "N", "NO"))
        h_D = o * 246.79e6 + n * 470.818e6 + no * 89.775e6
        assert min(h_D, HEAT_OF_OXYGEN) == pytest.approx(o * 246.79e6, abs=0.06 * h_D)
    assert pytest.approx(2.0 * 0.79 * 470.818e6 / 28.85064) == HEAT_OF_NITROGEN


def test_a_point_asks_only_for_what_its_effects_read() -> None:
    assert edge_flow_columns(EdgeFlow(EDGE), flown(6000.0, 1e-4, 220.0)) == {}
    assert list(edge_flow_columns(EdgeFlow(EDGE, 10.0, True), flown(6000.0, 1e-4, 220.0))) == ["log10_re_theta_m"]


def test_a_point_without_an_edge_has_the_atoms_of_the_stagnation_point() -> None:
    condition = flown(6000.0, 1e-4, 220.0)
    total, stagnation = (
        edge_flow_columns(EdgeFlow(recovery, atoms=atoms), condition)["dissociation_J_kg"][0]  # type: ignore[arg-type]
        for recovery, atoms in ((Recovery(), "edge"), (EDGE, "stagnation"))
    )
    assert total == stagnation


def test_atoms_of_oxygen_are_no_more_than_all_of_it() -> None:
    fast = flown(7500.0, 2e-5, 200.0)
    edge, oxygen = (
        edge_flow_columns(EdgeFlow(EDGE, atoms=atoms), fast)["dissociation_J_kg"][0]  # type: ignore[arg-type]
        for atoms in ("edge", "edge-oxygen")
    )
    assert edge > HEAT_OF_OXYGEN
    assert oxygen == HEAT_OF_OXYGEN
