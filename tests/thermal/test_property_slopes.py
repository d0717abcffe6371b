"""Slopes of the insulation's properties in temperature and pressure, against walls of the changed tables."""

from __future__ import annotations

import numpy as np
import pytest

from sim_heating.march.mesh_choice import pack
from sim_heating.march.point import PointModel
from sim_heating.thermal.stack import Material
from tests.support.walls import flight, heat, wall

PRESSURES_PA = [10.0, 100.0, 1e3, 1e4]
TIME_S = np.arange(0.0, 401.0, 2.0)
POPU = flight(
    TIME_S,
    h_ref_kg_m2_s=0.02 * np.sin(np.pi * TIME_S / 500.0),
    H_r_J_kg=2e7,
    p_surface_Pa=20.0 * 10.0 ** (TIME_S / 160.0),
)
SLOPES = {
    "stack.rsi.conductivity_slope": 4e-4,
    "stack.rsi.conductivity_decade": -0.12,
    "stack.rsi.heat_capacity_slope": -3e-4,
}
AGREEMENT_K = 0.05
"""The factor is linear in temperature, the table of the test every 20 K: their products differ between these points."""


def fibres(slope_k: float = 0.0, decade: float = 0.0, slope_c: float = 0.0) -> Material:
    """Fibrous insulation whose tables hold a change with temperature and pressure, written from equation 10b."""
    T = np.arange(0.0, 2000.0, 20.0)
    warm = np.minimum(T, 1700.0) - 700.0
    c = np.interp(T, [250.0, 1300.0], [600.0, 1250.0]) * (1.0 + slope_c * warm)
    at_p = [1.0 + decade * (np.log10(p) - 3.0) for p in PRESSURES_PA]
    gas = [0.0, 0.01, 0.02, 0.03]
    k = [
        [(0.03 + g + 8e-11 * t**3) * (1.0 + slope_k * w) * f for g, f in zip(gas, at_p, strict=True)]
        for t, w in zip(T, warm, strict=True)
    ]
    return Material(
        density_kg_m3=144.0,
        emissivity=[[300.0, 0.85]],
        specific_heat_J_kgK=np.column_stack([T, c]).tolist(),
        conductivity_W_mK={"p_Pa": PRESSURES_PA, "T_K": T.tolist(), "k": k},
    )


GLASS = Material(
    density_kg_m3=1666.0,
    emissivity=[[300.0, 0.85]],
    specific_heat_J_kgK=[[300.0, 800.0]],
    conductivity_W_mK=[[300.0, 1.0]],
)


def temperatures(insulation: Material, parameters: dict[str, float], coating: Material = GLASS) -> np.ndarray:
    tile = wall((coating, 0.0004), (insulation, 0.03))
    given = {"ratio.d0": 1.0} | parameters
    return heat(tile, POPU, (0.005, 0.015), nodes=40, parameters=given)[1]


def test_slopes_heat_a_wall_as_a_file_with_the_changed_tables():
    changed = temperatures(fibres(4e-4, -0.12, -3e-4), {})
    found = temperatures(fibres(), SLOPES)
    assert np.max(np.abs(changed - temperatures(fibres(), {}))) > 20.0
    np.testing.assert_allclose(found, changed, atol=AGREEMENT_K)


def test_a_change_with_pressure_acts_on_a_table_without_pressures():
    """Between 1 Pa and 100 kPa: at 20 kPa and -0.1 a decade k is lower by 1.3 tenths."""
    at_20_kPa = flight(TIME_S, h_ref_kg_m2_s=0.01, H_r_J_kg=2e7, p_surface_Pa=2e4)
    runs = [
        heat(wall((GLASS, 0.01)), at_20_kPa, nodes=40, parameters={"ratio.d0": 1.0, name: value})[1]
        for name, value in (
            ("stack.rsi.conductivity_decade", -0.1),
            ("stack.rsi.conductivity_factor", 1.0 - 0.1 * np.log10(20.0)),
        )
    ]
    np.testing.assert_allclose(runs[0], runs[1], atol=1e-9)


def test_slopes_of_the_insulation_leave_a_coating_of_the_same_material_alone():
    one = fibres()
    found = temperatures(one, SLOPES, coating=one)
    np.testing.assert_allclose(found, temperatures(fibres(4e-4, -0.12, -3e-4), {}, coating=one), atol=AGREEMENT_K)


def test_a_wall_is_the_declared_one_again_after_its_slopes_are_taken_away():
    model = PointModel("p", wall((GLASS, 0.0004), (fibres(), 0.03)), nodes=30, parameters={"ratio.d0": 1.0})
    fresh, used = pack([model]), pack([model.with_parameters(SLOPES)])
    changed = used.march(TIME_S, POPU)
    used.set_model(0, model)
    used.reset()
    assert np.max(np.abs(changed - fresh.march(TIME_S, POPU))) > 1.0
    assert np.array_equal(used.march(TIME_S, POPU), pack([model]).march(TIME_S, POPU))


@pytest.mark.parametrize("T", [150.0, 700.0, 1900.0])
@pytest.mark.parametrize("name", ["stack.rsi.conductivity_slope", "stack.rsi.heat_capacity_slope"])
def test_properties_stay_positive_at_the_bounds_of_their_slopes(name, T):
    model = PointModel("p", wall((GLASS, 0.01)))
    p = model.definition(name)
    weight = min(max(T, 0.0), 1700.0) - 700.0
    assert all(1.0 + slope * weight > 0.05 for slope in (p.lower, p.upper))
