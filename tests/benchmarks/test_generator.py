"""The generator of flight records in benchmarks: its numerics against Radau and against this program, its files."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.sparse import diags

from benchmarks.generator.case import Case, draw_case
from benchmarks.generator.conduction import SIGMA, Wall, build_wall
from benchmarks.generator.families import FAMILIES
from benchmarks.generator.record import LIMITS, Made, make, write
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.inputs.points import point_of_record
from sim_heating.inputs.record import Record, load_record
from sim_heating.simulation.predict import predict

FloatArray = NDArray[np.float64]

SEED = 20
CONTRACT = (
    "none", "transition", "impingement-onset", "alpha-curvature", "elevon-curvature", "bodyflap-curvature",
    "interaction", "sideslip", "time-skew", "coating-thickness", "conductivity", "heat-capacity", "emissivity",
    "sensor-bias", "nonisothermal-wall", "catalysis", "backface-cooling", "gap-flow", "jet-interaction", "moisture",
    "radiative-conduction", "unknown",
)  # fmt: skip
"""The names of effects in a closure report."""


def null_case(seed: int, kind: str) -> Case:
    """A flight of a pushover-pullup over a wall of this kind with three sensors."""
    return draw_case(np.random.default_rng(seed), kind, 3, ["popu"])


@cache
def null_record(number: int) -> Made:
    """A record without effect."""
    return make(SEED, number, "none")


def written(made: Made, folder: Path) -> Record:
    """The record as it reads back."""
    write(made, folder)
    return load_record(folder / made.name)


# Numerics ------------------------------------------------------------------------------------------------------------


def radau(case: Case, wall: Wall, end_s: float) -> FloatArray:
    """(time, surface) temperatures [K] of the generator's cells by scipy's Radau: air of constant cp, insulated back.

    Properties by np.interp from the declared tables, the surface temperature by Brent's method at every call.
    """
    layers = [case.point.materials[entry["material"]] for entry in case.point.stack["layer"]]
    cells = [np.flatnonzero(wall.layer == i) for i in range(len(layers))]
    eps, cp = np.array(layers[0]["emissivity"]).T, case.heating["wall_enthalpy"]["cp_J_kgK"]
    r = case.point.ratio.true(case.x, case.point.ratio.scale, case.point.ratio.d)
    film, H_r, p = r * case.fine["h_ref_kg_m2_s"], case.fine["H_r_J_kg"], case.fine["p_surface_Pa"]
    cold = case.point.stack["surroundings_K"]

    def properties(t: float, T: FloatArray) -> tuple[FloatArray, FloatArray]:
        k, c = np.empty(len(T)), np.empty(len(T))
        for m, of in zip(layers, cells, strict=True):
            c[of] = m["density_kg_m3"] * np.interp(T[of], *np.array(m["specific_heat_J_kgK"]).T)
            table = m["conductivity_W_mK"]
            if isinstance(table, dict):
                log_p = np.log10(np.interp(t, case.time_s, p))
                column = [np.interp(log_p, np.log10(table["p_Pa"]), row) for row in table["k"]]
                k[of] = np.interp(T[of], table["T_K"], column)
            else:
                k[of] = np.interp(T[of], *np.array(table).T)
        return k, c

    def surface(t: float, T_0: float, G: float) -> float:
        h, H = np.interp(t, case.time_s, film), np.interp(t, case.time_s, H_r)

        def excess(T: float) -> float:
            return h * (H - cp * T) - np.interp(T, *eps) * SIGMA * (T**4 - cold**4) - G * (T - T_0)

        return brentq(excess, 50.0, 3000.0, xtol=1e-9)

    def rate(t: float, T: FloatArray) -> FloatArray:
        k, c = properties(t, T)
        half = 0.5 * wall.dx_m / k
        G = 1.0 / half[0]
        inner = (T[:-1] - T[1:]) / (half[:-1] + half[1:] + wall.contact[:-1])
        flux = np.concatenate(([G * (surface(t, T[0], G) - T[0])], inner, [0.0]))
        return -np.diff(flux) / (c * wall.dx_m)

    n = len(wall.dx_m)
    time = np.arange(0.0, end_s + 0.5, 1.0)
    start = np.full(n, case.point.stack["initial_K"])
    pattern = diags([1.0, 1.0, 1.0], [-1, 0, 1], (n, n))
    found = solve_ivp(
        rate, (0.0, end_s), start, "Radau", t_eval=time, rtol=1e-7, atol=1e-5, max_step=2.0, jac_sparsity=pattern
    )
    k = [properties(t, T)[0][0] for t, T in zip(time, found.y.T, strict=True)]
    ends = zip(time, found.y[0], k, strict=True)
    return np.array([surface(t, T, 2.0 * k_0 / wall.dx_m[0]) for t, T, k_0 in ends])


def simplest(case: Case) -> Case:
    """The same case with an insulated back and air of constant cp."""
    from benchmarks.generator.conduction import wall_enthalpy

    air = {"cp_J_kgK": 1004.5}
    point = replace(case.point, stack={**case.point.stack, "back": "adiabatic"})
    return replace(case, point=point, heating={**case.heating, "wall_enthalpy": air}, H_w=wall_enthalpy(air))


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["lower", "felt"])
def test_generator_integrates_its_cells_as_radau_does(kind):
    case, end_s = simplest(null_case(3, kind)), 700.0
    wall = build_wall(case.point.stack, case.point.materials, case.point.depths_m, refine=0.3)
    expected = radau(case, wall, end_s)
    found = case.temperatures(refine=0.3)[:, 0][: 10 * len(expected) : 10]
    assert np.ptp(case.x[0, : 10 * len(expected)]) > 4.0  # a manoeuvre is in it
    assert np.max(np.abs(found - expected)[1:]) < 0.02  # the first is the initial temperature, not yet in balance


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["lower", "felt", "standoff", "metals"])
def test_generator_has_enough_cells(kind):
    case = null_case(5, kind)
    assert len(build_wall(case.point.stack, case.point.materials, case.point.depths_m).dx_m) >= 120
    assert np.max(np.abs(case.temperatures(refine=2.0) - case.temperatures())) < 0.04


@pytest.mark.thorough
def test_generator_is_of_second_order_in_depth():
    case = null_case(5, "lower")
    fine, *coarse = (case.temperatures(refine=share) for share in (2.0, 0.5, 0.25))
    near, far = (np.max(np.abs(T - fine)) for T in coarse)
    assert 3.0 < far / near < 5.5


def at_the_true_parameters(made: Made, record: Record) -> FloatArray:
    """(sensor, sample) the program's temperatures [K] on 100 nodes with the scale and slopes of the answer."""
    parameters = {f"ratio.{name}": value for name, value in made.answer["true_errors"].items()}
    reference = tuple(made.answer["reference_condition"][v] for v in RATIO_VARIABLES)
    model = replace(point_of_record(record, parameters), reference=reference, nodes=100)
    return predict(record, model).indicated_K


