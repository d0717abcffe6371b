"""Leading edge: the stagnation line of a swept cylinder."""

import math

import numpy as np
import pytest

from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.files import check
from sim_heating.heating.atmosphere import us76_kernel
from sim_heating.heating.reference.models import reference_heating
from sim_heating.heating.reference.recovery import Recovery
from sim_heating.heating.reference.stagnation import fay_riddell_kernel
from sim_heating.inputs.record import Heating


def heated(sweep_deg: float, alpha_deg: float, V: float, altitude_m: float) -> tuple[float, float]:
    """Film coefficient [kg/(m2 s)] and recovery enthalpy [J/kg]."""
    T, _, rho = us76_kernel(altitude_m)
    flown = Conditions({"time_s": np.zeros(1)}).with_columns(
        rho_kg_m3=rho, velocity_m_s=V, T_inf_K=T, alpha_deg=alpha_deg
    )
    h_ref, H_r, _ = reference_heating("swept-cylinder", flown, nose_radius_m=0.3048, sweep_deg=sweep_deg)
    return float(h_ref[0]), float(H_r[0])


def film(sweep_deg: float, alpha_deg: float = 0.0, V: float = 6000.0, altitude_m: float = 66e3) -> float:
    return heated(sweep_deg, alpha_deg, V, altitude_m)[0]


def cold_wall_flux(sweep_deg: float) -> float:
    return math.prod(heated(sweep_deg, 0.0, 6000.0, 66e3))


def test_a_cylinder_across_the_flow_has_0_57_over_0_763_of_the_sphere_of_its_radius():
    T, _, rho = us76_kernel(66e3)
    sphere = fay_riddell_kernel(rho, 6000.0, T, 0.3048, 300.0, 1.0)  # the same velocity gradient, of Newtonian pressure
    # less what the sphere's rho mu ratio to the power 0.1 is above the boundary layer at a wall of 300 K
    assert 0.92 < film(0.0) / (0.57 / 0.763 * sphere) < 0.98


def test_a_slow_cylinder_has_the_heat_transfer_of_incompressible_plane_stagnation_flow():
    # Sibulkin (1952) and Squire: Nu = 0.57 Pr^0.4 sqrt(du/dx rho / mu) x, du/dx = 2 V/R of potential flow
    T, _, rho = us76_kernel(0.0)
    mu = 1.458e-6 * T**1.5 / (T + 110.4)
    expected = 0.57 * 0.71**-0.6 * math.sqrt(rho * mu * 2.0 * 20.0 / 0.3048)
    assert film(0.0, V=20.0, altitude_m=0.0) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("sweep_deg", [20.0, 30.0, 45.0, 60.0])
def test_flux_falls_with_sweep_as_a_power_of_its_cosine_between_1_1_and_1_5(sweep_deg):
    # Cold-wall flux over the unswept one; published fits have cos^1.1 (Beckwith and Gallagher 1961) to cos^1.5
    falls = cold_wall_flux(sweep_deg) / cold_wall_flux(0.0)
    cosine = math.cos(math.radians(sweep_deg))
    assert cosine**1.6 < falls < cosine**1.05


def test_film_of_a_swept_cylinder_is_that_of_its_normal_flow():
    # Normal component at Mach 2, sweep 45 deg; the spanwise flow recovers 0.855 of its energy, for which H_r has Pr^1/2
    T = us76_kernel(20e3)[0]
    V = 2.0 * math.sqrt(1.4 * 288.19 * T) * math.sqrt(2.0)
    spanwise = 0.25 * V**2
    H_r = 1007.5 * T + spanwise + math.sqrt(0.71) * spanwise
    more = 1.0 + (0.855 - math.sqrt(0.71)) * spanwise / max(H_r - 302.5e3, 0.5 * H_r)
    found = film(45.0, V=V, altitude_m=20e3) / film(0.0, V=V / math.sqrt(2.0), altitude_m=20e3)
    assert found == pytest.approx(more, rel=1e-3)


def recovered_J_kg(sweep_deg: float, alpha_deg: float = 0.0, **more) -> float:
    flown = Conditions({"time_s": np.zeros(1)}).with_columns(
        rho_kg_m3=0.1, velocity_m_s=1000.0, T_inf_K=220.0, alpha_deg=alpha_deg
    )
    return float(reference_heating("swept-cylinder", flown, nose_radius_m=0.1, sweep_deg=sweep_deg, **more)[1][0])


@pytest.mark.parametrize(("sweep_deg", "wall_K"), [(0.0, 717.8), (45.0, 678.6), (60.0, 658.9)])
def test_an_insulated_leading_edge_has_its_own_recovery_temperature(sweep_deg, wall_K):
    # h_inf + V^2/2 (cos^2 + sqrt(Pr) sin^2) at cp = 1004.5; along the edge friction recovers sqrt(Pr)
    assert recovered_J_kg(sweep_deg) / 1004.5 == pytest.approx(wall_K, abs=0.15)


def test_angle_of_attack_and_a_stated_recovery_change_the_enthalpy_of_the_edge():
    assert recovered_J_kg(60.0, 90.0) == pytest.approx(recovered_J_kg(0.0), rel=1e-12)
    assert recovered_J_kg(60.0, recovery=Recovery()) == recovered_J_kg(0.0)
    assert recovered_J_kg(60.0, recovery=Recovery("attachment-line", sweep_deg=60.0)) == recovered_J_kg(60.0)


def test_a_record_of_columns_may_state_an_attachment_line_with_its_sweep():
    common = {"wall_enthalpy": {"cp_J_kgK": 1004.5}, "reference": "columns", "recovery": "attachment-line"}
    heating = check({**common, "sweep_deg": 45.0}, Heating, "record.toml")
    assert heating.recovery_of_point == Recovery("attachment-line", sweep_deg=45.0)
    for keys, problem in (
        (common, "needs `sweep_deg`"),
        ({**common, "sweep_deg": 45.0, "local_angle_deg": 3.0}, "local_angle_deg"),
    ):
        with pytest.raises(InputError, match=problem):
            check(keys, Heating, "record.toml")


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
