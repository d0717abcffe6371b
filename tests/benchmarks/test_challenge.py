"""The generator of flight records: free of the package's code, and in agreement with its march all the same."""

from __future__ import annotations

import ast
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.sparse import diags

from benchmarks.challenge.air import EARTH_M, G0, WALL_K, standard_air, wall_enthalpy
from benchmarks.challenge.case import FINE_S, Case, History
from benchmarks.challenge.deviation import HOT_K
from benchmarks.challenge.judge import Bench, log_evidence
from benchmarks.challenge.on_ratio import ALPHA
from benchmarks.challenge.record import (
    CLASSES,
    EFFECTS,
    FAULTS,
    IMPERFECT,
    IMPERFECT_CHI2,
    KINDS,
    LEAST,
    Made,
    make,
    whole_set,
    write,
)
from benchmarks.challenge.recorder import floor_K
from benchmarks.challenge.wall import SIGMA, Forcing, Wall, build, march
from benchmarks.challenge.world import ARC_S, World
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.heating.atmosphere import us76_kernel
from sim_heating.heating.reference.gas import wall_enthalpy_grid
from sim_heating.inputs.points import point_of_record
from sim_heating.inputs.record import Record, load_record
from sim_heating.simulation.predict import predict
from tests.support.paths import ROOT

SEED = 3
USES_THE_PACKAGE = {"flown.py"}
CONTRACT = {
    "transition", "impingement-onset", "alpha-curvature", "elevon-curvature", "bodyflap-curvature", "interaction",
    "sideslip", "time-skew", "coating-thickness", "conductivity", "heat-capacity", "emissivity", "sensor-bias",
    "sensor-lag", "nonisothermal-wall", "catalysis", "backface-cooling", "gap-flow", "jet-interaction", "moisture",
    "radiative-conduction",
}  # fmt: skip
"""Names of effects in a closure report, none and unknown aside."""


@cache
def made_of(of_class: str, number: int = 0) -> Made:
    """A record of a class."""
    return make(SEED, number, of_class)