@pytest.mark.thorough
@pytest.mark.parametrize("number", range(5))
def test_program_with_the_true_parameters_reproduces_a_null_record(number, tmp_path):
    made = null_record(number)
    found = at_the_true_parameters(made, written(made, tmp_path))
    assert np.nanmax(np.abs(found - made.indicated_K.T)) < 0.2


# Records -------------------------------------------------------------------------------------------------------------


def test_every_effect_of_a_closure_report_can_be_made():
    assert sorted(FAMILIES) == sorted(CONTRACT)


@pytest.mark.thorough
@pytest.mark.sample(2)
@pytest.mark.parametrize("number", range(5))
def test_error_at_the_truth_is_the_noise_floor(number):
    made = null_record(number)
    used = [i for i, s in enumerate(made.case.point.sensors) if s["used"]]
    residual = (made.measured_K - made.indicated_K)[:, used]
    white = (1.0 - made.recorder.colour) / (1.0 + made.recorder.colour)
    n = np.count_nonzero(np.isfinite(residual)) * white
    rmse = np.sqrt(np.nanmean(residual**2))
    assert rmse == pytest.approx(made.answer["noise_floor_K"], rel=4.0 / np.sqrt(2.0 * n) + 0.05)


@pytest.mark.thorough
def test_same_seed_makes_the_same_record_and_another_does_not():
    again, other = make(SEED, 1, "none"), make(SEED + 1, 1, "none")
    np.testing.assert_array_equal(again.measured_K, null_record(1).measured_K)
    assert other.measured_K.shape != again.measured_K.shape or np.any(other.measured_K != again.measured_K)


@pytest.mark.thorough
@pytest.mark.parametrize("effect", ["transition", "conductivity", "time-skew", "catalysis", "moisture"])
def test_an_effect_moves_the_readings_by_what_the_answer_says(effect, tmp_path):
    made = make(SEED, 7, effect)
    record = written(made, tmp_path)
    used = [i for i, s in enumerate(record.sensors) if s.used]
    moved = (made.indicated_K.T - at_the_true_parameters(made, record))[:, record.fit_mask()][used]
    assert np.sqrt(np.nanmean(moved**2)) == pytest.approx(made.answer["visibility_K"], rel=0.05, abs=0.1)
    assert LIMITS[0] <= made.answer["residual_over_floor"] <= LIMITS[1]
    assert made.answer["accepted"][0] == effect
