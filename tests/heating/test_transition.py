"""Transition in the surface balance: intermittency blends film coefficient and recovery enthalpy alike."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels import block
from sim_heating.heating.effects import EffectUse, combined_uses, effect, use
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.mesh_choice import pack
from sim_heating.march.point import PointModel
from tests.support.verification.exact import SIGMA
from tests.support.walls import flight, heat, material, wall

compiling = settings(deadline=None, max_examples=30)
ONSET = {"log10_re_onset": 6.5, "alpha_sens": 0.02, "width": 0.1, "factor": 4.0}
LAMINAR, RISE = 2.0e7, 1.1e6


def begun(*used: EffectUse, **conditions: float) -> Ensemble:
    """A wall at 300 K with ratio 0.5, h_ref 0.1, and the recovery enthalpy of an edge, at its start."""
    model = PointModel("p", wall((material(), 0.01)), nodes=14, parameters={"ratio.d0": 0.5}, effects=used)
    ensemble = pack([model])
    given_there = {"h_ref_kg_m2_s": 0.1, "H_r_J_kg": LAMINAR, "H_r_rise_J_kg": RISE, "alpha_deg": 40.0, **conditions}
    ensemble.begin(flight([0.0], **given_there)[:, 0])
    return ensemble


def recovery(ensemble: Ensemble) -> float:
    """Recovery enthalpy in the surface balance [J/kg]."""
    return float(ensemble.memory.block(0)[block.scalar_row(block.RECOVERY + 2)][0])


def gamma(log10_re: float, alpha: float) -> float:
    """Intermittency [-] by the logistic function, independently of the kernel."""
    x = (log10_re - ONSET["log10_re_onset"] + ONSET["alpha_sens"] * (alpha - 40.0)) / ONSET["width"]
    return 0.5 * (1.0 + np.tanh(0.5 * x))


@compiling
@given(st.floats(5.5, 7.5), st.floats(30.0, 45.0))
def test_recovery_enthalpy_rises_with_the_intermittency_of_the_film(log10_re, alpha):
    ensemble = begun(use("transition", ONSET), log10_re=log10_re, alpha_deg=alpha)
    part = gamma(log10_re, alpha)
    assert recovery(ensemble) == pytest.approx(LAMINAR + part * RISE, rel=1e-12)
    assert ensemble.film_kg_m2_s[0] == pytest.approx(0.05 * (1.0 + 3.0 * part), rel=1e-12)


def test_recovery_enthalpy_without_transition_is_the_laminar_one():
    assert recovery(begun(log10_re=9.0)) == LAMINAR
    assert recovery(begun(use("jet-interaction"), log10_re=9.0)) == LAMINAR


def test_transition_is_found_in_any_slot_of_the_lane():
    others = use("impingement-onset", {"alpha_onset_deg": 35.0}), use("catalysis"), use("jet-interaction")
    ensemble = begun(*others, use("transition", ONSET), log10_re=6.5)
    assert recovery(ensemble) == pytest.approx(LAMINAR + 0.5 * RISE, rel=1e-12)


def test_a_factor_on_the_tables_multiplies_their_turbulent_over_laminar_ratio():
    by_table = use("transition", ONSET | {"factor": 1.1, "by_table": 1.0})
    ensemble = begun(by_table, log10_re=9.0, turbulent_ratio=4.2)
    assert ensemble.film_kg_m2_s[0] == pytest.approx(0.05 * 1.1 * 4.2, rel=1e-9)


def test_a_flight_without_a_turbulent_ratio_has_the_ratio_one():
    assert begun(use("transition", ONSET | {"factor": 1.0, "by_table": 1.0}), log10_re=9.0).film_kg_m2_s[0] == 0.05


def test_an_onset_in_re_theta_over_edge_mach_number_does_not_see_the_free_stream_reynolds_number():
    used = use("transition", ONSET | {"log10_re_onset": np.log10(300.0), "by_re_theta": 1.0})
    for log10_re in (5.0, 8.0):
        ensemble = begun(used, log10_re=log10_re, log10_re_theta_m=np.log10(300.0))
        assert recovery(ensemble) == pytest.approx(LAMINAR + 0.5 * RISE, rel=1e-12)


def test_a_boundary_layer_turns_laminar_again_below_the_onset_at_which_it_turned_turbulent():
    """A sharp onset at 6.5 with a hysteresis of 0.3, along a Reynolds number that rises, falls and rises again."""
    rise = np.concatenate([np.linspace(6.0, 6.9, 10), np.linspace(6.8, 6.0, 9), np.linspace(6.1, 6.4, 4)]) + 0.05
    sharp = use("transition", {"log10_re_onset": 6.5, "width": 1e-3, "factor": 4.0, "hysteresis": 0.3})
    history = flight(np.arange(len(rise)), log10_re=rise, h_ref_kg_m2_s=0.1, H_r_J_kg=LAMINAR, H_r_rise_J_kg=RISE)[0]
    ensemble = pack(
        [PointModel("p", wall((material(), 0.01)), nodes=14, parameters={"ratio.d0": 0.5}, effects=(sharp,))]
    )
    turbulent, found = [], []
    for i, now in enumerate(history):
        if i == 0:
            ensemble.begin(now[np.newaxis])
        else:
            ensemble.advance(now[np.newaxis], 1.0)
        found.append((float(ensemble.film_kg_m2_s[0]), recovery(ensemble)))
        # By a relay: on above the onset, off below it by more than the hysteresis, else as before.
        turbulent.append(rise[i] > 6.5 or (rise[i] > 6.2 and bool(turbulent) and turbulent[-1]))
    assert [bool(t) for t in turbulent].count(True) == 12
    expected = [(0.2, LAMINAR + RISE) if t else (0.05, LAMINAR) for t in turbulent]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_the_search_for_an_onset_in_re_theta_over_edge_mach_number_needs_its_column():
    t = np.arange(100.0)
    flown = Conditions({"time_s": t, "log10_re": 6.0 + 0.01 * t, "alpha_deg": np.full(100, 40.0)})
    starts = effect("transition").starts_for(flown)
    assert not any(start.values.get("by_re_theta") for start in starts)
    with_column = effect("transition").starts_for(flown.with_columns(log10_re_theta_m=2.0 + 0.005 * t))
    onsets = [s.values["log10_re_onset"] for s in with_column if s.values.get("by_re_theta")]
    assert len(onsets) == 7
    assert 2.0 < min(onsets) < max(onsets) < 2.5
    assert not any("hysteresis" in start.names for start in starts)  # the onset is passed once, and never again


@pytest.mark.parametrize("log10_re", [6.4, 6.5, 6.7])
def test_a_thin_insulated_wall_ends_where_the_blended_flux_is_radiated(log10_re):
    """Equilibrium of a wall that stores nothing more: r h_ref (H_r - cp T) = eps sigma T^4, solved independently."""
    time = np.linspace(0.0, 3000.0, 301)
    given_there = {
        "h_ref_kg_m2_s": 0.02, "H_r_J_kg": LAMINAR, "H_r_rise_J_kg": RISE, "alpha_deg": 40.0, "log10_re": log10_re,
    }  # fmt: skip
    film, H_r = (0.01 * (1.0 + 3.0 * gamma(log10_re, 40.0)), LAMINAR + gamma(log10_re, 40.0) * RISE)
    expected = brentq(lambda T: film * (H_r - 1004.5 * T) - 0.85 * SIGMA * T**4, 300.0, 3000.0)
    thin = wall((material(emissivity=0.85), 0.001))
    _, temperature = heat(
        thin, flight(time, **given_there), nodes=14, step_s=10.0, parameters={"ratio.d0": 0.5},
        effects=(use("transition", ONSET),),
    )  # fmt: skip
    assert temperature[-1, 0] == pytest.approx(expected, abs=0.01)


def test_an_effect_given_with_a_declared_name_takes_its_place():
    declared = use("transition", ONSET), use("jet-interaction")
    changed, more = use("transition", ONSET | {"factor": 2.0}), use("catalysis")
    assert combined_uses(declared, (more, changed)) == (changed, declared[1], more)
