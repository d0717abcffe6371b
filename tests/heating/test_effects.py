"""Effects on the heating ratio: the formula of each, their order, and dependence on the wall temperature."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_heating.base.errors import InputError
from sim_heating.base.kernels.block import EFFECT_SLOTS
from sim_heating.closure.search.trials.candidates import candidates
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.estimation.side_by_side import JointMarch
from sim_heating.heating import flight_variables
from sim_heating.heating.effects import Effect, EffectUse, effect, effects, use
from sim_heating.heating.effects.compiled import values_along
from sim_heating.inputs.points import conditions_of_record
from sim_heating.march.ensemble import condition_history
from sim_heating.march.mesh_choice import pack
from sim_heating.march.point import PointModel
from sim_heating.thermal.frame import NOT_CONTROLLED_K
from tests.support.paths import ROOT
from tests.support.verification.exact import SIGMA
from tests.support.walls import flight, heat, material, orders, practice_model, practice_record, wall
from tools.draw_effects import page

compiling = settings(deadline=None)  # the first example waits for the compiler
alphas, any_re = st.floats(0.0, 60.0), st.floats(3.0, 8.0)


def value(used: EffectUse, wall_K: float = 300.0, **conditions: float) -> float:
    """Value [-] of an effect's kernel; conditions as alpha, log10_re, jets."""
    given = {"alpha_deg" if name == "alpha" else name: v for name, v in conditions.items()}
    lane = flight([0.0], **given)[0, 0]
    return used.effect.kernel(np.concatenate([lane, used.values]), 0, len(lane), wall_K)


def film_of(*used: EffectUse, **conditions: float) -> float:
    """Film coefficient [kg/(m2 s)] of a wall at 300 K with ratio 0.5, h_ref 0.1 and these effects."""
    model = PointModel("p", wall((material(), 0.01)), nodes=14, parameters={"ratio.d0": 0.5}, effects=used)
    ensemble = pack([model])
    ensemble.begin(flight([0.0], h_ref_kg_m2_s=0.1, **conditions)[:, 0])
    return float(ensemble.film_kg_m2_s[0])


@compiling
@given(alphas, any_re, st.floats(4.0, 8.0), st.floats(-0.1, 0.1), st.floats(1e-3, 0.5), st.floats(1.0, 6.0))
def test_transition_rises_from_one_to_its_factor_along_a_logistic(alpha, log10_re, onset, sens, width, factor):
    given_values = {"log10_re_onset": onset, "alpha_sens": sens, "width": width, "factor": factor, "alpha_0_deg": 38.0}
    past = (log10_re - onset + sens * (alpha - 38.0)) / width
    expected = 1.0 + (factor - 1.0) / (1.0 + math.exp(-min(max(past, -700.0), 700.0)))
    assert value(use("transition", given_values), alpha=alpha, log10_re=log10_re) == pytest.approx(expected, rel=1e-12)


@compiling
@given(any_re, st.floats(4.0, 8.0), st.floats(1e-3, 0.5), st.floats(1.0, 6.0))
def test_transition_by_spots_begins_at_its_onset_with_narasimhas_intermittency(log10_re, onset, width, factor):
    used = use("transition", {"log10_re_onset": onset, "width": width, "factor": factor, "spots": 1.0})
    past = max((log10_re - onset) / width, 0.0)
    expected = 1.0 + (factor - 1.0) * (1.0 - math.exp(-0.412 * past**2))
    assert value(used, alpha=40.0, log10_re=log10_re) == pytest.approx(expected, rel=1e-12)


def test_transition_is_half_complete_at_its_onset():
    used = use("transition", {"log10_re_onset": 6.5, "factor": 4.0})
    assert value(used, alpha=40.0, log10_re=6.5) == pytest.approx(2.5)


@compiling
@given(alphas, st.floats(30.0, 40.0), st.floats(-0.05, 0.05))
def test_impingement_is_a_ramp_above_its_onset(alpha, onset, slope):
    used = use("impingement-onset", {"alpha_onset_deg": onset, "slope": slope})
    assert value(used, alpha=alpha) == pytest.approx(slope * max(0.0, alpha - onset))


@compiling
@given(st.floats(100.0, 2500.0), st.floats(-0.9, 3.0), st.floats(5.0, 200.0))
def test_catalysis_is_a_step_in_the_wall_temperature(wall_K, step, width):
    used = use("catalysis", {"catalysis_step": step, "catalysis_K": 1100.0, "catalysis_width_K": width})
    expected = 1.0 + step / (1.0 + math.exp(-(wall_K - 1100.0) / width))
    assert value(used, wall_K) == pytest.approx(expected, rel=1e-12)


