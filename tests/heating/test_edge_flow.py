"""The flow at the edge that declared effects read: momentum thickness, sound, atoms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim_heating.base.conditions import Conditions
from sim_heating.heating.edge_flow import EdgeFlow, edge_flow_columns, surface_edge
from sim_heating.heating.effects.recombination import HEAT_OF_NITROGEN, HEAT_OF_OXYGEN
from sim_heating.heating.reference.flat_plate import DIVERGING_LAMINAR, eckert_film, windward_edge
from sim_heating.heating.reference.gas import (
    PRANDTL,
    air_density_of_enthalpy_kernel,
    air_state_kernel,
    pressure_cell,
    sound_in_cell,
)
from sim_heating.heating.reference.recovery import Recovery
from sim_heating.heating.reference.stagnation import stagnation_kernel
from sim_heating.inputs.vehicle import load_vehicle

ct = pytest.importorskip("cantera", reason="no wheel of Cantera for this Python")

EDGE = Recovery("edge-laminar")


def flown(V: float, rho: float, T: float, alpha: float = 40.0) -> Conditions:
    """One flight condition, held for a second."""
    given = {
        "velocity_m_s": V, "rho_kg_m3": rho, "T_inf_K": T, "alpha_deg": alpha, "beta_deg": 0.0, "log10_re": 6.3,
        "elevon_deg": 0.0, "bodyflap_deg": 0.0,
    }  # fmt: skip
    return Conditions({"time_s": np.array([0.0, 1.0])} | {name: np.full(2, value) for name, value in given.items()})


@pytest.mark.parametrize(("V", "rho", "T"), [(5800.0, 1.1e-4, 230.0), (3400.0, 6.4e-4, 265.0)])
def test_momentum_thickness_is_the_integral_of_the_wall_shear(V: float, rho: float, T: float) -> None:
    """theta = int tau / (rho_e u_e^2) dx, the shear by Reynolds' analogy of the film: tau = h u_e Pr^(2/3)."""
    length, state = 10.0, stagnation_kernel(rho, V, T)
    p_e, h_e, u_e = windward_edge(state[3], state[0], state[1], V, 40.0)
    x = length * np.linspace(0.0, 1.0, 20001)[1:] ** 4  # dense where the shear is singular
    shear = np.array([eckert_film(p_e, h_e, u_e, at, 1100.0, False) for at in x]) * u_e * PRANDTL ** (2.0 / 3.0)
    rho_e, mu_e = air_density_of_enthalpy_kernel(h_e, p_e), air_state_kernel(h_e, p_e)[1]
    theta = float(np.trapezoid(shear, x) + 2.0 * shear[0] * x[0]) / (rho_e * u_e**2)
    re_theta = rho_e * u_e * theta / mu_e / DIVERGING_LAMINAR
    mach = u_e / equilibrium_sound_speed(h_e, p_e)
    edge = surface_edge(state, V, 40.0, True)
    assert 10.0**edge.log10_re_theta_m * length**0.5 == pytest.approx(re_theta / mach, rel=0.01)


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
    s, p = gas.s, gas.P
    rho = []
    for factor in (0.9995, 1.0005):
        gas.SP = s, factor * p
        gas.equilibrate("SP")
        rho.append(gas.density)
    return math.sqrt(0.001 * p / (rho[1] - rho[0]))


@pytest.mark.parametrize(
    ("h", "p"), [(3e5, 2e3), (2.1e6, 500.0), (6.3e6, 1500.0), (1.1e7, 900.0), (2.3e7, 40.0), (2e7, 8e3)]
)
def test_speed_of_sound_is_that_of_equilibrium_to_half_a_thousandth(h: float, p: float) -> None:
    assert sound_in_cell(h, *pressure_cell(p)) == pytest.approx(equilibrium_sound_speed(h, p), rel=5e-4)


def test_speed_of_sound_rises_with_enthalpy_without_a_tooth() -> None:
    h = np.linspace(2e5, 3e7, 40001)
    for p in (30.0, 700.0, 2e4):
        assert np.all(np.diff([sound_in_cell(x, *pressure_cell(p)) for x in h]) > 0.0)


def criterion(angle_deg: float, bodyflap_deg: float = 0.0, flap: float = 0.0) -> float:
    """Re_theta / M_e [-] at 3870 m/s, 59 km, 29.8 m from the nose, at an angle of the surface against the flow."""
    recovery = Recovery("edge-laminar", bodyflap_factor=flap)
    at = flown(3870.0, 5.09e-4, 262.0, angle_deg).with_columns(bodyflap_deg=bodyflap_deg)
    return float(10.0 ** edge_flow_columns(EdgeFlow(recovery, 29.8, True), at)["log10_re_theta_m"][0])


def test_re_theta_over_edge_mach_number_is_bounded_on_steep_surfaces() -> None:
    """It rises to the steepest surface with an attached shock, and a wall square to the flow has no layer to turn."""
    rising, falling = ([criterion(a) for a in angles] for angles in ((20, 30, 40, 50, 57.5), (57.5, 65, 75, 85, 89.5)))
    assert np.all(np.diff(rising) > 0.0)
    assert np.all(np.diff(falling) < 0.0)
    assert criterion(57.5) == pytest.approx(criterion(57.51), rel=1e-3)
    assert falling[0] < 1.5 * criterion(40.0)
    assert falling[-1] < 0.2 * criterion(40.0)


def test_subsonic_flow_has_a_criterion_of_re_theta_alone() -> None:
    slow = flown(200.0, 0.9, 280.0)
    column = edge_flow_columns(EdgeFlow(EDGE, 10.0, True), slow)["log10_re_theta_m"][0]
    rho_u_x = 0.9 * 200.0 * math.cos(math.radians(40.0)) * 10.0
    assert 10.0**column == pytest.approx(0.664 * math.sqrt(rho_u_x / 1.7e-5 / 3.0), rel=0.3)


def test_a_flap_is_wetted_by_the_layer_that_has_run_ahead_of_it() -> None:
    assert criterion(40.0, 15.0, 1.0) == criterion(40.0)


def test_onset_at_the_body_flap_is_uncertain_by_a_layer_that_keeps_its_momentum_over_the_ramp() -> None:
    """rho u^2 theta the same on both sides, the edge that of the deflected surface behind the hinge; 15 deg."""
    declared = load_vehicle("orbiter").control_point("BODYFLAP").transition
    assert declared is not None
    assert declared.re_theta_over_m_e is not None
    state = stagnation_kernel(2.2e-4, 5000.0, 250.0)
    ahead, behind = (windward_edge(state[3], state[0], state[1], 5000.0, angle) for angle in (40.0, 55.0))
    (mu_a, u_a, M_a), (mu_b, u_b, M_b) = (
        (air_state_kernel(h, p)[1], u, u / equilibrium_sound_speed(h, p)) for p, h, u in (ahead, behind)
    )
    rise = mu_a / mu_b * u_a / u_b * M_a / M_b
    earliest = declared.re_theta_over_m_e / rise
    assert declared.re_theta_over_m_e_sigma == pytest.approx(declared.re_theta_over_m_e - earliest, rel=0.15)


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
