"""Properties as the kernel reads them are the declared ones, wherever the points of a file are.

The checks are made without the package's tables: np.interp and quadrature of the declared points, Neumann's solution of
melting, equilibrium air from Cantera.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from sim_heating.base.kernels.block import RECOVERY_ENTHALPY
from sim_heating.heating.reference.gas import wall_enthalpy_grid
from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.mesh_choice import pack
from sim_heating.march.point import PointModel
from sim_heating.thermal.assembly import BIN_K, BINS, PIECE_HEAD, piece_of
from sim_heating.thermal.faces import SIGMA
from sim_heating.thermal.frame import NOT_CONTROLLED_K
from sim_heating.thermal.stack import Material
from sim_heating.thermal.tables import TableStore
from tests.support.walls import flight, heat, material, practice_model, practice_record, wall

cantera = pytest.importorskip("cantera", reason="no wheel of Cantera for this Python")

CP_J_KGK = 1004.5
TEMPERATURES_K = np.linspace(1.0, 3500.0, 10_001)
MELTS_K, LATENT_J_KG, OVER_K = 603.7, 2e5, 0.5


def tabulated(m: Material, T: np.ndarray, column: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """c and k as the kernel reads them, at temperatures [K] and a pressure column."""
    store = TableStore()
    point = store.add_point([m], m, CP_J_KGK)
    table = store.values[point.materials[0] :]
    width = PIECE_HEAD + 3 + 3 * point.columns
    row = BINS + width * table[np.minimum((T / BIN_K).astype(int), BINS - 1)].astype(int)
    while np.any(beyond := table[row + 1] <= T):
        row[beyond] += width
    t, k = T - table[row + 2], row + PIECE_HEAD + 4 + 3 * column
    return table[row + PIECE_HEAD + 1] + t * table[row + PIECE_HEAD + 2], table[k] + t * table[k + 1]


@pytest.mark.parametrize("temperature_K", [np.inf, 1e300, 1e299, 1e6, -np.inf, np.nan])
def test_no_temperature_leads_out_of_the_table_of_a_material(temperature_K):
    m = practice_model("p06").construction.materials["li900"]
    store = TableStore()
    point = store.add_point([m], m, CP_J_KGK)
    width, first, end = PIECE_HEAD + 3 + 3 * point.columns, point.materials[0], point.materials[1] - 1
    # Interpreted, so that a number read beyond the array is an error; compiled, it would be whatever lies there.
    row = piece_of.py_func(store.values[:end], first, width, temperature_K)
    assert first + BINS <= row <= end - width


def declared(m: Material, T: np.ndarray, column: int = 0) -> tuple[np.ndarray, np.ndarray]:
    p_Pa, T_k, k = m.conductivity_grid()
    return np.interp(T, *np.array(m.specific_heat_J_kgK).T), np.interp(T, T_k, k[:, min(column, len(p_Pa) - 1)])


def with_points_at(m: Material, place: Callable[[float], float], emitted: float = 1.0) -> Material:
    """A material whose tables have their points at other temperatures; emissivity times a factor."""

    def shifted(table: list[list[float]], factor: float = 1.0) -> list[list[float]]:
        return [[place(T), factor * value] for T, value in table]

    k = m.conductivity_W_mK
    shifted_k = shifted(k) if isinstance(k, list) else k.model_copy(update={"T_K": [place(T) for T in k.T_K]})
    eps = None if m.emissivity is None else shifted(m.emissivity, emitted)
    changed = {"specific_heat_J_kgK": shifted(m.specific_heat_J_kgK), "conductivity_W_mK": shifted_k, "emissivity": eps}
    return m.model_copy(update=changed)


def as_given(T_K: float) -> float:
    return T_K


def uneven(T_K: float) -> float:
    """Near T, but on no edge of a bin and nowhere near one for most points."""
    return T_K + 1.7 + 1.1 * math.sin(T_K)


@pytest.mark.parametrize("place", [as_given, uneven])
@pytest.mark.parametrize("name", ["rcg", "li900", "rtv", "sip", "al2024"])
def test_properties_are_those_declared(name, place):
    m = with_points_at(practice_model("p06").construction.materials[name], place)
    for column in range(len(m.conductivity_grid()[0])):
        for stored, stated in zip(
            tabulated(m, TEMPERATURES_K, column), declared(m, TEMPERATURES_K, column), strict=True
        ):
            np.testing.assert_allclose(stored, stated, rtol=1e-12)


def test_several_points_within_a_bin_and_points_above_three_thousand_kelvin_are_kept():
    peak = [[501.0, 800.0], [501.3, 4000.0], [502.9, 3000.0], [503.0, 900.0], [3100.0, 1000.0], [3333.0, 1500.0]]
    m = material([[2990.0, 1.0], [3200.0, 2.0]], peak)
    T = np.concatenate([TEMPERATURES_K, np.linspace(500.0, 504.0, 999)])
    for stored, stated in zip(tabulated(m, T), declared(m, T), strict=True):
        np.testing.assert_allclose(stored, stated, rtol=1e-12)


def test_points_on_a_line_are_left_out():
    line = [[float(T), 700.0 + 0.5 * T] for T in range(0, 3000, 10)]
    store = TableStore()
    m = material([[300.0, 1.0]], line)
    point = store.add_point([m], m, CP_J_KGK)
    # from 0 K to 2990 K, and constant above
    assert store.values[point.materials[0] : point.materials[0] + BINS].max() == 1.0


def entry_error_K(of_layers: Callable[[float], float], of_emissivity: Callable[[float], float]) -> float:
    """Largest difference [K] of an entry from the same one with all temperatures 5/4 as high.

    With T' = 5/4 T, k and c at the place of T, fluxes times 5/4 and emissivity over (5/4)^3 the equations are the same;
    points of the tables then lie elsewhere in their bins.
    """
    record, _ = practice_record("p06")
    history = condition_history(record.conditions)[np.newaxis]
    model, t, warm = practice_model("p06"), record.conditions.time_s, history.copy()
    mesh, grow = pack([model]).meshes[0], 1.25
    warm[..., RECOVERY_ENTHALPY] *= grow

    def run(times: float, flown: np.ndarray) -> np.ndarray:
        c = model.construction
        materials = {n: with_points_at(m, lambda T: times * of_layers(T)) for n, m in c.materials.items()}
        outer = with_points_at(c.layer_materials()[0], lambda T: times * of_emissivity(T), times**-3)
        name = c.stack.layer[0].material
        materials[name] = materials[name].model_copy(update={"emissivity": outer.emissivity})
        stack = c.stack.model_copy(update={"initial_K": times * c.stack.initial_K})
        point = replace(model, construction=c.model_copy(update={"stack": stack, "materials": materials}))
        # without control: temperatures that are times a factor would divide their steps elsewhere
        return Ensemble([point], [mesh], tolerance_K=NOT_CONTROLLED_K).march(t, flown) / times

    return float(np.max(np.abs(run(1.0, history) - run(grow, warm))))


@pytest.mark.parametrize(("layers", "emissivity"), [(as_given, as_given), (uneven, as_given), (as_given, uneven)])
def test_an_entry_does_not_depend_on_where_the_points_of_its_tables_lie_in_bins(layers, emissivity):
    assert entry_error_K(layers, emissivity) < 1e-9


# A peak of specific heat ---------------------------------------------------------------------------------------------


def peaked(at_K: float, over_K: float, latent_J_kg: float, c: float = 1000.0) -> list[list[float]]:
    """Specific heat with a triangular peak of an area [J/kg] over a width."""
    half = 0.5 * over_K
    return [[300.0, c], [at_K - half, c], [at_K, c + latent_J_kg / half], [at_K + half, c], [1500.0, c]]


@pytest.mark.sample(1)
@pytest.mark.parametrize("over_K", [40.0, 10.0, 1.0])
def test_a_thin_plate_stores_what_it_absorbs_also_in_a_narrow_peak_of_specific_heat(over_K):
    q_W_m2, rho, thickness_m = 1e4, 1000.0, 1e-3
    table = peaked(503.7, over_K, 5e4)
    w = wall((material(1e6, table, rho), thickness_m))
    t = np.linspace(0.0, 30.0, 121)
    _, out = heat(w, flight(t, q_add_W_m2=q_W_m2), nodes=14)

    def stored(T_K: float) -> float:
        inside = [T for T, _ in table if 300.0 < T < T_K]
        c = lambda T: float(np.interp(T, *np.array(table).T))  # noqa: E731
        return rho * thickness_m * quad(c, 300.0, T_K, points=inside or None, epsabs=1e-6)[0]

    expected = [brentq(lambda T, k=k: stored(T) - q_W_m2 * t[k], 300.0, 1000.0, xtol=1e-9) for k in range(1, 121)]
    # gradient through the plate: q L / 2 k = 5e-6 K
    np.testing.assert_allclose(out[1:, 0], expected, atol=1e-4)


def test_melting_half_space_absorbs_what_neumann_found():
    rise_K, c, rho, k = 100.0, 1000.0, 1000.0, 1.0
    a, stefan = k / (rho * c), c * rise_K / LATENT_J_KG
    w = wall((material(k, peaked(MELTS_K, OVER_K, LATENT_J_KG, c), rho), 0.12), initial_K=MELTS_K - 0.5 * OVER_K)
    t = np.linspace(0.0, 400.0, 401)
    surface_K = MELTS_K + rise_K
    history = flight(t, h_ref_kg_m2_s=1e4, H_r_J_kg=CP_J_KGK * surface_K)
    ensemble, out = heat(w, history, nodes=100, parameters={"ratio.d0": 1.0})
    assert out[-1, 0] == pytest.approx(surface_K, abs=1e-2)
    # Neumann: Carslaw and Jaeger, Conduction of Heat in Solids, 2nd ed., section 11.2, the solid at its melting point
    root = brentq(lambda x: math.sqrt(math.pi) * x * math.exp(x * x) * math.erf(x) - stefan, 1e-3, 3.0)
    absorbed = 2.0 * k * rise_K * math.sqrt(t[-1] / (math.pi * a)) / math.erf(root)
    # 0.2 % of the mesh and of the width of the peak
    assert ensemble.counters.absorbed_J_m2[0] == pytest.approx(absorbed, rel=0.005)


# Air at the wall -----------------------------------------------------------------------------------------------------


def equilibrium_enthalpy(T_K: float, p_Pa: float) -> float:
    """Enthalpy of equilibrium air [J/kg] from Cantera, zero at 0 K: sensible 300.6 kJ/kg at 298.15 K."""
    air = cantera.Solution("airNASA9.yaml")
    air.TPX = 298.15, 1e5, "N2:0.79, O2:0.21"
    cold = air.enthalpy_mass - 300.6e3
    air.TPX = T_K, p_Pa, "N2:0.79, O2:0.21"
    air.equilibrate("TP", rtol=1e-10)
    return float(air.enthalpy_mass - cold)


BETWEEN_COLUMNS_PA = [1.5, 10.0**0.4375, 30.0, 220.0, 1e3, 4.1e3, 2.3e4]


def test_enthalpy_at_the_wall_is_within_a_thousandth_of_equilibrium():
    """Read from walls that have settled: m (H_r - H_w) = eps sigma T^4."""
    film, eps, n = 0.1, 0.85, len(BETWEEN_COLUMNS_PA)
    w = wall((material(emissivity=eps), 1e-3))
    points = [
        PointModel(str(i), w, nodes=14, wall_enthalpy="equilibrium-air", parameters={"ratio.d0": 1.0}) for i in range(n)
    ]
    t = np.linspace(0.0, 300.0, 301)
    H_r = np.linspace(1.45e7, 2.2e7, n)
    flown = [
        flight(t, h_ref_kg_m2_s=film, H_r_J_kg=H, p_surface_Pa=p) for H, p in zip(H_r, BETWEEN_COLUMNS_PA, strict=True)
    ]
    T = pack(points).march(t, np.concatenate(flown))[-1, ::2]
    H_w = H_r - eps * SIGMA * T**4 / film
    expected = [equilibrium_enthalpy(*at) for at in zip(T, BETWEEN_COLUMNS_PA, strict=True)]
    np.testing.assert_allclose(H_w, expected, rtol=1e-3)


def test_enthalpy_of_air_between_the_points_of_the_gas_table_is_within_two_parts_in_ten_thousand():
    T_K, p_Pa = [425.0, 1675.0, 2025.0, 2375.0, 2975.0], [10.0**0.125, 10.0**2.375, 10.0**4.6]
    expected = [[equilibrium_enthalpy(T, p) for p in p_Pa] for T in T_K]
    np.testing.assert_allclose(wall_enthalpy_grid("equilibrium-air", T_K, p_Pa), expected, rtol=2e-4)