@compiling
@given(st.floats(100.0, 2500.0), st.floats(0.0, 1.0), st.floats(800.0, 2000.0))
def test_catalysis_may_lose_part_of_its_rise_on_a_hotter_wall(wall_K, fall, fall_K):
    rise = {"catalysis_step": 0.5, "catalysis_K": 1100.0, "catalysis_width_K": 60.0}
    used = use("catalysis", rise | {"fall_fraction": fall, "fall_K": fall_K})
    up, down = (1.0 / (1.0 + math.exp(-(wall_K - T) / 60.0)) for T in (1100.0, fall_K))
    assert value(used, wall_K) == pytest.approx(1.0 + 0.5 * up * (1.0 - fall * down), rel=1e-12)


@pytest.mark.parametrize("name", ["transition", "impingement-onset", "catalysis", "jet-interaction", "emissivity"])
def test_values_along_a_flight_are_those_of_each_of_its_samples_to_the_last_bit(name):
    used, walls_K = use(name), np.linspace(300.0, 1600.0, 40)
    rows = flight(np.arange(40.0), alpha_deg=np.linspace(25.0, 50.0, 40), log10_re=np.linspace(5.0, 8.0, 40))[0]
    one_by_one = [
        used.effect.kernel(np.append(r, used.values), 0, len(r), T) for r, T in zip(rows, walls_K, strict=True)
    ]
    assert np.array_equal(values_along(used, rows, walls_K), one_by_one)


@pytest.mark.parametrize("jets", [0.0, 0.3, 1.0])
def test_jets_raise_the_ratio_in_proportion_to_their_firing(jets):
    assert value(use("jet-interaction", {"jet_gain": 0.4}), jets=jets) == pytest.approx(1.0 + 0.4 * jets)


def test_effects_that_add_act_before_those_that_multiply_in_any_order_of_declaration():
    ramp = use("impingement-onset", {"alpha_onset_deg": 30.0, "slope": 0.02})
    jets = use("jet-interaction", {"jet_gain": 0.5})
    expected = 0.1 * (0.5 + 0.02 * 10.0) * (1.0 + 0.5)
    for order in ((ramp, jets), (jets, ramp)):
        assert film_of(*order, alpha_deg=40.0, jets=1.0) == pytest.approx(expected, rel=1e-14)


def test_one_effect_twice_acts_twice():
    jets = use("jet-interaction", {"jet_gain": 0.5})
    assert film_of(jets, jets, jets=1.0) == pytest.approx(0.1 * 0.5 * 1.5**2, rel=1e-14)


def test_effects_of_one_point_do_not_reach_its_neighbour():
    model = PointModel("p", wall((material(), 0.01)), nodes=14, parameters={"ratio.d0": 0.5})
    with_jets = replace(model, name="q", effects=(use("jet-interaction"),))
    ensemble = pack([model, with_jets])
    ensemble.begin(np.repeat(flight([0.0], h_ref_kg_m2_s=0.1, jets=1.0)[:, 0], 2, axis=0))
    assert ensemble.film_kg_m2_s.tolist() == pytest.approx([0.05, 0.055])


# A wall temperature inside Newton's iteration ------------------------------------------------------------------------

STEEP = use("catalysis", {"catalysis_step": 1.0, "catalysis_K": 1000.0, "catalysis_width_K": 5.0})
SMOOTH = use("catalysis", {"catalysis_step": 0.5, "catalysis_K": 900.0, "catalysis_width_K": 100.0})


def test_catalytic_wall_settles_where_its_film_balances_radiation():
    film, H_r, eps = 0.005, 1.2e7, 0.85
    history = flight(np.linspace(0.0, 2000.0, 201), h_ref_kg_m2_s=film, H_r_J_kg=H_r)
    w = wall((material(emissivity=eps), 0.001))
    _, out = heat(w, history, nodes=14, parameters={"ratio.d0": 1.0}, effects=(SMOOTH,))
    T = float(out[-1, 0])
    taken = film * value(SMOOTH, T) * (H_r - 1004.5 * T)
    assert taken == pytest.approx(eps * SIGMA * T**4, rel=1e-9)


def test_step_converges_through_a_steep_catalytic_rise():
    record, _ = practice_record("p06")
    ensemble = pack([practice_model("p06", effects=(STEEP,))])
    ensemble.march(record.conditions.time_s, condition_history(record.conditions)[np.newaxis])
    assert ensemble.counters.failures[0] == 0.0


def test_order_in_time_stays_two_where_heating_depends_on_the_wall_temperature():
    t = np.linspace(0.0, 400.0, 51)
    history = flight(t, h_ref_kg_m2_s=0.015 * np.sin(np.pi * t / 400.0) ** 2, H_r_J_kg=1.5e7)
    w = wall((material(emissivity=0.85), 0.02))
    model = PointModel("p", w, nodes=30, parameters={"ratio.d0": 1.0}, effects=(SMOOTH,))
    plain = NOT_CONTROLLED_K
    runs = [
        pack([model], tolerance_K=plain).march(t, history, longest_step_s=step)[:, 0]
        for step in (4.0, 2.0, 1.0, 0.0625)
    ]
    errors = [np.max(np.abs(run - runs[-1])) for run in runs[:-1]]
    np.testing.assert_allclose(orders(errors), 2.0, atol=0.15)


# Declaring them ------------------------------------------------------------------------------------------------------


