"""Heating-ratio tables that a source makes by theory: Eckert's flat plate over Fay and Riddell's sphere."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.heating.atmosphere import us76_kernel
from sim_heating.heating.reference.flat_plate import windward_edge_kernel
from sim_heating.heating.reference.gas import PRANDTL, air_temperature_kernel
from sim_heating.heating.reference.stagnation import stagnation_kernel
from sim_heating.inputs.ratio_sources import build_tables
from tests.support.paths import ORBITER
from tests.support.verification.boundary_layer import plate, stagnation_film

SOURCE = """\
format = "ratio-source/1"
control_points = ["LOWER_MID"]
source = "theory"
recovery = "edge-laminar"
confidence = "C"
revision = "1"
relative_sigma = 0.25
[axes]
alpha_deg = [0.0, 25.0, 40.0]
beta_deg = [0.0]
log10_re = [2.0, 6.076, 6.3, 6.549, 8.4]
elevon_deg = [0.0]
bodyflap_deg = [0.0]
[base]
theory = "eckert-laminar"
length = "x_over_L"
wall_K = 1100.0
flight = [{ altitude_m = 57e3, velocity_m_s = 3900.0 }, { altitude_m = 70e3, velocity_m_s = 6300.0 }]
"""


@pytest.fixture
def orbiter(tmp_path) -> Path:
    copy = Path(shutil.copytree(ORBITER, tmp_path / "orbiter", ignore=shutil.ignore_patterns("flight_data", "jsbsim")))
    shutil.rmtree(copy / "ratio_sources")
    (copy / "ratio_sources").mkdir()
    (copy / "ratio_sources" / "theory.toml").write_text(SOURCE)
    return copy


def test_a_table_by_theory_is_the_ratio_of_two_boundary_layers(orbiter):
    table = build_tables(orbiter)["LOWER_MID"]
    for k, altitude_m, V in ((1, 70e3, 6300.0), (3, 57e3, 3900.0)):
        T_inf, _, rho = us76_kernel(altitude_m)
        p_e, h_e, u_e = windward_edge_kernel(rho, V, T_inf, 40.0)
        p_0, h_0, rho_0, p = stagnation_kernel(rho, V, T_inf)
        gradient = np.sqrt(2.0 * (p_0 - p) / rho_0) / 0.3048
        x = 0.5 * 32.77  # of LOWER_MID
        own = np.sqrt(3.0) * plate(p_e, air_temperature_kernel(h_e, p_e), u_e, x, 1100.0, PRANDTL).film
        own /= stagnation_film(p_0, air_temperature_kernel(h_0, p_0), 300.0, gradient, PRANDTL)
        # Eckert is 1 % below its boundary layer, Fay-Riddell 5 % above at 300 K
        assert table.ratio[2, 0, k, 0, 0] / own == pytest.approx(0.945, abs=0.015)


def test_between_its_flight_states_it_is_linear_and_beyond_them_constant(orbiter):
    table = build_tables(orbiter)["LOWER_MID"]
    at_40 = table.ratio[2, 0, :, 0, 0]
    assert at_40[0] == pytest.approx(at_40[1], rel=1e-3)
    assert at_40[4] == pytest.approx(at_40[3], rel=1e-3)
    w = (6.3 - 6.076) / (6.549 - 6.076)
    assert at_40[2] == pytest.approx((1.0 - w) * at_40[1] + w * at_40[3], rel=1e-3)
    assert np.all(np.diff(table.ratio[:, 0, 1, 0, 0]) > 0.0)


def test_the_surface_is_steeper_by_the_local_angle_of_the_point(orbiter):
    flat = build_tables(orbiter)["LOWER_MID"]
    point = orbiter / "control_points" / "LOWER_MID.toml"
    point.write_text(point.read_text().replace("local_angle_deg = 0.0", "local_angle_deg = 15.0"))
    steep = build_tables(orbiter)["LOWER_MID"]
    assert steep.ratio[1] == pytest.approx(flat.ratio[2], rel=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('recovery = "edge-laminar"\n', "", "goes with the enthalpy of an edge; give edge-laminar or edge-turbulent"),
        ("altitude_m = 57e3", "altitude_km = 57", "unknown key `altitude_km`"),
        ("velocity_m_s = 3900.0", "velocity_m_s = 3.9", "write 3900"),
        ('"eckert-laminar"', '"eckert"', "theory"),
        ("wall_K = 1100.0\n", "", "wall_K"),
        ("altitude_m = 57e3", "altitude_m = 300e3", "altitude_m"),
        ("altitude_m = 57e3, velocity_m_s = 3900.0", "altitude_m = 70e3, velocity_m_s = 6301.0", "have one log10_re"),
    ],
)
def test_a_theory_that_cannot_be_evaluated_is_refused_in_one_line(orbiter, old, new, message):
    source = orbiter / "ratio_sources" / "theory.toml"
    source.write_text(source.read_text().replace(old, new))
    with pytest.raises(InputError, match=message):
        build_tables(orbiter)


def test_theory_over_another_reference_is_refused(orbiter):
    vehicle = orbiter / "vehicle.toml"
    vehicle.write_text(vehicle.read_text().replace('"fay-riddell"', '"sutton-graves"'))
    with pytest.raises(InputError, match=r"theory\.toml, \[base\]: takes ratios over `fay-riddell`"):
        build_tables(orbiter)
