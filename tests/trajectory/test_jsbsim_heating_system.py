"""A ratio table in a system of JSBSim: JSBSim itself gives the temperature that this program gives."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np
import pytest
from scipy.optimize import brentq

from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError
from sim_heating.cli import main
from sim_heating.heating.atmosphere import CP_AIR, free_stream
from sim_heating.heating.ratio.lookup import table_ratios_at
from sim_heating.heating.reference.gas import wall_enthalpy_grid
from sim_heating.heating.reference.models import reference_heating
from sim_heating.heating.reference.recovery import Recovery
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.thermal.faces import SIGMA
from sim_heating.trajectory.jsbsim.heating_system import WALL_PRESSURE_PA, jsbsim_system_text, nd_table

AIRCRAFT = """<?xml version="1.0"?>
<fdm_config name="probe" version="2.0" release="ALPHA">
 <metrics><wingarea unit="M2">1</wingarea><wingspan unit="M">1</wingspan><chord unit="M">1</chord>
  <location name="AERORP" unit="M"><x>0</x><y>0</y><z>0</z></location></metrics>
 <mass_balance><ixx unit="KG*M2">1e6</ixx><iyy unit="KG*M2">1e6</iyy><izz unit="KG*M2">1e6</izz>
  <emptywt unit="KG">1e5</emptywt><location name="CG" unit="M"><x>0</x><y>0</y><z>0</z></location></mass_balance>
 <ground_reactions/><propulsion/><system file="heating"/><aerodynamics/>