def imported(path: Path) -> set[str]:
    """Modules that a file imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}: a relative import"
            found.add(node.module or "")
    return found


# Independence --------------------------------------------------------------------------------------------------------


def test_generator_imports_nothing_of_the_package():
    files = [p for p in (ROOT / "benchmarks" / "challenge").glob("*.py") if p.name not in USES_THE_PACKAGE]
    assert len(files) > 10
    for path in files:
        foreign = {
            name
            for name in imported(path)
            if name.startswith("sim_heating")
            or (name.startswith("benchmarks") and not name.startswith("benchmarks.challenge"))
            or name.endswith("flown")
        }
        assert not foreign, f"{path.name} imports {foreign}"


@pytest.mark.parametrize("altitude_m", [0.0, 15e3, 35e3, 62e3, 80e3, 97.5e3, 118e3])
def test_two_codings_of_the_standard_atmosphere_agree(altitude_m):
    T, p, rho = standard_air(altitude_m)
    expected_T, expected_p, expected_rho = us76_kernel(altitude_m)[:3]
    assert (T, p, rho) == pytest.approx((expected_T, expected_p, expected_rho), rel=0.02 if altitude_m > 86e3 else 5e-4)


def test_molar_enthalpies_give_the_package_s_air_while_it_is_not_dissociated():
    T = np.array([300.0, 600.0, 1000.0, 1400.0])
    expected = wall_enthalpy_grid("equilibrium-air", T, np.array([300.0]))[:, 0]
    assert np.interp(T, WALL_K, wall_enthalpy(None)) == pytest.approx(expected, rel=2e-3)  # dissociation begins


# Numerics ------------------------------------------------------------------------------------------------------------


def marched(history: History, share: float = 1.0) -> tuple[Wall, NDArray[np.float64]]:
    """The declared wall on a share of the usual elements, and its (time, surface | thermocouple) temperatures [K]."""
    case, columns, n = history.case, history.columns, len(history.t)
    wall = build(case.point.stack, case.point.materials, case.point.depths_m, share=share)
    none = np.zeros(len(wall.x_m))
    forcing = Forcing(
        film=history.true_ratio * columns["h_ref_kg_m2_s"], H_r=columns["H_r_J_kg"],
        log_p=np.log10(columns["p_surface_Pa"]), eps_factor=np.ones(n), hot=np.zeros(len(HOT_K)), hot_share=np.ones(n),
        H_w=wall_enthalpy(case.cp_J_kgK), deposit=none, diverted=0.0, water=none,
        moisture=np.array([0.0, 0.0, 1.0, 1.0, 0.0]), added=np.zeros(n), side=none,
    )  # fmt: skip
    nodes = [wall.node(depth) for depth in case.point.depths_m]
    return wall, march(wall, forcing, case.point.stack["initial_K"], nodes, history.step_s)


def radau(history: History, wall: Wall, end_s: float) -> NDArray[np.float64]:
    """(time, node) temperatures [K] of the control volumes each second, by scipy's Radau; the back is insulated.

    Properties by np.interp from the declared tables.
    """
    case, columns = history.case, history.columns
    layers = [case.point.materials[entry["material"]] for entry in case.point.stack["layer"]]
    T_air, H_air = WALL_K, wall_enthalpy(case.cp_J_kgK)
    film, H_r, p = history.true_ratio * columns["h_ref_kg_m2_s"], columns["H_r_J_kg"], columns["p_surface_Pa"]

    def conductivity(material: dict, T: NDArray[np.float64], log_p: float) -> NDArray[np.float64]:
        table = material["conductivity_W_mK"]
        if isinstance(table, dict):
            column = [np.interp(log_p, np.log10(table["p_Pa"]), row) for row in table["k"]]
            return np.interp(T, table["T_K"], column)
        return np.interp(T, *np.array(table).T)

    def rate(t: float, T: NDArray[np.float64]) -> NDArray[np.float64]:
        log_p = np.log10(np.interp(t, history.t, p))
        C, g, middle = np.zeros(len(T)), 1.0 / wall.dx_m, 0.5 * (T[1:] + T[:-1])
        for i, material in enumerate(layers):
            of = np.flatnonzero(wall.layer == i)
            g[of] *= conductivity(material, middle[of], log_p)
            for end in (of, of + 1):
                c = np.interp(T[end], *np.array(material["specific_heat_J_kgK"]).T)
                C[end] += 0.5 * wall.dx_m[of] * material["density_kg_m3"] * c
        convected = np.interp(t, history.t, film) * (np.interp(t, history.t, H_r) - np.interp(T[0], T_air, H_air))
        eps = np.interp(T[0], *np.array(layers[0]["emissivity"]).T)
        radiated = eps * SIGMA * (T[0] ** 4 - case.point.stack["surroundings_K"] ** 4)
        flux = np.concatenate(([convected - radiated], g * -np.diff(T), [0.0]))
        return -np.diff(flux) / C

    n = len(wall.x_m)
    found = solve_ivp(
        rate, (0.0, end_s), np.full(n, case.point.stack["initial_K"]), "Radau", t_eval=np.arange(0.0, end_s + 0.5),
        rtol=1e-7, atol=1e-5, max_step=2.0, jac_sparsity=diags([1.0, 1.0, 1.0], [-1, 0, 1], (n, n)),
    )  # fmt: skip
    return found.y.T


def null_case(number: int, wall: str) -> Case:
    """A flight without deviation over a wall of this name."""
    case = made_of("null", number).case
    assert case.point.name == wall
    return case


@pytest.mark.thorough
@pytest.mark.parametrize(("number", "wall"), [(6, "STS96_468"), (15, "LEE_FUSELAGE"), (4, "own-plate")])
def test_march_integrates_its_control_volumes_as_radau_does(number, wall):
    case, end_s = null_case(number, wall), 850.0
    history = case.at(FINE_S)
    mesh, found = marched(history, share=0.3)
    expected = radau(history, mesh, end_s)
    nodes = [0, *(mesh.node(depth) for depth in case.point.depths_m)]
    begun, end = case.flight.manoeuvres[0][1:]
    assert begun < end < end_s  # a manoeuvre is in it
    assert np.max(np.abs(found[: 5 * len(expected) : 5] - expected[:, nodes])) < 0.02


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("number", "wall"), [(6, "STS96_468"), (15, "LEE_FUSELAGE"), (8, "own-standoff"), (4, "own-plate")]
)
def test_march_has_enough_elements_and_short_steps(number, wall):
    case = null_case(number, wall)
    _, usual = marched(case.at(FINE_S))
    assert np.array_equal(usual, case.at(FINE_S).temperatures())
    assert np.max(np.abs(marched(case.at(FINE_S), share=2.0)[1] - usual)) < 0.04
    halved = marched(case.at(0.5 * FINE_S))[1][::2]
    assert np.max(np.abs(halved - usual[: len(halved)])) < 0.04


@pytest.mark.thorough
def test_march_is_of_second_order_in_depth():
    history = null_case(6, "STS96_468").at(FINE_S)
    fine, *coarse = (marched(history, share)[1] for share in (2.0, 0.5, 0.25))
    near, far = (np.max(np.abs(T - fine)) for T in coarse)
    assert 3.0 < far / near < 5.5


# Null records: two programs, one physics -----------------------------------------------------------------------------


def at_the_true_parameters(made: Made, record: Record) -> NDArray[np.float64]:
    """(sensor, sample) the package's temperatures [K] on 100 nodes with the scale and slopes of the answer."""
    parameters = {f"ratio.{name}": value for name, value in made.answer["true_errors"].items()}
    reference = tuple(made.answer["reference_condition"][v] for v in RATIO_VARIABLES)
    model = replace(point_of_record(record, parameters), reference=reference, nodes=100)
    return predict(record, model).indicated_K


