"""Energy: what has entered through the two faces is what the wall holds more of, to rounding."""

from __future__ import annotations

import numpy as np
import pytest

from sim_heating.heating.effects import use
from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.mesh_choice import pack
from sim_heating.march.point import PointModel
from tests.support.walls import flight, heat_content, material, practice_model, practice_record, wall

CLOSED = 1e-10
"""Relative to the heat that entered: rounding, and Newton's last update squared, over thousands of steps."""
TILE = material([[255.0, 0.02], [1100.0, 0.1]], [[115.0, 293.0], [535.0, 1055.0], [1365.0, 1268.0]], 144.2, 0.85)
PLATE = material([[200.0, 97.0], [600.0, 165.0]], [[200.0, 800.0], [600.0, 1010.0]], 2770.0)


def imbalance(ensemble: Ensemble, march, model: int = 0) -> float:
    """Heat gained less heat entered, over heat entered, of a march."""
    start = heat_content(ensemble, model)
    march()
    entered, left = ensemble.counters.absorbed_J_m2[model], ensemble.counters.emitted_J_m2[model]
    return abs(heat_content(ensemble, model) - start - (entered - left)) / abs(entered)


def entry_imbalance(model: PointModel, name: str, **march) -> float:
    conditions = practice_record(name)[0].conditions
    ensemble, history = pack([model]), condition_history(conditions)[np.newaxis]
    return imbalance(ensemble, lambda: ensemble.march(conditions.time_s, history, **march))


@pytest.mark.parametrize("name", ["p06", "p07"])
def test_energy_closes_over_a_whole_entry(name):
    assert entry_imbalance(practice_model(name), name) < CLOSED


def test_energy_closes_at_any_step_and_node_count():
    for nodes, step in ((14, 1.0), (40, 0.25), (100, 1.0)):
        assert entry_imbalance(practice_model("p06", nodes=nodes), "p06", longest_step_s=step) < CLOSED


def test_energy_closes_with_heat_leaving_at_the_back():
    w = wall((TILE, 0.03), (PLATE, 0.003), contact=1e-3, back={"h_W_m2K": 20.0, "T_K": 280.0, "emissivity": 0.8})
    ensemble, t = pack([PointModel("wall", w)]), np.linspace(0.0, 600.0, 301)
    history = flight(t, q_add_W_m2=8e4 * np.sin(np.pi * t / 600.0))
    assert imbalance(ensemble, lambda: ensemble.march(t, history)) < CLOSED
    assert ensemble.counters.emitted_J_m2[0] > 0.0


def test_energy_closes_where_the_heating_depends_on_the_wall_temperature():
    effect = use("catalysis", {"catalysis_step": 0.8, "catalysis_K": 1000.0, "catalysis_width_K": 20.0})
    assert entry_imbalance(practice_model("p06", effects=(effect,)), "p06") < CLOSED


def test_energy_closes_where_properties_change_with_pressure():
    # k(p) moves heat about in the wall; none may appear
    model, t = practice_model("p06"), np.linspace(0.0, 600.0, 601)
    ensemble = pack([model])
    history = flight(t, q_add_W_m2=5e4, p_surface_Pa=10.0 ** (3.0 + 2.0 * np.sin(t / 10.0)))
    assert imbalance(ensemble, lambda: ensemble.march(t, history)) < CLOSED


def test_energy_entered_is_the_flux_times_time_where_nothing_is_radiated():
    t = np.linspace(0.0, 100.0, 101)
    ensemble = pack([PointModel("wall", wall((material(), 0.02)), nodes=20)])
    ensemble.march(t, flight(t, q_add_W_m2=1e4))
    assert ensemble.counters.absorbed_J_m2[0] == pytest.approx(1e6, rel=1e-9)


def test_insulated_wall_in_surroundings_of_its_own_temperature_keeps_its_temperature():
    ensemble = pack([PointModel("wall", wall((TILE, 0.03), (PLATE, 0.003), surroundings_K=300.0), nodes=30)])
    out = ensemble.march(np.linspace(0.0, 1000.0, 101), flight(np.linspace(0.0, 1000.0, 101), p_surface_Pa=100.0))
    np.testing.assert_allclose(out, 300.0, rtol=0.0, atol=1e-9)


def test_reset_clears_the_energy_of_the_flight_before():
    ensemble, t = pack([PointModel("wall", wall((TILE, 0.03)), nodes=20)]), np.linspace(0.0, 10.0, 11)
    ensemble.march(t, flight(t, q_add_W_m2=1e4))
    once = ensemble.counters.absorbed_J_m2[0]
    ensemble.reset()
    ensemble.march(t, flight(t, q_add_W_m2=1e4))
    assert ensemble.counters.absorbed_J_m2[0] == once
