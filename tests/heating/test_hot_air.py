"""Hot air: the shipped table against Cantera, and its viscosity against the data it is made from and others."""

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.heating.atmosphere import sutherland_viscosity
from sim_heating.heating.reference.gas import (
    JOIN_K,
    _uniform_cell,
    air_density_kernel,
    air_kernel,
    air_state_kernel,
    air_temperature_kernel,
    air_transport_kernel,
    transport,
)
from tests.support.gas.cantera_air import AIR, Air
from tests.support.gas.transport import (
    SPECIES,
    blottner_viscosity,
    cea_viscosity,
    coulomb_logarithm,
    cross_section_viscosity,
    wilke,
)

cantera = pytest.importorskip("cantera", reason="no wheel of Cantera for this Python")


@pytest.fixture(scope="module")
def air() -> Air:
    return Air()


@pytest.fixture(scope="module")
def combustion_air() -> cantera.Solution:
    """Cantera's gri30.yaml: other polynomials than the table's, to 3500 K, and transport of molecules."""
    return cantera.Solution("gri30.yaml")


STATES = [
    (1230.0, 3e3),
    (2770.0, 40.0),
    (3380.0, 7e4),
    (4630.0, 1.7e3),
    (5780.0, 600.0),
    (6920.0, 2.2e4),
    (8810.0, 5e5),
]


@pytest.mark.parametrize(("T_K", "p_Pa"), STATES)
def test_between_its_points_the_table_is_cantera_at_that_state(air, T_K, p_Pa):
    h, Z, dissociation = air.thermodynamics(T_K, p_Pa)
    got = air_kernel(T_K, p_Pa)
    assert got[:2] == pytest.approx((h, Z), rel=4e-3)
    assert got[2] == pytest.approx(dissociation, abs=4e-3 * h)
    assert air_density_kernel(T_K, p_Pa) == pytest.approx(p_Pa * 28.85064 / (Z * 8314.462618 * T_K), rel=2e-3)
    t, kept = air.transport(T_K, p_Pa), transport([T_K], [p_Pa])
    assert kept.viscosity_Pa_s[0, 0] == pytest.approx(t.viscosity_Pa_s, rel=2e-3)
    assert kept.prandtl[0, 0] == pytest.approx(t.prandtl, rel=5e-3)


@pytest.mark.parametrize(("T_K", "p_Pa"), [(1000.0, 1e3), (2600.0, 100.0), (3300.0, 1e3), (3400.0, 1e5)])
def test_composition_and_enthalpy_agree_with_other_polynomials(combustion_air, T_K, p_Pa):
    gas = combustion_air
    gas.TPX = 298.15, p_Pa, AIR
    cold = gas.enthalpy_mass
    gas.TP = T_K, p_Pa
    gas.equilibrate("TP")
    h, Z, _ = air_kernel(T_K, p_Pa)
    assert 28.85064 / gas.mean_molecular_weight == pytest.approx(Z, rel=1e-3)
    assert h == pytest.approx(gas.enthalpy_mass - cold + 300.6e3, rel=4e-3)


@pytest.mark.parametrize("T_K", [200.0, 300.0, 633.0, 700.0])
def test_viscosity_of_cold_air_is_sutherlands_at_every_pressure(T_K):
    for p_Pa in (1.0, 1e3, 1e6):
        assert air_transport_kernel(T_K, p_Pa)[1] == pytest.approx(float(sutherland_viscosity(T_K)), rel=1e-15)


def test_the_two_viscosities_join_within_half_a_percent_and_without_a_jump():
    below, above = (air_transport_kernel(JOIN_K + d, 1e3)[1] for d in (-1e-6, 1e-6))
    assert above == pytest.approx(below, rel=1e-8)
    x = np.array([0.79, 0.21, 0.0, 0.0, 0.0])
    mixed = [wilke(x, mu, mu) for mu in (cea_viscosity(JOIN_K), blottner_viscosity(JOIN_K))]
    assert np.mean(mixed) == pytest.approx(below, rel=5e-3)


@pytest.mark.parametrize(("T_K", "mu"), [(1000.0, 424.4e-7), (1500.0, 557e-7), (2000.0, 689e-7), (2500.0, 818e-7)])
def test_viscosity_of_air_at_1_atm_is_within_5_percent_of_a_textbook_s(T_K, mu):
    # Incropera et al., Fundamentals of Heat and Mass Transfer, table A.4, from data of the 1960s
    assert transport([T_K], [101325.0]).viscosity_Pa_s[0, 0] == pytest.approx(mu, rel=0.05)