@pytest.mark.thorough
@pytest.mark.parametrize("number", [0, 4, 6, 12])
def test_package_at_the_true_parameters_explains_a_null_record_to_its_noise(number, tmp_path):
    made = made_of("null", number)
    write(made, tmp_path)
    record = load_record(tmp_path / made.name)
    found = at_the_true_parameters(made, record)
    assert np.nanmax(np.abs(found - made.indicated_K.T)) < 0.15
    floors = np.array([floor_K(s) for s in made.case.point.sensors])
    normalised = ((record.temperatures_K() - found) / floors[:, np.newaxis])[:, made.fit]
    n = np.count_nonzero(np.isfinite(normalised))
    # a word that is coarse for a slow signal does not err uniformly: 5 % besides the scatter of the sample
    assert np.nanmean(normalised**2) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / n) + 0.05)


@pytest.mark.thorough
def test_recorded_pressure_is_that_of_the_weight_of_the_recorded_density():
    recorded = made_of("null").case.recorded
    h, p, rho = (recorded[name] for name in ("altitude_m", "p_inf_Pa", "rho_kg_m3"))
    g = G0 * (EARTH_M / (EARTH_M + h)) ** 2
    weight = np.cumsum(0.5 * (rho[1:] * g[1:] + rho[:-1] * g[:-1]) * -np.diff(h))
    assert p[1:][h[1:] < 90e3] == pytest.approx((p[0] + weight)[h[1:] < 90e3], rel=2e-3)


# Records with something in them --------------------------------------------------------------------------------------


def test_every_effect_of_a_closure_report_can_be_made():
    assert {family.name for family in EFFECTS} == CONTRACT
    assert all(set(family.effects) <= {*CONTRACT, "none"} for families in FAULTS.values() for family in families)


