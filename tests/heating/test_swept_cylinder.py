"""Leading edge: the stagnation line of a swept cylinder."""

import math

import numpy as np
import pytest

from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.files import check
from sim_heating.heating.atmosphere import us76_kernel
from sim_heating.heating.reference.models import reference_heating
from sim_heating.heating.reference.stagnation import fay_riddell_kernel
from sim_heating.inputs.record import Heating


def film(sweep_deg: float, alpha_deg: float = 0.0, V: float = 6000.0, altitude_m: float = 66e3) -> float:
    T, _, rho = us76_kernel(altitude_m)
    flown = Conditions({"time_s": np.zeros(1)}).with_columns(
        rho_kg_m3=rho, velocity_m_s=V, T_inf_K=T, alpha_deg=alpha_deg
    )
    return float(reference_heating("swept-cylinder", flown, nose_radius_m=0.3048, sweep_deg=sweep_deg)[0][0])


def test_a_cylinder_across_the_flow_has_0_57_over_0_763_of_the_sphere_of_its_radius():
    T, _, rho = us76_kernel(66e3)
    sphere = fay_riddell_kernel(rho, 6000.0, T, 0.3048, 300.0, 1.0)  # the same velocity gradient, of Newtonian pressure
    assert film(0.0) == pytest.approx(0.57 / 0.763 * sphere, rel=1e-5)


def test_a_slow_cylinder_has_the_heat_transfer_of_incompressible_plane_stagnation_flow():
    # Sibulkin (1952) and Squire: Nu = 0.57 Pr^0.4 sqrt(du/dx rho / mu) x, du/dx = 2 V/R of potential flow
    T, _, rho = us76_kernel(0.0)
    mu = 1.458e-6 * T**1.5 / (T + 110.4)
    expected = 0.57 * 0.71**-0.6 * math.sqrt(rho * mu * 2.0 * 20.0 / 0.3048)
    assert film(0.0, V=20.0, altitude_m=0.0) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("sweep_deg", [20.0, 30.0, 45.0, 60.0])
def test_flux_falls_with_sweep_as_a_power_of_its_cosine_between_1_1_and_1_5(sweep_deg):
    # Cold-wall flux over the unswept one; published fits have cos^1.1 (Beckwith and Gallagher 1961) to cos^1.5
    falls = film(sweep_deg) / film(0.0)
    cosine = math.cos(math.radians(sweep_deg))
    assert cosine**1.6 < falls < cosine**1.05


def test_film_of_a_swept_cylinder_is_that_of_its_normal_flow_times_the_recovered_enthalpy():
    # Own computation for a perfect-gas-like case: normal component at Mach 2, sweep 45 deg
    T = us76_kernel(20e3)[0]
    V = 2.0 * math.sqrt(1.4 * 288.19 * T) * math.sqrt(2.0)
    normal = V / math.sqrt(2.0)
    H_0 = 1007.5 * T + 0.5 * V**2
    recovered = H_0 - (1.0 - math.sqrt(0.71)) * 0.5 * normal**2
    found = film(45.0, V=V, altitude_m=20e3) / film(0.0, V=normal, altitude_m=20e3)
    assert found == pytest.approx(recovered / H_0, rel=1e-3)


def test_angle_of_attack_turns_a_swept_edge_into_the_flow():
    assert film(45.0, 90.0) == pytest.approx(film(0.0), rel=1e-9)
    assert film(45.0, 0.0) < film(45.0, 40.0) < film(45.0, 80.0)
    assert film(0.0, 40.0) == pytest.approx(film(0.0), rel=1e-12)


def test_a_sweep_is_declared_with_the_cylinder_and_with_nothing_else():
    air = {"cp_J_kgK": 1004.5}
    common = {"nose_radius_m": 0.1, "wall_enthalpy": air}
    assert check({"reference": "swept-cylinder", "sweep_deg": 45.0, **common}, Heating, "record.toml").sweep_deg == 45.0
    for keys, problem in (
        ({"reference": "swept-cylinder", **common}, "needs `sweep_deg`"),
        ({"reference": "swept-cylinder", "sweep_deg": 45.0, "wall_enthalpy": air}, "needs `nose_radius_m`"),
        ({"reference": "fay-riddell", "sweep_deg": 45.0, **common}, "swept-cylinder"),
        ({"reference": "swept-cylinder", "sweep_deg": 90.0, **common}, "sweep_deg"),
    ):
        with pytest.raises(InputError, match=problem):
            check(keys, Heating, "record.toml")
    flown = Conditions({"time_s": np.zeros(1)}).with_columns(
        rho_kg_m3=1e-4, velocity_m_s=6e3, T_inf_K=220.0, alpha_deg=0.0
    )
    with pytest.raises(InputError, match=r"heating\.sweep_deg: 90"):
        reference_heating("swept-cylinder", flown, sweep_deg=90.0)