@pytest.mark.parametrize("T_K", [1000.0, 2000.0, 3000.0])
def test_viscosity_agrees_with_cantera_s_mixture_of_molecules(combustion_air, T_K):
    combustion_air.TPX = T_K, 1e3, AIR
    combustion_air.equilibrate("TP")
    assert transport([T_K], [1e3]).viscosity_Pa_s[0, 0] == pytest.approx(combustion_air.viscosity, rel=0.02)


@pytest.mark.parametrize(
    ("T_K", "p_Pa", "low", "high"),
    [
        (4000.0, 1e3, 0.05, 0.09),
        (4000.0, 1e5, 0.04, 0.08),
        (5750.0, 1e3, 0.18, 0.19),
        (5750.0, 1e5, 0.10, 0.13),
        (8000.0, 1e4, 0.22, 0.25),
    ],
)
def test_the_power_law_of_molecules_is_low_in_dissociated_air_by_either_set_of_data(air, T_K, p_Pa, low, high):
    fractions = air.fractions(T_K, p_Pa)
    x = np.array([fractions[s] for s in SPECIES])
    for mu in (cea_viscosity(T_K), blottner_viscosity(T_K)):
        assert low < 1.0 - 4.12e-7 * T_K**0.671 / wilke(x / x.sum(), mu, mu) < high
    assert air_transport_kernel(T_K, p_Pa)[1] > 1.25 * sutherland_viscosity(T_K)


@pytest.mark.parametrize(("T_K", "p_Pa"), [(1500.0, 1e3), (3000.0, 1e3), (4500.0, 1e4), (6000.0, 1e3), (8000.0, 1e5)])
def test_collision_cross_sections_give_the_viscosity_within_6_percent(air, T_K, p_Pa):
    # A third set, NASA RP-1232, mixed by its own rule: lowest where air is molecules and oxygen atoms
    x = air.fractions(T_K, p_Pa)
    third = cross_section_viscosity({s: x[s] for s in SPECIES}, T_K)
    assert -0.06 < third / air_transport_kernel(T_K, p_Pa)[1] - 1.0 < 0.02


def test_charges_lower_the_viscosity_and_widen_its_sigma():
    t = transport([6000.0, 8000.0, 10000.0], [1e3])
    assert t.viscosity_Pa_s[2, 0] < t.viscosity_Pa_s[1, 0]
    assert t.viscosity_sigma[0, 0] < 0.03 < 0.15 < t.viscosity_sigma[2, 0]
    # RP-1232 gives its cross sections at 0.0975 (T/1000 K)^4 atm of electrons, where ln Lambda is 1
    assert coulomb_logarithm(9000.0, 0.0975 * 9.0**4 * 101325.0) == pytest.approx(1.0, abs=1e-3)


def test_the_frozen_prandtl_number_scatters_about_0_71_to_6000_K():
    t = transport(np.arange(300.0, 6001.0, 100.0), [100.0, 1e3, 1e4])
    assert 0.70 < t.prandtl.min() < t.prandtl.max() < 0.78
    assert np.all(np.abs(t.prandtl / 0.71 - 1.0) < 2.0 * t.prandtl_sigma)


def test_density_and_viscosity_of_an_enthalpy_are_those_of_its_temperature():
    for T, p in [(150.0, 10.0), (650.0, 1e3), (2500.0, 30.0), (6100.0, 2e3)]:
        assert air_state_kernel(air_kernel(T, p)[0], p) == pytest.approx(air_transport_kernel(T, p), rel=1e-9)


def test_transport_at_an_impossible_temperature_or_pressure_is_rejected():
    for T, p in (([0.0], [1e3]), ([300.0], [-1.0])):
        with pytest.raises(InputError, match=r"_K|_Pa"):
            transport(T, p)


@pytest.mark.parametrize(("T_K", "p_Pa"), [(np.nan, 1e3), (4000.0, np.nan), (np.nan, np.nan)])
def test_properties_at_a_state_that_is_no_number_are_none_and_no_index_leaves_the_table(T_K, p_Pa):
    assert np.all(np.isnan(air_kernel(T_K, p_Pa)))
    assert np.isnan(air_temperature_kernel(1e3 * T_K, p_Pa))
    assert np.all(np.isnan(air_state_kernel(1e3 * T_K, p_Pa)))
    assert np.all(np.isnan(air_transport_kernel(T_K, p_Pa)))


def test_the_cell_of_a_value_that_is_no_number_is_the_first_compiled_or_not():
    for cell in (_uniform_cell, _uniform_cell.py_func):
        assert cell(np.nan, 0.0, 0.25, 25)[0] == 0
        assert cell(3.1, 0.0, 0.25, 25) == (12, pytest.approx(0.4))
        assert cell(-np.inf, 0.0, 0.25, 25) == (0, 0.0)
        assert cell(np.inf, 0.0, 0.25, 25) == (23, 1.0)