def test_set_holds_every_class_and_any_first_part_of_it_holds_nearly_all_in_proportion():
    assert len(set(whole_set(sum(CLASSES.values())))) == sum(CLASSES.values()) >= 600
    tenth = [of_class for of_class, _ in whole_set(66)]
    assert all(abs(tenth.count(name) - n / 10) <= 1 for name, n in CLASSES.items())


@pytest.mark.thorough
def test_a_kink_in_alpha_is_an_onset_of_impingement_beside_a_slope():
    curvature, onset = (next(f for f in EFFECTS if f.name == n) for n in ("alpha-curvature", "impingement-onset"))
    history = made_of("null").case.at(1.0)
    alpha = history.x[ALPHA]
    kink = curvature.act(history, "kink", {"d_alpha2": 0.001, "scale_deg": 10.0}).add
    at_deg = float(alpha[np.argmin(kink)])
    ramp = onset.act(history, "ramp", {"alpha_onset_deg": at_deg, "slope": 0.001, "blend_deg": 1.0}).add
    terms = np.column_stack([np.ones_like(alpha), alpha, ramp])
    left = kink - terms @ np.linalg.lstsq(terms, kink, rcond=None)[0]
    assert np.max(np.abs(left)) < 0.01 * np.ptp(kink)
    assert curvature.same == {"kink": onset.name}


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("of_class", "number"), [("one", 1), ("two", 0), ("wall", 2), ("flight", 1), ("sensor", 1), ("unknown", 1)]
)
def test_a_record_loads_and_its_deviation_is_more_than_its_noise(of_class, number, tmp_path):
    made = made_of(of_class, number)
    write(made, tmp_path)
    record = load_record(tmp_path / made.name)
    used = [i for i, s in enumerate(record.sensors) if s.used]
    floors = np.array([floor_K(s) for s in made.case.point.sensors])[used, np.newaxis]
    moved = (made.indicated_K.T - at_the_true_parameters(made, record))[used][:, made.fit] / floors
    # before the refit of scale and slopes; the answer is by a coarser march
    assert np.nansum(moved**2) > 0.95 * max(made.answer["chi_square"])
    assert made.answer["true_rmse_K"]["fit"] == pytest.approx(made.answer["noise_floor_K"], rel=0.25)
    assert made.answer.get("kind") == (of_class if of_class in KINDS else None)
    assert bool(made.answer["effects"]) == (of_class in ("one", "two"))
    if made.answer["effects"]:
        assert [names[0] for names in made.answer["accepted"]] == made.answer["effects"]
        assert min(made.answer["residual_over_floor"]) >= LEAST


def test_same_seed_class_and_number_make_the_same_record_and_others_do_not():
    again = make(SEED, 0, "null")
    np.testing.assert_array_equal(again.measured_K, made_of("null").measured_K)
    assert make(SEED + 1, 0, "null").measured_K.shape != again.measured_K.shape


# Records whose model has errors of its own ---------------------------------------------------------------------------


@cache
def imperfect(of_class: str, number: int) -> Made:
    """A record of an imperfect model."""
    return make(SEED, number, of_class, imperfect=True)


def test_spline_of_heating_error_passes_through_its_values():
    world = World("spline", 0.1, np.arange(0.0, 901.0, 150.0), np.array([0.1, -0.2, 0.0, 0.05, 0.1, -0.1, 0.02]))
    assert world.error(world.knots) == pytest.approx(world.values, abs=1e-12)
    between = world.error(np.linspace(0.0, 900.0, 400))
    assert np.max(np.abs(np.diff(between))) < 0.01  # it is smooth


def test_arc_of_a_trajectory_has_one_error_of_heating_up_to_the_next():
    world = World("steps", 0.1, np.array([0.0, 100.0, 200.0]), np.array([0.1, -0.1, 0.05]))
    assert world.error(np.array([0.0, 40.0, 60.0, 140.0, 160.0, 300.0])) == pytest.approx(
        [0.1, 0.1, -0.1, -0.1, 0.05, 0.05]
    )
    assert world.error(np.array([50.0])) == pytest.approx([0.0])  # half-way between two arcs
    assert np.allclose(world.shapes(np.linspace(0.0, 300.0, 50)).sum(axis=1), 1.0)
    assert ARC_S < 10.0