def test_flight_variables_are_named_as_the_columns_of_the_conditions():
    offsets = {name: value for name, value in vars(flight_variables).items() if isinstance(value, int)}
    values = {name: float(i) for i, name in enumerate(sorted(offsets))}
    (lane,) = flight([values["time_s"]], **{name: v for name, v in values.items() if name != "time_s"})[0]
    assert {name: lane[offset] for name, offset in offsets.items()} == values
    assert len(offsets) == len(lane)


def test_every_effect_states_its_physics_and_source():
    for found in effects().values():
        assert found.physics
        assert found.source
        assert all(p.text for p in found.parameters)


def test_every_effect_has_a_picture():
    docs = ROOT / "docs"
    text = (docs / "reference" / "effects.md").read_text()
    for name in effects():
        assert f"(../images/effect_{name}.png)" in text
        assert (docs / "images" / f"effect_{name}.png").is_file()


def test_page_of_effects_has_the_parameters_of_the_code_and_keeps_its_equations():
    text = (ROOT / "docs" / "reference" / "effects.md").read_text()
    assert page(text) == text
    assert text.count(r"\tag{") == 32


@pytest.mark.thorough
def test_neutral_effect_does_nothing_for_any_value_of_its_other_parameters():
    """Where its magnitudes are neutral, temperatures do not depend on any other of its parameters."""
    record, _ = practice_record("p06")
    looked_for = candidates(record, conditions_of_record(record))
    tried = {c.form: c for c in reversed(looked_for) if len(c.active) < len(c.names)}.values()
    with_more = {e.name for e in effects().values() if 0 < len(e.neutral) < len(e.parameters) and not e.last_resort}
    assert {c.name for c in tried} == with_more
    problems = [FitProblem([record], c.names, joint_reference([record]), FitOptions(effects=c.uses)) for c in tried]
    starts = [np.array([c.start[p.name] for p in q.parameters]) for c, q in zip(tried, problems, strict=True)]
    assert all(JointMarch(problems).march(starts))
    for c, problem, start in zip(tried, problems, starts, strict=True):
        own = np.concatenate([s.sensitivity for s in problem.samples(start)])
        sensitive = {p.name for p, column in zip(problem.parameters, own.T, strict=True) if np.any(column != 0.0)}
        assert sensitive, c
        assert sensitive <= set(c.active), c


def test_neutral_value_of_an_unknown_parameter_is_rejected():
    with pytest.raises(InputError, match="effect mine, `neutral`: no parameter `rize`"):
        Effect("mine", "multiply", effect("transition").parameters, lambda B, c, p, wall_K: 1.0, neutral={"rize": 0.0})


def test_misspelt_effect_is_answered_with_the_nearest():
    with pytest.raises(InputError, match="did you mean `transition`"):
        effect("transitoin")


def test_misspelt_parameter_and_value_out_of_bounds_are_named():
    with pytest.raises(InputError, match="log10_re_onset"):
        use("transition", {"onset": 6.0})
    with pytest.raises(InputError, match="jet_gain: 9 is outside its bounds -1 to 5"):
        use("jet-interaction", {"jet_gain": 9.0})


def test_more_effects_than_a_lane_has_slots_are_rejected():
    with pytest.raises(InputError, match=f"{EFFECT_SLOTS + 1} effects with a kernel; {EFFECT_SLOTS} at most"):
        PointModel("p", wall((material(), 0.01)), effects=(use("jet-interaction"),) * (EFFECT_SLOTS + 1))


def write_user_effect(folder):
    lines = [
        "from sim_heating import Effect, Parameter, njit",
        "@njit",
        "def double(B, c, p, wall_K):",
        "    return B[p]",
        "EFFECT = Effect('constant-factor', 'multiply', (Parameter('factor', '1', 2.0),), double)",
    ]
    (folder / "constant.py").write_text("\n".join(lines))


def test_file_in_a_users_folder_is_an_effect(tmp_path, monkeypatch):
    write_user_effect(tmp_path)
    monkeypatch.setenv("SIM_HEATING_EFFECTS", str(tmp_path))
    assert film_of(use("constant-factor")) == pytest.approx(0.1)


@pytest.mark.thorough
def test_user_defined_effect_is_loaded_from_the_cache_by_the_next_process(tmp_path):
    write_user_effect(tmp_path)
    lines = (
        "from sim_heating.heating.effects import use",
        "from sim_heating.heating.effects.compiled import effect_dispatcher",
        "effect_dispatcher((use('constant-factor').effect,))",
    )
    places = {"SIM_HEATING_EFFECTS": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    compiled = []
    for _ in range(2):
        command = [sys.executable, "-c", "; ".join(lines)]
        subprocess.run(command, env=os.environ | places | {"PYTHONPATH": str(ROOT)}, check=True)
        compiled.append({p.name: p.stat().st_mtime_ns for p in (tmp_path / "cache").rglob("constant.double*")})
    assert compiled[0]
    assert compiled[1] == compiled[0]