</fdm_config>"""


def fly(folder, system: str, altitude_m: float, velocity_m_s: float, alpha_deg: float, controls=()):
    """JSBSim after some steps of an aircraft with a system, at a state of flight."""
    jsbsim = pytest.importorskip("jsbsim")
    (folder / "aircraft" / "probe" / "Systems").mkdir(parents=True, exist_ok=True)
    (folder / "aircraft" / "probe" / "probe.xml").write_text(AIRCRAFT)
    (folder / "aircraft" / "probe" / "Systems" / "heating.xml").write_text(system)
    flown = jsbsim.FGFDMExec(str(folder), None)
    flown.set_debug_level(0)
    flown.set_dt(0.001)
    flown.load_model("probe")
    flown["ic/h-sl-ft"] = altitude_m / 0.3048
    flown["ic/vt-fps"] = velocity_m_s / 0.3048
    flown["ic/alpha-deg"] = alpha_deg
    flown.run_ic()
    for name, value in controls:
        flown[name] = value
    for _ in range(3):  # a system reads the angles of the step before
        flown.run()
    return flown


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("vehicle", "name", "altitude_m", "velocity_m_s", "alpha_deg"),
    [
        ("capsule", "FACE", 60e3, 6000.0, 20.0),
        ("orbiter", "NOSECAP", 70e3, 6500.0, 40.0),
        ("orbiter", "POD_LRSI", 45e3, 3000.0, 20.0),
        ("orbiter", "WING_LE", 65e3, 6000.0, 40.0),
        ("orbiter", "BODYFLAP", 55e3, 4500.0, 35.0),
    ],
)
def test_jsbsim_gives_the_equilibrium_temperature_of_a_point(
    tmp_path, vehicle, name, altitude_m, velocity_m_s, alpha_deg
):
    out = tmp_path / f"{name}.xml"
    assert main(["table", f"{vehicle}/{name}", "--out", str(out)]) == 0
    controls = [("heating/elevon-deg", 2.0), ("heating/bodyflap-deg", 5.0)]
    flown = fly(tmp_path, out.read_text(), altitude_m, velocity_m_s, alpha_deg, controls)
    loaded = load_vehicle(vehicle)
    point = loaded.control_point(name)
    rho, V = flown["atmosphere/rho-slugs_ft3"] * 515.3788184, flown["velocities/vt-fps"] * 0.3048
    z, alpha, beta = flown["position/geod-alt-ft"] * 0.3048, flown["aero/alpha-deg"], flown["aero/beta-deg"]
    air = free_stream([z], [V], [rho], loaded.reference_length_m)
    angles = {"alpha_deg": alpha, "beta_deg": beta, "elevon_deg": 2.0, "bodyflap_deg": 5.0}
    columns = {"time_s": [0.0], "velocity_m_s": [V], "rho_kg_m3": [rho], **{n: [a] for n, a in angles.items()}, **air}
    conditions = Conditions({n: np.asarray(c, dtype=float) for n, c in columns.items()})
    h_ref, H_r, _ = reference_heating(
        loaded.heating.reference,
        conditions,
        nose_radius_m=loaded.heating.nose_radius_m or 1.0,
        recovery=point.recovery,
    )
    x = np.array([[alpha, beta, air["log10_re"][0], 2.0, 5.0]])
    ratio = float(np.ravel(table_ratios_at(point.ratio, x if x.shape[0] == 1 else x.T))[0])
    emissivity = point.construction.layer_materials()[0].emissivity
    heat = loaded.heating.wall_enthalpy
    kind = heat if isinstance(heat, str) else {"cp_J_kgK": heat.cp_J_kgK}
    T_nodes, eps = np.asarray(emissivity, dtype=float).T

    def absorbed(T: float) -> float:
        """r h_ref (H_r - H_w(T)) - eps(T) sigma T^4 [W/m2]."""
        H_w = float(wall_enthalpy_grid(kind, [T], [WALL_PRESSURE_PA])[0, 0])
        return ratio * float(h_ref[0]) * (float(H_r[0]) - H_w) - float(np.interp(T, T_nodes, eps)) * SIGMA * T**4

    expected = float(brentq(absorbed, 50.0, 4000.0))
    assert flown[f"heating/{name}/ratio"] == pytest.approx(ratio, rel=1e-4)
    assert flown[f"heating/{name}/recovery-J_kg"] == pytest.approx(float(H_r[0]), rel=1e-3)
    assert flown[f"heating/{name}/equilibrium-K"] == pytest.approx(expected, abs=1.0)
    assert expected > 400.0


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    "recovery",
    [
        Recovery("edge-laminar", local_angle_deg=5.0),
        Recovery("edge-turbulent", local_angle_deg=-3.0, elevon_factor=1.0, bodyflap_factor=0.5),
        Recovery("attachment-line", sweep_deg=45.0),
    ],
    ids=lambda recovery: recovery.kind,
)
def test_jsbsim_gives_the_recovery_enthalpy_of_an_edge(tmp_path, recovery):
    """H_0 less (1 - r) u_e^2/2 at 30 deg, elevon at 6 deg and body flap at 10 deg."""
    table = load_vehicle("orbiter").control_point("WING_LE").ratio
    system = jsbsim_system_text(
        "P",
        table,
        reference="fay-riddell",
        nose_radius_m=0.3048,
        reference_length_m=32.8,
        emissivity=[[300.0, 0.85]],
        wall_enthalpy="equilibrium-air",
        recovery=recovery,
    )
    flown = fly(tmp_path, system, 60e3, 5000.0, 30.0, [("heating/elevon-deg", 6.0), ("heating/bodyflap-deg", 10.0)])
    V, alpha = flown["velocities/vt-fps"] * 0.3048, flown["aero/alpha-deg"]
    total = 0.5 * V**2 + CP_AIR * flown["heating/P/air-K"]
    edge = (
        V
        * {
            "edge-laminar": np.cos(np.radians(alpha + 5.0)),
            "edge-turbulent": np.cos(np.radians(alpha - 3.0 + 6.0 + 5.0)),
            "attachment-line": np.sin(np.radians(45.0)) * np.cos(np.radians(alpha)),
        }[recovery.kind]
    )
    r = 0.71 ** (1 / 3 if recovery.kind == "edge-turbulent" else 1 / 2)
    assert flown["heating/P/recovery-J_kg"] == pytest.approx(total - (1.0 - r) * edge**2 / 2.0, rel=1e-5)
    assert flown["heating/P/recovery-J_kg"] < 0.97 * total


@pytest.mark.parametrize(
    "shape", [(1, 1, 1, 1, 1), (3, 1, 1, 1, 1), (3, 2, 1, 1, 1), (2, 3, 2, 1, 1), (2, 2, 3, 2, 1), (2, 3, 2, 2, 2)]
)
def test_a_table_of_any_number_of_variables_is_read_as_it_was_written(tmp_path, shape):
    values = np.random.default_rng(1).uniform(0.1, 1.0, shape)
    axes = [np.arange(float(n)) for n in shape]
    names = [f"a/{c}" for c in "vwxyz"]
    table = ET.tostring(nd_table(axes, values, names), encoding="unicode")
    declared = "".join(f'<property value="0">{n}</property>' for n in names)
    function = f'<fcs_function name="a/out"><function>{table}</function></fcs_function>'
    system = f'<?xml version="1.0"?><system name="s">{declared}<channel name="c">{function}</channel></system>'
    x = [0.25 if n > 1 else 0.0 for n in shape]
    flown = fly(tmp_path, system, 30e3, 1000.0, 5.0, list(zip(names, x, strict=True)))
    expected = values
    for xi, n in zip(x, shape, strict=True):
        expected = expected[0] if n == 1 else expected[0] + xi * (expected[1] - expected[0])
    assert flown["a/out"] == pytest.approx(float(expected), rel=1e-12)


def test_a_reference_that_jsbsim_cannot_have_is_refused():
    table = load_vehicle("capsule").control_point("FACE").ratio
    with pytest.raises(InputError, match="`eckert-laminar` is not one of speed and density alone"):
        jsbsim_system_text("FACE", table, reference="eckert-laminar", nose_radius_m=1.0, reference_length_m=1.0,
                           emissivity=[[300.0, 0.85]], wall_enthalpy="equilibrium-air")  # fmt: skip