@pytest.mark.parametrize(
    ("declared", "relative", "shift_s", "measured"),
    [("rightly", 0.06, 3.0, False), ("small", 0.02, 1.0, False), ("not", None, None, True)],
)
def test_errors_are_declared_rightly_too_small_or_not_at_all(declared, relative, shift_s, measured):
    world = World("spline", 0.06, np.arange(3.0), np.zeros(3), {"time_shift_s": (3.0, -1.2)}, declared=declared)
    plain = {"measured": False, "conditions": {"file": "conditions.csv"}, "heating": {"reference": "columns"}}
    found = world.declare(plain, 1500.0)
    assert found["measured"] is measured
    assert found["heating"].get("uncertainty", {}).get("relative") == relative
    assert found["conditions"].get("uncertainty", {}).get("time_shift_s") == shift_s
    assert found["conditions"].get("confidence") == ("C" if declared == "not" else None)


def test_evidence_grows_with_what_is_seen_and_falls_with_what_has_to_be_found():
    assert log_evidence(40.0, 1) > log_evidence(40.0, 3) > log_evidence(10.0, 3)
    assert log_evidence(0.0, 3) == 0.0


def test_set_of_imperfect_models_has_the_classes_that_goals_need():
    assert len(set(whole_set(sum(IMPERFECT.values()), tuple(IMPERFECT), "imperfect"))) == sum(IMPERFECT.values())
    assert IMPERFECT["null"] + IMPERFECT["error"] >= 200
    assert IMPERFECT["one"] >= 200
    assert IMPERFECT["lacking"] >= 60
    assert IMPERFECT["three"] + IMPERFECT["rivals"] >= 60


@pytest.mark.thorough
@pytest.mark.parametrize(("of_class", "number"), [("error", 0), ("one", 1), ("lacking", 0)])
def test_record_of_an_imperfect_model_loads_and_its_errors_exceed_its_noise(of_class, number, tmp_path):
    made = imperfect(of_class, number)
    write(made, tmp_path)
    record = load_record(tmp_path / made.name)
    floors = np.array([floor_K(s) for s in made.case.point.sensors])[:, np.newaxis]
    used = [i for i, s in enumerate(record.sensors) if s.used]
    left = (made.indicated_K.T - at_the_true_parameters(made, record))[used][:, made.fit] / floors[used]
    assert np.nansum(left**2) > IMPERFECT_CHI2[0]  # before the refit of scale and slopes
    assert made.answer["world"] == "imperfect"
    assert made.answer["effects"] == ([made.drawn[0].family.name] if of_class == "one" else [])
    assert made.answer["true_rmse_K"]["fit"] < 2.0 * made.answer["noise_floor_K"]
    stated = record.declared.heating.uncertainty, record.declared.conditions.uncertainty, record.declared.measured
    assert any(stated)


@pytest.mark.thorough
def test_what_the_model_does_not_know_makes_a_deviation_less_visible():
    made = imperfect("one", 1)
    bench = Bench(made.case, made.recorder.time_s, made.fit)
    blurred = replace(bench, unknown=made.world.unknown(bench))
    change = bench.change(made.drawn, true=False)
    assert float(np.sum(blurred.change(made.drawn, true=False) ** 2)) < float(np.sum(change**2))


@pytest.mark.thorough
def test_deviation_is_less_visible_where_nobody_knows_when_arcs_end():
    made = imperfect("one", 5)
    assert made.world.heating == "steps"
    bench = Bench(made.case, made.recorder.time_s, made.fit)
    change_by_phases = [
        replace(bench, unknown=made.world.unknown(bench, phases=k)).change(made.drawn, true=False) for k in (1, 5)
    ]
    known, unknown = (float(np.sum(change**2)) for change in change_by_phases)
    assert unknown < known
